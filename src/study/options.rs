//! The sections of a study file as plain data.

use crate::scaling::LARGEST;
use indexmap::IndexMap;
use metafmu_runtime::{Activation, Encoding, Precision};
use serde::{Deserialize, Serialize};
use std::{collections::HashSet, path::PathBuf, time::Duration};

/// `[source]`: what is sampled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SourceOptions {
    /// Name of a built-in system.
    pub system: Option<String>,
    /// A mechanism file, relative to the study's folder. Its content counts for digests, not where it lies.
    #[serde(skip_serializing)]
    pub mechanism: Option<PathBuf>,
    /// An FMU to run, relative to the study's folder. Its content counts for digests, not where it lies.
    #[serde(skip_serializing)]
    pub fmu: Option<PathBuf>,
    /// Communication step size of the FMU in seconds, a whole part of `time.step`; without it, `time.step`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
    /// Tolerance of the integration. Of a system or mechanism relative and absolute, [`crate::integrate::TOLERANCE`] without
    /// it. Of an FMU for model exchange relative to each state and to its nominal value; without it that of the FMU's default
    /// experiment, else 1e-8.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Seconds after which a run, or the loading of the FMU, is given up. Like the next two it does not count for digests.
    #[serde(skip_serializing)]
    pub time_limit: Option<f64>,
    /// How often a run of the FMU that failed is tried again, in a fresh process.
    #[serde(skip_serializing)]
    pub retries: Option<usize>,
    /// Share of the runs that may fail; they are left out. If more do, the sampling fails.
    #[serde(skip_serializing)]
    pub max_failed: Option<f64>,
    /// A table of recorded runs, relative to the study's folder. Its content counts for digests, not where it lies.
    #[serde(skip_serializing)]
    pub table: Option<PathBuf>,
    /// An index of recorded runs, one file a run, likewise.
    #[serde(skip_serializing)]
    pub index: Option<PathBuf>,
    /// Names of columns in the tables where they are not the study's.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub columns: IndexMap<String, String>,
    /// Values of the source's quantities that are no parameters; it has a default for each.
    #[serde(default)]
    pub constants: IndexMap<String, f64>,
}

impl SourceOptions {
    /// How long a run may take, if that is limited.
    pub fn time_limit(&self) -> Option<Duration> {
        self.time_limit.map(|limit| Duration::from_secs_f64(limit.min(1e9)))
    }

    /// Whether runs are read from tables instead of being simulated.
    pub fn is_recorded(&self) -> bool {
        self.table.is_some() || self.index.is_some()
    }
}

/// `[time]`: the rows of a run, `0, step, ..., stop`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimeOptions {
    /// End of every run, in seconds.
    pub stop: f64,
    /// Time between two rows, in seconds; divides `stop`.
    pub step: f64,
    /// How much longer training runs are, as a share of `stop`, rounded up to whole steps: the network is better at the end of
    /// a time that it was trained beyond. Tests, bounds and the domain of validity end at `stop`.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub margin: f64,
}

fn is_zero(number: &f64) -> bool {
    *number == 0.0
}

impl TimeOptions {
    /// The times of a run's rows, in seconds: `count + 1` values computed as `stop * i / count`, so that none drifts.
    pub fn grid(&self) -> Vec<f64> {
        self.times(self.steps())
    }

    /// The times of a training run's rows, which go on beyond `stop` by the margin.
    pub fn training_grid(&self) -> Vec<f64> {
        self.times(self.training_steps())
    }

    /// Steps of a run.
    fn steps(&self) -> u64 {
        (self.stop / self.step).round() as u64
    }

    /// Steps of a training run.
    pub fn training_steps(&self) -> u64 {
        let steps = self.steps();
        // a margin of 0.05 of 100 steps is 5, not 6
        steps + (self.margin * steps as f64 - 1e-9).ceil().max(0.0) as u64
    }

    fn times(&self, steps: u64) -> Vec<f64> {
        let count = self.steps() as f64;
        (0..=steps).map(|i| self.stop * i as f64 / count).collect()
    }
}

