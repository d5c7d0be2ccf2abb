use super::*;
use crate::{
    Activation, Encoding, Graph, Numbers, Precision, ScaledNetwork, Scaling, Surrogate, encoding::nearest, example,
    simd::Simd,
};
use extended::Extended;

mod continuous;
mod extended;

const POINTS: [[f64; 3]; 3] = [[0.15, 0.3, 1.0], [0.1, 0.0, 0.0], [0.2, 5.0, 2.0]];

fn set_simd(evaluator: &mut Evaluator, simd: Simd) {
    Arc::get_mut(&mut evaluator.prepared).expect("it has no clone").simd = simd;
}

/// The textbook formulas, one scalar at a time.
fn reference(surrogate: &Surrogate, inputs: &[f64]) -> Vec<f64> {
    let ScaledNetwork { scaling, layers } = surrogate.network().unwrap();
    let act = |activation: Activation, x: f64| match activation {
        Activation::Tanh => x.tanh(),
        Activation::Sigmoid => 1.0 / (1.0 + (-x).exp()),
        Activation::Relu => x.max(0.0),
        Activation::Gelu => 0.5 * x * (1.0 + ((2.0 / std::f64::consts::PI).sqrt() * (x + 0.044715 * x.powi(3))).tanh()),
        Activation::Silu => x / (1.0 + (-x).exp()),
        Activation::Sine => x.sin(),
        Activation::Identity => x,
    };
    let mut h: Vec<f64> =
        (0..inputs.len()).map(|i| (inputs[i] - scaling.input_mean[i]) / scaling.input_scale[i]).collect();
    for layer in layers {
        h = (0..layer.outputs)
            .map(|o| {
                let sum: f64 = h.iter().enumerate().map(|(i, x)| layer.weight.get(o * layer.inputs + i) * x).sum();
                act(layer.activation, sum + layer.bias.get(o))
            })
            .collect();
    }
    (0..h.len()).map(|o| scaling.output_mean[o] + scaling.output_scale[o] * h[o]).collect()
}

#[test]
fn every_instruction_set_agrees_with_the_textbook_formula() {
    for activation in Activation::ALL {
        for hidden in [vec![], vec![1], vec![7, 33], vec![128, 128], vec![64, 64, 64]] {
            let surrogate = example::with_network(&hidden, activation);
            let mut evaluator = Evaluator::new(&surrogate);
            let mut outputs = [0.0; 2];
            for inputs in POINTS {
                let expected = reference(&surrogate, &inputs);
                for simd in Simd::available() {
                    set_simd(&mut evaluator, simd);
                    evaluator.evaluate(&inputs, &mut outputs);
                    for (found, expected) in outputs.iter().zip(&expected) {
                        let difference = (found - expected).abs();
                        assert!(difference < 1e-13, "{activation:?} {hidden:?} {simd:?}: {difference:e}");
                    }
                }
            }
        }
    }
}

#[test]
fn an_evaluation_at_nan_leaves_nothing_behind() {
    for hidden in [vec![], vec![7], vec![7, 33]] {
        let mut evaluator = Evaluator::new(&example::with_network(&hidden, Activation::Relu));
        let (mut outputs, mut expected) = ([0.0; 2], [0.0; 2]);
        evaluator.evaluate(&[0.15, 0.3, 1.0], &mut expected);
        for _ in 0..2 {
            evaluator.evaluate(&[f64::NAN; 3], &mut outputs);
            assert!(outputs[0].is_nan());
        }
        evaluator.evaluate(&[0.15, 0.3, 1.0], &mut outputs);
        assert_eq!(outputs, expected, "{hidden:?}");
    }
}

#[test]
fn every_evaluation_gives_the_same_bits_whichever_block_it_begins_with() {
    for precision in [Precision::Double, Precision::Single] {
        for hidden in [vec![7], vec![100, 33], vec![128, 128, 64]] {
            let mut evaluator = Evaluator::new(&example::with_precision(&hidden, Activation::Tanh, precision));
            let results = [(); 3].map(|()| {
                let mut outputs = [0.0; 2];
                evaluator.evaluate(&[0.15, 0.3, 1.0], &mut outputs);
                outputs.map(f64::to_bits)
            });
            assert!(results.iter().all(|result| *result == results[0]), "{precision:?} {hidden:?}: {results:?}");
        }
    }
}

