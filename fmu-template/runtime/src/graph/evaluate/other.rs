//! Steps that are not compiled once for each instruction set, so that FMUs stay small: those with few numbers, or whose functions are
//! those of the standard library. Numbers are kept in the precision of the graph, and computed in double precision.

use crate::{
    Jet,
    graph::{Elementwise, Forest, Operation, Step, cell::Cell, products::PreparedProducts, series::Series},
    simd::{Lanes, Real, flat, flat_mut},
};
use std::sync::Arc;

/// A step with what it takes: see [`Step`].
#[derive(Clone, Debug)]
pub(super) enum OtherStep {
    Elementwise {
        of: usize,
        function: Elementwise,
        parameters: Vec<f64>,
    },
    Combine {
        of: [usize; 2],
        operation: Operation,
    },
    Select {
        of: [usize; 3],
    },
    Columns {
        columns: Vec<[u32; 2]>,
    },
    /// `y_i = (x_i - centre_i) factor_i + offset_i`
    Shift {
        of: usize,
        centre: Vec<f64>,
        factor: Vec<f64>,
        offset: Vec<f64>,
    },
    Normalize {
        of: usize,
        epsilon: f64,
    },
    Softmax {
        of: usize,
    },
    Distances {
        of: usize,
        centres: Vec<f64>,
        inverse_lengths: Vec<f64>,
    },
    Forest {
        of: usize,
        forest: Arc<Forest>,
    },
    Products {
        of: usize,
        products: PreparedProducts,
    },
}

impl OtherStep {
    /// # Panics
    /// If the step is one of those that are compiled for each instruction set.
    pub(super) fn new<const WIDTH: usize>(step: &Step) -> Self {
        match step {
            Step::Affine { .. } => unreachable!("products are prepared separately"),
            Step::Call { .. } | Step::Interpolate { .. } | Step::Dictionary { .. } | Step::Motion { .. } => {
                unreachable!("steps with separate working memory")
            }
            Step::Elementwise { of, function, parameters } => {
                Self::Elementwise { of: *of, function: *function, parameters: parameters.clone() }
            }
            Step::Combine { of, operation } => Self::Combine { of: *of, operation: *operation },
            Step::Select { of } => Self::Select { of: *of },
            Step::Columns { columns } => Self::Columns { columns: columns.clone() },
            Step::Standardize { of, mean, scale } => Self::Shift {
                of: *of,
                centre: mean.clone(),
                factor: scale.iter().map(|scale| 1.0 / scale).collect(),
                offset: vec![0.0; mean.len()],
            },
            Step::Rescale { of, mean, scale } => {
                Self::Shift { of: *of, centre: vec![0.0; mean.len()], factor: scale.clone(), offset: mean.clone() }
            }
            Step::Normalize { of, epsilon } => Self::Normalize { of: *of, epsilon: *epsilon },
            Step::Softmax { of } => Self::Softmax { of: *of },
            Step::Distances { of, centres, lengths } => Self::Distances {
                of: *of,
                centres: centres.clone(),
                inverse_lengths: lengths.iter().map(|length| 1.0 / length).collect(),
            },
            Step::Forest { of, forest, .. } => Self::Forest { of: *of, forest: forest.clone() },
            Step::Products { of, products } => {
                Self::Products { of: *of, products: PreparedProducts::new(products, WIDTH) }
            }
        }
    }

    /// Number of values that an evaluation computes; the first `width` are those of the step.
    pub(super) fn numbers(&self, width: usize) -> usize {
        if let Self::Products { products, .. } = self { products.numbers() } else { width }
    }

    /// Computes the value, `width` numbers, from the values before it.
    #[inline(never)]
    pub(super) fn value<T: Real, const WIDTH: usize>(
        &self,
        before: &[Series<T, WIDTH>],
        to: &mut Series<T, WIDTH>,
        width: usize,
    ) {
        if let Some((sign, a, b)) = self.sum(before) {
            return sum(sign, (&a.value, &b.value), &mut to.value);
        }
        self.run::<f64, T, WIDTH>(before, to, width);
    }

