//! Speed of a surrogate and of its source: seconds of one core for a simulated second.

use super::cost::{Cost, Speed};
use crate::{
    Result,
    dataset::{Dataset, Run},
    evaluation::{first_predicted, predict, predict_all},
    fmi::Workers,
    kinds,
    project::Project,
    source::{Simulation, Source, setting::SourceSetting, timed::TimedRuns},
    worst::worst,
};
use metafmu_runtime::{Evaluator, Rows, Surrogate};
use std::time::{Duration, Instant};

/// Time after which a measurement is not repeated.
const ENOUGH: Duration = Duration::from_millis(300);
/// Most repetitions; the shortest counts.
const REPETITIONS: usize = 20;
/// Runs in which a surrogate and its source are compared.
const RUNS: usize = 4;
/// Wall time of a source's runs after which no further one is begun.
const LONG: Duration = Duration::from_secs(2);
/// Rows of a run that ends after its first step.
const FIRST_STEP: usize = 2;
/// Part of a source's wall time below which what follows the first step is lost in noise.
const LEAST_PART: f64 = 0.05;

/// Rows of which a step's cost is measured, if the test runs have as many.
const ROWS: usize = 1000;

/// Measures the cost of a step, and the speed beside the source's.
///
/// # Errors
/// As [`measure`].
pub(super) fn cost(project: &Project, surrogate: &Surrogate, test: &Dataset) -> Result<Cost> {
    Ok(Cost { seconds_per_step: seconds_per_step(surrogate, test), speed: measure(project, surrogate)? })
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
    let mut shortest = f64::INFINITY;
    let mut repetition = Repetition::begin();
    while repetition.next() {
        let begin = Instant::now();
        for run in &runs {
            std::hint::black_box(predict(surrogate, &evaluator, run));
        }
        shortest = shortest.min(begin.elapsed().as_secs_f64());
    }
    (rows > 0).then(|| shortest / rows as f64)
}

/// Repetitions of a measurement: at least one, and no more once there are enough.
struct Repetition {
    began: Instant,
    count: usize,
}

impl Repetition {
    fn begin() -> Self {
        Self { began: Instant::now(), count: 0 }
    }

    /// Returns true if the measurement is to be made once more.
    fn next(&mut self) -> bool {
        let is_enough = self.count >= REPETITIONS || self.count > 0 && self.began.elapsed() > ENOUGH;
        self.count += 1;
        !is_enough
    }
}

/// Measures both; none of recorded runs, whose source cannot be run, or where a run fails.
///
/// # Errors
/// Those of an FMU or a program that cannot be started, [`Error::Interrupted`](crate::Error::Interrupted).
fn measure(project: &Project, surrogate: &Surrogate) -> Result<Option<Speed>> {
    let Source::Simulation(simulation) = &project.source else { return Ok(None) };
    if kinds::of(&project.study).no_speed(&project.study).is_some() {
        return Ok(None);
    }
    let simulation = simulation.with_rows(project.study.time.grid().len());
    let points = simulation.plan(&project.study).test;
    let Some(truth) = TrueRuns::make(&simulation, &points, project.workers())? else { return Ok(None) };
    let speed = truth.compare(surrogate, project.study.source.runs_once())?;
    Ok(speed.filter(|speed| speed.speed_up.is_finite() && speed.speed_up > 0.0))
}

/// Test runs of a source with the setting of the study, which are the truth.
struct TrueRuns<'a> {
    simulation: &'a Simulation,
    workers: Workers<'a>,
    points: Rows,
    runs: Dataset,
}

impl<'a> TrueRuns<'a> {
    /// Makes the first runs of a plan; none if one fails, or there is none.
    fn make(simulation: &'a Simulation, points: &Rows, workers: Workers<'a>) -> Result<Option<Self>> {
        let (mut source, began) = (TimedRuns::new(simulation, workers)?, Instant::now());
        let mut runs = Vec::new();
        for point in points.iter().take(RUNS) {
            let Some(run) = source.run(point)? else { return Ok(None) };
            runs.push(Ok(simulation.run_of(point, run.outputs)));
            if began.elapsed() > LONG {
                break;
            }
        }
        let points = points.part(0..runs.len());
        let is_empty = runs.is_empty();
        let truth = Self { simulation, workers, points, runs: simulation.dataset(runs) };
        Ok((!is_empty).then_some(truth))
    }

