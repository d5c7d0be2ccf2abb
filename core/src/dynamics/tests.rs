use super::*;
use crate::{
    integrate::{Budget, TOLERANCE, integrate},
    multibody::{MotionCause, RunStart},
    signal::Signal,
};
use metafmu_runtime::StatePoint;
use nalgebra::Vector2;
use std::{
    f64::consts::{FRAC_PI_2, PI, TAU},
    path::Path,
};

/// A cart of 2 kg that a motor pushes, with damping `b`, and a load of `m` on a massless rope of length `l`.
const CRANE: &str = r#"
    gravity = [0, -9.81]
    parameters.l = { default = 1.5 }
    parameters.m = { default = 1 }
    parameters.b = { default = 0.3 }
    inputs.force = { min = -20, max = 20, unit = "N" }
    bodies.cart = { mass = 2, inertia = 1 }
    bodies.load = { mass = "m", position = [0, "-l"], points = { top = [0, "l"] } }
    joints.rail = { type = "prismatic", between = ["ground", "cart"], axis = [1, 0] }
    joints.rope = { type = "revolute", between = ["cart", "load.top"] }
    actuators.motor = { coordinate = "rail.position", effort = "force" }
    actuators.friction = { coordinate = "rail.position", effort = "-b * rail.velocity" }
    outputs.x = { measure = "rail.position" }
"#;

fn parse(text: &str) -> Mechanism {
    Mechanism::parse(text, Path::new("m.toml")).unwrap()
}

fn crane_region() -> Region {
    Region {
        coordinates: vec![
            QuantityRange::new("rail.position", -5.0, 5.0),
            QuantityRange::new("rope.angle", -TAU / 2.0, TAU / 2.0),
        ],
        parameters: vec![
            QuantityRange::new("l", 1.0, 2.0),
            QuantityRange::new("m", 0.5, 1.5),
            QuantityRange::new("b", 0.0, 0.5),
        ],
        ..Region::default()
    }
}

/// The accelerations that were learned are those of the mechanism at a state `(q, v, u, p)`.
fn assert_exact(text: &str, region: &Region, [q, v, u, p]: [&[f64]; 4], bound: f64) {
    let mechanism = parse(text);
    let fitted = fit(&mechanism, region, 1).unwrap();
    assert!(fitted.error < 1e-12, "{:e}", fitted.error);
    let mut found = vec![0.0; q.len()];
    fitted.dynamics.accelerations(StatePoint { q, v, u, p }, &mut found, &mut fitted.dynamics.scratch());
    let names: Vec<&str> = region.coordinates.iter().map(|range| range.name.as_str()).collect();
    let values: Vec<f64> = mechanism
        .parameters()
        .iter()
        .map(|(name, parameter)| {
            let varied = region.parameters.iter().position(|range| range.name == *name);
            varied.map_or(parameter.default, |index| p[index])
        })
        .collect();
    let reduced = mechanism.reduced(&values, &names).unwrap();
    let exact = reduced.accelerations(&reduced.terms(&q.to_vec().into()).unwrap(), &v.to_vec().into(), u).unwrap();
    for (found, exact) in found.iter().zip(&exact) {
        assert!((found - exact).abs() < bound * (1.0 + exact.abs()), "{found} {exact}");
    }
}

const CRANE_STATE: [&[f64]; 4] = [&[3.0, 0.7], &[1.5, -2.0], &[12.0], &[1.3, 0.8, 0.2]];

#[test]
fn a_tree_mechanism_is_learned_exactly() {
    assert_exact(CRANE, &crane_region(), CRANE_STATE, 1e-11);
}

#[test]
fn the_same_seed_gives_the_same_bits() {
    let mechanism = parse(CRANE);
    let fitted = || format!("{:?}", fit(&mechanism, &crane_region(), 3).unwrap().dynamics);
    let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(fitted(), alone.install(fitted));
}

#[test]
fn andrews_mechanism_with_its_torque_as_an_input_is_within_1e_8_after_two_and_a_half_turns() {
    let text = include_str!("../../../examples/dynamics/andrews.toml");
    let start = -0.061_713_890_014_276_45;
    let region = Region {
        coordinates: vec![QuantityRange::new("K1.angle", -PI, PI)],
        parameters: vec![QuantityRange::new("c0", 4000.0, 5000.0)],
        ..Region::default()
    };
    let fitted = fit(&parse(text), &region, 1).unwrap();
    // the crank starts at a dead center of the spring, where its force is rounding
    assert!(fitted.error < 1e-12 && !fitted.dynamics.is_uniform(0), "{:e}, {:?}", fitted.error, fitted.order);
    let mut accelerations = [0.0];
    let mut scratch = fitted.dynamics.scratch();
    let mut derivative = |y: &Vector2<f64>| {
        let point = StatePoint { q: &[y[0]], v: &[y[1]], u: &[0.033], p: &[4530.0] };
        fitted.dynamics.accelerations(point, &mut accelerations, &mut scratch);
        Vector2::new(y[1], accelerations[0])
    };
    let cell = std::cell::RefCell::new(&mut derivative);
    let states =
        integrate(|y| (cell.borrow_mut())(y), Vector2::new(start, 0.0), &[0.0, 0.03], TOLERANCE, &Budget::default())
            .unwrap();
    let error = (states[1][0] - 15.810771195153).abs();
    assert!(error < 1e-8, "{error:e} rad, order {:?}, {:e}", fitted.order, fitted.error);
}

