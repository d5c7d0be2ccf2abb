//! A state space in the units of the table.

use super::{
    super::{DiscreteSamples, LearnedDiscrete},
    features::{Features, SPAN},
    simulate::{Limits, Simulated, StateShape, overwriting},
};
use metafmu_runtime::{Activation, Graph, Layer, ScaledNetwork, Scaling, graph::Observer};

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
    let (first_outputs, hidden) = start.split_at(start.len() - shape.hidden());
    if *gain == overwriting(shape) && measured.is_none() {
        let graph = Graph::of_samples(columns, weights, constants, function).limited(stops);
        return LearnedDiscrete { hidden: hidden.to_vec(), ..LearnedDiscrete::solved(graph, [1, 1]) };
    }
    let in_units = |place: usize| scales[place / outputs] * gain[place] / scales[place % outputs];
    let observer = Observer { gain: (0..states * outputs).map(in_units).collect(), stops, measured };
    let graph = Graph::of_observer([states, outputs, columns], observer, (weights, constants), function);
    // a common start counts as a prediction; otherwise nothing was predicted
    let in_units = |(output, value): (usize, &f64)| output_mean[output] + scales[output] * value;
    let [predicted, begun] = match shape.common_start {
        Some(_) => [first_outputs.iter().enumerate().map(in_units).collect(), vec![1.0]],
        None => [vec![0.0; outputs], vec![0.0]],
    };
    let hidden = [&predicted, hidden, &begun].concat();
    LearnedDiscrete { hidden, ..LearnedDiscrete::solved(graph, [1, 1]) }
}
