//! Compares the surrogate with the unseen test runs.

use super::{cost::Cost, speed};
use crate::{
    Result, calibration,
    dataset::Dataset,
    diagnostics::numbers::{self, counted, is_proper, number, percent, power},
    dynamics::{Assembly, Region},
    evaluation::{
        AcceptanceCheck, Accuracy, DomainExit, Horizon, KindCoverage, OutputMetrics, Reason, RollOuts, SourceEquations,
        TestRows, Verdict, comparison::Comparison, constraint_residual,
    },
    files,
    kinds::{self, record::TrainingRecord, unseen::UnseenData},
    project::{Project, SamplesRecord},
    source::{OwnRuns, Source, driven::Driven, integrate_own_equations},
};
use indexmap::IndexMap;
use metafmu_runtime::{Output, Surrogate};
use serde::Serialize;
use std::fmt::Write;

/// Content of `metrics.json`.
#[derive(Debug, Serialize)]
pub struct Metrics {
    name: String,
    /// Accuracy on the test runs, with the verdict.
    #[serde(flatten)]
    pub accuracy: Accuracy,
    /// Outputs that did not vary in training, and the constants that the surrogate has for them.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    constants: IndexMap<String, f64>,
    /// Cost of a step, and speed beside that of the source.
    #[serde(flatten)]
    cost: Cost,
    train_runs: usize,
    sample_seconds: f64,
    /// Record of the training.
    #[serde(flatten)]
    pub training: TrainingRecord,
    seed: u64,
    study_digest: String,
    tool: String,
}

/// Measures the project's surrogate on its test runs.
///
/// # Errors
/// [`Error::Stale`](crate::Error::Stale) if one of them is missing or of another study, [`Error::Io`](crate::Error::Io).
pub fn evaluate(project: &Project) -> Result<(Metrics, Verdict)> {
    let (surrogate, training) = (project.load_model()?, project.load_training_record()?);
    let kind = kinds::of(&project.study);
    let (unseen, calibration) = (kind.load_unseen(project, &training)?, kind.load_calibration(project)?);
    project.prepare_folder()?;
    let mut accuracy = unseen.test.evaluated(&surrogate).accuracy;
    let comparison = project.load_comparison(&accuracy)?;
    complete(project, &surrogate, &training, (&unseen, calibration.as_ref()), &mut accuracy)?;
    let cost = measure_cost(project, &surrogate, &unseen.test.runs)?;
    let validation = project.load_validation(&surrogate);
    let judged = JudgedAccuracy::new(project, &surrogate, accuracy, comparison.as_ref(), &training, validation);
    stage(project, &surrogate, (judged, cost), &unseen.record, &training)
}

/// Completes the accuracy by what is measured with the source.
pub(super) fn complete(
    project: &Project,
    surrogate: &Surrogate,
    training: &TrainingRecord,
    (unseen, calibration): (&UnseenData, Option<&Dataset>),
    accuracy: &mut Accuracy,
) -> Result<()> {
    let test = &unseen.test.runs;
    add_residual(project, surrogate, test, accuracy)?;
    if let Some(calibration) = calibration {
        add_calibration(project, surrogate, calibration, accuracy);
    }
    add_dead_points(project, accuracy)?;
    add_source_equations(project, surrogate, test, training, accuracy)
}

/// Accuracy on the test runs, with the verdict.
pub(super) struct JudgedAccuracy {
    /// The accuracy, which contains the verdict.
    pub(super) accuracy: Accuracy,
    /// The verdict.
    pub(super) verdict: Verdict,
}

impl JudgedAccuracy {
    /// Judges a surrogate by its accuracy on the test runs. `validation`: problems of its FMUs.
    pub(super) fn new(
        project: &Project,
        surrogate: &Surrogate,
        accuracy: Accuracy,
        comparison: Option<&Comparison>,
        training: &TrainingRecord,
        validation: Vec<Reason>,
    ) -> Self {
        let verdict = project.judge(surrogate, training, &accuracy, comparison, validation);
        let seen_until = project.study.sampling.train_stop;
        Self { accuracy: Accuracy { verdict: Some(verdict.clone()), seen_until, ..accuracy }, verdict }
    }
}

/// Adds the residual of the mechanism's constraints in roll-outs.
pub(super) fn add_residual(
    project: &Project,
    surrogate: &Surrogate,
    test: &Dataset,
    accuracy: &mut Accuracy,
) -> Result<()> {
    let Some(roll_outs) = &mut accuracy.roll_outs else { return Ok(()) };
    let region = project.source.driven().and_then(Driven::region);
    if let (Some(mechanism), Some(region)) = (project.study.mechanism(), region) {
        let assembly = Assembly::new(mechanism, region).map_err(|message| project.study.refusal("source", message))?;
        roll_outs.constraint_residual = constraint_residual(surrogate, &assembly, test);
    }
    Ok(())
}

