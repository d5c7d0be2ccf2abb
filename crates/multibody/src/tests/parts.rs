//! Couplings, stops, bushings, spring forces and variables against closed forms, in both formulations.

use super::*;
use std::f64::consts::PI;

/// A torque `T` on a pinion of inertia `J` that moves a rack of mass `m`: `(J + m r²) φ'' = T`, with the force `m r φ''` between both.
#[test]
fn a_rack_follows_its_pinion() {
    let text = r#"
        parameters = { r = { default = 0.2 }, J = { default = 0.3 }, m = { default = 5 } }
        bodies.pinion = { mass = 1, inertia = "J" }
        bodies.rack = { mass = "m" }
        joints.shaft = { type = "revolute", between = ["ground", "pinion"] }
        joints.rail = { type = "prismatic", between = ["ground", "rack"], axis = [1, 0] }
        couplings.teeth = { coordinate = "rail.position", follows = "r*shaft.angle" }
        actuators.motor = { coordinate = "shaft.angle", effort = 0.7 }
        initial.shaft = { angle = 0, angular_velocity = 1 }
        outputs = { angle = { measure = "shaft.angle" }, x = { measure = "rail.position" }, force = { measure = "teeth.effort" } }
    "#;
    let acceleration = 0.7 / (0.3 + 5.0 * 0.04);
    for mechanism in both_formulations(text) {
        assert_eq!(mechanism.summary(), "2 bodies, 2 joints, 1 coupling, 1 degree of freedom");
        for (row, t) in rows(&mechanism, &grid(3.0, 6)).iter().zip(grid(3.0, 6)) {
            let angle = t + 0.5 * acceleration * t * t;
            assert_close(row[0], angle, 1e-11 * (1.0 + angle));
            assert_close(row[1], 0.2 * angle, 1e-11 * (1.0 + angle));
            assert_close(row[2], 5.0 * 0.2 * acceleration, 1e-10);
        }
    }
}

/// A cylinder whose pressure `p` follows a valve, `p' = (u - p)/tau`, pushes a mass of 1 kg: `x'' = p`.
#[test]
fn an_actuator_state_follows_its_rate() {
    let text = r#"
        parameters = { tau = { default = 0.3 }, p0 = { default = 2 } }
        inputs.u = { min = -5, max = 5, start = 0.5 }
        states.p = { rate = "(u - p)/tau", start = "2*p0", unit = "bar" }
        bodies.mass = { mass = 1 }
        joints.rail = { type = "prismatic", between = ["ground", "mass"], axis = [1, 0] }
        actuators.cylinder = { coordinate = "rail.position", effort = "p" }
        springs.gauge = { coordinate = "rail.position", force = "p - p" }
        initial.rail = { position = 0.1, velocity = -0.2 }
        outputs = { x = { measure = "rail.position" }, p = { measure = "p" }, power = { formula = "p*rail.velocity", unit = "W" } }
    "#;
    let (u, tau, p0) = (0.5, 0.3, 4.0);
    for mechanism in both_formulations(text) {
        assert_eq!(mechanism.summary(), "1 body, 1 joint, 1 degree of freedom, 1 actuator state");
        let units: Vec<&str> = mechanism.outputs().iter().map(|output| output.unit.as_str()).collect();
        assert_eq!(units, ["m", "bar", "W"]);
        for (row, t) in rows(&mechanism, &grid(2.0, 8)).iter().zip(grid(2.0, 8)) {
            let decay = (-t / tau).exp();
            let (p, v) = (u + (p0 - u) * decay, -0.2 + u * t + (p0 - u) * tau * (1.0 - decay));
            let x = 0.1 - 0.2 * t + 0.5 * u * t * t + (p0 - u) * tau * (t - tau * (1.0 - decay));
            for (found, expected) in row.iter().zip([x, p, p * v]) {
                assert_close(*found, expected, 1e-11);
            }
        }
    }
}

#[test]
fn a_state_that_is_too_fast_is_named() {
    let text = r#"
        inputs.u = { min = -5, max = 5, start = 1 }
        states.current = { rate = "(u - current)/1e-8 + 1e10*sin(1e9*time)" }
        bodies.a = { mass = 1, inertia = 1 }
        joints.p = { type = "revolute", between = ["ground", "a"] }
        actuators.m = { coordinate = "p.angle", effort = "current" }
        outputs.i = { measure = "current" }
    "#;
    let mechanism = parse(text);
    let message = mechanism.simulate(&[], &grid(10.0, 3), TOLERANCE, &Budget::default()).unwrap_err().message;
    assert!(
        message.contains("the motion is too fast; the stiffest part is `states.current`, 1.0e8 rad/s"),
        "{message}"
    );
}

