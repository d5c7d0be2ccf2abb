//! A model file, libraries and what explains them become an `.fmu` archive.

use super::{
    Binary,
    card::card,
    describe::describe,
    reference::{OPTIONS_FILE, RESULT_FILE, reference},
    sources,
};
use crate::{
    Error, Result,
    evaluation::Accuracy,
    fmi::{Archive, FmiVersion, ModelDescription, identifier::model_identifier, xml},
    report::Drawn,
    study::ExportOptions,
    surrogate::with_names,
};
use metafmu_runtime::{FormatError, Surrogate};
use std::{
    collections::HashSet,
    io::{Cursor, Write},
    path::Path,
};
use zip::{CompressionMethod, DateTime, ZipWriter, result::ZipResult, write::SimpleFileOptions};

/// Archive entry with the model file, byte for byte as trained.
pub const MODEL_FILE: &str = "resources/model.safetensors";

/// Largest model file that is read.
const MAX_MODEL: u64 = 1 << 30;

const ICON: &[u8] = include_bytes!("assets/icon.png");
/// Licenses of the runtime library; that of the model is the author's business.
const LICENSES: [(&str, &[u8]); 4] = [
    ("license.txt", include_bytes!("assets/license.txt")),
    ("third-party.txt", include_bytes!("assets/third-party.txt")),
    ("MIT.txt", include_bytes!("assets/MIT.txt")),
    ("Apache-2.0.txt", include_bytes!("assets/Apache-2.0.txt")),
];

/// Contents of an FMU beside the surrogate.
#[derive(Clone, Debug)]
pub struct Contents<'a> {
    /// Version of the standard.
    pub version: FmiVersion,
    /// Metadata of the FMU.
    pub about: &'a ExportOptions,
    /// The library for each platform; [`Binary::embedded`] returns those that are part of this program.
    pub binaries: &'a [Binary],
    /// Accuracy of the surrogate, if it was measured.
    pub accuracy: Option<&'a Accuracy>,
    /// Pictures of how good it is, for the model card.
    pub figures: &'a [Drawn],
    /// `true` if the FMU contains the surrogate as C source code.
    pub sources: bool,
}

struct PackageEntry {
    name: String,
    bytes: Vec<u8>,
    executable: bool,
}

/// The bytes of the FMU of a surrogate; the same surrogate and contents always give the same bytes. No compiler is needed.
///
/// # Errors
/// [`Error::Ports`] for ports that it cannot have and for equal flat names, [`Error::Surrogate`] if the surrogate cannot be
/// written as a model file, [`Error::SamePlace`] if two binaries belong in the same place, [`Error::NoSources`].
pub fn pack(surrogate: &Surrogate, contents: &Contents) -> Result<Vec<u8>> {
    let Contents { version, about, binaries, accuracy, figures, sources } = contents;
    refuse_ports(surrogate, about)?;
    let card = card(surrogate, about, *accuracy, figures);
    let surrogate = &with_names(surrogate, about.names)?;
    let identifier = model_identifier(&surrogate.metadata().name);
    let icon = match version {
        FmiVersion::V2 => "model.png",
        FmiVersion::V3 => "terminalsAndIcons/icon.png",
    };
    let (options, result) = reference(surrogate);
    let model = surrogate.to_bytes().map_err(|source| Error::Surrogate { source })?;
    let mut entries = vec![
        file("documentation/index.html", card.into()),
        file(icon, ICON.into()),
        file(OPTIONS_FILE, options.into()),
        file(RESULT_FILE, result.into()),
        file(MODEL_FILE, model),
    ];
    entries.extend(LICENSES.map(|(name, text)| file(&format!("documentation/licenses/{name}"), text.into())));
    if *sources && !sources::cover(surrogate.program()) {
        return Err(Error::NoSources);
    }
    if *sources {
        let sources = sources::files(surrogate, &identifier, *version);
        entries.extend(sources.into_iter().map(|(name, bytes)| file(&name, bytes)));
    }
    let mut places = HashSet::new();
    for Binary { platform, bytes } in *binaries {
        let name = platform.binary(*version, &identifier);
        if !places.insert(name.clone()) {
            return Err(Error::SamePlace { entry: name, tuple: platform.tuple });
        }
        entries.push(PackageEntry { name, bytes: bytes.to_vec(), executable: true });
    }
    entries.sort_by(|a, b| a.name.cmp(&b.name));
    // first, for hosts that read the archive as a stream
    entries.insert(0, file("modelDescription.xml", xml::write(&description(surrogate, contents)).into()));
    // in memory: the only failures left are those of the zip format's limits
    write_zip(&entries).map_err(|source| Error::Archive { path: "the new FMU".into(), source })
}

