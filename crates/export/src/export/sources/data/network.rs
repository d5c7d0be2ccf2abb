//! Scaling and weights of networks.

use super::{array, divisor, enumerator, maps::MapPart, operations::Operations, real, table};
use metafmu_runtime::{Activation, Layer, Numbers, ScaledNetwork, Surrogate};

/// Rows of a layer that are computed together; `BLOCK` of the C code. As many doubles as two AVX-512 registers hold.
pub(super) const BLOCK: usize = 16;

/// Entry of `BLOCK` among the sizes of a model.
pub(super) const BLOCK_SIZE: (&str, usize, &str) = ("BLOCK", BLOCK, "rows of a layer that are computed together");

/// External names of the activations.
pub(super) const ACTIVATIONS: [&str; 3] = ["activate", "activate_series", "real_activate"];

/// One network or several, with layers of the same sizes.
pub fn map(surrogate: &Surrogate, networks: &[ScaledNetwork]) -> MapPart {
    let first = &networks[0];
    let (last, hidden) = split(first);
    let columns = first.scaling.input_mean.len();
    let slopes: usize = hidden.iter().map(|layer| padded(layer.outputs)).sum();
    let width = hidden.iter().map(|layer| padded(layer.outputs)).fold(padded(columns), usize::max);
    let rows = networks.iter().enumerate().map(|(index, network)| row(index, network));
    let mut data = networks.iter().enumerate().map(|(index, network)| numbers(index, network)).collect();
    table(&mut data, "const Network model_networks", rows, "");
    MapPart {
        header: "network.h",
        defines: Vec::new(),
        names: [&ACTIVATIONS[..], &["model_networks"]].concat(),
        sizes: vec![
            BLOCK_SIZE,
            ("WIDTH", width, "of the widest layer, in whole blocks"),
            ("SLOPE_COUNT", slopes.max(1), "of all hidden layers, in whole blocks"),
            ("LAST_COLUMNS", padded(last.inputs), "of the last layer, in whole blocks"),
        ],
        data,
        operations: operations(first, surrogate.outputs().len()),
        formula: "network.c have",
    }
}

/// Operations of an evaluation; the formula is in `network.c`.
fn operations(network: &ScaledNetwork, outputs: usize) -> Operations {
    let (last, hidden) = split(network);
    let products: usize = hidden.iter().map(|layer| 2 * layer.inputs * padded(layer.outputs)).sum();
    let active = network.layers.iter().filter(|layer| layer.activation != Activation::Identity);
    Operations {
        arithmetic: (2 * network.scaling.input_mean.len() + products + outputs * (2 * padded(last.inputs) + 18)) as f64,
        activations: active.map(|layer| padded(layer.outputs)).sum::<usize>() as f64,
        ..Operations::default()
    }
}

/// Sums of the magnitudes of the terms of each output, relative to its scale, nodes before the last layer being at most about one.
pub(super) fn sums(network: &ScaledNetwork) -> Vec<f64> {
    let (last, _) = split(network);
    (0..last.outputs)
        .map(|row| {
            let products = (0..last.inputs).map(|column| last.weight.get(row * last.inputs + column).abs());
            products.sum::<f64>() + last.bias.get(row).abs()
        })
        .collect()
}

/// Means and scales of columns.
pub(super) fn scalings(declaration: &str, means: &[f64], scales: &[f64]) -> String {
    let mut text = String::new();
    let rows = means.iter().zip(scales).map(|(mean, scale)| format!("{}, {}", real(*mean), divisor(*scale)));
    table(&mut text, declaration, rows, "");
    text
}

/// Scalings and layers of network `index`.
fn numbers(index: usize, network: &ScaledNetwork) -> String {
    let scaling = &network.scaling;
    let of_inputs = format!("static const Scaling input_scaling_{index}");
    let of_outputs = format!("static const Scaling output_scaling_{index}");
    let mut text = scalings(&of_inputs, &scaling.input_mean, &scaling.input_scale);
    text += &scalings(&of_outputs, &scaling.output_mean, &scaling.output_scale);
    let (last, hidden) = split(network);
    for (number, layer) in hidden.iter().enumerate() {
        array(&mut text, &format!("static const Real weights_{index}_{number}"), &in_blocks(layer));
        array(&mut text, &format!("static const Real bias_{index}_{number}"), &padded_to_block(&layer.bias));
    }
    let rows = hidden.iter().enumerate().map(|(number, layer)| {
        let (inputs, blocks, activation) = (layer.inputs, layer.outputs.div_ceil(BLOCK), activation(layer.activation));
        format!("{inputs}, {blocks}, weights_{index}_{number}, bias_{index}_{number}, {activation}")
    });
    table(&mut text, &format!("static const Layer hidden_{index}"), rows, "0, 0, NULL, NULL, ACTIVATION_IDENTITY");
    array(&mut text, &format!("static const Real last_weights_{index}"), &in_rows(last));
    let bias: Vec<f64> = last.bias.iter().map(flushed).collect();
    array(&mut text, &format!("static const Real last_bias_{index}"), &bias);
    text
}

/// The fields of network `index`.
fn row(index: usize, network: &ScaledNetwork) -> String {
    let (last, hidden) = split(network);
    let (count, activation) = (hidden.len(), activation(last.activation));
    format!(
        "input_scaling_{index}, output_scaling_{index}, {count}, hidden_{index}, last_weights_{index}, last_bias_{index}, \
         {activation}"
    )
}

/// Name of an activation's constant in `model_data.h`.
pub(super) fn activation(activation: Activation) -> String {
    enumerator("ACTIVATION", activation)
}

/// The last layer and those before it; a network has at least one layer.
fn split(ScaledNetwork { layers, .. }: &ScaledNetwork) -> (&Layer, &[Layer]) {
    (&layers[layers.len() - 1], &layers[..layers.len() - 1])
}

/// `weights[(block * inputs + column) * BLOCK + row]`
pub(super) fn in_blocks(layer: &Layer) -> Vec<f64> {
    let mut weights = vec![0.0; padded(layer.outputs) * layer.inputs];
    for (index, value) in layer.weight.iter().enumerate() {
        let (row, column) = (index / layer.inputs, index % layer.inputs);
        weights[(row / BLOCK * layer.inputs + column) * BLOCK + row % BLOCK] = flushed(value);
    }
    weights
}

/// Row by row, with the columns padded to whole blocks.
fn in_rows(layer: &Layer) -> Vec<f64> {
    let mut weights = vec![0.0; padded(layer.inputs) * layer.outputs];
    for (index, value) in layer.weight.iter().enumerate() {
        weights[index / layer.inputs * padded(layer.inputs) + index % layer.inputs] = flushed(value);
    }
    weights
}

pub(super) fn padded_to_block(numbers: &Numbers) -> Vec<f64> {
    let mut padded_values: Vec<f64> = numbers.iter().map(flushed).collect();
    padded_values.resize(padded(numbers.len()), 0.0);
    padded_values
}

/// Weight as the evaluator uses it: zero if products with it would be denormal.
fn flushed(value: f64) -> f64 {
    if value.abs() < 1e-100 { 0.0 } else { value }
}

pub(super) fn padded(count: usize) -> usize {
    count.next_multiple_of(BLOCK)
}
