//! How good a surrogate is on runs it has not seen.

pub mod comparison;
mod coverage;
mod noise;
mod outside;
mod roll_outs;
mod source_equations;
mod verdict;

use crate::{
    dataset::{Dataset, Run},
    diagnostics::numbers::is_proper,
    layout::InputPoint,
    variable::SourceVariable,
};
pub use coverage::{KindCoverage, SignalKind};
use indexmap::IndexMap;
use metafmu_runtime::{Evaluator, Rows, Surrogate};
pub use noise::NoiseEstimate;
pub use outside::{DomainExit, OutsideRows};
use rayon::prelude::*;
pub use roll_outs::RollOut;
pub use roll_outs::{CHAOTIC, Horizon, OFF, RollOuts, constraint_residual};
use serde::{Deserialize, Serialize};
pub use source_equations::SourceEquations;
pub use verdict::{AcceptanceCheck, Findings, Grade, Reason, Verdict};

/// Accuracy of one output over all predicted rows of all test runs, in the output's unit. What is too large for a number, or an error of no
/// number, counts as the largest one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutputMetrics {
    /// Coefficient of determination, `1 - sum (y - prediction)^2 / sum (y - mean y)^2`; none if the truth does not vary by more than
    /// rounding.
    pub r2: Option<f64>,
    /// Mean squared error.
    pub mse: f64,
    /// Largest absolute error.
    pub max_abs_error: f64,
    /// Largest absolute error as a share of the output's range in training; none for a constant output, or without a
    /// surrogate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_max_error: Option<f64>,
    /// Test run in which the largest error stands.
    pub worst_run: usize,
    /// Time of the largest error, in seconds.
    pub worst_time: f64,
    /// The surrogate's error bound, if it has one; of a surrogate with a state the one at the end of its runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bound: Option<f64>,
    /// Share of the rows whose error is within the bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within_bound: Option<f64>,
    /// Share of the rows whose error is within two predicted standard deviations, of an output that has one: 0.954 of normal errors.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub within_two_std: Option<f64>,
    /// Noise of the measured output and error of the model apart from it, of a discrete-time surrogate whose errors show noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub noise: Option<NoiseEstimate>,
}

impl OutputMetrics {
    /// Root mean square error; the largest number if it is not finite.
    pub fn rms(&self) -> f64 {
        if is_proper(self.mse) { self.mse.sqrt() } else { f64::MAX }
    }

    /// Root mean square error relative to the standard deviation of the truth, `sqrt(1 - R²)`, or, if the truth does not vary, to the
    /// output's range in training; 0 without such a range.
    pub fn relative_error(&self) -> f64 {
        let relative = match (self.r2, self.relative_max_error) {
            (Some(r2), _) => (1.0 - r2).max(0.0).sqrt(),
            (None, Some(share)) if share > 0.0 => self.rms() * (share / self.max_abs_error),
            (None, _) => 0.0,
        };
        finite(relative)
    }
}

/// Rows that a surrogate was measured on, which belong to no runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TestRows {
    /// Rows that were given for it.
    Given,
    /// Those that were held out of the fit, and of the choice of the kind of model and of the best epoch.
    HeldOut,
    /// All of them, each predicted by a model that was fitted without it: cross-validation.
    CrossValidated,
    /// Rows of the test runs.
    OfRuns,
}

/// Accuracy of a surrogate, and on what it was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Accuracy {
    /// Accuracy of each output, by name.
    pub outputs: IndexMap<String, OutputMetrics>,
    /// Accuracy of each output over the runs that are not chaotic, see [`RollOuts::chaotic_runs`]; empty if all or none
    /// are.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub regular_outputs: IndexMap<String, OutputMetrics>,
    /// Number of test runs; of rows without runs each is one.
    pub test_runs: usize,
    /// Number of predicted rows of all of them: those that the figures are of.
    pub test_rows: usize,
    /// Number of further rows that are given and not predicted, see [`first_predicted`].
    #[serde(default, skip_serializing_if = "is_zero")]
    pub given_rows: usize,
    /// Content digest of the surrogate, so that figures of one are not taken for those of another.
    pub content_digest: String,
    /// Growth of errors along roll-outs, for a surrogate with states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roll_outs: Option<RollOuts>,
    /// Origin of the rows, if they belong to no runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rows: Option<TestRows>,
    /// End of the rows of the test runs that were learned from, in seconds, if runs were divided in time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seen_until: Option<f64>,
    /// Share of the calibration runs' rows within the error bounds, by kind of signal, if bounds were measured on several kinds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub calibration: Vec<KindCoverage>,
    /// Accuracy before motions leave the domain, if some do.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub outside: Option<OutsideRows>,
    /// Accuracy relative to the source's own equations, if they were integrated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_equations: Option<SourceEquations>,
    /// Verdict on the surrogate, if it has been judged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub verdict: Option<Verdict>,
}

