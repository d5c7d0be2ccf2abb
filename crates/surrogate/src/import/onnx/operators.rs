//! Operators: steps of the graph for each of them.

mod constants;
mod machine_learning;
mod normalization;
mod pairs;
mod products;
mod recurrent;
mod shapes;
mod windows;

use super::{
    GraphError, GraphReader, ImportError,
    attributes::Attributes,
    node::{RowTensor, Value, constant_row, is_standard, operator},
    proto::{DOUBLE, FLOAT, INT32, INT64, NodeProto, type_name},
    shape::{axis, broadcast, broadcast_places, places, strides},
    tensor::{ConstantTensor, Data, MAX_ELEMENTS, within_limits},
    trees::refuse_transform,
};
use metafmu_runtime::{
    Activation, Numbers,
    graph::{Elementwise, Operation, Step},
};

/// Operators of the standard set that are known here.
pub const STANDARD: [&str; 97] = [
    "Abs",
    "Add",
    "Atan",
    "BatchNormalization",
    "Cast",
    "Celu",
    "Clip",
    "Concat",
    "Constant",
    "ConstantOfShape",
    "Cos",
    "Div",
    "Dropout",
    "Elu",
    "Erf",
    "Exp",
    "Expand",
    "Flatten",
    "Gather",
    "Gelu",
    "Gemm",
    "HardSigmoid",
    "HardSwish",
    "Identity",
    "LayerNormalization",
    "LeakyRelu",
    "Log",
    "LogSoftmax",
    "MatMul",
    "Max",
    "Mean",
    "Min",
    "Mish",
    "Mul",
    "Neg",
    "PRelu",
    "Pow",
    "Range",
    "Reciprocal",
    "ReduceL1",
    "ReduceLogSumExp",
    "ReduceMax",
    "ReduceMean",
    "ReduceMin",
    "ReduceProd",
    "ReduceSum",
    "Relu",
    "Reshape",
    "Selu",
    "Shape",
    "Sigmoid",
    "Sin",
    "Size",
    "Slice",
    "Softmax",
    "Softplus",
    "Softsign",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Sum",
    "Swish",
    "Tan",
    "Tanh",
    "ThresholdedRelu",
    "Tile",
    "Transpose",
    "Unsqueeze",
    "CastLike",
    "Cosh",
    "Sinh",
    "ReduceSumSquare",
    "ReduceL2",
    "RMSNormalization",
    "And",
    "Greater",
    "GreaterOrEqual",
    "Less",
    "LessOrEqual",
    "Mod",
    "Not",
    "Or",
    "Sign",
    "Where",
    "AveragePool",
    "Conv",
    "GlobalAveragePool",
    "GlobalMaxPool",
    "MaxPool",
    "Pad",
    "Acos",
    "Asin",
    "Equal",
    "GroupNormalization",
    "InstanceNormalization",
    "ReduceLogSum",
];

/// Operators of `ai.onnx.ml` that are known here.
pub const MACHINE_LEARNING: [&str; 8] = [
    "ArrayFeatureExtractor",
    "FeatureVectorizer",
    "Imputer",
    "LinearRegressor",
    "Normalizer",
    "SVMRegressor",
    "Scaler",
    "TreeEnsembleRegressor",
];

pub const ML: &str = "ai.onnx.ml";

/// Returns true if an operator is supported.
pub fn is_known(node: &NodeProto) -> bool {
    match node.domain.as_str() {
        ML => MACHINE_LEARNING.contains(&node.op_type.as_str()),
        domain => {
            let name = node.op_type.as_str();
            is_standard(domain) && (STANDARD.contains(&name) || RECURRENT.contains(&name))
        }
    }
}

/// Advice on an operator, without its domain, that is not supported.
pub fn instead(operator: &str) -> String {
    match operator {
        "Scan" | "Loop" => {
            ": expected one step of the loop, with the state among the inputs and outputs of the graph".into()
        }
        "If" => ": expected a graph without branches".into(),
        "TreeEnsembleClassifier" | "LinearClassifier" | "SVMClassifier" | "ArgMax" | "ZipMap" => {
            ": expected a regression, whose outputs are real numbers".into()
        }
        operator => {
            let known = STANDARD.iter().chain(&RECURRENT).chain(&MACHINE_LEARNING).copied();
            crate::diagnostics::names::did_you_mean(operator, known) + "; docs/import.md lists those that are"
        }
    }
}

