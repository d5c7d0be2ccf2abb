//! What a quantity is called, in which unit, and what it means.

/// A named quantity of a source: a parameter or an output column of a dataset.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variable {
    /// Name, as the study and the FMU show it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
}
