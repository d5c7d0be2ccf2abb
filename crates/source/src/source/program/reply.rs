//! Requests to a program and its replies, each a line of JSON.

use crate::{
    Error,
    diagnostics::numbers::counted,
    source::{FailureCause, RunFailure},
    study::Study,
    table::Table,
};
use indexmap::IndexMap;
use serde::{
    Deserialize, Serialize,
    de::{DeserializeOwned, IgnoredAny},
};
use std::{
    fmt,
    path::{Path, PathBuf},
};

/// Number of characters of a line that a message shows.
const SHOWN: usize = 120;

/// Largest difference of a time in a file from that of a row, relative to the step between two rows.
const SAME_TIME: f64 = 1e-6;

/// A request.
#[derive(Debug, Serialize)]
#[serde(tag = "request", rename_all = "lowercase")]
pub(super) enum Request<'a> {
    /// For the description of the program.
    Describe { protocol: u32 },
    /// For the outputs of a run at some times.
    Run {
        parameters: IndexMap<&'a str, f64>,
        times: &'a [f64],
        /// At the start.
        #[serde(skip_serializing_if = "IndexMap::is_empty")]
        states: IndexMap<&'a str, f64>,
        /// At the times.
        #[serde(skip_serializing_if = "IndexMap::is_empty")]
        inputs: IndexMap<&'a str, Vec<f64>>,
        /// Inputs between two times: "hold" or "linear".
        #[serde(skip_serializing_if = "Option::is_none")]
        interpolation: Option<&'a str>,
        outputs: Vec<&'a str>,
    },
    /// For derivatives and outputs at some points.
    Equations {
        #[serde(skip)]
        points: usize,
        parameters: IndexMap<&'a str, Vec<f64>>,
        inputs: IndexMap<&'a str, Vec<f64>>,
        states: IndexMap<&'a str, Vec<f64>>,
        outputs: Vec<&'a str>,
        /// `true` if the mass matrix is wanted.
        #[serde(skip_serializing_if = "std::ops::Not::not")]
        mass: bool,
    },
}

/// Values by name; none where they are not finite.
type NamedValues = IndexMap<String, Vec<Option<f64>>>;

/// A reply to [`Request::Run`] or [`Request::Equations`].
#[derive(Debug, Deserialize)]
pub(super) struct ProgramReply {
    id: Option<u64>,
    error: Option<String>,
    outputs: Option<NamedValues>,
    derivatives: Option<NamedValues>,
    /// Rows by the rate of their coordinate, each with its columns.
    mass: Option<IndexMap<String, NamedValues>>,
    file: Option<PathBuf>,
}

/// Reason why a reply of a program has no results.
#[derive(Debug)]
pub(super) enum ReplyError {
    /// The program reports that it failed, with its own message.
    Reported(String),
    /// A line that is no reply.
    Line {
        /// Beginning of the line.
        line: String,
        /// Wrong shape of the JSON; none if the line is no JSON.
        shape: Option<serde_json::Error>,
    },
    /// A reply that lacks a value, or is one to another request: the value or number that is found, and the expected one.
    Mismatch(String),
    /// A value that is not finite.
    NotFinite {
        /// Column of the value, such as "output `x`".
        column: String,
        /// Time or point of the value.
        place: String,
    },
    /// The file of a run.
    File(Error),
}

impl fmt::Display for ReplyError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Reported(message) | Self::Mismatch(message) => f.write_str(message),
            Self::Line { line, shape: None } => {
                let expected = "expected a reply in JSON: print everything else to standard error";
                write!(f, "the program printed `{line}` to standard output, {expected}")
            }
            Self::Line { line, shape: Some(error) } => write!(f, "the reply `{line}` has a wrong shape: {error}"),
            Self::NotFinite { column, place } => write!(f, "{column} is not finite at {place}"),
            Self::File(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for ReplyError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Line { shape: Some(error), .. } => Some(error),
            Self::File(error) => Some(error),
            Self::Line { shape: None, .. } | Self::Reported(_) | Self::Mismatch(_) | Self::NotFinite { .. } => None,
        }
    }
}

impl From<ReplyError> for RunFailure {
    fn from(error: ReplyError) -> Self {
        let cause = match error {
            ReplyError::Reported(_) | ReplyError::NotFinite { .. } | ReplyError::File(_) => FailureCause::Model,
            ReplyError::Line { .. } | ReplyError::Mismatch(_) => FailureCause::Process,
        };
        Self::new(cause, error.to_string())
    }
}

