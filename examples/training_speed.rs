//! Time of an optimizer step with Adam of one of the paper's three networks, used by `scripts/measure training`:
//! `training_speed NETWORK THREADS ROWS SECONDS [ACTIVATION]`.
//!
//! ROWS is a file of numbers in single precision, row after row, each with its inputs and then its outputs. Prints a
//! line of JSON with the seconds of a step in each of many samples of some 20 ms.

use metafmu::{
    network::Network,
    study::{NetworkOptions, Optimizer, TrainingOptions},
    training::{Trainer, TrainingRows},
};
use metafmu_runtime::Activation;
use rand::{SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use std::{env, error::Error, fs, time::Instant};

/// Name, inputs, hidden layers, outputs, batch.
const NETWORKS: [(&str, usize, &[usize], usize, usize); 3] = [
    ("single-pendulum", 4, &[128, 128], 3, 64),
    ("slider-crank", 4, &[128, 128], 7, 64),
    ("double-pendulum", 5, &[64, 64, 64, 64], 4, 1024),
];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let ([name, threads, file, seconds], rest) =
        arguments.split_first_chunk().ok_or("usage: training_speed NETWORK THREADS ROWS SECONDS [ACTIVATION]")?;
    let seconds: f64 = seconds.parse()?;
    let activation: Activation = serde_json::from_value(rest.first().map_or("relu", String::as_str).into())?;
    let (_, inputs, hidden, outputs, batch) =
        NETWORKS.into_iter().find(|network| network.0 == name).ok_or("no such network")?;

    let options = NetworkOptions { hidden: hidden.into(), activation, ..NetworkOptions::default() };
    let network = Network::new(inputs, outputs, &options, 1)?;
    let rows = read(file, inputs, outputs)?;
    // as the peers do
    let options = TrainingOptions { optimizer: Optimizer::Adam, ..TrainingOptions::default() };
    let mut trainer = Trainer::new(network, &options, batch, threads.parse()?, 1)?;
    let mut order: Vec<u32> = (0..rows.len() as u32).collect();
    order.shuffle(&mut ChaCha8Rng::seed_from_u64(1));
    let mut batches = order.chunks_exact(batch).cycle();
    let mut sample = |steps: usize| {
        let started = Instant::now();
        for numbers in batches.by_ref().take(steps) {
            trainer.step(&rows, numbers, 1e-3);
        }
        started.elapsed().as_secs_f64() / steps as f64
    };
    let steps = (0.02 / sample(100)).max(1.0) as usize;
    let started = Instant::now();
    let mut times = Vec::new();
    while started.elapsed().as_secs_f64() < seconds {
        times.push(sample(steps));
    }
    println!("{}", serde_json::to_string(&times)?);
    Ok(())
}

fn read(file: &str, inputs: usize, outputs: usize) -> Result<TrainingRows, Box<dyn Error>> {
    let bytes = fs::read(file)?;
    let values: Vec<f32> = bytes.as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let (mut x, mut y) = (Vec::new(), Vec::new());
    for row in values.chunks_exact(inputs + outputs) {
        let (inputs, outputs) = row.split_at(inputs);
        x.extend_from_slice(inputs);
        y.extend_from_slice(outputs);
    }
    Ok(TrainingRows::new(inputs, outputs, x, y)?)
}
