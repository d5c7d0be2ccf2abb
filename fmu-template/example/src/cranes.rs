//! Cranes with made-up numbers: equations of motion with efforts, a motor, reactions and networks.

use super::{layer, shown, state, surrogate, term, uniform_sequence, variable};
use metafmu_runtime::{
    Activation, Dynamics, Efforts, Input, Integration, Metadata, Motion, Program, Reactions, Role, ScaledNetwork,
    Scaling, Shown, State, Surrogate, Tunability,
    dictionary::{Dictionary, Factor, SPLINE_POWERS, SplineFactor, Term},
    formula::{Combination, ElementaryFunction, Extrapolation, Formula, FormulaStep, Interpolation, LookupTable},
    function_set::{ColumnKind, FunctionSet, NetworkColumn, NetworkTerm},
};
use std::sync::Arc;

/// A crane, exact: a trolley of 2 kg with damping 0.3 N.s/m that a force pushes, and a load of 1 kg on a rope whose length is a
/// parameter. The states are the trolley's position, the rope's angle and their velocities; the outputs are both positions, the load's
/// horizontal position, velocity and acceleration, and the energies.
pub fn crane() -> Surrogate {
    let program = Program::of_motion(crane_motion(), Integration::Fixed { step: 0.005 });
    Surrogate::new(crane_metadata(), program).expect("the example is valid")
}

fn crane_metadata() -> Metadata {
    Metadata {
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
            shown("x", "m", 20.0),
            shown("theta", "rad", 20.0),
            shown("load.x", "m", 20.0),
            shown("load.vx", "m/s", 20.0),
            shown("load.ax", "m/s2", 20.0),
            shown("kinetic", "J", 20.0),
            shown("potential", "J", 20.0),
        ],
        states: vec![
            state("trolley.position", "m", "m/s", Some([-5.0, 5.0])),
            state("rope.angle", "rad", "rad/s", None),
            state("trolley.velocity", "m/s", "m/s2", None),
            state("rope.angular_velocity", "rad/s", "rad/s2", None),
        ],
        ..surrogate().metadata().clone()
    }
}

fn start(name: &str, unit: &str, value: f64) -> Input {
    variable(&State::start_name(name), Role::Start, unit, [-5.0, 5.0, value])
}

fn crane_motion() -> Motion {
    let factors = [Factor::Power { middle: 0.0, half: 1.0 }, Factor::Angle, Factor::Power { middle: 0.0, half: 1.0 }];
    // M = [3; l cos, l²], V = -g l cos, D_xx = 0.3, B_x = 1
    let functions = Dynamics::functions(2, 1);
    let terms = [
        term(&[0, 0, 0], functions, &[(0, 3.0), (6, 0.3), (10, 1.0)]),
        term(&[0, 1, 1], functions, &[(1, 1.0), (3, -9.81)]),
        term(&[0, 0, 2], functions, &[(2, 1.0)]),
    ];
    let function_set = Dictionary::new(&factors, functions, &terms).expect("the example is valid");
    // x, theta and the load's x: what is not a winding is l sin theta
    let positions = Dictionary::new(&factors, 3, &[term(&[0, -1, 1], 3, &[(2, 1.0)])]).expect("the example is valid");
    Motion {
        dynamics: Dynamics::new(2, 1, function_set).expect("the example is valid"),
        positions: positions.into(),
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
    }
}

fn formula(steps: &[FormulaStep]) -> Formula {
    Formula::new(steps.to_vec()).expect("the example is valid")
}

/// The example with different equations.
fn with_motion(like: &Surrogate, metadata: Metadata, motion: Motion) -> Surrogate {
    let integration = like.program().integration().expect("it has states");
    Surrogate::new(metadata, Program::of_motion(motion, integration)).expect("the example is valid")
}

/// [`crane`] with efforts: friction of the trolley, `force - 0.3 tanh(20 v)`, wind against the load's horizontal motion as a torque on the
/// rope, and a force with made-up numbers that has every function and operation.
pub fn crane_with_efforts() -> Surrogate {
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
    let [friction, wind] = friction_and_wind();
    let formulas = vec![friction, wind, made_up_force()];
    let windings = vec![0.0, 1.0, 1.0, 0.0, 1.0, 0.0];
    let efforts = Efforts::new([1, 1, 2], windings, formulas).expect("the example is valid");
    // three positions after V, and a column of B for each effort
    let functions = Dynamics::functions(2, 3) + 3;
    let widened = motion.dynamics.function_set().dictionary().terms().map(|term| {
        let mut coefficients = vec![0.0; functions];
        coefficients[..4].copy_from_slice(&term.coefficients[..4]);
        coefficients[7..13].copy_from_slice(&term.coefficients[4..10]);
        Term { coefficients, ..term }
    });
    let mut terms: Vec<Term> = widened.collect();
    // l sin theta of the load; B = [1 0 0.5; 0 1 0]
    terms.push(term(&[0, -1, 1], functions, &[(5, 1.0)]));
    terms.push(term(&[0, 0, 0], functions, &[(13, 1.0), (15, 0.5), (17, 1.0)]));
    let factors: Vec<Factor> = motion.dynamics.function_set().dictionary().factors().collect();
    let function_set = Dictionary::new(&factors, functions, &terms).expect("the example is valid");
    let dynamics = Dynamics::with_efforts(efforts, function_set).expect("the example is valid");
    let motion = Motion { dynamics, ..motion.clone() };
    with_motion(&crane, crane.metadata().clone(), motion)
}

