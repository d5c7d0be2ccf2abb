//! Runs FMUs made here.

use super::{host::*, *};
use crate::{Error, Result};
use metafmu_example as example;
use metafmu_runtime::Evaluator;
use metafmu_testing::{changed_fmu, entry, fmu, fmu_described_as, fmu_of, fmu_with_arrays, fmu_with_input};
use std::{fmt, path::PathBuf};

// value references of the example surrogate
const LENGTH: u32 = 1;
const SPEED: u32 = 2;
const OUTPUTS: [u32; 2] = [4, 5];

fn predict(inputs: [f64; 3]) -> [f64; 2] {
    let mut evaluator = Evaluator::new(&example::surrogate());
    let mut outputs = [0.0; 2];
    evaluator.evaluate(&inputs, &mut outputs);
    outputs
}

fn outputs(instance: &FmuInstance) -> [f64; 2] {
    let mut outputs = [0.0; 2];
    instance.get_real(&OUTPUTS, &mut outputs).unwrap();
    outputs
}

fn message(result: Result<impl fmt::Debug>) -> String {
    result.unwrap_err().to_string()
}

const VERSIONS: [FmiVersion; 2] = [FmiVersion::V2, FmiVersion::V3];

#[test]
fn an_instance_computes_what_the_surrogate_predicts() {
    let folder = tempfile::tempdir().unwrap();
    for version in VERSIONS {
        let fmu = Fmu::open(fmu_of(folder.path(), version)).unwrap();
        assert_eq!(fmu.version(), version.to_string());
        assert_eq!(fmu.missing_functions(), [""; 0]);
        let instance = fmu.instantiate("test", true).unwrap();
        instance.set_real(&[SPEED, LENGTH], &[3.0, 0.12]).unwrap();
        instance.enter_initialization_mode(0.0, Some(2.0)).unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.0]));
        instance.exit_initialization_mode().unwrap();
        instance.do_step(0.0, 0.25).unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));

        let state = instance.state().unwrap();
        let bytes = state.to_bytes().unwrap();
        instance.set_real(&[LENGTH], &[0.2]).unwrap();
        instance.do_step(0.25, 1.0).unwrap();
        assert_eq!(outputs(&instance), predict([0.2, 3.0, 1.25]));
        state.restore().unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));
        instance.do_step(0.25, 1.0).unwrap();
        instance.state_from_bytes(&bytes).unwrap().restore().unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));
        drop(state);
        instance.terminate().unwrap();
    }
}

#[test]
fn model_exchange_goes_by_the_modes_of_the_standard() {
    let folder = tempfile::tempdir().unwrap();
    for version in VERSIONS {
        let path = fmu_of(folder.path(), version);
        let fmu = Fmu::open_for(path, InterfaceKind::ModelExchange).unwrap();
        assert_eq!((fmu.interface(), fmu.missing_functions()), (InterfaceKind::ModelExchange, vec![]));
        let instance = fmu.instantiate("test", true).unwrap();
        instance.set_real(&[SPEED, LENGTH], &[3.0, 0.12]).unwrap();
        instance.enter_initialization_mode(0.5, None).unwrap();
        instance.exit_initialization_mode().unwrap();
        assert_eq!(instance.settle_events().unwrap(), DiscreteStates::default());
        instance.set_time(0.75).unwrap();
        assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.75]));
        assert_eq!(instance.completed_integrator_step().unwrap(), CompletedStep::default());
        instance.set_continuous_states(&[]).unwrap();
        instance.get_continuous_states(&mut []).unwrap();
        instance.get_derivatives(&mut []).unwrap();
        instance.enter_event_mode().unwrap();
        instance.set_real(&[LENGTH], &[0.2]).unwrap();
        assert_eq!(outputs(&instance), predict([0.2, 3.0, 0.75]));
        assert!(matches!(instance.do_step(0.75, 0.1), Err(Error::MissingFunction { function: "DoStep", .. })));
        instance.terminate().unwrap();
    }
}

#[test]
fn numbers_of_every_type_are_read_and_set() {
    let folder = tempfile::tempdir().unwrap();
    for version in VERSIONS {
        let fmu = Fmu::open(fmu_of(folder.path(), version)).unwrap();
        let instance = fmu.instantiate("test", true).unwrap();
        let variable = |name: &str| fmu.description().variable(name).unwrap();
        instance.set_numbers(variable("domain_policy"), &[1.0]).unwrap();
        instance.set_numbers(variable("length"), &[0.25]).unwrap();
        instance.enter_initialization_mode(0.0, None).unwrap();
        assert_eq!(instance.get_numbers(variable("domain_policy")).unwrap(), [1.0]);
        assert_eq!(instance.get_numbers(variable("length")).unwrap(), [0.25]);
        assert_eq!(instance.get_numbers(variable("in_domain")).unwrap(), [0.0]);
        assert!((instance.get_numbers(variable("domain_distance")).unwrap()[0] - 0.5).abs() < 1e-12);
        assert_eq!(outputs(&instance), predict([0.2, 2.5, 0.0]), "clamped");
        for (name, values, problem) in [
            ("domain_policy", &[0.5][..], "value 0.5, expected an integer of type Int32"),
            ("domain_policy", &[1e10], "value 10000000000, expected an integer of type Int32"),
            ("in_domain", &[2.0], "value 2, expected 0 or 1"),
            ("length", &[1.0, 2.0], "2 values, expected 1"),
        ] {
            let found = message(instance.set_numbers(variable(name), values));
            assert_eq!(found, format!("variable `{name}`: {problem}"));
        }
    }
}

