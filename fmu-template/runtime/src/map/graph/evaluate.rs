//! A graph laid out for evaluation: its value, and its exact derivatives.

use super::{Elementwise, Graph, Operation, Step};
use crate::{
    map::{
        Activation, Layer,
        activation::activate_exactly,
        evaluate::Task,
        jet::{Jet, Number},
        layers::{Dense, Order},
        regression::Forest,
    },
    simd::{Lanes, flat, flat_mut},
};

/// Numbers of a vector register.
const WIDTH: usize = 8;

/// The steps of a [`Graph`], and the lengths of all values.
#[derive(Clone, Debug)]
pub(crate) struct PreparedGraph {
    steps: Vec<Prepared>,
    widths: Vec<usize>,
}

#[derive(Clone, Debug)]
enum Prepared {
    Affine { of: usize, layer: Dense<f64, WIDTH> },
    Elementwise { of: usize, function: Elementwise, parameters: Vec<f64> },
    Combine { of: [usize; 2], operation: Operation },
    Select { of: [usize; 3] },
    Columns { columns: Vec<[u32; 2]> },
    Standardise { of: usize, epsilon: f64 },
    Softmax { of: usize },
    Distances { of: usize, centres: Vec<f64>, inverse_lengths: Vec<f64> },
    Forest { of: usize, forest: Forest },
}

/// Working memory of one evaluation at a time: all values.
#[derive(Clone, Debug)]
pub(crate) struct GraphScratch {
    values: Vec<Series>,
}

/// A value with its first and second derivative along a curve.
#[derive(Clone, Debug)]
struct Series {
    value: Vec<Lanes<f64, WIDTH>>,
    first: Vec<Lanes<f64, WIDTH>>,
    second: Vec<Lanes<f64, WIDTH>>,
}

/// What a graph is evaluated in: plain numbers, or numbers with their derivatives.
trait Cell: Number {
    const HAS_DERIVATIVES: bool;
    fn load(from: &Series, index: usize) -> Self;
    fn store(self, to: &mut Series, index: usize);
    /// A function of it, of which the value and the derivatives at a number are given.
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self;
}

impl Cell for f64 {
    const HAS_DERIVATIVES: bool = false;

    #[inline(always)]
    fn load(from: &Series, index: usize) -> Self {
        flat(&from.value)[index]
    }

    #[inline(always)]
    fn store(self, to: &mut Series, index: usize) {
        flat_mut(&mut to.value)[index] = self;
    }

    #[inline(always)]
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self {
        series(self)[0]
    }
}

impl Cell for Jet {
    const HAS_DERIVATIVES: bool = true;

    #[inline(always)]
    fn load(from: &Series, index: usize) -> Self {
        let [value, first, second] = [&from.value, &from.first, &from.second].map(|of| flat(of)[index]);
        Self { value, first, second }
    }

    #[inline(always)]
    fn store(self, to: &mut Series, index: usize) {
        flat_mut(&mut to.value)[index] = self.value;
        flat_mut(&mut to.first)[index] = self.first;
        flat_mut(&mut to.second)[index] = self.second;
    }

    #[inline(always)]
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self {
        let [value, slope, curvature] = series(self.value);
        let Self { first, second, .. } = self;
        Self { value, first: slope * first, second: slope * second + curvature * first * first }
    }
}

impl PreparedGraph {
    /// # Panics
    /// If [`Graph::check`] fails.
    pub(crate) fn new(graph: &Graph) -> Self {
        let widths = graph.widths().expect("a checked graph");
        let prepared = |step: &Step| match step {
            Step::Affine { of, weight, bias } => {
                let (inputs, outputs) = (widths[*of], bias.len());
                let (weight, bias, activation) = (weight.clone(), bias.clone(), Activation::Identity);
                let layer = Dense::new(&Layer { inputs, outputs, weight, bias, activation });
                Prepared::Affine { of: *of, layer }
            }
            Step::Elementwise { of, function, parameters } => {
                Prepared::Elementwise { of: *of, function: *function, parameters: parameters.clone() }
            }
            Step::Combine { of, operation } => Prepared::Combine { of: *of, operation: *operation },
            Step::Select { of } => Prepared::Select { of: *of },
            Step::Columns { columns } => Prepared::Columns { columns: columns.clone() },
            Step::Standardise { of, epsilon } => Prepared::Standardise { of: *of, epsilon: *epsilon },
            Step::Softmax { of } => Prepared::Softmax { of: *of },
            Step::Distances { of, centres, lengths } => Prepared::Distances {
                of: *of,
                centres: centres.clone(),
                inverse_lengths: lengths.iter().map(|length| 1.0 / length).collect(),
            },
            Step::Forest { of, forest, .. } => Prepared::Forest { of: *of, forest: forest.clone() },
        };
        Self { steps: graph.steps.iter().map(prepared).collect(), widths }
    }

