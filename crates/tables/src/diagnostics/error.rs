//! The one error type: every message says where, what was found and what was expected.

use super::{
    Place,
    interruption::Interruption,
    names::{did_you_mean, expected_one_of},
    numbers::exact,
    problem::Problem,
};
use std::{
    fmt::Display,
    path::{Path, PathBuf},
};

/// Every error of the tool.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The attempted operation, for instance `read`.
        action: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A study or mechanism file is wrong.
    #[error("{}", problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Study {
        /// Every problem found.
        problems: Vec<Problem>,
    },
    /// A simulation failed.
    #[error("{system} with {values}: {message}")]
    Run {
        /// The system or mechanism.
        system: String,
        /// The parameter values.
        values: String,
        /// The cause of the failure.
        message: String,
    },
    /// More runs failed than allowed.
    #[error(
        "{source_name}: {failed} of {total} runs failed, at most {allowed} may (source.max_failed = {share}); the last one \
         with {parameters}: {reason}"
    )]
    FailedRuns {
        /// The FMU, the mechanism file or the built-in system.
        source_name: String,
        /// The number of failed runs so far.
        failed: usize,
        /// The total number of runs.
        total: usize,
        /// The allowed number.
        allowed: usize,
        /// The allowed share.
        share: f64,
        /// The parameter values of the last one that failed.
        parameters: String,
        /// The reason of the last failure.
        reason: String,
    },
    /// The process that runs an FMU could not begin.
    #[error("{message}")]
    Worker {
        /// The reason.
        message: String,
    },
    /// Stopped by the user.
    #[error("stopped")]
    Interrupted,
    /// A build that the user stopped.
    #[error("{interruption}")]
    Unfinished {
        /// The results that are there, and those that are missing.
        interruption: Interruption,
    },
    /// A table is wrong.
    #[error("{}{}: {message}", path.display(), place.behind_path())]
    Table {
        /// The table's file.
        path: PathBuf,
        /// The location in the table.
        place: Place,
        /// Found and expected values.
        message: String,
    },
    /// The result of an earlier stage is missing, belongs to another study, or was changed since.
    #[error("{}: {message}", path.display())]
    Stale {
        /// The file.
        path: PathBuf,
        /// The remedy.
        message: String,
    },
    /// The tables were sampled from a study with other settings.
    #[error(
        "{}: the tables beside it were sampled from another study, with other settings of the source, parameters, time or \
         sampling: run `metafmu sample` again, or `metafmu build` without --resume",
        path.display()
    )]
    OtherStudy {
        /// The record of the sampling.
        path: PathBuf,
    },
    /// A plot could not be made.
    #[error("{}: {message}", path.display())]
    Plot {
        /// The plot's file.
        path: PathBuf,
        /// The reason.
        message: String,
    },
    /// A model file is wrong.
    #[error("{}: {source}", path.display())]
    Model {
        /// The model file.
        path: PathBuf,
        /// The format error.
        source: Box<metafmu_runtime::FormatError>,
    },
    /// A file that cannot be a surrogate by its name.
    #[error("{}: {message}", path.display())]
    OtherFile {
        /// The file.
        path: PathBuf,
        /// The kind of file, if it is known, the expected kind, and the remedy.
        message: String,
    },
    /// A surrogate with states, memory, or a network for each time point, which ONNX cannot represent.
    #[error(
        "the surrogate has states, a memory, or a network for each instant, which an ONNX model has not: expected one of the structure \
         \"response\""
    )]
    NoOnnx,
    /// C sources of a program that has none.
    #[error(
        "there is no C code for a model file that combines equations of motion, or networks for instants, with other steps"
    )]
    NoSources,
    /// Rows of a table are wrong.
    #[error("{}", problems.iter().map(|(place, message)| format!("{}{}: {message}", path.display(), place.behind_path())).collect::<Vec<_>>().join("\n"))]
    Rows {
        /// The table.
        path: PathBuf,
        /// The locations, with found and expected values.
        problems: Vec<(Place, String)>,
    },
    /// A model of another tool that cannot be imported.
    #[error("{}", problems.iter().map(|problem| format!("{}: {problem}", path.display())).collect::<Vec<_>>().join("\n"))]
    Import {
        /// The file.
        path: PathBuf,
        /// The mismatches.
        problems: Vec<String>,
    },
    /// An output would take the place of the file that it is made of.
    #[error("{}: is the surrogate itself: expected another folder, by --out", path.display())]
    SameFile {
        /// The file.
        path: PathBuf,
    },
    /// The parts of a surrogate do not fit each other.
    #[error("surrogate: {source}")]
    Surrogate {
        /// The mismatch.
        source: metafmu_runtime::FormatError,
    },
    /// A file is not a zip archive, or is damaged.
    #[error("{}: not an {}: {}", path.display(), archive_kind(path), no_zip(source))]
    Archive {
        /// The file.
        path: PathBuf,
        /// The error of the zip reader.
        source: zip::result::ZipError,
    },
    /// Something about one entry of an FMU archive.
    #[error("{}: entry `{entry}`: {problem}", path.display())]
    ArchiveEntry {
        /// The FMU.
        path: PathBuf,
        /// Name of the entry.
        entry: String,
        /// The problem.
        problem: String,
    },
    /// An archive is beyond the limits of what is unpacked.
    #[error("{}: {problem}", path.display())]
    ArchiveLimit {
        /// The archive.
        path: PathBuf,
        /// Found and expected size.
        problem: String,
    },
    /// An FMU's modelDescription.xml cannot be used.
    #[error("{}: modelDescription.xml, line {line}: {problem}", path.display())]
    Description {
        /// The FMU.
        path: PathBuf,
        /// Line in modelDescription.xml, counted from 1.
        line: usize,
        /// The problem.
        problem: String,
    },
    /// An FMU does not offer the interface needed.
    #[error("{}: offers {found}, expected {expected}", path.display())]
    Interface {
        /// The FMU.
        path: PathBuf,
        /// The interface of the FMU.
        found: String,
        /// The required interface.
        expected: String,
    },
    /// Variables that an FMU of this surrogate cannot have.
    #[error("the interface of the FMU: {}", problems.join("; "))]
    Ports {
        /// All that is wrong.
        problems: Vec<String>,
    },
    /// An FMU that is run by model exchange cannot be integrated.
    #[error("model exchange failed at {time} s: {message}")]
    Integration {
        /// The time of the failure, in seconds.
        time: f64,
        /// The cause of the failure.
        message: String,
    },
    /// A platform that does not exist.
    #[error("platform `{tuple}` is not known, expected {expected}")]
    UnknownPlatform {
        /// The requested platform.
        tuple: String,
        /// The platform that was perhaps meant, or the known ones.
        expected: String,
    },
    /// A platform without an embedded library in this program.
    #[error(
        "platform `{tuple}` has no library in this program, which has {}: add one with `metafmu export MODEL --binary {tuple}=FILE`",
        list_or_none(known)
    )]
    NotEmbedded {
        /// The requested platform.
        tuple: String,
        /// The embedded platforms.
        known: Vec<String>,
    },
    /// Two libraries that belong in the same place.
    #[error("`{entry}`: the place of {tuple} is taken already; a universal library serves both processors of darwin")]
    SamePlace {
        /// The archive entry.
        entry: String,
        /// The second platform.
        tuple: &'static str,
    },
    /// A baseline that could not be fitted or cannot be exported.
    #[error("model `{model}`: {problem}")]
    Baseline {
        /// The model's name.
        model: &'static str,
        /// The reason.
        problem: String,
    },
    /// A library that cannot go into an FMU.
    #[error("{}: {problem}", path.display())]
    Binary {
        /// Its file.
        path: PathBuf,
        /// The reason.
        problem: String,
    },
    /// An FMU has no binary for this platform.
    #[error("{}: no binary for this platform: found {}, expected `{expected}`", path.display(), list_or_none(found))]
    NoBinary {
        /// The FMU.
        path: PathBuf,
        /// Files in the folder of the missing entry; without any, platforms that it has binaries for.
        found: Vec<String>,
        /// The entry that is missing.
        expected: String,
    },
    /// The binary of an FMU cannot be loaded.
    #[error("{}: `{binary}` cannot be loaded: {source}{}{}", path.display(), cause(source), after_colon(hint.as_slice()))]
    Library {
        /// The FMU.
        path: PathBuf,
        /// Name of the entry.
        binary: String,
        /// The system's reason.
        source: libloading::Error,
        /// The remedy, if one is known.
        hint: Option<String>,
    },
    /// The binary of an FMU lacks a function.
    #[error("{}: the binary does not export `{function}`", path.display())]
    MissingFunction {
        /// The FMU.
        path: PathBuf,
        /// The function.
        function: &'static str,
    },
    /// The description of a system is wrong, or does not fit its components.
    #[error("{}", lines_of(path, problems))]
    System {
        /// The system's description.
        path: PathBuf,
        /// Every problem found, with its line counted from 1.
        problems: Vec<(usize, String)>,
    },
    /// A component that a system does not have.
    #[error("{}: there is no component `{name}`, {}", path.display(), {
        let known: Vec<&str> = known.iter().map(String::as_str).collect();
        expected_one_of(name, &known)
    })]
    UnknownComponent {
        /// The system's description.
        path: PathBuf,
        /// The requested name.
        name: String,
        /// The known names.
        known: Vec<String>,
    },
    /// A component cannot be replaced by another FMU.
    #[error("{}", problems.iter().map(|problem| format!("{}: {problem}", path.display())).collect::<Vec<_>>().join("\n"))]
    Replacement {
        /// The FMU that was to replace it.
        path: PathBuf,
        /// Every problem found.
        problems: Vec<String>,
    },
    /// A component of a system failed.
    #[error("component `{name}`: {source}")]
    Component {
        /// Its name.
        name: String,
        /// The failure.
        source: Box<Self>,
    },
    /// A function of an FMU failed.
    #[error("{function} returned {status}{}", after_colon(messages))]
    Fmi {
        /// The function.
        function: &'static str,
        /// The returned status.
        status: &'static str,
        /// The messages that the FMU logged.
        messages: Vec<String>,
    },
    /// A variable that the FMU does not have.
    #[error(
        "the FMU has no variable `{name}`; it has {}{}",
        list_or_none(known),
        did_you_mean(name, known.iter().map(String::as_str))
    )]
    UnknownVariable {
        /// The requested name.
        name: String,
        /// The known names.
        known: Vec<String>,
    },
    /// A value or variable that cannot be used as requested.
    #[error("variable `{name}`: {problem}")]
    Variable {
        /// The variable.
        name: String,
        /// The reason.
        problem: String,
    },
    /// Times that make no simulation.
    #[error("start {} s, {}, {}: {expected}", exact(*start), time_or_none("stop", *stop), time_or_none("step", *step))]
    Experiment {
        /// Start time.
        start: f64,
        /// Stop time, if there is one.
        stop: Option<f64>,
        /// Communication step size, if there is one.
        step: Option<f64>,
        /// The expected times.
        expected: &'static str,
    },
    /// The network cannot be built.
    #[error(transparent)]
    Network(Box<dyn std::error::Error + Send + Sync>),
    /// The network cannot be trained.
    #[error(transparent)]
    Training(Box<dyn std::error::Error + Send + Sync>),
}

