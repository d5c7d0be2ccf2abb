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

/// Share of the rows that must be known for a comparison.
const ENOUGH: f64 = 0.5;

/// Result of the integration of a source's own equations along runs.
pub enum OwnRuns {
    /// Outputs of each run, `[rows, outputs]`, up to the row at which the integration stops to converge or to be possible.
    Integrated(Vec<Vec<f64>>),
    /// The integration was not possible, for this reason.
    Unable(&'static str),
}

/// Runs with the same rows, whose equations one process evaluates together.
struct OwnEquations<'a> {
    process: &'a mut dyn WorkerProcess,
    time_limit: Duration,
    stop: &'a AtomicBool,
    runs: &'a [Run],
    /// Numbers of parameters, inputs, states, and outputs.
    counts: [usize; 4],
}

/// Outputs of all runs, run by run, which are NaN once a run has ended.
type EquationRuns = Vec<Vec<f64>>;

/// Integrates the source's own equations along runs, by Runge and Kutta's method of order 4 with as many steps as it needs.
///
/// # Errors
/// Those of a process that cannot be started, [`Error::Interrupted`].
pub fn integrate_own_equations(model: &WorkerModel, runs: &[Run], workers: Workers<'_>) -> Result<OwnRuns> {
    let Some(first) = runs.first().filter(|run| runs.iter().all(|other| other.times == run.times)) else {
        return Ok(OwnRuns::Unable("the test runs have different rows"));
    };
    let Some(states) = model.driven().map(|driven| driven.states().len()).filter(|states| *states > 0) else {
        return Ok(OwnRuns::Unable("the source offers none"));
    };
    let inputs = first.inputs.len() / first.times.len().max(1);
    let outputs = first.outputs.len() / first.times.len().max(1);
    let (counts, time_limit) = ([model.parameters(), inputs, states, outputs], model.time_limit());
    let result = model.with_equations(workers, |process| {
        OwnEquations { process, time_limit, stop: workers.stop, runs, counts }.converged()
    })?;
    Ok(result.unwrap_or(OwnRuns::Unable("a process of the source makes only one run")))
}

impl OwnEquations<'_> {
    /// The outputs with a number of steps of which half gives the same outputs.
    fn converged(&mut self) -> Result<OwnRuns> {
        const IMPOSSIBLE: OwnRuns = OwnRuns::Unable("the source could not evaluate them along the test runs");
        let (width, all_rows) = (self.counts[3], self.runs[0].times.len());
        let Some(mut known) = self.integrate(1)? else { return Ok(IMPOSSIBLE) };
        let mut rows = vec![0; self.runs.len()];
        let mut steps = 1;
        while steps < MOST_STEPS && rows.iter().any(|rows| *rows < all_rows) {
            steps *= 2;
            let Some(fine) = self.integrate(steps)? else { return Ok(IMPOSSIBLE) };
            rows = self.converged_rows(&known, &fine);
            known = fine;
        }
        if (rows.iter().sum::<usize>() as f64) < ENOUGH * (all_rows * rows.len()) as f64 {
            return Ok(OwnRuns::Unable("the integration does not converge on most of the rows"));
        }
        known.iter_mut().zip(&rows).for_each(|(outputs, rows)| outputs.truncate(rows * width));
        Ok(OwnRuns::Integrated(known))
    }

    /// The outputs of all runs with some steps between two rows; none if the source cannot evaluate the equations.
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
                let [begin, middle, end] = [0.0, 0.5, 1.0].map(|part| (step as f64 + part) / steps as f64);
                if step > 0 {
                    let Some(again) = self.evaluate(row, begin, &y, None)? else { return Ok(None) };
                    rates = again;
                }
                let trial = moved(&y, 0.5 * h, &rates);
                let Some(second) = self.evaluate(row, middle, &trial, None)? else { return Ok(None) };
                let trial = moved(&y, 0.5 * h, &second);
                let Some(third) = self.evaluate(row, middle, &trial, None)? else { return Ok(None) };
                let trial = moved(&y, h, &third);
                let Some(fourth) = self.evaluate(row, end, &trial, None)? else { return Ok(None) };
                for (k, y) in y.iter_mut().enumerate() {
                    *y += h / 6.0 * (rates[k] + 2.0 * (second[k] + third[k]) + fourth[k]);
                }
            }
        }
        Ok(Some(outputs))
    }

    /// Derivatives of the states of all runs at a part of the way from a row to the next one, and on request their outputs; none if the source
    /// cannot evaluate them. A run with a state or a value that is not finite has ended.
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
            let [before, after] = [row, next].map(|row| &run.inputs[row * inputs..][..inputs]);
            // inputs are linear between two rows
            request.extend(before.iter().zip(after).map(|(before, after)| before + part * (after - before)));
            // a run that has ended must not disturb the others: the source evaluates its initial states again
            let has_ended = states.iter().any(|state| !state.is_finite());
            request.extend_from_slice(if has_ended { &run.parameters[parameters..][..count] } else { states });
        }
        let mut values = match self.process.run(&request, self.time_limit, self.stop) {
            WorkerReply::Done(values) => values,
            WorkerReply::Stopped => return Err(Error::Interrupted),
            WorkerReply::Failed(_) | WorkerReply::TimedOut => return Ok(None),
        };
        let per_run = values.len() / self.runs.len();
        if per_run < count + width {
            return Ok(None);
        }
        for (values, states) in values.chunks_mut(per_run).zip(states.chunks(count)) {
            if values.iter().chain(states).any(|value| !value.is_finite()) {
                values.fill(f64::NAN);
            }
        }
        if let Some(outputs) = outputs {
            for (outputs, values) in outputs.iter_mut().zip(values.chunks(per_run)) {
                outputs.extend_from_slice(&values[count..count + width]);
            }
        }
        Ok(Some(values.chunks(per_run).flat_map(|values| values[..count].iter().copied()).collect()))
    }

    /// Number of the first rows of each run in which shorter steps change nothing that matters.
    fn converged_rows(&self, coarse: &EquationRuns, fine: &EquationRuns) -> Vec<usize> {
        let runs = self.runs.iter().zip(coarse.iter().zip(fine));
        runs.map(|(run, (coarse, fine))| converged_rows(&run.outputs, coarse, fine, self.counts[3])).collect()
    }
}

