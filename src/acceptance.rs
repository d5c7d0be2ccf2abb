//! Whether a surrogate is good enough to be used: `[accept]` of the study.

use crate::{
    baseline::{Comparison, ModelRow, Status, comparison::NETWORK},
    evaluation::{Accuracy, Horizon, OutputMetrics, RollOuts},
    html::number,
    study::{AcceptOptions, Study},
};
use metafmu_runtime::{Output, Surrogate};

/// What keeps a surrogate from being accepted, measured on these `runs` ("test runs"). Baselines are those of the study's builds,
/// measured on the same runs.
pub fn problems(
    study: &Study,
    surrogate: &Surrogate,
    accuracy: &Accuracy,
    comparison: Option<&Comparison>,
    runs: &str,
) -> Vec<String> {
    let baselines: Vec<&ModelRow> = comparison.map_or(Vec::new(), |comparison| of_build(study, comparison));
    let outputs = surrogate.outputs().iter().filter_map(|output| Some((output, accuracy.outputs.get(&output.name)?)));
    // of a motion that is chaotic nothing is explained in the end: what counts is a sixth of the runs' length
    let is_motion = accuracy.roll_outs.is_some();
    let off_course = accuracy.roll_outs.as_ref().and_then(|roll_outs| strayed(&study.accept, roll_outs, runs));
    let of_output = |(output, metrics): (&Output, &OutputMetrics)| {
        [
            unexplained(&study.accept, metrics, runs).filter(|_| !is_motion),
            missed(study, metrics, runs),
            beaten(&study.accept, output, metrics, &baselines),
            far_off(&study.accept, metrics),
        ]
        .into_iter()
        .flatten()
        .map(|problem| format!("{}: {problem}", output.name))
        .collect::<Vec<String>>()
    };
    off_course.into_iter().chain(outputs.flat_map(of_output)).collect()
}

fn of_build<'a>(study: &Study, comparison: &'a Comparison) -> Vec<&'a ModelRow> {
    let in_build = |row: &&ModelRow| study.baselines.build.iter().any(|kind| kind.name() == row.model);
    let measured = |row: &&ModelRow| row.model != NETWORK && row.status == Status::Fine;
    comparison.models.iter().filter(measured).filter(in_build).collect()
}

fn unexplained(options: &AcceptOptions, metrics: &OutputMetrics, runs: &str) -> Option<String> {
    let r2 = metrics.r2.filter(|&r2| r2 < options.r2)?;
    let mean = if r2 < 0.0 { ": its mean would be better" } else { "" };
    Some(format!("R² {} on the {runs}, expected at least {} (accept.r2){mean}", short(r2), options.r2))
}

/// The relative error `e` of the median run is an R² of `1 - e²`.
fn strayed(options: &AcceptOptions, roll_outs: &RollOuts, runs: &str) -> Option<String> {
    let Horizon { seconds, median, sensitivity: [sensitivity, _], .. } = roll_outs.horizons.first()?;
    let r2 = 1.0 - median * median;
    if r2 >= options.r2 {
        return None;
    }
    let (r2, seconds, least) = (short(r2.max(f64::MIN)), number(*seconds), options.r2);
    let chaos = if *sensitivity > 1e-3 { ": the motion is chaotic, a shorter `time.stop` can be judged" } else { "" };
    Some(format!("R² {r2} in the median of the {runs} up to {seconds} s, expected at least {least} (accept.r2){chaos}"))
}

/// A target was met on few runs: what is left unexplained on others may be off by half, but not by more.
fn missed(study: &Study, metrics: &OutputMetrics, runs: &str) -> Option<String> {
    let target = study.target?.r2;
    let r2 = metrics.r2.filter(|r2| 1.0 - r2 > 2.0 * (1.0 - target))?;
    Some(format!("R² {} on the {runs}, more than twice as far from 1 as the target, {target} (target.r2)", short(r2)))
}

fn beaten(
    options: &AcceptOptions,
    output: &Output,
    metrics: &OutputMetrics,
    baselines: &[&ModelRow],
) -> Option<String> {
    let r2 = metrics.r2.filter(|&r2| r2 < AcceptOptions::EXCELLENT)?;
    let measured = baselines.iter().filter_map(|row| Some((row, row.outputs.get(&output.name)?)));
    let (best, accuracy) = measured.min_by(|a, b| a.1.mse.total_cmp(&b.1.mse))?;
    let factor = (metrics.mse / accuracy.mse).sqrt();
    if factor <= options.baseline_factor {
        return None;
    }
    let found = format!("root mean square error {} times that of the baseline {}", short(factor), best.model);
    let r2s = format!("(R² {} against {})", short(r2), accuracy.r2.map_or("-".into(), short));
    Some(format!("{found} {r2s}, expected at most {} times (accept.baseline_factor)", options.baseline_factor))
}

fn far_off(options: &AcceptOptions, metrics: &OutputMetrics) -> Option<String> {
    let limit = options.largest_error?;
    let share = metrics.relative_max_error.filter(|&share| share > limit)?;
    let share = short(share);
    Some(format!("largest error {share} of its range in training, expected at most {limit} (accept.largest_error)"))
}