/// Friction and wind of [`crane_with_efforts`]. Columns: l, force; theta, the load's x, x; their rates.
fn friction_and_wind() -> [Formula; 2] {
    use Combination::{Multiply, Subtract};
    use ElementaryFunction::{Abs, Cos, Tanh};
    use FormulaStep::{Call, Column, Combine, Constant, Negate};
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
    [formula(&friction), formula(&wind.concat())]
}

/// A force that has every function and operation, of the columns of [`friction_and_wind`].
fn made_up_force() -> Formula {
    use Combination::{Add, Angle, Divide, Maximum, Minimum, Multiply, Power, Subtract};
    use ElementaryFunction::{Acos, Asin, Atan, Exp, Floor, Ln, Sign, Sin, Smooth, Sqrt, Tan};
    use FormulaStep::{Call, Column, Combine, Constant, Lookup, Negate};
    let [held, smooth, periodic] = lookup_tables().map(Lookup);
    let bounded = [Column(4), Constant(10.0), Combine(Divide), Call(Sin)];
    let force = [
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
    formula(&force.concat())
}

/// [`crane_with_reactions`] with a spline of the angle, its square and its slopes in equations, positions and reactions.
pub fn crane_with_splines() -> Surrogate {
    let crane = crane_with_reactions();
    let motion = crane.program().motion().expect("the crane moves");
    let [.., periodic] = lookup_tables();
    let splines = [SplineFactor { column: 1, table: periodic }];
    // M_00, M_11, V; the first position; the first force
    let of_motion = motion.dynamics.function_set().dictionary();
    let functions = of_motion.outputs();
    let terms = [
        term(&[0, 0, 0, 0, 2, 0], functions, &[(0, 0.02)]),
        term(&[0, -1, 1, 1, 1, 0], functions, &[(2, 0.01)]),
        term(&[0, 0, 1, 2, 0, 0], functions, &[(3, 3.0)]),
    ];
    let function_set = with_splines(of_motion, &splines, &terms);
    let dynamics =
        Dynamics::with_efforts(motion.dynamics.efforts().clone(), function_set).expect("the example is valid");
    let positions = motion.positions.dictionary();
    let of_position = term(&[0, 0, 0, 1, 0, 0], positions.outputs(), &[(0, 0.25)]);
    let positions = with_splines(positions, &splines, &[of_position]).into();
    let reactions = motion.reactions.as_ref().map(|reactions| {
        let each = Reactions::functions_of_each(2, 1);
        let functions = reactions.functions();
        let terms = [
            term(&[0, 0, 0, 0, 1, 1], functions.outputs(), &[(1, 0.01)]),
            term(&[0, 1, 0, 0, 0, 1], functions.outputs(), &[(each, 0.02)]),
        ];
        let functions = with_splines(functions, &splines, &terms);
        Reactions::new(2, 1, functions).expect("the example is valid")
    });
    with_motion(&crane, crane.metadata().clone(), Motion { dynamics, positions, reactions, ..motion.clone() })
}

/// A dictionary with splines and more terms, whose exponents end with those of the splines.
fn with_splines(dictionary: &Dictionary, splines: &[SplineFactor], more: &[Term]) -> Dictionary {
    let factors: Vec<Factor> = dictionary.factors().collect();
    let mut terms: Vec<Term> = dictionary.terms().collect();
    terms.iter_mut().for_each(|term| term.exponents.extend([0; SPLINE_POWERS]));
    terms.extend_from_slice(more);
    Dictionary::with_splines(&factors, splines, dictionary.outputs(), &terms).expect("the example is valid")
}

/// [`crane`] with a motor: the input is its voltage, its current is a state, the force is 4 times the current, and the electrical power is a
/// further output.
pub fn crane_with_motor() -> Surrogate {
    use Combination::{Add, Multiply, Subtract};
    use FormulaStep::{Column, Combine, Constant};
    let crane = crane();
    let motion = crane.program().motion().expect("the crane moves");
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
    let terms = motion.dynamics.function_set().dictionary().terms().map(|term| {
        let mut coefficients = vec![0.0; functions];
        coefficients[..4].copy_from_slice(&term.coefficients[..4]);
        coefficients[6..12].copy_from_slice(&term.coefficients[4..10]);
        coefficients[12] = term.coefficients[10];
        Term { coefficients, ..term }
    });
    let terms: Vec<Term> = terms.collect();
    let factors: Vec<Factor> = motion.dynamics.function_set().dictionary().factors().collect();
    let function_set = Dictionary::new(&factors, functions, &terms).expect("the example is valid");
    let dynamics = Dynamics::with_efforts(efforts, function_set).expect("the example is valid");
    let outputs = motion.outputs.iter().copied().chain([Shown::Effort(1)]).collect();
    let motion = Motion { dynamics, outputs, actuator_states: 1, ..motion.clone() };
    let mut metadata = crane.metadata().clone();
    metadata.outputs.push(shown("power", "W", 20.0));
    let voltage = metadata.inputs.len() - 1;
    metadata.inputs.insert(voltage, start("current", "A", 0.5));
    metadata.states.push(state("current", "A", "A/s", Some([-20.0, 20.0])));
    with_motion(&crane, metadata, motion)
}

/// Tables of one argument with straight lines, of two arguments with a spline, and a spline that repeats itself.
fn lookup_tables() -> [Arc<LookupTable>; 3] {
    use Interpolation::{Cubic, Linear};
    let surface = (0..20).map(|k| f64::from(k * k % 7) / 4.0 - 0.5).collect();
    let arguments = vec![vec![0.5, 0.75, 1.0, 2.0], vec![-1.0, -0.25, 0.0, 0.5, 1.0]];
    let (knots, values) = (vec![-0.2, 0.1, 0.25, 0.8], vec![0.1, 0.3, -0.2, 0.1]);
    [
        LookupTable::new(vec![vec![-0.5, 0.0, 0.75]], vec![0.25, 0.0, -0.5], Linear, Extrapolation::Hold),
        LookupTable::new(arguments, surface, Cubic, Extrapolation::Linear),
        LookupTable::new(vec![knots], values, Cubic, Extrapolation::Periodic),
    ]
    .map(|table| Arc::new(table.expect("the example is valid")))
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
    let count = 2 * each;
    let terms = [
        term(&[0, 0, 0], count, &[(7, 9.81), (each, 2.0), (each + 5, -0.3)]),
        term(&[0, -1, 1], count, &[(1, 1.0), (each + 1, 0.25), (each + 2, -0.5)]),
        term(&[0, 1, 1], count, &[(4, 1.0), (each + 3, 1.5), (each + 4, 0.75)]),
        term(&[1, -2, 0], count, &[(each + 6, 0.125), (each + 7, 0.5)]),
        term(&[0, 0, 2], count, &[(each + 8, 0.25)]),
    ];
    let factors: Vec<Factor> = motion.dynamics.function_set().dictionary().factors().collect();
    let functions = Dictionary::new(&factors, count, &terms).expect("the example is valid");
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
    let [x, l, v, w, u] = [0, 2, 3, 4, 5].map(|of| NetworkColumn { of, kind: ColumnKind::Plain });
    let [sine, cosine] = [ColumnKind::Sine, ColumnKind::Cosine].map(|kind| NetworkColumn { of: 1, kind });
    let of_law = network_term(vec![sine, cosine, x, l], vec![0, 1, 2, 3, 6, 10], Activation::Tanh, &mut uniform);
    let of_positions = network_term(vec![sine, l], vec![2], Activation::Silu, &mut uniform);
    let forces = network_term(vec![x, cosine, l, v, w, u], vec![1, 0], Activation::Tanh, &mut uniform);
    let function_set = FunctionSet::new(motion.dynamics.function_set().dictionary().clone(), Some(of_law))
        .expect("the example is valid");
    let positions = motion.positions.dictionary().clone();
    let dynamics = Dynamics::new(2, 1, function_set).and_then(|dynamics| dynamics.with_forces(Some(forces)));
    let motion = Motion {
        dynamics: dynamics.expect("the example is valid"),
        positions: FunctionSet::new(positions, Some(of_positions)).expect("the example is valid"),
        ..motion.clone()
    };
    with_motion(&crane, crane.metadata().clone(), motion)
}

/// Network with hidden layers of 9 and 6 and numbers of a sequence.
fn network_term(
    columns: Vec<NetworkColumn>,
    outputs: Vec<usize>,
    activation: Activation,
    uniform: &mut impl FnMut() -> f32,
) -> NetworkTerm {
    let layers = vec![
        layer(columns.len(), 9, activation, uniform),
        layer(9, 6, activation, uniform),
        layer(6, outputs.len(), Activation::Identity, uniform),
    ];
    let scaling = Scaling {
        input_mean: vec![0.1; columns.len()],
        input_scale: vec![2.0; columns.len()],
        output_mean: vec![0.05; outputs.len()],
        output_scale: vec![0.125; outputs.len()],
    };
    NetworkTerm::new(columns, outputs, ScaledNetwork { scaling, layers }).expect("the example is valid")
}
