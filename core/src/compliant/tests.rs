//! Fits of elements in closed form, and properties that hold whatever the coefficients are.

use super::*;
use crate::sampling::{self, Stream};
use rand::RngExt;
use std::{path::Path, sync::atomic::AtomicBool};

/// A study of an element of two coordinates and a parameter.
fn study(options: &str) -> Study {
    let rates = if options.contains("velocities") { "vx = {}\nvy = {}\n" } else { "" };
    let text = format!(
        "name = 'element'\nstructure = 'compliant'\nsource = {{ system = 'single-pendulum' }}\ntime = {{ stop = 1, step = 1 }}\n\
         [parameters]\np = {{ min = 1, max = 2 }}\nphase = {{ min = 0, max = 1 }}\n\
         [outputs]\nx = {{}}\ny = {{}}\n{rates}fx = {{}}\nfy = {{}}\n\
         [sampling]\nmethod = 'random'\nruns = 2\n\
         [compliant]\npositions = ['x', 'y']\nforces = ['fx', 'fy']\nparameters = ['p']\n{options}\n"
    );
    Study::parse(&text, Path::new("study.toml")).unwrap()
}

const VELOCITIES: &str = "velocities = ['vx', 'vy']";

/// `V = p x² y² + x³ + 5 y²` and `L = [[1 + x, 0], [0.5, 0.2]]`.
fn exact(point: &[f64]) -> Vec<f64> {
    let [p, x, y, vx, vy] = point else { unreachable!("five columns") };
    let (l, m, n) = (1.0 + x, 0.5, 0.2);
    let (first, second) = (l * vx + m * vy, n * vy);
    vec![2.0 * p * x * y * y + 3.0 * x * x + l * first, 2.0 * p * x * x * y + 10.0 * y + m * first + n * second]
}

fn rows(count: usize, seed: u64, law: fn(&[f64]) -> Vec<f64>, velocities: bool) -> ElementRows {
    let mut random = sampling::random(seed, Stream::Validation);
    let mut point = || {
        let mut at = |low: f64, high: f64| random.random_range(low..high);
        vec![at(1.0, 2.0), at(-0.5, 0.5), at(-0.3, 0.3), at(-2.0, 2.0), at(-2.0, 2.0)]
    };
    let points: Rows = (0..count).map(|_| point()).collect();
    let forces = points.iter().map(law).collect();
    let points = if velocities { points } else { points.select(&[0, 1, 2]) };
    ElementRows { parameters: 1, coordinates: 2, has_velocities: velocities, points, forces }
}

fn fitted(options: &str, law: fn(&[f64]) -> Vec<f64>, velocities: bool) -> ElementFit {
    let [seen, unseen] = [(600, 1), (200, 2)].map(|(count, seed)| rows(count, seed, law, velocities));
    fit(&study(options), &seen, &unseen, &AtomicBool::new(false)).unwrap()
}

#[test]
fn products_have_the_derivatives_of_central_differences() {
    let basis = ProductBasis::new(3, 5);
    assert_eq!((basis.products.terms(), basis.count(2)), (56, 10));
    let (at, h) = ([0.3, -0.7, 0.9], 1e-6);
    let values = |z: &[f64]| {
        let mut values = vec![0.0; basis.products.terms()];
        basis.products.evaluate(z, &mut values);
        values
    };
    let here = values(&at);
    for column in 0..3 {
        let [above, below] = [h, -h].map(|step| {
            let mut z = at;
            z[column] += step;
            values(&z)
        });
        for product in 0..basis.products.terms() {
            let exact: f64 =
                basis.derivative(column, product).iter().map(|(place, factor)| factor * here[*place]).sum();
            assert!((exact - (above[product] - below[product]) / (2.0 * h)).abs() < 1e-7, "{column} {product}");
        }
    }
}

#[test]
fn a_polynomial_element_is_found_exactly_with_its_degrees() {
    let ElementFit { element, candidates, best } = fitted(VELOCITIES, exact, true);
    assert!(candidates[best].error < 1e-6, "{candidates:?}");
    // p x² y² has a total degree of 5
    assert_eq!((candidates[best].potential, candidates[best].dissipation), (5, Some(1)), "{candidates:?}");
    let unseen = rows(100, 3, exact, true);
    for (found, exact) in element.graph().evaluate(&unseen.points).iter().zip(&unseen.forces) {
        assert!(found.iter().zip(exact).all(|(found, exact)| (found - exact).abs() < 1e-5), "{found:?} {exact:?}");
    }
}

#[test]
fn forces_that_create_energy_are_approximated_by_some_that_do_not() {
    // circulates, and has a negative damping
    let active = |point: &[f64]| vec![point[2] - point[3], -point[1] - 0.1 * point[4]];
    let ElementFit { element, candidates, best } = fitted(VELOCITIES, active, true);
    assert!(candidates[best].error > 0.3, "{candidates:?}");
    let moving = rows(500, 4, active, true).points;
    let still: Rows = moving.iter().map(|point| [&point[..3], &[0.0, 0.0]].concat()).collect();
    let (forces, forces_at_rest) = (element.graph().evaluate(&moving), element.graph().evaluate(&still));
    for (point, (moving, still)) in moving.iter().zip(forces.iter().zip(&forces_at_rest)) {
        let power: f64 = (0..2).map(|i| (moving[i] - still[i]) * point[3 + i]).sum();
        assert!(power > -1e-13, "{point:?}: {power}");
    }
}

#[test]
fn without_velocities_there_is_no_dissipation() {
    let elastic = |point: &[f64]| exact(&[point[0], point[1], point[2], 0.0, 0.0]);
    let ElementFit { element, candidates, best } = fitted("", elastic, false);
    assert!(candidates[best].error < 1e-8 && candidates[best].dissipation.is_none(), "{candidates:?}");
    assert_eq!((element.entries(), element.graph().inputs), (0, 3));
}

#[test]
fn degrees_of_the_study_are_kept_and_those_of_too_few_rows_refused() {
    let given = format!("{VELOCITIES}\npotential = 3\ndissipation = 0");
    let ElementFit { candidates, .. } = fitted(&given, exact, true);
    let degrees: Vec<_> = candidates.iter().map(|of| (of.potential, of.dissipation)).collect();
    assert_eq!(degrees, [(3, Some(0))]);
    let few = rows(20, 1, exact, true);
    let problem = fit(&study(&given), &few, &few, &AtomicBool::new(false)).unwrap_err().to_string();
    assert!(
        problem.contains("23 coefficients, expected at most 2000 and at most a third of the 40 forces"),
        "{problem}"
    );
    let stopped = fit(&study(VELOCITIES), &few, &few, &AtomicBool::new(true));
    assert!(matches!(stopped, Err(crate::Error::Interrupted)));
}
