//! Surrogates whose sources are compared.

use super::*;

/// The surrogate with an activation after the last layer of each network.
pub(super) fn bent(surrogate: &Surrogate, activation: Activation) -> Surrogate {
    let mut networks = networks(surrogate);
    networks.iter_mut().for_each(|network| network.layers.last_mut().unwrap().activation = activation);
    let graph = match surrogate.program().graph.steps.as_slice() {
        [Step::Interpolate { column, instants, .. }] => {
            Graph::of_instants(surrogate.program().graph.inputs, *column, instants.clone(), &networks)
        }
        _ => Graph::from(&networks[0]),
    };
    Surrogate::new(surrogate.metadata().clone(), graph).unwrap()
}

/// More outputs than a block of rows has.
pub(super) fn twenty_outputs() -> Surrogate {
    let surrogate = example::with_network(&[24], Activation::Tanh);
    let mut metadata = surrogate.metadata().clone();
    let mut network = surrogate.network().unwrap();
    let last = network.layers.last_mut().unwrap();
    let weights = |count: usize, from: &metafmu_runtime::Numbers| -> Vec<f64> {
        (0..count).map(|index| from.get(index % from.len()) * (0.3 + index as f64 / count as f64)).collect()
    };
    last.weight = weights(20 * 24, &last.weight).into();
    last.bias = weights(20, &last.bias).into();
    last.outputs = 20;
    network.scaling.output_mean = (0..20).map(|index| 0.1 * f64::from(index)).collect();
    network.scaling.output_scale = (1..=20).map(|index| 0.5 * f64::from(index)).collect();
    let output = |index| metafmu_runtime::Output { name: format!("y{index}"), ..metadata.outputs[0].clone() };
    metadata.outputs = (0..20).map(output).collect();
    Surrogate::new(metadata, Graph::from(&network)).unwrap()
}

/// A polynomial, a forest and kernels of the example's columns.
pub(super) fn regressions(example: &Surrogate) -> [Surrogate; 3] {
    let n = Encoder::of(example.inputs()).width();
    let mut scaling = example.network().unwrap().scaling;
    if n == 3 {
        // ranges become -1 to 1
        scaling.input_scale = vec![0.05, 2.5, 1.0];
    }
    // degrees 0 to 6 in each column
    let degrees = (0..8 * n).map(|index| (index * 5 % 8).saturating_sub(index % 3) as u8 % 7).collect();
    let coefficients: Vec<f64> = (0..16).map(|index| 0.3 * (0.7 * f64::from(index)).sin()).collect();
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let split = |column, number, below| Node { column, number, below };
    let nodes = vec![
        split(n as u32 - 1, 0.0, [1, 2]),
        leaf(0.25),
        split(0, -0.5, [3, 4]),
        leaf(-1.0),
        split(1, 0.25, [5, 6]),
        leaf(0.5),
        leaf(3.0),
    ];
    let trees = vec![Tree { root: 0, output: 0 }, Tree { root: 5, output: 1 }, Tree { root: 2, output: 1 }];
    let machine = |bias: f64, centres: usize| KernelMachine {
        lengths: (0..n).map(|column| 0.7 + 0.3 * column as f64).collect(),
        centres: (0..centres * n).map(|index| (1.3 * index as f64).sin()).collect(),
        weights: (0..centres).map(|index| (0.9 * index as f64).cos()).collect(),
        bias,
        deviation: None,
    };
    [
        Graph::of_polynomial(&scaling, Products { inputs: n, degrees }, &coefficients),
        Graph::of_forest(&scaling, Forest { nodes, trees }),
        Graph::of_kernels(&scaling, &[machine(0.1, 7), machine(-2.0, 0)]),
    ]
    .map(|graph| Surrogate::new(example.metadata().clone(), graph).unwrap())
}

