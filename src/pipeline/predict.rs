//! Predictions in bulk: the outputs of a surrogate for all rows of a table.
//!
//! Without states every row is a separate point. With states the rows of a run are rolled out together, from the start
//! in its first row, with inputs that are linear between two rows.
//!
//! One thread reads while the others evaluate, and written rows are not kept.

mod rows;

pub(super) use rows::{check_sample, partly_measured};

use crate::{
    Error, Result,
    diagnostics::{kinds, names::expected_one_of},
    evaluation::RollOut,
    export::read_surrogate,
    project::{Control, CountedWork, Event, Project},
    surrogate,
    table::writer::{Block, Format, Labels, Values, Writer},
    variable::DefaultValue,
};
use indexmap::IndexMap;
use metafmu_runtime::{BuiltIn, Domain, Evaluator, Output, Role, Surrogate};
use rayon::prelude::*;
use rows::{Batch, LabeledRun, Points, RUN, Reader, TIME};
use serde::Serialize;
use std::{
    io::Write,
    panic::resume_unwind,
    path::Path,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::{SyncSender, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

/// Options of a prediction.
#[derive(Clone, Debug)]
pub struct PredictOptions {
    /// Names of the outputs; all if there are none.
    pub outputs: Vec<String>,
    /// Format of the result.
    pub format: Format,
    /// Values of parameters, inputs and states at the start that the table has no column for.
    pub defaults: Vec<DefaultValue>,
}

/// Result of a prediction.
#[derive(Clone, Debug, Serialize)]
pub struct Predicted {
    /// Name of the surrogate.
    pub name: String,
    /// Its content digest.
    pub content_digest: String,
    /// Error bound of each predicted output, if it was measured; for a model with a state, the bound at the end of its
    /// runs.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    pub bounds: IndexMap<String, f64>,
    /// Rows of the table, and of the result.
    pub rows: u64,
    /// Roll-outs, of a surrogate with states.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<u64>,
    /// Rows outside the training ranges.
    pub outside: Found,
    /// Rows with an output that is not a finite number: it is too large, or the roll-out could not be computed so far.
    pub not_finite: Found,
    /// Wall time.
    pub seconds: f64,
    /// Time that one thread was reading and checking the table, meanwhile the others evaluated and wrote.
    pub read_seconds: f64,
    /// Wall time of the evaluation by all threads.
    pub evaluate_seconds: f64,
    /// Wall time of formatting, compressing and writing.
    pub write_seconds: f64,
}

/// Rows of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Found {
    /// How many.
    pub rows: u64,
    /// The first one, counted from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first: Option<u64>,
}

impl Found {
    /// Adds one at a position, counted from 0.
    fn add(&mut self, row: usize) {
        self.rows += 1;
        self.first = self.first.or(Some(row as u64 + 1));
    }

    /// Adds those of a block that begins after `after` rows.
    fn extend(&mut self, after: u64, block: Self) {
        self.rows += block.rows;
        self.first = self.first.or(block.first.map(|row| after + row));
    }
}

/// Reads the surrogate of an FMU made by metafmu (`.fmu`), of a model file (`.safetensors`), or of a study (`.toml`),
/// from its folder of results `out/NAME`.
///
/// # Errors
/// Those of [`read_surrogate`], [`surrogate::load`] and [`Project::load_model`]; [`Error::OtherFile`] for other files.
pub fn load(path: &Path, control: Control<'_>) -> Result<Surrogate> {
    match extension(path).as_deref() {
        Some("toml") => Project::open(path, None, control)?.load_model(),
        _ => load_file(path),
    }
}

/// Reads a surrogate that is a file: that of an FMU made by metafmu (`.fmu`) or of a model file (`.safetensors`).
///
/// # Errors
/// Those of [`read_surrogate`] and [`surrogate::load`]; [`Error::OtherFile`] for other files.
pub fn load_file(path: &Path) -> Result<Surrogate> {
    match extension(path).as_deref() {
        Some("fmu") => read_surrogate(path),
        Some("safetensors") => surrogate::load(path),
        _ => Err(kinds::other(
            path,
            "a surrogate, a file that ends in .fmu or .safetensors, or its study, which ends in .toml",
        )),
    }
}

/// Returns true if a file is a surrogate by its name.
pub fn is_surrogate(path: &Path) -> bool {
    matches!(extension(path).as_deref(), Some("fmu" | "safetensors"))
}

fn extension(path: &Path) -> Option<String> {
    Some(path.extension()?.to_string_lossy().to_lowercase())
}

/// Predicts all rows of a table and writes them in the same order. Columns are found by name; a parameter or input without one
/// is an error unless the options have its value. The columns are `run` and `time` if the table has
/// them, the outputs, `in_domain` and `domain_distance`. `path`: the name of `to` in errors.
///
/// # Errors
/// [`Error::Variable`] for an unknown output, [`Error::Table`] with file and line of a mistake, [`Error::Io`],
/// [`Error::Interrupted`].
pub fn predict(
    surrogate: &Surrogate,
    table: &Path,
    options: &PredictOptions,
    control: Control<'_>,
    (to, path): (&mut dyn Write, &Path),
) -> Result<Predicted> {
    let began = Instant::now();
    let Control { observer, stop, .. } = control;
    let predictor = Predictor::new(surrogate, &options.outputs, stop)?;
    let reader = Reader::open(surrogate, table, stop, &options.defaults)?;
    let [notes, doubts] = reader.notes_and_doubts();
    notes.iter().for_each(|line| observer.event(Event::Message(format_args!("{line}"))));
    doubts.iter().for_each(|line| observer.event(Event::Warning(format_args!("{line}"))));
    let mut writer = Writer::new(options.format, &predictor.columns(reader.has_labels()));
    let mut predicted = predictor.predicted();
    observer.event(Event::Begin { work: CountedWork::Rows, total: SHARES });
    let reader = thread::scope(|scope| {
        let (give, take) = sync_channel(1);
        let reading = scope.spawn(move || read(reader, &give));
        for (batch, share) in take {
            let start = Instant::now();
            let blocks = predictor.evaluate(batch?, &mut predicted);
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Interrupted);
            }
            predicted.evaluate_seconds += start.elapsed().as_secs_f64();
            let start = Instant::now();
            writer.write(&blocks, to).map_err(Error::io(path, "write"))?;
            predicted.write_seconds += start.elapsed().as_secs_f64();
            let (done, about) = ((share * SHARES as f64) as usize, format_args!("{} rows", predicted.rows));
            observer.event(Event::Progress { done, about });
        }
        let (reader, busy) = reading.join().unwrap_or_else(|panic| resume_unwind(panic));
        predicted.read_seconds = busy.as_secs_f64();
        Ok(reader)
    })?;
    if predicted.rows == 0 {
        return Err(reader.mistake("the table has no rows"));
    }
    writer.finish(to).map_err(Error::io(path, "write"))?;
    predicted.seconds = began.elapsed().as_secs_f64();
    observer.event(Event::End);
    Ok(predicted)
}

