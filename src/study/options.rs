//! The sections of a study file as plain data.

use indexmap::IndexMap;
use metafmu_runtime::{Activation, Precision, Variability};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `[source]`: what is sampled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceOptions {
    /// Name of a built-in system.
    pub system: Option<String>,
    /// A mechanism file, relative to the study's folder. Its content counts for digests, not where it lies.
    #[serde(skip_serializing)]
    pub mechanism: Option<PathBuf>,
    /// Values of the source's quantities that are no parameters; it has a default for each.
    #[serde(default)]
    pub constants: IndexMap<String, f64>,
}

/// `[time]`: the rows of a run, `0, step, ..., stop`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeOptions {
    /// End of every run, in seconds.
    pub stop: f64,
    /// Time between two rows, in seconds; divides `stop`.
    pub step: f64,
}

impl TimeOptions {
    /// The times of a run's rows, in seconds: `count + 1` values computed as `stop * i / count`, so that none drifts.
    pub fn grid(&self) -> Vec<f64> {
        let count = (self.stop / self.step).round();
        (0..=count as u64).map(|i| self.stop * i as f64 / count).collect()
    }
}

/// An entry of `[parameters]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ParameterOptions {
    /// Lower end of the range.
    pub min: f64,
    /// Upper end of the range.
    pub max: f64,
    /// Unit; must be the source's own.
    pub unit: Option<String>,
    /// One sentence for people; the source has one.
    pub description: Option<String>,
    /// Levels of this parameter in a mesh, instead of `sampling.levels`.
    pub levels: Option<usize>,
    /// When the FMU's host may change it.
    #[serde(default)]
    pub variability: Variability,
}

/// An entry of `[outputs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputOptions {
    /// Unit; must be the source's own.
    pub unit: Option<String>,
    /// One sentence for people; the source has one.
    pub description: Option<String>,
}

/// `[sampling]`: where in the parameters' ranges runs are placed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SamplingOptions {
    /// How the training runs are placed.
    pub method: Method,
    /// Levels of each parameter in a mesh, both ends of its range included.
    pub levels: Option<usize>,
    /// Number of training runs of the methods that have no levels.
    pub runs: Option<usize>,
    /// Number of test runs: random, from the same ranges, never part of training.
    #[serde(default = "default_test_runs")]
    pub test_runs: usize,
}

fn default_test_runs() -> usize {
    200
}

/// How the training runs are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Full factorial: every combination of evenly spaced levels.
    Mesh,
    /// Independent and uniform over the ranges.
    Random,
    /// Low-discrepancy: a randomly shifted Sobol sequence, which leaves no gaps and no clusters.
    Sobol,
}

/// `[export]`: what kind of FMU is made, and what it says about itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ExportOptions {
    /// Version of the standard.
    pub fmi: FmiChoice,
    /// What the FMU computes in.
    pub precision: Precision,
    /// Author of the model.
    pub author: Option<String>,
    /// Copyright of the model.
    pub copyright: Option<String>,
    /// Licence of the model.
    pub license: Option<String>,
}

/// Version of the standard that FMUs are made for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum FmiChoice {
    /// FMI 2.0, which more hosts know.
    #[default]
    #[serde(rename = "2")]
    V2,
    /// FMI 3.0.
    #[serde(rename = "3")]
    V3,
    /// An FMU of each.
    #[serde(rename = "both")]
    Both,
}

/// `[network]`: the feed-forward network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkOptions {
    /// Number of nodes of each hidden layer.
    pub hidden: Vec<usize>,
    /// Activation of every hidden layer.
    pub activation: Activation,
}

/// `[training]`: how the network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainingOptions {
    /// Rule that turns gradients into parameter updates.
    pub optimizer: Optimizer,
    /// Learning rate at its highest.
    pub learning_rate: f64,
    /// How the learning rate changes over the training.
    pub schedule: Schedule,
    /// Rows per optimizer step.
    pub batch: usize,
    /// Passes over the training rows, at the most.
    pub epochs: usize,
    /// Share of the training runs that is held out to choose the best epoch, between 0 and 1.
    pub validation: f64,
    /// Stop after this many epochs without a better validation loss; 0: never.
    pub patience: usize,
}

/// Rule that turns gradients into parameter updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optimizer {
    /// Kingma and Ba, arXiv:1412.6980.
    Adam,
}

/// How the learning rate changes over the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Always the same.
    Constant,
    /// A short linear warm-up, then half a cosine down to (nearly) zero.
    Cosine,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { hidden: vec![128, 128], activation: Activation::Tanh }
    }
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            optimizer: Optimizer::Adam,
            learning_rate: 5e-3,
            schedule: Schedule::Cosine,
            batch: 1024,
            epochs: 40,
            validation: 0.1,
            patience: 0,
        }
    }
}
