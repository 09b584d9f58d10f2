//! Error budgets on a drive under control, against figures 4-1 to 5-10 of the thesis and against identities.

use stillcut::force::balance::Method;
use stillcut::force::closed_loop::ClosedLoop;
use stillcut::force::driven_budget::{DrivenBudget, PhaseLag, with_inertia_ratio};
use stillcut::force::response::Chain;
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::Controller;
use stillcut::units::SampleRate;

/// Machine A, tables 3-2 and 3-3.
fn machine_a() -> DriveParams {
    DriveParams::new(RawDriveParams {
        movable_mass_kg: Some(6.2),
        screw_lead_m: Some(0.005),
        rotary_inertia_kg_m2: Some(3.8e-5),
        axial_stiffness_n_m: Some(25.7e6),
        structural_damping_n_s_m: Some(2.5e3),
        rotary_damping_nm_s_rad: Some(2.3e-3),
        translational_damping_n_s_m: Some(3.7e2),
        current_loop_bandwidth_rad_s: Some(3000.0),
        amplifier_dead_time_s: Some(0.35e-3),
        motor_encoder_delay_s: Some(0.45e-3),
        stage_encoder_delay_s: Some(0.1e-3),
        ..RawDriveParams::default()
    })
    .unwrap()
}

/// Table 4-1.
const CONTROLLER: Controller = Controller {
    position_gain_1_s: 50.0,
    velocity_gain_1_s: 200.0,
    velocity_integral_1_s: 0.0,
    velocity_filter_rad_s: 5000.0,
};

fn rate() -> SampleRate {
    SampleRate::new(20_000.0).unwrap()
}

/// The loop of the thesis: P, P and the disturbance fed back at 1000 rad/s.
fn plant(drive: &DriveParams) -> ClosedLoop {
    ClosedLoop::around(drive, CONTROLLER, rate()).cancelling_disturbances(1000.0)
}

#[test]
fn dead_times_of_table_3_3_give_its_compensation() {
    let lag = PhaseLag::complete(&machine_a());
    for (value, printed_s) in [(lag.current_s, 0.8e-3), (lag.motor_s, 0.0), (lag.stage_s, 0.35e-3)] {
        assert!((value - printed_s).abs() < 1e-9, "{lag:?}");
    }
}

/// Whatever the control does, the aligned balance returns the force: at the stated delay and for every method
/// that has both encoders.
#[test]
fn aligned_signals_leave_no_error_under_control() {
    let drive = machine_a();
    for method in [Method::Medob, Method::RigidMode] {
        for closed in [plant(&drive), ClosedLoop::around(&drive, CONTROLLER, rate())] {
            let budget =
                DrivenBudget::new(method, &drive, closed, PhaseLag::complete(&drive)).holding(rate());
            for hz in [1.0, 30.0, 100.0, 335.0, 700.0, 1000.0] {
                assert!(
                    budget.relative_error(hz) < 1e-9,
                    "{method:?} {hz} Hz: {}",
                    budget.relative_error(hz)
                );
            }
        }
    }
    let vibration =
        DrivenBudget::new(Method::VibrationMode, &drive, plant(&drive), PhaseLag::complete(&drive));
    assert!(vibration.holding(rate()).relative_error(150.0) < 1e-9);
}

/// Figure 4-3: without phase lag compensation (which here follows the current loop too) the multi-encoder
/// observer is worse than the motor's thrust near 100 Hz, in amplitude and as a whole; with it, it is right.
#[test]
fn without_delay_compensation_medob_is_worse_than_thrust_near_100_hz() {
    let drive = machine_a();
    let with = |method, lag| DrivenBudget::new(method, &drive, plant(&drive), lag);
    let none = with(Method::Medob, PhaseLag::default());
    let thrust = with(Method::Thrust, PhaseLag::default());
    assert!(none.relative_error(100.0) > 1.1 * thrust.relative_error(100.0));
    assert!(none.relative_error(10.0) < thrust.relative_error(10.0));
    let whole = PhaseLag::complete(&drive);
    // Partial compensation errs at certain frequencies: (0.8, 0, 0) near the resonance, (0, 0, 0.35) near 100 Hz.
    let current = with(Method::Medob, PhaseLag { stage_s: 0.0, ..whole }).holding(rate());
    let stage = with(Method::Medob, PhaseLag { current_s: 0.0, ..whole }).holding(rate());
    assert!(current.relative_error(100.0) < 0.1 && current.relative_error(335.0) > 1.0);
    assert!(stage.relative_error(100.0) > 0.5 && stage.relative_error(1000.0) < 0.1);
}

/// Figures 4-1, 5-1, 5-10: slow forces are thrust for the multi-encoder observer; fast ones inertia. In the
/// vibration mode the thrust has the small share alpha and the spring carries the force; the motor's angle has
/// more of the inertia force in the rigid mode.
#[test]
fn an_estimate_is_made_of_what_the_figures_show() {
    let drive = machine_a();
    let parts = |method, hz| {
        DrivenBudget::new(method, &drive, plant(&drive), PhaseLag::complete(&drive)).holding(rate()).parts(hz)
    };
    let slow = parts(Method::Medob, 1.0);
    assert!((slow.thrust.norm() - 1.0).abs() < 0.02 && slow.inertia.norm() < 0.01);
    let fast = parts(Method::Medob, 900.0);
    assert!(fast.thrust.norm() < 0.4 && fast.inertia.norm() > 0.8);
    let alpha = drive.movable_mass_kg() / drive.reflected_mass_kg();
    let slow = parts(Method::VibrationMode, 1.0);
    assert!((slow.thrust.norm() / alpha - 1.0).abs() < 0.02);
    assert!((slow.elastic.norm() - (1.0 + alpha)).abs() < 0.02);
    for hz in [100.0, 335.0, 900.0] {
        let (rigid, vibration) = (parts(Method::RigidMode, hz), parts(Method::VibrationMode, hz));
        assert!(rigid.motor_inertia.norm() > 5.0 * vibration.motor_inertia.norm(), "{hz} Hz");
    }
}

/// Figures 5-2 to 5-5 keep the total mass and the resonance while the inertia ratio changes.
#[test]
fn another_inertia_ratio_keeps_mass_and_resonance() {
    let drive = machine_a();
    for alpha in [0.1, 0.5, 2.0] {
        let other = with_inertia_ratio(&drive, alpha).unwrap();
        let resonance = |d: &DriveParams| Chain::of_drive(d).modes().frequencies_hz[1];
        assert!((other.total_mass_kg() / drive.total_mass_kg() - 1.0).abs() < 1e-12);
        assert!((resonance(&other) / resonance(&drive) - 1.0).abs() < 1e-9);
        assert!((other.inertia_ratio().unwrap() / alpha - 1.0).abs() < 1e-12);
        // The share of the thrust is the ratio.
        let budget =
            DrivenBudget::new(Method::VibrationMode, &other, plant(&other), PhaseLag::complete(&other));
        assert!((budget.parts(0.5).thrust.norm() / alpha - 1.0).abs() < 0.02, "{alpha}");
    }
}
