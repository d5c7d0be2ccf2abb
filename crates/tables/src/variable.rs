//! Named quantities, with their units and meanings, and the data that they are matched with by name.

use crate::diagnostics::names::{self, NameMatch, closest, expected_one_of, listed};
use std::fmt;

/// A named quantity of a source: a parameter or an output column of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct SourceVariable {
    /// Name, as the study and the FMU show it.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One sentence for people.
    pub description: String,
    /// Value of a parameter before a host sets one, in the FMU it is taken from.
    pub start: Option<f64>,
}

impl SourceVariable {
    /// A quantity that is from no FMU.
    pub fn new(name: &str, unit: &str, description: &str) -> Self {
        Self { name: name.into(), unit: unit.into(), description: description.into(), start: None }
    }
}

/// Value that a variable has where data lack it, as `--default` gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct DefaultValue {
    /// Name of the variable.
    pub name: String,
    /// The value; none for the start value.
    pub value: Option<f64>,
}

/// Text of a default value that is not a finite number.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a finite number, expected NAME or NAME=VALUE")]
pub struct DefaultValueError(pub String);

impl DefaultValue {
    /// Parses `NAME` or `NAME=VALUE`.
    ///
    /// # Errors
    /// [`DefaultValueError`] if the value is not a finite number.
    pub fn parse(text: &str) -> Result<Self, DefaultValueError> {
        let Some((name, value)) = text.rsplit_once('=') else {
            return Ok(Self { name: text.trim().to_owned(), value: None });
        };
        let number = value.trim().parse().ok().filter(|number: &f64| number.is_finite());
        let number = number.ok_or_else(|| DefaultValueError(value.to_owned()))?;
        Ok(Self { name: name.trim().to_owned(), value: Some(number) })
    }

    /// Message for a variable that does not exist.
    pub fn unknown(&self, known: &[&str]) -> String {
        format!("--default {}: no such variable, {}", self.name, expected_one_of(&self.name, known))
    }

    /// Message for a variable whose values only data have.
    fn impossible(&self) -> String {
        let name = &self.name;
        format!("--default {name}: found a default value, expected a column `{name}`: it differs from row to row")
    }
}

/// Option of a command that gives a variable its start value, or another one if it has none.
pub fn option_for(name: &str, start: Option<f64>) -> String {
    let is_plain = name.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '.' | '-'));
    let value = start.map_or("VALUE".into(), |start| format!("{:?}", readable(start)));
    let text = format!("{name}={value}");
    if is_plain { format!("--default {text}") } else { format!("--default '{text}'") }
}

/// A number without the rounding errors of its last digits.
fn readable(number: f64) -> f64 {
    format!("{number:.12e}").parse().unwrap_or(number)
}

/// A variable whose values are wanted.
#[derive(Clone, Copy, Debug)]
pub struct WantedVariable<'a> {
    /// Name of the variable, and of its column.
    pub name: &'a str,
    /// Unit; empty for a dimensionless quantity.
    pub unit: &'a str,
    /// Start value, if it has one.
    pub start: Option<f64>,
    /// Importance of its data.
    pub need: Need,
}

/// Importance of the data of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// Nothing can replace them.
    Data,
    /// They are needed unless a default value is requested.
    DataOrDefault,
    /// The start value serves, unless data that nothing uses could be meant.
    Any,
}

/// Variables matched with the columns of data.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MatchedVariables {
    /// Column of each variable; none where its value is constant.
    pub columns: Vec<Option<usize>>,
    /// Value of each variable without a column; NaN for those with one.
    pub values: Vec<f64>,
    /// Lines about start values and columns that are not used.
    pub notes: Vec<String>,
    /// Lines about default values that an unused column was perhaps meant for.
    pub doubts: Vec<String>,
}

/// Reasons why variables do not match the columns of data.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VariableMatchError {
    /// Message for all variables that lack data, then a message for each default value that cannot be used.
    pub problems: Vec<String>,
}

impl fmt::Display for VariableMatchError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.problems.join("; "))
    }
}

impl std::error::Error for VariableMatchError {}

