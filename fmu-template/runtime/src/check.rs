//! Checks of numbers and shapes.

use crate::FormatError;
use std::fmt::Display;

pub(crate) fn expect_shape(name: impl Display, found: &[usize], expected: &[usize]) -> Result<(), FormatError> {
    if found == expected { Ok(()) } else { Err(wrong_shape(&name, found, expected)) }
}

/// Refuses the element of a tensor at `index` unless it is below a limit.
#[inline(never)]
pub(crate) fn expect_below(name: &dyn Display, index: usize, found: usize, limit: usize) -> Result<(), FormatError> {
    if found < limit {
        return Ok(());
    }
    Err(FormatError::Index { name: name.to_string(), index, found: found as u64, limit: limit as u64 })
}

pub(crate) fn expect_finite(name: impl Display, values: impl Iterator<Item = f64>) -> Result<(), FormatError> {
    match values.enumerate().find(|(_, value)| !value.is_finite()) {
        Some((index, value)) => Err(not_finite(&name, index, value)),
        None => Ok(()),
    }
}

pub(crate) fn expect_positive(name: impl Display, values: &[f64]) -> Result<(), FormatError> {
    match values.iter().position(|&value| value <= 0.0) {
        Some(index) => Err(not_positive(&name, index, values[index])),
        None => Ok(()),
    }
}

// errors are made in one place each: in a checking function, for every type of name, they would be most of it

#[cold]
#[inline(never)]
fn wrong_shape(name: &dyn Display, found: &[usize], expected: &[usize]) -> FormatError {
    FormatError::Shape { name: name.to_string(), found: found.into(), expected: expected.into() }
}

#[cold]
#[inline(never)]
fn not_finite(name: &dyn Display, index: usize, value: f64) -> FormatError {
    FormatError::NotFinite { name: name.to_string(), index, value }
}

#[cold]
#[inline(never)]
fn not_positive(name: &dyn Display, index: usize, value: f64) -> FormatError {
    FormatError::NotPositive { name: name.to_string(), index, value }
}