#[test]
fn outputs_are_smooth_enough_to_be_differenced() {
    let surrogate = example::with_network(&[128, 128], Activation::Tanh);
    let mut evaluator = Evaluator::new(&surrogate);
    let mut y = [0.0; 2];
    let mut at = |t: f64| {
        evaluator.evaluate(&[0.15, 0.3, t], &mut y);
        y[0]
    };
    // central differences of two step sizes agree to their truncation error plus rounding: eps * |y| / h
    let coarse = (at(1.0 + 1e-4) - at(1.0 - 1e-4)) / 2e-4;
    let fine = (at(1.0 + 1e-5) - at(1.0 - 1e-5)) / 2e-5;
    assert!((coarse - fine).abs() < 1e-7 * coarse.abs().max(1.0), "{coarse} {fine}");
}

/// The outputs at `inputs + h direction + h^2/2 curvature`, in twice double precision.
fn on_curve(surrogate: &Surrogate, inputs: &[f64], rates: [&[f64]; 2], h: f64) -> Vec<Extended> {
    let exact = Extended::from;
    let sigmoid = |x: Extended| (x * exact(0.5)).tanh() * exact(0.5) + exact(0.5);
    let act = |activation: Activation, x: Extended| match activation {
        Activation::Tanh => x.tanh(),
        Activation::Sigmoid => sigmoid(x),
        Activation::Relu if x.to_f64() < 0.0 => exact(0.0),
        Activation::Relu | Activation::Identity => x,
        Activation::Gelu => {
            let u = x * (exact(0.797_884_560_802_865_4) + x * x * exact(0.035_677_408_136_300_13));
            x * exact(0.5) * (exact(1.0) + u.tanh())
        }
        Activation::Silu => x * sigmoid(x),
        Activation::Sine => x.sin(),
    };
    if let Some((instants, networks)) = surrogate.program().graph.instants() {
        return per_instant_on_curve(surrogate, instants, networks, inputs, rates, h);
    }
    let ScaledNetwork { scaling: Scaling { input_mean, input_scale, output_mean, output_scale }, layers } =
        surrogate.network().expect("it is a network");
    let h = exact(h);
    let columns = surrogate.inputs().iter().enumerate().flat_map(|(i, input)| {
        let x = exact(inputs[i]) + h * exact(rates[0][i]) + h * h * exact(0.5) * exact(rates[1][i]);
        match &input.encoding {
            Encoding::Plain => vec![x],
            Encoding::Nominal(values) => {
                let hot = nearest(values, inputs[i]);
                (0..values.len()).map(|value| exact(f64::from(u8::from(value == hot)))).collect()
            }
            Encoding::Periodic => {
                let turn = exact(std::f64::consts::TAU);
                let angle = turn * (x - exact(input.min)) / exact(input.max - input.min);
                vec![angle.sin(), (angle + turn * exact(0.25)).sin()]
            }
        }
    });
    let scaling = input_mean.iter().zip(&input_scale);
    let mut values: Vec<Extended> =
        columns.zip(scaling).map(|(x, (&mean, &scale))| (x - exact(mean)) / exact(scale)).collect();
    for layer in layers {
        let row = |o: usize| {
            let terms = values.iter().enumerate().map(|(i, &x)| exact(layer.weight.get(o * layer.inputs + i)) * x);
            act(layer.activation, terms.fold(exact(layer.bias.get(o)), |sum, term| sum + term))
        };
        values = (0..layer.outputs).map(row).collect();
    }
    let scaled = values.iter().zip(&output_mean).zip(&output_scale);
    scaled.map(|((&y, &mean), &scale)| exact(mean) + exact(scale) * y).collect()
}

