use super::{candidates::judged, *};
use crate::{
    baselines::BaselineKind,
    pipeline::Silent,
    processor_time::{ProcessorClock, ProcessorTimer},
};
use rand::RngExt as _;
use std::sync::atomic::AtomicBool;

/// Random points of a square.
fn points(rows: usize, seed: u64) -> Rows {
    let mut random = sampling::random(seed, Stream::Test);
    (0..rows).map(|_| [random.random_range(-1.0..1.0), random.random_range(-1.0..1.0)]).collect()
}

fn smooth(point: &[f64]) -> Vec<f64> {
    vec![(2.0 * point[0]).sin() * (1.5 * point[1]).exp(), 7.0]
}

fn fitted(x: &Rows, y: &Rows, options: &FitOptions) -> Result<(Surrogate, Fit)> {
    fitted_unless(x, y, options, &AtomicBool::new(false))
}

fn fitted_unless(x: &Rows, y: &Rows, options: &FitOptions, stop: &AtomicBool) -> Result<(Surrogate, Fit)> {
    let interface = r#"{"name": "f", "time": {"stop": 1.0, "step": 0.1}, "inputs": {"a": {}, "b": {}}, "outputs": {"y": {}, "constant": {}}}"#;
    let control = Control { observer: &Silent, stop, program: Path::new(""), heard: |_| {} };
    fit((x.clone(), y), &ModelInterface::from_json(interface)?, options, control)
}

fn quick(model: ModelChoice) -> FitOptions {
    let network = NetworkOptions { hidden: vec![8], ..NetworkOptions::default() };
    let training = TrainingOptions { epochs: 5, ..TrainingOptions::default() };
    FitOptions { model, network, training, measure: true, ..FitOptions::default() }
}

fn model_choice(name: &str) -> std::result::Result<ModelChoice, UnknownModel> {
    ModelChoice::try_from(name.to_owned())
}

#[test]
fn a_smooth_function_of_few_rows_is_a_gaussian_process_of_the_same_bytes_each_time() {
    let x = points(60, 1);
    let y: Rows = x.iter().map(smooth).collect();
    let training = TrainingOptions { epochs: 300, ..TrainingOptions::default() };
    let options = FitOptions { training, ..quick(ModelChoice::Auto) };
    let (surrogate, fit) = fitted(&x, &y, &options).unwrap();
    assert_eq!((fit.model, fit.train_rows, fit.validation_rows, fit.epochs), ("gaussian-process", 60, 0, 0));
    assert!(fit.best_epoch.is_none() && fit.stopped.is_none() && fit.train_loss.is_empty());
    let names: Vec<&str> = fit.candidates.iter().map(|row| row.model).collect();
    assert_eq!(names, ["polynomial", "gaussian-process", "network"]);
    let errors: Vec<f64> = fit.candidates.iter().map(|row| row.one_minus_r2.unwrap()).collect();
    assert!(errors[1] < 1e-2 * errors[2] && errors[1] < errors[0], "{errors:?}");
    let unseen = points(500, 2);
    let labels: Rows = unseen.iter().map(smooth).collect();
    let rmse =
        |surrogate: &Surrogate| Accuracy::of_rows(surrogate, TestRows::Given, &unseen, &labels).outputs["y"].mse.sqrt();
    let (network, of_network) =
        fitted(&x, &y, &FitOptions { model: model_choice("network").unwrap(), ..options.clone() }).unwrap();
    assert_eq!((of_network.model, of_network.epochs), ("network", of_network.train_loss.len()));
    assert!(10.0 * rmse(&surrogate) < rmse(&network), "{} {}", rmse(&surrogate), rmse(&network));
    // an output that does not vary is exact
    let accuracy = fit.accuracy.unwrap();
    assert_eq!((accuracy.rows, accuracy.outputs["constant"].mse), (Some(TestRows::CrossValidated), 0.0));
    let measured = accuracy.outputs["y"].mse.sqrt() / rmse(&surrogate);
    assert!((0.2..20.0).contains(&measured), "{measured}");
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (again, _) = pool.install(|| fitted(&x, &y, &options)).unwrap();
        assert_eq!(again.to_bytes().unwrap(), surrogate.to_bytes().unwrap(), "{threads} threads");
    }
}

