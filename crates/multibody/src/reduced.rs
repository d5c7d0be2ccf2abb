//! Equations of motion in independent coordinates, which components with states integrate and surrogates learn.
//!
//! A mechanism without prescribed motion and without time in its forces has `n` degrees of freedom. With `n` coordinates `s(q)`
//! that are independent of the constraints, `J = [C_q; s_q]` is square, and all velocities follow from those of `s`:
//!
//! ```text
//! qd = T sd,   J T = [0; 1]
//! M(s) sdd + h(s, sd) = Q(s, sd, u)
//! M = T^T M_q T,   h_i = sum over j, k of (dM_ij/ds_k - dM_jk/ds_i / 2) sd_j sd_k,   Q = T^T F_a
//! dT/ds_k = -J^-1 (dJ/ds_k) T
//! ```
//!
//! Generalized forces have three parts: the potential, the springs' damping, and efforts `e`, each along its own coordinate:
//!
//! ```text
//! Q = -dV/ds - D(s) sd + B(s) e(s, sd, u)
//! ```
//!
//! Everything but the velocities and the efforts is a function of the configuration. The derivatives of `M` are exact (Wehage, Haug 1982
//! for the partition of coordinates; Shabana: *Computational Dynamics*, chapter 5, for the quadratic velocity terms).
//!
//! A driver may give the acceleration of one of these coordinates. Its row then is `sdd_d = a(s, sd, u)`, and the other
//! rows are unchanged. Nothing is singular, even if the driven coordinate has no mass:
//!
//! ```text
//! M_ff sdd_f = Q_f - h_f - M_fd a
//! ```
//!
//! Multipliers follow from accelerations without the inverse of `M`: with the forces `mu` along the independent coordinates that
//! accelerations other than those of the equations would need,
//!
//! ```text
//! J^T [lambda; mu] = F_a(s, sd, u) - M_q (T sdd + sum over j, k of dT_j/ds_k sd_j sd_k)
//! ```
//!
//! which are zero but for driven coordinates: there `-mu` is the driver's effort.

use super::{
    constraint::{Constraint, Slot, Target, independence},
    coordinate::{BodyPoint, Coordinate},
    error::{MotionCause, MotionError},
    model::{MultibodyModel, Prescribed, Sample, Spring},
};
use nalgebra::{DMatrix, DVector, Dyn, LU};
use std::cell::RefCell;

/// Largest change of a coordinate, in rad or m, in one step from a known configuration to another.
const STEP: f64 = 0.1;

/// Steps to a configuration at most.
const MOST_STEPS: f64 = 1e5;

/// Part of a coordinate's gradient outside the span of the constraints and the coordinates before it that makes it a good choice.
const INDEPENDENT: f64 = 0.05;

/// Part of the determinant of `J` at the start below which a configuration is not used: beyond the singularity lies another
/// assembly.
const UNUSABLE: f64 = 1e-3;

/// A mechanism with numbers in it and its independent coordinates.
#[derive(Clone, Debug)]
pub struct Reduced {
    model: MultibodyModel,
    coordinates: Vec<Coordinate>,
    /// The coordinate of each prescribed acceleration.
    driven: Vec<usize>,
    start: Configuration,
    start_rates: DVector<f64>,
    /// Determinant of `J` at the start.
    determinant: f64,
    /// The latest configuration, from which the search for the next one begins if it is closer than the start.
    last: RefCell<Configuration>,
}

/// Independent coordinates and all coordinates that belong to them.
#[derive(Clone, Debug)]
struct Configuration {
    s: DVector<f64>,
    q: DVector<f64>,
}

/// The functions of the configuration in the equations of motion.
#[derive(Clone, Debug)]
pub struct Terms {
    /// All coordinates of the bodies.
    pub q: DVector<f64>,
    /// `T`, shape `[3 bodies, n]`.
    pub velocities: DMatrix<f64>,
    /// `dT/ds_k` for each `k`.
    pub velocity_gradient: Vec<DMatrix<f64>>,
    /// `M`, shape `[n, n]`, in kg, kg.m or kg.m².
    pub mass: DMatrix<f64>,
    /// `dM/ds_k` for each `k`.
    pub mass_gradient: Vec<DMatrix<f64>>,
    /// `-dV/ds`, the forces of gravity and springs at rest: shape `[n]`, in N or N.m.
    pub potential_force: DVector<f64>,
    /// `D`, the springs' damping; zero in the row of a driven coordinate: shape `[n, n]`.
    pub damping: DMatrix<f64>,
    /// `B`: forces of a unit of each effort, then of each prescribed acceleration, then zero for each further known
    /// expression: shape `[n, efforts]`.
    pub effort_map: DMatrix<f64>,
    /// Potential energy of gravity and springs, in J.
    pub potential: f64,
}

