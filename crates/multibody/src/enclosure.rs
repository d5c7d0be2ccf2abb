//! Enclosures of a formula of time over an interval: bounds of its value and of its rate (interval arithmetic; Moore, Kearfott, Cloud:
//! *Introduction to Interval Analysis*, chapters 5 and 6). Rounding is not enclosed.

use metafmu_runtime::{
    Jet,
    formula::{Combination, ElementaryFunction, Formula, FormulaStep, LookupTable},
};
use std::f64::consts::{FRAC_PI_2, PI};

type Interval = [f64; 2];

const ALL: Interval = [f64::NEG_INFINITY, f64::INFINITY];
const ZERO: Interval = [0.0, 0.0];

/// Interval of a function of time over an interval.
#[derive(Clone, Copy, Debug)]
pub(super) struct Enclosure {
    /// Interval of the value.
    pub value: Interval,
    /// Interval of the slope between any two times of the interval.
    pub rate: Interval,
    /// Values at the beginning, the middle and the end.
    pub points: [f64; 3],
}

impl Enclosure {
    /// Enclosure of a formula over an interval of time; `column` returns the value of a column, none for the time.
    pub fn of(formula: &Formula, interval: Interval, column: impl Fn(usize) -> Option<f64>) -> Self {
        let half = 0.5 * (interval[1] - interval[0]);
        let mut stack: Vec<Self> = Vec::with_capacity(formula.steps().len());
        for step in formula.steps() {
            let first = stack.len() - step.operands();
            let next = match (step, &stack[first..]) {
                (FormulaStep::Constant(value), _) => Self::constant(*value),
                (FormulaStep::Column(index), _) => column(*index).map_or_else(|| Self::time(interval), Self::constant),
                (FormulaStep::Negate, [x]) => x.scaled(-1.0),
                (FormulaStep::Call(function), [x]) => x.call(*function),
                (FormulaStep::Combine(combination), [a, b]) => a.combine(*combination, b, half),
                (FormulaStep::Lookup(table), at) => Self::lookup(table, at),
                _ => Self::unknown([f64::NAN; 3]),
            };
            stack.truncate(first);
            stack.push(next.tightened(half));
        }
        stack.pop().unwrap_or_else(|| Self::unknown([f64::NAN; 3]))
    }

    /// Returns true if the function does not decrease, or does not increase.
    pub fn is_monotone(&self) -> bool {
        self.rate[0] >= 0.0 || self.rate[1] <= 0.0
    }

    /// Returns true if the function does not change.
    pub fn is_constant(&self) -> bool {
        self.rate == ZERO
    }

    fn constant(value: f64) -> Self {
        Self { value: [value; 2], rate: ZERO, points: [value; 3] }
    }

    fn time([begin, end]: Interval) -> Self {
        Self { value: [begin, end], rate: [1.0; 2], points: [begin, 0.5 * (begin + end), end] }
    }

    fn unknown(points: [f64; 3]) -> Self {
        Self { value: ALL, rate: ALL, points }
    }

    /// Tightens the bounds by those that follow from the points and the rate.
    fn tightened(mut self, half: f64) -> Self {
        if is_undefined(self.value) || is_undefined(self.rate) {
            return Self::unknown(self.points);
        }
        let [begin, middle, end] = self.points;
        let by_middle =
            sum([middle; 2], scaled(hull([self.rate[0], -self.rate[1], self.rate[1], -self.rate[0]]), half));
        let by_ends = if self.is_monotone() { hull([begin, end, begin, end]) } else { ALL };
        for [low, high] in [by_middle, by_ends] {
            // a comparison with NaN is false
            if low > self.value[0] {
                self.value[0] = low;
            }
            if high < self.value[1] {
                self.value[1] = high;
            }
        }
        self.value = hull([self.value[0], self.value[1], begin.min(end), begin.max(end)]);
        self
    }

