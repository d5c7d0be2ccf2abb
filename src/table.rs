//! Tables of other tools, read row by row: CSV as spreadsheets and multibody packages write it.
//!
//! Columns are separated by commas, semicolons or tabs, whichever the header has; with semicolons and tabs numbers may have
//! decimal commas. Names may be quoted and carry a unit, `angle [rad]` or `angle (rad)`; or the second row holds the units.
//! Empty lines and lines that begin with `#` are skipped, a separator at the end of every line is not a column. UTF-8, with
//! or without a byte order mark, or Latin-1.

use crate::{Error, Result};
use csv_core::{Reader, ReaderBuilder};
use std::{
    borrow::Cow,
    fs::File,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
};

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    /// Name in the header, without the unit.
    pub name: String,
    /// Unit, if the table has one.
    pub unit: Option<String>,
}

/// A name as a field of a header: quoted if it has a separator, as in `a[1,2]`.
pub fn header_field(name: &str) -> String {
    let is_plain = !name.contains([',', ';', '\t', '"', '\n', '\r']) && !name.starts_with('#') && name.trim() == name;
    if is_plain { name.to_owned() } else { format!("\"{}\"", name.replace('"', "\"\"")) }
}

/// A table that is being read.
#[derive(Debug)]
pub struct Table {
    path: PathBuf,
    input: BufReader<File>,
    parser: Reader,
    separator: u8,
    columns: Vec<Column>,
    record: Record,
    /// The record is one that was read to see whether it holds units, and is still to be given out.
    is_waiting: bool,
    /// Line of the first number with a decimal point, and of the first with a decimal comma.
    point: Option<u64>,
    comma: Option<u64>,
}

/// A line and its fields.
#[derive(Debug, Default)]
struct Record {
    /// Counted from 1.
    line: u64,
    raw: Vec<u8>,
    /// The fields without quotes, one after the other, and where each ends.
    text: Vec<u8>,
    ends: Vec<usize>,
}

impl Record {
    fn field(&self, index: usize) -> Cow<'_, str> {
        let start = if index == 0 { 0 } else { self.ends[index - 1] };
        decode(self.text[start..self.ends[index]].trim_ascii())
    }

    fn fields(&self) -> impl Iterator<Item = Cow<'_, str>> {
        (0..self.ends.len()).map(|index| self.field(index))
    }
}

impl Table {
    /// Opens a table and reads its header.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] if the header is not one.
    pub fn open(path: &Path) -> Result<Self> {
        let input = BufReader::with_capacity(1 << 16, File::open(path).map_err(Error::io(path, "read"))?);
        let mut table = Self {
            path: path.to_owned(),
            input,
            parser: Reader::new(),
            separator: b',',
            columns: Vec::new(),
            record: Record::default(),
            is_waiting: false,
            point: None,
            comma: None,
        };
        if !table.next_line()? {
            return Err(table.mistake("the table is empty"));
        }
        let mut header = std::mem::take(&mut table.record.raw);
        if header.starts_with(b"\xFF\xFE") || header.starts_with(b"\xFE\xFF") {
            return Err(table.mistake("the text is UTF-16, expected UTF-8: save the table with that encoding"));
        }
        if header.starts_with(b"PAR1") {
            return Err(table.mistake("this is a Parquet file, expected CSV"));
        }
        if let Some(rest) = header.strip_prefix(b"\xEF\xBB\xBF") {
            header = rest.to_vec();
        }
        table.separator = separator(&header);
        table.parser = ReaderBuilder::new().delimiter(table.separator).build();
        table.record.raw = header;
        table.split()?;
        table.read_header()?;
        table.read_units()?;
        Ok(table)
    }

    /// The columns, in the order of the header.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// Position of the column of a name.
    ///
    /// # Errors
    /// [`Error::Table`] with the columns there are.
    pub fn column(&self, name: &str) -> Result<usize> {
        let found = self.columns.iter().position(|column| column.name == name);
        found.ok_or_else(|| {
            let known: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
            self.at(1, format!("no column `{name}`, expected it among {}", known.join(", ")))
        })
    }

    /// Goes to the next row; `false` if there is none.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] if the row has another number of fields than the header.
    pub fn next_row(&mut self) -> Result<bool> {
        if std::mem::take(&mut self.is_waiting) {
            return Ok(true);
        }
        if !self.next_line()? {
            return Ok(false);
        }
        self.split()?;
        let (found, expected) = (self.record.ends.len(), self.columns.len());
        if found < expected || !self.record.fields().skip(expected).all(|field| field.is_empty()) {
            return Err(self.mistake(&format!("{found} fields, expected {expected}")));
        }
        Ok(true)
    }

    /// Line of the row, counted from 1.
    pub fn line(&self) -> u64 {
        self.record.line
    }

