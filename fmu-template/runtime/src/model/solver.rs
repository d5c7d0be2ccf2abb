//! Integration of a model's states over a communication step.

use crate::Domain;
use std::ops::Range;

/// Why a step of the solver was not made; the states are as before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepError {
    /// After so many seconds a state is not finite: the mass matrix is not positive definite there, or the motion diverged.
    NotFinite {
        /// Since the beginning of the step.
        after: f64,
    },
    /// More steps of the solver than [`MAX_SOLVER_STEPS`].
    TooManySteps,
}

/// Steps of the solver in one communication step at most.
pub const MAX_SOLVER_STEPS: f64 = 1e7;

/// Stages of the adaptive method.
const STAGES: usize = 7;

/// How inputs go on during a step, and what is clamped on the way.
#[derive(Clone, Copy, Debug)]
pub struct Drive<'a> {
    /// First and second derivative of each input column with respect to time at the beginning of the step.
    pub rates: [&'a [f64]; 2],
    /// Where inputs are clamped to, if they are.
    pub clamp: Option<&'a Domain>,
}

/// A Runge-Kutta method: each stage's time and its weights of the stages before; the weights of the result.
struct Tableau {
    stages: &'static [(f64, &'static [f64])],
    result: &'static [f64],
}

/// The classical method of order 4.
const CLASSICAL: Tableau = Tableau {
    stages: &[(0.0, &[]), (0.5, &[0.5]), (0.5, &[0.0, 0.5]), (1.0, &[0.0, 0.0, 1.0])],
    result: &[1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0],
};

/// Dormand, Prince (1980): order 5 with an embedded method of order 4.
const DORMAND_PRINCE: Tableau = Tableau {
    stages: &[
        (0.0, &[]),
        (0.2, &[0.2]),
        (0.3, &[3.0 / 40.0, 9.0 / 40.0]),
        (0.8, &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0]),
        (8.0 / 9.0, &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0]),
        (1.0, &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0]),
        (1.0, &DORMAND_PRINCE_RESULT),
    ],
    result: &DORMAND_PRINCE_RESULT,
};
const DORMAND_PRINCE_RESULT: [f64; 6] =
    [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0];
/// Result of order 5 minus that of order 4.
const DORMAND_PRINCE_ERROR: [f64; 7] =
    [71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339_200.0, 22.0 / 525.0, -1.0 / 40.0];

/// Working memory of the integration of one point at a time.
#[derive(Clone, Debug)]
pub(super) struct Solver {
    inputs: Range<usize>,
    states: Range<usize>,
    /// The states before the step.
    before: Vec<f64>,
    /// Columns at a stage, and the rates of the states at each stage.
    stage: Vec<f64>,
    rates: Vec<Vec<f64>>,
}

impl Solver {
    /// For points whose last columns are the states, and those before them the inputs.
    pub(super) fn new(columns: usize, inputs: usize, states: usize) -> Self {
        let first = columns - states;
        Self {
            inputs: first - inputs..first,
            states: first..columns,
            before: vec![0.0; states],
            stage: vec![0.0; columns],
            rates: vec![vec![0.0; states]; STAGES],
        }
    }

    /// Integrates the states of `point` over `size` seconds: in equal steps of the classical Runge-Kutta method, none longer than
    /// `longest`, or, with a tolerance, in steps of the method of Dormand and Prince, whose local error is at most the tolerance
    /// relative to each state's magnitude and to `nominals`. `respond` gives the rates of the states at a point. Does not allocate.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    pub(super) fn advance(
        &mut self,
        point: &mut [f64],
        longest: f64,
        (size, tolerance, nominals): (f64, Option<f64>, &[f64]),
        drive: Drive,
        respond: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<(), StepError> {
        self.before.copy_from_slice(&point[self.states.clone()]);
        let result = match tolerance {
            None => self.fixed(point, (size, longest), drive, respond),
            Some(tolerance) => self.adaptive(point, (size, longest), (tolerance, nominals), drive, respond),
        };
        if result.is_err() {
            point[self.states.clone()].copy_from_slice(&self.before);
        }
        result
    }

