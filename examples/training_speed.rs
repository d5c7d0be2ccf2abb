//! Time of an optimizer step of the paper's three networks: `training_speed THREADS [SECONDS] [ACTIVATION] [NETWORK]`.
//!
//! One line of JSON for each network, with the minimum and the median over samples of many steps each. The rows are as
//! many as do not fit into the caches near the cores, in random order.

use metafmu::{
    network::Network,
    study::{NetworkOptions, TrainingOptions},
    training::{Rows, Trainer},
};
use metafmu_runtime::Activation;
use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use std::{
    env,
    time::{Duration, Instant},
};

/// Name, inputs, hidden layers, outputs, batch.
const NETWORKS: [(&str, usize, &[usize], usize, usize); 3] =
    [("pendulum", 4, &[128, 128], 3, 64), ("crank", 4, &[128, 128], 7, 64), ("double", 5, &[64, 64, 64, 64], 4, 1024)];

const ROWS: usize = 600_000;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = env::args().skip(1);
    let threads: usize =
        arguments.next().ok_or("usage: training_speed THREADS [SECONDS] [ACTIVATION] [NETWORK]")?.parse()?;
    let seconds: f64 = arguments.next().map_or(Ok(2.0), |text| text.parse())?;
    let name = arguments.next().unwrap_or_else(|| "relu".into());
    let activation: Activation = serde_json::from_value(name.clone().into())?;
    let only = arguments.next();
    for (problem, inputs, hidden, outputs, batch) in NETWORKS {
        if only.as_deref().is_some_and(|only| only != problem) {
            continue;
        }
        let options = NetworkOptions { hidden: hidden.into(), activation };
        let network = Network::new(inputs, outputs, &options, 1)?;
        let rows = rows(inputs, outputs)?;
        let mut order: Vec<u32> = (0..ROWS as u32).collect();
        order.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
        let mut batches = order.chunks_exact(batch).cycle();
        let mut trainer = Trainer::new(network, &TrainingOptions::default(), batch, threads, 1)?;
        let mut sample = |steps: u32| {
            let started = Instant::now();
            for numbers in batches.by_ref().take(steps as usize) {
                trainer.step(&rows, numbers, 1e-3);
            }
            started.elapsed().as_secs_f64() / f64::from(steps)
        };
        let steps = (0.003 / sample(50)).max(1.0) as u32;
        let started = Instant::now();
        let mut times = Vec::new();
        while started.elapsed() < Duration::from_secs_f64(seconds) {
            times.push(sample(steps));
        }
        times.sort_by(f64::total_cmp);
        let (min, median) = (times[0] * 1e6, times[times.len() / 2] * 1e6);
        println!(
            r#"{{"problem":"{problem}","batch":{batch},"threads":{threads},"activation":"{name}","us_min":{min:.2},"us_median":{median:.2}}}"#
        );
    }
    Ok(())
}

/// Numbers spread over (-1, 1): the fractional parts of multiples of the golden ratio.
fn rows(inputs: usize, outputs: usize) -> Result<Rows, metafmu::training::TrainingError> {
    let spread = |count: usize| (0..count).map(|i| 2.0 * (i as f64 * 0.618_033_988_749_894_9).fract() as f32 - 1.0);
    Rows::new(inputs, outputs, spread(ROWS * inputs).collect(), spread(ROWS * outputs).collect())
}
