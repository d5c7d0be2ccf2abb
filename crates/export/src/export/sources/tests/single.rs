//! Sources in single precision, compared with the evaluator.

use super::*;

/// Results and all derivatives, of every kind of model, second derivatives included.
#[test]
fn in_single_precision_results_and_derivatives_are_those_of_the_evaluator_but_for_its_rounding() {
    for (hidden, activation) in LAYERS {
        let surrogate = example::with_network(hidden, activation);
        compare_single(&surrogate, scales_of_networks(&surrogate), 2e-5);
    }
    let per_instant = example::per_instant(&[24, 9], Activation::Tanh, Precision::Double);
    for surrogate in
        [per_instant, example::encoded(&bent(&example::with_network(&[24], Activation::Silu), Activation::Gelu))]
    {
        compare_single(&surrogate, scales_of_networks(&surrogate), 2e-5);
    }
    let example = example::surrogate();
    for surrogate in regressions(&example).into_iter().chain([graph(&example)]) {
        compare_single(&surrogate, [10.0, 0.03], 2e-5);
    }
    // second derivatives are differences of larger terms
    for surrogate in [
        example::crane(),
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
        pushed_by_nothing(),
        example::oscillator(Some(example::residual_network())),
        turning(Activation::Gelu),
        left_alone(),
        without_states(true),
        example::with_prescribed_trolley(&example::crane()),
        example::oscillator_by_graph(),
        example::recorded(),
        example::supported(),
        example::direct(),
        example::cell(),
        window(),
    ] {
        compare_single(&surrogate, [10.0, 1.0], 2e-5);
    }
    // the knots of the spline are a tenth of a radian apart: its third derivative is large
    compare_single(&example::crane_with_splines(), [100.0, 0.01], 2e-5);
}

#[test]
fn in_single_precision_steps_are_those_of_the_evaluator_but_for_its_rounding() {
    let (crane, oscillator) = (example::crane(), example::oscillator(Some(example::residual_network())));
    let controlled = example::integrated(&crane, Integration::ErrorControlled { tolerance: 1e-5, longest: 0.005 });
    let of_crane = &[1.4, 0.4, 0.9, -1.2, 2.0, 3.0][..];
    for (surrogate, inputs) in [(&controlled, of_crane), (&crane, of_crane), (&oscillator, &[1.2, 0.8, -0.5, 0.4])] {
        let mut steps = Steps::of(surrogate);
        let start = steps.start(inputs);
        let driven = steps.driven();
        // the last tolerance is below the least of single precision
        for (tolerance, clamp) in [(0.0, false), (0.0, true), (1e-5, false), (1e-10, false)] {
            let mut point = start.clone();
            for index in 0..200 {
                let rates = [3.0 - f64::from(index % 7), 4.0 * f64::from(index % 3 - 1)];
                steps.step(index == 0, &mut point, 0.02, tolerance, clamp, rates);
                point[driven] += 0.02 * (rates[0] + 0.01 * rates[1]);
            }
        }
        steps.step(true, &mut start.clone(), 1e9, 0.0, false, [0.0; 2]);
        let ends = steps.compare_within(2e-5, &[&SANITIZERS[..], &[SINGLE]].concat());
        assert!(ends[..800].iter().all(|end| *end == 0.0) && ends[800..] == [2.0]);
    }
    let surrogate = example::recorded();
    let mut steps = Steps::of(&surrogate);
    let start = steps.start(&[1.3, 0.4, 0.25, 1.0]);
    for sizes in [&[0.1][..], &[0.1 / 3.0], &[0.25, 0.37, 0.02, 0.1, 1.7], &[0.1 * (1.0 + 1e-7)]] {
        let mut point = start.clone();
        for (index, size) in (0..60).zip(sizes.iter().cycle()) {
            steps.step(index == 0, &mut point, *size, 0.0, true, [1.0, 0.0]);
            point[3] = 4.0 * (0.37 * f64::from(index)).sin();
        }
    }
    assert!(steps.compare_within(2e-5, &[&SANITIZERS[..], &[SINGLE]].concat()).iter().all(|end| *end == 0.0));
}

/// A million turns away a single has no digit left of an angle; whole turns are taken off before.
#[test]
fn in_single_precision_an_angle_may_go_around_for_long() {
    for (surrogate, inputs, angle) in [
        (example::crane(), &[1.4, 0.4, 0.9, -1.2, 2.0, 3.0][..], 7),
        (turning(Activation::Tanh), &[1.2, 0.8, -0.5, 0.4], 4),
    ] {
        let mut steps = Steps::of(&surrogate);
        let mut point = steps.start(inputs);
        let turns = 1e6 * std::f64::consts::TAU;
        for index in 0..50 {
            point[angle] += turns;
            let input: Vec<String> = point.iter().map(|value| format!("{value:e}")).collect();
            steps.input += &format!("1 {} 0.02 0 0 0 0\n", input.join(" "));
            point[angle] -= turns;
            let text = std::mem::take(&mut steps.input);
            steps.step(index == 0, &mut point, 0.02, 0.0, false, [0.0; 2]);
            steps.input = text;
            steps.expected.last_mut().unwrap()[2 + angle - surrogate.inputs().len()] += turns;
        }
        let found = numbers(&run_evaluator(&surrogate, include_str!("steps.c"), &[SINGLE], &steps.input));
        for (found, expected) in found.iter().zip(&steps.expected) {
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-6 * expected.abs().clamp(1.0, 10.0), "{found} {expected}");
            }
        }
        assert_eq!(found.len(), 50);
    }
}