/// An entry of `[parameters]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "ParameterEntry")]
pub struct ParameterOptions {
    /// Lower end of the range; of a nominal parameter the smallest value.
    pub min: f64,
    /// Upper end of the range; of a nominal parameter the largest value.
    pub max: f64,
    /// The values of a nominal parameter, which has no others; none: it has a range.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub values: Vec<f64>,
    /// Whether `max` is `min` again, as of an angle of a full turn.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub periodic: bool,
    /// Unit; must be the source's own.
    pub unit: Option<String>,
    /// One sentence for people; the source has one.
    pub description: Option<String>,
    /// Levels of this parameter in a mesh, instead of `sampling.levels`.
    pub levels: Option<usize>,
    /// When the host of the surrogate's FMU may change it; fixed without it.
    pub variability: Option<Variability>,
}

/// When a host may change what is a parameter of the study, and constant in each of its runs (FMI terms).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Variability {
    /// Only before the simulation starts.
    #[default]
    Fixed,
    /// Also between two steps and at events. The FMU warns and is outside its domain from then on.
    Tunable,
    /// Any time: an input, which another component may drive. Likewise.
    Continuous,
}

/// [`ParameterOptions`] as they stand in the study.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table such as { min = 0.1, max = 0.2 }")]
struct ParameterEntry {
    min: Option<f64>,
    max: Option<f64>,
    values: Option<Vec<f64>>,
    #[serde(default)]
    periodic: bool,
    unit: Option<String>,
    description: Option<String>,
    levels: Option<usize>,
    variability: Option<Variability>,
}

impl TryFrom<ParameterEntry> for ParameterOptions {
    type Error = String;

    fn try_from(entry: ParameterEntry) -> Result<Self, String> {
        let ParameterEntry { min, max, values, periodic, unit, description, levels, variability } = entry;
        let (min, max) = match (&values, min, max) {
            (None, Some(min), Some(max)) => (min, max),
            (None, None, None) => return Err("expected `min` and `max`, or `values`".into()),
            (None, None, _) => return Err("`min` is missing".into()),
            (None, _, None) => return Err("`max` is missing".into()),
            (Some(values), None, None) if levels.is_none() && !periodic => values
                .iter()
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(min, max), &value| (min.min(value), max.max(value))),
            (Some(_), ..) => return Err("`values` exclude `min`, `max`, `levels` and `periodic`".into()),
        };
        if values.as_ref().is_some_and(Vec::is_empty) {
            return Err("no `values`, expected at least 2".into());
        }
        let values = values.unwrap_or_default();
        Ok(Self { min, max, values, periodic, unit, description, levels, variability })
    }
}

impl ParameterOptions {
    /// How its value becomes columns of the network.
    pub fn encoding(&self) -> Encoding {
        if self.is_nominal() {
            Encoding::Nominal(self.values.clone())
        } else if self.periodic {
            Encoding::Periodic
        } else {
            Encoding::Plain
        }
    }

    /// Whether it has `values` instead of a range.
    pub fn is_nominal(&self) -> bool {
        !self.values.is_empty()
    }

    /// Whether its range has ends.
    pub fn has_faces(&self) -> bool {
        !self.is_nominal() && !self.periodic
    }

    /// The value at a `share` from 0 to 1: of the range, or of the list of values, each of which has an equal part.
    pub fn at(&self, share: f64) -> f64 {
        let Self { min, max, values, .. } = self;
        match values.len() {
            0 => min + (max - min) * share,
            count => values[((share * count as f64) as usize).min(count - 1)],
        }
    }

    /// Where a value is, from 0 to 1: in the range, or in the list of values.
    pub fn share(&self, value: f64) -> f64 {
        match self.values.iter().position(|known| *known == value) {
            Some(index) => index as f64 / (self.values.len() - 1) as f64,
            None => (value - self.min) / (self.max - self.min),
        }
    }

    /// The values of a mesh: all of a nominal parameter, else `levels`, evenly spaced, both ends of the range included; of a
    /// periodic one without its upper end, which is its lower end again.
    pub fn mesh(&self, levels: usize) -> Vec<f64> {
        let Self { min, max, values, periodic, .. } = self;
        if self.is_nominal() {
            return values.clone();
        }
        let steps = if *periodic { levels } else { levels - 1 };
        (0..levels).map(|i| min + (max - min) * i as f64 / steps as f64).collect()
    }

