//! Runs that were simulated elsewhere and recorded in tables.
//!
//! Either one table of all runs (`source.table`), a row for each time of each run: `run,time,<parameters>,<outputs>`. A new
//! label in the column `run` begins a new run; without that column other parameters do. Or an index (`source.index`) with a
//! row for each run, `file,<parameters>`, and a file `time,<outputs>` for each run. `source.columns` gives the names that
//! columns have there, where they are not the study's. How tables are written: see [`crate::table`].
//!
//! Every run must begin at time zero and reach the study's `time.stop`; later rows are dropped.
//!
//! Tables of a study with states have columns of coordinates, of their rates and of inputs (module `motions`). With the
//! structure "discrete", rows also have inputs, `run,time,<parameters>,<inputs>,<outputs>`, and are `time.step` apart.
//! The parameters of such a run are those of the study and, after them, the outputs of its first row and the start
//! values of its inputs. Rows before time zero are the past of the run. A table of a single run is cut into runs that
//! follow each other, each with the samples before it.

mod motions;
mod outliers;
mod runs;
mod sets;

use crate::{
    Error, Result,
    dataset::{Dataset, Run},
    diagnostics::{KeyProblem, Problems, names::did_you_mean},
    dynamics::trajectory::Trajectory,
    sampling::Sets,
    study::{InputOptions, ParameterOptions, Study, read_value},
    table::{Table, runs::check_constants},
    variable::SourceVariable,
};
pub use motions::Motions;
use runs::Runs;
use std::{
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};

/// Recorded runs, their columns resolved.
#[derive(Clone, Debug)]
pub struct Recorded {
    path: PathBuf,
    is_index: bool,
    names: ColumnNames,
    /// Parameters. For runs with inputs they include the values of outputs and inputs before the start.
    parameters: Vec<SourceVariable>,
    inputs: Vec<RecordedInput>,
    input_variables: Vec<SourceVariable>,
    outputs: Vec<SourceVariable>,
    /// Each parameter's range or values in the study.
    options: Vec<ParameterOptions>,
    stop: f64,
    step: f64,
    /// Time between two rows, and number of rows before the start, which a run has all of or none; for runs with
    /// inputs.
    samples: Option<(f64, usize)>,
    test_runs: usize,
    /// Separate table of the test runs, or their index, if there is one.
    test: Option<PathBuf>,
    calibration_runs: usize,
    seed: u64,
    /// `true` if outliers are behavior of the component.
    keeps_outliers: bool,
    /// `true` if its rows must be equally spaced in time, and runs may have the same parameters.
    is_motion: bool,
    motions: Option<Box<Motions>>,
}

/// An input of recorded runs.
#[derive(Clone, Copy, Debug)]
struct RecordedInput {
    min: f64,
    max: f64,
    /// Its value before the start.
    start: f64,
}

/// Names of the columns in the tables.
#[derive(Clone, Debug)]
struct ColumnNames {
    run: String,
    time: String,
    file: String,
    parameters: Vec<String>,
    inputs: Vec<String>,
    outputs: Vec<String>,
}

/// Content of a table of recorded runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TableKind {
    /// All runs, with their parameters.
    Whole,
    /// The parameters and the file of each run.
    Index,
    /// One run, without its parameters.
    Run,
}

/// Positions of the columns of runs; those that a table of its kind does not have are empty or 0.
struct RunColumns {
    parameters: Vec<usize>,
    time: usize,
    /// Inputs, then outputs.
    values: Vec<usize>,
}

impl ColumnNames {
    /// Finds the columns in a table.
    ///
    /// # Errors
    /// [`Error::Table`] with all that are missing.
    fn find_in(&self, table: &Table, kind: TableKind) -> Result<RunColumns> {
        let (of_point, of_rows) = (kind != TableKind::Run, kind != TableKind::Index);
        let parameters = self.parameters.iter().filter(|_| of_point);
        let rows = std::iter::once(&self.time).chain(&self.inputs).chain(&self.outputs).filter(|_| of_rows);
        let file = (kind == TableKind::Index).then_some(&self.file);
        let mut parameters = table.columns_of(&parameters.chain(rows).chain(file).collect::<Vec<_>>())?;
        let mut values = parameters.split_off(if of_point { self.parameters.len() } else { 0 });
        Ok(RunColumns { parameters, time: if of_rows { values.remove(0) } else { 0 }, values })
    }
}

