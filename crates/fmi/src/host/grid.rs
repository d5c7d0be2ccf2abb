//! The communication points of a run.

use super::{Fmu, SimulationOptions};
use crate::{Error, Result};

/// A run with more steps than this is taken for a mistake in the step size.
const MAX_STEPS: f64 = 1e8;
/// Steps of a run whose step size neither the caller nor the FMU gives.
const DEFAULT_STEPS: f64 = 500.0;
/// A remainder below this share of a step is rounding, not a last partial step.
const ROUNDING: f64 = 1e-9;

/// The communication points of a run.
#[derive(Debug, PartialEq)]
pub struct Grid {
    start: f64,
    stop: f64,
    step: f64,
    full_steps: usize,
    /// `true` if a shorter step follows the full ones.
    partial: bool,
}

impl Grid {
    /// The points that the options and the FMU's default experiment give.
    ///
    /// # Errors
    /// [`Error::Experiment`] if they give no grid.
    pub fn new(fmu: &Fmu, options: &SimulationOptions) -> Result<Self> {
        let experiment = fmu.description().default_experiment.unwrap_or_default();
        let start = options.start.or(experiment.start).unwrap_or(0.0);
        let Some(stop) = options.stop.or(experiment.stop) else {
            let (stop, step, expected) =
                (None, options.step.or(experiment.step_size), "a stop time: the FMU suggests none");
            return Err(Error::Experiment { start, stop, step, expected });
        };
        let step = options.step.or(experiment.step_size).unwrap_or((stop - start) / DEFAULT_STEPS);
        Self::of_fmus(start, stop, step, [fmu])
    }

    /// Common communication points of several FMUs.
    pub fn of_fmus<'a>(start: f64, stop: f64, step: f64, fmus: impl IntoIterator<Item = &'a Fmu>) -> Result<Self> {
        let grid = Self::of_times(start, stop, step);
        let grid = grid.and_then(|grid| match grid.partial && fmus.into_iter().any(takes_whole_steps) {
            true => Err("whole steps: the FMU cannot do a shorter last one"),
            false => Ok(grid),
        });
        grid.map_err(|expected| Error::Experiment { start, stop: Some(stop), step: Some(step), expected })
    }

    /// Communication points regardless of the FMUs' capabilities and of limits on the times.
    pub fn of_times(start: f64, stop: f64, step: f64) -> std::result::Result<Self, &'static str> {
        if !(start.is_finite() && stop.is_finite() && start <= stop) {
            return Err("finite times, the stop not before the start");
        }
        if !(step.is_finite() && step > 0.0) && start < stop {
            return Err("a step size above zero");
        }
        // a run of no length has no steps, whatever their size
        let steps = if start < stop { (stop - start) / step } else { 0.0 };
        if steps > MAX_STEPS {
            return Err("at most 100 million steps");
        }
        let whole = steps.round();
        let partial = (steps - whole).abs() > ROUNDING * whole.max(1.0);
        let full_steps = if partial { steps.floor() } else { whole } as usize;
        Ok(Self { start, stop, step, full_steps, partial })
    }

    /// Only the first steps.
    pub fn shorten(&mut self, steps: usize) {
        if steps < self.full_steps {
            *self = Self { stop: self.time(steps), full_steps: steps, partial: false, ..*self };
        }
    }

    /// Number of steps.
    pub fn steps(&self) -> usize {
        self.full_steps + usize::from(self.partial)
    }

    /// Stop time to tell FMUs: none for a run of no length, which some refuse. The end of the last step may be past `stop` by rounding, and some
    /// FMUs refuse a step that ends later than their stop time.
    pub fn stop_time(&self) -> Option<f64> {
        let last = self.steps().checked_sub(1)?;
        Some(self.stop.max(self.time(last + 1)).max(self.time(last) + self.size(last)))
    }

    /// Time at which step `index` begins; `steps()` gives the end of the run.
    pub fn time(&self, index: usize) -> f64 {
        if index > self.full_steps { self.stop } else { self.start + index as f64 * self.step }
    }

    /// Full steps are given to the FMU as exactly `step`, for some accept no other size.
    pub fn size(&self, index: usize) -> f64 {
        if index < self.full_steps { self.step } else { self.stop - self.time(index) }
    }
}

fn takes_whole_steps(fmu: &Fmu) -> bool {
    fmu.co_simulation().is_some_and(|co_simulation| !co_simulation.variable_step_size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn communication_points_are_computed_without_accumulation() {
        let grid = Grid::of_times(0.0, 1.0, 0.1).unwrap();
        assert_eq!((grid.steps(), grid.partial), (10, false));
        assert_eq!(grid.time(3), 0.0 + 3.0 * 0.1);
        assert_eq!(grid.size(9), 0.1);
        // 0.3 / 0.1 is a little less than 3
        assert_eq!(Grid::of_times(0.0, 0.3, 0.1).unwrap().steps(), 3);
    }

    #[test]
    fn a_last_partial_step_ends_at_the_stop_time() {
        let grid = Grid::of_times(1.0, 2.05, 0.1).unwrap();
        assert_eq!((grid.steps(), grid.partial), (11, true));
        assert_eq!(grid.time(11), 2.05);
        assert_eq!(grid.size(10), 2.05 - grid.time(10));
        let grid = Grid::of_times(0.0, 0.5, 1.0).unwrap();
        assert_eq!((grid.steps(), grid.time(1), grid.size(0)), (1, 0.5, 0.5));
    }

    #[test]
    fn no_step_ends_after_the_stop_time_that_an_fmu_is_told() {
        for (stop, step) in [(0.02, 0.002), (1.0, 0.1), (0.3, 0.1), (2.05, 0.1)] {
            let grid = Grid::of_times(0.0, stop, step).unwrap();
            let told = grid.stop_time().unwrap();
            assert!((0..grid.steps()).all(|index| grid.time(index) + grid.size(index) <= told), "{stop} {step}");
            assert!((told - stop).abs() < 1e-15);
        }
    }

    #[test]
    fn a_run_of_no_length_has_one_row() {
        let grid = Grid::of_times(1.0, 1.0, 0.0).unwrap();
        assert_eq!((grid.steps(), grid.stop_time()), (0, None));
    }

    #[test]
    fn times_that_make_no_run_are_refused() {
        for (start, stop, step) in [
            (0.0, -1.0, 0.1),
            (0.0, f64::NAN, 0.1),
            (0.0, 1.0, 0.0),
            (0.0, 1.0, -1.0),
            (0.0, 1.0, f64::NAN),
            (0.0, 1.0, 1e-12),
        ] {
            assert!(Grid::of_times(start, stop, step).is_err(), "{start} {stop} {step}");
        }
    }
}
