//! Tests that cross modules, in one binary. Data beside the project (`../shared`) is read where it is
//! present; a test that needs it says so and passes where it is absent.

mod lathe;

mod conceal;
mod import;
mod report;
#[cfg(feature = "service")]
mod transport;

mod diagnosis;
