use super::*;
use crate::{
    Mechanism,
    formulation::augmented,
    integrate::{Budget, TOLERANCE, integrate},
    signal::{Signal, SineTerm},
};
use nalgebra::Vector2;
use std::{f64::consts::TAU, path::Path};

/// A cart of 2 kg that a motor pushes, and a load of 1 kg on a massless rope of length `l`.
const CRANE: &str = r#"
    gravity = [0, -9.81]
    parameters.l = { default = 1.5 }
    inputs.force = { min = -20, max = 20, unit = "N" }
    ground.points.rail = [0, 0]
    bodies.cart = { mass = 2, inertia = 1 }
    bodies.load = { mass = 1, position = [0, "-l"], points = { top = [0, "l"] } }
    joints.rail = { type = "prismatic", between = ["ground.rail", "cart"], axis = [1, 0] }
    joints.rope = { type = "revolute", between = ["cart", "load.top"] }
    actuators.motor = { coordinate = "rail.position", effort = "force" }
    actuators.friction = { coordinate = "rail.position", effort = "-0.3 * rail.velocity" }
    outputs.x = { measure = "rail.position" }
    outputs.angle = { measure = "rope.angle" }
"#;

fn parse(text: &str) -> Mechanism {
    Mechanism::parse(text, Path::new("m.toml")).unwrap()
}

fn reduced(text: &str, coordinates: &[&str]) -> Result<Reduced, MotionError> {
    let mechanism = parse(text);
    let defaults: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
    mechanism.reduced(&defaults, coordinates)
}

fn vector(values: &[f64]) -> DVector<f64> {
    DVector::from_column_slice(values)
}

/// The crane with the acceleration of its cart, and the slider crank with that of its crank, as inputs.
fn accelerated() -> [String; 2] {
    let crane = CRANE
        .replace("actuators.motor = {", "drivers.motor = {")
        .replace("effort = \"force\"", "acceleration = \"force * cos(rope.angle) - 0.2 * rope.angular_velocity\"");
    let slider_crank = include_str!("../../../../examples/dynamics/slider-crank.toml");
    let slider_crank = slider_crank.replace("[actuators.motor]", "[drivers.motor]");
    [crane, slider_crank.replace("effort = \"torque\"", "acceleration = \"torque - 0.1*slider.vx\"")]
}

/// Mechanisms without prescribed motion, with closed loops and without, and states of them.
fn states() -> Vec<(Reduced, [Vec<f64>; 3])> {
    let double = include_str!("../../../../examples/mechanisms/double-pendulum.toml");
    let four_bar = include_str!("../../../../examples/mechanisms/four-bar.toml");
    let car = include_str!("../../../../examples/mechanisms/quarter-car.toml");
    let andrews = include_str!("../../../../examples/dynamics/andrews.toml");
    let [driven_crane, slider_crank] = accelerated();
    let of_crane = [vec![0.7, -0.4], vec![1.1, -2.3], vec![5.0]];
    let mut states = vec![
        (reduced(CRANE, &[]).unwrap(), of_crane.clone()),
        (reduced(&driven_crane, &[]).unwrap(), of_crane),
        (reduced(&slider_crank, &[]).unwrap(), [vec![1.9], vec![4.0], vec![0.8]]),
    ];
    for (text, s, rates, u) in [
        (double, vec![0.9, -0.3], vec![1.3, 2.1], vec![]),
        (four_bar, vec![2.5], vec![3.0], vec![]),
        (andrews, vec![1.0], vec![300.0], vec![0.033]),
        (car, vec![0.02, -0.01], vec![0.3, 1.2], vec![]),
    ] {
        if let Ok(reduced) = reduced(text, &[]) {
            states.push((reduced, [s, rates, u]));
        }
    }
    assert!(states.len() >= 6, "{}", states.len());
    states
}