/// Reads the reply to the request of a number.
///
/// # Errors
/// Those of [`from_json`] and [`check_id`], or the program's own message.
pub(super) fn parse(line: &[u8], id: u64) -> Result<ProgramReply, ReplyError> {
    let reply: ProgramReply = from_json(line)?;
    check_id(reply.id, id)?;
    match reply.error {
        Some(message) => Err(ReplyError::Reported(message)),
        None => Ok(reply),
    }
}

/// Reads a line of JSON, in which numbers may be `NaN` or `Infinity` as some programs write them.
///
/// # Errors
/// [`ReplyError::Line`].
pub(super) fn from_json<T: DeserializeOwned>(line: &[u8]) -> Result<T, ReplyError> {
    let error = match serde_json::from_slice(line) {
        Ok(reply) => return Ok(reply),
        Err(error) => error,
    };
    let finite = without_nan(line);
    if let Ok(reply) = serde_json::from_slice(&finite) {
        return Ok(reply);
    }
    let is_json = serde_json::from_slice::<IgnoredAny>(&finite).is_ok();
    Err(ReplyError::Line { line: shown(line), shape: is_json.then_some(error) })
}

/// Compares the number of a reply with that of the request.
pub(super) fn check_id(found: Option<u64>, expected: u64) -> Result<(), ReplyError> {
    let message = match found {
        Some(found) if found == expected => return Ok(()),
        Some(found) => format!("the reply has `id` {found}, expected {expected}, that of the request"),
        None => format!("the reply has no `id`, expected {expected}, that of the request"),
    };
    Err(ReplyError::Mismatch(message))
}

impl ProgramReply {
    /// Outputs of a run, row by row, in the study's order; `folder` is that of relative paths.
    pub(super) fn run(&self, study: &Study, times: &[f64], folder: &Path) -> Result<Vec<f64>, ReplyError> {
        let columns = match (&self.outputs, &self.file) {
            (Some(outputs), _) => {
                let place = |row: usize| format!("{} s", times.get(row).copied().unwrap_or_default());
                let request = RequestedColumns { what: "output", count: times.len(), place: &place };
                request.find_in(outputs, study.outputs.keys())?
            }
            (None, Some(file)) => {
                return rows_of(&folder.join(file), study, times).map_err(ReplyError::File);
            }
            (None, None) => {
                let message = "the reply has no `outputs`, expected `outputs`, `file` or `error`";
                return Err(ReplyError::Mismatch(message.into()));
            }
        };
        Ok(rows(&columns, times.len()))
    }

    /// Derivatives, then outputs, then the lower triangle of the mass matrix if the study needs it, for each point.
    pub(super) fn equations(&self, study: &Study, points: usize) -> Result<Vec<f64>, ReplyError> {
        let place = |point: usize| format!("point {point}");
        let derivatives = required(self.derivatives.as_ref(), "the reply has no `derivatives`")?;
        let of_states = RequestedColumns { what: "derivative", count: points, place: &place };
        let mut columns = of_states.find_in(derivatives, study.states.keys())?;
        let outputs = required(self.outputs.as_ref(), "the reply has no `outputs`")?;
        let of_outputs = RequestedColumns { what: "output", count: points, place: &place };
        columns.extend(of_outputs.find_in(outputs, study.outputs.keys())?);
        if study.has_mass_matrix() {
            let without = "the reply has no `mass`, expected the mass matrix for states with `rate_of`";
            let mass = required(self.mass.as_ref(), without)?;
            let rates = study.states.keys().skip(study.states.len() / 2);
            for (count, row) in (1..).zip(rates.clone()) {
                let columns_of_row = required(mass.get(row), &format!("`mass` has no row `{row}`"))?;
                let what = format!("`mass` of `{row}`, column");
                let of_row = RequestedColumns { what: &what, count: points, place: &place };
                columns.extend(of_row.find_in(columns_of_row, rates.clone().take(count))?);
            }
        }
        Ok(rows(&columns, points))
    }
}

/// A value that a reply must have; `without`: the message if it has not.
fn required<'a, T>(value: Option<&'a T>, without: &str) -> Result<&'a T, ReplyError> {
    value.ok_or_else(|| ReplyError::Mismatch(without.to_owned()))
}