impl Accuracy {
    /// Measures a surrogate on unseen runs.
    pub fn of(surrogate: &Surrogate, test: &Dataset) -> Self {
        Self::from_predictions(surrogate, test, &predict_all(surrogate, test))
    }

    /// Measures a surrogate by the predictions of [`predict_all`].
    pub fn from_predictions(surrogate: &Surrogate, test: &Dataset, predictions: &[Vec<f64>]) -> Self {
        let outside = OutsideRows::of(surrogate, test, predictions);
        Self { outside, ..Self::of_all_rows(surrogate, test, predictions) }
    }

    /// Accuracy on all rows, whether they are in the domain or not.
    fn of_all_rows(surrogate: &Surrogate, test: &Dataset, predictions: &[Vec<f64>]) -> Self {
        let roll_outs = surrogate.program().has_memory().then(|| RollOuts::of(surrogate, test, predictions));
        let chaotic = roll_outs.as_ref().map_or(&[][..], |roll_outs| &roll_outs.chaotic_runs);
        let of_runs = |runs: &[usize]| -> IndexMap<String, OutputMetrics> {
            let names = surrogate.predictions().iter().map(|output| output.name.clone());
            names.zip(compare_runs(test, runs, predictions, Some(surrogate))).collect()
        };
        let all: Vec<usize> = (0..test.runs.len()).collect();
        let regular: Vec<usize> = all.iter().copied().filter(|run| !chaotic.contains(run)).collect();
        let some_are_chaotic = !regular.is_empty() && !chaotic.is_empty();
        let given_rows = test.runs.iter().map(|run| first_predicted(surrogate, run)).sum();
        Self {
            outputs: of_runs(&all),
            regular_outputs: if some_are_chaotic { of_runs(&regular) } else { IndexMap::new() },
            test_runs: test.runs.len(),
            test_rows: test.row_count() - given_rows,
            given_rows,
            content_digest: surrogate.metadata().provenance.content_digest.clone(),
            roll_outs,
            rows: None,
            seen_until: None,
            calibration: Vec::new(),
            outside: None,
            source_equations: None,
            verdict: None,
        }
    }

    /// Measures a surrogate without states on rows of its inputs, `points`, and what its outputs should be, `labels`. The run of an
    /// error is its row, counted from 0, and its share is of the labels' range.
    pub fn of_rows(surrogate: &Surrogate, rows: TestRows, points: &Rows, labels: &Rows) -> Self {
        Self::of_row_predictions(surrogate, rows, &predict_rows(surrogate, points), labels)
    }

    /// Measures a surrogate by its predictions of the rows, each with a number for each output.
    pub fn of_row_predictions(surrogate: &Surrogate, rows: TestRows, predictions: &Rows, labels: &Rows) -> Self {
        let outputs: Vec<SourceVariable> =
            surrogate.predictions().iter().map(|output| SourceVariable::new(&output.name, &output.unit, "")).collect();
        let test = Dataset::of_rows(&[], &outputs, &Rows::zeros(0, labels.len()), labels);
        let of_runs: Vec<Vec<f64>> = predictions.iter().map(<[f64]>::to_vec).collect();
        let mut found = Self { rows: Some(rows), ..Self::from_predictions(surrogate, &test, &of_runs) };
        // the surrogate's ranges are those of its own predictions
        for (column, metrics) in found.outputs.values_mut().enumerate() {
            let ends = labels.column(column);
            let range = ends.clone().fold(f64::NEG_INFINITY, f64::max) - ends.fold(f64::INFINITY, f64::min);
            metrics.relative_max_error = (range > 0.0).then(|| share_of(metrics.max_abs_error, range));
        }
        found
    }

