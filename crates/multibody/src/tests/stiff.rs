//! Stiff mechanisms against closed forms, in both formulations.

use super::*;
use crate::signal::{Knots, Signal};

#[track_caller]
fn assert_close(found: f64, expected: f64, bound: f64) {
    assert!((found - expected).abs() <= bound, "{found} {expected}");
}

/// A mass `m` in a damper `c`, pushed by a force `f` that jumps: `m v' = f - c v`. A second mass hangs on a soft spring.
const DASHPOT: &str = r#"
    parameters = { m = { default = 40 }, c = { default = 1e7 } }
    inputs.f = { min = -1e6, max = 1e6 }
    bodies.block = { mass = "m", inertia = 1 }
    bodies.load = { mass = 2, inertia = 1 }
    joints.b = { type = "prismatic", between = ["ground", "block"], axis = [1, 0] }
    joints.l = { type = "prismatic", between = ["ground", "load"], axis = [0, 1] }
    springs.pot = { coordinate = "b.position", damping = "c" }
    springs.soft = { coordinate = "l.position", stiffness = 50 }
    actuators.push = { coordinate = "b.position", effort = "f" }
    initial = { b = { position = 0.1, velocity = 3 }, l = { position = 0.2, velocity = 0 } }
    outputs = { x = { measure = "block.x" }, v = { measure = "block.vx" }, y = { measure = "load.y" } }
"#;

/// The rows of the closed form, with forces that jump at rows.
fn dashpot([m, c]: [f64; 2], forces: &[f64], step: f64) -> Vec<[f64; 3]> {
    let (mut x, mut v) = (0.1, 3.0);
    let mut rows = vec![[x, v, 0.2]];
    for (row, f) in forces.iter().enumerate() {
        let (last, decay) = (f / c, (-c / m * step).exp());
        x += last * step + (v - last) * m / c * -(-c / m * step).exp_m1();
        v = last + (v - last) * decay;
        rows.push([x, v, 0.2 * (5.0 * step * (row + 1) as f64).cos()]);
    }
    rows
}

#[test]
fn a_block_in_a_stiff_damper_follows_forces_that_jump() {
    let forces: Vec<f64> = (0..40).map(|row| 3e5 * f64::from(row * 7 % 11 - 5)).collect();
    let times = grid(4.0, 41);
    let step = times[1];
    let signal = Signal::Held(Knots::new(times[..40].to_vec(), forces.clone()).unwrap());
    for mechanism in both_formulations(DASHPOT) {
        // 250000 / s with a run of 4 s: the explicit method would take two million evaluations
        for (constants, tolerance) in [([40.0, 1e7], TOLERANCE), ([40.0, 1e7], 1e-9), ([1e-3, 1e5], 1e-12)] {
            let signals = [signal.clone()];
            let budget = Budget::default();
            let found = mechanism.simulate_driven(&constants, &signals, &times, tolerance, &budget).unwrap();
            let expected = dashpot(constants, &forces, step);
            for (row, expected) in found.chunks(3).zip(&expected) {
                for (found, expected) in row.iter().zip(expected) {
                    assert_close(*found, *expected, 20.0 * tolerance.max(1e-13));
                }
            }
            assert!(budget.spent() < 120_000, "{} evaluations", budget.spent());
        }
    }
}

#[test]
fn steps_of_a_stepper_become_implicit_as_well() {
    let mechanism = parse(DASHPOT);
    let mut stepper = mechanism.stepper(&[40.0, 1e7], &[0.0], 0.0, 1e-12).unwrap();
    let forces: Vec<f64> = (0..20).map(|row| 1e5 * f64::from(row * 5 % 7 - 3)).collect();
    let expected = dashpot([40.0, 1e7], &forces, 0.1);
    for (row, force) in forces.iter().enumerate() {
        stepper.set_inputs(&[*force]).unwrap();
        stepper.advance(0.1 * (row + 1) as f64).unwrap();
        for (found, expected) in stepper.outputs().iter().zip(expected[row + 1]) {
            assert_close(*found, expected, 1e-11);
        }
    }
}

/// A first-order actuator of 1 ns pushes a mass: `current = u (1 - exp(-t / tau))`.
#[test]
fn an_actuator_state_of_a_nanosecond_is_integrated() {
    let text = r#"
        inputs.u = { min = -5, max = 5, start = 1 }
        states.current = { rate = "(u - current)/1e-9" }
        bodies.a = { mass = 1, inertia = 1 }
        joints.p = { type = "revolute", between = ["ground", "a"] }
        actuators.m = { coordinate = "p.angle", effort = "current" }
        outputs = { i = { measure = "current" }, angle = { measure = "p.angle" } }
    "#;
    for mechanism in both_formulations(text) {
        let times = grid(10.0, 3);
        let rows = mechanism.simulate(&[], &times, TOLERANCE, &Budget::default()).unwrap();
        for (row, t) in rows.chunks(2).zip(&times) {
            assert_close(row[0], if *t > 0.0 { 1.0 } else { 0.0 }, 1e-12);
            // the current begins a nanosecond late
            assert_close(row[1], 0.5 * t * t - 1e-9 * t, 1e-10);
        }
    }
}

/// Wheel on a stiff bushing that turns about a pivot: the loop's dependent coordinates, a table with bends, and an input in one mechanism.
#[test]
fn tables_and_loops_are_as_exact_as_with_the_explicit_method() {
    let text = |damping: &str| {
        format!(
            r#"
        gravity = [0, -9.81]
        inputs.u = {{ min = -5, max = 5 }}
        tables.valve = {{ x = [-1, -0.1, 0, 0.1, 1], values = [-9, -5, 0, 5, 9], extrapolation = "linear" }}
        bodies.arm = {{ mass = 1, inertia = 0.1, angle = 0.3, points = {{ a = [-0.5, 0], b = [0.5, 0] }} }}
        bodies.tip = {{ mass = 0.01, inertia = 1e-4, angle = 0.3, points = {{ a = [-0.1, 0] }} }}
        joints.pivot = {{ type = "revolute", between = ["ground", "arm.a"] }}
        joints.hinge = {{ type = "revolute", between = ["arm.b", "tip.a"] }}
        springs.pad = {{ coordinate = "hinge.angle", stiffness = 2, damping = {damping} }}
        actuators.motor = {{ coordinate = "pivot.angle", effort = "valve(u - pivot.angular_velocity)" }}
        initial = {{ arm.angle = 0.3, hinge.angle = 0.1 }}
        outputs = {{ a = {{ measure = "arm.angle" }}, h = {{ measure = "hinge.angle" }} }}
    "#
        )
    };
    let signal = Signal::Linear(Knots::new(vec![0.0, 0.5, 1.0], vec![0.0, 4.0, -3.0]).unwrap());
    let times = grid(1.0, 11);
    let run = |mechanism: &Mechanism| {
        let budget = Budget::default();
        let rows = mechanism.simulate_driven(&[], std::slice::from_ref(&signal), &times, 1e-11, &budget).unwrap();
        (rows, budget.spent())
    };
    // a hinge so viscous that it does not turn in a second is nearly welded: two formulations agree
    let [first, second] = both_formulations(&text("100")).map(|mechanism| run(&mechanism));
    for (one, other) in first.0.iter().zip(&second.0) {
        assert_close(*one, *other, 1e-9);
    }
    assert!(first.1.max(second.1) < 100_000, "{} {}", first.1, second.1);
}
