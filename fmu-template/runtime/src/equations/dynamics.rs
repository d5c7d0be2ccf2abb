//! Equations of motion in generalized coordinates `q`, with learned functions of the configuration.
//!
//! ```text
//! qd = v
//! M(q, p) vd + h = -dV/dq + F(q, p) - D(q, p) v + B(q, p) e
//! h_i = sum over j, k of (dM_ij/dq_k - dM_jk/dq_i / 2) v_j v_k
//! ```
//!
//! The [efforts](Efforts) `e` are the inputs `u`, or formulas of them and of the motion, as friction is. `h` has the
//! exact derivatives of `M`, so that without `F`, `D` and `e` the energy `v^T M v / 2 + V` is conserved whatever the
//! functions are. No velocity enters a learned function, so none is ever extrapolated, unless a network of `(q, p, v,
//! u)` adds to the right-hand side.
//!
//! A force `F_k(p)` that no coordinate changes is uniform and has the potential `-F_k q_k`: the weight of a load on a drum, of whose
//! angle `V` alone is periodic.
//!
//! Drivers may prescribe accelerations, of the coordinates `d`; the others, `f`, follow:
//!
//! ```text
//! vd_d = F_d - D_d v + B_d e
//! M_ff vd_f + h_f = -dV/dq_f + F_f - D_f v + B_f e - M_fd vd_d
//! ```
//!
//! A uniform `F_d` belongs to the potential, and does not act.

use super::{
    bends::BentArgument,
    efforts::Efforts,
    function_set::{FunctionSet, NetworkTerm, WrittenNetwork},
    switches,
    tape::{Register, Tape, TapeBuilder, TapeWork, listing::Listing},
};
use crate::{
    FormatError,
    check::{expect_below, expect_shape},
    numbers::jet::{Jet, Number},
};
use std::{ops::Range, sync::Arc};

/// The equations of motion with `n` coordinates and `m` inputs.
#[derive(Clone, Debug, PartialEq)]
pub struct Dynamics {
    coordinates: usize,
    efforts: Efforts,
    /// From `(q, p)` to the lower triangle of `M` row by row, `V`, the positions in the efforts, `F`, `D` row by row and `B` row by row.
    function_set: FunctionSet,
    /// From `(q, p, v, u)` to further forces.
    forces: Option<NetworkTerm>,
    /// `true` for each coordinate whose acceleration is prescribed.
    prescribed: Vec<bool>,
    /// `true` if any acceleration is prescribed.
    is_driven: bool,
    written: Written,
}

/// The equations on a tape, whose inputs are `(q, p, v, u)`.
#[derive(Clone, Debug, Default, PartialEq)]
struct Written {
    tape: Tape,
    /// The lower triangle of `M` row by row, and `V` with the potentials of uniform forces.
    energies: Vec<Register>,
    efforts: Vec<Register>,
    accelerations: Vec<Register>,
}

/// Working memory of one evaluation at a time.
#[derive(Clone, Debug)]
pub struct DynamicsScratch {
    plain: TapeWork<f64>,
    series: TapeWork<Jet>,
    /// `(q, p, v, u)` with their derivatives.
    columns: Vec<Jet>,
}

/// A state with parameters and inputs.
#[derive(Clone, Copy, Debug)]
pub struct Point<'a> {
    /// Generalized coordinates.
    pub q: &'a [f64],
    /// Their rates.
    pub v: &'a [f64],
    /// Inputs.
    pub u: &'a [f64],
    /// Parameters.
    pub p: &'a [f64],
}

impl Dynamics {
    /// Number of functions of the function set for given numbers of coordinates and efforts, without the positions in formulas.
    pub fn functions(coordinates: usize, efforts: usize) -> usize {
        let n = coordinates;
        n * (n + 1) / 2 + 1 + n + n * n + n * efforts
    }

    /// The equations from a function set of `(q, p)`, whose efforts are the inputs; see the module for the order of what it gives.
    ///
    /// # Errors
    /// [`FormatError`] if the function set has another number of outputs, or fewer columns than coordinates.
    pub fn new(coordinates: usize, inputs: usize, function_set: impl Into<FunctionSet>) -> Result<Self, FormatError> {
        let function_set: FunctionSet = function_set.into();
        let parameters = function_set.dictionary().columns().saturating_sub(coordinates);
        Self::with_efforts(Efforts::of_inputs([parameters, inputs, coordinates]), function_set)
    }

