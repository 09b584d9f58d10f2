//! From the selection to what is said: verdict, findings, corrections, the model, the proof.

use super::case::{Case, Drives, Found};
use super::closed_loop::closed_loop;
use super::corrections::corrections;
use super::evidence::{least_seen_n, level};
use super::faults::force_faults;
use super::heldout::{Named, Written, fit_taken_out, foretold_n, without};
use super::laws::current_loop_lag::CurrentLoop;
use super::laws::dead_time::Delay;
use super::laws::{Deviations, Hypothesis, Shape, scale_deviation};
use super::likelihood::Design;
use super::model::{is_other_size, sizes};
use super::notes;
use super::numbers::{self, Absent, AsWritten, Doubt, as_written, doubt, held, stated_beta};
use super::rest::{Rest, rest, rest_of, spans_s};
use super::series::{Residuals, contribution, contribution_of_number, residuals};
use super::signals::Track;
use super::state::{Accepted, Balance, Number, State};
use super::subject::{PASSES, takes};
use super::words::{specification, statement, term_of, told};
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::diagnosis::result::{
    Alternative, Correction, DetectionLimit, Diagnosis, Estimate, Finding, Fit, Location, MapEstimate,
    RecordingFit, TimeSpans, Tried, Verdict,
};
use crate::diagnosis::selection::{Fitted, probabilities};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::{
    EffectKind, ParameterValue, PhysicsTerm, Port, Role, coulomb_friction, viscous_friction,
};
use crate::signal::inner_products::rms;

/// True where a law's size is as far from zero as a number must be from its statement to be wrong, and the
/// 95 % interval that is told does not hold zero. Sizes that stand in a shape do not.
pub(super) fn is_other_than_zero(
    balance: &Balance,
    (state, law): (&State, &Accepted),
    d: &Deviations,
) -> bool {
    if law.hypothesis.has_dose() {
        return true;
    }
    // Of a bristle the force: what remains without it is a damper. It is the level of dry friction, and that
    // is there as a number is that the model leaves out.
    let (count, least) = if law.hypothesis.facts().turns_friction {
        (1, Z95)
    } else {
        (law.amplitudes.len(), Criteria::STANDARD.correction_deviations)
    };
    let sized = |(a, d): (&f64, &f64)| a.abs() > least * d;
    let of = specification(law.hypothesis.effect);
    let is_size = |e: &&Estimate| of.parameter(&e.name).is_some_and(|p| p.role == Role::Size);
    let estimates = told(&law.hypothesis, &state.told(balance, law, d)).0;
    let mut sizes = estimates.iter().filter(is_size).map(|e| e.ci95[0] * e.ci95[1] > 0.0).peekable();
    law.amplitudes.iter().zip(&d.amplitudes).take(count).any(sized)
        && (sizes.peek().is_none() || sizes.any(|told| told))
}

/// True where a law is not told from nothing, or is none with what was fitted.
fn is_untold(balance: &Balance, state: &State, law: &Accepted, d: &Deviations) -> bool {
    !is_other_than_zero(balance, (state, law), d)
        || law.hypothesis.law().is_void(&state.ground(balance), &law.amplitudes)
}

/// Drops laws that the recordings do not determine, or puts in the place of one what it becomes at a bound
/// of its constants; what is left is built anew. Of two that stand for one another neither is determined: the
/// one goes that the other does without at the least loss.
fn determined(balance: &Balance, mut state: State) -> (State, Doubt) {
    loop {
        let left = rest(balance, &state);
        let doubt = doubt(balance, &state, &left);
        let most_n = foretold_n(balance, state.base.fitted()) / (1.0 + Criteria::STANDARD.exactness);
        let others_if_vague = |(k, (a, d)): (usize, (&Accepted, &Deviations))| {
            let told = if a.hypothesis.facts().trades { 1 } else { d.constants.len() };
            let vague = d.constants.iter().take(told).any(|c| *c > Criteria::STANDARD.undetermined)
                || a.hypothesis.is_at_bound()
                || is_untold(balance, &state, a, d);
            if let Some(limit) = a.hypothesis.law().limit(&balance.signals, &d.constants).filter(|_| vague) {
                return Some(state.with_form(balance, k, limit));
            }
            // Or the others foretell what was held out better: each part has been told by itself.
            let others = without(balance, &state, Named::Law(k));
            (vague || foretold_n(balance, others.base.fitted()) < most_n).then_some(others)
        };
        let found = |(_, (a, _)): &(usize, (&Accepted, &Deviations))| a.given.is_none();
        let pairs = state.accepted.iter().zip(&doubt.laws).enumerate();
        let without = pairs.filter(found).filter_map(others_if_vague);
        match without.min_by(|a, b| a.base.fit.nats.total_cmp(&b.base.fit.nats)) {
            Some(others) => state = rebuilt(balance, others),
            None => return (state, doubt),
        }
    }
}

