//! Tables for other tools, written block by block: CSV or Parquet.
//!
//! CSV has commas, a header with the names, numbers as the shortest decimals that read back as the same doubles, `NaN`, and
//! `true` and `false`. Parquet has INT64, DOUBLE, BOOLEAN, and for labels INT64 if all of the first blocks are whole numbers, else
//! BYTE_ARRAY (String), without nulls and compressed with snappy; each call of [`Writer::write`] makes a row group.

use super::header_field;
use parquet::{
    basic::{Compression, ConvertedType, LogicalType, Repetition, Type as Physical},
    column::writer::ColumnWriter,
    data_type::ByteArray,
    errors::ParquetError,
    file::{
        properties::{EnabledStatistics, WriterProperties},
        writer::SerializedFileWriter,
    },
    schema::types::{ColumnPath, PrimitiveTypeBuilder, Type},
};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{
    io::{self, Write},
    path::Path,
    sync::Arc,
};

/// Format of a written table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Text.
    Csv,
    /// Columns in binary, compressed.
    Parquet,
}

/// End of a file's name, after the dot, that is not that of a table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`.{0}`, expected a file that ends in .csv or .parquet")]
pub struct TableExtensionError(pub String);

impl Format {
    /// All formats.
    pub const ALL: [Self; 2] = [Self::Csv, Self::Parquet];

    /// End of a file's name, after the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Parquet => "parquet",
        }
    }

    /// Format of a file by the end of its name: `.parquet`, else `.csv` or none.
    ///
    /// # Errors
    /// [`TableExtensionError`] if its name ends otherwise.
    pub fn of(path: &Path) -> Result<Self, TableExtensionError> {
        match path.extension().map(|extension| extension.to_string_lossy().to_lowercase()).as_deref() {
            Some("parquet") => Ok(Self::Parquet),
            Some("csv") | None => Ok(Self::Csv),
            Some(other) => Err(TableExtensionError(other.to_owned())),
        }
    }
}

/// Values of a column in the rows of a block.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Labels.
    Labels(Labels),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Numbers; NaN if they could not be computed.
    Numbers(Vec<f64>),
    /// Truth values.
    Flags(Vec<bool>),
}

/// Texts, one for each row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Labels {
    text: String,
    ends: Vec<usize>,
}

impl Labels {
    /// One text in each of `count` rows.
    pub fn repeated(label: &str, count: usize) -> Self {
        Self { text: label.repeat(count), ends: (1..=count).map(|row| row * label.len()).collect() }
    }

    /// Adds a row.
    pub fn push(&mut self, label: &str) {
        self.text.push_str(label);
        self.ends.push(self.text.len());
    }

    fn get(&self, row: usize) -> &str {
        let start = row.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.text[start..self.ends[row]]
    }

    fn iter(&self) -> impl Iterator<Item = &str> {
        (0..self.ends.len()).map(|row| self.get(row))
    }
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Self::Labels(labels) => labels.ends.len(),
            Self::Integers(values) => values.len(),
            Self::Numbers(values) => values.len(),
            Self::Flags(values) => values.len(),
        }
    }
}

/// Some rows: the values of each column, as many in each of them.
pub type Block = Vec<Values>;

/// A table that is being written.
pub struct Writer {
    format: Format,
    names: Vec<String>,
    /// None before the first rows, whose values determine the types of the columns.
    written: Option<FormatWriter>,
}

enum FormatWriter {
    Csv,
    // what it writes waits in memory until the row group is complete
    Parquet(Box<SerializedFileWriter<Vec<u8>>>),
}

impl Writer {
    /// A table with columns of these names.
    pub fn new(format: Format, names: &[&str]) -> Self {
        Self { format, names: names.iter().map(|name| (*name).to_owned()).collect(), written: None }
    }

    /// Writes rows, the first time with a header.
    ///
    /// # Errors
    /// Errors of `to`; for Parquet also a label that is not a whole number although all labels of the first rows are.
    pub fn write(&mut self, blocks: &[Block], to: &mut dyn Write) -> io::Result<()> {
        if blocks.iter().all(|block| block.first().is_none_or(|values| values.len() == 0)) {
            return Ok(());
        }
        let written = match &mut self.written {
            Some(written) => written,
            None => self.written.insert(FormatWriter::begin(self.format, &self.names, blocks, to)?),
        };
        match written {
            FormatWriter::Csv => {
                let texts: Vec<Vec<u8>> = blocks.par_iter().map(lines).collect();
                texts.iter().try_for_each(|text| to.write_all(text))
            }
            FormatWriter::Parquet(writer) => {
                write_group(writer, blocks).map_err(io::Error::other)?;
                writer.flush()?;
                to.write_all(writer.inner())?;
                writer.inner_mut().clear();
                Ok(())
            }
        }
    }