/// Outputs of a surrogate with a state along the runs of a table, row by row, and `true` for the first row of a run.
/// Values that cannot be computed are NaN.
///
/// # Errors
/// [`Error::Io`], [`Error::Table`] with the problems of the table.
pub(super) fn roll_outs(surrogate: &Surrogate, table: &Path) -> Result<Vec<(bool, Vec<f64>)>> {
    let stop = AtomicBool::new(false);
    // the start is part of the model that is checked
    let starts = surrogate.inputs().iter().filter(|input| input.role == Role::Start);
    let defaults: Vec<DefaultValue> =
        starts.map(|input| DefaultValue { name: input.name.clone(), value: None }).collect();
    let mut reader = Reader::open(surrogate, table, &stop, &defaults)?;
    let evaluator = Evaluator::new(surrogate);
    let width = surrogate.outputs().len();
    let mut rows = Vec::new();
    while let Some(batch) = reader.next()? {
        let Batch::Runs(runs) = batch else { continue };
        for LabeledRun { run, .. } in &runs {
            let mut roll_out = RollOut::along(surrogate, &evaluator, run).with_most_steps(u64::MAX);
            for row in 0..run.times.len() {
                let found = roll_out.at(row).map_or(vec![f64::NAN; width], |(_, results)| results[..width].to_vec());
                rows.push((row == 0, found));
            }
        }
    }
    Ok(rows)
}

