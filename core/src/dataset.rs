//! Runs of a source, and the table they are kept in.
//!
//! The table is CSV or Parquet, with one row per time of a run and the columns `run,time,<parameters>,<inputs>,<outputs>`. Its numbers read
//! back as the same doubles.

mod constants;
mod csv;
mod parquet;

use crate::{Error, Result, diagnostics::Place, files, table::writer::Format, variable::SourceVariable};
pub use constants::{Rounding, settle};
use sha2::{Digest, Sha256};
use std::{
    io::{self, Write},
    path::Path,
    sync::Arc,
};

/// One simulation: its parameters, and its outputs at each time.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// One value per parameter.
    pub parameters: Vec<f64>,
    /// Times of the rows, ascending, in seconds.
    pub times: Arc<[f64]>,
    /// Inputs, row by row: shape `[times, inputs]`. Between two rows they are linear.
    pub inputs: Vec<f64>,
    /// Outputs, row by row: shape `[times, outputs]`.
    pub outputs: Vec<f64>,
}

/// Runs with the names of their columns.
#[derive(Clone, Debug, PartialEq)]
pub struct Dataset {
    /// The parameters.
    pub parameters: Vec<SourceVariable>,
    /// The inputs, which drive the runs.
    pub inputs: Vec<SourceVariable>,
    /// The outputs.
    pub outputs: Vec<SourceVariable>,
    /// The runs.
    pub runs: Vec<Run>,
}

/// The variables of a table's columns.
#[derive(Clone, Copy, Debug)]
pub struct DatasetColumns<'a> {
    /// The parameters.
    pub parameters: &'a [SourceVariable],
    /// The inputs, which drive the runs.
    pub inputs: &'a [SourceVariable],
    /// The outputs.
    pub outputs: &'a [SourceVariable],
}

impl DatasetColumns<'_> {
    /// A dataset of such columns that has no runs.
    pub fn without_runs(self) -> Dataset {
        let [parameters, inputs, outputs] =
            [self.parameters, self.inputs, self.outputs].map(<[SourceVariable]>::to_vec);
        Dataset { parameters, inputs, outputs, runs: Vec::new() }
    }
}

impl Run {
    /// The first rows of a run with this number of outputs.
    pub fn beginning(&self, rows: usize, outputs: usize) -> Self {
        let inputs = self.inputs.len() / self.times.len().max(1);
        Self {
            parameters: self.parameters.clone(),
            times: self.times[..rows].into(),
            inputs: self.inputs[..rows * inputs].to_vec(),
            outputs: self.outputs[..rows * outputs].to_vec(),
        }
    }

    /// Each row's time and outputs.
    pub fn rows(&self) -> impl Iterator<Item = (f64, &[f64])> {
        let width = self.outputs.len() / self.times.len().max(1);
        self.times.iter().copied().zip(self.outputs.chunks(width.max(1)))
    }
}

impl Dataset {
    /// Rows of a static map: a run of a single row for each, whose parameters are the inputs.
    pub fn of_rows<P: AsRef<[f64]>, L: AsRef<[f64]>>(
        inputs: &[SourceVariable],
        outputs: &[SourceVariable],
        points: impl IntoIterator<Item = P>,
        labels: impl IntoIterator<Item = L>,
    ) -> Self {
        let times: Arc<[f64]> = [0.0].into();
        let runs = points.into_iter().zip(labels).map(|(point, labels)| Run {
            parameters: point.as_ref().to_vec(),
            times: times.clone(),
            inputs: Vec::new(),
            outputs: labels.as_ref().to_vec(),
        });
        Self { parameters: inputs.to_vec(), inputs: Vec::new(), outputs: outputs.to_vec(), runs: runs.collect() }
    }

    /// Number of rows of all runs.
    pub fn row_count(&self) -> usize {
        self.runs.iter().map(|run| run.times.len()).sum()
    }

    /// The runs without the rows after `stop`.
    pub fn until(mut self, stop: f64) -> Self {
        let width = self.outputs.len();
        for run in &mut self.runs {
            let rows = run.times.partition_point(|&time| time <= stop);
            if rows < run.times.len() {
                run.times = run.times[..rows].into();
                run.inputs.truncate(rows * self.inputs.len());
                run.outputs.truncate(rows * width);
            }
        }
        self
    }