#[test]
fn derivatives_are_those_of_the_surrogate() {
    let folder = tempfile::tempdir().unwrap();
    for version in VERSIONS {
        let fmu = Fmu::open(fmu_of(folder.path(), version)).unwrap();
        let instance = fmu.instantiate("test", true).unwrap();
        instance.enter_initialization_mode(0.0, None).unwrap();
        let (length, speed) = (0.15000000000000002, 2.5);
        let difference = |output: usize| {
            let at = |length| predict([length, speed, 0.0])[output];
            (at(length + 1e-6) - at(length - 1e-6)) / 2e-6
        };
        let close = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()));
        let columns = instance.directional_derivative(&OUTPUTS, &[LENGTH], &[2.0]).unwrap();
        close(columns[0], 2.0 * difference(0));
        close(columns[1], 2.0 * difference(1));
        if version == FmiVersion::V3 {
            let row = instance.adjoint_derivative(&OUTPUTS, &[LENGTH], &[1.0, 2.0]).unwrap();
            close(row[0], difference(0) + 2.0 * difference(1));
        } else {
            let refused = instance.adjoint_derivative(&OUTPUTS[..1], &[LENGTH], &[1.0]);
            assert!(matches!(refused, Err(Error::MissingFunction { .. })));
        }
        instance.exit_initialization_mode().unwrap();
        instance.do_step(0.0, 0.5).unwrap();
        let rate = instance.output_derivatives(&OUTPUTS[..1], &[1]).unwrap()[0];
        let at = |time: f64| predict([length, speed, time])[0];
        close(rate, (at(0.5 + 1e-6) - at(0.5 - 1e-6)) / 2e-6);
    }
}

#[test]
fn inputs_drive_outputs_without_delay_by_every_version_and_interface() {
    let folder = tempfile::tempdir().unwrap();
    let inputs = Inputs { names: vec!["speed".into()], times: vec![0.0, 2.0], rows: vec![vec![1.0], vec![3.0]] };
    let options = SimulationOptions {
        stop: Some(1.95),
        step: Some(0.1),
        inputs,
        inputs_first: true,
        ..SimulationOptions::default()
    };
    let mut tables = Vec::new();
    for version in VERSIONS {
        for interface in [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange] {
            let fmu = Fmu::open_for(fmu_with_input(folder.path(), version), interface).unwrap();
            tables.push(simulate(&fmu.instantiate("test", true).unwrap(), &options).unwrap());
        }
    }
    assert_eq!(tables[0].times.len(), 21);
    for (time, row) in tables[0].times.iter().zip(&tables[0].rows) {
        let expected = predict([0.15000000000000002, 1.0 + time, *time]);
        assert!((row[0] - expected[0]).abs() + (row[1] - expected[1]).abs() < 1e-12, "{time}");
    }
    // times of steps are sums, times of model exchange are given: the last bits differ
    for table in &tables[1..] {
        assert_eq!((&table.columns, &table.times), (&tables[0].columns, &tables[0].times));
        for (row, expected) in table.rows.iter().flatten().zip(tables[0].rows.iter().flatten()) {
            assert!((row - expected).abs() < 1e-12, "{row} {expected}");
        }
    }
    let path = fmu_with_input(folder.path(), FmiVersion::V3);
    let fmu = Fmu::open(path).unwrap();
    let wrong = |name: &str| {
        let inputs = Inputs { names: vec![name.into()], times: vec![0.0], rows: vec![vec![1.0]] };
        message(simulate(&fmu.instantiate("x", true).unwrap(), &SimulationOptions { inputs, ..Default::default() }))
    };
    assert_eq!(wrong("length"), "variable `length`: is not an input; only inputs change over time");
    assert!(wrong("sped").starts_with("the FMU has no variable `sped`"));
}

#[test]
fn a_refused_call_is_an_error_with_what_the_fmu_logged() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = Fmu::open(fmu(folder.path())).unwrap();
    let instance = fmu.instantiate("test", true).unwrap();
    let Err(Error::Fmi { function, status, messages }) = instance.do_step(0.0, 1.0) else { panic!("no error") };
    assert_eq!((function, status), ("fmi2DoStep", "error"));
    assert!(messages[0].contains("fmi2DoStep"), "{messages:?}");
    let refused = message(fmu.instantiate_as("test", "{no such token}", true));
    assert!(refused.starts_with("fmi2Instantiate returned no instance: "), "{refused}");
    assert!(refused.contains("{no such token}"), "{refused}");
}