#[test]
fn accelerations_are_those_of_the_augmented_formulation() {
    for (mut reduced, [s, rates, u]) in states() {
        let (s, rates) = (vector(&s), vector(&rates));
        let found = reduced.accelerations(&reduced.terms(&s).unwrap(), &rates, &u).unwrap();
        reduced.model.inputs.iter_mut().zip(&u).for_each(|(input, u)| input.signal = Signal::Constant(*u));
        let terms = reduced.terms(&s).unwrap();
        let v = &terms.velocities * &rates;
        let qdd = augmented(&reduced.model, 0.0, (&terms.q, &v), &reduced.model.at(0.0, &[])).unwrap().qdd;
        for (coordinate, found) in reduced.coordinates.iter().zip(&found) {
            let expected = coordinate.rate(&terms.q, &qdd) + coordinate.curvature(&terms.q, &v);
            assert!((found - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{coordinate:?}: {found} {expected}");
        }
    }
}

#[test]
fn multipliers_from_accelerations_are_those_of_the_augmented_formulation() {
    for (mut reduced, [s, rates, u]) in states() {
        let (s, rates) = (vector(&s), vector(&rates));
        let terms = reduced.terms(&s).unwrap();
        let accelerations = reduced.accelerations(&reduced.terms(&s).unwrap(), &rates, &u).unwrap();
        let products = (0..s.len()).flat_map(|j| (0..=j).map(move |k| (j, k))).map(|(j, k)| rates[j] * rates[k]);
        let factors = DVector::from_vec(accelerations.iter().copied().chain(products).collect());
        let forces = reduced.applied_forces(&terms, &rates, &u) + reduced.inertia_forces(&terms) * factors;
        let found = reduced.balance(&terms, &DMatrix::from_columns(&[forces])).unwrap();
        reduced.model.inputs.iter_mut().zip(&u).for_each(|(input, u)| input.signal = Signal::Constant(*u));
        let expected =
            augmented(&reduced.model, 0.0, (&terms.q, &(&terms.velocities * &rates)), &reduced.model.at(0.0, &[]))
                .unwrap()
                .multipliers;
        let largest = expected.amax();
        let multipliers = reduced.multipliers(found.column(0));
        assert_eq!(multipliers.len(), expected.len());
        for (found, expected) in multipliers.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-9 * (1.0 + largest), "{found} {expected}");
        }
        // accelerations are those of the equations, so that nothing else is needed
        let rest = found.rows(reduced.model.constraints.len(), s.len());
        let free = (0..s.len()).filter(|k| !reduced.driven().contains(k)).map(|k| rest[k].abs());
        assert!(free.fold(0.0, f64::max) < 1e-9 * (1.0 + largest), "{found}");
    }
}

#[test]
fn derivatives_of_the_mass_matrix_are_those_of_finite_differences() {
    for (reduced, [s, ..]) in states() {
        let s = vector(&s);
        let terms = reduced.terms(&s).unwrap();
        for k in 0..s.len() {
            let step = 1e-5;
            let moved = |sign: f64| {
                let mut s = s.clone();
                s[k] += sign * step;
                reduced.terms(&s).unwrap()
            };
            let (after, before) = (moved(1.0), moved(-1.0));
            let expected = (&after.mass - &before.mass) / (2.0 * step);
            let error = (&terms.mass_gradient[k] - &expected).amax();
            assert!(error < 1e-8 * (terms.mass.amax() + expected.amax()), "{k}: {error:e}");
            // what gravity and springs do is in the potential
            let slope = (after.potential - before.potential) / (2.0 * step);
            let found = terms.potential_force[k];
            assert!((found + slope).abs() < 1e-7 * (1.0 + terms.potential_force.amax()), "{k}: {found} {slope}");
        }
    }
}

