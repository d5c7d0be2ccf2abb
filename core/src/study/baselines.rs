//! `[baselines]`: simpler models, and how each is fitted.

use crate::diagnostics::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{fmt, str::FromStr};

/// Trees of a model: all of them are in memory.
const MAX_TREES: usize = 10_000;
/// Rows of a Gaussian process, the squares of whose number are in memory, and steps of the search for its kernel.
const MAX_PROCESS: usize = 20_000;
/// Terms of a polynomial: with more the normal equations take longer than anyone waits.
pub const MAX_TERMS: usize = 5000;

/// `[baselines]`: which models are compared with the network, and how each is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Baselines {
    /// Models that `metafmu compare` fits.
    pub models: Vec<BaselineKind>,
    /// Models among them that `metafmu build` fits.
    pub build: Vec<BaselineKind>,
    /// Time limit of each model for the fit and the prediction of the test rows.
    #[serde(rename = "time_budget")]
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub time_budget: f64,
    /// Least squares, weights of the inputs and a constant: nothing is to be chosen, so that it has no keys.
    pub linear: Linear,
    /// Least squares with a penalty on the squares of the weights.
    pub ridge: Ridge,
    /// Least squares with a penalty on the sizes of the weights.
    pub lasso: Lasso,
    /// Least squares with both.
    pub elastic_net: ElasticNet,
    /// Least squares in products of powers.
    pub polynomial: Polynomial,
    /// Support vector regression.
    pub svr: Svr,
    /// Mean of the nearest training rows.
    pub knn: Knn,
    /// One tree.
    pub decision_tree: DecisionTree,
    /// Trees of different rows.
    pub random_forest: RandomForest,
    /// Trees with random splits.
    pub extra_trees: ExtraTrees,
    /// Trees that each correct those before.
    pub gradient_boosting: GradientBoosting,
    /// Kriging.
    pub gaussian_process: GaussianProcess,
}

impl Default for Baselines {
    fn default() -> Self {
        Self {
            models: BaselineKind::ALL.into(),
            build: vec![
                BaselineKind::Linear,
                BaselineKind::Ridge,
                BaselineKind::Polynomial,
                BaselineKind::DecisionTree,
            ],
            time_budget: 60.0,
            linear: Linear::default(),
            ridge: Ridge::default(),
            lasso: Lasso::default(),
            elastic_net: ElasticNet::default(),
            polynomial: Polynomial::default(),
            svr: Svr::default(),
            knn: Knn::default(),
            decision_tree: DecisionTree::default(),
            random_forest: RandomForest::default(),
            extra_trees: ExtraTrees::default(),
            gradient_boosting: GradientBoosting::default(),
            gaussian_process: GaussianProcess::default(),
        }
    }
}

/// The baselines there are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
#[allow(missing_docs)]
pub enum BaselineKind {
    Linear,
    Ridge,
    Lasso,
    ElasticNet,
    Polynomial,
    Svr,
    Knn,
    DecisionTree,
    RandomForest,
    ExtraTrees,
    GradientBoosting,
    GaussianProcess,
}

impl BaselineKind {
    /// All, from the simplest on.
    pub const ALL: [Self; 12] = [
        Self::Linear,
        Self::Ridge,
        Self::Lasso,
        Self::ElasticNet,
        Self::Polynomial,
        Self::Svr,
        Self::Knn,
        Self::DecisionTree,
        Self::RandomForest,
        Self::ExtraTrees,
        Self::GradientBoosting,
        Self::GaussianProcess,
    ];

    /// Its name in the study, in tables and in file names.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Ridge => "ridge",
            Self::Lasso => "lasso",
            Self::ElasticNet => "elastic-net",
            Self::Polynomial => "polynomial",
            Self::Svr => "svr",
            Self::Knn => "knn",
            Self::DecisionTree => "decision-tree",
            Self::RandomForest => "random-forest",
            Self::ExtraTrees => "extra-trees",
            Self::GradientBoosting => "gradient-boosting",
            Self::GaussianProcess => "gaussian-process",
        }
    }
}