/// Parts of a table in which progress is counted.
const SHARES: usize = 1000;

/// Reads a table, batch by batch, and reports each time the share that has been read. Returns the time that it took.
fn read<'a>(mut reader: Reader<'a>, give: &SyncSender<(Result<Batch>, f64)>) -> (Reader<'a>, Duration) {
    let mut busy = Duration::ZERO;
    loop {
        let start = Instant::now();
        let batch = reader.next().transpose();
        busy += start.elapsed();
        let Some(batch) = batch else { return (reader, busy) };
        let is_last = batch.is_err();
        // nobody takes it where writing has failed
        if give.send((batch, reader.share_read())).is_err() || is_last {
            return (reader, busy);
        }
    }
}

/// Positions of outputs by their names.
fn positions(outputs: &[String], known: &[&str]) -> Result<Vec<usize>> {
    let mut positions: Vec<usize> = Vec::with_capacity(outputs.len());
    for name in outputs {
        let problem = match known.iter().position(|known| known == name) {
            Some(position) if !positions.contains(&position) => {
                positions.push(position);
                continue;
            }
            Some(_) => "is listed twice, expected each output once".into(),
            None => format!("the surrogate has no such output, {}", expected_one_of(name, known)),
        };
        return Err(Error::Variable { name: name.clone(), problem });
    }
    Ok(positions)
}

/// A surrogate that predicts.
struct Predictor<'a> {
    surrogate: &'a Surrogate,
    evaluator: Evaluator,
    domain: Domain,
    /// Which outputs.
    outputs: Vec<usize>,
    stop: &'a AtomicBool,
}

impl<'a> Predictor<'a> {
    fn new(surrogate: &'a Surrogate, outputs: &[String], stop: &'a AtomicBool) -> Result<Self> {
        let known: Vec<&str> = surrogate.outputs().iter().map(|output| output.name.as_str()).collect();
        let mut outputs = positions(outputs, &known)?;
        if outputs.is_empty() {
            outputs = (0..known.len()).collect();
        }
        let (evaluator, domain) = (Evaluator::new(surrogate), Domain::of(surrogate));
        Ok(Self { surrogate, evaluator, domain, outputs, stop })
    }

