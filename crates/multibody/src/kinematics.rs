//! Runs whose drivers leave nothing free: `C(q, t) = 0` with a square `C_q`, solved position by position.
//!
//! The positions are followed in steps that do not depend on the rows: a parabola through the last position
//! predicts the next one, Newton's method corrects it. A step counts only if it stays on the way the mechanism moves:
//! - the first correction is small: angles on the scale of a radian, lengths on that of the lever arms;
//! - the next one is much smaller (Newton-Kantorovich; Deuflhard, *Newton Methods for Nonlinear Problems*, section 5.1);
//! - the determinant of each loop keeps its sign. The two ways to close a loop that meet in a singular position have
//!   opposite signs; two loops that change sides together leave the sign of the whole determinant as it was.
//!
//! Otherwise it is retried with half the length. Rows lie within steps: a polynomial of degree 5 through both ends
//! predicts them, and they count under the same conditions.

use super::{
    constraint::{Constraints, independence},
    error::{MotionCause, MotionError},
    model::{MultibodyModel, Sample},
};
use crate::integrate::Budget;
use nalgebra::{DMatrix, DVector, Dyn, LU};

/// Largest first correction of a step, in radians and lever arms; steps aim at half of it.
const CORRECTION: f64 = 0.02;

/// Largest ratio of a correction to the one before it.
const CONTRACTION: f64 = 0.1;

/// Correction after which another one with the same Jacobian leaves only rounding errors.
const CONVERGED: f64 = 1e-8;

/// Part of the longest step so far at which shorter ones are given up: closer to a singular position, rounding is as large as
/// the distance between the ways that meet there.
const SHORTEST: f64 = 1e-6;

/// A position on the way, with the velocities and accelerations that the constraints determine.
struct Position {
    t: f64,
    q: DVector<f64>,
    v: DVector<f64>,
    qdd: DVector<f64>,
}

/// Constraints that can be solved only together, and the coordinates that they decide: an irreducible diagonal block of
/// `C_q` in block triangular form.
struct Loop {
    constraints: Vec<usize>,
    coordinates: Vec<usize>,
    /// Sign of the block's determinant at the start.
    side: f64,
}

/// The way of a run.
struct Way<'a> {
    model: &'a MultibodyModel,
    loops: Vec<Loop>,
    /// Scale of each coordinate: a radian or the longest lever arm.
    scale: DVector<f64>,
    /// Corrections are what counts.
    budget: &'a Budget<'a>,
}

/// Samples at evenly spaced times of a model without degrees of freedom, from its position at the first of them.
///
/// # Errors
/// An error that says which joints are in a singular position, or which driver's motion jumps, and when, or that the run's
/// budget is spent.
pub fn follow(
    model: &MultibodyModel,
    times: &[f64],
    q: DVector<f64>,
    budget: &Budget,
) -> Result<Vec<Sample>, MotionError> {
    let &[start, ..] = times else { return Ok(Vec::new()) };
    let stop = times[times.len() - 1];
    let way = Way::new(model, &q, budget);
    let mut from = way.position(start, q.clone()).ok_or_else(|| way.obstacle(start, start, &q))?;
    let mut samples = vec![way.sample(&from)?];
    let mut step = way.first_step(&from).min(1e-6 * (stop - start));
    let mut longest = step;
    while samples.len() < times.len() {
        budget.arrive(from.t);
        budget.check(|| Some("the drivers are too fast for so long a run".into()))?;
        let to = if step < stop - from.t { from.t + step } else { stop };
        match way.step(&from, to, &times[samples.len()..]) {
            Some((next, rows, correction)) => {
                for row in rows {
                    samples.push(way.sample(&row)?);
                }
                from = next;
                longest = longest.max(step);
                // the correction is of third order in the step
                step = (step * (0.5 * CORRECTION / correction).cbrt().min(2.0)).min(0.02 * (stop - start));
            }
            None if step <= (SHORTEST * longest).max(4.0 * f64::EPSILON * to.abs()) => {
                return Err(way.obstacle(from.t, to, &from.q));
            }
            None => step *= 0.5,
        }
    }
    Ok(samples)
}

impl<'a> Way<'a> {
    fn new(model: &'a MultibodyModel, q: &DVector<f64>, budget: &'a Budget) -> Self {
        let gradients = model.constraints.gradients(q);
        let mut loops = loops(&model.constraints, q);
        let transposed = gradients.dense();
        loops.iter_mut().for_each(|one| one.side = one.sign(&transposed));
        let length = model.constraints.lever_arm(&gradients);
        let scale = DVector::from_fn(q.len(), |coordinate, _| if coordinate % 3 == 2 { 1.0 } else { length });
        Self { model, loops, scale, budget }
    }

    /// A first step that moves no coordinate by much.
    fn first_step(&self, from: &Position) -> f64 {
        (0.1 / self.size(&from.v)).min((0.1 / self.size(&from.qdd)).sqrt())
    }

