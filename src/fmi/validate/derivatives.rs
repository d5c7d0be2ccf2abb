//! Compares the derivatives an FMU offers with differences of its outputs.

mod slopes;

use super::{Area, Notes};
use crate::{
    Result,
    fmi::{
        FmiVersion, Fmu, FmuInstance,
        model_description::{Causality, RealAttributes, ScalarVariable, Unknown, VariableType},
    },
};
use slopes::{FiniteDifference, LONGEST, Slopes};

/// Largest difference, relative to the largest derivative of the same output; the error of the finite differences is
/// added.
const TOLERANCE: f64 = 1e-4;
/// Differences less sure than this, in the same measure, prove nothing.
const UNSURE: f64 = 0.1;
/// Differences that are sure up to this, relative to the output's nominal value when the known variable changes by its magnitude, prove
/// something in any case.
const NEGLIGIBLE: f64 = 1e-6;
/// More known variables than this are not tried.
const MAX_KNOWNS: usize = 32;

/// Reports derivatives of outputs by their known variables that differ from finite differences, in Initialization Mode,
/// where parameters count as known as well. Derivatives by the variables `without` any are skipped; each variable has a
/// reason.
pub fn check(fmu: &Fmu, without: &[(String, String)], report: &mut Notes) {
    let capabilities = fmu.capabilities();
    if !capabilities.directional_derivative {
        return report.skipped("derivatives: the FMU offers none");
    }
    for (name, reason) in without {
        report.skipped(format!("derivatives by \"{name}\": {reason}"));
    }
    let description = fmu.description();
    let variable = |position: &usize| description.variables.get(*position).filter(|variable| is_scalar(variable));
    for Unknown { variable: position, dependencies, .. } in &description.structure.initial_unknowns {
        let Some(unknown) = variable(position).filter(|unknown| unknown.causality == Causality::Output) else {
            continue;
        };
        let all = || (0..description.variables.len()).collect();
        let knowns = dependencies.clone().unwrap_or_else(all);
        let is_known = |known: &&ScalarVariable| {
            matches!(known.causality, Causality::Input | Causality::Parameter)
                && without.iter().all(|(name, _)| *name != known.name)
        };
        let mut knowns: Vec<&ScalarVariable> = knowns.iter().filter_map(variable).filter(is_known).collect();
        if knowns.len() > MAX_KNOWNS {
            report.skipped(format!("derivatives of \"{}\" by more than {MAX_KNOWNS} variables", unknown.name));
            knowns.truncate(MAX_KNOWNS);
        }
        report.doing(format!("derivatives of \"{}\"", unknown.name));
        match differences(fmu, unknown, &knowns, capabilities.adjoint_derivative, report) {
            Ok(problems) => problems.into_iter().for_each(|problem| report.problem(Area::Behavior, problem)),
            Err(error) => report.problem(Area::Behavior, format!("derivatives of \"{}\": {error}", unknown.name)),
        }
    }
}

fn is_scalar(variable: &ScalarVariable) -> bool {
    variable.dimensions.is_empty() && matches!(variable.kind, VariableType::Real(RealAttributes { single: false, .. }))
}

fn differences(
    fmu: &Fmu,
    unknown: &ScalarVariable,
    knowns: &[&ScalarVariable],
    adjoint: bool,
    report: &mut Notes,
) -> Result<Vec<String>> {
    let instance = fmu.instantiate("derivatives", true)?;
    let start = fmu.description().default_experiment.and_then(|experiment| experiment.start).unwrap_or(0.0);
    instance.enter_initialization_mode(start, None)?;
    let (mut found, mut expected) = (Vec::new(), Vec::new());
    for known in knowns {
        found.push(instance.directional_derivative(&[unknown.value_reference], &[known.value_reference], &[1.0])?[0]);
        expected.push(difference(&instance, unknown, known)?);
    }
    let largest = expected.iter().fold(f64::MIN_POSITIVE, |largest, of| largest.max(of.slopes.largest()));
    // where an output is at an extreme, all derivatives are 0, and the smallest error is larger than they are
    let nominal = unknown.kind.as_real().and_then(|real| real.nominal).unwrap_or(1.0);
    let is_rough = |Differences { slopes, magnitude }: &Differences| {
        slopes.error() > UNSURE * largest && slopes.error() * magnitude > NEGLIGIBLE * nominal
    };
    for (known, difference) in knowns.iter().zip(&expected) {
        if is_rough(difference) {
            let names = format!("the derivative of \"{}\" by \"{}\"", unknown.name, known.name);
            report.skipped(format!("{names}: the outputs are too rough for differences"));
        }
    }
    let wrong = |what: &str, found: f64, index: usize| {
        let (name, slopes) = (&knowns[index].name, &expected[index].slopes);
        let FiniteDifference { value, error, unseen } = slopes.nearest(found);
        // written so that NaN is wrong
        let right = (found - value).abs() <= TOLERANCE * largest + 2.0 * error + unseen;
        let message =
            format!("the {what} of \"{}\" by \"{name}\" is {found:?}, differences give {value:?}", unknown.name);
        (!right && !is_rough(&expected[index])).then_some(message)
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

/// Derivatives of an output by a known variable.
struct Differences {
    slopes: Slopes,
    /// Magnitude of the known variable.
    magnitude: f64,
}

/// Derivatives by differences at the current value of a known variable.
fn difference(instance: &FmuInstance, unknown: &ScalarVariable, known: &ScalarVariable) -> Result<Differences> {
    let reference = [known.value_reference];
    let mut center = [0.0];
    instance.get_real(&reference, &mut center)?;
    let center = center[0];
    let real = known.kind.as_real();
    let limit = |get: fn(&RealAttributes) -> Option<f64>| real.and_then(get).map(|limit| (limit - center).abs());
    // a start value may be at the end of its range, where steps in both directions do not stay inside
    let room = [limit(|real| real.min), limit(|real| real.max)].into_iter().flatten().filter(|room| *room > 0.0);
    let room = room.fold(f64::INFINITY, f64::min);
    let magnitude = center.abs().max(real.and_then(|real| real.nominal).unwrap_or(1.0)).min(room / LONGEST);
    let at = |value: f64| {
        instance.set_real(&reference, &[value])?;
        let mut output = [0.0];
        instance.get_real(&[unknown.value_reference], &mut output).map(|()| output[0])
    };
    let slopes = Slopes::of(center, magnitude, at)?;
    instance.set_real(&reference, &[center])?;
    Ok(Differences { slopes, magnitude })
}
