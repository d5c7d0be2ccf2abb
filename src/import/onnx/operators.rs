//! What each operator makes of its inputs.

use super::{
    Reader,
    attributes::Attributes,
    node::{Row, Value, is_standard, operator},
    proto::{DOUBLE, FLOAT, INT32, INT64, NodeProto, type_name},
    shape::{axis, broadcast, broadcast_places, places, strides},
    tensor::{Data, Tensor, within_limits},
    trees::refuse_transform,
};
use metafmu_runtime::{
    Activation, Numbers,
    graph::{Elementwise, Operation, Step},
};

/// Operators of the standard set that are known here.
pub const STANDARD: [&str; 80] = [
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
    "ReduceMean",
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
];

/// Those of `ai.onnx.ml`.
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

const ML: &str = "ai.onnx.ml";

/// Whether an operator is known here.
pub fn is_known(node: &NodeProto) -> bool {
    match node.domain.as_str() {
        ML => MACHINE_LEARNING.contains(&node.op_type.as_str()),
        domain => is_standard(domain) && STANDARD.contains(&node.op_type.as_str()),
    }
}

/// What to do about an operator that is not known.
pub fn instead(operator: &str) -> String {
    let name = operator.trim_matches('`').rsplit('.').next().unwrap_or_default();
    match name {
        "LSTM" | "GRU" | "RNN" | "Scan" | "Loop" => {
            ": a recurrent model has a state; export one step of it, with the state among its inputs and outputs".into()
        }
        "If" => ": expected a graph without branches".into(),
        "Conv" | "ConvTranspose" | "MaxPool" | "AveragePool" | "GlobalAveragePool" => {
            ": expected a feed-forward network of dense layers".into()
        }
        "TreeEnsembleClassifier" | "LinearClassifier" | "SVMClassifier" | "ArgMax" | "ZipMap" => {
            ": expected a regression, whose outputs are real numbers".into()
        }
        name => {
            let known = STANDARD.iter().chain(&MACHINE_LEARNING).copied();
            crate::diagnostics::names::did_you_mean(name, known) + "; docs/import.md lists those that are"
        }
    }
}

type Made = Result<Value, String>;

impl Reader {
    /// Computes what a node gives.
    pub fn node(&mut self, node: &NodeProto) -> Result<(), String> {
        let made = match node.domain.as_str() {
            ML => vec![self.machine_learning(node)?],
            _ if node.op_type == "Split" => self.split(node)?,
            _ => vec![self.standard(node)?],
        };
        let wanted = node.output.iter().take_while(|name| !name.is_empty()).count();
        // a dropout's mask and the like are not given here
        if wanted == 0 {
            return Err("it gives nothing".into());
        }
        for (name, value) in node.output.iter().zip(made).filter(|(name, _)| !name.is_empty()) {
            if self.values.insert(name.clone(), value).is_some() {
                return Err(format!("output `{name}` is made twice"));
            }
        }
        Ok(())
    }

    fn standard(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let activation = |activation| (Elementwise::Activation(activation), Vec::new());
        let (function, parameters) = match node.op_type.as_str() {
            "Identity" | "Dropout" => return self.input(node, 0),
            "Cast" => return self.cast(node),
            "CastLike" => return self.input(node, 0),
            "Constant" => return constant(attributes),
            "ConstantOfShape" => return self.constant_of_shape(node),
            "Shape" => return self.shape(node),
            "Size" => {
                let count = self.input(node, 0)?.shape().iter().product::<usize>();
                return Ok(Value::Constant(Tensor { shape: Vec::new(), data: Data::Integer(vec![count as i64]) }));
            }
            "Range" => return self.range(node),
            "Flatten" => return self.flatten(node),
            "Reshape" => return self.reshape(node),
            "Squeeze" => return self.squeeze(node),
            "Unsqueeze" => return self.unsqueeze(node),
            "Transpose" => return self.transpose(node),
            "Expand" => return self.expand(node),
            "Tile" => return self.tile(node),
            "Concat" => return self.concat(node),
            "Slice" => return self.slice(node),
            "Gather" => return self.gather(node),
            "Gemm" => return self.gemm(node),
            "MatMul" => return self.matmul(node),
            "Add" | "Sum" => return self.many(node, Operation::Add),
            "Sub" => return self.many(node, Operation::Subtract),
            "Mul" => return self.many(node, Operation::Multiply),
            "Div" => return self.many(node, Operation::Divide),
            "Max" => return self.many(node, Operation::Maximum),
            "Min" => return self.many(node, Operation::Minimum),
            "Mean" => {
                let sum = self.many(node, Operation::Add)?;
                return self.mapped(&sum, Elementwise::Linear, vec![1.0 / node.input.len() as f64, 0.0]);
            }
            "Greater" | "Less" | "GreaterOrEqual" | "LessOrEqual" => return self.compare(node),
            "Where" => return self.choose(node),
            // truth values are 1 and 0
            "And" => return self.many(node, Operation::Multiply),
            "Or" => return self.many(node, Operation::Maximum),
            "Not" => (Elementwise::Linear, vec![-1.0, 1.0]),
            "Mod" => return self.remainder(node),
            "Sign" => {
                let value = self.input(node, 0)?;
                let negative = self.mapped(&value, Elementwise::Linear, vec![-1.0, 0.0])?;
                let above = self.mapped(&value, Elementwise::Positive, Vec::new())?;
                let below = self.mapped(&negative, Elementwise::Positive, Vec::new())?;
                return self.combined(Operation::Subtract, &above, &below);
            }
            "Pow" => return self.power(node),
            "PRelu" => return self.prelu(node),
            "Clip" => return self.clip(node),
            "BatchNormalization" => return self.batch_normalization(node),
            "LayerNormalization" => return self.layer_normalization(node),
            "RMSNormalization" => return self.rms_normalization(node),
            "Softmax" => return self.softmax(node),
            "ReduceMean" | "ReduceProd" | "ReduceSum" | "ReduceSumSquare" | "ReduceL2" => return self.reduce(node),
            "HardSwish" => {
                let value = self.input(node, 0)?;
                let gate = self.hard_sigmoid(&value, 1.0 / 6.0, 0.5)?;
                return self.combined(Operation::Multiply, &value, &gate);
            }
            "Mish" => {
                let value = self.input(node, 0)?;
                let softplus = self.mapped(&value, Elementwise::Softplus, Vec::new())?;
                let gate = self.mapped(&softplus, Elementwise::Activation(Activation::Tanh), Vec::new())?;
                return self.combined(Operation::Multiply, &value, &gate);
            }
            "Swish" => {
                let (value, alpha) = (self.input(node, 0)?, attributes.float("alpha", 1.0)?);
                if alpha == 1.0 {
                    return self.mapped(&value, Elementwise::Activation(Activation::Silu), Vec::new());
                }
                let scaled = self.mapped(&value, Elementwise::Linear, vec![alpha, 0.0])?;
                let gate = self.mapped(&scaled, Elementwise::Activation(Activation::Sigmoid), Vec::new())?;
                return self.combined(Operation::Multiply, &value, &gate);
            }
            "HardSigmoid" => {
                let value = self.input(node, 0)?;
                return self.hard_sigmoid(&value, attributes.float("alpha", 0.2)?, attributes.float("beta", 0.5)?);
            }
            "Tan" | "Sinh" | "Cosh" => return self.of_two(node),
            "Selu" => {
                // a single is meant to be the constant next to it
                let meant = |name, constant: f64| -> Result<f64, String> {
                    let given = attributes.float(name, constant)?;
                    Ok(if given as f32 == constant as f32 { constant } else { given })
                };
                let alpha = meant("alpha", 1.673_263_242_354_377_2)?;
                let gamma = meant("gamma", 1.050_700_987_355_480_5)?;
                let value = self.input(node, 0)?;
                let elu = self.mapped(&value, Elementwise::Elu, vec![alpha])?;
                return self.mapped(&elu, Elementwise::Linear, vec![gamma, 0.0]);
            }
            "Celu" => {
                let alpha = attributes.float("alpha", 1.0)?;
                if alpha == 0.0 {
                    return Err("attribute `alpha` is 0, expected another number".into());
                }
                let value = self.input(node, 0)?;
                let inner = self.mapped(&value, Elementwise::Linear, vec![1.0 / alpha, 0.0])?;
                let elu = self.mapped(&inner, Elementwise::Elu, vec![1.0])?;
                return self.mapped(&elu, Elementwise::Linear, vec![alpha, 0.0]);
            }
            "Tanh" => activation(Activation::Tanh),
            "Sigmoid" => activation(Activation::Sigmoid),
            "Relu" => activation(Activation::Relu),
            "Sin" => activation(Activation::Sine),
            "Gelu" => match attributes.text("approximate").as_deref() {
                None | Some("none") => (Elementwise::GeluExact, Vec::new()),
                Some("tanh") => activation(Activation::Gelu),
                Some(other) => {
                    return Err(format!("attribute `approximate` is {other:?}, expected \"none\" or \"tanh\""));
                }
            },
            "Cos" => (Elementwise::Cosine, Vec::new()),
            "Exp" => (Elementwise::Exponential, Vec::new()),
            "Log" => (Elementwise::Logarithm, Vec::new()),
            "Sqrt" => (Elementwise::Power, vec![0.5]),
            "Reciprocal" => (Elementwise::Reciprocal, Vec::new()),
            "Neg" => (Elementwise::Linear, vec![-1.0, 0.0]),
            "Abs" => (Elementwise::Absolute, Vec::new()),
            "Erf" => (Elementwise::Erf, Vec::new()),
            "LeakyRelu" => (Elementwise::LeakyRelu, vec![attributes.float("alpha", 0.01)?]),
            "Elu" => (Elementwise::Elu, vec![attributes.float("alpha", 1.0)?]),
            "Softplus" => (Elementwise::Softplus, Vec::new()),
            "Softsign" => (Elementwise::Softsign, Vec::new()),
            "ThresholdedRelu" => (Elementwise::ThresholdedRelu, vec![attributes.float("alpha", 1.0)?]),
            "Atan" => (Elementwise::Arctangent, Vec::new()),
            _ => return Err(format!("operator {} is not supported", operator(node))),
        };
        let value = self.input(node, 0)?;
        self.mapped(&value, function, parameters)
    }

