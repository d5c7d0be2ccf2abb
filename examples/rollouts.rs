//! Equations of motion learned by structure, rolled out on unseen inputs beside the mechanisms: prints the table of
//! docs/multibody.md.
//!
//!     cargo run --release --example rollouts

use metafmu::{
    dynamics::{FittedEquations, QuantityRange, Region, fit},
    integrate::{Budget, TOLERANCE, integrate},
    multibody::Mechanism,
    signal::{Signal, SineTerm},
};
use metafmu_runtime::{DynamicsScratch, StatePoint};
use nalgebra::{DVector, SVector};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use std::{cell::RefCell, error::Error, f64::consts::PI, path::Path, time::Instant};

/// A mechanism, where its equations are learned, and how its runs begin.
struct Case {
    file: &'static str,
    coordinates: &'static [(&'static str, f64, f64)],
    parameters: &'static [&'static str],
    start: &'static [(&'static str, f64, f64)],
    /// Parameters without which energy is conserved; `None` if it never is.
    damping: Option<&'static [&'static str]>,
    /// Highest frequency of the inputs, in Hz.
    bandwidth: f64,
}

const CASES: [Case; 6] = [
    Case {
        file: "pendulum",
        coordinates: &[("pivot.angle", -PI, PI)],
        parameters: &["L", "m", "c"],
        start: &[("theta0", -1.0, 1.0), ("thetad0", -1.0, 1.0)],
        damping: Some(&["c"]),
        bandwidth: 1.0,
    },
    Case {
        file: "crane",
        coordinates: &[("rail.position", -5.0, 5.0), ("rope.angle", -PI, PI)],
        parameters: &["l", "m", "b"],
        start: &[("x0", -1.0, 1.0), ("theta0", -0.5, 0.5)],
        damping: Some(&["b"]),
        bandwidth: 1.0,
    },
    Case {
        file: "double-pendulum",
        coordinates: &[("shoulder.angle", -PI, PI), ("elbow.angle", -PI, PI)],
        parameters: &["L1", "L2"],
        start: &[("theta10", -0.4, 0.4), ("theta20", -0.4, 0.4)],
        damping: Some(&[]),
        bandwidth: 0.5,
    },
    Case {
        file: "quarter-car",
        coordinates: &[("strut.position", -0.2, 0.2), ("hub.position", -0.2, 0.2)],
        parameters: &["k", "c", "m"],
        start: &[("z0", -0.05, 0.05)],
        damping: None,
        bandwidth: 5.0,
    },
    Case {
        file: "slider-crank",
        coordinates: &[("A.angle", 0.0, 2.0 * PI)],
        parameters: &["m", "c"],
        start: &[("theta0", 0.2, 1.0), ("thetad0", 2.0, 5.0)],
        damping: Some(&["c"]),
        bandwidth: 1.0,
    },
    Case {
        file: "four-bar",
        coordinates: &[("A.angle", 0.0, 2.0 * PI)],
        parameters: &["k", "c"],
        start: &[("theta0", 0.4, 1.2), ("thetad0", 6.0, 12.0)],
        damping: Some(&["c"]),
        bandwidth: 1.0,
    },
];

const RUNS: u64 = 20;
/// Rows of a roll-out, 0.05 s each.
const ROWS: usize = 1200;

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "| mechanism | harmonics, powers | products | fit, s | unseen error | 10 s, median, 90 % | 60 s, median, 90 % | start perturbed by 1e-9 | energy |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for case in &CASES {
        let path = Path::new("examples/dynamics").join(case.file).with_extension("toml");
        let mechanism = Mechanism::load(&path)?;
        match case.coordinates.len() {
            1 => report::<3>(case, &mechanism)?,
            _ => report::<5>(case, &mechanism)?,
        }
    }
    Ok(())
}

