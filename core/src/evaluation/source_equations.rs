//! A source's own equations, integrated accurately: the truth that its runs and a surrogate of these equations both approximate.

use super::{AcceptanceCheck, Accuracy, OutputMetrics, Reason, compare};
use crate::{dataset::Dataset, diagnostics::numbers::number};
use indexmap::IndexMap;
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize};

/// Accuracy of a surrogate, and of the source's own runs, relative to the source's own equations along the test runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceEquations {
    /// Accuracy of the surrogate.
    pub surrogate: Box<Accuracy>,
    /// Errors of the source's own runs, which have the errors of its time step.
    pub source: IndexMap<String, OutputMetrics>,
}

impl SourceEquations {
    /// Measures both. `exact`: outputs of the integrated equations at the rows of each run, row by row.
    pub fn new(surrogate: &Surrogate, test: &Dataset, exact: Vec<Vec<f64>>) -> Self {
        let mut truth = test.clone();
        truth.runs.iter_mut().zip(exact).for_each(|(run, exact)| run.outputs = exact);
        let own: Vec<Vec<f64>> = test.runs.iter().map(|run| run.outputs.clone()).collect();
        let names = test.outputs.iter().map(|output| output.name.clone());
        Self {
            source: names.zip(compare(&truth, &own, None)).collect(),
            surrogate: Box::new(Accuracy::of(surrogate, &truth)),
        }
    }

    /// Returns true if the source's time step explains the difference of a surrogate from the source's runs: the surrogate is nearer to the
    /// equations, in every output that is not exact.
    pub fn explain(&self, of_runs: &Accuracy) -> bool {
        self.source.iter().all(|(name, source)| {
            let errors = self.surrogate.outputs.get(name).zip(of_runs.outputs.get(name));
            errors.is_some_and(|(surrogate, of_runs)| {
                surrogate.mse < source.mse || surrogate.mse <= ROUNDING * of_runs.mse
            })
        })
    }

    /// The limit on the surrogate's verdict, and what helps.
    pub fn findings(&self) -> (Reason, String) {
        let ratio = |metrics: &OutputMetrics| metrics.relative_error();
        let worst = self.source.iter().max_by(|a, b| ratio(a.1).total_cmp(&ratio(b.1)));
        let cause = worst.map_or(String::new(), |(name, OutputMetrics { max_abs_error, worst_run, worst_time, .. })| {
            let own = self.surrogate.outputs.get(name).map_or(0.0, |metrics| metrics.max_abs_error);
            format!(
                "the source's own runs are off by up to {} from its equations, integrated accurately (run {worst_run}, t = {} s), the \
                 surrogate by {}: it was judged by the equations. The source's time step is too long, or its runs contain what its \
                 equations lack",
                number(*max_abs_error),
                number(*worst_time),
                number(own)
            )
        });
        let name = worst.map_or("", |(name, _)| name.as_str());
        let advice = "a shorter time step of the source, then `metafmu build` again: the surrogate is nearer to the equations than the source is";
        (Reason::new(AcceptanceCheck::SourceStep, name, cause), advice.into())
    }
}

/// Part of a mean square error that counts as rounding.
const ROUNDING: f64 = 1e-12;
