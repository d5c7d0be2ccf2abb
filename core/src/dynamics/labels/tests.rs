use super::super::{FittedEquations, QuantityRange, Region, fit};
use crate::multibody::Mechanism;
use metafmu_runtime::StatePoint;
use std::{
    f64::consts::{PI, TAU},
    path::Path,
};

fn parse(text: &str) -> Mechanism {
    Mechanism::parse(text, Path::new("m.toml")).unwrap()
}

fn region(coordinates: &[(&str, f64)], parameters: &[(&str, f64, f64)]) -> Region {
    Region {
        coordinates: coordinates.iter().map(|(name, end)| QuantityRange::new(name, -end, *end)).collect(),
        parameters: parameters.iter().map(|(name, min, max)| QuantityRange::new(name, *min, *max)).collect(),
        ..Region::default()
    }
}

fn accelerations(fitted: &FittedEquations, [q, v, u, p]: [&[f64]; 4]) -> Vec<f64> {
    let mut found = vec![0.0; q.len()];
    fitted.dynamics.accelerations(StatePoint { q, v, u, p }, &mut found, &mut fitted.dynamics.scratch());
    found
}

fn energy(fitted: &FittedEquations, [q, v, u, p]: [&[f64]; 4]) -> f64 {
    fitted.dynamics.energy(StatePoint { q, v, u, p }, &mut fitted.dynamics.scratch())
}

/// A drum of 0.02 kg.m² about its center, whose mass of 2 kg is at the distance `e` from it, lifts a load by half its rope.
fn drum(more: &str) -> String {
    format!(
        r#"
        gravity = [0, -9.81]
        parameters.m = {{ default = 20, min = 10, max = 40 }}
        parameters.e = {{ default = 0.0 }}
        inputs.T = {{ min = 0, max = 30 }}
        bodies.d = {{ mass = 2, inertia = 0.02, position = ["e", 0], points = {{ o = ["-e", 0] }} }}
        bodies.l = {{ mass = "m" }}
        joints.drum = {{ type = "revolute", between = ["ground", "d.o"] }}
        joints.lift = {{ type = "prismatic", between = ["ground", "l"], axis = [0, 1] }}
        couplings.rope = {{ coordinate = "lift.position", follows = "0.1*drum.angle/2" }}
        actuators.t = {{ coordinate = "drum.angle", effort = "T - 0.2*drum.angular_velocity" }}
        outputs.y = {{ measure = "lift.position" }}
        {more}
    "#
    )
}

#[test]
fn the_weight_of_a_load_on_a_drum_is_learned_as_a_uniform_force() {
    let energy_shown = "outputs.V = { measure = \"potential_energy\" }";
    for (text, eccentricity) in [(drum(energy_shown), 0.0), (drum(energy_shown).replace("= 0.0 }", "= 0.03 }"), 0.03)] {
        let region =
            Region { outputs: vec!["y".into(), "V".into()], ..region(&[("drum.angle", PI)], &[("m", 10.0, 40.0)]) };
        let fitted = fit(&parse(&text), &region, 1).unwrap();
        assert!(fitted.error < 1e-12 && fitted.dynamics.is_uniform(0), "{:e}, {:?}", fitted.error, fitted.order);
        assert_eq!(fitted.periods, [Some(1)]);
        assert!((fitted.windings[0] - 0.05).abs() < 1e-12, "{:?}", fitted.windings);
        let at_start = energy(&fitted, [&[0.0], &[0.0], &[0.0], &[17.0]]);
        // the angle is many turns away from the start as well
        for angle in [-31.0f64, -0.4, 2.1, 400.0] {
            let (omega, torque, m) = (1.7, 21.0, 17.0);
            let side = torque - 0.2 * omega - 9.81 * (0.05 * m + 2.0 * eccentricity * angle.cos());
            let inertia = 0.02 + 2.0 * eccentricity * eccentricity + 0.0025 * m;
            let found = accelerations(&fitted, [&[angle], &[omega], &[torque], &[m]])[0];
            assert!((found - side / inertia).abs() < 1e-9 * (1.0 + (side / inertia).abs()), "{angle}: {found}");
            let found = energy(&fitted, [&[angle], &[omega], &[torque], &[m]]) - at_start;
            let expected = 0.5 * inertia * omega * omega + 9.81 * (0.05 * m * angle + 2.0 * eccentricity * angle.sin());
            assert!((found - expected).abs() < 1e-8 * (1.0 + expected.abs()), "{angle}: {found} {expected}");
        }
    }
}

