//! The two formulations of the equations of motion in Choi et al. 2021, section 2.
//!
//! *Augmented*: accelerations and Lagrange multipliers of all coordinates from
//! `[M C_q^T; C_q 0] [qdd; lambda] = [F_a; F_c]`. The state `(q, qd)` drifts off the constraints, which are enforced for
//! accelerations only; it is projected back where the drift exceeds 1e-11, or 10 tolerances of the integration
//! if that is more.
//!
//! *Embedding*: the state is `(q_i, qd_i)`, the independent coordinates; the others follow from the constraints. With
//! `C_q = [C_d C_i]`: `qdd = T qdd_i + r`, `T = [-C_d^-1 C_i; 1]`, `r = [C_d^-1 F_c; 0]`, and
//! `(T^T M T) qdd_i = T^T F_a - T^T M r` (Wehage, Haug 1982: generalized coordinate partitioning). The dependent
//! coordinates are chosen by Gaussian elimination with full pivoting, and again when `C_d` degrades.
//!
//! A driver that gives the acceleration `a` of a coordinate `s(q)` adds the row `s_q qdd = a - (s_q qd)_q qd` with a
//! multiplier `mu` to either formulation. In the augmented equations it is a constraint whose position and velocity are
//! those of the start. In the embedding, with `G = s_q T`, it is
//! `[T^T M T G^T; G 0] [qdd_i; mu] = [T^T F_a - T^T M r; a - (s_q qd)_q qd - s_q r]`.

use super::{
    coordinate::{Coordinate, TurnedBodies},
    description::FormulationKind,
    error::{MotionCause, MotionError},
    gradients::SparseGradients,
    model::MultibodyModel,
};
use nalgebra::{DMatrix, DVector, Dyn, LU};
use std::cell::Cell;

/// Violation of positions (m, rad) or velocities (m/s, rad/s) at which the augmented formulation's state is projected, in tolerances of
/// the integration.
const DRIFT: f64 = 10.0;

/// Least such violation: rounding must not reach it.
const LEAST_DRIFT: f64 = 1e-11;

/// Part of the determinant of `C_d` when it was chosen at which another partition is chosen.
const DEGRADED: f64 = 0.5;

/// Part of that determinant below which a partition is not used: beyond the singularity lies another assembly.
const UNUSABLE: f64 = 0.05;

/// Accelerations and multipliers in one state.
#[derive(Clone, Debug)]
pub struct Acceleration {
    /// `qdd`.
    pub qdd: DVector<f64>,
    /// `lambda`: the constraint forces are `-C_q^T lambda`; then those of prescribed accelerations.
    pub multipliers: DVector<f64>,
}

/// A formulation at work on a stretch of a run.
#[derive(Clone, Debug)]
pub enum Formulation {
    /// All coordinates with Lagrange multipliers.
    Augmented,
    /// Independent coordinates only.
    Embedding(Partition),
}

/// `C_d` factorised, and `C_i`.
type PartitionedJacobian = (LU<f64, Dyn, Dyn>, DMatrix<f64>);

/// Which coordinates are dependent.
#[derive(Clone, Debug)]
pub struct Partition {
    dependent: Vec<usize>,
    independent: Vec<usize>,
    /// Determinant of `C_d` when it was chosen.
    determinant: f64,
    /// Part of it that is left in the state that was looked at last.
    left: Cell<f64>,
}

impl Formulation {
    /// A formulation, from a state on the constraints.
    ///
    /// # Errors
    /// Names the constraint that is singular there.
    pub fn new(kind: FormulationKind, model: &MultibodyModel, t: f64, q: &DVector<f64>) -> Result<Self, MotionError> {
        Ok(match kind {
            // without constraints both are the same, and without a free coordinate there is nothing to integrate
            FormulationKind::Embedding if model.constraints.is_empty() || model.degrees_of_freedom() == 0 => {
                Self::Augmented
            }
            FormulationKind::Augmented => Self::Augmented,
            FormulationKind::Embedding => Self::Embedding(Partition::new(model, t, q)?),
        })
    }

    /// The integrated state: `(q, qd)` or `(q_i, qd_i)`; for `(qd, qdd)` its derivative.
    pub fn state(&self, q: &DVector<f64>, v: &DVector<f64>) -> DVector<f64> {
        match self {
            Self::Augmented => stack(q, v),
            Self::Embedding(partition) => stack(&gather(q, &partition.independent), &gather(v, &partition.independent)),
        }
    }

