//! Redundant constraints are taken out, singular starts are not.

use super::*;

/// A parallelogram with a third crank in the middle moves as the one without it: `3 · m l²/3 + m_c l²` turns, all weights are lifted.
#[test]
fn a_third_crank_is_left_out() {
    let text = |third: &str| {
        format!(
            r#"
            gravity = [0, 9.81]
            ground.points = {{ b = [1, 0], c = [2, 0] }}
            joints.a = {{ type = "revolute", between = ["ground", "one.low"] }}
            joints.b = {{ type = "revolute", between = ["ground.c", "two.low"] }}
            joints.e = {{ type = "revolute", between = ["one.high", "bar.left"] }}
            joints.f = {{ type = "revolute", between = ["two.high", "bar.right"] }}
            {third}
            initial.one.angle = 0.4
            outputs = {{ angle = {{ measure = "one.angle" }} }}
            bodies.one = {{ mass = 0.3, inertia = 0.01, position = [0.2, 0.2], angle = 0.4, points = {{ low = [0, -0.3], high = [0, 0.3] }} }}
            bodies.two = {{ mass = 0.3, inertia = 0.01, position = [2.2, 0.2], angle = 0.4, points = {{ low = [0, -0.3], high = [0, 0.3] }} }}
            bodies.bar = {{ mass = 1, inertia = 0.3, position = [1, 0.5], points = {{ left = [-1, 0], middle = [0, 0], right = [1, 0] }} }}
        "#
        )
    };
    let third = r#"
        bodies.mid = { mass = 0, inertia = 0, position = [1.2, 0.2], angle = 0.4, points = { low = [0, -0.3], high = [0, 0.3] } }
        joints.c = { type = "revolute", between = ["ground.b", "mid.low"] }
        joints.g = { type = "revolute", between = ["bar.middle", "mid.high"] }
    "#;
    let expected = rows(&parse(&text("")), &grid(3.0, 30));
    for mechanism in both_formulations(&text(third)) {
        let warnings: Vec<String> = mechanism.warnings().iter().map(ToString::to_string).collect();
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("joints.g: is left out as far as it repeats what others hold"), "{warnings:?}");
        assert!(mechanism.summary().ends_with("1 degree of freedom"), "{}", mechanism.summary());
        for (found, expected) in rows(&mechanism, &grid(3.0, 30)).iter().zip(&expected) {
            assert_close(found[0], expected[0], 1e-9);
        }
    }
    let message = refused(&text(third).replace("outputs = {", "outputs = { f = { measure = \"e.fx\" },"));
    assert!(message.contains("outputs.f.measure: is not determined: `joints.g` repeats what others hold"), "{message}");
    // a crank of another length is none that repeats
    let longer = text(third).replace(
        "low = [0, -0.3], high = [0, 0.3] } }\n        joints.c",
        "low = [0, -0.3], high = [0, 0.35] } }\n        joints.c",
    );
    assert!(refused(&longer).contains("cannot be assembled"));
}

/// A table on two parallel rails slides as on one; reactions of other joints are measured as before.
#[test]
fn a_second_rail_is_left_out() {
    let text = r#"
        gravity = [0, -10]
        bodies.table = { mass = 2, inertia = 0.1, points = { left = [-1, 0], right = [1, 0] } }
        bodies.arm = { mass = 1, inertia = 0, position = [0, -1], points = { top = [0, 1] } }
        joints.one = { type = "prismatic", between = ["ground", "table.left"], axis = [1, 0] }
        joints.two = { type = "prismatic", between = ["ground", "table.right"], axis = [1, 0] }
        joints.pin = { type = "revolute", between = ["table", "arm.top"] }
        drivers.hold = { coordinate = "pin.angle", motion = 0 }
        actuators.push = { coordinate = "table.x", effort = 6 }
        outputs = { x = { measure = "table.x" }, load = { measure = "pin.fy" }, torque = { measure = "hold.effort" } }
    "#;
    for mechanism in both_formulations(text) {
        assert_eq!(mechanism.warnings().len(), 1);
        for (row, t) in rows(&mechanism, &grid(1.0, 4)).iter().zip(grid(1.0, 4)) {
            assert_close(row[0], t * t, 1e-11);
            assert_close(row[1], 10.0, 1e-10);
            // the arm is accelerated by 2 m/s² through its pin, a metre above its centre of mass
            assert_close(row[2], 2.0, 1e-10);
        }
    }
}