#[test]
fn what_cannot_be_learned_is_refused() {
    let message = |text: &str, region: &Region| fit(&parse(text), region, 1).unwrap_err().message;
    let region = crane_region();
    let with = |change: &dyn Fn(&mut Region)| {
        let mut region = region.clone();
        change(&mut region);
        region
    };
    let rooted = CRANE.replace("-b * rail.velocity", "-sqrt(rail.velocity)");
    assert!(
        message(&rooted, &region).ends_with(
            "`-sqrt(rail.velocity)` of `actuators.friction` is NaN with force = 12, expected a finite number"
        )
    );
    let rooted = CRANE.replace("effort = \"force\"", "effort = \"sqrt(force)\"");
    assert!(
        message(&rooted, &region)
            .ends_with("`sqrt(force)` of `actuators.motor` is NaN with force = -20, expected a finite number")
    );
    let far = with(&|region| region.coordinates[0].max = 1e9);
    assert!(message(CRANE, &far).ends_with("more than 10000 rad or m from the start"));
    let unknown = with(&|region| region.parameters[0].name = "length".into());
    assert_eq!(message(CRANE, &unknown), "the mechanism has no parameter `length`");
    let empty = with(&|region| region.coordinates[0].max = -5.0);
    assert_eq!(message(CRANE, &empty), "`rail.position`: range from -5 to -5, expected an end above the beginning");
    let idle = CRANE.replace("[0, \"-l\"]", "[\"l*sin(b)\", \"-l*cos(b)\"]").replace("-b * rail", "-0.1 * rail");
    let checked = |text: &str| check(&parse(text), &region, 1).unwrap();
    let expected = Checked { idle: Vec::new(), is_periodic: vec![false, true], is_used: vec![false, true] };
    assert_eq!(checked(CRANE), expected);
    assert_eq!(checked(&idle).idle, ["b"]);
    let few = with(&|region| region.coordinates.truncate(1));
    assert!(message(CRANE, &few).contains("1 coordinate, expected 2: one for each degree of freedom"));
}

/// Friction in tanh, and a force that is a product of the input and a velocity.
fn rough_crane() -> String {
    CRANE
        .replace("-b * rail.velocity", "-b * tanh(rail.velocity / 0.05)")
        .replace("effort = \"force\"", "effort = \"force * (1 - 0.1 * rail.velocity)\"")
}

#[test]
fn known_forces_are_exact_however_they_depend_on_velocities_inputs_and_parameters() {
    assert_exact(&rough_crane(), &crane_region(), CRANE_STATE, 1e-12);
    for effort in [
        "0.2 * force^2",
        "tanh(force)",
        "force * rope.angle / (l + m^b)",
        "force - b * rail.velocity * abs(rail.velocity)",
        "-b * exp(-(load.vx / 0.3)^2) * atan(load.vx) + sqrt(1 + load.y^2)",
    ] {
        let text = CRANE.replace("effort = \"force\"", &format!("effort = \"{effort}\""));
        assert_exact(&text, &crane_region(), CRANE_STATE, 1e-11);
    }
    // against the wind, with components that depend on positions and velocities of points
    let wind =
        "forces.wind = { point = \"load.top\", force = [\"-0.1 * load.vx * abs(load.vx)\", \"0.2 * force * load.x\"] }";
    assert_exact(&format!("{CRANE}{wind}\n"), &crane_region(), CRANE_STATE, 1e-11);
    // what only the formula depends on acts
    assert_eq!(check(&parse(&rough_crane()), &crane_region(), 1).unwrap().idle, [""; 0]);
    let without = Region { velocities: vec![[-2.0, 2.0]], ..crane_region() };
    assert!(Equations::new(&parse(CRANE), &without).is_err());
}

