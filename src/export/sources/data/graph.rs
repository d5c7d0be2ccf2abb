//! Numbers of a graph.

use super::{
    array,
    maps::MapPart,
    network::{ACTIVATIONS, BLOCK, BLOCK_SIZE, padded},
    operations::Operations,
    push, real, table,
};
use metafmu_runtime::{
    Map,
    graph::{Elementwise, Graph, LEAF, Node, Operation, Step, Tree},
};

/// A step as `graph.h` has it; what it does not need is zero.
struct StepRow {
    kind: &'static str,
    function: usize,
    operation: usize,
    of: [usize; 3],
    width: usize,
    numbers: String,
    parameter_step: usize,
    more: String,
    places: String,
    trees: [usize; 2],
    degrees: String,
    orders: usize,
}

/// What is generated of a graph that is part of a model with a state; nothing if it has none.
#[derive(Default)]
pub(super) struct BesideGraph {
    pub names: Vec<&'static str>,
    pub sizes: Vec<(&'static str, usize, &'static str)>,
    pub data: String,
    /// Of an evaluation.
    pub operations: Operations,
}

impl BesideGraph {
    /// Of the map of a model; so many results are added to others.
    pub fn of(of: Option<&Map>, added: usize) -> Self {
        let Some(Map::Graph(graph)) = of else { return Self::default() };
        let MapPart { names, sizes, data, operations, .. } = steps(graph);
        let added = Operations { arithmetic: added as f64, ..Operations::default() };
        Self { names, sizes, data, operations: operations.times(1.0, added) }
    }
}

/// A map that is a graph, with what activations need.
pub fn map(graph: &Graph) -> MapPart {
    let part = steps(graph);
    let (names, sizes) = ([&ACTIVATIONS[..], &part.names].concat(), [&[BLOCK_SIZE], &part.sizes[..]].concat());
    MapPart { names, sizes, ..part }
}

/// The formulas are in `graph.c` and `graph_steps.h`.
fn steps(graph: &Graph) -> MapPart {
    let widths = graph.widths().expect("a surrogate's graph was checked");
    // what a step notes stands before what it makes: the last numbers are the outputs
    let noted = [0].into_iter().chain(graph.steps.iter().map(Step::noted));
    let mut numbers = 0;
    let begins: Vec<usize> = (widths.iter().zip(noted))
        .map(|(width, noted)| {
            numbers += noted + width;
            numbers - width
        })
        .collect();
    let (mut data, mut rows) = (String::new(), Vec::new());
    let (mut nodes, mut trees): (Vec<Node>, Vec<Tree>) = (Vec::new(), Vec::new());
    let mut operations = Operations::default();
    for (number, step) in graph.steps.iter().enumerate() {
        let count = widths[number + 1];
        let row = row(step, number, (&begins, &widths), &mut data, (&mut nodes, &mut trees));
        operations = of_step(step, (row.width, count)).times(1.0, operations);
        let StepRow {
            kind,
            function,
            operation,
            of: [a, b, c],
            width,
            numbers,
            parameter_step,
            more,
            places,
            trees,
            degrees,
            orders,
        } = row;
        rows.push(format!(
            "{kind}, (Function){function}, (Combination){operation}, {{{a}, {b}, {c}}}, {width}, {}, {count}, {numbers}, {parameter_step}, \
             {more}, {places}, {}, {}, {degrees}, {orders}",
            begins[number + 1],
            trees[0],
            trees[1]
        ));
    }
    let of_node = |Node { column, number, below: [first, second] }: &Node| {
        let column = if *column == LEAF { "NO_COLUMN".into() } else { column.to_string() };
        format!("{column}, {}, {{{first}, {second}}}", real(*number))
    };
    table(&mut data, "const GraphNode model_graph_nodes", nodes.iter().map(of_node), "NO_COLUMN, 0.0, {0, 0}");
    let of_tree = |Tree { root, output }: &Tree| format!("{root}, {output}");
    table(&mut data, "const GraphTree model_graph_trees", trees.iter().map(of_tree), "0, 0");
    table(&mut data, "const GraphStep model_steps", rows.into_iter(), "");
    MapPart {
        header: "graph.h",
        defines: Vec::new(),
        names: vec!["jet_graph", "model_graph_nodes", "model_graph_trees", "model_steps", "real_graph"],
        sizes: vec![
            ("STEP_COUNT", graph.steps.len(), ""),
            ("NUMBER_COUNT", numbers, "of the columns and of all steps"),
        ],
        data,
        operations,
        formula: "graph.c and graph_steps.h have",
    }
}

