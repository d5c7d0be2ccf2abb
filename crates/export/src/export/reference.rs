//! The reference result in every FMU: a receiver can repeat its run to check that the FMU is complete and computes
//! correctly.
//!
//! Two files in `extra/org.metafmu/`, the path that both versions of the standard reserve for additional data:
//! `reference_options.json` has the options of the run, `reference_result.csv` the outputs.

use super::describe::nominal;
use crate::table::header_field;
use indexmap::IndexMap;
use metafmu_runtime::{CommunicationStep, Drive, Evaluator, Integration, Precision, Role, Surrogate};
use serde::{Deserialize, Serialize};
use std::fmt::Write;

/// Archive entry with the options of the reference run.
pub const OPTIONS_FILE: &str = "extra/org.metafmu/reference_options.json";
/// Archive entry with time and outputs of that run.
pub const RESULT_FILE: &str = "extra/org.metafmu/reference_result.csv";

/// Rows after the first are at most as many.
const MAX_STEPS: f64 = 100.0;
/// Processors round differently: largest difference relative to an output's nominal value.
const DOUBLE_TOLERANCE: f64 = 1e-9;
/// Largest difference for networks that compute in single precision, relative to an output's nominal value.
const SINGLE_TOLERANCE: f64 = 1e-4;
/// Largest difference of two predicted standard deviations by rounding, relative to the smallest one: a variance is at least four times its rounding error.
const STD_ROUNDING: f64 = 0.25;

/// Options of the reference run. Inputs and parameters keep their start values throughout.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceOptions {
    /// Start time, in seconds.
    pub start_time: f64,
    /// Stop time, in seconds.
    pub stop_time: f64,
    /// Communication step size, in seconds.
    pub step_size: f64,
    /// Start values of parameters and inputs.
    pub start_values: IndexMap<String, f64>,
    /// Largest difference of each output that is no sign of a mistake.
    pub tolerances: IndexMap<String, f64>,
    /// Largest error of fixed solver steps in each output; model exchange is free of it. Empty with error control.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub solver_errors: IndexMap<String, f64>,
}

/// Both files: options as JSON and result as CSV, which ends where a motion cannot be computed any more.
pub fn reference(surrogate: &Surrogate) -> (String, String) {
    let inputs = surrogate.inputs();
    let time_step = surrogate.metadata().time_step;
    let time = surrogate.time_column().map(|column| &inputs[column]);
    let without_time = if surrogate.program().has_memory() { MAX_STEPS * time_step } else { time_step };
    let (start, stop) = time.map_or((0.0, without_time), |time| (time.min, time.max));
    let stride = ((stop - start) / time_step / MAX_STEPS).ceil().max(1.0);
    let step = stride * time_step;
    let steps = ((stop - start) / step + 1e-9).floor() as usize;
    // away from start values and ends of ranges, each at another share: variables that are mixed up are noticed
    let mut point: Vec<f64> = inputs
        .iter()
        .enumerate()
        .map(|(column, input)| {
            let share = 0.15 + 0.7 * (0.618_033_988_749_894_9 * (column + 1) as f64).fract();
            match input.nominal_values() {
                // the first one is mostly the start value
                Some(values) => values[1 + (share * (values.len() - 1) as f64) as usize],
                None => input.min + share * (input.max - input.min),
            }
        })
        .collect();
    let settable = inputs.iter().zip(&point).filter(|(input, _)| input.role != Role::Time);
    let tolerance = match surrogate.metadata().precision {
        Precision::Double => DOUBLE_TOLERANCE,
        Precision::Single => SINGLE_TOLERANCE,
    };
    let mut options = ReferenceOptions {
        start_time: start,
        stop_time: start + steps as f64 * step,
        step_size: step,
        start_values: settable.map(|(input, value)| (input.name.clone(), *value)).collect(),
        tolerances: surrogate
            .outputs()
            .iter()
            .map(|output| {
                let rounding = if output.std_of.is_some() { STD_ROUNDING * output.min } else { 0.0 };
                (output.name.clone(), tolerance * nominal(output.min, output.max) + rounding)
            })
            .collect(),
        solver_errors: IndexMap::new(),
    };
    let evaluator = Evaluator::new(surrogate);
    point.resize(evaluator.columns(), 0.0);
    let times: Vec<f64> = (0..=steps).map(|row| start + row as f64 * step).collect();
    let rows = rows(surrogate, &evaluator, &point, (&times, step));
    options.stop_time = times[rows.len() - 1];
    if let Some(Integration::Fixed { .. }) = surrogate.program().integration() {
        let exact = evaluator.with_integration(Integration::ErrorControlled { tolerance: EXACT, longest: step });
        let exact = self::rows(surrogate, &exact, &point, (&times, step));
        for (column, output) in surrogate.outputs().iter().enumerate() {
            let errors = rows.iter().zip(&exact).map(|(row, exact)| (row[column] - exact[column]).abs());
            options.solver_errors.insert(output.name.clone(), errors.fold(0.0, f64::max));
        }
    }
    let names: Vec<String> = surrogate.outputs().iter().map(|output| header_field(&output.name)).collect();
    let mut csv = format!("time,{}\n", names.join(","));
    for (now, row) in times.iter().zip(&rows) {
        // writing to a string does not fail
        let _ = write!(csv, "{now}");
        row.iter().for_each(|value| _ = write!(csv, ",{value}"));
        csv.push('\n');
    }
    // plain data with string keys: serialization cannot fail
    let json = serde_json::to_string_pretty(&options).unwrap_or_default();
    (json + "\n", csv)
}

