//! A surrogate without a state as an ONNX model: nobody is locked in.
//!
//! The model has one input, `inputs`, a row of all inputs of the surrogate for each point, and one output, `outputs`.
//! Names, units and ranges are in the model's metadata. It computes in double precision unless the surrogate uses
//! single; operators that ONNX Runtime has in single precision only are composed of others. The operators are those of
//! opset 17 and of `ai.onnx.ml` 3.

use crate::{
    Error, Result,
    import::onnx::proto::{
        AttributeProto, DOUBLE, DimensionProto, FLOAT, GraphProto, INT64, ModelProto, NodeProto, OperatorSetIdProto,
        ShapeProto, StringStringEntryProto, TensorProto, TensorTypeProto, TypeProto, ValueInfoProto,
    },
};
use metafmu_runtime::{
    Activation, Clock, Encoding, Graph, Input, Precision, Program, Surrogate,
    graph::{Elementwise, Forest, LEAF, Operation, Products, Step},
};
use prost::Message;
use std::f64::consts::TAU;

const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;
const MACHINE_LEARNING: &str = "ai.onnx.ml";

/// The bytes of the ONNX model; the same surrogate always gives the same.
///
/// # Errors
/// [`Error::NoOnnx`] if the surrogate has states, a memory, a network for each time point, or sums of products.
pub fn onnx(surrogate: &Surrogate) -> Result<Vec<u8>> {
    let Program { graph, clock: Clock::Static } = surrogate.program() else {
        return Err(Error::NoOnnx);
    };
    let has_nodes =
        |step: &Step| !matches!(step, Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. });
    if !graph.steps.iter().all(has_nodes) {
        return Err(Error::NoOnnx);
    }
    let is_single = surrogate.metadata().precision == Precision::Single && graph.is_network();
    let mut writer = OnnxWriter { is_single, nodes: Vec::new(), constants: Vec::new() };
    let columns = writer.columns(surrogate.inputs());
    let outputs = writer.graph(graph, columns);
    writer.add("Identity", &[&outputs], Vec::new(), "outputs");
    Ok(writer.model(surrogate).encode_to_vec())
}

/// Nodes and constants of a graph that is being written; their results are named by numbers.
struct OnnxWriter {
    is_single: bool,
    nodes: Vec<NodeProto>,
    constants: Vec<TensorProto>,
}

impl OnnxWriter {
    fn kind(&self) -> i32 {
        if self.is_single { FLOAT } else { DOUBLE }
    }

    // ---- nodes

    fn add(&mut self, operator: &str, inputs: &[&str], attribute: Vec<AttributeProto>, output: &str) {
        let is_ml = operator.starts_with("TreeEnsemble");
        self.nodes.push(NodeProto {
            input: inputs.iter().map(|&name| name.into()).collect(),
            output: vec![output.into()],
            name: format!("{operator}_{}", self.nodes.len()),
            op_type: operator.into(),
            attribute,
            domain: if is_ml { MACHINE_LEARNING.into() } else { String::new() },
        });
    }

    fn with(&mut self, operator: &str, inputs: &[&str], attribute: Vec<AttributeProto>) -> String {
        let output = format!("v{}", self.nodes.len());
        self.add(operator, inputs, attribute, &output);
        output
    }

    fn of(&mut self, operator: &str, inputs: &[&str]) -> String {
        self.with(operator, inputs, Vec::new())
    }

    /// A constant of real numbers.
    fn reals(&mut self, shape: &[usize], values: &[f64]) -> String {
        let raw_data = match self.is_single {
            true => values.iter().flat_map(|value| (*value as f32).to_le_bytes()).collect(),
            false => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        };
        self.constant(self.kind(), shape, raw_data)
    }

    /// A single real number.
    fn real(&mut self, value: f64) -> String {
        self.reals(&[], &[value])
    }

    fn integers(&mut self, values: &[i64]) -> String {
        self.constant(INT64, &[values.len()], values.iter().flat_map(|value| value.to_le_bytes()).collect())
    }

    fn constant(&mut self, data_type: i32, shape: &[usize], raw_data: Vec<u8>) -> String {
        let name = format!("c{}", self.constants.len());
        let dims = shape.iter().map(|dim| *dim as i64).collect();
        self.constants.push(TensorProto { dims, data_type, name: name.clone(), raw_data, ..Default::default() });
        name
    }

    // ---- functions

    fn binary(&mut self, operator: &str, a: &str, number: f64) -> String {
        let number = self.real(number);
        self.of(operator, &[a, &number])
    }

