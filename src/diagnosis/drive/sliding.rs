//! How freely an axis slides while it is recorded: what friction makes of a disturbance.
//!
//! Where friction turns it is a damper, F sech^2(v / v_s) / v_s, and a disturbance moves an axis that
//! sticks next to nothing, whatever its mass. The Jacobian is the mean over the time of log |det P|^2, P
//! with friction as it is at that time. Taken as that of an axis that always slides it gave a machine that
//! sticks for a fifth of the time a mass that was 7 to 20 % too large.

/// Classes of time, the first one that in which friction does not turn: how far it turns by a small change
/// of the speed, as a share of the most that it does, in powers of four. A grid of a mean.
pub(super) const CLASSES: usize = 4;

/// What a force follows as dry friction does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::diagnosis) enum Follows {
    Speed,
    Way,
}

/// That share, sech^2(v / v_s).
pub(super) fn turns(v_m_s: f64, smoothing_m_s: f64) -> f64 {
    (v_m_s / smoothing_m_s).cosh().powi(-2)
}

/// Classes of that share.
pub(super) fn classes(turns: &[f64]) -> Vec<u8> {
    let from_most = |share: &f64| (-share.max(f64::MIN_POSITIVE).log(4.0)).max(0.0) as usize;
    turns.iter().map(|share| (CLASSES - 1).saturating_sub(from_most(share)) as u8).collect()
}

/// Share of some samples in each class.
pub(super) fn shares<'a>(classes: impl Iterator<Item = &'a u8>) -> [f64; CLASSES] {
    let mut counts = [0.0; CLASSES];
    classes.for_each(|class| counts[usize::from(*class)] += 1.0);
    let all: f64 = counts.iter().sum();
    counts.map(|count| count / all.max(1.0))
}

/// Slope of a force by what it follows, in each class; series of force, motion and class at the full rate.
pub(super) fn class_slopes<'a>(
    all: impl Iterator<Item = (&'a [f64], &'a [f64], &'a [u8])>,
) -> [f64; CLASSES] {
    let (mut product, mut power) = ([0.0; CLASSES], [0.0; CLASSES]);
    for (force, motion, classes) in all {
        for ((f, x), class) in force.windows(2).zip(motion.windows(2)).zip(classes) {
            let class = usize::from(*class);
            product[class] += (f[1] - f[0]) * (x[1] - x[0]);
            power[class] += (x[1] - x[0]).powi(2);
        }
    }
    std::array::from_fn(|class| if power[class] > 0.0 { product[class] / power[class] } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_is_that_of_its_class() {
        let classes = classes(&[0.9, 0.9, 0.1, 0.1, 1e-3, 0.0]);
        assert_eq!(classes, [3, 3, 2, 2, 0, 0]);
        assert_eq!(shares(classes.iter()), [1.0 / 3.0, 0.0, 1.0 / 3.0, 1.0 / 3.0]);
        let (force, speed) = ([0.0, 5.0, 10.0, 11.0, 12.0, 12.0], [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        let of = class_slopes([(&force[..], &speed[..], &classes[..])].into_iter());
        assert_eq!(of, [0.0, 0.0, 1.0, 5.0]);
    }
}
