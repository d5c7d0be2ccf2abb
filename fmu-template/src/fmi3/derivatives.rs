//! Dependencies and derivatives in FMI 3.0.

use super::{Function, Status, call, count, not_null, slice, slice_mut, write};
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
            not_null(nDependencies, "nDependencies")?;
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
            let elements = slice_mut(elementIndicesOfDependent, nDependencies, "elementIndicesOfDependent")?;
            let independents = slice_mut(independents, nDependencies, "independents")?;
            let indices = slice_mut(elementIndicesOfIndependents, nDependencies, "elementIndicesOfIndependents")?;
            slice_mut(dependencyKinds, nDependencies, "dependencyKinds")?.fill(DEPENDENT);
            // zero: all elements of a variable, which is the only one of a scalar
            indices.fill(0);
            let places = elements.iter_mut().zip(independents);
            places.zip(instance.dependencies(dependent)?).for_each(|((element, independent), dependency)| {
                (*element, *independent) = dependency;
            });
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
            let unknowns = slice(unknowns, nUnknowns, "unknowns")?;
            let knowns = slice(knowns, nKnowns, "knowns")?;
            count(nSeed, instance.size(knowns)?, "seed")?;
            count(nSensitivity, instance.size(unknowns)?, "sensitivity")?;
            instance.directional_derivative(
                unknowns,
                knowns,
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
            let unknowns = slice(unknowns, nUnknowns, "unknowns")?;
            let knowns = slice(knowns, nKnowns, "knowns")?;
            count(nSeed, instance.size(unknowns)?, "seed")?;
            count(nSensitivity, instance.size(knowns)?, "sensitivity")?;
            instance.adjoint_derivative(
                unknowns,
                knowns,
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
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, instance.size(references)?, "values")?;
            instance.output_derivatives(
                references,
                slice(orders, nValueReferences, "orders")?,
                slice_mut(values, nValues, "values")?,
            )
        })
    }
}
