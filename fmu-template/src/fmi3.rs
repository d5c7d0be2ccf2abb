//! The C functions of FMI 3.0. Each one turns its arguments into Rust's and asks the instance. For the host's promise
//! in the `SAFETY` comments see `component`.
//!
//! `fmi3Boolean` is C's `bool`, read as a byte: no value a host could put there is undefined in Rust.

#![allow(non_snake_case)] // the standard's names

use crate::{
    boundary::{count, not_null, slice, slice_mut, text, write},
    component::{
        Component, InstantiationError, UpdateCallback, Updates, call, call_often, deserialize, free, free_state,
        instantiate, serialize, state_size, store, stored, switch_logging,
    },
    instance::{Instance, InstanceKind},
    location,
    logger::{Callback3, Logger},
    state::{Interface, Version},
    status::{Refusal, Status},
};
use std::{
    ffi::{c_char, c_void},
    path::PathBuf,
};
use table::Function;
use updates::step_with_updates;

mod clocks;
mod derivatives;
mod model_exchange;
mod table;
mod updates;
mod values;

/// `fmi3Boolean`
type Boolean = u8;

// ---- Version, instances, logging ---------------------------------------------------------------------------------

#[unsafe(no_mangle)]
extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateModelExchange(
    instanceName: *const c_char,
    instantiationToken: *const c_char,
    resourcePath: *const c_char,
    _visible: Boolean,
    loggingOn: Boolean,
    instanceEnvironment: *mut c_void,
    logMessage: Option<Callback3>,
) -> *mut c_void {
    let logger = Logger::fmi3(logMessage, instanceEnvironment, loggingOn != 0);
    let kind = InstanceKind { version: Version::Fmi3, interface: Interface::ModelExchange, event_mode: true };
    // SAFETY: the host's promise
    unsafe {
        instantiate("fmi3InstantiateModelExchange", instanceName, logger, None, &|| {
            arguments(kind, instantiationToken, resourcePath)
        })
    }
}

/// Models with states call the host back after each step of their solver; in others a step is one evaluation, and the offer goes unused.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateCoSimulation(
    instanceName: *const c_char,
    instantiationToken: *const c_char,
    resourcePath: *const c_char,
    _visible: Boolean,
    loggingOn: Boolean,
    eventModeUsed: Boolean,
    earlyReturnAllowed: Boolean,
    requiredIntermediateVariables: *const u32,
    nRequiredIntermediateVariables: usize,
    instanceEnvironment: *mut c_void,
    logMessage: Option<Callback3>,
    intermediateUpdate: Option<UpdateCallback>,
) -> *mut c_void {
    const NAME: &str = "fmi3InstantiateCoSimulation";
    let logger = Logger::fmi3(logMessage, instanceEnvironment, loggingOn != 0);
    let kind =
        InstanceKind { version: Version::Fmi3, interface: Interface::CoSimulation, event_mode: eventModeUsed != 0 };
    let updates = intermediateUpdate.map(|callback| Updates {
        callback,
        environment: instanceEnvironment,
        early_return: earlyReturnAllowed != 0,
    });
    // SAFETY: the host's promise
    unsafe {
        let required =
            slice(requiredIntermediateVariables, nRequiredIntermediateVariables, "requiredIntermediateVariables");
        match required {
            Ok(required) => {
                let updates = updates.map(|updates| (updates, required));
                instantiate(NAME, instanceName, logger, updates, &|| arguments(kind, instantiationToken, resourcePath))
            }
            Err(refusal) => {
                instantiate(NAME, instanceName, logger, None, &|| Err(InstantiationError::Argument(refusal.clone())))
            }
        }
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateScheduledExecution(
    instanceName: *const c_char,
    _instantiationToken: *const c_char,
    _resourcePath: *const c_char,
    _visible: Boolean,
    loggingOn: Boolean,
    instanceEnvironment: *mut c_void,
    logMessage: Option<Callback3>,
    _clockUpdate: *const c_void,
    _lockPreemption: *const c_void,
    _unlockPreemption: *const c_void,
) -> *mut c_void {
    let logger = Logger::fmi3(logMessage, instanceEnvironment, loggingOn != 0);
    // SAFETY: the host's promise
    unsafe {
        instantiate("fmi3InstantiateScheduledExecution", instanceName, logger, None, &|| {
            Err(InstantiationError::ScheduledExecution)
        })
    }
}

/// # Safety
/// The host's promise.
unsafe fn arguments(
    kind: InstanceKind,
    token: *const c_char,
    resources: *const c_char,
) -> Result<(InstanceKind, String, PathBuf), InstantiationError> {
    // SAFETY: the host's promise
    let (token, resources) = unsafe { (text(token), text(resources)) };
    let resources = resources.map_err(InstantiationError::text("resourcePath"))?;
    let token = token.map_err(InstantiationError::text("instantiationToken"))?.to_owned();
    Ok((kind, token, location::native(resources)?))
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeInstance(instance: *mut c_void) {
    // SAFETY: the host's promise
    unsafe { free(instance) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetDebugLogging(
    instance: *mut c_void,
    loggingOn: Boolean,
    nCategories: usize,
    categories: *const *const c_char,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::SetDebugLogging, |inner| {
            switch_logging(instance, inner, loggingOn != 0, nCategories, categories)
        })
    }
}

// ---- Modes -------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterInitializationMode(
    instance: *mut c_void,
    toleranceDefined: Boolean,
    tolerance: f64,
    startTime: f64,
    stopTimeDefined: Boolean,
    stopTime: f64,
) -> Status {
    let stop = (stopTimeDefined != 0).then_some(stopTime);
    let tolerance = (toleranceDefined != 0).then_some(tolerance);
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::EnterInitializationMode, |instance| {
            instance.set_up_experiment(startTime, stop, tolerance)?;
            instance.enter_initialization_mode()
        })
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3ExitInitializationMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::ExitInitializationMode, Instance::exit_initialization_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterEventMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::EnterEventMode, Instance::enter_event_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3Terminate(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::Terminate, Instance::terminate) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3Reset(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::Reset, Instance::reset) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterConfigurationMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::EnterConfigurationMode, |_| Ok(())) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3ExitConfigurationMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::ExitConfigurationMode, |_| Ok(())) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EvaluateDiscreteStates(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::EvaluateDiscreteStates, |_| Ok(())) }
}