#[test]
fn an_effort_that_is_another_one_a_turn_later_is_exact_too() {
    let text = CRANE.replace("effort = \"-b * rail.velocity\"", "effort = \"-b * rope.angle^3\"");
    let fitted = fit(&parse(&text), &crane_region(), 1).unwrap();
    assert_eq!(fitted.periods, [None, None]);
    assert_eq!(fit(&parse(CRANE), &crane_region(), 1).unwrap().periods, [None, Some(1)]);
    assert_exact(&text, &crane_region(), [&[3.0, 7.5], &[1.5, -2.0], &[12.0], &[1.3, 0.8, 0.2]], 1e-11);
}

#[test]
fn the_friction_of_a_closed_loop_is_as_exact_as_its_position() {
    let text = format!(
        "{}[actuators.friction]\ncoordinate = \"guide.position\"\neffort = \"-tanh(guide.velocity / 0.05)\"\n",
        include_str!("../../../examples/dynamics/slider-crank.toml")
    );
    let region = Region { coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)], ..Region::default() };
    assert_exact(&text, &region, [&[2.2], &[0.7], &[0.7], &[]], 1e-9);
}

/// A pendulum with a spring on its joint.
const TORSION: &str = r#"
    gravity = [0, -9.81]
    parameters.m = { default = 1, min = 0.5, max = 2 }
    inputs.torque = { min = -4, max = 4 }
    bodies.rod = { mass = "m", inertia = "0.02*m", position = [0, -0.3], points = { o = [0, 0.3] } }
    joints.pivot = { type = "revolute", between = ["ground", "rod.o"] }
    actuators.motor = { coordinate = "pivot.angle", effort = "torque" }
    springs.k = { coordinate = "pivot.angle", stiffness = 5, damping = 0.1 }
    outputs.q = { measure = "pivot.angle" }
"#;

#[test]
fn the_torque_of_a_spring_on_a_joint_is_another_one_a_turn_later() {
    let region = Region {
        coordinates: vec![QuantityRange::new("pivot.angle", -TAU / 2.0, TAU / 2.0)],
        parameters: vec![QuantityRange::new("m", 0.5, 2.0)],
        outputs: named(&["q"]),
        ..Region::default()
    };
    assert_eq!(check(&parse(TORSION), &region, 1).unwrap().is_periodic, [false]);
    let free = TORSION.replace("stiffness = 5, ", "");
    assert_eq!(check(&parse(&free), &region, 1).unwrap().is_periodic, [true]);
    let fitted = fit(&parse(TORSION), &region, 1).unwrap();
    assert!(fitted.error < 1e-11, "{:e}, {:?}", fitted.error, fitted.order);
    for theta in [-3.0f64, -0.4, 2.1] {
        let (omega, torque, m) = (1.7, -2.0, 1.3);
        let point = StatePoint { q: &[theta], v: &[omega], u: &[torque], p: &[m] };
        let mut found = [0.0];
        fitted.dynamics.accelerations(point, &mut found, &mut fitted.dynamics.scratch());
        let inertia = 0.02 * m + m * 0.09;
        let expected = (torque - 5.0 * theta - 0.1 * omega - m * 9.81 * 0.3 * theta.sin()) / inertia;
        assert!((found[0] - expected).abs() < 1e-8 * expected.abs().max(1.0), "{theta}: {found:?} {expected}");
    }
}

#[test]
fn singular_positions_in_a_range_are_found() {
    // of two arms of 1 m on pivots 1.5 m apart, joined by rods of 1 m
    let text = r#"
        ground.points = { a = [-0.75, 0], b = [0.75, 0] }
        bodies.left = { mass = 1, inertia = 0.1, position = [-0.75, 0.5], angle = 1.5708, points = { a = [-0.5, 0], b = [0.5, 0] } }
        bodies.right = { mass = 1, inertia = 0.1, position = [0.75, 0.5], angle = 1.5708, points = { a = [-0.5, 0], b = [0.5, 0] } }
        bodies.rod = { mass = 1, inertia = 0.1, position = [-0.4, 1.3], angle = 0.7, points = { a = [-0.5, 0], b = [0.5, 0] } }
        bodies.bar = { mass = 1, inertia = 0.1, position = [0.4, 1.3], angle = 2.4, points = { a = [-0.5, 0], b = [0.5, 0] } }
        joints.A = { type = "revolute", between = ["ground.a", "left.a"] }
        joints.B = { type = "revolute", between = ["ground.b", "right.a"] }
        joints.C = { type = "revolute", between = ["left.b", "rod.a"] }
        joints.D = { type = "revolute", between = ["right.b", "bar.a"] }
        joints.E = { type = "revolute", between = ["rod.b", "bar.b"] }
        initial.A.angle = 1.5708
        initial.B.angle = 1.5708
        outputs.x = { measure = "rod.b.x" }
    "#;
    let mechanism = parse(text);
    let region = |half: f64| Region {
        coordinates: ["A.angle", "B.angle"]
            .map(|name| QuantityRange::new(name, FRAC_PI_2 - half, FRAC_PI_2 + half))
            .into(),
        ..Region::default()
    };
    reach(&mechanism, &region(0.2), true, 1).unwrap();
    // the tips are farther apart than the rods are long
    let error = reach(&mechanism, &region(1.5), false, 1).unwrap_err();
    assert_eq!((error.cause, &error.part), (MotionCause::Singular, &None));
    assert!(error.message.starts_with("at A.angle = "), "{error}");
}