#[test]
fn predicted_standard_deviations_follow_the_outputs_of_a_gaussian_process() {
    let x = points(100, 1);
    let mut random = sampling::random(9, Stream::Test);
    // a uniform error with a standard deviation of 0.05
    let error = 0.05 * 3f64.sqrt();
    let y: Rows = x.iter().map(|point| [smooth(point)[0] + random.random_range(-error..error), 7.0]).collect();
    let options = FitOptions { std: true, ..quick(ModelChoice::Auto) };
    let (surrogate, fit) = fitted(&x, &y, &options).unwrap();
    assert_eq!((fit.model, fit.candidates.len()), ("gaussian-process", 1));
    let names: Vec<(&str, Option<u32>)> = surrogate.outputs().iter().map(|of| (of.name.as_str(), of.std_of)).collect();
    assert_eq!(names, [("y", None), ("constant", None), ("y_std", Some(0)), ("constant_std", Some(1))]);
    let found = evaluation::predict_rows(&surrogate, &Rows::from_iter([[0.1, 0.2], [30.0, 0.0]]));
    assert!((0.04..0.07).contains(&found[0][2]) && found[1][2] > 0.5, "{found:?}");
    assert!(found.iter().all(|row| (row[1], row[3]) == (7.0, 0.0)), "{found:?}");
    // the predictions are those of the same model without them
    let (alone, of_alone) = fitted(&x, &y, &quick(model_choice("gaussian-process").unwrap())).unwrap();
    assert_eq!(evaluation::predict_rows(&alone, &Rows::from_iter([[0.1, 0.2]]))[0], found[0][..2]);
    let accuracy = fit.accuracy.unwrap();
    let within = accuracy.outputs["y"].within_two_std.unwrap();
    assert!(
        (0.9..=1.0).contains(&within) && accuracy.outputs["y"].mse > 0.0 && accuracy.outputs.len() == 2,
        "{within}"
    );
    let without = |accuracy: &Accuracy| {
        let mut outputs = accuracy.outputs.clone();
        outputs.values_mut().for_each(|metrics| metrics.within_two_std = None);
        outputs
    };
    assert_eq!(without(&accuracy), without(&of_alone.accuracy.unwrap()));
    assert!(fit.unseen.unwrap().predictions.iter().all(|row| row.len() == 4 && row[2] > 0.0));
    let refused = |options: FitOptions, rows: usize| {
        let x = points(rows, 1);
        let y: Rows = x.iter().map(smooth).collect();
        fitted(&x, &y, &options).unwrap_err().to_string()
    };
    let message = refused(FitOptions { std: true, ..quick(model_choice("polynomial").unwrap()) }, 50);
    assert!(
        message.contains("std: polynomial has no predicted standard deviation, expected gaussian-process"),
        "{message}"
    );
    let message = refused(options, 1001);
    assert!(message.contains("std: 1001 rows, expected 2 to 1000 for a predicted standard deviation"), "{message}");
}

#[test]
fn a_small_network_of_few_rows_is_better_than_one_of_epochs_and_uses_all_rows() {
    let x = points(60, 1);
    let y: Rows = x.iter().map(smooth).collect();
    let of_epochs = TrainingOptions { epochs: 300, ..TrainingOptions::default() };
    let options = FitOptions { training: of_epochs, ..quick(model_choice("network").unwrap()) };
    let small = FitOptions { small_networks: SmallNetworks::OfChosenSize, ..options.clone() };
    let error = |fit: &Fit| 1.0 - fit.accuracy.as_ref().unwrap().outputs["y"].r2.unwrap();
    let [(surrogate, fit), (_, large)] = [&small, &options].map(|options| fitted(&x, &y, options).unwrap());
    assert!(100.0 * error(&fit) < error(&large), "{} {}", error(&fit), error(&large));
    assert_eq!((fit.model, fit.train_rows, fit.validation_rows, fit.epochs), ("network", 60, 0, 0));
    assert_eq!(fit.accuracy.unwrap().outputs["constant"].mse, 0.0);
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let (again, _) = pool.install(|| fitted(&x, &y, &small)).unwrap();
        assert_eq!(again.to_bytes().unwrap(), surrogate.to_bytes().unwrap(), "{threads} threads");
    }
    let stopped = fitted_unless(&x, &y, &small, &AtomicBool::new(true));
    assert!(matches!(stopped, Err(Error::Interrupted)));
}

