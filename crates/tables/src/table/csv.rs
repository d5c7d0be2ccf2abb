//! Rows of CSV, as spreadsheets and multibody packages write it.
//!
//! Columns are separated by commas, semicolons or tabs, whichever the header has; with semicolons and tabs numbers may have
//! decimal commas. Names may be quoted and carry a unit, `angle [rad]` or `angle (rad)`; or the second row holds the units.
//! Empty lines and lines that begin with `#` are skipped, a separator at the end of every line is not a column. Lines end with
//! LF, CR LF, or CR as once on the Macintosh. UTF-8, with or without a byte order mark, or Latin-1.

use super::{Place, TableColumn, bracketed, check_names, wrong};
use crate::{Error, Result, diagnostics::numbers::counted, reading::ByteSource};
use csv_core::{Reader, ReaderBuilder};
use std::{
    borrow::Cow,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

/// Bytes of a line at most.
const MAX_LINE: u64 = 64 << 20;

/// The rows of a file, one after the other.
#[derive(Debug)]
pub(super) struct Csv<'a> {
    path: PathBuf,
    input: BufReader<ByteSource<'a>>,
    /// Bytes that were read, and those of the file.
    read: u64,
    length: u64,
    parser: Reader,
    separator: u8,
    /// The last character of a line.
    line_end: u8,
    /// Columns of the header.
    width: usize,
    record: CsvRecord,
    /// The record is one that was read to see whether it holds units, and is still to be given out.
    is_waiting: bool,
    /// Line of the first number with a decimal point, and of the first with a decimal comma.
    point: Option<u64>,
    comma: Option<u64>,
}

/// A line and its fields.
#[derive(Debug, Default)]
struct CsvRecord {
    /// Counted from 1.
    line: u64,
    raw: Vec<u8>,
    /// The fields without quotes, one after the other, and where each ends.
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl CsvRecord {
    fn field(&self, index: usize) -> Cow<'_, str> {
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        decode(self.text[start..self.ends[index]].trim_ascii())
    }

    fn fields(&self) -> impl Iterator<Item = Cow<'_, str>> {
        (0..self.ends.len()).map(|index| self.field(index))
    }
}

impl<'a> Csv<'a> {
    /// Reads the header.
    pub(super) fn new(path: &Path, mut input: BufReader<ByteSource<'a>>) -> Result<(Self, Vec<TableColumn>)> {
        let line_end = line_end(input.fill_buf().map_err(Error::io(path, "read"))?);
        let length = input.get_ref().length().map_err(Error::io(path, "read"))?;
        let mut csv = Self {
            path: path.to_owned(),
            input,
            read: 0,
            length,
            parser: Reader::new(),
            separator: b',',
            line_end,
            width: 0,
            record: CsvRecord::default(),
            is_waiting: false,
            point: None,
            comma: None,
        };
        if !csv.next_line()? {
            return Err(csv.mistake("the table is empty"));
        }
        let mut header = std::mem::take(&mut csv.record.raw);
        if header.starts_with(b"\xFF\xFE") || header.starts_with(b"\xFE\xFF") {
            return Err(csv.mistake("the text is UTF-16, expected UTF-8: save the table with that encoding"));
        }
        if let Some(rest) = header.strip_prefix(b"\xEF\xBB\xBF") {
            header = rest.to_vec();
        }
        csv.separator = separator(&header);
        csv.parser = ReaderBuilder::new().delimiter(csv.separator).build();
        csv.record.raw = header;
        csv.split()?;
        let mut columns = csv.read_header()?;
        csv.width = columns.len();
        csv.read_units(&mut columns)?;
        Ok((csv, columns))
    }

    /// See [`super::Table::next_row`].
    pub(super) fn next_row(&mut self) -> Result<bool> {
        if std::mem::take(&mut self.is_waiting) {
            return Ok(true);
        }
        if !self.next_line()? {
            return Ok(false);
        }
        self.split()?;
        let (found, expected) = (self.record.ends.len(), self.width);
        if found < expected || !self.record.fields().skip(expected).all(|field| field.is_empty()) {
            return Err(self.mistake(&format!("{}, expected {expected}", counted(found, "field"))));
        }
        Ok(true)
    }

    pub(super) fn place(&self) -> Place {
        Place::Line(self.record.line.max(1))
    }

    /// See [`super::Table::share_read`].
    pub(super) fn share_read(&self) -> f64 {
        // a pipe has no length
        self.read as f64 / self.length.max(self.read).max(1) as f64
    }

