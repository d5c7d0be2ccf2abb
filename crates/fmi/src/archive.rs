//! An `.fmu` archive, or an `.ssp` archive with such in it, opened for reading.

use super::xml::{self, Document, tree::Element};
use crate::{
    Error, Result,
    diagnostics::kinds::{self, FileKind},
    reading,
    unpacking::{ArchiveSize, Patience, UnpackingClock, allowed_bytes},
};
use std::{
    fs::{self, File},
    io::{self, BufReader, ErrorKind, Read, Seek, Write},
    path::{Path, PathBuf},
};
use zip::{CompressionMethod, ZipArchive};

/// Largest modelDescription.xml that is read.
const MAX_DESCRIPTION: u64 = 256 << 20;

/// An `.fmu` archive, opened for reading.
#[derive(Debug)]
pub struct Archive {
    path: PathBuf,
    /// Bytes of the file.
    size: u64,
    zip: ZipArchive<BufReader<File>>,
}

/// One entry of the archive's directory.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Name as it is in the archive.
    pub name: String,
    /// `true` if reading it requires a password.
    pub encrypted: bool,
    /// `true` if FMI allows its compression method: stored or deflated.
    pub allowed_method: bool,
    /// Bytes of its content.
    pub size: u64,
    /// Reason why it cannot be unpacked safely, if there is one.
    pub unsafe_name: Option<&'static str>,
}

impl Archive {
    /// Opens an archive and reads its directory.
    ///
    /// # Errors
    /// [`Error::Io`] if there is no such file or it cannot be read, [`Error::Archive`] if it is not a zip archive.
    pub fn open(path: &Path) -> Result<Self> {
        let file = reading::open(path).map_err(Error::io(path, "open"))?;
        match kinds::of(path) {
            None | Some(FileKind::Fmu | FileKind::System | FileKind::Arrays) => Self::of_file(path.to_owned(), file),
            Some(_) => Err(kinds::other(path, "an FMU")),
        }
    }

    fn of_file(path: PathBuf, file: File) -> Result<Self> {
        let size = file.metadata().map_err(Error::io(&path, "open"))?.len();
        match ZipArchive::new(BufReader::new(file)) {
            Ok(zip) => Ok(Self { path, size, zip }),
            Err(source) => Err(Error::Archive { path, source }),
        }
    }

