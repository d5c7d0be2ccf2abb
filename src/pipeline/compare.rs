//! The network beside simpler models.

use crate::{
    Error, Result,
    baselines::{
        self, BaselineKind, StandardizedRows, choose_rows,
        worker::{self, BaselineFit, FitResult, FitTask},
    },
    dataset::{Dataset, Run},
    evaluation::{
        self, Accuracy, OutputMetrics,
        comparison::{Comparison, ModelRow, ModelStatus, NETWORK},
    },
    files,
    kinds::{self, prepare::baseline_rows, record::TrainingRecord},
    layout::RowLayout,
    project::{CountedWork, Event, Project},
    study::Study,
};
use metafmu_runtime::{Evaluator, Surrogate};
use std::{
    io::{BufWriter, Read},
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    sync::atomic::Ordering,
    time::{Duration, Instant},
};

/// Argument by which `metafmu` becomes a process that fits one baseline: it calls [`work`].
pub const FIT_BASELINE: &str = "fit-baseline";

/// Approximate number of test rows on which a slow baseline is measured: R² changes little with more, and the slowest
/// take 0.1 ms for each.
const TEST_ROWS: usize = 10_000;

/// Largest number of runs over which the prediction of a row is timed.
const TIMED_RUNS: usize = 50;

/// The network and the baselines `kinds`; without a network its row has the reason.
///
/// # Errors
/// [`Error::Study`] of another structure than "response", [`Error::Io`]; a model that fails has a row that says so.
pub fn compare(project: &Project, kinds: &[BaselineKind], train: &Dataset, test: &Dataset) -> Result<Comparison> {
    refuse_others(project)?;
    let network = project.load_model().and_then(|surrogate| Ok((surrogate, project.load_training_record()?)));
    let network = match &network {
        Ok((surrogate, training)) => network_row(surrogate, &Accuracy::of(surrogate, test), training, test),
        Err(error) => {
            ComparedNetwork { content_digest: None, row: row(NETWORK, ModelStatus::Failed, error.to_string()) }
        }
    };
    stage(project, kinds, network, train, test)
}

/// Baselines belong to the structure "response".
///
/// # Errors
/// [`Error::Study`] of another structure.
pub fn refuse_others(project: &Project) -> Result<()> {
    kinds::of(&project.study).no_baselines().map_or(Ok(()), |message| Err(project.study.refusal("structure", message)))
}

/// Does the task on stdin and writes its answer to stdout: what a process with the argument [`FIT_BASELINE`] does.
///
/// # Errors
/// [`Error::Io`] of the streams.
pub fn work() -> Result<()> {
    let served = worker::serve(std::io::stdin().lock(), std::io::stdout().lock());
    served.map_err(Error::io(Path::new("stdin"), "do the task from"))
}

/// The network of a comparison.
pub(super) struct ComparedNetwork {
    content_digest: Option<String>,
    row: ModelRow,
}

/// Fits the baselines one after the other and writes the tables. A Ctrl-C leaves out those that are not done, and is used up.
pub(super) fn stage(
    project: &Project,
    kinds: &[BaselineKind],
    network: ComparedNetwork,
    train: &Dataset,
    test: &Dataset,
) -> Result<Comparison> {
    let rows = baseline_rows(&project.study, train);
    let (thinned, stride) = thinned(test);
    project.begin(CountedWork::Models, kinds.len());
    let mut models = vec![network.row];
    for &kind in kinds {
        project.event(Event::Progress { done: models.len() - 1, about: format_args!("{}", kind.name()) });
        let is_thinned = stride > 1 && is_slow(kind);
        let mut row = measure(project, &project.study, kind, &rows, if is_thinned { &thinned } else { test })?;
        if is_thinned && row.status == ModelStatus::Fine {
            let measured = format!("measured on {} of {} test rows", thinned.row_count(), test.row_count());
            row.note = [row.note, measured].into_iter().filter(|note| !note.is_empty()).collect::<Vec<_>>().join("; ");
        }
        project.note(row.summary());
        models.push(row);
    }
    project.event(Event::End);
    // what follows is quick and needs none of the models
    project.control().stop.store(false, Ordering::Relaxed);
    let (name, content_digest) = (project.study.name.clone(), network.content_digest);
    let comparison =
        Comparison { name, content_digest, test_runs: test.runs.len(), test_rows: test.row_count(), models };
    files::write_json(&project.comparison(), &comparison)?;
    files::write_whole(&project.comparison_table(), comparison.csv().as_bytes())?;
    Ok(comparison)
}

/// Returns true if a prediction takes much longer than one of the network.
fn is_slow(kind: BaselineKind) -> bool {
    use BaselineKind::{ExtraTrees, GaussianProcess, GradientBoosting, Knn, RandomForest, Svr};
    matches!(kind, Svr | Knn | RandomForest | ExtraTrees | GradientBoosting | GaussianProcess)
}

