//! One instance of an FMU.

use super::{
    Fmu,
    ffi::{
        self, CO_SIMULATION, Callbacks, Component, DISCARD, FALSE, FATAL, LAST_SUCCESSFUL_TIME, StatePointer, Status,
        TERMINATED, TRUE, WARNING,
    },
    journal::{Journal, LogMessage},
};
use crate::{Error, Result};
use std::{
    cell::Cell,
    ffi::{CStr, c_int},
    ptr,
};

/// One instance of an FMU, freed when dropped. It stays in the thread that made it; other threads make their own.
///
/// Which call is legal in which state is for the FMU to judge: it answers an illegal one with an error.
#[derive(Debug)]
pub struct Instance<'fmu> {
    fmu: &'fmu Fmu,
    component: Component,
    /// After this the standard forbids every call, even that which frees the instance.
    fatal: Cell<bool>,
    // the FMU keeps their addresses
    journal: Box<Journal>,
    _callbacks: Box<Callbacks>,
}

/// How a step ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step {
    /// At its end.
    Done,
    /// The FMU ended the simulation.
    Terminated {
        /// When.
        time: f64,
    },
}

/// A state taken from an [`Instance`], freed when dropped.
#[derive(Debug)]
pub struct State<'instance> {
    instance: &'instance Instance<'instance>,
    pointer: StatePointer,
}

impl<'fmu> Instance<'fmu> {
    pub(super) fn new(fmu: &'fmu Fmu, name: &CStr, token: &CStr, logging: bool) -> Result<Self> {
        let journal = Box::<Journal>::default();
        let callbacks = Box::new(Callbacks::new(&journal));
        // SAFETY: the texts end with a zero byte and live until the call returns; callbacks and journal live in boxes
        // until the instance has been freed
        let component = unsafe {
            (fmu.functions.instantiate)(
                name.as_ptr(),
                CO_SIMULATION,
                token.as_ptr(),
                fmu.resources.as_ptr(),
                &raw const *callbacks,
                FALSE,
                c_bool(logging),
            )
        };
        if component.is_null() {
            let messages = texts(journal.take_after(0));
            return Err(Error::Fmi { function: "fmi2Instantiate", status: "no instance", messages });
        }
        Ok(Self { fmu, component, fatal: Cell::new(false), journal, _callbacks: callbacks })
    }

