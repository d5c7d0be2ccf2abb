//! Messages about mistakes in a mechanism and about failures in a run.

use super::*;

#[test]
fn mistakes_in_a_description_are_located_and_say_what_was_expected() {
    for (from, to, says) in [
        ("mass = \"m\"", "mass = \"n\"", "m.toml:16: bodies.rod.mass: `n`: no parameter `n`, expected one of L, c"),
        ("mass = \"m\"", "mass = \"-m\"", "bodies.rod.mass: `-m` is -0.3, expected zero or more"),
        ("mass = \"m\"", "mass = \"m/0\"", "bodies.rod.mass: `m/0` is inf"),
        ("mass = \"m\"", "mass = \"m*\"", "bodies.rod.mass: `m*`: found the end"),
        ("mass = \"m\"", "mas = 1", "bodies.rod.mas: unknown key `mas`, expected one of mass"),
        ("mass = \"m\"", "mass = true", "bodies.rod.mass: true, expected a number or an expression in quotes"),
        ("\"rod.top\"", "\"rod.tip\"", "joints.pivot.between: `rod` has no point `tip`, expected one of top"),
        ("\"rod.top\"", "\"bar.top\"", "joints.pivot.between: no body `bar`, expected one of rod, ground"),
        ("\"ground\"", "\"rod\"", "joints.pivot.between: both points belong to the same body"),
        ("\"revolute\"", "\"hinge\"", "joints.pivot.type: \"hinge\", expected one of \"revolute\""),
        ("\"revolute\"", "\"prismatic\"", "joints.pivot: a prismatic joint needs an `axis`"),
        ("\"revolute\"", "\"revolute\"\naxis = [1, 0]", "joints.pivot.axis: belongs to prismatic joints"),
        ("coordinate = \"pivot.angle\"", "", "springs.damper: expected either `between` or `coordinate`"),
        (
            "coordinate = \"pivot.angle\"",
            "coordinate = \"pivot.position\"",
            "`pivot` has no `position`, expected one of",
        ),
        ("measure = \"rod.x\"", "measure = \"rod.z\"", "outputs.x.measure: `rod` has no `z`"),
        (
            "measure = \"rod.x\"",
            "measure = \"rod.top\"",
            "`rod.top` is a point, expected a component such as `rod.top.x`",
        ),
        ("measure = \"rod.x\"", "measure = \"rod.x\", unit = \"mm\"", "outputs.x.unit: `mm`, expected `m`"),
        ("[springs.damper]", "[springs.rod]", "springs.rod: `rod` is the name of bodies already"),
        ("\nm = {", "\ntime = {", "parameters.time: `time` is the name of the time already"),
        ("rod.angle = ", "rod.ax = ", "initial.rod.ax: `rod.ax` is neither a position nor a velocity"),
        ("[0, \"-g\"]", "[0, 0, \"-g\"]", "m.toml:5: gravity: a list of 3, expected a list of 2"),
        ("[0, \"L\"]", "[0]", "bodies.rod.points.top: a list of 1, expected a list of 2"),
        ("\"rod.top\"]", "\"rod.top\", \"rod\"]", "joints.pivot.between: a list of 3, expected a list of 2"),
        ("min = 0.1, max = 0.2", "min = 0.1", "parameters.L.min: expected a `max` as well"),
        ("min = 0.1, max = 0.2", "max = 0.1", "parameters.L.max: expected a `min` as well"),
        ("min = 0.1, max = 0.2", "min = 0.2, max = 0.1", "parameters.L.min: range is empty"),
        ("default = 0.15", "default = 0.25", "parameters.L.default: 0.25 is outside the range from 0.1 to 0.2"),
        ("theta = {", "L = {", "outputs.L: `L` is a parameter already"),
        ("theta = {", "time = {", "outputs.time: `time` is the name of the time already"),
        ("theta = {", "\"theta 1\" = {", "`theta 1` is not a valid name: expected a letter or `_`"),
        ("damping = \"c*L\"", "damping = -0.1", "springs.damper.damping: -0.1, expected zero or more"),
        ("damping = \"c*L\"", "stiffness = \"-c\"", "springs.damper.stiffness: `-c` is -0.05, expected zero or more"),
        ("damping = \"c*L\"", "rest = 1", "springs.damper: none of `stiffness`, `damping` and `force`"),
        ("coordinate = \"pivot.angle\"", "between = [\"rod\", \"rod.top\"]", "both points belong to the same body"),
        ("coordinate = \"pivot.angle\"", "coordinate = \"ground.x\"", "`ground.x` belongs to the ground"),
        (
            "coordinate = \"pivot.angle\"",
            "between = [\"ground\", \"rod\"]\nrest = -1",
            "springs.damper.rest: -1, expected zero or more",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 2, 1]\nvalues = [1, 2, 3]\n[initial]",
            "m.toml:29: tables.cam.x: element 3: 1 is not above 2, expected ascending knots",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0]\nvalues = [1]\n[initial]",
            "tables.cam.x: a list of 1, expected two or more",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1]\nvalues = [1]\n[initial]",
            "tables.cam.values: 1, expected 2, one for each `x`",
        ),
        (
            "[initial]",
            "[tables.map]\nx = [0, 1]\ny = [0, 1, 2]\nvalues = [[1, 2, 3], [1, 2]]\n[initial]",
            "tables.map.values: list 2: 2 numbers, expected 3, one for each `y`",
        ),
        (
            "[initial]",
            "[tables.map]\nx = [0, 1]\nvalues = [[1, 2, 3], [1, 2]]\n[initial]",
            "tables.map.values: element 1: a list, expected a number, or the knots `y`",
        ),
        (
            "[initial]",
            "[tables.map]\nx = [0, 1]\ny = [0, 1]\nvalues = [1, 2]\n[initial]",
            "tables.map.values: element 1: a number, expected a list with one for each `y`",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1]\nvalues = [1, 2]\nextrapolation = \"periodic\"\n[initial]",
            "tables.cam.values: 1 at the first and 2 at the last `x`, expected the same in a periodic table",
        ),
        (
            "[initial]",
            "[tables.sin]\nx = [0, 1]\nvalues = [1, 2]\n[initial]",
            "`sin` is the name of a function already",
        ),
        ("[initial]", "[tables.L]\nx = [0, 1]\nvalues = [1, 2]\n[initial]", "`L` is the name of parameters already"),
        (
            "[initial]",
            "[actuators.motor]\ncoordinate = \"pivot.angle\"\neffort = \"cam(time)\"\n[initial]",
            "actuators.motor.effort: `cam(time)`: no function or table `cam`, expected one of sin",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1]\nvalues = [1, 2]\n[actuators.motor]\ncoordinate = \"pivot.angle\"\neffort = \"2*cam\"\n[initial]",
            "`2*cam`: `cam` is a table, expected its arguments, as in `cam(time)`",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1e-300]\nvalues = [0, 1e300]\ninterpolation = \"cubic\"\n[initial]",
            "tables.cam.values: too large or too close together for a spline",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1]\nvalues = [1, 2]\n[actuators.motor]\ncoordinate = \"pivot.angle\"\neffort = \"cam(time, L)\"\n[initial]",
            "`cam(time, L)`: 2 arguments of the table `cam`, expected 1",
        ),
        (
            "[initial]",
            "[tables.cam]\nx = [0, 1]\nvalues = [1, 2]\n[drivers.motor]\ncoordinate = \"pivot.angle\"\nmotion = \"cam(time)\"\n[initial]",
            "drivers.motor.motion: `cam(time)`: the table `cam` has no rate at its kinks, expected `interpolation",
        ),
        (
            "[initial]",
            "[forces.push]\npoint = \"ground\"\nforce = [1, 0]\n[initial]",
            "forces.push.point: `ground` belongs to the ground, expected a point of a body",
        ),
        ("[initial]", "[bodies.bob]\n[initial]", "bodies.bob.mass: 0, expected more: the body can move without"),
        ("[initial]", "[bodies.bob]\nmass = 1\n[initial]", "bodies.bob.inertia: 0, expected more: the body can turn"),
    ] {
        assert!(SINGLE_PENDULUM.contains(from), "{from}");
        let message = refused(&SINGLE_PENDULUM.replacen(from, to, 1));
        assert!(message.contains(says), "{to}: no `{says}` in\n{message}");
    }
}

