//! The whole way from a study to validated FMUs.

use super::{
    compare,
    cost::Cost,
    evaluate::{self, JudgedAccuracy, Metrics},
    export::{self, ExportPlan, WrittenFmu},
    report, rounds,
    sample::{self, Samples},
    stages::{BuildStage, Stages},
    training,
};
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::interruption::Interruption,
    evaluation::{
        AcceptanceCheck, Reason, Verdict,
        comparison::{Comparison, ModelStatus},
    },
    export::validate_apart,
    fmi::Report,
    kinds::{self, ResultFile, learning::Learning, record::TrainingRecord, unseen::UnseenData},
    project::{Project, SamplesRecord},
    report::Evaluated,
};
use metafmu_runtime::Surrogate;

/// Result of a build; the files are in the project's folder.
#[derive(Debug)]
pub struct Built {
    /// Content of `metrics.json`.
    pub metrics: Metrics,
    /// Verdict on the surrogate, with the reasons if it is not good enough.
    pub verdict: Verdict,
    /// The network beside the baselines that the study wants in a build.
    pub comparison: Option<Comparison>,
    /// The FMUs, each with what its validation found.
    pub fmus: Vec<(WrittenFmu, Report)>,
    /// State of the build if Ctrl-C shortened its training or comparison.
    pub interruption: Option<Interruption>,
}

impl Built {
    /// Paths of the results, the FMU first.
    pub fn files(&self, project: &Project) -> Vec<ResultFile> {
        let kind = kinds::of(&project.study);
        let fmus = self.fmus.iter().map(|(WrittenFmu { fmu, bytes, version }, _)| {
            ResultFile::new(fmu.clone(), format!("FMI {version} {}, {} kB", kind.interfaces(), bytes.div_ceil(1000)))
        });
        let model = format!("{}, variables: opens with safetensors in Python", kind.model_content());
        let others = [
            ResultFile::new(project.model(), model),
            ResultFile::new(project.report(), "surrogate beside truth: opens in a browser"),
            ResultFile::new(project.metrics(), kind.metrics_content()),
        ];
        fmus.chain(others).chain(kind.files(project, &self.metrics.training)).collect()
    }
}

/// Samples, trains, compares, evaluates, exports, validates and reports. To `resume` is to keep the completed stages of
/// a stopped build of the same study.
///
/// # Errors
/// Those of the stages; [`Error::Unfinished`] at Ctrl-C. A poor surrogate and the problems of an FMU are none: the verdict of
/// [`Built`] contains them.
pub fn build(project: &Project, plan: &ExportPlan, resume: bool) -> Result<Built> {
    let mut stages = Stages::new(project, plan);
    project.describe_mechanism();
    project.prepare_folder()?;
    let built = run(project, plan, resume, &mut stages);
    built.map_err(|error| match error {
        Error::Interrupted => Error::Unfinished { interruption: stages.interruption() },
        error => error,
    })
}

/// The stages of a build.
fn run(project: &Project, plan: &ExportPlan, resume: bool, stages: &mut Stages) -> Result<Built> {
    let LearnedWithData { surrogate, training, train_runs, calibration, unseen } = learn(project, resume, stages)?;
    let mut evaluated = unseen.test.evaluated(&surrogate);
    evaluate::complete(project, &surrogate, &training, (&unseen, calibration.as_ref()), &mut evaluated.accuracy)?;
    stages.stage = BuildStage::Comparison;
    let comparison = match &train_runs {
        Some(train) => compare_in_build(project, &evaluated, &training, train)?,
        // its models were compared while it was learned
        None => project.load_comparison(&evaluated.accuracy)?,
    };
    stages.stage = BuildStage::Measurement;
    let cost = evaluate::measure_cost(project, &surrogate, &unseen.test.runs)?;
    finish(project, plan, (&evaluated, cost), comparison, (&unseen.record, &training), stages)
}

/// A surrogate that was learned, and its data.
struct LearnedWithData {
    surrogate: Surrogate,
    training: TrainingRecord,
    /// The runs that it was learned from; none if it was learned from rows.
    train_runs: Option<Dataset>,
    /// Runs that error bounds are measured on.
    calibration: Option<Dataset>,
    unseen: UnseenData,
}

/// Samples the source and learns the surrogate.
fn learn(project: &Project, resume: bool, stages: &mut Stages) -> Result<LearnedWithData> {
    let kind = kinds::of(&project.study);
    if let Learning::FromRows(fit) = kind.learning(&project.study) {
        let (surrogate, training) = training::from_rows(project, fit, resume)?;
        let unseen = kind.load_unseen(project, &training)?;
        return Ok(LearnedWithData { surrogate, training, train_runs: None, calibration: None, unseen });
    }
    let kept = if resume { sample::kept(project)? } else { None };
    let Samples { sets, record } = kept.map_or_else(|| sample::stage(project), Ok)?;
    stages.stage = BuildStage::Training;
    let (surrogate, training) = rounds::stage(project, &sets.train, &sets.calibration, resume)?;
    let test = kind.unseen_runs(&project.study, sets.test);
    let (train_runs, calibration) = (Some(sets.train), Some(sets.calibration));
    Ok(LearnedWithData { surrogate, training, train_runs, calibration, unseen: UnseenData { test, record } })
}

