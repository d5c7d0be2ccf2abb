//! Where in the parameters' ranges runs are placed.

use crate::study::{Method, ParameterOptions, Study};
use rand::{Rng, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use sobol::{Sobol, params::JoeKuoD6};

/// Parameter values of every run, training and test.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// One row of parameter values a training run.
    pub train: Vec<Vec<f64>>,
    /// One row of parameter values a test run, none of them a training run's.
    pub test: Vec<Vec<f64>>,
}

/// Parameters a Sobol plan can have: as many as there are direction numbers for.
pub const MAX_SOBOL_PARAMETERS: usize = 100;

/// What a stream of random numbers is for; streams of one seed are independent of each other.
#[derive(Clone, Copy, Debug)]
pub enum Stream {
    /// Placing training runs.
    Train = 1,
    /// Placing test runs.
    Test = 2,
    /// Choosing the runs held out for validation.
    Validation = 3,
}

/// The random numbers of a seed for one purpose: the same on every platform.
pub fn random(seed: u64, stream: Stream) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(stream as u64);
    generator
}

impl Plan {
    /// The study's plan; the same study always has the same one.
    pub fn new(study: &Study) -> Self {
        let parameters: Vec<&ParameterOptions> = study.parameters.values().collect();
        let (runs, generator) = (study.sampling.runs.unwrap_or(0), random(study.seed, Stream::Train));
        let train = match study.sampling.method {
            Method::Mesh => mesh(&parameters, study.sampling.levels),
            Method::Random => uniform(&parameters, generator).take(runs).collect(),
            Method::Sobol => sobol(&parameters, generator).take(runs).collect(),
        };
        let unseen = |point: &Vec<f64>| !train.contains(point);
        let test = uniform(&parameters, random(study.seed, Stream::Test)).filter(unseen).take(study.sampling.test_runs);
        Self { test: test.collect(), train }
    }
}

/// Every combination of evenly spaced levels; the last parameter changes fastest.
fn mesh(parameters: &[&ParameterOptions], levels: Option<usize>) -> Vec<Vec<f64>> {
    parameters.iter().fold(vec![Vec::new()], |points, parameter| {
        // a validated study has levels for every parameter
        let steps = parameter.levels.or(levels).unwrap_or(2).max(2) - 1;
        let level = |i: usize| parameter.min + (parameter.max - parameter.min) * i as f64 / steps as f64;
        let extend = |point: Vec<f64>| (0..=steps).map(move |i| [point.as_slice(), &[level(i)]].concat());
        points.into_iter().flat_map(extend).collect()
    })
}

/// Independent points, uniform over the ranges.
fn uniform(parameters: &[&ParameterOptions], mut generator: ChaCha8Rng) -> impl Iterator<Item = Vec<f64>> {
    let ranges: Vec<(f64, f64)> = parameters.iter().map(|parameter| (parameter.min, parameter.max)).collect();
    std::iter::repeat_with(move || {
        ranges.iter().map(|(min, max)| min + (max - min) * unit_interval(&mut generator)).collect()
    })
}

/// Sobol's sequence with the direction numbers of Joe and Kuo (2008), each coordinate shifted by a random binary number
/// (digital shift), which keeps its even spread: any first `n` points of a longer plan are the plan of `n`.
fn sobol(parameters: &[&ParameterOptions], mut generator: ChaCha8Rng) -> impl Iterator<Item = Vec<f64>> {
    const BITS: f64 = (1u64 << 53) as f64;
    let ranges: Vec<(f64, f64)> = parameters.iter().map(|parameter| (parameter.min, parameter.max)).collect();
    let shifts: Vec<u64> = ranges.iter().map(|_| generator.next_u64() >> 11).collect();
    Sobol::<f64>::new(ranges.len(), &JoeKuoD6::minimal()).map(move |point| {
        let shifted = point.iter().zip(&shifts).map(|(x, shift)| ((x * BITS) as u64 ^ shift) as f64 / BITS);
        shifted.zip(&ranges).map(|(x, (min, max))| min + (max - min) * x).collect()
    })
}

/// The numbers below `count` in random order.
pub fn permutation(count: usize, mut generator: ChaCha8Rng) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut generator);
    order
}

