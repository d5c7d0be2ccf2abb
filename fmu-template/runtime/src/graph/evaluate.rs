//! A graph laid out for evaluation: its value, and its exact derivatives.
//!
//! Every task takes one or two passes over the steps. Outputs need the value of each step; derivatives along a curve
//! carry the derivatives with the value. `J^T weights` first computes the values and the slopes of activations, then
//! goes back from the last step to the columns.

mod interpolate;
mod layers;
mod nested;
mod other;

use super::{Elementwise, Graph, Step, series::Series};
use crate::{
    Activation, Precision,
    equations::motion::PreparedMotion,
    numbers::activation::{Kernel, Pass, activate},
    simd::{Compute, Lanes, Real, Simd, flat, flat_mut, flush, fma, share, share_narrow},
    task::Task,
};
pub(super) use interpolate::check as check_instants;
use layers::{Dense, DenseRows, Order};
use nested::{NestedScratch, NestedStep};
use other::OtherStep;
use std::ops::Range;

/// A graph laid out for fast evaluation.
#[derive(Clone, Debug)]
pub(crate) enum PreparedGraph {
    Double(PreparedSteps<f64, 8>),
    Single(PreparedSteps<f32, 16>),
}

/// Working memory of one evaluation at a time. Graphs can share it if their steps agree in kind and size.
#[derive(Clone, Debug)]
pub(crate) enum GraphScratch {
    Double(StepsScratch<f64, 8>),
    Single(StepsScratch<f32, 16>),
}

impl PreparedGraph {
    /// In single precision, a graph whose steps call others computes in double precision, and the others in single.
    pub(crate) fn new(graph: &Graph, precision: Precision) -> Self {
        match precision {
            Precision::Single if !graph.steps.iter().any(Step::is_nested) => {
                Self::Single(PreparedSteps::new(graph, precision))
            }
            _ => Self::Double(PreparedSteps::new(graph, precision)),
        }
    }

    /// The step with working memory that is the whole graph, without scaling before or after it.
    fn nested(&self) -> Option<&NestedStep> {
        match self {
            Self::Double(PreparedSteps { steps, first: None, last: None, .. }) => match steps.as_slice() {
                [Prepared { kind: Kind::Nested { step, .. }, .. }] => Some(step),
                _ => None,
            },
            _ => None,
        }
    }

    /// The equations of motion, if they are the whole graph.
    pub(crate) fn motion(&self) -> Option<&PreparedMotion> {
        self.nested()?.motion()
    }

    /// Derivatives of the states of a [motion](Self::motion), and its arguments with bends, without the outputs; see
    /// [`PreparedMotion::rates`].
    pub(crate) fn rates(
        &self,
        point: &[f64],
        left_out: Range<usize>,
        to: (&mut [f64], &mut [f64]),
        scratch: &mut GraphScratch,
    ) {
        if let (Some(step), GraphScratch::Double(scratch)) = (self.nested(), scratch) {
            step.rates(point, left_out, to, &mut scratch.nested[0]);
        }
    }

    pub(crate) fn scratch(&self) -> GraphScratch {
        match self {
            Self::Double(graph) => GraphScratch::Double(graph.scratch()),
            Self::Single(graph) => GraphScratch::Single(graph.scratch()),
        }
    }

    /// Does a task at a point, one value per column. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another graph.
    #[inline]
    pub(crate) fn perform(&self, simd: Simd, point: &[f64], task: Task, scratch: &mut GraphScratch) {
        // without copies to lanes and back
        if !matches!(task, Task::Adjoint { .. })
            && let (Some(step), GraphScratch::Double(scratch)) = (self.nested(), &mut *scratch)
        {
            return step.perform_alone(point, task, &mut scratch.nested[0]);
        }
        simd.run(Perform { program: self, point, task, scratch });
    }
}

struct Perform<'a, 'b> {
    program: &'a PreparedGraph,
    point: &'a [f64],
    task: Task<'b>,
    scratch: &'a mut GraphScratch,
}