#[test]
fn the_crane_has_the_textbook_equations() {
    let reduced = reduced(CRANE, &[]).unwrap();
    let ([x, theta], [xd, thetad], force, l) = ([0.7, -0.4], [1.1, -2.3], 5.0, 1.5);
    let terms = reduced.terms(&vector(&[x, theta])).unwrap();
    let (sine, cosine) = f64::sin_cos(theta);
    assert!((terms.mass[(0, 0)] - 3.0).abs() < 1e-14 && (terms.mass[(1, 1)] - l * l).abs() < 1e-14);
    assert!((terms.mass[(0, 1)] - l * cosine).abs() < 1e-14);
    assert!((terms.effort_map[(0, 0)] - 1.0).abs() < 1e-14 && terms.effort_map[(1, 0)].abs() < 1e-14);
    let found =
        reduced.accelerations(&reduced.terms(&vector(&[x, theta])).unwrap(), &vector(&[xd, thetad]), &[force]).unwrap();
    // (M + m) xdd + m l thetadd cos - m l thetad² sin = u - b xd;  l thetadd + xdd cos + g sin = 0
    let side = force - 0.3 * xd + l * thetad * thetad * sine + 9.81 * sine * cosine;
    let xdd = side / (3.0 - cosine * cosine);
    let thetadd = -(xdd * cosine + 9.81 * sine) / l;
    assert!((found[0] - xdd).abs() < 1e-12 && (found[1] - thetadd).abs() < 1e-12, "{found} {xdd} {thetadd}");
}

#[test]
fn a_driven_run_is_the_solution_of_the_reduced_equations() {
    let mechanism = parse(CRANE);
    let sine = |amplitude, frequency, phase| SineTerm { amplitude, frequency, phase };
    let signal = Signal::Multisine { offset: 1.0, sines: vec![sine(8.0, 0.4, 0.3), sine(4.0, 1.1, 2.0)] };
    let times: Vec<f64> = (0..=50).map(|i| 0.1 * f64::from(i)).collect();
    let rows = mechanism
        .simulate_driven(&[1.5], std::slice::from_ref(&signal), &times, TOLERANCE, &Budget::default())
        .unwrap();
    let reduced = mechanism.reduced(&[1.5], &["rail.position", "rope.angle"]).unwrap();
    let derivative = |y: &nalgebra::SVector<f64, 5>| {
        let (s, rates) = (vector(&[y[0], y[1]]), vector(&[y[2], y[3]]));
        let a = reduced.accelerations(&reduced.terms(&s).unwrap(), &rates, &[signal.value(y[4])]).unwrap();
        nalgebra::SVector::from([y[2], y[3], a[0], a[1], 1.0])
    };
    let states =
        integrate(derivative, nalgebra::SVector::from([0.0; 5]), &times, TOLERANCE, &Budget::default()).unwrap();
    let largest = rows.iter().copied().fold(0.0, f64::max);
    assert!(largest > 5.0, "the crane is pushed: {largest}");
    for (row, state) in rows.chunks(2).zip(&states) {
        assert!((row[0] - state[0]).abs() < 1e-9 && (row[1] - state[1]).abs() < 1e-9, "{row:?} {state}");
    }
}

#[test]
fn andrews_mechanism_is_one_equation_in_its_crank_angle() {
    let mechanism = parse(include_str!("../../../../examples/dynamics/andrews.toml"));
    let reduced = mechanism.reduced(&[4530.0], &[]).unwrap();
    let derivative = |y: &Vector2<f64>| {
        let acceleration =
            reduced.accelerations(&reduced.terms(&vector(&[y[0]])).unwrap(), &vector(&[y[1]]), &[0.033]).unwrap();
        Vector2::new(y[1], acceleration[0])
    };
    let (s, rates) = reduced.start();
    let initial = Vector2::new(s[0], rates[0]);
    assert!((derivative(&initial)[1] - 14222.4439199541).abs() < 1e-7);
    // 2.5 turns; the reference is as in the test of whole runs
    let states = integrate(derivative, initial, &[0.0, 0.03], TOLERANCE, &Budget::default()).unwrap();
    assert!((states[1][0] - 15.810771195153).abs() < 1e-9, "{}", states[1][0]);
    assert!((states[1][1] - 1139.92030225).abs() < 1e-6, "{}", states[1][1]);
}

