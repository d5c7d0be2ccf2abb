//! Activation functions in single precision, and their derivatives.

use super::{Lanes, Register};

/// An activation function.
pub(crate) trait Function {
    fn value<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N>;
}

/// The derivative of an activation function times something: `d f'(x)`.
pub(crate) trait Derivative {
    /// `from`: what the derivative is computed from.
    fn times<R: Register, const N: usize>(d: Lanes<R, N>, from: Lanes<R, N>) -> Lanes<R, N>;
}

/// `x`
pub(crate) struct Identity;

impl Function for Identity {
    #[inline(always)]
    fn value<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N> {
        x
    }
}

impl Derivative for Identity {
    #[inline(always)]
    fn times<R: Register, const N: usize>(d: Lanes<R, N>, _: Lanes<R, N>) -> Lanes<R, N> {
        d
    }
}

/// `tanh x`, absolute error below 1.2e-7, relative error below 3e-7, NaN for NaN. The derivative is from the value.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero.
pub(crate) struct Tanh;

impl Function for Tanh {
    #[inline(always)]
    fn value<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N> {
        // above 9.02, tanh x rounds to 1
        let magnitude = x.abs().at_most(Lanes::splat(9.1));
        let e = exp_minus_one(magnitude.add(magnitude));
        e.div(e.add(Lanes::splat(2.0))).copysign(x)
    }
}

impl Derivative for Tanh {
    #[inline(always)]
    fn times<R: Register, const N: usize>(d: Lanes<R, N>, y: Lanes<R, N>) -> Lanes<R, N> {
        Lanes::splat(1.0).sub(y.mul(y)).mul(d)
    }
}

/// `1 / (1 + exp(-x))`, absolute error below 1.2e-7, NaN for NaN. The derivative is from the value.
pub(crate) struct Sigmoid;

impl Function for Sigmoid {
    #[inline(always)]
    fn value<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N> {
        let half = Lanes::splat(0.5);
        Tanh::value(x.mul(half)).mul_add(half, half)
    }
}

impl Derivative for Sigmoid {
    #[inline(always)]
    fn times<R: Register, const N: usize>(d: Lanes<R, N>, y: Lanes<R, N>) -> Lanes<R, N> {
        y.sub(y.mul(y)).mul(d)
    }
}

/// `max(0, x)`, NaN for NaN. The derivative is from the value.
pub(crate) struct Relu;

impl Function for Relu {
    #[inline(always)]
    fn value<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N> {
        x.at_least_zero()
    }
}

impl Derivative for Relu {
    #[inline(always)]
    fn times<R: Register, const N: usize>(d: Lanes<R, N>, y: Lanes<R, N>) -> Lanes<R, N> {
        d.where_positive(y)
    }
}

/// `exp(x) - 1` for `0 <= x <= 18.2`: `x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`, scaled by `2^k`.
#[inline(always)]
fn exp_minus_one<R: Register, const N: usize>(x: Lanes<R, N>) -> Lanes<R, N> {
    // adding 1.5 * 2^23 rounds to an integer, which then stands in the low bits of the mantissa
    const ROUND: f32 = 12_582_912.0;
    const LN2_HIGH: f32 = 0.693_359_4; // 9 bits, so that k * LN2_HIGH is exact
    const LN2_LOW: f32 = -2.121_944_4e-4;
    // 1/2!, 1/3!, ..., 1/7!: the first omitted term is below 2e-8 of the sum
    const TAYLOR: [f32; 6] = [1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5_040.0];
    let shifted = x.mul_add(Lanes::splat(std::f32::consts::LOG2_E), Lanes::splat(ROUND));
    let k = shifted.sub(Lanes::splat(ROUND));
    let two_to_k = shifted.power_of_two();
    let r = k.mul_add(Lanes::splat(-LN2_LOW), k.mul_add(Lanes::splat(-LN2_HIGH), x));
    let mut sum = Lanes::splat(TAYLOR[5]);
    for &coefficient in TAYLOR[..5].iter().rev() {
        sum = sum.mul_add(r, Lanes::splat(coefficient));
    }
    let p = r.mul(r).mul_add(sum, r);
    two_to_k.mul_add(p, two_to_k.sub(Lanes::splat(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::kernels::{Kernel, Simd, WIDTH};
    use metafmu_runtime::Activation;

    const ALL: [Activation; 3] = [Activation::Tanh, Activation::Sigmoid, Activation::Relu];

    struct Values<'a> {
        activation: Activation,
        points: &'a mut [f32],
    }

    impl Kernel for Values<'_> {
        type Output = ();

        #[inline(always)]
        fn run<R: Register, const N: usize>(self) {
            for points in self.points.as_chunks_mut::<WIDTH>().0 {
                let x = Lanes::<R, N>::load(points);
                let y = match self.activation {
                    Activation::Tanh => Tanh::value(x),
                    Activation::Sigmoid => Sigmoid::value(x),
                    Activation::Relu => Relu::value(x),
                };
                y.store(points);
            }
        }
    }

    fn activate(simd: Simd, activation: Activation, points: &[f32]) -> Vec<f32> {
        let mut values = points.to_vec();
        values.resize(points.len().next_multiple_of(WIDTH), 0.0);
        simd.run(Values { activation, points: &mut values });
        values.truncate(points.len());
        values
    }

    fn reference(activation: Activation, x: f64) -> f64 {
        match activation {
            Activation::Tanh => x.tanh(),
            Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
            Activation::Relu => x.max(0.0),
        }
    }

    #[test]
    fn activations_keep_their_stated_error_on_every_instruction_set() {
        let dense = (-200_000..=200_000).map(|i| i as f32 * 1e-4);
        let small = (1..120).flat_map(|k| [2f32.powi(-k), -(2f32.powi(-k))]);
        let points: Vec<f32> = dense.chain(small).chain([0.0, 88.0, -300.0, 1e30, -1e30]).collect();
        for simd in Simd::available() {
            for activation in ALL {
                for (&x, found) in points.iter().zip(activate(simd, activation, &points)) {
                    let expected = reference(activation, x.into());
                    let bound = if activation == Activation::Relu { 0.0 } else { 1.2e-7 };
                    let error = (f64::from(found) - expected).abs();
                    assert!(error <= bound, "{simd:?} {activation:?} {x}: {found}, error {error:e}");
                }
            }
        }
    }

    #[test]
    fn tanh_is_accurate_relative_to_small_arguments_too() {
        let points: Vec<f32> = (1..400_000).map(|i| i as f32 * 1e-6).collect();
        for simd in Simd::available() {
            for (x, found) in points.iter().zip(activate(simd, Activation::Tanh, &points)) {
                let expected = f64::from(*x).tanh();
                let error = (f64::from(found) - expected).abs() / expected;
                assert!(error < 3e-7, "{simd:?} {x}: {error:e}");
            }
        }
    }

    #[test]
    fn nan_stays_nan_and_infinity_saturates() {
        for simd in Simd::available() {
            for activation in ALL {
                assert!(activate(simd, activation, &[f32::NAN])[0].is_nan(), "{simd:?} {activation:?}");
            }
            assert_eq!(activate(simd, Activation::Tanh, &[f32::INFINITY, f32::NEG_INFINITY]), [1.0, -1.0]);
            assert_eq!(activate(simd, Activation::Sigmoid, &[f32::INFINITY, f32::NEG_INFINITY]), [1.0, 0.0]);
        }
    }
}
