//! Dead times: number of samples after which outputs begin to follow an input. Models are learned from delayed inputs.

use super::{
    DiscreteSamples,
    linear::{gains, solve},
};
use crate::dataset::{Dataset, Run};
use metafmu_runtime::Graph;
use std::borrow::Cow;

/// Longest dead time, and the share of the shortest run that it may be.
const LONGEST: usize = 50;
const SHARE: usize = 4;
/// Past samples of the ARX models that are compared.
pub(super) const LAGS: usize = 4;
/// Rows of these.
const ROWS: usize = 10_000;
/// Ratio of the errors with and without a dead time below which an input is delayed; the smallest dead time with nearly
/// the least error is used.
const CLEAR: f64 = 0.5;
const NEARLY: f64 = 1.05;

/// Dead time of each input, in samples.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct DeadTimes(Vec<usize>);

impl DeadTimes {
    /// Dead times with which ARX models predict the next sample clearly better, one input after the other.
    pub fn of(step: f64, dataset: &Dataset) -> Self {
        let few = few(dataset);
        let mut found = Self(vec![0; dataset.inputs.len()]);
        // of a run that does not begin at rest, rows before its start have to be left
        let room = |run: &Run| match run.times.partition_point(|time| *time < 0.0) {
            0 => run.times.len() / SHARE,
            given => (given + 1).saturating_sub(LAGS).min(run.times.len() / SHARE),
        };
        let longest = few.runs.iter().map(room).min().unwrap_or(0).min(LONGEST);
        for input in 0..dataset.inputs.len() {
            let error = |samples: usize| {
                let mut tried = found.clone();
                tried.0[input] = samples;
                error(step, &tried.shifted(&few)).map(|error| (samples, error))
            };
            let errors: Vec<(usize, f64)> = (0..=longest).filter_map(error).collect();
            let least = errors.iter().map(|(_, error)| *error).fold(f64::INFINITY, f64::min);
            if errors.first().is_some_and(|(samples, error)| *samples == 0 && least < CLEAR * error) {
                let nearly = errors.iter().find(|(_, error)| *error <= NEARLY * least);
                found.0[input] = nearly.map_or(0, |(samples, _)| *samples);
            }
        }
        found
    }

    /// Returns true if an input has one.
    pub fn delays(&self, input: usize) -> bool {
        self.0[input] > 0
    }

    /// Longest dead time.
    pub fn longest(&self) -> usize {
        self.0.iter().copied().max().unwrap_or(0)
    }

    /// Runs with delayed inputs. In a run from rest, inputs before the start have their start values. Other runs lose the rows whose inputs are
    /// unknown.
    pub fn shifted<'a>(&self, dataset: &'a Dataset) -> Cow<'a, Dataset> {
        if self.longest() == 0 {
            return Cow::Borrowed(dataset);
        }
        let (inputs, outputs) = (dataset.inputs.len(), dataset.outputs.len());
        let of_run = |run: &Run| {
            let before = &run.parameters[run.parameters.len() - inputs..];
            let first = if run.times[0] < 0.0 { self.longest() } else { 0 };
            let late = |row: usize| {
                let of = move |(input, samples): (usize, &usize)| match row.checked_sub(*samples) {
                    Some(row) => run.inputs[row * inputs + input],
                    None => before[input],
                };
                self.0.iter().enumerate().map(of)
            };
            Run {
                parameters: run.parameters.clone(),
                times: run.times[first..].into(),
                inputs: (first..run.times.len()).flat_map(late).collect(),
                outputs: run.outputs[first * outputs..].to_vec(),
            }
        };
        Cow::Owned(Dataset { runs: dataset.runs.iter().map(of_run).collect(), ..dataset.clone() })
    }

    /// Graph of undelayed inputs, from one of delayed inputs, which has `numbers` of past outputs and hidden states and `history` samples of the inputs.
    pub fn delayed(&self, graph: &Graph, numbers: usize, history: usize) -> Graph {
        if self.longest() == 0 {
            return graph.clone();
        }
        let inputs = self.0.len();
        let all = (history + self.longest()) * inputs;
        let parameters = graph.inputs - numbers - history * inputs;
        let past = (0..history).flat_map(|lag| {
            self.0.iter().enumerate().map(move |(input, samples)| numbers + (lag + samples) * inputs + input)
        });
        let columns = (0..numbers).chain(past).chain(numbers + all..numbers + all + parameters);
        graph.clone().of_columns(numbers + all + parameters, columns)
    }

    /// Description for people, `u 20 samples`; None without dead time.
    pub fn describe(&self, dataset: &Dataset) -> Option<String> {
        let late = dataset.inputs.iter().zip(&self.0).filter(|(_, samples)| **samples > 0);
        let late: Vec<String> = late.map(|(input, samples)| format!("{} {samples} samples", input.name)).collect();
        (!late.is_empty()).then(|| late.join(", "))
    }
}

