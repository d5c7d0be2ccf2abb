//! A design study with the surrogate of a crane: peak swing of the load when the motor pushes for a second and brakes
//! for another.
//!
//! Draws lengths, masses, dampings and forces at random, runs the FMU with each on all cores, and prints a CSV table.
//! On stderr it prints the time of a run on one core, minimum and median of ten equal shares. For fifty runs drawn at
//! random, it compares time and angles with those of the mechanism.
//!
//!     cargo run --release --example peak_sway -- examples/dynamics/crane.toml crane.fmu 10000 > result.csv

#[path = "embedding/variables.rs"]
mod variables;

use metafmu::{
    fmi::{Fmu, FmuInstance},
    integrate::{Budget, TOLERANCE},
    multibody::{Mechanism, RunStart},
    signal::Signal,
};
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use rayon::prelude::*;
use std::{
    env,
    error::Error,
    fmt::Write as _,
    fs,
    io::{Write as _, stdout},
    path::Path,
    time::{Duration, Instant},
};
use variables::{references, values};

const STEP: f64 = 0.05;
const STEPS: usize = 200;
/// Number of steps in which the motor pushes; afterwards it brakes.
const PUSH_STEPS: usize = 20;
/// Parameters that vary, and the force.
const NAMES: [&str; 4] = ["l", "m", "b", "force"];
const STATES: [&str; 4] = ["rail.position", "rope.angle", "rail.velocity", "rope.angular_velocity"];
const SHARES: usize = 10;
const COMPARED: usize = 50;

type Design = [f64; 4];
/// A peak in rad, or the message of an error; for other threads.
type Peak = Result<f64, String>;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [mechanism, fmu, runs] = arguments.as_slice() else {
        return Err("expected three arguments: CRANE.toml CRANE.fmu RUNS".into());
    };
    let (mechanism, fmu) = (load(Path::new(mechanism))?, Fmu::open(fmu)?);
    let designs = draw(&mechanism, runs.parse()?)?;

    let mut chosen: Vec<usize> = (0..designs.len()).collect();
    chosen.shuffle(&mut ChaCha8Rng::seed_from_u64(2));
    chosen.truncate(COMPARED);
    let few: Vec<Design> = chosen.iter().map(|&run| designs[run]).collect();
    let swing = |few: &[Design], tolerance| few.iter().map(|one| swing_mechanism(&mechanism, one, tolerance)).collect();
    let (mut exact, mut rough, mut surrogate) = (Method::default(), Method::default(), Method::default());
    for share in 0..SHARES {
        surrogate.run(share_of(&designs, share), |designs| swing_surrogate(&fmu, designs))?;
        exact.run(share_of(&few, share), |few| swing(few, TOLERANCE))?;
        rough.run(share_of(&few, share), |few| swing(few, 1e-8))?;
    }

    let mut output = stdout().lock();
    writeln!(output, "{},peak", NAMES.join(","))?;
    for ([l, m, b, force], peak) in designs.iter().zip(&surrogate.peaks) {
        writeln!(output, "{l},{m},{b},{force},{peak}")?;
    }

    let (threads, elapsed) = (rayon::current_num_threads(), surrogate.elapsed.as_secs_f64());
    eprintln!("{} runs of the surrogate in {elapsed:.2} s on {threads} threads", designs.len());
    eprintln!(
        "{:18}{:>7}{:>10}{:>11}{:>15}{:>9}{:>13}",
        "", "runs", "least us", "median us", "faster, least", "median", "off by, rad"
    );
    let of_few: Vec<f64> = chosen.iter().map(|&run| surrogate.peaks[run]).collect();
    let [least_exact, median_exact] = exact.times()?;
    for (name, method, peaks) in [
        ("mechanism at 1e-13", &exact, &exact.peaks),
        ("mechanism at 1e-8", &rough, &rough.peaks),
        ("surrogate", &surrogate, &of_few),
    ] {
        let ([least, median], runs) = (method.times()?, method.peaks.len());
        let off = largest(peaks.iter().zip(&exact.peaks).map(|(peak, exact)| peak - exact));
        eprint!("{name:18}{runs:7}{:10.1}{:11.1}", 1e6 * least, 1e6 * median);
        eprintln!("{:15.1}{:9.1}{off:13.1e}", least_exact / least, median_exact / median);
    }
    Ok(())
}

/// The runs of a method so far.
#[derive(Default)]
struct Method {
    peaks: Vec<f64>,
    /// Seconds of a run on a core, for each share.
    seconds: Vec<f64>,
    elapsed: Duration,
}

impl Method {
    /// Runs a share of the designs on all cores.
    fn run(&mut self, designs: &[Design], swing: impl Fn(&[Design]) -> Vec<Peak> + Sync) -> Result<(), String> {
        let began = Instant::now();
        let for_each_core = designs.par_chunks(designs.len().div_ceil(rayon::current_num_threads()).max(1));
        let parts = for_each_core.map(|designs| {
            let began = Instant::now();
            (swing(designs), began.elapsed().as_secs_f64())
        });
        let parts: Vec<(Vec<Peak>, f64)> = parts.collect();
        self.elapsed += began.elapsed();
        if !designs.is_empty() {
            self.seconds.push(parts.iter().map(|(_, seconds)| seconds).sum::<f64>() / designs.len() as f64);
        }
        for peak in parts.into_iter().flat_map(|(peaks, _)| peaks) {
            self.peaks.push(peak?);
        }
        Ok(())
    }

