//! Constraints `C(q, t) = 0` of joints and drivers, with the terms that the solvers need.
//!
//! A constraint holds a scalar [`Coordinate`] at a target: `C = s(q) - f(t)`. Differentiated twice
//! (Haug: *Computer-Aided Kinematics and Dynamics of Mechanical Systems*, chapter 3):
//! - `C_q qd = f'`
//! - `C_q qdd = F_c` with `F_c = f'' - (C_q qd)_q qd`

use super::{
    coordinate::{Coordinate, Positions, TurnedBodies},
    error::{MotionCause, MotionError},
    gradients::{Elimination, SparseGradients},
};
use crate::diagnostics::numbers::power;
use metafmu_runtime::{Jet, formula::Formula};
use nalgebra::{DMatrix, DVector, Vector3};
use std::{ops::Deref, sync::OnceLock};

/// An expression whose names are resolved.
#[derive(Clone, Debug)]
pub struct BoundExpression {
    /// The expression, for messages.
    pub text: String,
    /// Its formula.
    pub formula: Formula,
    /// Quantity that each of its columns refers to.
    pub slots: Vec<Slot>,
}

/// Quantity that a name in a [`BoundExpression`] refers to.
#[derive(Clone, Copy, Debug)]
pub enum Slot {
    /// A parameter, by its position in the mechanism, and its value.
    Parameter(usize, f64),
    /// The time.
    Time,
    /// An input, by its position in the mechanism.
    Input(usize),
    /// A coordinate's value.
    Position(Coordinate),
    /// A coordinate's rate.
    Velocity(Coordinate),
}

impl Slot {
    /// Returns true if the quantity may change during a run.
    pub fn changes(&self) -> bool {
        !matches!(self, Self::Parameter(..))
    }

    /// Value in a state, with inputs `u`.
    pub fn value(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> f64 {
        match self {
            Self::Parameter(_, value) => *value,
            Self::Time => t,
            Self::Input(input) => u[*input],
            Self::Position(coordinate) => coordinate.value(q),
            Self::Velocity(coordinate) => coordinate.rate(q, v),
        }
    }
}

impl BoundExpression {
    /// Value and time derivatives of an expression of time alone.
    pub fn of_time(&self, t: f64) -> Jet {
        self.formula.series(|position| match self.slots[position] {
            Slot::Parameter(_, value) => Jet::from(value),
            Slot::Time => Jet { value: t, first: 1.0, second: 0.0 },
            Slot::Input(_) | Slot::Position(_) | Slot::Velocity(_) => Jet::from(f64::NAN),
        })
    }

    /// Value in a state, with inputs `u`.
    pub fn value(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> f64 {
        self.formula.value(|position| self.slots[position].value(t, q, v, u))
    }

    /// Value of an expression of positions alone, its rate, and the part of its second derivative that accelerations do not enter.
    fn of_positions(&self, q: &impl Positions, v: &DVector<f64>) -> Jet {
        self.formula.series(|position| match self.slots[position] {
            Slot::Parameter(_, value) => Jet::from(value),
            Slot::Position(coordinate) => {
                Jet { value: coordinate.value(q), first: coordinate.rate(q, v), second: coordinate.curvature(q, v) }
            }
            Slot::Time | Slot::Input(_) | Slot::Velocity(_) => Jet::from(f64::NAN),
        })
    }

    /// Passes the parts of `factor * f_q` of an expression of positions alone on.
    fn visit_gradient(&self, q: &impl Positions, factor: f64, act: &mut dyn FnMut(usize, Vector3<f64>)) {
        for (changed, slot) in self.slots.iter().enumerate() {
            let Slot::Position(coordinate) = slot else { continue };
            let slope = self.formula.series(|position| match self.slots[position] {
                Slot::Position(of) => Jet { first: f64::from(u8::from(position == changed)), ..Jet::from(of.value(q)) },
                Slot::Parameter(_, value) => Jet::from(value),
                Slot::Time | Slot::Input(_) | Slot::Velocity(_) => Jet::from(f64::NAN),
            });
            coordinate.visit_gradient(q, factor * slope.first, act);
        }
    }
}

/// Target of a constrained coordinate.
#[derive(Clone, Debug)]
pub enum Target {
    /// At a value and a rate.
    Fixed {
        /// The value.
        value: f64,
        /// The rate.
        rate: f64,
    },
    /// At a function of time.
    Motion(BoundExpression),
    /// At a function of other coordinates.
    Follows(BoundExpression),
}

impl Target {
    /// Value and time derivatives of what depends on time alone; zero for a function of coordinates.
    pub fn at(&self, t: f64) -> Jet {
        match self {
            Self::Fixed { value, rate } => Jet { value: *value, first: *rate, second: 0.0 },
            Self::Motion(formula) => formula.of_time(t),
            Self::Follows(_) => Jet::from(0.0),
        }
    }
}

/// One scalar constraint.
#[derive(Clone, Debug)]
pub struct Constraint {
    /// The constrained coordinate.
    pub coordinate: Coordinate,
    /// Its target.
    pub target: Target,
    /// Key of what it belongs to in the description, for messages: `joints.A`.
    pub owner: String,
}

impl Constraint {
    /// `C(q, t)`
    fn residual(&self, t: f64, q: &impl Positions) -> f64 {
        let target = match &self.target {
            Target::Follows(of) => of.value(t, q, q.coordinates(), &[]),
            target => target.at(t).value,
        };
        self.coordinate.value(q) - target
    }

