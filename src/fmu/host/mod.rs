//! Loads and runs FMI 2.0 co-simulation FMUs of any tool. All unsafe code of this crate is in this folder.
//!
//! An FMU is somebody else's machine code: running one is trusting it. What is made sure here is that calls, lifetimes
//! and pointers are right on this side.

mod elf;
mod ffi;
mod instance;
mod journal;
mod simulate;

pub use instance::{Instance, State, Step};
pub use journal::LogMessage;
pub use simulate::{Column, SimulationOptions, Table, simulate};
pub(super) use simulate::{Grid, Recorder};

use super::{Archive, ModelDescription, Platform, model_description::CoSimulation};
use crate::{Error, Result};
use ffi::Functions;
use libloading::Library;
use std::{
    ffi::{CStr, CString, c_char},
    path::{Path, PathBuf},
};
use tempfile::TempDir;

/// A loaded FMU: unpacked into a temporary folder that is removed when the value is dropped.
#[derive(Debug)]
pub struct Fmu {
    path: PathBuf,
    description: ModelDescription,
    co_simulation: CoSimulation,
    functions: Functions,
    resources: CString,
    // dropped in this order: the library is unloaded before its file is removed
    library: Library,
    _folder: TempDir,
}

impl Fmu {
    /// Opens, unpacks and loads an FMU. Initializers of its binary run.
    ///
    /// # Errors
    /// - [`Error::Io`], [`Error::Archive`], [`Error::ArchiveEntry`]: not a readable FMU archive;
    /// - [`Error::Description`]: modelDescription.xml is wrong in a way that cannot be read past, or not FMI 2.0;
    /// - [`Error::Interface`]: no co-simulation;
    /// - [`Error::NoBinary`]: not for this platform;
    /// - [`Error::Library`], [`Error::MissingFunction`]: the binary cannot be used.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut archive = Archive::open(path)?;
        let document = archive.document()?;
        if let Some(problem) = document.problems.iter().find(|problem| problem.unusable) {
            return Err(archive.description_error(problem));
        }
        let description = document.description;
        let found = if description.model_exchange.is_some() { "model exchange only" } else { "no interface" };
        let co_simulation =
            description.co_simulation.clone().ok_or_else(|| Error::Interface { path: path.to_owned(), found })?;
        let binary = Platform::CURRENT.binary(&co_simulation.interface.model_identifier);
        if !archive.contains(&binary) && !archive.contains(&binary.replace('/', "\\")) {
            return Err(Error::NoBinary { path: path.to_owned(), found: platforms(&archive)?, expected: binary });
        }
        let folder = tempfile::Builder::new()
            .prefix("metafmu-")
            .tempdir()
            .map_err(Error::io(&std::env::temp_dir(), "create a folder in"))?;
        archive.unpack(folder.path())?;
        let resources = folder.path().join("resources");
        std::fs::create_dir_all(&resources).map_err(Error::io(&resources, "create"))?;

        let file = folder.path().join(&binary);
        let bytes = std::fs::read(&file).map_err(Error::io(&file, "read"))?;
        if let Some(problem) = elf::cut_short(&bytes) {
            return Err(Error::ArchiveEntry { path: path.to_owned(), entry: binary, problem });
        }
        let library = load(&file).map_err(|source| Error::Library { path: path.to_owned(), binary, source })?;
        let functions = Functions::find(&library, path)?;
        Ok(Self {
            path: path.to_owned(),
            description,
            co_simulation,
            functions,
            resources: file_uri(&resources),
            library,
            _folder: folder,
        })
    }

    /// The file it was loaded from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the FMU says about itself.
    pub fn description(&self) -> &ModelDescription {
        &self.description
    }

    /// What the FMU says about its co-simulation interface.
    pub fn co_simulation(&self) -> &CoSimulation {
        &self.co_simulation
    }

    /// What `fmi2GetVersion` returns.
    pub fn version(&self) -> String {
        // SAFETY: the function takes nothing
        text(unsafe { (self.functions.get_version)() })
    }

    /// What `fmi2GetTypesPlatform` returns.
    pub fn types_platform(&self) -> String {
        // SAFETY: the function takes nothing
        text(unsafe { (self.functions.get_types_platform)() })
    }

    /// Functions of the standard that the binary does not export.
    pub fn missing_functions(&self) -> Vec<&'static str> {
        ffi::missing_functions(&self.library)
    }

    /// Makes an instance, in the state before `setup_experiment`.
    ///
    /// # Errors
    /// [`Error::Fmi`] with what the FMU logged if it returns no instance.
    pub fn instantiate(&self, name: &str, logging: bool) -> Result<Instance<'_>> {
        self.instantiate_as(name, &self.description.token, logging)
    }

    /// Makes an instance with a token that need not be the FMU's.
    pub(super) fn instantiate_as(&self, name: &str, token: &str, logging: bool) -> Result<Instance<'_>> {
        Instance::new(self, &c_text(name), &c_text(token), logging)
    }
}

