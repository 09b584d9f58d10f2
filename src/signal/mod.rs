//! Signal processing that knows nothing of machines: filters, spectra, windows.

pub mod down_mix;
pub mod line_bank;
pub mod moving_variance;
pub mod order_lines;
pub mod sliding_dft;
mod sliding_dft_kernel;
