//! Numbers that steps compute in, with or without derivatives.

use super::series::Series;
use crate::{
    numbers::jet::{Jet, Number},
    simd::{Real, flat, flat_mut},
};

/// Number type of a step: plain numbers, or numbers with derivatives along a curve.
pub(super) trait Cell: Number {
    const HAS_DERIVATIVES: bool;
    fn load<T: Real, const WIDTH: usize>(from: &Series<T, WIDTH>, index: usize) -> Self;
    fn store<T: Real, const WIDTH: usize>(self, to: &mut Series<T, WIDTH>, index: usize);
    /// A function of it, of which the value and the derivatives at a number are given.
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self;
}

impl Cell for f64 {
    const HAS_DERIVATIVES: bool = false;

    #[inline(always)]
    fn load<T: Real, const WIDTH: usize>(from: &Series<T, WIDTH>, index: usize) -> Self {
        flat(&from.value)[index].into()
    }

    #[inline(always)]
    fn store<T: Real, const WIDTH: usize>(self, to: &mut Series<T, WIDTH>, index: usize) {
        flat_mut(&mut to.value)[index] = T::narrow(self);
    }

    #[inline(always)]
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self {
        series(self)[0]
    }
}

impl Cell for Jet {
    const HAS_DERIVATIVES: bool = true;

    #[inline(always)]
    fn load<T: Real, const WIDTH: usize>(from: &Series<T, WIDTH>, index: usize) -> Self {
        let [value, first, second] = [&from.value, &from.first, &from.second].map(|of| flat(of)[index].into());
        Self { value, first, second }
    }

    #[inline(always)]
    fn store<T: Real, const WIDTH: usize>(self, to: &mut Series<T, WIDTH>, index: usize) {
        flat_mut(&mut to.value)[index] = T::narrow(self.value);
        flat_mut(&mut to.first)[index] = T::narrow(self.first);
        flat_mut(&mut to.second)[index] = T::narrow(self.second);
    }

    #[inline(always)]
    fn through(self, series: impl FnOnce(f64) -> [f64; 3]) -> Self {
        let [value, slope, curvature] = series(self.value);
        let Self { first, second, .. } = self;
        Self { value, first: slope * first, second: slope * second + curvature * first * first }
    }
}