    /// The row's text in a column.
    pub fn text(&self, column: usize) -> Cow<'_, str> {
        self.record.field(column)
    }

    /// The row's number in a column.
    ///
    /// # Errors
    /// [`Error::Table`] if it is missing or no finite number.
    pub fn number(&mut self, column: usize) -> Result<f64> {
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
            return Err(self.at(point.max(comma), message));
        }
        match parsed {
            Some(value) if f64::is_finite(value) => Ok(value),
            _ => {
                let name = &self.columns[column].name;
                let found = if field.is_empty() { "is empty".into() } else { format!("`{field}`") };
                let message = format!("column `{name}`: {found}, expected a finite number");
                Err(self.mistake(&message))
            }
        }
    }

    /// The row's number in a column, between `min` and `max`.
    ///
    /// # Errors
    /// As [`Table::number`], and if it is out of range.
    pub fn number_in(&mut self, column: usize, min: f64, max: f64) -> Result<f64> {
        let value = self.number(column)?;
        if value < min || value > max {
            let name = &self.columns[column].name;
            return Err(self.mistake(&format!("column `{name}`: {value}, expected {min} to {max}, the study's range")));
        }
        Ok(value)
    }

    /// Checks that a column's unit, if it has one, is the expected one, if there is one.
    ///
    /// # Errors
    /// [`Error::Table`].
    pub fn check_unit(&self, column: usize, expected: Option<&str>) -> Result<()> {
        let Column { name, .. } = &self.columns[column];
        match (self.columns[column].unit(), expected) {
            (Some(found), Some(expected)) if found != expected => {
                Err(self.at(1, format!("column `{name}`: unit `{found}`, expected `{expected}`")))
            }
            _ => Ok(()),
        }
    }

    /// A mistake in the row.
    pub fn mistake(&self, message: &str) -> Error {
        self.at(self.record.line, message.into())
    }

    /// A mistake in a line.
    pub fn at(&self, line: u64, message: String) -> Error {
        Error::Table { path: self.path.clone(), line: line.max(1), message }
    }

    /// Reads the next line that is neither empty nor a comment.
    fn next_line(&mut self) -> Result<bool> {
        loop {
            self.record.raw.clear();
            let count = self.input.read_until(b'\n', &mut self.record.raw).map_err(Error::io(&self.path, "read"))?;
            if count == 0 {
                return Ok(false);
            }
            self.record.line += 1;
            if !self.record.raw.trim_ascii().is_empty() && !self.record.raw.starts_with(b"#") {
                return Ok(true);
            }
        }
    }

    /// Splits the line into fields.
    fn split(&mut self) -> Result<()> {
        let Record { raw, text, ends, .. } = &mut self.record;
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

    fn read_header(&mut self) -> Result<()> {
        self.columns = self.record.fields().map(|name| Column::parse(&name)).collect();
        while self.columns.last().is_some_and(|column| column.name.is_empty()) {
            self.columns.pop();
        }
        for (index, Column { name, .. }) in self.columns.iter().enumerate() {
            if name.is_empty() {
                return Err(self.mistake(&format!("column {} has no name", index + 1)));
            }
            if name.parse::<f64>().is_ok() {
                return Err(self.mistake(&format!("`{name}` is a number, expected a header with the columns' names")));
            }
            if self.columns[..index].iter().any(|before| before.name == *name) {
                return Err(self.mistake(&format!("column `{name}` stands twice")));
            }
        }
        Ok(())
    }

    /// Takes the second row for units if it holds no number.
    fn read_units(&mut self) -> Result<()> {
        self.is_waiting = self.next_row()?;
        let is_number = |field: Cow<'_, str>| field.replacen(',', ".", 1).parse::<f64>().is_ok();
        let mut fields = self.record.fields();
        if self.is_waiting && !self.record.fields().any(is_number) && fields.any(|field| !field.is_empty()) {
            for (column, field) in self.columns.iter_mut().zip(self.record.fields()) {
                let unit = bracketed(&field).unwrap_or(&field);
                column.unit = Some(unit.to_owned()).filter(|unit| !unit.is_empty()).or(column.unit.take());
            }
            self.is_waiting = false;
        }
        Ok(())
    }
}

impl Column {
    /// `NAME`, `NAME [UNIT]` or `NAME (UNIT)`.
    fn parse(text: &str) -> Self {
        for (open, close) in [('[', ']'), ('(', ')')] {
            let parts = text.strip_suffix(close).and_then(|text| text.split_once(open));
            // a name such as f(x) has no unit
            if let Some((name, unit)) = parts.filter(|(name, _)| name.ends_with(' ')) {
                return Self { name: name.trim().into(), unit: Some(unit.trim().into()) };
            }
        }
        Self { name: text.into(), unit: None }
    }

    /// The unit as the study writes it: `-` and `1` are no unit.
    pub fn unit(&self) -> Option<&str> {
        self.unit.as_deref().map(|unit| if matches!(unit, "-" | "1") { "" } else { unit })
    }
}

