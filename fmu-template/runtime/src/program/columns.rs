//! From a point to the columns of a graph, and derivatives by the chain rule.

use crate::Encoder;
use std::ops::Range;

/// How the values of a point become columns of a graph.
#[derive(Clone, Debug)]
pub(super) enum Columns {
    /// Each value is a column.
    Same,
    /// Values are encoded.
    Encoded(Encoder),
    /// Each value is a column, except these: start values of states.
    Without(Range<usize>),
}

impl Columns {
    /// Number of columns of a point with `values` values.
    pub(super) fn width(&self, values: usize) -> usize {
        match self {
            Self::Same => values,
            Self::Encoded(encoder) => encoder.width(),
            Self::Without(range) => values - range.len(),
        }
    }

    /// Writes the columns of a point.
    #[inline]
    pub(super) fn write(&self, point: &[f64], columns: &mut [f64]) {
        match self {
            Self::Same => columns.copy_from_slice(point),
            Self::Encoded(encoder) => encoder.encode(point, columns),
            Self::Without(range) => remove(range, point, columns),
        }
    }

    /// Writes first and, unless `rates[1]` is empty, second derivatives of the `columns` along a curve. `rates` are the
    /// derivatives of the point.
    pub(super) fn along_curve(&self, columns: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2]) {
        match self {
            Self::Encoded(encoder) => encoder.along_curve(columns, rates, derivatives),
            Self::Same | Self::Without(_) => {
                let orders = rates.into_iter().zip(derivatives).filter(|(rates, _)| !rates.is_empty());
                orders.for_each(|(rates, derivatives)| self.write(rates, derivatives));
            }
        }
    }

    /// Writes the gradient with respect to the point from that with respect to the `columns`.
    pub(super) fn gradient(&self, columns: &[f64], by_columns: &[f64], by_point: &mut [f64]) {
        match self {
            Self::Same => by_point.copy_from_slice(by_columns),
            Self::Encoded(encoder) => encoder.gradient(columns, by_columns, by_point),
            Self::Without(range) => {
                by_point[..range.start].copy_from_slice(&by_columns[..range.start]);
                by_point[range.clone()].fill(0.0);
                by_point[range.end..].copy_from_slice(&by_columns[range.start..]);
            }
        }
    }
}

/// Copies all values except those of a range.
#[inline]
fn remove(range: &Range<usize>, from: &[f64], to: &mut [f64]) {
    let (before, after) = to.split_at_mut(range.start);
    before.copy_from_slice(&from[..range.start]);
    after.copy_from_slice(&from[range.end..]);
}
