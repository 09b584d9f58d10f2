//! Every threshold of the gate, with where it comes from.

/// When a fault is told. "Counted" means: set on the recordings and injected faults of
/// `docs/results-diagnosis.md`, section on faults, so that none of the clean ones is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Criteria {
    /// Decades of improbability under "the column is alive", beside log10 of the rows: one false alarm in
    /// 10^6 recordings, were rows independent.
    pub surprise_decades: f64,
    /// Shortest run of equal values that may be a hold; two equal neighbours are common.
    pub hold_rows: usize,
    /// Jump behind a hold over the travel that was due in it; a half allows for any acceleration.
    pub jump_share: f64,
    /// The same over every neighbouring change, where the axis turned round meanwhile. Counted.
    pub jump_over_neighbours: f64,
    /// Rows on both sides that say how often a column repeats itself, and how it scatters.
    pub neighbours: usize,
    /// Share of the changes on one residue that says that a column is updated every k rows. Counted.
    pub residue_share: f64,
    /// Share of the rows in runs of k or k + 1 rows that says the same where k is no whole number. Counted.
    pub run_share: f64,
    /// Fewest changes that tell a rate.
    pub rate_changes: usize,
    /// Least jump between updates in steps: a ramp over a coarse step has equal runs of one step, too.
    pub update_steps: f64,
    /// Deviation of a travel from a whole number of its neighbours' travel. Counted.
    pub whole_travel: f64,
    /// Travel of a row over the scatter of its neighbours, and over the step: below, a row more or less
    /// cannot be seen. Counted.
    pub travel_over_scatter: f64,
    /// The same over the step of the column.
    pub travel_over_step: f64,
    /// Deviation from the neighbours' travel in units of their scatter. Counted.
    pub row_over_scatter: f64,
    /// Jump against the logged velocity: steps, share of its largest change, share of itself, scatters,
    /// local scatters. Counted.
    pub jump_against_velocity: [f64; 5],
    /// Largest share of the rows that may jump; above, it is the velocity that is wrong.
    pub jumping_rows: f64,
    /// Deviation of a time step from the median as a share. Counted: 1 % does no harm.
    pub time_jitter: f64,
    /// Share of the rows with that jitter.
    pub jittering_rows: f64,
    /// Steps of the time in medians: above the first it is told; above the second nothing is interpolated.
    pub time_gap: [f64; 2],
    /// Power of rounding, q^2/12, over the power of the changes within a millisecond. Counted.
    pub rounding_share: f64,
    /// Significant digits that are too few.
    pub digits: i32,
    /// Rows at a limit; rows there over the mean of the five steps inwards; rows of one flat top. Counted.
    pub clipped_rows: usize,
    /// Rows at the limit over the mean of the next five steps inwards. Counted.
    pub clipped_over_inwards: f64,
    /// Longest flat top that a peak has by chance, rows.
    pub flat_top_rows: usize,
    /// Fewest different values of a column that is measured and not switched.
    pub least_values: usize,
    /// Deviation from the median of seven in local scales. Counted.
    pub outlier_scales: f64,
    /// The same as a share of the column's range (99th percentile about the median). Counted.
    pub outlier_range: f64,
    /// Disagreement of the neighbours as a share of the deviation.
    pub outlier_neighbours: f64,
    /// Largest share of the rows that are outliers; above, it is noise with a heavy tail.
    pub outlier_rows: f64,
    /// Share of the values of the other sign that a rectified column may have.
    pub other_sign: f64,
    /// Least share of each direction for a statement about signs.
    pub both_ways: f64,
    /// Heights of a touch of zero as shares of the 99th percentile: where it counts, where one is enough.
    pub touch: [f64; 2],
    /// Rows of a touch over those that the slope beside it takes; 1: V-shaped. Counted.
    pub touch_rows: f64,
    /// Share of the touches that are V-shaped. Counted.
    pub touch_share: f64,
    /// Balance of power, -1 to 1, below which the drive acts against the motion. Counted; friction makes
    /// it positive, inertia leaves it.
    pub against_motion: f64,
    /// Share of each direction for the sign.
    pub sign_both_ways: f64,
    /// Roughness of a position over that of the force that makes it. Counted.
    pub roughness: f64,
    /// Least correlation of a speed and the travel, and what their ratio may be off by.
    pub scale_correlation: f64,
    /// Deviation of the ratio of speed and travel from one that is told.
    pub scale_error: f64,
    /// Delay between a speed and the travel that is told, rows.
    pub speed_delay_rows: f64,
    /// Share of what is left that a move in time must take away. Counted.
    pub delay_gain: f64,
    /// The same where the force is early, or inertia too little (nothing is told of both): a clock explains
    /// most of it. Counted: 0.1 to 0.41 of what springs and forces over position leave.
    pub early_gain: f64,
    /// Quantile of F for one number at large samples, 0.1 %.
    pub delay_f: f64,
    /// Share of the force's power that inertia must have for its delay to be seen. Counted.
    pub delay_inertia: f64,
    /// Force later than its motion, s: no physics does that; encoders are read out within two milliseconds.
    pub late_s: f64,
    /// The same in rows: what a sample is late by is half a row, plus one of the logger.
    pub late_rows: f64,
    /// Force earlier than its motion, s; below it is dead time, which is physics.
    pub early_s: f64,
    /// Largest delay that is looked for, s.
    pub delay_span_s: f64,
    /// Cutoff at which force and motion are compared, Hz: above bandwidths of positions, below resonances.
    pub slow_hz: f64,
    /// Depth of each notch of a moving average and of their mean, dB. Counted.
    pub notch_db: [f64; 2],
    /// Line over what lies within 4 Hz, rms. Counted.
    pub line_over_neighbours: f64,
    /// Line over the spread of the column. Counted.
    pub line_share: f64,
    /// Share of the 99th percentile of the speed below which an axis rests.
    pub rest_speed: f64,
    /// Travel in steps below which it rests.
    pub rest_steps: f64,
    /// Share of the rows at rest that is told.
    pub rest_share: f64,
}

