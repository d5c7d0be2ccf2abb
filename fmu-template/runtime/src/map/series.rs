//! Values with their derivatives, and how they pass through an activation.

use super::activation::{Function, User};
use crate::simd::{Lanes, Real, flat_mut};

/// Values of a layer with their first and second derivative along a curve.
#[derive(Clone, Debug)]
pub(crate) struct Series<T, const WIDTH: usize> {
    pub(super) value: Vec<Lanes<T, WIDTH>>,
    pub(super) first: Vec<Lanes<T, WIDTH>>,
    pub(super) second: Vec<Lanes<T, WIDTH>>,
}

impl<T: Real, const WIDTH: usize> Series<T, WIDTH> {
    pub(super) fn new(lanes: usize) -> Self {
        let zeros = vec![Lanes::ZERO; lanes];
        Self { value: zeros.clone(), first: zeros.clone(), second: zeros }
    }

    /// The value, its first and its second derivative.
    pub(super) fn orders_mut(&mut self) -> [&mut [Lanes<T, WIDTH>]; 3] {
        [&mut self.value, &mut self.first, &mut self.second]
    }

    pub(super) fn lanes(&self) -> usize {
        self.value.len()
    }
}

/// Passes values with their first and second derivatives through an activation.
pub(super) struct Pass<'a, T, const SIMD: u8, const WIDTH: usize> {
    pub(super) value: &'a mut [Lanes<T, WIDTH>],
    pub(super) first: &'a mut [Lanes<T, WIDTH>],
    pub(super) second: &'a mut [Lanes<T, WIDTH>],
}

impl<T: Real, const SIMD: u8, const WIDTH: usize> User<T> for Pass<'_, T, SIMD, WIDTH> {
    #[inline(always)]
    fn run<F: Function<T>>(self) {
        let tangents = flat_mut(self.first).iter_mut().zip(flat_mut(self.second));
        for (x, (dx, ddx)) in flat_mut(self.value).iter_mut().zip(tangents) {
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
