//! Inputs that change over time.

use super::FmuInstance;
use crate::{
    Error, Result,
    diagnostics::names::expected_one_of,
    model_description::{Causality, ModelDescription, ScalarVariable, Variability},
    table::Table,
    variable::{DefaultValue, MatchedVariables, Need, VariableMatchError, WantedVariable, match_variables},
};
use serde::{Deserialize, Serialize};

/// Column of the times of rows.
const TIME: &str = "time";
/// Values of a table at most.
const MAX_VALUES: usize = 1 << 27;

/// Values of input variables over time. Continuous variables are linear between two rows; the others have the value of
/// the row before. The first and the last row extend without limit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Inputs {
    /// Names of the variables.
    pub names: Vec<String>,
    /// Times of the rows, ascending; two rows of the same time make a jump.
    pub times: Vec<f64>,
    /// A value for each name at each time.
    pub rows: Vec<Vec<f64>>,
}

impl Inputs {
    /// Reads a table: its column `time`, in s, and columns with the names of inputs.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::Table`] with the place of what is wrong.
    pub fn read(table: Table) -> Result<Self> {
        Self::read_with(table, |_, _| None)
    }

    /// Reads a table as [`Inputs::read`] does and checks the time of each row. `problem` receives the inputs of the
    /// rows before it and returns a message if the time is wrong.
    ///
    /// # Errors
    /// Those of [`Inputs::read`].
    pub fn read_with(mut table: Table, problem: impl Fn(&Self, f64) -> Option<String>) -> Result<Self> {
        let time = table.column(TIME)?;
        table.check_unit(time, Some("s"))?;
        let columns: Vec<usize> = (0..table.columns().len()).filter(|column| *column != time).collect();
        if columns.is_empty() {
            return Err(table.mistake_in_header("no column beside `time`, expected columns with the names of inputs"));
        }
        let names = columns.iter().map(|column| table.columns()[*column].name.clone()).collect();
        let mut inputs = Self { names, ..Self::default() };
        while table.next_row()? {
            let now = table.number(time)?;
            if let Some(last) = inputs.times.last().filter(|last| **last > now) {
                return Err(table.mistake(&format!("time {now} is before that of the row above, {last}")));
            }
            if let Some(problem) = problem(&inputs, now) {
                return Err(table.mistake(&problem));
            }
            if inputs.times.len() == MAX_VALUES / columns.len() {
                return Err(table.mistake(&format!("more than {MAX_VALUES} values, which are kept in memory")));
            }
            inputs.times.push(now);
            inputs.rows.push(columns.iter().map(|column| table.number(*column)).collect::<Result<_>>()?);
        }
        if inputs.rows.is_empty() {
            return Err(table.mistake("the table has no rows"));
        }
        Ok(inputs)
    }

    /// The inputs with the variables of a description that they set.
    ///
    /// # Errors
    /// [`Error::UnknownVariable`], [`Error::Variable`] if one is not an input.
    pub fn drive<'a>(&'a self, description: &'a ModelDescription) -> Result<InputDriver<'a>> {
        let variables = self.names.iter().map(|name| {
            let variable = description.variable(name).ok_or_else(|| Error::UnknownVariable {
                name: name.clone(),
                known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
            })?;
            if variable.causality != Causality::Input {
                let problem = "is not an input; only inputs change over time".into();
                return Err(Error::Variable { name: name.clone(), problem });
            }
            Ok(variable)
        });
        Ok(InputDriver { inputs: self, variables: variables.collect::<Result<_>>()? })
    }

