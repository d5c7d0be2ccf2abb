//! A run by model exchange: the host integrates the continuous states, finds the events and handles them.
//!
//! A run goes from one output instant to the next in stretches. A stretch ends at the instant, at the next time event or at
//! the next row of the inputs; a state event or a step event cuts it short. All of these are ends of steps of the
//! [method](super::stretch).

use super::{
    FmuInstance, StepResult,
    inputs::InputDriver,
    stretch::{IntegratedModel, RunPosition, Stop},
};
use crate::{Error, Result, model_description::MAX_ELEMENTS};

/// Default tolerance of a step, unless the caller has one or the FMU's default experiment has a tighter one.
const TOLERANCE: f64 = 1e-8;
/// Smallest useful tolerance: below it rounding dominates.
const TIGHTEST: f64 = 1e-13;
/// Number of events that must bring a run forward by [`ADVANCED`].
const MAX_EVENTS: usize = 10_000;
/// Part of the time to the next output that [`MAX_EVENTS`] must take; less is taken for an endless sequence.
const ADVANCED: f64 = 1e-4;

/// An instance that is run by model exchange, in Continuous-Time Mode.
#[derive(Debug)]
pub struct Exchange<'a> {
    model: IntegratedModel<'a>,
    position: RunPosition,
}

impl<'a> Exchange<'a> {
    /// Handles the events of an instance that has just left Initialization Mode at a time. The FMU may end the simulation.
    ///
    /// # Errors
    /// [`Error::Fmi`], [`Error::Integration`].
    pub fn start(
        instance: &'a FmuInstance<'a>,
        inputs: &'a InputDriver<'a>,
        tolerance: Option<f64>,
        time: f64,
    ) -> Result<(Self, StepResult)> {
        let description = instance.fmu().description();
        let suggested = description.default_experiment.and_then(|experiment| experiment.tolerance);
        let suggested =
            suggested.filter(|tolerance| *tolerance > 0.0).map_or(TOLERANCE, |suggested| suggested.min(TOLERANCE));
        let tolerance = tolerance.unwrap_or(suggested);
        let (states, indicators) = (description.state_count(), description.indicator_count());
        if states.max(indicators) as u64 > MAX_ELEMENTS {
            let message = format!("{states} continuous states and {indicators} event indicators are too many");
            return Err(Error::Integration { time, message });
        }
        let exchange = description.model_exchange.as_ref();
        let provides = exchange.is_some_and(|exchange| exchange.interface.directional_derivative);
        let pairs = description.states_with_derivatives().filter(|pairs| provides && pairs.len() == states);
        let directional = pairs.map(|pairs| {
            let references = pairs.into_iter().map(|(state, rate)| (state.value_reference, rate.value_reference));
            references.unzip()
        });
        let model = IntegratedModel {
            instance,
            inputs,
            tolerance: tolerance.max(TIGHTEST),
            completes_steps: exchange.is_some_and(|exchange| exchange.needs_completed_integrator_step),
            directional,
        };
        let position = RunPosition::new(time, states, indicators, inputs.rows_until(time));
        let mut run = Self { model, position };
        let begun = run.settle()?;
        Ok((run, begun))
    }

    /// Begins in other states than those that the initialization has found.
    ///
    /// # Errors
    /// [`Error::Fmi`], also if there is another number of states.
    pub fn set_states(&mut self, states: &[f64]) -> Result<()> {
        let position = &mut self.position;
        self.model.instance.set_continuous_states(states)?;
        position.states = states.to_vec();
        position.forget_steps();
        self.model.read_indicators(&mut position.indicators)
    }

    /// Position of the run.
    pub fn position(&self) -> &RunPosition {
        &self.position
    }

    /// Moves to another position; the state of the FMU was already set to it.
    pub fn rewind(&mut self, position: RunPosition) {
        self.position = position;
    }

