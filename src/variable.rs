//! What a quantity is called, in which unit, and what it means.

use metafmu_runtime::Role;

/// A named quantity of a source: a parameter or an output column of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Name, as the study and the FMU show it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// What a parameter was in the FMU it is taken from; none if it is from elsewhere.
    pub original: Option<Original>,
}

/// What a parameter is in an FMU whose surrogate is to take its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Original {
    /// A parameter, and when it may change, or an input.
    pub role: Role,
    /// Its value before a host sets one.
    pub start: Option<f64>,
}

impl Variable {
    /// A quantity that is from no FMU.
    pub fn new(name: &str, unit: &str, description: &str) -> Self {
        Self { name: name.into(), unit: unit.into(), description: description.into(), original: None }
    }
}
