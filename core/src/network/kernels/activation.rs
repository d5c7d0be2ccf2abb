//! Activation functions in single precision, and their derivatives.

use super::{Portable, SimdLanes};
use metafmu_runtime::Activation;

/// An activation function.
pub(crate) trait ActivationFunction {
    /// Method that computes its derivative in the backward pass.
    type Derivative: Derivative;

    fn value<L: SimdLanes>(x: L) -> L;

    /// `f(x)` and `f'(x)`.
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L);
}

/// The derivative of an activation function times something: `d f'(x)`.
pub(crate) trait Derivative {
    /// `true` if it is computed from the function's value; otherwise from the derivative, stored in the forward pass.
    const FOLLOWS_FROM_VALUE: bool;

    /// `from`: what the derivative is computed from.
    fn times<L: SimdLanes>(d: L, from: L) -> L;
}

/// Work with an activation function that is known when the program is compiled. Its fields are its arguments: a closure would
/// not be compiled with the caller's instruction set.
pub(crate) trait ActivationVisitor {
    /// Result of the work.
    type Output;

    /// Does the work with the function `F`. To be marked `#[inline(always)]`, as
    /// [`SimdKernel::run`](super::SimdKernel::run).
    fn visit<L: SimdLanes, F: ActivationFunction>(self) -> Self::Output;
}

/// Has a visitor work with the function of an activation.
#[inline(always)]
pub(crate) fn visit<L: SimdLanes, V: ActivationVisitor>(activation: Activation, visitor: V) -> V::Output {
    match activation {
        Activation::Tanh => visitor.visit::<L, TanhActivation>(),
        Activation::Sigmoid => visitor.visit::<L, SigmoidActivation>(),
        Activation::Relu => visitor.visit::<L, ReluActivation>(),
        Activation::Gelu => visitor.visit::<L, GeluActivation>(),
        Activation::Silu => visitor.visit::<L, SiluActivation>(),
        Activation::Sine => visitor.visit::<L, SineActivation>(),
        Activation::Identity => visitor.visit::<L, IdentityActivation>(),
    }
}

/// Returns true if the derivative of an activation follows from its value.
pub(crate) fn slope_follows_from_value(activation: Activation) -> bool {
    struct FollowsFromValue;

    impl ActivationVisitor for FollowsFromValue {
        type Output = bool;

        #[inline(always)]
        fn visit<L: SimdLanes, F: ActivationFunction>(self) -> bool {
            F::Derivative::FOLLOWS_FROM_VALUE
        }
    }

    visit::<Portable, _>(activation, FollowsFromValue)
}

/// A derivative that was stored in the forward pass.
pub(crate) struct Stored;

impl Derivative for Stored {
    const FOLLOWS_FROM_VALUE: bool = false;

    #[inline(always)]
    fn times<L: SimdLanes>(d: L, slope: L) -> L {
        d.mul(slope)
    }
}

/// `x`
pub(crate) struct IdentityActivation;

impl ActivationFunction for IdentityActivation {
    type Derivative = Self;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        x
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        (x, L::splat(1.0))
    }
}

impl Derivative for IdentityActivation {
    const FOLLOWS_FROM_VALUE: bool = true;

    #[inline(always)]
    fn times<L: SimdLanes>(d: L, _: L) -> L {
        d
    }
}

/// `tanh x`, absolute error below 1.2e-7, relative error below 3e-7, NaN for NaN. The derivative is from the value.
///
/// With `e = exp(2|x|) - 1`, `tanh |x| = e / (e + 2)`, which loses nothing near zero.
pub(crate) struct TanhActivation;

impl ActivationFunction for TanhActivation {
    type Derivative = Self;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        // above 9.02, tanh x rounds to 1
        let magnitude = x.abs().at_most(L::splat(9.1));
        let e = exp_minus_one(magnitude.add(magnitude));
        e.div(e.add(L::splat(2.0))).copysign(x)
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        let y = Self::value(x);
        (y, Self::times(L::splat(1.0), y))
    }
}

impl Derivative for TanhActivation {
    const FOLLOWS_FROM_VALUE: bool = true;