/// Outputs on a curve, see [`on_curve`], between the networks of two time points.
fn per_instant_on_curve(
    surrogate: &Surrogate,
    instants: &[f64],
    networks: &[Graph],
    inputs: &[f64],
    rates: [&[f64]; 2],
    h: f64,
) -> Vec<Extended> {
    let exact = Extended::from;
    // the interval does not change on the way: it is that of the point, which must not be an instant
    let right = instants.iter().position(|&instant| inputs[2] < instant).unwrap();
    let mut metadata = surrogate.metadata().clone();
    metadata.inputs.truncate(2);
    let [left, right] = [right - 1, right].map(|index| {
        let network = Surrogate::new(metadata.clone(), networks[index].clone()).unwrap();
        let rates = rates.map(|rates| &rates[..2]);
        (exact(instants[index]), on_curve(&network, &inputs[..2], rates, h))
    });
    let time = exact(inputs[2]) + exact(h) * exact(rates[0][2]) + exact(h * h * 0.5) * exact(rates[1][2]);
    let weight = (time - left.0) / (right.0 - left.0);
    left.1.iter().zip(&right.1).map(|(&left, &right)| left + weight * (right - left)).collect()
}

/// First and second derivative by central differences in twice double precision: exact to about 1e-12.
fn differences(surrogate: &Surrogate, inputs: &[f64], rates: [&[f64]; 2]) -> [Vec<f64>; 2] {
    let h = 1e-7;
    let [below, here, above] = [-h, 0.0, h].map(|h| on_curve(surrogate, inputs, rates, h));
    let exact = Extended::from;
    let columns = || below.iter().zip(&here).zip(&above);
    let first = columns().map(|((&below, _), &above)| ((above - below) / exact(2.0 * h)).to_f64());
    let second =
        columns().map(|((&below, &here), &above)| ((above - here - (here - below)) / (exact(h) * exact(h))).to_f64());
    [first.collect(), second.collect()]
}

#[track_caller]
fn assert_close(found: &[f64], expected: &[f64], relative: f64, what: &str) {
    for (found, expected) in found.iter().zip(expected) {
        let difference = (found - expected).abs();
        assert!(difference <= relative * expected.abs(), "{what}: {found} {expected}, off by {difference:e}");
    }
}

const SHAPES: [&[usize]; 5] = [&[], &[1], &[7, 33], &[128, 128], &[64, 64, 64]];

#[test]
fn derivatives_agree_with_differences_in_higher_precision() {
    for (activation, hidden) in Activation::ALL.iter().flat_map(|&a| SHAPES.map(|shape| (a, shape))) {
        check_derivatives(&example::with_network(hidden, activation), &POINTS);
    }
}

#[test]
fn derivatives_between_instants_agree_with_differences_in_higher_precision() {
    let points = [[0.15, 0.3, 1.0], [0.1, 0.0, 0.01], [0.2, 5.0, 0.7]];
    for (activation, hidden) in Activation::ALL.iter().flat_map(|&a| SHAPES.map(|shape| (a, shape))) {
        check_derivatives(&example::per_instant(hidden, activation, Precision::Double), &points);
    }
}

#[test]
fn derivatives_by_encoded_inputs_agree_with_differences_in_higher_precision() {
    let points = [[0.15, 0.3, 1.0], [0.1, 1.1, 0.01], [0.2, 4.7, 0.7]];
    for hidden in SHAPES {
        check_derivatives(&example::encoded(&example::with_network(hidden, Activation::Tanh)), &points);
        check_derivatives(
            &example::encoded(&example::per_instant(hidden, Activation::Tanh, Precision::Double)),
            &points,
        );
    }
}

#[test]
fn encoded_inputs_give_the_textbook_formula_of_their_columns() {
    for precision in [Precision::Double, Precision::Single] {
        let surrogate = example::encoded(&example::with_precision(&[7, 33], Activation::Tanh, precision));
        let mut evaluator = Evaluator::new(&surrogate);
        let mut outputs = [0.0; 2];
        for (length, hot) in [(0.14, 0), (0.1, 1), (0.2, 2), (0.19, 2), (-5.0, 1)] {
            for speed in [0.0, 1.3, 5.0, -3.7] {
                let angle = std::f64::consts::TAU * speed / 5.0;
                let mut columns = [0.0, 0.0, 0.0, angle.sin(), angle.cos(), 0.6];
                columns[hot] = 1.0;
                let expected = reference(&surrogate, &columns);
                evaluator.evaluate(&[length, speed, 0.6], &mut outputs);
                let tolerance = if precision == Precision::Single { 2e-5 } else { 1e-13 };
                assert_close(&outputs, &expected, tolerance, "encoded");
            }
        }
        evaluator.evaluate(&[f64::NAN, 0.0, 0.0], &mut outputs);
        assert!(outputs[0].is_nan());
    }
}

