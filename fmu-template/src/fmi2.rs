//! The C functions of FMI 2.0. Each one turns its arguments into Rust's and asks the instance. For the host's promise
//! in the `SAFETY` comments see `component`.

#![allow(non_snake_case)] // the standard's names

use crate::{
    boundary::{count, not_null, slice, slice_mut, text, write},
    component::{
        InstantiationError, call, call_often, deserialize, free, free_state, instantiate, serialize, state_size, store,
        stored, switch_logging,
    },
    instance::{Instance, InstanceKind},
    location,
    logger::{Callback2, Logger},
    state::{Interface, Version},
    status::{Refusal, Status},
};
use std::{
    ffi::{CStr, c_char, c_int, c_uint, c_void},
    path::PathBuf,
    ptr::null_mut,
};
use table::Function;

mod model_exchange;
mod table;

/// `fmi2CallbackFunctions`. Memory comes from Rust's own allocator and steps are synchronous, so only the logger matters.
#[repr(C)]
struct CallbackFunctions {
    logger: Option<Callback2>,
    allocate_memory: Option<unsafe extern "C" fn(usize, usize) -> *mut c_void>,
    free_memory: Option<unsafe extern "C" fn(*mut c_void)>,
    step_finished: Option<unsafe extern "C" fn(*mut c_void, c_int)>,
    environment: *mut c_void,
}

