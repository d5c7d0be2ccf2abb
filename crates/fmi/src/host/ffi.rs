//! Types that the C interfaces of both versions share, and the search for functions in a library.

use crate::{Error, Result};
use libloading::Library;
use std::{
    ffi::{c_int, c_void},
    path::Path,
};

/// `fmi2Component`, `fmi3Instance`.
pub type FmiComponent = *mut c_void;
/// `fmi2FMUstate`, `fmi3FMUState`.
pub type StatePointer = *mut c_void;
/// `fmi2Status`, `fmi3Status`.
pub type FmiStatus = c_int;

pub const WARNING: FmiStatus = 1;
pub const DISCARD: FmiStatus = 2;
pub const FATAL: FmiStatus = 4;

/// Name of a status.
pub fn status_name(status: FmiStatus) -> &'static str {
    ["ok", "warning", "discard", "error", "fatal", "pending"]
        .get(status as usize)
        .copied()
        .unwrap_or("an unknown status")
}

// Signatures that both versions have, with numbers in place of enumerations.
pub type Simple = unsafe extern "C" fn(FmiComponent) -> FmiStatus;
pub type Free = unsafe extern "C" fn(FmiComponent);
pub type GetState = unsafe extern "C" fn(FmiComponent, *mut StatePointer) -> FmiStatus;
pub type SetState = unsafe extern "C" fn(FmiComponent, StatePointer) -> FmiStatus;
pub type StateSize = unsafe extern "C" fn(FmiComponent, StatePointer, *mut usize) -> FmiStatus;
pub type SerializeState = unsafe extern "C" fn(FmiComponent, StatePointer, *mut u8, usize) -> FmiStatus;
pub type DeserializeState = unsafe extern "C" fn(FmiComponent, *const u8, usize, *mut StatePointer) -> FmiStatus;
pub type SetTime = unsafe extern "C" fn(FmiComponent, f64) -> FmiStatus;
pub type GetReals = unsafe extern "C" fn(FmiComponent, *mut f64, usize) -> FmiStatus;
pub type SetReals = unsafe extern "C" fn(FmiComponent, *const f64, usize) -> FmiStatus;

/// Functions for states, of FMUs that have them.
#[derive(Debug, Default)]
pub struct StateFunctions {
    pub get: Option<GetState>,
    pub set: Option<SetState>,
    pub free: Option<GetState>,
    pub size: Option<StateSize>,
    pub serialize: Option<SerializeState>,
    pub deserialize: Option<DeserializeState>,
}

/// Functions of model exchange that look the same in both versions.
#[derive(Debug)]
pub struct ExchangeFunctions {
    pub enter_event_mode: Simple,
    pub enter_continuous_time_mode: Simple,
    pub set_time: SetTime,
    pub set_continuous_states: SetReals,
    pub get_continuous_states: GetReals,
    pub get_derivatives: GetReals,
    pub get_event_indicators: GetReals,
    pub get_nominals: GetReals,
}

/// Finds functions in the library of the FMU at `path`.
pub struct Finder<'a> {
    pub library: &'a Library,
    pub path: &'a Path,
}

impl Finder<'_> {
    /// # Safety
    /// `T` must be the type of the function of that name.
    pub unsafe fn optional<T: Copy>(&self, function: &str) -> Option<T> {
        // SAFETY: as asked of the caller; the library outlives the table of functions, both being fields of `Fmu`
        unsafe { self.library.get::<T>(function).ok().map(|symbol| *symbol) }
    }

    /// # Safety
    /// As for `optional`.
    pub unsafe fn required<T: Copy>(&self, function: &'static str) -> Result<T> {
        // SAFETY: as asked of the caller
        let found = unsafe { self.optional(function) };
        found.ok_or_else(|| Error::MissingFunction { path: self.path.to_owned(), function })
    }
}

/// Functions that a library does not export, of some that are needed.
pub fn missing(library: &Library, functions: &[&[&'static str]]) -> Vec<&'static str> {
    let finder = Finder { library, path: Path::new("") };
    let mut missing = functions.concat();
    // SAFETY: the address is not used
    missing.retain(|function| unsafe { finder.optional::<*const c_void>(function) }.is_none());
    missing
}
