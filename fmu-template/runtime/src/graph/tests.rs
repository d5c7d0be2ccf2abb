use super::*;
use crate::{
    Activation, Evaluator, Metadata, Surrogate,
    dictionary::{Factor, Term},
    example,
};

/// Two outputs of three columns, through a step of every kind.
fn graph() -> Graph {
    let affine = |of, weight: &[f64], bias: &[f64]| Step::Affine {
        of,
        weight: weight.to_vec().into(),
        bias: bias.to_vec().into(),
    };
    let of = |of, function, parameters: &[f64]| Step::Elementwise { of, function, parameters: parameters.to_vec() };
    let nodes = vec![
        Node { column: 1, number: 0.4, below: [1, 2] },
        Node { column: LEAF, number: 0.25, below: [0; 2] },
        Node { column: LEAF, number: -1.0, below: [0; 2] },
    ];
    let steps = vec![
        affine(0, &[0.5, -0.2, 0.1, 1.5, 0.3, -0.7, 0.2, 0.9, 0.4, -0.6, 0.8, 0.05], &[0.1, -0.3, 0.2, 0.6]),
        of(1, Elementwise::GeluExact, &[]),
        Step::Normalize { of: 2, epsilon: 1e-3 },
        of(3, Elementwise::Linear, &[1.1, 0.9, 1.3, 0.7, 0.1, 0.2, -0.1, 0.0]),
        Step::Combine { of: [4, 1], operation: Operation::Add },
        Step::Softmax { of: 5 },
        Step::Distances {
            of: 5,
            centres: vec![0.1, 0.2, 0.3, 0.4, -0.5, 0.5, 0.1, 0.0],
            lengths: vec![1.0, 0.5, 2.0, 1.5],
        },
        Step::Columns { columns: vec![[6, 0], [7, 1], [0, 2], [6, 3]] },
        Step::Products {
            of: 8,
            products: Products { inputs: 4, degrees: vec![1, 0, 0, 1, 0, 1, 0, 0, 2, 0, 1, 0, 0, 0, 3, 2] },
        },
        Step::Forest { of: 0, forest: Forest { nodes, trees: vec![Tree { root: 0, output: 1 }] }.into(), outputs: 2 },
        affine(9, &[0.4, -0.6, 0.3, 1.2, -0.9, 0.2, 0.5, 0.7], &[0.0, 0.5]),
        Step::Combine { of: [11, 10], operation: Operation::Add },
        of(11, Elementwise::Exponential, &[]),
        of(11, Elementwise::Logarithm, &[]),
        Step::Select { of: [13, 12, 14] },
    ];
    Graph { inputs: 3, steps }
}

fn surrogate(graph: Graph) -> Surrogate {
    let of = example::surrogate();
    Surrogate::new(of.metadata().clone(), graph).unwrap()
}

fn outputs(graph: &Graph, point: [f64; 3]) -> Vec<f64> {
    let mut evaluator = Evaluator::new(&surrogate(graph.clone()));
    let mut outputs = vec![0.0; 2];
    evaluator.evaluate(&point, &mut outputs);
    outputs
}

