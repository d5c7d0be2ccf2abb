//! `[source]`: what is sampled.

use super::{Study, time::divides};
use crate::diagnostics::{Problems, numbers::exact};
use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{path::PathBuf, time::Duration};

/// `[source]`: what is sampled, by one of `system`, `mechanism`, `fmu`, `command`, `table` and `index`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SourceOptions {
    /// Name of a built-in system: `single-pendulum`, `double-pendulum` or `slider-crank`.
    pub system: Option<String>,
    /// A mechanism file, relative to the study's folder.
    #[schemars(extend("format" = "path"))]
    pub mechanism: Option<PathBuf>,
    /// An FMU to run, relative to the study's folder.
    #[schemars(extend("format" = "path"))]
    pub fmu: Option<PathBuf>,
    /// A program to run, with its arguments, in the study's folder. It answers requests in lines of JSON; with `{result}` in an argument it is
    /// started for each run and writes a CSV file. docs/command-sources.md has the protocol.
    #[schemars(extend("examples" = [["python", "model.py"]]))]
    pub command: Option<Vec<String>>,
    /// Further files that the program reads, relative to the study's folder. They count by their content, as do arguments of `command` that are
    /// files: runs of other content are not resumed.
    #[serde(default)]
    #[schemars(extend("examples" = [["arm.xml"]]))]
    pub files: Vec<PathBuf>,
    /// A table of recorded runs, CSV or Parquet, relative to the study's folder.
    #[schemars(extend("format" = "path"))]
    pub table: Option<PathBuf>,
    /// An index of recorded runs, one file a run, relative to the study's folder.
    #[schemars(extend("format" = "path"))]
    pub index: Option<PathBuf>,
    /// Names of columns in the tables where they are not the study's.
    #[serde(default)]
    #[schemars(extend("examples" = [{"theta": "Angle"}]))]
    pub columns: IndexMap<String, String>,
    /// Keeps rows of recorded runs of the structure "discrete" with outputs far beyond all others for one or two samples; they are refused otherwise.
    #[serde(default)]
    pub outliers: bool,
    /// Values of the source's quantities that are not parameters; it has a default for each.
    #[serde(default)]
    #[schemars(extend("examples" = [{"m": 0.3}]))]
    pub constants: IndexMap<String, f64>,
    /// Communication step size of the FMU: `time.step`, which it is unless given, divided by a whole number.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub step: Option<f64>,
    /// Tolerance of the integration, from 1e-13 to 0.1. Of a system or mechanism relative and absolute, 1e-13 unless given. Of an
    /// FMU for model exchange relative to each state and to its nominal value; unless given 1e-8, or that of the FMU's default
    /// experiment if it is smaller.
    #[schemars(range(min = 1e-13, max = 0.1))]
    pub tolerance: Option<f64>,
    /// Time after which a run, or the start of an FMU or program, is given up; of an FMU or program 60 s unless given, else none.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub time_limit: Option<f64>,
    /// How often a failed run of an FMU or program is repeated, in a fresh process; 1 unless given.
    pub retries: Option<usize>,
    /// Number of runs of an FMU or program that are simulated twice, after other runs, before most others; 2 unless given. The sampling ends if a
    /// result differs in any bit. 0 for a source that is random on purpose, or whose differences are accepted.
    pub repeats: Option<usize>,
    /// Memory of a worker process of an FMU or program after a run, above which it is replaced by a fresh one. Unless given 1000, or twice the
    /// memory after its first run if that is more.
    #[schemars(extend("x-unit" = "MB", "exclusiveMinimum" = 0))]
    pub memory_limit: Option<f64>,
    /// Share of the runs that may fail, 0.1 unless given; they are left out. If more do, the sampling fails.
    #[schemars(range(min = 0), extend("exclusiveMaximum" = 1))]
    pub max_failed: Option<f64>,
}

/// Communication steps of a run of an FMU.
const MAX_STEPS: f64 = 1e8;

/// Who has options of a simulation.
const SIMULATED: &str = "belongs to `system`, `mechanism`, `fmu` and `command`";

/// Placeholder in `source.command` for the file that a program writes if it is started for each run.
pub const RESULT: &str = "{result}";

impl SourceOptions {
    /// How long a run may take, if that is limited.
    pub fn time_limit(&self) -> Option<Duration> {
        self.time_limit.map(|limit| Duration::from_secs_f64(limit.min(1e9)))
    }

    /// Returns true if runs are read from tables instead of being simulated.
    pub fn is_recorded(&self) -> bool {
        self.table.is_some() || self.index.is_some()
    }

    /// Returns true if the source has known equations: a built-in system or a mechanism.
    pub fn is_of_equations(&self) -> bool {
        self.system.is_some() || self.mechanism.is_some()
    }

    /// Returns true if runs are made by worker processes: of an FMU or a program.
    pub fn is_run_apart(&self) -> bool {
        self.fmu.is_some() || self.command.is_some()
    }

