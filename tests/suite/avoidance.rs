//! The command invariants under arbitrary sequences, and under deliberately planted faults.

use proptest::prelude::*;
use stillcut::avoidance::guard::{Facts, Guard, GuardState, Refusal};
use stillcut::avoidance::invariants::{Commissioned, CommissionedAxis, InvariantMonitor, Violation};
use stillcut::avoidance::turret::{TurretAxis, TurretKinematics};
use stillcut::avoidance::{
    Avoidance, AvoidanceSettings, Command, CommandKind, Decision, Foreseen, Heard, HoldReason, Interlock,
    Mode, Situation, TurretMotion, TurretReport,
};
use stillcut::chatter::Phase;
use stillcut::plant::scenario::Scenario;
use stillcut::sample::MAX_AXES;

const DIAMETER_M: f64 = 0.0234;
const REACH_M: f64 = 1.2e-3;
const SPEED_M_S: f64 = 0.6e-3;
const ACCELERATION_M_S2: f64 = 0.02;
const DIRECTIONS: [f64; 2] = [0.0, std::f64::consts::FRAC_PI_4];

/// `identified`: the pitch is chosen as in production, by the identified cut; else by eq. (6-10).
fn settings(identified: bool) -> AvoidanceSettings {
    let axis = |index: usize| TurretAxis {
        index,
        direction_rad: DIRECTIONS[index],
        lowest_m: -REACH_M,
        highest_m: REACH_M,
        speed_m_s: SPEED_M_S,
        acceleration_m_s2: ACCELERATION_M_S2,
    };
    AvoidanceSettings {
        turret: TurretKinematics::new([axis(0), axis(1)]).unwrap(),
        diameter_m: DIAMETER_M,
        largest_pitch_rad: 0.15,
        interval_s: 1.0,
        ttl_s: 2.5,
        freshness_s: 0.05,
        report_deadline_s: 0.2,
        reached_m: 20e-6,
        stated: identified.then(Scenario::default),
        before_chatter: identified,
    }
}

fn watcher() -> InvariantMonitor {
    watcher_of(true)
}

fn watcher_of(before_chatter: bool) -> InvariantMonitor {
    let limits = Commissioned {
        axes: [0, 1].map(|index: usize| CommissionedAxis {
            index,
            direction_rad: DIRECTIONS[index],
            range_m: [-REACH_M, REACH_M],
            speed_m_s: SPEED_M_S,
            acceleration_m_s2: ACCELERATION_M_S2,
        }),
        diameter_m: DIAMETER_M,
        largest_pitch_rad: 0.15,
        report_deadline_s: 0.2,
        reached_m: 20e-6,
        before_chatter,
    };
    InvariantMonitor::new(limits, 100.0)
}

/// One step of the world: what happens until the next call, and what is then known.
#[derive(Debug, Clone)]
struct Step {
    dt_s: f64,
    sample_age_s: Option<f64>,
    window_full: bool,
    estimate_valid: bool,
    phase: Phase,
    frequency_hz: Option<f64>,
    power_n2: f64,
    foreseen: Option<Foreseen>,
    speed_rpm: Option<f64>,
    turret: TurretFault,
    report_age_s: Option<f64>,
    interlock: Option<(f64, bool)>,
    mode: Mode,
    operator_hold: bool,
    acknowledge: bool,
    store_writable: bool,
    /// The command of this step does not go out.
    withheld: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum TurretFault {
    Good,
    Stuck,
    /// Refuses what it is told now, and reports it once.
    Refuses,
    /// The same, and reports it until it takes a command.
    RefusesAndSaysSo,
    Overshoots,
    WrongSign,
    NotANumber,
}

/// Mostly good, so that commands come about; now and then anything.
fn step() -> impl Strategy<Value = Step> {
    let wild =
        prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1.0), Just(0.0), Just(5e-324), Just(1e300)];
    let time = prop_oneof![
        12 => 0.05f64..0.4,
        6 => Just(1.0),
        1 => 1.0f64..5.0,
        1 => Just(0.0),
        1 => Just(-3.0),
    ];
    let age = |bad: u32| prop_oneof![40 => (0.0f64..0.01).prop_map(Some), bad => (0.0f64..3.0).prop_map(Some), 1 => Just(None)];
    let phase = prop_oneof![6 => Just(Phase::Chatter), 3 => Just(Phase::Quiet), 1 => Just(Phase::Suspected), 1 => Just(Phase::Learning)];
    let turret = prop_oneof![
        40 => Just(TurretFault::Good), 2 => Just(TurretFault::Stuck), 1 => Just(TurretFault::Refuses), 1 => Just(TurretFault::RefusesAndSaysSo),
        1 => Just(TurretFault::Overshoots), 1 => Just(TurretFault::WrongSign), 1 => Just(TurretFault::NotANumber),
    ];
    let mode = prop_oneof![40 => Just(Mode::Act), 1 => Just(Mode::Advise), 1 => Just(Mode::Observe)];
    let frequency = prop_oneof![30 => (560.0f64..720.0).prop_map(Some), 1 => wild.clone().prop_map(Some), 1 => Just(None)];
    let power = prop_oneof![20 => 1.0f64..2000.0, 1 => wild.clone()];
    let foreseen = prop_oneof![
        2 => Just(None),
        6 => (560.0f64..720.0, 0.5f64..11.0).prop_map(Some),
        1 => (wild.clone(), wild.clone()).prop_map(Some),
    ]
    .prop_map(|line| line.map(|(frequency_hz, margin_1_s)| Foreseen { frequency_hz, margin_1_s }));
    let speed =
        prop_oneof![40 => (1150.0f64..1250.0).prop_map(Some), 1 => wild.prop_map(Some), 1 => Just(None)];
    let rare = |weight: u32| prop_oneof![40 => Just(false), weight => Just(true)];
    let interlock = prop_oneof![
        40 => (0.0f64..0.1, Just(false)).prop_map(Some), 2 => (0.0f64..0.1, Just(true)).prop_map(Some),
        1 => (0.0f64..2.0, Just(false)).prop_map(Some), 1 => Just(None),
    ];
    (
        (time, age(2), age(1), rare(1), phase, frequency, (power, foreseen)),
        (speed, turret, interlock, mode, rare(1), rare(2), (rare(1), rare(4)), rare(2)),
    )
        .prop_map(|((dt_s, sample_age_s, report_age_s, gap, phase, frequency_hz, size), rest)| {
            let (power_n2, foreseen) = size;
            let (speed_rpm, turret, interlock, mode, operator_hold, acknowledge, store, doubtful) = rest;
            let (store_down, withheld) = store;
            Step {
                dt_s,
                sample_age_s,
                window_full: !gap,
                estimate_valid: !doubtful,
                phase,
                frequency_hz,
                power_n2,
                foreseen,
                speed_rpm,
                turret,
                report_age_s,
                interlock,
                mode,
                operator_hold,
                acknowledge,
                store_writable: !store_down,
                withheld,
            }
        })
}