#[test]
fn a_mistake_is_said_once_and_not_again_by_its_consequences() {
    for (from, to, lines) in [
        ("\"rod.top\"", "\"rod.tip\"", 1),
        // no mass and no inertia
        ("[initial]", "[bodies.bob]\n[initial]", 2),
    ] {
        let message = refused(&SINGLE_PENDULUM.replacen(from, to, 1));
        assert_eq!(message.lines().count(), lines, "{message}");
    }
}

#[test]
fn all_vectors_of_a_wrong_length_are_named_at_once() {
    let text = SINGLE_PENDULUM.replacen("[0, \"-g\"]", "[0, 0, \"-g\"]", 1);
    let message = refused(&text.replacen("inertia = 0 ", "inertia = 0\nvelocity = [1]\nposition = [0, 0, 0] ", 1));
    for key in ["gravity", "bodies.rod.velocity", "bodies.rod.position"] {
        assert!(message.contains(&format!("{key}: ")), "{message}");
    }
}

#[test]
fn what_has_no_effect_is_warned_of_and_the_examples_have_nothing_of_the_kind() {
    let text = r#"
[parameters]
k = { default = 1 }
[ground]
points = { wall = [1, 0] }
[bodies.bob]
mass = 1
inertia = 1
points = { edge = [1, 0] }
[springs.gauge]
between = ["ground", "ball"]
rest = 1
[bodies.ball]
mass = 1
inertia = 1
position = [1, 0]
[forces.push]
point = "ball"
force = [0, 0]
[actuators.pull]
coordinate = "ball.x"
effort = 0.0
[outputs]
x = { measure = "bob.x" }
y = { measure = "ground.wall.y" }
length = { measure = "gauge.length" }
"#;
    let mechanism = parse(text);
    let warnings: Vec<String> = mechanism.warnings().iter().map(ToString::to_string).collect();
    assert_eq!(
        warnings,
        [
            "m.toml:3: parameters.k: nothing depends on it",
            "m.toml:6: bodies.bob: no joint, spring, force or actuator is attached to it",
            "m.toml:9: bodies.bob.points.edge: nothing uses this point",
            "m.toml:12: springs.gauge.rest: has no effect without `stiffness`",
            "m.toml:19: forces.push.force: is zero: it has no effect",
            "m.toml:22: actuators.pull.effort: is zero: it has no effect",
            "m.toml:25: outputs.y.measure: never changes: it belongs to the ground",
        ]
    );
    assert_eq!(mechanism.summary(), "2 bodies, 0 joints, 6 degrees of freedom");
    for example in EXAMPLES {
        assert!(parse(example).warnings().is_empty());
    }
    let summaries = [SINGLE_PENDULUM, SLIDER_CRANK].map(|example| parse(example).summary());
    assert_eq!(summaries[0], "1 body, 1 joint, 1 degree of freedom");
    assert_eq!(summaries[1], "3 bodies, 4 joints, 1 driver, 0 degrees of freedom");
}