#[test]
fn steps_are_their_textbook_formulas() {
    let x: [f64; 3] = [0.16, 1.1, 1.3];
    let rows = [[0.5, -0.2, 0.1], [1.5, 0.3, -0.7], [0.2, 0.9, 0.4], [-0.6, 0.8, 0.05]];
    let bias = [0.1, -0.3, 0.2, 0.6];
    let a: Vec<f64> = (0..4).map(|i| rows[i].iter().zip(x).map(|(w, x)| w * x).sum::<f64>() + bias[i]).collect();
    let g: Vec<f64> = a.iter().map(|a| 0.5 * a * (1.0 + libm::erf(a / 2f64.sqrt()))).collect();
    let mean = g.iter().sum::<f64>() / 4.0;
    let variance = g.iter().map(|g| (g - mean).powi(2)).sum::<f64>() / 4.0;
    let (factors, offsets) = ([1.1, 0.9, 1.3, 0.7], [0.1, 0.2, -0.1, 0.0]);
    let normal = |i: usize| (g[i] - mean) / (variance + 1e-3).sqrt() * factors[i] + offsets[i];
    let r: Vec<f64> = (0..4).map(|i| normal(i) + a[i]).collect();
    let total: f64 = r.iter().map(|r| r.exp()).sum();
    let distance = [(-0.5, 1.0), (0.5, 0.5), (0.1, 2.0), (0.0, 1.5)].iter().zip(&r);
    let distance: f64 = distance.map(|((centre, length), r)| ((r - centre) / length).powi(2)).sum();
    let c = [r[0].exp() / total, distance, x[2], r[3].exp() / total];
    let p2 = |x: f64| 0.5 * (3.0 * x * x - 1.0);
    let c = [c[0] * c[3], c[1], p2(c[0]) * c[2], 0.5 * (5.0 * c[2].powi(3) - 3.0 * c[2]) * p2(c[3])];
    let expected = [
        0.4 * c[0] - 0.6 * c[1] + 0.3 * c[2] + 1.2 * c[3],
        -0.9 * c[0] + 0.2 * c[1] + 0.5 * c[2] + 0.7 * c[3] + 0.5 - 1.0,
    ];
    // the last step chooses what was before, as an exponential is positive; a logarithm of a negative number is not chosen
    for (found, expected) in outputs(&graph(), x).iter().zip(expected) {
        assert!((found - expected).abs() < 1e-14, "{found} {expected}");
    }
}

#[test]
fn derivatives_are_those_of_differences() {
    let (point, rates, bends) = ([0.16, 1.1, 1.3], [0.3, -0.7, 0.5], [0.2, 0.1, -0.4]);
    let mut evaluator = Evaluator::new(&surrogate(graph()));
    let (mut first, mut second) = ([0.0; 2], [0.0; 2]);
    evaluator.along_curve(&point, [&rates, &bends], [&mut first, &mut second]);
    let at = |t: f64| {
        let point = std::array::from_fn(|i| point[i] + rates[i] * t + 0.5 * bends[i] * t * t);
        outputs(&graph(), point)
    };
    let (h, k) = (1e-5, 1e-3);
    let (ahead, behind, far, back, here) = (at(h), at(-h), at(k), at(-k), at(0.0));
    for output in 0..2 {
        let slope = (ahead[output] - behind[output]) / (2.0 * h);
        let bend = (far[output] - 2.0 * here[output] + back[output]) / (k * k);
        assert!((first[output] - slope).abs() < 1e-8 * slope.abs().max(1.0), "{} {slope}", first[output]);
        assert!((second[output] - bend).abs() < 1e-4 * bend.abs().max(1.0), "{} {bend}", second[output]);
    }
    let (mut gradient, mut directional) = ([0.0; 3], [0.0; 2]);
    let weights = [0.8, -1.7];
    evaluator.adjoint(&point, &weights, &mut gradient);
    evaluator.directional(&point, &rates, &mut directional);
    let by_rows: f64 = gradient.iter().zip(rates).map(|(slope, rate)| slope * rate).sum();
    let by_columns: f64 = directional.iter().zip(weights).map(|(slope, weight)| slope * weight).sum();
    assert!((by_rows - by_columns).abs() < 1e-13, "{by_rows} {by_columns}");
}

/// `J^T weights` column by column, from directional derivatives.
fn by_columns(evaluator: &mut Evaluator, point: &[f64], weights: &[f64]) -> Vec<f64> {
    let column = |column: usize| {
        let (mut direction, mut derivative) = (vec![0.0; point.len()], vec![0.0; weights.len()]);
        direction[column] = 1.0;
        evaluator.directional(point, &direction, &mut derivative);
        derivative.iter().zip(weights).map(|(slope, weight)| slope * weight).sum()
    };
    (0..point.len()).map(column).collect()
}

fn gradient(evaluator: &mut Evaluator, point: &[f64], weights: &[f64]) -> Vec<f64> {
    let mut gradient = vec![f64::NAN; point.len()];
    evaluator.adjoint(point, weights, &mut gradient);
    gradient
}

