//! An axis: its quantity, its unit, its range, and its ticks.

use super::readable;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use std::ops::Range;

/// An axis of a [`Chart`](super::chart::Chart).
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Name and unit, as written beside the axis.
    pub label: String,
    /// Map of values to places.
    pub scale: AxisScale,
    /// First value.
    pub low: f64,
    /// Last value; greater than `low`.
    pub high: f64,
}

/// Scale of an axis: the map from values to positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisScale {
    /// Evenly.
    Linear,
    /// Evenly, with ticks at whole numbers only.
    Whole,
    /// By their logarithm; begins and ends with 1, 2 or 5 times a power of ten.
    Log,
}

/// Largest number of decades below the largest value that a logarithmic axis shows.
const DECADES: i32 = 12;
/// Largest number of ticks of an axis.
pub const TICKS: usize = 6;

impl Axis {
    /// An evenly divided axis over all finite values, with a little room at both ends.
    pub fn linear(name: &str, unit: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let (low, high) = extent(values.into_iter().filter(|value| value.is_finite())).unwrap_or((0.0, 1.0));
        // a constant needs room too, and so much that the labels of the ticks differ
        let margin = if high > low { 0.04 * (high - low) } else { 0.1 * low.abs().max(1.0) };
        Self { label: label(name, unit), scale: AxisScale::Linear, low: low - margin, high: high + margin }
    }

    /// An evenly divided axis from `low` to `high`.
    pub fn exact(name: &str, unit: &str, low: f64, high: f64) -> Self {
        if high > low {
            Self { label: label(name, unit), scale: AxisScale::Linear, low, high }
        } else {
            Self::linear(name, unit, [low])
        }
    }

    /// An axis over numbers that are counted.
    pub fn whole(name: &str, values: impl IntoIterator<Item = f64>) -> Self {
        Self { scale: AxisScale::Whole, ..Self::linear(name, "", values) }
    }

    /// A logarithmic axis over all positive values.
    pub fn log(name: &str, unit: &str, values: impl IntoIterator<Item = f64>) -> Self {
        let positive = values.into_iter().filter(|value| value.is_finite() && *value > 0.0);
        let (low, high) = extent(positive).unwrap_or((0.1, 1.0));
        let high = round_step(high);
        // the inverse of the next round number above the inverse
        let low = 1.0 / round_step(1.0 / low.max(high * 10f64.powi(-DECADES)));
        let low = if low < 0.5 * high { low } else { 0.1 * high };
        Self { label: label(name, unit), scale: AxisScale::Log, low, high }
    }

    /// Share of the way from the first to the last value; outside of 0 to 1 for other values.
    fn place(&self, value: f64) -> f64 {
        match self.scale {
            AxisScale::Linear | AxisScale::Whole => (value - self.low) / (self.high - self.low),
            AxisScale::Log => (decades(value) - decades(self.low)) / (decades(self.high) - decades(self.low)),
        }
    }

    /// Values of the ticks, at most `count`.
    fn ticks(&self, count: usize) -> Vec<f64> {
        match self.scale {
            AxisScale::Linear | AxisScale::Whole => {
                let step = self.step(count);
                // an end that is a tick but for rounding is one
                let (first, last) = (self.low / step - 1e-6, self.high / step + 1e-6);
                (first.ceil() as i64..=last.floor() as i64).map(|i| i as f64 * step).collect()
            }
            AxisScale::Log => {
                let (first, last) = (self.low.log10() - 1e-6, self.high.log10() + 1e-6);
                let decades = first.floor() as i32..=last.ceil() as i32;
                let ticks: Vec<f64> = if last - first < 2.5 {
                    decades.flat_map(|decade| [1.0, 2.0, 5.0].map(|factor| factor * 10f64.powi(decade))).collect()
                } else {
                    let step = (last - first) as i32 / count.max(1) as i32 + 1;
                    decades.filter(|decade| decade % step == 0).map(|decade| 10f64.powi(decade)).collect()
                };
                ticks.into_iter().filter(|tick| (first..=last).contains(&tick.log10())).collect()
            }
        }
    }

    /// Distance of the ticks, at most `count`.
    fn step(&self, count: usize) -> f64 {
        let step = round_step((self.high - self.low) / count.max(1) as f64);
        if self.scale == AxisScale::Whole { step.max(1.0) } else { step }
    }

