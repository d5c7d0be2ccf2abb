//! Runs in which an integration is hardest: ends of parameters and inputs, largest velocities.

use crate::{dataset::Run, source::driven::Driven, study::Study};
use metafmu_runtime::{Evaluator, Surrogate};
use nalgebra::{DMatrix, Schur};

/// A run along which an integration is measured.
#[derive(Clone, Debug)]
pub(super) struct IntegrationTrial {
    /// Its outputs are not used.
    pub run: Run,
    /// Description of the run, such as its corner.
    pub name: String,
}

/// Runs at corners at most.
const MOST_CORNERS: usize = 48;
/// Largest number of parameters of which all combinations of ends are tried.
const ALL_COMBINATIONS: usize = 4;
const COMBINATIONS: usize = 16;
/// Maximum number of iterations of the eigenvalue search.
const ITERATIONS: usize = 1000;

/// Values of the inputs all along a run.
const INPUTS: [&str; 3] = ["all inputs at their lower ends", "all inputs at their upper ends", "inputs zero"];

/// Velocities at the start of a run.
#[derive(Clone, Copy, PartialEq)]
enum StartSpeed {
    /// As sampled.
    Sampled,
    /// At the upper ends of their ranges.
    Upper,
    Lower,
    Alternating,
    /// At [`SLOW`] of the upper ends: a fast motion leaves the domain before it meets all that is inside, such as both stops of a slide.
    Slow,
}

/// Velocities of corners, of which a single velocity has no alternating ends.
const SPEEDS: [StartSpeed; 4] = [StartSpeed::Sampled, StartSpeed::Upper, StartSpeed::Lower, StartSpeed::Alternating];
/// Part of the largest velocity of a slow start.
const SLOW: f64 = 0.1;
/// Number of slow runs at most.
const SLOW_RUNS: usize = 8;

impl StartSpeed {
    /// Velocity at the start of the velocity with this number, or none if it is as sampled.
    fn velocity(self, number: usize, [low, high]: [f64; 2]) -> Option<f64> {
        match self {
            Self::Sampled => None,
            Self::Upper => Some(high),
            Self::Lower => Some(low),
            Self::Alternating => Some(if number.is_multiple_of(2) { low } else { high }),
            Self::Slow => Some(SLOW * high),
        }
    }

    /// Description, or none if it is as sampled.
    fn describe(self) -> Option<&'static str> {
        match self {
            Self::Sampled => None,
            Self::Upper | Self::Lower | Self::Alternating => Some("starting at the largest velocities"),
            Self::Slow => Some("starting at a tenth of the largest velocities"),
        }
    }
}

/// Corners of the domain: combinations of the ends of all parameters, constant inputs at both ends and zero, and
/// initial states. These are those of the training runs, or at the ends of the velocities' ranges. `velocities`: range
/// of each state that is a velocity with one. With more than [`ALL_COMBINATIONS`] parameters, the combination in which
/// `surrogate` is stiffest is added.
pub(super) fn corners(
    study: &Study,
    driven: &Driven,
    runs: &[Run],
    velocities: &[Option<[f64; 2]>],
    surrogate: &Surrogate,
) -> Vec<IntegrationTrial> {
    let Some(first) = runs.first() else { return Vec::new() };
    let ranges: Vec<(&String, [f64; 2])> =
        study.parameters.iter().map(|(name, range)| (name, [range.min, range.max])).collect();
    let combinations = if ranges.len() <= ALL_COMBINATIONS { 1 << ranges.len() } else { COMBINATIONS };
    let inputs = if driven.drivers().is_empty() { 1 } else { INPUTS.len() };
    let moving = velocities.iter().flatten().count();
    let speeds = match moving {
        0 => 1,
        1 => SPEEDS.len() - 1,
        _ => SPEEDS.len(),
    };
    let total = combinations * inputs * speeds;
    let count = total.min(MOST_CORNERS);
    // evenly spread: every part of all combinations has its share
    let index = |corner: usize| corner * total / count;
    let trial = |base: &Run, upper: &[bool], input: usize, speed: StartSpeed| {
        let mut names = Vec::new();
        let mut parameters = base.parameters.clone();
        for (column, (name, ends)) in ranges.iter().enumerate() {
            parameters[column] = ends[usize::from(upper[column])];
            names.push(format!("{name} = {}", parameters[column]));
        }
        let starts = parameters.len() - velocities.len();
        let moving = velocities.iter().enumerate().filter_map(|(state, range)| Some((state, (*range)?)));
        for (number, (state, range)) in moving.enumerate() {
            if let Some(velocity) = speed.velocity(number, range) {
                parameters[starts + state] = velocity;
            }
        }
        if driven.drivers().is_empty() {
            names.extend((names.is_empty() && speed == StartSpeed::Sampled).then(|| "a start as drawn".to_owned()));
        } else {
            names.push(INPUTS[input].to_owned());
        }
        names.extend(speed.describe().map(str::to_owned));
        let values = driven.drivers().iter().map(|driver| match input {
            0 => driver.min,
            1 => driver.max,
            _ => 0f64.clamp(driver.min, driver.max),
        });
        let values: Vec<f64> = values.collect();
        let inputs = first.times.iter().flat_map(|_| values.iter().copied()).collect();
        let run = Run { parameters, times: first.times.clone(), inputs, outputs: Vec::new() };
        IntegrationTrial { run, name: names.join(", ") }
    };
    let combination =
        |number: usize| (0..ranges.len()).map(|column| is_upper(number, column, ranges.len())).collect::<Vec<bool>>();
    let corner = |corner: usize| {
        let index = index(corner);
        let upper = combination(index / speeds / inputs);
        trial(&runs[corner % runs.len()], &upper, index / speeds % inputs, SPEEDS[index % speeds])
    };
    let mut trials: Vec<IntegrationTrial> = (0..count).map(corner).collect();
    if ranges.len() > ALL_COMBINATIONS {
        let ends: Vec<[f64; 2]> = ranges.iter().map(|(_, ends)| *ends).collect();
        let stiffest = stiffest(surrogate, first, &ends, (0..combinations).map(combination));
        trials.extend((0..inputs).map(|input| trial(first, &stiffest, input, StartSpeed::Sampled)));
    }
    let slow = if moving > 0 { combinations.min(SLOW_RUNS) } else { 0 };
    trials.extend((0..slow).map(|number| {
        let upper = combination(number * combinations / slow);
        trial(&runs[number % runs.len()], &upper, inputs - 1, StartSpeed::Slow)
    }));
    trials
}