#[test]
fn two_drums_have_a_uniform_force_each() {
    let text = drum("").replace(
        "follows = \"0.1*drum.angle/2\" }",
        "follows = \"0.05*drum.angle + 0.03*other.angle\" }
         bodies.o = { mass = 1, inertia = 0.01 }
         joints.other = { type = \"revolute\", between = [\"ground\", \"o\"] }",
    );
    let fitted =
        fit(&parse(&text), &region(&[("drum.angle", PI), ("other.angle", PI)], &[("m", 10.0, 40.0)]), 1).unwrap();
    assert!(fitted.error < 1e-12, "{:e}", fitted.error);
    let (m, torque) = (23.0, 5.0);
    // M = [0.02 + 0.0025 m, 0.0015 m; ., 0.01 + 0.0009 m], weights m g r
    let (a, b, c) = (0.02 + 0.0025 * m, 0.0015 * m, 0.01 + 0.0009 * m);
    let side = [torque - 0.2 * 0.3 - 9.81 * m * 0.05, -9.81 * m * 0.03];
    let determinant = a * c - b * b;
    let expected = [(c * side[0] - b * side[1]) / determinant, (a * side[1] - b * side[0]) / determinant];
    let found = accelerations(&fitted, [&[9.0, -70.0], &[0.3, -2.0], &[torque], &[m]]);
    assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 1e-9 * expected[k].abs()), "{found:?} {expected:?}");
}

#[test]
fn equations_do_not_depend_on_a_position_that_only_rates_and_weights_have() {
    let text = r#"
        gravity = [0, -9.81]
        parameters.m = { default = 20 }
        inputs.F = { min = 0, max = 500 }
        bodies.car = { mass = "m" }
        joints.shaft = { type = "prismatic", between = ["ground", "car"], axis = [0.6, 0.8] }
        actuators.drive = { coordinate = "shaft.position", effort = "F - 3*shaft.velocity - 8*tanh(shaft.velocity/0.1)" }
        outputs.s = { measure = "shaft.position" }
    "#;
    let region = Region { outputs: vec!["s".into()], ..region(&[("shaft.position", 1.0)], &[("m", 10.0, 40.0)]) };
    let fitted = fit(&parse(text), &region, 1).unwrap();
    assert!(fitted.error < 1e-12 && !fitted.dynamics.depends_on(0), "{:e}", fitted.error);
    let found = accelerations(&fitted, [&[77.0], &[0.4], &[200.0], &[15.0]])[0];
    let expected = (200.0 - 1.2 - 8.0 * 4f64.tanh()) / 15.0 - 9.81 * 0.8;
    assert!((found - expected).abs() < 1e-10, "{found} {expected}");
    // a spring needs the position
    let sprung = format!("{text}\n springs.k = {{ coordinate = \"shaft.position\", stiffness = 300 }}");
    let fitted = fit(&parse(&sprung), &region, 1).unwrap();
    assert!(fitted.error < 1e-12 && fitted.dynamics.depends_on(0) && !fitted.dynamics.is_uniform(0));
    let found = accelerations(&fitted, [&[0.7], &[0.4], &[200.0], &[15.0]])[0];
    assert!((found - (expected - 300.0 * 0.7 / 15.0)).abs() < 1e-9, "{found}");
}