    /// Opens an archive that is an entry of this one; its path is that of this one followed by the entry's name.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if it is missing, damaged or too large, [`Error::Archive`] if it is not a zip archive.
    pub fn open_inner(&mut self, entry: &str) -> Result<Self> {
        let path = self.path.join(entry);
        if !self.contains(entry) {
            return Err(entry_error(&self.path, entry, "is missing".into()));
        }
        // a file without a name, which vanishes when it is closed
        let mut file = tempfile::tempfile().map_err(Error::io(&path, "unpack"))?;
        let content = self.zip.by_name(entry).map_err(|error| entry_error(&self.path, entry, error.to_string()))?;
        let limit = allowed_bytes(self.size);
        let count = io::copy(&mut content.take(limit + 1), &mut file).map_err(Error::io(&path, "unpack"))?;
        if count > limit {
            return Err(entry_error(&self.path, entry, format!("has more than {limit} bytes when it is unpacked")));
        }
        file.rewind().map_err(Error::io(&path, "unpack"))?;
        Self::of_file(path, file)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The directory.
    ///
    /// # Errors
    /// [`Error::Archive`] if an entry cannot be made sense of.
    pub fn entries(&self) -> Result<Vec<Entry>> {
        (0..self.zip.len())
            .map(|index| {
                let data = self.zip.by_index_data(index).map_err(self.archive_error())?;
                let name = data.name().map_err(self.archive_error())?.into_owned();
                Ok(Entry {
                    unsafe_name: if data.is_symlink() { Some("is a symbolic link") } else { unsafe_name(&name) },
                    encrypted: data.encrypted(),
                    size: data.size(),
                    allowed_method: matches!(
                        data.compression(),
                        CompressionMethod::Stored | CompressionMethod::Deflated
                    ),
                    name,
                })
            })
            .collect()
    }

    /// Returns true if two entries have the same name, so that readers may disagree about the content.
    pub fn has_duplicates(&self) -> bool {
        self.zip.has_duplicate_names()
    }

    /// Returns true if an entry of that name exists.
    pub fn contains(&self, name: &str) -> bool {
        self.zip.index_for_name(name).is_some()
    }

    /// The content of an entry of at most `limit` bytes, and no more than the archive may have.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if it is missing, damaged or larger.
    pub fn read(&mut self, name: &str, limit: u64) -> Result<Vec<u8>> {
        if !self.contains(name) {
            return Err(entry_error(&self.path, name, "is missing: not an FMU".into()));
        }
        let limit = limit.min(allowed_bytes(self.size));
        let entry = self.zip.by_name(name).map_err(|error| entry_error(&self.path, name, error.to_string()))?;
        if entry.size() > limit {
            return Err(entry_error(&self.path, name, format!("is larger than {limit} bytes")));
        }
        let mut bytes = Vec::new();
        // the size in the directory may be a lie: what counts is what comes out
        entry
            .take(limit + 1)
            .read_to_end(&mut bytes)
            .map_err(|error| entry_error(&self.path, name, error.to_string()))?;
        if bytes.len() as u64 > limit {
            return Err(entry_error(&self.path, name, format!("is larger than {limit} bytes")));
        }
        Ok(bytes)
    }

    /// The first bytes of an entry, at most `limit`.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if it is missing or damaged.
    pub fn read_start(&mut self, name: &str, limit: u64) -> Result<Vec<u8>> {
        let entry = self.zip.by_name(name).map_err(|error| entry_error(&self.path, name, error.to_string()))?;
        let mut bytes = Vec::new();
        entry.take(limit).read_to_end(&mut bytes).map_err(|error| entry_error(&self.path, name, error.to_string()))?;
        Ok(bytes)
    }

    /// Reads modelDescription.xml as far as it can be read.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if it is missing, [`Error::Description`] if it is not XML or of another FMI version.
    pub fn document(&mut self) -> Result<Document> {
        let root = self.description_root()?;
        xml::interpret(&root).map_err(|problem| description_error(&self.path, &problem))
    }

    /// The root element of modelDescription.xml.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if it is missing, [`Error::Description`] if it is not XML.
    pub fn description_root(&mut self) -> Result<Element> {
        let bytes = self.read("modelDescription.xml", MAX_DESCRIPTION)?;
        xml::root(&bytes).map_err(|problem| description_error(&self.path, &problem))
    }

    /// Unpacks the entries that are needed into a folder.
    ///
    /// # Errors
    /// [`Error::ArchiveEntry`] if an entry would land outside the folder, is damaged, or is beyond the limits of size and
    /// time; [`Error::Io`] if a file cannot be written; [`Error::Interrupted`].
    pub fn unpack(&mut self, folder: &Path, is_needed: fn(&str) -> bool, patience: Patience) -> Result<()> {
        let entries = self.entries()?;
        if let Some((entry, problem)) = entries.iter().find_map(|entry| Some((entry, entry.unsafe_name?))) {
            return Err(entry_error(&self.path, &entry.name, problem.into()));
        }
        let needed: Vec<(usize, &Entry)> =
            entries.iter().enumerate().filter(|(_, entry)| is_needed(&entry.name)).collect();
        let unpacked = needed.iter().fold(0u64, |sum, (_, entry)| sum.saturating_add(entry.size));
        let size = ArchiveSize { archive: self.size, entries: needed.len(), unpacked };
        if let Some(problem) = size.problem() {
            return Err(Error::ArchiveLimit { path: self.path.clone(), problem });
        }
        fs::create_dir_all(folder).map_err(Error::io(folder, "create"))?;
        let clock = patience.begin();
        needed.into_iter().try_for_each(|(index, entry)| self.unpack_entry(index, entry, folder, &clock))
    }

    fn unpack_entry(&mut self, index: usize, entry: &Entry, folder: &Path, clock: &UnpackingClock) -> Result<()> {
        let (path, name) = (&self.path, &entry.name);
        // some tools write backslashes
        let target = folder.join(entry.name.replace('\\', "/"));
        let is_folder = entry.name.ends_with(['/', '\\']);
        let parent = if is_folder { Some(target.as_path()) } else { target.parent() };
        if let Some(parent) = parent {
            fs::create_dir_all(parent).map_err(unpacking_error(path, name, parent, "create"))?;
        }
        if is_folder {
            return Ok(());
        }
        // gives no more than the size that is declared
        let mut content = self.zip.by_index(index).map_err(|error| entry_error(path, name, error.to_string()))?;
        let mut file = File::create(&target).map_err(unpacking_error(path, name, &target, "write"))?;
        let mut buffer = vec![0; 1 << 16];
        loop {
            if let Some(reason) = clock.problem()? {
                return Err(entry_error(path, name, reason));
            }
            let count = match content.read(&mut buffer) {
                Ok(0) => return Ok(()),
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(entry_error(path, name, error.to_string())),
            };
            file.write_all(&buffer[..count]).map_err(unpacking_error(path, name, &target, "write"))?;
        }
    }

    fn archive_error(&self) -> impl Fn(zip::result::ZipError) -> Error {
        move |source| Error::Archive { path: self.path.clone(), source }
    }
}

/// Something wrong with an entry of the archive at `path`.
fn entry_error(path: &Path, entry: &str, problem: String) -> Error {
    Error::ArchiveEntry { path: path.to_owned(), entry: entry.into(), problem }
}

/// The error of an entry whose target cannot be created or written.
fn unpacking_error(path: &Path, entry: &str, target: &Path, action: &'static str) -> impl Fn(io::Error) -> Error {
    move |error| match error.kind() {
        // names that are not valid for files here, or of a file that is a folder for another entry: the archive's fault
        ErrorKind::InvalidFilename
        | ErrorKind::InvalidInput
        | ErrorKind::NotADirectory
        | ErrorKind::IsADirectory
        | ErrorKind::AlreadyExists => entry_error(path, entry, format!("cannot be unpacked: {error}")),
        _ => Error::io(target, action)(error),
    }
}

/// Something wrong in the modelDescription.xml of the FMU at `path`.
pub fn description_error(path: &Path, problem: &xml::XmlProblem) -> Error {
    Error::Description { path: path.to_owned(), line: problem.line, problem: problem.message.clone() }
}

/// Reason why an entry of that name must not be unpacked, if there is one.
fn unsafe_name(name: &str) -> Option<&'static str> {
    let mut parts = name.split(['/', '\\']);
    if name.starts_with(['/', '\\']) {
        Some("has an absolute path")
    } else if parts.any(|part| part == "..") {
        Some("leads out of the archive by `..`")
    } else if name.as_bytes().get(1) == Some(&b':') || name.contains('\0') {
        Some("has a drive letter or a character that no file name may have")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::unpacking::MAX_ENTRIES;
    use zip::{ZipWriter, write::SimpleFileOptions};

    fn archive(folder: &Path, entries: &[(&str, &[u8])]) -> PathBuf {
        let path = folder.join("x.fmu");
        let mut zip = ZipWriter::new(File::create(&path).unwrap());
        for (name, bytes) in entries {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap();
        path
    }

    /// Unpacks everything.
    fn unpack(archive: &mut Archive, folder: &Path) -> Result<()> {
        archive.unpack(folder, |_| true, Patience::default())
    }

    fn message(result: Result<impl std::fmt::Debug>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn what_is_no_fmu_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("none.fmu");
        assert!(message(Archive::open(&missing)).contains("none.fmu: cannot open: "));
        assert!(message(Archive::open(folder.path())).contains("cannot open"));
        let text = folder.path().join("text.fmu");
        fs::write(&text, "plain text").unwrap();
        assert!(message(Archive::open(&text)).contains("text.fmu: not an FMU: "));
        let mut empty = Archive::open(&archive(folder.path(), &[("readme.txt", b"hello")])).unwrap();
        assert!(message(empty.document()).ends_with("entry `modelDescription.xml`: is missing: not an FMU"));
    }

    #[test]
    fn a_truncated_archive_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = archive(folder.path(), &[("modelDescription.xml", &[b'x'; 5000])]);
        let bytes = fs::read(&path).unwrap();
        fs::write(&path, &bytes[..bytes.len() - 30]).unwrap();
        assert!(matches!(Archive::open(&path), Err(Error::Archive { .. })));
    }

    #[test]
    fn entries_that_lead_outside_are_refused() {
        for name in ["../x", "a/../../x", "/etc/x", "\\x", "a\\..\\x", "C:x"] {
            let folder = tempfile::tempdir().unwrap();
            let mut archive = Archive::open(&archive(folder.path(), &[("good", b""), (name, b"")])).unwrap();
            let target = folder.path().join("out");
            assert!(
                matches!(unpack(&mut archive, &target), Err(Error::ArchiveEntry { entry, .. }) if entry == name),
                "{name}"
            );
            assert!(!target.exists(), "{name}");
        }
    }

    #[test]
    fn an_entry_larger_than_the_limit_is_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let mut archive = Archive::open(&archive(folder.path(), &[("zeros", &vec![0; 1 << 20])])).unwrap();
        assert_eq!(archive.read("zeros", 1 << 20).unwrap().len(), 1 << 20);
        assert!(message(archive.read("zeros", (1 << 20) - 1)).ends_with("is larger than 1048575 bytes"));
    }

