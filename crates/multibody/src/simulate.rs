//! Runs of a model: integration of its equations of motion, or, where the drivers leave nothing free, its [`kinematics`].
//!
//! The explicit method integrates as long as accuracy decides the length of its steps. Where stability does, the implicit method continues.

use super::{
    bends::Bending,
    constraint::independence,
    description::FormulationKind,
    error::{MotionCause, MotionError},
    formulation::{Acceleration, Formulation, mobility},
    kinematics,
    model::{MultibodyModel, Sample, Spring},
    switches::{Branch, Stops},
};
use crate::integrate::{
    self, Budget, IntegrationFailure, IntegrationResult,
    method::{Lap, MethodChoice},
    radau,
};
use nalgebra::{DMatrix, DVector};
use ode_solvers::System;
use std::cell::RefCell;

/// Fraction of a constraint's [independence] at the start of a run below which its position is nearly singular.
const NEARLY_SINGULAR: f64 = 0.1;

/// Samples at evenly spaced times, from a consistent state at the first of them.
///
/// # Errors
/// An error that says what failed, when, and at which joint, or that the run's budget is spent.
pub fn simulate(model: &MultibodyModel, times: &[f64], budget: &Budget) -> Result<Vec<Sample>, MotionError> {
    let Some(&start) = times.first() else { return Ok(Vec::new()) };
    let (q, v) = model.initial_state(start)?;
    simulate_from(model, (q, v, model.actuator_starts()), times, budget)
}

/// Samples at evenly spaced times, from a given state, which must be consistent.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_from(
    model: &MultibodyModel,
    state: (DVector<f64>, DVector<f64>, Vec<f64>),
    times: &[f64],
    budget: &Budget,
) -> Result<Vec<Sample>, MotionError> {
    continue_from(model, state, times, budget, &mut MethodChoice::default())
}

/// Samples at evenly spaced times, from a given state, with the latest choice of the method.
///
/// # Errors
/// As [`simulate`].
pub(super) fn continue_from(
    model: &MultibodyModel,
    (q, v, z): (DVector<f64>, DVector<f64>, Vec<f64>),
    times: &[f64],
    budget: &Budget,
    choice: &mut MethodChoice,
) -> Result<Vec<Sample>, MotionError> {
    let Some(&start) = times.first() else { return Ok(Vec::new()) };
    budget.begin(times);
    if model.degrees_of_freedom() == 0 && model.actuator_states.is_empty() {
        return kinematics::follow(model, times, q, budget);
    }
    let formulation = Formulation::new(model.formulation, model, start, &q)?;
    let mut samples = vec![sample(model, &formulation, start, (q, v, z))?];
    // signals with kinks have them at the rows: beginning anew there is faster than finding them
    let has_kinks = model.inputs.iter().any(|input| input.signal.has_knots());
    let bending = &Bending::of(model);
    let rows = if has_kinks || !bending.is_empty() { 2 } else { times.len() };
    let mut stops = Stops::new(model, times)?;
    let run = ModelRun { model, budget, bending, has_stops: stops.has_any() };
    // where the run is, if that is not a row
    let mut between: Option<Sample> = None;
    while samples.len() < times.len() {
        let from = between.as_ref().unwrap_or(&samples[samples.len() - 1]);
        let stretch = stops.next(from.t, &times[samples.len()..], if between.is_some() { 2 } else { rows });
        let next = run.rows(from, &stretch.times, choice).or_else(|error| {
            // where stability could not be checked, the implicit method may succeed
            budget.renew();
            if choice.is_stiff() || budget.is_over() || !choice.is_suspect() {
                return Err(error);
            }
            choice.set_stiff();
            run.rows(from, &stretch.times, choice).map_err(|_| error)
        });
        let mut next = next?;
        between = if stretch.has_rows { None } else { next.pop() };
        samples.extend(next);
    }
    Ok(samples)
}

/// Part of the time between two rows that is not divided any further.
const SHORTEST: f64 = 1e-12;

/// A run of a model.
#[derive(Clone, Copy)]
struct ModelRun<'a> {
    model: &'a MultibodyModel,
    budget: &'a Budget<'a>,
    /// Arguments whose bends may be stepped over.
    bending: &'a Bending<'a>,
    /// True if steps end at switches of formulas.
    has_stops: bool,
}

