//! Being built.
pub mod force_estimator;