pub use recurrent::RECURRENT;

type Made = Result<Value, ImportError>;

impl GraphReader {
    /// Computes the output of a node.
    pub fn node(&mut self, node: &NodeProto) -> Result<(), ImportError> {
        let made = match node.domain.as_str() {
            ML => vec![self.machine_learning(node)?],
            _ if node.op_type == "Split" => self.split(node)?,
            _ if RECURRENT.contains(&node.op_type.as_str()) => self.recurrent(node)?,
            _ => vec![self.standard(node)?],
        };
        // a dropout's mask and the like are not given here
        if node.output.iter().all(String::is_empty) {
            return Err(ImportError::malformed("it gives nothing"));
        }
        for (place, name) in node.output.iter().enumerate().skip(made.len()).filter(|(_, name)| !name.is_empty()) {
            let of = if node.name.is_empty() { String::new() } else { format!(" of node `{}`", node.name) };
            let what =
                format!("output {place} of operator {}{of}, which is not supported: only its first is", operator(node));
            self.beside.insert(name.clone(), what);
        }
        for (name, value) in node.output.iter().zip(made).filter(|(name, _)| !name.is_empty()) {
            self.constants += value.constant().map_or(0, |tensor| tensor.data.len());
            if self.constants > MAX_ELEMENTS {
                return Err(ImportError::too_large(format!(
                    "constants of {} numbers up to here, expected at most {MAX_ELEMENTS}",
                    self.constants
                )));
            }
            if self.values.insert(name.clone(), value).is_some() {
                return Err(ImportError::malformed(format!("output `{name}` is made twice")));
            }
        }
        Ok(())
    }

    fn standard(&mut self, node: &NodeProto) -> Made {
        if let Some((function, parameters)) = simple_function(node)? {
            let value = self.input(node, 0)?;
            return self.mapped(&value, function, parameters);
        }
        match node.op_type.as_str() {
            "Identity" => self.input(node, 0),
            "Dropout" => self.dropout(node),
            "Cast" => self.cast(node),
            "CastLike" => self.cast_like(node),
            "Constant" => constants::constant(Attributes::of(node)),
            "ConstantOfShape" => self.constant_of_shape(node),
            "Shape" => self.shape(node),
            "Size" => self.size(node),
            "Range" => self.range(node),
            "Flatten" => self.flatten(node),
            "Reshape" => self.reshape(node),
            "Squeeze" => self.squeeze(node),
            "Unsqueeze" => self.unsqueeze(node),
            "Transpose" => self.transpose(node),
            "Expand" => self.expand(node),
            "Tile" => self.tile(node),
            "Concat" => self.concat(node),
            "Slice" => self.slice(node),
            "Gather" => self.gather(node),
            "Gemm" => self.gemm(node),
            "MatMul" => self.matmul(node),
            "Add" | "Sum" => self.many(node, Operation::Add),
            "Sub" => self.many(node, Operation::Subtract),
            "Mul" => self.many(node, Operation::Multiply),
            "Div" => self.many(node, Operation::Divide),
            "Max" => self.many(node, Operation::Maximum),
            "Min" => self.many(node, Operation::Minimum),
            "Greater" | "Less" | "GreaterOrEqual" | "LessOrEqual" => self.compare(node),
            "Equal" => self.equal(node),
            "Where" => self.choose(node),
            // truth values are 1 and 0
            "And" => self.many(node, Operation::Multiply),
            "Or" => self.many(node, Operation::Maximum),
            "Mod" => self.remainder(node),
            "Pow" => self.power(node),
            "PRelu" => self.prelu(node),
            "Clip" => self.clip(node),
            "BatchNormalization" => self.batch_normalization(node),
            "LayerNormalization" => self.layer_normalization(node),
            "InstanceNormalization" | "GroupNormalization" => self.group_normalization(node),
            "RMSNormalization" => self.rms_normalization(node),
            "Softmax" => self.softmax(node),
            "LogSoftmax" => self.log_softmax(node),
            "Conv" => self.convolution(node),
            "AveragePool" => self.average_pool(node),
            "MaxPool" => self.max_pool(node),
            "GlobalAveragePool" | "GlobalMaxPool" => self.global_pool(node),
            "Pad" => self.pad(node),
            "ReduceL1" | "ReduceL2" | "ReduceLogSum" | "ReduceLogSumExp" | "ReduceMax" | "ReduceMean" | "ReduceMin"
            | "ReduceProd" | "ReduceSum" | "ReduceSumSquare" => self.reduce(node),
            _ => self.composed(node),
        }
    }

