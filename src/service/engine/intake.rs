//! One stream of samples: from wire to pipeline, with every loss and refusal counted.

use super::stamps::{Judged, Reject, Stamps};
use crate::config::service::ServiceConfig;
use crate::pipeline::{Pipeline, StepOutput, StreamFault};
use crate::sample::{MAX_AXES, SampleError, ServoSample};
use crate::service::black_box::BlackBox;
use crate::service::clock;
use crate::telemetry::{Event, EventKind, Metrics};
use crate::transport::wire::{AXIS_NAME_BYTES, ServoBatch, ServoPoint, axis_name_text};
use crate::units::{SampleRate, counted};
use prometheus::IntCounter;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Faults of a stream are told at most this often, and half as often each time while they go on, down to once
/// in [`LONGEST_PAUSE`]; in between they are counted.
const TELL_EVERY: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// Counters of one axis, looked up once.
struct AxisCounters {
    samples: IntCounter,
    lost: IntCounter,
    gaps: IntCounter,
    /// In the order of [`Reject::OF_AN_AXIS`].
    rejected: [IntCounter; Reject::OF_AN_AXIS.len()],
}

/// A stream whose layout is known.
pub(super) struct Stream {
    id: u64,
    names: Arc<[String]>,
    /// The names as they travel.
    travelled: [[u8; AXIS_NAME_BYTES]; MAX_AXES],
    rate: SampleRate,
    pipeline: Pipeline,
    counters: Vec<AxisCounters>,
    pub(super) faults: Faults,
    pub(super) totals: Totals,
    pub(super) newest: Option<ServoPoint>,
    /// Pitch angle difference as the turret reported it last, rad.
    pub(super) turret_rad: Option<f64>,
    /// Tools from the chuck then, where an axis tells it, m.
    pub(super) tool_position_m: Option<f64>,
    /// Samples taken since the last one that was refused.
    usable: u64,
    stamps: Stamps,
    /// In the order of [`Reject::OF_THE_STREAM`].
    rejected: [IntCounter; Reject::OF_THE_STREAM.len()],
    /// Refused since the last one that was taken: they leave a gap, and are not lost.
    refused_here: u64,
    /// A batch that did not say how many it holds: what the next gap lacks was in it.
    uncounted: bool,
    /// The producer's counter or clock jumped: everything is to begin anew.
    pub(super) ended: bool,
}

/// Counts since the stream began.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Totals {
    pub(super) samples: u64,
    pub(super) lost: u64,
    pub(super) rejected: u64,
}

/// Faults that wait to be told.
#[derive(Debug, Default)]
pub(super) struct Faults {
    lost: u64,
    gaps: u64,
    /// In the order of [`Reject::ALL`].
    rejected: [u64; Reject::ALL.len()],
    t_s: f64,
    /// When the last event was, and how long none may follow.
    told: Option<(Instant, Duration)>,
}

impl Faults {
    /// One event for everything since the last one, when it is time.
    pub(super) fn event_due(&mut self, now: Instant) -> Option<Event> {
        let rejected: u64 = self.rejected.iter().sum();
        let quiet = self.lost == 0 && rejected == 0;
        if quiet || self.told.is_some_and(|(t, pause)| now.duration_since(t) < pause) {
            return None;
        }
        let pause = match self.told {
            Some((t, pause)) if now.duration_since(t) < 2 * pause => (2 * pause).min(LONGEST_PAUSE),
            _ => TELL_EVERY,
        };
        let (kind, text) = if self.lost > 0 {
            let text = format!("{} lost in {}", counted(self.lost, "sample"), counted(self.gaps, "gap"));
            (EventKind::DataGap, text)
        } else {
            let why = Reject::ALL.iter().zip(self.rejected).filter(|(_, count)| *count > 0);
            let why: Vec<String> =
                why.map(|(r, count)| format!("{count} {}", r.name().replace('_', " "))).collect();
            (EventKind::DataRejected, format!("{} refused: {}", counted(rejected, "sample"), why.join(", ")))
        };
        let event = Event { t_s: Some(self.t_s), ..Event::new(kind, clock::wall_ns(), text) };
        *self = Self { told: Some((now, pause)), ..Self::default() };
        Some(event)
    }
}

/// Names of the axes, rate and pipeline for what a batch announces. Errors: one line why it cannot be used.
fn designed(
    batch: &ServoBatch,
    config: &ServiceConfig,
) -> Result<(Vec<String>, SampleRate, Pipeline), String> {
    let count =
        batch.axes().ok_or_else(|| format!("{} axes in a batch; expected 1 to 6", batch.axis_count))?;
    let names: Vec<String> = batch.axis_names.iter().take(count).map(axis_name_text).collect();
    let rate = SampleRate::new(batch.sample_rate_hz).map_err(|e| e.to_string())?;
    let pipeline = Pipeline::new(config.pipeline_settings(rate, &names)).map_err(|e| e.to_string())?;
    Ok((names, rate, pipeline))
}