#[test]
fn adjoint_derivatives_are_those_of_each_column() {
    let (point, weights) = ([0.16, 1.1, 1.3], [0.8, -1.7]);
    let columns = |of: [u32; 2]| Step::Columns { columns: of.map(|column| [0, column]).to_vec() };
    let mut graphs = vec![graph()];
    for operation in Operation::ALL {
        let steps = vec![columns([0, 1]), columns([1, 2]), Step::Combine { of: [1, 2], operation }];
        graphs.push(Graph { inputs: 3, steps: [steps, vec![Step::Combine { of: [3, 1], operation }]].concat() });
        let squared = Step::Combine { of: [1, 1], operation };
        graphs.push(Graph { inputs: 3, steps: vec![columns([2, 0]), squared] });
    }
    for function in Elementwise::all() {
        let parameters = [0.9, 1.2][..function.parameters()].to_vec();
        let of = |of| Step::Elementwise { of, function, parameters: parameters.clone() };
        // of what has one use, of what has another, and of columns
        let affine =
            |of, weight: &[f64]| Step::Affine { of, weight: weight.to_vec().into(), bias: vec![1.3, 1.1].into() };
        let first = affine(0, &[0.5, 0.2, 0.7, 0.4, 0.3, 0.1]);
        let sum = Step::Combine { of: [4, 1], operation: Operation::Multiply };
        let steps = vec![first, of(1), affine(2, &[0.7, 0.2, 0.1, 0.6]), of(3), sum];
        graphs.push(Graph { inputs: 3, steps });
    }
    for graph in graphs {
        let mut evaluator = Evaluator::new(&surrogate(graph.clone()));
        let (found, expected) =
            (gradient(&mut evaluator, &point, &weights), by_columns(&mut evaluator, &point, &weights));
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-13 * expected.abs().max(1.0), "{found} {expected}: {graph:?}");
        }
    }
}

#[test]
fn what_is_not_chosen_adds_nothing_to_an_adjoint_derivative() {
    let of = |of, function, parameters: &[f64]| Step::Elementwise { of, function, parameters: parameters.to_vec() };
    let steps = vec![
        Step::Columns { columns: vec![[0, 0], [0, 1]] },
        of(1, Elementwise::Power, &[0.5]),
        of(1, Elementwise::Logarithm, &[]),
        Step::Combine { of: [2, 3], operation: Operation::Multiply },
        Step::Select { of: [1, 4, 1] },
    ];
    let mut evaluator = Evaluator::new(&surrogate(Graph { inputs: 3, steps }));
    for point in [[-0.5, 1.1, 0.0], [0.0, -1.0, 0.0]] {
        let found = gradient(&mut evaluator, &point, &[0.8, -1.7]);
        let expected = by_columns(&mut evaluator, &point, &[0.8, -1.7]);
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-14), "{found:?} {expected:?}");
        assert!(found[0] == 0.8 && found[2] == 0.0);
    }
}

#[test]
fn in_single_precision_it_is_the_same_but_for_rounding() {
    let graph = graph();
    let double = surrogate(graph.clone());
    let metadata = Metadata { precision: Precision::Single, ..double.metadata().clone() };
    let single = Surrogate::new(metadata, graph).unwrap();
    let [mut double, mut single] = [&double, &single].map(Evaluator::new);
    let weights = [0.8, -1.7];
    for point in [[0.16, 1.1, 1.3], [-0.7, 0.2, 0.9], [0.0, 0.0, 0.0]] {
        let (mut expected, mut found) = ([0.0; 2], [0.0; 2]);
        double.evaluate(&point, &mut expected);
        single.evaluate(&point, &mut found);
        let slopes = gradient(&mut double, &point, &weights);
        let pairs = found.iter().zip(&expected).map(|(found, expected)| (*found, *expected));
        let of_adjoint = gradient(&mut single, &point, &weights).into_iter().zip(slopes.clone());
        let of_columns = by_columns(&mut single, &point, &weights).into_iter().zip(slopes);
        for (found, expected) in pairs.chain(of_adjoint).chain(of_columns) {
            assert!((found - expected).abs() < 4e-6 * expected.abs().max(1.0), "{found} {expected}");
        }
        assert!(found.iter().zip(expected).any(|(found, expected)| *found != expected), "it is in double precision");
    }
}