    /// Ends the table, which is empty if it has no rows.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn finish(self, to: &mut dyn Write) -> io::Result<()> {
        match self.written {
            None | Some(FormatWriter::Csv) => Ok(()),
            Some(FormatWriter::Parquet(writer)) => to.write_all(&writer.into_inner().map_err(io::Error::other)?),
        }
    }
}

impl FormatWriter {
    fn begin(format: Format, names: &[String], first: &[Block], to: &mut dyn Write) -> io::Result<Self> {
        match format {
            Format::Csv => {
                let header: Vec<String> = names.iter().map(|name| header_field(name)).collect();
                writeln!(to, "{}", header.join(","))?;
                Ok(Self::Csv)
            }
            Format::Parquet => Ok(Self::Parquet(Box::new(parquet(names, first).map_err(io::Error::other)?))),
        }
    }
}

/// The lines of a block.
fn lines(block: &Block) -> Vec<u8> {
    let (mut text, mut digits) = (Vec::new(), zmij::Buffer::new());
    for row in 0..block.first().map_or(0, Values::len) {
        for (column, values) in block.iter().enumerate() {
            if column > 0 {
                text.push(b',');
            }
            match values {
                Values::Labels(labels) => text.extend_from_slice(header_field(labels.get(row)).as_bytes()),
                Values::Integers(values) => text.extend_from_slice(values[row].to_string().as_bytes()),
                Values::Numbers(values) => text.extend_from_slice(digits.format(values[row]).as_bytes()),
                Values::Flags(values) => text.extend_from_slice(if values[row] { b"true" } else { b"false" }),
            }
        }
        text.push(b'\n');
    }
    text
}

fn parquet(names: &[String], first: &[Block]) -> Result<SerializedFileWriter<Vec<u8>>, ParquetError> {
    let mut fields = Vec::new();
    // other numbers hardly repeat, and looking for those that do takes most of the time
    let mut properties = WriterProperties::builder()
        .set_compression(Compression::SNAPPY)
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_dictionary_enabled(false);
    for (column, name) in names.iter().enumerate() {
        let mut values = first.iter().map(|block| &block[column]);
        let field = match values.clone().next() {
            Some(Values::Labels(_)) => {
                properties = properties.set_column_dictionary_enabled(ColumnPath::from(vec![name.clone()]), true);
                if values.all(|values| matches!(values, Values::Labels(labels) if labels.iter().all(is_whole))) {
                    required_field(name, Physical::INT64)
                } else {
                    required_field(name, Physical::BYTE_ARRAY)
                        .with_logical_type(Some(LogicalType::String))
                        .with_converted_type(ConvertedType::UTF8)
                }
            }
            Some(Values::Integers(_)) => {
                properties = properties.set_column_dictionary_enabled(ColumnPath::from(vec![name.clone()]), true);
                required_field(name, Physical::INT64)
            }
            Some(Values::Flags(_)) => required_field(name, Physical::BOOLEAN),
            Some(Values::Numbers(_)) | None => required_field(name, Physical::DOUBLE),
        };
        fields.push(Arc::new(field.build()?));
    }
    let schema = Type::group_type_builder("schema").with_fields(fields).build()?;
    SerializedFileWriter::new(Vec::new(), Arc::new(schema), Arc::new(properties.build()))
}

/// A column without missing values.
fn required_field(name: &str, physical: Physical) -> PrimitiveTypeBuilder<'_> {
    Type::primitive_type_builder(name, physical).with_repetition(Repetition::REQUIRED)
}

/// Returns true if a label is a whole number in its usual form: not `007`.
fn is_whole(label: &str) -> bool {
    label.parse::<i64>().is_ok_and(|number| number.to_string() == label)
}

