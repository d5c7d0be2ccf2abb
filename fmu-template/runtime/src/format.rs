//! The model file.
//!
//! A safetensors container: numpy (`safetensors.numpy.load_file`) and PyTorch (`safetensors.torch.load_file`) open it
//! in one line. The very same file is an FMU's `resources/model.safetensors`.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `outputs.input_mean`, `outputs.input_scale` | F64 | `[input columns]` | `z = (x - mean) / scale` |
//! | `outputs.layers.K.weight` | F32 or F64 | `[outputs of layer K, inputs of layer K]` | K counts from 0; PyTorch's `Linear` convention |
//! | `outputs.layers.K.bias` | F32 or F64 | `[outputs of layer K]` | |
//! | `outputs.output_mean`, `outputs.output_scale` | F64 | `[outputs]` | `y = mean + scale * z` |
//!
//! The names begin with the map that the tensors belong to: `outputs` is the one that gives the outputs. Input columns are
//! those after the inputs' [`Encoding`](crate::Encoding), input by input: one column unless the metadata say
//! otherwise, for a nominal input one for each value, for a periodic one sine and cosine.
//!
//! That is a [`Model::Response`] of a network. A [`Model::PerInstant`], a network for each instant, has one more tensor,
//! `instants`, F64 of shape `[instants]`: seconds, ascending. Every other tensor has one more dimension in front, the
//! instant, and the input columns are those other than the time, in order.
//!
//! A [graph](crate::graph::Graph), of a baseline or of a third-party tool, is a sequence of steps K; value 0 is the input columns, value
//! K + 1 the result of step K:
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `graph.inputs` | U32 | `[1]` | number of input columns |
//! | `graph.steps` | U32 | `[steps, 4]` | kind, code, and the values that it is of: 0: affine, 1: elementwise, code: position in [`Elementwise::ALL`](crate::graph::Elementwise::ALL), 2: of two values, code: position in [`Operation::ALL`](crate::graph::Operation::ALL), 3: columns, 4: standardised, 5: softmax, 6: distances, 7: forest, code: number of outputs, 8: one of two values, code: the value that says which, 9: products of Legendre polynomials |
//! | `graph.K.weight`, `graph.K.bias` | F32 or F64 | `[outputs, inputs]`, `[outputs]` | of an affine step |
//! | `graph.K.parameters` | F64 | `[parameters]` or `[parameters * length]` | of an elementwise step; `ε` of a standardised one |
//! | `graph.K.columns` | U32 | `[outputs, 2]` | a value, and a position in it |
//! | `graph.K.centres`, `graph.K.lengths` | F64 | `[centres, inputs]`, `[inputs]` | of distances |
//! | `graph.K.forest.column`, `graph.K.forest.number` | U32, F64 | `[nodes]` | of a [`Forest`](crate::graph::Forest); a column of 2^32 - 1 is a leaf |
//! | `graph.K.forest.below` | U32 | `[nodes, 2]` | |
//! | `graph.K.forest.root`, `graph.K.forest.output` | U32 | `[trees]` | |
//! | `graph.K.degrees` | U8 | `[terms, inputs]` | of [`Products`](crate::graph::Products) |
//!
//! A [`Model::Motion`] has two [dictionaries](crate::dictionary), the functions of the equations of motion and the positions, over
//! the same columns: coordinates, then parameters.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `columns` | F64 | `[columns, 2]` | of an angle 0, 0; of a power the middle and the half of its range |
//! | `law.exponents`, `positions.exponents` | I16 | `[terms, columns]` | a harmonic, negative of a sine, or a power |
//! | `law.coefficients`, `positions.coefficients` | F64 | `[terms, functions]` | in the order of [`Dynamics`](crate::Dynamics); positions |
//! | `law.prescribed` | U32 | `[drivers]` | coordinates whose accelerations are prescribed; left out if there are none |
//! | `efforts.inputs` | U32 | `[1]` | number of inputs |
//! | `efforts.windings` | F64 | `[positions, coordinates]` | of the positions in the [`Efforts`](crate::Efforts), as those of the positions |
//! | `efforts.steps` | U32 | `[steps, 2]` | formulas of the efforts, one after the other in postfix notation, each a kind and an argument: 0: element K of `efforts.constants`, 1: column K, 2: function K of [`ElementaryFunction::ALL`](crate::formula::ElementaryFunction::ALL), 3: minus, 4: lookup table K, 5 and more: combination K of [`Combination::ALL`](crate::formula::Combination::ALL), from 5 on |
//! | `efforts.constants` | F64 | `[constants]` | numbers in the formulas |
//! | `efforts.tables.K.x`, `efforts.tables.K.y` | F64 | `[x]`, `[y]` | knots of [lookup table](crate::formula::LookupTable) K; one with one argument has no `y` |
//! | `efforts.tables.K.values` | F64 | `[x]` or `[x, y]` | values at the knots |
//! | `efforts.tables.K.kinds` | U32 | `[2]` | positions in [`Interpolation::ALL`](crate::formula::Interpolation::ALL) and [`Extrapolation::ALL`](crate::formula::Extrapolation::ALL) |
//! | `positions.windings` | F64 | `[positions, coordinates]` | added to a position for each radian of a coordinate |
//! | `outputs.shown` | U32 | `[outputs, 2]` | 0, 1, 2: this derivative of position K; 3: kinetic, 4: potential energy; 5: reaction K |
//! | `solver.step` | F64 | `[1]` | longest step, in seconds |
//! | `solver.tolerance` | F64 | `[1]` | largest error of a step, relative to the states' nominal values; left out if all steps are equal |
//!
//! If there are [`Reactions`](crate::Reactions), forces of joints, drivers and springs, a third dictionary gives them: `reactions.exponents` and
//! `reactions.coefficients`, in the order of their functions.
//!
//! A network may add to the law, to the positions and to the forces: X is `law`, `positions` or `forces`. The columns of the last one
//! are coordinates, parameters, velocities and inputs, and it gives the forces on the coordinates.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `X.network.columns` | U32 | `[network columns, 2]` | a column, and 0: it itself, 1: its sine, 2: its cosine |
//! | `X.network.outputs` | U32 | `[network outputs]` | functions that they are added to |
//! | `X.network.activations` | U32 | `[layers]` | 0: tanh, 1: sigmoid, 2: relu, 3: gelu, 4: silu, 5: sine, 6: identity |
//! | `X.network.input_mean`, ..., `X.network.layers.K.weight`, ... | | | as those of `outputs.` above |
//!
//! A [`Model::StateSpace`] has a dictionary over parameters, inputs and states, and the tensors `outputs.` of a network or graph if there is
//! one (MAP then is that of it).
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `counts` | U32 | `[3]` | number of parameters, of inputs and of states |
//! | `columns`, `functions.exponents`, `functions.coefficients` | | | as those of a motion |
//! | `results.given` | U32 | `[outputs + states, 2]` | outputs, then derivatives: 0: state K, 1: function K |
//! | `solver.step`, `solver.tolerance` | | | as those of a motion |
//!
//! A [`Model::Discrete`] has a linear part, and the tensors `outputs.` of a network or graph if there is one (MAP then is that of it). A
//! sample has numbers: the outputs, and those that are hidden.
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `counts` | U32 | `[3]` | number of parameters, of inputs and of outputs |
//! | `history` | U32 | `[2]` | number of past samples of the outputs and of the inputs |
//! | `sample.time` | F64 | `[1]` | time between two samples, in seconds |
//! | `linear.weights`, `linear.constants` | F64 | `[numbers, columns]`, `[numbers]` | of past numbers, past inputs, the newest first, and parameters; the first one is missing if it is zero |
//! | `hidden.start` | F64 | `[hidden numbers]` | what they are at the start; missing if there are none |
//!
//! The ranges of its training are its [`Support`](crate::Support), if they are known:
//!
//! | tensor | type | shape | |
//! |---|---|---|---|
//! | `support.ranges` | F64 | `[features, 2]` | smallest and largest value of each feature of a transition |
//! | `support.samples` | F64 | `[1]` | `M`: over how many samples inputs are averaged, and a distance fades |
//!
//! The container's string metadata has one entry, `metafmu`: the JSON text of [`Metadata`] beside two more fields, and a single
//! entry keeps the bytes independent of hash-map order. No other tensor may be present.
//!
//! | field | |
//! |---|---|
//! | `format` | 4, the version of this layout |
//! | `model` | `{"structure": "response", "per-instant", "motion", "state-space" or "discrete", "outputs": MAP}`; of a motion MAP is `{"map": "dictionary"}`, of a discrete model without another map `{"map": "linear"}`, else `{"map": "network", "activations": [one for each layer]}` or `{"map": "graph"}` |
//!
//! Older formats are refused: what made them can make them again. Format 1 had one activation for all hidden layers and no names of
//! maps; format 2 had no efforts.

