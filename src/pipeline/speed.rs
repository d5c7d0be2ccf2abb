//! Speed of a surrogate and of its source: seconds of one core for a simulated second.

use super::{
    project::Project,
    record::{Cost, Speed},
};
use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::predict,
    source::{Simulation, Source},
};
use metafmu_runtime::{Evaluator, Surrogate};
use std::time::{Duration, Instant};

/// Time after which a measurement is not repeated, and most repetitions; the shortest counts.
const ENOUGH: (Duration, usize) = (Duration::from_millis(100), 20);
/// Runs of an FMU or a program.
const RUNS: usize = 4;
/// Time of a run of an FMU or a program that is not repeated.
const LONG: Duration = Duration::from_secs(2);

/// Rows of which a step's cost is measured, if the test runs have as many.
const ROWS: usize = 1000;

/// Measures the cost of a step, and the speed beside the source's.
///
/// # Errors
/// As [`measure`].
pub(super) fn cost(project: &Project, surrogate: &Surrogate, test: &Dataset) -> Result<Cost> {
    Ok(Cost { seconds_per_step: seconds_per_step(surrogate, test), speed: measure(project, surrogate, test)? })
}

fn seconds_per_step(surrogate: &Surrogate, test: &Dataset) -> Option<f64> {
    let mut rows = 0;
    let runs = test.runs.iter().take_while(|run| {
        let is_enough = rows >= ROWS;
        rows += run.times.len();
        !is_enough
    });
    let runs: Vec<&Run> = runs.collect();
    let rows: usize = runs.iter().map(|run| run.times.len()).sum();
    let evaluator = Evaluator::new(surrogate);
    let seconds = shortest(|| {
        for run in &runs {
            std::hint::black_box(predict(surrogate, &evaluator, run));
        }
    });
    (rows > 0).then(|| seconds / rows as f64)
}

/// Measures both; none of recorded runs, whose source cannot be run, or where a run fails.
///
/// # Errors
/// Those of an FMU or a program that cannot be started, [`Error::Interrupted`](crate::Error::Interrupted).
fn measure(project: &Project, surrogate: &Surrogate, test: &Dataset) -> Result<Option<Speed>> {
    // a compliant element has no run to itself: another component moves it
    let Source::Simulation(simulation) = &project.source else { return Ok(None) };
    if project.study.is_compliant() {
        return Ok(None);
    }
    let Some(run) = test.runs.first() else { return Ok(None) };
    let length = |times: &[f64]| times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    let Some(of_source) = of_source(project, simulation)? else { return Ok(None) };
    let evaluator = Evaluator::new(surrogate);
    let of_surrogate = shortest(|| {
        std::hint::black_box(predict(surrogate, &evaluator, run));
    });
    let (source, surrogate) = (of_source / length(simulation.times()), of_surrogate / length(&run.times));
    let speed_up = source / surrogate;
    Ok((speed_up.is_finite() && speed_up > 0.0).then_some(Speed { source, surrogate, speed_up }))
}

/// Shortest time of some repetitions, in seconds.
fn shortest(mut work: impl FnMut()) -> f64 {
    let began = Instant::now();
    let mut shortest = f64::INFINITY;
    for _ in 0..ENOUGH.1 {
        let start = Instant::now();
        work();
        shortest = shortest.min(start.elapsed().as_secs_f64());
        if began.elapsed() > ENOUGH.0 {
            break;
        }
    }
    shortest
}

/// Seconds of a run of the source; none if it fails.
fn of_source(project: &Project, simulation: &Simulation) -> Result<Option<f64>> {
    let points: Vec<Vec<f64>> = simulation.plan(&project.study).test.into_iter().take(RUNS).collect();
    let Some(first) = points.first() else { return Ok(None) };
    let Some(model) = simulation.worker_model() else {
        let mut fails = false;
        let seconds = shortest(|| fails |= simulation.run(first).is_err());
        return Ok((!fails).then_some(seconds));
    };
    model.seconds(&points, LONG, project.workers())
}