    pub(crate) fn scratch(&self) -> GraphScratch {
        let lanes = |value: usize| match value.checked_sub(1).map(|step| &self.steps[step]) {
            Some(Prepared::Affine { layer, .. }) => layer.lanes(),
            _ => self.widths[value].div_ceil(WIDTH),
        };
        let series = |value| {
            let zeros = vec![Lanes::ZERO; lanes(value)];
            Series { value: zeros.clone(), first: zeros.clone(), second: zeros }
        };
        GraphScratch { values: (0..self.widths.len()).map(series).collect() }
    }

    /// Does a task at a point. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another graph.
    #[inline(always)]
    pub(crate) fn run<const SIMD: u8>(&self, point: &[f64], task: Task, scratch: &mut GraphScratch) {
        let values = &mut scratch.values;
        flat_mut(&mut values[0].value)[..self.widths[0]].copy_from_slice(point);
        let mut task = match task {
            Task::Outputs(outputs) => {
                self.forward::<SIMD, f64>(values);
                outputs.copy_from_slice(&flat(&self.last(values).value)[..outputs.len()]);
                return;
            }
            derivatives => derivatives,
        };
        let columns = &mut values[0];
        let (rates, passes) = match &task {
            Task::Series { rates, .. } => (*rates, 1),
            Task::Adjoint { gradient, .. } => ([&[] as &[f64]; 2], gradient.len()),
            Task::Outputs(_) => ([&[] as &[f64]; 2], 0),
        };
        for (to, rates) in [&mut columns.first, &mut columns.second].into_iter().zip(rates) {
            flat_mut(to).fill(0.0);
            flat_mut(to)[..rates.len()].copy_from_slice(rates);
        }
        // in one place for both, as it is compiled for each instruction set
        for pass in 0..passes {
            if let Task::Adjoint { .. } = task {
                // along one column after the other
                let along = flat_mut(&mut values[0].first);
                along.fill(0.0);
                along[pass] = 1.0;
            }
            self.forward::<SIMD, Jet>(values);
            let Series { first: found, second: bent, .. } = self.last(values);
            match &mut task {
                Task::Series { first, second, .. } => {
                    first.copy_from_slice(&flat(found)[..first.len()]);
                    if let Some(second) = second {
                        second.copy_from_slice(&flat(bent)[..second.len()]);
                    }
                }
                Task::Adjoint { weights, gradient } => {
                    gradient[pass] = weights.iter().zip(flat(found)).map(|(weight, first)| weight * first).sum();
                }
                Task::Outputs(_) => {}
            }
        }
    }