/// A time with its name, for instance `stop 1 s` or `no stop`.
fn time_or_none(name: &str, time: Option<f64>) -> String {
    time.map_or_else(|| format!("no {name}"), |time| format!("{name} {} s", exact(time)))
}

/// At most ten items, in backquotes.
fn list_or_none(items: &[String]) -> String {
    let shown: Vec<String> = items.iter().take(10).map(|item| format!("`{item}`")).collect();
    match items.len() {
        0 => "none".into(),
        count if count > shown.len() => format!("{} and {} more", shown.join(", "), count - shown.len()),
        _ => shown.join(", "),
    }
}

/// Problems of a file, one per line.
fn lines_of(path: &Path, problems: &[(usize, String)]) -> String {
    let lines = problems.iter().map(|(line, problem)| format!("{}:{line}: {problem}", path.display()));
    lines.collect::<Vec<_>>().join("\n")
}

/// Kind of archive expected for a file name: an SSP archive or an FMU.
fn archive_kind(path: &Path) -> &'static str {
    if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ssp")) { "SSP archive" } else { "FMU" }
}

/// The reason why a file cannot be read as a zip archive.
fn no_zip(error: &zip::result::ZipError) -> String {
    use zip::result::ZipError;
    match error {
        ZipError::InvalidArchive(what) if what.contains("EOCD") => {
            "it is no zip archive, or one whose end is missing".into()
        }
        ZipError::InvalidArchive(what) => format!("the zip archive is damaged: {what}"),
        ZipError::UnsupportedArchive(what) => format!("a zip archive of a kind that is not read: {what}"),
        other => other.to_string(),
    }
}

/// The underlying cause of an error, after a colon; empty if it has none.
fn cause(error: &dyn std::error::Error) -> String {
    error.source().map_or(String::new(), |source| format!(": {source}"))
}

fn after_colon(messages: &[String]) -> String {
    if messages.is_empty() { String::new() } else { format!(": {}", messages.join("; ")) }
}

/// Result with the tool's error.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// For `map_err`: wraps an I/O error with what was tried on which file.
    pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }

    /// For `map_err`: what is wrong at a place of a table.
    pub fn table<E: Display>(path: &Path, place: Place) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |error| Self::Table { path, place, message: error.to_string() }
    }

    /// For `map_err`: why a plot cannot be made.
    pub fn plot<E: Display>(path: impl Into<PathBuf>) -> impl FnOnce(E) -> Self {
        let path = path.into();
        move |error| Self::Plot { path, message: error.to_string() }
    }
}
