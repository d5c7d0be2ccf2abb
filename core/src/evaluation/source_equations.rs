//! A source's own equations, integrated accurately: the truth that its runs and a surrogate of these equations both approximate.

use super::{AcceptanceCheck, Accuracy, DomainExit, OutputMetrics, Reason, compare, predict_all};
use crate::{
    dataset::{Dataset, Run},
    diagnostics::numbers::number,
};
use indexmap::IndexMap;
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize};

/// Accuracy of a surrogate, and of the source's own runs, relative to the source's own equations along the test runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceEquations {
    /// Accuracy of the surrogate on all rows.
    pub surrogate: Box<Accuracy>,
    /// Errors of the surrogate on the rows by which it is compared with the source: those before a motion leaves the domain, and of a chaotic
    /// run the first sixth.
    pub surrogate_compared: IndexMap<String, OutputMetrics>,
    /// Errors of the source's own runs on these rows, which have the errors of its time step.
    pub source: IndexMap<String, OutputMetrics>,
}

impl SourceEquations {
    /// Measures both. `exact`: outputs of the integrated equations at the first rows of each run, row by row, as far as they are known.
    pub fn new(surrogate: &Surrogate, test: &Dataset, exact: Vec<Vec<f64>>) -> Self {
        let width = test.outputs.len();
        let known = test.runs.iter().zip(exact).filter(|(_, exact)| !exact.is_empty());
        let known = known.map(|(run, exact)| {
            let source = run.beginning(exact.len() / width, width);
            (Run { outputs: exact, ..source.clone() }, source.outputs)
        });
        let (runs, own): (Vec<Run>, Vec<Vec<f64>>) = known.unzip();
        let truth = Dataset { runs, ..test.clone() };
        let predictions = predict_all(surrogate, &truth);
        let accuracy = Accuracy::from_predictions(surrogate, &truth, &predictions);
        let rows = compared_rows(&truth, &accuracy);
        let runs = truth.runs.iter().zip(&rows).map(|(run, rows)| run.beginning(*rows, width)).collect();
        let compared = Dataset { runs, ..truth };
        Self {
            surrogate_compared: errors(&compared, &predictions),
            source: errors(&compared, &own),
            surrogate: Box::new(accuracy),
        }
    }