/// `STATES`: two for each coordinate, and the time.
fn report<const STATES: usize>(case: &Case, mechanism: &Mechanism) -> Result<(), Box<dyn Error>> {
    let range = |name: &&str| {
        let parameter = &mechanism.parameters()[*name];
        QuantityRange::new(name, parameter.min.unwrap_or(0.0), parameter.max.unwrap_or(1.0))
    };
    let region = Region {
        coordinates: case.coordinates.iter().map(|(name, min, max)| QuantityRange::new(name, *min, *max)).collect(),
        parameters: case.parameters.iter().map(range).collect(),
        ..Region::default()
    };
    let began = Instant::now();
    let fitted = fit(mechanism, &region, 1)?;
    let seconds = began.elapsed().as_secs_f64();
    let mut errors = [Vec::new(), Vec::new(), Vec::new()];
    let mut energies = Vec::new();
    for seed in 0..RUNS {
        let run = Run::new(case, mechanism, &region, seed);
        let truth = run.truth(mechanism, 0.0)?;
        let found = run.rollout::<STATES>(&fitted, true)?;
        for (errors, rows) in errors.iter_mut().zip([ROWS / 6, ROWS]) {
            errors.push(relative_error(&truth[..=rows], &found[..=rows]));
        }
        errors[2].push(relative_error(&truth, &run.truth(mechanism, 1e-9)?));
        if let Some(damping) = case.damping {
            energies.push(run.without(mechanism, case, damping).energy_trend::<STATES>(mechanism, &region, &fitted)?);
        }
    }
    let [ten, sixty, sensitivity] = errors.map(quantiles);
    let energy = if energies.is_empty() { "-".to_owned() } else { format!("{:.0e}", quantiles(energies).0) };
    println!(
        "| {} | {}, {} | {} | {seconds:.1} | {:.0e} | {:.0e}, {:.0e} | {:.0e}, {:.0e} | {:.0e}, {:.0e} | {energy} |",
        case.file,
        fitted.order[0],
        fitted.order[1],
        fitted.dynamics.function_set().dictionary().products(),
        fitted.error,
        ten.0,
        ten.1,
        sixty.0,
        sixty.1,
        sensitivity.0,
        sensitivity.1,
    );
    Ok(())
}

/// Median and 90 % quantile.
fn quantiles(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    (values[values.len() / 2], values[values.len() * 9 / 10])
}

/// Values of all parameters, signals of the inputs, and those of the parameters that vary.
struct Run {
    values: Vec<f64>,
    start: usize,
    signals: Vec<Signal>,
    parameters: Vec<f64>,
    initial: (Vec<f64>, Vec<f64>),
}

impl Run {
    fn new(case: &Case, mechanism: &Mechanism, region: &Region, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(1000 + seed);
        let mut within = |min: f64, max: f64| min + random.random::<f64>() * (max - min);
        let known = mechanism.parameters();
        let mut values: Vec<f64> = known.values().map(|parameter| parameter.default).collect();
        let position = |name: &str| known.get_index_of(name).expect("a parameter of the mechanism");
        let mut parameters = Vec::new();
        for range in &region.parameters {
            parameters.push(within(range.min, range.max));
            values[position(&range.name)] = parameters[parameters.len() - 1];
        }
        for (name, min, max) in case.start {
            values[position(name)] = within(*min, *max);
        }
        // ten sines of random frequencies and phases that together stay within the range
        let signals = mechanism.inputs().values().map(|input| {
            let (middle, half) = (0.5 * (input.min + input.max), 0.5 * (input.max - input.min));
            let sines = (0..10).map(|_| SineTerm {
                amplitude: 0.2 * half,
                frequency: within(0.05, 1.0) * case.bandwidth,
                phase: within(0.0, 2.0 * PI),
            });
            Signal::Multisine { offset: middle, sines: sines.collect() }
        });
        let signals = signals.collect();
        let start = position(case.start[0].0);
        let mut run = Self { values, start, signals, parameters, initial: Default::default() };
        run.begin(mechanism, case);
        run
    }

    /// Sets the state at the start, as the mechanism has it.
    fn begin(&mut self, mechanism: &Mechanism, case: &Case) {
        let names: Vec<&str> = case.coordinates.iter().map(|(name, ..)| *name).collect();
        let reduced = mechanism.reduced(&self.values, &names).expect("the mechanism can be assembled");
        let (q, v) = reduced.start();
        self.initial = (q.as_slice().to_vec(), v.as_slice().to_vec());
    }

