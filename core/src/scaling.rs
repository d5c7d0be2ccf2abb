//! Standardization: columns of mean 0 and standard deviation 1, which is what a network learns best from.

use crate::{
    dataset::{Dataset, Run},
    diagnostics::{KeyProblem, Problems},
    layout::RowLayout,
    variable::SourceVariable,
};
use metafmu_runtime::Scaling;

/// Largest magnitude of a parameter or an output, and the inverse of its smallest spread. Squares of them, and of the
/// values that a network computes from them, are still finite.
pub const LARGEST: f64 = 1e100;

/// Problems of the outputs of runs: `outputs.NAME` with values for which neither scaling nor errors can be computed. An
/// output may have one value in all rows.
pub fn problems(dataset: &Dataset) -> Problems {
    let width = dataset.outputs.len();
    let mut ranges = vec![(f64::INFINITY, f64::NEG_INFINITY); width];
    for row in dataset.runs.iter().flat_map(|run| run.outputs.chunks(width)) {
        for ((min, max), &value) in ranges.iter_mut().zip(row) {
            (*min, *max) = (min.min(value), max.max(value));
        }
    }
    let problem = |(output, (min, max)): (&SourceVariable, (f64, f64))| {
        // a set may have no runs
        if min > max {
            return None;
        }
        let spread = max - min;
        let (size, least) = (min.abs().max(max.abs()), 1.0 / LARGEST);
        let expected = if size > LARGEST {
            format!("numbers up to {LARGEST:e}")
        } else if size > 0.0 && size < least || spread > 0.0 && spread < least {
            format!("a size and a spread above {least:e}")
        } else {
            return None;
        };
        let message = format!("from {min:e} to {max:e} in the runs, expected {expected}: choose another unit");
        Some(KeyProblem { key: format!("outputs.{}", output.name), message })
    };
    dataset.outputs.iter().zip(ranges).filter_map(problem).collect()
}

/// Means and standard deviations of the input and output columns over the rows of the runs. A constant column gets scale 1.
pub fn fit<'a>(dataset: &Dataset, layout: &RowLayout, runs: impl Iterator<Item = &'a Run> + Clone) -> Scaling {
    let mut input = Moments::new(layout.columns());
    let mut output = Moments::new(dataset.outputs.len());
    for run in runs.clone() {
        layout.for_each(run, |columns, outputs| {
            input.count(columns);
            output.count(outputs);
        });
    }
    input.center();
    output.center();
    for run in runs {
        layout.for_each(run, |columns, outputs| {
            input.spread(columns);
            output.spread(outputs);
        });
    }
    let ((input_mean, input_scale), (output_mean, output_scale)) = (input.finish(), output.finish());
    Scaling { input_mean, input_scale, output_mean, output_scale }
}

/// Mean and standard deviation of each column of rows, at least one; a constant column gets scale 1.
pub fn of_columns(rows: impl IntoIterator<Item: AsRef<[f64]>, IntoIter: Clone>) -> (Vec<f64>, Vec<f64>) {
    let rows = rows.into_iter();
    let mut moments = Moments::new(rows.clone().next().map_or(0, |row| row.as_ref().len()));
    rows.clone().for_each(|row| moments.count(row.as_ref()));
    moments.center();
    rows.for_each(|row| moments.spread(row.as_ref()));
    moments.finish()
}

/// Standardized rows, in single precision, one after the other.
pub fn standardize_rows(rows: impl IntoIterator<Item: AsRef<[f64]>>, means: &[f64], scales: &[f64]) -> Vec<f32> {
    let mut standardized = Vec::new();
    rows.into_iter().for_each(|row| standardized.extend(standardize_row(row.as_ref(), means, scales)));
    standardized
}

fn standardize_row(row: &[f64], means: &[f64], scales: &[f64]) -> impl Iterator<Item = f32> {
    row.iter().zip(means).zip(scales).map(|((value, mean), scale)| ((value - mean) / scale) as f32)
}

/// Standardized rows of the runs, in single precision: inputs of shape `[rows, input columns]`, outputs of shape
/// `[rows, outputs]`.
pub fn standardize<'a>(
    runs: impl Iterator<Item = &'a Run>,
    layout: &RowLayout,
    scaling: &Scaling,
) -> (Vec<f32>, Vec<f32>) {
    let (mut inputs, mut outputs) = (Vec::new(), Vec::new());
    for run in runs {
        layout.for_each(run, |columns, row| {
            inputs.extend(standardize_row(columns, &scaling.input_mean, &scaling.input_scale));
            outputs.extend(standardize_row(row, &scaling.output_mean, &scaling.output_scale));
        });
    }
    (inputs, outputs)
}