pub use crate::error::FORMAT;
use crate::error::{FormatError, METADATA_KEY};
use crate::{
    Activation, Discrete, Layer, Map, Metadata, Model, Motion, Numbers, ScaledNetwork, Scaling, StateSpace, Surrogate,
    graph::Graph,
    map::tensors::{OUTPUTS, Tensor, Views, bytes, elements, numbers, take, take_one_of},
};
use fields::{Fields, Read};
use safetensors::{
    Dtype, SafeTensorError, SafeTensors,
    tensor::{TensorInfo, TensorView},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

#[derive(Serialize)]
struct HeaderOut<'a> {
    format: u32,
    model: ModelHeader,
    #[serde(flatten)]
    metadata: &'a Metadata,
}

/// The structure of a model, without its numbers.
#[derive(Serialize)]
struct ModelHeader {
    structure: Structure,
    outputs: MapHeader,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Structure {
    Response,
    PerInstant,
    Motion,
    StateSpace,
    Discrete,
}

#[derive(Serialize)]
struct MapHeader {
    map: MapKind,
    /// Of the layers of a network.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    activations: Vec<Activation>,
}

#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum MapKind {
    Network,
    Graph,
    Dictionary,
    Linear,
}

impl ModelHeader {
    fn of(model: &Model) -> Self {
        match model {
            Model::Response(map) => Self { structure: Structure::Response, outputs: MapHeader::of(map) },
            Model::PerInstant { networks, .. } => {
                Self { structure: Structure::PerInstant, outputs: MapHeader::of_network(&networks[0]) }
            }
            Model::Motion(_) => {
                let outputs = MapHeader { map: MapKind::Dictionary, activations: Vec::new() };
                Self { structure: Structure::Motion, outputs }
            }
            Model::Discrete(discrete) => {
                let linear = || MapHeader { map: MapKind::Linear, activations: Vec::new() };
                let outputs = discrete.map.as_ref().map_or_else(linear, MapHeader::of);
                Self { structure: Structure::Discrete, outputs }
            }
            Model::StateSpace(space) => {
                let dictionary = || MapHeader { map: MapKind::Dictionary, activations: Vec::new() };
                let outputs = space.map.as_ref().map_or_else(dictionary, MapHeader::of);
                Self { structure: Structure::StateSpace, outputs }
            }
        }
    }
}