impl Compute for Perform<'_, '_> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        let Self { program, point, task, scratch } = self;
        match (program, scratch) {
            (PreparedGraph::Double(graph), GraphScratch::Double(scratch)) => graph.run::<SIMD>(point, task, scratch),
            (PreparedGraph::Single(graph), GraphScratch::Single(scratch)) => graph.run::<SIMD>(point, task, scratch),
            _ => panic!("the scratch belongs to another graph"),
        }
    }
}

/// The steps of a [`Graph`] in the order of their evaluation, and the lengths of all values.
#[derive(Clone, Debug)]
pub(crate) struct PreparedSteps<T, const WIDTH: usize> {
    steps: Vec<Prepared<T, WIDTH>>,
    widths: Vec<usize>,
    /// A first step that standardizes the columns, and a last one that rescales the outputs.
    first: Option<MeanAndScale>,
    last: Option<MeanAndScale>,
}

/// Means and scales with which columns are standardized or outputs rescaled, in double precision.
#[derive(Clone, Debug)]
struct MeanAndScale {
    mean: Vec<f64>,
    scale: Vec<f64>,
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
    /// A step with separate working memory, at this position.
    Nested { step: Box<NestedStep>, memory: usize },
}

/// `W x + b`, laid out for many or for few rows.
#[derive(Clone, Debug)]
enum Product<T, const WIDTH: usize> {
    Many(Dense<T, WIDTH>),
    Few(DenseRows<T, WIDTH>),
}

/// Working memory of one evaluation at a time: all values.
#[derive(Clone, Debug)]
pub(crate) struct StepsScratch<T, const WIDTH: usize> {
    /// With their derivatives along a curve; for an adjoint derivative with the slopes of activations as the first, and with the
    /// derivatives of the weighted outputs as the second.
    values: Vec<Series<T, WIDTH>>,
    /// A sum for each of few rows.
    sums: Vec<Lanes<T, WIDTH>>,
    /// In place of second derivatives.
    spare: Vec<Lanes<T, WIDTH>>,
    /// Order of the next evaluation.
    order: Order,
    nested: Vec<NestedScratch>,
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
impl<T: Real, const WIDTH: usize> StepsScratch<T, WIDTH> {
    /// Every value of the last evaluation.
    pub(crate) fn hidden(&self) -> impl Iterator<Item = f64> {
        self.values.iter().flat_map(|value| flat(&value.value)).map(|x| (*x).into())
    }
}

impl<T: Real, const WIDTH: usize> PreparedSteps<T, WIDTH> {
    /// Functions that steps call compute in this precision.
    ///
    /// # Panics
    /// If [`Graph::check`] fails.
    pub(crate) fn new(graph: &Graph, precision: Precision) -> Self {
        let Ok(widths) = graph.widths() else { panic!("a graph that was not checked") };
        let is_network = graph.is_network();
        let mut uses = vec![0usize; widths.len()];
        graph.steps.iter().for_each(|step| step.values().for_each(|of| uses[of] += 1));
        let (mut first, mut last) = (None, None);
        // the steps that are part of another one
        let mut is_fused = vec![false; graph.steps.len()];
        for (number, step) in graph.steps.iter().enumerate() {
            match step {
                Step::Standardize { of: 0, mean, scale } if number == 0 && uses[0] == 1 && graph.steps.len() > 1 => {
                    first = Some(MeanAndScale { mean: mean.clone(), scale: scale.clone() });
                    is_fused[0] = true;
                }
                Step::Rescale { of, mean, scale }
                    if number + 1 == graph.steps.len() && *of == number && number > 0 && uses[number] == 1 =>
                {
                    last = Some(MeanAndScale { mean: mean.clone(), scale: scale.clone() });
                    is_fused[number] = true;
                }
                Step::Elementwise { of, function: Elementwise::Activation(_), .. } if uses[*of] == 1 && *of > 0 => {
                    is_fused[of - 1] |= matches!(graph.steps[of - 1], Step::Affine { .. });
                }
                _ => {}
            }
        }
        let end = graph.steps.len() - usize::from(last.is_some());
        let product = |of: usize, to: usize, step: &Step, activation| {
            let Step::Affine { weight, bias, .. } = step else { unreachable!("a product is made of an affine step") };
            let (is_few, kernel) = match is_network {
                true => (to == end, Kernel::of_network(activation)),
                false => (bias.len() <= FEW, Kernel::of_graph(activation)),
            };
            let product = match is_few {
                true => Product::Few(DenseRows::new(widths[of], weight, bias)),
                false => Product::Many(Dense::new(widths[of], weight, bias)),
            };
            Kind::Dense { of, product, kernel }
        };
        let (mut steps, mut nested) = (Vec::new(), 0);
        for (number, step) in graph.steps.iter().enumerate().filter(|(number, _)| !is_fused[*number]) {
            let to = number + 1;
            if let Some(step) = NestedStep::new(step, (&widths, to), precision) {
                steps.push(Prepared { to, kind: Kind::Nested { step: Box::new(step), memory: nested } });
                nested += 1;
                continue;
            }
            let kind = match step {
                Step::Affine { of, .. } => product(*of, to, step, Activation::Identity),
                Step::Elementwise { of, function: Elementwise::Activation(activation), .. } => {
                    match of.checked_sub(1).filter(|before| is_fused[*before]).map(|before| &graph.steps[before]) {
                        Some(affine @ Step::Affine { of, .. }) => product(*of, to, affine, *activation),
                        _ => Kind::Activate { of: *of, kernel: Kernel::of_graph(*activation) },
                    }
                }
                other => Kind::Other(OtherStep::new::<WIDTH>(other)),
            };
            steps.push(Prepared { to, kind });
        }
        Self { steps, widths, first, last }
    }

