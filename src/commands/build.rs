//! `metafmu build`: the whole way from a study to a validated FMU.

use super::{
    Outcome, compare, evaluate,
    export::{self, Plan, Written},
    heard, interrupt,
    job::Job,
    print, print_json, report, sample, say,
    train::{self, TrainingRecord},
};
use crate::cli::BuildArgs;
use metafmu::{
    Result,
    baseline::Comparison,
    dataset::Dataset,
    evaluation::Accuracy,
    fmu::{Watch, validate_apart},
    report::Evaluated,
    sampling::Sets,
};
use metafmu_runtime::Surrogate;
use std::path::PathBuf;

pub fn run(args: &BuildArgs) -> Result<Outcome> {
    let job = Job::new(&args.export.study)?;
    let plan = Plan::new(&job, &args.export)?;
    job.describe_mechanism();
    job.prepare_folder()?;
    let kept = if args.resume { sample::kept(&job)? } else { None };
    let samples = kept.map_or_else(|| sample::stage(&job), Ok)?;
    let (surrogate, training) = train::stage(&job, &samples.sets.train, &samples.sets.calibration, args.resume)?;
    let evaluated = Evaluated::new(&surrogate, &samples.sets.test);
    let accuracy = evaluated.accuracy.clone();
    let comparison = compare_in_build(&job, &surrogate, &accuracy, &training, &samples.sets)?;
    let (metrics, verdict) =
        evaluate::stage(&job, &surrogate, accuracy, comparison.as_ref(), &samples.record, &training)?;
    let figures = export::figures(&evaluated)?;
    let written = export::stage(&job, &plan, &surrogate, Some(&metrics.accuracy), &figures)?;
    let mut problems = 0;
    for Written { fmu, .. } in &written {
        let report = validate_apart(fmu, Watch { limit: None, stop: interrupt::flag(), heard })?;
        problems += report.problems.len();
        say(format_args!("validated {}: {}", fmu.display(), report.to_string().trim_end()));
    }
    report::stage(&job, &evaluated, &samples.record, &training, None, None)?;
    if job.json {
        print_json(&metrics)?;
    } else {
        print(&format!("\n{}\n", evaluate::table(&job, &metrics)))?;
        comparison.map_or(Ok(()), |comparison| print(&format!("{}\n", comparison.table())))?;
        print(&files(&job, &written))?;
    }
    let outcome = train::conclude(&job, &verdict)?;
    Ok(match problems {
        _ if train::was_interrupted(&training) => Outcome::Interrupted,
        0 => outcome,
        _ => Outcome::ProblemsFound,
    })
}

/// The network beside the baselines that the study wants in a build.
fn compare_in_build(
    job: &Job,
    surrogate: &Surrogate,
    accuracy: &Accuracy,
    training: &TrainingRecord,
    sets: &Sets<Dataset>,
) -> Result<Option<Comparison>> {
    let kinds = &job.study.baselines.build;
    if kinds.is_empty() {
        return Ok(None);
    }
    let network = compare::network_row(surrogate, accuracy, training, &sets.test);
    compare::stage(job, kinds, network, &sets.train, &sets.test).map(Some)
}

/// Where the results are, the FMU first.
fn files(job: &Job, written: &[Written]) -> String {
    let fmu = |Written { fmu, bytes, version }: &Written| {
        let what = format!("FMI {version} co-simulation and model exchange, {} kB", bytes.div_ceil(1000));
        (fmu.clone(), what)
    };
    let others = [
        (job.model(), "network, scaling, variables: opens with safetensors in Python".into()),
        (job.report(), "surrogate beside truth: opens in a browser".into()),
        (job.metrics(), "accuracy on the test runs".into()),
        (job.comparison(), "the network beside simpler models".into()),
        (job.history(), "loss of each epoch".into()),
        (job.table("train"), "training and validation runs".into()),
        (job.table("test"), "test runs".into()),
    ];
    let calibration = job.study.bounds.map(|_| (job.table("calibration"), "runs for the error bounds".into()));
    let rows: Vec<(PathBuf, String)> = written.iter().map(fmu).chain(others).chain(calibration).collect();
    let width = rows.iter().map(|(path, _)| path.display().to_string().len()).max().unwrap_or(0);
    rows.iter().map(|(path, what)| format!("{:<width$}  {what}\n", path.display().to_string())).collect()
}
