//! Inner products of columns per recording, fold and band. Fits never touch samples again.

use super::spectra::{Cell, Plan, Response, Spectrum};
use crate::signal::inner_products::{dot, dots};
use std::borrow::Cow;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// A column of the balance: what it is at the motor and at the stage. An axis with one position has its
/// one balance in the first place.
#[derive(Debug, Clone, Default)]
pub(super) struct Column {
    pub(super) sides: [Option<Spectrum>; 2],
    /// What it makes of the positions at each point of the Jacobian.
    pub(super) response: Option<Arc<Vec<Response>>>,
}

impl Column {
    /// This one and another, which is no function of the positions.
    pub(super) fn plus(&self, other: &Self) -> Self {
        let of = |k: usize| match (&self.sides[k], &other.sides[k]) {
            (Some(a), Some(b)) => Some(Arc::new(a.iter().zip(b.iter()).map(|(a, b)| a + b).collect())),
            (a, b) => a.clone().or_else(|| b.clone()),
        };
        Self { sides: [0, 1].map(of), response: None }
    }
}

/// Inner products of a set of columns.
#[derive(Debug, Clone)]
pub(super) struct Gram {
    columns: Vec<Column>,
    layers: Vec<Arc<Layer>>,
}

/// Columns that came together, each with each of them and of those before.
#[derive(Debug)]
struct Layer {
    own: Range<usize>,
    cells: Vec<Products>,
    /// Sum of all cells of one level.
    all: OnceLock<Vec<Level>>,
}

/// Inner products of own columns, in rows, with all up to the last own: motor with motor, motor with stage,
/// stage with motor, stage with stage; what one of the others has by symmetry is zero.
#[derive(Debug, Clone)]
struct Products([Vec<f64>; 4]);

/// Cells of one noise level of a layer, added up.
#[derive(Debug, Clone)]
struct Level {
    recording: usize,
    band: usize,
    values: f64,
    products: Products,
}

/// Cells of the same recording and band, added up.
#[derive(Debug, Clone)]
pub(super) struct BandGram {
    pub(super) recording: usize,
    pub(super) band: usize,
    /// Complex values.
    pub(super) values: f64,
    /// Number of columns.
    pub(super) order: usize,
    /// Symmetric: motor with motor, the mean of motor with stage and stage with motor, stage with stage.
    pub(super) products: [Vec<f64>; 3],
}

impl BandGram {
    /// True where a column is not zero.
    pub(super) fn acts(&self, column: usize) -> bool {
        let place = column * (self.order + 1);
        self.products[0][place] != 0.0 || self.products[2][place] != 0.0
    }
}

/// A part of the recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Part {
    All,
    Fold(usize),
    Recording(usize),
}

impl Part {
    fn has(self, cell: &Cell) -> bool {
        match self {
            Part::All => true,
            Part::Fold(f) => cell.fold == f,
            Part::Recording(r) => cell.recording == r,
        }
    }
}

impl Products {
    /// Of own columns of one cell.
    fn of<'a>(cell: &Cell, columns: &'a [Column], own: &Range<usize>) -> Self {
        let n = columns.len();
        // What acts in one recording or for a while is zero in most cells.
        let sides = [0, 1].map(|side| {
            let part = |c: &'a Column| c.sides[side].as_deref().map(|s| cell.of(s));
            let acts = |part: &&[f64]| part.iter().any(|v| *v != 0.0);
            columns.iter().map(|c| part(c).filter(acts)).collect::<Vec<_>>()
        });
        Self([(0, 0), (0, 1), (1, 0), (1, 1)].map(|(a, b)| {
            let mut out = vec![0.0; own.len() * n];
            let until = |i: usize| [[i + 1, n], [own.start, i + 1]][a][b];
            let acting: Vec<(usize, &[f64])> =
                own.clone().filter_map(|i| sides[a][i].map(|left| (i, left))).collect();
            // Four at a time beside each other column: what was loaded is used four times.
            for four in acting.chunks(4) {
                let last = four.iter().map(|(i, _)| until(*i)).max().unwrap_or(0);
                for (j, right) in sides[b][..last].iter().enumerate() {
                    let Some(right) = right else { continue };
                    let lefts = std::array::from_fn(|k| four.get(k).map_or(&[][..], |(_, left)| left));
                    let values =
                        if four.len() == 4 { dots(lefts, right) } else { lefts.map(|left| dot(left, right)) };
                    for ((i, _), value) in four.iter().zip(values).filter(|((i, _), _)| j < until(*i)) {
                        out[(i - own.start) * n + j] = value;
                    }
                }
            }
            out
        }))
    }

    fn add(&mut self, other: &Self) {
        for (sum, more) in self.0.iter_mut().zip(&other.0) {
            sum.iter_mut().zip(more).for_each(|(s, p)| *s += p);
        }
    }

    /// Into square matrices of n columns: see [`BandGram`].
    fn put_into(&self, own: &Range<usize>, [motor, both, stage]: &mut [Vec<f64>; 3], n: usize) {
        let at = |kind: usize, i: usize, j: usize| self.0[kind][(i - own.start) * own.end + j];
        for i in own.clone() {
            for j in 0..=i {
                let other = if j < own.start { at(2, i, j) } else { at(1, j, i) };
                let values = [at(0, i, j), 0.5 * (at(1, i, j) + other), at(3, i, j)];
                for (matrix, value) in [&mut *motor, &mut *both, &mut *stage].into_iter().zip(values) {
                    (matrix[i * n + j], matrix[j * n + i]) = (value, value);
                }
            }
        }
    }
}

