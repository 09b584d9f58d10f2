//! What is heard becomes events, evidence and the table of past cuts.

use super::super::hub::Report;
use super::intake::Stream;
use super::{Engine, clock, picture};
use crate::pipeline::{Margin, StepOutput};
use crate::service::cut_book::{Condition, Stretch};
use crate::stability::margin::BLOCK_S;
use crate::stability::{CutExpectation, CutMismatch};
use crate::store::PastCut;
use crate::telemetry::{Event, EventKind};
use std::time::Instant;

impl Engine {
    /// Turns what a sample led to into events.
    pub(super) fn hear(&mut self, output: &StepOutput, stream: &Stream) {
        if let Some(warning) = &output.margin_warning {
            self.report(picture::margin_event(warning, stream.axes().get(warning.axis), output.t_s));
        }
        if let Some((_, event)) = &output.event {
            self.book.hear(output.t_s, event);
        }
        let Some((kind, text)) = picture::event_of(output) else { return };
        let line = output.event.map(|(axis, event)| (axis, picture::line_of(&event)));
        let mut event = Event::new(kind, clock::wall_ns(), text);
        event.t_s = Some(output.t_s);
        if let Some((axis, line)) = line {
            event.axis = stream.axes().get(axis).cloned();
            event.frequency_hz = line.map(|l| l.frequency_hz);
            event.power_n2 = line.map(|l| l.power_n2);
        }
        if kind == EventKind::ChatterOnset {
            self.save_around(kind.word(), "chatter began");
        }
        let heard_hz = event.frequency_hz.filter(|_| kind == EventKind::ChatterOnset);
        self.report(event);
        if let Some(heard_hz) = heard_hz {
            self.compare_cut(output.t_s, heard_hz, stream);
        }
    }

    /// Chatter that the stated cut does not allow, told once for each way in which it differs.
    fn compare_cut(&mut self, t_s: f64, heard_hz: f64, stream: &Stream) {
        let Some(speed_rpm) = stream.newest.as_ref().map(|p| p.spindle_speed_rpm).filter(|s| *s > 1.0) else {
            return;
        };
        let Some(pitch_rad) = self.pitch_rad(stream) else { return };
        let expected = CutExpectation::of(&self.setup.config.cut, speed_rpm, pitch_rad);
        if let Some(mismatch) = expected.mismatch(heard_hz) {
            self.tell_cut(mismatch, (t_s, pitch_rad), Some(heard_hz));
        }
    }

    /// Silence that the stated cut does not allow, or with another margin than it has.
    fn compare_silence(&mut self, stretch: &Stretch, margin: Option<Margin>) {
        let Condition { speed_rpm, pitch_rad, tool_position_m } = stretch.condition;
        let cut = &self.setup.config.cut;
        let expected = match tool_position_m.zip(stretch.nearest_m) {
            Some((far_m, near_m)) => CutExpectation::at(cut, [speed_rpm, pitch_rad], &[near_m, far_m]),
            None => CutExpectation::of(cut, speed_rpm, pitch_rad),
        };
        let margin_1_s = margin.map(|m| [m.lo_1_s, m.hi_1_s]);
        if let Some(mismatch) = expected.mismatch_of_silence(stretch.ended_s - stretch.began_s, margin_1_s) {
            let line_hz = margin.map(|m| m.frequency_hz);
            self.tell_cut(mismatch, (stretch.ended_s, pitch_rad), line_hz);
        }
    }

    /// Told once a cut for each way in which it differs.
    fn tell_cut(&mut self, mismatch: CutMismatch, (t_s, pitch_rad): (f64, f64), line_hz: Option<f64>) {
        if self.told_cut.contains(&mismatch.name()) {
            return;
        }
        self.told_cut.push(mismatch.name());
        let mut event = Event::new(EventKind::CutMismatch, clock::wall_ns(), mismatch.sentence());
        (event.t_s, event.frequency_hz) = (Some(t_s), line_hz);
        event.pitch_difference_rad = Some(pitch_rad);
        self.report(event);
    }

    /// What was cut goes into the history.
    pub(super) fn keep_cuts(&mut self, stream: &Stream) {
        let Some(newest) = stream.newest.as_ref() else { return };
        let now_s = newest.t_ns as f64 * 1e-9;
        let pitch_rad = self.pitch_rad(stream);
        let condition = Condition {
            speed_rpm: newest.spindle_speed_rpm,
            pitch_rad: pitch_rad.unwrap_or(self.setup.config.cut.tools.pitch_difference_rad()),
            tool_position_m: stream.tool_position_m,
        };
        let in_cut = stream.pipeline().in_cut();
        if self.cuts.look(in_cut) {
            // Of each cut anew: the one before may be weeks away.
            self.told_cut.clear();
            self.setup.commissioning.evidence.hear_cut();
        }
        self.book.look(now_s, condition, in_cut);
        let newest_margin = stream.pipeline().margin().copied();
        while let Some(stretch) = self.book.take() {
            // What cannot be heard is no silence.
            if stretch.chatter_hz.is_none() && stream.pipeline().deaf().is_some() {
                continue;
            }
            // After chatter what was left of it is heard for a while.
            let margin = self.cut_margin.filter(|_| stretch.chatter_hz.is_none() && !stretch.after_chatter);
            if stretch.chatter_hz.is_none() && pitch_rad.is_some() {
                self.compare_silence(&stretch, margin);
            }
            // A shorter stretch has no block of its own: what is said of it was heard before.
            let lasted_s = stretch.ended_s - stretch.began_s;
            let root = margin.filter(|_| stretch.is_at_one_place() && lasted_s > BLOCK_S);
            #[allow(clippy::cast_possible_truncation)]
            let ago_ns = ((now_s - stretch.began_s) * 1e9) as i64;
            let cutting = &self.setup.config.cut.cutting;
            let cut = PastCut {
                sequence: 0,
                id: clock::new_id(),
                began_ns: clock::wall_ns().saturating_sub(ago_ns),
                lasted_s,
                spindle_speed_rpm: stretch.condition.speed_rpm,
                width_m: cutting.raw().width_m,
                feed_m_rev: cutting.raw().feed_m_rev,
                pitch_difference_rad: stretch.condition.pitch_rad,
                tool_position_m: stretch.condition.tool_position_m,
                chattered: stretch.chatter_hz.is_some(),
                line_hz: stretch.chatter_hz.or(root.map(|m| m.frequency_hz)),
                growth_1_s: root.map(|m| [-m.margin_1_s, m.standard_error_1_s()]),
            };
            self.queue(Report::Cut(Box::new(cut)));
        }
        // Of the stretch that goes on, not of the one that ended.
        self.cut_margin = newest_margin.or(self.cut_margin.filter(|_| in_cut == Some(true)));
    }

    /// Pitch angle difference of the cut, rad: as the turret reports it, as stated where none ever reported.
    /// `None`: the turret is heard no more, and may stand anywhere.
    fn pitch_rad(&self, stream: &Stream) -> Option<f64> {
        let stated_rad = self.setup.config.cut.tools.pitch_difference_rad();
        stream.turret_rad.or(self.status.is_none().then_some(stated_rad))
    }

    /// Pitch angle difference as the turret reports it, while it is heard, rad.
    pub(super) fn reported_pitch_rad(&self, now: Instant) -> Option<f64> {
        let heard = self.acting.as_ref().zip(self.fresh_status(now));
        heard.map(|(acting, status)| acting.pitch_rad(&status.offset_m))
    }
}
