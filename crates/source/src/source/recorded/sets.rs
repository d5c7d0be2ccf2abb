//! Division of recorded runs into those that train, test and calibrate.

use super::Recorded;
use crate::{
    diagnostics::numbers::counted,
    sampling::{self, Sets, Stream},
};
use std::fmt;

impl Recorded {
    /// The numbers of the runs of each set, in their order. Tests are the last parts of a record, and of several runs random ones.
    pub(super) fn choose(&self, count: usize, is_record: bool) -> Result<Sets<Vec<usize>>, TooFewRuns> {
        let Self { test_runs, calibration_runs, .. } = *self;
        let to_train = if self.is_motion { 1 } else { 2 };
        if count < test_runs + calibration_runs + to_train {
            let is_motion = self.is_motion;
            return Err(TooFewRuns { found: count, test_runs, calibration_runs, to_train, is_motion });
        }
        let order: Vec<usize> = match is_record {
            true => (0..count).rev().collect(),
            false => sampling::permutation(count, sampling::random(self.seed, Stream::Test)),
        };
        let mut places = vec![0; count];
        order.iter().enumerate().for_each(|(place, &run)| places[run] = place);
        let (tests, bounds) = (test_runs, test_runs + calibration_runs);
        let [train, test, calibration] = [bounds..count, 0..tests, tests..bounds]
            .map(|range| (0..count).filter(|run| range.contains(&places[*run])).collect());
        Ok(Sets { train, test, calibration })
    }
}

/// Error of tables with fewer runs than the sets of a study need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct TooFewRuns {
    found: usize,
    test_runs: usize,
    calibration_runs: usize,
    /// Fewest training runs.
    to_train: usize,
    /// `true` if each run could also be divided in time.
    is_motion: bool,
}

impl fmt::Display for TooFewRuns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { found, test_runs, calibration_runs, to_train, is_motion } = *self;
        let least = test_runs + calibration_runs + to_train;
        write!(f, "{}, expected at least {least}: ", counted(found, "run"))?;
        if test_runs > 0 {
            write!(f, "{test_runs} for the tests, ")?;
        }
        if calibration_runs > 0 {
            write!(f, "{calibration_runs} for bounds, ")?;
        }
        let part = if is_motion { "; `sampling.train_stop` divides every run in time" } else { "" };
        write!(f, "{to_train} to train{part}")
    }
}

impl std::error::Error for TooFewRuns {}
