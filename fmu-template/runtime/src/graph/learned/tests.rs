use super::*;
use crate::{
    Evaluator, FormatError, Input, Surrogate, example,
    graph::{LEAF, MAX_VALUES, Node, Tree},
};
use std::f64::consts::TAU;

fn scaling() -> Scaling {
    Scaling {
        input_mean: vec![0.15, 2.5, 1.0],
        input_scale: vec![0.05, 2.5, 1.0],
        output_mean: vec![0.1, -0.2],
        output_scale: vec![0.8, 6.0],
    }
}

const COEFFICIENTS: [f64; 10] = [0.3, -0.5, 0.7, 0.2, -0.1, 1.0, 0.0, -0.4, 0.6, 0.25];

fn products() -> Products {
    Products { inputs: 3, degrees: vec![0, 0, 0, 1, 0, 0, 0, 2, 1, 3, 1, 2, 0, 0, 5] }
}

fn linear_function() -> Graph {
    Graph::of_linear(&scaling(), &COEFFICIENTS[..6], &[0.7, -0.3])
}

fn polynomial() -> Graph {
    Graph::of_polynomial(&scaling(), products(), &COEFFICIENTS)
}

fn machines() -> [KernelMachine; 2] {
    [0.1, -2.0].map(|bias| KernelMachine {
        lengths: vec![0.9, 1.3, 0.4],
        centres: vec![0.1, -0.3, 0.5, -0.8, 0.2, 0.9],
        weights: vec![1.5, -0.7],
        bias,
        deviation: None,
    })
}

/// Machines that share their kernels, and machines with different lengths.
fn kernels() -> [Graph; 2] {
    let [first, second] = machines();
    let own = KernelMachine { lengths: vec![0.5, 2.0, 0.7], ..second.clone() };
    [[first.clone(), second], [first, own]].map(|machines| Graph::of_kernels(&scaling(), &machines))
}

fn trees() -> Forest {
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let split = |column, number, below| Node { column, number, below };
    let nodes = vec![split(2, 0.0, [1, 2]), leaf(0.25), split(0, -0.5, [3, 4]), leaf(-1.0), leaf(3.0), leaf(0.5)];
    let trees = vec![Tree { root: 0, output: 0 }, Tree { root: 5, output: 1 }, Tree { root: 2, output: 1 }];
    Forest { nodes, trees }
}

fn forest() -> Graph {
    Graph::of_forest(&scaling(), trees())
}

fn all() -> Vec<Graph> {
    [vec![linear_function(), polynomial(), forest()], kernels().to_vec()].concat()
}

/// The example with another graph.
fn surrogate(graph: Graph) -> Result<Surrogate, FormatError> {
    Surrogate::new(example::surrogate().metadata().clone(), graph)
}

fn outputs(graph: &Graph, inputs: &[f64]) -> Vec<f64> {
    graph.evaluate([inputs])[0].to_vec()
}

const POINT: [f64; 3] = [0.16, 1.1, 1.3];

#[test]
fn a_polynomial_is_its_textbook_formula() {
    let [a, b, c] = [(0.16 - 0.15) / 0.05, (1.1 - 2.5) / 2.5, 0.3];
    let p2 = |z: f64| 0.5 * (3.0 * z * z - 1.0);
    let p3 = |z: f64| 0.5 * (5.0 * z * z * z - 3.0 * z);
    let p5 = |z: f64| (63.0 * z.powi(5) - 70.0 * z.powi(3) + 15.0 * z) / 8.0;
    let terms = [1.0, a, p2(b) * c, p3(a) * b * p2(c), p5(c)];
    let sum = |weights: [f64; 5]| terms.iter().zip(weights).map(|(term, weight)| term * weight).sum::<f64>();
    let expected = [0.1 + 0.8 * sum([0.3, -0.5, 0.7, 0.2, -0.1]), -0.2 + 6.0 * sum([1.0, 0.0, -0.4, 0.6, 0.25])];
    for (found, expected) in outputs(&polynomial(), &POINT).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    }
}

#[test]
fn a_linear_function_is_the_polynomial_of_degree_one() {
    let products = Products { inputs: 3, degrees: vec![0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1] };
    let coefficients = [&[0.7], &COEFFICIENTS[..3], &[-0.3], &COEFFICIENTS[3..6]].concat();
    let expected = outputs(&Graph::of_polynomial(&scaling(), products, &coefficients), &POINT);
    for (found, expected) in outputs(&linear_function(), &POINT).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    }
}

