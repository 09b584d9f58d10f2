//! Everything that recordings of cuts show, as observables of the fit.

use super::criteria::CRITERIA;
use super::followed::FollowedSpectra;
use super::input::CutRecording;
use super::known::Reference;
use super::line::SwellingLine;
use super::observable::Observable;
use super::rows::{MeanForces, OrderLines, SpindleAngle};
use super::spectra::{CalmSpectra, pieces};
use super::stretches::Stretches;

/// The observables of recordings that are divided into these stretches.
pub(crate) fn observe(
    recordings: &[CutRecording],
    stretches: &Stretches,
    known: &Reference,
) -> Vec<Box<dyn Observable>> {
    let scenario = &known.machine.scenario;
    let mut out: Vec<Box<dyn Observable>> = Vec::new();
    let (mut power, mut count) = (0.0, 0.0);
    for stretch in &stretches.calm {
        let recording = &recordings[stretch.recording];
        out.push(Box::new(MeanForces::new(recording, stretch, scenario)));
        let orders = OrderLines::new(recording, stretch, scenario);
        let [sum, of] = orders.power();
        (power, count) = (power + sum, count + of);
        out.push(Box::new(orders));
    }
    // Chi-square of noise is `count`, give or take some sqrt(2 count).
    let lines = power > count + CRITERIA.outlying_sd * (2.0 * count).sqrt();
    for stretch in stretches.calm.iter().filter(|s| stretches.is_random(s)) {
        let recording = &recordings[stretch.recording];
        for piece in pieces(recording, stretch, &known.machine) {
            out.push(Box::new(CalmSpectra::new(recording, &piece, known, lines)));
        }
    }
    for stretch in stretches.followed.iter().filter(|s| stretches.is_random(s)) {
        let recording = &recordings[stretch.recording];
        // A line among those of the spindle is told from them by its innovations alone.
        let line = (!lines).then(|| SwellingLine::new(recording, stretch, known)).flatten();
        let taken_hz = line.as_ref().map(SwellingLine::band_hz);
        let seconds = stretch.samples.len() as f64 / recording.sample_rate.hz();
        let long = seconds >= CRITERIA.shortest_followed_s;
        let followed = long.then(|| FollowedSpectra::new(recording, stretch, known, (lines, taken_hz)));
        if let Some(followed) = followed.flatten() {
            out.push(Box::new(followed));
        }
        if let Some(line) = line {
            out.push(Box::new(line));
        }
    }
    for (index, recording) in recordings.iter().enumerate() {
        if let Some(angle) = SpindleAngle::new(recording, index) {
            out.push(Box::new(angle));
        }
    }
    out
}