    /// All coordinates and velocities of a state; those that are dependent are found from a guess nearby.
    ///
    /// # Errors
    /// Which constraint cannot be met.
    pub fn complete(
        &self,
        model: &MultibodyModel,
        t: f64,
        state: &DVector<f64>,
        guess: &DVector<f64>,
    ) -> Result<(DVector<f64>, DVector<f64>), MotionError> {
        let (q, v) = halves(state);
        match self {
            Self::Augmented => Ok((q, v)),
            Self::Embedding(partition) => partition.complete(model, t, (&q, &v), guess),
        }
    }

    /// Accelerations and multipliers.
    ///
    /// # Errors
    /// Names the constraint that is singular there.
    pub fn accelerate(
        &self,
        model: &MultibodyModel,
        t: f64,
        (q, v): (&DVector<f64>, &DVector<f64>),
        u: &[f64],
    ) -> Result<Acceleration, MotionError> {
        match self {
            Self::Augmented => augmented(model, t, (q, v), u),
            Self::Embedding(partition) => partition.accelerate(model, t, (q, v), u),
        }
    }

    /// Returns true if a state needs to be projected, or other independent coordinates have to be chosen.
    pub fn is_worn(&self, model: &MultibodyModel, t: f64, state: &DVector<f64>) -> bool {
        match self {
            Self::Augmented => {
                let (q, v) = halves(state);
                let drift = LEAST_DRIFT.max(DRIFT * model.tolerance);
                model.constraints.violation(t, &q, &v) > drift * (1.0 + q.amax())
            }
            Self::Embedding(partition) => partition.left.get() < DEGRADED,
        }
    }
}

/// `[M C_q^T; C_q 0] [qdd; lambda] = [F_a; F_c]`.
///
/// # Errors
/// Names the constraint that is singular there.
pub fn augmented(
    model: &MultibodyModel,
    t: f64,
    (q, v): (&DVector<f64>, &DVector<f64>),
    u: &[f64],
) -> Result<Acceleration, MotionError> {
    let q = &TurnedBodies::new(q);
    let gradients = model.deciding.gradients(q);
    let (forces, side) = (model.applied_forces(t, q, v, u), model.deciding_side(t, q, v, u));
    let solution = eliminated(model, &gradients, &forces, &side);
    let solution = solution.or_else(|| whole(&model.mass, &gradients, &forces, &side));
    solution.ok_or_else(|| without_solution(model, t, &gradients))
}

/// The augmented equations with the accelerations eliminated: `(C_q M^-1 C_q^T) lambda = C_q M^-1 F_a - F_c` by Cholesky's
/// method, at a fraction of the cost. `None` where a mass is zero or the matrix is not safely positive definite.
fn eliminated(
    model: &MultibodyModel,
    gradients: &SparseGradients,
    forces: &DVector<f64>,
    side: &DVector<f64>,
) -> Option<Acceleration> {
    if model.mass.iter().any(|&mass| mass <= 0.0) {
        return None;
    }
    let mobility = model.mass.map(|mass| 1.0 / mass);
    let elimination = model.deciding.elimination(gradients);
    let factors = elimination.factorise(gradients, |body| mobility.fixed_rows::<3>(3 * body).into_owned())?;
    let free = forces.component_mul(&mobility);
    let multipliers = factors.solve(&(gradients.along(&free) - side));
    let qdd = free - gradients.sum(&multipliers).component_mul(&mobility);
    let is_finite = qdd.iter().chain(multipliers.iter()).all(|value| value.is_finite());
    is_finite.then_some(Acceleration { qdd, multipliers })
}

/// The augmented equations without elimination.
fn whole(
    mass: &DVector<f64>,
    gradients: &SparseGradients,
    forces: &DVector<f64>,
    side: &DVector<f64>,
) -> Option<Acceleration> {
    let transposed = gradients.dense();
    let (n, m) = transposed.shape();
    let mut matrix = DMatrix::zeros(n + m, n + m);
    matrix.view_mut((0, 0), (n, n)).set_diagonal(mass);
    matrix.view_mut((0, n), (n, m)).copy_from(&transposed);
    matrix.view_mut((n, 0), (m, n)).tr_copy_from(&transposed);
    let solution = matrix.lu().solve(&stack(forces, side)).filter(|x| x.iter().all(|value| value.is_finite()))?;
    Some(Acceleration { qdd: solution.rows(0, n).into_owned(), multipliers: solution.rows(n, m).into_owned() })
}