    /// Operators that are several functions of numbers, one after the other.
    fn composed(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        match node.op_type.as_str() {
            "Mean" => {
                let sum = self.many(node, Operation::Add)?;
                self.mapped(&sum, Elementwise::Linear, vec![1.0 / node.input.len() as f64, 0.0])
            }
            "Sign" => {
                let value = self.input(node, 0)?;
                let negative = self.mapped(&value, Elementwise::Linear, vec![-1.0, 0.0])?;
                let above = self.mapped(&value, Elementwise::Positive, Vec::new())?;
                let below = self.mapped(&negative, Elementwise::Positive, Vec::new())?;
                self.combined(Operation::Subtract, &above, &below)
            }
            "HardSwish" => {
                let value = self.input(node, 0)?;
                let gate = self.hard_sigmoid(&value, 1.0 / 6.0, 0.5)?;
                self.combined(Operation::Multiply, &value, &gate)
            }
            "Mish" => {
                let value = self.input(node, 0)?;
                let softplus = self.mapped(&value, Elementwise::Softplus, Vec::new())?;
                let gate = self.mapped(&softplus, Elementwise::Activation(Activation::Tanh), Vec::new())?;
                self.combined(Operation::Multiply, &value, &gate)
            }
            "Swish" => {
                let (value, alpha) = (self.input(node, 0)?, attributes.float("alpha", 1.0)?);
                if alpha == 1.0 {
                    return self.mapped(&value, Elementwise::Activation(Activation::Silu), Vec::new());
                }
                let scaled = self.mapped(&value, Elementwise::Linear, vec![alpha, 0.0])?;
                let gate = self.mapped(&scaled, Elementwise::Activation(Activation::Sigmoid), Vec::new())?;
                self.combined(Operation::Multiply, &value, &gate)
            }
            "HardSigmoid" => {
                let value = self.input(node, 0)?;
                self.hard_sigmoid(&value, attributes.float("alpha", 0.2)?, attributes.float("beta", 0.5)?)
            }
            "Tan" | "Sinh" | "Cosh" => self.of_two(node),
            "Asin" | "Acos" => self.arc(node),
            "Selu" => {
                let alpha = attributes.constant("alpha", 1.673_263_242_354_377_2)?;
                let gamma = attributes.constant("gamma", 1.050_700_987_355_480_5)?;
                let value = self.input(node, 0)?;
                let elu = self.mapped(&value, Elementwise::Elu, vec![alpha])?;
                self.mapped(&elu, Elementwise::Linear, vec![gamma, 0.0])
            }
            "Celu" => {
                let alpha = attributes.float("alpha", 1.0)?;
                if alpha == 0.0 {
                    return Err(ImportError::not_finite("attribute `alpha` is 0, expected another number"));
                }
                let value = self.input(node, 0)?;
                let inner = self.mapped(&value, Elementwise::Linear, vec![1.0 / alpha, 0.0])?;
                let elu = self.mapped(&inner, Elementwise::Elu, vec![1.0])?;
                self.mapped(&elu, Elementwise::Linear, vec![alpha, 0.0])
            }
            _ => Err(ImportError::unsupported(format!("operator {} is not supported", operator(node)))),
        }
    }