    fn scaled(&self, by: f64) -> Self {
        Self { value: scaled(self.value, by), rate: scaled(self.rate, by), points: self.points.map(|x| by * x) }
    }

    /// A function of this one, with bounds of its value and of its derivative.
    fn chained(&self, function: impl Fn(f64) -> f64, value: Interval, slope: Interval) -> Self {
        Self { value, rate: product(slope, self.rate), points: self.points.map(function) }
    }

    fn call(&self, function: ElementaryFunction) -> Self {
        use ElementaryFunction::*;
        let [low, high] = self.value;
        let ends = [function.value(low), function.value(high)];
        let (value, slope) = match function {
            Sin => (waves(self.value, FRAC_PI_2), waves(self.value, 0.0)),
            Cos => (waves(self.value, 0.0), waves(self.value, -FRAC_PI_2)),
            Tan if ((low + FRAC_PI_2) / PI).floor() == ((high + FRAC_PI_2) / PI).floor() => {
                (ends, sum([1.0; 2], square(ends)))
            }
            Tan => (ALL, ALL),
            Asin => (ends, reciprocal(root(sum([1.0; 2], scaled(square(self.value), -1.0))))),
            Acos => {
                let slope = reciprocal(root(sum([1.0; 2], scaled(square(self.value), -1.0))));
                ([ends[1], ends[0]], scaled(slope, -1.0))
            }
            Atan => (ends, reciprocal(sum([1.0; 2], square(self.value)))),
            Tanh => (ends, sum([1.0; 2], scaled(square(ends), -1.0))),
            Exp => (ends, ends),
            Ln => (ends, if low > 0.0 { [1.0 / high, 1.0 / low] } else { [f64::NAN; 2] }),
            Sqrt => (ends, if low >= 0.0 { [0.5 / ends[1], 0.5 / ends[0]] } else { [f64::NAN; 2] }),
            Abs if low >= 0.0 => return *self,
            Abs if high <= 0.0 => return self.scaled(-1.0),
            Abs => ([0.0, high.max(-low)], [-1.0, 1.0]),
            Sign | Floor if ends[0] == ends[1] => (ends, ZERO),
            // it jumps upward
            Sign | Floor => (ends, [0.0, f64::INFINITY]),
            Smooth => {
                let [low, high] = [low.clamp(0.0, 1.0), high.clamp(0.0, 1.0)];
                let most = smooth_slope(0.5f64.clamp(low, high));
                (ends, [smooth_slope(low).min(smooth_slope(high)), most])
            }
        };
        self.chained(|x| function.value(x), value, slope)
    }

    fn combine(&self, combination: Combination, other: &Self, half: f64) -> Self {
        let mut points = self.points;
        points.iter_mut().zip(other.points).for_each(|(a, b)| *a = combination.value(*a, b));
        let (value, rate) = match combination {
            Combination::Add => (sum(self.value, other.value), sum(self.rate, other.rate)),
            Combination::Subtract => return self.minus(other, points),
            Combination::Multiply => {
                let rate = sum(product(self.rate, other.value), product(self.value, other.rate));
                (product(self.value, other.value), rate)
            }
            Combination::Divide => {
                let inverse = reciprocal(other.value);
                // (a / b)' = (a' - (a / b) b') / b
                let value = product(self.value, inverse);
                let numerator = sum(self.rate, scaled(product(value, other.rate), -1.0));
                (value, product(numerator, inverse))
            }
            Combination::Power => return self.power(other, points),
            Combination::Minimum | Combination::Maximum => {
                let difference = self.combine(Combination::Subtract, other, half).tightened(half);
                let is_maximum = combination == Combination::Maximum;
                if difference.value[0] >= 0.0 {
                    return if is_maximum { *self } else { *other };
                }
                if difference.value[1] <= 0.0 {
                    return if is_maximum { *other } else { *self };
                }
                let value = [0, 1].map(|side| combination.value(self.value[side], other.value[side]));
                let rates = [self.rate[0], self.rate[1], other.rate[0], other.rate[1]];
                (value, hull(rates))
            }
            Combination::Angle => {
                let (y, x) = (self, other);
                let has_no_jump = x.value[0] > 0.0 || y.value[0] > 0.0 || y.value[1] < 0.0;
                let numerator = sum(product(x.value, y.rate), scaled(product(y.value, x.rate), -1.0));
                let rate = product(numerator, reciprocal(sum(square(x.value), square(y.value))));
                ([-PI, PI], if has_no_jump { rate } else { ALL })
            }
        };
        Self { value, rate, points }
    }