impl Terms {
    /// `h`, the forces of inertia that are quadratic in the velocities.
    pub fn quadratic_forces(&self, rates: &DVector<f64>) -> DVector<f64> {
        let along = self
            .mass_gradient
            .iter()
            .zip(rates)
            .fold(DMatrix::zeros(rates.len(), rates.len()), |sum: DMatrix<f64>, (gradient, rate)| {
                sum + gradient * *rate
            });
        let mut forces = along * rates;
        for (force, gradient) in forces.iter_mut().zip(&self.mass_gradient) {
            *force -= 0.5 * rates.dot(&(gradient * rates));
        }
        forces
    }

    /// Accelerations of all coordinates of the bodies, from those of the independent ones.
    pub fn all_accelerations(&self, rates: &DVector<f64>, accelerations: &DVector<f64>) -> DVector<f64> {
        let mut sum = &self.velocities * accelerations;
        for (gradient, rate) in self.velocity_gradient.iter().zip(rates) {
            sum += gradient * rates * *rate;
        }
        sum
    }
}

impl Reduced {
    /// The equations in these independent coordinates, or in the first `n` of them that are independent at the start if there are
    /// more.
    ///
    /// # Errors
    /// An error if a motion is prescribed, a force or prescribed acceleration depends on time, or the mechanism
    /// cannot be assembled. Also if there are fewer independent coordinates than degrees of freedom, or the
    /// acceleration of another coordinate is prescribed.
    pub fn new(model: MultibodyModel, candidates: &[Coordinate]) -> Result<Self, MotionError> {
        refuse_time(&model)?;
        let (q, v) = model.initial_state(0.0)?;
        let coordinates = choose(&model, &q, candidates)?;
        let driven = driven(&model, &coordinates)?;
        let s = DVector::from_iterator(coordinates.len(), coordinates.iter().map(|coordinate| coordinate.value(&q)));
        let rates = coordinates.iter().map(|coordinate| coordinate.rate(&q, &v));
        let start_rates = DVector::from_iterator(coordinates.len(), rates);
        let determinant = jacobian(&model, &coordinates, &q).determinant();
        let start = Configuration { s, q };
        let last = RefCell::new(start.clone());
        Ok(Self { model, coordinates, driven, last, start, start_rates, determinant })
    }

    /// The mechanism.
    pub fn model(&self) -> &MultibodyModel {
        &self.model
    }

    /// The independent coordinates.
    pub fn coordinates(&self) -> &[Coordinate] {
        &self.coordinates
    }

    /// Which of them a driver accelerates, in the order of the drivers.
    pub fn driven(&self) -> &[usize] {
        &self.driven
    }

    /// The independent coordinates and their rates at the start.
    pub fn start(&self) -> (&DVector<f64>, &DVector<f64>) {
        (&self.start.s, &self.start_rates)
    }

    /// All coordinates of the bodies for independent coordinates `s`, on the assembly of the start. They are followed
    /// along the straight line in `s` from the closer of two configurations, the start or the latest one.
    ///
    /// # Errors
    /// An error that names the constraint that is singular on the way.
    pub fn configuration(&self, s: &DVector<f64>) -> Result<DVector<f64>, MotionError> {
        let last = self.last.borrow();
        let from = if (&last.s - s).amax() < (&self.start.s - s).amax() { &*last } else { &self.start };
        let distance = s - &from.s;
        let steps = (distance.amax() / STEP).ceil().max(1.0);
        if steps > MOST_STEPS {
            let message =
                format!("the independent coordinates are more than {} rad or m from the start", MOST_STEPS * STEP);
            return Err(MotionError::new(MotionCause::Unsuitable, message));
        }
        let mut q = from.q.clone();
        for step in 1..=steps as u32 {
            let target = &from.s + &distance * (f64::from(step) / steps);
            let factors = self.factorise(&q)?;
            let mut side = DVector::zeros(q.len());
            side.rows_mut(q.len() - s.len(), s.len()).copy_from(&(&distance / steps));
            let before = q.clone();
            q += factors.solve(&side).ok_or_else(|| self.singular(&q))?;
            q = self.correct(q, &target)?;
            self.refuse_turned_springs(&before, &q)?;
        }
        drop(last);
        self.last.replace(Configuration { s: s.clone(), q: q.clone() });
        Ok(q)
    }

