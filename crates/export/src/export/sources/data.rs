//! The generated files: sizes, names for the linker, and the surrogate's numbers.

use metafmu_runtime::{
    Activation, BuiltIn, Clock, Cover, Encoding, Evaluator, Graph, Input, Metadata, Program, Quantity, Role,
    ScaledNetwork, State, Surrogate, Tunability, Variable, Variables, graph::Elementwise,
};
use std::fmt::Write;

mod discrete;
mod graph;
mod maps;
mod motion;
mod network;
mod operations;
mod state_space;
mod states;
mod tables;
mod tape;

/// External names of the C code that all models have, but the FMI functions.
const EXTERNAL_NAMES: &[&str] = &[
    "domain_contains",
    "domain_describe",
    "domain_forbids",
    "domain_forbids_point",
    "domain_note_data",
    "domain_note_value",
    "domain_outside",
    "instance_accept_point",
    "instance_adjoint_derivative",
    "instance_begin",
    "instance_boolean",
    "instance_check_booleans",
    "instance_check_derivatives",
    "instance_check_intermediate",
    "instance_check_name",
    "instance_check_set_boolean",
    "instance_check_step",
    "instance_check_token",
    "instance_count_dependencies",
    "instance_dependency",
    "instance_deserialize",
    "instance_directional_derivative",
    "instance_do_step",
    "instance_end",
    "instance_enter_event_mode",
    "instance_enter_initialization_mode",
    "instance_exit_initialization_mode",
    "instance_get_derivatives",
    "instance_get_integer",
    "instance_get_nominals",
    "instance_get_real",
    "instance_get_states",
    "instance_initialize",
    "instance_initialize_states",
    "instance_lacks",
    "instance_miscounts",
    "instance_no_variables",
    "instance_not_finite",
    "instance_output_derivatives",
    "instance_reset",
    "instance_restart",
    "instance_restore",
    "instance_save",
    "instance_serialize",
    "instance_set_input_derivatives",
    "instance_set_integer",
    "instance_set_real",
    "instance_set_solver_time",
    "instance_set_states",
    "instance_set_time",
    "instance_set_up_experiment",
    "instance_state_name",
    "instance_switch_logging",
    "instance_tell",
    "instance_update_point",
    "instance_update_results",
    "instance_updates",
    "instance_use_measured",
    "model_adjoint",
    "model_along_curve",
    "model_bound_times",
    "model_bounds",
    "model_centres",
    "model_columns",
    "model_cover_columns",
    "model_cover_radius",
    "model_description",
    "model_directional",
    "model_evaluate",
    "model_time_step",
    "model_token",
    "model_variables",
    "snapshot_fingerprint",
    "snapshot_size",
    "variable_bound",
    "variable_is_result",
    "variable_wrong",
];

/// Number and array of nominal values of a column that has a range instead.
const NO_VALUES: &str = "0, NULL";

const NOTICE: &str = "/* Generated. */\n";

