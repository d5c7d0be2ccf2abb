//! Surrogates with states: [equations of motion](Dynamics) and what is shown of the motion.
//!
//! The columns of a point are, in this order, with `n` coordinates
//!
//! | columns | |
//! |---|---|
//! | `p` | parameters |
//! | `n`, `n` | coordinates and velocities at the start: parameters, too; only the states' values at initialization |
//! | `u` | inputs |
//! | `n`, `n` | the states: coordinates `q` and velocities `v` |
//!
//! and the results are the outputs and the states' derivatives `v`, `vd`. A position is a function of the configuration,
//! `r(q, p) + w^T q` with whole numbers `w`, so that an angle may go around; its velocity and acceleration are exact derivatives.

use super::dynamics::{Dynamics, Work};
use crate::{
    Domain, FormatError, Input, Role, State,
    map::{
        Task,
        dictionary::{Atom, Dictionary},
        expect_finite, expect_shape,
        jet::{Jet, Number},
    },
};

/// Equations of motion, outputs, and the steps of the solver inside the FMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// The equations.
    pub dynamics: Dynamics,
    /// `r`, from `(q, p)`.
    pub positions: Dictionary,
    /// `w` of each position, shape `[positions, n]`.
    pub windings: Vec<f64>,
    /// What the outputs are.
    pub outputs: Vec<Shown>,
    /// Largest step of the Runge-Kutta method, in seconds.
    pub step: f64,
}

/// What an output shows of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// A position.
    Position(usize),
    /// The first derivative of a position with respect to time.
    Velocity(usize),
    /// The second one.
    Acceleration(usize),
    /// `v^T M v / 2`.
    KineticEnergy,
    /// The potential.
    PotentialEnergy,
}

/// Why a step of the solver was not made; the states are as before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepError {
    /// After so many seconds a state is not finite: the mass matrix is not positive definite there, or the motion diverged.
    NotFinite {
        /// Since the beginning of the step.
        after: f64,
    },
    /// More steps of the solver than [`MAX_SOLVER_STEPS`].
    TooManySteps,
}

/// Steps of the solver in one communication step at most.
pub const MAX_SOLVER_STEPS: f64 = 1e7;

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(crate) struct MotionScratch {
    plain: Parts<f64>,
    series: Parts<Jet>,
    /// Of an adjoint derivative: a direction, and the change of the results.
    direction: [Vec<f64>; 2],
    /// Columns at a stage, and the rates of the states at each stage.
    stage: Vec<f64>,
    rates: Vec<Vec<f64>>,
}

#[derive(Clone, Debug)]
struct Parts<T> {
    columns: Vec<T>,
    results: Vec<T>,
    equations: Work<T>,
    /// Columns of the positions along the motion, what they are and their working memory.
    along: Vec<Jet<T>>,
    positions: Vec<Jet<T>>,
    atoms: Vec<Atom<Jet<T>>>,
}

/// Where the parts of a point begin.
#[derive(Clone, Copy, Debug)]
struct Layout {
    coordinates: usize,
    parameters: usize,
    inputs: usize,
}

impl Layout {
    fn start(self) -> usize {
        self.parameters
    }

    fn inputs(self) -> usize {
        self.parameters + 2 * self.coordinates
    }

    fn states(self) -> usize {
        self.inputs() + self.inputs
    }

    fn columns(self) -> usize {
        self.states() + 2 * self.coordinates
    }
}

impl Motion {
    fn layout(&self) -> Layout {
        let Self { dynamics, .. } = self;
        Layout { coordinates: dynamics.coordinates(), parameters: dynamics.parameters(), inputs: dynamics.inputs() }
    }

    /// The same with some values of the parameters, as [`Dynamics::held`].
    ///
    /// # Errors
    /// As there.
    pub fn held(&self, parameters: &[f64]) -> Result<Self, FormatError> {
        let positions = self.positions.held(self.dynamics.coordinates(), parameters)?;
        let (windings, outputs) = (self.windings.clone(), self.outputs.clone());
        Ok(Self { dynamics: self.dynamics.held(parameters)?, positions, windings, outputs, step: self.step })
    }

    /// Number of states, twice that of the coordinates.
    pub fn states(&self) -> usize {
        2 * self.dynamics.coordinates()
    }

