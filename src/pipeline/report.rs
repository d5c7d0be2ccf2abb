//! The report: the surrogate and the truth on one page.

use super::{
    compare::seconds_per_row,
    element, evaluate,
    project::{Project, SamplesRecord},
    record::{MethodRecord, TrainingRecord},
    unseen,
};
use crate::{
    Error, Result,
    diagnostics::numbers::counted,
    evaluation::OutsideRows,
    files,
    report::{Beside, Evaluated, Material, page},
    sampling::Plan,
    source::Source,
    study::{Method, Study, TimeStructure},
    training::read_history,
};
use metafmu_runtime::Surrogate;
use serde::Serialize;
use std::{
    collections::HashSet,
    path::{Path, PathBuf},
};

/// A report that was written.
#[derive(Debug, Serialize)]
pub struct WrittenReport {
    /// The page.
    pub report: PathBuf,
    /// Its size.
    pub bytes: usize,
    /// Number of figures on it.
    pub figures: usize,
}

/// Another study whose surrogate is shown with the project's, and its folder of results unless that is the default one.
#[derive(Clone, Copy, Debug)]
pub struct BesideStudy<'a> {
    /// Its file.
    pub study: &'a Path,
    /// Its folder of results.
    pub folder: Option<&'a Path>,
}

/// Writes `report.html` of the project's surrogate and test runs, and on request its plots.
///
/// # Errors
/// [`Error::Stale`] if something is missing or does not belong together, [`Error::Io`].
pub fn report(project: &Project, beside: Option<BesideStudy>, plots: Option<&Path>) -> Result<WrittenReport> {
    let (surrogate, training) = (project.load_model()?, project.load_training_record()?);
    if project.study.is_static() {
        return of_rows(project, &surrogate, &training, beside, plots);
    }
    if beside.is_some() && project.study.is_compliant() {
        let message = "compliant elements are measured on rows: the report shows one study, without --beside";
        return Err(project.study.refusal("structure", message));
    }
    let other = beside.map(|beside| Other::load(project, beside)).transpose()?;
    let (test, samples) = (project.load_table("test")?, project.load_samples_record()?);
    project.prepare_folder()?;
    plots.map_or(Ok(()), files::writable_folder)?;
    let test = element::test_data(&project.study, &test);
    let mut evaluated = element::evaluated(project, &surrogate, &test);
    evaluate::add_residual(project, &surrogate, &test, &mut evaluated.accuracy)?;
    if let Some(measured) = project.load_accuracy(&surrogate)? {
        evaluated.accuracy.outside = measured.outside;
        evaluated.accuracy.source_equations = measured.source_equations;
    }
    stage(project, &evaluated, &samples, &training, other.as_ref(), plots)
}

/// [`report`] of a static map.
fn of_rows(
    project: &Project,
    surrogate: &Surrogate,
    training: &TrainingRecord,
    beside: Option<BesideStudy>,
    plots: Option<&Path>,
) -> Result<WrittenReport> {
    if beside.is_some() {
        let message = "each static map is measured on other rows: the report shows one study, without --beside";
        return Err(project.study.refusal("structure", message));
    }
    let unseen = unseen::load(project, training)?;
    project.prepare_folder()?;
    plots.map_or(Ok(()), files::writable_folder)?;
    let samples = unseen::samples(project, training);
    stage(project, &unseen.evaluated(surrogate), &samples, training, None, plots)
}

