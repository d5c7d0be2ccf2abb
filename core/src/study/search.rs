//! `[search]`: which studies are tried.

use super::BaselineKind;
use crate::diagnostics::{Problems, numbers::from_to, schema};
use indexmap::IndexMap;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use toml::de::DeTable;

/// `[search]`: studies that differ from this one in some keys, of which the best is wanted.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SearchOptions {
    /// Which trials there are, and how far each goes.
    #[serde(default)]
    pub method: SearchMethod,
    /// Number of trials, 2 to 10,000; a grid has as many as it has points.
    #[schemars(range(min = 2, max = MAX_TRIALS))]
    pub trials: Option<usize>,
    /// Method "halving": number of comparisons of the trials, the last one after all epochs.
    #[serde(default = "default_rungs")]
    #[schemars(range(min = 1, max = MAX_RUNGS))]
    pub rungs: u32,
    /// Method "halving": factor by which each comparison reduces the number of trials and increases their epochs.
    #[serde(default = "default_reduction")]
    #[schemars(range(min = 2))]
    pub reduction: usize,
    /// The baseline that is fitted instead of the network, if any.
    pub model: Option<BaselineKind>,
    /// Values by the dotted key of this file that they are for.
    pub space: IndexMap<String, Space>,
}

fn default_rungs() -> u32 {
    3
}

fn default_reduction() -> usize {
    3
}

/// How trials are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SearchMethod {
    /// Every combination of values.
    Grid,
    /// Values drawn at random, independently of each other.
    Random,
    /// As random; all begin, and after each rung the better ones go on (successive halving, arXiv:1502.07943).
    #[default]
    Halving,
}

/// Values of one key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Space {
    /// These.
    Values(#[schemars(with = "Vec<serde_json::Value>")] Vec<toml::Value>),
    /// Numbers of a range.
    Range(SearchRange),
}

/// Numbers of a range; whole ones if both ends are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SearchRange {
    /// Smallest value.
    #[schemars(with = "f64")]
    pub min: toml::Value,
    /// Largest value.
    #[schemars(with = "f64")]
    pub max: toml::Value,
    /// How values are spread.
    #[serde(default)]
    pub scale: SearchScale,
    /// Number of values in a grid.
    #[schemars(range(min = 2))]
    pub levels: Option<usize>,
}

/// How the values of a range are spread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SearchScale {
    /// Evenly.
    #[default]
    Linear,
    /// Their logarithms evenly.
    Log,
}

impl SearchOptions {
    /// Every mistake, by key within the section.
    pub fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        let mut add = |key: &str, message: String| problems.add(key, message);
        if self.space.is_empty() {
            add("space", "no key, expected at least one".into());
        }
        let grid = self.method == SearchMethod::Grid;
        match self.trials {
            Some(_) if grid => add("trials", "a grid has as many trials as points".into()),
            Some(trials) if trials < 2 => add("trials", format!("{trials}, expected at least 2")),
            Some(trials) if trials > MAX_TRIALS => add("trials", format!("{trials}, expected 2 to {MAX_TRIALS}")),
            None if !grid => add("trials", "missing: expected at least 2".into()),
            _ => {}
        }
        if !(1..=MAX_RUNGS).contains(&self.rungs) {
            add("rungs", format!("{}, expected 1 to {MAX_RUNGS}", self.rungs));
        }
        if self.reduction < 2 {
            add("reduction", format!("{}, expected at least 2", self.reduction));
        }
        for (name, space) in &self.space {
            let key = format!("space.{name}");
            if self.model.is_none() && name.starts_with("baselines.") {
                add(&key, "is no key of the network's, expected `search.model` to say which baseline is fitted".into());
            }
            if let Some(model) = self.model.filter(|model| !concerns(name, model.name())) {
                add(&key, format!("decides nothing about the baseline `{}`, which is fitted", model.name()));
            }
            if name == "search" || name.starts_with("search.") {
                add(&key, "a trial is no search".into());
            }
            match space {
                Space::Values(values) if values.is_empty() => add(&key, "no values, expected at least one".into()),
                Space::Values(_) => {}
                Space::Range(range) => {
                    if let Some(message) = range.problem(grid) {
                        add(&key, message);
                    }
                }
            }
        }
        let points = |space: &Space| match space {
            Space::Values(values) => values.len(),
            Space::Range(range) => range.levels.unwrap_or(2),
        };
        let trials = self.space.values().map(points).fold(1, usize::saturating_mul);
        if grid && trials > MAX_TRIALS {
            problems.add("space", format!("{trials} trials, expected at most {MAX_TRIALS}"));
        }
        problems
    }
}

