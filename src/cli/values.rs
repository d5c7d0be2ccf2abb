//! Values of options: the text of the command line, read or refused.

use metafmu::table::writer::{Format, TableExtensionError};
use std::{fmt, path::PathBuf, time::Duration};

pub fn table_file(text: &str) -> Result<(PathBuf, Format), TableExtensionError> {
    let path = PathBuf::from(text);
    Format::of(&path).map(|format| (path, format))
}

pub fn name_and_value(text: &str) -> Result<(String, f64), ValueError> {
    let (name, value) = text.rsplit_once('=').ok_or(ValueError::Unexpected { expected: "NAME=VALUE" })?;
    let number = value.trim().parse().map_err(|_| ValueError::NotANumber(value.to_owned()))?;
    Ok((name.trim().to_owned(), number))
}

pub fn duration(text: &str) -> Result<Duration, ValueError> {
    let seconds = text.parse().ok().filter(|seconds| *seconds > 0.0);
    let duration = seconds.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
    duration.ok_or(ValueError::Unexpected { expected: "a positive number of seconds" })
}

pub fn tolerance(text: &str) -> Result<f64, ValueError> {
    let number = text.parse().ok().filter(|number| (1e-13..=0.1).contains(number));
    number.ok_or(ValueError::Unexpected { expected: "a number from 1e-13 to 0.1" })
}

pub fn share(text: &str) -> Result<f64, ValueError> {
    let number = text.parse().ok().filter(|number: &f64| number.is_finite() && *number >= 0.0);
    number.ok_or(ValueError::Unexpected { expected: "0 or a positive number" })
}

pub fn svg_file(text: &str) -> Result<PathBuf, ValueError> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(extension) if !extension.eq_ignore_ascii_case("svg") => Err(ValueError::PlotExtension),
        _ => Ok(path),
    }
}

pub fn tuple_and_file(text: &str) -> Result<(String, PathBuf), ValueError> {
    let (tuple, file) = text.split_once('=').ok_or(ValueError::Unexpected { expected: "TUPLE=FILE" })?;
    Ok((tuple.trim().to_owned(), PathBuf::from(file)))
}

/// Reason why the value of an option is refused; clap puts the option and the value in front.
#[derive(Debug)]
pub enum ValueError {
    /// The value has another form, or is outside of the range.
    Unexpected { expected: &'static str },
    /// Text in place of the number in `NAME=VALUE`.
    NotANumber(String),
    /// Name of a plot's file that ends in the extension of another format.
    PlotExtension,
}

impl fmt::Display for ValueError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unexpected { expected } => write!(f, "expected {expected}"),
            Self::NotANumber(text) => write!(f, "`{text}` is not a number"),
            Self::PlotExtension => {
                f.write_str("plots are SVG, which every browser opens: expected a file that ends in .svg")
            }
        }
    }
}

impl std::error::Error for ValueError {}
