use super::{builder::Builder, *};
use crate::import::onnx::proto::{
    DimensionProto, FLOAT, GraphProto, ModelProto, NodeProto, ShapeProto, TensorProto, TensorTypeProto, TypeProto,
    ValueInfoProto,
};
use metafmu_example as example;
use metafmu_runtime::{
    Activation,
    graph::{Elementwise, Operation},
};
use prost::Message;

const LINEAR: Elementwise = Elementwise::Linear;
const TANH: Elementwise = Elementwise::Activation(Activation::Tanh);

fn numbers(count: usize, seed: u64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| random.random::<f64>() - 0.5).collect()
}

fn outputs(graph: Graph, point: &[f64; 3]) -> Vec<f64> {
    let surrogate = Surrogate::new(example::surrogate().metadata().clone(), graph).unwrap();
    let mut evaluator = Evaluator::new(&surrogate);
    let mut outputs = vec![0.0; 2];
    evaluator.evaluate(point, &mut outputs);
    outputs
}

/// Graphs of the steps as they are, and simplified.
fn both(build: impl Fn(&mut Builder) -> usize) -> [Graph; 2] {
    let columns = |value: usize| vec![[value as u32, 0], [value as u32, 1]];
    let mut builder = Builder::new(3);
    let value = build(&mut builder);
    let steps = format!("{builder:?}");
    let mut plain = Builder::new(3);
    build(&mut plain);
    assert_eq!(format!("{plain:?}"), steps);
    let graph = plain.unsimplified(columns(value));
    [graph, builder.finish(columns(value)).unwrap()]
}

fn affine(builder: &mut Builder, of: usize, outputs: usize, seed: u64) -> usize {
    let width = builder.width(of);
    builder.affine(of, numbers(outputs * width, seed).into(), numbers(outputs, seed + 1).into()).unwrap()
}

fn check(what: &str, [plain, graph]: [Graph; 2], is_network: bool) {
    assert_eq!(graph.is_network(), is_network, "{what}: {graph:?}");
    for point in [[0.15, 0.3, 1.0], [0.1, 0.0, 0.0], [0.2, 5.0, 2.0]] {
        let (expected, found) = (outputs(plain.clone(), &point), outputs(graph.clone(), &point));
        for (found, expected) in found.iter().zip(&expected) {
            assert!((found - expected).abs() < 1e-13 * expected.abs().max(1.0), "{what}: {found} {expected}");
        }
    }
}

