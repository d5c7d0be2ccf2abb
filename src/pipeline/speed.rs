//! Speed of a surrogate and of its source: seconds of one core for a simulated second.

use super::{project::Project, record::Speed};
use crate::{
    Result,
    dataset::Dataset,
    evaluation::predict,
    source::{Simulation, Source},
};
use metafmu_runtime::{Evaluator, Surrogate};
use std::time::{Duration, Instant};

/// Time after which a measurement is not repeated, and most repetitions; the shortest counts.
const ENOUGH: (Duration, usize) = (Duration::from_millis(100), 20);
/// Further runs of an FMU, whose time is that of a run: the first one also loads it.
const RUNS: usize = 3;
/// Seconds of a run of an FMU that is not repeated.
const LONG: f64 = 2.0;

/// Measures both; none of recorded runs, whose source cannot be run, or where a run fails.
///
/// # Errors
/// Those of an FMU that cannot be loaded, [`Error::Interrupted`](crate::Error::Interrupted).
pub(super) fn measure(project: &Project, surrogate: &Surrogate, test: &Dataset) -> Result<Option<Speed>> {
    let Source::Simulation(simulation) = &project.source else { return Ok(None) };
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
    let points: Vec<Vec<f64>> = simulation.plan(&project.study).test.into_iter().take(1 + RUNS).collect();
    let Some((first, others)) = points.split_first() else { return Ok(None) };
    let Some(fmu) = simulation.fmu() else {
        let mut fails = false;
        let seconds = shortest(|| fails |= simulation.run(first).is_err());
        return Ok((!fails).then_some(seconds));
    };
    let time = |points: &[Vec<f64>]| -> Result<(f64, bool)> {
        let began = Instant::now();
        let outcomes = fmu.run_all(points, None, project.workers(), &|_, _| Ok(()), || ())?;
        Ok((began.elapsed().as_secs_f64(), outcomes.iter().any(|outcome| outcome.is_err())))
    };
    // as many processes as threads
    let Ok(alone) = rayon::ThreadPoolBuilder::new().num_threads(1).build() else { return Ok(None) };
    let (once, fails) = alone.install(|| time(&points[..1]))?;
    if fails || others.is_empty() {
        return Ok(None);
    }
    // beside so long a run loading takes no time
    if once > LONG {
        return Ok(Some(once));
    }
    let (all, fails) = alone.install(|| time(&points))?;
    if fails {
        return Ok(None);
    }
    Ok(Some((all - once) / others.len() as f64).filter(|seconds| *seconds > 0.0))
}
