//! Encodings: from the inputs' values to the columns of the network.

use crate::{Encoding, FormatError, Input, Role, exact};
use std::f64::consts::TAU;

impl Input {
    /// The values of a nominal input.
    pub fn nominal_values(&self) -> Option<&[f64]> {
        match &self.encoding {
            Encoding::Nominal(values) => Some(values),
            Encoding::Plain | Encoding::Periodic => None,
        }
    }

    /// Description of the valid values: for instance `the training range from 0 to 2`.
    pub fn valid(&self) -> String {
        match &self.encoding {
            Encoding::Plain => format!("the training range from {} to {}", exact(self.min), exact(self.max)),
            Encoding::Nominal(values) => format!("the trained values {}", list(values)),
            Encoding::Periodic => "all numbers".into(),
        }
    }

    /// Makes sure that the encoding fits role, range and start.
    pub(crate) fn check_encoding(&self) -> Result<(), FormatError> {
        let Self { name, role, min, max, start, encoding, .. } = self;
        let problem = match encoding {
            Encoding::Plain => None,
            _ if *role == Role::Time => Some("the time is its own column"),
            Encoding::Periodic => (min == max).then_some("a period is longer than zero"),
            Encoding::Nominal(values) => {
                let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
                let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let repeated = (1..values.len()).any(|index| values[..index].contains(&values[index]));
                if values.len() < 2 || repeated || !values.iter().all(|value| value.is_finite()) {
                    Some("nominal values are at least two, finite and distinct")
                } else if (smallest, largest) != (*min, *max) {
                    Some("the range is from the smallest to the largest nominal value")
                } else {
                    (!values.contains(start)).then_some("the start is one of the nominal values")
                }
            }
        };
        problem.map_or(Ok(()), |expected| Err(FormatError::Encoding { name: name.clone(), expected }))
    }
}

/// Numbers, separated by commas.
fn list(values: &[f64]) -> String {
    values.iter().copied().map(exact).collect::<Vec<_>>().join(", ")
}

/// Position of the value that is nearest to `x`; of two the first.
pub(crate) fn nearest(values: &[f64], x: f64) -> usize {
    let mut best = 0;
    for (index, &value) in values.iter().enumerate() {
        // by the middle between the two: far away, distances are equal up to rounding
        let middle = values[best] + 0.5 * (value - values[best]);
        let is_nearer = if value > values[best] { x > middle } else { x < middle };
        if is_nearer {
            best = index;
        }
    }
    best
}

/// The encodings of all inputs, with the ranges they refer to.
#[derive(Clone, Debug)]
pub struct Encoder {
    inputs: Vec<Encoded>,
    width: usize,
}

#[derive(Clone, Debug)]
enum Encoded {
    Plain,
    Nominal(Vec<f64>),
    Periodic { min: f64, period: f64 },
}

