//! Noise of measured outputs, apart from the error of the model that is compared with them.

use serde::{Deserialize, Serialize};

/// Parts of the differences between measured and simulated outputs, in the output's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseEstimate {
    /// Standard deviation of the noise: of the part that is white, and independent of inputs.
    pub noise: f64,
    /// Root mean square of the remainder, the error of the model.
    pub model_error: f64,
    /// `true` if the remainder is too small beside the noise to be measured: then `model_error` is a limit of it.
    pub is_limit: bool,
}

impl NoiseEstimate {
    /// Description for people, of an output with this name and unit; `has_bound`: `true` if it has an error bound.
    pub fn describe(&self, name: &str, unit: &str, has_bound: bool) -> String {
        let with_unit = |value: f64| format!("{value:.2e} {unit}").trim_end().to_owned();
        let limit = if self.is_limit { "at most about" } else { "about" };
        let bound = if has_bound { "; the bound is that of measured values, which includes the noise" } else { "" };
        let (noise, error) = (with_unit(self.noise), with_unit(self.model_error));
        format!("{name}: noise of about {noise}, error of the model without it {limit} {error}{bound}")
    }
}

/// Lags of the autocovariance that determine the part that is not white.
const LAGS: usize = 4;
/// Lags up to which differences must be independent of inputs and of each other.
const INDEPENDENT: usize = 12;

/// Estimates the noise from the differences `e` of consecutive rows of runs, each with its inputs, shape `[rows, inputs]`; none if the differences
/// show no noise. `deviation`: standard deviation of the output.
///
/// Noise is white, the error of a model is smooth: the autocovariance `r` of the sum is that of the error at all lags but 0. It is extrapolated to lag 0
/// by a parabola, `r(k) = a + b k²` for k from 1 to 4 by least squares; the variance of the noise is `r(0) - a`, the mean square error of the
/// model is `a`. A rough error is no noise: `e[k] - (e[k - 1] + e[k + 1]) / 2` must have no correlation with itself from lag 3 on, nor with
/// inputs and their changes, nor its square with the squared changes.
pub(super) fn estimate(runs: &[(Vec<f64>, &[f64])], deviation: f64) -> Option<NoiseEstimate> {
    let rows: f64 = runs.iter().map(|(differences, _)| differences.len() as f64).sum();
    // fewer do not tell parts apart
    if rows < 200.0 {
        return None;
    }
    let differences: Vec<&[f64]> = runs.iter().map(|(differences, _)| differences.as_slice()).collect();
    let total = covariance(&differences, &differences, 0)?;
    let squares = |lag: usize| (lag * lag) as f64;
    let mean = (1..=LAGS).map(squares).sum::<f64>() / LAGS as f64;
    let spread: f64 = (1..=LAGS).map(|lag| (squares(lag) - mean).powi(2)).sum();
    let weight = |lag: usize| 1.0 / LAGS as f64 - mean * (squares(lag) - mean) / spread;
    let mut smooth = 0.0;
    for lag in 1..=LAGS {
        smooth += weight(lag) * covariance(&differences, &differences, lag)?;
    }
    // of white differences
    let standard_error = total * ((1..=LAGS).map(|lag| weight(lag).powi(2)).sum::<f64>() / rows).sqrt();
    let variance = total - smooth.max(0.0);
    let is_large = variance > (1e-3 * deviation).powi(2) && variance > 0.1 * total;
    if !(is_large && is_independent(runs, rows)) {
        return None;
    }
    let is_limit = smooth < 2.0 * standard_error;
    let model = if is_limit { smooth.max(0.0) + 2.0 * standard_error } else { smooth };
    Some(NoiseEstimate { noise: variance.sqrt(), model_error: model.sqrt(), is_limit })
}

/// Mean product of a row and the row of another signal `lag` rows before.
fn covariance(signals: &[&[f64]], others: &[&[f64]], lag: usize) -> Option<f64> {
    let pairs = || signals.iter().zip(others).flat_map(|(a, b)| a.iter().skip(lag).zip(*b));
    let count = pairs().count();
    (count > 0).then(|| pairs().map(|(a, b)| a * b).sum::<f64>() / count as f64).filter(|mean| mean.is_finite())
}