/// Sources that are generated for one kind of model.
struct ModelSources {
    /// Header of the model.
    header: &'static str,
    /// Further definitions for the preprocessor.
    defines: Vec<(&'static str, String)>,
    /// External names.
    names: Vec<&'static str>,
    /// Sizes, with a comment where one is needed.
    sizes: Vec<(&'static str, usize, &'static str)>,
    /// A comment at the end of the sizes.
    remark: String,
    /// Definitions.
    data: String,
}

impl ModelSources {
    fn of(surrogate: &Surrogate) -> Self {
        let Program { graph, clock } = surrogate.program();
        match (clock, surrogate.program().motion()) {
            (Clock::Static, _) => match networks(graph) {
                Some((instants, networks)) => maps::part(surrogate, instants, network::map(surrogate, &networks)),
                None => maps::part(surrogate, &[], graph::map(graph)),
            },
            (Clock::Continuous(integration), Some(motion)) => motion::part(surrogate, motion, *integration),
            (Clock::Continuous(integration), None) => state_space::part(surrogate, *integration),
            (Clock::Sampled(sampling), _) => discrete::part(surrogate, sampling),
        }
    }
}

/// Time points, none for a single network, and the networks: `maps.c` computes them.
fn networks(graph: &Graph) -> Option<(&[f64], Vec<ScaledNetwork>)> {
    match graph.instants() {
        Some((instants, functions)) => Some((instants, functions.iter().filter_map(Graph::network).collect())),
        None => graph.network().map(|network| (&[][..], vec![network])),
    }
}

/// Returns true if `graph.c` computes the program.
pub(super) fn has_graph(program: &Program) -> bool {
    program.motion().is_none() && (program.has_memory() || networks(&program.graph).is_none())
}

/// `model_data.h`
pub fn header(surrogate: &Surrogate, identifier: &str) -> String {
    let ModelSources { header, defines, names, sizes, remark, .. } = ModelSources::of(surrogate);
    let evaluator = Evaluator::new(surrogate);
    let (columns, measured) = (evaluator.columns(), evaluator.measured_columns().unwrap_or_default());
    let policy = surrogate.variables().reference(Quantity::BuiltIn(BuiltIn::DomainPolicy));
    let (inputs, outputs, states) = (surrogate.inputs().len(), surrogate.outputs().len(), surrogate.states().len());
    let mut text = format!(
        "{NOTICE}#ifndef MODEL_DATA_H\n#define MODEL_DATA_H\n\n\
         /* External names begin with the model identifier, so that several FMUs can be linked into one program. */\n"
    );
    for name in EXTERNAL_NAMES.iter().chain(&names) {
        push(&mut text, format_args!("#define {name} {identifier}_{name}\n"));
    }
    let common = [
        ("FIRST_REFERENCE", Variables::FIRST_REFERENCE as usize, "value reference of the first variable"),
        ("REFERENCE_COUNT", surrogate.variables().reference_count() as usize, "value references, also those before it"),
        ("POLICY_REFERENCE", policy.expect("every surrogate has it") as usize, "value reference of domain_policy"),
        ("INPUT_COUNT", inputs, ""),
        ("STATE_COUNT", states, ""),
        ("NAMED_COUNT", inputs + states, "columns that are variables: inputs and states"),
        ("COLUMN_COUNT", columns, "of a point: inputs, and states or what is remembered"),
        ("OUTPUT_COUNT", outputs, ""),
        ("RESULT_COUNT", outputs + states, "outputs and derivatives of states"),
        ("BOUND_TIME_COUNT", bounds(surrogate).0.len(), "times of error bounds"),
        ("MEASURED_COUNT", measured.len(), "columns that are measured outputs"),
        (
            "FIRST_MEASURED",
            measured.start,
            "the first of them; the column after all of them is 1 while they are used, else 0",
        ),
    ];
    let of_cover = surrogate.metadata().cover.iter().flat_map(|Cover { columns, centres, .. }| {
        [
            ("COVER_COLUMN_COUNT", columns.len(), "columns of the centres of training data"),
            ("COVER_COUNT", centres.len() / columns.len(), "centres of training data"),
        ]
    });
    let sampling = surrogate.program().sampling();
    let of_all = [
        ("MODEL_HEADER", format!("\"{header}\"")),
        ("MODEL_GOES_ON", u8::from(columns > inputs).to_string()),
        ("MODEL_HAS_STATES", u8::from(states > 0).to_string()),
        ("MODEL_HAS_EQUATIONS", u8::from(surrogate.program().integration().is_some()).to_string()),
        ("MODEL_HAS_MAPS", u8::from(!surrogate.program().has_memory()).to_string()),
        ("MODEL_HAS_COVER", u8::from(surrogate.metadata().cover.is_some()).to_string()),
        ("MODEL_HAS_SUPPORT", u8::from(sampling.is_some_and(|sampling| sampling.support.is_some())).to_string()),
        ("MODEL_HAS_DIRECT", u8::from(sampling.is_some_and(|sampling| !sampling.direct.is_empty())).to_string()),
    ];
    text.push('\n');
    for (name, value) in of_all.into_iter().chain(defines) {
        push(&mut text, format_args!("#define {name} {value}\n"));
    }
    enumeration(&mut text, "Activation", Activation::ALL.map(network::activation));
    if has_graph(surrogate.program()) {
        enumeration(&mut text, "Function", Elementwise::all().map(graph::function));
    }
    text.push_str("\nenum {\n");
    let mut sizes = common.into_iter().chain(of_cover).chain(sizes).peekable();
    while let Some((name, size, comment)) = sizes.next() {
        let comma = if sizes.peek().is_some() { "," } else { "" };
        let comment = if comment.is_empty() { String::new() } else { format!(" /* {comment} */") };
        push(&mut text, format_args!("    {name} = {size}{comma}{comment}\n"));
    }
    push(&mut text, format_args!("}};\n{remark}\n#endif\n"));
    text
}

/// `model_data.c`
pub fn source(surrogate: &Surrogate) -> String {
    let Metadata { name, inputs, outputs, provenance, time_step, .. } = surrogate.metadata();
    let description =
        format!("surrogate `{name}` of {}, {} inputs, {} outputs", provenance.tool, inputs.len(), outputs.len());
    let mut text = format!(
        "{NOTICE}#include \"evaluator.h\"\n#include <math.h>\n\nconst char model_token[] = {};\nconst char model_description[] = {};\n\
         const double model_time_step = {};\n",
        string(&surrogate.instantiation_token()),
        string(&description),
        double(*time_step),
    );
    variables(&mut text, surrogate);
    columns(&mut text, surrogate);
    let (times, half_widths) = bounds(surrogate);
    doubles(&mut text, "const double model_bound_times", &times);
    doubles(&mut text, "const double model_bounds", &half_widths);
    if let Some(Cover { columns, radius, centres }) = &surrogate.metadata().cover {
        let columns = columns.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
        push(&mut text, format_args!("\nconst double model_cover_radius = {};\n", double(*radius)));
        push(&mut text, format_args!("const uint32_t model_cover_columns[COVER_COLUMN_COUNT] = {{{columns}}};\n"));
        let centres: Vec<f64> = centres.iter().copied().map(f64::from).collect();
        doubles(&mut text, "const float model_centres", &centres);
    }
    let data = ModelSources::of(surrogate).data;
    if let Some(reason) = refusal_of_single(surrogate, &data) {
        push(&mut text, format_args!("\n#ifdef METAFMU_SINGLE\n#error \"{reason}\"\n#endif\n"));
    }
    text + &data
}

/// Reason why the model cannot be computed in single precision, if there is one; `data` has its definitions.
fn refusal_of_single(surrogate: &Surrogate, data: &str) -> Option<String> {
    let of_inputs = surrogate.inputs().iter().flat_map(|input| [input.start, input.min, input.max]);
    let of_states = surrogate.states().iter().flat_map(|state| state.range.unwrap_or_default());
    if data.contains(BEYOND_SINGLE.trim_end())
        || of_inputs.chain(of_states).any(|value| value.is_finite() && (value as f32).is_infinite())
    {
        return Some("METAFMU_SINGLE: the model has numbers, or ranges, that single precision has not".into());
    }
    let rounding = 0.5 * f64::from(f32::EPSILON) * largest_sum(surrogate);
    (rounding > ROUNDING_IN_SINGLE).then(|| {
        format!(
            "METAFMU_SINGLE: the terms of a sum nearly cancel, so that rounding would be up to {rounding:.0e} of the standard deviation of \
             what it gives: compile in double precision, or export another model"
        )
    })
}

/// Rounding of the terms of an output, relative to its standard deviation, that makes single precision meaningless.
const ROUNDING_IN_SINGLE: f64 = 0.01;

/// The largest sum of magnitudes of the terms of an output of the model or of one of its networks, relative to its standard deviation.
fn largest_sum(surrogate: &Surrogate) -> f64 {
    let program = surrogate.program();
    if !program.has_memory() {
        return match networks(&program.graph) {
            Some((_, networks)) => networks
                .iter()
                .map(|network| {
                    let ScaledNetwork { scaling, .. } = network;
                    of_outputs(surrogate, &scaling.output_mean, &scaling.output_scale, network::sums(network))
                })
                .fold(0.0, f64::max),
            None => {
                let sums = graph::sums(&program.graph);
                let (means, scales) = (vec![0.0; sums.len()], vec![1.0; sums.len()]);
                of_outputs(surrogate, &means, &scales, sums)
            }
        };
    }
    match program.motion() {
        Some(motion) => {
            let terms =
                [motion.dynamics.function_set().network(), motion.positions.network(), motion.dynamics.forces()];
            terms.into_iter().flatten().map(|term| largest_of_network(term.network())).fold(0.0, f64::max)
        }
        None => program.graph.called().and_then(Graph::network).map_or(0.0, |network| largest_of_network(&network)),
    }
}

/// The largest of the sums of a network.
fn largest_of_network(network: &ScaledNetwork) -> f64 {
    network::sums(network).into_iter().fold(0.0, f64::max)
}

/// The largest of an output, from sums relative to scales: the standard deviation is about a quarter of the range.
fn of_outputs(surrogate: &Surrogate, means: &[f64], scales: &[f64], sums: Vec<f64>) -> f64 {
    let outputs = surrogate.outputs().iter().zip(means.iter().zip(scales)).zip(sums);
    outputs
        .map(|((output, (mean, scale)), sum)| (mean.abs() + scale * sum, 0.25 * (output.max - output.min)))
        .filter(|(_, deviation)| *deviation > 0.0)
        .map(|(sum, deviation)| sum / deviation)
        .fold(0.0, f64::max)
}

/// Times and error bounds; zeros if there are none.
fn bounds(surrogate: &Surrogate) -> (Vec<f64>, Vec<f64>) {
    let outputs = surrogate.outputs().len();
    let bounds = surrogate.bounds().map(|bounds| (bounds.times.clone(), bounds.half_widths.clone()));
    let (times, half_widths) = bounds.unwrap_or((Vec::new(), vec![0.0; outputs]));
    (if times.is_empty() { vec![0.0] } else { times }, half_widths)
}

fn variables(text: &mut String, surrogate: &Surrogate) {
    text.push_str("\nconst Variable model_variables[REFERENCE_COUNT] = {\n");
    for _ in 0..Variables::FIRST_REFERENCE {
        text.push_str("    {\"\", VARIABLE_NONE, 0, false},\n");
    }
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
            Quantity::BuiltIn(BuiltIn::UseMeasured) => ("USE_MEASURED", 0),
            Quantity::Array(_) => ("NONE", 0),
            Quantity::Bound(output) => ("BOUND", output),
            Quantity::Measured(output) => ("MEASURED", output),
        };
        push(text, format_args!("    {{{}, VARIABLE_{quantity}, {index}, {only_fmi3}}},\n", string(name)));
    }
    text.push_str("};\n");
}