    /// Returns true if the source's time step explains the difference of a surrogate from the source's runs: the surrogate is nearer to the
    /// equations, in every output that is not exact.
    pub fn explain(&self, of_runs: &Accuracy) -> bool {
        self.source.iter().all(|(name, source)| {
            let errors = self.surrogate_compared.get(name).zip(of_runs.outputs.get(name));
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
            let own = self.surrogate_compared.get(name).map_or(0.0, |metrics| metrics.max_abs_error);
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

/// Part of a chaotic run in which errors of the source's time step and of the surrogate have not grown into noise.
const PREDICTABLE: f64 = 1.0 / 6.0;

/// Number of rows of each run by which a surrogate is compared with its source.
fn compared_rows(truth: &Dataset, accuracy: &Accuracy) -> Vec<usize> {
    let exits = accuracy.outside.as_ref().map_or(&[][..], |outside| &outside.exits);
    let of_inside = accuracy.outside.as_ref().map_or(accuracy, |outside| &outside.inside);
    let chaotic = of_inside.roll_outs.as_ref().map_or(&[][..], |roll_outs| &roll_outs.chaotic_runs);
    let runs = truth.runs.iter().enumerate();
    runs.map(|(index, run)| {
        let rows = rows_inside(run, exits.iter().find(|exit| exit.run == index));
        if chaotic.contains(&index) { ((PREDICTABLE * rows as f64) as usize).max(2).min(rows) } else { rows }
    })
    .collect()
}

/// Number of rows of a run before it leaves the domain.
fn rows_inside(run: &Run, exit: Option<&DomainExit>) -> usize {
    // the first row has the initial states, which are given
    exit.map_or(run.times.len(), |exit| run.times.partition_point(|time| *time < exit.time)).max(1)
}

/// Errors of outputs on the rows of `compared`, which are the first ones of each run.
fn errors(compared: &Dataset, outputs: &[Vec<f64>]) -> IndexMap<String, OutputMetrics> {
    let names = compared.outputs.iter().map(|output| output.name.clone());
    let beginnings: Vec<Vec<f64>> =
        compared.runs.iter().zip(outputs).map(|(run, outputs)| outputs[..run.outputs.len()].to_vec()).collect();
    names.zip(compare(compared, &beginnings, None)).collect()
}

/// Part of a mean square error that counts as rounding.
const ROUNDING: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{evaluation::RollOut, variable::SourceVariable};
    use metafmu_example as example;
    use metafmu_runtime::Evaluator;
    use std::{f64::consts::PI, sync::Arc};

    /// Error of the source's own runs.
    const OWN_ERROR: f64 = 1e-3;

    #[test]
    fn chaotic_runs_and_exits_do_not_hide_a_coarse_time_step() {
        // its trolley has a range of 5 m in both directions
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let times: Arc<[f64]> = (0..=200).map(|row| 0.05 * f64::from(row)).collect();
        let width = surrogate.outputs().len();
        let run = |angle: f64, speed: f64| {
            let (parameters, inputs) = (vec![1.2, 0.0, angle, speed, 0.0], vec![0.0; times.len()]);
            let run = Run { inputs, parameters, times: times.clone(), outputs: Vec::new() };
            let mut roll_out = RollOut::along(&surrogate, &evaluator, &run);
            let outputs = (0..times.len()).flat_map(|row| roll_out.at(row).unwrap().1[..width].to_vec()).collect();
            Run { outputs, ..run }
        };
        let mut exact: Vec<Run> = vec![run(0.8, 0.1), run(0.3, 8.0), run(PI, 0.0)];
        // a wall a little beyond the domain
        for outputs in exact[1].outputs.chunks_mut(width).filter(|outputs| outputs[0] > 5.2) {
            outputs[0] = 5.2;
        }
        // where the load falls to from its upright rest is left to rounding
        exact[2].outputs.chunks_mut(width).skip(150).for_each(|outputs| outputs[1] += 2.0);
        let mut own = exact.clone();
        own.iter_mut().flat_map(|run| &mut run.outputs).for_each(|value| *value += OWN_ERROR);
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let test = Dataset {
            inputs: vec![variable("force")],
            parameters: ["rope", "x_start", "theta_start", "speed_start", "rate_start"].map(variable).to_vec(),
            outputs: surrogate.outputs().iter().map(|output| variable(&output.name)).collect(),
            runs: own,
        };
        let of_runs = Accuracy::of(&surrogate, &test);
        let exact: Vec<Vec<f64>> = exact.into_iter().map(|run| run.outputs).collect();
        let equations = SourceEquations::new(&surrogate, &test, exact.clone());
        assert!(equations.explain(&of_runs), "{equations:?}");
        for (name, metrics) in &equations.source {
            assert!((metrics.max_abs_error - OWN_ERROR).abs() < 1e-12, "{name}: {metrics:?}");
            assert!(equations.surrogate_compared[name].max_abs_error < 1e-9, "{name}");
        }
        assert!(equations.surrogate.outputs.values().any(|metrics| metrics.max_abs_error > 1.0));
        // rows that are not known do not count
        let beginnings: Vec<Vec<f64>> = exact.iter().map(|outputs| outputs[..50 * width].to_vec()).collect();
        assert_eq!(SourceEquations::new(&surrogate, &test, beginnings).surrogate.test_rows, 150);
        // the source's runs are as exact as can be, and the surrogate is of other equations
        let own = test.runs.iter().map(|run| run.outputs.clone()).collect();
        assert!(!SourceEquations::new(&surrogate, &test, own).explain(&of_runs));
    }
}
