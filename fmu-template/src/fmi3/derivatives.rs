//! Dependencies and derivatives in FMI 3.0.

use super::{Function, Status, call, count, slice, slice_mut, write};
use std::ffi::{c_int, c_void};

/// `fmi3Dependent`: no particular structure.
const DEPENDENT: c_int = 5;

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetNumberOfVariableDependencies(
    instance: *mut c_void,
    valueReference: u32,
    nDependencies: *mut usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetNumberOfVariableDependencies, |instance| {
            write(nDependencies, instance.dependencies(valueReference)?.count(), "nDependencies")
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetVariableDependencies(
    instance: *mut c_void,
    dependent: u32,
    elementIndicesOfDependent: *mut usize,
    independents: *mut u32,
    elementIndicesOfIndependents: *mut usize,
    dependencyKinds: *mut c_int,
    nDependencies: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetVariableDependencies, |instance| {
            count(nDependencies, instance.dependencies(dependent)?.count(), "independents")?;
            // zero: all elements of a variable, which is the only one of a scalar
            slice_mut(elementIndicesOfDependent, nDependencies, "elementIndicesOfDependent")?.fill(0);
            slice_mut(elementIndicesOfIndependents, nDependencies, "elementIndicesOfIndependents")?.fill(0);
            slice_mut(dependencyKinds, nDependencies, "dependencyKinds")?.fill(DEPENDENT);
            let independents = slice_mut(independents, nDependencies, "independents")?;
            independents.iter_mut().zip(instance.dependencies(dependent)?).for_each(|(to, from)| *to = from);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetDirectionalDerivative(
    instance: *mut c_void,
    unknowns: *const u32,
    nUnknowns: usize,
    knowns: *const u32,
    nKnowns: usize,
    seed: *const f64,
    nSeed: usize,
    sensitivity: *mut f64,
    nSensitivity: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetDirectionalDerivative, |instance| {
            count(nSeed, nKnowns, "seed")?;
            count(nSensitivity, nUnknowns, "sensitivity")?;
            instance.directional_derivative(
                slice(unknowns, nUnknowns, "unknowns")?,
                slice(knowns, nKnowns, "knowns")?,
                slice(seed, nSeed, "seed")?,
                slice_mut(sensitivity, nSensitivity, "sensitivity")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetAdjointDerivative(
    instance: *mut c_void,
    unknowns: *const u32,
    nUnknowns: usize,
    knowns: *const u32,
    nKnowns: usize,
    seed: *const f64,
    nSeed: usize,
    sensitivity: *mut f64,
    nSensitivity: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetAdjointDerivative, |instance| {
            count(nSeed, nUnknowns, "seed")?;
            count(nSensitivity, nKnowns, "sensitivity")?;
            instance.adjoint_derivative(
                slice(unknowns, nUnknowns, "unknowns")?,
                slice(knowns, nKnowns, "knowns")?,
                slice(seed, nSeed, "seed")?,
                slice_mut(sensitivity, nSensitivity, "sensitivity")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetOutputDerivatives(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    orders: *const i32,
    values: *mut f64,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetOutputDerivatives, |instance| {
            count(nValues, nValueReferences, "values")?;
            instance.output_derivatives(
                slice(valueReferences, nValueReferences, "valueReferences")?,
                slice(orders, nValueReferences, "orders")?,
                slice_mut(values, nValues, "values")?,
            )
        })
    }
}