/// Columns that a request is for.
struct RequestedColumns<'a> {
    /// Kind of each column, for messages.
    what: &'a str,
    /// Number of values of each column.
    count: usize,
    /// Place of a value of a column, for messages.
    place: &'a dyn Fn(usize) -> String,
}

impl RequestedColumns<'_> {
    /// The columns of these names, each of finite values.
    fn find_in<'n>(
        &self,
        columns: &NamedValues,
        names: impl Iterator<Item = &'n String>,
    ) -> Result<Vec<Vec<f64>>, ReplyError> {
        names.map(|name| self.column(columns, name)).collect()
    }

    fn column(&self, columns: &NamedValues, name: &str) -> Result<Vec<f64>, ReplyError> {
        let Self { what, count, place } = self;
        let column = format!("{what} `{name}`");
        let values = required(columns.get(name), &format!("the reply has no {column}"))?;
        if values.len() != *count {
            return Err(ReplyError::Mismatch(format!("{column} has {} values, expected {count}", values.len())));
        }
        let finite: Vec<f64> = values.iter().map_while(|value| value.filter(|value| value.is_finite())).collect();
        if finite.len() < values.len() {
            return Err(ReplyError::NotFinite { column, place: place(finite.len()) });
        }
        Ok(finite)
    }
}

fn rows(columns: &[Vec<f64>], count: usize) -> Vec<f64> {
    (0..count).flat_map(|row| columns.iter().filter_map(move |column| column.get(row).copied())).collect()
}

/// Outputs in a file with a column `time` and one for each output, row by row.
///
/// # Errors
/// [`Error::Table`] with the place of what is wrong, and those of [`Table::open`].
pub(super) fn rows_of(path: &Path, study: &Study, times: &[f64]) -> crate::Result<Vec<f64>> {
    let mut table = Table::open(path)?;
    let names: Vec<&str> = ["time"].into_iter().chain(study.outputs.keys().map(String::as_str)).collect();
    let mut columns = table.columns_of(&names)?;
    let time = columns.remove(0);
    let units = study.outputs.values().map(|output| output.unit.as_deref());
    table.check_units(columns.iter().copied().zip(units))?;
    let (mut values, mut row) = (Vec::with_capacity(times.len() * columns.len()), 0);
    while table.next_row()? {
        let now = table.number(time)?;
        match times.get(row) {
            Some(expected) if (now - expected).abs() <= SAME_TIME * study.time.step => {}
            Some(expected) => return Err(table.mistake(&format!("column `time`: {now}, expected {expected}"))),
            None => return Err(table.mistake(&format!("a row after the last one, expected {}", times.len()))),
        }
        for &column in &columns {
            values.push(table.number(column)?);
        }
        row += 1;
    }
    if row < times.len() {
        return Err(table.mistake(&format!("{}, expected {}", counted(row, "row"), times.len())));
    }
    Ok(values)
}

/// The beginning of a line as text.
fn shown(line: &[u8]) -> String {
    let text = String::from_utf8_lossy(&line[..line.len().min(4 * SHOWN)]);
    let text = text.trim_end().replace(char::is_control, " ");
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text,
    }
}