/// An entry that is no program.
fn file(name: &str, bytes: Vec<u8>) -> PackageEntry {
    PackageEntry { name: name.into(), bytes, executable: false }
}

fn refuse_ports(surrogate: &Surrogate, about: &ExportOptions) -> Result<()> {
    let is_discrete = surrogate.program().sampling().is_some();
    let problems = about.port_problems(surrogate.bounds().is_some(), is_discrete);
    if problems.is_empty() { Ok(()) } else { Err(Error::Ports { problems }) }
}

fn description(surrogate: &Surrogate, contents: &Contents) -> ModelDescription {
    let mut description = describe(surrogate, contents.version, contents.about);
    if contents.sources && contents.version == FmiVersion::V2 {
        let files: Vec<String> =
            sources::compiled(surrogate, contents.version).into_iter().map(str::to_owned).collect();
        let of_model_exchange = description.model_exchange.as_mut().map(|offered| &mut offered.interface);
        let of_co_simulation = description.co_simulation.as_mut().map(|offered| &mut offered.interface);
        for interface in of_model_exchange.into_iter().chain(of_co_simulation) {
            interface.source_files.clone_from(&files);
        }
    }
    description
}

/// The surrogate inside an archive, if there is one; a model file of another program is none of ours.
///
/// # Errors
/// [`Error::ArchiveEntry`] if it is damaged.
pub(super) fn surrogate(archive: &mut Archive) -> Result<Option<Surrogate>> {
    if !archive.contains(MODEL_FILE) {
        return Ok(None);
    }
    match Surrogate::from_bytes(&archive.read(MODEL_FILE, MAX_MODEL)?) {
        Ok(surrogate) => Ok(Some(surrogate)),
        Err(FormatError::NoMetadata) => Ok(None),
        Err(error) => Err(of_model(archive.path(), error.to_string())),
    }
}

/// Reads the surrogate of an FMU, if metafmu made it.
///
/// # Errors
/// [`Error::Io`] or [`Error::Archive`] if it is no FMU, [`Error::ArchiveEntry`] if its surrogate is damaged.
pub fn find_surrogate(path: &Path) -> Result<Option<Surrogate>> {
    surrogate(&mut Archive::open(path)?)
}

/// Reads the surrogate of an FMU that metafmu made.
///
/// # Errors
/// [`Error::Io`] or [`Error::Archive`] if it is no FMU, [`Error::ArchiveEntry`] if it has no surrogate of metafmu inside or a
/// damaged one.
pub fn read_surrogate(path: &Path) -> Result<Surrogate> {
    find_surrogate(path)?.ok_or_else(|| {
        let problem = "expected a surrogate of metafmu, this is a third-party FMU: `metafmu simulate` runs it";
        of_model(path, problem.into())
    })
}

fn of_model(path: &Path, problem: String) -> Error {
    Error::ArchiveEntry { path: path.to_owned(), entry: MODEL_FILE.into(), problem }
}

