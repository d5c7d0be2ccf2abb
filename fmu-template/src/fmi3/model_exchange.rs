//! The functions of FMI 3.0 that only model exchange has. The FMU has no events. What has no states is a
//! function of time, inputs and parameters.

use super::{Boolean, Function, Instance, Status, call, count, not_null, slice, slice_mut, write};
use std::ffi::c_void;

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3EnterContinuousTimeMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::EnterContinuousTimeMode, Instance::enter_continuous_time_mode) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3CompletedIntegratorStep(
    instance: *mut c_void,
    _noSetFMUStatePriorToCurrentPoint: Boolean,
    enterEventMode: *mut Boolean,
    terminateSimulation: *mut Boolean,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::CompletedIntegratorStep, |instance| {
            not_null(enterEventMode, "enterEventMode")?;
            not_null(terminateSimulation, "terminateSimulation")?;
            write(enterEventMode, 0, "enterEventMode")?;
            write(terminateSimulation, 0, "terminateSimulation")?;
            instance.accept_point()
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetTime(instance: *mut c_void, time: f64) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetTime, |instance| instance.set_solver_time(time)) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetContinuousStates(
    instance: *mut c_void,
    continuousStates: *const f64,
    nContinuousStates: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::SetContinuousStates, |instance| {
            count(nContinuousStates, instance.states().len(), "continuousStates")?;
            instance.set_states(slice(continuousStates, nContinuousStates, "continuousStates")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetContinuousStateDerivatives(
    instance: *mut c_void,
    derivatives: *mut f64,
    nContinuousStates: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetContinuousStateDerivatives, |instance| {
            count(nContinuousStates, instance.states().len(), "derivatives")?;
            let to = slice_mut(derivatives, nContinuousStates, "derivatives")?;
            to.copy_from_slice(instance.derivatives()?);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetEventIndicators(
    instance: *mut c_void,
    _eventIndicators: *mut f64,
    nEventIndicators: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetEventIndicators, |_| count(nEventIndicators, 0, "eventIndicators")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetContinuousStates(
    instance: *mut c_void,
    continuousStates: *mut f64,
    nContinuousStates: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetContinuousStates, |instance| {
            let values = instance.states();
            count(nContinuousStates, values.len(), "continuousStates")?;
            slice_mut(continuousStates, nContinuousStates, "continuousStates")?.copy_from_slice(values);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetNominalsOfContinuousStates(
    instance: *mut c_void,
    nominals: *mut f64,
    nContinuousStates: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetNominalsOfContinuousStates, |instance| {
            let values = instance.nominals();
            count(nContinuousStates, values.len(), "nominals")?;
            slice_mut(nominals, nContinuousStates, "nominals")?.copy_from_slice(values);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetNumberOfEventIndicators(
    instance: *mut c_void,
    nEventIndicators: *mut usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetNumberOfEventIndicators, |_| write(nEventIndicators, 0, "nEventIndicators")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetNumberOfContinuousStates(
    instance: *mut c_void,
    nContinuousStates: *mut usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetNumberOfContinuousStates, |instance| {
            write(nContinuousStates, instance.states().len(), "nContinuousStates")
        })
    }
}
