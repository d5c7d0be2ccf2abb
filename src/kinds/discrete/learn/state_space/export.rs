//! A state space in the units of the table.

use crate::{
    discrete::{Features, Limits, SPAN, Simulated, StateShape, correct, overwriting},
    kinds::discrete::learn::{DiscreteSamples, LearnedDiscrete},
};
use metafmu_runtime::{Activation, Graph, Layer, ScaledNetwork, Scaling, graph::StateObserver};

/// The next sample, and the hidden states at the start. `gain` corrects the states by outputs that are given.
pub fn model(samples: &DiscreteSamples, shape: &StateShape, simulated: Simulated) -> LearnedDiscrete {
    let Simulated { coefficients, gain, limits } = simulated;
    let StateShape { states, outputs, columns, ref features, .. } = *shape;
    let [linear, constant, last, first, bias, start] = shape.places().map(|place| &coefficients[place]);
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
    let scales = output_scale.clone();
    let mut scaling = Scaling { input_mean, input_scale, output_mean: vec![0.0; states], output_scale };
    let function = match features {
        Features::Nodes(0) => None,
        Features::Nodes(nodes) => {
            let layer = |inputs: usize, outputs: usize, weight: &[f64], bias: Vec<f64>, activation| Layer {
                inputs,
                outputs,
                weight: weight.to_vec().into(),
                bias: bias.into(),
                activation,
            };
            let layers = vec![
                layer(columns, *nodes, first, bias.to_vec(), Activation::Tanh),
                layer(*nodes, states, last, vec![0.0; states], Activation::Identity),
            ];
            Some(Graph::from(&ScaledNetwork { scaling, layers }))
        }
        Features::Products(products) => {
            scaling.input_scale.iter_mut().for_each(|scale| *scale *= SPAN);
            Some(Graph::of_polynomial(&scaling, products.clone(), last))
        }
    };
    let ends = |ranges: &[[f64; 2]]| {
        let is_limited = ranges.iter().any(|range| *range != Limits::NONE);
        let in_units = |(state, range): (usize, &[f64; 2])| {
            range.map(|end| if end.is_finite() { output_mean[state] + scales[state] * end } else { end })
        };
        is_limited.then(|| ranges.iter().enumerate().map(in_units).collect::<Vec<_>>())
    };
    let (stops, measured) = (ends(&limits.states), ends(&limits.measured));
    if *gain == overwriting(shape) && measured.is_none() && start.is_empty() {
        let graph = Graph::of_samples(columns, weights, constants, function).limited(stops);
        return LearnedDiscrete::solved(graph, [1, 1]);
    }
    let in_units = |of: &[f64]| -> Vec<f64> {
        let one = |(place, value): (usize, &f64)| scales[place / outputs] * value / scales[place % outputs];
        of.iter().enumerate().map(one).collect()
    };
    // states at the start are a linear function of the first outputs: those for their means, and weights
    let (at_means, first) = match shape.common_start {
        Some(_) => {
            let mut states = start.to_vec();
            correct(&mut states, gain, limits, &vec![0.0; outputs]);
            (states, gain.to_vec())
        }
        None => {
            let (constants, of_outputs) = start.split_at(shape.hidden());
            let own = overwriting(shape)[..outputs * outputs].to_vec();
            ([&vec![0.0; outputs], constants].concat(), [&own, of_outputs].concat())
        }
    };
    let first = in_units(&first);
    let before = |(state, value): (usize, &f64)| {
        let of_means = first[state * outputs..].iter().zip(&output_mean[..outputs]);
        output_mean[state] + scales[state] * value - of_means.map(|(weight, mean)| weight * mean).sum::<f64>()
    };
    // the last number: nothing was predicted
    let hidden = at_means.iter().enumerate().map(before).chain([0.0]).collect();
    let observer = StateObserver { gain: in_units(gain), first, stops, measured };
    let graph = Graph::of_observer([states, outputs, columns], observer, (weights, constants), function);
    LearnedDiscrete { hidden, ..LearnedDiscrete::solved(graph, [1, 1]) }
}