#[test]
fn gradients_of_the_functions_are_those_of_finite_differences() {
    let text = include_str!("../../../examples/dynamics/slider-crank.toml");
    let mechanism = parse(text);
    let free = mechanism.free_coordinates().unwrap().remove(0).name;
    let outputs = mechanism.outputs().iter().map(|output| output.name.clone()).collect();
    let coordinates = vec![QuantityRange::new(&free, 0.0, TAU)];
    let region = Region { coordinates, outputs, inputs: vec![[-1.0, 1.0]], ..Region::default() };
    let labels = MechanismRegion::new(&mechanism, &region).unwrap();
    let known = labels.known();
    // mass matrix, potential, force, damping, input, positions
    assert_eq!(known[..5], [true, true, false, false, false]);
    assert!(known.len() > 5 && known[5..].iter().all(|known| *known));
    for angle in [0.3, 1.9, 4.0] {
        let (at, h) = (|angle: f64| labels.at(&[angle]).unwrap().functions, 1e-4);
        let gradients = labels.at(&[angle]).unwrap().gradients;
        let [before, after] = [at(angle - h), at(angle + h)];
        for (function, _) in known.iter().enumerate().filter(|(_, known)| **known) {
            let expected = (after[function] - before[function]) / (2.0 * h);
            let found = gradients[function];
            assert!((found - expected).abs() < 1e-6, "{function}: {found} {expected}");
        }
    }
}

#[test]
fn a_loop_that_cannot_be_closed_everywhere_is_refused_with_the_place() {
    // a crank-slider whose rod is shorter than the crank
    let text = r#"
        bodies.crank = { mass = 1, inertia = 0.1, position = [0.5, 0], points = { pin = [-0.5, 0], tip = [0.5, 0] } }
        bodies.rod = { mass = 1, inertia = 0.1, position = [1.4, 0], points = { a = [-0.4, 0], b = [0.4, 0] } }
        bodies.slider = { mass = 1, position = [1.8, 0] }
        joints.A = { type = "revolute", between = ["ground", "crank.pin"] }
        joints.B = { type = "revolute", between = ["crank.tip", "rod.a"] }
        joints.C = { type = "revolute", between = ["rod.b", "slider"] }
        joints.guide = { type = "prismatic", between = ["ground", "slider"], axis = [1, 0] }
        outputs.x = { measure = "guide.position" }
    "#;
    let region = |end: f64| Region { coordinates: vec![QuantityRange::new("A.angle", 0.0, end)], ..Region::default() };
    let error = fit(&parse(text), &region(TAU), 1).unwrap_err();
    assert_eq!((error.cause, &error.part), (MotionCause::Singular, &None));
    assert!(error.message.starts_with("at A.angle = "), "{error}");
    assert!(fit(&parse(text), &region(0.5), 1).unwrap().error < 1e-8);
}

#[test]
fn outputs_are_positions_with_their_windings() {
    let region = Region { outputs: vec!["x".into(), "theta".into()], ..crane_region() };
    // what is left of an angle without its turns may be rounding, and is not learned
    for start in ["", "[initial]\nrope.angle = 0.3"] {
        let text = format!("{CRANE}    outputs.theta = {{ measure = \"rope.angle\" }}\n{start}");
        let fitted = fit(&parse(&text), &region, 1).unwrap();
        assert_eq!(fitted.windings, [1.0, 0.0, 0.0, 1.0]);
        assert!(fitted.error < 1e-12, "{}", fitted.error);
    }
}

