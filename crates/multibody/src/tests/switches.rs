//! Forces and motions that are formulas of time, with pulses that are narrow beside the rows, against closed forms.

use super::*;

/// A rotor whose torque is a pulse, and a weight on a soft spring in another plane of motion.
fn rotor(effort: &str) -> String {
    format!(
        r#"
        parameters = {{ at = {{ default = 0.5 }}, width = {{ default = 1e-3 }} }}
        bodies.rotor = {{ mass = 1, inertia = 2 }}
        bodies.load = {{ mass = 2, inertia = 1 }}
        joints.shaft = {{ type = "revolute", between = ["ground", "rotor"] }}
        joints.l = {{ type = "prismatic", between = ["ground", "load"], axis = [0, 1] }}
        springs.soft = {{ coordinate = "l.position", stiffness = 50 }}
        actuators.motor = {{ coordinate = "shaft.angle", effort = "{effort}" }}
        initial.l = {{ position = 0.2 }}
        outputs.speed = {{ measure = "shaft.angular_velocity" }}
        outputs.angle = {{ measure = "shaft.angle" }}
        outputs.load = {{ measure = "load.y" }}
    "#
    )
}

/// Pulses of height 1000 whose center is `at`, with the integral over their height and width.
fn pulses() -> [(&'static str, f64); 7] {
    [
        ("1000*(step(time, at - width/2, 0, at - 0.4*width, 1) - step(time, at + 0.4*width, 0, at + width/2, 1))", 0.9),
        ("1000*max(0, 1 - abs(time - at)/width)", 1.0),
        ("500*(sign(time - at + width/2) - sign(time - at - width/2))", 1.0),
        ("1000*(floor(min(1.5, time/(at - width/2))) - floor(min(1.5, time/(at + width/2))))", 1.0),
        ("1000*min(1, max(0, 2 - 4*abs(mod(time, 3) - at)/width))", 0.75),
        ("500*(tanh(200*(time - at + width/2)/width) - tanh(200*(time - at - width/2)/width))", 1.0),
        ("1000*exp(-((time - at)/width)^2)", std::f64::consts::PI.sqrt()),
    ]
}

#[test]
fn narrow_pulses_have_the_impulse_of_their_closed_form_wherever_they_are() {
    for (text, area) in pulses() {
        for mechanism in both_formulations(&rotor(text)) {
            for (at, width, rows) in
                [(0.5, 1e-3, 3), (0.731_234, 1e-4, 21), (0.05, 1e-2, 201), (1.2345, 1e-4, 2), (1.9, 9e-4, 21)]
            {
                let values = [at, width];
                let found = mechanism.simulate(&values, &grid(2.0, rows), 1e-12, &Budget::default()).unwrap();
                let &[speed, angle, load] = &found[found.len() - 3..] else { panic!() };
                let expected = 1000.0 * area * width / 2.0;
                assert_close(speed, expected, 1e-10);
                assert_close(angle, expected * (2.0 - at), 1e-10);
                assert_close(load, 0.2 * 10.0f64.cos(), 1e-9);
            }
        }
    }
}

/// Torques of an angle with pulses that are narrow beside the rows, and their energies.
fn torques_of_an_angle() -> [(&'static str, f64); 8] {
    [
        ("500*max(0, 1 - abs(shaft.angle - at)/width)", 0.5),
        ("500*(step(shaft.angle, at, 0, at + width/9, 1) - step(shaft.angle, at + width, 0, at + width*10/9, 1))", 0.5),
        ("250*(sign(shaft.angle - at + width/2) - sign(shaft.angle - at - width/2))", 0.5),
        ("250*(tanh((shaft.angle - at)*50/width) - tanh((shaft.angle - at - width)*50/width))", 0.5),
        ("500*exp(-((shaft.angle - at)/width)^2)", 0.5 * std::f64::consts::PI.sqrt()),
        ("500/(1 + ((shaft.angle - at)/width)^4)^2", 0.375 * std::f64::consts::PI / 2.0f64.sqrt()),
        ("500*max(0, 1 - abs(mod(shaft.angle, 3) - at)/width)", 0.5),
        // in two dimensions: the shaft passes the middle of a disk that the load moves little
        ("500*exp(-((shaft.angle - at)^2 + (1e-9*l.velocity)^2)/width^2)", 0.5 * std::f64::consts::PI.sqrt()),
    ]
}

#[test]
fn narrow_torques_of_an_angle_give_their_energy() {
    for (text, energy) in torques_of_an_angle() {
        let start = "initial.shaft = { angular_velocity = 1 }";
        let mechanism = parse(&format!("{}{start}\n", rotor(text)));
        for (at, width, rows) in [(0.5, 1e-3, 3), (0.731_234, 1e-4, 21), (1.2345, 1e-3, 5)] {
            let found = mechanism.simulate(&[at, width], &grid(2.0, rows), 1e-12, &Budget::default()).unwrap();
            // an inertia of 2 kg.m²
            let expected = (1.0 + 1000.0 * energy * width).sqrt();
            assert!((found[found.len() - 3] - expected).abs() < 1e-7, "{text}: {} {expected}", found[found.len() - 3]);
        }
    }
}

#[test]
fn trains_of_pulses_are_followed_pulse_by_pulse() {
    // a pulse of 0.1 ms every 10 ms, with ramps of 10 us, in each of 200 periods
    let phase = "mod(time, 0.01)";
    let edge = |at: f64| format!("step({phase}, {at}, 0, {}, 1)", at + 1e-5);
    let text = format!("1000*({} - {})", edge(0.005), edge(0.0051));
    for mechanism in both_formulations(&rotor(&text)) {
        let values = values(&mechanism, &[]);
        let found = mechanism.simulate(&values, &grid(2.0, 21), 1e-12, &Budget::default()).unwrap();
        assert_close(found[found.len() - 3], 200.0 * 1000.0 * 1e-4 / 2.0, 1e-9);
    }
}

#[test]
fn pulses_in_motions_accelerations_and_rates_are_not_stepped_over() {
    let text = r#"
        parameters = { at = { default = 0.5 } }
        variables.pulse = "step(time, at, 0, at + 1e-3, 1) - step(time, at + 2e-3, 0, at + 3e-3, 1)"
        bodies = { cart = { mass = 1, inertia = 1 }, load = { mass = 2, inertia = 1 }, sled = { mass = 1, inertia = 1 } }
        joints.c = { type = "prismatic", axis = [1, 0], between = ["ground", "cart"] }
        drivers.shake = { coordinate = "c.position", motion = "pulse" }
        joints.l = { type = "prismatic", axis = [0, 1], between = ["ground", "load"] }
        actuators.pull = { coordinate = "l.position", effort = "1000*c.position" }
        joints.s = { type = "prismatic", axis = [1, 1], between = ["ground", "sled"] }
        drivers.push = { coordinate = "s.position", acceleration = "1000*pulse" }
        states.charge = { rate = "1000*pulse" }
        outputs = { load = { measure = "l.velocity" }, sled = { measure = "s.velocity" }, charge = { measure = "charge" } }
    "#;
    for mechanism in both_formulations(text) {
        for (at, rows) in [(0.123_456, 21), (1.5, 3)] {
            let found = mechanism.simulate(&[at], &grid(2.0, rows), 1e-12, &Budget::default()).unwrap();
            let &[load, sled, charge] = &found[found.len() - 3..] else { panic!() };
            assert_close(load, 1.0, 1e-10);
            assert_close(sled, 2.0, 1e-10);
            assert_close(charge, 2.0, 1e-10);
        }
    }
}

#[test]
fn the_implicit_method_ends_steps_at_switches_too() {
    // m v' = f - c v with c / m = 250 000 / s: after the pulse, c x is its impulse
    let text = r#"
        parameters = { at = { default = 0.5 }, width = { default = 1e-3 } }
        bodies.block = { mass = 40, inertia = 1 }
        joints.b = { type = "prismatic", between = ["ground", "block"], axis = [1, 0] }
        springs.pot = { coordinate = "b.position", damping = 1e7 }
        actuators.push = { coordinate = "b.position", effort = "1e7*(sign(time - at) - sign(time - at - width))/2" }
        initial.b = { velocity = 3 }
        outputs.x = { measure = "b.position" }
    "#;
    for mechanism in both_formulations(text) {
        for (at, width) in [(0.51, 1e-3), (1.234, 1e-4), (0.7, 1e-2)] {
            let budget = Budget::default();
            let found = mechanism.simulate(&[at, width], &grid(2.0, 21), 1e-12, &budget).unwrap();
            assert_close(found[20], width + 3.0 * 40.0 / 1e7, 1e-10);
            assert!(budget.spent() < 120_000, "{} evaluations", budget.spent());
        }
    }
}

#[test]
fn runs_without_switches_of_time_cost_what_they_did() {
    let spent = |effort: &str| {
        let [mechanism, _] = both_formulations(&rotor(effort));
        let budget = Budget::default();
        mechanism.simulate(&[0.5, 1e-3], &grid(2.0, 21), 1e-12, &budget).unwrap();
        budget.spent()
    };
    let smooth = spent("sin(time)");
    assert_eq!(spent("sin(time) + 0*max(shaft.angle, -1)"), smooth);
    // a switch begins the integration anew in its row
    let switched = spent("max(sin(time), -1) + 0*step(time, 0.5, 0, 1.5, 1)");
    assert!((smooth..6 * smooth).contains(&switched), "{switched} {smooth}");
}

#[test]
fn formulas_that_switch_too_often_are_refused() {
    let mechanism = parse(&rotor("mod(time, 1e-6)"));
    let message = mechanism.simulate(&[0.5, 1e-3], &grid(2.0, 21), 1e-12, &Budget::default()).unwrap_err().message;
    assert!(message.contains("`mod(time, 1e-6)` of `actuators.motor` switches at too many times"), "{message}");
}
