//! Integration of a program's states over a communication step.

mod rosenbrock;

use crate::{
    Domain, FormatError, State, TOLERANCE,
    bends::{ArgumentPath, BentArgument, StepOverBends, step_over},
};
use rosenbrock::Rosenbrock;
use std::ops::Range;

/// Integration of the states of a program over a communication step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Integration {
    /// The method of Dormand and Prince, order 5, which estimates the error of each step.
    ErrorControlled {
        /// Largest error of a step, relative to each state's [`Scale`].
        tolerance: f64,
        /// Longest step, in seconds, which is also the first one that is tried.
        longest: f64,
    },
    /// The method of Rosenbrock's type of order 5 by Steinebach (2023), for stiff equations: it estimates the error of each step, too.
    Implicit {
        /// Largest error of a step, relative to each state's [`Scale`].
        tolerance: f64,
        /// Longest step, in seconds, which is also the first one that is tried.
        longest: f64,
    },
    /// Equal steps of the classical Runge-Kutta method, order 4: the cost of a communication step is always the same.
    Fixed {
        /// Longest step, in seconds.
        step: f64,
    },
}

impl Integration {
    /// Longest step, in seconds.
    pub fn longest(self) -> f64 {
        match self {
            Self::ErrorControlled { longest, .. } | Self::Implicit { longest, .. } => longest,
            Self::Fixed { step } => step,
        }
    }

    /// Tolerance of a step; none if steps are fixed.
    pub fn tolerance(self) -> Option<f64> {
        match self {
            Self::ErrorControlled { tolerance, .. } | Self::Implicit { tolerance, .. } => Some(tolerance),
            Self::Fixed { .. } => None,
        }
    }

    /// Returns true if steps solve linear equations.
    pub fn is_implicit(self) -> bool {
        matches!(self, Self::Implicit { .. })
    }

    /// Number of equal parts, none of them longer than the longest step, of a communication step.
    pub fn parts(self, size: f64) -> f64 {
        // rounding of the size does not cost a step
        (size / self.longest() * (1.0 - 1e-9)).ceil().max(1.0)
    }

    /// Makes sure that step and tolerance are positive.
    ///
    /// # Errors
    /// A [`FormatError`].
    pub(super) fn check(self) -> Result<(), FormatError> {
        expect_step(self.longest())?;
        match self.tolerance().filter(|tolerance| !(tolerance.is_finite() && *tolerance > 0.0)) {
            Some(found) => Err(FormatError::Tolerance { found }),
            None => Ok(()),
        }
    }
}

pub(super) fn expect_step(step: f64) -> Result<(), FormatError> {
    if step.is_finite() && step > 0.0 { Ok(()) } else { Err(FormatError::TimeStep { found: step }) }
}

/// Scale of a state for errors of a step and for plausible values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// Unit of errors of a step.
    pub nominal: f64,
    /// `true` if errors are relative to the state's magnitude as well, where that is larger: for a state that has no
    /// range and is not an angle.
    pub is_relative: bool,
    /// Magnitude beyond which no value is plausible.
    pub limit: f64,
}

impl Scale {
    /// Scale of a state; `is_angle` is true if whole turns change nothing but the state itself.
    pub fn new(state: &State, is_angle: bool) -> Self {
        Self { nominal: state.nominal, is_relative: state.range.is_none() && !is_angle, limit: state.limit() }
    }

    /// Unit of errors of a step: the tolerance is relative to it.
    fn of(self, value: f64) -> f64 {
        // what rounding makes of a large value is no error of a step
        let least = if self.is_relative { value.abs() } else { f64::EPSILON * value.abs() };
        self.nominal.max(least)
    }
}

/// A communication step.
#[derive(Clone, Copy, Debug)]
pub struct CommunicationStep<'a> {
    /// In seconds.
    pub size: f64,
    /// Tolerance that the host wants: that of an integration with error control, if it is the smaller one.
    pub tolerance: Option<f64>,
    /// Derivatives of the states at the beginning, if they are known, with which an evaluation is saved.
    pub derivatives: Option<&'a [f64]>,
    /// Largest number of steps of the solver, at most [`MAX_SOLVER_STEPS`].
    pub most_steps: u32,
}

