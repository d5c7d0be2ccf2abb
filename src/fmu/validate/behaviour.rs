//! Runs an FMU and compares what it does with what the standard says.

use super::{Area, Report};
use crate::{
    Result,
    fmu::{
        Fmu, Instance,
        host::{Grid, Recorder, SimulationOptions, Step},
    },
};
use std::ops::Range;

/// A run that would take more steps than this is cut short.
const MAX_STEPS: usize = 1000;

/// Reports what the binary lacks and what goes wrong when it is run.
pub fn check(fmu: &Fmu, report: &mut Report) {
    for function in fmu.missing_functions() {
        report.problem(Area::Binary, format!("does not export `{function}`"));
    }
    for (function, found, expected) in
        [("fmi2GetVersion", fmu.version(), "2.0"), ("fmi2GetTypesPlatform", fmu.types_platform(), "default")]
    {
        if found != expected {
            report.problem(Area::Binary, format!("{function} returns \"{found}\", expected \"{expected}\""));
        }
    }
    if fmu.instantiate_as("wrong token", "{no such token}", false).is_ok() {
        report.problem(Area::Behaviour, "fmi2Instantiate accepts a guid that is not that of modelDescription.xml");
    }
    let Some(mut experiment) = experiment(fmu, report) else { return };
    let mut reference = Vec::new();
    attempt(report, "the default experiment", || {
        reference = run(&fmu.instantiate("validation", true)?, &experiment)?;
        Ok(reference.iter().flatten().any(|value| !value.is_finite()).then_some("an output is not a finite number"))
    });
    if reference.is_empty() {
        return;
    }
    // an FMU may end the simulation by itself; after that nothing may be called but what ends it
    experiment.shorten(reference.len() - 1);
    attempt(report, "outputs in Initialization Mode", || in_initialization_mode(fmu, &experiment));
    attempt(report, "a run after fmi2Reset", || {
        let instance = fmu.instantiate("reset", true)?;
        run(&instance, &experiment)?;
        instance.reset()?;
        Ok(differ(&run(&instance, &experiment)?, &reference))
    });
    if fmu.co_simulation().interface.only_once_per_process {
        report.skipped("two instances at once: the FMU allows one per process");
    } else {
        attempt(report, "two instances at once", || two_at_once(fmu, &experiment, &reference));
    }
    states(fmu, &experiment, &reference, report);
}

/// Runs a check that returns what is different from what it should be, and reports that or the failure.
fn attempt(report: &mut Report, what: &str, check: impl FnOnce() -> Result<Option<&'static str>>) {
    match check() {
        Ok(None) => {}
        Ok(Some(difference)) => report.problem(Area::Behaviour, format!("{what}: {difference}")),
        Err(error) => report.problem(Area::Behaviour, format!("{what}: {error}")),
    }
}

/// The communication points of the default experiment, as far as they are run.
pub fn experiment(fmu: &Fmu, report: &mut Report) -> Option<Grid> {
    let suggested = fmu.description().default_experiment.unwrap_or_default();
    let mut options = SimulationOptions::default();
    if suggested.stop.is_none() {
        options.stop = Some(suggested.start.unwrap_or(0.0) + 1.0);
    }
    match Grid::new(fmu, &options) {
        Ok(mut grid) => {
            if grid.steps() > MAX_STEPS {
                let time = grid.time(MAX_STEPS);
                report.skipped(format!("the default experiment after {MAX_STEPS} steps, from {time} s on"));
                grid.shorten(MAX_STEPS);
            }
            Some(grid)
        }
        Err(error) => {
            report.problem(Area::Behaviour, format!("the default experiment cannot be run: {error}"));
            None
        }
    }
}

/// Rows of the outputs at every communication point of a fresh or reset instance.
fn run(instance: &Instance, experiment: &Grid) -> Result<Vec<Vec<f64>>> {
    initialize(instance, experiment)?;
    let mut rows = vec![Recorder::new(instance, &[])?.row()?];
    rows.extend(steps(instance, experiment, 0..experiment.steps())?);
    Ok(rows)
}

