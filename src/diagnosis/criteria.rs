//! Every threshold of the diagnosis of a drive, with where it comes from.

pub(super) use crate::units::Z95;

macro_rules! criteria {
    ($($(#[$source:meta])* $name:ident: $kind:ty = $value:expr),* $(,)?) => {
        /// Thresholds, in nats, shares, floors or deviations: one set for every machine, effect, recording.
        #[derive(Debug, Clone, PartialEq)]
        pub(super) struct Criteria { $($(#[$source])* pub(super) $name: $kind),* }

        impl Criteria {
            /// The one set.
            pub(super) const STANDARD: Self = Self { $($name: $value),* };
        }
    };
}

criteria! {
    /// Least evidence of a finding, nats. What a balance does wrong by itself on a healthy axis in closed
    /// loop (tanh of a noisy velocity): 112, 125 and 156 nats in three simulations; above their largest.
    artefact_nats: f64 = 160.0,
    /// The same a value, at most: a short recording has no room for as much. A bias of half a deviation.
    artefact_share: f64 = 0.1,
    /// Odds against a false finding where chance alone speaks, for all hypotheses of a screening together.
    odds: f64 = 300.0,
    /// Evidence over that of the knockoffs: their largest of three turns is a sample of chance, not its end.
    knockoff_factor: f64 = 2.0,
    /// A fit has converged when the likelihood gains less than this, nats.
    converged_nats: f64 = 0.05,
    /// Amplitude of a law whose shape carries its size (a gap, a mode), least and most: 1 if it is true.
    dose: [f64; 2] = [0.6, 1.6],
    /// When a reference acts beside what the dead time says, samples. One that is held over its sample acts
    /// half a sample after it was given; drives take it up within one. A force that is logged as it acts has
    /// the time of its position: half a sample earlier. Where both encoders are read by the drive itself it
    /// is no later than said, or there is a dead time.
    timing_samples: [f64; 2] = [-0.5, 0.1],
    /// Where in those they mostly do, and by how much that differs between drives, as a deviation.
    timing_usual: f64 = -0.15,
    timing_deviation: f64 = 0.05,
    /// Findings that take nearly all of the power above the floor are the cause; the rest is told beside
    /// them. A constant takes six parts of seven of a random walk.
    named_share: f64 = 0.9,
    /// Force over position of a guide's own texture, over its dry friction: less is on every axis.
    texture: f64 = 0.003,
    /// Speeds over which friction turns up to which its form is not told from a bump at low speed: tanh is
    /// within a ten thousandth of one there.
    turning: f64 = 5.0,
    /// What friction of a real drive does not repeat, as a share of the thrust: the publishers' best model of
    /// EMPS leaves 3.1 %. So much beside a finding takes nothing from it, a stated dry friction is no nearer,
    /// and the band of one position ends where its noise makes so much force.
    repeatability: f64 = 0.031,
    /// Share of the thrust's power that a model leaves at most that is adequate: one that leaves more says
    /// nothing of this axis, however white that is.
    adequate_share: f64 = 0.5,
    /// Deviations over those by the curvature of L, at least: half-overlapping blocks, leakage between bins,
    /// noise that is not flat within a band.
    serial: f64 = 1.5,
    /// A number is wrong beyond this many of its statement's own tolerances ...
    correction_tolerances: f64 = 3.0,
    /// ... and of its deviations. A law is there beyond as many.
    correction_deviations: f64 = 4.0,
    /// Tolerance of stated masses and stiffness, as a share: what an identification by a sweep repeats to.
    mass_tolerance: f64 = 0.02,
    /// The same of dampings.
    damping_tolerance: f64 = 0.05,
    /// The same of the torque constant: winding and magnet at room temperature.
    torque_constant_tolerance: f64 = 0.01,
    /// Noise of an encoder's steps over what they are read for. Over the deflection of the screw: beyond, the
    /// axis is one mass, since errors in variables make the stiffness wrong by the square. Over friction's
    /// smoothing speed: the speed that steps make in the band of the velocity.
    step_share: f64 = 0.1,
    /// What a law evaluated between samples is exact to, as a share.
    exactness: f64 = 5e-4,
    /// What a model of a linear axis leaves of its thrust at best, as a share of its rms, where a statement
    /// of what is left stands in the model: twice that may be left on another day.
    repeat_factor: f64 = 2.0,
    /// Deviation of the logarithm of a constant from which on the recordings do not determine it.
    undetermined: f64 = 0.5,
    /// Evidence that halves the odds, over the level: chance is known no better.
    temper_share: f64 = 0.1,
    /// Found over stated from which on a step of an encoder is a coarser one: noise makes half of it.
    coarser_step: f64 = 2.0,
    /// A force over what its motion needs from which on it moves nothing.
    idle: f64 = 3.0,
    /// Mains keep their frequency within so much of it.
    mains_off: f64 = 2e-3,
    /// Share of the reference's changes that a control law may leave and still be the one that acted.
    law_share: f64 = 0.02,
    /// Pass band of a balance at most, Hz.
    band_hz: f64 = 800.0,
    /// The same as a share of the rate: of two positions, and of one, which has no resonance in it.
    band_share: [f64; 2] = [0.08, 0.1],
    /// Band of a speed at most, as a share of the rate: the kernel of its low-pass is smooth over samples.
    velocity_share: f64 = 0.2,
    /// Highest frequency looked at over the pass band: what a kernel that is half there still tells.
    top: f64 = 1.1875,
    /// Share of the excess above the floor that the stated band holds.
    excess_share: f64 = 0.95,
    /// Power of a block over the median of its recording that is told as a time of the mismatch.
    loud: f64 = 3.0,
    /// A constant this near to a bound is at it, as a share.
    at_bound: f64 = 0.02,
    /// A stated step of an encoder is right if the found one is below this many times it.
    other_step: f64 = 1.3,
    /// Share of the differences of a position that lie on the grid of its step.
    on_grid: f64 = 0.97,
    /// A motion of fewer steps is none ...
    still_steps: f64 = 3.0,
    /// ... nor is one in which no guide slides, m: guides give by 5 to 50 um before they do. What a cut moves
    /// an axis by that is told to stand has no friction, inertia or screw to tell of.
    slides_m: f64 = 5e-6,
    /// What a lead, a scale or a long screw may be off by, as a share: motor and stage have one travel where
    /// they agree in form and size to this.
    travel_off: f64 = 0.05,
    /// Least travel that tells a unit or a sign, m: what moves less may be moved by a cut, and then the drive
    /// pushes against it.
    tells_m: f64 = 2.5e-3,
    /// Share of the thrust's power below which inertia or friction have no say of their own.
    silent: f64 = 0.01,
}
