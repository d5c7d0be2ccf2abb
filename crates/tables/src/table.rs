//! Tables of other tools, read row by row: CSV (module `csv`) and Parquet (module `parquet`), told apart by how they begin; and
//! tables for other tools ([`writer`]).
//!
//! Both readers give named columns with units and one row after the other; everything is checked here and by the readers of rows,
//! for both alike.

mod csv;
mod parquet;
pub mod runs;
pub mod stamps;
pub mod writer;

use crate::{
    Error, Result,
    diagnostics::{
        Place,
        kinds::{self, FileKind},
        names::{self, NameMatch},
        numbers::{ends, exact},
    },
    reading::{self, ByteSource},
    unit,
};
use csv::Csv;
use parquet::Parquet;
pub use parquet::contained;
use std::{
    borrow::Cow,
    collections::{HashMap, HashSet},
    fmt,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

/// A column of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableColumn {
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
pub struct Table<'a> {
    path: PathBuf,
    columns: Vec<TableColumn>,
    /// Position of each column by its name.
    positions: HashMap<String, usize>,
    rows: FormatReader<'a>,
    /// Flag that ends the wait for a pipe.
    stop: Option<&'a AtomicBool>,
}

/// Reader of a table in its format.
#[derive(Debug)]
enum FormatReader<'a> {
    Csv(Box<Csv<'a>>),
    Parquet(Box<Parquet>),
}

