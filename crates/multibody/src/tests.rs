//! Physical identities and closed forms that whole mechanisms must meet, in both formulations.

mod chains;
mod contacts;
mod drivers;
mod mistakes;
mod parts;
mod redundancy;

use super::{
    Mechanism, MotionCause,
    model::{MultibodyModel, Sample},
    simulate::simulate,
};
use crate::integrate::{Budget, TOLERANCE};
use std::path::Path;

const SINGLE_PENDULUM: &str = include_str!("../../../examples/mechanisms/single-pendulum.toml");
const DOUBLE_PENDULUM: &str = include_str!("../../../examples/mechanisms/double-pendulum.toml");
const SLIDER_CRANK: &str = include_str!("../../../examples/mechanisms/slider-crank.toml");
const FOUR_BAR: &str = include_str!("../../../examples/mechanisms/four-bar.toml");
const QUARTER_CAR: &str = include_str!("../../../examples/mechanisms/quarter-car.toml");
const SCOTCH_YOKE: &str = include_str!("../../../examples/mechanisms/scotch-yoke.toml");
const EXAMPLES: [&str; 6] = [SINGLE_PENDULUM, DOUBLE_PENDULUM, SLIDER_CRANK, FOUR_BAR, QUARTER_CAR, SCOTCH_YOKE];

fn both_formulations(text: &str) -> [Mechanism; 2] {
    let text = text.replace("formulation", "# formulation");
    ["augmented", "embedding"].map(|formulation| parse(&format!("formulation = \"{formulation}\"\n{text}")))
}

fn parse(text: &str) -> Mechanism {
    Mechanism::parse(text, Path::new("m.toml")).unwrap()
}

fn refused(text: &str) -> String {
    Mechanism::parse(text, Path::new("m.toml")).unwrap_err().to_string()
}

fn grid(stop: f64, count: u32) -> Vec<f64> {
    (0..=count).map(|i| stop * f64::from(i) / f64::from(count)).collect()
}

/// The mechanism's parameters with some of them set.
fn values(mechanism: &Mechanism, set: &[(&str, f64)]) -> Vec<f64> {
    for (name, _) in set {
        assert!(mechanism.parameters().contains_key(*name), "{name}");
    }
    let value = |(name, parameter): (&String, &super::description::MechanismParameter)| {
        set.iter().find(|(known, _)| known == name).map_or(parameter.default, |(_, value)| *value)
    };
    mechanism.parameters().iter().map(value).collect()
}

/// Rows of outputs.
fn rows(mechanism: &Mechanism, times: &[f64]) -> Vec<Vec<f64>> {
    let values = values(mechanism, &[]);
    let rows = mechanism.simulate(&values, times, TOLERANCE, &Budget::default()).unwrap();
    rows.chunks(mechanism.outputs().len()).map(<[f64]>::to_vec).collect()
}

#[track_caller]
fn assert_close(found: f64, expected: f64, bound: f64) {
    assert!((found - expected).abs() <= bound, "{found} {expected}");
}

fn run(mechanism: &Mechanism, set: &[(&str, f64)], times: &[f64]) -> (MultibodyModel, Vec<Sample>) {
    let (model, _) = mechanism.build(&values(mechanism, set)).unwrap();
    let samples = simulate(&model, times, &Budget::default()).unwrap();
    (model, samples)
}

#[test]
fn constraints_hold_and_both_formulations_agree_on_every_example() {
    let times = grid(2.0, 100);
    for text in EXAMPLES {
        let runs = both_formulations(text).map(|mechanism| run(&mechanism, &[], &times));
        for (model, samples) in &runs {
            let violation = |s: &Sample| model.constraints.violation(s.t, &s.q, &s.v);
            let largest = samples.iter().map(violation).fold(0.0, f64::max);
            assert!(largest < 1e-10, "{largest:e} in {text}");
        }
        let mut largest: [f64; 3] = [0.0; 3];
        for (one, other) in runs[0].1.iter().zip(&runs[1].1) {
            let scale = 1.0 + one.multipliers.amax();
            let differences = [
                (&one.q - &other.q).amax(),
                (&one.v - &other.v).amax(),
                (&one.multipliers - &other.multipliers).amax() / scale,
            ];
            largest = std::array::from_fn(|i| largest[i].max(differences[i]));
        }
        assert!(largest[0] < 1e-8 && largest[1] < 1e-7 && largest[2] < 1e-7, "{largest:?} in {text}");
    }
}

