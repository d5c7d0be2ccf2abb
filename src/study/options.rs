//! What a study says about the network and its training.

use metafmu_runtime::Activation;
use serde::{Deserialize, Serialize};

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
