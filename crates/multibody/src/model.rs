//! A mechanism with numbers in it: mass matrix, applied forces and constraints of one run.

use super::{
    constraint::{BoundExpression, Constraints, null_space},
    coordinate::{Coordinate, Positions},
    description::FormulationKind,
    error::{MotionCause, MotionError},
    gradients::SparseGradients,
};
use crate::signal::Signal;
use nalgebra::{DMatrix, DVector, Vector2};

/// A spring and damper along a coordinate: effort `-stiffness (s - rest) - damping sd`.
#[derive(Clone, Debug)]
pub struct Spring {
    /// The coordinate `s`.
    pub coordinate: Coordinate,
    /// In N/m or N.m/rad.
    pub stiffness: f64,
    /// In N.s/m or N.m.s/rad.
    pub damping: f64,
    /// Where there is no force.
    pub rest: f64,
    /// The effort that acts beside these, by its position in the model.
    pub further: Option<usize>,
    /// Its key in the description, for messages: `springs.A`.
    pub owner: String,
}

impl Spring {
    /// Force or torque of stiffness and damping that acts to increase the coordinate.
    pub fn effort(&self, q: &impl Positions, v: &DVector<f64>) -> f64 {
        // a distance of zero has no rate
        let damping = if self.damping == 0.0 { 0.0 } else { self.damping * self.coordinate.rate(q, v) };
        -self.stiffness * (self.coordinate.value(q) - self.rest) - damping
    }
}

/// A force or torque along a coordinate: an actuator, or a component of a force at a point.
#[derive(Clone, Debug)]
pub struct Effort {
    /// The coordinate.
    pub coordinate: Coordinate,
    /// Force or torque that acts to increase it.
    pub expression: BoundExpression,
    /// Its key in the description, for messages: `actuators.A`.
    pub owner: String,
}

/// A driver that gives the acceleration of a coordinate, whose position and velocity are free at the start.
#[derive(Clone, Debug)]
pub struct Prescribed {
    /// The coordinate.
    pub coordinate: Coordinate,
    /// Its second derivative, in m/s² or rad/s².
    pub expression: BoundExpression,
    /// The coordinate's name in the description, for messages.
    pub name: String,
    /// Its key in the description, for messages: `drivers.A`.
    pub owner: String,
}

/// A state of an actuator or a controller: `zd` is an expression.
#[derive(Clone, Debug)]
pub struct ActuatorState {
    /// Its derivative with respect to time.
    pub rate: BoundExpression,
    /// Its value at the start.
    pub start: f64,
    /// Its key in the description, for messages: `states.A`.
    pub owner: String,
}

/// An expression that an output shows.
#[derive(Clone, Debug)]
pub struct OutputFormula {
    /// The expression.
    pub expression: BoundExpression,
    /// Its unit in the description.
    pub unit: String,
}

/// Input that acts on the mechanism while it runs.
#[derive(Clone, Debug)]
pub struct MultibodyInput {
    /// Its name in the description.
    pub name: String,
    /// Its range there.
    pub range: [f64; 2],
    /// Its value in the course of a run.
    pub signal: Signal,
}

/// All of a run but its time: coordinates `(x, y, phi)` of each body one after the other. Functions of a state take the values `u` of the
/// inputs, and after them those of the actuator states, as [`at`](Self::at) joins them.
#[derive(Clone, Debug)]
pub struct MultibodyModel {
    /// How the equations of motion are solved.
    pub formulation: FormulationKind,
    /// Relative and absolute tolerance of the integration.
    pub tolerance: f64,
    /// Diagonal of the mass matrix: mass, mass, moment of inertia about the centre of mass of each body.
    pub mass: DVector<f64>,
    /// Acceleration of gravity.
    pub gravity: Vector2<f64>,
    /// Joints, then drivers of motions.
    pub constraints: Constraints,
    /// Drivers of accelerations; their multipliers follow those of the constraints.
    pub prescribed: Vec<Prescribed>,
    /// The constraints, then the coordinates whose accelerations are prescribed, as constraints that hold still: all that decides
    /// accelerations. For gradients and names.
    pub deciding: Constraints,
    /// Constraints that follow from the others.
    pub redundant: Constraints,
    /// Springs and dampers.
    pub springs: Vec<Spring>,
    /// Forces at points and actuators.
    pub efforts: Vec<Effort>,
    /// Inputs that act on the mechanism.
    pub inputs: Vec<MultibodyInput>,
    /// States of actuators and controllers.
    pub actuator_states: Vec<ActuatorState>,
    /// Expressions that outputs show.
    pub formulas: Vec<OutputFormula>,
    /// Guess of the coordinates at the start.
    pub position_guess: DVector<f64>,
    /// Guess of the velocities at the start.
    pub velocity_guess: DVector<f64>,
    /// Coordinates at the start.
    pub initial_positions: Constraints,
    /// Velocities at the start.
    pub initial_velocities: Constraints,
    /// True if positions at the start are those of a static equilibrium.
    pub starts_in_equilibrium: bool,
}