    pub(crate) fn scratch(&self) -> StepsScratch<T, WIDTH> {
        let mut values = vec![Series::new(0); self.widths.len()];
        values[self.begin()] = Series::new(self.widths[0].div_ceil(WIDTH));
        let (mut rows, mut nested) = (0, Vec::new());
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
            if let Kind::Nested { step, .. } = kind {
                nested.push(step.scratch());
            }
        }
        let longest = values.iter().map(Series::lanes).max().unwrap_or(0);
        let spare = vec![Lanes::ZERO; longest];
        StepsScratch { values, sums: vec![Lanes::ZERO; rows], spare, order: Order::Forward, nested }
    }

    /// Does a task at a point. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another graph.
    #[inline(always)]
    pub(crate) fn run<const SIMD: u8>(&self, point: &[f64], task: Task, scratch: &mut StepsScratch<T, WIDTH>) {
        let columns = &mut scratch.values[self.begin()];
        match &self.first {
            Some(MeanAndScale { mean, scale }) => {
                let standardized = point.iter().zip(mean).zip(scale);
                load(&mut columns.value, standardized.map(|((x, mean), scale)| flush(T::narrow((x - mean) / scale))));
            }
            None => load_scaled(&mut columns.value, point, None, |x, _| x),
        }
        let forward = match &task {
            Task::Outputs(_) => Forward::Values,
            Task::Series { rates, second, .. } => {
                for (to, rates) in [&mut columns.first, &mut columns.second].into_iter().zip(rates) {
                    load_scaled(to, rates, scales(&self.first), |x, scale| x / scale);
                }
                if second.is_some() { Forward::Second } else { Forward::First }
            }
            Task::Adjoint { .. } => Forward::Slopes,
        };
        // in one place for all, as it is compiled for each instruction set
        self.forward::<SIMD>(forward, scratch);
        let end = self.end();
        if let Task::Adjoint { weights, .. } = &task {
            scratch.values.iter_mut().for_each(|value| value.second.fill(Lanes::ZERO));
            load_scaled(&mut scratch.values[end].second, weights, scales(&self.last), |x, scale| x * scale);
            share_narrow::<SIMD>(Backward { steps: self, scratch });
        }
        let outputs = &scratch.values[end];
        match task {
            Task::Outputs(to) => {
                store(&outputs.value, to);
                if let Some(MeanAndScale { mean, scale }) = &self.last {
                    for ((y, mean), scale) in to.iter_mut().zip(mean).zip(scale) {
                        *y = fma::<f64, SIMD>(*y, *scale, *mean);
                    }
                }
            }
            Task::Series { first, second, .. } => {
                for (from, to) in [(&outputs.first, Some(first)), (&outputs.second, second)] {
                    let Some(to) = to else { continue };
                    store(from, to);
                    if let Some(MeanAndScale { scale, .. }) = &self.last {
                        to.iter_mut().zip(scale).for_each(|(dy, scale)| *dy *= scale);
                    }
                }
            }
            Task::Adjoint { gradient, .. } => {
                store(&scratch.values[self.begin()].second, gradient);
                if let Some(MeanAndScale { scale, .. }) = &self.first {
                    gradient.iter_mut().zip(scale).for_each(|(dx, scale)| *dx /= scale);
                }
            }
        }
        scratch.order.reverse();
    }

