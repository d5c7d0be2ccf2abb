//! Runs that are repeated after others: results must depend on the request only.

use super::{
    RunOutputs, WorkerModel,
    campaign::{Campaign, IdleWorker},
};
use crate::{
    Error, Result,
    diagnostics::numbers::{exact, number},
};

/// A number that a repeated run has changed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Change {
    /// Row and column among the results of the run.
    row: usize,
    column: usize,
    first: f64,
    again: f64,
    /// Range of the column in the run.
    range: f64,
}

impl Change {
    /// The largest change relative to the range of its column, among rows of `width` numbers; none if all bits are the same.
    fn largest(first: &[f64], again: &[f64], width: usize) -> Option<Self> {
        let of_columns = (0..width).filter_map(|column| Self::of_column(first, again, column, width));
        of_columns.max_by(|a, b| a.share().total_cmp(&b.share()))
    }

    /// The largest change of a column.
    fn of_column(first: &[f64], again: &[f64], column: usize, width: usize) -> Option<Self> {
        let values = first.iter().skip(column).step_by(width).copied();
        let range = values.clone().fold(f64::NEG_INFINITY, f64::max) - values.clone().fold(f64::INFINITY, f64::min);
        let pairs = values.zip(again.iter().skip(column).step_by(width).copied()).enumerate();
        let changes = pairs
            .filter(|(_, (first, again))| first.to_bits() != again.to_bits())
            .map(|(row, (first, again))| Self { row, column, first, again, range });
        changes.max_by(|a, b| a.size().total_cmp(&b.size()))
    }

    fn size(&self) -> f64 {
        (self.again - self.first).abs()
    }

    /// Size relative to the range, infinite for a column that was constant.
    fn share(&self) -> f64 {
        self.size() / self.range
    }
}

impl Campaign<'_> {
    /// Repeats runs in reverse order, so that each follows other runs than before. A repeat that fails is no evidence.
    ///
    /// # Errors
    /// [`Error::Study`] if a result differs.
    pub(super) fn repeat(&self, runs: &[(usize, RunOutputs)], worker: &mut Option<IdleWorker>) -> Result<()> {
        for (index, outcome) in runs.iter().rev() {
            let (Ok(first), point) = (outcome, &self.points[*index]) else { continue };
            let Some(repeated) = self.try_run(point, worker)? else { return Ok(()) };
            let change = repeated.ok().and_then(|again| Change::largest(first, &again, self.model.columns.len()));
            if let Some(change) = change {
                return Err(self.model.unrepeatable(point, change));
            }
        }
        Ok(())
    }
}

impl WorkerModel {
    /// The error about a run with other results than before.
    fn unrepeatable(&self, point: &[f64], change: Change) -> Error {
        let Change { row, column, first, again, range } = change;
        let study = &self.study;
        let place = if self.is_of_equations {
            let names = study.parameters.keys().chain(study.inputs.keys()).chain(study.states.keys());
            let width = point.len() / self.batch();
            format!("at {}", named(names.map(String::as_str), &point[row * width..]))
        } else {
            let values = named(study.planned().map(|(name, _)| name), point);
            format!("at {} s of the run with {values}", self.times[row])
        };
        let share = if range > 0.0 { format!(", {} of its range", number(change.share())) } else { String::new() };
        let message = format!(
            "{} is {} {place}, and {} when that is repeated after other runs: a difference of {}{share}. Results must depend \
             on the values of the run only: start each run from the same state. If the difference is intended, for instance noise, set \
             source.repeats = 0",
            self.columns[column],
            exact(first),
            exact(again),
            number(change.size())
        );
        study.refusal(if study.source.fmu.is_some() { "source.fmu" } else { "source.command" }, message)
    }
}

/// Values with their names, for messages.
fn named<'a>(names: impl Iterator<Item = &'a str>, values: &[f64]) -> String {
    names.zip(values).map(|(name, value)| format!("{name} = {}", exact(*value))).collect::<Vec<String>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_change_is_that_of_the_most_affected_column() {
        let first = [0.0, 10.0, 1.0, 20.0, 2.0, 30.0];
        assert_eq!(Change::largest(&first, &first, 2), None);
        let again = [0.0, 10.0, 1.0, 21.0, 2.5, 30.0];
        let change = Change::largest(&first, &again, 2).unwrap();
        assert_eq!(change, Change { row: 2, column: 0, first: 2.0, again: 2.5, range: 2.0 });
        assert_eq!(change.share(), 0.25);
        // by a bit
        assert!(Change::largest(&[0.0], &[-0.0], 1).is_some_and(|change| change.range == 0.0));
    }
}
