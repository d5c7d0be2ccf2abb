//! A small surrogate with made-up weights, for documentation, tests and benches.

mod cranes;

pub use cranes::{
    crane, crane_with_efforts, crane_with_motor, crane_with_networks, crane_with_reactions, crane_with_splines,
    with_prescribed_trolley,
};
use metafmu_runtime::{
    Activation, Bounds, Clock, Cover, Encoder, Encoding, Graph, Input, Integration, Layer, Metadata, Output,
    OutputArray, Precision, Program, Provenance, Role, Sampling, ScaledNetwork, Scaling, State, Support, Surrogate,
    Tunability,
    dictionary::{Dictionary, Factor, Term},
    graph::{Elementwise, Given, Operation, Step},
};

/// Two parameters (`length` tunable, `speed` fixed), the time, two outputs, one hidden layer of 16.
pub fn surrogate() -> Surrogate {
    with_network(&[16], Activation::Tanh)
}

/// One whose training data are where both parameters of [`surrogate`] are in the lower half of their ranges, or both in the upper one.
pub fn with_cover(surrogate: &Surrogate) -> Surrogate {
    let cover = Cover { columns: vec![0, 1], radius: 0.25, centres: vec![0.25, 0.25, 0.75, 0.75] };
    let metadata = Metadata { cover: Some(cover), ..surrogate.metadata().clone() };
    Surrogate::new(metadata, surrogate.program().clone()).expect("its inputs are no constants")
}

/// [`surrogate`] with hidden layers of the given sizes.
///
/// # Panics
/// If a size is zero.
pub fn with_network(hidden: &[usize], activation: Activation) -> Surrogate {
    with_precision(hidden, activation, Precision::Double)
}

/// [`with_network`] in a given precision.
///
/// # Panics
/// If a size is zero.
pub fn with_precision(hidden: &[usize], activation: Activation, precision: Precision) -> Surrogate {
    let metadata = Metadata {
        name: "example".into(),
        description: "A network with made-up weights".into(),
        inputs: vec![
            variable("length", Role::Parameter(Tunability::Tunable), "m", [0.1, 0.2, 0.5 * (0.1 + 0.2)]),
            variable("speed", Role::Parameter(Tunability::Fixed), "rad/s", [0.0, 5.0, 2.5]),
            variable("time", Role::Time, "s", [0.0, 2.0, 0.0]),
        ],
        outputs: vec![shown("angle", "rad", 2.0), shown("velocity", "rad/s", 2.0)],
        states: Vec::new(),
        arrays: Vec::new(),
        bounds: None,
        solver_error: None,
        cover: None,
        precision,
        time_step: 0.01,
        stop_time: None,
        provenance: Provenance { tool: "example".into(), content_digest: "0".repeat(64), ..Provenance::default() },
    };
    let scaling = Scaling {
        input_mean: vec![0.15, 2.5, 1.0],
        input_scale: vec![0.03, 1.5, 0.6],
        output_mean: vec![0.1, -0.2],
        output_scale: vec![0.8, 6.0],
    };
    let layers = layers(&[&[3], hidden, &[2]].concat(), activation, &mut uniform_sequence());
    Surrogate::new(metadata, Graph::from(&ScaledNetwork { scaling, layers })).expect("the example is valid")
}

fn variable(name: &str, role: Role, unit: &str, [min, max, start]: [f64; 3]) -> Input {
    Input {
        name: name.into(),
        role,
        unit: unit.into(),
        description: format!("example input {name}"),
        min,
        max,
        start,
        encoding: Encoding::Plain,
    }
}

fn state(name: &str, unit: &str, rate_unit: &str, range: Option<[f64; 2]>) -> State {
    State {
        name: name.into(),
        unit: unit.into(),
        rate_unit: rate_unit.into(),
        description: format!("example state {name}"),
        range,
        nominal: 1.0,
    }
}

fn shown(name: &str, unit: &str, largest: f64) -> Output {
    let description = format!("example output {name}");
    Output { name: name.into(), unit: unit.into(), description, min: -largest, max: largest, std_of: None }
}

