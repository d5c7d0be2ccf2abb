//! Checks of numbers and shapes.

use crate::FormatError;
use std::fmt::Display;

pub(crate) fn expect_shape(name: impl Display, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.to_string(), found: found.into(), expected: expected.into() })
}

/// Refuses the element of a tensor at `index` unless it is below a limit.
pub(crate) fn expect_below(name: &str, index: usize, found: usize, limit: usize) -> Result<(), FormatError> {
    if found < limit {
        return Ok(());
    }
    Err(FormatError::Index { name: name.into(), index, found: found as u64, limit: limit as u64 })
}

pub(crate) fn expect_finite(name: impl Display, values: impl Iterator<Item = f64>) -> Result<(), FormatError> {
    match values.enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, value)) => Err(FormatError::NotFinite { name: name.to_string(), index, value }),
        None => Ok(()),
    }
}

pub(crate) fn expect_positive(name: impl Display, values: &[f64]) -> Result<(), FormatError> {
    match values.iter().enumerate().find(|&(_, &value)| value <= 0.0) {
        Some((index, &value)) => Err(FormatError::NotPositive { name: name.to_string(), index, value }),
        None => Ok(()),
    }
}
