//! One instance of an FMU: its life from instantiation to its end, and steps of co-simulation.

use super::{
    FmiFunctions, Fmu, InterfaceKind,
    ffi::{self, DISCARD, FATAL, FmiComponent, FmiStatus, WARNING},
    fmi2, fmi3,
    journal::{self, LogMessage, MessageLog},
};
use crate::{Error, Result};
use std::{
    cell::Cell,
    ffi::{CStr, c_int},
    ptr,
};

/// One instance of an FMU, freed when dropped. It stays in the thread that created it; other threads create their own.
///
/// Which call is legal in which state is for the FMU to judge: it returns an error from an illegal one. Calls that the
/// interface of the instance does not have fail with [`Error::MissingFunction`].
#[derive(Debug)]
pub struct FmuInstance<'fmu> {
    pub(super) fmu: &'fmu Fmu,
    component: FmiComponent,
    /// After this the standard forbids every call, even that which frees the instance.
    fatal: Cell<bool>,
    // the FMU keeps their addresses
    journal: Box<MessageLog>,
    _callbacks: Option<Box<fmi2::Callbacks>>,
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepResult {
    /// At its end.
    Done,
    /// The FMU ended the simulation.
    Terminated {
        /// When.
        time: f64,
    },
}

impl<'fmu> FmuInstance<'fmu> {
    pub(super) fn new(fmu: &'fmu Fmu, name: &CStr, token: &CStr, logging: bool) -> Result<Self> {
        let journal = MessageLog::of_instance();
        let resources = fmu.resources.as_ptr();
        let (name, token) = (name.as_ptr(), token.as_ptr());
        let environment = (&raw const *journal).cast_mut().cast();
        let mut callbacks = None;
        let (component, function) = match &fmu.functions {
            FmiFunctions::V2(functions) => {
                let callbacks = callbacks.insert(Box::new(fmi2::Callbacks::new(&journal)));
                let kind = match fmu.interface {
                    InterfaceKind::CoSimulation => fmi2::CO_SIMULATION,
                    InterfaceKind::ModelExchange => fmi2::MODEL_EXCHANGE,
                };
                // SAFETY: the texts end with a zero byte and live until the call returns; callbacks and journal live in
                // boxes until the instance has been freed
                let component = unsafe {
                    (functions.instantiate)(
                        name,
                        kind,
                        token,
                        resources,
                        &raw const **callbacks,
                        fmi2::FALSE,
                        c_bool(logging),
                    )
                };
                (component, "fmi2Instantiate")
            }
            FmiFunctions::V3(fmi3::Fmi3Functions { co_simulation: Some(functions), .. }) => {
                // neither Event Mode nor early return nor intermediate updates are asked for
                // SAFETY: as above
                let component = unsafe {
                    (functions.instantiate)(
                        name,
                        token,
                        resources,
                        0,
                        logging.into(),
                        0,
                        0,
                        ptr::null(),
                        0,
                        environment,
                        journal::log_message,
                        ptr::null(),
                    )
                };
                (component, "fmi3InstantiateCoSimulation")
            }
            FmiFunctions::V3(fmi3::Fmi3Functions { model_exchange: Some(functions), .. }) => {
                // SAFETY: as above
                let component = unsafe {
                    (functions.instantiate)(
                        name,
                        token,
                        resources,
                        0,
                        logging.into(),
                        environment,
                        journal::log_message,
                    )
                };
                (component, "fmi3InstantiateModelExchange")
            }
            FmiFunctions::V3(_) => (ptr::null_mut(), "fmi3Instantiate"),
        };
        if component.is_null() {
            let messages = texts(journal.take_after(0));
            return Err(Error::Fmi { function, status: "no instance", messages });
        }
        Ok(Self { fmu, component, fatal: Cell::new(false), journal, _callbacks: callbacks })
    }

