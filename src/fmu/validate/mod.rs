//! Every problem of an FMU, not the first: the archive, modelDescription.xml, the binary, how it behaves by each of its
//! interfaces, and whether it computes what the surrogate and the reference result inside say.

mod apart;
mod archive;
mod arrival;
mod behaviour;
mod derivatives;
mod description;
mod domain;
mod prediction;
mod run;

pub use apart::{Task, validate_apart};

pub(super) use apart::serve;

use super::{Archive, Fmu, InterfaceKind, ModelDescription, Platform, host::Unpacked, package::MODEL_FILE};
use crate::Error;
use metafmu_runtime::{
    FormatError, Model, Surrogate,
    regression::{Function, Regression},
};
use serde::{Deserialize, Serialize};
use std::{collections::HashSet, fmt, path::Path};

/// Largest model file that is read.
const MAX_MODEL: u64 = 1 << 30;

/// What validation found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Everything that is wrong.
    pub problems: Vec<Finding>,
    /// What could not be checked, and why.
    pub not_checked: Vec<String>,
}

/// One problem.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Part of the FMU.
    pub area: Area,
    /// Line in modelDescription.xml, counted from 1, if there is one to point at.
    pub line: Option<usize>,
    /// What is wrong.
    pub message: String,
}

/// Part of an FMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Area {
    /// The zip archive and what is in it.
    Archive,
    /// modelDescription.xml.
    Description,
    /// The shared library.
    Binary,
    /// What the FMU does when it is run.
    Behaviour,
    /// The model file of a metafmu surrogate.
    Surrogate,
}

/// What comes up while the binary is run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Note {
    /// This is what is done from here on.
    Doing(String),
    /// This is wrong.
    Problem(Finding),
    /// This could not be checked.
    NotChecked(String),
}

/// Takes notes at once, for an FMU may end the process at any time.
struct Notes<'a>(&'a mut dyn FnMut(Note));

impl Notes<'_> {
    fn doing(&mut self, what: impl Into<String>) {
        self.0(Note::Doing(what.into()));
    }

    fn problem(&mut self, area: Area, message: impl Into<String>) {
        self.0(Note::Problem(Finding { area, line: None, message: message.into() }));
    }

    fn skipped(&mut self, what: impl Into<String>) {
        self.0(Note::NotChecked(what.into()));
    }
}

impl Report {
    fn add(&mut self, note: Note) {
        match note {
            Note::Doing(_) => {}
            Note::Problem(finding) => self.problems.push(finding),
            Note::NotChecked(what) => self.not_checked.push(what),
        }
    }

    fn problem(&mut self, area: Area, message: impl Into<String>) {
        self.problems.push(Finding { area, line: None, message: message.into() });
    }

    fn at_line(&mut self, line: usize, message: impl Into<String>) {
        self.problems.push(Finding { area: Area::Description, line: Some(line), message: message.into() });
    }

    fn skipped(&mut self, what: impl Into<String>) {
        self.not_checked.push(what.into());
    }

    /// What was found by way of both interfaces is said once.
    fn forget_repetitions(&mut self) {
        let mut known = HashSet::new();
        self.problems.retain(|finding| known.insert(finding.to_string()));
        self.not_checked.retain(|what| known.insert(what.clone()));
    }
}

/// A line for each problem, for each thing not checked, and for the number of problems.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for problem in &self.problems {
            writeln!(f, "{problem}")?;
        }
        for what in &self.not_checked {
            writeln!(f, "not checked: {what}")?;
        }
        match self.problems.len() {
            0 => writeln!(f, "no problems found"),
            1 => writeln!(f, "1 problem found"),
            count => writeln!(f, "{count} problems found"),
        }
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}, line {line}: {}", self.area, self.message),
            None => write!(f, "{}: {}", self.area, self.message),
        }
    }
}

impl fmt::Display for Area {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Archive => "archive",
            Self::Description => "modelDescription.xml",
            Self::Binary => "binary",
            Self::Behaviour => "behaviour",
            Self::Surrogate => "surrogate",
        })
    }
}