    /// Passes the parts of `C_q` on.
    fn visit_gradient(&self, q: &impl Positions, act: &mut dyn FnMut(usize, Vector3<f64>)) {
        self.coordinate.visit_gradient(q, 1.0, act);
        if let Target::Follows(of) = &self.target {
            of.visit_gradient(q, -1.0, act);
        }
    }

    /// `(C_q qd)_q qd`, in m/s² or rad/s².
    pub fn curvature(&self, q: &impl Positions, v: &DVector<f64>) -> f64 {
        let of_target = if let Target::Follows(of) = &self.target { of.of_positions(q, v).second } else { 0.0 };
        self.coordinate.curvature(q, v) - of_target
    }
}

/// All scalar constraints of a mechanism, in the order of the multipliers.
#[derive(Clone, Debug, Default)]
pub struct Constraints {
    list: Vec<Constraint>,
    /// Found when it is first used.
    elimination: OnceLock<Elimination>,
}

impl Deref for Constraints {
    type Target = [Constraint];

    fn deref(&self) -> &[Constraint] {
        &self.list
    }
}

impl FromIterator<Constraint> for Constraints {
    fn from_iter<I: IntoIterator<Item = Constraint>>(constraints: I) -> Self {
        Self { list: constraints.into_iter().collect(), elimination: OnceLock::new() }
    }
}

/// Constraints hold to this in every row: positions in m and rad, velocities in m/s and rad/s.
pub const CONSTRAINT_TOLERANCE: f64 = 1e-10;

/// Constraints hold to this fraction of the largest coordinate or velocity where it exceeds [`CONSTRAINT_TOLERANCE`],
/// that is beyond 10 km, 10 000 rad, or these per second. Doubles have 16 digits, and a constraint is a difference of
/// coordinates.
pub const CONSTRAINT_ROUNDING: f64 = 1e-14;

/// A row of the Jacobian counts as dependent on those before it if its component outside their span is below this fraction of it.
pub(super) const DEPENDENT: f64 = 1e-9;

impl Constraints {
    /// `C(q, t)`.
    pub fn residual(&self, t: f64, q: &impl Positions) -> DVector<f64> {
        DVector::from_iterator(self.len(), self.iter().map(|constraint| constraint.residual(t, q)))
    }

    /// Gradients of the constraints: the columns of `C_q^T`.
    pub fn gradients(&self, q: &impl Positions) -> SparseGradients {
        let mut gradients = SparseGradients::new(q.coordinates().len(), self.len());
        for constraint in self.iter() {
            gradients.push(|act| constraint.visit_gradient(q, act));
        }
        gradients
    }

    /// Order and pattern of the factors for the gradients of these constraints.
    pub fn elimination(&self, gradients: &SparseGradients) -> &Elimination {
        self.elimination.get_or_init(|| Elimination::new(gradients))
    }

