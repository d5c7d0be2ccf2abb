//! The builder of graphs, for readers of fitted models.

use crate::{Error, PySurrogate, bytes, doubles, refused, rows, threads::shared};
use metafmu::{
    import::interface::ModelInterface,
    import::{
        self, About, Imported,
        builder::{Builder, GraphError},
        rounding::RandomRounding,
    },
};
use metafmu_runtime::{
    Activation, Layer, Numbers, ScaledNetwork,
    graph::{Elementwise, Forest, LEAF, Node, Operation, Step, Tree},
};
use pyo3::{prelude::*, types::PyByteArray};
use std::path::Path;

/// Functions of one number by name, besides activations.
const OTHERS: [(&str, Elementwise); 18] = [
    ("linear", Elementwise::Linear),
    ("cos", Elementwise::Cosine),
    ("exp", Elementwise::Exponential),
    ("log", Elementwise::Logarithm),
    ("reciprocal", Elementwise::Reciprocal),
    ("power", Elementwise::Power),
    ("abs", Elementwise::Absolute),
    ("erf", Elementwise::Erf),
    ("gelu", Elementwise::GeluExact),
    ("leaky_relu", Elementwise::LeakyRelu),
    ("elu", Elementwise::Elu),
    ("softplus", Elementwise::Softplus),
    ("softsign", Elementwise::Softsign),
    ("clip", Elementwise::Clip),
    ("thresholded_relu", Elementwise::ThresholdedRelu),
    ("atan", Elementwise::Arctangent),
    ("single", Elementwise::Single),
    ("positive", Elementwise::Positive),
];

/// Operations of two numbers by name.
const OPERATIONS: [(&str, Operation); 6] = [
    ("add", Operation::Add),
    ("subtract", Operation::Subtract),
    ("multiply", Operation::Multiply),
    ("divide", Operation::Divide),
    ("maximum", Operation::Maximum),
    ("minimum", Operation::Minimum),
];

/// Functions of one number by name.
fn functions() -> Vec<(&'static str, Elementwise)> {
    let name = |activation: Activation| match activation {
        // in Python frameworks, GELU without an addition is the exact one
        Activation::Gelu => "gelu_tanh",
        Activation::Sine => "sin",
        other => other.key(),
    };
    let activations = Activation::ALL.map(|activation| (name(activation), Elementwise::Activation(activation)));
    activations.into_iter().chain(OTHERS).collect()
}

/// The names of functions of one number.
pub fn names() -> Vec<&'static str> {
    functions().iter().map(|(name, _)| *name).collect()
}

fn by_name<T: Copy>(table: &[(&str, T)], wanted: &str) -> PyResult<T> {
    let found = table.iter().find(|(name, _)| *name == wanted).map(|(_, value)| *value);
    found.ok_or_else(|| refused(format!("no function `{wanted}`")))
}

/// A graph that is being made: value 0 is the row of inputs, and each method makes a value of others and gives its number.
#[pyclass(name = "Graph", module = "metafmu._metafmu")]
pub struct PyGraph {
    builder: Builder,
    is_finished: bool,
    values: usize,
}

impl PyGraph {
    /// Makes sure that the values exist: Python may say anything.
    fn check_values(&self, values: &[usize]) -> PyResult<()> {
        match values.iter().find(|value| **value >= self.values) {
            Some(value) => Err(refused(format!("value {value} of {}", self.values))),
            None => Ok(()),
        }
    }

    /// The builder, to add something of values that exist.
    fn of(&mut self, values: &[usize]) -> PyResult<&mut Builder> {
        self.check_values(values)?;
        if self.is_finished { Err(Error::new_err("the graph is finished")) } else { Ok(&mut self.builder) }
    }

    fn made(&mut self, made: Result<usize, GraphError>) -> PyResult<usize> {
        let value = made.map_err(refused)?;
        self.values = value + 1;
        Ok(value)
    }
}

