//! Values with their derivatives.

use crate::{
    numbers::activation::PAIR,
    simd::{Lanes, Real},
};

/// Values of a layer with their first and second derivative along a curve.
#[derive(Clone, Debug)]
pub(crate) struct Series<T, const WIDTH: usize> {
    pub(super) value: Vec<Lanes<T, WIDTH>>,
    pub(super) first: Vec<Lanes<T, WIDTH>>,
    pub(super) second: Vec<Lanes<T, WIDTH>>,
}

impl<T: Real, const WIDTH: usize> Series<T, WIDTH> {
    #[inline(never)]
    pub(super) fn new(lanes: usize) -> Self {
        let zeros = vec![Lanes::ZERO; lanes.next_multiple_of(PAIR)];
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
