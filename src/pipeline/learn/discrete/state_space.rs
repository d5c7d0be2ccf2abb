//! Nonlinear state spaces with hidden states, fitted to whole simulations.
//!
//! ```text
//! x[k+1] = x[k] + L z[k] + c + G tanh(W z[k] + b),    z = (x, u, p),    x = (y, h)
//! ```
//!
//! Outputs, inputs and parameters are standardized. The squares of the errors of all simulated outputs, with a penalty of all coefficients, are
//! minimized by the method of Levenberg and Marquardt (Nocedal, Wright (2006), section 10.3), with exact sensitivities of the simulations. A
//! training begins with an ARX model, of which this is the observer form, and random nodes without an effect.

mod fit;

use super::{DiscreteSamples, LearnedDiscrete, solve, standardised};
use crate::{
    Error, Result,
    dataset::Run,
    pipeline::{observer::Event, project::Project},
    training::StopReason,
};
use fit::{Data, STRETCHES, Shape, Signals};
use metafmu_runtime::{Activation, Graph, Layer, ScaledNetwork, Scaling};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::sync::atomic::Ordering;

/// Trainings, in this order: numbers of past samples of the ARX model, of nodes, and the penalty for each error.
const ORDERS: [usize; 3] = [1, 2, 3];
const NODES: [usize; 2] = [6, 12];
const PENALTIES: [f64; 3] = [1e-5, 1e-3, 3e-2];
const SEEDS: u64 = 4;
/// Multiplications of all trainings, about ten seconds on two cores. No training begins, or goes on, after them.
const BUDGET: f64 = 1e11;

/// The best of all trainings in simulations of the held-out runs; none if no start simulates the training runs.
///
/// # Errors
/// [`Error::Interrupted`] if no training was begun.
pub(super) fn learn(project: &Project, samples: &DiscreteSamples) -> Result<Vec<LearnedDiscrete>> {
    let [training, validation] =
        [&samples.training, &samples.validation].map(|runs| runs.iter().map(|run| Signals::of(samples, run)).collect());
    let data = Data { training, validation };
    let mut best: Option<(f64, Shape, Vec<f64>)> = None;
    let mut left = BUDGET;
    let stop = project.control().stop;
    let options = (0..SEEDS).flat_map(|seed| {
        PENALTIES.into_iter().flat_map(move |penalty| {
            NODES.into_iter().flat_map(move |nodes| ORDERS.map(|order| (seed, penalty, nodes, order)))
        })
    });
    for (place, (seed, penalty, nodes, order)) in options.enumerate() {
        if left <= 0.0 || stop.load(Ordering::Relaxed) {
            break;
        }
        let shape = Shape {
            states: order * samples.counts[2],
            outputs: samples.counts[2],
            columns: order * samples.counts[2] + samples.counts[1] + samples.counts[0],
            nodes,
        };
        let stretches = if seed % 2 == 0 { &STRETCHES[STRETCHES.len() - 1..] } else { &STRETCHES };
        let seed = project.study.seed.wrapping_add(seed << 32).wrapping_add(place as u64);
        let Some(start) = start(samples, &data, shape, seed) else { continue };
        let found = data.train(shape, start, penalty, stretches, &mut left, &|| stop.load(Ordering::Relaxed));
        let is_better = |(error, ..): &(f64, Shape, Vec<f64>)| found.0 < *error;
        if best.as_ref().is_none_or(is_better) && found.0.is_finite() {
            best = Some((found.0, shape, found.1));
        }
    }
    let stopped = if stop.load(Ordering::Relaxed) { StopReason::Interrupted } else { StopReason::Solved };
    match best {
        None if stopped == StopReason::Interrupted => Err(Error::Interrupted),
        None => Ok(Vec::new()),
        Some((error, shape, coefficients)) => {
            // a Ctrl-C is used up: what follows is quick and uses the best model
            stop.store(false, Ordering::Relaxed);
            project.event(Event::Note(format_args!(
                "state space: {} hidden states, {} nodes, error {error:.2e} in simulations of held-out runs",
                shape.hidden(),
                shape.nodes
            )));
            let (graph, hidden) = exported(samples, shape, &coefficients);
            Ok(vec![LearnedDiscrete { hidden, stopped, ..LearnedDiscrete::solved(graph, [1, 1]) }])
        }
    }
}

impl Signals {
    fn of(samples: &DiscreteSamples, run: &Run) -> Self {
        let [of_parameters, of_inputs, of_outputs] = &samples.scales;
        let [parameters, inputs, outputs] = samples.counts;
        let p: Vec<f64> = standardised(&run.parameters[..parameters], of_parameters).collect();
        let rows = 0..run.times.len();
        let columns = |row: usize| {
            let u = standardised(&run.inputs[row * inputs..][..inputs], of_inputs);
            u.chain(p.iter().copied()).collect::<Vec<f64>>()
        };
        Self {
            outputs: rows
                .clone()
                .flat_map(|row| standardised(&run.outputs[row * outputs..][..outputs], of_outputs))
                .collect(),
            inputs: rows.flat_map(columns).collect(),
            given: run.times.partition_point(|time| *time < 0.0).max(1),
        }
    }
}

