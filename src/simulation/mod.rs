//! Simulated machines: what the rest of the crate is tried on. It never uses the observers.

pub mod concealed_axis;
