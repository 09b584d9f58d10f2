//! Stability before and after, over the two conditions that the cuts differ in most, with the cuts on it.

use super::page::key;
use super::plot::{Axis, Figure, Mark, range_of};
use crate::diagnosis::cut::result::{CutDiagnosis, MappedCut};
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::Scenario;
use crate::stability::scenario_root;
use std::fmt::Write as _;

/// Points of the map along either axis: a lobe of a thirtieth of the speed is seen.
const COLUMNS: usize = 72;
const ROWS: usize = 36;

/// A condition that cuts differ in.
#[derive(Clone, Copy)]
struct Side {
    label: &'static str,
    scale: f64,
    of: fn(&MappedCut) -> f64,
    set: fn(&mut CutCondition, f64),
}

const SIDES: [Side; 4] = [
    Side { label: "spindle speed, rpm", scale: 1.0, of: |c| c.at.speed_rpm, set: |at, v| at.speed_rpm = v },
    Side { label: "width of cut, mm", scale: 1e3, of: |c| c.at.width_m, set: |at, v| at.width_m = v },
    Side {
        label: "pitch difference, degrees",
        scale: 57.295_779_513_082_32,
        of: |c| c.at.pitch_difference_rad,
        set: |at, v| at.pitch_difference_rad = v,
    },
    Side {
        label: "tools from the chuck, mm",
        scale: 1e3,
        of: |c| c.at.position_m,
        set: |at, v| at.position_m = v,
    },
];

/// The two maps; nothing where the cuts are all alike.
pub(super) fn maps(out: &mut String, d: &CutDiagnosis) {
    let judged: Vec<&MappedCut> = d.mapped.iter().filter(|c| c.at.width_m > 0.0).collect();
    let Some([x, y]) = sides(&judged) else { return };
    out.push_str("<h2>Where it chatters: the stated model and the repaired one</h2><div class=\"row\">");
    let stated_rad = d.stated.tools.pitch_difference_rad();
    for (scenario, title) in [(&d.stated, "as stated"), (&d.scenario, "repaired")] {
        // What a correction adds to the commanded pitch it adds to that of every cut.
        let pitch_rad = scenario.tools.pitch_difference_rad() - stated_rad;
        let told: Vec<Told<'_>> = judged.iter().map(|cut| Told::by(scenario, pitch_rad, cut)).collect();
        let figure = map(scenario, &told, [x, y], title);
        let known = told.iter().filter(|t| t.right.is_some()).count();
        let right = told.iter().filter(|t| t.right == Some(true)).count();
        let _ = write!(
            out,
            "<div class=\"card\"><h3>{title}: {right} of {known} cuts right</h3>{}</div>",
            figure.svg()
        );
    }
    let _ = write!(
        out,
        "</div><p class=\"small soft\">{}{}{}{}Disc: the cut chattered; ring: it did not. Its colour is by the model under all of \
         the cut's own conditions. Shaded: small vibration grows, all else as in the middle of the cuts; a cut that differs in \
         something else may lie beside its place.</p>",
        key("shade", "model: chatter"),
        key("after", "the model has this cut right"),
        key("before", "the model has it wrong"),
        key("floor", "not judged"),
    );
}

/// A cut beside what a model says of it.
struct Told<'a> {
    cut: &'a MappedCut,
    /// Whether that is what it did; `None`: nobody knows what it did.
    right: Option<bool>,
}

impl<'a> Told<'a> {
    fn by(scenario: &Scenario, pitch_rad: f64, cut: &'a MappedCut) -> Self {
        let pitch_difference_rad = cut.at.pitch_difference_rad + pitch_rad;
        let at = CutCondition { pitch_difference_rad, ..cut.at };
        let grows = || scenario_root(scenario, &at).growth_1_s > 0.0;
        Self { cut, right: cut.chatter.map(|chatter| chatter == grows()) }
    }

