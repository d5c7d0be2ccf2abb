//! The network between standardised inputs and standardised outputs, in either precision.

use super::{
    Activation, Layer,
    activation::{Function, User, series},
    layers::{Dense, Order, Rows},
};
use crate::simd::{Lanes, Real, flat, flat_mut, flush};

/// Layers, each with its activation. The last one, which has few rows, is laid out in another way than those before it.
#[derive(Clone, Debug)]
pub(crate) struct Network<T, const WIDTH: usize> {
    hidden: Vec<(Dense<T, WIDTH>, Activation)>,
    last: Rows<T, WIDTH>,
    last_activation: Activation,
}

/// Values of a layer with their first and second derivative along a curve.
#[derive(Clone, Debug)]
pub(crate) struct Series<T, const WIDTH: usize> {
    pub(super) value: Vec<Lanes<T, WIDTH>>,
    pub(super) first: Vec<Lanes<T, WIDTH>>,
    pub(super) second: Vec<Lanes<T, WIDTH>>,
}

/// Working memory: the layer at hand, the one after it, and the slopes of all activations.
#[derive(Clone, Debug)]
pub(crate) struct Buffers<T, const WIDTH: usize> {
    current: Series<T, WIDTH>,
    next: Series<T, WIDTH>,
    slopes: Vec<Vec<Lanes<T, WIDTH>>>,
    /// What the last layer's activation is computed of.
    last: Vec<f64>,
    /// Order of the next evaluation.
    order: Order,
}

impl<T: Real, const WIDTH: usize> Series<T, WIDTH> {
    pub(super) fn new(lanes: usize) -> Self {
        let zeros = vec![Lanes::ZERO; lanes];
        Self { value: zeros.clone(), first: zeros.clone(), second: zeros }
    }

    pub(super) fn lanes(&self) -> usize {
        self.value.len()
    }
}

impl<T: Real, const WIDTH: usize> Buffers<T, WIDTH> {
    /// Takes the input columns.
    #[inline(always)]
    pub(crate) fn load(&mut self, values: impl Iterator<Item = f64>) {
        flat_mut(&mut self.current.value).iter_mut().zip(values).for_each(|(z, x)| *z = flush(T::narrow(x)));
    }

    /// Takes the first or the second derivatives of the input columns.
    #[inline(always)]
    pub(crate) fn load_rates(&mut self, order: usize, rates: impl Iterator<Item = f64>) {
        let to = if order == 1 { &mut self.current.first } else { &mut self.current.second };
        flat_mut(to).iter_mut().zip(rates).for_each(|(z, x)| *z = T::narrow(x));
    }

    /// The derivatives with respect to the input columns, after [`Network::adjoint`].
    #[inline(always)]
    pub(crate) fn gradient(&self) -> impl Iterator<Item = f64> {
        flat(&self.current.value).iter().map(|&x| x.into())
    }

    /// Every hidden value of the last evaluation, for tests.
    #[cfg(test)]
    pub(crate) fn hidden(&self) -> impl Iterator<Item = f64> {
        flat(&self.current.value).iter().chain(flat(&self.next.value)).map(|&x| x.into())
    }
}

impl<T: Real, const WIDTH: usize> Network<T, WIDTH> {
    /// # Panics
    /// If there is no layer; a surrogate's networks have at least one.
    pub(crate) fn new(layers: &[Layer]) -> Self {
        let (last, hidden) = layers.split_last().expect("a network has at least one layer");
        let hidden = hidden.iter().map(|layer| (Dense::new(layer), layer.activation)).collect();
        Self { hidden, last: Rows::new(last), last_activation: last.activation }
    }

    pub(crate) fn buffers(&self, inputs: usize) -> Buffers<T, WIDTH> {
        let lanes = || self.hidden.iter().map(|(layer, _)| layer.lanes());
        let widest = lanes().fold(inputs.div_ceil(WIDTH).max(self.last.outputs()), usize::max);
        let slopes = lanes().map(|lanes| vec![Lanes::ZERO; lanes]).collect();
        let last = vec![0.0; self.last.outputs()];
        Buffers { current: Series::new(widest), next: Series::new(widest), slopes, last, order: Order::Forward }
    }

    /// Outputs for the inputs that are loaded.
    #[inline(always)]
    pub(crate) fn forward<const SIMD: u8>(&self, buffers: &mut Buffers<T, WIDTH>, outputs: &mut [f64]) {
        let (current, next) = (&mut buffers.current.value, &mut buffers.next.value);
        for (layer, activation) in &self.hidden {
            layer.apply::<SIMD, true>(current, next, buffers.order, *activation);
            std::mem::swap(current, next);
        }
        self.last.apply::<SIMD, true, f64>(current, outputs, next);
        if self.last_activation != Activation::Identity {
            outputs.iter_mut().for_each(|y| [*y, ..] = series(self.last_activation, *y));
        }
        buffers.order.reverse();
    }