    /// The equations from a function set of `(q, p)`; see the module for the order of what it gives.
    ///
    /// # Errors
    /// [`FormatError`] if the function set has another number of outputs or columns than the efforts need, or there are no coordinates.
    pub fn with_efforts(efforts: Efforts, function_set: impl Into<FunctionSet>) -> Result<Self, FormatError> {
        let function_set: FunctionSet = function_set.into();
        let [parameters, _, coordinates] = efforts.counts();
        let dictionary = function_set.dictionary();
        let functions = Self::functions(coordinates, efforts.count()) + efforts.positions();
        expect_shape("functions", &[dictionary.outputs()], &[functions])?;
        if dictionary.columns() != coordinates + parameters || coordinates == 0 {
            return Err(FormatError::Shape {
                name: "functions".into(),
                found: vec![dictionary.columns()],
                expected: vec![(coordinates + parameters).max(1)],
            });
        }
        let dynamics = Self {
            coordinates,
            efforts,
            function_set,
            forces: None,
            prescribed: vec![false; coordinates],
            is_driven: false,
            written: Written::default(),
        };
        Ok(dynamics.write())
    }

    /// Writes the equations as they are now.
    fn write(mut self) -> Self {
        let (n, m, p) = (self.coordinates, self.inputs(), self.parameters());
        let (e, r) = (self.efforts.count(), self.efforts.positions());
        let mut tape = TapeBuilder::new(self.force_columns(), n..n + p);
        let input = |range: Range<usize>| -> Vec<Register> { range.map(Register::input).collect() };
        let (q, v) = (input(0..n), input(n + p..2 * n + p));
        let [parameters, u] = [input(n..n + p), input(2 * n + p..2 * n + p + m)];
        let (zero, one) = (tape.zero, tape.one);
        let function_set = self.function_set.dictionary().write(&input(0..n + p), &mut tape);
        let differentiated = self.differentiated();
        let network =
            self.function_set.network().map(|network| network.write(&input(0..n + p), n, differentiated, &mut tape));
        let columns = input(0..self.force_columns());
        let forces = self.forces.as_ref().map(|network| network.write(&columns, 0, 0, &mut tape));
        let added = |network: &Option<WrittenNetwork>, to, index, column, tape: &mut TapeBuilder| match network {
            Some(network) => network.added(to, index, column, tape),
            None => to,
        };
        let function = |index: usize, tape: &mut TapeBuilder| {
            let value = function_set.value(index, tape);
            added(&network, value, index, None, tape)
        };
        let slope = |index: usize, k: usize, tape: &mut TapeBuilder| {
            let value = function_set.slope(index, k, tape);
            added(&network, value, index, Some(k), tape)
        };
        let potential = n * (n + 1) / 2;
        let force = potential + 1 + r;
        let (damping, effort_map) = (force + n, force + n + n * n);
        let mut energies: Vec<Register> = (0..=potential).map(|index| function(index, &mut tape)).collect();
        for k in (0..n).filter(|k| self.is_uniform(*k)) {
            let uniform = function(force + k, &mut tape);
            energies[potential] = tape.subtract_product(energies[potential], uniform, q[k]);
        }
        let slopes: Vec<Register> = (0..potential * n).map(|index| slope(index / n, index % n, &mut tape)).collect();
        // positions and their rates
        let mut motion = [Vec::new(), Vec::new()];
        for (index, windings) in self.efforts.windings().chunks(n).enumerate() {
            let (mut value, mut rate) = (function(potential + 1 + index, &mut tape), zero);
            for (k, winding) in windings.iter().enumerate() {
                value = tape.add_scaled(value, q[k], *winding);
                let slope = slope(potential + 1 + index, k, &mut tape);
                let winding = tape.constant(*winding);
                let slope = tape.add_product(winding, slope, one);
                rate = tape.add_product(rate, slope, v[k]);
            }
            motion[0].push(value);
            motion[1].push(rate);
        }
        let of_formulas = [parameters, u, motion.concat()].concat();
        let mut efforts = Vec::with_capacity(e);
        for formula in self.efforts.formulas() {
            efforts.push(formula.write(&of_formulas, &mut tape));
            let group = tape.new_group();
            let varies = |column: usize| tape.varies(of_formulas[column]);
            for argument in switches::bent_arguments(formula, &varies) {
                let of = argument.formula.write(&of_formulas, &mut tape);
                tape.add_bends(of, &Arc::new(argument.bends), group);
            }
        }
        let mut sides = Vec::with_capacity(n);
        for i in 0..n {
            let has_force = !(self.prescribed[i] && self.is_uniform(i));
            let mut side = if has_force { function(force + i, &mut tape) } else { zero };
            side = added(&forces, side, i, None, &mut tape);
            for (j, v) in v.iter().enumerate() {
                let damping = function(damping + i * n + j, &mut tape);
                side = tape.subtract_product(side, damping, *v);
            }
            for (j, effort) in efforts.iter().enumerate() {
                let factor = function(effort_map + i * e + j, &mut tape);
                side = tape.add_product(side, factor, *effort);
            }
            // inertia and potential do not act on what is prescribed
            if !self.prescribed[i] {
                side = function_set.add_slope(side, potential, i, -1.0, &mut tape);
                let of_network = added(&network, zero, potential, Some(i), &mut tape);
                side = tape.add_scaled(side, of_network, -1.0);
                for (j, k) in (0..n).flat_map(|j| (0..=j).map(move |k| (j, k))) {
                    let mut terms = of_velocities([i, j, k], |a, b, c| slopes[entry(a, b) * n + c]);
                    terms.retain(|(of, weight)| !tape.is_zero(*of) && *weight != 0.0);
                    let (factor, weight) = match terms[..] {
                        [] => continue,
                        [term] => term,
                        _ => (tape.weighted(&terms), 1.0),
                    };
                    let weighted_v = tape.add_scaled(zero, v[j], -weight);
                    let velocities = tape.product(weighted_v, v[k]);
                    side = tape.add_product(side, factor, velocities);
                }
            }
            sides.push(side);
        }
        let (prescribed, free): (Vec<usize>, Vec<usize>) = (0..n).partition(|&i| self.prescribed[i]);
        for &i in &free {
            for &j in &prescribed {
                sides[i] = tape.subtract_product(sides[i], energies[entry(i, j)], sides[j]);
            }
        }
        let mass = |i: usize, j: usize| energies[entry(free[i], free[j])];
        let mut found: Vec<Register> = free.iter().map(|&i| sides[i]).collect();
        solve(&mut tape, free.len(), mass, &mut found);
        for (&i, found) in free.iter().zip(found) {
            sides[i] = found;
        }
        let tape = tape.finish_for(&[efforts.as_slice(), &sides].concat());
        self.written = Written { energies, efforts, accelerations: sides, tape };
        self
    }