impl CommunicationStep<'_> {
    /// A communication step of `size` seconds.
    pub fn of(size: f64) -> Self {
        Self { size, tolerance: None, derivatives: None, most_steps: MAX_SOLVER_STEPS as u32 }
    }
}

/// Reasons why the solver made no step; the states are as before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepError {
    /// A state is not finite after `after` seconds: the mass matrix is not positive definite there, or the motion
    /// diverged.
    NotFinite {
        /// Since the beginning of the step.
        after: f64,
    },
    /// A state is farther from zero than its [`Scale::limit`].
    Implausible {
        /// Position among the states.
        state: usize,
        /// Value of the state.
        value: f64,
        /// Since the beginning of the step, in seconds.
        after: f64,
    },
    /// No step is short enough for the tolerance.
    Underflow {
        /// Since the beginning of the step, in seconds.
        after: f64,
    },
    /// More steps of the solver than [`CommunicationStep::most_steps`].
    TooManySteps,
}

/// Steps of the solver in one communication step at most.
pub const MAX_SOLVER_STEPS: f64 = 1e7;

/// Part of a communication step that no step of the solver is shorter than.
const SHORTEST: f64 = 1e-14;

/// Error of a step, relative to the tolerance, below which the next one may be longer: `0.9^5` is 0.59.
const LEAST_SPARE: f64 = 0.5;

/// Ratio of the error of a step over a bend to its estimate: both embedded results are wrong there in the same way.
const HIDDEN_BY_BEND: f64 = 30.0;

/// States whose rates are added up at once.
const LANES: usize = 4;

/// Stages of the error-controlled method. The last one is the first of the next step.
const STAGES: usize = 7;

/// The stage of both methods that is nearest to the middle of the step and more accurate than the one before.
const MIDDLE: usize = 2;

/// How inputs go on during a step, and what is clamped on the way.
#[derive(Clone, Copy, Debug)]
pub struct Drive<'a> {
    /// First and second derivative of each input column with respect to time at the beginning of the step.
    pub rates: [&'a [f64]; 2],
    /// Where inputs are clamped to, if they are.
    pub clamp: Option<&'a Domain>,
}

impl Drive<'_> {
    /// The value of a column with this value at the beginning of the step, `since` seconds later.
    #[inline]
    pub(super) fn at(&self, column: usize, value: f64, since: f64) -> f64 {
        value + since * (self.rates[0][column] + 0.5 * since * self.rates[1][column])
    }
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
    /// Range of each input.
    ranges: Vec<[f64; 2]>,
    states: Range<usize>,
    scales: Vec<Scale>,
    /// The states before the step.
    before: Vec<f64>,
    /// Columns at a stage, and the rates of the states at each stage.
    stage: Vec<f64>,
    rates: Vec<[f64; LANES]>,
    /// Arguments with bends, their values at each stage, and their paths.
    bent: Vec<BentArgument>,
    arguments: Vec<f64>,
    paths: Vec<ArgumentPath>,
    /// `true` if the last stage was the end of a communication step: its arguments are those at the beginning of the next one.
    is_at_end: bool,
    implicit: Rosenbrock,
}

impl Solver {
    /// For points whose last columns are the states, which have these scales, and those before them the inputs, which have these ranges.
    /// No step of an error-controlled integration goes over the bends of these arguments.
    pub(super) fn new(columns: usize, ranges: Vec<[f64; 2]>, scales: Vec<Scale>, bent: Vec<BentArgument>) -> Self {
        let states = scales.len();
        let first = columns - states;
        Self {
            inputs: first - ranges.len()..first,
            ranges,
            states: first..columns,
            scales,
            before: vec![0.0; states],
            stage: vec![0.0; columns],
            rates: vec![[0.0; LANES]; STAGES * states.div_ceil(LANES)],
            arguments: vec![0.0; STAGES * bent.len()],
            paths: vec![ArgumentPath::default(); bent.len()],
            bent,
            is_at_end: false,
            implicit: Rosenbrock::new(states),
        }
    }