    fn class(&self) -> &'static str {
        match (self.right, self.cut.chatter) {
            (None, _) => "floor",
            (Some(true), Some(true)) => "after",
            (Some(true), _) => "ring after",
            (Some(false), Some(true)) => "before",
            (Some(false), _) => "ring before",
        }
    }
}

/// The two conditions with most different values among the cuts.
fn sides(cuts: &[&MappedCut]) -> Option<[Side; 2]> {
    let different = |side: &Side| {
        let mut values: Vec<f64> = cuts.iter().map(|c| (side.of)(c)).collect();
        values.sort_by(f64::total_cmp);
        let apart = |w: &[f64]| (w[1] - w[0]).abs() > 1e-3 * w[1].abs().max(1e-9);
        1 + values.windows(2).filter(|w| apart(w)).count()
    };
    let mut all: Vec<(usize, Side)> = SIDES.iter().map(|s| (different(s), *s)).collect();
    all.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    (cuts.len() > 1 && all[0].0 > 1).then(|| [all[0].1, all[1].1])
}

fn middle(cuts: &[&MappedCut], of: fn(&MappedCut) -> f64) -> f64 {
    let mut values: Vec<f64> = cuts.iter().map(|c| of(c)).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn map(scenario: &Scenario, told: &[Told<'_>], [x, y]: [Side; 2], title: &str) -> Figure {
    let cuts: Vec<&MappedCut> = told.iter().map(|t| t.cut).collect();
    let mut at = CutCondition::of(scenario);
    for side in SIDES {
        (side.set)(&mut at, middle(&cuts, side.of));
    }
    let range = |side: Side| {
        let mut values: Vec<f64> = cuts.iter().map(|c| (side.of)(c)).collect();
        let [low, high] = range_of(&mut values, false);
        let widest = if high - low < 1e-6 * high.abs() { 0.5 * high.abs().max(1e-6) } else { 0.0 };
        let least = if low > 0.0 || high <= 0.0 { low - widest } else { low };
        // Below zero there is no speed, width or place; a pitch may be there.
        let floor = if side.label.starts_with("pitch") { f64::NEG_INFINITY } else { 0.02 * high };
        [least.max(floor), high + widest]
    };
    let (xs, ys) = (range(x), range(y));
    let cell = [(xs[1] - xs[0]) / COLUMNS as f64, (ys[1] - ys[0]) / ROWS as f64];
    let mut cells = Vec::new();
    for row in 0..ROWS {
        let low_y = ys[0] + row as f64 * cell[1];
        let mut run: Option<f64> = None;
        for column in 0..=COLUMNS {
            let low_x = xs[0] + column as f64 * cell[0];
            let mut here = at;
            (x.set)(&mut here, low_x + 0.5 * cell[0]);
            (y.set)(&mut here, low_y + 0.5 * cell[1]);
            let grows = column < COLUMNS && scenario_root(scenario, &here).growth_1_s > 0.0;
            match (grows, run) {
                (true, None) => run = Some(low_x),
                (false, Some(from)) => {
                    cells.push([
                        from * x.scale,
                        low_x * x.scale,
                        low_y * y.scale,
                        (low_y + cell[1]) * y.scale,
                    ]);
                    run = None;
                }
                _ => {}
            }
        }
    }
    let mut marks = vec![Mark::Cells { class: "shade", cells }];
    // Those that are wrong above those that are right.
    for class in ["floor", "after", "ring after", "ring before", "before"] {
        let own = told.iter().filter(|t| t.class() == class);
        let points = own.map(|t| [(x.of)(t.cut) * x.scale, (y.of)(t.cut) * y.scale]).collect();
        marks.push(Mark::Dots { class, points });
    }
    Figure {
        size: [520.0, 300.0],
        x: Axis::linear(x.label, xs.map(|v| v * x.scale)),
        y: Axis::linear(y.label, ys.map(|v| v * y.scale)),
        marks,
        title: format!("stability, {title}"),
    }
}