    /// The equations as data: inputs are `(q, p, v, u)`, results the accelerations, the efforts, the lower triangle of `M` row by row and `V`.
    pub fn listing(&self) -> Listing {
        let Written { tape, energies, efforts, accelerations } = &self.written;
        tape.listing([accelerations, efforts, energies].into_iter().flatten().copied())
    }

    /// Number of functions whose derivatives enter the equations: the first ones of the function set.
    fn differentiated(&self) -> usize {
        self.coordinates * (self.coordinates + 1) / 2 + 1 + self.efforts.positions()
    }

    /// Prescribes the accelerations of some coordinates.
    ///
    /// # Errors
    /// [`FormatError`] if there is no such coordinate.
    pub fn with_prescribed(mut self, coordinates: &[usize]) -> Result<Self, FormatError> {
        for (index, &found) in coordinates.iter().enumerate() {
            expect_below(&"prescribed", index, found, self.coordinates)?;
            self.prescribed[found] = true;
        }
        self.is_driven = self.prescribed.contains(&true);
        Ok(if coordinates.is_empty() { self } else { self.write() })
    }

    /// Sets the network of `(q, p, v, u)` that adds forces, if there is one.
    ///
    /// # Errors
    /// [`FormatError`] if it has other columns, or more forces than there are coordinates.
    pub fn with_forces(self, forces: Option<NetworkTerm>) -> Result<Self, FormatError> {
        if let Some(forces) = &forces {
            forces.check_limits(self.force_columns(), self.coordinates)?;
        }
        let changes = forces != self.forces;
        let dynamics = Self { forces, ..self };
        Ok(if changes { dynamics.write() } else { dynamics })
    }

    /// Number of generalized coordinates: half the number of states.
    pub fn coordinates(&self) -> usize {
        self.coordinates
    }

    /// Number of inputs.
    pub fn inputs(&self) -> usize {
        self.efforts.inputs()
    }

    /// Efforts of the equations.
    pub fn efforts(&self) -> &Efforts {
        &self.efforts
    }

    /// Number of parameters.
    pub fn parameters(&self) -> usize {
        self.function_set.dictionary().columns() - self.coordinates
    }