/// Matches variables with the columns of data by name. Columns in `other` have a meaning that is none of these variables.
///
/// # Errors
/// [`VariableMatchError`] with all variables that lack data, each with the closest unused column, and with default values of
/// unknown variables.
pub fn match_variables(
    wanted: &[WantedVariable],
    columns: &[&str],
    other: &[&str],
    defaults: &[DefaultValue],
) -> Result<MatchedVariables, VariableMatchError> {
    let names: Vec<&str> = wanted.iter().map(|variable| variable.name).collect();
    let NameMatch { positions, unused } = NameMatch::of(&names, columns);
    let unused: Vec<&str> =
        unused.into_iter().map(|column| columns[column]).filter(|name| !other.contains(name)).collect();
    let (mut found, mut missing) = (MatchedVariables { columns: positions, ..Default::default() }, Vec::new());
    let (mut constants, mut doubtful) = (Vec::new(), Vec::new());
    for (variable, column) in wanted.iter().zip(&found.columns) {
        let WantedVariable { name, unit, start, need } = variable;
        let default = defaults.iter().rev().find(|default| default.name == *name).filter(|_| *need != Need::Data);
        let value = default.and_then(|default| default.value).or(*start);
        found.values.push(if column.is_some() { f64::NAN } else { value.unwrap_or(f64::NAN) });
        if column.is_some() {
            if let Some(DefaultValue { value: Some(value), .. }) = default {
                found.doubts.push(format!("`{name}` has a column, and its default value {value:?} is not used"));
            }
            continue;
        }
        match (need, default, value) {
            (Need::Any, None, _) if !unused.is_empty() => doubtful.push(variable),
            (Need::Any, ..) | (_, Some(_), Some(_)) => {}
            _ => missing.push(variable),
        }
        let space = if unit.is_empty() { "" } else { " " };
        constants.push(format!("{name} = {:?}{space}{unit}", readable(value.unwrap_or(f64::NAN))));
        if default.is_some()
            && let Some(meant) = closest(name, unused.iter().copied())
        {
            found.doubts.push(format!("`{name}` has its default value, and the column `{meant}` is not used"));
        }
    }
    // an unused column is more likely one that is needed
    let is_alone = missing.is_empty();
    missing.extend(
        doubtful.into_iter().filter(|variable| is_alone || closest(variable.name, unused.iter().copied()).is_some()),
    );
    let mut problems: Vec<String> = lacking(&missing, columns, &unused).into_iter().collect();
    problems.extend(mistaken_defaults(wanted, defaults));
    problems.extend(contradictions(defaults));
    if !problems.is_empty() {
        return Err(VariableMatchError { problems });
    }
    if !constants.is_empty() {
        let constants: Vec<&str> = constants.iter().map(String::as_str).collect();
        found.notes.push(format!("constant, without a column: {}", listed(&constants)));
    }
    if !unused.is_empty() {
        found.notes.push(format!("columns that are not used: {}", listed(&unused)));
    }
    Ok(found)
}

/// Messages for default values of variables that are unknown or need data.
fn mistaken_defaults(wanted: &[WantedVariable], defaults: &[DefaultValue]) -> Vec<String> {
    let (need_data, can_have_default): (Vec<&WantedVariable>, Vec<&WantedVariable>) =
        wanted.iter().partition(|variable| variable.need == Need::Data);
    let can_have_default: Vec<&str> = can_have_default.iter().map(|variable| variable.name).collect();
    let impossible = defaults.iter().filter(|default| need_data.iter().any(|variable| variable.name == default.name));
    let unknown = defaults.iter().filter(|default| wanted.iter().all(|variable| variable.name != default.name));
    let unknown = unknown.map(|default| default.unknown(&can_have_default));
    impossible.map(DefaultValue::impossible).chain(unknown).collect()
}

/// Messages for variables with two different default values.
fn contradictions(defaults: &[DefaultValue]) -> Vec<String> {
    let mut messages = Vec::new();
    for (position, default) in defaults.iter().enumerate() {
        if defaults[..position].iter().any(|earlier| earlier.name == default.name && earlier != default) {
            messages.push(format!("`{}` has two default values", default.name));
        }
    }
    messages
}

