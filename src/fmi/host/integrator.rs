//! A run by model exchange: the host integrates the continuous states, finds the events and handles them.
//!
//! A run goes from one output instant to the next in stretches. A stretch ends at the instant, at the next time event or at
//! the next row of the inputs; a state event or a step event cuts it short. Each is integrated separately by Dormand and Prince's
//! method of order 8(5,3), so that all of these are ends of steps and nothing is interpolated.

use super::{FmuInstance, StepResult, inputs::InputDriver};
use crate::{Error, Result, fmi::model_description::MAX_ELEMENTS, integrate::in_words};
use nalgebra::DVector;
use ode_solvers::{
    Dop853, System,
    dop_shared::{IntegrationError, OutputType},
};
use std::cell::RefCell;

/// Default tolerance of a step, if neither the caller nor the FMU's default experiment has one.
const TOLERANCE: f64 = 1e-8;
/// Smallest useful tolerance: below it rounding dominates.
const TIGHTEST: f64 = 1e-13;
/// An event is located to this share of its time and of the step that it is found in.
const LOCATED: f64 = 100.0 * f64::EPSILON;
/// Largest number of events between two output instants; more are taken for an endless sequence.
const MAX_EVENTS: usize = 10_000;
/// Trials to locate an event; every fourth halves the interval that it lies in.
const MAX_TRIALS: usize = 400;
/// Steps that a stretch may have.
const MAX_STEPS: u32 = 100_000;
/// Steps of a stretch after which the method looks whether the equations are stiff.
const STIFF_AFTER: u32 = 1000;

/// An instance that is run by model exchange, in Continuous-Time Mode.
#[derive(Debug)]
pub struct Exchange<'a> {
    model: IntegratedModel<'a>,
    position: RunPosition,
}

/// Constant part of a run.
#[derive(Clone, Copy, Debug)]
struct IntegratedModel<'a> {
    instance: &'a FmuInstance<'a>,
    inputs: &'a InputDriver<'a>,
    /// Relative to the states and to their nominal values.
    tolerance: f64,
    /// `true` if the FMU requires a report of each completed step.
    completes_steps: bool,
}

