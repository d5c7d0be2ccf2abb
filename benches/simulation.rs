//! Simulation: order of the integrator, accuracy of mechanisms in both formulations, and cost of a run.
//!
//! `cargo bench -p metafmu-benches --bench simulation` prints the tables of docs/multibody.md.

use metafmu::{
    integrate::{Budget, IntegrationResult, TOLERANCE, advance},
    multibody::{Mechanism, model::Sample, simulate::simulate},
    systems::SYSTEMS,
};
use nalgebra::Vector2;
use ode_solvers::{Dop853, System, dop_shared::OutputType};
use std::{path::Path, time::Instant};

/// `y'' = -sin y` with amplitude 2.
struct Pendulum;

impl System<f64, Vector2<f64>> for Pendulum {
    fn system(&self, _: f64, y: &Vector2<f64>, derivative: &mut Vector2<f64>) {
        *derivative = Vector2::new(y[1], -y[0].sin());
    }
}

const MECHANISMS: [&str; 6] =
    ["single-pendulum", "double-pendulum", "slider-crank", "four-bar", "quarter-car", "scotch-yoke"];

fn main() {
    order();
    accuracy();
    cost();
}

fn grid(stop: f64) -> Vec<f64> {
    (0..=500).map(|i| stop * f64::from(i) / 500.0).collect()
}

/// A mechanism of `examples/` in one formulation.
fn mechanism(name: &str, formulation: &str) -> Mechanism {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../examples/mechanisms/{name}.toml"));
    let text = std::fs::read_to_string(&path).unwrap();
    let rest: Vec<&str> = text.lines().filter(|line| !line.starts_with("formulation")).collect();
    Mechanism::parse(&format!("formulation = \"{formulation}\"\n{}", rest.join("\n")), &path).unwrap()
}

/// Largest violation of the constraints, drift of the energy, and difference to the built-in system of the same name.
fn accuracy() {
    println!("\n| mechanism, formulation | residual | energy drift | to closed form |\n|---|---|---|---|");
    for name in MECHANISMS {
        for formulation in ["augmented", "embedding"] {
            let mechanism = mechanism(name, formulation);
            // without what dissipates
            let value =
                |(name, default): (&String, f64)| if ["c", "damping"].contains(&name.as_str()) { 0.0 } else { default };
            let values: Vec<f64> = mechanism.parameters().iter().map(|(name, p)| value((name, p.default))).collect();
            let (model, _) = mechanism.build(&values).unwrap();
            let samples = simulate(&model, &grid(10.0), &Budget::default()).unwrap();
            let largest = |of: &dyn Fn(&Sample) -> f64| samples.iter().map(of).fold(0.0, f64::max);
            let residual = largest(&|s| model.constraints.violation(s.t, &s.q, &s.v));
            let energy = |s: &Sample| model.kinetic_energy(&s.v) + model.potential_energy(&s.q);
            let drift =
                largest(&|s| (energy(s) - energy(&samples[0])).abs()) / largest(&|s| model.kinetic_energy(&s.v));
            let is_conservative = ["single-pendulum", "double-pendulum", "four-bar"].contains(&name);
            let drift = if is_conservative { format!("{drift:.1e}") } else { "-".into() };
            let twin = SYSTEMS.iter().find(|system| system.name == name).map(|_| twin(&mechanism, name, &values));
            let twin = twin.map_or("-".into(), |difference| format!("{difference:.1e}"));
            println!("| {name}, {formulation} | {residual:.1e} | {drift} | {twin} |");
        }
    }
}

/// Largest difference of an output to that of the built-in system over 5 s.
fn twin(mechanism: &Mechanism, name: &str, values: &[f64]) -> f64 {
    let system = SYSTEMS.iter().find(|system| system.name == name).unwrap();
    let value = |name: &str| mechanism.parameters().get_index_of(name).map(|index| values[index]);
    let quantities: Vec<f64> = system.quantities.iter().map(|q| value(q.name).unwrap_or(q.default)).collect();
    let exact = (system.simulate)(&quantities, &grid(5.0), TOLERANCE, &Budget::default()).unwrap();
    let found = mechanism.simulate(values, &grid(5.0), TOLERANCE, &Budget::default()).unwrap();
    let rows = exact.chunks(system.outputs.len()).zip(found.chunks(mechanism.outputs().len()));
    let column = |name: &str| mechanism.outputs().iter().position(|output| output.name == name).unwrap();
    let columns: Vec<usize> = system.outputs.iter().map(|output| column(output.name)).collect();
    rows.flat_map(|(exact, found)| exact.iter().zip(&columns).map(|(exact, &column)| (exact - found[column]).abs()))
        .fold(0.0, f64::max)
}

/// Error over step size, where the order shows, and over work with steps of the method's own choice.
fn order() {
    let times: Vec<f64> = (0..=200).map(|i| 0.1 * f64::from(i)).collect();
    let start = Vector2::new(2.0, 0.0);
    let solve = |tolerance: f64| advance(Pendulum, start, &times, tolerance, &Budget::default());
    let exact = solve(1e-13).states;
    let largest = |states: &[Vector2<f64>]| states.iter().zip(&exact).map(|(a, b)| (a - b).amax()).fold(0.0, f64::max);

    println!("| step in s | error | order |\n|---|---|---|");
    let mut before: Option<f64> = None;
    for step in [0.8, 0.4, 0.2, 0.1] {
        // any error will do, no step grows, the largest and the first step are `step`
        let mut solver = Dop853::from_param(
            Pendulum,
            0.0,
            20.001,
            0.1,
            start,
            1e9,
            1e9,
            0.9,
            0.0,
            0.333,
            1.0,
            step,
            step,
            100_000,
            100_000,
            OutputType::Dense,
        );
        solver.integrate().unwrap();
        let error = largest(&solver.y_out()[..times.len()]);
        let order = before.map_or(String::new(), |before| format!("{:.1}", (before / error).log2()));
        before = Some(error);
        println!("| {step} | {error:.1e} | {order} |");
    }
    println!("\n| tolerance | error | evaluations |\n|---|---|---|");
    for exponent in 4..=11 {
        let tolerance = 10f64.powi(-exponent);
        let IntegrationResult { states, evaluations, .. } = solve(tolerance);
        println!("| {tolerance:.0e} | {:.1e} | {evaluations} |", largest(&states));
    }
}

/// Shortest time of a run with the default parameters and 500 rows.
fn cost() {
    let report = |name: &str, simulate: &dyn Fn()| {
        let start = Instant::now();
        let mut shortest = f64::INFINITY;
        while start.elapsed().as_secs_f64() < 1.0 {
            let begin = Instant::now();
            simulate();
            shortest = shortest.min(begin.elapsed().as_secs_f64());
        }
        println!("| {name} | {:.3} |", 1e3 * shortest);
    };
    println!("\n| run of 5 s, 500 rows, on one core | ms |\n|---|---|");
    for system in SYSTEMS {
        let quantities: Vec<f64> = system.quantities.iter().map(|quantity| quantity.default).collect();
        report(&format!("{}, closed form", system.name), &|| {
            (system.simulate)(&quantities, &grid(5.0), TOLERANCE, &Budget::default()).unwrap();
        });
    }
    for name in MECHANISMS {
        for formulation in ["augmented", "embedding"] {
            let mechanism = mechanism(name, formulation);
            let values: Vec<f64> = mechanism.parameters().values().map(|parameter| parameter.default).collect();
            report(&format!("{name}, {formulation}"), &|| {
                mechanism.simulate(&values, &grid(5.0), TOLERANCE, &Budget::default()).unwrap();
            });
        }
    }
}
