use super::*;

/// Random points of a square, standardized enough.
fn points(rows: usize, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..2 * rows).map(|_| random.random_range(-1.7..1.7)).collect()
}

fn smooth(x: &[f64]) -> [f64; 2] {
    [(1.5 * x[0]).sin() * (0.5 * x[1]).exp(), x[0] * x[1]]
}

fn labels(x: &[f64]) -> Vec<f64> {
    x.chunks_exact(2).flat_map(smooth).collect()
}

fn network(hidden: Option<Vec<usize>>) -> SmallNetwork {
    SmallNetwork { hidden, activation: Activation::Tanh, seed: 1 }
}

fn trained(x: &[f64], y: &[f64], outputs: usize, small: &SmallNetwork) -> Vec<Layer> {
    let follower = IterationFollower { progress: &|_| {}, is_stopped: &|| false };
    train_small(FewRows { x, y, inputs: 2, outputs }, small, &follower).unwrap()
}

/// Outputs of layers with tanh.
fn evaluated(layers: &[Layer], x: &[f64]) -> Vec<f64> {
    layers.iter().fold(x.to_vec(), |values, layer| {
        let node = |node: usize| {
            let weights = (0..layer.inputs).map(|input| layer.weight.get(node * layer.inputs + input));
            let sum: f64 = weights.zip(&values).map(|(weight, value)| weight * value).sum();
            let sum = sum + layer.bias.get(node);
            if layer.activation == Activation::Tanh { sum.tanh() } else { sum }
        };
        (0..layer.outputs).map(node).collect()
    })
}

fn rmse(layers: &[Layer], output: usize) -> f64 {
    let unseen = points(500, 9);
    let squares = unseen.chunks_exact(2).map(|x| (evaluated(layers, x)[output] - smooth(x)[output]).powi(2));
    (squares.sum::<f64>() / 500.0).sqrt()
}

#[test]
fn derivatives_by_the_weights_are_those_of_differences() {
    for activation in [Activation::Tanh, Activation::Sigmoid, Activation::Silu, Activation::Sine] {
        let shape = NetworkShape::new(2, &[4, 3], activation);
        let weights = shape.start(&mut ChaCha8Rng::seed_from_u64(3));
        let x = points(5, 1);
        let mut jacobian = DMatrix::zeros(shape.weights(), 5);
        shape.evaluate(weights.as_slice(), &x, Some(&mut jacobian));
        for weight in 0..shape.weights() {
            let moved = |step: f64| {
                let mut weights = weights.clone();
                weights[weight] += step;
                shape.evaluate(weights.as_slice(), &x, None)
            };
            let expected = (moved(1e-5) - moved(-1e-5)) / 2e-5;
            let found = jacobian.row(weight).transpose();
            assert!((&found - &expected).amax() < 1e-8, "{activation:?} {weight}: {found} {expected}");
        }
    }
}

#[test]
fn a_smooth_function_of_few_rows_is_learned_with_the_same_bits_for_any_number_of_threads() {
    let x = points(80, 2);
    let y = labels(&x);
    let layers = trained(&x, &y, 2, &network(None));
    assert!(rmse(&layers, 0) < 1e-2 && rmse(&layers, 1) < 1e-2, "{} {}", rmse(&layers, 0), rmse(&layers, 1));
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| trained(&x, &y, 2, &network(None))), layers, "{threads} threads");
    }
    // outputs that are best with one and with two layers have as many
    let mixed: Vec<f64> = x.chunks_exact(2).flat_map(|x| [0.5 * x[0] - x[1], smooth(x)[0] * x[1].cos(), 2.0]).collect();
    assert_eq!(trained(&x, &mixed, 3, &network(None)).last().unwrap().outputs, 3);
    // outputs have separate nodes
    let first: Vec<f64> = y.iter().step_by(2).copied().collect();
    let given = |y: &[f64], outputs| trained(&x, y, outputs, &network(Some(vec![5, 4])));
    let (both, alone) = (given(&y, 2), given(&first, 1));
    assert_eq!(both.iter().map(|layer| layer.outputs).collect::<Vec<_>>(), [10, 8, 2]);
    for x in x.chunks_exact(2).take(10) {
        assert!((evaluated(&both, x)[0] - evaluated(&alone, x)[0]).abs() < 1e-12);
    }
}

#[test]
fn noise_is_smoothed_and_not_learned() {
    let x = points(150, 4);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    // twelve uniform numbers: nearly normal, with the standard deviation 0.2
    let mut noise = || 0.2 * (0..12).map(|_| random.random::<f64>() - 0.5).sum::<f64>();
    let y: Vec<f64> = x.chunks_exact(2).map(|x| smooth(x)[0] + noise()).collect();
    let layers = trained(&x, &y, 1, &network(None));
    // as of thirty numbers fitted to 150 rows, 0.2 (30 / 150)^(1/2) = 0.09; a network that learns the noise is off by 0.2 and more
    assert!(rmse(&layers, 0) < 0.12, "{}", rmse(&layers, 0));
}

#[test]
fn few_rows_and_a_constant_output_are_finite() {
    for rows in [1, 2, 3, 7] {
        let x = points(rows, 6);
        let layers = trained(&x, &vec![0.0; rows], 1, &network(None));
        assert_eq!(evaluated(&layers, &[0.3, 0.2]), [0.0], "{rows}");
        let layers = trained(&x, &labels(&x), 2, &network(None));
        assert!(evaluated(&layers, &[0.3, 0.2]).iter().all(|value| value.is_finite()), "{rows}");
    }
}

#[test]
fn a_training_that_is_stopped_gives_nothing_and_large_ones_are_left_to_others() {
    let x = points(20, 7);
    let follower = IterationFollower { progress: &|_| {}, is_stopped: &|| true };
    let rows = FewRows { x: &x, y: &labels(&x), inputs: 2, outputs: 2 };
    assert!(train_small(rows, &network(None), &follower).is_none());
    assert!(network(None).is_quick([8, 1], 500) && !network(None).is_quick([8, 1], 100_000));
    assert!(!network(Some(vec![64, 64])).is_quick([8, 1], 200));
    let relu = SmallNetwork { activation: Activation::Relu, ..network(None) };
    assert!(!relu.is_quick([2, 1], 20));
}