/// Position of a run. With a state of the FMU it is all that is needed to continue from there.
#[derive(Clone, Debug)]
pub struct RunPosition {
    time: f64,
    states: Vec<f64>,
    nominals: Vec<f64>,
    indicators: Vec<f64>,
    /// Time of the FMU's next event.
    next_event: Option<f64>,
    /// Rows of the inputs up to here.
    rows: usize,
    /// Step size to begin with, if one proved right.
    step: Option<f64>,
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
        let tolerance = tolerance.or(suggested.filter(|tolerance| *tolerance > 0.0)).unwrap_or(TOLERANCE);
        let (states, indicators) = (description.state_count(), description.indicator_count());
        if states.max(indicators) as u64 > MAX_ELEMENTS {
            let message = format!("{states} continuous states and {indicators} event indicators are too many");
            return Err(Error::Integration { time, message });
        }
        let model = IntegratedModel {
            instance,
            inputs,
            tolerance: tolerance.max(TIGHTEST),
            completes_steps: description.model_exchange.as_ref().is_some_and(|e| e.needs_completed_integrator_step),
        };
        let position = RunPosition {
            time,
            states: vec![0.0; states],
            nominals: vec![1.0; states],
            indicators: vec![0.0; indicators],
            next_event: None,
            rows: inputs.rows_until(time),
            step: None,
        };
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
        let begin = self.position.time;
        for _ in 0..MAX_EVENTS {
            let stop = loop {
                let end = self.end_of_stretch(to);
                let stop = if end > self.position.time { self.stretch(end)? } else { None };
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
        }
        let message = format!("no end of events: {MAX_EVENTS} since {begin} s");
        Err(Error::Integration { time: self.position.time, message })
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
        position.step = None;
        if !position.states.is_empty() {
            instance.get_continuous_states(&mut position.states)?;
            instance.get_nominals(&mut position.nominals)?;
            let usable = |nominal: &f64| nominal.is_normal();
            position.nominals.iter_mut().for_each(|n| *n = if usable(n) { n.abs() } else { 1.0 });
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

    /// Integrates up to a time or the first event before it.
    fn stretch(&mut self, end: f64) -> Result<Option<Stop>> {
        let position = &mut self.position;
        let length = end - position.time;
        let scaled = position.states.iter().zip(&position.nominals).map(|(state, nominal)| state / nominal);
        let state = DVector::from_iterator(position.states.len() + 1, scaled.chain([0.0]));
        let first = SolutionPoint { elapsed: 0.0, state, indicators: position.indicators.clone() };
        let stretch = ContinuousStretch {
            model: self.model,
            start: position.time,
            end,
            rows: position.rows,
            inputs_vary: self.model.inputs.vary(position.rows),
            nominals: &position.nominals,
            unscaled: RefCell::new(vec![0.0; position.states.len()]),
            failure: RefCell::default(),
            discarded: RefCell::default(),
        };
        let steps = RefCell::new(AcceptedSteps { before: first.clone(), now: first.clone(), longest: 0.0, stop: None });
        stretch.solve(&first.state, length, position.step.map_or(0.0, |step| step.min(length)), Some(&steps))?;
        let AcceptedSteps { before, mut now, longest, mut stop } = steps.into_inner();
        if crossed(&before.indicators, &now.indicators) {
            now = stretch.locate(&before, now)?;
            stretch.put(now.elapsed, &now.state)?;
            stop = self.model.complete_step()?.or(Some(Stop::Event));
        }
        position.time = stretch.time(now.elapsed);
        position.step = Some(longest);
        let SolutionPoint { state, indicators, .. } = now;
        position.states.iter_mut().zip(&position.nominals).zip(&state).for_each(|((to, nominal), z)| *to = z * nominal);
        position.indicators = indicators;
        Ok(stop)
    }
}

impl IntegratedModel<'_> {
    fn read_indicators(&self, indicators: &mut [f64]) -> Result<()> {
        if indicators.is_empty() { Ok(()) } else { self.instance.get_event_indicators(indicators) }
    }

    /// Reports that the step to where the FMU is now is part of the solution.
    fn complete_step(&self) -> Result<Option<Stop>> {
        if !self.completes_steps {
            return Ok(None);
        }
        let completed = self.instance.completed_integrator_step()?;
        Ok(match (completed.terminate, completed.enter_event_mode) {
            (true, _) => Some(Stop::Terminated),
            (_, true) => Some(Stop::Event),
            _ => None,
        })
    }
}

/// Reason why a stretch ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stop {
    Event,
    Terminated,
}

/// A part of a run without discontinuities, in the form that `ode_solvers` needs.
///
/// Its state is the FMU's in units of the nominal values, which makes the tolerance absolute, followed by the time
/// since the start; see [`crate::integrate`].
struct ContinuousStretch<'a> {
    model: IntegratedModel<'a>,
    start: f64,
    end: f64,
    /// Rows of the inputs up to its start.
    rows: usize,
    inputs_vary: bool,
    nominals: &'a [f64],
    /// The FMU's states: a position to compute them.
    unscaled: RefCell<Vec<f64>>,
    /// Error that ended the integration.
    failure: RefCell<Option<Error>>,
    /// The last state that the FMU found impossible.
    discarded: RefCell<Option<Error>>,
}

/// A point of the solution.
#[derive(Clone)]
struct SolutionPoint {
    elapsed: f64,
    state: DVector<f64>,
    indicators: Vec<f64>,
}

/// The last accepted step and its result.
struct AcceptedSteps {
    before: SolutionPoint,
    now: SolutionPoint,
    longest: f64,
    stop: Option<Stop>,
}