#[test]
fn energy_is_kept_where_nothing_dissipates() {
    let times = grid(10.0, 500);
    let cases: [(&str, &[(&str, f64)]); 3] = [
        (SINGLE_PENDULUM, &[("c", 0.0), ("thetad0", 5.0)]),
        (DOUBLE_PENDULUM, &[("theta1d0", 0.1)]),
        (FOUR_BAR, &[("damping", 0.0)]),
    ];
    for (text, set) in cases {
        for mechanism in both_formulations(text) {
            let (model, samples) = run(&mechanism, set, &times);
            let energy = |s: &Sample| model.kinetic_energy(&s.v) + model.potential_energy(&s.q);
            // relative to what moves
            let scale = samples.iter().map(|s| model.kinetic_energy(&s.v)).fold(0.0, f64::max);
            let drift = samples.iter().map(|s| (energy(s) - energy(&samples[0])).abs()).fold(0.0, f64::max) / scale;
            assert!(drift < 1e-9, "{drift:e} of {scale} J in {text}");
        }
    }
}

/// A bead that slides on a rotating arm, and a slider crank without load: angles and lengths of very different size.
const BEAD: &str = r#"
    bodies.arm = { mass = 1, inertia = 0.1, angle = 0.3 }
    bodies.bead = { mass = 0.5, inertia = 0.001, position = ["0.5*cos(0.3)", "0.5*sin(0.3)"], angle = 0.3 }
    joints.pivot = { type = "revolute", between = ["ground", "arm"] }
    joints.slide = { type = "prismatic", between = ["arm", "bead"], axis = [1, 0] }
    initial.arm = { angle = 0.3, angular_velocity = -1 }
    initial.slide = { position = 0.5, velocity = 0 }
    outputs.omega = { measure = "arm.angular_velocity" }
    outputs.r = { measure = "slide.position" }
    outputs.v = { measure = "slide.velocity" }
"#;
/// A bead that a spring pulls through the pivot of the arm that it slides on.
const BEAD_THROUGH_PIVOT: &str = r#"
    bodies.arm = { mass = 1, inertia = 0.08, points = { o = [0, 0] } }
    bodies.bead = { mass = 0.2, inertia = 1e-4, position = [0.1, 0], points = { c = [0, 0] } }
    joints.pivot = { type = "revolute", between = ["ground", "arm.o"] }
    joints.wire = { type = "prismatic", between = ["arm.o", "bead.c"], axis = [1, 0] }
    springs.k = { coordinate = "wire.position", stiffness = 20 }
    parameters.speed = { default = 3 }
    parameters.r0 = { default = 0.1 }
    initial.arm = { angle = 0, angular_velocity = "speed" }
    initial.wire = { position = "r0", velocity = 0 }
    outputs.r = { measure = "wire.position" }
"#;
const FREE_CRANK: &str = r#"
    parameters.omega = { default = 100 }
    bodies.crank = { mass = 1, inertia = 0.01, position = [0.05, 0], points = { left = [-0.05, 0], right = [0.05, 0] } }
    bodies.rod = { mass = 0.6, inertia = 0.0045, position = [0.25, 0], points = { left = [-0.15, 0], right = [0.15, 0] } }
    bodies.piston = { mass = 0.5, inertia = 0.001, position = [0.4, 0] }
    joints.A = { type = "revolute", between = ["ground", "crank.left"] }
    joints.B = { type = "revolute", between = ["crank.right", "rod.left"] }
    joints.C = { type = "revolute", between = ["rod.right", "piston"] }
    joints.guide = { type = "prismatic", between = ["ground", "piston"], axis = [1, 0] }
    initial.crank = { angle = 0, angular_velocity = "omega" }
    outputs.theta = { measure = "crank.angle" }
    outputs.omega = { measure = "crank.angular_velocity" }