impl Encoder {
    /// For inputs with these encodings and ranges (`min`, `max`).
    pub fn new<'a>(inputs: impl Iterator<Item = (&'a Encoding, f64, f64)> + Clone) -> Self {
        let width = inputs.clone().map(|(encoding, ..)| encoding.width()).sum();
        let inputs = inputs.map(|(encoding, min, max)| match encoding {
            Encoding::Plain => Encoded::Plain,
            Encoding::Nominal(values) => Encoded::Nominal(values.clone()),
            Encoding::Periodic => Encoded::Periodic { min, period: max - min },
        });
        Self { inputs: inputs.collect(), width }
    }

    /// For the inputs of a surrogate.
    pub fn of(inputs: &[Input]) -> Self {
        Self::new(inputs.iter().map(|input| (&input.encoding, input.min, input.max)))
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns true if every column is the value itself.
    pub fn is_plain(&self) -> bool {
        self.inputs.iter().all(|input| matches!(input, Encoded::Plain))
    }

    /// Columns of one value per input. All columns of a NaN are NaN.
    ///
    /// # Panics
    /// If the lengths are not those of inputs and columns.
    pub fn encode(&self, inputs: &[f64], columns: &mut [f64]) {
        self.for_each(inputs, columns, |encoded, x, columns| match encoded {
            Encoded::Plain => columns[0] = x,
            Encoded::Nominal(values) => {
                let hot = nearest(values, x);
                for (index, column) in columns.iter_mut().enumerate() {
                    *column = if x.is_nan() { x } else { f64::from(u8::from(index == hot)) };
                }
            }
            Encoded::Periodic { min, period } => {
                // whole turns are taken off first, so that a period later the columns are the very same
                let turns = (x - min) / period;
                let (sine, cosine) = (TAU * (turns - turns.floor())).sin_cos();
                columns.copy_from_slice(&[sine, cosine]);
            }
        });
    }

    /// First and, unless `rates[1]` is empty, second derivatives of the `columns` along a curve with the derivatives
    /// `rates` of the inputs.
    pub(crate) fn along_curve(&self, columns: &[f64], rates: [&[f64]; 2], derivatives: [&mut [f64]; 2]) {
        let [first, second] = derivatives;
        let mut begin = 0;
        for (index, encoded) in self.inputs.iter().enumerate() {
            let (rate, acceleration) = (rates[0][index], rates[1].get(index).copied().unwrap_or(0.0));
            let own = begin..begin + encoded.width();
            begin = own.end;
            match encoded {
                Encoded::Plain => (first[own.start], second[own.start]) = (rate, acceleration),
                Encoded::Nominal(_) => {
                    first[own.clone()].fill(0.0);
                    second[own].fill(0.0);
                }
                Encoded::Periodic { period, .. } => {
                    let (sine, cosine) = (columns[own.start], columns[own.start + 1]);
                    let (rate, acceleration) = (TAU / period * rate, TAU / period * acceleration);
                    first[own.clone()].copy_from_slice(&[cosine * rate, -sine * rate]);
                    let bent =
                        [cosine * acceleration - sine * rate * rate, -sine * acceleration - cosine * rate * rate];
                    second[own].copy_from_slice(&bent);
                }
            }
        }
    }

    /// Derivatives by the inputs from those by the `columns`.
    pub(crate) fn gradient(&self, columns: &[f64], by_columns: &[f64], by_inputs: &mut [f64]) {
        let mut begin = 0;
        for (encoded, by_input) in self.inputs.iter().zip(by_inputs) {
            *by_input = match encoded {
                Encoded::Plain => by_columns[begin],
                Encoded::Nominal(_) => 0.0,
                Encoded::Periodic { period, .. } => {
                    let (sine, cosine) = (columns[begin], columns[begin + 1]);
                    TAU / period * (cosine * by_columns[begin] - sine * by_columns[begin + 1])
                }
            };
            begin += encoded.width();
        }
    }

    /// The first column of an input.
    pub fn first_column(&self, input: usize) -> usize {
        self.inputs[..input].iter().map(Encoded::width).sum()
    }

    fn for_each(&self, inputs: &[f64], columns: &mut [f64], mut each: impl FnMut(&Encoded, f64, &mut [f64])) {
        assert_eq!((inputs.len(), columns.len()), (self.inputs.len(), self.width), "number of inputs and columns");
        let mut rest = columns;
        for (encoded, &x) in self.inputs.iter().zip(inputs) {
            let (own, others) = rest.split_at_mut(encoded.width());
            each(encoded, x, own);
            rest = others;
        }
    }
}

impl Encoded {
    fn width(&self) -> usize {
        match self {
            Self::Plain => 1,
            Self::Nominal(values) => values.len(),
            Self::Periodic { .. } => 2,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_become_their_columns() {
        let nominal = Encoding::Nominal(vec![17.0, 12.0, 24.0]);
        let encoder = Encoder::new([(&Encoding::Plain, 0.0, 1.0), (&nominal, 12.0, 24.0)].into_iter());
        let columns = |x: f64| {
            let mut columns = [0.0; 4];
            encoder.encode(&[0.3, x], &mut columns);
            columns
        };
        assert_eq!((encoder.width(), encoder.is_plain(), encoder.first_column(1)), (4, false, 1));
        for (x, hot) in [(17.0, 1), (12.0, 2), (24.0, 3), (-1e300, 2), (14.4, 2), (14.5, 1), (1e9, 3)] {
            let mut expected = [0.3, 0.0, 0.0, 0.0];
            expected[hot] = 1.0;
            assert_eq!(columns(x), expected, "{x}");
        }
        assert!(columns(f64::NAN)[1..].iter().all(|column| column.is_nan()));
    }

    #[test]
    fn a_periodic_value_is_the_same_any_number_of_periods_later() {
        let encoder = Encoder::new([(&Encoding::Periodic, -1.0, 3.0)].into_iter());
        let columns = |x: f64| {
            let mut columns = [0.0; 2];
            encoder.encode(&[x], &mut columns);
            columns
        };
        for x in [-1.0, -0.25, 0.0, 1.0, 1.5, 2.75] {
            let angle = TAU * (x + 1.0) / 4.0;
            let found = columns(x);
            assert!((found[0] - angle.sin()).abs() < 1e-15 && (found[1] - angle.cos()).abs() < 1e-15, "{x}");
            assert_eq!(columns(x + 4.0 * 12345.0), found);
            assert_eq!(columns(x - 4.0), found);
        }
        assert!(columns(f64::NAN)[0].is_nan() && columns(f64::INFINITY)[1].is_nan());
    }
}
