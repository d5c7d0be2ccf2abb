//! `[discrete]`: discrete-time models of recorded runs, or of runs of an FMU.

use super::kind::{GivenKeys, StudyKind, digested};
use crate::{
    diagnostics::Problems,
    study::{Baselines, NetworkOptions, RunForm, Study, inputs},
};
use metafmu_runtime::{Precision, State};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// `[discrete]`: discrete-time models of recorded runs, or of runs of an FMU, of the structure "discrete".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DiscreteOptions {
    /// Number of past samples of the outputs and of the inputs that the next outputs follow from, in models with feedback, at most.
    #[schemars(range(min = 1, max = MOST))]
    pub history: usize,
    /// Number of past samples of the inputs that the next outputs follow from, in the model without feedback.
    #[schemars(range(min = 1, max = MOST))]
    pub window: usize,
    /// Length of a stretch: number of consecutive predictions that are trained at a time, each from those before.
    #[schemars(range(min = 1, max = MOST))]
    pub stretch: usize,
    /// About how many seconds of two cores the models take together, counted in multiplications: what is learned does not depend on the machine.
    #[schemars(range(min = 1, max = LONGEST))]
    pub budget: usize,
    /// The model that is exported; unless given, the one whose simulations of the held-out runs are best.
    pub model: Option<DiscreteModel>,
}

/// A way to learn the next outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum DiscreteModel {
    /// Linear in past outputs and inputs, by least squares (ARX).
    Linear,
    /// A sum of products of powers of up to four past samples, by least squares; degree and number of samples are chosen.
    Polynomial,
    /// Outputs and hidden states follow from those of the last sample; fitted to whole simulations by the method of Levenberg and Marquardt.
    StateSpace,
    /// A network on a window of past inputs, without feedback: it has nothing that could drift.
    Window,
    /// The linear model and a network on the same past outputs and inputs, trained on stretches of predictions.
    Feedback,
}

impl DiscreteModel {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Linear, Self::Polynomial, Self::StateSpace, Self::Window, Self::Feedback];

    /// Its name in a study.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Polynomial => "polynomial",
            Self::StateSpace => "state-space",
            Self::Window => "window",
            Self::Feedback => "feedback",
        }
    }
}

impl Default for DiscreteOptions {
    fn default() -> Self {
        Self { history: 8, window: 64, stretch: 64, budget: 60, model: None }
    }
}

/// Number of runs of an FMU or a program unless given.
const RUNS: usize = 30;
/// Hidden layers unless given: a network that is evaluated at each sample, and has a linear part beside it.
const HIDDEN: [usize; 2] = [32, 32];
/// Longest gradients unless given: what goes through many predictions has steep slopes.
const CLIP_NORM: f64 = 1.0;

/// Samples of a history, a window or a stretch at most.
const MOST: usize = 10_000;
/// Longest budget in seconds: a week.
const LONGEST: usize = 604_800;

impl DiscreteOptions {
    /// Number of samples before a run that its models can go on from.
    pub fn longest(&self) -> usize {
        self.history.max(self.window)
    }

    /// Every mistake, by key within the section.
    pub(in crate::study) fn problems(&self) -> Problems {
        let Self { history, window, stretch, budget, model: _ } = *self;
        let mut problems = Problems::default();
        for (key, value) in [("history", history), ("window", window), ("stretch", stretch)] {
            problems.expect((1..=MOST).contains(&value), key, value, &format!("a number from 1 to {MOST}"));
        }
        problems.expect((1..=LONGEST).contains(&budget), "budget", budget, &format!("seconds from 1 to {LONGEST}"));
        problems
    }

    /// Seconds of two cores in a share of the budget.
    pub fn seconds(&self, share: f64) -> f64 {
        share * self.budget as f64
    }
}

/// Outputs as functions of past outputs, past inputs and parameters.
pub(super) struct DiscreteStudy;

impl StudyKind for DiscreteStudy {
    fn runs(&self) -> RunForm {
        RunForm { have_memory: true, are_samples: true, usual_number: RUNS, ..RunForm::default() }
    }

    fn section(&self) -> Option<&'static str> {
        Some("discrete")
    }

    fn is_given(&self, study: &Study) -> bool {
        study.discrete != DiscreteOptions::default()
    }

    fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = of_runs(study);
        problems.extend(refused(study));
        problems
    }

    fn set_defaults(&self, study: &mut Study, given: GivenKeys) {
        if !given.hidden {
            study.network.hidden = HIDDEN.to_vec();
        }
        if !given.clip_norm {
            study.training.clip_norm = CLIP_NORM;
        }
    }

    fn digested(&self, study: &Study) -> Option<Value> {
        digested(&study.discrete)
    }
}

/// Problems of the source, its inputs and its outputs.
fn of_runs(study: &Study) -> Problems {
    let mut problems = Problems::default();
    if study.source.count() == 1 && study.source.is_of_equations() {
        let message = "the structure \"discrete\" is learned from recorded runs, a program or an FMU, expected \
                       `table`, `index`, `command` or `fmu`";
        problems.add("source", message);
    }
    problems.expect_absent(!study.states.is_empty(), "states", "belongs to the structure \"dynamics\"");
    if study.inputs.is_empty() {
        problems.add("inputs", "no input, expected at least one: the columns that drive the runs");
    }
    // those of other sources are known with the source only
    if study.source.is_recorded() {
        problems.extend(inputs::range_problems(study));
    }
    let names = || study.outputs.keys().chain(study.inputs.keys());
    for start in names().map(|name| State::start_name(name)) {
        if study.parameters.contains_key(&start) || names().any(|name| *name == start) {
            problems.add("outputs", format!("`{start}` is the name of a variable's value before the start"));
        }
    }
    if study.time.stop < 2.0 * study.time.step {
        problems.add("time.stop", format!("{} s, expected at least two steps", study.time.stop));
    }
    problems
}

/// Sections and keys that are of other structures.
fn refused(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let of_response = "belongs to the structure \"response\"";
    let has_margin = study.time.margin > 0.0 && !study.source.is_recorded();
    problems.expect_absent(has_margin, "time.margin", of_response);
    let instead =
        "belongs to the structure \"response\": for smaller errors record more runs, or raise discrete.budget";
    problems.expect_absent(study.target.is_some(), "target", instead);
    let instead = "belongs to the structure \"response\": the build chooses the kind of model, its order and its functions (discrete.budget)";
    problems.expect_absent(study.search.is_some(), "search", instead);
    problems.expect_absent(study.baselines != Baselines::default(), "baselines", of_response);
    let is_fixed = study.network.structure != NetworkOptions::default().structure;
    problems.expect_absent(is_fixed, "network.structure", of_response);
    problems.expect_absent(study.training.batch_norm, "training.batch_norm", of_response);
    problems.expect_absent(study.training.dropout > 0.0, "training.dropout", of_response);
    if study.network.hidden.is_empty() {
        problems.add("network.hidden", "no hidden layer, expected at least one: the linear part is beside the network");
    }
    let is_single = study.export.precision == Precision::Single;
    problems.expect_absent(is_single, "export.precision", "\"single\" belongs to networks without feedback");
    problems
}
