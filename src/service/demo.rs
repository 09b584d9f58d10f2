//! The whole system in one process, over real shared memory: virtual lathe and service, and what a person
//! sees of them.

use super::engine::was_late;
use super::live::LiveState;
use super::virtual_lathe::VirtualLathe;
use super::{EventFilter, Handle, MAX_PAGE, Origin, Running, ServiceError, live, start};
use crate::config::service::{BUILT_IN_MODEL, COMMISSIONING_ITEMS, ServiceConfig};
use crate::simulation::lathe::{CARRIAGE, LatheSettings};
use crate::telemetry::{Event, EventKind};
use crate::transport::{Domain, TransportError};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;

/// File of the virtual lathe's drives, where diagnoses start from.
const MODEL: &str = "machine.toml";

/// What to show.
#[derive(Debug, Clone)]
pub struct DemoPlan {
    /// Lathe and cut.
    pub lathe: LatheSettings,
    /// Machine time to run for, s.
    pub duration_s: f64,
    /// How far the service goes.
    pub mode: live::Mode,
    /// First choice of the page's port; any free one if it is taken.
    pub port: u16,
}

/// Why the demonstration did not run.
#[derive(Debug, Error)]
pub enum DemoError {
    /// The service did not start.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// Shared memory cannot be used.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The folder for the run cannot be made.
    #[error("{}: {source}", path.display())]
    Folder {
        /// Folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The lathe's thread ended early.
    #[error("the virtual lathe stopped: {0}")]
    Lathe(String),
}

/// What happened; times on the machine's clock, `None` where it did not happen.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Summary {
    /// `observe`, `advise` or `act`.
    pub mode: &'static str,
    /// Seed of the run.
    pub seed: u64,
    /// Machine time, s.
    pub duration_s: f64,
    /// When the bar's vibration began to grow into chatter.
    pub onset_s: Option<f64>,
    /// When chatter was declared.
    pub alarm_s: Option<f64>,
    /// When the first pitch command was sent.
    pub command_s: Option<f64>,
    /// When chatter was declared over after it.
    pub suppressed_s: Option<f64>,
    /// Frequency at the alarm, Hz.
    pub frequency_hz: Option<f64>,
    /// Pitch difference commanded, rad.
    pub pitch_difference_rad: Option<f64>,
    /// Power of the band's strongest line in the last second before the command (without one: at the alarm),
    /// N2.
    pub power_before_n2: Option<f64>,
    /// The same in the last quarter of the run, N2.
    pub power_after_n2: Option<f64>,
    /// Alarms while the bar did not chatter.
    pub false_alarms: u64,
    /// Samples lost on the way.
    pub lost_samples: u64,
}

/// One look at lathe and service.
#[derive(Debug, Clone, Copy, Default)]
struct Look {
    t_s: f64,
    /// Largest excursion of the bar about its rest since the last look, m.
    vibration_m: f64,
    line_power_n2: f64,
}