impl<'a> Table<'a> {
    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a table, a regular file, and reads its header.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] if the header is not one.
    pub fn open(path: &Path) -> Result<Self> {
        Self::of_bytes(path, ByteSource::File(reading::open(path).map_err(Error::io(path, "read"))?), None)
    }

    /// Opens a table that may also be a pipe or a device, for readers that go through it once. Nothing waits for a pipe once
    /// `stop` is true.
    ///
    /// # Errors
    /// As [`Table::open`], and [`Error::Interrupted`].
    pub fn open_stream(path: &Path, stop: &'a AtomicBool) -> Result<Self> {
        let input = ByteSource::open(path, stop).map_err(Error::io(path, "read"))?;
        Self::of_bytes(path, input, Some(stop)).map_err(|error| unless_stopped(Some(stop), error))
    }

    fn of_bytes(path: &Path, input: ByteSource<'a>, stop: Option<&'a AtomicBool>) -> Result<Self> {
        let mut input = BufReader::with_capacity(1 << 16, input);
        if kinds::of(path).is_some_and(|kind| kind != FileKind::Table) {
            return Err(kinds::other(path, "a table, in CSV or Parquet"));
        }
        let (rows, columns) = if parquet::begins(input.fill_buf().map_err(Error::io(path, "read"))?) {
            let ByteSource::File(file) = input.into_inner() else {
                let message =
                    "is a pipe or a device with Parquet, which is read from its end: write its content to a file first";
                return Err(Error::Table { path: path.to_owned(), place: Place::Whole, message: message.into() });
            };
            let (rows, columns) = Parquet::new(path, file)?;
            (FormatReader::Parquet(Box::new(rows)), columns)
        } else {
            let (rows, columns) = Csv::new(path, input)?;
            (FormatReader::Csv(Box::new(rows)), columns)
        };
        let positions = columns.iter().enumerate().map(|(position, column)| (column.name.clone(), position)).collect();
        Ok(Self { path: path.to_owned(), columns, positions, rows, stop })
    }

    /// The columns, in the order of the header.
    pub fn columns(&self) -> &[TableColumn] {
        &self.columns
    }

    /// Position of the column of a name.
    ///
    /// # Errors
    /// [`Error::Table`] with the columns there are.
    pub fn column(&self, name: &str) -> Result<usize> {
        match self.positions.get(name) {
            Some(position) => Ok(*position),
            None => Err(self.without(&[name])),
        }
    }

    /// Positions of the columns of several names.
    ///
    /// # Errors
    /// [`Error::Table`] with all names that have no column, each with the closest of the columns that are not used.
    pub fn columns_of<T: AsRef<str>>(&self, names: &[T]) -> Result<Vec<usize>> {
        let positions: Option<Vec<usize>> =
            names.iter().map(|name| self.positions.get(name.as_ref()).copied()).collect();
        positions.ok_or_else(|| self.without(&names.iter().map(AsRef::as_ref).collect::<Vec<&str>>()))
    }

    /// Position of a column that need not be there. `used`: columns that have another meaning.
    ///
    /// # Errors
    /// [`Error::Table`] if it is missing, and the name of an unused column differs from it in case or punctuation only.
    pub fn optional_column(&self, name: &str, used: &[usize]) -> Result<Option<usize>> {
        if let Some(position) = self.positions.get(name) {
            return Ok(Some(*position));
        }
        let mut unused = self.columns.iter().enumerate().filter(|(position, _)| !used.contains(position));
        match unused.find(|(_, column)| names::is_respelled(&column.name, name)) {
            None => Ok(None),
            Some((_, TableColumn { name: found, .. })) => {
                Err(self
                    .mistake_in_header(&format!("column `{found}`, expected the spelling `{name}`, or another name")))
            }
        }
    }

    /// Error for wanted columns, some of which are missing.
    fn without(&self, wanted: &[&str]) -> Error {
        let known: Vec<&str> = self.columns.iter().map(|column| column.name.as_str()).collect();
        let NameMatch { positions, unused } = NameMatch::of(wanted, &known);
        let missing: Vec<&str> =
            wanted.iter().zip(positions).filter(|(_, position)| position.is_none()).map(|(name, _)| *name).collect();
        let unused: Vec<&str> = unused.into_iter().map(|column| known[column]).collect();
        self.mistake_in_header(&names::missing("column", &missing, &known, &unused).unwrap_or_default())
    }

    /// Goes to the next row; `false` if there is none.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Table`] if the row has another number of fields than the header, or [`Error::Interrupted`].
    pub fn next_row(&mut self) -> Result<bool> {
        match &mut self.rows {
            FormatReader::Csv(csv) => csv.next_row().map_err(|error| unless_stopped(self.stop, error)),
            FormatReader::Parquet(parquet) => Ok(parquet.next_row()),
        }
    }

    /// Location of the row.
    pub fn place(&self) -> Place {
        match &self.rows {
            FormatReader::Csv(csv) => csv.place(),
            FormatReader::Parquet(parquet) => parquet.place(),
        }
    }

    /// The row's text in a column; empty where there is no value.
    ///
    /// # Errors
    /// [`Error::Table`] if a Parquet file is damaged, or its column holds something else than text and numbers.
    pub fn text(&mut self, column: usize) -> Result<Cow<'_, str>> {
        match &mut self.rows {
            FormatReader::Csv(csv) => Ok(csv.text(column)),
            FormatReader::Parquet(parquet) => parquet.text(column),
        }
    }

    /// The row's number in a column.
    ///
    /// # Errors
    /// [`Error::Table`] if it is missing or no finite number, or as [`Table::text`].
    pub fn number(&mut self, column: usize) -> Result<f64> {
        let found = match &mut self.rows {
            FormatReader::Csv(csv) => csv.number(column)?,
            FormatReader::Parquet(parquet) => parquet.number(column)?,
        };
        match found {
            Some(value) if value.is_finite() => Ok(value),
            _ => {
                let text = self.text(column)?;
                let found = if text.is_empty() { "is empty".into() } else { format!("`{text}`") };
                let hint = if has_commas(&text) { COMMAS } else { "" };
                let name = &self.columns[column].name;
                Err(self.mistake(&format!("column `{name}`: {found}, expected a finite number{hint}")))
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
            return Err(self.mistake(&format!(
                "column `{name}`: {}, expected {}, the study's range",
                exact(value),
                ends(min, max)
            )));
        }
        Ok(value)
    }

    /// Checks that a column's unit, if it has one, is the expected one, if there is one.
    ///
    /// # Errors
    /// [`Error::Table`].
    pub fn check_unit(&self, column: usize, expected: Option<&str>) -> Result<()> {
        self.check_units([(column, expected)])
    }

    /// Checks that the units of columns, if they have some, are the expected ones, if there are some.
    ///
    /// # Errors
    /// [`Error::Table`] with all that are not.
    pub fn check_units<'b>(&self, expected: impl IntoIterator<Item = (usize, Option<&'b str>)>) -> Result<()> {
        let problems = expected.into_iter().filter_map(|(column, expected)| self.unit_problem(column, expected));
        let problems: Vec<String> = problems.collect();
        if problems.is_empty() { Ok(()) } else { Err(self.mistake_in_header(&problems.join("; "))) }
    }

    /// The problem of a column's unit, if it has one, and one is expected.
    pub fn unit_problem(&self, column: usize, expected: Option<&str>) -> Option<String> {
        let column = &self.columns[column];
        let (found, expected) = (column.unit()?, expected?);
        (!unit::is_same(found, expected))
            .then(|| format!("column `{}`: unit `{found}`, expected `{expected}`", column.name))
    }

    /// How much of the table has been read, from 0 to 1.
    pub fn share_read(&self) -> f64 {
        match &self.rows {
            FormatReader::Csv(csv) => csv.share_read(),
            FormatReader::Parquet(parquet) => parquet.share_read(),
        }
    }

    /// A mistake in the row, or at the end of the table.
    pub fn mistake(&self, message: &str) -> Error {
        wrong(&self.path, self.place(), message.into())
    }

    /// A mistake in another row.
    pub fn mistake_at(&self, place: Place, message: &str) -> Error {
        wrong(&self.path, place, message.into())
    }

    /// A mistake in the header.
    pub fn mistake_in_header(&self, message: &str) -> Error {
        let place = match &self.rows {
            FormatReader::Csv(_) => Place::Line(1),
            FormatReader::Parquet(_) => Place::Whole,
        };
        wrong(&self.path, place, message.into())
    }
}

