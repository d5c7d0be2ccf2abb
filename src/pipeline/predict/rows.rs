//! Rows of a table on their way into a surrogate: points, or runs that are rolled out.

use crate::{
    Error, Result,
    dataset::Run,
    diagnostics::names::{self, NameMatch},
    table::{
        Table,
        runs::{self, check_constants, check_time},
        writer::Labels,
    },
    variable::{DefaultValue, MatchedVariables, Need, WantedVariable, match_variables},
};
use metafmu_runtime::{Input, Role, Surrogate};
use std::{
    path::Path,
    sync::atomic::{AtomicBool, Ordering},
};

/// Column that labels the runs.
pub(super) const RUN: &str = "run";
/// Column of the time, whether it is an input of the surrogate or not.
pub(super) const TIME: &str = "time";

/// Rows that are read before they are given on: enough for all threads, little memory, and a row group of Parquet.
const BATCH: usize = 1 << 17;
/// Part of the sample time by which the time of a measured row may be off, as communication points may.
const SAME_SAMPLE: f64 = 1e-6;
/// Rows that a thread evaluates at a time.
const BLOCK: usize = 1 << 11;

/// Rows that were read together.
pub(super) enum Batch {
    /// Each row is a point.
    Points(Vec<Points>),
    /// Whole runs.
    Runs(Vec<LabeledRun>),
}

/// Points of a surrogate without states.
#[derive(Default)]
pub(super) struct Points {
    pub(super) labels: Option<Labels>,
    /// The surrogate's inputs, row by row.
    pub(super) values: Vec<f64>,
}

/// A run, whose parameters are those of the surrogate and then the values of its states at the start.
pub(super) struct LabeledRun {
    /// Empty without a column for it.
    pub(super) label: String,
    pub(super) run: Run,
}

/// Columns of a table with the values of a surrogate.
struct PredictionColumns {
    /// Column of each input; none for those with a constant value.
    inputs: Vec<Option<usize>>,
    /// Values of the inputs without a column.
    values: Vec<f64>,
    /// Column of the time, for a surrogate with states.
    time: Option<usize>,
    run: Option<usize>,
    /// Columns of the outputs of a discrete-time surrogate, which are measured before the start; empty if one is
    /// missing.
    measured: Vec<usize>,
    /// The problem of rows before the start, if some of these columns are missing and others are not.
    unmeasured: Option<String>,
}

/// A table that is being read for a surrogate.
pub(super) struct Reader<'a> {
    surrogate: &'a Surrogate,
    stop: &'a AtomicBool,
    table: Table<'a>,
    columns: PredictionColumns,
    labels: runs::RunLabels,
    current: Option<PredictionRun>,
    /// Notes and doubts about the header.
    matched: MatchedVariables,
}

/// The run that is being read.
struct PredictionRun {
    label: String,
    constants: Vec<f64>,
    times: Vec<f64>,
    inputs: Vec<f64>,
    /// Outputs of the rows before the start, if they are measured.
    outputs: Vec<f64>,
}

impl<'a> Reader<'a> {
    /// Opens a table and finds the surrogate's inputs in its header.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Table`] with all that is wrong with the header, [`Error::Interrupted`].
    pub(super) fn open(
        surrogate: &'a Surrogate,
        path: &Path,
        stop: &'a AtomicBool,
        defaults: &[DefaultValue],
    ) -> Result<Self> {
        let table = Table::open_stream(path, stop)?;
        let (columns, matched) = PredictionColumns::find(surrogate, &table, defaults)?;
        Ok(Self { surrogate, stop, table, columns, labels: runs::RunLabels::default(), current: None, matched })
    }

    /// Lines about inputs without a column and columns without a use, and about those that perhaps belong together.
    pub(super) fn notes_and_doubts(&self) -> [&[String]; 2] {
        [&self.matched.notes, &self.matched.doubts]
    }

    /// Returns true if the rows have labels.
    pub(super) fn has_labels(&self) -> bool {
        self.columns.run.is_some()
    }

    /// How much of the table has been read, from 0 to 1.
    pub(super) fn share_read(&self) -> f64 {
        self.table.share_read()
    }

