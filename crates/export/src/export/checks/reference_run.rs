//! Repeats the reference run inside an FMU of metafmu and compares the results.

use crate::{
    Error, Result,
    export::reference::{OPTIONS_FILE, RESULT_FILE, ReferenceOptions},
    fmi::{
        Archive, Fmu, InterfaceKind, SimulationOptions, simulate,
        validate::{Area, Notes},
    },
};
use indexmap::IndexMap;
use metafmu_runtime::{BuiltIn, Role, Surrogate};
use std::fmt;

/// Largest reference that is read.
const MAX_SIZE: u64 = 64 << 20;

/// The reference run of an FMU.
pub struct Reference {
    options: ReferenceOptions,
    names: Vec<String>,
    rows: Vec<Vec<f64>>,
}

/// Reason why the reference run inside an FMU cannot be read.
#[derive(Debug)]
pub enum ReferenceError {
    /// One of its two files is missing, too large or damaged.
    Archive(Error),
    /// The options of the run.
    Options(serde_json::Error),
    /// The table of its result.
    Result(csv::Error),
}

impl fmt::Display for ReferenceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Archive(error) => error.fmt(f),
            Self::Options(error) => write!(f, "`{OPTIONS_FILE}`: {error}"),
            Self::Result(error) => write!(f, "`{RESULT_FILE}`: {error}"),
        }
    }
}

impl std::error::Error for ReferenceError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Archive(error) => Some(error),
            Self::Options(error) => Some(error),
            Self::Result(error) => Some(error),
        }
    }
}

/// The reference inside, if there is one, or its problem.
pub fn read(archive: &mut Archive) -> std::result::Result<Option<Reference>, ReferenceError> {
    if !archive.contains(OPTIONS_FILE) && !archive.contains(RESULT_FILE) {
        return Ok(None);
    }
    parse(archive).map(Some)
}

fn parse(archive: &mut Archive) -> std::result::Result<Reference, ReferenceError> {
    let options = archive.read(OPTIONS_FILE, MAX_SIZE).map_err(ReferenceError::Archive)?;
    let options = serde_json::from_slice(&options).map_err(ReferenceError::Options)?;
    let result = archive.read(RESULT_FILE, MAX_SIZE).map_err(ReferenceError::Archive)?;
    let mut reader = csv::Reader::from_reader(result.as_slice());
    let header = reader.headers().map_err(ReferenceError::Result)?;
    let names = header.iter().skip(1).map(str::to_owned).collect();
    let rows = reader.deserialize().collect::<std::result::Result<Vec<Vec<f64>>, _>>();
    Ok(Reference { options, names, rows: rows.map_err(ReferenceError::Result)? })
}

/// Reports the first difference. `surrogate`: the one inside, if it can be read.
pub fn check(fmu: &Fmu, reference: &Reference, surrogate: Option<&Surrogate>, report: &mut Notes) {
    let interface = fmu.interface();
    report.doing("the reference run");
    let is_solved = interface == InterfaceKind::ModelExchange && !fmu.description().structure.derivatives.is_empty();
    let difference = match is_solved {
        true => difference_of_solved(fmu, reference, surrogate),
        false => reference.repeat(fmu, Integrator::Fmu, None).map(|run| reference.difference(&run, None)),
    };
    match difference {
        Ok(None) => {}
        Ok(Some(problem)) => report.problem(Area::Behavior, format!("{interface}, the reference run: {problem}")),
        Err(error) => report.problem(Area::Behavior, format!("{interface}, the reference run: {error}")),
    }
}

/// Part of a tolerance that the host's solver around an FMU with states takes, in multiples of it.
const SOLVER: f64 = 1e3;
/// Tolerance of that solver.
const SOLVER_TOLERANCE: f64 = 1e-11;
/// Steps of that solver between two rows, at least: first, and then as long as the results differ. In model exchange nothing but the host's
/// step sees a force that acts for a short time, so a step that passes over one is no fault of the FMU.
const STEPS_OF_ROW: [usize; 3] = [32, 256, 2048];
/// Error of that solver, like an initial state that is perturbed by it, at least.
const SOLVER_ERROR: f64 = 3e-8;

/// Owner of the solver that integrates the states of a repeated run.
#[derive(Clone, Copy)]
enum Integrator {
    /// The FMU steps from row to row.
    Fmu,
    /// The host's solver integrates its states; `steps`: smallest number between two rows.
    Host { steps: usize },
}

/// A change of the initial state.
struct Perturbation<'a> {
    /// Initial values that are changed.
    names: Vec<&'a str>,
    /// Change of each.
    by: f64,
}

/// Outputs of a repeated run.
struct RepeatedRun {
    integrator: Integrator,
    /// Rows of the run.
    count: usize,
    /// Outputs in the reference's order, row by row. With a host's solver they end where the motion leaves the domain: outside, it may pass
    /// points at which equations are singular, where two solvers need not agree.
    rows: Vec<Vec<f64>>,
}

/// Two runs by a host's solver, one of which begins at a perturbed state.
struct MotionSensitivity {
    unperturbed: RepeatedRun,
    perturbed: RepeatedRun,
}

impl MotionSensitivity {
    /// Change of an output by the perturbation in a row; infinite where it is not known.
    fn change(&self, row: usize, output: usize) -> f64 {
        let runs = Option::zip(self.unperturbed.rows.get(row), self.perturbed.rows.get(row));
        let change = runs.map(|(unperturbed, perturbed)| (unperturbed[output] - perturbed[output]).abs());
        change.filter(|change| !change.is_nan()).unwrap_or(f64::INFINITY)
    }
}

