//! Test runs whose motion leaves the domain of validity: rows from there on are no evidence of what the surrogate is inside.

use super::{Accuracy, roll_outs::divergence};
use crate::{
    dataset::{Dataset, Run},
    diagnostics::numbers::{counted, number},
    evaluation::RollOut,
};
use indexmap::IndexMap;
use metafmu_runtime::{Domain, Evaluator, Surrogate};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Accuracy on the rows before motions leave the domain, and where they leave it.
///
/// Rows after that are outside, and so is the error that they begin with if the motion returns. A run counts only if its roll-out agrees with the
/// truth up to and including the first row outside, to a tenth of each output's standard deviation. A surrogate that diverges from the truth inside
/// has not left the domain with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OutsideRows {
    /// Number of predicted rows from the exits on.
    pub rows: usize,
    /// First row outside of each run that leaves the domain, in the order of the runs.
    pub exits: Vec<DomainExit>,
    /// Accuracy on the rows before.
    pub inside: Box<Accuracy>,
}

/// First row of a run that is outside the domain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DomainExit {
    /// Index of the test run.
    pub run: usize,
    /// Its time, in seconds.
    pub time: f64,
    /// State or input that has left its range.
    pub variable: String,
    /// Unit of the variable.
    pub unit: String,
    /// Value of the variable.
    pub value: f64,
    /// Range of the variable.
    pub range: [f64; 2],
    /// All states.
    pub states: IndexMap<String, f64>,
    /// Parameters of the run, and the initial values of its states.
    pub parameters: Vec<f64>,
    /// Dead point of the mechanism: value of the variable at which the coordinates stop to determine the configuration; none if no dead point is near.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dead_point: Option<f64>,
}

impl OutsideRows {
    /// Measures predictions of test runs; none if no run leaves the domain, or the surrogate is no continuous-time model.
    pub(super) fn of(surrogate: &Surrogate, test: &Dataset, predictions: &[Vec<f64>]) -> Option<Self> {
        surrogate.program().integration()?;
        let (evaluator, domain) = (Evaluator::new(surrogate), Domain::of(surrogate));
        let ranges: Vec<f64> = surrogate.outputs().iter().map(|output| output.max - output.min).collect();
        let exit = |(number, (run, found)): (usize, (&Run, &Vec<f64>))| {
            let (row, exit) = first_outside(surrogate, (&evaluator, &domain), (number, run))?;
            (divergence(run, found, 0, &ranges) > run.times[row]).then_some((row, exit))
        };
        let exits: Vec<Option<(usize, DomainExit)>> =
            test.runs.par_iter().zip(predictions).enumerate().map(exit).collect();
        if exits.iter().all(Option::is_none) {
            return None;
        }
        let width = test.outputs.len();
        let rows_of = |(run, exit): (&Run, &Option<(usize, DomainExit)>)| {
            // the first row has the initial states, which are given
            exit.as_ref().map_or(run.times.len(), |(row, _)| (*row).max(1))
        };
        let rows: Vec<usize> = test.runs.iter().zip(&exits).map(rows_of).collect();
        let runs = test.runs.iter().zip(&rows).map(|(run, rows)| run.beginning(*rows, width)).collect();
        let inside = Dataset { runs, ..test.clone() };
        let predictions: Vec<Vec<f64>> =
            predictions.iter().zip(&rows).map(|(found, rows)| found[..rows * width].to_vec()).collect();
        Some(Self {
            rows: test.row_count() - rows.iter().sum::<usize>(),
            exits: exits.into_iter().flatten().map(|(_, exit)| exit).collect(),
            inside: Box::new(Accuracy::of_all_rows(surrogate, &inside, &predictions)),
        })
    }

    /// Share of the predicted rows that are inside.
    pub fn share_inside(&self) -> f64 {
        let inside = self.inside.test_rows as f64;
        inside / (inside + self.rows as f64)
    }

    /// Number of rows and runs outside, and the first exit, as text.
    pub fn describe(&self) -> String {
        let (rows, runs) = (self.rows + self.inside.test_rows, self.inside.test_runs);
        let first = self.exits.iter().min_by(|a, b| a.time.total_cmp(&b.time));
        let first = first.map_or(String::new(), |exit| format!(": {}", exit.describe()));
        let (outside, leaving) = (self.rows, self.exits.len());
        let verb = if leaving == 1 { "leaves" } else { "leave" };
        format!(
            "{leaving} of {} {verb} the domain, {outside} of {} are outside{first}",
            counted(runs, "test run"),
            counted(rows, "row")
        )
    }
}

