//! Every problem of an FMU, not only the first. The archive, modelDescription.xml, the binary, and its behavior by each
//! interface are checked, and the [`Checks`] of the FMU's maker are made.

mod archive;
mod behavior;
mod binaries;
mod derivatives;
mod description;
pub mod run;

use super::{
    Archive, Fmu, InterfaceKind, ModelDescription, Platform, host::Unpacked, model_description::InterfaceCapabilities,
};
use crate::{Error, diagnostics::names::listed, unpacking::Patience};
use serde::{Deserialize, Serialize};
use std::{collections::HashSet, fmt, path::Path};

/// Result of a validation.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Everything that is wrong.
    pub problems: Vec<Finding>,
    /// Checks that could not be made, with the reason.
    pub not_checked: Vec<String>,
    /// `true` if the FMU was run by each of its interfaces for co-simulation and model exchange.
    pub was_run: bool,
}

/// One problem.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Finding {
    /// Part of the FMU.
    pub area: Area,
    /// Line in modelDescription.xml, counted from 1, if there is one to point at.
    pub line: Option<usize>,
    /// Description of the problem.
    pub message: String,
}

/// Part of an FMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Area {
    /// The zip archive and its content.
    Archive,
    /// modelDescription.xml.
    Description,
    /// The shared library.
    Binary,
    /// Behavior of the FMU in a run.
    Behavior,
    /// The model file of a metafmu surrogate.
    Surrogate,
}

/// Note on a run of the binary.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Note {
    /// Activity from here on.
    Doing(String),
    /// This is wrong.
    Problem(Finding),
    /// This could not be checked.
    NotChecked(String),
}

/// Takes notes at once, for an FMU may end the process at any time.
pub struct Notes<'a>(pub &'a mut dyn FnMut(Note));

impl fmt::Debug for Notes<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str("Notes")
    }
}

/// Checks that those who made an FMU add to the standard's.
pub trait Checks: Sync {
    /// Before anything is run.
    fn archive(&self, _archive: &mut Archive, _report: &mut Report) {}

    /// Reason why derivatives cannot be compared with differences, if there is one.
    fn no_derivatives(&self, _archive: &mut Archive) -> Option<&'static str> {
        None
    }

    /// Variables by which derivatives cannot be compared with differences, and why.
    fn no_derivatives_by(&self, _archive: &mut Archive) -> Vec<(String, String)> {
        Vec::new()
    }

    /// Checks with the binary loaded, after those of the standard.
    fn run(&self, _fmu: &Fmu, _archive: &mut Archive, _notes: &mut Notes) {}

    /// After everything was run.
    fn end(&self, _archive: &mut Archive, _report: &mut Report) {}
}

/// No further checks.
#[derive(Clone, Copy, Debug, Default)]
pub struct StandardOnly;

impl Checks for StandardOnly {}

impl Notes<'_> {
    /// Sets the activity from here on.
    pub fn doing(&mut self, what: impl Into<String>) {
        self.0(Note::Doing(what.into()));
    }

    /// This is wrong.
    pub fn problem(&mut self, area: Area, message: impl Into<String>) {
        self.0(Note::Problem(Finding { area, line: None, message: message.into() }));
    }

    /// This could not be checked.
    pub fn skipped(&mut self, what: impl Into<String>) {
        self.0(Note::NotChecked(what.into()));
    }
}

impl Report {
    /// Adds a finding, or what was not checked.
    pub fn add(&mut self, note: Note) {
        match note {
            Note::Doing(_) => {}
            Note::Problem(finding) => self.problems.push(finding),
            Note::NotChecked(what) => self.not_checked.push(what),
        }
    }

    /// Adds a problem.
    pub fn problem(&mut self, area: Area, message: impl Into<String>) {
        self.problems.push(Finding { area, line: None, message: message.into() });
    }

    fn at_line(&mut self, line: usize, message: impl Into<String>) {
        self.problems.push(Finding { area: Area::Description, line: Some(line), message: message.into() });
    }

    /// Adds what could not be checked.
    pub fn skipped(&mut self, what: impl Into<String>) {
        self.not_checked.push(what.into());
    }

    /// Removes findings that both interfaces repeat.
    fn forget_repetitions(&mut self) {
        let mut known = HashSet::new();
        self.problems.retain(|finding| known.insert(finding.to_string()));
        self.not_checked.retain(|what| known.insert(what.clone()));
    }
}

/// A line for each problem, for each thing not checked, and for the result.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        for problem in &self.problems {
            writeln!(f, "{problem}")?;
        }
        for what in &self.not_checked {
            writeln!(f, "not checked: {what}")?;
        }
        match self.problems.len() {
            0 if self.was_run => writeln!(f, "no problems found"),
            0 => writeln!(f, "no problems found, but the FMU was not run"),
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
            Self::Behavior => "behavior",
            Self::Surrogate => "surrogate",
        })
    }
}

