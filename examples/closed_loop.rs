//! How does the loop behave on my cut? Runs it in one process and prints what happened.
//!
//! `cargo run --release --example closed_loop -- [SEED] [SECONDS] [FROM TO]`: with FROM and TO, what each axis
//! heard in that stretch is printed fifty times a second.

use stillcut::avoidance::Mode;
use stillcut::config::service::ServiceConfig;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::simulation::closed_loop::ClosedLoop;
use stillcut::simulation::lathe::{AXES, LatheSettings, PAUSE_S};
use stillcut::units::SampleRate;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let numbers: Vec<f64> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let number = |k: usize, default: f64| numbers.get(k).copied().unwrap_or(default);
    let scenario = Scenario::new(&RawScenario { travel_m_s: -3.0e-3, ..RawScenario::default() })?;
    let config = ServiceConfig { cut: scenario, ..ServiceConfig::default() };
    let settings = config.pipeline_settings(SampleRate::new(9000.0)?, &AXES.map(str::to_owned));
    let lathe = LatheSettings::realistic(scenario, number(0, 1.0) as u64);
    let lathe = LatheSettings { pause_s: Some(PAUSE_S), ..lathe };
    let mut cut = ClosedLoop::new(lathe, settings, Mode::Act)?;
    let (from_s, to_s) = (number(2, 0.0), number(3, 0.0));
    let mut count = 0_u32;
    while cut.lathe().truth().t_s < number(1, 24.0) {
        let event = cut.step();
        let t_s = cut.lathe().truth().t_s;
        if let Some(event) = event {
            println!("{t_s:8.3} s {event:?}");
        }
        count += 1;
        if count.is_multiple_of(180) && (from_s..to_s).contains(&t_s) {
            let offsets = cut.lathe().actual_offset_m();
            println!("{t_s:8.3} s x1 {:.1} nm y1 {:.1} nm", offsets[0] * 1e9, offsets[1] * 1e9);
            for axis in 0..2 {
                if let Some(o) = cut.pipeline().axis_output(axis) {
                    println!(
                        "    {} {:?} {:?} Hz {:.4} N2 x {:.1}",
                        AXES[axis], o.phase, o.frequency_hz, o.power_n2, o.contrast
                    );
                }
            }
        }
    }
    Ok(())
}