impl MapHeader {
    fn of(map: &Map) -> Self {
        let kind = match map {
            Map::Network(network) => return Self::of_network(network),
            Map::Graph(_) => MapKind::Graph,
        };
        Self { map: kind, activations: Vec::new() }
    }

    fn of_network(network: &ScaledNetwork) -> Self {
        let activations = network.layers.iter().map(|layer| layer.activation).collect();
        Self { map: MapKind::Network, activations }
    }
}

impl Surrogate {
    /// The model file's bytes; the same surrogate always gives the same bytes.
    ///
    /// # Errors
    /// [`FormatError::Container`] or [`FormatError::Metadata`] if the libraries below refuse to serialize.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FormatError> {
        let header = HeaderOut { format: FORMAT, model: ModelHeader::of(self.model()), metadata: self.metadata() };
        let text = serde_json::to_string(&header).map_err(FormatError::Metadata)?;
        let mut tensors = match self.model() {
            Model::Response(map) => of_map(map),
            Model::PerInstant { networks, .. } => with_prefix(stacked(networks, Some(networks.len())), OUTPUTS),
            Model::Motion(motion) => motion.tensors(),
            Model::StateSpace(space) => space.tensors(),
            Model::Discrete(discrete) => discrete.tensors(),
        };
        if let Model::PerInstant { instants, .. } = self.model() {
            tensors.push(("instants".into(), Dtype::F64, vec![instants.len()], bytes(instants, f64::to_le_bytes)));
        }
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
        let (header, metadata) = parse_header(text.ok_or(FormatError::NoMetadata)?)?;
        let data = &bytes[size_of::<u64>() + length..];
        let mut tensors = Views::new();
        for (name, TensorInfo { dtype, shape, data_offsets: (begin, end) }) in container.tensors() {
            let view = TensorView::new(*dtype, shape.clone(), &data[*begin..*end]).map_err(FormatError::Container)?;
            tensors.insert(name, view);
        }
        let model = read_model(&header, &mut tensors)?;
        if let Some(name) = tensors.into_keys().min() {
            return Err(FormatError::UnknownTensor { name });
        }
        let surrogate = Self::new(metadata, model)?;
        surrogate.check_content(bytes)?;
        Ok(surrogate)
    }
}