/// Writes `report.html`, and on request its plots.
pub(super) fn stage(
    project: &Project,
    evaluated: &Evaluated,
    samples: &SamplesRecord,
    training: &TrainingRecord,
    other: Option<&Other>,
    plots: Option<&Path>,
) -> Result<WrittenReport> {
    let history = if project.history().exists() { read_history(&project.history())? } else { Vec::new() };
    let beside = other.map(|other| Evaluated::new(&other.surrogate, evaluated.test));
    let beside = other.zip(beside.as_ref()).map(|(other, beside)| other.beside(project, evaluated, beside, training));
    let comparison = project.load_comparison(&evaluated.accuracy)?;
    let validation = project.load_validation(evaluated.surrogate);
    let verdict = project.judge(evaluated.surrogate, training, &evaluated.accuracy, comparison.as_ref(), validation);
    let points = project.source.points(&project.study);
    let mut facts = facts(project, samples, training);
    let cost = project.load_cost(evaluated.surrogate).unwrap_or_default();
    let outside = evaluated.accuracy.outside.as_ref().map(OutsideRows::describe);
    facts.extend(outside.map(|text| ("Outside the domain".into(), text)));
    facts.extend(
        cost.speed.map(|speed| ("Speed on one core".into(), format!("{}; {}", speed.describe(), speed.conditions()))),
    );
    let worst = evaluated.runs_by_error().last().map(|&run| &evaluated.test.runs[run]);
    let material = Material {
        study: &project.study,
        evaluated,
        verdict: &verdict,
        points: &points,
        mechanism: worst.and_then(|run| project.source.moving_mechanism(run)),
        step_seconds: cost.seconds_per_step,
        speed_up: cost.speed.map(|speed| speed.speed_up),
        history: &history,
        facts: &facts,
        comparison: comparison.as_ref(),
        beside,
    };
    let (page, figures) = page(&material)?;
    files::write_whole(&project.report(), page.as_bytes())?;
    if let Some(folder) = plots {
        for figure in &figures {
            files::write_whole(&folder.join(format!("{}.svg", figure.id)), figure.svg.as_bytes())?;
        }
    }
    Ok(WrittenReport { report: project.report(), bytes: page.len(), figures: figures.len() })
}