impl Recorded {
    /// Finds the study's parameters and outputs in the header of its table, or of its index and the first file there.
    ///
    /// # Errors
    /// [`Error::Study`] with names in `source.columns` that the study does not have, [`Error::Table`] or [`Error::Io`]
    /// if a table lacks a required part.
    pub fn new(study: &Study) -> Result<Self> {
        study.refuse(column_problems(study, &["run", "time", "file"]))?;
        let columns = &study.source.columns;
        let there = |name: &str| columns.get(name).map_or(name, String::as_str).to_owned();
        let (table, index) = (&study.source.table, &study.source.index);
        let path = study.beside(table.as_ref().or(index.as_ref()).map_or(Path::new(""), |file| file));
        // motions have other columns for what drives them
        let driven = study.inputs.iter().filter(|_| study.runs().are_samples);
        let mut recorded = Self {
            path,
            is_index: index.is_some(),
            names: ColumnNames {
                run: there("run"),
                time: there("time"),
                file: there("file"),
                parameters: study.parameters.keys().map(|name| there(name)).collect(),
                inputs: driven.clone().map(|(name, _)| there(name)).collect(),
                outputs: study.outputs.keys().map(|name| there(name)).collect(),
            },
            parameters: Vec::new(),
            inputs: driven.map(|(_, input)| RecordedInput::of(input)).collect(),
            input_variables: Vec::new(),
            outputs: Vec::new(),
            options: study.parameters.values().cloned().collect(),
            stop: study.time.stop,
            step: study.time.step,
            samples: study.runs().are_samples.then(|| (study.time.step, study.discrete.longest())),
            test_runs: if study.sampling.test.is_some() { 0 } else { study.sampling.test_runs },
            test: study.sampling.test.as_ref().map(|file| study.beside(file)),
            calibration_runs: study.calibration_runs(),
            seed: study.seed,
            keeps_outliers: study.source.outliers || !study.runs().are_samples,
            is_motion: false,
            motions: None,
        };
        let mut table = Table::open(&recorded.path)?;
        // without states, or of an index, which is said elsewhere, there is nothing to read
        let is_motion = study.runs().start_from_states && !study.states.is_empty() && !recorded.is_index;
        match recorded.is_index {
            _ if is_motion => recorded.names.find_motions(study, &table)?,
            true => drop(recorded.names.find_in(&table, TableKind::Index)?),
            false => drop(recorded.names.find_in(&table, TableKind::Whole)?),
        }
        for ((name, options), column) in study.parameters.iter().zip(&recorded.names.parameters) {
            let (unit, text) = (options.unit.as_deref(), options.description.as_deref());
            recorded.parameters.push(resolve(&table, column, name, unit, text)?);
        }
        if is_motion {
            return recorded.with_motions(study);
        }
        if recorded.is_index {
            table = match table.next_row()? {
                true => recorded.open_run(&mut table)?,
                false => return Err(table.mistake("the index has no rows")),
            };
            recorded.names.find_in(&table, TableKind::Run)?;
        }
        for ((name, options), column) in study.outputs.iter().zip(&recorded.names.outputs) {
            let (unit, text) = (options.unit.as_deref(), options.description.as_deref());
            recorded.outputs.push(resolve(&table, column, name, unit, text)?);
        }
        for ((name, options), column) in study.inputs.iter().zip(&recorded.names.inputs) {
            let (unit, text) = (options.unit.as_deref(), options.description.as_deref());
            recorded.input_variables.push(resolve(&table, column, name, unit, text)?);
        }
        recorded.add_starts();
        Ok(recorded)
    }

    /// Adds the values of outputs and inputs before the start to the parameters of runs with inputs.
    fn add_starts(&mut self) {
        if self.inputs.is_empty() {
            return;
        }
        self.parameters.extend(super::before_start(self.outputs.iter().chain(&self.input_variables)));
    }

    /// The value of each input before the start, and its range in the study.
    pub(super) fn drives(&self) -> Vec<(f64, [f64; 2])> {
        self.inputs.iter().map(|input| (input.start, [input.min, input.max])).collect()
    }

    /// The parameters, in the study's order; of runs with inputs, what outputs and inputs were before the start.
    pub fn parameters(&self) -> &[SourceVariable] {
        &self.parameters
    }

    /// The outputs, in the study's order.
    pub fn outputs(&self) -> &[SourceVariable] {
        &self.outputs
    }

