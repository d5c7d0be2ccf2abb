//! Equations of an FMU for model exchange, evaluated in a state.

use super::{FmuInstance, Recorder, SimulationOptions, recorder::RecordedColumn, simulate::set_start};
use crate::{Error, Result};

/// Derivatives and outputs in a state.
#[derive(Clone, Debug, PartialEq)]
pub struct StateEvaluation {
    /// Derivatives of the continuous states, in the order of the state vector.
    pub derivatives: Vec<f64>,
    /// Names and units of the outputs.
    pub columns: Vec<RecordedColumn>,
    /// Their values.
    pub outputs: Vec<f64>,
}

/// Reason why an FMU with events has no equations to learn, and what fits instead.
pub const NO_EQUATIONS: &str = "equations with events cannot be learned; use `structure = \"discrete\"` if inputs drive the \
                                       FMU, else leave out `structure`";

/// Second time at which derivatives are evaluated, as a share of the run, to detect equations that depend on the time.
const LATER: f64 = 0.377;

impl StateEvaluation {
    /// Evaluates a new instance: its initialization, with start values, parameters and the first row of the inputs, is
    /// followed by the states of the options.
    ///
    /// # Errors
    /// [`Error::Integration`] if the FMU has a time event, ends the simulation, or its derivatives depend on the time;
    /// [`Error::UnknownVariable`], [`Error::Variable`] for an invalid start value, input or recorded variable;
    /// [`Error::Fmi`].
    pub fn of(instance: &FmuInstance, options: &SimulationOptions) -> Result<Self> {
        let (start, stop) = (options.start.unwrap_or(0.0), options.stop.unwrap_or(1.0));
        let inputs = options.inputs.drive(instance.fmu().description())?;
        let recorder = Recorder::new(instance, &options.record, options.record_only)?;
        for (name, value) in &options.start_values {
            set_start(instance, name, *value)?;
        }
        instance.enter_initialization_mode(start, Some(stop))?;
        inputs.set(instance, start, 1)?;
        instance.exit_initialization_mode()?;
        let events = instance.settle_events()?;
        if events.terminate {
            return Err(Error::Integration { time: start, message: "the FMU ended the simulation".into() });
        }
        if let Some(time) = events.next_event_time {
            let message = format!("the FMU has an event at {time} s; {NO_EQUATIONS}");
            return Err(Error::Integration { time: start, message });
        }
        let states = options.states.as_deref().unwrap_or_default();
        let at = |time: f64| {
            let mut derivatives = vec![0.0; states.len()];
            instance.set_time(time)?;
            instance.set_continuous_states(states)?;
            instance.get_derivatives(&mut derivatives)?;
            Ok::<_, Error>((derivatives, recorder.row()?))
        };
        let (later, later_outputs) = at(start + LATER * (stop - start))?;
        let (derivatives, outputs) = at(start)?;
        let mut pairs = later.iter().zip(&derivatives).chain(later_outputs.iter().zip(&outputs));
        // nearly the same is another rounding
        if pairs.any(|(a, b)| (a - b).abs() > 1e-9 * (a.abs() + b.abs()) + 1e-12) {
            let message = "the equations depend on the time; such cannot be learned with states".into();
            return Err(Error::Integration { time: start, message });
        }
        Ok(Self { derivatives, columns: recorder.columns, outputs })
    }
}
