//! Rows of a table without a time: inputs and outputs of a static map (`source.table`, structure "static").
//!
//! `source.columns` gives the names that columns have in the table, where they are not the study's. Rows that repeat others are dropped:
//! a row that judges a model must not be one that it was fitted to.

use super::recorded::{column_problems, resolve};
use crate::{
    Error, Result,
    dataset::Dataset,
    diagnostics::{Place, Problems},
    scaling,
    study::Study,
    table::{Table, TableColumn},
    variable::SourceVariable,
};
use metafmu_runtime::Rows;
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};

/// A table of rows, its columns resolved.
#[derive(Clone, Debug)]
pub struct StaticRows {
    path: PathBuf,
    inputs: Vec<SourceVariable>,
    outputs: Vec<SourceVariable>,
    /// Positions of the inputs, then of the outputs.
    positions: Vec<usize>,
}

/// Rows that were read.
#[derive(Clone, Debug, Default)]
pub struct ReadRows {
    /// Inputs of each row.
    pub inputs: Rows,
    /// Outputs of each row.
    pub outputs: Rows,
    /// Line of each row, or in Parquet its number.
    pub places: Vec<u64>,
    /// Notes on dropped rows and on odd ones.
    pub notes: Vec<String>,
}

/// Rows of a design: some of them may have no outputs yet.
#[derive(Clone, Debug)]
pub struct DesignRows {
    /// All columns of the table.
    pub columns: Vec<TableColumn>,
    /// Position of each input among the columns.
    pub positions: Vec<usize>,
    /// Inputs of each row.
    pub points: Rows,
    /// Outputs of each row; None if these cells are empty.
    pub outputs: Vec<Option<Vec<f64>>>,
}

impl DesignRows {
    /// No rows of a table that does not exist yet: its columns are the inputs and outputs of the study.
    pub fn of_study(study: &Study) -> Self {
        let inputs = study.inputs.iter().map(|(name, of)| (name, &of.unit));
        let outputs = study.outputs.iter().map(|(name, of)| (name, &of.unit));
        let columns = inputs.chain(outputs).map(|(name, unit)| {
            let title = study.source.columns.get(name).unwrap_or(name);
            TableColumn { name: title.clone(), unit: unit.clone() }
        });
        Self {
            columns: columns.collect(),
            positions: (0..study.inputs.len()).collect(),
            points: Rows::default(),
            outputs: Vec::new(),
        }
    }
}

/// Cells that a message names at most.
const SHOWN: usize = 20;
/// Fewest rows: one judges a model of the other.
const FEWEST: usize = 2;

impl StaticRows {
    /// Finds the study's inputs and outputs in the header of its table.
    ///
    /// # Errors
    /// [`Error::Study`] with every column that does not exist or has another unit, [`Error::Table`], [`Error::Io`].
    pub fn new(study: &Study) -> Result<Self> {
        study.refuse(column_problems(study, &[]))?;
        let path = study.beside(study.source.table.as_deref().unwrap_or(Path::new("")));
        let table = Table::open(&path)?;
        let (mut positions, mut problems) = (Vec::new(), Problems::default());
        let mut found = |section: &str, name: &str, unit: &Option<String>, text: &Option<String>| {
            let column = study.source.columns.get(name).map_or(name, String::as_str);
            match resolve(&table, column, name, unit.as_deref(), text.as_deref()) {
                Ok(variable) => {
                    positions.extend(table.column(column));
                    Some(variable)
                }
                Err(error) => {
                    problems.add(format!("{section}.{name}"), error.to_string());
                    None
                }
            }
        };
        let inputs = study.inputs.iter().filter_map(|(name, of)| found("inputs", name, &of.unit, &of.description));
        let inputs = inputs.collect();
        let outputs = study.outputs.iter().filter_map(|(name, of)| found("outputs", name, &of.unit, &of.description));
        let outputs = outputs.collect();
        study.refuse(problems)?;
        Ok(Self { path, inputs, outputs, positions })
    }

    /// The inputs, in the study's order.
    pub fn inputs(&self) -> &[SourceVariable] {
        &self.inputs
    }

    /// The outputs, in the study's order.
    pub fn outputs(&self) -> &[SourceVariable] {
        &self.outputs
    }

