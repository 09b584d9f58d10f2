//! libFuzzer target: REST bodies, queries and headers into the router of a running service, without sockets.
#![no_main]
#[path = "../src/rest.rs"]
mod rest;

thread_local! {
    static SITE: std::cell::RefCell<rest::Site> = std::cell::RefCell::new(rest::Site::new());
}

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    SITE.with_borrow_mut(|site| site.ask(bytes));
});