    /// The functions of the configuration.
    pub fn function_set(&self) -> &FunctionSet {
        &self.function_set
    }

    /// Network of further forces, if there is one.
    pub fn forces(&self) -> Option<&NetworkTerm> {
        self.forces.as_ref()
    }

    /// Mask of the coordinates whose accelerations are prescribed.
    pub fn prescribed(&self) -> &[bool] {
        &self.prescribed
    }

    /// Returns true if a function or an effort depends on a coordinate or parameter, by its position among both.
    pub fn depends_on(&self, column: usize) -> bool {
        self.function_set.depends_on(column)
            || self.efforts.depends_on(column)
            || self.forces.as_ref().is_some_and(|forces| forces.depends_on(column))
    }

    /// Returns true if equations are known in a range of a coordinate only: functions or efforts depend on it. A position whose rate alone enters
    /// efforts may be a straight line along it.
    pub fn is_limited_along(&self, coordinate: usize) -> bool {
        let first = self.coordinates * (self.coordinates + 1) / 2 + 1;
        let is_limited = |function: usize| match function.checked_sub(first) {
            Some(position) if position < self.efforts.positions() && !self.efforts.has_position(position) => {
                !self.function_set.function_is_straight(function, coordinate)
            }
            _ => self.function_set.function_depends_on(function, coordinate),
        };
        (0..self.function_set.dictionary().outputs()).any(is_limited)
            || self.efforts.depends_on(coordinate)
            || self.forces.as_ref().is_some_and(|forces| forces.depends_on(coordinate))
    }

    /// Returns true if a force `F_k` other than zero acts on a coordinate, and no coordinate changes it.
    pub fn is_uniform(&self, coordinate: usize) -> bool {
        let force = self.differentiated() + coordinate;
        let depends = |column: usize| self.function_set.function_depends_on(force, column);
        !self.function_set.is_zero(force) && !(0..self.coordinates).any(depends)
    }

    /// Returns true if a velocity enters the network of forces, which may extrapolate it: elsewhere velocities enter
    /// exactly.
    pub fn extrapolates(&self, coordinate: usize) -> bool {
        let velocity = self.coordinates + self.parameters() + coordinate;
        self.forces.as_ref().is_some_and(|forces| forces.depends_on(velocity))
    }

    /// Returns true if an input has an effect.
    pub fn is_driven_by(&self, input: usize) -> bool {
        let (n, e) = (self.coordinates, self.efforts.count());
        let first = self.function_set.dictionary().outputs() - n * e;
        let column = 2 * n + self.parameters() + input;
        let acts = |effort: usize| (0..n).any(|row| !self.function_set.is_zero(first + row * e + effort));
        (0..e).any(|effort| self.efforts.follows_input(effort, input) && acts(effort))
            || self.forces.as_ref().is_some_and(|forces| forces.depends_on(column))
    }

    /// Returns true if only the inputs change the energy.
    pub fn is_conservative(&self) -> bool {
        let (n, first) = (self.coordinates, self.differentiated());
        let mut damping = first + n..first + n + n * n;
        let has_potential = |k: usize| self.is_uniform(k) || self.function_set.is_zero(first + k);
        let is_free = self.forces.is_none() && !self.is_driven && self.efforts.are_inputs();
        is_free && (0..n).all(has_potential) && damping.all(|function| self.function_set.is_zero(function))
    }

    /// Number of columns `(q, p, v, u)`.
    fn force_columns(&self) -> usize {
        2 * self.coordinates + self.parameters() + self.inputs()
    }

    /// Working memory that fits.
    pub fn scratch(&self) -> DynamicsScratch {
        let columns = vec![Jet::from(0.0); self.force_columns()];
        DynamicsScratch { plain: self.work(), series: self.work(), columns }
    }

    pub(super) fn work<T: Number>(&self) -> TapeWork<T> {
        self.written.tape.work()
    }

    /// `vd`, shape `[n]`. NaN where the mass matrix is not positive definite. Does not allocate.
    ///
    /// # Panics
    /// If a slice has the wrong length or the scratch belongs to other equations.
    pub fn accelerations(&self, point: Point, accelerations: &mut [f64], scratch: &mut DynamicsScratch) {
        self.check(point, accelerations);
        self.solve(Self::columns(point), &mut scratch.plain);
        accelerations.iter_mut().zip(self.found(&scratch.plain)).for_each(|(to, found)| *to = found);
    }