/// Acceleration of a coordinate by a unit force or torque along it, at rest and with nothing else acting. `None` in a singular
/// position.
pub fn mobility(model: &MultibodyModel, q: &DVector<f64>, coordinate: &Coordinate) -> Option<f64> {
    let mut force = DVector::zeros(q.len());
    coordinate.add_gradient(q, 1.0, force.as_mut_slice());
    let gradients = model.deciding.gradients(q);
    let Acceleration { qdd, .. } = whole(&model.mass, &gradients, &force, &DVector::zeros(gradients.len()))?;
    Some(qdd.dot(&force))
}

/// The error of dependent coordinates that the others do not decide.
fn without_partition() -> MotionError {
    MotionError::new(MotionCause::Singular, "C_d is singular")
}

/// The reason why the equations of motion have no solution.
fn without_solution(model: &MultibodyModel, t: f64, gradients: &SparseGradients) -> MotionError {
    match model.deciding.first_dependent(gradients) {
        Some(_) => model.deciding.singular(t, gradients),
        None => {
            let message = format!(
                "the equations of motion have no finite solution at t = {t} s: a free motion without mass or inertia, or a \
                 force that is not finite"
            );
            MotionError::new(MotionCause::Unsolved, message)
        }
    }
}

impl Partition {
    /// Chooses the dependent coordinates: the pivots of Gaussian elimination with full pivoting of `C_q`.
    fn new(model: &MultibodyModel, t: f64, q: &DVector<f64>) -> Result<Self, MotionError> {
        let gradients = model.constraints.gradients(q);
        if model.constraints.first_dependent(&gradients).is_some() {
            return Err(model.constraints.singular(t, &gradients));
        }
        let transposed = gradients.dense();
        let (n, m) = transposed.shape();
        let mut scaled = transposed.transpose();
        // lengths in parts of the mechanism's size: the pivots do not depend on the unit
        let length = model.length(&gradients);
        for (constraint, mut row) in model.constraints.iter().zip(scaled.row_iter_mut()) {
            if !constraint.coordinate.is_angle() {
                row.iter_mut().skip(2).step_by(3).for_each(|of_angle| *of_angle /= length);
            }
        }
        let mut order = DMatrix::from_fn(1, n, |_, column| column);
        scaled.full_piv_lu().q().permute_columns(&mut order);
        let (mut dependent, mut independent) = (order.as_slice()[..m].to_vec(), order.as_slice()[m..].to_vec());
        dependent.sort_unstable();
        independent.sort_unstable();
        let determinant = transposed.select_rows(&dependent).transpose().determinant();
        Ok(Self { dependent, independent, determinant, left: Cell::new(1.0) })
    }

    /// `C_d` factorised and `C_i`; `None` if `C_d` is near singular or beyond a singularity.
    fn split(&self, transposed: &DMatrix<f64>) -> Option<PartitionedJacobian> {
        let factors = transposed.select_rows(&self.dependent).transpose().lu();
        let left = factors.determinant() / self.determinant;
        self.left.set(left);
        (left > UNUSABLE).then(|| (factors, transposed.select_rows(&self.independent).transpose()))
    }

    fn complete(
        &self,
        model: &MultibodyModel,
        t: f64,
        (q_i, v_i): (&DVector<f64>, &DVector<f64>),
        guess: &DVector<f64>,
    ) -> Result<(DVector<f64>, DVector<f64>), MotionError> {
        let mut q = guess.clone();
        scatter(&mut q, &self.independent, q_i);
        let (factors, c_i) = self.correct_dependent(model, t, &mut q)?;
        let dependent =
            factors.solve(&(model.constraints.target_rates(t) - c_i * v_i)).ok_or_else(without_partition)?;
        let mut v = DVector::zeros(q.len());
        scatter(&mut v, &self.independent, v_i);
        scatter(&mut v, &self.dependent, &dependent);
        Ok((q, v))
    }

    /// Newton's method on the dependent coordinates; returns `C_d` factorised and `C_i` at the solution.
    fn correct_dependent(
        &self,
        model: &MultibodyModel,
        t: f64,
        q: &mut DVector<f64>,
    ) -> Result<PartitionedJacobian, MotionError> {
        let mut converged = false;
        for _ in 0..30 {
            let gradients = model.constraints.gradients(q);
            let split = self.split(&gradients.dense());
            let split = split.ok_or_else(|| model.constraints.singular(t, &gradients))?;
            if converged {
                return Ok(split);
            }
            let step = split.0.solve(&model.constraints.residual(t, q)).ok_or_else(without_partition)?;
            for (&position, step) in self.dependent.iter().zip(step.iter()) {
                q[position] -= step;
            }
            // the error left is about the square of the step: below rounding
            converged = step.amax() <= 1e-8 * (1.0 + q.amax());
        }
        let message = format!("the dependent coordinates cannot be found at t = {t} s");
        Err(MotionError::new(MotionCause::Singular, message))
    }

