//! Where further runs are placed when a surrogate is not good enough yet.

use crate::{
    dataset::{Dataset, Run},
    evaluation::predict,
    sampling::{self, Plan, Stream},
    study::{Method, Study, TargetOptions},
};
use metafmu_runtime::{Evaluator, Rows, Surrogate};
use rayon::prelude::*;

/// Points among which one is chosen, for each that is wanted.
const CANDIDATES: usize = 30;

/// Parameter values of the next runs of a study, whose runs so far are `dataset`; runs at the points `failed` have failed, and
/// `asked` points were given here before. The same study, surrogate and runs give the same points.
pub fn next_points(
    study: &Study,
    target: &TargetOptions,
    surrogate: &Surrogate,
    dataset: &Dataset,
    failed: &Rows,
    asked: usize,
) -> Rows {
    let count = target.runs.min(target.max_runs.saturating_sub(dataset.runs.len()));
    if !target.adaptive {
        return go_on(study, asked, count);
    }
    // a stretch of the stream of its own for each round
    let candidates = uniform(study, study.faces(), asked * CANDIDATES, count * CANDIDATES);
    let places = |points: &Rows| points.iter().map(|point| unit_cube(point, study)).collect::<Rows>();
    let (mut runs, mut errors) = (Rows::default(), errors(surrogate, dataset));
    runs.extend(dataset.runs.iter().map(|run| unit_cube(&run.parameters, study)));
    // there is nothing to gain where runs fail
    runs.extend(&places(failed));
    errors.resize(runs.len(), 0.0);
    candidates.pick(&choose(&runs, &errors, &places(&candidates), count))
}

/// The points that follow those of the plan, where it can be extended; else random ones.
fn go_on(study: &Study, asked: usize, count: usize) -> Rows {
    match study.sampling.method {
        Some(Method::Random | Method::Sobol | Method::Halton) => {
            let mut longer = study.clone();
            let planned = study.sampling.runs.unwrap_or(0);
            longer.sampling.runs = Some(planned + asked + count);
            let points = Plan::new(&longer).train;
            points.part(planned + asked..points.len())
        }
        _ => uniform(study, 0.0, asked, count),
    }
}

fn uniform(study: &Study, faces: f64, skip: usize, count: usize) -> Rows {
    let parameters: Vec<_> = study.parameters.values().collect();
    let points = sampling::uniform(parameters.len(), sampling::random(study.seed, Stream::Refinement));
    sampling::place(&parameters, faces, points.skip(skip)).take(count).collect()
}

fn unit_cube(point: &[f64], study: &Study) -> Vec<f64> {
    point.iter().zip(study.parameters.values()).map(|(value, parameter)| parameter.share(*value)).collect()
}

/// Error of each run: root mean square over rows and outputs, each output relative to its scale in training.
fn errors(surrogate: &Surrogate, dataset: &Dataset) -> Vec<f64> {
    let evaluator = Evaluator::new(surrogate);
    let widths: Vec<f64> =
        surrogate.outputs().iter().map(|output| (output.max - output.min).max(f64::MIN_POSITIVE)).collect();
    let error = |run: &Run| {
        let predictions = predict(surrogate, &evaluator, run);
        let labels = run.outputs.iter().zip(&predictions).zip(widths.iter().cycle());
        let squares: f64 = labels.map(|((label, prediction), width)| ((label - prediction) / width).powi(2)).sum();
        (squares / run.outputs.len() as f64).sqrt()
    };
    dataset.runs.par_iter().map(error).collect()
}

