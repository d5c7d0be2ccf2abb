//! The C functions of FMI 2.0. Each one turns its arguments into Rust's and asks the instance.
//!
//! What every `SAFETY` comment below calls the host's promise is the standard's: a component is null or came from
//! `fmi2Instantiate` and is used by one thread at a time; arrays have the length that is passed with them; strings
//! are terminated; states came from this library and were not freed. Null pointers are tested for, not trusted.

#![allow(non_snake_case)] // the standard's names

use crate::{
    answer::{Refusal, Status, Warning},
    boundary::{TextError, guard, slice, slice_mut, text, write},
    instance::{Call, Instance, LoadError, State},
    location::{self, LocationError},
    logger::{Callback, Logger},
    snapshot::Snapshot,
};
use std::{
    ffi::{CStr, c_char, c_int, c_uint, c_void},
    ptr::null_mut,
};

/// `fmi2Component` points to one.
struct Component {
    instance: Instance,
    logger: Logger,
}

/// `fmi2CallbackFunctions`. Memory comes from Rust's own allocator and steps are synchronous, so only the logger matters.
#[repr(C)]
struct CallbackFunctions {
    logger: Option<Callback>,
    allocate_memory: Option<unsafe extern "C" fn(usize, usize) -> *mut c_void>,
    free_memory: Option<unsafe extern "C" fn(*mut c_void)>,
    step_finished: Option<unsafe extern "C" fn(*mut c_void, c_int)>,
    environment: *mut c_void,
}

