//! What leaves as a report: for a person as pictures and pages, for a program as JSON.

pub mod diagnosis;
pub mod html;
mod maps;
pub mod page;
pub mod plot;
pub mod study;
