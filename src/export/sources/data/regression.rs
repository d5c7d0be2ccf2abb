//! Numbers of a polynomial, a forest or kernels.

use super::{array, maps::MapPart, network::scalings, operations::Operations, push, real, table};
use metafmu_runtime::regression::{Forest, Function, KernelMachine, LEAF, Node, Polynomial, Regression, Tree};

pub fn map(regression: &Regression) -> MapPart {
    let (columns, outputs) = (regression.inputs(), regression.outputs());
    let scaling = &regression.scaling;
    let mut data = scalings("const Scaling model_input_scaling", &scaling.input_mean, &scaling.input_scale);
    data += &scalings("const Scaling model_output_scaling", &scaling.output_mean, &scaling.output_scale);
    let function = match &regression.function {
        Function::Polynomial(polynomial) => of_polynomial(polynomial, columns, outputs),
        Function::Forest(forest) => of_forest(forest),
        Function::Kernel(machines) => of_kernels(&machines.machines, columns),
    };
    let scaled = Operations { arithmetic: 2.0 * (columns + outputs) as f64, ..Operations::default() };
    let Written { header, names, sizes, data: numbers, operations, formula } = function;
    MapPart {
        header: "regression.h",
        defines: vec![("FUNCTION_HEADER", format!("\"{header}\""))],
        names: [&["model_input_scaling", "model_output_scaling"], names].concat(),
        sizes,
        data: data + &numbers,
        operations: operations.times(1.0, scaled),
        formula,
    }
}

/// Sums of the magnitudes of the terms of each output, relative to its scale: Legendre polynomials and kernels are at most one. Of trees
/// nothing cancels.
pub(super) fn sums(regression: &Regression) -> Vec<f64> {
    let sum = |numbers: &[f64]| numbers.iter().map(|number| number.abs()).sum::<f64>();
    match &regression.function {
        Function::Polynomial(Polynomial { coefficients, .. }) => {
            coefficients.chunks((coefficients.len() / regression.outputs()).max(1)).map(sum).collect()
        }
        Function::Forest(_) => vec![0.0; regression.outputs()],
        Function::Kernel(machines) => {
            machines.machines.iter().map(|machine| sum(&machine.weights) + machine.bias.abs()).collect()
        }
    }
}

/// What is generated of a function.
struct Written {
    header: &'static str,
    names: &'static [&'static str],
    sizes: Vec<(&'static str, usize, &'static str)>,
    data: String,
    operations: Operations,
    formula: &'static str,
}

/// Of functions that note nothing down.
const NO_TABLE: (&str, usize, &str) = ("TABLE_SIZE", 1, "nothing is noted down, but C has no empty arrays");

/// The formula is in `polynomial.h`.
fn of_polynomial(Polynomial { degrees, coefficients }: &Polynomial, columns: usize, outputs: usize) -> Written {
    let terms = degrees.len() / columns;
    let degree = usize::from(degrees.iter().copied().max().unwrap_or(0));
    let factors = degrees.iter().filter(|degree| **degree > 0).count();
    let mut data = String::from("\nconst unsigned char model_degrees[TERM_COUNT * MAP_COLUMNS] = {\n");
    for term in degrees.chunks(columns) {
        let term: Vec<String> = term.iter().map(u8::to_string).collect();
        push(&mut data, format_args!("    {},\n", term.join(", ")));
    }
    data.push_str("};\n");
    array(&mut data, "const Real model_coefficients", coefficients);
    let orders = degree.max(1) + 1;
    Written {
        header: "polynomial.h",
        names: &["model_coefficients", "model_degrees"],
        sizes: vec![
            ("TERM_COUNT", terms, "products of polynomials"),
            ("ORDER_COUNT", orders, "polynomials of a column: degrees 0, 1, ..."),
            ("TABLE_SIZE", orders * columns, "of all columns"),
        ],
        data,
        operations: Operations {
            arithmetic: (9 * (orders - 2) * columns + factors + 2 * outputs * terms) as f64,
            ..Operations::default()
        },
        formula: "polynomial.h have",
    }
}

/// The formula is in `forest.h`.
fn of_forest(Forest { nodes, trees }: &Forest) -> Written {
    let mut data = format!("\nconst size_t model_tree_count = {};\n", trees.len());
    let rows = nodes.iter().map(|Node { column, number, below: [first, second] }| {
        let column = if *column == LEAF { "MAP_COLUMNS".into() } else { column.to_string() };
        format!("{column}, {}, {{{first}, {second}}}", real(*number))
    });
    table(&mut data, "const Node model_nodes", rows, "MAP_COLUMNS, 0.0, {0, 0}");
    let rows = trees.iter().map(|Tree { root, output }| format!("{root}, {output}"));
    table(&mut data, "const Tree model_trees", rows, "0, 0");
    // levels of splits from a node on; those below a node come after it
    let mut levels = vec![0.0_f64; nodes.len()];
    for (index, node) in nodes.iter().enumerate().rev().filter(|(_, node)| node.column != LEAF) {
        levels[index] = 1.0 + node.below.iter().map(|&below| levels[below as usize]).fold(0.0, f64::max);
    }
    Written {
        header: "forest.h",
        names: &["model_nodes", "model_tree_count", "model_trees"],
        sizes: vec![NO_TABLE],
        data,
        operations: Operations {
            arithmetic: trees.len() as f64,
            comparisons: trees.iter().map(|tree| levels[tree.root as usize]).sum(),
            ..Operations::default()
        },
        formula: "forest.h have",
    }
}

/// The formula is in `kernel.h`.
fn of_kernels(machines: &[KernelMachine], columns: usize) -> Written {
    let mut data = String::new();
    for (index, KernelMachine { lengths, centres, weights, .. }) in machines.iter().enumerate() {
        let per_length: Vec<f64> = lengths.iter().map(|length| 1.0 / length).collect();
        array(&mut data, &format!("static const Real per_length_{index}"), &per_length);
        for (name, values) in [("centres", centres), ("weights", weights)] {
            // C has no empty arrays
            let values = if values.is_empty() { &vec![0.0] } else { values };
            array(&mut data, &format!("static const Real {name}_{index}"), values);
        }
    }
    let rows = machines.iter().enumerate().map(|(index, machine)| {
        let (bias, count) = (real(machine.bias), machine.weights.len());
        format!("{bias}, per_length_{index}, {count}, centres_{index}, weights_{index}")
    });
    table(&mut data, "const Machine model_machines", rows, "");
    let centres = machines.iter().map(|machine| machine.weights.len()).sum::<usize>() as f64;
    Written {
        header: "kernel.h",
        names: &["model_machines"],
        sizes: vec![NO_TABLE],
        data,
        operations: Operations {
            arithmetic: centres * (4.0 * columns as f64 + 3.0),
            exponentials: centres,
            ..Operations::default()
        },
        formula: "kernel.h have",
    }
}
