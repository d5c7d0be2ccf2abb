//! Time stamps that a recorder has rounded: to milliseconds, say.

use std::ops::RangeInclusive;

/// Most decimals of a stamp that was rounded; with more of them a number is taken as it is.
const MOST_DECIMALS: i32 = 9;

/// Share of the time between two rows by which a row is never off, however coarse the stamps are.
const NEAREST: f64 = 0.49;

/// The unit of the last decimal of stamps.
#[derive(Clone, Copy, Debug)]
pub struct StampUnit(f64);

impl Default for StampUnit {
    fn default() -> Self {
        Self(f64::INFINITY)
    }
}

impl StampUnit {
    /// The unit of some stamps, in seconds.
    pub fn of(stamps: &[f64]) -> Self {
        let mut unit = Self::default();
        stamps.iter().for_each(|stamp| unit.see(*stamp));
        unit
    }

    /// Takes a further stamp: the unit is that of the one with the most decimals.
    pub fn see(&mut self, stamp: f64) {
        let decimals = (0..=MOST_DECIMALS).find(|decimals| {
            let power = 10f64.powi(*decimals);
            (stamp * power).round() / power == stamp
        });
        self.0 = self.0.min(decimals.map_or(0.0, |decimals| 10f64.powi(-decimals)));
    }

    /// By how much a stamp may be off in rows that are `step` apart: half a unit, or the share `exact` of the step.
    pub fn tolerance(self, step: f64, exact: f64) -> f64 {
        (0.5 * self.0 * (1.0 + 1e-6)).min(NEAREST * step).max(exact * step)
    }
}

/// Sampling period in seconds, if the stamps belong to rows at equal distances, up to rounding. It is the least-squares
/// period over all rows, or the number with the fewest digits that gives the same stamps.
pub fn period(stamps: &[f64]) -> Option<f64> {
    let count = stamps.len();
    let &[first, _, ..] = stamps else { return None };
    let middle = 0.5 * (count - 1) as f64;
    let (mut sum, mut squares) = (0.0, 0.0);
    for (row, stamp) in stamps.iter().enumerate() {
        let from_middle = row as f64 - middle;
        sum += from_middle * (stamp - first);
        squares += from_middle * from_middle;
    }
    let slope = sum / squares;
    if !(slope.is_finite() && slope > 0.0) {
        return None;
    }
    let unit = StampUnit::of(stamps);
    if let Some(possible) = possible_periods(stamps, unit.tolerance(slope, 1e-9)) {
        return Some(shortest_number(slope.clamp(*possible.start(), *possible.end()), &possible));
    }
    let possible = possible_periods(stamps, unit.tolerance(slope, 1e-6))?;
    Some(slope.clamp(*possible.start(), *possible.end()))
}

/// Periods that give all stamps within a tolerance.
fn possible_periods(stamps: &[f64], tolerance: f64) -> Option<RangeInclusive<f64>> {
    let (mut least, mut most) = (0.0f64, f64::INFINITY);
    for (row, stamp) in stamps.iter().enumerate().skip(1) {
        let since_first = stamp - stamps[0];
        least = least.max((since_first - tolerance) / row as f64);
        most = most.min((since_first + tolerance) / row as f64);
    }
    (least <= most).then_some(least..=most)
}

/// The number with the fewest digits in a range, among those that a number in it is rounded to.
fn shortest_number(number: f64, range: &RangeInclusive<f64>) -> f64 {
    let rounded = (0..16).map(|digits: usize| format!("{number:.digits$e}").parse().unwrap_or(number));
    rounded.into_iter().find(|rounded| range.contains(rounded)).unwrap_or(number)
}

/// The first row that is not where the rows before it lead to, and where that is, in seconds: no period gives the stamps up to one of the
/// next two rows.
pub fn uneven(stamps: &[f64]) -> Option<(usize, f64)> {
    let (&first, &last) = (stamps.first()?, stamps.last()?);
    let tolerance = StampUnit::of(stamps).tolerance((last - first) / (stamps.len() - 1).max(1) as f64, 1e-6);
    // periods that give the stamps so far
    let (mut least, mut most) = (0.0, f64::INFINITY);
    let mut middles = vec![f64::NAN];
    for (row, stamp) in stamps.iter().enumerate().skip(1) {
        let [low, high] = [-tolerance, tolerance].map(|off| (stamp - first + off) / row as f64);
        if low > most || high < least {
            let expected = |row: usize| first + middles[row - 1] * row as f64;
            let mut before = row.saturating_sub(2).max(2)..row;
            let found = before.find(|&row| (stamps[row] - expected(row)).abs() > tolerance).unwrap_or(row);
            return Some((found, (expected(found) * 1e9).round() / 1e9));
        }
        (least, most) = (least.max(low), most.min(high));
        middles.push(0.5 * (least + most));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounded(step: f64, decimals: i32, rows: usize) -> Vec<f64> {
        let power = 10f64.powi(decimals);
        (0..rows).map(|row| (step * row as f64 * power).round() / power).collect()
    }

    #[test]
    fn the_period_of_rounded_stamps_is_that_of_the_recorder() {
        // the silver box is sampled with 10 MHz / 2^14
        for (step, decimals) in [(0.001_638_4, 3), (0.001_638_4, 6), (1.0 / 610.35, 6), (0.05, 2), (1.0 / 3.0, 3)] {
            let found = period(&rounded(step, decimals, 20_000)).unwrap();
            assert!((found - step).abs() < 1e-7 * step, "{step} {decimals}: {found}");
        }
        assert_eq!(period(&rounded(0.001_638_4, 6, 131_072)), Some(0.001_638_4));
        assert_eq!(period(&[0.0, 0.1, 0.2, 0.3]), Some(0.1));
        assert_eq!(period(&[0.0, 0.1, 0.25, 0.3]), None);
        assert_eq!(period(&[0.0]), None);
    }

    #[test]
    fn a_row_that_is_missing_is_found() {
        let mut stamps = rounded(0.001_638_4, 6, 1000);
        assert!(uneven(&stamps).is_none());
        stamps.remove(700);
        assert_eq!(period(&stamps), None);
        let (row, expected) = uneven(&stamps).unwrap();
        assert!(row == 700 && (expected - 700.0 * 0.001_638_4).abs() < 2e-6, "{row} {expected}");
        let mut stamps = rounded(0.1, 1, 100);
        stamps[50] = 5.01;
        let (row, expected) = uneven(&stamps).unwrap();
        assert!(row == 50 && (expected - 5.0).abs() < 1e-9, "{row} {expected}");
    }
}
