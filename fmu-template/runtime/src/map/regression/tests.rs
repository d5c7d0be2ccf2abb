use super::*;

use crate::{Evaluator, Input, Map, Model, Surrogate, example};
use std::f64::consts::TAU;

fn scaling() -> Scaling {
    Scaling {
        input_mean: vec![0.15, 2.5, 1.0],
        input_scale: vec![0.05, 2.5, 1.0],
        output_mean: vec![0.1, -0.2],
        output_scale: vec![0.8, 6.0],
    }
}

fn polynomial() -> Regression {
    let degrees = vec![0, 0, 0, 1, 0, 0, 0, 2, 1, 3, 1, 2, 0, 0, 5];
    let coefficients = vec![0.3, -0.5, 0.7, 0.2, -0.1, 1.0, 0.0, -0.4, 0.6, 0.25];
    Regression { scaling: scaling(), function: Function::Polynomial(Polynomial { degrees, coefficients }) }
}

fn kernel() -> Regression {
    let machine = |bias: f64| KernelMachine {
        lengths: vec![0.9, 1.3, 0.4],
        centres: vec![0.1, -0.3, 0.5, -0.8, 0.2, 0.9],
        weights: vec![1.5, -0.7],
        bias,
    };
    let machines = vec![machine(0.1), machine(-2.0)];
    Regression { scaling: scaling(), function: Function::Kernel(KernelMachines { machines }) }
}

fn forest() -> Regression {
    let leaf = |number| Node { column: LEAF, number, below: [0; 2] };
    let split = |column, number, below| Node { column, number, below };
    let nodes = vec![split(2, 0.0, [1, 2]), leaf(0.25), split(0, -0.5, [3, 4]), leaf(-1.0), leaf(3.0), leaf(0.5)];
    let trees = vec![Tree { root: 0, output: 0 }, Tree { root: 5, output: 1 }, Tree { root: 2, output: 1 }];
    Regression { scaling: scaling(), function: Function::Forest(Forest { nodes, trees }) }
}

