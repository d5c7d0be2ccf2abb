//! Sums of powers of past samples (polynomial NARX).

use super::{DiscreteSamples, LearnedDiscrete};
use crate::{
    baselines::{Baseline, Fitted, StandardizedRows},
    study::baselines::Polynomial,
};
use metafmu_runtime::Graph;

/// Past samples at most: of more there are too many products.
const LONGEST: usize = 4;
const DEGREES: [u8; 3] = [3, 5, 7];
const MOST_TERMS: usize = 300;
/// Penalty of the coefficients, which keeps those of columns apart that are nearly the same.
const PENALTY: f64 = 1e-12;

/// Models of each length of the history and each degree with few enough terms. They give the change from sample to
/// sample. Models that the samples do not determine are dropped.
pub(super) fn learn(samples: &DiscreteSamples, history: usize) -> Vec<LearnedDiscrete> {
    let all = (1..=history.min(LONGEST)).flat_map(|length| DEGREES.map(|degree| (length, degree)));
    all.filter_map(|(length, degree)| of_degree(samples, [length; 2], degree)).collect()
}

fn of_degree(samples: &DiscreteSamples, history: [usize; 2], degree: u8) -> Option<LearnedDiscrete> {
    let rows = changes(samples, history);
    if terms(rows.inputs, degree) > MOST_TERMS || terms(rows.inputs, degree) > rows.len() {
        return None;
    }
    let model = Polynomial { degree: Some(degree), alpha: PENALTY, ..Polynomial::default() };
    let Ok(Fitted::Formula(polynomial)) = model.fit(&rows, 0) else { return None };
    let outputs = rows.outputs;
    // the outputs of the last sample are the first columns
    let last = (0..outputs * rows.inputs).map(|place| f64::from(u8::from(place / rows.inputs == place % rows.inputs)));
    let graph = Graph::of_samples(rows.inputs, last.collect(), vec![0.0; outputs], Some(polynomial));
    Some(LearnedDiscrete::solved(graph, history))
}

/// Columns of each sample, and the change of the outputs to the next one.
fn changes(samples: &DiscreteSamples, history: [usize; 2]) -> StandardizedRows {
    let regressors = samples.regressors(&samples.training, history);
    let rows = regressors.inputs.iter().zip(&regressors.outputs);
    let y = rows.flat_map(|(row, next)| next.iter().zip(row).map(|(next, now)| next - now)).collect();
    let mut scaling = samples.scaling(history);
    scaling.output_mean.fill(0.0);
    let [inputs, outputs] = [scaling.input_mean.len(), scaling.output_mean.len()];
    StandardizedRows { inputs, outputs, x: regressors.inputs.into_values(), y, scaling }
}

/// Number of products of powers of `columns` columns with a sum of at most `degree`.
fn terms(columns: usize, degree: u8) -> usize {
    (1..=usize::from(degree)).fold(1, |terms, k| terms * (columns + k) / k)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terms_are_those_of_pascals_triangle() {
        assert_eq!([terms(3, 5), terms(2, 1), terms(6, 3), terms(1, 7)], [56, 3, 84, 8]);
    }
}