/// Uniform over `[0, 1)` with all 53 bits a double can hold there.
fn unit_interval(generator: &mut ChaCha8Rng) -> f64 {
    (generator.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn study(edit: impl Fn(String) -> String) -> Study {
        let text = edit(include_str!("../examples/single-pendulum.toml").to_owned());
        Study::parse(&text, Path::new("s.toml")).unwrap()
    }

    #[test]
    fn the_mesh_has_every_combination_once_and_both_ends() {
        let plan = Plan::new(&study(|text| text));
        assert_eq!(plan.train.len(), 11 * 11 * 11);
        assert_eq!(plan.train[0], [0.1, 0.0, 0.0]);
        assert_eq!(plan.train[1], [0.1, 0.0, 0.5]);
        assert_eq!(plan.train[1330], [0.2, 0.15, 5.0]);
        let mut sorted = plan.train.clone();
        sorted.sort_by(|a, b| a.partial_cmp(b).unwrap());
        sorted.dedup();
        assert_eq!(sorted.len(), 1331);
    }

    #[test]
    fn a_parameter_may_have_levels_of_its_own() {
        let plan = Plan::new(&study(|text| text.replacen("max = 0.2,", "max = 0.2, levels = 3,", 1)));
        assert_eq!(plan.train.len(), 3 * 11 * 11);
    }

    #[test]
    fn random_points_lie_in_the_ranges_and_repeat_for_a_seed_only() {
        let random = |text: String| {
            text.replace("method = \"mesh\"", "method = \"random\"").replace("levels = 11", "runs = 500")
        };
        let plan = Plan::new(&study(random));
        assert_eq!((plan.train.len(), plan.test.len()), (500, 200));
        for point in plan.train.iter().chain(&plan.test) {
            assert!(
                (0.1..0.2).contains(&point[0]) && (0.0..0.15).contains(&point[1]) && (0.0..5.0).contains(&point[2])
            );
        }
        assert_eq!(plan, Plan::new(&study(random)));
        assert_ne!(plan, Plan::new(&study(|text| random(text).replace("seed = 1", "seed = 2"))));
        let mean = plan.train.iter().map(|point| point[2]).sum::<f64>() / 500.0;
        assert!((mean - 2.5).abs() < 0.25, "the mean of 500 points is within 4 standard deviations: {mean}");
    }

    #[test]
    fn sobol_points_fill_every_cell_once_and_a_shorter_plan_begins_a_longer_one() {
        let sobol = |runs: usize| {
            let text = move |text: String| {
                text.replace("method = \"mesh\"", "method = \"sobol\"")
                    .replace("levels = 11", &format!("runs = {runs}"))
            };
            Plan::new(&study(text)).train
        };
        let points = sobol(1024);
        assert_eq!(points[..100], sobol(100));
        let ranges = [(0.1, 0.2), (0.0, 0.15), (0.0, 5.0)];
        let cell = |point: &[f64], column: usize, cells: f64| {
            ((point[column] - ranges[column].0) / (ranges[column].1 - ranges[column].0) * cells) as usize
        };
        for column in 0..3 {
            let mut seen = vec![0; 1024];
            points.iter().for_each(|point| seen[cell(point, column, 1024.0)] += 1);
            assert_eq!(seen, vec![1; 1024], "each 1024th of column {column} has one point");
        }
        // the first two coordinates are a (0, 2)-sequence: one point in each of 32 x 32 cells
        let mut seen = vec![0; 1024];
        points.iter().for_each(|point| seen[32 * cell(point, 0, 32.0) + cell(point, 1, 32.0)] += 1);
        assert_eq!(seen, vec![1; 1024]);
    }

    #[test]
    fn sobol_points_exist_up_to_the_stated_number_of_parameters() {
        let study = study(|text| text);
        let parameter = &study.parameters[0];
        let parameters = vec![parameter; MAX_SOBOL_PARAMETERS];
        assert_eq!(sobol(&parameters, random(1, Stream::Train)).next().unwrap().len(), MAX_SOBOL_PARAMETERS);
    }

    #[test]
    fn no_test_run_is_a_training_run() {
        let plan = Plan::new(&study(|text| text));
        assert!(plan.test.iter().all(|point| !plan.train.contains(point)));
    }
}