/// `fmi2ModelExchange`
const MODEL_EXCHANGE: c_int = 0;
/// `fmi2CoSimulation`
const CO_SIMULATION: c_int = 1;
/// `fmi2LastSuccessfulTime`
const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`
const TERMINATED: c_int = 3;

// ---- Version, instances, logging ---------------------------------------------------------------------------------

#[unsafe(no_mangle)]
extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Instantiate(
    instanceName: *const c_char,
    fmuType: c_int,
    fmuGUID: *const c_char,
    fmuResourceLocation: *const c_char,
    functions: *const CallbackFunctions,
    _visible: c_int,
    loggingOn: c_int,
) -> *mut c_void {
    // SAFETY: the host's promise
    let Some(functions) = (unsafe { functions.as_ref() }) else { return null_mut() };
    let Some(callback) = functions.logger else { return null_mut() };
    // SAFETY: not null and the host's promise
    let name = if instanceName.is_null() { c"" } else { unsafe { CStr::from_ptr(instanceName) } };
    let logger = Logger::fmi2(callback, functions.environment, name, loggingOn != 0);
    // SAFETY: the host's promise
    unsafe {
        instantiate("fmi2Instantiate", instanceName, logger, None, &|| arguments(fmuType, fmuGUID, fmuResourceLocation))
    }
}

/// # Safety
/// The host's promise.
unsafe fn arguments(
    kind: c_int,
    token: *const c_char,
    resources: *const c_char,
) -> Result<(InstanceKind, String, PathBuf), InstantiationError> {
    let interface = match kind {
        MODEL_EXCHANGE => Interface::ModelExchange,
        CO_SIMULATION => Interface::CoSimulation,
        found => return Err(InstantiationError::Type { found }),
    };
    // SAFETY: the host's promise
    let (token, resources) = unsafe { (text(token), text(resources)) };
    let resources = location::directory(resources.map_err(InstantiationError::text("fmuResourceLocation"))?)?;
    let token = token.map_err(InstantiationError::text("fmuGUID"))?.to_owned();
    Ok((InstanceKind { version: Version::Fmi2, interface, event_mode: false }, token, resources))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeInstance(c: *mut c_void) {
    // SAFETY: the host's promise
    unsafe { free(c) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetDebugLogging(
    c: *mut c_void,
    loggingOn: c_int,
    nCategories: usize,
    categories: *const *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::SetDebugLogging, |instance| {
            switch_logging(c, instance, loggingOn != 0, nCategories, categories)
        })
    }
}

// ---- Modes -------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetupExperiment(
    c: *mut c_void,
    toleranceDefined: c_int,
    tolerance: f64,
    startTime: f64,
    stopTimeDefined: c_int,
    stopTime: f64,
) -> Status {
    let stop = (stopTimeDefined != 0).then_some(stopTime);
    let tolerance = (toleranceDefined != 0).then_some(tolerance);
    // SAFETY: the host's promise
    unsafe { call(c, Function::SetupExperiment, |instance| instance.set_up_experiment(startTime, stop, tolerance)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2EnterInitializationMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::EnterInitializationMode, Instance::enter_initialization_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2ExitInitializationMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::ExitInitializationMode, Instance::exit_initialization_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Terminate(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::Terminate, Instance::terminate) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Reset(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::Reset, Instance::reset) }
}

// ---- Values ------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetReal(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *mut f64) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call_often(c, Function::GetReal, |instance| {
            instance.get_real(slice(vr, nvr, "vr")?, slice_mut(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetReal(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *const f64) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call_often(c, Function::SetReal, |instance| {
            instance.set_real(slice(vr, nvr, "vr")?, slice(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetInteger(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetInteger, |instance| {
            instance.get_integer(slice(vr, nvr, "vr")?, slice_mut(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetBoolean(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetBoolean, |instance| {
            instance.get_boolean(slice(vr, nvr, "vr")?, slice_mut(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *mut *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetString, |_| no_variables("String", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetInteger(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *const c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::SetInteger, |instance| {
            instance.set_integer(slice(vr, nvr, "vr")?, slice(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetBoolean(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *const c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::SetBoolean, |instance| {
            instance.set_boolean(slice(vr, nvr, "vr")?, slice(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *const *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::SetString, |_| no_variables("String", nvr)) }
}

fn no_variables(kind: &'static str, count: usize) -> Result<(), Refusal> {
    if count == 0 { Ok(()) } else { Err(Refusal::NoVariableOfType { kind, count }) }
}

// ---- FMU state ---------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetFMUstate, |instance| store(instance.snapshot(), FMUstate, "FMUstate")) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetFMUstate(c: *mut c_void, FMUstate: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::SetFMUstate, |instance| instance.restore(stored(FMUstate, "FMUstate")?)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::FreeFMUstate, |_| free_state(FMUstate)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SerializedFMUstateSize(c: *mut c_void, FMUstate: *mut c_void, size: *mut usize) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::SerializedFMUstateSize, |_| state_size(FMUstate, "FMUstate", size)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SerializeFMUstate(
    c: *mut c_void,
    FMUstate: *mut c_void,
    serializedState: *mut u8,
    size: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::SerializeFMUstate, |_| serialize(FMUstate, "FMUstate", serializedState, size)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2DeSerializeFMUstate(
    c: *mut c_void,
    serializedState: *const u8,
    size: usize,
    FMUstate: *mut *mut c_void,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::DeSerializeFMUstate, |instance| {
            deserialize(instance, serializedState, size, FMUstate, "FMUstate")
        })
    }
}

// ---- Derivatives -------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetDirectionalDerivative(
    c: *mut c_void,
    vUnknown_ref: *const c_uint,
    nUnknown: usize,
    vKnown_ref: *const c_uint,
    nKnown: usize,
    dvKnown: *const f64,
    dvUnknown: *mut f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetDirectionalDerivative, |instance| {
            instance.directional_derivative(
                slice(vUnknown_ref, nUnknown, "vUnknown_ref")?,
                slice(vKnown_ref, nKnown, "vKnown_ref")?,
                slice(dvKnown, nKnown, "dvKnown")?,
                slice_mut(dvUnknown, nUnknown, "dvUnknown")?,
            )
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    order: *const c_int,
    value: *const f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::SetRealInputDerivatives, |instance| {
            let (vr, order) = (slice(vr, nvr, "vr")?, slice(order, nvr, "order")?);
            instance.set_input_derivatives(vr, order, slice(value, nvr, "value")?)
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetRealOutputDerivatives(
    c: *mut c_void,
    vr: *const c_uint,
    nvr: usize,
    order: *const c_int,
    value: *mut f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetRealOutputDerivatives, |instance| {
            let (vr, order) = (slice(vr, nvr, "vr")?, slice(order, nvr, "order")?);
            instance.output_derivatives(vr, order, slice_mut(value, nvr, "value")?)
        })
    }
}

// ---- Steps -------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2DoStep(
    c: *mut c_void,
    currentCommunicationPoint: f64,
    communicationStepSize: f64,
    _noSetFMUStatePriorToCurrentPoint: c_int,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call_often(c, Function::DoStep, |instance| instance.do_step(currentCommunicationPoint, communicationStepSize))
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2CancelStep(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::CancelStep, |_| Ok(())) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetStatus(c: *mut c_void, s: c_int, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetStatus, |_| Err(no_status(s))) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetRealStatus(c: *mut c_void, s: c_int, value: *mut f64) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetRealStatus, |instance| match s {
            LAST_SUCCESSFUL_TIME => write(value, instance.time(), "value"),
            _ => Err(no_status(s)),
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetIntegerStatus(c: *mut c_void, s: c_int, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetIntegerStatus, |_| Err(no_status(s))) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetBooleanStatus(c: *mut c_void, s: c_int, value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Function::GetBooleanStatus, |_| match s {
            TERMINATED => write(value, 0, "value"),
            _ => Err(no_status(s)),
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetStringStatus(c: *mut c_void, s: c_int, _value: *mut *const c_char) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Function::GetStringStatus, |_| Err(no_status(s))) }
}

fn no_status(kind: c_int) -> Refusal {
    Refusal::NoStatus { kind, reason: "steps are synchronous and always complete" }
}

#[cfg(test)]
mod tests;
