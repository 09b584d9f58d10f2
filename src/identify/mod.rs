//! What a machine is, from recordings of it: mechanical parameters and dead times from a sweep, the
//! accelerometer estimator from runs with known force, the noise that encoder steps cause.

pub mod banded;
mod fitted_drive;
pub mod frf;
pub mod least_squares;
pub mod resolution;
pub mod sweep;
mod sweep_fit;
mod sweep_lines;
mod sweep_recording;
mod sweep_result;