#[test]
fn each_fold_is_judged_with_the_candidate_that_the_other_folds_choose() {
    // enough of them that no other candidate is as good by the standard error
    let order: Vec<usize> = (0..200).collect();
    let outputs: Rows = order.iter().map(|row| vec![*row as f64]).collect();
    // a candidate for each fold, with no error there only: by their own fold they would seem perfect
    let perfect_in = |fold: usize| -> Rows {
        order.iter().map(|row| vec![if row % 5 == fold { *row as f64 } else { -1000.0 }]).collect()
    };
    let candidates: Vec<Rows> = (0..5).map(perfect_in).collect();
    let candidates: Vec<&Rows> = candidates.iter().collect();
    let found = judged(&outputs, &candidates, &order);
    assert!(found.iter().all(|values| values == [-1000.0]), "{found:?}");
    // one that is better everywhere is chosen for all
    let good: Rows = order.iter().map(|row| vec![*row as f64 + 0.1]).collect();
    assert_eq!(judged(&outputs, &[candidates[0], &good], &order), good);
}

#[test]
fn rows_that_judge_take_no_part_in_the_choice_and_the_fit() {
    let x = points(FEW_ROWS, 3);
    let y: Rows = x.iter().map(smooth).collect();
    let order = sampling::permutation(x.len(), sampling::random(0, Stream::Validation));
    let judging = RowSplit::of(&order, &TrainingOptions::default(), true).judging;
    let mut others = y.clone();
    judging.iter().for_each(|row| others[*row].copy_from_slice(&[1e3, 7.0]));
    for model in [ModelChoice::Auto, model_choice("polynomial").unwrap()] {
        let [(surrogate, fit), (same, of_others)] = [&y, &others].map(|y| fitted(&x, y, &quick(model)).unwrap());
        assert_eq!(fit.train_rows, if fit.model == "network" { 900 } else { 950 }, "{}", fit.model);
        assert_eq!(surrogate.program(), same.program(), "{model:?}");
        let [accuracy, wrong] = [fit, of_others].map(|fit| fit.accuracy.unwrap());
        assert_eq!((accuracy.rows, accuracy.test_rows), (Some(TestRows::HeldOut), 50));
        assert!(accuracy.outputs["y"].mse < 1.0 && wrong.outputs["y"].mse > 1e5);
    }
}

#[test]
fn a_table_of_any_length_is_fitted_and_candidates_that_cannot_be_say_why() {
    for rows in [1, 2, 3, 5, FEW_ROWS + 1] {
        let x = points(rows, 4);
        let y: Rows = x.iter().map(smooth).collect();
        let (surrogate, fit) = fitted(&x, &y, &quick(ModelChoice::Auto)).unwrap();
        assert_eq!(fit.candidates.len(), if rows == 1 { 1 } else { 3 });
        assert!(fit.candidates.iter().any(|row| row.model == fit.model && row.note.is_empty()), "{:?}", fit.candidates);
        assert_eq!(fit.accuracy.is_some(), rows > 1);
        assert_eq!(surrogate.metadata().provenance.train_rows, rows as u64);
        if rows > FEW_ROWS {
            let process = &fit.candidates[1];
            assert_eq!((process.note.as_str(), process.one_minus_r2), ("1001 rows, expected at most 1000", None));
        }
    }
    // that kind was asked for
    let x = points(FEW_ROWS + 1, 4);
    let y: Rows = x.iter().map(smooth).collect();
    let options = FitOptions { measure: false, ..quick(model_choice("svr").unwrap()) };
    let (_, fit) = fitted(&x, &y, &options).unwrap();
    assert_eq!((fit.train_rows, fit.candidates[0].note.as_str()), (1000, "fitted to 1000 of 1001 rows"));
}

#[test]
fn what_cannot_be_fitted_is_refused_with_the_reason_of_each_candidate() {
    // squares of such numbers are infinite
    for rows in [20, FEW_ROWS] {
        let x = points(rows, 7);
        let y: Rows = x.iter().map(|point| vec![1e200 * point[0], 7.0]).collect();
        let refused = fitted(&x, &y, &quick(ModelChoice::Auto)).unwrap_err().to_string();
        for kind in ["polynomial", "gaussian-process", "network"] {
            assert!(refused.contains(&format!("{kind}: ")), "{refused}");
        }
        let refused = fitted(&x, &y, &quick(model_choice("gaussian-process").unwrap())).unwrap_err().to_string();
        assert!(refused.contains("f: gaussian-process: "), "{refused}");
    }
}

