//! Models that are linear in past outputs and inputs (ARX), by least squares: alone, or beside a network.

use super::{DiscreteSamples, LearnedDiscrete, Regressors};
use crate::{Result, study::Study};
use metafmu_runtime::{Graph, Layer, Rows, ScaledNetwork, Scaling};
use nalgebra::DMatrix;

/// Share of the sum of squares that keeps the coefficients of columns apart that are nearly the same, as those of fast sampling are.
const RIDGE: f64 = 1e-10;
/// Smallest weight of a network beside the linear part.
const LEAST_GAIN: f64 = 1e-6;

/// The model of `discrete.history` past samples.
pub(super) fn learn(samples: &DiscreteSamples, study: &Study) -> Result<LearnedDiscrete> {
    let part = LinearPart::of(samples, study, [samples.past(study.discrete.history); 2])?;
    Ok(LearnedDiscrete::solved(part.graph(samples, None), part.history))
}

/// Linear part of a model, by least squares.
pub(super) struct LinearPart {
    /// Number of past samples of the outputs and of the inputs that count.
    pub(super) history: [usize; 2],
    /// Regressors of the training runs.
    pub(super) seen: Regressors,
    /// Coefficients, and constants below them, shape `[columns + 1, outputs]`.
    pub(super) linear: DMatrix<f64>,
    /// Standard deviation of each output's residual.
    pub(super) gains: Vec<f64>,
}

impl LinearPart {
    /// Linear part with this number of past samples.
    pub(super) fn of(samples: &DiscreteSamples, study: &Study, history: [usize; 2]) -> Result<Self> {
        let seen = samples.regressors(&samples.training, history);
        let linear = solve(&seen).ok_or_else(|| {
            study.refusal("discrete", "the samples do not determine the linear part: more runs or a shorter history")
        })?;
        let gains = gains(&seen, &linear);
        Ok(Self { history, seen, linear, gains })
    }

    /// Next sample from those before, in the units of the table: the sum of the linear part and of the layers of a
    /// network, if there are any.
    pub(super) fn graph(&self, samples: &DiscreteSamples, network: Option<Vec<Layer>>) -> Graph {
        let Self { linear, gains, .. } = self;
        let scaling = samples.scaling(self.history);
        let (means, scales) = (&scaling.input_mean, &scaling.input_scale);
        let columns = means.len();
        let mut weights = Vec::new();
        let mut constants = Vec::new();
        for output in 0..samples.counts[2] {
            let (mean, scale) = (scaling.output_mean[output], scaling.output_scale[output]);
            let row: Vec<f64> =
                (0..scales.len()).map(|column| scale * linear[(column, output)] / scales[column]).collect();
            let at_means = mean + scale * linear[(scales.len(), output)];
            constants.push(at_means - row.iter().zip(means).map(|(weight, mean)| weight * mean).sum::<f64>());
            weights.extend(row);
        }
        let network = network.map(|layers| {
            let output_scale = scaling.output_scale.iter().zip(gains).map(|(scale, gain)| scale * gain).collect();
            let output_mean = vec![0.0; samples.counts[2]];
            Graph::from(&ScaledNetwork { scaling: Scaling { output_mean, output_scale, ..scaling }, layers })
        });
        Graph::of_samples(columns, weights, constants, network)
    }

    /// Residuals of the linear part for some regressors, in standard deviations.
    pub(super) fn rest(&self, regressors: &Regressors) -> Rows {
        let rows = rest(regressors, &self.linear);
        rows.map(|rest| rest.zip(&self.gains).map(|(rest, gain)| rest / gain).collect::<Vec<f64>>()).collect()
    }
}

/// Coefficients of least squares, and constants below them, shape `[columns + 1, outputs]`; none if they are not determined.
pub(super) fn solve(regressors: &Regressors) -> Option<DMatrix<f64>> {
    let Regressors { inputs, outputs, .. } = regressors;
    if inputs.is_empty() {
        return None;
    }
    let (rows, columns, functions) = (inputs.len(), inputs.width(), outputs.width());
    let ridge = (RIDGE * rows as f64).sqrt();
    let matrix = DMatrix::from_fn(rows + columns, columns + 1, |row, column| match row.checked_sub(rows) {
        None => inputs[row].get(column).copied().unwrap_or(1.0),
        Some(row) => f64::from(u8::from(row == column)) * ridge,
    });
    let mut sides =
        DMatrix::from_fn(rows + columns, functions, |row, output| if row < rows { outputs[row][output] } else { 0.0 });
    let decomposition = matrix.qr();
    decomposition.q_tr_mul(&mut sides);
    let sides = sides.rows(0, columns + 1).into_owned();
    let solution = decomposition.r().solve_upper_triangular(&sides)?;
    Some(solution).filter(|solution| solution.iter().all(|value| value.is_finite()))
}

/// Residuals of the linear part, row by row.
fn rest<'a>(
    regressors: &'a Regressors,
    linear: &'a DMatrix<f64>,
) -> impl Iterator<Item = impl Iterator<Item = f64> + 'a> + 'a {
    let rows = regressors.inputs.iter().zip(&regressors.outputs);
    rows.map(|(row, outputs)| {
        outputs.iter().zip(linear.column_iter()).map(|(output, weights)| {
            let products = row.iter().zip(&weights).map(|(value, weight)| value * weight);
            output - (products.sum::<f64>() + weights[row.len()])
        })
    })
}

/// Standard deviation of the residual of each output.
pub(super) fn gains(regressors: &Regressors, linear: &DMatrix<f64>) -> Vec<f64> {
    let mut squares = vec![0.0; linear.ncols()];
    for rest in rest(regressors, linear) {
        squares.iter_mut().zip(rest).for_each(|(square, rest)| *square += rest * rest);
    }
    let rows = regressors.inputs.len().max(1) as f64;
    squares.into_iter().map(|square| (square / rows).sqrt().max(LEAST_GAIN)).collect()
}
