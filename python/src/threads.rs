//! The threads that work is shared among. Those of a process are gone in one that was forked from it, which would wait for them for ever.

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// The process that the module was imported in.
static IMPORTED_IN: OnceLock<u32> = OnceLock::new();
/// The threads of a process that was forked from it.
static FORKED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// Notes the process that has the usual threads.
pub fn of_this_process() {
    IMPORTED_IN.get_or_init(std::process::id);
}

/// Does work with the threads of this process.
pub fn shared<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let id = std::process::id();
    if IMPORTED_IN.get() == Some(&id) {
        return work();
    }
    let mut forked = FORKED.lock().unwrap_or_else(PoisonError::into_inner);
    let pool = match &*forked {
        Some((of, pool)) if *of == id => Arc::clone(pool),
        _ => {
            let pool = ThreadPoolBuilder::new().build().expect("the system starts threads");
            Arc::clone(&forked.insert((id, Arc::new(pool))).1)
        }
    };
    drop(forked);
    pool.install(work)
}

/// Does work without Python's lock.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> T {
    py.detach(|| shared(work))
}
