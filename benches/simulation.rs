//! Simulation: order of the integrator, and cost of a run of each built-in system and mechanism.
//!
//! `cargo bench --bench simulation` prints both tables.

use metafmu::{
    integrate::{Integration, advance},
    multibody::Mechanism,
    source::systems::SYSTEMS,
};
use nalgebra::Vector2;
use ode_solvers::System;
use std::{path::Path, time::Instant};

/// `y'' = -sin y` with amplitude 2.
struct Pendulum;

impl System<f64, Vector2<f64>> for Pendulum {
    fn system(&self, _: f64, y: &Vector2<f64>, derivative: &mut Vector2<f64>) {
        *derivative = Vector2::new(y[1], -y[0].sin());
    }
}

fn main() {
    order();
    cost();
}

/// Error over work: the slope of a straight line through the logarithms is the order.
fn order() {
    let times: Vec<f64> = (0..=200).map(|i| 0.1 * f64::from(i)).collect();
    let solve = |tolerance: f64| advance(Pendulum, Vector2::new(2.0, 0.0), &times, tolerance);
    let exact = solve(1e-13).states;
    let mut points = Vec::new();
    println!("pendulum, 20 s, all rows: error over work\n\ntolerance  evaluations  largest error");
    for exponent in 4..=11 {
        let tolerance = 10f64.powi(-exponent);
        let Integration { states, evaluations, .. } = solve(tolerance);
        let error = states.iter().zip(&exact).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);
        points.push((f64::from(evaluations).ln(), error.ln()));
        println!("{tolerance:9.0e}  {evaluations:11}  {error:13.1e}");
    }
    let mean = |values: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(values).sum::<f64>() / points.len() as f64;
    let (x, y) = (mean(&|point| point.0), mean(&|point| point.1));
    let slope = mean(&|point| (point.0 - x) * (point.1 - y)) / mean(&|point| (point.0 - x).powi(2));
    println!("\norder {:.1}", -slope);
}

/// Shortest time of a run with the default parameters and 500 rows.
fn cost() {
    let grid = |stop: f64| (0..=500).map(|i| stop * f64::from(i) / 500.0).collect::<Vec<f64>>();
    let report = |name: &str, simulate: &dyn Fn()| {
        let start = Instant::now();
        let mut shortest = f64::INFINITY;
        while start.elapsed().as_secs_f64() < 1.0 {
            let begin = Instant::now();
            simulate();
            shortest = shortest.min(begin.elapsed().as_secs_f64());
        }
        println!("{name:44} {:10.3} ms", 1e3 * shortest);
    };
    println!("\none run on one core, 500 rows of 5 s\n");
    for system in SYSTEMS {
        let quantities: Vec<f64> = system.quantities.iter().map(|quantity| quantity.default).collect();
        report(&format!("{}, closed form", system.name), &|| {
            (system.simulate)(&quantities, &grid(5.0)).unwrap();
        });
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/mechanisms");
    for name in ["single-pendulum", "double-pendulum", "slider-crank", "four-bar", "quarter-car", "scotch-yoke"] {
        let text = std::fs::read_to_string(folder.join(format!("{name}.toml"))).unwrap();
        let rest: Vec<&str> = text.lines().filter(|line| !line.starts_with("formulation")).collect();
        for formulation in ["augmented", "embedding"] {
            let text = format!("formulation = \"{formulation}\"\n{}", rest.join("\n"));
            let mechanism = Mechanism::parse(&text, Path::new(name)).unwrap();
            let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
            report(&format!("{name}, {formulation}"), &|| {
                mechanism.simulate(&values, &grid(5.0)).unwrap();
            });
        }
    }
}
