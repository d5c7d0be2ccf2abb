//! Checks that the rows of a run are contiguous in the table, in the order of time, and have the same parameters.

use super::Table;
use crate::{Result, diagnostics::Place};
use std::collections::HashMap;

/// The labels of the runs so far, and where each began.
#[derive(Debug, Default)]
pub struct RunLabels(HashMap<String, Place>);

impl RunLabels {
    /// Notes that a run begins at the row of a table; one without a label is not noted.
    ///
    /// # Errors
    /// [`Error::Table`](crate::Error::Table) if it began before.
    pub fn begin(&mut self, table: &Table, label: &str) -> Result<()> {
        if label.is_empty() {
            return Ok(());
        }
        match self.0.insert(label.to_owned(), table.place()) {
            None => Ok(()),
            Some(before) => {
                Err(table
                    .mistake(&format!("run `{label}` again, it began in {before}: a run's rows must be contiguous")))
            }
        }
    }
}

/// The run with a label, which may be empty, in messages.
pub fn named(label: &str) -> String {
    if label.is_empty() { "the run".into() } else { format!("run `{label}`") }
}

/// Checks that the time `t` of a row comes after that of the row before.
///
/// # Errors
/// [`Error::Table`](crate::Error::Table).
pub fn check_time(table: &Table, label: &str, before: f64, t: f64) -> Result<()> {
    let run = named(label);
    if before == t {
        return Err(table.mistake(&format!("time {t} s is duplicated in {run}")));
    }
    if before > t {
        let expected = "expected rows in the order of time";
        return Err(table.mistake(&format!("time {t} s after {before} s in {run}, {expected}")));
    }
    Ok(())
}

/// Checks that the values of these columns are what they were in the run before.
///
/// # Errors
/// [`Error::Table`](crate::Error::Table).
pub fn check_constants<'a>(
    table: &Table,
    names: impl IntoIterator<Item = &'a str>,
    found: &[f64],
    expected: &[f64],
) -> Result<()> {
    let mut columns = names.into_iter().zip(found.iter().zip(expected));
    match columns.find(|(_, (found, expected))| found != expected) {
        None => Ok(()),
        Some((name, (found, expected))) => {
            Err(table.mistake(&format!("column `{name}`: {found} after {expected}, expected one value in a run")))
        }
    }
}
