//! The domain of validity: the box of training ranges, the values of nominal inputs, and in the box what is near the training data.

use crate::{
    Cover, Encoding, Input, Role, State,
    cover::{Cubes, Nearest},
    encoding::nearest,
};

/// How far outside the domain a point may be and still count as inside: hosts add up step sizes and convert units.
pub const TOLERANCE: f64 = 1e-9;

/// Policy outside the training ranges: the values of [`BuiltIn::DomainPolicy`](crate::BuiltIn::DomainPolicy).
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

/// Where every input was trained: in a range, or, if it is nominal, at some values. A periodic one is valid everywhere. Where the data are
/// known that it was trained on, a point is valid near those only ([`Cover`]; of a discrete-time model [`Support`](crate::Support)).
#[derive(Clone, Debug, PartialEq)]
pub struct Domain {
    inputs: Vec<Valid>,
    data: Option<Cubes>,
    /// Column of a point with its distance from the [`Support`](crate::Support) of the training.
    distance: Option<usize>,
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

impl Valid {
    const EVERYWHERE: Self = Self::Range(Range::EVERYWHERE);

    fn of_input(input: &Input) -> Self {
        match &input.encoding {
            _ if input.role == Role::Start => Self::EVERYWHERE,
            Encoding::Plain => Self::Range(Range::new(input.min, input.max)),
            Encoding::Nominal(values) => Self::Values { values: values.clone(), scale: input.max - input.min },
            Encoding::Periodic => Self::EVERYWHERE,
        }
    }

