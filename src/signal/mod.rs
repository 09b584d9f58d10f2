//! Filters and spectra over plain number series. It does not know what a machine is.
//!
//! Each filter is an immutable design and a plain state: `design.step(&mut state, x) -> y`, no
//! allocation, no clock. Designs refuse what cannot work at the given rate.

pub mod butterworth;
pub mod dispatch;
pub mod down_mix;
pub(crate) mod exponential;
pub mod finite_difference;
pub mod harmonic_fit;
pub mod linear_phase;
pub mod notch;
pub mod order_tracking;
pub(crate) mod sine;
pub mod sliding_dft;
mod sliding_dft_kernel;
pub(crate) mod sliding_median;

use thiserror::Error;

/// Why a filter cannot be designed.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum FilterError {
    /// The frequency must lie between zero and half the sampling rate.
    #[error("{what} of {frequency_hz} Hz is not between 0 and {nyquist_hz} Hz, half the sampling rate")]
    Frequency {
        /// Which frequency.
        what: &'static str,
        /// Value.
        frequency_hz: f64,
        /// Half the sampling rate.
        nyquist_hz: f64,
    },
    /// The order is outside of what is supported.
    #[error("filter order {order} is not in 1..={largest}")]
    Order {
        /// Value.
        order: usize,
        /// Largest order.
        largest: usize,
    },
    /// A number that must be positive is not.
    #[error("{what} of {value} is not positive")]
    NotPositive {
        /// Which number.
        what: &'static str,
        /// Value.
        value: f64,
    },
    /// More samples of delay than a state can hold.
    #[error("delay of {samples:.1} samples is longer than the {largest} that the line holds")]
    DelayTooLong {
        /// Delay.
        samples: f64,
        /// Largest.
        largest: usize,
    },
}

/// Errors unless 0 < `frequency_hz` < `nyquist_hz`.
pub(crate) fn check_frequency(
    what: &'static str,
    frequency_hz: f64,
    nyquist_hz: f64,
) -> Result<(), FilterError> {
    if frequency_hz.is_finite() && frequency_hz > 0.0 && frequency_hz < nyquist_hz {
        Ok(())
    } else {
        Err(FilterError::Frequency { what, frequency_hz, nyquist_hz })
    }
}

pub mod inner_products;
pub mod sliding_fit;
