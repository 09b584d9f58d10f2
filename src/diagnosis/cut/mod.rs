//! What physics of the cut does a scenario leave out? The same question as for a drive, with the lathe as
//! plant: recordings of cuts, or a table of cuts, beside the two-delay model.

mod adequacy;
mod along;
mod answer;
mod bursts;
mod contact;
mod criteria;
mod diagnose;
mod fit;
mod followed;
mod force_signal;
mod foretold;
mod free;
mod hidden;
pub mod input;
mod known;
mod laws;
mod line;
mod machine;
mod matrix;
mod observable;
mod observe;
mod plan;
mod port;
mod proof;
mod recorded;
pub mod result;
mod rows;
mod scatter;
mod search;
mod source;
mod spectra;
mod stretches;
#[cfg(test)]
mod synthetic;
mod table;

pub use diagnose::diagnose;
