//! Files written whole or not at all.

mod destination;

use crate::{
    Error, Result,
    fail_points::{Moment, reach},
    reading,
};
use destination::{Destination, folder_of};
use sha2::{Digest, Sha256};
use std::{
    fs::{File, Metadata, OpenOptions},
    io::{self, BufWriter, ErrorKind, Read, Seek, SeekFrom, Write},
    path::Path,
};
use tempfile::NamedTempFile;

/// Prefix of the names of incomplete files.
const UNFINISHED: &str = ".metafmu-";

/// Writes a file, see [`write_with`].
///
/// # Errors
/// [`Error::Io`]; what was at `path` is unchanged.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_at(path, |destination| match destination {
        Destination::File(target) => replace(target, false, |file| file.write_all(bytes)),
        stream => stream.write(|stream| stream.write_all(bytes)),
    })
    .map_err(|error| sized(error, bytes.len()))
}

/// Writes a file beside its place and moves it there when it is complete: a reader sees the old file or the new one.
///
/// Symbolic links are followed, and what they lead to is created if it is not there. An existing file keeps its mode, and its
/// owner and group where the system allows it; one that must not be written to is not replaced. Another name of it (a hard
/// link) stays with the old content, so that copies made of links stay unchanged. Anything but a file on a disk (a device, a
/// pipe, a socket, `/dev/stdout`) is written to as it is, and not whole if that fails midway.
///
/// # Errors
/// [`Error::Io`]; a file that was at `path` is still there.
pub fn write_with(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    write_at(path, |destination| match destination {
        Destination::File(target) => replace(target, false, write),
        stream => stream.write(write),
    })
}