/// The turret, from outside.
struct World {
    now_s: f64,
    latest_s: f64,
    actual_m: [f64; MAX_AXES],
    target_m: [f64; MAX_AXES],
    withheld: Option<u64>,
    refused: Option<TurretFault>,
    taken: Option<(u64, u64)>,
    expires_s: f64,
}

impl World {
    fn new() -> Self {
        Self {
            now_s: 100.0,
            latest_s: 100.0,
            actual_m: [0.0; MAX_AXES],
            target_m: [0.0; MAX_AXES],
            withheld: None,
            refused: None,
            taken: None,
            expires_s: f64::INFINITY,
        }
    }

    /// A command goes out, and the turret takes it or not.
    fn obey(&mut self, step: &Step, command: &Command) {
        if step.withheld && command.kind != CommandKind::Return {
            self.withheld = Some(command.sequence);
        } else if matches!(step.turret, TurretFault::Refuses | TurretFault::RefusesAndSaysSo) {
            self.refused = Some(step.turret);
        } else {
            (self.target_m, self.refused) = (command.offsets_m, None);
            self.taken = Some((command.epoch, command.sequence));
            self.expires_s = command.based_on_s + command.ttl_s;
        }
    }

    fn motion(&mut self) -> TurretMotion {
        let refused = self.refused.take_if(|r| *r == TurretFault::Refuses).or(self.refused);
        match refused {
            Some(_) => TurretMotion::Refused,
            None if self.expires_s == f64::NEG_INFINITY => TurretMotion::Expired,
            None => TurretMotion::Reached,
        }
    }

    fn go_on(&mut self, step: &Step) -> Situation {
        self.now_s = self.latest_s + step.dt_s;
        self.latest_s = self.latest_s.max(self.now_s);
        if self.latest_s > self.expires_s {
            (self.target_m, self.expires_s) = ([0.0; MAX_AXES], f64::NEG_INFINITY);
        }
        for axis in 0..2 {
            let way = (self.target_m[axis] - self.actual_m[axis]).clamp(-1e-3, 1e-3);
            self.actual_m[axis] += match step.turret {
                TurretFault::Stuck => 0.0,
                TurretFault::WrongSign => -way,
                TurretFault::Overshoots => 1.2 * way,
                TurretFault::Good
                | TurretFault::NotANumber
                | TurretFault::Refuses
                | TurretFault::RefusesAndSaysSo => way,
            };
        }
        let mut offsets_m = self.actual_m;
        if step.turret == TurretFault::NotANumber {
            offsets_m[1] = f64::NAN;
        }
        let motion = self.motion();
        let now_s = self.now_s;
        Situation {
            now_s,
            newest_sample_s: step.sample_age_s.map(|a| now_s - a),
            window_full: step.window_full,
            estimate_valid: step.estimate_valid,
            heard: Heard {
                phase: step.phase,
                frequency_hz: step.frequency_hz,
                power_n2: step.power_n2,
                growth_1_s: None,
            },
            foreseen: step.foreseen,
            spindle_speed_rpm: step.speed_rpm,
            turret: step.report_age_s.map(|a| TurretReport {
                heard_s: now_s - a,
                offsets_m,
                motion,
                acknowledged: self.taken,
            }),
            interlock: step.interlock.map(|(a, open)| Interlock { heard_s: now_s - a, open }),
            mode: step.mode,
            operator_hold: step.operator_hold,
            operator_acknowledge: step.acknowledge,
            store_writable: step.store_writable,
            withheld: self.withheld,
            ..Situation::default()
        }
    }
}

