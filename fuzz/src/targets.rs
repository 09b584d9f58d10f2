//! What is done with bytes from outside: one function for each parser. Used by the libFuzzer targets beside
//! this file and by `examples/fuzz_campaign.rs`, which needs no nightly compiler.
//!
//! Each takes any bytes and may answer anything but a panic; what it accepts must hold what it promises.

use std::path::Path;
use stillcut::avoidance::Avoidance;
use stillcut::avoidance::account::{Account, Look, LookWriter, decide_again, settings_digest};
use stillcut::config::import_map::import_map_from_text;
use stillcut::config::machine::{machine_from_text, machine_to_text};
use stillcut::config::scenario::scenario_from_text;
use stillcut::config::service::service_config_from_text;
use stillcut::keyframe::Keep as _;
use stillcut::pipeline::Pipeline;
use stillcut::recording::{Evidence, import, read_recording};
use stillcut::sample::Recording;
use stillcut::units::SampleRate;

/// Configuration of the service, scenario of the lathe, map of an import.
pub(crate) fn configuration(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    // A model that is named is another file; here it must not be found.
    let path = Path::new("/nonexistent/c.toml");
    let one_line = |e: String| assert!(e.lines().count() == 1, "more than one line: {e:?}");
    let good = service_config_from_text(path, &text).map_err(|e| one_line(e.to_string())).is_ok();
    let scenario = scenario_from_text(path, &text).map_err(|e| one_line(e.to_string())).is_ok();
    let map = import_map_from_text(path, &text).map_err(|e| one_line(e.to_string())).is_ok();
    good || scenario || map
}

/// Machine models: what is read must be what is written again.
pub(crate) fn model(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    match machine_from_text(Path::new("machine.toml"), &text) {
        Ok(machine) => {
            let again = machine_to_text(&machine);
            let second = machine_from_text(Path::new("again.toml"), &again);
            assert!(second.is_ok(), "{:?} from {again}", second.err().map(|e| e.to_string()));
            true
        }
        Err(error) => {
            assert!(error.to_string().lines().count() == 1, "more than one line: {error}");
            false
        }
    }
}

/// A recording in a file of that ending; `scratch` is a folder, best in memory.
pub(crate) fn recording(bytes: &[u8], ending: &str, scratch: &Path) -> bool {
    let path = scratch.join(format!("{}.{ending}", std::process::id()));
    std::fs::write(&path, bytes).expect("the scratch folder can be written");
    match read_recording(&path) {
        Ok(recording) => {
            let length = recording.len();
            assert!(recording.columns.iter().all(|c| c.values.len() == length));
            assert!(recording.columns.iter().flat_map(|c| &c.values).all(|v| v.is_finite()));
            let _ = Evidence::of(&recording);
            true
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.lines().count() == 1, "more than one line: {text:?}");
            false
        }
    }
}

/// A MAT file through the map of one that is known.
pub(crate) fn mat(bytes: &[u8], scratch: &Path) -> bool {
    const MAP: &str = include_str!("../../config/import/emps-mat.toml");
    let map = import_map_from_text(Path::new("map.toml"), MAP).expect("a good map");
    let path = scratch.join(format!("{}.mat", std::process::id()));
    std::fs::write(&path, bytes).expect("the scratch folder can be written");
    match import(&path, &map) {
        Ok(recording) => recording.columns.iter().all(|c| c.values.iter().all(|v| v.is_finite())),
        Err(error) => {
            let text = error.to_string();
            assert!(text.lines().count() == 1, "more than one line: {text:?}");
            false
        }
    }
}

/// Rate of the pipeline that wire samples and keyframes go to.
const RATE_HZ: f64 = 3000.0;

/// A pipeline as the service makes it, for wire samples and keyframes.
pub(crate) struct Live {
    /// A keyframe in the middle of a stream.
    good: Vec<u64>,
    fresh: Pipeline,
    pipeline: Pipeline,
}

impl Live {
    /// One heard axis at a low rate and a narrow band: a small state, so that many inputs can be tried.
    #[must_use]
    pub(crate) fn new() -> Self {
        let rate = SampleRate::new(RATE_HZ).expect("a rate");
        let axes = ["x1", "y1"].map(str::to_owned);
        let text = "[detection]\nband_hz = [200.0, 220.0]\n[machine]\nwatch = [\"x1\"]\n";
        let config = service_config_from_text(Path::new("c.toml"), text).expect("good");
        let settings = config.pipeline_settings(rate, &axes);
        let fresh = Pipeline::new(settings).expect("the defaults make a pipeline");
        let (mut pipeline, mut good) = (fresh.clone(), Vec::new());
        for k in 0..3000_u64 {
            let mut sample = plain_sample(k);
            sample.axes[0].motor_angle_rad = (k as f64 * 0.3).sin() * 1e-3;
            pipeline.step(&sample);
        }
        pipeline.keep(&mut good);
        Self { good, pipeline: fresh.clone(), fresh }
    }

