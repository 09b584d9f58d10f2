//! What no tool exerts, and what no cut of the stated machine does: recordings in which nothing is linear.

use super::adequacy::Left;
use super::answer::Posterior;
use super::criteria::CRITERIA;
use super::fit::Problem;
use super::input::CutRecording;
use super::result::CutLocation;
use super::stretches::{Stretches, condition, constant};
use crate::diagnosis::result::TimeSpans;
use crate::plant::cut_loop::CutLoop;
use crate::plant::effects::Port;
use crate::stability::rightmost_cut_root;
use nalgebra::Complex;
use rustfft::FftPlanner;
use std::ops::Range;

/// A line of a force signal that no tool exerts.
///
/// A tool only pushes, F >= 0: no line of its force is larger than twice its mean, over whatever time,
///
/// |2/T int F exp(-i w t) dt| <= 2/T int F dt,
///
/// nor is it behind a low-pass, whose gain is 1 at most. Larger ones are of the signal: hum, a zero that was
/// never set, a channel that is turned round.
pub(crate) fn pulls(recordings: &[CutRecording]) -> Option<Left> {
    let mut worst: Option<(f64, [f64; 2])> = None;
    let mut time: Vec<TimeSpans> = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        let rate = recording.sample_rate.hz();
        for range in long(recording) {
            let lines = recording.forces_n.iter().flatten().filter_map(|f| pulling(&f[range.clone()], rate));
            let Some(line) = lines.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            if worst.is_none_or(|w| line.0 > w.0) {
                worst = Some(line);
            }
            TimeSpans::add(&mut time, index, span_s(recording, &range));
        }
    }
    let (_, band_hz) = worst?;
    let location =
        CutLocation { port: Port::ForceSensor, domain: "frequency", bands_hz: vec![band_hz], time };
    Some(Left { location, excess_nats: 0.0 })
}

/// Stretches of one condition that are long enough to tell a line.
fn long(recording: &CutRecording) -> impl Iterator<Item = Range<usize>> {
    let least = CRITERIA.shortest_calm_s * recording.sample_rate.hz();
    constant(recording).into_iter().filter(move |range| range.len() as f64 >= least)
}

fn span_s(recording: &CutRecording, range: &Range<usize>) -> [f64; 2] {
    [recording.time_s(range.start), recording.time_s(range.end - 1)]
}

/// By how much the largest line of a force exceeds what a push may have, N, and its bin, Hz.
fn pulling(force_n: &[f64], rate_hz: f64) -> Option<(f64, [f64; 2])> {
    let n = force_n.len();
    let mut spectrum: Vec<Complex<f64>> = force_n.iter().map(|f| Complex::new(*f, 0.0)).collect();
    FftPlanner::new().plan_fft_forward(n).process(&mut spectrum);
    let line_n: Vec<f64> = spectrum[..n / 2].iter().map(|x| 2.0 * x.norm() / n as f64).collect();
    let (k, largest_n) = line_n.iter().copied().enumerate().skip(1).max_by(|a, b| a.1.total_cmp(&b.1))?;
    // What is noise has such lines as well: of a Rayleigh amplitude the median is 1.18 deviations.
    let mut sorted = line_n.clone();
    sorted.sort_by(f64::total_cmp);
    let noise_n = CRITERIA.outlying_sd * sorted[n / 4];
    let mean_n = force_n.iter().sum::<f64>() / n as f64;
    let excess_n = largest_n - 2.0 * mean_n.max(0.0) - noise_n;
    let bin_hz = rate_hz / n as f64;
    (excess_n > 0.0).then_some((excess_n, [(k as f64 - 0.5) * bin_hz, (k as f64 + 0.5) * bin_hz]))
}

/// Chatter that the stated machine calls impossible: cuts in which contact is lost all through, whose growth
/// is below zero whatever of its tolerances the machine uses.
///
/// `None`: some stretch is linear and was fitted, or the machine says that it chatters there.
pub(crate) fn impossible_chatter(
    problem: &Problem<'_>,
    posterior: &Posterior,
    recordings: &[CutRecording],
    stretches: &Stretches,
) -> Option<Left> {
    if !(stretches.calm.is_empty() && stretches.followed.is_empty()) {
        return None;
    }
    let mut time: Vec<TimeSpans> = Vec::new();
    for (index, recording) in recordings.iter().enumerate() {
        for range in long(recording) {
            let at = condition(recording, usize::midpoint(range.start, range.end), &problem.frame.stated);
            let growth = |coordinates: &[f64]| {
                let machine = problem.frame.machine(&posterior.point.with(coordinates))?;
                Some(rightmost_cut_root(&CutLoop::new(&machine.terms(&at))).growth_1_s)
            };
            if posterior.interval(&growth).is_some_and(|[_, most_1_s]| most_1_s < 0.0) {
                TimeSpans::add(&mut time, index, span_s(recording, &range));
            }
        }
    }
    let location = CutLocation { port: Port::Process, domain: "outcome", bands_hz: Vec::new(), time };
    (!location.time.is_empty()).then_some(Left { location, excess_nats: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::super::input::CutEvidence;
    use super::super::machine::Frame;
    use super::super::stretches::Stretch;
    use super::super::synthetic::recording;
    use super::*;
    use crate::plant::scenario::Scenario;
    use std::f64::consts::TAU;

    /// A cut of no linear stretch is impossible where the machine is stable with all that is open of it: not
    /// at the width at which it chatters, and not where something linear was fitted.
    #[test]
    fn chatter_is_impossible_where_no_machine_of_the_tolerance_chatters() {
        let scenario = Scenario::default();
        let frame = Frame::of(&scenario, &CutEvidence { recordings: &[], table: None });
        let problem = Problem { frame: &frame, observables: &[] };
        let posterior = Posterior::new(&problem, &frame.origin()).expect("priors alone");
        let of = |width: f64, calm: Vec<Stretch>| {
            let mut cut = recording(&scenario, 1.0, |_| [50.0, 50.0]);
            cut.width_m.iter_mut().for_each(|b| *b *= width);
            let stretches = Stretches { calm, ..Stretches::default() };
            impossible_chatter(&problem, &posterior, &[cut], &stretches)
        };
        let left = of(0.01, Vec::new()).expect("chatter in a cut that is stable").location;
        assert_eq!((left.port, left.domain, left.time.len()), (Port::Process, "outcome", 1));
        assert!(of(0.05, Vec::new()).is_none(), "at the border a machine of the tolerance may chatter");
        assert!(of(1.0, Vec::new()).is_none(), "the stated machine chatters there");
        assert!(of(0.01, vec![Stretch { recording: 0, samples: 0..9000 }]).is_none(), "it was fitted");
    }

    /// Contact that is lost over half of a period is none of it; a hum of three times the mean is.
    #[test]
    fn no_tool_pulls() {
        let scenario = Scenario::default();
        let wave = |t: f64| (TAU * 50.0 * t).sin();
        let pushed = recording(&scenario, 1.0, |t| [60.0 * wave(t).max(0.0), 20.0]);
        assert!(pulls(&[pushed]).is_none());
        let hum = recording(&scenario, 1.0, |t| [20.0, 20.0 + 60.0 * wave(t)]);
        let left = pulls(&[hum]).expect("a line that no tool exerts").location;
        assert_eq!((left.port, left.time.len()), (Port::ForceSensor, 1));
        assert!(left.bands_hz[0][0] < 50.0 && left.bands_hz[0][1] > 50.0, "{:?}", left.bands_hz);
    }
}