/// Solver tolerance of the solution with which fixed steps are compared.
const EXACT: f64 = 1e-10;

/// Outputs at `times`, `step` apart, up to the last time point that can be computed; at least one row.
fn rows(surrogate: &Surrogate, evaluator: &Evaluator, point: &[f64], (times, step): (&[f64], f64)) -> Vec<Vec<f64>> {
    let (mut evaluator, mut results) = (evaluator.clone(), vec![0.0; evaluator.results()]);
    let mut point = point.to_vec();
    evaluator.start(&mut point);
    let constant = vec![0.0; point.len()];
    let mut rows = Vec::new();
    for (row, now) in times.iter().enumerate() {
        if let Some(column) = surrogate.time_column() {
            point[column] = *now;
        }
        let drive = Drive { rates: [&constant, &constant], clamp: None };
        if row > 0 && evaluator.advance(&mut point, CommunicationStep::of(step), drive).is_err() {
            break;
        }
        evaluator.evaluate(&point, &mut results);
        rows.push(results[..surrogate.outputs().len()].to_vec());
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;

    #[test]
    fn a_reference_covers_the_time_with_few_rows_inside_the_ranges() {
        let surrogate = example::surrogate();
        let (json, csv) = reference(&surrogate);
        let options: ReferenceOptions = serde_json::from_str(&json).unwrap();
        assert_eq!((options.start_time, options.stop_time, options.step_size), (0.0, 2.0, 0.02));
        assert_eq!(options.start_values.keys().collect::<Vec<_>>(), ["length", "speed"]);
        for (input, value) in surrogate.inputs().iter().zip(options.start_values.values()) {
            assert!(input.min < *value && *value < input.max && *value != input.start, "{}", input.name);
        }
        let (encoded, _) = reference(&example::encoded(&surrogate));
        let encoded: ReferenceOptions = serde_json::from_str(&encoded).unwrap();
        assert!([0.1, 0.2].contains(&encoded.start_values["length"]), "a listed value, and not the start");
        assert_eq!(csv.lines().next(), Some("time,angle,velocity"));
        assert_eq!(csv.lines().count(), 102);
        assert!(csv.lines().last().unwrap().starts_with("2,"), "{csv}");
    }
}