/// Checks an FMU and reports every problem. Its binary is run in this process: an FMU that crashes takes the program along,
/// unlike with `validate_apart` of the crate `metafmu`.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read or unpacked, [`Error::Archive`] if it is not a zip archive: there is nothing to validate.
pub fn validate(path: impl AsRef<Path>, checks: &dyn Checks) -> crate::Result<Report> {
    let path = path.as_ref();
    examine(path, checks, Patience::default(), &mut |unpacked, report| {
        let mut archive = Archive::open(path)?;
        match unpacked.load() {
            Ok(fmu) => check_binary(&fmu, &mut archive, checks, &mut Notes(&mut |note| report.add(note))),
            Err(error) => report.problem(Area::Binary, error.to_string()),
        }
        Ok(())
    })
}

/// Makes the checks that need no binary, and runs the binary by each interface.
///
/// # Errors
/// Those of [`validate`], and of `run`.
pub fn examine(
    path: &Path,
    checks: &dyn Checks,
    patience: Patience,
    run: &mut dyn FnMut(Unpacked, &mut Report) -> crate::Result<()>,
) -> crate::Result<Report> {
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
    binaries::check(&mut archive, &document.description, &mut report);
    checks.archive(&mut archive, &mut report);
    if document.description.scheduled_execution.is_some() {
        report.skipped("scheduled execution: only co-simulation and model exchange are run");
    }
    let interfaces = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
    let offered = interfaces.into_iter().filter(|kind| document.description.interface(*kind).is_some());
    let (mut offered_count, mut run_count) = (0, 0);
    for interface in offered {
        offered_count += 1;
        if let Some(unpacked) = unpack(&archive, &document.description, interface, patience, &mut report)? {
            run_count += 1;
            run(unpacked, &mut report)?;
        }
    }
    report.was_run = run_count > 0 && run_count == offered_count;
    checks.end(&mut archive, &mut report);
    report.forget_repetitions();
    Ok(report)
}

/// Runs an FMU; what cannot be read of the archive has been reported.
pub fn check_binary(fmu: &Fmu, archive: &mut Archive, checks: &dyn Checks, notes: &mut Notes) {
    behavior::check(fmu, notes);
    match checks.no_derivatives(archive) {
        Some(reason) => notes.skipped(format!("derivatives: {reason}")),
        None => derivatives::check(fmu, &checks.no_derivatives_by(archive), notes),
    }
    checks.run(fmu, archive, notes);
}

fn nothing_run(mut report: Report) -> Report {
    report.skipped("the binary and what it computes: modelDescription.xml cannot be read");
    report
}

/// The FMU for one of its interfaces, if it offers that and can be run here.
fn unpack(
    archive: &Archive,
    description: &ModelDescription,
    interface: InterfaceKind,
    patience: Patience,
    report: &mut Report,
) -> crate::Result<Option<Unpacked>> {
    let Some(offered) = description.interface(interface) else { return Ok(None) };
    if offered.needs_execution_tool {
        report.skipped(format!("{interface}: the FMU needs another program to run"));
        return Ok(None);
    }
    match Unpacked::open(archive.path(), Some(interface), patience) {
        Ok(unpacked) => return Ok(Some(unpacked)),
        // its mistakes have been reported with their lines
        Err(Error::Description { .. }) => {
            report.skipped("the binary and what it computes: modelDescription.xml cannot be used");
        }
        Err(Error::NoBinary { found, expected, .. }) if !found.is_empty() => {
            report.skipped(format!(
                "{interface}: this platform, {}, needs `{expected}`, the FMU has {}",
                Platform::CURRENT.tuple,
                listed(&found.iter().map(String::as_str).collect::<Vec<_>>())
            ));
        }
        Err(Error::NoBinary { .. }) if has_sources(archive, offered) => {
            report.skipped(format!("{interface}: the FMU has source code only: compile it and validate the result"));
        }
        Err(Error::NoBinary { expected, .. }) => {
            report.problem(Area::Binary, format!("there is no binary for any platform, expected `{expected}`"));
        }
        // the machine's fault
        Err(error @ (Error::Io { .. } | Error::Interrupted)) => return Err(error),
        // the check of the archive may have found it, too
        Err(Error::ArchiveEntry { entry, problem, .. }) => {
            report.problem(Area::Archive, format!("entry `{entry}` {problem}"));
        }
        Err(Error::ArchiveLimit { problem, .. }) => report.problem(Area::Archive, problem),
        Err(error) => report.problem(Area::Archive, error.to_string()),
    }
    Ok(None)
}

/// Returns true if an interface comes as source code.
fn has_sources(archive: &Archive, interface: &InterfaceCapabilities) -> bool {
    !interface.source_files.is_empty() || archive.contains("sources/buildDescription.xml")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_is_printed_line_by_line() {
        let mut report = Report::default();
        assert_eq!(report.to_string(), "no problems found, but the FMU was not run\n");
        report.was_run = true;
        assert_eq!(report.to_string(), "no problems found\n");
        report.at_line(7, "something is wrong");
        report.skipped("the weather");
        assert_eq!(
            report.to_string(),
            "modelDescription.xml, line 7: something is wrong\nnot checked: the weather\n1 problem found\n"
        );
    }
}
