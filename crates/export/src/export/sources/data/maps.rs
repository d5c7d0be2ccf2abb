//! Models without states: inputs, their encoding, and instants.

use super::{ModelSources, array, double, operations::Operations, push};
use metafmu_runtime::{Encoder, Encoding, Input, Surrogate};

/// Generated part of a network or a regression, or of several networks.
pub(super) struct MapPart {
    /// Its header.
    pub header: &'static str,
    /// Further definitions for the preprocessor.
    pub defines: Vec<(&'static str, String)>,
    /// External names.
    pub names: Vec<&'static str>,
    /// Sizes, with a comment where one is needed.
    pub sizes: Vec<(&'static str, usize, &'static str)>,
    /// Definitions.
    pub data: String,
    /// Operations of an evaluation of one map.
    pub operations: Operations,
    /// Files with the formula, followed by the verb.
    pub formula: &'static str,
}

const NAMES: [&str; 4] = ["map_adjoint", "map_along_curve", "map_evaluate", "model_turns"];

/// Model of one map, or of a network for each of several instants.
pub fn part(surrogate: &Surrogate, instants: &[f64], map: MapPart) -> ModelSources {
    let (inputs, outputs) = (surrogate.inputs(), surrogate.outputs().len());
    let features = Encoder::of(inputs).width();
    let is_timed = !instants.is_empty();
    let mut names = [&map.names[..], &NAMES].concat();
    let mut sizes = vec![
        // compilers warn of sine and cosine beyond an array of one
        ("FEATURE_COUNT", features.max(2), "columns that the inputs become, or two"),
        ("MAP_COLUMNS", features - usize::from(is_timed), "of them those of a map"),
    ];
    let mut data = turns(inputs);
    if let (true, Some(time)) = (is_timed, surrogate.time_column()) {
        names.push("model_instants");
        sizes.push(("INSTANT_COUNT", instants.len(), ""));
        sizes.push((
            "TIME_FEATURE",
            inputs[..time].iter().map(|input| input.encoding.width()).sum(),
            "the time's column",
        ));
        array(&mut data, "const Real model_instants", instants);
    }
    let operations = operations(inputs, outputs, instants.len(), map.operations);
    let has_instants = u8::from(is_timed).to_string();
    ModelSources {
        header: "maps.h",
        defines: [
            vec![("MAP_HEADER", format!("\"{}\"", map.header)), ("MODEL_HAS_INSTANTS", has_instants)],
            map.defines,
        ]
        .concat(),
        names,
        sizes: [sizes, map.sizes].concat(),
        remark: operations.remark("The outputs after a step take", &format!("maps.c and {}", map.formula)),
        data: data + &map.data,
    }
}

/// Operations for all outputs at a point; the formula is in `maps.c`.
fn operations(inputs: &[Input], outputs: usize, instants: usize, of_map: Operations) -> Operations {
    let encoding = inputs.iter().map(of_input).fold(Operations::default(), |sum, one| one.times(1.0, sum));
    if instants == 0 {
        return of_map.times(1.0, encoding);
    }
    let between = Operations {
        arithmetic: 4.0 + 3.0 * outputs as f64,
        comparisons: 4.0 + (instants as f64).log2().ceil(),
        ..Operations::default()
    };
    of_map.times(2.0, between.times(1.0, encoding))
}

/// Operations that encode an input.
fn of_input(input: &Input) -> Operations {
    match &input.encoding {
        Encoding::Plain => Operations::default(),
        Encoding::Nominal(values) => {
            let others = values.len() as f64 - 1.0;
            Operations { arithmetic: 3.0 * others, comparisons: 2.0 * others, ..Operations::default() }
        }
        Encoding::Periodic => Operations { arithmetic: 4.0, sines: 2.0, ..Operations::default() },
    }
}

/// Start and length of the period of each periodic input.
fn turns(inputs: &[Input]) -> String {
    let mut text = String::from("\nconst Turn model_turns[COLUMN_COUNT] = {\n");
    for Input { min, max, encoding, .. } in inputs {
        let [start, period] = if *encoding == Encoding::Periodic { [*min, max - min] } else { [0.0; 2] };
        push(&mut text, format_args!("    {{{}, {}}},\n", double(start), double(period)));
    }
    text.push_str("};\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::sources::data::network;
    use metafmu_example as example;
    use metafmu_runtime::{Activation, Graph, Precision};

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let surrogate = example::encoded(&example::per_instant(&[5, 20], Activation::Tanh, Precision::Double));
        let (instants, functions) = surrogate.program().graph.instants().unwrap();
        let networks: Vec<_> = functions.iter().filter_map(Graph::network).collect();
        let of_map = network::map(&surrogate, &networks).operations;
        // one of three values, sine and cosine; layers of 5 to 5 to 20 to 2, in blocks of 16; two outputs
        let one = 5 * 2 + 2 * (5 * 16 + 5 * 32) + 2 * (2 * 32 + 18);
        let expected = Operations { arithmetic: f64::from(one), activations: 48.0, ..Operations::default() };
        assert_eq!(of_map, expected);
        let expected = Operations {
            arithmetic: f64::from(2 * one + (4 + 3 * 2) + 3 * 2 + 4),
            sines: 2.0,
            comparisons: f64::from(4 + 2 + 2 * 2),
            activations: 96.0,
            ..Operations::default()
        };
        assert_eq!(operations(surrogate.inputs(), 2, instants.len(), of_map), expected);
    }
}
