//! Contacts of points and circles with lines, in both formulations.

use super::*;

/// A ball of mass `m` falls on a ramp without friction: across the ramp it flies and is an oscillator by turns, along it nothing stops it.
#[test]
fn a_ball_bounces_on_a_ramp() {
    let text = r#"
        gravity = [0, -10]
        ground.points = { low = [1, 1], high = [9, 7] }
        bodies.ball = { mass = 0.5, inertia = 0.01, position = [4, 4.25], points = { rim = [0.3, 0] } }
        contacts.ramp = { point = "ball", line = ["ground.low", "ground.high"], radius = 0.25, stiffness = 2e3 }
        initial.ball = { x = 4, y = 4.25 }
        outputs = { x = { measure = "ball.x" }, y = { measure = "ball.y" }, n = { measure = "ramp.fy" }, along = { formula = "ramp.x", unit = "m" }, height = { formula = "ramp.y", unit = "m" } }
    "#;
    // the ramp rises 3 in 4: gravity has 8 across it and 6 along it
    let (k, m, g, drop): (f64, f64, f64, f64) = (2e3, 0.5, 8.0, 4.0 / 5.0 * 3.25 - 3.0 / 5.0 * 3.0 - 0.25);
    let (fall, speed) = ((2.0 * drop / g).sqrt(), (2.0 * drop * g).sqrt());
    let omega = (k / m).sqrt();
    // depth d'' = g - omega² d from d = 0, d' = speed, until d is 0 again
    let [offset, swing] = [g / (omega * omega), speed / omega];
    let contact = 2.0 * (std::f64::consts::PI - (swing / offset).atan()) / omega;
    for mechanism in both_formulations(text) {
        for (row, t) in rows(&mechanism, &grid(1.5, 150)).iter().zip(grid(1.5, 150)) {
            let [x, y, normal, along, height] = row[..] else { unreachable!() };
            assert_close(along, (x - 1.0) * 0.8 + (y - 1.0) * 0.6, 1e-12);
            assert_close(height, (y - 1.0) * 0.8 - (x - 1.0) * 0.6, 1e-12);
            assert_close(along, 0.8 * 3.0 + 0.6 * 3.25 - 3.0 * t * t, 1e-9);
            let phase = (t + fall) % (2.0 * fall + contact);
            let flies = phase < 2.0 * fall;
            let since = phase - 2.0 * fall;
            let depth = if flies {
                -(drop - 0.5 * g * (phase - fall).powi(2))
            } else {
                offset * (1.0 - (omega * since).cos()) + swing * (omega * since).sin()
            };
            assert_close(height, 0.25 - depth, 1e-9);
            assert_close(normal, if flies { 0.0 } else { k * depth }, 1e-5);
        }
    }
}

/// A disc rolls down a ramp at two thirds of what it would have without friction, and creeps: `m a = m g sin - F`, `m r² / 2 · a / r = F r`.
#[test]
fn a_disc_rolls_down_a_ramp() {
    let text = r#"
        gravity = [0, -10]
        parameters = { r = { default = 0.2 } }
        ground.points = { right = [4, 3], left = [0, 0] }
        bodies.disc = { mass = 2, inertia = "0.5*2*r^2", position = ["-0.6*(r - 16/2e4)", "0.8*(r - 16/2e4)"] }
        contacts.ramp = { point = "disc", line = ["ground.left", "ground.right"], radius = "r", stiffness = 2e4, damping = 1, friction = 0.8, slip = 0.01 }
        initial.disc = { x = "-0.6*(r - 16/2e4)", y = "0.8*(r - 16/2e4)" }
        outputs = { speed = { formula = "ramp.vx", unit = "m/s" }, slip = { formula = "ramp.vx + r*ramp.angular_velocity", unit = "m/s" }, f = { measure = "ramp.fx" }, n = { measure = "ramp.fy" } }
    "#;
    let (weight, push) = (16.0f64, 4.0f64);
    for mechanism in both_formulations(text) {
        let rows = rows(&mechanism, &grid(1.0, 10));
        for (before, row) in rows[4..].iter().zip(&rows[5..]) {
            let [speed, slip, friction, normal] = row[..] else { unreachable!() };
            assert_close(normal, weight, 1e-9);
            // the slip's own rate is 1700/s: its error of 1e-11 m/s is 3e-8 N
            assert_close(friction, push, 1e-7);
            assert_close(slip, -0.01 * (push / (0.8 * weight)).atanh(), 1e-10);
            assert_close((speed - before[0]) / 0.1, -(2.0 * 6.0 - push) / 2.0, 1e-8);
        }
    }
}

