//! Scaling and weights of a network.

use super::{Part, array, push, real};
use metafmu_runtime::{Activation, Encoder, Encoding, Input, Layer, Numbers, ScaledNetwork, Scaling, Surrogate};

/// Rows of a layer that are computed together; `BLOCK` of the C code. As many doubles as two AVX-512 registers hold.
pub(super) const BLOCK: usize = 16;

/// The same among the sizes of a model.
pub(super) const BLOCK_SIZE: (&str, usize, &str) = ("BLOCK", BLOCK, "rows of a layer that are computed together");

/// External names of the activations.
pub(super) const ACTIVATIONS: [&str; 3] = ["activate", "activate_series", "real_activate"];

const NAMES: [&str; 7] = [
    "model_hidden",
    "model_hidden_count",
    "model_input_scaling",
    "model_last_bias",
    "model_last_weights",
    "model_output_scaling",
    "model_turns",
];

pub fn part(surrogate: &Surrogate, network: &ScaledNetwork) -> Part {
    let (last, hidden) = split(network);
    let slopes: Vec<usize> = hidden.iter().map(|layer| padded(layer.outputs)).collect();
    let features = Encoder::of(surrogate.inputs()).width();
    let width = slopes.iter().copied().fold(padded(features), usize::max);
    Part {
        names: [&ACTIVATIONS[..], &NAMES].concat(),
        sizes: vec![
            ("FEATURE_COUNT", features, "columns of the network"),
            BLOCK_SIZE,
            ("WIDTH", width, "of the widest layer, in whole blocks"),
            ("SLOPE_COUNT", slopes.iter().sum::<usize>().max(1), "of all hidden layers, in whole blocks"),
            ("LAST_COLUMNS", padded(last.inputs), "of the last layer, in whole blocks"),
        ],
        remark: String::new(),
        data: turns(surrogate.inputs()) + &data(network),
    }
}

/// Where periodic inputs begin, and how long a period is.
fn turns(inputs: &[Input]) -> String {
    let mut text = String::from("\nconst Turn model_turns[COLUMN_COUNT] = {\n");
    for Input { min, max, encoding, .. } in inputs {
        let [start, period] = if *encoding == Encoding::Periodic { [*min, max - min] } else { [0.0; 2] };
        push(&mut text, format_args!("    {{{}, {}}},\n", real(start), real(period)));
    }
    text.push_str("};\n");
    text
}

fn data(network: &ScaledNetwork) -> String {
    let mut text = String::new();
    let Scaling { input_mean, input_scale, output_mean, output_scale } = &network.scaling;
    for (declaration, means, scales) in [
        ("model_input_scaling[FEATURE_COUNT]", input_mean, input_scale),
        ("model_output_scaling[OUTPUT_COUNT]", output_mean, output_scale),
    ] {
        push(&mut text, format_args!("\nconst Scaling {declaration} = {{\n"));
        for (mean, scale) in means.iter().zip(scales) {
            push(&mut text, format_args!("    {{{}, {}}},\n", real(*mean), real(*scale)));
        }
        text.push_str("};\n");
    }
    let (last, hidden) = split(network);
    for (index, layer) in hidden.iter().enumerate() {
        array(&mut text, &format!("static const double weights_{index}"), &in_blocks(layer));
        array(&mut text, &format!("static const double bias_{index}"), &padded_to_block(&layer.bias));
    }
    push(
        &mut text,
        format_args!("\nconst size_t model_hidden_count = {};\nconst Layer model_hidden[] = {{\n", hidden.len()),
    );
    for (index, layer) in hidden.iter().enumerate() {
        let blocks = layer.outputs.div_ceil(BLOCK);
        let (inputs, activation) = (layer.inputs, activation(layer.activation));
        push(&mut text, format_args!("    {{{inputs}, {blocks}, weights_{index}, bias_{index}, {activation}}},\n"));
    }
    if hidden.is_empty() {
        text.push_str("    {0, 0, NULL, NULL, ACTIVATION_IDENTITY}, /* C has no empty arrays */\n");
    }
    text.push_str("};\n");
    array(&mut text, "const double model_last_weights", &in_rows(last));
    array(&mut text, "const double model_last_bias", &last.bias.iter().map(flushed).collect::<Vec<_>>());
    text
}

pub(super) fn activation(activation: Activation) -> &'static str {
    match activation {
        Activation::Tanh => "ACTIVATION_TANH",
        Activation::Sigmoid => "ACTIVATION_SIGMOID",
        Activation::Relu => "ACTIVATION_RELU",
        Activation::Gelu => "ACTIVATION_GELU",
        Activation::Silu => "ACTIVATION_SILU",
        Activation::Sine => "ACTIVATION_SINE",
        Activation::Identity => "ACTIVATION_IDENTITY",
    }
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

/// As the evaluator has it: without weights so small that products with them would be denormal.
fn flushed(value: f64) -> f64 {
    if value.abs() < 1e-100 { 0.0 } else { value }
}

pub(super) fn padded(count: usize) -> usize {
    count.next_multiple_of(BLOCK)
}