    /// The variables of its columns.
    pub fn variables(&self) -> DatasetColumns<'_> {
        DatasetColumns { parameters: &self.parameters, inputs: &self.inputs, outputs: &self.outputs }
    }

    fn columns(&self) -> Vec<String> {
        let names =
            self.parameters.iter().chain(&self.inputs).chain(&self.outputs).map(|variable| variable.name.clone());
        ["run".to_owned(), "time".to_owned()].into_iter().chain(names).collect()
    }

    /// Count of the table's numbers: rows times columns.
    pub fn number_count(&self) -> usize {
        let columns = [&self.parameters, &self.inputs, &self.outputs].map(Vec::len).into_iter().sum::<usize>() + 2;
        self.row_count().saturating_mul(columns)
    }

    /// Format of the table, unless a study selects one.
    pub fn format(&self) -> Format {
        if self.number_count() > CSV_NUMBERS { Format::Parquet } else { Format::Csv }
    }

    /// Writes the table, whole or not at all, in the format of the path's extension. Returns the SHA-256 of its bytes, which do not
    /// depend on the number of threads.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Table`] for another extension.
    pub fn write(&self, path: &Path) -> Result<String> {
        let format = format_of(path)?;
        let mut hash = Sha256::new();
        files::write_with(path, |file| {
            let mut to = HashedWriter { to: file, hash: &mut hash };
            match format {
                Format::Csv => csv::write(self, &mut to),
                Format::Parquet => parquet::write(self, &mut to),
            }
        })?;
        Ok(files::digits(hash))
    }

    /// Reads a table that [`Dataset::write`] wrote for these variables and gave this digest, in the format of the path's extension.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Stale`] if the file has other bytes by now, or [`Error::Table`] with the line or row of the first
    /// mistake.
    pub fn read(path: &Path, digest: &str, columns: DatasetColumns) -> Result<Self> {
        let stale = |found: &str, mistake: String| {
            let message = format!(
                "was changed or damaged after the sampling{mistake}: its SHA-256 is {found}, expected {digest}; run `metafmu \
                 sample` again; a table of your own is the `source.table` of a study"
            );
            Error::Stale { path: path.to_owned(), message }
        };
        match format_of(path)? {
            Format::Csv => {
                let read = csv::read(path, columns);
                let found = match &read {
                    Ok((_, found)) => found.clone(),
                    Err(Error::Table { .. }) => files::digest(path)?,
                    Err(_) => return read.map(|(dataset, _)| dataset),
                };
                if found != digest {
                    return Err(stale(&found, read.err().map_or(String::new(), |mistake| format!(" ({mistake})"))));
                }
                read.map(|(dataset, _)| dataset)
            }
            // damaged lengths could make the decoder allocate any amount of memory
            Format::Parquet => match files::digest(path)? {
                found if found != digest => Err(stale(&found, String::new())),
                _ => parquet::read(path, columns),
            },
        }
    }
}

/// Most numbers of a table that is CSV unless a study selects a format: about 50 to 100 MB of text, which spreadsheets and editors
/// still open. Parquet is smaller and is read in a fraction of the time.
const CSV_NUMBERS: usize = 5_000_000;

fn format_of(path: &Path) -> Result<Format> {
    Format::of(path).map_err(Error::table(path, Place::Whole))
}

/// Writes to a file and hashes what it writes.
struct HashedWriter<'a> {
    to: &'a mut dyn Write,
    hash: &'a mut Sha256,
}

impl Write for HashedWriter<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.to.write(bytes)?;
        self.hash.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

/// Reason why a row does not continue its run.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
enum RunRowError {
    #[error("run {run}: parameters differ from those of the run's first row")]
    Parameters { run: f64 },
    #[error("run {run}: time {time} does not come after the row before")]
    Time { run: f64, time: f64 },
}

/// Collects rows into runs.
struct RunReader {
    /// Numbers of parameters and inputs.
    counts: [usize; 2],
    number: Option<f64>,
    parameters: Vec<f64>,
    times: Vec<f64>,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    /// Runs mostly share their times: the previous run's are kept to share them.
    shared_times: Arc<[f64]>,
}