    /// The value with its first and second derivative.
    #[inline(never)]
    pub(super) fn series<T: Real, const WIDTH: usize>(
        &self,
        before: &[Series<T, WIDTH>],
        to: &mut Series<T, WIDTH>,
        width: usize,
    ) {
        if let Some((sign, a, b)) = self.sum(before) {
            sum(sign, (&a.value, &b.value), &mut to.value);
            sum(sign, (&a.first, &b.first), &mut to.first);
            return sum(sign, (&a.second, &b.second), &mut to.second);
        }
        self.run::<Jet, T, WIDTH>(before, to, width);
    }

    /// The sign of `b`, `a` and `b` of `a + b` or `a - b`, as residual connections are: computed in whole vectors.
    fn sum<'a, T: Real, const WIDTH: usize>(
        &self,
        before: &'a [Series<T, WIDTH>],
    ) -> Option<(T, &'a Series<T, WIDTH>, &'a Series<T, WIDTH>)> {
        let Self::Combine { of: [a, b], operation } = self else { return None };
        let sign = match operation {
            Operation::Add => T::ONE,
            Operation::Subtract => -T::ONE,
            _ => return None,
        };
        Some((sign, &before[*a], &before[*b]))
    }

    fn run<N: Cell, T: Real, const WIDTH: usize>(
        &self,
        before: &[Series<T, WIDTH>],
        to: &mut Series<T, WIDTH>,
        width: usize,
    ) {
        match self {
            Self::Elementwise { of, function, parameters } => {
                let from = &before[*of];
                let parameters = Parameters::new(*function, parameters, width);
                match function {
                    // of every standardized column
                    Elementwise::Linear => {
                        for i in 0..width {
                            let [factor, offset] = parameters.of(i);
                            (N::load(from, i).scaled(factor) + N::from(offset)).store(to, i);
                        }
                    }
                    // of every centre
                    Elementwise::Gaussian => (0..width).for_each(|i| N::load(from, i).scaled(-0.5).exp().store(to, i)),
                    _ => {
                        for i in 0..width {
                            N::load(from, i).through(|x| function.series(x, parameters.of(i))).store(to, i);
                        }
                    }
                }
            }
            Self::Combine { of: [a, b], operation } => {
                let (a, b) = (&before[*a], &before[*b]);
                (0..width).for_each(|i| combine(*operation, N::load(a, i), N::load(b, i)).store(to, i));
            }
            Self::Select { of } => {
                let [condition, a, b] = of.map(|of| &before[of]);
                let conditions = flat(&condition.value)[..width].iter().enumerate();
                conditions.for_each(|(i, condition)| N::load(if *condition > T::ZERO { a } else { b }, i).store(to, i));
            }
            Self::Columns { columns } => {
                let places = columns.iter().enumerate();
                places.for_each(|(i, [of, column])| N::load(&before[*of as usize], *column as usize).store(to, i));
            }
            Self::Shift { of, centre, factor, offset } => {
                let numbers = centre.iter().zip(factor).zip(offset).enumerate();
                numbers.for_each(|(i, ((centre, factor), offset))| {
                    let difference = N::load(&before[*of], i) - N::from(*centre);
                    (difference.scaled(*factor) + N::from(*offset)).store(to, i);
                });
            }
            Self::Normalize { of, epsilon } => normalize::<N, T, WIDTH>(*epsilon, &before[*of], to, width),
            Self::Softmax { of } => softmax::<N, T, WIDTH>(&before[*of], to, width),
            Self::Distances { of, centres, inverse_lengths } => {
                distances::<N, T, WIDTH>((centres, inverse_lengths), &before[*of], to);
            }
            Self::Forest { of, forest } => {
                to.value.fill(Lanes::ZERO);
                let inputs = &before[*of];
                forest.evaluate(
                    |column| f64::load(inputs, column),
                    |output, more| (f64::load(to, output) + more).store(to, output),
                );
                if N::HAS_DERIVATIVES {
                    to.first.fill(Lanes::ZERO);
                    to.second.fill(Lanes::ZERO);
                }
            }
            Self::Products { of, products } => products.run::<N, T, WIDTH>(&before[*of], to),
        }
    }

    /// Adjoint of the step: adds its contribution to the cotangents of the operands, which are in `second`. `y` is the step's value and
    /// `change` its cotangent. Elements with a cotangent of zero are skipped, since their slopes may be infinite.
    #[inline(never)]
    pub(super) fn adjoint<T: Real, const WIDTH: usize>(
        &self,
        before: &mut [Series<T, WIDTH>],
        y: &[Lanes<T, WIDTH>],
        change: &mut [Lanes<T, WIDTH>],
        width: usize,
    ) {
        if let Self::Products { of, products } = self {
            return products.adjoint(y, change, &mut before[*of].second);
        }
        let change = &*change;
        let changes = (0..width).map(|i| (i, number_at(change, i))).filter(|(_, change)| *change != 0.0);
        match self {
            Self::Elementwise { of, function, parameters } => {
                let parameters = Parameters::new(*function, parameters, width);
                for (i, change) in changes {
                    let [_, slope, _] = function.series(number_at(&before[*of].value, i), parameters.of(i));
                    add_to_cotangent(&mut before[*of], i, slope * change);
                }
            }
            Self::Combine { of: [a, b], operation: Operation::Add } => {
                for of in [*a, *b] {
                    let sums = flat_mut(&mut before[of].second).iter_mut();
                    sums.zip(flat(change)).for_each(|(sum, change)| *sum = *sum + *change);
                }
            }
            Self::Combine { of: [a, b], operation } => {
                for (i, change) in changes {
                    let [of_a, of_b] =
                        slopes(*operation, number_at(&before[*a].value, i), number_at(&before[*b].value, i));
                    add_to_cotangent(&mut before[*a], i, of_a * change);
                    add_to_cotangent(&mut before[*b], i, of_b * change);
                }
            }
            Self::Select { of: [condition, a, b] } => {
                for (i, change) in changes {
                    let chosen = if number_at(&before[*condition].value, i) > 0.0 { a } else { b };
                    add_to_cotangent(&mut before[*chosen], i, change);
                }
            }
            Self::Columns { columns } => {
                for (i, change) in changes {
                    let [of, column] = columns[i];
                    add_to_cotangent(&mut before[of as usize], column as usize, change);
                }
            }
            Self::Shift { of, factor, .. } => {
                changes.for_each(|(i, change)| add_to_cotangent(&mut before[*of], i, factor[i] * change))
            }
            Self::Normalize { of, epsilon } => normalize_adjoint(*epsilon, &mut before[*of], y, change, width),
            Self::Softmax { of } => {
                let along: f64 = (0..width).map(|i| number_at(change, i) * number_at(y, i)).sum();
                (0..width).for_each(|i| {
                    add_to_cotangent(&mut before[*of], i, number_at(y, i) * (number_at(change, i) - along))
                });
            }
            Self::Distances { of, centres, inverse_lengths } => {
                for (i, change) in changes {
                    let centre = &centres[i * inverse_lengths.len()..][..inverse_lengths.len()];
                    for (column, (centre, inverse)) in centre.iter().zip(inverse_lengths).enumerate() {
                        let distance = number_at(&before[*of].value, column) - centre;
                        add_to_cotangent(&mut before[*of], column, 2.0 * change * distance * inverse * inverse);
                    }
                }
            }
            Self::Forest { .. } | Self::Products { .. } => {}
        }
    }
}

