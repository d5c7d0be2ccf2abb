//! Verdict on a surrogate by `[accept]` of the study: good, usable, or rejected.

use crate::{
    diagnostics::numbers::{number, power},
    evaluation::{
        AcceptanceCheck, Accuracy, Findings, Grade, Horizon, OutputMetrics, OutsideRows, Reason, RollOuts, Verdict,
        comparison::{Comparison, ModelRow, ModelStatus, NETWORK},
    },
    study::{AcceptOptions, Study},
};
use indexmap::IndexSet;
use metafmu_runtime::{Output, Surrogate};
use std::f64::consts::{PI, TAU};

/// Relative difference up to which two errors count as equal.
const TIE: f64 = 1e-3;
/// Variance of an angle that is spread evenly over a turn.
const TURN_VARIANCE: f64 = PI * PI / 3.0;

/// Verdict on a surrogate that was measured on these `runs` ("test runs"). Baselines are those of the study's builds, measured on the
/// same runs. `others`: findings of all checks other than the accuracy; their advice helps if something was learned badly.
///
/// A surrogate that is not good on all rows is judged on the rows before motions leave the domain and, if the source's own equations were
/// integrated, by these in place of the source's runs. The best of these verdicts counts, with what it rests on; of equal ones that by the
/// equations, which do not have the errors of the source's time step.
pub fn judge(
    study: &Study,
    surrogate: &Surrogate,
    (accuracy, runs): (&Accuracy, &str),
    comparison: Option<&Comparison>,
    others: Findings,
) -> Verdict {
    let of_runs = judge_inside(study, surrogate, (accuracy, runs), comparison, others.clone());
    let equations = accuracy.source_equations.as_ref().filter(|equations| equations.explain(accuracy));
    let Some(equations) = equations.filter(|_| of_runs.grade != Grade::Good) else { return of_runs };
    let (limit, advice) = equations.findings();
    let mut others = others;
    others.limits.push(limit);
    let name = "runs of the source's equations";
    let mut of_equations = judge_inside(study, surrogate, (&equations.surrogate, name), None, others);
    // of equal grades that which knows what the difference from the source's runs comes from
    if better(&of_runs, &of_equations) {
        return of_runs;
    }
    of_equations.advice.insert(0, advice);
    of_equations
}

/// Verdict by all rows or, if these are not good, by those before motions leave the domain.
fn judge_inside(
    study: &Study,
    surrogate: &Surrogate,
    (accuracy, runs): (&Accuracy, &str),
    comparison: Option<&Comparison>,
    others: Findings,
) -> Verdict {
    let of_all = judge_rows(study, surrogate, (accuracy, runs), comparison, others.clone());
    let Some(outside) = accuracy.outside.as_ref().filter(|_| of_all.grade != Grade::Good) else { return of_all };
    let (others, advice) = with_exits(others, outside);
    let in_domain = format!("{runs} in the domain");
    let mut of_inside = judge_rows(study, surrogate, (&outside.inside, &in_domain), comparison, others);
    if better(&of_inside, &of_all) || of_inside.grade == Grade::Rejected {
        if of_inside.grade != Grade::Good {
            of_inside.advice.insert(0, advice);
        }
        return of_inside;
    }
    of_all
}

/// Share of the rows in the domain below which they are too few for a verdict other than a rejection, and below which they are too few for a
/// good one.
const FEW_INSIDE: [f64; 2] = [0.1, 0.5];

/// The findings with that on motions that leave the domain, and advice.
fn with_exits(mut others: Findings, outside: &OutsideRows) -> (Findings, String) {
    let share = outside.share_inside();
    let reason = |after: &str| Reason::new(AcceptanceCheck::Domain, "", format!("{}{after}", outside.describe()));
    let [rejected, limited] = FEW_INSIDE;
    if share < rejected {
        others.problems.push(reason(": too few are left to be judged"));
    } else if share < limited {
        others.limits.push(reason(": only the others were judged"));
    } else {
        others.notes.push(reason(": only the others were judged"));
    }
    let variables: IndexSet<&str> = outside.exits.iter().map(|exit| exit.variable.as_str()).collect();
    let names = variables.into_iter().collect::<Vec<&str>>().join(", ");
    let has_dead_point = outside.exits.iter().any(|exit| exit.dead_point.is_some());
    let other = if has_dead_point {
        "a coordinate without a dead point, such as the angle of the crank, or "
    } else {
        "a wider range of "
    };
    let what = if has_dead_point { format!("starts and inputs that keep {names} in its range") } else { names };
    (others, format!("{other}{what}"))
}

