//! Tests that cross modules, in one binary. Data beside the project (`../shared`) is read where it is
//! present; a test that needs it says so and passes where it is absent.
#![expect(clippy::disallowed_methods, reason = "a test waits for real processes and says how long it took")]

mod folders;
mod lathe;
mod lathe_diagnosis;

#[cfg(feature = "service")]
mod acting;
mod avoidance;
mod chatter;
mod chatter_judge;
mod closed_loop;
mod coarse_encoders;
mod conceal;
mod concealed_cut;
mod cut_in_time;
mod cut_streams;
#[cfg(feature = "service")]
mod deploy;
#[cfg(feature = "service")]
mod evidence;
#[cfg(feature = "service")]
mod faults;
mod first_user;
#[cfg(feature = "nats")]
mod fleet;
mod force;
mod force_budget;
mod force_flags;
mod force_live;
mod force_trust;
mod guideway;
#[cfg(feature = "service")]
mod http;
mod identify;
mod identities;
mod import;
#[cfg(feature = "service")]
mod io_faults;
#[cfg(feature = "service")]
mod kill_points;
#[cfg(feature = "service")]
mod live_diagnosis;
mod margin;
mod model_axis;
#[cfg(feature = "service")]
mod own_cut;
mod own_drive;
#[cfg(feature = "service")]
mod page;
mod parsers;
mod passes;
mod pipeline;
mod real_chatter;
mod real_cuts;
mod real_machines;
mod recording_faults;
mod report;
#[cfg(feature = "service")]
mod running;
#[cfg(feature = "service")]
mod service;
#[cfg(feature = "service")]
mod store;
mod stream_score;
#[cfg(feature = "service")]
mod transport;
#[cfg(feature = "service")]
mod unprivileged;

mod diagnosis;
