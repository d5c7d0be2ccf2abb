//! A study, its source, and its folder of results.

mod observer;
pub(crate) mod rescue;

use crate::{
    Error, Result,
    baselines::BaselineKind,
    dataset::Dataset,
    evaluation::{AcceptanceCheck, Accuracy, Reason, comparison::Comparison},
    files,
    fmi::{Watch, Workers},
    multibody::Mechanism,
    sampling::Sets,
    scaling, search,
    source::{self, Source, shard::Shard},
    study::Study,
    surrogate,
    table::writer::Format,
};
use indexmap::IndexMap;
use metafmu_runtime::Surrogate;
pub use observer::{Control, CountedWork, Event, PipelineObserver, Silent};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::{
    fmt::Display,
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::atomic::Ordering,
};

/// A study with its source resolved, its folder of results, and the program around it.
#[derive(Debug)]
pub struct Project<'a> {
    /// The study.
    pub study: Study,
    /// Source of its runs.
    pub source: Source,
    folder: PathBuf,
    control: Control<'a>,
}

/// Record of a sampling, `samples.json`: the study of the tables, and their cost.
#[derive(Debug, Serialize, Deserialize)]
pub struct SamplesRecord {
    /// [`Study::sampling_digest`] of the study they were sampled from.
    pub sampling_digest: String,
    /// Training and validation runs.
    pub train_runs: usize,
    /// Their rows.
    pub train_rows: usize,
    /// Test runs.
    pub test_runs: usize,
    /// Their rows.
    pub test_rows: usize,
    /// Runs that error bounds are measured on.
    #[serde(default)]
    pub calibration_runs: usize,
    /// SHA-256 of each table, by its set.
    #[serde(default)]
    pub tables: IndexMap<String, String>,
    /// Wall time of the sampling.
    pub sample_seconds: f64,
    /// Runs of the plan that failed and are not in the tables.
    #[serde(default)]
    pub failed_runs: usize,
    /// These runs.
    #[serde(default)]
    pub failed: Vec<FailedRun>,
}

/// A run that is not in the tables.
#[derive(Debug, Serialize, Deserialize)]
pub struct FailedRun {
    /// `train`, `test` or `calibration`.
    pub set: String,
    /// Its number in that part of the plan, as `sample --dry-run` prints it.
    pub run: usize,
    /// Its parameters.
    pub parameters: IndexMap<String, f64>,
    /// Reason of the failure.
    pub reason: String,
}

/// Reports the parts of a mechanism and its oddities.
pub fn describe(mechanism: &Mechanism, control: Control<'_>) {
    for warning in mechanism.warnings() {
        control.observer.event(Event::Warning(format_args!("{warning}")));
    }
    control.observer.event(Event::Message(format_args!("{}", mechanism.summary())));
}

impl<'a> Project<'a> {
    /// Reads the study file and finds its source; writes nothing. Results go to `folder`, by default to `out/NAME` with
    /// the study's name.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake in the file, the errors of the source.
    pub fn open(study: &Path, folder: Option<&Path>, control: Control<'a>) -> Result<Self> {
        let (study, source) = source::open(study)?;
        search::check(&study)?;
        let folder = folder.map_or_else(|| Path::new("out").join(&study.name), Path::to_owned);
        Ok(Self { study, source, folder, control })
    }