#[test]
fn damping_that_is_negative_at_some_parameters_only_is_named_in_the_run() {
    let mechanism = parse(&SINGLE_PENDULUM.replacen("\"c*L\"", "\"c - 0.01\"", 1));
    assert!(mechanism.simulate(&values(&mechanism, &[]), &grid(1.0, 10), TOLERANCE, &Budget::default()).is_ok());
    let error = mechanism
        .simulate(&values(&mechanism, &[("c", 0.0)]), &grid(1.0, 10), TOLERANCE, &Budget::default())
        .unwrap_err();
    assert_eq!(error.part.as_deref(), Some("springs.damper.damping"));
    assert_eq!(error.message, "springs.damper.damping: `c - 0.01` is -0.01, expected zero or more");
}

#[test]
fn redundant_and_contradicting_constraints_are_named() {
    let twice = format!(
        "{FOUR_BAR}\n[drivers]\none = {{ coordinate = \"crank.angle\", motion = \"theta0\" }}\ntwo = {{ coordinate = \"crank.angle\", motion = \"theta0\" }}\n"
    );
    let message = refused(&twice);
    assert!(message.contains("`drivers.two` depends on the joints and drivers before it"), "{message}");
    let condition = "crank.angle = \"theta0\"";
    let message = refused(&FOUR_BAR.replacen(condition, "crank.angle = \"theta0\"\nD.angle = 1.5", 1));
    assert!(
        message.contains("joints.D: the mechanism cannot be assembled at t = 0 s: `joints.D` stays open by"),
        "{message}"
    );
    let message =
        refused(&FOUR_BAR.replacen("crank.angular_velocity = 0", "rocker.angular_velocity = 0\ncrank.vx = 0", 1));
    assert!(message.contains("initial.rocker.angular_velocity` is decided by"), "{message}");
    let message = refused(&FOUR_BAR.replacen("default = 0.5, unit", "default = 5.5, unit", 1));
    assert!(message.contains("cannot be assembled at t = 0 s: `joints."), "{message}");
}

