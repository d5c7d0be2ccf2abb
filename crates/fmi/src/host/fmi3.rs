//! The C interface of FMI 3.0, as a table of functions found in a library.
//!
//! `fmi3Boolean` is C's `bool`. It is read as a byte, because an FMU may leave a value there that is not a valid `bool` of Rust.

use super::{
    InterfaceKind,
    ffi::{ExchangeFunctions, Finder, FmiComponent, FmiStatus, Free, Simple, StateFunctions},
};
use crate::Result;
use libloading::Library;
use std::{
    ffi::{c_char, c_void},
    path::Path,
};

/// `fmi3Boolean`.
pub type Fmi3Boolean = u8;

pub type LogMessageCallback = unsafe extern "C" fn(*mut c_void, FmiStatus, *const c_char, *const c_char);
pub type Fmi3GetValues<T> = unsafe extern "C" fn(FmiComponent, *const u32, usize, *mut T, usize) -> FmiStatus;
pub type Fmi3SetValues<T> = unsafe extern "C" fn(FmiComponent, *const u32, usize, *const T, usize) -> FmiStatus;
pub type GetDerivative = unsafe extern "C" fn(
    FmiComponent,
    *const u32,
    usize,
    *const u32,
    usize,
    *const f64,
    usize,
    *mut f64,
    usize,
) -> FmiStatus;

/// The functions that are used; those for types, states and derivatives are not in every FMU.
#[derive(Debug)]
pub struct Fmi3Functions {
    pub get_version: unsafe extern "C" fn() -> *const c_char,
    pub free_instance: Free,
    pub enter_initialization_mode:
        unsafe extern "C" fn(FmiComponent, Fmi3Boolean, f64, f64, Fmi3Boolean, f64) -> FmiStatus,
    pub exit_initialization_mode: Simple,
    pub terminate: Simple,
    pub reset: Simple,
    pub get_float64: Fmi3GetValues<f64>,
    pub set_float64: Fmi3SetValues<f64>,
    pub get_boolean: Fmi3GetValues<Fmi3Boolean>,
    pub set_boolean: Fmi3SetValues<Fmi3Boolean>,
    pub types: Types,
    pub directional_derivative: Option<GetDerivative>,
    pub adjoint_derivative: Option<GetDerivative>,
    pub states: StateFunctions,
    pub co_simulation: Option<Fmi3CoSimulation>,
    pub model_exchange: Option<Fmi3ModelExchange>,
}

/// Getters and setters of one type.
#[derive(Debug)]
pub struct Accessors<T> {
    pub get: Option<Fmi3GetValues<T>>,
    pub set: Option<Fmi3SetValues<T>>,
}

/// The types that are seldom met.
#[derive(Debug)]
pub struct Types {
    pub float32: Accessors<f32>,
    pub int8: Accessors<i8>,
    pub uint8: Accessors<u8>,
    pub int16: Accessors<i16>,
    pub uint16: Accessors<u16>,
    pub int32: Accessors<i32>,
    pub uint32: Accessors<u32>,
    pub int64: Accessors<i64>,
    pub uint64: Accessors<u64>,
}

#[derive(Debug)]
pub struct Fmi3CoSimulation {
    pub instantiate: unsafe extern "C" fn(
        *const c_char,
        *const c_char,
        *const c_char,
        Fmi3Boolean,
        Fmi3Boolean,
        Fmi3Boolean,
        Fmi3Boolean,
        *const u32,
        usize,
        *mut c_void,
        LogMessageCallback,
        *const c_void,
    ) -> FmiComponent,
    pub do_step: unsafe extern "C" fn(
        FmiComponent,
        f64,
        f64,
        Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut f64,
    ) -> FmiStatus,
    pub output_derivatives:
        Option<unsafe extern "C" fn(FmiComponent, *const u32, usize, *const i32, *mut f64, usize) -> FmiStatus>,
}

#[derive(Debug)]
pub struct Fmi3ModelExchange {
    pub instantiate: unsafe extern "C" fn(
        *const c_char,
        *const c_char,
        *const c_char,
        Fmi3Boolean,
        Fmi3Boolean,
        *mut c_void,
        LogMessageCallback,
    ) -> FmiComponent,
    pub common: ExchangeFunctions,
    pub update_discrete_states: unsafe extern "C" fn(
        FmiComponent,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut Fmi3Boolean,
        *mut f64,
    ) -> FmiStatus,
    pub completed_integrator_step:
        unsafe extern "C" fn(FmiComponent, Fmi3Boolean, *mut Fmi3Boolean, *mut Fmi3Boolean) -> FmiStatus,
}

