//! Where a moment lies in a series of networks, one for each instant, and what lies between two of them.

/// The instants, and which input column is the time.
#[derive(Clone, Debug)]
pub(crate) struct Instants {
    instants: Vec<f64>,
    time: usize,
}

/// Between instant `left` and the next one: outputs are `y = (1 - weight) y_left + weight y_right`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Interpolation {
    pub(crate) left: usize,
    pub(crate) weight: f64,
    /// Derivative of the weight with respect to the time.
    pub(crate) slope: f64,
}

/// Working memory, each time for the two instants around the moment.
#[derive(Clone, Debug)]
pub(crate) struct Sides {
    /// The input columns other than the time, and their derivatives.
    pub(crate) point: Vec<f64>,
    pub(crate) rates: [Vec<f64>; 2],
    /// Outputs and their derivatives.
    pub(crate) values: [Vec<f64>; 2],
    pub(crate) first: [Vec<f64>; 2],
    pub(crate) second: [Vec<f64>; 2],
    /// Adjoint derivatives.
    pub(crate) gradient: [Vec<f64>; 2],
}

impl Instants {
    pub(crate) fn new(instants: &[f64], time: usize) -> Self {
        Self { instants: instants.to_vec(), time }
    }

    pub(crate) fn time(&self) -> usize {
        self.time
    }

    /// At an instant, the interval that begins there counts; at the last one, the one that ends there.
    #[inline]
    pub(crate) fn interpolation(&self, time: f64) -> Interpolation {
        let intervals = self.instants.len() - 1;
        let left = self.instants.partition_point(|&instant| instant <= time).clamp(1, intervals) - 1;
        let (begin, end) = (self.instants[left], self.instants[left + 1]);
        // NaN stays NaN
        let weight = ((time - begin) / (end - begin)).clamp(0.0, 1.0);
        let outside = time < self.instants[0] || time > self.instants[intervals];
        Interpolation { left, weight, slope: if outside { 0.0 } else { 1.0 / (end - begin) } }
    }

    /// The columns other than the time.
    #[inline]
    pub(crate) fn others(&self, columns: &[f64], to: &mut [f64]) {
        let from = columns.iter().enumerate().filter(|&(column, _)| column != self.time);
        to.iter_mut().zip(from).for_each(|(to, (_, &from))| *to = from);
    }
}

impl Interpolation {
    /// Between two values; exactly the one or the other at an instant.
    #[inline]
    pub(crate) fn between(&self, left: f64, right: f64) -> f64 {
        (1.0 - self.weight) * left + self.weight * right
    }
}

impl Sides {
    /// For so many columns other than the time.
    pub(crate) fn new(columns: usize, outputs: usize) -> Self {
        let [point, output] = [columns, outputs].map(|length| vec![0.0; length]);
        let both = || [output.clone(), output.clone()];
        Self {
            rates: [point.clone(), point.clone()],
            gradient: [point.clone(), point.clone()],
            point,
            values: both(),
            first: both(),
            second: both(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_is_found_between_its_neighbours_and_outside_at_the_ends() {
        let instants = Instants::new(&[0.0, 0.5, 0.75, 2.0], 1);
        for (time, left, weight, slope) in [
            (-1.0, 0, 0.0, 0.0),
            (0.0, 0, 0.0, 2.0),
            (0.25, 0, 0.5, 2.0),
            (0.5, 1, 0.0, 4.0),
            (0.625, 1, 0.5, 4.0),
            (2.0, 2, 1.0, 0.8),
            (2.5, 2, 1.0, 0.0),
        ] {
            assert_eq!(instants.interpolation(time), Interpolation { left, weight, slope }, "{time}");
        }
        assert!(instants.interpolation(f64::NAN).weight.is_nan());
        let mut others = [0.0; 2];
        instants.others(&[1.0, 9.0, 2.0], &mut others);
        assert_eq!(others, [1.0, 2.0]);
    }
}