/// Writes and validates the results of a surrogate and its accuracy.
fn finish(
    project: &Project,
    plan: &ExportPlan,
    (evaluated, cost): (&Evaluated, Cost),
    comparison: Option<Comparison>,
    (samples, training): (&SamplesRecord, &TrainingRecord),
    stages: &mut Stages,
) -> Result<Built> {
    let surrogate = evaluated.surrogate;
    stages.stage = BuildStage::Export;
    let figures = export::figures(evaluated)?;
    let judge = |validation: Vec<Reason>| {
        let accuracy = evaluated.accuracy.clone();
        JudgedAccuracy::new(project, surrogate, accuracy, comparison.as_ref(), training, validation)
    };
    let mut judged = judge(Vec::new());
    let mut written = export::stage(project, plan, surrogate, Some(&judged.accuracy), &figures)?;
    stages.stage = BuildStage::Validation;
    let reports = written.iter().map(|written| validate(project, written)).collect::<Result<Vec<Report>>>()?;
    let problems: Vec<Reason> =
        written.iter().zip(&reports).filter_map(|(written, report)| problem_of(written, report)).collect();
    if !problems.is_empty() {
        judged = judge(problems);
        // nothing but the model card changes, which has the verdict
        written = export::stage(project, plan, surrogate, Some(&judged.accuracy), &figures)?;
    }
    stages.stage = BuildStage::Report;
    let (metrics, verdict) = evaluate::stage(project, surrogate, (judged, cost), samples, training)?;
    report::stage(project, evaluated, samples, training, None, None)?;
    let interruption = shortened(training, comparison.as_ref());
    Ok(Built { metrics, verdict, comparison, fmus: written.into_iter().zip(reports).collect(), interruption })
}

fn validate(project: &Project, written: &WrittenFmu) -> Result<Report> {
    let report = validate_apart(&written.fmu, project.watch())?;
    project.say(format_args!("validated {}: {}", written.fmu.display(), report.to_string().trim_end()));
    Ok(report)
}

/// Problems that the validation of an FMU found, as a reason of the verdict.
fn problem_of(written: &WrittenFmu, report: &Report) -> Option<Reason> {
    let first = report.problems.first()?;
    let count = match report.problems.len() {
        1 => "1 problem: ".to_owned(),
        count => format!("{count} problems, the first: "),
    };
    let file = written.fmu.file_name().unwrap_or_default().to_string_lossy();
    let cause = format!("the validation found {count}{first}; `metafmu validate` lists all");
    Some(Reason::new(AcceptanceCheck::Validation, &file, cause))
}

/// State of a build whose training or comparison was shortened by Ctrl-C.
fn shortened(training: &TrainingRecord, comparison: Option<&Comparison>) -> Option<Interruption> {
    let of = |stage: BuildStage, done: String, missing: String| Interruption {
        during: stage.work().into(),
        done: vec![done],
        missing: vec![missing],
    };
    let stopped = |comparison: &Comparison| -> Option<Vec<String>> {
        let stopped = comparison.models.iter().filter(|row| row.status == ModelStatus::Stopped);
        Some(stopped.map(|row| row.model.clone()).collect()).filter(|models: &Vec<String>| !models.is_empty())
    };
    if training.was_interrupted() {
        let epoch = match training.best_epoch {
            0 => "all files, of the best surrogate so far".into(),
            epoch => format!("all files, of the best surrogate so far (epoch {epoch})"),
        };
        return Some(of(BuildStage::Training, epoch, "the rest of the training".into()));
    }
    let models = comparison.and_then(stopped)?.join(", ");
    Some(of(BuildStage::Comparison, "all files".into(), format!("models of the comparison ({models})")))
}

/// The network beside the baselines that the study wants in a build.
fn compare_in_build(
    project: &Project,
    evaluated: &Evaluated,
    training: &TrainingRecord,
    train: &Dataset,
) -> Result<Option<Comparison>> {
    let wanted = &project.study.baselines.build;
    if wanted.is_empty() || kinds::of(&project.study).no_baselines().is_some() {
        return Ok(None);
    }
    let network = compare::network_row(evaluated.surrogate, &evaluated.accuracy, training, evaluated.test);
    compare::stage(project, wanted, network, train, evaluated.test).map(Some)
}