/// Every function that an FMU must export.
pub const REQUIRED: &[&str] = &[
    "fmi3GetVersion",
    "fmi3SetDebugLogging",
    "fmi3FreeInstance",
    "fmi3EnterInitializationMode",
    "fmi3ExitInitializationMode",
    "fmi3EnterEventMode",
    "fmi3Terminate",
    "fmi3Reset",
    "fmi3GetFloat32",
    "fmi3GetFloat64",
    "fmi3GetInt8",
    "fmi3GetUInt8",
    "fmi3GetInt16",
    "fmi3GetUInt16",
    "fmi3GetInt32",
    "fmi3GetUInt32",
    "fmi3GetInt64",
    "fmi3GetUInt64",
    "fmi3GetBoolean",
    "fmi3GetString",
    "fmi3GetBinary",
    "fmi3GetClock",
    "fmi3SetFloat32",
    "fmi3SetFloat64",
    "fmi3SetInt8",
    "fmi3SetUInt8",
    "fmi3SetInt16",
    "fmi3SetUInt16",
    "fmi3SetInt32",
    "fmi3SetUInt32",
    "fmi3SetInt64",
    "fmi3SetUInt64",
    "fmi3SetBoolean",
    "fmi3SetString",
    "fmi3SetBinary",
    "fmi3SetClock",
    "fmi3GetNumberOfVariableDependencies",
    "fmi3GetVariableDependencies",
    "fmi3GetFMUState",
    "fmi3SetFMUState",
    "fmi3FreeFMUState",
    "fmi3SerializedFMUStateSize",
    "fmi3SerializeFMUState",
    "fmi3DeserializeFMUState",
    "fmi3GetDirectionalDerivative",
    "fmi3GetAdjointDerivative",
    "fmi3EnterConfigurationMode",
    "fmi3ExitConfigurationMode",
    "fmi3GetIntervalDecimal",
    "fmi3GetIntervalFraction",
    "fmi3GetShiftDecimal",
    "fmi3GetShiftFraction",
    "fmi3SetIntervalDecimal",
    "fmi3SetIntervalFraction",
    "fmi3SetShiftDecimal",
    "fmi3SetShiftFraction",
    "fmi3EvaluateDiscreteStates",
    "fmi3UpdateDiscreteStates",
];

/// And these for co-simulation.
pub const REQUIRED_FOR_CO_SIMULATION: &[&str] =
    &["fmi3InstantiateCoSimulation", "fmi3EnterStepMode", "fmi3GetOutputDerivatives", "fmi3DoStep"];

/// And these for model exchange.
pub const REQUIRED_FOR_MODEL_EXCHANGE: &[&str] = &[
    "fmi3InstantiateModelExchange",
    "fmi3EnterContinuousTimeMode",
    "fmi3CompletedIntegratorStep",
    "fmi3SetTime",
    "fmi3SetContinuousStates",
    "fmi3GetContinuousStateDerivatives",
    "fmi3GetEventIndicators",
    "fmi3GetContinuousStates",
    "fmi3GetNominalsOfContinuousStates",
    "fmi3GetNumberOfEventIndicators",
    "fmi3GetNumberOfContinuousStates",
];