    /// Replaces the sizes that the archive declares.
    fn declare(path: &Path, size: u32) {
        let mut bytes = fs::read(path).unwrap();
        for place in 0..bytes.len() - 28 {
            if bytes[place..].starts_with(b"PK\x01\x02") {
                bytes[place + 24..place + 28].copy_from_slice(&size.to_le_bytes());
            }
        }
        fs::write(path, bytes).unwrap();
    }

    #[test]
    fn an_archive_that_says_it_is_too_large_is_refused_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = archive(folder.path(), &[("a", b"1"), ("b", b"2")]);
        declare(&path, u32::MAX - 1);
        let target = folder.path().join("out");
        let found = message(unpack(&mut Archive::open(&path).unwrap(), &target));
        let says = "x.fmu: has 8589934588 bytes when it is unpacked, expected at most 67108864: pack it with less";
        assert!(found.contains(says), "{found}");
        assert!(!target.exists());
        assert!(message(Archive::open(&path).unwrap().read("a", 1 << 20)).ends_with("is larger than 1048576 bytes"));
    }

    #[test]
    fn archives_of_too_many_entries_are_refused_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<String> = (0..=MAX_ENTRIES).map(|index| format!("{index}")).collect();
        let entries: Vec<(&str, &[u8])> = names.iter().map(|name| (name.as_str(), b"".as_slice())).collect();
        let mut archive = Archive::open(&archive(folder.path(), &entries)).unwrap();
        let target = folder.path().join("out");
        let found = message(unpack(&mut archive, &target));
        assert!(found.ends_with("has 50001 entries to unpack, expected at most 50000"), "{found}");
        assert!(!target.exists());
        // what is not needed does not count
        archive.unpack(&target, |name| name == "7", Patience::default()).unwrap();
        assert_eq!(fs::read_dir(&target).unwrap().count(), 1);
    }

    #[test]
    fn unpacking_ends_at_its_time_limit() {
        let folder = tempfile::tempdir().unwrap();
        let mut archive = Archive::open(&archive(folder.path(), &[("a", b"1")])).unwrap();
        let patience = Patience { limit: std::time::Duration::ZERO, option: "--time-limit", stop: None };
        let found = message(archive.unpack(&folder.path().join("out"), |_| true, patience));
        assert!(
            found.ends_with("entry `a`: is not unpacked: the archive took longer than 0 s (--time-limit)"),
            "{found}"
        );
    }

    #[test]
    #[cfg(unix)]
    fn a_pipe_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe.fmu");
        assert!(std::process::Command::new("mkfifo").arg(&path).status().unwrap().success());
        let found = message(Archive::open(&path));
        assert!(found.contains("pipe.fmu: cannot open: it is not a regular file but a pipe"), "{found}");
    }

    #[test]
    fn an_entry_larger_than_it_says_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = archive(folder.path(), &[("zeros", &vec![0; 1 << 20])]);
        declare(&path, 10);
        let target = folder.path().join("out");
        let found = message(unpack(&mut Archive::open(&path).unwrap(), &target));
        assert!(found.ends_with("entry `zeros`: File is larger than its declared uncompressed size"), "{found}");
        assert!(fs::read(target.join("zeros")).unwrap().len() <= 10);
    }

    #[test]
    fn entries_that_cannot_be_files_are_the_archives_fault_and_a_folder_that_is_not_there_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let long = "x".repeat(5000);
        for (name, target) in [("a/b", "one"), (long.as_str(), "two")] {
            let path = archive(folder.path(), &[("a", b"1"), (name, b"2")]);
            let found = unpack(&mut Archive::open(&path).unwrap(), &folder.path().join(target));
            assert!(matches!(&found, Err(Error::ArchiveEntry { entry, .. }) if entry == name), "{found:?}");
        }
        let path = archive(folder.path(), &[("a", b"1")]);
        let found = unpack(&mut Archive::open(&path).unwrap(), Path::new("/dev/null/none"));
        assert!(matches!(found, Err(Error::Io { .. })), "{found:?}");
    }

    #[test]
    fn backslashes_and_folders_are_unpacked_as_paths() {
        let folder = tempfile::tempdir().unwrap();
        let mut archive = Archive::open(&archive(folder.path(), &[("a\\b.txt", b"b"), ("c/d/e.txt", b"e")])).unwrap();
        let target = folder.path().join("out");
        unpack(&mut archive, &target).unwrap();
        assert_eq!(fs::read(target.join("a/b.txt")).unwrap(), b"b");
        assert_eq!(fs::read(target.join("c/d/e.txt")).unwrap(), b"e");
    }
}