/// Rows of all runs at a constant distance, which is 1 if there are few rows. It does not divide the length of a run,
/// so that all times occur.
fn thinned(test: &Dataset) -> (Dataset, usize) {
    let length = test.runs.first().map_or(1, |run| run.times.len()).max(1);
    let is_coprime =
        |stride: &usize| (2..=*stride).all(|factor| !stride.is_multiple_of(factor) || !length.is_multiple_of(factor));
    let stride = (test.row_count().div_ceil(TEST_ROWS).max(1)..).find(is_coprime).unwrap_or(1);
    let width = test.outputs.len();
    let mut before = 0;
    let thin = |run: &Run| {
        let first = (stride - before % stride) % stride;
        before += run.times.len();
        let places = || (first..run.times.len()).step_by(stride);
        let of =
            |values: &[f64], width: usize| places().flat_map(|row| values[row * width..][..width].to_vec()).collect();
        Run {
            times: places().map(|row| run.times[row]).collect::<Vec<f64>>().into(),
            outputs: of(&run.outputs, width),
            inputs: of(&run.inputs, test.inputs.len()),
            parameters: run.parameters.clone(),
        }
    };
    let runs = test.runs.iter().map(thin).filter(|run| !run.times.is_empty()).collect();
    (
        Dataset {
            runs,
            inputs: test.inputs.clone(),
            parameters: test.parameters.clone(),
            outputs: test.outputs.clone(),
        },
        stride,
    )
}

/// The network's row.
pub(super) fn network_row(
    surrogate: &Surrogate,
    accuracy: &Accuracy,
    training: &TrainingRecord,
    test: &Dataset,
) -> ComparedNetwork {
    let row = ModelRow {
        rows: training.train_rows,
        fit_seconds: training.processor_seconds,
        predict_seconds_per_point: seconds_per_row(surrogate, test),
        memory_bytes: surrogate.to_bytes().ok().map(|bytes| bytes.len() as u64),
        exportable: true,
        outputs: accuracy.outputs.iter().map(|(name, metrics)| (name.clone(), metrics.into())).collect(),
        ..row(NETWORK, ModelStatus::Fine, String::new())
    };
    ComparedNetwork { content_digest: Some(surrogate.metadata().provenance.content_digest.clone()), row }
}

/// Seconds of the prediction of a row on one core: the median over some runs; none if there is no run.
pub(super) fn seconds_per_row(surrogate: &Surrogate, test: &Dataset) -> Option<f64> {
    let evaluator = Evaluator::new(surrogate);
    let time = |run: &Run| {
        let began = Instant::now();
        std::hint::black_box(evaluation::predict(surrogate, &evaluator, run));
        began.elapsed().as_secs_f64() / run.times.len() as f64
    };
    let mut times: Vec<f64> = test.runs.iter().take(TIMED_RUNS).map(time).collect();
    times.sort_by(f64::total_cmp);
    times.get(times.len() / 2).copied()
}

fn row(model: &str, status: ModelStatus, note: String) -> ModelRow {
    ModelRow {
        model: model.into(),
        status,
        note,
        rows: 0,
        fit_seconds: None,
        predict_seconds_per_point: None,
        memory_bytes: None,
        exportable: false,
        outputs: [].into(),
    }
}

/// Fits a baseline of the study and measures it on some runs.
pub(super) fn measure(
    project: &Project,
    study: &Study,
    kind: BaselineKind,
    rows: &StandardizedRows,
    test: &Dataset,
) -> Result<ModelRow> {
    let name = kind.name();
    if project.is_stopped() {
        return Ok(row(name, ModelStatus::Stopped, "by Ctrl-C".into()));
    }
    let all = rows.len();
    let rows = choose_rows(rows, baselines::model(&study.baselines, kind).most_rows(), study.seed).into_owned();
    let layout = RowLayout::new(study.encoder());
    let mut points = Vec::new();
    for run in &test.runs {
        layout.for_each(run, |columns, _| points.extend_from_slice(columns));
    }
    let options = study.baselines.clone();
    let count = rows.len();
    let task = FitTask { kind, options, seed: study.seed, rows, test: points };
    Ok(match fit(project, &task)? {
        Ended::Answered(FitResult { result: Ok(fit), predictions }) => {
            let metrics = evaluation::compare(test, &by_run(test, &predictions), None);
            fitted_row(kind, &fit, count, all, test, &metrics)
        }
        Ended::Answered(FitResult { result: Err(error), .. }) => row(name, ModelStatus::Failed, error.message),
        Ended::TooSlow => {
            let note = format!("not done after {} s with {count} of {all} rows", study.baselines.time_budget);
            row(name, ModelStatus::TooSlow, note)
        }
        Ended::Stopped => row(name, ModelStatus::Stopped, "by Ctrl-C".into()),
        Ended::Died(status) => row(name, ModelStatus::Failed, format!("its process ended with {status}")),
    })
}

