//! Evaluation: a network whose hidden layers have residual connections beside the plain chain of its layers.
//!
//! `cargo bench -p metafmu-benches --bench evaluation` prints the time of each pass over that of the chain: minimum and median of pairs of
//! measurements, one of either in turn.

use metafmu_example as example;
use metafmu_runtime::{
    Activation, Evaluator, Graph, Numbers, Precision, Surrogate,
    graph::{Elementwise, Operation, Step},
};
use std::{hint::black_box, time::Instant};

const HIDDEN: [usize; 6] = [64; 6];
const PAIRS: usize = 41;
/// Evaluations of a measurement.
const REPEATED: u32 = 2000;

type Pass = fn(&mut Evaluator, &mut Work);

struct Work {
    point: Vec<f64>,
    direction: Vec<f64>,
    outputs: Vec<f64>,
    weights: Vec<f64>,
    gradient: Vec<f64>,
}

const PASSES: [(&str, Pass); 3] = [
    ("outputs", |evaluator, work| evaluator.evaluate(&work.point, &mut work.outputs)),
    ("directional derivative", |evaluator, work| {
        evaluator.directional(&work.point, &work.direction, &mut work.outputs);
    }),
    ("adjoint derivative", |evaluator, work| {
        evaluator.adjoint(&work.point, &work.weights, &mut work.gradient);
    }),
];

fn main() {
    println!("time over that of the chain, 6 x 64, tanh: minimum, median; the chain in ns");
    for precision in [Precision::Double, Precision::Single] {
        let chain = example::with_precision(&HIDDEN, Activation::Tanh, precision);
        let [mut chain, mut residual] = [&chain, &residual(&chain, precision)].map(Evaluator::new);
        for (name, pass) in PASSES {
            let mut both = || [time(&mut chain, pass), time(&mut residual, pass)];
            let mut times: Vec<[f64; 2]> = (0..PAIRS).map(|_| both()).collect();
            let fastest = |of: usize| times.iter().map(|pair| pair[of]).fold(f64::INFINITY, f64::min);
            let [of_chain, of_residual] = [fastest(0), fastest(1)];
            times.sort_by(|a, b| (a[1] / a[0]).total_cmp(&(b[1] / b[0])));
            let [chain, residual] = times[PAIRS / 2];
            println!(
                "{precision:?} {name:24} {:.2} {:.2}   {:.0} ns",
                of_residual / of_chain,
                residual / chain,
                1e9 * of_chain
            );
        }
    }
}

/// Seconds of an evaluation.
fn time(evaluator: &mut Evaluator, pass: Pass) -> f64 {
    let numbers = |count: usize| (0..count).map(|i| 0.1 + 0.05 * i as f64).collect();
    let (columns, results) = (evaluator.columns(), evaluator.results());
    let mut work = Work {
        point: numbers(columns),
        direction: numbers(columns),
        outputs: numbers(results),
        weights: numbers(results),
        gradient: numbers(columns),
    };
    let begin = Instant::now();
    for repetition in 0..REPEATED {
        work.point[0] = 0.2 + 1e-4 * f64::from(repetition);
        pass(black_box(evaluator), &mut work);
    }
    begin.elapsed().as_secs_f64() / f64::from(REPEATED)
}

/// The layers of `chain`; each hidden layer after the first is added to the one before it.
fn residual(chain: &Surrogate, precision: Precision) -> Surrogate {
    let network = chain.network().expect("the example is a network");
    let numbers = |numbers: &Numbers| match precision {
        Precision::Double => Numbers::Double(numbers.iter().collect()),
        Precision::Single => numbers.clone(),
    };
    let (mut steps, mut before) = (Vec::new(), 0);
    for (index, layer) in network.layers.iter().enumerate() {
        steps.push(Step::Affine { of: before, weight: numbers(&layer.weight), bias: numbers(&layer.bias) });
        if layer.activation != Activation::Identity {
            let function = Elementwise::Activation(layer.activation);
            steps.push(Step::Elementwise { of: steps.len(), function, parameters: Vec::new() });
            if index > 0 {
                steps.push(Step::Combine { of: [before, steps.len()], operation: Operation::Add });
            }
        }
        before = steps.len();
    }
    let graph = Graph { inputs: network.layers[0].inputs, steps };
    Surrogate::new(chain.metadata().clone(), graph).expect("the layers fit")
}
