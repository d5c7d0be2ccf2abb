//! [Equations of motion](Dynamics) and their outputs.
//!
//! The columns are, in this order, with `n` coordinates
//!
//! | columns | |
//! |---|---|
//! | `p` | parameters |
//! | `u` | inputs |
//! | `n`, `n` | coordinates `q` and velocities `v` |
//! | `z` | actuator states: currents, pressures, integrals of a controller |
//!
//! and the results are the outputs and the derivatives `v`, `vd`, `zd`. To the equations, actuator states are further inputs, and
//! their rates are efforts that act on no coordinate: the last of both. A position is a function of the configuration,
//! `r(q, p) + w^T q` with whole numbers `w`, so that an angle may go around; its velocity and acceleration are exact derivatives.
//! Forces of joints and springs are [`Reactions`].

use super::{
    bends::BentArgument,
    dynamics::Dynamics,
    function_set::{FunctionSet, PreparedFunctions},
    reactions::Reactions,
    tape::{TapeWork, listing::Listing},
};
use crate::{
    FormatError,
    check::{expect_below, expect_finite, expect_shape},
    numbers::jet::{Jet, Number},
    task::Task,
};
use std::ops::Range;

/// Equations of motion, and outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// The equations.
    pub dynamics: Dynamics,
    /// `r`, from `(q, p)`.
    pub positions: FunctionSet,
    /// `w` of each position, shape `[positions, n]`.
    pub windings: Vec<f64>,
    /// Forces of joints and springs, if outputs show any.
    pub reactions: Option<Reactions>,
    /// Number of actuator states: the last inputs of the equations, whose rates are the last efforts.
    pub actuator_states: usize,
    /// Quantities that the outputs show.
    pub outputs: Vec<Shown>,
}

/// Quantity of the motion that an output shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// A position.
    Position(usize),
    /// The first derivative of a position with respect to time.
    Velocity(usize),
    /// The second derivative of a position with respect to time.
    Acceleration(usize),
    /// `v^T M v / 2`.
    KineticEnergy,
    /// The potential.
    PotentialEnergy,
    /// One of the [`Reactions`].
    Reaction(usize),
    /// Value of one of the [`Efforts`](super::efforts::Efforts).
    Effort(usize),
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub(crate) struct MotionScratch {
    plain: Parts<f64>,
    series: Parts<Jet>,
}

#[derive(Clone, Debug)]
struct Parts<T> {
    columns: Vec<T>,
    results: Vec<T>,
    equations: TapeWork<T>,
    /// Columns of the positions along the motion, the positions, and their working memory.
    along: Vec<Jet<T>>,
    positions: Vec<Jet<T>>,
    of_positions: TapeWork<Jet<T>>,
    reactions: Option<TapeWork<T>>,
}

