//! `[states]`: the independent coordinates of a surrogate with states.

use crate::{
    Result,
    diagnostics::{
        Problems,
        numbers::{exact, from_to},
    },
    study::{ParameterOptions, Study},
    table::Table,
};
use indexmap::IndexMap;
use metafmu_runtime::State;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::{borrow::Cow, f64::consts::TAU};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// An entry of `[states]`. For a mechanism, an independent coordinate with its velocity, by the measure that names it,
/// or an actuator state, by its name. For an FMU or a program, a continuous state, by its name. For a table, the column
/// of a generalized coordinate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(extend("examples" = [{"min": -5.0, "max": 5.0}]))]
pub struct StateOptions {
    /// Lower end of the range in which the equations are learned; of a table its smallest value unless given. An actuator state needs none: its
    /// range of validity then follows from the training runs, as those of velocities.
    #[serde(default = "not_given", skip_serializing_if = "is_not_given")]
    #[schemars(extend("x-unit" = "rad or m"))]
    pub min: f64,
    /// Upper end; of an angle that goes around, a turn above `min`; of a table its largest value unless given.
    #[serde(default = "not_given", skip_serializing_if = "is_not_given")]
    #[schemars(extend("x-unit" = "rad or m"))]
    pub max: f64,
    /// Where runs start that the surrogate is tested with; the middle fifth of the range unless given.
    #[schemars(extend("x-unit" = "rad or m"))]
    pub start: Option<[f64; 2]>,
    /// Mechanism: velocities with which these runs start; 0 unless given. They belong to the domain of validity.
    #[schemars(extend("x-unit" = "rad/s or m/s"))]
    pub velocity: Option<[f64; 2]>,
    /// Velocities of a mechanism in the domain of validity, for which the solver's error is measured. Unless given, 1.5 times what the
    /// velocity reaches in the training runs, in either direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(extend("x-unit" = "rad/s or m/s"))]
    pub velocity_range: Option<[f64; 2]>,
    /// FMU, program or table: true if the state is an angle in rad, and the equations are the same a turn later. The
    /// range of an FMU's or a program's angle is a turn. A table's angle is not wound back into a turn, and has no
    /// range. Unless given, both are tried for a table, and the one that better continues held-out rows is taken.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub periodic: Option<bool>,
    /// Program: unit of the state. Other sources know the units of their states.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Program: coordinate whose rate this state is. The program then gives its mass matrix as well, and equations of motion are learned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate_of: Option<String>,
    /// Table: column of the coordinate's derivative with respect to time. Without it, the derivative is computed by
    /// differences and called `NAME_rate`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rate: Option<String>,
}

/// A range that the study does not give.
fn not_given() -> f64 {
    f64::NAN
}

fn is_not_given(end: &f64) -> bool {
    end.is_nan()
}

/// Measures of independent coordinates and of their velocities.
const MEASURES: [(&str, &str); 4] = [("angle", "angular_velocity"), ("position", "velocity"), ("x", "vx"), ("y", "vy")];

/// The name of a coordinate's velocity, in the terms of a mechanism file; none if it is no coordinate.
pub fn velocity_name(coordinate: &str) -> Option<String> {
    let (part, measure) = coordinate.rsplit_once('.')?;
    let (_, velocity) = MEASURES.iter().find(|(known, _)| *known == measure)?;
    Some(format!("{part}.{velocity}"))
}

/// Returns true if a coordinate is an angle.
pub fn is_angle(coordinate: &str) -> bool {
    coordinate.ends_with(".angle")
}

impl StateOptions {
    /// Returns true if the coordinate is an angle whose range is a full turn: every number is a valid value of it.
    pub fn goes_around(&self, name: &str) -> bool {
        self.is_periodic() || is_angle(name) && self.max - self.min > TAU - 1e-6
    }

    /// Returns true if the study declares it an angle.
    pub fn is_periodic(&self) -> bool {
        self.periodic.unwrap_or(false)
    }

    /// The name of the derivative of a coordinate of a table.
    pub fn rate_name(&self, name: &str) -> String {
        self.rate.clone().unwrap_or_else(|| format!("{name}_rate"))
    }

    /// The range that the study gives.
    pub fn range(&self) -> Option<[f64; 2]> {
        (self.min.is_finite() && self.max.is_finite()).then_some([self.min, self.max])
    }

    fn start(&self) -> [f64; 2] {
        let (middle, tenth) = (0.5 * (self.min + self.max), 0.1 * (self.max - self.min));
        self.start.unwrap_or([middle - tenth, middle + tenth])
    }
}

/// The values of the states at the start of a run, which are sampled like parameters: those of the coordinates, of the velocities, and of
/// actuator states.
pub(in crate::study) fn starts(study: &Study) -> IndexMap<String, ParameterOptions> {
    let range = |name: &str, [min, max]: [f64; 2]| (State::start_name(name), ParameterOptions::range(min, max));
    let own = study.coordinates().map(|(name, state)| range(name, state.start()));
    let of_actuators = study.actuator_states().map(|(name, state)| range(name, state.start()));
    // those of an FMU or a program are states by themselves
    let coordinates = study.coordinates().filter(|_| !study.source.is_run_apart());
    let velocities = coordinates.map(|(name, state)| {
        let velocity = match study.source.is_recorded() {
            true => state.rate_name(name),
            false => velocity_name(name).unwrap_or_default(),
        };
        range(&velocity, state.velocity.unwrap_or_default())
    });
    own.chain(velocities).chain(of_actuators).collect()
}

