//! libFuzzer target; see ../src/targets.rs.
#![no_main]
#[path = "../src/targets.rs"]
#[allow(dead_code)]
mod targets;

thread_local! {
    static LIVE: std::cell::RefCell<targets::Live> = std::cell::RefCell::new(targets::Live::new());
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    LIVE.with_borrow_mut(|live| live.restore(bytes));
});
