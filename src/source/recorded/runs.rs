//! Rows on their way into runs, and what a run must be: rows in the order of time from zero to the end, in one place, of
//! parameters that no other run has.

use super::{super::list, Driven, Recorded};
use crate::{
    Error, Result,
    dataset::Run,
    diagnostics::Place,
    table::{
        Table,
        runs::{Labels, check_time, named},
        stamps::{self, Unit},
    },
};
use std::{
    collections::HashMap,
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
    labels: Labels,
    /// Where each point began.
    points: HashMap<Vec<u64>, Place>,
    /// Runs mostly share their times: the previous run's are kept to share them.
    shared_times: Arc<[f64]>,
    /// Of the stamps so far.
    unit: Unit,
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
    /// Where the rows of a motion are in the table.
    places: Vec<Place>,
}

impl<'a> Runs<'a> {
    pub(super) fn new(recorded: &'a Recorded, stop: &'a AtomicBool) -> Self {
        let (labels, points) = (Labels::default(), HashMap::new());
        Self {
            recorded,
            stop,
            finished: Vec::new(),
            current: None,
            labels,
            points,
            shared_times: Arc::new([]),
            unit: Unit::default(),
        }
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
            let values = list(names.iter().zip(&parameters).map(|(name, value)| format!("{name} = {value}")));
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
            let value = table.number(column)?;
            if let Some(&Driven { min, max, .. }) = self.recorded.inputs.get(index)
                && !(min..=max).contains(&value)
            {
                let name = &self.recorded.names.inputs[index];
                let message = format!("column `{name}`: {value}, expected {min} to {max}, the study's range");
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
            if self.recorded.is_motion {
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
        if *self.shared_times != *times {
            self.shared_times = times.into();
        }
        if !self.recorded.inputs.is_empty() {
            parameters.extend_from_slice(&outputs[..self.recorded.outputs.len()]);
            parameters.extend(self.recorded.inputs.iter().map(|input| input.start));
        }
        self.finished.push(Run { inputs, parameters, times: Arc::clone(&self.shared_times), outputs });
        Ok(())
    }

    /// Ends runs with inputs at the study's `time.stop`; a single one is cut into as many as it gives, each with the rows before it.
    pub(super) fn cut(&mut self) {
        let (Some((step, longest)), Some(first)) = (self.recorded.samples, self.finished.first()) else { return };
        let steps = (self.recorded.stop / step).round() as usize;
        let before = first.times.partition_point(|time| *time < 0.0);
        let pieces = if self.finished.len() == 1 { (first.times.len() - before - 1) / steps } else { 1 };
        let widths = [self.recorded.inputs.len(), self.recorded.outputs.len()];
        let piece = |number: usize| {
            let start = before + number * steps;
            let from = if number == 0 { 0 } else { start.saturating_sub(longest) };
            let rows = from..start + steps + 1;
            let time = |row: usize| step * (row as f64 - start as f64);
            let [inputs, outputs] = [(&first.inputs, widths[0]), (&first.outputs, widths[1])]
                .map(|(values, width)| values[rows.start * width..rows.end * width].to_vec());
            let mut parameters = first.parameters.clone();
            let own = parameters.len() - widths[0] - widths[1];
            parameters[own..own + widths[1]].copy_from_slice(&outputs[..widths[1]]);
            Run { parameters, times: rows.map(time).collect(), inputs, outputs }
        };
        let cut: Vec<Run> = (0..pieces).map(piece).collect();
        self.finished.splice(..1, cut);
    }
}

/// Makes the times of a motion's rows those of rows that are equally far apart, which they are but for rounding.
fn even_out(table: &Table, run: &str, times: &mut [f64], places: &[Place]) -> Result<()> {
    if times.len() < 3 {
        return Ok(());
    }
    if let Some(step) = stamps::period(times) {
        times.iter_mut().enumerate().for_each(|(row, time)| *time = step * row as f64);
        return Ok(());
    }
    // stamps that drift have no single row
    let (row, expected) = stamps::uneven(times).unwrap_or((times.len() - 1, f64::NAN));
    let (time, before) = (times[row], times[row - 1]);
    let expected = if expected.is_nan() { String::new() } else { format!("expected {expected} s: ") };
    let message =
        format!("time {time} s after {before} s in {run}, {expected}rows are to be equally far apart in time");
    Err(table.mistake_at(places[row].clone(), &message))
}