/// Returns true if the first of two verdicts has the better grade.
fn better(first: &Verdict, second: &Verdict) -> bool {
    let rank = |verdict: &Verdict| match verdict.grade {
        Grade::Good => 0,
        Grade::Usable => 1,
        Grade::Rejected => 2,
    };
    rank(first) < rank(second)
}

/// Verdict by the figures of an accuracy.
fn judge_rows(
    study: &Study,
    surrogate: &Surrogate,
    (accuracy, runs): (&Accuracy, &str),
    comparison: Option<&Comparison>,
    others: Findings,
) -> Verdict {
    let baselines: Vec<&ModelRow> = comparison.map_or(Vec::new(), |comparison| of_build(study, comparison));
    let outputs = surrogate.outputs().iter().filter_map(|output| Some((output, accuracy.outputs.get(&output.name)?)));
    // nobody predicts a chaotic motion to its end: what counts is a sixth of the runs' length, or the runs that are not chaotic
    let of_regular = format!("{runs} that are not chaotic");
    let is_chaotic = accuracy.roll_outs.as_ref().is_some_and(|roll_outs| roll_outs.is_chaotic(accuracy.test_runs));
    let mut judged = Judged { options: study.accept, runs, problems: others.problems, limits: others.limits };
    if let Some(roll_outs) = &accuracy.roll_outs {
        judged.diverged(roll_outs, accuracy.test_runs);
        judged.strayed(roll_outs, is_chaotic);
    }
    let mut better = None;
    for (output, metrics) in outputs {
        if !is_chaotic {
            let regular = accuracy.regular_outputs.get(&output.name);
            judged.runs = if regular.is_some() { &of_regular } else { runs };
            judged.unexplained(output, regular.unwrap_or(metrics));
            judged.turned(output, regular.unwrap_or(metrics));
            judged.constant(output, regular.unwrap_or(metrics));
            judged.runs = runs;
        }
        judged.missed(study, output, metrics);
        better = better.or(judged.beaten(output, metrics, &baselines));
        judged.far_off(output, metrics);
    }
    let instead = better.map(|model| format!("the simpler model: `metafmu export STUDY --model {model}`"));
    let Judged { problems, limits, .. } = judged;
    let is_of_learning = problems.iter().chain(&limits).any(Reason::is_of_learning);
    let of_learning = others.advice.into_iter().filter(|_| is_of_learning);
    let advice = instead.into_iter().chain(of_learning).collect();
    Verdict::of(Findings { problems, limits, notes: others.notes, advice })
}

fn of_build<'a>(study: &Study, comparison: &'a Comparison) -> Vec<&'a ModelRow> {
    let in_build = |row: &&ModelRow| study.baselines.build.iter().any(|kind| kind.name() == row.model);
    let measured = |row: &&ModelRow| row.model != NETWORK && row.status == ModelStatus::Fine;
    comparison.models.iter().filter(measured).filter(in_build).collect()
}

/// Findings so far.
struct Judged<'a> {
    options: AcceptOptions,
    runs: &'a str,
    problems: Vec<Reason>,
    limits: Vec<Reason>,
}