impl DomainExit {
    /// Run, time, variable and dead point as text.
    pub fn describe(&self) -> String {
        let Self { run, time, variable, unit, value, range: [min, max], dead_point, .. } = self;
        let with_unit = |value: f64| if unit.is_empty() { number(value) } else { format!("{} {unit}", number(value)) };
        let dead_point = dead_point.map_or(String::new(), |place| {
            format!(
                "; the mechanism has a dead point at {}, where this coordinate stops to determine it",
                with_unit(place)
            )
        });
        format!(
            "run {run} at t = {} s by {variable} = {}, range {} to {}{dead_point}",
            number(*time),
            with_unit(*value),
            number(*min),
            with_unit(*max)
        )
    }
}

/// First row of a run at which a column is outside its range.
fn first_outside(
    surrogate: &Surrogate,
    (evaluator, domain): (&Evaluator, &Domain),
    (number, run): (usize, &Run),
) -> Option<(usize, DomainExit)> {
    let mut roll_out = RollOut::along(surrogate, evaluator, run);
    let inputs = surrogate.inputs().len();
    for row in 0..run.times.len() {
        let (point, _) = roll_out.at(row)?;
        let Some(column) = (0..domain.columns()).find(|&column| !domain.contains(column, point[column])) else {
            continue;
        };
        let (variable, unit, range) = match column.checked_sub(inputs).map(|state| &surrogate.states()[state]) {
            Some(state) => (&state.name, &state.unit, state.range.unwrap_or([f64::MIN, f64::MAX])),
            None => {
                let input = &surrogate.inputs()[column];
                (&input.name, &input.unit, [input.min, input.max])
            }
        };
        let states = surrogate.states().iter().zip(&point[inputs..]);
        let exit = DomainExit {
            run: number,
            time: run.times[row],
            variable: variable.clone(),
            unit: unit.clone(),
            value: point[column],
            range,
            states: states.map(|(state, value)| (state.name.clone(), *value)).collect(),
            parameters: run.parameters.clone(),
            dead_point: None,
        };
        return Some((row, exit));
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variable::SourceVariable;
    use metafmu_example as example;
    use std::sync::Arc;

    #[test]
    fn rows_from_an_exit_on_are_left_out_if_the_truth_agrees_until_then() {
        // its trolley has a range of 5 m in both directions
        let surrogate = example::crane();
        let evaluator = Evaluator::new(&surrogate);
        let times: Arc<[f64]> = (0..=100).map(|row| 0.05 * f64::from(row)).collect();
        let width = surrogate.outputs().len();
        let run = |speed: f64| {
            let (parameters, inputs) = (vec![1.2, 0.0, 0.0, speed, 0.0], vec![0.0; times.len()]);
            let run = Run { inputs, parameters, times: times.clone(), outputs: Vec::new() };
            let outputs = RollOut::along(&surrogate, &evaluator, &run).predictions();
            Run { outputs, ..run }
        };
        let variable = |name: &str| SourceVariable::new(name, "", "");
        let test_of = |runs: Vec<Run>| Dataset {
            inputs: vec![variable("force")],
            parameters: ["rope", "x", "theta", "speed", "rate"].map(variable).to_vec(),
            outputs: surrogate.outputs().iter().map(|output| variable(&output.name)).collect(),
            runs,
        };
        let mut runs = vec![run(0.1), run(8.0)];
        let trolley: Vec<f64> = runs[1].outputs.iter().step_by(width).copied().collect();
        let row = trolley.iter().position(|x| *x > 5.0).unwrap();
        // the source stops at a wall a little beyond
        let rest = runs[1].outputs[(row + 1) * width..].chunks_mut(width);
        rest.for_each(|outputs| outputs[0] = 5.2);
        let accuracy = Accuracy::of(&surrogate, &test_of(runs.clone()));
        let name = &surrogate.outputs()[0].name;
        let outside = accuracy.outside.unwrap();
        assert_eq!((outside.rows, outside.inside.test_rows), (101 - row, 101 + row));
        let exit = &outside.exits[0];
        assert_eq!((outside.exits.len(), exit.run, exit.time), (1, 1, times[row]));
        assert_eq!((exit.variable.as_str(), exit.range), ("trolley.position", [-5.0, 5.0]));
        assert!((exit.value - trolley[row]).abs() < 1e-12, "{exit:?}");
        assert!(accuracy.outputs[name].max_abs_error > 1.0 && outside.inside.outputs[name].max_abs_error < 1e-12);
        let text = outside.describe();
        assert!(text.starts_with("1 of 2 test runs leaves the domain, ") && text.contains("range -5 to 5 m"), "{text}");
        // a surrogate that diverges from a truth inside has not left the domain with it
        runs[1].outputs.chunks_mut(width).skip(row / 2).for_each(|outputs| outputs[0] = 0.0);
        assert_eq!(Accuracy::of(&surrogate, &test_of(runs)).outside, None);
    }
}