impl Motion {
    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.velocities().end + self.actuator_states
    }

    /// Number of inputs that other components drive.
    pub fn driven(&self) -> usize {
        self.dynamics.inputs().saturating_sub(self.actuator_states)
    }

    fn inputs(&self) -> Range<usize> {
        let parameters = self.dynamics.parameters();
        parameters..parameters + self.driven()
    }

    fn coordinates(&self) -> Range<usize> {
        let first = self.inputs().end;
        first..first + self.dynamics.coordinates()
    }

    fn velocities(&self) -> Range<usize> {
        let first = self.coordinates().end;
        first..first + self.dynamics.coordinates()
    }

    /// Returns true if equations, positions or reactions depend on a coordinate or parameter, by its position among
    /// both. A column that none of them depends on may have any value.
    pub fn depends_on(&self, column: usize) -> bool {
        self.dynamics.depends_on(column)
            || self.positions.depends_on(column)
            || self.reactions.as_ref().is_some_and(|reactions| reactions.depends_on(column))
    }

    /// Returns true if equations or reactions depend on a coordinate, or positions by more than a straight line. Otherwise the coordinate may
    /// have any value, provided that the positions of the mechanism itself are straight along it: a line may be the best fit of a curve.
    pub fn is_limited_along(&self, coordinate: usize) -> bool {
        let functions = 0..self.positions.dictionary().outputs();
        self.dynamics.is_limited_along(coordinate)
            || functions.into_iter().any(|function| !self.positions.function_is_straight(function, coordinate))
            || self.reactions.as_ref().is_some_and(|reactions| reactions.depends_on(coordinate))
    }

    /// Returns true if any function has a network.
    pub fn has_networks(&self) -> bool {
        let networks = [self.dynamics.function_set().network(), self.dynamics.forces(), self.positions.network()];
        networks.into_iter().any(|network| network.is_some())
    }

    /// The positions as data, functions of `(q, p)`.
    pub fn listing_of_positions(&self) -> Listing {
        self.prepared_positions().listing()
    }

    fn prepared_positions(&self) -> PreparedFunctions {
        let (n, columns) = (self.dynamics.coordinates(), self.positions.dictionary().columns());
        self.positions.with_windings(0, n..columns, &self.windings)
    }

    /// Number of states: coordinates, velocities and actuator states.
    pub fn states(&self) -> usize {
        2 * self.dynamics.coordinates() + self.actuator_states
    }

    /// Returns true if an effort changes at once with an input that other components drive.
    pub fn effort_follows_inputs(&self, effort: usize) -> bool {
        (0..self.driven()).any(|input| self.dynamics.efforts().follows_input(effort, input))
    }

    /// Number of results: outputs and derivatives of the states.
    pub fn results(&self) -> usize {
        self.outputs.len() + self.states()
    }

    /// Makes sure that its parts fit each other.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(crate) fn check(&self) -> Result<(), FormatError> {
        let coordinates = self.dynamics.coordinates();
        let columns = coordinates + self.dynamics.parameters();
        let positions = self.positions.dictionary();
        let efforts = self.dynamics.efforts();
        expect_below(&"states.actuators", 0, self.actuator_states, efforts.inputs().min(efforts.count()) + 1)?;
        expect_shape("positions", &[positions.columns()], &[columns])?;
        expect_shape("windings", &[self.windings.len()], &[positions.outputs() * coordinates])?;
        expect_finite("windings", self.windings.iter().copied())?;
        if let Some(reactions) = &self.reactions {
            reactions.check([coordinates, self.dynamics.efforts().count(), columns])?;
        }
        for (index, shown) in self.outputs.iter().enumerate() {
            let (found, limit) = match *shown {
                Shown::Position(position) | Shown::Velocity(position) | Shown::Acceleration(position) => {
                    (position, positions.outputs())
                }
                Shown::Reaction(reaction) => (reaction, self.reactions.as_ref().map_or(0, Reactions::count)),
                Shown::Effort(effort) => (effort, efforts.count()),
                Shown::KineticEnergy | Shown::PotentialEnergy => continue,
            };
            expect_below(&"shown", index, found, limit)?;
        }
        Ok(())
    }
}

/// A [`Motion`] laid out for evaluation.
#[derive(Clone, Debug)]
pub(crate) struct PreparedMotion {
    motion: Motion,
    positions: PreparedFunctions,
    /// Columns `(q, p, v, u)` of the equations.
    inputs: Vec<usize>,
}

impl PreparedMotion {
    pub(crate) fn new(motion: Motion) -> Self {
        let (q, p) = (motion.coordinates(), 0..motion.dynamics.parameters());
        let actuators = motion.velocities().end..motion.columns();
        let inputs = q.chain(p).chain(motion.velocities()).chain(motion.inputs()).chain(actuators).collect();
        Self { positions: motion.prepared_positions(), inputs, motion }
    }

    pub(crate) fn scratch(&self) -> MotionScratch {
        MotionScratch { plain: self.parts(), series: self.parts() }
    }