#[inline(always)]
fn number_at<T: Real, const WIDTH: usize>(of: &[Lanes<T, WIDTH>], index: usize) -> f64 {
    flat(of)[index].into()
}

#[inline(always)]
fn add_to_cotangent<T: Real, const WIDTH: usize>(of: &mut Series<T, WIDTH>, index: usize, more: f64) {
    let sum = &mut flat_mut(&mut of.second)[index];
    *sum = *sum + T::narrow(more);
}

/// [`OtherStep::adjoint`] of [`normalize`].
fn normalize_adjoint<T: Real, const WIDTH: usize>(
    epsilon: f64,
    of: &mut Series<T, WIDTH>,
    y: &[Lanes<T, WIDTH>],
    change: &[Lanes<T, WIDTH>],
    width: usize,
) {
    let share = 1.0 / width as f64;
    let mean = share * (0..width).map(|i| number_at(&of.value, i)).sum::<f64>();
    let variance = share * (0..width).map(|i| (number_at(&of.value, i) - mean).powi(2)).sum::<f64>();
    let inverse = 1.0 / (variance + epsilon).sqrt();
    let average = share * (0..width).map(|i| number_at(change, i)).sum::<f64>();
    let along = share * (0..width).map(|i| number_at(change, i) * number_at(y, i)).sum::<f64>();
    for i in 0..width {
        add_to_cotangent(of, i, inverse * (number_at(change, i) - average - along * number_at(y, i)));
    }
}