#[test]
fn what_may_lose_digits_in_single_precision_stays_in_double() {
    let of = |function, parameters: &[f64]| Step::Elementwise { of: 0, function, parameters: parameters.to_vec() };
    let fits = |step, range| Graph { inputs: 1, steps: vec![step] }.fits_single(&[range]);
    let affine = |weight: f64| Step::Affine { of: 0, weight: vec![weight].into(), bias: vec![1e-20].into() };
    assert!(fits(affine(2.0), [-1.0, 1.0]) && fits(of(Elementwise::GeluExact, &[]), [0.0, 1.0]));
    assert!(!fits(affine(2e-16), [-1.0, 1.0]), "below what counts");
    assert!(!fits(affine(2.0), [101_000.0, 102_000.0]), "a pressure has few digits left");
    assert!(!fits(of(Elementwise::Logarithm, &[]), [0.5, 1.0]) && !fits(of(Elementwise::Positive, &[]), [-1.0, 1.0]));
    let combined = |operation| fits(Step::Combine { of: [0, 0], operation }, [1.0, 2.0]);
    assert!(combined(Operation::Add) && !combined(Operation::Divide));
    assert!(!fits(Step::Select { of: [0; 3] }, [1.0, 2.0]));
    assert!(!fits(Step::Products { of: 0, products: Products { inputs: 1, degrees: vec![4] } }, [-1.0, 1.0]));
}

#[test]
fn every_elementwise_function_has_its_derivatives() {
    for function in Elementwise::all().filter(|function| *function != Elementwise::Single) {
        for x in [-2.3f64, -0.4, 0.3, 0.9, 2.7] {
            let positive = matches!(function, Elementwise::Logarithm | Elementwise::Power);
            let (x, p) = (if positive { x.abs() } else { x }, [0.35, 1.2]);
            let h = 1e-4;
            let [value, slope, curvature] = function.series(x, p);
            let [behind, ..] = function.series(x - h, p);
            let [ahead, ..] = function.series(x + h, p);
            let expected = [(ahead - behind) / (2.0 * h), (ahead - 2.0 * value + behind) / (h * h)];
            for (found, expected) in [slope, curvature].into_iter().zip(expected) {
                let close = (found - expected).abs() < 2e-6 * expected.abs().max(1.0);
                assert!(close, "{function:?} at {x}: {found} {expected}");
            }
        }
    }
    assert_eq!(Elementwise::Power.series(0.0, [1.0, 0.0]), [0.0, 1.0, 0.0], "a power of zero is no NaN");
    assert_eq!(Elementwise::Elu.series(800.0, [1.0, 0.0])[1], 1.0, "nothing overflows");
    assert_eq!(Elementwise::Softplus.series(800.0, [0.0; 2])[0], 800.0);
}

#[test]
fn a_graph_is_read_as_it_was_written() {
    let written = surrogate(graph());
    let read = Surrogate::from_bytes(&written.to_bytes().unwrap()).unwrap();
    assert_eq!(read, written);
}

#[test]
fn what_does_not_fit_is_refused() {
    let refused = |change: fn(&mut Graph)| {
        let mut graph = graph();
        change(&mut graph);
        graph.check(3, 2).unwrap_err().to_string()
    };
    let of = |of| Step::Elementwise { of, function: Elementwise::Activation(Activation::Tanh), parameters: Vec::new() };
    assert!(refused(|graph| graph.steps.clear()).contains("graph.steps"));
    let message = refused(|graph| graph.inputs = 4);
    assert!(message.contains("graph.inputs"), "{message}");
    assert!(matches!(Graph { inputs: 3, steps: vec![of(1)] }.check(3, 3), Err(FormatError::Index { .. })));
    let message = refused(|graph| graph.steps[11] = Step::Combine { of: [11, 1], operation: Operation::Add });
    assert!(message.contains("graph.11"), "{message}");
    let message = refused(|graph| graph.steps[7] = Step::Columns { columns: vec![[6, 4]; 4] });
    assert!(message.contains("graph.7.columns"), "{message}");
    let message = refused(|graph| graph.steps[2] = Step::Normalize { of: 2, epsilon: f64::NAN });
    assert!(message.contains("graph.2.parameters"), "{message}");
    let message = refused(|graph| graph.steps.push(Step::Columns { columns: vec![[0, 0]; MAX_VALUES] }));
    assert!(message.contains("at most"), "{message}");
}

