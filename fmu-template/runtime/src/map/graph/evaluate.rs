//! A graph laid out for evaluation: its value, and its exact derivatives. A network is one, of layers.
//!
//! Every task is one or two passes over the steps. Outputs take the value of each; derivatives along a curve take the derivatives with it;
//! `J^T weights` takes the values and the slopes of activations first, and then goes back from the last step to the columns.

use super::{Elementwise, Graph, Step, other::OtherStep};
use crate::{
    map::{
        Activation, Layer, ScaledNetwork, Scaling,
        activation::{Kernel, Pass, activate},
        layers::{Dense, Order, Rows},
        series::Series,
        task::Task,
    },
    simd::{Lanes, Real, flat, flat_mut, flush, fma, share},
};

/// The steps of a [`Graph`] in the order of their evaluation, and the lengths of all values.
#[derive(Clone, Debug)]
pub(crate) struct PreparedGraph<T, const WIDTH: usize> {
    steps: Vec<Prepared<T, WIDTH>>,
    widths: Vec<usize>,
    /// Scaling of a network's inputs and outputs, applied in double precision; none for a graph.
    scaling: Option<Scaling>,
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
    Dense { of: usize, product: Product<T, WIDTH>, kernel: Kernel },
    /// An activation of a value.
    Activate { of: usize, kernel: Kernel },
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
    /// In place of second derivatives.
    spare: Vec<Lanes<T, WIDTH>>,
    /// Order of the next evaluation.
    order: Order,
}

/// Quantities that a forward pass computes: values, with derivatives along a curve or slopes of activations.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Forward {
    Values,
    First,
    Second,
    Slopes,
}

/// Largest number of rows for which a product is laid out row by row.
const FEW: usize = 8;

#[cfg(test)]
impl<T: Real, const WIDTH: usize> GraphScratch<T, WIDTH> {
    /// Every value of the last evaluation but the outputs.
    pub(crate) fn hidden(&self) -> impl Iterator<Item = f64> {
        self.values[..self.values.len() - 1].iter().flat_map(|value| flat(&value.value)).map(|x| (*x).into())
    }
}

