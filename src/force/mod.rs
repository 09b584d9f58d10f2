//! Cutting force from what a machine already measures: motor current, rotary encoder, linear scale,
//! accelerometers.
//!
//! ```text
//!  current ref --lag, dead time--+
//!  motor angle --delay-----------+--> aligned motion --> force balance --> idle map --> low-pass --> N
//!  stage scale --delay-----------+        (thrust, dob, medob, rigid_mode, vibration_mode)
//! ```
//! One [`observer::Observer`] serves the live pipeline and the offline command: one sample in,
//! one [`motion::ForceEstimate`] out, with the time by which it lags, the band in which it can be
//! used, its noise floor and flags that say what it cannot see.
//!
//! It does not know what chatter is, and it never reads a simulated truth.

mod above_band;
pub mod alignment;
pub mod balance;
mod band;
mod beyond;
pub mod budget;
pub mod closed_loop;
pub mod disagreement;
pub mod driven_budget;
pub mod estimator;
mod follow;
pub mod frf;
pub mod frf_stream;
pub mod friction;
pub mod guideway;
mod guideway_learner;
pub mod harmonic;
pub mod harmonic_settings;
pub mod idle_map;
mod lane_line;
mod lane_part;
mod lane_sections;
pub mod lanes;
pub mod modal;
pub mod motion;
pub mod observer;
pub mod observers;
pub mod offline;
pub mod physics;
pub mod plan;
pub mod recorded;
pub mod response;
pub mod settings;
pub mod signals;
pub mod stiffness;
mod stiffness_learner;
mod thinned;
pub mod two_sides;
pub mod validity;
