//! `[time]`: the rows of a run.

use super::{Study, TimeStructure};
use crate::diagnostics::{Problems, numbers::exact};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[time]`: the rows of a run, `0, step, ..., stop`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TimeOptions {
    /// End of every run.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub stop: f64,
    /// Time between two rows; divides `stop`. At most 10 million rows a run.
    #[schemars(extend("x-unit" = "s", "exclusiveMinimum" = 0))]
    pub step: f64,
    /// How much longer training runs are, as a share of `stop` from 0 to 1, rounded up to whole steps: the network is better at
    /// the end of a time that it was trained beyond. Tests, bounds and the domain of validity end at `stop`. Recorded runs
    /// have none, nor does the structure "fixed".
    #[serde(default)]
    #[schemars(range(min = 0, max = 1))]
    pub margin: f64,
}

/// Steps of a run.
const MAX_STEPS: f64 = 1e7;

/// Returns true if `part` divides `whole` up to rounding.
pub(super) fn divides(part: f64, whole: f64) -> bool {
    let count = whole / part;
    count >= 0.5 && (count.round() - count).abs() <= 1e-9 * count
}

impl TimeOptions {
    /// Experiment that the FMU of a static map suggests to hosts.
    pub(super) fn of_rows() -> Self {
        Self { stop: 1.0, step: 0.01, margin: 0.0 }
    }

    /// The times of a run's rows, in seconds: `count + 1` values computed as `stop * i / count`, so that none drifts.
    pub fn grid(&self) -> Vec<f64> {
        self.times(self.steps())
    }

    /// The times of a training run's rows, which go on beyond `stop` by the margin.
    pub fn training_grid(&self) -> Vec<f64> {
        self.times(self.training_steps())
    }

    /// Steps of a run.
    fn steps(&self) -> u64 {
        (self.stop / self.step).round() as u64
    }

    /// Steps of a training run.
    pub fn training_steps(&self) -> u64 {
        let steps = self.steps();
        // a margin of 0.05 of 100 steps is 5, not 6
        steps + (self.margin * steps as f64 - 1e-9).ceil().max(0.0) as u64
    }

    fn times(&self, steps: u64) -> Vec<f64> {
        let count = self.steps();
        // rounding would put the last row of some runs behind `stop`, where tests end
        let time = |i: u64| if i == count { self.stop } else { self.stop * i as f64 / count as f64 };
        (0..=steps).map(time).collect()
    }

    /// Every mistake, by key within the section.
    pub(super) fn problems(&self) -> Problems {
        let Self { stop, step, margin } = *self;
        let mut problems = Problems::default();
        problems.expect((0.0..=1.0).contains(&margin), "margin", margin, "a share from 0 to 1");
        problems.expect_positive("stop", stop);
        problems.expect_positive("step", step);
        let steps = stop / step;
        if steps > MAX_STEPS {
            problems.add("step", format!("{} rows a run, expected at most 10 million", exact(steps)));
        } else if steps > 0.0 && !divides(step, stop) {
            problems.add("step", format!("{} s does not divide the stop time of {} s", exact(step), exact(stop)));
        }
        problems
    }

    /// Problems that depend on the other sections.
    pub(super) fn problems_beside(&self, study: &Study) -> Problems {
        let mut problems = Problems::default();
        if self.margin > 0.0 && study.source.is_recorded() {
            problems.add(
                "margin",
                "belongs to `system`, `mechanism`, `fmu` and `command`: recorded runs end where they end",
            );
        } else if self.margin > 0.0 && study.network.structure == TimeStructure::Fixed {
            problems.add("margin", "belongs to the structure \"full\"");
        }
        problems
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_row_of_a_run_is_at_its_end() {
        for (stop, step) in [(1.98, 0.02), (0.3, 0.1), (2.0, 0.00125), (0.7, 0.07)] {
            let time = TimeOptions { stop, step, margin: 0.1 };
            let (grid, training) = (time.grid(), time.training_grid());
            assert_eq!(*grid.last().unwrap(), stop);
            assert!(grid.windows(2).all(|pair| pair[0] < pair[1]) && training[..grid.len()] == grid[..]);
            assert!(training.len() > grid.len() && training[grid.len()] > stop);
        }
    }
}
