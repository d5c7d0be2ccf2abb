//! Ctrl-C: the first one stops the running stage, the second one ends the program.

use std::sync::{
    OnceLock,
    atomic::{AtomicBool, Ordering},
};

/// Turns true at the first Ctrl-C. A stage that it has stopped may clear it and leave the rest to be done; a second
/// Ctrl-C ends the program in any case.
pub fn flag() -> &'static AtomicBool {
    static STOP: AtomicBool = AtomicBool::new(false);
    static PRESSED: AtomicBool = AtomicBool::new(false);
    static HANDLER: OnceLock<()> = OnceLock::new();
    HANDLER.get_or_init(|| {
        let handler = || {
            STOP.store(true, Ordering::Relaxed);
            if PRESSED.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        };
        // without a handler Ctrl-C ends the program at once, which is safe too: files are written whole
        let _ = ctrlc::set_handler(handler);
    });
    &STOP
}