/// Origin of the data and the network.
fn facts(project: &Project, samples: &SamplesRecord, training: &TrainingRecord) -> Vec<(String, String)> {
    let study = &project.study;
    let source = match (&study.source.system, study.mechanism()) {
        (Some(system), _) => format!("built-in system {system}"),
        (None, Some(_)) => "mechanism".into(),
        (None, None) if study.source.fmu.is_some() => "FMU".into(),
        (None, None) if study.source.command.is_some() => "program".into(),
        (None, None) if study.is_static() => "table of rows".into(),
        (None, None) => "recorded runs".into(),
    };
    let method = match study.sampling.method {
        Some(Method::Mesh) => "mesh",
        Some(Method::Random) => "random",
        Some(Method::LatinHypercube) => "latin hypercube",
        Some(Method::Sobol) => "Sobol sequence",
        Some(Method::Halton) => "Halton sequence",
        Some(Method::List) => "list of points",
        None if study.has_states() && !study.source.is_recorded() => "random starts, parameters and inputs",
        None if !study.source.is_recorded() => "random parameters and inputs",
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
        method: by_method,
        ..
    } = training;
    let held_out = counted(*validation_runs, "run");
    let trained_on = match by_method {
        None => format!(
            "{rows} rows, {held_out} held out, {epochs} of {all} epochs ({stopped}), the best is {best_epoch}",
            all = study.training.epochs
        ),
        Some(MethodRecord::Motion(_)) => format!("{rows} configurations, "),
        Some(MethodRecord::StateSpace(_)) => format!("{rows} states, "),
        Some(MethodRecord::Trajectories(_)) => format!("{rows} rows, "),
        Some(MethodRecord::Discrete(_)) => format!("{rows} samples, {held_out} held out, "),
        Some(MethodRecord::StaticMap(_)) => format!("{rows} rows, "),
        Some(MethodRecord::Compliant(_)) => format!("{rows} rows, {held_out} held out, "),
    };
    let how = trained_on + &by_method.as_ref().map_or(String::new(), MethodRecord::describe).replace('\n', "; ");
    let added =
        if *added_runs > 0 { format!("; {added_runs} more were added to meet the target") } else { String::new() };
    if study.is_static() {
        return [
            ("Source", source),
            ("Rows of the table", train_rows.to_string()),
            ("Unseen rows", test_rows.to_string()),
            ("Fit", how),
            ("Fit took", format!("{train_seconds:.1} s")),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .into();
    }
    [
        ("Source", source),
        ("Sampling of the training runs", method.to_owned()),
        ("Training runs", format!("{train_runs}, {}{added}", counted(*train_rows, "row"))),
        ("Test runs", format!("{test_runs}, {}", counted(*test_rows, "row"))),
        ("Sampling took", format!("{sample_seconds:.2} s")),
        ("Training", how),
        ("Training took", format!("{train_seconds:.1} s")),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

/// Another study of the same source and its surrogate.
pub struct Other<'p> {
    project: Project<'p>,
    surrogate: Surrogate,
    training: TrainingRecord,
}

impl<'p> Other<'p> {
    /// Loads the surrogate and checks that it can be compared with the project's. Variables must be equal, and no test
    /// run of the project may be among its training runs.
    fn load(project: &Project<'p>, BesideStudy { study, folder }: BesideStudy) -> Result<Self> {
        let other = Project::open(study, folder, project.control())?;
        let refuse = |message: String| Error::Stale { path: study.to_owned(), message };
        for (what, own, others) in [
            ("parameters", project.source.parameters(), other.source.parameters()),
            ("outputs", project.source.outputs(), other.source.outputs()),
        ] {
            let list = |variables: &[crate::variable::SourceVariable]| {
                let names: Vec<String> = variables.iter().map(|v| format!("{} [{}]", v.name, v.unit)).collect();
                names.join(", ")
            };
            let (own, others) = (list(own), list(others));
            if own != others {
                return Err(refuse(format!(
                    "has the {what} {others}, expected those of {}: {own}",
                    project.study.name
                )));
            }
        }
        if other.study.sampling_digest() != project.study.sampling_digest() {
            let (Source::Simulation(_), Source::Simulation(_)) = (&project.source, &other.source) else {
                return Err(refuse("has other recorded runs or another choice of test runs".into()));
            };
            let bits = |point: &[f64]| point.iter().map(|value| value.to_bits()).collect::<Vec<u64>>();
            let Plan { train, calibration, .. } = Plan::new(&other.study);
            let seen: HashSet<Vec<u64>> = train.iter().chain(&calibration).map(bits).collect();
            let known = Plan::new(&project.study).test.iter().filter(|point| seen.contains(&bits(point))).count();
            if known > 0 {
                return Err(refuse(format!("was trained on {known} of the test runs of {}", project.study.name)));
            }
        }
        Ok(Self { surrogate: other.load_model()?, training: other.load_training_record()?, project: other })
    }

    fn beside<'a>(
        &self,
        project: &Project,
        own: &'a Evaluated<'a>,
        other: &'a Evaluated<'a>,
        training: &TrainingRecord,
    ) -> Beside<'a> {
        let kilobytes = |project: &Project| {
            std::fs::metadata(project.model()).map_or("-".into(), |file| format!("{:.0} kB", file.len() as f64 / 1e3))
        };
        let costs = [
            ("training rows", [&self.training, training].map(|training| training.train_rows.to_string())),
            ("training", [&self.training, training].map(|training| format!("{:.1} s", training.train_seconds))),
            ("model file", [kilobytes(&self.project), kilobytes(project)]),
            (
                "prediction of a row, one core",
                [other, own].map(|evaluated| {
                    let seconds = seconds_per_row(evaluated.surrogate, evaluated.test);
                    seconds.map_or("-".into(), |seconds| format!("{:.2} µs", 1e6 * seconds))
                }),
            ),
        ];
        let (own_study, other_study) = (&project.study, &self.project.study);
        let fixed = |study: &Study| study.network.structure == TimeStructure::Fixed;
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
        // S_fixed is on the left
        if mixed && fixed(own_study) {
            names.reverse();
            evaluated.reverse();
            costs.iter_mut().for_each(|(_, values)| values.reverse());
        }
        Beside { names, evaluated, costs: costs.into() }
    }
}