/// Activations of the first network's layers.
fn activations(surrogate: &Surrogate) -> Vec<Activation> {
    let graph = &surrogate.program().graph;
    let network = graph.instants().map_or(graph, |(_, networks)| &networks[0]).network();
    network.iter().flat_map(|network| network.layers.iter().map(|layer| layer.activation)).collect()
}

fn check_derivatives(surrogate: &Surrogate, points: &[[f64; 3]]) {
    let rates: [&[f64]; 2] = [&[0.02, -1.3, 0.7], &[0.05, 0.9, -0.4]];
    let mut evaluator = Evaluator::new(surrogate);
    for (inputs, simd) in points.iter().flat_map(|point| Simd::available().into_iter().map(move |s| (point, s))) {
        let what = format!("{:?} {inputs:?} {simd:?}", activations(surrogate));
        set_simd(&mut evaluator, simd);
        let [first, second] = differences(surrogate, inputs, rates);
        let [mut directional, mut once, mut twice] = [[0.0; 2]; 3];
        evaluator.directional(inputs, rates[0], &mut directional);
        assert_close(&directional, &first, 1e-9, &what);
        evaluator.along_curve(inputs, rates, [&mut once, &mut twice]);
        assert_eq!(once, directional, "{what}");
        assert_close(&twice, &second, 1e-9, &what);
        let weights = [0.6, -0.03];
        let mut gradient = [0.0; 3];
        evaluator.adjoint(inputs, &weights, &mut gradient);
        let expected = [0, 1, 2].map(|column| {
            let mut unit = [0.0; 3];
            unit[column] = 1.0;
            let [first, _] = differences(surrogate, inputs, [&unit, &[0.0; 3]]);
            weights[0] * first[0] + weights[1] * first[1]
        });
        assert_close(&gradient, &expected, 1e-9, &what);
    }
}

/// Outputs and their slopes in time.
fn at(surrogate: &Surrogate, time: f64) -> [[f64; 2]; 2] {
    let mut evaluator = Evaluator::new(surrogate);
    let (mut outputs, mut slopes) = ([0.0; 2], [0.0; 2]);
    evaluator.evaluate(&[0.15, 0.3, time], &mut outputs);
    evaluator.directional(&[0.15, 0.3, time], &[0.0, 0.0, 1.0], &mut slopes);
    [outputs, slopes]
}

#[test]
fn a_model_of_networks_for_instants_is_its_networks_at_the_instants_and_a_straight_line_between_them() {
    for precision in [Precision::Double, Precision::Single] {
        let surrogate = example::per_instant(&[7, 33], Activation::Tanh, precision);
        let (instants, networks) = surrogate.program().graph.instants().expect("so it was made");
        let mut metadata = surrogate.metadata().clone();
        metadata.inputs.truncate(2);
        let of_network = |network: &Graph| {
            let alone = Surrogate::new(metadata.clone(), network.clone()).unwrap();
            let (mut evaluator, mut outputs) = (Evaluator::new(&alone), [0.0; 2]);
            evaluator.evaluate(&[0.15, 0.3], &mut outputs);
            outputs
        };
        let expected: Vec<[f64; 2]> = networks.iter().map(of_network).collect();
        for (&instant, expected) in instants.iter().zip(&expected) {
            assert_eq!(at(&surrogate, instant)[0], *expected, "{instant}");
        }
        for left in 0..instants.len() - 1 {
            let [begin, end] = [instants[left], instants[left + 1]];
            let [outputs, slopes] = at(&surrogate, begin + 0.25 * (end - begin));
            for output in 0..2 {
                let [from, to] = [expected[left][output], expected[left + 1][output]];
                assert!((outputs[output] - (0.75 * from + 0.25 * to)).abs() < 1e-14);
                assert!((slopes[output] - (to - from) / (end - begin)).abs() < 1e-13);
            }
        }
        for (time, end) in [(-3.0, 0), (2.5, 3)] {
            assert_eq!(at(&surrogate, time), [expected[end], [0.0; 2]], "{time}");
        }
        assert!(at(&surrogate, f64::NAN)[0][0].is_nan());
        assert!(at(&surrogate, 1.0)[0][0].is_finite());
    }
}