"#;

#[test]
fn a_bead_on_a_rotating_arm_keeps_energy_and_angular_momentum() {
    let runs = both_formulations(BEAD)
        .map(|mechanism| mechanism.simulate(&[], &grid(2.0, 200), TOLERANCE, &Budget::default()).unwrap());
    for (one, other) in runs[0].iter().zip(&runs[1]) {
        assert!((one - other).abs() < 1e-11);
    }
    for row in runs.iter().flat_map(|run| run.chunks(3)) {
        let &[omega, r, v] = row else { panic!() };
        let inertia = 0.101 + 0.5 * r * r;
        let (momentum, energy) = (inertia * omega, 0.5 * inertia * omega * omega + 0.25 * v * v);
        assert!((momentum + 0.226).abs() < 1e-12 && (energy - 0.113).abs() < 1e-12, "{momentum} {energy}");
    }
    assert!(runs[1].last().unwrap() > &0.5);
}

#[test]
fn a_slider_crank_without_load_keeps_its_energy_at_any_speed() {
    /// Twice the kinetic energy at a crank speed of 1 rad/s.
    fn inertia(theta: f64) -> f64 {
        let (crank, rod) = (0.1, 0.3);
        let (sine, cosine) = theta.sin_cos();
        let along = (rod * rod - crank * crank * sine * sine).sqrt();
        let slope = crank * crank * sine * cosine / along;
        let (rod_x, rod_y) = (-crank * sine - 0.5 * slope, 0.5 * crank * cosine);
        0.0125
            + 0.0045 * (crank * cosine / along).powi(2)
            + 0.6 * (rod_x * rod_x + rod_y * rod_y)
            + 0.5 * (crank * sine + slope).powi(2)
    }
    for (omega, stop) in [(100.0, 1.0), (1000.0, 0.1)] {
        let runs = both_formulations(FREE_CRANK);
        let runs =
            runs.map(|mechanism| mechanism.simulate(&[omega], &grid(stop, 50), TOLERANCE, &Budget::default()).unwrap());
        for (one, other) in runs[0].iter().zip(&runs[1]) {
            assert!((one - other).abs() < 1e-8 * omega, "{one} {other}");
        }
        for row in runs.iter().flat_map(|run| run.chunks(2)) {
            let exact = omega * (inertia(0.0) / inertia(row[0])).sqrt();
            assert!((row[1] - exact).abs() < 1e-9 * omega, "{row:?} {exact}");
        }
        assert!(runs[1][100] > 80.0);
    }
}

#[test]
fn andrews_squeezing_mechanism_is_the_reference_solution() {
    // row, then angles of K1, K3, K5 and K7 and the angular velocity of K1: recomputed to 1e-12 by two integrators, because the
    // test set's own digits are good to 1e-9
    let reference = [
        (1, [0.211076385903, 0.449115190012, 0.488743765462, 1.225866794035, 151.0107012692]),
        (2, [2.160113131532, 0.158516758001, 0.525154774798, 1.068427204632, 711.9231528311]),
        (4, [8.184905889662, 0.209536913385, 0.522536917156, 1.086275108600, 726.5583426091]),
        (5, [12.107149234447, 0.440973355583, 0.490519544682, 1.219766771810, 587.4597890778]),
        (6, [15.810771195153, 0.040822240120, 0.524409965880, 1.048080741042, 1139.92030225]),
    ];
    for mechanism in both_formulations(include_str!("../../../examples/dynamics/andrews.toml")) {
        let rows = mechanism.simulate(&[4530.0], &grid(0.03, 6), TOLERANCE, &Budget::default()).unwrap();
        let rows: Vec<&[f64]> = rows.chunks(mechanism.outputs().len()).collect();
        for (index, [beta, k3, k5, k7, betad]) in reference {
            let row = rows[index];
            for (found, exact) in [row[0], row[2], row[3], row[4]].into_iter().zip([beta, k3, k5, k7]) {
                assert!((found - exact).abs() < 2e-11, "row {index}: {found} {exact}");
            }
            assert!((row[1] - betad).abs() < 2e-8, "row {index}: {} {betad}", row[1]);
        }
        // at rest: of K1, and of K2 relative to K1
        assert!(
            (rows[0][7] - 14222.4439199541).abs() < 1e-7 && (rows[0][8] - rows[0][7] + 10666.8329399656).abs() < 1e-7
        );
    }
}

