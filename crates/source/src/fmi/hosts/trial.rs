//! Does an FMU run at all?

use super::facts::{FailedTrial, FmuFacts};
use crate::{
    Error, Result,
    fmi::{
        InterfaceKind, Watch,
        host::{RecordedColumn, RowSink, SimulationOptions, Unpacked},
        model_description::DefaultExperiment,
        simulate_apart,
    },
};
use std::path::Path;

/// Communication steps of a trial.
const STEPS: f64 = 10.0;
/// Step size of an FMU that suggests none, in seconds, unless it suggests a stop time.
const USUAL_STEP: f64 = 0.01;
/// Steps up to a stop time that is suggested without a step size.
const STEPS_OF_EXPERIMENT: f64 = 500.0;

/// Rows that nobody looks at.
struct NoRows;

impl RowSink for NoRows {
    fn begin(&mut self, _columns: &[RecordedColumn]) -> Result<()> {
        Ok(())
    }

    fn row(&mut self, _time: f64, _values: &[f64]) -> Result<()> {
        Ok(())
    }
}

/// Interfaces by which an FMU does not run for some steps of its default experiment.
pub(super) fn failures(path: &Path, facts: &FmuFacts, watch: Watch) -> Result<Vec<FailedTrial>> {
    let mut failed = Vec::new();
    for interface in [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange] {
        if facts.offers(facts.version(), interface) {
            match run(path, facts, interface, watch) {
                Ok(()) => {}
                Err(Error::Interrupted) => return Err(Error::Interrupted),
                Err(error) => failed.push(FailedTrial { interface, message: error.to_string() }),
            }
        }
    }
    Ok(failed)
}

fn run(path: &Path, facts: &FmuFacts, interface: InterfaceKind, watch: Watch) -> Result<()> {
    let experiment = facts.description().default_experiment.unwrap_or_default();
    let inside = facts.description().co_simulation.as_ref().and_then(|offered| offered.fixed_internal_step_size);
    let (start, step) = (experiment.start.unwrap_or(0.0), step_size(&experiment, inside));
    let options = SimulationOptions {
        start: Some(start),
        stop: Some(start + STEPS * step),
        step: Some(step),
        ..SimulationOptions::default()
    };
    let unpacked = Unpacked::open(path, Some(interface), watch.patience())?;
    simulate_apart(&unpacked, &options, watch, &mut NoRows).map(drop)
}

/// `inside`: step size inside the FMU.
fn step_size(experiment: &DefaultExperiment, inside: Option<f64>) -> f64 {
    let of_stop = experiment.stop.map(|stop| (stop - experiment.start.unwrap_or(0.0)) / STEPS_OF_EXPERIMENT);
    let sizes = [experiment.step_size, inside, of_stop];
    sizes.into_iter().flatten().find(|size| *size > 0.0 && size.is_finite()).unwrap_or(USUAL_STEP)
}