impl ModelRun<'_> {
    /// The samples after one, at least one of them.
    fn rows(self, from: &Sample, ahead: &[f64], choice: &mut MethodChoice) -> Result<Vec<Sample>, MotionError> {
        let Self { model, budget, bending, .. } = self;
        let next = match bending.is_empty() {
            true => self.stretch(model.formulation, from, ahead, choice),
            false => self.over_bends(from, ahead[1], choice).map(|sample| vec![sample]),
        };
        match next {
            Ok(next) => Ok(next),
            // with other independent coordinates on the way it may succeed, and else with all coordinates
            Err(_) if model.formulation == FormulationKind::Embedding && !budget.is_over() => {
                match self.bridge(from, ahead[1], 5, choice) {
                    Ok(sample) => Ok(vec![sample]),
                    Err(error) if budget.is_over() => Err(error),
                    Err(error) => {
                        let all = self.stretch(FormulationKind::Augmented, from, &ahead[..2], choice);
                        all.map_err(|_| error)
                    }
                }
            }
            Err(error) => Err(error),
        }
    }

    /// The sample at a time; on the way no bend is stepped over.
    fn over_bends(self, from: &Sample, t: f64, choice: &mut MethodChoice) -> Result<Sample, MotionError> {
        let kind = self.model.formulation;
        let (mut from, least) = (from.clone(), SHORTEST * (t - from.t));
        let mut h = t - from.t;
        while from.t < t {
            let to = if from.t + h < t - least { from.t + h } else { t };
            self.bending.begin(&from, to);
            let next = self.stretch(kind, &from, &[from.t, to], choice)?.swap_remove(0);
            let share = self.bending.share_up_to(self.model, &next);
            let step = to - from.t;
            if share < 1.0 && share * step > least {
                h = step * share.min(0.9);
                continue;
            }
            from = next;
            h = 5.0 * step;
        }
        Ok(from)
    }

    /// The sample at the next time; independent coordinates are chosen again in between as often as necessary.
    fn bridge(self, from: &Sample, t: f64, halvings: u32, choice: &mut MethodChoice) -> Result<Sample, MotionError> {
        match self.stretch(self.model.formulation, from, &[from.t, t], choice) {
            Ok(mut samples) => Ok(samples.swap_remove(0)),
            Err(error) if halvings == 0 || self.budget.is_over() => Err(error),
            Err(_) => {
                let middle = self.bridge(from, 0.5 * (from.t + t), halvings - 1, choice)?;
                self.bridge(&middle, t, halvings - 1, choice)
            }
        }
    }

    /// The samples after one, as far as a formulation's choices last; at least one.
    fn stretch(
        self,
        kind: FormulationKind,
        from: &Sample,
        times: &[f64],
        choice: &mut MethodChoice,
    ) -> Result<Vec<Sample>, MotionError> {
        let Self { model, budget, bending, has_stops } = self;
        let formulation = Formulation::new(kind, model, from.t, &from.q)?;
        let [guess, speeds] = [&from.q, &from.v].map(|from| RefCell::new(from.clone()));
        let undefined = RefCell::default();
        let branch = has_stops.then(|| Branch::of(times));
        let stretch = Stretch {
            model,
            formulation,
            guess,
            speeds,
            z: from.actuator_states(model),
            budget,
            undefined,
            bending,
            branch,
        };
        let states = stretch.integrate(from, times, choice)?;
        let mut samples: Vec<Sample> = Vec::with_capacity(states.len());
        for (state, &t) in states.iter().zip(times).skip(1) {
            let guess = samples.last().map_or(&from.q, |sample| &sample.q);
            let (_, state, z) = split(state, model.actuator_states.len());
            let (mut q, mut v) = stretch.formulation.complete(model, t, &state, guess)?;
            model.constraints.correct_positions(t, &mut q)?;
            model.constraints.correct_velocities(t, &q, &mut v)?;
            samples.push(sample(model, &stretch.formulation, t, (q, v, z))?);
        }
        Ok(samples)
    }
}

fn sample(
    model: &MultibodyModel,
    formulation: &Formulation,
    t: f64,
    (q, v, z): (DVector<f64>, DVector<f64>, Vec<f64>),
) -> Result<Sample, MotionError> {
    let u = model.at(t, &z);
    let acceleration = formulation.accelerate(model, t, (&q, &v), &u);
    let Acceleration { qdd, multipliers } =
        acceleration.map_err(|error| model.undefined_force(t, &q, &v, &u).unwrap_or(error))?;
    model.check(t, &q, &v)?;
    Ok(Sample { t, q, v, u, qdd, multipliers })
}

