//! The C interface of FMI 2.0, as a table of functions found in a library.

use super::{
    InterfaceKind,
    ffi::{ExchangeFunctions, Finder, FmiComponent, FmiStatus, Free, Simple, StateFunctions},
    journal::MessageLog,
};
use crate::Result;
use libloading::Library;
use std::{
    ffi::{c_char, c_int, c_void},
    path::Path,
};

/// `fmi2True`.
pub const TRUE: c_int = 1;
/// `fmi2False`.
pub const FALSE: c_int = 0;
/// `fmi2ModelExchange`.
pub const MODEL_EXCHANGE: c_int = 0;
/// `fmi2CoSimulation`.
pub const CO_SIMULATION: c_int = 1;

/// `fmi2LastSuccessfulTime`, a status for `fmi2GetRealStatus`.
pub const LAST_SUCCESSFUL_TIME: c_int = 2;
/// `fmi2Terminated`, a status for `fmi2GetBooleanStatus`.
pub const TERMINATED: c_int = 3;

/// `fmi2CallbackFunctions`.
#[repr(C)]
#[derive(Debug)]
pub struct Callbacks {
    /// C-variadic; Rust only hands its address on.
    logger: unsafe extern "C" fn(),
    allocate_memory: unsafe extern "C" fn(usize, usize) -> *mut c_void,
    free_memory: unsafe extern "C" fn(*mut c_void),
    step_finished: Option<unsafe extern "C" fn(*mut c_void, FmiStatus)>,
    environment: *const MessageLog,
}

unsafe extern "C" {
    /// In logger.c.
    fn metafmu_logger();
    fn calloc(count: usize, size: usize) -> *mut c_void;
    fn free(pointer: *mut c_void);
}

impl Callbacks {
    /// The journal must outlive every use of the callbacks.
    pub fn new(journal: &MessageLog) -> Self {
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

pub type Fmi2GetValues<T> = unsafe extern "C" fn(FmiComponent, *const u32, usize, *mut T) -> FmiStatus;
pub type Fmi2SetValues<T> = unsafe extern "C" fn(FmiComponent, *const u32, usize, *const T) -> FmiStatus;
type GetStatus<T> = unsafe extern "C" fn(FmiComponent, c_int, *mut T) -> FmiStatus;

/// `fmi2EventInfo`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default)]
pub struct Fmi2EventInfo {
    pub new_discrete_states_needed: c_int,
    pub terminate_simulation: c_int,
    pub nominals_of_continuous_states_changed: c_int,
    pub values_of_continuous_states_changed: c_int,
    pub next_event_time_defined: c_int,
    pub next_event_time: f64,
}

/// The functions that are used; some FMUs lack those for states, derivatives and details of a step because they offer
/// none of them.
#[derive(Debug)]
pub struct Fmi2Functions {
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
    ) -> FmiComponent,
    pub free_instance: Free,
    pub setup_experiment: unsafe extern "C" fn(FmiComponent, c_int, f64, f64, c_int, f64) -> FmiStatus,
    pub enter_initialization_mode: Simple,
    pub exit_initialization_mode: Simple,
    pub terminate: Simple,
    pub reset: Simple,
    pub get_real: Fmi2GetValues<f64>,
    pub get_integer: Fmi2GetValues<c_int>,
    pub get_boolean: Fmi2GetValues<c_int>,
    pub set_real: Fmi2SetValues<f64>,
    pub set_integer: Fmi2SetValues<c_int>,
    pub set_boolean: Fmi2SetValues<c_int>,
    pub directional_derivative: Option<
        unsafe extern "C" fn(FmiComponent, *const u32, usize, *const u32, usize, *const f64, *mut f64) -> FmiStatus,
    >,
    pub states: StateFunctions,
    pub co_simulation: Option<Fmi2CoSimulation>,
    pub model_exchange: Option<Fmi2ModelExchange>,
}

#[derive(Debug)]
pub struct Fmi2CoSimulation {
    pub do_step: unsafe extern "C" fn(FmiComponent, f64, f64, c_int) -> FmiStatus,
    pub get_boolean_status: Option<GetStatus<c_int>>,
    pub get_real_status: Option<GetStatus<f64>>,
    pub output_derivatives:
        Option<unsafe extern "C" fn(FmiComponent, *const u32, usize, *const c_int, *mut f64) -> FmiStatus>,
}

#[derive(Debug)]
pub struct Fmi2ModelExchange {
    pub common: ExchangeFunctions,
    pub new_discrete_states: unsafe extern "C" fn(FmiComponent, *mut Fmi2EventInfo) -> FmiStatus,
    pub completed_integrator_step: unsafe extern "C" fn(FmiComponent, c_int, *mut c_int, *mut c_int) -> FmiStatus,
}

/// Every function that an FMU must export.
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
];