    fn parts<T: Number>(&self) -> Parts<T> {
        let (zero, none) = (T::from(0.0), Jet::<T>::from(0.0));
        Parts {
            columns: vec![zero; self.motion.columns()],
            results: vec![zero; self.motion.results()],
            equations: self.motion.dynamics.work(),
            along: vec![none; self.motion.positions.dictionary().columns()],
            positions: vec![none; self.motion.positions.dictionary().outputs()],
            of_positions: self.positions.work(),
            reactions: self.motion.reactions.as_ref().map(Reactions::work),
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
            // by directions
            Task::Adjoint { .. } => {}
        }
    }

    /// The arguments of the efforts that have bends.
    pub(crate) fn arguments(&self) -> Vec<BentArgument> {
        self.motion.dynamics.arguments()
    }

    /// Derivatives of the states without the outputs, and the arguments with bends, at a point: the columns, and among them values that are
    /// left out. At each stage of a solver, where a copy of the columns would count.
    #[inline]
    pub(crate) fn rates(
        &self,
        point: &[f64],
        left_out: Range<usize>,
        (rates, arguments): (&mut [f64], &mut [f64]),
        scratch: &mut MotionScratch,
    ) {
        let equations = &mut scratch.plain.equations;
        self.motion.dynamics.solve(self.inputs.iter().map(|column| point[point_column(*column, &left_out)]), equations);
        let v = &point[point_column(self.motion.velocities().start, &left_out)..];
        self.motion.dynamics.write_rates(v, equations, self.motion.actuator_states, rates);
        self.motion.dynamics.write_arguments(equations, arguments);
    }

    /// The results at the columns.
    fn respond<T: Number>(&self, parts: &mut Parts<T>) {
        self.accelerate(&parts.columns, &mut parts.equations);
        let Parts { columns, results, equations, along, positions, of_positions, reactions } = parts;
        let n = self.motion.dynamics.coordinates();
        let (q, v) = (&columns[self.motion.coordinates()], &columns[self.motion.velocities()]);
        let (outputs, rates) = results.split_at_mut(self.motion.outputs.len());
        self.motion.dynamics.write_rates(v, equations, self.motion.actuator_states, rates);
        let a = &rates[n..2 * n];
        for (k, column) in along.iter_mut().enumerate() {
            *column = match k.checked_sub(n) {
                None => Jet { value: q[k], first: v[k], second: a[k] },
                Some(parameter) => Jet { value: columns[parameter], ..Jet::from(0.0) },
            };
        }
        if !positions.is_empty() {
            self.positions.compute(along, positions, &mut [], of_positions);
        }
        let mut reactions = self.motion.reactions.as_ref().zip(reactions.as_mut());
        if let Some((reactions, work)) = &mut reactions {
            let configuration = self.motion.dynamics.configuration(equations);
            reactions.compute([configuration, v, a], |index| self.motion.dynamics.effort(index, equations), work);
        }
        let mut shown = self.motion.outputs.iter();
        let has_energy = shown.any(|shown| matches!(shown, Shown::KineticEnergy | Shown::PotentialEnergy));
        let [kinetic, potential] = match has_energy {
            true => self.motion.dynamics.energies(|k| v[k], equations),
            false => [T::from(0.0); 2],
        };
        for (to, shown) in outputs.iter_mut().zip(&self.motion.outputs) {
            *to = match *shown {
                Shown::Position(position) => positions[position].value,
                Shown::Velocity(position) => positions[position].first,
                Shown::Acceleration(position) => positions[position].second,
                Shown::KineticEnergy => kinetic,
                Shown::PotentialEnergy => potential,
                Shown::Reaction(index) => match &reactions {
                    Some((reactions, work)) => reactions.value(index, work),
                    None => T::from(f64::NAN),
                },
                Shown::Effort(index) => self.motion.dynamics.effort(index, equations),
            };
        }
    }

    /// The accelerations at the columns.
    fn accelerate<T: Number>(&self, columns: &[T], equations: &mut TapeWork<T>) {
        let inputs = self.inputs.iter().map(|column| columns[*column]);
        self.motion.dynamics.solve(inputs, equations);
    }
}