/// The ARX model of an order in observer form, with hidden states of unit variance, and random nodes without an effect; none if it is not
/// determined or its simulations diverge.
fn start(samples: &DiscreteSamples, data: &Data, shape: Shape, seed: u64) -> Option<Vec<f64>> {
    let [parameters, inputs, outputs] = samples.counts;
    let Shape { states, columns, nodes, .. } = shape;
    let order = states / outputs;
    let arx = solve(&samples.regressors(&samples.training, [order; 2]))?;
    let [linear, constant, _, first, bias, _] = shape.places();
    let mut coefficients = vec![0.0; shape.coefficients()];
    for lag in 0..order {
        for output in 0..outputs {
            let state = lag * outputs + output;
            let row = &mut coefficients[linear.start + state * columns..][..columns];
            for other in 0..outputs {
                row[other] += arx[(lag * outputs + other, output)];
            }
            for input in 0..inputs {
                row[states + input] = arx[(order * outputs + lag * inputs + input, output)];
            }
            // what is constant in a run acts once
            for parameter in (0..parameters).filter(|_| lag == 0) {
                row[states + inputs + parameter] = arx[(order * (outputs + inputs) + parameter, output)];
            }
            if lag + 1 < order {
                row[state + outputs] += 1.0;
            }
            row[state] -= 1.0;
        }
    }
    (0..outputs).for_each(|output| coefficients[constant.start + output] = arx[(arx.nrows() - 1, output)]);
    let deviations = data.deviations(shape, &coefficients)?;
    for hidden in outputs..states {
        let scale = deviations[hidden].max(1e-6);
        coefficients[linear.start + hidden * columns..][..columns].iter_mut().for_each(|weight| *weight /= scale);
        coefficients[constant.start + hidden] /= scale;
        (0..states).for_each(|row| coefficients[linear.start + row * columns + hidden] *= scale);
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let spread = (columns as f64).sqrt();
    // a sum of uniform numbers is nearly normal, on every platform the same
    let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
    coefficients[first].iter_mut().for_each(|weight| *weight = normal() / spread);
    coefficients[bias].iter_mut().for_each(|bias| *bias = 0.5 * normal());
    debug_assert_eq!(nodes * columns, shape.places()[3].len());
    Some(coefficients)
}

/// The next sample in the units of the table, and the hidden numbers at the start.
fn exported(samples: &DiscreteSamples, shape: Shape, coefficients: &[f64]) -> (Graph, Vec<f64>) {
    let Shape { states, outputs, columns, nodes } = shape;
    let [linear, constant, last, first, bias, hidden] = shape.places().map(|place| &coefficients[place]);
    let of = samples.scaling([1, 1]);
    let with_hidden =
        |values: &[f64], other: f64| [&values[..outputs], &vec![other; shape.hidden()], &values[outputs..]].concat();
    let (input_mean, input_scale) = (with_hidden(&of.input_mean, 0.0), with_hidden(&of.input_scale, 1.0));
    let (output_mean, output_scale) = (with_hidden(&of.output_mean, 0.0), with_hidden(&of.output_scale, 1.0));
    let (mut weights, mut constants) = (Vec::new(), Vec::new());
    for state in 0..states {
        let of_column = |column: usize| {
            let own = if column == state { 1.0 } else { 0.0 };
            output_scale[state] * (own + linear[state * columns + column]) / input_scale[column]
        };
        let row: Vec<f64> = (0..columns).map(of_column).collect();
        let at_means: f64 = row.iter().zip(&input_mean).map(|(weight, mean)| weight * mean).sum();
        constants.push(output_mean[state] + output_scale[state] * constant[state] - at_means);
        weights.extend(row);
    }
    let layer = |inputs: usize, outputs: usize, weight: &[f64], bias: Vec<f64>, activation| Layer {
        inputs,
        outputs,
        weight: weight.to_vec().into(),
        bias: bias.into(),
        activation,
    };
    let layers = vec![
        layer(columns, nodes, first, bias.to_vec(), Activation::Tanh),
        layer(nodes, states, last, vec![0.0; states], Activation::Identity),
    ];
    let scaling = Scaling { input_mean, input_scale, output_mean: vec![0.0; states], output_scale };
    let network = Graph::from(&ScaledNetwork { scaling, layers });
    (Graph::of_samples(columns, weights, constants, Some(network)), hidden.to_vec())
}