/// Steps in which a dead point is searched beyond the range of a coordinate, over one width of the range, and bisections of its step.
const DEAD_POINT_STEPS: [usize; 2] = [64, 30];

/// Adds the dead points of the mechanism at which motions leave the domain.
fn add_dead_points(project: &Project, accuracy: &mut Accuracy) -> Result<()> {
    let (Some(outside), Some(mechanism)) = (&mut accuracy.outside, project.study.mechanism()) else { return Ok(()) };
    let Some(region) = project.source.driven().and_then(Driven::region) else { return Ok(()) };
    let assembly = Assembly::new(mechanism, region).map_err(|message| project.study.refusal("source", message))?;
    for exit in &mut outside.exits {
        exit.dead_point = dead_point(&assembly, region, exit);
    }
    Ok(())
}

/// Value of the coordinate that has left its range at which the mechanism cannot be assembled any more, from the exit on outward.
fn dead_point(assembly: &Assembly, region: &Region, exit: &DomainExit) -> Option<f64> {
    let coordinate = region.coordinates.iter().position(|range| range.name == exit.variable)?;
    let assembled = assembly.with(exit.parameters.get(..region.parameters.len())?).ok()?;
    let mut place: Vec<f64> = exit.states.values().copied().take(region.coordinates.len()).collect();
    let [min, max] = exit.range;
    let outward = if exit.value > max { max - min } else { min - max };
    let mut is_possible = |value: f64| {
        place[coordinate] = value;
        assembled.positions(&place).is_ok()
    };
    let [steps, bisections] = DEAD_POINT_STEPS;
    let end = if exit.value > max { max } else { min };
    let at = |step: usize| end + outward * step as f64 / steps as f64;
    // the configuration is followed from the end of the range on
    if !is_possible(end) {
        return None;
    }
    let first = (1..=steps).find(|step| !is_possible(at(*step)))?;
    let (mut inside, mut beyond) = (at(first - 1), at(first));
    for _ in 0..bisections {
        let middle = 0.5 * (inside + beyond);
        if is_possible(middle) { inside = middle } else { beyond = middle }
    }
    Some(inside)
}

/// Adds the accuracy relative to the source's own equations, where that to its runs is not good and the source gives equations.
fn add_source_equations(
    project: &Project,
    surrogate: &Surrogate,
    test: &Dataset,
    training: &TrainingRecord,
    accuracy: &mut Accuracy,
) -> Result<()> {
    if !kinds::of(&project.study).has_equations() {
        return Ok(());
    }
    let Source::Simulation(simulation) = &project.source else { return Ok(()) };
    let Some(model) = simulation.worker_model() else { return Ok(()) };
    let verdict = project.judge(surrogate, training, accuracy, None, Vec::new());
    if !verdict.reasons().iter().any(|reason| reason.check == AcceptanceCheck::Accuracy) {
        return Ok(());
    }
    project.note(
        "integrating the source's own equations along the test runs: its runs may have the errors of its time step",
    );
    match integrate_own_equations(model, &test.runs, project.workers())? {
        OwnRuns::Integrated(exact) => accuracy.source_equations = Some(SourceEquations::new(surrogate, test, exact)),
        OwnRuns::Unable(reason) => project.note(format_args!(
            "the source's own equations cannot show whether its time step is too long: {reason}; compare a build with half the step"
        )),
    }
    Ok(())
}

/// Adds how error bounds hold for each kind of signal.
fn add_calibration(project: &Project, surrogate: &Surrogate, calibration: &Dataset, accuracy: &mut Accuracy) {
    // runs of a table are driven by whatever they are driven by
    if !project.study.source.is_recorded() {
        accuracy.calibration = calibration::coverage(surrogate, calibration);
    }
}

/// Measures the cost of a step and the speed beside the source's, and warns if that is faster.
pub(super) fn measure_cost(project: &Project, surrogate: &Surrogate, test: &Dataset) -> Result<Cost> {
    let cost = speed::cost(project, surrogate, test)?;
    if let Some(warning) = cost.speed.and_then(|speed| speed.warning(surrogate)) {
        project.warn(warning);
    }
    Ok(cost)
}

