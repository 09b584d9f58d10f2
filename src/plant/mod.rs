//! Physics: drives, effects beyond the drive's structure, workpiece and cutting. It knows nothing of
//! the observers and decisions that look at it.

pub mod cut_effects;
pub mod cut_loop;
pub mod cut_terms;
pub mod cutting;
pub mod drive;
pub mod effects;
pub mod machine;
pub mod scenario;
pub mod scenario_error;
pub mod scenario_terms;
pub mod workpiece;