#[test]
fn the_pivot_carries_weight_and_centripetal_force() {
    let (m, l, g) = (0.3, 0.15, 9.81);
    for mechanism in both_formulations(SINGLE_PENDULUM) {
        let all = values(&mechanism, &[("c", 0.0), ("thetad0", 3.0)]);
        let rows = mechanism.simulate(&all, &grid(2.0, 200), TOLERANCE, &Budget::default()).unwrap();
        for row in rows.chunks(mechanism.outputs().len()) {
            let (theta, thetad, fx, fy) = (row[0], row[1], row[5], row[6]);
            let rod = m * l * thetad * thetad + m * g * theta.cos();
            assert!((fx + rod * theta.sin()).abs() < 1e-10 && (fy - rod * theta.cos()).abs() < 1e-10, "{fx} {fy}");
        }
    }
}

#[test]
fn the_motor_of_the_slider_crank_does_the_work_on_the_slider() {
    let mechanism = parse(SLIDER_CRANK);
    let rows = mechanism
        .simulate(&values(&mechanism, &[("tau", 1.3)]), &grid(5.0, 100), TOLERANCE, &Budget::default())
        .unwrap();
    for (row, t) in rows.chunks(mechanism.outputs().len()).zip(grid(5.0, 100)) {
        let (thetad, xbd, xbdd, torque) = ((1.0 - (1.3 * t).cos()) / 1.3, row[5], row[6], row[7]);
        assert!((torque * thetad - xbd * xbdd).abs() < 1e-11, "t = {t}");
    }
}

#[test]
fn prismatic_and_fixed_joints_hold_their_angle() {
    // a block on an incline of 30 degrees, an arm welded to it at right angles
    let text = r#"
        gravity = [0, -10]
        bodies.block = { mass = 2, inertia = 1, position = [1, 0] }
        bodies.arm = { mass = 1, inertia = 0.1, position = [1, 1], angle = 2, points = { foot = [-1, 0] } }
        joints.incline = { type = "prismatic", between = ["ground", "block"], axis = ["cos(pi/6)", 0.5], angle = "pi/6" }
        joints.weld = { type = "fixed", between = ["block", "arm.foot"], angle = "pi/2" }
        outputs.s = { measure = "incline.position" }
        outputs.acceleration = { measure = "incline.acceleration" }
        outputs.angle = { measure = "arm.angle" }
        outputs.fx = { measure = "incline.fx" }
        outputs.fy = { measure = "weld.fy" }
        outputs.moment = { measure = "weld.moment" }
    "#;
    for mechanism in both_formulations(text) {
        let rows = mechanism.simulate(&[], &grid(1.0, 10), TOLERANCE, &Budget::default()).unwrap();
        let first = rows[0];
        for (row, t) in rows.chunks(6).zip(grid(1.0, 10)) {
            let &[s, acceleration, angle, fx, fy, moment] = row else { panic!() };
            assert!((s - (first - 2.5 * t * t)).abs() < 1e-12 && (acceleration + 5.0).abs() < 1e-12);
            assert!((angle - std::f64::consts::PI * 2.0 / 3.0).abs() < 1e-12);
            // normal force 30 cos 30 along (-sin 30, cos 30); the arm slides with -5 along (cos 30, sin 30)
            let normal = 30.0 * 0.75f64.sqrt();
            assert!((fx + 0.5 * normal).abs() < 1e-11, "{fx}");
            assert!((fy - (10.0 - 2.5)).abs() < 1e-11, "{fy}");
            // about the foot: weight and inertia of the arm at (-1/2, cos 30)
            let (x, y) = (-0.5, 0.75f64.sqrt());
            let expected = x * (-2.5 + 10.0) - y * (-5.0 * 0.75f64.sqrt());
            assert!((moment - expected).abs() < 1e-11, "{moment} {expected}");
        }
    }
}