/// Takes the ranges that the study does not give from its table: the values of each coordinate in all rows. An angle has none, since every
/// number is a good value of it. Rows after `stop` are not looked at.
///
/// # Errors
/// [`Error::Table`](crate::Error::Table) with the missing column, or the line of a value that is not a finite number.
pub(in crate::study) fn complete(
    states: &mut IndexMap<String, StateOptions>,
    columns: &IndexMap<String, String>,
    stop: f64,
    table: &mut Table,
) -> Result<()> {
    let names = ["time"].into_iter().chain(states.keys().map(String::as_str));
    let names: Vec<&str> = names.map(|name| columns.get(name).map_or(name, String::as_str)).collect();
    let mut positions = table.columns_of(&names)?;
    let time = positions.remove(0);
    let mut found = vec![[f64::INFINITY, f64::NEG_INFINITY]; positions.len()];
    while table.next_row()? {
        let is_learned = table.number(time)? <= stop * (1.0 + 1e-9);
        for (position, [min, max]) in positions.iter().zip(&mut found).filter(|_| is_learned) {
            let value = table.number(*position)?;
            (*min, *max) = (min.min(value), max.max(value));
        }
    }
    for (state, [min, max]) in states.values_mut().zip(found) {
        state.min = if state.min.is_nan() { min } else { state.min };
        state.max = if state.max.is_nan() { max } else { state.max };
    }
    Ok(())
}

/// Makes names of the dotted keys of `[states]`: `rail.position = { ... }` is `"rail.position" = { ... }`, as it is in a mechanism file.
pub(in crate::study) fn join_names(root: &mut DeTable<'_>) {
    let Some(DeValue::Table(states)) = root.get_mut("states").map(Spanned::get_mut) else { return };
    let mut joined = DeTable::new();
    add_joined(std::mem::take(states), "", &mut joined);
    *states = joined;
}

fn add_joined<'a>(table: DeTable<'a>, prefix: &str, joined: &mut DeTable<'a>) {
    let is_table = |value: &Spanned<DeValue>| matches!(value.get_ref(), DeValue::Table(_));
    for (name, value) in table {
        let span = name.span();
        let name = format!("{prefix}{}", name.get_ref());
        let value_span = value.span();
        match value.into_inner() {
            // a coordinate has keys whose values are no tables
            DeValue::Table(inner) if !inner.is_empty() && inner.values().all(is_table) => {
                add_joined(inner, &format!("{name}."), joined);
            }
            value => {
                joined.insert(Spanned::new(span, Cow::Owned(name)), Spanned::new(value_span, value));
            }
        }
    }
}

/// Every mistake in `[states]`, by dotted key.
pub(in crate::study) fn problems(study: &Study) -> Problems {
    let mut problems = Problems::default();
    let of_table = study.source.is_recorded();
    for (name, StateOptions { min, max, start, velocity, velocity_range, periodic, unit: _, rate_of: _, rate: _ }) in
        &study.states
    {
        let key = format!("states.{name}");
        if of_table && (min.is_nan() || max.is_nan()) {
            continue;
        }
        let is_open = study.is_actuator_state(name) && min.is_nan() && max.is_nan();
        if is_open && start.is_none() {
            problems.add(&key, "expected `start`, or `min` and `max`: where runs begin");
        } else if !is_open && (min.is_nan() || max.is_nan()) {
            problems.add(&key, "expected `min` and `max`: the range in which the equations are learned");
            continue;
        }
        let [min, max] = if is_open { &[f64::MIN, f64::MAX] } else { &[*min, *max] };
        if !(min.is_finite() && max.is_finite() && min < max) {
            problems.add(&key, format!("range is empty or not finite: min {}, max {}", exact(*min), exact(*max)));
            continue;
        }
        if *periodic == Some(true) && !of_table && (max - min - TAU).abs() > 1e-6 {
            problems.add(format!("{key}.periodic"), format!("the range {} is not a turn of 2 pi", from_to(*min, *max)));
        }
        for (field, range) in [("start", start), ("velocity", velocity), ("velocity_range", velocity_range)] {
            let Some([low, high]) = range else { continue };
            if field == "velocity_range" && low == high {
                problems.add(format!("{key}.{field}"), format!("range is empty: {}", from_to(*low, *high)));
            } else if !(low.is_finite() && high.is_finite() && low <= high) {
                let expected = "expected two finite numbers, the second at least as large as the first";
                problems.add(format!("{key}.{field}"), format!("[{}, {}], {expected}", exact(*low), exact(*high)));
            } else if field == "start" && !(min <= low && high <= max) {
                let message = format!("{}, expected a part of the range {}", from_to(*low, *high), from_to(*min, *max));
                problems.add(format!("{key}.{field}"), message);
            }
        }
    }
    problems
}