/// Gaussian process of the example's columns with its predicted standard deviation. Its number of centers requires
/// several blocks of rows.
pub(super) fn process(example: &Surrogate) -> Surrogate {
    let (n, count) = (Encoder::of(example.inputs()).width(), 70);
    let whitening = (0..count).flat_map(|row| (0..=row).map(move |column| (row, column)));
    let machine = |scale: f64| KernelMachine {
        lengths: (0..n).map(|column| 0.7 + 0.3 * column as f64).collect(),
        centres: (0..count * n).map(|index| (1.3 * index as f64).sin()).collect(),
        weights: (0..count).map(|index| (0.9 * index as f64).cos()).collect(),
        bias: 0.2,
        deviation: Some(ProcessDeviation {
            whitening: whitening.clone().map(|(row, column)| 0.02 * (0.7 * (row + 3 * column) as f64).sin()).collect(),
            trend: (0..count).map(|index| 0.1 * (0.4 * index as f64).sin()).collect(),
            trend_origin: 0.3,
            noise: 1e-3,
            least: 1e-2,
            scale,
        }),
    };
    let mut metadata = example.metadata().clone();
    let stds = (0..).zip(&metadata.outputs).map(|(index, output)| {
        let name = metafmu_runtime::Output::std_name(&output.name);
        metafmu_runtime::Output { name, std_of: Some(index), ..output.clone() }
    });
    metadata.outputs = metadata.outputs.iter().cloned().chain(stds).collect();
    let scaling = example.network().unwrap().scaling;
    Surrogate::new(metadata, Graph::of_kernels(&scaling, &[machine(1.5), machine(0.5)])).unwrap()
}

/// A graph with steps of all kinds, and all elementwise functions.
pub(super) fn graph(example: &Surrogate) -> Surrogate {
    let n = Encoder::of(example.inputs()).width();
    let numbers =
        |count: usize, factor: f64| (0..count).map(|index| (factor * index as f64).sin()).collect::<Vec<f64>>();
    let mut steps = vec![Step::Affine { of: 0, weight: numbers(4 * n, 0.7).into(), bias: numbers(4, 1.1).into() }];
    // of positive numbers, as logarithms and powers are
    steps.push(Step::Elementwise { of: 1, function: Elementwise::Softplus, parameters: Vec::new() });
    let mut sum = 2;
    for function in Elementwise::all() {
        // of all alike, or of each its own
        let rows = if sum % 2 == 0 { 1 } else { 4 };
        let parameters = numbers(rows * function.parameters(), 0.9).iter().map(|number| 0.6 + 0.3 * number).collect();
        let has_pole = matches!(function, Elementwise::Logarithm | Elementwise::Reciprocal);
        let function_of = if function.parameters() > 0 || has_pole { 2 } else { 1 };
        steps.push(Step::Elementwise { of: function_of, function, parameters });
        steps.push(Step::Combine { of: [sum, steps.len()], operation: Operation::Add });
        sum = steps.len();
    }
    steps.push(Step::Normalize { of: sum, epsilon: 0.25 });
    let standard = steps.len();
    for operation in Operation::ALL {
        steps.push(Step::Combine { of: [steps.len(), 2], operation });
    }
    steps.push(Step::Softmax { of: steps.len() });
    steps.push(Step::Distances { of: standard, centres: numbers(12, 0.4), lengths: vec![1.0, 0.5, 2.0, 1.5] });
    let distances = steps.len() as u32;
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let nodes = vec![Node { column: 1, number: 0.1, below: [1, 2] }, leaf(0.25), leaf(-1.0), leaf(0.5)];
    let trees = vec![Tree { root: 0, output: 2 }, Tree { root: 3, output: 0 }];
    steps.push(Step::Forest { of: standard, forest: Forest { nodes, trees }.into(), outputs: 3 });
    let forest = steps.len() as u32;
    let degrees = (0..12).map(|index| index * 5 % 7).collect();
    steps.push(Step::Products { of: distances as usize - 1, products: Products { inputs: 4, degrees } });
    let products = steps.len() as u32;
    steps.push(Step::Columns { columns: vec![[products, 1], [distances, 0], [0, 0], [forest, 2]] });
    steps.push(Step::Select { of: [standard, steps.len(), 1] });
    let scales = || vec![0.5, 2.0, 1.0, 1.5];
    steps.push(Step::Standardize { of: steps.len(), mean: numbers(4, 0.8), scale: scales() });
    steps.push(Step::Rescale { of: steps.len(), mean: numbers(4, 0.2), scale: scales() });
    let function = Graph {
        inputs: 4,
        steps: vec![
            Step::Affine { of: 0, weight: numbers(16, 0.6).into(), bias: numbers(4, 0.5).into() },
            Step::Elementwise { of: 1, function: Elementwise::Activation(Activation::Tanh), parameters: Vec::new() },
        ],
    };
    steps.push(Step::Call { of: steps.len(), function });
    let factors = [Factor::Angle, Factor::Power { middle: 0.5, half: 2.0 }, Factor::Angle, Factor::Angle];
    let term = |exponents: [i16; 4]| Term { exponents: exponents.to_vec(), coefficients: numbers(4, 0.9) };
    let terms = [[2, 1, 0, 0], [0, 3, -1, 0], [1, 0, 0, -2], [0; 4]].map(term);
    let dictionary = Dictionary::new(&factors, 4, &terms).unwrap();
    steps.push(Step::Dictionary { of: steps.len(), dictionary });
    steps.push(Step::Affine { of: steps.len(), weight: numbers(8, 0.3).into(), bias: numbers(2, 0.5).into() });
    Surrogate::new(example.metadata().clone(), Graph { inputs: n, steps }).unwrap()
}

