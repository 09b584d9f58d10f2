//! Model against machine, all the time and at small cost: the residual of the force balance, slowly.
//!
//! While the spindle stands and an axis moves, nothing cuts: the force that the spring-free balance (2-21)
//! then finds is what the model leaves out. Its rms over that of the thrust, window by window of one second,
//! is the residual ratio. Well identified axes show 0.02 to 0.09. The mismatch counts as significant when the
//! mean of [`RECENT`] windows is above [`LARGE`], or has doubled since the first [`BASELINE`] windows.
//!
//! Runs on a thread of its own over chunks that the black box has filled anyway; a chunk in which the spindle
//! never stands costs nothing.

use super::black_box::Chunk;
use crate::config::service::ServiceConfig;
use crate::force::balance::Method;
use crate::force::estimator::{ForceEstimator, ForceState};
use crate::force::motion::MotionSample;
use crate::force::plan::ServoPlan;
use crate::force::settings::{ForceSettings, LowPass};
use crate::force::signals::{AxisSignals, Signals};
use crate::sample::{ServoSample, follows};
use crate::telemetry::Metrics;
use crate::units::SampleRate;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Part of the thrust that no identified model should leave open.
const LARGE: f64 = 0.2;
/// Growth over the baseline that counts, where the ratio is also above [`SMALL`].
const GROWTH: f64 = 2.0;
const SMALL: f64 = 0.06;
/// Windows of the present mean.
const RECENT: usize = 5;
/// Windows of the baseline.
const BASELINE: usize = 20;
/// Slower than this an axis stands, m/s.
const MOVING_M_S: f64 = 1e-3;
/// Share of a window in which the axis must move.
const MOVING_SHARE: f64 = 0.3;
/// Above this the spindle turns and something may cut.
const STANDING_RPM: f64 = 1.0;
/// Residuals are looked at below this: slow physics, little encoder noise.
const CUTOFF_HZ: f64 = 100.0;
/// Chunks that may wait.
const WAITING: usize = 3;

/// Samples for the comparison.
#[derive(Debug)]
pub(super) struct Feed {
    pub(super) chunk: Arc<Chunk>,
    pub(super) axes: Arc<[String]>,
    pub(super) rate: SampleRate,
}

/// A mismatch that a person should look at.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Mismatch {
    pub(super) axis: String,
    pub(super) ratio: f64,
    pub(super) baseline: f64,
}

impl Mismatch {
    /// For the event.
    pub(super) fn sentence(&self) -> String {
        let (axis, ratio, baseline) = (&self.axis, 100.0 * self.ratio, 100.0 * self.baseline);
        format!(
            "the model of axis {axis} leaves {ratio:.0} % of the thrust open while nothing cuts \
             ({baseline:.0} % at the \
             start): something about the machine is not in it"
        )
    }
}

/// Starts the thread; it ends when the sender is gone. `found` is told of each mismatch once.
pub(super) fn start(
    config: Arc<ServiceConfig>,
    metrics: Arc<Metrics>,
    found: impl Fn(Mismatch) + Send + 'static,
) -> std::io::Result<(SyncSender<Feed>, std::thread::JoinHandle<()>)> {
    let (send, feeds) = sync_channel(WAITING);
    let thread = std::thread::Builder::new().name("drift".into()).spawn(move || {
        super::priority::step_back();
        metrics.stage_up.with_label_values(&["drift"]).set(1);
        compare(&feeds, &config, (&metrics, &found));
        metrics.stage_up.with_label_values(&["drift"]).set(0);
    })?;
    Ok((send, thread))
}

fn compare(feeds: &Receiver<Feed>, config: &ServiceConfig, (metrics, found): (&Metrics, &impl Fn(Mismatch))) {
    let mut watched: Option<(Arc<[String]>, SampleRate, Vec<Watch>)> = None;
    let mut last = None;
    while let Ok(feed) = feeds.recv() {
        let known = watched.as_ref().is_some_and(|(axes, rate, _)| *axes == feed.axes && *rate == feed.rate);
        if !known {
            let watches = feed.axes.iter().enumerate().filter_map(|a| Watch::new(config, a, feed.rate));
            watched = Some((Arc::clone(&feed.axes), feed.rate, watches.collect()));
        }
        let Some((_, _, watches)) = &mut watched else { continue };
        let first = feed.chunk.samples.first().map(|s| s.sequence);
        let follows = last.zip(first).is_some_and(|(l, f)| follows(l, f));
        let stands = feed.chunk.samples.iter().any(|sample| stands(&sample));
        last = feed.chunk.samples.last().map(|s| s.sequence).filter(|_| stands);
        for watch in watches {
            if !follows {
                watch.restart();
            }
            if stands {
                feed.chunk.samples.iter().for_each(|sample| watch.step(&sample));
            }
            let axis = watch.axis.clone();
            let labels = [axis.as_str()];
            Metrics::show(&metrics.model_residual_ratio, &labels, watch.ratio());
            metrics.model_windows.with_label_values(&labels).inc_by(std::mem::take(&mut watch.fresh));
            if let Some(mismatch) = watch.news() {
                metrics.model_mismatches.with_label_values(&labels).inc();
                found(mismatch);
            }
        }
    }
}

