//! Checks of metafmu's own FMUs beyond the standard: their outputs must match the surrogate and the reference result
//! inside.

mod domain;
mod prediction;
mod reference_run;

use super::package::{MODEL_FILE, surrogate};
use crate::{
    Result,
    fmi::{
        self, Archive, Checks, Fmu, Report, Watch,
        validate::{Area, Notes},
        worker,
    },
};
use metafmu_runtime::{Surrogate, graph::Step};
use std::path::Path;

/// Checks an FMU as [`fmi::validate()`] does, and the surrogate and the reference result inside if it is one of ours.
///
/// # Errors
/// Those of [`fmi::validate()`].
pub fn validate(path: impl AsRef<Path>) -> Result<Report> {
    fmi::validate(path, &SurrogateChecks)
}

/// Checks an FMU as [`validate`] does, but runs it in separate processes: see [`fmi::validate_apart`].
///
/// # Errors
/// Those of [`fmi::validate_apart`].
pub fn validate_apart(path: impl AsRef<Path>, watch: Watch) -> Result<Report> {
    fmi::validate_apart(path, watch, &SurrogateChecks)
}

/// Serves the process that started this one: see [`worker::serve`].
///
/// # Errors
/// Those of [`worker::serve`].
pub fn serve_worker() -> Result<()> {
    worker::serve(&SurrogateChecks)
}

/// Checks of the surrogate and the reference result inside an FMU, if there are any.
#[derive(Clone, Copy, Debug, Default)]
pub struct SurrogateChecks;

impl Checks for SurrogateChecks {
    fn archive(&self, archive: &mut Archive, report: &mut Report) {
        if let Err(problem) = surrogate(archive) {
            report.problem(Area::Surrogate, problem.to_string());
        }
        match reference_run::read(archive) {
            Ok(Some(_)) => {}
            Ok(None) => report.skipped("a reference result: there is none of metafmu's inside"),
            Err(error) => report.problem(Area::Archive, error.to_string()),
        }
    }

    fn no_derivatives(&self, archive: &mut Archive) -> Option<&'static str> {
        let surrogate = surrogate(archive).ok()??;
        is_piecewise_constant(&surrogate).then_some("the model inside jumps, between jumps they are 0")
    }

    fn no_derivatives_by(&self, archive: &mut Archive) -> Vec<(String, String)> {
        let Ok(Some(surrogate)) = surrogate(archive) else { return Vec::new() };
        // a value between the nominal ones acts as the nearest of them, and is outside of the domain
        let nominal = surrogate.inputs().iter().filter(|input| input.nominal_values().is_some());
        nominal.map(|input| (input.name.clone(), format!("it has {} only, and no range", input.valid()))).collect()
    }

    fn run(&self, fmu: &Fmu, archive: &mut Archive, notes: &mut Notes) {
        // what cannot be read has been reported
        let surrogate = surrogate(archive).ok().flatten();
        if let Some(surrogate) = &surrogate {
            prediction::check(fmu, surrogate, notes);
            domain::check(fmu, surrogate, notes);
            domain::check_data(fmu, surrogate, notes);
        }
        if let Ok(Some(reference)) = reference_run::read(archive) {
            reference_run::check(fmu, &reference, surrogate.as_ref(), notes);
        }
    }

    fn end(&self, archive: &mut Archive, report: &mut Report) {
        if !matches!(surrogate(archive), Ok(Some(_))) {
            report.skipped(format!(
                "whether the outputs are right: there is no `{MODEL_FILE}` of a metafmu surrogate to compare with"
            ));
        }
    }
}

fn is_piecewise_constant(surrogate: &Surrogate) -> bool {
    // near a threshold differences are no derivatives
    surrogate.program().graph.steps.iter().any(|step| matches!(step, Step::Forest { .. }))
}

#[cfg(test)]
mod tests;