    /// A tick's label, with as many digits as tell the ticks apart.
    fn tick_label(&self, value: f64) -> String {
        if self.scale == AxisScale::Log {
            let decade = value.log10().floor() as i32;
            let decimals = (-decade).max(0) as usize;
            return if (-2..=3).contains(&decade) {
                format!("{value:.decimals$}")
            } else {
                readable::tick(&format!("{value:.0e}"))
            };
        }
        let step = self.step(TICKS);
        if value.abs() < 1e-6 * step {
            return "0".into();
        }
        let largest = self.low.abs().max(self.high.abs());
        if (1e-2..1e5).contains(&largest) {
            let decimals = (-step.log10()).ceil().clamp(0.0, 9.0) as usize;
            return format!("{value:.decimals$}");
        }
        let digits = (value.abs().log10().floor() - step.log10().floor()).clamp(0.0, 6.0) as usize;
        readable::tick(&format!("{value:.digits$e}"))
    }
}

/// Logarithm of a value on a logarithmic axis.
fn decades(value: f64) -> f64 {
    value.max(f64::MIN_POSITIVE).log10()
}

/// Names a quantity as axes do: `theta [rad]`.
pub fn label(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name} [{unit}]") }
}

/// Smallest and largest value.
pub fn extent(values: impl IntoIterator<Item = f64>) -> Option<(f64, f64)> {
    let start = (f64::INFINITY, f64::NEG_INFINITY);
    let (low, high) = values.into_iter().fold(start, |(low, high), value| (low.min(value), high.max(value)));
    (low <= high).then_some((low, high))
}

/// The next of 1, 2, 5, 10, ... that is not smaller.
fn round_step(step: f64) -> f64 {
    let decade = 10f64.powf(step.log10().floor());
    let factor = [1.0, 2.0, 5.0].into_iter().find(|factor| factor * decade >= step * (1.0 - 1e-9));
    factor.unwrap_or(10.0) * decade
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (begin, end): (i32, i32)) -> i32 {
        // a place far outside must stay within the picture's integers
        let place = self.place(*value).clamp(-1.0, 2.0);
        begin + (place * f64::from(end - begin)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        self.ticks(hint.bold_points())
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Axis {
    fn format_ext(&self, value: &f64) -> String {
        self.tick_label(*value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: &Axis) -> Vec<String> {
        axis.ticks(6).iter().map(|&tick| axis.tick_label(tick)).collect()
    }

    #[test]
    fn ticks_are_round_numbers_that_differ() {
        for (low, high, expected) in [
            (0.0, 2.0, vec!["0.0", "0.5", "1.0", "1.5", "2.0"]),
            (-47.0, 12.0, vec!["-40", "-30", "-20", "-10", "0", "10"]),
            (1e-7, 6e-7, vec!["10⁻⁷", "2·10⁻⁷", "3·10⁻⁷", "4·10⁻⁷", "5·10⁻⁷", "6·10⁻⁷"]),
            (1234.5, 1234.9, vec!["1234.5", "1234.6", "1234.7", "1234.8", "1234.9"]),
        ] {
            let found: Vec<String> = labels(&Axis::exact("x", "", low, high));
            let found: Vec<&str> =
                found.iter().map(|label| if label == "0" && low == 0.0 { "0.0" } else { label }).collect();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn a_logarithmic_axis_has_round_ends_and_few_ticks() {
        let axis = Axis::log("loss", "", [3e-7, 0.0, f64::NAN, 0.2]);
        assert!((axis.low - 2e-7).abs() < 1e-12 && (axis.high - 0.2).abs() < 1e-12, "{axis:?}");
        assert_eq!(labels(&axis), ["10⁻⁶", "10⁻⁴", "0.01"]);
        assert_eq!(axis.map(&2e-7, (0, 600)), 0);
        assert_eq!(axis.map(&2e-4, (0, 600)), 300);
        assert_eq!(axis.map(&0.0, (0, 600)), -600, "zero is below everything");
    }

    #[test]
    fn a_short_logarithmic_axis_has_ticks_between_the_decades() {
        assert_eq!(labels(&Axis::log("x", "", [0.3, 4.0])), ["0.2", "0.5", "1", "2", "5"]);
        assert_eq!(labels(&Axis::log("x", "", [1.0])), ["0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&Axis::log("x", "", [30_000.0, 200_000.0])), ["2·10⁴", "5·10⁴", "10⁵", "2·10⁵"]);
    }

    #[test]
    fn what_is_counted_has_whole_ticks() {
        assert_eq!(labels(&Axis::whole("epoch", [1.0, 4.0])), ["1", "2", "3", "4"]);
        assert_eq!(labels(&Axis::whole("epoch", [1.0, 150.0])), ["0", "50", "100", "150"]);
    }

    #[test]
    fn an_axis_over_nothing_or_one_value_is_not_empty() {
        for axis in [
            Axis::linear("x", "m", []),
            Axis::linear("x", "m", [3.0]),
            Axis::log("x", "m", [1.0]),
            Axis::exact("x", "m", 2.0, 2.0),
        ] {
            assert!(axis.low < axis.high, "{axis:?}");
            assert_eq!(axis.label, "x [m]");
        }
    }
}