/// Functions with arithmetic in double precision by the instructions of this processor: those of times, turns and valid values only.
#[cfg(target_arch = "x86_64")]
#[test]
fn in_single_precision_nothing_is_computed_in_double_precision_but_times_turns_and_values() {
    let may = [
        "advance_fixed",
        "advance_with_error_control",
        "by_inputs",
        "encode",
        "encode_rates",
        "enter",
        "find_turns",
        "go_on",
        "model_advance",
        "model_evaluate",
        "model_turned",
        "nearest",
        "parts",
        "within",
    ];
    let example = example::surrogate();
    let [polynomial, forest, kernel] = regressions(&example);
    for surrogate in [
        example::encoded(&example::per_instant(&[24, 9], Activation::Tanh, Precision::Double)),
        polynomial,
        forest,
        kernel,
        graph(&example),
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
        turning(Activation::Gelu),
        example::oscillator_by_graph(),
        example::recorded(),
        example::supported(),
        example::direct(),
        example::cell(),
    ] {
        let folder = tempfile::tempdir().unwrap();
        write_sources(folder.path(), &surrogate, FmiVersion::V2);
        let mut instructions = 0;
        for name in compiled(&surrogate, FmiVersion::V2) {
            if HOST_FILES.contains(&name) {
                continue;
            }
            let assembly = compile(folder.path(), &[name], &[SINGLE, "-fno-inline", "-S"], "code.s");
            let mut function = String::new();
            for line in fs::read_to_string(assembly).unwrap().lines() {
                if let Some(label) = line.strip_suffix(':').filter(|label| !label.starts_with('.')) {
                    function = label.split('.').next().unwrap().into();
                }
                let word = line.split_whitespace().next().unwrap_or("");
                let is_arithmetic = ["add", "sub", "mul", "div", "sqrt"]
                    .iter()
                    .any(|kind| ["sd", "pd"].iter().any(|end| word.trim_start_matches('v') == format!("{kind}{end}")));
                let is_allowed = may.iter().any(|name| function.ends_with(name));
                assert!(!is_arithmetic || is_allowed, "{name}, {function}: {line}");
                instructions += usize::from(word.ends_with("ss") || word.ends_with("ps"));
            }
        }
        assert!(instructions > 10, "the model is computed in single precision");
    }
}

#[test]
fn in_single_precision_what_has_no_meaning_is_no_program() {
    let refused = |surrogate: &Surrogate| {
        let folder = tempfile::tempdir().unwrap();
        write_sources(folder.path(), surrogate, FmiVersion::V2);
        let output = compiler()
            .args(["-std=c99", "-c", SINGLE, "-o"])
            .args([folder.path().join("data.o"), folder.path().join(FOLDER).join("model_data.c")])
            .output()
            .unwrap();
        assert!(!output.status.success());
        // in double precision it is one
        compile(folder.path(), &["model_data.c"], &["-c"], "data.o");
        String::from_utf8(output.stderr).unwrap()
    };
    let with = |change: &dyn Fn(&mut ScaledNetwork)| {
        let surrogate = example::with_network(&[24], Activation::Tanh);
        let mut network = surrogate.network().unwrap();
        change(&mut network);
        Surrogate::new(surrogate.metadata().clone(), Graph::from(&network)).unwrap()
    };
    let cancelling = with(&|network| {
        let last = network.layers.last_mut().unwrap();
        last.weight =
            (0..last.weight.len()).map(|index| if index % 2 == 0 { 3e6 } else { -3e6 }).collect::<Vec<f64>>().into();
    });
    assert!(refused(&cancelling).contains("the terms of a sum nearly cancel"), "{}", refused(&cancelling));
    // which is not a matter of units
    let mut metadata = cancelling.metadata().clone();
    metadata.outputs.iter_mut().for_each(|output| (output.min, output.max) = (-1e6, 1e6));
    let large = Surrogate::new(metadata.clone(), cancelling.program().clone()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write_sources(folder.path(), &large, FmiVersion::V2);
    compile(folder.path(), &["model_data.c"], &["-c", SINGLE], "data.o");
    metadata.inputs[0].max = 1e200;
    let wide = Surrogate::new(metadata, cancelling.program().clone()).unwrap();
    let [.., kernels] = regressions(&example::surrogate());
    let mut graph = kernels.program().graph.clone();
    let affine = graph.steps.iter_mut().find(|step| matches!(step, Step::Affine { .. }));
    let Some(Step::Affine { weight, .. }) = affine else { panic!("it has kernels") };
    *weight = weight.iter().map(|weight| 1e8 * weight).collect::<Vec<f64>>().into();
    let kernels = Surrogate::new(kernels.metadata().clone(), graph).unwrap();
    assert!(refused(&kernels).contains("the terms of a sum nearly cancel"));
    for huge in [
        with(&|network| network.scaling.output_mean[0] = 1e300),
        with(&|network| network.scaling.input_scale[0] = 1e-60),
        wide,
    ] {
        assert!(refused(&huge).contains("the model has numbers, or ranges, that single precision has not"));
    }
}