    /// Column of the input that gives each state at the start, in order.
    pub fn start_columns(&self) -> std::ops::Range<usize> {
        let layout = self.layout();
        layout.start()..layout.inputs()
    }

    /// Makes sure that it fits these inputs, states and so many outputs.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(crate) fn check(&self, inputs: &[Input], states: &[State], outputs: usize) -> Result<(), FormatError> {
        let layout = self.layout();
        let mut rest = inputs;
        let mut count = |is_wanted: fn(Role) -> bool| {
            let count = rest.iter().take_while(|input| is_wanted(input.role)).count();
            rest = &rest[count..];
            count
        };
        let parameters = count(|role| matches!(role, Role::Parameter(_)));
        let found = [parameters, count(|role| role == Role::Start), count(|role| role == Role::Input), rest.len()];
        expect_shape("inputs", &found, &[layout.parameters, self.states(), layout.inputs, 0])?;
        expect_shape("states", &[states.len()], &[self.states()])?;
        expect_shape("shown", &[self.outputs.len()], &[outputs])?;
        let columns = layout.coordinates + layout.parameters;
        expect_shape("positions", &[self.positions.columns()], &[columns])?;
        expect_shape("windings", &[self.windings.len()], &[self.positions.outputs() * layout.coordinates])?;
        expect_finite("windings", self.windings.iter().copied())?;
        for (index, shown) in self.outputs.iter().enumerate() {
            if let Shown::Position(position) | Shown::Velocity(position) | Shown::Acceleration(position) = shown
                && *position >= self.positions.outputs()
            {
                let (found, limit) = (*position as u64, self.positions.outputs() as u64);
                return Err(FormatError::Index { name: "shown".into(), index, found, limit });
            }
        }
        if let Some(input) = inputs.iter().find(|input| !input.encoding.is_plain()) {
            return Err(FormatError::Encoding { name: input.name.clone(), expected: "none with states" });
        }
        if !(self.step.is_finite() && self.step > 0.0) {
            return Err(FormatError::TimeStep { found: self.step });
        }
        Ok(())
    }

    pub(crate) fn scratch(&self) -> MotionScratch {
        let (columns, results) = (self.layout().columns(), self.outputs.len() + self.states());
        MotionScratch {
            plain: self.parts(),
            series: self.parts(),
            direction: [vec![0.0; columns], vec![0.0; results]],
            stage: vec![0.0; columns],
            rates: vec![vec![0.0; self.states()]; STAGES],
        }
    }

    fn parts<T: Number>(&self) -> Parts<T> {
        let (zero, none) = (T::from(0.0), Jet::<T>::from(0.0));
        Parts {
            columns: vec![zero; self.layout().columns()],
            results: vec![zero; self.outputs.len() + self.states()],
            equations: self.dynamics.work(),
            along: vec![none; self.positions.columns()],
            positions: vec![none; self.positions.outputs()],
            atoms: self.positions.work(),
        }
    }

    /// Does a task at a point. Does not allocate.
    pub(crate) fn perform(&self, point: &[f64], task: Task, scratch: &mut MotionScratch) {
        match task {
            Task::Outputs(results) => {
                scratch.plain.columns.copy_from_slice(point);
                self.respond(&mut scratch.plain);
                results.copy_from_slice(&scratch.plain.results);
            }
            Task::Series { rates: [first_rates, second_rates], first, second } => {
                let series = &mut scratch.series;
                for (index, column) in series.columns.iter_mut().enumerate() {
                    let (first, second) = (first_rates[index], second_rates.get(index).copied().unwrap_or(0.0));
                    *column = Jet { value: point[index], first, second };
                }
                self.respond(series);
                first.iter_mut().zip(&series.results).for_each(|(to, from)| *to = from.first);
                second.into_iter().flatten().zip(&series.results).for_each(|(to, from)| *to = from.second);
            }
            Task::Adjoint { weights, gradient } => {
                for column in 0..point.len() {
                    let mut direction = std::mem::take(&mut scratch.direction);
                    let [along, change] = &mut direction;
                    along.fill(0.0);
                    along[column] = 1.0;
                    self.perform(point, Task::Series { rates: [along, &[]], first: change, second: None }, scratch);
                    gradient[column] = weights.iter().zip(&*change).map(|(weight, change)| weight * change).sum();
                    scratch.direction = direction;
                }
            }
        }
    }

    /// The results at the columns.
    fn respond<T: Number>(&self, parts: &mut Parts<T>) {
        let layout = self.layout();
        self.accelerate(&parts.columns, &mut parts.equations);
        let Parts { columns, results, equations, along, positions, atoms } = parts;
        let n = layout.coordinates;
        let (q, v) = columns[layout.states()..].split_at(n);
        let a = &equations.accelerations;
        for (k, column) in along.iter_mut().enumerate() {
            *column = match k.checked_sub(n) {
                None => Jet { value: q[k], first: v[k], second: a[k] },
                Some(parameter) => Jet { value: columns[parameter], ..Jet::from(0.0) },
            };
        }
        if !positions.is_empty() {
            self.positions.compute(along, positions, &mut [], 0, atoms);
        }
        for (index, position) in positions.iter_mut().enumerate() {
            for (k, winding) in self.windings[index * n..][..n].iter().enumerate().filter(|(_, w)| **w != 0.0) {
                *position = *position + along[k].scaled(*winding);
            }
        }
        let (outputs, rates) = results.split_at_mut(self.outputs.len());
        for (to, shown) in outputs.iter_mut().zip(&self.outputs) {
            *to = match *shown {
                Shown::Position(position) => positions[position].value,
                Shown::Velocity(position) => positions[position].first,
                Shown::Acceleration(position) => positions[position].second,
                Shown::KineticEnergy => self.dynamics.energies(|k| v[k], equations)[0],
                Shown::PotentialEnergy => self.dynamics.energies(|k| v[k], equations)[1],
            };
        }
        rates[..n].copy_from_slice(v);
        rates[n..].copy_from_slice(a);
    }

    /// The accelerations at the columns.
    fn accelerate<T: Number>(&self, columns: &[T], equations: &mut Work<T>) {
        let layout = self.layout();
        let (q, v) = columns[layout.states()..].split_at(layout.coordinates);
        let u = &columns[layout.inputs()..layout.states()];
        let law = q.iter().chain(&columns[..layout.parameters]);
        equations.columns.iter_mut().zip(law).for_each(|(to, from)| *to = *from);
        self.dynamics.solve(&|k| v[k], &|k| u[k], equations);
    }
}

