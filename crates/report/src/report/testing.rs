//! A small surrogate with test runs that it predicts exactly.

use super::{Evaluated, Material};
use crate::{
    dataset::{Dataset, Run},
    evaluation::{Verdict, predict_all},
    study::Study,
};
use metafmu_example as example;
use metafmu_runtime::Surrogate;
use metafmu_tables::variable::SourceVariable;
use std::{path::Path, sync::Arc};

pub fn exact() -> (Surrogate, Dataset) {
    let surrogate = example::surrogate();
    let times: Arc<[f64]> = (0..21).map(|i| f64::from(i) * 0.1).collect();
    let run = |i: u32| {
        let parameters = vec![0.1 + 0.1 * (f64::from(i) * 0.618).fract(), 5.0 * (f64::from(i) * 0.381 + 0.1).fract()];
        Run { inputs: Vec::new(), parameters, times: Arc::clone(&times), outputs: Vec::new() }
    };
    let variable = |name: &str, unit: &str| SourceVariable::new(name, unit, "");
    let mut test = Dataset {
        inputs: Vec::new(),
        parameters: vec![variable("length", "m"), variable("speed", "rad/s")],
        outputs: vec![variable("angle", "rad"), variable("velocity", "rad/s")],
        runs: (0..12).map(run).collect(),
    };
    let predictions = predict_all(&surrogate, &test);
    test.runs.iter_mut().zip(predictions).for_each(|(run, outputs)| run.outputs = outputs);
    (surrogate, test)
}

/// A study of a surrogate in steps of 0.1 s.
pub fn study() -> Study {
    let text = include_str!("../../../../examples/quick/single-pendulum.toml").replace("step = 0.01 ", "step = 0.1 ");
    Study::parse(&text, Path::new("s.toml")).unwrap()
}

/// The least that a report needs.
pub fn material<'a>(study: &'a Study, evaluated: &'a Evaluated<'a>, verdict: &'a Verdict) -> Material<'a> {
    Material {
        study,
        evaluated,
        verdict,
        points: &[],
        mechanism: None,
        step_seconds: None,
        speed_up: None,
        no_speed: "its source could not be timed",
        subject: None,
        history: &[],
        facts: &[],
        comparison: None,
        beside: None,
    }
}