#[test]
fn a_kernel_machine_is_its_textbook_formula() {
    let z = [(0.16 - 0.15) / 0.05, (1.1 - 2.5) / 2.5, 0.3];
    let kernel_at = |centre: [f64; 3]| {
        let square: f64 = (0..3).map(|i| ((z[i] - centre[i]) / [0.9, 1.3, 0.4][i]).powi(2)).sum();
        (-0.5 * square).exp()
    };
    let sum = 1.5 * kernel_at([0.1, -0.3, 0.5]) - 0.7 * kernel_at([-0.8, 0.2, 0.9]);
    let expected = [0.1 + 0.8 * (0.1 + sum), -0.2 + 6.0 * (sum - 2.0)];
    for (found, expected) in outputs(&kernels()[0], &POINT).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    }
}

#[test]
fn a_forest_is_the_sum_of_the_leaves_its_trees_lead_to() {
    let of = |a: f64, c: f64| outputs(&forest(), &[0.15 + 0.05 * a, 2.5, 1.0 + c]);
    assert_eq!(of(0.0, -1.0), [0.1 + 0.8 * 0.25, -0.2 + 6.0 * 3.5]);
    // a number equal to that of the split goes to the first node
    assert_eq!(of(0.0, 0.0)[0], 0.1 + 0.8 * 0.25);
    assert_eq!(of(-1.0, 1.0), [0.1 - 0.8, -0.2 + 6.0 * -0.5]);
}

#[test]
fn machines_with_the_same_kernels_share_them() {
    let distances = |graph: &Graph| graph.steps.iter().filter(|step| matches!(step, Step::Distances { .. })).count();
    assert_eq!(kernels().each_ref().map(distances), [1, 2]);
    let [first, second] = machines();
    let swapped =
        Graph::of_kernels(&scaling(), &[second, KernelMachine { weights: Vec::new(), centres: Vec::new(), ..first }]);
    let [.., constant] = outputs(&swapped, &POINT)[..] else { panic!("two outputs") };
    assert!((constant - (-0.2 + 6.0 * 0.1)).abs() < 1e-14, "far from every centre it is the bias");
}

#[test]
fn terms_are_evaluated_as_in_a_fit() {
    let z = [0.2, -0.56, 0.3];
    let mut values = [f64::NAN; 5];
    products().evaluate(&z, &mut values);
    let scaling = Scaling { input_mean: vec![0.0; 3], input_scale: vec![1.0; 3], ..scaling() };
    let sum = |weights: &[f64]| values.iter().zip(weights).map(|(term, weight)| term * weight).sum::<f64>();
    let found = outputs(&Graph::of_polynomial(&scaling, products(), &COEFFICIENTS), &z);
    for (found, expected) in
        found.iter().zip([0.1 + 0.8 * sum(&COEFFICIENTS[..5]), -0.2 + 6.0 * sum(&COEFFICIENTS[5..])])
    {
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    }
}

#[test]
fn derivatives_are_those_of_differences() {
    // of every degree up to 5 in all inputs, so that terms are products of earlier ones
    let degrees: Vec<u8> =
        (0..=5).flat_map(|a| (0..=5).flat_map(move |b| (0..=5).flat_map(move |c| [a, b, c]))).collect();
    let coefficients: Vec<f64> = (0..432).map(|index| (0.7 * f64::from(index)).sin() / 50.0).collect();
    let full = Graph::of_polynomial(&scaling(), Products { inputs: 3, degrees }, &coefficients);
    for graph in [vec![linear_function(), polynomial(), full], kernels().to_vec()].concat() {
        let mut evaluator = Evaluator::new(&surrogate(graph.clone()).unwrap());
        let (velocity, acceleration) = ([0.02, -0.7, 0.9], [0.1, 0.3, -0.5]);
        let (mut first, mut second) = (vec![0.0; 2], vec![0.0; 2]);
        evaluator.along_curve(&POINT, [&velocity, &acceleration], [&mut first, &mut second]);
        let at = |s: f64| {
            let inputs: Vec<f64> = (0..3).map(|i| POINT[i] + s * velocity[i] + 0.5 * s * s * acceleration[i]).collect();
            outputs(&graph, &inputs)
        };
        let h = 1e-4;
        for output in 0..2 {
            let [below, here, above] = [-h, 0.0, h].map(|s| at(s)[output]);
            assert!((first[output] - (above - below) / (2.0 * h)).abs() < 1e-5);
            assert!((second[output] - (above - 2.0 * here + below) / (h * h)).abs() < 1e-4);
            // J^T e_output along the direction is the directional derivative
            let (mut gradient, mut weights) = ([0.0; 3], [0.0; 2]);
            weights[output] = 1.0;
            evaluator.adjoint(&POINT, &weights, &mut gradient);
            let along: f64 = gradient.iter().zip(velocity).map(|(slope, rate)| slope * rate).sum();
            assert!((along - first[output]).abs() < 1e-12);
        }
    }
}

