//! Rows of Parquet, as pandas, pyarrow, Polars and DuckDB write it.
//!
//! Numbers are DOUBLE, FLOAT, INT32, INT64 or BOOLEAN, text is BYTE_ARRAY in UTF-8; names may carry a unit as in CSV. Nulls
//! are missing values. Columns of other types are allowed as long as the study does not name them. The index that pandas adds to rows
//! (`__index_level_0__`) is not a column.
//!
//! A column is decoded when it is first asked for, some thousand rows at a time.

use super::{Place, TableColumn, check_names, wrong};
use crate::{Error, Result};
use parquet::{
    basic::{Compression, ConvertedType, LogicalType, Type},
    column::reader::{ColumnReader, ColumnReaderImpl},
    data_type::{ByteArray, DataType},
    errors::ParquetError,
    file::reader::{FileReader, SerializedFileReader},
    schema::types::{ColumnDescriptor, SchemaDescriptor},
};
use std::{
    borrow::Cow,
    cell::Cell,
    fmt,
    fs::File,
    panic::{self, AssertUnwindSafe},
    path::{Path, PathBuf},
    sync::Once,
};

/// Rows of a column that are decoded at once: little memory, and little to do for each time.
const CHUNK: usize = 8192;

/// Types that are read as numbers, and types that are read as text.
const NUMBERS: &str = "DOUBLE, FLOAT, INT32, INT64 or BOOLEAN";
const TEXTS: &str = "BYTE_ARRAY (String), DOUBLE, FLOAT, INT32, INT64 or BOOLEAN";

/// Returns true if a file with this beginning is a Parquet file: its mark, then in Thrift's compact protocol the first
/// field of a structure, an integer. No text has such a character.
pub(super) fn begins(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PAR1\x15")
}

/// The rows of a file, one after the other.
pub(super) struct Parquet {
    path: PathBuf,
    file: SerializedFileReader<File>,
    columns: Vec<Leaf>,
    /// The row group, its rows, and those of the groups before it.
    group: usize,
    rows: usize,
    rows_before: u64,
    /// The row in its group, counted from 1; zero before the first.
    row: usize,
}

/// A column and the part of it that is decoded.
struct Leaf {
    name: String,
    content: ColumnType,
    /// Position among the columns that are stored.
    index: usize,
    reader: Option<ColumnReader>,
    /// Row group of the reader.
    group: usize,
    /// Rows of that group before the chunk, and before the next one.
    start: usize,
    end: usize,
    chunk: Chunk,
}

/// Type of the values of a column.
#[derive(Clone, Debug, PartialEq, Eq)]
enum ColumnType {
    Number { is_unsigned: bool },
    Text,
    Other(String),
}

/// Values of some rows, null for none.
enum Chunk {
    Doubles(Vec<Option<f64>>),
    // wide enough for signed and unsigned ones
    Integers(Vec<Option<i128>>),
    Texts(Vec<Option<ByteArray>>),
}

impl fmt::Debug for Parquet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Parquet").field("path", &self.path).field("place", &self.place()).finish_non_exhaustive()
    }
}

impl Parquet {
    /// Reads the names and types of the columns.
    pub(super) fn new(path: &Path, file: File) -> Result<(Self, Vec<TableColumn>)> {
        let file = contained(|| SerializedFileReader::new(file)).map_err(Error::table(path, Place::Whole))?;
        let schema = file.metadata().file_metadata().schema_descr_ptr();
        let leaves: Vec<Leaf> = contained(|| Ok(leaves(&schema))).map_err(Error::table(path, Place::Whole))?;
        let columns: Vec<TableColumn> = leaves.iter().map(|leaf| TableColumn::parse(&leaf.name)).collect();
        check_names(&columns).map_err(Error::table(path, Place::Whole))?;
        let mut rows = Self { path: path.to_owned(), file, columns: leaves, group: 0, rows: 0, rows_before: 0, row: 0 };
        rows.rows = rows.rows_of(0);
        Ok((rows, columns))
    }

