//! Loads and runs FMI 2.0 and 3.0 FMUs of any tool, for co-simulation and model exchange. All unsafe code of this crate
//! is in this folder.
//!
//! An FMU is third-party machine code: running one requires trust. This module ensures that calls, lifetimes and
//! pointers are correct on the host's side.

mod elf;
mod exchange;
mod ffi;
mod fmi2;
mod fmi3;
mod grid;
mod inputs;
mod instance;
mod integrator;
mod journal;
mod labels;
mod options;
pub mod process;
mod python;
mod recorder;
mod simulate;
mod state;
mod stretch;
pub mod unpacked;
mod values;

pub use exchange::{CompletedStep, DiscreteStates};
pub use inputs::Inputs;
pub use instance::{FmuInstance, StepResult};
pub use journal::LogMessage;
pub use labels::{NO_EQUATIONS, StateEvaluation};
pub use options::SimulationOptions;
pub use recorder::{RecordedColumn, element_names};
pub use simulate::{RowSink, SimulationTable, simulate, simulate_into};
pub use state::FmuState;
pub use unpacked::Unpacked;
pub use {
    grid::Grid,
    inputs::NO_INPUTS,
    integrator::Exchange,
    recorder::Recorder,
    simulate::{is_settable, set_start},
    stretch::RunPosition,
};

use super::{
    Archive, ModelDescription, Platform,
    archive::description_error,
    model_description::{CoSimulation, FmiVersion, InterfaceCapabilities},
    xml::{self, Document},
};
use crate::{Error, Result, reading, unpacking::Patience};
use libloading::Library;
use serde::{Deserialize, Serialize};
use std::{
    ffi::{CStr, CString, c_char},
    fmt,
    path::{MAIN_SEPARATOR, Path, PathBuf},
};

/// Who advances the time of an FMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum InterfaceKind {
    /// The FMU itself, step by step.
    CoSimulation,
    /// The host, with a solver.
    ModelExchange,
}

impl fmt::Display for InterfaceKind {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::CoSimulation => "co-simulation",
            Self::ModelExchange => "model exchange",
        })
    }
}

/// The functions of a loaded binary.
#[derive(Debug)]
enum FmiFunctions {
    V2(fmi2::Fmi2Functions),
    V3(fmi3::Fmi3Functions),
}

/// An FMU loaded for one of its interfaces: unpacked into a temporary folder that is removed when the value is dropped.
#[derive(Debug)]
pub struct Fmu {
    path: PathBuf,
    description: ModelDescription,
    interface: InterfaceKind,
    functions: FmiFunctions,
    resources: CString,
    // dropped in this order: the library is unloaded before its file is removed
    library: Library,
    _folder: Option<unpacked::TemporaryFolder>,
}

/// Opens an archive and reads its content, including the interface to use and a binary for this platform.
///
/// # Errors
/// As [`Fmu::open`], but for what concerns the content of the binary.
pub fn describe(path: &Path, wanted: Option<InterfaceKind>) -> Result<(ModelDescription, InterfaceKind)> {
    inspect(&mut Archive::open(path)?, wanted)
}

fn inspect(archive: &mut Archive, wanted: Option<InterfaceKind>) -> Result<(ModelDescription, InterfaceKind)> {
    let path = archive.path().to_owned();
    let (description, interface) = usable(&path, archive.document()?, wanted)?;
    let binary = binary(&description, interface);
    if !archive.contains(&binary) && !archive.contains(&binary.replace('/', "\\")) {
        return Err(Error::NoBinary { path, found: libraries(archive, &binary)?, expected: binary });
    }
    Ok((description, interface))
}

/// An FMU's description of itself, if it can be used, and the interface to use.
fn usable(path: &Path, document: Document, wanted: Option<InterfaceKind>) -> Result<(ModelDescription, InterfaceKind)> {
    if let Some(problem) = document.problems.iter().find(|problem| problem.unusable) {
        return Err(description_error(path, problem));
    }
    let interface = choose(&document.description, wanted).map_err(|(found, expected)| Error::Interface {
        path: path.to_owned(),
        found,
        expected,
    })?;
    Ok((document.description, interface))
}