    /// Minimum and median of the shares.
    fn times(&self) -> Result<[f64; 2], &'static str> {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).ok_or("expected at least one run")?;
        Ok([sorted[0], *median])
    }
}

/// One of equal shares; empty if `share` is beyond the last one.
fn share_of(designs: &[Design], share: usize) -> &[Design] {
    designs.chunks(designs.len().div_ceil(SHARES).max(1)).nth(share).unwrap_or(&[])
}

/// The mechanism, with its states as further outputs, which are the last section of its file.
fn load(path: &Path) -> Result<Mechanism, Box<dyn Error>> {
    let mut text = fs::read_to_string(path)?;
    for (index, state) in STATES.iter().enumerate() {
        writeln!(text, "state{index} = {{ measure = \"{state}\" }}")?;
    }
    Ok(Mechanism::parse(&text, path)?)
}

/// Designs, evenly distributed over the ranges in the mechanism's file; forces above a tenth of the greatest.
fn draw(mechanism: &Mechanism, runs: usize) -> Result<Vec<Design>, String> {
    let mut ranges = [(0.0, 0.0); 4];
    for (range, name) in ranges.iter_mut().zip(NAMES) {
        let parameter = mechanism.parameters().get(name).and_then(|parameter| parameter.min.zip(parameter.max));
        let force = mechanism.inputs().get(name).map(|input| (0.1 * input.max, input.max));
        *range = parameter.or(force).ok_or_else(|| format!("the mechanism has no `{name}` with a range"))?;
    }
    let mut random = ChaCha8Rng::seed_from_u64(1);
    Ok((0..runs).map(|_| ranges.map(|(min, max)| min + random.random::<f64>() * (max - min))).collect())
}

/// The force of the motor in a step.
fn push(force: f64, step: usize) -> f64 {
    match step / PUSH_STEPS {
        0 => force,
        1 => -force,
        _ => 0.0,
    }
}

/// One instance for all designs.
fn swing_surrogate(fmu: &Fmu, designs: &[Design]) -> Vec<Peak> {
    let instance = match fmu.instantiate("peak_sway", false) {
        Ok(instance) => instance,
        Err(error) => return vec![Err(error.to_string())],
    };
    designs.iter().map(|design| swing_instance(&instance, design).map_err(|error| error.to_string())).collect()
}

fn swing_instance(instance: &FmuInstance, &[l, m, b, force]: &Design) -> metafmu::Result<f64> {
    let parameters = references(instance.fmu(), ["l", "m", "b", "rope.angle_start"])?;
    let (motor, angle) = (references(instance.fmu(), ["force"])?, references(instance.fmu(), ["theta"])?);
    instance.reset()?;
    instance.set_real(&parameters, &[l, m, b, 0.0])?;
    instance.enter_initialization_mode(0.0, None)?;
    instance.exit_initialization_mode()?;
    let mut angles = [0.0; STEPS];
    for (step, theta) in angles.iter_mut().enumerate() {
        instance.set_real(&motor, &[push(force, step)])?;
        instance.do_step(step as f64 * STEP, STEP)?;
        [*theta] = values(instance, angle)?;
    }
    Ok(largest(angles))
}

/// In parts in which the force is constant: the integrator has no jumps to find.
fn swing_mechanism(mechanism: &Mechanism, &[l, m, b, force]: &Design, tolerance: f64) -> Peak {
    let given = [("l", l), ("m", m), ("b", b)];
    let value = |name: &str| given.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    let values: Vec<f64> =
        mechanism.parameters().iter().map(|(name, parameter)| value(name).unwrap_or(parameter.default)).collect();
    let first = mechanism.outputs().len() - STATES.len();
    let (mut state, mut angles, mut begin) = (vec![0.0; STATES.len()], Vec::new(), 0);
    for end in [PUSH_STEPS, 2 * PUSH_STEPS, STEPS] {
        let times: Vec<f64> = (begin..=end).map(|row| row as f64 * STEP).collect();
        let (positions, rates) = state.split_at(2);
        let from = RunStart { coordinates: &STATES[..2], positions, rates, actuator_states: &[] };
        let signals = [Signal::Constant(push(force, begin))];
        let rows = mechanism.simulate_from(&values, from, &signals, &times, (tolerance, &Budget::default()))?;
        let states: Vec<&[f64]> = rows.chunks(mechanism.outputs().len()).map(|row| &row[first..]).collect();
        angles.extend(states.iter().map(|state| state[1]));
        state = states.last().map_or(state, |last| last.to_vec());
        begin = end;
    }
    Ok(largest(angles))
}

/// The largest magnitude; not a number if one is not.
fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().map(f64::abs).max_by(f64::total_cmp).unwrap_or(0.0)
}
