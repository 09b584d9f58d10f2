//! What the pipeline thread shows twenty times a second.

use super::Engine;
use crate::chatter::{ChatterEvent, Line, Phase};
use crate::force::observers::AxisObserver;
use crate::force::validity::Validity;
use crate::pipeline::{Deaf, DeafReason, Margin, MarginReading, MarginWarning, Pipeline, StepOutput};
use crate::sample::MAX_AXES;
use crate::service::clock;
use crate::service::hub::{ForceFrame, View};
use crate::service::live::{
    AxisView, ChatterView, InterlockView, LiveState, Mode, PitchView, SourceView, SpectrumView,
};
use crate::telemetry::{Event, EventKind, Metrics};
use crate::transport::wire::{
    INTERLOCK_NAMES, TURRET_EXPIRED, TURRET_LIMITED, TURRET_MOVING, TURRET_REACHED, TURRET_REFUSED,
};
use std::time::{Duration, Instant};

/// Slices of a picture's force: 5 ms each.
const SLICES: usize = 10;

/// Force of one axis since the last picture.
#[derive(Debug, Clone, Copy)]
struct Gathered {
    sum: f64,
    squares: f64,
    slice: [f32; 2],
    slices: [[f32; 2]; SLICES],
}

impl Gathered {
    const EMPTY: Self = Self { sum: 0.0, squares: 0.0, slice: Self::NOTHING, slices: [[0.0; 2]; SLICES] };
    const NOTHING: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

    /// Of `count` samples.
    fn mean_n(&self, count: u64) -> f64 {
        self.sum / count.max(1) as f64
    }
}

/// What is gathered between two pictures.
pub(super) struct Picture {
    due: Instant,
    count: u64,
    full_slices: usize,
    in_slice: u32,
    axes: [Gathered; MAX_AXES],
    t_s: f64,
    phase: Option<(Phase, i64)>,
    pub(super) refused_stream: Option<u64>,
}

impl Picture {
    pub(super) fn new(now: Instant) -> Self {
        Self {
            due: now,
            count: 0,
            full_slices: 0,
            in_slice: 0,
            axes: [Gathered::EMPTY; MAX_AXES],
            t_s: 0.0,
            phase: None,
            refused_stream: None,
        }
    }

    pub(super) fn is_due(&mut self, now: Instant, every: Duration) -> bool {
        let due = now >= self.due;
        if due {
            self.due = (self.due + every).max(now);
        }
        due
    }

    pub(super) fn forget(&mut self) {
        *self = Self { refused_stream: self.refused_stream, ..Self::new(self.due) };
    }

    /// Takes in what one sample led to.
    #[allow(clippy::cast_possible_truncation)]
    pub(super) fn add(&mut self, output: &StepOutput, axes: usize) {
        self.count += 1;
        self.t_s = output.t_s;
        for (gathered, force) in self.axes.iter_mut().zip(&output.forces).take(axes) {
            let force_n = force.force_n;
            gathered.sum += force_n;
            gathered.squares += force_n * force_n;
            gathered.slice[0] = gathered.slice[0].min(force_n as f32);
            gathered.slice[1] = gathered.slice[1].max(force_n as f32);
        }
        self.in_slice += 1;
        // 45 samples are 5 ms at 9 kHz; at other rates a slice is a little shorter or longer.
        if self.in_slice >= 45 {
            self.close_slice(axes);
        }
        let phase = output.chatter.phase;
        if self.phase.is_none_or(|(p, _)| p != phase) {
            self.phase = Some((phase, clock::wall_ns()));
        }
    }

    fn close_slice(&mut self, axes: usize) {
        self.in_slice = 0;
        let place = self.full_slices.min(SLICES - 1);
        for gathered in self.axes.iter_mut().take(axes) {
            if self.full_slices >= SLICES {
                gathered.slices.rotate_left(1);
            }
            gathered.slices[place] = gathered.slice;
            gathered.slice = Gathered::NOTHING;
        }
        self.full_slices = (self.full_slices + 1).min(SLICES);
    }

    /// For drawing: nothing of an axis that nobody estimates, and a force whose mean is not known about that
    /// mean.
    #[allow(clippy::cast_possible_truncation)]
    fn force_frame(&self, axes: &[AxisView], rate_hz: f64) -> ForceFrame {
        let line = |(gathered, axis): (&Gathered, &AxisView)| {
            let unknown_n = if axis.force_mean_n.is_none() { gathered.mean_n(self.count) } else { 0.0 };
            let shown = gathered.slices.iter().take(self.full_slices).filter(|_| axis.watched);
            shown.map(|slice| slice.map(|force_n| force_n - unknown_n as f32)).collect()
        };
        let lines = self.axes.iter().zip(axes).map(line);
        ForceFrame { t_s: self.t_s, slice_s: 45.0 / rate_hz, axes: lines.collect() }
    }

