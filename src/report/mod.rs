//! What leaves the process as files: events, the track, estimators, diagnosis, models.

pub mod events;
pub mod force_estimator;
pub mod track;