/// Writes a file at a path that the user gave. Unlike [`write_with`], it also writes into the existing file if that has
/// other names (hard links), which shall all have the new content, or if its folder accepts no new file. In that case a
/// process that is killed while it copies the complete content leaves a mixture of old and new; a full disk does not.
///
/// # Errors
/// [`Error::Io`]; a file that was at `path` is still there.
pub fn write_output(path: &Path, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> Result<()> {
    write_at(path, |destination| match destination {
        Destination::File(target) => replace(target, true, write),
        stream => stream.write(write),
    })
}

/// Returns true if the file exists and is not empty.
pub fn has_content(path: &Path) -> bool {
    path.metadata().is_ok_and(|of| of.len() > 0)
}

/// Finds out before the work whether [`write_output`] can write there, and removes what processes that were killed have not finished beside it.
///
/// # Errors
/// [`Error::Io`].
pub fn check_output(path: &Path) -> Result<()> {
    write_at(path, |destination| match destination {
        Destination::File(target) => {
            remove_unfinished(folder_of(target));
            match target.exists() {
                true => OpenOptions::new().write(true).open(target).map(drop),
                false => tempfile::tempfile_in(folder_of(target)).map(drop),
            }
        }
        _ => Ok(()),
    })
}

fn write_at(path: &Path, write: impl FnOnce(&Destination) -> io::Result<()>) -> Result<()> {
    Destination::find(path).and_then(|destination| write(&destination)).map_err(Error::io(path, "write"))
}

/// Replaces or creates a file. With `in_place`, it writes into the existing file if that has other names or its folder
/// accepts no new file.
fn replace(path: &Path, in_place: bool, write: impl FnOnce(&mut dyn Write) -> io::Result<()>) -> io::Result<()> {
    let old = match OpenOptions::new().write(true).open(path) {
        Ok(file) => Some(file.metadata()?),
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(error) => return Err(error),
    };
    let in_place = in_place && old.is_some();
    let file = match unfinished(folder_of(path)) {
        Err(error) if in_place && is_of_folder(&error) => NamedTempFile::new(),
        found => found,
    };
    let mut file = file?;
    // not by the name of the unfinished file, which would appear in errors
    let mut writer = BufWriter::with_capacity(1 << 16, file.as_file_mut());
    write(&mut writer)?;
    writer.flush()?;
    drop(writer);
    if in_place && old.as_ref().is_some_and(has_other_names) {
        return overwrite(path, file.as_file_mut());
    }
    old.map_or(Ok(()), |old| keep_access(file.as_file(), &old))?;
    file.as_file().sync_all()?;
    reach(Moment::Complete, path);
    match file.persist(path) {
        Err(mut failed) if in_place && is_of_folder(&failed.error) => overwrite(path, failed.file.as_file_mut()),
        moved => moved.map(|_| reach(Moment::Replaced, path)).map_err(|failed| failed.error),
    }
}

/// Copies a file into another one. Writes the part beyond its end first, so that nothing has changed if there is no
/// room for it.
fn overwrite(path: &Path, from: &mut File) -> io::Result<()> {
    let mut to = OpenOptions::new().write(true).open(path)?;
    let (old, new) = (to.metadata()?.len(), from.metadata()?.len());
    let common = old.min(new);
    to.seek(SeekFrom::Start(common))?;
    from.seek(SeekFrom::Start(common))?;
    if let Err(error) = io::copy(from, &mut to).and_then(|_| to.sync_all()) {
        to.set_len(old)?;
        return Err(error);
    }
    to.rewind()?;
    from.rewind()?;
    io::copy(&mut from.take(common), &mut to)?;
    to.set_len(new)?;
    to.sync_all()
}

/// A new file of this process: it is locked, so that [`remove_unfinished`] of another one knows that it is not left over. Where
/// files cannot be locked, none is removed either.
fn unfinished(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(UNFINISHED);
    // temporary files are private by default; this one becomes an ordinary file
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    loop {
        let file = builder.tempfile_in(folder)?;
        let _ = file.as_file().lock();
        // it may have been removed before it was locked
        if file.path().exists() {
            return Ok(file);
        }
    }
}

/// Removes the files that processes did not finish because they were killed. What cannot be removed does no harm.
fn remove_unfinished(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let is_one = entry.file_name().as_encoded_bytes().starts_with(UNFINISHED.as_bytes());
        if is_one
            && entry.file_type().is_ok_and(|kind| kind.is_file())
            && let Ok(file) = OpenOptions::new().write(true).open(entry.path())
            && file.try_lock().is_ok()
        {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Gives a file the owner and the mode of the one whose place it takes.
#[cfg(unix)]
fn keep_access(file: &File, old: &Metadata) -> io::Result<()> {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let new = file.metadata()?;
    let mut mode = old.mode() & 0o777;
    if (new.uid(), new.gid()) != (old.uid(), old.gid()) {
        let kept = fchown(file, Some(old.uid()), Some(old.gid())).or_else(|_| fchown(file, None, Some(old.gid())));
        // another group may do no more than everybody might
        mode &= if kept.is_ok() { 0o777 } else { 0o707 | (mode & 0o007) << 3 };
    }
    // not every file system has modes
    if new.mode() & 0o777 == mode { Ok(()) } else { file.set_permissions(PermissionsExt::from_mode(mode)) }
}

#[cfg(not(unix))]
fn keep_access(_: &File, _: &Metadata) -> io::Result<()> {
    Ok(())
}

#[cfg(unix)]
fn has_other_names(file: &Metadata) -> bool {
    std::os::unix::fs::MetadataExt::nlink(file) > 1
}

#[cfg(not(unix))]
fn has_other_names(_: &Metadata) -> bool {
    false
}

/// Returns true if a folder refuses new files, although the file to be replaced may still be writable: for instance a
/// file that is mounted into a container.
fn is_of_folder(error: &io::Error) -> bool {
    use ErrorKind::{CrossesDevices, PermissionDenied, ReadOnlyFilesystem, ResourceBusy};
    matches!(error.kind(), PermissionDenied | ReadOnlyFilesystem | ResourceBusy | CrossesDevices)
}

/// Returns true if there was no room for a file.
pub fn is_full(error: &Error) -> bool {
    matches!(error, Error::Io { source, .. } if no_room(source))
}

fn no_room(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge)
}

/// Says how much room a file needs if there was none.
fn sized(error: Error, bytes: usize) -> Error {
    match error {
        Error::Io { path, action, source } if no_room(&source) => {
            let text = format!("{source}: the file needs {bytes} bytes");
            Error::Io { path, action, source: io::Error::new(source.kind(), text) }
        }
        other => other,
    }
}

/// Writes a value as indented JSON, whole or not at all.
///
/// # Errors
/// [`Error::Io`].
pub fn write_json(path: &Path, value: &impl serde::Serialize) -> Result<()> {
    write_with(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        file.write_all(b"\n")
    })
}

/// SHA-256 of a file's content, in hexadecimal digits.
///
/// # Errors
/// [`Error::Io`].
pub fn digest(path: &Path) -> Result<String> {
    let mut file = reading::open(path).map_err(Error::io(path, "read"))?;
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer).map_err(Error::io(path, "read"))? {
            0 => return Ok(digits(hash)),
            count => hash.update(&buffer[..count]),
        }
    }
}

/// Hash in hexadecimal digits.
pub fn digits(hash: Sha256) -> String {
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Removes a file if it is there.
///
/// # Errors
/// [`Error::Io`].
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.map(|()| reach(Moment::Removed, path)).map_err(Error::io(path, "remove")),
    }
}

/// Removes a folder with everything in it, if it is there.
///
/// # Errors
/// [`Error::Io`].
pub fn remove_folder(path: &Path) -> Result<()> {
    match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => Err(Error::io(path, "remove")(error)),
        _ => Ok(()),
    }
}

