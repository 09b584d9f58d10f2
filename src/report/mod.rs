//! What leaves the process as files: events, the track, diagnosis, models.

pub mod events;
pub mod track;
//! Being built.
pub mod force_estimator;