/// An arm whose motion is given leaves nothing free; its brake warms up by a constant power and cools: `T' = 3 - T/5`.
#[test]
fn an_actuator_state_needs_no_degree_of_freedom() {
    let text = r#"
        states.T = { rate = "abs(arm.angular_velocity) - T/5", start = 1 }
        bodies.arm = { mass = 1, inertia = 1 }
        joints.pivot = { type = "revolute", between = ["ground", "arm"] }
        drivers.motor = { coordinate = "pivot.angle", motion = "-3*time" }
        outputs = { T = { measure = "T" }, angle = { measure = "pivot.angle" } }
    "#;
    for mechanism in both_formulations(text) {
        for (row, t) in rows(&mechanism, &grid(4.0, 5)).iter().zip(grid(4.0, 5)) {
            assert_close(row[0], 15.0 - 14.0 * (-t / 5.0).exp(), 1e-11);
            assert_close(row[1], -3.0 * t, 1e-12);
        }
    }
}

/// A heavy follower on a cam that turns freely: `J(φ) = J0 + m l'(φ)²` and energy is kept; the lift is a sine or a periodic spline.
#[test]
fn a_follower_on_a_cam_keeps_the_energy() {
    let with_lift = |lift: &str| {
        format!(
            r#"
            gravity = [0, -9.81]
            bodies.cam = {{ mass = 1, inertia = 0.02 }}
            bodies.follower = {{ mass = 0.4 }}
            joints.shaft = {{ type = "revolute", between = ["ground", "cam"] }}
            joints.guide = {{ type = "prismatic", between = ["ground", "follower"], axis = [0, 1] }}
            couplings.contact = {{ coordinate = "guide.position", follows = "{lift}" }}
            initial.shaft = {{ angle = 0.2, angular_velocity = 12 }}
            outputs = {{ angle = {{ measure = "shaft.angle" }}, speed = {{ measure = "shaft.angular_velocity" }}, y = {{ measure = "guide.position" }} }}
            [tables.lift]
            x = [0, 1, 2, 3, 4, 5, 6, "TAU"]
            values = [0.05, 0.06, 0.09, 0.1, 0.08, 0.06, 0.052, 0.05]
            interpolation = "cubic"
            extrapolation = "periodic"
            "#
        )
        .replace("\"TAU\"", &(2.0 * PI).to_string())
    };
    for mechanism in both_formulations(&with_lift("0.05*sin(shaft.angle)")) {
        let rows = rows(&mechanism, &grid(2.0, 40));
        let energy = |row: &Vec<f64>| {
            let [angle, speed, y] = row[..] else { unreachable!() };
            assert_close(y, 0.05 * angle.sin(), 1e-10);
            0.5 * (0.02 + 0.4 * (0.05 * angle.cos()).powi(2)) * speed * speed + 0.4 * 9.81 * y
        };
        rows.iter().for_each(|row| assert_close(energy(row), energy(&rows[0]), 1e-10));
    }
    for mechanism in both_formulations(&with_lift("lift(shaft.angle)")) {
        let (model, samples) = run(&mechanism, &[], &grid(2.0, 40));
        let energy = |s: &Sample| model.kinetic_energy(&s.v) + model.potential_energy(&s.q);
        samples.iter().for_each(|s| assert_close(energy(s), energy(&samples[0]), 1e-8));
    }
}