    /// The efforts `e` at a state.
    ///
    /// # Panics
    /// As [`Dynamics::accelerations`].
    pub fn efforts_at(&self, point: Point, scratch: &mut DynamicsScratch) -> Vec<f64> {
        self.accelerations(point, &mut vec![0.0; self.coordinates], scratch);
        (0..self.efforts.count()).map(|index| self.effort(index, &scratch.plain)).collect()
    }

    /// Directional derivative of `vd` along `direction`, exact but for rounding. Does not allocate.
    ///
    /// # Panics
    /// As [`Dynamics::accelerations`].
    pub fn directional(&self, point: Point, direction: Point, derivative: &mut [f64], scratch: &mut DynamicsScratch) {
        self.check(point, derivative);
        self.check(direction, derivative);
        let DynamicsScratch { series, columns, .. } = scratch;
        let [values, rates] = [point, direction].map(Self::columns);
        for (to, (value, first)) in columns.iter_mut().zip(values.zip(rates)) {
            *to = Jet { value, first, second: 0.0 };
        }
        self.solve(columns.iter().copied(), series);
        derivative.iter_mut().zip(self.found(series)).for_each(|(to, found)| *to = found.first);
    }

    /// `v^T M v / 2 + V` with the potentials of uniform forces, in J. Does not allocate.
    ///
    /// # Panics
    /// As [`Dynamics::accelerations`].
    pub fn energy(&self, point: Point, scratch: &mut DynamicsScratch) -> f64 {
        self.solve(Self::columns(point), &mut scratch.plain);
        let [kinetic, potential] = self.energies(|k| point.v[k], &mut scratch.plain);
        kinetic + potential
    }

    /// The arguments of the efforts that have bends.
    pub(super) fn arguments(&self) -> Vec<BentArgument> {
        self.written.tape.arguments()
    }

    /// These arguments, once the equations were solved.
    pub(super) fn write_arguments(&self, work: &TapeWork<f64>, to: &mut [f64]) {
        self.written.tape.write_arguments(work, to);
    }

    /// `(q, p)` with which the equations were solved.
    pub(super) fn configuration<'a, T: Number>(&self, work: &'a TapeWork<T>) -> &'a [T] {
        &work.inputs()[..self.coordinates + self.parameters()]
    }

    /// An effort, once the equations were solved.
    pub(super) fn effort<T: Number>(&self, index: usize, work: &TapeWork<T>) -> T {
        work.get(self.written.efforts[index])
    }

    /// `v^T M v / 2`, and `V` with the potentials of uniform forces, once the equations were solved.
    pub(super) fn energies<T: Number>(&self, v: impl Fn(usize) -> T, work: &mut TapeWork<T>) -> [T; 2] {
        let n = self.coordinates;
        self.written.tape.run_rest(work);
        let function = |index: usize| work.get(self.written.energies[index]);
        let mut kinetic = T::from(0.0);
        for i in 0..n {
            for j in 0..n {
                kinetic = kinetic + v(i) * function(entry(i, j)) * v(j);
            }
        }
        [kinetic.scaled(0.5), function(n * (n + 1) / 2)]
    }

    /// One step of the classical Runge-Kutta method of order 4 over `h` seconds with constant inputs: `q` and `v` are replaced.
    /// `stages` is working memory of `8 n` numbers. Does not allocate.
    ///
    /// # Panics
    /// As [`Dynamics::accelerations`], or if `stages` is too short.
    pub fn runge_kutta_step(
        &self,
        (q, v): (&mut [f64], &mut [f64]),
        (u, p): (&[f64], &[f64]),
        h: f64,
        stages: &mut [f64],
        scratch: &mut DynamicsScratch,
    ) {
        let n = self.coordinates;
        // at the stage, its acceleration, and the weighted sums of rates and accelerations
        let (at_q, rest) = stages.split_at_mut(n);
        let (at_v, rest) = rest.split_at_mut(n);
        let (acceleration, rest) = rest.split_at_mut(n);
        let (sum_v, rest) = rest.split_at_mut(n);
        let sum_a = &mut rest[..n];
        sum_v.fill(0.0);
        sum_a.fill(0.0);
        at_q.copy_from_slice(q);
        at_v.copy_from_slice(v);
        for (weight, next) in [(1.0 / 6.0, 0.5), (1.0 / 3.0, 0.5), (1.0 / 3.0, 1.0), (1.0 / 6.0, 0.0)] {
            self.accelerations(Point { q: at_q, v: at_v, u, p }, acceleration, scratch);
            for k in 0..n {
                sum_v[k] += weight * at_v[k];
                sum_a[k] += weight * acceleration[k];
                at_q[k] = q[k] + next * h * at_v[k];
                at_v[k] = v[k] + next * h * acceleration[k];
            }
        }
        for k in 0..n {
            q[k] += h * sum_v[k];
            v[k] += h * sum_a[k];
        }
    }

    fn check(&self, Point { q, v, u, p }: Point, accelerations: &[f64]) {
        assert_eq!([q.len(), v.len(), accelerations.len()], [self.coordinates; 3], "number of coordinates");
        assert_eq!([u.len(), p.len()], [self.inputs(), self.parameters()], "number of inputs and parameters");
    }

    /// `(q, p, v, u)`
    fn columns(Point { q, v, u, p }: Point<'_>) -> impl Iterator<Item = f64> {
        q.iter().chain(p).chain(v).chain(u).copied()
    }

    /// Solves the equations at `(q, p, v, u)`.
    pub(super) fn solve<T: Number>(&self, columns: impl Iterator<Item = T>, work: &mut TapeWork<T>) {
        // the end of a step is where outputs are wanted and the next step begins
        if work.set_inputs(columns) {
            self.written.tape.run(work);
        }
    }

    /// `vd = M^-1 (-h - dV/dq + F - D v + B e)`, once the equations were solved.
    fn found<T: Number>(&self, work: &TapeWork<T>) -> impl Iterator<Item = T> {
        self.written.accelerations.iter().map(|register| work.get(*register))
    }

    /// Writes `(v, vd)` and the last efforts, once the equations were solved.
    pub(super) fn write_rates<T: Number>(&self, v: &[T], work: &TapeWork<T>, last_efforts: usize, to: &mut [T]) {
        let Written { accelerations, efforts, .. } = &self.written;
        let efforts = efforts.iter().skip(efforts.len().saturating_sub(last_efforts));
        let found = accelerations.iter().chain(efforts).map(|register| work.get(*register));
        let rates = v.iter().copied().take(self.coordinates).chain(found);
        to.iter_mut().zip(rates).for_each(|(to, rate)| *to = rate);
    }
}