#[test]
fn points_that_parameters_move_are_where_they_are_with_their_values() {
    // alike for the defaults only
    let text = format!(
        "{CRANE}\n    outputs.half = {{ measure = \"load.half.x\" }}\n    outputs.fixed = {{ measure = \"load.fixed.x\" }}\n"
    );
    let points = "points = { top = [0, \"l\"], half = [0, \"l / 2\"], fixed = [0, 0.75] } }";
    let text = text.replace("points = { top = [0, \"l\"] } }", points);
    let region = Region { outputs: named(&["half", "fixed"]), ..crane_region() };
    let mechanism = parse(&text);
    let fitted = fit(&mechanism, &region, 1).unwrap();
    assert_eq!(fitted.outputs, [Shown::Position(0), Shown::Position(1)]);
    let mut found = [0.0; 2];
    fitted.positions.evaluate(&[3.0, 0.7, 1.1, 1.0, 0.2], &mut found);
    let expected = [0.55, 0.35].map(|rope: f64| rope * 0.7f64.sin());
    assert_eq!(fitted.windings, [1.0, 0.0, 1.0, 0.0]);
    assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-12), "{found:?} {expected:?}");
    let assembly = Assembly::new(&mechanism, &region).unwrap();
    let positions = assembly.with(&[1.1, 1.0, 0.2]).unwrap().positions(&[3.0, 0.7]).unwrap();
    let of_mechanism: Vec<f64> = positions.iter().map(|(_, position)| position - 3.0).collect();
    assert!((0..2).all(|k| (of_mechanism[k] - expected[k]).abs() < 1e-12), "{of_mechanism:?} {expected:?}");
}

#[test]
fn a_closed_loop_is_put_together_at_any_coordinate() {
    let text = include_str!("../../../examples/dynamics/slider-crank.toml");
    let mechanism = parse(&format!("{text}x = {{ measure = \"slider.x\" }}\nspeed = {{ measure = \"slider.vx\" }}\n"));
    let region = Region {
        coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)],
        outputs: ["theta", "speed", "x"].map(String::from).into(),
        ..Region::default()
    };
    let assembly = Assembly::new(&mechanism, &region).unwrap();
    let assembled = assembly.with(&[]).unwrap();
    for theta in [0.3, 2.0, 9.0, -4.0] {
        let x = 0.3 * f64::cos(theta) + (0.81 - 0.09 * f64::sin(theta).powi(2)).sqrt();
        let positions = assembled.positions(&[theta]).unwrap();
        assert_eq!(positions.iter().map(|(output, _)| *output).collect::<Vec<_>>(), [0, 2]);
        for ((_, found), expected) in positions.iter().zip([theta, x]) {
            assert!((found - expected).abs() < 1e-12, "{theta}: {found} {expected}");
        }
    }
}

/// Outputs that are forces, in a state: as learned, and as the augmented formulation has them. The exact equations must agree with the
/// latter.
fn forces(text: &str, region: &Region, [q, v, u, p]: [&[f64]; 4]) -> [Vec<f64>; 2] {
    let mechanism = parse(text);
    let fitted = fit(&mechanism, region, 1).unwrap();
    let FittedReactions { reactions, error, order } = fitted.reactions.unwrap();
    assert!(error < 1e-9, "{error:e} {order:?}");
    let point = StatePoint { q, v, u, p };
    let mut accelerations = vec![0.0; q.len()];
    fitted.dynamics.accelerations(point, &mut accelerations, &mut fitted.dynamics.scratch());
    let efforts = fitted.dynamics.efforts_at(point, &mut fitted.dynamics.scratch());
    let shown = |reactions: Vec<f64>| -> Vec<f64> {
        let of = |shown: &Shown| if let Shown::Reaction(index) = shown { reactions[*index] } else { f64::NAN };
        fitted.outputs.iter().map(of).collect()
    };
    let names: Vec<&str> = region.coordinates.iter().map(|range| range.name.as_str()).collect();
    let value = |(name, parameter): (&String, &crate::multibody::description::MechanismParameter)| {
        let varied = region.parameters.iter().position(|range| range.name == *name);
        varied.map_or(parameter.default, |index| p[index])
    };
    let values: Vec<f64> = mechanism.parameters().iter().map(value).collect();
    let signals: Vec<Signal> = u.iter().map(|u| Signal::Constant(*u)).collect();
    let integration = (TOLERANCE, &Budget::default());
    let start = RunStart { coordinates: &names, positions: q, rates: v, actuator_states: &[] };
    let row = mechanism.simulate_from(&values, start, &signals, &[0.0], integration).unwrap();
    let of_output = |name: &String| row[mechanism.outputs().iter().position(|output| output.name == *name).unwrap()];
    let simulated: Vec<f64> = region.outputs.iter().map(of_output).collect();
    let [velocities, inputs] = [v, u].map(|values| values.iter().map(|value| [value - 1.0, value + 1.0]).collect());
    let region = Region { velocities, inputs, ..region.clone() };
    let exact = Equations::new(&mechanism, &region).unwrap().with(p).unwrap().motion(q, v, u).unwrap();
    let of_forces = shown(exact.reactions).into_iter().zip(&simulated).filter(|(force, _)| !force.is_nan());
    let (exact, expected) = of_forces.unzip();
    assert_alike([exact, expected], 1e-9);
    [shown(reactions.evaluate(StatePoint { u: &efforts, ..point }, &accelerations)), simulated]
}