/// Nothing cuts: only then model and machine can be compared.
fn stands(sample: &ServoSample) -> bool {
    sample.spindle_speed_rpm.abs() < STANDING_RPM
}

/// Sums of one window.
#[derive(Debug, Clone, Copy, Default)]
struct Window {
    samples: usize,
    moving: usize,
    residual_n2: f64,
    thrust_n2: f64,
}

/// One axis.
struct Watch {
    axis: String,
    index: usize,
    estimator: ForceEstimator,
    state: Option<ForceState>,
    travel_m_rad: f64,
    thrust_n_a: f64,
    window_samples: usize,
    window: Window,
    moving: bool,
    looked_m: Option<f64>,
    recent: Vec<f64>,
    baseline: Vec<f64>,
    noise_n: f64,
    residual_n: f64,
    told: bool,
    fresh: u64,
}

impl Watch {
    /// Nothing where the model does not know the axis or it has no thrust.
    fn new(config: &ServiceConfig, (index, axis): (usize, &String), rate: SampleRate) -> Option<Self> {
        // Whatever estimates the force, model and machine are compared by the balance of both encoders.
        let plan = ServoPlan::of_axis(config.machine.axis(axis)?, Method::Medob, Signals::Both);
        let signals = AxisSignals { drive: &plan.drive, rate, signals: Signals::Both };
        let low_pass = LowPass::Butterworth { order: 2, cutoff_hz: CUTOFF_HZ };
        let settings = ForceSettings { low_pass, ..plan.settings.clone() };
        let estimator = ForceEstimator::new(Method::Medob, &signals, settings).ok()?;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive rate")]
        let window_samples = rate.hz().round().max(1.0) as usize;
        Some(Self {
            axis: axis.clone(),
            index,
            noise_n: estimator.properties().noise_floor_n,
            estimator,
            state: None,
            travel_m_rad: plan.drive.travel_m_rad(),
            thrust_n_a: plan.drive.thrust_constant_n_a()?,
            window_samples,
            window: Window::default(),
            moving: false,
            looked_m: None,
            recent: Vec::with_capacity(RECENT + 1),
            baseline: Vec::with_capacity(BASELINE),
            residual_n: 0.0,
            told: false,
            fresh: 0,
        })
    }

    fn restart(&mut self) {
        (self.state, self.window) = (None, Window::default());
        (self.moving, self.looked_m) = (false, None);
    }

    fn step(&mut self, sample: &ServoSample) {
        let axis = &sample.axes[self.index];
        let motion = MotionSample {
            thrust_ref_n: self.thrust_n_a * axis.current_ref_a,
            motor_travel_m: Some(self.travel_m_rad * axis.motor_angle_rad),
            nut_position_m: None,
            stage_position_m: axis.stage_position_m,
            spindle_speed_rpm: Some(sample.spindle_speed_rpm),
            accel_m_s2: None,
        };
        let state = self.state.get_or_insert_with(|| self.estimator.settled(&motion));
        let estimate = self.estimator.step(state, &motion);
        self.look_at_speed(motion.motor_travel_m.unwrap_or_default());
        self.window.samples += 1;
        if self.moving && estimate.flags.may_act() && stands(sample) {
            self.window.moving += 1;
            self.window.residual_n2 += estimate.force_n * estimate.force_n;
            self.window.thrust_n2 += motion.thrust_ref_n * motion.thrust_ref_n;
        }
        if self.window.samples >= self.window_samples {
            self.close();
        }
    }

    /// Every hundredth of a second: far enough apart that the encoder's steps do not count.
    fn look_at_speed(&mut self, travel_m: f64) {
        let every = (self.window_samples / 100).max(1);
        if self.window.samples.is_multiple_of(every) {
            let elapsed_s = every as f64 / self.window_samples as f64;
            self.moving = self.looked_m.is_some_and(|x| (travel_m - x).abs() > MOVING_M_S * elapsed_s);
            self.looked_m = Some(travel_m);
        }
    }

