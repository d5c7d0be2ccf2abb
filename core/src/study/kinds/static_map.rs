//! `[static]`: a static map of the rows of a table, which have no time.

use super::kind::{GivenKeys, StudyKind, digested};
use crate::{
    diagnostics::Problems,
    study::{BaselineKind, BoundsOptions, RunForm, Study, TimeStructure, TrainingOptions, inputs, outputs, size},
};
use metafmu_runtime::Precision;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::{borrow::Cow, fmt};

/// `[static]`: the model of the structure "static".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct StaticOptions {
    /// Kind of model that is exported; unless given, the best of a polynomial, a Gaussian process (of up to 1000 rows) and a network on rows
    /// that they were not fitted to. The others have their default options. A small network of few rows is trained by Levenberg-Marquardt steps with Bayesian
    /// regularization, unless there is a section `[training]`.
    pub model: Option<ModelKind>,
    /// `true` adds the predicted standard deviation of each output `NAME` as an output `NAME_std` of the same unit, noise included. The model is then a Gaussian
    /// process, of up to 1000 rows.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub std: bool,
}

/// Name of the network among other kinds of model.
pub const NETWORK: &str = "network";

/// Kind of model that is fitted to rows and can be exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "&'static str")]
pub enum ModelKind {
    /// A network with the options of the study or of the fit.
    Network,
    /// A baseline with its default options, in double precision.
    Baseline(BaselineKind),
}

impl ModelKind {
    /// Its name: `network`, or that of the baseline.
    pub fn name(self) -> &'static str {
        match self {
            Self::Network => NETWORK,
            Self::Baseline(kind) => kind.name(),
        }
    }

    /// Returns true if the kind has a predicted standard deviation.
    pub fn has_std(self) -> bool {
        self == Self::Baseline(BaselineKind::GaussianProcess)
    }

    /// Message on a given kind without a predicted standard deviation.
    pub fn std_problem(self) -> Option<String> {
        let names = || Self::all().filter(|kind| kind.has_std()).map(Self::name).collect::<Vec<_>>().join(", ");
        (!self.has_std()).then(|| format!("{} has no predicted standard deviation, expected {}", self.name(), names()))
    }

    /// All kinds: the prediction of nearest neighbors is no formula and cannot be exported.
    pub fn all() -> impl Iterator<Item = Self> {
        let baselines = BaselineKind::ALL.into_iter().filter(|kind| *kind != BaselineKind::Knn);
        [Self::Network].into_iter().chain(baselines.map(Self::Baseline))
    }
}

/// Name that is not that of a kind of model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownModelKind(pub String);

impl fmt::Display for UnknownModelKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = ModelKind::all().map(ModelKind::name).collect();
        write!(f, "`{}`, expected one of {}", self.0, names.join(", "))
    }
}

impl std::error::Error for UnknownModelKind {}

impl TryFrom<String> for ModelKind {
    type Error = UnknownModelKind;

    fn try_from(name: String) -> Result<Self, UnknownModelKind> {
        Self::all().find(|kind| kind.name() == name).ok_or(UnknownModelKind(name))
    }
}

impl From<ModelKind> for &'static str {
    fn from(kind: ModelKind) -> Self {
        kind.name()
    }
}

impl JsonSchema for ModelKind {
    fn schema_name() -> Cow<'static, str> {
        "ModelKind".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": "string", "enum": Self::all().map(Self::name).collect::<Vec<_>>() })
    }
}

/// Which networks of few rows are trained by Levenberg-Marquardt steps with Bayesian regularization.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SmallNetworks {
    /// None: the options of the training are given.
    #[default]
    Never,
    /// Those with the given hidden layers, if they are small.
    OfGivenSize,
    /// Those with hidden layers that are chosen by their evidence.
    OfChosenSize,
}

impl SmallNetworks {
    /// Choice for a study: `has_hidden` if it has hidden layers, `has_training` if it has options of the training.
    pub(in crate::study) fn of(has_hidden: bool, has_training: bool) -> Self {
        match (has_training, has_hidden) {
            (true, _) => Self::Never,
            (false, true) => Self::OfGivenSize,
            (false, false) => Self::OfChosenSize,
        }
    }
}

/// Hidden layers unless given, of rows that are too many for Levenberg-Marquardt steps.
const HIDDEN: [usize; 2] = [64, 64];

/// Optimizer steps of a training whose epochs are not given, and fewest epochs of it.
const STEPS: usize = 2000;
const FEWEST_EPOCHS: usize = 150;

