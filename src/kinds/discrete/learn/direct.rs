//! Direct effects: outputs that follow from inputs at the same instant, as an acceleration follows from a force.
//!
//! ```text
//! y[k] = v[k] + D u[k]
//! ```
//!
//! Models are learned from `v`, which follows from past samples.

use super::{
    DiscreteSamples, Regressors,
    dead_time::{DeadTimes, LAGS, few},
    linear::{gains, solve},
    standardized,
};
use crate::dataset::{Dataset, Run};
use metafmu_runtime::Rows;
use nalgebra::DMatrix;
use std::borrow::Cow;

/// Error of an ARX model with the inputs at the next sample over that without, below which they act directly.
const CLEAR: f64 = 0.5;
/// Root mean square change of the effect from sample to sample, relative to the standard deviation of the output, above which a sample matters.
const LEAST: f64 = 0.02;

/// `D`, shape `[outputs, inputs]`; empty if no input acts directly.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DirectEffects(Vec<f64>);

impl DirectEffects {
    /// Effects with which an ARX model predicts the next sample clearly better than without. Inputs with a dead time have none.
    pub fn of(step: f64, late: &Dataset, dead_times: &DeadTimes) -> Self {
        let few = few(late);
        let samples = DiscreteSamples::new(step, &few, few.runs.iter().collect(), Vec::new());
        Self::of_samples(&samples, dead_times).unwrap_or(Self(Vec::new()))
    }

    fn of_samples(samples: &DiscreteSamples, dead_times: &DeadTimes) -> Option<Self> {
        let [_, inputs, outputs] = samples.counts;
        let past = samples.regressors(&samples.training, [LAGS.min(samples.known); 2]);
        let ahead = ahead(samples, &past);
        let all: Vec<usize> = (0..inputs).filter(|input| !dead_times.delays(*input)).collect();
        let FittedInputs { errors: with, effects } = FittedInputs::of(&past, &ahead, &all)?;
        let without = FittedInputs::of(&past, &ahead, &[])?.errors;
        if with.iter().zip(&without).all(|(with, without)| *with >= CLEAR * without) {
            return None;
        }
        let mut direct = vec![0.0; outputs * inputs];
        let [_, of_inputs, of_outputs] = &samples.scales;
        for (place, input) in all.iter().enumerate() {
            let others: Vec<usize> = all.iter().copied().filter(|other| other != input).collect();
            let without = FittedInputs::of(&past, &ahead, &others)?.errors;
            let change = change(samples, *input);
            for output in 0..outputs {
                let effect = effects[(place, output)];
                if with[output] < CLEAR * without[output] && effect.abs() * change > LEAST {
                    direct[output * inputs + input] = effect * of_outputs.scales[output] / of_inputs.scales[*input];
                }
            }
        }
        direct.iter().any(|effect| *effect != 0.0).then_some(Self(direct))
    }

    /// `D`, output by output.
    pub fn matrix(&self) -> &[f64] {
        &self.0
    }

    /// Runs without the effects.
    pub fn removed<'a>(&self, dataset: Cow<'a, Dataset>) -> Cow<'a, Dataset> {
        if self.0.is_empty() {
            return dataset;
        }
        let runs = dataset.runs.iter().map(|run| self.without(run, dataset.inputs.len())).collect();
        Cow::Owned(Dataset { runs, ..dataset.into_owned() })
    }

    /// Effect of a row of inputs on an output.
    pub fn effect(&self, row: &[f64], output: usize) -> f64 {
        let directs = self.0.iter().skip(output * row.len());
        directs.zip(row).map(|(direct, input)| direct * input).sum()
    }

    /// A run without the effects.
    pub fn without(&self, run: &Run, inputs: usize) -> Run {
        let mut run = run.clone();
        if self.0.is_empty() {
            return run;
        }
        let outputs = self.0.len() / inputs;
        // outputs before the start are those of the first row
        let starts = run.parameters.len() - inputs - outputs;
        let first = run.inputs[..inputs].to_vec();
        (0..outputs).for_each(|output| run.parameters[starts + output] -= self.effect(&first, output));
        for (row, values) in run.inputs.chunks(inputs).zip(run.outputs.chunks_mut(outputs)) {
            values.iter_mut().enumerate().for_each(|(output, value)| *value -= self.effect(row, output));
        }
        run
    }

    /// Description for people, `acceleration of force`; None if no input acts directly.
    pub fn describe(&self, dataset: &Dataset) -> Option<String> {
        let inputs = dataset.inputs.len();
        let acting = self.0.iter().enumerate().filter(|(_, effect)| **effect != 0.0);
        let name = |(place, _): (usize, &f64)| {
            format!("{} of {}", dataset.outputs[place / inputs].name, dataset.inputs[place % inputs].name)
        };
        let acting: Vec<String> = acting.map(name).collect();
        (!acting.is_empty()).then(|| acting.join(", "))
    }
}

/// Fit of an ARX model in which some inputs act at the next sample.
struct FittedInputs {
    /// Standard deviation of the residual of each output.
    errors: Vec<f64>,
    /// Effect of each of these inputs on each output.
    effects: DMatrix<f64>,
}

impl FittedInputs {
    /// `ahead`: the inputs at the next sample, of which those of `acting` count.
    fn of(past: &Regressors, ahead: &Rows, acting: &[usize]) -> Option<Self> {
        let acting_ahead = ahead.select(acting);
        let rows = past.inputs.iter().zip(&acting_ahead).map(|(past, acting)| [past, acting].concat());
        let regressors =
            Regressors { inputs: rows.collect(), outputs: past.outputs.clone(), lengths: past.lengths.clone() };
        let coefficients = solve(&regressors)?;
        let first = coefficients.nrows() - 1 - acting.len();
        let effects = coefficients.rows(first, acting.len()).into_owned();
        Some(Self { errors: gains(&regressors, &coefficients), effects })
    }
}

/// Standardized inputs at the sample that follows, of each row of regressors of the training runs.
fn ahead(samples: &DiscreteSamples, past: &Regressors) -> Rows {
    let mut ahead = Rows::default();
    for (run, length) in samples.training.iter().zip(&past.lengths) {
        for row in run.inputs.chunks(samples.counts[1]).skip(run.times.len() - length) {
            ahead.push(&standardized(row, &samples.scales[1]).collect::<Vec<f64>>());
        }
    }
    ahead
}

/// Root mean square change of a standardized input from sample to sample.
fn change(samples: &DiscreteSamples, input: usize) -> f64 {
    let (inputs, scale) = (samples.counts[1], samples.scales[1].scales[input]);
    let (mut squares, mut count) = (0.0, 0.0);
    for run in &samples.training {
        for row in 1..run.times.len() {
            squares += ((run.inputs[row * inputs + input] - run.inputs[(row - 1) * inputs + input]) / scale).powi(2);
            count += 1.0;
        }
    }
    f64::sqrt(squares / f64::max(count, 1.0))
}
