//! Runs of a source's own equations, integrated here: what the source's runs would be without the error of its time step.

use super::{
    launch::{WorkerProcess, WorkerReply},
    worker::WorkerModel,
};
use crate::{Error, Result, dataset::Run, fmi::Workers};
use std::{sync::atomic::AtomicBool, time::Duration};

/// Most steps between two rows.
const MOST_STEPS: usize = 32;
/// Change of the outputs by steps of half the length, relative to the output's largest value, at which the integration is accurate enough.
const ACCURATE: f64 = 1e-6;
/// Change relative to the difference from the source's own run at which it is accurate enough.
const PART: f64 = 1e-3;

/// Runs with the same rows, whose equations one process evaluates together.
struct OwnEquations<'a> {
    process: &'a mut dyn WorkerProcess,
    time_limit: Duration,
    stop: &'a AtomicBool,
    runs: &'a [Run],
    /// Numbers of parameters, inputs, states, and outputs.
    counts: [usize; 4],
}

/// States and outputs of all runs, run by run.
type EquationRuns = Vec<Vec<f64>>;

/// Outputs of the source's own equations at the rows of runs, by Runge and Kutta's method of order 4 with as many steps as it needs: shape
/// `[times, outputs]` for each run. None if the equations cannot be evaluated all along, or the method does not converge.
///
/// # Errors
/// Those of a process that cannot be started, [`Error::Interrupted`].
pub fn integrate_own_equations(
    model: &WorkerModel,
    runs: &[Run],
    workers: Workers<'_>,
) -> Result<Option<EquationRuns>> {
    let Some(first) = runs.first().filter(|run| runs.iter().all(|other| other.times == run.times)) else {
        return Ok(None);
    };
    let Some(states) = model.driven().map(|driven| driven.states().len()).filter(|states| *states > 0) else {
        return Ok(None);
    };
    let inputs = first.inputs.len() / first.times.len().max(1);
    let outputs = first.outputs.len() / first.times.len().max(1);
    let (counts, time_limit) = ([model.parameters(), inputs, states, outputs], model.time_limit());
    model.with_equations(workers, |process| {
        OwnEquations { process, time_limit, stop: workers.stop, runs, counts }.converged()
    })
}

impl OwnEquations<'_> {
    /// The outputs with a number of steps of which half gives the same outputs.
    fn converged(&mut self) -> Result<Option<EquationRuns>> {
        let mut coarse: Option<EquationRuns> = None;
        let mut steps = 1;
        while steps <= MOST_STEPS {
            let Some(fine) = self.integrate(steps)? else { return Ok(None) };
            if coarse.is_some_and(|coarse| self.has_converged(&coarse, &fine)) {
                return Ok(Some(fine));
            }
            steps *= 2;
            coarse = Some(fine);
        }
        Ok(None)
    }

    /// The outputs of all runs with some steps between two rows; none if the equations cannot be evaluated.
    fn integrate(&mut self, steps: usize) -> Result<Option<EquationRuns>> {
        let [parameters, _, states, _] = self.counts;
        let times = self.runs[0].times.clone();
        let mut y: Vec<f64> =
            self.runs.iter().flat_map(|run| run.parameters[parameters..][..states].iter().copied()).collect();
        let mut outputs = vec![Vec::new(); self.runs.len()];
        for row in 0..times.len() {
            let Some(mut rates) = self.evaluate(row, 0.0, &y, Some(&mut outputs))? else { return Ok(None) };
            if row + 1 == times.len() {
                break;
            }
            let h = (times[row + 1] - times[row]) / steps as f64;
            for step in 0..steps {
                let at = |part: f64| (step as f64 + part) / steps as f64;
                let moved = |by: f64, rates: &[f64]| y.iter().zip(rates).map(|(y, rate)| y + by * rate).collect();
                if step > 0 {
                    let Some(found) = self.evaluate(row, at(0.0), &y, None)? else { return Ok(None) };
                    rates = found;
                }
                let middle: Vec<f64> = moved(0.5 * h, &rates);
                let Some(second) = self.evaluate(row, at(0.5), &middle, None)? else { return Ok(None) };
                let middle: Vec<f64> = moved(0.5 * h, &second);
                let Some(third) = self.evaluate(row, at(0.5), &middle, None)? else { return Ok(None) };
                let end: Vec<f64> = moved(h, &third);
                let Some(fourth) = self.evaluate(row, at(1.0), &end, None)? else { return Ok(None) };
                for (k, y) in y.iter_mut().enumerate() {
                    *y += h / 6.0 * (rates[k] + 2.0 * (second[k] + third[k]) + fourth[k]);
                }
            }
        }
        Ok(Some(outputs))
    }

    /// Derivatives of the states of all runs at a part of the way from a row to the next one, and on request their outputs; none if they
    /// cannot be evaluated.
    fn evaluate(
        &mut self,
        row: usize,
        part: f64,
        states: &[f64],
        outputs: Option<&mut EquationRuns>,
    ) -> Result<Option<Vec<f64>>> {
        let [parameters, inputs, count, width] = self.counts;
        let mut request = Vec::new();
        for (run, states) in self.runs.iter().zip(states.chunks(count)) {
            request.extend_from_slice(&run.parameters[..parameters]);
            let next = (row + 1).min(run.times.len() - 1);
            let value = |row: usize, input: usize| run.inputs[row * inputs + input];
            // inputs are linear between two rows
            request
                .extend((0..inputs).map(|input| value(row, input) + part * (value(next, input) - value(row, input))));
            request.extend_from_slice(states);
        }
        let values = match self.process.run(&request, self.time_limit, self.stop) {
            WorkerReply::Done(values) => values,
            WorkerReply::Stopped => return Err(Error::Interrupted),
            WorkerReply::Failed(_) | WorkerReply::TimedOut => return Ok(None),
        };
        let per_run = values.len() / self.runs.len();
        if per_run < count + width || values.iter().any(|value| !value.is_finite()) {
            return Ok(None);
        }
        if let Some(outputs) = outputs {
            for (outputs, values) in outputs.iter_mut().zip(values.chunks(per_run)) {
                outputs.extend_from_slice(&values[count..count + width]);
            }
        }
        Ok(Some(values.chunks(per_run).flat_map(|values| values[..count].iter().copied()).collect()))
    }

    /// Returns true if shorter steps change nothing that matters.
    fn has_converged(&self, coarse: &EquationRuns, fine: &EquationRuns) -> bool {
        let width = self.counts[3];
        let largest =
            |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |largest: f64, value| largest.max(value.abs()));
        let of_run = |((run, coarse), fine): ((&Run, &Vec<f64>), &Vec<f64>)| {
            (0..width).all(|output| {
                let column = |values: &[f64]| values.iter().skip(output).step_by(width).copied().collect::<Vec<f64>>();
                let (source, coarse, fine) = (column(&run.outputs), column(coarse), column(fine));
                let size = largest(&mut fine.iter().copied());
                let change = largest(&mut coarse.iter().zip(&fine).map(|(a, b)| a - b));
                let difference = largest(&mut source.iter().zip(&fine).map(|(a, b)| a - b));
                change <= (ACCURATE * size).max(PART * difference)
            })
        };
        self.runs.iter().zip(coarse).zip(fine).all(of_run)
    }
}