    /// See [`super::Table::next_row`].
    pub(super) fn next_row(&mut self) -> bool {
        while self.row == self.rows {
            if self.group + 1 >= self.file.num_row_groups() {
                return false;
            }
            self.rows_before += self.rows as u64;
            self.group += 1;
            (self.rows, self.row) = (self.rows_of(self.group), 0);
        }
        self.row += 1;
        true
    }

    fn rows_of(&self, group: usize) -> usize {
        let groups = self.file.metadata().row_groups();
        groups.get(group).map_or(0, |group| usize::try_from(group.num_rows()).unwrap_or(0))
    }

    pub(super) fn place(&self) -> Place {
        match self.rows_before + self.row as u64 {
            0 => Place::Whole,
            row => Place::Row(row),
        }
    }

    /// See [`super::Table::share_read`].
    pub(super) fn share_read(&self) -> f64 {
        let rows = self.file.metadata().file_metadata().num_rows().max(1);
        (self.rows_before + self.row as u64) as f64 / rows as f64
    }

    /// See [`super::Table::text`].
    pub(super) fn text(&mut self, column: usize) -> Result<Cow<'_, str>> {
        let index = self.decode(column, TEXTS)?;
        let Leaf { name, chunk, .. } = &self.columns[column];
        Ok(match chunk {
            Chunk::Doubles(values) => values[index].map_or(String::new(), |value| value.to_string()).into(),
            Chunk::Integers(values) => values[index].map_or(String::new(), |value| value.to_string()).into(),
            Chunk::Texts(values) => match &values[index] {
                None => "".into(),
                Some(bytes) => std::str::from_utf8(bytes.data()).map(Cow::from).map_err(|_| {
                    let message = format!("column `{name}`: {:?} is not UTF-8", String::from_utf8_lossy(bytes.data()));
                    wrong(&self.path, self.place(), message)
                })?,
            },
        })
    }

    /// The number in a column, if there is one.
    pub(super) fn number(&mut self, column: usize) -> Result<Option<f64>> {
        let index = self.decode(column, NUMBERS)?;
        match &self.columns[column].chunk {
            Chunk::Doubles(values) => Ok(values[index]),
            Chunk::Integers(values) => Ok(values[index].map(|value| value as f64)),
            Chunk::Texts(_) => Err(self.refused(column, "BYTE_ARRAY (String)", NUMBERS)),
        }
    }

    /// Sees to it that the row is in the column's chunk, and gives its position there.
    fn decode(&mut self, column: usize, expected: &str) -> Result<usize> {
        let leaf = &self.columns[column];
        let row = self.row - 1;
        if leaf.reader.is_none() || leaf.group != self.group || !(leaf.start..leaf.end).contains(&row) {
            self.read_chunk(column, row, expected)?;
        }
        Ok(row - self.columns[column].start)
    }

    /// Decodes the rows of a column from `row` on.
    fn read_chunk(&mut self, column: usize, row: usize, expected: &str) -> Result<()> {
        let leaf = &self.columns[column];
        let is_unsigned = match &leaf.content {
            ColumnType::Number { is_unsigned } => *is_unsigned,
            ColumnType::Text => false,
            ColumnType::Other(found) => return Err(self.refused(column, found, expected)),
        };
        if leaf.reader.is_none() || leaf.group != self.group {
            self.open(column)?;
        }
        let leaf = &mut self.columns[column];
        let count = CHUNK.min(self.rows - row);
        let Some(reader) = &mut leaf.reader else { return Ok(()) };
        let skip = row - leaf.end;
        let chunk = contained(|| {
            Ok(match reader {
                ColumnReader::DoubleColumnReader(reader) => Chunk::Doubles(read(reader, skip, count)?),
                ColumnReader::FloatColumnReader(reader) => Chunk::Doubles(map(read(reader, skip, count)?, f64::from)),
                ColumnReader::Int32ColumnReader(reader) => {
                    let values = read(reader, skip, count)?;
                    Chunk::Integers(map(values, |value| if is_unsigned { (value as u32).into() } else { value.into() }))
                }
                ColumnReader::Int64ColumnReader(reader) => {
                    let values = read(reader, skip, count)?;
                    Chunk::Integers(map(values, |value| if is_unsigned { (value as u64).into() } else { value.into() }))
                }
                ColumnReader::BoolColumnReader(reader) => Chunk::Integers(map(read(reader, skip, count)?, i128::from)),
                ColumnReader::ByteArrayColumnReader(reader) => Chunk::Texts(read(reader, skip, count)?),
                _ => return Err(ParquetError::General("a type that does not fit the schema".into())),
            })
        });
        match chunk {
            Ok(chunk) => {
                (leaf.chunk, leaf.start, leaf.end) = (chunk, row, row + count);
                Ok(())
            }
            Err(error) => {
                let message = format!("column `{}`: {error}", leaf.name);
                Err(wrong(&self.path, self.place(), message))
            }
        }
    }

    /// Begins a column of the row group.
    fn open(&mut self, column: usize) -> Result<()> {
        let Leaf { name, index, .. } = &self.columns[column];
        let reader = contained(|| {
            let group = self.file.get_row_group(self.group)?;
            match group.metadata().column(*index).compression() {
                Compression::UNCOMPRESSED | Compression::SNAPPY | Compression::GZIP(_) => {}
                codec => return Ok(Err(codec.to_string())),
            }
            group.get_column_reader(*index).map(Ok)
        });
        let message = match reader {
            Ok(Ok(reader)) => {
                let leaf = &mut self.columns[column];
                (leaf.reader, leaf.group, leaf.start, leaf.end) = (Some(reader), self.group, 0, 0);
                return Ok(());
            }
            Ok(Err(codec)) => {
                // as in ZSTD(ZstdLevel(1))
                let codec = codec.split('(').next().unwrap_or_default();
                let todo = "write the file again with `compression=\"snappy\"`";
                format!("column `{name}`: compressed with {codec}, expected SNAPPY, GZIP or none: {todo}")
            }
            Err(error) => format!("column `{name}`: {error}"),
        };
        Err(wrong(&self.path, Place::Whole, message))
    }

    fn refused(&self, column: usize, found: &str, expected: &str) -> Error {
        let message = format!("column `{}` is {found}, expected {expected}", self.columns[column].name);
        wrong(&self.path, Place::Whole, message)
    }
}