/// Parameters of a function: common to all numbers, or a row of numbers for each parameter.
struct Parameters<'a> {
    all: &'a [f64],
    /// Distance between the parameters of a number; 0 if they are common to all.
    stride: usize,
}

impl<'a> Parameters<'a> {
    fn new(function: Elementwise, all: &'a [f64], width: usize) -> Self {
        Self { all, stride: if all.len() > function.parameters() { width } else { 0 } }
    }

    #[inline(always)]
    fn of(&self, index: usize) -> [f64; 2] {
        let places = if self.stride == 0 { [0, 1] } else { [index, index + self.stride] };
        places.map(|place| self.all.get(place).copied().unwrap_or(0.0))
    }
}

/// `a + sign b`
fn sum<T: Real, const WIDTH: usize>(
    sign: T,
    (a, b): (&[Lanes<T, WIDTH>], &[Lanes<T, WIDTH>]),
    to: &mut [Lanes<T, WIDTH>],
) {
    for (y, (a, b)) in flat_mut(to).iter_mut().zip(flat(a).iter().zip(flat(b))) {
        *y = *a + sign * *b;
    }
}

#[inline]
fn combine<N: Cell>(operation: Operation, a: N, b: N) -> N {
    match operation {
        Operation::Add => a + b,
        Operation::Subtract => a - b,
        Operation::Multiply => a * b,
        Operation::Divide => a * b.recip(),
        Operation::Maximum if b.value() > a.value() => b,
        Operation::Minimum if b.value() < a.value() => b,
        Operation::Maximum | Operation::Minimum => a,
    }
}

/// Derivatives of [`combine`] with respect to `a` and `b`.
fn slopes(operation: Operation, a: f64, b: f64) -> [f64; 2] {
    match operation {
        Operation::Add => [1.0, 1.0],
        Operation::Subtract => [1.0, -1.0],
        Operation::Multiply => [b, a],
        Operation::Divide => [b.recip(), -a * b.recip() * b.recip()],
        Operation::Maximum if b > a => [0.0, 1.0],
        Operation::Minimum if b < a => [0.0, 1.0],
        Operation::Maximum | Operation::Minimum => [1.0, 0.0],
    }
}

fn normalize<N: Cell, T: Real, const WIDTH: usize>(
    epsilon: f64,
    from: &Series<T, WIDTH>,
    to: &mut Series<T, WIDTH>,
    width: usize,
) {
    let share = 1.0 / width as f64;
    let mean = (0..width).fold(N::from(0.0), |sum, i| sum + N::load(from, i)).scaled(share);
    let squares = (0..width).fold(N::from(0.0), |sum, i| {
        let difference = N::load(from, i) - mean;
        sum + difference * difference
    });
    let variance = squares.scaled(share);
    let inverse = (variance + N::from(epsilon)).through(|x| Elementwise::Power.series(x, [-0.5, 0.0]));
    (0..width).for_each(|i| ((N::load(from, i) - mean) * inverse).store(to, i));
}

fn softmax<N: Cell, T: Real, const WIDTH: usize>(from: &Series<T, WIDTH>, to: &mut Series<T, WIDTH>, width: usize) {
    // the same for all, so that nothing overflows
    let largest = (0..width).fold(f64::NEG_INFINITY, |largest, i| largest.max(f64::load(from, i)));
    let mut sum = N::from(0.0);
    for i in 0..width {
        let power = (N::load(from, i) - N::from(largest)).exp();
        power.store(to, i);
        sum = sum + power;
    }
    let inverse = sum.recip();
    (0..width).for_each(|i| (N::load(to, i) * inverse).store(to, i));
}

fn distances<N: Cell, T: Real, const WIDTH: usize>(
    (centres, inverse_lengths): (&[f64], &[f64]),
    from: &Series<T, WIDTH>,
    to: &mut Series<T, WIDTH>,
) {
    for (index, centre) in centres.chunks_exact(inverse_lengths.len()).enumerate() {
        let columns = centre.iter().zip(inverse_lengths).enumerate();
        let sum = columns.fold(N::from(0.0), |sum, (i, (centre, inverse))| {
            let distance = (N::load(from, i) - N::from(*centre)).scaled(*inverse);
            sum + distance * distance
        });
        sum.store(to, index);
    }
}
