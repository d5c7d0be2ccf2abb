//! Value references and their quantities in one version of the standard.

use crate::{state::Version, status::Refusal};
use metafmu_runtime::{Bounds, BuiltIn, Quantity, Surrogate, Variable};

/// A scalar that has derivatives.
#[derive(Clone, Copy)]
pub(super) enum UnknownQuantity {
    /// An output, maybe as an element of an array, or after all outputs the derivative of a state.
    Result(usize),
    /// A state.
    State(usize),
    /// The distance from the domain.
    Distance,
    /// The error bound of an output, which depends on the time alone.
    Bound(usize),
    /// A constant, or a Boolean that belongs to the outputs of some hosts.
    Constant,
}

/// The surrogate's variables that the version has.
pub(super) struct InstanceVariables {
    /// By value reference; none before the first one and, in FMI 2.0, for a variable of FMI 3.0 only.
    all: Vec<Option<Variable>>,
    /// Outputs of each array.
    arrays: Vec<Vec<usize>>,
    /// Error bounds of the outputs, if they were measured.
    bounds: Option<Bounds>,
    /// Number of outputs.
    outputs: usize,
}

impl InstanceVariables {
    pub(super) fn new(surrogate: &Surrogate, version: Version) -> Self {
        let table = surrogate.variables();
        let arrays = if version == Version::Fmi3 { surrogate.arrays().len() } else { 0 };
        let mut all: Vec<Option<Variable>> = (0..table.reference_count())
            .map(|reference| table.get(reference).filter(|variable| version == Version::Fmi3 || !variable.only_fmi3))
            .map(Option::<&Variable>::cloned)
            .collect();
        all.truncate(all.iter().rposition(Option::is_some).map_or(0, |last| last + 1));
        Self {
            all,
            arrays: (0..arrays).map(|index| surrogate.array_elements(index).1.to_vec()).collect(),
            bounds: surrogate.bounds().cloned(),
            outputs: surrogate.outputs().len(),
        }
    }

    #[inline]
    pub(super) fn find(&self, reference: u32) -> Result<&Variable, Refusal> {
        match self.all.get(reference as usize) {
            Some(Some(variable)) => Ok(variable),
            Some(None) => Err(Refusal::UnusedReference { reference }),
            None => Err(Refusal::UnknownReference { reference, last: self.all.len() as u32 - 1 }),
        }
    }

    /// Value reference of the variable with this quantity, if the version has it.
    pub(super) fn reference(&self, quantity: Quantity) -> Option<u32> {
        let reference =
            self.all.iter().position(|variable| variable.as_ref().is_some_and(|v| v.quantity == quantity))?;
        Some(reference as u32)
    }

    /// Error bound of an output that has one, `elapsed` seconds after the start.
    pub(super) fn bound(&self, output: usize, elapsed: f64) -> f64 {
        self.bounds.as_ref().map_or(0.0, |bounds| bounds.at(output, elapsed))
    }

    /// Derivative of such a bound with respect to the time.
    pub(super) fn bound_rate(&self, output: usize, elapsed: f64) -> f64 {
        self.bounds.as_ref().map_or(0.0, |bounds| bounds.rate(output, elapsed))
    }

    /// Returns true if the bounds depend on the time.
    pub(super) fn bounds_grow(&self) -> bool {
        self.bounds.as_ref().is_some_and(Bounds::grow)
    }

    /// How many values these variables have.
    pub(super) fn size(&self, references: &[u32]) -> Result<usize, Refusal> {
        if self.arrays.is_empty() {
            return Ok(references.len());
        }
        references
            .iter()
            .try_fold(0, |sum, &reference| Ok(sum + self.elements(self.find(reference)?.quantity).unwrap_or(1)))
    }

    /// How many elements an array has, none for a scalar.
    pub(super) fn elements(&self, quantity: Quantity) -> Option<usize> {
        match quantity {
            Quantity::Array(array) => Some(self.arrays[array].len()),
            _ => None,
        }
    }

    /// The outputs an array consists of.
    pub(super) fn outputs_of(&self, array: usize) -> &[usize] {
        &self.arrays[array]
    }

    /// The scalars with derivatives that these variables consist of, in order.
    #[inline]
    pub(super) fn unknowns<'a>(&'a self, references: &'a [u32]) -> impl Iterator<Item = UnknownQuantity> + 'a {
        references.iter().flat_map(|&reference| {
            let (scalar, array) = match self.find(reference).map(|variable| variable.quantity) {
                Ok(Quantity::Output(output)) => (Some(UnknownQuantity::Result(output)), &[][..]),
                Ok(Quantity::Derivative(state)) => (Some(UnknownQuantity::Result(self.outputs + state)), &[][..]),
                Ok(Quantity::State(state)) => (Some(UnknownQuantity::State(state)), &[][..]),
                Ok(Quantity::BuiltIn(BuiltIn::DomainDistance)) => (Some(UnknownQuantity::Distance), &[][..]),
                Ok(Quantity::Array(array)) => (None, self.outputs_of(array)),
                Ok(Quantity::Bound(output)) if self.bounds_grow() => (Some(UnknownQuantity::Bound(output)), &[][..]),
                Ok(Quantity::Bound(_) | Quantity::BuiltIn(BuiltIn::InDomain)) => {
                    (Some(UnknownQuantity::Constant), &[][..])
                }
                Ok(Quantity::Input(_) | Quantity::Measured(_) | Quantity::BuiltIn(_)) | Err(_) => (None, &[][..]),
            };
            scalar.into_iter().chain(array.iter().map(|&output| UnknownQuantity::Result(output)))
        })
    }
}