type Tamper = fn(&mut Situation);
type Spoil = fn(&mut Decision, &mut Spoiler);

/// What a planted fault may remember.
#[derive(Default)]
struct Spoiler {
    last: Option<Command>,
    decisions: u32,
}

struct Outcome {
    violations: Vec<Violation>,
    commands: Vec<Command>,
    holds: u64,
}

/// Runs a sequence; `tamper` changes what the decision believes, `spoil` what it says.
fn run(steps: &[Step], tamper: Tamper, spoil: Spoil) -> Outcome {
    run_with(settings(false), steps, (tamper, spoil))
}

fn run_with(settings: AvoidanceSettings, steps: &[Step], (tamper, spoil): (Tamper, Spoil)) -> Outcome {
    let avoidance = Avoidance::new(settings).unwrap();
    let mut state = avoidance.start(1, 100.0);
    let mut watch = watcher();
    let mut world = World::new();
    let mut spoiler = Spoiler::default();
    let mut outcome = Outcome { violations: Vec::new(), commands: Vec::new(), holds: 0 };
    for step in steps {
        let seen = world.go_on(step);
        let mut believed = seen;
        tamper(&mut believed);
        let mut decision = avoidance.decide(&mut state, &believed);
        spoil(&mut decision, &mut spoiler);
        if let Err(violation) = watch.watch(&seen, &decision) {
            if std::env::var("SHOW").is_ok() {
                eprintln!("{violation:?} {seen:?} {decision:?} {state:?}");
            }
            outcome.violations.push(violation);
        }
        match decision {
            Decision::Command(command) => {
                world.obey(step, &command);
                outcome.commands.push(command);
            }
            Decision::Hold(_) | Decision::Advice(_) => outcome.holds += 1,
            Decision::NotDue => {}
        }
    }
    outcome
}

const HONEST: Tamper = |_| {};
const FAITHFUL: Spoil = |_, _| {};

