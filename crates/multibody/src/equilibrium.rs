//! Static equilibrium of a mechanism: positions in which it stays at rest.
//!
//! With the multipliers `lambda` of least squares, `R = F_a - C_q^T lambda` is the part of the applied forces that the constraints do not
//! balance. Positions follow it in steps of pseudo-time `h`, linearly implicit in the stiffness `K = dR/dq` (Kelley, Keyes 1998: *Convergence
//! analysis of pseudo-transient continuation*):
//!
//! ```text
//! [M/h - K  C_q^T; C_q  0] [dq; mu] = [R; -C]
//! ```
//!
//! Steps grow until they are those of Newton's method. Each follows the forces, so that the equilibrium is stable unless the mechanism starts in
//! an unstable one.

use super::{
    constraint::{Constraint, Constraints, Target},
    coordinate::size_of_change,
    error::{MotionCause, MotionError},
    model::MultibodyModel,
};
use nalgebra::{DMatrix, DVector};

/// Steps at most.
const MOST_STEPS: u32 = 500;

/// Largest change of a coordinate in a step: an angle, and a length in lengths of the mechanism.
const LARGEST_STEP: f64 = 0.2;

/// First pseudo-time step, in s², and the one from which on steps are those of Newton's method.
const FIRST: f64 = 1e-3;
const NEWTON: f64 = 1e9;

/// Part of the forces that rounding may leave.
const BALANCED: f64 = 1e-11;

/// Part of the forces above which steps must follow them.
const DECIDED: f64 = 1e-6;

/// Moves positions that meet some constraints to a static equilibrium with the inputs and actuator states of the start. What drivers
/// accelerate stays where it is.
///
/// # Errors
/// An error: no equilibrium is found, or no position is free.
pub(super) fn settle(
    model: &MultibodyModel,
    t: f64,
    held: &Constraints,
    q: &mut DVector<f64>,
) -> Result<(), MotionError> {
    let driven = model.prescribed.iter().map(|driver| Constraint {
        coordinate: driver.coordinate,
        target: Target::Fixed { value: driver.coordinate.value(q), rate: 0.0 },
        owner: driver.owner.clone(),
    });
    let held: Constraints = held.iter().cloned().chain(driven).collect();
    if held.len() >= q.len() {
        let message = "no position is free to settle: joints, `[initial]` and drivers decide all of them";
        return Err(MotionError::of("equilibrium", MotionCause::Inconsistent, message));
    }
    let (u, rest) = (model.at(t, &model.actuator_starts()), DVector::zeros(q.len()));
    let forces = |q: &DVector<f64>| model.applied_forces(t, q, &rest, &u);
    let length = model.length(&held.gradients(q));
    let (mut h, mut left) = (FIRST, f64::NAN);
    for _ in 0..MOST_STEPS {
        let transposed = held.gradients(q).dense();
        let applied = forces(q);
        let multipliers = balance(&transposed, &applied);
        let residual = &applied - &transposed * &multipliers;
        let scale = largest(model, t, q, &u).max(f64::MIN_POSITIVE);
        left = residual.amax();
        let is_newton = h >= NEWTON;
        if left <= BALANCED * scale && is_newton {
            return Ok(());
        }
        let stiffness = derivative(&|q: &DVector<f64>| forces(q) - held.gradients(q).sum(&multipliers), q);
        let step = loop {
            let step = step(&model.mass, h, &stiffness, &transposed, &residual, &held.residual(t, q));
            let step = step.filter(|step| left <= DECIDED * scale || step.dot(&residual) > 0.0);
            match step.filter(|step| size_of_change(step, length) <= LARGEST_STEP) {
                Some(step) => break step,
                None if h < f64::MIN_POSITIVE / f64::EPSILON => return Err(none_found(left)),
                None => h *= 0.1,
            }
        };
        *q += step;
        held.correct_positions(t, q)?;
        h *= 3.0;
    }
    Err(none_found(left))
}

/// The largest weight, or force of a spring or an effort. Their sum vanishes in equilibrium.
fn largest(model: &MultibodyModel, t: f64, q: &DVector<f64>, u: &[f64]) -> f64 {
    let rest = DVector::zeros(q.len());
    let springs = model.springs.iter().map(|spring| spring.effort(q, &rest));
    let efforts = model.efforts.iter().map(|effort| effort.expression.value(t, q, &rest, u));
    let weight = model.mass.amax() * model.gravity.norm();
    springs.chain(efforts).fold(weight, |largest, force| largest.max(force.abs()))
}

fn none_found(left: f64) -> MotionError {
    let message =
        format!("no static equilibrium is found from the guesses of positions: {left:.1e} N or N.m are not balanced");
    MotionError::of("equilibrium", MotionCause::Unsolved, message)
}

/// Multipliers that balance forces best, `min |F - C_q^T lambda|`.
fn balance(transposed: &DMatrix<f64>, forces: &DVector<f64>) -> DVector<f64> {
    if transposed.ncols() == 0 {
        return DVector::zeros(0);
    }
    let qr = transposed.clone().qr();
    qr.r().solve_upper_triangular(&qr.q().tr_mul(forces)).unwrap_or_else(|| DVector::zeros(transposed.ncols()))
}

/// A step of pseudo-time.
fn step(
    mass: &DVector<f64>,
    h: f64,
    stiffness: &DMatrix<f64>,
    transposed: &DMatrix<f64>,
    residual: &DVector<f64>,
    gaps: &DVector<f64>,
) -> Option<DVector<f64>> {
    let (n, m) = transposed.shape();
    let mut matrix = DMatrix::zeros(n + m, n + m);
    matrix.view_mut((0, 0), (n, n)).copy_from(&(DMatrix::from_diagonal(&(mass / h)) - stiffness));
    matrix.view_mut((0, n), (n, m)).copy_from(transposed);
    matrix.view_mut((n, 0), (m, n)).tr_copy_from(transposed);
    let side = DVector::from_iterator(n + m, residual.iter().copied().chain(gaps.iter().map(|gap| -gap)));
    let solution = matrix.lu().solve(&side)?;
    solution.iter().all(|value| value.is_finite()).then(|| solution.rows(0, n).into_owned())
}

/// Derivative of a function of the coordinates by central differences.
fn derivative(function: &dyn Fn(&DVector<f64>) -> DVector<f64>, q: &DVector<f64>) -> DMatrix<f64> {
    let columns = (0..q.len()).map(|k| {
        let by = f64::EPSILON.cbrt() * (1.0 + q[k].abs());
        let [low, high] = [-by, by].map(|by| {
            let mut moved = q.clone();
            moved[k] += by;
            function(&moved)
        });
        (high - low) / (2.0 * by)
    });
    DMatrix::from_columns(&columns.collect::<Vec<_>>())
}
