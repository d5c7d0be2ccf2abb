//! A model file and the library inside every FMU become an `.fmu` archive.

use super::{ModelDescription, Platform, describe::model_identifier, xml};
use crate::{Error, Result, study::ExportOptions};
use metafmu_runtime::Surrogate;
use std::io::{Cursor, Write};
use zip::{CompressionMethod, DateTime, ZipWriter, result::ZipResult, write::SimpleFileOptions};

/// Archive entry with the model file, byte for byte what was trained.
pub const MODEL_FILE: &str = "resources/model.safetensors";

/// The library for this program's own platform, built with it.
const LIBRARY: &[u8] = include_bytes!(env!("METAFMU_FMU_LIBRARY"));

struct Entry<'a> {
    name: String,
    bytes: &'a [u8],
    executable: bool,
}

/// The bytes of the FMU of a surrogate; the same surrogate always gives the same bytes. No compiler is needed.
///
/// # Errors
/// [`Error::Surrogate`] if it cannot be written as a model file.
pub fn pack(surrogate: &Surrogate, about: &ExportOptions) -> Result<Vec<u8>> {
    let model = surrogate.to_bytes().map_err(|source| Error::Surrogate { source })?;
    let ExportOptions { author, copyright, license } = about.clone();
    let description = ModelDescription { author, copyright, license, ..ModelDescription::of_surrogate(surrogate) };
    let description = xml::write(&description);
    let binary = Platform::CURRENT.binary(&model_identifier(&surrogate.metadata().name));
    let entries = [
        // first, for hosts that read the archive as a stream; the others are sorted
        Entry { name: "modelDescription.xml".into(), bytes: description.as_bytes(), executable: false },
        Entry { name: binary, bytes: LIBRARY, executable: true },
        Entry { name: MODEL_FILE.into(), bytes: &model, executable: false },
    ];
    // in memory: the only failures left are those of the zip format's limits
    write_zip(&entries).map_err(|source| Error::Archive { path: "the new FMU".into(), source })
}

fn write_zip(entries: &[Entry]) -> ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for Entry { name, bytes, executable } in entries {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            // the first moment a zip archive can tell
            .last_modified_time(DateTime::DEFAULT)
            .unix_permissions(if *executable { 0o755 } else { 0o644 });
        zip.start_file(name.as_str(), options)?;
        zip.write_all(bytes)?;
    }
    Ok(zip.finish()?.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surrogate::seal;
    use metafmu_runtime::example;
    use std::io::Read;

    #[test]
    fn an_fmu_is_reproducible_small_and_in_order() {
        let surrogate = seal(example::surrogate()).unwrap();
        let about = ExportOptions { author: Some("A. Uthor".into()), ..ExportOptions::default() };
        let fmu = pack(&surrogate, &about).unwrap();
        assert!(fmu.len() < 1 << 20, "{} bytes", fmu.len());
        assert!(fmu == pack(&surrogate, &about).unwrap());

        let mut zip = zip::ZipArchive::new(Cursor::new(&fmu)).unwrap();
        let binary = Platform::CURRENT.binary("example");
        for (index, (name, mode)) in
            [("modelDescription.xml", 0o100644), (binary.as_str(), 0o100755), (MODEL_FILE, 0o100644)]
                .into_iter()
                .enumerate()
        {
            let entry = zip.by_index(index).unwrap();
            assert_eq!((entry.name().unwrap().as_ref(), entry.unix_mode()), (name, Some(mode)));
            let time = entry.last_modified().unwrap();
            assert_eq!((time.year(), time.month(), time.day(), time.hour()), (1980, 1, 1, 0));
        }
        let mut inside = Vec::new();
        zip.by_name(MODEL_FILE).unwrap().read_to_end(&mut inside).unwrap();
        assert!(inside == surrogate.to_bytes().unwrap());
    }
}