    /// A state to begin with, for mutation.
    #[must_use]
    pub(crate) fn keyframe(&self) -> Vec<u8> {
        let mut words = Vec::new();
        self.pipeline.keep(&mut words);
        words.iter().flat_map(|w| w.to_le_bytes()).collect()
    }

    /// Keyframes, as a recording would carry them: taken or refused, and what follows does not panic. The first
    /// byte says whether the rest is the keyframe or what is changed in a good one: place, length, word.
    pub(crate) fn restore(&mut self, bytes: &[u8]) -> bool {
        let [kind, rest @ ..] = bytes else { return false };
        let word = |c: &[u8]| c.iter().take(8).rev().fold(0_u64, |w, b| w << 8 | u64::from(*b));
        let mut words: Vec<u64> = rest.chunks_exact(8).map(word).collect();
        if kind % 4 != 0 {
            let changes = std::mem::replace(&mut words, self.good.clone());
            for pair in changes.chunks_exact(2) {
                let place = pair[0] as usize % words.len();
                match pair[0] >> 60 {
                    0 => words.truncate(place.max(1)),
                    1 => words.push(pair[1]),
                    _ => words[place] = pair[1],
                }
            }
        }
        let taken = self.fresh.restore(&words).is_ok();
        if taken {
            // The first ones follow the good keyframe without a gap, the others whatever was restored.
            for k in 0..64_u64 {
                let sequence = if k < 32 { 3000 + k } else { u64::MAX - 200 + k };
                let sample = stillcut::sample::ServoSample { sequence, ..plain_sample(k) };
                let output = self.fresh.step(&sample);
                assert!(output.forces.iter().all(|f| f.force_n.is_finite()));
            }
        }
        taken
    }
}

impl Default for Live {
    fn default() -> Self {
        Self::new()
    }
}

/// What a recording carries beside its samples, and the decisions on the turret that are made again from it.
pub(crate) struct Decisions {
    avoidance: Avoidance,
    good: Evidence,
}

impl Decisions {
    /// The turret of the defaults, and a short account of it.
    #[must_use]
    pub(crate) fn new() -> Self {
        let axes = ["x1", "y1"].map(str::to_owned);
        let config = service_config_from_text(Path::new("c.toml"), "").expect("defaults");
        let settings = config.avoidance_settings(&axes).expect("a turret");
        let avoidance = Avoidance::new(settings).expect("a turret that moves");
        let mut state = avoidance.start(7, 9.5);
        let mut account = Account { settings: settings_digest(avoidance.settings()), ..Account::default() };
        state.keep(&mut account.state);
        let (mut writer, mut looks) = (LookWriter::default(), Vec::new());
        for k in 0..20 {
            let now_s = 10.0 + 1e-3 * f64::from(k);
            let situation = stillcut::avoidance::Situation {
                now_s,
                newest_sample_s: Some(now_s),
                window_full: true,
                ..Default::default()
            };
            let decision = avoidance.decide(&mut state, &situation);
            writer.write(&Look { t_s: Some(now_s), situation, decision }, &mut looks);
        }
        account.stretches.push(looks);
        let good = Evidence {
            settings: 1,
            keyframe: vec![1, 2, 3],
            first_sequence: 7,
            stretches: vec![(3, 5), (4, 6)],
            decisions: String::new(),
            account: Some(account),
        };
        Self { avoidance, good }
    }

    /// The first byte says what the rest is: metadata (place and text, line by line), the state of the decision, or
    /// looks at it. What is read must be what is written again; damage is told in one line.
    pub(crate) fn read(&self, bytes: &[u8]) -> bool {
        let [kind, rest @ ..] = bytes else { return false };
        if kind % 4 == 0 {
            return self.metadata(rest);
        }
        let mut account = self.good.account.clone().unwrap_or_default();
        if kind % 4 == 1 {
            // Place and value: a byte and a word.
            for change in rest.chunks_exact(9) {
                let place = usize::from(change[0]) % account.state.len();
                account.state[place] = change[1..].iter().fold(0, |word, b| word << 8 | u64::from(*b));
            }
        } else {
            account.stretches[0] = rest.to_vec();
        }
        let again = decide_again(&self.avoidance, &account);
        if let Err(error) = &again {
            let text = error.to_string();
            assert!(text.lines().count() == 1, "more than one line: {text:?}");
        }
        again.is_ok()
    }

