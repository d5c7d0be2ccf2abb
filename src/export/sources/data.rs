//! The generated files: sizes, names for the linker, and the surrogate's numbers.

use metafmu_runtime::{
    Activation, BuiltIn, Input, Layer, Metadata, Numbers, Quantity, Role, ScaledNetwork, Scaling, Surrogate,
    Variability, Variable,
};
use std::fmt::Write;

/// Rows of a layer that are computed together; `BLOCK` of the C code. As many doubles as two AVX-512 registers hold.
const BLOCK: usize = 16;

/// External names of the C code but the FMI functions.
const EXTERNAL_NAMES: &[&str] = &[
    "activate",
    "activate_series",
    "instance_accept_point",
    "instance_adjoint_derivative",
    "instance_begin",
    "instance_count_dependencies",
    "instance_dependency",
    "instance_deserialize",
    "instance_directional_derivative",
    "instance_do_step",
    "instance_enter_event_mode",
    "instance_enter_initialization_mode",
    "instance_exit_initialization_mode",
    "instance_get_boolean",
    "instance_get_integer",
    "instance_get_real",
    "instance_initialize",
    "instance_lacks",
    "instance_miscounts",
    "instance_no_variables",
    "instance_output_derivatives",
    "instance_reset",
    "instance_restore",
    "instance_save",
    "instance_serialize",
    "instance_set_boolean",
    "instance_set_input_derivatives",
    "instance_set_integer",
    "instance_set_real",
    "instance_set_solver_time",
    "instance_set_up_experiment",
    "instance_switch_logging",
    "instance_tell",
    "network_adjoint",
    "network_along_curve",
    "network_directional",
    "network_evaluate",
    "snapshot_size",
    "model_columns",
    "model_description",
    "model_hidden",
    "model_hidden_count",
    "model_last_bias",
    "model_last_weights",
    "model_outputs",
    "model_time_step",
    "model_token",
    "model_variables",
];

const NOTICE: &str = "/* Generated. */\n";

fn padded(count: usize) -> usize {
    count.next_multiple_of(BLOCK)
}

/// `model_data.h`
pub fn header(surrogate: &Surrogate, network: &ScaledNetwork, identifier: &str) -> String {
    let (last, hidden) = split(network);
    let hidden: Vec<usize> = hidden.iter().map(|layer| padded(layer.outputs)).collect();
    let columns = surrogate.inputs().len();
    let width = hidden.iter().copied().fold(padded(columns), usize::max);
    let policy = surrogate.variables().reference(Quantity::BuiltIn(BuiltIn::DomainPolicy));
    let mut text = format!(
        "{NOTICE}#ifndef MODEL_DATA_H\n#define MODEL_DATA_H\n\n\
         /* External names begin with the model identifier, so that several FMUs can be linked into one program. */\n"
    );
    for name in EXTERNAL_NAMES {
        push(&mut text, format_args!("#define {name} {identifier}_{name}\n"));
    }
    push(
        &mut text,
        format_args!(
            "\nenum {{\n    \
                 VARIABLE_COUNT = {variables},\n    \
                 POLICY_REFERENCE = {policy}, /* value reference of domain_policy */\n    \
                 COLUMN_COUNT = {columns},\n    \
                 OUTPUT_COUNT = {outputs},\n    \
                 BLOCK = {BLOCK}, /* rows of a layer that are computed together */\n    \
                 WIDTH = {width}, /* of the widest layer, in whole blocks */\n    \
                 SLOPE_COUNT = {slopes}, /* of all hidden layers, in whole blocks */\n    \
                 LAST_COLUMNS = {last_columns} /* of the last layer, in whole blocks */\n\
             }};\n\n#endif\n",
            variables = surrogate.variables().len(),
            policy = policy.expect("every surrogate has it"),
            outputs = surrogate.outputs().len(),
            slopes = hidden.iter().sum::<usize>().max(1),
            last_columns = padded(last.inputs),
        ),
    );
    text
}