impl Layer {
    fn new(plan: &Plan, columns: &[Column], own: Range<usize>) -> Self {
        let cells = plan.cells.iter().map(|cell| Products::of(cell, columns, &own)).collect();
        Self { own, cells, all: OnceLock::new() }
    }

    /// Added up over the cells that are asked for, by what has one noise level.
    fn added(&self, plan: &Plan, has: impl Fn(&Cell) -> bool, level: impl Fn(usize) -> usize) -> Vec<Level> {
        let mut out: Vec<Level> = Vec::new();
        for (cell, products) in plan.cells.iter().zip(&self.cells).filter(|(cell, _)| has(cell)) {
            let (recording, band, values) = (cell.recording, level(cell.band), cell.values as f64);
            match out.iter_mut().find(|l| (l.recording, l.band) == (recording, band)) {
                Some(level) => {
                    level.values += values;
                    level.products.add(products);
                }
                None => out.push(Level { recording, band, values, products: products.clone() }),
            }
        }
        out
    }
}

impl Gram {
    /// Inner products of columns, each with each.
    pub(super) fn new(plan: &Plan, columns: Vec<Column>) -> Self {
        Self { columns: Vec::new(), layers: Vec::new() }.with(plan, columns)
    }

    /// The same with more columns. Cost: new times all columns.
    pub(super) fn with(&self, plan: &Plan, more: Vec<Column>) -> Self {
        let own = self.len()..self.len() + more.len();
        let columns: Vec<Column> = self.columns.iter().cloned().chain(more).collect();
        let layer = Arc::new(Layer::new(plan, &columns, own));
        Self { layers: self.layers.iter().cloned().chain([layer]).collect(), columns }
    }

    /// Number of columns.
    pub(super) fn len(&self) -> usize {
        self.columns.len()
    }

    /// The column at a place.
    pub(super) fn column(&self, index: usize) -> &Column {
        &self.columns[index]
    }

    /// Added up over a part, by what has one noise level.
    pub(super) fn sum(&self, plan: &Plan, part: Part) -> Vec<BandGram> {
        let of = |layer: &Layer| layer.added(plan, |cell| part.has(cell), level_of(plan));
        match part {
            Part::All => self.whole(|layer| Cow::Borrowed(layer.all.get_or_init(|| of(layer)))),
            _ => self.whole(|layer| Cow::Owned(of(layer))),
        }
    }

    /// The same over all else.
    pub(super) fn sum_without(&self, plan: &Plan, part: Part) -> Vec<BandGram> {
        self.whole(|layer| Cow::Owned(layer.added(plan, |cell| !part.has(cell), level_of(plan))))
    }

    /// The same as [`Self::sum`] of all by bands.
    pub(super) fn sum_by_band(&self, plan: &Plan) -> Vec<BandGram> {
        self.whole(|layer| Cow::Owned(layer.added(plan, |_| true, |band| band)))
    }

    /// Layers put together: square matrices of all columns.
    fn whole<'a>(&'a self, of: impl Fn(&'a Layer) -> Cow<'a, [Level]>) -> Vec<BandGram> {
        let n = self.len();
        let mut out: Vec<BandGram> = Vec::new();
        for layer in &self.layers {
            for (k, level) in of(layer).iter().enumerate() {
                if out.len() == k {
                    let Level { recording, band, values, .. } = *level;
                    let products = [0, 1, 2].map(|_| vec![0.0; n * n]);
                    out.push(BandGram { recording, band, values, order: n, products });
                }
                level.products.put_into(&layer.own, &mut out[k].products, n);
            }
        }
        out
    }
}

/// The level of a band: all bands have one where the plan is white.
fn level_of(plan: &Plan) -> impl Fn(usize) -> usize + use<> {
    let white = plan.white;
    move |band| if white { 0 } else { band }
}