    fn machine_learning(&mut self, node: &NodeProto) -> Made {
        match node.op_type.as_str() {
            "Scaler" => self.scaler(node),
            "LinearRegressor" => self.linear_regressor(node),
            "SVMRegressor" => self.svm_regressor(node),
            "TreeEnsembleRegressor" => self.tree_ensemble(node),
            "ArrayFeatureExtractor" => self.extract(node),
            "FeatureVectorizer" => {
                let values =
                    (0..node.input.len()).map(|place| self.input(node, place)).collect::<Result<Vec<_>, _>>()?;
                self.concatenated(&values, 1)
            }
            // a value that is missing never reaches an FMU
            "Imputer" => self.input(node, 0),
            "Normalizer" => self.normalizer(node),
            _ => Err(format!("operator {} is not supported", operator(node))),
        }
    }

    // ---- types and constants

    fn cast(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let to = Attributes::of(node).integer("to").unwrap_or_default() as i32;
        let refused = || Err(format!("a cast to {}, expected float or double", type_name(to)));
        match value {
            Value::Constant(Tensor { shape, data }) => {
                let values = data.doubles();
                let data = match to {
                    FLOAT => Data::Single(values.iter().map(|value| *value as f32).collect()),
                    DOUBLE => Data::Double(values),
                    INT32 | INT64 => Data::Integer(values.iter().map(|value| *value as i64).collect()),
                    _ => return refused(),
                };
                Ok(Value::Constant(Tensor { shape, data }))
            }
            // where rounding counts the inputs are rounded already
            Value::Row(row) if matches!(to, FLOAT | DOUBLE) => Ok(Value::Row(Row { is_single: to == FLOAT, ..row })),
            Value::Row(_) => refused(),
        }
    }

    fn constant_of_shape(&mut self, node: &NodeProto) -> Made {
        let shape = self.constant(node, 0)?.ok_or("input 0 is missing")?;
        let shape = lengths(shape.integers()?)?;
        let count = within_limits(&shape)?;
        let value = Attributes::of(node).tensor("value").transpose()?;
        let value = value.unwrap_or(Tensor { shape: vec![1], data: Data::Single(vec![0.0]) });
        if value.data.len() != 1 {
            return Err(format!("attribute `value` has {} elements, expected 1", value.data.len()));
        }
        Ok(Value::Constant(Tensor { shape, data: value.data.picked(&vec![0; count]) }))
    }

    fn shape(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let value = self.input(node, 0)?;
        let rank = value.shape().len() as i64;
        let place = |name: &str, default: i64| {
            let place = attributes.integer(name).unwrap_or(default);
            (if place < 0 { place + rank } else { place }).clamp(0, rank) as usize
        };
        let (start, end) = (place("start", 0), place("end", rank));
        let dims = value.shape().get(start..end).unwrap_or_default();
        Ok(Value::Constant(Tensor::of_integers(dims.iter().map(|dim| *dim as i64).collect())))
    }

    fn range(&mut self, node: &NodeProto) -> Made {
        let number = |place: usize| -> Result<i64, String> {
            let tensor = self.constant(node, place)?.ok_or_else(|| format!("input {place} is missing"))?;
            tensor.integers()?.first().copied().ok_or_else(|| format!("input {place} is empty"))
        };
        let (start, limit, step) = (number(0)?, number(1)?, number(2)?);
        if step == 0 {
            return Err("a step of 0".into());
        }
        let count = (i128::from(limit) - i128::from(start)).div_euclid(i128::from(step)).max(0);
        let exact = count * i128::from(step) == i128::from(limit) - i128::from(start);
        let count = usize::try_from(if exact { count } else { count + 1 }).unwrap_or(usize::MAX);
        within_limits(&[count])?;
        let values = (0..count).map(|index| start.wrapping_add(step.wrapping_mul(index as i64))).collect();
        Ok(Value::Constant(Tensor::of_integers(values)))
    }

    // ---- shapes

