//! The numbers behind the figures: errors of a surrogate on test runs, gathered over time, over parameters and by size.
//!
//! Every function processes all test rows, however many there are, and returns a few numbers.

use super::axis::extent;
use crate::{
    dataset::{Dataset, Run},
    evaluation::{Accuracy, TestRows, first_predicted, predict_all},
    layout::InputPoint,
};
use metafmu_runtime::{Evaluator, Rows, Surrogate};
use rayon::prelude::*;

/// A surrogate and its predictions of the test runs.
#[derive(Debug)]
pub struct Evaluated<'a> {
    /// The surrogate.
    pub surrogate: &'a Surrogate,
    /// The runs, unseen in training.
    pub test: &'a Dataset,
    /// Predictions of all outputs of the surrogate for each run, shape `[times, columns]`.
    predictions: Vec<Vec<f64>>,
    /// Accuracy of each output.
    pub accuracy: Accuracy,
    /// Error of each run, see [`Evaluated::runs_by_error`].
    errors: Vec<f64>,
}

/// A row of a test run, of one output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TestRow {
    /// In seconds.
    pub time: f64,
    /// The source's value.
    pub label: f64,
    /// The surrogate's value.
    pub prediction: f64,
}

/// Errors gathered in bins of something.
#[derive(Clone, Debug, PartialEq)]
pub struct Binned {
    /// Middle of each bin that has rows.
    pub at: Vec<f64>,
    /// Root mean square error in each.
    pub rms: Vec<f64>,
    /// Largest error in each.
    pub largest: Vec<f64>,
    /// Share of the rows whose error is within the output's bound, if it has one.
    pub within: Vec<f64>,
}

/// Rows counted in the cells of a square over label and prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct Density {
    /// Both axes begin here.
    pub low: f64,
    /// Both axes end here.
    pub high: f64,
    /// Rows in each cell: shape `[CELLS, CELLS]`, by prediction, then by label.
    pub counts: Vec<u64>,
}

/// Errors counted in bins of equal width.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// The first bin begins at the negative of this, the last one ends here.
    pub reach: f64,
    /// Rows in each bin.
    pub counts: Vec<u64>,
}

/// Derivatives of an output with respect to the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivity {
    /// Instants.
    pub times: Vec<f64>,
    /// Mean magnitude of the derivative at each instant, times the parameter's range, for each parameter.
    pub over_time: Vec<Vec<f64>>,
    /// Mean over all instants, for each parameter.
    pub mean: Vec<f64>,
}

/// Cells of a [`Density`] in each direction.
pub const CELLS: usize = 60;
/// Largest number of bins over the time.
const TIME_BINS: usize = 200;
/// Bins over a parameter.
const PARAMETER_BINS: usize = 16;
/// Bins of a [`Histogram`].
const ERROR_BINS: usize = 61;
/// Largest number of runs, and of instants of each, at which derivatives are taken.
pub const SENSITIVITY_RUNS: usize = 100;
const SENSITIVITY_TIMES: usize = 60;

impl<'a> Evaluated<'a> {
    /// Predicts every test row.
    pub fn new(surrogate: &'a Surrogate, test: &'a Dataset) -> Self {
        let predictions = predict_all(surrogate, test);
        let accuracy = Accuracy::from_predictions(surrogate, test, &predictions);
        Self::of(surrogate, test, predictions, accuracy)
    }

    fn of(surrogate: &'a Surrogate, test: &'a Dataset, predictions: Vec<Vec<f64>>, accuracy: Accuracy) -> Self {
        let mut evaluated = Self { surrogate, test, predictions, accuracy, errors: Vec::new() };
        evaluated.errors = (0..test.runs.len()).into_par_iter().map(|run| evaluated.relative_error(run)).collect();
        evaluated
    }

    /// A static map and predictions of unseen rows, which are runs of a single row.
    pub fn of_rows(surrogate: &'a Surrogate, test: &'a Dataset, predictions: &Rows, kind: TestRows) -> Self {
        let labels: Rows = test.runs.iter().map(|run| &run.outputs).collect();
        let mut accuracy = Accuracy::of_row_predictions(surrogate, kind, predictions, &labels);
        // bounds were measured on these rows
        accuracy.outputs.values_mut().for_each(|metrics| metrics.within_bound = None);
        let predictions = predictions.iter().map(<[f64]>::to_vec).collect();
        Self::of(surrogate, test, predictions, accuracy)
    }

