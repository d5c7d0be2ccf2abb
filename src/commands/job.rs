//! What the verbs on a study share: the study, its source, and where results go.

use super::{say, train::TrainingRecord};
use crate::cli::StudyArgs;
use indexmap::IndexMap;
use metafmu::{
    Error, Result,
    acceptance::{self, Verdict},
    baseline::{Comparison, Kind, comparison::NETWORK},
    dataset::Dataset,
    evaluation::Accuracy,
    files,
    multibody::Mechanism,
    sampling::Sets,
    scaling,
    source::{Source, shard::Shard},
    study::Study,
    surrogate,
};
use metafmu_runtime::Surrogate;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A study with its source resolved and its folder of results.
pub struct Job {
    pub study: Study,
    pub source: Source,
    folder: PathBuf,
    pub json: bool,
}

/// Of which study the tables are, and what making them took: `samples.json`.
#[derive(Debug, Serialize, Deserialize)]
pub struct SamplesRecord {
    /// [`Study::sampling_digest`] of the study they were sampled from.
    pub sampling_digest: String,
    pub train_runs: usize,
    pub train_rows: usize,
    pub test_runs: usize,
    pub test_rows: usize,
    /// Runs that error bounds are measured on.
    #[serde(default)]
    pub calibration_runs: usize,
    /// SHA-256 of each table, by its set.
    #[serde(default)]
    pub tables: IndexMap<String, String>,
    pub sample_seconds: f64,
    /// Runs of the plan that failed and are not in the tables.
    #[serde(default)]
    pub failed_runs: usize,
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
    pub parameters: IndexMap<String, f64>,
    pub reason: String,
}

/// Says on stderr what a mechanism consists of and what is odd about it.
pub fn describe(mechanism: &Mechanism) {
    for warning in mechanism.warnings() {
        say(format!("warning: {warning}"));
    }
    say(mechanism.summary());
}

impl Job {
    /// Reads the study and finds its folder; writes nothing.
    pub fn new(args: &StudyArgs) -> Result<Self> {
        let study = Study::load(&args.study)?;
        let source = Source::new(&study)?;
        let folder = args.out.clone().unwrap_or_else(|| Path::new("out").join(&study.name));
        Ok(Self { study, source, folder, json: args.json })
    }

    /// Says on stderr what the study's mechanism consists of and what is odd about it.
    pub fn describe_mechanism(&self) {
        if let Some(mechanism) = self.study.mechanism() {
            describe(mechanism);
        }
    }

    /// Makes the folder of results, so that one that cannot be written is found before the work and not after it.
    pub fn prepare_folder(&self) -> Result<()> {
        files::writable_folder(&self.folder)
    }

    /// Table of a set of runs: `train.csv`, `test.csv` or `calibration.csv`.
    pub fn table(&self, set: &str) -> PathBuf {
        self.folder.join(format!("{set}.csv"))
    }

    pub fn samples_record(&self) -> PathBuf {
        self.folder.join("samples.json")
    }

    /// Runs of a sampling that is not finished.
    pub fn journal(&self) -> PathBuf {
        self.folder.join("unfinished-runs.bin")
    }

    /// The same of one shard of it.
    pub fn shard_journal(&self, Shard { number, of }: Shard) -> PathBuf {
        self.folder.join(format!("unfinished-runs-{number}-of-{of}.bin"))
    }

