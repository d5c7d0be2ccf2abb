//! The C interface of FMI 2.0 for co-simulation, as a table of functions found in a library.

use super::journal::Journal;
use crate::{Error, Result};
use libloading::Library;
use std::{
    ffi::{c_char, c_int, c_void},
    path::Path,
};

pub type Component = *mut c_void;
pub type StatePointer = *mut c_void;
pub type Status = c_int;

/// `fmi2True`.
pub const TRUE: c_int = 1;
/// `fmi2False`.
pub const FALSE: c_int = 0;
/// `fmi2CoSimulation`.
pub const CO_SIMULATION: c_int = 1;

pub const WARNING: Status = 1;
pub const DISCARD: Status = 2;
pub const FATAL: Status = 4;

/// `fmi2LastSuccessfulTime`, to be asked for by `fmi2GetRealStatus`.
pub const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`, to be asked for by `fmi2GetBooleanStatus`.
pub const TERMINATED: c_int = 3;

/// Name of a status.
pub fn status_name(status: Status) -> &'static str {
    ["ok", "warning", "discard", "error", "fatal", "pending"]
        .get(status as usize)
        .copied()
        .unwrap_or("an unknown status")
}

/// `fmi2CallbackFunctions`.
#[repr(C)]
#[derive(Debug)]
pub struct Callbacks {
    /// C-variadic; Rust only hands its address on.
    logger: unsafe extern "C" fn(),
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    step_finished: Option<unsafe extern "C" fn(*mut c_void, Status)>,
    environment: *const Journal,
}

unsafe extern "C" {
    /// In logger.c.
    fn metafmu_logger();
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(pointer: *mut c_void);
}

impl Callbacks {
    /// The journal must outlive every use of the callbacks.
    pub fn new(journal: &Journal) -> Self {
        Self {
            logger: metafmu_logger,
            allocate_memory: calloc,
            free_memory: free,
            // steps are not asynchronous
            step_finished: None,
            environment: journal,
        }
    }
}

pub type GetState = unsafe extern "C" fn(Component, *mut StatePointer) -> Status;
pub type GetValues<T> = unsafe extern "C" fn(Component, *const u32, usize, *mut T) -> Status;
pub type SetValues<T> = unsafe extern "C" fn(Component, *const u32, usize, *const T) -> Status;
type GetStatus<T> = unsafe extern "C" fn(Component, c_int, *mut T) -> Status;
type Simple = unsafe extern "C" fn(Component) -> Status;

/// The functions that are used; some FMUs lack those for states and details of a step because they offer neither.
#[derive(Debug)]
pub struct Functions {
    pub get_types_platform: unsafe extern "C" fn() -> *const c_char,
    pub get_version: unsafe extern "C" fn() -> *const c_char,
    pub instantiate: unsafe extern "C" fn(
        *const c_char,
        c_int,
        *const c_char,
        *const c_char,
        *const Callbacks,
        c_int,
        c_int,
    ) -> Component,
    pub free_instance: unsafe extern "C" fn(Component),
    pub setup_experiment: unsafe extern "C" fn(Component, c_int, f64, f64, c_int, f64) -> Status,
    pub enter_initialization_mode: Simple,
    pub exit_initialization_mode: Simple,
    pub terminate: Simple,
    pub reset: Simple,
    pub get_real: GetValues<f64>,
    pub get_integer: GetValues<c_int>,
    pub get_boolean: GetValues<c_int>,
    pub set_real: SetValues<f64>,
    pub set_integer: SetValues<c_int>,
    pub set_boolean: SetValues<c_int>,
    pub do_step: unsafe extern "C" fn(Component, f64, f64, c_int) -> Status,
    pub get_boolean_status: Option<GetStatus<c_int>>,
    pub get_real_status: Option<GetStatus<f64>>,
    pub get_state: Option<GetState>,
    pub set_state: Option<unsafe extern "C" fn(Component, StatePointer) -> Status>,
    pub free_state: Option<GetState>,
    pub serialized_state_size: Option<unsafe extern "C" fn(Component, StatePointer, *mut usize) -> Status>,
    pub serialize_state: Option<unsafe extern "C" fn(Component, StatePointer, *mut u8, usize) -> Status>,
    pub deserialize_state: Option<unsafe extern "C" fn(Component, *const u8, usize, *mut StatePointer) -> Status>,
}

/// Every function that a co-simulation FMU must export.
pub const REQUIRED: &[&str] = &[
    "fmi2GetTypesPlatform",
    "fmi2GetVersion",
    "fmi2SetDebugLogging",
    "fmi2Instantiate",
    "fmi2FreeInstance",
    "fmi2SetupExperiment",
    "fmi2EnterInitializationMode",
    "fmi2ExitInitializationMode",
    "fmi2Terminate",
    "fmi2Reset",
    "fmi2GetReal",
    "fmi2GetInteger",
    "fmi2GetBoolean",
    "fmi2GetString",
    "fmi2SetReal",
    "fmi2SetInteger",
    "fmi2SetBoolean",
    "fmi2SetString",
    "fmi2GetFMUstate",
    "fmi2SetFMUstate",
    "fmi2FreeFMUstate",
    "fmi2SerializedFMUstateSize",
    "fmi2SerializeFMUstate",
    "fmi2DeSerializeFMUstate",
    "fmi2GetDirectionalDerivative",
    "fmi2SetRealInputDerivatives",
    "fmi2GetRealOutputDerivatives",
    "fmi2DoStep",
    "fmi2CancelStep",
    "fmi2GetStatus",
    "fmi2GetRealStatus",
    "fmi2GetIntegerStatus",
    "fmi2GetBooleanStatus",
    "fmi2GetStringStatus",
];

impl Functions {
    /// Finds the functions in a library loaded from the FMU at `path`.
    pub fn find(library: &Library, path: &Path) -> Result<Self> {
        let finder = Finder { library, path };
        // SAFETY: the standard gives the function of each name the type of its field
        unsafe {
            Ok(Self {
                get_types_platform: finder.required("fmi2GetTypesPlatform")?,
                get_version: finder.required("fmi2GetVersion")?,
                instantiate: finder.required("fmi2Instantiate")?,
                free_instance: finder.required("fmi2FreeInstance")?,
                setup_experiment: finder.required("fmi2SetupExperiment")?,
                enter_initialization_mode: finder.required("fmi2EnterInitializationMode")?,
                exit_initialization_mode: finder.required("fmi2ExitInitializationMode")?,
                terminate: finder.required("fmi2Terminate")?,
                reset: finder.required("fmi2Reset")?,
                get_real: finder.required("fmi2GetReal")?,
                get_integer: finder.required("fmi2GetInteger")?,
                get_boolean: finder.required("fmi2GetBoolean")?,
                set_real: finder.required("fmi2SetReal")?,
                set_integer: finder.required("fmi2SetInteger")?,
                set_boolean: finder.required("fmi2SetBoolean")?,
                do_step: finder.required("fmi2DoStep")?,
                get_boolean_status: finder.optional("fmi2GetBooleanStatus"),
                get_real_status: finder.optional("fmi2GetRealStatus"),
                get_state: finder.optional("fmi2GetFMUstate"),
                set_state: finder.optional("fmi2SetFMUstate"),
                free_state: finder.optional("fmi2FreeFMUstate"),
                serialized_state_size: finder.optional("fmi2SerializedFMUstateSize"),
                serialize_state: finder.optional("fmi2SerializeFMUstate"),
                deserialize_state: finder.optional("fmi2DeSerializeFMUstate"),
            })
        }
    }
}

struct Finder<'a> {
    library: &'a Library,
    path: &'a Path,
}

impl Finder<'_> {
    /// # Safety
    /// `T` must be the type of the function of that name.
    unsafe fn optional<T: Copy>(&self, function: &str) -> Option<T> {
        // SAFETY: as asked of the caller; the library outlives the table of functions, both being fields of `Fmu`
        unsafe { self.library.get::<T>(function).ok().map(|symbol| *symbol) }
    }

    /// # Safety
    /// As for `optional`.
    unsafe fn required<T: Copy>(&self, function: &'static str) -> Result<T> {
        // SAFETY: as asked of the caller
        let found = unsafe { self.optional(function) };
        found.ok_or_else(|| Error::MissingFunction { path: self.path.to_owned(), function })
    }
}

/// The functions of [`REQUIRED`] that a library does not export.
pub fn missing_functions(library: &Library) -> Vec<&'static str> {
    let finder = Finder { library, path: Path::new("") };
    // SAFETY: the address is not used
    let exports = |function: &str| unsafe { finder.optional::<*const c_void>(function) }.is_some();
    REQUIRED.iter().copied().filter(|function| !exports(function)).collect()
}