/// The first runs, enough for a linear model.
pub(super) fn few(dataset: &Dataset) -> Dataset {
    let mut rows = 0;
    let few = dataset.runs.iter().take_while(|run| {
        rows += run.times.len();
        rows - run.times.len() < ROWS
    });
    Dataset { runs: few.cloned().collect(), ..dataset.clone() }
}

/// Root mean square error of the next sample by an ARX model; none if it is not determined.
fn error(step: f64, dataset: &Dataset) -> Option<f64> {
    let samples = DiscreteSamples::new(step, dataset, dataset.runs.iter().collect(), Vec::new());
    let regressors = samples.regressors(&samples.training, [LAGS.min(samples.known); 2]);
    let gains = gains(&regressors, &solve(&regressors)?);
    Some(gains.iter().map(|gain| gain * gain).sum::<f64>().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::variable::SourceVariable;

    /// Runs of `y' = 0.9 y + 0.2 u + 0.1 v` with late inputs, from rest.
    fn dataset(late: [usize; 2]) -> Dataset {
        let value = |run: usize, row: usize| (0.37 * (run * 977 + row / 5) as f64).powi(2).sin();
        let run = |run: usize| {
            let rows = 200;
            let inputs: Vec<f64> = (0..rows).flat_map(|row| [value(run, row), value(run + 50, row)]).collect();
            let at = |input: usize, row: usize| row.checked_sub(late[input]).map_or(0.0, |row| inputs[2 * row + input]);
            let mut y = 0.0;
            let next = |row: usize| {
                let now = y;
                y = 0.9 * y + 0.2 * at(0, row) + 0.1 * at(1, row);
                now
            };
            let outputs = (0..rows).map(next).collect();
            let times = (0..rows).map(|row| row as f64).collect::<Vec<_>>().into();
            // starts of the output and of the inputs
            Run { parameters: vec![0.0; 3], times, inputs, outputs }
        };
        let [parameters, inputs, outputs] = [["y_start", "u_start", "v_start"].as_slice(), &["u", "v"], &["y"]]
            .map(|names| names.iter().map(|name| SourceVariable::new(name, "", "")).collect());
        Dataset { parameters, inputs, outputs, runs: (0..4).map(run).collect() }
    }

    #[test]
    fn each_input_has_its_dead_time() {
        assert_eq!(DeadTimes::of(1.0, &dataset([0, 0])), DeadTimes(vec![0, 0]));
        // four past samples reach three samples back
        let DeadTimes(found) = DeadTimes::of(1.0, &dataset([20, 0]));
        assert!((17..=20).contains(&found[0]) && found[1] == 0, "{found:?}");
    }

    #[test]
    fn late_inputs_are_those_of_samples_before() {
        let data = dataset([0, 0]);
        let late = DeadTimes(vec![3, 0]).shifted(&data).into_owned();
        let [found, of] = [&late.runs[1].inputs, &data.runs[1].inputs];
        assert_eq!(found[..8], [0.0, of[1], 0.0, of[3], 0.0, of[5], of[0], of[7]]);
    }
}
