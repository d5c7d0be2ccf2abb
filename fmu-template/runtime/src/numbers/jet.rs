//! Numbers that carry their derivatives: a formula written once gives values and exact derivatives along a curve.

use super::{elementary::ElementaryFunction, exponential};
use crate::simd;
use std::ops::{Add, Mul, Sub};

/// Number type of a formula: plain numbers, or [`Jet`]s, also of jets.
pub(crate) trait Number:
    Copy + PartialEq + From<f64> + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// How many series it is in one another.
    const DEPTH: usize;
    /// Without derivatives.
    fn value(self) -> f64;
    /// First one of the value and its derivatives that is not zero: its sign is the number's an instant later.
    fn leading(self) -> f64;
    /// Times a constant.
    fn scaled(self, by: f64) -> Self;
    fn exp(self) -> Self;
    fn sin_cos(self) -> (Self, Self);
    fn recip(self) -> Self;
    /// An elementary function of the number. Derivatives are zero where the number does not change, even if the slope is infinite.
    fn apply(self, function: ElementaryFunction) -> Self;
    fn divided_by(self, other: Self) -> Self;
    fn power(self, exponent: Self) -> Self;
    /// Smaller one of two numbers; NaN if one of them is. Of equal ones the one that is smaller an instant later.
    fn smaller(self, other: Self) -> Self {
        let is_other = if Self::DEPTH > 0 && self.value() == other.value() {
            (other - self).leading() < 0.0
        } else {
            other.value() < self.value() || other.value().is_nan()
        };
        if is_other { other } else { self }
    }
    /// Larger one of two numbers; NaN if one of them is. Of equal ones the one that is larger an instant later.
    fn larger(self, other: Self) -> Self {
        let is_other = if Self::DEPTH > 0 && self.value() == other.value() {
            (other - self).leading() > 0.0
        } else {
            other.value() > self.value() || other.value().is_nan()
        };
        if is_other { other } else { self }
    }
    /// Angle of the point with this height above the axis, and this distance along it, from -π to π.
    fn angle_of(self, along: Self) -> Self;
    fn tanh<const SIMD: u8>(self) -> Self;
    /// Plus `a` times `b`.
    fn add_product<const SIMD: u8>(self, a: Self, b: Self) -> Self;
    /// Plus `x` times a constant.
    fn add_scaled<const SIMD: u8>(self, x: Self, by: f64) -> Self;
}

/// A value with its first and second derivative along a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jet<T = f64> {
    /// `f`
    pub value: T,
    /// `df/dt`
    pub first: T,
    /// `d²f/dt²`
    pub second: T,
}

impl Number for f64 {
    const DEPTH: usize = 0;

    fn value(self) -> f64 {
        self
    }

    fn leading(self) -> f64 {
        self
    }

    fn scaled(self, by: f64) -> Self {
        by * self
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

    fn apply(self, function: ElementaryFunction) -> Self {
        function.value(self)
    }

    fn divided_by(self, other: Self) -> Self {
        self / other
    }

    fn power(self, exponent: Self) -> Self {
        self.powf(exponent)
    }

    fn angle_of(self, along: Self) -> Self {
        self.atan2(along)
    }

    #[inline(always)]
    fn tanh<const SIMD: u8>(self) -> Self {
        exponential::tanh::<f64, SIMD>(self)
    }

    #[inline(always)]
    fn add_product<const SIMD: u8>(self, a: Self, b: Self) -> Self {
        simd::fma::<f64, SIMD>(a, b, self)
    }

    #[inline(always)]
    fn add_scaled<const SIMD: u8>(self, x: Self, by: f64) -> Self {
        simd::fma::<f64, SIMD>(by, x, self)
    }
}

impl<T: Number> Number for Jet<T> {
    const DEPTH: usize = T::DEPTH + 1;

    fn value(self) -> f64 {
        self.value.value()
    }

    fn leading(self) -> f64 {
        let orders = [self.value, self.first, self.second].map(T::leading);
        orders.into_iter().find(|order| *order != 0.0).unwrap_or(0.0)
    }

    fn scaled(self, by: f64) -> Self {
        let Self { value, first, second } = self;
        Self { value: value.scaled(by), first: first.scaled(by), second: second.scaled(by) }
    }

    fn exp(self) -> Self {
        let value = self.value.exp();
        let Self { first, second, .. } = self;
        Self { value, first: value * first, second: value * (second + first * first) }
    }

    fn sin_cos(self) -> (Self, Self) {
        let Self { value, first, second } = self;
        let (sine, cosine) = value.sin_cos();
        let of =
            |value: T, slope: T| Self { value, first: slope * first, second: slope * second - value * first * first };
        (of(sine, cosine), of(cosine, sine.scaled(-1.0)))
    }

    fn recip(self) -> Self {
        let value = self.value.recip();
        let slope = (value * value).scaled(-1.0);
        let Self { first, second, .. } = self;
        Self { value, first: slope * first, second: slope * (second - (value * first * first).scaled(2.0)) }
    }

    #[inline(never)]
    fn apply(self, function: ElementaryFunction) -> Self {
        use ElementaryFunction::{Abs, Sign};
        // at a kink or a jump the derivatives are those of the piece that the curve enters
        match function {
            Abs if self.leading() < 0.0 => self.scaled(-1.0),
            Abs => self,
            Sign => Self::from(Sign.value(self.leading())),
            _ => {
                let value = self.value.apply(function);
                chain(self, value, derivatives(function, self.value, value))
            }
        }
    }