#[test]
fn a_comparison_that_is_stopped_is_interrupted() {
    for rows in [20, FEW_ROWS] {
        let x = points(rows, 6);
        let y: Rows = x.iter().map(smooth).collect();
        for model in [ModelChoice::Auto, model_choice("network").unwrap()] {
            let stopped = fitted_unless(&x, &y, &quick(model), &AtomicBool::new(true));
            assert!(matches!(stopped, Err(Error::Interrupted)), "{rows} {model:?}");
        }
    }
}

#[test]
fn folds_that_are_fitted_side_by_side_count_their_processor_time_once() {
    let x = points(200, 5);
    let y: Rows = x.iter().map(smooth).collect();
    let all = ProcessorTimer::start(ProcessorClock::Process);
    let (_, fit) = fitted(&x, &y, &quick(ModelChoice::Auto)).unwrap();
    let of_candidates: f64 = fit.candidates.iter().filter_map(|row| row.fit_seconds).sum();
    assert!(0.0 < of_candidates && of_candidates <= all.seconds(), "{of_candidates} of {}", all.seconds());
}

#[test]
fn every_kind_is_fitted_by_its_name_and_others_are_refused() {
    let x = points(40, 5);
    let y: Rows = x.iter().map(smooth).collect();
    for kind in BaselineKind::ALL.into_iter().filter(|kind| *kind != BaselineKind::Knn) {
        let (_, fit) = fitted(&x, &y, &quick(model_choice(kind.name()).unwrap())).unwrap();
        assert_eq!((fit.model, fit.train_rows), (kind.name(), 40));
        let [row] = &fit.candidates[..] else { panic!("{:?}", fit.candidates) };
        assert!(row.one_minus_r2.is_some() && row.fit_seconds.is_some(), "{row:?}");
        assert_eq!(fit.accuracy.unwrap().outputs["constant"].mse, 0.0, "{}", kind.name());
    }
    for name in ["knn", "kriging", ""] {
        let problem = model_choice(name).unwrap_err().to_string();
        assert!(
            problem.starts_with(&format!("model: `{name}`, expected one of auto, network, linear, ridge, ")),
            "{problem}"
        );
    }
}

#[test]
fn no_row_both_learns_chooses_and_judges() {
    for (rows, measure, judges, choosers) in [
        (1, true, 0, 1),
        (30, true, 0, 3),
        (30, false, 0, 3),
        (1000, true, 50, 50),
        (5000, true, 250, 250),
        (5000, false, 0, 500),
    ] {
        let order: Vec<usize> = (0..rows).collect();
        let RowSplit { judging, choosing, seen } = RowSplit::of(&order, &TrainingOptions::default(), measure);
        assert_eq!((judging.len(), choosing.len()), (judges, choosers), "{rows}");
        let all: Vec<usize> = [judging, choosing, seen].concat();
        assert!(rows == 1 || all == order, "{rows}");
    }
}

#[test]
fn options_beyond_their_limits_are_refused_by_name_before_anything_is_allocated() {
    type OptionsChange = fn(&mut FitOptions);
    let found = |change: OptionsChange| {
        let mut options = FitOptions::default();
        change(&mut options);
        problems(&options, [3, 2]).join("; ")
    };
    assert_eq!(found(|_| ()), "");
    let cases: [(OptionsChange, &str); 7] = [
        (|of| of.training.learning_rate = f64::NAN, "training.learning_rate: NaN, expected a positive number"),
        (|of| of.training.l2 = -1.0, "training.l2: -1, expected 0 or a positive number"),
        (|of| of.training.batch = 0, "training.batch: 0, expected at least 1 row"),
        (|of| of.training.output_weights = vec![1.0], "training.output_weights: 1 weights, expected one for each"),
        (
            |of| of.network.hidden = vec![1_000_000; 2],
            "network.hidden: hidden layer 1 has 1000000 nodes, expected 1 to 16384; network.hidden: hidden layer 2",
        ),
        (
            |of| of.network.hidden = vec![16_384; 2],
            "network.hidden: 2.686e8 weights and biases, expected at most 100 million",
        ),
        (|of| of.network.structure = TimeStructure::Fixed, "network.structure: belongs to studies"),
    ];
    for (change, expected) in cases {
        let found = found(change);
        assert!(found.starts_with(expected), "{found}, expected {expected}");
    }
}