    fn flatten(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape();
        let at = Attributes::of(node).integer("axis").unwrap_or(1);
        let at = match at {
            _ if at == shape.len() as i64 => shape.len(),
            _ => axis(at, shape.len())?,
        };
        let flat = vec![shape[..at].iter().product(), shape[at..].iter().product()];
        self.reshaped(&value, flat)
    }

    fn reshape(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let wanted = self.constant(node, 1)?.ok_or("input 1 is missing")?;
        let keeps_zero = Attributes::of(node).integer("allowzero").unwrap_or(0) != 0;
        let mut shape = Vec::new();
        let mut rest = None;
        for (place, dim) in wanted.integers()?.iter().enumerate() {
            shape.push(match *dim {
                -1 if rest.is_none() => {
                    rest = Some(place);
                    1
                }
                0 if !keeps_zero => *value.shape().get(place).ok_or("a dimension of 0 that the input does not have")?,
                dim => usize::try_from(dim).map_err(|_| format!("a dimension of {dim}"))?,
            });
        }
        let known = within_limits(&shape)?;
        if let Some(place) = rest {
            let count: usize = value.shape().iter().product();
            if known == 0 || !count.is_multiple_of(known) {
                return Err(format!("a shape of {:?} is to become {:?}", value.shape(), wanted.integers()?));
            }
            shape[place] = count / known;
        }
        // of a file for a batch of another size: all that follows from the inputs has one row
        self.reshaped(&value, shape)
    }

    fn squeeze(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape();
        let squeezed: Vec<usize> = match self.integers(node, 1, "axes")? {
            Some(axes) => axes.iter().map(|at| axis(*at, shape.len())).collect::<Result<_, _>>()?,
            None => (0..shape.len()).filter(|at| shape[*at] == 1).collect(),
        };
        let rest = (0..shape.len()).filter(|at| !squeezed.contains(at)).map(|at| shape[at]).collect();
        self.reshaped(&value, rest)
    }

    fn unsqueeze(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let axes = self.integers(node, 1, "axes")?.ok_or("no axes")?;
        let rank = value.shape().len() + axes.len();
        let added: Vec<usize> = axes.iter().map(|at| axis(*at, rank)).collect::<Result<_, _>>()?;
        let mut old = value.shape().iter();
        let shape: Option<Vec<usize>> =
            (0..rank).map(|at| if added.contains(&at) { Some(1) } else { old.next().copied() }).collect();
        self.reshaped(&value, shape.ok_or("an axis is given twice")?)
    }

    fn transpose(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        let order: Vec<usize> = match Attributes::of(node).integers("perm") {
            Some(order) => order.iter().map(|at| axis(*at, rank)).collect::<Result<_, _>>()?,
            None => (0..rank).rev().collect(),
        };
        let mut sorted = order.clone();
        sorted.sort_unstable();
        if sorted != (0..rank).collect::<Vec<_>>() {
            return Err(format!("perm {order:?} of {rank} dimensions"));
        }
        self.transposed(&value, &order)
    }

    fn expand(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let wanted = lengths(self.constant(node, 1)?.ok_or("input 1 is missing")?.integers()?)?;
        let shape = broadcast(value.shape(), &wanted)?;
        self.expanded(&value, &shape)
    }

    fn tile(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let times = lengths(self.constant(node, 1)?.ok_or("input 1 is missing")?.integers()?)?;
        let from = value.shape().to_vec();
        if times.len() != from.len() {
            return Err(format!("{} repeats of {} dimensions", times.len(), from.len()));
        }
        let shape: Option<Vec<usize>> = from.iter().zip(&times).map(|(dim, times)| dim.checked_mul(*times)).collect();
        let shape = shape.ok_or("a tensor that is too large")?;
        within_limits(&shape)?;
        let strides = strides(&from);
        let found = places(&shape, |index| {
            index.iter().zip(&from).zip(&strides).map(|((index, dim), stride)| index % dim * stride).sum()
        });
        self.pick(&value, &found, shape)
    }

    fn concat(&mut self, node: &NodeProto) -> Made {
        let values = (0..node.input.len()).map(|place| self.input(node, place)).collect::<Result<Vec<_>, _>>()?;
        let at = Attributes::of(node).integer("axis").ok_or("attribute `axis` is missing")?;
        self.concatenated(&values, at)
    }

    fn concatenated(&mut self, values: &[Value], at: i64) -> Made {
        let first = values.first().ok_or("nothing to put together")?.shape().to_vec();
        let at = axis(at, first.len())?;
        let mut shape = first.clone();
        shape[at] = 0;
        for value in values {
            let fits = value.shape().len() == first.len()
                && (0..first.len()).all(|place| place == at || value.shape()[place] == first[place]);
            if !fits {
                return Err(format!("shapes {first:?} and {:?} put together along axis {at}", value.shape()));
            }
            shape[at] += value.shape()[at];
        }
        within_limits(&shape)?;
        // where each element is from
        let mut of: Vec<(usize, usize)> = Vec::new();
        for (number, value) in values.iter().enumerate() {
            of.extend((0..value.shape()[at]).map(|within| (number, within)));
        }
        let strides: Vec<Vec<usize>> = values.iter().map(|value| strides(value.shape())).collect();
        let place = |index: &[usize]| -> (usize, usize) {
            let (number, within) = of[index[at]];
            let dims = index.iter().zip(&strides[number]).enumerate();
            (number, dims.map(|(place, (index, stride))| stride * if place == at { within } else { *index }).sum())
        };
        let mut found = Vec::new();
        places(&shape, |index| {
            found.push(place(index));
            0
        });
        let constants: Option<Vec<&Tensor>> = values.iter().map(Value::constant).collect();
        if let Some(tensors) = constants {
            let all: Vec<Vec<f64>> = tensors.iter().map(|tensor| tensor.data.doubles()).collect();
            let values = found.iter().map(|(number, place)| all[*number][*place]).collect();
            return Ok(Value::Constant(Tensor::like(&tensors[0].data, shape, values)));
        }
        let mut rows = Vec::new();
        for value in values {
            rows.push(match value {
                Value::Row(row) => row.clone(),
                Value::Constant(tensor) => super::node::constant_row(&mut self.builder, tensor)?,
            });
        }
        let columns = found.iter().map(|(number, place)| [rows[*number].value as u32, *place as u32]).collect();
        let is_single = rows.iter().all(|row| row.is_single);
        Ok(Value::Row(Row { shape, value: self.builder.columns(columns)?, is_single }))
    }

    fn slice(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let given = |place: usize, attribute: &str| self.integers(node, place, attribute);
        let (starts, ends) = (given(1, "starts")?.ok_or("no starts")?, given(2, "ends")?.ok_or("no ends")?);
        let axes = given(3, "axes")?.unwrap_or_else(|| (0..starts.len() as i64).collect());
        let steps = given(4, "steps")?.unwrap_or_else(|| vec![1; starts.len()]);
        if [ends.len(), axes.len(), steps.len()] != [starts.len(); 3] {
            return Err("starts, ends, axes and steps of different lengths".into());
        }
        let mut chosen: Vec<Vec<usize>> = shape.iter().map(|dim| (0..*dim).collect()).collect();
        for (((start, end), at), step) in starts.iter().zip(&ends).zip(&axes).zip(&steps) {
            let at = axis(*at, shape.len())?;
            chosen[at] = sliced(shape[at] as i64, (*start, *end, *step))?;
        }
        self.chosen(&value, &chosen)
    }

