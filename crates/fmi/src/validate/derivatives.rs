//! Compares the derivatives an FMU offers with differences of its outputs.

mod slopes;

use super::{Area, Notes};
use crate::{
    FmiVersion, Fmu, FmuInstance, Result,
    model_description::{Causality, ModelDescription, RealAttributes, ScalarVariable, Unknown, VariableType},
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
/// Distance from a start at a kink, relative to the known variable's magnitude, at which its derivative is compared once more.
const BESIDE: f64 = 1e-3;
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
    for Unknown { variable: position, dependencies, .. } in &description.structure.initial_unknowns {
        let Some(unknown) = scalar(description, *position).filter(|unknown| unknown.causality == Causality::Output)
        else {
            continue;
        };
        let knowns = dependencies.clone().unwrap_or_else(|| (0..description.variables.len()).collect());
        let mut knowns: Vec<&ScalarVariable> =
            knowns.into_iter().filter_map(|position| scalar(description, position)).collect();
        knowns.retain(|known| {
            matches!(known.causality, Causality::Input | Causality::Parameter)
                && without.iter().all(|(name, _)| *name != known.name)
        });
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

/// The variable at a position, if it is a single number.
fn scalar(description: &ModelDescription, position: usize) -> Option<&ScalarVariable> {
    description.variables.get(position).filter(|variable| is_scalar(variable))
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
    for (known, difference) in knowns.iter().zip(&expected) {
        if difference.is_rough(largest, nominal) {
            let names = format!("the derivative of \"{}\" by \"{}\"", unknown.name, known.name);
            report.skipped(format!("{names}: the outputs are too rough for differences"));
        }
    }
    let mut check =
        DerivativeCheck { instance: &instance, unknown, largest, problems: Vec::new(), skipped: Vec::new() };
    for ((known, difference), found) in knowns.iter().zip(&expected).zip(found) {
        if !difference.is_rough(largest, nominal) {
            check.compare(Mode::Directional, known, difference, found)?;
        }
    }
    if adjoint && fmu.description().fmi_version == FmiVersion::V3 && !knowns.is_empty() {
        let references: Vec<u32> = knowns.iter().map(|known| known.value_reference).collect();
        let row = instance.adjoint_derivative(&[unknown.value_reference], &references, &[1.0])?;
        for ((known, difference), found) in knowns.iter().zip(&expected).zip(row) {
            if !difference.is_rough(largest, nominal) {
                check.compare(Mode::Adjoint, known, difference, found)?;
            }
        }
    }
    let DerivativeCheck { problems, skipped, .. } = check;
    skipped.into_iter().for_each(|skipped| report.skipped(skipped));
    Ok(problems)
}

/// Function by which an FMU offers a derivative.
#[derive(Clone, Copy)]
enum Mode {
    Directional,
    Adjoint,
}

/// Comparison of the derivatives of one output.
struct DerivativeCheck<'a> {
    instance: &'a FmuInstance<'a>,
    unknown: &'a ScalarVariable,
    /// Largest derivative of the output by differences.
    largest: f64,
    problems: Vec<String>,
    skipped: Vec<String>,
}

impl DerivativeCheck<'_> {
    /// Compares a derivative at the start. One that differs there and is right on both sides is at a kink, where it may be any of the slopes that
    /// the parts of the function have.
    fn compare(&mut self, mode: Mode, known: &ScalarVariable, difference: &Differences, found: f64) -> Result<()> {
        if self.agrees(&difference.slopes, found) {
            return Ok(());
        }
        let what = match mode {
            Mode::Directional => "derivative",
            Mode::Adjoint => "adjoint derivative",
        };
        let derivative = format!("the {what} of \"{}\" by \"{}\"", self.unknown.name, known.name);
        if self.is_right_beside(mode, known, difference)? {
            self.skipped.push(format!("{derivative}: the start is at a kink"));
        } else {
            let value = difference.slopes.nearest(found).value;
            self.problems.push(format!("{derivative} is {found:?}, differences give {value:?}"));
        }
        Ok(())
    }

    /// Returns true if a derivative is what differences give. NaN is not.
    fn agrees(&self, slopes: &Slopes, found: f64) -> bool {
        let FiniteDifference { value, error, unseen } = slopes.nearest(found);
        (found - value).abs() <= TOLERANCE * self.largest.max(slopes.largest()) + 2.0 * error + unseen
    }

    /// Returns true if the derivative is right on both sides of the start, of which one may be outside the variable's range.
    fn is_right_beside(&self, mode: Mode, known: &ScalarVariable, at_start: &Differences) -> Result<bool> {
        let (instance, reference) = (self.instance, [known.value_reference]);
        let mut is_right = true;
        let mut sides = 0;
        for side in [-BESIDE, BESIDE] {
            let value = at_start.center + side * at_start.magnitude;
            if !is_in_range(known, value) {
                continue;
            }
            instance.set_real(&reference, &[value])?;
            let difference = difference(instance, self.unknown, known)?;
            let unknown = [self.unknown.value_reference];
            let found = match mode {
                Mode::Directional => instance.directional_derivative(&unknown, &reference, &[1.0])?[0],
                Mode::Adjoint => instance.adjoint_derivative(&unknown, &reference, &[1.0])?[0],
            };
            sides += 1;
            is_right &= self.agrees(&difference.slopes, found);
        }
        instance.set_real(&reference, &[at_start.center])?;
        Ok(is_right && sides > 0)
    }
}

/// Returns true if a variable may have a value.
fn is_in_range(variable: &ScalarVariable, value: f64) -> bool {
    let Some(RealAttributes { min, max, .. }) = variable.kind.as_real() else { return true };
    min.is_none_or(|min| value >= min) && max.is_none_or(|max| value <= max)
}

/// Derivatives of an output by a known variable.
struct Differences {
    slopes: Slopes,
    /// Value of the known variable.
    center: f64,
    /// Magnitude of the known variable.
    magnitude: f64,
}

impl Differences {
    /// Returns true if the slopes are too unsure for a comparison: relative to the largest derivative of the output and to its nominal value.
    fn is_rough(&self, largest: f64, nominal: f64) -> bool {
        self.slopes.error() > UNSURE * largest && self.slopes.error() * self.magnitude > NEGLIGIBLE * nominal
    }
}

/// Derivatives by differences at the current value of a known variable.
fn difference(instance: &FmuInstance, unknown: &ScalarVariable, known: &ScalarVariable) -> Result<Differences> {
    let reference = [known.value_reference];
    let mut center = [0.0];
    instance.get_real(&reference, &mut center)?;
    let center = center[0];
    let real = known.kind.as_real();
    let limits = real.map_or([None; 2], |real| [real.min, real.max]).into_iter().flatten();
    // a start value may be at the end of its range, where steps in both directions do not stay inside
    let room = limits.map(|limit| (limit - center).abs()).filter(|room| *room > 0.0).fold(f64::INFINITY, f64::min);
    let magnitude = center.abs().max(real.and_then(|real| real.nominal).unwrap_or(1.0)).min(room / LONGEST);
    let slopes = Slopes::of(center, magnitude, |value| {
        instance.set_real(&reference, &[value])?;
        let mut output = [0.0];
        instance.get_real(&[unknown.value_reference], &mut output).map(|()| output[0])
    })?;
    instance.set_real(&reference, &[center])?;
    Ok(Differences { slopes, center, magnitude })
}