/// Position of `M_ij` in the lower triangle.
fn entry(i: usize, j: usize) -> usize {
    let (row, column) = (i.max(j), i.min(j));
    row * (row + 1) / 2 + column
}

/// Slopes of `M` and their weights whose sum is the factor of `v_j v_k` in `h_i`, from the slope of `M_ab` along `c`. Each slope occurs once.
fn of_velocities([i, j, k]: [usize; 3], slope: impl Fn(usize, usize, usize) -> Register) -> Vec<(Register, f64)> {
    let mut terms: Vec<(Register, f64)> = Vec::with_capacity(4);
    // both orders of a pair
    for (j, k) in [(j, k), (k, j)].into_iter().take(if j == k { 1 } else { 2 }) {
        for (of, weight) in [(slope(i, j, k), 1.0), (slope(j, k, i), -0.5)] {
            match terms.iter_mut().find(|(known, _)| *known == of) {
                Some((_, sum)) => *sum += weight,
                None => terms.push((of, weight)),
            }
        }
    }
    terms
}

/// Writes `x` in place of `b` with `M x = b`, by the factors `M = L D L^T`; NaN where a pivot is not positive.
fn solve(tape: &mut TapeBuilder, n: usize, mass: impl Fn(usize, usize) -> Register, x: &mut [Register]) {
    let zero = tape.zero;
    // -L below the diagonal, L D above, 1 / D on it
    let mut factors = vec![zero; n * n];
    for i in 0..n {
        for j in 0..=i {
            let mut value = mass(i, j);
            for k in 0..j {
                value = tape.add_product(value, factors[i * n + k], factors[k * n + j]);
            }
            if j < i {
                factors[j * n + i] = value;
                let minus = tape.negative(factors[j * n + j]);
                factors[i * n + j] = tape.product(value, minus);
            } else {
                factors[i * n + i] = tape.reciprocal(value);
            }
        }
    }
    for i in 0..n {
        for j in 0..i {
            x[i] = tape.add_product(x[i], factors[i * n + j], x[j]);
        }
    }
    for i in (0..n).rev() {
        x[i] = tape.product(x[i], factors[i * n + i]);
        for j in i + 1..n {
            x[i] = tape.add_product(x[i], factors[j * n + i], x[j]);
        }
    }
}

#[cfg(test)]
mod tests;