/// Four digits, or as many as tell it from 1.
fn short(value: f64) -> String {
    match value {
        _ if value.abs() >= 1e4 => format!("{value:.2e}"),
        _ if (0.99..1.0).contains(&value) => format!("{value:.6}"),
        _ => format!("{value:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::baseline::ModelAccuracy;
    use crate::evaluation::Verdict;
    use metafmu_runtime::example;
    use std::path::Path;

    const STUDY: &str = include_str!("../examples/single-pendulum.toml");

    fn metrics(r2: Option<f64>, mse: f64) -> OutputMetrics {
        OutputMetrics {
            r2,
            mse,
            max_abs_error: 0.3,
            relative_max_error: Some(0.02),
            worst_run: 0,
            worst_time: 0.0,
            bound: None,
            within_bound: None,
        }
    }

    fn baseline(model: &str, status: Status, mse: f64) -> ModelRow {
        let accuracy = ModelAccuracy { r2: Some(1.0 - mse), mse, max_abs_error: 0.5 };
        ModelRow {
            model: model.into(),
            status,
            note: String::new(),
            rows: 10,
            fit_seconds: None,
            predict_seconds_per_point: None,
            memory_bytes: None,
            exportable: true,
            outputs: [("angle".to_owned(), accuracy)].into(),
        }
    }

    /// What is said of the example whose outputs have these figures, beside a decision tree with an R² of 0.95 and better models
    /// that are no part of a build or could not be fitted.
    fn said(accept: &str, angle: OutputMetrics, velocity: OutputMetrics) -> Vec<String> {
        let study = Study::parse(&format!("{STUDY}\n[accept]\n{accept}\n"), Path::new("s.toml")).unwrap();
        let accuracy = Accuracy {
            outputs: [("angle".to_owned(), angle), ("velocity".to_owned(), velocity)].into(),
            test_runs: 20,
            test_rows: 100,
            content_digest: String::new(),
            roll_outs: None,
            rows: None,
            seen_until: None,
            verdict: None,
        };
        let models = vec![
            baseline(NETWORK, Status::Fine, 0.0),
            baseline("linear", Status::Fine, 0.5),
            baseline("decision-tree", Status::Fine, 0.05),
            baseline("polynomial", Status::Failed, 1e-9),
            baseline("random-forest", Status::Fine, 1e-9),
        ];
        let comparison = Comparison { name: "s".into(), content_digest: None, test_runs: 20, test_rows: 100, models };
        problems(&study, &example::surrogate(), &accuracy, Some(&comparison), "test runs")
    }

    #[test]
    fn a_good_surrogate_is_accepted_and_constant_outputs_are_not_judged() {
        assert_eq!(said("", metrics(Some(0.9), 0.1), metrics(None, 1.0)), Vec::<String>::new());
        assert_eq!(Verdict::of(Vec::new()).text(), "");
    }

    #[test]
    fn an_output_worse_than_its_mean_or_than_the_best_baseline_of_the_build_is_rejected() {
        let found = said("", metrics(Some(-388.2), 389.2), metrics(Some(0.5), 1.0));
        assert_eq!(
            found,
            [
                "angle: R² -388.200 on the test runs, expected at least 0 (accept.r2): its mean would be better",
                "angle: root mean square error 88.227 times that of the baseline decision-tree (R² -388.200 against 0.950), \
                 expected at most 2 times (accept.baseline_factor)",
            ]
        );
        let found = said("", metrics(Some(0.69), 0.31), metrics(Some(0.0), 1.0));
        assert!(found.len() == 1 && found[0].contains("2.490 times that of the baseline decision-tree"), "{found:?}");
        assert!(Verdict::of(found).text().starts_with("\nrejected: "));
        // as good as anyone may wish
        let exact = said("baseline_factor = 1.0", metrics(Some(0.99995), 0.06), metrics(None, 0.0));
        assert_eq!(exact, Vec::<String>::new());
    }

    #[test]
    fn a_target_that_was_met_on_held_out_runs_only_is_missed() {
        let of = |r2: f64| {
            let target = "baseline_factor = inf\n[target]\nr2 = 0.99\nruns = 10\nmax_runs = 2000";
            said(target, metrics(Some(r2), 1.0 - r2), metrics(Some(0.995), 0.005))
        };
        assert_eq!(of(0.981), Vec::<String>::new());
        let expected =
            "angle: R² 0.970 on the test runs, more than twice as far from 1 as the target, 0.99 (target.r2)";
        assert_eq!(of(0.97), [expected]);
    }

    #[test]
    fn limits_are_those_of_the_study() {
        let of = |accept: &str| said(accept, metrics(Some(0.69), 0.31), metrics(Some(0.8), 0.2));
        assert_eq!(of("baseline_factor = 2.5"), Vec::<String>::new());
        assert_eq!(of("baseline_factor = inf\nr2 = -inf"), Vec::<String>::new());
        let found = of("baseline_factor = inf\nr2 = 0.75");
        assert_eq!(found, ["angle: R² 0.690 on the test runs, expected at least 0.75 (accept.r2)"]);
        let found = of("baseline_factor = inf\nlargest_error = 1e-3");
        let expected =
            "angle: largest error 0.020 of its range in training, expected at most 0.001 (accept.largest_error)";
        assert_eq!((found.len(), found[0].as_str()), (2, expected));
    }
}