fn write_zip(entries: &[PackageEntry]) -> ZipResult<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for PackageEntry { name, bytes, executable } in entries {
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
    use crate::{
        fmi::Platform,
        study::{FmuInterface, FmuPort, NameStyle},
        surrogate::seal,
    };
    use metafmu_example as example;
    use std::{io::Read, path::Path};

    #[test]
    fn licenses_in_an_fmu_are_those_of_the_repository() {
        for (copy, name) in [("assets/MIT.txt", "LICENSE-MIT"), ("assets/Apache-2.0.txt", "LICENSE-APACHE")] {
            let root = Path::new(env!("CARGO_MANIFEST_DIR"));
            let [copy, original] = [root.join("src/export").join(copy), root.join("../..").join(name)];
            assert!(std::fs::read(copy).unwrap() == std::fs::read(original).unwrap(), "{name}");
        }
    }

    fn pack_example(version: FmiVersion, binaries: &[Binary]) -> Result<Vec<u8>> {
        let about = ExportOptions { author: Some("A. Uthor".into()), ..ExportOptions::default() };
        let surrogate = seal(example::surrogate()).unwrap();
        pack(&surrogate, &Contents { version, about: &about, binaries, accuracy: None, figures: &[], sources: false })
    }

    #[test]
    fn an_fmu_is_reproducible_small_and_in_order() {
        for (version, icon) in [(FmiVersion::V2, "model.png"), (FmiVersion::V3, "terminalsAndIcons/icon.png")] {
            let fmu = pack_example(version, &Binary::embedded()).unwrap();
            assert!(fmu.len() < 1 << 20, "{} bytes", fmu.len());
            assert!(fmu == pack_example(version, &Binary::embedded()).unwrap());

            let mut zip = zip::ZipArchive::new(Cursor::new(&fmu)).unwrap();
            let names: Vec<String> = zip.file_names().map(|name| name.unwrap().into_owned()).collect();
            assert_eq!(names[0], "modelDescription.xml");
            assert!(names[1..].is_sorted());
            let binary = Platform::CURRENT.binary(version, "example");
            for (name, mode) in [(binary.as_str(), 0o100755), (icon, 0o100644), (MODEL_FILE, 0o100644)] {
                let entry = zip.by_name(name).unwrap();
                assert_eq!(entry.unix_mode(), Some(mode), "{name}");
                let time = entry.last_modified().unwrap();
                assert_eq!((time.year(), time.month(), time.day(), time.hour()), (1980, 1, 1, 0));
            }
            let mut inside = Vec::new();
            zip.by_name(MODEL_FILE).unwrap().read_to_end(&mut inside).unwrap();
            assert!(inside == seal(example::surrogate()).unwrap().to_bytes().unwrap());
        }
    }

    #[test]
    fn there_is_no_license_of_the_model_unless_its_author_states_one() {
        let surrogate = seal(example::surrogate()).unwrap();
        let text = |about: &ExportOptions, version, entry: &str| {
            let contents = Contents { version, about, binaries: &[], accuracy: None, figures: &[], sources: false };
            let mut zip = zip::ZipArchive::new(Cursor::new(pack(&surrogate, &contents).unwrap())).unwrap();
            let mut text = String::new();
            zip.by_name(entry).unwrap().read_to_string(&mut text).unwrap();
            text
        };
        let stated = ExportOptions { license: Some("GPL-3.0-only".into()), ..ExportOptions::default() };
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let description = text(&ExportOptions::default(), version, "modelDescription.xml");
            assert!(!description.contains("license="), "{description}");
            assert!(text(&stated, version, "modelDescription.xml").contains("license=\"GPL-3.0-only\""));
        }
        let licenses = text(&ExportOptions::default(), FmiVersion::V3, "documentation/licenses/license.txt");
        assert!(licenses.contains("The runtime library (binaries/): metafmu's, MIT OR Apache-2.0"), "{licenses}");
        assert!(licenses.contains("Where they state none,\nnone is granted here"), "{licenses}");
        let texts = text(&ExportOptions::default(), FmiVersion::V3, "documentation/licenses/third-party.txt");
        for package in ["safetensors ", "serde ", "hashbrown ", "The Rust standard library"] {
            assert!(texts.lines().any(|line| line.starts_with(package)), "{package}");
        }
        assert!(texts.contains("Permission is hereby granted, free of charge") && texts.contains("Apache License"));
    }

    #[test]
    fn platforms_share_an_fmu_unless_they_share_a_place() {
        let binary = |tuple| Binary { platform: Platform::from_tuple(tuple).unwrap(), bytes: b"library".into() };
        let both = [binary("x86_64-darwin"), binary("aarch64-darwin")];
        assert!(pack_example(FmiVersion::V3, &both).is_ok());
        let message = pack_example(FmiVersion::V2, &both).unwrap_err().to_string();
        assert!(message.contains("binaries/darwin64/example.dylib"), "{message}");
        let fmu = pack_example(FmiVersion::V2, &[binary("x86_64-windows"), binary("aarch64-linux")]).unwrap();
        let zip = zip::ZipArchive::new(Cursor::new(&fmu)).unwrap();
        assert!(zip.index_for_name("binaries/win64/example.dll").is_some());
        assert!(zip.index_for_name("binaries/aarch64-linux/example.so").is_some());
    }

    /// The surrogate inside an FMU with these options, or why there is none.
    fn packed(surrogate: &Surrogate, about: &ExportOptions) -> Result<Surrogate> {
        let contents =
            Contents { version: FmiVersion::V2, about, binaries: &[], accuracy: None, figures: &[], sources: false };
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), pack(surrogate, &contents)?).unwrap();
        read_surrogate(file.path())
    }

    #[test]
    fn flat_names_are_those_of_the_model_file_as_well() {
        let mut metadata = example::surrogate().metadata().clone();
        metadata.outputs[0].name = "rail.angle [1]".into();
        metadata.inputs[0].name = "2nd length".into();
        let hierarchical =
            seal(Surrogate::new(metadata.clone(), example::surrogate().program().clone()).unwrap()).unwrap();
        let flat = ExportOptions { names: NameStyle::Flat, ..ExportOptions::default() };
        let inside = packed(&hierarchical, &flat).unwrap();
        assert_eq!(
            (inside.outputs()[0].name.as_str(), inside.inputs()[0].name.as_str()),
            ("rail_angle_1", "_2nd_length")
        );
        assert_eq!(inside.program(), hierarchical.program());
        assert_eq!(packed(&hierarchical, &ExportOptions::default()).unwrap(), hierarchical);

        metadata.outputs[1].name = "rail_angle.1".into();
        let alike = seal(Surrogate::new(metadata, example::surrogate().program().clone()).unwrap()).unwrap();
        let message = packed(&alike, &flat).unwrap_err().to_string();
        assert!(message.ends_with("rail.angle [1], rail_angle.1 would all be `rail_angle_1`"), "{message}");
    }

    /// The message with which an export of the example with these ports fails.
    fn refusal_of(interface: FmuInterface, ports: &[FmuPort]) -> String {
        let about = ExportOptions { interface, ports: ports.into(), ..ExportOptions::default() };
        packed(&seal(example::surrogate()).unwrap(), &about).unwrap_err().to_string()
    }

    #[test]
    fn ports_that_an_fmu_cannot_have_are_refused_all_at_once() {
        let message = refusal_of(FmuInterface::Study, &[FmuPort::Bounds, FmuPort::Measured, FmuPort::Domain]);
        assert!(message.contains("`bounds`: there are no error bounds"), "{message}");
        assert!(message.contains("`measured`: only discrete-time FMUs take measured outputs"), "{message}");
        let message = refusal_of(FmuInterface::Plain, &[FmuPort::Domain]);
        assert!(message.contains("a plain interface has variables of the study only"), "{message}");
    }
}