/// Two outputs of three columns, through the steps with separate working memory and scaling between them.
fn nested() -> Graph {
    let two = |weight: [f64; 4]| Step::Affine { of: 1, weight: weight.to_vec().into(), bias: vec![0.2, -0.1].into() };
    let tanh = Step::Elementwise { of: 2, function: Elementwise::Activation(Activation::Tanh), parameters: Vec::new() };
    let function = |weight, scale: f64| Graph {
        inputs: 2,
        steps: vec![
            Step::Standardize { of: 0, mean: vec![0.1, 1.0], scale: vec![0.5, scale] },
            two(weight),
            tanh.clone(),
            Step::Rescale { of: 3, mean: vec![0.3, -0.2], scale: vec![1.5, scale] },
        ],
    };
    let functions = vec![
        function([0.5, -0.7, 0.9, 0.2], 0.8),
        function([-0.3, 0.4, 0.6, 1.1], 1.2),
        function([0.8, 0.1, -0.5, 0.7], 0.9),
    ];
    let angle = Factor::Angle;
    let power = Factor::Power { middle: 0.2, half: 0.5 };
    let term = |exponents: [i16; 3], coefficients: [f64; 2]| Term {
        exponents: exponents.to_vec(),
        coefficients: coefficients.to_vec(),
    };
    let terms = [term([1, 2, 0], [0.4, -0.3]), term([-2, 0, 1], [0.2, 0.7]), term([0, 1, 1], [-0.6, 0.0])];
    let dictionary = Dictionary::new(&[angle, power, power], 2, &terms).unwrap();
    let steps = vec![
        Step::Interpolate { of: 0, column: 2, instants: vec![0.0, 1.0, 2.5], functions },
        Step::Columns { columns: vec![[1, 1], [0, 0], [1, 0]] },
        Step::Standardize { of: 2, mean: vec![0.1, -0.3, 0.4], scale: vec![0.7, 1.3, 2.0] },
        Step::Dictionary { of: 3, dictionary },
        Step::Call { of: 4, function: function([0.6, 0.3, -0.2, 0.4], 1.1) },
        Step::Rescale { of: 5, mean: vec![1.0, -2.0], scale: vec![0.6, 1.7] },
        Step::Combine { of: [6, 1], operation: Operation::Multiply },
    ];
    Graph { inputs: 3, steps }
}

/// A graph with equations of motion between other steps: those of the crane.
fn moved() -> Graph {
    let crane = example::crane();
    let motion = Box::new(crane.program().motion().unwrap().clone());
    let columns = vec![[0, 1], [0, 0], [0, 2], [0, 0], [0, 1], [0, 2]];
    let steps = vec![
        Step::Columns { columns },
        Step::Motion { of: 1, motion },
        Step::Columns { columns: vec![[2, 4], [2, 10]] },
        Step::Rescale { of: 3, mean: vec![1.0, -2.0], scale: vec![0.01, 0.02] },
        Step::Elementwise { of: 4, function: Elementwise::Activation(Activation::Sine), parameters: Vec::new() },
    ];
    Graph { inputs: 3, steps }
}

#[test]
fn derivatives_of_steps_with_memory_of_their_own_are_those_of_differences() {
    // as the last step, and before others; the derivative of the last step alone needs no value
    let mut last = nested();
    last.steps.truncate(5);
    for graph in [nested(), last, moved()] {
        let mut evaluator = Evaluator::new(&surrogate(graph.clone()));
        let (point, rates, bends) = ([0.16, 1.1, 1.3], [0.3, -0.7, 0.5], [0.2, 0.1, -0.4]);
        let (mut first, mut second, mut along) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        evaluator.along_curve(&point, [&rates, &bends], [&mut first, &mut second]);
        evaluator.directional(&point, &rates, &mut along);
        assert_eq!(along, first);
        let at = |t: f64| {
            let point = std::array::from_fn(|i| point[i] + rates[i] * t + 0.5 * bends[i] * t * t);
            outputs(&graph, point)
        };
        let (h, k) = (1e-5, 1e-3);
        let (ahead, behind, far, back, here) = (at(h), at(-h), at(k), at(-k), at(0.0));
        for output in 0..2 {
            let slope = (ahead[output] - behind[output]) / (2.0 * h);
            let bend = (far[output] - 2.0 * here[output] + back[output]) / (k * k);
            assert!(slope.abs() > 1e-3 && bend.abs() > 1e-3, "{slope} {bend}");
            assert!((first[output] - slope).abs() < 1e-8 * slope.abs().max(1.0), "{} {slope}", first[output]);
            assert!((second[output] - bend).abs() < 1e-4 * bend.abs().max(1.0), "{} {bend}", second[output]);
        }
        let weights = [0.8, -1.7];
        let found = gradient(&mut evaluator, &point, &weights);
        for (column, found) in found.iter().enumerate() {
            let at = |t: f64| {
                let point = std::array::from_fn(|i| point[i] + if i == column { t } else { 0.0 });
                outputs(&graph, point).iter().zip(weights).map(|(output, weight)| weight * output).sum::<f64>()
            };
            let slope = (at(h) - at(-h)) / (2.0 * h);
            assert!((found - slope).abs() < 1e-8 * slope.abs().max(1.0), "{column}: {found} {slope}");
        }
    }
}