#[test]
fn a_gear_whose_ratio_is_a_parameter_is_exact_at_all_angles() {
    let text = r#"
        parameters.ratio = { default = 2, min = 2, max = 4 }
        bodies.pinion = { inertia = 0.001 }
        bodies.wheel = { inertia = 0.05 }
        joints.shaft = { type = "revolute", between = ["ground", "pinion"] }
        joints.axle = { type = "revolute", between = ["ground", "wheel"] }
        couplings.gear = { coordinate = "wheel.angle", follows = "-pinion.angle/ratio" }
        actuators.motor = { coordinate = "pinion.angle", effort = 0.2 }
        actuators.load = { coordinate = "wheel.angle", effort = "-0.05*wheel.angular_velocity" }
        outputs.wheel = { measure = "wheel.angle" }
    "#;
    let region = Region { outputs: vec!["wheel".into()], ..region(&[("shaft.angle", 3.0)], &[("ratio", 2.0, 4.0)]) };
    let fitted = fit(&parse(text), &region, 1).unwrap();
    assert!(fitted.error < 1e-12 && !fitted.dynamics.is_limited_along(0), "{:e}", fitted.error);
    assert!(fitted.straight == [0] && fitted.positions.output_is_straight(0, 0));
    let ratio = 3.1;
    let found = accelerations(&fitted, [&[500.0], &[7.0], &[], &[ratio]])[0];
    let expected = (0.2 - 0.05 * 7.0 / (ratio * ratio)) / (0.001 + 0.05 / (ratio * ratio));
    assert!((found - expected).abs() < 1e-9 * expected.abs(), "{found} {expected}");
    // a spring acts by the angle, which is a straight line along it
    let sprung = format!("{text}\n springs.k = {{ coordinate = \"wheel.angle\", stiffness = 3 }}");
    let fitted = fit(&parse(&sprung), &region, 1).unwrap();
    assert!(fitted.error < 1e-12 && fitted.dynamics.is_limited_along(0), "{:e}", fitted.error);
    // gears whose ratio changes a little with the angle
    let curved = text.replace("-pinion.angle/ratio", "-pinion.angle/ratio - 1e-6*pinion.angle^2");
    assert!(fit(&parse(&curved), &region, 1).unwrap().straight.is_empty());
}

#[test]
fn forces_repeat_after_the_turns_of_their_tables_and_gears() {
    let shaft = |effort: &str| {
        format!(
            r#"
            bodies.wheel = {{ mass = 1, inertia = 0.1 }}
            joints.shaft = {{ type = "revolute", between = ["ground", "wheel"] }}
            actuators.gas = {{ coordinate = "shaft.angle", effort = "{effort}" }}
            outputs.q = {{ measure = "shaft.angle" }}
            [tables.cycle]
            x = [0, 180, 360, 540, 720]
            values = [1, 3, -1, -2, 1]
            interpolation = "cubic"
            extrapolation = "periodic"
            [tables.spark]
            x = [0, 400, 410, 420, 720]
            values = [0, 0, 9, 0, 0]
            extrapolation = "periodic"
            [tables.latch]
            x = [600, 650, 700]
            values = [0, 5, 0]
        "#
        )
    };
    for (effort, period) in [
        ("2 - shaft.angular_velocity", Some(1)),
        ("sin(shaft.angle)", Some(1)),
        ("cycle(shaft.angle*180/pi)", Some(2)),
        ("cycle(shaft.angle*360/pi)", Some(1)),
        ("cycle(shaft.angle*60/pi)", Some(6)),
        ("cycle(shaft.angle*180/pi) + sin(shaft.angle/3)", Some(6)),
        // both are zero about the start
        ("spark(shaft.angle*180/pi)", Some(2)),
        ("cos(shaft.angle) + latch(shaft.angle*180/pi)", None),
        ("cycle(shaft.angle*180/pi) - 0.1*shaft.angle", None),
        ("cycle(shaft.angle)", None),
    ] {
        let fitted = fit(&parse(&shaft(effort)), &region(&[("shaft.angle", PI)], &[]), 1).unwrap();
        let angles = [0.3, 2.0, 7.1];
        assert_eq!(fitted.periods, [period], "{effort}");
        for (angle, turns) in angles.iter().zip(1..).filter_map(|(angle, k)| Some((*angle, f64::from(k * period?)))) {
            let at = |angle: f64| accelerations(&fitted, [&[angle], &[0.5], &[], &[]])[0];
            assert!((at(angle) - at(angle + turns * TAU)).abs() < 1e-9, "{effort} at {angle}");
        }
    }
}
