//! FMUs for the tests of this module.

use crate::{study::ExportOptions, surrogate::seal};
use metafmu_runtime::example;
use std::{
    io::{Cursor, Read, Write},
    path::{Path, PathBuf},
};
use zip::{ZipArchive, ZipWriter, write::SimpleFileOptions};

/// Writes the example's FMU.
pub fn fmu(folder: &Path) -> PathBuf {
    changed_fmu(folder, |_| {})
}

/// Writes the example's FMU after a change of its entries.
pub fn changed_fmu(folder: &Path, change: impl FnOnce(&mut Vec<(String, Vec<u8>)>)) -> PathBuf {
    let surrogate = seal(example::surrogate()).unwrap();
    let mut zip = ZipArchive::new(Cursor::new(super::pack(&surrogate, &ExportOptions::default()).unwrap())).unwrap();
    let mut entries: Vec<(String, Vec<u8>)> = (0..zip.len())
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

/// The same with a change of its modelDescription.xml.
pub fn fmu_described_as(folder: &Path, change: impl FnOnce(String) -> String) -> PathBuf {
    changed_fmu(folder, |entries| {
        let text = String::from_utf8(std::mem::take(&mut entries[0].1)).unwrap();
        entries[0].1 = change(text).into_bytes();
    })
}