/// Chooses candidates one after the other, each the one with the largest product of
/// - the error that is expected there: the mean over the nearest runs, as many as parameters and one, weighted by the inverse
///   of the squared distance, and
/// - the distance to the nearest run, chosen candidates included,
///
/// so that runs go where the error is large, without crowding. All places are in the unit cube.
fn choose(runs: &Rows, errors: &[f64], candidates: &Rows, count: usize) -> Vec<usize> {
    let estimate = |candidate: usize| {
        let candidate = &candidates[candidate];
        let mut near: Vec<(f64, f64)> =
            runs.iter().zip(errors).map(|(run, &error)| (squared_distance(run, candidate), error)).collect();
        let neighbors = (candidate.len() + 1).min(near.len());
        if neighbors < near.len() {
            near.select_nth_unstable_by(neighbors, |a, b| a.0.total_cmp(&b.0));
            near.truncate(neighbors);
            // the order that selection leaves is not that of the runs, and sums depend on it
            near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        }
        let weight = |distance: f64| 1.0 / distance.max(1e-12);
        let weights: f64 = near.iter().map(|&(distance, _)| weight(distance)).sum();
        let expected = near.iter().map(|&(distance, error)| weight(distance) * error).sum::<f64>() / weights;
        let nearest = near.iter().map(|&(distance, _)| distance).fold(f64::INFINITY, f64::min);
        (expected, nearest)
    };
    let mut open: Vec<(f64, f64)> = (0..candidates.len()).into_par_iter().map(estimate).collect();
    let mut chosen = Vec::with_capacity(count);
    for _ in 0..count.min(candidates.len()) {
        let score = |&(expected, nearest): &(f64, f64)| expected * nearest.sqrt();
        // the first of equal ones
        let best = (0..open.len()).rev().max_by(|&a, &b| score(&open[a]).total_cmp(&score(&open[b])));
        let Some(best) = best else { break };
        chosen.push(best);
        for (place, candidate) in open.iter_mut().zip(candidates) {
            place.1 = place.1.min(squared_distance(&candidates[best], candidate));
        }
    }
    chosen
}

fn squared_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    fn study(edit: impl Fn(String) -> String) -> Study {
        let text = edit(include_str!("../../examples/single-pendulum.toml").to_owned());
        Study::parse(&text, Path::new("s.toml")).unwrap()
    }

    #[test]
    fn an_extendable_plan_goes_on_where_it_ended_and_others_at_random() {
        let long = Plan::new(&study(|text| text.replacen("runs = 1331", "runs = 50", 1))).train;
        let short = study(|text| text.replacen("runs = 1331", "runs = 20", 1));
        assert_eq!(go_on(&short, 10, 20), long.part(30..50));
        let mesh = study(|text| {
            let text = text.replacen("\"sobol\"", "\"mesh\"", 1).replacen("runs = 1331", "levels = 3", 1);
            text.replacen("faces = ", "# ", 1)
        });
        let (first, second) = (go_on(&mesh, 0, 5), go_on(&mesh, 5, 5));
        assert_eq!((first.len(), second.len()), (5, 5));
        assert!(first.iter().all(|point| !second.contains(point)));
    }

    #[test]
    fn runs_go_where_the_error_is_large_and_keep_apart() {
        let grid: Rows = (0..100).map(|i| [f64::from(i % 10) / 9.0, f64::from(i / 10) / 9.0]).collect();
        // large in one corner
        let errors: Vec<f64> = grid.iter().map(|p| if p[0] > 0.7 && p[1] > 0.7 { 1.0 } else { 1e-3 }).collect();
        let candidates: Rows =
            (0..2000).map(|i| [(f64::from(i) * 0.618_034).fract(), (f64::from(i) * 0.754_878).fract()]).collect();
        let chosen = choose(&grid, &errors, &candidates, 20);
        let places: Vec<&[f64]> = chosen.iter().map(|&index| &candidates[index]).collect();
        let inside = places.iter().filter(|p| p[0] > 0.6 && p[1] > 0.6).count();
        assert!(inside >= 18, "{inside} of 20 in the corner");
        for (index, a) in places.iter().enumerate() {
            assert!(places[..index].iter().all(|b| squared_distance(a, b) > 0.02f64.powi(2)), "{places:?}");
        }
    }

    #[test]
    fn equal_errors_fill_the_gaps() {
        let runs = Rows::from_iter([[0.0], [0.1], [0.2], [1.0]]);
        let candidates: Rows = (0..=100).map(|i| [f64::from(i) / 100.0]).collect();
        assert_eq!(choose(&runs, &[1.0; 4], &candidates, 1), [60]);
    }
}
