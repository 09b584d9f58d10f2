//! Does small vibration grow between two opposed tools, how fast and at which frequency?
//!
//! The linear equation with two delays has infinitely many roots; the one farthest to the right decides:
//!
//! ```text
//!  m s^2 + c s + k + K (2 + e^{-s tau1} + e^{-s tau2}) = 0        s = growth + j 2 pi frequency
//! ```
//!
//! [`rightmost_cut_root`] is the same question to a cut with effects beyond this structure, or with one tool.
//! [`rightmost_root`] finds it by Newton's method from every place in which it can lie, and [`Grid`] walks a
//! map. [`roots_right_of`] counts roots by the argument principle and shares nothing with the search.
//! The linear model does not know loss of contact: it says whether chatter starts, not how large it gets.

mod characteristic;
mod count;
mod cut_root;
mod expectation;
mod foretold;
mod grid;
mod lanes;
pub mod margin;
mod root;

pub use count::{cut_roots_right_of, roots_right_of};
pub use cut_root::{cut_root_near, rightmost_cut_root, scenario_root};
pub use expectation::{CutExpectation, CutMismatch};
pub use foretold::{Foretold, foretell};
pub use grid::{Grid, GridError, GridPoint, GridRange};
pub use root::{Root, rightmost_root};