#[test]
fn loops_in_a_singular_position_are_named_with_the_time_also_two_at_once() {
    // rods as long as the crank: at 90 degrees, after 5 ms, the pistons stand on the crank's bearing
    for pins in [&[0.0][..], &[0.0, std::f64::consts::PI]] {
        for times in [grid(0.1, 10), grid(0.1, 1000), grid(10.0, 1)] {
            let error =
                parse(&engine(0.04, pins)).simulate(&[3000.0], &times, TOLERANCE, &Budget::default()).unwrap_err();
            let says = "singular position of `joints.big0`, `joints.small0` at t = 0.005000 s";
            assert!(error.message.contains(says) && error.cause == MotionCause::Singular, "{error}");
        }
    }
}

#[test]
fn a_violated_constraint_is_named_however_large_the_mechanism_is() {
    let (model, samples) = run(&parse(SLIDER_CRANK), &[], &grid(1.0, 1));
    let Sample { t, mut q, v, .. } = samples[1].clone();
    model.constraints.check(t, &q, &v).unwrap();
    // the crank's bearing, with coordinates of 8 m
    q[1] += 2e-10;
    let error = model.constraints.check(t, &q, &v).unwrap_err();
    assert_eq!(error.message, "`joints.A` is violated by 2.0e-10 at t = 1 s, expected at most 1.0e-10");
    q[1] = f64::NAN;
    assert!(model.constraints.check(t, &q, &v).is_err());
}

#[test]
fn motions_that_cannot_be_followed_are_named() {
    for (motion, says) in [
        ("(time - 1.003)/abs(time - 1.003)*0.3", "the motion of `drivers.motor0` jumps at t = 1.003000 s"),
        ("sqrt(1.003 - time)", "the motion of `drivers.motor0` or a derivative of it is not finite at t = 1.003000 s"),
        ("sqrt(time)", "the motion of `drivers.motor0` or a derivative of it is not finite at t = 0.000000 s"),
    ] {
        let text = driven_four_bars(1).replace("omega*time", motion);
        let error = match Mechanism::parse(&text, Path::new("m.toml")) {
            Ok(mechanism) => {
                let run = mechanism.simulate(&[1.0], &grid(2.0, 20), TOLERANCE, &Budget::default());
                run.unwrap_err().message
            }
            Err(error) => error.to_string(),
        };
        assert!(error.contains(says), "{motion}: {error}");
    }
    // a kink is none
    let text = driven_four_bars(1).replace("omega*time", "abs(time - 1.003)");
    parse(&text).simulate(&[1.0], &grid(2.0, 20), TOLERANCE, &Budget::default()).unwrap();
}

#[test]
fn a_crank_that_drives_the_linkage_into_its_dead_position_is_named() {
    let mechanism = parse(SLIDER_CRANK);
    // a rod shorter than the crank opens the loop where the crank's sine is their ratio; one as long as the crank lets the
    // slider stand on the crank's bearing
    for ratio in [0.6, 1.0_f64] {
        for rows in [5, 100] {
            let run = mechanism.simulate(
                &values(&mechanism, &[("L_over_r", ratio)]),
                &grid(5.0, rows),
                TOLERANCE,
                &Budget::default(),
            );
            let error = run.unwrap_err();
            let (before, after) = error.message.split_once(" at t = ").unwrap();
            assert!(before.ends_with("singular position of `joints.B`, `joints.C`"), "{error}");
            let t: f64 = after.strip_suffix(" s").unwrap().parse().unwrap();
            let theta = t / 1.5 - (1.5 * t).sin() / 2.25;
            assert!((theta - ratio.asin()).abs() < 1e-5, "{error}");
        }
    }
}