/// JSON with `null` where numbers are `NaN`, `Infinity` or `-Infinity`.
fn without_nan(line: &[u8]) -> Vec<u8> {
    let (mut cleaned, mut place, mut is_text) = (Vec::with_capacity(line.len()), 0, false);
    while let Some(&byte) = line.get(place) {
        let rest = &line[place..];
        let token = [&b"NaN"[..], b"Infinity", b"-Infinity"].into_iter().find(|token| rest.starts_with(token));
        match (is_text, token) {
            (false, Some(token)) => {
                cleaned.extend_from_slice(b"null");
                place += token.len();
                continue;
            }
            (true, _) if byte == b'\\' => {
                cleaned.extend_from_slice(&rest[..rest.len().min(2)]);
                place += 2;
                continue;
            }
            _ => {}
        }
        is_text ^= byte == b'"';
        cleaned.push(byte);
        place += 1;
    }
    cleaned
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    const STUDY: &str = "name = \"s\"\n[source]\ncommand = [\"python\", \"model.py\"]\n[time]\nstop = 1\nstep = 0.5\n[parameters]\n\
        p = { min = 0, max = 1 }\n[outputs]\nx = { unit = \"m\" }\ny = {}\n[sampling]\nmethod = \"sobol\"\nruns = 2\n";

    fn run(line: &str) -> Result<Vec<f64>, ReplyError> {
        let study = Study::parse(STUDY, Path::new("s.toml")).unwrap();
        parse(line.as_bytes(), 3)?.run(&study, &study.time.grid(), Path::new(""))
    }

    #[test]
    fn outputs_become_rows_in_the_order_of_the_study() {
        let line = r#"{"id": 3, "outputs": {"y": [4, 5, 6], "x": [1, 2.5, 3], "z": []}}"#;
        assert_eq!(run(line).unwrap(), [1.0, 4.0, 2.5, 5.0, 3.0, 6.0]);
    }

    #[test]
    fn a_wrong_reply_is_shown() {
        for (line, says) in [
            ("step 1 of 10", "the program printed `step 1 of 10` to standard output, expected a reply in JSON"),
            (r#"{"id": 3, "outputs": {"x": 1}}"#, "has a wrong shape: invalid type: integer `1`, expected a sequence"),
            ("7", "the reply `7` has a wrong shape: invalid type: integer `7`"),
            (r#"{"id": 2, "outputs": {}}"#, "the reply has `id` 2, expected 3, that of the request"),
            (r#"{"outputs": {}}"#, "the reply has no `id`, expected 3"),
            (r#"{"id": 3}"#, "expected `outputs`, `file` or `error`"),
            (r#"{"id": 3, "outputs": {"x": [1, 2, 3]}}"#, "the reply has no output `y`"),
            (r#"{"id": 3, "outputs": {"x": [1, 2], "y": [1]}}"#, "output `x` has 2 values, expected 3"),
            (r#"{"id": 3, "outputs": {"x": [1, NaN, -Infinity], "y": [1]}}"#, "output `x` is not finite at 0.5 s"),
            (r#"{"id": 3, "error": "NaN \" in the \\"}"#, "NaN \" in the \\"),
            (r#"{"id": 3, "file": "none.csv"}"#, "none.csv"),
        ] {
            let message = run(line).unwrap_err().to_string();
            assert!(message.contains(says), "{line}: {message}");
        }
        let message = run(&"x".repeat(500)).unwrap_err().to_string();
        assert!(message.len() < 300, "{message}");
    }

    #[test]
    fn a_reply_that_breaks_the_protocol_is_no_failure_of_the_model() {
        for (line, cause) in [
            (r#"{"id": 3, "error": "too long"}"#, FailureCause::Model),
            (r#"{"id": 3, "outputs": {"x": [1, NaN, 2], "y": [1, 2, 3]}}"#, FailureCause::Model),
            (r#"{"id": 3, "outputs": {"x": [1, 2, 3]}}"#, FailureCause::Process),
            (r#"{"id": 2}"#, FailureCause::Process),
            ("step 1 of 10", FailureCause::Process),
            ("7", FailureCause::Process),
        ] {
            assert_eq!(RunFailure::from(run(line).unwrap_err()).cause, cause, "{line}");
        }
    }

    #[test]
    fn a_file_has_the_rows_of_the_study() {
        let folder = tempfile::tempdir().unwrap();
        let study = Study::parse(STUDY, &folder.path().join("s.toml")).unwrap();
        let path = folder.path().join("rows.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            rows_of(&path, &study, &study.time.grid())
        };
        assert_eq!(read("y,time,x [m]\n4,0,1\n5,0.5,2\n6,1,3\n").unwrap(), [1.0, 4.0, 2.0, 5.0, 3.0, 6.0]);
        for (text, says) in [
            ("time,x\n0,1\n", "no column `y`"),
            ("time,x [mm],y\n0,1,2\n", "mm"),
            ("time,x,y\n0,1,2\n0.4,1,2\n", "rows.csv:3: column `time`: 0.4, expected 0.5"),
            ("time,x,y\n0,1,2\n0.5,1,2\n", "2 rows, expected 3"),
            ("time,x,y\n0,1,2\n0.5,1,2\n1,1,2\n1.5,1,2\n", "rows.csv:5: a row after the last one, expected 3"),
            ("time,x,y\n0,1,nan\n", "rows.csv:2: column `y`"),
        ] {
            let message = read(text).unwrap_err().to_string();
            assert!(message.contains(says), "{text}: {message}");
        }
    }
}