/// A part of a run with one formulation's choices.
struct Stretch<'a> {
    model: &'a MultibodyModel,
    formulation: Formulation,
    /// Coordinates found last: where the search for dependent coordinates begins.
    guess: RefCell<DVector<f64>>,
    /// Velocities found last.
    speeds: RefCell<DVector<f64>>,
    /// Actuator states at the start.
    z: &'a [f64],
    budget: &'a Budget<'a>,
    /// A force that was not a number where the integrator has been.
    undefined: RefCell<Option<MotionError>>,
    /// Where the arguments with bends have been.
    bending: &'a Bending<'a>,
    /// Where formulas of time are on one branch, if they switch.
    branch: Option<Branch>,
}

impl Stretch<'_> {
    /// The states at `times`, or at the first of them if the formulation wears out before the end; at least two.
    fn integrate(
        &self,
        from: &Sample,
        times: &[f64],
        choice: &mut MethodChoice,
    ) -> Result<Vec<DVector<f64>>, MotionError> {
        let state = joined(&self.formulation.state(&from.q, &from.v), from.actuator_states(self.model), from.t);
        let mut implicit = None;
        if choice.is_stiff() {
            let result = self.implicit(&state, times)?;
            if result.states.len() >= 2 {
                return Ok(result.states);
            }
            implicit = Some(result);
        }
        self.bending.restart();
        let lap = Lap::begin(self.budget, from.t);
        let is_watched = self.branch.is_some() || !self.bending.is_empty();
        let ends_exactly = is_watched && times.len() == 2;
        let problem = StretchProblem { stretch: self, start: if ends_exactly { f64::INFINITY } else { from.t } };
        let tolerance = self.model.tolerance;
        let IntegrationResult { states, failure, is_stiff, .. } = match times {
            &[begin, end] if ends_exactly => {
                integrate::advance_to(problem, state.clone(), [begin, end], tolerance, self.budget)
            }
            times => integrate::advance(problem, state.clone(), times, tolerance, self.budget),
        };
        let gave_up = is_stiff || self.budget.is_spent();
        if !choice.is_stiff()
            && choice.note(lap.end(self.budget), gave_up, || self.jacobian(states.last().unwrap_or(&state)))
        {
            self.budget.renew();
            if states.len() < 2 {
                let result = self.implicit(&state, times)?;
                if result.states.len() >= 2 {
                    return Ok(result.states);
                }
                implicit = Some(result);
            }
        }
        self.check_budget()?;
        // after a failure the next stretch may succeed, if there is a row from which to continue
        if states.len() >= 2 {
            Ok(states)
        } else {
            Err(self.explain(implicit.map_or(failure, |result| result.failure), from.t))
        }
    }

    /// A stretch by the implicit method, which has failed if there are fewer than two states.
    ///
    /// # Errors
    /// The budget is exhausted.
    fn implicit(&self, state: &DVector<f64>, times: &[f64]) -> Result<IntegrationResult<DVector<f64>>, MotionError> {
        let guess = self.guess.borrow().clone();
        self.bending.restart();
        let mut problem = StretchProblem { stretch: self, start: times[0] };
        let mut result = radau::advance(&mut problem, without_time(state), times, self.model.tolerance, self.budget);
        self.check_budget()?;
        if result.states.len() < 2 {
            self.guess.replace(guess);
        }
        result.states.iter_mut().zip(times).for_each(|(state, t)| *state = state.push(*t));
        Ok(result)
    }

    /// The Jacobian of the equations in a state, its time fixed.
    fn jacobian(&self, state: &DVector<f64>) -> Option<DMatrix<f64>> {
        let (guess, undefined) = (self.guess.borrow().clone(), self.undefined.borrow().clone());
        let t = state[state.len() - 1];
        let rates = |y: &DVector<f64>| self.derivative(&y.push(t)).ok().map(|rates| without_time(&rates));
        let y = without_time(state);
        let found = rates(&y).and_then(|value| radau::jacobian(rates, &y, &value));
        self.guess.replace(guess);
        self.undefined.replace(undefined);
        found
    }

    /// Error of a failed stretch, with the reason in the equations of motion. Without a failure of the method, a state is not finite.
    fn explain(&self, failure: Option<IntegrationFailure>, t: f64) -> MotionError {
        if let Some(error) = self.undefined.take() {
            let message = format!("integration failed after t = {t} s: {error}");
            return error.with_message(message);
        }
        let q = self.guess.borrow();
        let rest = DVector::zeros(q.len());
        let reason = self.formulation.accelerate(self.model, t, (&q, &rest), &self.model.at(t, self.z)).err();
        let reason = reason.or_else(|| self.singular()).or_else(|| self.stiffest_part());
        let failure = failure.map_or("the state is not finite".into(), |failure| failure.to_string());
        let failed = format!("integration failed after t = {t} s: {failure}");
        match reason {
            Some(reason) => {
                let message = format!("{failed}; {reason}");
                reason.with_message(message)
            }
            None => MotionError::new(MotionCause::Unsolved, failed),
        }
    }

    /// Fails if the run must be abandoned, with the reason why the integration does not progress if it is known.
    fn check_budget(&self) -> Result<(), MotionError> {
        let mut reason = None;
        let checked = self.budget.check(|| {
            reason = self.obstacle();
            reason.as_ref().map(MotionError::to_string)
        });
        checked.map_err(|error| match reason {
            Some(reason) if reason.cause == MotionCause::Singular => reason.with_message(error.message),
            reason => MotionError { part: reason.and_then(|reason| reason.part), ..error.into() },
        })
    }

    /// The reason that prevents the integration from progressing, if it is known.
    fn obstacle(&self) -> Option<MotionError> {
        let stiffest = self.stiffest_part().map(too_fast);
        stiffest.or_else(|| self.singular()).or_else(|| self.largest_force().map(too_fast))
    }

    /// The error of the force or torque that has become largest, if it is a formula.
    fn largest_force(&self) -> Option<MotionError> {
        let (q, v, t) = (self.guess.borrow(), self.speeds.borrow(), self.budget.reached());
        let u = self.model.at(t, self.z);
        let values = self.model.acting_expressions().map(|(bound, owner)| (owner, bound.value(t, &*q, &v, &u)));
        let (owner, value) = values.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        let message = format!("`{owner}` is the largest force, {value:.1e}");
        Some(MotionError::of(owner, MotionCause::Unsolved, message))
    }

    /// The error of the spring or actuator state that alone makes the fastest motion or decay, if that decides the length of the steps.
    fn stiffest_part(&self) -> Option<MotionError> {
        let rates = self.rates_of_springs().into_iter().chain(self.rates_of_actuators());
        let (part, rate) = rates.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let message = format!("the stiffest part is `{part}`, {rate:.1e} rad/s");
        let is_short = rate * self.budget.last_step() > 0.01;
        is_short.then(|| MotionError::of(part, MotionCause::Unsolved, message))
    }

    /// The error of the constraint that has come close to depending on others.
    fn singular(&self) -> Option<MotionError> {
        let (start, _) = self.model.initial_state(self.budget.start()).ok()?;
        let here = self.model.deciding.gradients(&*self.guess.borrow());
        let parts = [&self.model.deciding.gradients(&start), &here].map(|gradients| independence(&gradients.dense()));
        let is_close = parts[0].iter().zip(&parts[1]).any(|(before, now)| *now < NEARLY_SINGULAR * before);
        is_close.then(|| self.model.deciding.singular(self.budget.reached(), &here))
    }

    /// Angular frequency or rate of decay that each spring makes alone.
    fn rates_of_springs(&self) -> Vec<(&str, f64)> {
        let rates = self.model.springs.iter().filter_map(|Spring { coordinate, stiffness, damping, owner, .. }| {
            let mobility = mobility(self.model, &self.guess.borrow(), coordinate)?;
            Some((owner.as_str(), (stiffness * mobility).sqrt().max(damping * mobility)))
        });
        rates.collect()
    }

    /// Rate of growth or decay of each actuator state while all else stays, `|d zd / d z|`, at the start of the stretch.
    fn rates_of_actuators(&self) -> Vec<(&str, f64)> {
        let (q, t) = (self.guess.borrow(), self.budget.reached());
        let rest = DVector::zeros(q.len());
        let states = self.model.actuator_states.iter().enumerate();
        let rates = states.map(|(index, state)| {
            let by = f64::EPSILON.cbrt() * (1.0 + self.z[index].abs());
            let [low, high] = [-by, by].map(|by| {
                let mut z = self.z.to_vec();
                z[index] += by;
                state.rate.value(t, &*q, &rest, &self.model.at(t, &z))
            });
            (state.owner.as_str(), ((high - low) / (2.0 * by)).abs())
        });
        rates.collect()
    }

    /// Notes where arguments with bends are in the state whose derivative was found last.
    fn observe(&self, state: &DVector<f64>) {
        if !self.bending.is_empty() {
            let (t, _, z) = split(state, self.z.len());
            self.bending.try_state(t, &*self.guess.borrow(), &self.speeds.borrow(), &self.model.at(t, &z));
        }
    }

    /// Adds a state of an accepted step of the implicit method, without its time, to the paths of arguments with bends.
    fn add(&self, t: f64, state: &DVector<f64>) {
        let (_, state, z) = split(&state.push(t), self.z.len());
        if let Ok((q, v)) = self.formulation.complete(self.model, t, &state, &self.guess.borrow()) {
            self.bending.add(t, &q, &v, &self.model.at(t, &z));
        }
    }

    fn derivative(&self, state: &DVector<f64>) -> Result<DVector<f64>, MotionError> {
        let (t, state, z) = split(state, self.z.len());
        let t = self.branch.map_or(t, |branch| branch.nearest(t));
        let mut guess = self.guess.borrow_mut();
        let (q, v) = self.formulation.complete(self.model, t, &state, &guess)?;
        let u = self.model.at(t, &z);
        let acceleration = self.formulation.accelerate(self.model, t, (&q, &v), &u);
        let rates = self.model.actuator_rates(t, &q, &v, &u);
        let is_finite = acceleration.as_ref().is_ok_and(|acceleration| acceleration.qdd.iter().all(|x| x.is_finite()))
            && rates.iter().all(|rate| rate.is_finite());
        // stages after one that was not a number have no time either
        if t.is_finite()
            && !is_finite
            && let Some(error) = self.model.undefined_force(t, &q, &v, &u)
        {
            self.undefined.replace(Some(error.clone()));
            return Err(error);
        }
        let Acceleration { qdd, .. } = acceleration?;
        *guess = q;
        let derivative = joined(&self.formulation.state(&v, &qdd), &rates, 1.0);
        self.speeds.replace(v);
        Ok(derivative)
    }
}