#[test]
fn an_integration_that_comes_to_a_singular_position_names_it() {
    // the crank is driven, a pendulum on the slider is free
    let bob = r#"
        bodies.bob = { mass = 1, inertia = 0.1, position = [7, -1], points = { top = [0, 1] } }
        joints.hinge = { type = "revolute", between = ["slider", "bob.top"] }
    "#;
    for mechanism in both_formulations(&format!("gravity = [0, -9.81]\n{bob}\n{SLIDER_CRANK}")) {
        // a rod shorter than the crank, and one as long as it
        for (ratio, time) in [(0.8, "at t = 1.73"), (1.0, "at t = 2.225")] {
            let all = values(&mechanism, &[("L_over_r", ratio)]);
            let error = mechanism.simulate(&all, &grid(5.0, 500), TOLERANCE, &Budget::default()).unwrap_err();
            assert!(error.cause == MotionCause::Singular && error.message.contains(time), "{error}");
            assert!(error.message.ends_with("` depends on the other constraints there"), "{error}");
        }
    }
}

#[test]
fn stiff_equations_are_given_up_and_the_stiffest_spring_is_named() {
    let text = r#"
        parameters.k = { default = 100 }
        bodies.block = { mass = 2, inertia = 1 }
        joints.guide = { type = "prismatic", between = ["ground", "block"], axis = [1, 0] }
        springs.soft = { coordinate = "guide.position", stiffness = 1 }
        springs.contact = { coordinate = "guide.position", stiffness = "k", rest = 0.1 }
        outputs.x = { measure = "block.x" }
    "#;
    let mechanism = parse(text);
    let run = |k: f64| mechanism.simulate(&[k], &grid(2.0, 200), TOLERANCE, &Budget::default());
    assert!(run(1e6).is_ok());
    let error = run(2e14).unwrap_err();
    assert_eq!((error.cause, error.part.as_deref()), (MotionCause::GivenUp, Some("springs.contact")));
    let error = error.message;
    assert!(error.starts_with("given up at t = 0.0") && error.contains(" evaluations, the last step was "), "{error}");
    assert!(error.ends_with("the stiffest part is `springs.contact`, 1.0e7 rad/s"), "{error}");
}

#[test]
fn a_force_that_is_no_number_is_named_with_the_time() {
    for (effort, says) in [
        ("sqrt(-time - 1)", "`sqrt(-time - 1)` of `actuators.push` is NaN at t = 0 s, expected a finite number"),
        // it swings past its lowest point on the way
        ("0.01*sqrt(rod.angle)", "`0.01*sqrt(rod.angle)` of `actuators.push` is NaN at t = 0."),
    ] {
        let actuator = format!("[actuators.push]\ncoordinate = \"rod.angle\"\neffort = \"{effort}\"\n[initial]");
        for mechanism in both_formulations(&SINGLE_PENDULUM.replace("[initial]", &actuator)) {
            let run = mechanism.simulate(&values(&mechanism, &[]), &grid(1.0, 100), TOLERANCE, &Budget::default());
            let error = run.unwrap_err();
            assert_eq!((error.cause, error.part.as_deref()), (MotionCause::Undefined, Some("actuators.push")));
            assert!(error.message.contains(says), "{error}");
        }
    }
}

#[test]
fn a_motion_without_inertia_is_refused() {
    let mechanism = parse(SINGLE_PENDULUM);
    let error = mechanism
        .simulate(&values(&mechanism, &[("m", 0.0)]), &grid(1.0, 10), TOLERANCE, &Budget::default())
        .unwrap_err();
    assert!(error.message.contains("without mass or inertia"), "{error}");
}

