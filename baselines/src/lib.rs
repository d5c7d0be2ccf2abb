//! Simpler models than a network, fitted by other libraries to the same rows: whether the network is worth it.
//!
//! One file a model, each an `impl` of [`Baseline`] for its options in the study. The names of a model in the study, in
//! tables and in file names are those of [`BaselineKind`].

mod elastic_net;
mod gaussian_process;
mod gradient_boosting;
mod knn;
mod lasso;
mod linear;
mod options;
mod polynomial;
mod ridge;
mod rows;
mod svr;
#[cfg(test)]
mod testing;
mod tree;
pub mod worker;

pub use elastic_net::ElasticNet;
pub use gaussian_process::GaussianProcess;
pub use gradient_boosting::GradientBoosting;
pub use knn::Knn;
pub use lasso::Lasso;
pub use linear::Linear;
use metafmu_runtime::regression::Regression;
pub use options::{BaselineKind, Baselines};
pub use polynomial::Polynomial;
pub use ridge::Ridge;
pub use rows::Rows;
pub use svr::Svr;
pub use tree::{DecisionTree, ExtraTrees, RandomForest};

/// What is wrong with an option.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OptionProblem {
    /// Its key within the section: of the model, or `[baselines]` in what [`Baselines`] says.
    pub key: String,
    /// What was found and what is expected.
    pub message: String,
}

/// A model that can be fitted to rows.
pub trait Baseline {
    /// At most so many rows, chosen at random; none: all there are.
    fn most_rows(&self) -> Option<usize> {
        None
    }

    /// Fits it to standardised rows; the same rows and seed give the same model.
    ///
    /// # Errors
    /// Why it cannot be fitted, in words.
    fn fit(&self, rows: &Rows, seed: u64) -> Result<Fitted, String>;

    /// Every mistake in the options.
    fn problems(&self) -> Vec<OptionProblem>;
}

/// A fitted model.
pub enum Fitted {
    /// One whose numbers are known: the FMU's library evaluates it, here and in an FMU.
    Formula(Regression),
    /// One that only the library that fitted it can evaluate.
    Library(LibraryModel),
}

/// What a library predicts at some rows, or why not.
pub type Predict = dyn Fn(&[f64]) -> Result<Vec<f64>, String>;

/// A fitted model inside a library.
pub struct LibraryModel {
    /// From standardised rows, shape `[rows, inputs]`, to standardised outputs, shape `[rows, outputs]`.
    pub predict: Box<Predict>,
    /// Bytes of its numbers.
    pub memory_bytes: u64,
    /// Why it cannot be exported.
    pub not_exportable: &'static str,
}

/// Runs a library's function for each output, over all cores; results in the order of the outputs.
fn for_each_output<T: Send>(
    rows: &Rows,
    fit: impl Fn(usize) -> Result<T, String> + Send + Sync,
) -> Result<Vec<T>, String> {
    use rayon::prelude::*;
    (0..rows.outputs).into_par_iter().map(fit).collect()
}

/// A mistake if a number is not as it should be.
fn expect(good: bool, key: &'static str, found: &dyn std::fmt::Display, expected: &str) -> Option<OptionProblem> {
    (!good).then(|| OptionProblem { key: key.into(), message: format!("{found}, expected {expected}") })
}

fn not_negative(key: &'static str, value: f64) -> Option<OptionProblem> {
    expect(value >= 0.0 && value.is_finite(), key, &value, "0 or a positive number")
}

fn positive(key: &'static str, value: f64) -> Option<OptionProblem> {
    expect(value > 0.0 && value.is_finite(), key, &value, "a positive number")
}

fn at_most(key: &'static str, value: usize, most: usize) -> Option<OptionProblem> {
    expect(value <= most, key, &value, &format!("at most {most}"))
}

/// Trees of a model: all of them are in memory.
const MOST_TREES: usize = 10_000;

fn at_least(key: &'static str, value: usize, least: usize) -> Option<OptionProblem> {
    expect(value >= least, key, &value, &format!("at least {least}"))
}
