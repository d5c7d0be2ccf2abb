//! Integration of the continuous states of an FMU between two events.
//!
//! The explicit method, Dormand and Prince's of order 8(5,3), integrates as long as accuracy decides the length of its steps. Where
//! stability does, Radau's implicit method continues, by the rule of [`MethodChoice`]. Both work
//! with the states in units of their nominal values, which makes the tolerance relative and absolute.

use super::{FmuInstance, inputs::InputDriver};
use crate::{
    Error, Result,
    integrate::{
        Budget, in_words,
        method::MethodChoice,
        radau::{self, CollocationStep, ImplicitProblem, RadauMemory},
    },
};
use nalgebra::{DMatrix, DVector};
use ode_solvers::{
    Dop853, System,
    dop_shared::{IntegrationError, OutputType},
};
use std::cell::{Cell, RefCell};

/// An event is located to this share of its time and of the step that it is found in.
const LOCATED: f64 = 100.0 * f64::EPSILON;
/// Trials to locate an event; every fourth halves the interval that it lies in.
const MAX_TRIALS: usize = 400;
/// Steps that a stretch may have, by each of the methods.
const MAX_STEPS: u32 = 100_000;
/// Steps of a stretch after which the explicit method looks whether the equations are stiff.
const STIFF_AFTER: u32 = 1000;

/// Constant part of a run.
#[derive(Clone, Debug)]
pub(super) struct IntegratedModel<'a> {
    pub instance: &'a FmuInstance<'a>,
    pub inputs: &'a InputDriver<'a>,
    /// Relative to the states and to their nominal values.
    pub tolerance: f64,
    /// `true` if the FMU requires a report of each completed step.
    pub completes_steps: bool,
    /// Value references of states and of their derivatives, if the FMU provides directional derivatives of these.
    pub directional: Option<(Vec<u32>, Vec<u32>)>,
}

