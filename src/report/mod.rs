//! What leaves the process as files: events, the track, the stability map, diagnosis, models.

pub mod events;
pub mod stability_picture;
pub mod track;
