//! Error budgets of the observers, as tables, JSON and pictures (`stillcut resolution --budget`).

use crate::force::balance::Method;
use crate::force::budget::{Budget, Imperfection};
use crate::force::closed_loop::ClosedLoop;
use crate::force::driven_budget::{DrivenBudget, Parts, PhaseLag, with_inertia_ratio};
use crate::plant::drive::{DriveParams, ParamError, Structure};
use crate::plant::machine::{AxisModel, Controller};
use crate::report::force_plots::{Curve, Panel};
use crate::units::SampleRate;
use std::fmt::Write as _;

const BUDGET_HZ: [f64; 12] = [1.0, 10.0, 30.0, 50.0, 70.0, 100.0, 150.0, 200.0, 300.0, 500.0, 700.0, 1000.0];
/// Points of a curve from 1 Hz to 1 kHz.
const CURVE_POINTS: u32 = 121;
/// Position and velocity gain of the thesis, table 4-1, where a model states no controller.
const TABLE_4_1: Controller = Controller {
    position_gain_1_s: 50.0,
    velocity_gain_1_s: 200.0,
    velocity_integral_1_s: 0.0,
    velocity_filter_rad_s: 5000.0,
};

/// One thing that goes wrong: its name and its size over frequency.
struct BudgetRow {
    name: String,
    size: Box<dyn Fn(f64) -> f64>,
}

/// One table: what goes wrong with one observer of one axis.
pub(super) struct BudgetTable {
    axis: String,
    method: &'static str,
    what: &'static str,
    unit: &'static str,
    figures: &'static str,
    rows: Vec<BudgetRow>,
}

impl BudgetTable {
    pub(super) fn text(&self) -> String {
        let mut text = format!(
            "\naxis {}, {}: {}, {} (figures {})\n{:26}",
            self.axis, self.method, self.what, self.unit, self.figures, "hz"
        );
        let line = |text: &mut String, values: &mut dyn Iterator<Item = f64>| {
            for value in values {
                let _ = write!(text, " {value:>8.2}");
            }
            text.push('\n');
        };
        line(&mut text, &mut BUDGET_HZ.into_iter());
        for row in &self.rows {
            let _ = write!(text, "{:26}", row.name);
            line(&mut text, &mut BUDGET_HZ.into_iter().map(&row.size));
        }
        text
    }

    pub(super) fn json(&self) -> serde_json::Value {
        let rows: Vec<serde_json::Value> = self
            .rows
            .iter()
            .map(|row| {
                let values: Vec<f64> = BUDGET_HZ.into_iter().map(&row.size).collect();
                serde_json::json!({ "name": row.name, "values": values })
            })
            .collect();
        serde_json::json!({
            "axis": self.axis, "method": self.method, "what": self.what, "unit": self.unit,
            "figures": self.figures, "frequency_hz": BUDGET_HZ, "rows": rows,
        })
    }

    pub(super) fn panel(&self) -> Panel {
        let curve = |row: &BudgetRow| Curve {
            label: row.name.clone(),
            points: (0..CURVE_POINTS)
                .map(|k| 10f64.powf(f64::from(k) / 40.0))
                .map(|hz| (hz, (row.size)(hz).max(1e-6)))
                .collect(),
            dots: false,
        };
        Panel {
            title: format!("axis {}, {}: {} ({})", self.axis, self.method, self.what, self.figures),
            x_label: "Hz".to_owned(),
            y_label: self.unit.to_owned(),
            log_y: true,
            curves: self.rows.iter().map(curve).collect(),
        }
    }
}

/// All tables of all axes; `disturbance_cutoff_rad_s`: of the loop's own disturbance observer.
pub(super) fn budget_tables(
    axes: &[AxisModel],
    rate: SampleRate,
    disturbance_cutoff_rad_s: Option<f64>,
) -> Result<Vec<BudgetTable>, ParamError> {
    let mut tables = Vec::new();
    for axis in axes {
        let methods: &[Method] = match axis.drive.structure() {
            Structure::Rigid => &[Method::Dob],
            _ => &[Method::Dob, Method::Medob, Method::VibrationMode],
        };
        let controller = axis.controller.unwrap_or(TABLE_4_1);
        let closed = |drive: &DriveParams| {
            let closed = ClosedLoop::around(drive, controller, rate);
            disturbance_cutoff_rad_s.map_or(closed, |g| closed.cancelling_disturbances(g))
        };
        for method in methods {
            let one = Observer { axis, method: *method, rate, closed: &closed };
            tables.push(one.parameters()?);
            if axis.drive.structure() == Structure::DualInertia && *method != Method::Dob {
                tables.push(one.phase_lag());
                tables.push(one.parts(&axis.drive, "what the estimate is made of"));
            }
            if axis.drive.structure() == Structure::DualInertia && *method == Method::VibrationMode {
                for part in SHARES {
                    tables.push(one.over_inertia_ratio(part)?);
                }
            }
            tables.push(one.steps()?);
        }
    }
    Ok(tables)
}

/// A part of the estimate over inertia ratios: name, figure, share.
type Share = (&'static str, &'static str, fn(&Parts) -> f64);
const SHARES: [Share; 4] = [
    ("thrust force over the inertia ratio", "5-2", |p| p.thrust.norm()),
    ("elastic force over the inertia ratio", "5-3", |p| p.elastic.norm()),
    ("damping force over the inertia ratio", "5-4", |p| p.damping.norm()),
    ("inertia force over the inertia ratio", "5-5", |p| p.inertia.norm()),
];

struct Observer<'a> {
    axis: &'a AxisModel,
    method: Method,
    rate: SampleRate,
    closed: &'a dyn Fn(&DriveParams) -> ClosedLoop,
}

