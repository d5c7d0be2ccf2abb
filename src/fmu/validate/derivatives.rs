//! Compares the derivatives an FMU offers with differences of its outputs.

use super::{Area, Report};
use crate::{
    Result,
    fmu::{
        FmiVersion, Fmu, Instance,
        model_description::{Causality, Real, ScalarVariable, Unknown, VariableType},
    },
};

/// Step of a central difference relative to the magnitude of a variable: its error is then a few 1e-10.
const STEP: f64 = 1e-5;
/// Largest difference, relative to the largest derivative of the same output.
const TOLERANCE: f64 = 1e-4;
/// More known variables than this are not tried.
const MAX_KNOWNS: usize = 32;

/// Reports derivatives that are not those of the outputs by the inputs and parameters they are said to depend on, in
/// Initialization Mode, where parameters count as known as well.
pub fn check(fmu: &Fmu, report: &mut Report) {
    let capabilities = fmu.capabilities();
    if !capabilities.directional_derivative {
        return report.skipped("derivatives: the FMU offers none");
    }
    let description = fmu.description();
    let variable = |position: &usize| description.variables.get(*position).filter(|variable| is_scalar(variable));
    for Unknown { variable: position, dependencies, .. } in &description.structure.initial_unknowns {
        let Some(unknown) = variable(position).filter(|unknown| unknown.causality == Causality::Output) else {
            continue;
        };
        let all = || (0..description.variables.len()).collect();
        let knowns = dependencies.clone().unwrap_or_else(all);
        let is_known = |known: &&ScalarVariable| matches!(known.causality, Causality::Input | Causality::Parameter);
        let mut knowns: Vec<&ScalarVariable> = knowns.iter().filter_map(variable).filter(is_known).collect();
        if knowns.len() > MAX_KNOWNS {
            report.skipped(format!("derivatives of \"{}\" by more than {MAX_KNOWNS} variables", unknown.name));
            knowns.truncate(MAX_KNOWNS);
        }
        match differences(fmu, unknown, &knowns, capabilities.adjoint_derivative) {
            Ok(problems) => problems.into_iter().for_each(|problem| report.problem(Area::Behaviour, problem)),
            Err(error) => report.problem(Area::Behaviour, format!("derivatives of \"{}\": {error}", unknown.name)),
        }
    }
}

fn is_scalar(variable: &ScalarVariable) -> bool {
    variable.dimensions.is_empty() && matches!(variable.kind, VariableType::Real(Real { single: false, .. }))
}

fn differences(fmu: &Fmu, unknown: &ScalarVariable, knowns: &[&ScalarVariable], adjoint: bool) -> Result<Vec<String>> {
    let instance = fmu.instantiate("derivatives", true)?;
    let start = fmu.description().default_experiment.and_then(|experiment| experiment.start).unwrap_or(0.0);
    instance.enter_initialization_mode(start, None)?;
    let (mut found, mut expected) = (Vec::new(), Vec::new());
    for known in knowns {
        found.push(instance.directional_derivative(&[unknown.value_reference], &[known.value_reference], &[1.0])?[0]);
        expected.push(central_difference(&instance, unknown, known)?);
    }
    let largest = expected.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let wrong = |what: &str, found: f64, index: usize| {
        let (name, expected) = (&knowns[index].name, expected[index]);
        // written so that NaN is wrong
        let right = (found - expected).abs() <= TOLERANCE * largest.max(f64::MIN_POSITIVE);
        let message =
            format!("the {what} of \"{}\" by \"{name}\" is {found}, differences give {expected}", unknown.name);
        (!right).then_some(message)
    };
    let directional = found.iter().enumerate().filter_map(|(index, found)| wrong("derivative", *found, index));
    let mut problems: Vec<String> = directional.collect();
    if adjoint && fmu.description().fmi_version == FmiVersion::V3 && !knowns.is_empty() {
        let references: Vec<u32> = knowns.iter().map(|known| known.value_reference).collect();
        let row = instance.adjoint_derivative(&[unknown.value_reference], &references, &[1.0])?;
        let adjoint = row.into_iter().enumerate();
        problems.extend(adjoint.filter_map(|(index, found)| wrong("adjoint derivative", found, index)));
    }
    Ok(problems)
}

fn central_difference(instance: &Instance, unknown: &ScalarVariable, known: &ScalarVariable) -> Result<f64> {
    let reference = [known.value_reference];
    let mut center = [0.0];
    instance.get_real(&reference, &mut center)?;
    let nominal = known.kind.as_real().and_then(|real| real.nominal).unwrap_or(1.0);
    let step = STEP * center[0].abs().max(nominal);
    let at = |value: f64| {
        instance.set_real(&reference, &[value])?;
        let mut output = [0.0];
        instance.get_real(&[unknown.value_reference], &mut output).map(|()| output[0])
    };
    let (above, below) = (at(center[0] + step)?, at(center[0] - step)?);
    at(center[0])?;
    Ok((above - below) / ((center[0] + step) - (center[0] - step)))
}