#[test]
fn functions_that_are_called_compute_in_the_precision_of_the_model() {
    let double = surrogate(nested());
    let metadata = Metadata { precision: Precision::Single, ..double.metadata().clone() };
    let single = Surrogate::new(metadata, nested()).unwrap();
    let [mut double, mut single] = [&double, &single].map(Evaluator::new);
    let (point, weights) = ([0.16, 1.1, 1.3], [0.8, -1.7]);
    let (mut expected, mut found) = ([0.0; 2], [0.0; 2]);
    double.evaluate(&point, &mut expected);
    single.evaluate(&point, &mut found);
    assert!(found != expected);
    let slopes = gradient(&mut single, &point, &weights).into_iter().zip(gradient(&mut double, &point, &weights));
    for (found, expected) in found.into_iter().zip(expected).chain(slopes) {
        assert!((found - expected).abs() < 4e-6 * expected.abs().max(1.0), "{found} {expected}");
    }
}

#[test]
fn steps_that_scale_compute_the_same_anywhere() {
    let (mean, scale) = (vec![0.1, -2.0, 30.0], vec![0.5, 4.0, 7.0]);
    let standardize = |of| Step::Standardize { of, mean: mean.clone(), scale: scale.clone() };
    let rescale = |of| Step::Rescale { of, mean: mean.clone(), scale: scale.clone() };
    let same = |of| Step::Columns { columns: (0..3).map(|column| [of, column]).collect() };
    let x = [0.16, 1.1, 1.3];
    let standardized: [f64; 3] = std::array::from_fn(|i| (x[i] - mean[i]) / scale[i]);
    let rescaled: [f64; 3] = std::array::from_fn(|i| mean[i] + scale[i] * x[i]);
    for (steps, expected) in [
        (vec![standardize(0)], standardized),
        (vec![same(0), standardize(1)], standardized),
        (vec![standardize(0), same(1)], standardized),
        (vec![same(0), standardize(1), same(2)], standardized),
        (vec![rescale(0)], rescaled),
        (vec![rescale(0), same(1)], rescaled),
        (vec![same(0), rescale(1)], rescaled),
        (vec![same(0), rescale(1), same(2)], rescaled),
        (vec![standardize(0), rescale(1)], x),
        (vec![rescale(0), standardize(1)], x),
        // the first step, but not the only one of the columns; the last step, but not of the one before it
        (
            vec![standardize(0), Step::Combine { of: [1, 0], operation: Operation::Maximum }],
            std::array::from_fn(|i| standardized[i].max(x[i])),
        ),
        (vec![standardize(0), same(0), rescale(1)], x),
    ] {
        let graph = Graph { inputs: 3, steps };
        let found = graph.evaluate([x])[0].to_vec();
        let close = found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-13);
        assert!(close, "{found:?} {expected:?}: {:?}", graph.steps);
        let program = PreparedGraph::new(&graph, Precision::Double);
        let (mut scratch, simd) = (program.scratch(), Simd::detect());
        let (weights, mut gradient, mut along) = ([0.8, -1.7, 0.4], [0.0; 3], [0.0; 3]);
        let rates = [0.3, -0.7, 0.5];
        program.perform(simd, &x, Task::Adjoint { weights: &weights, gradient: &mut gradient }, &mut scratch);
        let task = Task::Series { rates: [&rates, &[]], first: &mut along, second: None };
        program.perform(simd, &x, task, &mut scratch);
        let moved = graph.evaluate([[0, 1, 2].map(|i| x[i] + 1e-4 * rates[i])])[0].to_vec();
        for i in 0..3 {
            let slope = (moved[i] - found[i]) / 1e-4;
            assert!((along[i] - slope).abs() < 1e-9, "{} {slope}: {:?}", along[i], graph.steps);
        }
        let forwards: f64 = weights.iter().zip(along).map(|(weight, along)| weight * along).sum();
        let backwards: f64 = gradient.iter().zip(rates).map(|(slope, rate)| slope * rate).sum();
        assert!((forwards - backwards).abs() < 1e-13, "{:?}", graph.steps);
    }
    let refused = |mean: Vec<f64>, scale: Vec<f64>| {
        let steps = vec![same(0), Step::Rescale { of: 1, mean, scale }];
        Graph { inputs: 3, steps }.check(3, 3).unwrap_err().to_string()
    };
    assert_eq!(refused(vec![0.0; 2], vec![1.0; 3]), "tensor `graph.1.mean` has shape [2], expected [3]");
    assert_eq!(refused(vec![0.0; 3], vec![1.0; 4]), "tensor `graph.1.scale` has shape [4], expected [3]");
    let message = refused(vec![0.0, f64::INFINITY, 0.0], vec![1.0; 3]);
    assert_eq!(message, "tensor `graph.1.mean`, element 1: inf is not finite");
    let message = refused(vec![0.0; 3], vec![1.0, 1.0, 0.0]);
    assert_eq!(message, "tensor `graph.1.scale`, element 2: 0 is not positive");
}

