//! How far a running cut is from chatter, before it is heard: the stability margin with its interval.
//!
//! The cut's own random force shakes the bar, and what is heard of it dies out the slower the nearer the cut
//! is to chatter. Its spectrum is a comb of lines between which the two delays are known; their place, width
//! and height tell stiffness, damping and level, and these tell the rightmost root of the two-delay equation:
//!
//! ```text
//! force --> band, blocks of 2 s --> periodogram --> most likely numbers --> roots in the band --> margin
//!           (spectrum)                              (fit, prior: the last   (roots: a cloud of   with 95 %
//! speed, pitch, position, feed, width (conditions)   second, and drift)      the posterior)      (judge)
//! ```
//!
//! A root and its mirror image have nearly one spectrum; only a stable cut has one that stands, and the fit
//! keeps to those (Nyquist's criterion). Between blocks the numbers stand and the conditions move: a pitch
//! that drifts moves the margin at once. The mean force over the chip area tells changes of the stiffness.
//!
//! All work is done in parts of a few bins a sample; nothing is allocated after [`MarginMonitor::start`].
//! It does not decide whether there is chatter: a cut that swings out of the linear range teaches nothing.

mod conditions;
mod criteria;
mod fit;
mod interference;
mod judge;
mod knowledge;
mod model;
mod monitor;
mod roots;
mod spectrum;

pub use conditions::CutConditions;
pub use criteria::{BLOCK_S, RECOVERED_1_S};
pub use judge::{DeafReason, Margin, MarginReading};
pub use knowledge::CutPrior;
pub use monitor::{MarginMonitor, MarginSettings, MarginState};