/// And these for co-simulation.
pub const REQUIRED_FOR_CO_SIMULATION: &[&str] = &[
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

/// And these for model exchange.
pub const REQUIRED_FOR_MODEL_EXCHANGE: &[&str] = &[
    "fmi2EnterEventMode",
    "fmi2NewDiscreteStates",
    "fmi2EnterContinuousTimeMode",
    "fmi2CompletedIntegratorStep",
    "fmi2SetTime",
    "fmi2SetContinuousStates",
    "fmi2GetDerivatives",
    "fmi2GetEventIndicators",
    "fmi2GetContinuousStates",
    "fmi2GetNominalsOfContinuousStates",
];

impl Fmi2Functions {
    /// Finds the functions for an interface in a library loaded from the FMU at `path`.
    pub fn find(library: &Library, path: &Path, interface: InterfaceKind) -> Result<Self> {
        let finder = Finder { library, path };
        // SAFETY: the standard gives the function of each name the type of its field
        unsafe {
            let (co_simulation, model_exchange) = match interface {
                InterfaceKind::CoSimulation => (Some(Fmi2CoSimulation::find(&finder)?), None),
                InterfaceKind::ModelExchange => (None, Some(Fmi2ModelExchange::find(&finder)?)),
            };
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
                directional_derivative: finder.optional("fmi2GetDirectionalDerivative"),
                states: StateFunctions {
                    get: finder.optional("fmi2GetFMUstate"),
                    set: finder.optional("fmi2SetFMUstate"),
                    free: finder.optional("fmi2FreeFMUstate"),
                    size: finder.optional("fmi2SerializedFMUstateSize"),
                    serialize: finder.optional("fmi2SerializeFMUstate"),
                    deserialize: finder.optional("fmi2DeSerializeFMUstate"),
                },
                co_simulation,
                model_exchange,
            })
        }
    }
}

impl Fmi2CoSimulation {
    /// # Safety
    /// The library must be one of an FMU, which has functions of the standard's types.
    unsafe fn find(finder: &Finder) -> Result<Self> {
        // SAFETY: as asked of the caller
        unsafe {
            Ok(Self {
                do_step: finder.required("fmi2DoStep")?,
                get_boolean_status: finder.optional("fmi2GetBooleanStatus"),
                get_real_status: finder.optional("fmi2GetRealStatus"),
                output_derivatives: finder.optional("fmi2GetRealOutputDerivatives"),
            })
        }
    }
}

impl Fmi2ModelExchange {
    /// # Safety
    /// As for `Fmi2CoSimulation::find`.
    unsafe fn find(finder: &Finder) -> Result<Self> {
        // SAFETY: as asked of the caller
        unsafe {
            Ok(Self {
                common: ExchangeFunctions {
                    enter_event_mode: finder.required("fmi2EnterEventMode")?,
                    enter_continuous_time_mode: finder.required("fmi2EnterContinuousTimeMode")?,
                    set_time: finder.required("fmi2SetTime")?,
                    set_continuous_states: finder.required("fmi2SetContinuousStates")?,
                    get_continuous_states: finder.required("fmi2GetContinuousStates")?,
                    get_derivatives: finder.required("fmi2GetDerivatives")?,
                    get_event_indicators: finder.required("fmi2GetEventIndicators")?,
                    get_nominals: finder.required("fmi2GetNominalsOfContinuousStates")?,
                },
                new_discrete_states: finder.required("fmi2NewDiscreteStates")?,
                completed_integrator_step: finder.required("fmi2CompletedIntegratorStep")?,
            })
        }
    }
}
