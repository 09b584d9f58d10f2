//! From servo sample to chatter report: composition only, no formula lives here.
//!
//! ```text
//! ServoSample --check, gaps--> force estimator --> chatter monitor --> agreement of the axes --> StepOutput
//!                              of each axis        of each axis
//!                                    |--> stability margin of each axis (what is left before chatter)
//!                                    \--> sliding DFT of the band (what the page shows)
//! ```
//! The same [`Pipeline`] serves the live service and `stillcut replay`: what it says depends on the
//! samples alone, so the same bytes in give the same bytes out. A recording that already holds forces
//! enters after the estimators, through [`Pipeline::step_estimates`].
//!
//! After [`Pipeline::new`] a step allocates nothing, unless a gap or, for estimators that are made for a
//! spindle speed, a new speed makes it start anew.

mod cutting;
mod deaf;
mod keyframe;
mod margin;
mod settings;

pub use crate::force::plan::{ForcePlan, ServoPlan};
pub use deaf::Deaf;
pub use keyframe::KeyframeError;
pub use margin::{CutConditions, CutPrior, DeafReason, Margin, MarginPlan, MarginReading, MarginWarning};
pub use settings::{AxisPlan, BandPlan, PipelineError, PipelineSettings, ToolAxis, lines_of};

use crate::chatter::{
    Agreement, AgreementState, ChatterEvent, ChatterMonitor, ChatterOutput, ChatterSettings, ChatterState,
    Line, Phase, Reason, agree,
};
use crate::force::disagreement::Disagreement;
use crate::force::lanes::LANES;
use crate::force::motion::{ForceEstimate, MotionSample};
use crate::force::observers::{AxisObserver, Observers};
use crate::force::validity::Validity;
use crate::sample::{AxisSample, MAX_AXES, SampleError, ServoSample};
use crate::signal::sliding_dft::{SlidingDft, SlidingDftSettings, SlidingDftState};
use cutting::{CutWatch, Stand};
use margin::Margins;

/// Lost samples up to this many are bridged by straight lines; after more, everything starts anew.
pub const LARGEST_BRIDGE: u64 = 9;
/// Chatter that goes on after a start is heard within this: the monitors watch the strongest line for 1.2 s.
const UNKNOWN_S: f64 = 1.5;

/// What went wrong with the stream at a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StreamFault {
    /// Samples are missing before this one.
    Gap {
        /// How many.
        lost: u64,
    },
    /// The sequence number is not above the last one: the sample was left out.
    Repeated,
    /// A signal is not a finite number: the sample was left out.
    NotFinite(SampleError),
}

/// What one sample led to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepOutput {
    /// Time of the sample, s.
    pub t_s: f64,
    /// Force of each axis as it was a short while ago, with what speaks against it.
    pub forces: [ForceEstimate; MAX_AXES],
    /// What the axes say together.
    pub chatter: Agreement,
    /// What began or ended, on which axis.
    pub event: Option<(usize, ChatterEvent)>,
    /// The axis whose margin begins to run out with this sample.
    pub margin_warning: Option<MarginWarning>,
    /// What was wrong with the stream.
    pub fault: Option<StreamFault>,
    /// True when the spectra were brought up to date with this sample.
    pub spectrum_updated: bool,
}

#[derive(Debug, Clone, Copy)]
struct Channel {
    thrust_n_a: f64,
    travel_m_rad: f64,
    nut: Option<usize>,
    watch: bool,
    pushed: f64,
}

impl Channel {
    /// What the axis did, in force and travel.
    fn motion(&self, axis: usize, sample: &ServoSample) -> MotionSample {
        let signals = &sample.axes[axis];
        MotionSample {
            thrust_ref_n: self.thrust_n_a * signals.current_ref_a,
            motor_travel_m: Some(self.travel_m_rad * signals.motor_angle_rad),
            nut_position_m: self.nut.and_then(|other| sample.axes.get(other)?.stage_position_m),
            stage_position_m: signals.stage_position_m,
            spindle_speed_rpm: Some(sample.spindle_speed_rpm),
            accel_m_s2: sample.accel_m_s2,
        }
    }
}

