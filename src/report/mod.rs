//! What leaves the process as files: events, the track, maps, estimators, diagnosis, models, pages for
//! people.

pub mod cut_files;
mod cut_map;
pub mod cut_page;
mod cut_proof;
mod cut_words;
pub mod decisions;
pub mod diagnosis;
pub mod events;
pub mod faults;
pub mod force_plots;
pub mod html;
mod in_loop;
mod maps;
mod naming;
pub mod page;
mod place;
pub mod plot;
mod residual_series;
pub mod stability_picture;
pub mod study;
pub mod track;
mod words;
