//! Drivers that prescribe accelerations, also by inputs, against equations with a separate integrator, and against
//! drivers of motions.

use super::*;
use crate::signal::{Signal, SineTerm};

/// A trolley of 2 kg whose acceleration is the input, with friction, and a load of `m` on a massless rope of length `l`.
pub const TROLLEY: &str = r#"
    gravity = [0, -9.81]
    parameters.l = { default = 1.5 }
    parameters.m = { default = 0.7 }
    inputs.a = { min = -3, max = 3, unit = "m/s2" }
    bodies.trolley = { mass = 2, inertia = 1 }
    bodies.load = { mass = "m", position = ["l*sin(0.3)", "-l*cos(0.3)"], angle = 0.3, points = { top = [0, "l"] } }
    joints.rail = { type = "prismatic", between = ["ground", "trolley"], axis = [1, 0] }
    joints.rope = { type = "revolute", between = ["trolley", "load.top"] }
    springs.bearing = { coordinate = "rail.position", damping = 0.4 }
    drivers.motor = { coordinate = "rail.position", acceleration = "a" }
    initial.rail = { position = 0, velocity = 0.2 }
    initial.rope = { angle = 0.3, angular_velocity = 0 }
    outputs.x = { measure = "rail.position" }
    outputs.theta = { measure = "rope.angle" }
    outputs.speed = { measure = "rope.angular_velocity" }
    outputs.effort = { measure = "motor.effort" }
"#;

/// Classical Runge-Kutta steps of order 4 from row to row, `h` long or less.
fn runge_kutta<const N: usize>(
    f: impl Fn(f64, [f64; N]) -> [f64; N],
    start: [f64; N],
    times: &[f64],
    h: f64,
) -> Vec<[f64; N]> {
    let mut rows = vec![start];
    for pair in times.windows(2) {
        let (count, mut y) = (((pair[1] - pair[0]) / h).ceil(), rows[rows.len() - 1]);
        let h = (pair[1] - pair[0]) / count;
        for step in 0..count as u32 {
            let t = pair[0] + f64::from(step) * h;
            let moved = |k: [f64; N], by: f64| std::array::from_fn(|i| y[i] + by * k[i]);
            let a = f(t, y);
            let b = f(t + 0.5 * h, moved(a, 0.5 * h));
            let c = f(t + 0.5 * h, moved(b, 0.5 * h));
            let d = f(t + h, moved(c, h));
            y = std::array::from_fn(|i| y[i] + h / 6.0 * (a[i] + 2.0 * b[i] + 2.0 * c[i] + d[i]));
        }
        rows.push(y);
    }
    rows
}

#[test]
fn a_load_below_a_trolley_that_is_accelerated_swings_as_the_textbook_says_and_the_motor_gives_newtons_force() {
    let sine = |amplitude, frequency, phase| SineTerm { amplitude, frequency, phase };
    let signal = Signal::Multisine { offset: 0.1, sines: vec![sine(1.5, 0.3, 0.4), sine(0.8, 0.9, 2.0)] };
    let times = grid(6.0, 60);
    let (l, m, g) = (1.5, 0.7, 9.81);
    let alpha = |a: f64, theta: f64| -(g * theta.sin() + a * theta.cos()) / l;
    let f = |t: f64, [_, v, theta, omega]: [f64; 4]| [v, signal.value(t), omega, alpha(signal.value(t), theta)];
    let expected = runge_kutta(f, [0.0, 0.2, 0.3, 0.0], &times, 1e-3);
    for mechanism in both_formulations(TROLLEY) {
        assert_eq!(mechanism.summary(), "2 bodies, 2 joints, 1 driver, 2 degrees of freedom");
        let signals = std::slice::from_ref(&signal);
        let rows = mechanism.simulate_driven(&[l, m], signals, &times, TOLERANCE, &Budget::default()).unwrap();
        let largest = rows.chunks(4).map(|row| row[1].abs()).fold(0.0, f64::max);
        assert!(largest > 0.4, "it swings: {largest}");
        for ((&t, row), [x, v, theta, omega]) in times.iter().zip(rows.chunks(4)).zip(&expected) {
            let a = signal.value(t);
            let load = m * (a + l * alpha(a, *theta) * theta.cos() - l * omega * omega * theta.sin());
            for (found, expected) in row.iter().zip([*x, *theta, *omega, 2.0 * a + load + 0.4 * v]) {
                assert!((found - expected).abs() < 1e-9, "{found} {expected} at {t}");
            }
        }
    }
}

