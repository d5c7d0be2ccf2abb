//! Checks of numbers and shapes.

use crate::FormatError;
use std::fmt::Display;

pub(crate) fn expect_shape(name: impl Display, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.to_string(), found: found.into(), expected: expected.into() })
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