    /// The position at `to`, those at the times of rows up to there, and the size of the first correction.
    fn step(&self, from: &Position, to: f64, rows: &[f64]) -> Option<(Position, Vec<Position>, f64)> {
        let (next, correction) = self.correct(to, from.ahead(to))?;
        let rows = rows.iter().take_while(|&&t| t <= to);
        let rows: Option<Vec<_>> = rows.map(|&t| Some(self.correct(t, from.between(&next, t))?.0)).collect();
        Some((next, rows?, correction))
    }

    /// Newton's method from a prediction, as long as it converges at once; also the size of the first correction.
    fn correct(&self, t: f64, mut q: DVector<f64>) -> Option<(Position, f64)> {
        let constraints = &self.model.constraints;
        let rounding = 16.0 * f64::EPSILON * self.size(&q);
        let (mut first, mut allowed) = (None, CORRECTION);
        loop {
            self.budget.spend();
            let factors = square(&constraints.gradients(&q).dense());
            let correction = factors.solve(&constraints.residual(t, &q))?;
            let size = self.size(&correction);
            if size.is_nan() || size > allowed.max(rounding) {
                return None;
            }
            let first = *first.get_or_insert(size);
            q -= correction;
            if size <= CONVERGED.max(rounding) {
                q -= factors.solve(&constraints.residual(t, &q))?;
                return Some((self.position(t, q)?, first));
            }
            allowed = CONTRACTION * size;
        }
    }

    /// `C_q qd = f'`, `C_q qdd = F_c`; `None` where they have no solution, or where a loop has changed sides.
    fn position(&self, t: f64, q: DVector<f64>) -> Option<Position> {
        let constraints = &self.model.constraints;
        let transposed = constraints.gradients(&q).dense();
        if self.loops.iter().any(|one| one.sign(&transposed) != one.side) {
            return None;
        }
        let factors = square(&transposed);
        let v = factors.solve(&constraints.target_rates(t))?;
        let qdd = factors.solve(&constraints.acceleration_side(t, &q, &v))?;
        let is_finite = qdd.iter().chain(&v).all(|value| value.is_finite());
        is_finite.then_some(Position { t, q, v, qdd })
    }

    /// With the multipliers of `M qdd + C_q^T lambda = F_a`.
    fn sample(&self, position: &Position) -> Result<Sample, MotionError> {
        let Position { t, q, v, qdd } = position;
        let u = self.model.at(*t, &[]);
        let forces = self.model.applied_forces(*t, q, v, &u) - self.model.mass.component_mul(qdd);
        let multipliers = self.model.constraints.gradients(q).dense().lu().solve(&forces);
        let multipliers = multipliers.ok_or_else(|| self.obstacle(*t, *t, q))?;
        self.model.check(*t, q, v)?;
        Ok(Sample { t: *t, q: q.clone(), v: v.clone(), u, qdd: qdd.clone(), multipliers })
    }

    /// Largest entry, in radians and lever arms.
    fn size(&self, vector: &DVector<f64>) -> f64 {
        let sizes = vector.iter().zip(&self.scale).map(|(entry, scale)| (entry / scale).abs());
        sizes.fold(0.0, |largest, size| if size.is_nan() { size } else { largest.max(size) })
    }

    /// The reason why no path leads from a position to a time right after it.
    fn obstacle(&self, from: f64, to: f64, q: &DVector<f64>) -> MotionError {
        let constraints = &self.model.constraints;
        if let Some(error) = constraints.undefined_motion(to) {
            return error;
        }
        for constraint in constraints.iter() {
            let [before, behind] = [from, to].map(|t| constraint.target.at(t));
            let unit = if constraint.coordinate.is_angle() { 1.0 } else { self.scale[0] };
            if (behind.value - before.value - before.first * (to - from)).abs() > 0.5 * CORRECTION * unit {
                let message = format!("the motion of `{}` jumps at t = {to:.6} s", constraint.owner);
                return MotionError::of(&constraint.owner, MotionCause::Undefined, message);
            }
        }
        let owners = self.singular_loop(&constraints.gradients(q).dense());
        let names: Vec<String> = owners.iter().map(|owner| format!("`{owner}`")).collect();
        let message = format!("the mechanism reaches a singular position of {} at t = {to:.6} s", names.join(", "));
        let part = if let [owner] = owners[..] { Some(owner.to_owned()) } else { None };
        MotionError { cause: MotionCause::Singular, part, message }
    }

    /// The joints and drivers that hold the bodies of the loop that is the closest to a singular position.
    fn singular_loop(&self, transposed: &DMatrix<f64>) -> Vec<&str> {
        let parts = self.loops.iter().map(|of| (of.least_independent_part(transposed), of));
        let Some((_, singular)) = parts.min_by(|(a, _), (b, _)| a.total_cmp(b)) else { return Vec::new() };
        let decisions =
            self.loops.iter().flat_map(|one| one.constraints.iter().copied().zip(one.coordinates.iter().copied()));
        let of_its_bodies =
            decisions.filter(|(_, coordinate)| singular.coordinates.iter().any(|c| c / 3 == coordinate / 3));
        let mut rows: Vec<usize> = of_its_bodies.map(|(row, _)| row).collect();
        rows.sort_unstable();
        let mut owners: Vec<&str> = rows.into_iter().map(|row| self.model.constraints[row].owner.as_str()).collect();
        owners.dedup();
        owners
    }
}