/// Checks an FMU and reports every problem. Its binary is run in this process: an FMU that crashes takes the program along,
/// unlike with [`validate_apart`].
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or unpacked, [`Error::Archive`] if it is no zip archive: there is nothing to validate.
pub fn validate(path: impl AsRef<Path>) -> crate::Result<Report> {
    let path = path.as_ref();
    examine(path, &mut |unpacked, report| {
        let mut archive = Archive::open(path)?;
        match unpacked.load() {
            Ok(fmu) => run(&fmu, &mut archive, &mut Notes(&mut |note| report.add(note))),
            Err(error) => report.problem(Area::Binary, error.to_string()),
        }
        Ok(())
    })
}

/// Checks what can be checked without the binary, and has it run by each interface.
fn examine(path: &Path, run: &mut dyn FnMut(Unpacked, &mut Report) -> crate::Result<()>) -> crate::Result<Report> {
    let mut report = Report::default();
    let mut archive = Archive::open(path)?;
    archive::check(&mut archive, &mut report);

    let document = match archive.document() {
        Ok(document) => document,
        // the archive check has reported a missing description
        Err(Error::ArchiveEntry { problem, .. }) if archive.contains("modelDescription.xml") => {
            report.problem(Area::Archive, format!("entry `modelDescription.xml`: {problem}"));
            return Ok(nothing_run(report));
        }
        Err(Error::Description { line, problem, .. }) => {
            report.at_line(line, problem);
            return Ok(nothing_run(report));
        }
        Err(_) => return Ok(nothing_run(report)),
    };
    description::check(&document, &mut report);
    let surrogate = match surrogate(&mut archive) {
        Ok(surrogate) => surrogate,
        Err(problem) => {
            report.problem(Area::Surrogate, problem);
            None
        }
    };
    match arrival::read(&mut archive) {
        Ok(Some(_)) => {}
        Ok(None) => report.skipped("a reference result: there is none of metafmu's inside"),
        Err(problem) => report.problem(Area::Archive, problem),
    }
    if document.description.scheduled_execution.is_some() {
        report.skipped("scheduled execution: only co-simulation and model exchange are run");
    }
    for interface in [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange] {
        if let Some(unpacked) = unpack(path, &document.description, interface, &mut report)? {
            run(unpacked, &mut report)?;
        }
    }
    if surrogate.is_none() {
        report.skipped(format!(
            "whether the outputs are right: there is no `{MODEL_FILE}` of a metafmu surrogate to compare with"
        ));
    }
    report.forget_repetitions();
    Ok(report)
}

/// Runs an FMU; what cannot be read of the archive has been reported.
fn run(fmu: &Fmu, archive: &mut Archive, report: &mut Notes) {
    let surrogate = surrogate(archive).ok().flatten();
    behaviour::check(fmu, report);
    if surrogate.as_ref().is_some_and(is_piecewise_constant) {
        report.skipped("derivatives: the model inside jumps, between jumps they are 0");
    } else {
        derivatives::check(fmu, report);
    }
    if let Some(surrogate) = &surrogate {
        prediction::check(fmu, surrogate, report);
        domain::check(fmu, surrogate, report);
    }
    if let Ok(Some(reference)) = arrival::read(archive) {
        arrival::check(fmu, &reference, report);
    }
}

fn nothing_run(mut report: Report) -> Report {
    report.skipped("the binary and what it computes: modelDescription.xml cannot be read");
    report
}

fn is_piecewise_constant(surrogate: &Surrogate) -> bool {
    matches!(surrogate.model(), Model::Regression(Regression { function: Function::Forest(_), .. }))
}

/// The surrogate inside, if there is one, or what is wrong with it; a model file of another program is none of ours.
fn surrogate(archive: &mut Archive) -> Result<Option<Surrogate>, String> {
    if !archive.contains(MODEL_FILE) {
        return Ok(None);
    }
    let bytes = archive.read(MODEL_FILE, MAX_MODEL).map_err(|error| error.to_string())?;
    match Surrogate::from_bytes(&bytes) {
        Ok(surrogate) => Ok(Some(surrogate)),
        Err(FormatError::NoMetadata) => Ok(None),
        Err(error) => Err(format!("`{MODEL_FILE}`: {error}")),
    }
}