#[derive(Debug, Clone)]
struct ChannelState {
    apart: Option<Disagreement>,
    monitor: ChatterState,
    flags: Validity,
    stand: Stand,
}

/// The pipeline of one machine.
#[derive(Debug, Clone)]
pub struct Pipeline {
    settings: PipelineSettings,
    channels: Vec<Channel>,
    observers: Observers<LANES>,
    /// Second estimators of axes that have one.
    beside: Option<Observers<LANES>>,
    monitor: ChatterMonitor,
    margins: Option<Margins>,
    cutting: CutWatch,
    /// What the page shows: single precision errs by 5e-6 of the strongest line and does not drift. What is
    /// tracked and decided is computed in double precision by the monitors.
    spectrum: SlidingDft<f32>,
    states: Vec<ChannelState>,
    spectrum_state: SlidingDftState<f32>,
    row: Vec<f64>,
    last: Option<ServoSample>,
    clean_samples: u64,
    agreement_state: AgreementState,
    agreement: Agreement,
    declared: bool,
    /// Samples since everything began anew.
    since_restart: u64,
    /// The band of the tools' place lies outside of what the monitors were designed for.
    out_of_reach: bool,
}

impl Pipeline {
    /// Designs estimators, monitors and spectrum. Errors: names the axis or the band that does not fit.
    pub fn new(settings: PipelineSettings) -> Result<Self, PipelineError> {
        settings.check()?;
        let band = settings.band.band()?;
        let monitor = ChatterMonitor::new(ChatterSettings {
            sample_rate: settings.sample_rate,
            band,
            mean: settings.mean,
            false_alarm_s: settings.false_alarm_s,
        })?;
        let channels = settings.axes.iter().map(|a| settings.channel(a)).collect::<Result<Vec<_>, _>>()?;
        let observers = settings.observers(|axis| axis.force.as_ref())?;
        let beside = settings.axes.iter().any(|axis| axis.beside.is_some());
        let beside = beside.then(|| settings.observers(|axis| axis.beside.as_ref())).transpose()?;
        let bins = settings.spectrum_bins(band);
        let spectrum = SlidingDft::new(SlidingDftSettings {
            sample_rate: settings.sample_rate,
            window_samples: settings.window_samples(),
            first_bin_hz: bins.first_hz,
            bin_step_hz: bins.step_hz,
            bins: bins.count,
            axes: channels.len(),
        })?;
        let states = channels
            .iter()
            .map(|_| ChannelState {
                apart: None,
                monitor: monitor.start(),
                flags: Validity::SETTLING,
                stand: Stand::default(),
            })
            .collect();
        let spectrum_state = spectrum.start();
        let row = vec![0.0; channels.len()];
        let margins = Margins::new(&settings, [band.low_hz(), band.high_hz()]);
        Ok(Self {
            margins,
            cutting: CutWatch::default(),
            settings,
            channels,
            observers,
            beside,
            monitor,
            spectrum,
            states,
            spectrum_state,
            row,
            last: None,
            clean_samples: 0,
            agreement_state: AgreementState::default(),
            agreement: agree(&mut AgreementState::default(), 0.0, std::iter::empty()),
            declared: false,
            since_restart: 0,
            out_of_reach: false,
        })
    }

    /// What it was made from.
    #[must_use]
    pub fn settings(&self) -> &PipelineSettings {
        &self.settings
    }

    /// Watched band, Hz: as planned, narrower where the tools are near the chuck, wider where a line sits
    /// at its edge.
    #[must_use]
    pub fn band_hz(&self) -> [f64; 2] {
        let band = self.monitor.settings().band;
        let watched = self.channels.iter().zip(&self.states).filter(|(c, _)| c.watch);
        watched
            .map(|(_, s)| self.monitor.watched_hz(&s.monitor))
            .reduce(|[low, high], now| [low.min(now[0]), high.max(now[1])])
            .unwrap_or([band.low_hz(), band.high_hz()])
    }

