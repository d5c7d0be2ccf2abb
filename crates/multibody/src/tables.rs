//! Lookup tables of a description.

use super::{
    description::{Description, ExtrapolationKind, InterpolationKind, TableOptions, TableValues},
    expression::Tables,
};
use crate::{diagnostics::Problems, table::Table};
use metafmu_runtime::formula::{Extrapolation, Interpolation, LookupTable};
use std::{fmt, path::Path, sync::Arc};

/// Reads knots and values of tables from the files that they name, which are relative to a folder; every mistake by its key.
pub fn read_files(description: &mut Description, folder: &Path) -> Problems {
    let mut problems = Problems::default();
    for (name, options) in &mut description.tables {
        let mut add = |field: &str, message: &str| problems.add(format!("tables.{name}{field}"), message);
        let given = [("x", !options.x.is_empty()), ("y", options.y.is_some()), ("values", !options.values.is_empty())];
        let Some(file) = &options.file else {
            if options.columns.is_some() {
                add(".columns", "belongs to tables with a `file`");
            }
            for (field, _) in given.iter().filter(|(field, is_given)| *field != "y" && !is_given) {
                add("", &format!("no `{field}`, expected `x` and `values`, or a `file`"));
            }
            continue;
        };
        if let Some((field, _)) = given.iter().find(|(_, is_given)| *is_given) {
            add(&format!(".{field}"), "belongs to tables without a `file`");
            continue;
        }
        match read(&folder.join(file), options.columns.as_deref()) {
            Ok((x, y, values)) => (options.x, options.y, options.values) = (x, y, values),
            Err(error) => add(".file", &error.to_string()),
        }
    }
    problems
}

/// Content of a table of one argument or of both, and the values.
type TableContent = (Vec<f64>, Option<Vec<f64>>, Vec<TableValues>);

/// TableContent and values in a file.
fn read(path: &Path, columns: Option<&[String]>) -> crate::Result<TableContent> {
    let mut table = Table::open(path)?;
    let places = match columns {
        Some(names) => table.columns_of(names)?,
        None if table.columns().len() >= 2 => vec![0, 1],
        None => return Err(table.mistake_in_header("one column, expected one of knots and one of values")),
    };
    let (of_values, of_knots) = places.split_last().unwrap_or((&0, &[]));
    match of_knots {
        [of_x, of_y] => read_grid(&mut table, [*of_x, *of_y], *of_values),
        of_knots => {
            let (mut x, mut values) = (Vec::new(), Vec::new());
            while table.next_row()? {
                x.push(table.number(of_knots.first().copied().unwrap_or_default())?);
                values.push(TableValues::One(table.number(*of_values)?));
            }
            Ok((x, None, values))
        }
    }
}

/// Values at all pairs of knots, a row for each.
fn read_grid(table: &mut Table, of_knots: [usize; 2], of_values: usize) -> crate::Result<TableContent> {
    let mut rows = Vec::new();
    while table.next_row()? {
        // -0 and 0 are the same knot
        let [x, y] = [table.number(of_knots[0])? + 0.0, table.number(of_knots[1])? + 0.0];
        rows.push((x, y, table.number(of_values)?, table.place()));
    }
    let x = knots(rows.iter().map(|row| row.0).collect());
    let y = knots(rows.iter().map(|row| row.1).collect());
    rows.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let [of_x, of_y] = of_knots.map(|column| table.columns()[column].name.clone());
    if let Some(rows) = rows.windows(2).find(|rows| (rows[0].0, rows[0].1) == (rows[1].0, rows[1].1)) {
        let (x, y, _, place) = &rows[1];
        let message = format!("{of_x} = {x}, {of_y} = {y}: a second row, expected one for each pair");
        return Err(table.mistake_at(*place, &message));
    }
    let pairs = x.iter().flat_map(|x| y.iter().map(move |y| (*x, *y)));
    let mut found = rows.iter();
    for (x, y) in pairs {
        if found.next().is_none_or(|row| (row.0, row.1) != (x, y)) {
            let message = format!("no row with {of_x} = {x}, {of_y} = {y}, expected one for each pair");
            return Err(table.mistake_in_header(&message));
        }
    }
    let values: Vec<f64> = rows.iter().map(|row| row.2).collect();
    let values = values.chunks(y.len()).map(|row| TableValues::Row(row.to_vec())).collect();
    Ok((x, Some(y), values))
}

/// Numbers in increasing order, each once.
fn knots(mut numbers: Vec<f64>) -> Vec<f64> {
    numbers.sort_unstable_by(f64::total_cmp);
    numbers.dedup();
    numbers
}

/// The tables by their names, and the problems of the others.
pub fn tables(description: &Description) -> (Tables, Problems) {
    let (mut tables, mut problems) = (Tables::new(), Problems::default());
    for (name, options) in &description.tables {
        match table(options) {
            Ok(table) => {
                tables.insert(name.clone(), Arc::new(table));
            }
            Err(error) => {
                let field = if options.file.is_some() { "file" } else { error.field() };
                problems.add(format!("tables.{name}.{field}"), error.to_string());
            }
        }
    }
    (tables, problems)
}