/// Entry of the binary for this platform.
fn binary(description: &ModelDescription, interface: InterfaceKind) -> String {
    let identifier = description.interface(interface).map_or("", |interface| &interface.model_identifier);
    Platform::CURRENT.binary(description.fmi_version, identifier)
}

impl Fmu {
    /// Opens, unpacks and loads an FMU for co-simulation or, if it does not offer that, for model exchange. Initializers
    /// of its binary run.
    ///
    /// # Errors
    /// - [`Error::Io`], [`Error::Archive`], [`Error::ArchiveEntry`]: not a readable FMU archive;
    /// - [`Error::Description`]: modelDescription.xml is wrong in a way that cannot be read past, or of another version;
    /// - [`Error::Interface`]: neither co-simulation nor model exchange;
    /// - [`Error::NoBinary`]: not for this platform;
    /// - [`Error::Library`], [`Error::MissingFunction`]: the binary cannot be used.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        Self::load(path.as_ref(), None)
    }

    /// Opens an FMU for one interface, see [`Fmu::open`].
    ///
    /// # Errors
    /// As [`Fmu::open`]; [`Error::Interface`] if it does not offer the interface.
    pub fn open_for(path: impl AsRef<Path>, interface: InterfaceKind) -> Result<Self> {
        Self::load(path.as_ref(), Some(interface))
    }

    fn load(path: &Path, wanted: Option<InterfaceKind>) -> Result<Self> {
        Unpacked::open(path, wanted, Patience::default())?.load()
    }

    /// Loads an FMU that another process has unpacked into a [temporary folder](Unpacked::folder), in a process that is there
    /// for it alone; `path` is for messages.
    ///
    /// # Errors
    /// As [`Fmu::open`].
    pub fn open_unpacked(path: &Path, folder: &Path, interface: InterfaceKind) -> Result<Self> {
        let folder = unpacked::files(folder);
        let file = folder.join("modelDescription.xml");
        let text = reading::read(&file, reading::MAX_WHOLE).map_err(Error::io(&file, "read"))?;
        let document = xml::read(&text).map_err(|problem| description_error(path, &problem))?;
        let (description, interface) = usable(path, document, Some(interface))?;
        Self::of_folder(path, &folder, description, interface, true)
    }

    /// Loads the FMU in a folder. `alone`: the process is for this FMU only.
    fn of_folder(
        path: &Path,
        folder: &Path,
        description: ModelDescription,
        interface: InterfaceKind,
        alone: bool,
    ) -> Result<Self> {
        let resources = folder.join("resources");
        let binary = binary(&description, interface);
        let file = folder.join(&binary);
        let bytes = reading::read(&file, reading::MAX_WHOLE).map_err(Error::io(&file, "read"))?;
        if let Some(problem) = elf::cut_short(&bytes) {
            return Err(Error::ArchiveEntry { path: path.to_owned(), entry: binary, problem });
        }
        let library = load_library(&file, &bytes, alone).map_err(|UnloadedLibrary { source, hint }| {
            let path = path.to_owned();
            Error::Library { path, binary, source, hint: hint.map(|hint| hint.to_string()) }
        })?;
        let (functions, resources) = match description.fmi_version {
            FmiVersion::V2 => {
                (FmiFunctions::V2(fmi2::Fmi2Functions::find(&library, path, interface)?), file_uri(&resources))
            }
            FmiVersion::V3 => {
                (FmiFunctions::V3(fmi3::Fmi3Functions::find(&library, path, interface)?), folder_path(&resources))
            }
        };
        Ok(Self { path: path.to_owned(), description, interface, functions, resources, library, _folder: None })
    }

    /// The file it was loaded from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The FMU's description of itself.
    pub fn description(&self) -> &ModelDescription {
        &self.description
    }

    /// Interface that it was loaded for.
    pub fn interface(&self) -> InterfaceKind {
        self.interface
    }

    /// Capabilities of the interface it was loaded for.
    pub fn capabilities(&self) -> InterfaceCapabilities {
        self.description.interface(self.interface).cloned().unwrap_or_default()
    }

    /// Capabilities of its co-simulation interface, if it was loaded for that.
    pub fn co_simulation(&self) -> Option<&CoSimulation> {
        self.description.co_simulation.as_ref().filter(|_| self.interface == InterfaceKind::CoSimulation)
    }

    /// Result of `fmi2GetVersion` or `fmi3GetVersion`.
    pub fn version(&self) -> String {
        let function = match &self.functions {
            FmiFunctions::V2(functions) => functions.get_version,
            FmiFunctions::V3(functions) => functions.get_version,
        };
        // SAFETY: the function takes nothing
        text(unsafe { function() })
    }

    /// Result of `fmi2GetTypesPlatform`; FMI 3.0 has no such function.
    pub fn types_platform(&self) -> Option<String> {
        match &self.functions {
            // SAFETY: the function takes nothing
            FmiFunctions::V2(functions) => Some(text(unsafe { (functions.get_types_platform)() })),
            FmiFunctions::V3(_) => None,
        }
    }

    /// Functions of the standard that the binary does not export.
    pub fn missing_functions(&self) -> Vec<&'static str> {
        ffi::missing(&self.library, &required_functions(self.description.fmi_version, self.interface))
    }

    /// Makes an instance, in the state before Initialization Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`] with the messages of the FMU if it returns no instance.
    pub fn instantiate(&self, name: &str, logging: bool) -> Result<FmuInstance<'_>> {
        self.instantiate_as(name, &self.description.token, logging)
    }

    /// Creates an instance with a token that may differ from the FMU's.
    ///
    /// # Errors
    /// As [`instantiate`](Self::instantiate).
    pub fn instantiate_as(&self, name: &str, token: &str, logging: bool) -> Result<FmuInstance<'_>> {
        FmuInstance::new(self, &c_text(name), &c_text(token), logging)
    }
}

