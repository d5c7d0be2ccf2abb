//! Tables of runs as CSV: numbers are the shortest decimals that read back as the same doubles.

use super::{Dataset, DatasetColumns, Run, RunReader};
use crate::{Error, Result, diagnostics::Place, files, reading, table::header_field};
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::{
    io::{self, BufRead, BufReader, Read, Write},
    path::Path,
};

/// Writes the table.
pub(super) fn write(dataset: &Dataset, to: &mut dyn Write) -> io::Result<()> {
    let header: Vec<String> = dataset.columns().iter().map(|name| header_field(name)).collect();
    to.write_all(format!("{}\n", header.join(",")).as_bytes())?;
    for (block, runs) in dataset.runs.chunks(RUNS).enumerate() {
        let lines = |(index, run)| lines_of(block * RUNS + index, run);
        let written: Vec<Vec<u8>> = runs.par_iter().enumerate().map(lines).collect();
        written.iter().try_for_each(|lines| to.write_all(lines))?;
    }
    Ok(())
}

/// The table and the SHA-256 of its bytes.
pub(super) fn read(path: &Path, variables: DatasetColumns) -> Result<(Dataset, String)> {
    let mut dataset = variables.without_runs();
    let DatasetColumns { parameters, inputs, .. } = variables;
    let mistake =
        |line: u64, message: String| Error::Table { path: path.to_owned(), place: Place::Line(line), message };
    let mut file = BufReader::new(reading::open(path).map_err(Error::io(path, "read"))?);
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
                dataset.runs.extend(rows.push(row).map_err(|error| mistake(line + offset, error.to_string()))?);
            }
            if let Some(error) = piece.mistake {
                return Err(mistake(line + error.line, error.message));
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

/// Runs of a table that are serialized at a time, by all threads.
const RUNS: usize = 256;

/// The lines of a run.
fn lines_of(index: usize, run: &Run) -> Vec<u8> {
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
fn next_block(file: &mut impl BufRead, block: &mut Vec<u8>) -> io::Result<bool> {
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

/// Reason why a line is no row of a table.
struct CsvLineError {
    /// Line, counted from 0 at the start of the piece.
    line: u64,
    message: String,
}

/// Rows of a part of a table.
struct TablePiece {
    /// Row by row.
    values: Vec<f64>,
    /// Line of each row, counted from the piece's first.
    row_lines: Vec<u64>,
    /// Number of lines.
    lines: u64,
    /// The first mistake, which ends the rows.
    mistake: Option<CsvLineError>,
}

impl TablePiece {
    fn parse(text: &[u8], columns: &[String]) -> Self {
        let lines = text.iter().filter(|&&byte| byte == b'\n').count() as u64;
        let mut piece = Self { values: Vec::new(), row_lines: Vec::new(), lines, mistake: None };
        piece.mistake = piece.read(text, columns).err();
        piece
    }

    fn read(&mut self, text: &[u8], columns: &[String]) -> std::result::Result<(), CsvLineError> {
        let mut reader = csv::ReaderBuilder::new().has_headers(false).flexible(true).from_reader(text);
        let (mut record, mut before) = (csv::ByteRecord::new(), csv::ByteRecord::new());
        while reader
            .read_byte_record(&mut record)
            .map_err(|error| CsvLineError { line: 0, message: error.to_string() })?
        {
            let line = record.position().map_or(0, csv::Position::line) - 1;
            if record.len() != columns.len() {
                let message = format!("{} fields, expected {}", record.len(), columns.len());
                return Err(CsvLineError { line, message });
            }
            let last_row = self.values.len().saturating_sub(columns.len());
            for (index, column) in columns.iter().enumerate() {
                // most columns of a row are those of the row before
                let value = if before.get(index) == Some(&record[index]) {
                    self.values[last_row + index]
                } else {
                    number(&record[index]).ok_or_else(|| {
                        let text = String::from_utf8_lossy(&record[index]);
                        CsvLineError { line, message: format!("column `{column}`: `{text}` is not a finite number") }
                    })?
                };
                self.values.push(value);
            }
            self.row_lines.push(line);
            std::mem::swap(&mut record, &mut before);
        }
        Ok(())
    }
}

/// The finite number in a field; none if its text is another.
fn number(field: &[u8]) -> Option<f64> {
    String::from_utf8_lossy(field).trim().parse().ok().filter(|value: &f64| value.is_finite())
}