/// Name that is not that of a baseline.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownBaseline(pub String);

impl fmt::Display for UnknownBaseline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = BaselineKind::ALL.map(|kind| format!("`{}`", kind.name()));
        write!(f, "no model `{}`, expected one of {}", self.0, names.join(", "))
    }
}

impl std::error::Error for UnknownBaseline {}

impl FromStr for BaselineKind {
    type Err = UnknownBaseline;

    fn from_str(name: &str) -> Result<Self, UnknownBaseline> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| UnknownBaseline(name.to_owned()))
    }
}

impl Baselines {
    /// Problems with this number of inputs.
    pub(super) fn problems_beside(&self, inputs: usize) -> Problems {
        let mut problems = Problems::default();
        if let Some(message) = self.polynomial.degree_problem(inputs) {
            problems.add("polynomial.degree", message);
        }
        problems
    }

    /// Every mistake, by key within the section.
    pub(super) fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        problems.expect_positive("time_budget", self.time_budget);
        for (key, kinds) in [("models", &self.models), ("build", &self.build)] {
            let duplicated = kinds.iter().enumerate().find(|(index, kind)| kinds[..*index].contains(kind));
            if let Some((_, kind)) = duplicated {
                problems.add(key, format!("`{}` is duplicated", kind.name()));
            }
        }
        for kind in BaselineKind::ALL {
            problems.add_section(kind.name(), self.problems_of(kind));
        }
        problems
    }

    fn problems_of(&self, kind: BaselineKind) -> Problems {
        match kind {
            BaselineKind::Linear => Problems::default(),
            BaselineKind::Ridge => self.ridge.problems(),
            BaselineKind::Lasso => self.lasso.problems(),
            BaselineKind::ElasticNet => self.elastic_net.problems(),
            BaselineKind::Polynomial => self.polynomial.problems(),
            BaselineKind::Svr => self.svr.problems(),
            BaselineKind::Knn => self.knn.problems(),
            BaselineKind::DecisionTree => self.decision_tree.problems(),
            BaselineKind::RandomForest => self.random_forest.problems(),
            BaselineKind::ExtraTrees => self.extra_trees.problems(),
            BaselineKind::GradientBoosting => self.gradient_boosting.problems(),
            BaselineKind::GaussianProcess => self.gaussian_process.problems(),
        }
    }
}

/// `[baselines.linear]`: no options.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Linear {}

/// `[baselines.ridge]`: the smallest `1/(2 rows) |y - b - X w|^2 + alpha/2 |w|^2` over standardized columns.
///
/// linfa's elastic net never finds its end without a penalty on sizes, so this is its least squares with one more row
/// `sqrt(rows alpha) e_i` for each weight.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ridge {
    /// Strength of the penalty.
    #[schemars(range(min = 0))]
    pub alpha: f64,
}

impl Default for Ridge {
    fn default() -> Self {
        Self { alpha: 1e-3 }
    }
}

impl Ridge {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_not_negative(&mut problems, "alpha", self.alpha);
        problems
    }
}

/// `[baselines.lasso]`: the elastic net with `l1_ratio = 1`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Lasso {
    /// Strength of the penalty.
    #[schemars(range(min = 0))]
    pub alpha: f64,
}

impl Default for Lasso {
    fn default() -> Self {
        Self { alpha: 1e-3 }
    }
}

impl Lasso {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_not_negative(&mut problems, "alpha", self.alpha);
        problems
    }
}

/// `[baselines.elastic-net]`: the smallest
/// `1/(2 rows) |y - b - X w|^2 + alpha (l1_ratio |w|_1 + (1 - l1_ratio)/2 |w|_2^2)` over standardized columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ElasticNet {
    /// Strength of the penalties.
    #[schemars(range(min = 0))]
    pub alpha: f64,
    /// Share of the penalty on the sizes, above 0: 1 is lasso.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub l1_ratio: f64,
}