/// Velocities jump at a kink of what is prescribed. Where other motions are free, that would take an impulse.
#[test]
fn kinks_of_motions_and_couplings_are_refused() {
    let text = |more: &str| {
        format!(
            r#"
            gravity = [0, -9.81]
            parameters = {{ p = {{ default = -0.3 }} }}
            bodies.rod = {{ mass = 1, inertia = 0.1, position = [0, -0.5], points = {{ top = [0, 0.5], bot = [0, -0.5] }} }}
            bodies.w = {{ mass = 1, inertia = 0.1, position = [0, -1.5], points = {{ t = [0, 0.5] }} }}
            joints.pivot = {{ type = "revolute", between = ["ground", "rod.top"] }}
            joints.q = {{ type = "revolute", between = ["rod.bot", "w.t"] }}
            outputs = {{ a = {{ measure = "pivot.angle" }} }}
            {more}
        "#
        )
    };
    let driver = |motion: &str| text(&format!("drivers.d = {{ coordinate = \"pivot.angle\", motion = \"{motion}\" }}"));
    for (motion, function) in [
        ("max(0, time - 0.55)", "max"),
        ("min(time, 0.5)", "min"),
        ("0.2*abs(0.35 - time)", "abs"),
        ("mod(time, 0.4)", "floor` or `mod"),
        ("0.1*floor(time + 0.45)", "floor` or `mod"),
        ("sign(time - 0.5)", "sign"),
    ] {
        let message = refused(&driver(motion));
        let expected = format!("drivers.d.motion: `{motion}`: `{function}` has no rate at its kinks");
        assert!(message.contains(&expected), "{message}");
    }
    // kinks of parameters are none of the motion
    assert!(parse(&driver("max(p, 0)*time + abs(p)*step(time, 0, 0, 1, 1)")).warnings().is_empty());
    let coupling =
        |follows: &str| text(&format!("couplings.c = {{ coordinate = \"q.angle\", follows = \"{follows}\" }}"));
    let message = refused(&coupling("abs(pivot.angle)"));
    assert!(message.contains("couplings.c.follows: `abs(pivot.angle)`: `abs` has no rate at its kinks"), "{message}");
    assert!(parse(&coupling("abs(p)*pivot.angle")).warnings().is_empty());
}

/// A rod of a kilometre is turned from its guess like one of a metre, and a spring without length has no force.
#[test]
fn large_mechanisms_are_assembled_and_springs_without_length_are_named() {
    let rod = |length: f64, spring: &str| {
        format!(
            r#"
            gravity = [0, -9.81]
            bodies.rod = {{ mass = 1, inertia = {}, position = [0, {}], points = {{ top = [0, {}] }} }}
            joints.pivot = {{ type = "revolute", between = ["ground", "rod.top"] }}
            initial.pivot.angle = 1.5
            {spring}
            outputs = {{ x = {{ measure = "rod.x" }}, a = {{ measure = "pivot.angle" }} }}
        "#,
            length * length / 12.0,
            -length / 2.0,
            length / 2.0
        )
    };
    for length in [1.0, 1e3, 1e5] {
        let found = rows(&parse(&rod(length, "")), &[0.0]).remove(0);
        assert_close(found[0], 0.5 * length * 1.5f64.sin(), 1e-12 * length);
    }
    let at_pivot =
        |more: &str| rod(1.0, &format!("springs.s = {{ between = [\"ground\", \"rod.top\"], stiffness = 10{more} }}"));
    let [plain, sprung] = [rod(1.0, ""), at_pivot("")].map(|text| rows(&parse(&text), &grid(1.0, 4)));
    let pairs = plain.iter().flatten().zip(sprung.iter().flatten());
    pairs.for_each(|(plain, sprung)| assert_close(*sprung, *plain, 1e-12));
    let message = parse(&at_pivot(", rest = 0.1"))
        .simulate(&[], &grid(1.0, 4), TOLERANCE, &Budget::default())
        .unwrap_err()
        .message;
    assert!(message.contains("the direction of `springs.s` is not defined: its length is zero"), "{message}");
}

#[test]
fn problems_of_numbers_parts_and_units_are_reported_together() {
    let text = r#"
        parameters.m = { default = 20, min = 30, max = 40 }
        bodies.load = { mass = "m", inertia = "J" }
        bodies.cart = { mass = 1 }
        joints.lift = { type = "prismatic", between = ["ground", "load"] }
        joints.rail = { type = "prismatic", between = ["ground", "wagon"], axis = [1, 0] }
        outputs.z = { measure = "lift.positio" }
    "#;
    let message = refused(text);
    for key in
        ["parameters.m.default", "bodies.load.inertia", "joints.lift", "joints.rail.between", "outputs.z.measure"]
    {
        assert!(message.contains(&format!(": {key}: ")), "{key}: {message}");
    }
    let text = r#"
        parameters.m = { default = 20, min = 30, max = 40 }
        bodies.load = { mass = "m" }
        joints.lift = { type = "prismatic", between = ["ground", "load"], axis = [0, 1] }
        outputs.y = { measure = "lift.position", unit = "s" }
        outputs.z = { measure = "lift.positio" }
    "#;
    let message = refused(text);
    for key in ["parameters.m.default", "outputs.y.unit", "outputs.z.measure"] {
        assert!(message.contains(&format!(": {key}: ")), "{key}: {message}");
    }
}