/// A puck of mass `m` between two stops: half a period of `sqrt(k / m)` in contact with each.
#[test]
fn a_puck_returns_from_a_stop() {
    let text = r#"
        bodies.puck = { mass = 0.5 }
        joints.rail = { type = "prismatic", between = ["ground", "puck"], axis = [1, 0] }
        stops.ends = { coordinate = "rail.position", min = -1, max = 1, stiffness = 2e3 }
        initial.rail = { position = 0, velocity = 2 }
        outputs = { x = { measure = "rail.position" } }
    "#;
    let contact = PI / (2e3f64 / 0.5).sqrt();
    for mechanism in both_formulations(text) {
        for (row, t) in rows(&mechanism, &grid(3.0, 300)).iter().zip(grid(3.0, 300)) {
            // from the middle to the middle, with a contact between
            let (passes, t) = ((t / (1.0 + contact)).floor(), t % (1.0 + contact));
            let x = match t {
                ..0.5 => 2.0 * t,
                t if t < 0.5 + contact => 1.0 + 2.0 / (2e3f64 / 0.5).sqrt() * (PI * (t - 0.5) / contact).sin(),
                t => 2.0 * (1.0 + contact - t),
            };
            assert_close(row[0], if passes % 2.0 == 0.0 { x } else { -x }, 1e-9);
        }
    }
    let damped = text.replace("stiffness = 2e3", "stiffness = 2e3, damping = 0.5");
    for mechanism in both_formulations(&damped) {
        let found = rows(&mechanism, &grid(0.8, 8));
        let speed = (found[7][0] - found[8][0]) / 0.1;
        // of velocity v and damping d the rebound solves dv = ln(|(1 + d v0) / (1 - d v)|): never faster, never stuck
        let [v0, d] = [2.0, 0.5f64];
        assert_close(d * (v0 + speed), ((1.0 + d * v0) / (1.0 - d * speed)).ln(), 1e-6);
    }
}

/// A block on a bushing moves along `x`, along `y` and about itself as three oscillators.
#[test]
fn a_bushing_is_a_spring_in_each_direction() {
    let text = r#"
        bodies.block = { mass = 2, inertia = 0.1, position = [0.1, -0.2], angle = 0.3 }
        bushings.mount = { between = ["ground", "block"], stiffness = [50, 80, 3], damping = [0, 2, 0], angle = 0.1 }
        initial.block = { x = 0.1, y = -0.2, angle = 0.3 }
        outputs.x = { measure = "block.x" }
        outputs.y = { measure = "block.y" }
        outputs.angle = { measure = "block.angle" }
        outputs.fx = { measure = "mount.fx" }
        outputs.moment = { measure = "mount.moment" }
        outputs.along = { measure = "mount.x" }
    "#;
    for mechanism in both_formulations(text) {
        for (row, t) in rows(&mechanism, &grid(2.0, 8)).iter().zip(grid(2.0, 8)) {
            assert_close(row[0], 0.1 * (25.0f64.sqrt() * t).cos(), 1e-10);
            let (decay, frequency) = (0.5, (40.0f64 - 0.25).sqrt());
            let y = (-decay * t).exp() * ((frequency * t).cos() + decay / frequency * (frequency * t).sin());
            assert_close(row[1], -0.2 * y, 1e-10);
            assert_close(row[2], 0.1 + 0.2 * (30.0f64.sqrt() * t).cos(), 1e-10);
            assert_close(row[3], -50.0 * row[0], 1e-10);
            assert_close(row[4], -3.0 * (row[2] - 0.1), 1e-10);
            assert_close(row[5], row[0], 1e-15);
        }
    }
}

#[test]
fn the_force_of_a_spring_is_a_formula_and_variables_stand_for_expressions() {
    let part = |spring: &str| {
        format!(
            r#"
            parameters.k = {{ default = 40 }}
            inputs.u = {{ min = 0, max = 2, start = 1.5 }}
            bodies.mass = {{ mass = 1, inertia = 1, position = [0.21, 0.28] }}
            joints.rail = {{ type = "prismatic", between = ["ground", "mass"], axis = [0.6, 0.8] }}
            {spring}
            initial.rail = {{ position = 0.35, velocity = 0 }}
            outputs.r = {{ measure = "rail.position" }}
            "#
        )
    };
    let with_spring = part(
        r#"
        springs.strut = { between = ["ground", "mass"], stiffness = 10, rest = 0.2, force = "cubic - u*strut.velocity" }
        variables = { cubic = "-k*stretch^3", stretch = "strut.length - free", free = 0.2 }
        outputs.force = { measure = "strut.force" }
        "#,
    );
    let by_hand = part(
        r#"
        springs.linear = { coordinate = "rail.position", stiffness = 10, rest = 0.2 }
        actuators.strut = { coordinate = "rail.position", effort = "-k*(rail.position - 0.2)^3 - u*rail.velocity" }
        outputs.linear = { measure = "linear.force" }
        "#,
    );
    for (found, expected) in both_formulations(&with_spring).iter().zip(both_formulations(&by_hand)) {
        let times = grid(2.0, 20);
        for (found, expected) in rows(found, &times).iter().zip(rows(&expected, &times)) {
            let r = expected[1];
            assert_close(found[1], r, 1e-11);
            assert_close(expected[0], -10.0 * (r - 0.2), 1e-12);
            let largest = (found[0] - expected[0] + 40.0 * (r - 0.2f64).powi(3)).abs();
            assert!(largest < 1.5 * 2.0, "{largest}");
        }
    }
}