    /// Returns true if the command is started for each run, and writes a file.
    pub fn runs_once(&self) -> bool {
        self.command.iter().flatten().any(|argument| argument.contains(RESULT))
    }

    /// The key that names the source.
    pub(super) fn key(&self) -> &'static str {
        match self.file() {
            Some(("mechanism", _)) => "source.mechanism",
            Some(("fmu", _)) => "source.fmu",
            Some(("table", _)) => "source.table",
            Some(_) => "source.index",
            None if self.command.is_some() => "source.command",
            None => "source",
        }
    }

    /// The key that names the source, and the file that it names, if it is one.
    pub(super) fn file(&self) -> Option<(&'static str, &PathBuf)> {
        let Self { mechanism, fmu, table, index, .. } = self;
        let files = [("mechanism", mechanism), ("fmu", fmu), ("table", table), ("index", index)];
        files.into_iter().find_map(|(key, file)| Some((key, file.as_ref()?)))
    }

    /// How many sources are given; it should be one.
    pub(super) fn count(&self) -> usize {
        let Self { system, mechanism, fmu, command, table, index, .. } = self;
        let files = [mechanism, fmu, table, index].into_iter().flatten().count();
        files + usize::from(system.is_some()) + usize::from(command.is_some())
    }

    /// Every mistake, by dotted key.
    pub(super) fn problems(&self) -> Problems {
        let Self {
            fmu,
            command,
            columns,
            outliers,
            constants,
            step,
            tolerance,
            time_limit,
            retries,
            repeats,
            memory_limit,
            max_failed,
            ..
        } = self;
        let mut problems = Problems::default();
        let is_recorded = self.is_recorded();
        if self.count() != 1 {
            problems.add("source", "expected one of `system`, `mechanism`, `fmu`, `command`, `table` and `index`");
        } else {
            let tables = "belongs to `table` and `index`";
            problems.expect_absent(!is_recorded && !columns.is_empty(), "source.columns", tables);
            problems.expect_absent(!is_recorded && *outliers, "source.outliers", tables);
            problems.expect_absent(is_recorded && !constants.is_empty(), "source.constants", SIMULATED);
        }
        problems.expect_absent(step.is_some() && fmu.is_none(), "source.step", "belongs to `fmu`");
        if retries.is_some() && !self.is_run_apart() {
            let reason = if is_recorded { "" } else { ": a simulation that failed would fail again" };
            problems.add("source.retries", format!("belongs to `fmu` and `command`{reason}"));
        }
        for (key, is_given) in [("repeats", repeats.is_some()), ("memory_limit", memory_limit.is_some())] {
            problems.expect_absent(
                is_given && !self.is_run_apart(),
                format!("source.{key}"),
                "belongs to `fmu` and `command`",
            );
        }
        problems.expect_absent(!self.files.is_empty() && command.is_none(), "source.files", "belongs to `command`");
        let integrates = "belongs to sources that metafmu integrates: a program has its own solver";
        problems.expect_absent(tolerance.is_some() && command.is_some(), "source.tolerance", integrates);
        if command.as_ref().is_some_and(|command| command.first().is_none_or(|program| program.trim().is_empty())) {
            problems.add("source.command", "no program, expected a program and its arguments");
        }
        let given = [("tolerance", tolerance), ("time_limit", time_limit), ("max_failed", max_failed)];
        for (key, value) in given {
            problems.expect_absent(is_recorded && value.is_some(), format!("source.{key}"), SIMULATED);
        }
        if let Some(tolerance) = tolerance {
            let expected = "a number from 1e-13 to 0.1";
            problems.expect((1e-13..=0.1).contains(tolerance), "source.tolerance", tolerance, expected);
        }
        if let Some(limit) = time_limit {
            problems.expect_positive("source.time_limit", *limit);
        }
        if let Some(limit) = memory_limit {
            problems.expect_positive("source.memory_limit", *limit);
        }
        if let Some(share) = max_failed {
            let expected = "a share of at least 0 and below 1";
            problems.expect((0.0..1.0).contains(share), "source.max_failed", share, expected);
        }
        if let Some(step) = step {
            problems.expect_positive("source.step", *step);
        }
        problems
    }

    /// Problems that depend on the other sections.
    pub(super) fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = Problems::default();
        let Some(step) = self.step.filter(|step| step.is_finite() && *step > 0.0) else { return problems };
        let steps = study.time.stop / step;
        if study.time.step > 0.0 && !divides(step, study.time.step) {
            let message =
                format!("{} s does not divide the time between two rows, {} s", exact(step), exact(study.time.step));
            problems.add("source.step", message);
        } else if steps > MAX_STEPS {
            problems.add("source.step", format!("{} steps a run, expected at most 100 million", exact(steps)));
        }
        problems
    }
}