    /// Matches the columns with the inputs of a description. Returns the values of inputs without a column, which
    /// `defaults` must ask for, and lines about them. Inputs for which `is_optional` is true may keep their start values.
    ///
    /// # Errors
    /// [`VariableMatchError`] with all inputs that lack a column, and all columns that are no inputs.
    pub fn complete<'a>(
        &'a self,
        description: &'a ModelDescription,
        is_optional: impl Fn(&str) -> bool,
        defaults: &[DefaultValue],
    ) -> std::result::Result<(Vec<(String, f64)>, MatchedVariables), VariableMatchError> {
        let inputs = description.variables.iter().filter(|variable| {
            let is_number = variable.kind.is_number() && variable.dimensions.is_empty();
            variable.causality == Causality::Input && is_number && !is_optional(&variable.name)
        });
        let wanted = inputs.map(|variable| WantedVariable {
            name: &variable.name,
            unit: description.unit_of(variable).unwrap_or_default(),
            start: variable.start_value(),
            need: Need::DataOrDefault,
        });
        let wanted: Vec<WantedVariable> = wanted.collect();
        // columns may have other names of a variable
        let columns = self.names.iter().map(|name| match description.variable(name) {
            Some(variable) => variable.name.as_str(),
            None => name,
        });
        let columns: Vec<&str> = columns.collect();
        let is_input =
            |name: &str| description.variable(name).is_some_and(|variable| variable.causality == Causality::Input);
        let other: Vec<&str> = columns.iter().copied().filter(|name| is_input(name)).collect();
        let matched = match_variables(&wanted, &columns, &other, defaults);
        let others = self.names.iter().filter(|name| !is_input(name)).map(|name| match description.variable(name) {
            Some(variable) if variable.causality == Causality::Parameter => format!(
                "column `{name}` is a parameter of the FMU, and only inputs change over time: --start {name}=VALUE sets it"
            ),
            Some(_) => format!("column `{name}` is not an input of the FMU; only inputs change over time"),
            None => {
                let known: Vec<&str> = wanted.iter().map(|variable| variable.name).collect();
                format!("column `{name}` is no variable of the FMU, {}", expected_one_of(name, &known))
            }
        });
        let missing = matched.as_ref().err().map_or(&[][..], |error| &error.problems);
        let problems: Vec<String> = missing.iter().cloned().chain(others).collect();
        match matched {
            Ok(matched) if problems.is_empty() => {
                let constant = wanted.iter().zip(&matched.columns).zip(&matched.values);
                let constant = constant.filter(|((_, column), _)| column.is_none());
                Ok((constant.map(|((variable, _), value)| (variable.name.to_owned(), *value)).collect(), matched))
            }
            _ => Err(VariableMatchError { problems }),
        }
    }

    fn rows_until(&self, time: f64) -> usize {
        self.times.partition_point(|row| *row <= time)
    }

    /// The value at a time that lies after `rows` rows.
    fn value(&self, column: usize, time: f64, rows: usize, continuous: bool) -> f64 {
        let before = rows.saturating_sub(1);
        let from = self.rows[before][column];
        if !continuous || rows == 0 || rows == self.times.len() {
            return from;
        }
        let share = (time - self.times[before]) / (self.times[rows] - self.times[before]);
        from + share * (self.rows[rows][column] - from)
    }
}

/// Inputs and the variables they set.
#[derive(Debug)]
pub struct InputDriver<'a> {
    inputs: &'a Inputs,
    variables: Vec<&'a ScalarVariable>,
}

/// Sets nothing.
pub static NO_INPUTS: InputDriver = InputDriver {
    inputs: {
        static NONE: Inputs = Inputs { names: Vec::new(), times: Vec::new(), rows: Vec::new() };
        &NONE
    },
    variables: Vec::new(),
};

impl InputDriver<'_> {
    /// How many rows there are up to a time.
    pub fn rows_until(&self, time: f64) -> usize {
        self.inputs.rows_until(time)
    }

    /// Time of the first row after `rows` rows.
    pub fn next_row(&self, rows: usize) -> Option<f64> {
        self.inputs.times.get(rows).copied()
    }

    /// Sets all variables to their values at a time after `rows` rows.
    pub fn set(&self, instance: &FmuInstance, time: f64, rows: usize) -> Result<()> {
        self.set_some(instance, time, rows, |_| true)
    }

    /// Sets all variables to their values at a time, after all rows up to it.
    pub(super) fn set_at(&self, instance: &FmuInstance, time: f64) -> Result<()> {
        self.set(instance, time, self.rows_until(time))
    }

    /// Sets the continuous variables, the only ones that may be set between events.
    pub fn set_continuous(&self, instance: &FmuInstance, time: f64, rows: usize) -> Result<()> {
        self.set_some(instance, time, rows, is_continuous)
    }

    fn set_some(
        &self,
        instance: &FmuInstance,
        time: f64,
        rows: usize,
        which: impl Fn(&ScalarVariable) -> bool,
    ) -> Result<()> {
        for (column, variable) in self.variables.iter().enumerate().filter(|(_, variable)| which(variable)) {
            instance.set_numbers(variable, &[self.inputs.value(column, time, rows, is_continuous(variable))])?;
        }
        Ok(())
    }

    /// Returns true if a continuous variable changes from the last of `rows` rows to the next.
    pub fn vary(&self, rows: usize) -> bool {
        let of = &self.inputs.rows;
        (1..of.len()).contains(&rows)
            && self
                .variables
                .iter()
                .enumerate()
                .any(|(column, variable)| is_continuous(variable) && of[rows - 1][column] != of[rows][column])
    }

    /// Returns true if a variable jumps at the rows from `before` up to `after`, which have one time.
    pub fn jump(&self, before: usize, after: usize) -> bool {
        let of = &self.inputs.rows;
        self.variables.iter().enumerate().any(|(column, variable)| {
            let last = if is_continuous(variable) { before } else { before.saturating_sub(1) };
            of[last][column] != of[after - 1][column]
        })
    }
}

