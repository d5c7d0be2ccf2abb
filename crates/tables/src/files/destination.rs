//! Destination of a path to be written to, with links followed.

use std::{
    fs::{self, OpenOptions},
    io::{self, BufWriter, ErrorKind, Write},
    path::{Path, PathBuf},
};

/// As many symbolic links in a row as Linux follows.
const LINKS: usize = 40;

/// Destination of a path, with symbolic links followed.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Destination {
    /// A file, or nothing yet.
    File(PathBuf),
    /// A device, a pipe, a socket, or a file that a process has open.
    Stream(PathBuf),
    /// `/dev/stdout`; opened by its name, what was redirected to a file would be written from the file's beginning.
    Stdout,
    /// `/dev/stderr`
    Stderr,
}

impl Destination {
    /// # Errors
    /// If it is a folder, or in none.
    pub(super) fn find(path: &Path) -> io::Result<Self> {
        let mut path = path.to_owned();
        for _ in 0..LINKS {
            let (Some(name), false) = (path.file_name(), ends_like_a_folder(&path)) else {
                return Err(ErrorKind::IsADirectory.into());
            };
            let folder = fs::canonicalize(folder_of(&path)).map_err(|error| in_folder(&path, error))?;
            if folder.starts_with("/proc") || folder == Path::new("/dev/fd") {
                let is_own =
                    ["/proc/self/fd", "/dev/fd"].iter().any(|own| fs::canonicalize(own).is_ok_and(|own| own == folder));
                return Ok(match name.to_str() {
                    Some("1") if is_own => Self::Stdout,
                    Some("2") if is_own => Self::Stderr,
                    _ => Self::Stream(path),
                });
            }
            match fs::symlink_metadata(&path) {
                Ok(found) if found.is_symlink() => path = folder_of(&path).join(fs::read_link(&path)?),
                Ok(found) if found.is_dir() => return Err(ErrorKind::IsADirectory.into()),
                Ok(found) if found.is_file() => return Ok(Self::File(path)),
                Ok(_) => return Ok(Self::Stream(path)),
                Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::File(path)),
                Err(error) => return Err(in_folder(&path, error)),
            }
        }
        Err(io::Error::other("too many symbolic links"))
    }

    /// Writes to something other than a file on a disk. A reader that has seen enough (`| head`) is not an error.
    pub(super) fn write(&self, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
        let mut stream = BufWriter::with_capacity(1 << 16, self.open()?);
        match write(&mut stream).and_then(|()| stream.flush()) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
            done => done,
        }
    }

    fn open(&self) -> io::Result<Box<dyn Write>> {
        match self {
            Self::Stdout => Ok(Box::new(io::stdout())),
            Self::Stderr => Ok(Box::new(io::stderr())),
            #[cfg(unix)]
            Self::Stream(path) if is_socket(path) => Ok(Box::new(std::os::unix::net::UnixStream::connect(path)?)),
            // writing to a file that a process has open continues at its end
            Self::Stream(path) | Self::File(path) => Ok(Box::new(OpenOptions::new().append(true).open(path)?)),
        }
    }
}

/// The folder a file is in.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn ends_like_a_folder(path: &Path) -> bool {
    path.as_os_str().to_string_lossy().ends_with(std::path::is_separator)
}

fn in_folder(path: &Path, error: io::Error) -> io::Error {
    let folder = folder_of(path).display();
    match error.kind() {
        ErrorKind::NotFound => io::Error::new(ErrorKind::NotFound, format!("there is no folder {folder}")),
        ErrorKind::NotADirectory => io::Error::new(ErrorKind::NotADirectory, format!("{folder} is not a folder")),
        _ => error,
    }
}

#[cfg(unix)]
fn is_socket(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| std::os::unix::fs::FileTypeExt::is_socket(&found.file_type()))
}