#[test]
fn a_position_that_is_commanded_through_a_filter_follows_its_closed_form() {
    // x'' = w² (target - x) - 2 z w x'
    let text = TROLLEY.replace("acceleration = \"a\"", "acceleration = \"9*(a - rail.position) - 1.8*rail.velocity\"");
    let (target, w, z, times) = (1.2, 3.0f64, 0.3f64, grid(4.0, 40));
    let fast = w * (1.0 - z * z).sqrt();
    for mechanism in both_formulations(&text) {
        let signals = [Signal::Constant(target)];
        let rows = mechanism.simulate_driven(&[1.5, 0.7], &signals, &times, TOLERANCE, &Budget::default()).unwrap();
        for (t, row) in times.iter().zip(rows.chunks(4)) {
            // of a start at zero with a velocity of 0.2
            let sine = (0.2 - z * w * target) / fast;
            let expected = target + (-z * w * t).exp() * (sine * (fast * t).sin() - target * (fast * t).cos());
            assert!((row[0] - expected).abs() < 1e-9, "{} {expected} at {t}", row[0]);
        }
    }
}

/// The slider crank of the examples, turned by a driver in the place of its motor, with friction of the slider and reactions.
fn turned(driver: &str) -> String {
    let text = include_str!("../../../../examples/dynamics/slider-crank.toml");
    let motor = "[actuators.motor]\ncoordinate = \"A.angle\"\neffort = \"torque\"\n";
    assert!(text.contains(motor));
    let friction = "[actuators.friction]\ncoordinate = \"guide.position\"\neffort = \"-2*tanh(guide.velocity)\"\n";
    let text = text.replace(motor, &format!("{friction}[drivers.motor]\ncoordinate = \"A.angle\"\n{driver}\n"));
    let text = text.replace("torque = {", "alpha = {");
    format!(
        "{text}effort = {{ measure = \"motor.effort\" }}\nside = {{ measure = \"guide.fy\" }}\npin = {{ measure = \"B.fx\" }}\n"
    )
}

#[test]
fn a_closed_loop_whose_crank_is_accelerated_moves_and_pushes_as_one_whose_crank_has_that_motion() {
    // from 0.5 rad and 3 rad/s by 8 sin(2 t) rad/s²
    let by_motion = turned("motion = \"theta0 + (thetad0 + 4)*time - 2*sin(2*time)\"")
        .replace("A.angle = \"theta0\"\nA.angular_velocity = \"thetad0\"\n", "");
    let times = grid(3.0, 60);
    let run = |mechanism: &Mechanism| {
        mechanism.simulate(&values(mechanism, &[("c", 0.1)]), &times, TOLERANCE, &Budget::default()).unwrap()
    };
    let expected = run(&parse(&by_motion));
    let largest = expected.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
    assert!(expected[expected.len() - 4] > 2.0 * std::f64::consts::TAU, "it goes around");
    for mechanism in both_formulations(&turned("acceleration = \"8*sin(2*time)\"")) {
        for (found, expected) in run(&mechanism).iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-8 * (1.0 + largest), "{found} {expected}");
        }
    }
}

#[test]
fn drivers_of_both_kinds_have_efforts_of_their_own() {
    // an arm that turns at a constant rate, and a bead that is accelerated along it: the names are in an order of their own
    let text = r#"
        bodies.arm = { mass = 1, inertia = 0.1 }
        bodies.bead = { mass = 0.5, inertia = 0.001, position = [0.2, 0] }
        joints.pivot = { type = "revolute", between = ["ground", "arm"] }
        joints.slide = { type = "prismatic", between = ["arm", "bead"], axis = [1, 0] }
        drivers.push = { coordinate = "slide.position", acceleration = "0.6" }
        drivers.turn = { coordinate = "pivot.angle", motion = "2*time" }
        initial.slide = { position = 0.2, velocity = -0.1 }
        outputs.r = { measure = "slide.position" }
        outputs.force = { measure = "push.effort" }
        outputs.torque = { measure = "turn.effort" }
    "#;
    for mechanism in both_formulations(text) {
        assert_eq!(
            mechanism.outputs().iter().map(|output| output.unit.as_str()).collect::<Vec<_>>(),
            ["m", "N", "N.m"]
        );
        let times = grid(2.0, 20);
        let rows = mechanism.simulate(&[], &times, TOLERANCE, &Budget::default()).unwrap();
        for (t, row) in times.iter().zip(rows.chunks(3)) {
            let (r, v) = (0.2 - 0.1 * t + 0.3 * t * t, -0.1 + 0.6 * t);
            for (found, expected) in row.iter().zip([r, 0.5 * (0.6 - 4.0 * r), 0.5 * 2.0 * 2.0 * r * v]) {
                assert!((found - expected).abs() < 1e-10, "{found} {expected} at {t}");
            }
        }
    }
}

