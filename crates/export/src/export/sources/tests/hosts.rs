//! FMUs of sources, compared with those of the library in runs and by strict hosts.

use super::*;

/// A surrogate's FMU with the library of its sources and with the packed one, for each version and interface that it has.
fn in_c_and_rust(surrogate: &Surrogate) -> Vec<[Fmu; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let mut pairs = Vec::new();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let paths = [c_fmu(folder.path(), surrogate, version), rust_fmu(folder.path(), surrogate, version)];
        let is_discrete = surrogate.program().sampling().is_some();
        let interfaces = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
        for interface in interfaces.into_iter().filter(|kind| !is_discrete || *kind == InterfaceKind::CoSimulation) {
            pairs.push(paths.each_ref().map(|path| Fmu::open_for(path, interface).unwrap()));
        }
    }
    pairs
}

#[test]
fn a_whole_run_is_that_of_the_packed_library() {
    let example = example::with_network(&[20, 20], Activation::Tanh);
    let [polynomial, forest, kernel] = regressions(&example);
    let per_instant = example::per_instant(&[20, 20], Activation::Tanh, Precision::Double);
    let covered = example::with_cover(&example);
    for surrogate in [bent(&example, Activation::Tanh), example, covered, per_instant, polynomial, forest, kernel] {
        compare_run_of_example(&seal(surrogate).unwrap());
    }
}

fn compare_run_of_example(surrogate: &Surrogate) {
    for fmus in in_c_and_rust(surrogate) {
        // inside the domain, and outside with each policy that does not refuse
        for (speed, policy) in [(4.5, 0.0), (7.0, 0.0), (7.0, 1.0)] {
            let start_values = [("length", 0.13), ("speed", speed), ("domain_policy", policy)];
            let start_values = start_values.map(|(name, value)| (name.to_owned(), value)).into();
            let record = ["in_domain", "domain_distance"].map(str::to_owned).into();
            let options = SimulationOptions { start_values, step: Some(0.013), record, ..SimulationOptions::default() };
            let [found, expected] =
                fmus.each_ref().map(|fmu| simulate(&fmu.instantiate("run", false).unwrap(), &options).unwrap());
            assert_eq!((&found.columns, &found.times), (&expected.columns, &expected.times));
            assert_eq!((found.rows.len(), found.columns.len()), (155, 4));
            for (found, expected) in found.rows.iter().zip(&expected.rows) {
                assert_close(found, expected, 6.0, "run");
            }
        }
    }
}

/// OMSimulator takes the value reference 0 among the dependencies of an output for none.
#[test]
fn no_variable_has_the_value_reference_0_and_reading_it_says_so() {
    for surrogate in [example::surrogate(), example::crane(), example::oscillator(None), example::recorded()] {
        for fmus in in_c_and_rust(&seal(surrogate).unwrap()) {
            for fmu in fmus {
                assert!(fmu.description().variables.iter().all(|variable| variable.value_reference > 0));
                let instance = fmu.instantiate("run", true).unwrap();
                instance.enter_initialization_mode(0.0, None).unwrap();
                let refused = instance.get_real(&[0], &mut [0.0]).unwrap_err().to_string();
                assert!(refused.contains("value reference 0 is unknown: no variable has it"), "{refused}");
            }
        }
    }
}

/// A run with a force that jumps, by each policy that does not refuse.
fn compare_run(surrogate: Surrogate, starts: &[(&str, f64)], record: &[&str], step: f64) {
    let surrogate = seal(surrogate).unwrap();
    for fmus in in_c_and_rust(&surrogate) {
        for policy in [0.0, 1.0] {
            let start_values = starts.iter().copied().chain([("domain_policy", policy)]);
            let options = SimulationOptions {
                start_values: start_values.map(|(name, value)| (name.to_owned(), value)).collect(),
                stop: Some(2.0),
                step: Some(step),
                inputs: Inputs {
                    names: vec!["force".into()],
                    times: vec![0.0, 0.5, 0.5, 2.0],
                    rows: vec![vec![-4.0], vec![12.0], vec![3.0], vec![-14.0]],
                },
                record: record.iter().map(|name| (*name).to_owned()).collect(),
                ..SimulationOptions::default()
            };
            let [found, expected] =
                fmus.each_ref().map(|fmu| simulate(&fmu.instantiate("run", false).unwrap(), &options).unwrap());
            assert_eq!((&found.columns, &found.times), (&expected.columns, &expected.times));
            let outputs = surrogate.outputs().len();
            assert!(found.rows.len() > 100 && found.columns.len() >= outputs + record.len(), "{:?}", found.columns);
            for (found, expected) in found.rows.iter().zip(&expected.rows) {
                assert_close(found, expected, 10.0, "run");
            }
        }
    }
}