fn read_model(header: &ModelHeader, tensors: &mut Views) -> Result<Model, FormatError> {
    let MapHeader { map, activations } = &header.outputs;
    match (&header.structure, map) {
        (Structure::Response, kind) => match added(tensors, kind, activations)? {
            Some(map) => Ok(Model::Response(map)),
            None if matches!(kind, MapKind::Linear) => Err(FormatError::DiscreteMap),
            None => Err(FormatError::MotionMap),
        },
        (Structure::PerInstant, MapKind::Network) => {
            let instants = take(tensors, "instants", Dtype::F64, 1)?;
            let instants = elements(instants.data(), f64::from_le_bytes);
            let networks = unstacked(tensors, OUTPUTS, activations, Some(instants.len()))?;
            Ok(Model::PerInstant { instants, networks })
        }
        (Structure::PerInstant, _) => Err(FormatError::PerInstantMap),
        (Structure::Motion, MapKind::Dictionary) => Ok(Model::Motion(Box::new(Motion::read(tensors)?))),
        (Structure::Motion, _) => Err(FormatError::MotionMap),
        (Structure::StateSpace, MapKind::Dictionary | MapKind::Network | MapKind::Graph) => {
            let map = added(tensors, map, activations)?;
            Ok(Model::StateSpace(Box::new(StateSpace::read(tensors, map)?)))
        }
        (Structure::StateSpace, _) => Err(FormatError::StateSpaceMap),
        (Structure::Discrete, MapKind::Linear | MapKind::Network | MapKind::Graph) => {
            let map = added(tensors, map, activations)?;
            Ok(Model::Discrete(Box::new(Discrete::read(tensors, map)?)))
        }
        (Structure::Discrete, _) => Err(FormatError::DiscreteMap),
    }
}

/// The network or graph of a model, of which there may be other functions.
fn added(tensors: &mut Views, map: &MapKind, activations: &[Activation]) -> Result<Option<Map>, FormatError> {
    match map {
        MapKind::Network => Ok(Some(Map::Network(unstacked(tensors, OUTPUTS, activations, None)?.remove(0)))),
        MapKind::Graph => Ok(Some(Map::Graph(Graph::read(tensors)?))),
        _ => Ok(None),
    }
}

type Column = fn(&Scaling) -> &Vec<f64>;

/// Each tensor of all networks as one, with `leading` as its first dimension if there is one.
fn stacked(networks: &[ScaledNetwork], leading: Option<usize>) -> Vec<Tensor> {
    let shape = |own: &[usize]| leading.into_iter().chain(own.iter().copied()).collect::<Vec<usize>>();
    let columns: [(&str, Column); 4] = [
        ("input_mean", |scaling| &scaling.input_mean),
        ("input_scale", |scaling| &scaling.input_scale),
        ("output_mean", |scaling| &scaling.output_mean),
        ("output_scale", |scaling| &scaling.output_scale),
    ];
    let mut tensors = Vec::new();
    for (name, column) in columns {
        let content = networks.iter().flat_map(|network| bytes(column(&network.scaling), f64::to_le_bytes)).collect();
        tensors.push((name.into(), Dtype::F64, shape(&[column(&networks[0].scaling).len()]), content));
    }
    for (index, Layer { inputs, outputs, .. }) in networks[0].layers.iter().enumerate() {
        let all = |numbers: fn(&Layer) -> &Numbers| {
            let numbers = || networks.iter().map(|network| numbers(&network.layers[index]));
            // in double precision if any of them is
            if numbers().all(|numbers| numbers.as_single().is_some()) {
                let singles =
                    numbers().filter_map(Numbers::as_single).flat_map(|values| bytes(values, f32::to_le_bytes));
                return (Dtype::F32, singles.collect());
            }
            (Dtype::F64, numbers().flat_map(Numbers::iter).flat_map(f64::to_le_bytes).collect())
        };
        let (weight, bias): ((Dtype, Vec<u8>), (Dtype, Vec<u8>)) =
            (all(|layer| &layer.weight), all(|layer| &layer.bias));
        tensors.push((format!("layers.{index}.weight"), weight.0, shape(&[*outputs, *inputs]), weight.1));
        tensors.push((format!("layers.{index}.bias"), bias.0, shape(&[*outputs]), bias.1));
    }
    tensors
}

