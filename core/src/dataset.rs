//! Runs of a source, and the table they are kept in.
//!
//! The table is CSV, one row per time of a run: `run,time,<parameters>,<inputs>,<outputs>`. Numbers are the shortest decimals that
//! read back as the same doubles.

mod constants;

use crate::{Error, Result, diagnostics::Place, files, table::header_field, variable::SourceVariable};
pub use constants::{Rounding, settle};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::{
    fs::File,
    io::{BufRead, BufReader, Read},
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
    /// Each row's time and outputs.
    pub fn rows(&self) -> impl Iterator<Item = (f64, &[f64])> {
        let width = self.outputs.len() / self.times.len().max(1);
        self.times.iter().copied().zip(self.outputs.chunks(width.max(1)))
    }
}

impl Dataset {
    /// Rows of a static map: a run of a single row for each, whose parameters are the inputs.
    pub fn of_rows(
        inputs: &[SourceVariable],
        outputs: &[SourceVariable],
        points: &[Vec<f64>],
        labels: &[Vec<f64>],
    ) -> Self {
        let times: Arc<[f64]> = [0.0].into();
        let run = |(point, labels): (&Vec<f64>, &Vec<f64>)| Run {
            parameters: point.clone(),
            times: times.clone(),
            inputs: Vec::new(),
            outputs: labels.clone(),
        };
        let runs = points.iter().zip(labels).map(run).collect();
        Self { parameters: inputs.to_vec(), inputs: Vec::new(), outputs: outputs.to_vec(), runs }
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

    /// Writes the table, whole or not at all, and returns the SHA-256 of its bytes.
    ///
    /// # Errors
    /// [`Error::Io`].
    pub fn write_csv(&self, path: &Path) -> Result<String> {
        let mut hash = Sha256::new();
        files::write_with(path, |file| {
            let mut write = |text: &[u8]| {
                hash.update(text);
                file.write_all(text)
            };
            let header: Vec<String> = self.columns().iter().map(|name| header_field(name)).collect();
            write(format!("{}\n", header.join(",")).as_bytes())?;
            for (block, runs) in self.runs.chunks(RUNS).enumerate() {
                let lines = |(index, run)| csv_lines(block * RUNS + index, run);
                let written: Vec<Vec<u8>> = runs.par_iter().enumerate().map(lines).collect();
                written.iter().try_for_each(|lines| write(lines))?;
            }
            Ok(())
        })?;
        Ok(files::digits(hash))
    }

    /// Reads a table that [`Dataset::write_csv`] wrote for these variables and gave this digest.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Stale`] if the file has other bytes by now, or [`Error::Table`] with the line of the first
    /// mistake.
    pub fn read_csv(path: &Path, digest: &str, columns: DatasetColumns) -> Result<Self> {
        let read = Self::parse_csv(path, columns);
        let found = match &read {
            Ok((_, found)) => found.clone(),
            Err(Error::Table { .. }) => files::digest(path)?,
            Err(_) => return read.map(|(dataset, _)| dataset),
        };
        if found != digest {
            let mistake = read.err().map_or(String::new(), |mistake| format!(" ({mistake})"));
            let message = format!(
                "was changed or damaged after the sampling{mistake}: its SHA-256 is {found}, expected {digest}; run `metafmu \
                 sample` again; a table of your own is the `source.table` of a study"
            );
            return Err(Error::Stale { path: path.to_owned(), message });
        }
        read.map(|(dataset, _)| dataset)
    }

    /// The table and the SHA-256 of its bytes.
    fn parse_csv(path: &Path, variables: DatasetColumns) -> Result<(Self, String)> {
        let mut dataset = variables.without_runs();
        let DatasetColumns { parameters, inputs, .. } = variables;
        let mistake =
            |line: u64, message: String| Error::Table { path: path.to_owned(), place: Place::Line(line), message };
        let mut file = BufReader::new(File::open(path).map_err(Error::io(path, "read"))?);
        let mut header = Vec::new();
        file.read_until(b'\n', &mut header).map_err(Error::io(path, "read"))?;
        let mut hash = Sha256::new_with_prefix(&header);
        let columns = dataset.columns();
        let found = csv::Reader::from_reader(header.as_slice()).byte_headers().cloned();
        let found = found.map_err(|error| mistake(1, error.to_string()))?;
        if found.iter().ne(columns.iter().map(String::as_bytes)) {
            let found = found.iter().map(String::from_utf8_lossy).collect::<Vec<_>>().join(",");
            return Err(mistake(1, format!("columns `{found}`, expected `{}`", columns.join(","))));
        }
        let mut rows = RunReader::new([parameters.len(), inputs.len()]);
        let (mut line, mut block) = (2, Vec::new());
        while next_block(&mut file, &mut block).map_err(Error::io(path, "read"))? {
            let parse = || split_lines(&block).into_par_iter().map(|text| TablePiece::parse(text, &columns)).collect();
            let (pieces, ()): (Vec<TablePiece>, ()) = rayon::join(parse, || hash.update(&block));
            for piece in pieces {
                for (row, offset) in piece.values.chunks(columns.len()).zip(&piece.row_lines) {
                    dataset.runs.extend(rows.push(row).map_err(|message| mistake(line + offset, message))?);
                }
                if let Some((offset, message)) = piece.mistake {
                    return Err(mistake(line + offset, message));
                }
                line += piece.lines;
            }
        }
        dataset.runs.extend(rows.finish());
        if dataset.runs.is_empty() {
            return Err(mistake(2, "the table has no rows".into()));
        }
        Ok((dataset, files::digits(hash)))
    }
}

/// Runs of a table that are serialized at a time, by all threads.
const RUNS: usize = 256;

/// The lines of a run.
fn csv_lines(index: usize, run: &Run) -> Vec<u8> {
    let (mut lines, mut digits) = (Vec::new(), zmij::Buffer::new());
    let mut append = |lines: &mut Vec<u8>, value: f64, end: u8| {
        lines.extend_from_slice(digits.format(value).as_bytes());
        lines.push(end);
    };
    let (begin, mut parameters) = (format!("{index},"), Vec::new());
    run.parameters.iter().for_each(|&value| append(&mut parameters, value, b','));
    let inputs = run.inputs.len() / run.times.len().max(1);
    for (row, (time, outputs)) in run.rows().enumerate() {
        lines.extend_from_slice(begin.as_bytes());
        append(&mut lines, time, b',');
        lines.extend_from_slice(&parameters);
        run.inputs[row * inputs..][..inputs].iter().for_each(|&value| append(&mut lines, value, b','));
        for (column, &value) in outputs.iter().enumerate() {
            append(&mut lines, value, if column + 1 == outputs.len() { b'\n' } else { b',' });
        }
    }
    lines
}

/// Bytes of a table that are read at a time.
const BLOCK: u64 = 1 << 25;
/// Pieces of a block that are parsed at a time.
const PIECES: usize = 16;

/// Reads whole lines, about [`BLOCK`] bytes; false at the end of the file.
fn next_block(file: &mut impl BufRead, block: &mut Vec<u8>) -> std::io::Result<bool> {
    block.clear();
    file.by_ref().take(BLOCK).read_to_end(block)?;
    file.read_until(b'\n', block)?;
    Ok(!block.is_empty())
}

/// Pieces of about the same length, each of whole lines.
fn split_lines(block: &[u8]) -> Vec<&[u8]> {
    let (mut pieces, mut rest) = (Vec::new(), block);
    while !rest.is_empty() {
        let from = block.len().div_ceil(PIECES).min(rest.len());
        let end = rest[from - 1..].iter().position(|&byte| byte == b'\n').map_or(rest.len(), |length| from + length);
        let (piece, after) = rest.split_at(end);
        pieces.push(piece);
        rest = after;
    }
    pieces
}

/// Rows of a part of a table.
struct TablePiece {
    /// Row by row.
    values: Vec<f64>,
    /// Line of each row, counted from the piece's first.
    row_lines: Vec<u64>,
    /// Number of lines.
    lines: u64,
    /// Line and message of the first mistake, which ends the rows.
    mistake: Option<(u64, String)>,
}

impl TablePiece {
    fn parse(text: &[u8], columns: &[String]) -> Self {
        let lines = text.iter().filter(|&&byte| byte == b'\n').count() as u64;
        let mut piece = Self { values: Vec::new(), row_lines: Vec::new(), lines, mistake: None };
        if let Err(mistake) = piece.read(text, columns) {
            piece.mistake = Some(mistake);
        }
        piece
    }

