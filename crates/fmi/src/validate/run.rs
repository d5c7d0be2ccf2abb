//! Runs an FMU along its default experiment, by whichever interface it was loaded for.

use super::{Area, Notes};
use crate::{
    Fmu, FmuInstance, InterfaceKind, Result,
    host::{Exchange, Grid, NO_INPUTS, Recorder, RunPosition, SimulationOptions, StepResult},
};
use std::ops::Range;

/// A run that would take more steps than this is cut short.
const MAX_STEPS: usize = 1000;

/// A run that is under way.
pub struct ValidationRun<'a> {
    /// The instance that runs.
    pub instance: &'a FmuInstance<'a>,
    experiment: &'a Grid,
    /// Model exchange.
    exchange: Option<Exchange<'a>>,
}

impl<'a> ValidationRun<'a> {
    /// Initializes a fresh or reset instance, `set` being called before Initialization Mode.
    pub fn start(
        instance: &'a FmuInstance<'a>,
        experiment: &'a Grid,
        set: impl FnOnce(&FmuInstance) -> Result<()>,
    ) -> Result<Self> {
        set(instance)?;
        let start = experiment.time(0);
        instance.enter_initialization_mode(start, experiment.stop_time())?;
        instance.exit_initialization_mode()?;
        let mut exchange = None;
        if instance.fmu().interface() == InterfaceKind::ModelExchange {
            exchange = Some(Exchange::start(instance, &NO_INPUTS, None, start)?.0);
        }
        Ok(Self { instance, experiment, exchange })
    }

    /// The outputs now.
    pub fn row(&self) -> Result<Vec<f64>> {
        Recorder::new(self.instance, &[], false)?.row()
    }

    /// Advances by one step of the experiment.
    pub fn step(&mut self, index: usize) -> Result<StepResult> {
        match &mut self.exchange {
            Some(run) => run.advance(self.experiment.time(index + 1)),
            None => self.instance.do_step(self.experiment.time(index), self.experiment.size(index)),
        }
    }

    /// Rows after each step, up to that in which the FMU ends the simulation.
    pub fn steps(&mut self, range: Range<usize>) -> Result<Vec<Vec<f64>>> {
        let recorder = Recorder::new(self.instance, &[], false)?;
        let mut rows = Vec::new();
        for index in range {
            let end = self.step(index)?;
            rows.push(recorder.row()?);
            if end != StepResult::Done {
                break;
            }
        }
        Ok(rows)
    }

    /// Position of the host in model exchange, which a state of the FMU does not contain.
    pub fn position(&self) -> Option<RunPosition> {
        self.exchange.as_ref().map(|run| run.position().clone())
    }

    /// Back to where the instance was put.
    pub fn rewind(&mut self, position: Option<RunPosition>) {
        if let (Some(run), Some(position)) = (&mut self.exchange, position) {
            run.rewind(position);
        }
    }
}

/// Rows of the outputs at every communication point of a fresh or reset instance, which is terminated.
pub fn whole_run(instance: &FmuInstance, experiment: &Grid) -> Result<Vec<Vec<f64>>> {
    let mut run = ValidationRun::start(instance, experiment, |_| Ok(()))?;
    let mut rows = vec![run.row()?];
    rows.extend(run.steps(0..experiment.steps())?);
    instance.terminate()?;
    Ok(rows)
}

/// The communication points of the default experiment, as far as they are run.
pub fn experiment(fmu: &Fmu, report: &mut Notes) -> Option<Grid> {
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
            report.problem(Area::Behavior, format!("the default experiment cannot be run: {error}"));
            None
        }
    }
}
