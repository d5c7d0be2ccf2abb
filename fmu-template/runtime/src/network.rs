//! The network between standardised inputs and standardised outputs, in either precision.

use crate::{
    Activation, Layer, activation,
    layers::{Dense, Order, Rows},
    simd::{Lanes, Real, flat, flat_mut, flush},
};

/// Hidden layers and a linear last one.
#[derive(Clone, Debug)]
pub(crate) struct Network<T, const WIDTH: usize> {
    activation: Activation,
    hidden: Vec<Dense<T, WIDTH>>,
    last: Rows<T, WIDTH>,
}

/// Values of a layer with their first and second derivative along a curve.
#[derive(Clone, Debug)]
pub(crate) struct Series<T, const WIDTH: usize> {
    value: Vec<Lanes<T, WIDTH>>,
    first: Vec<Lanes<T, WIDTH>>,
    second: Vec<Lanes<T, WIDTH>>,
}

/// Working memory: the layer at hand, the one after it, and the slopes of all activations.
#[derive(Clone, Debug)]
pub(crate) struct Buffers<T, const WIDTH: usize> {
    current: Series<T, WIDTH>,
    next: Series<T, WIDTH>,
    slopes: Vec<Vec<Lanes<T, WIDTH>>>,
    /// Order of the next evaluation.
    order: Order,
}

impl<T: Real, const WIDTH: usize> Series<T, WIDTH> {
    fn new(lanes: usize) -> Self {
        let zeros = vec![Lanes::ZERO; lanes];
        Self { value: zeros.clone(), first: zeros.clone(), second: zeros }
    }

    /// Passes the first `lanes` through a function that gives value, slope and curvature.
    #[inline(always)]
    fn pass(&mut self, lanes: usize, function: impl Fn(T) -> [T; 3]) {
        let tangents = flat_mut(&mut self.first).iter_mut().zip(flat_mut(&mut self.second));
        for (x, (dx, ddx)) in flat_mut(&mut self.value[..lanes]).iter_mut().zip(tangents) {
            let [y, slope, curvature] = function(*x);
            (*x, *dx, *ddx) = (y, slope * *dx, slope * *ddx + curvature * *dx * *dx);
        }
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
    pub(crate) fn new(layers: &[Layer], activation: Activation) -> Self {
        let (last, hidden) = layers.split_last().expect("a network has at least one layer");
        let hidden = hidden.iter().map(Dense::new).collect();
        Self { activation, hidden, last: Rows::new(last) }
    }

    pub(crate) fn buffers(&self, inputs: usize) -> Buffers<T, WIDTH> {
        let widest =
            self.hidden.iter().map(Dense::lanes).fold(inputs.div_ceil(WIDTH).max(self.last.outputs()), usize::max);
        let slopes = self.hidden.iter().map(|layer| vec![Lanes::ZERO; layer.lanes()]).collect();
        Buffers { current: Series::new(widest), next: Series::new(widest), slopes, order: Order::Forward }
    }

    /// Outputs for the inputs that are loaded.
    #[inline(always)]
    pub(crate) fn forward<const FMA: bool>(&self, buffers: &mut Buffers<T, WIDTH>, outputs: &mut [f64]) {
        let (current, next) = (&mut buffers.current.value, &mut buffers.next.value);
        for layer in &self.hidden {
            layer.apply::<FMA, true>(current, next, buffers.order, self.activation);
            std::mem::swap(current, next);
        }
        self.last.apply::<FMA, true>(current, outputs, next);
        buffers.order.reverse();
    }

    /// First derivatives of the outputs, and second ones if there is a slice for them, along the curve whose value and
    /// derivatives are loaded.
    #[inline(always)]
    pub(crate) fn series<const FMA: bool>(
        &self,
        buffers: &mut Buffers<T, WIDTH>,
        first: &mut [f64],
        second: Option<&mut [f64]>,
    ) {
        let Buffers { current, next, .. } = buffers;
        for layer in &self.hidden {
            layer.apply::<FMA, true>(&current.value, &mut next.value, Order::Forward, Activation::Identity);
            layer.apply::<FMA, false>(&current.first, &mut next.first, Order::Forward, Activation::Identity);
            if second.is_some() {
                layer.apply::<FMA, false>(&current.second, &mut next.second, Order::Forward, Activation::Identity);
            }
            match self.activation {
                Activation::Tanh => next.pass(layer.lanes(), activation::tanh_series::<T, FMA>),
                Activation::Sigmoid => next.pass(layer.lanes(), activation::sigmoid_series::<T, FMA>),
                Activation::Relu => next.pass(layer.lanes(), activation::relu_series),
                Activation::Gelu => next.pass(layer.lanes(), activation::gelu_series::<T, FMA>),
                Activation::Silu => next.pass(layer.lanes(), activation::silu_series::<T, FMA>),
                Activation::Sine => next.pass(layer.lanes(), activation::sine_series::<T, FMA>),
                Activation::Identity => next.pass(layer.lanes(), activation::identity_series),
            }
            std::mem::swap(current, next);
        }
        self.last.apply::<FMA, false>(&mut current.first, first, &mut next.first);
        if let Some(second) = second {
            self.last.apply::<FMA, false>(&mut current.second, second, &mut next.second);
        }
    }

    /// `J^T weights` at the inputs that are loaded; the result is [`Buffers::gradient`].
    #[inline(always)]
    pub(crate) fn adjoint<const FMA: bool>(&self, buffers: &mut Buffers<T, WIDTH>, weights: impl Iterator<Item = f64>) {
        let Buffers { current, next, slopes, .. } = buffers;
        let (current, next) = (&mut current.value, &mut next.value);
        for (layer, slopes) in self.hidden.iter().zip(&mut *slopes) {
            layer.apply::<FMA, true>(current, next, Order::Forward, Activation::Identity);
            match self.activation {
                Activation::Tanh => record(next, slopes, activation::tanh_series::<T, FMA>),
                Activation::Sigmoid => record(next, slopes, activation::sigmoid_series::<T, FMA>),
                Activation::Relu => record(next, slopes, activation::relu_series),
                Activation::Gelu => record(next, slopes, activation::gelu_series::<T, FMA>),
                Activation::Silu => record(next, slopes, activation::silu_series::<T, FMA>),
                Activation::Sine => record(next, slopes, activation::sine_series::<T, FMA>),
                Activation::Identity => record(next, slopes, activation::identity_series),
            }
            std::mem::swap(current, next);
        }
        self.last.apply_transposed::<FMA>(weights.map(T::narrow), current);
        for (layer, slopes) in self.hidden.iter().zip(&*slopes).rev() {
            flat_mut(current).iter_mut().zip(flat(slopes)).for_each(|(x, &slope)| *x = *x * slope);
            layer.apply_transposed::<FMA>(&current[..layer.lanes()], next);
            std::mem::swap(current, next);
        }
    }
}

/// Replaces values by the function of them and notes its slopes.
#[inline(always)]
fn record<T: Real, const WIDTH: usize>(
    values: &mut [Lanes<T, WIDTH>],
    slopes: &mut [Lanes<T, WIDTH>],
    function: impl Fn(T) -> [T; 3],
) {
    for (x, slope) in flat_mut(values).iter_mut().zip(flat_mut(slopes)) {
        [*x, *slope, _] = function(*x);
    }
}
