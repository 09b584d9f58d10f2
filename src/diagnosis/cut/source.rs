//! Where does a force that nothing explains act? What reaches both tools is not the same for a force of the
//! chip, one on the bar, and a holder that moves; in forces undone by the cut and in those of its loop alike.
//!
//! ```text
//! process    F = Z n,          n of either tool, or of both alike
//! workpiece  F = Z A (1,-1) G p,   p on the bar
//! turret     F = Z A (0, 1) w,     w: holder of tool 2 into the work
//! ```

use crate::plant::cut_loop::CutLoop;
use crate::plant::effects::Port;
use nalgebra::Complex;

/// Both tools.
pub(crate) type Pair = [Complex<f64>; 2];

/// What sources of unit size at each port make of the forces of a bin.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sources {
    pub(crate) process: [Pair; 2],
    pub(crate) workpiece: Pair,
    pub(crate) turret: Pair,
}

impl Sources {
    /// At `s` of a cut. `undone`: of forces from which the loop has been taken.
    pub(crate) fn of(cut: &CutLoop, s: Complex<f64>, undone: bool) -> Self {
        let one = Complex::new(1.0, 0.0);
        let none = Complex::new(0.0, 0.0);
        let z = if undone { [[one, none], [none, one]] } else { cut.closed(s) };
        let a = cut.force_law(s);
        let through = |u: Pair| {
            let n = [0, 1].map(|i| a[i][0] * u[0] + a[i][1] * u[1]);
            [0, 1].map(|i| z[i][0] * n[0] + z[i][1] * n[1])
        };
        let g = cut.bar_response(s);
        Self {
            process: [[z[0][0], z[1][0]], [z[0][1], z[1][1]]],
            workpiece: through([g, -g]),
            turret: through([none, one]),
        }
    }

    /// By hypothesis the port and what acts there at once.
    pub(crate) fn hypotheses(&self) -> [(Port, Vec<Pair>); 5] {
        let [first, second] = self.process;
        [
            (Port::Process, vec![first, second]),
            (Port::Process, vec![first]),
            (Port::Process, vec![second]),
            (Port::Workpiece, vec![self.workpiece]),
            (Port::Turret, vec![self.turret]),
        ]
    }
}