// ---- The solver --------------------------------------------------------------------------------------------------

/// Stages of the adaptive method.
const STAGES: usize = 7;

/// How inputs go on during a step, and what is clamped on the way.
#[derive(Clone, Copy, Debug)]
pub struct Drive<'a> {
    /// First and second derivative of each input column with respect to time at the beginning of the step.
    pub rates: [&'a [f64]; 2],
    /// Where inputs are clamped to, if they are.
    pub clamp: Option<&'a Domain>,
}

/// A Runge-Kutta method: each stage's time and its weights of the stages before; the weights of the result.
struct Tableau {
    stages: &'static [(f64, &'static [f64])],
    result: &'static [f64],
}

/// The classical method of order 4.
const CLASSICAL: Tableau = Tableau {
    stages: &[(0.0, &[]), (0.5, &[0.5]), (0.5, &[0.0, 0.5]), (1.0, &[0.0, 0.0, 1.0])],
    result: &[1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0],
};

/// Dormand, Prince (1980): order 5 with an embedded method of order 4.
const DORMAND_PRINCE: Tableau = Tableau {
    stages: &[
        (0.0, &[]),
        (0.2, &[0.2]),
        (0.3, &[3.0 / 40.0, 9.0 / 40.0]),
        (0.8, &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0]),
        (8.0 / 9.0, &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0]),
        (1.0, &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0]),
        (1.0, &DORMAND_PRINCE_RESULT),
    ],
    result: &DORMAND_PRINCE_RESULT,
};
const DORMAND_PRINCE_RESULT: [f64; 6] =
    [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0];
/// Result of order 5 minus that of order 4.
const DORMAND_PRINCE_ERROR: [f64; 7] =
    [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339_200.0, 22.0 / 525.0, -1.0 / 40.0];