    /// Lets the band follow the tools along the bar and the diameter, four times a second, while no chatter
    /// is heard. It stays inside of what the monitors were designed for.
    fn follow_tools(&mut self, sample: &ServoSample) {
        let PipelineSettings { tools, infeed, .. } = &self.settings;
        if tools.is_none() && infeed.is_none() {
            return;
        }
        let due = self.clean_samples.is_multiple_of(self.spectrum.settings().window_samples as u64 / 4);
        if !due || self.agreement.phase == Phase::Chatter {
            return;
        }
        let position_m = tools.and_then(|axis| axis.distance_m(sample));
        let diameter_m = infeed.and_then(|axis| axis.distance_m(sample)).map(|radius_m| 2.0 * radius_m);
        if let Ok(band) = self.settings.band.band_at(position_m, diameter_m) {
            let monitor = &self.monitor;
            self.out_of_reach = false;
            for state in &mut self.states {
                // What cannot be heard is not acted on.
                self.out_of_reach |= !monitor.follow(&mut state.monitor, band);
            }
        }
    }

    /// Diameter at the tools by the newest sample, m, where an axis tells the infeed.
    #[must_use]
    pub fn measured_diameter_m(&self) -> Option<f64> {
        let (infeed, sample) = (self.settings.infeed.as_ref()?, self.last.as_ref()?);
        infeed.distance_m(sample).map(|radius_m| 2.0 * radius_m)
    }

    /// Whether the tools are where the bar's band cannot be heard as planned: nothing is acted on.
    #[must_use]
    pub fn band_out_of_reach(&self) -> bool {
        self.out_of_reach
    }

    /// Whether the tools cut, by the mean force of the turret's watched axes; nothing before anything told.
    #[must_use]
    pub fn in_cut(&self) -> Option<bool> {
        self.cutting.in_cut()
    }

    /// What explains best, other than chatter, what the axis hears that leads.
    #[must_use]
    pub fn reason(&self) -> Reason {
        self.monitor.output(&self.states[self.agreement.leading_axis].monitor).reason
    }

    /// Samples since the last gap or restart.
    #[must_use]
    pub fn clean_samples(&self) -> u64 {
        self.clean_samples
    }

    /// What the monitor of one axis says now.
    #[must_use]
    pub fn axis_output(&self, axis: usize) -> Option<&ChatterOutput> {
        self.states.get(axis).map(|s| self.monitor.output(&s.monitor))
    }

    /// First bin and distance of the bins of [`Self::amplitudes_n`], Hz.
    #[must_use]
    pub fn spectrum_grid_hz(&self) -> [f64; 2] {
        [self.spectrum.settings().first_bin_hz, self.spectrum.settings().bin_step_hz]
    }

