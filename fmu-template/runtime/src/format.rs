//! The model file.
//!
//! A safetensors container: numpy (`safetensors.numpy.load_file`) and PyTorch (`safetensors.torch.load_file`) open it
//! in one line. The very same file is an FMU's `resources/model.safetensors`.
//!
//! The graph of the program is a sequence of steps K; value 0 is the columns, value K + 1 the result of step K. The
//! columns of a [static](Clock::Static) program are the inputs after their [`Encoding`](crate::Encoding), input by
//! input. An input is one column unless the metadata say otherwise: a nominal input is one for each value, a periodic
//! one sine and cosine.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `graph.inputs` | U32 | `[1]` | number of columns |
//! | `graph.steps` | U32 | `[steps, 4]` | kind, code and operands of each step, see the kinds below |
//! | `graph.K.weight`, `graph.K.bias` | F32 or F64 | `[outputs, inputs]`, `[outputs]` | of an affine step, as PyTorch's `Linear` |
//! | `graph.K.parameters` | F64 | `[parameters]` or `[parameters * length]` | of an elementwise step; `ε` of a normalized one |
//! | `graph.K.mean`, `graph.K.scale` | F64 | `[length]` | standardized: `(x - mean) / scale`, rescaled: `mean + scale * x` |
//! | `graph.K.columns` | U32 | `[outputs, 2]` | a value, and a position in it |
//! | `graph.K.centres`, `graph.K.lengths` | F64 | `[centres, inputs]`, `[inputs]` | of distances |
//! | `graph.K.forest.column`, `graph.K.forest.number` | U32, F64 | `[nodes]` | of a [`Forest`](crate::graph::Forest); a column of 2^32 - 1 is a leaf |
//! | `graph.K.forest.below` | U32 | `[nodes, 2]` | |
//! | `graph.K.forest.root`, `graph.K.forest.output` | U32 | `[trees]` | |
//! | `graph.K.degrees` | U8 | `[terms, inputs]` | of [`Products`](crate::graph::Products) |
//! | `graph.K.function.*` | | | the tensors of another graph, without the kinds from 12 on |
//! | `graph.K.instants` | F64 | `[instants]` | seconds, ascending |
//! | `graph.K.functions.*` | | `[instants, ...]` | the tensors of the networks, of all time points one after the other |
//!
//! The kinds of steps and their codes are
//!
//! | kind | step | code |
//! |---|---|---|
//! | 0 | affine | |
//! | 1 | elementwise | position in [`Activation::ALL`](crate::Activation::ALL); from 32 on the other functions, in the order of [`Elementwise`](crate::graph::Elementwise) |
//! | 2 | combination of two values | position in [`Operation::ALL`](crate::graph::Operation::ALL) |
//! | 3 | columns | |
//! | 4 | normalized | |
//! | 5 | softmax | |
//! | 6 | distances | |
//! | 7 | forest | number of outputs |
//! | 8 | selection of one of two values | value that decides |
//! | 9 | products of Legendre polynomials | |
//! | 10 | standardized | |
//! | 11 | rescaled | |
//! | 12 | another graph | |
//! | 13 | interpolation between graphs | position of the time |
//! | 14 | dictionary | |
//! | 15 | equations of motion | |
//!
//! A network is a graph of a standardized step, affine and elementwise ones by turns, and a rescaled one.
//!
//! [Dictionaries](crate::dictionary) are sums of products of columns. X is `graph.K` of a dictionary:
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `X.columns` | F64 | `[columns, 2]` | of an angle 0, 0; of a power the middle and the half of its range |
//! | `X.exponents` | I16 | `[terms, columns]` | a harmonic, negative of a sine, or a power |
//! | `X.coefficients` | F64 | `[terms, functions]` | |
//!
//! [Equations of motion](crate::Motion) have two dictionaries, functions of the equations and positions. Their columns are
//! coordinates, then parameters. X is `graph.K`:
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `X.columns` | | | as those of a dictionary |
//! | `X.splines.columns` | U32 | `[splines]` | argument of each spline; three exponents of each, powers of its value and its two derivatives, follow those of the columns; absent without splines |
//! | `X.splines.K.x`, `X.splines.K.values`, `X.splines.K.kinds` | | | spline K, as `X.efforts.tables.K` |
//! | `X.functions.exponents`, `X.positions.exponents` | | | as `X.exponents` of a dictionary |
//! | `X.functions.coefficients`, `X.positions.coefficients` | | | in the order of [`Dynamics`](crate::Dynamics); positions |
//! | `X.functions.prescribed` | U32 | `[drivers]` | coordinates whose accelerations are prescribed; missing if there are none |
//! | `X.efforts.inputs` | U32 | `[1]` | number of inputs |
//! | `X.efforts.windings` | F64 | `[positions, coordinates]` | of the positions in the [`Efforts`](crate::Efforts), as those of the positions |
//! | `X.efforts.steps` | U32 | `[steps, 2]` | formulas of the efforts, one after the other in postfix notation: kind and argument of each step, see below |
//! | `X.efforts.constants` | F64 | `[constants]` | numbers in the formulas |
//! | `X.efforts.tables.K.x`, `X.efforts.tables.K.y` | F64 | `[x]`, `[y]` | knots of [lookup table](crate::formula::LookupTable) K; one with one argument has no `y` |
//! | `X.efforts.tables.K.values` | F64 | `[x]` or `[x, y]` | values at the knots |
//! | `X.efforts.tables.K.kinds` | U32 | `[2]` | positions in [`Interpolation::ALL`](crate::formula::Interpolation::ALL) and [`Extrapolation::ALL`](crate::formula::Extrapolation::ALL) |
//! | `X.positions.windings` | F64 | `[positions, coordinates]` | added to a position for each radian of a coordinate |
//! | `X.outputs.shown` | U32 | `[outputs, 2]` | 0, 1, 2: this derivative of position K; 3: kinetic, 4: potential energy; 5: reaction K; 6: effort K |
//! | `X.states.actuators` | U32 | `[1]` | number of actuator states; missing if there are none |
//! | `X.reactions.exponents`, `X.reactions.coefficients` | | | of [`Reactions`](crate::Reactions), forces of joints, drivers and springs, if there are any |
//!
//! The kinds of steps of a formula are
//!
//! | kind | step with argument K |
//! |---|---|
//! | 0 | element K of `efforts.constants` |
//! | 1 | column K |
//! | 2 | function K of [`ElementaryFunction::ALL`](crate::formula::ElementaryFunction::ALL) |
//! | 3 | minus |
//! | 4 | lookup table K |
//! | 5 and more | combination: 5 plus the position in [`Combination::ALL`](crate::formula::Combination::ALL) |
//!
//! A network may add to the function set, to the positions and to the forces: Y is `X.functions`, `X.positions` or `X.forces`. The
//! columns of the last one are coordinates, parameters, velocities and inputs; its results are the forces on the
//! coordinates.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `Y.network.columns` | U32 | `[network columns, 2]` | a column, and 0: it itself, 1: its sine, 2: its cosine |
//! | `Y.network.outputs` | U32 | `[network outputs]` | functions that they are added to |
//! | `Y.network.graph.*` | | | the tensors of the network |
//!
//! A [continuous](Clock::Continuous) program has, for its solver,
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `solver.step` | F64 | `[1]` | longest step, in seconds |
//! | `solver.tolerance` | F64 | `[1]` | largest error of a step, relative to the states' nominal values; missing if all steps are equal |
//! | `solver.implicit_tolerance` | F64 | `[1]` | largest error of a step of the implicit method, instead of `solver.tolerance` |
//!
//! and a [sampled](Clock::Sampled) one
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `samples.history` | U32 | `[2]` | number of past samples of the outputs and of the inputs |
//! | `samples.time` | F64 | `[1]` | time between two samples, in seconds |
//! | `samples.hidden` | F64 | `[hidden numbers]` | hidden numbers of a sample at the start; missing if there are none |
//! | `samples.direct` | F64 | `[outputs * inputs]` | direct effect of the inputs on the outputs; missing if there is none |
//! | `support.ranges` | F64 | `[measures, 2]` | smallest and largest value of each measure of a transition in training, if they are known: [`Support`] |
//! | `support.inputs` | U32 | `[1]` | number of inputs among the features: all or none |
//! | `support.components` | F64 | `[components * features]` | weights of the components, features from the averages of inputs on |
//! | `support.samples` | F64 | `[2]` | `M` and `L`: over how many samples inputs are averaged, and a distance fades |
//!
//! The container's string metadata has one entry, `metafmu`: the JSON text of [`Metadata`] beside two more fields, and a single
//! entry keeps the bytes independent of hash-map order. No other tensor may be present.
//!
//! | field | |
//! |---|---|
//! | `format` | 7, the version of this layout |
//! | `clock` | `"static"`, `"continuous"` or `"sampled"` |
//!
//! Older formats are refused: the program that made a file can make it again.