    /// The next rows; none at the end of the table.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Table`] with the first mistake, [`Error::Interrupted`].
    pub(super) fn next(&mut self) -> Result<Option<Batch>> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        if !self.surrogate.program().has_memory() {
            let points = self.next_points()?;
            return Ok((!points.is_empty()).then_some(Batch::Points(points)));
        }
        let (runs, is_end) = self.next_runs()?;
        Ok((!(is_end && runs.is_empty())).then_some(Batch::Runs(runs)))
    }

    fn next_points(&mut self) -> Result<Vec<Points>> {
        let mut blocks = Vec::with_capacity(BATCH / BLOCK);
        while blocks.len() < BATCH / BLOCK {
            let mut block = Points { labels: self.columns.run.map(|_| Labels::default()), values: Vec::new() };
            block.values.reserve(BLOCK * self.columns.inputs.len());
            let mut rows = 0;
            while rows < BLOCK && self.table.next_row()? {
                self.read_point(&mut block)?;
                rows += 1;
            }
            if rows > 0 {
                blocks.push(block);
            }
            if rows < BLOCK {
                break;
            }
        }
        Ok(blocks)
    }

    fn read_point(&mut self, Points { labels, values }: &mut Points) -> Result<()> {
        for (column, value) in self.columns.inputs.iter().zip(&self.columns.values) {
            values.push(column.map_or(Ok(*value), |column| self.table.number(column))?);
        }
        if let (Some(labels), Some(run)) = (labels, self.columns.run) {
            labels.push(&self.table.text(run)?);
        }
        Ok(())
    }

    /// Whole runs, and whether the table has ended.
    fn next_runs(&mut self) -> Result<(Vec<LabeledRun>, bool)> {
        let mut runs = Vec::new();
        for _ in 0..BATCH {
            if !self.table.next_row()? {
                runs.extend(self.current.take().map(PredictionRun::finish));
                return Ok((runs, true));
            }
            runs.extend(self.read_row()?);
        }
        Ok((runs, false))
    }

    /// Reads a row, and gives the run that has ended before it.
    fn read_row(&mut self) -> Result<Option<LabeledRun>> {
        let Self { surrogate, table, columns, current, labels, .. } = self;
        let time = columns.time.map_or(Ok(0.0), |column| table.number(column))?;
        let (mut constants, mut inputs) = (Vec::new(), Vec::new());
        for ((column, value), input) in columns.inputs.iter().zip(&columns.values).zip(surrogate.inputs()) {
            let value = column.map_or(Ok(*value), |column| table.number(column))?;
            if input.role == Role::Input { &mut inputs } else { &mut constants }.push(value);
        }
        if let Some(problem) = columns.unmeasured.as_ref().filter(|_| time < 0.0) {
            return Err(table.mistake(problem));
        }
        let measured = if time < 0.0 { columns.measured.as_slice() } else { &[] };
        let mut outputs = measured.iter().map(|column| table.number(*column)).collect::<Result<Vec<f64>>>()?;
        let label = columns.run.map_or(Ok("".into()), |run| table.text(run))?.into_owned();
        if columns.run.is_some() && label.is_empty() {
            return Err(table.mistake(&format!("column `{RUN}`: is empty, expected the run's label")));
        }
        // without labels, a run ends where the time goes back
        let has_memory =
            |run: &PredictionRun| if columns.run.is_some() { run.label == label } else { time >= run.last() };
        let Some(run) = current.as_mut().filter(|run| has_memory(run)) else {
            labels.begin(table, &label)?;
            let begun = PredictionRun { label, constants, times: vec![time], inputs, outputs };
            return Ok(current.replace(begun).map(PredictionRun::finish));
        };
        check_time(table, &label, run.last(), time)?;
        if let (Some(sampling), false) = (surrogate.program().sampling(), outputs.is_empty()) {
            check_sample(&run.times, time, sampling.step).map_or(Ok(()), |problem| Err(table.mistake(&problem)))?;
        }
        let names = surrogate.inputs().iter().filter(|input| input.role != Role::Input);
        check_constants(table, names.map(|input| input.name.as_str()), &constants, &run.constants)?;
        run.times.push(time);
        run.inputs.append(&mut inputs);
        run.outputs.append(&mut outputs);
        Ok(None)
    }

    /// A mistake of the table as a whole.
    pub(super) fn mistake(&self, message: &str) -> Error {
        self.table.mistake(message)
    }
}

