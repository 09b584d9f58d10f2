//! The black box: the last seconds of samples, kept in memory, saved around every event.
//!
//! Samples fill chunks of a second. Each begins with a keyframe of the pipeline and carries what
//! the pipeline decided, so that a saved recording can be replayed to the same bytes. A full chunk is shared,
//! not copied: saving hands out references, so the pipeline thread pays the same whether anything is saved.

use crate::chatter::ChatterEvent;
use crate::keyframe::Digest;
use crate::pipeline::{Pipeline, StepOutput};
use crate::sample::{AxisSample, MAX_AXES, ServoSample, follows};
use std::collections::VecDeque;
use std::sync::Arc;

/// Samples of one chunk at 9 kHz: a second. Shorter ones would need more memory for their keyframes (270 KB).
const CHUNK: usize = 9000;
/// Chunks beside those that are kept: what fills while a recording is written takes them, and what saves cut
/// short.
const SPARE: usize = 3;
/// Events of one chunk that find room without asking for memory.
const HEARD: usize = 16;

/// What the pipeline said at one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heard {
    pub(super) t_s: f64,
    pub(super) axis: usize,
    pub(super) event: ChatterEvent,
    pub(super) spindle_speed_rpm: f64,
}

/// Words of a sample beside its axes, and of one axis.
const HEAD_WORDS: usize = 8;
const AXIS_WORDS: usize = 3;

/// Samples of a stream with a known number of axes, one after the other, without the places that no axis has.
/// Every signal is finite, so NaN stands for one that was not measured.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Samples {
    words: Vec<u64>,
    axes: usize,
}

impl Samples {
    fn with_room(count: usize) -> Self {
        Self { words: Vec::with_capacity(count * (HEAD_WORDS + AXIS_WORDS * MAX_AXES)), axes: 0 }
    }

    fn stride(&self) -> usize {
        HEAD_WORDS + AXIS_WORDS * self.axes
    }

    /// All samples of one run have the same number of axes.
    fn push(&mut self, sample: &ServoSample, axes: usize) {
        debug_assert!(self.is_empty() || self.axes == axes);
        self.axes = axes;
        let accel = sample.accel_m_s2.unwrap_or([f64::NAN; 3]);
        let pitch_rad = sample.pitch_difference_rad.unwrap_or(f64::NAN);
        let head = [sample.t_s, sample.spindle_angle_rad, sample.spindle_speed_rpm, pitch_rad];
        self.words.push(sample.sequence);
        self.words.extend(head.iter().chain(&accel).map(|v| v.to_bits()));
        for axis in sample.axes.iter().take(axes) {
            let stage_m = axis.stage_position_m.unwrap_or(f64::NAN);
            self.words.extend([axis.current_ref_a, axis.motor_angle_rad, stage_m].map(f64::to_bits));
        }
    }

    fn unpack(words: &[u64]) -> ServoSample {
        let value = |k: usize| f64::from_bits(words[k]);
        let measured = |v: f64| (!v.is_nan()).then_some(v);
        let mut axes = [AxisSample::default(); MAX_AXES];
        for (axis, place) in axes.iter_mut().zip((HEAD_WORDS..words.len()).step_by(AXIS_WORDS)) {
            *axis = AxisSample {
                current_ref_a: value(place),
                motor_angle_rad: value(place + 1),
                stage_position_m: measured(value(place + 2)),
            };
        }
        ServoSample {
            sequence: words[0],
            t_s: value(1),
            axes,
            spindle_angle_rad: value(2),
            spindle_speed_rpm: value(3),
            pitch_difference_rad: measured(value(4)),
            accel_m_s2: measured(value(5)).map(|x| [x, value(6), value(7)]),
        }
    }

    /// Oldest first.
    pub(super) fn iter(&self) -> impl DoubleEndedIterator<Item = ServoSample> + '_ {
        self.words.chunks_exact(self.stride()).map(Self::unpack)
    }

    pub(super) fn first(&self) -> Option<ServoSample> {
        self.iter().next()
    }

    pub(super) fn last(&self) -> Option<ServoSample> {
        self.iter().next_back()
    }

    fn last_sequence(&self) -> Option<u64> {
        let place = self.words.len().checked_sub(self.stride())?;
        self.words.get(place).copied()
    }

    pub(super) fn len(&self) -> usize {
        self.words.len() / self.stride()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    fn clear(&mut self) {
        self.words.clear();
    }
}

/// A run of samples without a gap inside.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Chunk {
    pub(super) samples: Samples,
    /// State of the pipeline before the first sample.
    pub(super) keyframe: Vec<u64>,
    /// Digest of all that the samples led to.
    pub(super) digest: Digest,
    pub(super) heard: Vec<Heard>,
}