/// Loads a binary.
fn load(binary: &Path) -> std::result::Result<Library, libloading::Error> {
    // SAFETY: initializers of the library run; that is what loading an FMU means
    unsafe { Library::new(binary) }
}

/// The platforms that an FMU has binaries for.
fn platforms(archive: &Archive) -> Result<Vec<String>> {
    let mut found: Vec<String> = archive
        .entries()?
        .iter()
        .filter_map(|entry| {
            let name = entry.name.replace('\\', "/");
            let (folder, file) = name.strip_prefix("binaries/")?.split_once('/')?;
            (!file.is_empty()).then(|| folder.to_owned())
        })
        .collect();
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// Text for C; what follows a zero byte is lost.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmu::testing::{changed_fmu, fmu, fmu_described_as};
    use metafmu_runtime::{Evaluator, example};

    fn predict(inputs: [f64; 3]) -> [f64; 2] {
        let evaluator = Evaluator::new(&example::surrogate());
        let mut outputs = [0.0; 2];
        evaluator.evaluate(&inputs, &mut outputs, &mut evaluator.scratch());
        outputs
    }

    fn outputs(instance: &Instance) -> [f64; 2] {
        let mut outputs = [0.0; 2];
        instance.get_real(&[3, 4], &mut outputs).unwrap();
        outputs
    }

    fn message(result: Result<impl std::fmt::Debug>) -> String {
        result.unwrap_err().to_string()
    }

    #[test]
    fn an_instance_computes_what_the_surrogate_predicts() {
        let folder = tempfile::tempdir().unwrap();
        let fmu = Fmu::open(fmu(folder.path())).unwrap();
        assert_eq!((fmu.version().as_str(), fmu.types_platform().as_str()), ("2.0", "default"));
        assert_eq!(fmu.missing_functions(), [""; 0]);
        let instance = fmu.instantiate("test", true).unwrap();
        instance.setup_experiment(0.0, Some(2.0)).unwrap();
        instance.set_real(&[1, 0], &[3.0, 0.12]).unwrap();
        instance.enter_initialization_mode().unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.0]));
        instance.exit_initialization_mode().unwrap();
        instance.do_step(0.0, 0.25).unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));

        let state = instance.state().unwrap();
        let bytes = state.to_bytes().unwrap();
        instance.set_real(&[0], &[0.2]).unwrap();
        instance.do_step(0.25, 1.0).unwrap();
        assert_eq!(outputs(&instance), predict([0.2, 3.0, 1.25]));
        state.restore().unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));
        instance.do_step(0.25, 1.0).unwrap();
        instance.state_from_bytes(&bytes).unwrap().restore().unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));
        drop(state);
        instance.terminate().unwrap();
    }

    #[test]
    fn a_refused_call_is_an_error_with_what_the_fmu_logged() {
        let folder = tempfile::tempdir().unwrap();
        let fmu = Fmu::open(fmu(folder.path())).unwrap();
        let instance = fmu.instantiate("test", true).unwrap();
        let Err(Error::Fmi { function, status, messages }) = instance.do_step(0.0, 1.0) else { panic!("no error") };
        assert_eq!((function, status), ("fmi2DoStep", "error"));
        assert!(messages[0].contains("fmi2DoStep"), "{messages:?}");
        let refused = message(fmu.instantiate_as("test", "{no such token}", true));
        assert!(refused.starts_with("fmi2Instantiate returned no instance: "), "{refused}");
        assert!(refused.contains("{no such token}"), "{refused}");
    }

    #[test]
    fn a_simulation_records_outputs_and_more_from_the_start_to_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let fmu = Fmu::open(fmu(folder.path())).unwrap();
        let instance = fmu.instantiate("test", true).unwrap();
        let options = SimulationOptions {
            stop: Some(0.95),
            step: Some(0.1),
            start_values: vec![("speed".into(), 4.0)],
            record: vec!["length".into(), "angle".into()],
            ..SimulationOptions::default()
        };
        let table = simulate(&instance, &options).unwrap();
        let columns: Vec<_> = table.columns.iter().map(|c| (c.name.as_str(), c.unit.as_deref())).collect();
        assert_eq!(columns, [("angle", Some("rad")), ("velocity", Some("rad/s")), ("length", Some("m"))]);
        assert_eq!(table.times.len(), 11);
        assert_eq!((table.times[3], table.times[10]), (3.0 * 0.1, 0.95));
        for (time, row) in table.times.iter().zip(&table.rows) {
            let expected = predict([row[2], 4.0, *time]);
            assert!((row[0] - expected[0]).abs() + (row[1] - expected[1]).abs() < 1e-13, "{time}");
        }
        instance.reset().unwrap();
        assert_eq!(simulate(&instance, &options).unwrap(), table);
        instance.reset().unwrap();
        let nothing = SimulationOptions { stop: Some(0.0), ..SimulationOptions::default() };
        assert_eq!(simulate(&instance, &nothing).unwrap().times, [0.0]);
    }

    #[test]
    fn what_cannot_be_simulated_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let fmu = Fmu::open(fmu(folder.path())).unwrap();
        let run = |options: SimulationOptions| {
            let instance = fmu.instantiate("test", true).unwrap();
            message(simulate(&instance, &options))
        };
        let start = |name: &str, value| SimulationOptions {
            start_values: vec![(name.into(), value)],
            ..SimulationOptions::default()
        };
        assert_eq!(
            run(start("lenght", 1.0)),
            "the FMU has no variable `lenght`; it has `length`, `speed`, `time`, `angle`, `velocity`"
        );
        assert_eq!(run(start("angle", 1.0)), "variable `angle`: has no start value to be set");
        let backwards = SimulationOptions { stop: Some(-1.0), ..SimulationOptions::default() };
        assert_eq!(run(backwards), "start 0 s, stop -1 s, step 0.01 s: finite times, the stop not before the start");
    }

    #[test]
    fn an_fmu_that_cannot_run_here_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let open = |path: PathBuf| message(Fmu::open(path));
        let expected = Platform::CURRENT.binary("example");
        let elsewhere = changed_fmu(folder.path(), |entries| entries[1].0 = "binaries/amiga/example.so".into());
        let reason = format!("no binary for this platform: found `amiga`, expected `{expected}`");
        assert!(open(elsewhere).ends_with(&reason));
        let garbage = changed_fmu(folder.path(), |entries| entries[1].1 = b"no library".into());
        assert!(open(garbage).contains(&format!("`{expected}` cannot be loaded: ")));
        let exchange = fmu_described_as(folder.path(), |text| {
            let start = text.find("<CoSimulation").unwrap();
            let end = start + text[start..].find("/>").unwrap() + 2;
            format!("{}<ModelExchange modelIdentifier=\"example\"/>{}", &text[..start], &text[end..])
        });
        assert!(open(exchange).ends_with("offers model exchange only, expected co-simulation"));
        let newer = fmu_described_as(folder.path(), |text| text.replace("fmiVersion=\"2.0\"", "fmiVersion=\"3.0\""));
        assert!(
            open(newer).ends_with("modelDescription.xml, line 2: fmiVersion is \"3.0\": only FMI 2.0 is supported")
        );
        let wrong =
            fmu_described_as(folder.path(), |text| text.replacen("valueReference=\"0\"", "valueReference=\"a\"", 1));
        assert!(open(wrong).contains("<ScalarVariable> has valueReference=\"a\", expected"));
    }

    #[test]
    fn a_path_becomes_a_percent_encoded_uri() {
        let uri = file_uri(Path::new("/tmp/a b/\u{fc}#%/resources"));
        assert_eq!(uri.to_str().unwrap(), "file:///tmp/a%20b/%C3%BC%23%25/resources");
    }
}
