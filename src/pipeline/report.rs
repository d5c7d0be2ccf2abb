//! The report: the surrogate and the truth on one page.

use super::{compare::seconds_per_row, evaluate};
use crate::{
    Error, Result,
    evaluation::OutsideRows,
    files,
    kinds::{self, Fact, record::TrainingRecord},
    project::{Project, SamplesRecord},
    report::{Beside, Evaluated, Material, page},
    sampling::Plan,
    source::Source,
    study::{Study, TimeStructure},
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
    let kind = kinds::of(&project.study);
    if let (Some(_), Some(message)) = (beside, kind.no_other_beside()) {
        return Err(project.study.refusal("structure", message));
    }
    let other = beside.map(|beside| Other::load(project, beside)).transpose()?;
    let unseen = kind.load_unseen(project, &training)?;
    project.prepare_folder()?;
    plots.map_or(Ok(()), files::writable_folder)?;
    let mut evaluated = unseen.test.evaluated(&surrogate);
    evaluate::add_residual(project, &surrogate, &unseen.test.runs, &mut evaluated.accuracy)?;
    if let Some(measured) = project.load_accuracy(&surrogate)? {
        evaluated.accuracy.outside = measured.outside;
        evaluated.accuracy.source_equations = measured.source_equations;
    }
    stage(project, &evaluated, &unseen.record, &training, other.as_ref(), plots)
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
    let kind = kinds::of(&project.study);
    let facts = kind.facts(project, samples, training);
    let mut facts: Vec<(String, String)> = facts.into_iter().map(|Fact { name, value }| (name.into(), value)).collect();
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
        no_speed: kind.no_speed(&project.study).unwrap_or("its source could not be timed"),
        subject: kind.subject(),
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
