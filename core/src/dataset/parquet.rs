//! Tables of runs as Parquet: `run` is INT64, all other columns are DOUBLE.

use super::{Dataset, DatasetColumns, Run, RunReader};
use crate::{
    Error, Result,
    diagnostics::Place,
    reading,
    table::{
        contained,
        writer::{Block, Format, Values, Writer},
    },
};
use parquet::{
    basic::Type,
    column::reader::ColumnReader,
    errors::ParquetError,
    file::reader::{FileReader, SerializedFileReader},
};
use rayon::prelude::*;
use std::{
    fs::File,
    io::{self, Write},
    path::Path,
};

/// Numbers of a row group, 32 MB: whole runs up to this count, or one longer run.
const GROUP: usize = 1 << 22;

/// Writes the table.
pub(super) fn write(dataset: &Dataset, to: &mut dyn Write) -> io::Result<()> {
    let names = dataset.columns();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let mut writer = Writer::new(Format::Parquet, &names);
    let mut index = 0;
    while index < dataset.runs.len() {
        let runs = &dataset.runs[index..][..group(&dataset.runs[index..], names.len())];
        let blocks: Vec<Block> = runs.par_iter().enumerate().map(|(of, run)| block(index + of, run)).collect();
        writer.write(&blocks, to)?;
        index += runs.len();
    }
    writer.finish(to)
}

/// Number of runs of the next row group.
fn group(runs: &[Run], columns: usize) -> usize {
    let ends = runs.iter().scan(0, |numbers: &mut usize, run| {
        *numbers += run.times.len() * columns;
        Some(*numbers)
    });
    ends.take_while(|&numbers| numbers <= GROUP).count().max(1)
}

/// The rows of a run, column by column.
fn block(index: usize, run: &Run) -> Block {
    let rows = run.times.len();
    let label = i64::try_from(index).unwrap_or(i64::MAX);
    let mut block = vec![Values::Integers(vec![label; rows]), Values::Numbers(run.times.to_vec())];
    block.extend(run.parameters.iter().map(|&value| Values::Numbers(vec![value; rows])));
    for values in [&run.inputs, &run.outputs] {
        let width = values.len() / rows.max(1);
        let column = |first| values.iter().skip(first).step_by(width).copied().collect();
        block.extend((0..width).map(|first| Values::Numbers(column(first))));
    }
    block
}

/// Reads the table from a file that is not damaged.
pub(super) fn read(path: &Path, variables: DatasetColumns) -> Result<Dataset> {
    let wrong = |place, message| Error::Table { path: path.to_owned(), place, message };
    let file = reading::open(path).map_err(Error::io(path, "read"))?;
    let file = contained(|| SerializedFileReader::new(file)).map_err(Error::table(path, Place::Whole))?;
    let mut dataset = variables.without_runs();
    let columns = dataset.columns();
    check_columns(&file, &columns).map_err(Error::table(path, Place::Whole))?;
    let mut reader = RunReader::new([variables.parameters.len(), variables.inputs.len()]);
    let (mut number, mut row) = (0, Vec::with_capacity(columns.len()));
    for group in 0..file.num_row_groups() {
        let values = contained(|| group_values(&file, group)).map_err(Error::table(path, Place::Whole))?;
        for index in 0..values[0].len() {
            number += 1;
            row.clear();
            row.extend(values.iter().map(|column| column[index]));
            if let Some(column) = row.iter().position(|value| !value.is_finite()) {
                let message = format!("column `{}`: `{}` is not a finite number", columns[column], row[column]);
                return Err(wrong(Place::Row(number), message));
            }
            dataset.runs.extend(reader.push(&row).map_err(Error::table(path, Place::Row(number)))?);
        }
    }
    dataset.runs.extend(reader.finish());
    if dataset.runs.is_empty() {
        return Err(wrong(Place::Whole, "the table has no rows".into()));
    }
    Ok(dataset)
}

/// Reason why the columns of a file are not those of the dataset.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum ColumnsError {
    /// Other names, or the same in another order.
    #[error("columns `{}`, expected `{}`", found.join(","), expected.join(","))]
    Names { found: Vec<String>, expected: Vec<String> },
    /// A column of another type, or one that may have missing values.
    #[error("column `{column}` is {found}, expected {expected} without missing values")]
    Type { column: String, found: Type, expected: Type },
}

/// Checks the names and types of the columns.
fn check_columns(file: &SerializedFileReader<File>, expected: &[String]) -> std::result::Result<(), ColumnsError> {
    let schema = file.metadata().file_metadata().schema_descr();
    let found: Vec<&str> = schema.columns().iter().map(|column| column.name()).collect();
    if found != expected {
        let found = found.into_iter().map(str::to_owned).collect();
        return Err(ColumnsError::Names { found, expected: expected.to_owned() });
    }
    for (position, column) in schema.columns().iter().enumerate() {
        let (found, expected) = (column.physical_type(), if position == 0 { Type::INT64 } else { Type::DOUBLE });
        if found != expected || column.max_def_level() > 0 {
            return Err(ColumnsError::Type { column: column.name().to_owned(), found, expected });
        }
    }
    Ok(())
}

/// The values of a row group, column by column: as many of each.
fn group_values(file: &SerializedFileReader<File>, group: usize) -> std::result::Result<Vec<Vec<f64>>, ParquetError> {
    let group = file.get_row_group(group)?;
    let rows = usize::try_from(group.metadata().num_rows())?;
    (0..group.num_columns())
        .map(|column| {
            let mut values = Vec::new();
            match group.get_column_reader(column)? {
                ColumnReader::DoubleColumnReader(mut reader) => {
                    reader.read_records(rows, None, None, &mut values)?;
                }
                ColumnReader::Int64ColumnReader(mut reader) => {
                    let mut integers = Vec::new();
                    reader.read_records(rows, None, None, &mut integers)?;
                    values = integers.into_iter().map(|value| value as f64).collect();
                }
                _ => return Err(ParquetError::General("a type that does not fit the schema".into())),
            }
            match values.len() == rows {
                true => Ok(values),
                false => Err(ParquetError::EOF(format!("{} rows fewer than in its row group", rows - values.len()))),
            }
        })
        .collect()
}
