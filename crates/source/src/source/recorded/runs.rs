//! Rows on their way into runs. The rows of a run must be in the order of time from zero to the end, in one place, with
//! parameters that no other run has.

use super::{
    super::list,
    Recorded, RecordedInput, at_gap,
    outliers::{self, Outliers},
};
use crate::{
    Error, Result,
    dataset::Run,
    diagnostics::{
        Place,
        numbers::{ends, exact},
    },
    scaling,
    table::{
        Table,
        runs::{RunLabels, check_time, named},
        stamps::{self, StampUnit},
    },
};
use nalgebra::DMatrix;
use std::{
    collections::HashMap,
    hash::{DefaultHasher, Hash, Hasher},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

/// Part of a sample time by which a row may miss its time, unless the stamps are rounded.
const SAME_TIME: f64 = 1e-6;

/// Rows on their way into runs.
pub(super) struct Runs<'a> {
    recorded: &'a Recorded,
    stop: &'a AtomicBool,
    pub(super) finished: Vec<Run>,
    pub(super) current: Option<Current>,
    labels: RunLabels,
    /// Place at which each point begins.
    points: HashMap<Vec<u64>, Place>,
    /// Names of runs with inputs, by the hash of their recorded values.
    recordings: HashMap<u64, String>,
    /// Runs mostly share their times: the previous run's are kept to share them.
    shared_times: Arc<[f64]>,
    /// Unit of the stamps so far.
    unit: StampUnit,
    /// Places of the rows of finished runs with samples.
    origins: Vec<(PathBuf, Vec<Place>)>,
}

/// The run that is being read.
pub(super) struct Current {
    pub(super) label: String,
    pub(super) parameters: Vec<f64>,
    times: Vec<f64>,
    inputs: Vec<f64>,
    outputs: Vec<f64>,
    /// Rows before time zero.
    before: usize,
    /// Time of the last row, those past the end included.
    last: Option<f64>,
    /// Places of the rows of a motion, or of a run with samples, in the table.
    places: Vec<Place>,
}

/// Number of past samples by which the first rows of a record are compared with rest, minimum number of rows for each
/// column of them, and a weight that separates columns that are nearly equal.
const ORDER: usize = 8;
const ROWS_OF_A_COLUMN: usize = 4;
const RIDGE: f64 = 1e-10;
/// Multiple of the usual error that contradicts rest.
const MUCH_LARGER: f64 = 5.0;
/// Runs of a table of several that are compared with rest.
const TRIED: usize = 10;

impl<'a> Runs<'a> {
    pub(super) fn new(recorded: &'a Recorded, stop: &'a AtomicBool) -> Self {
        let (labels, points, recordings) = (RunLabels::default(), HashMap::new(), HashMap::new());
        Self {
            recorded,
            stop,
            finished: Vec::new(),
            current: None,
            labels,
            points,
            recordings,
            shared_times: Arc::new([]),
            unit: StampUnit::default(),
            origins: Vec::new(),
        }
    }

    /// Further runs, which must differ from these.
    pub(super) fn followed(&self) -> Self {
        let (points, recordings) = (self.points.clone(), self.recordings.clone());
        Self { points, recordings, ..Self::new(self.recorded, self.stop) }
    }