/// The tensors of one network, whose names have a prefix.
fn of_one(network: &ScaledNetwork, prefix: &str) -> Vec<Tensor> {
    with_prefix(stacked(std::slice::from_ref(network), None), prefix)
}

/// The tensors of the map that gives the outputs.
fn of_map(map: &Map) -> Vec<Tensor> {
    let tensors = match map {
        Map::Network(network) => stacked(std::slice::from_ref(network), None),
        Map::Graph(graph) => graph.tensors(),
    };
    with_prefix(tensors, OUTPUTS)
}

fn with_prefix(mut tensors: Vec<Tensor>, prefix: &str) -> Vec<Tensor> {
    tensors.iter_mut().for_each(|(name, ..)| name.insert_str(0, prefix));
    tensors
}

/// The networks of such tensors, whose names have a prefix: `leading` of them, or one if there is no such dimension.
fn unstacked(
    tensors: &mut Views,
    prefix: &str,
    activations: &[Activation],
    leading: Option<usize>,
) -> Result<Vec<ScaledNetwork>, FormatError> {
    let mut of_all = |name: &str, types: &[Dtype], dimensions| {
        let name = format!("{prefix}{name}");
        let view = take_one_of(tensors, &name, types, dimensions + usize::from(leading.is_some()))?;
        match leading {
            Some(count) if view.shape()[0] != count => {
                let expected = [&[count], &view.shape()[1..]].concat();
                Err(FormatError::Shape { name, found: view.shape().to_vec(), expected })
            }
            _ => Ok(view),
        }
    };
    let mut column = |name| of_all(name, &[Dtype::F64], 1);
    let columns = [column("input_mean")?, column("input_scale")?, column("output_mean")?, column("output_scale")?];
    let mut layers = Vec::new();
    for (index, activation) in activations.iter().enumerate() {
        let weight = of_all(&format!("layers.{index}.weight"), &[Dtype::F32, Dtype::F64], 2)?;
        let bias = of_all(&format!("layers.{index}.bias"), &[Dtype::F32, Dtype::F64], 1)?;
        layers.push((weight, bias, *activation));
    }
    let count = leading.unwrap_or(1);
    let network = |index: usize| {
        let [input_mean, input_scale, output_mean, output_scale] =
            columns.each_ref().map(|view| elements(part(view, index, count), f64::from_le_bytes));
        let layer = |(weight, bias, activation): &(TensorView, TensorView, Activation)| {
            let [.., outputs, inputs] = *weight.shape() else { unreachable!("its dimensions were counted") };
            let [weight, bias] = [weight, bias].map(|view| numbers(view.dtype(), part(view, index, count)));
            Layer { inputs, outputs, weight, bias, activation: *activation }
        };
        let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
        ScaledNetwork { scaling, layers: layers.iter().map(layer).collect() }
    };
    Ok((0..count).map(network).collect())
}

/// Part `index` of `count` equal ones.
fn part<'a>(view: &'a TensorView, index: usize, count: usize) -> &'a [u8] {
    let length = view.data().len() / count;
    &view.data()[index * length..][..length]
}

/// Checks the version before the fields, so that a newer file is named as such and not by its first unknown field.
fn parse_header(text: &str) -> Result<(ModelHeader, Metadata), FormatError> {
    // not `from_str`: that is generic, and would be compiled once more, for speed
    let fields = text.parse::<Value>().and_then(Fields::of);
    let mut fields = fields.map_err(FormatError::Metadata)?;
    match fields.take::<u32>("format").map_err(FormatError::Metadata)? {
        FORMAT => {}
        found if found < FORMAT => return Err(FormatError::OldVersion { found }),
        found => return Err(FormatError::NewVersion { found }),
    }
    if !fields.contain("model") {
        return Err(FormatError::NoModel);
    }
    let model = fields.take("model").map_err(FormatError::Metadata)?;
    let metadata = Metadata::read(fields.rest()).map_err(FormatError::Metadata)?;
    Ok((model, metadata))
}

mod discrete;
mod fields;
mod motion;
mod state_space;
#[cfg(test)]
mod tests;