    /// Description of how often rows are within two predicted standard deviations; None without these.
    pub fn within_two_std(&self) -> Option<String> {
        let shares = self.outputs.values().filter_map(|metrics| metrics.within_two_std);
        let shares: Vec<String> = shares.map(|share| format!("{:.1} %", 100.0 * share)).collect();
        let expected = "95.4 % of normal errors would be";
        (!shares.is_empty()).then(|| {
            format!("Within two predicted standard deviations: {} of these rows; {expected}", shares.join(", "))
        })
    }

    /// Description of the noise of each output that has some.
    pub fn noise(&self, surrogate: &Surrogate) -> Vec<String> {
        let unit =
            |name: &String| surrogate.outputs().iter().find(|output| output.name == *name).map(|output| &output.unit);
        let of_output = |(name, metrics): (&String, &OutputMetrics)| {
            let unit = unit(name).map_or("", String::as_str);
            Some(metrics.noise?.describe(name, unit, metrics.bound.is_some()))
        };
        self.outputs.iter().filter_map(of_output).collect()
    }
}

/// Predictions of the surrogate for a run: shape `[times, outputs]`. With states, it is rolled out from the start of
/// the run, with inputs that are linear between two rows. Values that cannot be computed are NaN.
pub fn predict(surrogate: &Surrogate, evaluator: &Evaluator, run: &Run) -> Vec<f64> {
    if surrogate.program().has_memory() {
        return RollOut::along(surrogate, evaluator, run).predictions();
    }
    let width = surrogate.outputs().len();
    let mut predictions = vec![0.0; run.times.len() * width];
    let (mut evaluator, mut point) = (evaluator.clone(), InputPoint::of(run, surrogate.time_column().is_some()));
    for (&time, outputs) in run.times.iter().zip(predictions.chunks_mut(width)) {
        evaluator.evaluate(point.at(time), outputs);
    }
    predictions
}

/// Predictions of a surrogate without states for rows of its inputs.
pub fn predict_rows(surrogate: &Surrogate, points: &Rows) -> Rows {
    let evaluator = Evaluator::new(surrogate);
    let rows = (0..points.len()).into_par_iter();
    let predictions =
        rows.map_init(|| evaluator.clone(), |evaluator, row| predict_row(surrogate, evaluator, &points[row]));
    predictions.collect::<Vec<_>>().into_iter().collect()
}

fn predict_row(surrogate: &Surrogate, evaluator: &mut Evaluator, point: &[f64]) -> Vec<f64> {
    let mut outputs = vec![0.0; surrogate.outputs().len()];
    evaluator.evaluate(point, &mut outputs);
    outputs
}

/// Predictions of the surrogate for each run, see [`predict`].
pub fn predict_all(surrogate: &Surrogate, test: &Dataset) -> Vec<Vec<f64>> {
    let evaluator = Evaluator::new(surrogate);
    test.runs.par_iter().map(|run| predict(surrogate, &evaluator, run)).collect()
}

/// Index of the first row of a run that a surrogate predicts. A discrete-time one is given the rows before the start, or else the outputs
/// of the first row, which it begins with.
pub fn first_predicted(surrogate: &Surrogate, run: &Run) -> usize {
    match surrogate.program().sampling() {
        Some(_) => run.times.partition_point(|time| *time < 0.0).max(1).min(run.times.len()),
        None => 0,
    }
}

/// Accuracy of predictions of the test runs, each of shape `[times, columns]`, for every output of the runs, over the predicted rows: the first
/// columns, which predicted standard deviations may follow. `surrogate`: whose they are, if it has ranges and bounds.
pub fn compare(test: &Dataset, predictions: &[Vec<f64>], surrogate: Option<&Surrogate>) -> Vec<OutputMetrics> {
    let all: Vec<usize> = (0..test.runs.len()).collect();
    compare_runs(test, &all, predictions, surrogate)
}

/// Metrics of each output over some of the runs.
fn compare_runs(
    test: &Dataset,
    runs: &[usize],
    predictions: &[Vec<f64>],
    surrogate: Option<&Surrogate>,
) -> Vec<OutputMetrics> {
    let columns = (0..test.outputs.len()).into_par_iter();
    columns.map(|column| output_metrics(test, (runs, predictions), column, surrogate)).collect()
}