/// The parameters of `a x + b`, number by number.
fn linear(factors: &[f64], offsets: &[f64]) -> Vec<f64> {
    factors.iter().chain(offsets).copied().collect()
}

fn lengths(what: &str, found: usize, expected: usize) -> PyResult<()> {
    if found == expected { Ok(()) } else { Err(refused(format!("{found} {what}, expected {expected}"))) }
}

#[pymethods]
impl PyGraph {
    #[new]
    fn new(inputs: usize) -> PyResult<Self> {
        if inputs == 0 {
            return Err(refused("no inputs, expected at least one"));
        }
        Ok(Self { builder: Builder::new(inputs), is_finished: false, values: 1 })
    }

    fn width(&self, value: usize) -> PyResult<usize> {
        self.check_values(&[value])?;
        Ok(self.builder.width(value))
    }

    /// `W x + b`; of `single` precision the bytes of `weight` and `bias` are floats, else doubles.
    fn affine(&mut self, of: usize, weight: &[u8], bias: &[u8], single: bool) -> PyResult<usize> {
        let numbers = |bytes: &[u8]| -> Numbers {
            let floats = |four: &[u8]| f32::from_ne_bytes(std::array::from_fn(|place| four[place]));
            match single {
                true => bytes.chunks_exact(4).map(floats).collect::<Vec<f32>>().into(),
                false => doubles(bytes).into(),
            }
        };
        let (weight, bias) = (numbers(weight), numbers(bias));
        let builder = self.of(&[of])?;
        lengths("weights", weight.len(), bias.len() * builder.width(of))?;
        let made = builder.affine(of, weight, bias);
        self.made(made)
    }

    /// Predictions of a surrogate without states, as steps: that of a regressor of ours in a pipeline.
    fn surrogate(&mut self, of: usize, surrogate: &PySurrogate) -> PyResult<usize> {
        surrogate.stateless()?;
        let predictions = surrogate.surrogate.predictions().len() as u32;
        if surrogate.surrogate.outputs().len() as u32 > predictions {
            let builder = self.of(&[of])?;
            let made = builder.append(of, &surrogate.surrogate.program().graph);
            let made =
                made.and_then(|made| builder.columns((0..predictions).map(|column| [made as u32, column]).collect()));
            return self.made(made);
        }
        let Some(ScaledNetwork { scaling, layers }) = surrogate.surrogate.network() else {
            let made = self.of(&[of])?.append(of, &surrogate.surrogate.program().graph);
            return self.made(made);
        };
        let builder = self.of(&[of])?;
        lengths("columns", builder.width(of), scaling.input_mean.len())?;
        let made = (|| -> Result<usize, GraphError> {
            let minus: Vec<f64> = scaling.input_mean.iter().map(|mean| -mean).collect();
            let mut value = builder.elementwise(of, Elementwise::Linear, linear(&vec![1.0; minus.len()], &minus))?;
            let factors: Vec<f64> = scaling.input_scale.iter().map(|scale| 1.0 / scale).collect();
            value = builder.elementwise(value, Elementwise::Linear, linear(&factors, &vec![0.0; factors.len()]))?;
            for Layer { weight, bias, activation, .. } in layers {
                value = builder.affine(value, weight, bias)?;
                value = builder.elementwise(value, Elementwise::Activation(activation), Vec::new())?;
            }
            builder.elementwise(value, Elementwise::Linear, linear(&scaling.output_scale, &scaling.output_mean))
        })();
        self.made(made)
    }

    fn elementwise(&mut self, of: usize, function: &str, parameters: Vec<f64>) -> PyResult<usize> {
        let function = by_name(&functions(), function)?;
        let builder = self.of(&[of])?;
        if parameters.len() != function.parameters() {
            lengths("parameters", parameters.len(), function.parameters() * builder.width(of))?;
        }
        let made = builder.elementwise(of, function, parameters);
        self.made(made)
    }

