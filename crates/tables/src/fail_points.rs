//! Points at which a process aborts as if it were killed, for tests of the files that it leaves behind.
//!
//! The environment variable `METAFMU_ABORT_AT` selects one: a [`Moment`], the name of a file, and the number of times
//! it is reached, once by default: `replaced checkpoint.safetensors 2`. Released programs contain these points, too, so
//! that the tests cover released programs. They have no effect unless the variable is set.

use std::{
    env,
    path::Path,
    process::abort,
    sync::atomic::{AtomicUsize, Ordering},
};

/// The latest change to a file.
#[derive(Clone, Copy, Debug)]
pub enum Moment {
    /// Its new content is complete, under another name.
    Complete,
    /// The new content has taken its place.
    Replaced,
    /// A record was appended to it.
    Appended,
    /// It was removed.
    Removed,
}

/// Ends the process without cleaning up if it is to end at this moment.
pub fn reach(moment: Moment, path: &Path) {
    if let Ok(wanted) = env::var("METAFMU_ABORT_AT")
        && is_due(&wanted, moment, path)
    {
        abort();
    }
}

fn is_due(wanted: &str, moment: Moment, path: &Path) -> bool {
    static REACHED: AtomicUsize = AtomicUsize::new(0);
    let moment = match moment {
        Moment::Complete => "complete",
        Moment::Replaced => "replaced",
        Moment::Appended => "appended",
        Moment::Removed => "removed",
    };
    let mut words = wanted.split(' ');
    let is_this = words.next() == Some(moment) && words.next() == path.file_name().and_then(|name| name.to_str());
    let count = words.next().map_or(Ok(1), str::parse);
    is_this && count == Ok(REACHED.fetch_add(1, Ordering::Relaxed) + 1)
}
