//! Machines that do not exist: the virtual lathe and feed axes in closed loop.
//!
//! Nothing here knows how an observer or a decision works, so that both can be tested on it.

pub mod closed_loop;
pub mod concealed_axis;
pub mod concealed_cut;
pub mod force_signal;
pub mod lathe;
pub mod model_axis;
pub mod model_cut;