    /// Begins a run at the row of a table.
    pub(super) fn begin(&mut self, table: &Table, label: String, parameters: Vec<f64>) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        self.labels.begin(table, &label)?;
        // zeros of both signs are one point
        let point = parameters.iter().map(|value| (value + 0.0).to_bits()).collect();
        let first = self.points.insert(point, table.place());
        // motions and runs with inputs differ in what drives them
        if let Some(before) = first.filter(|_| self.recorded.inputs.is_empty() && !self.recorded.is_motion) {
            let names = &self.recorded.names.parameters;
            let values = list(names.iter().zip(&parameters).map(|(name, value)| format!("{name} = {}", exact(*value))));
            let message = format!("a second run with {values}, the first is in {before}: runs must differ");
            return Err(table.mistake(&message));
        }
        let times = Vec::with_capacity(self.shared_times.len());
        let (inputs, outputs, places) = (Vec::new(), Vec::new(), Vec::new());
        self.current = Some(Current { label, parameters, times, inputs, outputs, before: 0, last: None, places });
        Ok(())
    }

    /// Adds a row, given the columns of the time and of inputs and outputs.
    pub(super) fn row(&mut self, table: &mut Table, time: usize, values: &[usize]) -> Result<()> {
        let t = table.number(time)?;
        let Some(current) = &mut self.current else { return Ok(()) };
        let stop = self.recorded.stop;
        self.unit.see(t);
        let rounding = self.unit.tolerance(self.recorded.step, 0.0).max(1e-9 * stop);
        match current.last {
            None if t < 0.0 && self.recorded.samples.is_some() => {
                let (step, least) = self.recorded.samples.unwrap_or_default();
                current.before = (-t / step).round() as usize;
                if current.before < least {
                    let expected =
                        format!("expected 0 s, or at least {least} rows before it (discrete.history, discrete.window)");
                    return Err(table.mistake(&format!("{} begins at {t} s, {expected}", named(&current.label))));
                }
            }
            None if t.abs() > 1e-9 * stop => {
                return Err(table.mistake(&format!("{} begins at {t} s, expected 0 s", named(&current.label))));
            }
            None => {}
            Some(last) => check_time(table, &current.label, last, t)?,
        }
        current.last = Some(t);
        // a single run is cut into several
        let is_within = t <= stop + rounding || self.recorded.samples.is_some() && self.finished.is_empty();
        let inputs = self.recorded.inputs.len();
        for (index, &column) in values.iter().enumerate() {
            let is_sampled = self.recorded.samples.is_some();
            let value = table.number(column).map_err(|error| if is_sampled { at_gap(error) } else { error })?;
            if let Some(&RecordedInput { min, max, .. }) = self.recorded.inputs.get(index)
                && !(min..=max).contains(&value)
            {
                let name = &self.recorded.names.inputs[index];
                let message =
                    format!("column `{name}`: {}, expected {}, the study's range", exact(value), ends(min, max));
                return Err(table.mistake(&message));
            }
            if is_within {
                if index < inputs { &mut current.inputs } else { &mut current.outputs }.push(value);
            }
        }
        if is_within {
            let mut time = t.clamp(0.0, stop);
            if let Some((step, _)) = self.recorded.samples {
                let expected = step * (current.times.len() as f64 - current.before as f64);
                if (t - expected).abs() > self.unit.tolerance(step, SAME_TIME) {
                    let message = format!("time {t} s, expected {expected} s: rows are {step} s apart (time.step)");
                    return Err(table.mistake(&message));
                }
                time = expected;
            }
            current.times.push(time);
            if self.recorded.is_motion || self.recorded.samples.is_some() {
                current.places.push(table.place());
            }
        }
        Ok(())
    }

    /// Ends the run before the row of a table, or at its end.
    pub(super) fn finish(&mut self, table: &Table) -> Result<()> {
        let Some(Current { label, mut parameters, mut times, inputs, outputs, last, places, .. }) = self.current.take()
        else {
            return Ok(());
        };
        let stop = self.recorded.stop;
        let run = named(&label);
        match last {
            None => return Err(table.mistake(&format!("{run} has no rows"))),
            Some(last) if last < stop - self.unit.tolerance(self.recorded.step, 0.0).max(1e-9 * stop) => {
                let here = table.place().unit();
                let expected = format!("expected {stop} s, the study's `time.stop`");
                return Err(table.mistake(&format!("{run} ends before this {here} at {last} s, {expected}")));
            }
            _ => {}
        }
        if self.recorded.is_motion {
            even_out(table, &run, &mut times, &places)?;
        }
        if !self.recorded.inputs.is_empty() {
            let rows = times.partition_point(|time| *time <= stop * (1.0 + SAME_TIME));
            let [inputs, outputs] = [(&inputs, self.recorded.inputs.len()), (&outputs, self.recorded.outputs.len())]
                .map(|(values, width)| &values[..rows * width]);
            let mut hasher = DefaultHasher::new();
            let numbers = parameters.iter().chain(&times[..1]).chain(inputs).chain(outputs);
            numbers.for_each(|number| number.to_bits().hash(&mut hasher));
            if let Some(other) = self.recordings.insert(hasher.finish(), run.clone()) {
                let expected = "runs must differ, or tests repeat training runs";
                return Err(table.mistake(&format!("{run} has the same rows as {other}: {expected}")));
            }
        }
        if *self.shared_times != *times {
            self.shared_times = times.into();
        }
        if !self.recorded.inputs.is_empty() {
            parameters.extend_from_slice(&outputs[..self.recorded.outputs.len()]);
            parameters.extend(self.recorded.inputs.iter().map(|input| input.start));
        }
        if self.recorded.samples.is_some() {
            self.origins.push((table.path().to_owned(), places));
        }
        self.finished.push(Run { inputs, parameters, times: Arc::clone(&self.shared_times), outputs });
        Ok(())
    }

    /// Refuses outliers, unless the study keeps them.
    pub(super) fn refuse_outliers(&self) -> Result<()> {
        let outputs = self.recorded.outputs.len();
        let found = if self.recorded.keeps_outliers { None } else { outliers::find(&self.finished, outputs) };
        let Some(Outliers { output, rows, range: [low, high] }) = found else { return Ok(()) };
        let (run, row) = rows[0];
        let value = self.finished[run].outputs[row * outputs + output];
        let (path, places) = &self.origins[run];
        let count = if rows.len() == 1 { String::new() } else { format!(", the first of {}", rows.len()) };
        let name = &self.recorded.names.outputs[output];
        let message = format!(
            "column `{name}`: {} is an outlier{count}, all other rows are from {} to {}: correct it, or leave it out and \
             divide the record there into runs; `source.outliers = true` keeps it, if the component does that",
            exact(value),
            exact(low),
            exact(high)
        );
        Err(Error::Table { path: path.clone(), place: places[row], message })
    }

    /// Ends runs with inputs at the study's `time.stop`. A single one is cut into as many as it gives, each with the
    /// rows before it. If a record does not begin at rest, its first rows are the past of its first piece. Returns a
    /// notice about runs that do not begin at rest.
    pub(super) fn cut(&mut self) -> Option<String> {
        let (step, longest) = self.recorded.samples?;
        let first = self.finished.first()?;
        let steps = (self.recorded.stop / step).round() as usize;
        let is_record = self.finished.len() == 1;
        let given = first.times.partition_point(|time| *time < 0.0);
        let are_enough = first.times.len().saturating_sub(longest + 1) >= steps;
        let moves = is_record && given == 0 && are_enough && self.moves(first, longest);
        let before = if moves { longest } else { given };
        let pieces = if is_record { first.times.len().saturating_sub(before + 1) / steps } else { 1 };
        let widths = [self.recorded.inputs.len(), self.recorded.outputs.len()];
        let mut cut = Vec::new();
        for number in 0..pieces {
            let start = before + number * steps;
            let from = if number == 0 { 0 } else { start.saturating_sub(longest) };
            let rows = from..start + steps + 1;
            let [inputs, outputs] = [(&first.inputs, widths[0]), (&first.outputs, widths[1])]
                .map(|(values, width)| values[rows.start * width..rows.end * width].to_vec());
            let mut parameters = first.parameters.clone();
            let own = parameters.len() - widths[0] - widths[1];
            parameters[own..own + widths[1]].copy_from_slice(&outputs[..widths[1]]);
            let times = rows.map(|row| step * (row as f64 - start as f64)).collect();
            cut.push(Run { parameters, times, inputs, outputs });
        }
        self.finished.splice(..1, cut);
        if moves {
            let first = format!("its first {longest} rows are given, as what was before its first run");
            return Some(format!("the record does not begin at rest: {first}"));
        }
        if is_record { None } else { self.moving(longest) }
    }

    /// Warning if most runs of a table do not begin at rest.
    fn moving(&self, longest: usize) -> Option<String> {
        let from_zero = self.finished.iter().filter(|run| run.times[0] >= 0.0).take(TRIED);
        let (tried, moving) =
            from_zero.fold((0, 0), |(tried, moving), run| (tried + 1, moving + usize::from(self.moves(run, longest))));
        (2 * moving > tried).then(|| {
            format!(
                "{moving} of the first {tried} runs do not begin at rest, but are simulated from rest: add the rows before them, with \
                 negative times"
            )
        })
    }

    /// Returns true if the first rows of a record contradict rest before them. A linear function of past samples gives
    /// the next outputs, by least squares on the rows whose past is known. If outputs and inputs are assumed at rest
    /// before the first row, its errors in the first rows are then much larger.
    fn moves(&self, run: &Run, longest: usize) -> bool {
        let [inputs, outputs] = [self.recorded.inputs.len(), self.recorded.outputs.len()];
        let (rows, signals) = (run.times.len() - 1, outputs + inputs);
        // the rows must determine the function
        let most = (rows + 1) / (ROWS_OF_A_COLUMN * signals + 1);
        let order = longest.min(ORDER).min(most);
        if order < 2 {
            return false;
        }
        let starts: Vec<f64> = self.recorded.inputs.iter().map(|input| input.start).collect();
        let y = |k: usize| &run.outputs[k * outputs..][..outputs];
        let past = |k: usize| -> Vec<f64> {
            let of_outputs = (0..order).flat_map(|lag| y(k.saturating_sub(lag)));
            let of_inputs = (0..order)
                .flat_map(|lag| k.checked_sub(lag).map_or(&starts[..], |k| &run.inputs[k * inputs..][..inputs]));
            of_outputs.chain(of_inputs).copied().collect()
        };
        let columns = order * signals;
        let known: Vec<Vec<f64>> = (order - 1..rows).map(past).collect();
        let (means, scales) = scaling::of_columns(&known);
        let scaled = |row: &[f64], column: usize| match row.get(column) {
            Some(value) => (value - means[column]) / scales[column],
            None => 1.0,
        };
        let ridge = (RIDGE * known.len() as f64).sqrt();
        let matrix = DMatrix::from_fn(known.len() + columns, columns + 1, |row, column| match known.get(row) {
            Some(row) => scaled(row, column),
            None => f64::from(u8::from(row - known.len() == column)) * ridge,
        });
        let mut sides = DMatrix::from_fn(known.len() + columns, outputs, |row, output| match known.get(row) {
            Some(_) => y(row + order)[output] - y(row + order - 1)[output],
            None => 0.0,
        });
        let decomposition = matrix.qr();
        decomposition.q_tr_mul(&mut sides);
        let projected = sides.rows(0, columns + 1).into_owned();
        let Some(solution) = decomposition.r().solve_upper_triangular(&projected) else { return false };
        let errors = |k: usize, row: &[f64]| -> Vec<f64> {
            (0..outputs)
                .map(|output| {
                    let predicted = (0..=columns).map(|c| scaled(row, c) * solution[(c, output)]).sum::<f64>();
                    y(k + 1)[output] - y(k)[output] - predicted
                })
                .collect()
        };
        let mut squares = vec![0.0; outputs];
        for (row, k) in known.iter().zip(order - 1..) {
            squares.iter_mut().zip(errors(k, row)).for_each(|(sum, error)| *sum += error * error);
        }
        let usual: Vec<f64> = squares.iter().map(|sum| (sum / known.len() as f64).sqrt()).collect();
        (0..order - 1).any(|k| {
            let errors = errors(k, &past(k));
            errors.iter().zip(&usual).any(|(error, usual)| error.abs() > MUCH_LARGER * usual)
        })
    }
}

/// Sets the times of a motion's rows to equally spaced ones, from which they differ by rounding only.
fn even_out(table: &Table, run: &str, times: &mut [f64], places: &[Place]) -> Result<()> {
    if times.len() < 3 {
        return Ok(());
    }
    if let Some(step) = stamps::period(times) {
        times.iter_mut().enumerate().for_each(|(row, time)| *time = step * row as f64);
        return Ok(());
    }
    // stamps that drift have no single row
    let uneven = stamps::uneven(times);
    let row = uneven.map_or(times.len() - 1, |(row, _)| row);
    let (time, before) = (times[row], times[row - 1]);
    let expected = uneven.map_or_else(String::new, |(_, expected)| format!("expected {expected} s: "));
    let message =
        format!("time {time} s after {before} s in {run}, {expected}rows are to be equally far apart in time");
    Err(table.mistake_at(places[row], &message))
}