impl Stream {
    /// Designs the pipeline for what this batch announces. Errors: one line why it cannot be used.
    pub(super) fn begin(
        batch: &ServoBatch,
        config: &ServiceConfig,
        metrics: &Arc<Metrics>,
    ) -> Result<Self, String> {
        let (names, rate, pipeline) = designed(batch, config)?;
        let counters = names.iter().map(|axis| AxisCounters {
            samples: metrics.samples.with_label_values(&[axis]),
            lost: metrics.samples_lost.with_label_values(&[axis]),
            gaps: metrics.sample_gaps.with_label_values(&[axis]),
            rejected: Reject::OF_AN_AXIS
                .map(|r| metrics.samples_rejected.with_label_values(&[axis.as_str(), r.name()])),
        });
        let counters = counters.collect();
        let whole = |r: Reject| metrics.samples_rejected.with_label_values(&["all", r.name()]);
        Ok(Self {
            id: batch.stream,
            names: names.into(),
            travelled: batch.axis_names,
            rate,
            pipeline,
            counters,
            faults: Faults::default(),
            totals: Totals::default(),
            newest: None,
            turret_rad: None,
            tool_position_m: None,
            usable: 0,
            stamps: Stamps::new(rate),
            rejected: Reject::OF_THE_STREAM.map(whole),
            refused_here: 0,
            uncounted: false,
            ended: false,
        })
    }

    /// Whether a batch belongs to this stream.
    pub(super) fn carries(&self, batch: &ServoBatch) -> bool {
        let count = self.names.len();
        let same_axes = batch.axes() == Some(count) && batch.axis_names[..count] == self.travelled[..count];
        batch.stream == self.id && same_axes && batch.sample_rate_hz.to_bits() == self.rate.hz().to_bits()
    }

    /// Whether a sample's stamp goes on from those before; what does not is counted by its name.
    pub(super) fn believes(&mut self, point: &ServoPoint, now_s: f64) -> bool {
        // What follows in the batch that ended the stream is of the next one, which is not there yet.
        let judged = if self.ended { Judged::Anew } else { self.stamps.judge(point, now_s) };
        self.ended = judged == Judged::Anew;
        match judged {
            Judged::Good => true,
            Judged::Refused(why) => {
                self.refuse(why, None, point.t_ns);
                false
            }
            Judged::Anew => {
                self.refuse(Reject::ImplausibleStamp, None, point.t_ns);
                false
            }
        }
    }

    /// A batch that says that it holds no sample, or more than fit.
    pub(super) fn refuse_batch(&mut self, batch: &ServoBatch) {
        self.uncounted = true;
        self.refuse(Reject::BadCount, None, batch.points[0].t_ns);
    }

    /// Whether a batch says that it is of this stream and has another head: one wrong batch, not another
    /// machine, whose stream has another number.
    pub(super) fn disowns(&self, batch: &ServoBatch) -> bool {
        batch.stream == self.id && !self.carries(batch)
    }

    /// A batch whose head is wrong: none of its samples can be read.
    pub(super) fn refuse_layout(&mut self, batch: &ServoBatch) {
        let held = batch.used_points().len();
        self.uncounted |= held == 0;
        for point in batch.points.iter().take(held.max(1)) {
            self.refuse(Reject::BadLayout, None, point.t_ns);
        }
    }

    /// One sample whose stamp is believed. Nothing when it could not be read.
    pub(super) fn step(&mut self, point: &ServoPoint, black_box: &mut BlackBox) -> Option<StepOutput> {
        let sample = match point.to_sample(self.names.len()) {
            Ok(sample) => ServoSample { pitch_difference_rad: self.turret_rad, ..sample },
            Err(error) => {
                self.refuse(Reject::NotFinite, axis_of(error), point.t_ns);
                return None;
            }
        };
        black_box.before(&sample, &self.pipeline);
        let output = self.pipeline.step(&sample);
        match output.fault {
            Some(StreamFault::Repeated) => {
                self.refuse(Reject::Duplicate, None, point.t_ns);
                return None;
            }
            Some(StreamFault::NotFinite(error)) => {
                self.refuse(Reject::NotFinite, axis_of(error), point.t_ns);
                return None;
            }
            Some(StreamFault::Gap { lost }) => self.count_gap(lost, point),
            None => {}
        }
        self.totals.samples += 1;
        self.usable += 1;
        self.refused_here = 0;
        self.newest = Some(*point);
        self.tool_position_m = self.pipeline.tool_position_m(&sample);
        black_box.push(&sample, (&output, self.names.len()));
        Some(output)
    }

