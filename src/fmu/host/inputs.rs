//! Inputs that change over time.

use super::Instance;
use crate::{
    Error, Result,
    fmu::model_description::{Causality, ModelDescription, ScalarVariable, Variability},
};
use std::path::Path;

/// Values of input variables over time: linear between two rows for continuous variables, that of the row before for the
/// others, and the first and last row go on for ever.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Inputs {
    /// Names of the variables.
    pub names: Vec<String>,
    /// Times of the rows, ascending; two rows of the same time make a jump.
    pub times: Vec<f64>,
    /// A value for each name at each time.
    pub rows: Vec<Vec<f64>>,
}

impl Inputs {
    /// Reads a CSV file: a header with `time` and the names of inputs, then rows.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] with the line that is wrong.
    pub fn read_csv(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(Error::io(path, "read"))?;
        let wrong = |line: u64, message: String| Error::Table { path: path.to_owned(), line, message };
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_bytes());
        let header = reader.headers().map_err(|error| wrong(1, error.to_string()))?.clone();
        if header.get(0) != Some("time") || header.len() < 2 {
            return Err(wrong(1, "expected a header `time,NAME,...`".into()));
        }
        let names = header.iter().skip(1).map(str::to_owned).collect();
        let mut inputs = Self { names, ..Self::default() };
        for record in reader.records() {
            let record = record.map_err(|error| {
                wrong(
                    error.position().map_or(0, csv::Position::line),
                    "has another number of values than the header".into(),
                )
            })?;
            let line = record.position().map_or(0, csv::Position::line);
            let number = |field: &str| {
                let number = field.parse().ok().filter(|number: &f64| number.is_finite());
                number.ok_or_else(|| wrong(line, format!("`{field}` is no finite number")))
            };
            let values = record.iter().map(number).collect::<Result<Vec<f64>>>()?;
            if inputs.times.last().is_some_and(|last| *last > values[0]) {
                return Err(wrong(line, format!("time {} is before that of the row above", values[0])));
            }
            inputs.times.push(values[0]);
            inputs.rows.push(values[1..].to_vec());
        }
        if inputs.rows.is_empty() {
            return Err(wrong(1, "has no rows".into()));
        }
        Ok(inputs)
    }

    /// The variables that are set, in the order of the names.
    pub(super) fn variables<'a>(&self, description: &'a ModelDescription) -> Result<Vec<&'a ScalarVariable>> {
        let find = |name: &String| {
            let variable = description.variable(name).ok_or_else(|| Error::UnknownVariable {
                name: name.clone(),
                known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
            })?;
            if variable.causality != Causality::Input {
                let problem = "is no input; only inputs change over time".into();
                return Err(Error::Variable { name: name.clone(), problem });
            }
            Ok(variable)
        };
        self.names.iter().map(find).collect()
    }

    /// Sets the variables to their values at a time; just after it, if there is a jump.
    pub(super) fn set(&self, instance: &Instance, variables: &[&ScalarVariable], time: f64) -> Result<()> {
        for (column, variable) in variables.iter().enumerate() {
            let continuous = variable.variability == Variability::Continuous;
            instance.set_numbers(variable, &[self.value(column, time, continuous)])?;
        }
        Ok(())
    }

    fn value(&self, column: usize, time: f64, continuous: bool) -> f64 {
        let after = self.times.partition_point(|row| *row <= time);
        let before = after.saturating_sub(1);
        let from = self.rows[before][column];
        if !continuous || after == 0 || after == self.times.len() {
            return from;
        }
        let share = (time - self.times[before]) / (self.times[after] - self.times[before]);
        from + share * (self.rows[after][column] - from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Inputs> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Inputs::read_csv(file.path())
    }

    #[test]
    fn values_are_interpolated_held_and_jump() {
        let inputs = read("time, u ,v\n1,10,0\n2,20,1\n2,40,1\n3,50,0\n").unwrap();
        assert_eq!(inputs.names, ["u", "v"]);
        for (time, continuous, held) in [
            (0.0, 10.0, 10.0),
            (1.0, 10.0, 10.0),
            (1.5, 15.0, 10.0),
            (2.0, 40.0, 40.0),
            (2.5, 45.0, 40.0),
            (9.0, 50.0, 50.0),
        ] {
            assert_eq!(inputs.value(0, time, true), continuous, "{time}");
            assert_eq!(inputs.value(0, time, false), held, "{time}");
        }
    }

    #[test]
    fn what_is_wrong_with_a_file_is_located() {
        for (text, message) in [
            ("t,u\n0,1\n", ":1: expected a header `time,NAME,...`"),
            ("time,u\n", ":1: has no rows"),
            ("time,u\n0,1\n1,x\n", ":3: `x` is no finite number"),
            ("time,u\n0,1\n1\n", ":3: has another number of values than the header"),
            ("time,u\n0,inf\n", ":2: `inf` is no finite number"),
            ("time,u\n1,1\n0,1\n", ":3: time 0 is before that of the row above"),
        ] {
            let found = read(text).unwrap_err().to_string();
            assert!(found.ends_with(message), "{found}");
        }
    }
}
