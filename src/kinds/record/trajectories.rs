//! Record of the identification from motions of a table.

use super::{Candidate, SolverRecord};
use crate::diagnostics::numbers::power;
use serde::{Deserialize, Serialize};

/// Result of an identification from the motions of a table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrajectoriesRecord {
    /// Errors of roll-outs of the candidates that were tried, along stretches that were held out. The best is exported.
    pub candidates: Vec<Candidate>,
    /// The name of the best.
    pub exported: String,
    /// Highest harmonic of the angles.
    pub harmonics: usize,
    /// Highest power of the other columns; of equations of motion in the mass matrix, and the potential has two more.
    pub powers: usize,
    /// Coordinates that were found to be angles, with equations that are the same a turn later, where the study does not say.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub periodic: Vec<String>,
    /// Columns of rates that are not the derivatives of their coordinates, and the root mean square of the difference, relative to the rate's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rate_errors: Vec<(String, f64)>,
    /// Coefficients other than zero.
    pub coefficients: usize,
    /// Number of independent solutions of the equations of motion that the rows do not distinguish; one for
    /// accelerations.
    pub solutions: usize,
    /// Integration by the solver.
    pub solver: SolverRecord,
}

/// Error of roll-outs, relative to the coordinates' standard deviations, from which on the equations are not those of the motions.
pub(crate) const POOR: f64 = 0.1;

/// Name of a candidate.
pub(crate) const MOTION: &str = "equations of motion";

impl TrajectoriesRecord {
    fn error(&self) -> f64 {
        self.candidates.iter().map(|candidate| candidate.error).fold(f64::INFINITY, f64::min)
    }

    /// Problem of the equations, if there is one.
    pub(crate) fn problem(&self) -> Option<String> {
        let error = self.error();
        // false for NaN as well
        let is_good = error <= POOR;
        (!is_good).then(|| {
            format!(
                "the learned equations are off by {} of the coordinates' standard deviation along stretches that were held \
                 out, expected at most {POOR}: the rows are too few, too far apart or too noisy, or the equations are no sums of sines, \
                 cosines and powers",
                power(error, 1)
            )
        })
    }

    /// Description of the identification as text, in lines.
    pub(crate) fn describe(&self) -> String {
        let Self { candidates, exported, harmonics, powers, coefficients, solutions, solver, periodic, .. } = self;
        let errors: Vec<String> =
            candidates.iter().map(|Candidate { name, error, .. }| format!("{name} {}", power(*error, 1))).collect();
        let of_mass = if exported == MOTION { " in the mass matrix" } else { "" };
        let order = match (harmonics, powers) {
            (0, powers) => format!("powers up to {powers}{of_mass}"),
            (harmonics, 0) => format!("harmonics up to {harmonics}"),
            _ => format!("harmonics up to {harmonics}, powers up to {powers}{of_mass}"),
        };
        let angles = match periodic.as_slice() {
            [] => String::new(),
            names => format!("angles: {}\n", names.join(", ")),
        };
        let ambiguous = match solutions {
            0 | 1 => String::new(),
            _ => format!(
                "{solutions} independent solutions fit the rows, one with a positive definite mass matrix was taken\n"
            ),
        };
        format!(
            "error along stretches that were held out: {}; exported: {exported}, {coefficients} coefficients, {order}\n\
             {angles}{ambiguous}{}",
            errors.join(", "),
            solver.describe()
        )
    }
}