fn is_independent(runs: &[(Vec<f64>, &[f64])], rows: f64) -> bool {
    let centred = |mut signals: Vec<Vec<f64>>| {
        let mean = signals.iter().flatten().sum::<f64>() / signals.iter().map(Vec::len).sum::<usize>().max(1) as f64;
        signals.iter_mut().flatten().for_each(|value| *value -= mean);
        signals
    };
    let rough: Vec<Vec<f64>> =
        runs.iter().map(|(e, _)| e.windows(3).map(|three| three[1] - 0.5 * (three[0] + three[2])).collect()).collect();
    let squared = |signals: &[Vec<f64>]| -> Vec<Vec<f64>> {
        centred(signals.iter().map(|signal| signal.iter().map(|value| value * value).collect()).collect())
    };
    let is_uncorrelated = |signals: &[Vec<f64>], others: &[Vec<f64>], first: usize| {
        let [signals, others] = [signals, others].map(|all| all.iter().map(Vec::as_slice).collect::<Vec<_>>());
        let variance = |of: &[&[f64]]| covariance(of, of, 0).unwrap_or(0.0);
        let scale = (variance(&signals) * variance(&others)).sqrt();
        // neighbors are correlated by the difference: its correlations are -2/3 and 1/6
        // 4.5 standard errors, and what is too small to matter
        let limit = 0.02 + 4.5 * (1.95 / rows).sqrt();
        scale == 0.0
            || (first..=INDEPENDENT)
                .all(|lag| covariance(&signals, &others, lag).is_none_or(|found| found.abs() <= limit * scale))
    };
    let of_squares = squared(&rough);
    if !is_uncorrelated(&rough, &rough, 3) {
        return false;
    }
    let inputs = runs.iter().map(|(e, inputs)| inputs.len() / e.len().max(1)).max().unwrap_or(0);
    (0..inputs).all(|input| {
        // at the rows of the rough part, and one later: what comes with a lag of 0 is one row ahead
        let values: Vec<Vec<f64>> = runs
            .iter()
            .map(|(_, all)| all.iter().skip(input).step_by(inputs).skip(1).copied().collect::<Vec<f64>>())
            .collect();
        let changes: Vec<Vec<f64>> =
            values.iter().map(|values| values.windows(2).map(|two| two[1] - two[0]).collect()).collect();
        is_uncorrelated(&rough, &centred(values), 0)
            && is_uncorrelated(&rough, &changes, 0)
            && is_uncorrelated(&of_squares, &squared(&changes), 0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};

    const ROWS: usize = 2000;

    /// White noise of deviation 1.
    fn white(seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..ROWS).map(|_| (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0).collect()
    }

    /// Inputs that are constant over five rows.
    fn held() -> Vec<f64> {
        white(9).into_iter().step_by(5).flat_map(|value| [value; 5]).collect()
    }

    fn of(differences: Vec<f64>, inputs: &[f64]) -> Option<NoiseEstimate> {
        estimate(&[(differences, inputs)], 20.0)
    }

    #[test]
    fn noise_and_a_smooth_error_are_told_apart() {
        let inputs = held();
        for (seed, amplitude) in [(1, 0.5), (2, 1.0), (3, 2.0)] {
            let error = |row: usize| amplitude * (0.3 * row as f64).sin();
            let differences = white(seed).iter().enumerate().map(|(row, noise)| noise + error(row)).collect();
            let NoiseEstimate { noise, model_error, is_limit } = of(differences, &inputs).unwrap();
            assert!((noise - 1.0).abs() < 0.1 && !is_limit, "{noise}");
            let ratio = model_error / (amplitude / 2f64.sqrt());
            assert!((0.7..1.4).contains(&ratio), "{ratio}");
        }
        let alone = of(white(4), &inputs).unwrap();
        assert!((alone.noise - 1.0).abs() < 0.05 && alone.is_limit && alone.model_error < 0.3, "{alone:?}");
    }

    #[test]
    fn errors_of_a_model_alone_are_no_noise() {
        let inputs = held();
        assert_eq!(of((0..ROWS).map(|row| (0.3 * row as f64).sin()).collect(), &inputs), None);
        // each change of the input makes an error of one row, or one of a sign that the input does not tell
        let change = |row: usize| if row == 0 { 0.0 } else { inputs[row] - inputs[row - 1] };
        assert_eq!(of((0..ROWS).map(change).collect(), &inputs), None);
        assert_eq!(of(white(5).iter().enumerate().map(|(row, sign)| sign * change(row)).collect(), &inputs), None);
        assert_eq!(of(white(6).iter().map(|noise| 1e-3 * noise).collect(), &inputs), None, "rounding");
        assert_eq!(of(white(7)[..100].to_vec(), &inputs[..100]), None, "few rows");
    }
}