fn row(
    step: &Step,
    number: usize,
    (begins, widths): (&[usize], &[usize]),
    data: &mut String,
    (nodes, trees): (&mut Vec<Node>, &mut Vec<Tree>),
) -> StepRow {
    let none = || String::from("NULL");
    let row = |kind, of: usize| StepRow {
        kind,
        function: 0,
        operation: 0,
        of: [begins[of]; 3],
        width: widths[of],
        numbers: none(),
        parameter_step: 0,
        more: none(),
        places: none(),
        trees: [0; 2],
        degrees: none(),
        orders: 0,
    };
    let mut numbers = |what: &str, values: &[f64]| {
        let name = format!("{what}_{number}");
        array(data, &format!("static const Real {name}"), values);
        name
    };
    match step {
        Step::Affine { of, weight, bias } => StepRow {
            numbers: numbers("weights", &in_blocks(&weight.iter().collect::<Vec<f64>>(), widths[*of])),
            more: numbers("bias", &bias.iter().collect::<Vec<f64>>()),
            ..row("STEP_AFFINE", *of)
        },
        Step::Elementwise { of, function, parameters } => {
            let place = Elementwise::ALL.iter().position(|known| known == function);
            let is_each = parameters.len() > function.parameters();
            // there are always two, so that nothing else is read
            let (count, each) = (function.parameters(), if is_each { widths[*of] } else { 1 });
            let mut both = parameters.clone();
            both.resize(each * 2.max(count), 0.0);
            StepRow {
                function: place.expect("all of them are listed"),
                numbers: numbers("parameters", &both),
                parameter_step: usize::from(is_each),
                ..row("STEP_ELEMENTWISE", *of)
            }
        }
        Step::Combine { of: [a, b], operation } => {
            let place = Operation::ALL.iter().position(|known| known == operation);
            let operation = place.expect("all of them are listed");
            StepRow { operation, of: [begins[*a], begins[*b], 0], ..row("STEP_COMBINE", *a) }
        }
        Step::Select { of: [condition, a, b] } => {
            StepRow { of: [begins[*condition], begins[*a], begins[*b]], ..row("STEP_SELECT", *a) }
        }
        Step::Columns { columns } => {
            let places: Vec<String> =
                columns.iter().map(|[of, column]| (begins[*of as usize] + *column as usize).to_string()).collect();
            let name = format!("places_{number}");
            push(data, format_args!("\nstatic const size_t {name}[] = {{{}}};\n", places.join(", ")));
            StepRow { places: name, ..row("STEP_COLUMNS", 0) }
        }
        Step::Standardise { of, epsilon } => {
            StepRow { more: numbers("epsilon", &[*epsilon]), ..row("STEP_STANDARDISE", *of) }
        }
        Step::Softmax { of } => row("STEP_SOFTMAX", *of),
        Step::Distances { of, centres, lengths } => {
            let per_length: Vec<f64> = lengths.iter().map(|length| 1.0 / length).collect();
            StepRow {
                numbers: numbers("centres", centres),
                more: numbers("per_length", &per_length),
                ..row("STEP_DISTANCES", *of)
            }
        }
        Step::Forest { of, forest, .. } => {
            let (first_node, first_tree) = (nodes.len() as u32, trees.len());
            let moved = |node: &Node| match node.column {
                LEAF => *node,
                _ => Node { below: node.below.map(|below| below + first_node), ..*node },
            };
            nodes.extend(forest.nodes.iter().map(moved));
            trees.extend(forest.trees.iter().map(|tree| Tree { root: tree.root + first_node, ..*tree }));
            StepRow { trees: [first_tree, forest.trees.len()], ..row("STEP_FOREST", *of) }
        }
        Step::Products { of, products } => {
            let name = format!("degrees_{number}");
            push(data, format_args!("\nstatic const unsigned char {name}[] = {{\n"));
            for term in products.degrees.chunks(products.inputs) {
                let term: Vec<String> = term.iter().map(u8::to_string).collect();
                push(data, format_args!("    {},\n", term.join(", ")));
            }
            data.push_str("};\n");
            StepRow { degrees: name, orders: products.orders(), ..row("STEP_PRODUCTS", *of) }
        }
    }
}

