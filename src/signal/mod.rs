//! Signal processing that knows nothing of machines: filters, spectra, windows.

pub mod sliding_dft;
mod sliding_dft_kernel;