impl TableColumn {
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

/// Reason why columns cannot be told apart by their names.
#[derive(Clone, Debug, PartialEq, Eq)]
enum ColumnNameError {
    /// A column without a name: its position, counted from 0.
    Missing(usize),
    /// A name of two columns.
    Duplicated(String),
}

impl fmt::Display for ColumnNameError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing(0) => {
                f.write_str("column 1 has no name; an index of pandas is left out by `to_csv(index=False)`")
            }
            Self::Missing(index) => write!(f, "column {} has no name", index + 1),
            Self::Duplicated(name) => write!(f, "column `{name}` is duplicated"),
        }
    }
}

impl std::error::Error for ColumnNameError {}

/// Checks the names of the columns: each has one, and no two are equal.
fn check_names(columns: &[TableColumn]) -> std::result::Result<(), ColumnNameError> {
    let mut before = HashSet::with_capacity(columns.len());
    for (index, TableColumn { name, .. }) in columns.iter().enumerate() {
        if name.is_empty() {
            return Err(ColumnNameError::Missing(index));
        }
        if !before.insert(name.as_str()) {
            return Err(ColumnNameError::Duplicated(name.clone()));
        }
    }
    Ok(())
}

/// [`Error::Interrupted`] if a flag has ended the wait for a pipe, else the error.
fn unless_stopped(stop: Option<&AtomicBool>, error: Error) -> Error {
    if stop.is_some_and(|stop| stop.load(Ordering::Relaxed)) { Error::Interrupted } else { error }
}

fn wrong(path: &Path, place: Place, message: String) -> Error {
    Error::Table { path: path.to_owned(), place, message }
}

/// Advice on commas within numbers.
const COMMAS: &str = " without separators of thousands; decimal commas require semicolons or tabs between columns";

/// Returns true for a number with separators of thousands, or with a decimal comma.
pub fn has_commas(text: &str) -> bool {
    text.contains(',') && text.replace(',', "").parse::<f64>().is_ok()
}