    /// Some elements along each axis.
    fn chosen(&mut self, value: &Value, chosen: &[Vec<usize>]) -> Made {
        let strides = strides(value.shape());
        let shape: Vec<usize> = chosen.iter().map(Vec::len).collect();
        if shape.contains(&0) && matches!(value, Value::Row(_)) {
            return Err("nothing is left".into());
        }
        let found = places(&shape, |index| {
            index.iter().zip(chosen).zip(&strides).map(|((index, chosen), stride)| chosen[*index] * stride).sum()
        });
        self.pick(value, &found, shape)
    }

    fn gather(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let indices = self.constant(node, 1)?.ok_or("input 1 is missing")?;
        let at = axis(Attributes::of(node).integer("axis").unwrap_or(0), value.shape().len())?;
        let dim = value.shape()[at];
        let index = |index: &i64| axis(*index, dim).map_err(|_| format!("index {index} of {dim}"));
        let found = indices.integers()?.iter().map(index).collect::<Result<Vec<_>, _>>()?;
        let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
        chosen[at] = found;
        let picked = self.chosen(&value, &chosen)?;
        let shape = [&value.shape()[..at], &indices.shape, &value.shape()[at + 1..]].concat();
        self.reshaped(&picked, shape)
    }

    fn split(&mut self, node: &NodeProto) -> Result<Vec<Value>, String> {
        let value = self.input(node, 0)?;
        let attributes = Attributes::of(node);
        let at = axis(attributes.integer("axis").unwrap_or(0), value.shape().len())?;
        let dim = value.shape()[at];
        let sizes = match self.integers(node, 1, "split")? {
            Some(sizes) => lengths(&sizes)?,
            None => {
                let count = node.output.len();
                let each = dim.div_ceil(count.max(1));
                (0..count).map(|part| each.min(dim.saturating_sub(part * each))).collect()
            }
        };
        if sizes.iter().try_fold(0usize, |sum, size| sum.checked_add(*size)) != Some(dim) {
            return Err(format!("{dim} elements in parts of {sizes:?}"));
        }
        let mut first = 0;
        let mut parts = Vec::new();
        for size in sizes {
            let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
            chosen[at] = (first..first + size).collect();
            parts.push(self.chosen(&value, &chosen)?);
            first += size;
        }
        Ok(parts)
    }

    fn extract(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let indices = self.constant(node, 1)?.ok_or("input 1 is missing")?;
        let (rank, dim) = (value.shape().len(), value.shape().last().copied().unwrap_or(1));
        if rank == 0 {
            return Err("a tensor without dimensions".into());
        }
        let index = |index: &i64| axis(*index, dim).map_err(|_| format!("index {index} of {dim}"));
        let mut chosen: Vec<Vec<usize>> = value.shape().iter().map(|dim| (0..*dim).collect()).collect();
        chosen[rank - 1] = indices.integers()?.iter().map(index).collect::<Result<_, _>>()?;
        self.chosen(&value, &chosen)
    }

    // ---- products

    fn gemm(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let (alpha, beta) = (attributes.float("alpha", 1.0)?, attributes.float("beta", 1.0)?);
        let mut factor = |place: usize, name: &str| -> Made {
            let value = self.input(node, place)?;
            if value.shape().len() != 2 {
                return Err(format!("a tensor of shape {:?}, expected two dimensions", value.shape()));
            }
            match attributes.integer(name).unwrap_or(0) {
                0 => Ok(value),
                _ => self.transposed(&value, &[1, 0]),
            }
        };
        let (a, b) = (factor(0, "transA")?, factor(1, "transB")?);
        let mut product = self.product(&a, &b)?;
        if alpha != 1.0 {
            product = self.mapped(&product, Elementwise::Linear, vec![alpha, 0.0])?;
        }
        let Some(c) = self.given(node, 2)?.cloned() else { return Ok(product) };
        let c = if beta == 1.0 { c } else { self.mapped(&c, Elementwise::Linear, vec![beta, 0.0])? };
        self.combined(Operation::Add, &product, &c)
    }