#[test]
fn a_whole_run_with_an_input_is_that_of_the_packed_library() {
    let record = ["rope.angular_velocity", "der(rope.angular_velocity)"];
    compare_run(example::crane(), &[("rope", 1.3), ("rope.angle_start", 0.8)], &record, 0.013);
    compare_run(
        example::crane_with_motor(),
        &[("rope", 1.3), ("current_start", 0.8)],
        &["current", "der(current)"],
        0.013,
    );
    let by_network = example::oscillator(Some(example::residual_network()));
    for surrogate in [by_network, example::oscillator_by_graph(), turning(Activation::Tanh)] {
        compare_run(surrogate, &[("mu", 1.3), ("x_start", 0.8)], &["v", "der(v)"], 0.013);
    }
    compare_run(without_states(true), &[("mu", 1.3)], &["domain_distance"], 0.013);
    compare_run(example::recorded(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
    compare_run(example::supported(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
    compare_run(example::direct(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
    compare_run(window(), &[("force_start", 0.8)], &[], 0.013);
    compare_run(example::cell(), &[("mass", 1.3), ("position_start", 0.8)], &["domain_distance"], 0.013);
}

/// Answers of an instance in the middle of a run: states as bytes, and derivatives. Policy 1 clamps the inputs.
fn said_in_a_run(instance: &FmuInstance, surrogate: &Surrogate, starts: &[f64]) -> (Vec<u8>, Vec<f64>) {
    let of_inputs = |wanted: fn(Role) -> bool| -> Vec<u32> {
        let indexed = (Variables::FIRST_REFERENCE..).zip(surrogate.inputs());
        indexed.filter(|(_, input)| wanted(input.role)).map(|(reference, _)| reference).collect()
    };
    let (parameters, start, driven) = (
        of_inputs(|role| matches!(role, Role::Parameter(_))),
        of_inputs(|role| role == Role::Start),
        of_inputs(|role| role == Role::Input),
    );
    let references = |wanted: fn(&Quantity) -> bool| -> Vec<u32> {
        let variables = surrogate.variables().iter();
        variables.filter(|(_, variable)| wanted(&variable.quantity)).map(|(reference, _)| reference).collect()
    };
    let states = references(|quantity| matches!(quantity, Quantity::State(_)));
    let unknowns = references(|quantity| {
        let distance = Quantity::BuiltIn(BuiltIn::DomainDistance);
        *quantity == distance || matches!(quantity, Quantity::Output(_) | Quantity::State(_) | Quantity::Derivative(_))
    });
    let policy = surrogate.variables().reference(Quantity::BuiltIn(BuiltIn::DomainPolicy)).unwrap();
    instance.set_real(&start, starts).unwrap();
    instance.enter_initialization_mode(0.0, Some(9.0)).unwrap();
    instance.exit_initialization_mode().unwrap();
    instance.set_integer(&[policy], &[1]).unwrap();
    for reference in &driven {
        instance.set_real(&[*reference], &[11.0]).unwrap();
    }
    for step in 0..10 {
        instance.do_step(0.13 * f64::from(step), 0.13).unwrap();
    }
    let knowns = [parameters, driven, states, start].concat();
    let seed: Vec<f64> = (0..knowns.len()).map(|k| 0.25 + k as f64).collect();
    let mut values = instance.directional_derivative(&unknowns, &knowns, &seed).unwrap();
    // outputs of samples have none, and a refusal ends the run
    let orders: &[i32] = if surrogate.program().sampling().is_some() { &[] } else { &[1, 2] };
    for &order in orders {
        values.extend(instance.output_derivatives(&unknowns, &vec![order; unknowns.len()]).unwrap());
    }
    let all = references(|quantity| {
        let is_real = |of| of == BuiltIn::DomainDistance;
        !matches!(*quantity, Quantity::BuiltIn(of) if !is_real(of))
    });
    let mut read = vec![0.0; all.len()];
    instance.get_real(&all, &mut read).unwrap();
    values.extend(read);
    (instance.state().unwrap().to_bytes().unwrap(), values)
}

#[test]
fn states_and_derivatives_in_a_run_are_those_of_the_packed_library() {
    for (surrogate, starts) in [
        // beyond the rail
        (example::crane(), &[4.5, 0.5, 1.5, 0.3][..]),
        (example::crane_with_motor(), &[4.5, 0.5, 1.5, 0.3, 2.5]),
        (turning(Activation::Tanh), &[3.5, 0.8]),
        (example::recorded(), &[0.5, -0.25]),
        (two_by_two(), &[0.5, -0.25]),
        (example::cell(), &[0.5]),
        (example::oscillator_by_graph(), &[0.5, -0.25]),
    ] {
        let surrogate = seal(surrogate).unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
            let [c, rust] = fmus.map(|path| Fmu::open(path).unwrap());
            let [(found, values), (expected, expected_values)] =
                [&c, &rust].map(|fmu| said_in_a_run(&fmu.instantiate("run", false).unwrap(), &surrogate, starts));
            assert_close(&values, &expected_values, 1.0, &format!("{version:?}"));
            assert_eq!(values.len(), expected_values.len());
            // after magic, fingerprint and state, whose numbers are others, and before the checksum
            let end = found.len() - 8;
            assert_eq!((found.len(), &found[17..20]), (expected.len(), &expected[17..20]));
            let numbers = |bytes: &[u8]| -> Vec<f64> {
                bytes[20..end].as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect()
            };
            assert_close(&numbers(&found), &numbers(&expected), 1.0, "snapshot");
            assert_eq!((found[7], expected[7]), (4, 4), "version of the layout");
        }
    }
}

/// In the ranges, but not near the data that the surrogate knows of.
#[test]
fn where_no_data_are_near_is_as_in_the_packed_library() {
    let surrogate = seal(example::with_cover(&example::surrogate())).unwrap();
    let reference = |of: BuiltIn| surrogate.variables().reference(Quantity::BuiltIn(of)).unwrap();
    let unknown = [reference(BuiltIn::DomainDistance)];
    let inputs = [0, 1].map(|input| surrogate.variables().reference(Quantity::Input(input)).unwrap());
    for [c, rust] in in_c_and_rust(&surrogate) {
        for (length, speed, policy) in [
            (0.12, 1.0, 0),
            (0.12, 4.5, 0),
            (0.19, 1.5, 0),
            (0.12, 4.5, 1),
            (0.12, 4.5, 2),
            (0.25, 4.5, 0),
            (0.19, 4.5, 2),
        ] {
            let [found, expected] = [&c, &rust].map(|fmu| {
                let instance = fmu.instantiate("run", false).unwrap();
                instance.set_real(&inputs, &[length, speed]).unwrap();
                instance.set_integer(&[reference(BuiltIn::DomainPolicy)], &[policy]).unwrap();
                instance.enter_initialization_mode(0.0, None).unwrap();
                let mut values = instance.directional_derivative(&unknown, &inputs, &[0.5, 0.25]).unwrap();
                let (mut inside, mut distance) = ([true], [0.0]);
                instance.get_boolean(&[reference(BuiltIn::InDomain)], &mut inside).unwrap();
                instance.get_real(&unknown, &mut distance).unwrap();
                values.extend(distance);
                let left = instance.exit_initialization_mode().map_err(|error| error.to_string());
                (values, inside, left)
            });
            assert_close(&found.0, &expected.0, 1.0, &format!("{length} {speed}"));
            assert_eq!((found.1, found.2.is_ok()), (expected.1, expected.2.is_ok()));
            let is_inside = (length < 0.15) == (speed < 2.5) && length <= 0.2;
            assert_eq!(
                (found.1[0], found.2.is_ok()),
                (is_inside, is_inside || policy != 2),
                "{length} {speed} {policy}"
            );
        }
    }
}

/// Steps that fail: messages, and outputs afterwards if the host may continue.
#[test]
fn steps_that_fail_say_what_the_library_says() {
    for (surrogate, starts, size, says) in [
        (
            diverging(),
            &[0.4, 0.25][..],
            1.0,
            "the outputs are not finite at the sample 0.2 s after the beginning of the step",
        ),
        (example::recorded(), &[0.4, 0.25], 2e6, "communication step size 2000000 takes more than ten million steps"),
        (
            example::oscillator(None),
            &[1e100, 1.0],
            0.25,
            "the states are not finite 0.005 s after the beginning of the step",
        ),
        (example::oscillator(None), &[1.0, 1.0], 1e9, "takes more than ten million steps of the solver"),
    ] {
        let surrogate = seal(surrogate).unwrap();
        let output_reference = surrogate.variables().reference(Quantity::Output(0)).unwrap();
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
            let [found, expected] = fmus.map(|path| {
                let fmu = Fmu::open(path).unwrap();
                let instance = fmu.instantiate("run", true).unwrap();
                instance.set_real(&[2, 3], starts).unwrap();
                instance.enter_initialization_mode(0.0, None).unwrap();
                instance.exit_initialization_mode().unwrap();
                instance.take_messages();
                let refused = instance.do_step(0.0, size).unwrap_err().to_string();
                let said: String = instance.take_messages().into_iter().map(|said| said.text).collect();
                let mut output = [0.0];
                instance.get_real(&[output_reference], &mut output).unwrap();
                (refused + &said, output)
            });
            assert_eq!(found, expected);
            assert_eq!(found.1, [starts[0]]);
            assert!(found.0.contains(says), "{}", found.0);
        }
    }
}

/// Messages and outputs outside of the valid values of an encoded input, by each policy.
#[test]
fn nominal_and_periodic_inputs_are_checked_as_in_the_library() {
    let surrogate = seal(example::encoded(&example::surrogate())).unwrap();
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let fmus = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
        let fmus = fmus.map(|path| Fmu::open(path).unwrap());
        let (length, speed, policy, distance) = (1, 2, 6, 8);
        for number in 0..3 {
            for value in [0.14, 0.15, 0.2 + 1e-12, 0.19, -7.0] {
                let [found, expected] = fmus.each_ref().map(|fmu| {
                    let instance = fmu.instantiate("run", true).unwrap();
                    instance.take_messages();
                    instance.set_integer(&[policy], &[number]).unwrap();
                    let refused = instance.set_real(&[length, speed], &[value, 1e3]).map_err(|error| error.to_string());
                    let said: String = instance.take_messages().into_iter().map(|said| said.text).collect();
                    let mut values = [0.0; 4];
                    if refused.is_ok() {
                        instance.enter_initialization_mode(0.0, None).unwrap();
                        instance.get_real(&[4, 5, length, distance], &mut values).unwrap();
                    }
                    (refused, said, values)
                });
                assert_eq!((&found.0, &found.1), (&expected.0, &expected.1), "{number} {value}");
                assert_close(&found.2, &expected.2, 6.0, &format!("{number} {value}"));
                let says = found.1 + &found.0.err().unwrap_or_default();
                let is_told = number != 1 && (value == 0.15 || value == 0.19 || value == -7.0);
                assert_eq!(says.contains("is outside the trained values 0.14, 0.1, 0.2"), is_told, "{says}");
            }
        }
    }
}

#[test]
fn the_validator_finds_nothing() {
    let [polynomial, forest, kernel] = regressions(&example::surrogate());
    let per_instant = example::per_instant(&[20], Activation::Tanh, Precision::Double);
    for surrogate in [
        bent(&per_instant, Activation::Tanh),
        example::encoded(&per_instant),
        polynomial,
        forest,
        kernel,
        graph(&example::surrogate()),
        example::with_input(),
        example::crane(),
        example::encoded(&example::with_input()),
        turning(Activation::Tanh),
        without_states(false),
        example::recorded(),
        example::cell(),
        example::oscillator_by_graph(),
        alone(),
    ] {
        for version in [FmiVersion::V2, FmiVersion::V3] {
            let folder = tempfile::tempdir().unwrap();
            let report = validate(c_fmu(folder.path(), &seal(surrogate.clone()).unwrap(), version)).unwrap();
            assert!(report.problems.is_empty(), "{report}");
        }
    }
}

#[test]
fn error_bounds_are_read_as_in_the_library() {
    let mut metadata = example::with_bounds().metadata().clone();
    metadata.arrays.clear();
    let [polynomial, ..] = regressions(&example::surrogate());
    let per_instant = example::per_instant(&[16], Activation::Tanh, Precision::Double);
    let with_bounds = |of: &Surrogate| Surrogate::new(metadata.clone(), of.program().clone()).unwrap();
    for surrogate in [example::surrogate(), per_instant, polynomial].iter().map(with_bounds) {
        check_bounds(&surrogate);
    }
}

fn check_bounds(surrogate: &Surrogate) {
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let fmu = c_fmu(folder.path(), &seal(surrogate.clone()).unwrap(), version);
        assert!(validate(&fmu).unwrap().problems.is_empty(), "{}", validate(&fmu).unwrap());
        let fmu = Fmu::open(&fmu).unwrap();
        let instance = fmu.instantiate("bounds", false).unwrap();
        instance.enter_initialization_mode(0.0, None).unwrap();
        let mut values = [0.0; 2];
        let [first, second] = [0, 1].map(|output| surrogate.variables().reference(Quantity::Bound(output)).unwrap());
        instance.get_real(&[second, first], &mut values).unwrap();
        assert_eq!(values, [0.25, 0.125]);
        assert!(instance.get_real(&[second + 1], &mut values[..1]).is_err());
    }
}

#[test]
fn error_bounds_grow_as_in_the_library() {
    let surrogate = seal(example::with_growing_bounds()).unwrap();
    let [first, last] = [0, 6].map(|output| surrogate.variables().reference(Quantity::Bound(output)).unwrap());
    let force = surrogate.variables().reference(Quantity::Input(5)).unwrap();
    let said = |fmu: &Path| {
        let fmu = Fmu::open(fmu).unwrap();
        let instance = fmu.instantiate("bounds", false).unwrap();
        instance.enter_initialization_mode(5.0, None).unwrap();
        instance.exit_initialization_mode().unwrap();
        let mut said = Vec::new();
        for step in 0..5 {
            instance.do_step(5.0 + 0.6 * f64::from(step), 0.6).unwrap();
            let mut values = [0.0; 2];
            instance.get_real(&[first, last], &mut values).unwrap();
            said.extend(values);
            said.extend(instance.directional_derivative(&[first], &[force], &[1.0]).unwrap());
            said.extend(instance.output_derivatives(&[last], &[1]).unwrap());
        }
        said
    };
    for version in [FmiVersion::V2, FmiVersion::V3] {
        let folder = tempfile::tempdir().unwrap();
        let [c, rust] = [c_fmu(folder.path(), &surrogate, version), rust_fmu(folder.path(), &surrogate, version)];
        assert!(validate(&c).unwrap().problems.is_empty(), "{}", validate(&c).unwrap());
        let (found, expected) = (said(&c), said(&rust));
        assert_close(&found, &expected, 1.0, &format!("{version:?}"));
        assert!((expected[8] - 0.325).abs() < 1e-12 && expected[16] == 0.375, "{expected:?}");
    }
}

/// A program in C that calls everything: right, wrong, and with null pointers.
#[test]
fn the_functions_of_fmi_2_answer_as_the_standard_says() {
    run(&seal(example::with_input()).unwrap(), FmiVersion::V2, include_str!("fmi2_calls.c"));
}

#[test]
fn the_functions_of_fmi_3_answer_as_the_standard_says() {
    run(&seal(example::with_input()).unwrap(), FmiVersion::V3, include_str!("fmi3_calls.c"));
}

#[test]
fn hosts_written_with_the_names_of_the_standards_compile_and_run() {
    let surrogate = seal(example::with_input()).unwrap();
    run(&surrogate, FmiVersion::V2, include_str!("fmi2_standard.c"));
    run(&surrogate, FmiVersion::V3, include_str!("fmi3_standard.c"));
}

#[test]
fn the_functions_of_both_versions_answer_as_the_library_does_of_states() {
    let surrogate = seal(example::crane()).unwrap();
    run(&surrogate, FmiVersion::V2, include_str!("fmi2_motion.c"));
    let controlled = Integration::ErrorControlled { tolerance: 1e-5, longest: 0.005 };
    let surrogate = seal(example::integrated(&example::crane(), controlled)).unwrap();
    run(&surrogate, FmiVersion::V3, include_str!("fmi3_motion.c"));
}

#[test]
fn the_functions_of_fmi_2_answer_as_the_library_does_of_samples() {
    run(&seal(example::recorded()).unwrap(), FmiVersion::V2, include_str!("fmi2_samples.c"));
}

/// Outputs that tests/hosts/strict.c prints at the end with the library of a surrogate, by each version and interface.
fn run_strict_host(
    surrogate: Surrogate,
    model: &str,
    library_of: impl Fn(&Path, &Surrogate, FmiVersion) -> PathBuf,
) -> Vec<[f64; 2]> {
    let folder = tempfile::tempdir().unwrap();
    let resources = folder.path().join("resources");
    let surrogate = seal(surrogate).unwrap();
    fs::create_dir(&resources).unwrap();
    fs::write(resources.join("model.safetensors"), surrogate.to_bytes().unwrap()).unwrap();
    let host = folder.path().join("strict");
    let source = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/hosts/strict.c");
    let status = compiler().args(FLAGS).arg(source).arg("-o").arg(&host).arg("-ldl").status().unwrap();
    assert!(status.success());
    let mut found = Vec::new();
    for (version, number, resources) in [
        (FmiVersion::V2, "2", format!("file://{}", resources.display())),
        (FmiVersion::V3, "3", resources.display().to_string()),
    ] {
        let library = library_of(folder.path(), &surrogate, version);
        for interface in ["cs", "me"] {
            let token = surrogate.instantiation_token();
            let arguments = [library.to_str().unwrap(), number, interface, &resources, &token, model];
            let output = Command::new(&host).args(arguments).output().unwrap();
            assert!(output.status.success(), "{number} {interface}: {}", String::from_utf8_lossy(&output.stderr));
            assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
            let text = String::from_utf8(output.stdout).unwrap();
            let numbers: Vec<f64> = text.split_whitespace().map(|number| number.parse().unwrap()).collect();
            found.extend(numbers.chunks(2).map(|outputs| [outputs[0], outputs[1]]));
        }
    }
    // two versions, two interfaces, three domain policies
    assert_eq!(found.len(), 12);
    found
}

fn packed_library(folder: &Path, _: &Surrogate, _: FmiVersion) -> PathBuf {
    let binary = Binary::embedded().into_iter().find(|binary| binary.platform == Platform::CURRENT).unwrap();
    let path = folder.join("packed");
    fs::write(&path, &binary.bytes).unwrap();
    path
}

fn library_of_sources(folder: &Path, surrogate: &Surrogate, version: FmiVersion) -> PathBuf {
    write_sources(folder, surrogate, version);
    let files = compiled(surrogate, version);
    compile(folder, &files, &["-fPIC", "-shared"], &format!("of-sources-{version:?}"))
}

#[test]
fn a_host_that_takes_every_status_but_ok_for_a_failure_finds_none() {
    for library_of in [packed_library, library_of_sources] {
        let found = run_strict_host(example::with_input(), "response", library_of);
        for outputs in &found {
            assert!((0..2).all(|i| (outputs[i] - found[0][i]).abs() < 1e-12), "{found:?}");
        }
    }
}

/// The crane of the example, pushed as the host does: its own equations, integrated here.
#[test]
fn the_same_host_drives_the_input_of_a_motion_by_both_interfaces() {
    let mut state = SVector::from([0.0, 0.3, 0.0, 0.0]);
    for force in [4.0, -6.0, 8.0, -3.0] {
        let derivative = |state: &SVector<f64, 4>| {
            let (l, [_, theta, v, omega]) = (1.3, (*state).into());
            let masses = Matrix2::new(3.0, l * theta.cos(), l * theta.cos(), l * l);
            let swing = l * omega * omega * theta.sin();
            let forces = Vector2::new(force - 0.3 * v + swing, -9.81 * l * theta.sin());
            let accelerations = masses.try_inverse().unwrap() * forces;
            SVector::from([v, omega, accelerations[0], accelerations[1]])
        };
        state = integrate(derivative, state, &[0.0, 0.5], TOLERANCE, &Budget::default()).unwrap()[1];
    }
    for library_of in [packed_library, library_of_sources] {
        let found = run_strict_host(example::crane(), "motion", library_of);
        for outputs in &found {
            assert!((0..2).all(|i| (outputs[i] - state[i]).abs() < 1e-5), "{found:?}, expected {state}");
        }
    }
}