    fn axis_view(&self, index: usize, name: &str) -> AxisView {
        let gathered = &self.axes[index.min(MAX_AXES - 1)];
        let n = (self.count.max(1)) as f64;
        let mean = gathered.mean_n(self.count);
        let peak = gathered.slices.iter().take(self.full_slices).fold(0.0_f64, |most, s| {
            most.max((f64::from(s[1]) - mean).abs()).max((f64::from(s[0]) - mean).abs())
        });
        AxisView {
            name: name.to_owned(),
            force_mean_n: Some(mean),
            force_deviation_n: Some((gathered.squares / n - mean * mean).max(0.0).sqrt()),
            force_peak_n: Some(peak),
            ..AxisView::default()
        }
    }

    fn begin_next(&mut self) {
        for gathered in &mut self.axes {
            (gathered.sum, gathered.squares) = (0.0, 0.0);
        }
        (self.count, self.full_slices) = (0, 0);
    }
}

/// Word for what is heard, and why it is silent.
fn heard_words(pipeline: &Pipeline) -> (&'static str, Option<&'static str>) {
    let phase = pipeline.agreement().phase;
    match (phase, pipeline.deaf()) {
        (Phase::Chatter, _) | (Phase::Learning, None) => (phase.name(), None),
        (_, Some(deaf)) => ("deaf", Some(deaf.name())),
        (Phase::Quiet | Phase::Suspected, None) => (phase.name(), Some(pipeline.reason().name())),
    }
}

/// Word for a turret's state.
fn turret_word(state: Option<u32>) -> &'static str {
    match state {
        Some(TURRET_REACHED) => "reached",
        Some(TURRET_MOVING) => "moving",
        Some(TURRET_REFUSED) => "refused",
        Some(TURRET_LIMITED) => "limited",
        Some(TURRET_EXPIRED) => "expired",
        _ => "unknown",
    }
}

/// The line that a chatter event names.
pub(super) fn line_of(event: &ChatterEvent) -> Option<Line> {
    match event {
        ChatterEvent::Onset(line) => Some(*line),
        _ => None,
    }
}

/// Kind and sentence of what a sample led to, if it is worth an event.
pub(super) fn event_of(output: &StepOutput) -> Option<(EventKind, String)> {
    let (_, event) = output.event?;
    match event {
        ChatterEvent::Onset(line) => {
            Some((EventKind::ChatterOnset, format!("chatter began at {:.1} Hz", line.frequency_hz)))
        }
        ChatterEvent::End => Some((EventKind::ChatterEnd, "chatter ended".to_owned())),
        ChatterEvent::Dismissed(_) | ChatterEvent::CutChanged | ChatterEvent::Hop { .. } => None,
    }
}

/// Puts the margin of an axis in its view.
fn show_margin(axis: &mut AxisView, reading: Option<&MarginReading>) {
    let margin = reading.and_then(MarginReading::margin);
    axis.stability_margin_1_s = margin.map(|m| m.margin_1_s);
    axis.stability_margin_lo_1_s = margin.map(|m| m.lo_1_s);
    axis.stability_margin_hi_1_s = margin.map(|m| m.hi_1_s);
    reading.map_or("off", |r| r.word()).clone_into(&mut axis.stability_margin_state);
}

/// The event of a margin that begins to run out.
pub(super) fn margin_event(warning: &MarginWarning, axis: Option<&String>, t_s: f64) -> Event {
    let Margin { margin_1_s, lo_1_s, hi_1_s, frequency_hz } = warning.margin;
    let text = format!(
        "the stability margin runs out: {margin_1_s:.1} 1/s ({lo_1_s:.1} to {hi_1_s:.1}) at \
         {frequency_hz:.1} Hz"
    );
    let mut event = Event::new(EventKind::MarginWarning, clock::wall_ns(), text);
    (event.t_s, event.axis, event.frequency_hz) = (Some(t_s), axis.cloned(), Some(frequency_hz));
    event
}

