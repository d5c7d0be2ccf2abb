use super::*;
use std::path::Path;

fn study(from: &str, to: &str) -> Study {
    let text = SYSTEMS[0].study;
    assert!(text.contains(from));
    Study::parse(&text.replacen(from, to, 1), Path::new("s.toml")).unwrap()
}

#[test]
fn every_system_has_a_study_that_it_accepts() {
    for system in SYSTEMS {
        let study = Study::parse(system.study, Path::new("s.toml")).unwrap();
        assert_eq!(study.name, system.name);
        assert_eq!(study.source.system.as_deref(), Some(system.name));
        let simulation = Simulation::new(&study).unwrap();
        let middle: Vec<f64> = study.parameters.values().map(|p| 0.5 * (p.min + p.max)).collect();
        let run = simulation.run(&middle).unwrap();
        assert_eq!(run.outputs.len(), simulation.times().len() * simulation.outputs().len());
    }
}

#[test]
fn a_system_with_states_moves_as_its_equations_say() {
    // parameters, coordinates at the start, velocities there
    let pendulum: &[(&str, f64)] = &[("L", 0.17), ("c", 0.1), ("theta0", 0.7), ("thetad0", -1.3)];
    let double = &[("L1", 1.3), ("L2", 2.2), ("theta10", 1.1), ("theta20", -0.4), ("theta1d0", 0.2), ("theta2d0", 0.6)];
    for (name, states, outputs, point) in [
        ("single-pendulum", &["pivot.angle"][..], &["theta", "thetad", "thetadd"][..], pendulum),
        ("double-pendulum", &["upper.angle", "lower.angle"], &["theta1", "theta2", "theta1d", "theta2d"], double),
    ] {
        let (parameters, constant) = (point.len() - 2 * states.len(), if states.len() == 1 { "m" } else { "m2" });
        let list = |names: &mut dyn Iterator<Item = String>| names.collect::<Vec<_>>().join("\n");
        let text = format!(
            "name = \"s\"\nstructure = \"dynamics\"\n[source]\nsystem = \"{name}\"\nconstants = {{ {constant} = 0.8 }}\n\
             [time]\nstop = 2\nstep = 0.05\n[parameters]\n{}\n[states]\n{}\n[outputs]\n{}\n",
            list(&mut point[..parameters].iter().map(|(name, _)| format!("{name} = {{ min = 0, max = 3 }}"))),
            list(&mut states.iter().map(|name| format!("{name} = {{ min = -3.2, max = 3.2 }}"))),
            list(&mut outputs.iter().map(|name| format!("{name} = {{}}"))),
        );
        let study = Study::parse(&text, Path::new("s.toml")).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        let run = simulation.run(&point.iter().map(|(_, value)| *value).collect::<Vec<_>>()).unwrap();

        let system = System::of(name).unwrap();
        let quantities = system.quantities.iter().map(|quantity| {
            let given = point.iter().find(|(name, _)| *name == quantity.name).map(|(_, value)| *value);
            given.unwrap_or(if quantity.name == constant { 0.8 } else { quantity.default })
        });
        let quantities: Vec<f64> = quantities.collect();
        let exact = (system.simulate)(&quantities, simulation.times(), TOLERANCE, &Budget::default()).unwrap();
        assert_eq!(run.outputs.len(), exact.len());
        for (output, _) in outputs.iter().enumerate() {
            let column =
                |values: &[f64]| values.iter().skip(output).step_by(outputs.len()).copied().collect::<Vec<_>>();
            let (run, exact) = (column(&run.outputs), column(&exact));
            let largest = exact.iter().fold(1.0f64, |largest, value| largest.max(value.abs()));
            for (run, exact) in run.iter().zip(&exact) {
                assert!((run - exact).abs() < 1e-9 * largest, "{name}, {}: {run} {exact}", outputs[output]);
            }
        }
    }
}

