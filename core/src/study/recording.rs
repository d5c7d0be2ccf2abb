//! Signals that were recorded, of which runs take stretches.

use crate::{
    Result,
    diagnostics::{Place, numbers::ends},
    files,
    signal::{Knots, Signal},
    table::{Table, TableColumn},
    unit,
};
use std::path::{Path, PathBuf};

/// A signal in a table: a column of the input's name, beside the column `time` in s.
#[derive(Debug)]
pub struct Recording {
    path: PathBuf,
    /// SHA-256 of the table.
    digest: String,
    column: TableColumn,
    /// Linear between the rows.
    signal: Signal,
    /// Time of the first row.
    begin: f64,
    /// From the first row to the last, in s.
    duration: f64,
    /// The smallest and the largest value, and where they are.
    extremes: [(f64, Place); 2],
}

impl Recording {
    /// Reads the recording of an input.
    ///
    /// # Errors
    /// [`Error::Io`](crate::Error::Io), or [`Error::Table`](crate::Error::Table) with the line: a column is missing, a value is no finite
    /// number, times do not ascend, there are less than two rows.
    pub fn read(path: &Path, input: &str) -> Result<Self> {
        let mut table = Table::open(path)?;
        let columns = table.columns_of(&["time", input])?;
        let (time, value) = (columns[0], columns[1]);
        table.check_unit(time, Some("s"))?;
        let (mut times, mut values) = (Vec::new(), Vec::new());
        let mut extremes = [(f64::INFINITY, Place::Whole), (f64::NEG_INFINITY, Place::Whole)];
        while table.next_row()? {
            let (t, v) = (table.number(time)?, table.number(value)?);
            if let Some(before) = times.last().filter(|before| **before >= t) {
                let expected = "expected rows in the order of time";
                return Err(table.mistake(&format!("time {t} s after {before} s, {expected}")));
            }
            if v < extremes[0].0 {
                extremes[0] = (v, table.place());
            }
            if v > extremes[1].0 {
                extremes[1] = (v, table.place());
            }
            times.push(t);
            values.push(v);
        }
        let &[begin, .., end] = times.as_slice() else {
            return Err(table.mistake("expected at least two rows"));
        };
        Ok(Self {
            path: path.to_owned(),
            digest: files::digest(path)?,
            column: table.columns()[value].clone(),
            signal: Signal::Linear(Knots::new(times, values).map_err(|error| table.mistake(&error.to_string()))?),
            begin,
            duration: end - begin,
            extremes,
        })
    }

    /// SHA-256 of the table, in hexadecimal digits.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// The reason why runs of `run` seconds cannot take stretches of it; none if they can.
    pub(super) fn too_short(&self, run: f64) -> Option<String> {
        let Self { path, duration, .. } = self;
        (*duration < run * (1.0 - 1e-9))
            .then(|| format!("{}: {duration} s, expected at least {run} s, the length of a run", path.display()))
    }

    /// The reason why it does not suit an input with this unit and range; none if it does.
    pub fn unfit(&self, expected: &str, [min, max]: [f64; 2]) -> Option<String> {
        let TableColumn { name, unit: own } = &self.column;
        let path = self.path.display();
        if let Some(own) = own.as_ref().filter(|own| !unit::is_same(own, expected)) {
            return Some(format!("{path}: column `{name}`: unit `{own}`, expected `{expected}`"));
        }
        let (value, place) = self.extremes.into_iter().find(|(value, _)| !(min..=max).contains(value))?;
        let place = place.behind_path();
        let expected = ends(min, max);
        Some(format!("{path}{place}: column `{name}`: {value}, expected {expected}, the input's range"))
    }

    /// Its values at ascending times from 0 on, if that is a point in the recording: the first one at which the times fit for a `place` of
    /// 0, the last one for 1.
    pub fn stretch(&self, place: f64, times: &[f64]) -> Vec<f64> {
        let spare = (self.duration - times.last().copied().unwrap_or(0.0)).max(0.0);
        let start = self.begin + place * spare;
        times.iter().map(|time| self.signal.value(start + time)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Recording> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r.csv");
        std::fs::write(&path, text).unwrap();
        Recording::read(&path, "force")
    }

    #[test]
    fn stretches_are_linear_between_rows_from_the_first_to_the_last() {
        let recording = read("note,time [s],force [N]\nx,2,0\n,4,8\n,5,-1\n,12,-8\n").unwrap();
        let times = [0.0, 1.0, 2.5];
        assert_eq!(recording.stretch(0.0, &times), [0.0, 4.0, 3.5]);
        assert_eq!(recording.stretch(1.0, &times), [-5.5, -6.5, -8.0]);
        assert_eq!(recording.stretch(0.5, &[0.0, 10.0]), [0.0, -8.0], "there is one place only");
        assert!(recording.too_short(10.0).is_none());
        assert!(
            recording.too_short(10.1).unwrap().ends_with("r.csv: 10 s, expected at least 10.1 s, the length of a run")
        );
        assert!(recording.unfit("N", [-8.0, 8.0]).is_none());
        for (unit, range, says) in [
            ("kN", [-8.0, 8.0], "r.csv: column `force`: unit `N`, expected `kN`"),
            ("N", [-7.0, 8.0], "r.csv:5: column `force`: -8, expected -7 to 8, the input's range"),
            ("N", [-8.0, 7.0], "r.csv:3: column `force`: 8, expected -8 to 7, the input's range"),
        ] {
            let message = recording.unfit(unit, range).unwrap();
            assert!(message.ends_with(says), "{message}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_recording_is_located() {
        for (text, says) in [
            ("time,torque\n0,1\n1,2\n", "r.csv:1: no column `force`, expected it among time, torque"),
            ("t,force\n0,1\n1,2\n", "r.csv:1: no column `time`, expected it among t, force"),
            ("time [ms],force\n0,1\n1,2\n", "r.csv:1: column `time`: unit `ms`, expected `s`"),
            ("time,force\n0,1\n1,nan\n", "r.csv:3: column `force`: `nan`, expected a finite number"),
            ("time,force\n0,1\n1,\n", "r.csv:3: column `force`: is empty, expected a finite number"),
            ("time,force\n1,1\n1,2\n", "r.csv:3: time 1 s after 1 s, expected rows in the order of time"),
            ("time,force\n0,1\n", "r.csv:2: expected at least two rows"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.ends_with(says), "{message}");
        }
    }
}