    fn matmul(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.input(node, 0)?, self.input(node, 1)?);
        self.product(&a, &b)
    }

    /// The matrix product; of tensors of more dimensions one for each of the others, vectors being rows or columns.
    fn product(&mut self, a: &Value, b: &Value) -> Made {
        let (a_rank, b_rank) = (a.shape().len(), b.shape().len());
        if a_rank == 0 || b_rank == 0 {
            return Err("a product with a single number, expected matrices".into());
        }
        if a_rank == 1 {
            let row = self.reshaped(a, vec![1, a.shape()[0]])?;
            let product = self.product(&row, b)?;
            let mut shape = product.shape().to_vec();
            shape.remove(shape.len() - if b_rank == 1 { 1 } else { 2 });
            return self.reshaped(&product, shape);
        }
        if b_rank == 1 {
            let column = self.reshaped(b, vec![b.shape()[0], 1])?;
            let product = self.product(a, &column)?;
            let shape = product.shape()[..product.shape().len() - 1].to_vec();
            return self.reshaped(&product, shape);
        }
        let misfit = || format!("a product of shapes {:?} and {:?}", a.shape(), b.shape());
        let (rows, inner) = (a.shape()[a_rank - 2], a.shape()[a_rank - 1]);
        let columns = b.shape()[b_rank - 1];
        if b.shape()[b_rank - 2] != inner || inner == 0 {
            return Err(misfit());
        }
        let batch = broadcast(&a.shape()[..a_rank - 2], &b.shape()[..b_rank - 2]).map_err(|_| misfit())?;
        let shape = [batch.as_slice(), &[rows, columns]].concat();
        let count = within_limits(&shape)?;
        // for each element of the result where its sum begins in either factor
        let of_a = broadcast_places(&a.shape()[..a_rank - 2], &batch);
        let of_b = broadcast_places(&b.shape()[..b_rank - 2], &batch);
        let begins = |element: usize| {
            let (matrix, row, column) = (element / (rows * columns), element / columns % rows, element % columns);
            ((of_a[matrix] * rows + row) * inner, of_b[matrix] * inner * columns + column)
        };
        let (row, constant) = match (a, b) {
            (Value::Constant(a), Value::Constant(b)) => {
                let (x, y) = (a.data.doubles(), b.data.doubles());
                within_limits(&[count, inner])?;
                let sum = |element| {
                    let (first, second) = begins(element);
                    (0..inner).map(|k| x[first + k] * y[second + k * columns]).sum()
                };
                return Ok(Value::Constant(Tensor::like(&a.data, shape, (0..count).map(sum).collect())));
            }
            (Value::Row(row), Value::Constant(constant)) | (Value::Constant(constant), Value::Row(row)) => {
                (row, constant)
            }
            (Value::Row(_), Value::Row(_)) => {
                return Err(
                    "a product of two matrices that both follow from the inputs, expected one of them to be a constant"
                        .into(),
                );
            }
        };
        let (width, row_is_first) = (self.builder.width(row.value), matches!(a, Value::Row(_)));
        weights_within_limits(count, width)?;
        // a vector times a matrix, which is most of them, keeps its precision
        if row_is_first && width == inner && rows == 1 && batch.iter().all(|dim| *dim == 1) {
            let transposed: Vec<usize> =
                (0..columns).flat_map(|column| (0..inner).map(move |k| k * columns + column)).collect();
            let weight = of_data(constant.data.picked(&transposed));
            let bias = zeros_like(&weight, columns);
            return self.affine(row, weight, bias, shape);
        }
        let numbers = constant.data.doubles();
        let mut weight = vec![0.0; count * width];
        for element in 0..count {
            let (first, second) = begins(element);
            for k in 0..inner {
                let (of_a, of_b) = (first + k, second + k * columns);
                let (variable, number) = if row_is_first { (of_a, numbers[of_b]) } else { (of_b, numbers[of_a]) };
                weight[element * width + variable] += number;
            }
        }
        self.affine(row, weight.into(), vec![0.0; count].into(), shape)
    }

    // ---- two values, or more

    fn many(&mut self, node: &NodeProto, operation: Operation) -> Made {
        let mut result = self.input(node, 0)?;
        for place in 1..node.input.len() {
            let next = self.input(node, place)?;
            result = self.combined(operation, &result, &next)?;
        }
        Ok(result)
    }

    fn combined(&mut self, operation: Operation, a: &Value, b: &Value) -> Made {
        let shape = broadcast(a.shape(), b.shape())?;
        let (a, b) = (self.expanded(a, &shape)?, self.expanded(b, &shape)?);
        match (&a, &b) {
            (Value::Constant(a), Value::Constant(b)) => {
                let is_whole = matches!((&a.data, &b.data), (Data::Integer(_), Data::Integer(_)));
                let pairs = a.data.doubles().into_iter().zip(b.data.doubles());
                let values: Vec<f64> = pairs.map(|(a, b)| of_numbers(operation, a, b, is_whole)).collect();
                if values.iter().any(|value| !value.is_finite()) {
                    return Err("a constant becomes a number that is not finite".into());
                }
                Ok(Value::Constant(Tensor::like(&a.data, shape, values)))
            }
            (Value::Row(_), Value::Constant(b)) => self.with_constant(operation, &a, &b.data.doubles(), false),
            (Value::Constant(a), Value::Row(_)) => self.with_constant(operation, &b, &a.data.doubles(), true),
            (Value::Row(a), Value::Row(b)) => {
                let width = self.builder.width(a.value);
                let value = self.builder.add(Step::Combine { of: [a.value, b.value], operation }, width)?;
                Ok(Value::Row(Row { shape, value, is_single: a.is_single }))
            }
        }
    }

    /// A row and a constant of the same shape; `is_first`: the constant is the first of the two.
    fn with_constant(&mut self, operation: Operation, row: &Value, numbers: &[f64], is_first: bool) -> Made {
        let width = numbers.len();
        let linear = |factors: Vec<f64>, offsets: Vec<f64>| {
            let all_same = |of: &[f64]| of.iter().all(|value| *value == of[0]);
            match all_same(&factors) && all_same(&offsets) {
                true => vec![factors[0], offsets[0]],
                false => [factors, offsets].concat(),
            }
        };
        if width == 0 {
            return Err("nothing is left".into());
        }
        let ones = || vec![1.0; width];
        let zeros = || vec![0.0; width];
        match operation {
            Operation::Add => self.mapped(row, Elementwise::Linear, linear(ones(), numbers.to_vec())),
            Operation::Subtract if is_first => {
                self.mapped(row, Elementwise::Linear, linear(vec![-1.0; width], numbers.to_vec()))
            }
            Operation::Subtract => {
                let offsets = numbers.iter().map(|number| -number).collect();
                self.mapped(row, Elementwise::Linear, linear(ones(), offsets))
            }
            Operation::Multiply => self.mapped(row, Elementwise::Linear, linear(numbers.to_vec(), zeros())),
            Operation::Divide if is_first => {
                let inverse = self.mapped(row, Elementwise::Reciprocal, Vec::new())?;
                self.mapped(&inverse, Elementwise::Linear, linear(numbers.to_vec(), zeros()))
            }
            Operation::Divide => {
                if numbers.contains(&0.0) {
                    return Err("a division by a constant that is 0".into());
                }
                let factors = numbers.iter().map(|number| 1.0 / number).collect();
                self.mapped(row, Elementwise::Linear, linear(factors, zeros()))
            }
            Operation::Maximum => {
                self.mapped(row, Elementwise::Clip, [numbers.to_vec(), vec![f64::MAX; width]].concat())
            }
            Operation::Minimum => {
                self.mapped(row, Elementwise::Clip, [vec![f64::MIN; width], numbers.to_vec()].concat())
            }
        }
    }

    fn power(&mut self, node: &NodeProto) -> Made {
        let (base, exponent) = (self.input(node, 0)?, self.input(node, 1)?);
        let shape = broadcast(base.shape(), exponent.shape())?;
        let (base, exponent) = (self.expanded(&base, &shape)?, self.expanded(&exponent, &shape)?);
        match (&base, &exponent) {
            (_, Value::Constant(exponent)) => {
                let mut exponents = exponent.data.doubles();
                if exponents.windows(2).all(|pair| pair[0] == pair[1]) {
                    exponents.truncate(1);
                }
                self.mapped(&base, Elementwise::Power, exponents)
            }
            (Value::Constant(base), Value::Row(_)) => {
                let base = base.data.doubles();
                if base.iter().any(|base| *base <= 0.0) {
                    return Err("a power of a constant that is not positive".into());
                }
                let factors = [base.iter().map(|base| base.ln()).collect(), vec![0.0; base.len()]].concat();
                let exponent = self.mapped(&exponent, Elementwise::Linear, factors)?;
                self.mapped(&exponent, Elementwise::Exponential, Vec::new())
            }
            (Value::Row(_), Value::Row(_)) => {
                let logarithm = self.mapped(&base, Elementwise::Logarithm, Vec::new())?;
                let product = self.combined(Operation::Multiply, &exponent, &logarithm)?;
                self.mapped(&product, Elementwise::Exponential, Vec::new())
            }
        }
    }

    /// 1 where it is so, else 0.
    fn compare(&mut self, node: &NodeProto) -> Made {
        let (a, b) = (self.input(node, 0)?, self.input(node, 1)?);
        let (more, less) = if node.op_type.starts_with("Greater") { (a, b) } else { (b, a) };
        if !node.op_type.ends_with("OrEqual") {
            let difference = self.combined(Operation::Subtract, &more, &less)?;
            return self.mapped(&difference, Elementwise::Positive, Vec::new());
        }
        let difference = self.combined(Operation::Subtract, &less, &more)?;
        let is_less = self.mapped(&difference, Elementwise::Positive, Vec::new())?;
        self.mapped(&is_less, Elementwise::Linear, vec![-1.0, 1.0])
    }

    fn choose(&mut self, node: &NodeProto) -> Made {
        let (condition, a, b) = (self.input(node, 0)?, self.input(node, 1)?, self.input(node, 2)?);
        let shape = broadcast(&broadcast(condition.shape(), a.shape())?, b.shape())?;
        let condition = self.expanded(&condition, &shape)?;
        let (a, b) = (self.expanded(&a, &shape)?, self.expanded(&b, &shape)?);
        if let (Value::Constant(condition), Value::Constant(a), Value::Constant(b)) = (&condition, &a, &b) {
            let pairs = a.data.doubles().into_iter().zip(b.data.doubles());
            let chosen = condition.data.doubles().into_iter().zip(pairs);
            let values = chosen.map(|(condition, (a, b))| if condition > 0.0 { a } else { b }).collect();
            return Ok(Value::Constant(Tensor::like(&a.data, shape, values)));
        }
        let mut rows = Vec::new();
        for value in [condition, a, b] {
            rows.push(match value {
                Value::Row(row) => row,
                Value::Constant(tensor) => super::node::constant_row(&mut self.builder, &tensor)?,
            });
        }
        let width = self.builder.width(rows[0].value);
        let value = self.builder.add(Step::Select { of: [rows[0].value, rows[1].value, rows[2].value] }, width)?;
        Ok(Value::Row(Row { shape, value, is_single: rows[1].is_single }))
    }

    /// Of whole numbers that are known.
    fn remainder(&mut self, node: &NodeProto) -> Made {
        let number = |place: usize| -> Result<Tensor, String> {
            self.constant(node, place)?.ok_or_else(|| format!("input {place} is missing"))
        };
        let (a, b) = (number(0)?, number(1)?);
        let shape = broadcast(&a.shape, &b.shape)?;
        let (of_a, of_b) = (broadcast_places(&a.shape, &shape), broadcast_places(&b.shape, &shape));
        let (a, b) = (a.integers()?, b.integers()?);
        let pairs = of_a.iter().zip(&of_b).map(|(first, second)| (a[*first], b[*second]));
        let values = pairs.map(|(a, b)| {
            a.checked_rem(b).map(|rest| if rest != 0 && (rest < 0) != (b < 0) { rest + b } else { rest })
        });
        let values: Option<Vec<i64>> = values.collect();
        Ok(Value::Constant(Tensor { shape, data: Data::Integer(values.ok_or("a division by 0")?) }))
    }

    fn prelu(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let slope = Value::Constant(self.constant(node, 1)?.ok_or("input 1 is missing")?);
        let shape = value.shape().to_vec();
        if broadcast(&shape, slope.shape())? != shape {
            return Err(format!("a slope of shape {:?} for {shape:?}", slope.shape()));
        }
        let Value::Constant(slope) = self.expanded(&slope, &shape)? else { unreachable!("a constant stays one") };
        self.mapped(&value, Elementwise::LeakyRelu, slope.data.doubles())
    }

    fn clip(&mut self, node: &NodeProto) -> Made {
        let limit = |place: usize, none: f64| -> Result<f64, String> {
            let Some(tensor) = self.constant(node, place)? else {
                // attributes before version 11
                return Attributes::of(node).float(if place == 1 { "min" } else { "max" }, none);
            };
            tensor.data.doubles().first().copied().ok_or_else(|| format!("input {place} is empty"))
        };
        let (min, max) = (limit(1, f64::MIN)?, limit(2, f64::MAX)?);
        if min > max {
            return Err(format!("limits from {min} to {max}"));
        }
        let value = self.input(node, 0)?;
        self.mapped(&value, Elementwise::Clip, vec![min, max])
    }

    fn hard_sigmoid(&mut self, value: &Value, alpha: f64, beta: f64) -> Made {
        let line = self.mapped(value, Elementwise::Linear, vec![alpha, beta])?;
        self.mapped(&line, Elementwise::Clip, vec![0.0, 1.0])
    }

    /// Functions made of two others.
    fn of_two(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        if node.op_type == "Tan" {
            let sine = self.mapped(&value, Elementwise::Activation(Activation::Sine), Vec::new())?;
            let cosine = self.mapped(&value, Elementwise::Cosine, Vec::new())?;
            return self.combined(Operation::Divide, &sine, &cosine);
        }
        let up = self.mapped(&value, Elementwise::Exponential, Vec::new())?;
        let down = self.mapped(&value, Elementwise::Linear, vec![-1.0, 0.0])?;
        let down = self.mapped(&down, Elementwise::Exponential, Vec::new())?;
        let operation = if node.op_type == "Sinh" { Operation::Subtract } else { Operation::Add };
        let both = self.combined(operation, &up, &down)?;
        self.mapped(&both, Elementwise::Linear, vec![0.5, 0.0])
    }

    // ---- normalisation

    fn batch_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        if attributes.integer("training_mode").unwrap_or(0) != 0 {
            return Err("a network in training, expected one for inference: export it after `eval()`".into());
        }
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let channels = *shape.get(1).ok_or("a tensor without channels")?;
        let numbers = |place: usize| -> Result<Vec<f64>, String> {
            let tensor = self.constant(node, place)?.ok_or_else(|| format!("input {place} is missing"))?;
            if tensor.data.len() == channels {
                Ok(tensor.data.doubles())
            } else {
                Err(format!("input {place} has {} elements, expected {channels}", tensor.data.len()))
            }
        };
        let (scale, bias, mean, variance) = (numbers(1)?, numbers(2)?, numbers(3)?, numbers(4)?);
        let factor = |channel: usize| scale[channel] / (variance[channel] + epsilon).sqrt();
        let factors: Vec<f64> = (0..channels).map(factor).collect();
        if factors.iter().any(|factor| !factor.is_finite()) {
            return Err("a variance that is not positive".into());
        }
        let offsets: Vec<f64> = (0..channels).map(|channel| bias[channel] - mean[channel] * factors[channel]).collect();
        let channel = places(&shape, |index| index[1]);
        let of = |numbers: &[f64]| channel.iter().map(|channel| numbers[*channel]).collect::<Vec<f64>>();
        self.mapped(&value, Elementwise::Linear, [of(&factors), of(&offsets)].concat())
    }

    fn layer_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let at = axis(attributes.integer("axis").unwrap_or(-1), value.shape().len())?;
        let normal = self
            .in_groups(&value, at, |reader, of, width| reader.builder.add(Step::Standardise { of, epsilon }, width))?;
        self.scaled(node, normal)
    }

    fn rms_normalization(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let epsilon = attributes.float("epsilon", 1e-5)?;
        let value = self.input(node, 0)?;
        let at = axis(attributes.integer("axis").unwrap_or(-1), value.shape().len())?;
        let normal = self.in_groups(&value, at, |reader, of, width| {
            let square =
                reader.builder.add(Step::Distances { of, centres: vec![0.0; width], lengths: vec![1.0; width] }, 1)?;
            let mean = reader.builder.elementwise(square, Elementwise::Linear, vec![1.0 / width as f64, epsilon])?;
            let inverse = reader.builder.elementwise(mean, Elementwise::Power, vec![-0.5])?;
            let repeated = reader.builder.columns(vec![[inverse as u32, 0]; width])?;
            reader.builder.add(Step::Combine { of: [of, repeated], operation: Operation::Multiply }, width)
        })?;
        self.scaled(node, normal)
    }

    /// Times input 1, plus input 2.
    fn scaled(&mut self, node: &NodeProto, mut value: Value) -> Made {
        if let Some(scale) = self.given(node, 1)?.cloned() {
            value = self.combined(Operation::Multiply, &value, &scale)?;
        }
        if let Some(bias) = self.given(node, 2)?.cloned() {
            value = self.combined(Operation::Add, &value, &bias)?;
        }
        Ok(value)
    }

    /// Does something to each group of elements that differ in the axes from `at` on only.
    fn in_groups(
        &mut self,
        value: &Value,
        at: usize,
        mut make: impl FnMut(&mut Self, usize, usize) -> Result<usize, String>,
    ) -> Made {
        let Value::Row(row) = value else { return Err("a normalisation of a constant".into()) };
        let width: usize = row.shape[at..].iter().product();
        let groups: usize = row.shape[..at].iter().product();
        if width == 0 || groups == 0 {
            return Err("a normalisation of nothing".into());
        }
        if groups == 1 {
            let made = make(self, row.value, width)?;
            return Ok(Value::Row(Row { value: made, ..row.clone() }));
        }
        let mut columns = Vec::new();
        for group in 0..groups {
            let part = (group * width..(group + 1) * width).map(|column| [row.value as u32, column as u32]).collect();
            let part = self.builder.columns(part)?;
            let made = make(self, part, width)?;
            columns.extend((0..width).map(|column| [made as u32, column as u32]));
        }
        Ok(Value::Row(Row { value: self.builder.columns(columns)?, ..row.clone() }))
    }

    fn softmax(&mut self, node: &NodeProto) -> Made {
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        // before version 13 all axes from this one on are one
        let (default, whole) = if self.opset < 13 { (1, true) } else { (-1, false) };
        let at = axis(Attributes::of(node).integer("axis").unwrap_or(default), rank)?;
        if !whole && at + 1 != rank {
            return Err(format!("axis {at} of {rank}, expected the last one"));
        }
        self.in_groups(&value, at, |reader, of, width| reader.builder.add(Step::Softmax { of }, width))
    }

    fn reduce(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let mut value = self.input(node, 0)?;
        let shape = value.shape().to_vec();
        let axes = self.integers(node, 1, "axes")?;
        if axes.as_ref().is_none_or(Vec::is_empty) && attributes.integer("noop_with_empty_axes").unwrap_or(0) != 0 {
            return Ok(value);
        }
        let axes: Vec<usize> = match axes.filter(|axes| !axes.is_empty()) {
            Some(axes) => axes.iter().map(|at| axis(*at, shape.len())).collect::<Result<_, _>>()?,
            None => (0..shape.len()).collect(),
        };
        if matches!(node.op_type.as_str(), "ReduceSumSquare" | "ReduceL2") {
            value = self.mapped(&value, Elementwise::Power, vec![2.0])?;
        }
        let kept: Vec<usize> =
            shape.iter().enumerate().map(|(at, dim)| if axes.contains(&at) { 1 } else { *dim }).collect();
        let (count, width) = (kept.iter().product::<usize>(), shape.iter().product::<usize>());
        if count == 0 || width == 0 {
            return Err("a sum of nothing".into());
        }
        let rest: Vec<usize> = match attributes.integer("keepdims").unwrap_or(1) {
            0 => shape.iter().enumerate().filter(|(at, _)| !axes.contains(at)).map(|(_, dim)| *dim).collect(),
            _ => kept.clone(),
        };
        if node.op_type == "ReduceProd" {
            let product = self.factors(&value, &broadcast_places(&kept, &shape), kept)?;
            return self.reshaped(&product, rest);
        }
        weights_within_limits(count, width)?;
        let share = if node.op_type == "ReduceMean" { count as f64 / width as f64 } else { 1.0 };
        let into = broadcast_places(&kept, &shape);
        let mut weight = vec![0.0; count * width];
        into.iter().enumerate().for_each(|(column, row)| weight[row * width + column] = share);
        let mut sum = match &value {
            Value::Row(row) => self.affine(row, weight.into(), vec![0.0; count].into(), kept.clone())?,
            Value::Constant(tensor) => {
                let numbers = tensor.data.doubles();
                let rows = weight.chunks_exact(width);
                let sums = rows.map(|row| row.iter().zip(&numbers).map(|(weight, number)| weight * number).sum());
                Value::Constant(Tensor::like(&tensor.data, kept.clone(), sums.collect()))
            }
        };
        if node.op_type == "ReduceL2" {
            sum = self.mapped(&sum, Elementwise::Power, vec![0.5])?;
        }
        self.reshaped(&sum, rest)
    }

    /// Products of elements; `into`: of each element the place of its product.
    fn factors(&mut self, value: &Value, into: &[usize], shape: Vec<usize>) -> Made {
        let count: usize = shape.iter().product();
        let mut of: Vec<Vec<usize>> = vec![Vec::new(); count];
        into.iter().enumerate().for_each(|(element, place)| of[*place].push(element));
        let each = of.first().map_or(0, Vec::len);
        let mut product = None;
        for number in 0..each {
            let places: Vec<usize> = of.iter().map(|elements| elements[number]).collect();
            let factor = self.pick(value, &places, shape.clone())?;
            product = Some(match product {
                None => factor,
                Some(product) => self.combined(Operation::Multiply, &product, &factor)?,
            });
        }
        product.ok_or_else(|| "a product of nothing".into())
    }

    // ---- machine learning

    fn scaler(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        let value = self.input(node, 0)?;
        let width = value.shape().iter().product::<usize>();
        let numbers = |name: &str| -> Result<Vec<f64>, String> {
            match attributes.numbers(name)?.values {
                one if one.len() == 1 => Ok(vec![one[0]; width]),
                all if all.len() == width => Ok(all),
                other => Err(format!("attribute `{name}` has {} elements, expected {width}", other.len())),
            }
        };
        let (offset, scale) = (numbers("offset")?, numbers("scale")?);
        let offsets = offset.iter().zip(&scale).map(|(offset, scale)| -offset * scale).collect();
        self.mapped(&value, Elementwise::Linear, [scale, offsets].concat())
    }

    fn linear_regressor(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        refuse_transform(attributes)?;
        let row = self.row(node, 0)?;
        let width = self.builder.width(row.value);
        let targets = usize::try_from(attributes.integer("targets").unwrap_or(1)).unwrap_or(0);
        let (weight, mut bias) = (attributes.numbers("coefficients")?.values, attributes.numbers("intercepts")?.values);
        if bias.is_empty() {
            bias = vec![0.0; targets];
        }
        if targets == 0 || weight.len() != targets * width || bias.len() != targets {
            return Err(format!(
                "{} coefficients and {} intercepts, expected {targets} times {width} and {targets}",
                weight.len(),
                bias.len()
            ));
        }
        self.affine(&row, single(weight), single(bias), vec![1, targets])
    }

    fn svm_regressor(&mut self, node: &NodeProto) -> Made {
        let attributes = Attributes::of(node);
        refuse_transform(attributes)?;
        if attributes.integer("one_class").unwrap_or(0) != 0 {
            return Err("a classifier of one class, expected a regression".into());
        }
        let row = self.row(node, 0)?;
        let width = self.builder.width(row.value);
        let supports = usize::try_from(attributes.integer("n_supports").unwrap_or(0)).unwrap_or(0);
        let (coefficients, rho) = (attributes.numbers("coefficients")?.values, attributes.numbers("rho")?.values);
        let bias = rho.first().copied().unwrap_or(0.0);
        let kernel = attributes.text("kernel_type").unwrap_or("LINEAR".into());
        if supports == 0 {
            if coefficients.len() != width {
                return Err(format!("{} coefficients, expected {width}", coefficients.len()));
            }
            return self.affine(&row, single(coefficients), single(vec![bias]), vec![1, 1]);
        }
        let vectors = attributes.numbers("support_vectors")?.values;
        if coefficients.len() != supports
            || vectors.len().checked_div(supports) != Some(width)
            || vectors.len() != supports * width
        {
            return Err(format!(
                "{} coefficients and {} numbers of support vectors, expected {supports} and {supports} times {width}",
                coefficients.len(),
                vectors.len()
            ));
        }
        let parameters = attributes.numbers("kernel_params")?.values;
        let parameter = |place: usize, default: f64| parameters.get(place).copied().unwrap_or(default);
        let (gamma, offset, degree) = (parameter(0, 0.0), parameter(1, 0.0), parameter(2, 0.0));
        let like_vectors = |factor: f64| vectors.iter().map(|number| factor * number).collect::<Vec<f64>>();
        let products = |reader: &mut Self, factor: f64, offset: f64| {
            reader.builder.affine(row.value, like_vectors(factor).into(), vec![offset; supports].into())
        };
        let kernels = match kernel.as_str() {
            "LINEAR" => products(self, 1.0, 0.0)?,
            "POLY" => {
                let line = products(self, gamma, offset)?;
                self.builder.elementwise(line, Elementwise::Power, vec![degree])?
            }
            "SIGMOID" => {
                let line = products(self, gamma, offset)?;
                self.builder.elementwise(line, Elementwise::Activation(Activation::Tanh), Vec::new())?
            }
            "RBF" => {
                let step = Step::Distances { of: row.value, centres: vectors.clone(), lengths: vec![1.0; width] };
                let distances = self.builder.add(step, supports)?;
                let exponent = self.builder.elementwise(distances, Elementwise::Linear, vec![-gamma, 0.0])?;
                self.builder.elementwise(exponent, Elementwise::Exponential, Vec::new())?
            }
            other => return Err(format!("kernel {other}, expected LINEAR, POLY, RBF or SIGMOID")),
        };
        let kernels = Row { shape: vec![1, supports], value: kernels, is_single: row.is_single };
        self.affine(&kernels, single(coefficients), single(vec![bias]), vec![1, 1])
    }

    fn normalizer(&mut self, node: &NodeProto) -> Made {
        let norm = Attributes::of(node).text("norm").unwrap_or("MAX".into());
        let value = self.input(node, 0)?;
        let rank = value.shape().len();
        if norm != "L2" || rank == 0 {
            return Err(format!("norm {norm}, expected L2"));
        }
        self.in_groups(&value, rank - 1, |reader, of, width| {
            let square =
                reader.builder.add(Step::Distances { of, centres: vec![0.0; width], lengths: vec![1.0; width] }, 1)?;
            let inverse = reader.builder.elementwise(square, Elementwise::Power, vec![-0.5])?;
            let repeated = reader.builder.columns(vec![[inverse as u32, 0]; width])?;
            reader.builder.add(Step::Combine { of: [of, repeated], operation: Operation::Multiply }, width)
        })
    }
}

