//! Writes results as they come, and records whether stdout was open when the program began.
//!
//! Before `main` the standard library puts `/dev/null` in the place of closed standard streams: results would vanish there
//! without an error. On Windows writing to a missing stdout is not an error either, and is ignored.

use super::{visible, write};
use metafmu::{Error, Result, files};
use std::{
    io::{self, ErrorKind, IsTerminal, Write},
    path::Path,
};

/// Number of bytes that are printed at once. Work that fails before prints nothing.
const PIECE: usize = 1 << 20;

/// Does work that writes to a file, whole or not at all, or to stdout. A reader that has seen enough (`| head`) ends it without
/// an error, and without a value.
pub fn write_result<T>(path: Option<&Path>, work: impl FnOnce(&mut dyn Write) -> Result<T>) -> Result<Option<T>> {
    let mut done = None;
    let ended = match path {
        Some(path) => {
            let mut failure = None;
            let written = files::write_output(path, |file| {
                work(file).map(|value| done = Some(value)).map_err(|error| {
                    failure = Some(error);
                    io::Error::other("the work failed")
                })
            });
            failure.map_or(written, Err)
        }
        None => {
            let mut stdout = Stdout::default();
            let worked = work(&mut stdout).map(|value| done = Some(value));
            worked.and_then(|()| stdout.flush().map_err(Error::io(Path::new("stdout"), "write")))
        }
    };
    match ended {
        Err(Error::Io { source, .. }) if source.kind() == ErrorKind::BrokenPipe => Ok(None),
        ended => ended.map(|()| done),
    }
}

/// Standard output, in large pieces.
#[derive(Default)]
struct Stdout {
    waiting: Vec<u8>,
}

impl Write for Stdout {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.waiting.extend_from_slice(bytes);
        if self.waiting.len() >= PIECE {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        let waiting = std::mem::take(&mut self.waiting);
        match str::from_utf8(&waiting) {
            // the names of the columns are not the user's
            Ok(text) if io::stdout().is_terminal() => write(visible(text).as_bytes()),
            _ => write(&waiting),
        }
    }
}

#[cfg(any(target_os = "linux", target_vendor = "apple"))]
mod at_start {
    use std::sync::atomic::{AtomicBool, Ordering};

    pub static CLOSED: AtomicBool = AtomicBool::new(false);

    /// Runs before the standard library begins.
    #[used]
    #[cfg_attr(target_os = "linux", unsafe(link_section = ".init_array"))]
    #[cfg_attr(target_vendor = "apple", unsafe(link_section = "__DATA,__mod_init_func"))]
    static LOOK: extern "C" fn() = {
        extern "C" fn look() {
            let flags = rustix::io::fcntl_getfd(rustix::stdio::stdout());
            CLOSED.store(flags.is_err(), Ordering::Relaxed);
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