/// A polynomial of degree zero.
pub(super) fn constant() -> Surrogate {
    let example = example::surrogate();
    let scaling = &example.network().unwrap().scaling;
    let graph = Graph::of_polynomial(scaling, Products { inputs: 3, degrees: vec![0; 3] }, &[0.5, -0.25]);
    Surrogate::new(example.metadata().clone(), graph).unwrap()
}

pub(super) fn no_tree() -> Surrogate {
    let example = example::surrogate();
    let graph = Graph::of_forest(&example.network().unwrap().scaling, Forest::default());
    Surrogate::new(example.metadata().clone(), graph).unwrap()
}

/// The crane without its force, whose outputs are energies only.
pub(super) fn pushed_by_nothing() -> Surrogate {
    let crane = example::crane();
    let motion = crane.program().motion().unwrap();
    let function_set = motion.dynamics.function_set().dictionary();
    let factors: Vec<_> = function_set.factors().collect();
    let mut terms: Vec<_> = function_set.terms().collect();
    terms.iter_mut().for_each(|term| term.coefficients.truncate(Dynamics::functions(2, 0)));
    let function_set = Dictionary::new(&factors, Dynamics::functions(2, 0), &terms).unwrap();
    let motion = Motion {
        dynamics: Dynamics::new(2, 0, function_set).unwrap(),
        positions: Dictionary::new(&factors, 0, &[]).unwrap().into(),
        windings: Vec::new(),
        reactions: None,
        actuator_states: 0,
        outputs: vec![Shown::PotentialEnergy, Shown::KineticEnergy],
    };
    let mut metadata = crane.metadata().clone();
    metadata.inputs.pop();
    metadata.outputs.drain(..5);
    let integration = crane.program().integration().unwrap();
    Surrogate::new(metadata, Program::of_motion(motion, integration)).unwrap()
}

/// A wheel with angle and speed as states. A network computes from sine and cosine of the angle and from the other
/// columns; the outputs are the angle and a function.
pub(super) fn turning(activation: Activation) -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    metadata.states[0].range = None;
    metadata.outputs.push(metadata.outputs[0].clone());
    metadata.outputs[1].name = "torque".into();
    let plain = Factor::Power { middle: 0.5, half: 2.0 };
    let term = |exponents: [i16; 4], coefficients: [f64; 2]| Term {
        exponents: exponents.to_vec(),
        coefficients: coefficients.to_vec(),
    };
    // of mu, force, angle, speed
    let terms = [term([1, 0, -2, 0], [-1.0, 0.5]), term([0, 1, 0, 0], [1.0, 0.0]), term([0, 0, 1, 1], [0.25, -0.125])];
    let number = |index: usize| ((index as f64 * 0.618).fract() - 0.5) as f32;
    let layer = |inputs: usize, outputs: usize, activation| Layer {
        inputs,
        outputs,
        weight: (0..inputs * outputs).map(number).collect::<Vec<f32>>().into(),
        bias: (0..outputs).map(|index| number(7 + index)).collect::<Vec<f32>>().into(),
        activation,
    };
    let network = ScaledNetwork {
        scaling: Scaling {
            input_mean: vec![1.0, 0.0, 0.1, -0.1, 0.5],
            input_scale: vec![0.5, 1.0, 0.7, 0.7, 2.0],
            output_mean: vec![0.1, -0.2],
            output_scale: vec![0.25, 0.5],
        },
        layers: vec![layer(5, 9, activation), layer(9, 6, activation), layer(6, 2, Activation::Identity)],
    };
    let dictionary = Dictionary::new(&[plain, plain, Factor::Angle, plain], 2, &terms).unwrap();
    let results = [Given::State(0), Given::Function(1), Given::State(1), Given::Function(0)];
    of_rates(metadata, Graph::of_rates(&dictionary, Some(Graph::from(&network)), 2, &results))
}

