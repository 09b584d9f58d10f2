//! What leaves as a report for a person: pictures and pages. Core types in, text out; no files here.

pub mod diagnosis;
pub mod html;
mod maps;
pub mod page;
pub mod plot;