/// Two-pass mean and standard deviation per column: exact enough for columns whose mean is large beside their spread.
struct Moments {
    rows: f64,
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Moments {
    fn new(columns: usize) -> Self {
        Self { rows: 0.0, mean: vec![0.0; columns], squares: vec![0.0; columns] }
    }

    fn count(&mut self, row: &[f64]) {
        self.rows += 1.0;
        self.mean.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }

    fn center(&mut self) {
        let rows = self.rows.max(1.0);
        self.mean.iter_mut().for_each(|sum| *sum /= rows);
    }

    fn spread(&mut self, row: &[f64]) {
        let columns = self.squares.iter_mut().zip(&self.mean);
        columns.zip(row).for_each(|((squares, mean), value)| *squares += (value - mean).powi(2));
    }

    fn finish(self) -> (Vec<f64>, Vec<f64>) {
        let scale = |(squares, mean): (&f64, &f64)| {
            let deviation = (squares / self.rows.max(1.0)).sqrt();
            // the spread of a constant column is only the rounding of its mean
            if deviation > 1e-12 * mean.abs() { deviation } else { 1.0 }
        };
        let scales = self.squares.iter().zip(&self.mean).map(scale).collect();
        (self.mean, scales)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Encoder, Encoding};
    use std::sync::Arc;

    #[test]
    fn standardized_columns_have_mean_zero_and_deviation_one() {
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let run = |p: f64| Run {
            inputs: Vec::new(),
            parameters: vec![p],
            times: Arc::new([0.0, 0.5, 1.0, 1.5]),
            outputs: vec![1e6 + p, 3.0, 1e6 - p, 3.0, 1e6, 3.0, 1e6 + 2.0 * p, 3.0],
        };
        let outputs = vec![variable("u"), variable("constant")];
        let dataset =
            Dataset { inputs: Vec::new(), parameters: vec![variable("p")], outputs, runs: vec![run(1.0), run(2.0)] };
        let encoder = Encoder::new([(&Encoding::Plain, 1.0, 2.0)].into_iter());
        let layout = RowLayout::new(encoder.clone());
        let scaling = fit(&dataset, &layout, dataset.runs.iter());
        assert_eq!(scaling.output_scale[1], 1.0);
        let (inputs, outputs) = standardize(dataset.runs.iter(), &layout, &scaling);
        for (column, width, values) in [(0, 2, &inputs), (1, 2, &inputs), (0, 2, &outputs)] {
            let column: Vec<f64> = values.iter().skip(column).step_by(width).map(|&value| value.into()).collect();
            let mean = column.iter().sum::<f64>() / 8.0;
            let variance = column.iter().map(|value| value * value).sum::<f64>() / 8.0;
            assert!(mean.abs() < 1e-6 && (variance - 1.0).abs() < 1e-6, "{mean} {variance}");
        }
        // at one instant the time is not a column, and the first output of the two runs is 1e6 + p
        let scaling = fit(&dataset, &RowLayout::at(encoder.clone(), 0), dataset.runs.iter());
        assert_eq!((scaling.input_mean, scaling.input_scale), (vec![1.5], vec![0.5]));
        assert_eq!((&scaling.output_mean[..], &scaling.output_scale[..]), (&[1e6 + 1.5, 3.0][..], &[0.5, 1.0][..]));
        let scaling = fit(&dataset, &RowLayout::at(encoder.clone(), 2), dataset.runs.iter());
        assert_eq!(scaling.output_scale, [1.0, 1.0], "every run has the same outputs there");
        let (inputs, outputs) = standardize(dataset.runs.iter(), &RowLayout::at(encoder.clone(), 2), &scaling);
        assert_eq!((inputs, outputs), (vec![-1.0, 1.0], vec![0.0; 4]));
        // one-hot: half of the rows have the one value, half the other, none the third
        let encoder = Encoder::new([(&Encoding::Nominal(vec![2.0, 3.0, 1.0]), 1.0, 3.0)].into_iter());
        let scaling = fit(&dataset, &RowLayout::at(encoder.clone(), 0), dataset.runs.iter());
        assert_eq!((&scaling.input_mean[..], &scaling.input_scale[..]), (&[0.5, 0.0, 0.5][..], &[0.5, 1.0, 0.5][..]));
        let (inputs, _) = standardize(dataset.runs.iter(), &RowLayout::at(encoder.clone(), 0), &scaling);
        assert_eq!(inputs, [-1.0, 0.0, 1.0, 1.0, 0.0, -1.0]);
    }

    #[test]
    fn outputs_that_cannot_be_computed_with_are_named() {
        let dataset = |values: [f64; 3]| Dataset {
            inputs: Vec::new(),
            parameters: vec![SourceVariable::new("p", "", "")],
            outputs: vec![SourceVariable::new("y", "", ""), SourceVariable::new("z", "", "")],
            runs: values
                .map(|y| Run {
                    inputs: Vec::new(),
                    parameters: vec![1.0],
                    times: Arc::new([0.0]),
                    outputs: vec![y, 1.0],
                })
                .to_vec(),
        };
        for good in [[0.0; 3], [3.0; 3], [1e99, -1e99, 0.0], [1e-99, 2e-98, 1e-97]] {
            assert!(problems(&dataset(good)).is_empty(), "{good:?}");
        }
        assert!(problems(&Dataset { runs: Vec::new(), ..dataset([0.0; 3]) }).is_empty());
        for (wrong, says) in [
            ([1e155, 1.0, 0.0], "from 0e0 to 1e155 in the runs, expected numbers up to 1e100"),
            ([1e-200; 3], "from 1e-200 to 1e-200 in the runs, expected a size and a spread above 1e-100"),
            ([0.0, 1e-200, 2e-200], "expected a size and a spread above 1e-100: choose another unit"),
        ] {
            let found: Vec<KeyProblem> = problems(&dataset(wrong)).into_iter().collect();
            assert!(found.len() == 1 && found[0].key == "outputs.y" && found[0].message.contains(says), "{found:?}");
        }
    }
}