fn named(outputs: &[&str]) -> Vec<String> {
    outputs.iter().map(|name| (*name).to_owned()).collect()
}

fn assert_alike([found, expected]: [Vec<f64>; 2], tolerance: f64) {
    let largest = expected.iter().fold(0.0f64, |largest, one| largest.max(one.abs()));
    assert!(!found.is_empty() && found.len() == expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        assert!((found - expected).abs() < tolerance * largest, "{found} {expected}");
    }
}

#[test]
fn the_force_at_the_pivot_of_a_pendulum_has_its_closed_form() {
    let text = format!(
        "{}fx = {{ measure = \"pivot.fx\" }}\nfy = {{ measure = \"pivot.fy\" }}\n",
        include_str!("../../../examples/dynamics/pendulum.toml")
    );
    let region = Region {
        coordinates: vec![QuantityRange::new("pivot.angle", 0.0, TAU)],
        parameters: vec![
            QuantityRange::new("L", 0.5, 1.0),
            QuantityRange::new("m", 0.5, 2.0),
            QuantityRange::new("c", 0.0, 0.2),
        ],
        outputs: named(&["fx", "fy"]),
        ..Region::default()
    };
    let (theta, omega, torque, [l, m, c]) = (2.1f64, -7.0, 1.7, [0.7, 1.3, 0.15]);
    let [found, simulated] = forces(&text, &region, [&[theta], &[omega], &[torque], &[l, m, c]]);
    let (sine, cosine) = theta.sin_cos();
    let alpha = (torque - c * omega - m * 9.81 * l * sine) / (m * l * l);
    let fx = m * l * (cosine * alpha - sine * omega * omega);
    let fy = m * (9.81 + l * (sine * alpha + cosine * omega * omega));
    assert_alike([found, vec![fx, fy]], 1e-11);
    assert_alike([simulated, vec![fx, fy]], 1e-11);
}

#[test]
fn forces_in_trees_and_loops_are_those_of_the_simulation() {
    // joints of all kinds, and a spring
    let crane = format!(
        "{CRANE}\
         bodies.hook = {{ mass = 0.3, inertia = 0.01, position = [0.1, \"-l - 0.2\"] }}\n\
         joints.weld = {{ type = \"fixed\", between = [\"load.eye\", \"hook\"] }}\n\
         springs.line = {{ coordinate = \"rail.position\", stiffness = 2, damping = 0.1 }}\n\
         outputs.rail = {{ measure = \"rail.fy\" }}\n\
         outputs.moment = {{ measure = \"rail.moment\" }}\n\
         outputs.rope_x = {{ measure = \"rope.fx\" }}\n\
         outputs.rope_y = {{ measure = \"rope.fy\" }}\n\
         outputs.weld = {{ measure = \"weld.moment\" }}\n\
         outputs.line = {{ measure = \"line.force\" }}\n"
    );
    let crane = crane.replace("points = { top = [0, \"l\"] } }", "points = { top = [0, \"l\"], eye = [0.1, -0.2] } }");
    let region = Region { outputs: named(&["rail", "moment", "rope_x", "rope_y", "weld", "line"]), ..crane_region() };
    assert_alike(forces(&crane, &region, [&[3.0, 0.7], &[1.5, -2.0], &[12.0], &[1.3, 0.8, 0.2]]), 1e-11);

    let slider_crank = format!(
        "{}side = {{ measure = \"guide.fy\" }}\nmoment = {{ measure = \"guide.moment\" }}\n\
         pin = {{ measure = \"B.fx\" }}\nmain = {{ measure = \"A.fy\" }}\n",
        include_str!("../../../examples/dynamics/slider-crank.toml")
    );
    let region = Region {
        coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)],
        parameters: vec![QuantityRange::new("m", 0.5, 2.0), QuantityRange::new("c", 0.0, 0.5)],
        outputs: named(&["side", "moment", "pin", "main"]),
        ..Region::default()
    };
    assert_alike(forces(&slider_crank, &region, [&[2.2], &[9.0], &[0.7], &[1.7, 0.3]]), 1e-9);

    let four_bar = format!(
        "{}x = {{ measure = \"C.fx\" }}\ny = {{ measure = \"D.fy\" }}\nspring = {{ measure = \"return.force\" }}\n",
        include_str!("../../../examples/dynamics/four-bar.toml")
    );
    let region = Region {
        coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)],
        outputs: named(&["x", "y", "spring"]),
        ..Region::default()
    };
    assert_alike(forces(&four_bar, &region, [&[5.1], &[-12.0], &[-0.4], &[]]), 1e-9);
}

