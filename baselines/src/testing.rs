//! Rows and closed forms for the tests of all baselines.

use crate::{Fitted, StandardizedRows};
use metafmu_runtime::{Scaling, graph::Step};
use nalgebra::{DMatrix, DVector};

/// Two parameters, the time, two outputs that are smooth and not linear.
pub fn wavy_rows(count: usize) -> StandardizedRows {
    let (mut state, mut x, mut y) = (1u64, Vec::new(), Vec::new());
    // Knuth's linear congruential generator
    let mut uniform = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    for _ in 0..count / 10 {
        let (p, q) = (uniform(), 3.0 + uniform());
        for i in 0..10 {
            let t = f64::from(i) * 0.1 + 0.05 * uniform();
            x.extend([p, q, t]);
            y.extend([2.0 + (3.0 * t + p).sin() * q, q * q - 0.5 * t + p * t]);
        }
    }
    let (input_mean, input_scale) = moments(&x, 3);
    let (output_mean, output_scale) = moments(&y, 2);
    StandardizedRows::new(x, y, Scaling { input_mean, input_scale, output_mean, output_scale })
}

/// Mean and standard deviation of each column.
fn moments(values: &[f64], width: usize) -> (Vec<f64>, Vec<f64>) {
    let of = |column: usize| {
        let column: Vec<f64> = values.iter().skip(column).step_by(width).copied().collect();
        let mean = column.iter().sum::<f64>() / column.len() as f64;
        (mean, (column.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / column.len() as f64).sqrt())
    };
    (0..width).map(of).unzip()
}

/// Intercept and weights of an output by `(X^T X / rows + alpha I) w = X^T y / rows`, the intercept not penalized.
pub fn least_squares(rows: &StandardizedRows, output: usize, alpha: f64) -> Vec<f64> {
    let count = rows.len() as f64;
    let x = DMatrix::from_fn(rows.len(), rows.inputs + 1, |row, column| match column {
        0 => 1.0,
        _ => rows.x[row * rows.inputs + column - 1],
    });
    let mut matrix = x.tr_mul(&x) / count;
    (1..=rows.inputs).for_each(|column| matrix[(column, column)] += alpha);
    let right = x.tr_mul(&DVector::from_vec(rows.output(output))) / count;
    matrix.lu().solve(&right).unwrap().as_slice().to_vec()
}

/// Standardized outputs of a formula at a row.
pub fn formula_at(fitted: &Fitted, rows: &StandardizedRows, row: usize) -> Vec<f64> {
    let Fitted::Formula(graph) = fitted else { panic!("no formula") };
    graph.check(rows.inputs, rows.outputs).unwrap();
    let scaling = &rows.scaling;
    let x: Vec<f64> = (0..rows.inputs)
        .map(|i| scaling.input_mean[i] + scaling.input_scale[i] * rows.x[row * rows.inputs + i])
        .collect();
    let y = graph.evaluate([x])[0].to_vec();
    y.iter().enumerate().map(|(o, y)| (y - scaling.output_mean[o]) / scaling.output_scale[o]).collect()
}

/// Intercept and weights of a linear formula, of standardized rows.
pub fn formula_weights(fitted: &Fitted, rows: &StandardizedRows, output: usize) -> Vec<f64> {
    let Fitted::Formula(graph) = fitted else { panic!("no formula") };
    let Some(Step::Affine { weight, bias, .. }) = graph.steps.last() else { panic!("not linear") };
    let Scaling { input_scale, output_mean, output_scale, .. } = &rows.scaling;
    let intercept = (bias.get(output) - output_mean[output]) / output_scale[output];
    let weights = input_scale.iter().enumerate().map(|(input, scale)| weight.get(output * rows.inputs + input) * scale);
    [intercept].into_iter().chain(weights.map(|weight| weight / output_scale[output])).collect()
}

/// Coefficient of determination of an output on the rows.
pub fn r2(fitted: &Fitted, rows: &StandardizedRows, output: usize) -> f64 {
    let y = rows.output(output);
    let mean = y.iter().sum::<f64>() / y.len() as f64;
    let predicted: Vec<f64> = match fitted {
        Fitted::Formula(_) => (0..rows.len()).map(|row| formula_at(fitted, rows, row)[output]).collect(),
        Fitted::Library(model) => {
            let all = (model.predict)(&rows.x).unwrap();
            all.iter().skip(output).step_by(rows.outputs).copied().collect()
        }
    };
    let residual: f64 = y.iter().zip(&predicted).map(|(y, p)| (y - p).powi(2)).sum();
    1.0 - residual / y.iter().map(|y| (y - mean).powi(2)).sum::<f64>()
}
