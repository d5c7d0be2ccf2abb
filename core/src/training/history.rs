//! The epochs of a training as a table: `history.csv`.

use super::EpochRecord;
use crate::{Error, Result, diagnostics::Place, files};
use serde::Deserialize;
use std::{fs::File, io::BufReader, path::Path};

/// An epoch as a row of the table.
#[derive(Deserialize)]
struct EpochRow {
    epoch: usize,
    train_loss: f64,
    validation_loss: f64,
    learning_rate: f64,
    seconds: f64,
}

/// Writes the table: losses and learning rates as the shortest decimals that read back as the same doubles, milliseconds.
///
/// # Errors
/// [`Error::Io`].
pub fn write_history(path: &Path, history: &[EpochRecord]) -> Result<()> {
    files::write_with(path, |file| {
        writeln!(file, "epoch,train_loss,validation_loss,learning_rate,seconds")?;
        for EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, .. } in history {
            writeln!(file, "{epoch},{train_loss:e},{validation_loss:e},{learning_rate:e},{seconds:.3}")?;
        }
        Ok(())
    })
}

/// Reads the table.
///
/// # Errors
/// [`Error::Io`], or [`Error::Table`] with the line of the first mistake.
pub fn read_history(path: &Path) -> Result<Vec<EpochRecord>> {
    let file = File::open(path).map_err(Error::io(path, "read"))?;
    let mut history: Vec<EpochRecord> = Vec::new();
    for row in csv::Reader::from_reader(BufReader::new(file)).deserialize() {
        let EpochRow { epoch, train_loss, validation_loss, learning_rate, seconds } =
            row.map_err(|error| row_error(path, &error))?;
        let best = history.iter().all(|earlier| validation_loss < earlier.validation_loss);
        history.push(EpochRecord { epoch, train_loss, validation_loss, learning_rate, seconds, best });
    }
    Ok(history)
}

fn row_error(path: &Path, error: &csv::Error) -> Error {
    let line = error.position().map_or(1, csv::Position::line);
    Error::Table { path: path.to_owned(), place: Place::Line(line), message: error.to_string() }
}

/// Trainings that followed each other as one: epochs and seconds are counted on.
pub fn joined<'a>(histories: impl IntoIterator<Item = &'a [EpochRecord]>) -> Vec<EpochRecord> {
    let mut joined: Vec<EpochRecord> = Vec::new();
    for history in histories {
        let (epochs, seconds) = joined.last().map_or((0, 0.0), |last| (last.epoch, last.seconds));
        joined.extend(history.iter().map(|record| EpochRecord {
            epoch: epochs + record.epoch,
            seconds: seconds + record.seconds,
            ..*record
        }));
    }
    joined
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(epoch: usize, validation_loss: f64, best: bool) -> EpochRecord {
        EpochRecord { epoch, train_loss: 0.1, validation_loss, learning_rate: 1e-3, seconds: 0.5 * epoch as f64, best }
    }

    #[test]
    fn a_history_that_is_read_is_the_one_that_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("history.csv");
        let history = [record(1, 0.3, true), record(2, 0.4, false), record(3, 1.0 / 3.0 - 0.2, true)];
        write_history(&path, &history).unwrap();
        assert_eq!(read_history(&path).unwrap(), history);
        std::fs::write(&path, "epoch,train_loss\n1,x\n").unwrap();
        let message = read_history(&path).unwrap_err().to_string();
        assert!(message.contains("history.csv:2"), "{message}");
    }

    #[test]
    fn epochs_and_seconds_are_counted_on() {
        let history = [record(1, 0.3, true), record(2, 0.2, true)];
        let joined = joined([&history[..], &[], &history[..1]]);
        let found: Vec<(usize, f64)> = joined.iter().map(|record| (record.epoch, record.seconds)).collect();
        assert_eq!(found, [(1, 0.5), (2, 1.0), (3, 1.5)]);
    }
}