fn columns(text: &mut String, surrogate: &Surrogate) {
    for (index, input) in surrogate.inputs().iter().enumerate() {
        if let Some(values) = input.nominal_values() {
            doubles(text, &format!("static const double values_{index}"), values);
        }
    }
    text.push_str("\nconst Column model_columns[NAMED_COUNT] = {\n");
    for (index, Input { name, min, max, start, role, encoding, .. }) in surrogate.inputs().iter().enumerate() {
        // as in the domain: the state that begins there has a range
        let is_everywhere = *role == Role::Start || *encoding == Encoding::Periodic;
        let range = (!is_everywhere).then_some([*min, *max]);
        let values = match encoding {
            Encoding::Nominal(values) => format!("{}, values_{index}", values.len()),
            Encoding::Plain | Encoding::Periodic => NO_VALUES.into(),
        };
        let of_input =
            DescribedColumn { name, role: role_name(*role), start: *start, range, nominal: 1.0, values: &values };
        text.push_str(&of_input.row());
    }
    for State { name, range, nominal, .. } in surrogate.states() {
        let of_state = DescribedColumn {
            name,
            role: "ROLE_STATE",
            start: 0.0,
            range: *range,
            nominal: *nominal,
            values: NO_VALUES,
        };
        text.push_str(&of_state.row());
    }
    text.push_str("};\n");
}