pub use crate::error::FORMAT;
use crate::error::{FormatError, METADATA_KEY};
use crate::{
    Clock, Metadata, Program, Sampling, Support, Surrogate,
    check::expect_shape,
    graph::Graph,
    tensors::{Tensor, Views, bytes, counts, elements, joined, take, whole_rows},
};
use fields::Fields;
use motion::{double, doubles, integration, of_integration};
use safetensors::{Dtype, SafeTensorError, SafeTensors, tensor::TensorView};
use serde::{Deserialize, Serialize};
use serde_json::Value;

#[derive(Serialize)]
struct HeaderOut<'a> {
    format: u32,
    clock: ClockKind,
    #[serde(flatten)]
    metadata: &'a Metadata,
}

/// A clock without its numbers.
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum ClockKind {
    Static,
    Continuous,
    Sampled,
}

/// Prefix of the tensor names of the program's graph.
const GRAPH: &str = "graph.";

impl Surrogate {
    /// The model file's bytes; the same surrogate always gives the same bytes.
    ///
    /// # Errors
    /// [`FormatError::Container`] or [`FormatError::Metadata`] if the libraries below refuse to serialize.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FormatError> {
        let Program { graph, clock } = self.program();
        let mut tensors = graph.tensors(GRAPH);
        let clock = match clock {
            Clock::Static => ClockKind::Static,
            Clock::Continuous(integration) => {
                tensors.extend(of_integration(*integration));
                ClockKind::Continuous
            }
            Clock::Sampled(sampling) => {
                tensors.extend(sampling.tensors());
                ClockKind::Sampled
            }
        };
        let header = HeaderOut { format: FORMAT, clock, metadata: self.metadata() };
        let text = serde_json::to_string(&header).map_err(FormatError::Metadata)?;
        let views: Vec<(&str, TensorView)> = tensors
            .iter()
            .map(|(name, dtype, shape, bytes)| Ok((name.as_str(), TensorView::new(*dtype, shape.clone(), bytes)?)))
            .collect::<Result<_, SafeTensorError>>()
            .map_err(FormatError::Container)?;
        let metadata = [(METADATA_KEY.to_owned(), text)].into_iter().collect();
        safetensors::serialize(views, Some(metadata)).map_err(FormatError::Container)
    }

    /// Reads and validates a model file, and makes sure that its content is what was once written.
    ///
    /// # Errors
    /// A [`FormatError`] that says what is wrong where.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormatError> {
        let (length, container) = SafeTensors::read_metadata(bytes).map_err(FormatError::Container)?;
        let text = container.metadata().as_ref().and_then(|entries| entries.get(METADATA_KEY));
        let (clock, metadata) = parse_header(text.ok_or(FormatError::NoMetadata)?)?;
        let data = &bytes[size_of::<u64>() + length..];
        let mut tensors = Views::new(&container, data);
        let graph = Graph::read(&mut tensors, GRAPH, false)?;
        let clock = match clock {
            ClockKind::Static => Clock::Static,
            ClockKind::Continuous => Clock::Continuous(integration(&mut tensors)?),
            ClockKind::Sampled => Clock::Sampled(Box::new(Sampling::read(&mut tensors)?)),
        };
        if let Some(name) = tensors.unread() {
            return Err(FormatError::UnknownTensor { name });
        }
        let surrogate = Self::new(metadata, Program { graph, clock })?;
        surrogate.check_content(bytes)?;
        Ok(surrogate)
    }
}

