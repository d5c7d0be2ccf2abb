//! `[parameters]`: inputs of the surrogate beside the time.

use super::{Method, RunForm, Study, outputs::check_variable_name};
use crate::{
    diagnostics::{
        Problems,
        numbers::{exact, from_to},
    },
    scaling::LARGEST,
};
use indexmap::IndexMap;
use metafmu_runtime::Encoding;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// An entry of `[parameters]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(from = "ParameterEntry")]
pub struct ParameterOptions {
    /// Lower end of the range; of a nominal parameter the smallest value.
    pub min: f64,
    /// Upper end of the range; of a nominal parameter the largest value.
    pub max: f64,
    /// The values of a nominal parameter, which has no others; none: it has a range.
    pub values: Vec<f64>,
    /// `true` if `max` is equivalent to `min`, as for an angle of a full turn.
    pub periodic: bool,
    /// Unit; must be the source's own.
    pub unit: Option<String>,
    /// One sentence for people; the source has one.
    pub description: Option<String>,
    /// Levels of this parameter in a mesh, instead of `sampling.levels`.
    pub levels: Option<usize>,
    /// When the host of the surrogate's FMU may change it. Unless given, `Tunable` if outputs follow from states or samples, else `Fixed`.
    pub variability: Option<ParameterVariability>,
    /// Which of its keys are missing, or exclude each other.
    #[serde(skip)]
    pub(super) problem: Option<&'static str>,
}

/// When a host may change what is a parameter of the study, and constant in each of its runs (FMI terms).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ParameterVariability {
    /// Only before the simulation starts.
    Fixed,
    /// Also between two steps and at events. A response warns and is outside its domain from then on.
    Tunable,
    /// Any time: an input, which another component may drive. A response warns and is outside its domain from then on.
    Continuous,
}

/// An entry of `[parameters]`: a range by `min` and `max`, or the `values` of a nominal parameter.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename = "Parameter")]
#[schemars(extend("examples" = [{"min": 0.1, "max": 0.2}]))]
struct ParameterEntry {
    /// Lower end of the range.
    #[schemars(extend("x-unit" = "the parameter's"))]
    min: Option<f64>,
    /// Upper end of the range.
    #[schemars(extend("x-unit" = "the parameter's"))]
    max: Option<f64>,
    /// The values of a nominal parameter, at least 2; it has no others.
    #[schemars(extend("x-unit" = "the parameter's"))]
    values: Option<Vec<f64>>,
    /// `true` if `max` is equivalent to `min`, as for an angle of a full turn.
    #[serde(default)]
    periodic: bool,
    /// Unit; must be the source's own, which it is unless given.
    unit: Option<String>,
    /// One sentence for people; the source's unless given.
    description: Option<String>,
    /// Levels of this parameter in a mesh, instead of `sampling.levels`.
    #[schemars(range(min = 2))]
    levels: Option<usize>,
    /// When the host of the surrogate's FMU may change it. Unless given, "tunable" for the structures "dynamics" and "discrete", else "fixed".
    variability: Option<ParameterVariability>,
}

impl From<ParameterEntry> for ParameterOptions {
    fn from(entry: ParameterEntry) -> Self {
        let ParameterEntry { min, max, values, periodic, unit, description, levels, variability } = entry;
        let problem = match (&values, min, max) {
            (None, Some(_), Some(_)) => None,
            (None, None, None) => Some("expected `min` and `max`, or `values`"),
            (None, None, _) => Some("`min` is missing"),
            (None, _, None) => Some("`max` is missing"),
            (Some(values), None, None) if levels.is_none() && !periodic => {
                values.is_empty().then_some("no `values`, expected at least 2")
            }
            (Some(_), ..) => Some("`values` exclude `min`, `max`, `levels` and `periodic`"),
        };
        let values = values.unwrap_or_default();
        let min = min.unwrap_or_else(|| values.iter().copied().fold(f64::INFINITY, f64::min));
        let max = max.unwrap_or_else(|| values.iter().copied().fold(f64::NEG_INFINITY, f64::max));
        Self { min, max, values, periodic, unit, description, levels, variability, problem }
    }
}

impl ParameterOptions {
    /// Options with a range only.
    pub(super) const fn range(min: f64, max: f64) -> Self {
        Self {
            min,
            max,
            values: Vec::new(),
            periodic: false,
            unit: None,
            description: None,
            levels: None,
            variability: None,
            problem: None,
        }
    }

    /// How its value becomes columns of the network.
    pub fn encoding(&self) -> Encoding {
        if self.is_nominal() {
            Encoding::Nominal(self.values.clone())
        } else if self.periodic {
            Encoding::Periodic
        } else {
            Encoding::Plain
        }
    }

    /// Returns true if it has `values` instead of a range.
    pub fn is_nominal(&self) -> bool {
        !self.values.is_empty()
    }

