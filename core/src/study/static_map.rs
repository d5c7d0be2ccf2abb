//! `[static]`: a static map of the rows of a table, which have no time.

use super::{BaselineKind, BoundsOptions, Study, TimeStructure, inputs, outputs, size};
use crate::diagnostics::Problems;
use metafmu_runtime::Precision;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};
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
    pub(super) fn of(has_hidden: bool, has_training: bool) -> Self {
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

/// Sections that a static map has not.
pub(super) fn refused(has: impl Fn(&str) -> bool) -> Problems {
    let mut problems = Problems::default();
    for (section, message) in REFUSED {
        problems.expect_absent(has(section), section, message);
    }
    problems
}

/// Options that have other defaults than those of other structures; `given`: whether the study has hidden layers, a `schedule` and a `batch`.
pub(super) fn set_defaults(study: &mut Study, [hidden, schedule, batch]: [bool; 3]) {
    let usual = super::TrainingOptions::of_rows();
    if !hidden {
        study.network.hidden = HIDDEN.to_vec();
    }
    if !schedule {
        study.training.schedule = usual.schedule;
    }
    if !batch {
        study.training.batch = usual.batch;
    }
}

/// Default number of epochs of a training on `rows` rows.
pub(super) fn epochs(rows: usize, batch: usize) -> usize {
    let steps = rows.div_ceil(batch.max(1)).max(1);
    STEPS.div_ceil(steps).max(FEWEST_EPOCHS)
}

/// Problems that depend on the other sections.
pub(super) fn problems_beside(study: &Study) -> Problems {
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
