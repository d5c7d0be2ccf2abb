//! FMI, the standard: FMUs of any tool are read, run and checked. Nothing here knows of surrogates.
//!
//! - [`ModelDescription`]: an FMU's description of itself; [`xml`] writes and reads it as FMI 2.0 and 3.0 do.
//! - [`Fmu`] and [`FmuInstance`]: load anyone's FMU and run it; [`simulate`] does a whole run.
//! - [`system`]: systems of FMUs that exchange values (SSP), and runs of them.
//! - [`worker`]: FMUs in separate processes; [`simulate_apart`] does a whole run in one.
//! - [`hosts`]: what hosts will do with an FMU.
//! - [`validate()`]: every problem of an FMU; [`validate_apart`] runs it in separate processes.

pub mod hosts;
pub mod system;
#[cfg(test)]
mod tests;
pub mod worker;

#[doc(inline)]
pub use metafmu_fmi::{
    Archive, Checks, FmiVersion, Fmu, FmuInstance, Inputs, InterfaceKind, ModelDescription, Platform, Report,
    SimulationOptions, SimulationTable, StandardOnly, description_error, host, identifier, model_description, platform,
    simulate, validate, xml,
};
pub use worker::{Watch, Workers, simulate_apart, validate_apart};