    /// Speed of the surrogate and of the source at the loosest setting whose error is no larger than the surrogate's. None if a run fails, or
    /// hardly takes longer than its first step, or the surrogate diverges. `starts_each_run`: of a program that is started for each run, the
    /// start is a part of the run.
    fn compare(&self, surrogate: &Surrogate, starts_each_run: bool) -> Result<Option<Speed>> {
        let predictions = predict_all(surrogate, &self.runs);
        let given = self.runs.runs.iter().map(|run| first_predicted(surrogate, run)).max().unwrap_or(0);
        let surrogate_error = relative_error(&self.runs, &predictions, given);
        // nothing is as wrong as a surrogate that diverges
        if !surrogate_error.is_finite() {
            return Ok(None);
        }
        let source = self.loosest(surrogate_error)?;
        let Some(seconds) = self.alternate(&source.simulation, surrogate)? else { return Ok(None) };
        let times = &self.runs.runs[0].times;
        let (steps, length) = ((times.len() - 1) as f64, times[times.len() - 1] - times[0]);
        let simulated = self.points.len() as f64 * length;
        let of_source = if starts_each_run {
            seconds.source / simulated
        } else {
            let Some(after_first_step) = seconds.after_first_step() else { return Ok(None) };
            after_first_step / (simulated * (steps - 1.0) / steps)
        };
        let of_surrogate = seconds.surrogate / simulated;
        Ok(Some(Speed {
            source: of_source,
            surrogate: of_surrogate,
            speed_up: of_source / of_surrogate,
            output_step: length / steps,
            runs: self.points.len(),
            setting: source.setting,
            source_error: source.error,
            surrogate_error,
        }))
    }

    /// The source with the loosest setting whose relative error is no larger than a given one.
    fn loosest(&self, error: f64) -> Result<AccurateSource> {
        let mut settings = self.simulation.settings();
        let setting = settings.pop().unwrap_or(SourceSetting::Fixed);
        let mut loosest = AccurateSource { simulation: self.simulation.clone(), setting, error: 0.0 };
        // from the tightest on, as errors grow with them
        while let Some(setting) = settings.pop() {
            let simulation = self.simulation.with_setting(setting);
            match self.error_of(&simulation)? {
                Some(of_source) if of_source <= error => {
                    loosest = AccurateSource { simulation, setting, error: of_source };
                }
                _ => break,
            }
        }
        Ok(loosest)
    }

    /// Relative error of the source at another setting; none if a run fails.
    fn error_of(&self, simulation: &Simulation) -> Result<Option<f64>> {
        let mut source = TimedRuns::new(simulation, self.workers)?;
        let mut outputs = Vec::new();
        for point in &self.points {
            let Some(run) = source.run(point)? else { return Ok(None) };
            outputs.push(run.outputs);
        }
        Ok(Some(relative_error(&self.runs, &outputs, 0)))
    }

    /// Shortest wall times of the source, of its first step and of the surrogate, alternately; none if a run fails.
    fn alternate(&self, simulation: &Simulation, surrogate: &Surrogate) -> Result<Option<Seconds>> {
        let evaluator = Evaluator::new(surrogate);
        let first_step = simulation.with_rows(FIRST_STEP);
        let mut source = TimedRuns::new(simulation, self.workers)?;
        let mut beginning = TimedRuns::new(&first_step, self.workers)?;
        let mut shortest = vec![Seconds::LONGEST; self.points.len()];
        let mut repetition = Repetition::begin();
        while repetition.next() {
            for ((point, run), shortest) in self.points.iter().zip(&self.runs.runs).zip(&mut shortest) {
                let (Some(whole), Some(first)) = (source.run(point)?, beginning.run(point)?) else { return Ok(None) };
                let begin = Instant::now();
                std::hint::black_box(predict(surrogate, &evaluator, run));
                shortest.surrogate = shortest.surrogate.min(begin.elapsed().as_secs_f64());
                shortest.source = shortest.source.min(whole.seconds);
                shortest.first_step = shortest.first_step.min(first.seconds);
            }
        }
        Ok(Some(Seconds {
            source: shortest.iter().map(|of| of.source).sum(),
            first_step: shortest.iter().map(|of| of.first_step).sum(),
            surrogate: shortest.iter().map(|of| of.surrogate).sum(),
        }))
    }
}

/// A source with its setting, and its relative error.
struct AccurateSource {
    simulation: Simulation,
    setting: SourceSetting,
    error: f64,
}

/// Wall times in seconds.
#[derive(Clone, Copy)]
struct Seconds {
    source: f64,
    first_step: f64,
    surrogate: f64,
}

impl Seconds {
    const LONGEST: Self = Self { source: f64::INFINITY, first_step: f64::INFINITY, surrogate: f64::INFINITY };

    /// Time of the source after its first step; none if that is lost in the noise of both measurements.
    fn after_first_step(self) -> Option<f64> {
        let rest = self.source - self.first_step;
        (rest > LEAST_PART * self.source).then_some(rest)
    }
}