/// `fmi2CoSimulation`
const CO_SIMULATION: c_int = 1;
/// `fmi2LastSuccessfulTime`
const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`
const TERMINATED: c_int = 3;

/// Why instantiation failed.
#[derive(Debug, thiserror::Error)]
enum InstantiationError {
    #[error("the instance name is empty")]
    EmptyName,
    #[error("FMU type is {found}, expected {CO_SIMULATION} (co-simulation), the only one offered")]
    Type { found: c_int },
    #[error("argument `{argument}` {source}")]
    Text { argument: &'static str, source: TextError },
    #[error(transparent)]
    Location(#[from] LocationError),
    #[error(transparent)]
    Load(#[from] LoadError),
}

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
    let logger = Logger::new(callback, functions.environment, name, loggingOn != 0);
    let instance = guard(|| {
        if name.to_bytes().trim_ascii().is_empty() {
            return Err(InstantiationError::EmptyName);
        }
        if fmuType != CO_SIMULATION {
            return Err(InstantiationError::Type { found: fmuType });
        }
        let argument = |argument| move |source| InstantiationError::Text { argument, source };
        // SAFETY: the host's promise
        let (token, resources) = unsafe { (text(fmuGUID), text(fmuResourceLocation)) };
        let resources = location::directory(resources.map_err(argument("fmuResourceLocation"))?)?;
        Ok(Instance::load(&resources, token.map_err(argument("fmuGUID"))?)?)
    });
    let (status, message) = match instance {
        Ok(Ok(instance)) => {
            logger.log(Status::Ok, &format!("fmi2Instantiate: {}", describe(&instance)));
            return Box::into_raw(Box::new(Component { instance, logger })).cast();
        }
        Ok(Err(error)) => (Status::Error, error.to_string()),
        Err(panic) => (Status::Fatal, panicked(&panic)),
    };
    logger.log(status, &format!("fmi2Instantiate: {message}"));
    null_mut()
}

fn describe(instance: &Instance) -> String {
    let metadata = instance.metadata();
    let (inputs, outputs) = (metadata.inputs.len(), metadata.outputs.len());
    format!("surrogate `{}` of {}, {inputs} inputs, {outputs} outputs", metadata.name, metadata.provenance.tool)
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeInstance(c: *mut c_void) {
    if !c.is_null() {
        // SAFETY: the host's promise
        let component = unsafe { Box::from_raw(c.cast::<Component>()) };
        // nobody is left to be told of a panic
        let _ = guard(|| drop(component));
    }
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
        call(c, Call::SetDebugLogging, |instance| {
            let logger = &mut (*c.cast::<Component>()).logger;
            let on = loggingOn != 0;
            if nCategories == 0 {
                logger.switch_all(on);
            }
            for &category in slice(categories, nCategories, "categories")? {
                if category.is_null() {
                    return Err(Refusal::NullPointer { argument: "categories" });
                }
                let category = CStr::from_ptr(category).to_string_lossy();
                // a warning, not an error: an unknown category is no reason to end a simulation
                if !logger.switch(&category, on) {
                    let (found, expected) = (category.into_owned(), Logger::categories());
                    instance.warn(Warning::UnknownCategory { found, expected });
                }
            }
            Ok(())
        })
    }
}

// ---- Modes -------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetupExperiment(
    c: *mut c_void,
    _toleranceDefined: c_int,
    _tolerance: f64,
    startTime: f64,
    stopTimeDefined: c_int,
    stopTime: f64,
) -> Status {
    let stop = (stopTimeDefined != 0).then_some(stopTime);
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetupExperiment, |instance| instance.set_up_experiment(startTime, stop)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2EnterInitializationMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::EnterInitializationMode, Instance::enter_initialization_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2ExitInitializationMode(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::ExitInitializationMode, |instance| {
            instance.exit_initialization_mode();
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Terminate(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::Terminate, |instance| {
            instance.terminate();
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2Reset(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::Reset, |instance| {
            instance.reset();
            Ok(())
        })
    }
}

// ---- Values ------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetReal(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *mut f64) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetReal, |instance| instance.get(slice(vr, nvr, "vr")?, slice_mut(value, nvr, "value")?)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetReal(c: *mut c_void, vr: *const c_uint, nvr: usize, value: *const f64) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetReal, |instance| instance.set(slice(vr, nvr, "vr")?, slice(value, nvr, "value")?)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetInteger(c: *mut c_void, _vr: *const c_uint, nvr: usize, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetInteger, |_| no_variables("Integer", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetBoolean(c: *mut c_void, _vr: *const c_uint, nvr: usize, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetBoolean, |_| no_variables("Boolean", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *mut *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetString, |_| no_variables("String", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetInteger(c: *mut c_void, _vr: *const c_uint, nvr: usize, _value: *const c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetInteger, |_| no_variables("Integer", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetBoolean(c: *mut c_void, _vr: *const c_uint, nvr: usize, _value: *const c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetBoolean, |_| no_variables("Boolean", nvr)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetString(
    c: *mut c_void,
    _vr: *const c_uint,
    nvr: usize,
    _value: *const *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetString, |_| no_variables("String", nvr)) }
}

fn no_variables(kind: &'static str, count: usize) -> Result<(), Refusal> {
    if count == 0 { Ok(()) } else { Err(Refusal::NoVariableOfType { kind, count }) }
}

// ---- FMU state ---------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetFMUstate, |instance| store(instance.snapshot().clone(), FMUstate)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetFMUstate(c: *mut c_void, FMUstate: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetFMUstate, |instance| instance.restore(stored(FMUstate)?)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2FreeFMUstate(c: *mut c_void, FMUstate: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::FreeFMUstate, |_| {
            if !FMUstate.is_null() && !(*FMUstate).is_null() {
                drop(Box::from_raw((*FMUstate).cast::<Snapshot>()));
                *FMUstate = null_mut();
            }
            Ok(())
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SerializedFMUstateSize(c: *mut c_void, FMUstate: *mut c_void, size: *mut usize) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::SerializedFMUstateSize, |_| write(size, stored(FMUstate)?.size(), "size")) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SerializeFMUstate(
    c: *mut c_void,
    FMUstate: *mut c_void,
    serializedState: *mut u8,
    size: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::SerializeFMUstate, |_| {
            let snapshot = stored(FMUstate)?;
            if size != snapshot.size() {
                return Err(Refusal::StateSize { found: size, expected: snapshot.size() });
            }
            slice_mut(serializedState, size, "serializedState")?.copy_from_slice(&snapshot.to_bytes());
            Ok(())
        })
    }
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
        call(c, Call::DeSerializeFMUstate, |instance| {
            let bytes = slice(serializedState, size, "serializedState")?;
            store(Snapshot::from_bytes(bytes, instance.snapshot())?, FMUstate)
        })
    }
}

/// Puts a snapshot where `state` points: into the state that is there already, or else into a new one.
///
/// # Safety
/// The host's promise.
unsafe fn store(snapshot: Snapshot, state: *mut *mut c_void) -> Result<(), Refusal> {
    if state.is_null() {
        return Err(Refusal::NullPointer { argument: "FMUstate" });
    }
    // SAFETY: not null and the host's promise
    unsafe {
        match (*state).cast::<Snapshot>().as_mut() {
            Some(there) => *there = snapshot,
            None => *state = Box::into_raw(Box::new(snapshot)).cast(),
        }
    }
    Ok(())
}

/// # Safety
/// The host's promise.
unsafe fn stored<'a>(state: *mut c_void) -> Result<&'a Snapshot, Refusal> {
    // SAFETY: the host's promise
    unsafe { state.cast::<Snapshot>().as_ref() }.ok_or(Refusal::NullPointer { argument: "FMUstate" })
}

// ---- Derivatives -------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetDirectionalDerivative(
    c: *mut c_void,
    _vUnknown_ref: *const c_uint,
    _nUnknown: usize,
    _vKnown_ref: *const c_uint,
    _nKnown: usize,
    _dvKnown: *const f64,
    _dvUnknown: *mut f64,
) -> Status {
    let reason = "providesDirectionalDerivative is false";
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetDirectionalDerivative, |_| Err(Refusal::NotOffered { reason })) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2SetRealInputDerivatives(
    c: *mut c_void,
    _vr: *const c_uint,
    _nvr: usize,
    _order: *const c_int,
    _value: *const f64,
) -> Status {
    let reason = "canInterpolateInputs is false, as there are no inputs";
    // SAFETY: the host's promise
    unsafe { call(c, Call::SetRealInputDerivatives, |_| Err(Refusal::NotOffered { reason })) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetRealOutputDerivatives(
    c: *mut c_void,
    _vr: *const c_uint,
    _nvr: usize,
    _order: *const c_int,
    _value: *mut f64,
) -> Status {
    let reason = "maxOutputDerivativeOrder is 0";
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetRealOutputDerivatives, |_| Err(Refusal::NotOffered { reason })) }
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
    unsafe { call(c, Call::DoStep, |instance| instance.do_step(currentCommunicationPoint, communicationStepSize)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2CancelStep(c: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::CancelStep, |_| Ok(())) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetStatus(c: *mut c_void, s: c_int, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetStatus, |_| Err(no_status(s))) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetRealStatus(c: *mut c_void, s: c_int, value: *mut f64) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::GetRealStatus, |instance| match s {
            LAST_SUCCESSFUL_TIME => write(value, instance.time(), "value"),
            _ => Err(no_status(s)),
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetIntegerStatus(c: *mut c_void, s: c_int, _value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetIntegerStatus, |_| Err(no_status(s))) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetBooleanStatus(c: *mut c_void, s: c_int, value: *mut c_int) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(c, Call::GetBooleanStatus, |_| match s {
            TERMINATED => write(value, 0, "value"),
            _ => Err(no_status(s)),
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi2GetStringStatus(c: *mut c_void, s: c_int, _value: *mut *const c_char) -> Status {
    // SAFETY: the host's promise
    unsafe { call(c, Call::GetStringStatus, |_| Err(no_status(s))) }
}

fn no_status(kind: c_int) -> Refusal {
    Refusal::NoStatus { kind, reason: "steps are synchronous and always complete" }
}

// ---- What all calls have in common -------------------------------------------------------------------------------

/// Refuses a null component and a call the state does not allow, keeps panics in, tells the host of everything that
/// is not simply fine.
///
/// # Safety
/// The host's promise.
#[inline]
unsafe fn call(c: *mut c_void, call: Call, body: impl FnOnce(&mut Instance) -> Result<(), Refusal>) -> Status {
    let component = c.cast::<Component>();
    if component.is_null() {
        return Status::Error;
    }
    // SAFETY: not null and the host's promise; only the instance is borrowed, so that the logger stays free
    let instance = unsafe { &mut (*component).instance };
    let answer = guard(|| {
        instance.begin(call)?;
        body(instance)
    });
    match answer {
        Ok(Ok(())) if !instance.has_warnings() => Status::Ok,
        // SAFETY: as above
        _ => unsafe { tell(component, call, answer) },
    }
}

/// # Safety
/// The host's promise, and the component is not null.
#[cold]
unsafe fn tell(component: *mut Component, call: Call, answer: Result<Result<(), Refusal>, String>) -> Status {
    // SAFETY: the caller's promise
    let instance = unsafe { &mut (*component).instance };
    let mut messages: Vec<String> = instance.take_warnings().iter().map(ToString::to_string).collect();
    let mut status = Status::Warning;
    match answer {
        Ok(Ok(())) => {}
        Ok(Err(refusal)) => {
            status = refusal.status();
            messages.push(refusal.to_string());
        }
        Err(panic) => {
            status = Status::Fatal;
            messages.push(panicked(&panic));
        }
    }
    match status {
        Status::Ok | Status::Warning | Status::Discard => {}
        Status::Error => instance.fail(State::Error),
        Status::Fatal => instance.fail(State::Fatal),
    }
    // SAFETY: the caller's promise; the instance is not borrowed any more, should the host call back from its logger
    let logger = unsafe { &(*component).logger };
    for message in messages {
        logger.log(status, &format!("fmi2{call:?}: {message}"));
    }
    status
}

fn panicked(message: &str) -> String {
    format!("a mistake in this library ({message}); free the instance and please report it")
}

#[cfg(test)]
mod tests;