#[test]
fn fewer_steps_give_the_same() {
    let each = |width: usize, seed| numbers(2 * width, seed);
    let perceptron = both(|builder| {
        let scaled = builder.elementwise(0, LINEAR, each(3, 1)).unwrap();
        let hidden = affine(builder, scaled, 5, 2);
        let normal = builder.elementwise(hidden, LINEAR, each(5, 4)).unwrap();
        let tanh = builder.elementwise(normal, TANH, Vec::new()).unwrap();
        let same = builder.elementwise(tanh, Elementwise::Activation(Activation::Identity), Vec::new()).unwrap();
        let last = affine(builder, same, 4, 5);
        let scaled = builder.elementwise(last, LINEAR, vec![2.0, -1.0]).unwrap();
        let again = builder.elementwise(scaled, LINEAR, each(4, 7)).unwrap();
        builder.columns(vec![[again as u32, 3], [again as u32, 0]]).unwrap()
    });
    check("a perceptron with scalings", perceptron, true);
    let bottleneck = both(|builder| {
        let narrow = affine(builder, 0, 2, 1);
        let wide = affine(builder, narrow, 6, 3);
        let tanh = builder.elementwise(wide, TANH, Vec::new()).unwrap();
        affine(builder, tanh, 2, 5)
    });
    check("layers without an activation between them", bottleneck, true);
    let arranged = both(|builder| {
        let columns = builder.columns(vec![[0, 2], [0, 0], [0, 2], [0, 1]]).unwrap();
        let hidden = affine(builder, columns, 5, 3);
        let tanh = builder.elementwise(hidden, TANH, Vec::new()).unwrap();
        affine(builder, tanh, 2, 5)
    });
    check("columns in another order, one of them twice", arranged, true);
    let one_by_one = both(|builder| {
        let column = |builder: &mut Builder, column| builder.columns(vec![[0, column]]).unwrap();
        let (first, last) = (column(builder, 0), column(builder, 2));
        let scaled = builder.elementwise(first, LINEAR, vec![2.0, -0.3]).unwrap();
        let difference = builder.elementwise(last, LINEAR, vec![1.0, -0.5]).unwrap();
        let standardized = builder.elementwise(difference, LINEAR, vec![-3.0, 0.1]).unwrap();
        let all =
            [[standardized, 0], [0, 1], [scaled, 0], [standardized, 0]].map(|[of, column]| [of as u32, column as u32]);
        let all = builder.columns(all.to_vec()).unwrap();
        let hidden = affine(builder, all, 5, 3);
        let tanh = builder.elementwise(hidden, TANH, Vec::new()).unwrap();
        affine(builder, tanh, 2, 5)
    });
    check("inputs that are normalized one by one", one_by_one, true);
    let twice = both(|builder| {
        let scaled = builder.elementwise(0, LINEAR, each(3, 1)).unwrap();
        let other = builder.elementwise(0, LINEAR, each(3, 2)).unwrap();
        let all = [[scaled, 1], [other, 1], [other, 0]].map(|[of, column]| [of as u32, column as u32]);
        let all = builder.columns(all.to_vec()).unwrap();
        let hidden = affine(builder, all, 5, 3);
        let tanh = builder.elementwise(hidden, TANH, Vec::new()).unwrap();
        let last = affine(builder, tanh, 2, 5);
        let scaled_again = builder.columns(vec![[scaled as u32, 0]; 2]).unwrap();
        builder.add(Step::Combine { of: [last, scaled_again], operation: Operation::Multiply }, 2).unwrap()
    });
    check("a column that is scaled twice, and used elsewhere", twice, false);
    let residual = both(|builder| {
        let hidden = affine(builder, 0, 3, 3);
        let tanh = builder.elementwise(hidden, TANH, Vec::new()).unwrap();
        let unused = builder.elementwise(hidden, LINEAR, vec![1.0, 1.0]).unwrap();
        builder.elementwise(unused, TANH, Vec::new()).unwrap();
        let width = builder.width(tanh);
        let sum = builder.add(Step::Combine { of: [tanh, 0], operation: Operation::Add }, width).unwrap();
        affine(builder, sum, 2, 5)
    });
    assert!(residual[1].steps.len() == 4, "{:?}", residual[1]);
    check("a residual", residual, false);
    let shared = both(|builder| {
        let scaled = builder.elementwise(0, LINEAR, each(3, 1)).unwrap();
        let first = affine(builder, scaled, 2, 2);
        let second = affine(builder, scaled, 2, 4);
        builder.add(Step::Combine { of: [first, second], operation: Operation::Multiply }, 2).unwrap()
    });
    check("a value that two steps take", shared, false);
    let inputs_alone = both(|builder| builder.columns(vec![[0, 0], [0, 1], [0, 2]]).unwrap());
    check("nothing but columns", inputs_alone, false);
}