impl Default for ElasticNet {
    fn default() -> Self {
        Self { alpha: 1e-3, l1_ratio: 0.5 }
    }
}

impl ElasticNet {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_not_negative(&mut problems, "alpha", self.alpha);
        // without any penalty on sizes linfa's search does not end
        let is_share = self.l1_ratio > 0.0 && self.l1_ratio <= 1.0;
        problems.expect(is_share, "l1_ratio", self.l1_ratio, "a share above 0, at most 1");
        problems
    }
}

/// `[baselines.polynomial]`: the products of powers of inputs up to a total degree, with weights `w` that make
/// `1/(2 rows) |y - X w|^2 + alpha/2 |w|^2` smallest.
///
/// linfa wants the whole matrix `X` in memory, 25 GB for 462 terms of 7 million rows: the normal equations
/// `(X^T X / rows + alpha I) w = X^T y / rows` are summed up block by block instead. They are well conditioned as the
/// powers are Legendre polynomials over the range of each input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Polynomial {
    /// Highest sum of the powers in a term; unless given the highest of 1 to 6 that makes no more than 1000 terms.
    #[schemars(range(min = 1, max = 20))]
    pub degree: Option<u8>,
    /// Strength of the penalty.
    #[schemars(range(min = 0))]
    pub alpha: f64,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for Polynomial {
    fn default() -> Self {
        Self { degree: None, alpha: 1e-9, rows: 100_000 }
    }
}

impl Polynomial {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        if let Some(degree) = self.degree {
            problems.expect((1..=20).contains(&degree), "degree", degree, "1 to 20");
        }
        expect_not_negative(&mut problems, "alpha", self.alpha);
        expect_at_least(&mut problems, "rows", self.rows, 2);
        problems
    }

    /// Problem of the degree with this number of inputs: a polynomial has `(inputs + degree)! / (inputs! degree!)`
    /// terms.
    fn degree_problem(&self, inputs: usize) -> Option<String> {
        let degree = self.degree?;
        let terms = (1..=usize::from(degree)).fold(1.0, |terms, index| terms * (inputs + index) as f64 / index as f64);
        let message = || format!("more than {MAX_TERMS} terms of degree {degree} in {inputs} inputs: lower `degree`");
        (terms.round() > MAX_TERMS as f64).then(message)
    }
}

/// `[baselines.svr]`: the kernel is `exp(-gamma |z - c|^2)` over standardized inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Svr {
    /// Maximum number of rows: the time grows with their square.
    #[schemars(range(min = 2))]
    pub rows: usize,
    /// Weight of the errors against the flatness of the model.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub c: f64,
    /// Errors up to this one, in standard deviations, count nothing.
    #[schemars(range(min = 0))]
    pub epsilon: f64,
    /// Narrowness of the kernel.
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub gamma: f64,
}

impl Default for Svr {
    fn default() -> Self {
        Self { rows: 1000, c: 100.0, epsilon: 0.01, gamma: 1.0 }
    }
}

impl Svr {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        problems.expect_positive("c", self.c);
        problems.expect_positive("gamma", self.gamma);
        expect_not_negative(&mut problems, "epsilon", self.epsilon);
        expect_at_least(&mut problems, "rows", self.rows, 2);
        problems
    }
}

/// `[baselines.knn]`: the mean of the nearest training rows, weighted by the inverse of their distance in standardized
/// inputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Knn {
    /// Number of neighbors.
    #[schemars(range(min = 1))]
    pub neighbors: usize,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for Knn {
    fn default() -> Self {
        Self { neighbors: 5, rows: 100_000 }
    }
}

impl Knn {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_at_least(&mut problems, "neighbors", self.neighbors, 1);
        expect_at_least(&mut problems, "rows", self.rows, self.neighbors.max(2));
        problems
    }
}