    fn of_state(state: &State) -> Self {
        state.range.map_or(Self::EVERYWHERE, |[min, max]| Self::Range(Range::new(min, max)))
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Range {
    min: f64,
    max: f64,
    /// Unit of distances: the width, or the magnitude for a column that was constant in training.
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
    /// neither have columns after them, which are what a discrete-time model remembers.
    pub fn new(inputs: &[Input], states: &[State]) -> Self {
        Self {
            inputs: inputs.iter().map(Valid::of_input).chain(states.iter().map(Valid::of_state)).collect(),
            data: None,
            distance: None,
        }
    }

    /// With a column of points that has their distance from the support of the training.
    pub(crate) fn with_distance(self, column: usize) -> Self {
        Self { distance: Some(column), ..self }
    }

    /// Restricts the domain to the neighborhood of the training data.
    #[must_use]
    pub fn near(self, cover: &Cover, inputs: &[Input]) -> Self {
        Self { data: Some(Cubes::new(cover, inputs)), ..self }
    }

    /// Returns true if more is known of the training data than their ranges.
    pub fn knows_data(&self) -> bool {
        self.data.is_some() || self.distance.is_some()
    }

    /// Distance from the support of the training, which a point contains.
    #[inline]
    fn own_distance(&self, point: &[f64]) -> f64 {
        self.distance.and_then(|column| point.get(column)).map_or(0.0, |distance| distance.max(0.0))
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
    /// width of the input's range; of a nominal one that from the nearest value. Where the data are known, at least that from what is near
    /// them. Finite for every finite point: it is an output of the FMU; infinite where a number is NaN. `guess`: see [`Domain::is_near_data`].
    pub fn distance(&self, inputs: &[f64], guess: usize) -> f64 {
        if inputs.iter().any(|value| value.is_nan()) {
            return f64::INFINITY;
        }
        let of_data = self.far(inputs, guess).map_or(0.0, |nearest| nearest.distance).max(self.own_distance(inputs));
        let of_columns = inputs.iter().enumerate().map(|(column, value)| self.column_distance(column, *value));
        of_columns.fold(of_data, f64::max).min(f64::MAX)
    }

    /// Distance of a value from the range of its column.
    #[inline]
    fn column_distance(&self, column: usize, value: f64) -> f64 {
        self.range(column, value).distance(value)
    }

    /// The data that are nearest to a point, if it is not among them.
    fn far(&self, inputs: &[f64], guess: usize) -> Option<Nearest> {
        self.data.as_ref().map(|data| data.nearest(inputs, guess, 0.0)).filter(|nearest| nearest.distance > 0.0)
    }

    /// Returns true if training data are near a point, up to [`TOLERANCE`], or if nothing is known about the data.
    /// Stores the position of the data in `guess`: the search for a nearby point may begin there, and the result does
    /// not depend on it. Does not allocate.
    #[inline]
    pub fn is_near_data(&self, inputs: &[f64], guess: &mut usize) -> bool {
        if self.own_distance(inputs) > TOLERANCE {
            return false;
        }
        let Some(data) = &self.data else { return true };
        let Nearest { centre, distance, .. } = data.nearest(inputs, *guess, TOLERANCE);
        *guess = centre;
        distance <= TOLERANCE
    }

    /// Returns true if the value of a column is in its range or equal to one of its nominal values, up to
    /// [`TOLERANCE`].
    #[inline]
    pub fn contains(&self, column: usize, value: f64) -> bool {
        let Range { lowest, highest, .. } = self.range(column, value);
        lowest <= value && value <= highest
    }

    /// Returns true if the value of every column is in its range or equal to one of its nominal values, up to
    /// [`TOLERANCE`].
    pub fn is_in_ranges(&self, inputs: &[f64]) -> bool {
        let mut columns = inputs.iter().enumerate().take(self.columns());
        columns.all(|(column, &value)| self.contains(column, value))
    }

    /// Number of columns that may have ranges. Columns after them, which are the memory of samples, have none.
    pub fn columns(&self) -> usize {
        self.inputs.len()
    }

    /// Returns true if a point is in the domain: in the ranges and near the data. `guess`: see
    /// [`Domain::is_near_data`].
    pub fn contains_point(&self, inputs: &[f64], mut guess: usize) -> bool {
        self.is_in_ranges(inputs) && self.is_near_data(inputs, &mut guess)
    }

    /// Valid value that is nearest.
    #[inline]
    pub fn clamp(&self, column: usize, value: f64) -> f64 {
        let Range { min, max, .. } = self.range(column, value);
        value.clamp(min, max)
    }

    /// The only derivative of [`Domain::distance`] that is not zero: its column and value. None inside the domain, and where
    /// earlier samples determine the distance.
    pub fn distance_derivative(&self, inputs: &[f64]) -> Option<(usize, f64)> {
        let (column, value) = inputs
            .iter()
            .enumerate()
            .max_by(|a, b| self.column_distance(a.0, *a.1).total_cmp(&self.column_distance(b.0, *b.1)))?;
        let farthest = self.column_distance(column, *value);
        if self.own_distance(inputs) > farthest {
            return None;
        }
        if let Some(data) = self.far(inputs, 0).filter(|data| data.distance > farthest) {
            return Some(data.slope);
        }
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
    use crate::{Metadata, Surrogate, example};

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
            let found = domain().distance(&point, 0);
            assert!((found - expected).abs() < 1e-12, "{point:?}: {found}");
        }
        assert!(domain().contains(2, 2.0 + 1e-10) && !domain().contains(2, 2.0 + 1e-8));
        assert!(
            domain().contains_point(&[0.15, 2.0, 2.0 + 1e-10], 0) && !domain().contains_point(&[0.15, 2.0, -1e-8], 0)
        );
        assert!(!domain().contains(2, f64::NAN));
        assert_eq!(domain().distance(&[-f64::MAX, 2.0, 1.0], 0), f64::MAX);
        for column in 0..3 {
            let mut point = [0.0, 2.0, 1.0];
            point[column] = f64::NAN;
            assert_eq!(domain().distance(&point, 0), f64::INFINITY);
            assert!(!domain().contains_point(&point, 0));
        }
    }

    #[test]
    fn the_derivative_is_the_difference_quotient() {
        for point in [[0.15, 2.0, 1.0], [0.25, 2.0, 1.0], [0.15, -5.0, 1.0], [0.25, -5.0, 2.2], [0.2, 5.0, 4.0]] {
            let derivative = domain().distance_derivative(&point);
            for column in 0..3 {
                let mut moved = point;
                moved[column] += 1e-6;
                let quotient = (domain().distance(&moved, 0) - domain().distance(&point, 0)) / 1e-6;
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
            assert!((domain.distance(&point, 0) - distance).abs() < 1e-12, "{length}: {}", domain.distance(&point, 0));
            assert_eq!(domain.contains_point(&point, 0), distance <= TOLERANCE, "{length}");
            assert_eq!(domain.clamp(0, length), nearest);
            let found = domain.distance_derivative(&point).map(|(input, slope)| (input, slope.round()));
            assert_eq!(found, slope.map(|slope| (0, slope)), "{length}");
        }
        assert_eq!((domain.clamp(1, -1e300), domain.contains(1, f64::MIN)), (-1e300, true));
        assert!(!domain.contains(0, f64::NAN) && !domain.contains(1, f64::NAN));
        assert_eq!(domain.distance(&[-f64::MAX, 0.0, 1.0], 0), f64::MAX);
    }

    #[test]
    fn where_the_data_are_known_only_what_is_near_them_is_inside() {
        let surrogate = example::with_cover(&example::surrogate());
        let domain = Domain::of(&surrogate);
        let mut guess = 0;
        for (point, distance, slope) in [
            ([0.12, 1.0, 1.0], 0.0, None),
            ([0.18, 4.0, 1.0], 0.0, None),
            ([0.15 + 5e-11, 2.5, 1.0], 0.0, None),
            ([0.12, 4.5, 1.0], 0.3, Some((0, -10.0))),
            ([0.19, 1.5, 1.0], 0.2, Some((1, -0.2))),
            // farther from the ranges than from the data
            ([0.16, 4.0, 2.8], 0.4, Some((2, 0.5))),
            ([0.26, 0.5, 1.0], 0.6, Some((0, 10.0))),
        ] {
            let found = domain.distance(&point, 0);
            assert!((found - distance).abs() < 1e-6, "{point:?}: {found}");
            let is_inside = distance == 0.0;
            assert_eq!(domain.contains_point(&point, 0), is_inside, "{point:?}");
            let is_in_ranges = point[0] <= 0.2 && point[2] <= 2.0;
            assert_eq!(domain.is_in_ranges(&point), is_in_ranges, "{point:?}");
            assert_eq!(domain.is_near_data(&point, &mut guess), is_inside || point[2] > 2.0, "{point:?}");
            let found =
                domain.distance_derivative(&point).map(|(column, slope)| (column, (10.0 * slope).round() / 10.0));
            assert_eq!(found, slope, "{point:?}");
        }
        assert_eq!(domain.distance(&[-f64::MAX, f64::MAX, 1.0], 0), f64::MAX);
        let file = surrogate.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&file).unwrap().metadata().cover, surrogate.metadata().cover);
    }

    #[test]
    fn a_cover_that_does_not_fit_the_inputs_is_refused() {
        let surrogate = example::surrogate();
        let whole = Cover { columns: vec![0, 1], radius: 0.1, centres: vec![0.5, 0.5] };
        for (change, expected) in [
            ((|cover| cover.columns = vec![]) as fn(&mut Cover), "columns"),
            (|cover| cover.columns = vec![1, 0], "columns"),
            (|cover| cover.columns = vec![0, 2], "columns"), // the time
            (|cover| cover.columns = vec![0, 9], "columns"),
            (|cover| cover.radius = 0.0, "radius"),
            (|cover| cover.radius = f64::INFINITY, "radius"),
            (|cover| cover.centres = vec![], "centre"),
            (|cover| cover.centres = vec![0.5], "centre"),
            (|cover| cover.centres = vec![0.5, f32::NAN], "centre"),
        ] {
            let mut cover = whole.clone();
            change(&mut cover);
            let metadata = Metadata { cover: Some(cover), ..surrogate.metadata().clone() };
            let error = Surrogate::new(metadata, surrogate.program().clone()).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
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
        let domain = Domain::new(&[input(-4.0), input(0.0)], &[]);
        assert_eq!(domain.distance(&[-4.0, 0.0], 0), 0.0);
        assert_eq!(domain.distance(&[-2.0, 0.0], 0), 0.5);
        assert_eq!(domain.distance(&[-4.0, -0.25], 0), 0.25);
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
