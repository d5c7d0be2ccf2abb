//! An FMU's files in a temporary folder.

use super::{Fmu, InterfaceKind, inspect};
use crate::{Archive, Error, ModelDescription, Platform, Result, unpacking::Patience};
use std::{
    fs::{File, OpenOptions},
    io::ErrorKind,
    path::{Path, PathBuf},
};
use tempfile::TempDir;

/// Begins the names of these folders only: an empty one is left over.
const PREFIX: &str = "metafmu-fmu-";
/// The FMU's files in such a folder.
const FILES: &str = "fmu";
/// The file beside them that is locked for as long as the folder is used.
const LOCK: &str = "lock";

/// An FMU's files in a temporary folder, which is removed when the value is dropped. Nothing of it is loaded.
#[derive(Debug)]
pub struct Unpacked {
    path: PathBuf,
    description: ModelDescription,
    interface: InterfaceKind,
    folder: TemporaryFolder,
}

/// A temporary folder that is removed when the value is dropped; if its process was killed, when another is made.
#[derive(Debug)]
pub struct TemporaryFolder {
    // dropped in this order
    _lock: File,
    folder: TempDir,
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        // the lock goes last: if the process is killed meanwhile, another one finds what is left by it
        let _ = std::fs::remove_dir_all(self.files());
    }
}

impl Unpacked {
    /// Opens and unpacks an FMU for one interface; else for co-simulation or, if it does not offer that, for model exchange.
    ///
    /// # Errors
    /// As [`Fmu::open`], but for what concerns the content of the binary.
    pub fn open(path: &Path, wanted: Option<InterfaceKind>, patience: Patience) -> Result<Self> {
        Self::of_archive(Archive::open(path)?, wanted, patience)
    }

    /// Unpacks an FMU, see [`Unpacked::open`].
    ///
    /// # Errors
    /// As [`Unpacked::open`].
    pub fn of_archive(mut archive: Archive, wanted: Option<InterfaceKind>, patience: Patience) -> Result<Self> {
        let (description, interface) = inspect(&mut archive, wanted)?;
        let folder = TemporaryFolder::create()?;
        let files = folder.files();
        archive.unpack(&files, is_needed, patience)?;
        let resources = files.join("resources");
        std::fs::create_dir_all(&resources).map_err(Error::io(&resources, "create"))?;
        Ok(Self { path: archive.path().to_owned(), description, interface, folder })
    }

    /// The FMU.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The FMU's description of itself.
    pub fn description(&self) -> &ModelDescription {
        &self.description
    }

    /// Interface that it was unpacked for.
    pub fn interface(&self) -> InterfaceKind {
        self.interface
    }

    /// The temporary folder, which [`Fmu::open_unpacked`] takes.
    pub fn folder(&self) -> &Path {
        self.folder.folder.path()
    }

    /// Loads the FMU.
    ///
    /// # Errors
    /// As [`Fmu::open`].
    pub fn load(self) -> Result<Fmu> {
        let fmu = Fmu::of_folder(&self.path, &self.folder.files(), self.description, self.interface, false)?;
        Ok(Fmu { _folder: Some(self.folder), ..fmu })
    }
}

impl TemporaryFolder {
    fn create() -> Result<Self> {
        const ACTION: &str = "create a folder in";
        let parent = std::env::temp_dir();
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX);
        // no one else may write into it
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o700));
        loop {
            let folder = builder.tempdir_in(&parent).map_err(Error::io(&parent, ACTION))?;
            let name = folder.path().join(LOCK);
            let lock = match File::create_new(&name) {
                // another process has taken the empty folder for one that was left
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                lock => lock.map_err(Error::io(&parent, ACTION))?,
            };
            // where files cannot be locked, nobody finds a folder that is not
            let _ = lock.lock();
            // another process may have taken it for a stale one before it was locked
            if name.exists() {
                remove_stale(folder.path(), &parent);
                return Ok(Self { _lock: lock, folder });
            }
        }
    }

    fn files(&self) -> PathBuf {
        files(self.folder.path())
    }
}

/// Returns true if an FMU that runs here may need an entry: neither documents and source code nor libraries for other
/// operating systems. Libraries for other processors stay, as some FMUs start programs for these.
fn is_needed(entry: &str) -> bool {
    let name = entry.replace('\\', "/");
    let (folder, rest) = name.split_once('/').unwrap_or(("", &name));
    match folder {
        "documentation" | "sources" | "terminalsAndIcons" => false,
        "binaries" => {
            let platform = rest.split('/').next().unwrap_or_default();
            let known = Platform::ALL.into_iter().find(|known| [known.tuple, known.folder_2].contains(&platform));
            known.is_none_or(|known| known.extension == Platform::CURRENT.extension)
        }
        _ => true,
    }
}