/// Difference of a run whose states the host's solver integrates, if there is one. A sensitive motion amplifies the errors of both solvers:
/// it may differ by what an initial state changes it that is perturbed by as much.
fn difference_of_solved(fmu: &Fmu, reference: &Reference, surrogate: Option<&Surrogate>) -> Result<Option<String>> {
    let mut finest = None;
    for steps in STEPS_OF_ROW {
        let run = reference.repeat(fmu, Integrator::Host { steps }, None)?;
        if reference.difference(&run, None).is_none() {
            return Ok(None);
        }
        finest = Some(run);
    }
    let of_surrogate = surrogate.and_then(|surrogate| surrogate.metadata().solver_error).unwrap_or(0.0);
    let perturbation =
        Perturbation { names: surrogate.map_or_else(Vec::new, starts), by: of_surrogate.max(SOLVER_ERROR) };
    let integrator = Integrator::Host { steps: STEPS_OF_ROW[0] };
    let sensitivity = MotionSensitivity {
        unperturbed: reference.repeat(fmu, integrator, None)?,
        perturbed: reference.repeat(fmu, integrator, Some(&perturbation))?,
    };
    Ok(finest.and_then(|run| reference.difference(&run, Some(&sensitivity))))
}

/// Names of the initial values of states.
fn starts(surrogate: &Surrogate) -> Vec<&str> {
    let starts = surrogate.inputs().iter().filter(|input| input.role == Role::Start);
    starts.map(|input| input.name.as_str()).collect()
}

impl Reference {
    /// Repeats the run, from a perturbed state if that is wanted.
    fn repeat(&self, fmu: &Fmu, integrator: Integrator, perturbation: Option<&Perturbation>) -> Result<RepeatedRun> {
        let Self { options, names, .. } = self;
        let instance = fmu.instantiate("reference", true)?;
        let in_domain = BuiltIn::InDomain.name();
        let (steps, tolerance) = match integrator {
            Integrator::Fmu => (1, None),
            Integrator::Host { steps } => (steps, Some(SOLVER_TOLERANCE)),
        };
        let is_watched = matches!(integrator, Integrator::Host { .. })
            && fmu.description().variable(in_domain).is_some()
            && !names.iter().any(|name| name == in_domain);
        let mut start_values = options.start_values.clone();
        for name in perturbation.iter().flat_map(|perturbation| &perturbation.names) {
            if let (Some(value), Some(perturbation)) = (start_values.get_mut(*name), perturbation) {
                *value += perturbation.by;
            }
        }
        let table = simulate(
            &instance,
            &SimulationOptions {
                start: Some(options.start_time),
                stop: Some(options.stop_time),
                step: Some(options.step_size / steps as f64),
                start_values: start_values.into_iter().collect(),
                record: names.iter().cloned().chain(is_watched.then(|| in_domain.to_owned())).collect(),
                tolerance,
                ..SimulationOptions::default()
            },
        )?;
        let columns: Vec<Option<usize>> =
            names.iter().map(|name| table.columns.iter().position(|column| column.name == *name)).collect();
        let of_domain =
            if is_watched { table.columns.iter().position(|column| column.name == in_domain) } else { None };
        let last = table.rows.len().saturating_sub(1);
        let mut run = RepeatedRun { integrator, count: 0, rows: Vec::new() };
        let mut is_inside = true;
        for (_, row) in table.rows.iter().enumerate().filter(|(index, _)| index.is_multiple_of(steps) || *index == last)
        {
            run.count += 1;
            is_inside &= of_domain.is_none_or(|column| row[column] != 0.0);
            if is_inside {
                run.rows.push(columns.iter().map(|column| column.map_or(f64::NAN, |column| row[column])).collect());
            }
        }
        Ok(run)
    }

    /// The first difference of a run, if there is one. One by a host's solver may differ by [`SOLVER`] tolerances, and by twice of what a
    /// perturbation has changed so far.
    fn difference(&self, run: &RepeatedRun, sensitivity: Option<&MotionSensitivity>) -> Option<String> {
        let Self { options, names, rows } = self;
        if run.count != rows.len() {
            return Some(format!("{} rows, expected {}", run.count, rows.len()));
        }
        let of_names = |values: &IndexMap<String, f64>| -> Vec<f64> {
            names.iter().map(|name| values.get(name).copied().unwrap_or(0.0)).collect()
        };
        let mut tolerances = of_names(&options.tolerances);
        if let Integrator::Host { .. } = run.integrator {
            for (tolerance, error) in tolerances.iter_mut().zip(of_names(&options.solver_errors)) {
                *tolerance = SOLVER * *tolerance + 2.0 * error;
            }
        }
        let mut changes = vec![0.0f64; names.len()];
        for (row, (found, expected)) in run.rows.iter().zip(rows).enumerate() {
            let Some((time, expected)) = expected.split_first() else { continue };
            for (output, (found, expected)) in found.iter().zip(expected).enumerate() {
                let change = sensitivity.map_or(0.0, |sensitivity| sensitivity.change(row, output));
                changes[output] = changes[output].max(change);
                // written so that NaN is wrong
                let is_right = (found - expected).abs() <= tolerances[output] + 2.0 * changes[output];
                if !is_right {
                    return Some(format!("\"{}\" is {found} at {time} s, expected {expected}", names[output]));
                }
            }
        }
        None
    }
}