/// `[baselines.decision-tree]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DecisionTree {
    /// Fewest rows of a leaf.
    #[schemars(range(min = 1))]
    pub leaf: usize,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for DecisionTree {
    fn default() -> Self {
        Self { leaf: 2, rows: 200_000 }
    }
}

impl DecisionTree {
    fn problems(&self) -> Problems {
        problems_of_trees(1, self.leaf, self.rows)
    }
}

/// `[baselines.random-forest]`: the mean of trees, each of rows drawn with repetition.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RandomForest {
    /// Number of trees of each output.
    #[schemars(range(min = 1, max = MAX_TREES))]
    pub trees: usize,
    /// Fewest rows of a leaf.
    #[schemars(range(min = 1))]
    pub leaf: usize,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for RandomForest {
    fn default() -> Self {
        Self { trees: 20, leaf: 5, rows: 50_000 }
    }
}

impl RandomForest {
    fn problems(&self) -> Problems {
        problems_of_trees(self.trees, self.leaf, self.rows)
    }
}

/// `[baselines.extra-trees]`: the mean of trees whose splits are drawn at random.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ExtraTrees {
    /// Number of trees of each output.
    #[schemars(range(min = 1, max = MAX_TREES))]
    pub trees: usize,
    /// Fewest rows of a leaf.
    #[schemars(range(min = 1))]
    pub leaf: usize,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for ExtraTrees {
    fn default() -> Self {
        Self { trees: 20, leaf: 5, rows: 50_000 }
    }
}

impl ExtraTrees {
    fn problems(&self) -> Problems {
        problems_of_trees(self.trees, self.leaf, self.rows)
    }
}

/// `[baselines.gradient-boosting]`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GradientBoosting {
    /// Number of trees of each output.
    #[schemars(range(min = 1, max = MAX_TREES))]
    pub trees: usize,
    /// Most splits from the root to a leaf.
    #[schemars(range(min = 1))]
    pub depth: u16,
    /// Share of its correction that a tree makes.
    #[schemars(range(max = 1), extend("exclusiveMinimum" = 0))]
    pub learning_rate: f64,
    /// Maximum number of rows.
    #[schemars(range(min = 2))]
    pub rows: usize,
}

impl Default for GradientBoosting {
    fn default() -> Self {
        Self { trees: 100, depth: 6, learning_rate: 0.3, rows: 50_000 }
    }
}

impl GradientBoosting {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_between(&mut problems, "trees", self.trees, 1, MAX_TREES);
        expect_at_least(&mut problems, "depth", self.depth.into(), 1);
        let is_share = self.learning_rate > 0.0 && self.learning_rate <= 1.0;
        problems.expect(is_share, "learning_rate", self.learning_rate, "above 0, at most 1");
        expect_at_least(&mut problems, "rows", self.rows, 2);
        problems
    }
}

/// `[baselines.gaussian-process]`: a squared exponential kernel with a length for each standardized input.
/// Amplitude, lengths and noise are those of the greatest likelihood of a few rows; the model is that of more.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GaussianProcess {
    /// Maximum number of rows: the time grows with their cube.
    #[schemars(range(min = 2, max = MAX_PROCESS))]
    pub rows: usize,
    /// Number of rows that determine the kernel.
    #[schemars(range(min = 2, max = MAX_PROCESS))]
    pub kernel_rows: usize,
    /// Steps of the search for the greatest likelihood.
    #[schemars(range(min = 1, max = MAX_PROCESS))]
    pub steps: usize,
    /// Standard deviation of the noise, relative to that of the function, where the search begins.
    #[schemars(range(min = 1e-6), extend("exclusiveMaximum" = 1))]
    pub noise: f64,
}

impl Default for GaussianProcess {
    fn default() -> Self {
        Self { rows: 1000, kernel_rows: 500, steps: 100, noise: 1e-3 }
    }
}