/// Two gears that turn each other: what the second one says follows from the first, unless its ratio is another.
#[test]
fn a_coupling_that_repeats_another_is_left_out() {
    let text = |ratio: f64| {
        format!(
            r#"
            bodies.a = {{ mass = 1, inertia = 0.1 }}
            bodies.b = {{ mass = 1, inertia = 0.2 }}
            joints.p = {{ type = "revolute", between = ["ground", "a"] }}
            joints.q = {{ type = "revolute", between = ["ground", "b"] }}
            couplings.there = {{ coordinate = "q.angle", follows = "-2*p.angle" }}
            couplings.back = {{ coordinate = "p.angle", follows = "{ratio}*q.angle" }}
            actuators.m = {{ coordinate = "p.angle", effort = 1.8 }}
            outputs.angle = {{ measure = "p.angle" }}
        "#
        )
    };
    for mechanism in both_formulations(&text(-0.5)) {
        assert_eq!(mechanism.warnings().len(), 1);
        assert_close(rows(&mechanism, &[0.0, 1.0])[1][0], 0.5 * 1.8 / (0.1 + 4.0 * 0.2), 1e-11);
    }
    // both angles are held: nothing moves
    let held = parse(&text(0.7));
    assert!(held.warnings().is_empty());
    assert!(held.summary().ends_with("0 degrees of freedom"), "{}", held.summary());
}

/// A cam that starts at its lowest point, where its slope is a rounding error, is turned by its driver.
#[test]
fn a_driven_cam_starts_where_its_slope_is_zero() {
    let text = r#"
        bodies.cam = { mass = 1, inertia = 0.02 }
        bodies.follower = { mass = 0.4 }
        joints.shaft = { type = "revolute", between = ["ground", "cam"] }
        joints.guide = { type = "prismatic", between = ["ground", "follower"], axis = [0, 1] }
        couplings.contact = { coordinate = "guide.position", follows = "lift(shaft.angle)" }
        drivers.speed = { coordinate = "shaft.angle", motion = "20*time" }
        outputs = { y = { measure = "guide.position" }, force = { measure = "contact.effort" } }
        [tables.lift]
        x = [0, 0.7853981633974483, 1.5707963267948966, 2.356194490192345, 3.141592653589793, 3.9269908169872414, 4.71238898038469, 5.497787143782138, 6.283185307179586]
        values = [0, 0.0015, 0.005, 0.0085, 0.01, 0.0085, 0.005, 0.0015, 0]
        interpolation = "cubic"
        extrapolation = "periodic"
    "#;
    for mechanism in both_formulations(text) {
        let knots = rows(&mechanism, &grid(std::f64::consts::TAU / 20.0, 8));
        for (row, expected) in knots.iter().zip([0.0, 0.0015, 0.005, 0.0085, 0.01, 0.0085, 0.005, 0.0015, 0.0]) {
            assert_close(row[0], expected, 1e-12);
        }
    }
}

#[test]
fn a_singular_start_is_no_redundancy() {
    let text = r#"
        bodies.one = { mass = 1, inertia = 0.1, position = [0.5, 0], points = { left = [-0.5, 0], right = [0.5, 0] } }
        bodies.two = { mass = 1, inertia = 0.1, position = [2, 0], points = { left = [-1, 0], right = [1, 0] } }
        bodies.three = { mass = 1, inertia = 0.1, position = [3.5, 0], points = { left = [-0.5, 0], right = [0.5, 0] } }
        ground.points.end = [4, 0]
        joints.a = { type = "revolute", between = ["ground", "one.left"] }
        joints.b = { type = "revolute", between = ["one.right", "two.left"] }
        joints.c = { type = "revolute", between = ["two.right", "three.left"] }
        joints.d = { type = "revolute", between = ["three.right", "ground.end"] }
        outputs.x = { measure = "two.x" }
    "#;
    let message = refused(text);
    assert!(message.contains("`joints.d` depends on the joints and drivers before it"), "{message}");
}
