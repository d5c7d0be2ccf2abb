//! Files that a user gives, opened for reading within limits.

use std::{
    fs::{self, File, FileType},
    io::{self, ErrorKind, Read},
    path::Path,
};

/// Bytes of a study, a mechanism, an interface or a system's description at most.
pub const MAX_TEXT: u64 = 64 << 20;
/// Bytes of a trained model, a library or a table that is read as a whole at most.
pub const MAX_WHOLE: u64 = 2 << 30;

/// Opens a regular file. A pipe is refused, as opening it waits for a writer, and a device, as it may have no end.
///
/// # Errors
/// The system's reason, or the kind of file.
pub fn open(path: &Path) -> io::Result<File> {
    let found = fs::metadata(path)?;
    if found.is_file() {
        return File::open(path);
    }
    if found.is_dir() {
        return Err(ErrorKind::IsADirectory.into());
    }
    let kind = kind_of(found.file_type());
    Err(io::Error::other(format!("it is not a regular file but {kind}: write its content to a file first")))
}

/// Opens a file, a pipe or a device, for readers that take each byte once and have a limit. Opening a pipe waits for a
/// writer: [`is_stream`] tells before.
///
/// # Errors
/// The system's reason.
pub fn open_stream(path: &Path) -> io::Result<File> {
    if is_stream(path) { File::open(path) } else { open(path) }
}

/// Returns true for a pipe or a device.
pub fn is_stream(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// The content of a regular file of at most `limit` bytes.
///
/// # Errors
/// The system's reason, the kind of file, or its size.
pub fn read(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    let file = open(path)?;
    let size = file.metadata()?.len();
    if size > limit {
        return Err(too_large(size, limit));
    }
    read_to_limit(file, limit)
}

fn read_to_limit(file: File, limit: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes)?;
    let size = bytes.len() as u64;
    if size > limit { Err(too_large(size, limit)) } else { Ok(bytes) }
}

fn too_large(size: u64, limit: u64) -> io::Error {
    io::Error::new(ErrorKind::FileTooLarge, format!("it has {size} bytes or more, expected at most {limit}"))
}

/// The kind of something that is neither a file nor a folder.
fn kind_of(kind: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        if kind.is_fifo() {
            return "a pipe";
        }
        if kind.is_socket() {
            return "a socket";
        }
    }
    let _ = kind;
    "a device"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_above_their_limit_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sparse");
        // takes no room on the disk
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let message = read(&path, MAX_TEXT).unwrap_err().to_string();
        assert_eq!(message, "it has 1099511627776 bytes or more, expected at most 67108864");
        fs::write(&path, "12345").unwrap();
        assert_eq!(read(&path, 5).unwrap(), b"12345");
        assert_eq!(read(&path, 4).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(open(folder.path()).unwrap_err().kind(), ErrorKind::IsADirectory);
        assert_eq!(open(&folder.path().join("absent")).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    #[cfg(unix)]
    fn devices_are_read_as_streams_only_and_up_to_a_limit() {
        let zero = Path::new("/dev/zero");
        let message = read(zero, MAX_TEXT).unwrap_err().to_string();
        assert_eq!(message, "it is not a regular file but a device: write its content to a file first");
        assert!(is_stream(zero) && !is_stream(Path::new("/dev")) && !is_stream(Path::new("/etc/passwd")));
        assert_eq!(read_to_limit(open_stream(zero).unwrap(), 1 << 10).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_to_limit(open_stream(Path::new("/dev/null")).unwrap(), 1 << 10).unwrap(), b"");
    }
}