/// An in-line engine, its crank driven at a constant speed; cylinders by the angle of their crank pins, at 0.04 m.
fn engine(rod: f64, pins: &[f64]) -> String {
    let points: Vec<[f64; 2]> = pins.iter().map(|pin| [0.04 * pin.cos(), 0.04 * pin.sin()]).collect();
    let named: Vec<String> = points.iter().enumerate().map(|(i, point)| format!("pin{i} = {point:?}")).collect();
    let mut text = format!(
        r#"
        parameters.rpm = {{ default = 1000 }}
        bodies.crank = {{ inertia = 0.01, points = {{ {} }} }}
        joints.bearing = {{ type = "revolute", between = ["ground", "crank"] }}
        drivers.motor = {{ coordinate = "crank.angle", motion = "rpm*pi/30*time" }}
        "#,
        named.join(", ")
    );
    for (i, [x, y]) in points.iter().enumerate() {
        let along = (rod * rod - y * y).sqrt();
        let (piston, angle, half) = (x + along, f64::atan2(-y, along), 0.5 * rod);
        let (middle, height) = (x + 0.5 * along, 0.5 * y);
        text += &format!(
            r#"
            [bodies.rod{i}]
            mass = 0.6
            inertia = 0.001
            position = [{middle}, {height}]
            angle = {angle}
            points = {{ big = [-{half}, 0], small = [{half}, 0] }}
            [bodies.piston{i}]
            mass = 0.5
            position = [{piston}, 0]
            [joints.big{i}]
            type = "revolute"
            between = ["crank.pin{i}", "rod{i}.big"]
            [joints.small{i}]
            type = "revolute"
            between = ["rod{i}.small", "piston{i}"]
            [joints.cylinder{i}]
            type = "prismatic"
            between = ["ground", "piston{i}"]
            axis = [1, 0]
            [outputs.x{i}]
            measure = "cylinder{i}.position"
            [outputs.v{i}]
            measure = "cylinder{i}.velocity"
            "#
        );
    }
    text
}

/// Crank-rocker linkages side by side, the cranks driven at a constant speed.
fn driven_four_bars(count: usize) -> String {
    let mut text = "parameters.omega = { default = 1 }\nground.points = { right = [0.45, 0] }\n".to_owned();
    for i in 0..count {
        text += &format!(
            r#"
            [bodies.crank{i}]
            points = {{ tip = [0.2, 0] }}
            [bodies.coupler{i}]
            position = [0.2, 0]
            angle = 0.9
            points = {{ tip = [0.5, 0] }}
            [bodies.rocker{i}]
            mass = 1
            position = [0.45, 0]
            angle = 1.4
            points = {{ tip = [0.4, 0] }}
            [joints.A{i}]
            type = "revolute"
            between = ["ground", "crank{i}"]
            [joints.B{i}]
            type = "revolute"
            between = ["crank{i}.tip", "coupler{i}"]
            [joints.C{i}]
            type = "revolute"
            between = ["coupler{i}.tip", "rocker{i}.tip"]
            [joints.D{i}]
            type = "revolute"
            between = ["ground.right", "rocker{i}"]
            [drivers.motor{i}]
            coordinate = "A{i}.angle"
            motion = "omega*time"
            [outputs.psi{i}]
            measure = "rocker{i}.angle"
            "#
        );
    }
    text
}

