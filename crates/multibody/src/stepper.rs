//! A mechanism that is simulated step by step, its inputs held over each.

use super::{
    Mechanism,
    build::motions,
    error::{MotionCause, MotionError},
    measure::Measure,
    model::{MultibodyModel, Sample},
    simulate::{continue_from, simulate},
};
use crate::{
    integrate::{Budget, TOLERANCE, method::MethodChoice},
    signal::Signal,
};

/// A mechanism at a time.
#[derive(Debug)]
pub struct Stepper {
    model: MultibodyModel,
    measures: Vec<Measure>,
    now: Sample,
    choice: MethodChoice,
}

impl Mechanism {
    /// The mechanism at the beginning of a run: a value for each parameter and for each input, the time and the tolerance of the
    /// integration.
    ///
    /// # Errors
    /// An error that says what cannot be built or assembled.
    pub fn stepper(&self, values: &[f64], inputs: &[f64], time: f64, tolerance: f64) -> Result<Stepper, MotionError> {
        let (mut model, measures) = self.build(values)?;
        model.tolerance = tolerance;
        hold(&mut model, inputs);
        let now = last(simulate(&model, &[time], &Budget::default())?)?;
        Ok(Stepper { model, measures, now, choice: MethodChoice::default() })
    }

    /// Positions and velocities of all joints and bodies at the beginning of a run, by the names of their measures.
    ///
    /// # Errors
    /// As [`Mechanism::stepper`].
    pub fn state_at_start(&self, values: &[f64], time: f64) -> Result<Vec<(String, f64)>, MotionError> {
        let inputs: Vec<f64> = self.inputs().values().map(|input| input.start).collect();
        let Stepper { model, now, .. } = self.stepper(values, &inputs, time, TOLERANCE)?;
        let measures = motions(self.description(), values).into_iter();
        Ok(measures.map(|(name, measure)| (name, measure.value(&model, &now))).collect())
    }
}

impl Stepper {
    /// Sets the inputs from now on, one value for each.
    ///
    /// # Errors
    /// As [`Mechanism::simulate`].
    ///
    /// # Panics
    /// If there are more or fewer values than inputs.
    pub fn set_inputs(&mut self, values: &[f64]) -> Result<(), MotionError> {
        hold(&mut self.model, values);
        // accelerations and reactions follow at once
        self.go_on(&[self.now.t])
    }

    /// Advances to a later time.
    ///
    /// # Errors
    /// As [`Mechanism::simulate`].
    pub fn advance(&mut self, to: f64) -> Result<(), MotionError> {
        self.go_on(&[self.now.t, to])
    }

    fn go_on(&mut self, times: &[f64]) -> Result<(), MotionError> {
        let state = (self.now.q.clone(), self.now.v.clone(), self.now.actuator_states(&self.model).to_vec());
        self.now = last(continue_from(&self.model, state, times, &Budget::default(), &mut self.choice)?)?;
        Ok(())
    }

    /// The outputs, in the order of the file.
    pub fn outputs(&self) -> Vec<f64> {
        self.measures.iter().map(|measure| measure.value(&self.model, &self.now)).collect()
    }
}

fn hold(model: &mut MultibodyModel, values: &[f64]) {
    assert_eq!(values.len(), model.inputs.len(), "a value for each input");
    model.inputs.iter_mut().zip(values).for_each(|(input, value)| input.signal = Signal::Constant(*value));
}

fn last(samples: Vec<Sample>) -> Result<Sample, MotionError> {
    samples.into_iter().last().ok_or_else(|| MotionError::new(MotionCause::Unsolved, "it has no state"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::Knots;

    #[test]
    fn steps_with_held_inputs_are_a_run_with_signals_that_jump() {
        let path = format!("{}/../../examples/dynamics/crane.toml", env!("CARGO_MANIFEST_DIR"));
        let mechanism = Mechanism::load(path.as_ref()).unwrap();
        let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
        let mut stepper = mechanism.stepper(&values, &[0.0], 0.0, 1e-12).unwrap();
        let forces = [3.0, -5.0, 0.0, 8.0];
        let rows: Vec<f64> = (0..=forces.len()).map(|row| row as f64 * 0.2).collect();
        let signal = Signal::Held(Knots::new(rows[..forces.len()].to_vec(), forces.to_vec()).unwrap());
        let expected = mechanism.simulate_driven(&values, &[signal], &rows, 1e-12, &Budget::default()).unwrap();
        for (step, force) in forces.iter().enumerate() {
            stepper.set_inputs(&[*force]).unwrap();
            stepper.advance(rows[step + 1]).unwrap();
            for (found, expected) in stepper.outputs().iter().zip(&expected[2 * (step + 1)..]) {
                assert!((found - expected).abs() < 1e-9, "{found} {expected}");
            }
        }
    }

    #[test]
    fn the_state_at_the_start_goes_by_the_parameters() {
        let path = format!("{}/../../examples/dynamics/crane.toml", env!("CARGO_MANIFEST_DIR"));
        let mechanism = Mechanism::load(path.as_ref()).unwrap();
        let start = mechanism.state_at_start(&[1.5, 1.0, 0.0, -0.7, 0.2], 0.0).unwrap();
        let value = |name: &str| start.iter().find(|(known, _)| known == name).unwrap().1;
        for (name, expected) in
            [("rail.position", -0.7), ("rope.angle", 0.2), ("rail.velocity", 0.0), ("rope.angular_velocity", 0.0)]
        {
            assert!((value(name) - expected).abs() < 1e-12, "{name}");
        }
    }
}