    /// Number of the value that the columns become, and of the one that becomes the outputs.
    fn begin(&self) -> usize {
        usize::from(self.first.is_some())
    }

    fn end(&self) -> usize {
        self.widths.len() - 1 - usize::from(self.last.is_some())
    }

    #[inline(always)]
    fn forward<const SIMD: u8>(
        &self,
        forward: Forward,
        StepsScratch { values, sums, spare, order, nested }: &mut StepsScratch<T, WIDTH>,
    ) {
        let orders = match forward {
            Forward::Values | Forward::Slopes => 0,
            Forward::First => 1,
            Forward::Second => 2,
        };
        let end = self.end();
        for Prepared { to, kind } in &self.steps {
            let (number, width) = (*to, self.widths[*to]);
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
                Kind::Nested { step, memory } => {
                    let needs_value = number != end || forward == Forward::Slopes;
                    step.forward(&before[step.of], to, (orders, needs_value), &mut nested[*memory]);
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
    fn backward<const SIMD: u8>(&self, StepsScratch { values, nested, .. }: &mut StepsScratch<T, WIDTH>) {
        for Prepared { to, kind } in self.steps.iter().rev() {
            let width = self.widths[*to];
            let (before, after) = values.split_at_mut(*to);
            let Series { value, first: slopes, second: change } = &mut after[0];
            // without a derivative to pass back, an infinite slope would make NaN
            if flat(change)[..width].iter().all(|change| *change == T::ZERO) {
                continue;
            }
            if !matches!(kind, Kind::Other(_) | Kind::Nested { .. }) {
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
                Kind::Nested { step, memory } => step.backward(&mut before[step.of], change, &mut nested[*memory]),
            }
        }
    }
}

/// [`PreparedSteps::backward`].
struct Backward<'a, T, const WIDTH: usize> {
    steps: &'a PreparedSteps<T, WIDTH>,
    scratch: &'a mut StepsScratch<T, WIDTH>,
}

impl<T: Real, const WIDTH: usize> Compute for Backward<'_, T, WIDTH> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        self.steps.backward::<SIMD>(self.scratch);
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

fn scales(of: &Option<MeanAndScale>) -> Option<&[f64]> {
    of.as_ref().map(|of| of.scale.as_slice())
}

fn store<T: Real, const WIDTH: usize>(from: &[Lanes<T, WIDTH>], to: &mut [f64]) {
    to.iter_mut().zip(flat(from)).for_each(|(to, from)| *to = (*from).into());
}

impl<T: Real, const WIDTH: usize> Product<T, WIDTH> {
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