/// Returns true if a text is neither empty nor a number, whatever its commas are.
pub fn is_text(text: &str) -> bool {
    !(text.is_empty() || text.parse::<f64>().is_ok() || has_commas(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(bytes: &[u8]) -> Result<Table<'static>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        Table::open(file.path())
    }

    type Lines = Vec<(Place, Vec<f64>)>;

    /// Names with units, and all rows as numbers with their lines.
    fn read(text: &str) -> Result<(Vec<String>, Lines)> {
        let mut table = open(text.as_bytes())?;
        let names = table.columns().iter().map(|c| format!("{}|{}", c.name, c.unit().unwrap_or("?"))).collect();
        let mut rows = Vec::new();
        while table.next_row()? {
            let values = (0..table.columns().len()).map(|column| table.number(column)).collect::<Result<_>>()?;
            rows.push((table.place(), values));
        }
        Ok((names, rows))
    }

    #[test]
    fn what_other_tools_write_is_the_same_table() {
        let rows = vec![(Place::Line(2), vec![0.0, 1.5]), (Place::Line(3), vec![0.5, -2.5e-3])];
        for text in [
            "time [s],theta [rad]\n0,1.5\n0.5,-2.5e-3\n",
            "\u{feff}time (s);theta (rad)\r\n0,0;1,5\r\n0,5;-2,5E-3",
            "\"time [s]\"\t\"theta [rad]\"\n 0.0 \t 1.5\n0.5\t-0.0025\n",
            "time [s];theta [rad];\n0;1.5;\n0.5;-2.5e-3;\n",
            "time [s],theta [rad]\r0,1.5\r0.5,-2.5e-3\r",
        ] {
            assert_eq!(read(text).unwrap(), (vec!["time|s".into(), "theta|rad".into()], rows.clone()), "{text}");
        }
        let (names, rows) =
            read("# written by a tool\n\ntime,\"the, angle\",n\n[s],rad,-\n# here\n1,2,3\n\n4,5,6").unwrap();
        assert_eq!(names, ["time|s", "the, angle|rad", "n|"]);
        assert_eq!(rows, [(Place::Line(6), vec![1.0, 2.0, 3.0]), (Place::Line(8), vec![4.0, 5.0, 6.0])]);
    }

    #[test]
    fn latin_1_is_read() {
        let table = open(b"time,\"angle [\xB0]\"\n0,1\n").unwrap();
        assert_eq!(table.columns()[1], TableColumn { name: "angle".into(), unit: Some("\u{b0}".into()) });
    }

    #[test]
    fn mistakes_name_line_column_and_what_was_expected() {
        for (text, says) in [
            ("", ":1: the table is empty"),
            ("# only this\n", ":1: the table is empty"),
            ("0,1\n1,2\n", ":1: `0` is a number, expected a header"),
            ("time,,x\n", ":1: column 2 has no name"),
            ("time,x,x\n", ":1: column `x` is duplicated"),
            ("time,x\n0,1\n1\n", ":3: 1 field, expected 2"),
            ("time,x\n0,1\n1,2,3\n", ":3: 3 fields, expected 2"),
            ("time,x\n0,1\n\n1,\n", ":4: column `x`: is empty, expected a finite number"),
            ("time,x\n0,1\n1,NaN\n", ":3: column `x`: `NaN`, expected a finite number"),
            ("time,x\n0,1\n1,inf\n", ":3: column `x`: `inf`, expected"),
            ("time,x\n0,1\n1,1e999\n", ":3: column `x`: `1e999`, expected"),
            ("time,x\n0,1\n1,one\n", ":3: column `x`: `one`, expected"),
            ("time;x\n0;1.500,2\n", ":2: column `x`: `1.500,2`, expected"),
            ("time;x\n0;1,5\n1;2.5\n", ":3: decimal points (line 3) and decimal commas (line 2) in one table"),
            ("time,x\n0,\"1\n", ":2: a quote is opened and not closed"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(says), "{text:?}: {message}");
        }
        let message = open(b"\xFF\xFEt\0i\0").unwrap_err().to_string();
        assert!(message.contains("UTF-16, expected UTF-8"), "{message}");
        let table = open(b"time,x\n0,1\n").unwrap();
        let message = table.column("y").unwrap_err().to_string();
        assert!(message.contains(":1: no column `y`, expected it among time, x"), "{message}");
        let message = table.columns_of(&["Time", "x", "y"]).unwrap_err().to_string();
        let says = ":1: no columns `Time`, `y`, expected them among time, x; did you mean `time` for `Time`?";
        assert!(message.ends_with(says), "{message}");
    }

    #[test]
    fn a_table_of_many_columns_is_read_in_a_moment() {
        const COLUMNS: usize = 80_000;
        let names: Vec<String> = (0..COLUMNS).map(|column| format!("y{column}")).collect();
        let begin = std::time::Instant::now();
        let table = open(format!("{}\n{}0\n", names.join(","), "0,".repeat(COLUMNS - 1)).as_bytes()).unwrap();
        for (position, name) in names.iter().enumerate() {
            assert_eq!(table.column(name).unwrap(), position);
        }
        let message = table.column("z").unwrap_err().to_string();
        assert!(message.contains("y18, y19 and 79980 more"), "{message}");
        // comparing each name with each takes half a minute
        assert!(begin.elapsed().as_secs() < 10, "{:?}", begin.elapsed());
    }

    #[test]
    fn commas_within_numbers_are_told_from_text() {
        let numbers = ["1,5", "1,500.5", "-1,5e-3", "1,500"];
        assert!(numbers.into_iter().all(|text| has_commas(text) && !is_text(text)));
        let others = [("", false), ("NaN", false), ("1.5", false), ("true", true), ("a,b", true), ("1 500", true)];
        assert!(others.into_iter().all(|(text, expected)| !has_commas(text) && is_text(text) == expected));
    }
}
