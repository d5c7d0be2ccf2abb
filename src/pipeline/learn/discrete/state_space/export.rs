//! A state space in the units of the table.

use super::{
    super::{DiscreteSamples, LearnedDiscrete},
    features::{Features, SPAN},
    fit::{StateShape, overwriting},
};
use metafmu_runtime::{Activation, Graph, Layer, ScaledNetwork, Scaling};

/// The next sample, and the hidden states at the start. `gain` corrects the states by outputs that are given.
pub fn model(samples: &DiscreteSamples, shape: &StateShape, coefficients: &[f64], gain: &[f64]) -> LearnedDiscrete {
    let StateShape { states, outputs, columns, ref features } = *shape;
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
    if *gain == overwriting(shape) {
        let graph = Graph::of_samples(columns, weights, constants, function);
        return LearnedDiscrete { hidden: hidden.to_vec(), ..LearnedDiscrete::solved(graph, [1, 1]) };
    }
    let scales = &samples.scales[2].1;
    let correction = (0..columns * outputs).map(|place| {
        let (column, output) = (place / outputs, place % outputs);
        let own = if column == output { 1.0 } else { 0.0 };
        let scale = scales.get(column).copied().unwrap_or(1.0);
        gain.get(place).map_or(0.0, |gain| scale * (gain - own) / scales[output])
    });
    let graph = Graph::of_observer([states, outputs, columns], correction.collect(), (weights, constants), function);
    // at the start nothing was predicted
    let hidden = [hidden, &vec![0.0; outputs + 1]].concat();
    LearnedDiscrete { hidden, ..LearnedDiscrete::solved(graph, [1, 1]) }
}