#[test]
fn forces_of_joints_are_exact_with_friction() {
    let text = format!("{}outputs.rope = {{ measure = \"rope.fy\" }}\n", rough_crane());
    let region = Region { outputs: named(&["rope"]), ..crane_region() };
    assert_alike(forces(&text, &region, [&[3.0, 0.7], &[0.03, -2.0], &[12.0], &[1.3, 0.8, 0.2]]), 1e-11);
    let slider_crank = format!(
        "{}side = {{ measure = \"guide.fy\" }}\n[actuators.friction]\ncoordinate = \"guide.position\"\n\
         effort = \"-tanh(guide.velocity / 0.05)\"\n",
        include_str!("../../../examples/dynamics/slider-crank.toml")
    );
    let region = Region {
        coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)],
        outputs: named(&["side"]),
        ..Region::default()
    };
    assert_alike(forces(&slider_crank, &region, [&[2.2], &[0.7], &[0.7], &[]]), 1e-9);
}

/// The crane whose cart a driver accelerates: by the input, with a brake and something of the swing.
fn driven_crane() -> String {
    let motor = "actuators.motor = { coordinate = \"rail.position\", effort = \"force\" }";
    assert!(CRANE.contains(motor));
    let driver = "drivers.motor = { coordinate = \"rail.position\", acceleration = \"a * l - b * rail.velocity + 0.3 * sin(rope.angle)\" }";
    let text = CRANE.replace(motor, driver).replace("inputs.force", "inputs.a");
    format!(
        "{text}    outputs.effort = {{ measure = \"motor.effort\" }}\n    outputs.rope = {{ measure = \"rope.fx\" }}\n"
    )
}

#[test]
fn a_driver_with_an_input_is_learned_exactly_and_its_effort_is_newtons() {
    let region = Region { outputs: named(&["effort", "rope"]), ..crane_region() };
    let mechanism = parse(&driven_crane());
    let fitted = fit(&mechanism, &region, 1).unwrap();
    assert!(fitted.error < 1e-12, "{:e}", fitted.error);
    assert_eq!(fitted.dynamics.prescribed(), [true, false]);
    let (q, v, u, [l, m, b]) = ([3.0, 0.7], [1.5, -2.0], [1.2], [1.3, 0.8, 0.2]);
    let mut found = [0.0; 2];
    let point = StatePoint { q: &q, v: &v, u: &u, p: &[l, m, b] };
    fitted.dynamics.accelerations(point, &mut found, &mut fitted.dynamics.scratch());
    let (sine, cosine) = q[1].sin_cos();
    let a = u[0] * l - b * v[0] + 0.3 * sine;
    let alpha = -(9.81 * sine + a * cosine) / l;
    assert!((found[0] - a).abs() < 1e-12 && (found[1] - alpha).abs() < 1e-12, "{found:?} {a} {alpha}");
    let rope = m * (a + l * (alpha * cosine - v[1] * v[1] * sine));
    let [learned, simulated] = forces(&driven_crane(), &region, [&q, &v, &u, &[l, m, b]]);
    assert_alike([learned, vec![2.0 * a + rope + b * v[0], rope]], 1e-11);
    assert_alike([simulated, vec![2.0 * a + rope + b * v[0], rope]], 1e-11);
}

#[test]
fn the_effort_that_turns_a_closed_loop_is_that_of_the_simulation() {
    let text =
        include_str!("../../../examples/dynamics/slider-crank.toml").replace("[actuators.motor]", "[drivers.motor]");
    let text = text.replace("effort = \"torque\"", "acceleration = \"5*torque\"");
    let text = format!("{text}effort = {{ measure = \"motor.effort\" }}\nside = {{ measure = \"guide.fy\" }}\n");
    let region = Region {
        coordinates: vec![QuantityRange::new("A.angle", 0.0, TAU)],
        parameters: vec![QuantityRange::new("m", 0.5, 2.0), QuantityRange::new("c", 0.0, 0.5)],
        outputs: named(&["effort", "side"]),
        ..Region::default()
    };
    assert_alike(forces(&text, &region, [&[2.2], &[9.0], &[0.7], &[1.7, 0.3]]), 1e-9);
}

#[test]
fn prescribed_accelerations_are_exact_however_large_the_forces_are() {
    // forces of a billion newtons beside an acceleration of some m/s²
    let text = driven_crane().replace("0.3 * sin(rope.angle)", "0.1 * tanh(rail.velocity / 0.5)");
    let text = text.replace("mass = \"m\"", "mass = \"1e8 * m\"");
    assert_exact(&text, &crane_region(), CRANE_STATE, 1e-11);
    let region = Region { outputs: named(&["effort"]), ..crane_region() };
    let rough = driven_crane().replace("-b * rail.velocity\"", "-b * tanh(rail.velocity / 0.05)\"");
    assert!(rough.contains("tanh"));
    assert_alike(forces(&rough, &region, CRANE_STATE), 1e-11);
}