impl Chunk {
    fn fresh() -> Self {
        Self {
            samples: Samples::with_room(CHUNK),
            keyframe: Vec::new(),
            digest: Digest::default(),
            heard: Vec::with_capacity(HEARD),
        }
    }

    fn clear(&mut self) {
        self.samples.clear();
        self.keyframe.clear();
        self.digest = Digest::default();
        self.heard.clear();
    }
}

/// What is kept.
#[derive(Debug)]
pub(super) struct BlackBox {
    full: VecDeque<Arc<Chunk>>,
    filling: Chunk,
    spare: Vec<Arc<Chunk>>,
    chunks: usize,
    turned: Option<Arc<Chunk>>,
}

impl BlackBox {
    /// Room for about `seconds` at `rate_hz`, all of it taken at once.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn new(seconds: f64, rate_hz: f64) -> Self {
        let chunks = ((seconds * rate_hz / CHUNK as f64).ceil() as usize).clamp(1, 400);
        let spare = (0..chunks + 1).map(|_| Arc::new(Chunk::fresh())).collect();
        Self {
            full: VecDeque::with_capacity(chunks + 1),
            filling: Chunk::fresh(),
            spare,
            chunks,
            turned: None,
        }
    }

    /// Call before the pipeline takes the sample: a chunk begins where the last is full or samples are
    /// missing, and keeps the pipeline's state.
    pub(super) fn before(&mut self, sample: &ServoSample, pipeline: &Pipeline) {
        let last = self.filling.samples.last_sequence();
        let follows = last.is_none_or(|l| follows(l, sample.sequence));
        if !follows || self.filling.samples.len() >= CHUNK {
            self.turn();
        }
        if self.filling.samples.is_empty() {
            self.filling.keyframe.clear();
            pipeline.keep(&mut self.filling.keyframe);
        }
    }

    /// Takes one sample that the pipeline took, and what it led to.
    pub(super) fn push(&mut self, sample: &ServoSample, (output, axes): (&StepOutput, usize)) {
        self.filling.samples.push(sample, axes);
        output.digest(axes, &mut self.filling.digest);
        if let Some((axis, event)) = output.event {
            let spindle_speed_rpm = sample.spindle_speed_rpm;
            self.filling.heard.push(Heard { t_s: output.t_s, axis, event, spindle_speed_rpm });
        }
    }

    /// Puts the chunk away and takes an empty one, from the spare ones where one is free.
    fn turn(&mut self) {
        let empty =
            self.spare.iter().position(|c| Arc::strong_count(c) == 1).map(|i| self.spare.swap_remove(i));
        let mut next = empty.and_then(Arc::into_inner).unwrap_or_else(Chunk::fresh);
        next.clear();
        next.keyframe.reserve_exact(self.filling.keyframe.len());
        let done = std::mem::replace(&mut self.filling, next);
        let done = Arc::new(done);
        self.turned = Some(Arc::clone(&done));
        self.full.push_back(done);
        if self.has_surplus()
            && let Some(oldest) = self.full.pop_front()
            && self.full.len() + self.spare.len() < self.chunks + SPARE
        {
            self.spare.push(oldest); // free once nobody is writing it
        }
    }

    /// Whether the oldest chunk may go: the others hold the time asked for, or there are too many short ones.
    fn has_surplus(&self) -> bool {
        let later: usize = self.full.iter().skip(1).map(|c| c.samples.len()).sum();
        later >= self.chunks * CHUNK || self.full.len() > self.chunks + SPARE
    }

    /// The chunk that was filled since the last call.
    pub(super) fn newest_full(&mut self) -> Option<Arc<Chunk>> {
        self.turned.take()
    }

    /// Forgets everything: what comes next has another clock or other axes.
    pub(super) fn clear(&mut self) {
        while let Some(chunk) = self.full.pop_front() {
            self.spare.push(chunk);
        }
        self.filling.clear();
        self.turned = None;
    }

    /// Everything that is kept, oldest first. Nothing is copied: the chunk that is being filled ends here.
    pub(super) fn snapshot(&mut self) -> Vec<Arc<Chunk>> {
        if !self.filling.samples.is_empty() {
            self.turn();
        }
        self.full.iter().cloned().collect()
    }
}