fn is_continuous(variable: &ScalarVariable) -> bool {
    variable.variability == Variability::Continuous
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Inputs> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Table::open(file.path()).and_then(Inputs::read)
    }

    /// A parameter `length` and an input `speed`.
    fn description() -> ModelDescription {
        let text = r#"<fmiModelDescription fmiVersion="2.0" modelName="belt" guid="{1}">
            <CoSimulation modelIdentifier="belt"/>
            <ModelVariables>
                <ScalarVariable name="length" valueReference="1" causality="parameter" variability="fixed"><Real start="1"/></ScalarVariable>
                <ScalarVariable name="speed" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
            </ModelVariables>
            <ModelStructure/>
        </fmiModelDescription>"#;
        crate::xml::read(text.as_bytes()).unwrap().description
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
            assert_eq!(inputs.value(0, time, inputs.rows_until(time), true), continuous, "{time}");
            assert_eq!(inputs.value(0, time, inputs.rows_until(time), false), held, "{time}");
        }
    }

    #[test]
    fn a_table_is_read_as_other_tables_are() {
        let inputs = read("# a drive\nspeed [m/s];time [s]\n1,5;0\n2,5;0,1\n").unwrap();
        assert_eq!((inputs.names, inputs.times), (vec!["speed".to_owned()], vec![0.0, 0.1]));
        assert_eq!(inputs.rows, [[1.5], [2.5]]);
    }

    #[test]
    fn a_jump_of_a_continuous_variable_needs_two_rows_and_one_of_a_discrete_one_a_change() {
        let inputs = read("time,u\n1,10\n2,20\n2,40\n3,40\n4,50\n").unwrap();
        let description = description();
        for (variability, jumps, varies) in [
            (Variability::Continuous, [false, true, false, false], [false, true, false, true, false]),
            (Variability::Discrete, [false, true, false, true], [false; 5]),
        ] {
            let mut variable = description.variable("speed").unwrap().clone();
            variable.variability = variability;
            let driver = InputDriver { inputs: &inputs, variables: vec![&variable] };
            let found = [(0, 1), (1, 3), (3, 4), (4, 5)].map(|(before, after)| driver.jump(before, after));
            assert_eq!(found, jumps);
            assert_eq!([0, 1, 3, 4, 5].map(|rows| driver.vary(rows)), varies);
        }
    }

    #[test]
    fn every_input_has_a_column_or_a_value_and_every_column_is_an_input() {
        let mut description = description();
        let speed = description.variable("speed").unwrap().clone();
        description.variables.push(ScalarVariable { name: "brake".into(), ..speed });
        let complete = |text: &str, defaults: &[&str]| {
            let defaults: Vec<DefaultValue> = defaults.iter().map(|text| DefaultValue::parse(text).unwrap()).collect();
            let inputs = read(text).unwrap();
            inputs.complete(&description, |_| false, &defaults).map(|(constants, _)| constants)
        };
        assert_eq!(complete("time,brake,speed\n0,1,2\n", &[]), Ok(Vec::new()));
        assert_eq!(complete("time,speed\n0,1\n", &["brake=0.25"]), Ok(vec![("brake".into(), 0.25)]));
        let unmatched = complete("time,Speed,length\n0,1,2\n", &[]).unwrap_err();
        assert_eq!(unmatched.problems.len(), 3);
        let message = unmatched.to_string();
        for says in [
            "no columns `speed`, `brake`, expected them among Speed, length; did you mean `Speed` for `speed`?",
            "column `Speed` is no variable of the FMU, expected one of speed, brake; did you mean `speed`?",
            "column `length` is a parameter of the FMU",
        ] {
            assert!(message.contains(says), "{message}");
        }
        let message = complete("time,speed\n0,1\n", &["Brake"]).unwrap_err().to_string();
        assert!(message.contains("--default Brake: no such variable"), "{message}");
    }

    #[test]
    fn what_is_wrong_with_a_file_is_located() {
        for (text, message) in [
            ("t,u\n0,1\n", ":1: no column `time`, expected it among t, u"),
            ("time\n0\n", ":1: no column beside `time`, expected columns with the names of inputs"),
            ("time [ms],u\n0,1\n", ":1: column `time`: unit `ms`, expected `s`"),
            ("time,u,v,u\n0,1,2,3\n", ":1: column `u` is duplicated"),
            ("time,u\n", ":1: the table has no rows"),
            ("time,u\n0,1\n1,x\n", ":3: column `u`: `x`, expected a finite number"),
            ("time,u\n0,1\n1\n", ":3: 1 field, expected 2"),
            ("time,u\n0,inf\n", ":2: column `u`: `inf`, expected a finite number"),
            ("time,u\n1,1\n0,1\n", ":3: time 0 is before that of the row above, 1"),
        ] {
            let found = read(text).unwrap_err().to_string();
            assert!(found.ends_with(message), "{found}");
        }
    }
}