/// Writes `metrics.json`.
pub(super) fn stage(
    project: &Project,
    surrogate: &Surrogate,
    (judged, cost): (JudgedAccuracy, Cost),
    samples: &SamplesRecord,
    training: &TrainingRecord,
) -> Result<(Metrics, Verdict)> {
    let provenance = &surrogate.metadata().provenance;
    let JudgedAccuracy { accuracy, verdict } = judged;
    let metrics = Metrics {
        name: project.study.name.clone(),
        accuracy,
        cost,
        constants: constants(surrogate).map(|(output, constant)| (output.name.clone(), constant)).collect(),
        train_runs: samples.train_runs + training.added_runs,
        sample_seconds: samples.sample_seconds,
        training: training.clone(),
        seed: provenance.seed,
        study_digest: provenance.study_digest.clone(),
        tool: provenance.tool.clone(),
    };
    files::write_json(&project.metrics(), &metrics)?;
    Ok((metrics, verdict))
}

/// Outputs that did not vary in training, with their values.
pub(super) fn constants(surrogate: &Surrogate) -> impl Iterator<Item = (&Output, f64)> {
    surrogate.outputs().iter().filter_map(|output| Some((output, output.constant()?)))
}

/// The results as a table for people: errors in the outputs' units.
pub fn table(project: &Project, metrics: &Metrics) -> String {
    let Accuracy { outputs, test_runs, test_rows, given_rows, seen_until, .. } = &metrics.accuracy;
    let runs = match seen_until {
        None => counted(*test_runs, "unseen run"),
        Some(stop) => format!("{}, unseen after {stop} s", counted(*test_runs, "run")),
    };
    let on = match (metrics.accuracy.rows, given_rows) {
        (Some(TestRows::CrossValidated), _) => {
            format!(
                "{test_rows} rows, each predicted by a model that was fitted without it, of the kind that the other rows choose"
            )
        }
        (Some(TestRows::OfRuns), _) => format!("{test_rows} rows of unseen runs"),
        (Some(_), _) => format!("{test_rows} unseen rows"),
        (None, 0) => format!("{runs}, {}", counted(*test_rows, "row")),
        (None, given) => format!("{runs}, {}, and {given} given", counted(*test_rows, "predicted row")),
    };
    let mut text = format!("{} on {on}\n\n", metrics.name);
    let coverage = project.study.bounds.map(|bounds| 100.0 * bounds.coverage);
    let bounds = coverage.map_or(String::new(), |percent| format!("  {:>11}", format!("{percent} % bound")));
    let header =
        format!("{:<12} {:<8} {:>11} {:>12}{bounds}  largest error, of the range", "output", "unit", "R²", "MSE");
    let _ = writeln!(text, "{header}");
    let named = |name: &String| project.source.outputs().iter().find(|variable| variable.name == *name);
    let variables = || outputs.iter().filter_map(|(name, of_output)| Some((name, of_output, named(name)?)));
    for (name, of_output, variable) in variables() {
        let OutputMetrics { r2, mse, max_abs_error, relative_max_error, worst_run, worst_time, bound, .. } = of_output;
        let r2 = r2.map_or("constant".into(), numbers::r2);
        let unit = if variable.unit.is_empty() { "-" } else { &variable.unit };
        let share = relative_max_error.map_or(String::new(), |share| format!(", {}", percent(share)));
        let place = match metrics.accuracy.rows {
            Some(TestRows::OfRuns) => format!("row {} of the test table", worst_run + 1),
            Some(_) => format!("row {} of unseen.csv", worst_run + 1),
            None => format!("test run {worst_run}, t = {worst_time:.3} s"),
        };
        let worst = format!("{}{share} ({place})", power(*max_abs_error, 3));
        let bound = bound.map_or(String::new(), |bound| format!("  {:>11}", power(bound, 3)));
        let _ = writeln!(text, "{name:<12} {unit:<8} {r2:>11} {:>12}{bound}  {worst}", power(*mse, 3));
    }
    let noise = variables().filter_map(|(name, of_output, variable)| {
        Some(of_output.noise?.describe(name, &variable.unit, of_output.bound.is_some()))
    });
    noise.for_each(|line| _ = writeln!(text, "{line}"));
    if let Some(roll_outs) = &metrics.accuracy.roll_outs {
        let _ = write!(text, "\n{}", roll_out_table(roll_outs));
        if let Some(chaos) = roll_outs.describe_chaos(*test_runs) {
            let _ = writeln!(text, "{chaos}");
        }
    }
    if let Some(outside) = &metrics.accuracy.outside {
        let _ = writeln!(text, "{}", outside.describe());
        text += &accuracy_inside(&outside.inside);
    }
    if outputs.values().any(|metrics| metrics.within_bound.is_some()) {
        let shares = outputs.values().filter_map(|metrics| metrics.within_bound);
        let shares: Vec<String> = shares.map(|share| format!("{:.1}", 100.0 * share)).collect();
        let _ = writeln!(text, "\nwithin the bound, % of these rows: {}", shares.join(", "));
    }
    if outputs.values().any(|metrics| metrics.within_two_std.is_some()) {
        let shares = outputs.values().filter_map(|metrics| metrics.within_two_std);
        let shares: Vec<String> = shares.map(|share| format!("{:.1}", 100.0 * share)).collect();
        let _ = writeln!(text, "\nwithin two predicted standard deviations, % of these rows: {}", shares.join(", "));
    }
    for KindCoverage { kind, runs, within } in &metrics.accuracy.calibration {
        let shares: Vec<String> = within.values().map(|share| format!("{:.1}", 100.0 * share)).collect();
        let _ = writeln!(text, "  of {}, {kind}: {}", counted(*runs, "calibration run"), shares.join(", "));
    }
    if let Some(speed) = &metrics.cost.speed {
        let _ = writeln!(text, "\n{}\n({})", speed.describe(), speed.conditions());
    }
    text
}

