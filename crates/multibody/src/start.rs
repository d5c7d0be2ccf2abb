//! State of a mechanism at the start of a run.

use super::{
    constraint::Constraints,
    equilibrium,
    error::{MotionCause, MotionError},
    model::MultibodyModel,
};
use nalgebra::DVector;

impl MultibodyModel {
    /// Coordinates and velocities at the start: the guesses, corrected so that all constraints and initial conditions hold.
    ///
    /// # Errors
    /// Which joint cannot be closed, which constraint is redundant, which initial condition contradicts; no static equilibrium is found.
    pub fn initial_state(&self, t: f64) -> Result<(DVector<f64>, DVector<f64>), MotionError> {
        let (mut q, mut v) = (self.position_guess.clone(), self.velocity_guess.clone());
        let [positions, velocities] = [&self.initial_positions, &self.initial_velocities]
            .map(|conditions| -> Constraints { self.constraints.iter().chain(&**conditions).cloned().collect() });
        positions.assemble(t, &mut q)?;
        if let Some(constraint) = self.deciding.first_dependent(&self.deciding.gradients(&q)) {
            let owner = &constraint.owner;
            let message = format!(
                "`{owner}` depends on the joints and drivers before it: it is redundant, or the mechanism starts in a singular \
                 position"
            );
            return Err(MotionError::of(owner, MotionCause::Singular, message));
        }
        for conditions in [&positions, &velocities] {
            if let Some(condition) = conditions.first_dependent(&conditions.gradients(&q)) {
                let owner = &condition.owner;
                let message = format!("`{owner}` is decided by the constraints and conditions before it");
                return Err(MotionError::of(owner, MotionCause::Inconsistent, message));
            }
        }
        if self.starts_in_equilibrium {
            equilibrium::settle(self, t, &positions, &mut q)?;
        }
        velocities.correct_velocities(t, &q, &mut v)?;
        Ok((q, v))
    }
}
