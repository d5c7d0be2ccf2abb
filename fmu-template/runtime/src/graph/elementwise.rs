//! Functions of one number, with their first and second derivatives.

use crate::numbers::activation::{self, Activation};

/// A function `f(x)` of one number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elementwise {
    /// One of the network's own.
    Activation(Activation),
    /// `p0 x + p1`
    Linear,
    /// `cos x`
    Cosine,
    /// `exp x`
    Exponential,
    /// `ln x`
    Logarithm,
    /// `1 / x`
    Reciprocal,
    /// `x^p0`; of a negative `x` for whole `p0` only.
    Power,
    /// `|x|`, of derivative 0 at 0.
    Absolute,
    /// `2 / √π` times the integral of `exp(-t²)` from 0 to `x`
    Erf,
    /// `x (1 + erf(x / √2)) / 2`: GELU without approximation, PyTorch's default.
    GeluExact,
    /// `x` if positive, else `p0 x`: leaky ReLU, PReLU.
    LeakyRelu,
    /// `x` if positive, else `p0 (exp(x) - 1)`: ELU; others are made of it and of [`Elementwise::Linear`].
    Elu,
    /// `ln(1 + exp x)`
    Softplus,
    /// `x / (1 + |x|)`
    Softsign,
    /// `x`, at least `p0` and at most `p1`.
    Clip,
    /// `x` if above `p0`, else 0.
    ThresholdedRelu,
    /// `atan x`
    Arctangent,
    /// `x` rounded to single precision, of derivative 1: what a model in single precision compares with thresholds.
    Single,
    /// 1 if `x` is positive, else 0; of derivative 0.
    Positive,
    /// `exp(-x / 2)`: of squared distances, a Gaussian kernel.
    Gaussian,
}

impl Elementwise {
    /// Those that are no activation.
    const OTHERS: [Self; 19] = [
        Self::Linear,
        Self::Cosine,
        Self::Exponential,
        Self::Logarithm,
        Self::Reciprocal,
        Self::Power,
        Self::Absolute,
        Self::Erf,
        Self::GeluExact,
        Self::LeakyRelu,
        Self::Elu,
        Self::Softplus,
        Self::Softsign,
        Self::Clip,
        Self::ThresholdedRelu,
        Self::Arctangent,
        Self::Single,
        Self::Positive,
        Self::Gaussian,
    ];

    /// Code of the first one that is no activation.
    const FIRST_OTHER: usize = 32;

    /// All of them: activations first.
    pub fn all() -> impl Iterator<Item = Self> {
        Activation::ALL.into_iter().map(Self::Activation).chain(Self::OTHERS)
    }

    /// The one of a code in the model file: position of an activation in [`Activation::ALL`], or 32 and more.
    pub(super) fn of_code(code: usize) -> Option<Self> {
        match code.checked_sub(Self::FIRST_OTHER) {
            None => Activation::ALL.get(code).copied().map(Self::Activation),
            Some(other) => Self::OTHERS.get(other).copied(),
        }
    }

    pub(super) fn code(self) -> usize {
        if let Self::Activation(activation) = self {
            return Activation::ALL.iter().position(|known| *known == activation).unwrap_or_default();
        }
        Self::FIRST_OTHER + Self::OTHERS.iter().position(|known| *known == self).unwrap_or_default()
    }

    /// How many parameters it has, `p0` and `p1`.
    pub fn parameters(self) -> usize {
        match self {
            Self::Linear | Self::Clip => 2,
            Self::Power | Self::LeakyRelu | Self::Elu | Self::ThresholdedRelu => 1,
            _ => 0,
        }
    }

    /// Returns true if the function is continuous and its slope seldom far from 1.
    pub(super) fn is_smooth(self) -> bool {
        let is_steep =
            matches!(self, Self::Exponential | Self::Gaussian | Self::Logarithm | Self::Reciprocal | Self::Power);
        !is_steep && !matches!(self, Self::ThresholdedRelu | Self::Single | Self::Positive)
    }

    /// `f(x)` with its parameters; those that it does not have are not looked at.
    pub fn value(self, x: f64, parameters: [f64; 2]) -> f64 {
        self.series(x, parameters)[0]
    }