    /// Makes sure that no spring has lost its direction between two configurations that are close: one whose force is not zero where its
    /// length is.
    fn refuse_turned_springs(&self, before: &DVector<f64>, after: &DVector<f64>) -> Result<(), MotionError> {
        let springs = self.model.springs.iter();
        let directed = springs.filter(|spring| spring.rest != 0.0 || spring.damping != 0.0 || spring.further.is_some());
        for Spring { coordinate, owner, .. } in directed {
            let [from, to] = [before, after].map(|q| coordinate.direction(q));
            if Option::zip(from, to).is_some_and(|(from, to)| from.dot(&to) <= 0.0) {
                let message = format!("`{owner}` has no length on the way: its direction is lost there");
                return Err(MotionError::of(owner, MotionCause::Undefined, message));
            }
        }
        Ok(())
    }

    /// The functions of the configuration.
    ///
    /// # Errors
    /// As [`Reduced::configuration`].
    pub fn terms(&self, s: &DVector<f64>) -> Result<Terms, MotionError> {
        let q = self.configuration(s)?;
        let (count, n) = (q.len(), s.len());
        let factors = self.factorise(&q)?;
        let mut unit = DMatrix::zeros(count, n);
        unit.view_mut((count - n, 0), (n, n)).fill_with_identity();
        let velocities = factors.solve(&unit).ok_or_else(|| self.singular(&q))?;
        let weighted = self.weighted(&velocities);
        let mass = velocities.tr_mul(&weighted);
        let (mut velocity_gradient, mut mass_gradient) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for k in 0..n {
            let side = -self.second_derivatives(&q, &velocities, k);
            let of_velocities = factors.solve(&side).ok_or_else(|| self.singular(&q))?;
            let half = of_velocities.tr_mul(&weighted);
            mass_gradient.push(&half + half.transpose());
            velocity_gradient.push(of_velocities);
        }
        let potential = self.model.potential_energy(&q);
        let potential_force = velocities.tr_mul(&self.model.potential_forces(&q));
        let mut damping = -velocities.tr_mul(&self.model.damping_forces(&q, &velocities));
        let efforts = velocities.tr_mul(&self.model.effort_gradients(&q));
        let first = efforts.ncols();
        let mut effort_map = efforts.resize_horizontally(self.model.known_expressions().count(), 0.0);
        for (driver, &k) in self.driven.iter().enumerate() {
            damping.row_mut(k).fill(0.0);
            effort_map.row_mut(k).fill(0.0);
            effort_map[(k, first + driver)] = 1.0;
        }
        Ok(Terms {
            q,
            velocities,
            velocity_gradient,
            mass,
            mass_gradient,
            potential_force,
            damping,
            effort_map,
            potential,
        })
    }

    /// Generalized forces `Q` of the independent coordinates in a state with inputs `u`, and accelerations of driven ones.
    pub fn force(&self, terms: &Terms, rates: &DVector<f64>, u: &[f64]) -> DVector<f64> {
        self.forces_or_accelerations(&terms.q, &terms.velocities, rates, u)
    }

    fn forces_or_accelerations(
        &self,
        q: &DVector<f64>,
        velocities: &DMatrix<f64>,
        rates: &DVector<f64>,
        u: &[f64],
    ) -> DVector<f64> {
        let v = velocities * rates;
        let mut forces = velocities.tr_mul(&self.model.applied_forces(0.0, q, &v, u));
        for (driver, &k) in self.model.prescribed.iter().zip(&self.driven) {
            forces[k] = driver.expression.value(0.0, q, &v, u);
        }
        forces
    }