/// With weights of 1 behind it, the difference alone is visible.
#[test]
fn what_is_subtracted_from_inputs_is_subtracted_before_anything_else() {
    let (mean, factor) = (1e4, 5.0);
    let pass = || vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let standardized = |builder: &mut Builder, of: usize| {
        let difference = builder.elementwise(of, LINEAR, vec![1.0, -mean]).unwrap();
        builder.elementwise(difference, LINEAR, vec![factor, 0.25]).unwrap()
    };
    let network = |builder: &mut Builder, of: usize| {
        let first = builder.affine(of, pass().into(), vec![0.0; 2].into()).unwrap();
        builder.affine(first, vec![1.0, 0.0, 0.0, 1.0].into(), vec![0.5, -0.25].into()).unwrap()
    };
    let plain = both(|builder| {
        let scaled = standardized(builder, 0);
        network(builder, scaled)
    });
    let chosen = both(|builder| {
        let columns = builder.columns(vec![[0, 0], [0, 1], [0, 0]]).unwrap();
        let scaled = standardized(builder, columns);
        let again = builder.elementwise(scaled, LINEAR, vec![-1.0, 0.5]).unwrap();
        let back = builder.elementwise(again, LINEAR, vec![-1.0, 0.5]).unwrap();
        network(builder, back)
    });
    let two = both(|builder| {
        let parts = [0, 1, 2].map(|column| {
            let part = builder.columns(vec![[0, column]]).unwrap();
            standardized(builder, part)
        });
        let all = builder.columns(parts.map(|part| [part as u32, 0]).to_vec()).unwrap();
        network(builder, all)
    });
    let beside = both(|builder| {
        let scaled = standardized(builder, 0);
        let network = network(builder, scaled);
        let inputs = builder.columns(vec![[scaled as u32, 2]; 2]).unwrap();
        let zero = builder.elementwise(inputs, LINEAR, vec![0.0, 0.0]).unwrap();
        builder.add(Step::Combine { of: [network, zero], operation: Operation::Add }, 2).unwrap()
    });
    for (what, [_, graph], is_network) in
        [("plain", plain, true), ("chosen", chosen, true), ("column by column", two, true), ("two uses", beside, false)]
    {
        assert_eq!(graph.is_network(), is_network, "{what}: {graph:?}");
        for offset in [-0.2, -0.0625, 0.1, 0.15] {
            let point = [mean + offset, mean - offset, mean];
            let expected = [(point[0] - mean) * factor + 0.75, (point[1] - mean) * factor];
            for (found, expected) in outputs(graph.clone(), &point).into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-15, "{what}: {found} {expected}");
            }
        }
    }
}

#[test]
fn a_graph_is_appended_to_a_value() {
    let mut inner = Builder::new(2);
    let first = affine(&mut inner, 0, 3, 1);
    let second = inner.elementwise(first, Elementwise::Exponential, Vec::new()).unwrap();
    let inner = inner.unsimplified(vec![[second as u32, 2], [0, 1], [first as u32, 0]]);
    let mut outer = Builder::new(3);
    let before = affine(&mut outer, 0, 2, 5);
    let error = outer.append(0, &inner).unwrap_err();
    assert!(matches!(error, GraphError::Width { found: 3, expected: 2 }), "{error}");
    let value = outer.append(before, &inner).unwrap();
    assert_eq!(outer.width(value), 3);
    let behind = affine(&mut outer, value, 2, 7);
    let whole = outer.unsimplified(vec![[behind as u32, 0], [value as u32, 1]]);
    let mut alone = [Builder::new(3), Builder::new(3)];
    let value = affine(&mut alone[0], 0, 2, 5);
    affine(&mut alone[1], 0, 2, 7);
    let [first, last] = alone;
    let first = first.unsimplified(vec![[value as u32, 0], [value as u32, 1]]);
    let last = last.unsimplified(vec![[value as u32, 0]]);
    let point = [0.15, 0.3, 1.0];
    let between = inner.evaluate(&first.evaluate([point]))[0].to_vec();
    assert_eq!(whole.evaluate([point])[0], [last.evaluate([&between])[0][0], between[1]]);
}

#[test]
fn a_graph_that_is_too_large_is_refused() {
    let mut builder = Builder::new(3);
    let mut value = 0;
    let error = (0..40).find_map(|_| {
        let columns = (0..2 * builder.width(value)).map(|column| [value as u32, (column / 2) as u32]).collect();
        match builder.columns(columns) {
            Ok(next) => {
                value = next;
                None
            }
            Err(error) => Some(error),
        }
    });
    assert!(matches!(error, Some(GraphError::TooLarge { .. })), "{error:?}");
}