/// [`with_precision`] with a network for each of four time points, which are not evenly spaced.
///
/// # Panics
/// If a size is zero.
pub fn per_instant(hidden: &[usize], activation: Activation, precision: Precision) -> Surrogate {
    let metadata = with_precision(hidden, activation, precision).metadata().clone();
    let mut uniform = uniform_sequence();
    let instants = vec![0.0, 0.5, 0.75, 2.0];
    let networks = instants.iter().map(|&instant| ScaledNetwork {
        scaling: Scaling {
            input_mean: vec![0.15, 2.5],
            input_scale: vec![0.03, 1.5],
            output_mean: vec![0.1 + instant, -0.2],
            output_scale: vec![0.8, 6.0 - instant],
        },
        layers: layers(&[&[2], hidden, &[2]].concat(), activation, &mut uniform),
    });
    let networks: Vec<ScaledNetwork> = networks.collect();
    Surrogate::new(metadata, Graph::of_instants(3, 2, instants, &networks)).expect("the example is valid")
}

/// Layers of these sizes, inputs first; the last one is linear.
fn layers(sizes: &[usize], activation: Activation, uniform: &mut impl FnMut() -> f32) -> Vec<Layer> {
    let layers = sizes.windows(2).enumerate().map(|(index, pair)| {
        let (inputs, outputs) = (pair[0], pair[1]);
        let scale = 1.0 / (inputs as f32).sqrt();
        let weight: Vec<f32> = (0..inputs * outputs).map(|_| scale * uniform()).collect();
        let bias: Vec<f32> = (0..outputs).map(|_| scale * uniform()).collect();
        let activation = if index + 2 == sizes.len() { Activation::Identity } else { activation };
        Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
    });
    layers.collect()
}

/// A layer with numbers of a sequence.
fn layer(inputs: usize, outputs: usize, activation: Activation, uniform: &mut impl FnMut() -> f32) -> Layer {
    let weight: Vec<f32> = (0..inputs * outputs).map(|_| uniform()).collect();
    let bias: Vec<f32> = (0..outputs).map(|_| uniform()).collect();
    Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
}

/// [`surrogate`] with `speed` an input that another component drives.
pub fn with_input() -> Surrogate {
    let surrogate = surrogate();
    let mut metadata = surrogate.metadata().clone();
    metadata.inputs[1].role = Role::Input;
    Surrogate::new(metadata, surrogate.program().clone()).expect("the example is valid")
}

/// A surrogate of either structure with encoded inputs: `length` is one of 0.1, 0.14 and 0.2, and `speed` is periodic.
///
/// # Panics
/// If it is a regression.
pub fn encoded(surrogate: &Surrogate) -> Surrogate {
    let mut metadata = surrogate.metadata().clone();
    metadata.inputs[0].encoding = Encoding::Nominal(vec![0.14, 0.1, 0.2]);
    metadata.inputs[0].start = 0.14;
    metadata.inputs[1].encoding = Encoding::Periodic;
    let mut uniform = uniform_sequence();
    let graph = match (surrogate.network(), surrogate.program().graph.instants()) {
        (Some(network), _) => Graph::from(&encoded_network(network, &mut uniform)),
        (None, Some((instants, functions))) => {
            let networks = functions.iter().filter_map(Graph::network);
            let networks: Vec<_> = networks.map(|network| encoded_network(network, &mut uniform)).collect();
            Graph::of_instants(6, 5, instants.to_vec(), &networks)
        }
        (None, None) => panic!("the examples are networks"),
    };
    debug_assert_eq!(Encoder::of(&metadata.inputs).width(), 6);
    Surrogate::new(metadata, graph).expect("the example is valid")
}

/// A network like this one, of five columns in place of the first two.
fn encoded_network(mut network: ScaledNetwork, uniform: &mut impl FnMut() -> f32) -> ScaledNetwork {
    let Scaling { input_mean, input_scale, .. } = &mut network.scaling;
    input_mean.splice(..2, [0.3, 0.35, 0.3, 0.1, -0.05]);
    input_scale.splice(..2, [0.45, 0.5, 0.45, 0.7, 0.75]);
    let mut sizes: Vec<usize> = network.layers.iter().map(|layer| layer.outputs).collect();
    sizes.insert(0, input_mean.len());
    network.layers = layers(&sizes, network.layers[0].activation, uniform);
    network
}