    /// The motions, of a study with states.
    pub fn motions(&self) -> Option<&Motions> {
        self.motions.as_deref()
    }

    /// Inputs that drive the runs.
    pub fn inputs(&self) -> &[SourceVariable] {
        self.motions().map_or(&self.input_variables, Motions::inputs)
    }

    /// The motions from which equations are learned: the training runs, or the first part of every run.
    pub fn learned(&self) -> Vec<Trajectory> {
        self.motions().map_or(Vec::new(), Motions::learned)
    }

    /// Reads all runs and chooses those for the tests and for error bounds at random; each set is in the table's order.
    ///
    /// # Errors
    /// [`Error::Table`] with file and line of the mistake, [`Error::Io`], [`Error::Interrupted`] when `stop` turns true.
    pub fn sample(&self, stop: &AtomicBool) -> Result<Sets<Dataset>> {
        self.read(stop).map(|(sets, _)| sets)
    }

    /// [`Recorded::sample`], and a notice about runs that do not begin at rest.
    ///
    /// # Errors
    /// As [`Recorded::sample`].
    pub fn read(&self, stop: &AtomicBool) -> Result<(Sets<Dataset>, Option<String>)> {
        if let Some(motions) = &self.motions {
            return motions.sets(self).map(|sets| (sets, None));
        }
        let mut runs = Runs::new(self, stop);
        let table = self.read_table(&self.path, &mut runs)?;
        runs.refuse_outliers()?;
        let is_record = runs.finished.len() == 1 && self.samples.is_some();
        let odd = runs.cut();
        let chosen = self.choose(runs.finished.len(), is_record);
        let chosen = chosen.map_err(|error| table.mistake(&error.to_string()))?;
        let tests = self.test.as_ref().map(|path| {
            let mut tests = runs.followed();
            let table = self.read_table(path, &mut tests)?;
            tests.refuse_outliers()?;
            tests.cut();
            if tests.finished.is_empty() { Err(table.mistake("no test runs")) } else { Ok(tests.finished) }
        });
        let mut runs: Vec<Option<Run>> = runs.finished.into_iter().map(Some).collect();
        let mut sets = chosen
            .try_map(|chosen| Ok(self.dataset(chosen.into_iter().filter_map(|run| runs[run].take()).collect())))?;
        if let Some(tests) = tests.transpose()? {
            sets.test = self.dataset(tests);
        }
        Ok((sets, odd))
    }

    fn dataset(&self, runs: Vec<Run>) -> Dataset {
        let (parameters, inputs) = (self.parameters.clone(), self.input_variables.clone());
        Dataset { inputs, parameters, outputs: self.outputs.clone(), runs }
    }

    /// Reads a table, or an index and its files.
    fn read_table(&self, path: &Path, runs: &mut Runs) -> Result<Table<'static>> {
        let mut table = Table::open(path)?;
        match self.is_index {
            true => self.read_index(&mut table, runs)?,
            false => self.read_long(&mut table, runs)?,
        }
        Ok(table)
    }

    fn read_long(&self, table: &mut Table, runs: &mut Runs) -> Result<()> {
        let RunColumns { parameters, time, values } = self.names.find_in(table, TableKind::Whole)?;
        table.check_unit(time, Some("s"))?;
        let label = table.optional_column(&self.names.run, &[parameters.as_slice(), &values].concat())?;
        while table.next_row()? {
            let point = self.point(table, &parameters)?;
            let name = match label {
                Some(label) => table.text(label)?.into_owned(),
                None => String::new(),
            };
            if name.is_empty() && label.is_some() {
                return Err(table.mistake(&format!("column `{}`: is empty, expected the run's label", self.names.run)));
            }
            let current = runs.current.as_ref().filter(|current| match label {
                Some(_) => current.label == name,
                None => current.parameters == point,
            });
            match current {
                Some(current) => {
                    let names = self.names.parameters.iter().map(String::as_str);
                    check_constants(table, names, &point, &current.parameters)?;
                }
                None => {
                    runs.finish(table)?;
                    runs.begin(table, name, point)?;
                }
            }
            runs.row(table, time, &values)?;
        }
        runs.finish(table)
    }

    fn read_index(&self, index: &mut Table, runs: &mut Runs) -> Result<()> {
        let RunColumns { parameters, .. } = self.names.find_in(index, TableKind::Index)?;
        let file = index.column(&self.names.file)?;
        while index.next_row()? {
            let point = self.point(index, &parameters)?;
            let name = index.text(file)?.into_owned();
            runs.begin(index, name, point)?;
            let mut table = self.open_run(index)?;
            let RunColumns { time, values, .. } = self.names.find_in(&table, TableKind::Run)?;
            let units = self.input_variables.iter().chain(&self.outputs).map(|variable| Some(variable.unit.as_str()));
            table.check_units(std::iter::once((time, Some("s"))).chain(values.iter().copied().zip(units)))?;
            while table.next_row()? {
                runs.row(&mut table, time, &values)?;
            }
            runs.finish(&table)?;
        }
        Ok(())
    }

    /// Opens the file that a row of the index names.
    fn open_run(&self, index: &mut Table) -> Result<Table<'static>> {
        let name = index.text(index.column(&self.names.file)?)?.into_owned();
        Table::open(&index.path().with_file_name(&name)).map_err(|error| match error {
            Error::Io { source, .. } => index.mistake(&format!("`{name}` cannot be read: {source}")),
            error => error,
        })
    }

    fn point(&self, table: &mut Table, columns: &[usize]) -> Result<Vec<f64>> {
        let columns = columns.iter().zip(&self.options);
        columns.map(|(&column, options)| read_value(table, column, options)).collect()
    }
}