/// Reason why the options of a table make none.
#[derive(Clone, Debug, PartialEq)]
enum LookupTableError {
    /// Knots of the argument `x` or `y`: fewer than two, not finite, or not ascending.
    Knots {
        /// The argument.
        field: &'static str,
        message: String,
    },
    /// Values: another number or kind than the knots require, or not finite.
    Values(String),
    /// A periodic table with different values at the ends of an argument.
    Open {
        /// The argument.
        axis: &'static str,
        begin: f64,
        end: f64,
    },
    /// Values that are too large, or knots that are too close together, for a spline.
    Spline,
}

impl LookupTableError {
    /// Key of the table that is wrong.
    fn field(&self) -> &'static str {
        match self {
            Self::Knots { field, .. } => field,
            Self::Values(_) | Self::Open { .. } | Self::Spline => "values",
        }
    }
}

impl fmt::Display for LookupTableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Knots { message, .. } | Self::Values(message) => f.write_str(message),
            Self::Open { axis, begin, end } => {
                write!(f, "{begin} at the first and {end} at the last `{axis}`, expected the same in a periodic table")
            }
            Self::Spline => f.write_str("too large or too close together for a spline"),
        }
    }
}

impl std::error::Error for LookupTableError {}

/// The table of some options.
fn table(options: &TableOptions) -> Result<LookupTable, LookupTableError> {
    let TableOptions { x, y, values, interpolation, extrapolation, .. } = options;
    check_knots("x", x)?;
    y.as_ref().map_or(Ok(()), |y| check_knots("y", y))?;
    if values.len() != x.len() {
        return Err(LookupTableError::Values(format!("{}, expected {}, one for each `x`", values.len(), x.len())));
    }
    let mut numbers = Vec::new();
    for (index, value) in values.iter().enumerate() {
        match (value, y) {
            (TableValues::One(value), None) => numbers.push(*value),
            (TableValues::Row(row), Some(y)) if row.len() == y.len() => numbers.extend(row),
            (TableValues::Row(row), Some(y)) => {
                let (found, expected) = (row.len(), y.len());
                return Err(LookupTableError::Values(format!(
                    "list {}: {found} numbers, expected {expected}, one for each `y`",
                    index + 1
                )));
            }
            (TableValues::One(_), Some(_)) => {
                return Err(LookupTableError::Values(format!(
                    "element {}: a number, expected a list with one for each `y`",
                    index + 1
                )));
            }
            (TableValues::Row(_), None) => {
                return Err(LookupTableError::Values(format!(
                    "element {}: a list, expected a number, or the knots `y`",
                    index + 1
                )));
            }
        }
    }
    if numbers.iter().any(|value| !value.is_finite()) {
        return Err(LookupTableError::Values("expected finite numbers".into()));
    }
    let axes = [Some(x), y.as_ref()].into_iter().flatten().cloned().collect();
    let interpolation = match interpolation {
        InterpolationKind::Linear => Interpolation::Linear,
        InterpolationKind::Cubic => Interpolation::Cubic,
    };
    let extrapolation = match extrapolation {
        ExtrapolationKind::Hold => Extrapolation::Hold,
        ExtrapolationKind::Linear => Extrapolation::Linear,
        ExtrapolationKind::Periodic => Extrapolation::Periodic,
    };
    if extrapolation == Extrapolation::Periodic {
        close(&mut numbers, [x.len(), y.as_ref().map_or(1, Vec::len)])?;
    }
    let table = LookupTable::new(axes, numbers, interpolation, extrapolation);
    // all else is checked above
    table.map_err(|_| LookupTableError::Spline)
}

/// Makes values at the ends of both arguments equal, if they are but for rounding; `values` has shape `[rows, columns]`.
fn close(values: &mut [f64], [rows, columns]: [usize; 2]) -> Result<(), LookupTableError> {
    /// Relative to the largest value.
    const ROUNDING: f64 = 1e-9;
    let least = ROUNDING * values.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let of_x = (0..columns).map(|column| (column, (rows - 1) * columns + column, "x"));
    let of_y = (0..rows).map(|row| (row * columns, row * columns + columns - 1, "y"));
    for (first, last, axis) in of_x.chain(of_y) {
        let [begin, end] = [values[first], values[last]];
        if (begin - end).abs() > least {
            return Err(LookupTableError::Open { axis, begin, end });
        }
        values[last] = begin;
    }
    Ok(())
}

/// Checks the knots of an argument.
fn check_knots(field: &'static str, knots: &[f64]) -> Result<(), LookupTableError> {
    let message = if knots.len() < 2 {
        format!("a list of {}, expected two or more knots", knots.len())
    } else if knots.iter().any(|knot| !knot.is_finite()) {
        "expected finite numbers".into()
    } else if let Some(index) = knots.windows(2).position(|pair| pair[0] >= pair[1]) {
        let (number, knot, before) = (index + 2, knots[index + 1], knots[index]);
        format!("element {number}: {knot} is not above {before}, expected ascending knots")
    } else {
        return Ok(());
    };
    Err(LookupTableError::Knots { field, message })
}
