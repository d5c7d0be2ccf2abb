//! Rows of recorded outputs that stand far beyond all others, as a short failure of a sensor or a transmission causes
//! them.

use crate::dataset::Run;

/// Share of the values at either end that do not count for the range of the others.
const ENDS: f64 = 0.005;
/// Rows in a row that may be outliers: a motion lasts longer.
const LONGEST: usize = 2;
/// Values at least: of fewer no range is known.
const FEWEST: usize = 50;

/// The outliers of an output.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Outliers {
    pub(super) output: usize,
    /// Run and row of each.
    pub(super) rows: Vec<(usize, usize)>,
    /// Range of the other values.
    pub(super) range: [f64; 2],
}

/// The first output with outliers. They are more than the width of the range beyond the range of the other values, and alone or two in a row. If one of those beyond
/// lasts longer, the component does it.
pub(super) fn find(runs: &[Run], outputs: usize) -> Option<Outliers> {
    (0..outputs).find_map(|output| of_output(runs, outputs, output))
}

fn of_output(runs: &[Run], outputs: usize, output: usize) -> Option<Outliers> {
    let mut sorted: Vec<f64> = runs.iter().flat_map(|run| values(run, outputs, output)).collect();
    if sorted.len() < FEWEST {
        return None;
    }
    sorted.sort_by(f64::total_cmp);
    let left_out = ((ENDS * sorted.len() as f64) as usize).max(1);
    let [low, high] = [sorted[left_out], sorted[sorted.len() - 1 - left_out]];
    let width = high - low;
    let usual = low - width..=high + width;
    if width == 0.0 || (usual.contains(&sorted[0]) && usual.contains(&sorted[sorted.len() - 1])) {
        return None;
    }
    let (mut rows, mut range) = (Vec::new(), [f64::INFINITY, f64::NEG_INFINITY]);
    for (number, run) in runs.iter().enumerate() {
        let mut length = 0;
        for (row, value) in values(run, outputs, output).enumerate() {
            if !usual.contains(&value) {
                length += 1;
                rows.push((number, row));
            } else {
                length = 0;
                range = [range[0].min(value), range[1].max(value)];
            }
            if length > LONGEST {
                return None;
            }
        }
    }
    Some(Outliers { output, rows, range })
}

/// Values of an output.
fn values(run: &Run, outputs: usize, output: usize) -> impl Iterator<Item = f64> {
    run.outputs.iter().skip(output).step_by(outputs).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run of two outputs, an oscillation and a ramp.
    fn run(change: impl Fn(usize, &mut [f64; 2])) -> Run {
        let row = |row: usize| {
            let mut values = [(0.1 * row as f64).sin(), row as f64];
            change(row, &mut values);
            values
        };
        let outputs = (0..300).flat_map(row).collect();
        Run { parameters: Vec::new(), times: (0..300).map(f64::from).collect(), inputs: Vec::new(), outputs }
    }

    #[test]
    fn single_rows_far_beyond_the_others_are_outliers() {
        let clean = run(|_, _| {});
        let spoiled = run(|row, values| match row {
            40 | 41 => values[0] = 9.0,
            250 => values[0] = -20.0,
            _ => {}
        });
        let found = find(&[clean.clone(), spoiled], 2).unwrap();
        assert_eq!((found.output, found.rows), (0, vec![(1, 40), (1, 41), (1, 250)]));
        assert!(found.range[0] < -0.99 && found.range[1] < 1.0);
        assert_eq!(find(&[clean], 2), None);
    }

    #[test]
    fn what_lasts_or_is_near_is_no_outlier() {
        let pulse = run(|row, values| values[0] = if (40..44).contains(&row) { 9.0 } else { values[0] });
        let near = run(|row, values| values[0] = if row == 40 { 2.5 } else { values[0] });
        let still = run(|row, values| values[0] = f64::from(u8::from(row == 40)));
        assert_eq!([pulse, near, still].map(|run| find(&[run], 2)), [None, None, None]);
    }
}