#[test]
fn graphs_with_steps_that_have_memory_of_their_own_are_read_as_they_were_written() {
    for graph in [nested(), moved()] {
        let written = surrogate(graph);
        let bytes = written.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&bytes).unwrap(), written);
        for position in 0..bytes.len() {
            for change in [0x01, 0x08, 0x80] {
                let mut damaged = bytes.clone();
                damaged[position] ^= change;
                let Ok(surrogate) = Surrogate::from_bytes(&damaged) else { continue };
                let mut evaluator = Evaluator::new(&surrogate);
                evaluator.evaluate(&[0.16, 1.1, 1.3], &mut [0.0; 2]);
            }
        }
    }
}

#[test]
fn functions_that_do_not_fit_are_refused() {
    let refused = |number: usize, change: &dyn Fn(&mut Step)| {
        let mut graph = nested();
        change(&mut graph.steps[number]);
        graph.check(3, 2).unwrap_err().to_string()
    };
    let called = |change: &dyn Fn(&mut Graph)| {
        refused(4, &|step| {
            let Step::Call { function, .. } = step else { unreachable!("it is a call") };
            change(function);
        })
    };
    let calls = "`graph.4.function` has a step that calls a function, or equations: expected none";
    for step in nested().steps.into_iter().filter(Step::is_nested).chain(moved().steps.into_iter().skip(1).take(1)) {
        let message = called(&|function| function.steps[1] = step.clone());
        assert!(message.starts_with(calls), "{message}");
    }
    assert!(called(&|function| function.inputs = 0).contains("shape [0], expected [2]"));
    assert!(called(&|function| function.inputs = 3).contains("shape [3], expected [2]"));
    assert!(called(&|function| function.steps.clear()).contains("`graph.steps` is missing"));
    let instants = |change: &dyn Fn(&mut usize, &mut Vec<Graph>)| {
        refused(0, &|step| {
            let Step::Interpolate { column, functions, .. } = step else { unreachable!("it has instants") };
            change(column, functions);
        })
    };
    let message = instants(&|column, _| *column = 3);
    assert_eq!(message, "tensor `graph.0.instants`, element 0: 3, expected less than 3");
    let message = instants(&|_, functions| functions[1].steps[2] = Step::Softmax { of: 2 });
    assert_eq!(message, "instant 1: steps of other kinds or precisions than at the first instant");
    let message = instants(&|_, functions| functions.iter_mut().for_each(|f| f.steps[2] = Step::Softmax { of: 2 }));
    assert!(message.starts_with("instant 0: `function` is not a network"), "{message}");
    let message = refused(3, &|step| {
        let Step::Dictionary { of, .. } = step else { unreachable!("it is a dictionary") };
        *of = 1;
    });
    assert_eq!(message, "tensor `graph.3.functions` has shape [3], expected [2]");
}