#[test]
fn every_mechanism_has_a_study_that_simulates() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/mechanisms");
    let names = ["single-pendulum", "double-pendulum", "slider-crank", "four-bar", "quarter-car", "scotch-yoke"];
    for name in names {
        let study = Study::load(&folder.join(format!("{name}-study.toml"))).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        for end in [0.0, 0.5, 1.0] {
            let point: Vec<f64> = study.parameters.values().map(|p| p.min + end * (p.max - p.min)).collect();
            let run = simulation.run(&point).unwrap();
            assert_eq!(run.outputs.len(), simulation.times().len() * simulation.outputs().len(), "{name}");
        }
    }
}

#[test]
fn the_studys_tolerance_is_that_of_the_integration() {
    let mechanism = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/mechanisms/single-pendulum-study.toml");
    let of_mechanism = std::fs::read_to_string(&mechanism).unwrap();
    for (text, path) in [(SYSTEMS[0].study, Path::new("s.toml")), (&of_mechanism, &mechanism)] {
        let run = |tolerance: &str| {
            let text = text.replacen("[source]", &format!("[source]\n{tolerance}"), 1);
            Simulation::new(&Study::parse(&text, path).unwrap()).unwrap().run(&[0.1, 0.05, 2.0]).unwrap().outputs
        };
        let (usual, same, loose) = (run(""), run("tolerance = 1e-13"), run("tolerance = 1e-6"));
        assert_eq!(usual, same);
        let difference = usual.iter().zip(&loose).map(|(usual, loose)| (usual - loose).abs()).fold(0.0, f64::max);
        assert!((1e-9..1e-2).contains(&difference), "{difference:e}");
    }
}

/// A slider crank whose rod is too short at some of the points.
fn short_rods(options: &str) -> (Study, Rows) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/mechanisms/slider-crank-study.toml");
    let text = std::fs::read_to_string(&path).unwrap().replacen("[source]", &format!("[source]\n{options}"), 1);
    let study = Study::parse(&text, &path).unwrap();
    let ratio = study.parameters.get_index_of("L_over_r").unwrap();
    let middle: Vec<f64> = study.parameters.values().map(|p| 0.5 * (p.min + p.max)).collect();
    let point = |run: usize| {
        let mut point = middle.clone();
        point[ratio] = if run % 10 == 3 { 0.6 } else { 3.0 };
        point
    };
    (study, (0..20).map(point).collect())
}

/// Equations are solved in this process.
fn no_workers(stop: &AtomicBool) -> Workers<'_> {
    Workers { program: Path::new(""), stop }
}

#[test]
fn runs_of_a_mechanism_may_fail_as_long_as_they_are_few() {
    let folder = tempfile::tempdir().unwrap();
    let run_all = |options: &str, total: usize| {
        let (study, points) = short_rods(options);
        let simulation = Simulation::new(&study).unwrap();
        let journal = simulation.journal(&folder.path().join("runs"), &study).unwrap();
        let outcomes = simulation.run_all(&points, total, &journal, no_workers(&AtomicBool::new(false)), || ())?;
        simulation.check_failures(&points, &outcomes)?;
        Ok::<_, Error>((outcomes.iter().map(std::result::Result::is_ok).collect(), simulation.dataset(outcomes)))
    };
    let (outcomes, dataset): (Vec<bool>, _) = run_all("", 20).unwrap();
    assert_eq!(outcomes, (0..20).map(|run| run % 10 != 3).collect::<Vec<_>>());
    assert_eq!(dataset.runs.len(), 18);
    for (options, total) in [("max_failed = 0.09", 20), ("", 10)] {
        let message = run_all(options, total).unwrap_err().to_string();
        assert!(
            message.contains(&format!("2 of {total} runs failed, at most 1 may (source.max_failed = ")),
            "{message}"
        );
        assert!(message.contains("L_over_r = 0.6: ") && message.contains("`joints."), "{message}");
    }
}