/// Problem of the time of a row whose outputs are measured, because they must be those of a sample. `before`: times of
/// the rows before it.
pub(crate) fn check_sample(before: &[f64], time: f64, step: f64) -> Option<String> {
    let expected = before.first()? + step * before.len() as f64;
    let is_sample = (time - expected).abs() <= SAME_SAMPLE * step;
    (!is_sample).then(|| {
        // as people read it
        let expected = format!("{expected:.12e}").parse().unwrap_or(expected);
        format!("time {time} s, expected {expected} s: rows before time 0 are {step} s apart, as their outputs are measured samples")
    })
}

impl PredictionRun {
    /// Time of the row before.
    fn last(&self) -> f64 {
        self.times.last().copied().unwrap_or(f64::NEG_INFINITY)
    }

    fn finish(self) -> LabeledRun {
        let Self { label, constants, times, inputs, outputs } = self;
        let run = Run { parameters: constants, times: times.into(), inputs, outputs };
        LabeledRun { label, run }
    }
}

impl PredictionColumns {
    fn find<'a>(
        surrogate: &'a Surrogate,
        table: &Table,
        defaults: &[DefaultValue],
    ) -> Result<(Self, MatchedVariables)> {
        let names: Vec<&str> = table.columns().iter().map(|column| column.name.as_str()).collect();
        let outputs: Vec<&str> = surrogate.outputs().iter().map(|output| output.name.as_str()).collect();
        let has_states = surrogate.program().has_memory();
        let of_input = |input: &'a Input| {
            let need = match input.role {
                Role::Time => Need::Data,
                Role::Start => Need::Any,
                Role::Input | Role::Parameter(_) => Need::DataOrDefault,
            };
            WantedVariable { name: &input.name, unit: &input.unit, start: Some(input.start), need }
        };
        let time = has_states.then_some(WantedVariable { name: TIME, unit: "s", start: None, need: Need::Data });
        let wanted: Vec<WantedVariable> = surrogate.inputs().iter().map(of_input).chain(time).collect();
        let other: Vec<&str> = outputs.iter().copied().chain([RUN, TIME]).collect();
        let matched = match_variables(&wanted, &names, &other, defaults);
        let of_wanted: Vec<&str> = wanted.iter().map(|variable| variable.name).collect();
        let used = NameMatch::of(&of_wanted, &names).positions;
        let units = used.iter().zip(&wanted);
        let units = units.filter_map(|(column, variable)| table.unit_problem((*column)?, Some(variable.unit)));
        let problems: Vec<String> = matched.as_ref().err().map(ToString::to_string).into_iter().chain(units).collect();
        let matched = match matched {
            Ok(matched) if problems.is_empty() => matched,
            _ => return Err(table.mistake_in_header(&problems.join("; "))),
        };
        let run = table.optional_column(RUN, &used.iter().flatten().copied().collect::<Vec<_>>())?;

        let (mut columns, mut values) = (matched.columns.clone(), matched.values.clone());
        let time = if has_states { columns.pop().flatten() } else { None };
        values.truncate(columns.len());
        let NameMatch { positions, .. } = NameMatch::of(&outputs, &names);
        let is_sampled = surrogate.program().sampling().is_some();
        let all: Option<Vec<usize>> = positions.iter().copied().collect();
        let some_are_missing = is_sampled && all.is_none() && positions.iter().any(Option::is_some);
        let unmeasured = some_are_missing.then(|| {
            let missing = outputs.iter().zip(&positions).filter(|(_, position)| position.is_none());
            partly_measured(&missing.map(|(name, _)| *name).collect::<Vec<_>>(), &names)
        });
        let measured = all.filter(|_| is_sampled).unwrap_or_default();
        Ok((Self { inputs: columns, values, time, run, measured, unmeasured }, matched))
    }
}

/// Message for rows before the start of a discrete-time surrogate in which some outputs are measured and others are missing.
pub(crate) fn partly_measured(missing: &[&str], columns: &[&str]) -> String {
    let message = names::missing("column", missing, columns, columns).unwrap_or_default();
    format!("a row before time 0 has measured outputs, and all outputs are needed there: {message}")
}
