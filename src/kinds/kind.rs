//! The questions that the stages of the pipeline ask a kind of surrogate.

use super::{
    learning::Learning,
    record::TrainingRecord,
    unseen::{UnseenData, UnseenRuns},
};
use crate::{
    Result,
    dataset::Dataset,
    diagnostics::numbers::counted,
    project::{Project, SamplesRecord},
    study::{Method, Study},
    training::StopReason,
};
use std::path::PathBuf;

/// A file with results, and what is in it.
pub struct ResultFile {
    /// The file.
    pub path: PathBuf,
    /// Description of its content.
    pub content: String,
}

impl ResultFile {
    pub(crate) fn new(path: PathBuf, content: impl Into<String>) -> Self {
        Self { path, content: content.into() }
    }
}

/// A name and a value, as reports list them.
pub(crate) struct Fact {
    pub(crate) name: &'static str,
    pub(crate) value: String,
}

impl Fact {
    pub(super) fn new(name: &'static str, value: impl Into<String>) -> Self {
        Self { name, value: value.into() }
    }
}

/// A kind of surrogate. What a kind does not answer itself is true of one that is learned from runs and simulated alone.
pub trait SurrogateKind: Sync {
    /// Way in which the surrogate of a study is learned.
    fn learning(&self, study: &Study) -> Learning;

    /// Description of the content of the model file.
    fn model_content(&self) -> &'static str;