impl Judged<'_> {
    /// Adds a problem of an output's accuracy.
    fn reject(&mut self, output: &str, cause: String) {
        self.problems.push(Reason::new(AcceptanceCheck::Accuracy, output, cause));
    }

    /// Notes an R² that is below a limit; `what` follows the number. `output` is empty if it is that of all outputs.
    fn grade(&mut self, output: &str, r2: f64, what: &str, after: &str) {
        let AcceptOptions { r2: least, good, .. } = self.options;
        let line = |limit: f64, key: &str| {
            let found = told_apart(r2, limit);
            let cause = format!("R² {found} {what}, expected at least {limit} ({key}){after}");
            Reason::new(AcceptanceCheck::Accuracy, output, cause)
        };
        if r2 < least {
            self.problems.push(line(least, "accept.r2"));
        } else if r2 < good {
            self.limits.push(line(good, "accept.good"));
        }
    }

    /// A surrogate that diverges in a test run is wrong there, whatever the other runs are like.
    fn diverged(&mut self, roll_outs: &RollOuts, test_runs: usize) {
        if let Some(diverging) = roll_outs.describe_divergence(test_runs) {
            let cause = "the predictions are not finite, or far outside the truth and the outputs' ranges in training";
            self.reject("", format!("{diverging}: {cause}"));
        }
    }

    /// The relative error `e` of the median run is an R² of `1 - e²`. The beginning of a run may be slower than the rest, or little more than
    /// noise: its error counts relative to the whole run, unless the motion is chaotic and nothing else of it counts.
    fn strayed(&mut self, roll_outs: &RollOuts, is_chaotic: bool) {
        let Some(Horizon { seconds, median, of_run, .. }) = roll_outs.horizons.first() else { return };
        let error = if is_chaotic { median } else { of_run };
        let r2 = (1.0 - error * error).max(f64::MIN);
        let chaos = if is_chaotic { ": the motion is chaotic, a shorter `time.stop` can be judged" } else { "" };
        self.grade("", r2, &format!("in the median of the {} up to {} s", self.runs, number(*seconds)), chaos);
    }

    fn unexplained(&mut self, output: &Output, metrics: &OutputMetrics) {
        let Some(r2) = metrics.r2 else { return };
        let mean = if r2 < 0.0 { ": its mean would be better" } else { "" };
        self.grade(&output.name, r2, &format!("on the {}", self.runs), mean);
    }

    /// The variance of an angle that winds up grows with its turns: it is judged as one that is spread over a turn as well.
    fn turned(&mut self, output: &Output, metrics: &OutputMetrics) {
        let radians = match output.unit.as_str() {
            "rad" => 1.0,
            "deg" => PI / 180.0,
            _ => return,
        };
        if radians * (output.max - output.min) <= TAU {
            return;
        }
        let [rms, largest] = [metrics.rms(), metrics.max_abs_error].map(|error| (radians * error).min(f64::MAX));
        let limit = self.options.angle_error;
        if largest > limit {
            let (found, turns) = (told_apart(largest, limit), number(largest / TAU));
            let cause = format!(
                "largest error {found} rad on the {}, {turns} turns, expected at most {} rad (accept.angle_error)",
                self.runs,
                number(limit)
            );
            self.reject(&output.name, cause);
        }
        let r2 = (1.0 - rms * rms / TURN_VARIANCE).max(f64::MIN);
        let what =
            format!("of its position in a turn (root mean square error {} rad) on the {}", number(rms), self.runs);
        self.grade(&output.name, r2, &what, "");
    }

    /// An output without an R² is where it should be: a constant exactly, another one as far as `accept.r2` allows.
    fn constant(&mut self, output: &Output, metrics: &OutputMetrics) {
        if metrics.r2.is_some() {
            return;
        }
        let Output { name, min, max, .. } = output;
        let deviation = 0.5 * (max - min);
        let limit = (deviation * (1.0 - self.options.r2).sqrt()).max(1e-9 * min.abs().max(max.abs()));
        let rms = metrics.rms();
        if rms > limit {
            let runs = self.runs;
            let (found, limit) = (number(rms), number(limit));
            let expected = format!("root mean square error {found}, expected at most {limit} (accept.r2)");
            self.reject(name, format!("constant in the {runs}, {expected}"));
        }
    }

    /// A target was met on few runs: the unexplained part on others may be half larger, but not more.
    fn missed(&mut self, study: &Study, output: &Output, metrics: &OutputMetrics) {
        let Some((target, r2)) = study.target.zip(metrics.r2) else { return };
        if 1.0 - r2 > 2.0 * (1.0 - target.r2) {
            let found = format!("R² {} on the {}", told_apart(r2, target.r2), self.runs);
            let expected = format!("more than twice as far from 1 as the target, {} (target.r2)", target.r2);
            self.reject(&output.name, format!("{found}, {expected}"));
        }
    }

    /// The name of a better baseline.
    fn beaten(&mut self, output: &Output, metrics: &OutputMetrics, baselines: &[&ModelRow]) -> Option<String> {
        let r2 = metrics.r2.filter(|&r2| r2 < AcceptOptions::EXCELLENT)?;
        let measured = baselines.iter().filter_map(|row| Some((row, row.outputs.get(&output.name)?)));
        let (best, accuracy) = measured.min_by(|a, b| a.1.mse.total_cmp(&b.1.mse))?;
        let (factor, limit) = ((metrics.mse / accuracy.mse).sqrt(), self.options.baseline_factor);
        if factor <= limit * (1.0 + TIE) {
            return None;
        }
        let (found, model) = (told_apart(factor, limit), &best.model);
        let theirs = accuracy.r2.map_or("-".into(), |theirs| told_apart(theirs, r2));
        let r2 = accuracy.r2.map_or_else(|| told_apart(r2, 1.0), |theirs| told_apart(r2, theirs));
        let cause = format!(
            "root mean square error {found} times that of the baseline {model} (R² {r2} against {theirs}), expected at most \
             {limit} times (accept.baseline_factor)"
        );
        self.problems.push(Reason::new(AcceptanceCheck::Baselines, &output.name, cause));
        Some(model.clone())
    }

    fn far_off(&mut self, output: &Output, metrics: &OutputMetrics) {
        let Some((limit, share)) = self.options.largest_error.zip(metrics.relative_max_error) else { return };
        if share > limit {
            let share = told_apart(share, limit);
            let expected = format!("expected at most {limit} (accept.largest_error)");
            self.reject(&output.name, format!("largest error {share} of its range in training, {expected}"));
        }
    }
}

