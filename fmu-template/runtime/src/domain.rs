//! The domain of validity: the box of training ranges.

use crate::Input;

/// How far outside the domain a point may be and still count as inside: hosts add up step sizes and convert units.
pub const TOLERANCE: f64 = 1e-9;

/// The training range of every input column.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    ranges: Vec<Range>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    min: f64,
    max: f64,
    /// What distances are relative to: the width, but for a column that was constant in training its magnitude.
    scale: f64,
    /// `min` and `max` with the tolerance, for a comparison that is cheap enough for every step.
    lowest: f64,
    highest: f64,
}

impl Range {
    fn new(min: f64, max: f64) -> Self {
        let scale = [max - min, max.abs()].into_iter().find(|&scale| scale > 0.0).unwrap_or(1.0);
        Self { min, max, scale, lowest: min - TOLERANCE * scale, highest: max + TOLERANCE * scale }
    }

    #[inline]
    fn distance(self, value: f64) -> f64 {
        ((self.min - value) / self.scale).max((value - self.max) / self.scale).max(0.0)
    }
}

impl Domain {
    /// The ranges of these columns.
    pub fn new(inputs: &[Input]) -> Self {
        Self { ranges: inputs.iter().map(|input| Range::new(input.min, input.max)).collect() }
    }

    /// Distance of a point from the domain, zero inside: the largest of its columns' distances, each relative to the
    /// width of the column's range.
    pub fn distance(&self, inputs: &[f64]) -> f64 {
        self.ranges.iter().zip(inputs).map(|(range, &value)| range.distance(value)).fold(0.0, f64::max)
    }

    /// Whether a column's value is in its range, up to [`TOLERANCE`].
    #[inline]
    pub fn contains(&self, column: usize, value: f64) -> bool {
        let Range { lowest, highest, .. } = self.ranges[column];
        lowest <= value && value <= highest
    }

    /// Whether every column's value is in its range, up to [`TOLERANCE`].
    pub fn contains_point(&self, inputs: &[f64]) -> bool {
        inputs.iter().enumerate().all(|(column, &value)| self.contains(column, value))
    }

    /// The value in the column's range that is nearest.
    #[inline]
    pub fn clamp(&self, column: usize, value: f64) -> f64 {
        let Range { min, max, .. } = self.ranges[column];
        value.clamp(min, max)
    }

    /// The only derivative of [`Domain::distance`] that is not zero: its column and value. None inside the domain.
    pub fn distance_derivative(&self, inputs: &[f64]) -> Option<(usize, f64)> {
        let distance = |&(column, value): &(usize, &f64)| self.ranges[column].distance(*value);
        let (column, value) = inputs.iter().enumerate().max_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let Range { min, max, scale, .. } = self.ranges[column];
        match value {
            value if *value > max => Some((column, 1.0 / scale)),
            value if *value < min => Some((column, -1.0 / scale)),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::example;

    fn domain() -> Domain {
        Domain::new(example::surrogate().inputs()) // 0.1 to 0.2, 0 to 5, 0 to 2
    }

    #[test]
    fn the_distance_is_that_of_the_worst_column() {
        for (point, expected) in [
            ([0.15, 2.0, 1.0], 0.0),
            ([0.1, 0.0, 0.0], 0.0),
            ([0.2, 5.0, 2.0], 0.0),
            ([0.25, 2.0, 1.0], 0.5),
            ([0.15, -5.0, 1.0], 1.0),
            ([0.25, -5.0, 2.2], 1.0),
            ([0.15, 2.0, 2.0 + 2e-10], 1e-10),
        ] {
            let found = domain().distance(&point);
            assert!((found - expected).abs() < 1e-12, "{point:?}: {found}");
        }
        assert!(domain().contains(2, 2.0 + 1e-10) && !domain().contains(2, 2.0 + 1e-8));
        assert!(domain().contains_point(&[0.15, 2.0, 2.0 + 1e-10]) && !domain().contains_point(&[0.15, 2.0, -1e-8]));
        assert!(!domain().contains(2, f64::NAN));
    }

    #[test]
    fn the_derivative_is_the_difference_quotient() {
        for point in [[0.15, 2.0, 1.0], [0.25, 2.0, 1.0], [0.15, -5.0, 1.0], [0.25, -5.0, 2.2], [0.2, 5.0, 4.0]] {
            let derivative = domain().distance_derivative(&point);
            for column in 0..3 {
                let mut moved = point;
                moved[column] += 1e-6;
                let quotient = (domain().distance(&moved) - domain().distance(&point)) / 1e-6;
                let expected = derivative.filter(|(at, _)| *at == column).map_or(0.0, |(_, slope)| slope);
                assert!((quotient - expected).abs() < 1e-6, "{point:?} {column}: {quotient} {expected}");
            }
        }
    }

    #[test]
    fn values_are_clamped_to_the_range() {
        assert_eq!([0.0, 0.15, 0.3].map(|value| domain().clamp(0, value)), [0.1, 0.15, 0.2]);
    }

    #[test]
    fn a_column_that_was_constant_is_measured_by_its_magnitude() {
        let input = |value: f64| {
            let mut input = example::surrogate().inputs()[0].clone();
            (input.min, input.max, input.start) = (value, value, value);
            input
        };
        let domain = Domain::new(&[input(-4.0), input(0.0)]);
        assert_eq!(domain.distance(&[-4.0, 0.0]), 0.0);
        assert_eq!(domain.distance(&[-2.0, 0.0]), 0.5);
        assert_eq!(domain.distance(&[-4.0, -0.25]), 0.25);
    }
}