    /// `factor x + offset`, with one of each or one for each column.
    fn linear(&mut self, x: &str, factors: &[f64], offsets: &[f64]) -> String {
        let (factors, offsets) = (self.reals(&[factors.len()], factors), self.reals(&[offsets.len()], offsets));
        let product = self.of("Mul", &[x, &factors]);
        self.of("Add", &[&product, &offsets])
    }

    fn picked(&mut self, x: &str, columns: &[i64]) -> String {
        let columns = self.integers(columns);
        self.with("Gather", &[x, &columns], vec![integer("axis", 1)])
    }

    fn joined(&mut self, parts: &[String]) -> String {
        match parts {
            [one] => one.clone(),
            parts => {
                let names: Vec<&str> = parts.iter().map(String::as_str).collect();
                self.with("Concat", &names, vec![integer("axis", 1)])
            }
        }
    }

    fn affine(&mut self, x: &str, weight: &[f64], bias: &[f64]) -> String {
        let inputs = weight.len() / bias.len();
        let (weight, bias) = (self.reals(&[bias.len(), inputs], weight), self.reals(&[bias.len()], bias));
        self.with("Gemm", &[x, &weight, &bias], vec![integer("transB", 1)])
    }

    /// The columns of the inputs after their encoding.
    fn columns(&mut self, inputs: &[Input]) -> String {
        if inputs.iter().all(|input| input.encoding.is_plain()) {
            return "inputs".into();
        }
        let mut parts = Vec::new();
        for (place, Input { min, max, encoding, .. }) in inputs.iter().enumerate() {
            let x = self.picked("inputs", &[place as i64]);
            match encoding {
                Encoding::Plain => parts.push(x),
                Encoding::Periodic => {
                    let from_min = self.binary("Sub", &x, *min);
                    let angle = self.binary("Mul", &from_min, TAU / (max - min));
                    parts.push(self.of("Sin", &[&angle]));
                    parts.push(self.of("Cos", &[&angle]));
                }
                Encoding::Nominal(values) => {
                    let known = self.reals(&[1, values.len()], values);
                    let difference = self.of("Sub", &[&x, &known]);
                    let distance = self.of("Abs", &[&difference]);
                    let nearest = self.with("ArgMin", &[&distance], vec![integer("axis", 1), integer("keepdims", 1)]);
                    let places: Vec<i64> = (0..values.len() as i64).collect();
                    let places = self.integers(&places);
                    let is_nearest = self.of("Equal", &[&nearest, &places]);
                    parts.push(self.with("Cast", &[&is_nearest], vec![integer("to", self.kind().into())]));
                }
            }
        }
        self.joined(&parts)
    }

    /// [`Activation::onnx`] of a value.
    fn activation(&mut self, activation: Activation, x: &str) -> String {
        let mut operands: Vec<String> = Vec::new();
        for word in activation.onnx().split(' ') {
            let operand = match (word, word.parse()) {
                ("x", _) => x.to_owned(),
                (_, Ok(number)) => self.real(number),
                (operator, Err(_)) => {
                    let count = if matches!(operator, "Add" | "Mul") { 2 } else { 1 };
                    let of = operands.split_off(operands.len() - count);
                    self.of(operator, &of.iter().map(String::as_str).collect::<Vec<&str>>())
                }
            };
            operands.push(operand);
        }
        operands.pop().expect("a formula has a result")
    }

    /// Legendre polynomials of all columns by Bonnet's recursion, and their products.
    fn products(&mut self, products: &Products, z: &str) -> String {
        let inputs = products.inputs;
        let mut of_degree = vec![self.linear(z, &[0.0], &[1.0]), z.to_owned()];
        for k in 1..products.orders().saturating_sub(1) {
            let (k, next) = (k as f64, k as f64 + 1.0);
            let before = of_degree.len() - 2;
            let product = self.of("Mul", &[z, &of_degree[before + 1]]);
            let first = self.binary("Mul", &product, (2.0 * k + 1.0) / next);
            let second = self.binary("Mul", &of_degree[before], k / next);
            of_degree.push(self.of("Sub", &[&first, &second]));
        }
        let all = self.joined(&of_degree);
        let mut product: Option<String> = None;
        for input in 0..inputs {
            let places: Vec<i64> = (0..products.terms())
                .map(|term| i64::from(products.degrees[term * inputs + input]) * inputs as i64 + input as i64)
                .collect();
            let factor = self.picked(&all, &places);
            product = Some(match product {
                None => factor,
                Some(product) => self.of("Mul", &[&product, &factor]),
            });
        }
        product.unwrap_or(all)
    }