    /// The longest lever arm: by how much a length changes with an angle at most, in m/rad; 1 if none does. It makes lengths
    /// comparable with angles.
    pub fn lever_arm(&self, gradients: &SparseGradients) -> f64 {
        let lengths = (0..self.len()).filter(|&row| !self[row].coordinate.is_angle());
        let parts = lengths.flat_map(|row| gradients.parts(row));
        let longest = parts.map(|(_, part)| part.z.abs()).fold(0.0, f64::max);
        // a cam at rest has a slope of rounding errors
        if longest > 1e-12 { longest } else { 1.0 }
    }

    /// `-C_t = f'(t)`: what `C_q qd` must be.
    pub fn target_rates(&self, t: f64) -> DVector<f64> {
        DVector::from_iterator(self.len(), self.iter().map(|constraint| constraint.target.at(t).first))
    }

    /// `F_c`: what `C_q qdd` must be.
    pub fn acceleration_side(&self, t: f64, q: &impl Positions, v: &DVector<f64>) -> DVector<f64> {
        let sides = self.iter().map(|constraint| constraint.target.at(t).second - constraint.curvature(q, v));
        DVector::from_iterator(self.len(), sides)
    }

    /// Largest violation of positions (m, rad) and velocities (m/s, rad/s).
    pub fn violation(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>) -> f64 {
        self.violations(t, q, v).into_iter().max_by(f64::total_cmp).unwrap_or(0.0)
    }

    /// Checks that a state meets the constraints: no violation exceeds [`CONSTRAINT_TOLERANCE`] or, if that is more,
    /// the fraction [`CONSTRAINT_ROUNDING`] of the largest coordinate or velocity.
    ///
    /// # Errors
    /// Which constraint is violated, and by how much.
    pub fn check(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>) -> Result<(), MotionError> {
        let bound = CONSTRAINT_TOLERANCE.max(CONSTRAINT_ROUNDING * q.amax().max(v.amax()));
        let mut violations = self.iter().zip(self.violations(t, q, v));
        match violations.find(|(_, violation)| violation.is_nan() || *violation > bound) {
            None => Ok(()),
            Some((Constraint { owner, .. }, violation)) => {
                let message =
                    format!("`{owner}` is violated by {violation:.1e} at t = {t} s, expected at most {bound:.1e}");
                Err(MotionError::of(owner, MotionCause::Inconsistent, message))
            }
        }
    }

    /// Violation of each constraint, in its position or its velocity, whichever is larger.
    fn violations(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>) -> Vec<f64> {
        let q = &TurnedBodies::new(q);
        let (positions, rates) = (self.residual(t, q), self.gradients(q).along(v) - self.target_rates(t));
        let larger = positions.iter().zip(&rates).map(|(position, rate)| {
            if position.abs().total_cmp(&rate.abs()).is_gt() { position.abs() } else { rate.abs() }
        });
        larger.collect()
    }

    /// Corrects `q` by Newton's method with the smallest corrections, `dq = -C_q^T (C_q C_q^T)^-1 C`, until rounding is
    /// all that is left. For a `q` that is close; where the Jacobian loses rank this fails.
    ///
    /// # Errors
    /// Which constraint stays violated.
    pub fn correct_positions(&self, t: f64, q: &mut DVector<f64>) -> Result<(), MotionError> {
        self.newton(t, q, |gradients, residual| self.least_norm(gradients, residual))
    }

    /// Like [`Constraints::correct_positions`] from a rough guess: constraints may depend on each other on the way.
    ///
    /// # Errors
    /// Which constraint stays violated.
    pub fn assemble(&self, t: f64, q: &mut DVector<f64>) -> Result<(), MotionError> {
        self.newton(t, q, |gradients, residual| {
            self.shortest(gradients, residual).or_else(|| {
                let dense = gradients.dense().transpose();
                // the decomposition panics on values that are not finite
                if !dense.iter().all(|value| value.is_finite()) {
                    return None;
                }
                let svd = dense.svd(true, true);
                svd.solve(residual, 1e-10 * svd.singular_values.amax()).ok()
            })
        })
    }