    /// The FMU.
    pub fn fmu(&self) -> &'fmu Fmu {
        self.fmu
    }

    /// Takes the messages that the FMU logged since the last call, except those that an error carries.
    pub fn take_messages(&self) -> Vec<LogMessage> {
        self.journal.take_after(0)
    }

    /// Enters Initialization Mode: tells the FMU when the simulation starts and, if known, stops. What has no effect on the
    /// initialization is set before or after, start values of parameters before.
    ///
    /// # Errors
    /// [`Error::Fmi`] if the FMU refuses; so do all functions of this type.
    pub fn enter_initialization_mode(&self, start: f64, stop: Option<f64>) -> Result<()> {
        let end = stop.unwrap_or(0.0);
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => {
                self.call("fmi2SetupExperiment", |component| {
                    // SAFETY: as for `call`
                    unsafe {
                        (functions.setup_experiment)(component, fmi2::FALSE, 0.0, start, c_bool(stop.is_some()), end)
                    }
                })?;
                let enter = functions.enter_initialization_mode;
                // SAFETY: as for `call`
                self.call("fmi2EnterInitializationMode", |component| unsafe { enter(component) })
            }
            FmiFunctions::V3(functions) => self.call("fmi3EnterInitializationMode", |component| {
                let enter = functions.enter_initialization_mode;
                // SAFETY: as for `call`
                unsafe { enter(component, 0, 0.0, start, stop.is_some().into(), end) }
            }),
        }
    }

    /// Leaves Initialization Mode: outputs at the start time are known, and steps may follow; in model exchange, Event
    /// Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn exit_initialization_mode(&self) -> Result<()> {
        let (name, function) = match &self.fmu.functions {
            FmiFunctions::V2(functions) => ("fmi2ExitInitializationMode", functions.exit_initialization_mode),
            FmiFunctions::V3(functions) => ("fmi3ExitInitializationMode", functions.exit_initialization_mode),
        };
        // SAFETY: as for `call`
        self.call(name, |component| unsafe { function(component) })
    }

    /// Computes from time `time` to `time + step`.
    ///
    /// # Errors
    /// [`Error::Fmi`]; also if the FMU computes the step asynchronously, or discards it without ending the simulation.
    pub fn do_step(&self, time: f64, step: f64) -> Result<StepResult> {
        match &self.fmu.functions {
            FmiFunctions::V2(fmi2::Fmi2Functions { co_simulation: Some(functions), .. }) => {
                self.do_step_2(functions, time, step)
            }
            FmiFunctions::V3(fmi3::Fmi3Functions { co_simulation: Some(functions), .. }) => {
                self.do_step_3(functions, time, step)
            }
            _ => Err(self.missing("DoStep")),
        }
    }

    fn do_step_2(&self, functions: &fmi2::Fmi2CoSimulation, time: f64, step: f64) -> Result<StepResult> {
        let mut status = 0;
        let result = self.call("fmi2DoStep", |component| {
            // SAFETY: as for `call`
            status = unsafe { (functions.do_step)(component, time, step, fmi2::TRUE) };
            status
        });
        if status != DISCARD {
            return result.map(|()| StepResult::Done);
        }
        // an FMU that ends the simulation discards the step and reports that in its status
        let (mut terminated, mut last) = (fmi2::FALSE, time);
        if let (Some(boolean), Some(real)) = (functions.get_boolean_status, functions.get_real_status) {
            let status = self.call("fmi2GetBooleanStatus", |component| {
                // SAFETY: as for `call`
                unsafe { boolean(component, fmi2::TERMINATED, &raw mut terminated) }
            });
            if status.is_ok() && terminated != fmi2::FALSE {
                self.call("fmi2GetRealStatus", |component| {
                    // SAFETY: as for `call`
                    unsafe { real(component, fmi2::LAST_SUCCESSFUL_TIME, &raw mut last) }
                })?;
                return Ok(StepResult::Terminated { time: last });
            }
        }
        result.map(|()| StepResult::Done)
    }

    fn do_step_3(&self, functions: &fmi3::Fmi3CoSimulation, time: f64, step: f64) -> Result<StepResult> {
        let (mut event, mut terminate, mut early, mut last) = (0, 0, 0, time);
        self.call("fmi3DoStep", |component| {
            // SAFETY: as for `call`; the results are written to living variables
            unsafe {
                (functions.do_step)(
                    component,
                    time,
                    step,
                    1,
                    &raw mut event,
                    &raw mut terminate,
                    &raw mut early,
                    &raw mut last,
                )
            }
        })?;
        Ok(if terminate == 0 { StepResult::Done } else { StepResult::Terminated { time: last } })
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn terminate(&self) -> Result<()> {
        let (name, function) = match &self.fmu.functions {
            FmiFunctions::V2(functions) => ("fmi2Terminate", functions.terminate),
            FmiFunctions::V3(functions) => ("fmi3Terminate", functions.terminate),
        };
        // SAFETY: as for `call`
        self.call(name, |component| unsafe { function(component) })
    }

    /// Back to the state after instantiation, start values included.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn reset(&self) -> Result<()> {
        let (name, function) = match &self.fmu.functions {
            FmiFunctions::V2(functions) => ("fmi2Reset", functions.reset),
            FmiFunctions::V3(functions) => ("fmi3Reset", functions.reset),
        };
        // SAFETY: as for `call`
        self.call(name, |component| unsafe { function(component) })
    }

    /// A function that the FMU need not have.
    pub(super) fn offered<T>(&self, name: &'static str, function: Option<T>) -> Result<T> {
        function.ok_or_else(|| self.missing(name))
    }

    pub(super) fn missing(&self, function: &'static str) -> Error {
        Error::MissingFunction { path: self.fmu.path.clone(), function }
    }

    /// Calls a function with the component, which is valid while `self` lives and no fatal error has occurred; the
    /// library outlives it.
    pub(super) fn call(&self, function: &'static str, call: impl FnOnce(FmiComponent) -> FmiStatus) -> Result<()> {
        if self.fatal.get() {
            return Err(Error::Fmi { function, status: "nothing: an earlier call was fatal", messages: Vec::new() });
        }
        let before = self.journal.count();
        let status = call(self.component);
        if (0..=WARNING).contains(&status) {
            return Ok(());
        }
        self.fatal.set(status == FATAL);
        Err(Error::Fmi { function, status: ffi::status_name(status), messages: texts(self.journal.take_after(before)) })
    }
}

impl Drop for FmuInstance<'_> {
    fn drop(&mut self) {
        if !self.fatal.get() {
            let free = match &self.fmu.functions {
                FmiFunctions::V2(functions) => functions.free_instance,
                FmiFunctions::V3(functions) => functions.free_instance,
            };
            // SAFETY: the component is valid and is not used again
            unsafe { free(self.component) }
        }
    }
}

pub(super) fn c_bool(value: bool) -> c_int {
    if value { fmi2::TRUE } else { fmi2::FALSE }
}

fn texts(messages: Vec<LogMessage>) -> Vec<String> {
    messages.into_iter().map(|message| message.text).collect()
}
