//! Repeats the reference run inside an FMU of metafmu and compares the results.

use crate::{
    Result,
    export::reference::{OPTIONS_FILE, RESULT_FILE, ReferenceOptions},
    fmi::{
        Archive, Fmu, InterfaceKind, SimulationOptions, simulate,
        validate::{Area, Notes},
    },
};
use metafmu_runtime::BuiltIn;

/// Largest reference that is read.
const MAX_SIZE: u64 = 64 << 20;

/// The reference run of an FMU.
pub struct Reference {
    options: ReferenceOptions,
    names: Vec<String>,
    rows: Vec<Vec<f64>>,
}

/// The reference inside, if there is one, or its problem.
pub fn read(archive: &mut Archive) -> std::result::Result<Option<Reference>, String> {
    if !archive.contains(OPTIONS_FILE) && !archive.contains(RESULT_FILE) {
        return Ok(None);
    }
    parse(archive).map(Some)
}

fn parse(archive: &mut Archive) -> std::result::Result<Reference, String> {
    let mut text = |name: &str| archive.read(name, MAX_SIZE).map_err(|error| error.to_string());
    let options = serde_json::from_slice(&text(OPTIONS_FILE)?).map_err(|error| format!("`{OPTIONS_FILE}`: {error}"))?;
    let result = text(RESULT_FILE)?;
    let wrong = |error: csv::Error| format!("`{RESULT_FILE}`: {error}");
    let mut reader = csv::Reader::from_reader(result.as_slice());
    let names = reader.headers().map_err(wrong)?.iter().skip(1).map(str::to_owned).collect();
    let rows = reader.deserialize().collect::<std::result::Result<Vec<Vec<f64>>, _>>().map_err(wrong)?;
    Ok(Reference { options, names, rows })
}

/// Reports the first difference.
pub fn check(fmu: &Fmu, reference: &Reference, report: &mut Notes) {
    let interface = fmu.interface();
    report.doing("the reference run");
    match compare(fmu, reference) {
        Ok(None) => {}
        Ok(Some(problem)) => report.problem(Area::Behavior, format!("{interface}, the reference run: {problem}")),
        Err(error) => report.problem(Area::Behavior, format!("{interface}, the reference run: {error}")),
    }
}

/// Part of a tolerance that the host's solver around an FMU with states takes, in multiples of it.
const SOLVER: f64 = 1e3;
/// Tolerance of that solver.
const SOLVER_TOLERANCE: f64 = 1e-11;
/// Steps of that solver between two rows, at least. In model exchange nothing but the host's step sees a force that acts for a short time.
const STEPS_OF_ROW: usize = 32;

fn compare(fmu: &Fmu, Reference { options, names, rows }: &Reference) -> Result<Option<String>> {
    let instance = fmu.instantiate("reference", true)?;
    let is_solved =
        fmu.interface() == InterfaceKind::ModelExchange && !fmu.description().structure.derivatives.is_empty();
    let in_domain = BuiltIn::InDomain.name();
    let watched =
        is_solved && fmu.description().variable(in_domain).is_some() && !names.iter().any(|name| name == in_domain);
    let steps = if is_solved { STEPS_OF_ROW } else { 1 };
    let table = simulate(
        &instance,
        &SimulationOptions {
            start: Some(options.start_time),
            stop: Some(options.stop_time),
            step: Some(options.step_size / steps as f64),
            start_values: options.start_values.clone().into_iter().collect(),
            record: names.iter().cloned().chain(watched.then(|| in_domain.to_owned())).collect(),
            tolerance: is_solved.then_some(SOLVER_TOLERANCE),
            ..SimulationOptions::default()
        },
    )?;
    let last = table.rows.len().saturating_sub(1);
    let of_rows = table.rows.iter().enumerate().filter(|(index, _)| index.is_multiple_of(steps) || *index == last);
    let found: Vec<&Vec<f64>> = of_rows.map(|(_, row)| row).collect();
    if found.len() != rows.len() {
        return Ok(Some(format!("{} rows, expected {}", found.len(), rows.len())));
    }
    let domain_column = table.columns.iter().position(|column| column.name == in_domain).filter(|_| is_solved);
    for (found, expected) in found.into_iter().zip(rows) {
        // outside, a motion may pass points at which equations are singular: two solvers need not agree from there on
        if domain_column.is_some_and(|column| found[column] == 0.0) {
            break;
        }
        let Some((time, expected)) = expected.split_first() else { continue };
        for (name, expected) in names.iter().zip(expected) {
            let column = table.columns.iter().position(|column| column.name == *name);
            let found = column.and_then(|column| found.get(column)).copied().unwrap_or(f64::NAN);
            let tolerance = options.tolerances.get(name).copied().unwrap_or(0.0);
            let of_solver = 2.0 * options.solver_errors.get(name).copied().unwrap_or(0.0);
            let tolerance = if is_solved { SOLVER * tolerance + of_solver } else { tolerance };
            // written so that NaN is wrong
            let right = (found - expected).abs() <= tolerance;
            if !right {
                return Ok(Some(format!("\"{name}\" is {found} at {time} s, expected {expected}")));
            }
        }
    }
    Ok(None)
}
