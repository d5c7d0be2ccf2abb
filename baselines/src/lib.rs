//! Simpler models than a network, fitted to the same rows, most of them by other libraries: whether the network is worth it.
//!
//! One file a model, each an `impl` of [`Baseline`] for its options in the study. The names of a model in the study, in
//! tables and in file names are those of [`BaselineKind`].

mod bfgs;
mod elastic_net;
mod error;
mod gaussian_process;
mod gradient_boosting;
mod knn;
mod lasso;
mod linear;
mod polynomial;
mod prepare;
mod ridge;
mod rows;
mod svr;
#[cfg(test)]
mod testing;
mod tree;
pub mod worker;

pub use error::{BaselineCause, BaselineError};
pub use gaussian_process::{DesignPlaces, design_points};
pub use metafmu_core::study::baselines::{BaselineKind, Baselines, GaussianProcess};
use metafmu_runtime::graph::Graph;
pub use polynomial::degrees as polynomial_degrees;
pub use prepare::{choose_rows, rows};
pub use rows::StandardizedRows;

/// A model that can be fitted to rows.
pub trait Baseline {
    /// Maximum number of training rows, chosen at random; `None`: all rows.
    fn most_rows(&self) -> Option<usize> {
        None
    }

    /// Fits the model to standardized rows; the same rows and seed give the same model.
    ///
    /// # Errors
    /// The reason why the model cannot be fitted.
    fn fit(&self, rows: &StandardizedRows, seed: u64) -> Result<Fitted, BaselineError>;

    /// Fits a model that also predicts standard deviations: those of a further row, one for each output, follow all
    /// outputs.
    ///
    /// # Errors
    /// Those of [`Self::fit`], and [`BaselineCause::NoDeviation`] if the model has no predicted standard deviation.
    fn fit_with_std(&self, _: &StandardizedRows, _: u64) -> Result<Graph, BaselineError> {
        Err(BaselineError::new(BaselineCause::NoDeviation, "has no predicted standard deviation"))
    }
}

/// The model of a kind, with its options.
pub fn model(options: &Baselines, kind: BaselineKind) -> &dyn Baseline {
    match kind {
        BaselineKind::Linear => &options.linear,
        BaselineKind::Ridge => &options.ridge,
        BaselineKind::Lasso => &options.lasso,
        BaselineKind::ElasticNet => &options.elastic_net,
        BaselineKind::Polynomial => &options.polynomial,
        BaselineKind::Svr => &options.svr,
        BaselineKind::Knn => &options.knn,
        BaselineKind::DecisionTree => &options.decision_tree,
        BaselineKind::RandomForest => &options.random_forest,
        BaselineKind::ExtraTrees => &options.extra_trees,
        BaselineKind::GradientBoosting => &options.gradient_boosting,
        BaselineKind::GaussianProcess => &options.gaussian_process,
    }
}

/// A fitted model.
pub enum Fitted {
    /// One whose numbers are known: the FMU's library evaluates it, here and in an FMU.
    Formula(Graph),
    /// One that only the library that fitted it can evaluate.
    Library(LibraryModel),
}

/// Predictions of a library at rows, or the reason for a failure.
pub type Predict = dyn Fn(&[f64]) -> Result<Vec<f64>, BaselineError>;

/// A fitted model inside a library.
pub struct LibraryModel {
    /// From standardized rows, shape `[rows, inputs]`, to standardized outputs, shape `[rows, outputs]`.
    pub predict: Box<Predict>,
    /// Memory of the model's numbers.
    pub memory_bytes: u64,
    /// Why it cannot be exported.
    pub not_exportable: &'static str,
}

/// Runs a library's function for each output, over all cores; results in the order of the outputs.
fn for_each_output<T: Send>(
    rows: &StandardizedRows,
    fit: impl Fn(usize) -> Result<T, BaselineError> + Send + Sync,
) -> Result<Vec<T>, BaselineError> {
    use rayon::prelude::*;
    (0..rows.outputs).into_par_iter().map(fit).collect()
}
