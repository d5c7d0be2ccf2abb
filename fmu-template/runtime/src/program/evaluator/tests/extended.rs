//! Numbers of about 106 bits as the unevaluated sum of two doubles, for finite differences that are as good as exact.

use std::ops::{Add, Div, Mul, Neg, Sub};

#[derive(Clone, Copy, Debug)]
pub struct Extended {
    high: f64,
    low: f64,
}

impl Extended {
    /// The exact sum of two doubles.
    fn sum(a: f64, b: f64) -> Self {
        let high = a + b;
        let part = high - a;
        Self { high, low: (a - (high - part)) + (b - part) }
    }

    pub fn to_f64(self) -> f64 {
        self.high + self.low
    }

    /// By the Taylor series at `x / 2^10`, squared ten times; as `exp(x) - 1`, for small `x` keep their digits so.
    fn exp_minus_one(self) -> Self {
        let small = self * (1.0 / 1024.0).into();
        let mut sum = Self::from(0.0);
        for n in (1..=16).rev() {
            sum = (sum + 1.0.into()) * small / f64::from(n).into();
        }
        for _ in 0..10 {
            sum = sum * (sum + 2.0.into());
        }
        sum
    }

    /// By the Taylor series, for arguments of a few units.
    pub fn sin(self) -> Self {
        let mut sum = Self::from(0.0);
        for n in (1..=35).rev() {
            let factors = f64::from(2 * n * (2 * n + 1));
            sum = (sum + 1.0.into()) * -(self * self) / factors.into();
        }
        self * (sum + 1.0.into())
    }

    pub fn tanh(self) -> Self {
        if self.high < 0.0 {
            return -(-self).tanh();
        }
        let e = (self * 2.0.into()).exp_minus_one();
        e / (e + 2.0.into())
    }
}

impl From<f64> for Extended {
    fn from(high: f64) -> Self {
        Self { high, low: 0.0 }
    }
}

impl Neg for Extended {
    type Output = Self;
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Add for Extended {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let (high, low) = (Self::sum(self.high, other.high), Self::sum(self.low, other.low));
        let first = Self::sum(high.high, high.low + low.high);
        Self::sum(first.high, first.low + low.low)
    }
}

impl Sub for Extended {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Extended {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let high = self.high * other.high;
        let rest = self.high.mul_add(other.high, -high);
        Self::sum(high, rest + (self.high * other.low + self.low * other.high))
    }
}

impl Div for Extended {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * first.into();
        let second = rest.high / other.high;
        let rest = rest - other * second.into();
        Self::sum(first, second) + (rest.high / other.high).into()
    }
}

#[test]
fn a_third_is_exact_to_thirty_digits_and_tanh_is_that_of_doubles() {
    let one = Extended::from(1.0);
    let rest = one - one / 3.0.into() - one / 3.0.into() - one / 3.0.into();
    assert!(rest.to_f64().abs() < 1e-31);
    let half = Extended::from(0.5).tanh();
    // tanh(1) = 2 t / (1 + t^2) of t = tanh(1/2)
    let doubled = half * 2.0.into() / (one + half * half);
    assert!((doubled - one.tanh()).to_f64().abs() < 1e-30);
    assert!((one.tanh().to_f64() - 1f64.tanh()).abs() < 1e-15);
}