/// Sequences to try; more with `STILLCUT_SEQUENCES=20000`.
fn sequences() -> u32 {
    std::env::var("STILLCUT_SEQUENCES").ok().and_then(|n| n.parse().ok()).unwrap_or(600)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: sequences(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_sequence_breaks_an_invariant(steps in prop::collection::vec(step(), 1..150)) {
        let outcome = run(&steps, HONEST, FAITHFUL);
        prop_assert!(outcome.violations.is_empty(), "{:?}", outcome.violations);
    }

    #[test]
    fn nor_where_the_cut_is_identified(steps in prop::collection::vec(step(), 1..40)) {
        let outcome = run_with(settings(true), &steps, (HONEST, FAITHFUL));
        prop_assert!(outcome.violations.is_empty(), "{:?}", outcome.violations);
    }

    #[test]
    fn the_same_input_gives_the_same_commands(steps in prop::collection::vec(step(), 1..80)) {
        let (a, b) = (run(&steps, HONEST, FAITHFUL), run(&steps, HONEST, FAITHFUL));
        prop_assert_eq!(a.commands, b.commands);
        prop_assert_eq!(a.holds, b.holds);
    }
}

fn on_command(decision: &mut Decision, change: impl FnOnce(&mut Command)) {
    if let Decision::Command(command) = decision
        && command.kind != CommandKind::Return
    {
        change(command);
    }
}

/// Deliberate faults of the decision; each must be noticed from outside.
fn planted() -> Vec<(&'static str, Tamper, Spoil)> {
    let spoil = |name, spoil: Spoil| (name, HONEST, spoil);
    let tamper = |name, tamper: Tamper| (name, tamper, FAITHFUL);
    vec![
        spoil("sign of the offsets", |d, _| on_command(d, |c| c.offsets_m = c.offsets_m.map(|o| -o))),
        spoil("millimetres for metres", |d, _| on_command(d, |c| c.offsets_m = c.offsets_m.map(|o| o * 1e3))),
        spoil("degrees for radians", |d, _| {
            on_command(d, |c| c.pitch_difference_rad = c.pitch_difference_rad.to_degrees())
        }),
        spoil("axes swapped", |d, _| on_command(d, |c| c.offsets_m.swap(0, 1))),
        spoil("axis that is not ours", |d, _| on_command(d, |c| c.offsets_m[3] = 1e-6)),
        spoil("not a number", |d, _| on_command(d, |c| c.offsets_m[1] = f64::NAN)),
        spoil("lifetime without end", |d, _| on_command(d, |c| c.ttl_s = 60.0)),
        spoil("number not raised", |d, s| {
            on_command(d, |c| {
                c.sequence = s.last.map_or(c.sequence, |l| l.sequence);
                s.last = Some(*c);
            })
        }),
        spoil("old epoch after some commands", |d, s| {
            on_command(d, |c| {
                s.decisions += 1;
                if s.decisions > 3 {
                    c.epoch -= 1
                }
            })
        }),
        spoil("the last command again and again", |d, s| match (&d, &mut s.last) {
            (Decision::Command(c), last) => *last = Some(*c),
            (Decision::NotDue, Some(last)) if last.kind != CommandKind::Return => {
                last.sequence += 1;
                *d = Decision::Command(*last);
            }
            _ => {}
        }),
        spoil("says nothing any more", |d, s| {
            s.decisions += 1;
            if s.decisions > 20 {
                *d = Decision::NotDue
            }
        }),
        spoil("never goes back", |d, _| {
            if matches!(d, Decision::Command(c) if c.kind == CommandKind::Return) {
                *d = Decision::Hold(HoldReason::Returned);
            }
        }),
        spoil("goes somewhere when it goes back", |d, _| {
            if let Decision::Command(c) = d
                && c.kind == CommandKind::Return
            {
                c.offsets_m[0] = 1e-4
            }
        }),
        spoil("every renewal a new target", |d, _| on_command(d, |c| c.kind = CommandKind::Move)),
        spoil("pitch for twice the speed", |d, _| {
            on_command(d, |c| {
                c.requested_pitch_rad *= 2.0;
            })
        }),
        tamper("interlock believed closed", |s| {
            s.interlock = Some(Interlock { heard_s: s.now_s, open: false });
        }),
        tamper("long silence believed short", |s| {
            s.newest_sample_s = s.newest_sample_s.map(|t| t.max(s.now_s - 0.5));
        }),
        tamper("mode believed act", |s| s.mode = Mode::Act),
        tamper("samples believed fresh", |s| s.newest_sample_s = Some(s.now_s)),
        tamper("window believed full", |s| s.window_full = true),
        tamper("estimate believed valid", |s| s.estimate_valid = true),
        tamper("store believed writable", |s| s.store_writable = true),
        tamper("operator not heard", |s| s.operator_hold = false),
        tamper("turret believed alive", |s| {
            if let Some(t) = &mut s.turret {
                t.heard_s = s.now_s
            }
        }),
        tamper("refusal overlooked", |s| {
            if let Some(t) = &mut s.turret {
                t.motion = TurretMotion::Reached
            }
        }),
        tamper("turret believed far along", |s| {
            if let Some(t) = &mut s.turret {
                t.offsets_m = t.offsets_m.map(|o| if o.is_finite() { o + 0.4e-3 } else { o })
            }
        }),
    ]
}

#[test]
fn every_planted_fault_is_noticed() {
    use proptest::strategy::ValueTree as _;
    use proptest::test_runner::TestRunner;
    let mut runner = TestRunner::deterministic();
    let strategy = prop::collection::vec(step(), 150);
    let sequences: Vec<Vec<Step>> =
        (0..60).map(|_| strategy.new_tree(&mut runner).unwrap().current()).collect();
    for identified in [false, true] {
        let run = |s: &Vec<Step>, tamper, spoil| run_with(settings(identified), s, (tamper, spoil));
        let honest: Vec<Outcome> = sequences.iter().take(30).map(|s| run(s, HONEST, FAITHFUL)).collect();
        assert!(honest.iter().all(|outcome| outcome.violations.is_empty()), "{identified}");
        let commands: usize = honest.iter().map(|outcome| outcome.commands.len()).sum();
        assert!(commands > 100, "only {commands} commands: the sequences do not exercise the decision");
        let faults = planted();
        assert!(faults.len() >= 20);
        for (name, tamper, spoil) in faults {
            let seen = sequences.iter().find_map(|s| run(s, tamper, spoil).violations.first().copied());
            println!("{name}, identified {identified}: {seen:?}");
            assert!(seen.is_some(), "planted fault `{name}` was not noticed: identified {identified}");
        }
    }
}

/// Chatter on a good machine in `act`, second by second.
fn good_second() -> Step {
    Step {
        dt_s: 1.0,
        sample_age_s: Some(0.001),
        window_full: true,
        estimate_valid: true,
        phase: Phase::Chatter,
        frequency_hz: Some(652.0),
        power_n2: 100.0,
        foreseen: None,
        speed_rpm: Some(1200.0),
        turret: TurretFault::Good,
        report_age_s: Some(0.001),
        interlock: Some((0.001, false)),
        mode: Mode::Act,
        operator_hold: false,
        acknowledge: false,
        store_writable: true,
        withheld: false,
    }
}

/// Decisions of one sequence and what the monitor says of each.
fn decisions(steps: &[Step]) -> Vec<Decision> {
    let avoidance = Avoidance::new(settings(false)).unwrap();
    let (mut state, mut watch) = (avoidance.start(1, 100.0), watcher());
    let mut world = World::new();
    let mut decide = |step: &Step| {
        let seen = world.go_on(step);
        let decision = avoidance.decide(&mut state, &seen);
        assert_eq!(watch.watch(&seen, &decision), Ok(()), "{seen:?} {decision:?}");
        if let Decision::Command(command) = decision {
            world.obey(step, &command);
        }
        decision
    };
    steps.iter().map(&mut decide).collect()
}

/// Two pitches do not help, a person is called; once he has cleared it in `observe`, `act` acts again.
#[test]
fn a_fault_cleared_in_observe_stays_cleared() {
    let mut steps = vec![good_second(); 8];
    steps.push(Step { mode: Mode::Observe, ..good_second() });
    steps.push(Step { mode: Mode::Observe, acknowledge: true, dt_s: 0.001, ..good_second() });
    steps.push(Step { phase: Phase::Quiet, ..good_second() });
    steps.extend(vec![good_second(); 2]);
    let decided = decisions(&steps);
    let held = Decision::Hold(HoldReason::HandedOver);
    assert_eq!(decided[7], held, "{decided:?}");
    let after = &decided[10..];
    assert!(!after.contains(&held), "{after:?}");
    assert!(after.iter().any(|d| matches!(d, Decision::Command(c) if c.kind == CommandKind::Move)));
    // Without a person it stays latched.
    steps[9].acknowledge = false;
    assert_eq!(decisions(&steps).last(), Some(&held));
}

/// A command that waits in vain for its record never reached the turret: nothing is stuck, nothing is judged.
#[test]
fn commands_that_do_not_go_out_do_not_make_the_turret_look_stuck() {
    let mut steps = vec![Step { withheld: true, ..good_second() }; 12];
    steps.push(good_second());
    let decided = decisions(&steps);
    for decision in &decided {
        assert!(matches!(decision, Decision::Command(c) if c.kind == CommandKind::Move), "{decision:?}");
    }
}

/// While the record cannot be written the turret stays where it was told on record; nothing new is asked.
#[test]
fn without_a_record_what_stands_is_renewed_and_nothing_else() {
    let mut steps = vec![good_second(); 1];
    steps.extend(vec![Step { phase: Phase::Quiet, ..good_second() }; 3]);
    steps.extend(vec![Step { store_writable: false, phase: Phase::Quiet, ..good_second() }; 3]);
    steps.push(Step { store_writable: false, ..good_second() });
    let decided = decisions(&steps);
    let renewed = |d: &Decision| matches!(d, Decision::Command(c) if c.kind == CommandKind::Renew);
    assert!(decided[4..].iter().all(renewed), "{decided:?}");
    let none = decisions(&[Step { store_writable: false, ..good_second() }]);
    assert_eq!(none, [Decision::Hold(HoldReason::StoreNotWritable)]);
}

fn is_move(decision: &Decision) -> bool {
    matches!(decision, Decision::Command(c) if c.kind == CommandKind::Move)
}

/// A silent cut whose margin runs out.
fn silent_second() -> Step {
    let foreseen = Some(Foreseen { frequency_hz: 652.0, margin_1_s: 6.0 });
    Step { phase: Phase::Quiet, frequency_hz: None, power_n2: 1.0, foreseen, ..good_second() }
}

/// Where it is commissioned the pitch moves before any chatter, as far as the margin asks, again only after
/// the margin of the new pitch has been read, and no more than five times without its recovery.
#[test]
fn the_pitch_moves_before_chatter_where_that_is_commissioned() {
    let moves = |before_chatter: bool, steps: &[Step]| {
        let settings = AvoidanceSettings { before_chatter, ..settings(true) };
        let outcome = run_with(settings, steps, (HONEST, FAITHFUL));
        assert!(outcome.violations.is_empty(), "{:?}", outcome.violations);
        outcome.commands.into_iter().filter(|c| c.kind == CommandKind::Move).collect::<Vec<_>>()
    };
    let steps = vec![silent_second(); 60];
    let asked = moves(true, &steps);
    assert!((1..=5).contains(&asked.len()), "{asked:?}");
    assert!(asked.windows(2).all(|w| w[1].issued_s - w[0].issued_s >= 4.0 - 1e-9), "{asked:?}");
    assert!(asked.iter().all(|c| (0.002..0.15).contains(&c.requested_pitch_rad.abs())), "{asked:?}");
    assert!(moves(false, &steps).is_empty());
    let calm = Step { foreseen: None, ..silent_second() };
    assert!(moves(true, &vec![calm.clone(); 60]).is_empty());
    let impatient: Spoil = |d, _| on_command(d, |c| c.kind = CommandKind::Move);
    let told = run_with(settings(true), &steps, (HONEST, impatient)).violations;
    assert!(told.contains(&Violation::Interval), "{told:?}");
    // Chatter of the last minute rules: no move of this kind after it.
    let after = [vec![good_second(); 1], vec![silent_second(); 20]].concat();
    assert_eq!(moves(true, &after).len(), 1, "the one against chatter");
    // Not on a force that must not be acted on, and not by a monitor that was told of no such limits.
    let doubtful = Step { estimate_valid: false, ..silent_second() };
    assert!(moves(true, &vec![doubtful; 60]).is_empty());
    let (avoidance, mut world) = (Avoidance::new(settings(true)).unwrap(), World::new());
    let (mut state, mut watch) = (avoidance.start(1, 100.0), watcher_of(false));
    let mut told = steps.iter().map(|step| {
        let seen = world.go_on(step);
        watch.watch(&seen, &avoidance.decide(&mut state, &seen))
    });
    assert!(told.any(|t| t == Err(Violation::Purpose)));
}

fn is_renewal(decision: &Decision) -> bool {
    matches!(decision, Decision::Command(c) if c.kind == CommandKind::Renew)
}

/// Whether the controller tells a refusal once or until it takes a command: it is one refusal, and the waits
/// grow.
#[test]
fn refusals_are_counted_once_each_and_waited_for_longer_each_time() {
    for turret in [TurretFault::Refuses, TurretFault::RefusesAndSaysSo] {
        let look = |turret| Step { dt_s: 0.1, turret, ..good_second() };
        let decided = decisions(&vec![look(turret); 170]);
        let times: Vec<usize> =
            (0..decided.len()).filter(|k| matches!(decided[*k], Decision::Command(_))).collect();
        let waits: Vec<usize> = times.windows(2).map(|t| t[1] - t[0]).collect();
        assert!(waits.len() >= 3, "{turret:?} {times:?}");
        for (wait, expected) in waits.iter().zip([10, 20, 40, 80]) {
            assert!((expected..expected + 15).contains(wait), "{turret:?} {waits:?}");
        }
        assert!(!decided.contains(&Decision::Hold(HoldReason::TurretNotReached)), "{turret:?}");
    }
}

/// A line that is now declared, now only suspected, at the same power all the time.
#[test]
fn five_targets_in_vain_call_a_person() {
    let suspected = Step { phase: Phase::Suspected, ..good_second() };
    let steps: Vec<Step> =
        (0..40).map(|k| if k % 3 == 2 { suspected.clone() } else { good_second() }).collect();
    let decided = decisions(&steps);
    assert!(decided.iter().filter(|d| is_move(d)).count() <= 5);
    assert_eq!(decided.last(), Some(&Decision::Hold(HoldReason::HandedOver)));
}

/// A detector that falls silent over a vibration that is as loud as before has cured nothing.
#[test]
fn silence_at_the_same_power_is_no_success() {
    let deaf = Step { phase: Phase::Quiet, ..good_second() };
    let moves = |quiet: Step| {
        let mut steps = vec![good_second(); 3];
        steps.extend(vec![quiet; 2]);
        steps.extend(vec![good_second(); 5]);
        let decided = decisions(&steps);
        (decided.iter().filter(|d| is_move(d)).count(), decided.last().copied())
    };
    assert_eq!(moves(deaf.clone()), (2, Some(Decision::Hold(HoldReason::HandedOver))));
    // Where it was silenced the next chatter is another.
    let (_, last) = moves(Step { power_n2: 1.0, ..deaf });
    assert_ne!(last, Some(Decision::Hold(HoldReason::HandedOver)));
}

/// Samples that stay away: the turret is told to go back, and a decision that only holds is noticed.
#[test]
fn stale_samples_take_the_turret_back_and_a_missing_return_is_noticed() {
    let mut steps = vec![good_second(); 3];
    steps.extend(vec![Step { sample_age_s: Some(2.0), dt_s: 0.1, ..good_second() }; 30]);
    let back = |d: &Decision| matches!(d, Decision::Command(c) if c.kind == CommandKind::Return);
    let decided = decisions(&steps);
    assert_eq!(decided.iter().filter(|d| back(d)).count(), 1, "{decided:?}");
    assert!(decided[3..15].iter().any(back));
    let never: Spoil = |d, _| {
        if matches!(d, Decision::Command(c) if c.kind == CommandKind::Return) {
            *d = Decision::Hold(HoldReason::StaleSamples);
        }
    };
    assert_eq!(run(&steps, HONEST, never).violations.first(), Some(&Violation::Return));
}

/// While a command is on its way nothing is decided, but what the turret says is heard.
#[test]
fn a_refusal_told_while_nothing_may_be_decided_is_heard() {
    let avoidance = Avoidance::new(settings(false)).unwrap();
    let (mut state, mut watch, mut world) = (avoidance.start(1, 100.0), watcher(), World::new());
    let mut look = |step: &Step, (too_soon, motion)| {
        let mut seen = Situation { too_soon, ..world.go_on(step) };
        seen.turret = seen.turret.map(|t| TurretReport { motion, ..t });
        let decision = avoidance.decide(&mut state, &seen);
        assert_eq!(watch.watch(&seen, &decision), Ok(()), "{seen:?} {decision:?}");
        decision
    };
    let (second, soon) = (good_second(), Step { dt_s: 0.3, ..good_second() });
    assert!(is_move(&look(&second, (false, TurretMotion::Reached))));
    assert_eq!(look(&soon, (true, TurretMotion::Refused)), Decision::NotDue);
    assert_eq!(look(&soon, (true, TurretMotion::Reached)), Decision::NotDue);
    assert_eq!(look(&soon, (true, TurretMotion::Reached)), Decision::NotDue);
    let late = look(&Step { dt_s: 0.2, ..second }, (false, TurretMotion::Reached));
    assert_eq!(late, Decision::Hold(HoldReason::TurretRefused));
}

/// The offsets are made for a diameter: on another one they make another pitch.
#[test]
fn another_diameter_than_the_stated_one_is_not_acted_on() {
    let avoidance = Avoidance::new(settings(false)).unwrap();
    for (share, moves) in [(0.97, true), (0.93, false), (f64::NAN, false)] {
        let mut state = avoidance.start(1, 100.0);
        let seen = Situation { diameter_m: Some(share * DIAMETER_M), ..World::new().go_on(&good_second()) };
        let decision = avoidance.decide(&mut state, &seen);
        assert_eq!(is_move(&decision), moves, "{share} {decision:?}");
        assert!(moves || decision == Decision::Hold(HoldReason::OutsideLimits));
    }
}

/// Which way the spindle turns changes neither the waves nor the pitch.
#[test]
fn a_spindle_that_turns_the_other_way_is_acted_on_alike() {
    let decided = decisions(&vec![Step { speed_rpm: Some(-1200.0), ..good_second() }; 2]);
    assert_eq!(decided, decisions(&vec![good_second(); 2]));
    assert!(is_move(&decided[0]));
}

/// I15: commands and holds together are the intervals that passed.
#[test]
fn every_interval_ends_in_one_decision() {
    let phases = [Phase::Quiet, Phase::Suspected, Phase::Learning];
    let steps: Vec<Step> = (0..3000_usize)
        .map(|k| Step { dt_s: 0.01, phase: phases[k / 400 % 3], power_n2: 1.0, ..good_second() })
        .collect();
    for chatter in [false, true] {
        let mut steps = steps.clone();
        if chatter {
            // From the first look on, so that no onset comes between two intervals.
            steps.iter_mut().for_each(|s| (s.phase, s.power_n2) = (Phase::Chatter, 100.0));
        }
        let counted = run(&steps, HONEST, FAITHFUL);
        let decided = counted.commands.len() as u64 + counted.holds;
        // 30 s in looks of 10 ms: an interval ends with the first look after it. Chatter at once is one more.
        assert!((29..=31).contains(&decided), "{decided}");
        assert!(counted.violations.is_empty());
    }
}

/// The way to the pitch takes longer than one interval: it is judged where the turret stands, not before.
#[test]
fn a_slow_turret_is_judged_when_it_has_arrived() {
    let decided = decisions(&vec![good_second(); 6]);
    assert!(is_move(&decided[0]) && is_renewal(&decided[1]) && is_renewal(&decided[2]), "{decided:?}");
    let target = |k: usize| match decided[k] {
        Decision::Command(c) => c.offsets_m,
        _ => panic!("{decided:?}"),
    };
    assert!(target(0) != target(1) && target(1) == target(2), "on the way, then there");
    assert!(is_move(&decided[3]), "two intervals there did not help: {decided:?}");
}

#[test]
fn a_held_turret_stays_where_it_is_and_is_moved_once_it_is_let_go() {
    let held = Step { operator_hold: true, ..good_second() };
    let none = decisions(&vec![held.clone(); 3]);
    assert_eq!(none, vec![Decision::Hold(HoldReason::OperatorHold); 3]);
    let mut steps = vec![good_second(); 3];
    steps.extend(vec![held; 5]);
    steps.extend(vec![good_second(); 2]);
    let decided = decisions(&steps);
    assert!(decided[3..8].iter().all(is_renewal), "{decided:?}");
    let target = |d: &Decision| if let Decision::Command(c) = d { c.offsets_m } else { [f64::NAN; MAX_AXES] };
    assert!(decided[3..8].iter().all(|d| target(d) == target(&decided[2])));
    assert!(decided[8..].iter().any(is_move), "{decided:?}");
}

/// No sample for three seconds of a window that is not full: the command expires, the turret goes back by
/// itself, and that is no turret that is stuck.
#[test]
fn an_expired_command_is_no_stuck_turret() {
    let mut steps = vec![good_second(); 2];
    steps.extend(vec![Step { window_full: false, phase: Phase::Learning, ..good_second() }; 6]);
    steps.extend(vec![good_second(); 3]);
    let decided = decisions(&steps);
    assert!(is_move(&decided[8]), "{decided:?}");
    assert!(!decided.contains(&Decision::Hold(HoldReason::TurretNotReached)));
}

/// Axes that reach to the other side only: the pitch is as large, and negative.
#[test]
fn the_pitch_goes_to_the_side_that_the_axes_reach() {
    let mut there = settings(false);
    let axes = there.turret.axes().map(|a| TurretAxis {
        lowest_m: -1.2e-3,
        highest_m: if a.index == 1 { 0.0 } else { 1.2e-3 },
        ..a
    });
    there.turret = TurretKinematics::new(axes).unwrap();
    let avoidance = Avoidance::new(there).unwrap();
    let (mut state, mut watch, mut world) = (avoidance.start(1, 100.0), watcher(), World::new());
    let seen = world.go_on(&good_second());
    let decision = avoidance.decide(&mut state, &seen);
    assert_eq!(watch.watch(&seen, &decision), Ok(()));
    assert!(matches!(decision, Decision::Command(c) if c.requested_pitch_rad < -0.08), "{decision:?}");
}

/// The monitor believes its own eyes: what the situation says of the samples does not count.
#[test]
fn the_monitor_counts_the_samples_itself() {
    let decide = |samples: &[(f64, u64, bool)]| {
        let avoidance = Avoidance::new(settings(false)).unwrap();
        let (mut state, mut watch) = (avoidance.start(1, 100.0), watcher());
        let mut world = World::new();
        watch.stream_begins(1000.0);
        samples.iter().for_each(|(t, n, good)| watch.sample(*t, *n, *good));
        let seen = world.go_on(&good_second());
        let decision = avoidance.decide(&mut state, &seen);
        assert!(matches!(decision, Decision::Command(_)));
        watch.watch(&seen, &decision)
    };
    let good: Vec<(f64, u64, bool)> = (0..1000).map(|n| (100.0 + 1e-3 * n as f64, n, true)).collect();
    assert_eq!(decide(&good), Ok(()));
    let spoilt = |change: fn(&mut Vec<(f64, u64, bool)>)| {
        let mut samples = good.clone();
        change(&mut samples);
        decide(&samples)
    };
    assert_eq!(spoilt(|s| s[500].2 = false), Err(Violation::Freshness), "no number inside the window");
    assert_eq!(spoilt(|s| s[500].1 = 499), Err(Violation::Freshness), "repeated");
    assert_eq!(spoilt(|s| s.truncate(900)), Err(Violation::Freshness), "100 ms old");
    assert_eq!(spoilt(|s| s[990..].iter_mut().for_each(|x| x.1 += 7)), Err(Violation::Freshness), "a gap");
    assert_eq!(decide(&[]), Err(Violation::Freshness));
}

#[test]
fn the_guard_lets_good_commands_through_and_stops_each_kind_of_bad_one() {
    let guard = Guard {
        lowest_m: [-REACH_M, -REACH_M, 0.0, 0.0, 0.0, 0.0],
        highest_m: [REACH_M, REACH_M, 0.0, 0.0, 0.0, 0.0],
        speed_m_s: [SPEED_M_S; MAX_AXES],
        acceleration_m_s2: [ACCELERATION_M_S2; MAX_AXES],
        direction_rad: [DIRECTIONS[0], DIRECTIONS[1], 0.0, 0.0, 0.0, 0.0],
        diameter_m: DIAMETER_M,
        largest_pitch_rad: 0.15,
    };
    let facts =
        Facts { now_s: 10.0, mode: Mode::Act, interlock_closed_s: Some(9.95), actual_m: [0.0; MAX_AXES] };
    let good = Command {
        epoch: 1,
        sequence: 1,
        issued_s: 10.0,
        based_on_s: 9.99,
        ttl_s: 2.5,
        kind: CommandKind::Move,
        pitch_difference_rad: 0.048_269_010_5,
        requested_pitch_rad: 0.05,
        offsets_m: [-0.3e-3, 0.4e-3, 0.0, 0.0, 0.0, 0.0],
    };
    let passes =
        |command: &Command, facts: &Facts| guard.pass(&mut GuardState::default(), command, facts).is_ok();
    assert!(passes(&good, &facts));
    let far = [0.0, 1.3e-3, 0.0, 0.0, 0.0, 0.0];
    let bad = [
        Command { offsets_m: far, ..good },
        Command { offsets_m: [0.0, 0.7e-3, 0.0, 0.0, 0.0, 0.0], ..good },
        Command { offsets_m: [f64::NAN; MAX_AXES], ..good },
        Command { offsets_m: [0.0, 0.0, 1e-6, 0.0, 0.0, 0.0], ..good },
        Command { pitch_difference_rad: 0.2, ..good },
        Command { pitch_difference_rad: 0.0, ..good },
        Command { offsets_m: [0.2e-3, 0.7e-3, 0.0, 0.0, 0.0, 0.0], ..good },
        Command { ttl_s: 3.0, ..good },
        Command { ttl_s: 0.0, ..good },
        Command { based_on_s: 9.9, ..good },
        Command { based_on_s: 10.1, ..good },
        Command { kind: CommandKind::Return, ..good },
    ];
    assert!(bad.iter().all(|c| !passes(c, &facts)));
    let worse = [
        Facts { mode: Mode::Advise, ..facts },
        Facts { interlock_closed_s: None, ..facts },
        Facts { interlock_closed_s: Some(9.7), ..facts },
        Facts { now_s: f64::NAN, ..facts },
    ];
    assert!(worse.iter().all(|f| !passes(&good, f)));
    let mut state = GuardState::default();
    assert!(guard.pass(&mut state, &good, &facts).is_ok());
    assert!(guard.pass(&mut state, &good, &facts).is_err(), "the same number twice");
    let soon = Facts { now_s: 10.5, interlock_closed_s: Some(10.5), ..facts };
    assert!(guard.pass(&mut state, &Command { sequence: 2, based_on_s: 10.5, ..good }, &soon).is_err());
    let back = Command {
        sequence: 2,
        kind: CommandKind::Return,
        offsets_m: [0.0; 6],
        pitch_difference_rad: 0.0,
        ..good
    };
    let lost = [f64::NAN; MAX_AXES];
    let open = Facts { interlock_closed_s: None, mode: Mode::Observe, actual_m: lost, ..soon };
    assert!(guard.pass(&mut state, &back, &open).is_ok(), "going back waits for nothing");
    let unlimited = Guard { speed_m_s: [0.0; MAX_AXES], acceleration_m_s2: [0.0; MAX_AXES], ..guard };
    let still = Facts { actual_m: lost, ..facts };
    assert_eq!(guard.pass(&mut GuardState::default(), &good, &still), Err(Refusal::NotFinite));
    assert_eq!(unlimited.pass(&mut GuardState::default(), &good, &facts), Err(Refusal::Rate));
}

#[test]
fn every_reason_has_its_own_name() {
    let mut names: Vec<&str> = HoldReason::ALL.iter().map(|r| r.name()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), HoldReason::ALL.len());
}
