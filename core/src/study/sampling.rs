//! `[sampling]`: where in the parameters' ranges runs are placed.

use super::{MAX_HALTON_PARAMETERS, MAX_SOBOL_PARAMETERS, RunForm, Study, limits::MAX_RUNS};
use crate::{diagnostics::Problems, table::writer::Format};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `[sampling]`: where in the parameters' ranges runs are placed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SamplingOptions {
    /// How the training runs are placed; recorded runs have no method.
    pub method: Option<Method>,
    /// Method "mesh": levels of each parameter, both ends of its range included.
    #[schemars(range(min = 2))]
    pub levels: Option<usize>,
    /// Number of training runs of the methods that have neither levels nor a file. Structure "dynamics": runs that
    /// determine the ranges of the outputs and the steps of the solver, 8 unless given. Structure "discrete" of an FMU
    /// or a program: training runs, 30 unless given.
    #[schemars(range(min = 2, max = MAX_RUNS))]
    pub runs: Option<usize>,
    /// Structure "dynamics": number of states, with inputs and parameters, at which the equations are evaluated. An FMU
    /// or a program is queried at 5000 unless given, a mechanism for the functions that its networks learn at 20000. A
    /// tenth of them is held out.
    #[schemars(range(min = 100, max = MAX_RUNS))]
    pub states: Option<usize>,
    /// Method "list": CSV or Parquet file with a column for each parameter, relative to the study's folder.
    #[schemars(extend("format" = "path"))]
    pub file: Option<PathBuf>,
    /// Share of the training runs that lie on the ends of each parameter's range, half of them on either end, from 0 to 0.5; none
    /// unless given. A mesh has its ends anyway, and a list has its points.
    #[schemars(range(min = 0, max = 0.5))]
    pub faces: Option<f64>,
    /// Number of test runs: random, from the same ranges, never part of training.
    #[serde(default = "default_test_runs")]
    #[schemars(range(min = 1, max = MAX_RUNS))]
    pub test_runs: usize,
    /// Table of the test runs of recorded ones, with the same columns, or the index of their files, relative to the study's folder. All runs of the
    /// source are for the training then, and there are no `test_runs`.
    #[schemars(extend("format" = "path"))]
    pub test: Option<PathBuf>,
    /// Structure "dynamics" of a table: the equations are learned from the rows of all runs up to this time, and all
    /// runs are test runs to their end. For tables of one run or few; there are no `test_runs` then.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub train_stop: Option<f64>,
    /// Format of the tables of runs in the folder of results; unless given CSV up to 5 million numbers in a table,
    /// Parquet above.
    pub tables: Option<Format>,
}

impl Default for SamplingOptions {
    fn default() -> Self {
        Self {
            method: None,
            levels: None,
            runs: None,
            states: None,
            file: None,
            faces: None,
            test_runs: default_test_runs(),
            test: None,
            train_stop: None,
            tables: None,
        }
    }
}

fn default_test_runs() -> usize {
    200
}

/// How the training runs are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Full factorial: every combination of evenly spaced levels.
    Mesh,
    /// Independent and uniform over the ranges.
    Random,
    /// Latin hypercube: each of `runs` slices of each range has one point.
    LatinHypercube,
    /// Low-discrepancy: a randomly shifted Sobol sequence, which leaves no gaps and no clusters; at most 100 parameters.
    Sobol,
    /// Low-discrepancy: a randomly shifted Halton sequence; at most 16 parameters.
    Halton,
    /// The points of a CSV or Parquet file.
    List,
}