    #[inline(always)]
    fn times<L: SimdLanes>(d: L, y: L) -> L {
        L::splat(1.0).sub(y.mul(y)).mul(d)
    }
}

/// `1 / (1 + exp(-x))`, absolute error below 1.2e-7, NaN for NaN. The derivative is from the value.
pub(crate) struct SigmoidActivation;

impl ActivationFunction for SigmoidActivation {
    type Derivative = Self;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        let half = L::splat(0.5);
        TanhActivation::value(x.mul(half)).mul_add(half, half)
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        let y = Self::value(x);
        (y, Self::times(L::splat(1.0), y))
    }
}

impl Derivative for SigmoidActivation {
    const FOLLOWS_FROM_VALUE: bool = true;

    #[inline(always)]
    fn times<L: SimdLanes>(d: L, y: L) -> L {
        y.sub(y.mul(y)).mul(d)
    }
}

/// `max(0, x)`, NaN for NaN. The derivative is from the value.
pub(crate) struct ReluActivation;

impl ActivationFunction for ReluActivation {
    type Derivative = Self;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        x.at_least_zero()
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        let y = Self::value(x);
        (y, Self::times(L::splat(1.0), y))
    }
}

impl Derivative for ReluActivation {
    const FOLLOWS_FROM_VALUE: bool = true;

    #[inline(always)]
    fn times<L: SimdLanes>(d: L, y: L) -> L {
        d.where_positive(y)
    }
}

/// `x (1 + tanh u) / 2` with `u = √(2/π) (x + 0.044715 x³)`: PyTorch's `gelu` with `approximate="tanh"`. Error below 2e-7
/// of `max(1, |x|)`, NaN for NaN.
pub(crate) struct GeluActivation;

impl GeluActivation {
    const LINEAR: f32 = 0.797_884_6; // √(2/π)
    const CUBIC: f32 = 0.035_677_407; // 0.044715 √(2/π)
}

impl ActivationFunction for GeluActivation {
    type Derivative = Stored;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        Self::value_and_slope(x).0
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        let splat = L::splat;
        let (half, square) = (x.mul(splat(0.5)), x.mul(x));
        let t = TanhActivation::value(square.mul_add(splat(Self::CUBIC), splat(Self::LINEAR)).mul(x));
        let u_slope = square.mul_add(splat(3.0 * Self::CUBIC), splat(Self::LINEAR));
        let share = t.mul_add(splat(0.5), splat(0.5));
        // where the cube overflows, tanh is flat
        let t_slope = TanhActivation::times(half, t).mul(u_slope.at_most(splat(1e30)));
        (half.mul_add(t, half), share.add(t_slope))
    }
}

/// `x / (1 + exp(-x))`, error below 2e-7 of `max(1, |x|)`, NaN for NaN.
pub(crate) struct SiluActivation;

impl ActivationFunction for SiluActivation {
    type Derivative = Stored;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        x.mul(SigmoidActivation::value(x))
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        let share = SigmoidActivation::value(x);
        (x.mul(share), x.mul_add(SigmoidActivation::times(L::splat(1.0), share), share))
    }
}

/// `sin x`, absolute error below 2e-7 for `|x|` up to 8192, beyond which it grows with `x`; NaN for NaN.
///
/// With `x = k π + r`, `|r| <= π / 2`, the Taylor polynomials of `r`, with the sign of `(-1)^k`.
pub(crate) struct SineActivation;

impl ActivationFunction for SineActivation {
    type Derivative = Stored;

    #[inline(always)]
    fn value<L: SimdLanes>(x: L) -> L {
        Self::value_and_slope(x).0
    }