/// Weights, row by row, in blocks of rows, each column by column.
fn in_blocks(weights: &[f64], columns: usize) -> Vec<f64> {
    let of_block = |block: &[f64]| -> Vec<f64> {
        (0..columns).flat_map(|column| block.iter().skip(column).step_by(columns).copied()).collect()
    };
    weights.chunks(BLOCK * columns.max(1)).flat_map(of_block).collect()
}

/// Sums of the magnitudes of the terms of each output where these are at most one times a weight: Legendre polynomials and Gaussian
/// kernels. None of other outputs.
pub(super) fn sums(graph: &Graph) -> Vec<f64> {
    let is_bounded = |of: usize| {
        let step = of.checked_sub(1).and_then(|number| graph.steps.get(number));
        matches!(step, Some(Step::Products { .. } | Step::Elementwise { function: Elementwise::Gaussian, .. }))
    };
    let of_step = |step: &Step| match step {
        Step::Affine { of, weight, bias } if is_bounded(*of) => {
            let weights: Vec<f64> = weight.iter().map(f64::abs).collect();
            let rows = weights.chunks(weights.len() / bias.len()).map(|row| row.iter().sum::<f64>());
            rows.zip(bias.iter()).map(|(sum, bias)| sum + bias.abs()).collect()
        }
        _ => Vec::new(),
    };
    match graph.steps.as_slice() {
        [steps @ .., Step::Columns { columns }] => {
            let of_column = |[of, column]: &[u32; 2]| {
                let step = (*of as usize).checked_sub(1).map(|number| of_step(&steps[number])).unwrap_or_default();
                step.get(*column as usize).copied().unwrap_or(0.0)
            };
            columns.iter().map(of_column).collect()
        }
        steps => steps.last().map(of_step).unwrap_or_default(),
    }
}

/// The counts that `graph.c` states.
fn of_step(step: &Step, (width, count): (usize, usize)) -> Operations {
    let (n, m) = (width as f64, count as f64);
    let none = Operations::default();
    match step {
        Step::Affine { .. } => Operations { arithmetic: 2.0 * n * m, ..none },
        Step::Distances { .. } => Operations { arithmetic: 4.0 * n * m, ..none },
        Step::Elementwise { function: Elementwise::Activation(_), .. } => {
            Operations { activations: padded(count) as f64, ..none }
        }
        Step::Elementwise { function: Elementwise::Linear, .. } => Operations { arithmetic: 2.0 * m, ..none },
        Step::Elementwise { function: Elementwise::Gaussian, .. } => {
            Operations { arithmetic: 3.0 * m, exponentials: m, ..none }
        }
        Step::Elementwise { .. } => Operations { activations: m, ..none },
        Step::Combine { .. } => Operations { arithmetic: m, ..none },
        Step::Select { .. } => Operations { comparisons: m, ..none },
        Step::Columns { .. } => none,
        Step::Standardise { .. } => Operations { arithmetic: 5.0 * n + 4.0, activations: 1.0, ..none },
        Step::Softmax { .. } => Operations { arithmetic: 3.0 * n, exponentials: n, comparisons: n, ..none },
        Step::Forest { forest, .. } => {
            let mut levels = vec![0.0f64; forest.nodes.len()];
            // those below a node come after it
            for (index, node) in forest.nodes.iter().enumerate().rev().filter(|(_, node)| node.column != LEAF) {
                levels[index] = 1.0 + node.below.iter().map(|&below| levels[below as usize]).fold(0.0, f64::max);
            }
            let comparisons = forest.trees.iter().map(|tree| levels[tree.root as usize]).sum();
            Operations { arithmetic: forest.trees.len() as f64, comparisons, ..none }
        }
        Step::Products { products, .. } => {
            let factors = products.degrees.iter().filter(|degree| **degree > 0).count();
            let polynomials = 9 * products.orders().saturating_sub(2) * products.inputs;
            Operations { arithmetic: (polynomials + factors) as f64, ..none }
        }
    }
}
