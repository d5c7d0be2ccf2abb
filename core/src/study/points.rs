//! Points that a study takes from a table.

use super::ParameterOptions;
use crate::{Result, diagnostics::Place, table::Table};
use indexmap::IndexMap;
use metafmu_runtime::TOLERANCE;
use std::path::Path;

/// Reads the points of the method "list": a table with a column for each parameter; others are not looked at.
///
/// # Errors
/// [`Error::Io`](crate::Error::Io), or [`Error::Table`](crate::Error::Table) with the line that is wrong.
pub fn read_points(path: &Path, parameters: &IndexMap<String, ParameterOptions>) -> Result<Vec<Vec<f64>>> {
    let mut table = Table::open(path)?;
    let columns: Vec<(usize, &ParameterOptions)> =
        table.columns_of(&parameters.keys().collect::<Vec<_>>())?.into_iter().zip(parameters.values()).collect();
    table.check_units(columns.iter().map(|(column, options)| (*column, options.unit.as_deref())))?;
    let mut points: IndexMap<Vec<u64>, Place> = IndexMap::new();
    while table.next_row()? {
        let mut point = Vec::with_capacity(columns.len());
        for &(column, options) in &columns {
            // zeros of both signs are one point
            point.push((read_value(&mut table, column, options)? + 0.0).to_bits());
        }
        if let Some(before) = points.insert(point, table.place()) {
            return Err(table.mistake(&format!("the point of {before} again")));
        }
    }
    if points.len() < 2 {
        return Err(table.mistake(&format!("{} points, expected at least 2", points.len())));
    }
    Ok(points.into_keys().map(|point| point.into_iter().map(f64::from_bits).collect()).collect())
}

/// The row's number in a column, which must be a value that the parameter may have. Of a nominal one it is the very value of
/// the study.
///
/// # Errors
/// [`Error::Table`](crate::Error::Table) with the line.
pub fn read_value(table: &mut Table, column: usize, options: &ParameterOptions) -> Result<f64> {
    let ParameterOptions { min, max, values, .. } = options;
    if !options.is_nominal() {
        return table.number_in(column, *min, *max);
    }
    let found = table.number(column)?;
    let same = |value: &&f64| (**value - found).abs() <= TOLERANCE * (max - min);
    values.iter().find(same).copied().ok_or_else(|| {
        let expected: Vec<String> = values.iter().map(f64::to_string).collect();
        let name = &table.columns()[column].name;
        table.mistake(&format!("column `{name}`: {found}, expected one of {}, the study's values", expected.join(", ")))
    })
}