    /// Control by the program around it.
    pub fn control(&self) -> Control<'a> {
        self.control
    }

    /// Returns true if the work must end.
    pub(crate) fn is_stopped(&self) -> bool {
        self.control.stop.load(Ordering::Relaxed)
    }

    /// Settings of worker processes.
    pub(crate) fn workers(&self) -> Workers<'a> {
        Workers { program: self.control.program, stop: self.control.stop }
    }

    /// Watch over an FMU that runs in a separate process.
    pub(crate) fn watch(&self) -> Watch<'a> {
        Watch { workers: self.workers(), limit: None, heard: self.control.heard }
    }

    /// Reports an event to the observer.
    pub(crate) fn event(&self, event: Event<'_>) {
        self.control.observer.event(event);
    }

    /// Tells the observer a result or a decision.
    pub(crate) fn say(&self, line: impl Display) {
        self.event(Event::Message(format_args!("{line}")));
    }

    /// Reports a problem that the user should check.
    pub(crate) fn warn(&self, line: impl Display) {
        self.event(Event::Warning(format_args!("{line}")));
    }

    /// Reports the progress of the work to the observer.
    pub(crate) fn note(&self, line: impl Display) {
        self.event(Event::Note(format_args!("{line}")));
    }

    /// Tells the observer that work of `total` units begins.
    pub(crate) fn begin(&self, work: CountedWork, total: usize) {
        self.event(Event::Begin { work, total });
    }

    /// Reports the end of the work, and its result, to the observer.
    pub(crate) fn finish(&self, line: impl Display) {
        self.event(Event::End);
        self.say(line);
    }

    /// Reports the parts of the study's mechanism and its oddities.
    pub fn describe_mechanism(&self) {
        if let Some(mechanism) = self.study.mechanism() {
            describe(mechanism, self.control);
        }
    }

    /// Creates the folder of results, so that a write error is detected before the work instead of after it.
    ///
    /// # Errors
    /// [`Error::Io`] with the system's reason.
    pub fn prepare_folder(&self) -> Result<()> {
        files::writable_folder(&self.folder)
    }

    /// Table of a set of runs, `train`, `test` or `calibration`: the file that exists, `train.csv` or `train.parquet`.
    pub fn table(&self, set: &str) -> PathBuf {
        let [csv, parquet] = self.tables(set);
        if parquet.exists() && !csv.exists() { parquet } else { csv }
    }

    /// Files of the table of a set of runs: one for each format, of which at most one exists unless the user adds another.
    fn tables(&self, set: &str) -> [PathBuf; Format::ALL.len()] {
        Format::ALL.map(|format| self.table_in(set, format))
    }

    fn table_in(&self, set: &str, format: Format) -> PathBuf {
        self.folder.join(format!("{set}.{}", format.extension()))
    }

    /// Writes the table of a set of runs in the study's format, and returns the SHA-256 of its bytes. The file of another format
    /// is removed first, so that there are never two; a set without runs has neither. A record of the earlier table must be
    /// removed before.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub(crate) fn write_table(&self, set: &str, dataset: &Dataset) -> Result<Option<String>> {
        let format = self.study.sampling.tables.unwrap_or_else(|| dataset.format());
        let path = self.table_in(set, format);
        let has_runs = !dataset.runs.is_empty();
        self.tables(set)
            .iter()
            .filter(|other| !has_runs || **other != path)
            .try_for_each(|other| files::remove(other))?;
        has_runs.then(|| dataset.write(&path)).transpose()
    }

    /// `rounds.csv`
    pub(crate) fn rounds_table(&self) -> PathBuf {
        self.folder.join("rounds.csv")
    }

    pub(crate) fn samples_record(&self) -> PathBuf {
        self.folder.join("samples.json")
    }

    /// Runs of a sampling that is not finished.
    pub(crate) fn journal(&self) -> PathBuf {
        self.folder.join("unfinished-runs.bin")
    }

    /// Runs of a shard that is not finished.
    pub(crate) fn shard_journal(&self, Shard { number, of }: Shard) -> PathBuf {
        self.folder.join(format!("unfinished-runs-{number}-of-{of}.bin"))
    }

    /// Folder of the results.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Rows that a static map was measured on.
    pub fn unseen(&self) -> PathBuf {
        self.folder.join("unseen.csv")
    }

    /// The network, as it goes into the FMU.
    pub fn model(&self) -> PathBuf {
        self.folder.join(format!("{}.safetensors", self.study.name))
    }

    /// Folder of the trials of a search.
    pub(crate) fn search_folder(&self) -> PathBuf {
        self.folder.join("search")
    }

    pub(crate) fn search_table(&self) -> PathBuf {
        self.folder.join("search.csv")
    }

    pub(crate) fn best_study(&self) -> PathBuf {
        self.folder.join(format!("{}-best.toml", self.study.name))
    }

    /// Loss of each epoch.
    pub fn history(&self) -> PathBuf {
        self.folder.join("history.csv")
    }

    /// Checkpoint from which a stopped training continues.
    pub(crate) fn checkpoint(&self) -> PathBuf {
        self.folder.join("checkpoint.safetensors")
    }

    /// Checkpoint of one of several trainings, counted from 1.
    pub(crate) fn checkpoint_of(&self, number: usize) -> PathBuf {
        self.folder.join(format!("checkpoint-{number}.safetensors"))
    }

    /// Returns true if a training is under way or was stopped.
    pub(crate) fn is_unfinished(&self) -> bool {
        [self.checkpoint(), self.checkpoint_of(1), self.unfinished_networks()].iter().any(|path| path.exists())
    }

    /// Removes what a training continues from.
    pub(crate) fn remove_checkpoints(&self) -> Result<()> {
        files::remove(&self.checkpoint())?;
        let count = (1..).take_while(|number| self.checkpoint_of(*number).exists()).count();
        // the first one shows that there are others
        (1..=count).rev().try_for_each(|number| files::remove(&self.checkpoint_of(number)))?;
        files::remove(&self.unfinished_networks())
    }

    /// Networks of a training that is under way or was stopped, where there is one for each instant.
    pub(crate) fn unfinished_networks(&self) -> PathBuf {
        self.folder.join("unfinished-networks.bin")
    }

    /// Folder of the rounds of a training with a target.
    pub(crate) fn rounds(&self) -> PathBuf {
        self.folder.join("rounds")
    }

    /// This project, with the folder of a round for its results.
    pub(crate) fn round(&self, number: usize) -> Self {
        self.with_folder(self.rounds().join(number.to_string()))
    }

    /// This project, with another folder for its results.
    pub(crate) fn with_folder(&self, folder: PathBuf) -> Self {
        Self { study: self.study.clone(), source: self.source.clone(), folder, control: self.control }
    }

    pub(crate) fn training_record(&self) -> PathBuf {
        self.folder.join("training.json")
    }

    /// Accuracy on the test runs.
    pub fn metrics(&self) -> PathBuf {
        self.folder.join("metrics.json")
    }

    pub(crate) fn baseline_model(&self, kind: BaselineKind) -> PathBuf {
        self.folder.join(format!("{}-{}.safetensors", self.study.name, kind.name()))
    }

    /// The network beside simpler models.
    pub fn comparison(&self) -> PathBuf {
        self.folder.join("comparison.json")
    }

    /// The comparison as a table.
    pub fn comparison_table(&self) -> PathBuf {
        self.folder.join("comparison.csv")
    }

    /// The surrogate beside the truth, for people.
    pub fn report(&self) -> PathBuf {
        self.folder.join("report.html")
    }

    /// Reads the record of the sampled tables and checks that they are this study's.
    ///
    /// # Errors
    /// [`Error::Stale`] if it is missing or damaged, [`Error::OtherStudy`].
    pub fn load_samples_record(&self) -> Result<SamplesRecord> {
        let path = self.samples_record();
        let record: SamplesRecord = self.load_json(&path, "metafmu sample")?;
        if record.sampling_digest != self.study.sampling_digest() {
            return Err(Error::OtherStudy { path });
        }
        Ok(record)
    }

    /// Reads the accuracy of a surrogate from `metrics.json`; none if that has not been measured.
    pub(crate) fn load_accuracy(&self, surrogate: &Surrogate) -> Result<Option<Accuracy>> {
        let path = self.metrics();
        if !path.exists() {
            return Ok(None);
        }
        let accuracy: Accuracy = self.load_json(&path, "metafmu evaluate")?;
        let digest = &surrogate.metadata().provenance.content_digest;
        // measured on an earlier network
        Ok(Some(accuracy).filter(|accuracy| accuracy.content_digest == *digest))
    }

    /// Problems that the validation of the last build found in FMUs of this surrogate, from `metrics.json`.
    pub(crate) fn load_validation(&self, surrogate: &Surrogate) -> Vec<Reason> {
        // a damaged file is reported where its figures are needed
        let verdict = self.load_accuracy(surrogate).ok().flatten().and_then(|accuracy| accuracy.verdict);
        let problems = verdict.map_or(Vec::new(), |verdict| verdict.problems);
        problems.into_iter().filter(|reason| reason.check == AcceptanceCheck::Validation).collect()
    }

    /// Reads the comparison with other models; none if there is none of this network.
    pub(crate) fn load_comparison(&self, measured: &Accuracy) -> Result<Option<Comparison>> {
        let path = self.comparison();
        if !path.exists() {
            return Ok(None);
        }
        let comparison: Comparison = self.load_json(&path, "metafmu compare")?;
        let same = comparison.content_digest.as_ref() == Some(&measured.content_digest);
        if !same {
            self.say(format_args!("{} is of another network: it is left out", path.display()));
        }
        Ok(Some(comparison).filter(|_| same))
    }

    pub(crate) fn load_json<T: DeserializeOwned>(&self, path: &Path, verb: &str) -> Result<T> {
        let text = std::fs::read_to_string(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => self.missing(path, verb),
            _ => Error::io(path, "read")(source),
        })?;
        serde_json::from_str(&text).map_err(|error| {
            let place = error.line();
            let message = format!("damaged, or of another version of metafmu, in line {place}: run `{verb}` again");
            Error::Stale { path: path.to_owned(), message }
        })
    }

    /// Reads the tables of all sets.
    ///
    /// # Errors
    /// As [`Project::load_table`].
    pub fn load_tables(&self) -> Result<Sets<Dataset>> {
        let set = |set| self.load_table(set);
        Ok(Sets { train: set("train")?, test: set("test")?, calibration: set("calibration")? })
    }

    /// Reads the table of a set of runs of this study; a set without runs has none.
    ///
    /// # Errors
    /// [`Error::Stale`] if it is missing, of another study or changed, [`Error::Study`] if it cannot be scaled.
    pub fn load_table(&self, set: &str) -> Result<Dataset> {
        let record = self.load_samples_record()?;
        let columns = self.source.columns();
        if set == "calibration" && self.study.bounds.is_none() {
            return Ok(columns.without_runs());
        }
        let digest = record.tables.get(set).ok_or_else(|| {
            let message = format!("has no digest of the table `{set}`: run `metafmu sample` again");
            Error::Stale { path: self.samples_record(), message }
        })?;
        let existing: Vec<PathBuf> = self.tables(set).into_iter().filter(|path| path.exists()).collect();
        let path = match existing.as_slice() {
            [] => {
                let message = format!("the table `{set}` beside it is missing: run `metafmu sample` again");
                return Err(Error::Stale { path: self.samples_record(), message });
            }
            [path] => path,
            // the user has converted one of them
            [path, ..] => {
                existing.iter().find(|path| files::digest(path).is_ok_and(|found| found == *digest)).unwrap_or(path)
            }
        };
        let dataset = Dataset::read(path, digest, columns)?;
        self.study.refuse(scaling::problems(&dataset))?;
        Ok(dataset)
    }

    /// Reads the trained surrogate and checks that it is this study's.
    ///
    /// # Errors
    /// [`Error::Stale`] if it is missing or of another study, the errors of a damaged file.
    pub fn load_model(&self) -> Result<Surrogate> {
        let path = self.model();
        if !path.exists() {
            return Err(self.missing(&path, "metafmu train"));
        }
        let surrogate = surrogate::load(&path)?;
        if surrogate.metadata().provenance.study_digest != self.study.digest() {
            let message = "was trained from another study: run `metafmu train` again".into();
            return Err(Error::Stale { path, message });
        }
        Ok(surrogate)
    }

    fn missing(&self, path: &Path, verb: &str) -> Error {
        Error::Stale { path: path.to_owned(), message: format!("not there yet: run `{verb}` first") }
    }
}