#[test]
fn mistakes_in_these_parts_say_what_was_expected() {
    let text = r#"
        parameters.r = { default = 0.2 }
        bodies.a = { mass = 1, inertia = 1 }
        bodies.b = { mass = 1, inertia = 1 }
        joints.p = { type = "revolute", between = ["ground", "a"] }
        joints.s = { type = "prismatic", between = ["ground", "b"], axis = [1, 0] }
        couplings.c = { coordinate = "s.position", follows = "r*p.angle" }
        stops.t = { coordinate = "s.position", min = -1, max = 1, stiffness = 1e3 }
        variables = { v = "2*r", w = "v + p.angle" }
        actuators.m = { coordinate = "p.angle", effort = "w" }
        outputs.x = { measure = "s.position" }
    "#;
    parse(text);
    for (from, to, says) in [
        (
            "r*p.angle",
            "r*p.angular_velocity",
            "couplings.c.follows: `r*p.angular_velocity`: `p.angular_velocity` is not a position",
        ),
        ("r*p.angle", "r*time", "couplings.c.follows: `r*time`: no `time`, expected one of r, v"),
        (
            "follows = \"r*p.angle\"",
            "follow = 1",
            "couplings.c.follow: unknown key `follow`, expected coordinate or follows; did you mean `follows`?",
        ),
        (
            "coordinate = \"s.position\", follows",
            "coordinate = \"s.angle\", follows",
            "couplings.c.coordinate: `s` has no `angle`",
        ),
        ("r*p.angle", "2*s.position", "couplings.c.follows: `2*s.position` names the coordinate itself"),
        ("min = -1, max = 1", "min = 1, max = 1", "stops.t.min: 1 is not below max 1"),
        ("min = -1, max = 1, ", "", "stops.t: neither `min` nor `max`, expected at least one of them"),
        ("stiffness = 1e3", "stiffness = -1", "stops.t.stiffness: -1, expected zero or more"),
        ("v = \"2*r\"", "v = \"2*w\"", "variables.v: `2*w` depends on the variable itself"),
        ("v = \"2*r\"", "r = \"2*r\"", "variables.r: `r` is the name of parameters already"),
        ("effort = \"w\"", "effort = \"q\"", "actuators.m.effort: `q`: no `q`, expected one of r, v, w, time"),
        ("s.position\" }", "c.force\" }", "outputs.x.measure: `c` has no `force`, expected one of effort"),
    ] {
        assert!(text.contains(from), "{from}");
        let message = refused(&text.replace(from, to));
        assert!(message.contains(says), "{message}\n{says}");
    }
}

#[test]
fn mistakes_in_states_and_formulas_are_reported() {
    let text = r#"
        parameters.R = { default = 0.5 }
        inputs.u = { min = -5, max = 5 }
        states.current = { rate = "(u - R*current)/0.1", start = "R" }
        bodies.a = { mass = 1, inertia = 1 }
        joints.p = { type = "revolute", between = ["ground", "a"] }
        actuators.m = { coordinate = "p.angle", effort = "current" }
        outputs = { i = { measure = "current" }, power = { formula = "u*current" } }
    "#;
    parse(text);
    for (from, to, says) in [
        ("rate = \"(u", "rates = \"(u", "states.current.rates: unknown key `rates`"),
        (
            "rate = \"(u - R*current)/0.1\"",
            "rate = \"(u - R*curent)/0.1\"",
            "no `curent`, expected one of R, u, current, time; did you mean `current`?",
        ),
        ("start = \"R\"", "start = \"u\"", "states.current.start: `u`: no parameter `u`, expected one of R"),
        ("start = \"R\"", "start = \"1/0\"", "states.current.start"),
        ("states.current", "states.R", "states.R: `R` is the name of parameters already"),
        ("states.current", "states.\"a.b\"", "states.a.b: `a.b` is not a valid name"),
        (
            "measure = \"current\"",
            "measure = \"curent\"",
            "outputs.i.measure: `curent` is not a measure, expected for instance `BODY.angle`, expected one of current; did you mean `current`?",
        ),
        (
            "measure = \"current\"",
            "measure = \"current\", formula = \"u\"",
            "outputs.i: both of `measure` and `formula`, expected one of them",
        ),
        (
            "formula = \"u*current\"",
            "unit = \"W\"",
            "outputs.power: neither of `measure` and `formula`, expected one of them",
        ),
        ("u*current", "u*p.speed", "outputs.power.formula: `u*p.speed`: `p` has no `speed`"),
        ("measure = \"current\"", "measure = \"current\", unit = \"A\"", "outputs.i.unit: `A`, expected none"),
        (
            "effort = \"current\"",
            "effort = \"current\" }\n drivers.d = { coordinate = \"p.angle\", motion = \"current\"",
            "drivers.d.motion: `current`: no `current`, expected one of R, time",
        ),
    ] {
        assert!(text.contains(from), "{from}");
        let message = refused(&text.replace(from, to));
        assert!(message.contains(says), "{message}\n{says}");
    }
}

