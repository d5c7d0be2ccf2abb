//! The whole way from a study to validated FMUs.

use super::{
    compare, element, evaluate,
    evaluate::{JudgedAccuracy, Metrics},
    export::{self, ExportPlan, WrittenFmu},
    project::{Project, SamplesRecord},
    record::{Cost, TrainingRecord},
    report, rounds, sample,
    stages::{BuildStage, Stages},
    static_map, unseen,
};
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::interruption::Interruption,
    evaluation::{
        AcceptanceCheck, Accuracy, Reason, Verdict,
        comparison::{Comparison, ModelStatus},
    },
    export::validate_apart,
    fmi::Report,
    report::Evaluated,
    sampling::Sets,
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
    let built = match project.study.is_static() {
        true => build_of_rows(project, plan, resume, &mut stages),
        false => build_of_runs(project, plan, resume, &mut stages),
    };
    built.map_err(|error| match error {
        Error::Interrupted => Error::Unfinished { interruption: stages.interruption() },
        error => error,
    })
}

/// [`build`] of a surrogate of runs.
fn build_of_runs(project: &Project, plan: &ExportPlan, resume: bool, stages: &mut Stages) -> Result<Built> {
    let kept = if resume { sample::kept(project)? } else { None };
    let samples = kept.map_or_else(|| sample::stage(project), Ok)?;
    stages.stage = BuildStage::Training;
    let (surrogate, training) = rounds::stage(project, &samples.sets.train, &samples.sets.calibration, resume)?;
    let test = element::test_data(&project.study, &samples.sets.test);
    let mut evaluated = element::evaluated(project, &surrogate, &test);
    evaluate::add_residual(project, &surrogate, &samples.sets.test, &mut evaluated.accuracy)?;
    evaluate::add_calibration(project, &surrogate, &samples.sets.calibration, &mut evaluated.accuracy);
    evaluate::add_dead_points(project, &mut evaluated.accuracy)?;
    evaluate::add_source_equations(project, &surrogate, &samples.sets.test, &training, &mut evaluated.accuracy)?;
    let accuracy = evaluated.accuracy.clone();
    stages.stage = BuildStage::Comparison;
    let comparison = compare_in_build(project, &surrogate, &accuracy, &training, &samples.sets)?;
    stages.stage = BuildStage::Measurement;
    let cost = evaluate::measure_cost(project, &surrogate, &samples.sets.test)?;
    finish(project, plan, (&evaluated, cost), comparison, (&samples.record, &training), stages)
}

/// [`build`] of a static map: its samples are the rows of its table.
fn build_of_rows(project: &Project, plan: &ExportPlan, resume: bool, stages: &mut Stages) -> Result<Built> {
    let (surrogate, training) = static_map::stage(project, resume)?;
    stages.stage = BuildStage::Measurement;
    let unseen = unseen::load(project, &training)?;
    let evaluated = unseen.evaluated(&surrogate);
    let comparison = project.load_comparison(&evaluated.accuracy)?;
    let cost = evaluate::measure_cost(project, &surrogate, &unseen.test)?;
    finish(project, plan, (&evaluated, cost), comparison, (&unseen::samples(project, &training), &training), stages)
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
    surrogate: &Surrogate,
    accuracy: &Accuracy,
    training: &TrainingRecord,
    sets: &Sets<Dataset>,
) -> Result<Option<Comparison>> {
    let kinds = &project.study.baselines.build;
    // baselines are functions of parameters and time
    if kinds.is_empty() || project.study.has_memory() || project.study.is_compliant() {
        return Ok(None);
    }
    let network = compare::network_row(surrogate, accuracy, training, &sets.test);
    compare::stage(project, kinds, network, &sets.train, &sets.test).map(Some)
}