impl ContinuousStretch<'_> {
    /// Returns the state after `duration`. With `steps`, every accepted step is checked, and an event ends the
    /// integration.
    fn solve(
        &self,
        from: &DVector<f64>,
        duration: f64,
        step: f64,
        steps: Option<&RefCell<AcceptedSteps>>,
    ) -> Result<DVector<f64>> {
        let mut problem = OdeProblem { stretch: self, steps };
        if self.nominals.is_empty() {
            // nothing but the time
            let end = from.add_scalar(duration);
            problem.solout(duration, &end, &end);
            return self.failure.take().map_or(Ok(end), Err);
        }
        let tolerance = self.model.tolerance;
        let (safety, beta, least, most) = (0.9, 0.0, 0.333, 6.0);
        let mut solver = Dop853::from_param(
            problem,
            0.0,
            duration,
            duration,
            from.clone(),
            tolerance,
            tolerance,
            safety,
            beta,
            least,
            most,
            duration,
            step,
            MAX_STEPS,
            STIFF_AFTER,
            OutputType::Sparse,
        );
        let result = solver.integrate();
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        let last = solver.y_out().last();
        match (result, last) {
            (Ok(_), Some(state)) => Ok(state.clone()),
            (result, last) => {
                let reason = result.err().map_or_else(String::new, |error| reason(&error));
                let message = self.discarded.take().map_or(reason, |error| error.to_string());
                let elapsed = last.and_then(|state| state.as_slice().last()).copied().unwrap_or(0.0);
                Err(Error::Integration { time: self.start + elapsed, message })
            }
        }
    }

    /// Puts the FMU at a point.
    fn put(&self, elapsed: f64, state: &DVector<f64>) -> Result<()> {
        let instance = self.model.instance;
        let time = self.time(elapsed);
        instance.set_time(time)?;
        if self.inputs_vary {
            self.model.inputs.set_continuous(instance, time, self.rows)?;
        }
        if self.nominals.is_empty() {
            return Ok(());
        }
        let mut states = self.unscaled.borrow_mut();
        states.iter_mut().zip(self.nominals).zip(state).for_each(|((to, nominal), z)| *to = z * nominal);
        instance.set_continuous_states(&states)
    }

    /// The time; at the end without rounding.
    fn time(&self, elapsed: f64) -> f64 {
        let length = self.end - self.start;
        if elapsed >= length * (1.0 - 4.0 * f64::EPSILON) { self.end } else { self.start + elapsed }
    }

    fn derive(&self, state: &DVector<f64>, derivative: &mut DVector<f64>) -> Result<()> {
        let count = self.nominals.len();
        self.put(state[count], state)?;
        let rates = &mut derivative.as_mut_slice()[..count];
        self.model.instance.get_derivatives(rates)?;
        rates.iter_mut().zip(self.nominals).for_each(|(rate, nominal)| *rate /= nominal);
        derivative[count] = 1.0;
        Ok(())
    }

    /// Follows an accepted step; false at an event.
    fn follow(&self, steps: &mut AcceptedSteps, elapsed: f64, state: &DVector<f64>) -> Result<bool> {
        let AcceptedSteps { before, now, longest, stop } = steps;
        std::mem::swap(before, now);
        now.elapsed = elapsed;
        now.state.copy_from(state);
        *longest = longest.max(elapsed - before.elapsed);
        self.put(elapsed, state)?;
        self.model.read_indicators(&mut now.indicators)?;
        if crossed(&before.indicators, &now.indicators) {
            return Ok(false);
        }
        *stop = self.model.complete_step()?;
        Ok(stop.is_none())
    }

    /// The first point, up to the tolerance, where indicators have changed that had not `before` and have `after`.
    ///
    /// Each trial is a solution from `before` on. They are placed by the Illinois method, every fourth one in the middle,
    /// which limits their number for any indicators.
    fn locate(&self, before: &SolutionPoint, mut after: SolutionPoint) -> Result<SolutionPoint> {
        let tolerance = LOCATED * (self.start.abs() + after.elapsed);
        let (mut low, mut indicators) = (before.elapsed, before.indicators.clone());
        // which end moved last, and what the indicators of the other one weigh
        let (mut raised, mut weights) = (None, (1.0, 1.0));
        for trial in 1..=MAX_TRIALS {
            let width = after.elapsed - low;
            if width <= tolerance {
                break;
            }
            let share = if trial % 4 == 0 { 0.5 } else { root(&indicators, &after.indicators, weights) };
            let margin = 0.5 * tolerance;
            let elapsed = (low + share * width).min(after.elapsed - margin).max(low + margin);
            let state = self.solve(&before.state, elapsed - before.elapsed, elapsed - before.elapsed, None)?;
            self.put(elapsed, &state)?;
            let mut found = SolutionPoint { elapsed, state, indicators: after.indicators.clone() };
            self.model.read_indicators(&mut found.indicators)?;
            let raise = !crossed(&before.indicators, &found.indicators);
            let again = raised.replace(raise) == Some(raise);
            if raise {
                weights = (1.0, if again { 0.5 * weights.1 } else { 1.0 });
                (low, indicators) = (elapsed, found.indicators);
            } else {
                weights = (if again { 0.5 * weights.0 } else { 1.0 }, 1.0);
                after = found;
            }
        }
        Ok(after)
    }
}

