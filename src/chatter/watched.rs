//! The part of the designed band in which a line counts: it follows the bar, and widens when a line sits at
//! its edge.

use super::band::Band;

/// A line nearer to the edge than this share of the band's half width sits at it.
const AT_EDGE: f64 = 0.06;
/// It must sit there for so many decisions (12 ms).
const LOOKS: u32 = 3;
/// The band grows by this share of its half width at a time.
const GROWS: f64 = 0.15;

/// Limits of the watched band, relative to the centre of the design, Hz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Watched {
    pub(super) low_hz: f64,
    pub(super) high_hz: f64,
    half_width_hz: f64,
    seen: [u32; 2],
    /// How far it was widened.
    reached_hz: [f64; 2],
}

crate::keyframe::keep!(Watched { low_hz, high_hz, half_width_hz, seen, reached_hz }
    if |s| s.low_hz <= s.high_hz);

impl Watched {
    /// The stated band, a little wider so that a line at its edge is seen whole.
    pub(super) fn new(band: Band, centre_hz: f64, edge: f64) -> Self {
        let (middle_hz, half_hz) = (band.centre_hz() - centre_hz, band.half_width_hz() * edge);
        let (low_hz, high_hz) = (middle_hz - half_hz, middle_hz + half_hz);
        let reached_hz = [f64::INFINITY, f64::NEG_INFINITY];
        Self { low_hz, high_hz, half_width_hz: band.half_width_hz(), seen: [0; 2], reached_hz }
    }

    /// Another band, without losing what it was widened by: a line was heard there.
    pub(super) fn moved_to(self, other: Self) -> Self {
        let [low_hz, high_hz] = self.reached_hz;
        let (low_hz, high_hz) = (other.low_hz.min(low_hz), other.high_hz.max(high_hz));
        Self { low_hz, high_hz, reached_hz: self.reached_hz, ..other }
    }

    /// Takes the line of declared chatter; widens the band on its side when it stays at the edge.
    pub(super) fn follow(&mut self, line_hz: Option<f64>, reach_hz: f64) {
        let near_hz = AT_EDGE * self.half_width_hz;
        let sides = line_hz.map_or([false; 2], |f| [f < self.low_hz + near_hz, f > self.high_hz - near_hz]);
        for (seen, at) in self.seen.iter_mut().zip(sides) {
            *seen = if at { *seen + 1 } else { 0 };
        }
        let grow_hz = GROWS * self.half_width_hz;
        if self.seen[0] >= LOOKS {
            (self.low_hz, self.seen[0]) = ((self.low_hz - grow_hz).max(-reach_hz), 0);
            self.reached_hz[0] = self.low_hz;
        }
        if self.seen[1] >= LOOKS {
            (self.high_hz, self.seen[1]) = ((self.high_hz + grow_hz).min(reach_hz), 0);
            self.reached_hz[1] = self.high_hz;
        }
    }

    /// Filters of a bank of `count` evenly spaced over -`reach_hz`..`reach_hz` that lie in it.
    pub(super) fn filters(&self, count: usize, reach_hz: f64) -> std::ops::Range<usize> {
        let steps = count.saturating_sub(1) as f64;
        let place = |f: f64| ((f + reach_hz) / (2.0 * reach_hz) * steps).clamp(0.0, steps);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bank")]
        let (first, last) =
            ((place(self.low_hz) - 0.01).ceil() as usize, (place(self.high_hz) + 0.01).floor() as usize);
        first..(last + 1).min(count).max(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_at_the_edge_widens_its_side() {
        let mut watched = Watched::new(Band::new(500.0, 700.0).unwrap(), 600.0, 1.08);
        let before = watched;
        (0..9).for_each(|_| watched.follow(Some(30.0), 150.0));
        assert_eq!(watched, before);
        (0..9).for_each(|_| watched.follow(Some(107.0), 150.0));
        assert!(watched.high_hz > before.high_hz + 10.0 && watched.low_hz == before.low_hz);
        (0..99).for_each(|_| watched.follow(Some(149.0), 150.0));
        assert!((watched.high_hz - 150.0).abs() < 1e-12);
        // A narrower band keeps the side at which a line was heard.
        let moved = watched.moved_to(Watched::new(Band::new(520.0, 650.0).unwrap(), 600.0, 1.0));
        assert!((moved.high_hz - 150.0).abs() < 1e-12 && (moved.low_hz + 80.0).abs() < 1e-12);
        assert_eq!(watched.filters(301, 150.0).end, 301);
        assert_eq!(before.filters(301, 150.0), 42..259);
    }
}