    fn newton(
        &self,
        t: f64,
        q: &mut DVector<f64>,
        solve: impl Fn(&SparseGradients, &DVector<f64>) -> Option<DVector<f64>>,
    ) -> Result<(), MotionError> {
        let mut residual = self.residual(t, &TurnedBodies::new(q));
        for _ in 0..100 {
            let scale = 1.0 + q.amax();
            if residual.amax() <= 1e-15 * scale {
                break;
            }
            let gradients = self.gradients(&TurnedBodies::new(q));
            let Some(step) = solve(&gradients, &residual) else { break };
            // turning a body of a kilometre by a radian moves its end by a kilometre
            let length = self.lever_arm(&gradients).max(1.0);
            let Some((better, left)) = self.shortened(t, q, &step, &residual, length) else { break };
            (*q, residual) = (better, left);
        }
        if residual.amax() <= 1e-12 * (1.0 + q.amax()) {
            return Ok(());
        }
        // a residual without rows is zero
        let Some((row, gap)) = residual.iter().map(|gap| gap.abs()).enumerate().max_by(|a, b| a.1.total_cmp(&b.1))
        else {
            return Ok(());
        };
        let unit = if self[row].coordinate.is_angle() { "rad" } else { "m" };
        let (owner, gap) = (&self[row].owner, power(gap, 3));
        let message = format!("the mechanism cannot be assembled at t = {t} s: `{owner}` stays open by {gap} {unit}");
        Err(MotionError::of(owner, MotionCause::Inconsistent, message))
    }

    /// `q - step`, shortened until the constraints are less violated, lengths in parts of `length`; `None` if that does not help.
    fn shortened(
        &self,
        t: f64,
        q: &DVector<f64>,
        step: &DVector<f64>,
        residual: &DVector<f64>,
        length: f64,
    ) -> Option<(DVector<f64>, DVector<f64>)> {
        let before = self.squared_violation(residual, length);
        (0..12).find_map(|halvings| {
            let better = q - step * 0.5f64.powi(halvings);
            let left = self.residual(t, &TurnedBodies::new(&better));
            (self.squared_violation(&left, length) < before).then_some((better, left))
        })
    }

    /// Sum of the squares of a residual, lengths in parts of `length`.
    fn squared_violation(&self, residual: &DVector<f64>, length: f64) -> f64 {
        let gaps = self.iter().zip(residual.iter());
        let gaps = gaps.map(|(row, gap)| if row.coordinate.is_angle() { *gap } else { *gap / length });
        gaps.map(|gap| gap * gap).sum()
    }

    /// The velocities closest to `v` that the constraints allow.
    ///
    /// # Errors
    /// Which constraint depends on the others.
    pub fn correct_velocities(&self, t: f64, q: &DVector<f64>, v: &mut DVector<f64>) -> Result<(), MotionError> {
        if self.is_empty() {
            return Ok(());
        }
        let gradients = self.gradients(&TurnedBodies::new(q));
        if let Some(error) = self.undefined_motion(t) {
            return Err(error);
        }
        // the second pass removes the rounding of the first
        for _ in 0..2 {
            let error = gradients.along(v) - self.target_rates(t);
            *v -= self.least_norm(&gradients, &error).ok_or_else(|| self.singular(t, &gradients))?;
        }
        Ok(())
    }

    /// The shortest `x` with `C_q x = b`, also where constraints are close to dependent.
    fn least_norm(&self, gradients: &SparseGradients, b: &DVector<f64>) -> Option<DVector<f64>> {
        self.shortest(gradients, b).or_else(|| least_norm(&gradients.dense(), b))
    }

    /// `x = C_q^T (C_q C_q^T)^-1 b`; `None` if constraints are close to dependent.
    fn shortest(&self, gradients: &SparseGradients, b: &DVector<f64>) -> Option<DVector<f64>> {
        let factors = self.elimination(gradients).factorise(gradients, |_| Vector3::repeat(1.0))?;
        Some(gradients.sum(&factors.solve(b)))
    }

    /// The error of a driver without a finite motion, rate or acceleration.
    pub fn undefined_motion(&self, t: f64) -> Option<MotionError> {
        let undefined = self.iter().find(|constraint| {
            let Jet { value, first, second } = constraint.target.at(t);
            ![value, first, second].iter().all(|x| x.is_finite())
        })?;
        let owner = &undefined.owner;
        let message = format!("the motion of `{owner}` or a derivative of it is not finite at t = {t:.6} s");
        Some(MotionError::of(owner, MotionCause::Undefined, message))
    }