/// Returns true if an indicator changed between positive and not positive, which is a state event.
fn crossed(before: &[f64], after: &[f64]) -> bool {
    before.iter().zip(after).any(|(before, after)| (*before > 0.0) != (*after > 0.0))
}

/// Time at which the first indicator becomes zero between two points, by the straight lines between their weighted
/// values.
fn root(low: &[f64], high: &[f64], weights: (f64, f64)) -> f64 {
    let share = |(low, high): (&f64, &f64)| {
        let (low, high) = (weights.0 * low, weights.1 * high);
        ((low > 0.0) != (high > 0.0)).then(|| low / (low - high)).filter(|share| (0.0..=1.0).contains(share))
    };
    low.iter().zip(high).filter_map(share).min_by(f64::total_cmp).unwrap_or(0.5)
}

fn reason(error: &IntegrationError) -> String {
    let more = match error {
        IntegrationError::StiffnessDetected { .. } => "; co-simulation has the FMU's own solver",
        _ => "",
    };
    in_words(error) + more
}

/// Problem that `ode_solvers` takes over and drops.
struct OdeProblem<'a> {
    stretch: &'a ContinuousStretch<'a>,
    steps: Option<&'a RefCell<AcceptedSteps>>,
}

impl System<f64, DVector<f64>> for OdeProblem<'_> {
    fn system(&self, _: f64, state: &DVector<f64>, derivative: &mut DVector<f64>) {
        if self.stretch.failure.borrow().is_none() {
            match self.stretch.derive(state, derivative) {
                Ok(()) => return,
                // a step into a position without solution is tried again shorter
                Err(error @ Error::Fmi { status: "discard", .. }) => *self.stretch.discarded.borrow_mut() = Some(error),
                Err(error) => *self.stretch.failure.borrow_mut() = Some(error),
            }
        }
        derivative.fill(f64::NAN);
    }

    /// Returns true if the integration must stop.
    fn solout(&mut self, elapsed: f64, state: &DVector<f64>, _: &DVector<f64>) -> bool {
        let Some(steps) = self.steps else { return false };
        match self.stretch.follow(&mut steps.borrow_mut(), elapsed, state) {
            Ok(has_memory) => !has_memory,
            Err(error) => {
                *self.stretch.failure.borrow_mut() = Some(error);
                true
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_event_is_a_change_between_positive_and_not_positive() {
        for (before, after, expected) in
            [(1.0, 2.0, false), (1.0, 0.0, true), (0.0, -1.0, false), (-1.0, 0.0, false), (0.0, 1e-300, true)]
        {
            assert_eq!(crossed(&[3.0, before], &[4.0, after]), expected, "{before} {after}");
        }
    }

    #[test]
    fn the_first_root_is_estimated_and_nothing_leaves_the_bracket() {
        assert_eq!(root(&[1.0, 1.0, 1.0], &[-1.0, -3.0, 1.0], (1.0, 1.0)), 0.25);
        assert_eq!(root(&[1.0], &[-1.0], (0.5, 1.0)), 0.5 / 1.5);
        assert_eq!(root(&[f64::NAN], &[1.0], (1.0, 1.0)), 0.5);
        assert_eq!(root(&[f64::INFINITY], &[-1.0], (1.0, 1.0)), 0.5);
    }
}
