//! The functions of FMI 2.0 that only model exchange has. The FMU has no events. What has no states is a
//! function of time, inputs and parameters.

use super::{Function, Instance, Status, call, count, not_null, slice, slice_mut, write};
use std::ffi::{c_int, c_void};

/// `fmi2EventInfo`
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub(super) struct EventInfo {
    pub new_discrete_states_needed: c_int,
    pub terminate_simulation: c_int,
    pub nominals_of_continuous_states_changed: c_int,
    pub values_of_continuous_states_changed: c_int,
    pub next_event_time_defined: c_int,
    pub next_event_time: f64,
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2EnterEventMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::EnterEventMode, Instance::enter_event_mode) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2NewDiscreteStates(c: *mut c_void, fmi2eventInfo: *mut EventInfo) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::NewDiscreteStates, |_| write(fmi2eventInfo, EventInfo::default(), "fmi2eventInfo")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2EnterContinuousTimeMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::EnterContinuousTimeMode, Instance::enter_continuous_time_mode) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2CompletedIntegratorStep(
    c: *mut c_void,
    _noSetFMUStatePriorToCurrentPoint: c_int,
    enterEventMode: *mut c_int,
    terminateSimulation: *mut c_int,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::CompletedIntegratorStep, |instance| {
            not_null(enterEventMode, "enterEventMode")?;
            not_null(terminateSimulation, "terminateSimulation")?;
            write(enterEventMode, 0, "enterEventMode")?;
            write(terminateSimulation, 0, "terminateSimulation")?;
            instance.accept_point()
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetTime(c: *mut c_void, time: f64) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::SetTime, |instance| instance.set_solver_time(time)) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2SetContinuousStates(c: *mut c_void, x: *const f64, nx: usize) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::SetContinuousStates, |instance| {
            count(nx, instance.states().len(), "x")?;
            instance.set_states(slice(x, nx, "x")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetDerivatives(c: *mut c_void, derivatives: *mut f64, nx: usize) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetDerivatives, |instance| {
            count(nx, instance.states().len(), "derivatives")?;
            let to = slice_mut(derivatives, nx, "derivatives")?;
            to.copy_from_slice(instance.derivatives()?);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetEventIndicators(
    c: *mut c_void,
    _eventIndicators: *mut f64,
    ni: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetEventIndicators, |_| count(ni, 0, "eventIndicators")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetContinuousStates(c: *mut c_void, x: *mut f64, nx: usize) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetContinuousStates, |instance| {
            let values = instance.states();
            count(nx, values.len(), "x")?;
            slice_mut(x, nx, "x")?.copy_from_slice(values);
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi2GetNominalsOfContinuousStates(
    c: *mut c_void,
    x_nominal: *mut f64,
    nx: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetNominalsOfContinuousStates, |instance| {
            let values = instance.nominals();
            count(nx, values.len(), "x_nominal")?;
            slice_mut(x_nominal, nx, "x_nominal")?.copy_from_slice(values);
            Ok(())
        })
    }
}