impl Default for Criteria {
    fn default() -> Self {
        Self {
            surprise_decades: 6.0,
            hold_rows: 3,
            jump_share: 0.5,
            jump_over_neighbours: 8.0,
            neighbours: 100,
            residue_share: 0.9,
            run_share: 0.6,
            rate_changes: 40,
            update_steps: 3.0,
            whole_travel: 0.15,
            travel_over_scatter: 10.0,
            travel_over_step: 6.0,
            row_over_scatter: 12.0,
            jump_against_velocity: [4.0, 0.4, 0.5, 8.0, 6.0],
            jumping_rows: 0.2,
            time_jitter: 0.02,
            jittering_rows: 0.001,
            time_gap: [1.5, 3.0],
            rounding_share: 1.0 / 13.0,
            digits: 3,
            clipped_rows: 8,
            clipped_over_inwards: 6.0,
            flat_top_rows: 3,
            least_values: 8,
            outlier_scales: 12.0,
            outlier_range: 0.03,
            outlier_neighbours: 1.0 / 3.0,
            outlier_rows: 0.002,
            other_sign: 0.001,
            both_ways: 0.03,
            touch: [0.03, 0.003],
            touch_rows: 1.6,
            touch_share: 0.3,
            against_motion: -0.15,
            sign_both_ways: 0.1,
            roughness: 3.0,
            scale_correlation: 0.98,
            scale_error: 0.015,
            speed_delay_rows: 0.75,
            delay_gain: 0.1,
            early_gain: 0.5,
            delay_f: 10.8,
            delay_inertia: 0.02,
            late_s: 2e-3,
            late_rows: 1.5,
            early_s: 4e-3,
            delay_span_s: 0.03,
            slow_hz: 30.0,
            notch_db: [9.0, 12.0],
            line_over_neighbours: 6.0,
            line_share: 0.005,
            rest_speed: 0.01,
            rest_steps: 1.5,
            rest_share: 0.5,
        }
    }
}
