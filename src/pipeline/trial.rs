//! A study tried before it is built: what a build checks before and at the beginning of its sampling, and a few runs.

use crate::{
    Error, Result,
    multibody::Mechanism,
    project::Control,
    sampling::Plan,
    search,
    source::{Simulation, Source},
    study::Study,
};
use metafmu_runtime::Rows;
use rayon::prelude::*;
use std::{sync::atomic::Ordering, time::Duration};

/// Runs that are tried.
const RUNS: usize = 8;

/// A run that takes longer is not waited for.
const LIMIT: Duration = Duration::from_secs(2);

/// Result of a trial.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Trial {
    /// Runs that were tried; none of recorded runs and of FMUs.
    pub runs: usize,
    /// Parameters of each run that failed, and why.
    pub failures: Vec<String>,
}

/// Finds the source of a study, reads recorded runs, and simulates a few runs of a system or mechanism.
///
/// # Errors
/// What a build would refuse: those of [`Source::new`] and [`Recorded::sample`](crate::source::Recorded::sample); [`Error::Interrupted`].
pub fn attempt(study: &Study, control: Control<'_>) -> Result<Trial> {
    search::check(study)?;
    let simulation: Simulation = match Source::new(study)? {
        Source::Simulation(simulation) => simulation,
        Source::Recorded(recorded) => {
            recorded.sample(control.stop)?;
            return Ok(Trial::default());
        }
        Source::Rows(rows) => {
            rows.read(study, control.stop)?;
            return Ok(Trial::default());
        }
    };
    let points = points(study);
    let attempts = (0..points.len()).into_par_iter();
    let found: Vec<_> = attempts.filter_map(|run| simulation.attempt(&points[run], LIMIT, control.stop)).collect();
    if control.stop.load(Ordering::Relaxed) {
        return Err(Error::Interrupted);
    }
    let failures = points.iter().zip(&found).filter_map(|(point, outcome)| {
        let failure = outcome.as_ref().err()?;
        Some(format!("{}: {failure}", simulation.values(point)))
    });
    Ok(Trial { runs: found.len(), failures: failures.collect() })
}

/// Smallest and largest value that each coordinate of a study of a mechanism reaches in the same runs; none if a run fails.
pub fn reached(study: &Study, mechanism: &Mechanism) -> Option<Vec<[f64; 2]>> {
    let Source::Simulation(simulation) = Source::new(study).ok()? else { return None };
    let points = points(study);
    let runs: Vec<_> = points.iter().map(|point| (point, simulation.times())).collect();
    let mut reached = simulation.driven()?.reached(mechanism, &runs).ok()?;
    reached.truncate(study.coordinates().count());
    Some(reached)
}

/// Parameters of the runs that are tried.
fn points(study: &Study) -> Rows {
    let Plan { train, test, .. } = Plan::new(study);
    train.iter().take(RUNS / 2).chain(test.iter().take(RUNS / 2)).collect()
}