    pub(super) fn text(&self, column: usize) -> Cow<'_, str> {
        self.record.field(column)
    }

    /// The number in a field, if it is one. One table has decimal points or decimal commas.
    pub(super) fn number(&mut self, column: usize) -> Result<Option<f64>> {
        let (field, line) = (self.record.field(column), self.record.line);
        let parsed = if self.separator != b',' && field.contains(',') {
            self.comma = self.comma.or(Some(line));
            field.replacen(',', ".", 1).parse().ok().filter(|_| !field.contains('.'))
        } else {
            if field.contains('.') {
                self.point = self.point.or(Some(line));
            }
            field.parse().ok()
        };
        if let (Some(point), Some(comma)) = (self.point, self.comma) {
            let message = format!("decimal points (line {point}) and decimal commas (line {comma}) in one table");
            return Err(wrong(&self.path, Place::Line(point.max(comma)), message));
        }
        Ok(parsed)
    }

    fn mistake(&self, message: &str) -> Error {
        wrong(&self.path, self.place(), message.into())
    }

    /// Reads the next line that is neither empty nor a comment.
    fn next_line(&mut self) -> Result<bool> {
        loop {
            self.record.raw.clear();
            let mut input = self.input.by_ref().take(MAX_LINE + 1);
            let count = input.read_until(self.line_end, &mut self.record.raw);
            let count = count.map_err(Error::io(&self.path, "read"))? as u64;
            if count == 0 {
                return Ok(false);
            }
            self.read += count;
            self.record.line += 1;
            if count > MAX_LINE {
                return Err(self.mistake(&format!("a line of more than {MAX_LINE} bytes, expected a table")));
            }
            if !self.record.raw.trim_ascii().is_empty() && !self.record.raw.starts_with(b"#") {
                return Ok(true);
            }
        }
    }

    /// Splits the line into fields.
    fn split(&mut self) -> Result<()> {
        let CsvRecord { raw, text, ends, .. } = &mut self.record;
        let line = trim_end(raw);
        let is_open = line.iter().filter(|&&byte| byte == b'"').count() % 2 == 1;
        text.resize(line.len() + 1, 0);
        ends.resize(line.len() + 2, 0);
        self.parser.reset();
        let (_, _, written, fields) = self.parser.read_record(line, text, ends);
        // no input is the end of the last field
        let (_, _, _, last) = self.parser.read_record(&[], &mut text[written..], &mut ends[fields..]);
        ends.truncate(fields + last);
        if is_open { Err(self.mistake("a quote is opened and not closed in the line")) } else { Ok(()) }
    }

    fn read_header(&self) -> Result<Vec<TableColumn>> {
        let mut columns: Vec<TableColumn> = self.record.fields().map(|name| TableColumn::parse(&name)).collect();
        while columns.last().is_some_and(|column| column.name.is_empty()) {
            columns.pop();
        }
        if let Some(TableColumn { name, .. }) = columns.iter().find(|column| column.name.parse::<f64>().is_ok()) {
            return Err(self.mistake(&format!("`{name}` is a number, expected a header with the columns' names")));
        }
        check_names(&columns).map_err(|error| self.mistake(&error.to_string()))?;
        Ok(columns)
    }

    /// Takes the second row for units if it holds no number.
    fn read_units(&mut self, columns: &mut [TableColumn]) -> Result<()> {
        self.is_waiting = self.next_row()?;
        if !self.is_waiting {
            return Ok(());
        }
        let has_number = self.record.fields().any(|field| field.replacen(',', ".", 1).parse::<f64>().is_ok());
        if !has_number && self.record.fields().any(|field| !field.is_empty()) {
            for (column, field) in columns.iter_mut().zip(self.record.fields()) {
                let unit = bracketed(&field).unwrap_or(&field);
                column.unit = Some(unit.to_owned()).filter(|unit| !unit.is_empty()).or(column.unit.take());
            }
            self.is_waiting = false;
        }
        Ok(())
    }
}

/// Byte that ends the first line.
fn line_end(text: &[u8]) -> u8 {
    let end = text.iter().position(|byte| b"\r\n".contains(byte));
    match end.map(|end| &text[end..]) {
        Some([b'\r', next, ..]) if *next != b'\n' => b'\r',
        _ => b'\n',
    }
}

/// Separator of the columns of a header: the first of semicolon, tab and comma that occurs outside of quotes, else a
/// comma.
fn separator(header: &[u8]) -> u8 {
    let mut is_quoted = false;
    let plain: Vec<u8> = header
        .iter()
        .copied()
        .filter(|&byte| {
            is_quoted ^= byte == b'"';
            !is_quoted
        })
        .collect();
    *b";\t,".iter().find(|separator| plain.contains(separator)).unwrap_or(&b',')
}

/// Text in UTF-8, or else Latin-1, whose bytes are the first characters of Unicode.
fn decode(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => text.into(),
        // Latin 1
        Err(_) => bytes.iter().map(|&byte| char::from(byte)).collect::<String>().into(),
    }
}

fn trim_end(line: &[u8]) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
}
