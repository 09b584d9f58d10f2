//! Inner products of columns per recording, fold and band. Fits never touch samples again.

use super::spectra::{Cell, Plan, Response, Spectrum};
use crate::signal::inner_products::dot;
use std::sync::Arc;

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

/// Inner products of one cell: motor with motor, motor with stage, stage with stage; row-major.
#[derive(Debug, Clone)]
struct CellGram {
    products: [Vec<f64>; 3],
}

/// Inner products of a set of columns.
#[derive(Debug, Clone)]
pub(super) struct Gram {
    columns: Vec<Column>,
    cells: Vec<CellGram>,
}

/// Cells of the same recording and band, added up.
#[derive(Debug, Clone)]
pub(super) struct BandGram {
    pub(super) recording: usize,
    pub(super) band: usize,
    /// Complex values.
    pub(super) values: f64,
    pub(super) products: [Vec<f64>; 3],
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

impl Gram {
    /// Inner products of columns, each with each.
    pub(super) fn new(plan: &Plan, columns: Vec<Column>) -> Self {
        let empty = Self {
            columns: Vec::new(),
            cells: vec![CellGram { products: [Vec::new(), Vec::new(), Vec::new()] }; plan.cells.len()],
        };
        empty.with(plan, columns)
    }

    /// The same with more columns. Cost: new times all columns.
    pub(super) fn with(&self, plan: &Plan, more: Vec<Column>) -> Self {
        let (before, n) = (self.columns.len(), self.columns.len() + more.len());
        let columns: Vec<Column> = self.columns.iter().cloned().chain(more).collect();
        let cell_gram = |(cell, old): (&Cell, &CellGram)| {
            let product = |a: &Option<Spectrum>, b: &Option<Spectrum>| match (a, b) {
                (Some(a), Some(b)) => dot(cell.of(a), cell.of(b)),
                _ => 0.0,
            };
            let products = std::array::from_fn(|kind| {
                let (a, b) = [(0, 0), (0, 1), (1, 1)][kind];
                let mut m = vec![0.0; n * n];
                for i in 0..before {
                    m[i * n..i * n + before]
                        .copy_from_slice(&old.products[kind][i * before..(i + 1) * before]);
                }
                for i in 0..n {
                    let from = if i < before { before } else { 0 };
                    for j in from..n {
                        let done = a == b && i > j;
                        m[i * n + j] = if done {
                            m[j * n + i]
                        } else {
                            product(&columns[i].sides[a], &columns[j].sides[b])
                        };
                    }
                }
                m
            });
            CellGram { products }
        };
        let cells = plan.cells.iter().zip(&self.cells).map(cell_gram).collect();
        Self { columns, cells }
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
        self.added(plan, |cell| part.has(cell))
    }

    /// The same over all else.
    pub(super) fn sum_without(&self, plan: &Plan, part: Part) -> Vec<BandGram> {
        self.added(plan, |cell| !part.has(cell))
    }

    /// The same as [`Self::sum`] of all by bands.
    pub(super) fn sum_by_band(&self, plan: &Plan) -> Vec<BandGram> {
        self.by_level(plan, |_| true, |band| band)
    }

    fn added(&self, plan: &Plan, has: impl Fn(&Cell) -> bool) -> Vec<BandGram> {
        self.by_level(plan, has, |band| if plan.white { 0 } else { band })
    }

    fn by_level(
        &self,
        plan: &Plan,
        has: impl Fn(&Cell) -> bool,
        level: impl Fn(usize) -> usize,
    ) -> Vec<BandGram> {
        let mut out: Vec<BandGram> = Vec::new();
        for (cell, gram) in plan.cells.iter().zip(&self.cells).filter(|(cell, _)| has(cell)) {
            let values = cell.values as f64;
            match out.iter_mut().find(|b| b.recording == cell.recording && b.band == level(cell.band)) {
                Some(band) => {
                    band.values += values;
                    for (sum, products) in band.products.iter_mut().zip(&gram.products) {
                        sum.iter_mut().zip(products).for_each(|(s, p)| *s += p);
                    }
                }
                None => out.push(BandGram {
                    recording: cell.recording,
                    band: level(cell.band),
                    values,
                    products: gram.products.clone(),
                }),
            }
        }
        out
    }
}