/// Skips rows, then reads some, which must be there.
fn read<T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    skip: usize,
    count: usize,
) -> std::result::Result<Vec<Option<T::T>>, ParquetError> {
    let (mut levels, mut values) = (Vec::new(), Vec::new());
    let skipped = reader.skip_records(skip)?;
    let (found, ..) = reader.read_records(count, Some(&mut levels), None, &mut values)?;
    if (skipped, found) != (skip, count) {
        let message = format!("{} rows less than in its row group", skip + count - skipped - found);
        return Err(ParquetError::EOF(message));
    }
    if values.len() == count {
        return Ok(values.into_iter().map(Some).collect());
    }
    let mut values = values.into_iter();
    Ok(levels.into_iter().map(|level| if level > 0 { values.next() } else { None }).collect())
}

fn map<T, U>(values: Vec<Option<T>>, convert: impl Fn(T) -> U) -> Vec<Option<U>> {
    values.into_iter().map(|value| value.map(&convert)).collect()
}

/// The columns of a schema; one of a nested type is one column.
fn leaves(schema: &SchemaDescriptor) -> Vec<Leaf> {
    let mut leaves: Vec<Leaf> = Vec::new();
    for (index, root) in schema.root_schema().get_fields().iter().enumerate() {
        let position = (0..schema.num_columns()).find(|&leaf| schema.get_column_root_idx(leaf) == index);
        let content = match position.map(|position| schema.column(position)) {
            Some(column) if root.is_primitive() && column.max_rep_level() == 0 => ColumnType::of(&column),
            _ => ColumnType::Other("nested".into()),
        };
        let name = root.name();
        if name.starts_with("__index_level_") {
            continue;
        }
        let (reader, chunk) = (None, Chunk::Texts(Vec::new()));
        let index = position.unwrap_or(0);
        leaves.push(Leaf { name: name.into(), content, index, reader, group: 0, start: 0, end: 0, chunk });
    }
    leaves
}