    #[inline(never)]
    fn divided_by(self, other: Self) -> Self {
        let x = other.value;
        let inverse = chain(other, x.recip(), [(x * x).recip().scaled(-1.0), (x * x * x).recip().scaled(2.0)]);
        // value by value, so that 1/3 is the double nearest to a third
        Self { value: self.value.divided_by(x), ..self * inverse }
    }

    #[inline(never)]
    fn power(self, exponent: Self) -> Self {
        let (zero, value) = (T::from(0.0), self.value.power(exponent.value));
        let changes = exponent.first != zero || exponent.second != zero;
        // at zero a power vanishes whatever its exponent is
        if changes && !(self.value.value() == 0.0 && exponent.value.value() > 0.0) {
            return chain(exponent * self.apply(ElementaryFunction::Ln), value, [value; 2]);
        }
        let (x, p) = (self.value, exponent.value);
        // exponents of the derivatives
        let [first, second] = [1.0, 2.0].map(|less| p - T::from(less));
        chain(self, value, [scaled_power(p, x, first), scaled_power(p * first, x, second)])
    }

    fn angle_of(self, along: Self) -> Self {
        let [y, x] = [self.value(), along.value()];
        // the angle to the point itself, which changes with both; it has no derivatives at the origin
        let across = self.scaled(x) - along.scaled(y);
        let ahead = along.scaled(x) + self.scaled(y);
        let turned = if ahead.value() > 0.0 { across.divided_by(ahead).apply(ElementaryFunction::Atan) } else { ahead };
        turned + Self::from(y.atan2(x))
    }

    #[inline(always)]
    fn tanh<const SIMD: u8>(self) -> Self {
        let value = self.value.tanh::<SIMD>();
        let slope = T::from(1.0) - value * value;
        let Self { first, second, .. } = self;
        Self { value, first: slope * first, second: slope * (second - (value * first * first).scaled(2.0)) }
    }

    #[inline(always)]
    fn add_product<const SIMD: u8>(self, a: Self, b: Self) -> Self {
        self + a * b
    }

    #[inline(always)]
    fn add_scaled<const SIMD: u8>(self, x: Self, by: f64) -> Self {
        Self {
            value: self.value.add_scaled::<SIMD>(x.value, by),
            first: self.first.add_scaled::<SIMD>(x.first, by),
            second: self.second.add_scaled::<SIMD>(x.second, by),
        }
    }
}

/// First and second derivative of a function at `x`, where the value is `y`.
fn derivatives<T: Number>(function: ElementaryFunction, x: T, y: T) -> [T; 2] {
    use ElementaryFunction::{Abs, Acos, Asin, Atan, Cos, Exp, Floor, Ln, Sign, Sin, Smooth, Sqrt, Tan, Tanh};
    let (zero, one, minus) = (T::from(0.0), T::from(1.0), |value: T| value.scaled(-1.0));
    match function {
        Sin => [x.apply(Cos), minus(y)],
        Cos => [minus(x.apply(Sin)), minus(y)],
        Tan => {
            let slope = one + y * y;
            [slope, y.scaled(2.0) * slope]
        }
        Asin | Acos => {
            let slope = (one - x * x).apply(Sqrt).recip();
            let change = x * (slope * slope * slope);
            if function == Asin { [slope, change] } else { [minus(slope), minus(change)] }
        }
        Atan => {
            let slope = (one + x * x).recip();
            [slope, x.scaled(-2.0) * slope * slope]
        }
        Tanh => {
            let slope = one - y * y;
            [slope, y.scaled(-2.0) * slope]
        }
        Exp => [y, y],
        Ln => [x.recip(), minus((x * x).recip())],
        Sqrt => [y.recip().scaled(0.5), (x * y).recip().scaled(-0.25)],
        Smooth if x.value() > 0.0 && x.value() < 1.0 => [(x - x * x).scaled(6.0), (x + x - one).scaled(-6.0)],
        // those of `abs` and `sign` depend on the curve
        Abs | Sign | Floor | Smooth => [zero, zero],
    }
}

/// A function of a series by the chain rule, from its value and its derivatives.
fn chain<T: Number>(x: Jet<T>, value: T, [slope, change]: [T; 2]) -> Jet<T> {
    // what does not change has no derivative, even where that of the function is infinite, as of sqrt at 0
    let second = chained(change, x.first * x.first) + chained(slope, x.second);
    Jet { value, first: chained(slope, x.first), second }
}

/// `slope * change`, but zero for a change of zero.
#[inline]
fn chained<T: Number>(slope: T, change: T) -> T {
    let zero = T::from(0.0);
    if change == zero { zero } else { slope * change }
}

/// `factor * x^exponent`, but zero for a factor of zero: `0 * 0^-1` is the derivative of a constant.
#[inline]
fn scaled_power<T: Number>(factor: T, x: T, exponent: T) -> T {
    let zero = T::from(0.0);
    if factor == zero { zero } else { factor * x.power(exponent) }
}

impl<T: Number> From<f64> for Jet<T> {
    fn from(value: f64) -> Self {
        Self { value: T::from(value), first: T::from(0.0), second: T::from(0.0) }
    }
}

impl<T: Number> Add for Jet<T> {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self { value: self.value + value, first: self.first + first, second: self.second + second }
    }
}

impl<T: Number> Sub for Jet<T> {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self { value: self.value - value, first: self.first - first, second: self.second - second }
    }
}

impl<T: Number> Mul for Jet<T> {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let Self { value, first, second } = other;
        Self {
            value: self.value * value,
            first: self.first * value + self.value * first,
            second: self.second * value + (self.first * first).scaled(2.0) + self.value * second,
        }
    }
}