    /// Returns true if the test rows belong to no runs.
    pub fn is_of_rows(&self) -> bool {
        self.accuracy.rows.is_some()
    }

    /// Number of outputs.
    pub fn outputs(&self) -> usize {
        self.test.outputs.len()
    }

    /// Range of an output in training: errors of different outputs are compared relative to it.
    pub fn range(&self, output: usize) -> f64 {
        let output = &self.surrogate.outputs()[output];
        if output.max > output.min { output.max - output.min } else { 1.0 }
    }

    /// The predicted rows of a run, of one output.
    pub fn rows(&self, run: usize, output: usize) -> impl Iterator<Item = TestRow> {
        let Run { times, outputs, .. } = &self.test.runs[run];
        // standard deviations follow the predictions
        let predictions = self.predictions[run].iter().skip(output).step_by(self.surrogate.outputs().len());
        let labels = outputs.iter().skip(output).step_by(self.outputs());
        let rows = times.iter().zip(labels.copied()).zip(predictions.copied());
        rows.map(|((&time, label), prediction)| TestRow { time, label, prediction }).skip(self.first(run))
    }

    /// The first row of a run that is predicted.
    fn first(&self, run: usize) -> usize {
        first_predicted(self.surrogate, &self.test.runs[run])
    }

    /// Number of predicted rows of a run.
    pub fn run_rows(&self, run: usize) -> usize {
        self.test.runs[run].times.len() - self.first(run)
    }

    fn all_rows(&self, output: usize) -> impl Iterator<Item = TestRow> {
        (0..self.test.runs.len()).flat_map(move |run| self.rows(run, output))
    }