/// Combination of ends with the largest eigenvalue at the start of a run. Local search from each given combination, one end at a time.
fn stiffest(
    surrogate: &Surrogate,
    run: &Run,
    ends: &[[f64; 2]],
    combinations: impl Iterator<Item = Vec<bool>>,
) -> Vec<bool> {
    let mut evaluator = Evaluator::new(surrogate);
    let mut stiffness = |upper: &[bool]| {
        let mut point = vec![0.0; evaluator.columns()];
        point[..run.parameters.len()].copy_from_slice(&run.parameters);
        for ((value, ends), upper) in point.iter_mut().zip(ends).zip(upper) {
            *value = ends[usize::from(*upper)];
        }
        evaluator.start(&mut point);
        let (first, states) = (surrogate.inputs().len(), surrogate.states().len());
        let mut jacobian = DMatrix::zeros(states, states);
        for state in 0..states {
            let (mut direction, mut derivative) = (vec![0.0; point.len()], vec![0.0; evaluator.results()]);
            direction[first + state] = 1.0;
            evaluator.directional(&point, &direction, &mut derivative);
            jacobian.column_mut(state).copy_from_slice(&derivative[surrogate.outputs().len()..]);
        }
        // what cannot be computed is found by other checks
        let is_finite = jacobian.iter().all(|value: &f64| value.is_finite());
        let schur = if is_finite { Schur::try_new(jacobian, f64::EPSILON, ITERATIONS) } else { None };
        let eigenvalues = schur.map(|schur| schur.complex_eigenvalues());
        eigenvalues.map_or(0.0, |values| values.iter().map(|value| value.norm()).fold(0.0, f64::max))
    };
    let climb = |mut upper: Vec<bool>| {
        let mut best = stiffness(&upper);
        loop {
            let before = best;
            for parameter in 0..upper.len() {
                upper[parameter] ^= true;
                let found = stiffness(&upper);
                upper[parameter] ^= found <= best;
                best = best.max(found);
            }
            if best <= before {
                return (best, upper);
            }
        }
    };
    combinations.map(climb).max_by(|a, b| a.0.total_cmp(&b.0)).map_or_else(Vec::new, |(_, upper)| upper)
}

/// Returns true if a parameter is at its upper end in a combination. Few parameters have all combinations, many have
/// the rows of a Hadamard matrix. In these rows each pair of parameters has all four combinations, and each row has its
/// opposite.
fn is_upper(combination: usize, parameter: usize, parameters: usize) -> bool {
    if parameters <= ALL_COMBINATIONS {
        return combination >> parameter & 1 == 1;
    }
    let half = COMBINATIONS / 2;
    let row = (combination % half) & (1 + parameter % (half - 1));
    (row.count_ones() % 2 == 1) ^ (combination >= half)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pair_of_up_to_seven_parameters_is_at_all_four_combinations_of_ends() {
        for parameters in 1..=7 {
            let combinations = if parameters <= ALL_COMBINATIONS { 1 << parameters } else { COMBINATIONS };
            for (one, other) in (0..parameters).flat_map(|one| (0..one).map(move |other| (one, other))) {
                let ends = (0..combinations)
                    .map(|combination| [one, other].map(|parameter| is_upper(combination, parameter, parameters)));
                let found: std::collections::HashSet<[bool; 2]> = ends.collect();
                assert_eq!(found.len(), 4, "{one} and {other} of {parameters}");
            }
        }
    }
}