/// A number with three decimals, or as many as distinguish it from another one.
fn told_apart(value: f64, other: f64) -> String {
    if value.abs() >= 1e4 {
        return power(value, 2);
    }
    let fixed = |decimals: usize| (format!("{value:.decimals$}"), format!("{other:.decimals$}"));
    let found = (3..=17).map(fixed).find(|(value, other)| value != other);
    found.map_or_else(|| value.to_string(), |(value, _)| value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluation::{DomainExit, comparison::ModelAccuracy};
    use metafmu_example as example;
    use std::path::Path;

    const STUDY: &str = include_str!("../../examples/single-pendulum.toml");

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
            within_two_std: None,
            noise: None,
        }
    }

    fn baseline(model: &str, status: ModelStatus, mse: f64) -> ModelRow {
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

    fn accuracy(angle: OutputMetrics, velocity: OutputMetrics) -> Accuracy {
        Accuracy {
            outputs: [("angle".to_owned(), angle), ("velocity".to_owned(), velocity)].into(),
            regular_outputs: [].into(),
            test_runs: 20,
            test_rows: 100,
            given_rows: 0,
            content_digest: String::new(),
            roll_outs: None,
            rows: None,
            seen_until: None,
            calibration: Vec::new(),
            outside: None,
            source_equations: None,
            verdict: None,
        }
    }

    fn study(accept: &str) -> Study {
        Study::parse(&format!("{STUDY}\n[accept]\n{accept}\n"), Path::new("s.toml")).unwrap()
    }

    /// Verdict on the example whose outputs have these figures, beside a decision tree with an R² of 0.95 and better models that are
    /// no part of a build or could not be fitted.
    fn verdict(accept: &str, angle: OutputMetrics, velocity: OutputMetrics) -> Verdict {
        let models = vec![
            baseline(NETWORK, ModelStatus::Fine, 0.0),
            baseline("linear", ModelStatus::Fine, 0.5),
            baseline("decision-tree", ModelStatus::Fine, 0.05),
            baseline("polynomial", ModelStatus::Failed, 1e-9),
            baseline("random-forest", ModelStatus::Fine, 1e-9),
        ];
        let comparison = Comparison { name: "s".into(), content_digest: None, test_runs: 20, test_rows: 100, models };
        let measured = (&accuracy(angle, velocity), "test runs");
        judge(&study(accept), &example::surrogate(), measured, Some(&comparison), Findings::default())
    }

    fn problems(accept: &str, angle: OutputMetrics, velocity: OutputMetrics) -> Vec<String> {
        lines(&verdict(accept, angle, velocity).problems)
    }

    fn lines(reasons: &[Reason]) -> Vec<String> {
        reasons.iter().map(Reason::to_string).collect()
    }

    #[test]
    fn surrogates_are_good_usable_or_rejected_by_their_worst_output() {
        let of = |angle: f64, velocity: f64| {
            let Verdict { grade, problems, limits, .. } =
                verdict("", metrics(Some(angle), 1.0 - angle), metrics(Some(velocity), 1.0));
            (grade, lines(&problems), lines(&limits))
        };
        assert_eq!(of(0.992, 0.99), (Grade::Good, Vec::new(), Vec::new()));
        let limit = "velocity: R² 0.989 on the test runs, expected at least 0.99 (accept.good)";
        assert_eq!(of(0.992, 0.989), (Grade::Usable, Vec::new(), vec![limit.to_owned()]));
        let problem = "velocity: R² 0.899 on the test runs, expected at least 0.9 (accept.r2)";
        assert_eq!(of(0.98, 0.899), (Grade::Rejected, vec![problem.to_owned()], Vec::new()));
        // a constant output has no R², and rejects only where it is not the truth
        let constant = verdict("", metrics(Some(0.992), 0.008), metrics(None, 0.0));
        assert_eq!(constant.grade, Grade::Good);
        let wrong = problems("", metrics(Some(0.992), 0.008), metrics(None, 1e6));
        assert!(
            wrong.len() == 1 && wrong[0].starts_with("velocity: constant in the test runs, root mean"),
            "{wrong:?}"
        );
    }

    #[test]
    fn an_output_worse_than_its_mean_or_than_the_best_baseline_of_the_build_is_rejected() {
        let found = verdict("", metrics(Some(-388.2), 389.2), metrics(Some(0.995), 1.0));
        assert_eq!(
            lines(&found.problems),
            [
                "angle: R² -388.200 on the test runs, expected at least 0.9 (accept.r2): its mean would be better",
                "angle: root mean square error 88.227 times that of the baseline decision-tree (R² -388.200 against 0.950), \
                 expected at most 1 times (accept.baseline_factor)",
            ]
        );
        assert_eq!(found.advice, ["the simpler model: `metafmu export STUDY --model decision-tree`"]);
        let found = problems("", metrics(Some(0.94), 0.06), metrics(Some(0.995), 1.0));
        assert!(found.len() == 1 && found[0].contains("1.095 times that of the baseline decision-tree"), "{found:?}");
        // nobody could wish for more
        assert_eq!(problems("", metrics(Some(0.99995), 0.06), metrics(None, 0.0)), Vec::<String>::new());
    }

    #[test]
    fn a_rejection_has_as_many_digits_as_show_why() {
        let of = |accept: &str, r2: f64| {
            problems(&format!("baseline_factor = inf\n{accept}"), metrics(Some(r2), 0.0), metrics(Some(1.0), 0.0))
        };
        let found = of("r2 = 0.99999999", 1.0 - 1.3e-8);
        assert_eq!(found, ["angle: R² 0.999999987 on the test runs, expected at least 0.99999999 (accept.r2)"]);
        let found = of("", f64::MIN);
        assert!(found[0].starts_with("angle: R² not finite on the test runs"), "{found:?}");
        assert!(of("", 0.8999999)[0].starts_with("angle: R² 0.8999999 on the test runs"));
    }

    #[test]
    fn an_angle_that_winds_up_is_judged_by_its_error_in_radians() {
        let mut metadata = example::surrogate().metadata().clone();
        (metadata.outputs[0].min, metadata.outputs[0].max) = (0.0, 4000.0);
        let surrogate = Surrogate::new(metadata, example::surrogate().program().clone()).unwrap();
        let of = |rms: f64, largest: f64, accept: &str| {
            let angle = OutputMetrics { max_abs_error: largest, ..metrics(Some(0.999985), rms * rms) };
            let measured = accuracy(angle, metrics(Some(1.0), 0.0));
            judge(&study(accept), &surrogate, (&measured, "test runs"), None, Findings::default())
        };
        let lost = of(0.1, 4.4, "");
        let expected = "angle: largest error 4.400 rad on the test runs, 0.7003 turns, expected at most 3.142 rad \
                        (accept.angle_error)";
        assert_eq!(lines(&lost.problems), [expected]);
        // as spread as an angle can be within a turn, its R² would be 0.7
        assert!(
            lines(&of(1.0, 2.0, "").problems)[0]
                .starts_with("angle: R² 0.696 of its position in a turn (root mean square")
        );
        assert_eq!(of(0.4, 2.0, "").grade, Grade::Usable);
        assert_eq!((of(0.1, 2.0, "").grade, of(0.1, 4.4, "angle_error = inf").grade), (Grade::Good, Grade::Good));
    }

    #[test]
    fn motions_are_judged_to_their_end_unless_they_are_chaotic() {
        let of = |chaotic_runs: usize, median: f64| {
            let horizon =
                |seconds, median| Horizon { seconds, median, q90: 1.0, of_run: 0.5 * median, sensitivity: [1e-9; 2] };
            let roll_outs = RollOuts {
                horizons: vec![horizon(1.0, median), horizon(6.0, 0.5)],
                chaotic_runs: (0..chaotic_runs).collect(),
                diverged_runs: Vec::new(),
                divergence_time: None,
                energy_drift: None,
                constraint_residual: None,
                long_runs: [2, 2],
            };
            let metrics = || metrics(Some(0.72), 0.28);
            let measured = Accuracy { roll_outs: Some(roll_outs), ..accuracy(metrics(), metrics()) };
            let others = Findings::default();
            lines(&judge(&study(""), &example::surrogate(), (&measured, "test runs"), None, others).problems)
        };
        let found = of(9, 0.01);
        assert!(found.len() == 2 && found[1].starts_with("velocity: R² 0.720 on the test runs"), "{found:?}");
        assert_eq!(of(10, 0.01), Vec::<String>::new());
        let found = of(20, 0.5);
        let expected = "R² 0.750 in the median of the test runs up to 1 s, expected at least 0.9 (accept.r2): the motion is chaotic";
        assert!(found.len() == 1 && found[0].starts_with(expected), "{found:?}");
        // the beginning of a motion that is not chaotic counts relative to whole runs
        let found = of(0, 0.5);
        assert!(found.len() == 2 && found[0].starts_with("angle"), "{found:?}");
        let found = of(0, 1.5);
        assert!(
            found.len() == 3 && found[0].starts_with("R² 0.438 in the median of the test runs up to 1 s"),
            "{found:?}"
        );
    }

    #[test]
    fn a_surrogate_that_diverges_in_a_run_is_rejected() {
        let roll_outs = RollOuts {
            horizons: Vec::new(),
            chaotic_runs: (0..19).collect(),
            diverged_runs: vec![19],
            divergence_time: None,
            energy_drift: None,
            constraint_residual: None,
            long_runs: [2, 2],
        };
        let exact = || metrics(Some(1.0), 0.0);
        let measured = Accuracy { roll_outs: Some(roll_outs), ..accuracy(exact(), exact()) };
        let verdict = judge(&study(""), &example::surrogate(), (&measured, "test runs"), None, Findings::default());
        let expected = "1 of 20 test runs is diverging: run 19: the predictions are not finite, or far outside the truth \
                        and the outputs' ranges in training";
        assert_eq!((verdict.grade, lines(&verdict.problems)), (Grade::Rejected, vec![expected.to_owned()]));
    }

    #[test]
    fn a_few_chaotic_runs_do_not_reject_an_angle_that_is_right_in_the_others() {
        let mut metadata = example::surrogate().metadata().clone();
        (metadata.outputs[0].min, metadata.outputs[0].max) = (0.0, 40.0);
        let surrogate = Surrogate::new(metadata, example::surrogate().program().clone()).unwrap();
        let angle = |largest| OutputMetrics { max_abs_error: largest, ..metrics(Some(0.9), 2.0) };
        let of = |regular: Option<OutputMetrics>| {
            let regular = regular.map(|regular| ("angle".to_owned(), regular));
            let measured = accuracy(angle(17.0), metrics(Some(1.0), 0.0));
            let measured = Accuracy { regular_outputs: regular.into_iter().collect(), ..measured };
            judge(&study("baseline_factor = inf"), &surrogate, (&measured, "test runs"), None, Findings::default())
        };
        assert!(
            lines(&of(None).problems)[0].starts_with("angle: largest error 17.000 rad on the test runs, 2.706 turns")
        );
        let exact = OutputMetrics { max_abs_error: 1e-3, ..metrics(Some(1.0), 1e-8) };
        assert_eq!(of(Some(exact)).grade, Grade::Good);
        let problems = lines(&of(Some(angle(4.4))).problems);
        assert!(problems[0].starts_with("angle: largest error 4.400 rad on the test runs that are not chaotic"));
    }

    #[test]
    fn a_target_that_was_met_on_held_out_runs_only_is_missed() {
        let of = |r2: f64| {
            let target = "baseline_factor = inf\n[target]\nr2 = 0.99\nruns = 10\nmax_runs = 2000";
            problems(target, metrics(Some(r2), 1.0 - r2), metrics(Some(0.995), 0.005))
        };
        assert_eq!(of(0.981), Vec::<String>::new());
        let expected =
            "angle: R² 0.970 on the test runs, more than twice as far from 1 as the target, 0.99 (target.r2)";
        assert_eq!(of(0.97), [expected]);
    }

    #[test]
    fn rows_outside_the_domain_do_not_count_unless_few_are_inside() {
        // 100 rows inside
        let exact = || Box::new(accuracy(metrics(Some(1.0), 0.0), metrics(Some(1.0), 0.0)));
        let exit = DomainExit {
            run: 3,
            time: 1.25,
            variable: "rail.position".into(),
            unit: "m".into(),
            value: 0.31,
            range: [0.0, 0.3],
            states: [].into(),
            parameters: Vec::new(),
            dead_point: Some(0.35),
        };
        let of = |rows: usize, r2: f64| {
            let outside = OutsideRows { rows, exits: vec![exit.clone()], inside: exact() };
            let measured =
                Accuracy { outside: Some(outside), ..accuracy(metrics(Some(r2), 2.0), metrics(Some(1.0), 0.0)) };
            judge(
                &study("baseline_factor = inf"),
                &example::surrogate(),
                (&measured, "test runs"),
                None,
                Findings::default(),
            )
        };
        let good = of(100, -1.0);
        assert_eq!((good.grade, good.notes[0].check), (Grade::Good, AcceptanceCheck::Domain));
        let expected = "1 of 20 test runs leaves the domain, 100 of 200 rows are outside: run 3 at t = 1.25 s by rail.position = \
                        0.31 m, range 0 to 0.3 m; the mechanism has a dead point at 0.35 m, where this coordinate stops to determine it: \
                        only the others were judged";
        assert_eq!(good.notes[0].cause, expected);
        let usable = of(101, -1.0);
        assert_eq!((usable.grade, usable.limits[0].check), (Grade::Usable, AcceptanceCheck::Domain));
        assert!(usable.advice[0].starts_with("a coordinate without a dead point"), "{:?}", usable.advice);
        let rejected = of(901, -1.0);
        assert_eq!((rejected.grade, rejected.problems[0].check), (Grade::Rejected, AcceptanceCheck::Domain));
        // what is good everywhere needs no exception
        assert_eq!(of(901, 0.999), Verdict::of(Findings::default()));
    }

    #[test]
    fn limits_are_those_of_the_study() {
        let of = |accept: &str| problems(accept, metrics(Some(0.69), 0.31), metrics(Some(0.995), 0.2));
        assert_eq!(of("r2 = 0.6\nbaseline_factor = 2.5"), Vec::<String>::new());
        assert_eq!(of("baseline_factor = inf\nr2 = -inf"), Vec::<String>::new());
        let found = of("baseline_factor = inf\nr2 = 0.75");
        assert_eq!(found, ["angle: R² 0.690 on the test runs, expected at least 0.75 (accept.r2)"]);
        let found = of("baseline_factor = inf\nr2 = 0\nlargest_error = 1e-3");
        let expected =
            "angle: largest error 0.020 of its range in training, expected at most 0.001 (accept.largest_error)";
        assert_eq!((found.len(), found[0].as_str()), (2, expected));
    }
}
