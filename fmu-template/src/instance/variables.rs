//! What value references stand for.

use crate::{answer::Refusal, state::Version};
use metafmu_runtime::{Surrogate, extra};

/// What a value reference stands for.
#[derive(Clone, Copy)]
pub(super) enum Variable {
    /// Input column of the network.
    Column(usize),
    Output(usize),
    Policy,
    InDomain,
    Distance,
    /// The independent variable of a surrogate without a time column.
    Time,
    /// Several outputs, in FMI 3.0.
    Array(usize),
    /// Error bound of an output, a constant.
    Bound(usize),
}

/// A scalar of real type: a variable or an element of an array.
#[derive(Clone, Copy)]
pub(super) enum Real {
    Column,
    Output(usize),
    Distance,
    Time,
    Bound,
}

/// Input columns come first, then outputs, then what every FMU adds, then arrays, then error bounds.
pub(super) struct Variables {
    inputs: usize,
    /// Value reference after those of the outputs.
    first_extra: u32,
    /// Whether the time is a variable that the FMU adds.
    adds_time: bool,
    first_array: u32,
    /// Outputs of each array.
    arrays: Vec<Vec<usize>>,
    first_bound: u32,
    /// Error bound of each output, if they were measured.
    bounds: Vec<f64>,
}

const POLICY: u32 = extra::DOMAIN_POLICY.offset;
const IN_DOMAIN: u32 = extra::IN_DOMAIN.offset;
const DISTANCE: u32 = extra::DOMAIN_DISTANCE.offset;
const TIME: u32 = extra::TIME.offset;

impl Variables {
    pub(super) fn new(surrogate: &Surrogate, version: Version) -> Self {
        // FMI 2.0 has no array variables
        let arrays = if version == Version::Fmi3 { surrogate.arrays().len() } else { 0 };
        Self {
            inputs: surrogate.inputs().len(),
            first_extra: surrogate.output_value_reference(surrogate.outputs().len()),
            adds_time: surrogate.time_column().is_none(),
            first_array: surrogate.array_value_reference(0),
            arrays: (0..arrays).map(|index| surrogate.array_elements(index).1.to_vec()).collect(),
            first_bound: surrogate.bound_value_reference(0),
            bounds: surrogate.bounds().map_or(Vec::new(), |bounds| bounds.half_widths.clone()),
        }
    }

    #[inline]
    pub(super) fn find(&self, reference: u32) -> Result<Variable, Refusal> {
        let index = reference as usize;
        if index < self.inputs {
            return Ok(Variable::Column(index));
        }
        if reference < self.first_extra {
            return Ok(Variable::Output(index - self.inputs));
        }
        match reference - self.first_extra {
            POLICY => Ok(Variable::Policy),
            IN_DOMAIN => Ok(Variable::InDomain),
            DISTANCE => Ok(Variable::Distance),
            TIME if self.adds_time => Ok(Variable::Time),
            _ => self.array_or_bound(reference),
        }
    }

    fn array_or_bound(&self, reference: u32) -> Result<Variable, Refusal> {
        let among = |first: u32, count: usize| {
            reference.checked_sub(first).map(|index| index as usize).filter(|&index| index < count)
        };
        if let Some(array) = among(self.first_array, self.arrays.len()) {
            return Ok(Variable::Array(array));
        }
        if let Some(output) = among(self.first_bound, self.bounds.len()) {
            return Ok(Variable::Bound(output));
        }
        let last = match (self.arrays.len() as u32, self.bounds.len() as u32) {
            (0, 0) => self.first_extra + if self.adds_time { TIME } else { DISTANCE },
            (arrays, 0) => self.first_array + arrays - 1,
            (_, bounds) => self.first_bound + bounds - 1,
        };
        Err(if reference < last {
            Refusal::UnusedReference { reference }
        } else {
            Refusal::UnknownReference { reference, last }
        })
    }

    /// The error bound of an output that has one.
    pub(super) fn bound(&self, output: usize) -> f64 {
        self.bounds[output]
    }

    /// How many values these variables have.
    pub(super) fn size(&self, references: &[u32]) -> Result<usize, Refusal> {
        if self.arrays.is_empty() {
            return Ok(references.len());
        }
        references.iter().try_fold(0, |sum, &reference| Ok(sum + self.elements(self.find(reference)?).unwrap_or(1)))
    }

    /// How many elements an array has, none for a scalar.
    pub(super) fn elements(&self, variable: Variable) -> Option<usize> {
        match variable {
            Variable::Array(array) => Some(self.arrays[array].len()),
            _ => None,
        }
    }

    /// The outputs an array consists of.
    pub(super) fn outputs_of(&self, array: usize) -> &[usize] {
        &self.arrays[array]
    }

    /// Scalars of real type that these variables consist of, in order. Variables of other types have none.
    #[inline]
    pub(super) fn reals<'a>(&'a self, references: &'a [u32]) -> impl Iterator<Item = Real> + 'a {
        references.iter().flat_map(|&reference| {
            let (scalar, array) = match self.find(reference) {
                Ok(Variable::Column(_)) => (Some(Real::Column), &[][..]),
                Ok(Variable::Output(output)) => (Some(Real::Output(output)), &[][..]),
                Ok(Variable::Distance) => (Some(Real::Distance), &[][..]),
                Ok(Variable::Time) => (Some(Real::Time), &[][..]),
                Ok(Variable::Bound(_)) => (Some(Real::Bound), &[][..]),
                Ok(Variable::Array(array)) => (None, self.outputs_of(array)),
                Ok(Variable::Policy | Variable::InDomain) | Err(_) => (None, &[][..]),
            };
            scalar.into_iter().chain(array.iter().map(|&output| Real::Output(output)))
        })
    }
}