impl RecordedInput {
    fn of(options: &InputOptions) -> Self {
        let (min, max) = (options.min.unwrap_or(f64::NEG_INFINITY), options.max.unwrap_or(f64::INFINITY));
        Self { min, max, start: options.start.unwrap_or(0.0f64.max(min).min(max)) }
    }
}

/// A variable of the study in a column of a table; the study's unit must be the table's. Advice on a missing value
/// among samples, in addition to its error.
pub fn at_gap(error: Error) -> Error {
    let advice = "divide the record at the gap into runs, numbered in a column `run`, each with times from 0";
    match error {
        Error::Table { path, place, message } => Error::Table { path, place, message: format!("{message}; {advice}") },
        other => other,
    }
}

/// Names in `source.columns` that are no variables of the study nor its `own` columns, and columns that have two names.
pub(super) fn column_problems(study: &Study, own: &[&str]) -> Problems {
    let columns = &study.source.columns;
    let rates = study.states.values().filter_map(|state| state.rate.as_ref());
    let states: Vec<&String> = study.states.keys().chain(rates).chain(study.inputs.keys()).collect();
    let known =
        || study.parameters.keys().chain(study.outputs.keys()).chain(states.iter().copied()).map(String::as_str);
    let neither = match own {
        [] => "neither an input nor an output",
        _ => "neither a parameter nor an output, nor `run`, `time` or `file`",
    };
    let unknown = columns.keys().filter(|name| !own.contains(&name.as_str()) && !known().any(|known| known == *name));
    let unknown = unknown.map(|name| {
        let suggestion = did_you_mean(name, known().chain(own.iter().copied()));
        let message = format!("`{name}` is {neither}{suggestion}");
        KeyProblem { key: format!("source.columns.{name}"), message }
    });
    let shared = columns.iter().filter_map(|(name, column)| {
        let time = own.iter().copied().filter(|own| *own == "time");
        let mut others = known().chain(time).filter(|other| other != name);
        let other = others.find(|other| columns.get(*other).map_or(*other, String::as_str) == column.as_str())?;
        let message = format!("column `{column}` is that of `{other}` already");
        Some(KeyProblem { key: format!("source.columns.{name}"), message })
    });
    unknown.chain(shared).collect()
}