    fn distances(&mut self, x: &str, centres: &[f64], lengths: &[f64]) -> String {
        let axis = self.integers(&[1]);
        let rows = self.of("Unsqueeze", &[x, &axis]);
        let centres = self.reals(&[1, centres.len() / lengths.len(), lengths.len()], centres);
        let lengths = self.reals(&[lengths.len()], lengths);
        let difference = self.of("Sub", &[&rows, &centres]);
        let relative = self.of("Div", &[&difference, &lengths]);
        let square = self.of("Mul", &[&relative, &relative]);
        let axes = self.integers(&[2]);
        self.with("ReduceSum", &[&square, &axes], vec![integer("keepdims", 0)])
    }

    fn forest(&mut self, forest: &Forest, x: &str, outputs: usize) -> String {
        let count = forest.nodes.len();
        let mut tree_of = vec![0i64; count];
        let mut targets: Vec<(i64, i64, i64, f64)> = Vec::new();
        for (number, tree) in forest.trees.iter().enumerate() {
            let mut waiting = vec![tree.root];
            while let Some(place) = waiting.pop() {
                let node = &forest.nodes[place as usize];
                tree_of[place as usize] = number as i64;
                match node.column {
                    LEAF => targets.push((number as i64, place.into(), tree.output.into(), node.number)),
                    _ => waiting.extend(node.below),
                }
            }
        }
        // the first node of each tree is its root; nodes of a tree are together, as the forest has them
        let (mut modes, mut columns, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
        let [mut first, mut second] = [Vec::new(), Vec::new()];
        for node in &forest.nodes {
            let is_leaf = node.column == LEAF;
            modes.push(if is_leaf { b"LEAF".to_vec() } else { b"BRANCH_LEQ".to_vec() });
            columns.push(if is_leaf { 0 } else { node.column.into() });
            numbers.push(if is_leaf { 0.0 } else { node.number });
            let below = if is_leaf { [0; 2] } else { node.below.map(i64::from) };
            first.push(below[0]);
            second.push(below[1]);
        }
        let weights: Vec<f64> = targets.iter().map(|(.., weight)| *weight).collect();
        let attributes = vec![
            integers("nodes_treeids", tree_of.clone()),
            integers("nodes_nodeids", (0..count as i64).collect()),
            integers("nodes_featureids", columns),
            tensor("nodes_values_as_tensor", &numbers),
            AttributeProto { name: "nodes_modes".into(), strings: modes, kind: 8, ..Default::default() },
            integers("nodes_truenodeids", first),
            integers("nodes_falsenodeids", second),
            integers("target_treeids", targets.iter().map(|target| target.0).collect()),
            integers("target_nodeids", targets.iter().map(|target| target.1).collect()),
            integers("target_ids", targets.iter().map(|target| target.2).collect()),
            tensor("target_weights_as_tensor", &weights),
            integer("n_targets", outputs as i64),
        ];
        // ONNX Runtime sums double trees in double and gives singles
        let found = self.with("TreeEnsembleRegressor", &[x], attributes);
        self.with("Cast", &[&found], vec![integer("to", self.kind().into())])
    }

    // ---- graphs

    fn graph(&mut self, graph: &Graph, columns: String) -> String {
        let mut values = vec![columns];
        for step in &graph.steps {
            let made = self.step(step, &values);
            values.push(made);
        }
        values.pop().expect("a graph has its inputs")
    }

    fn step(&mut self, step: &Step, values: &[String]) -> String {
        match step {
            Step::Affine { of, weight, bias } => {
                let (weight, bias): (Vec<f64>, Vec<f64>) = (weight.iter().collect(), bias.iter().collect());
                self.affine(&values[*of], &weight, &bias)
            }
            Step::Elementwise { of, function, parameters } => self.elementwise(&values[*of], *function, parameters),
            Step::Combine { of: [a, b], operation } => {
                let operator = match operation {
                    Operation::Add => "Add",
                    Operation::Subtract => "Sub",
                    Operation::Multiply => "Mul",
                    Operation::Divide => "Div",
                    Operation::Maximum => "Max",
                    Operation::Minimum => "Min",
                };
                self.of(operator, &[&values[*a], &values[*b]])
            }
            Step::Select { of: [condition, a, b] } => {
                let zero = self.real(0.0);
                let chosen = self.of("Greater", &[&values[*condition], &zero]);
                self.of("Where", &[&chosen, &values[*a], &values[*b]])
            }
            Step::Columns { columns } => {
                let mut parts: Vec<String> = Vec::new();
                // stretches of columns of one value
                let mut rest = columns.as_slice();
                while let Some([of, _]) = rest.first() {
                    let length = rest.iter().take_while(|[other, _]| other == of).count();
                    let places: Vec<i64> = rest[..length].iter().map(|[_, column]| (*column).into()).collect();
                    parts.push(self.picked(&values[*of as usize], &places));
                    rest = &rest[length..];
                }
                self.joined(&parts)
            }
            Step::Standardize { of, mean, scale } => {
                if mean.iter().all(|mean| *mean == 0.0) && scale.iter().all(|scale| *scale == 1.0) {
                    return values[*of].clone();
                }
                let (mean, scale) = (self.reals(&[mean.len()], mean), self.reals(&[scale.len()], scale));
                let difference = self.of("Sub", &[&values[*of], &mean]);
                self.of("Div", &[&difference, &scale])
            }
            Step::Rescale { of, mean, scale } => self.linear(&values[*of], scale, mean),
            Step::Normalize { of, epsilon } => {
                let mean = self.with("ReduceMean", &[&values[*of]], vec![integers("axes", vec![1])]);
                let difference = self.of("Sub", &[&values[*of], &mean]);
                let square = self.of("Mul", &[&difference, &difference]);
                let variance = self.with("ReduceMean", &[&square], vec![integers("axes", vec![1])]);
                let variance = self.binary("Add", &variance, *epsilon);
                let deviation = self.of("Sqrt", &[&variance]);
                self.of("Div", &[&difference, &deviation])
            }
            Step::Softmax { of } => self.with("Softmax", &[&values[*of]], vec![integer("axis", 1)]),
            Step::Distances { of, centres, lengths } => self.distances(&values[*of], centres, lengths),
            Step::Forest { of, forest, outputs } => self.forest(forest, &values[*of], *outputs),
            Step::Products { of, products } => self.products(products, &values[*of]),
            Step::Call { of, function } => self.graph(function, values[*of].clone()),
            Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. } => {
                unreachable!("a program without a clock and instants has none")
            }
        }
    }