    fn combine(&mut self, first: usize, second: usize, operation: &str) -> PyResult<usize> {
        let operation = by_name(&OPERATIONS, operation)?;
        let builder = self.of(&[first, second])?;
        let width = builder.width(first);
        lengths("numbers", builder.width(second), width)?;
        let made = builder.add(Step::Combine { of: [first, second], operation }, width);
        self.made(made)
    }

    /// Numbers of one value where a condition is positive, else of another one.
    fn choose(&mut self, condition: usize, chosen: usize, otherwise: usize) -> PyResult<usize> {
        let builder = self.of(&[condition, chosen, otherwise])?;
        let width = builder.width(condition);
        for value in [chosen, otherwise] {
            lengths("numbers", builder.width(value), width)?;
        }
        let made = builder.add(Step::Select { of: [condition, chosen, otherwise] }, width);
        self.made(made)
    }

    fn columns(&mut self, columns: Vec<[u32; 2]>) -> PyResult<usize> {
        self.check_columns(&columns)?;
        let made = self.of(&[])?.columns(columns);
        self.made(made)
    }

    fn standardize(&mut self, of: usize, epsilon: f64) -> PyResult<usize> {
        let builder = self.of(&[of])?;
        let made = builder.add(Step::Normalize { of, epsilon }, builder.width(of));
        self.made(made)
    }

    fn softmax(&mut self, of: usize) -> PyResult<usize> {
        let builder = self.of(&[of])?;
        let made = builder.add(Step::Softmax { of }, builder.width(of));
        self.made(made)
    }

    fn distances(&mut self, of: usize, centres: &[u8], lengths: Vec<f64>) -> PyResult<usize> {
        let centres = doubles(centres);
        let builder = self.of(&[of])?;
        let width = builder.width(of);
        self::lengths("lengths", lengths.len(), width)?;
        if centres.is_empty() || !centres.len().is_multiple_of(width) {
            return Err(refused(format!("{} numbers of centres, expected a multiple of {width}", centres.len())));
        }
        let rows = centres.len() / width;
        let made = builder.add(Step::Distances { of, centres, lengths }, rows);
        self.made(made)
    }

    /// Nodes of all trees: the column of a split, negative at a leaf; its threshold, or the leaf's number; the nodes below. Of each tree
    /// the first node and the output.
    fn forest(
        &mut self,
        of: usize,
        columns: Vec<i64>,
        numbers: &[u8],
        below: Vec<[u32; 2]>,
        trees: Vec<[u32; 2]>,
        outputs: usize,
    ) -> PyResult<usize> {
        let numbers = doubles(numbers);
        lengths("numbers of nodes", numbers.len(), columns.len())?;
        lengths("pairs of nodes", below.len(), columns.len())?;
        let nodes = columns.iter().zip(numbers).zip(below).map(|((column, number), below)| Node {
            column: u32::try_from(*column).unwrap_or(LEAF),
            number,
            below,
        });
        let trees = trees.iter().map(|[root, output]| Tree { root: *root, output: *output });
        let forest = Forest { nodes: nodes.collect(), trees: trees.collect() };
        let made = self.of(&[of])?.add(Step::Forest { of, forest: forest.into(), outputs }, outputs);
        self.made(made)
    }