/// Functions that a library must export for an interface: those that are always required, and those of the interface.
pub fn required_functions(version: FmiVersion, interface: InterfaceKind) -> [&'static [&'static str]; 2] {
    match (version, interface) {
        (FmiVersion::V2, InterfaceKind::CoSimulation) => [fmi2::REQUIRED, fmi2::REQUIRED_FOR_CO_SIMULATION],
        (FmiVersion::V2, InterfaceKind::ModelExchange) => [fmi2::REQUIRED, fmi2::REQUIRED_FOR_MODEL_EXCHANGE],
        (FmiVersion::V3, InterfaceKind::CoSimulation) => [fmi3::REQUIRED, fmi3::REQUIRED_FOR_CO_SIMULATION],
        (FmiVersion::V3, InterfaceKind::ModelExchange) => [fmi3::REQUIRED, fmi3::REQUIRED_FOR_MODEL_EXCHANGE],
    }
}

impl ModelDescription {
    /// Capabilities of an interface; `None` if the FMU does not offer it.
    pub fn interface(&self, kind: InterfaceKind) -> Option<&InterfaceCapabilities> {
        match kind {
            InterfaceKind::CoSimulation => self.co_simulation.as_ref().map(|co_simulation| &co_simulation.interface),
            InterfaceKind::ModelExchange => self.model_exchange.as_ref().map(|exchange| &exchange.interface),
        }
    }
}