/// Makes a folder with its parents, checks that files can be written into it, and removes what processes that were killed have
/// not finished there.
///
/// # Errors
/// [`Error::Io`].
pub fn writable_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(Error::io(path, "create the folder"))?;
    tempfile::tempfile_in(path).map_err(Error::io(path, "write into the folder"))?;
    remove_unfinished(path);
    Ok(())
}

/// Makes a folder as [`writable_folder`] does, but requires its parent to exist: a mistyped path makes none.
///
/// # Errors
/// [`Error::Io`].
pub fn writable_folder_in_place(path: &Path) -> Result<()> {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => {
            std::fs::metadata(parent).map_err(Error::io(path, "write into the folder")).map(drop)?;
        }
        _ => {}
    }
    writable_folder(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_whole(&path, b"old").unwrap();
        let failure = write_with(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("stop"))
        });
        assert!(failure.unwrap_err().to_string().contains("file: cannot write: stop"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_was_not_finished_is_removed_unless_somebody_is_at_it() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join(".metafmu-folder")).unwrap();
        let other = unfinished(folder.path()).unwrap();
        for check in [writable_folder, |path: &Path| check_output(&path.join("run.csv"))] {
            for name in [".metafmu-killed", ".metafmurc", "run.csv"] {
                fs::write(folder.path().join(name), "half a").unwrap();
            }
            check(folder.path()).unwrap();
            let left = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
            let mut left: Vec<_> = left.filter(|path| path != other.path()).collect();
            left.sort();
            assert!(other.path().exists());
            assert_eq!(left, [".metafmu-folder", ".metafmurc", "run.csv"].map(|name| folder.path().join(name)));
        }
    }

    #[test]
    fn folders_and_places_in_no_folder_are_refused_before_and_at_the_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (path, says) in [
            (folder.path().to_owned(), "is a directory"),
            (path("absent/"), "is a directory"),
            (path("absent/run.csv"), "there is no folder"),
        ] {
            for refused in
                [write_output(&path, |file| file.write_all(b"text")), write_whole(&path, b"text"), check_output(&path)]
            {
                let message = refused.unwrap_err().to_string();
                assert!(message.contains(says) && message.contains("cannot write"), "{message}");
            }
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[cfg(unix)]
    mod unix {
        use super::*;
        use std::os::unix::{
            fs::{PermissionsExt, symlink},
            net::UnixListener,
        };

        #[test]
        fn links_are_followed_and_modes_are_kept() {
            let folder = tempfile::tempdir().unwrap();
            let path = |name: &str| folder.path().join(name);
            fs::create_dir(path("far")).unwrap();
            fs::write(path("far/file"), "old").unwrap();
            fs::set_permissions(path("far/file"), PermissionsExt::from_mode(0o640)).unwrap();
            symlink("far/file", path("near")).unwrap();
            symlink(path("near"), path("link")).unwrap();
            symlink("far/absent", path("dangling")).unwrap();
            for name in ["link", "dangling"] {
                write_whole(&path(name), b"new").unwrap();
                assert!(fs::symlink_metadata(path(name)).unwrap().is_symlink());
                assert_eq!(fs::read(path(name)).unwrap(), b"new");
            }
            assert_eq!(fs::read(path("far/absent")).unwrap(), b"new");
            assert_eq!(fs::metadata(path("far/file")).unwrap().permissions().mode() & 0o7777, 0o640);
            symlink("round", path("round")).unwrap();
            let message = write_whole(&path("round"), b"new").unwrap_err().to_string();
            assert!(message.contains("too many symbolic links"), "{message}");
        }

        #[test]
        fn other_names_of_an_output_have_the_new_content_and_those_of_a_result_the_old() {
            let folder = tempfile::tempdir().unwrap();
            let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
            fs::write(&one, "a long old text").unwrap();
            fs::hard_link(&one, &two).unwrap();
            for new in ["short", "a text that is longer than the old one"] {
                write_output(&one, |file| file.write_all(new.as_bytes())).unwrap();
                assert_eq!(fs::read_to_string(&two).unwrap(), new);
            }
            write_whole(&one, b"result").unwrap();
            assert_eq!(fs::read(&one).unwrap(), b"result");
            assert_eq!(fs::read_to_string(&two).unwrap(), "a text that is longer than the old one");
        }

        #[test]
        fn a_socket_is_written_to() {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("socket");
            let listener = UnixListener::bind(&path).unwrap();
            let reader = std::thread::spawn(move || {
                let mut text = String::new();
                listener.accept().unwrap().0.read_to_string(&mut text).unwrap();
                text
            });
            check_output(&path).unwrap();
            write_output(&path, |file| file.write_all(b"time,x\n")).unwrap();
            assert_eq!(reader.join().unwrap(), "time,x\n");
        }
    }
}