impl GaussianProcess {
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        expect_between(&mut problems, "rows", self.rows, 2, MAX_PROCESS);
        expect_between(&mut problems, "kernel_rows", self.kernel_rows, 2, MAX_PROCESS);
        expect_between(&mut problems, "steps", self.steps, 1, MAX_PROCESS);
        problems.expect((1e-6..1.0).contains(&self.noise), "noise", self.noise, "at least 1e-6 and below 1");
        problems
    }
}

fn problems_of_trees(trees: usize, leaf: usize, rows: usize) -> Problems {
    let mut problems = Problems::default();
    expect_between(&mut problems, "trees", trees, 1, MAX_TREES);
    expect_at_least(&mut problems, "leaf", leaf, 1);
    expect_at_least(&mut problems, "rows", rows, 2);
    problems
}

fn expect_not_negative(problems: &mut Problems, key: &str, value: f64) {
    problems.expect(value >= 0.0 && value.is_finite(), key, value, "0 or a positive number");
}

fn expect_at_least(problems: &mut Problems, key: &str, value: usize, least: usize) {
    problems.expect(value >= least, key, value, &format!("at least {least}"));
}

fn expect_between(problems: &mut Problems, key: &str, value: usize, least: usize, most: usize) {
    expect_at_least(problems, key, value, least);
    problems.expect(value <= most, key, value, &format!("at most {most}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostics::KeyProblem;

    #[test]
    fn names_are_those_of_the_study_and_every_default_is_valid() {
        for kind in BaselineKind::ALL {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert!(Baselines::default().problems().is_empty());
    }

    #[test]
    fn mistakes_are_named_by_key() {
        let parse = |text: &str| toml::from_str::<Baselines>(text).map(|baselines| baselines.problems());
        for (text, expected) in [
            ("time_budget = 0", "time_budget: 0, expected a positive number"),
            ("models = [\"ridge\", \"ridge\"]", "models: `ridge` is duplicated"),
            ("ridge = { alpha = -1 }", "ridge.alpha: -1, expected 0 or a positive number"),
            ("elastic-net = { l1_ratio = 2 }", "elastic-net.l1_ratio: 2, expected a share above 0, at most 1"),
            ("polynomial = { degree = 0 }", "polynomial.degree: 0, expected 1 to 20"),
            ("svr = { rows = 1 }", "svr.rows: 1, expected at least 2"),
            ("knn = { neighbors = 0 }", "knn.neighbors: 0, expected at least 1"),
            ("random-forest = { trees = 0 }", "random-forest.trees: 0, expected at least 1"),
            ("random-forest = { trees = 1000000000 }", "random-forest.trees: 1000000000, expected at most 10000"),
            (
                "gradient-boosting = { trees = 1000000000 }",
                "gradient-boosting.trees: 1000000000, expected at most 10000",
            ),
            ("gaussian-process = { rows = 1000000 }", "gaussian-process.rows: 1000000, expected at most 20000"),
        ] {
            let problems: Vec<String> = parse(text)
                .unwrap()
                .into_iter()
                .map(|KeyProblem { key, message }| format!("{key}: {message}"))
                .collect();
            assert_eq!(problems, [expected], "{text}");
        }
        let beside = |text: &str, inputs| {
            toml::from_str::<Baselines>(text).unwrap().problems_beside(inputs).into_iter().collect::<Vec<_>>()
        };
        assert_eq!(beside("polynomial = { degree = 20 }", 2), []);
        let message = "more than 5000 terms of degree 20 in 4 inputs: lower `degree`".to_owned();
        assert_eq!(
            beside("polynomial = { degree = 20 }", 4),
            [KeyProblem { key: "polynomial.degree".into(), message }]
        );
        assert!(parse("models = [\"forest\"]").unwrap_err().to_string().contains("unknown variant `forest`"));
        assert!(parse("ridge = { lambda = 1 }").unwrap_err().to_string().contains("unknown field `lambda`"));
    }
}
