//! Outputs that do not vary but for rounding.

use super::Dataset;
use crate::variable::SourceVariable;

/// Differences of an output's values that are rounding, not motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rounding {
    /// Share of the output's own largest value.
    pub own: f64,
    /// Share of the largest value of any parameter, input and output of the same unit.
    pub of_unit: f64,
    /// Difference in m, rad and their rates, of a source that computes in them; else 0.
    pub of_motion: f64,
}

/// Units of coordinates and of their rates.
const MOTION: [&str; 6] = ["m", "rad", "m/s", "rad/s", "m/s2", "rad/s2"];

impl Rounding {
    /// Rounding of third-party values: a few units in the last place of a double.
    pub const OF_DOUBLES: Self = Self { own: 1e-14, of_unit: 1e-15, of_motion: 0.0 };

    /// Rounding of mechanisms and built-in systems: ten times the resolution of the finest integration tolerance. In m
    /// and rad it is a thousandth of that where no other value of the unit is known.
    pub const OF_SIMULATIONS: Self = Self { own: 1e-12, of_unit: 1e-12, of_motion: 1e-16 };

    /// Largest difference of each output's values that is rounding.
    fn limits(&self, dataset: &Dataset) -> Vec<f64> {
        let largest = |of: fn(&super::Run) -> &[f64], width: usize| {
            let mut largest = vec![0.0f64; width];
            for row in dataset.runs.iter().flat_map(|run| of(run).chunks(width.max(1))) {
                largest.iter_mut().zip(row).for_each(|(largest, value)| *largest = largest.max(value.abs()));
            }
            largest
        };
        let of = |variables: &[SourceVariable], values: Vec<f64>| -> Vec<(String, f64)> {
            variables.iter().map(|variable| variable.unit.clone()).zip(values).collect()
        };
        let outputs = largest(|run| &run.outputs, dataset.outputs.len());
        let known = [
            of(&dataset.parameters, largest(|run| &run.parameters, dataset.parameters.len())),
            of(&dataset.inputs, largest(|run| &run.inputs, dataset.inputs.len())),
            of(&dataset.outputs, outputs.clone()),
        ]
        .concat();
        let limit = |(variable, own): (&SourceVariable, &f64)| {
            let unit = variable.unit.as_str();
            // values without a unit need not be of one kind
            let same = known.iter().filter(|(other, _)| !unit.is_empty() && other == unit).map(|(_, value)| *value);
            let of_motion = if MOTION.contains(&unit) { self.of_motion } else { 0.0 };
            (self.own * own).max(self.of_unit * same.fold(0.0, f64::max)).max(of_motion)
        };
        dataset.outputs.iter().zip(&outputs).map(limit).collect()
    }
}

/// Replaces outputs that vary in the training runs by rounding only with their constant. This applies to these runs,
/// and to the runs of each other set that differ from the constant by rounding only. Returns the positions of the
/// constant outputs, and the constants.
pub fn settle(train: &mut Dataset, others: [&mut Dataset; 2], rounding: Rounding) -> Vec<(usize, f64)> {
    let limits = rounding.limits(train);
    let (mut constants, mut changed) = (Vec::new(), Vec::new());
    for (output, &limit) in limits.iter().enumerate() {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        values(train, output).for_each(|value| (low, high) = (low.min(value), high.max(value)));
        // NaN varies, and so do no rows
        let is_constant = high - low <= limit;
        if !is_constant {
            continue;
        }
        // the first value is that of the start, before rounding adds up
        let first = values(train, output).next().unwrap_or(0.0);
        let constant = if low.abs().max(high.abs()) <= limit { 0.0 } else { first };
        constants.push((output, constant));
        changed.extend((high > low).then_some((output, constant)));
        set(train, output, constant);
    }
    for other in others {
        for &(output, constant) in &constants {
            let limit = limits[output];
            if values(other, output).all(|value| (value - constant).abs() <= limit) {
                set(other, output, constant);
            }
        }
    }
    changed
}

fn values(dataset: &Dataset, output: usize) -> impl Iterator<Item = f64> {
    let width = dataset.outputs.len();
    dataset.runs.iter().flat_map(move |run| run.outputs.iter().skip(output).step_by(width).copied())
}

fn set(dataset: &mut Dataset, output: usize, constant: f64) {
    let width = dataset.outputs.len();
    for run in &mut dataset.runs {
        run.outputs.iter_mut().skip(output).step_by(width).for_each(|value| *value = constant);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Run;

    /// A run of outputs `x` in m, `y` in m, `f` in N and `n` without a unit.
    fn dataset(rows: &[[f64; 4]]) -> Dataset {
        let variable = |(name, unit): (&str, &str)| SourceVariable::new(name, unit, "");
        Dataset {
            parameters: vec![variable(("mass", "kg"))],
            inputs: Vec::new(),
            outputs: [("x", "m"), ("y", "m"), ("f", "N"), ("n", "")].map(variable).into(),
            runs: vec![Run {
                parameters: vec![2.0],
                times: (0..rows.len()).map(|row| row as f64).collect(),
                inputs: Vec::new(),
                outputs: rows.concat(),
            }],
        }
    }

    fn settled(rows: &[[f64; 4]], test: &[[f64; 4]], rounding: Rounding) -> (Vec<(usize, f64)>, Dataset) {
        let (mut train, mut test, mut none) = (dataset(rows), dataset(test), dataset(&[]));
        let found = settle(&mut train, [&mut test, &mut none], rounding);
        for (output, constant) in &found {
            assert!(values(&train, *output).all(|value| value == *constant));
        }
        (found, test)
    }

    #[test]
    fn rounding_noise_is_the_constant_that_it_surrounds_and_small_motion_stays() {
        let simulated = Rounding::OF_SIMULATIONS;
        // noise of 1e-30 m where nothing else is in m, of a mechanism only
        let at_rest = [[0.0, 0.0, 1.0, 1.0], [2e-30, -1e-30, 1.0, 2.0]];
        let (found, test) = settled(&at_rest, &[[0.0, 3e-30, 1.0, 0.0]], simulated);
        assert_eq!(found, [(0, 0.0), (1, 0.0)]);
        assert_eq!(test.runs[0].outputs, [0.0, 0.0, 1.0, 0.0]);
        assert_eq!(settled(&at_rest, &[], Rounding::OF_DOUBLES).0, []);
        // relative to another output of the unit, never to one without
        let beside = [[1.0, 1e-17, 1.0, 1e-17], [2.0, 3e-17, 2.0, 3e-17]];
        assert_eq!(settled(&beside, &[], Rounding::OF_DOUBLES).0, [(1, 0.0)]);
        // a nanometre beside a metre is motion, and so is a force of 1e-30 N
        let small = [[1.0, 1e-9, 1e-30, 0.5], [1.0, 2e-9, 2e-30, 0.5]];
        assert_eq!(settled(&small, &[], simulated).0, []);
    }

    #[test]
    fn test_runs_in_which_a_constant_output_moves_keep_their_values() {
        let train = [[0.5, 1.0, 0.0, 0.0], [0.5 + 1e-16, 2.0, 1.0, 1.0]];
        let (found, test) = settled(&train, &[[0.6, 1.0, 0.0, 0.0]], Rounding::OF_DOUBLES);
        assert_eq!((found, test.runs[0].outputs[0]), (vec![(0, 0.5)], 0.6));
    }
}