    /// Reads all rows.
    ///
    /// # Errors
    /// [`Error::Rows`] with every cell that is not a finite number. [`Error::Study`] with inputs that do not vary,
    /// bounds of too few rows and numbers that are too large. [`Error::Table`], [`Error::Io`], [`Error::Interrupted`]
    /// when `stop` turns true.
    pub fn read(&self, study: &Study, stop: &AtomicBool) -> Result<ReadRows> {
        let mut table = Table::open(&self.path)?;
        let mut read = ReadRows::default();
        let mut wrong = WrongCells::default();
        let (mut known, mut points) = (HashMap::new(), HashSet::new());
        let (mut repeated, mut again) = (0, 0);
        while table.next_row()? {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            let mut values = Vec::with_capacity(self.positions.len());
            for position in &self.positions {
                match table.number(*position) {
                    Ok(value) => values.push(value),
                    Err(Error::Table { place, message, .. }) => wrong.add(place, message),
                    Err(error) => return Err(error),
                }
            }
            if values.len() < self.positions.len() {
                continue;
            }
            let place = table.place();
            if known.insert(bits(&values), place).is_some() {
                repeated += 1;
                continue;
            }
            let outputs = values.split_off(self.inputs.len());
            again += usize::from(!points.insert(bits(&values)));
            read.inputs.push(&values);
            read.outputs.push(&outputs);
            read.places.push(match place {
                Place::Line(number) | Place::Row(number) => number,
                Place::Whole => 0,
            });
        }
        wrong.refuse(&self.path)?;
        let rows = read.inputs.len();
        if rows < FEWEST {
            let all = if repeated > 0 { format!(" of {} that differ", rows + repeated) } else { String::new() };
            let expected = format!("expected at least {FEWEST}: add rows to the table");
            return Err(table.mistake(&format!("{rows} row{}{all}, {expected}", if rows == 1 { "" } else { "s" })));
        }
        self.check(study, &read)?;
        if repeated > 0 {
            read.notes.push(format!("{repeated} of {} rows repeat other rows and are left out", rows + repeated));
        }
        if again > 0 {
            let what = "have the inputs of other rows and other outputs: the model is between them";
            read.notes.push(format!("{again} of {rows} rows {what}"));
        }
        Ok(read)
    }

    /// Reads the rows of a design, those without outputs too.
    ///
    /// # Errors
    /// [`Error::Rows`] with every other cell that is not a finite number, [`Error::Table`], [`Error::Io`],
    /// [`Error::Interrupted`] when `stop` turns true.
    pub fn design(&self, stop: &AtomicBool) -> Result<DesignRows> {
        let mut table = Table::open(&self.path)?;
        let (inputs, outputs) = self.positions.split_at(self.inputs.len());
        let columns = table.columns().to_vec();
        let mut rows = DesignRows { columns, positions: inputs.to_vec(), points: Rows::default(), outputs: Vec::new() };
        let mut wrong = WrongCells::default();
        while table.next_row()? {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            let mut is_planned = true;
            for position in outputs {
                is_planned &= table.text(*position)?.is_empty();
            }
            rows.points.push(&wrong.numbers(&mut table, inputs)?);
            rows.outputs.push(if is_planned { None } else { Some(wrong.numbers(&mut table, outputs)?) });
        }
        wrong.refuse(&self.path)?;
        Ok(rows)
    }

    /// Checks that the study can be learned from the rows.
    fn check(&self, study: &Study, read: &ReadRows) -> Result<()> {
        let mut problems = Problems::default();
        for (column, variable) in self.inputs.iter().enumerate() {
            let first = read.inputs[0][column];
            if read.inputs.iter().all(|row| row[column] == first) {
                let expected = "expected an input that varies: leave it out";
                problems.add(format!("inputs.{}", variable.name), format!("is {first} in all rows, {expected}"));
            }
        }
        let of = |variables: &[SourceVariable], labels| {
            scaling::problems(&Dataset::of_rows(&[], variables, &Rows::zeros(0, read.inputs.len()), labels))
        };
        problems.extend(of(&self.outputs, &read.outputs));
        let of_inputs = of(&self.inputs, &read.inputs);
        problems.extend(of_inputs.into_iter().map(|mut problem| {
            problem.key = problem.key.replacen("outputs.", "inputs.", 1);
            problem
        }));
        study.refuse(problems)
    }
}

/// Bits of numbers; both zeros have the same.
fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| (value + 0.0).to_bits()).collect()
}

