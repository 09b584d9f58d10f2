//! What physics of the cut does a scenario leave out? The same question as for a drive, with the lathe as
//! plant: recordings of cuts, or a table of cuts, beside the two-delay model.

pub mod input;
pub mod result;