impl Fmi3Functions {
    /// Finds the functions for an interface in a library loaded from the FMU at `path`.
    pub fn find(library: &Library, path: &Path, interface: InterfaceKind) -> Result<Self> {
        let finder = Finder { library, path };
        // SAFETY: the standard gives the function of each name the type of its field
        unsafe {
            let (co_simulation, model_exchange) = match interface {
                InterfaceKind::CoSimulation => (Some(Fmi3CoSimulation::find(&finder)?), None),
                InterfaceKind::ModelExchange => (None, Some(Fmi3ModelExchange::find(&finder)?)),
            };
            Ok(Self {
                get_version: finder.required("fmi3GetVersion")?,
                free_instance: finder.required("fmi3FreeInstance")?,
                enter_initialization_mode: finder.required("fmi3EnterInitializationMode")?,
                exit_initialization_mode: finder.required("fmi3ExitInitializationMode")?,
                terminate: finder.required("fmi3Terminate")?,
                reset: finder.required("fmi3Reset")?,
                get_float64: finder.required("fmi3GetFloat64")?,
                set_float64: finder.required("fmi3SetFloat64")?,
                get_boolean: finder.required("fmi3GetBoolean")?,
                set_boolean: finder.required("fmi3SetBoolean")?,
                types: Types::find(&finder),
                directional_derivative: finder.optional("fmi3GetDirectionalDerivative"),
                adjoint_derivative: finder.optional("fmi3GetAdjointDerivative"),
                states: StateFunctions {
                    get: finder.optional("fmi3GetFMUState"),
                    set: finder.optional("fmi3SetFMUState"),
                    free: finder.optional("fmi3FreeFMUState"),
                    size: finder.optional("fmi3SerializedFMUStateSize"),
                    serialize: finder.optional("fmi3SerializeFMUState"),
                    deserialize: finder.optional("fmi3DeserializeFMUState"),
                },
                co_simulation,
                model_exchange,
            })
        }
    }
}

impl Types {
    /// # Safety
    /// The library must be one of an FMU, which has functions of the standard's types.
    unsafe fn find(finder: &Finder) -> Self {
        // SAFETY: as asked of the caller
        unsafe {
            Self {
                float32: Accessors { get: finder.optional("fmi3GetFloat32"), set: finder.optional("fmi3SetFloat32") },
                int8: Accessors { get: finder.optional("fmi3GetInt8"), set: finder.optional("fmi3SetInt8") },
                uint8: Accessors { get: finder.optional("fmi3GetUInt8"), set: finder.optional("fmi3SetUInt8") },
                int16: Accessors { get: finder.optional("fmi3GetInt16"), set: finder.optional("fmi3SetInt16") },
                uint16: Accessors { get: finder.optional("fmi3GetUInt16"), set: finder.optional("fmi3SetUInt16") },
                int32: Accessors { get: finder.optional("fmi3GetInt32"), set: finder.optional("fmi3SetInt32") },
                uint32: Accessors { get: finder.optional("fmi3GetUInt32"), set: finder.optional("fmi3SetUInt32") },
                int64: Accessors { get: finder.optional("fmi3GetInt64"), set: finder.optional("fmi3SetInt64") },
                uint64: Accessors { get: finder.optional("fmi3GetUInt64"), set: finder.optional("fmi3SetUInt64") },
            }
        }
    }
}

impl Fmi3CoSimulation {
    /// # Safety
    /// As for `Types::find`.
    unsafe fn find(finder: &Finder) -> Result<Self> {
        // SAFETY: as asked of the caller
        unsafe {
            Ok(Self {
                instantiate: finder.required("fmi3InstantiateCoSimulation")?,
                do_step: finder.required("fmi3DoStep")?,
                output_derivatives: finder.optional("fmi3GetOutputDerivatives"),
            })
        }
    }
}

impl Fmi3ModelExchange {
    /// # Safety
    /// As for `Types::find`.
    unsafe fn find(finder: &Finder) -> Result<Self> {
        // SAFETY: as asked of the caller
        unsafe {
            Ok(Self {
                instantiate: finder.required("fmi3InstantiateModelExchange")?,
                common: ExchangeFunctions {
                    enter_event_mode: finder.required("fmi3EnterEventMode")?,
                    enter_continuous_time_mode: finder.required("fmi3EnterContinuousTimeMode")?,
                    set_time: finder.required("fmi3SetTime")?,
                    set_continuous_states: finder.required("fmi3SetContinuousStates")?,
                    get_continuous_states: finder.required("fmi3GetContinuousStates")?,
                    get_derivatives: finder.required("fmi3GetContinuousStateDerivatives")?,
                    get_event_indicators: finder.required("fmi3GetEventIndicators")?,
                    get_nominals: finder.required("fmi3GetNominalsOfContinuousStates")?,
                },
                update_discrete_states: finder.required("fmi3UpdateDiscreteStates")?,
                completed_integrator_step: finder.required("fmi3CompletedIntegratorStep")?,
            })
        }
    }
}