    /// Values of these columns at rows of the inputs, before the graph is finished.
    fn evaluate<'py>(
        &mut self,
        py: Python<'py>,
        columns: Vec<[u32; 2]>,
        x: &[u8],
    ) -> PyResult<Bound<'py, PyByteArray>> {
        self.check_columns(&columns)?;
        let builder = self.of(&[])?.clone();
        let points = rows(Some(x), builder.width(0)).unwrap_or_default();
        let graph = builder.finish(columns).map_err(refused)?;
        Ok(PyByteArray::new(py, &bytes(&graph.evaluate(&points).into_values())))
    }

    /// Values of these columns at rows of the inputs, with all values rounded at random: relative and absolute size, and a seed. The graph
    /// may be finished.
    #[allow(clippy::needless_pass_by_value)]
    fn rounded<'py>(
        &self,
        py: Python<'py>,
        columns: Vec<[u32; 2]>,
        x: &[u8],
        sizes: (f64, f64),
        seed: u64,
    ) -> PyResult<Bound<'py, PyByteArray>> {
        let points = rows(Some(x), self.builder.width(0)).unwrap_or_default();
        let is_there = |[of, place]: &[u32; 2]| {
            (*of as usize) < self.values && (*place as usize) < self.builder.width(*of as usize)
        };
        if !columns.iter().all(is_there) {
            return Err(refused("a column that no value has"));
        }
        let (relative, absolute) = sizes;
        let graph = RandomRounding { relative, absolute, seed }.of(&self.builder, columns).map_err(refused)?;
        Ok(PyByteArray::new(py, &bytes(&graph.evaluate(&points).into_values())))
    }

    /// Finishes the graph with these columns as the outputs of a model, whose columns have names: `named` has those of
    /// the inputs and of the outputs.
    #[allow(clippy::too_many_arguments)]
    fn finish_with_states(
        &mut self,
        columns: Vec<[u32; 2]>,
        interface: &str,
        data: Option<&[u8]>,
        content: &[u8],
        single: bool,
        producer: &str,
        named: (Vec<String>, Vec<String>),
    ) -> PyResult<PySurrogate> {
        let interface = ModelInterface::from_json(interface).map_err(refused)?;
        let (inputs, outputs) = named;
        let builder = self.taken(&columns, [inputs.len(), outputs.len()])?;
        let rows = rows(data, interface.variables().count());
        let (stacked, recurrences, producer) = (Vec::new(), Vec::new(), producer.to_owned());
        let imported =
            Imported { inputs, stacked, outputs, builder, columns, recurrences, is_single: single, producer };
        let path = Path::new(&interface.name);
        let made = shared(|| import::surrogate((path, content), imported, &interface, rows));
        made.map(PySurrogate::new).map_err(refused)
    }

    /// Finishes the graph with these columns as the outputs.
    fn finish(
        &mut self,
        columns: Vec<[u32; 2]>,
        interface: &str,
        data: Option<&[u8]>,
        content: &[u8],
        single: bool,
        producer: &str,
    ) -> PyResult<PySurrogate> {
        let interface = ModelInterface::from_json(interface).map_err(refused)?;
        let variables = interface.variables().count();
        let builder = self.taken(&columns, [variables, interface.outputs.len()])?;
        let rows = rows(data, variables);
        let graph = builder.finish(columns).map_err(refused)?;
        let about = About { path: Path::new(&interface.name), content, is_single: single, producer };
        let made = shared(|| import::of_graph(graph, about, &interface, rows));
        made.map(PySurrogate::new).map_err(refused)
    }
}

impl PyGraph {
    /// Takes the builder of a graph that is finished, after a check of the numbers of inputs and outputs.
    fn taken(&mut self, columns: &[[u32; 2]], [inputs, outputs]: [usize; 2]) -> PyResult<Builder> {
        self.check_columns(columns)?;
        lengths("outputs", columns.len(), outputs)?;
        lengths("columns of inputs", self.of(&[0])?.width(0), inputs)?;
        self.is_finished = true;
        Ok(self.builder.clone())
    }

    fn check_columns(&mut self, columns: &[[u32; 2]]) -> PyResult<()> {
        if columns.is_empty() {
            return Err(refused("no columns, expected at least one"));
        }
        for [of, column] in columns {
            let width = self.of(&[*of as usize])?.width(*of as usize);
            if *column as usize >= width {
                return Err(refused(format!("column {column} of {width}")));
            }
        }
        Ok(())
    }
}
