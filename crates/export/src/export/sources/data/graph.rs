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
    graph::{Elementwise, Forest, Graph, LEAF, Node, Operation, Products, Step, Tree},
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

/// Numbers of a graph up to those of a step.
struct StepLayout<'a> {
    /// First number of the columns and of each step.
    begins: &'a [usize],
    widths: &'a [usize],
}

impl StepLayout<'_> {
    /// First number of the step.
    fn begin(&self) -> usize {
        self.begins[self.begins.len() - 1]
    }

    /// How many numbers the step has.
    fn count(&self) -> usize {
        self.widths[self.begins.len() - 1]
    }

    /// The row of a step that has no numbers.
    fn row(&self, kind: &'static str, of: usize) -> StepRow {
        StepRow {
            kind,
            function: "FUNCTION_TANH".into(),
            operation: 0,
            of: [self.begins[of]; 3],
            width: self.widths[of],
            numbers: "NULL".into(),
            parameter_step: 0,
            more: "NULL".into(),
            places: "NULL".into(),
            trees: [0; 2],
            degrees: "NULL".into(),
            orders: 0,
        }
    }
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
        table(
            data,
            "const GraphNode model_graph_nodes",
            nodes.iter().map(|Node { column, number, below: [first, second] }| {
                let column = if *column == LEAF { "NO_COLUMN".into() } else { column.to_string() };
                format!("{column}, {}, {{{first}, {second}}}", real(*number))
            }),
            "NO_COLUMN, 0.0, {0, 0}",
        );
        table(
            data,
            "const GraphTree model_graph_trees",
            trees.iter().map(|Tree { root, output }| format!("{root}, {output}")),
            "0, 0",
        );
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
            self.add(step, &StepLayout { begins: &begins, widths: &widths });
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

    fn add(&mut self, step: &Step, layout: &StepLayout) {
        let row = self.row(step, layout);
        let (begin, count) = (layout.begin(), layout.count());
        self.operations = of_step(step, row.width, count).times(1.0, self.operations);
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

    fn row(&mut self, step: &Step, layout: &StepLayout) -> StepRow {
        match step {
            Step::Affine { of, weight, bias } => {
                let weights = in_blocks(&weight.iter().collect::<Vec<f64>>(), layout.widths[*of]);
                let bias: Vec<f64> = bias.iter().collect();
                StepRow {
                    numbers: self.array("weights", &weights),
                    more: self.array("bias", &bias),
                    ..layout.row("STEP_AFFINE", *of)
                }
            }
            Step::Elementwise { of, function, parameters } => {
                self.elementwise(*function, parameters, layout.row("STEP_ELEMENTWISE", *of))
            }
            Step::Combine { of: [a, b], operation } => {
                let place = Operation::ALL.iter().position(|known| known == operation);
                let operation = place.expect("all of them are listed");
                let of = [layout.begins[*a], layout.begins[*b], 0];
                StepRow { operation, of, ..layout.row("STEP_COMBINE", *a) }
            }
            Step::Select { of: [condition, a, b] } => {
                StepRow { of: [*condition, *a, *b].map(|of| layout.begins[of]), ..layout.row("STEP_SELECT", *a) }
            }
            Step::Columns { columns } => self.columns(columns, layout),
            Step::Standardize { of, mean, scale } => {
                let per_scale: Vec<f64> = scale.iter().map(|scale| 1.0 / scale).collect();
                StepRow {
                    numbers: self.array("mean", mean),
                    more: self.array("per_scale", &per_scale),
                    ..layout.row("STEP_STANDARDIZE", *of)
                }
            }
            Step::Rescale { of, mean, scale } => StepRow {
                numbers: self.array("mean", mean),
                more: self.array("scale", scale),
                ..layout.row("STEP_RESCALE", *of)
            },
            Step::Normalize { of, epsilon } => {
                StepRow { more: self.array("epsilon", &[*epsilon]), ..layout.row("STEP_NORMALIZE", *of) }
            }
            Step::Softmax { of } => layout.row("STEP_SOFTMAX", *of),
            Step::Distances { of, centres, lengths } => {
                let per_length: Vec<f64> = lengths.iter().map(|length| 1.0 / length).collect();
                StepRow {
                    numbers: self.array("centres", centres),
                    more: self.array("per_length", &per_length),
                    ..layout.row("STEP_DISTANCES", *of)
                }
            }
            Step::Forest { of, forest, .. } => {
                StepRow { trees: self.add_forest(forest), ..layout.row("STEP_FOREST", *of) }
            }
            Step::Products { of, products } => {
                let degrees = self.degrees(products);
                StepRow { degrees, orders: products.orders(), ..layout.row("STEP_PRODUCTS", *of) }
            }
            Step::Dictionary { of, .. } => layout.row("STEP_DICTIONARY", *of),
            Step::Call { .. } | Step::Interpolate { .. } | Step::Motion { .. } => {
                unreachable!("graphs that are called are laid out step by step, others have separate sources")
            }
        }
    }

    /// Name of an array of numbers of the next row, which it writes.
    fn array(&mut self, what: &str, values: &[f64]) -> String {
        let name = format!("{what}_{}", self.rows.len());
        array(&mut self.data, &format!("static const Real {name}"), values);
        name
    }

    fn elementwise(&mut self, function: Elementwise, parameters: &[f64], row: StepRow) -> StepRow {
        let is_each = parameters.len() > function.parameters();
        // there are always two, so that nothing else is read
        let (count, each) = (function.parameters(), if is_each { row.width } else { 1 });
        let mut both = parameters.to_vec();
        both.resize(each * 2.max(count), 0.0);
        StepRow {
            function: self::function(function),
            numbers: self.array("parameters", &both),
            parameter_step: usize::from(is_each),
            ..row
        }
    }

    fn columns(&mut self, columns: &[[u32; 2]], layout: &StepLayout) -> StepRow {
        let places: Vec<String> =
            columns.iter().map(|[of, column]| (layout.begins[*of as usize] + *column as usize).to_string()).collect();
        let name = format!("places_{}", self.rows.len());
        push(&mut self.data, format_args!("\nstatic const size_t {name}[] = {{{}}};\n", places.join(", ")));
        StepRow { places: name, ..layout.row("STEP_COLUMNS", 0) }
    }

    /// Position of the first tree of a forest, and the number of its trees.
    fn add_forest(&mut self, forest: &Forest) -> [usize; 2] {
        let (first_node, first_tree) = (self.nodes.len() as u32, self.trees.len());
        self.nodes.extend(forest.nodes.iter().map(|node| match node.column {
            LEAF => *node,
            _ => Node { below: node.below.map(|below| below + first_node), ..*node },
        }));
        self.trees.extend(forest.trees.iter().map(|tree| Tree { root: tree.root + first_node, ..*tree }));
        [first_tree, forest.trees.len()]
    }

    /// Name of the array of the degrees of products, which it writes.
    fn degrees(&mut self, products: &Products) -> String {
        let name = format!("degrees_{}", self.rows.len());
        push(&mut self.data, format_args!("\nstatic const unsigned char {name}[] = {{\n"));
        for term in products.degrees.chunks(products.inputs) {
            let term: Vec<String> = term.iter().map(u8::to_string).collect();
            push(&mut self.data, format_args!("    {},\n", term.join(", ")));
        }
        self.data.push_str("};\n");
        name
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
    weights
        .chunks(BLOCK * columns.max(1))
        .flat_map(|block| -> Vec<f64> {
            (0..columns).flat_map(|column| block.iter().skip(column).step_by(columns).copied()).collect()
        })
        .collect()
}

/// Sums of the magnitudes of the terms of each output where these are at most one times a weight: Legendre polynomials and Gaussian
/// kernels. None of other outputs.
pub(super) fn sums(graph: &Graph) -> Vec<f64> {
    match graph.steps.as_slice() {
        [steps @ .., Step::Columns { columns }] => columns
            .iter()
            .map(|[of, column]| {
                let step =
                    (*of as usize).checked_sub(1).map(|number| sums_of_step(graph, &steps[number])).unwrap_or_default();
                step.get(*column as usize).copied().unwrap_or(0.0)
            })
            .collect(),
        steps => steps.last().map(|step| sums_of_step(graph, step)).unwrap_or_default(),
    }
}

/// The sums of a step that is a linear function of bounded numbers; none of others.
fn sums_of_step(graph: &Graph, step: &Step) -> Vec<f64> {
    match step {
        Step::Affine { of, weight, bias } if is_bounded(graph, *of) => {
            let weights: Vec<f64> = weight.iter().map(f64::abs).collect();
            let rows = weights.chunks(weights.len() / bias.len()).map(|row| row.iter().sum::<f64>());
            rows.zip(bias.iter()).map(|(sum, bias)| sum + bias.abs()).collect()
        }
        _ => Vec::new(),
    }
}

/// Returns true if no number of a value is larger than one.
fn is_bounded(graph: &Graph, of: usize) -> bool {
    let step = of.checked_sub(1).and_then(|number| graph.steps.get(number));
    matches!(step, Some(Step::Products { .. } | Step::Elementwise { function: Elementwise::Gaussian, .. }))
}

/// Tape of a dictionary without fixed inputs.
fn listing(dictionary: &Dictionary) -> Listing {
    FunctionSet::from(dictionary.clone()).listing(0..0)
}

/// The counts that `graph.c` states.
fn of_step(step: &Step, width: usize, count: usize) -> Operations {
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
