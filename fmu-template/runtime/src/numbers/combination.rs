//! Functions of two variables that formulas call.

use super::jet::Number;

/// A function of two values, `a` and `b`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Combination {
    /// `a + b`
    Add,
    /// `a - b`
    Subtract,
    /// `a b`
    Multiply,
    /// `a / b`
    Divide,
    /// `a^b`
    Power,
    /// The smaller one.
    Minimum,
    /// The larger one.
    Maximum,
    /// The angle of the point `(b, a)`, from -π to π: C's `atan2(a, b)`.
    Angle,
}

/// Largest power that is a product.
const LARGEST_POWER: f64 = 4.0;

impl Combination {
    /// All of them, in the order of their numbers in the model file.
    pub const ALL: [Self; 8] = [
        Self::Add,
        Self::Subtract,
        Self::Multiply,
        Self::Divide,
        Self::Power,
        Self::Minimum,
        Self::Maximum,
        Self::Angle,
    ];

    /// Name in upper case, as in the C sources.
    pub fn name(self) -> &'static str {
        match self {
            Self::Add => "ADD",
            Self::Subtract => "SUBTRACT",
            Self::Multiply => "MULTIPLY",
            Self::Divide => "DIVIDE",
            Self::Power => "POWER",
            Self::Minimum => "MINIMUM",
            Self::Maximum => "MAXIMUM",
            Self::Angle => "ANGLE",
        }
    }

    /// The power as a number of factors, if it is computed as a product.
    pub(crate) fn factors(power: f64) -> Option<u32> {
        (power.fract() == 0.0 && (1.0..=LARGEST_POWER).contains(&power)).then_some(power as u32)
    }

    /// Value at two numbers.
    pub fn value(self, a: f64, b: f64) -> f64 {
        self.of(a, b)
    }

    /// Value of the function.
    pub(crate) fn of<T: Number>(self, a: T, b: T) -> T {
        match self {
            Self::Add => a + b,
            Self::Subtract => a - b,
            Self::Multiply => a * b,
            Self::Maximum => a.larger(b),
            Self::Divide | Self::Power | Self::Minimum | Self::Angle => self.on_tape(a, b),
        }
    }

    /// Value of a function that is an operation of tapes; the others are written there as sums, products and minima.
    #[inline(never)]
    pub(crate) fn on_tape<T: Number>(self, a: T, b: T) -> T {
        match self {
            Self::Divide => a.divided_by(b),
            Self::Power => a.power(b),
            Self::Angle => a.angle_of(b),
            Self::Add | Self::Subtract | Self::Multiply | Self::Maximum | Self::Minimum => a.smaller(b),
        }
    }
}