/// A disc that spins falls on a plank that floats freely: what acts on one acts on the other, so that both momenta stay.
#[test]
fn contacts_keep_momenta() {
    let text = r#"
        bodies.plank = { mass = 3, inertia = 0.4, points = { a = [-1, 0.1], b = [1, 0.1] } }
        bodies.disc = { mass = 1, inertia = 0.02, position = [0.3, 0.5], velocity = [0.2, -1], angular_velocity = 9 }
        contacts.top = { point = "disc", line = ["plank.a", "plank.b"], radius = 0.2, stiffness = 5e3, damping = 0.2, friction = 0.5, slip = 0.02 }
        outputs.f = { measure = "top.fx" }
    "#;
    for mechanism in both_formulations(text) {
        let (model, samples) = run(&mechanism, &[], &grid(1.0, 50));
        let momenta = |s: &Sample| {
            let momentum = model.mass.component_mul(&s.v);
            let [mut px, mut py, mut angular] = [0.0; 3];
            for (p, q) in momentum.as_slice().chunks(3).zip(s.q.as_slice().chunks(3)) {
                px += p[0];
                py += p[1];
                angular += p[2] + q[0] * p[1] - q[1] * p[0];
            }
            [px, py, angular]
        };
        let first = momenta(&samples[0]);
        assert!(samples.iter().any(|s| (s.v[5] - 9.0).abs() > 1.0), "the disc has to be braked");
        for sample in &samples {
            for (found, expected) in momenta(sample).into_iter().zip(first) {
                assert_close(found, expected, 1e-10);
            }
        }
    }
}

#[test]
fn mistakes_in_contacts_are_named() {
    let text = r#"
bodies = { a = { mass = 1, inertia = 1, points = { p = [1, 0], q = [2, 0] } }, b = { mass = 1, inertia = 1 } }
outputs = { x = { measure = "a.x" } }
[contacts]
"#;
    for (contact, expected) in [
        (
            r#"c = { point = "a.p", line = ["a", "a.q"], stiffness = 1 }"#,
            "contacts.c.point: point and line belong to the same body",
        ),
        (
            r#"c = { point = "a.p", line = ["ground", "b"], stiffness = 1 }"#,
            "contacts.c.line: the points belong to two bodies",
        ),
        (
            r#"c = { point = "a.p", line = ["b", "b"], stiffness = 1 }"#,
            "contacts.c.line: both points are in the same place",
        ),
        (r#"c = { point = "a.pp", line = ["b", "b"], stiffness = 1 }"#, "`a` has no point `pp`"),
        (r#"c = { point = "a.p", line = ["ground", "ground.w"], stiffness = 1 }"#, "`ground` has no point `w`"),
        (r#"c = { point = "b", line = ["a.p", "a.q"], stiffness = 1, friction = 0.3 }"#, "contacts.c: no `slip`"),
        (
            r#"c = { point = "b", line = ["a.p", "a.q"], stiffness = 1, friction = 0.3, slip = 0 }"#,
            "contacts.c.slip: 0, expected a speed above zero",
        ),
        (
            r#"c = { point = "b", line = ["a.p", "a.q"], stiffness = -1 }"#,
            "contacts.c.stiffness: -1, expected zero or more",
        ),
        (
            r#"a = { point = "b", line = ["a.p", "a.q"], stiffness = 1 }"#,
            "contacts.a: `a` is the name of bodies already",
        ),
        (r#"c = { point = "b", line = ["a.p", "a.q"], stifness = 1 }"#, "stiffness"),
    ] {
        let error = refused(&format!("{text}{contact}\n"));
        assert!(error.contains(expected), "{contact}: {error}");
    }
}
