//! Stillcut: supervisory chatter control for parallel turning, and the diagnosis of what physics a
//! machine model leaves out.
//!
//! ```text
//! servo samples --> force --> chatter --> avoidance --> Command | Hold(reason)
//! (live, or a       estimate   frequency,  pitch angle    to the turret, once a second
//!  recording)       in N       onset       and limits
//!        ^
//!        |            plant (drive, cutting, workpiece, effects)
//!   simulation <------/      \------> identify, diagnosis: what does the model leave out?
//! ```
//!
//! The core (everything above the line in the module list below) is plain functions over `f64`: no
//! clock, no files, no threads. It builds with `--no-default-features`. The shell, behind the
//! features `cli` (files and commands) and `service` (sockets, shared memory, database), moves data
//! in and out of it. Who may use whom is written in `docs/architecture.md` and held by `tests/tidy.rs`.

pub mod keyframe;
pub mod sample;
pub mod units;

pub mod avoidance;
pub mod chatter;
pub mod diagnosis;
pub mod force;
pub mod gate;
pub mod identify;
pub mod pipeline;
pub mod plant;
pub mod signal;
pub mod simulation;
pub mod stability;

#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "cli")]
pub mod config;
#[cfg(feature = "cli")]
pub mod recording;
#[cfg(feature = "cli")]
pub mod report;

#[cfg(feature = "service")]
pub mod http;
#[cfg(feature = "service")]
pub mod service;
#[cfg(feature = "service")]
pub mod store;
#[cfg(feature = "service")]
pub mod telemetry;
#[cfg(feature = "service")]
pub mod transport;
