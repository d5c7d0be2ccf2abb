//! Integration of autonomous ordinary differential equations on a fixed grid of times.
//!
//! The right-hand side must not depend on the time argument: `ode_solvers` 0.6 evaluates the last stage of a step at the
//! step's beginning (node `c_12` is 0 and not 1). Where time matters it is a state with the derivative 1.

mod budget;
pub mod method;
pub mod radau;

pub use budget::{Budget, BudgetError, StopCause};
use nalgebra::{DefaultAllocator, Dim, OVector, SVector, allocator::Allocator};
use ode_solvers::{
    Dop853, System,
    dop_shared::{IntegrationError as DopriError, OutputType},
};
use std::fmt;

/// Relative and absolute tolerance of a step unless the study gives one. Tighter ones gain nothing: rounding takes over.
///
/// On the undamped pendulum over 2 s the largest error at any row is 2e-11 against a fixed-step solution.
pub const TOLERANCE: f64 = 1e-13;

/// Powers of ten above a tolerance, from 1e-2 downward: settings that are tried for a source that need not be as accurate.
pub fn looser_tolerances(tolerance: f64) -> impl Iterator<Item = f64> {
    const LOOSER: [f64; 10] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11];
    LOOSER.into_iter().filter(move |looser| *looser > tolerance)
}

/// Result of an integration.
#[derive(Clone, Debug)]
pub struct IntegrationResult<State> {
    /// The states at the first times, all of them if nothing failed and the problem did not stop.
    pub states: Vec<State>,
    /// Set if the method failed before the last row.
    pub failure: Option<IntegrationFailure>,
    /// True if the method found the equations to be stiff.
    pub is_stiff: bool,
    /// Evaluations of the right-hand side.
    pub evaluations: u32,
}

/// Failure of a method, and where.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegrationFailure {
    /// The method's message.
    pub message: String,
    /// Time.
    pub t: f64,
}

impl fmt::Display for IntegrationFailure {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{} at t = {} s", self.message, self.t)
    }
}

impl std::error::Error for IntegrationFailure {}

/// Reason why there are no states at all times of an integration.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IntegrationError {
    /// The method found no step that is accurate enough, or took too many steps.
    #[error("integration failed: {0}")]
    Method(IntegrationFailure),
    /// A state that is not finite.
    #[error("the state is not finite at t = {t} s")]
    NotFinite {
        /// Time of the state, in s.
        t: f64,
    },
    /// The run has exhausted its budget, or was stopped.
    #[error(transparent)]
    GivenUp(#[from] BudgetError),
}

/// Right-hand side `f(y)` of `y' = f(y)` in the form that `ode_solvers` needs.
struct RightHandSide<F>(F);

impl<const N: usize, F: Fn(&SVector<f64, N>) -> SVector<f64, N>> System<f64, SVector<f64, N>> for RightHandSide<F> {
    fn system(&self, _: f64, y: &SVector<f64, N>, derivative: &mut SVector<f64, N>) {
        *derivative = (self.0)(y);
    }
}

/// A problem that ends with its budget: then the derivative is not a number, and the method gives up.
struct Budgeted<'a, P> {
    problem: P,
    budget: &'a Budget<'a>,
}

impl<D: Dim, P: System<f64, OVector<f64, D>>> System<f64, OVector<f64, D>> for Budgeted<'_, P>
where
    DefaultAllocator: Allocator<D>,
{
    fn system(&self, t: f64, y: &OVector<f64, D>, derivative: &mut OVector<f64, D>) {
        if self.budget.spend() {
            self.problem.system(t, y, derivative);
        } else {
            derivative.fill(f64::NAN);
        }
    }

    fn solout(&mut self, t: f64, row: &OVector<f64, D>, derivative: &OVector<f64, D>) -> bool {
        self.budget.arrive(t);
        self.problem.solout(t, row, derivative) || self.budget.is_over()
    }
}

/// Most steps of an integration: more than a [`Budget`] has evaluations for.
const MAX_STEPS: u32 = 2_000_000;

/// States at evenly spaced `times`, from `initial` at the first of them; `tolerance` is relative and absolute.
///
/// # Errors
/// [`IntegrationError`]: the method fails, a state is not finite, or the budget is exhausted.
pub fn integrate<const N: usize>(
    derivative: impl Fn(&SVector<f64, N>) -> SVector<f64, N>,
    initial: SVector<f64, N>,
    times: &[f64],
    tolerance: f64,
    budget: &Budget,
) -> Result<Vec<SVector<f64, N>>, IntegrationError> {
    budget.begin(times);
    let IntegrationResult { states, failure, .. } =
        advance(RightHandSide(derivative), initial, times, tolerance, budget);
    budget.check(|| None)?;
    match failure {
        Some(failure) => Err(IntegrationError::Method(failure)),
        None if states.len() < times.len() => Err(IntegrationError::NotFinite { t: times[states.len()] }),
        None => Ok(states),
    }
}