#[test]
fn tensors_of_other_shapes_are_refused() {
    let bytes = surrogate(graph()).to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    for (tensor, from, to, expected) in [
        ("graph.0.weight", "[4,3]", "[3,4]", "shape [3, 4], expected [4, 3]"),
        ("graph.7.columns", "[4,2]", "[2,4]", "shape [4], expected [2]"),
        ("graph.6.centres", "[2,4]", "[4,2]", "shape [2], expected [4]"),
        ("graph.9.forest.below", "[3,2]", "[2,3]", "shape [2, 3], expected [3, 2]"),
        ("graph.8.degrees", "[4,4]", "[2,8]", "shape [2, 8], expected [2, 4]"),
    ] {
        let entry = header.split_once(&format!("\"{tensor}\":")).unwrap().1.split_once('}').unwrap().0;
        let changed = header.replace(entry, &entry.replace(from, to));
        assert_ne!(changed, header, "{tensor}: {entry}");
        let file = [&bytes[..8], changed.as_bytes(), &bytes[8 + length..]].concat();
        let found = Surrogate::from_bytes(&file).unwrap_err().to_string();
        assert_eq!(found, format!("tensor `{tensor}` has {expected}"));
    }
}

#[test]
fn an_observer_corrects_states_where_outputs_are_not_what_it_predicted() {
    // y' = 0.5 y + h + u, h' = 0.9 h, with columns y, x_y, h, s, u
    let linear = || (vec![0.5, 1.0, 1.0, 0.0, 0.9, 0.0], vec![0.0, 0.0]);
    let observer = StateObserver { gain: vec![0.25, 0.5], first: vec![1.0, 0.125], stops: None, measured: None };
    let graph = Graph::of_observer([2, 1, 3], observer.clone(), linear(), None);
    let rows = vec![
        // as predicted; measured; at the start
        vec![2.0, 2.0, 4.0, 1.0, 10.0],
        vec![3.0, 2.0, 4.0, 1.0, 10.0],
        vec![3.0, 0.0, 4.0, 0.0, 10.0],
    ];
    let found = graph.evaluate(&rows);
    let state = |y: f64, h: f64| [0.5 * y + h + 10.0, 0.9 * h];
    let next = |y: f64, h: f64| [&state(y, h)[..1], &state(y, h), &[1.0]].concat();
    assert_eq!(found, Rows::from_iter([next(2.0, 4.0), next(2.25, 4.5), next(3.0, 4.375)]));
    // a sensor measures up to 2.5, the hidden state stops at 3.5
    let (stops, measured) = (Some(vec![[f64::NEG_INFINITY, f64::INFINITY], [0.0, 3.5]]), Some(vec![[0.0, 2.5]]));
    let graph = Graph::of_observer([2, 1, 3], StateObserver { stops, measured, ..observer }, linear(), None);
    let rows = vec![vec![2.5, 9.0, 4.0, 1.0, -3.0], vec![2.0, 9.0, 4.0, 1.0, -3.0]];
    let [beyond, before] = [state(9.0, 4.0)[0] - 13.0, state(9.0 - 0.125, 3.75)[0] - 13.0];
    let expected = Rows::from_iter([[2.5, beyond, 3.5, 1.0], [2.5, before, 3.375, 1.0]]);
    assert_eq!(graph.evaluate(&rows), expected);
}

#[test]
fn a_function_of_some_columns_is_that_of_the_others_without_them() {
    let whole = graph();
    let row = [0.3, -0.2, 0.7];
    let more = whole.clone().of_columns(5, [4, 0, 2]);
    more.check(5, 2).unwrap();
    assert_eq!(more.evaluate([[-0.2, 9.0, 0.7, 9.0, 0.3]]), whole.evaluate([row]));
}