/// [`surrogate`] with outputs `x` and `y` in metres, and arrays of them: `position` is `[x, y]` and `swapped` `[y, x]`.
pub fn with_arrays() -> Surrogate {
    let surrogate = surrogate();
    let mut metadata = surrogate.metadata().clone();
    for (output, name) in metadata.outputs.iter_mut().zip(["x", "y"]) {
        (output.name, output.unit) = (name.into(), "m".into());
    }
    let arrays = [("position", ["x", "y"]), ("swapped", ["y", "x"])].map(|(name, outputs)| OutputArray {
        name: name.into(),
        description: format!("example array {name}"),
        outputs: outputs.map(String::from).into(),
    });
    metadata.arrays = arrays.into();
    Surrogate::new(metadata, surrogate.program().clone()).expect("the example is valid")
}

/// [`with_arrays`] with the error bounds 0.125 and 0.25.
pub fn with_bounds() -> Surrogate {
    let bounds = Bounds { coverage: 0.95, runs: 100, times: Vec::new(), half_widths: vec![0.125, 0.25] };
    with_arrays().with_bounds(bounds).expect("the example is valid")
}

/// [`crane`] with error bounds of 0.125, 0.25, 0.375, ... that grow to three times as much from 1 s to 2 s after the start.
pub fn with_growing_bounds() -> Surrogate {
    let outputs = crane().outputs().len();
    let half_widths =
        [1.0, 1.0, 3.0].iter().flat_map(|times| (1..=outputs).map(move |output| times * 0.125 * output as f64));
    let half_widths = half_widths.collect();
    let bounds = Bounds { coverage: 0.95, runs: 100, times: vec![0.0, 1.0, 2.0], half_widths };
    crane().with_bounds(bounds).expect("the example is valid")
}

/// Numbers spread over (-1, 1): the fractional parts of multiples of the golden ratio.
fn uniform_sequence() -> impl FnMut() -> f32 {
    let mut state = 0.5f64;
    move || {
        state = (state + 0.618_033_988_749_894_9).fract();
        (2.0 * state - 1.0) as f32
    }
}

/// A surrogate with a different integration of its states.
pub fn integrated(surrogate: &Surrogate, integration: Integration) -> Surrogate {
    let program = surrogate.program().clone().with_integration(integration);
    Surrogate::new(surrogate.metadata().clone(), program).expect("the integration is valid")
}

/// Van der Pol's oscillator with a force, `xdd = mu (1 - x^2) xd - x + force`, exact unless a network from `(mu, force, x, v)`
/// is added to the acceleration. `mu` is a parameter; the output is `x`.
pub fn oscillator(network: Option<ScaledNetwork>) -> Surrogate {
    let states = [("x", "m", "m/s"), ("v", "m/s", "m/s2")]
        .map(|(name, unit, rate_unit)| State { nominal: 2.0, ..state(name, unit, rate_unit, Some([-4.0, 4.0])) });
    let metadata = Metadata {
        name: "oscillator".into(),
        description: "Van der Pol's oscillator with a force".into(),
        inputs: vec![
            variable("mu", Role::Parameter(Tunability::Fixed), "1", [0.5, 2.0, 1.0]),
            variable("x_start", Role::Start, "m", [-4.0, 4.0, 1.0]),
            variable("v_start", Role::Start, "m/s", [-4.0, 4.0, 0.0]),
            variable("force", Role::Input, "N", [-1.0, 1.0, 0.0]),
        ],
        outputs: vec![shown("position", "m", 4.0)],
        states: states.into(),
        ..surrogate().metadata().clone()
    };
    let plain = Factor::Power { middle: 0.0, half: 1.0 };
    // of mu, force, x, v
    let terms = [
        term(&[1, 0, 0, 1], 1, &[(0, 1.0)]),
        term(&[1, 0, 2, 1], 1, &[(0, -1.0)]),
        term(&[0, 0, 1, 0], 1, &[(0, -1.0)]),
        term(&[0, 1, 0, 0], 1, &[(0, 1.0)]),
    ];
    let dictionary = Dictionary::new(&[plain; 4], 1, &terms).expect("the example is valid");
    let results = [Given::State(0), Given::State(1), Given::Function(0)];
    let graph = Graph::of_rates(&dictionary, network.as_ref().map(Graph::from), 2, &results);
    let clock = Clock::Continuous(Integration::Fixed { step: 0.005 });
    Surrogate::new(metadata, Program { graph, clock }).expect("the example is valid")
}

