//! Files that a user gives, opened for reading within limits.

use std::{
    fs::{self, File, FileType},
    io::{self, Cursor, ErrorKind, Read},
    path::Path,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    thread,
    time::Duration,
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

/// Bytes that are taken once, in their order: a regular file, or a [`StreamReader`].
#[derive(Debug)]
pub enum ByteSource<'a> {
    /// A regular file.
    File(File),
    /// A pipe or a device.
    Stream(StreamReader<'a>),
}

impl<'a> ByteSource<'a> {
    /// Opens a file, a pipe or a device. [`is_stream`] tells before. Nothing waits for a pipe once `stop` is true.
    ///
    /// # Errors
    /// The system's reason.
    pub fn open(path: &Path, stop: &'a AtomicBool) -> io::Result<Self> {
        if is_stream(path) { Ok(Self::Stream(StreamReader::open(path, stop))) } else { open(path).map(Self::File) }
    }

    /// Number of bytes of a regular file, 0 of a stream.
    ///
    /// # Errors
    /// The system's reason.
    pub fn length(&self) -> io::Result<u64> {
        match self {
            Self::File(file) => file.metadata().map(|found| found.len()),
            Self::Stream(_) => Ok(0),
        }
    }
}

impl Read for ByteSource<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.read(to),
            Self::Stream(stream) => stream.read(to),
        }
    }
}

/// A pipe or a device. A separate thread waits for its writer and for its bytes, so that a flag ends the wait of the reader.
#[derive(Debug)]
pub struct StreamReader<'a> {
    pieces: Receiver<io::Result<Vec<u8>>>,
    piece: Cursor<Vec<u8>>,
    stop: &'a AtomicBool,
}

/// Bytes of a stream that are read at a time, and pieces that wait for the reader.
const PIECE: usize = 1 << 16;
const PIECES: usize = 4;
/// Time between two checks of the flag.
const BETWEEN: Duration = Duration::from_millis(50);

impl<'a> StreamReader<'a> {
    fn open(path: &Path, stop: &'a AtomicBool) -> Self {
        let (give, pieces) = sync_channel(PIECES);
        let path = path.to_owned();
        // it ends with the stream, with its reader, or with the process
        thread::spawn(move || give_pieces(&path, &give));
        Self { pieces, piece: Cursor::default(), stop }
    }
}

impl Read for StreamReader<'_> {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        loop {
            let count = self.piece.read(to)?;
            if count > 0 || to.is_empty() {
                return Ok(count);
            }
            if self.stop.load(Ordering::Relaxed) {
                return Err(io::Error::other("stopped"));
            }
            match self.pieces.recv_timeout(BETWEEN) {
                Ok(piece) => self.piece = Cursor::new(piece?),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(0),
            }
        }
    }
}

/// Reads a stream to its end, unless nobody takes its pieces any more.
fn give_pieces(path: &Path, give: &SyncSender<io::Result<Vec<u8>>>) {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) => return drop(give.send(Err(error))),
    };
    loop {
        let mut piece = vec![0; PIECE];
        let found = file.read(&mut piece);
        let is_last = !matches!(found, Ok(1..));
        let found = found.map(|count| {
            piece.truncate(count);
            piece
        });
        let is_end = found.as_ref().is_ok_and(Vec::is_empty);
        if is_end || give.send(found).is_err() || is_last {
            return;
        }
    }
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

fn read_to_limit(file: impl Read, limit: u64) -> io::Result<Vec<u8>> {
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
    #[cfg(unix)]
    use std::process::Command;

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
        let stop = AtomicBool::new(false);
        let opened = |path: &Path| ByteSource::open(path, &stop).unwrap();
        assert_eq!(read_to_limit(opened(zero), 1 << 10).unwrap_err().kind(), ErrorKind::FileTooLarge);
        assert_eq!(read_to_limit(opened(Path::new("/dev/null")), 1 << 10).unwrap(), b"");
    }

    #[test]
    #[cfg(unix)]
    fn a_flag_ends_the_wait_for_the_writer_of_a_pipe() {
        let folder = tempfile::tempdir().unwrap();
        let [silent, path] = ["silent", "pipe"].map(|name| folder.path().join(name));
        assert!(Command::new("mkfifo").args([&silent, &path]).status().unwrap().success());
        let stop = AtomicBool::new(false);
        thread::scope(|scope| {
            let reading = scope.spawn(|| ByteSource::open(&silent, &stop).unwrap().read(&mut [0; 8]));
            thread::sleep(2 * BETWEEN);
            stop.store(true, Ordering::Relaxed);
            assert_eq!(reading.join().unwrap().unwrap_err().to_string(), "stopped");
        });
        // and gets all bytes otherwise, in their order
        let bytes: Vec<u8> = (0..3 * PIECE).map(|place| (place % 251) as u8).collect();
        let stop = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| fs::write(&path, &bytes).unwrap());
            assert!(read_to_limit(ByteSource::open(&path, &stop).unwrap(), MAX_TEXT).unwrap() == bytes);
        });
    }
}