#[test]
fn a_run_that_takes_long_ends_at_the_time_limit_and_when_it_is_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let spring = "coordinate = \"pivot.angle\"\nstiffness = 1e8\n";
    let text = include_str!("../../../../../examples/mechanisms/single-pendulum.toml");
    let text = text.replacen("coordinate = \"pivot.angle\"\n", spring, 1);
    std::fs::write(folder.path().join("m.toml"), text).unwrap();
    let simulation = |options: &str| {
        let source = format!("mechanism = \"m.toml\"\n{options}");
        let text = SYSTEMS[0].study.replacen("system = \"single-pendulum\"", &source, 1);
        let study = Study::parse(&text, &folder.path().join("s.toml")).unwrap();
        (Simulation::new(&study).unwrap(), study)
    };
    let points = Rows::from_iter([[0.1, 0.05, 2.0]]);
    let begin = Instant::now();
    let message = simulation("time_limit = 0.2").0.run(&points[0]).unwrap_err().to_string();
    assert!(message.contains("took longer than 200ms (source.time_limit) and came to t = 0.0"), "{message}");

    let (simulation, study) = simulation("");
    let journal = simulation.journal(&folder.path().join("runs"), &study).unwrap();
    let stop = AtomicBool::new(false);
    let outcome = std::thread::scope(|scope| {
        let outcome = scope.spawn(|| simulation.run_all(&points, 1, &journal, no_workers(&stop), || ()));
        std::thread::sleep(Duration::from_millis(200));
        stop.store(true, Ordering::Relaxed);
        outcome.join().unwrap()
    });
    assert!(matches!(outcome, Err(Error::Interrupted)), "{outcome:?}");
    assert!(begin.elapsed() < Duration::from_secs(10), "{:?}", begin.elapsed());
}

#[test]
fn a_mechanisms_content_counts_for_the_digest_and_its_layout_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let digest = |mechanism: String| {
        std::fs::write(folder.path().join("m.toml"), mechanism).unwrap();
        let text = SYSTEMS[0].study.replacen("system = \"single-pendulum\"", "mechanism = \"m.toml\"", 1);
        Study::parse(&text, &folder.path().join("s.toml")).unwrap().sampling_digest()
    };
    let text = include_str!("../../../../../examples/mechanisms/single-pendulum.toml");
    let first = digest(text.to_owned());
    assert_eq!(digest(format!("# a comment\n{text}")), first);
    assert_ne!(digest(text.replacen("inertia = 0 ", "inertia = 1 ", 1)), first);
    assert_ne!(digest(text.replacen("augmented", "embedding", 1)), first);
}

#[test]
fn outputs_come_in_the_studys_order_and_constants_count() {
    let all = Simulation::new(&study("seed", "seed")).unwrap().run(&[0.1, 0.05, 2.0]).unwrap();
    let text = SYSTEMS[0].study.replace("m = 0.3", "m = 0.6");
    let lines: Vec<&str> = text.lines().filter(|line| !line.starts_with("theta = ")).collect();
    let study = Study::parse(&lines.join("\n"), Path::new("s.toml")).unwrap();
    let two = Simulation::new(&study).unwrap().run(&[0.1, 0.1, 2.0]).unwrap();
    // twice the mass and twice the damping: the same motion
    for (two, all) in two.outputs.chunks(2).zip(all.outputs.chunks(3)) {
        assert!((two[0] - all[1]).abs() < 1e-9 && (two[1] - all[2]).abs() < 1e-7);
    }
}

#[test]
fn unknown_names_and_foreign_units_are_refused() {
    for (from, to, says) in [
        ("system = \"single", "system = \"triple", "no system `triple-pendulum`"),
        ("\nc = {", "\nd = {", "no quantity `d`, expected one of L, c, thetad0"),
        ("\nthetad = {", "\nomega = {", "no output `omega`"),
        ("unit = \"m\"", "unit = \"mm\"", "`mm`, expected `m`"),
        ("m = 0.3", "L = 0.3", "is a parameter"),
    ] {
        let message = Simulation::new(&study(from, to)).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
}
