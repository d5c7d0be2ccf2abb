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
    function_set::{FunctionSet, NetworkTerm},
    tape::{Register, Tape, TapeWork, listing::Listing},
};
use crate::{
    FormatError,
    check::{expect_below, expect_shape},
    numbers::jet::{Jet, Number},
};
use writer::EquationWriter;

mod writer;

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
        self.written = EquationWriter::new(&self).write();
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
        let is_limited =
            (0..self.function_set.dictionary().outputs()).any(|function| match function.checked_sub(first) {
                Some(position) if position < self.efforts.positions() && !self.efforts.has_position(position) => {
                    !self.function_set.function_is_straight(function, coordinate)
                }
                _ => self.function_set.function_depends_on(function, coordinate),
            });
        is_limited
            || self.efforts.depends_on(coordinate)
            || self.forces.as_ref().is_some_and(|forces| forces.depends_on(coordinate))
    }

    /// Returns true if a force `F_k` other than zero acts on a coordinate, and no coordinate changes it.
    pub fn is_uniform(&self, coordinate: usize) -> bool {
        let force = self.differentiated() + coordinate;
        !self.function_set.is_zero(force)
            && !(0..self.coordinates).any(|column| self.function_set.function_depends_on(force, column))
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
        let mut efforts = (0..e).filter(|effort| self.efforts.follows_input(*effort, input));
        efforts.any(|effort| (0..n).any(|row| !self.function_set.is_zero(first + row * e + effort)))
            || self.forces.as_ref().is_some_and(|forces| forces.depends_on(column))
    }

    /// Returns true if only the inputs change the energy.
    pub fn is_conservative(&self) -> bool {
        let (n, first) = (self.coordinates, self.differentiated());
        let mut damping = first + n..first + n + n * n;
        let is_free = self.forces.is_none() && !self.is_driven && self.efforts.are_inputs();
        is_free
            && (0..n).all(|k| self.is_uniform(k) || self.function_set.is_zero(first + k))
            && damping.all(|function| self.function_set.is_zero(function))
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
        let energies = &self.written.energies;
        let mut kinetic = T::from(0.0);
        for i in 0..n {
            for j in 0..n {
                kinetic = kinetic + v(i) * work.get(energies[entry(i, j)]) * v(j);
            }
        }
        [kinetic.scaled(0.5), work.get(energies[n * (n + 1) / 2])]
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

#[cfg(test)]
mod tests;
