//! Every threshold of the diagnosis of a drive, with where it comes from.

/// Thresholds, in nats, shares, floors or deviations. One set for every machine, effect and recording.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::diagnosis) struct Criteria {
    /// Least evidence of a finding, nats. What a balance does wrong by itself on a healthy axis in closed
    /// loop (tanh of a noisy velocity): 112, 125 and 156 nats in three simulations; above their largest.
    pub(super) artefact_nats: f64,
    /// The same a value, at most: a short recording has no room for as much. A bias of half a deviation.
    pub(super) artefact_share: f64,
    /// Odds against a false finding where chance alone speaks, for all hypotheses of a screening together.
    pub(super) odds: f64,
    /// Evidence over that of the knockoffs: their largest of three turns is a sample of chance, not its end.
    pub(super) knockoff_factor: f64,
    /// A fit has converged when the likelihood gains less than this, nats.
    pub(super) converged_nats: f64,
    /// Amplitude of a law whose shape carries its size (a gap, a mode), least and most: 1 if it is true.
    pub(super) dose: [f64; 2],
    /// When a reference acts beside what the dead time says, samples. One that is held over its sample acts
    /// half a sample after it was given; drives take it up within one. A force that is logged as it acts has
    /// the time of its position: half a sample earlier. Where both encoders are read by the drive itself it
    /// is no later than said, or there is a dead time.
    pub(super) timing_samples: [f64; 2],
    /// Where in those they mostly do, and by how much that differs between drives, as a deviation.
    pub(super) timing_usual: f64,
    pub(super) timing_deviation: f64,
    /// What is left is told where it stands above this many floors.
    pub(super) rest_floors: f64,
    /// Findings that take nearly all of the power above the floor are the cause; the rest is told beside
    /// them. A constant takes six parts of seven of a random walk.
    pub(super) named_share: f64,
    /// Force over position of a guide's own texture, over its dry friction: less is on every axis.
    pub(super) texture: f64,
    /// Speeds over which friction turns up to which its form is not told from a bump at low speed: tanh is
    /// within a ten thousandth of one there.
    pub(super) turning: f64,
    /// What friction of a real drive does not repeat, as a share of the thrust: the publishers' best model of
    /// EMPS leaves 3.1 %. So much beside a finding takes nothing from it.
    pub(super) repeatability: f64,
    /// Share of the thrust's power that a model leaves at most that is adequate: one that leaves more says
    /// nothing of this axis, however white that is.
    pub(super) adequate_share: f64,
    /// Deviations over those by the curvature of L, at least: half-overlapping blocks, leakage between bins,
    /// noise that is not flat within a band.
    pub(super) serial: f64,
    /// A number is wrong beyond this many of its statement's own tolerances ...
    pub(super) correction_tolerances: f64,
    /// ... and of its deviations.
    pub(super) correction_deviations: f64,
    /// Tolerance of stated masses and stiffness, as a share: what an identification by a sweep repeats to.
    pub(super) mass_tolerance: f64,
    /// The same of dry friction.
    pub(super) coulomb_tolerance: f64,
    /// The same of dampings.
    pub(super) damping_tolerance: f64,
    /// The same of the torque constant: winding and magnet at room temperature.
    pub(super) torque_constant_tolerance: f64,
    /// Steps of an encoder over the deflection of the screw from which on the axis is one mass: beyond, the
    /// stiffness is estimated wrong by errors in variables.
    pub(super) unresolved_deflection: f64,
    /// Speed that a step of the encoder makes in the band of the velocity, over friction's smoothing speed.
    pub(super) velocity_noise: f64,
    /// Force that noise of a position makes through the mass, over the thrust: where the band of one position
    /// ends. A thirtieth of the thrust bends a mass by a thousandth.
    pub(super) position_noise: f64,
    /// Speed of the axis below which a linear spectrum is flat: two bands of the floor, share of the band.
    pub(super) floor_band: [f64; 2],
    /// What a law evaluated between samples is exact to, as a share.
    pub(super) exactness: f64,
    /// What a model of a linear axis leaves of its thrust at best, as a share of its rms, where a statement
    /// of what is left stands in the model: twice that may be left on another day.
    pub(super) repeat_factor: f64,
    /// Deviation of the logarithm of a constant from which on the recordings do not determine it.
    pub(super) undetermined: f64,
    /// Evidence that halves the odds, over the level: chance is known no better.
    pub(super) temper_share: f64,
    /// Found over stated from which on a step of an encoder is a coarser one: noise makes half of it.
    pub(super) coarser_step: f64,
    /// A force over what its motion needs from which on it moves nothing.
    pub(super) idle: f64,
    /// Mains keep their frequency within so much of it.
    pub(super) mains_off: f64,
    /// Share of the reference's changes that a control law may leave and still be the one that acted.
    pub(super) law_share: f64,
    /// Share of itself that the deviation of a number may be which the written model states.
    pub(super) known_share: f64,
}

impl Criteria {
    /// The one set.
    pub(in crate::diagnosis) const STANDARD: Self = Self {
        artefact_nats: 160.0,
        artefact_share: 0.1,
        odds: 300.0,
        knockoff_factor: 2.0,
        converged_nats: 0.05,
        dose: [0.6, 1.6],
        timing_samples: [-0.5, 0.1],
        timing_usual: -0.15,
        timing_deviation: 0.05,
        rest_floors: 1.0,
        named_share: 0.9,
        texture: 0.003,
        turning: 5.0,
        repeatability: 0.031,
        adequate_share: 0.5,
        serial: 1.5,
        correction_tolerances: 3.0,
        correction_deviations: 4.0,
        mass_tolerance: 0.02,
        coulomb_tolerance: 0.033,
        damping_tolerance: 0.05,
        torque_constant_tolerance: 0.01,
        unresolved_deflection: 0.1,
        velocity_noise: 0.1,
        position_noise: 0.03,
        floor_band: [0.168, 0.337],
        exactness: 5e-4,
        repeat_factor: 2.0,
        undetermined: 0.5,
        temper_share: 0.1,
        coarser_step: 2.0,
        idle: 3.0,
        mains_off: 2e-3,
        law_share: 0.02,
        known_share: 0.05,
    };
}

/// Normal 95 %.
pub(super) const Z95: f64 = 1.96;
