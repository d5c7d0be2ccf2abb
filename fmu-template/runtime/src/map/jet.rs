//! Numbers that carry their derivatives: a formula written once gives values and exact derivatives along a curve.

use std::ops::{Add, Mul, Sub};

/// What a formula is computed in: plain numbers, or [`Jet`]s.
pub(crate) trait Number:
    Copy + From<f64> + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// Without derivatives.
    fn value(self) -> f64;
    fn exp(self) -> Self;
    fn sin_cos(self) -> (Self, Self);
    fn recip(self) -> Self;
}

/// A value with its first and second derivative along a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Jet {
    pub(crate) value: f64,
    pub(crate) first: f64,
    pub(crate) second: f64,
}

impl Number for f64 {
    fn value(self) -> f64 {
        self
    }

    fn exp(self) -> Self {
        self.exp()
    }

    fn sin_cos(self) -> (Self, Self) {
        self.sin_cos()
    }

    fn recip(self) -> Self {
        self.recip()
    }
}

impl Number for Jet {
    fn value(self) -> f64 {
        self.value
    }

    fn exp(self) -> Self {
        let value = self.value.exp();
        let Self { first, second, .. } = self;
        Self { value, first: value * first, second: value * (second + first * first) }
    }

    fn sin_cos(self) -> (Self, Self) {
        let Self { value, first, second } = self;
        let (sine, cosine) = value.sin_cos();
        let of = |value: f64, slope: f64| Self {
            value,
            first: slope * first,
            second: slope * second - value * first * first,
        };
        (of(sine, cosine), of(cosine, -sine))
    }

    fn recip(self) -> Self {
        let value = self.value.recip();
        let slope = -value * value;
        let Self { first, second, .. } = self;
        Self { value, first: slope * first, second: slope * (second - 2.0 * value * first * first) }
    }
}

impl From<f64> for Jet {
    fn from(value: f64) -> Self {
        Self { value, first: 0.0, second: 0.0 }
    }
}

impl Add for Jet {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self { value: self.value + value, first: self.first + first, second: self.second + second }
    }
}

impl Sub for Jet {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self { value: self.value - value, first: self.first - first, second: self.second - second }
    }
}

impl Mul for Jet {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self {
            value: self.value * value,
            first: self.first * value + self.value * first,
            second: self.second * value + 2.0 * self.first * first + self.value * second,
        }
    }
}