    fn fixed(
        &mut self,
        point: &mut [f64],
        (size, longest): (f64, f64),
        drive: Drive,
        mut respond: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<(), StepError> {
        // rounding of the size does not cost a step
        let steps = (size / longest * (1.0 - 1e-9)).ceil().max(1.0);
        if steps > MAX_SOLVER_STEPS {
            return Err(StepError::TooManySteps);
        }
        let h = size / steps;
        for step in 0..steps as u32 {
            let since = f64::from(step) * h;
            self.stages(&CLASSICAL, point, (since, h), drive, &mut respond);
            for (k, state) in point[self.states.clone()].iter_mut().enumerate() {
                *state += h * weighted(CLASSICAL.result, &self.rates, k);
            }
            expect_finite_states(&point[self.states.clone()], since + h)?;
        }
        Ok(())
    }

    fn adaptive(
        &mut self,
        point: &mut [f64],
        (size, longest): (f64, f64),
        (tolerance, nominals): (f64, &[f64]),
        drive: Drive,
        mut respond: impl FnMut(&[f64], &mut [f64]),
    ) -> Result<(), StepError> {
        let (mut since, mut h) = (0.0, size.min(longest));
        let mut steps = 0.0;
        // what is left by rounding is no step
        while size - since > 1e-14 * size {
            steps += 1.0;
            if steps > MAX_SOLVER_STEPS {
                return Err(StepError::TooManySteps);
            }
            let rest = size - since;
            // no sliver at the end
            h = if h > 0.99 * rest { rest } else { h.min(0.5 * rest) };
            self.stages(&DORMAND_PRINCE, point, (since, h), drive, &mut respond);
            let states = &mut point[self.states.clone()];
            let mut error = 0.0f64;
            for (k, state) in states.iter().enumerate() {
                let scale = tolerance * state.abs().max(nominals[k]);
                let found = (h * weighted(&DORMAND_PRINCE_ERROR, &self.rates, k)).abs() / scale;
                // a maximum would leave out what is not a number
                error = if found > error || found.is_nan() { found } else { error };
            }
            if error <= 1.0 {
                for (k, state) in states.iter_mut().enumerate() {
                    *state += h * weighted(DORMAND_PRINCE.result, &self.rates, k);
                }
                since += h;
                expect_finite_states(states, since)?;
            }
            // nan: the shortest
            let factor = if error.is_nan() { 0.1 } else { (0.9 * error.max(1e-10).powf(-0.2)).clamp(0.1, 5.0) };
            h *= factor;
            if h < 1e-14 * size {
                return Err(StepError::NotFinite { after: since });
            }
        }
        Ok(())
    }

    /// Rates of the states at the stages of a step of size `h`, `since` seconds after the beginning.
    fn stages(
        &mut self,
        tableau: &Tableau,
        point: &[f64],
        (since, h): (f64, f64),
        drive: Drive,
        respond: &mut impl FnMut(&[f64], &mut [f64]),
    ) {
        let Self { inputs, states, stage, rates, .. } = self;
        stage.copy_from_slice(point);
        for (index, (time, weights)) in tableau.stages.iter().enumerate() {
            let later = since + time * h;
            for column in inputs.clone() {
                let value = point[column] + later * (drive.rates[0][column] + 0.5 * later * drive.rates[1][column]);
                stage[column] = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
            }
            for (k, column) in states.clone().enumerate() {
                stage[column] = point[column] + h * weighted(weights, rates, k);
            }
            respond(stage, &mut rates[index]);
        }
    }
}

fn weighted(weights: &[f64], rates: &[Vec<f64>], state: usize) -> f64 {
    weights.iter().zip(rates).map(|(weight, rates)| weight * rates[state]).sum()
}

fn expect_finite_states(states: &[f64], after: f64) -> Result<(), StepError> {
    if states.iter().all(|state| state.is_finite()) { Ok(()) } else { Err(StepError::NotFinite { after }) }
}
