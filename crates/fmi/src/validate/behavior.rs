//! Runs an FMU by one of its interfaces and compares its behavior with the standard.

use super::{
    Area, Notes,
    run::{ValidationRun, experiment, whole_run},
};
use crate::{
    Error, FmiVersion, Fmu, Result,
    host::{Grid, Recorder},
};

/// Reports missing functions of the binary and errors when it is run.
pub fn check(fmu: &Fmu, report: &mut Notes) {
    report.doing("its version");
    binary(fmu, report);
    report.doing("an instance with a wrong token");
    if fmu.instantiate_as("wrong token", "{no such token}", false).is_ok() {
        report.problem(Area::Behavior, "an instance is made with a token that is not that of modelDescription.xml");
    }
    let Some(mut experiment) = experiment(fmu, report) else { return };
    attempt(fmu, report, "outputs in Initialization Mode", || in_initialization_mode(fmu, experiment.time(0)));
    let mut reference = Vec::new();
    attempt(fmu, report, "the default experiment", || {
        reference = whole_run(&fmu.instantiate("validation", true)?, &experiment)?;
        Ok(reference.iter().flatten().any(|value| !value.is_finite()).then_some("an output is not a finite number"))
    });
    if reference.is_empty() {
        return;
    }
    // an FMU may end the simulation; after that only functions that end the instance may be called
    experiment.shorten(reference.len() - 1);
    attempt(fmu, report, "a run after a reset", || {
        let instance = fmu.instantiate("reset", true)?;
        whole_run(&instance, &experiment)?;
        instance.reset()?;
        Ok(differ(&whole_run(&instance, &experiment)?, &reference))
    });
    if fmu.capabilities().only_once_per_process {
        report.skipped("two instances at once: the FMU allows one per process");
    } else {
        attempt(fmu, report, "two instances at once", || two_at_once(fmu, &experiment, &reference));
    }
    states_put_back(fmu, &experiment, &reference, report);
}

fn binary(fmu: &Fmu, report: &mut Notes) {
    for function in fmu.missing_functions() {
        report.problem(Area::Binary, format!("does not export `{function}`"));
    }
    let version = fmu.version();
    let right = match fmu.description().fmi_version {
        FmiVersion::V2 => version == "2.0",
        FmiVersion::V3 => version.starts_with("3."),
    };
    if !right {
        let expected = fmu.description().fmi_version;
        report.problem(Area::Binary, format!("says it is of version \"{version}\", expected \"{expected}\""));
    }
    if let Some(platform) = fmu.types_platform().filter(|platform| platform != "default") {
        report.problem(Area::Binary, format!("fmi2GetTypesPlatform returns \"{platform}\", expected \"default\""));
    }
}

/// Runs a check that returns a difference from the expected result, and reports that or the failure.
pub fn attempt(fmu: &Fmu, report: &mut Notes, what: &str, check: impl FnOnce() -> Result<Option<&'static str>>) {
    let interface = fmu.interface();
    report.doing(what);
    match check() {
        Ok(None) => {}
        Ok(Some(difference)) => report.problem(Area::Behavior, format!("{interface}, {what}: {difference}")),
        // the FMU may be right and the method not made for it
        Err(error @ Error::Integration { .. }) => report.skipped(format!("{what}: {error}")),
        Err(error) => report.problem(Area::Behavior, format!("{interface}, {what}: {error}")),
    }
}

/// A host must be able to read the outputs in Initialization Mode.
fn in_initialization_mode(fmu: &Fmu, start: f64) -> Result<Option<&'static str>> {
    let instance = fmu.instantiate("initialization", true)?;
    instance.enter_initialization_mode(start, None)?;
    let row = Recorder::new(&instance, &[], false)?.row()?;
    instance.exit_initialization_mode()?;
    Ok(row.iter().any(|value| !value.is_finite()).then_some("one is not a finite number"))
}

/// Two instances must not share anything: they are stepped in turn.
fn two_at_once(fmu: &Fmu, experiment: &Grid, reference: &[Vec<f64>]) -> Result<Option<&'static str>> {
    let instances = [fmu.instantiate("first", true)?, fmu.instantiate("second", true)?];
    let mut runs = [
        ValidationRun::start(&instances[0], experiment, |_| Ok(()))?,
        ValidationRun::start(&instances[1], experiment, |_| Ok(()))?,
    ];
    let mut rows = [vec![runs[0].row()?], vec![runs[1].row()?]];
    for step in 0..experiment.steps() {
        for (run, rows) in runs.iter_mut().zip(&mut rows) {
            rows.extend(run.steps(step..step + 1)?);
        }
    }
    Ok(rows.iter().find_map(|rows| differ(rows, reference)))
}

/// A state taken in the middle of a run and put back must lead to the same end.
fn states_put_back(fmu: &Fmu, experiment: &Grid, reference: &[Vec<f64>], report: &mut Notes) {
    let capabilities = fmu.capabilities();
    if !capabilities.get_and_set_state {
        return report.skipped("FMU states: the FMU offers none");
    }
    let middle = experiment.steps() / 2;
    let rest = middle..experiment.steps();
    attempt(fmu, report, "a state put back", || {
        let instance = fmu.instantiate("state", true)?;
        let mut run = ValidationRun::start(&instance, experiment, |_| Ok(()))?;
        run.steps(0..middle)?;
        let (state, position) = (instance.state()?, run.position());
        run.steps(rest.clone())?;
        state.restore()?;
        run.rewind(position);
        Ok(differ(&run.steps(rest.clone())?, &reference[middle + 1..]))
    });
    if !capabilities.serialize_state {
        return report.skipped("FMU states as bytes: the FMU offers none");
    }
    attempt(fmu, report, "a state put back from bytes", || {
        let instance = fmu.instantiate("bytes", true)?;
        let mut run = ValidationRun::start(&instance, experiment, |_| Ok(()))?;
        run.steps(0..middle)?;
        let (bytes, position) = (instance.state()?.to_bytes()?, run.position());
        run.steps(rest.clone())?;
        instance.state_from_bytes(&bytes)?.restore()?;
        run.rewind(position);
        Ok(differ(&run.steps(rest.clone())?, &reference[middle + 1..]))
    });
}

/// Bit by bit: the same computation gives the same numbers.
fn differ(found: &[Vec<f64>], expected: &[Vec<f64>]) -> Option<&'static str> {
    let mut rows = found.iter().zip(expected);
    let all_same = found.len() == expected.len()
        && rows.all(|(found, expected)| found.iter().zip(expected).all(|(a, b)| a.to_bits() == b.to_bits()));
    (!all_same).then_some("the outputs are not those of the first run")
}