#[test]
fn a_crank_is_followed_around_on_the_same_assembly() {
    let mechanism = parse(include_str!("../../../../examples/dynamics/andrews.toml"));
    let reduced = mechanism.reduced(&[4530.0], &[]).unwrap();
    let start = reduced.start().0[0];
    let first = reduced.configuration(&vector(&[start + 1.0])).unwrap();
    for turns in [1.0, 3.0, -2.0] {
        let again = reduced.configuration(&vector(&[start + 1.0 + turns * TAU])).unwrap();
        for (index, (one, other)) in first.iter().zip(&again).enumerate() {
            // the crank's own angle has gone around
            let around = ((other - one) / TAU).round() * TAU;
            assert!((other - one - around).abs() < 1e-11, "coordinate {index} after {turns} turns: {one} {other}");
        }
    }
}

#[test]
fn what_has_no_such_equations_is_refused() {
    let refused = |text: &str, coordinates: &[&str]| reduced(text, coordinates).unwrap_err().message;
    let driven = CRANE.replacen(
        "[\"cart\", \"load.top\"] }",
        "[\"cart\", \"load.top\"] }\n    drivers.swing = { coordinate = \"rope.angle\", motion = \"sin(time)\" }",
        1,
    );
    assert_eq!(refused(&driven, &[]), "`drivers.swing` prescribes the motion `sin(time)`, expected an `acceleration`");
    let timed = CRANE.replace("\"-0.3 * rail.velocity\"", "\"sin(2 * time)\"");
    assert_eq!(refused(&timed, &[]), "the force `sin(2 * time)` of `actuators.friction` depends on time");
    assert_eq!(refused(CRANE, &["rail.position"]), "1 coordinate, expected 2: one for each degree of freedom");
    let same = refused(CRANE, &["rail.position", "cart.x"]);
    assert_eq!(same, "only 1 of 2 coordinates are independent, expected 2: as many as there are degrees of freedom");
    let unknown = refused(CRANE, &["rail.position", "rope.force"]);
    assert!(unknown.starts_with("rope.force: `rope` has no `force`"), "{unknown}");
    let [driven, _] = accelerated();
    assert_eq!(
        refused(&driven, &["cart.y", "rope.angle"]),
        "only 1 of 2 coordinates are independent, expected 2: as many as there are degrees of freedom"
    );
    assert_eq!(
        refused(&driven, &["load.x", "rope.angle"]),
        "`drivers.motor` gives the acceleration of `rail.position`, expected that among the coordinates"
    );
    let timed = driven.replace("\"force * cos", "\"time * cos");
    let expected =
        "the acceleration `time * cos(rope.angle) - 0.2 * rope.angular_velocity` of `drivers.motor` depends on time";
    assert_eq!(refused(&timed, &[]), expected);
}

#[test]
fn inputs_are_checked_when_the_file_is_read() {
    let problems = |from: &str, to: &str| {
        Mechanism::parse(&CRANE.replacen(from, to, 1), Path::new("m.toml")).unwrap_err().to_string()
    };
    for (from, to, expected) in [
        ("min = -20", "min = 30", "inputs.force.min: range is empty: min 30 is not below max 20"),
        ("min = -20", "start = 21, min = -20", "inputs.force.start: 21 is outside the range from -20 to 20"),
        ("inputs.force", "inputs.l", "inputs.l: `l` is the name of parameters already"),
        ("inputs.force", "inputs.time", "inputs.time: `time` is the name of the time already"),
        ("outputs.x", "outputs.force", "outputs.force: `force` is an input already: names of variables must be unique"),
        (
            "effort = \"force\"",
            "effort = \"forse\"",
            "no `forse`, expected one of l, force, time; did you mean `force`?",
        ),
        ("mass = 2", "mass = \"force\"", "no parameter `force`"),
    ] {
        let found = problems(from, to);
        assert!(found.contains(expected), "{to}: {found}");
    }
    let idle = parse(&CRANE.replacen("effort = \"force\"", "effort = \"3\"", 1));
    let warnings: Vec<String> = idle.warnings().iter().map(ToString::to_string).collect();
    assert!(
        warnings.iter().any(|one| one.ends_with("inputs.force: no force, effort or acceleration depends on it")),
        "{warnings:?}"
    );
}