    fn minus(&self, other: &Self, points: [f64; 3]) -> Self {
        let [value, rate] = [(self.value, other.value), (self.rate, other.rate)].map(|(a, b)| sum(a, scaled(b, -1.0)));
        Self { value, rate, points }
    }

    /// `a^b` with a constant exponent, or a positive base.
    fn power(&self, exponent: &Self, points: [f64; 3]) -> Self {
        let (value, rate) = if exponent.is_constant() {
            let n = exponent.points[0];
            (power(self.value, n), product(scaled(power(self.value, n - 1.0), n), self.rate))
        } else if self.value[0] > 0.0 {
            let logarithm = self.value.map(f64::ln);
            let value = product(logarithm, exponent.value).map(f64::exp);
            let of_base = product(product(exponent.value, reciprocal(self.value)), self.rate);
            (value, product(value, sum(product(exponent.rate, logarithm), of_base)))
        } else {
            (ALL, ALL)
        };
        Self { value, rate, points }
    }

    /// The arguments of a table at one of the points, as constants.
    fn jets(at: &[Self], k: usize) -> [Jet; 2] {
        let mut jets = [Jet::from(0.0); 2];
        jets.iter_mut().zip(at).for_each(|(to, of)| *to = Jet::from(of.points[k]));
        jets
    }

    /// A table with one argument that changes.
    fn lookup(table: &LookupTable, at: &[Self]) -> Self {
        let points = [0, 1, 2].map(|k| table.series(&Self::jets(at, k)[..at.len()]).value);
        let mut changing = (0..at.len()).filter(|&axis| !at[axis].is_constant());
        let Some(axis) = changing.next() else { return Self::constant(points[0]) };
        let [low, high] = at[axis].value;
        if changing.next().is_some() || !(low.is_finite() && high.is_finite()) {
            return Self::unknown(points);
        }
        let jet = |x: f64| {
            let mut jets = Self::jets(at, 0);
            jets[axis] = Jet { value: x, first: 1.0, second: 0.0 };
            table.series(&jets[..at.len()])
        };
        let Some(knots) = knots_between(table, axis, [low, high]) else { return Self::unknown(points) };
        let ends: Vec<f64> = std::iter::once(low).chain(knots).chain([high]).collect();
        let pieces = ends.windows(2).map(|pair| {
            // slopes are those of the piece between two knots, a cubic at most: it is within its Bézier points
            let inside = 1e-9 * (pair[1] - pair[0]);
            let [begin, end] = [jet(pair[0] + inside), jet(pair[1] - inside)];
            let third = (pair[1] - pair[0] - 2.0 * inside) / 3.0;
            let [after, before] = [begin.value + third * begin.first, end.value - third * end.first];
            let slope = if third > 0.0 { (before - after) / third } else { end.first };
            [hull([begin.value, after, before, end.value]), hull([begin.first, slope, slope, end.first])]
        });
        let all = pieces.reduce(|all, piece| [0, 1].map(|k| hull([all[k][0], all[k][1], piece[k][0], piece[k][1]])));
        let Some([value, slope]) = all else { return Self::unknown(points) };
        Self { value, rate: product(slope, at[axis].rate), points }
    }
}