fn output_metrics(
    test: &Dataset,
    (runs, predictions): (&[usize], &[Vec<f64>]),
    column: usize,
    surrogate: Option<&Surrogate>,
) -> OutputMetrics {
    let bounds = surrogate.and_then(Surrogate::bounds);
    let range = surrogate.map(|surrogate| &surrogate.outputs()[column]).map(|output| output.max - output.min);
    let width = test.outputs.len();
    let first = |run: &Run| surrogate.map_or(0, |surrogate| first_predicted(surrogate, run));
    let labels =
        |run: &Run| run.outputs.iter().skip(column).step_by(width).skip(first(run)).copied().collect::<Vec<_>>();
    let all: Vec<f64> = runs.iter().flat_map(|&run| labels(&test.runs[run])).collect();
    let rows = all.len().max(1) as f64;
    let mean = all.iter().sum::<f64>() / rows;
    let (mut residual, mut total) = (0.0, 0.0);
    let mut worst = (0.0, 0, 0.0);
    let (mut within, mut within_two_std) = (0, 0);
    let std = surrogate.and_then(|surrogate| surrogate.std_column(column));
    // of a surrogate with predicted standard deviations more than the outputs of the runs
    let columns = |index: usize| predictions[index].len() / test.runs[index].times.len().max(1);
    for &index in runs {
        let run = &test.runs[index];
        let first = first(run);
        let predicted = predictions[index].chunks(columns(index)).skip(first);
        for ((label, predicted), &time) in labels(run).iter().zip(predicted).zip(&run.times[first..]) {
            let error = finite((label - predicted[column]).abs());
            within_two_std += usize::from(std.is_some_and(|std| error <= 2.0 * predicted[std]));
            residual += error * error;
            total += (label - mean).powi(2);
            within += usize::from(bounds.is_some_and(|bounds| error <= bounds.at(column, time)));
            if error > worst.0 {
                worst = (error, index, time);
            }
        }
    }
    let (max_abs_error, worst_run, worst_time) = worst;
    // of infinite sums it is as bad as can be
    let r2 = varies(&all, range.unwrap_or(0.0))
        .then(|| if residual.is_finite() { finite(1.0 - residual / total) } else { f64::MIN });
    let (bound, within_bound) = (bounds.map(|bounds| bounds.largest(column)), bounds.map(|_| within as f64 / rows));
    let within_two_std = std.map(|_| within_two_std as f64 / rows);
    let mse = finite(residual / rows);
    let relative_max_error = range.filter(|&range| range > 0.0).map(|range| share_of(max_abs_error, range));
    let of_run = |&index: &usize| {
        let run = &test.runs[index];
        let inputs = run.inputs.len() / run.times.len().max(1);
        let predicted = predictions[index].iter().skip(column).step_by(columns(index)).skip(first(run));
        let differences = labels(run).iter().zip(predicted).map(|(label, prediction)| label - prediction).collect();
        (differences, &run.inputs[first(run) * inputs..])
    };
    let is_sampled = surrogate.is_some_and(|surrogate| surrogate.program().sampling().is_some());
    let noise = is_sampled
        .then(|| noise::estimate(&runs.iter().map(of_run).collect::<Vec<_>>(), (total / rows).sqrt()))
        .flatten();
    OutputMetrics {
        r2,
        mse,
        max_abs_error,
        relative_max_error,
        worst_run,
        worst_time,
        bound,
        within_bound,
        within_two_std,
        noise,
    }
}

/// Largest spread that counts as rounding, relative to the magnitude of the values and to their range in training.
const ROUNDING: [f64; 2] = [1e-14, 1e-10];

/// Returns true if values differ by more than rounding explains; `range`: that of the quantity in training.
fn varies(values: &[f64], range: f64) -> bool {
    let fold = |[low, high]: [f64; 2], value: &f64| [low.min(*value), high.max(*value)];
    let [low, high] = values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], fold);
    let [of_magnitude, of_range] = ROUNDING;
    high - low > (of_magnitude * low.abs().max(high.abs())).max(of_range * range)
}

fn is_zero(count: &usize) -> bool {
    *count == 0
}

/// Error as a share of a range; the largest number if the error is.
fn share_of(error: f64, range: f64) -> f64 {
    if is_proper(error) { finite(error / range) } else { f64::MAX }
}