impl IntegratedModel<'_> {
    pub fn read_indicators(&self, indicators: &mut [f64]) -> Result<()> {
        if indicators.is_empty() { Ok(()) } else { self.instance.get_event_indicators(indicators) }
    }

    /// Reports that the step to where the FMU is now is part of the solution.
    pub fn complete_step(&self) -> Result<Option<Stop>> {
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
pub(super) enum Stop {
    Event,
    Terminated,
}

/// End of a part of a stretch by one method.
enum PartEnd {
    /// The end of the stretch, or a stop before it.
    Reached(Option<Stop>),
    /// The method gave up; the other one may continue from where it was.
    GaveUp(Error),
}

/// Position of a run. With a state of the FMU it is all that is needed to continue from there.
#[derive(Clone, Debug)]
pub struct RunPosition {
    pub(super) time: f64,
    pub(super) states: Vec<f64>,
    pub(super) nominals: Vec<f64>,
    pub(super) indicators: Vec<f64>,
    /// Time of the FMU's next event.
    pub(super) next_event: Option<f64>,
    /// Rows of the inputs up to here.
    pub(super) rows: usize,
    choice: MethodChoice,
    /// Step size that the explicit method begins with, if one proved right.
    step: Option<f64>,
    /// Memory of the last step of the implicit method.
    memory: Option<RadauMemory>,
}

impl RunPosition {
    /// The beginning of a run, before its first event: numbers of states and of event indicators, rows of the inputs up to there.
    pub(super) fn new(time: f64, states: usize, indicators: usize, rows: usize) -> Self {
        Self {
            time,
            states: vec![0.0; states],
            nominals: vec![1.0; states],
            indicators: vec![0.0; indicators],
            next_event: None,
            rows,
            choice: MethodChoice::default(),
            step: None,
            memory: None,
        }
    }

    /// Forgets the steps before a jump of states or equations.
    pub(super) fn forget_steps(&mut self) {
        self.step = None;
        self.memory = None;
    }

    /// Integrates up to a time or the first event before it.
    pub(super) fn stretch(&mut self, model: &mut IntegratedModel, end: f64) -> Result<Option<Stop>> {
        let mut gave_up = None;
        loop {
            let is_implicit = self.choice.is_stiff() && gave_up != Some(true);
            match self.part(model, end, is_implicit)? {
                PartEnd::Reached(stop) => return Ok(stop),
                // derivatives that the FMU provides may be wrong
                PartEnd::GaveUp(_) if is_implicit && model.directional.take().is_some() => {}
                PartEnd::GaveUp(error) if gave_up.is_some() => return Err(error),
                PartEnd::GaveUp(_) => {
                    gave_up = Some(is_implicit);
                    self.choice.set_stiff();
                }
            }
        }
    }

    /// Integrates by one method.
    fn part(&mut self, model: &IntegratedModel, end: f64, is_implicit: bool) -> Result<PartEnd> {
        let length = end - self.time;
        let stretch = ContinuousStretch {
            model,
            start: self.time,
            end,
            rows: self.rows,
            inputs_vary: model.inputs.vary(self.rows),
            nominals: &self.nominals,
            unscaled: RefCell::new(vec![0.0; self.states.len()]),
            evaluations: Cell::new(0),
            failure: RefCell::default(),
            discarded: RefCell::default(),
        };
        let scaled = self.states.iter().zip(&self.nominals).map(|(state, nominal)| state / nominal);
        let first = SolutionPoint {
            elapsed: 0.0,
            state: DVector::from_iterator(self.states.len(), scaled),
            indicators: self.indicators.clone(),
        };
        let has_states = !self.states.is_empty();
        let steps =
            AcceptedSteps { before: first.clone(), now: first, longest: 0.0, stop: None, count: 0, is_located: false };
        let (steps, gave_up) = if is_implicit && has_states {
            stretch.implicit(length, steps, &mut self.memory)?
        } else {
            stretch.explicit(length, self.step.map_or(0.0, |step| step.min(length)), steps)?
        };
        let AcceptedSteps { before, mut now, longest, mut stop, is_located, .. } = steps;
        if crossed(&before.indicators, &now.indicators) {
            if !is_located {
                now = stretch.locate(&before, now, |elapsed| stretch.state_after(&before, elapsed))?;
            }
            stretch.put(now.elapsed, &now.state)?;
            stop = model.complete_step()?.or(Some(Stop::Event));
        }
        if !is_implicit {
            self.step = Some(longest).filter(|longest| *longest > 0.0).or(self.step);
        }
        if !self.choice.is_stiff() && has_states {
            let evaluations = stretch.evaluations.get();
            self.choice
                .note((evaluations, now.elapsed), gave_up.is_some(), || stretch.jacobian(now.elapsed, &now.state));
            if stretch.evaluations.get() > evaluations {
                // differences have moved the FMU
                stretch.put(now.elapsed, &now.state)?;
            }
        }
        self.time = stretch.time(now.elapsed);
        let SolutionPoint { state, indicators, .. } = now;
        self.states.iter_mut().zip(&self.nominals).zip(&state).for_each(|((to, nominal), z)| *to = z * nominal);
        self.indicators = indicators;
        Ok(gave_up.filter(|_| stop.is_none()).map_or(PartEnd::Reached(stop), PartEnd::GaveUp))
    }
}

/// A part of a run without discontinuities. States are those of the FMU in units of the nominal values.
struct ContinuousStretch<'a> {
    model: &'a IntegratedModel<'a>,
    start: f64,
    end: f64,
    /// Rows of the inputs up to its start.
    rows: usize,
    inputs_vary: bool,
    nominals: &'a [f64],
    /// The FMU's states: a position to compute them.
    unscaled: RefCell<Vec<f64>>,
    /// Evaluations of the derivatives.
    evaluations: Cell<u64>,
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
    count: u32,
    /// `true` if `now` is the located event.
    is_located: bool,
}

/// Steps up to the end of a method, and the error if it gave up for stiffness or cost.
type MethodEnd = (AcceptedSteps, Option<Error>);