#[test]
fn more_inputs_than_an_fmu_may_have_are_refused_before_anything_is_made_of_them() {
    let interface = |count: usize| {
        let inputs: Vec<String> = (0..count).map(|input| format!("\"x{input}\":{{\"min\":0,\"max\":1}}")).collect();
        ModelInterface::from_json(&format!(
            "{{\"name\":\"n\",\"inputs\":{{{}}},\"outputs\":{{\"y\":{{}}}}}}",
            inputs.join(",")
        ))
    };
    assert!(interface(300).is_ok());
    let message = interface(200_001).unwrap_err().to_string();
    assert!(message.ends_with("inputs: 200001 inputs, expected at most 200000"), "{message}");
}

/// A node with an input and an output.
fn node(operator: &str, input: &str, output: &str) -> NodeProto {
    NodeProto {
        op_type: operator.into(),
        input: vec![input.into()],
        output: vec![output.into()],
        ..NodeProto::default()
    }
}

/// An ONNX file from the input `x`, a row of three columns, to the output `y`.
fn onnx_file(node: &[NodeProto], initializer: &[TensorProto]) -> Vec<u8> {
    let dim = [1, 3].map(|dim| DimensionProto { dim_value: Some(dim), dim_param: None }).to_vec();
    let tensor = TensorTypeProto { elem_type: FLOAT, shape: Some(ShapeProto { dim }) };
    let column =
        |name: &str, tensor_type| ValueInfoProto { name: name.into(), r#type: Some(TypeProto { tensor_type }) };
    let graph = GraphProto {
        node: node.to_vec(),
        initializer: initializer.to_vec(),
        input: vec![column("x", Some(tensor))],
        output: vec![column("y", None)],
        ..GraphProto::default()
    };
    ModelProto { graph: Some(graph), ..ModelProto::default() }.encode_to_vec()
}

fn problems(file: &[u8]) -> Vec<(ImportCause, Option<ImportPlace>)> {
    let errors = onnx::read(file, None).unwrap_err();
    errors.into_iter().map(|error| (error.cause, error.place)).collect()
}

#[test]
fn problems_of_models_have_a_cause_and_a_place() {
    let place = |number: usize, operator: &str| NodePlace { number, name: String::new(), operator: operator.into() };
    let steps = [node("Tanhh", "x", "a"), node("Loop", "a", "b"), node("Tanhh", "b", "y")];
    let unknown = [vec![place(0, "Tanhh"), place(2, "Tanhh")], vec![place(1, "Loop")]];
    let unknown = unknown.map(|nodes| (ImportCause::Unsupported, Some(ImportPlace::Nodes(nodes))));
    assert_eq!(problems(&onnx_file(&steps, &[])), unknown);

    let steps = [node("Identity", "x", "a"), node("Tanh", "b", "y")];
    let misplaced = ImportPlace::Nodes(vec![place(1, "Tanh")]);
    assert_eq!(problems(&onnx_file(&steps, &[])), [(ImportCause::Malformed, Some(misplaced))]);

    let large = TensorProto { name: "c".into(), dims: vec![1 << 40], data_type: FLOAT, ..TensorProto::default() };
    let initializer = ImportPlace::Initializer("c".into());
    assert_eq!(problems(&onnx_file(&[node("Tanh", "x", "y")], &[large])), [(ImportCause::TooLarge, Some(initializer))]);

    let output = ImportPlace::Output("y".into());
    assert_eq!(problems(&onnx_file(&[node("Tanh", "x", "z")], &[])), [(ImportCause::Malformed, Some(output))]);
    assert_eq!(problems(b"no model"), [(ImportCause::Malformed, None)]);
}