/// A column of the model as C describes it.
struct DescribedColumn<'a> {
    name: &'a str,
    role: &'a str,
    start: f64,
    /// None if every value is valid.
    range: Option<[f64; 2]>,
    nominal: f64,
    values: &'a str,
}

impl DescribedColumn<'_> {
    fn row(&self) -> String {
        let Self { name, role, start, range, nominal, values } = *self;
        let [min, max, width] =
            range.map_or([f64::NEG_INFINITY, f64::INFINITY, 1.0], |[min, max]| [min, max, range_width(min, max)]);
        let numbers = [start, min, max, width, nominal].map(double).join(", ");
        format!("    {{{}, {role}, {numbers}, {values}}},\n", string(name))
    }
}

/// Scale of distances from a range, as in [`metafmu_runtime::Domain`].
fn range_width(min: f64, max: f64) -> f64 {
    [max - min, max.abs()].into_iter().find(|&width| width > 0.0).unwrap_or(1.0)
}

fn role_name(role: Role) -> &'static str {
    match role {
        Role::Parameter(Tunability::Fixed) => "ROLE_FIXED_PARAMETER",
        Role::Parameter(Tunability::Tunable) => "ROLE_TUNABLE_PARAMETER",
        Role::Time => "ROLE_TIME",
        Role::Input => "ROLE_INPUT",
        Role::Start => "ROLE_START",
    }
}