impl Engine {
    /// The picture now.
    pub(super) fn view(&mut self, now: Instant) -> View {
        self.setup.commissioning.hear_now(self.heard_now());
        let mut state = LiveState {
            mode: self.mode,
            mode_revision: self.mode_revision,
            mode_reason: self.mode_reason.clone(),
            fault: self.fault.clone(),
            turret_held: self.held,
            source: self.source_view(now),
            interlocks: self.interlock_views(),
            pitch: self.pitch_view(now),
            ..LiveState::default()
        };
        let (mut force, mut spectrum) = (ForceFrame::default(), SpectrumView::default());
        if let Some(stream) = &self.stream {
            let chatter = stream.pipeline().agreement();
            state.axes =
                stream.axes().iter().enumerate().map(|(i, name)| self.picture.axis_view(i, name)).collect();
            for (index, axis) in state.axes.iter_mut().enumerate() {
                let heard = stream.pipeline().axis_output(index);
                axis.line_hz = heard.and_then(|o| o.frequency_hz);
                show_margin(axis, stream.pipeline().margin_reading(index));
                let stated = stream.pipeline().observer(index).map(AxisObserver::properties);
                axis.noise_floor_n = stated.map(|p| p.noise_floor_n);
                axis.force_delay_s = stated.map(|p| p.delay_s);
                axis.usable_band_hz = stated.map(|p| p.usable_band_hz);
                axis.usable_above_hz = stated.and_then(|p| p.usable_above_hz);
                let flags = stream.pipeline().force_flags(index);
                axis.force_flags = flags.to_string();
                axis.watched = self.setup.config.watch.contains(&axis.name);
                // What nobody estimates is not 0, and what cannot be observed is no number.
                if !axis.watched {
                    axis.force_flags = "not_watched".to_owned();
                    (axis.force_deviation_n, axis.force_peak_n) = (None, None);
                }
                if !axis.watched || flags.shares(Validity::MEAN_NOT_OBSERVABLE | Validity::BELOW_FRICTION) {
                    axis.force_mean_n = None;
                }
                axis.disagreement_n = stream.pipeline().disagreement_n(index);
            }
            self.offsets(now, &mut state.axes);
            let phase = self.picture.phase.unwrap_or((chatter.phase, clock::wall_ns()));
            let (word, reason) = heard_words(stream.pipeline());
            state.chatter = ChatterView {
                state: word.to_owned(),
                reason: reason.map(str::to_owned),
                frequency_hz: chatter.frequency_hz,
                power_n2: Some(chatter.power_n2),
                since: Some(clock::rfc3339(phase.1)),
                band_hz: Some(stream.band_hz()),
            };
            let [first_hz, step_hz] = stream.pipeline().spectrum_grid_hz();
            let amplitude_n = stream.pipeline().amplitudes_n(chatter.leading_axis).collect();
            spectrum = SpectrumView { first_hz, step_hz, amplitude_n, t_s: self.picture.t_s };
            force = self.picture.force_frame(&state.axes, stream.sample_rate().hz());
        } else {
            state.chatter.state = "learning".to_owned();
        }
        self.gauge(&state, now);
        self.picture.begin_next();
        View { state, force, spectrum }
    }

    fn source_view(&self, now: Instant) -> SourceView {
        let last = self.last_arrival;
        let connected =
            last.is_some_and(|(at, _)| now.duration_since(at) <= super::SILENCE) && self.stream.is_some();
        let newest = self.stream.as_ref().and_then(|s| s.newest.as_ref());
        let totals = self.stream.as_ref().map(|s| s.totals).unwrap_or_default();
        SourceView {
            connected,
            last_sample_at: last.map(|(_, wall_ns)| clock::rfc3339(wall_ns)),
            last_sample_t_s: newest.map(|p| p.t_ns as f64 * 1e-9),
            sample_rate_hz: self.stream.as_ref().map(|s| s.sample_rate().hz()),
            spindle_speed_rpm: newest.map(|p| p.spindle_speed_rpm),
            samples: totals.samples,
            lost: totals.lost,
            rejected: totals.rejected,
        }
    }

    fn interlock_views(&self) -> Vec<InterlockView> {
        let view = |(bit, name): (usize, &&str)| InterlockView {
            name: (*name).to_owned(),
            open: self.interlocks_open >> bit & 1 == 1,
        };
        INTERLOCK_NAMES.iter().enumerate().map(view).collect()
    }

    fn pitch_view(&self, now: Instant) -> PitchView {
        let status = self.fresh_status(now);
        let acting = self.acting.as_ref();
        let latest = acting.and_then(|a| a.latest).filter(|_| self.mode != Mode::Observe);
        PitchView {
            commanded_rad: latest.map_or(0.0, |c| c.pitch_difference_rad),
            reported_rad: acting.zip(status).map(|(a, s)| a.pitch_rad(&s.offset_m)),
            optimum_rad: latest.map(|c| c.requested_pitch_rad),
            limit_rad: self.setup.config.turret.largest_pitch_difference_rad,
            limited: latest
                .is_some_and(|c| c.pitch_difference_rad.abs() < 0.999 * c.requested_pitch_rad.abs()),
            turret: turret_word(status.map(|s| s.state)).to_owned(),
            unavailable: self.no_pitch.clone(),
            hold_reason: acting.and_then(|a| a.hold).map(str::to_owned),
            before_chatter: acting.is_some_and(|a| a.is_before_chatter(self.mode)),
            waits: acting.and_then(|a| a.waits).map(str::to_owned),
            advised_speed_rpm: acting
                .and_then(|a| a.advised_speed_rpm().1)
                .filter(|_| self.mode != Mode::Observe),
        }
    }

