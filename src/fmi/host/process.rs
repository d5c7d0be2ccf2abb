//! What a process needs that runs third-party machine code.

use std::fs::File;

/// A worker's ways from and to the process that started it.
#[derive(Debug)]
pub struct Pipes {
    /// What standard input was.
    pub requests: File,
    /// What standard output was.
    pub replies: File,
}

impl Pipes {
    /// Takes standard input and output away from everything else in this process: an FMU that prints, prints to standard
    /// error from here on, and one that reads finds nothing.
    ///
    /// # Errors
    /// The system's.
    #[cfg(unix)]
    pub fn take() -> std::io::Result<Self> {
        use std::os::fd::{AsFd, AsRawFd, BorrowedFd, RawFd};
        unsafe extern "C" {
            fn dup2(from: RawFd, to: RawFd) -> RawFd;
        }
        let duplicate = |stream: BorrowedFd| stream.try_clone_to_owned().map(File::from);
        let redirect = |from: BorrowedFd, to: BorrowedFd| {
            // SAFETY: both are open, and what `to` was has been duplicated
            match unsafe { dup2(from.as_raw_fd(), to.as_raw_fd()) } {
                -1 => Err(std::io::Error::last_os_error()),
                _ => Ok(()),
            }
        };
        let (input, output, error) = (std::io::stdin(), std::io::stdout(), std::io::stderr());
        let pipes = Self { requests: duplicate(input.as_fd())?, replies: duplicate(output.as_fd())? };
        redirect(File::open("/dev/null")?.as_fd(), input.as_fd())?;
        redirect(error.as_fd(), output.as_fd())?;
        Ok(pipes)
    }

    /// Where streams cannot be redirected, an FMU that prints to standard output disturbs its worker.
    ///
    /// # Errors
    /// The system's.
    #[cfg(windows)]
    pub fn take() -> std::io::Result<Self> {
        use std::os::windows::io::{AsHandle, BorrowedHandle};
        let duplicate = |stream: BorrowedHandle| stream.try_clone_to_owned().map(File::from);
        let (input, output) = (std::io::stdin(), std::io::stdout());
        Ok(Self { requests: duplicate(input.as_handle())?, replies: duplicate(output.as_handle())? })
    }
}

/// Ends this process at once: neither destructors nor exit handlers run, which may wait for ever on what an FMU does.
pub fn exit_now() -> ! {
    unsafe extern "C" {
        fn _exit(code: i32) -> !;
    }
    // SAFETY: the function takes a number and does not return
    unsafe { _exit(0) }
}