pub(super) fn of_rates(metadata: Metadata, graph: Graph) -> Surrogate {
    let clock = Clock::Continuous(Integration::Fixed { step: 0.005 });
    Surrogate::new(metadata, Program { graph, clock }).unwrap()
}

/// A state that is its own derivative: no parameter, no input, no function.
pub(super) fn left_alone() -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    metadata.inputs = vec![metadata.inputs[1].clone()];
    metadata.states.truncate(1);
    let factors = [Factor::Power { middle: 0.0, half: 1.0 }];
    let dictionary = Dictionary::new(&factors, 1, &[]).unwrap();
    of_rates(metadata, Graph::of_rates(&dictionary, None, 1, &[Given::State(0), Given::State(0)]))
}

/// Functions of a force and, if there is one, a parameter, without any state.
pub(super) fn without_states(has_parameter: bool) -> Surrogate {
    let oscillator = example::oscillator(None);
    let mut metadata = oscillator.metadata().clone();
    let parameters = usize::from(has_parameter);
    metadata.inputs = [&metadata.inputs[..parameters], &metadata.inputs[3..]].concat();
    metadata.states.clear();
    metadata.outputs.push(metadata.outputs[0].clone());
    metadata.outputs[1].name = "square".into();
    let factors = vec![Factor::Power { middle: 0.5, half: 2.0 }; parameters + 1];
    let term = |order: i16, coefficients: [f64; 2]| Term {
        exponents: [vec![1; parameters], vec![order]].concat(),
        coefficients: coefficients.to_vec(),
    };
    let terms = [term(1, [0.5, 0.25]), term(2, [0.0, -1.5])];
    let dictionary = Dictionary::new(&factors, 2, &terms).unwrap();
    let graph = Graph::of_rates(&dictionary, None, 0, &[Given::Function(0), Given::Function(1)]);
    Surrogate::new(metadata, graph).unwrap()
}

/// Discrete-time surrogate with this history, these weights and these constants. `change` may remove its parameter.
pub(super) fn of_samples(
    history: [usize; 2],
    weights: &[f64],
    constants: &[f64],
    change: impl FnOnce(&mut Metadata),
) -> Surrogate {
    let recorded = example::recorded();
    let mut metadata = recorded.metadata().clone();
    change(&mut metadata);
    let sampling = Sampling { history, ..recorded.program().sampling().unwrap().clone() };
    let graph = Graph::of_samples(weights.len() / constants.len(), weights.to_vec(), constants.to_vec(), None);
    Surrogate::new(metadata, Program { graph, clock: Clock::Sampled(Box::new(sampling)) }).unwrap()
}

/// Model without feedback, parameters and network.
pub(super) fn window() -> Surrogate {
    of_samples([0, 4], &[0.4, 0.3, -0.2, 0.1], &[0.01], |metadata| drop(metadata.inputs.remove(0)))
}

/// Model of two inputs and two outputs, with one past sample of each.
pub(super) fn two_by_two() -> Surrogate {
    let weights = [0.9, 0.2, 0.1, -0.1, 0.02, -0.3, 0.8, 0.05, 0.2, -0.01];
    of_samples([1, 1], &weights, &[0.01, -0.02], |metadata| {
        let again = |input: &Input, name: &str| Input { name: name.into(), ..input.clone() };
        let [position, driven] = [1, 3].map(|index| metadata.inputs[index].clone());
        // of a single past sample the inputs before the start do not count
        metadata.inputs[2] = again(&position, "speed_start");
        metadata.inputs.push(again(&driven, "wind"));
        metadata.outputs.push(metadata.outputs[0].clone());
        metadata.outputs[1].name = "speed".into();
    })
}

/// Model without inputs and hidden states.
pub(super) fn alone() -> Surrogate {
    of_samples([2, 1], &[1.2, -0.5, 0.1], &[0.01], |metadata| metadata.inputs.truncate(2))
}

/// The one that diverges at its second sample.
pub(super) fn diverging() -> Surrogate {
    let recorded = example::recorded();
    let mut program = recorded.program().clone();
    let Step::Affine { weight, .. } = &mut program.graph.steps[0] else { panic!("it has a linear part") };
    let mut weights: Vec<f64> = weight.iter().collect();
    weights[0] = 1e200;
    *weight = weights.into();
    Surrogate::new(recorded.metadata().clone(), program).unwrap()
}
