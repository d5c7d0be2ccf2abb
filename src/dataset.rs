//! Runs of a source, and the table they are kept in.
//!
//! The table is CSV, one row per time of a run: `run,time,<parameters>,<outputs>`. Numbers are the shortest decimals that
//! read back as the same doubles.

use crate::{Error, Result, files, table::header_field, variable::Variable};
use std::{io::Write, path::Path, sync::Arc};

/// One simulation: its parameters, and its outputs at each time.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// One value per parameter.
    pub parameters: Vec<f64>,
    /// Times of the rows, ascending, in seconds.
    pub times: Arc<[f64]>,
    /// Outputs, row by row: shape `[times, outputs]`.
    pub outputs: Vec<f64>,
}

/// Runs with the names of their columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The parameters.
    pub parameters: Vec<Variable>,
    /// The outputs.
    pub outputs: Vec<Variable>,
    /// The runs.
    pub runs: Vec<Run>,
}

impl Run {
    /// Each row's time and outputs.
    pub fn rows(&self) -> impl Iterator<Item = (f64, &[f64])> {
        let width = self.outputs.len() / self.times.len().max(1);
        self.times.iter().copied().zip(self.outputs.chunks(width.max(1)))
    }
}

impl Dataset {
    /// Number of rows of all runs.
    pub fn row_count(&self) -> usize {
        self.runs.iter().map(|run| run.times.len()).sum()
    }

    fn columns(&self) -> Vec<String> {
        let names = self.parameters.iter().chain(&self.outputs).map(|variable| variable.name.clone());
        ["run".to_owned(), "time".to_owned()].into_iter().chain(names).collect()
    }

    /// Writes the table, whole or not at all.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        files::write_with(path, |file| {
            let header: Vec<String> = self.columns().iter().map(|name| header_field(name)).collect();
            writeln!(file, "{}", header.join(","))?;
            for (index, run) in self.runs.iter().enumerate() {
                let parameters: String = run.parameters.iter().map(|value| format!("{value:?},")).collect();
                for (time, outputs) in run.rows() {
                    write!(file, "{index},{time:?},{parameters}")?;
                    for (column, value) in outputs.iter().enumerate() {
                        let end = if column + 1 == outputs.len() { '\n' } else { ',' };
                        write!(file, "{value:?}{end}")?;
                    }
                }
            }
            Ok(())
        })
    }

    /// Reads a table that [`Dataset::write_csv`] wrote for these variables.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] with the line of the first mistake.
    pub fn read_csv(path: &Path, parameters: &[Variable], outputs: &[Variable]) -> Result<Self> {
        let mut dataset = Self { parameters: parameters.to_vec(), outputs: outputs.to_vec(), runs: Vec::new() };
        let mistake = |line: u64, message: String| Error::Table { path: path.to_owned(), line, message };
        let file = std::fs::File::open(path).map_err(Error::io(path, "read"))?;
        let mut reader = csv::Reader::from_reader(std::io::BufReader::with_capacity(1 << 16, file));
        let wrong = |error: csv::Error| {
            let line = error.position().map_or(1, csv::Position::line);
            mistake(line, error.to_string())
        };

        let header = reader.headers().map_err(wrong)?.clone();
        let expected = dataset.columns();
        if header.iter().ne(&expected) {
            let found = header.iter().collect::<Vec<_>>().join(",");
            return Err(mistake(1, format!("columns `{found}`, expected `{}`", expected.join(","))));
        }
        let mut rows = RunReader::new(parameters.len());
        let mut record = csv::StringRecord::new();
        while reader.read_record(&mut record).map_err(wrong)? {
            let line = record.position().map_or(0, csv::Position::line);
            let mut values = Vec::with_capacity(record.len());
            for (field, column) in record.iter().zip(&expected) {
                match field.trim().parse::<f64>() {
                    Ok(value) if value.is_finite() => values.push(value),
                    _ => return Err(mistake(line, format!("column `{column}`: `{field}` is no finite number"))),
                }
            }
            dataset.runs.extend(rows.push(&values).map_err(|message| mistake(line, message))?);
        }
        dataset.runs.extend(rows.finish());
        if dataset.runs.is_empty() {
            return Err(mistake(2, "the table has no rows".into()));
        }
        Ok(dataset)
    }
}

