//! Record of the training of equations of motion.

use super::{Candidate, DICTIONARY, SolverRecord, list};
use crate::diagnostics::numbers::power;
use serde::{Deserialize, Serialize};

/// Result of a training on the equations of motion of a mechanism.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MotionRecord {
    /// Highest harmonic of the angles in the dictionary, which is found by least squares.
    pub harmonics: usize,
    /// Highest power of the other coordinates and of the parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers with a coefficient: those of the equations of motion and of the positions.
    pub products: [usize; 2],
    /// Largest error of any function of the dictionary at unseen configurations, relative to the largest value of the function.
    pub error: f64,
    /// Forces of joints and springs among the outputs, which have a separate dictionary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reactions: Option<ReactionRecord>,
    /// The ways to learn the equations that were compared, the best first; none if the dictionary is exact.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub candidates: Vec<Candidate>,
    /// The one that is exported: `dictionary`, `network` or `dictionary and network`.
    #[serde(default = "dictionary")]
    pub exported: String,
    /// Errors at corners of the domain; none if the dictionaries are exact.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corners: Option<CornerRecord>,
    /// Integration by the solver.
    pub solver: SolverRecord,
}

/// Errors of learned accelerations and forces along motions that begin at corners of the domain.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CornerRecord {
    /// Number of runs.
    pub runs: usize,
    /// Largest error of an acceleration, relative to its standard deviation over random states.
    pub accelerations: CornerError,
    /// Largest error of a force of a joint, driver or spring, relative to the range of the output in training or in the run, whichever is
    /// larger; none if no output is such a force.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forces: Option<CornerError>,
}

/// The largest error in runs from corners.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CornerError {
    /// Relative error.
    pub error: f64,
    /// Description of the run with this error.
    pub run: String,
}

/// Result of a training on forces of joints and springs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ReactionRecord {
    /// Highest harmonic of the angles.
    pub harmonics: usize,
    /// Highest power of the other coordinates and of the parameters.
    pub powers: usize,
    /// Products of sines, cosines and powers with a coefficient.
    pub products: usize,
    /// Largest error of any function at unseen configurations, relative to its largest value.
    pub error: f64,
}

/// Error of a function, relative to its largest value, above which the equations are not those of the mechanism. With
/// networks it is the error of the accelerations, relative to their standard deviation.
const POOR: f64 = 0.01;

fn dictionary() -> String {
    DICTIONARY.into()
}

impl CornerRecord {
    /// Text that follows the description of the learned equations.
    fn describe(&self) -> String {
        let Self { runs, accelerations: CornerError { error, run }, forces } = self;
        let forces = forces.as_ref().map_or(String::new(), |CornerError { error, run }| {
            format!(" and {} of the range of a force ({run})", power(*error, 1))
        });
        let error = power(*error, 1);
        format!(
            "; in {runs} runs from corners of the domain off by at most {error} of the standard deviation of an acceleration ({run}){forces}"
        )
    }
}

impl CornerError {
    /// The error as text, if it is above the limit or NaN.
    fn poor(&self) -> Option<String> {
        let is_good = self.error <= POOR;
        (!is_good).then(|| power(self.error, 1))
    }
}

impl MotionRecord {
    /// Problem of the equations, if there is one.
    pub(crate) fn problem(&self) -> Option<String> {
        self.problem_of_equations().or_else(|| self.problem_of_reactions())
    }

    /// Returns true if networks were compared: dictionaries have as many samples as they need, whatever the study says.
    fn has_networks(&self) -> bool {
        !self.candidates.is_empty()
    }

    /// Returns true if more states to learn from may improve what is poor: networks gain from them, but forces have a dictionary alone.
    pub(crate) fn may_gain_from_states(&self) -> bool {
        self.has_networks() && !self.are_only_forces_poor()
    }

    fn are_only_forces_poor(&self) -> bool {
        let Some(CornerRecord { accelerations, forces: Some(forces), .. }) = &self.corners else { return false };
        let are_equations_good = self.problem_of_equations().is_none() && accelerations.poor().is_none();
        are_equations_good && (forces.poor().is_some() || self.problem_of_reactions().is_some())
    }

    /// Limit of the equations that are good at random states: corners of the domain at which they are not.
    pub(crate) fn limit(&self) -> Option<String> {
        let CornerRecord { accelerations, forces, .. } = self.corners.as_ref()?;
        if let Some(error) = accelerations.poor() {
            return Some(format!(
                "the learned accelerations are off by {error} of their standard deviation at a corner of the domain ({}), expected at most \
                 {POOR}: {} may help",
                accelerations.run,
                if self.has_networks() {
                    "more `sampling.states`, smaller ranges or a larger network"
                } else {
                    "smaller ranges"
                }
            ));
        }
        let forces = forces.as_ref()?;
        let error = forces.poor()?;
        Some(format!(
            "the learned forces of joints, drivers and springs are off by {error} of their ranges at a corner of the domain ({}), expected \
             at most {POOR}: smaller ranges may help",
            forces.run
        ))
    }

    fn problem_of_reactions(&self) -> Option<String> {
        let reactions = self.reactions.as_ref()?;
        // false for NaN as well
        let is_good = reactions.error <= POOR;
        (!is_good).then(|| {
            format!(
                "the learned forces of joints, drivers and springs are off by {} of their largest value at unseen configurations, expected \
                 at most {POOR}: they are no sums of sines, cosines and powers, or the ranges are too wide",
                power(reactions.error, 1)
            )
        })
    }

    fn problem_of_equations(&self) -> Option<String> {
        if let Some(exported) = self.candidates.iter().find(|candidate| candidate.name == self.exported) {
            // false for NaN as well
            let is_good = exported.error <= POOR;
            return (!is_good).then(|| {
                format!(
                    "the learned accelerations or positions are off by {} of their standard deviation at unseen states, expected \
                     at most {POOR}: more `sampling.states`, smaller ranges or a larger network may help",
                    power(exported.error, 1)
                )
            });
        }
        (self.error > POOR).then(|| {
            format!(
                "the learned equations of motion are off by {} of their largest value at unseen configurations, expected at most \
                 {POOR}: they are no sums of sines, cosines and powers, or the ranges are too wide",
                power(self.error, 1)
            )
        })
    }

    /// Description of the training as text, in lines.
    pub(crate) fn describe(&self) -> String {
        let Self { harmonics, powers, products: [equations, positions], error, solver, .. } = self;
        let Self { candidates, exported, corners, reactions, .. } = self;
        let corners = corners.as_ref().map_or(String::new(), CornerRecord::describe);
        let reactions = reactions.as_ref().map_or(String::new(), |ReactionRecord { harmonics, powers, products, error }| {
            format!(
                "; forces of joints, drivers and springs: harmonics up to {harmonics}, powers up to {powers}, {products} products, error \
                 {error:.1e}"
            )
        });
        let compared = match candidates.as_slice() {
            [] => String::new(),
            candidates => {
                let errors = list(candidates);
                format!("; error of the accelerations at unseen states: {errors}; exported: {exported}")
            }
        };
        format!(
            "least squares: harmonics up to {harmonics}, powers up to {powers}, {equations} products in the equations and {positions} \
             in positions, error {error:.1e} at unseen configurations{reactions}{compared}{corners}\n{}",
            solver.describe()
        )
    }
}