impl Sampling {
    /// Name, type, shape and content of each.
    fn tensors(&self) -> Vec<Tensor> {
        let Self { hidden, direct, history, step, support } = self;
        let history = history.map(|count| count as u32);
        let mut tensors: Vec<Tensor> = vec![
            ("samples.history".into(), Dtype::U32, vec![2], bytes(&history, u32::to_le_bytes)),
            double("samples.time", &[1], &[*step]),
        ];
        if !hidden.is_empty() {
            tensors.push(double("samples.hidden", &[hidden.len()], hidden));
        }
        if !direct.is_empty() {
            tensors.push(double("samples.direct", &[direct.len()], direct));
        }
        if let Some(Support { inputs, ranges, components, samples, lasting }) = support {
            let count = [*inputs as u32];
            tensors.push(("support.inputs".into(), Dtype::U32, vec![1], bytes(&count, u32::to_le_bytes)));
            tensors.push(double("support.components", &[components.len()], components));
            tensors.push(double("support.ranges", &[ranges.len(), 2], ranges.as_flattened()));
            tensors.push(double("support.samples", &[2], &[*samples, *lasting]));
        }
        tensors
    }

    fn read(tensors: &mut Views) -> Result<Self, FormatError> {
        let history = counts(tensors, "samples.history", 2)?;
        let step = exactly(tensors, "samples.time", 1)?[0];
        let support = match tensors.contain("support.ranges") {
            true => {
                let (ranges, shape) = doubles(tensors, "support.ranges", 2)?;
                expect_shape("support.ranges", &shape, &[shape[0], 2])?;
                let samples = exactly(tensors, "support.samples", 2)?;
                let inputs = counts(tensors, "support.inputs", 1)?[0] as usize;
                let (components, _) = doubles(tensors, "support.components", 1)?;
                let ranges = ranges.as_chunks().0.to_vec();
                Some(Support { inputs, ranges, components, samples: samples[0], lasting: samples[1] })
            }
            false => None,
        };
        let hidden = if_any(tensors, "samples.hidden")?;
        let direct = if_any(tensors, "samples.direct")?;
        Ok(Self { hidden, direct, history: [history[0] as usize, history[1] as usize], step, support })
    }
}

