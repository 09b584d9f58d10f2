//! Calls into libraries that panic on damaged files: the panic is an answer, without a trace on stderr.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<bool> = const { Cell::new(false) };
}

static HOOK: Once = Once::new();

/// What `act` answers; nothing when it panicked. Panics of other threads are told as before.
pub(super) fn quietly<T>(act: impl FnOnce() -> T) -> Option<T> {
    HOOK.call_once(|| {
        let before = take_hook();
        set_hook(Box::new(move |info| {
            if !QUIET.get() {
                before(info);
            }
        }));
    });
    let was = QUIET.replace(true);
    let outcome = catch_unwind(AssertUnwindSafe(act));
    QUIET.set(was);
    outcome.ok()
}

#[cfg(test)]
mod tests {
    use super::quietly;

    #[test]
    fn a_panic_is_nothing_and_an_answer_is_itself() {
        let damaged: [u8; 0] = [];
        assert_eq!(quietly(|| damaged[std::hint::black_box(3)]), None);
        assert_eq!(quietly(|| 7), Some(7));
    }
}
