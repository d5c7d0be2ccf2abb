//! `[network]`: the feed-forward network.

use super::{MAX_EPOCHS, Study, TrainingOptions};
use crate::diagnostics::Problems;
use metafmu_runtime::Activation;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Serialize};

/// `[network]`: the feed-forward network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct NetworkOptions {
    /// How the time enters.
    pub structure: TimeStructure,
    /// Number of nodes of each hidden layer, 1 to 16384 each; at most 100 layers. Of the structure "discrete" 32, 32 unless given. Of
    /// "static" unless given one or two layers of 8 to 16 nodes, chosen by their evidence, or of many rows 64, 64.
    #[schemars(length(max = MAX_LAYERS), inner(range(min = 1, max = MAX_NODES)))]
    pub hidden: Vec<usize>,
    /// Activation of every hidden layer.
    #[schemars(schema_with = "activations")]
    pub activation: Activation,
}

/// How the time enters a surrogate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum TimeStructure {
    /// One network, of which the time is an input.
    #[default]
    Full,
    /// A network of the parameters for each time of the runs; between two of them outputs are interpolated. Not with
    /// `time.margin`, as beyond `stop` there is no network, and not with `[target]`.
    Fixed,
}

impl Default for NetworkOptions {
    fn default() -> Self {
        Self { structure: TimeStructure::Full, hidden: vec![64; 6], activation: Activation::Tanh }
    }
}

impl NetworkOptions {
    /// In the equations of motion of a mechanism, which are evaluated in every stage of every step.
    pub fn of_equations() -> Self {
        Self { hidden: vec![64; 3], ..Self::default() }
    }
}

/// The runtime has no schemas: what is in every FMU stays small.
fn activations(_: &mut SchemaGenerator) -> Schema {
    json_schema!({ "type": "string", "enum": Activation::ALL })
}

/// Hidden layers of a network.
const MAX_LAYERS: usize = 100;

/// Nodes of a hidden layer.
const MAX_NODES: usize = 16384;

/// Weights and biases of all networks: training holds several copies of them in single precision.
const MAX_WEIGHTS: f64 = 1e8;

/// Maximum number of epochs of all networks if there is one for each time point: each has its history.
const MAX_HISTORIES: f64 = 1e8;

impl NetworkOptions {
    /// Every mistake, by key within the section.
    pub fn problems(&self) -> Problems {
        if self.hidden.len() > MAX_LAYERS {
            let message = format!("{} hidden layers, expected at most {MAX_LAYERS}", self.hidden.len());
            return Problems::one("hidden", message);
        }
        let mut problems = Problems::default();
        for (layer, nodes) in self.hidden.iter().enumerate().filter(|(_, nodes)| !(1..=MAX_NODES).contains(*nodes)) {
            problems.add("hidden", format!("hidden layer {} has {nodes} nodes, expected 1 to {MAX_NODES}", layer + 1));
        }
        problems
    }

    /// Problems that depend on the other sections, by dotted key.
    pub(super) fn problems_beside(&self, study: &Study) -> Problems {
        let Self { structure, .. } = self;
        let instants = match structure {
            TimeStructure::Fixed if !study.source.is_recorded() => study.time.stop / study.time.step + 1.0,
            _ => 1.0,
        };
        let inputs = study.encoder().width() + usize::from(*structure == TimeStructure::Full);
        let mut problems = self.problems_between([inputs, study.outputs.len()], instants, &study.training);
        let epochs = study.training.epochs as f64 * instants;
        if instants > 1.0 && epochs > MAX_HISTORIES && study.training.epochs <= MAX_EPOCHS {
            let message = format!("{epochs:.3e} epochs of {instants:.0} networks, expected at most 100 million");
            problems.add("training.epochs", message);
        }
        problems
    }

    /// Problems of `instants` networks with these numbers of inputs and outputs, by dotted key.
    pub fn problems_between(
        &self,
        [inputs, outputs]: [usize; 2],
        instants: f64,
        training: &TrainingOptions,
    ) -> Problems {
        let mut problems = Problems::default();
        if self.hidden.is_empty() {
            let message = "belongs to hidden layers, `network.hidden` has none";
            problems.expect_absent(training.dropout > 0.0, "training.dropout", message);
            problems.expect_absent(training.batch_norm, "training.batch_norm", message);
        }
        let sizes: Vec<usize> = [&[inputs], self.hidden.as_slice(), &[outputs]].concat();
        let weights: f64 = sizes.windows(2).map(|pair| (pair[0] as f64 + 1.0) * pair[1] as f64).sum();
        if weights * instants > MAX_WEIGHTS {
            let of = if instants > 1.0 { format!(" of {instants:.0} networks") } else { String::new() };
            let message = format!("{:.3e} weights and biases{of}, expected at most 100 million", weights * instants);
            problems.add("network.hidden", message);
        }
        problems
    }
}