/// A line with the accuracy on the rows before motions leave the domain, by which a surrogate is judged; none without such rows.
fn accuracy_inside(inside: &Accuracy) -> String {
    if inside.test_rows == 0 {
        return String::new();
    }
    let r2_of = |metrics: &OutputMetrics| metrics.r2.map_or("constant".into(), numbers::r2);
    let each: Vec<String> = inside.outputs.iter().map(|(name, metrics)| format!("{name} {}", r2_of(metrics))).collect();
    format!("R² of {} before motions leave it: {}\n", counted(inside.test_rows, "row"), each.join(", "))
}

/// Growth of errors along the roll-outs, for people.
fn roll_out_table(
    RollOuts { horizons, divergence_time, energy_drift, constraint_residual, long_runs: [runs, finite], .. }: &RollOuts,
) -> String {
    let mut text =
        format!("{:<10} {:>15} {:>10}   start perturbed by 1e-9: median, 90 %\n", "roll-out", "relative RMS", "90 %");
    for Horizon { seconds, median, q90, sensitivity: [changed, changed_q90], .. } in horizons {
        let time = format!("{} s", number(*seconds));
        let [median, q90, changed, changed_q90] = [median, q90, changed, changed_q90].map(|value| power(*value, 1));
        let _ = writeln!(text, "{time:<10} {median:>15} {q90:>10}   {changed}, {changed_q90}");
    }
    let diverges = match divergence_time {
        Some(time) => format!("half of the runs are off by 0.1 standard deviations within {} s", number(*time)),
        None => "over half of the runs stay within 0.1 standard deviations of the truth".into(),
    };
    let energy = energy_drift.map_or(String::new(), |drift| match is_proper(drift) {
        true => format!("; without inputs the energy stays within {drift:.1e} of the largest kinetic energy"),
        false => "; without inputs the energy grows beyond all limits, or a run ends".into(),
    });
    let residual = constraint_residual.map_or(String::new(), |residual| match is_proper(residual) {
        true => format!(
            "; at the same coordinates, positions differ from the mechanism's by at most {residual:.1e} of their ranges"
        ),
        false => "; the surrogate reaches coordinates at which the mechanism cannot be assembled".into(),
    });
    let of_runs = counted(*runs, "run");
    let _ = writeln!(text, "{diverges}{energy}{residual}; {finite} of {of_runs} finite after ten times the length");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_that_are_not_finite_are_told_without_a_number() {
        let horizon = Horizon { seconds: 2.0, median: 1e-3, q90: f64::MAX, of_run: 0.0, sensitivity: [1e-9, f64::MAX] };
        let found = RollOuts {
            horizons: vec![horizon],
            chaotic_runs: Vec::new(),
            diverged_runs: Vec::new(),
            divergence_time: None,
            energy_drift: Some(f64::MAX),
            constraint_residual: Some(f64::MAX),
            long_runs: [1, 0],
        };
        let text = roll_out_table(&found);
        assert!(!text.contains("e308") && text.matches("not finite").count() == 2, "{text}");
        assert!(text.contains("the energy grows beyond all limits, or a run ends; the surrogate reaches"), "{text}");
        assert!(text.contains("0 of 1 run finite after ten times the length"), "{text}");
        let finite = RollOuts { energy_drift: Some(0.01), constraint_residual: Some(2e-3), long_runs: [2, 2], ..found };
        let text = roll_out_table(&finite);
        assert!(
            text.contains("stays within 1.0e-2 of") && text.contains("by at most 2.0e-3 of their ranges"),
            "{text}"
        );
    }
}