impl SearchOptions {
    /// Keys of the space that the study cannot have, and values of the wrong type; by key within the section.
    pub(super) fn key_problems(&self, schema: &serde_json::Value) -> Problems {
        let mut problems = Problems::default();
        for (name, space) in &self.space {
            let key = format!("space.{name}");
            for choice in space.choices() {
                let mut study = toml::Table::new();
                set(&mut study, name, choice);
                let text = study.to_string();
                let Ok(root) = DeTable::parse(&text) else { continue };
                // one mistake of each key is enough, and what is missing is in the study itself
                let mistakes = schema::mistakes(schema, |_, _| None, root.get_ref(), &text);
                if let Some(mistake) = mistakes.into_iter().find(|mistake| !mistake.is_missing) {
                    problems.add(key, mistake.message);
                    break;
                }
            }
        }
        problems
    }
}

impl Space {
    /// All values of a list, the ends of a range.
    pub fn choices(&self) -> Vec<toml::Value> {
        match self {
            Self::Values(values) => values.clone(),
            Self::Range(range) => vec![range.min.clone(), range.max.clone()],
        }
    }
}

/// Sets the value of a dotted key; none if it leads through something that is not a table.
pub fn set(table: &mut toml::Table, key: &str, value: toml::Value) -> Option<()> {
    match key.split_once('.') {
        None => {
            table.insert(key.to_owned(), value);
            Some(())
        }
        Some((first, rest)) => {
            let inner = table.entry(first).or_insert_with(|| toml::Value::Table(toml::Table::new()));
            set(inner.as_table_mut()?, rest, value)
        }
    }
}

/// Trials of a search: each is a study in memory.
const MAX_TRIALS: usize = 10_000;

/// Maximum number of rungs: the first of 20 trains for a millionth of the epochs or less.
const MAX_RUNGS: u32 = 20;

/// Returns true if a key affects a baseline.
fn concerns(key: &str, model: &str) -> bool {
    match key.split_once('.') {
        Some(("baselines", rest)) => rest == "time_budget" || rest.split('.').next() == Some(model),
        Some(("network", _)) => false,
        Some(("training", rest)) => rest == "validation",
        _ => true,
    }
}

impl SearchRange {
    /// Both ends as numbers.
    pub(crate) fn ends(&self) -> Option<(f64, f64)> {
        let number = |value: &toml::Value| value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64));
        Some((number(&self.min)?, number(&self.max)?))
    }

    fn problem(&self, grid: bool) -> Option<String> {
        let Some((min, max)) = self.ends() else { return Some("`min` and `max`: expected numbers".into()) };
        if !(min.is_finite() && max.is_finite() && min < max) {
            return Some(format!("range {} is empty or not finite", from_to(min, max)));
        }
        if self.scale == SearchScale::Log && min <= 0.0 {
            return Some(format!("min {min}: a logarithmic range begins above 0"));
        }
        match self.levels {
            None if grid => Some("a range in a grid needs `levels`".into()),
            Some(levels) if levels < 2 => Some(format!("{levels} levels, expected at least 2")),
            _ => None,
        }
    }

    /// The value at a share of the way from `min` to `max`.
    pub fn at(&self, share: f64) -> toml::Value {
        let (min, max) = self.ends().unwrap_or_default();
        let value = match self.scale {
            SearchScale::Linear => min + share * (max - min),
            SearchScale::Log => min * (max / min).powf(share),
        };
        if self.min.is_integer() && self.max.is_integer() {
            toml::Value::Integer((value.round() as i64).clamp(min as i64, max as i64))
        } else {
            toml::Value::Float(value.clamp(min, max))
        }
    }
}