fn initialize(instance: &Instance, experiment: &Grid) -> Result<()> {
    instance.setup_experiment(experiment.time(0), Some(experiment.time(experiment.steps())))?;
    instance.enter_initialization_mode()?;
    instance.exit_initialization_mode()
}

/// Rows after each step, up to that in which the FMU ends the simulation.
fn steps(instance: &Instance, experiment: &Grid, range: Range<usize>) -> Result<Vec<Vec<f64>>> {
    let recorder = Recorder::new(instance, &[])?;
    let mut rows = Vec::new();
    for step in range {
        let end = instance.do_step(experiment.time(step), experiment.size(step))?;
        rows.push(recorder.row()?);
        if end != Step::Done {
            break;
        }
    }
    Ok(rows)
}

/// A host must be able to read the outputs in Initialization Mode.
fn in_initialization_mode(fmu: &Fmu, experiment: &Grid) -> Result<Option<&'static str>> {
    let instance = fmu.instantiate("initialization", true)?;
    instance.setup_experiment(experiment.time(0), None)?;
    instance.enter_initialization_mode()?;
    let row = Recorder::new(&instance, &[])?.row()?;
    instance.exit_initialization_mode()?;
    Ok(row.iter().any(|value| !value.is_finite()).then_some("one is not a finite number"))
}

/// Two instances must not share anything: they are stepped in turn.
fn two_at_once(fmu: &Fmu, experiment: &Grid, reference: &[Vec<f64>]) -> Result<Option<&'static str>> {
    let instances = [fmu.instantiate("first", true)?, fmu.instantiate("second", true)?];
    let mut rows = [Vec::new(), Vec::new()];
    for (instance, rows) in instances.iter().zip(&mut rows) {
        initialize(instance, experiment)?;
        rows.push(Recorder::new(instance, &[])?.row()?);
    }
    for step in 0..experiment.steps() {
        for (instance, rows) in instances.iter().zip(&mut rows) {
            rows.extend(steps(instance, experiment, step..step + 1)?);
        }
    }
    Ok(rows.iter().find_map(|rows| differ(rows, reference)))
}

/// A state taken in the middle of a run and put back must lead to the same end.
fn states(fmu: &Fmu, experiment: &Grid, reference: &[Vec<f64>], report: &mut Report) {
    let interface = &fmu.co_simulation().interface;
    if !interface.get_and_set_state {
        return report.skipped("FMU states: the FMU offers none");
    }
    let middle = experiment.steps() / 2;
    let rest = middle..experiment.steps();
    attempt(report, "a state put back", || {
        let instance = fmu.instantiate("state", true)?;
        initialize(&instance, experiment)?;
        steps(&instance, experiment, 0..middle)?;
        let state = instance.state()?;
        steps(&instance, experiment, rest.clone())?;
        state.restore()?;
        Ok(differ(&steps(&instance, experiment, rest.clone())?, &reference[middle + 1..]))
    });
    if !interface.serialize_state {
        return report.skipped("FMU states as bytes: the FMU offers none");
    }
    attempt(report, "a state put back from bytes", || {
        let instance = fmu.instantiate("bytes", true)?;
        initialize(&instance, experiment)?;
        steps(&instance, experiment, 0..middle)?;
        let bytes = instance.state()?.to_bytes()?;
        steps(&instance, experiment, rest.clone())?;
        instance.state_from_bytes(&bytes)?.restore()?;
        Ok(differ(&steps(&instance, experiment, rest.clone())?, &reference[middle + 1..]))
    });
}

/// Bit by bit: the same computation gives the same numbers.
fn differ(found: &[Vec<f64>], expected: &[Vec<f64>]) -> Option<&'static str> {
    let same = |(found, expected): (&f64, &f64)| found.to_bits() == expected.to_bits();
    let all_same = found.len() == expected.len()
        && found.iter().zip(expected).all(|(found, expected)| found.iter().zip(expected).all(same));
    (!all_same).then_some("the outputs are not those of the first run")
}