/// Collects rows into runs.
struct RunReader {
    parameter_count: usize,
    number: Option<f64>,
    parameters: Vec<f64>,
    times: Vec<f64>,
    outputs: Vec<f64>,
    /// Runs mostly share their times: the previous run's are kept to share them.
    shared_times: Arc<[f64]>,
}

impl RunReader {
    fn new(parameter_count: usize) -> Self {
        let (parameters, times, outputs) = (Vec::new(), Vec::new(), Vec::new());
        Self { parameter_count, number: None, parameters, times, outputs, shared_times: Arc::new([]) }
    }

    /// Takes the values of a row; returns the run before it if the row begins a new one.
    fn push(&mut self, row: &[f64]) -> std::result::Result<Option<Run>, String> {
        let (number, time) = (row[0], row[1]);
        let (parameters, outputs) = row[2..].split_at(self.parameter_count);
        let mut finished = None;
        if self.number != Some(number) {
            finished = self.finish();
            self.number = Some(number);
            self.parameters = parameters.to_vec();
        } else if self.parameters != parameters {
            return Err(format!("run {number}: parameters differ from those of the run's first row"));
        } else if self.times.last().is_some_and(|&last| last >= time) {
            return Err(format!("run {number}: time {time} does not come after the row before"));
        }
        self.times.push(time);
        self.outputs.extend_from_slice(outputs);
        Ok(finished)
    }

    fn finish(&mut self) -> Option<Run> {
        self.number.take()?;
        if *self.shared_times != *self.times {
            self.shared_times = self.times.as_slice().into();
        }
        self.times.clear();
        let (parameters, outputs) = (std::mem::take(&mut self.parameters), std::mem::take(&mut self.outputs));
        Some(Run { parameters, times: Arc::clone(&self.shared_times), outputs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variable(name: &str) -> Variable {
        Variable::new(name, "", "")
    }

    fn example() -> Dataset {
        let times: Arc<[f64]> = Arc::new([0.0, 0.1, 0.30000000000000004]);
        let run = |p: f64| Run {
            parameters: vec![p, -p],
            times: Arc::clone(&times),
            outputs: vec![1e-300, p, 1.0 / 3.0, 2e22, -0.0, 5e-324],
        };
        let outputs = vec![variable("u"), variable("v")];
        Dataset { parameters: vec![variable("a"), variable("b")], outputs, runs: vec![run(0.1), run(7.0)] }
    }

    #[test]
    fn a_table_reads_back_as_the_same_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("train.csv");
        let dataset = example();
        dataset.write_csv(&path).unwrap();
        assert_eq!(Dataset::read_csv(&path, &dataset.parameters, &dataset.outputs).unwrap(), dataset);
        assert_eq!(dataset.row_count(), 6);
    }

    #[test]
    fn names_with_separators_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("train.csv");
        let mut dataset = example();
        dataset.parameters[0].name = "body.r[1,2]".into();
        dataset.outputs[1].name = "der(\"x\"; y)".into();
        dataset.write_csv(&path).unwrap();
        assert_eq!(Dataset::read_csv(&path, &dataset.parameters, &dataset.outputs).unwrap(), dataset);
    }

    #[test]
    fn mistakes_in_a_table_are_located_by_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let dataset = example();
        for (text, says) in [
            ("run,time,a,u,v\n", "t.csv:1: columns `run,time,a,u,v`, expected `run,time,a,b,u,v`"),
            ("run,time,a,b,u,v\n", "t.csv:2: the table has no rows"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,1,1,1,x,1\n", "t.csv:3: column `u`: `x` is no finite number"),
            ("run,time,a,b,u,v\n0,0,1,1,1,NaN\n", "t.csv:2: column `v`: `NaN` is no finite number"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,1,2,1,1,1\n", "t.csv:3: run 0: parameters differ"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,0,1,1,1,1\n", "t.csv:3: run 0: time 0 does not come after"),
            ("run,time,a,b,u,v\n0,0,1,1,1\n", "t.csv:2: "),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = Dataset::read_csv(&path, &dataset.parameters, &dataset.outputs).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
    }
}
