//! A graph laid out for evaluation: its value, and its exact derivatives.
//!
//! Every task is one or two passes over the steps. Outputs take the value of each; derivatives along a curve take the derivatives with it;
//! `J^T weights` takes the values and the slopes of activations first, and then goes back from the last step to the columns.

use super::{Elementwise, Graph, Step, other::OtherStep};
use crate::{
    map::{
        Activation, Layer,
        activation::activate_exactly,
        evaluate::Task,
        layers::{Dense, Order, Rows},
        network::{Pass, Record, Series},
    },
    simd::{Lanes, Real, flat, flat_mut},
};

/// The steps of a [`Graph`] in the order of their evaluation, and the lengths of all values.
#[derive(Clone, Debug)]
pub(crate) struct PreparedGraph<T, const WIDTH: usize> {
    steps: Vec<Prepared<T, WIDTH>>,
    widths: Vec<usize>,
}

/// A step, and the number of the value that it makes.
#[derive(Clone, Debug)]
struct Prepared<T, const WIDTH: usize> {
    to: usize,
    kind: Kind<T, WIDTH>,
}

#[derive(Clone, Debug)]
enum Kind<T, const WIDTH: usize> {
    /// An activation of `W x + b`: two steps, if nothing else needs what is between them.
    Dense { of: usize, product: Product<T, WIDTH>, activation: Activation },
    /// An activation of a value.
    Activate { of: usize, activation: Activation },
    /// A step that is not compiled once for each instruction set.
    Other(OtherStep),
}

/// `W x + b`, laid out for many or for few rows.
#[derive(Clone, Debug)]
enum Product<T, const WIDTH: usize> {
    Many(Dense<T, WIDTH>),
    Few(Rows<T, WIDTH>),
}

/// Working memory of one evaluation at a time: all values.
#[derive(Clone, Debug)]
pub(crate) struct GraphScratch<T, const WIDTH: usize> {
    /// With their derivatives along a curve; for an adjoint derivative with the slopes of activations as the first, and with the
    /// derivatives of the weighted outputs as the second.
    values: Vec<Series<T, WIDTH>>,
    /// A sum for each of few rows.
    sums: Vec<Lanes<T, WIDTH>>,
    /// Order of the next evaluation.
    order: Order,
}

/// What a pass from the columns to the outputs takes beside the values.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Forward {
    Values,
    First,
    Second,
    Slopes,
}

/// For how many rows a product has its columns in vectors, not its rows.
const FEW: usize = 8;

impl<T: Real, const WIDTH: usize> PreparedGraph<T, WIDTH> {
    /// # Panics
    /// If [`Graph::check`] fails.
    pub(crate) fn new(graph: &Graph) -> Self {
        let widths = graph.widths().expect("a checked graph");
        let mut uses = vec![0usize; widths.len()];
        graph.steps.iter().for_each(|step| step.values().for_each(|of| uses[of] += 1));
        // the steps that are part of an activation behind them
        let mut is_fused = vec![false; graph.steps.len()];
        for step in &graph.steps {
            if let Step::Elementwise { of, function: Elementwise::Activation(_), .. } = step
                && let Some(before) = of.checked_sub(1)
                && matches!(graph.steps[before], Step::Affine { .. })
                && uses[*of] == 1
            {
                is_fused[before] = true;
            }
        }
        let product = |of: usize, step: &Step, activation| {
            let Step::Affine { weight, bias, .. } = step else { unreachable!("a product is made of an affine step") };
            let (weight, bias) = (weight.clone(), bias.clone());
            let layer =
                Layer { inputs: widths[of], outputs: bias.len(), weight, bias, activation: Activation::Identity };
            let is_few = layer.outputs <= FEW;
            let product = if is_few { Product::Few(Rows::new(&layer)) } else { Product::Many(Dense::new(&layer)) };
            Kind::Dense { of, product, activation }
        };
        let prepared = |(number, step): (usize, &Step)| {
            let kind = match step {
                Step::Affine { of, .. } => product(*of, step, Activation::Identity),
                Step::Elementwise { of, function: Elementwise::Activation(activation), .. } => {
                    match of.checked_sub(1).filter(|before| is_fused[*before]).map(|before| &graph.steps[before]) {
                        Some(affine @ Step::Affine { of, .. }) => product(*of, affine, *activation),
                        _ => Kind::Activate { of: *of, activation: *activation },
                    }
                }
                other => Kind::Other(OtherStep::new(other)),
            };
            Prepared { to: number + 1, kind }
        };
        let kept = graph.steps.iter().enumerate().filter(|(number, _)| !is_fused[*number]);
        Self { steps: kept.map(prepared).collect(), widths }
    }