    /// Integrates the states of `point` over a communication step. `respond` gives the rates of the states at a point, and the arguments
    /// with bends. Returns how many steps were tried. Does not allocate.
    ///
    /// # Errors
    /// A [`StepError`]; the states are as before.
    pub(super) fn advance(
        &mut self,
        point: &mut [f64],
        integration: Integration,
        step: CommunicationStep,
        drive: Drive,
        respond: impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) -> Result<u32, StepError> {
        self.before.copy_from_slice(&point[self.states.clone()]);
        let result = match integration.tolerance() {
            None => self.fixed(point, integration, step, drive, respond),
            Some(own) => {
                let tolerance = step.tolerance.map_or(own, |tolerance| tolerance.min(own));
                self.error_controlled(point, (integration, tolerance), step, drive, respond)
            }
        };
        if result.is_err() {
            point[self.states.clone()].copy_from_slice(&self.before);
        }
        result
    }

    fn fixed(
        &mut self,
        point: &mut [f64],
        integration: Integration,
        CommunicationStep { size, most_steps, .. }: CommunicationStep,
        drive: Drive,
        mut respond: impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) -> Result<u32, StepError> {
        let steps = integration.parts(size);
        if steps > f64::from(most_steps) {
            return Err(StepError::TooManySteps);
        }
        let (h, lanes) = (size / steps, self.lanes());
        self.is_at_end = false;
        for step in 0..steps as u32 {
            let since = f64::from(step) * h;
            self.begin(point);
            self.stages(&CLASSICAL, 0, point, (since, h), drive, &mut respond);
            for (lane, states) in point[self.states.clone()].chunks_mut(LANES).enumerate() {
                let sums = weighted(CLASSICAL.result, &self.rates[lane..], lanes);
                states.iter_mut().zip(sums).for_each(|(state, sum)| *state += h * sum);
            }
            self.expect_plausible(&point[self.states.clone()], since + h)?;
        }
        Ok(steps as u32)
    }

    fn error_controlled(
        &mut self,
        point: &mut [f64],
        (integration, tolerance): (Integration, f64),
        CommunicationStep { size, derivatives, most_steps, .. }: CommunicationStep,
        drive: Drive,
        mut respond: impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) -> Result<u32, StepError> {
        let parts = integration.parts(size);
        if parts > f64::from(most_steps) {
            return Err(StepError::TooManySteps);
        }
        let longest = size / parts;
        let (mut since, mut h, mut steps) = (0.0, longest, 0);
        let is_implicit = integration.is_implicit();
        let mut is_repeated = false;
        // the arguments are known, or there are none
        let has_arguments = self.bent.is_empty() || (self.is_at_end && self.stage == point);
        self.is_at_end = false;
        self.begin(point);
        match derivatives.filter(|_| has_arguments) {
            Some(known) => self.rates.as_flattened_mut()[..known.len()].copy_from_slice(known),
            None => self.first_stage(point, 0.0, drive, &mut respond),
        }
        // a remainder by rounding is not a step
        while size - since > SHORTEST * size {
            steps += 1;
            if steps > most_steps {
                return Err(StepError::TooManySteps);
            }
            let rest = size - since;
            // no sliver at the end
            h = if h > 0.99 * rest { rest } else { h.min(0.5 * rest) };
            if is_implicit {
                self.implicit_stages(point, (since, h), is_repeated, drive, &mut respond);
            } else {
                self.stages(&DORMAND_PRINCE, 1, point, (since, h), drive, &mut respond);
            }
            is_repeated = true;
            let StepOverBends { share, has_bend } = self.step_over(is_implicit);
            if share < 1.0 && share * h >= SHORTEST * size {
                // less than what would be lengthened to the end of the communication step again
                h *= share.min(0.9);
                continue;
            }
            let hidden = if has_bend { HIDDEN_BY_BEND } else { 1.0 };
            let error = hidden * self.error(&point[self.states.clone()], h, is_implicit) / tolerance;
            if error <= 1.0 {
                // the last stage is at the end of the step
                point[self.states.clone()].copy_from_slice(&self.stage[self.states.clone()]);
                since += h;
                if is_implicit {
                    is_repeated = false;
                    self.first_stage(point, since, drive, &mut respond);
                } else {
                    let last = (STAGES - 1) * self.lanes();
                    self.rates.copy_within(last.., 0);
                    self.arguments.copy_within((STAGES - 1) * self.bent.len().., 0);
                }
                self.expect_plausible(&point[self.states.clone()], since)?;
            }
            // a step of full length that could have been longer is followed by another one, whatever the power is
            if !(error < LEAST_SPARE && h >= longest) {
                // nan: the shortest
                let factor = if error.is_nan() { 0.1 } else { (0.9 * error.max(1e-10).powf(-0.2)).clamp(0.1, 5.0) };
                h = longest.min(h * factor);
            }
            if h < SHORTEST * size {
                let after = since;
                return Err(if error.is_nan() {
                    StepError::NotFinite { after }
                } else {
                    StepError::Underflow { after }
                });
            }
        }
        self.is_at_end = true;
        Ok(steps)
    }