/// Knots of a table's axis between two arguments; none if they are too many.
fn knots_between(table: &LookupTable, axis: usize, [low, high]: Interval) -> Option<Vec<f64>> {
    /// Knots of a periodic table that an interval is checked for.
    const MOST: f64 = 10_000.0;
    let knots = &table.axes()[axis];
    let turns = match table.period(axis) {
        Some(period) => [low, high].map(|x| ((x - knots[0]) / period).floor()),
        None => ZERO,
    };
    if (turns[1] - turns[0] + 1.0) * knots.len() as f64 > MOST {
        return None;
    }
    let count = (turns[1] - turns[0]) as usize + 1;
    let shifts = (0..count).map(|turn| (turns[0] + turn as f64) * table.period(axis).unwrap_or(0.0));
    let all = shifts.flat_map(|shift| knots.iter().map(move |knot| knot + shift));
    Some(all.filter(|knot| low < *knot && *knot < high).collect())
}

fn hull(values: [f64; 4]) -> Interval {
    if values.iter().any(|value| value.is_nan()) {
        return [f64::NAN; 2];
    }
    values.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(*x), high.max(*x)])
}

fn sum(a: Interval, b: Interval) -> Interval {
    [a[0] + b[0], a[1] + b[1]]
}

fn scaled([low, high]: Interval, by: f64) -> Interval {
    product([low, high], [by; 2])
}

fn product(a: Interval, b: Interval) -> Interval {
    hull([
        product_of_bounds(a[0], b[0]),
        product_of_bounds(a[0], b[1]),
        product_of_bounds(a[1], b[0]),
        product_of_bounds(a[1], b[1]),
    ])
}

/// Product of two bounds; zero times a bound that is infinite is zero.
#[inline]
fn product_of_bounds(x: f64, y: f64) -> f64 {
    if x == 0.0 || y == 0.0 { 0.0 } else { x * y }
}

fn is_undefined([low, high]: Interval) -> bool {
    low.is_nan() || high.is_nan() || low > high
}

/// Slope of the smooth step from 0 to 1.
fn smooth_slope(x: f64) -> f64 {
    6.0 * x * (1.0 - x)
}

fn reciprocal([low, high]: Interval) -> Interval {
    if low > 0.0 || high < 0.0 {
        [1.0 / high, 1.0 / low]
    } else if low == 0.0 && high > 0.0 {
        [1.0 / high, f64::INFINITY]
    } else {
        ALL
    }
}

fn square(x: Interval) -> Interval {
    power(x, 2.0)
}

fn root([low, high]: Interval) -> Interval {
    [low.max(0.0).sqrt(), high.sqrt()]
}

/// Interval of `x^n`.
fn power([low, high]: Interval, n: f64) -> Interval {
    if n == 0.0 {
        return [1.0; 2];
    }
    let is_whole = n.fract() == 0.0;
    if n < 0.0 && (is_whole || low >= 0.0) {
        return reciprocal(power([low, high], -n));
    }
    let [a, b] = [low.powf(n), high.powf(n)];
    let is_even = is_whole && n % 2.0 == 0.0;
    match () {
        () if low >= 0.0 || (is_whole && !is_even) => [a, b],
        () if !is_whole => [f64::NAN; 2],
        () if high <= 0.0 => [b, a],
        () => [0.0, a.max(b)],
    }
}

/// Interval of `cos(x - top)`.
fn waves([low, high]: Interval, top: f64) -> Interval {
    if (high - low).is_nan() || high - low >= 2.0 * PI {
        return [-1.0, 1.0];
    }
    let [a, b] = [(low - top).cos(), (high - top).cos()];
    let [has_bottom, has_top] = [top + PI, top].map(|phase| has_phase([low, high], phase));
    [if has_bottom { -1.0 } else { a.min(b) }, if has_top { 1.0 } else { a.max(b) }]
}

