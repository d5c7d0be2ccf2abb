//! `metafmu report`: the surrogate beside the truth, on one page for people.

use super::{
    Outcome,
    job::{Job, SamplesRecord},
    print, print_json,
    train::TrainingRecord,
};
use crate::cli::{ReportArgs, StudyArgs};
use metafmu::{
    Error, Result, files,
    report::{Beside, Epoch, Evaluated, Material, page},
    sampling::Plan,
    source::Source,
    study::{Method, Structure, Study},
};
use metafmu_runtime::Surrogate;
use serde::Serialize;
use std::{
    collections::HashSet,
    path::{Path, PathBuf},
    time::Instant,
};

/// What was written.
#[derive(Debug, Serialize)]
pub struct Written {
    pub report: PathBuf,
    pub bytes: usize,
    pub figures: usize,
}

pub fn run(args: &ReportArgs) -> Result<Outcome> {
    let job = Job::new(&args.study)?;
    let (surrogate, training) = (job.load_model()?, job.load_training_record()?);
    let other = args.beside.as_ref().map(|study| Other::load(&job, study, args.beside_out.as_deref())).transpose()?;
    let (test, samples) = (job.load_table("test")?, job.load_samples_record()?);
    job.prepare_folder()?;
    if let Some(plots) = &args.plots {
        files::writable_folder(plots)?;
    }
    let evaluated = Evaluated::new(&surrogate, &test);
    let written = stage(&job, &evaluated, &samples, &training, other.as_ref(), args.plots.as_deref())?;
    if job.json {
        print_json(&written)?;
    } else {
        print(&format!("{}\n", written.report.display()))?;
    }
    Ok(Outcome::Fine)
}

/// Writes `report.html`, and on request its plots.
pub fn stage(
    job: &Job,
    evaluated: &Evaluated,
    samples: &SamplesRecord,
    training: &TrainingRecord,
    other: Option<&Other>,
    plots: Option<&Path>,
) -> Result<Written> {
    let history = if job.history().exists() { Epoch::read_csv(&job.history())? } else { Vec::new() };
    let beside = other.map(|other| Evaluated::new(&other.surrogate, evaluated.test));
    let beside = other.zip(beside.as_ref()).map(|(other, beside)| other.beside(job, evaluated, beside, training));
    let comparison = job.load_comparison(&evaluated.accuracy)?;
    let verdict = job.judge(evaluated.surrogate, training, &evaluated.accuracy, comparison.as_ref());
    let points = job.source.points(&job.study);
    let facts = facts(job, samples, training);
    let material = Material {
        study: &job.study,
        evaluated,
        verdict: &verdict,
        points: &points,
        history: &history,
        facts: &facts,
        comparison: comparison.as_ref(),
        beside,
    };
    let (page, figures) = page(&material)?;
    files::write_whole(&job.report(), page.as_bytes())?;
    if let Some(folder) = plots {
        for figure in &figures {
            files::write_whole(&folder.join(format!("{}.svg", figure.id)), figure.svg.as_bytes())?;
        }
    }
    Ok(Written { report: job.report(), bytes: page.len(), figures: figures.len() })
}

