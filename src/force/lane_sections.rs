//! Cascades of second-order sections side by side, one in each vector lane.

use crate::signal::butterworth::Section;
use crate::signal::dispatch::multiply_add;

/// One second-order section a lane: b0, b1, b2, a1, a2.
pub(super) type LaneSection<const L: usize> = [[f64; L]; 5];

/// Cascades side by side, one a lane; a lane without one lets everything through.
pub(super) fn lane_sections<const L: usize>(
    cascades: impl IntoIterator<Item = Vec<Section>>,
) -> Vec<LaneSection<L>> {
    let mut lanes: Vec<LaneSection<L>> = Vec::new();
    for (lane, cascade) in cascades.into_iter().enumerate() {
        let through = [[1.0; L], [0.0; L], [0.0; L], [0.0; L], [0.0; L]];
        lanes.resize(lanes.len().max(cascade.len()), through);
        for (to, Section { b: [b0, b1, b2], a: [a1, a2] }) in lanes.iter_mut().zip(cascade) {
            to.iter_mut().zip([b0, b1, b2, a1, a2]).for_each(|(to, value)| to[lane] = value);
        }
    }
    lanes
}

fn section_of_lane<const L: usize>(section: &LaneSection<L>, lane: usize) -> Section {
    let [b0, b1, b2, a1, a2] = section.map(|c| c[lane]);
    Section { b: [b0, b1, b2], a: [a1, a2] }
}

/// Settles the filter of one lane on `x`.
pub(super) fn settle_sections<const L: usize>(
    sections: &[LaneSection<L>],
    states: &mut [[[f64; L]; 2]],
    lane: usize,
    mut x: f64,
) {
    for (section, state) in sections.iter().zip(states) {
        let section = section_of_lane(section, lane);
        let [first, second] = section.settled(x);
        (state[0][lane], state[1][lane]) = (first, second);
        x *= section.b.iter().sum::<f64>() / (1.0 + section.a[0] + section.a[1]);
    }
}

/// One sample of every lane through the cascade, in place.
#[inline(always)]
pub(super) fn filter<const L: usize, const FUSED: bool>(
    sections: &[LaneSection<L>],
    states: &mut [[[f64; L]; 2]],
    x: &mut [f64; L],
) {
    for ([b0, b1, b2, a1, a2], state) in sections.iter().zip(states) {
        // From copies into a copy: stores to the state must not stand between the lanes.
        let (input, [first, second]) = (*x, *state);
        let mut next = [[0.0; L]; 2];
        for lane in 0..L {
            let y = multiply_add::<FUSED>(b0[lane], input[lane], first[lane]);
            let inner = multiply_add::<FUSED>(b1[lane], input[lane], second[lane]);
            next[0][lane] = multiply_add::<FUSED>(-a1[lane], y, inner);
            next[1][lane] = multiply_add::<FUSED>(b2[lane], input[lane], -a2[lane] * y);
            x[lane] = y;
        }
        *state = next;
    }
}