/// An array of numbers that the model is computed with.
fn array(text: &mut String, declaration: &str, values: &[f64]) {
    list(text, declaration, values, real);
}

/// An array of numbers of the interface.
fn doubles(text: &mut String, declaration: &str, values: &[f64]) {
    list(text, declaration, values, double);
}

fn list(text: &mut String, declaration: &str, values: &[f64], written: fn(f64) -> String) {
    push(text, format_args!("\n{declaration}[{}] = {{\n", values.len()));
    for line in values.chunks(8) {
        push(text, format_args!("    {},\n", line.iter().map(|&value| written(value)).collect::<Vec<_>>().join(", ")));
    }
    text.push_str("};\n");
}

/// Stands before numbers that single precision does not have.
const BEYOND_SINGLE: &str = "/* beyond single precision */ ";

/// Literal of the C type `Real`, which a definition for the preprocessor makes single precision.
fn real(value: f64) -> String {
    if value.is_infinite() {
        return if value > 0.0 { "REAL_HUGE" } else { "-REAL_HUGE" }.into();
    }
    let single = value as f32;
    if single.is_infinite() {
        return format!("{BEYOND_SINGLE}{}", double(value));
    }
    // compilers warn of literals that become zero
    if value != 0.0 && single == 0.0 {
        return format!("(Real){}", double(value));
    }
    format!("R({})", double(value))
}

/// Literal of a divisor of the C type `Real`; one that is not normal in single precision is marked.
fn divisor(value: f64) -> String {
    let mark = if (value as f32).is_normal() { "" } else { BEYOND_SINGLE };
    format!("{mark}{}", real(value))
}

/// An exact literal: an integer with a decimal point if it is short, else hexadecimal.
fn double(value: f64) -> String {
    if value.is_infinite() {
        return if value > 0.0 { "HUGE_VAL" } else { "-HUGE_VAL" }.into();
    }
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

/// C enumeration, numbered from 0.
fn enumeration(text: &mut String, name: &str, constants: impl IntoIterator<Item = String>) {
    let constants: Vec<String> = constants.into_iter().map(|constant| format!("    {constant}")).collect();
    push(text, format_args!("\ntypedef enum {{\n{}\n}} {name};\n", constants.join(",\n")));
}

/// Name of a C constant, from the name of the variant.
fn enumerator(prefix: &str, variant: impl std::fmt::Debug) -> String {
    let mut name = prefix.to_owned();
    for letter in format!("{variant:?}").chars() {
        if letter.is_uppercase() {
            name.push('_');
        }
        name.push(letter.to_ascii_uppercase());
    }
    name
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    // writing to a string does not fail
    let _ = text.write_fmt(arguments);
}

/// An array of structures; with one that is not used if there are none, as C has no empty arrays.
fn table(text: &mut String, declaration: &str, rows: impl Iterator<Item = String>, unused: &str) {
    let mut rows = rows.peekable();
    let unused = rows.peek().is_none().then(|| unused.to_owned());
    push(text, format_args!("\n{declaration}[] = {{\n"));
    for row in unused.into_iter().chain(rows) {
        push(text, format_args!("    {{{row}}},\n"));
    }
    text.push_str("};\n");
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
            (f64::NEG_INFINITY, "-HUGE_VAL"),
        ] {
            assert_eq!(double(value), text);
        }
    }

    #[test]
    fn numbers_that_single_precision_lacks_are_marked() {
        for (value, text) in [
            (12.0, "R(12.0)"),
            (-0.1, "R(-0x1.999999999999ap-4)"),
            (f64::INFINITY, "REAL_HUGE"),
            (1e-60, "(Real)0x1.9b604aaaca626p-200"),
            (-1e300, "/* beyond single precision */ -0x1.7e43c8800759cp996"),
        ] {
            assert_eq!(real(value), text);
        }
        assert_eq!(divisor(0.5), "R(0x1p-1)");
        assert_eq!(divisor(1e-60), "/* beyond single precision */ (Real)0x1.9b604aaaca626p-200");
    }

    #[test]
    fn text_becomes_a_plain_c_literal() {
        assert_eq!(string("a\"b\\c\n\u{e4}??="), r#""a\"b\\c\012\303\244\077\077=""#);
    }
}