    /// Advances to a time, through the events before it and those at it.
    ///
    /// # Errors
    /// [`Error::Fmi`]; [`Error::Integration`] if the method fails or events do not end.
    pub fn advance(&mut self, to: f64) -> Result<StepResult> {
        // where the count of events began, and the time of the event before
        let (mut begin, mut before, length) = (self.position.time, self.position.time, to - self.position.time);
        for count in 1.. {
            let stop = loop {
                let end = self.end_of_stretch(to);
                let stop = if end > self.position.time { self.position.stretch(&mut self.model, end)? } else { None };
                if stop.is_some()
                    || self.pass_input_rows()?
                    || self.position.next_event.is_some_and(|event| event <= end)
                {
                    break stop.unwrap_or(Stop::Event);
                }
                if end >= to {
                    return Ok(StepResult::Done);
                }
            };
            let time = self.position.time;
            if stop == Stop::Terminated {
                return Ok(StepResult::Terminated { time });
            }
            self.model.instance.enter_event_mode()?;
            self.model.inputs.set(self.model.instance, time, self.position.rows)?;
            if let StepResult::Terminated { time } = self.settle()? {
                return Ok(StepResult::Terminated { time });
            }
            // an event that stays where it was would be handled for ever
            self.position.next_event = self.position.next_event.filter(|next| *next > time);
            if count % MAX_EVENTS == 0 {
                if time - begin <= ADVANCED * length {
                    return Err(endless(begin, time, time - before));
                }
                begin = time;
            }
            before = time;
        }
        Ok(StepResult::Done)
    }

    /// Handles an event at the current time, at which `set` sets inputs. The FMU may end the simulation.
    ///
    /// # Errors
    /// [`Error::Fmi`], and those of `set`.
    pub fn interrupt(&mut self, set: impl FnOnce() -> Result<()>) -> Result<StepResult> {
        self.model.instance.enter_event_mode()?;
        set()?;
        self.settle()
    }

    /// Lets the FMU handle an event, then reads all values that may have changed, whether or not the FMU reports
    /// changes.
    fn settle(&mut self) -> Result<StepResult> {
        let (instance, position) = (self.model.instance, &mut self.position);
        let found = instance.settle_events()?;
        if found.terminate {
            return Ok(StepResult::Terminated { time: position.time });
        }
        position.next_event = found.next_event_time;
        position.forget_steps();
        if !position.states.is_empty() {
            instance.get_continuous_states(&mut position.states)?;
            instance.get_nominals(&mut position.nominals)?;
            position.nominals.iter_mut().for_each(|n| *n = if n.is_normal() { n.abs() } else { 1.0 });
        }
        self.model.read_indicators(&mut position.indicators)?;
        Ok(StepResult::Done)
    }

    fn end_of_stretch(&self, to: f64) -> f64 {
        let RunPosition { time, next_event, rows, .. } = self.position;
        let next_row = self.model.inputs.next_row(rows);
        [next_event, next_row].into_iter().flatten().fold(to, f64::min).max(time)
    }

    /// Notes the rows of the inputs that have been reached; true if an input jumps there, which takes an event.
    fn pass_input_rows(&mut self) -> Result<bool> {
        let (inputs, position) = (self.model.inputs, &mut self.position);
        let before = std::mem::replace(&mut position.rows, inputs.rows_until(position.time));
        if position.rows == before {
            return Ok(false);
        }
        if inputs.jump(before, position.rows) {
            return Ok(true);
        }
        inputs.set_continuous(self.model.instance, position.time, position.rows)?;
        Ok(false)
    }
}

/// Error of events that do not bring a run forward; the last two are `gap` apart.
fn endless(begin: f64, time: f64, gap: f64) -> Error {
    let message = format!(
        "no end of events: {MAX_EVENTS} since {begin} s, the last two {gap:.1e} s apart; either they accumulate, as the bounces of a ball \
         that comes to rest (Zeno behavior), or an equation switches back and forth: the model needs a state of rest or a hysteresis"
    );
    Error::Integration { time, message }
}