    fn accelerate(
        &self,
        model: &MultibodyModel,
        t: f64,
        (q, v): (&DVector<f64>, &DVector<f64>),
        u: &[f64],
    ) -> Result<Acceleration, MotionError> {
        let (gradients, side) = (model.deciding.gradients(q), model.deciding_side(t, q, v, u));
        let (m, prescribed) = (model.constraints.len(), model.prescribed.len());
        let all = gradients.dense();
        let transposed = all.columns(0, m).into_owned();
        let (factors, c_i) = self.split(&transposed).ok_or_else(|| model.constraints.singular(t, &gradients))?;
        let (t_d, r_d) = (factors.solve(&-c_i), factors.solve(&side.rows(0, m)));
        let (t_d, r_d) = Option::zip(t_d, r_d).ok_or_else(without_partition)?;
        let forces = model.applied_forces(t, q, v, u);
        let (m_d, m_i) = (gather(&model.mass, &self.dependent), gather(&model.mass, &self.independent));

        // s_q^T of prescribed accelerations, and G^T
        let s_q = all.columns(m, prescribed);
        let [s_d, s_i] = [&self.dependent, &self.independent].map(|rows| s_q.select_rows(rows));
        let g = s_i + t_d.tr_mul(&s_d);

        // [T^T M T G^T; G 0] [qdd_i; mu] = [T^T F_a - T^T M r; a - (s_q qd)_q qd - s_q r]
        let mut weighted = t_d.clone();
        weighted.column_iter_mut().for_each(|mut column| column.component_mul_assign(&m_d));
        let free = self.independent.len();
        let mut matrix = DMatrix::zeros(free + prescribed, free + prescribed);
        matrix.view_mut((0, 0), (free, free)).copy_from(&(t_d.tr_mul(&weighted) + DMatrix::from_diagonal(&m_i)));
        matrix.view_mut((0, free), (free, prescribed)).copy_from(&g);
        matrix.view_mut((free, 0), (prescribed, free)).tr_copy_from(&g);
        let f_d = gather(&forces, &self.dependent);
        let of_forces = gather(&forces, &self.independent) + t_d.tr_mul(&(&f_d - m_d.component_mul(&r_d)));
        let of_drivers = side.rows(m, prescribed) - s_d.tr_mul(&r_d);
        let solution = matrix.lu().solve(&stack(&of_forces, &of_drivers));
        let solution = solution.filter(|x| x.iter().all(|value| value.is_finite()));
        let solution = solution.ok_or_else(|| without_solution(model, t, &gradients))?;
        let (qdd_i, mu) = (solution.rows(0, free).into_owned(), solution.rows(free, prescribed).into_owned());

        // the dependent rows of M qdd + C_q^T lambda + s_q^T mu = F_a
        let qdd_d = t_d * &qdd_i + r_d;
        let c_d_transposed = transposed.select_rows(&self.dependent).lu();
        let rest = f_d - m_d.component_mul(&qdd_d) - s_d * &mu;
        let multipliers = c_d_transposed.solve(&rest).ok_or_else(without_partition)?;
        let mut qdd = DVector::zeros(q.len());
        scatter(&mut qdd, &self.independent, &qdd_i);
        scatter(&mut qdd, &self.dependent, &qdd_d);
        Ok(Acceleration { qdd, multipliers: stack(&multipliers, &mu) })
    }
}

fn gather(vector: &DVector<f64>, positions: &[usize]) -> DVector<f64> {
    DVector::from_iterator(positions.len(), positions.iter().map(|&position| vector[position]))
}

fn scatter(vector: &mut DVector<f64>, positions: &[usize], values: &DVector<f64>) {
    for (&position, &value) in positions.iter().zip(values.iter()) {
        vector[position] = value;
    }
}

fn stack(upper: &DVector<f64>, lower: &DVector<f64>) -> DVector<f64> {
    DVector::from_vec([upper.as_slice(), lower.as_slice()].concat())
}

fn halves(state: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
    let (upper, lower) = state.as_slice().split_at(state.len() / 2);
    (DVector::from_column_slice(upper), DVector::from_column_slice(lower))
}