    fn offsets(&self, now: Instant, axes: &mut [AxisView]) {
        let latest = self.acting.as_ref().and_then(|a| a.latest).filter(|_| self.mode != Mode::Observe);
        let status = self.fresh_status(now);
        for (index, axis) in axes.iter_mut().enumerate().take(MAX_AXES) {
            axis.offset_commanded_m = latest.map_or(0.0, |c| c.offsets_m[index]);
            axis.offset_reported_m = status.map(|s| s.offset_m[index]);
        }
    }

    fn gauge(&self, state: &LiveState, now: Instant) {
        let metrics = &self.setup.metrics;
        metrics.stage_up.with_label_values(&["turret"]).set(i64::from(self.fresh_status(now).is_some()));
        for interlock in &state.interlocks {
            metrics.interlock_open.with_label_values(&[&interlock.name]).set(i64::from(interlock.open));
        }
        let chatter = &state.chatter;
        metrics.chatter_active.set(i64::from(chatter.state == "chatter"));
        for reason in Deaf::ALL.map(Deaf::name) {
            let deaf = chatter.state == "deaf" && chatter.reason.as_deref() == Some(reason);
            Metrics::show(&metrics.chatter_deaf, &[reason], deaf.then_some(1.0));
        }
        metrics.chatter_frequency_valid.set(i64::from(chatter.frequency_hz.is_some()));
        Metrics::show(&metrics.chatter_frequency_hertz, &[], chatter.frequency_hz);
        metrics.chatter_power_newtons_squared.set(chatter.power_n2.unwrap_or_default());
        for (name, apart_n) in state.axes.iter().filter_map(|a| Some((&a.name, a.disagreement_n?))) {
            metrics.force_disagreement_newtons.with_label_values(&[name]).set(apart_n);
        }
        for axis in &state.axes {
            let ends = axis.usable_band_hz.map(|band| ["lower", "upper"].into_iter().zip(band));
            for (end, hz) in ends.into_iter().flatten() {
                metrics.force_usable_band_hertz.with_label_values(&[axis.name.as_str(), end]).set(hz);
            }
            if let Some(floor_n) = axis.noise_floor_n {
                metrics.force_noise_floor_newtons.with_label_values(&[axis.name.as_str()]).set(floor_n);
            }
        }
        self.gauge_margins(state);
        if let Some([low, high]) = chatter.band_hz {
            metrics.predicted_band_hertz.with_label_values(&["lower"]).set(low);
            metrics.predicted_band_hertz.with_label_values(&["upper"]).set(high);
        }
        let pitch = &state.pitch;
        metrics.pitch_difference_radians.with_label_values(&["commanded"]).set(pitch.commanded_rad);
        metrics
            .pitch_difference_radians
            .with_label_values(&["reported"])
            .set(pitch.reported_rad.unwrap_or_default());
        metrics.pitch_reported_valid.set(i64::from(pitch.reported_rad.is_some()));
        metrics.limit_active.with_label_values(&["rate"]).set(i64::from(pitch.limited));
        let outside = pitch.hold_reason.as_deref() == Some("outside_limits");
        metrics.limit_active.with_label_values(&["pitch"]).set(i64::from(outside));
        let arrived_s = self.last_arrival.map(|(_, wall_ns)| wall_ns as f64 * 1e-9);
        Metrics::show(&metrics.last_sample_timestamp_seconds, &[], arrived_s);
    }

    fn gauge_margins(&self, state: &LiveState) {
        let metrics = &self.setup.metrics;
        for axis in &state.axes {
            let name = axis.name.as_str();
            let bounds = [
                ("estimate", axis.stability_margin_1_s),
                ("lower", axis.stability_margin_lo_1_s),
                ("upper", axis.stability_margin_hi_1_s),
            ];
            for (bound, value) in bounds {
                Metrics::show(&metrics.stability_margin_per_second, &[name, bound], value);
            }
            let known = i64::from(axis.stability_margin_1_s.is_some());
            metrics.stability_margin_known.with_label_values(&[name]).set(known);
            // The reason in force alone has a series: six axes would have thirty-six.
            for reason in DeafReason::ALL.map(DeafReason::name) {
                let deaf = (axis.stability_margin_state == reason).then_some(1.0);
                Metrics::show(&metrics.stability_margin_deaf, &[name, reason], deaf);
            }
        }
    }
}
