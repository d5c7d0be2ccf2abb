//! Tools for a process that runs third-party machine code.

use std::fs::File;

/// Connections of a worker to the process that started it.
#[derive(Debug)]
pub struct Pipes {
    /// The former standard input.
    pub requests: File,
    /// The former standard output.
    pub replies: File,
}

impl Pipes {
    /// Takes standard input and output away from everything else in this process. After that an FMU that prints writes
    /// to standard error, and one that reads finds nothing.
    ///
    /// # Errors
    /// The system's.
    #[cfg(unix)]
    pub fn take() -> std::io::Result<Self> {
        use std::os::fd::AsFd;
        let pipes = Self {
            requests: File::from(std::io::stdin().as_fd().try_clone_to_owned()?),
            replies: File::from(std::io::stdout().as_fd().try_clone_to_owned()?),
        };
        rustix::stdio::dup2_stdin(File::open("/dev/null")?)?;
        rustix::stdio::dup2_stdout(std::io::stderr())?;
        Ok(pipes)
    }

    /// On platforms without redirection, an FMU that prints to standard output disturbs its worker.
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

/// Ends this process at once: neither destructors nor exit handlers run, which may wait for an FMU without end.
pub fn exit_now() -> ! {
    unsafe extern "C" {
        fn _exit(code: i32) -> !;
    }
    // SAFETY: the function takes a number and does not return
    unsafe { _exit(0) }
}