impl ColumnType {
    fn of(column: &ColumnDescriptor) -> Self {
        use ConvertedType::{INT_8, INT_16, INT_32, INT_64, NONE, UINT_8, UINT_16, UINT_32, UINT_64, UTF8};
        let (physical, logical, converted) =
            (column.physical_type(), column.logical_type_ref(), column.converted_type());
        match (physical, logical, converted) {
            (Type::DOUBLE | Type::FLOAT | Type::BOOLEAN, ..) => Self::Number { is_unsigned: false },
            (Type::INT32 | Type::INT64, Some(LogicalType::Integer(integer)), _) => {
                Self::Number { is_unsigned: !integer.is_signed }
            }
            // that of a column of nulls only is unknown
            (Type::INT32 | Type::INT64, None | Some(LogicalType::Unknown), NONE | INT_8 | INT_16 | INT_32 | INT_64) => {
                Self::Number { is_unsigned: false }
            }
            (Type::INT32 | Type::INT64, None, UINT_8 | UINT_16 | UINT_32 | UINT_64) => {
                Self::Number { is_unsigned: true }
            }
            (Type::BYTE_ARRAY, Some(LogicalType::String), _) | (Type::BYTE_ARRAY, None, UTF8) => Self::Text,
            (_, Some(logical), _) => {
                // as in Timestamp(TimestampType { .. })
                let logical = format!("{logical:?}");
                Self::Other(format!("{physical} ({})", logical.split(['(', ' ']).next().unwrap_or_default()))
            }
            (_, None, NONE) => Self::Other(physical.to_string()),
            (_, None, converted) => Self::Other(format!("{physical} ({converted})")),
        }
    }
}

/// Reason why a Parquet file cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ParquetReadError {
    /// A file that needs something that the crate does not have.
    #[error("written in a way that is not read: {0}")]
    Unsupported(String),
    /// A file that the crate refuses.
    #[error("the file is damaged or cut off: {0}")]
    Damaged(ParquetError),
    /// A file that makes the crate panic.
    #[error("the file is damaged")]
    Panicked,
}

/// Calls the crate, which panics at some damaged files (found by flipping bits: a dictionary that was never set, lengths past
/// the end of a page). That is an error like its others, and nothing to report on its own.
pub fn contained<T>(
    call: impl FnOnce() -> std::result::Result<T, ParquetError>,
) -> std::result::Result<T, ParquetReadError> {
    thread_local! { static IS_CONTAINED: Cell<bool> = const { Cell::new(false) } }
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let report = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            if !IS_CONTAINED.get() {
                report(panic);
            }
        }));
    });
    IS_CONTAINED.set(true);
    let result = panic::catch_unwind(AssertUnwindSafe(call));
    IS_CONTAINED.set(false);
    match result {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(ParquetError::NYI(what))) => Err(ParquetReadError::Unsupported(what)),
        Ok(Err(error)) => Err(ParquetReadError::Damaged(error)),
        Err(_) => Err(ParquetReadError::Panicked),
    }
}

#[cfg(test)]
mod tests {
    use crate::{Result, diagnostics::Place, table::Table};
    use parquet::{
        basic::Compression,
        column::writer::ColumnWriter,
        data_type::ByteArray,
        file::{
            properties::{EnabledStatistics, WriterProperties},
            writer::SerializedFileWriter,
        },
        schema::parser::parse_message_type,
    };
    use std::{collections::HashSet, sync::Arc};