/// There are neither states nor events.
#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3UpdateDiscreteStates(
    instance: *mut c_void,
    discreteStatesNeedUpdate: *mut Boolean,
    terminateSimulation: *mut Boolean,
    nominalsOfContinuousStatesChanged: *mut Boolean,
    valuesOfContinuousStatesChanged: *mut Boolean,
    nextEventTimeDefined: *mut Boolean,
    nextEventTime: *mut f64,
) -> Status {
    let booleans = [
        (discreteStatesNeedUpdate, "discreteStatesNeedUpdate"),
        (terminateSimulation, "terminateSimulation"),
        (nominalsOfContinuousStatesChanged, "nominalsOfContinuousStatesChanged"),
        (valuesOfContinuousStatesChanged, "valuesOfContinuousStatesChanged"),
        (nextEventTimeDefined, "nextEventTimeDefined"),
    ];
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::UpdateDiscreteStates, |_| {
            booleans.into_iter().try_for_each(|(pointer, argument)| not_null(pointer, argument))?;
            write(nextEventTime, 0.0, "nextEventTime")?;
            booleans.into_iter().try_for_each(|(pointer, argument)| write(pointer, 0, argument))
        })
    }
}

// ---- Steps -------------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterStepMode(instance: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::EnterStepMode, Instance::enter_step_mode) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3DoStep(
    instance: *mut c_void,
    currentCommunicationPoint: f64,
    communicationStepSize: f64,
    _noSetFMUStatePriorToCurrentPoint: Boolean,
    eventHandlingNeeded: *mut Boolean,
    terminateSimulation: *mut Boolean,
    earlyReturn: *mut Boolean,
    lastSuccessfulTime: *mut f64,
) -> Status {
    let mut updates = None;
    // SAFETY: the host's promise
    unsafe {
        let status = call_often(instance, Function::DoStep, |inner| {
            not_null(eventHandlingNeeded, "eventHandlingNeeded")?;
            not_null(terminateSimulation, "terminateSimulation")?;
            not_null(earlyReturn, "earlyReturn")?;
            not_null(lastSuccessfulTime, "lastSuccessfulTime")?;
            write(eventHandlingNeeded, 0, "eventHandlingNeeded")?;
            write(terminateSimulation, 0, "terminateSimulation")?;
            write(earlyReturn, 0, "earlyReturn")?;
            // another field than the instance
            updates = (*instance.cast::<Component>()).updates;
            if updates.is_some() {
                return Ok(());
            }
            let answer = inner.do_step(currentCommunicationPoint, communicationStepSize);
            write(lastSuccessfulTime, inner.time(), "lastSuccessfulTime")?;
            answer
        });
        match updates {
            Some(updates) => {
                let (status, early) =
                    step_with_updates(instance, updates, currentCommunicationPoint, communicationStepSize);
                *earlyReturn = early.into();
                *lastSuccessfulTime = (*instance.cast::<Component>()).instance.time();
                status
            }
            None => status,
        }
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3ActivateModelPartition(
    instance: *mut c_void,
    _clockReference: u32,
    _activationTime: f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::ActivateModelPartition, |_| Ok(())) }
}

// ---- FMU state ---------------------------------------------------------------------------------------------------

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetFMUState(instance: *mut c_void, FMUState: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetFMUState, |instance| store(instance.snapshot(), FMUState, "FMUState")) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetFMUState(instance: *mut c_void, FMUState: *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetFMUState, |instance| instance.restore(stored(FMUState, "FMUState")?)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeFMUState(instance: *mut c_void, FMUState: *mut *mut c_void) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::FreeFMUState, |_| free_state(FMUState)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SerializedFMUStateSize(
    instance: *mut c_void,
    FMUState: *mut c_void,
    size: *mut usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SerializedFMUStateSize, |_| state_size(FMUState, "FMUState", size)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SerializeFMUState(
    instance: *mut c_void,
    FMUState: *mut c_void,
    serializedState: *mut u8,
    size: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SerializeFMUState, |_| serialize(FMUState, "FMUState", serializedState, size)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3DeserializeFMUState(
    instance: *mut c_void,
    serializedState: *const u8,
    size: usize,
    FMUState: *mut *mut c_void,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::DeserializeFMUState, |instance| {
            deserialize(instance, serializedState, size, FMUState, "FMUState")
        })
    }
}

#[cfg(test)]
mod tests;
