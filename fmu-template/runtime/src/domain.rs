//! The domain of validity: the box of training ranges, and the values of nominal inputs.

use crate::{Encoding, Input, Role, State, encoding::nearest};

/// How far outside the domain a point may be and still count as inside: hosts add up step sizes and convert units.
pub const TOLERANCE: f64 = 1e-9;

/// What to do outside the training ranges: the values of [`BuiltIn::DomainPolicy`](crate::BuiltIn::DomainPolicy).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DomainPolicy {
    /// Compute anyway and warn once a run for each variable.
    #[default]
    Warn,
    /// Compute with inputs, parameters and time clamped to their ranges.
    Clamp,
    /// Refuse to leave the ranges, and to change inputs or parameters during a run.
    Error,
}

impl DomainPolicy {
    const ALL: [Self; 3] = [Self::Warn, Self::Clamp, Self::Error];

    /// The policy whose `as i32` this is.
    pub fn from_number(number: i32) -> Option<Self> {
        usize::try_from(number).ok().and_then(|index| Self::ALL.get(index)).copied()
    }
}

/// Where every input was trained: in a range, or, if it is nominal, at some values. A periodic one is valid everywhere.
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    inputs: Vec<Valid>,
}

#[derive(Clone, Debug, PartialEq)]
enum Valid {
    Range(Range),
    /// Distances from them are relative to `scale`.
    Values {
        values: Vec<f64>,
        scale: f64,
    },
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
    const EVERYWHERE: Self = Self {
        min: f64::NEG_INFINITY,
        max: f64::INFINITY,
        scale: 1.0,
        lowest: f64::NEG_INFINITY,
        highest: f64::INFINITY,
    };

    fn new(min: f64, max: f64) -> Self {
        let scale = [max - min, max.abs()].into_iter().find(|&scale| scale > 0.0).unwrap_or(1.0);
        Self::relative_to(scale, min, max)
    }

    #[inline]
    fn relative_to(scale: f64, min: f64, max: f64) -> Self {
        Self { min, max, scale, lowest: min - TOLERANCE * scale, highest: max + TOLERANCE * scale }
    }

    #[inline]
    fn distance(self, value: f64) -> f64 {
        ((self.min - value) / self.scale).max((value - self.max) / self.scale).max(0.0)
    }
}

impl Domain {
    /// The ranges of these inputs and, after them, of these states. The value of a state at the start has none, as the state has one;
    /// neither have columns after them, which are what a discrete model remembers.
    pub fn new(inputs: &[Input], states: &[State]) -> Self {
        let everywhere = || Valid::Range(Range::EVERYWHERE);
        let of_state = |state: &State| match state.range {
            Some([min, max]) => Valid::Range(Range::new(min, max)),
            None => everywhere(),
        };
        let valid = |input: &Input| match &input.encoding {
            _ if input.role == Role::Start => everywhere(),
            Encoding::Plain => Valid::Range(Range::new(input.min, input.max)),
            Encoding::Nominal(values) => Valid::Values { values: values.clone(), scale: input.max - input.min },
            Encoding::Periodic => everywhere(),
        };
        Self { inputs: inputs.iter().map(valid).chain(states.iter().map(of_state)).collect() }
    }

    /// The range that counts for a value: of a nominal input the one that holds the nearest value only.
    #[inline]
    fn range(&self, input: usize, value: f64) -> Range {
        match self.inputs.get(input) {
            None => Range::EVERYWHERE,
            Some(Valid::Range(range)) => *range,
            Some(Valid::Values { values, scale }) => {
                let nearest = values[nearest(values, value)];
                Range::relative_to(*scale, nearest, nearest)
            }
        }
    }

    /// Distance of a point from the domain, zero inside: the largest of its inputs' distances, each relative to the
    /// width of the input's range; of a nominal one that from the nearest value. Finite for every finite point: it is an output of the FMU.
    pub fn distance(&self, inputs: &[f64]) -> f64 {
        let distance = |(input, &value): (usize, &f64)| self.range(input, value).distance(value);
        inputs.iter().enumerate().map(distance).fold(0.0, f64::max).min(f64::MAX)
    }