impl MultibodyModel {
    /// Makes sure that a state is a row of a run, as [`Constraints::check`], redundant constraints included.
    ///
    /// # Errors
    /// Which constraint is violated, and by how much.
    pub fn check(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>) -> Result<(), MotionError> {
        self.constraints.check(t, q, v)?;
        self.redundant.check(t, q, v)
    }

    /// Values `u`: those of the inputs at a time of the run, then the actuator states `z`.
    pub fn at(&self, t: f64, z: &[f64]) -> Vec<f64> {
        self.inputs.iter().map(|input| input.signal.value(t)).chain(z.iter().copied()).collect()
    }

    /// Values of the actuator states at the start.
    pub fn actuator_starts(&self) -> Vec<f64> {
        self.actuator_states.iter().map(|state| state.start).collect()
    }

    /// Derivatives of the actuator states with respect to time.
    pub fn actuator_rates(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> Vec<f64> {
        self.actuator_states.iter().map(|state| state.rate.value(t, q, v, u)).collect()
    }

    /// `F_a(t, q, qd, u)`: gravity, springs and efforts. With the centres of mass as coordinates there are no
    /// velocity terms of inertia.
    pub fn applied_forces(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> DVector<f64> {
        let mut sum = self.weights();
        for spring in &self.springs {
            spring.coordinate.add_gradient(q, spring.effort(q, v), sum.as_mut_slice());
        }
        for effort in &self.efforts {
            effort.coordinate.add_gradient(q, effort.expression.value(t, q, v, u), sum.as_mut_slice());
        }
        sum
    }

    /// The forces of gravity and springs at rest, which are those of the potential energy.
    pub fn potential_forces(&self, q: &DVector<f64>) -> DVector<f64> {
        let (mut sum, rest) = (self.weights(), DVector::zeros(q.len()));
        for spring in &self.springs {
            spring.coordinate.add_gradient(q, spring.effort(q, &rest), sum.as_mut_slice());
        }
        sum
    }

    /// Gradients of the coordinates of the efforts, `s_q`: one a column.
    pub fn effort_gradients(&self, q: &DVector<f64>) -> DMatrix<f64> {
        let mut gradients = DMatrix::zeros(q.len(), self.efforts.len());
        for (effort, mut column) in self.efforts.iter().zip(gradients.column_iter_mut()) {
            effort.coordinate.add_gradient(q, 1.0, column.as_mut_slice());
        }
        gradients
    }

    /// Forces of the springs' damping for each column of velocities: shape `[coordinates, columns]`.
    pub fn damping_forces(&self, q: &DVector<f64>, velocities: &DMatrix<f64>) -> DMatrix<f64> {
        let mut forces = DMatrix::zeros(q.len(), velocities.ncols());
        for spring in self.springs.iter().filter(|spring| spring.damping != 0.0) {
            let mut gradient = DVector::zeros(q.len());
            spring.coordinate.add_gradient(q, 1.0, gradient.as_mut_slice());
            forces -= spring.damping * &gradient * velocities.tr_mul(&gradient).transpose();
        }
        forces
    }

    /// Every effort, every prescribed acceleration, then the rate of every actuator state, with its key.
    pub fn acting_expressions(&self) -> impl Iterator<Item = (&BoundExpression, &str)> {
        let efforts = self.efforts.iter().map(|effort| (&effort.expression, effort.owner.as_str()));
        let drivers = self.prescribed.iter().map(|driver| (&driver.expression, driver.owner.as_str()));
        efforts.chain(drivers).chain(self.actuator_states.iter().map(|state| (&state.rate, state.owner.as_str())))
    }

    /// Expressions that are efforts of learned equations: efforts, prescribed accelerations, formulas of outputs, rates of actuator states.
    pub fn known_expressions(&self) -> impl Iterator<Item = &BoundExpression> {
        let efforts = self.efforts.iter().map(|effort| &effort.expression);
        let drivers = self.prescribed.iter().map(|driver| &driver.expression);
        let formulas = self.formulas.iter().map(|formula| &formula.expression);
        efforts.chain(drivers).chain(formulas).chain(self.actuator_states.iter().map(|state| &state.rate))
    }

    fn weights(&self) -> DVector<f64> {
        let mut sum = DVector::zeros(self.mass.len());
        for (force, mass) in sum.as_mut_slice().chunks_mut(3).zip(self.mass.as_slice().chunks(3)) {
            force[0] = mass[0] * self.gravity.x;
            force[1] = mass[1] * self.gravity.y;
        }
        sum
    }

    /// The error of the first effort that is not finite in a state: the square root of a negative number, for instance.
    pub fn undefined_force(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>, u: &[f64]) -> Option<MotionError> {
        let error = self.undefined_effort(t, q, v, u)?;
        let message = format!("{error} at t = {t} s, expected a finite number");
        Some(error.with_message(message))
    }

    /// The first effort, prescribed acceleration or rate of an actuator state that is not finite in a state, and its value; or a spring
    /// whose length is zero.
    pub fn undefined_effort(&self, t: f64, q: &DVector<f64>, v: &DVector<f64>, u: &[f64]) -> Option<MotionError> {
        let mut without_length = self.springs.iter().filter(|spring| {
            spring.coordinate.direction(q).is_some_and(|direction| direction.norm() == 0.0)
                && spring.effort(q, v) != 0.0
        });
        if let Some(spring) = without_length.next() {
            let message = format!("the direction of `{}` is not defined: its length is zero", spring.owner);
            return Some(MotionError::of(&spring.owner, MotionCause::Undefined, message));
        }
        self.acting_expressions().find_map(|(bound, owner)| {
            let value = bound.value(t, q, v, u);
            if value.is_finite() {
                return None;
            }
            let message = format!("`{}` of `{owner}` is {value}", bound.text);
            Some(MotionError::of(owner, MotionCause::Undefined, message))
        })
    }

    /// `qd^T M qd / 2`, in J.
    pub fn kinetic_energy(&self, v: &DVector<f64>) -> f64 {
        0.5 * self.mass.component_mul(v).dot(v)
    }

    /// Potential energy of gravity, zero at the ground's origin, and of the springs, in J.
    pub fn potential_energy(&self, q: &DVector<f64>) -> f64 {
        let bodies = q.as_slice().chunks(3).zip(self.mass.as_slice().chunks(3));
        let height: f64 = bodies.map(|(q, mass)| -mass[0] * (self.gravity.x * q[0] + self.gravity.y * q[1])).sum();
        let springs = self.springs.iter();
        let stretch = springs.map(|spring| 0.5 * spring.stiffness * (spring.coordinate.value(q) - spring.rest).powi(2));
        height + stretch.sum::<f64>()
    }

    /// Right-hand side of the equations that [`Self::deciding`] sets for accelerations: `F_c`, then `a - (s_q qd)_q qd` with a prescribed
    /// acceleration `a`.
    pub fn deciding_side(&self, t: f64, q: &impl Positions, v: &DVector<f64>, u: &[f64]) -> DVector<f64> {
        let of_constraints = self.constraints.acceleration_side(t, q, v);
        if self.prescribed.is_empty() {
            return of_constraints;
        }
        let prescribed = self.prescribed.iter();
        let of_drivers =
            prescribed.map(|driver| driver.expression.value(t, q, v, u) - driver.coordinate.curvature(q, v));
        let sides = of_constraints.iter().copied().chain(of_drivers);
        DVector::from_iterator(of_constraints.len() + self.prescribed.len(), sides)
    }

    /// A length that makes angles comparable with lengths: the longest lever arm of the constraints, or the longest radius of gyration.
    /// Lever arms alone vanish where a body passes the pivot that it turns about.
    pub fn length(&self, gradients: &SparseGradients) -> f64 {
        let bodies = self.mass.as_slice().chunks(3);
        let radii = bodies.map(|mass| if mass[0] > 0.0 { (mass[2] / mass[0]).sqrt() } else { 0.0 });
        let longest = radii.fold(0.0, f64::max);
        self.constraints.lever_arm(gradients).max(longest)
    }

    /// The coordinate of a multiplier.
    pub fn held_coordinate(&self, row: usize) -> &Coordinate {
        let first = self.constraints.len();
        if row < first { &self.constraints[row].coordinate } else { &self.prescribed[row - first].coordinate }
    }

    /// For each independent motion that the constraints and drivers allow and neither mass nor inertia resists, the coordinate that
    /// moves most: the null space of their gradients and of the coordinates with mass.
    pub fn motions_without_inertia(&self, q: &DVector<f64>) -> Vec<usize> {
        let gradients = self.deciding.gradients(q).dense();
        let (n, m) = gradients.shape();
        let mut rows = DMatrix::zeros(n + m, n);
        for (index, gradient) in gradients.column_iter().enumerate() {
            rows.row_mut(index).tr_copy_from(&(gradient / gradient.norm()));
        }
        for (coordinate, _) in self.mass.iter().enumerate().filter(|(_, mass)| **mass > 0.0) {
            rows[(m + coordinate, coordinate)] = 1.0;
        }
        let mut found: Vec<usize> = null_space(&rows).iter().map(DVector::iamax).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// Number of coordinates that the constraints leave free, those included whose accelerations are prescribed.
    pub fn degrees_of_freedom(&self) -> usize {
        self.mass.len().saturating_sub(self.constraints.len())
    }
}

/// Everything about a model at one time.
#[derive(Clone, Debug)]
pub struct Sample {
    /// Time in s.
    pub t: f64,
    /// Coordinates.
    pub q: DVector<f64>,
    /// Velocities.
    pub v: DVector<f64>,
    /// Values of the inputs, then of the actuator states.
    pub u: Vec<f64>,
    /// Accelerations.
    pub qdd: DVector<f64>,
    /// Lagrange multipliers of the constraints, then of the prescribed accelerations.
    pub multipliers: DVector<f64>,
}

impl Sample {
    /// Values of the actuator states.
    pub fn actuator_states(&self, model: &MultibodyModel) -> &[f64] {
        &self.u[model.inputs.len()..]
    }
}