/// How data and network were made.
fn facts(job: &Job, samples: &SamplesRecord, training: &TrainingRecord) -> Vec<(String, String)> {
    let study = &job.study;
    let source = match (&study.source.system, study.mechanism()) {
        (Some(system), _) => format!("built-in system {system}"),
        (None, Some(_)) => "mechanism".into(),
        (None, None) => "recorded runs".into(),
    };
    let method = match study.sampling.method {
        Some(Method::Mesh) => "mesh",
        Some(Method::Random) => "random",
        Some(Method::LatinHypercube) => "latin hypercube",
        Some(Method::Sobol) => "Sobol sequence",
        Some(Method::Halton) => "Halton sequence",
        Some(Method::List) => "list of points",
        None => "as recorded",
    };
    let SamplesRecord { train_runs, train_rows, test_runs, test_rows, sample_seconds, .. } = samples;
    let TrainingRecord {
        train_rows: rows,
        validation_runs,
        epochs,
        best_epoch,
        stopped,
        train_seconds,
        added_runs,
        ..
    } = training;
    let added =
        if *added_runs > 0 { format!("; {added_runs} more were added to meet the target") } else { String::new() };
    [
        ("Source", source),
        ("Sampling of the training runs", method.to_owned()),
        ("Training runs", format!("{train_runs}, {train_rows} rows{added}")),
        ("Test runs", format!("{test_runs}, {test_rows} rows")),
        ("Sampling took", format!("{sample_seconds:.2} s")),
        (
            "Training",
            format!(
                "{rows} rows, {validation_runs} runs held out, {epochs} epochs ({stopped}), the best is {best_epoch}"
            ),
        ),
        ("Training took", format!("{train_seconds:.1} s")),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

/// Another study of the same source and its surrogate.
pub struct Other {
    job: Job,
    surrogate: Surrogate,
    training: TrainingRecord,
}

impl Other {
    /// Loads the surrogate and makes sure that it can be compared with the job's: same variables, and none of the job's test
    /// runs were among its training runs.
    fn load(job: &Job, study: &Path, out: Option<&Path>) -> Result<Self> {
        let args = StudyArgs { study: study.to_owned(), out: out.map(Path::to_owned), json: false };
        let other = Job::new(&args)?;
        let refuse = |message: String| Error::Stale { path: study.to_owned(), message };
        for (what, own, others) in [
            ("parameters", job.source.parameters(), other.source.parameters()),
            ("outputs", job.source.outputs(), other.source.outputs()),
        ] {
            let list = |variables: &[metafmu::variable::Variable]| {
                let names: Vec<String> = variables.iter().map(|v| format!("{} [{}]", v.name, v.unit)).collect();
                names.join(", ")
            };
            let (own, others) = (list(own), list(others));
            if own != others {
                return Err(refuse(format!("has the {what} {others}, expected those of {}: {own}", job.study.name)));
            }
        }
        if other.study.sampling_digest() != job.study.sampling_digest() {
            let (Source::Simulation(_), Source::Simulation(_)) = (&job.source, &other.source) else {
                return Err(refuse("has other recorded runs or another choice of test runs".into()));
            };
            let bits = |point: &Vec<f64>| point.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
            let Plan { train, calibration, .. } = Plan::new(&other.study);
            let seen: HashSet<Vec<u64>> = train.iter().chain(&calibration).map(bits).collect();
            let known = Plan::new(&job.study).test.iter().filter(|point| seen.contains(&bits(point))).count();
            if known > 0 {
                return Err(refuse(format!("was trained on {known} of the test runs of {}", job.study.name)));
            }
        }
        Ok(Self { surrogate: other.load_model()?, training: other.load_training_record()?, job: other })
    }

    fn beside<'a>(
        &self,
        job: &Job,
        own: &'a Evaluated<'a>,
        other: &'a Evaluated<'a>,
        training: &TrainingRecord,
    ) -> Beside<'a> {
        let kilobytes = |job: &Job| {
            std::fs::metadata(job.model()).map_or("-".into(), |file| format!("{:.0} kB", file.len() as f64 / 1e3))
        };
        let costs = [
            ("training rows", [&self.training, training].map(|training| training.train_rows.to_string())),
            ("training", [&self.training, training].map(|training| format!("{:.1} s", training.train_seconds))),
            ("model file", [kilobytes(&self.job), kilobytes(job)]),
            (
                "prediction of a row, one core",
                [other, own].map(|evaluated| format!("{:.2} µs", 1e6 * seconds_per_row(evaluated))),
            ),
        ];
        let (own_study, other_study) = (&job.study, &self.job.study);
        let fixed = |study: &Study| study.network.structure == Structure::Fixed;
        let mixed = fixed(own_study) != fixed(other_study);
        let name = |study: &Study| match (mixed, fixed(study)) {
            (false, _) => study.name.clone(),
            (true, true) => format!("S_fixed ({})", study.name),
            (true, false) => format!("S_full ({})", study.name),
        };
        let mut names = [name(other_study), name(own_study)];
        if names[0] == names[1] {
            names[0] += " (other)";
        }
        let mut evaluated = [other, own];
        let mut costs = costs.map(|(name, values)| (name.to_owned(), values));
        // S_fixed stands on the left
        if mixed && fixed(own_study) {
            names.reverse();
            evaluated.reverse();
            costs.iter_mut().for_each(|(_, values)| values.reverse());
        }
        Beside { names, evaluated, costs: costs.into() }
    }
}

/// Median over some runs.
fn seconds_per_row(evaluated: &Evaluated) -> f64 {
    let evaluator = metafmu_runtime::Evaluator::new(evaluated.surrogate);
    let time = |run: &metafmu::dataset::Run| {
        let begin = Instant::now();
        let predictions = metafmu::evaluation::predict(evaluated.surrogate, &evaluator, run);
        std::hint::black_box(predictions);
        begin.elapsed().as_secs_f64() / run.times.len() as f64
    };
    let mut times: Vec<f64> = evaluated.test.runs.iter().take(50).map(time).collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}