fn fitted_row(
    kind: BaselineKind,
    fit: &BaselineFit,
    count: usize,
    all: usize,
    test: &Dataset,
    metrics: &[OutputMetrics],
) -> ModelRow {
    let some = (count < all).then(|| format!("on {count} of {all} rows"));
    let not_exportable = fit.not_exportable.as_ref().map(|reason| format!("cannot be exported: {reason}"));
    let names = test.outputs.iter().map(|output| output.name.clone());
    ModelRow {
        rows: count,
        fit_seconds: Some(fit.fit_seconds),
        predict_seconds_per_point: Some(fit.predict_seconds_per_point),
        memory_bytes: Some(fit.memory_bytes),
        exportable: fit.not_exportable.is_none(),
        outputs: names.zip(metrics.iter().map(Into::into)).collect(),
        ..row(kind.name(), ModelStatus::Fine, some.into_iter().chain(not_exportable).collect::<Vec<_>>().join("; "))
    }
}

/// The predictions of each run.
fn by_run(test: &Dataset, predictions: &[f64]) -> Vec<Vec<f64>> {
    let mut left = predictions;
    let mut take = |count: usize| {
        let (these, others) = left.split_at(count);
        left = others;
        these.to_vec()
    };
    test.runs.iter().map(|run| take(run.outputs.len())).collect()
}

/// End of a worker.
enum Ended {
    Answered(FitResult),
    TooSlow,
    Stopped,
    Died(ExitStatus),
}

/// Executes a task in a separate process. The process ends after the time budget, or at a Ctrl-C.
fn fit(project: &Project, task: &FitTask) -> Result<Ended> {
    let program = project.control().program;
    let failed = |source| Error::io(program, "run")(source);
    let mut command = Command::new(program);
    command.arg(FIT_BASELINE).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().map_err(failed)?;
    let (to, from) = (child.stdin.take(), child.stdout.take());
    std::thread::scope(|scope| {
        // a worker that ended early does not read: its exit status says why
        scope.spawn(|| to.map(|to| task.write(BufWriter::with_capacity(1 << 16, to))));
        let answer = scope.spawn(|| {
            let mut bytes = Vec::new();
            from.map(|mut from| from.read_to_end(&mut bytes));
            bytes
        });
        let status = wait(project, &mut child).map_err(failed)?;
        let bytes = answer.join().unwrap_or_default();
        Ok(match status {
            None => Ended::Stopped,
            Some(status) if status.code() == Some(worker::TOO_SLOW) => Ended::TooSlow,
            Some(status) if !status.success() && project.is_stopped() => Ended::Stopped,
            Some(status) => FitResult::read(&bytes).map_or(Ended::Died(status), Ended::Answered),
        })
    })
}

/// Waits for a process; ends it and returns nothing at a Ctrl-C.
fn wait(project: &Project, child: &mut Child) -> std::io::Result<Option<ExitStatus>> {
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Some(status));
        }
        if project.is_stopped() {
            child.kill()?;
            child.wait()?;
            return Ok(None);
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variable::SourceVariable;

    #[test]
    fn baselines_are_measured_on_rows_of_all_runs_and_times() {
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let of = |runs: usize, length: usize| {
            let run = |run: usize| Run {
                inputs: Vec::new(),
                parameters: vec![run as f64],
                times: (0..length).map(|row| row as f64).collect::<Vec<f64>>().into(),
                outputs: (0..length).flat_map(|row| [run as f64, row as f64]).collect(),
            };
            let (runs, outputs) = ((0..runs).map(run).collect(), vec![variable("run"), variable("row")]);
            Dataset { inputs: Vec::new(), parameters: vec![variable("p")], outputs, runs }
        };
        assert_eq!(thinned(&of(20, 500)), (of(20, 500), 1));
        for (runs, length) in [(200, 500), (30_000, 2), (100, 1100)] {
            let (found, stride) = thinned(&of(runs, length));
            let rows = runs * length;
            assert!(stride > 1 && found.row_count() == rows.div_ceil(stride) && found.row_count() <= TEST_ROWS);
            let mut times = vec![false; length];
            for run in &found.runs {
                for (row, time) in run.times.iter().enumerate() {
                    assert_eq!(run.outputs[2 * row..][..2], [run.parameters[0], *time]);
                    times[*time as usize] = true;
                }
            }
            assert!(times.iter().all(|time| *time), "{runs} {length}");
        }
    }
}