    /// Returns true if its range has ends.
    pub fn has_faces(&self) -> bool {
        !self.is_nominal() && !self.periodic
    }

    /// The value at a `share` from 0 to 1: of the range, or of the list of values, each of which has an equal part.
    pub fn at(&self, share: f64) -> f64 {
        let Self { min, max, values, .. } = self;
        match values.len() {
            0 => min + (max - min) * share,
            count => values[((share * count as f64) as usize).min(count - 1)],
        }
    }

    /// Where a value is, from 0 to 1: in the range, or in the list of values.
    pub fn share(&self, value: f64) -> f64 {
        match self.values.iter().position(|known| *known == value) {
            Some(index) => index as f64 / (self.values.len() - 1) as f64,
            None => (value - self.min) / (self.max - self.min),
        }
    }

    /// The values of a mesh: all of a nominal parameter, else `levels`, evenly spaced, both ends of the range included; of a
    /// periodic one without its upper end, which is its lower end again.
    pub fn mesh(&self, levels: usize) -> Vec<f64> {
        let Self { min, max, values, periodic, .. } = self;
        if self.is_nominal() {
            return values.clone();
        }
        let steps = if *periodic { levels } else { levels - 1 };
        (0..levels).map(|i| min + (max - min) * i as f64 / steps as f64).collect()
    }

    /// Problem of the range or the values.
    fn problem(&self) -> Option<String> {
        let Self { min, max, values, problem, .. } = self;
        if let Some(problem) = problem {
            Some((*problem).into())
        } else if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            Some(format!("value {value} is not finite"))
        } else if let Some(value) = twice(values) {
            Some(format!("value {value} is duplicated"))
        } else if values.len() == 1 {
            Some("1 value, expected at least 2".into())
        } else if !min.is_finite() || !max.is_finite() {
            Some(format!("range {} is not finite", from_to(*min, *max)))
        } else if min >= max {
            Some(format!("range is empty: min {} is not below max {}", exact(*min), exact(*max)))
        } else if min.abs().max(max.abs()) > LARGEST || max - min < 1.0 / LARGEST {
            Some(format!(
                "range {}, expected numbers up to {LARGEST:e} and a width above {:e}",
                from_to(*min, *max),
                1.0 / LARGEST
            ))
        } else {
            None
        }
    }
}

/// A value that is there more than once.
fn twice(values: &[f64]) -> Option<f64> {
    let mut before = HashSet::with_capacity(values.len());
    // zeros of both signs are one value
    values.iter().copied().find(|value| !before.insert((value + 0.0).to_bits()))
}

/// Every mistake in `[parameters]`, by dotted key.
pub(super) fn problems(parameters: &IndexMap<String, ParameterOptions>, form: RunForm) -> Problems {
    let mut problems = Problems::default();
    let is_motion = !form.are_planned;
    if parameters.is_empty() && !is_motion {
        problems.add("parameters", "no parameter, expected at least one");
    }
    for (name, parameter) in parameters {
        let key = format!("parameters.{name}");
        check_variable_name(&mut problems, &key, name);
        if let Some(problem) = parameter.problem() {
            problems.add(key, problem);
        } else if is_motion {
            let message = "belongs to the structure \"response\": expected `min` and `max`";
            problems.expect_absent(parameter.is_nominal(), format!("{key}.values"), message);
            problems.expect_absent(parameter.periodic, format!("{key}.periodic"), message);
            let is_driven = parameter.variability == Some(ParameterVariability::Continuous);
            let message =
                "\"continuous\", expected \"fixed\" or \"tunable\": what changes all the time is one of the `inputs`";
            problems.expect_absent(is_driven, format!("{key}.variability"), message);
        }
    }
    problems
}

/// Problems that depend on the other sections.
pub(super) fn problems_beside(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let Study { parameters, sampling, .. } = study;
    let Some(method) = sampling.method.filter(|_| !study.source.is_recorded()) else { return problems };
    if !parameters.is_empty() && parameters.values().all(ParameterOptions::is_nominal) {
        let message = "every parameter has `values`, expected one with a range: no run would be left for the tests";
        problems.add("parameters", message);
    }
    for (name, parameter) in parameters.iter().filter(|(_, parameter)| !parameter.is_nominal()) {
        let key = format!("parameters.{name}.levels");
        match (method, parameter.levels.or(sampling.levels)) {
            (Method::Mesh, None) => problems.add("sampling", format!("the mesh has no `levels` for `{name}`")),
            (Method::Mesh, Some(levels)) if levels < 2 => {
                problems.add(key, format!("{levels} levels, expected at least 2: both ends of the range"));
            }
            (Method::Mesh, _) => {}
            _ => problems.expect_absent(parameter.levels.is_some(), key, "belongs to the method \"mesh\""),
        }
    }
    problems
}
