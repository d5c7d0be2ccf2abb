//! Description of variables: names, units, roles, ranges.

use crate::exact;
use serde::{Deserialize, Serialize};

/// How an input's value becomes one or several columns of the network.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Encoding {
    /// One column: the value itself.
    #[default]
    Plain,
    /// One-hot, a column for each of these values: 1 for the one nearest to the input's value, 0 for the others.
    Nominal(Vec<f64>),
    /// Two columns: sine and cosine of `2 pi (x - min) / (max - min)`, so that `min` and `max` are the same.
    Periodic,
}

impl Encoding {
    /// Returns true if the column is the value itself.
    pub fn is_plain(&self) -> bool {
        *self == Self::Plain
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        match self {
            Self::Plain => 1,
            Self::Nominal(values) => values.len(),
            Self::Periodic => 2,
        }
    }
}

/// One input of the surrogate: a column of the network, or several if its encoding says so.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Input {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// Role of the input in the host.
    pub role: Role,
    /// Unit, for instance `rad/s`; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value in the training range.
    pub min: f64,
    /// Largest value in the training range.
    pub max: f64,
    /// Value before a host sets one; within the range, and one of the values of a nominal input.
    pub start: f64,
    /// How its value becomes columns of the network.
    #[serde(skip_serializing_if = "Encoding::is_plain")]
    pub encoding: Encoding,
}

/// Role of an input column of the network for a host.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase", tag = "causality", content = "variability")]
pub enum Role {
    /// A parameter the host sets.
    Parameter(Tunability),
    /// The simulation time.
    Time,
    /// A continuous input: another component drives it while the simulation runs.
    Input,
    /// The value of a state at the start: a fixed parameter that nothing else depends on.
    Start,
}

/// Precision of a network's arithmetic. Weights are kept in single precision and scaling is done in double precision
/// either way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Outputs smooth enough for solvers with tight tolerances.
    #[default]
    Double,
    /// Twice as fast, errors around 1e-6 of the outputs' scale: for real-time co-simulation.
    Single,
}

impl Precision {
    pub(crate) fn is_double(&self) -> bool {
        *self == Self::Double
    }
}

/// When a host may change a parameter (FMI terms).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tunability {
    /// Only before the simulation starts.
    #[default]
    Fixed,
    /// Also between two communication steps.
    Tunable,
}

/// Limit of a state with a range, as a multiple of the largest value in the range: beyond it the solution is not a
/// motion.
const IMPLAUSIBLE: f64 = 1e3;
/// Limit of a state without a range, as a multiple of its nominal value, which counts as 1 at least.
const LARGEST: f64 = 1e9;

/// A continuous state.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct State {
    /// Variable name, as the FMU shows it; its derivative is `der(NAME)`.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// Unit of its derivative.
    pub rate_unit: String,
    /// One sentence for people.
    pub description: String,
    /// Where it was trained; none if every number is as good, as for an angle or what enters exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Typical magnitude, positive; a solver's tolerance is relative to it.
    pub nominal: f64,
}

impl State {
    /// Name of the variable that holds its derivative.
    pub fn rate_name(&self) -> String {
        format!("der({})", self.name)
    }

    /// Name of the parameter that holds its value at the start.
    pub fn start_name(name: &str) -> String {
        format!("{name}_start")
    }

    /// Magnitude beyond which no value is plausible: a thousand times the largest in the range; without a range a billion nominal values, of
    /// which most digits are lost.
    pub fn limit(&self) -> f64 {
        if self.range.is_some() { IMPLAUSIBLE * self.nominal } else { LARGEST * self.nominal.max(1.0) }
    }

    /// Description of the valid values.
    pub fn valid(&self) -> String {
        match self.range {
            Some([min, max]) => format!("the training range from {} to {}", exact(min), exact(max)),
            None => "all numbers".into(),
        }
    }
}

/// One output column of the network.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Output {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Smallest value seen in training.
    pub min: f64,
    /// Largest value seen in training.
    pub max: f64,
    /// Position of the output whose predicted standard deviation it is; none of an output that predicts a quantity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub std_of: Option<u32>,
}

impl Output {
    /// Name of the output that holds the predicted standard deviation of another one.
    pub fn std_name(name: &str) -> String {
        format!("{name}_std")
    }

    /// Name of the variable that holds the error bound of an output.
    pub fn bound_name(name: &str) -> String {
        format!("{name}_bound")
    }

    /// Name of the input that holds the measured value of an output.
    pub fn measured_name(name: &str) -> String {
        format!("{name}_measured")
    }

    /// The value of an output that did not vary in training. A standard deviation that is the same at all rows may vary between them.
    pub fn constant(&self) -> Option<f64> {
        (self.min == self.max && self.std_of.is_none()).then_some(self.min)
    }
}

/// Several outputs of one unit as one array variable of FMI 3.0, for instance the coordinates of a point.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OutputArray {
    /// Variable name, as the FMU shows it.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// Names of the outputs that are the elements, in order; at least two, each at most once.
    pub outputs: Vec<String>,
}

/// Where a surrogate comes from; enough to make it again.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Provenance {
    /// Name and version of the program that wrote the file.
    pub tool: String,
    /// SHA-256 of the study's content, in hexadecimal digits.
    pub study_digest: String,
    /// The study's seed.
    pub seed: u64,
    /// Number of training rows.
    pub train_rows: u64,
    /// SHA-256 of everything in the file but this field: the FMU's GUID is made from it.
    pub content_digest: String,
}