impl Motion {
    /// Integrates the states at the end of `point` over `size` seconds: in equal steps of the classical Runge-Kutta method, none
    /// longer than [`Motion::step`], or, with a tolerance, in steps of the method of Dormand and Prince, whose local error is at
    /// most the tolerance relative to each state's magnitude and to `nominals`. Does not allocate.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    pub(crate) fn advance(
        &self,
        point: &mut [f64],
        (size, tolerance, nominals): (f64, Option<f64>, &[f64]),
        drive: Drive,
        scratch: &mut MotionScratch,
    ) -> Result<(), StepError> {
        let first = self.layout().states();
        // in the scratch of adjoint derivatives, which is free now
        scratch.direction[0].copy_from_slice(point);
        let result = match tolerance {
            None => self.fixed(point, size, drive, scratch),
            Some(tolerance) => self.adaptive(point, (size, tolerance, nominals), drive, scratch),
        };
        if result.is_err() {
            point[first..].copy_from_slice(&scratch.direction[0][first..]);
        }
        result
    }

    fn fixed(&self, point: &mut [f64], size: f64, drive: Drive, scratch: &mut MotionScratch) -> Result<(), StepError> {
        let first = self.layout().states();
        // rounding of the size does not cost a step
        let steps = (size / self.step * (1.0 - 1e-9)).ceil().max(1.0);
        if steps > MAX_SOLVER_STEPS {
            return Err(StepError::TooManySteps);
        }
        let h = size / steps;
        for step in 0..steps as u32 {
            let since = f64::from(step) * h;
            self.stages(&CLASSICAL, point, (since, h), drive, scratch);
            for (k, state) in point[first..].iter_mut().enumerate() {
                *state += h * weighted(CLASSICAL.result, &scratch.rates, k);
            }
            expect_finite_states(&point[first..], since + h)?;
        }
        Ok(())
    }

    fn adaptive(
        &self,
        point: &mut [f64],
        (size, tolerance, nominals): (f64, f64, &[f64]),
        drive: Drive,
        scratch: &mut MotionScratch,
    ) -> Result<(), StepError> {
        let first = self.layout().states();
        let (mut since, mut h) = (0.0, size.min(self.step));
        let mut steps = 0.0;
        // what is left by rounding is no step
        while size - since > 1e-14 * size {
            steps += 1.0;
            if steps > MAX_SOLVER_STEPS {
                return Err(StepError::TooManySteps);
            }
            let rest = size - since;
            // no sliver at the end
            h = if h > 0.99 * rest { rest } else { h.min(0.5 * rest) };
            self.stages(&DORMAND_PRINCE, point, (since, h), drive, scratch);
            let mut error = 0.0f64;
            for (k, state) in point[first..].iter().enumerate() {
                let scale = tolerance * state.abs().max(nominals[k]);
                let found = (h * weighted(&DORMAND_PRINCE_ERROR, &scratch.rates, k)).abs() / scale;
                // a maximum would leave out what is not a number
                error = if found > error || found.is_nan() { found } else { error };
            }
            if error <= 1.0 {
                for (k, state) in point[first..].iter_mut().enumerate() {
                    *state += h * weighted(DORMAND_PRINCE.result, &scratch.rates, k);
                }
                since += h;
                expect_finite_states(&point[first..], since)?;
            }
            // nan: the shortest
            let factor = if error.is_nan() { 0.1 } else { (0.9 * error.max(1e-10).powf(-0.2)).clamp(0.1, 5.0) };
            h *= factor;
            if h < 1e-14 * size {
                return Err(StepError::NotFinite { after: since });
            }
        }
        Ok(())
    }

    /// Rates of the states at the stages of a step of size `h`, `since` seconds after the beginning.
    fn stages(
        &self,
        tableau: &Tableau,
        point: &[f64],
        (since, h): (f64, f64),
        drive: Drive,
        scratch: &mut MotionScratch,
    ) {
        let layout = self.layout();
        let (n, first) = (layout.coordinates, layout.states());
        let MotionScratch { plain, stage, rates, .. } = scratch;
        stage.copy_from_slice(point);
        for (index, (time, weights)) in tableau.stages.iter().enumerate() {
            let later = since + time * h;
            for column in layout.inputs()..first {
                let value = point[column] + later * (drive.rates[0][column] + 0.5 * later * drive.rates[1][column]);
                stage[column] = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
            }
            for (k, state) in stage[first..].iter_mut().enumerate() {
                *state = point[first + k] + h * weighted(weights, rates, k);
            }
            self.accelerate(stage, &mut plain.equations);
            rates[index][..n].copy_from_slice(&stage[first + n..]);
            rates[index][n..].copy_from_slice(&plain.equations.accelerations);
        }
    }
}