    pub(crate) fn scratch(&self) -> GraphScratch<T, WIDTH> {
        let mut values = vec![Series::new(0); self.widths.len()];
        values[0] = Series::new(self.widths[0].div_ceil(WIDTH));
        let mut rows = 0;
        for Prepared { to, kind } in &self.steps {
            let lanes = match kind {
                Kind::Dense { product: Product::Many(dense), .. } => dense.lanes(),
                Kind::Activate { of, .. } => values[*of].lanes(),
                _ => self.widths[*to].div_ceil(WIDTH),
            };
            values[*to] = Series::new(lanes);
            if let Kind::Dense { product: Product::Few(few), .. } = kind {
                rows = rows.max(few.outputs());
            }
        }
        GraphScratch { values, sums: vec![Lanes::ZERO; rows], order: Order::Forward }
    }

    /// Does a task at a point. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another graph.
    #[inline(always)]
    pub(crate) fn run<const SIMD: u8>(&self, point: &[f64], task: Task, scratch: &mut GraphScratch<T, WIDTH>) {
        load(&mut scratch.values[0].value, point, self.widths[0]);
        let forward = match &task {
            Task::Outputs(_) => Forward::Values,
            Task::Series { rates, second, .. } => {
                let Series { first: velocity, second: change, .. } = &mut scratch.values[0];
                load(velocity, rates[0], self.widths[0]);
                load(change, rates[1], self.widths[0]);
                if second.is_some() { Forward::Second } else { Forward::First }
            }
            Task::Adjoint { .. } => Forward::Slopes,
        };
        // in one place for all, as it is compiled for each instruction set
        self.forward::<SIMD>(forward, scratch);
        if let Task::Adjoint { weights, .. } = &task {
            scratch.values.iter_mut().for_each(|value| value.second.fill(Lanes::ZERO));
            let last = self.last();
            load(&mut scratch.values[last].second, weights, weights.len());
            self.backward::<SIMD>(&mut scratch.values);
        }
        let last = &scratch.values[self.last()];
        match task {
            Task::Outputs(outputs) => store(&last.value, outputs),
            Task::Series { first, second, .. } => {
                store(&last.first, first);
                second.into_iter().for_each(|second| store(&last.second, second));
            }
            Task::Adjoint { gradient, .. } => store(&scratch.values[0].second, gradient),
        }
        scratch.order.reverse();
    }

    fn last(&self) -> usize {
        self.widths.len() - 1
    }

    #[inline(always)]
    fn forward<const SIMD: u8>(
        &self,
        forward: Forward,
        GraphScratch { values, sums, order }: &mut GraphScratch<T, WIDTH>,
    ) {
        let linear = (*order, Activation::Identity);
        for Prepared { to, kind } in &self.steps {
            let width = self.widths[*to];
            let (before, after) = values.split_at_mut(*to);
            let to = &mut after[0];
            match kind {
                Kind::Dense { of, product, activation } => {
                    let from = &mut before[*of];
                    // block by block, while the next one is computed, if it may be the function of networks
                    let at_once = forward == Forward::Values && activation.is_exact();
                    let first = if at_once { *activation } else { Activation::Identity };
                    product.apply::<SIMD, true>(&mut from.value, &mut to.value, (*order, first), sums);
                    if matches!(forward, Forward::First | Forward::Second) {
                        product.apply::<SIMD, false>(&mut from.first, &mut to.first, linear, sums);
                    }
                    if forward == Forward::Second {
                        product.apply::<SIMD, false>(&mut from.second, &mut to.second, linear, sums);
                    }
                    if *activation != first {
                        activate::<T, SIMD, WIDTH>(*activation, forward, to);
                    } else if forward == Forward::Slopes {
                        to.first.fill(Lanes([T::ONE; WIDTH]));
                    }
                }
                Kind::Activate { of, activation } => {
                    let from = &before[*of];
                    to.value.copy_from_slice(&from.value);
                    if matches!(forward, Forward::First | Forward::Second) {
                        to.first.copy_from_slice(&from.first);
                        to.second.copy_from_slice(&from.second);
                    }
                    activate::<T, SIMD, WIDTH>(*activation, forward, to);
                }
                Kind::Other(step) => {
                    if matches!(forward, Forward::First | Forward::Second) {
                        step.series(before, to, width);
                    } else {
                        step.value(before, to, width);
                    }
                }
            }
        }
    }

