//! Model exchange: the host has time, states and events in hand.

use super::{FmiFunctions, FmuInstance, InterfaceKind, ffi::ExchangeFunctions, fmi2, fmi3};
use crate::Result;

/// Report of an FMU after an update of its discrete states.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DiscreteStates {
    /// `true` if the discrete states must be updated again.
    pub need_update: bool,
    /// `true` if the simulation must end.
    pub terminate: bool,
    /// When the next time event is, if one is known.
    pub next_event_time: Option<f64>,
}

/// Report of an FMU after an integrator step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CompletedStep {
    /// `true` if Event Mode must be entered.
    pub enter_event_mode: bool,
    /// `true` if the simulation must end.
    pub terminate: bool,
}

/// Events that follow each other for longer than this without end are taken for an endless loop.
const MAX_UPDATES: usize = 1000;

/// Every function but [`FmuInstance::settle_events`] is the standard's of that name, and fails with
/// [`Error::MissingFunction`](crate::Error::MissingFunction) on an instance for co-simulation.
impl FmuInstance<'_> {
    /// Enters Event Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi); so do all functions of model exchange.
    pub fn enter_event_mode(&self) -> Result<()> {
        let function = self.exchange("EnterEventMode")?.enter_event_mode;
        // SAFETY: as for `call`
        self.call("EnterEventMode", |component| unsafe { function(component) })
    }

    /// Enters Continuous-Time Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn enter_continuous_time_mode(&self) -> Result<()> {
        let function = self.exchange("EnterContinuousTimeMode")?.enter_continuous_time_mode;
        // SAFETY: as for `call`
        self.call("EnterContinuousTimeMode", |component| unsafe { function(component) })
    }

    /// Sets the time.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn set_time(&self, time: f64) -> Result<()> {
        let function = self.exchange("SetTime")?.set_time;
        // SAFETY: as for `call`
        self.call("SetTime", |component| unsafe { function(component, time) })
    }

    /// Sets the continuous states, all of them.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn set_continuous_states(&self, states: &[f64]) -> Result<()> {
        let function = self.exchange("SetContinuousStates")?.set_continuous_states;
        // SAFETY: as for `call`; the array has the length that is passed
        self.call("SetContinuousStates", |component| unsafe { function(component, states.as_ptr(), states.len()) })
    }

    /// The continuous states.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn get_continuous_states(&self, states: &mut [f64]) -> Result<()> {
        let function = self.exchange("GetContinuousStates")?.get_continuous_states;
        // SAFETY: as for `call`; the array has the length that is passed
        self.call("GetContinuousStates", |component| unsafe { function(component, states.as_mut_ptr(), states.len()) })
    }

    /// The derivatives of the continuous states.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn get_derivatives(&self, derivatives: &mut [f64]) -> Result<()> {
        let function = self.exchange("GetDerivatives")?.get_derivatives;
        self.call("GetDerivatives", |component| {
            // SAFETY: as for `call`; the array has the length that is passed
            unsafe { function(component, derivatives.as_mut_ptr(), derivatives.len()) }
        })
    }

    /// The event indicators.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn get_event_indicators(&self, indicators: &mut [f64]) -> Result<()> {
        let function = self.exchange("GetEventIndicators")?.get_event_indicators;
        self.call("GetEventIndicators", |component| {
            // SAFETY: as for `call`; the array has the length that is passed
            unsafe { function(component, indicators.as_mut_ptr(), indicators.len()) }
        })
    }

    /// Nominal values of the continuous states.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn get_nominals(&self, nominals: &mut [f64]) -> Result<()> {
        let function = self.exchange("GetNominalsOfContinuousStates")?.get_nominals;
        self.call("GetNominalsOfContinuousStates", |component| {
            // SAFETY: as for `call`; the array has the length that is passed
            unsafe { function(component, nominals.as_mut_ptr(), nominals.len()) }
        })
    }

    /// Updates the discrete states at an event.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn update_discrete_states(&self) -> Result<DiscreteStates> {
        match &self.fmu.functions {
            FmiFunctions::V2(fmi2::Fmi2Functions { model_exchange: Some(functions), .. }) => {
                let mut info = fmi2::Fmi2EventInfo::default();
                self.call("fmi2NewDiscreteStates", |component| {
                    // SAFETY: as for `call`; the result is written to a living variable
                    unsafe { (functions.new_discrete_states)(component, &raw mut info) }
                })?;
                Ok(DiscreteStates {
                    need_update: info.new_discrete_states_needed != fmi2::FALSE,
                    terminate: info.terminate_simulation != fmi2::FALSE,
                    next_event_time: (info.next_event_time_defined != fmi2::FALSE).then_some(info.next_event_time),
                })
            }
            FmiFunctions::V3(fmi3::Fmi3Functions { model_exchange: Some(functions), .. }) => {
                let (mut need_update, mut terminate, mut nominals, mut values) = (0, 0, 0, 0);
                let (mut defined, mut time) = (0, 0.0);
                self.call("fmi3UpdateDiscreteStates", |component| {
                    // SAFETY: as for `call`; the results are written to living variables
                    unsafe {
                        (functions.update_discrete_states)(
                            component,
                            &raw mut need_update,
                            &raw mut terminate,
                            &raw mut nominals,
                            &raw mut values,
                            &raw mut defined,
                            &raw mut time,
                        )
                    }
                })?;
                Ok(DiscreteStates {
                    need_update: need_update != 0,
                    terminate: terminate != 0,
                    next_event_time: (defined != 0).then_some(time),
                })
            }
            _ => Err(self.missing("UpdateDiscreteStates")),
        }
    }

    /// Updates the discrete states until they no longer change, then enters Continuous-Time Mode unless the simulation
    /// must end. To be called in Event Mode.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi), also if it does not end.
    pub fn settle_events(&self) -> Result<DiscreteStates> {
        for _ in 0..MAX_UPDATES {
            let states = self.update_discrete_states()?;
            if states.terminate {
                return Ok(states);
            }
            if !states.need_update {
                self.enter_continuous_time_mode()?;
                return Ok(states);
            }
        }
        let function = "UpdateDiscreteStates";
        let status = "no end of events: 1000 updates at one time";
        Err(crate::Error::Fmi { function, status, messages: Vec::new() })
    }

    /// Reports a completed integrator step.
    ///
    /// # Errors
    /// [`Error::Fmi`](crate::Error::Fmi).
    pub fn completed_integrator_step(&self) -> Result<CompletedStep> {
        match &self.fmu.functions {
            FmiFunctions::V2(fmi2::Fmi2Functions { model_exchange: Some(functions), .. }) => {
                let (mut event, mut terminate) = (fmi2::FALSE, fmi2::FALSE);
                let function = functions.completed_integrator_step;
                self.call("fmi2CompletedIntegratorStep", |component| {
                    // SAFETY: as for `call`; the results are written to living variables
                    unsafe { function(component, fmi2::TRUE, &raw mut event, &raw mut terminate) }
                })?;
                Ok(CompletedStep { enter_event_mode: event != fmi2::FALSE, terminate: terminate != fmi2::FALSE })
            }
            FmiFunctions::V3(fmi3::Fmi3Functions { model_exchange: Some(functions), .. }) => {
                let (mut event, mut terminate) = (0, 0);
                let function = functions.completed_integrator_step;
                self.call("fmi3CompletedIntegratorStep", |component| {
                    // SAFETY: as for `call`; the results are written to living variables
                    unsafe { function(component, 1, &raw mut event, &raw mut terminate) }
                })?;
                Ok(CompletedStep { enter_event_mode: event != 0, terminate: terminate != 0 })
            }
            _ => Err(self.missing("CompletedIntegratorStep")),
        }
    }

    fn exchange(&self, function: &'static str) -> Result<&ExchangeFunctions> {
        let functions = match &self.fmu.functions {
            FmiFunctions::V2(functions) => functions.model_exchange.as_ref().map(|functions| &functions.common),
            FmiFunctions::V3(functions) => functions.model_exchange.as_ref().map(|functions| &functions.common),
        };
        debug_assert_eq!(functions.is_some(), self.fmu.interface == InterfaceKind::ModelExchange);
        self.offered(function, functions)
    }
}
