//! What is said of the encoders: steps that are coarser than stated, and what they read wrong.

use super::case::{Case, Found};
use super::columns::TimeColumn;
use super::encoders::ReadError;
use super::evidence::level;
use super::heldout::{Named, Stepped};
use super::numbers::{Beside, fit_as_stated, held};
use super::recorded::position_at;
use super::rest::{Rest, rest_of};
use super::series::of_recording;
use super::signals::Track;
use super::state::{Number, State};
use super::words::{specification, term_of, told};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::encoder_noise::variance_m2;
use crate::diagnosis::result::{Estimate, Finding, Location, TimeSpans};
use crate::diagnosis::steps::{coarser_step_of_all, off_steps_m, stated_step_m};
use crate::plant::effects::encoder_quantization::STEP;
use crate::plant::effects::{EffectKind, PhysicsTerm, Port};
use crate::sample::Recording;
use crate::units::engineering;

impl Case<'_> {
    /// What encoders read wrong and no model says.
    pub(super) fn unstated_errors(&self) -> impl Iterator<Item = &ReadError> {
        self.errors.iter().filter(|error| error.stated_m.is_none())
    }

    /// An encoder's error for people and as a term of a model.
    pub(super) fn told_error(&self, error: &ReadError, state: &State) -> (Vec<Estimate>, PhysicsTerm) {
        told(&error.law.hypothesis, &state.told(self.balance, &error.law, &error.deviations))
    }

    /// Where an encoder is off whose position is not balanced: above the balance, all of the time.
    pub(super) fn above_balance(&self, finding: &Finding) -> Location {
        let s = &self.balance.signals;
        let whole =
            |(recording, track): (usize, &Track)| TimeSpans { recording, spans_s: vec![track.span_s()] };
        Location {
            port: finding.port,
            domain: specification(finding.effect).domain,
            bands_hz: vec![[self.above_hz().max(s.top_hz()), 0.5 * s.rate_hz]],
            time: s.tracks.iter().enumerate().map(whole).collect(),
            shares: None,
        }
    }

    /// From where on both encoders read one motion, Hz.
    fn above_hz(&self) -> f64 {
        Criteria::STANDARD.band_share[0] * self.balance.signals.rate_hz
    }

    /// What the proof of each error is: it may be seen by no balance.
    pub(super) fn notes_of_errors(&self) -> impl Iterator<Item = String> {
        let above_hz = self.above_hz();
        self.unstated_errors().map(move |error| {
            format!(
                "Above {above_hz:.0} Hz both encoders differ by {}, without what the {} reads wrong by {} \
                 (root mean square).",
                engineering(error.apart_m[0], "m", 3),
                error.port().name().replace('_', " "),
                engineering(error.apart_m[1], "m", 3)
            )
        })
    }

    /// What an encoder reads wrong.
    fn read_wrong(&self, error: &ReadError, state: &State) -> Found {
        let all = self.recordings.iter().enumerate();
        let along = all.map(|(k, r)| of_recording(k, r, error.along_m(self.axis, r).unwrap_or_default()));
        let (estimates, term) = self.told_error(error, state);
        Found {
            term,
            estimates,
            evidence_nats: error.evidence_nats,
            level_nats: error.level_nats,
            contribution: along.collect(),
            named: Named::Error(error.port()),
        }
    }

    /// Those of an encoder whose position is balanced.
    fn balanced_errors(&self) -> impl Iterator<Item = &ReadError> {
        self.unstated_errors().filter(|error| self.balance.signals.balances(error.port()))
    }

    /// Force that an error of each encoder makes of the balance.
    pub(super) fn error_forces(&self, state: &State) -> Vec<(Port, TimeColumn)> {
        let ground = state.ground(self.balance);
        self.balanced_errors().map(|error| (error.port(), error.law.sum(&ground))).collect()
    }

    /// What the stated model leaves of the recordings as they came, numbers that are said or contested as it
    /// states them.
    pub(super) fn before(&self, said: &[Number], contested: &[Beside]) -> Rest {
        let (design, beta) = fit_as_stated(self.balance, self.start, &held(said, contested));
        let as_read = self.as_read(self.start, &beta);
        as_read.unwrap_or_else(|| rest_of(self.balance, self.start, (&design, &beta)))
    }

    /// What these coefficients leave of the recordings as they came; `None`: no balanced position is read
    /// wrong.
    pub(super) fn as_read(&self, state: &State, beta: &[f64]) -> Option<Rest> {
        self.balanced_errors().next()?;
        let mut with = state.clone();
        with.accepted.extend(self.balanced_errors().map(|error| error.law.clone()));
        let with = with.rebuilt(self.balance);
        let mut beta = beta.to_vec();
        beta.extend(self.balanced_errors().flat_map(|error| error.law.amplitudes.iter().map(|a| -a)));
        Some(rest_of(self.balance, &with, (&with.base.design, &beta)))
    }

    /// Steps of encoders that are coarser than stated, then what they read wrong: that is told above the band
    /// of the balance, by nats that are none of its own.
    pub(super) fn of_encoders(&self, state: &State) -> Vec<Found> {
        let steps = [Port::MotorEncoder, Port::StageEncoder].into_iter().filter_map(|p| self.encoder_step(p));
        steps.chain(self.unstated_errors().map(|error| self.read_wrong(error, state))).collect()
    }

    fn encoder_step(&self, port: Port) -> Option<Found> {
        let axis = self.axis;
        let raw = axis.drive.raw();
        // Without a stated step there is nothing to be coarser than.
        match port {
            Port::MotorEncoder => raw.motor_encoder_resolution_m,
            _ => raw.stage_encoder_resolution_m,
        }?;
        let read = |r: &Recording| Some((position_at(axis, r, port)?, r.sample_rate.hz()));
        let read: Vec<(Vec<f64>, f64)> = self.recordings.iter().map(read).collect::<Option<_>>()?;
        let step_m = coarser_step_of_all(&read, stated_step_m(axis, port))?;
        let read = read.iter().zip(self.recordings).enumerate();
        let level_nats = level(self.start, (1, 0.0));
        let ci95 = [0.98 * step_m, 1.02 * step_m];
        let estimates = vec![Estimate { ci95, ..Estimate::within(&STEP, step_m, 0.0) }];
        Some(Found {
            term: term_of(EffectKind::EncoderQuantization, port, &estimates),
            estimates,
            evidence_nats: 10.0 * level_nats,
            level_nats,
            contribution: read.map(|(k, ((x, _), r))| of_recording(k, r, off_steps_m(x, step_m))).collect(),
            named: Named::Steps(port),
        })
    }

    /// Noise that steps make, where those are what was found.
    pub(super) fn stepped(&self, found: &Found) -> Option<Stepped> {
        let Named::Steps(port) = found.named else { return None };
        if !self.balance.signals.balances(port) {
            return None;
        }
        let noise_m2 =
            |r: &Recording| Some(variance_m2(&position_at(self.axis, r, port)?, r.sample_rate.hz()));
        Some(Stepped { port, variance_m2: self.recordings.iter().map(noise_m2).collect::<Option<_>>()? })
    }
}