#[test]
fn what_is_driven_needs_no_mass() {
    let massless = TROLLEY.replace("bodies.trolley = { mass = 2, inertia = 1 }", "bodies.trolley = {}");
    let times = grid(2.0, 20);
    let rows = |text: &str| -> [Vec<f64>; 2] {
        both_formulations(text).map(|mechanism| {
            mechanism
                .simulate_driven(&[1.5, 0.7], &[Signal::Constant(1.0)], &times, TOLERANCE, &Budget::default())
                .unwrap()
        })
    };
    for (massless, with_mass) in rows(&massless).iter().zip(rows(TROLLEY)) {
        for (one, other) in massless.chunks(4).zip(with_mass.chunks(4)) {
            assert!((0..3).all(|k| (one[k] - other[k]).abs() < 1e-9), "{one:?} {other:?}");
            assert!((other[3] - one[3] - 2.0).abs() < 1e-9, "{one:?} {other:?}");
        }
    }
    // without the load and without the driver nothing decides how it moves
    let alone = r#"
        bodies.trolley = {}
        joints.rail = { type = "prismatic", between = ["ground", "trolley"], axis = [1, 0] }
        outputs.x = { measure = "rail.position" }
    "#;
    assert!(refused(alone).contains("bodies.trolley.mass: 0, expected more: the body can move without"));
    parse(&format!("{alone}\ndrivers.motor = {{ coordinate = \"rail.position\", acceleration = \"1\" }}"));
}

#[test]
fn mistakes_in_drivers_are_located_and_say_what_was_expected() {
    let driver = "drivers.motor = { coordinate = \"rail.position\", acceleration = \"a\" }";
    for (to, says) in [
        (
            "drivers.motor = { coordinate = \"rail.position\" }",
            "m.toml:11: drivers.motor: neither of `motion` and `acceleration`, expected one of them",
        ),
        (
            "drivers.motor = { coordinate = \"rail.position\", acceleration = \"a\", motion = \"time\" }",
            "drivers.motor: both of `motion` and `acceleration`, expected one of them",
        ),
        (
            "drivers.motor = { coordinate = \"rail.position\", acceleration = \"b\" }",
            "m.toml:11: drivers.motor.acceleration: `b`: no `b`, expected one of l, m, a, time",
        ),
        (
            "drivers.motor = { coordinate = \"rail.position\", acceleration = \"rope.angular_acceleration\" }",
            "drivers.motor.acceleration: `rope.angular_acceleration`: `rope.angular_acceleration` is neither a position nor a velocity",
        ),
        (
            "drivers.motor = { coordinate = \"rail.velocity\", acceleration = \"a\" }",
            "drivers.motor.coordinate: `rail.velocity` is not a position",
        ),
        (
            "drivers.motor = { coordinate = \"rail.position\", motion = \"a\" }",
            "drivers.motor.motion: `a`: no `a`, expected one of l, m, time",
        ),
        (
            "drivers.motor = { coordinate = \"trolley.y\", acceleration = \"a\" }",
            "m.toml:11: drivers.motor: `drivers.motor` depends on the joints and drivers before it",
        ),
    ] {
        assert!(TROLLEY.contains(driver));
        let message = refused(&TROLLEY.replace(driver, to));
        assert!(message.contains(says), "{to}: no `{says}` in\n{message}");
    }
    for second in ["acceleration = \"2*a\"", "motion = \"time\""] {
        let twice = format!("{driver}\n    drivers.other = {{ coordinate = \"trolley.x\", {second} }}");
        let message = refused(&TROLLEY.replace(driver, &twice));
        let says = "depends on the joints and drivers before it: it is redundant";
        assert!(message.contains("m.toml:1") && message.contains(says), "{message}");
    }
    // the square root of a negative input
    let rooted = parse(&TROLLEY.replace("acceleration = \"a\"", "acceleration = \"sqrt(a)\""));
    let run =
        rooted.simulate_driven(&[1.5, 0.7], &[Signal::Constant(-1.0)], &grid(1.0, 5), TOLERANCE, &Budget::default());
    assert_eq!(run.unwrap_err().message, "`sqrt(a)` of `drivers.motor` is NaN at t = 0 s, expected a finite number");
}

#[test]
fn a_driver_that_comes_to_a_singular_position_is_named() {
    // the slider of a crank is accelerated to where the crank and the rod are in line
    let text = turned("acceleration = \"2\"").replace("\"A.angle\"\nacceleration", "\"guide.position\"\nacceleration");
    let text = text.replace("A.angular_velocity = \"thetad0\"", "A.angular_velocity = 0");
    for mechanism in both_formulations(&text) {
        let error =
            mechanism.simulate(&values(&mechanism, &[]), &grid(2.0, 100), TOLERANCE, &Budget::default()).unwrap_err();
        assert_eq!((error.cause, error.part.as_deref()), (MotionCause::Singular, Some("drivers.motor")), "{error}");
    }
}
