//! libFuzzer target; see ../src/targets.rs.
#![no_main]
#[path = "../src/targets.rs"]
#[allow(dead_code)]
mod targets;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = targets::wire::shdr(bytes);
});