    /// Forces on all coordinates of the bodies in a state with inputs `u`.
    pub fn applied_forces(&self, terms: &Terms, rates: &DVector<f64>, u: &[f64]) -> DVector<f64> {
        self.model.applied_forces(0.0, &terms.q, &(&terms.velocities * rates), u)
    }

    /// Forces of inertia, `-M_q qdd`, of a unit of each `sdd`, and of each product `sd_j sd_k` with `k <= j`, the lower triangle row by
    /// row: shape `[3 bodies, n + n (n + 1) / 2]`.
    pub fn inertia_forces(&self, terms: &Terms) -> DMatrix<f64> {
        let n = terms.velocities.ncols();
        let mut columns: Vec<DVector<f64>> = terms.velocities.column_iter().map(|column| column.into_owned()).collect();
        for j in 0..n {
            for k in 0..=j {
                let column = terms.velocity_gradient[k].column(j).into_owned();
                // both orders of two different coordinates
                columns.push(if j == k { column } else { 2.0 * column });
            }
        }
        -self.weighted(&DMatrix::from_columns(&columns))
    }

    /// The multipliers of the constraints, and then the forces along the independent coordinates, that balance forces on all coordinates of
    /// the bodies: `J^T [lambda; mu] = forces`, column by column.
    ///
    /// # Errors
    /// An error that names the constraint that is singular there.
    pub fn balance(&self, terms: &Terms, forces: &DMatrix<f64>) -> Result<DMatrix<f64>, MotionError> {
        let factors = jacobian(&self.model, &self.coordinates, &terms.q).transpose().lu();
        factors.solve(forces).ok_or_else(|| self.singular(&terms.q))
    }

    /// Multipliers of one column, in the order of a [sample](super::model::Sample): constraints, then drivers.
    pub fn multipliers(&self, balance: nalgebra::DVectorView<f64>) -> DVector<f64> {
        let constraints = self.model.constraints.len();
        let of_drivers = self.driven.iter().map(|k| balance[constraints + k]);
        DVector::from_iterator(
            constraints + self.driven.len(),
            balance.iter().take(constraints).copied().chain(of_drivers),
        )
    }

    /// `sdd` in a state with inputs `u`.
    ///
    /// # Errors
    /// The mass matrix is singular there.
    pub fn accelerations(&self, terms: &Terms, rates: &DVector<f64>, u: &[f64]) -> Result<DVector<f64>, MotionError> {
        let (mut side, inertia) = (self.force(terms, rates, u), terms.quadratic_forces(rates));
        let mut mass = terms.mass.clone();
        for row in (0..side.len()).filter(|row| !self.driven.contains(row)) {
            let by_drivers: f64 = self.driven.iter().map(|&k| terms.mass[(row, k)] * side[k]).sum();
            side[row] -= inertia[row] + by_drivers;
        }
        for &k in &self.driven {
            mass.row_mut(k).fill(0.0);
            mass.column_mut(k).fill(0.0);
            mass[(k, k)] = 1.0;
        }
        let solved = mass.cholesky().map(|factors| factors.solve(&side));
        let solved = solved.filter(|accelerations| accelerations.iter().all(|value| value.is_finite()));
        let message = "the mass matrix of the independent coordinates is not positive definite";
        solved.ok_or_else(|| MotionError::new(MotionCause::Unsolved, message))
    }

    /// Everything about a state with inputs `u` and accelerations `sdd`.
    ///
    /// # Errors
    /// As [`balance`](Self::balance).
    pub fn sample(
        &self,
        terms: &Terms,
        rates: &DVector<f64>,
        sdd: &DVector<f64>,
        u: &[f64],
    ) -> Result<Sample, MotionError> {
        let (v, qdd) = (&terms.velocities * rates, terms.all_accelerations(rates, sdd));
        let unbalanced = self.model.applied_forces(0.0, &terms.q, &v, u) - self.model.mass.component_mul(&qdd);
        let balanced = self.balance(terms, &DMatrix::from_columns(&[unbalanced]))?;
        let multipliers = self.multipliers(balanced.column(0));
        Ok(Sample { t: 0.0, q: terms.q.clone(), v, u: u.to_vec(), qdd, multipliers })
    }