impl Position {
    /// The coordinates at another time, by the parabola.
    fn ahead(&self, t: f64) -> DVector<f64> {
        let step = t - self.t;
        &self.q + step * &self.v + 0.5 * step * step * &self.qdd
    }

    /// The coordinates at a time between two positions, by the polynomial of degree 5 through both.
    fn between(&self, next: &Self, t: f64) -> DVector<f64> {
        let step = next.t - self.t;
        let s = (t - self.t) / step;
        let positions = &next.q - self.ahead(next.t);
        let velocities = step * (&next.v - &self.v - step * &self.qdd);
        let accelerations = step * step * (&next.qdd - &self.qdd);
        let cubic = 10.0 * &positions - 4.0 * &velocities + 0.5 * &accelerations;
        let quartic = -15.0 * &positions + 7.0 * &velocities - &accelerations;
        let quintic = 6.0 * positions - 3.0 * velocities + 0.5 * accelerations;
        self.ahead(t) + s.powi(3) * (cubic + s * (quartic + s * quintic))
    }
}

impl Loop {
    /// The block of `C_q^T`.
    fn block(&self, transposed: &DMatrix<f64>) -> DMatrix<f64> {
        transposed.select_rows(&self.coordinates).select_columns(&self.constraints)
    }

    /// Smallest part of a constraint's gradient that is in the block and independent of the others.
    fn least_independent_part(&self, transposed: &DMatrix<f64>) -> f64 {
        let block = self.block(transposed);
        let parts = independence(&block).into_iter().zip(block.column_iter().zip(&self.constraints));
        let parts = parts.map(|(part, (column, &row))| part * column.norm() / transposed.column(row).norm());
        parts.fold(1.0, f64::min)
    }

    /// Sign of the block's determinant, which may be too small or too large a number itself.
    fn sign(&self, transposed: &DMatrix<f64>) -> f64 {
        let factors = self.block(transposed).lu();
        factors.p().determinant::<f64>() * factors.lu_internal().diagonal().map(f64::signum).product()
    }
}

/// `C_q` factorised.
fn square(transposed: &DMatrix<f64>) -> LU<f64, Dyn, Dyn> {
    transposed.transpose().lu()
}

/// The irreducible diagonal blocks of `C_q` (Duff, Reid 1978): a coordinate is found for each constraint, then those that
/// need each other are put together.
fn loops(constraints: &Constraints, q: &DVector<f64>) -> Vec<Loop> {
    let count = constraints.len();
    // what is zero in this position is zero in all
    let anywhere = DVector::from_fn(q.len(), |coordinate, _| q[coordinate] + (1.0 + coordinate as f64).sin());
    let transposed = constraints.gradients(&anywhere).dense();
    let has = |constraint: usize, coordinate: usize| {
        let column = transposed.column(constraint);
        column[coordinate].abs() > 1e-12 * column.amax()
    };
    let mut decided_by: Vec<Option<usize>> = vec![None; count];
    for constraint in 0..count {
        assign(constraint, &has, &mut decided_by, &mut vec![false; count]);
    }
    let mut decides = vec![0; count];
    for (coordinate, constraint) in decided_by.iter().enumerate() {
        if let Some(constraint) = *constraint {
            decides[constraint] = coordinate;
        }
    }
    // whether a constraint needs what another one decides, at first directly, then on any way (Warshall)
    let mut needs = DMatrix::from_fn(count, count, |one, other| one == other || has(one, decides[other]));
    for between in 0..count {
        for one in 0..count {
            for other in 0..count {
                needs[(one, other)] |= needs[(one, between)] && needs[(between, other)];
            }
        }
    }
    let mut loops = Vec::new();
    for first in 0..count {
        let constraints: Vec<usize> =
            (0..count).filter(|&other| needs[(first, other)] && needs[(other, first)]).collect();
        if constraints[0] == first {
            let coordinates = constraints.iter().map(|&constraint| decides[constraint]).collect();
            loops.push(Loop { constraints, coordinates, side: 0.0 });
        }
    }
    loops
}

/// Finds a coordinate for a constraint; the others may have to take other ones (Kuhn's augmenting paths).
fn assign(
    constraint: usize,
    has: &impl Fn(usize, usize) -> bool,
    decided_by: &mut [Option<usize>],
    tried: &mut [bool],
) -> bool {
    (0..decided_by.len()).any(|coordinate| {
        if tried[coordinate] || !has(constraint, coordinate) {
            return false;
        }
        tried[coordinate] = true;
        let is_free = decided_by[coordinate].is_none_or(|other| assign(other, has, decided_by, tried));
        if is_free {
            decided_by[coordinate] = Some(constraint);
        }
        is_free
    })
}