/// In angles of bodies, the inertia of a chain has products of two sines or cosines at most.
/// A cam with ten knots that lifts a follower against a spring, and turns by a torque.
fn cam(more: &str) -> String {
    let knots: Vec<f64> = (0..=10).map(|k| f64::from(k) * TAU / 10.0).collect();
    let lift = [0.0, 0.4, 2.6, 6.1, 9.2, 10.0, 8.4, 5.3, 2.2, 0.3, 0.0].map(|lift| 1e-3 * lift);
    format!(
        r#"
        gravity = [0, -9.81]
        parameters = {{ m = {{ default = 0.2, min = 0.1, max = 0.4 }} }}
        inputs.torque = {{ min = -2, max = 2 }}
        tables.lift = {{ x = {knots:?}, values = {lift:?}, interpolation = "cubic", extrapolation = "periodic" }}
        bodies = {{ disk = {{ inertia = 0.001 }}, valve = {{ mass = "m" }} }}
        joints.camshaft = {{ type = "revolute", between = ["ground", "disk"] }}
        joints.follower = {{ type = "prismatic", between = ["ground", "valve"], axis = [0, 1] }}
        couplings.cam = {{ coordinate = "follower.position", follows = "lift(camshaft.angle)" }}
        springs.spring = {{ coordinate = "follower.position", stiffness = 900, damping = 3, rest = -0.005 }}
        outputs = {{ position = {{ measure = "follower.position" }}, effort = {{ measure = "cam.effort" }} }}
        {more}
    "#
    )
}

#[test]
fn the_lift_of_a_cam_and_its_derivatives_are_exact_in_equations_and_reactions() {
    let region = Region {
        coordinates: vec![QuantityRange::new("camshaft.angle", 0.0, TAU)],
        parameters: vec![QuantityRange::new("m", 0.1, 0.4)],
        outputs: named(&["effort"]),
        ..Region::default()
    };
    let free = cam("actuators.motor = { coordinate = \"camshaft.angle\", effort = \"torque\" }");
    let driven = cam("drivers.speed = { coordinate = \"camshaft.angle\", acceleration = \"100*torque\" }");
    for text in [free, driven] {
        let fitted = fit(&parse(&text), &region, 1).unwrap();
        let reactions = fitted.reactions.as_ref().unwrap();
        assert!(fitted.error < 1e-11 && reactions.error < 1e-11, "{:e} {:e}", fitted.error, reactions.error);
        let products = fitted.dynamics.function_set().dictionary().products();
        assert!(
            products < 20,
            "{products}: {:?}",
            fitted.dynamics.function_set().dictionary().terms().collect::<Vec<_>>()
        );
        for (q, v, m) in [(0.4, 30.0, 0.1), (2.9, -70.0, 0.33), (5.9, 5.0, 0.4)] {
            let state: [&[f64]; 4] = [&[q], &[v], &[1.3], &[m]];
            assert_exact(&text, &region, state, 1e-10);
            assert_alike(forces(&text, &region, state), 1e-9);
        }
    }
}

#[test]
fn a_long_chain_is_exact_in_the_proposed_coordinates() {
    let path = format!("{}/../examples/dynamics/parts/chain.toml", env!("CARGO_MANIFEST_DIR"));
    let text = &std::fs::read_to_string(path).unwrap();
    let mechanism = parse(text);
    let proposed = mechanism.free_coordinates().unwrap();
    let names: Vec<&str> = proposed.iter().map(|coordinate| coordinate.name.as_str()).collect();
    assert_eq!(names, ["j1.angle", "link2.angle", "link3.angle", "link4.angle", "link5.angle"]);
    let region = Region {
        coordinates: names.iter().map(|name| QuantityRange::new(name, -TAU / 2.0, TAU / 2.0)).collect(),
        parameters: vec![QuantityRange::new("m", 0.3, 0.8)],
        ..Region::default()
    };
    let (q, v) = ([0.4, -1.1, 2.3, 0.2, -2.9], [1.0, -2.0, 0.5, 3.0, -1.5]);
    assert_exact(text, &region, [&q, &v, &[1.3], &[0.45]], 1e-9);
    // three links have the angles of their joints
    let cut = text.find("[bodies.link4]").unwrap();
    let rest = text.find("[forces.push]").unwrap();
    let three = format!("{}{}", &text[..cut], text[rest..].replace("link5", "link3").replace("j5", "j3"));
    let proposed = parse(&three.replace("\"m\"", "0.5")).free_coordinates().unwrap();
    let names: Vec<&str> = proposed.iter().map(|coordinate| coordinate.name.as_str()).collect();
    assert_eq!(names, ["j1.angle", "j2.angle", "j3.angle"]);
}