/// An error of a part that makes the motion too fast to be integrated.
fn too_fast(error: MotionError) -> MotionError {
    let message = format!("the motion is too fast; {error}");
    error.with_message(message)
}

/// A stretch in the form that `ode_solvers` needs.
struct StretchProblem<'a> {
    stretch: &'a Stretch<'a>,
    /// Rows up to this time are no end of the stretch.
    start: f64,
}

impl System<f64, DVector<f64>> for StretchProblem<'_> {
    fn system(&self, _: f64, state: &DVector<f64>, derivative: &mut DVector<f64>) {
        match self.stretch.derivative(state) {
            Ok(value) => {
                derivative.copy_from(&value);
                self.stretch.observe(state);
            }
            // a step to a state without a solution is retried with a shorter one
            Err(_) => derivative.fill(f64::NAN),
        }
    }

    /// Stops after a row where the formulation is worn.
    fn solout(&mut self, _: f64, row: &DVector<f64>, _: &DVector<f64>) -> bool {
        self.stretch.bending.accept();
        let (t, state, _) = split(row, self.stretch.z.len());
        t > self.start && self.stretch.formulation.is_worn(self.stretch.model, t, &state)
    }
}

impl radau::ImplicitProblem for StretchProblem<'_> {
    fn derivative(&mut self, t: f64, state: &DVector<f64>) -> Option<DVector<f64>> {
        self.stretch.derivative(&state.push(t)).ok().map(|rates| without_time(&rates))
    }

    fn accept(&mut self, step: &radau::CollocationStep) -> bool {
        if !self.stretch.bending.is_empty() {
            for (node, share) in radau::CollocationStep::nodes().iter().enumerate() {
                self.stretch.add(step.t + share * step.size, &step.at_node(node));
            }
        }
        false
    }

    fn is_last(&mut self, t: f64, row: &DVector<f64>) -> bool {
        self.solout(t, &row.push(t), row)
    }
}

/// All integrated values but the time.
fn without_time(state: &DVector<f64>) -> DVector<f64> {
    state.rows(0, state.len() - 1).into_owned()
}

/// Vector of integrated values: state of the formulation, actuator states, time.
fn joined(state: &DVector<f64>, z: &[f64], t: f64) -> DVector<f64> {
    let count = state.len() + z.len() + 1;
    DVector::from_iterator(count, state.iter().chain(z).copied().chain([t]))
}

/// The time, the state of a formulation, and the actuator states.
fn split(state: &DVector<f64>, actuators: usize) -> (f64, DVector<f64>, Vec<f64>) {
    let (first, last) = (state.len() - 1 - actuators, state.len() - 1);
    (state[last], state.rows(0, first).into_owned(), state.as_slice()[first..last].to_vec())
}