    /// Root mean square error of a run, of one output, in its unit.
    pub fn rms(&self, run: usize, output: usize) -> f64 {
        let (sum, count) =
            self.rows(run, output).fold((0.0, 0.0), |(sum, count), row| (sum + row.error().powi(2), count + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    }

    /// Root mean square over the outputs of a run's errors, each relative to the output's range.
    fn relative_error(&self, run: usize) -> f64 {
        let squares = (0..self.outputs()).map(|output| (self.rms(run, output) / self.range(output)).powi(2));
        (squares.sum::<f64>() / self.outputs() as f64).sqrt()
    }

    /// Error of each run relative to the outputs' ranges.
    pub fn run_errors(&self) -> &[f64] {
        &self.errors
    }

    /// The runs, those with the smallest errors first.
    pub fn runs_by_error(&self) -> Vec<usize> {
        let mut runs: Vec<usize> = (0..self.errors.len()).collect();
        runs.sort_by(|&a, &b| self.errors[a].total_cmp(&self.errors[b]));
        runs
    }

    /// Half the width of the error band around the prediction at some time of a run.
    pub fn bound(&self, output: usize, time: f64) -> Option<f64> {
        self.surrogate.bounds().map(|bounds| bounds.at(output, time))
    }

    /// Returns true if the truth of a row is in that band; none if there is no such band.
    pub fn is_within(&self, output: usize, row: &TestRow) -> Option<bool> {
        self.bound(output, row.time).map(|bound| row.error().abs() <= bound)
    }

    /// Errors in bins of the time.
    pub fn over_time(&self, output: usize) -> Binned {
        let stop =
            self.test.runs.iter().filter_map(|run| run.times.last()).fold(0.0, |stop: f64, &time| stop.max(time));
        let instants = (0..self.test.runs.len()).map(|run| self.run_rows(run)).max().unwrap_or(1).max(1);
        let bins = instants.min(TIME_BINS);
        // bins are centred on instants where there are as many
        let width = stop / (bins.max(2) - 1) as f64;
        let rows = self.all_rows(output).map(|row| (row.time, row));
        gather(rows, -0.5 * width, stop + 0.5 * width, bins, |row| self.is_within(output, row)).limited(0.0, stop)
    }

    /// Errors in bins of a parameter.
    pub fn over_parameter(&self, output: usize, parameter: usize) -> Binned {
        let input = &self.surrogate.inputs()[parameter];
        let runs = 0..self.test.runs.len();
        let rows = runs
            .flat_map(|run| self.rows(run, output).map(move |row| (self.test.runs[run].parameters[parameter], row)));
        gather(rows, input.min, input.max, PARAMETER_BINS, |row| self.is_within(output, row))
    }

    /// Labels against predictions.
    pub fn density(&self, output: usize) -> Density {
        let (low, high) =
            extent(self.all_rows(output).flat_map(|row| [row.label, row.prediction])).unwrap_or((0.0, 1.0));
        let (low, high) = if high > low { (low, high) } else { (low - 0.5, high + 0.5) };
        let mut counts = vec![0; CELLS * CELLS];
        for row in self.all_rows(output) {
            counts[bin(row.prediction, low, high, CELLS) * CELLS + bin(row.label, low, high, CELLS)] += 1;
        }
        Density { low, high, counts }
    }

    /// Errors by size.
    pub fn histogram(&self, output: usize) -> Histogram {
        let reach = self.all_rows(output).fold(0.0, |reach: f64, row| reach.max(row.error().abs()));
        let reach = if reach > 0.0 { reach } else { 1.0 };
        let mut counts = vec![0; ERROR_BINS];
        self.all_rows(output).for_each(|row| counts[bin(row.error(), -reach, reach, ERROR_BINS)] += 1);
        Histogram { reach, counts }
    }

    /// Exact derivatives of each output with respect to each parameter, at evenly chosen instants of evenly chosen runs.
    pub fn sensitivities(&self) -> Vec<Sensitivity> {
        let runs = evenly(self.test.runs.len(), SENSITIVITY_RUNS);
        let times = &self.test.runs[runs[0]].times;
        let instants: Vec<f64> = evenly(times.len(), SENSITIVITY_TIMES).iter().map(|&row| times[row]).collect();
        let evaluator = Evaluator::new(self.surrogate);
        let parameters = self.test.parameters.len();
        (0..self.outputs())
            .into_par_iter()
            .map(|output| {
                let mut evaluator = evaluator.clone();
                let (mut gradient, mut weights) =
                    (vec![0.0; self.surrogate.inputs().len()], vec![0.0; self.surrogate.outputs().len()]);
                weights[output] = 1.0;
                let mut over_time = vec![vec![0.0; instants.len()]; parameters];
                for &run in &runs {
                    let mut point = InputPoint::of(&self.test.runs[run], self.surrogate.time_column().is_some());
                    for (instant, &time) in instants.iter().enumerate() {
                        evaluator.adjoint(point.at(time), &weights, &mut gradient);
                        for (sums, derivative) in over_time.iter_mut().zip(&gradient) {
                            sums[instant] += derivative.abs();
                        }
                    }
                }
                for (sums, input) in over_time.iter_mut().zip(self.surrogate.inputs()) {
                    sums.iter_mut().for_each(|sum| *sum *= (input.max - input.min) / runs.len() as f64);
                }
                let mean = over_time.iter().map(|values| values.iter().sum::<f64>() / values.len() as f64).collect();
                Sensitivity { times: instants.clone(), over_time, mean }
            })
            .collect()
    }
}

impl TestRow {
    /// Prediction minus truth.
    pub fn error(&self) -> f64 {
        self.prediction - self.label
    }
}

impl Binned {
    /// Bins with the middles of the first and last one moved into a range.
    fn limited(mut self, low: f64, high: f64) -> Self {
        self.at.iter_mut().for_each(|at| *at = at.clamp(low, high));
        self
    }
}

/// At most `count` of the numbers below `length`, evenly spread, the first and the last among them.
pub fn evenly(length: usize, count: usize) -> Vec<usize> {
    if length <= count {
        return (0..length).collect();
    }
    (0..count).map(|i| i * (length - 1) / (count - 1).max(1)).collect()
}

fn bin(value: f64, low: f64, high: f64, bins: usize) -> usize {
    let place = (value - low) / (high - low) * bins as f64;
    // a float becomes the nearest integer there is: the lower end is the first bin's, the upper end the last one's
    (place as usize).min(bins - 1)
}

/// Errors of rows in bins, and the number within a bound, if there is one.
fn gather(
    rows: impl Iterator<Item = (f64, TestRow)>,
    low: f64,
    high: f64,
    bins: usize,
    is_within: impl Fn(&TestRow) -> Option<bool>,
) -> Binned {
    #[derive(Clone, Copy, Default)]
    struct Sums {
        count: f64,
        squares: f64,
        largest: f64,
        within: Option<f64>,
    }
    let mut sums = vec![Sums::default(); bins];
    for (at, row) in rows {
        let (sums, error) = (&mut sums[bin(at, low, high, bins)], row.error().abs());
        sums.count += 1.0;
        sums.squares += error * error;
        sums.largest = sums.largest.max(error);
        if let Some(is_within) = is_within(&row) {
            *sums.within.get_or_insert(0.0) += f64::from(u8::from(is_within));
        }
    }
    let width = (high - low) / bins as f64;
    let (mut binned, filled) =
        (Binned { at: vec![], rms: vec![], largest: vec![], within: vec![] }, |sums: &Sums| sums.count > 0.0);
    for (index, Sums { count, squares, largest, within }) in
        sums.into_iter().enumerate().filter(|(_, sums)| filled(sums))
    {
        binned.at.push(low + (index as f64 + 0.5) * width);
        binned.rms.push((squares / count).sqrt());
        binned.largest.push(largest);
        binned.within.extend(within.map(|within| within / count));
    }
    binned
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    #[test]
    fn errors_put_into_the_labels_are_found_where_they_are() {
        let (surrogate, mut test) = testing::exact();
        // output 0 of run 3 is off by 0.25 at its sixth instant
        let time = test.runs[3].times[5];
        test.runs[3].outputs[5 * 2] -= 0.25;
        let evaluated = Evaluated::new(&surrogate, &test);
        assert_eq!(evaluated.runs_by_error().last(), Some(&3));
        let (runs, instants) = (test.runs.len() as f64, test.runs[0].times.len() as f64);
        assert!((evaluated.rms(3, 0) - 0.25 / instants.sqrt()).abs() < 1e-12);

        let over_time = evaluated.over_time(0);
        assert_eq!(over_time.at.len(), test.runs[0].times.len());
        for (index, &at) in over_time.at.iter().enumerate() {
            let expected = if index == 5 { 0.25 } else { 0.0 };
            assert!((over_time.largest[index] - expected).abs() < 1e-12, "{at}");
            assert!((over_time.rms[index] - expected / runs.sqrt()).abs() < 1e-12, "{at}");
        }
        assert!((over_time.at[5] - time).abs() < 1e-9);

        let over_parameter = evaluated.over_parameter(0, 0);
        let worst = over_parameter.largest.iter().position(|&largest| largest > 0.2).unwrap();
        assert!(
            (over_parameter.at[worst] - test.runs[3].parameters[0]).abs() <= 0.5 * 0.1 / PARAMETER_BINS as f64 + 1e-12
        );
        assert_eq!(over_parameter.largest.iter().filter(|&&largest| largest > 0.0).count(), 1);

        let histogram = evaluated.histogram(0);
        assert_eq!(histogram.reach, 0.25);
        assert_eq!(
            (histogram.counts[ERROR_BINS - 1], histogram.counts[ERROR_BINS / 2]),
            (1, test.row_count() as u64 - 1)
        );

        let density = evaluated.density(0);
        let diagonal: u64 = (0..CELLS).map(|cell| density.counts[cell * CELLS + cell]).sum();
        assert_eq!(density.counts.iter().sum::<u64>(), test.row_count() as u64);
        assert!(diagonal >= test.row_count() as u64 - 1);
    }

    #[test]
    fn sensitivities_agree_with_finite_differences() {
        let (surrogate, test) = testing::exact();
        let evaluated = Evaluated::new(&surrogate, &test);
        let sensitivities = evaluated.sensitivities();
        let mut evaluator = Evaluator::new(&surrogate);
        for (parameter, input) in surrogate.inputs().iter().take(2).enumerate() {
            for (output, sensitivity) in sensitivities.iter().enumerate() {
                let instant = sensitivity.times.len() / 2;
                let mut sum = 0.0;
                for run in &test.runs {
                    let mut value = |offset: f64| {
                        let mut inputs = InputPoint::of(run, true).at(sensitivity.times[instant]).to_vec();
                        inputs[parameter] += offset;
                        let mut outputs = [0.0; 2];
                        evaluator.evaluate(&inputs, &mut outputs);
                        outputs[output]
                    };
                    sum += ((value(1e-5) - value(-1e-5)) / 2e-5).abs();
                }
                let expected = sum / test.runs.len() as f64 * (input.max - input.min);
                let found = sensitivity.over_time[parameter][instant];
                assert!((found - expected).abs() < 1e-6 * expected.max(1e-3), "{found} {expected}");
            }
        }
    }

    #[test]
    fn evenly_chosen_are_few_and_have_both_ends() {
        assert_eq!(evenly(3, 5), [0, 1, 2]);
        assert_eq!(evenly(14641, 5), [0, 3660, 7320, 10980, 14640]);
    }
}