/// Returns true if a phase that repeats every turn is inside an interval.
fn has_phase([low, high]: Interval, phase: f64) -> bool {
    let turn = 2.0 * PI;
    ((high - phase) / turn).floor() * turn + phase >= low
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::expression::{Expression, Tables};
    use metafmu_runtime::formula::{Extrapolation, Interpolation};
    use std::sync::Arc;

    fn tables() -> Tables {
        let knots = vec![0.0, 0.3, 0.5, 1.1, 1.6];
        let table = |axes: Vec<Vec<f64>>, values: Vec<f64>, interpolation, extrapolation| {
            Arc::new(LookupTable::new(axes, values, interpolation, extrapolation).unwrap())
        };
        let values = vec![0.2, -1.0, 2.0, 0.4, 0.2];
        let grid: Vec<f64> = (0..25).map(|k| f64::from(k * k % 7) - 2.0).collect();
        let (linear, cubic) = (Interpolation::Linear, Interpolation::Cubic);
        [
            ("line", table(vec![knots.clone()], values.clone(), linear, Extrapolation::Hold)),
            ("cam", table(vec![knots.clone()], values, cubic, Extrapolation::Periodic)),
            ("map", table(vec![knots.clone(), knots], grid, cubic, Extrapolation::Linear)),
        ]
        .map(|(name, table)| (name.to_owned(), table))
        .into_iter()
        .collect()
    }

    #[test]
    fn values_and_slopes_are_within_their_bounds() {
        let texts = [
            "sin(3*time) - cos(2*time)^3*tan(time/3)",
            "asin(time/5)/acos(time/6) + atan(time^2)*tanh(3*time - 1)",
            "exp(-(time - 1)^2)*ln(time + 1) - sqrt(time)",
            "abs(sin(4*time)) + sign(time - 1)*floor(3*time) + mod(time, 0.4)",
            "min(time, 2 - time)*max(sin(5*time), 0.3) + step(time, 0.5, 1, 1.2, -2)",
            "atan2(sin(3*time), cos(2*time)) + (time - 1)^-2",
            "(time + 0.5)^(1.5 - time) + 2^time - (0.7 - time)^2*(time - 1.1)^3",
            "line(time) + cam(3*time) - map(time, 0.7)*map(0.2, 2*time)",
            "line(sin(6*time)) + map(time, 2*time)",
        ];
        let tables = tables();
        for text in texts {
            let formula = Expression::parse(text).unwrap().formula(&tables).unwrap();
            for (begin, length) in (0..60).flat_map(|k| [1.0, 0.3, 0.01].map(|length| (0.04 * f64::from(k), length))) {
                let found = Enclosure::of(&formula, [begin, begin + length], |_| None);
                let at = |k: u32| formula.value(|_| begin + length * f64::from(k) / 50.0);
                let values: Vec<f64> = (0..=50).map(at).collect();
                let rounding = 1e-9;
                for (value, next) in values.iter().zip(&values[1..]) {
                    let is_within = |x: f64, [low, high]: Interval| {
                        x >= low - rounding * (1.0 + low.abs()) && x <= high + rounding * (1.0 + high.abs())
                    };
                    assert!(is_within(*value, found.value), "{text} from {begin}: {value} {found:?}");
                    let slope = (next - value) * 50.0 / length;
                    assert!(is_within(slope, found.rate), "{text} from {begin}, {length} s: slope {slope} {found:?}");
                }
            }
        }
    }

    #[test]
    fn bounds_of_short_intervals_are_close() {
        let tables = tables();
        for text in
            ["sin(3*time)*exp(-time)/(1 + time^2)", "cam(time)*tanh(time) - line(time)", "atan2(time, 2 - time)"]
        {
            let formula = Expression::parse(text).unwrap().formula(&tables).unwrap();
            let found = Enclosure::of(&formula, [0.71, 0.71 + 1e-4], |_| None);
            assert!(found.value[1] - found.value[0] < 1e-3, "{text}: {found:?}");
            assert!(found.rate[1] - found.rate[0] < 2e-2, "{text}: {found:?}");
        }
    }
}