    fn last<'a>(&self, values: &'a [Series]) -> &'a Series {
        &values[self.steps.len()]
    }

    #[inline(always)]
    fn forward<const SIMD: u8, N: Cell>(&self, values: &mut [Series]) {
        for (number, step) in self.steps.iter().enumerate() {
            let (before, after) = values.split_at_mut(number + 1);
            let to = &mut after[0];
            match step {
                Prepared::Affine { of, layer } => affine::<SIMD, N>(layer, &before[*of], to),
                Prepared::Elementwise { of, function: Elementwise::Activation(activation), .. }
                    if !N::HAS_DERIVATIVES =>
                {
                    let lanes = to.value.len();
                    to.value.copy_from_slice(&before[*of].value[..lanes]);
                    activate_exactly::<SIMD, WIDTH>(*activation, &mut to.value);
                }
                other => self.other::<N>(other, before, to, self.widths[number + 1]),
            }
        }
    }

    /// Steps that are not compiled once for each instruction set: FMUs stay small.
    #[inline(never)]
    fn other<N: Cell>(&self, step: &Prepared, before: &[Series], to: &mut Series, width: usize) {
        match step {
            Prepared::Affine { .. } => unreachable!("a product of its own for each instruction set"),
            Prepared::Elementwise { of, function, parameters } => {
                elementwise::<N>((*function, parameters), &before[*of], to, width);
            }
            Prepared::Combine { of: [a, b], operation } => {
                let (a, b) = (&before[*a], &before[*b]);
                (0..width).for_each(|i| combine(*operation, N::load(a, i), N::load(b, i)).store(to, i));
            }
            Prepared::Select { of } => {
                let [condition, a, b] = of.map(|of| &before[of]);
                let conditions = flat(&condition.value)[..width].iter().enumerate();
                conditions.for_each(|(i, condition)| N::load(if *condition > 0.0 { a } else { b }, i).store(to, i));
            }
            Prepared::Columns { columns } => {
                let column = |[of, column]: &[u32; 2]| N::load(&before[*of as usize], *column as usize);
                columns.iter().enumerate().for_each(|(i, from)| column(from).store(to, i));
            }
            Prepared::Standardise { of, epsilon } => standardise::<N>(*epsilon, &before[*of], to, width),
            Prepared::Softmax { of } => softmax::<N>(&before[*of], to, width),
            Prepared::Distances { of, centres, inverse_lengths } => {
                distances::<N>((centres, inverse_lengths), &before[*of], to);
            }
            Prepared::Forest { of, forest } => {
                let inputs = &flat(&before[*of].value)[..self.widths[*of]];
                forest.evaluate(inputs, &mut flat_mut(&mut to.value)[..width]);
                if N::HAS_DERIVATIVES {
                    flat_mut(&mut to.first).fill(0.0);
                    flat_mut(&mut to.second).fill(0.0);
                }
            }
        }
    }
}

#[inline(always)]
fn affine<const SIMD: u8, N: Cell>(layer: &Dense<f64, WIDTH>, from: &Series, to: &mut Series) {
    let (order, linear) = (Order::Forward, Activation::Identity);
    layer.apply::<SIMD, true>(&from.value, &mut to.value, order, linear);
    if N::HAS_DERIVATIVES {
        layer.apply::<SIMD, false>(&from.first, &mut to.first, order, linear);
        layer.apply::<SIMD, false>(&from.second, &mut to.second, order, linear);
    }
}

fn elementwise<N: Cell>((function, parameters): (Elementwise, &[f64]), from: &Series, to: &mut Series, width: usize) {
    let count = function.parameters();
    // one for all, or one for each
    let stride = usize::from(parameters.len() > count) * width;
    let places = if stride == 0 { [0, 1] } else { [0, stride] };
    for i in 0..width {
        let of_number = if stride == 0 { 0 } else { i };
        let p = places.map(|place| parameters.get(place + of_number).copied().unwrap_or(0.0));
        N::load(from, i).through(|x| function.series(x, p)).store(to, i);
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

fn standardise<N: Cell>(epsilon: f64, from: &Series, to: &mut Series, width: usize) {
    let share = 1.0 / width as f64;
    let mean = (0..width).fold(N::from(0.0), |sum, i| sum + N::load(from, i)).scaled(share);
    let square = |difference: N| difference * difference;
    let variance = (0..width).fold(N::from(0.0), |sum, i| sum + square(N::load(from, i) - mean)).scaled(share);
    let inverse = (variance + N::from(epsilon)).through(|x| Elementwise::Power.series(x, [-0.5, 0.0]));
    (0..width).for_each(|i| ((N::load(from, i) - mean) * inverse).store(to, i));
}

fn softmax<N: Cell>(from: &Series, to: &mut Series, width: usize) {
    // the same for all, so that nothing overflows
    let largest = flat(&from.value)[..width].iter().fold(f64::NEG_INFINITY, |largest, x| largest.max(*x));
    let mut sum = N::from(0.0);
    for i in 0..width {
        let power = (N::load(from, i) - N::from(largest)).exp();
        power.store(to, i);
        sum = sum + power;
    }
    let inverse = sum.recip();
    (0..width).for_each(|i| (N::load(to, i) * inverse).store(to, i));
}

fn distances<N: Cell>((centres, inverse_lengths): (&[f64], &[f64]), from: &Series, to: &mut Series) {
    for (index, centre) in centres.chunks_exact(inverse_lengths.len()).enumerate() {
        let columns = centre.iter().zip(inverse_lengths).enumerate();
        let sum = columns.fold(N::from(0.0), |sum, (i, (centre, inverse))| {
            let distance = (N::load(from, i) - N::from(*centre)).scaled(*inverse);
            sum + distance * distance
        });
        sum.store(to, index);
    }
}