    /// The first constraint that depends on those before it, by Gram-Schmidt in the order of the description.
    pub fn first_dependent(&self, gradients: &SparseGradients) -> Option<&Constraint> {
        // safe pivots are far from dependence
        if self.elimination(gradients).factorise(gradients, |_| Vector3::repeat(1.0)).is_some() {
            return None;
        }
        let mut constraints = self.iter().zip(independence(&gradients.dense()));
        constraints.find(|(_, independent)| *independent <= DEPENDENT).map(|(constraint, _)| constraint)
    }

    /// The error of the constraint that depends most on those before it.
    pub fn singular(&self, t: f64, gradients: &SparseGradients) -> MotionError {
        let worst = self.iter().zip(independence(&gradients.dense())).min_by(|a, b| a.1.total_cmp(&b.1));
        // without constraints nothing is singular
        let owner = worst.map_or("", |(constraint, _)| constraint.owner.as_str());
        let message = format!("singular position at t = {t} s: `{owner}` depends on the other constraints there");
        MotionError::of(owner, MotionCause::Singular, message)
    }
}

/// For each column the fraction of it that is outside the span of the columns before it, between 0 and 1.
pub(super) fn independence(columns: &DMatrix<f64>) -> Vec<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let mut parts = Vec::new();
    for column in columns.column_iter() {
        let (mut rest, norm) = (column.into_owned(), column.norm());
        // twice is enough (Kahan, Parlett)
        for _ in 0..2 {
            for direction in &basis {
                rest -= direction * direction.dot(&rest);
            }
        }
        let part = rest.norm() / norm;
        parts.push(if part.is_nan() { 0.0 } else { part });
        if part > DEPENDENT {
            basis.push(rest.normalize());
        }
    }
    parts
}

/// Orthonormal vectors `x` with `A x = 0`.
pub(super) fn null_space(matrix: &DMatrix<f64>) -> Vec<DVector<f64>> {
    let (rows, columns) = matrix.shape();
    // with as many rows as columns the decomposition has all of them
    let square = matrix.clone().resize_vertically(rows.max(columns), 0.0);
    // the decomposition panics on values that are not finite
    if !square.iter().all(|value| value.is_finite()) {
        return Vec::new();
    }
    let svd = square.svd(false, true);
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    let vectors = svd.v_t.iter().flat_map(DMatrix::row_iter).zip(&svd.singular_values);
    vectors.filter(|(_, value)| **value <= DEPENDENT * largest).map(|(vector, _)| vector.transpose()).collect()
}

/// The shortest `x` with `A x = b`, given `A^T` of full column rank: `A^T = Q R`, `x = Q R^-T b`.
fn least_norm(transposed: &DMatrix<f64>, b: &DVector<f64>) -> Option<DVector<f64>> {
    if transposed.ncols() > transposed.nrows() {
        return None;
    }
    let qr = transposed.clone().qr();
    let y = qr.r().tr_solve_upper_triangular(b)?;
    y.iter().all(|value| value.is_finite()).then(|| qr.q() * y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_norm_solves_and_is_shortest() {
        let transposed = DMatrix::from_column_slice(3, 2, &[1.0, 2.0, -1.0, 0.5, 0.0, 3.0]);
        let b = DVector::from_vec(vec![0.7, -1.1]);
        let x = least_norm(&transposed, &b).unwrap();
        assert!((transposed.tr_mul(&x) - &b).amax() < 1e-15);
        // the null space of a 2 x 3 matrix is the cross product of its rows
        let null = transposed.column(0).cross(&transposed.column(1));
        assert!(null.dot(&x).abs() < 1e-15);
    }

    #[test]
    fn independence_is_the_sine_of_the_angle_to_the_columns_before() {
        let columns = DMatrix::from_column_slice(2, 3, &[2.0, 0.0, 3.0, 3.0, 1.0, -5.0]);
        let parts = independence(&columns);
        assert!((parts[0] - 1.0).abs() < 1e-15 && (parts[1] - 0.5f64.sqrt()).abs() < 1e-15 && parts[2] < 1e-15);
    }
}
