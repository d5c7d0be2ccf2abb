//! A small surrogate with made-up weights, for documentation, tests and benches.

use metafmu_runtime::{
    Activation, Bounds, Clock, Cover, Dynamics, Efforts, Encoder, Encoding, Graph, Input, Integration, Layer, Metadata,
    Motion, Output, OutputArray, Precision, Program, Provenance, Reactions, Role, Sampling, ScaledNetwork, Scaling,
    Shown, State, Support, Surrogate, Tunability,
    dictionary::{Dictionary, Factor, Term},
    formula::{Combination, ElementaryFunction, Extrapolation, Formula, FormulaStep, Interpolation, LookupTable},
    graph::{Elementwise, Given, Operation, Step},
    law::{ColumnKind, Law, NetworkColumn, NetworkTerm},
};
use std::sync::Arc;

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

/// The same variables with hidden layers of the given sizes.
///
/// # Panics
/// If a size is zero.
pub fn with_network(hidden: &[usize], activation: Activation) -> Surrogate {
    with_precision(hidden, activation, Precision::Double)
}

/// The same in a precision of choice.
///
/// # Panics
/// If a size is zero.
pub fn with_precision(hidden: &[usize], activation: Activation, precision: Precision) -> Surrogate {
    let input = |name: &str, role, unit: &str, min, max| {
        let start = if role == Role::Time { min } else { 0.5 * (min + max) };
        variable(name, role, unit, [min, max, start])
    };
    let output = |name: &str, unit: &str| shown(name, unit, 2.0);
    let metadata = Metadata {
        name: "example".into(),
        description: "A network with made-up weights".into(),
        inputs: vec![
            input("length", Role::Parameter(Tunability::Tunable), "m", 0.1, 0.2),
            input("speed", Role::Parameter(Tunability::Fixed), "rad/s", 0.0, 5.0),
            input("time", Role::Time, "s", 0.0, 2.0),
        ],
        outputs: vec![output("angle", "rad"), output("velocity", "rad/s")],
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

fn shown(name: &str, unit: &str, largest: f64) -> Output {
    let description = format!("example output {name}");
    Output { name: name.into(), unit: unit.into(), description, min: -largest, max: largest, std_of: None }
}

/// The same with a network for each of four instants, which are not evenly spaced.
///
/// # Panics
/// If a size is zero.
pub fn per_instant(hidden: &[usize], activation: Activation, precision: Precision) -> Surrogate {
    let metadata = with_precision(hidden, activation, precision).metadata().clone();
    let mut uniform = uniform_sequence();
    let instants = vec![0.0, 0.5, 0.75, 2.0];
    let network = |&instant: &f64| ScaledNetwork {
        scaling: Scaling {
            input_mean: vec![0.15, 2.5],
            input_scale: vec![0.03, 1.5],
            output_mean: vec![0.1 + instant, -0.2],
            output_scale: vec![0.8, 6.0 - instant],
        },
        layers: layers(&[&[2], hidden, &[2]].concat(), activation, &mut uniform),
    };
    let networks: Vec<ScaledNetwork> = instants.iter().map(network).collect();
    Surrogate::new(metadata, Graph::of_instants(3, 2, instants, &networks)).expect("the example is valid")
}

/// Layers of these sizes, inputs first; the last one is linear.
fn layers(sizes: &[usize], activation: Activation, uniform: &mut impl FnMut() -> f32) -> Vec<Layer> {
    let layer = |(index, pair): (usize, &[usize])| {
        let (inputs, outputs) = (pair[0], pair[1]);
        let scale = 1.0 / (inputs as f32).sqrt();
        let weight: Vec<f32> = (0..inputs * outputs).map(|_| scale * uniform()).collect();
        let bias: Vec<f32> = (0..outputs).map(|_| scale * uniform()).collect();
        let activation = if index + 2 == sizes.len() { Activation::Identity } else { activation };
        Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
    };
    sizes.windows(2).enumerate().map(layer).collect()
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
    let mut encode = |network: &ScaledNetwork| {
        let mut network = network.clone();
        let Scaling { input_mean, input_scale, .. } = &mut network.scaling;
        input_mean.splice(..2, [0.3, 0.35, 0.3, 0.1, -0.05]);
        input_scale.splice(..2, [0.45, 0.5, 0.45, 0.7, 0.75]);
        let mut sizes: Vec<usize> = network.layers.iter().map(|layer| layer.outputs).collect();
        sizes.insert(0, input_mean.len());
        network.layers = layers(&sizes, network.layers[0].activation, &mut uniform);
        network
    };
    let graph = match (surrogate.network(), surrogate.program().graph.instants()) {
        (Some(network), _) => Graph::from(&encode(&network)),
        (None, Some((instants, functions))) => {
            let networks: Vec<_> =
                functions.iter().filter_map(Graph::network).map(|network| encode(&network)).collect();
            Graph::of_instants(6, 5, instants.to_vec(), &networks)
        }
        (None, None) => panic!("the examples are networks"),
    };
    debug_assert_eq!(Encoder::of(&metadata.inputs).width(), 6);
    Surrogate::new(metadata, graph).expect("the example is valid")
}

/// [`surrogate`] with outputs `x` and `y` in metres, and arrays of them: `position` is `[x, y]` and `swapped` `[y, x]`.
pub fn with_arrays() -> Surrogate {
    let surrogate = surrogate();
    let mut metadata = surrogate.metadata().clone();
    for (output, name) in metadata.outputs.iter_mut().zip(["x", "y"]) {
        (output.name, output.unit) = (name.into(), "m".into());
    }
    let array = |name: &str, outputs: [&str; 2]| OutputArray {
        name: name.into(),
        description: format!("example array {name}"),
        outputs: outputs.map(String::from).into(),
    };
    metadata.arrays = vec![array("position", ["x", "y"]), array("swapped", ["y", "x"])];
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

/// A crane, exact: a trolley of 2 kg with damping 0.3 N.s/m that a force pushes, and a load of 1 kg on a rope whose length is a
/// parameter. The states are the trolley's position, the rope's angle and their velocities; the outputs are both positions, the load's
/// horizontal position, velocity and acceleration, and the energies.
pub fn crane() -> Surrogate {
    let output = |name: &str, unit: &str| shown(name, unit, 20.0);
    let state = |name: &str, unit: &str, rate_unit: &str, range| State {
        name: name.into(),
        unit: unit.into(),
        rate_unit: rate_unit.into(),
        description: format!("example state {name}"),
        range,
        nominal: 1.0,
    };
    let start = |name: &str, unit, value| variable(&State::start_name(name), Role::Start, unit, [-5.0, 5.0, value]);
    let metadata = Metadata {
        name: "crane".into(),
        description: "A crane with made-up numbers".into(),
        inputs: vec![
            variable("rope", Role::Parameter(Tunability::Fixed), "m", [1.0, 2.0, 1.5]),
            start("trolley.position", "m", 0.0),
            start("rope.angle", "rad", 0.3),
            start("trolley.velocity", "m/s", 0.0),
            start("rope.angular_velocity", "rad/s", 0.0),
            variable("force", Role::Input, "N", [-10.0, 10.0, 0.0]),
        ],
        outputs: vec![
            output("x", "m"),
            output("theta", "rad"),
            output("load.x", "m"),
            output("load.vx", "m/s"),
            output("load.ax", "m/s2"),
            output("kinetic", "J"),
            output("potential", "J"),
        ],
        states: vec![
            state("trolley.position", "m", "m/s", Some([-5.0, 5.0])),
            state("rope.angle", "rad", "rad/s", None),
            state("trolley.velocity", "m/s", "m/s2", None),
            state("rope.angular_velocity", "rad/s", "rad/s2", None),
        ],
        ..surrogate().metadata().clone()
    };
    let factors = [Factor::Power { middle: 0.0, half: 1.0 }, Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    // exponents, and coefficients by function
    type Product<'a> = ([i16; 3], &'a [(usize, f64)]);
    let dictionary = |functions: usize, terms: &[Product]| {
        let term = |&(exponents, values): &Product| {
            let mut coefficients = vec![0.0; functions];
            values.iter().for_each(|(index, value)| coefficients[*index] = *value);
            Term { exponents: exponents.to_vec(), coefficients }
        };
        Dictionary::new(&factors, functions, &terms.iter().map(term).collect::<Vec<_>>()).expect("the example is valid")
    };
    // M = [3; l cos, l²], V = -g l cos, D_xx = 0.3, B_x = 1
    let law = dictionary(
        Dynamics::functions(2, 1),
        &[
            ([0, 0, 0], &[(0, 3.0), (6, 0.3), (10, 1.0)]),
            ([0, 1, 1], &[(1, 1.0), (3, -9.81)]),
            ([0, 0, 2], &[(2, 1.0)]),
        ],
    );
    let motion = Motion {
        dynamics: Dynamics::new(2, 1, law).expect("the example is valid"),
        // x, theta and the load's x: what is not a winding is l sin theta
        positions: dictionary(3, &[([0, -1, 1], &[(2, 1.0)])]).into(),
        windings: vec![1.0, 0.0, 0.0, 1.0, 1.0, 0.0],
        reactions: None,
        actuator_states: 0,
        outputs: vec![
            Shown::Position(0),
            Shown::Position(1),
            Shown::Position(2),
            Shown::Velocity(2),
            Shown::Acceleration(2),
            Shown::KineticEnergy,
            Shown::PotentialEnergy,
        ],
    };
    let program = Program::of_motion(motion, Integration::Fixed { step: 0.005 });
    Surrogate::new(metadata, program).expect("the example is valid")
}

/// The example with different equations.
fn with_motion(like: &Surrogate, metadata: Metadata, motion: Motion) -> Surrogate {
    let integration = like.program().integration().expect("it has states");
    Surrogate::new(metadata, Program::of_motion(motion, integration)).expect("the example is valid")
}

/// The same with another integration of its states.
pub fn integrated(surrogate: &Surrogate, integration: Integration) -> Surrogate {
    let program = surrogate.program().clone().with_integration(integration);
    Surrogate::new(surrogate.metadata().clone(), program).expect("the integration is valid")
}

/// [`crane`] with efforts: friction of the trolley, `force - 0.3 tanh(20 v)`, wind against the load's horizontal motion as a torque on the
/// rope, and a force with made-up numbers that has every function and operation.
pub fn crane_with_efforts() -> Surrogate {
    use Combination::{Add, Angle, Divide, Maximum, Minimum, Multiply, Power, Subtract};
    use ElementaryFunction::{Abs, Acos, Asin, Atan, Cos, Exp, Floor, Ln, Sign, Sin, Smooth, Sqrt, Tan, Tanh};
    use FormulaStep::{Call, Column, Combine, Constant, Lookup, Negate};
    let [held, smooth, periodic] = lookup_tables().map(Lookup);
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
    let formula = |steps: &[FormulaStep]| Formula::new(steps.to_vec()).expect("the example is valid");
    // columns: l, force; theta, the load's x, x; their rates
    let friction = [
        Column(1),
        Constant(0.3),
        Column(7),
        Constant(20.0),
        Combine(Multiply),
        Call(Tanh),
        Combine(Multiply),
        Combine(Subtract),
    ];
    let wind_speed = [Column(6), Negate];
    let wind = [
        &[Constant(0.2)][..],
        &wind_speed,
        &[Combine(Multiply)],
        &wind_speed,
        &[Call(Abs), Combine(Multiply), Column(0), Combine(Multiply), Column(2), Call(Cos), Combine(Multiply)],
    ];
    let bounded = [Column(4), Constant(10.0), Combine(Divide), Call(Sin)];
    let motor = [
        &bounded[..],
        &[Call(Asin)],
        &bounded,
        &[Call(Acos), Combine(Add)],
        &bounded,
        &[Call(Tan), Combine(Subtract)],
        &bounded,
        &[
            Call(Atan),
            Call(Exp),
            Combine(Add),
            Column(0),
            Call(Ln),
            Column(0),
            Call(Sqrt),
            Combine(Multiply),
            Combine(Add),
            Column(1),
            Column(1),
        ],
        &[Constant(2.0), Combine(Power), Constant(1.0), Combine(Add), Combine(Divide), Combine(Add), Column(0)],
        &bounded,
        &[
            Combine(Power),
            Combine(Add),
            Column(1),
            Constant(2.0),
            Combine(Minimum),
            Column(1),
            Constant(-2.5),
            Combine(Maximum),
            Combine(Add),
            Combine(Add),
        ],
        &bounded,
        &[Call(Sign), Combine(Add)],
        &bounded,
        &[Constant(0.6), Combine(Multiply), Constant(0.3), Combine(Add), Call(Smooth), Combine(Add)],
        &bounded,
        &[Constant(5.0), Combine(Multiply), Call(Floor), Combine(Add)],
        &bounded,
        &[Constant(1.5), Combine(Add), Column(0), Negate, Combine(Angle), Combine(Add)],
        &[Column(7), held, Combine(Add)],
        &[Column(0), Column(5), smooth, Combine(Add)],
        &[Column(2), periodic, Combine(Add)],
    ];
    let formulas = vec![formula(&friction), formula(&wind.concat()), formula(&motor.concat())];
    let windings = vec![0.0, 1.0, 1.0, 0.0, 1.0, 0.0];
    let efforts = Efforts::new([1, 1, 2], windings, formulas).expect("the example is valid");
    // three positions after V, and a column of B for each effort
    let functions = Dynamics::functions(2, 3) + 3;
    let widened = |term: Term| {
        let mut coefficients = vec![0.0; functions];
        coefficients[..4].copy_from_slice(&term.coefficients[..4]);
        coefficients[7..13].copy_from_slice(&term.coefficients[4..10]);
        Term { coefficients, ..term }
    };
    let mut terms: Vec<Term> = motion.dynamics.law().dictionary().terms().map(widened).collect();
    let mut more = |exponents: [i16; 3], values: &[(usize, f64)]| {
        let mut coefficients = vec![0.0; functions];
        values.iter().for_each(|(index, value)| coefficients[*index] = *value);
        terms.push(Term { exponents: exponents.to_vec(), coefficients });
    };
    // l sin theta of the load; B = [1 0 0.5; 0 1 0]
    more([0, -1, 1], &[(5, 1.0)]);
    more([0, 0, 0], &[(13, 1.0), (15, 0.5), (17, 1.0)]);
    let factors: Vec<Factor> = motion.dynamics.law().dictionary().factors().collect();
    let law = Dictionary::new(&factors, functions, &terms).expect("the example is valid");
    let dynamics = Dynamics::with_efforts(efforts, law).expect("the example is valid");
    let motion = Motion { dynamics, ..motion.clone() };
    with_motion(&crane, crane.metadata().clone(), motion)
}

/// [`crane`] with a motor: the input is its voltage, its current is a state, the force is 4 times the current, and the electrical power is a
/// further output.
pub fn crane_with_motor() -> Surrogate {
    use Combination::{Add, Multiply, Subtract};
    use FormulaStep::{Column, Combine, Constant};
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
    let formula = |steps: &[FormulaStep]| Formula::new(steps.to_vec()).expect("the example is valid");
    // columns: l; voltage, current; x; its rate
    let force = [Constant(4.0), Column(2), Combine(Multiply)];
    let power = [Column(1), Column(2), Combine(Multiply)];
    // 5 (voltage - 2 current - v / 2 - sin(theta) / 10)
    let resistance = [Column(1), Constant(2.0), Column(2), Combine(Multiply), Combine(Subtract)];
    let speed = [Column(5), Constant(0.5), Combine(Multiply), Combine(Subtract)];
    let angle =
        [Column(4), FormulaStep::Call(ElementaryFunction::Sin), Constant(-0.1), Combine(Multiply), Combine(Add)];
    let rate = [&resistance[..], &speed, &angle, &[Constant(5.0), Combine(Multiply)]].concat();
    let formulas = vec![formula(&force), formula(&power), formula(&rate)];
    let efforts = Efforts::new([1, 2, 2], vec![1.0, 0.0, 0.0, 1.0], formulas).expect("the example is valid");
    // two positions after V, and a column of B for each effort
    let functions = Dynamics::functions(2, 3) + 2;
    let widened = |term: Term| {
        let mut coefficients = vec![0.0; functions];
        coefficients[..4].copy_from_slice(&term.coefficients[..4]);
        coefficients[6..12].copy_from_slice(&term.coefficients[4..10]);
        coefficients[12] = term.coefficients[10];
        Term { coefficients, ..term }
    };
    let terms: Vec<Term> = motion.dynamics.law().dictionary().terms().map(widened).collect();
    let factors: Vec<Factor> = motion.dynamics.law().dictionary().factors().collect();
    let law = Dictionary::new(&factors, functions, &terms).expect("the example is valid");
    let dynamics = Dynamics::with_efforts(efforts, law).expect("the example is valid");
    let outputs = motion.outputs.iter().copied().chain([Shown::Effort(1)]).collect();
    let motion = Motion { dynamics, outputs, actuator_states: 1, ..motion.clone() };
    let mut metadata = crane.metadata().clone();
    metadata.outputs.push(shown("power", "W", 20.0));
    let current = State {
        name: "current".into(),
        unit: "A".into(),
        rate_unit: "A/s".into(),
        description: "example state current".into(),
        range: Some([-20.0, 20.0]),
        nominal: 1.0,
    };
    let voltage = metadata.inputs.len() - 1;
    metadata.inputs.insert(voltage, variable(&State::start_name("current"), Role::Start, "A", [-5.0, 5.0, 0.5]));
    metadata.states.push(current);
    with_motion(&crane, metadata, motion)
}

/// Tables of one argument with straight lines, of two arguments with a spline, and a spline that repeats itself.
fn lookup_tables() -> [Arc<LookupTable>; 3] {
    let table = |axes: &[&[f64]], values: &[f64], interpolation, extrapolation| {
        let axes = axes.iter().map(|axis| axis.to_vec()).collect();
        Arc::new(LookupTable::new(axes, values.to_vec(), interpolation, extrapolation).expect("the example is valid"))
    };
    let surface: Vec<f64> = (0..20).map(|k| f64::from(k * k % 7) / 4.0 - 0.5).collect();
    [
        table(&[&[-0.5, 0.0, 0.75]], &[0.25, 0.0, -0.5], Interpolation::Linear, Extrapolation::Hold),
        table(
            &[&[0.5, 0.75, 1.0, 2.0], &[-1.0, -0.25, 0.0, 0.5, 1.0]],
            &surface,
            Interpolation::Cubic,
            Extrapolation::Linear,
        ),
        table(&[&[-0.2, 0.1, 0.25, 0.8]], &[0.1, 0.3, -0.2, 0.1], Interpolation::Cubic, Extrapolation::Periodic),
    ]
}

/// A crane whose trolley has a prescribed acceleration, its input less 0.3 of its velocity.
pub fn with_prescribed_trolley(crane: &Surrogate) -> Surrogate {
    let motion = crane.program().motion().expect("the crane moves");
    let dynamics = motion.dynamics.clone().with_prescribed(&[0]).expect("the example is valid");
    let motion = Motion { dynamics, ..motion.clone() };
    with_motion(crane, crane.metadata().clone(), motion)
}

/// [`crane`] with two more outputs: the vertical force of the rope on the load, and a force with made-up numbers that has all parts.
pub fn crane_with_reactions() -> Surrogate {
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
    // A; C_00, C_10, C_11; D; F; B
    let each = Reactions::functions_of_each(2, 1);
    let term = |exponents: [i16; 3], values: &[(usize, f64)]| {
        let mut coefficients = vec![0.0; 2 * each];
        values.iter().for_each(|(index, value)| coefficients[*index] = *value);
        Term { exponents: exponents.to_vec(), coefficients }
    };
    let terms = [
        term([0, 0, 0], &[(7, 9.81), (each, 2.0), (each + 5, -0.3)]),
        term([0, -1, 1], &[(1, 1.0), (each + 1, 0.25), (each + 2, -0.5)]),
        term([0, 1, 1], &[(4, 1.0), (each + 3, 1.5), (each + 4, 0.75)]),
        term([1, -2, 0], &[(each + 6, 0.125), (each + 7, 0.5)]),
        term([0, 0, 2], &[(each + 8, 0.25)]),
    ];
    let factors: Vec<Factor> = motion.dynamics.law().dictionary().factors().collect();
    let functions = Dictionary::new(&factors, 2 * each, &terms).expect("the example is valid");
    let reactions = Reactions::new(2, 1, functions).expect("the example is valid");
    let mut metadata = crane.metadata().clone();
    metadata.outputs.extend(["rope.fy", "belt"].map(|name| shown(name, "N", 20.0)));
    let outputs = motion.outputs.iter().copied().chain([Shown::Reaction(0), Shown::Reaction(1)]).collect();
    let motion = Motion { reactions: Some(reactions), outputs, ..motion.clone() };
    with_motion(&crane, metadata, motion)
}

/// [`crane`] with networks of made-up numbers that add to the mass matrix, the potential, the damping and the force's effect, to a
/// position, and to the forces, which depend on everything.
pub fn crane_with_networks() -> Surrogate {
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
    let mut uniform = uniform_sequence();
    let mut term = |columns: &[(usize, ColumnKind)], outputs: &[usize], activation| {
        let mut layer = |inputs: usize, outputs: usize, activation| {
            let weight: Vec<f32> = (0..inputs * outputs).map(|_| uniform()).collect();
            let bias: Vec<f32> = (0..outputs).map(|_| uniform()).collect();
            Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
        };
        let layers = vec![
            layer(columns.len(), 9, activation),
            layer(9, 6, activation),
            layer(6, outputs.len(), Activation::Identity),
        ];
        let scaling = Scaling {
            input_mean: vec![0.1; columns.len()],
            input_scale: vec![2.0; columns.len()],
            output_mean: vec![0.05; outputs.len()],
            output_scale: vec![0.125; outputs.len()],
        };
        let columns = columns.iter().map(|&(of, kind)| NetworkColumn { of, kind }).collect();
        NetworkTerm::new(columns, outputs.into(), ScaledNetwork { scaling, layers }).expect("the example is valid")
    };
    let (plain, sine, cosine) = (ColumnKind::Plain, ColumnKind::Sine, ColumnKind::Cosine);
    let of_law = term(&[(1, sine), (1, cosine), (0, plain), (2, plain)], &[0, 1, 2, 3, 6, 10], Activation::Tanh);
    let of_positions = term(&[(1, sine), (2, plain)], &[2], Activation::Silu);
    let columns = [(0, plain), (1, cosine), (2, plain), (3, plain), (4, plain), (5, plain)];
    let forces = term(&columns, &[1, 0], Activation::Tanh);
    let law = Law::new(motion.dynamics.law().dictionary().clone(), Some(of_law)).expect("the example is valid");
    let positions = motion.positions.dictionary().clone();
    let dynamics = Dynamics::new(2, 1, law).and_then(|dynamics| dynamics.with_forces(Some(forces)));
    let motion = Motion {
        dynamics: dynamics.expect("the example is valid"),
        positions: Law::new(positions, Some(of_positions)).expect("the example is valid"),
        ..motion.clone()
    };
    with_motion(&crane, crane.metadata().clone(), motion)
}

/// Van der Pol's oscillator with a force, `xdd = mu (1 - x^2) xd - x + force`, exact unless a network from `(mu, force, x, v)`
/// is added to the acceleration. `mu` is a parameter; the output is `x`.
pub fn oscillator(network: Option<ScaledNetwork>) -> Surrogate {
    let state = |name: &str, unit: &str, rate_unit: &str| State {
        name: name.into(),
        unit: unit.into(),
        rate_unit: rate_unit.into(),
        description: format!("example state {name}"),
        range: Some([-4.0, 4.0]),
        nominal: 2.0,
    };
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
        states: vec![state("x", "m", "m/s"), state("v", "m/s", "m/s2")],
        ..surrogate().metadata().clone()
    };
    let plain = Factor::Power { middle: 0.0, half: 1.0 };
    let term = |exponents: [i16; 4], value: f64| Term { exponents: exponents.to_vec(), coefficients: vec![value] };
    // of mu, force, x, v
    let terms = [term([1, 0, 0, 1], 1.0), term([1, 0, 2, 1], -1.0), term([0, 0, 1, 0], -1.0), term([0, 1, 0, 0], 1.0)];
    let dictionary = Dictionary::new(&[plain; 4], 1, &terms).expect("the example is valid");
    let results = [Given::State(0), Given::State(1), Given::Function(0)];
    let graph = Graph::of_rates(&dictionary, network.as_ref().map(Graph::from), 2, &results);
    let clock = Clock::Continuous(Integration::Fixed { step: 0.005 });
    Surrogate::new(metadata, Program { graph, clock }).expect("the example is valid")
}

/// A network for [`oscillator`] with made-up numbers.
pub fn residual_network() -> ScaledNetwork {
    let mut uniform = uniform_sequence();
    let mut layer = |inputs: usize, outputs: usize, activation| {
        let weight: Vec<f32> = (0..inputs * outputs).map(|_| uniform()).collect();
        let bias: Vec<f32> = (0..outputs).map(|_| uniform()).collect();
        Layer { inputs, outputs, weight: weight.into(), bias: bias.into(), activation }
    };
    let layers = vec![layer(4, 6, Activation::Tanh), layer(6, 1, Activation::Identity)];
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
    let mut affine = |of: usize, inputs: usize, outputs: usize| {
        let mut numbers = |count: usize| -> Vec<f64> { (0..count).map(|_| uniform().into()).collect() };
        Step::Affine { of, weight: numbers(inputs * outputs).into(), bias: numbers(outputs).into() }
    };
    let activation = |of: usize, activation| {
        let function = Elementwise::Activation(activation);
        Step::Elementwise { of, function, parameters: Vec::new() }
    };
    // of position, hidden, force, mass: gates, candidates, what was there before, and what becomes of them
    let steps = vec![
        affine(0, 5, 3),
        activation(1, Activation::Sigmoid),
        affine(0, 5, 3),
        activation(3, Activation::Tanh),
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

/// [`oscillator`] by a graph.
pub fn oscillator_by_graph() -> Surrogate {
    let oscillator = oscillator(None);
    let columns = |columns: &[u32]| Step::Columns { columns: columns.iter().map(|column| [0, *column]).collect() };
    let steps = vec![
        columns(&[2]),
        Step::Combine { of: [1, 1], operation: Operation::Multiply },
        Step::Elementwise { of: 2, function: Elementwise::Linear, parameters: vec![-1.0, 1.0] },
        columns(&[0]),
        columns(&[3]),
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