/// Integrates an autonomous problem over evenly spaced `times`; `tolerance` is relative and absolute.
///
/// Dormand and Prince's method of order 8(5,3) with dense output of order 7 (Hairer, Norsett, Wanner: *Solving Ordinary
/// Differential Equations I*, II.10).
pub fn advance<D: Dim>(
    problem: impl System<f64, OVector<f64, D>>,
    initial: OVector<f64, D>,
    times: &[f64],
    tolerance: f64,
    budget: &Budget,
) -> IntegrationResult<OVector<f64, D>>
where
    DefaultAllocator: Allocator<D>,
{
    let &[start, .., stop] = times else {
        return IntegrationResult {
            states: vec![initial; times.len()],
            failure: None,
            is_stiff: false,
            evaluations: 0,
        };
    };
    let spacing = (stop - start) / (times.len() - 1) as f64;
    // ode_solvers extrapolates a row at the very end of the integration from the step before it: no row is there
    let run = OdeRun { start, end: stop + 0.01 * spacing, spacing, tolerance, output: OutputType::Dense };
    let IntegrationResult { mut states, failure, is_stiff, evaluations } = run.solve(problem, initial, budget);
    states.truncate(times.len());
    // nothing is wrong if only the way past the last row failed
    let failure = failure.filter(|_| states.len() < times.len());
    IntegrationResult { states, failure, is_stiff, evaluations }
}

/// Integration as by [`advance`] between two times, where the last step ends at the second one: nothing is evaluated beyond it.
pub fn advance_to<D: Dim>(
    problem: impl System<f64, OVector<f64, D>>,
    initial: OVector<f64, D>,
    [start, end]: [f64; 2],
    tolerance: f64,
    budget: &Budget,
) -> IntegrationResult<OVector<f64, D>>
where
    DefaultAllocator: Allocator<D>,
{
    let run = OdeRun { start, end, spacing: end - start, tolerance, output: OutputType::Sparse };
    let IntegrationResult { mut states, failure, is_stiff, evaluations } = run.solve(problem, initial.clone(), budget);
    let last = states.pop().filter(|_| failure.is_none() && !budget.is_over());
    let states = [initial].into_iter().chain(last).collect();
    IntegrationResult { states, failure, is_stiff, evaluations }
}

/// An integration by `ode_solvers`.
struct OdeRun {
    start: f64,
    end: f64,
    spacing: f64,
    tolerance: f64,
    /// Rows, or the ends of all steps.
    output: OutputType,
}

impl OdeRun {
    /// States until the first that is not finite.
    fn solve<D: Dim>(
        self,
        problem: impl System<f64, OVector<f64, D>>,
        initial: OVector<f64, D>,
        budget: &Budget,
    ) -> IntegrationResult<OVector<f64, D>>
    where
        DefaultAllocator: Allocator<D>,
    {
        let Self { start, end, spacing, tolerance, output } = self;
        // all but the number of steps is what `Dop853::new` takes
        let mut solver = Dop853::from_param(
            Budgeted { problem, budget },
            start,
            end,
            spacing,
            initial,
            tolerance,
            tolerance,
            0.9,
            0.0,
            0.333,
            6.0,
            end - start,
            0.0,
            MAX_STEPS,
            1000,
            output,
        );
        let (evaluations, failure, is_stiff) = match solver.integrate() {
            Ok(statistics) => (statistics.num_eval, None, false),
            Err(error) => {
                let is_stiff = matches!(error, DopriError::StiffnessDetected { .. });
                let (DopriError::MaxNumStepReached { x, .. }
                | DopriError::StepSizeUnderflow { x }
                | DopriError::StiffnessDetected { x }) = &error;
                (0, Some(IntegrationFailure { message: in_words(&error), t: *x }), is_stiff)
            }
        };
        let finite = solver.y_out().iter().take_while(|state| state.iter().all(|value| value.is_finite()));
        let states = finite.cloned().collect();
        IntegrationResult { states, failure, is_stiff, evaluations }
    }
}

/// Why a method gave up, without the time.
pub fn in_words(error: &DopriError) -> String {
    match error {
        DopriError::MaxNumStepReached { n_step, .. } => format!("more than {n_step} steps"),
        DopriError::StepSizeUnderflow { .. } => "no step is short enough for the tolerance".into(),
        DopriError::StiffnessDetected { .. } => "the equations are stiff, for which the method is not made".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn every_row_is_as_accurate_as_the_steps_the_last_one_too() {
        for count in [2, 3, 7, 50, 1000] {
            let times: Vec<f64> = (0..=count).map(|i| 10.0 * f64::from(i) / f64::from(count)).collect();
            let states =
                integrate(|y| Vector2::new(y[1], -y[0]), Vector2::new(0.0, 1.0), &times, TOLERANCE, &Budget::default())
                    .unwrap();
            for (state, t) in states.iter().zip(&times) {
                assert!((state[0] - t.sin()).abs() < 1e-11, "{count} rows, t = {t}: {}", state[0] - t.sin());
            }
        }
    }

    #[test]
    fn a_state_that_leaves_the_numbers_is_located() {
        let times = [0.0, 0.5, 1.0, 1.5];
        let error =
            integrate(|y| y.component_mul(y), SVector::<f64, 1>::new(1.0), &times, TOLERANCE, &Budget::default())
                .unwrap_err();
        assert!(matches!(error, IntegrationError::Method(_)), "{error}");
        let message = error.to_string();
        assert!(
            message.starts_with("integration failed: no step is short enough for the tolerance at t = 0.9999"),
            "{message}"
        );
        assert!(!message.contains("underflow") && !message.contains(" x "), "{message}");
    }
}