    /// Interfaces of the FMU, as people read them.
    fn interfaces(&self) -> &'static str {
        "co-simulation and model exchange"
    }

    /// Results of a build beside the model, the report and the metrics.
    fn files(&self, project: &Project, training: &TrainingRecord) -> Vec<ResultFile>;

    /// Content of the metrics, as people read it.
    fn metrics_content(&self) -> &'static str {
        "accuracy on the test runs"
    }

    /// The file beside the model that shows most about a training.
    fn training_file(&self, project: &Project) -> PathBuf {
        project.history()
    }

    /// Test runs in the form in which a surrogate is measured on them.
    fn unseen_runs(&self, _: &Study, runs: Dataset) -> UnseenRuns {
        UnseenRuns::of_runs(runs)
    }

    /// The table of the data that a surrogate is measured on.
    fn unseen_table(&self, project: &Project) -> PathBuf {
        project.table("test")
    }

    /// Reads the data that a surrogate is measured on.
    ///
    /// # Errors
    /// [`Error::Stale`](crate::Error::Stale) if they are missing or of another study, [`Error::Io`](crate::Error::Io).
    fn load_unseen(&self, project: &Project, _: &TrainingRecord) -> Result<UnseenData> {
        Ok(UnseenData {
            test: self.unseen_runs(&project.study, project.load_table("test")?),
            record: project.load_samples_record()?,
        })
    }

    /// Reads the runs that error bounds are measured on; none of a kind without runs.
    ///
    /// # Errors
    /// Those of [`load_unseen`](Self::load_unseen).
    fn load_calibration(&self, project: &Project) -> Result<Option<Dataset>> {
        project.load_table("calibration").map(Some)
    }

    /// Reason why no simpler models are compared with the surrogate; none if they are.
    fn no_baselines(&self) -> Option<&'static str> {
        Some("baselines are functions of parameters and time, expected the structure \"response\"")
    }

    /// Reason why a report does not show another study's surrogate beside this one; none if it does.
    fn no_other_beside(&self) -> Option<&'static str> {
        None
    }

    /// Reason why the surrogate is not timed beside its source; none if it is, where that is possible.
    fn no_speed(&self, study: &Study) -> Option<&'static str> {
        study.source.is_recorded().then_some("a table is no source to compare with")
    }

    /// Returns true if the surrogate has equations like those that its source may give.
    fn has_equations(&self) -> bool {
        false
    }

    /// The surrogate as the subject of a sentence; none if the program of the surrogate says it.
    fn subject(&self) -> Option<&'static str> {
        None
    }

    /// Sampling of a source that is not recorded and has no plan of parameters.
    fn usual_sampling(&self) -> &'static str {
        "random parameters and inputs"
    }

    /// Origin of the data and the surrogate, for the report.
    fn facts(&self, project: &Project, samples: &SamplesRecord, training: &TrainingRecord) -> Vec<Fact> {
        let study = &project.study;
        let SamplesRecord { train_runs, train_rows, test_runs, test_rows, sample_seconds, .. } = samples;
        let added = match training.added_runs {
            0 => String::new(),
            added => format!("; {added} more were added to meet the target"),
        };
        let sampling = match study.sampling.method {
            Some(method) => method_name(method),
            None if study.source.is_recorded() => "as recorded",
            None => self.usual_sampling(),
        };
        vec![
            Fact::new("Source", source_name(study)),
            Fact::new("Sampling of the training runs", sampling),
            Fact::new("Training runs", format!("{train_runs}, {}{added}", counted(*train_rows, "row"))),
            Fact::new("Test runs", format!("{test_runs}, {}", counted(*test_rows, "row"))),
            Fact::new("Sampling took", format!("{sample_seconds:.2} s")),
            Fact::new("Training", training.describe(study)),
            Fact::new("Training took", format!("{:.1} s", training.train_seconds)),
        ]
    }

    /// Advice that may improve a surrogate, the surest first.
    fn advice(&self, study: &Study, training: &TrainingRecord) -> Vec<String> {
        let TrainingRecord { epochs, stopped, train_rows, .. } = training;
        let longer = match stopped {
            StopReason::Interrupted => Some("continue the training that was stopped: --resume".into()),
            StopReason::Finished => Some(format!("train longer: `training.epochs` above {epochs}")),
            _ => None,
        };
        let more = match study.source.is_recorded() {
            true => format!("record more runs: these have {train_rows} training rows"),
            false => self.more_samples(study, training),
        };
        let larger = (*epochs > 0).then(|| "a larger network: `network.hidden`".into());
        longer.into_iter().chain([more]).chain(self.more_structure(study)).chain(larger).collect()
    }

    /// Advice on the sampling of a source that is not recorded.
    fn more_samples(&self, study: &Study, _: &TrainingRecord) -> String {
        let runs = study.sampling.runs.map_or(String::new(), |runs| format!(" above {runs}"));
        format!("add runs: `sampling.runs`{runs}, or a `[target]`")
    }

    /// Advice on options of the kind.
    fn more_structure(&self, _: &Study) -> Option<String> {
        None
    }
}

/// Tables of the runs that were sampled.
pub(super) fn run_tables(project: &Project) -> Vec<ResultFile> {
    let mut files = vec![
        ResultFile::new(project.table("train"), "training and validation runs"),
        ResultFile::new(project.table("test"), "test runs"),
    ];
    if project.study.bounds.is_some() {
        files.push(ResultFile::new(project.table("calibration"), "runs for the error bounds"));
    }
    files
}

/// The loss of a training.
pub(super) fn history(project: &Project) -> ResultFile {
    ResultFile::new(project.history(), "loss of each epoch")
}

fn source_name(study: &Study) -> String {
    match (&study.source.system, study.mechanism()) {
        (Some(system), _) => format!("built-in system {system}"),
        (None, Some(_)) => "mechanism".into(),
        (None, None) if study.source.fmu.is_some() => "FMU".into(),
        (None, None) if study.source.command.is_some() => "program".into(),
        (None, None) => "recorded runs".into(),
    }
}

fn method_name(method: Method) -> &'static str {
    match method {
        Method::Mesh => "mesh",
        Method::Random => "random",
        Method::LatinHypercube => "latin hypercube",
        Method::Sobol => "Sobol sequence",
        Method::Halton => "Halton sequence",
        Method::List => "list of points",
    }
}