/// A variable of the study in a column.
pub(super) fn resolve(
    table: &Table,
    column: &str,
    name: &str,
    unit: Option<&str>,
    description: Option<&str>,
) -> Result<SourceVariable> {
    let position = table.column(column)?;
    table.check_unit(position, unit)?;
    let unit = unit.or(table.columns()[position].unit()).unwrap_or_default();
    Ok(SourceVariable::new(name, unit, description.unwrap_or_default()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{dataset::Run, source::Source};

    /// A folder with a study of a table, and tables.
    struct TableFolder(tempfile::TempDir);

    const STUDY: &str = "name = \"s\"
[source]
SOURCE
[time]
stop = 1
step = 0.5
[parameters]
a = { min = 0, max = 10 }
b = { min = -1, max = 1, unit = \"m\" }
[outputs]
y = { unit = \"rad\" }
[sampling]
test_runs = 1
";

    impl TableFolder {
        fn new(files: &[(&str, &str)]) -> Self {
            let folder = Self(tempfile::tempdir().unwrap());
            files.iter().for_each(|(name, text)| std::fs::write(folder.0.path().join(name), text).unwrap());
            folder
        }

        fn study(&self, source: &str) -> Result<Study> {
            Study::parse(&STUDY.replace("SOURCE", source), &self.0.path().join("s.toml"))
        }

        /// Both sets' runs in the order of the parameter `a`.
        fn sample(&self, source: &str) -> Result<Vec<Run>> {
            let Source::Recorded(recorded) = Source::new(&self.study(source)?)? else { panic!() };
            assert_eq!(recorded.parameters()[1].unit, "m");
            let Sets { train, test, .. } = recorded.sample(&AtomicBool::new(false))?;
            assert_eq!(test.runs.len(), 1);
            let mut runs = [train.runs, test.runs].concat();
            runs.sort_by(|one, other| one.parameters[0].total_cmp(&other.parameters[0]));
            Ok(runs)
        }
    }

    fn run(a: f64, b: f64, times: &[f64], outputs: &[f64]) -> Run {
        Run { inputs: Vec::new(), parameters: vec![a, b], times: times.into(), outputs: outputs.to_vec() }
    }

    fn expected() -> Vec<Run> {
        let times = [0.0, 0.5, 1.0];
        vec![
            run(1.0, 0.5, &times, &[1.0, 2.0, 3.0]),
            run(2.0, 0.5, &times, &[4.0, 5.0, 6.0]),
            run(3.0, -0.5, &[0.0, 1.0], &[7.0, 8.0]),
        ]
    }

    const LONG: &str = "run,time,a,b,y
first,0,1,0.5,1
first,0.5,1,0.5,2
first,1,1,0.5,3
second,0,2,0.5,4
second,0.5,2,0.5,5
second,1,2,0.5,6
third,0,3,-0.5,7
third,1,3,-0.5,8
";

    #[test]
    fn one_table_of_all_runs_with_labels_or_without_is_read() {
        // other times, times past the end, other columns, other names
        let foreign = "t;note;Length [-];b [m];Body.y [rad]
0,0;x;1;0,5;1
0,5;;1;0,5;2
1;;1;0,5;3
1,5;;1;0,5;99
0;;2;0,5;4
0,5;;2;0,5;5
1;;2;0,5;6
0;;3;-0,5;7
1;;3;-0,5;8
";
        let folder = TableFolder::new(&[("r.csv", LONG), ("f.csv", foreign)]);
        assert_eq!(folder.sample("table = \"r.csv\"").unwrap(), expected());
        let source = "table = \"f.csv\"\ncolumns = { time = \"t\", a = \"Length\", y = \"Body.y\" }";
        assert_eq!(folder.sample(source).unwrap(), expected());
    }

    #[test]
    fn an_index_of_one_file_a_run_is_read() {
        let folder = TableFolder::new(&[
            ("i.csv", "file,a,b [m]\n1.csv,1,0.5\n2.csv,2,0.5\n3.csv,3,-0.5\n"),
            ("1.csv", "time [s]\ty\n0\t1\n0.5\t2\n1\t3\n"),
            ("2.csv", "time,y\ns,rad\n0,4\n0.5,5\n1,6\n"),
            ("3.csv", "y,time\n7,0\n8,1\n"),
        ]);
        assert_eq!(folder.sample("index = \"i.csv\"").unwrap(), expected());
        let digest = folder.study("index = \"i.csv\"").unwrap().sampling_digest();
        std::fs::write(folder.0.path().join("3.csv"), "y,time\n7,0\n9,1\n").unwrap();
        assert_ne!(folder.study("index = \"i.csv\"").unwrap().sampling_digest(), digest, "a file changed");
    }

    #[test]
    fn the_choice_of_test_runs_repeats_for_a_seed_only() {
        let rows: String =
            (0..40).map(|i| format!("{i},0,{},0,1\n{i},1,{},0,2\n", i as f64 / 4.0, i as f64 / 4.0)).collect();
        let folder = TableFolder::new(&[("r.csv", &format!("run,time,a,b,y\n{rows}"))]);
        let test = |seed: u64| {
            let text = STUDY.replace("SOURCE", "table = \"r.csv\"").replace("test_runs = 1", "test_runs = 10");
            let text = format!("seed = {seed}\n{text}");
            let study = Study::parse(&text, &folder.0.path().join("s.toml")).unwrap();
            let Sets { train, test, .. } = Recorded::new(&study).unwrap().sample(&AtomicBool::new(false)).unwrap();
            assert!(train.runs.len() == 30 && test.runs.iter().all(|run| !train.runs.contains(run)));
            test
        };
        assert_eq!(test(1), test(1));
        assert_ne!(test(1), test(2));
    }

    #[test]
    fn test_runs_may_have_a_table_of_their_own() {
        let tests = LONG.lines().take(4).collect::<Vec<_>>().join("\n").replace("1,0.5,", "4,0.5,");
        let folder = TableFolder::new(&[
            ("r.csv", LONG),
            ("t.csv", &tests),
            ("same.csv", LONG),
            ("none.csv", "run,time,a,b,y\n"),
        ]);
        let sets = |file: &str| {
            let source =
                STUDY.replace("SOURCE", "table = \"r.csv\"").replace("test_runs = 1", &format!("test = \"{file}\""));
            let study = Study::parse(&source, &folder.0.path().join("s.toml"))?;
            Ok::<_, Error>((Recorded::new(&study)?.sample(&AtomicBool::new(false))?, study.sampling_digest()))
        };
        let (Sets { train, test, .. }, digest) = sets("t.csv").unwrap();
        assert_eq!(train.runs, expected());
        assert_eq!(test.runs, [run(4.0, 0.5, &[0.0, 0.5, 1.0], &[1.0, 2.0, 3.0])]);
        for (file, says) in [
            ("same.csv", "same.csv:2: a second run with a = 1, b = 0.5, the first is in line 2"),
            ("none.csv", "none.csv:1: no test runs"),
            ("missing.csv", "missing.csv: cannot read"),
        ] {
            let message = sets(file).unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
        std::fs::write(folder.0.path().join("t.csv"), tests.replace(",3", ",3.5")).unwrap();
        assert_ne!(sets("t.csv").unwrap().1, digest, "the tests changed");
    }

    #[test]
    fn mistakes_in_recorded_runs_are_located() {
        for (from, to, says) in [
            ("y\n", "z\n", "r.csv:1: no column `y`, expected it among run, time, a, b, z"),
            (",time", ",t", "r.csv:1: no column `time`"),
            ("time,a,b,y", "time [ms],a,b,y", "r.csv:1: column `time`: unit `ms`, expected `s`"),
            ("time,a,b,y", "time,a,b [mm],y", "r.csv:1: column `b`: unit `mm`, expected `m`"),
            ("time,a,b,y", "time,a,b,y [deg]", "r.csv:1: column `y`: unit `deg`, expected `rad`"),
            ("first,0.5,1,0.5,2", "first,0.5,1,0.5,", "r.csv:3: column `y`: is empty, expected a finite number"),
            ("first,0.5,1,0.5,2", "first,0.5,1,0.5,nan", "r.csv:3: column `y`: `nan`, expected a finite number"),
            ("first,0.5,1,0.5,2", "first,0.5,1,0.5", "r.csv:3: 4 fields, expected 5"),
            ("first,0.5,1,0.5,2", ",0.5,1,0.5,2", "r.csv:3: column `run`: is empty, expected the run's label"),
            ("first,0.5,1,0.5,2", "first,0,1,0.5,2", "r.csv:3: time 0 s is duplicated in run `first`"),
            (
                "first,0.5,1,",
                "first,1.5,1,",
                "r.csv:4: time 1 s after 1.5 s in run `first`, expected rows in the order",
            ),
            ("first,0.5,1,", "first,0.5,1.5,", "r.csv:3: column `a`: 1.5 after 1, expected one value in a run"),
            ("first,0.5,1,", "first,0.5,11,", "r.csv:3: column `a`: 11, expected 0 to 10, the study's range"),
            ("second,0,", "second,0.1,", "r.csv:5: run `second` begins at 0.1 s, expected 0 s"),
            ("first,1,1,0.5,3\n", "", "r.csv:4: run `first` ends before this line at 0.5 s, expected 1 s"),
            ("third,1,3,-0.5,8\n", "", "r.csv:8: run `third` ends before this line at 0 s, expected 1 s"),
            ("third", "first", "r.csv:8: run `first` again, it began in line 2: a run's rows must be contiguous"),
            ("third,0,3,-0.5", "third,0,2,0.5", "r.csv:8: a second run with a = 2, b = 0.5, the first is in line 5"),
        ] {
            assert!(LONG.contains(from), "{from}");
            let folder = TableFolder::new(&[("r.csv", &LONG.replacen(from, to, 1))]);
            let message = folder.sample("table = \"r.csv\"").unwrap_err().to_string();
            assert!(message.contains(says), "{message} should contain {says}");
        }
        let two: String = LONG.lines().take(7).map(|line| format!("{line}\n")).collect();
        let message = TableFolder::new(&[("r.csv", &two)]).sample("table = \"r.csv\"").unwrap_err().to_string();
        assert!(message.contains("r.csv:7: 2 runs, expected at least 3: 1 for the tests, 2 to train"), "{message}");
        let without: String = LONG
            .replace("third,0,3,-0.5", "x,0,1,0.5")
            .lines()
            .map(|line| {
                let (_, rest) = line.split_once(',').unwrap();
                format!("{rest}\n")
            })
            .collect();
        let message = TableFolder::new(&[("r.csv", &without)]).sample("table = \"r.csv\"").unwrap_err().to_string();
        assert!(message.contains("r.csv:8: a second run with a = 1, b = 0.5, the first is in line 2"), "{message}");
    }

    #[test]
    fn mistakes_in_an_index_and_in_the_study_are_located() {
        let folder = TableFolder::new(&[
            ("i.csv", "file,a,b\n1.csv,1,0.5\n2.csv,2,0.5\n"),
            ("1.csv", "time,y\n0,1\n1,2\n"),
            ("empty.csv", "file,a,b\n"),
            ("none.csv", "file,a,b\n1.csv,1,0.5\nshort.csv,2,0.5\n1.csv,3,0\n"),
            ("short.csv", "time,y\n0,1\n0.9,2\n"),
            ("blank.csv", "file,a,b\nheader.csv,1,0.5\n"),
            ("header.csv", "time,y\n"),
            ("again.csv", "file,a,b\n1.csv,1,0.5\n1.csv,2,0.5\n"),
        ]);
        for (source, says) in [
            ("index = \"i.csv\"", "i.csv:3: "),
            ("index = \"i.csv\"", "2.csv: cannot read"),
            ("index = \"empty.csv\"", "empty.csv:1: the index has no rows"),
            ("index = \"none.csv\"", "short.csv:3: run `short.csv` ends before this line at 0.9 s"),
            ("index = \"blank.csv\"", "header.csv:1: run `header.csv` has no rows"),
            ("index = \"again.csv\"", "again.csv:3: run `1.csv` again"),
            ("index = \"1.csv\"", "1.csv:1: no column `file`"),
            ("table = \"missing.csv\"", "missing.csv: cannot read"),
            (
                "table = \"i.csv\"\nindex = \"i.csv\"",
                "s.toml:2: source: expected one of `system`, `mechanism`, `fmu`, `command`, `table`",
            ),
            (
                "table = \"i.csv\"\nconstants = { m = 1 }",
                "s.toml:4: source.constants: belongs to `system`, `mechanism`, `fmu` and `command`",
            ),
            (
                "table = \"1.csv\"\ncolumns = { z = \"y\" }",
                "s.toml:4: source.columns.z: `z` is neither a parameter nor",
            ),
            (
                "table = \"1.csv\"\ncolumns = { y = \"time\" }",
                "s.toml:4: source.columns.y: column `time` is that of `time` already",
            ),
            ("system = \"single-pendulum\"", "s.toml:12: sampling: expected a `method`"),
        ] {
            let message = folder.sample(source).unwrap_err().to_string();
            assert!(message.contains(says), "{source}: {message} should contain {says}");
        }
        let text = STUDY.replace("SOURCE", "table = \"i.csv\"").replace("[sampling]", "[sampling]\nruns = 5");
        let message = Study::parse(&text, &folder.0.path().join("s.toml")).unwrap_err().to_string();
        assert!(
            message
                .contains("sampling: recorded runs are where they are: expected `test_runs`, `test` or `tables` only"),
            "{message}"
        );
    }
}