    fn close(&mut self) {
        let window = std::mem::take(&mut self.window);
        if (window.moving as f64) < MOVING_SHARE * window.samples as f64 || window.thrust_n2 <= 0.0 {
            return;
        }
        let ratio = (window.residual_n2 / window.thrust_n2).sqrt();
        self.residual_n = (window.residual_n2 / window.moving as f64).sqrt();
        self.fresh += 1;
        if self.baseline.len() < BASELINE {
            self.baseline.push(ratio);
        }
        if self.recent.len() >= RECENT {
            self.recent.remove(0);
        }
        self.recent.push(ratio);
    }

    /// Mean of the last windows.
    fn ratio(&self) -> Option<f64> {
        (!self.recent.is_empty()).then(|| mean(&self.recent))
    }

    /// A mismatch, once; again only after it was gone.
    fn news(&mut self) -> Option<Mismatch> {
        let ratio = self.ratio().filter(|_| self.recent.len() >= RECENT)?;
        let baseline = mean(&self.baseline);
        let known = self.baseline.len() >= BASELINE;
        let limit = if known { LARGE.min((GROWTH * baseline).max(SMALL)) } else { LARGE };
        let significant = ratio > limit && self.residual_n > 3.0 * self.noise_n;
        let news = significant && !self.told;
        self.told = if self.told { ratio > 0.7 * limit } else { significant };
        news.then(|| Mismatch { axis: self.axis.clone(), ratio, baseline })
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / (values.len().max(1)) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{AxisSample, MAX_AXES};
    use std::f64::consts::TAU;

    /// Minutes of one axis that moves to and fro, its mass as the model says times `mass`.
    fn told(mass: impl Fn(usize) -> f64, seconds: usize, spindle_rpm: f64) -> (Option<f64>, Vec<Mismatch>) {
        let config = ServiceConfig::default();
        let rate = SampleRate::new(9000.0).unwrap();
        let name = "x1".to_owned();
        let mut watch = Watch::new(&config, (0, &name), rate).unwrap();
        let drive = &config.machine.axis("x1").unwrap().drive;
        let (reach_m, turns_1_s) = (0.02, 1.5);
        let mut found = Vec::new();
        for k in 0..9000 * seconds {
            let phase = TAU * turns_1_s * k as f64 / 9000.0;
            let w = TAU * turns_1_s;
            let (x, v, a) =
                (reach_m * phase.sin(), reach_m * w * phase.cos(), -reach_m * w * w * phase.sin());
            let friction_n = drive.stage_coulomb_friction_n() + drive.motor_coulomb_friction_n();
            let damping = drive.reflected_damping_n_s_m() + drive.translational_damping_n_s_m();
            let thrust_n =
                mass(k / 9000) * drive.total_mass_kg() * a + damping * v + friction_n * (v / 2e-4).tanh();
            let mut axes = [AxisSample::default(); MAX_AXES];
            axes[0] = AxisSample {
                current_ref_a: thrust_n / watch.thrust_n_a,
                motor_angle_rad: x / watch.travel_m_rad,
                stage_position_m: Some(x),
            };
            let sample = ServoSample {
                sequence: k as u64,
                t_s: k as f64 / 9000.0,
                axes,
                spindle_angle_rad: 0.0,
                spindle_speed_rpm: spindle_rpm,
                accel_m_s2: None,
                pitch_difference_rad: None,
            };
            watch.step(&sample);
            found.extend(watch.news());
        }
        (watch.ratio(), found)
    }

    #[test]
    fn a_model_that_fits_is_left_in_peace() {
        let (ratio, found) = told(|_| 1.0, 30, 0.0);
        assert!(ratio.unwrap() < 0.1 && found.is_empty(), "{ratio:?} {found:?}");
    }

    #[test]
    fn a_wrong_mass_and_one_that_changes_are_told_once_each() {
        let (ratio, found) = told(|_| 1.8, 30, 0.0);
        assert!(ratio.unwrap() > LARGE && found.len() == 1, "{ratio:?} {found:?}");
        let (_, found) = told(|s| if s < 30 { 1.0 } else { 1.3 }, 60, 0.0);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].baseline < 0.1 && found[0].ratio > 2.0 * found[0].baseline);
    }

    #[test]
    fn while_the_spindle_turns_nothing_is_said() {
        let (ratio, found) = told(|_| 1.8, 20, 1200.0);
        assert!(ratio.is_none() && found.is_empty());
    }
}
