//! Every threshold of the diagnosis of a drive, with where it comes from.

/// Thresholds, in nats, shares, floors or deviations. One set for every machine, effect and recording.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Criteria {
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
    /// Steps of an encoder over what they are read for. Over the deflection of the screw: beyond, the axis is
    /// one mass, since errors in variables make the stiffness wrong. Over friction's smoothing speed: the
    /// speed that a step makes in the band of the velocity.
    pub(super) step_share: f64,
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
    /// Pass band of a balance at most, Hz.
    pub(super) band_hz: f64,
    /// The same as a share of the rate: of two positions, and of one, which has no resonance in it.
    pub(super) band_share: [f64; 2],
    /// Highest frequency looked at over the pass band: what a kernel that is half there still tells.
    pub(super) top: f64,
    /// Share of the axial resonance up to which an axis with one position moves as one mass: its stage lags
    /// by 2 % of its inertia there.
    pub(super) rigid_share: f64,
    /// Narrowest band of a velocity, as a share of the rate.
    pub(super) velocity_band_share: f64,
    /// Quantile of the blocks of a recording in which the axis moves: at rest a step shows no noise.
    pub(super) moving: f64,
    /// Bands from which on an axis with one position shows its floor, as a share of the highest frequency.
    pub(super) quiet_from: f64,
    /// Share of the excess above the floor that the stated band holds.
    pub(super) excess_share: f64,
    /// Power of a block over the median of its recording that is told as a time of the mismatch.
    pub(super) loud: f64,
    /// A constant this near to a bound is at it, as a share.
    pub(super) at_bound: f64,
    /// A way back that is a reversal, in travels.
    pub(super) reversal: f64,
    /// A line is there itself where it has this share of its strongest harmonic.
    pub(super) line_share: f64,
    /// A stated step of an encoder is right if the found one is below this many times it.
    pub(super) other_step: f64,
    /// Share of the differences of a position that lie on the grid of its step.
    pub(super) on_grid: f64,
    /// Steps of the force that differ by less of its span are the same step.
    pub(super) same_step: f64,
    /// A motion of fewer steps is none ...
    pub(super) still_steps: f64,
    /// ... nor is one in which no guide slides, m: guides give by 5 to 50 um before they do. What a cut moves
    /// an axis by that is told to stand has no friction, inertia or screw to tell of.
    pub(super) slides_m: f64,
    /// What a lead, a scale or a long screw may be off by.
    pub(super) travel_off: f64,
    /// Motor and stage have one travel where they agree in form to this share of their power ...
    pub(super) travel_alike: f64,
    /// ... and go further than this, m, and than so many stretches of the screw and steps of the encoder.
    pub(super) travel_least_m: f64,
    pub(super) travel_least_times: f64,
    /// Least share of the thrust's power that a model explains once it is turned, if its sign is wrong.
    pub(super) turned_explains: f64,
    /// Least travel that tells a sign, m: what moves less may be moved by a cut, and then the drive pushes
    /// against it.
    pub(super) turned_least_m: f64,
    /// Share of the thrust's power below which inertia or friction have no say of their own.
    pub(super) silent: f64,
}

impl Criteria {
    /// The one set.
    pub(super) const STANDARD: Self = Self {
        artefact_nats: 160.0,
        artefact_share: 0.1,
        odds: 300.0,
        knockoff_factor: 2.0,
        converged_nats: 0.05,
        dose: [0.6, 1.6],
        timing_samples: [-0.5, 0.1],
        timing_usual: -0.15,
        timing_deviation: 0.05,
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
        step_share: 0.1,
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
        band_hz: 800.0,
        band_share: [0.08, 0.1],
        top: 1.1875,
        rigid_share: 0.15,
        velocity_band_share: 0.05,
        moving: 0.75,
        quiet_from: 0.02,
        excess_share: 0.95,
        loud: 3.0,
        at_bound: 0.02,
        reversal: 1e-3,
        line_share: 0.25,
        other_step: 1.3,
        on_grid: 0.97,
        same_step: 1e-6,
        still_steps: 3.0,
        slides_m: 5e-6,
        travel_off: 0.05,
        travel_alike: 0.98,
        travel_least_m: 1e-3,
        travel_least_times: 20.0,
        turned_explains: 0.3,
        turned_least_m: 2.5e-3,
        silent: 0.01,
    };
}

/// Normal 95 %.
pub(super) const Z95: f64 = 1.96;
