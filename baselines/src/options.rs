//! `[baselines]` of the study.

use crate::{
    Baseline, DecisionTree, ElasticNet, ExtraTrees, GaussianProcess, GradientBoosting, Knn, Lasso, Linear,
    OptionProblem, Polynomial, RandomForest, Ridge, Svr,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::str::FromStr;

/// `[baselines]`: which models are compared with the network, and how each is fitted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Baselines {
    /// Those that `metafmu compare` fits.
    pub models: Vec<BaselineKind>,
    /// Those of them that `metafmu build` fits.
    pub build: Vec<BaselineKind>,
    /// What each may take to fit and to predict the test rows.
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

impl FromStr for BaselineKind {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
            let names = Self::ALL.map(|kind| format!("`{}`", kind.name()));
            format!("no model `{name}`, expected one of {}", names.join(", "))
        })
    }
}

impl Baselines {
    /// The model of a kind with its options.
    pub fn get(&self, kind: BaselineKind) -> &dyn Baseline {
        match kind {
            BaselineKind::Linear => &self.linear,
            BaselineKind::Ridge => &self.ridge,
            BaselineKind::Lasso => &self.lasso,
            BaselineKind::ElasticNet => &self.elastic_net,
            BaselineKind::Polynomial => &self.polynomial,
            BaselineKind::Svr => &self.svr,
            BaselineKind::Knn => &self.knn,
            BaselineKind::DecisionTree => &self.decision_tree,
            BaselineKind::RandomForest => &self.random_forest,
            BaselineKind::ExtraTrees => &self.extra_trees,
            BaselineKind::GradientBoosting => &self.gradient_boosting,
            BaselineKind::GaussianProcess => &self.gaussian_process,
        }
    }

    /// What is wrong beside so many inputs.
    pub fn problems_beside(&self, inputs: usize) -> Vec<OptionProblem> {
        let degree = self.polynomial.degree_problem(inputs);
        degree.map(|message| OptionProblem { key: "polynomial.degree".into(), message }).into_iter().collect()
    }

    /// Every mistake.
    pub fn problems(&self) -> Vec<OptionProblem> {
        let mut problems = Vec::from_iter(super::positive("time_budget", self.time_budget));
        for (key, kinds) in [("models", &self.models), ("build", &self.build)] {
            let twice = kinds.iter().enumerate().find(|(index, kind)| kinds[..*index].contains(kind));
            let message = |kind: BaselineKind| format!("`{}` is duplicated", kind.name());
            problems.extend(twice.map(|(_, kind)| OptionProblem { key: key.into(), message: message(*kind) }));
        }
        for kind in BaselineKind::ALL {
            let within = |problem: &OptionProblem| format!("{}.{}", kind.name(), problem.key);
            let of_model = self.get(kind).problems().into_iter();
            problems.extend(of_model.map(|problem| OptionProblem { key: within(&problem), ..problem }));
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_those_of_the_study_and_every_default_is_valid() {
        for kind in BaselineKind::ALL {
            assert_eq!(serde_json::to_value(kind).unwrap(), kind.name());
        }
        assert_eq!(Baselines::default().problems(), []);
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
            ("knn = { neighbours = 0 }", "knn.neighbours: 0, expected at least 1"),
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
                .map(|OptionProblem { key, message }| format!("{key}: {message}"))
                .collect();
            assert_eq!(problems, [expected], "{text}");
        }
        let beside = |text: &str, inputs| toml::from_str::<Baselines>(text).unwrap().problems_beside(inputs);
        assert_eq!(beside("polynomial = { degree = 20 }", 2), []);
        let message = "more than 5000 terms of degree 20 in 4 inputs: lower `degree`".to_owned();
        assert_eq!(
            beside("polynomial = { degree = 20 }", 4),
            [OptionProblem { key: "polynomial.degree".into(), message }]
        );
        assert!(parse("models = [\"forest\"]").unwrap_err().to_string().contains("unknown variant `forest`"));
        assert!(parse("ridge = { lambda = 1 }").unwrap_err().to_string().contains("unknown field `lambda`"));
    }
}