    /// Number of lanes of the states.
    fn lanes(&self) -> usize {
        self.before.len().div_ceil(LANES)
    }

    /// The bends on the way of a step.
    #[inline]
    fn step_over(&mut self, is_implicit: bool) -> StepOverBends {
        let count = self.bent.len();
        if count == 0 {
            return StepOverBends { share: 1.0, has_bend: false };
        }
        let share_of_middle = if is_implicit { rosenbrock::TIMES[MIDDLE] } else { DORMAND_PRINCE.stages[MIDDLE].0 };
        for (index, path) in self.paths.iter_mut().enumerate() {
            let [start, middle, end] = [0, MIDDLE, STAGES - 1].map(|stage| self.arguments[stage * count + index]);
            *path = ArgumentPath::at(start);
            (1..STAGES).for_each(|stage| path.add(self.arguments[stage * count + index]));
            path.add_turn([[0.0, start], [share_of_middle, middle], [1.0, end]]);
        }
        step_over(&self.bent, &self.paths)
    }

    /// Largest estimate of the error of a step of size `h` in any state, relative to its scale.
    fn error(&self, states: &[f64], h: f64, is_implicit: bool) -> f64 {
        let mut largest = 0.0f64;
        if is_implicit {
            for ((state, scale), error) in states.iter().zip(&self.scales).zip(self.implicit.error()) {
                let error = error.abs() / scale.of(*state);
                largest = if error > largest || error.is_nan() { error } else { largest };
            }
            return largest;
        }
        for (lane, (states, scales)) in states.chunks(LANES).zip(self.scales.chunks(LANES)).enumerate() {
            let sums = weighted(&DORMAND_PRINCE_ERROR, &self.rates[lane..], self.lanes());
            for ((state, scale), sum) in states.iter().zip(scales).zip(sums) {
                let error = (h * sum).abs() / scale.of(*state);
                // a maximum would ignore NaN
                largest = if error > largest || error.is_nan() { error } else { largest };
            }
        }
        largest
    }

    fn expect_plausible(&self, states: &[f64], after: f64) -> Result<(), StepError> {
        for ((state, &value), scale) in states.iter().enumerate().zip(&self.scales) {
            if !value.is_finite() {
                return Err(StepError::NotFinite { after });
            }
            if value.abs() > scale.limit {
                return Err(StepError::Implausible { state, value, after });
            }
        }
        Ok(())
    }

    /// Begins a step at a point: columns that are neither inputs nor states stay what they are.
    fn begin(&mut self, point: &[f64]) {
        self.stage.copy_from_slice(point);
    }

    /// Rates of the states at a point, `since` seconds after the beginning of a communication step.
    fn first_stage(
        &mut self,
        point: &[f64],
        since: f64,
        drive: Drive,
        respond: &mut impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) {
        let begin = Tableau { stages: &DORMAND_PRINCE.stages[..1], ..DORMAND_PRINCE };
        self.stages(&begin, 0, point, (since, 0.0), drive, respond);
    }

