//! One optimizer step: forward, backward and update.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use metafmu::{
    network::Network,
    study::{NetworkOptions, Optimizer, TrainingOptions},
    training::{Trainer, TrainingRows},
};
use metafmu_runtime::Activation;
use std::{hint::black_box, time::Instant};

fn optimizer_step(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("optimizer step");
    for (inputs, hidden, outputs, batch) in
        [(4, vec![128, 128], 3, 64), (4, vec![128, 128], 3, 1024), (5, vec![64; 4], 4, 1024)]
    {
        for activation in [Activation::Tanh, Activation::Relu] {
            let name = format!("{inputs}-{hidden:?}-{outputs} {activation:?}, batch {batch}");
            let options = NetworkOptions { hidden: hidden.clone(), activation, ..NetworkOptions::default() };
            let network = Network::new(inputs, outputs, &options, 1).expect("the sizes are positive");
            let rows = rows(inputs, outputs, 16 * batch);
            group.throughput(Throughput::Elements(batch as u64));
            group
                .bench_function(name, |bencher| bencher.iter_custom(|steps| time_steps(&network, &rows, batch, steps)));
        }
    }
    group.finish();
}

/// On as many threads as a training takes.
fn time_steps(network: &Network, rows: &TrainingRows, batch: usize, steps: u64) -> std::time::Duration {
    let numbers: Vec<u32> = (0..rows.len() as u32).collect();
    let mut trainer = Trainer::new(
        network.clone(),
        &TrainingOptions { optimizer: Optimizer::Adam, ..TrainingOptions::default() },
        batch,
        rayon::current_num_threads(),
        1,
    )
    .expect("the defaults are good");
    let started = Instant::now();
    for (_, numbers) in (0..steps).zip(numbers.chunks_exact(batch).cycle()) {
        black_box(trainer.step(rows, numbers, 1e-3));
    }
    started.elapsed()
}

/// Numbers spread over (-1, 1): the fractional parts of multiples of the golden ratio.
fn rows(inputs: usize, outputs: usize, count: usize) -> TrainingRows {
    let spread = |count: usize| (0..count).map(|i| 2.0 * (i as f64 * 0.618_033_988_749_894_9).fract() as f32 - 1.0);
    let (x, y) = (spread(count * inputs).collect(), spread(count * outputs).collect());
    TrainingRows::new(inputs, outputs, x, y).expect("whole rows of finite numbers")
}

criterion_group!(benches, optimizer_step);
criterion_main!(benches);