    /// Rows of the equations that are of one kind: all forces, then each prescribed acceleration.
    pub fn alike(&self) -> Vec<Vec<usize>> {
        let forces = (0..self.coordinates.len()).filter(|row| !self.driven.contains(row)).collect();
        std::iter::once(forces).chain(self.driven.iter().map(|k| vec![*k])).collect()
    }

    /// `M_q` times a matrix.
    fn weighted(&self, matrix: &DMatrix<f64>) -> DMatrix<f64> {
        let mut weighted = matrix.clone();
        weighted.column_iter_mut().for_each(|mut column| column.component_mul_assign(&self.model.mass));
        weighted
    }

    /// `(dJ/ds_k) T`: of each row's coordinate the second derivatives along `T_k` and every column of `T`, from the curvature,
    /// which is a quadratic form, by polarization.
    fn second_derivatives(&self, q: &DVector<f64>, velocities: &DMatrix<f64>, k: usize) -> DMatrix<f64> {
        let direction = velocities.column(k);
        DMatrix::from_fn(q.len(), velocities.ncols(), |row, column| {
            let other = velocities.column(column);
            let (sum, difference) = (direction + other, direction - other);
            0.25 * (self.curvature(row, q, &sum) - self.curvature(row, q, &difference))
        })
    }

    /// Curvature of a constraint, or of an independent coordinate after them, along velocities.
    fn curvature(&self, row: usize, q: &DVector<f64>, along: &DVector<f64>) -> f64 {
        let constraints = &self.model.constraints;
        match constraints.get(row) {
            Some(constraint) => constraint.curvature(q, along),
            None => self.coordinates[row - constraints.len()].curvature(q, along),
        }
    }

    fn factorise(&self, q: &DVector<f64>) -> Result<LU<f64, Dyn, Dyn>, MotionError> {
        let factors = jacobian(&self.model, &self.coordinates, q).lu();
        if factors.determinant() / self.determinant > UNUSABLE { Ok(factors) } else { Err(self.singular(q)) }
    }

    /// Newton's method on the constraints and the independent coordinates.
    fn correct(&self, mut q: DVector<f64>, target: &DVector<f64>) -> Result<DVector<f64>, MotionError> {
        for _ in 0..30 {
            let mut residual = self.model.constraints.residual(0.0, &q).as_slice().to_vec();
            residual.extend(self.coordinates.iter().zip(target).map(|(one, target)| one.value(&q) - target));
            let step = self.factorise(&q)?.solve(&DVector::from_vec(residual)).ok_or_else(|| self.singular(&q))?;
            q -= &step;
            // the error left is about the square of the step: below rounding
            if step.amax() <= 1e-8 * (1.0 + q.amax()) {
                return Ok(q);
            }
        }
        Err(self.singular(&q))
    }

    fn singular(&self, q: &DVector<f64>) -> MotionError {
        let s: Vec<String> = self.coordinates.iter().map(|coordinate| format!("{:.4}", coordinate.value(q))).collect();
        let s = s.join(", ");
        match self.model.constraints.first_dependent(&self.model.constraints.gradients(q)) {
            Some(Constraint { owner, .. }) => {
                let message = format!("`{owner}` is singular at independent coordinates ({s})");
                MotionError::of(owner, MotionCause::Singular, message)
            }
            None => {
                let message = format!("the independent coordinates do not decide the others at ({s})");
                MotionError::new(MotionCause::Singular, message)
            }
        }
    }
}

/// `J = [C_q; s_q]`.
fn jacobian(model: &MultibodyModel, coordinates: &[Coordinate], q: &DVector<f64>) -> DMatrix<f64> {
    let constraints = model.constraints.len();
    let mut transposed = DMatrix::zeros(q.len(), constraints + coordinates.len());
    transposed.columns_mut(0, constraints).copy_from(&model.constraints.gradients(q).dense());
    for (index, coordinate) in coordinates.iter().enumerate() {
        coordinate.add_gradient(q, 1.0, transposed.column_mut(constraints + index).as_mut_slice());
    }
    transposed.transpose()
}