    /// Removes damping and inputs.
    fn without(mut self, mechanism: &Mechanism, case: &Case, damping: &[&str]) -> Self {
        for name in damping {
            let index = case.parameters.iter().position(|known| known == name).expect("a parameter that varies");
            self.parameters[index] = 0.0;
            self.values[mechanism.parameters().get_index_of(*name).expect("a parameter")] = 0.0;
        }
        self.signals.iter_mut().for_each(|signal| *signal = Signal::Constant(0.0));
        self
    }

    /// Coordinates of the mechanism, with its start perturbed by `off`.
    fn truth(&self, mechanism: &Mechanism, off: f64) -> Result<Vec<Vec<f64>>, String> {
        let mut values = self.values.clone();
        values[self.start] += off;
        let rows = mechanism.simulate_driven(&values, &self.signals, &times(), TOLERANCE, &Budget::default())?;
        Ok(rows.chunks(mechanism.outputs().len()).map(<[f64]>::to_vec).collect())
    }

    /// States of the learned equations, integrated as exactly as those of the mechanism: what differs is what was learned. Of
    /// `coordinates_only` without the rates.
    fn rollout<const STATES: usize>(
        &self,
        fitted: &FittedEquations,
        coordinates_only: bool,
    ) -> Result<Vec<Vec<f64>>, String> {
        let n = fitted.dynamics.coordinates();
        let work: RefCell<(Vec<f64>, DynamicsScratch)> = RefCell::new((vec![0.0; n], fitted.dynamics.scratch()));
        let derivative = |y: &SVector<f64, STATES>| {
            let (accelerations, scratch) = &mut *work.borrow_mut();
            let (q, v) = (&y.as_slice()[..n], &y.as_slice()[n..2 * n]);
            let u: Vec<f64> = self.signals.iter().map(|signal| signal.value(y[2 * n])).collect();
            fitted.dynamics.accelerations(StatePoint { q, v, u: &u, p: &self.parameters }, accelerations, scratch);
            SVector::from_iterator(v.iter().chain(&*accelerations).copied().chain([1.0]))
        };
        let (q, v) = &self.initial;
        let initial = SVector::from_iterator(q.iter().chain(v).copied().chain([0.0]));
        let states = integrate(derivative, initial, &times(), TOLERANCE, &Budget::default());
        let states = states.map_err(|error| error.to_string())?;
        let length = if coordinates_only { n } else { 2 * n };
        Ok(states.iter().map(|state| state.as_slice()[..length].to_vec()).collect())
    }

    /// Largest change of the mechanism's energy along the learned motion, relative to the largest kinetic energy.
    fn energy_trend<const STATES: usize>(
        &self,
        mechanism: &Mechanism,
        region: &Region,
        fitted: &FittedEquations,
    ) -> Result<f64, String> {
        let names: Vec<&str> = region.coordinates.iter().map(|range| range.name.as_str()).collect();
        let reduced = mechanism.reduced(&self.values, &names)?;
        let n = names.len();
        let (mut energies, mut largest) = (Vec::new(), 0.0f64);
        for state in self.rollout::<STATES>(fitted, false)?.iter().step_by(10) {
            let terms = reduced.terms(&DVector::from_column_slice(&state[..n]))?;
            let rates = DVector::from_column_slice(&state[n..]);
            let kinetic = 0.5 * rates.dot(&(&terms.mass * &rates));
            largest = largest.max(kinetic);
            energies.push(kinetic + terms.potential);
        }
        let (low, high) = energies.iter().fold((f64::MAX, f64::MIN), |(low, high), &e| (low.min(e), high.max(e)));
        Ok((high - low) / largest)
    }
}

fn times() -> Vec<f64> {
    (0..=ROWS).map(|row| 0.05 * row as f64).collect()
}

/// Root mean square of the difference over that of the truth around its mean, of the coordinate where it is largest.
fn relative_error(truth: &[Vec<f64>], found: &[Vec<f64>]) -> f64 {
    let of = |column: usize| {
        let mean = truth.iter().map(|row| row[column]).sum::<f64>() / truth.len() as f64;
        let spread: f64 = truth.iter().map(|row| (row[column] - mean).powi(2)).sum();
        let error: f64 = truth.iter().zip(found).map(|(a, b)| (a[column] - b[column]).powi(2)).sum();
        (error / spread).sqrt()
    };
    (0..truth[0].len()).map(of).fold(0.0, f64::max)
}