fn outputs(regression: &Regression, inputs: &[f64]) -> Vec<f64> {
    regression.check().unwrap();
    let mut outputs = vec![0.0; 2];
    regression.evaluate(inputs, &mut outputs, &mut regression.scratch());
    outputs
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
fn a_kernel_machine_is_its_textbook_formula() {
    let z = [(0.16 - 0.15) / 0.05, (1.1 - 2.5) / 2.5, 0.3];
    let kernel_at = |centre: [f64; 3]| {
        let square: f64 = (0..3).map(|i| ((z[i] - centre[i]) / [0.9, 1.3, 0.4][i]).powi(2)).sum();
        (-0.5 * square).exp()
    };
    let sum = 1.5 * kernel_at([0.1, -0.3, 0.5]) - 0.7 * kernel_at([-0.8, 0.2, 0.9]);
    for (found, expected) in outputs(&kernel(), &POINT).iter().zip([0.1 + 0.8 * (0.1 + sum), -0.2 + 6.0 * (sum - 2.0)])
    {
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
fn derivatives_are_those_of_differences() {
    for regression in [polynomial(), kernel()] {
        let mut scratch = regression.scratch();
        let (velocity, acceleration) = ([0.02, -0.7, 0.9], [0.1, 0.3, -0.5]);
        let (mut first, mut second) = (vec![0.0; 2], vec![0.0; 2]);
        regression.along_curve(&POINT, [&velocity, &acceleration], &mut first, Some(&mut second), &mut scratch);
        let at = |s: f64| {
            let inputs: Vec<f64> = (0..3).map(|i| POINT[i] + s * velocity[i] + 0.5 * s * s * acceleration[i]).collect();
            outputs(&regression, &inputs)
        };
        let h = 1e-4;
        for output in 0..2 {
            let [below, here, above] = [-h, 0.0, h].map(|s| at(s)[output]);
            assert!((first[output] - (above - below) / (2.0 * h)).abs() < 1e-5);
            assert!((second[output] - (above - 2.0 * here + below) / (h * h)).abs() < 1e-4);
            // J^T e_output along the direction is the directional derivative
            let (mut gradient, mut weights) = ([0.0; 3], [0.0; 2]);
            weights[output] = 1.0;
            regression.adjoint(&POINT, &weights, &mut gradient, &mut scratch);
            let along: f64 = gradient.iter().zip(velocity).map(|(slope, rate)| slope * rate).sum();
            assert!((along - first[output]).abs() < 1e-12);
        }
    }
}

#[test]
fn indices_that_point_at_nothing_are_refused() {
    let broken = |change: &dyn Fn(&mut Forest)| {
        let mut regression = forest();
        let Function::Forest(forest) = &mut regression.function else { unreachable!("made as a forest") };
        change(forest);
        regression.check().unwrap_err().to_string()
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

/// The example with another model.
fn surrogate(regression: Regression) -> Result<Surrogate, FormatError> {
    Surrogate::new(example::surrogate().metadata().clone(), Model::Response(Map::Regression(regression)))
}

#[test]
fn a_file_gives_every_kind_back_and_the_same_bytes_again() {
    for regression in [polynomial(), kernel(), forest()] {
        let surrogate = surrogate(regression).unwrap().sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        let again = Surrogate::from_bytes(&bytes).unwrap();
        assert_eq!(again, surrogate);
        assert_eq!(again.to_bytes().unwrap(), bytes);
    }
}

#[test]
fn a_surrogate_evaluates_as_its_regression_does() {
    for regression in [polynomial(), kernel(), forest()] {
        let expected = outputs(&regression, &POINT);
        let evaluator = Evaluator::new(&surrogate(regression.clone()).unwrap());
        let (mut scratch, mut found) = (evaluator.scratch(), [0.0; 2]);
        evaluator.evaluate(&POINT, &mut found, &mut scratch);
        assert_eq!(found, expected[..]);
        evaluator.directional(&POINT, &[0.0, 0.0, 1.0], &mut found, &mut scratch);
        let is_forest = matches!(regression.function, Function::Forest(_));
        assert_eq!(found == [0.0; 2], is_forest);
    }
}

#[test]
fn a_regression_takes_the_columns_that_the_inputs_are_encoded_as() {
    let like = example::encoded(&example::surrogate());
    let degrees: Vec<u8> = (0..36).map(|index| u8::from(index % 7 == 0)).collect();
    let coefficients = (1..=12).map(f64::from).collect();
    let scaling = like.network().unwrap().scaling.clone();
    let regression = Regression { scaling, function: Function::Polynomial(Polynomial { degrees, coefficients }) };
    let Input { min, max, .. } = like.inputs()[1];
    let angle = TAU * (1.1 - min) / (max - min);
    let expected = outputs(&regression, &[0.0, 1.0, 0.0, angle.sin(), angle.cos(), 1.3]);
    let evaluator =
        Evaluator::new(&Surrogate::new(like.metadata().clone(), Model::Response(Map::Regression(regression))).unwrap());
    let mut found = [0.0; 2];
    evaluator.evaluate(&[0.1, 1.1, 1.3], &mut found, &mut evaluator.scratch());
    assert!(found.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
    let refused = Surrogate::new(like.metadata().clone(), Model::Response(Map::Regression(polynomial()))).unwrap_err();
    assert!(refused.to_string().contains('6'), "{refused}");
}

#[test]
fn no_damage_to_a_file_makes_reading_it_panic() {
    for regression in [polynomial(), kernel(), forest()] {
        let bytes = surrogate(regression).unwrap().to_bytes().unwrap();
        for position in 0..bytes.len() {
            for change in [0x01, 0x20, 0x80, 0xff] {
                let mut damaged = bytes.clone();
                damaged[position] ^= change;
                let Ok(surrogate) = Surrogate::from_bytes(&damaged) else { continue };
                let evaluator = Evaluator::new(&surrogate);
                evaluator.evaluate(&POINT, &mut [0.0; 2], &mut evaluator.scratch());
            }
        }
    }
}

#[test]
fn tensors_that_do_not_fit_are_refused() {
    let refused = |change: &dyn Fn(&mut Regression), regression: Regression| {
        let mut regression = regression;
        change(&mut regression);
        surrogate(regression).unwrap_err().to_string()
    };
    let scale: &dyn Fn(&mut Regression) = &|regression| regression.scaling.input_scale[1] = 0.0;
    assert_eq!(refused(scale, kernel()), "tensor `input_scale`, element 1: 0 is not positive");
    let terms: &dyn Fn(&mut Regression) = &|regression| {
        let Function::Polynomial(polynomial) = &mut regression.function else { unreachable!("a polynomial") };
        polynomial.coefficients.pop();
    };
    assert_eq!(refused(terms, polynomial()), "tensor `polynomial.coefficients` has shape [9], expected [10]");
    let length: &dyn Fn(&mut Regression) = &|regression| {
        let Function::Kernel(machines) = &mut regression.function else { unreachable!("kernels") };
        machines.machines[1].lengths[0] = -1.0;
    };
    assert_eq!(refused(length, kernel()), "tensor `kernel.1.lengths`, element 0: -1 is not positive");
}