fn write_group(writer: &mut SerializedFileWriter<Vec<u8>>, blocks: &[Block]) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    let mut index = 0;
    while let Some(mut column) = group.next_column()? {
        for block in blocks {
            match (&block[index], column.untyped()) {
                (Values::Numbers(values), ColumnWriter::DoubleColumnWriter(writer)) => {
                    writer.write_batch(values, None, None)?
                }
                (Values::Integers(values), ColumnWriter::Int64ColumnWriter(writer)) => {
                    writer.write_batch(values, None, None)?
                }
                (Values::Flags(values), ColumnWriter::BoolColumnWriter(writer)) => {
                    writer.write_batch(values, None, None)?
                }
                (Values::Labels(labels), ColumnWriter::Int64ColumnWriter(writer)) => {
                    let numbers = labels.iter().map(whole).collect::<Result<Vec<i64>, _>>()?;
                    writer.write_batch(&numbers, None, None)?
                }
                (Values::Labels(labels), ColumnWriter::ByteArrayColumnWriter(writer)) => {
                    let texts: Vec<ByteArray> = labels.iter().map(ByteArray::from).collect();
                    writer.write_batch(&texts, None, None)?
                }
                _ => return Err(ParquetError::General("a column has values of two types".into())),
            };
        }
        column.close()?;
        index += 1;
    }
    group.close()?;
    Ok(())
}

fn whole(label: &str) -> Result<i64, ParquetError> {
    label.parse().ok().filter(|_| is_whole(label)).ok_or_else(|| {
        let message = format!("the label `{label}` is no whole number, those before it are: write CSV instead");
        ParquetError::General(message)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Table;

    fn block(labels: &[&str], numbers: &[f64], flags: &[bool]) -> Block {
        let mut texts = Labels::default();
        labels.iter().for_each(|label| texts.push(label));
        vec![Values::Labels(texts), Values::Numbers(numbers.to_vec()), Values::Flags(flags.to_vec())]
    }

    fn written(format: Format, parts: &[Vec<Block>]) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut writer = Writer::new(format, &["run", "a[1,2]", "is"]);
        parts.iter().try_for_each(|blocks| writer.write(blocks, &mut bytes))?;
        writer.finish(&mut bytes)?;
        Ok(bytes)
    }

    /// All fields as text.
    fn read(bytes: &[u8]) -> Vec<Vec<String>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        let mut table = Table::open(file.path()).unwrap();
        let mut rows = vec![table.columns().iter().map(|column| column.name.clone()).collect()];
        while table.next_row().unwrap() {
            rows.push((0..3).map(|column| table.text(column).unwrap().into_owned()).collect());
        }
        rows
    }

    #[test]
    fn what_is_written_is_read_again_in_both_formats() {
        let parts = [
            vec![block(&["x, y", ""], &[0.1, f64::NAN], &[true, false]), block(&["z"], &[-1e-300], &[true])],
            vec![block(&[], &[], &[])],
            vec![block(&["7"], &[3.0], &[false])],
        ];
        let text = String::from_utf8(written(Format::Csv, &parts).unwrap()).unwrap();
        assert_eq!(text, "run,\"a[1,2]\",is\n\"x, y\",0.1,true\n,NaN,false\nz,-1e-300,true\n7,3.0,false\n");
        let rows = read(&written(Format::Parquet, &parts).unwrap());
        let small = format!("{}", -1e-300);
        for (found, expected) in rows.iter().zip([
            ["run", "a[1,2]", "is"],
            ["x, y", "0.1", "1"],
            ["", "NaN", "0"],
            ["z", &small, "1"],
            ["7", "3", "0"],
        ]) {
            assert_eq!(found, &expected);
        }
        assert_eq!(rows.len(), 5);
    }

    #[test]
    fn labels_are_whole_numbers_in_parquet_if_the_first_ones_are() {
        let parts =
            |later: &str| [vec![block(&["-7", "12"], &[0.0; 2], &[true; 2])], vec![block(&[later], &[0.0], &[true])]];
        let bytes = written(Format::Parquet, &parts("3")).unwrap();
        assert!(!String::from_utf8_lossy(&bytes).contains("-7"), "the numbers are binary");
        assert_eq!(read(&bytes)[1][0], "-7");
        let message = written(Format::Parquet, &parts("03")).unwrap_err().to_string();
        assert!(message.contains("the label `03` is no whole number"), "{message}");
        assert!(written(Format::Csv, &parts("03")).is_ok());
    }

    #[test]
    fn the_format_is_that_of_the_name() {
        for (name, expected) in [
            ("a.csv", Ok(Format::Csv)),
            ("a", Ok(Format::Csv)),
            ("a.b.Parquet", Ok(Format::Parquet)),
            ("a.xlsx", Err(())),
        ] {
            assert_eq!(Format::of(Path::new(name)).map_err(|_| ()), expected, "{name}");
        }
    }
}