    /// What is wrong with the range or the values.
    pub fn problem(&self) -> Option<String> {
        let Self { min, max, values, .. } = self;
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            Some(format!("value {value} is not finite"))
        } else if let Some(value) = twice(values) {
            Some(format!("value {value} is duplicated"))
        } else if values.len() == 1 {
            Some("1 value, expected at least 2".into())
        } else if !min.is_finite() || !max.is_finite() {
            Some(format!("range from {min} to {max} is not finite"))
        } else if min >= max {
            Some(format!("range is empty: min {min} is not below max {max}"))
        } else if min.abs().max(max.abs()) > LARGEST || max - min < 1.0 / LARGEST {
            Some(format!(
                "range from {min} to {max}, expected numbers up to {LARGEST:e} and a width above {:e}",
                1.0 / LARGEST
            ))
        } else {
            None
        }
    }
}

/// A value that is there more than once.
fn twice(values: &[f64]) -> Option<f64> {
    let mut before = HashSet::with_capacity(values.len());
    // zeros of both signs are one value
    values.iter().copied().find(|value| !before.insert((value + 0.0).to_bits()))
}

/// An entry of `[outputs]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, expecting = "a table such as { unit = \"rad\" }, or {}")]
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
    /// How the training runs are placed; recorded runs are where they are.
    pub method: Option<Method>,
    /// Levels of each parameter in a mesh, both ends of its range included.
    pub levels: Option<usize>,
    /// Number of training runs of the methods that have neither levels nor a file.
    pub runs: Option<usize>,
    /// CSV or Parquet file of the method "list", relative to the study's folder: a column for each parameter. Its content counts for
    /// digests, not where it lies.
    #[serde(skip_serializing)]
    pub file: Option<PathBuf>,
    /// Share of the training runs that lie on the ends of each parameter's range, half of them on either end; none unless given. A
    /// mesh has its ends anyway, a list is what it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub faces: Option<f64>,
    /// Number of test runs: random, from the same ranges, never part of training.
    #[serde(default = "default_test_runs")]
    pub test_runs: usize,
}

fn default_test_runs() -> usize {
    200
}

/// `[bounds]`: error bounds of the outputs, measured on runs of their own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoundsOptions {
    /// Share of points that are to lie within the bounds, between 0 and 1.
    pub coverage: f64,
    /// Number of runs the bounds are measured on: random, from the same ranges, part of neither training nor tests.
    pub runs: usize,
}

impl BoundsOptions {
    /// Fewest runs that bounds of this coverage can be measured on.
    pub fn least_runs(coverage: f64) -> usize {
        (coverage / (1.0 - coverage)).ceil() as usize
    }
}

impl Default for BoundsOptions {
    fn default() -> Self {
        Self { coverage: 0.95, runs: 200 }
    }
}

/// `[accept]`: when a surrogate may be used. One that is not as good is rejected: `build`, `train` and `evaluate` say why and end
/// with exit code 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AcceptOptions {
    /// Smallest R² of an output; at 0 it is as good as its mean.
    pub r2: f64,
    /// Largest root mean square error of an output, in multiples of that of the best baseline of the build. Not asked of an
    /// output whose R² is above [`AcceptOptions::EXCELLENT`].
    pub baseline_factor: f64,
    /// Largest error of an output, as a share of its range in training; without it, it may have any.
    pub largest_error: Option<f64>,
}

impl Default for AcceptOptions {
    fn default() -> Self {
        Self { r2: 0.0, baseline_factor: 2.0, largest_error: None }
    }
}

impl AcceptOptions {
    /// R² from which on an output is not compared with baselines: its root mean square error is a hundredth of its standard
    /// deviation, and a polynomial may be exact where the truth is one.
    pub const EXCELLENT: f64 = 0.9999;

