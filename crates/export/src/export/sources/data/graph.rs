//! Numbers of a graph.

use super::{
    array, enumerator,
    maps::MapPart,
    network::{ACTIVATIONS, BLOCK, BLOCK_SIZE, padded},
    operations::Operations,
    push, real, table,
    tape::{self, index_type},
};
use metafmu_runtime::{
    dictionary::Dictionary,
    function_set::FunctionSet,
    graph::{Elementwise, Graph, LEAF, Node, Operation, Step, Tree},
    listing::Listing,
};

/// A step in the form of `graph.h`; unused numbers are zero.
struct StepRow {
    kind: &'static str,
    function: String,
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

/// Generated data of a graph. `graph.c` and `graph_steps.h` have the formulas.
#[derive(Default)]
pub(super) struct GraphSources {
    pub defines: Vec<(&'static str, String)>,
    pub names: Vec<&'static str>,
    pub sizes: Vec<(&'static str, usize, &'static str)>,
    pub data: String,
    /// Operations of an evaluation.
    pub operations: Operations,
    rows: Vec<String>,
    nodes: Vec<Node>,
    trees: Vec<Tree>,
    /// Number of numbers that are laid out.
    numbers: usize,
    has_dictionary: bool,
}

/// A graph without states as a map.
pub fn map(graph: &Graph) -> MapPart {
    let GraphSources { defines, names, sizes, data, operations, .. } = GraphSources::of(graph);
    MapPart { header: "graph.h", defines, names, sizes, data, operations, formula: "graph.c and graph_steps.h have" }
}

impl GraphSources {
    pub fn of(graph: &Graph) -> Self {
        let mut sources = Self { numbers: graph.inputs, ..Self::default() };
        sources.lay(graph, 0);
        let Self { rows, nodes, trees, data, sizes, numbers, .. } = &mut sources;
        let of_node = |Node { column, number, below: [first, second] }: &Node| {
            let column = if *column == LEAF { "NO_COLUMN".into() } else { column.to_string() };
            format!("{column}, {}, {{{first}, {second}}}", real(*number))
        };
        table(data, "const GraphNode model_graph_nodes", nodes.iter().map(of_node), "NO_COLUMN, 0.0, {0, 0}");
        let of_tree = |Tree { root, output }: &Tree| format!("{root}, {output}");
        table(data, "const GraphTree model_graph_trees", trees.iter().map(of_tree), "0, 0");
        sizes.extend([
            BLOCK_SIZE,
            ("STEP_COUNT", rows.len(), ""),
            ("NUMBER_COUNT", *numbers, "of the columns and of all steps"),
        ]);
        table(data, "const GraphStep model_steps", rows.drain(..), "");
        sources.names.extend(ACTIVATIONS);
        sources.names.extend(["jet_graph", "model_graph_nodes", "model_graph_trees", "model_steps", "real_graph"]);
        sources.defines.push(("MODEL_HAS_DICTIONARY", u8::from(sources.has_dictionary).to_string()));
        sources
    }

    /// Lays out the steps of a graph whose columns begin somewhere; the result is where its outputs do.
    fn lay(&mut self, graph: &Graph, columns: usize) -> usize {
        let widths = graph.widths().expect("a surrogate's graph was checked");
        let mut begins = vec![columns];
        for (number, step) in graph.steps.iter().enumerate() {
            // a graph that is called is part of this one
            if let Step::Call { of, function } = step {
                begins.push(self.lay(function, begins[*of]));
                continue;
            }
            // notes of a step stand before its value: the last numbers are the outputs
            let noted = match step {
                Step::Dictionary { dictionary, .. } => self.add_tape(&listing(dictionary)),
                _ => step.noted(),
            };
            let begin = self.numbers + noted;
            self.numbers = begin + widths[number + 1];
            begins.push(begin);
            self.add(step, (&begins, &widths));
        }
        begins[graph.steps.len()]
    }

    /// The number of its registers.
    fn add_tape(&mut self, listing: &Listing) -> usize {
        tape::write(&mut self.data, "functions", listing);
        self.has_dictionary = true;
        self.defines.push(index_type(&[listing]));
        self.names.push("model_functions");
        self.sizes.push(("FUNCTION_REGISTERS", listing.registers, "of the tape"));
        listing.registers
    }

    fn add(&mut self, step: &Step, (begins, widths): (&[usize], &[usize])) {
        let number = begins.len() - 1;
        let (begin, count) = (begins[number], widths[number]);
        let row = row(step, self.rows.len(), (begins, widths), &mut self.data, (&mut self.nodes, &mut self.trees));
        self.operations = of_step(step, (row.width, count)).times(1.0, self.operations);
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
        self.rows.push(format!(
            "{kind}, {function}, (Combination){operation}, {{{a}, {b}, {c}}}, {width}, {begin}, {count}, {numbers}, \
             {parameter_step}, {more}, {places}, {}, {}, {degrees}, {orders}",
            trees[0], trees[1]
        ));
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
        function: "FUNCTION_TANH".into(),
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
            let is_each = parameters.len() > function.parameters();
            // there are always two, so that nothing else is read
            let (count, each) = (function.parameters(), if is_each { widths[*of] } else { 1 });
            let mut both = parameters.clone();
            both.resize(each * 2.max(count), 0.0);
            StepRow {
                function: self::function(*function),
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
        Step::Standardize { of, mean, scale } => {
            let per_scale: Vec<f64> = scale.iter().map(|scale| 1.0 / scale).collect();
            StepRow {
                numbers: numbers("mean", mean),
                more: numbers("per_scale", &per_scale),
                ..row("STEP_STANDARDIZE", *of)
            }
        }
        Step::Rescale { of, mean, scale } => {
            StepRow { numbers: numbers("mean", mean), more: numbers("scale", scale), ..row("STEP_RESCALE", *of) }
        }
        Step::Normalize { of, epsilon } => {
            StepRow { more: numbers("epsilon", &[*epsilon]), ..row("STEP_NORMALIZE", *of) }
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
        Step::Dictionary { of, .. } => row("STEP_DICTIONARY", *of),
        Step::Call { .. } | Step::Interpolate { .. } | Step::Motion { .. } => {
            unreachable!("graphs that are called are laid out step by step, others have separate sources")
        }
    }
}

/// Name of a function's constant in `model_data.h`.
pub(super) fn function(function: Elementwise) -> String {
    match function {
        Elementwise::Activation(activation) => enumerator("FUNCTION", activation),
        other => enumerator("FUNCTION", other),
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

/// Tape of a dictionary without fixed inputs.
fn listing(dictionary: &Dictionary) -> Listing {
    FunctionSet::from(dictionary.clone()).listing(0..0)
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
        Step::Standardize { .. } | Step::Rescale { .. } => Operations { arithmetic: 2.0 * m, ..none },
        Step::Normalize { .. } => Operations { arithmetic: 5.0 * n + 4.0, activations: 1.0, ..none },
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
        Step::Dictionary { dictionary, .. } => {
            let [fixed, others, _] = tape::operations(&listing(dictionary));
            fixed.times(1.0, others)
        }
        Step::Call { .. } | Step::Interpolate { .. } | Step::Motion { .. } => none,
    }
}