    /// Two row groups of each type that is read; the value of row 3 of `y` is missing.
    fn file(compression: Compression, has_dictionary: bool) -> Vec<u8> {
        let schema = "message runs {
            required byte_array run (string); optional double time; required float a; required int32 b;
            required int64 c (integer(64, false)); required boolean d; optional double y; optional int96 when;
        }";
        let schema = Arc::new(parse_message_type(schema).unwrap());
        let properties = WriterProperties::builder()
            .set_compression(compression)
            .set_dictionary_enabled(has_dictionary)
            .set_statistics_enabled(EnabledStatistics::None)
            .build();
        let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::new(properties)).unwrap();
        for run in 0..2 {
            let mut group = writer.next_row_group().unwrap();
            while let Some(mut column) = group.next_column().unwrap() {
                let levels = if run == 0 { [1, 1, 0] } else { [1, 1, 1] };
                let count = if run == 0 { 2 } else { 3 };
                let value = [1.5, 2.5, 3.5].map(|value| value + f64::from(run));
                match column.untyped() {
                    ColumnWriter::ByteArrayColumnWriter(writer) => {
                        writer.write_batch(&[(); 3].map(|()| ByteArray::from(vec![b'a' + run])), None, None)
                    }
                    ColumnWriter::DoubleColumnWriter(writer) => {
                        writer.write_batch(&value[..count], Some(&levels), None)
                    }
                    ColumnWriter::FloatColumnWriter(writer) => writer.write_batch(&value.map(|v| v as f32), None, None),
                    ColumnWriter::Int32ColumnWriter(writer) => writer.write_batch(&[-1, 2, 3], None, None),
                    ColumnWriter::Int64ColumnWriter(writer) => writer.write_batch(&[-1, 2, 3], None, None),
                    ColumnWriter::BoolColumnWriter(writer) => writer.write_batch(&[true, false, true], None, None),
                    ColumnWriter::Int96ColumnWriter(writer) => writer.write_batch(&[], Some(&[0; 3]), None),
                    _ => panic!(),
                }
                .unwrap();
                column.close().unwrap();
            }
            group.close().unwrap();
        }
        writer.into_inner().unwrap()
    }

    /// All rows as text, but for the last column.
    fn read(bytes: &[u8]) -> Result<Vec<String>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let mut table = Table::open(file.path())?;
        let mut rows = Vec::new();
        while table.next_row()? {
            let mut row = table.place().to_string();
            for column in 0..table.columns().len().min(7) {
                row = format!("{row},{}", table.text(column)?);
            }
            rows.push(row);
        }
        Ok(rows)
    }

    const ROWS: [&str; 6] = [
        "row 1,a,1.5,1.5,-1,18446744073709551615,1,1.5",
        "row 2,a,2.5,2.5,2,2,0,2.5",
        "row 3,a,,3.5,3,3,1,",
        "row 4,b,2.5,2.5,-1,18446744073709551615,1,2.5",
        "row 5,b,3.5,3.5,2,2,0,3.5",
        "row 6,b,4.5,4.5,3,3,1,4.5",
    ];

    #[test]
    fn a_damaged_or_cut_file_is_an_error_and_no_panic() {
        let mut messages = HashSet::new();
        for (compression, has_dictionary) in [(Compression::UNCOMPRESSED, false), (Compression::SNAPPY, true)] {
            let whole = file(compression, has_dictionary);
            assert_eq!(read(&whole).unwrap(), ROWS);
            for at in 0..whole.len() {
                let mut bytes = whole.clone();
                bytes[at] ^= 1 << (at % 8);
                // a change of a number, or of something that is not read, goes unnoticed
                messages.extend(read(&bytes).err().map(|error| error.to_string()));
                // a file shorter than the mark is CSV
                if at >= 5 {
                    let message = read(&whole[..at]).unwrap_err().to_string();
                    assert!(message.contains(": the file is damaged or cut off: "), "{at}: {message}");
                }
            }
        }
        // without one of these the crate does not panic any more and need not be contained
        assert!(messages.iter().any(|message| message.ends_with(": the file is damaged")), "{messages:?}");
    }

    #[test]
    fn columns_are_read_in_any_order_and_some_rows_only() {
        let stored = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(stored.path(), file(Compression::SNAPPY, true)).unwrap();
        let mut table = Table::open(stored.path()).unwrap();
        let mut found = Vec::new();
        while table.next_row().unwrap() {
            match table.place() {
                Place::Row(2) => found.push(table.number(4).unwrap()),
                Place::Row(5) => found.extend([table.number(6).unwrap(), table.number(3).unwrap()]),
                Place::Row(6) => found.extend([table.number(3).unwrap(), table.number(6).unwrap()]),
                _ => {}
            }
        }
        assert_eq!(found, [2.0, 3.5, 2.0, 3.0, 4.5]);
    }
}