impl RunReader {
    fn new(counts: [usize; 2]) -> Self {
        let [parameters, times, inputs, outputs] = std::array::from_fn(|_| Vec::new());
        Self { counts, number: None, parameters, times, inputs, outputs, shared_times: Arc::new([]) }
    }

    /// Takes the values of a row; returns the run before it if the row begins a new one.
    fn push(&mut self, row: &[f64]) -> std::result::Result<Option<Run>, RunRowError> {
        let (number, time) = (row[0], row[1]);
        let (parameters, rest) = row[2..].split_at(self.counts[0]);
        let (inputs, outputs) = rest.split_at(self.counts[1]);
        let mut finished = None;
        if self.number != Some(number) {
            finished = self.finish();
            self.number = Some(number);
            self.parameters = parameters.to_vec();
        } else if self.parameters != parameters {
            return Err(RunRowError::Parameters { run: number });
        } else if self.times.last().is_some_and(|&last| last >= time) {
            return Err(RunRowError::Time { run: number, time });
        }
        self.times.push(time);
        self.inputs.extend_from_slice(inputs);
        self.outputs.extend_from_slice(outputs);
        Ok(finished)
    }

    fn finish(&mut self) -> Option<Run> {
        self.number.take()?;
        if *self.shared_times != *self.times {
            self.shared_times = self.times.as_slice().into();
        }
        self.times.clear();
        let [parameters, inputs, outputs] =
            [&mut self.parameters, &mut self.inputs, &mut self.outputs].map(std::mem::take);
        Some(Run { parameters, times: Arc::clone(&self.shared_times), inputs, outputs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::{
        Table,
        writer::{Block, Values, Writer},
    };

    fn variable(name: &str) -> SourceVariable {
        SourceVariable::new(name, "", "")
    }

    fn example() -> Dataset {
        let times: Arc<[f64]> = Arc::new([0.0, 0.1, 0.30000000000000004]);
        let run = |p: f64| Run {
            inputs: Vec::new(),
            parameters: vec![p, -p],
            times: Arc::clone(&times),
            outputs: vec![1e-300, p, 1.0 / 3.0, 2e22, -0.0, 5e-324],
        };
        let outputs = vec![variable("u"), variable("v")];
        Dataset {
            inputs: Vec::new(),
            parameters: vec![variable("a"), variable("b")],
            outputs,
            runs: vec![run(0.1), run(7.0)],
        }
    }

    #[test]
    fn rows_after_the_end_are_left_out() {
        let run = Run {
            inputs: Vec::new(),
            parameters: vec![1.0],
            times: [0.0, 0.5, 1.0, 1.5].into(),
            outputs: (0..8).map(f64::from).collect(),
        };
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let (parameters, outputs) = (vec![variable("p")], vec![variable("a"), variable("b")]);
        let dataset = Dataset { inputs: Vec::new(), parameters, outputs, runs: vec![run] };
        let short = dataset.clone().until(1.0);
        assert_eq!(short.runs[0].times[..], [0.0, 0.5, 1.0]);
        assert_eq!(short.runs[0].outputs, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        assert_eq!(dataset.clone().until(1.5), dataset);
    }

    /// Bits of all numbers of a table: `==` does not distinguish 0.0 from -0.0.
    fn bits(dataset: &Dataset) -> Vec<Vec<u64>> {
        let values = dataset
            .runs
            .iter()
            .flat_map(|run| [&run.parameters[..], &run.times, &run.inputs, &run.outputs].map(Vec::from));
        values.map(|values| values.into_iter().map(f64::to_bits).collect()).collect()
    }

    #[test]
    fn a_table_reads_back_as_the_same_bits_in_both_formats() {
        let folder = tempfile::tempdir().unwrap();
        let mut driven = example();
        driven.inputs = vec![variable("force")];
        driven.runs.iter_mut().for_each(|run| run.inputs = vec![-0.0, 5e-324, 0.1 + 0.2]);
        driven.runs[1].times = [-0.0, 1e-7, f64::MAX].into();
        let mut without_parameters = driven.clone();
        without_parameters.parameters.clear();
        without_parameters.runs.iter_mut().for_each(|run| run.parameters.clear());
        for dataset in [example(), driven, without_parameters] {
            for name in ["train.csv", "train.parquet"] {
                let path = folder.path().join(name);
                let digest = dataset.write(&path).unwrap();
                assert_eq!(digest, files::digest(&path).unwrap());
                let found = Dataset::read(&path, &digest, dataset.variables()).unwrap();
                assert_eq!(found, dataset, "{name}");
                assert_eq!(bits(&found), bits(&dataset), "{name}");
            }
            assert_eq!(dataset.row_count(), 6);
        }
        let other = example().write(&folder.path().join("train.xlsx")).unwrap_err().to_string();
        assert!(other.contains("train.xlsx: `.xlsx`, expected a file that ends in .csv or .parquet"), "{other}");
    }

    #[test]
    fn names_with_separators_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut dataset = example();
        dataset.parameters[0].name = "body.r[1,2]".into();
        dataset.parameters[1].name = "angle [rad]".into();
        dataset.outputs[0].name = "angle [deg]".into();
        dataset.outputs[1].name = "der(\"x\"; y)".into();
        for name in ["train.csv", "train.parquet"] {
            let path = folder.path().join(name);
            let digest = dataset.write(&path).unwrap();
            assert_eq!(digest, files::digest(&path).unwrap());
            assert_eq!(Dataset::read(&path, &digest, dataset.variables()).unwrap(), dataset);
        }
    }

    #[test]
    fn a_large_table_is_parquet_of_several_row_groups_whatever_the_number_of_threads() {
        let folder = tempfile::tempdir().unwrap();
        let mut dataset = example();
        let times: Arc<[f64]> = (0..2000).map(|row| f64::from(row) / 128.0).collect();
        let outputs: Vec<f64> = times.iter().flat_map(|time| [time.sin(), time.cos()]).collect();
        let run = |i: u16| Run {
            parameters: vec![f64::from(i), -f64::from(i)],
            times: Arc::clone(&times),
            inputs: Vec::new(),
            outputs: outputs.clone(),
        };
        dataset.runs = (0..416).map(run).collect();
        // 2000 rows of six columns
        assert_eq!((dataset.number_count(), dataset.format()), (416 * 12_000, Format::Csv));
        dataset.runs.push(run(416));
        assert_eq!((dataset.number_count(), dataset.format()), (417 * 12_000, Format::Parquet));
        let write = |threads| {
            let path = folder.path().join(format!("{threads}.parquet"));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            (pool.install(|| dataset.write(&path)).unwrap(), path)
        };
        let [(digest, path), (other, _)] = [1, 3].map(write);
        assert_eq!(digest, other);
        assert_eq!(Dataset::read(&path, &digest, dataset.variables()).unwrap(), dataset);
        // any reader of tables reads it
        let mut table = Table::open(&path).unwrap();
        let (mut rows, mut last) = (0, 0.0);
        while table.next_row().unwrap() {
            (rows, last) = (rows + 1, table.number(0).unwrap());
        }
        assert_eq!((rows, last), (417 * 2000, 416.0));
    }

    #[test]
    fn a_long_table_reads_as_the_same_numbers_and_mistakes_keep_their_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let mut dataset = example();
        let run = dataset.runs[0].clone();
        dataset.runs = (0..4000).map(|i| Run { parameters: vec![f64::from(i), 0.5], ..run.clone() }).collect();
        let digest = dataset.write(&path).unwrap();
        assert_eq!(digest, files::digest(&path).unwrap());
        assert_eq!(Dataset::read(&path, &digest, dataset.variables()).unwrap(), dataset);
        let mut lines: Vec<String> = std::fs::read_to_string(&path).unwrap().lines().map(String::from).collect();
        for wrong in [11_998, 7_003, 5, 1] {
            lines[wrong] = lines[wrong].replacen("0.5", "half", 1);
            std::fs::write(&path, lines.join("\n")).unwrap();
            let digest = files::digest(&path).unwrap();
            let message = Dataset::read(&path, &digest, dataset.variables()).unwrap_err().to_string();
            assert!(message.contains(&format!("t.csv:{}: column `b`: `half`", wrong + 1)), "{message}");
        }
    }

    #[test]
    fn mistakes_in_a_table_are_located_by_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let dataset = example();
        for (text, says) in [
            ("run,time,a,u,v\n", "t.csv:1: columns `run,time,a,u,v`, expected `run,time,a,b,u,v`"),
            ("run,time,a,b,u,v\n", "t.csv:2: the table has no rows"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,1,1,1,x,1\n", "t.csv:3: column `u`: `x` is not a finite number"),
            ("run,time,a,b,u,v\n0,0,1,1,1,NaN\n", "t.csv:2: column `v`: `NaN` is not a finite number"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,1,2,1,1,1\n", "t.csv:3: run 0: parameters differ"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n0,0,1,1,1,1\n", "t.csv:3: run 0: time 0 does not come after"),
            ("run,time,a,b,u,v\n0,0,1,1,1\n", "t.csv:2: 5 fields, expected 6"),
            ("run,time,a,b,u,v\n0,0,1,1,1,1\n\n0,1,1,1,1,1\r\n0,2,1,1,1,inf", "t.csv:5: column `v`: `inf`"),
        ] {
            std::fs::write(&path, text).unwrap();
            let digest = files::digest(&path).unwrap();
            let message = Dataset::read(&path, &digest, dataset.variables()).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
    }

    #[test]
    fn mistakes_in_a_parquet_table_are_located_by_row() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.parquet");
        let dataset = example();
        let columns = ["run", "time", "a", "b", "u", "v"];
        let table = |names: &[&str], rows: &[[f64; 6]]| {
            let mut block: Block = vec![Values::Integers(rows.iter().map(|row| row[0] as i64).collect())];
            block.extend((1..6).map(|column| Values::Numbers(rows.iter().map(|row| row[column]).collect())));
            (names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(), block)
        };
        let (good, later) = ([0.0, 0.0, 1.0, 1.0, 1.0, 1.0], [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        let mut of_doubles = table(&columns, &[good]);
        of_doubles.1[0] = Values::Numbers(vec![0.0]);
        for ((names, block), says) in [
            (
                table(&["run", "time", "a", "b", "v", "u"], &[good]),
                "t.parquet: columns `run,time,a,b,v,u`, expected `run,time,a,b,u,v`",
            ),
            (of_doubles, "t.parquet: column `run` is DOUBLE, expected INT64 without missing values"),
            (
                table(&columns, &[good, [0.0, 1.0, 1.0, 1.0, f64::NAN, 1.0]]),
                "t.parquet, row 2: column `u`: `NaN` is not a finite number",
            ),
            (
                table(&columns, &[good, later, [0.0, 2.0, 1.5, 1.0, 1.0, 1.0]]),
                "t.parquet, row 3: run 0: parameters differ",
            ),
            (table(&columns, &[good, good]), "t.parquet, row 2: run 0: time 0 does not come after"),
        ] {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let (mut writer, mut bytes) = (Writer::new(Format::Parquet, &names), Vec::new());
            writer.write(&[block], &mut bytes).unwrap();
            writer.finish(&mut bytes).unwrap();
            std::fs::write(&path, bytes).unwrap();
            let digest = files::digest(&path).unwrap();
            let message = Dataset::read(&path, &digest, dataset.variables()).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
    }

    #[test]
    fn a_table_that_was_changed_is_refused_whether_it_can_be_read_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let dataset = example();
        for name in ["t.csv", "t.parquet"] {
            let path = folder.path().join(name);
            let digest = dataset.write(&path).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let changed = bytes.iter().enumerate().flat_map(|(place, &byte)| {
                let with = |other: u8| [&bytes[..place], &[other], &bytes[place + 1..]].concat();
                [with(byte ^ 1), with(b'x'), bytes[..place].to_vec()]
            });
            for changed in changed.filter(|changed| *changed != bytes) {
                std::fs::write(&path, &changed).unwrap();
                let refused = Dataset::read(&path, &digest, dataset.variables()).unwrap_err();
                assert!(matches!(refused, Error::Stale { .. }), "{refused}");
                let message = refused.to_string();
                assert!(message.contains(&format!("{name}: was changed or damaged after the sampling")), "{message}");
            }
        }
    }
}
