//! Runs FMUs made here.

use super::*;
use crate::fmu::testing::{changed_fmu, fmu, fmu_described_as};
use metafmu_runtime::{Evaluator, example};

fn predict(inputs: [f64; 3]) -> [f64; 2] {
    let evaluator = Evaluator::new(&example::surrogate());
    let mut outputs = [0.0; 2];
    evaluator.evaluate(&inputs, &mut outputs, &mut evaluator.scratch());
    outputs
}

fn outputs(instance: &Instance) -> [f64; 2] {
    let mut outputs = [0.0; 2];
    instance.get_real(&[3, 4], &mut outputs).unwrap();
    outputs
}

fn message(result: Result<impl std::fmt::Debug>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn an_instance_computes_what_the_surrogate_predicts() {
    let folder = tempfile::tempdir().unwrap();
    let fmu = Fmu::open(fmu(folder.path())).unwrap();
    assert_eq!((fmu.version().as_str(), fmu.types_platform().as_str()), ("2.0", "default"));
    assert_eq!(fmu.missing_functions(), [""; 0]);
    let instance = fmu.instantiate("test", true).unwrap();
    instance.set_real(&[1, 0], &[3.0, 0.12]).unwrap();
    instance.enter_initialization_mode(0.0, Some(2.0)).unwrap();
    assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.0]));
    instance.exit_initialization_mode().unwrap();
    instance.do_step(0.0, 0.25).unwrap();
    assert_eq!(outputs(&instance), predict([0.12, 3.0, 0.25]));

    let state = instance.state().unwrap();
    let bytes = state.to_bytes().unwrap();
    instance.set_real(&[0], &[0.2]).unwrap();
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
        record: vec!["length".into(), "angle".into()],
        ..SimulationOptions::default()
    };
    let table = simulate(&instance, &options).unwrap();
    let columns: Vec<_> = table.columns.iter().map(|c| (c.name.as_str(), c.unit.as_deref())).collect();
    assert_eq!(columns, [("angle", Some("rad")), ("velocity", Some("rad/s")), ("length", Some("m"))]);
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
        "the FMU has no variable `lenght`; it has `length`, `speed`, `time`, `angle`, `velocity`"
    );
    assert_eq!(run(start("angle", 1.0)), "variable `angle`: has no start value to be set");
    let backwards = SimulationOptions { stop: Some(-1.0), ..SimulationOptions::default() };
    assert_eq!(run(backwards), "start 0 s, stop -1 s, step 0.01 s: finite times, the stop not before the start");
}

#[test]
fn an_fmu_that_cannot_run_here_says_why() {
    let folder = tempfile::tempdir().unwrap();
    let open = |path: PathBuf| message(Fmu::open(path));
    let expected = Platform::CURRENT.binary("example");
    let elsewhere = changed_fmu(folder.path(), |entries| entries[1].0 = "binaries/amiga/example.so".into());
    let reason = format!("no binary for this platform: found `amiga`, expected `{expected}`");
    assert!(open(elsewhere).ends_with(&reason));
    let garbage = changed_fmu(folder.path(), |entries| entries[1].1 = b"no library".into());
    assert!(open(garbage).contains(&format!("`{expected}` cannot be loaded: ")));
    let exchange = fmu_described_as(folder.path(), |text| {
        let start = text.find("<CoSimulation").unwrap();
        let end = start + text[start..].find("/>").unwrap() + 2;
        format!("{}<ModelExchange modelIdentifier=\"example\"/>{}", &text[..start], &text[end..])
    });
    assert!(open(exchange).ends_with("offers model exchange only, expected co-simulation"));
    let newer = fmu_described_as(folder.path(), |text| text.replace("fmiVersion=\"2.0\"", "fmiVersion=\"3.0\""));
    assert!(open(newer).ends_with("modelDescription.xml, line 2: fmiVersion is \"3.0\": only FMI 2.0 is supported"));
    let wrong =
        fmu_described_as(folder.path(), |text| text.replacen("valueReference=\"0\"", "valueReference=\"a\"", 1));
    assert!(open(wrong).contains("<ScalarVariable> has valueReference=\"a\", expected"));
}

#[test]
fn a_path_becomes_a_percent_encoded_uri() {
    let uri = file_uri(Path::new("/tmp/a b/\u{fc}#%/resources"));
    assert_eq!(uri.to_str().unwrap(), "file:///tmp/a%20b/%C3%BC%23%25/resources");
}