    /// What never came: by number; where the time tells another tale, not more than it had room for between
    /// the two that came. Not what came and was refused.
    fn count_gap(&mut self, lost: u64, point: &ServoPoint) {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let by_time = |before: ServoPoint| {
            let passed_s = point.t_ns.saturating_sub(before.t_ns) as f64 * 1e-9;
            ((passed_s * self.rate.hz()).round() as u64).saturating_sub(1)
        };
        let contradicted = self.newest.filter(|before| !self.stamps.agree(before, point));
        let lost = lost.min(contradicted.map_or(lost, by_time)).saturating_sub(self.refused_here);
        if std::mem::take(&mut self.uncounted) {
            self.count_refused(Reject::BadCount, lost);
            return;
        }
        if lost == 0 {
            return;
        }
        self.totals.lost += lost;
        self.faults.lost += lost;
        self.faults.gaps += 1;
        self.faults.t_s = point.t_ns as f64 * 1e-9;
        for counter in &self.counters {
            counter.lost.inc_by(lost);
            counter.gaps.inc();
        }
    }

    /// Counts what [`Self::step`] took, a batch at a time.
    pub(super) fn count_taken(&self, samples: u64) {
        self.counters.iter().for_each(|c| c.samples.inc_by(samples));
    }

    /// What is refused is missing from the detector's window, whatever the reason. `axis`: the one at fault.
    fn refuse(&mut self, why: Reject, axis: Option<usize>, t_ns: u64) {
        self.usable = 0;
        self.totals.rejected += 1;
        // A sample that came twice leaves no gap.
        self.refused_here += u64::from(why != Reject::Duplicate);
        // A stamp that nobody believes is no time either.
        self.faults.t_s = self.newest.map_or(t_ns, |n| n.t_ns) as f64 * 1e-9;
        if let Some(count) = self.faults.rejected.get_mut(why as usize) {
            *count += 1;
        }
        if let Some(counter) = self.of_the_stream(why) {
            counter.inc();
            return;
        }
        let concerned = |index: &usize| axis.is_none_or(|axis| axis == *index);
        for (_, counter) in self.counters.iter().enumerate().filter(|(index, _)| concerned(index)) {
            if let Some(rejected) = counter.rejected.get(why as usize) {
                rejected.inc();
            }
        }
    }

    /// The counter of a reason that concerns no axis alone.
    fn of_the_stream(&self, why: Reject) -> Option<&IntCounter> {
        let place = Reject::OF_THE_STREAM.iter().position(|r| *r == why)?;
        self.rejected.get(place)
    }

    fn count_refused(&mut self, why: Reject, count: u64) {
        self.totals.rejected += count;
        if let Some(told) = self.faults.rejected.get_mut(why as usize) {
            *told += count;
        }
        if let Some(counter) = self.of_the_stream(why) {
            counter.inc_by(count);
        }
    }

    /// Samples in a row without one lost or refused.
    pub(super) fn usable_run(&self) -> u64 {
        self.usable.min(self.pipeline.clean_samples())
    }

    pub(super) fn id(&self) -> u64 {
        self.id
    }

    pub(super) fn axes(&self) -> &[String] {
        &self.names
    }

    pub(super) fn shared_axes(&self) -> Arc<[String]> {
        Arc::clone(&self.names)
    }

    pub(super) fn sample_rate(&self) -> SampleRate {
        self.rate
    }

    pub(super) fn pipeline(&self) -> &Pipeline {
        &self.pipeline
    }

    pub(super) fn band_hz(&self) -> [f64; 2] {
        self.pipeline.band_hz()
    }

    pub(super) fn describe(&self) -> String {
        format!("axes {} at {} Hz", self.names.join(", "), self.rate.hz())
    }
}

/// The axis whose signal is no number; nothing where it is not one axis'.
fn axis_of(error: SampleError) -> Option<usize> {
    match error {
        SampleError::AxisNotFinite { axis } => Some(axis),
        SampleError::HeadNotFinite => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_that_go_on_are_told_less_often_and_counted_in_full() {
        let mut faults = Faults::default();
        let began = clock::now();
        let mut told = Vec::new();
        for tenth in 0..6000_u64 {
            faults.rejected[1] += 1;
            if let Some(event) = faults.event_due(began + Duration::from_millis(100 * tenth)) {
                told.push((tenth, event.text));
            }
        }
        assert_eq!(told[..4].iter().map(|t| t.0).collect::<Vec<_>>(), [0, 10, 30, 70]);
        assert!(told.len() < 16, "{} events in ten minutes", told.len());
        assert!(told[1].1.starts_with("10 samples refused"), "{}", told[1].1);
        // After a quiet time the next fault is told at once, and often again.
        faults = Faults { told: faults.told, rejected: [1, 0, 0, 0, 0, 0], ..Faults::default() };
        let later = began + Duration::from_secs(1000);
        assert!(faults.event_due(later).is_some());
        faults.rejected[0] = 1;
        assert!(faults.event_due(later + Duration::from_millis(1100)).is_some());
    }
}