    /// Where results go.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    pub fn model(&self) -> PathBuf {
        self.folder.join(format!("{}.safetensors", self.study.name))
    }

    /// Where the trials of a search keep what they have.
    pub fn search_folder(&self) -> PathBuf {
        self.folder.join("search")
    }

    pub fn search_table(&self) -> PathBuf {
        self.folder.join("search.csv")
    }

    pub fn best_study(&self) -> PathBuf {
        self.folder.join(format!("{}-best.toml", self.study.name))
    }

    pub fn history(&self) -> PathBuf {
        self.folder.join("history.csv")
    }

    /// Where a training that is under way, or was stopped, goes on from.
    pub fn checkpoint(&self) -> PathBuf {
        self.folder.join("checkpoint.safetensors")
    }

    /// Networks of a training that is under way or was stopped, where there is one for each instant.
    pub fn unfinished_networks(&self) -> PathBuf {
        self.folder.join("unfinished-networks.bin")
    }

    /// Where the rounds of a training with a target keep what they have.
    pub fn rounds(&self) -> PathBuf {
        self.folder.join("rounds")
    }

    /// The same job, with the folder of a round for its results.
    pub fn round(&self, number: usize) -> Self {
        self.with_folder(self.rounds().join(number.to_string()))
    }

    /// The same job, with another folder for its results.
    pub fn with_folder(&self, folder: PathBuf) -> Self {
        Self { study: self.study.clone(), source: self.source.clone(), folder, json: self.json }
    }

    pub fn training_record(&self) -> PathBuf {
        self.folder.join("training.json")
    }

    pub fn metrics(&self) -> PathBuf {
        self.folder.join("metrics.json")
    }

    pub fn baseline_model(&self, kind: Kind) -> PathBuf {
        self.folder.join(format!("{}-{}.safetensors", self.study.name, kind.name()))
    }

    pub fn comparison(&self) -> PathBuf {
        self.folder.join("comparison.json")
    }

    pub fn comparison_table(&self) -> PathBuf {
        self.folder.join("comparison.csv")
    }

    pub fn report(&self) -> PathBuf {
        self.folder.join("report.html")
    }

    pub fn fmu(&self, suffix: &str) -> PathBuf {
        self.folder.join(format!("{}{suffix}.fmu", self.study.name))
    }

    /// Reads the record of the sampled tables and checks that they are this study's.
    pub fn load_samples_record(&self) -> Result<SamplesRecord> {
        let path = self.samples_record();
        let record: SamplesRecord = self.load_json(&path, "metafmu sample")?;
        if record.sampling_digest != self.study.sampling_digest() {
            let message = "the tables beside it were sampled from another study: run `metafmu sample` again".into();
            return Err(Error::Stale { path, message });
        }
        Ok(record)
    }

    /// Reads how the training went.
    pub fn load_training_record(&self) -> Result<TrainingRecord> {
        self.load_json(&self.training_record(), "metafmu train")
    }

    /// Reads the accuracy of a surrogate from `metrics.json`; none if that has not been measured.
    pub fn load_accuracy(&self, surrogate: &Surrogate) -> Result<Option<Accuracy>> {
        let path = self.metrics();
        if !path.exists() {
            return Ok(None);
        }
        let accuracy: Accuracy = self.load_json(&path, "metafmu evaluate")?;
        let digest = &surrogate.metadata().provenance.content_digest;
        // measured on an earlier network
        Ok(Some(accuracy).filter(|accuracy| accuracy.content_digest == *digest))
    }

    /// What is to be thought of a surrogate with this accuracy on the test runs.
    pub fn judge(
        &self,
        surrogate: &Surrogate,
        training: &TrainingRecord,
        accuracy: &Accuracy,
        comparison: Option<&Comparison>,
    ) -> Verdict {
        let of_outputs = acceptance::problems(&self.study, surrogate, accuracy, comparison, "test runs");
        Verdict::of([training.problems(&self.study), of_outputs].concat())
    }

    /// Reads the comparison with other models; none if there is none of these test runs.
    pub fn load_comparison(&self, measured: &Accuracy) -> Result<Option<Comparison>> {
        let path = self.comparison();
        if !path.exists() {
            return Ok(None);
        }
        let comparison: Comparison = self.load_json(&path, "metafmu compare")?;
        let network = comparison.models.iter().find(|row| row.model == NETWORK);
        // made with an earlier network
        let same = network.is_some_and(|row| {
            row.outputs.len() == measured.outputs.len()
                && measured.outputs.iter().all(|(name, metrics)| {
                    row.outputs.get(name).is_some_and(|found| (found.mse - metrics.mse).abs() <= 1e-6 * metrics.mse)
                })
        });
        if !same {
            say(format_args!("{} is of another network: it is left out", path.display()));
        }
        Ok(Some(comparison).filter(|_| same))
    }

    fn load_json<T: DeserializeOwned>(&self, path: &Path, verb: &str) -> Result<T> {
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

    pub fn load_tables(&self) -> Result<Sets<Dataset>> {
        let set = |set| self.load_table(set);
        Ok(Sets { train: set("train")?, test: set("test")?, calibration: set("calibration")? })
    }

    /// Reads a table of runs of this study; a set without runs has none.
    pub fn load_table(&self, set: &str) -> Result<Dataset> {
        let record = self.load_samples_record()?;
        let (parameters, outputs) = (self.source.parameters(), self.source.outputs());
        if set == "calibration" && self.study.bounds.is_none() {
            return Ok(Dataset { parameters: parameters.into(), outputs: outputs.into(), runs: Vec::new() });
        }
        let digest = record.tables.get(set).ok_or_else(|| {
            let message = format!("has no digest of {set}.csv: run `metafmu sample` again");
            Error::Stale { path: self.samples_record(), message }
        })?;
        let dataset = Dataset::read_csv(&self.table(set), digest, parameters, outputs)?;
        self.study.refuse(scaling::problems(&dataset))?;
        Ok(dataset)
    }

    /// Reads the trained surrogate and checks that it is this study's.
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