#[test]
fn indices_that_point_at_nothing_are_refused() {
    let broken = |change: &dyn Fn(&mut Forest)| {
        let mut forest = trees();
        change(&mut forest);
        Graph::of_forest(&scaling(), forest).check(3, 2).unwrap_err().to_string()
    };
    assert_eq!(
        broken(&|forest| forest.nodes[0].column = 3),
        "tensor `forest.column`, element 0: 3, expected less than 3"
    );
    assert_eq!(
        broken(&|forest| forest.nodes[2].below[1] = 9),
        "tensor `forest.below`, element 5: 9, expected less than 6"
    );
    assert_eq!(
        broken(&|forest| forest.nodes[2].below[0] = 2),
        "tensor `forest.below`: node 2 is below node 2, expected one after it"
    );
    assert_eq!(broken(&|forest| forest.trees[1].root = 6), "tensor `forest.root`, element 1: 6, expected less than 6");
    assert_eq!(
        broken(&|forest| forest.trees[1].output = 2),
        "tensor `forest.output`, element 1: 2, expected less than 2"
    );
    assert!(broken(&|forest| forest.nodes[1].number = f64::NAN).contains("is not finite"));
}

#[test]
fn a_file_gives_every_kind_back_and_the_same_bytes_again() {
    for graph in all() {
        let surrogate = surrogate(graph).unwrap().sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        let again = Surrogate::from_bytes(&bytes).unwrap();
        assert_eq!(again, surrogate);
        assert_eq!(again.to_bytes().unwrap(), bytes);
    }
}

#[test]
fn a_surrogate_evaluates_as_its_graph_does() {
    for graph in all() {
        let mut evaluator = Evaluator::new(&surrogate(graph.clone()).unwrap());
        let mut found = [0.0; 2];
        evaluator.evaluate(&POINT, &mut found);
        assert_eq!(found, outputs(&graph, &POINT)[..]);
        evaluator.directional(&POINT, &[0.0, 0.0, 1.0], &mut found);
        let is_forest = graph.steps.iter().any(|step| matches!(step, Step::Forest { .. }));
        assert_eq!(found == [0.0; 2], is_forest);
    }
}

