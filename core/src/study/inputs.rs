//! `[inputs]`: what acts on a surrogate with states while it runs.

use super::{Study, outputs::check_variable_name};
use crate::diagnostics::{Problems, numbers::ends};
use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// An entry of `[inputs]`. All keys have defaults.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("examples" = [{"min": -10.0, "max": 10.0, "bandwidth": 1.0}]))]
pub struct InputOptions {
    /// Smallest value; the source's unless given, of a table the smallest one there.
    #[schemars(extend("x-unit" = "the input's"))]
    pub min: Option<f64>,
    /// Largest value; the source's unless given, of a table the largest one there.
    #[schemars(extend("x-unit" = "the input's"))]
    pub max: Option<f64>,
    /// Value before a host sets one; the source's unless given.
    #[schemars(extend("x-unit" = "the input's"))]
    pub start: Option<f64>,
    /// Highest frequency of signals other than recordings; a twentieth of the rows' frequency, `0.05 / time.step`, unless given.
    #[schemars(extend("x-unit" = "Hz", "exclusiveMinimum" = 0))]
    pub bandwidth: Option<f64>,
    /// Kinds of signals of runs that are simulated, one of which is drawn for each run; `["multisine"]` unless given, none with a
    /// `recording`.
    pub excitation: Option<Vec<Excitation>>,
    /// Table of a recorded signal, CSV or Parquet, relative to the study's folder: a column of the input's name, and `time` in s. It is a
    /// further kind of signal: a run takes a stretch of it from a random place on, linear between its rows. All recordings that drive a run
    /// begin at the same share of their lengths.
    #[schemars(extend("format" = "path"))]
    pub recording: Option<PathBuf>,
    /// Unit; must be the source's own, which it is unless given.
    pub unit: Option<String>,
    /// One sentence for people; the source's unless given.
    pub description: Option<String>,
}

/// A kind of signal. All are within the range, and linear between two rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Excitation {
    /// Ten sines of random frequencies up to the bandwidth and random phases.
    Multisine,
    /// Levels that are held for random times, on average half a period of the bandwidth.
    Steps,
    /// Straight lines between random levels at random times.
    Ramps,
    /// A sine whose frequency grows to the bandwidth during the run.
    Chirp,
    /// Pseudo-random binary: the ends of the range, in turn, for random multiples of half a period of the bandwidth.
    Binary,
    /// Random with a flat spectrum up to the bandwidth: a hundred sines of random phases.
    Random,
    /// A smooth curve through random levels, half a period of the bandwidth apart.
    Spline,
}

impl InputOptions {
    /// The kinds of signals that are drawn from, beside a recording.
    pub fn excitations(&self) -> &[Excitation] {
        let usual: &[Excitation] = if self.recording.is_some() { &[] } else { &[Excitation::Multisine] };
        self.excitation.as_deref().unwrap_or(usual)
    }

    /// The bandwidth of signals whose rows are so far apart, in Hz.
    pub fn bandwidth(&self, step: f64) -> f64 {
        self.bandwidth.unwrap_or(0.05 / step)
    }
}

/// Every mistake in `[inputs]`, by dotted key.
pub(super) fn problems(inputs: &IndexMap<String, InputOptions>) -> Problems {
    let mut problems = Problems::default();
    for (name, InputOptions { min, max, start, bandwidth, excitation, recording, .. }) in inputs {
        let key = format!("inputs.{name}");
        check_variable_name(&mut problems, &key, name);
        for (field, value) in [("min", min), ("max", max), ("start", start)] {
            if let Some(value) = value.filter(|value| !value.is_finite()) {
                problems.add(format!("{key}.{field}"), format!("{value}, expected a finite number"));
            }
        }
        if let Some(bandwidth) = bandwidth {
            problems.expect_positive(format!("{key}.bandwidth"), *bandwidth);
        }
        if excitation.as_ref().is_some_and(Vec::is_empty) {
            problems.add(format!("{key}.excitation"), "no kind of signal, expected at least one");
        }
        let is_unused = bandwidth.is_some() && recording.is_some() && excitation.is_none();
        let message = "belongs to kinds of `excitation`, and there are none beside the recording";
        problems.expect_absent(is_unused, format!("{key}.bandwidth"), message);
    }
    problems
}

/// Ranges of columns of tables that are empty, and start values outside of them.
pub(super) fn range_problems(study: &Study) -> Problems {
    let mut problems = Problems::default();
    for (name, input) in &study.inputs {
        let (min, max) = (input.min.unwrap_or(f64::NEG_INFINITY), input.max.unwrap_or(f64::INFINITY));
        if min >= max {
            problems.add(format!("inputs.{name}"), format!("from {min} to {max}, expected min below max"));
        } else if let Some(start) = input.start.filter(|start| !(min..=max).contains(start)) {
            problems.add(format!("inputs.{name}.start"), format!("{start}, expected {}", ends(min, max)));
        }
    }
    problems
}

/// Problems that depend on the other sections.
pub(super) fn problems_beside(study: &Study) -> Problems {
    let mut problems = Problems::default();
    for (name, input) in &study.inputs {
        let key = format!("inputs.{name}");
        if study.parameters.contains_key(name) || study.outputs.contains_key(name) {
            problems.add(&key, format!("`{name}` is a parameter or output already: names of variables must be unique"));
        }
        if study.source.is_recorded() {
            let message = "belongs to sources that are simulated: recorded inputs are what they are";
            problems.expect_absent(input.bandwidth.is_some(), format!("{key}.bandwidth"), message);
            problems.expect_absent(input.excitation.is_some(), format!("{key}.excitation"), message);
            problems.expect_absent(input.recording.is_some(), format!("{key}.recording"), message);
        }
        let run = study.time.training_steps() as f64 * study.time.step;
        if let Some(message) = study.recordings.get(name).and_then(|recording| recording.too_short(run)) {
            problems.add(format!("{key}.recording"), message);
        }
        let nyquist = 0.5 / study.time.step;
        if let Some(bandwidth) = input.bandwidth.filter(|bandwidth| *bandwidth > nyquist) {
            let message = format!("{bandwidth} Hz, expected at most half of the rows' frequency, {nyquist} Hz");
            problems.add(format!("{key}.bandwidth"), message);
        }
    }
    problems
}
