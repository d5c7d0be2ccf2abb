//! `[target]`: how good the surrogate is to be.

use super::{Method, Study, TimeStructure, limits::MAX_RUNS};
use crate::diagnostics::{Problems, numbers::counted};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[target]`: required accuracy of the surrogate. Runs are added, and the training continues, until it is reached.
/// Without this section, no runs are added to the plan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TargetOptions {
    /// R² that every output is to reach on the runs held out for validation, between 0 and 1.
    #[schemars(extend("exclusiveMinimum" = 0, "exclusiveMaximum" = 1))]
    pub r2: f64,
    /// Runs that are added each time, 1 to 100,000.
    #[schemars(range(min = 1, max = MAX_ADDED_RUNS))]
    pub runs: usize,
    /// Most training runs, those of the plan included.
    #[schemars(range(max = MAX_RUNS))]
    pub max_runs: usize,
    /// `true` if runs are added where the error is large; otherwise the plan continues.
    #[serde(default = "default_adaptive")]
    pub adaptive: bool,
}

fn default_adaptive() -> bool {
    true
}

/// Runs that are added each time: the places of each are chosen among thirty.
const MAX_ADDED_RUNS: usize = 100_000;

/// Minimum number of held-out runs for a `[target]`. Errors differ from run to run: the next run is worse than the
/// worst of `n` with a probability of `1 / (n + 1)`. This is below a tenth from here on, and a quarter for three runs.
const LEAST_JUDGES: usize = 10;

impl TargetOptions {
    /// Every mistake, by dotted key.
    pub(super) fn problems(&self) -> Problems {
        let Self { r2, runs, .. } = *self;
        let mut problems = Problems::default();
        problems.expect(r2 > 0.0 && r2 < 1.0, "target.r2", r2, "a number between 0 and 1");
        if !(1..=MAX_ADDED_RUNS).contains(&runs) {
            problems.add("target.runs", format!("{}, expected 1 to {MAX_ADDED_RUNS}", counted(runs, "run")));
        }
        problems
    }

    /// Problems that depend on the other sections.
    pub(super) fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = Problems::default();
        if study.network.structure == TimeStructure::Fixed {
            problems.add("target", "belongs to the structure \"full\"");
        }
        if study.source.is_recorded() {
            problems.add("target", "recorded runs cannot be added to");
            return problems;
        }
        let (runs, max_runs) = (study.train_runs(), self.max_runs);
        if (max_runs as u64) < runs {
            problems.add(
                "target.max_runs",
                format!("{}, expected at least the {runs} of the plan", counted(max_runs, "run")),
            );
        }
        if let Some(message) = too_few_judges(study, runs) {
            problems.add("target", message);
        }
        problems
    }
}

/// The problem if too few of the plan's runs are held out.
fn too_few_judges(study: &Study, runs: u64) -> Option<String> {
    let share = study.training.validation;
    let held_out = study.training.held_out(runs as usize);
    if held_out >= LEAST_JUDGES || !(share > 0.0 && share < 1.0) {
        return None;
    }
    let more = match study.sampling.method {
        Some(Method::Mesh) => "more `sampling.levels`",
        Some(Method::List) => "more points in `sampling.file`",
        _ => "more `sampling.runs`",
    };
    let least_runs = (LEAST_JUDGES as f64 / share).ceil();
    let least_share = (100.0 * LEAST_JUDGES as f64 / runs as f64).ceil() / 100.0;
    let larger = match least_share <= 0.5 {
        true => format!("`training.validation` of at least {least_share}, or "),
        false => String::new(),
    };
    Some(format!(
        "{held_out} of {runs} runs are held out to judge it, expected at least {LEAST_JUDGES}: set {larger}{more} \
         ({least_runs} runs with `training.validation = {share}`)"
    ))
}