    /// In operators that ONNX Runtime has in double precision, too.
    fn elementwise(&mut self, x: &str, function: Elementwise, parameters: &[f64]) -> String {
        let count = function.parameters().max(1);
        let rows: Vec<&[f64]> = parameters.chunks(parameters.len().div_ceil(count).max(1)).collect();
        let [first, second] = [0, 1].map(|number| rows.get(number).copied().unwrap_or(&[0.0]));
        match function {
            Elementwise::Activation(activation) => self.activation(activation, x),
            Elementwise::Linear => self.linear(x, first, second),
            Elementwise::Cosine => self.of("Cos", &[x]),
            Elementwise::Exponential => self.of("Exp", &[x]),
            Elementwise::Gaussian => {
                let exponent = self.binary("Mul", x, -0.5);
                self.of("Exp", &[&exponent])
            }
            Elementwise::Logarithm => self.of("Log", &[x]),
            Elementwise::Reciprocal => self.of("Reciprocal", &[x]),
            Elementwise::Absolute => self.of("Abs", &[x]),
            Elementwise::Power => {
                let exponents = self.reals(&[first.len()], first);
                self.of("Pow", &[x, &exponents])
            }
            Elementwise::Erf => self.erf(x),
            Elementwise::GeluExact => {
                let argument = self.binary("Mul", x, std::f64::consts::FRAC_1_SQRT_2);
                let erf = self.erf(&argument);
                let half = self.linear(&erf, &[0.5], &[0.5]);
                self.of("Mul", &[x, &half])
            }
            Elementwise::LeakyRelu => {
                let (above, below) = (self.binary("Max", x, 0.0), self.binary("Min", x, 0.0));
                let slopes = self.reals(&[first.len()], first);
                let below = self.of("Mul", &[&below, &slopes]);
                self.of("Add", &[&above, &below])
            }
            Elementwise::Elu => {
                let (above, below) = (self.binary("Max", x, 0.0), self.binary("Min", x, 0.0));
                let power = self.of("Exp", &[&below]);
                let less = self.binary("Sub", &power, 1.0);
                let factors = self.reals(&[first.len()], first);
                let below = self.of("Mul", &[&less, &factors]);
                self.of("Add", &[&above, &below])
            }
            Elementwise::Softplus => {
                let above = self.binary("Max", x, 0.0);
                let magnitude = self.of("Abs", &[x]);
                let negative = self.of("Neg", &[&magnitude]);
                let power = self.of("Exp", &[&negative]);
                let sum = self.binary("Add", &power, 1.0);
                let logarithm = self.of("Log", &[&sum]);
                self.of("Add", &[&above, &logarithm])
            }
            Elementwise::Softsign => {
                let magnitude = self.of("Abs", &[x]);
                let sum = self.binary("Add", &magnitude, 1.0);
                self.of("Div", &[x, &sum])
            }
            Elementwise::Clip => {
                let (least, most) = (self.reals(&[first.len()], first), self.reals(&[second.len()], second));
                let above = self.of("Max", &[x, &least]);
                self.of("Min", &[&above, &most])
            }
            Elementwise::ThresholdedRelu => {
                let thresholds = self.reals(&[first.len()], first);
                let is_above = self.of("Greater", &[x, &thresholds]);
                let is_above = self.with("Cast", &[&is_above], vec![integer("to", self.kind().into())]);
                self.of("Mul", &[x, &is_above])
            }
            Elementwise::Positive => {
                let zero = self.real(0.0);
                let is_positive = self.of("Greater", &[x, &zero]);
                self.with("Cast", &[&is_positive], vec![integer("to", self.kind().into())])
            }
            Elementwise::Arctangent => self.in_single("Atan", x),
            Elementwise::Single => {
                let single = self.with("Cast", &[x], vec![integer("to", FLOAT.into())]);
                self.with("Cast", &[&single], vec![integer("to", self.kind().into())])
            }
        }
    }