/// A term with these coefficients by function, of `functions` in number; the others are zero.
fn term(exponents: &[i16], functions: usize, values: &[(usize, f64)]) -> Term {
    let mut coefficients = vec![0.0; functions];
    values.iter().for_each(|(function, value)| coefficients[*function] = *value);
    Term { exponents: exponents.to_vec(), coefficients }
}

/// A network for [`oscillator`] with made-up numbers.
pub fn residual_network() -> ScaledNetwork {
    let mut uniform = uniform_sequence();
    let layers = vec![layer(4, 6, Activation::Tanh, &mut uniform), layer(6, 1, Activation::Identity, &mut uniform)];
    let scaling = Scaling {
        input_mean: vec![1.0, 0.0, 0.0, 0.0],
        input_scale: vec![0.5, 1.0, 2.0, 2.0],
        output_mean: vec![0.0],
        output_scale: vec![0.25],
    };
    ScaledNetwork { scaling, layers }
}

/// A mass that is pushed, known by samples of its position and of the force 0.1 s apart, with made-up numbers: two past positions and
/// three past forces count, and a network adds a little.
pub fn recorded() -> Surrogate {
    let metadata = Metadata {
        name: "recorded".into(),
        description: "a mass that is pushed, by samples".into(),
        inputs: vec![
            variable("mass", Role::Parameter(Tunability::Fixed), "kg", [1.0, 2.0, 1.25]),
            variable("position_start", Role::Start, "m", [-2.0, 2.0, 0.5]),
            variable("force_start", Role::Start, "N", [-3.0, 3.0, 0.0]),
            variable("force", Role::Input, "N", [-3.0, 3.0, 0.0]),
        ],
        outputs: vec![shown("position", "m", 2.0)],
        time_step: 0.1,
        stop_time: Some(2.0),
        ..surrogate().metadata().clone()
    };
    let layers = layers(&[6, 5, 1], Activation::Tanh, &mut uniform_sequence());
    let scaling = Scaling {
        input_mean: vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.5],
        input_scale: vec![1.0, 1.0, 2.0, 2.0, 2.0, 0.5],
        output_mean: vec![0.0],
        output_scale: vec![0.05],
    };
    let weights = vec![1.2, -0.5, 0.1, 0.05, -0.02, 0.03];
    let graph = Graph::of_samples(6, weights, vec![0.01], Some(Graph::from(&ScaledNetwork { scaling, layers })));
    let sampling = Sampling { hidden: Vec::new(), direct: Vec::new(), history: [2, 3], step: 0.1, support: None };
    let program = Program { graph, clock: Clock::Sampled(Box::new(sampling)) };
    Surrogate::new(metadata, program).expect("the example is valid")
}

/// [`recorded`] with the support of a training: positions that stay below 0.5 m.
pub fn supported() -> Surrogate {
    let recorded = recorded();
    let Program { graph, clock } = recorded.program().clone();
    let Clock::Sampled(sampling) = clock else { unreachable!("it has samples") };
    // force, its change, average change and average; position and its change
    let of_features = [[-1.0, 1.0], [-0.5, 0.5], [0.0, 0.1], [-1.0, 1.0], [-0.5, 0.5], [-0.05, 0.05]];
    // two components, their sum and their difference
    let of_shape = [[-0.6, 0.6], [-0.6, 0.6], [-1.1, 1.1], [-0.2, 0.2]];
    let support = Some(Support {
        inputs: 1,
        ranges: [&of_features[..], &of_shape].concat(),
        components: vec![-0.1, 1.0, 0.0, 0.0, 1.0, 2.0],
        samples: 10.0,
        lasting: 10.0,
    });
    let clock = Clock::Sampled(Box::new(Sampling { support, ..*sampling }));
    Surrogate::new(recorded.metadata().clone(), Program { graph, clock }).expect("the example is valid")
}