#[test]
fn pistons_of_an_engine_are_the_closed_form_whatever_the_speed_and_the_rows() {
    let (radius, rod) = (0.04, 0.13);
    let turn = std::f64::consts::TAU;
    let engines: [&[f64]; 3] = [&[0.0], &[0.0, 0.5 * turn], &[0.0, 0.5 * turn, 0.5 * turn, 0.0]];
    let three_rows_in_many_turns = [0.0, 1.1, 2.2];
    for pins in engines {
        let mechanism = parse(&engine(rod, pins));
        for rpm in [2500.0, 3500.0, 8000.0] {
            for times in [&grid(0.5, 50)[..], &grid(0.05, 500), &three_rows_in_many_turns] {
                let rows = mechanism.simulate(&[rpm], times, TOLERANCE, &Budget::default()).unwrap();
                for (row, t) in rows.chunks(2 * pins.len()).zip(times) {
                    let omega = rpm * turn / 60.0;
                    for (piston, pin) in row.chunks(2).zip(pins) {
                        let (sine, cosine) = (omega * t + pin).sin_cos();
                        let along = (rod * rod - radius * radius * sine * sine).sqrt();
                        let x = radius * cosine + along;
                        let v = -omega * radius * sine * (1.0 + radius * cosine / along);
                        let differences = ((piston[0] - x).abs(), (piston[1] - v).abs() / omega);
                        assert!(differences.0 < 1e-12 && differences.1 < 1e-12, "{rpm} {t}: {differences:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn rockers_of_driven_four_bar_linkages_are_the_closed_form_whatever_the_rows() {
    let (crank, coupler, rocker, base): (f64, f64, f64, f64) = (0.2, 0.5, 0.4, 0.45);
    for count in [1, 2] {
        let mechanism = parse(&driven_four_bars(count));
        // 0.01 to 7 rad a row
        for (omega, times) in
            [(1.0, grid(10.0, 1000)), (1.0, grid(20.0, 20)), (130.0, grid(1.0, 100)), (70.0, grid(5.0, 50))]
        {
            let rows = mechanism.simulate(&[omega], &times, TOLERANCE, &Budget::default()).unwrap();
            for (row, t) in rows.chunks(count).zip(&times) {
                let (sine, cosine) = (omega * t).sin_cos();
                let (x, y) = (base - crank * cosine, -crank * sine);
                let diagonal = x.hypot(y);
                let inside = (coupler * coupler + diagonal * diagonal - rocker * rocker) / (2.0 * coupler * diagonal);
                let phi = y.atan2(x) + inside.acos();
                let psi = (coupler * phi.sin() - y).atan2(coupler * phi.cos() - x);
                for found in row {
                    assert!((found - psi).abs() < 1e-12, "{omega} {t}: {found} {psi}");
                }
            }
        }
    }
}

#[test]
fn a_bead_passes_the_pivot_of_its_arm_with_independent_coordinates_only() {
    let times = grid(2.0, 40);
    let [augmented, embedding] = both_formulations(BEAD_THROUGH_PIVOT);
    for (speed, r0) in [(3.0, 0.1), (0.0, 0.1), (-8.0, 0.3), (0.5, 1e-3), (3.0, 1e-9)] {
        let set = [("speed", speed), ("r0", r0)];
        let [(_, expected), (_, found)] = [&augmented, &embedding].map(|mechanism| run(mechanism, &set, &times));
        for (expected, found) in expected.iter().zip(&found) {
            let error = (&expected.q - &found.q).amax().max((&expected.v - &found.v).amax());
            assert!(error < 1e-8, "{error:e} at {} s with {set:?}", expected.t);
        }
    }
}

#[test]
fn no_step_goes_over_a_pulse_in_a_table_of_time() {
    let text = r#"
        tables.pulse = { x = [0.5, 0.51, 0.52], values = [0, 100, 0] }
        bodies.rotor = { mass = 1, inertia = 2 }
        joints.shaft = { type = "revolute", between = ["ground", "rotor"] }
        actuators.motor = { coordinate = "shaft.angle", effort = "pulse(time)" }
        outputs.speed = { measure = "shaft.angular_velocity" }
    "#;
    for mechanism in both_formulations(text) {
        for rows in [2, 3, 200] {
            let speeds = mechanism.simulate(&[], &grid(2.0, rows), 1e-12, &Budget::default()).unwrap();
            assert!((speeds[speeds.len() - 1] - 0.5).abs() < 1e-9, "{rows}: {speeds:?}");
        }
    }
}

mod stiff;
mod switches;