fn constant(attributes: Attributes) -> Made {
    if let Some(tensor) = attributes.tensor("value") {
        return tensor.map(Value::Constant);
    }
    if let Some(value) = attributes.integer("value_int") {
        return Ok(Value::Constant(Tensor { shape: Vec::new(), data: Data::Integer(vec![value]) }));
    }
    if let Some(values) = attributes.integers("value_ints") {
        return Ok(Value::Constant(Tensor::of_integers(values.to_vec())));
    }
    let floats = attributes.numbers("value_floats")?.values;
    let (shape, values) = match floats.is_empty() {
        true => (Vec::new(), vec![attributes.float("value_float", f64::NAN).map_err(|_| "no value of a known kind")?]),
        false => (vec![floats.len()], floats),
    };
    Ok(Value::Constant(Tensor { shape, data: Data::Single(values.iter().map(|value| *value as f32).collect()) }))
}

fn lengths(dims: &[i64]) -> Result<Vec<usize>, String> {
    dims.iter().map(|dim| usize::try_from(*dim).map_err(|_| format!("a dimension of {dim}"))).collect()
}

/// The positions that a slice takes of `length`.
fn sliced(length: i64, (start, end, step): (i64, i64, i64)) -> Result<Vec<usize>, String> {
    if step == 0 {
        return Err("a step of 0".into());
    }
    let within = |place: i64, lowest: i64, highest: i64| {
        (if place < 0 { place.saturating_add(length) } else { place }).clamp(lowest, highest)
    };
    let (first, limit) = match step > 0 {
        true => (within(start, 0, length), within(end, 0, length)),
        false => (within(start, -1, length - 1), if end == i64::MIN { -1 } else { within(end, -1, length - 1) }),
    };
    let mut found = Vec::new();
    let mut place = first;
    while (step > 0 && place < limit) || (step < 0 && place > limit) {
        found.push(place as usize);
        place = match place.checked_add(step) {
            Some(next) => next,
            None => break,
        };
    }
    Ok(found)
}

