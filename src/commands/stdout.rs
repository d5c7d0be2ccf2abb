//! Whether stdout was open when the program began.
//!
//! Before `main` the standard library puts `/dev/null` in the place of closed standard streams: results would vanish there
//! without an error. On Windows writing to a missing stdout is not an error either, and is ignored.

#[cfg(any(target_os = "linux", target_vendor = "apple"))]
mod at_start {
    use std::{
        ffi::c_int,
        sync::atomic::{AtomicBool, Ordering},
    };

    unsafe extern "C" {
        fn fcntl(descriptor: c_int, command: c_int, ...) -> c_int;
    }

    pub static CLOSED: AtomicBool = AtomicBool::new(false);

    /// Runs before the standard library begins.
    #[used]
    #[cfg_attr(target_os = "linux", unsafe(link_section = ".init_array"))]
    #[cfg_attr(target_vendor = "apple", unsafe(link_section = "__DATA,__mod_init_func"))]
    static LOOK: extern "C" fn() = {
        extern "C" fn look() {
            const STDOUT: c_int = 1;
            const F_GETFD: c_int = 1;
            // SAFETY: reads the flags of a descriptor, and takes no further argument
            CLOSED.store(unsafe { fcntl(STDOUT, F_GETFD) } == -1, Ordering::Relaxed);
        }
        look
    };

    pub fn was_closed() -> bool {
        CLOSED.load(Ordering::Relaxed)
    }
}

#[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
mod at_start {
    pub fn was_closed() -> bool {
        false
    }
}

pub use at_start::was_closed;