    fn metadata(&self, bytes: &[u8]) -> bool {
        let mut recording = Recording {
            sample_rate: SampleRate::new(RATE_HZ).expect("a rate"),
            experiment: String::new(),
            axes: vec![],
            columns: vec![],
            start_s: 0.0,
            metadata: self.good.metadata(),
        };
        let count = recording.metadata.len();
        for line in bytes.split(|b| *b == b'\n') {
            if let [place, text @ ..] = line {
                recording.metadata[usize::from(*place) % count].1 =
                    String::from_utf8_lossy(text).into_owned();
            }
        }
        match Evidence::of(&recording) {
            Ok(read) => {
                let read = read.expect("a keyframe stands there");
                recording.metadata = read.metadata();
                assert_eq!(Evidence::of(&recording), Ok(Some(read)));
                true
            }
            Err(error) => {
                assert!(error.to_string().lines().count() == 1, "more than one line: {error}");
                false
            }
        }
    }
}

fn plain_sample(k: u64) -> stillcut::sample::ServoSample {
    stillcut::sample::ServoSample {
        sequence: k,
        t_s: k as f64 / RATE_HZ,
        axes: Default::default(),
        spindle_angle_rad: 0.0,
        spindle_speed_rpm: 1200.0,
        accel_m_s2: None,
        pitch_difference_rad: None,
    }
}

/// What the service reads from shared memory, made of arbitrary bytes.
#[cfg(feature = "service")]
pub(crate) mod wire {
    use super::Live;
    use stillcut::transport::wire::{MAX_SAMPLES, ServoBatch, ServoPoint, axis_name_text};

    struct Bytes<'a>(std::iter::Cycle<std::slice::Iter<'a, u8>>);

    impl Bytes<'_> {
        fn word(&mut self) -> u64 {
            (0..8).fold(0, |word, _| word << 8 | u64::from(*self.0.next().unwrap_or(&0)))
        }

        fn number(&mut self) -> f64 {
            f64::from_bits(self.word())
        }
    }

    /// Batches: counted, refused or taken; an estimate that comes out is finite for finite, sane input.
    pub(crate) fn batch(bytes: &[u8], live: &mut Live) -> bool {
        if bytes.is_empty() {
            return false;
        }
        let mut from = Bytes(bytes.iter().cycle());
        let mut batch = ServoBatch {
            stream: from.word(),
            sample_rate_hz: from.number(),
            sample_count: (from.word() % 40) as u32 & (from.word() % 64) as u32,
            axis_count: (from.word() % 9) as u32,
            ..ServoBatch::default()
        };
        for name in &mut batch.axis_names {
            *name = from.word().to_le_bytes();
            assert!(axis_name_text(name).chars().all(|c| c.is_ascii_graphic()));
        }
        for point in batch.points.iter_mut().take(MAX_SAMPLES.min(batch.sample_count as usize)) {
            *point = ServoPoint {
                sequence: from.word() >> (from.word() % 60),
                t_ns: from.word(),
                spindle_angle_rad: from.number(),
                spindle_speed_rpm: from.number(),
                valid: from.word() as u32,
                ..ServoPoint::default()
            };
            for axis in &mut point.axes {
                axis.current_ref_a = from.number();
                axis.motor_angle_rad = from.number();
                axis.stage_position_m = from.number();
            }
        }
        let Some(axes) = batch.axes() else { return false };
        let mut taken = false;
        for point in batch.used_points() {
            let Ok(sample) = point.to_sample(axes.min(2)) else { continue };
            let output = live.pipeline.step(&sample);
            taken |= output.fault.is_none();
        }
        taken
    }

    /// What an MTConnect agent sends: answers to its pings and nothing else, in bounded memory.
    pub(crate) fn shdr(bytes: &[u8]) -> bool {
        let mut line = Vec::new();
        let pings =
            bytes.chunks(64).map(|c| stillcut::service::mtconnect::take(&mut line, c)).collect::<String>();
        assert!(pings.lines().all(|l| l == "* PONG 10000") && line.len() <= 128);
        !pings.is_empty()
    }
}