impl<T: Real, const WIDTH: usize> PreparedGraph<T, WIDTH> {
    /// # Panics
    /// If [`Graph::check`] fails.
    pub(crate) fn new(graph: &Graph) -> Self {
        let Ok(widths) = graph.widths() else { panic!("a graph that was not checked") };
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
            let layer = Layer { inputs: widths[of], outputs: bias.len(), weight, bias, activation };
            let is_few = layer.outputs <= FEW;
            Kind::Dense { of, product: Product::new(&layer, is_few), kernel: Kernel::of_graph(activation) }
        };
        let prepared = |(number, step): (usize, &Step)| {
            let kind = match step {
                Step::Affine { of, .. } => product(*of, step, Activation::Identity),
                Step::Elementwise { of, function: Elementwise::Activation(activation), .. } => {
                    match of.checked_sub(1).filter(|before| is_fused[*before]).map(|before| &graph.steps[before]) {
                        Some(affine @ Step::Affine { of, .. }) => product(*of, affine, *activation),
                        _ => Kind::Activate { of: *of, kernel: Kernel::of_graph(*activation) },
                    }
                }
                other => Kind::Other(OtherStep::new::<WIDTH>(other)),
            };
            Prepared { to: number + 1, kind }
        };
        let kept = graph.steps.iter().enumerate().filter(|(number, _)| !is_fused[*number]);
        Self { steps: kept.map(prepared).collect(), widths, scaling: None }
    }

    /// The layers one after the other. The last one, which has few rows, is laid out in another way than those before it.
    pub(crate) fn of_network(ScaledNetwork { scaling, layers }: &ScaledNetwork) -> Self {
        let step = |(of, layer): (usize, &Layer)| {
            let product = Product::new(layer, of + 1 == layers.len());
            let kernel = Kernel::of_network(layer.activation);
            Prepared { to: of + 1, kind: Kind::Dense { of, product, kernel } }
        };
        Self {
            steps: layers.iter().enumerate().map(step).collect(),
            widths: [scaling.input_mean.len()].into_iter().chain(layers.iter().map(|layer| layer.outputs)).collect(),
            scaling: Some(scaling.clone()),
        }
    }

    pub(crate) fn scratch(&self) -> GraphScratch<T, WIDTH> {
        let mut values = vec![Series::new(0); self.widths.len()];
        values[0] = Series::new(self.widths[0].div_ceil(WIDTH));
        let mut rows = 0;
        for Prepared { to, kind } in &self.steps {
            let lanes = match kind {
                Kind::Dense { product: Product::Many(dense), .. } => dense.lanes(),
                Kind::Activate { of, .. } => values[*of].lanes(),
                Kind::Other(step) => step.numbers(self.widths[*to]).div_ceil(WIDTH),
                _ => self.widths[*to].div_ceil(WIDTH),
            };
            values[*to] = Series::new(lanes);
            if let Kind::Dense { product: Product::Few(few), .. } = kind {
                rows = rows.max(few.outputs());
            }
        }
        let longest = values.iter().map(Series::lanes).max().unwrap_or(0);
        let spare = vec![Lanes::ZERO; longest];
        GraphScratch { values, sums: vec![Lanes::ZERO; rows], spare, order: Order::Forward }
    }

    /// Does a task at a point. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another graph.
    #[inline(always)]
    pub(crate) fn run<const SIMD: u8>(&self, point: &[f64], task: Task, scratch: &mut GraphScratch<T, WIDTH>) {
        let (columns, scaling) = (&mut scratch.values[0], self.scaling.as_ref());
        match scaling {
            Some(Scaling { input_mean, input_scale, .. }) => {
                let standardised = point.iter().zip(input_mean).zip(input_scale);
                load(&mut columns.value, standardised.map(|((x, mean), scale)| flush(T::narrow((x - mean) / scale))));
            }
            None => load_scaled(&mut columns.value, point, None, |x, _| x),
        }
        let forward = match &task {
            Task::Outputs(_) => Forward::Values,
            Task::Series { rates, second, .. } => {
                for (to, rates) in [&mut columns.first, &mut columns.second].into_iter().zip(rates) {
                    load_scaled(to, rates, scaling.map(|scaling| scaling.input_scale.as_slice()), |x, scale| x / scale);
                }
                if second.is_some() { Forward::Second } else { Forward::First }
            }
            Task::Adjoint { .. } => Forward::Slopes,
        };
        // in one place for all, as it is compiled for each instruction set
        self.forward::<SIMD>(forward, scratch);
        let last = self.last();
        if let Task::Adjoint { weights, .. } = &task {
            scratch.values.iter_mut().for_each(|value| value.second.fill(Lanes::ZERO));
            let to = &mut scratch.values[last].second;
            load_scaled(to, weights, scaling.map(|scaling| scaling.output_scale.as_slice()), |x, scale| x * scale);
            self.backward::<SIMD>(&mut scratch.values);
        }
        let outputs = &scratch.values[last];
        match task {
            Task::Outputs(to) => {
                store(&outputs.value, to);
                if let Some(Scaling { output_mean, output_scale, .. }) = scaling {
                    for ((y, mean), scale) in to.iter_mut().zip(output_mean).zip(output_scale) {
                        *y = fma::<f64, SIMD>(*y, *scale, *mean);
                    }
                }
            }
            Task::Series { first, second, .. } => {
                for (from, to) in [(&outputs.first, Some(first)), (&outputs.second, second)] {
                    let Some(to) = to else { continue };
                    store(from, to);
                    if let Some(Scaling { output_scale, .. }) = scaling {
                        to.iter_mut().zip(output_scale).for_each(|(dy, scale)| *dy *= scale);
                    }
                }
            }
            Task::Adjoint { gradient, .. } => {
                store(&scratch.values[0].second, gradient);
                if let Some(Scaling { input_scale, .. }) = scaling {
                    gradient.iter_mut().zip(input_scale).for_each(|(dx, scale)| *dx /= scale);
                }
            }
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
        GraphScratch { values, sums, spare, order }: &mut GraphScratch<T, WIDTH>,
    ) {
        let orders = match forward {
            Forward::Values | Forward::Slopes => 0,
            Forward::First => 1,
            Forward::Second => 2,
        };
        for Prepared { to, kind } in &self.steps {
            let width = self.widths[*to];
            let (before, after) = values.split_at_mut(*to);
            let to = &mut after[0];
            // each of these is compiled for each instruction set and activation: there is one of each
            let rest = match kind {
                Kind::Dense { of, product, kernel } => {
                    let (from, to) = (before[*of].orders_mut(), to.orders_mut());
                    // many values block by block, while the next block is computed
                    let at_once = forward == Forward::Values && matches!(product, Product::Many(_));
                    for (number, (from, to)) in from.into_iter().zip(to).take(1 + orders).enumerate() {
                        let kernel = if at_once { *kernel } else { Kernel::Identity };
                        product.apply::<SIMD>(from, to, number == 0, (*order, kernel), sums);
                    }
                    if at_once { Kernel::Identity } else { *kernel }
                }
                Kind::Activate { of, kernel } => {
                    for (from, to) in before[*of].orders_mut().into_iter().zip(to.orders_mut()).take(1 + orders) {
                        to[..from.len()].copy_from_slice(from);
                    }
                    *kernel
                }
                Kind::Other(step) => {
                    if orders > 0 {
                        step.series(before, to, width)
                    } else {
                        step.value(before, to, width)
                    }
                    continue;
                }
            };
            match forward {
                Forward::Values => activate::<T, SIMD, WIDTH>(rest, &mut to.value),
                _ => {
                    let [value, first, second] = to.orders_mut();
                    // slopes are derivatives along the argument
                    if forward == Forward::Slopes {
                        first.fill(Lanes([T::ONE; WIDTH]));
                    }
                    // unused second derivatives stay in the first cache
                    let second = if forward == Forward::Second { second } else { &mut spare[..second.len()] };
                    if rest != Kernel::Identity {
                        share::<SIMD>(Pass { kernel: rest, value, first, second });
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
            // without a derivative to pass back, an infinite slope would make NaN
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

/// Takes numbers, and zeros where there are none.
#[inline(always)]
fn load<T: Real, const WIDTH: usize>(to: &mut [Lanes<T, WIDTH>], from: impl ExactSizeIterator<Item = T>) {
    let (to, rest) = flat_mut(to).split_at_mut(from.len());
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from);
    rest.fill(T::ZERO);
}

/// As [`load`], of numbers with their scales if they have some; compiled once for all instruction sets.
#[inline(never)]
fn load_scaled<T: Real, const WIDTH: usize>(
    to: &mut [Lanes<T, WIDTH>],
    from: &[f64],
    scales: Option<&[f64]>,
    scaled: impl Fn(f64, f64) -> f64,
) {
    match scales {
        Some(scales) => load(to, from.iter().zip(scales).map(|(x, scale)| T::narrow(scaled(*x, *scale)))),
        None => load(to, from.iter().map(|x| T::narrow(*x))),
    }
}

fn store<T: Real, const WIDTH: usize>(from: &[Lanes<T, WIDTH>], to: &mut [f64]) {
    to.iter_mut().zip(flat(from)).for_each(|(to, from)| *to = (*from).into());
}

impl<T: Real, const WIDTH: usize> Product<T, WIDTH> {
    fn new(layer: &Layer, is_few: bool) -> Self {
        if is_few { Self::Few(Rows::new(layer)) } else { Self::Many(Dense::new(layer)) }
    }

    /// The activation of `W x + b`, or of `W x` without the bias; that of few rows is left out.
    #[inline(always)]
    fn apply<const SIMD: u8>(
        &self,
        from: &mut [Lanes<T, WIDTH>],
        to: &mut [Lanes<T, WIDTH>],
        has_bias: bool,
        (order, kernel): (Order, Kernel),
        sums: &mut [Lanes<T, WIDTH>],
    ) {
        match self {
            Self::Many(dense) => dense.apply::<SIMD>(from, to, has_bias, order, kernel),
            Self::Few(rows) => rows.apply::<SIMD>(from, flat_mut(to), has_bias, sums),
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