    /// Adds to what the values before each step have as derivatives of the weighted outputs, last step first.
    #[inline(always)]
    fn backward<const SIMD: u8>(&self, values: &mut [Series<T, WIDTH>]) {
        for Prepared { to, kind } in self.steps.iter().rev() {
            let width = self.widths[*to];
            let (before, after) = values.split_at_mut(*to);
            let Series { value, first: slopes, second: change } = &mut after[0];
            // a slope where nothing goes on may be infinite
            if flat(change)[..width].iter().all(|change| *change == T::ZERO) {
                continue;
            }
            if !matches!(kind, Kind::Other(_)) {
                for (change, slope) in flat_mut(change).iter_mut().zip(flat(slopes)) {
                    *change = if *change == T::ZERO { T::ZERO } else { *change * *slope };
                }
            }
            match kind {
                Kind::Dense { of, product, .. } => {
                    product.apply_transposed::<SIMD>(change, &mut before[*of].second);
                }
                Kind::Activate { of, .. } => {
                    let sums = flat_mut(&mut before[*of].second).iter_mut();
                    sums.zip(flat(change)).for_each(|(sum, change)| *sum = *sum + *change);
                }
                Kind::Other(step) => step.adjoint(before, value, change, width),
            }
        }
    }
}

/// Passes a value through an activation, with what the pass takes beside it.
#[inline(always)]
fn activate<T: Real, const SIMD: u8, const WIDTH: usize>(
    activation: Activation,
    forward: Forward,
    to: &mut Series<T, WIDTH>,
) {
    match forward {
        Forward::Values => activate_exactly::<T, SIMD, WIDTH>(activation, &mut to.value),
        Forward::First | Forward::Second => {
            let lanes = to.lanes();
            activation.with_exact(Pass::<T, SIMD, WIDTH> { series: to, lanes });
        }
        Forward::Slopes => {
            activation.with_exact(Record::<T, SIMD, WIDTH> { values: &mut to.value, slopes: &mut to.first });
        }
    }
}

/// Takes numbers, and zeros where there are none.
fn load<T: Real, const WIDTH: usize>(to: &mut [Lanes<T, WIDTH>], from: &[f64], width: usize) {
    let to = flat_mut(to);
    to[from.len()..].fill(T::ZERO);
    to[..width].iter_mut().zip(from).for_each(|(to, from)| *to = T::narrow(*from));
}

fn store<T: Real, const WIDTH: usize>(from: &[Lanes<T, WIDTH>], to: &mut [f64]) {
    to.iter_mut().zip(flat(from)).for_each(|(to, from)| *to = (*from).into());
}

impl<T: Real, const WIDTH: usize> Product<T, WIDTH> {
    /// The activation of `W x + b`, or of `W x` without `BIAS`.
    #[inline(always)]
    fn apply<const SIMD: u8, const BIAS: bool>(
        &self,
        from: &mut [Lanes<T, WIDTH>],
        to: &mut [Lanes<T, WIDTH>],
        (order, activation): (Order, Activation),
        sums: &mut [Lanes<T, WIDTH>],
    ) {
        match self {
            Self::Many(dense) => dense.apply::<SIMD, BIAS>(from, to, order, activation),
            Self::Few(rows) => {
                rows.apply::<SIMD, BIAS, T>(from, flat_mut(to), sums);
                if activation != Activation::Identity {
                    activate_exactly::<T, SIMD, WIDTH>(activation, to);
                }
            }
        }
    }

    /// Adds `W^T y`.
    #[inline(always)]
    fn apply_transposed<const SIMD: u8>(&self, from: &[Lanes<T, WIDTH>], to: &mut [Lanes<T, WIDTH>]) {
        match self {
            Self::Many(dense) => dense.apply_transposed::<SIMD>(from, to),
            Self::Few(rows) => rows.apply_transposed::<SIMD>(flat(from)[..rows.outputs()].iter().copied(), to),
        }
    }
}
