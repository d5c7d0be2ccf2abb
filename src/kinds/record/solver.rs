//! Record of a surrogate's solver.

use crate::{
    diagnostics::numbers::power,
    evaluation::{AcceptanceCheck, Findings, Reason},
};
use metafmu_runtime::Integration;
use serde::{Deserialize, Serialize};

/// Integration by the solver, and its error.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SolverRecord {
    /// Largest error of a step, relative to the states' nominal values; none if all steps are equal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tolerance: Option<f64>,
    /// Longest step, in seconds.
    pub step: f64,
    /// Cost of the implicit method, where it was cheaper than the explicit one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub implicit: Option<ImplicitCost>,
    /// Perturbation of the initial state, in all states, that changes the outputs of a run as much as the solver does:
    /// the largest of all runs, up to where they leave the domain.
    pub error: f64,
    /// Wanted error: a tenth of the error of the equations, within limits.
    pub wanted: f64,
    /// Number of training runs and of corners that it was measured in.
    pub runs: [usize; 2],
    /// Run of the largest error.
    pub worst: String,
    /// Steps of the solver in a second of simulated time: median of the training runs, and the most in any run.
    pub steps_per_second: [f64; 2],
    /// Run of the most steps.
    pub slowest: String,
}

/// Cost of the implicit method beside the explicit one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImplicitCost {
    /// Evaluations of the equations in a second of simulated time, the solution of linear equations among them: in all runs, by the implicit method.
    pub evaluations: f64,
    /// Evaluations by the explicit method at a tolerance of 1e-6.
    pub explicit: f64,
}

/// Error of the solver above which a surrogate is rejected, as a perturbation of the initial state.
pub(crate) const POOR: f64 = 1e-3;

impl SolverRecord {
    /// Adds a missed criterion: a problem above [`POOR`], a limit above the wanted error. Fixed steps are the study's choice, and poor equations
    /// are not measured.
    pub(crate) fn add_to(&self, findings: &mut Findings) {
        let Self { tolerance, error, wanted, runs, worst, .. } = self;
        if runs.iter().sum::<usize>() == 0 || *error <= if tolerance.is_some() { *wanted } else { POOR } {
            return;
        }
        let size = if *error < f64::MAX {
            format!("has the effect of an initial state perturbed by {error:.1e}")
        } else {
            "is not finite".into()
        };
        let cause = format!("error of the solver {size}, in a run with {worst}, expected at most {wanted:.0e}");
        let reason = Reason::new(AcceptanceCheck::Solver, "", cause);
        if *error > POOR { findings.problems.push(reason) } else { findings.limits.push(reason) }
    }

    /// Integration with these numbers.
    pub(crate) fn integration(&self) -> Integration {
        let Self { tolerance, step, .. } = *self;
        match tolerance {
            Some(tolerance) if self.implicit.is_some() => Integration::Implicit { tolerance, longest: step },
            Some(tolerance) => Integration::ErrorControlled { tolerance, longest: step },
            None => Integration::Fixed { step },
        }
    }

    /// Description of the integration as text, in lines.
    pub(crate) fn describe(&self) -> String {
        let Self { tolerance, step, error, runs: [training, corners], worst, steps_per_second, slowest, .. } = self;
        let how = match tolerance {
            Some(tolerance) => format!("solver with a tolerance of {tolerance:.0e}, steps of at most {step} s"),
            None => format!("solver with fixed steps of {step} s"),
        };
        let how = match &self.implicit {
            Some(ImplicitCost { evaluations, explicit }) => format!(
                "implicit {how}, {} evaluations a second instead of {} as the equations are stiff",
                evaluations.ceil(),
                explicit.ceil()
            ),
            None => how,
        };
        if training + corners == 0 {
            return how;
        }
        let error = power(*error, 1);
        let [median, most] = steps_per_second.map(|steps| format!("{:.0}", steps.ceil()));
        format!(
            "{how}: {median} steps a second, at most {most} (at {slowest})\nerror of the solver like an initial state perturbed by {error}, in \
             {training} training runs and at {corners} corners of the domain (most at {worst})"
        )
    }
}
