//! FMUs for tests: written whole into a folder, and changed on request.

use metafmu_core::study::ExportOptions;
use metafmu_example as example;
use metafmu_export::export::{Binary, Contents, pack};
use metafmu_fmi::FmiVersion;
use metafmu_runtime::Surrogate;
use metafmu_surrogate::surrogate::seal;
use std::{
    io::{Cursor, Read, Write},
    path::{Path, PathBuf},
};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

/// Writes the example's FMU for FMI 2.0.
pub fn fmu(folder: &Path) -> PathBuf {
    changed_fmu(folder, |_| {})
}

/// Writes the example's FMU for a version.
pub fn fmu_of(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::surrogate(), version, |_| {})
}

/// Writes the FMU of an example one of whose columns is an input.
pub fn fmu_with_input(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::with_input(), version, |_| {})
}

/// Writes the FMU of an example whose outputs are grouped into arrays in FMI 3.0.
pub fn fmu_with_arrays(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::with_arrays(), version, |_| {})
}

/// Writes the FMU of an example with a nominal and a periodic parameter.
pub fn fmu_with_encodings(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::encoded(&example::surrogate()), version, |_| {})
}

/// Writes the FMU of an example with error bounds.
pub fn fmu_with_bounds(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::with_bounds(), version, |_| {})
}

/// Writes the FMU of a crane, which has states.
pub fn fmu_with_states(folder: &Path, version: FmiVersion) -> PathBuf {
    write(folder, &example::crane(), version, |_| {})
}

/// Entries of an archive.
pub type Entries = Vec<(String, Vec<u8>)>;

/// Writes the example's FMU for FMI 2.0 after a change of its entries.
pub fn changed_fmu(folder: &Path, change: impl FnOnce(&mut Entries)) -> PathBuf {
    write(folder, &example::surrogate(), FmiVersion::V2, change)
}

/// Writes the example's FMU for a version after a change of its modelDescription.xml.
pub fn fmu_of_described_as(folder: &Path, version: FmiVersion, change: impl FnOnce(String) -> String) -> PathBuf {
    write(folder, &example::surrogate(), version, |entries| {
        let text = String::from_utf8(std::mem::take(&mut entries[0].1)).unwrap();
        entries[0].1 = change(text).into_bytes();
    })
}

/// Writes the example's FMU for FMI 2.0 after a change of its modelDescription.xml.
pub fn fmu_described_as(folder: &Path, change: impl FnOnce(String) -> String) -> PathBuf {
    fmu_of_described_as(folder, FmiVersion::V2, change)
}

/// The entry whose name begins like that.
pub fn entry<'a>(entries: &'a mut Entries, start: &str) -> &'a mut (String, Vec<u8>) {
    entries.iter_mut().find(|(name, _)| name.starts_with(start)).unwrap()
}

fn write(folder: &Path, surrogate: &Surrogate, version: FmiVersion, change: impl FnOnce(&mut Entries)) -> PathBuf {
    let about = ExportOptions::default();
    let surrogate = seal(surrogate.clone()).unwrap();
    let contents = Contents {
        version,
        about: &about,
        binaries: &Binary::embedded(),
        accuracy: None,
        figures: &[],
        sources: false,
    };
    let mut zip = ZipArchive::new(Cursor::new(pack(&surrogate, &contents).unwrap())).unwrap();
    let mut entries: Entries = (0..zip.len())
        .map(|index| {
            let mut entry = zip.by_index(index).unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            (entry.name().unwrap().into_owned(), bytes)
        })
        .collect();
    change(&mut entries);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        zip.start_file(name, SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    let path = folder.join("example.fmu");
    std::fs::write(&path, zip.finish().unwrap().into_inner()).unwrap();
    path
}