    /// Every mistake: its key within `[accept]` and what is wrong.
    pub fn problems(&self) -> Vec<(String, String)> {
        let Self { r2, baseline_factor, largest_error } = *self;
        [
            (r2 < 1.0, "r2", r2, "a number below 1"),
            (baseline_factor >= 1.0, "baseline_factor", baseline_factor, "a number of at least 1, or inf"),
            (
                largest_error.is_none_or(|share| share > 0.0),
                "largest_error",
                largest_error.unwrap_or(0.0),
                "a positive number",
            ),
        ]
        .into_iter()
        .filter(|(good, ..)| !good)
        .map(|(_, key, found, expected)| (key.to_owned(), format!("{found}, expected {expected}")))
        .collect()
    }
}

/// `[target]`: how good the surrogate is to be; runs are added, and the training goes on, until it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TargetOptions {
    /// R² that every output is to reach on the runs held out for validation.
    pub r2: f64,
    /// Runs that are added each time.
    pub runs: usize,
    /// Training runs there may be at last, those of the plan included.
    pub max_runs: usize,
    /// Whether the added runs go where the error is large; else the plan goes on.
    #[serde(default = "default_adaptive")]
    pub adaptive: bool,
}

fn default_adaptive() -> bool {
    true
}

/// How the training runs are placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Full factorial: every combination of evenly spaced levels.
    Mesh,
    /// Independent and uniform over the ranges.
    Random,
    /// Latin hypercube: each of `runs` slices of each range has one point.
    LatinHypercube,
    /// Low-discrepancy: a randomly shifted Sobol sequence, which leaves no gaps and no clusters.
    Sobol,
    /// Low-discrepancy: a randomly shifted Halton sequence.
    Halton,
    /// The points of a CSV or Parquet file.
    List,
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
    /// How the time enters.
    #[serde(skip_serializing_if = "Structure::is_full")]
    pub structure: Structure,
    /// Number of nodes of each hidden layer.
    pub hidden: Vec<usize>,
    /// Activation of every hidden layer.
    pub activation: Activation,
}

/// How the time enters a surrogate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Structure {
    /// One network, of which the time is an input.
    #[default]
    Full,
    /// A network of the parameters for each time of the runs; between two of them outputs are interpolated.
    Fixed,
}

impl Structure {
    fn is_full(&self) -> bool {
        *self == Self::Full
    }
}

/// `[training]`: how the network is trained.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainingOptions {
    /// What is made small.
    pub loss: Loss,
    /// From which error on, in standard deviations, the Huber loss grows linearly.
    pub huber_delta: f64,
    /// Weights of the outputs in the loss, in the order of the outputs; none: all 1.
    pub output_weights: Vec<f64>,
    /// Rule that turns gradients into parameter updates.
    pub optimizer: Optimizer,
    /// Share of the mean gradient that is kept from step to step: SGD's momentum, β1 of the others. Without it, the
    /// optimizer's own: 0.9, of SOAP 0.95, of RMSprop none.
    pub momentum: Option<f64>,
    /// Share of the mean squared gradient that is kept from step to step: RMSprop's α, β2 of the others. Without it,
    /// the optimizer's own: 0.99 of RMSprop, 0.999 of Adam and AdamW, 0.95 of SOAP.
    pub beta2: Option<f64>,
    /// Steps between two refreshes of SOAP's eigenbases.
    pub refresh: u64,
    /// Learning rate at its highest.
    pub learning_rate: f64,
    /// How the learning rate changes over the training.
    pub schedule: Schedule,
    /// Share of the training in which the learning rate rises linearly from nearly zero (of the one-cycle schedule:
    /// along half a cosine). Without it, the schedule's own: 0.03 of the cosine, 0.3 of one-cycle, 0 of the others.
    pub warm_up: Option<f64>,
    /// Rows per optimizer step.
    pub batch: usize,
    /// Passes over the training rows, at the most.
    pub epochs: usize,
    /// Share of the training runs that is held out to choose the best epoch, between 0 and 1.
    pub validation: f64,
    /// Stop after this many epochs without a better validation loss; 0: never.
    pub patience: usize,
    /// Of the schedule "restarts": validation loss, about 1 - R², at which a cycle is the last; 1e-7 unless given. So is a cycle, from the
    /// third on, that is hardly better than the one before: less than a quarter, if it was twice as long.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub enough: Option<f64>,
    /// Weight of the sum of all parameters' magnitudes in the loss.
    pub l1: f64,
    /// Weight of half the sum of all parameters' squares in the loss.
    pub l2: f64,
    /// AdamW's and SOAP's: what a parameter loses in a step, relative to itself and to the learning rate.
    pub weight_decay: f64,
    /// Share of the hidden nodes that is left out in a step, others in each row.
    pub dropout: f64,
    /// Whether hidden layers are normalised over the rows of a block. In the FMU, weights and biases contain it.
    pub batch_norm: bool,
    /// Longer gradients are shortened to this length; 0: none is.
    pub clip_norm: f64,
}