    /// Rates of the states at the stages, from one on, of a step of size `h`, `since` seconds after the beginning.
    fn stages(
        &mut self,
        tableau: &Tableau,
        first: usize,
        point: &[f64],
        (since, h): (f64, f64),
        drive: Drive,
        respond: &mut impl FnMut(&[f64], &mut [f64], &mut [f64]),
    ) {
        let lanes = self.lanes();
        let Self { inputs, ranges, states, stage, rates, bent, arguments, .. } = self;
        let bent = bent.len();
        for (index, (time, weights)) in tableau.stages.iter().enumerate().skip(first) {
            let later = since + time * h;
            for (column, range) in inputs.clone().zip(&*ranges) {
                let value = drive.at(column, point[column], later);
                let value = without_rounding(value, *range);
                stage[column] = drive.clamp.map_or(value, |domain| domain.clamp(column, value));
            }
            let both = stage[states.clone()].chunks_mut(LANES).zip(point[states.clone()].chunks(LANES));
            for (lane, (to, from)) in both.enumerate() {
                let sums = weighted(weights, &rates[lane..], lanes);
                to.iter_mut().zip(from).zip(sums).for_each(|((to, from), sum)| *to = from + h * sum);
            }
            let rates = &mut rates[index * lanes..][..lanes];
            respond(stage, &mut rates.as_flattened_mut()[..states.len()], &mut arguments[index * bent..][..bent]);
        }
    }
}

/// The end of the range if a value passes it by rounding only, else the value: beyond a range a formula may be undefined.
#[inline]
fn without_rounding(value: f64, [min, max]: [f64; 2]) -> f64 {
    let rounding = TOLERANCE * (max - min);
    if value < min && value >= min - rounding {
        min
    } else if value > max && value <= max + rounding {
        max
    } else {
        value
    }
}

/// Weighted sums of rates over the stages; the rates of one lane are `apart` lanes apart.
#[inline]
fn weighted(weights: &[f64], rates: &[[f64; LANES]], apart: usize) -> [f64; LANES] {
    let mut sums = [0.0; LANES];
    for (weight, rates) in weights.iter().zip(rates.iter().step_by(apart)) {
        sums.iter_mut().zip(rates).for_each(|(sum, rate)| *sum += weight * rate);
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bends::Bends;
    use std::sync::Arc;

    /// Speed after 0.3 s of a mass of 1 kg that is slowed by up to 300 N over 4 mm of its way.
    fn speed_after_a_narrow_force(start: f64, tolerance: f64) -> f64 {
        let bends = Arc::new(Bends::at(&[0.298, 0.3, 0.302], None));
        let scale = Scale { nominal: 1.0, is_relative: false, limit: 1e3 };
        let bent = vec![BentArgument { bends, group: 0 }];
        let mut solver = Solver::new(2, Vec::new(), vec![scale; 2], bent);
        let mut point = [0.0, start];
        for _ in 0..3 {
            let integration = Integration::ErrorControlled { tolerance, longest: 0.1 };
            let drive = Drive { rates: [&[], &[]], clamp: None };
            let step = CommunicationStep::of(0.1);
            let advanced = solver.advance(&mut point, integration, step, drive, |point, rates, arguments| {
                rates[0] = point[1];
                rates[1] = -300.0 * (1.0 - (point[0] - 0.3).abs() / 2e-3).max(0.0);
                arguments[0] = point[0];
            });
            advanced.unwrap();
        }
        point[1]
    }

    #[test]
    fn a_step_over_a_bend_misses_little_more_than_its_tolerance() {
        let tolerance = 1e-9;
        let error = |start: f64| (speed_after_a_narrow_force(start, tolerance) - (start * start - 1.2).sqrt()).abs();
        let largest = (0..200).map(|k| error(2.0 + 0.02 * f64::from(k))).fold(0.0, f64::max);
        assert!(largest < 100.0 * tolerance, "{largest:e}");
    }
}