    fn machine_learning(&mut self, node: &NodeProto) -> Made {
        match node.op_type.as_str() {
            "Scaler" => self.scaler(node),
            "LinearRegressor" => self.linear_regressor(node),
            "SVMRegressor" => self.svm_regressor(node),
            "TreeEnsembleRegressor" => self.tree_ensemble(node),
            "ArrayFeatureExtractor" => self.extract(node),
            "FeatureVectorizer" => self.features(node),
            "Imputer" => self.imputer(node),
            "Normalizer" => self.normalizer(node),
            _ => Err(ImportError::unsupported(format!("operator {} is not supported", operator(node)))),
        }
    }
}

/// The function of each number that an operator is, with its parameters; none for other operators.
fn simple_function(node: &NodeProto) -> Result<Option<(Elementwise, Vec<f64>)>, ImportError> {
    let attributes = Attributes::of(node);
    let (function, parameters) = match node.op_type.as_str() {
        "Tanh" => (Elementwise::Activation(Activation::Tanh), Vec::new()),
        "Sigmoid" => (Elementwise::Activation(Activation::Sigmoid), Vec::new()),
        "Relu" => (Elementwise::Activation(Activation::Relu), Vec::new()),
        "Sin" => (Elementwise::Activation(Activation::Sine), Vec::new()),
        "Gelu" => match attributes.text("approximate").as_deref() {
            None | Some("none") => (Elementwise::GeluExact, Vec::new()),
            Some("tanh") => (Elementwise::Activation(Activation::Gelu), Vec::new()),
            Some(other) => {
                return Err(ImportError::malformed(format!(
                    "attribute `approximate` is {other:?}, expected \"none\" or \"tanh\""
                )));
            }
        },
        "Cos" => (Elementwise::Cosine, Vec::new()),
        "Exp" => (Elementwise::Exponential, Vec::new()),
        "Log" => (Elementwise::Logarithm, Vec::new()),
        "Sqrt" => (Elementwise::Power, vec![0.5]),
        "Reciprocal" => (Elementwise::Reciprocal, Vec::new()),
        "Neg" => (Elementwise::Linear, vec![-1.0, 0.0]),
        // truth values are 1 and 0
        "Not" => (Elementwise::Linear, vec![-1.0, 1.0]),
        "Abs" => (Elementwise::Absolute, Vec::new()),
        "Erf" => (Elementwise::Erf, Vec::new()),
        "LeakyRelu" => (Elementwise::LeakyRelu, vec![attributes.float("alpha", 0.01)?]),
        "Elu" => (Elementwise::Elu, vec![attributes.float("alpha", 1.0)?]),
        "Softplus" => (Elementwise::Softplus, Vec::new()),
        "Softsign" => (Elementwise::Softsign, Vec::new()),
        "ThresholdedRelu" => (Elementwise::ThresholdedRelu, vec![attributes.float("alpha", 1.0)?]),
        "Atan" => (Elementwise::Arctangent, Vec::new()),
        _ => return Ok(None),
    };
    Ok(Some((function, parameters)))
}

fn lengths(dims: &[i64]) -> Result<Vec<usize>, ImportError> {
    dims.iter().map(|dim| length(*dim)).collect()
}

fn length(dim: i64) -> Result<usize, ImportError> {
    usize::try_from(dim).map_err(|_| ImportError::malformed(format!("a dimension of {dim}")))
}

fn missing_attribute(name: &str) -> ImportError {
    ImportError::malformed(format!("attribute `{name}` is missing"))
}

fn empty_input(place: usize) -> ImportError {
    ImportError::malformed(format!("input {place} is empty"))
}

/// Position of an element along an axis of a length.
fn element(index: i64, length: usize) -> Result<usize, ImportError> {
    axis(index, length).map_err(|_| ImportError::malformed(format!("index {index} of {length}")))
}

fn weights_within_limits(rows: usize, columns: usize) -> Result<(), ImportError> {
    const LIMIT: usize = 1 << 25;
    match rows.checked_mul(columns) {
        Some(count) if count <= LIMIT => Ok(()),
        _ => Err(ImportError::too_large(format!(
            "a product of {columns} numbers with {rows} rows of weights, expected at most {LIMIT} weights"
        ))),
    }
}