/// A state from which a law is gone: numbers had moved beside it.
fn rebuilt(balance: &Balance, others: State) -> State {
    (0..PASSES).fold(others, |state, _| state.rebuilt(balance))
}

/// Share of the power that was left before and is not left now, less what never repeats, N.
fn explained_share([before, left]: [&Rest; 2], repeats_n: f64) -> f64 {
    1.0 - (left.force_n.powi(2) - repeats_n.powi(2)).max(0.0) / before.force_n.max(1e-300).powi(2)
}

impl Case<'_> {
    /// The answer for a state.
    pub(super) fn answer(self, state: State) -> Diagnosis {
        let balance = self.balance;
        let (AsWritten { state, doubt, absent, unsaid, contested, undivided }, level) = self.written(state);
        let held = held(&unsaid, &contested);
        let mut found = self.found(&state, &doubt, &absent, level);
        found.extend(self.of_encoders(&state));
        // The model says how much it leaves, and no more is left.
        let of_start = rest(balance, self.start);
        let as_stated = self.stated_rest_n > 0.0 && !of_start.is_left(self.stated_rest_n);
        let mut settled = doubt.clone();
        if as_stated {
            // Of what is left in the balance, not above it.
            found.retain(|f| matches!(f.named, Named::Error(_)));
            settled = numbers::doubt(balance, self.start, &of_start);
        }
        let said: Vec<Number> = absent.iter().map(|a| a.number).collect();
        let before = self.before(&said, &contested);
        let left = rest(balance, &state);
        let of = if as_stated { self.start } else { &state };
        let told_wrong = self.all_corrections(of, &settled);
        let nothing_told = found.is_empty() && told_wrong.is_empty();
        let drives = self.drives(&state, nothing_told);
        let undivided = undivided.filter(|_| !as_stated);
        let outweighed = !as_stated && found.iter().any(|f| self.is_outweighed(f));
        let series = self.series(&state);
        let is_compared = balance.plan.white && !as_stated && !nothing_told;
        let worse_n = is_compared.then(|| self.worse_n(&series, level)).flatten();
        let not_named = drives.is_unsaid() || undivided.is_some() || outweighed || worse_n.is_some();
        let is_left = left.is_left(self.stated_rest_n) || not_named;
        let share = explained_share([&before, &left], Criteria::STANDARD.repeatability * drives.thrust_n);
        let explains = !is_left || share > Criteria::STANDARD.named_share;
        let stands = !outweighed && worse_n.is_none();
        let named = !found.is_empty() && explains && drives.are_said_by(&found) && stands;
        let bent = self.out_of_budget && found.is_empty() && !told_wrong.is_empty();
        let unexplained = is_left && !named || bent;
        let corrections = if unexplained { Vec::new() } else { told_wrong.clone() };
        let verdict = verdict(unexplained, found.is_empty(), corrections.is_empty());
        let mut candidates = self.candidates(&found, !unexplained);
        candidates.extend(self.undivided(&unsaid, undivided));
        let mut notes = self.notes_of((&left, &drives), is_left, &candidates);
        let faults = force_faults((self.axis, self.recordings), balance, &state, &doubt);
        let (force_faults, more) = notes::budget(&self, faults, found.is_empty());
        let kept = notes::kept(&contested).chain(worse_n.map(notes::worse));
        notes.extend(more.into_iter().chain(self.notes_of_errors()).chain(kept));
        let asserted = if unexplained { Vec::new() } else { found };
        let first = asserted.first().map(|f| f.named);
        let findings = self.findings(asserted, (&state, &held), &left);
        let said = (&findings[..], &corrections[..]);
        let model = self.model(verdict, (of, &settled), said, (&left, is_left));
        let axes = [
            self.stated.clone(),
            self.recalibrated(&state, &doubt, &told_wrong),
            model.axis(&self.stated.name).unwrap_or(self.stated).clone(),
        ];
        let limits = self.detection_limits(&state, level, &findings);
        let closed_loop = closed_loop(&balance.signals, &axes, self.recordings, &state);
        let location = self.location(verdict, (findings.first(), first), &left, (&state, &held));
        Diagnosis {
            axis: self.stated.name.clone(),
            verdict,
            location,
            findings,
            unexplained: self.unexplained(&state, (&left, is_left), &drives),
            candidates,
            residual_band_hz: [0.0, balance.signals.top_hz()],
            force_faults,
            parameter_corrections: corrections,
            recordings: self.recording_fits(&series, unexplained),
            left_out: Vec::new(),
            no_evidence: None,
            balances: balance.signals.sides_named().to_vec(),
            series_rate_hz: balance.signals.thin_rate_hz(),
            noise_floor_n: left.floors_n[..balance.signals.sides()].to_vec(),
            tried: self.tried(),
            detection_limits: limits,
            model,
            notes,
            closed_loop,
        }
    }

    /// What is written of a state, and what chance reaches: of laws those that are determined there, too.
    fn written(&self, mut state: State) -> (AsWritten, f64) {
        let balance = self.balance;
        loop {
            let (all, doubt) = determined(balance, state);
            let level = self.level(&all);
            let written = as_written((balance, self.stated), (&all, doubt), (level, self.stated_rest_n));
            let is_gone = |(a, d): (&Accepted, &Deviations)| {
                a.given.is_none() && is_untold(balance, &written.state, a, d)
            };
            match written.state.accepted.iter().zip(&written.doubt.laws).position(is_gone) {
                Some(k) => state = rebuilt(balance, without(balance, &all, Named::Law(k))),
                None => return (written, level),
            }
        }
    }

    /// What a state leaves of what drives the axis.
    fn drives(&self, state: &State, nothing_told: bool) -> Drives {
        let (_, design, beta) = state.base.fitted();
        let left_n = self.left_n(state, (design, beta));
        let stated_n = || {
            let stated = numbers::fitted_as_stated(self.balance, self.start);
            self.left_n(self.start, (&self.start.base.design, &stated))
        };
        Drives {
            left_n,
            judged_n: if nothing_told { left_n.max(stated_n()) } else { left_n },
            thrust_n: self.left_n(state, (design, &vec![0.0; beta.len()])),
            beside_loads_n: self.thrust_beside_loads_n(state),
        }
    }

    /// The thrust less loads that were found: the mean of a column is nothing that drives an axis.
    fn thrust_beside_loads_n(&self, state: &State) -> f64 {
        let (_, design, beta) = state.base.fitted();
        let mut loads = vec![0.0; beta.len()];
        for (k, law) in state.accepted.iter().enumerate() {
            if law.given.is_none() && law.hypothesis.effect == EffectKind::GravityLoad {
                loads[state.place(k)] = beta[state.place(k)];
            }
        }
        self.left_n(state, (design, &loads))
    }

    /// What the stated model leaves, and a state.
    pub(super) fn series(&self, state: &State) -> Residuals {
        let stated = stated_beta(self.balance, self.start, state.now.inertial);
        let series = residuals(self.balance, (self.start, &stated), state);
        series.with(&self.error_forces(self.start))
    }

    /// What is left in time, N, by the stated model and with all that was found, where the latter is less
    /// likely by more than chance reaches, noise of each recording's own size: what was found stands where
    /// nothing was measured. Of two positions the bands have weights, and a right mass may leave more of the
    /// noise.
    fn worse_n(&self, series: &Residuals, level_nats: f64) -> Option<[f64; 2]> {
        let fits = self.recording_fits(series, false);
        let tracks = || self.balance.signals.tracks.iter().zip(&fits);
        let judged = |track: &Track| track.judged().iter().filter(|judged| **judged).count() as f64;
        let more_nats = |(track, f): (&Track, &RecordingFit)| {
            judged(track) * (f.rms_after_n / f.rms_before_n.max(f64::MIN_POSITIVE)).ln()
        };
        let all = tracks().map(|(track, _)| judged(track)).sum::<f64>().max(1.0);
        let rms_n = |of: &dyn Fn(&RecordingFit) -> f64| {
            (tracks().map(|(track, f)| judged(track) * of(f).powi(2)).sum::<f64>() / all).sqrt()
        };
        let is_worse = tracks().map(more_nats).sum::<f64>() > level_nats;
        is_worse.then(|| [rms_n(&|f| f.rms_before_n), rms_n(&|f| f.rms_after_n)])
    }

    /// What coefficients leave of the thrust at the motor, root mean square, N.
    fn left_n(&self, state: &State, (design, beta): (&Design, &[f64])) -> f64 {
        let bands = state.base.all.iter();
        let power: f64 = bands.map(|band| design.spread(band, beta)[0] * band.values).sum();
        (power / self.samples()).sqrt()
    }

    /// What evidence has to exceed: as it was asked last.
    fn level(&self, state: &State) -> f64 {
        let last = self.rounds.last().and_then(|round| round.fitted.first());
        last.map_or_else(|| level(state, (1, 0.0)), |fitted| fitted.level_nats)
    }

    fn samples(&self) -> f64 {
        self.balance.plan.measured().max(1.0)
    }

    pub(super) fn found(&self, state: &State, doubt: &Doubt, absent: &[Absent], level: f64) -> Vec<Found> {
        let balance = self.balance;
        let mut list = Vec::new();
        let is_found = |a: &Accepted| a.given.is_none() && !a.hypothesis.facts().is_number;
        let laws = state.accepted.iter().zip(&doubt.laws).enumerate().filter(|(_, (a, _))| is_found(a));
        let laws = laws.map(|(k, (law, sd))| (law, sd, state, Named::Law(k)));
        let path = self.found_in_path(state, doubt);
        let of_path = path.iter().map(|(law, sd, named)| (law, sd, self.start, *named));
        for (law, sd, of, named) in laws.chain(of_path) {
            let h = &law.hypothesis;
            let (estimates, term) = told(h, &state.told(balance, law, sd));
            let (evidence_nats, level_nats) = self.evidence_of(h.effect, h.port);
            list.push(Found {
                term,
                estimates,
                evidence_nats,
                level_nats,
                contribution: contribution(balance, of, law, self.recordings),
                named,
            });
        }
        let scale = scale_deviation(balance);
        for a in absent {
            let Some(effect) = a.number.effect() else { continue };
            let dry = effect == EffectKind::CoulombFriction;
            let of = if dry { &coulomb_friction::FORCE } else { &viscous_friction::COEFFICIENT };
            let port = Absent::port_of(balance, a.number);
            let half = Z95 * a.deviation.hypot(scale * a.value);
            let estimates = vec![Estimate::within(of, a.value, half)];
            list.push(Found {
                term: term_of(effect, port, &estimates),
                estimates,
                evidence_nats: a.evidence_nats,
                level_nats: level,
                contribution: contribution_of_number(balance, state, a.number, self.recordings),
                named: Named::Number(a.number),
            });
        }
        list.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
        list
    }

    /// A dead time longer than stated, a current loop slower than stated.
    fn found_in_path(&self, state: &State, doubt: &Doubt) -> Vec<(Accepted, Deviations, Named)> {
        let balance = self.balance;
        let found = |law: Shape, deviation: f64, named: Named| {
            let deviations = Deviations { amplitudes: vec![0.0], constants: vec![deviation] };
            (Accepted::found(Hypothesis::new(Port::Current, law), vec![1.0]), deviations, named)
        };
        let extra_s = state.now.path.delay_s - balance.drive.amplifier_dead_time_s();
        // What a loop took the place of may have left nothing of a delay.
        let within_s = balance.timing_deviation_s(state.coulomb_n());
        let is_late = state.now.found_delay && extra_s > Z95 * doubt.path[0].hypot(within_s);
        let late = Delay { extra_s, early: false };
        let delay = is_late.then(|| found(late.into(), doubt.path[0] / extra_s, Named::Delay));
        // What was a loop before the encoders were put together may be the one that is stated.
        let stated_rad_s = balance.drive.current_loop_bandwidth_rad_s().unwrap_or(f64::INFINITY);
        let is_slow =
            |rad_s: &f64| (stated_rad_s / rad_s).ln() > Z95 * doubt.path[1].hypot(within_s * *rad_s);
        let bandwidth = state.now.path.loop_rad_s.filter(|_| state.now.found_loop).filter(is_slow);
        let lag = |rad_s| {
            found(CurrentLoop { rad_s, in_place: false, quicker: false }.into(), doubt.path[1], Named::Loop)
        };
        delay.into_iter().chain(bandwidth.map(lag)).collect()
    }

    /// The round in which a law was taken up, the law first.
    fn round_of(&self, effect: EffectKind, port: Port) -> &[Fitted<Hypothesis, State>] {
        let mut rounds = self.known.iter().chain(self.rounds);
        let round = rounds.find(|r| takes(r, effect, port));
        round.map_or(&[], |r| &r.fitted)
    }

    /// What was fitted last and not taken up.
    pub(super) fn asked_in_vain(&self) -> &[Fitted<Hypothesis, State>] {
        self.rounds.last().filter(|round| !round.accepted).map_or(&[][..], |round| &round.fitted)
    }

    /// True where, beside what was asked with a law, something else had a constant at a bound and still says
    /// more at the end than the law ever did: that stood in for what no law tells.
    fn is_outweighed(&self, found: &Found) -> bool {
        if !matches!(found.named, Named::Law(_) | Named::Delay | Named::Loop) {
            return false;
        }
        let named = |f: &Fitted<Hypothesis, State>| (f.hypothesis.effect, f.hypothesis.port);
        let held = |f: &&Fitted<Hypothesis, State>| f.hypothesis.is_at_bound();
        let asked_with = self.round_of(found.term.effect, found.term.port);
        let still =
            self.asked_in_vain().iter().filter(held).filter(|f| f.evidence_nats > found.evidence_nats);
        still.map(named).any(|still| asked_with.iter().filter(held).any(|f| named(f) == still))
    }

    /// Evidence and level with which a law was taken up.
    fn evidence_of(&self, effect: EffectKind, port: Port) -> (f64, f64) {
        self.round_of(effect, port).first().map_or((0.0, 1.0), |f| (f.evidence_nats, f.level_nats))
    }

    pub(super) fn findings(
        &self,
        found: Vec<Found>,
        (state, held): (&State, &[Number]),
        left: &Rest,
    ) -> Vec<Finding> {
        let floor = left.floors_n[0].hypot(left.floors_n[1]);
        if found.is_empty() {
            return Vec::new();
        }
        let stepped = found.iter().filter_map(|f| self.stepped(f)).collect();
        let errors_n2 = self.error_forces(state).iter().map(|(port, force)| (*port, force.power())).collect();
        let written = Written { state, held, stepped, errors_n2 };
        let left_n = |named: Option<Named>| written.heldout_n(self.balance, named);
        let after_n = left_n(None);
        let of = |(k, f): (usize, Found)| {
            let (probability, alternatives) = self.probabilities(&f);
            let next = alternatives.first().filter(|a: &&Alternative| a.probability > 0.05);
            let maps = f.term.parameters.iter().filter_map(|(name, value)| match value {
                ParameterValue::List(values) => {
                    Some(MapEstimate { name: name.clone(), values: values.clone() })
                }
                ParameterValue::Number(_) => None,
            });
            let PhysicsTerm { effect, port, .. } = f.term;
            Finding {
                rank: k + 1,
                effect,
                port,
                statement: statement(effect, port, &f.estimates),
                equation: specification(effect).equation,
                maps: maps.collect(),
                fit: Fit {
                    heldout_rms_before_n: left_n(Some(f.named)),
                    heldout_rms_after_n: after_n,
                    noise_floor_n: floor,
                },
                probability,
                next_experiment: next.map(|a| specification(a.effect).told_apart_by.to_owned()),
                alternatives,
                contribution: f.contribution,
                parameters: f.estimates,
                term: f.term,
                evidence: 2.0 * f.evidence_nats,
            }
        };
        found.into_iter().enumerate().map(of).collect()
    }

    /// Of a finding and of what else was fitted in its round; "nothing" has the level.
    fn probabilities(&self, f: &Found) -> (f64, Vec<Alternative>) {
        let others = self.round_of(f.term.effect, f.term.port).iter().skip(1);
        let others: Vec<_> = others.filter(|o| !o.at_bound && o.evidence_nats > 0.0).collect();
        let mut evidence = vec![f.evidence_nats];
        evidence.extend(others.iter().map(|o| o.evidence_nats.min(f.evidence_nats)));
        let temper = Criteria::STANDARD.temper_share * f.level_nats;
        let p = probabilities(&evidence, f.level_nats, temper);
        let alternatives = others.iter().zip(&p[1..]).map(|(o, p)| Alternative {
            effect: o.hypothesis.effect,
            port: o.hypothesis.port,
            probability: *p,
        });
        (p[0], alternatives.filter(|a| a.probability > 1e-3).collect())
    }

    /// Numbers of the structure and of stated laws that stand elsewhere.
    fn all_corrections(&self, state: &State, doubt: &Doubt) -> Vec<Correction> {
        let mut list = corrections(self.balance, self.stated, state, doubt);
        for (law, sd) in state.accepted.iter().zip(&doubt.laws) {
            let Some(index) = law.given else { continue };
            if let Some((key, nominal)) = self.size_of(index)
                && is_other_size(law.scale, sd.amplitudes.first().copied().unwrap_or(0.0))
            {
                let effect = self.axis.physics[index].effect.name();
                let (value, half) = (nominal * law.scale, Z95 * nominal.abs() * sd.amplitudes[0]);
                list.push(Correction::within(format!("{effect}.{key}"), nominal, value, half));
            }
        }
        for error in self.errors.iter().filter(|e| e.is_other_size()) {
            let Estimate { name, value, ci95, .. } = self.told_error(error, state).0.swap_remove(0);
            let name = format!("{}.{name}", error.law.hypothesis.effect.name()).into();
            list.extend(error.stated_m.map(|nominal| Correction { name, nominal, value, ci95 }));
        }
        list
    }

    /// The key of a stated law that its size is in.
    fn size_of(&self, index: usize) -> Option<(&'static str, f64)> {
        let term = &self.axis.physics[index];
        sizes(term.effect).find_map(|p| term.value(p).map(|value| (p.name, value)))
    }

    pub(super) fn location(
        &self,
        verdict: Verdict,
        (first, named): (Option<&Finding>, Option<Named>),
        left: &Rest,
        (state, held): (&State, &[Number]),
    ) -> Option<Location> {
        if matches!(verdict, Verdict::ModelAdequate | Verdict::ParameterError) {
            return None;
        }
        // Where the answer is wrong without the finding alone.
        let (shown, of) = match named {
            None => (left.clone(), state.clone()),
            Some(Named::Steps(port) | Named::Error(port)) if !self.balance.signals.balances(port) => {
                return first.map(|finding| self.above_balance(finding));
            }
            Some(Named::Steps(_)) => (rest(self.balance, self.start), self.start.clone()),
            Some(Named::Error(_)) => {
                let shown = self.as_read(state, &state.base.fit.beta);
                (shown.unwrap_or_else(|| left.clone()), state.clone())
            }
            Some(_) => {
                let (others, design, beta) = fit_taken_out(self.balance, state, named, held);
                (rest_of(self.balance, &others, (&design, &beta)), others)
            }
        };
        let time = (0..self.recordings.len())
            .map(|r| TimeSpans { recording: r, spans_s: spans_s(self.balance, &of, r, shown.band_hz) })
            .collect();
        let port = first.map_or(left.port, |f| f.port);
        Some(Location {
            port,
            domain: first.map_or("time", |f| specification(f.effect).domain),
            bands_hz: vec![shown.band_hz],
            time,
            shares: shown.shares,
        })
    }

    pub(super) fn recording_fits(&self, series: &Residuals, unexplained: bool) -> Vec<RecordingFit> {
        let s = &self.balance.signals;
        let power = |sides: &[Vec<f64>], judged: &[bool]| {
            let of = |x: &Vec<f64>| {
                let kept = x.iter().zip(judged).filter(|(_, judged)| **judged).map(|(v, _)| *v);
                rms(&kept.collect::<Vec<f64>>()).powi(2)
            };
            (sides.iter().map(of).sum::<f64>() / sides.len().max(1) as f64).sqrt()
        };
        let blank = |sides: &[Vec<f64>], judged: &[bool]| -> Vec<Vec<f64>> {
            let of = |x: &Vec<f64>| x.iter().zip(judged).map(|(v, j)| if *j { *v } else { 0.0 }).collect();
            sides.iter().map(of).collect()
        };
        let of = |(r, track): (usize, &Track)| {
            let after = if unexplained { &series.before[r] } else { &series.after[r] };
            let written = if unexplained { &series.nominal[r] } else { &series.after[r] };
            let judged = track.judged();
            RecordingFit {
                experiment: track.experiment.clone(),
                rms_before_n: power(&series.nominal[r], &judged),
                rms_after_n: power(written, &judged),
                t_s: (0..track.thin_count()).map(|j| track.start_s + track.thin_s(j, s.step)).collect(),
                measured: track.masked.iter().map(|m| !m).collect(),
                position_m: track.thin.position.clone(),
                velocity_m_s: track.thin.velocity[s.sides() - 1].clone(),
                residual_nominal_n: blank(&series.nominal[r], &judged),
                residual_before_n: blank(&series.before[r], &judged),
                residual_after_n: blank(after, &judged),
            }
        };
        s.tracks.iter().enumerate().map(of).collect()
    }

    /// What would have been seen of every law that was asked and is no finding, beside what was found.
    fn detection_limits(&self, state: &State, level: f64, findings: &[Finding]) -> Vec<DetectionLimit> {
        let asked = self.rounds.last().map_or(&[][..], |r| &r.screened);
        let is_law = |h: &&Hypothesis| !h.facts().is_number && !h.facts().is_of_one_recording && !h.is_map();
        let is_found = |h: &Hypothesis| findings.iter().any(|f| f.effect == h.effect && f.port == h.port);
        let open = asked.iter().map(|s| &s.hypothesis).filter(is_law);
        let open: Vec<&Hypothesis> = open.filter(|h| !is_found(h)).collect();
        let limits = on_two_cores(&open, |h| least_seen_n(self.balance, state, h, level));
        let of = |(h, force_rms_n): (&&Hypothesis, Option<f64>)| {
            Some(DetectionLimit { effect: h.effect, port: h.port, force_rms_n: force_rms_n? })
        };
        open.iter().zip(limits).filter_map(of).collect()
    }

    fn tried(&self) -> Vec<Tried> {
        let Some(round) = self.rounds.first() else { return Vec::new() };
        let fitted = round.fitted.iter().map(|f| (f.hypothesis, f.evidence_nats));
        let screened = round.screened.iter().map(|s| (s.hypothesis, s.promise_nats));
        let mut list: Vec<Tried> = Vec::new();
        for (h, nats) in fitted.chain(screened) {
            if !h.facts().is_number && !list.iter().any(|t| t.effect == Some(h.effect) && t.port == h.port) {
                list.push(Tried { effect: Some(h.effect), port: h.port, evidence: (2.0 * nats).max(0.0) });
            }
        }
        list.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        list
    }
}

/// What is said of a model where so much was found.
fn verdict(unexplained: bool, nothing_found: bool, nothing_wrong: bool) -> Verdict {
    match (unexplained, nothing_found, nothing_wrong) {
        (true, ..) => Verdict::UnexplainedMismatch,
        (_, false, _) => Verdict::MissingPhysics,
        (_, _, true) => Verdict::ModelAdequate,
        _ => Verdict::ParameterError,
    }
}
