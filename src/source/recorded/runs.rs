//! Rows on their way into runs, and what a run must be: rows in the order of time from zero to the end, in one place, of
//! parameters that no other run has.

use super::{super::list, Recorded};
use crate::{
    Error, Result,
    dataset::Run,
    diagnostics::Place,
    table::{
        Table,
        runs::{Labels, check_time, named},
    },
};
use std::{
    collections::HashMap,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

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
}

/// The run that is being read.
pub(super) struct Current {
    pub(super) label: String,
    pub(super) parameters: Vec<f64>,
    times: Vec<f64>,
    outputs: Vec<f64>,
    /// Time of the last row, those past the end included.
    last: Option<f64>,
}

/// Part of the time between two rows of a motion by which it may differ from that of the run's first two.
const UNIFORM: f64 = 1e-6;

impl<'a> Runs<'a> {
    pub(super) fn new(recorded: &'a Recorded, stop: &'a AtomicBool) -> Self {
        let (labels, points) = (Labels::default(), HashMap::new());
        Self { recorded, stop, finished: Vec::new(), current: None, labels, points, shared_times: Arc::new([]) }
    }

    /// Begins a run at the row of a table.
    pub(super) fn begin(&mut self, table: &Table, label: String, parameters: Vec<f64>) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(Error::Interrupted);
        }
        self.labels.begin(table, &label)?;
        // zeros of both signs are one point
        let point = parameters.iter().map(|value| (value + 0.0).to_bits()).collect();
        if let Some(before) = self.points.insert(point, table.place()).filter(|_| !self.recorded.is_motion) {
            let names = &self.recorded.names.parameters;
            let values = list(names.iter().zip(&parameters).map(|(name, value)| format!("{name} = {value}")));
            let message = format!("a second run with {values}, the first is in {before}: runs must differ");
            return Err(table.mistake(&message));
        }
        let (times, outputs) = (Vec::with_capacity(self.shared_times.len()), Vec::new());
        self.current = Some(Current { label, parameters, times, outputs, last: None });
        Ok(())
    }

    pub(super) fn row(&mut self, table: &mut Table, time: usize, outputs: &[usize]) -> Result<()> {
        let t = table.number(time)?;
        let Some(current) = &mut self.current else { return Ok(()) };
        let stop = self.recorded.stop;
        match current.last {
            None if t.abs() > 1e-9 * stop => {
                return Err(table.mistake(&format!("{} begins at {t} s, expected 0 s", named(&current.label))));
            }
            None => {}
            Some(last) => check_time(table, &current.label, last, t)?,
        }
        if self.recorded.is_motion
            && let ([first, second, ..], Some(last)) = (current.times.as_slice(), current.last)
            && ((t - last) - (second - first)).abs() > UNIFORM * (second - first)
        {
            let expected = format!("expected {} s: rows are to be equally far apart in time", last + second - first);
            return Err(table.mistake(&format!("time {t} s after {last} s in {}, {expected}", named(&current.label))));
        }
        current.last = Some(t);
        for &column in outputs {
            let value = table.number(column)?;
            if t <= stop * (1.0 + 1e-9) {
                current.outputs.push(value);
            }
        }
        if t <= stop * (1.0 + 1e-9) {
            current.times.push(t.clamp(0.0, stop));
        }
        Ok(())
    }

    /// Ends the run before the row of a table, or at its end.
    pub(super) fn finish(&mut self, table: &Table) -> Result<()> {
        let Some(Current { label, parameters, times, outputs, last }) = self.current.take() else { return Ok(()) };
        let stop = self.recorded.stop;
        let run = named(&label);
        match last {
            None => return Err(table.mistake(&format!("{run} has no rows"))),
            Some(last) if last < stop * (1.0 - 1e-9) => {
                let here = table.place().unit();
                let expected = format!("expected {stop} s, the study's `time.stop`");
                return Err(table.mistake(&format!("{run} ends before this {here} at {last} s, {expected}")));
            }
            _ => {}
        }
        if *self.shared_times != *times {
            self.shared_times = times.into();
        }
        self.finished.push(Run { inputs: Vec::new(), parameters, times: Arc::clone(&self.shared_times), outputs });
        Ok(())
    }
}