/// The interface to use, or the FMU's interfaces and the expected one.
fn choose(
    description: &ModelDescription,
    wanted: Option<InterfaceKind>,
) -> std::result::Result<InterfaceKind, (String, String)> {
    let all = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
    let offered: Vec<InterfaceKind> = all.into_iter().filter(|&kind| description.interface(kind).is_some()).collect();
    let chosen = offered.iter().copied().find(|kind| wanted.is_none_or(|wanted| wanted == *kind));
    chosen.ok_or_else(|| {
        let scheduled = description.scheduled_execution.is_some();
        let found = match (offered.first(), scheduled) {
            (Some(kind), _) => format!("{kind} only"),
            (None, true) => "scheduled execution only".into(),
            (None, false) => "no interface".into(),
        };
        (found, wanted.map_or("co-simulation or model exchange".into(), |kind| kind.to_string()))
    })
}

/// Error of a binary that cannot be loaded.
struct UnloadedLibrary {
    source: libloading::Error,
    /// Missing Python interpreter, if the binary needs one.
    hint: Option<python::PythonError>,
}

/// Loads a binary of these bytes.
fn load_library(binary: &Path, bytes: &[u8], alone: bool) -> std::result::Result<Library, UnloadedLibrary> {
    // SAFETY: initializers of the library run; that is what loading an FMU means
    let load = || unsafe { Library::new(binary) };
    let source = match load() {
        Ok(library) => return Ok(library),
        Err(source) => source,
    };
    if !python::is_missing(bytes) {
        return Err(UnloadedLibrary { source, hint: None });
    }
    match python::provide(alone) {
        Ok(()) => load().map_err(|source| UnloadedLibrary { source, hint: None }),
        Err(error) => Err(UnloadedLibrary { source, hint: Some(error) }),
    }
}

/// Files in the folder of the missing `binary`; if there are none, the platforms that an FMU has binaries for.
fn libraries(archive: &Archive, binary: &str) -> Result<Vec<String>> {
    let (mut beside, mut platforms) = (Vec::new(), Vec::new());
    let expected_folder = binary.split('/').nth(1);
    for entry in archive.entries()? {
        let name = entry.name.replace('\\', "/");
        let Some((folder, file)) = name.strip_prefix("binaries/").and_then(|rest| rest.split_once('/')) else {
            continue;
        };
        if file.is_empty() {
            continue;
        }
        platforms.push(folder.to_owned());
        if expected_folder == Some(folder) {
            beside.push(name);
        }
    }
    let mut found = if beside.is_empty() { platforms } else { beside };
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// Text for C, up to the first zero byte.
fn c_text(text: &str) -> CString {
    CString::new(text.split('\0').next().unwrap_or_default()).unwrap_or_default()
}

/// Text that an FMU returned.
fn text(pointer: *const c_char) -> String {
    if pointer.is_null() {
        return String::new();
    }
    // SAFETY: not null, and the standard says that it ends with a zero byte and stays valid
    unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned()
}

/// `file:///` and the absolute path, percent-encoded (RFC 8089).
fn file_uri(path: &Path) -> CString {
    #[cfg(unix)]
    let bytes = std::os::unix::ffi::OsStrExt::as_bytes(path.as_os_str()).to_owned();
    #[cfg(not(unix))]
    let bytes = path.to_string_lossy().replace('\\', "/").into_bytes();
    let mut uri = String::from(if bytes.starts_with(b"/") { "file://" } else { "file:///" });
    for byte in bytes {
        if byte.is_ascii_alphanumeric() || b"-._~/:".contains(&byte) {
            uri.push(char::from(byte));
        } else {
            uri.push_str(&format!("%{byte:02X}"));
        }
    }
    c_text(&uri)
}

/// The path with a separator at its end, as FMI 3.0 requires.
fn folder_path(path: &Path) -> CString {
    c_text(&format!("{}{MAIN_SEPARATOR}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_becomes_a_percent_encoded_uri() {
        let uri = file_uri(Path::new("/tmp/a b/\u{fc}#%/resources"));
        assert_eq!(uri.to_str().unwrap(), "file:///tmp/a%20b/%C3%BC%23%25/resources");
    }
}