/// Path of the FMU's files in a temporary folder.
pub(super) fn files(folder: &Path) -> PathBuf {
    folder.join(FILES)
}

/// Removes a temporary folder of another process, which has ended.
pub fn remove(folder: &Path) {
    if is_named(folder) {
        // it may be gone already; the lock goes last
        let _ = std::fs::remove_dir_all(files(folder));
        let _ = std::fs::remove_dir_all(folder);
    }
}

/// Returns true if a folder has a name as these folders have.
fn is_named(folder: &Path) -> bool {
    folder.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PREFIX))
}

/// Removes the folders beside one's own that killed processes of the same user have left: nobody holds their locks.
fn remove_stale(own: &Path, parent: &Path) {
    let others = std::fs::read_dir(parent).into_iter().flatten().flatten().map(|entry| entry.path());
    for other in others.filter(|other| other != own && have_one_owner(own, other)) {
        match OpenOptions::new().read(true).write(true).open(other.join(LOCK)) {
            // the lock is held until the folder is gone: its owner may be between making the folder and locking it
            Ok(lock) if lock.try_lock().is_ok() => remove(&other),
            // killed before there was a lock, or after it was gone
            Err(error) if error.kind() == ErrorKind::NotFound && is_named(&other) => drop(std::fs::remove_dir(&other)),
            _ => {}
        }
    }
}

/// Returns true if two paths are folders, not links, of one user.
fn have_one_owner(first: &Path, second: &Path) -> bool {
    let owner = |path: &Path| {
        let metadata = std::fs::symlink_metadata(path).ok().filter(std::fs::Metadata::is_dir)?;
        #[cfg(unix)]
        let owner = std::os::unix::fs::MetadataExt::uid(&metadata);
        // the temporary folder is a user's own
        #[cfg(not(unix))]
        let owner = metadata.is_dir();
        Some(owner)
    };
    owner(first).is_some() && owner(first) == owner(second)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_entries_that_a_run_may_need_are_unpacked() {
        let own = Platform::CURRENT.binary(crate::FmiVersion::V2, "m");
        for name in ["modelDescription.xml", "resources/a/b", "extra/x", "binaries/odd/m.so", "resources\\a", &own] {
            assert!(is_needed(name), "{name}");
        }
        let other = if cfg!(windows) { "binaries/linux64/m.so" } else { "binaries/win64/m.dll" };
        for name in ["documentation/index.html", "sources/m.c", "terminalsAndIcons/icon.png", other] {
            assert!(!is_needed(name), "{name}");
        }
    }

    #[test]
    fn a_folder_that_nobody_holds_is_removed_when_another_is_made() {
        let parent = tempfile::tempdir().unwrap();
        let make = |name: &str| {
            let folder = parent.path().join(name);
            std::fs::create_dir_all(folder.join(FILES)).unwrap();
            File::create_new(folder.join(LOCK)).unwrap()
        };
        let own = parent.path().join("metafmu-fmu-own");
        let (_, used) = (make("metafmu-fmu-own"), make("metafmu-fmu-used"));
        used.lock().unwrap();
        drop((make("metafmu-fmu-stale"), make("another")));
        // as a process leaves them that is killed between two steps
        std::fs::create_dir(parent.path().join("metafmu-fmu-empty")).unwrap();
        std::fs::create_dir(parent.path().join("metafmu-empty-of-a-program")).unwrap();
        std::fs::create_dir_all(parent.path().join("metafmu-fmu-other").join("of somebody else")).unwrap();
        #[cfg(unix)]
        std::os::unix::fs::symlink(parent.path().join("another"), parent.path().join("metafmu-fmu-link")).unwrap();
        remove_stale(&own, parent.path());
        let mut left: Vec<String> = std::fs::read_dir(parent.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .filter(|name| name != "metafmu-fmu-link")
            .collect();
        left.sort_unstable();
        assert_eq!(
            left,
            ["another", "metafmu-empty-of-a-program", "metafmu-fmu-other", "metafmu-fmu-own", "metafmu-fmu-used"]
        );
        #[cfg(unix)]
        assert!(parent.path().join("another").join(FILES).exists() && parent.path().join("metafmu-fmu-link").exists());
    }
}