/// What is made small: the mean over rows and outputs of a function of the error `e` of the standardised output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Loss {
    /// `e²`
    Mse,
    /// `|e|`
    Mae,
    /// `e² / 2` up to `|e| = δ`, `δ (|e| - δ / 2)` above.
    Huber,
}

/// Rule that turns gradients into parameter updates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optimizer {
    /// Gradient descent with momentum: `m = μ m + g`, `p -= rate m`.
    Sgd,
    /// Tieleman and Hinton 2012: `v = α v + (1 - α) g²`, `p -= rate g / (√v + ε)`.
    RmsProp,
    /// Kingma and Ba, arXiv:1412.6980.
    Adam,
    /// Loshchilov and Hutter, arXiv:1711.05101: Adam with a weight decay beside the gradient.
    AdamW,
    /// Vyas and others, arXiv:2409.11321: Adam in the eigenbasis of Shampoo's preconditioner.
    Soap,
}

/// How the learning rate changes over the training.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Schedule {
    /// Always the same.
    Constant,
    /// A tenth after each third of the training.
    Step,
    /// Half a cosine down to (nearly) zero.
    Cosine,
    /// Loshchilov and Hutter, arXiv:1608.03983 (SGDR): half a cosine down to (nearly) zero again and again, first over a thirtieth of the
    /// epochs, then over a fifteenth, then over as many as it takes until the validation loss is [`TrainingOptions::enough`], as far
    /// as those before tell. The training ends when it is, when a cycle gains nothing any more, or with the epochs.
    Restarts,
    /// Smith and Topin, arXiv:1708.07120: from a 25th up half a cosine, then down half a cosine to (nearly) zero.
    OneCycle,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { structure: Structure::Full, hidden: vec![64; 6], activation: Activation::Tanh }
    }
}

impl Default for TrainingOptions {
    fn default() -> Self {
        Self {
            loss: Loss::Mse,
            huber_delta: 1.0,
            output_weights: Vec::new(),
            optimizer: Optimizer::Soap,
            momentum: None,
            beta2: None,
            refresh: 10,
            learning_rate: 5e-3,
            schedule: Schedule::Restarts,
            warm_up: None,
            batch: 1024,
            epochs: 150,
            validation: 0.1,
            patience: 0,
            enough: None,
            l1: 0.0,
            l2: 0.0,
            weight_decay: 0.0,
            dropout: 0.0,
            batch_norm: false,
            clip_norm: 0.0,
        }
    }
}

/// Hidden layers of a network.
const MAX_LAYERS: usize = 100;

/// Epochs of a training, all of which are in its history.
pub(super) const MAX_EPOCHS: usize = 1_000_000;

impl NetworkOptions {
    /// Every mistake: its key within `[network]` and what is wrong.
    pub fn problems(&self) -> Vec<(String, String)> {
        if self.hidden.len() > MAX_LAYERS {
            let message = format!("{} hidden layers, expected at most {MAX_LAYERS}", self.hidden.len());
            return vec![("hidden".to_owned(), message)];
        }
        let too = |(layer, nodes): (usize, &usize)| {
            let message = format!("hidden layer {} has {nodes} nodes, expected 1 to 16384", layer + 1);
            (!(1..=16384).contains(nodes)).then(|| ("hidden".to_owned(), message))
        };
        self.hidden.iter().enumerate().filter_map(too).collect()
    }
}

