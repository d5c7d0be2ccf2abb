//! Named quantities, with their units and meanings.

/// A named quantity of a source: a parameter or an output column of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceVariable {
    /// Name, as the study and the FMU show it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Value of a parameter before a host sets one, in the FMU it is taken from.
    pub start: Option<f64>,
}

impl SourceVariable {
    /// A quantity that is from no FMU.
    pub fn new(name: &str, unit: &str, description: &str) -> Self {
        Self { name: name.into(), unit: unit.into(), description: description.into(), start: None }
    }
}