    /// First derivatives of the outputs, and second ones if there is a slice for them, along the curve whose value and
    /// derivatives are loaded.
    #[inline(always)]
    pub(crate) fn series<const SIMD: u8>(
        &self,
        buffers: &mut Buffers<T, WIDTH>,
        first: &mut [f64],
        mut second: Option<&mut [f64]>,
    ) {
        let Buffers { current, next, last, .. } = buffers;
        for (layer, activation) in &self.hidden {
            layer.apply::<SIMD, true>(&current.value, &mut next.value, Order::Forward, Activation::Identity);
            layer.apply::<SIMD, false>(&current.first, &mut next.first, Order::Forward, Activation::Identity);
            if second.is_some() {
                layer.apply::<SIMD, false>(&current.second, &mut next.second, Order::Forward, Activation::Identity);
            }
            activation.with(Pass::<T, SIMD, WIDTH> { series: next, lanes: layer.lanes() });
            std::mem::swap(current, next);
        }
        self.last.apply::<SIMD, false, f64>(&mut current.first, first, &mut next.first);
        // not in a closure, which would not be compiled with the caller's instruction set
        if let Some(second) = second.as_deref_mut() {
            self.last.apply::<SIMD, false, f64>(&mut current.second, second, &mut next.second);
        }
        if self.last_activation != Activation::Identity {
            self.last.apply::<SIMD, true, f64>(&mut current.value, last, &mut next.value);
            pass_last(self.last_activation, last, first, second);
        }
    }

    /// `J^T weights` at the inputs that are loaded; the result is [`Buffers::gradient`].
    #[inline(always)]
    pub(crate) fn adjoint<const SIMD: u8>(&self, buffers: &mut Buffers<T, WIDTH>, weights: impl Iterator<Item = f64>) {
        let Buffers { current, next, slopes, last, .. } = buffers;
        let (current, next) = (&mut current.value, &mut next.value);
        for ((layer, activation), slopes) in self.hidden.iter().zip(&mut *slopes) {
            layer.apply::<SIMD, true>(current, next, Order::Forward, Activation::Identity);
            activation.with(Record::<T, SIMD, WIDTH> { values: next, slopes });
            std::mem::swap(current, next);
        }
        if self.last_activation == Activation::Identity {
            last.fill(1.0);
        } else {
            self.last.apply::<SIMD, true, f64>(current, last, next);
            last.iter_mut().for_each(|y| [_, *y, _] = series(self.last_activation, *y));
        }
        let weights = weights.zip(&*last).map(|(weight, slope)| T::narrow(weight * slope));
        current.fill(Lanes::ZERO);
        self.last.apply_transposed::<SIMD>(weights, current);
        for ((layer, _), slopes) in self.hidden.iter().zip(&*slopes).rev() {
            flat_mut(current).iter_mut().zip(flat(slopes)).for_each(|(x, &slope)| *x = *x * slope);
            next.fill(Lanes::ZERO);
            layer.apply_transposed::<SIMD>(&current[..layer.lanes()], next);
            std::mem::swap(current, next);
        }
    }
}

/// Passes the first `lanes` of a series through an activation.
pub(super) struct Pass<'a, T, const SIMD: u8, const WIDTH: usize> {
    pub(super) series: &'a mut Series<T, WIDTH>,
    pub(super) lanes: usize,
}

impl<T: Real, const SIMD: u8, const WIDTH: usize> User<T> for Pass<'_, T, SIMD, WIDTH> {
    #[inline(always)]
    fn run<F: Function<T>>(self) {
        let Series { value, first, second } = self.series;
        let tangents = flat_mut(first).iter_mut().zip(flat_mut(second));
        for (x, (dx, ddx)) in flat_mut(&mut value[..self.lanes]).iter_mut().zip(tangents) {
            let [y, slope, curvature] = F::series::<SIMD>(*x);
            (*x, *dx, *ddx) = (y, slope * *dx, slope * *ddx + curvature * *dx * *dx);
        }
    }
}

/// Replaces values by the activation of them and notes its slopes.
pub(super) struct Record<'a, T, const SIMD: u8, const WIDTH: usize> {
    pub(super) values: &'a mut [Lanes<T, WIDTH>],
    pub(super) slopes: &'a mut [Lanes<T, WIDTH>],
}

impl<T: Real, const SIMD: u8, const WIDTH: usize> User<T> for Record<'_, T, SIMD, WIDTH> {
    #[inline(always)]
    fn run<F: Function<T>>(self) {
        for (x, slope) in flat_mut(self.values).iter_mut().zip(flat_mut(self.slopes)) {
            [*x, *slope, _] = F::series::<SIMD>(*x);
        }
    }
}

/// Passes the derivatives of the last layer through its activation at `values`.
fn pass_last(activation: Activation, values: &[f64], first: &mut [f64], second: Option<&mut [f64]>) {
    for ((x, dx), ddx) in values.iter().zip(&*first).zip(second.into_iter().flatten()) {
        let [_, slope, curvature] = series(activation, *x);
        *ddx = slope * *ddx + curvature * dx * dx;
    }
    for (x, dx) in values.iter().zip(first) {
        *dx *= series(activation, *x)[1];
    }
}