    #[inline(always)]
    fn value_and_slope<L: SimdLanes>(x: L) -> (L, L) {
        // π in parts: products of the first ones with small integers are exact
        const PI: [f32; 3] = [3.140_625, 9.675_026e-4, 1.509_958e-7];
        // -1/3!, 1/5!, ..., 1/13! and -1/2!, 1/4!, ..., 1/12!: the first omitted terms are below 7e-10 and 7e-9
        const SINE: [f32; 6] =
            [-1.0 / 6.0, 1.0 / 120.0, -1.0 / 5_040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0, 1.0 / 6_227_020_800.0];
        const COSINE: [f32; 6] =
            [-1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0, 1.0 / 40_320.0, -1.0 / 3_628_800.0, 1.0 / 479_001_600.0];
        let shifted = x.mul_add(L::splat(std::f32::consts::FRAC_1_PI), L::splat(ROUND));
        let k = shifted.sub(L::splat(ROUND));
        let mut r = x;
        for part in PI {
            r = k.mul_add(L::splat(-part), r);
        }
        let square = r.mul(r);
        let (mut sine, mut cosine) = (L::splat(SINE[5]), L::splat(COSINE[5]));
        for i in (0..5).rev() {
            sine = sine.mul_add(square, L::splat(SINE[i]));
            cosine = cosine.mul_add(square, L::splat(COSINE[i]));
        }
        let sine = r.mul(square).mul_add(sine, r);
        let cosine = cosine.mul_add(square, L::splat(1.0));
        (sine.alternate(shifted), cosine.alternate(shifted))
    }
}

/// Adding 1.5 * 2^23 rounds to an integer, which is then in the low bits of the mantissa.
const ROUND: f32 = 12_582_912.0;

