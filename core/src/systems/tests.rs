//! Built-in systems against the mechanisms that describe the same, in both formulations.

use super::{System, SystemQuantity};
use crate::{
    integrate::{Budget, TOLERANCE},
    multibody::Mechanism,
};
use std::path::Path;

/// Largest difference of the outputs between a built-in system and its mechanism, `count` steps long.
fn difference(name: &str, points: &[&[f64]], parameters: &[&str], stop: f64, count: u32) -> f64 {
    let system = System::of(name).unwrap();
    let times: Vec<f64> = (0..=count).map(|i| stop * f64::from(i) / f64::from(count)).collect();
    let text = system.mechanism.replace("formulation", "# formulation");
    let mut largest: f64 = 0.0;
    for formulation in ["augmented", "embedding"] {
        let text = format!("formulation = \"{formulation}\"\n{text}");
        let mechanism = Mechanism::parse(&text, Path::new("m.toml")).unwrap();
        for point in points {
            let set = |name: &str| parameters.iter().position(|known| *known == name).map(|index| point[index]);
            let values: Vec<f64> = (mechanism.parameters().iter())
                .map(|(name, parameter)| set(name).unwrap_or(parameter.default))
                .collect();
            let twin = mechanism.simulate(&values, &times, TOLERANCE, &Budget::default()).unwrap();
            let quantity = |quantity: &SystemQuantity| set(quantity.name).unwrap_or(quantity.default);
            let quantities: Vec<f64> = system.quantities.iter().map(quantity).collect();
            let exact = (system.simulate)(&quantities, &times, TOLERANCE, &Budget::default()).unwrap();
            for (exact, twin) in exact.chunks(system.outputs.len()).zip(twin.chunks(mechanism.outputs().len())) {
                for (output, exact) in system.outputs.iter().zip(exact) {
                    let column = mechanism.outputs().iter().position(|known| known.name == output.name).unwrap();
                    largest = largest.max((twin[column] - exact).abs());
                }
            }
        }
        for name in parameters {
            assert!(mechanism.parameters().contains_key(*name), "{name}");
        }
    }
    largest
}

#[test]
fn the_single_pendulum_is_its_mechanism() {
    let points: [&[f64]; 4] = [&[0.1, 0.0, 5.0], &[0.2, 0.15, 0.0], &[0.1911, 0.055, 3.78], &[0.123, 0.055, 2.53]];
    let largest = difference("single-pendulum", &points, &["L", "c", "thetad0"], 2.0, 200);
    // theta and thetad; thetadd is up to 98 times theta
    assert!(largest < 1e-8, "{largest:e}");
}

#[test]
fn the_double_pendulum_is_its_mechanism() {
    let points: [&[f64]; 3] = [&[1.0, 2.0, 0.1, 0.5], &[1.01, 2.13, 0.0, 0.3], &[1.98, 2.94, 0.087, 0.47]];
    let parameters = ["L1", "L2", "theta1d0", "theta2d0"];
    let largest = difference("double-pendulum", &points, &parameters, 5.0, 500);
    assert!(largest < 1e-8, "{largest:e}");
}

#[test]
fn the_slider_crank_is_its_mechanism() {
    let points: [&[f64]; 3] = [&[1.0, 1.0, 2.5], &[2.0, 3.0, 3.5], &[1.78, 1.36, 3.05]];
    let largest = difference("slider-crank", &points, &["tau", "r", "L_over_r"], 5.0, 500);
    assert!(largest < 1e-11, "{largest:e}");
}

/// The files packed with this crate are copies of the examples in the repository.
#[test]
fn the_files_of_systems_are_those_among_the_examples() {
    let examples = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples"));
    for system in super::SYSTEMS {
        for (text, folder) in [(system.study, examples.to_owned()), (system.mechanism, examples.join("mechanisms"))] {
            let path = folder.join(system.name).with_extension("toml");
            assert_eq!(
                text,
                std::fs::read_to_string(&path).unwrap(),
                "{}: copy it to core/src/systems/",
                path.display()
            );
        }
    }
}