impl ContinuousStretch<'_> {
    /// Integrates by the explicit method. Every accepted step is checked, and an event ends the integration.
    fn explicit(&self, length: f64, step: f64, steps: AcceptedSteps) -> Result<MethodEnd> {
        let from = steps.now.state.clone();
        let steps = RefCell::new(steps);
        let gave_up = self.solve(&from, 0.0, length, step, Some(&steps))?.err();
        Ok((steps.into_inner(), gave_up))
    }

    /// Integrates by the implicit method as [`Self::explicit`]; `memory` is that of the step before.
    fn implicit(&self, length: f64, steps: AcceptedSteps, memory: &mut Option<RadauMemory>) -> Result<MethodEnd> {
        let from = steps.now.state.clone();
        let mut problem = ImplicitStretch { stretch: self, steps };
        let (times, tolerance, budget) = ([0.0, length], self.model.tolerance, Budget::default());
        let result = radau::resume(&mut problem, from, &times, tolerance, &budget, memory);
        if let Some(error) = self.failure.take() {
            return Err(error);
        }
        let steps = problem.steps;
        let message = match (result.failure, self.discarded.take()) {
            (None, _) if steps.count < MAX_STEPS => return Ok((steps, None)),
            (None, _) => format!("more than {MAX_STEPS} steps of the implicit method"),
            (Some(_), Some(discarded)) => discarded.to_string(),
            // the error has the time of the run
            (Some(failure), None) => failure.message,
        };
        *memory = None;
        let error = Error::Integration { time: self.time(steps.now.elapsed), message };
        Ok((steps, Some(error)))
    }

    /// The state at a time of the last step, by the explicit method in one step or more.
    fn state_after(&self, before: &SolutionPoint, elapsed: f64) -> Result<DVector<f64>> {
        let duration = elapsed - before.elapsed;
        let state = self.solve(&before.state, before.elapsed, duration, duration, None)??;
        // without the time
        Ok(state.rows(0, self.nominals.len()).into_owned())
    }

    /// Returns the state, and the time behind it, after `duration`. The inner error is that of giving up for stiffness or cost.
    fn solve(
        &self,
        from: &DVector<f64>,
        begin: f64,
        duration: f64,
        step: f64,
        steps: Option<&RefCell<AcceptedSteps>>,
    ) -> Result<Result<DVector<f64>>> {
        // time is a state: see [`crate::integrate`]
        let from = from.push(begin);
        let mut problem = ExplicitStretch { stretch: self, steps };
        if self.nominals.is_empty() {
            // nothing but the time
            let end = from.add_scalar(duration);
            problem.solout(duration, &end, &end);
            return self.failure.take().map_or(Ok(Ok(end)), Err);
        }
        let tolerance = self.model.tolerance;
        let (safety, beta, least, most) = (0.9, 0.0, 0.333, 6.0);
        let mut solver = Dop853::from_param(
            problem,
            0.0,
            duration,
            duration,
            from,
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
            (Ok(_), Some(state)) => Ok(Ok(state.clone())),
            (result, last) => {
                let (message, gave_up) = match &result {
                    Ok(_) => (String::new(), false),
                    Err(error @ IntegrationError::StepSizeUnderflow { .. }) => (in_words(error), false),
                    Err(error) => (in_words(error), true),
                };
                let message = self.discarded.take().map_or(message, |error| error.to_string());
                let elapsed = last.and_then(|state| state.as_slice().last()).copied().unwrap_or(0.0);
                let error = Error::Integration { time: self.start + elapsed, message };
                if gave_up { Ok(Err(error)) } else { Err(error) }
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

    /// Evaluates the derivatives of the states; false where they do not exist or the FMU failed.
    fn derive(&self, elapsed: f64, state: &DVector<f64>, rates: &mut [f64]) -> bool {
        if self.failure.borrow().is_some() {
            return false;
        }
        self.evaluations.set(self.evaluations.get() + 1);
        match self.put(elapsed, state).and_then(|()| self.model.instance.get_derivatives(rates)) {
            Ok(()) => {
                rates.iter_mut().zip(self.nominals).for_each(|(rate, nominal)| *rate /= nominal);
                return true;
            }
            // a step into a position without solution is tried again shorter
            Err(error @ Error::Fmi { status: "discard", .. }) => *self.discarded.borrow_mut() = Some(error),
            Err(error) => *self.failure.borrow_mut() = Some(error),
        }
        false
    }

    /// The derivatives of the states as a vector.
    fn rates(&self, elapsed: f64, state: &DVector<f64>) -> Option<DVector<f64>> {
        let mut rates = DVector::zeros(state.len());
        self.derive(elapsed, state, rates.as_mut_slice()).then_some(rates)
    }

    /// Jacobian of the derivatives at a point.
    fn jacobian(&self, elapsed: f64, state: &DVector<f64>) -> Option<DMatrix<f64>> {
        self.directional(elapsed, state).or_else(|| {
            let value = self.rates(elapsed, state)?;
            radau::jacobian(|state| self.rates(elapsed, state), state, &value)
        })
    }

    /// Jacobian by the directional derivatives that the FMU provides.
    fn directional(&self, elapsed: f64, state: &DVector<f64>) -> Option<DMatrix<f64>> {
        let (states, derivatives) = self.model.directional.as_ref()?;
        let mut jacobian = DMatrix::zeros(state.len(), state.len());
        self.put(elapsed, state).ok()?;
        for (column, (reference, nominal)) in states.iter().zip(self.nominals).enumerate() {
            let changes = self.model.instance.directional_derivative(derivatives, &[*reference], &[*nominal]).ok()?;
            for (row, (change, nominal)) in changes.iter().zip(self.nominals).enumerate() {
                jacobian[(row, column)] = change / nominal;
            }
        }
        Some(jacobian)
    }

    /// Follows an accepted step; false at an event.
    fn follow(&self, steps: &mut AcceptedSteps, elapsed: f64, state: &[f64]) -> Result<bool> {
        let AcceptedSteps { before, now, longest, stop, count, .. } = steps;
        std::mem::swap(before, now);
        now.elapsed = elapsed;
        now.state.copy_from_slice(state);
        *longest = longest.max(elapsed - before.elapsed);
        *count += 1;
        self.put(elapsed, &now.state)?;
        self.model.read_indicators(&mut now.indicators)?;
        if crossed(&before.indicators, &now.indicators) {
            return Ok(false);
        }
        *stop = self.model.complete_step()?;
        Ok(stop.is_none())
    }

    /// Follows an accepted step of the implicit method; false at an event. Such steps are long: indicators are read at the nodes, too.
    fn follow_nodes(&self, steps: &mut AcceptedSteps, step: &CollocationStep) -> Result<bool> {
        let between = |elapsed: f64| Ok(step.at((elapsed - step.t) / step.size));
        let nodes = CollocationStep::nodes();
        let (inside, end) = (nodes.len() - 1, step.at_node(nodes.len() - 1));
        let mut low = steps.now.clone();
        for (node, share) in nodes.iter().enumerate().take(if low.indicators.is_empty() { 0 } else { inside }) {
            let mut high = low.clone();
            high.elapsed = step.t + share * step.size;
            high.state = step.at_node(node);
            self.put(high.elapsed, &high.state)?;
            self.model.read_indicators(&mut high.indicators)?;
            if crossed(&low.indicators, &high.indicators) {
                steps.now = self.locate(&low, high, between)?;
                steps.before = low;
                steps.is_located = true;
                return Ok(false);
            }
            low = high;
        }
        if self.follow(steps, step.t + step.size, end.as_slice())? {
            return Ok(true);
        }
        if crossed(&steps.before.indicators, &steps.now.indicators) {
            steps.now = self.locate(&low, steps.now.clone(), between)?;
            steps.is_located = true;
        }
        Ok(false)
    }

    /// The first point, up to the tolerance, where indicators have changed that had not `before` and have `after`.
    ///
    /// Trials are states of the solution between the two. They are placed by the Illinois method, every fourth one in the middle,
    /// which limits their number for any indicators.
    fn locate(
        &self,
        before: &SolutionPoint,
        mut after: SolutionPoint,
        between: impl Fn(f64) -> Result<DVector<f64>>,
    ) -> Result<SolutionPoint> {
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
            let state = between(elapsed)?;
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
    let shares = low.iter().zip(high).filter_map(|(low, high)| {
        let (low, high) = (weights.0 * low, weights.1 * high);
        ((low > 0.0) != (high > 0.0)).then(|| low / (low - high)).filter(|share| (0.0..=1.0).contains(share))
    });
    shares.min_by(f64::total_cmp).unwrap_or(0.5)
}

/// Problem that `ode_solvers` takes over and drops. Its state is that of the stretch, followed by the time since the start.
struct ExplicitStretch<'a> {
    stretch: &'a ContinuousStretch<'a>,
    steps: Option<&'a RefCell<AcceptedSteps>>,
}

impl System<f64, DVector<f64>> for ExplicitStretch<'_> {
    fn system(&self, _: f64, state: &DVector<f64>, derivative: &mut DVector<f64>) {
        let count = state.len() - 1;
        if self.stretch.derive(state[count], state, &mut derivative.as_mut_slice()[..count]) {
            derivative[count] = 1.0;
        } else {
            derivative.fill(f64::NAN);
        }
    }

    /// Returns true if the integration must stop.
    fn solout(&mut self, elapsed: f64, state: &DVector<f64>, _: &DVector<f64>) -> bool {
        let Some(steps) = self.steps else { return false };
        let state = &state.as_slice()[..state.len() - 1];
        match self.stretch.follow(&mut steps.borrow_mut(), elapsed, state) {
            Ok(continues) => !continues,
            Err(error) => {
                *self.stretch.failure.borrow_mut() = Some(error);
                true
            }
        }
    }
}

/// Problem of the implicit method.
struct ImplicitStretch<'a> {
    stretch: &'a ContinuousStretch<'a>,
    steps: AcceptedSteps,
}

impl ImplicitProblem for ImplicitStretch<'_> {
    fn derivative(&mut self, elapsed: f64, state: &DVector<f64>) -> Option<DVector<f64>> {
        self.stretch.rates(elapsed, state)
    }

    fn jacobian(&mut self, elapsed: f64, state: &DVector<f64>) -> Option<DMatrix<f64>> {
        self.stretch.directional(elapsed, state)
    }

    fn accept(&mut self, step: &CollocationStep) -> bool {
        match self.stretch.follow_nodes(&mut self.steps, step) {
            Ok(continues) => !continues || self.steps.count >= MAX_STEPS,
            Err(error) => {
                *self.stretch.failure.borrow_mut() = Some(error);
                true
            }
        }
    }

    fn is_last(&mut self, _: f64, _: &DVector<f64>) -> bool {
        false
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