/// States after a step with these rates.
fn moved(states: &[f64], by: f64, rates: &[f64]) -> Vec<f64> {
    states.iter().zip(rates).map(|(state, rate)| state + by * rate).collect()
}

/// Number of the first rows in which no output changes by more than a part of its size, or of its difference from the source's own run, up to there.
fn converged_rows(source: &[f64], coarse: &[f64], fine: &[f64], width: usize) -> usize {
    let (mut sizes, mut differences) = (vec![0.0f64; width], vec![0.0f64; width]);
    let rows = source.chunks(width).zip(coarse.chunks(width).zip(fine.chunks(width)));
    for (row, (source, (coarse, fine))) in rows.enumerate() {
        for output in 0..width {
            sizes[output] = sizes[output].max(fine[output].abs());
            differences[output] = differences[output].max((source[output] - fine[output]).abs());
            let limit = (ACCURATE * sizes[output]).max(PART * differences[output]);
            let has_converged = (coarse[output] - fine[output]).abs() <= limit;
            if !has_converged {
                return row;
            }
        }
    }
    fine.len() / width
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Evaluates `y' = -100 y³` in a run that falls, and `y' = y²`, which has no solution after a second, in one that rises.
    struct Power;

    impl WorkerProcess for Power {
        fn run(&mut self, request: &[f64], _: Duration, _: &AtomicBool) -> WorkerReply {
            let rate = |y: f64| if y < 0.0 { -100.0 * y.powi(3) } else { y * y };
            WorkerReply::Done(request.iter().flat_map(|y| [rate(*y), *y]).collect())
        }

        fn finish(self: Box<Self>) {}
    }

    fn run_from(start: f64, rows: u32, step: f64) -> Run {
        let times: Arc<[f64]> = (0..rows).map(|row| step * f64::from(row)).collect();
        let outputs = vec![start; times.len()];
        Run { parameters: vec![start], times, inputs: Vec::new(), outputs }
    }

    fn integrated(runs: &[Run]) -> OwnRuns {
        let (mut process, stop) = (Power, AtomicBool::new(false));
        let counts = [0, 0, 1, 1];
        OwnEquations { process: &mut process, time_limit: Duration::MAX, stop: &stop, runs, counts }
            .converged()
            .unwrap()
    }

    #[test]
    fn rows_are_known_as_far_as_the_integration_converges() {
        // the first steps converge slowly in the run that falls, and the other one has no solution at its end
        let runs = [run_from(-1.0, 12, 0.1), run_from(1.0, 12, 0.1)];
        let OwnRuns::Integrated(known) = integrated(&runs) else { panic!("most of the rows are known") };
        assert!(known[0].len() == 12 && (8..=10).contains(&known[1].len()), "{known:?}");
        for (row, y) in known[0].iter().enumerate() {
            let exact = -1.0 / (1.0 + 20.0 * row as f64).sqrt();
            assert!((y - exact).abs() < 1e-3, "row {row}: {y}, expected {exact}");
        }
        for (row, y) in known[1].iter().enumerate() {
            let exact = 1.0 / (1.0 - 0.1 * row as f64);
            assert!((y - exact).abs() < 1e-2 * exact, "row {row}: {y}, expected {exact}");
        }
        let short = [run_from(1.0, 12, 0.5)];
        assert!(matches!(integrated(&short), OwnRuns::Unable(reason) if reason.contains("does not converge")));
    }

    #[test]
    fn rows_count_until_shorter_steps_change_an_output() {
        let fine = [1.0, 10.0, 2.0, 20.0, 3.0, f64::NAN];
        let near = [1.0, 10.0, 2.0 + 1e-6, 20.0, 3.0, f64::NAN];
        assert_eq!(converged_rows(&fine, &near, &fine, 2), 2);
        let far = [1.0, 10.0, 2.0 + 1e-5, 20.0, 3.0, 30.0];
        assert_eq!(converged_rows(&fine, &far, &fine, 2), 1);
        // an error is small beside a larger one of the source
        let source = [1.0, 10.0, 2.1, 20.0, 3.0, 30.0];
        assert_eq!(converged_rows(&source, &far, &fine, 2), 2);
    }
}