#[test]
fn derivatives_keep_their_digits_where_every_neuron_saturates() {
    let surrogate = example::with_network(&[16], Activation::Tanh);
    let mut evaluator = Evaluator::new(&surrogate);
    let (inputs, direction) = ([3.0, 2.0, 1.0], [0.01, 0.0, 0.0]);
    let mut found = [0.0; 2];
    evaluator.directional(&inputs, &direction, &mut found);
    let [expected, _] = differences(&surrogate, &inputs, [&direction, &[0.0; 3]]);
    assert!(expected[0].abs() < 1e-3 && expected[0] != 0.0, "saturated: {expected:?}");
    assert_close(&found, &expected, 1e-9, "saturated");
}

#[test]
fn single_precision_agrees_with_double_precision_to_its_own() {
    for (activation, hidden) in Activation::ALL.iter().flat_map(|&a| SHAPES.map(|shape| (a, shape))) {
        let mut double = Evaluator::new(&example::with_network(hidden, activation));
        let mut single = Evaluator::new(&example::with_precision(hidden, activation, Precision::Single));
        for (inputs, simd) in POINTS.iter().flat_map(|point| Simd::available().into_iter().map(move |s| (point, s))) {
            set_simd(&mut single, simd);
            let (mut expected, mut found) = ([0.0; 2], [0.0; 2]);
            let scales = [0.8, 6.0]; // of the example's outputs
            let check = |expected: &[f64], found: &[f64], what: &str| {
                for ((expected, found), scale) in expected.iter().zip(found).zip(scales) {
                    let error = (expected - found).abs() / scale;
                    assert!(error < 3e-6, "{activation:?} {hidden:?} {simd:?} {what}: {error:e}");
                }
            };
            double.evaluate(inputs, &mut expected);
            single.evaluate(inputs, &mut found);
            check(&expected, &found, "outputs");
            let direction = [0.03, 1.5, 0.6];
            double.directional(inputs, &direction, &mut expected);
            single.directional(inputs, &direction, &mut found);
            check(&expected, &found, "derivative");
            let (mut expected, mut found) = ([0.0; 3], [0.0; 3]);
            double.adjoint(inputs, &[1.25, 0.16], &mut expected);
            single.adjoint(inputs, &[1.25, 0.16], &mut found);
            for ((expected, found), scale) in expected.iter().zip(&found).zip(direction) {
                assert!((expected - found).abs() * scale < 3e-6, "{activation:?} {hidden:?}: {expected} {found}");
            }
        }
    }
}

/// The example with its first layer's weights and biases multiplied by `factor`.
fn scaled(factor: f32, activation: Activation, precision: Precision) -> Surrogate {
    let surrogate = example::with_precision(&[32, 32], activation, precision);
    let mut network = surrogate.network().unwrap();
    let [first, ..] = &mut network.layers[..] else { unreachable!("it has layers") };
    for numbers in [&mut first.weight, &mut first.bias] {
        *numbers = numbers.as_single().unwrap().iter().map(|w| w * factor).collect::<Vec<f32>>().into();
    }
    with(&surrogate, network)
}

/// The surrogate with another network.
fn with(surrogate: &Surrogate, network: ScaledNetwork) -> Surrogate {
    Surrogate::new(surrogate.metadata().clone(), Graph::from(&network)).unwrap()
}