    /// The value with its first and second derivative; what has a kink has the derivatives of one side there.
    pub fn series(self, x: f64, p: [f64; 2]) -> [f64; 3] {
        match self {
            Self::Activation(activation) => activation::series(activation, x),
            Self::Linear => [p[0] * x + p[1], p[0], 0.0],
            Self::Cosine => {
                let (sine, cosine) = x.sin_cos();
                [cosine, -sine, -cosine]
            }
            Self::Exponential => [x.exp(); 3],
            Self::Logarithm => [x.ln(), 1.0 / x, -1.0 / (x * x)],
            Self::Reciprocal => {
                let y = 1.0 / x;
                [y, -y * y, 2.0 * y * y * y]
            }
            Self::Power => power(x, p[0]),
            Self::Absolute => [x.abs(), if x == 0.0 { 0.0 } else { x.signum() }, 0.0],
            Self::Erf => erf_series(x),
            Self::GeluExact => {
                let [erf, slope, _] = erf_series(x * std::f64::consts::FRAC_1_SQRT_2);
                // of the normal distribution: its density, and its integral
                let density = 0.5 * slope * std::f64::consts::FRAC_1_SQRT_2;
                let integral = 0.5 * (1.0 + erf);
                [x * integral, integral + x * density, density * (2.0 - x * x)]
            }
            Self::LeakyRelu => {
                let slope = if x > 0.0 { 1.0 } else { p[0] };
                [slope * x, slope, 0.0]
            }
            Self::Elu if x > 0.0 => [x, 1.0, 0.0],
            Self::Elu => {
                let slope = p[0] * x.exp();
                [p[0] * x.exp_m1(), slope, slope]
            }
            Self::Softplus => {
                let [_, slope, curvature] = Self::Activation(Activation::Sigmoid).shifted(x);
                [x.max(0.0) + (-x.abs()).exp().ln_1p(), slope, curvature]
            }
            Self::Softsign => {
                let y = 1.0 / (1.0 + x.abs());
                [x * y, y * y, -2.0 * y * y * y * x.signum()]
            }
            Self::Clip => match x {
                _ if x < p[0] => [p[0], 0.0, 0.0],
                _ if x > p[1] => [p[1], 0.0, 0.0],
                _ => [x, 1.0, 0.0],
            },
            Self::ThresholdedRelu => {
                let slope = if x > p[0] { 1.0 } else { 0.0 };
                [slope * x, slope, 0.0]
            }
            Self::Arctangent => {
                let slope = 1.0 / (1.0 + x * x);
                [x.atan(), slope, -2.0 * x * slope * slope]
            }
            Self::Single => [f64::from(x as f32), 1.0, 0.0],
            Self::Gaussian => {
                let y = (-0.5 * x).exp();
                [y, -0.5 * y, 0.25 * y]
            }
            Self::Positive => [if x > 0.0 { 1.0 } else { 0.0 }, 0.0, 0.0],
        }
    }

    /// The derivatives of an integral of the function: its value and its slope stand one place later.
    fn shifted(self, x: f64) -> [f64; 3] {
        let [value, slope, _] = self.series(x, [0.0; 2]);
        [0.0, value, slope]
    }
}

fn power(x: f64, exponent: f64) -> [f64; 3] {
    let first = exponent;
    let second = exponent * (exponent - 1.0);
    [power_of(x, exponent), scaled_power(first, x, exponent - 1.0), scaled_power(second, x, exponent - 2.0)]
}

/// `factor * x^exponent`, but zero for a factor of zero, as the power may be infinite at 0.
#[inline]
fn scaled_power(factor: f64, x: f64, exponent: f64) -> f64 {
    if factor == 0.0 { 0.0 } else { factor * power_of(x, exponent) }
}

fn power_of(x: f64, exponent: f64) -> f64 {
    match exponent {
        0.5 => x.sqrt(),
        -0.5 => 1.0 / x.sqrt(),
        2.0 => x * x,
        3.0 => x * x * x,
        _ => x.powf(exponent),
    }
}

fn erf_series(x: f64) -> [f64; 3] {
    let slope = std::f64::consts::FRAC_2_SQRT_PI * (-x * x).exp();
    [libm::erf(x), slope, -2.0 * x * slope]
}
