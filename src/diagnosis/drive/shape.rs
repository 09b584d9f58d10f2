//! The hypotheses of a drive: an effect, a port, a shape with its constants.

use crate::plant::effects::{EffectKind as E, Port};

/// What a map is over; those over speed and way are no findings, but what one over position stands beside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Over {
    Position,
    Speed,
    /// Way since the last reversal.
    Way,
}

/// A law with the constants that are not linear in it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    /// exp(-(v / speed)^2) tanh.
    Stribeck { speed_m_s: f64 },
    /// Dahl's bristle over its yield length, and its rate.
    Presliding { yield_m: f64 },
    /// |tanh| / 2.
    Asymmetric,
    /// |tanh| / 2 and |v| / 2.
    AsymmetricViscous,
    /// 1.
    Gravity,
    /// v |v|.
    NonlinearViscosity,
    /// (1 - exp(-t / tau)) tanh.
    Drift { tau_s: f64 },
    /// sin, cos of x and of 2 x over the wavelength, at stage or motor.
    Wave { wavelength_m: f64 },
    /// Thrust lost, z / (1 + (1 - a) z) of it with z = b i^2: a is 0 for K / (1 + z), 1 for K (1 - z).
    Saturation { per_a2: f64, parabolic: f64 },
    /// Dead zone of the spring; `loose`: of its damper, too.
    Backlash { gap_m: f64, loose: bool },
    /// Dead zone of the spring of a stage that is held, its lower flank that far from the least stretch: a
    /// load on the motor hides where the spring is without force.
    Gap { gap_m: f64, flank_m: f64 },
    /// A slider of unit friction behind a spring with play: yields after that way, and a gap when it turns.
    Play { gap_m: f64, yield_m: f64 },
    /// D^3.
    Cubic,
    /// D x: a stiffness that changes evenly over the travel.
    StiffnessSlope,
    /// D sin, cos of x over a length.
    StiffnessWave { length_m: f64 },
    /// A third inertia.
    Torsion { frequency_hz: f64, share: f64, damping: f64 },
    /// Thrust later than stated; `early`: earlier, which is a wrong number.
    Delay { extra_s: f64, early: bool },
    /// A current loop of this bandwidth; `in_place`: it takes its own lag off a dead time that was found.
    Loop { rad_s: f64, in_place: bool },
    /// Sine and cosine of two harmonics in what an encoder reads.
    /// The first harmonic as it is known is taken off the position before the law is asked at it.
    EncoderError { period_m: f64, sine_m: f64, cosine_m: f64 },
    /// An encoder that answers later than stated.
    EncoderDelay { extra_s: f64 },
    /// A cut: four harmonics and a mean, in a window, each recording with its own phases.
    Cut { hz: f64, start_s: f64, end_s: f64 },
    /// A line of the mains in the recorded force, each recording with its own phase: no force, a fault.
    Mains { hz: f64 },
    /// The mean force of tools that cut in one recording while the spindle turns.
    Push { recording: usize, spindle_hz: f64, start_s: f64, end_s: f64 },
    /// Cubic B-splines, with the direction or without.
    Map { pieces: usize, flips: bool, over: Over },
    /// Friction that turns over another speed: a wrong number.
    Smoothing { speed_m_s: f64 },
}

/// What is asked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) effect: E,
    pub(super) port: Port,
    pub(super) shape: Shape,
}

/// A constant of a shape between its bounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Constant {
    pub(super) value: f64,
    pub(super) bounds: [f64; 2],
}

/// A relative step over which a law is differentiated by a constant.
pub(super) const DIFFERENCE: f64 = 1e-3;
/// Harmonics of a cut.
pub(super) const CUT_HARMONICS: usize = 10;

impl Hypothesis {
    /// True for a shape that moves a number of the path instead of adding a law.
    pub(super) fn is_of_path(&self) -> bool {
        matches!(self.shape, Shape::Delay { .. } | Shape::Loop { .. })
    }

    /// True for what is a number of the model, or a fault of a column, and no finding.
    pub(super) fn is_number(&self) -> bool {
        matches!(self.shape, Shape::Smoothing { .. } | Shape::Delay { early: true, .. } | Shape::Mains { .. })
    }

    /// True where the size of the law is in its shape: its amplitude is one if it is true.
    pub(super) fn has_dose(&self) -> bool {
        matches!(
            self.shape,
            Shape::Saturation { .. }
                | Shape::Backlash { .. }
                | Shape::Gap { .. }
                | Shape::Torsion { .. }
                | Shape::Delay { .. }
                | Shape::Loop { .. }
                | Shape::EncoderDelay { .. }
        )
    }

    /// True where the shape carries all of the size: another amplitude is another law.
    pub(super) fn is_whole(&self) -> bool {
        matches!(self.shape, Shape::Torsion { .. } | Shape::Saturation { .. })
    }

    /// True where physics allows no negative amplitude.
    pub(super) fn is_positive(&self) -> bool {
        matches!(
            self.shape,
            Shape::Stribeck { .. }
                | Shape::Presliding { .. }
                | Shape::Play { .. }
                | Shape::NonlinearViscosity
        )
    }

    /// True for a law of how the stage's friction turns: over a way, in place of over a speed.
    pub(super) fn turns_friction(&self) -> bool {
        matches!(self.shape, Shape::Presliding { .. } | Shape::Play { .. })
    }