    /// The FMU.
    pub fn fmu(&self) -> &'fmu Fmu {
        self.fmu
    }

    /// What the FMU has logged since the last call of this, but for what an error carries along.
    pub fn take_messages(&self) -> Vec<LogMessage> {
        self.journal.take_after(0)
    }

    /// Tells the FMU when the simulation starts and, perhaps, stops.
    ///
    /// # Errors
    /// [`Error::Fmi`] if the FMU refuses; so do all functions of this type.
    pub fn setup_experiment(&self, start: f64, stop: Option<f64>) -> Result<()> {
        let function = self.fmu.functions.setup_experiment;
        self.call("fmi2SetupExperiment", |component| {
            // SAFETY: as for `call`
            unsafe { function(component, FALSE, 0.0, start, c_bool(stop.is_some()), stop.unwrap_or(0.0)) }
        })
    }

    /// Enters Initialization Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn enter_initialization_mode(&self) -> Result<()> {
        // SAFETY: as for `call`
        self.call("fmi2EnterInitializationMode", |c| unsafe { (self.fmu.functions.enter_initialization_mode)(c) })
    }

    /// Leaves Initialization Mode: outputs at the start time are known, and steps may follow.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn exit_initialization_mode(&self) -> Result<()> {
        // SAFETY: as for `call`
        self.call("fmi2ExitInitializationMode", |c| unsafe { (self.fmu.functions.exit_initialization_mode)(c) })
    }

    /// Computes from time `time` to `time + step`.
    ///
    /// # Errors
    /// [`Error::Fmi`]; also when the FMU computes the step asynchronously, or discards it and would go on.
    pub fn do_step(&self, time: f64, step: f64) -> Result<Step> {
        let functions = &self.fmu.functions;
        let mut status = 0;
        let result = self.call("fmi2DoStep", |component| {
            // SAFETY: as for `call`
            status = unsafe { (functions.do_step)(component, time, step, TRUE) };
            status
        });
        if status != DISCARD {
            return result.map(|()| Step::Done);
        }
        // an FMU that wants to end the simulation discards the step and says so when asked
        let (mut terminated, mut last) = (FALSE, time);
        if let (Some(boolean), Some(real)) = (functions.get_boolean_status, functions.get_real_status) {
            let answer = self.call("fmi2GetBooleanStatus", |component| {
                // SAFETY: as for `call`
                unsafe { boolean(component, TERMINATED, &raw mut terminated) }
            });
            if answer.is_ok() && terminated != FALSE {
                // SAFETY: as for `call`
                self.call("fmi2GetRealStatus", |c| unsafe { real(c, LAST_SUCCESSFUL_TIME, &raw mut last) })?;
                return Ok(Step::Terminated { time: last });
            }
        }
        result.map(|()| Step::Done)
    }

    /// Ends the simulation.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn terminate(&self) -> Result<()> {
        // SAFETY: as for `call`
        self.call("fmi2Terminate", |c| unsafe { (self.fmu.functions.terminate)(c) })
    }

    /// Back to the state after instantiation, start values included.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn reset(&self) -> Result<()> {
        // SAFETY: as for `call`
        self.call("fmi2Reset", |c| unsafe { (self.fmu.functions.reset)(c) })
    }

    /// Values of real variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_real(&self, references: &[u32], values: &mut [f64]) -> Result<()> {
        self.get("fmi2GetReal", self.fmu.functions.get_real, references, values)
    }

    /// Sets real variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_real(&self, references: &[u32], values: &[f64]) -> Result<()> {
        self.set("fmi2SetReal", self.fmu.functions.set_real, references, values)
    }

    /// Values of integer and enumeration variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_integer(&self, references: &[u32], values: &mut [i32]) -> Result<()> {
        self.get("fmi2GetInteger", self.fmu.functions.get_integer, references, values)
    }

    /// Sets integer and enumeration variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_integer(&self, references: &[u32], values: &[i32]) -> Result<()> {
        self.set("fmi2SetInteger", self.fmu.functions.set_integer, references, values)
    }

    /// Values of boolean variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_boolean(&self, references: &[u32], values: &mut [bool]) -> Result<()> {
        let mut numbers = vec![FALSE; values.len()];
        self.get("fmi2GetBoolean", self.fmu.functions.get_boolean, references, &mut numbers)?;
        values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number != FALSE);
        Ok(())
    }

    /// Sets boolean variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_boolean(&self, references: &[u32], values: &[bool]) -> Result<()> {
        let numbers: Vec<c_int> = values.iter().map(|&value| c_bool(value)).collect();
        self.set("fmi2SetBoolean", self.fmu.functions.set_boolean, references, &numbers)
    }

    /// Takes the state.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that has no states to offer.
    pub fn state(&self) -> Result<State<'_>> {
        let function = self.offered("fmi2GetFMUstate", self.fmu.functions.get_state)?;
        let mut pointer = ptr::null_mut();
        // SAFETY: as for `call`; a null pointer asks the FMU to allocate a new state
        self.call("fmi2GetFMUstate", |component| unsafe { function(component, &raw mut pointer) })?;
        Ok(State { instance: self, pointer })
    }

    /// A state from the bytes of [`State::to_bytes`], of this or another instance of the same FMU.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that has no states to offer.
    pub fn state_from_bytes(&self, bytes: &[u8]) -> Result<State<'_>> {
        let function = self.offered("fmi2DeSerializeFMUstate", self.fmu.functions.deserialize_state)?;
        let mut pointer = ptr::null_mut();
        self.call("fmi2DeSerializeFMUstate", |component| {
            // SAFETY: as for `call`; pointer and length are those of a slice
            unsafe { function(component, bytes.as_ptr(), bytes.len(), &raw mut pointer) }
        })?;
        Ok(State { instance: self, pointer })
    }

    fn get<T>(
        &self,
        name: &'static str,
        function: ffi::GetValues<T>,
        references: &[u32],
        values: &mut [T],
    ) -> Result<()> {
        assert_eq!(references.len(), values.len(), "one value per value reference");
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the length that is passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_mut_ptr()) }
        })
    }

    fn set<T>(&self, name: &'static str, function: ffi::SetValues<T>, references: &[u32], values: &[T]) -> Result<()> {
        assert_eq!(references.len(), values.len(), "one value per value reference");
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the length that is passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_ptr()) }
        })
    }

    fn offered<T>(&self, name: &'static str, function: Option<T>) -> Result<T> {
        function.ok_or_else(|| Error::MissingFunction { path: self.fmu.path.clone(), function: name })
    }

    /// Calls a function with the component, which is valid for as long as `self` lives and nothing fatal has happened;
    /// the library is loaded for longer than that.
    fn call(&self, function: &'static str, call: impl FnOnce(Component) -> Status) -> Result<()> {
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

impl Drop for Instance<'_> {
    fn drop(&mut self) {
        if !self.fatal.get() {
            // SAFETY: the component is valid and is not used again
            unsafe { (self.fmu.functions.free_instance)(self.component) }
        }
    }
}

impl State<'_> {
    /// Puts the instance back into this state.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    pub fn restore(&self) -> Result<()> {
        let function = self.instance.offered("fmi2SetFMUstate", self.instance.fmu.functions.set_state)?;
        // SAFETY: as for `call`; the state is one of this instance
        self.instance.call("fmi2SetFMUstate", |component| unsafe { function(component, self.pointer) })
    }

    /// The state as bytes.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that cannot serialize.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let functions = &self.instance.fmu.functions;
        let size_of = self.instance.offered("fmi2SerializedFMUstateSize", functions.serialized_state_size)?;
        let serialize = self.instance.offered("fmi2SerializeFMUstate", functions.serialize_state)?;
        let mut size = 0;
        self.instance.call("fmi2SerializedFMUstateSize", |component| {
            // SAFETY: as for `call`; the state is one of this instance
            unsafe { size_of(component, self.pointer, &raw mut size) }
        })?;
        let mut bytes = vec![0; size];
        self.instance.call("fmi2SerializeFMUstate", |component| {
            // SAFETY: as above; the array has the length that is passed
            unsafe { serialize(component, self.pointer, bytes.as_mut_ptr(), bytes.len()) }
        })?;
        Ok(bytes)
    }
}

impl Drop for State<'_> {
    fn drop(&mut self) {
        if let Some(free) = self.instance.fmu.functions.free_state {
            // a failure here leaves nothing to be done
            // SAFETY: as for `call`; the state is one of this instance and is not used again
            let _ = self.instance.call("fmi2FreeFMUstate", |c| unsafe { free(c, &raw mut self.pointer) });
        }
    }
}

fn c_bool(value: bool) -> c_int {
    if value { TRUE } else { FALSE }
}

fn texts(messages: Vec<LogMessage>) -> Vec<String> {
    messages.into_iter().map(|message| message.text).collect()
}