impl Observer<'_> {
    fn table(&self, what: &'static str, unit: &'static str, figures: &'static str) -> BudgetTable {
        let (axis, method) = (self.axis.name.clone(), self.method.name());
        BudgetTable { axis, method, what, unit, figures, rows: Vec::new() }
    }

    fn parameters(&self) -> Result<BudgetTable, ParamError> {
        let right = Imperfection::default();
        let mass = |q: f64| Imperfection { mass_factor: q, ..right };
        let stiffness = |q: f64| Imperfection { stiffness_factor: q, ..right };
        let inertia = |q: f64| Imperfection { inertia_factor: q, ..right };
        let mut table =
            self.table("error for wrong parameters", "% of the force", "4-2, 5-6, 5-8; drive not driven");
        for (name, wrong) in [
            ("nothing wrong", right),
            ("movable mass x 0.5", mass(0.5)),
            ("movable mass + 5 %", mass(1.05)),
            ("movable mass x 1.5", mass(1.5)),
            ("rotary inertia + 5 %", inertia(1.05)),
            ("axial stiffness x 0.8", stiffness(0.8)),
            ("axial stiffness + 5 %", stiffness(1.05)),
            ("axial stiffness x 1.2", stiffness(1.2)),
            ("stage late by 10 us", Imperfection { stage_late_s: 1e-5, ..right }),
        ] {
            let budget = Budget::new(self.method, &self.axis.drive, wrong)?;
            let size = Box::new(move |hz| 100.0 * budget.relative_error(hz));
            table.rows.push(BudgetRow { name: name.to_owned(), size });
        }
        Ok(table)
    }

    /// Complete, partial and no alignment; the thrust alone beside them.
    fn phase_lag(&self) -> BudgetTable {
        let drive = &self.axis.drive;
        let plant = (self.closed)(drive);
        let whole = PhaseLag::complete(drive);
        let ms = |lag: PhaseLag| {
            format!("({:.2}, {:.2}, {:.2}) ms", 1e3 * lag.current_s, 1e3 * lag.motor_s, 1e3 * lag.stage_s)
        };
        let mut table = self.table("error for incomplete alignment", "% of the force", "4-3, 5-7");
        let none = PhaseLag::default();
        for (what, lag) in [
            ("all", whole),
            ("current", PhaseLag { stage_s: 0.0, ..whole }),
            ("stage", PhaseLag { current_s: 0.0, ..whole }),
            ("none", none),
        ] {
            let budget = DrivenBudget::new(self.method, drive, plant, lag).holding(self.rate);
            let size = Box::new(move |hz| 100.0 * budget.relative_error(hz));
            table.rows.push(BudgetRow { name: format!("{what} {}", ms(lag)), size });
        }
        let thrust = DrivenBudget::new(Method::Thrust, drive, plant, none);
        let size = Box::new(move |hz| 100.0 * thrust.relative_error(hz));
        table.rows.push(BudgetRow { name: "thrust alone".to_owned(), size });
        table
    }

    fn parts(&self, drive: &DriveParams, what: &'static str) -> BudgetTable {
        let plant = (self.closed)(drive);
        let budget = DrivenBudget::new(self.method, drive, plant, PhaseLag::complete(drive));
        let budget = budget.holding(self.rate);
        let mut table = self.table(what, "% of the force", "4-1, 5-1, 5-10");
        let shares: [Share; 6] = [
            ("estimate", "", |p| p.sum().norm()),
            ("thrust", "", |p| p.thrust.norm()),
            ("elastic", "", |p| p.elastic.norm()),
            ("damping", "", |p| p.damping.norm()),
            ("inertia", "", |p| p.inertia.norm()),
            ("inertia from motor angle", "", |p| p.motor_inertia.norm()),
        ];
        for (name, _, share) in shares {
            let size = Box::new(move |hz| 100.0 * share(&budget.parts(hz)));
            table.rows.push(BudgetRow { name: name.to_owned(), size });
        }
        table
    }

    fn over_inertia_ratio(&self, (what, figure, share): Share) -> Result<BudgetTable, ParamError> {
        let stated = self.axis.drive.movable_mass_kg() / self.axis.drive.reflected_mass_kg();
        let mut table = self.table(what, "% of the force", figure);
        for alpha in [stated, 0.2, 0.5, 1.0, 2.0] {
            let drive = with_inertia_ratio(&self.axis.drive, alpha)?;
            let plant = (self.closed)(&drive);
            let budget = DrivenBudget::new(self.method, &drive, plant, PhaseLag::complete(&drive));
            let budget = budget.holding(self.rate);
            let size = Box::new(move |hz| 100.0 * share(&budget.parts(hz)));
            table.rows.push(BudgetRow { name: format!("alpha {alpha:.3}"), size });
        }
        Ok(table)
    }

    /// Standard deviation of encoder steps through each side of the balance.
    fn steps(&self) -> Result<BudgetTable, ParamError> {
        let drive = &self.axis.drive;
        let budget = Budget::new(self.method, drive, Imperfection::default())?;
        let (motor_m, stage_m) = (drive.motor_encoder_resolution_m(), drive.stage_encoder_resolution_m());
        let mut table =
            self.table("encoder steps, if all fell at one frequency", "N", "4-5, 4-7, 5-9; see errata");
        for (name, motor_m, stage_m) in [
            ("as stated", motor_m, stage_m),
            ("rotary 38 nm", 38e-9, 0.0),
            ("rotary 1 nm", 1e-9, 0.0),
            ("scale 20 nm", 0.0, 20e-9),
            ("scale 5 nm", 0.0, 5e-9),
        ] {
            let budget = budget.clone();
            let size = Box::new(move |hz| budget.step_error_n(hz, motor_m, stage_m));
            table.rows.push(BudgetRow { name: name.to_owned(), size });
        }
        Ok(table)
    }
}