    /// True for a free function, of the position or of what stands in for it.
    pub(super) fn is_map(&self) -> bool {
        matches!(self.shape, Shape::Map { .. })
    }

    /// True where each recording has columns of its own: nothing carries over to another recording.
    pub(super) fn is_of_one_recording(&self) -> bool {
        matches!(self.shape, Shape::Cut { .. } | Shape::Push { .. } | Shape::Mains { .. })
    }

    /// Begin and end of a cut, s since the recording began.
    pub(super) fn window_s(&self) -> Option<[f64; 2]> {
        match self.shape {
            Shape::Cut { start_s, end_s, .. } | Shape::Push { start_s, end_s, .. } => Some([start_s, end_s]),
            _ => None,
        }
    }

    /// The same cut from `from_s` to `to_s`.
    pub(super) fn within(mut self, [from_s, to_s]: [f64; 2]) -> Self {
        if let Shape::Cut { start_s, end_s, .. } | Shape::Push { start_s, end_s, .. } = &mut self.shape {
            (*start_s, *end_s) = (from_s, to_s);
        }
        self
    }

    /// Its constants, positive, those that are fitted by logarithmic steps.
    pub(super) fn constants(&self) -> Vec<Constant> {
        let c = |value, low, high| Constant { value, bounds: [low, high] };
        match self.shape {
            Shape::Stribeck { speed_m_s } => vec![c(speed_m_s, 1e-7, 1e3)],
            Shape::Presliding { yield_m } => vec![c(yield_m, 1e-9, 1.0)],
            Shape::Drift { tau_s } => vec![c(tau_s, 0.1, 300.0)],
            Shape::Wave { wavelength_m } => vec![c(wavelength_m, 1e-7, 1e2)],
            Shape::Saturation { per_a2, .. } => vec![c(per_a2, 1e-5, 1.0)],
            Shape::Backlash { gap_m, .. } => vec![c(gap_m, 1e-9, 1.0)],
            Shape::Gap { gap_m, flank_m } => vec![c(gap_m, 1e-9, 1.0), c(flank_m, 1e-9, 1.0)],
            Shape::Play { gap_m, yield_m } => vec![c(gap_m, 1e-9, 1.0), c(yield_m, 1e-9, 1.0)],
            Shape::StiffnessWave { length_m } => vec![c(length_m, 1e-3, 2.0)],
            Shape::Torsion { frequency_hz, share, damping } => {
                vec![c(frequency_hz, 50.0, 20_000.0), c(share, 0.05, 0.95), c(damping, 1e-3, 0.5)]
            }
            Shape::Delay { extra_s, .. } | Shape::EncoderDelay { extra_s } => vec![c(extra_s, 1e-7, 0.1)],
            Shape::Loop { rad_s, .. } => vec![c(rad_s, 1.0, 1e6)],
            Shape::Cut { hz, .. } => vec![c(hz, 0.1, 1e4)],
            Shape::Smoothing { speed_m_s } => vec![c(speed_m_s, 1e-8, 1e3)],
            Shape::Push { .. }
            | Shape::Mains { .. }
            | Shape::Asymmetric
            | Shape::AsymmetricViscous
            | Shape::Gravity
            | Shape::NonlinearViscosity
            | Shape::Cubic
            | Shape::StiffnessSlope
            | Shape::EncoderError { .. }
            | Shape::Map { .. } => Vec::new(),
        }
    }

    /// True where a constant is at a bound, to 2 %: then it is none.
    pub(super) fn is_at_bound(&self) -> bool {
        const NEAR: f64 = 0.02;
        let near =
            |c: &Constant| c.value < c.bounds[0] * (1.0 + NEAR) || c.value > c.bounds[1] * (1.0 - NEAR);
        self.constants().iter().any(near)
    }

    /// The same hypothesis with other constants, in the order of [`Hypothesis::constants`].
    pub(super) fn with(mut self, values: &[f64]) -> Self {
        match (&mut self.shape, values) {
            (Shape::Stribeck { speed_m_s: a } | Shape::Smoothing { speed_m_s: a }, [v])
            | (Shape::Presliding { yield_m: a }, [v])
            | (Shape::Drift { tau_s: a }, [v])
            | (Shape::Wave { wavelength_m: a }, [v])
            | (Shape::Saturation { per_a2: a, .. }, [v])
            | (Shape::Backlash { gap_m: a, .. }, [v])
            | (Shape::StiffnessWave { length_m: a }, [v])
            | (Shape::Delay { extra_s: a, .. } | Shape::EncoderDelay { extra_s: a }, [v])
            | (Shape::Loop { rad_s: a, .. }, [v])
            | (Shape::Cut { hz: a, .. }, [v]) => *a = *v,
            (Shape::Gap { gap_m, flank_m }, [g, f]) => (*gap_m, *flank_m) = (*g, *f),
            (Shape::Play { gap_m, yield_m }, [g, y]) => (*gap_m, *yield_m) = (*g, *y),
            (Shape::Torsion { frequency_hz, share, damping }, [f, s, d]) => {
                (*frequency_hz, *share, *damping) = (*f, *s, *d);
            }
            _ => {}
        }
        self
    }

    /// Effect and port; what is no finding has the name of the number that it is.
    pub(super) fn named(effect: E, port: Port, shape: Shape) -> Self {
        Self { effect, port, shape }
    }
}