/// The first candidates that are independent of the constraints and of each other at the start, one for each degree of
/// freedom. Lengths are relative to the mechanism's size, so that the choice does not depend on the unit.
fn choose(model: &MultibodyModel, q: &DVector<f64>, candidates: &[Coordinate]) -> Result<Vec<Coordinate>, MotionError> {
    let count = model.degrees_of_freedom();
    if count == 0 {
        return Err(MotionError::new(MotionCause::Unsuitable, "the mechanism has no degree of freedom"));
    }
    let gradients = model.constraints.gradients(q);
    let (lever_arm, mut gradients) = (model.constraints.lever_arm(&gradients), gradients.dense());
    let mut scales = DVector::from_fn(q.len(), |row, _| if row % 3 == 2 { lever_arm } else { 1.0 });
    // a coordinate that a gear multiplies is as good as the one that follows it
    let gears = model.constraints.iter().zip(gradients.column_iter());
    for (_, gradient) in gears.filter(|(constraint, _)| matches!(constraint.target, Target::Follows(_))) {
        scales.zip_apply(&gradient, |scale, slope| *scale = scale.max(slope.abs()));
    }
    gradients.column_iter_mut().for_each(|mut column| column.component_div_assign(&scales));
    let mut chosen = Vec::new();
    for candidate in candidates {
        let mut gradient = DVector::zeros(q.len());
        candidate.add_gradient(q, 1.0, gradient.as_mut_slice());
        gradient.component_div_assign(&scales);
        let with = DMatrix::from_columns(&[gradients.column_iter().collect(), vec![gradient.column(0)]].concat());
        if chosen.len() < count && independence(&with).last().is_some_and(|part| *part > INDEPENDENT) {
            gradients = with;
            chosen.push(*candidate);
        }
    }
    if chosen.len() < count {
        let (found, tried) = (chosen.len(), candidates.len());
        let message = format!(
            "only {found} of {tried} coordinates are independent, expected {count}: as many as there are degrees of freedom"
        );
        return Err(MotionError::new(MotionCause::Unsuitable, message));
    }
    Ok(chosen)
}

/// The independent coordinates that drivers accelerate.
fn driven(model: &MultibodyModel, coordinates: &[Coordinate]) -> Result<Vec<usize>, MotionError> {
    let places = model.prescribed.iter().map(|driver| {
        let position = coordinates.iter().position(|coordinate| *coordinate == driver.coordinate);
        let Prescribed { name, owner, .. } = driver;
        position.ok_or_else(|| {
            let message = format!("`{owner}` gives the acceleration of `{name}`, expected that among the coordinates");
            MotionError::of(owner, MotionCause::Unsuitable, message)
        })
    });
    places.collect()
}

/// Independent coordinates that are tried if none are named: those that drivers accelerate, those that the joints leave free, then those
/// of the bodies.
pub fn candidates(model: &MultibodyModel, free: impl IntoIterator<Item = Coordinate>) -> Vec<Coordinate> {
    let of_bodies = (0..model.mass.len() / 3).flat_map(|body| {
        let centre = BodyPoint { frame: Some(body), ..BodyPoint::ORIGIN };
        [
            Coordinate::component(centre, 0),
            Coordinate::component(centre, 1),
            Coordinate::Angle { from: None, to: Some(body) },
        ]
    });
    let driven = model.prescribed.iter().map(|driver| driver.coordinate);
    driven.chain(free).chain(of_bodies).collect()
}

/// Refuses what depends on time: it would be another state.
fn refuse_time(model: &MultibodyModel) -> Result<(), MotionError> {
    for constraint in model.constraints.iter() {
        if let Target::Motion(formula) = &constraint.target {
            let (owner, motion) = (&constraint.owner, &formula.text);
            let message = format!("`{owner}` prescribes the motion `{motion}`, expected an `acceleration`");
            return Err(MotionError::of(owner, MotionCause::Unsuitable, message));
        }
    }
    for (bound, owner) in model.acting_expressions() {
        if bound.slots.iter().any(|slot| matches!(slot, Slot::Time)) {
            let what = match owner.split('.').next() {
                Some("drivers") => "acceleration",
                Some("states") => "rate",
                _ => "force",
            };
            let message = format!("the {what} `{}` of `{owner}` depends on time", bound.text);
            return Err(MotionError::of(owner, MotionCause::Unsuitable, message));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests;