#[test]
fn columns_are_those_that_the_inputs_are_encoded_as() {
    let like = example::encoded(&example::surrogate());
    let degrees: Vec<u8> = (0..36).map(|index| u8::from(index % 7 == 0)).collect();
    let coefficients: Vec<f64> = (1..=12).map(f64::from).collect();
    let scaling = &like.network().unwrap().scaling;
    let graph = Graph::of_polynomial(scaling, Products { inputs: 6, degrees }, &coefficients);
    let Input { min, max, .. } = like.inputs()[1];
    let angle = TAU * (1.1 - min) / (max - min);
    let expected = outputs(&graph, &[0.0, 1.0, 0.0, angle.sin(), angle.cos(), 1.3]);
    let mut evaluator = Evaluator::new(&Surrogate::new(like.metadata().clone(), graph).unwrap());
    let mut found = [0.0; 2];
    evaluator.evaluate(&[0.1, 1.1, 1.3], &mut found);
    assert!(found.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
    let refused = Surrogate::new(like.metadata().clone(), polynomial()).unwrap_err();
    assert!(refused.to_string().contains('6'), "{refused}");
}

#[test]
fn no_damage_to_a_file_makes_reading_it_panic() {
    for graph in all() {
        let bytes = surrogate(graph).unwrap().to_bytes().unwrap();
        for position in 0..bytes.len() {
            for change in [0x01, 0x20, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[position] ^= change;
                let Ok(surrogate) = Surrogate::from_bytes(&damaged) else { continue };
                let mut evaluator = Evaluator::new(&surrogate);
                evaluator.evaluate(&POINT, &mut [0.0; 2]);
            }
        }
    }
}

#[test]
fn numbers_that_do_not_fit_are_refused() {
    let refused = |graph: Graph| surrogate(graph).unwrap_err().to_string();
    let flat = Scaling { input_scale: vec![1.0, 0.0, 1.0], ..scaling() };
    let message = refused(Graph::of_kernels(&flat, &machines()));
    assert_eq!(message, "tensor `graph.0.scale`, element 1: 0 is not positive");
    let missing = Graph::of_polynomial(&scaling(), products(), &COEFFICIENTS[..9]);
    assert_eq!(refused(missing), "tensor `graph.2.weight` has shape [9], expected [10]");
    let [first, mut second] = machines();
    second.lengths[0] = -1.0;
    let message = refused(Graph::of_kernels(&scaling(), &[first, second]));
    assert_eq!(message, "tensor `graph.4.lengths`, element 0: -1 is not positive");
    let of = |products: Products| refused(Graph::of_polynomial(&scaling(), products, &COEFFICIENTS));
    let [few, wide] = [Products { degrees: vec![1; 14], inputs: 3 }, Products { degrees: vec![1; 20], inputs: 4 }];
    assert_eq!(of(few), "tensor `graph.1.degrees` has shape [14], expected [12]");
    assert_eq!(of(wide), "tensor `graph.1.degrees` has shape [5, 4], expected [5, 3]");
    let none = of(Products { degrees: Vec::new(), inputs: 3 });
    assert!(none.contains("outputs"), "{none}");
    // a table of degrees up to 255 for each of many inputs
    let many = Graph {
        inputs: MAX_VALUES / 200,
        steps: vec![Step::Products {
            of: 0,
            products: Products { inputs: MAX_VALUES / 200, degrees: vec![255; MAX_VALUES / 200] },
        }],
    };
    assert!(many.widths().unwrap_err().to_string().contains("at most"));
}

#[test]
fn a_network_is_given_back_as_it_was_taken() {
    for activation in Activation::ALL {
        for hidden in [&[][..], &[1], &[7, 3]] {
            let network = example::with_network(hidden, activation).network().unwrap();
            assert_eq!(network.layers.len(), hidden.len() + 1);
            let mut nonlinear = network.clone();
            nonlinear.layers.last_mut().unwrap().activation = activation;
            for network in [network, nonlinear] {
                let graph = Graph::from(&network);
                graph.check(3, 2).unwrap();
                assert!(graph.is_network());
                assert_eq!(graph.network().unwrap(), network);
            }
        }
    }
}

#[test]
fn graphs_that_are_nearly_networks_are_none() {
    // standardized, affine, activation, affine, rescaled
    let network = Graph::from(&example::with_network(&[3], Activation::Tanh).network().unwrap());
    let activation = |of, function| Step::Elementwise { of, function, parameters: Vec::new() };
    let tanh = Elementwise::Activation(Activation::Tanh);
    type Change<'a> = &'a dyn Fn(&mut Graph);
    let changes: [(&str, Change); 11] = [
        ("not standardized", &|graph| graph.steps[0] = Step::Softmax { of: 0 }),
        ("not rescaled", &|graph| drop(graph.steps.pop())),
        ("rescaled is not of the last layer", &|graph| {
            let Some(Step::Rescale { of, .. }) = graph.steps.last_mut() else { unreachable!("it is rescaled") };
            *of = 3;
        }),
        ("no layers", &|graph| drop(graph.steps.drain(1..4))),
        ("nothing", &|graph| graph.steps.clear()),
        ("the activation of another function", &|graph| graph.steps[2] = activation(2, Elementwise::Cosine)),
        ("the activation of what was before", &|graph| graph.steps[2] = activation(1, tanh)),
        ("a layer of what was before", &|graph| {
            let Step::Affine { of, .. } = &mut graph.steps[3] else { unreachable!("it is a layer") };
            *of = 2;
        }),
        ("a layer of the columns", &|graph| {
            let Step::Affine { of, .. } = &mut graph.steps[1] else { unreachable!("it is a layer") };
            *of = 0;
        }),
        ("an activation before every layer", &|graph| graph.steps[1] = activation(1, tanh)),
        ("two activations", &|graph| graph.steps[3] = activation(3, tanh)),
    ];
    assert!(network.is_network());
    for (what, change) in changes {
        let mut graph = network.clone();
        change(&mut graph);
        assert!(!graph.is_network(), "{what}");
    }
    assert!(all().iter().all(|graph| !graph.is_network()));
}