impl SamplingOptions {
    /// Every mistake, by dotted key.
    pub(super) fn problems(&self, form: RunForm) -> Problems {
        let Self { method, levels, runs, states, file, faces, test_runs, test, train_stop, tables: _ } = self;
        let mut problems = Problems::default();
        if let Some(stop) = train_stop {
            problems.expect_positive("sampling.train_stop", *stop);
            let message = "with `train_stop` every run is a test run: expected no `test_runs`";
            problems.expect_absent(*test_runs != default_test_runs(), "sampling.test_runs", message);
        }
        let message = "with `test` the test runs are those of that table: expected no `test_runs`";
        problems.expect_absent(test.is_some() && *test_runs != default_test_runs(), "sampling.test_runs", message);
        if let Some(states) = states {
            let expected = format!("a number from 100 to {MAX_RUNS}");
            problems.expect((100..=MAX_RUNS).contains(states), "sampling.states", states, &expected);
        }
        if *test_runs == 0 {
            problems.add("sampling.test_runs", "expected at least 1");
        }
        // others have no method
        let Some(method) = method.as_ref().filter(|_| form.are_planned) else { return problems };
        let (mesh, list) = (*method == Method::Mesh, *method == Method::List);
        problems.expect_absent(!mesh && levels.is_some(), "sampling.levels", "belongs to the method \"mesh\"");
        problems.expect_absent(!list && file.is_some(), "sampling.file", "belongs to the method \"list\"");
        let message = "a mesh has `levels`; `runs` belong to the other methods";
        problems.expect_absent(mesh && runs.is_some(), "sampling.runs", message);
        let message = "a list has a `file`; `runs` belong to the other methods";
        problems.expect_absent(list && runs.is_some(), "sampling.runs", message);
        if list && file.is_none() {
            problems.add("sampling", "the list has no `file`");
        }
        let message = "a mesh has its ends anyway, and a list its points: expected no `faces`";
        problems.expect_absent(faces.is_some() && (mesh || list), "sampling.faces", message);
        if let Some(faces) = faces.filter(|_| !mesh && !list) {
            problems.expect((0.0..=0.5).contains(&faces), "sampling.faces", faces, "a share from 0 to 0.5");
        }
        if !mesh && !list && runs.is_none_or(|runs| runs < 2) {
            problems.add("sampling.runs", "expected at least 2 runs");
        }
        problems
    }

    /// Problems that depend on the other sections.
    pub(super) fn problems_beside(&self, study: &Study) -> Problems {
        let Self { method, levels, runs, states, file, faces, test, train_stop, .. } = self;
        let mut problems = Problems::default();
        let is_asked = study.runs().start_from_states && !study.source.is_recorded();
        let message = "belongs to the structure \"dynamics\" of an FMU, a program or a mechanism";
        problems.expect_absent(states.is_some() && !is_asked, "sampling.states", message);
        let message = "belongs to the structure \"dynamics\" of a table";
        problems.expect_absent(
            train_stop.is_some() && !(study.runs().start_from_states && study.source.is_recorded()),
            "sampling.train_stop",
            message,
        );
        let is_read = study.source.is_recorded() && !study.runs().start_from_states;
        let message = "belongs to recorded runs without states";
        problems.expect_absent(test.is_some() && !is_read, "sampling.test", message);
        let message = "is measured on separate runs: with `sampling.train_stop` every run is learned from";
        problems.expect_absent(train_stop.is_some() && study.bounds.is_some(), "bounds", message);
        if let Some(train_stop) = train_stop.filter(|train_stop| *train_stop >= study.time.stop) {
            let message = format!(
                "{train_stop} s, expected less than `time.stop`, {} s: the rows after it are for tests",
                study.time.stop
            );
            problems.add("sampling.train_stop", message);
        }
        if study.source.is_recorded() {
            let given = [method.is_some(), levels.is_some(), runs.is_some(), file.is_some(), faces.is_some()];
            if given.contains(&true) || study.parameters.values().any(|parameter| parameter.levels.is_some()) {
                problems
                    .add("sampling", "recorded runs are where they are: expected `test_runs`, `test` or `tables` only");
            }
        } else if study.runs().have_memory {
            let message = match study.runs().start_from_states {
                true => "belongs to the structure \"response\": a motion is learned from configurations",
                false => "belongs to the structure \"response\": runs that inputs drive have random parameters",
            };
            problems.expect_absent(method.is_some(), "sampling.method", message);
            problems.expect_absent(levels.is_some(), "sampling.levels", message);
            problems.expect_absent(file.is_some(), "sampling.file", message);
            problems.expect_absent(faces.is_some(), "sampling.faces", message);
            if runs.is_some_and(|runs| runs < 2) {
                problems.add("sampling.runs", "expected at least 2 runs");
            }
        } else if method.is_none() && study.source.count() == 1 {
            problems.add("sampling", "expected a `method`");
        }
        let limit = match method {
            Some(Method::Sobol) => ("sobol", MAX_SOBOL_PARAMETERS),
            Some(Method::Halton) => ("halton", MAX_HALTON_PARAMETERS),
            _ => return problems,
        };
        let (name, limit) = limit;
        if study.parameters.len() > limit {
            problems.add("sampling.method", format!("the method \"{name}\" takes at most {limit} parameters"));
        }
        problems
    }
}
