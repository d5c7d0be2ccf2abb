//! Limits of memory and computing time.

use super::{
    Method, Study,
    limits::{MAX_RUNS, MAX_VARIABLES},
};
use crate::diagnostics::{Problems, numbers::counted};

/// Rows of all runs together.
const MAX_ROWS: f64 = 1e9;

/// Bytes of the outputs of all rows.
const MAX_BYTES: f64 = 64e9;

/// Numbers of runs and rows that are too many, by dotted key.
pub(super) fn problems(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let variables =
        [("parameters", study.parameters.len()), ("inputs", study.inputs.len()), ("outputs", study.outputs.len())];
    for (key, count) in variables.into_iter().filter(|(_, count)| *count > MAX_VARIABLES) {
        problems.add(key, format!("{count} {key}, expected at most {MAX_VARIABLES}"));
    }
    let train_runs = study.train_runs();
    let planned = match study.sampling.method {
        Some(Method::Mesh) => "sampling.levels",
        Some(Method::List) => "sampling.file",
        _ => "sampling.runs",
    };
    let target = study.target.map_or(0, |target| target.max_runs);
    let counts = [
        (planned, train_runs),
        ("sampling.test_runs", study.sampling.test_runs as u64),
        ("bounds.runs", study.calibration_runs() as u64),
        ("target.max_runs", target as u64),
    ];
    for (key, runs) in counts.into_iter().filter(|(_, runs)| *runs > MAX_RUNS as u64) {
        let found =
            if runs == u64::MAX { "more runs than can be counted".into() } else { counted(runs as usize, "run") };
        problems.add(key, format!("{found}, expected at most {MAX_RUNS}"));
    }
    // rows of recorded runs are what the tables have
    if !problems.is_empty() || study.source.is_recorded() {
        return problems;
    }
    let runs = train_runs.max(target as u64) + (study.sampling.test_runs + study.calibration_runs()) as u64;
    let rows = runs as f64 * (study.time.stop * (1.0 + study.time.margin) / study.time.step + 1.0);
    let bytes = 8.0 * rows * study.outputs.len() as f64;
    if rows > MAX_ROWS {
        problems.add("sampling", format!("{rows:.3e} rows of all runs, expected at most a billion"));
    } else if bytes > MAX_BYTES {
        let (count, gigabytes) = (study.outputs.len(), bytes / 1e9);
        let message = format!("{rows:.3e} rows of {count} outputs are {gigabytes:.0} GB, expected at most 64 GB");
        problems.add("sampling", message);
    }
    problems
}
