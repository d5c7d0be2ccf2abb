use super::*;
use crate::integrate::{Budget, TOLERANCE, integrate};
use metafmu_runtime::StatePoint;
use nalgebra::Vector2;
use std::{f64::consts::TAU, path::Path};

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
        coordinates: vec![Range::new("rail.position", -5.0, 5.0), Range::new("rope.angle", -TAU / 2.0, TAU / 2.0)],
        parameters: vec![Range::new("l", 1.0, 2.0), Range::new("m", 0.5, 1.5), Range::new("b", 0.0, 0.5)],
        ..Region::default()
    }
}

#[test]
fn a_tree_mechanism_is_learned_exactly() {
    let mechanism = parse(CRANE);
    let fitted = fit(&mechanism, &crane_region(), 1).unwrap();
    assert!(fitted.error < 1e-12, "{:e}", fitted.error);
    let (q, v, u, p) = ([3.0, 0.7], [1.5, -2.0], [12.0], [1.3, 0.8, 0.2]);
    let mut found = [0.0; 2];
    fitted.dynamics.accelerations(
        StatePoint { q: &q, v: &v, u: &u, p: &p },
        &mut found,
        &mut fitted.dynamics.scratch(),
    );
    let reduced = mechanism.reduced(&p, &["rail.position", "rope.angle"]).unwrap();
    let exact = reduced.accelerations(&q.to_vec().into(), &v.to_vec().into(), &u).unwrap();
    for (found, exact) in found.iter().zip(&exact) {
        assert!((found - exact).abs() < 1e-11, "{found} {exact}");
    }
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
    let region = Region { coordinates: vec![Range::new("K1.angle", start, start + TAU)], ..Region::default() };
    let fitted = fit(&parse(text), &region, 1).unwrap();
    let mut accelerations = [0.0];
    let mut scratch = fitted.dynamics.scratch();
    let mut derivative = |y: &Vector2<f64>| {
        let point = StatePoint { q: &[y[0]], v: &[y[1]], u: &[0.033], p: &[] };
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
    let message = |text: &str, region: &Region| fit(&parse(text), region, 1).unwrap_err();
    let region = crane_region();
    let with = |change: &dyn Fn(&mut Region)| {
        let mut region = region.clone();
        change(&mut region);
        region
    };
    let rooted = CRANE.replace("-b * rail.velocity", "-sqrt(rail.velocity)");
    assert!(message(&rooted, &region).ends_with("a force is not a number at some velocities"));
    let rooted = CRANE.replace("effort = \"force\"", "effort = \"sqrt(force)\"");
    assert!(message(&rooted, &region).ends_with("the forces are not linear in the input `force`"));
    let far = with(&|region| region.coordinates[0].max = 1e9);
    assert!(message(CRANE, &far).ends_with("more than 10000 rad or m from the start"));
    let unknown = with(&|region| region.parameters[0].name = "length".into());
    assert_eq!(message(CRANE, &unknown), "the mechanism has no parameter `length`");
    let empty = with(&|region| region.coordinates[0].max = -5.0);
    assert_eq!(message(CRANE, &empty), "`rail.position`: range from -5 to -5, expected an end above the beginning");
    let idle = CRANE.replace("[0, \"-l\"]", "[\"l*sin(b)\", \"-l*cos(b)\"]").replace("-b * rail", "-0.1 * rail");
    assert_eq!(check(&parse(CRANE), &region, 1).unwrap(), [""; 0]);
    assert_eq!(check(&parse(&idle), &region, 1).unwrap(), ["b"]);
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
fn forces_that_are_not_linear_in_the_velocities_are_what_the_equations_leave_out() {
    let mechanism = parse(&rough_crane());
    let region = Region { velocities: vec![[-2.0, 2.0], [-3.0, 3.0]], inputs: vec![[-20.0, 20.0]], ..crane_region() };
    assert!(!fit(&parse(CRANE), &region, 1).unwrap().has_other_forces);
    let fitted = fit(&mechanism, &region, 1).unwrap();
    assert!(fitted.has_other_forces && fitted.error < 1e-12, "{:e}", fitted.error);
    let equations = Equations::new(&mechanism, &region).unwrap();
    let samples = equations.other_forces(50, 1).unwrap();
    for (point, forces) in samples.points.iter().zip(&samples.labels) {
        let [_, _, _, _, b, v, _, u] = point[..] else { panic!("{point:?}") };
        // the damping is that between the ends of the velocity
        let expected = -b * (v / 0.05).tanh() + b * (2.0f64 / 0.05).tanh() / 2.0 * v - 0.1 * u * v;
        assert!((forces[0] - expected).abs() < 1e-11 && forces[1].abs() < 1e-11, "{forces:?} {expected}");
    }
    // of x, theta, l, m, b, the two velocities and the force
    let depends = equations.dependencies_of_forces(&samples).unwrap();
    assert_eq!(depends, [false, false, false, false, true, true, false, true]);
    let without = Region { velocities: Vec::new(), ..region };
    assert!(Equations::new(&mechanism, &without).is_err());
}

#[test]
fn gradients_of_the_functions_are_those_of_finite_differences() {
    let text = include_str!("../../../examples/dynamics/slider-crank.toml");
    let mechanism = parse(text);
    let free = mechanism.free_coordinates().unwrap().remove(0).name;
    let outputs = mechanism.outputs().iter().map(|output| output.name.clone()).collect();
    let coordinates = vec![Range::new(&free, 0.0, TAU)];
    let region = Region { coordinates, outputs, inputs: vec![[-1.0, 1.0]], ..Region::default() };
    let labels = Labels::new(&mechanism, &region).unwrap();
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
    let region = |end: f64| Region { coordinates: vec![Range::new("A.angle", 0.0, end)], ..Region::default() };
    let message = fit(&parse(text), &region(TAU), 1).unwrap_err();
    assert!(message.starts_with("at A.angle = ") && message.contains("do not decide the others"), "{message}");
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
fn a_closed_loop_is_put_together_at_any_coordinate() {
    let text = include_str!("../../../examples/dynamics/slider-crank.toml");
    let mechanism = parse(&format!("{text}x = {{ measure = \"slider.x\" }}\nspeed = {{ measure = \"slider.vx\" }}\n"));
    let region = Region {
        coordinates: vec![Range::new("A.angle", 0.0, TAU)],
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