#[test]
fn a_simulation_records_outputs_and_more_from_the_start_to_the_end() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = Fmu::open(fmu(folder.path())).unwrap();
    let instance = fmu.instantiate("test", true).unwrap();
    let options = SimulationOptions {
        stop: Some(0.95),
        step: Some(0.1),
        start_values: vec![("speed".into(), 4.0)],
        record: vec!["length".into(), "angle".into(), "in_domain".into()],
        ..SimulationOptions::default()
    };
    let table = simulate(&instance, &options).unwrap();
    let columns: Vec<_> = table.columns.iter().map(|c| (c.name.as_str(), c.unit.as_deref())).collect();
    assert_eq!(
        columns,
        [("angle", Some("rad")), ("velocity", Some("rad/s")), ("length", Some("m")), ("in_domain", None)]
    );
    assert_eq!(table.times.len(), 11);
    assert_eq!((table.times[3], table.times[10]), (3.0 * 0.1, 0.95));
    for (time, row) in table.times.iter().zip(&table.rows) {
        let expected = predict([row[2], 4.0, *time]);
        assert!((row[0] - expected[0]).abs() + (row[1] - expected[1]).abs() < 1e-13, "{time}");
    }
    instance.reset().unwrap();
    assert_eq!(simulate(&instance, &options).unwrap(), table);
    instance.reset().unwrap();
    let nothing = SimulationOptions { stop: Some(0.0), ..SimulationOptions::default() };
    assert_eq!(simulate(&instance, &nothing).unwrap().times, [0.0]);
}

#[test]
fn what_cannot_be_simulated_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = Fmu::open(fmu(folder.path())).unwrap();
    let run = |options: SimulationOptions| {
        let instance = fmu.instantiate("test", true).unwrap();
        message(simulate(&instance, &options))
    };
    let start = |name: &str, value| SimulationOptions {
        start_values: vec![(name.into(), value)],
        ..SimulationOptions::default()
    };
    assert_eq!(
        run(start("lenght", 1.0)),
        "the FMU has no variable `lenght`; it has `length`, `speed`, `time`, `angle`, `velocity`, \
         `domain_policy`, `in_domain`, `domain_distance`; did you mean `length`?"
    );
    assert_eq!(run(start("angle", 1.0)), "variable `angle`: has no start value to be set");
    let backwards = SimulationOptions { stop: Some(-1.0), ..SimulationOptions::default() };
    assert_eq!(run(backwards), "start 0 s, stop -1 s, step 0.01 s: finite times, the stop not before the start");
}

#[test]
fn an_fmu_that_cannot_run_here_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: PathBuf| message(Fmu::open(path));
    let expected = Platform::CURRENT.binary(FmiVersion::V2, "example");
    let elsewhere = changed_fmu(folder.path(), |entries| {
        entry(entries, "binaries/").0 = "binaries/amiga/example.so".into();
    });
    let reason = format!("no binary for this platform: found `amiga`, expected `{expected}`");
    assert!(open(elsewhere).ends_with(&reason));
    let garbage = changed_fmu(folder.path(), |entries| entry(entries, "binaries/").1 = b"no library".into());
    assert!(open(garbage).contains(&format!("`{expected}` cannot be loaded: ")));
    let remove = |text: &str, element: &str| {
        let start = text.find(element).unwrap();
        let end = start + text[start..].find("/>").unwrap() + 2;
        [&text[..start], &text[end..]].concat()
    };
    let exchange = fmu_described_as(folder.path(), |text| remove(&text, "<CoSimulation"));
    assert_eq!(Fmu::open(&exchange).unwrap().interface(), InterfaceKind::ModelExchange);
    let refused = message(Fmu::open_for(&exchange, InterfaceKind::CoSimulation));
    assert!(refused.ends_with("offers model exchange only, expected co-simulation"), "{refused}");
    let none = fmu_described_as(folder.path(), |text| remove(&remove(&text, "<CoSimulation"), "<ModelExchange"));
    assert!(open(none).ends_with("offers no interface, expected co-simulation or model exchange"));
    let newer = fmu_described_as(folder.path(), |text| text.replace("fmiVersion=\"2.0\"", "fmiVersion=\"4.0\""));
    assert!(open(newer).ends_with("fmiVersion is \"4.0\": only FMI 2.0 and 3.0 are supported"));
    let wrong =
        fmu_described_as(folder.path(), |text| text.replacen("valueReference=\"1\"", "valueReference=\"a\"", 1));
    assert!(open(wrong).contains("<ScalarVariable> has valueReference=\"a\", expected"));
}

#[test]
fn elements_of_an_array_are_columns_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = Fmu::open(fmu_with_arrays(folder.path(), FmiVersion::V3)).unwrap();
    let table = simulate(&fmu.instantiate("test", true).unwrap(), &SimulationOptions::default()).unwrap();
    let names: Vec<&str> = table.columns.iter().map(|column| column.name.as_str()).collect();
    assert_eq!(names[..2], ["x", "y"]);
    assert_eq!(names[2..], ["position[1]", "position[2]", "swapped[1]", "swapped[2]"]);
    assert!(table.rows.iter().all(|row| row[..2] == row[2..4] && row[0] == row[5] && row[1] == row[4]));
}