    /// Whether an input's value is in its range or one of its values, up to [`TOLERANCE`].
    #[inline]
    pub fn contains(&self, column: usize, value: f64) -> bool {
        let Range { lowest, highest, .. } = self.range(column, value);
        lowest <= value && value <= highest
    }

    /// Whether every input's value is in its range or one of its values, up to [`TOLERANCE`].
    pub fn contains_point(&self, inputs: &[f64]) -> bool {
        inputs.iter().enumerate().all(|(column, &value)| self.contains(column, value))
    }

    /// The valid value that is nearest.
    #[inline]
    pub fn clamp(&self, column: usize, value: f64) -> f64 {
        let Range { min, max, .. } = self.range(column, value);
        value.clamp(min, max)
    }

    /// The only derivative of [`Domain::distance`] that is not zero: its column and value. None inside the domain.
    pub fn distance_derivative(&self, inputs: &[f64]) -> Option<(usize, f64)> {
        let distance = |&(column, value): &(usize, &f64)| self.range(column, *value).distance(*value);
        let (column, value) = inputs.iter().enumerate().max_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let Range { min, max, scale, .. } = self.range(column, *value);
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
        Domain::new(example::surrogate().inputs(), &[]) // 0.1 to 0.2, 0 to 5, 0 to 2
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
        assert_eq!(domain().distance(&[-f64::MAX, 2.0, 1.0]), f64::MAX);
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
    fn a_nominal_input_is_inside_at_its_values_only_and_a_periodic_one_everywhere() {
        // length is one of 0.14, 0.1 and 0.2, speed is periodic
        let domain = Domain::new(example::encoded(&example::surrogate()).inputs(), &[]);
        for (length, distance, nearest, slope) in [
            (0.14, 0.0, 0.14, None),
            (0.2 + 5e-11, 5e-10, 0.2, Some(10.0)),
            (0.15, 0.1, 0.14, Some(10.0)),
            (0.18, 0.2, 0.2, Some(-10.0)),
            (0.0, 1.0, 0.1, Some(-10.0)),
            (0.3, 1.0, 0.2, Some(10.0)),
        ] {
            let point = [length, 1e6, 1.0];
            assert!((domain.distance(&point) - distance).abs() < 1e-12, "{length}: {}", domain.distance(&point));
            assert_eq!(domain.contains_point(&point), distance <= TOLERANCE, "{length}");
            assert_eq!(domain.clamp(0, length), nearest);
            let found = domain.distance_derivative(&point).map(|(input, slope)| (input, slope.round()));
            assert_eq!(found, slope.map(|slope| (0, slope)), "{length}");
        }
        assert_eq!((domain.clamp(1, -1e300), domain.contains(1, f64::MIN)), (-1e300, true));
        assert!(!domain.contains(0, f64::NAN) && !domain.contains(1, f64::NAN));
        assert_eq!(domain.distance(&[-f64::MAX, 0.0, 1.0]), f64::MAX);
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
        let domain = Domain::new(&[input(-4.0), input(0.0)], &[]);
        assert_eq!(domain.distance(&[-4.0, 0.0]), 0.0);
        assert_eq!(domain.distance(&[-2.0, 0.0]), 0.5);
        assert_eq!(domain.distance(&[-4.0, -0.25]), 0.25);
    }

    #[test]
    fn the_number_of_a_policy_is_its_position() {
        for (number, policy) in (0..).zip(DomainPolicy::ALL) {
            assert_eq!(policy as i32, number);
            assert_eq!(DomainPolicy::from_number(number), Some(policy));
        }
        assert_eq!([-1, 3, i32::MIN, i32::MAX].map(DomainPolicy::from_number), [None; 4]);
    }
}
