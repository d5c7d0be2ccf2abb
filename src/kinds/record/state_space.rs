//! Record of the training of the equations of an FMU.

use super::{Candidate, SolverRecord, list};
use crate::diagnostics::numbers::power;
use serde::{Deserialize, Serialize};

/// Result of a training on the equations of an FMU.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StateSpaceRecord {
    /// Functions that were learned; the other derivatives and outputs are states.
    pub functions: usize,
    /// Highest harmonic of the angles.
    pub harmonics: usize,
    /// Highest power of the other states, of inputs and of parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers in the surrogate.
    pub products: usize,
    /// Relative errors at states that were held out, of the candidates that were tried. The best is exported.
    pub candidates: Vec<Candidate>,
    /// The name of the best.
    pub exported: String,
    /// Integration by the solver.
    pub solver: SolverRecord,
}

/// Error of a function, relative to its standard deviation, from which on the equations are not those of the FMU.
const POOR: f64 = 0.1;

impl StateSpaceRecord {
    fn error(&self) -> f64 {
        let exported = self.candidates.iter().find(|candidate| candidate.name == self.exported);
        exported.map_or(f64::INFINITY, |candidate| candidate.error)
    }

    /// Problem of the equations, if there is one.
    pub(crate) fn problem(&self) -> Option<String> {
        let error = self.error();
        // false for NaN as well
        let is_good = error <= POOR;
        (!is_good).then(|| {
            format!(
                "the learned equations are off by {} of their standard deviation at unseen states, expected at most {POOR}: \
                 more `sampling.states`, smaller ranges or a larger network may help",
                power(error, 1)
            )
        })
    }

    /// Description of the training as text, in lines.
    pub(crate) fn describe(&self) -> String {
        let Self { functions, harmonics, powers, products, candidates, exported, solver, .. } = self;
        let harmonics = if *harmonics > 0 { format!("harmonics up to {harmonics}, ") } else { String::new() };
        format!(
            "{functions} functions; error at unseen states: {}; exported: {exported}, {products} products, {harmonics}powers up to \
             {powers}\n{}",
            list(candidates),
            solver.describe()
        )
    }
}