/// Message for variables that lack data: what is missing, what is not used, and the default values.
fn lacking(missing: &[&WantedVariable], columns: &[&str], unused: &[&str]) -> Option<String> {
    let names: Vec<&str> = missing.iter().map(|variable| variable.name).collect();
    let mut message = names::missing("column", &names, columns, unused)?;
    let can_have_default = missing.iter().filter(|variable| variable.need != Need::Data);
    let options: Vec<String> = can_have_default.map(|variable| option_for(variable.name, variable.start)).collect();
    let unused = (!unused.is_empty()).then(|| format!("Not used: {}", listed(unused)));
    let constants = (!options.is_empty()).then(|| format!("For constants: {}", options.join(" ")));
    for sentence in unused.into_iter().chain(constants) {
        message += if message.ends_with('?') { " " } else { ". " };
        message += &sentence;
    }
    Some(message)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wanted<'a>(name: &'a str, need: Need) -> WantedVariable<'a> {
        WantedVariable { name, unit: "m", start: Some(0.5), need }
    }

    fn default(text: &str) -> DefaultValue {
        DefaultValue::parse(text).unwrap()
    }

    #[test]
    fn data_that_are_missing_are_one_error_unless_defaults_are_asked_for() {
        let variables = [
            wanted("time", Need::Data),
            wanted("L", Need::DataOrDefault),
            wanted("force", Need::DataOrDefault),
            wanted("x_start", Need::Any),
        ];
        let matched =
            |columns: &[&str], defaults: &[DefaultValue]| match_variables(&variables, columns, &["run"], defaults);
        let found = matched(&["force", "time", "run", "L"], &[]).unwrap();
        assert_eq!(found.columns, [Some(1), Some(3), Some(0), None]);
        assert_eq!(
            (found.values[3], found.notes),
            (0.5, vec!["constant, without a column: x_start = 0.5 m".to_owned()])
        );
        // a column that nothing uses may be meant
        assert_eq!(
            matched(&["t", "l", "force"], &[]).unwrap_err().to_string(),
            "no columns `time`, `L`, expected them among t, l, force; did you mean `l` for `L`? Not used: t, l. \
             For constants: --default L=0.5"
        );
        assert_eq!(
            matched(&["time", "L", "force", "x0"], &[]).unwrap_err().to_string(),
            "no column `x_start`, expected it among time, L, force, x0. Not used: x0. For constants: --default x_start=0.5"
        );
        let found = matched(&["time", "l", "force"], &[default("L"), default("x_start = -2")]).unwrap();
        assert_eq!((found.values[1], found.values[3]), (0.5, -2.0));
        assert_eq!(found.doubts, ["`L` has its default value, and the column `l` is not used"]);
        assert_eq!(found.notes[1], "columns that are not used: l");
        let found = matched(&["time", "L", "force"], &[default("L=2"), default("force")]).unwrap();
        assert_eq!(found.doubts, ["`L` has a column, and its default value 2.0 is not used"]);
        let message = matched(&["time", "force"], &[default("L=2"), default("L=3")]).unwrap_err().to_string();
        assert_eq!(message, "`L` has two default values");
        let message = matched(&["time", "L", "force"], &[default("forse=1"), default("time")]).unwrap_err().to_string();
        assert!(message.contains("--default forse: no such variable") && message.ends_with("did you mean `force`?"));
        let message = matched(&["L", "force"], &[default("time=1")]).unwrap_err().to_string();
        assert!(message.starts_with("no column `time`") && message.contains("--default time: found"), "{message}");
    }

    #[test]
    fn values_that_only_data_have_take_no_default() {
        let variables = [wanted("time", Need::Data), wanted("force", Need::DataOrDefault)];
        assert_eq!(
            match_variables(&variables, &["time", "force"], &[], &[default("time")]).unwrap_err().to_string(),
            "--default time: found a default value, expected a column `time`: it differs from row to row"
        );
    }

    #[test]
    fn a_default_is_a_name_with_or_without_a_number() {
        assert_eq!(default("a=b=1e3"), DefaultValue { name: "a=b".into(), value: Some(1000.0) });
        assert!(DefaultValue::parse("a=nan").is_err() && DefaultValue::parse("a=").is_err());
        assert_eq!(option_for("L", Some(0.5 * (0.1 + 0.2))), "--default L=0.15");
        let nameless = [WantedVariable { start: None, ..wanted("x[1] 2", Need::DataOrDefault) }];
        let message = match_variables(&nameless, &[], &[], &[]).unwrap_err().to_string();
        assert!(message.ends_with("For constants: --default 'x[1] 2=VALUE'"), "{message}");
    }
}