/// Root mean square error relative to the standard deviation of the truth, of the worst output that varies, over rows
/// from `first` on. The first columns of `outputs` are those of the truth. Unlike sqrt(1 - R²) it is exact where it is small.
fn relative_error(truth: &Dataset, outputs: &[Vec<f64>], first: usize) -> f64 {
    let of_column = |column: usize| {
        let pairs = || truth.runs.iter().zip(outputs).flat_map(|(run, outputs)| pairs_of(run, outputs, column, first));
        let count = pairs().count().max(1) as f64;
        let mean = pairs().map(|[truth, _]| truth).sum::<f64>() / count;
        let variance = pairs().map(|[truth, _]| (truth - mean).powi(2)).sum::<f64>();
        let squares = pairs().map(|[truth, output]| (truth - output).powi(2)).sum::<f64>();
        if variance > 0.0 { (squares / variance).sqrt() } else { 0.0 }
    };
    worst((0..truth.outputs.len()).map(of_column))
}

/// Values of a column in a run and among outputs, row by row.
fn pairs_of<'a>(
    run: &'a Run,
    outputs: &'a [f64],
    column: usize,
    first: usize,
) -> impl Iterator<Item = [f64; 2]> + use<'a> {
    let rows = run.times.len();
    let [truth, outputs] = [&run.outputs[..], outputs].map(|values| values.chunks_exact((values.len() / rows).max(1)));
    truth.zip(outputs).skip(first).map(move |(truth, outputs)| [truth[column], outputs[column]])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{study::Study, systems::SYSTEMS};
    use std::{path::Path, sync::atomic::AtomicBool};

    #[test]
    fn the_source_is_as_loose_as_the_error_of_the_surrogate_allows() {
        let study = Study::parse(SYSTEMS[0].study, Path::new("s.toml")).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        let workers = Workers { program: Path::new("none"), stop: &AtomicBool::new(false) };
        let truth = TrueRuns::make(&simulation, &simulation.plan(&study).test, workers).unwrap().unwrap();
        assert_eq!(truth.points.len(), RUNS);
        let mut tolerances = Vec::new();
        for error in [1e-9, 1e-6, 1e-3] {
            let source = truth.loosest(error).unwrap();
            let SourceSetting::Tolerance(tolerance) = source.setting else { panic!("{:?}", source.setting) };
            assert!(0.0 < source.error && source.error <= error, "{tolerance}: {}", source.error);
            let looser = simulation.with_setting(SourceSetting::Tolerance(10.0 * tolerance));
            assert!(truth.error_of(&looser).unwrap().unwrap() > error, "{tolerance}");
            tolerances.push(tolerance);
        }
        assert!(tolerances.is_sorted_by(|a, b| a < b), "{tolerances:?}");
        // nothing looser is as accurate as the truth itself
        assert_eq!(truth.loosest(0.0).unwrap().setting, *simulation.settings().last().unwrap());
    }

    #[test]
    fn relative_errors_are_exact_where_they_are_small() {
        let study = Study::parse(SYSTEMS[0].study, Path::new("s.toml")).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        let run = simulation.run(&simulation.plan(&study).test[0]).unwrap();
        let outputs: Vec<f64> = run.outputs.iter().map(|value| value + 1e-11).collect();
        let rows = run.outputs.chunks_exact(simulation.outputs().len()).skip(1).map(|row| row[0]).collect::<Vec<_>>();
        let mean = rows.iter().sum::<f64>() / rows.len() as f64;
        let std = (rows.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / rows.len() as f64).sqrt();
        // angles vary least, so their relative error is the largest
        let found = relative_error(&simulation.dataset(vec![Ok(run)]), &[outputs], 1);
        assert!((found * std / 1e-11 - 1.0).abs() < 1e-3, "{found}");
    }

    #[test]
    fn a_source_that_hardly_takes_longer_than_its_start_has_no_speed() {
        let seconds = |source, first_step| Seconds { source, first_step, surrogate: 1e-6 };
        assert_eq!(seconds(3e-3, 2.95e-3).after_first_step(), None);
        assert_eq!(seconds(2.9e-3, 3e-3).after_first_step(), None);
        assert_eq!(seconds(4.0, 1.0).after_first_step(), Some(3.0));
    }

    #[test]
    fn a_run_of_the_first_step_begins_like_the_whole_run() {
        let study = Study::parse(SYSTEMS[0].study, Path::new("s.toml")).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        let point = &simulation.plan(&study).test[0];
        let (whole, first) = (simulation.run(point).unwrap(), simulation.with_rows(FIRST_STEP).run(point).unwrap());
        assert_eq!(first.times.len(), FIRST_STEP);
        for (first, whole) in first.outputs.iter().zip(&whole.outputs) {
            assert!((first - whole).abs() <= 1e-9 * whole.abs().max(1.0), "{first} {whole}");
        }
    }
}