/// Position of a column in a point, which has further values in the range `left_out`.
#[inline]
fn point_column(column: usize, left_out: &Range<usize>) -> usize {
    if column < left_out.start { column } else { column + left_out.len() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        CommunicationStep, Domain, Drive, Efforts, Evaluator, Graph, Integration, Program, StepError, Surrogate,
        equations::dynamics::Point,
        example,
        formula::{Combination, ElementaryFunction, Formula, FormulaStep},
    };

    /// Rope, state at the start, force, state.
    const POINT: [f64; 10] = [1.4, 0.0, 0.3, 0.0, 0.0, 3.0, 0.4, 0.9, -1.2, 2.0];

    fn evaluator() -> Evaluator {
        Evaluator::new(&example::crane())
    }

    fn results<const COUNT: usize>(evaluator: &mut Evaluator, point: &[f64]) -> [f64; COUNT] {
        let mut results = [0.0; COUNT];
        evaluator.evaluate(point, &mut results);
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
        for (found, expected) in results::<11>(&mut evaluator(), &POINT).iter().zip(expected) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
    }

    #[test]
    fn actuator_states_change_and_act_as_their_formulas_say() {
        let accurate = Integration::ErrorControlled { tolerance: 1e-11, longest: 0.01 };
        let surrogate = example::integrated(&example::crane_with_motor(), accurate);
        let mut evaluator = Evaluator::new(&surrogate);
        // rope, states at the start, voltage, states
        let point = [1.4, 0.0, 0.3, 0.0, 0.0, 0.0, 3.0, 0.4, 0.9, -1.2, 2.0, 0.75];
        let [l, .., voltage, _, theta, v, omega, current] = point;
        let (sine, cosine) = theta.sin_cos();
        let force = 4.0 * current;
        let a = (force - 0.3 * v + l * omega * omega * sine + 9.81 * sine * cosine) / (3.0 - cosine * cosine);
        let alpha = -(a * cosine + 9.81 * sine) / l;
        let rate = 5.0 * (voltage - 2.0 * current - 0.5 * v - 0.1 * sine);
        let found = results::<13>(&mut evaluator, &point);
        for (found, expected) in found[7..].iter().zip([voltage * current, v, omega, a, alpha, rate]) {
            assert!((found - expected).abs() < 1e-13, "{found} {expected}");
        }
        // derivatives are those of differences
        let direction = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.7, 0.3, -0.4, 0.9, 0.2, -0.6];
        let mut derivative = [0.0; 13];
        evaluator.directional(&point, &direction, &mut derivative);
        let at = |h: f64, evaluator: &mut Evaluator| {
            let moved: Vec<f64> = point.iter().zip(&direction).map(|(value, along)| value + h * along).collect();
            results::<13>(evaluator, &moved)
        };
        let [low, high] = [-1e-6, 1e-6].map(|h| at(h, &mut evaluator));
        for (found, (low, high)) in derivative.iter().zip(low.iter().zip(&high)) {
            assert!((found - (high - low) / 2e-6).abs() < 1e-7, "{found}");
        }
        // a step with a constant voltage, as the solution of many small ones by hand
        let mut stepped = point;
        let rates = vec![0.0; point.len()];
        let drive = Drive { rates: [&rates, &rates], clamp: None };
        evaluator.advance(&mut stepped, CommunicationStep::of(0.1), drive).expect("the step is possible");
        let mut expected = point;
        for _ in 0..10_000 {
            let half = results::<13>(&mut evaluator, &expected);
            let mut middle = expected;
            middle[7..].iter_mut().zip(&half[8..]).for_each(|(state, rate)| *state += 0.5e-5 * rate);
            let rates = results::<13>(&mut evaluator, &middle);
            expected[7..].iter_mut().zip(&rates[8..]).for_each(|(state, rate)| *state += 1e-5 * rate);
        }
        for (found, expected) in stepped.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-8, "{stepped:?} {expected:?}");
        }
    }

    #[test]
    fn efforts_act_as_their_formulas_say() {
        let [l, .., force, x, theta, v, omega] = POINT;
        let (sine, cosine) = theta.sin_cos();
        let load_rate = v + l * cosine * omega;
        let friction = force - 0.3 * (20.0 * v).tanh();
        let wind = -0.2 * load_rate * load_rate.abs() * l * cosine;
        let y = (x / 10.0).sin();
        let known = y.asin() + y.acos() - y.tan() + y.atan().exp() + l.ln() * l.sqrt();
        let motor = known + force / (force.powi(2) + 1.0) + l.powf(y) + force.min(2.0) + force.max(-2.5) + y.signum();
        let share = 0.6 * y + 0.3;
        let motor = motor + share * share * (3.0 - 2.0 * share) + (5.0 * y).floor() + (y + 1.5).atan2(-l);
        // the tables at v, at (l, omega) and at theta: the value at the end, and `CubicSpline` of scipy 1.17
        let motor = motor + 0.25 + 3.678733333333338 + 0.30352240352240356;
        let side = [friction + 0.5 * motor - 0.3 * v + l * omega * omega * sine, wind - 9.81 * l * sine];
        // M = [3, l cos; l cos, l²]
        let determinant = 3.0 * l * l - l * l * cosine * cosine;
        let a = (l * l * side[0] - l * cosine * side[1]) / determinant;
        let alpha = (3.0 * side[1] - l * cosine * side[0]) / determinant;
        let found = results::<11>(&mut Evaluator::new(&example::crane_with_efforts()), &POINT);
        assert!((found[9] - a).abs() < 1e-12 && (found[10] - alpha).abs() < 1e-12, "{found:?} {a} {alpha}");
        let surrogate = example::crane_with_efforts();
        let motion = surrogate.program().motion().expect("the crane moves");
        assert!(!motion.dynamics.is_conservative() && motion.dynamics.is_driven_by(0));
        assert!((0..3).all(|column| motion.dynamics.depends_on(column)));
    }

    #[test]
    fn reactions_are_those_of_newton_and_euler() {
        let surrogate = example::crane_with_reactions();
        let mut evaluator = Evaluator::new(&surrogate);
        // the second rope is another one than that of the evaluation before
        for rope in [1.4, 1.9] {
            let (mut results, mut point) = ([0.0; 13], POINT);
            point[0] = rope;
            evaluator.evaluate(&point, &mut results);
            let [l, .., force, x, theta, v, omega] = point;
            let (a, alpha, (sine, cosine)) = (results[11], results[12], theta.sin_cos());
            let rope = 9.81 + l * sine * alpha + l * cosine * omega * omega;
            let belt = 2.0 * a + 0.25 * l * sine * alpha - 0.5 * l * sine * v * v
                + l * cosine * (1.5 * v * omega + 0.75 * omega * omega)
                - 0.3 * v
                + x * (2.0 * theta).sin() * (0.125 * omega + 0.5)
                + 0.25 * l * l * force;
            for (found, expected) in [(results[7], rope), (results[8], belt)] {
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
        // of jets, too
        let (mut along, mut direction) = ([0.0; 13], [0.0; 10]);
        direction[5] = 1.0;
        evaluator.directional(&POINT, &direction, &mut along);
        let expected = 1.4 * 0.9f64.sin() * along[12];
        assert!((along[7] - expected).abs() < 1e-14, "{} {expected}", along[7]);
    }

    #[test]
    fn derivatives_are_those_of_finite_differences_with_and_without_networks() {
        for surrogate in [example::crane(), example::crane_with_networks(), example::crane_with_efforts()] {
            check_derivatives::<11>(&mut Evaluator::new(&surrogate));
        }
        check_derivatives::<13>(&mut Evaluator::new(&example::crane_with_reactions()));
        for surrogate in [example::crane(), example::crane_with_networks()] {
            check_derivatives::<11>(&mut Evaluator::new(&example::with_prescribed_trolley(&surrogate)));
        }
    }

    #[test]
    fn the_load_of_a_trolley_with_a_prescribed_acceleration_is_a_pendulum_whose_pivot_moves() {
        let surrogate = example::with_prescribed_trolley(&example::crane());
        let [l, .., input, _, theta, v, omega] = POINT;
        let a = input - 0.3 * v;
        let alpha = -(9.81 * theta.sin() + a * theta.cos()) / l;
        let found = results::<11>(&mut Evaluator::new(&surrogate), &POINT);
        assert_eq!(found[7..10], [v, omega, a]);
        assert!((found[10] - alpha).abs() < 1e-13, "{} {alpha}", found[10]);
        // energies are those of both bodies
        let kinetic = 1.5 * v * v + l * theta.cos() * v * omega + 0.5 * l * l * omega * omega;
        assert!((found[5] - kinetic).abs() < 1e-13, "{} {kinetic}", found[5]);
        let motion = surrogate.program().motion().expect("the crane moves");
        assert!(!motion.dynamics.is_conservative() && motion.dynamics.is_driven_by(0));
    }

    fn check_derivatives<const COUNT: usize>(evaluator: &mut Evaluator) {
        let direction = [0.3, 1.0, 1.0, 1.0, 1.0, -0.7, 0.2, 0.5, -0.4, 1.1];
        let change = [0.1, 0.0, 0.0, 0.0, 0.0, 0.4, -0.3, 0.2, 0.6, -0.8];
        let (mut first, mut second, mut along) = ([0.0; COUNT], [0.0; COUNT], [0.0; COUNT]);
        evaluator.directional(&POINT, &direction, &mut along);
        evaluator.along_curve(&POINT, [&direction, &change], [&mut first, &mut second]);
        let at = |h: f64| {
            results::<COUNT>(
                evaluator,
                &std::array::from_fn::<_, 10, _>(|k| POINT[k] + h * (direction[k] + 0.5 * h * change[k])),
            )
        };
        let h = 1e-3;
        let [before, after, far_before, far_after] = [-h, h, -2.0 * h, 2.0 * h].map(at);
        let now = results::<COUNT>(evaluator, &POINT);
        for k in 0..COUNT {
            let slope = (8.0 * (after[k] - before[k]) - far_after[k] + far_before[k]) / (12.0 * h);
            let curvature =
                (16.0 * (after[k] + before[k]) - far_after[k] - far_before[k] - 30.0 * now[k]) / (12.0 * h * h);
            assert!((first[k] - slope).abs() < 1e-8 && first[k] == along[k], "{k}: {} {slope}", first[k]);
            assert!((second[k] - curvature).abs() < 1e-5, "{k}: {} {curvature}", second[k]);
        }
        let weights: [f64; COUNT] = std::array::from_fn(|k| 0.3 + k as f64);
        let mut gradient = [0.0; 10];
        evaluator.adjoint(&POINT, &weights, &mut gradient);
        let forwards: f64 = first.iter().zip(weights).map(|(first, weight)| first * weight).sum();
        let backwards: f64 = gradient.iter().zip(direction).map(|(gradient, along)| gradient * along).sum();
        assert!((forwards - backwards).abs() < 1e-11 * forwards.abs(), "{forwards} {backwards}");
    }

    #[test]
    fn networks_add_to_the_equations_as_their_functions_say() {
        let (with, without) = (example::crane_with_networks(), example::crane());
        let motion = |surrogate: &Surrogate| surrogate.program().motion().expect("the crane moves").clone();
        let (with, without) = (motion(&with).dynamics, motion(&without).dynamics);
        let [l, _, _, _, _, force, x, theta, v, omega] = POINT;
        let term = Graph::from(with.function_set().network().unwrap().network());
        // M and dV/dq, D, B by differences of what the network gives
        let of_law = |x: f64, theta: f64| term.evaluate([[theta.sin(), theta.cos(), x, l]])[0].to_vec();
        let exact = |theta: f64| [3.0, l * theta.cos(), l * l, -9.81 * l * theta.cos()];
        let functions = |x: f64, theta: f64| -> [f64; 4] {
            let more = of_law(x, theta);
            std::array::from_fn(|k| exact(theta)[k] + more[k])
        };
        let h = 1e-5;
        let by = |f: [[f64; 4]; 2]| -> [f64; 4] { std::array::from_fn(|k| (f[1][k] - f[0][k]) / (2.0 * h)) };
        let by_x = by([-h, h].map(|h| functions(x + h, theta)));
        let by_theta = by([-h, h].map(|h| functions(x, theta + h)));
        let [mxx, mxt, mtt, _] = functions(x, theta);
        let more = of_law(x, theta);
        let forces =
            Graph::from(with.forces().unwrap().network()).evaluate([[x, theta.cos(), l, v, omega, force]])[0].to_vec();
        // h_i = sum over j, k of (dM_ij/dq_k - dM_jk/dq_i / 2) v_j v_k
        let rate = |k: usize| by_x[k] * v + by_theta[k] * omega;
        let half = |by: [f64; 4]| 0.5 * (by[0] * v * v + 2.0 * by[1] * v * omega + by[2] * omega * omega);
        let side = [
            -(rate(0) * v + rate(1) * omega - half(by_x)) - by_x[3] - (0.3 + more[4]) * v
                + (1.0 + more[5]) * force
                + forces[1],
            -(rate(1) * v + rate(2) * omega - half(by_theta)) - by_theta[3] + forces[0],
        ];
        let determinant = mxx * mtt - mxt * mxt;
        let expected = [(mtt * side[0] - mxt * side[1]) / determinant, (mxx * side[1] - mxt * side[0]) / determinant];
        let point = Point { q: &[x, theta], v: &[v, omega], u: &[force], p: &[l] };
        let (mut found, mut before) = ([0.0; 2], [0.0; 2]);
        with.accelerations(point, &mut found, &mut with.scratch());
        without.accelerations(point, &mut before, &mut without.scratch());
        for k in 0..2 {
            assert!((found[k] - expected[k]).abs() < 1e-8, "{k}: {} {}", found[k], expected[k]);
            assert!((found[k] - before[k]).abs() > 1e-3, "{k}: the networks have no effect");
        }
        assert!(with.is_driven_by(0) && with.depends_on(0) && !without.depends_on(0));
    }

    /// States after `count` steps of one tenth of a second, with a force that changes linearly.
    fn after(count: usize, integration: Integration) -> [f64; 10] {
        let mut evaluator = Evaluator::new(&example::integrated(&example::crane(), integration));
        let (mut point, mut rates) = (POINT, [0.0; 10]);
        rates[5] = -2.0;
        for _ in 0..count {
            let drive = Drive { rates: [&rates, &[0.0; 10]], clamp: None };
            evaluator.advance(&mut point, CommunicationStep::of(0.1), drive).unwrap();
            point[5] += 0.1 * rates[5];
        }
        point
    }

    #[test]
    fn both_methods_agree_and_the_order_of_the_fixed_one_is_four() {
        let fixed = |step: f64| after(20, Integration::Fixed { step });
        let controlled = |tolerance: f64| after(20, Integration::ErrorControlled { tolerance, longest: 1.0 });
        let exact = fixed(1e-4);
        let error = |point: [f64; 10]| point.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let ratio = error(fixed(0.01)) / error(fixed(0.005));
        assert!((14.0..18.0).contains(&ratio), "{ratio}");
        let errors = [1e-4, 1e-6, 1e-10].map(|tolerance| error(controlled(tolerance)));
        assert!(errors[0] < 1e-2 && errors[1] < 1e-4 && errors[2] < 1e-8, "{errors:?}");
        assert!(errors[0] > 1e-7, "the tolerance has an effect: {errors:?}");
    }

    #[test]
    fn a_step_that_fails_leaves_the_states_and_says_why() {
        let mut evaluator = evaluator();
        let mut point = POINT;
        let none = [0.0; 10];
        let drive = Drive { rates: [&none, &none], clamp: None };
        let error = evaluator.advance(&mut point, CommunicationStep::of(1e9), drive);
        assert_eq!((error, point), (Err(StepError::TooManySteps), POINT));
        for (most_steps, is_enough) in [(1, false), (1000, true)] {
            let step = CommunicationStep { most_steps, ..CommunicationStep::of(0.1) };
            let mut point = POINT;
            let result = evaluator.advance(&mut point, step, drive);
            assert_eq!((result.is_ok(), point != POINT), (is_enough, is_enough), "{result:?}");
        }
        let fixed = Integration::Fixed { step: 0.005 };
        for integration in [fixed, Integration::ErrorControlled { tolerance: 1e-6, longest: 0.005 }] {
            let mut evaluator = evaluator.with_integration(integration);
            let mut advance = |mut point: [f64; 10]| {
                let before = point;
                let error = evaluator.advance(&mut point, CommunicationStep::of(0.1), drive);
                assert_eq!(point, before);
                error
            };
            // no rope, no mass matrix
            let mut point = POINT;
            point[0] = 0.0;
            let error = advance(point);
            assert!(matches!(error, Err(StepError::NotFinite { .. })), "{error:?}");
            // a trolley that is a thousand times farther than in its range
            let limit = example::crane().states()[0].limit();
            let mut point = POINT;
            point[6] = limit - 0.1;
            point[8] = 2.0;
            let error = advance(point);
            let is_far =
                |state: usize, value: f64, after: f64| state == 0 && value > limit && after > 0.0 && after <= 0.1;
            assert!(
                matches!(error, Err(StepError::Implausible { state, value, after }) if is_far(state, value, after)),
                "{error:?}"
            );
        }
    }

    #[test]
    fn an_input_that_goes_to_the_end_of_its_range_does_not_pass_it_by_rounding() {
        // the square root of the distance from the upper end
        let surrogate = example::crane();
        let motion = surrogate.program().motion().expect("the crane moves");
        let steps = [
            FormulaStep::Constant(10.0),
            FormulaStep::Column(1),
            FormulaStep::Combine(Combination::Subtract),
            FormulaStep::Call(ElementaryFunction::Sqrt),
        ];
        let formulas = vec![Formula::new(steps.to_vec()).unwrap()];
        let efforts = Efforts::new([1, 1, 2], Vec::new(), formulas).unwrap();
        let dynamics = Dynamics::with_efforts(efforts, motion.dynamics.function_set().clone()).unwrap();
        let program =
            Program::of_motion(Motion { dynamics, ..motion.clone() }, surrogate.program().integration().unwrap());
        let surrogate = Surrogate::new(surrogate.metadata().clone(), program).unwrap();
        let mut evaluator = Evaluator::new(&surrogate);
        let none = [0.0; 10];
        for number in 0..1000 {
            let (mut point, mut rates) = (POINT, none);
            point[5] = 9.0 + 0.9 * (f64::from(number) * 0.618_033_988_749_894_9).fract();
            rates[5] = (10.0 - point[5]) / 0.02;
            let drive = Drive { rates: [&rates, &none], clamp: None };
            evaluator.advance(&mut point, CommunicationStep::of(0.02), drive).unwrap();
        }
        // and beyond it the formula has no value
        let (mut point, mut rates) = (POINT, none);
        rates[5] = 400.0;
        let drive = Drive { rates: [&rates, &none], clamp: None };
        assert!(evaluator.advance(&mut point, CommunicationStep::of(0.02), drive).is_err());
    }

    #[test]
    fn inputs_are_clamped_at_every_stage() {
        let mut evaluator = evaluator();
        let surrogate = example::crane();
        let domain = Domain::new(surrogate.inputs(), surrogate.states());
        let none = [0.0; 10];
        let mut states = |force: f64, rate: f64| {
            let (mut point, mut rates) = (POINT, none);
            (point[5], rates[5]) = (force, rate);
            let drive = Drive { rates: [&rates, &none], clamp: Some(&domain) };
            evaluator.advance(&mut point, CommunicationStep::of(0.1), drive).unwrap();
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
        let error = Surrogate::new(metadata, surrogate.program().clone()).unwrap_err().to_string();
        assert!(error.contains("in this order"), "{error}");
        let mut metadata = surrogate.metadata().clone();
        metadata.states.pop();
        assert!(Surrogate::new(metadata, surrogate.program().clone()).is_err());
    }
}