/// Runs the demonstration until its time is over or `stop` is set. `tell` gets a line whenever something
/// happened, with its machine time.
///
/// Errors: shared memory, ports or the temporary folder cannot be used.
pub fn run_demo(
    plan: &DemoPlan,
    stop: Arc<AtomicBool>,
    tell: impl FnMut(&str),
) -> Result<Summary, DemoError> {
    let folder = std::env::temp_dir().join(format!("stillcut-demo-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|source| DemoError::Folder { path: folder.clone(), source })?;
    let domain = Domain::new(&format!("demo{}", std::process::id()), &folder.join("domain"))?;
    let outcome = run_in(plan, (&folder, &domain), stop, tell);
    domain.remove();
    // The run is over and told; what cannot be removed is the system's temporary folder's affair.
    let _ = std::fs::remove_dir_all(&folder);
    outcome
}

fn service_config(plan: &DemoPlan, folder: &Path, port: u16) -> ServiceConfig {
    let mut config = ServiceConfig { cut: plan.lathe.scenario, ..ServiceConfig::default() };
    config.model = Some(folder.join(MODEL));
    config.transport = (format!("demo{}", std::process::id()), folder.join("domain"));
    config.history.folder = folder.join("history");
    config.tools = Some((CARRIAGE.to_owned(), 0.0, false));
    config.http.listen.set_port(port);
    config.http.trust_loopback = true;
    // The virtual lathe's limits are the defaults.
    config.turret.commissioned = Some(("the demonstration".to_owned(), "2026-11-21".to_owned()));
    config.turret.accept = COMMISSIONING_ITEMS.map(str::to_owned).to_vec();
    config.turret.accept.push("estimators_disagree".to_owned());
    config
}

fn run_in(
    plan: &DemoPlan,
    (folder, domain): (&Path, &Domain),
    stop: Arc<AtomicBool>,
    tell: impl FnMut(&str),
) -> Result<Summary, DemoError> {
    let model = folder.join(MODEL);
    std::fs::write(&model, BUILT_IN_MODEL).map_err(|source| DemoError::Folder { path: model, source })?;
    let running = match start(service_config(plan, folder, plan.port)) {
        Err(ServiceError::Listen { .. }) => start(service_config(plan, folder, 0))?,
        other => other?,
    };
    let latest = Arc::new(Mutex::new(Look::default()));
    let lathe = spawn_lathe(plan, domain.clone(), Arc::clone(&stop), Arc::clone(&latest))?;
    let looks = running.wait(follow(plan, running.handle(), &lathe, &latest, tell));
    let ended_early = stop.swap(true, Ordering::Relaxed);
    let ended = lathe.join().map_err(|_| DemoError::Lathe("its thread panicked".into()))?;
    let lost_samples = running.handle().state().source.lost;
    let events = running.wait(events(&running));
    running.stop();
    ended.map_err(|e| DemoError::Lathe(e.to_string()))?;
    let mut plan = plan.clone();
    if ended_early {
        plan.duration_s = looks.last().map_or(0.0, |l| l.t_s);
    }
    Ok(summary(&plan, &looks, &events, lost_samples))
}

type LatheThread = std::thread::JoinHandle<Result<(), TransportError>>;

fn spawn_lathe(
    plan: &DemoPlan,
    domain: Domain,
    stop: Arc<AtomicBool>,
    latest: Arc<Mutex<Look>>,
) -> Result<LatheThread, DemoError> {
    let (settings, duration_s) = (plan.lathe, plan.duration_s);
    let body = move || {
        let mut rest_m = 0.0;
        VirtualLathe::join(settings, &domain)?.run(&stop, Some(duration_s), |lathe| {
            let truth = lathe.truth();
            // Rest follows slowly (20 ms), so that only vibration is left.
            rest_m += (truth.workpiece_displacement_m - rest_m) * 0.05;
            let mut look = latest.lock().unwrap_or_else(PoisonError::into_inner);
            look.t_s = truth.t_s;
            look.vibration_m = look.vibration_m.max((truth.workpiece_displacement_m - rest_m).abs());
        })
    };
    std::thread::Builder::new()
        .name("virtual-lathe".into())
        .spawn(body)
        .map_err(|source| DemoError::Folder { path: "virtual lathe's thread".into(), source })
}

/// Switches the mode on when the machine is ready, looks twenty times a second, tells what happens.
async fn follow(
    plan: &DemoPlan,
    handle: &Handle,
    lathe: &LatheThread,
    latest: &Mutex<Look>,
    mut tell: impl FnMut(&str),
) -> Vec<Look> {
    tell(&format!("page      http://{}/", handle.address()));
    tell(&format!("mode      {}", plan.mode.word()));
    tell(&format!("ends      after {} s or with Ctrl-C; --duration-s sets another time", plan.duration_s));
    let mut looks = Vec::new();
    let (mut cursor, mut raised) = (0, false);
    while !lathe.is_finished() {
        tokio::time::sleep(Duration::from_millis(50)).await;
        let state = handle.state();
        if raised && starved(&state, plan.mode) {
            if state.fault.is_some() {
                // Refused or not, the next look shows it.
                let _ = handle.clear_fault(origin("the computer was too busy")).await;
            }
            tell("          the computer was too busy for the virtual lathe: the demonstration asks again");
            raised = false;
        }
        // Once: a person who takes the turret back on the page keeps it.
        if !raised && state.mode != plan.mode && state.source.connected {
            let asked = origin("the demonstration asks for it");
            // Refused until samples and turret are heard: asked again at the next look.
            raised = handle.set_mode(plan.mode, Some(state.mode_revision), asked).await.is_ok();
        }
        let strongest = handle.spectrum().amplitude_n.iter().copied().fold(0.0, f64::max);
        looks.push(Look { line_power_n2: strongest * strongest / 2.0, ..take_look(latest) });
        cursor = tell_events(handle, cursor, &mut tell).await;
    }
    looks
}

/// For the record.
fn origin(reason: &str) -> Origin {
    Origin { actor: "demo".into(), role: "engineer".into(), reason: reason.into() }
}

/// The virtual lathe, or this whole process, was held up until the service stopped acting; it is heard again.
/// Every other fault stands until a person clears it, and a person who took the turret back keeps it.
fn starved(state: &LiveState, wanted: live::Mode) -> bool {
    state.source.connected && state.mode != wanted && was_late(&state.mode_reason)
}

/// The newest look; vibration counts anew from here.
fn take_look(latest: &Mutex<Look>) -> Look {
    let mut now = latest.lock().unwrap_or_else(PoisonError::into_inner);
    let look = *now;
    now.vibration_m = 0.0;
    look
}

async fn tell_events(handle: &Handle, cursor: i64, tell: &mut impl FnMut(&str)) -> i64 {
    let filter = EventFilter { cursor: Some(cursor), ascending: true, limit: 100, ..EventFilter::default() };
    let Ok(page) = handle.events(&filter).await else { return cursor };
    for event in &page.events {
        let at = event.t_s.map_or_else(|| "         ".to_owned(), |t| format!("{t:7.3} s"));
        tell(&format!("{at} {}", event.text));
    }
    page.events.last().map_or(cursor, |e| e.sequence)
}

async fn events(running: &Running) -> Vec<Event> {
    let filter = EventFilter { ascending: true, limit: MAX_PAGE, ..EventFilter::default() };
    running.handle().events(&filter).await.map(|page| page.events).unwrap_or_default()
}

fn summary(plan: &DemoPlan, looks: &[Look], events: &[Event], lost_samples: u64) -> Summary {
    let at = |kind: EventKind, from_s: f64| {
        events.iter().find(|e| e.kind == kind && e.t_s.is_some_and(|t| t >= from_s))
    };
    let alarm = at(EventKind::ChatterOnset, 0.0);
    let command = at(EventKind::PitchCommand, 0.0).filter(|_| plan.mode == live::Mode::Act);
    let command_s = command.and_then(|e| e.t_s);
    let suppressed_s = command_s.and_then(|from| at(EventKind::ChatterEnd, from)).and_then(|e| e.t_s);
    let strongest = |from: f64, to: f64| {
        let inside = looks.iter().filter(|l| l.t_s > from && l.t_s <= to).map(|l| l.line_power_n2);
        inside.reduce(f64::max)
    };
    let before_s = command_s.or_else(|| alarm.and_then(|e| e.t_s).map(|t| t + 1.0));
    Summary {
        mode: plan.mode.word(),
        seed: plan.lathe.seed,
        duration_s: plan.duration_s,
        onset_s: onset_s(looks),
        alarm_s: alarm.and_then(|e| e.t_s),
        command_s,
        suppressed_s,
        frequency_hz: alarm.and_then(|e| e.frequency_hz),
        pitch_difference_rad: command.and_then(|e| e.pitch_difference_rad),
        power_before_n2: before_s.and_then(|t| strongest(t - 1.0, t)),
        power_after_n2: mean_power_n2(looks, 0.75 * plan.duration_s),
        false_alarms: false_alarms(looks, events),
        lost_samples,
    }
}

/// Mean power of the strongest line from a time on.
fn mean_power_n2(looks: &[Look], from_s: f64) -> Option<f64> {
    let inside = looks.iter().filter(|l| l.t_s > from_s);
    let count = inside.clone().count();
    (count > 0).then(|| inside.map(|l| l.line_power_n2).sum::<f64>() / count as f64)
}

/// Last time before half of the largest vibration at which it was below a tenth.
fn onset_s(looks: &[Look]) -> Option<f64> {
    let largest = looks.iter().map(|l| l.vibration_m).fold(0.0, f64::max);
    // Less than a micrometre is no chatter.
    let half = looks.iter().position(|l| l.vibration_m >= 0.5 * largest).filter(|_| largest > 1e-6)?;
    let start = looks[..half].iter().rposition(|l| l.vibration_m < 0.1 * largest)?;
    Some(looks[start].t_s)
}

/// Alarms around which the bar never moved by a tenth of its largest vibration.
fn false_alarms(looks: &[Look], events: &[Event]) -> u64 {
    let largest = looks.iter().map(|l| l.vibration_m).fold(0.0, f64::max);
    let onsets = events.iter().filter(|e| e.kind == EventKind::ChatterOnset).filter_map(|e| e.t_s);
    let quiet = |t: f64| {
        let around = looks.iter().filter(|l| (t - 0.3..t + 0.3).contains(&l.t_s));
        around.map(|l| l.vibration_m).fold(0.0, f64::max) < (0.1 * largest).max(1e-6)
    };
    onsets.filter(|t| quiet(*t)).count() as u64
}