/// The content of `[...]` or `(...)`.
fn bracketed(text: &str) -> Option<&str> {
    let square = text.strip_prefix('[').and_then(|text| text.strip_suffix(']'));
    square.or_else(|| text.strip_prefix('(').and_then(|text| text.strip_suffix(')'))).map(str::trim)
}

/// What separates the columns of a header: the first of these that stands outside of quotes.
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
    let latin_1 = |_| bytes.iter().map(|&byte| char::from(byte)).collect::<String>().into();
    std::str::from_utf8(bytes).map_or_else(latin_1, Cow::from)
}

fn trim_end(line: &[u8]) -> &[u8] {
    let line = line.strip_suffix(b"\n").unwrap_or(line);
    line.strip_suffix(b"\r").unwrap_or(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(bytes: &[u8]) -> Result<Table> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        Table::open(file.path())
    }

    type Rows = Vec<(u64, Vec<f64>)>;

    /// Names with units, and all rows as numbers with their lines.
    fn read(text: &str) -> Result<(Vec<String>, Rows)> {
        let mut table = open(text.as_bytes())?;
        let names = table.columns().iter().map(|c| format!("{}|{}", c.name, c.unit().unwrap_or("?"))).collect();
        let mut rows = Vec::new();
        while table.next_row()? {
            let values = (0..table.columns().len()).map(|column| table.number(column)).collect::<Result<_>>()?;
            rows.push((table.line(), values));
        }
        Ok((names, rows))
    }

    #[test]
    fn what_other_tools_write_is_the_same_table() {
        let rows = vec![(2, vec![0.0, 1.5]), (3, vec![0.5, -2.5e-3])];
        for text in [
            "time [s],theta [rad]\n0,1.5\n0.5,-2.5e-3\n",
            "\u{feff}time (s);theta (rad)\r\n0,0;1,5\r\n0,5;-2,5E-3",
            "\"time [s]\"\t\"theta [rad]\"\n 0.0 \t 1.5\n0.5\t-0.0025\n",
            "time [s];theta [rad];\n0;1.5;\n0.5;-2.5e-3;\n",
        ] {
            assert_eq!(read(text).unwrap(), (vec!["time|s".into(), "theta|rad".into()], rows.clone()), "{text}");
        }
        let (names, rows) =
            read("# written by a tool\n\ntime,\"the, angle\",n\n[s],rad,-\n# here\n1,2,3\n\n4,5,6").unwrap();
        assert_eq!(names, ["time|s", "the, angle|rad", "n|"]);
        assert_eq!(rows, [(6, vec![1.0, 2.0, 3.0]), (8, vec![4.0, 5.0, 6.0])]);
    }

    #[test]
    fn latin_1_is_read() {
        let table = open(b"time,\"angle [\xB0]\"\n0,1\n").unwrap();
        assert_eq!(table.columns()[1], Column { name: "angle".into(), unit: Some("\u{b0}".into()) });
    }

    #[test]
    fn mistakes_name_line_column_and_what_was_expected() {
        for (text, says) in [
            ("", ":1: the table is empty"),
            ("# only this\n", ":1: the table is empty"),
            ("0,1\n1,2\n", ":1: `0` is a number, expected a header"),
            ("time,,x\n", ":1: column 2 has no name"),
            ("time,x,x\n", ":1: column `x` stands twice"),
            ("time,x\n0,1\n1\n", ":3: 1 fields, expected 2"),
            ("time,x\n0,1\n1,2,3\n", ":3: 3 fields, expected 2"),
            ("time,x\n0,1\n\n1,\n", ":4: column `x`: is empty, expected a finite number"),
            ("time,x\n0,1\n1,NaN\n", ":3: column `x`: `NaN`, expected a finite number"),
            ("time,x\n0,1\n1,inf\n", ":3: column `x`: `inf`, expected"),
            ("time,x\n0,1\n1,1e999\n", ":3: column `x`: `1e999`, expected"),
            ("time,x\n0,1\n1,one\n", ":3: column `x`: `one`, expected"),
            ("time;x\n0;1.500,2\n", ":2: column `x`: `1.500,2`, expected"),
            ("time;x\n0;1,5\n1;2.5\n", ":3: decimal points (line 3) and decimal commas (line 2) in one table"),
            ("time,x\n0,\"1\n", ":2: a quote is opened and not closed"),
            ("PAR1\u{15}\u{4}", ":1: this is a Parquet file, expected CSV"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(says), "{text:?}: {message}");
        }
        let message = open(b"\xFF\xFEt\0i\0").unwrap_err().to_string();
        assert!(message.contains("UTF-16, expected UTF-8"), "{message}");
        let table = open(b"time,x\n0,1\n").unwrap();
        let message = table.column("y").unwrap_err().to_string();
        assert!(message.contains(":1: no column `y`, expected it among time, x"), "{message}");
    }
}