/// The chunks at the end between which no sample is missing: a recording is uniformly sampled.
pub(super) fn last_unbroken(chunks: &[Arc<Chunk>]) -> &[Arc<Chunk>] {
    let unbroken = |pair: &[Arc<Chunk>]| {
        let ends = pair[0].samples.last().zip(pair[1].samples.first());
        ends.is_some_and(|(a, b)| follows(a.sequence, b.sequence))
    };
    let begin = chunks.windows(2).rposition(|pair| !unbroken(pair)).map_or(0, |i| i + 1);
    chunks.get(begin..).unwrap_or_default()
}

/// Name of the signals of an axis that every sample has.
pub(super) const AXIS_SIGNALS: [&str; 2] = ["current_ref_a", "motor_angle_rad"];

/// Samples of chunks, oldest first.
pub(super) fn samples(chunks: &[Arc<Chunk>]) -> impl Iterator<Item = ServoSample> + '_ {
    chunks.iter().flat_map(|c| c.samples.iter())
}

/// A column of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Signal {
    CurrentRef(usize),
    MotorAngle(usize),
    StagePosition(usize),
    /// 0 where the scale was silent: the position beside it means nothing.
    StageValid(usize),
    Accel(usize),
    AccelValid,
    SpindleAngle,
    SpindleSpeed,
    Pitch,
    /// 0 where the turret was not heard.
    PitchValid,
    /// As the machine's clock said, to the last bit.
    SourceTime,
}

impl Signal {
    fn of(self, sample: &ServoSample) -> f64 {
        let axis = |index: usize| &sample.axes[index];
        match self {
            Self::CurrentRef(index) => axis(index).current_ref_a,
            Self::MotorAngle(index) => axis(index).motor_angle_rad,
            Self::StagePosition(index) => axis(index).stage_position_m.unwrap_or_default(),
            Self::StageValid(index) => f64::from(u8::from(axis(index).stage_position_m.is_some())),
            Self::Accel(place) => sample.accel_m_s2.map_or(0.0, |a| a[place]),
            Self::AccelValid => f64::from(u8::from(sample.accel_m_s2.is_some())),
            Self::SpindleAngle => sample.spindle_angle_rad,
            Self::SpindleSpeed => sample.spindle_speed_rpm,
            Self::Pitch => sample.pitch_difference_rad.unwrap_or_default(),
            Self::PitchValid => f64::from(u8::from(sample.pitch_difference_rad.is_some())),
            Self::SourceTime => sample.t_s,
        }
    }

    /// Appends the values of this column.
    pub(super) fn fill(self, chunks: &[Arc<Chunk>], out: &mut Vec<f64>) {
        out.extend(samples(chunks).map(|s| self.of(&s)));
    }
}