impl TrainingOptions {
    /// Every mistake: its key within `[training]` and what is wrong. `outputs`: how many the network has.
    pub fn problems(&self, outputs: usize) -> Vec<(String, String)> {
        let mut problems = Vec::new();
        let mut expect = |good: bool, key: &str, found: &dyn std::fmt::Display, expected: &str| {
            if !good {
                problems.push((key.to_owned(), format!("{found}, expected {expected}")));
            }
        };
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let share = |value: f64| (0.0..1.0).contains(&value);

        expect(positive(self.learning_rate), "learning_rate", &self.learning_rate, "a positive number");
        expect(positive(self.huber_delta), "huber_delta", &self.huber_delta, "a positive number");
        for (key, value) in
            [("l1", self.l1), ("l2", self.l2), ("weight_decay", self.weight_decay), ("clip_norm", self.clip_norm)]
        {
            expect(not_negative(value), key, &value, "0 or a positive number");
        }
        expect(share(self.dropout), "dropout", &self.dropout, "a share of at least 0 and below 1");
        for (key, value) in [("momentum", self.momentum), ("beta2", self.beta2), ("warm_up", self.warm_up)] {
            let value = value.unwrap_or(0.0);
            expect(share(value), key, &value, "a share of at least 0 and below 1");
        }
        let held_out = self.validation > 0.0 && self.validation < 1.0;
        expect(held_out, "validation", &self.validation, "a share between 0 and 1");
        expect(self.batch > 0, "batch", &self.batch, "at least 1 row");
        let norm = !self.batch_norm || self.batch != 1;
        expect(norm, "batch", &self.batch, "at least 2 rows with `batch_norm`, which is over the rows of a batch");
        let epochs = format!("1 to {MAX_EPOCHS}");
        expect((1..=MAX_EPOCHS).contains(&self.epochs), "epochs", &self.epochs, &epochs);
        expect(self.refresh > 0, "refresh", &self.refresh, "at least 1 step");
        let enough = self.enough.unwrap_or(0.0);
        expect(not_negative(enough), "enough", &enough, "0 or a positive number");

        let weights = &self.output_weights;
        let count = format!("{} weights", weights.len());
        expect(weights.is_empty() || weights.len() == outputs, "output_weights", &count, "one for each output or none");
        let good = weights.iter().all(|&weight| not_negative(weight));
        let some = weights.is_empty() || weights.iter().any(|&weight| weight > 0.0);
        expect(good && some, "output_weights", &format!("{weights:?}"), "no negative numbers, and not only zeros");
        let (decays, defaults) = (matches!(self.optimizer, Optimizer::AdamW | Optimizer::Soap), Self::default());
        let of_others = [
            (
                "weight_decay",
                self.weight_decay > 0.0 && !decays,
                "belongs to the optimizers \"adamw\" and \"soap\"; the others have `l2`",
            ),
            (
                "enough",
                self.enough.is_some() && self.schedule != Schedule::Restarts,
                "belongs to the schedule \"restarts\"",
            ),
            (
                "patience",
                self.patience > 0 && self.schedule == Schedule::Restarts,
                "belongs to the other schedules: one with restarts ends when its cycles gain nothing any more",
            ),
            (
                "beta2",
                self.beta2.is_some() && self.optimizer == Optimizer::Sgd,
                "belongs to the other optimizers: \"sgd\" has `momentum` only",
            ),
            (
                "refresh",
                self.refresh != defaults.refresh && self.optimizer != Optimizer::Soap,
                "belongs to the optimizer \"soap\"",
            ),
            (
                "huber_delta",
                self.huber_delta != defaults.huber_delta && self.loss != Loss::Huber,
                "belongs to the loss \"huber\"",
            ),
        ];
        let given = of_others.into_iter().filter(|(_, given, _)| *given);
        problems.extend(given.map(|(key, _, message)| (key.to_owned(), message.to_owned())));
        problems
    }

    /// How many of so many training runs are held out for validation: at least one, and not all.
    pub fn held_out(&self, runs: usize) -> usize {
        ((self.validation * runs as f64).round() as usize).clamp(1, runs.saturating_sub(1).max(1))
    }
}