/// `model_data.c`
pub fn source(surrogate: &Surrogate, network: &ScaledNetwork) -> String {
    let Metadata { name, inputs, outputs, provenance, time_step, .. } = surrogate.metadata();
    let description =
        format!("surrogate `{name}` of {}, {} inputs, {} outputs", provenance.tool, inputs.len(), outputs.len());
    let mut text = format!(
        "{NOTICE}#include \"model.h\"\n\nconst char model_token[] = {};\nconst char model_description[] = {};\n\
         const double model_time_step = {};\n",
        string(&surrogate.instantiation_token()),
        string(&description),
        real(*time_step),
    );
    variables(&mut text, surrogate);
    columns(&mut text, surrogate, &network.scaling);
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

fn variables(text: &mut String, surrogate: &Surrogate) {
    text.push_str("\nconst Variable model_variables[VARIABLE_COUNT] = {\n");
    for (_, Variable { name, quantity, only_fmi3 }) in surrogate.variables().iter() {
        let (quantity, index) = match *quantity {
            Quantity::Input(column) => ("COLUMN", column),
            Quantity::Output(output) => ("OUTPUT", output),
            Quantity::State(state) => ("STATE", state),
            Quantity::Derivative(state) => ("DERIVATIVE", state),
            Quantity::BuiltIn(BuiltIn::DomainPolicy) => ("DOMAIN_POLICY", 0),
            Quantity::BuiltIn(BuiltIn::InDomain) => ("IN_DOMAIN", 0),
            Quantity::BuiltIn(BuiltIn::DomainDistance) => ("DOMAIN_DISTANCE", 0),
            Quantity::BuiltIn(BuiltIn::Time) => ("TIME", 0),
            Quantity::Array(array) => ("ARRAY", array),
            Quantity::Bound(output) => ("BOUND", output),
        };
        push(text, format_args!("    {{{}, VARIABLE_{quantity}, {index}, {only_fmi3}}},\n", string(name)));
    }
    text.push_str("};\n");
}

fn activation(activation: Activation) -> &'static str {
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

fn columns(text: &mut String, surrogate: &Surrogate, scaling: &Scaling) {
    let Scaling { input_mean, input_scale, output_mean, output_scale } = scaling;
    text.push_str("\nconst Column model_columns[COLUMN_COUNT] = {\n");
    for ((input, &mean), &scale) in surrogate.inputs().iter().zip(input_mean).zip(input_scale) {
        let Input { name, min, max, start, .. } = input;
        let numbers = [*start, *min, *max, range_width(*min, *max), mean, scale].map(real).join(", ");
        push(text, format_args!("    {{{}, {}, {numbers}}},\n", string(name), role(input.role)));
    }
    text.push_str("};\n\nconst Output model_outputs[OUTPUT_COUNT] = {\n");
    for index in 0..surrogate.outputs().len() {
        let bound = surrogate.bounds().map_or(0.0, |bounds| bounds.half_widths[index]);
        let numbers = [output_mean[index], output_scale[index], bound].map(real).join(", ");
        push(text, format_args!("    {{{numbers}}},\n"));
    }
    text.push_str("};\n");
}

/// What distances from a range are relative to, as in [`metafmu_runtime::Domain`].
fn range_width(min: f64, max: f64) -> f64 {
    [max - min, max.abs()].into_iter().find(|&width| width > 0.0).unwrap_or(1.0)
}

fn role(role: Role) -> &'static str {
    match role {
        Role::Parameter(Variability::Fixed) => "ROLE_FIXED_PARAMETER",
        Role::Parameter(Variability::Tunable) => "ROLE_TUNABLE_PARAMETER",
        Role::Time => "ROLE_TIME",
        Role::Input => "ROLE_INPUT",
        Role::Start => "ROLE_START",
    }
}

/// The last layer and those before it; a network has at least one layer.
fn split(ScaledNetwork { layers, .. }: &ScaledNetwork) -> (&Layer, &[Layer]) {
    (&layers[layers.len() - 1], &layers[..layers.len() - 1])
}

/// `weights[(block * inputs + column) * BLOCK + row]`
fn in_blocks(layer: &Layer) -> Vec<f64> {
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

fn padded_to_block(numbers: &Numbers) -> Vec<f64> {
    let mut padded_values: Vec<f64> = numbers.iter().map(flushed).collect();
    padded_values.resize(padded(numbers.len()), 0.0);
    padded_values
}

/// As the evaluator has it: without weights so small that products with them would be denormal.
fn flushed(value: f64) -> f64 {
    if value.abs() < 1e-100 { 0.0 } else { value }
}

fn array(text: &mut String, declaration: &str, values: &[f64]) {
    push(text, format_args!("\n{declaration}[{}] = {{\n", values.len()));
    for line in values.chunks(8) {
        push(text, format_args!("    {},\n", line.iter().map(|&value| real(value)).collect::<Vec<_>>().join(", ")));
    }
    text.push_str("};\n");
}

/// An exact literal: an integer with a decimal point if it is short, else hexadecimal.
fn real(value: f64) -> String {
    if value.fract() == 0.0 && value.abs() < 1e6 {
        return format!("{value:.1}");
    }
    let bits = value.to_bits();
    let sign = if value.is_sign_negative() { "-" } else { "" };
    let (exponent, mantissa) = ((bits >> 52) as i64 & 0x7ff, bits & ((1 << 52) - 1));
    let digits = format!("{mantissa:013x}");
    let digits = digits.trim_end_matches('0');
    let point = if digits.is_empty() { "" } else { "." };
    // denormal numbers have no leading one
    let (leading, power) = if exponent == 0 { (0, -1022) } else { (1, exponent - 1023) };
    format!("{sign}0x{leading}{point}{digits}p{power}")
}

/// A C string literal, with an octal escape for every byte that is not plain.
fn string(text: &str) -> String {
    let mut literal = String::from("\"");
    for byte in text.bytes() {
        match byte {
            b'"' | b'\\' => push(&mut literal, format_args!("\\{}", char::from(byte))),
            // `??` would begin a trigraph
            b' '..=b'~' if byte != b'?' => literal.push(char::from(byte)),
            _ => push(&mut literal, format_args!("\\{byte:03o}")),
        }
    }
    literal.push('"');
    literal
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    // writing to a string does not fail
    let _ = text.write_fmt(arguments);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_exactly() {
        for (value, text) in [
            (0.0, "0.0"),
            (-0.0, "-0.0"),
            (12.0, "12.0"),
            (0.5, "0x1p-1"),
            (0.1, "0x1.999999999999ap-4"),
            (-1e300, "-0x1.7e43c8800759cp996"),
            (f64::MIN_POSITIVE / 4.0, "0x0.4p-1022"),
            (f64::MAX, "0x1.fffffffffffffp1023"),
        ] {
            assert_eq!(real(value), text);
        }
    }

    #[test]
    fn text_becomes_a_plain_c_literal() {
        assert_eq!(string("a\"b\\c\n\u{e4}??="), r#""a\"b\\c\012\303\244\077\077=""#);
    }
}