    /// Amplitude of each bin of one axis over the last second, N.
    pub fn amplitudes_n(&self, axis: usize) -> impl Iterator<Item = f64> + '_ {
        let bins = if axis < self.channels.len() { self.spectrum.settings().bins } else { 0 };
        (0..bins).map(move |k| self.line_amplitude_n(axis, k))
    }

    fn line_amplitude_n(&self, axis: usize, bin: usize) -> f64 {
        // |S| = A N / 2 for a tone of amplitude A.
        let window = self.spectrum.settings().window_samples as f64;
        2.0 * self.spectrum.value(&self.spectrum_state, axis, bin).norm() / window
    }

    /// One servo sample. A sample that cannot be used changes nothing but the fault that is reported.
    pub fn step(&mut self, sample: &ServoSample) -> StepOutput {
        if let Err(error) = sample.check() {
            self.clean_samples = 0;
            return self.unchanged(sample.t_s, StreamFault::NotFinite(error));
        }
        let mut bridged = None;
        let fault = match self.last {
            Some(last) if sample.sequence <= last.sequence => {
                return self.unchanged(sample.t_s, StreamFault::Repeated);
            }
            Some(last) if sample.sequence - last.sequence > 1 => {
                let lost = sample.sequence - last.sequence - 1;
                if lost <= LARGEST_BRIDGE {
                    bridged = self.bridge(&last, sample, lost);
                } else {
                    self.restart();
                }
                self.clean_samples = 0;
                Some(StreamFault::Gap { lost })
            }
            _ => None,
        };
        self.last = Some(*sample);
        self.follow_tools(sample);
        let mut output = self.take(sample);
        output.event = output.event.or(bridged);
        output.fault = fault;
        output
    }

    /// One instant of forces that were estimated elsewhere, one per axis, with what speaks against each and
    /// what is known of the cut.
    pub fn step_estimates(
        &mut self,
        t_s: f64,
        estimates: &[ForceEstimate],
        conditions: &CutConditions,
    ) -> StepOutput {
        let mut forces = [ForceEstimate { force_n: 0.0, flags: Validity::VALID }; MAX_AXES];
        for (to, from) in forces.iter_mut().zip(estimates) {
            *to = *from;
        }
        self.listen(t_s, forces, true, conditions)
    }

    fn unchanged(&self, t_s: f64, fault: StreamFault) -> StepOutput {
        StepOutput {
            t_s,
            forces: [ForceEstimate { force_n: 0.0, flags: Validity::SIGNAL_MISSING }; MAX_AXES],
            chatter: self.agreement,
            event: None,
            margin_warning: None,
            fault: Some(fault),
            spectrum_updated: false,
        }
    }

    /// Feeds what lies on straight lines between two samples, so that short losses do not ring. Answers what
    /// began or ended on the way.
    fn bridge(&mut self, from: &ServoSample, to: &ServoSample, lost: u64) -> Option<(usize, ChatterEvent)> {
        let mut event = None;
        for i in 1..=lost {
            let share = i as f64 / (lost + 1) as f64;
            let mix = |a: f64, b: f64| a + share * (b - a);
            let mut between = *to;
            between.sequence = from.sequence + i;
            between.t_s = mix(from.t_s, to.t_s);
            let accel = from.accel_m_s2.zip(to.accel_m_s2);
            between.accel_m_s2 = accel.map(|(a, b)| std::array::from_fn(|k| mix(a[k], b[k])));
            for (axis, (a, b)) in between.axes.iter_mut().zip(from.axes.iter().zip(&to.axes)) {
                *axis = AxisSample {
                    current_ref_a: mix(a.current_ref_a, b.current_ref_a),
                    motor_angle_rad: mix(a.motor_angle_rad, b.motor_angle_rad),
                    stage_position_m: a.stage_position_m.zip(b.stage_position_m).map(|(a, b)| mix(a, b)),
                };
            }
            event = self.take(&between).event.or(event);
        }
        event
    }

    /// As if new.
    fn begin(&mut self) {
        self.restart();
        for state in &mut self.states {
            state.monitor = self.monitor.start();
        }
    }

    /// Forgets everything but the settings, the noise of air and cut, and that chatter was told: whether it
    /// goes on is not known before it can be heard again.
    pub fn restart(&mut self) {
        (self.since_restart, self.out_of_reach) = (0, false);
        self.observers.restart();
        if let Some(beside) = &mut self.beside {
            beside.restart();
        }
        for state in &mut self.states {
            state.apart = None;
            self.monitor.resume(&mut state.monitor);
            state.flags = Validity::SETTLING;
            state.stand = Stand::default();
        }
        if let Some(margins) = &mut self.margins {
            margins.restart();
        }
        self.cutting = CutWatch::default();
        self.spectrum_state = self.spectrum.start();
        self.clean_samples = 0;
        self.agreement_state = AgreementState::default();
        self.agreement = agree(&mut AgreementState::default(), 0.0, std::iter::empty());
    }

    fn take(&mut self, sample: &ServoSample) -> StepOutput {
        let mut forces = [ForceEstimate { force_n: 0.0, flags: Validity::VALID }; MAX_AXES];
        let channels = &self.channels;
        let motion = |axis: usize| channels[axis].motion(axis, sample);
        let period_s = self.settings.sample_rate.period_s();
        let mut turret_stands = true;
        for (axis, (channel, state)) in channels.iter().zip(&mut self.states).enumerate() {
            let (moved, of_turret) = (motion(axis), channel.pushed != 0.0);
            let tells = of_turret && state.stand.step(moved, period_s);
            turret_stands &= tells || !of_turret;
            self.monitor.listen_to_mean(&mut state.monitor, tells);
        }
        let estimates = self.observers.step(motion);
        forces.copy_from_slice(&estimates[..MAX_AXES]);
        if let Some(beside) = &mut self.beside {
            let others = beside.step(motion);
            for (axis, (state, force)) in self.states.iter_mut().zip(&mut forces).enumerate() {
                let (Some(one), Some(other)) = (self.observers.axis(axis), beside.axis(axis)) else {
                    continue;
                };
                let (pair, rate) = ([one.properties(), other.properties()], self.settings.sample_rate);
                let apart = state.apart.get_or_insert_with(|| Disagreement::new(pair, rate));
                if !apart.fits(pair) {
                    apart.begin(pair, rate);
                }
                force.flags |= apart.step(*force, others[axis]);
            }
        }
        let conditions = self.conditions(sample);
        self.listen(sample.t_s, forces, turret_stands, &conditions)
    }

    fn listen(
        &mut self,
        t_s: f64,
        mut forces: [ForceEstimate; MAX_AXES],
        turret_stands: bool,
        conditions: &CutConditions,
    ) -> StepOutput {
        self.clean_samples += 1;
        for force in forces.iter_mut().filter(|f| !f.force_n.is_finite()) {
            // Finite samples lead here only from a keyframe that was damaged: not heard, not acted on.
            *force = ForceEstimate { force_n: 0.0, flags: Validity::SETTLING | Validity::SIGNAL_MISSING };
        }
        self.since_restart += 1;
        let cutting = conditions.cutting.or(self.cutting.in_cut());
        let conditions = &CutConditions { cutting, chatter: self.declared, ..*conditions };
        let pitch_rad = conditions.pitch_difference_rad.or(self.settings.stated_pitch_rad);
        let (mut heard, mut away_n) = (None, 0.0);
        for (index, (channel, state)) in self.channels.iter().zip(&mut self.states).enumerate() {
            self.row[index] = forces[index].force_n;
            state.flags = forces[index].flags;
            if !channel.watch || forces[index].flags.contains(Validity::SETTLING) {
                continue;
            }
            let (force_n, speed_rpm) = (forces[index].force_n, conditions.spindle_speed_rpm);
            away_n += channel.pushed * force_n;
            self.monitor.follow_pitch(&mut state.monitor, pitch_rad);
            if let Some(event) = self.monitor.step(&mut state.monitor, force_n, speed_rpm) {
                heard = Some((index, event));
            }
            if let Some(margins) = &mut self.margins {
                margins.step(index, force_n, conditions);
            }
        }
        let spectrum_updated = self.spectrum.step(&mut self.spectrum_state, &self.row);
        // Between two decisions of the monitors there is nothing new to agree on.
        let decides = self.monitor.decision_samples() as u64;
        if heard.is_some() || self.clean_samples.is_multiple_of(decides) {
            self.agreement = self.ask_all(t_s);
        }
        let chatter = self.agreement;
        let event = self.machine_event(&chatter, heard);
        self.cutting.step(
            away_n,
            turret_stands,
            self.settings.sample_rate.period_s(),
            event.as_ref().map(|(_, event)| event),
        );
        let margin_warning = self.margins.as_mut().and_then(Margins::take_warning);
        let margin_warning = margin_warning.filter(|warning| !self.is_deaf(warning.axis));
        StepOutput { t_s, forces, chatter, event, margin_warning, fault: None, spectrum_updated }
    }

    /// Onset when the first axis is sure, end when the last has fallen quiet; the rest as it comes.
    fn machine_event(
        &mut self,
        now: &Agreement,
        heard: Option<(usize, ChatterEvent)>,
    ) -> Option<(usize, ChatterEvent)> {
        let chatter = now.phase == Phase::Chatter;
        if chatter && !self.declared {
            self.declared = true;
            let line = Line {
                frequency_hz: now.frequency_hz.unwrap_or(0.0),
                power_n2: now.power_n2,
                growth_1_s: now.growth_1_s.unwrap_or(0.0),
                contrast: self.monitor.output(&self.states[now.leading_axis].monitor).contrast,
            };
            return match heard {
                Some((axis, ChatterEvent::Onset(line))) => Some((axis, ChatterEvent::Onset(line))),
                _ => Some((now.leading_axis, ChatterEvent::Onset(line))),
            };
        }
        let known_again = self.since_restart as f64 > UNKNOWN_S * self.settings.sample_rate.hz();
        if !chatter && self.declared && known_again {
            self.declared = false;
            return Some((now.leading_axis, ChatterEvent::End));
        }
        heard.filter(|(axis, event)| match event {
            ChatterEvent::Onset(_) | ChatterEvent::End => false,
            ChatterEvent::Hop { .. } => *axis == now.leading_axis,
            ChatterEvent::Dismissed(_) | ChatterEvent::CutChanged => true,
        })
    }

    /// What the axes say together.
    #[must_use]
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    /// Standard deviation of the difference of the two estimators of an axis over the last second, N; `None`
    /// where only one runs or one of them has not settled.
    #[must_use]
    pub fn disagreement_n(&self, axis: usize) -> Option<f64> {
        self.states.get(axis)?.apart.as_ref()?.deviation_n()
    }

    /// The estimator of one axis that is acted on.
    #[must_use]
    pub fn observer(&self, axis: usize) -> Option<&AxisObserver> {
        self.observers.axis(axis)
    }

    /// What speaks against the newest force estimate of one axis; also that nothing of the watched band lies
    /// where its method is right.
    #[must_use]
    pub fn force_flags(&self, axis: usize) -> Validity {
        let deaf = self.observer(axis).is_some_and(|observer| !observer.reaches(self.band_hz()));
        let flags = self.states.get(axis).map_or(Validity::SIGNAL_MISSING, |state| state.flags);
        flags | Validity::when(deaf, Validity::FORCE_ABOVE_BAND)
    }

    /// Whether no flag of the newest force estimate of one axis forbids acting on it, and the band in which
    /// the bar can chatter is one that is heard.
    #[must_use]
    pub fn axis_may_act(&self, axis: usize) -> bool {
        !self.out_of_reach && self.states.get(axis).is_some_and(|state| state.flags.may_act())
    }

    /// Whether no flag forbids acting on any watched axis.
    #[must_use]
    pub fn may_act(&self) -> bool {
        let pairs = self.channels.iter().zip(&self.states);
        !self.out_of_reach
            && pairs.filter(|(channel, _)| channel.watch).all(|(_, state)| state.flags.may_act())
    }

    fn ask_all(&mut self, t_s: f64) -> Agreement {
        let (channels, states) = (&self.channels, &self.states);
        let watched = channels.iter().zip(states).enumerate().filter(|(_, (channel, _))| channel.watch);
        let outputs = watched.map(|(index, (_, state))| (index, self.monitor.output(&state.monitor)));
        agree(&mut self.agreement_state, t_s, outputs)
    }
}