/// Cells that are not finite numbers.
#[derive(Default)]
struct WrongCells {
    problems: Vec<(Place, String)>,
    others: usize,
}

impl WrongCells {
    /// Numbers of a row; a cell without a finite number is NaN, and noted.
    fn numbers(&mut self, table: &mut Table, positions: &[usize]) -> Result<Vec<f64>> {
        let mut values = Vec::with_capacity(positions.len());
        for position in positions {
            match table.number(*position) {
                Ok(value) => values.push(value),
                Err(Error::Table { place, message, .. }) => {
                    self.add(place, message);
                    // all rows have the same width; the table is refused anyway
                    values.push(f64::NAN);
                }
                Err(error) => return Err(error),
            }
        }
        Ok(values)
    }

    fn add(&mut self, place: Place, message: String) {
        if self.problems.len() < SHOWN { self.problems.push((place, message)) } else { self.others += 1 }
    }

    fn refuse(mut self, path: &Path) -> Result<()> {
        let Some((_, last)) = self.problems.last_mut() else { return Ok(()) };
        if self.others > 0 {
            last.push_str(&format!("; and {} further cells", self.others));
        }
        last.push_str("; leave out the rows that have no values");
        Err(Error::Rows { path: path.to_owned(), problems: self.problems })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of a table with the columns `a`, `b` and `y`, or the error that refuses them.
    fn read(rows: &str) -> Result<ReadRows> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("t.csv"), format!("a,b,y\n{rows}")).unwrap();
        let text = "name = 's'\nstructure = 'static'\nsource = { table = 't.csv' }\n[inputs]\na = {}\nb = {}\n[outputs]\ny = {}\n";
        let study = Study::parse(text, &folder.path().join("s.toml"))?;
        StaticRows::new(&study)?.read(&study, &AtomicBool::new(false))
    }

    #[test]
    fn rows_that_repeat_others_are_dropped_and_those_with_other_outputs_are_not() {
        let ReadRows { inputs, outputs, places, notes } = read("1,2,3\n0,2.5,4\n1,2,3\n-0.0,2.5,4\n1,2,5\n").unwrap();
        assert_eq!(inputs, Rows::from_iter([[1.0, 2.0], [0.0, 2.5], [1.0, 2.0]]));
        assert_eq!((outputs, places), (Rows::from_iter([[3.0], [4.0], [5.0]]), vec![2, 3, 6]));
        assert!(notes[0].starts_with("2 of 5 rows repeat other rows"), "{notes:?}");
        assert!(notes[1].starts_with("1 of 3 rows have the inputs of other rows"), "{notes:?}");
    }

    #[test]
    fn all_cells_that_are_no_numbers_are_named_with_their_lines() {
        let message = read("1,2,3\n,2,x\n3,NaN,5\n").unwrap_err().to_string();
        let lines: Vec<&str> = message.lines().map(|line| &line[line.find("t.csv").unwrap()..]).collect();
        assert_eq!(
            lines,
            [
                "t.csv:3: column `a`: is empty, expected a finite number",
                "t.csv:3: column `y`: `x`, expected a finite number",
                "t.csv:4: column `b`: `NaN`, expected a finite number; leave out the rows that have no values",
            ]
        );
        let message = read(&"x,1,2\n".repeat(30)).unwrap_err().to_string();
        assert_eq!(message.lines().count(), SHOWN, "{message}");
        assert!(message.contains("; and 10 further cells"), "{message}");
    }

    #[test]
    fn inputs_that_do_not_vary_and_too_few_rows_are_refused() {
        let message = read("1,2,3\n1,2,4\n").unwrap_err().to_string();
        for column in ["inputs.a: is 1 in all rows", "inputs.b: is 2 in all rows"] {
            assert!(message.contains(column), "{message}");
        }
        for (rows, says) in [("", "0 rows"), ("1,2,3\n", "1 row,"), ("1,2,3\n1,2,3\n", "1 row of 2 that differ")] {
            let message = read(rows).unwrap_err().to_string();
            assert!(message.contains(says) && message.contains("expected at least 2"), "{message}");
        }
        let message = read("1,2,3\n2,3,1e200\n").unwrap_err().to_string();
        assert!(message.contains("outputs.y: from 3e0 to 1e200"), "{message}");
    }
}
