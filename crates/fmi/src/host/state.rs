//! States of an instance, taken and put back.

use super::{
    FmiFunctions, FmuInstance,
    ffi::{StateFunctions, StatePointer},
};
use crate::Result;
use std::ptr;

/// A state taken from an [`FmuInstance`], freed when dropped.
#[derive(Debug)]
pub struct FmuState<'instance> {
    instance: &'instance FmuInstance<'instance>,
    pointer: StatePointer,
}

impl FmuInstance<'_> {
    fn states(&self) -> &StateFunctions {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => &functions.states,
            FmiFunctions::V3(functions) => &functions.states,
        }
    }

    /// Takes the state.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that has no states to offer.
    ///
    /// [`Error::Fmi`]: crate::Error::Fmi
    /// [`Error::MissingFunction`]: crate::Error::MissingFunction
    pub fn state(&self) -> Result<FmuState<'_>> {
        let function = self.offered("GetFMUState", self.states().get)?;
        let mut pointer = ptr::null_mut();
        // SAFETY: as for `call`; a null pointer asks the FMU to allocate a new state
        self.call("GetFMUState", |component| unsafe { function(component, &raw mut pointer) })?;
        Ok(FmuState { instance: self, pointer })
    }

    /// A state from the bytes of [`FmuState::to_bytes`], of this or another instance of the same FMU and interface.
    ///
    /// # Errors
    /// As [`FmuInstance::state`].
    pub fn state_from_bytes(&self, bytes: &[u8]) -> Result<FmuState<'_>> {
        let function = self.offered("DeserializeFMUState", self.states().deserialize)?;
        let mut pointer = ptr::null_mut();
        self.call("DeserializeFMUState", |component| {
            // SAFETY: as for `call`; pointer and length are those of a slice
            unsafe { function(component, bytes.as_ptr(), bytes.len(), &raw mut pointer) }
        })?;
        Ok(FmuState { instance: self, pointer })
    }
}

impl FmuState<'_> {
    /// Puts the instance back into this state.
    ///
    /// # Errors
    /// As [`FmuInstance::state`].
    pub fn restore(&self) -> Result<()> {
        let function = self.instance.offered("SetFMUState", self.instance.states().set)?;
        // SAFETY: as for `call`; the state is one of this instance
        self.instance.call("SetFMUState", |component| unsafe { function(component, self.pointer) })
    }

    /// The state as bytes.
    ///
    /// # Errors
    /// As [`FmuInstance::state`].
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        let functions = self.instance.states();
        let size_of = self.instance.offered("SerializedFMUStateSize", functions.size)?;
        let serialize = self.instance.offered("SerializeFMUState", functions.serialize)?;
        let mut size = 0;
        self.instance.call("SerializedFMUStateSize", |component| {
            // SAFETY: as for `call`; the state is one of this instance
            unsafe { size_of(component, self.pointer, &raw mut size) }
        })?;
        let mut bytes = vec![0; size];
        self.instance.call("SerializeFMUState", |component| {
            // SAFETY: as above; the array has the length that is passed
            unsafe { serialize(component, self.pointer, bytes.as_mut_ptr(), bytes.len()) }
        })?;
        Ok(bytes)
    }
}

impl Drop for FmuState<'_> {
    fn drop(&mut self) {
        if let Some(free) = self.instance.states().free {
            // a failure here leaves nothing to be done
            // SAFETY: as for `call`; the state is one of this instance and is not used again
            let _ = self.instance.call("FreeFMUState", |component| unsafe { free(component, &raw mut self.pointer) });
        }
    }
}
