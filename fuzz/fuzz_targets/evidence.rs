//! libFuzzer target; see ../src/targets.rs.
#![no_main]
#[path = "../src/targets.rs"]
#[allow(dead_code)]
mod targets;

thread_local! {
    static DECISIONS: targets::Decisions = targets::Decisions::new();
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    DECISIONS.with(|decisions| decisions.read(bytes));
});