/// JSON has neither infinity nor NaN.
fn finite(value: f64) -> f64 {
    if value.is_nan() { f64::MAX } else { value.clamp(f64::MIN, f64::MAX) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;
    use std::sync::Arc;

    #[test]
    fn errors_put_into_the_labels_are_found_again() {
        let surrogate = example::surrogate();
        let evaluator = Evaluator::new(&surrogate);
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let mut runs: Vec<Run> = [[0.12, 1.0], [0.18, 4.0]]
            .map(|parameters| {
                let times: Arc<[f64]> = (0..21).map(|i| f64::from(i) * 0.1).collect();
                let mut run = Run { inputs: Vec::new(), parameters: parameters.to_vec(), times, outputs: Vec::new() };
                run.outputs = predict(&surrogate, &evaluator, &run);
                run
            })
            .into();
        runs[1].outputs[2 * 7] += 0.25; // output 0 of run 1 at t = 0.7
        let (parameters, outputs) =
            (vec![variable("length"), variable("speed")], vec![variable("angle"), variable("velocity")]);
        let accuracy =
            Accuracy::of(&surrogate, &Dataset { inputs: Vec::new(), parameters, outputs, runs: runs.clone() });
        let metrics: Vec<OutputMetrics> = accuracy.outputs.into_values().collect();
        assert!((metrics[0].mse - 0.0625 / 42.0).abs() < 1e-15);
        assert!((metrics[0].max_abs_error - 0.25).abs() < 1e-15);
        let angle = &surrogate.outputs()[0];
        assert!((metrics[0].relative_max_error.unwrap() - 0.25 / (angle.max - angle.min)).abs() < 1e-15);
        assert_eq!((metrics[0].worst_run, metrics[0].worst_time), (1, 0.7000000000000001));
        let labels: Vec<f64> = runs.iter().flat_map(|run| run.outputs.iter().step_by(2)).copied().collect();
        let mean = labels.iter().sum::<f64>() / 42.0;
        let total: f64 = labels.iter().map(|label| (label - mean).powi(2)).sum();
        assert!((metrics[0].r2.unwrap() - (1.0 - 0.0625 / total)).abs() < 1e-14);
        assert_eq!((metrics[1].r2, metrics[1].mse), (Some(1.0), 0.0));
    }

    #[test]
    fn rows_are_measured_as_runs_of_one_row_are() {
        let surrogate = example::surrogate();
        let mut evaluator = Evaluator::new(&surrogate);
        let points: Rows = (0..9).map(|i| [0.1 + 0.01 * f64::from(i), 3.0, 0.2 * f64::from(i)]).collect();
        let mut labels: Rows = (points.iter())
            .map(|point| {
                let mut outputs = vec![0.0; 2];
                evaluator.evaluate(point, &mut outputs);
                outputs
            })
            .collect();
        labels[4][1] -= 0.5;
        let accuracy = Accuracy::of_rows(&surrogate, TestRows::Given, &points, &labels);
        assert_eq!((accuracy.test_runs, accuracy.test_rows, accuracy.rows), (9, 9, Some(TestRows::Given)));
        assert_eq!((accuracy.outputs[0].mse, accuracy.outputs[0].r2), (0.0, Some(1.0)));
        let off = &accuracy.outputs[1];
        assert!((off.mse - 0.25 / 9.0).abs() < 1e-15 && (off.max_abs_error - 0.5).abs() < 1e-15, "{off:?}");
        assert_eq!(off.worst_run, 4);
        let mean = labels.column(1).sum::<f64>() / 9.0;
        let total: f64 = labels.column(1).map(|label| (label - mean).powi(2)).sum();
        assert!((off.r2.unwrap() - (1.0 - 0.25 / total)).abs() < 1e-14, "{off:?}");
    }

    /// Test runs of [`example::recorded`], whose outputs are off by `error` where they are predicted: one from rest, one with two rows
    /// before its start.
    fn sampled(error: f64) -> (Surrogate, Dataset) {
        let surrogate = example::recorded();
        let evaluator = Evaluator::new(&surrogate);
        let run = |before: usize| {
            let times: Arc<[f64]> = (0..12 + before).map(|row| 0.1 * (row as f64 - before as f64)).collect();
            let inputs = (0..times.len()).map(|row| (row as f64).sin()).collect();
            let mut run = Run { inputs, parameters: vec![1.5, 0.4, 0.25], times, outputs: Vec::new() };
            run.outputs = predict(&surrogate, &evaluator, &run);
            let first = first_predicted(&surrogate, &run);
            run.outputs[first..].iter_mut().for_each(|output| *output += error);
            run
        };
        let runs = vec![run(0), run(2)];
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let parameters = ["mass", "position_start", "force_start"].map(variable).to_vec();
        let (inputs, outputs) = (vec![variable("force")], vec![variable("position")]);
        (surrogate, Dataset { inputs, parameters, outputs, runs })
    }

    #[test]
    fn rows_that_are_given_are_no_part_of_the_accuracy() {
        let (surrogate, test) = sampled(0.0);
        let rows = [1, 2].map(|run: usize| first_predicted(&surrogate, &test.runs[run - 1]));
        assert_eq!(rows, [1, 2], "the start of a run from rest is given; that of one with rows before it is predicted");
        // what is given may be anything
        let mut found = predict_all(&surrogate, &test);
        found.iter_mut().zip(rows).for_each(|(found, rows)| found[..rows].fill(1e6));
        let accuracy = Accuracy::from_predictions(&surrogate, &test, &found);
        assert_eq!((accuracy.test_rows, accuracy.given_rows), (11 + 12, 1 + 2));
        assert_eq!((accuracy.outputs[0].r2, accuracy.outputs[0].mse), (Some(1.0), 0.0));
        // a wrong prediction of the first predicted row counts in full
        found[1][2] += 0.5;
        let accuracy = Accuracy::from_predictions(&surrogate, &test, &found);
        assert!((accuracy.outputs[0].mse - 0.25 / 23.0).abs() < 1e-12, "{accuracy:?}");
        assert_eq!(accuracy.outputs[0].worst_time, 0.0);
        let roll_outs = accuracy.roll_outs.unwrap();
        assert!(roll_outs.horizons.iter().all(|horizon| horizon.seconds > 0.0 && horizon.q90 > 0.0), "{roll_outs:?}");
    }

    #[test]
    fn a_truth_that_varies_by_rounding_only_has_no_r2_and_is_measured_by_its_range_in_training() {
        let (surrogate, mut test) = sampled(0.0);
        let range = surrogate.outputs()[0].max - surrogate.outputs()[0].min;
        for run in &mut test.runs {
            run.outputs.iter_mut().enumerate().for_each(|(row, y)| *y = 0.3 * (1.0 + f64::EPSILON * (row % 3) as f64));
        }
        let found: Vec<Vec<f64>> = test.runs.iter().map(|run| vec![0.3 + 0.1 * range; run.times.len()]).collect();
        let accuracy = Accuracy::from_predictions(&surrogate, &test, &found);
        assert_eq!(accuracy.outputs[0].r2, None);
        assert!((accuracy.outputs[0].relative_error() - 0.1).abs() < 1e-9, "{accuracy:?}");
        for Horizon { median, q90, .. } in accuracy.roll_outs.unwrap().horizons {
            assert!((median - 0.1).abs() < 1e-9 && (q90 - 0.1).abs() < 1e-9, "{median} {q90}");
        }
        // a small motion far from zero is one where it is all that the training has
        assert!(
            varies(&[1e6, 1e6 + 1e-6], 2e-6) && !varies(&[1e6, 1e6 + 1e-6], 1e5) && !varies(&[1e6, 1e6 + 1e-9], 0.0)
        );
        // rounding of a standstill among runs that move
        test.runs[1].outputs[5] += range;
        assert!(Accuracy::from_predictions(&surrogate, &test, &found).outputs[0].r2.is_some());
    }

    #[test]
    fn predictions_that_are_no_numbers_are_the_worst_and_figures_read_back() {
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let run = Run { inputs: Vec::new(), parameters: vec![0.0], times: [0.0, 1.0].into(), outputs: vec![1.0, 2.0] };
        let test = Dataset {
            inputs: Vec::new(),
            parameters: vec![variable("p")],
            outputs: vec![variable("y")],
            runs: vec![run],
        };
        for wrong in [f64::NAN, f64::INFINITY, 1e200] {
            let metrics = compare(&test, &[vec![1.0, wrong]], None).remove(0);
            assert_eq!((metrics.r2, metrics.mse), (Some(f64::MIN), f64::MAX));
            assert!(metrics.max_abs_error >= 1e200 && metrics.worst_time == 1.0, "{metrics:?}");
            let text = serde_json::to_string(&metrics).unwrap();
            assert!(!text.contains("null"), "{text}");
            assert_eq!(serde_json::from_str::<OutputMetrics>(&text).unwrap(), metrics);
        }
    }
}
