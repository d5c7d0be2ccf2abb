//! Checks of numbers and shapes.

use crate::FormatError;

pub(crate) fn expect_shape(name: &str, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected {
        return Ok(());
    }
    Err(FormatError::Shape { name: name.into(), found: found.into(), expected: expected.into() })
}

pub(crate) fn expect_finite(name: &str, values: impl Iterator<Item = f64>) -> Result<(), FormatError> {
    match values.enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, value)) => Err(FormatError::NotFinite { name: name.into(), index, value }),
        None => Ok(()),
    }
}

pub(crate) fn expect_positive(name: &str, values: &[f64]) -> Result<(), FormatError> {
    match values.iter().enumerate().find(|&(_, &value)| value <= 0.0) {
        Some((index, &value)) => Err(FormatError::NotPositive { name: name.into(), index, value }),
        None => Ok(()),
    }
}