    fn outputs(&self) -> impl Iterator<Item = &'a Output> {
        self.outputs.iter().map(|&index| &self.surrogate.outputs()[index])
    }

    fn has_states(&self) -> bool {
        self.surrogate.program().has_memory()
    }

    /// Names of the result's columns.
    fn columns(&self, has_labels: bool) -> Vec<&'a str> {
        let has_time = self.has_states() || self.surrogate.time_column().is_some();
        let of_row = has_labels.then_some(RUN).into_iter().chain(has_time.then_some(TIME));
        let of_domain = [BuiltIn::InDomain.name(), BuiltIn::DomainDistance.name()];
        of_row.chain(self.outputs().map(|output| output.name.as_str())).chain(of_domain).collect()
    }

    /// Result, as far as it is known before the first row.
    fn predicted(&self) -> Predicted {
        let bounds = self.surrogate.bounds();
        let predictions = self.surrogate.predictions().len();
        let bounded = self.outputs.iter().filter(|&&index| index < predictions);
        let bounds = bounded.filter_map(|&index| Some((index, bounds?.largest(index))));
        Predicted {
            name: self.surrogate.metadata().name.clone(),
            content_digest: self.surrogate.metadata().provenance.content_digest.clone(),
            bounds: bounds.map(|(index, bound)| (self.surrogate.outputs()[index].name.clone(), bound)).collect(),
            rows: 0,
            runs: self.has_states().then_some(0),
            outside: Found::default(),
            not_finite: Found::default(),
            seconds: 0.0,
            read_seconds: 0.0,
            evaluate_seconds: 0.0,
            write_seconds: 0.0,
        }
    }

    /// Predicts a batch and counts its rows.
    fn evaluate(&self, batch: Batch, predicted: &mut Predicted) -> Vec<Block> {
        let answers: Vec<Answers> = match batch {
            Batch::Points(blocks) => blocks.into_par_iter().map(|points| self.respond(points)).collect(),
            Batch::Runs(runs) => {
                predicted.runs = predicted.runs.map(|count| count + runs.len() as u64);
                runs.into_par_iter().map(|run| self.roll_out(&run)).collect()
            }
        };
        for answers in &answers {
            predicted.outside.extend(predicted.rows, answers.outside);
            predicted.not_finite.extend(predicted.rows, answers.not_finite);
            predicted.rows += answers.distances.len() as u64;
        }
        answers.into_iter().map(Answers::block).collect()
    }

    fn respond(&self, Points { labels, values }: Points) -> Answers {
        let width = self.surrogate.inputs().len();
        let times = self.surrogate.time_column();
        let times = times.map(|column| values.iter().skip(column).step_by(width).copied().collect());
        let mut answers = Answers::new(self, labels, times, values.len() / width);
        let (mut results, mut evaluator) = (vec![0.0; self.evaluator.results()], self.evaluator.clone());
        for point in values.chunks_exact(width) {
            evaluator.evaluate(point, &mut results);
            answers.push(self, point, &results);
        }
        answers
    }

    fn roll_out(&self, LabeledRun { label, run }: &LabeledRun) -> Answers {
        let rows = run.times.len();
        let labels = (!label.is_empty()).then(|| Labels::repeated(label, rows));
        let mut answers = Answers::new(self, labels, Some(run.times.to_vec()), rows);
        let mut roll_out = RollOut::along(self.surrogate, &self.evaluator, run).with_most_steps(u64::MAX);
        for row in 0..rows {
            match roll_out.at(row) {
                Some((point, results)) if !self.stop.load(Ordering::Relaxed) => answers.push(self, point, results),
                _ => {
                    answers.give_up(rows - row);
                    break;
                }
            }
        }
        answers
    }
}

/// Columns of some rows of the result.
struct Answers {
    labels: Option<Labels>,
    times: Option<Vec<f64>>,
    outputs: Vec<Vec<f64>>,
    inside: Vec<bool>,
    distances: Vec<f64>,
    outside: Found,
    not_finite: Found,
}

impl Answers {
    /// No results yet, with room for `rows` rows.
    fn new(predictor: &Predictor, labels: Option<Labels>, times: Option<Vec<f64>>, rows: usize) -> Self {
        Self {
            labels,
            times,
            outputs: predictor.outputs.iter().map(|_| Vec::with_capacity(rows)).collect(),
            inside: Vec::with_capacity(rows),
            distances: Vec::with_capacity(rows),
            outside: Found::default(),
            not_finite: Found::default(),
        }
    }

    /// Adds a row: the results at a point.
    fn push(&mut self, predictor: &Predictor, point: &[f64], results: &[f64]) {
        let row = self.distances.len();
        let mut is_finite = true;
        for (column, &output) in self.outputs.iter_mut().zip(&predictor.outputs) {
            column.push(results[output]);
            is_finite &= results[output].is_finite();
        }
        let is_inside = predictor.domain.contains_point(point, 0);
        self.inside.push(is_inside);
        self.distances.push(predictor.domain.distance(point, 0));
        if !is_inside {
            self.outside.add(row);
        }
        if !is_finite {
            self.not_finite.add(row);
        }
    }

    /// Adds rows that cannot be computed: nothing is known about them.
    fn give_up(&mut self, count: usize) {
        let rows = self.distances.len() + count;
        (self.distances.len()..rows).for_each(|row| self.not_finite.add(row));
        self.outputs.iter_mut().chain([&mut self.distances]).for_each(|column| column.resize(rows, f64::NAN));
        self.inside.resize(rows, false);
    }

    /// The columns in the order of [`Predictor::columns`].
    fn block(self) -> Block {
        let of_row = self.labels.map(Values::Labels).into_iter().chain(self.times.map(Values::Numbers));
        let outputs = self.outputs.into_iter().map(Values::Numbers);
        of_row.chain(outputs).chain([Values::Flags(self.inside), Values::Numbers(self.distances)]).collect()
    }
}