fn weighted(weights: &[f64], rates: &[Vec<f64>], state: usize) -> f64 {
    weights.iter().zip(rates).map(|(weight, rates)| weight * rates[state]).sum()
}

fn expect_finite_states(states: &[f64], after: f64) -> Result<(), StepError> {
    if states.iter().all(|state| state.is_finite()) { Ok(()) } else { Err(StepError::NotFinite { after }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Evaluator, Model, Scratch, Surrogate, example};

    /// Rope, state at the start, force, state.
    const POINT: [f64; 10] = [1.4, 0.0, 0.3, 0.0, 0.0, 3.0, 0.4, 0.9, -1.2, 2.0];

    fn evaluator() -> (Evaluator, Scratch) {
        let evaluator = Evaluator::new(&example::crane());
        let scratch = evaluator.scratch();
        (evaluator, scratch)
    }

    fn results(point: &[f64]) -> [f64; 11] {
        let (evaluator, mut scratch) = evaluator();
        let mut results = [0.0; 11];
        evaluator.evaluate(point, &mut results, &mut scratch);
        results
    }

    #[test]
    fn results_are_those_of_the_crane() {
        let [l, .., force, x, theta, v, omega] = POINT;
        let (sine, cosine) = theta.sin_cos();
        let a = (force - 0.3 * v + l * omega * omega * sine + 9.81 * sine * cosine) / (3.0 - cosine * cosine);
        let alpha = -(a * cosine + 9.81 * sine) / l;
        let kinetic = 1.5 * v * v + l * cosine * v * omega + 0.5 * l * l * omega * omega;
        let load = [x + l * sine, v + l * cosine * omega, a + l * cosine * alpha - l * sine * omega * omega];
        let [load_x, load_v, load_a] = load;
        let expected = [x, theta, load_x, load_v, load_a, kinetic, -9.81 * l * cosine, v, omega, a, alpha];
        for (found, expected) in results(&POINT).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
    }

    #[test]
    fn derivatives_are_those_of_finite_differences() {
        let (evaluator, mut scratch) = evaluator();
        let direction = [0.3, 1.0, 1.0, 1.0, 1.0, -0.7, 0.2, 0.5, -0.4, 1.1];
        let change = [0.1, 0.0, 0.0, 0.0, 0.0, 0.4, -0.3, 0.2, 0.6, -0.8];
        let (mut first, mut second, mut along) = ([0.0; 11], [0.0; 11], [0.0; 11]);
        evaluator.directional(&POINT, &direction, &mut along, &mut scratch);
        evaluator.along_curve(&POINT, [&direction, &change], [&mut first, &mut second], &mut scratch);
        let at =
            |h: f64| results(&std::array::from_fn::<_, 10, _>(|k| POINT[k] + h * (direction[k] + 0.5 * h * change[k])));
        let h = 1e-3;
        let [before, after, far_before, far_after] = [-h, h, -2.0 * h, 2.0 * h].map(at);
        let now = results(&POINT);
        for k in 0..11 {
            let slope = (8.0 * (after[k] - before[k]) - far_after[k] + far_before[k]) / (12.0 * h);
            let curvature =
                (16.0 * (after[k] + before[k]) - far_after[k] - far_before[k] - 30.0 * now[k]) / (12.0 * h * h);
            assert!((first[k] - slope).abs() < 1e-8 && first[k] == along[k], "{k}: {} {slope}", first[k]);
            assert!((second[k] - curvature).abs() < 1e-5, "{k}: {} {curvature}", second[k]);
        }
        let weights: [f64; 11] = std::array::from_fn(|k| 0.3 + k as f64);
        let mut gradient = [0.0; 10];
        evaluator.adjoint(&POINT, &weights, &mut gradient, &mut scratch);
        let forwards: f64 = first.iter().zip(weights).map(|(first, weight)| first * weight).sum();
        let backwards: f64 = gradient.iter().zip(direction).map(|(gradient, along)| gradient * along).sum();
        assert!((forwards - backwards).abs() < 1e-11 * forwards.abs(), "{forwards} {backwards}");
    }

    /// States after `count` steps of one tenth of a second, with a force that changes linearly.
    fn after(count: usize, tolerance: Option<f64>, step: f64) -> [f64; 10] {
        let surrogate = example::crane();
        let Model::Motion(motion) = surrogate.model() else { panic!("the crane moves") };
        let motion = Motion { step, ..(**motion).clone() };
        let surrogate = Surrogate::new(surrogate.metadata().clone(), Model::Motion(Box::new(motion))).unwrap();
        let evaluator = Evaluator::new(&surrogate);
        let (mut scratch, mut point) = (evaluator.scratch(), POINT);
        let mut rates = [0.0; 10];
        rates[5] = -2.0;
        for _ in 0..count {
            let drive = Drive { rates: [&rates, &[0.0; 10]], clamp: None };
            evaluator.advance(&mut point, (0.1, tolerance, &[1.0; 4]), drive, &mut scratch).unwrap();
            point[5] += 0.1 * rates[5];
        }
        point
    }

    #[test]
    fn both_methods_agree_and_the_order_of_the_fixed_one_is_four() {
        let exact = after(20, None, 1e-4);
        let error = |point: [f64; 10]| point.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let ratio = error(after(20, None, 0.01)) / error(after(20, None, 0.005));
        assert!((14.0..18.0).contains(&ratio), "{ratio}");
        let errors = [1e-4, 1e-6, 1e-10].map(|tolerance| error(after(20, Some(tolerance), 0.01)));
        assert!(errors[0] < 1e-2 && errors[1] < 1e-4 && errors[2] < 1e-8, "{errors:?}");
        assert!(errors[0] > 1e-7, "the tolerance has an effect: {errors:?}");
    }

    #[test]
    fn a_step_that_fails_leaves_the_states_and_says_why() {
        let (evaluator, mut scratch) = evaluator();
        let mut point = POINT;
        let none = [0.0; 10];
        let drive = Drive { rates: [&none, &none], clamp: None };
        let error = evaluator.advance(&mut point, (1e9, None, &[1.0; 4]), drive, &mut scratch);
        assert_eq!((error, point), (Err(StepError::TooManySteps), POINT));
        // no rope, no mass matrix
        point[0] = 0.0;
        for tolerance in [None, Some(1e-6)] {
            let before = point;
            let error = evaluator.advance(&mut point, (0.1, tolerance, &[1.0; 4]), drive, &mut scratch);
            assert!(matches!(error, Err(StepError::NotFinite { .. })), "{error:?}");
            assert_eq!(point, before);
        }
    }

    #[test]
    fn inputs_are_clamped_at_every_stage() {
        let (evaluator, mut scratch) = evaluator();
        let surrogate = example::crane();
        let domain = Domain::new(surrogate.inputs(), surrogate.states());
        let none = [0.0; 10];
        let mut states = |force: f64, rate: f64| {
            let (mut point, mut rates) = (POINT, none);
            (point[5], rates[5]) = (force, rate);
            let drive = Drive { rates: [&rates, &none], clamp: Some(&domain) };
            evaluator.advance(&mut point, (0.1, None, &[1.0; 4]), drive, &mut scratch).unwrap();
            [point[8], point[9]]
        };
        assert_eq!(states(10.0, 500.0), states(10.0, 0.0));
        assert_ne!(states(9.0, 500.0), states(9.0, 0.0));
    }

    #[test]
    fn columns_out_of_order_are_refused() {
        let surrogate = example::crane();
        let mut metadata = surrogate.metadata().clone();
        metadata.inputs.swap(0, 5);
        let error = Surrogate::new(metadata, surrogate.model().clone()).unwrap_err().to_string();
        assert!(error.contains("`inputs` has shape"), "{error}");
        let mut metadata = surrogate.metadata().clone();
        metadata.states.pop();
        assert!(Surrogate::new(metadata, surrogate.model().clone()).is_err());
    }
}