/// The FMU for one of its interfaces, if it offers that and can be run here.
fn unpack(
    path: &Path,
    description: &ModelDescription,
    interface: InterfaceKind,
    report: &mut Report,
) -> crate::Result<Option<Unpacked>> {
    let Some(offered) = description.interface(interface) else { return Ok(None) };
    if offered.needs_execution_tool {
        report.skipped(format!("{interface}: the FMU needs another program to run"));
        return Ok(None);
    }
    match Unpacked::open(path, Some(interface)) {
        Ok(unpacked) => return Ok(Some(unpacked)),
        // what of it is wrong has been reported with its line
        Err(Error::Description { .. }) => {
            report.skipped("the binary and what it computes: modelDescription.xml cannot be used");
        }
        Err(Error::NoBinary { found, expected, .. }) if !found.is_empty() => {
            let (found, platform) = (found.join(", "), Platform::CURRENT.tuple);
            report.skipped(format!(
                "the binary and what it computes: there is no `{expected}` for this platform, {platform}, only for {found}"
            ));
        }
        Err(Error::NoBinary { expected, .. }) => {
            report.problem(Area::Binary, format!("there is no binary for any platform, expected `{expected}`"));
        }
        // the machine's fault
        Err(error @ Error::Io { .. }) => return Err(error),
        // the check of the archive may have found it, too
        Err(Error::ArchiveEntry { entry, problem, .. }) => {
            report.problem(Area::Archive, format!("entry `{entry}` {problem}"));
        }
        Err(error) => report.problem(Area::Archive, error.to_string()),
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmu::{
        FmiVersion,
        testing::{
            changed_fmu, entry, fmu_described_as, fmu_of, fmu_of_described_as, fmu_with_arrays, fmu_with_bounds,
            fmu_with_input,
        },
    };
    use std::path::PathBuf;

    fn problems(fmu: PathBuf) -> Vec<String> {
        validate(fmu).unwrap().problems.iter().map(Finding::to_string).collect()
    }

    #[test]
    fn our_own_fmu_has_no_problem_and_nothing_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            assert_eq!(validate(fmu_of(folder.path(), version)).unwrap(), Report::default());
            assert_eq!(validate(fmu_with_input(folder.path(), version)).unwrap(), Report::default());
            assert_eq!(validate(fmu_with_arrays(folder.path(), version)).unwrap(), Report::default());
            assert_eq!(validate(fmu_with_bounds(folder.path(), version)).unwrap(), Report::default());
        }
    }

    #[test]
    fn a_report_is_printed_line_by_line() {
        let mut report = Report::default();
        assert_eq!(report.to_string(), "no problems found\n");
        report.at_line(7, "something is wrong");
        report.skipped("the weather");
        assert_eq!(
            report.to_string(),
            "modelDescription.xml, line 7: something is wrong\nnot checked: the weather\n1 problem found\n"
        );
    }

    #[test]
    fn what_is_no_archive_is_an_error() {
        assert!(matches!(validate("/no/such.fmu"), Err(Error::Io { .. })));
        assert!(matches!(validate(file!()), Err(Error::Archive { .. })));
    }

    #[test]
    fn a_description_that_cannot_be_read_is_the_only_finding() {
        let folder = tempfile::tempdir().unwrap();
        let newer = fmu_described_as(folder.path(), |text| text.replace("fmiVersion=\"2.0\"", "fmiVersion=\"4.0\""));
        let report = validate(newer).unwrap();
        assert_eq!(
            report.problems[0].to_string(),
            "modelDescription.xml, line 2: fmiVersion is \"4.0\": only FMI 2.0 and 3.0 are supported"
        );
        assert_eq!(report.not_checked, ["the binary and what it computes: modelDescription.xml cannot be read"]);
        let none = changed_fmu(folder.path(), |entries| drop(entries.remove(0)));
        assert_eq!(problems(none), ["archive: there is no `modelDescription.xml`"]);
    }

    #[test]
    fn an_fmu_without_a_binary_is_wrong_and_one_for_another_platform_is_not_checked() {
        let folder = tempfile::tempdir().unwrap();
        let expected = Platform::CURRENT.binary(FmiVersion::V2, "example");
        let without = changed_fmu(folder.path(), |entries| entries.retain(|(name, _)| !name.starts_with("binaries/")));
        assert_eq!(problems(without), [format!("binary: there is no binary for any platform, expected `{expected}`")]);
        let other = changed_fmu(folder.path(), |entries| {
            entry(entries, "binaries/").0 = "binaries/amiga/example.so".into();
        });
        let report = validate(other).unwrap();
        assert_eq!(report.problems, []);
        assert!(report.not_checked[0].ends_with("only for amiga"), "{:?}", report.not_checked);
    }

    #[test]
    fn problems_of_behaviour_are_found_by_either_version() {
        let folder = tempfile::tempdir().unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let missing = fmu_of_described_as(folder.path(), version, |text| {
                text.replacen("modelIdentifier=\"example\"", "modelIdentifier=\"other\"", 1)
            });
            let found = validate(missing).unwrap();
            assert!(found.not_checked[0].contains("other."), "{found}");
            let token = fmu_of_described_as(folder.path(), version, |text| text.replacen("=\"{", "=\"{0", 1));
            let found = problems(token);
            assert!(found.iter().any(|problem| problem.contains("returned no instance")), "{found:?}");
        }
    }

    #[test]
    fn a_changed_reference_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let found = problems(changed_fmu(folder.path(), |entries| {
            let text = &mut entry(entries, "extra/org.metafmu/reference_result.csv").1;
            *text = String::from_utf8_lossy(text).replacen("\n0,", "\n0,1", 1).into_bytes();
        }));
        assert_eq!(found.len(), 2, "{found:?}");
        assert!(found[0].starts_with("behaviour: co-simulation, the reference run: \"angle\" is "), "{found:?}");
    }

    #[test]
    fn a_damaged_binary_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let damaged = changed_fmu(folder.path(), |entries| entry(entries, "binaries/").1.truncate(1000));
        assert!(problems(damaged)[0].contains("is cut short: 1000 bytes"));
    }

    #[test]
    fn a_token_that_is_not_that_of_the_model_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let found = problems(fmu_described_as(folder.path(), |text| text.replace("guid=\"{", "guid=\"{0")));
        assert!(
            found.iter().any(|problem| problem.starts_with("surrogate: the token in modelDescription.xml is ")),
            "{found:?}"
        );
        assert!(found.iter().any(|problem| problem.contains("fmi2Instantiate returned no instance")), "{found:?}");
    }

    #[test]
    fn a_changed_weight_is_found() {
        let folder = tempfile::tempdir().unwrap();
        let found = problems(changed_fmu(folder.path(), |entries| {
            let model = &mut entry(entries, MODEL_FILE).1;
            let place = model.len() - 4;
            model[place] ^= 1;
        }));
        assert!(found[0].contains("the file is damaged"), "{found:?}");
        assert!(found.iter().any(|problem| problem.contains("fmi2Instantiate returned no instance")), "{found:?}");
    }

    #[test]
    fn outputs_that_are_not_those_predicted_are_found() {
        let folder = tempfile::tempdir().unwrap();
        let swapped = fmu_described_as(folder.path(), |text| {
            let text = text.replace("valueReference=\"3\"", "valueReference=\"x\"");
            text.replace("valueReference=\"4\"", "valueReference=\"3\"")
                .replace("valueReference=\"x\"", "valueReference=\"4\"")
        });
        let found = problems(swapped);
        // once for each point: the start values and four corners; and the reference run of each interface
        assert_eq!(found.len(), 7, "{found:?}");
        assert!(found[0].starts_with("behaviour: in Initialization Mode, \"angle\" is "), "{found:?}");
    }

    #[test]
    fn a_model_of_another_program_is_not_compared_with() {
        let folder = tempfile::tempdir().unwrap();
        let without = changed_fmu(folder.path(), |entries| entry(entries, MODEL_FILE).0 = "resources/other".into());
        let found = problems(without);
        assert!(found[0].contains("fmi2Instantiate returned no instance"), "{found:?}");
    }
}