/// Columns of a recording, by name.
pub(super) fn signals(chunks: &[Arc<Chunk>], axes: &[String]) -> Vec<(String, Signal)> {
    let count: usize = chunks.iter().map(|c| c.samples.len()).sum();
    let mut out = Vec::new();
    for (index, axis) in axes.iter().enumerate().take(MAX_AXES) {
        out.push((format!("{axis}_{}", AXIS_SIGNALS[0]), Signal::CurrentRef(index)));
        out.push((format!("{axis}_{}", AXIS_SIGNALS[1]), Signal::MotorAngle(index)));
        let stages = samples(chunks).filter(|s| s.axes[index].stage_position_m.is_some()).count();
        if stages > 0 {
            out.push((format!("{axis}_stage_position_m"), Signal::StagePosition(index)));
        }
        if (1..count).contains(&stages) {
            out.push((format!("{axis}_stage_valid"), Signal::StageValid(index)));
        }
    }
    let heard = samples(chunks).filter(|s| s.accel_m_s2.is_some()).count();
    if heard > 0 {
        let accels = ["x", "y", "z"].into_iter().enumerate();
        out.extend(accels.map(|(place, axis)| (format!("{axis}_accel_m_s2"), Signal::Accel(place))));
    }
    if (1..count).contains(&heard) {
        out.push(("accel_valid".into(), Signal::AccelValid));
    }
    out.push(("spindle_angle_rad".into(), Signal::SpindleAngle));
    out.push(("spindle_speed_rpm".into(), Signal::SpindleSpeed));
    let told = samples(chunks).filter(|s| s.pitch_difference_rad.is_some()).count();
    if told > 0 {
        out.push(("pitch_difference_rad".into(), Signal::Pitch));
    }
    if (1..count).contains(&told) {
        out.push(("pitch_valid".into(), Signal::PitchValid));
    }
    out.push(("source_t_s".into(), Signal::SourceTime));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(sequence: u64) -> ServoSample {
        ServoSample {
            sequence,
            t_s: sequence as f64 / 9000.0,
            axes: [AxisSample::default(); MAX_AXES],
            spindle_angle_rad: 0.0,
            spindle_speed_rpm: 1200.0,
            accel_m_s2: None,
            pitch_difference_rad: None,
        }
    }

    fn pipeline() -> Pipeline {
        let config = crate::config::service::ServiceConfig::default();
        let rate = crate::units::SampleRate::new(9000.0).unwrap();
        Pipeline::new(config.pipeline_settings(rate, &["x1".into(), "y1".into()])).unwrap()
    }

    fn feed(kept: &mut BlackBox, pipeline: &mut Pipeline, sequences: impl Iterator<Item = u64>) {
        for sequence in sequences {
            let sample = sample(sequence);
            kept.before(&sample, pipeline);
            let output = pipeline.step(&sample);
            kept.push(&sample, (&output, 2));
        }
    }

    fn run(chunks: &[Arc<Chunk>]) -> Vec<ServoSample> {
        samples(last_unbroken(chunks)).collect()
    }

    #[test]
    fn keeps_the_newest_and_reuses_its_memory() {
        let mut kept = BlackBox::new(1.0, 9000.0);
        feed(&mut kept, &mut pipeline(), 0..50_000);
        let chunks = kept.snapshot();
        let run = run(&chunks);
        assert_eq!(run.last().unwrap().sequence, 49_999);
        assert!((9000..9000 + 2 * CHUNK).contains(&run.len()), "{}", run.len());
        assert!(kept.full.len() + kept.spare.len() <= kept.chunks + SPARE);
        // A save now and then costs nothing of the time that is kept before the next.
        for k in 0..8 {
            let from = 50_000 + 5000 * k;
            feed(&mut kept, &mut pipeline(), from..from + 5000);
            let length = kept.snapshot().iter().map(|c| c.samples.len()).sum::<usize>();
            assert!(length >= 9000 && kept.full.len() <= kept.chunks + SPARE, "{length}");
        }
    }

    #[test]
    fn a_recording_begins_after_the_last_gap_with_the_state_before_it() {
        let mut kept = BlackBox::new(1.0, 9000.0);
        let mut live = pipeline();
        feed(&mut kept, &mut live, (0..3000).chain(3001..5000));
        let chunks = kept.snapshot();
        let samples = run(&chunks);
        assert_eq!((samples[0].sequence, samples.len()), (3001, 1999));
        let mut again = pipeline();
        again.restore(&last_unbroken(&chunks)[0].keyframe).unwrap();
        let mut digest = Digest::default();
        samples.iter().for_each(|s| again.step(s).digest(2, &mut digest));
        assert_eq!(digest, last_unbroken(&chunks)[0].digest);
        let signals = signals(last_unbroken(&chunks), &["x1".into()]);
        let names: Vec<_> = signals.iter().map(|(name, _)| name.as_str()).collect();
        let expected = [
            "x1_current_ref_a",
            "x1_motor_angle_rad",
            "spindle_angle_rad",
            "spindle_speed_rpm",
            "source_t_s",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn samples_come_back_as_they_went_in() {
        let mut kept = Samples::with_room(3);
        let (mut one, mut two) = (sample(u64::MAX), sample(7));
        one.accel_m_s2 = Some([1.0, -2.0, 3e-300]);
        one.axes[1] =
            AxisSample { current_ref_a: -0.0, motor_angle_rad: 1e300, stage_position_m: Some(-0.5) };
        two.spindle_angle_rad = 2.5;
        kept.push(&one, 2);
        kept.push(&two, 2);
        assert_eq!(kept.iter().collect::<Vec<_>>(), [one, two]);
        assert_eq!((kept.first(), kept.last(), kept.len()), (Some(one), Some(two), 2));
        assert_eq!(kept.last_sequence(), Some(7));
        kept.clear();
        assert!(kept.is_empty() && kept.last().is_none() && kept.last_sequence().is_none());
    }

    #[test]
    fn a_scale_that_falls_silent_is_marked() {
        let mut list = [sample(1), sample(2)];
        list[0].axes[0].stage_position_m = Some(0.5);
        let mut chunk = Chunk::fresh();
        list.iter().for_each(|s| chunk.samples.push(s, 1));
        let chunks = [Arc::new(chunk)];
        let signals = signals(&chunks, &["x1".into()]);
        let of = |name: &str| {
            let mut values = Vec::new();
            signals.iter().find(|(n, _)| n == name).unwrap().1.fill(&chunks, &mut values);
            values
        };
        assert_eq!(of("x1_stage_position_m"), [0.5, 0.0]);
        assert_eq!(of("x1_stage_valid"), [1.0, 0.0]);
    }
}