/// A damper's table in a file is the table in the mechanism file.
#[test]
fn tables_are_read_from_files() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("damper.csv", "speed,force,other\n-1,-800,3\n0,0,4\n0.5,300,5\n2,900,6\n");
    write("letters.csv", "speed,force\n-1,-800\n0,none\n");
    write("falling.csv", "speed,force\n0,1\n-1,2\n");
    write("narrow.csv", "speed\n0\n1\n");
    write("map.csv", "load,speed,force\n1,2,900\n0,0,0\n0,-1,-800\n1,-1,-80\n1,0,0\n0,2,90\n");
    write("twice.csv", "load,speed,force\n0,1,5\n0,0,0\n0,1,5\n");
    write("gap.csv", "load,speed,force\n0,0,0\n0,1,1\n1,1,1\n");
    let text = |table: &str| {
        let of_two = if table.contains("load") || table.contains("y = ") { ", 0.3*time" } else { "" };
        format!(
            r#"
            bodies.a = {{ mass = 1, inertia = 1 }}
            joints.s = {{ type = "prismatic", between = ["ground", "a"], axis = [1, 0] }}
            actuators.damper = {{ coordinate = "s.position", effort = "-f(s.velocity{of_two})/500" }}
            initial.s = {{ position = 0, velocity = 3 }}
            outputs.v = {{ measure = "s.velocity" }}
            [tables.f]
            {table}
            "#
        )
    };
    let parse = |table: &str| Mechanism::parse(&text(table), &folder.path().join("m.toml"));
    let last = |table: &str| rows(&parse(table).unwrap(), &grid(1.0, 4)).pop().unwrap();
    let expected = last("x = [-1, 0, 0.5, 2]\nvalues = [-800, 0, 300, 900]");
    assert_eq!(last("file = \"damper.csv\""), expected);
    assert_eq!(last("file = \"damper.csv\"\ncolumns = [\"speed\", \"force\"]"), expected);
    assert_ne!(last("file = \"damper.csv\"\ncolumns = [\"speed\", \"other\"]"), expected);
    let map = "columns = [\"speed\", \"load\", \"force\"]";
    let grid_of_numbers = "x = [-1, 0, 2]\ny = [0, 1]\nvalues = [[-800, -80], [0, 0], [90, 900]]";
    assert_eq!(last(&format!("file = \"map.csv\"\n{map}")), last(grid_of_numbers));
    for (table, says) in [
        (
            "file = \"twice.csv\"\ncolumns = [\"speed\", \"load\", \"force\"]",
            "twice.csv:4: speed = 1, load = 0: a second row, expected one for each pair",
        ),
        (
            "file = \"gap.csv\"\ncolumns = [\"speed\", \"load\", \"force\"]",
            "gap.csv:1: no row with speed = 0, load = 1, expected one for each pair",
        ),
        ("file = \"map.csv\"\ncolumns = [\"load\"]", "tables.f.columns: "),
        ("file = \"none.csv\"", "tables.f.file: "),
        ("file = \"letters.csv\"", "letters.csv:3: column `force`: `none`, expected a finite number"),
        ("file = \"falling.csv\"", "tables.f.file: element 2: -1 is not above 0, expected ascending knots"),
        ("file = \"narrow.csv\"", "one column, expected one of knots and one of values"),
        (
            "file = \"damper.csv\"\ncolumns = [\"sped\", \"force\"]",
            "no column `sped`, expected it among speed, force, other; did you mean `speed`?",
        ),
        ("file = \"damper.csv\"\nx = [1, 2]", "m.toml:9: tables.f.x: belongs to tables without a `file`"),
        (
            "x = [1, 2]\nvalues = [1, 2]\ncolumns = [\"a\", \"b\"]",
            "m.toml:10: tables.f.columns: belongs to tables with a `file`",
        ),
        ("x = [1, 2]", "m.toml:7: tables.f: no `values`, expected `x` and `values`, or a `file`"),
    ] {
        let message = parse(table).unwrap_err().to_string();
        assert!(message.contains(says), "{message}\n{says}");
    }
}

