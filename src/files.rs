//! Files written whole or not at all.

use crate::{Error, Result};
use sha2::{Digest, Sha256};
use std::{
    io::{BufWriter, Read, Write},
    path::Path,
};
use tempfile::NamedTempFile;

/// Writes a file, see [`write_with`].
///
/// # Errors
/// [`Error::Io`]; whatever was at `path` is still there.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_with(path, |file| file.write_all(bytes))
}

/// Writes a file beside its place and moves it there when it is complete: a reader sees the old file or the new one.
///
/// # Errors
/// [`Error::Io`]; whatever was at `path` is still there.
pub fn write_with(path: &Path, write: impl FnOnce(&mut BufWriter<NamedTempFile>) -> std::io::Result<()>) -> Result<()> {
    let folder = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut builder = tempfile::Builder::new();
    builder.prefix(".metafmu-");
    // temporary files are private by default; this one becomes an ordinary file
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let file = builder.tempfile_in(folder).map_err(Error::io(path, "write"))?;
    let mut writer = BufWriter::with_capacity(1 << 16, file);
    write(&mut writer).map_err(Error::io(path, "write"))?;
    let file = writer.into_inner().map_err(|error| error.into_error()).map_err(Error::io(path, "write"))?;
    file.as_file().sync_all().map_err(Error::io(path, "write"))?;
    file.persist(path).map_err(|error| error.error).map_err(Error::io(path, "write"))?;
    Ok(())
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
    let mut file = std::fs::File::open(path).map_err(Error::io(path, "read"))?;
    let (mut hash, mut buffer) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut buffer).map_err(Error::io(path, "read"))? {
            0 => return Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()),
            count => hash.update(&buffer[..count]),
        }
    }
}

/// Removes a file if it is there.
///
/// # Errors
/// [`Error::Io`].
pub fn remove(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "remove")(error)),
        _ => Ok(()),
    }
}

/// Removes a folder with everything in it, if it is there.
///
/// # Errors
/// [`Error::Io`].
pub fn remove_folder(path: &Path) -> Result<()> {
    match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, "remove")(error)),
        _ => Ok(()),
    }
}

/// Makes a folder with its parents and checks that files can be written into it.
///
/// # Errors
/// [`Error::Io`].
pub fn writable_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(Error::io(path, "create the folder"))?;
    tempfile::tempfile_in(path).map_err(Error::io(path, "write into the folder"))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_whole(&path, b"old").unwrap();
        let failure = write_with(&path, |file| {
            file.write_all(b"new")?;
            Err(std::io::Error::other("stop"))
        });
        assert!(failure.unwrap_err().to_string().contains("file: cannot write: stop"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}