    fn read(&mut self, text: &[u8], columns: &[String]) -> std::result::Result<(), (u64, String)> {
        let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text);
        let (mut record, mut before) = (csv::ByteRecord::new(), csv::ByteRecord::new());
        while reader.read_byte_record(&mut record).map_err(|error| (0, error.to_string()))? {
            let line = record.position().map_or(0, csv::Position::line) - 1;
            if record.len() != columns.len() {
                return Err((line, format!("{} fields, expected {}", record.len(), columns.len())));
            }
            let last_row = self.values.len().saturating_sub(columns.len());
            for (index, column) in columns.iter().enumerate() {
                // most columns of a row are those of the row before
                let value = if before.get(index) == Some(&record[index]) {
                    self.values[last_row + index]
                } else {
                    number(&record[index])
                        .map_err(|found| (line, format!("column `{column}`: `{found}` is not a finite number")))?
                };
                self.values.push(value);
            }
            self.row_lines.push(line);
            std::mem::swap(&mut record, &mut before);
        }
        Ok(())
    }
}

/// A finite number, or the text that is none.
fn number(field: &[u8]) -> std::result::Result<f64, String> {
    let text = String::from_utf8_lossy(field);
    text.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or(text.into_owned())
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
    fn push(&mut self, row: &[f64]) -> std::result::Result<Option<Run>, String> {
        let (number, time) = (row[0], row[1]);
        let (parameters, rest) = row[2..].split_at(self.counts[0]);
        let (inputs, outputs) = rest.split_at(self.counts[1]);
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

    #[test]
    fn a_table_reads_back_as_the_same_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("train.csv");
        let dataset = example();
        let digest = dataset.write_csv(&path).unwrap();
        assert_eq!(digest, files::digest(&path).unwrap());
        assert_eq!(Dataset::read_csv(&path, &digest, dataset.variables()).unwrap(), dataset);
        assert_eq!(dataset.row_count(), 6);
    }

    #[test]
    fn names_with_separators_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("train.csv");
        let mut dataset = example();
        dataset.parameters[0].name = "body.r[1,2]".into();
        dataset.outputs[1].name = "der(\"x\"; y)".into();
        let digest = dataset.write_csv(&path).unwrap();
        assert_eq!(digest, files::digest(&path).unwrap());
        assert_eq!(Dataset::read_csv(&path, &digest, dataset.variables()).unwrap(), dataset);
    }

    #[test]
    fn a_long_table_reads_as_the_same_numbers_and_mistakes_keep_their_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let mut dataset = example();
        let run = dataset.runs[0].clone();
        dataset.runs = (0..4000).map(|i| Run { parameters: vec![f64::from(i), 0.5], ..run.clone() }).collect();
        let digest = dataset.write_csv(&path).unwrap();
        assert_eq!(digest, files::digest(&path).unwrap());
        assert_eq!(Dataset::read_csv(&path, &digest, dataset.variables()).unwrap(), dataset);
        let mut lines: Vec<String> = std::fs::read_to_string(&path).unwrap().lines().map(String::from).collect();
        for wrong in [11_998, 7_003, 5, 1] {
            lines[wrong] = lines[wrong].replacen("0.5", "half", 1);
            std::fs::write(&path, lines.join("\n")).unwrap();
            let digest = files::digest(&path).unwrap();
            let message = Dataset::read_csv(&path, &digest, dataset.variables()).unwrap_err().to_string();
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
            let message = Dataset::read_csv(&path, &digest, dataset.variables()).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
    }

    #[test]
    fn a_table_that_was_changed_is_refused_whether_it_can_be_read_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let dataset = example();
        let digest = dataset.write_csv(&path).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let changed = bytes.iter().enumerate().flat_map(|(place, &byte)| {
            let with = |other: u8| [&bytes[..place], &[other], &bytes[place + 1..]].concat();
            [with(byte ^ 1), with(b'x'), bytes[..place].to_vec()]
        });
        for changed in changed.filter(|changed| *changed != bytes) {
            std::fs::write(&path, &changed).unwrap();
            let refused = Dataset::read_csv(&path, &digest, dataset.variables());
            let message = refused.unwrap_err().to_string();
            assert!(message.contains("t.csv: was changed or damaged after the sampling"), "{message}");
        }
    }
}