/// [`supported`] with a direct effect of the force on the position.
pub fn direct() -> Surrogate {
    let supported = supported();
    let Program { graph, clock } = supported.program().clone();
    let Clock::Sampled(sampling) = clock else { unreachable!("it has samples") };
    let clock = Clock::Sampled(Box::new(Sampling { direct: vec![0.2], ..*sampling }));
    Surrogate::new(supported.metadata().clone(), Program { graph, clock }).expect("the example is valid")
}

/// A recurrent cell with made-up numbers, 0.1 s from sample to sample: a mass is a parameter, a force the input, a position the output, and two
/// states are hidden. All of it is a graph.
pub fn cell() -> Surrogate {
    let recorded = recorded();
    let mut metadata = recorded.metadata().clone();
    metadata.name = "cell".into();
    // of a single past sample the force before the start does not count
    metadata.inputs.remove(2);
    let mut uniform = uniform_sequence();
    let [gates, candidates] = [affine(0, 5, 3, &mut uniform), affine(0, 5, 3, &mut uniform)];
    let [sigmoid, tanh] = [(1, Activation::Sigmoid), (3, Activation::Tanh)].map(|(of, activation)| Step::Elementwise {
        of,
        function: Elementwise::Activation(activation),
        parameters: Vec::new(),
    });
    // of position, hidden, force, mass: gates, candidates, what was there before, and what becomes of them
    let steps = vec![
        gates,
        sigmoid,
        candidates,
        tanh,
        Step::Columns { columns: vec![[0, 0], [0, 1], [0, 2]] },
        Step::Combine { of: [5, 4], operation: Operation::Subtract },
        Step::Combine { of: [2, 6], operation: Operation::Multiply },
        Step::Combine { of: [4, 7], operation: Operation::Add },
    ];
    let graph = Graph::of_samples(5, Vec::new(), vec![0.0; 3], Some(Graph { inputs: 5, steps }));
    let sampling = Sampling { hidden: vec![0.1, -0.2], direct: Vec::new(), history: [1, 1], step: 0.1, support: None };
    let program = Program { graph, clock: Clock::Sampled(Box::new(sampling)) };
    Surrogate::new(metadata, program).expect("the example is valid")
}

/// An affine step with numbers of a sequence.
fn affine(of: usize, inputs: usize, outputs: usize, uniform: &mut impl FnMut() -> f32) -> Step {
    let weight: Vec<f64> = (0..inputs * outputs).map(|_| uniform().into()).collect();
    let bias: Vec<f64> = (0..outputs).map(|_| uniform().into()).collect();
    Step::Affine { of, weight: weight.into(), bias: bias.into() }
}

/// [`oscillator`] by a graph.
pub fn oscillator_by_graph() -> Surrogate {
    let oscillator = oscillator(None);
    let [mu, x, v] = [0, 2, 3].map(|column| Step::Columns { columns: vec![[0, column]] });
    let steps = vec![
        x,
        Step::Combine { of: [1, 1], operation: Operation::Multiply },
        Step::Elementwise { of: 2, function: Elementwise::Linear, parameters: vec![-1.0, 1.0] },
        mu,
        v,
        Step::Combine { of: [4, 5], operation: Operation::Multiply },
        Step::Combine { of: [3, 6], operation: Operation::Multiply },
        Step::Affine { of: 0, weight: vec![0.0, 1.0, -1.0, 0.0].into(), bias: vec![0.0].into() },
        Step::Combine { of: [7, 8], operation: Operation::Add },
    ];
    let plain = Factor::Power { middle: 0.0, half: 1.0 };
    let nothing = Dictionary::new(&[plain; 4], 1, &[]).expect("the example is valid");
    let results = [Given::State(0), Given::State(1), Given::Function(0)];
    let graph = Graph::of_rates(&nothing, Some(Graph { inputs: 4, steps }), 2, &results);
    let program = Program { graph, ..oscillator.program().clone() };
    Surrogate::new(oscillator.metadata().clone(), program).expect("the example is valid")
}