#[test]
fn no_hidden_value_is_ever_denormal() {
    // 1e-40 is denormal in single precision; inputs below 1e-300 make products with any weight denormal in double
    for (factor, precision) in [(1e-40, Precision::Single), (1e-30, Precision::Single), (1e-40, Precision::Double)] {
        for activation in Activation::ALL {
            let mut surrogate = scaled(factor, activation, precision);
            let mut network = surrogate.network().unwrap();
            network.scaling.input_mean.fill(0.0);
            surrogate = with(&surrogate, network);
            let mut evaluator = Evaluator::new(&surrogate);
            let mut outputs = [0.0; 2];
            for inputs in [[0.15, 0.3, 1.0], [1e-300, -1e-305, 1e-310], [1e-20, 1e-25, -1e-30], [1e30, -1e30, 1e20]] {
                evaluator.evaluate(&inputs, &mut outputs);
                assert!(outputs.iter().all(|y| y.is_finite()));
                let denormal = |x: f64| match precision {
                    Precision::Double => x.is_subnormal(),
                    Precision::Single => (x as f32).is_subnormal(),
                };
                let hidden: Vec<f64> = match &evaluator.work.graph {
                    GraphScratch::Double(scratch) => scratch.hidden().collect(),
                    GraphScratch::Single(scratch) => scratch.hidden().collect(),
                };
                assert_eq!(hidden.iter().position(|&x| denormal(x)), None, "{factor:e} {activation:?} {inputs:?}");
            }
        }
    }
}

/// Another activation in each layer, the last one included, and weights in double precision that single precision does not
/// have.
fn mixed(hidden: &[usize], activations: &[Activation], precision: Precision) -> Surrogate {
    let surrogate = example::with_precision(hidden, Activation::Tanh, precision);
    let mut network = surrogate.network().unwrap();
    assert_eq!(network.layers.len(), activations.len());
    for (layer, &activation) in network.layers.iter_mut().zip(activations) {
        layer.activation = activation;
        for numbers in [&mut layer.weight, &mut layer.bias] {
            *numbers = Numbers::Double(numbers.iter().map(|w| w * (1.0 + 1e-9)).collect());
        }
    }
    with(&surrogate, network)
}

#[test]
fn each_layer_has_its_own_activation_and_doubles_keep_their_digits() {
    for last in Activation::ALL {
        let activations = [Activation::Sine, Activation::Silu, last];
        let surrogate = mixed(&[9, 33], &activations, Precision::Double);
        let (mut evaluator, mut single) =
            (Evaluator::new(&surrogate), Evaluator::new(&mixed(&[9, 33], &activations, Precision::Single)));
        for inputs in POINTS {
            let expected = reference(&surrogate, &inputs);
            let (mut outputs, mut narrow) = ([0.0; 2], [0.0; 2]);
            single.evaluate(&inputs, &mut narrow);
            for simd in Simd::available() {
                set_simd(&mut evaluator, simd);
                evaluator.evaluate(&inputs, &mut outputs);
                for ((found, narrow), expected) in outputs.iter().zip(narrow).zip(&expected) {
                    assert!((found - expected).abs() < 1e-13, "{last:?} {simd:?}: {found} {expected}");
                    assert!((narrow - expected).abs() < 1e-5, "{last:?} in single precision: {narrow} {expected}");
                }
            }
        }
        check_derivatives(&surrogate, &POINTS);
    }
}

#[test]
fn a_clone_shares_the_weights_and_has_memory_of_its_own() {
    for surrogate in [example::surrogate(), example::oscillator(Some(example::residual_network())), example::crane()] {
        let mut one = Evaluator::new(&surrogate);
        let mut other = one.clone();
        assert!(Arc::ptr_eq(&one.prepared, &other.prepared));
        let [near, far] = [0.1, 0.2].map(|value| vec![value; one.columns()]);
        let at = |evaluator: &mut Evaluator, point: &[f64]| {
            let mut results = vec![0.0; evaluator.results()];
            evaluator.evaluate(point, &mut results);
            results
        };
        let expected = at(&mut one, &near);
        assert_ne!(at(&mut other, &far), expected);
        assert_eq!(at(&mut one, &near), expected);
    }
}