fn of_numbers(operation: Operation, a: f64, b: f64, is_whole: bool) -> f64 {
    match operation {
        Operation::Add => a + b,
        Operation::Subtract => a - b,
        Operation::Multiply => a * b,
        Operation::Divide if is_whole => (a / b).trunc(),
        Operation::Divide => a / b,
        Operation::Maximum => a.max(b),
        Operation::Minimum => a.min(b),
    }
}

fn weights_within_limits(rows: usize, columns: usize) -> Result<(), String> {
    const LIMIT: usize = 1 << 25;
    match rows.checked_mul(columns) {
        Some(count) if count <= LIMIT => Ok(()),
        _ => {
            Err(format!("a product of {columns} numbers with {rows} rows of weights, expected at most {LIMIT} weights"))
        }
    }
}

/// Weights of a file, in its precision.
fn of_data(data: Data) -> Numbers {
    match data {
        Data::Single(values) => values.into(),
        Data::Double(values) => values.into(),
        Data::Integer(values) => values.into_iter().map(|value| value as f64).collect::<Vec<f64>>().into(),
    }
}

fn zeros_like(numbers: &Numbers, count: usize) -> Numbers {
    match numbers {
        Numbers::Single(_) => vec![0.0f32; count].into(),
        Numbers::Double(_) => vec![0.0f64; count].into(),
    }
}

/// As singles if all of them are.
fn single(values: Vec<f64>) -> Numbers {
    match values.iter().all(|value| f64::from(*value as f32) == *value) {
        true => values.into_iter().map(|value| value as f32).collect::<Vec<f32>>().into(),
        false => values.into(),
    }
}