/// Takes a tensor of `count` numbers.
fn exactly(tensors: &mut Views, name: &str, count: usize) -> Result<Vec<f64>, FormatError> {
    let (values, shape) = doubles(tensors, name, 1)?;
    expect_shape(name, &shape, &[count])?;
    Ok(values)
}

/// Takes the numbers of a tensor, none if the tensor is missing.
fn if_any(tensors: &mut Views, name: &str) -> Result<Vec<f64>, FormatError> {
    if tensors.contain(name) { doubles(tensors, name, 1).map(|(values, _)| values) } else { Ok(Vec::new()) }
}

/// Checks the version before the fields, so that a newer file is named as such and not by its first unknown field.
fn parse_header(text: &str) -> Result<(ClockKind, Metadata), FormatError> {
    // not `from_str`: that is generic, and would be compiled once more, for speed
    let fields = text.parse::<Value>().and_then(Fields::of);
    let mut fields = fields.map_err(FormatError::Metadata)?;
    match fields.take::<u32>("format").map_err(FormatError::Metadata)? {
        FORMAT => {}
        found if found < FORMAT => return Err(FormatError::OldVersion { found }),
        found => return Err(FormatError::NewVersion { found }),
    }
    if !fields.contain("clock") {
        return Err(FormatError::NoClock);
    }
    let clock = fields.take("clock").map_err(FormatError::Metadata)?;
    let metadata = Metadata::from_fields(fields).map_err(FormatError::Metadata)?;
    Ok((clock, metadata))
}

mod fields;
mod motion;
#[cfg(test)]
mod tests;