    fn erf(&mut self, x: &str) -> String {
        self.in_single("Erf", x)
    }

    /// An operator that ONNX Runtime has in single precision only.
    fn in_single(&mut self, operator: &str, x: &str) -> String {
        let single = self.with("Cast", &[x], vec![integer("to", FLOAT.into())]);
        let made = self.of(operator, &[&single]);
        self.with("Cast", &[&made], vec![integer("to", self.kind().into())])
    }

    fn model(self, surrogate: &Surrogate) -> ModelProto {
        let (kind, inputs, outputs) = (self.kind(), surrogate.inputs(), surrogate.outputs());
        let entries = [
            ("input_names", json(inputs.iter().map(|input| input.name.clone()))),
            ("input_units", json(inputs.iter().map(|input| input.unit.clone()))),
            ("input_min", json(inputs.iter().map(|input| input.min))),
            ("input_max", json(inputs.iter().map(|input| input.max))),
            ("output_names", json(outputs.iter().map(|output| output.name.clone()))),
            ("output_units", json(outputs.iter().map(|output| output.unit.clone()))),
            ("content_digest", surrogate.metadata().provenance.content_digest.clone()),
        ];
        let graph = GraphProto {
            name: surrogate.metadata().name.clone(),
            input: vec![batch_of_rows("inputs", inputs.len(), kind)],
            output: vec![batch_of_rows("outputs", outputs.len(), kind)],
            node: self.nodes,
            initializer: self.constants,
        };
        ModelProto {
            ir_version: IR_VERSION,
            producer_name: "metafmu".into(),
            producer_version: env!("CARGO_PKG_VERSION").into(),
            graph: Some(graph),
            opset_import: vec![operator_set("", OPSET), operator_set(MACHINE_LEARNING, 3)],
            metadata_props: entries.map(|(key, value)| StringStringEntryProto { key: key.into(), value }).into(),
        }
    }
}

fn operator_set(domain: &str, version: i64) -> OperatorSetIdProto {
    OperatorSetIdProto { domain: domain.into(), version }
}

/// Description of rows of numbers, of which there may be any count.
fn batch_of_rows(name: &str, columns: usize, kind: i32) -> ValueInfoProto {
    ValueInfoProto {
        name: name.into(),
        r#type: Some(TypeProto {
            tensor_type: Some(TensorTypeProto {
                elem_type: kind,
                shape: Some(ShapeProto {
                    dim: vec![
                        DimensionProto { dim_value: None, dim_param: Some("points".into()) },
                        DimensionProto { dim_value: Some(columns as i64), dim_param: None },
                    ],
                }),
            }),
        }),
    }
}

/// List of JSON values as text.
fn json<V: Into<serde_json::Value>>(values: impl Iterator<Item = V>) -> String {
    serde_json::Value::from(values.map(Into::into).collect::<Vec<serde_json::Value>>()).to_string()
}

fn integer(name: &str, value: i64) -> AttributeProto {
    AttributeProto { name: name.into(), i: Some(value), kind: 2, ..Default::default() }
}

fn integers(name: &str, values: Vec<i64>) -> AttributeProto {
    AttributeProto { name: name.into(), ints: values, kind: 7, ..Default::default() }
}

fn tensor(name: &str, values: &[f64]) -> AttributeProto {
    let t = TensorProto {
        dims: vec![values.len() as i64],
        data_type: DOUBLE,
        name: name.into(),
        raw_data: values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        ..Default::default()
    };
    AttributeProto { name: name.into(), t: Some(t), kind: 4, ..Default::default() }
}
