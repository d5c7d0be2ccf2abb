//! Reads variables into rows of numbers.

use super::FmuInstance;
use crate::{
    Error, Result,
    model_description::{RealAttributes, ScalarVariable, VariableType},
};
use serde::{Deserialize, Serialize};

/// A recorded variable, or an element of one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordedColumn {
    /// The variable's name; of an array with the indices of the element, counted from 1.
    pub name: String,
    /// Its unit.
    pub unit: Option<String>,
}

/// Reads variables of several types into rows of numbers.
pub struct Recorder<'a> {
    instance: &'a FmuInstance<'a>,
    /// The columns of a row.
    pub columns: Vec<RecordedColumn>,
    /// Scalars of double precision, which nearly all variables are: read by one call.
    reals: Vec<u32>,
    /// And the columns they go to.
    real_columns: Vec<usize>,
    /// The others, with the first of the columns they go to.
    others: Vec<(&'a ScalarVariable, usize)>,
}

impl<'a> Recorder<'a> {
    /// Records all outputs that are numbers, unless it is `only` those named, then the named variables.
    pub fn new(instance: &'a FmuInstance<'a>, more: &[String], only: bool) -> Result<Self> {
        let description = instance.fmu().description();
        let mut variables: Vec<&ScalarVariable> =
            description.outputs().filter(|output| output.kind.is_number() && !only).collect();
        for name in more {
            let variable = find(instance, name)?;
            if !variable.kind.is_number() {
                let problem = "is not a number: only numbers can be recorded".into();
                return Err(Error::Variable { name: name.clone(), problem });
            }
            if !variables.iter().any(|known| known.name == variable.name) {
                variables.push(variable);
            }
        }
        let mut recorder =
            Self { instance, columns: Vec::new(), reals: Vec::new(), real_columns: Vec::new(), others: Vec::new() };
        for variable in variables {
            let column = recorder.columns.len();
            if variable.dimensions.is_empty()
                && matches!(variable.kind, VariableType::Real(RealAttributes { single: false, .. }))
            {
                recorder.reals.push(variable.value_reference);
                recorder.real_columns.push(column);
            } else {
                recorder.others.push((variable, column));
            }
            instance.element_count(variable)?;
            let shape = description.shape(variable).unwrap_or_default();
            let unit = description.unit_of(variable).map(str::to_owned);
            let names = element_names(&variable.name, &shape);
            recorder.columns.extend(names.map(|name| RecordedColumn { name, unit: unit.clone() }));
        }
        Ok(recorder)
    }

    /// The values now.
    pub fn row(&self) -> Result<Vec<f64>> {
        let mut row = vec![0.0; self.columns.len()];
        if !self.reals.is_empty() {
            let mut reals = vec![0.0; self.reals.len()];
            self.instance.get_real(&self.reals, &mut reals)?;
            for (&column, value) in self.real_columns.iter().zip(reals) {
                row[column] = value;
            }
        }
        for &(variable, column) in &self.others {
            let values = self.instance.get_numbers(variable)?;
            row[column..column + values.len()].copy_from_slice(&values);
        }
        Ok(row)
    }
}

/// `name`, or `name[1,1]`, `name[1,2]` and so on, the last index first to change.
pub fn element_names(name: &str, shape: &[u64]) -> impl Iterator<Item = String> {
    let count = shape.iter().copied().fold(1, u64::saturating_mul);
    (0..count).map(move |mut position| {
        let mut indices = Vec::new();
        for size in shape.iter().rev() {
            indices.push((position % size + 1).to_string());
            position /= size;
        }
        indices.reverse();
        if shape.is_empty() { name.to_owned() } else { format!("{name}[{}]", indices.join(",")) }
    })
}

pub(super) fn find<'a>(instance: &FmuInstance<'a>, name: &str) -> Result<&'a ScalarVariable> {
    let description = instance.fmu().description();
    description.variable(name).ok_or_else(|| Error::UnknownVariable {
        name: name.into(),
        known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_of_arrays_are_named_in_row_major_order() {
        let names = |shape: &[u64]| element_names("x", shape).collect::<Vec<_>>();
        assert_eq!(names(&[]), ["x"]);
        assert_eq!(names(&[2]), ["x[1]", "x[2]"]);
        assert_eq!(names(&[2, 3]), ["x[1,1]", "x[1,2]", "x[1,3]", "x[2,1]", "x[2,2]", "x[2,3]"]);
        assert_eq!(names(&[2, 0]), [""; 0]);
    }
}