/// `exp(x) - 1` for `0 <= x <= 18.2`: `x = k ln 2 + r` with `|r| <= ln(2) / 2`, a Taylor polynomial in `r`, scaled by `2^k`.
#[inline(always)]
fn exp_minus_one<L: SimdLanes>(x: L) -> L {
    const LN2_HIGH: f32 = 0.693_359_4; // 9 bits, so that k * LN2_HIGH is exact
    const LN2_LOW: f32 = -2.121_944_4e-4;
    // 1/2!, 1/3!, ..., 1/7!: the first omitted term is below 2e-8 of the sum
    const TAYLOR: [f32; 6] = [1.0 / 2.0, 1.0 / 6.0, 1.0 / 24.0, 1.0 / 120.0, 1.0 / 720.0, 1.0 / 5_040.0];
    let shifted = x.mul_add(L::splat(std::f32::consts::LOG2_E), L::splat(ROUND));
    let k = shifted.sub(L::splat(ROUND));
    let two_to_k = shifted.power_of_two();
    let r = k.mul_add(L::splat(-LN2_LOW), k.mul_add(L::splat(-LN2_HIGH), x));
    let mut sum = L::splat(TAYLOR[5]);
    for &coefficient in TAYLOR[..5].iter().rev() {
        sum = sum.mul_add(r, L::splat(coefficient));
    }
    let p = r.mul(r).mul_add(sum, r);
    two_to_k.mul_add(p, two_to_k.sub(L::splat(1.0)))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::network::kernels::{InstructionSet, SimdKernel, WIDTH};

    /// Replaces points by values, and puts the derivatives into `slopes`.
    struct ActivationValues<'a> {
        activation: Activation,
        points: &'a mut [f32],
        slopes: &'a mut [f32],
    }

    impl SimdKernel for ActivationValues<'_> {
        type Output = ();

        #[inline(always)]
        fn run<L: SimdLanes>(self) {
            visit::<L, _>(self.activation, self);
        }
    }

    impl ActivationVisitor for ActivationValues<'_> {
        type Output = ();

        #[inline(always)]
        fn visit<L: SimdLanes, F: ActivationFunction>(self) {
            for (points, slopes) in
                self.points.as_chunks_mut::<WIDTH>().0.iter_mut().zip(self.slopes.as_chunks_mut::<WIDTH>().0)
            {
                let x = L::load(points);
                let (y, slope) = F::value_and_slope(x);
                F::value(x).store(points);
                slope.store(slopes);
                let mut again = [0.0; WIDTH];
                y.store(&mut again);
                assert!(again.iter().zip(&*points).all(|(a, b)| a == b || a.is_nan() && b.is_nan()), "{again:?}");
            }
        }
    }

    fn activate(simd: InstructionSet, activation: Activation, points: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let mut values = points.to_vec();
        values.resize(points.len().next_multiple_of(WIDTH), 0.0);
        let mut slopes = values.clone();
        simd.run(ActivationValues { activation, points: &mut values, slopes: &mut slopes });
        values.truncate(points.len());
        slopes.truncate(points.len());
        (values, slopes)
    }

    /// The textbook formulas of the function and its derivative.
    pub(crate) fn reference(activation: Activation, x: f64) -> (f64, f64) {
        let sigmoid = |x: f64| 1.0 / (1.0 + (-x).exp());
        let s = sigmoid(x);
        match activation {
            Activation::Tanh => (x.tanh(), 1.0 - x.tanh().powi(2)),
            Activation::Sigmoid => (s, s * sigmoid(-x)),
            Activation::Relu => (x.max(0.0), if x > 0.0 { 1.0 } else { 0.0 }),
            Activation::Gelu => {
                let c = (2.0 / std::f64::consts::PI).sqrt();
                let (t, u) = ((c * (x + 0.044715 * x * x * x)).tanh(), c * (1.0 + 3.0 * 0.044715 * x * x));
                (0.5 * x * (1.0 + t), 0.5 * (1.0 + t) + 0.5 * x * (1.0 - t * t) * u)
            }
            Activation::Silu => (x * s, s + x * s * sigmoid(-x)),
            Activation::Sine => (x.sin(), x.cos()),
            Activation::Identity => (x, 1.0),
        }
    }

    #[test]
    fn activations_and_their_derivatives_keep_their_stated_error_on_every_instruction_set() {
        let dense = (-200_000..=200_000).map(|i| i as f32 * 1e-4);
        let wide = (-8_000..8_000).map(|i| i as f32 + 0.37);
        let small = (1..120).flat_map(|k| [2f32.powi(-k), -(2f32.powi(-k))]);
        let points: Vec<f32> = dense.chain(wide).chain(small).chain([0.0, 88.0, -300.0, 1e30, -1e30]).collect();
        for simd in InstructionSet::available() {
            for activation in Activation::ALL {
                let points: Vec<f32> =
                    points.iter().copied().filter(|x| activation != Activation::Sine || x.abs() < 8192.0).collect();
                let (values, slopes) = activate(simd, activation, &points);
                for ((&x, found), slope) in points.iter().zip(values).zip(slopes) {
                    let (expected, expected_slope) = reference(activation, x.into());
                    let (bound, slope_bound) = match activation {
                        Activation::Relu | Activation::Identity => (0.0, 0.0),
                        Activation::Tanh | Activation::Sigmoid => (1.2e-7, 2.4e-7),
                        Activation::Sine => (2e-7, 2e-7),
                        Activation::Gelu | Activation::Silu => (2e-7 * f64::from(x.abs()).max(1.0), 3e-6),
                    };
                    let error = (f64::from(found) - expected).abs();
                    assert!(error <= bound, "{simd:?} {activation:?} {x}: {found}, error {error:e}");
                    let error = (f64::from(slope) - expected_slope).abs();
                    assert!(error <= slope_bound, "{simd:?} {activation:?}' {x}: {slope}, error {error:e}");
                }
            }
        }
    }

    #[test]
    fn tanh_is_accurate_relative_to_small_arguments_too() {
        let points: Vec<f32> = (1..400_000).map(|i| i as f32 * 1e-6).collect();
        for simd in InstructionSet::available() {
            for (x, found) in points.iter().zip(activate(simd, Activation::Tanh, &points).0) {
                let expected = f64::from(*x).tanh();
                let error = (f64::from(found) - expected).abs() / expected;
                assert!(error < 3e-7, "{simd:?} {x}: {error:e}");
            }
        }
    }

    #[test]
    fn nan_stays_nan_and_infinity_saturates() {
        for simd in InstructionSet::available() {
            for activation in Activation::ALL {
                assert!(activate(simd, activation, &[f32::NAN]).0[0].is_nan(), "{simd:?} {activation:?}");
            }
            assert_eq!(activate(simd, Activation::Tanh, &[f32::INFINITY, f32::NEG_INFINITY]).0, [1.0, -1.0]);
            assert_eq!(activate(simd, Activation::Sigmoid, &[f32::INFINITY, f32::NEG_INFINITY]).0, [1.0, 0.0]);
        }
    }
}