/// Equilibria have closed forms: a mass on a spring, a pendulum that hangs down wherever it is guessed, and a body on two inclined springs.
#[test]
fn a_run_starts_in_the_static_equilibrium() {
    let oscillator = r#"
        equilibrium = true
        gravity = [0, -9.81]
        bodies.mass = { mass = 2, position = [0, 0.3] }
        joints.guide = { type = "prismatic", between = ["ground", "mass"], axis = [0, 1] }
        springs.s = { coordinate = "guide.position", stiffness = 500, damping = 3 }
        outputs = { y = { measure = "guide.position" }, v = { measure = "guide.velocity" }, a = { measure = "guide.acceleration" } }
    "#;
    for mechanism in both_formulations(oscillator) {
        for row in rows(&mechanism, &grid(1.0, 3)) {
            assert_close(row[0], -2.0 * 9.81 / 500.0, 1e-14);
            assert_close(row[1], 0.0, 1e-13);
            assert_close(row[2], 0.0, 1e-11);
        }
    }
    for angle in [0.4, 1.5, -2.0, 3.0] {
        let pendulum = format!(
            r#"
            equilibrium = true
            gravity = [0, -9.81]
            inputs.torque = {{ min = -2, max = 2, start = 0.7 }}
            bodies.rod = {{ mass = 1, inertia = 0.01, position = [0, -0.2], angle = {angle}, points = {{ top = [0, 0.2] }} }}
            joints.pivot = {{ type = "revolute", between = ["ground", "rod.top"] }}
            actuators.motor = {{ coordinate = "pivot.angle", effort = "torque" }}
            outputs = {{ sine = {{ measure = "rod.x" }}, y = {{ measure = "rod.y" }} }}
        "#
        );
        for mechanism in both_formulations(&pendulum) {
            let row = rows(&mechanism, &[0.0]).remove(0);
            // m g x = torque, below the pivot
            assert_close(row[0], 0.7 / 9.81, 1e-12);
            assert_close(row[1], -(0.04 - (0.7f64 / 9.81).powi(2)).sqrt(), 1e-12);
        }
    }
    // a chain between two walls, whose middle is pulled down: symmetric, and the tension follows from the angle
    let rope = r#"
        equilibrium = true
        gravity = [0, -9.81]
        ground.points = { left = [-1, 0], right = [1, 0] }
        bodies.bead = { mass = 3, inertia = 0.1, position = [0.2, -0.4] }
        springs.a = { between = ["ground.left", "bead"], stiffness = 100, rest = 0.8 }
        springs.b = { between = ["ground.right", "bead"], stiffness = 100, rest = 0.8 }
        outputs = { x = { measure = "bead.x" }, y = { measure = "bead.y" }, force = { measure = "a.force" } }
    "#;
    let row = rows(&parse(rope), &[0.0]).remove(0);
    let length = (1.0 + row[1] * row[1]).sqrt();
    assert_close(row[0], 0.0, 1e-12);
    assert_close(2.0 * row[2] * row[1] / length, 3.0 * 9.81, 1e-9);
    // nothing holds it
    let falling =
        oscillator.replace("springs.s = { coordinate = \"guide.position\", stiffness = 500, damping = 3 }", "");
    let message = refused(&falling);
    let decided = refused(&format!("{oscillator}initial.guide.position = 0.1"));
    assert!(decided.contains("m.toml:2: equilibrium: no position is free to settle"), "{decided}");
    assert!(message.contains("m.toml:2: equilibrium: no static equilibrium is found"), "{message}");
}