/// Sections of studies whose runs have a time, and why a static map has none of them.
const REFUSED: [(&str, &str); 10] = [
    ("time", "belongs to runs: the rows of a static map have no time"),
    (
        "parameters",
        "belongs to runs, which have one value of each: the columns of a static map are `inputs` and `outputs`",
    ),
    ("states", "belongs to the structure \"dynamics\""),
    ("dynamics", "belongs to the structure \"dynamics\""),
    ("discrete", "belongs to the structure \"discrete\""),
    ("compliant", "belongs to the structure \"compliant\""),
    (
        "sampling",
        "belongs to runs: the rows of the table are the samples, and each judges a model that was fitted without it",
    ),
    ("target", "belongs to sources that are simulated: no rows can be added to a table"),
    ("baselines", "belongs to runs: `static.model` names the kind of model"),
    ("search", "belongs to runs: the kind of model is chosen by `metafmu train`"),
];

/// Options of a static map in the digest of a study: epochs that are not given follow from the number of rows.
#[derive(Serialize)]
struct DigestedMap {
    options: StaticOptions,
    has_epochs: bool,
    small_networks: SmallNetworks,
}

/// Outputs as functions of inputs.
pub(super) struct StaticStudy;

impl StudyKind for StaticStudy {
    fn runs(&self) -> RunForm {
        RunForm { are_rows: true, ..RunForm::default() }
    }

    fn section(&self) -> Option<&'static str> {
        Some("static")
    }

    fn is_given(&self, study: &Study) -> bool {
        study.static_map != StaticOptions::default()
    }

    fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = of_rows(study);
        problems.extend(of_model(study));
        problems
    }

    fn refused(&self, has: &dyn Fn(&str) -> bool) -> Problems {
        let mut problems = Problems::default();
        for (section, message) in REFUSED {
            problems.expect_absent(has(section), section, message);
        }
        problems
    }

    fn set_defaults(&self, study: &mut Study, given: GivenKeys) {
        let usual = TrainingOptions::of_rows();
        if !given.hidden {
            study.network.hidden = HIDDEN.to_vec();
        }
        if !given.schedule {
            study.training.schedule = usual.schedule;
        }
        if !given.batch {
            study.training.batch = usual.batch;
        }
    }

    fn digested(&self, study: &Study) -> Option<Value> {
        let Study { static_map: options, has_epochs, small_networks, .. } = *study;
        digested(&DigestedMap { options, has_epochs, small_networks })
    }
}

/// Default number of epochs of a training on `rows` rows.
pub(in crate::study) fn epochs(rows: usize, batch: usize) -> usize {
    let steps = rows.div_ceil(batch.max(1)).max(1);
    STEPS.div_ceil(steps).max(FEWEST_EPOCHS)
}

/// Problems of the table and its columns.
fn of_rows(study: &Study) -> Problems {
    let mut problems = Problems::default();
    if study.source.count() == 1 && study.source.table.is_none() {
        problems.add("source", "the structure \"static\" is learned from one table of rows, expected `table`");
    }
    if study.inputs.is_empty() {
        problems.add("inputs", "no input, expected at least one: the columns that the outputs follow from");
    }
    problems.extend(inputs::problems_beside(study));
    problems.extend(inputs::range_problems(study));
    problems.extend(outputs::problems_beside(study));
    problems.extend(size::problems(study));
    problems
}

/// Problems of the model, its training and its FMU.
fn of_model(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let columns = [study.inputs.len(), study.outputs.len()];
    problems.extend(study.network.problems_between(columns, 1.0, &study.training));
    problems.add_section("training", study.training.problems_beside(study.outputs.len()));
    problems.add_section("export", study.export.problems_beside(study));
    let is_fixed = study.network.structure == TimeStructure::Fixed;
    problems.expect_absent(is_fixed, "network.structure", "\"fixed\" belongs to the structure \"response\"");
    let has_runs = study.bounds.is_some_and(|bounds| bounds.runs != BoundsOptions::default().runs);
    let message = "belongs to runs: bounds of a static map are measured on the unseen rows";
    problems.expect_absent(has_runs, "bounds.runs", message);
    let is_single = study.export.precision == Precision::Single;
    let message = "\"single\" belongs to networks of runs: a static map is computed in double precision";
    problems.expect_absent(is_single, "export.precision", message);
    let without_std = study.static_map.model.filter(|_| study.static_map.std).and_then(ModelKind::std_problem);
    without_std.into_iter().for_each(|problem| problems.add("static.std", problem));
    problems
}
