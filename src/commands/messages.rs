//! Messages of the command on standard error: progress, notes, warnings and errors, with their verbosity and color.

use crate::cli::GlobalArgs;
use anstream::AutoStream;
use anstyle::AnsiColor;
use clap::ColorChoice;
use metafmu::{
    evaluation::{Grade, Verdict},
    reading,
};
use std::{
    borrow::Cow,
    fmt::Display,
    io::Write,
    path::Path,
    sync::atomic::{AtomicU8, Ordering},
};

/// Verbosity of the messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verbosity {
    /// Warnings and errors.
    Quiet,
    /// Progress and notes as well.
    Normal,
    /// On a terminal also the notes that replace a progress bar elsewhere.
    Verbose,
}

static VERBOSITY: AtomicU8 = AtomicU8::new(Verbosity::Normal as u8);

/// Sets verbosity and color for this process.
pub fn set(arguments: GlobalArgs) {
    let verbosity = match arguments {
        GlobalArgs { quiet: true, .. } => Verbosity::Quiet,
        GlobalArgs { verbose: true, .. } => Verbosity::Verbose,
        _ => Verbosity::Normal,
    };
    VERBOSITY.store(verbosity as u8, Ordering::Relaxed);
    let choice = match arguments.color {
        ColorChoice::Auto => anstream::ColorChoice::Auto,
        ColorChoice::Always => anstream::ColorChoice::Always,
        ColorChoice::Never => anstream::ColorChoice::Never,
    };
    choice.write_global();
}

/// The verbosity of this process.
pub fn verbosity() -> Verbosity {
    match VERBOSITY.load(Ordering::Relaxed) {
        0 => Verbosity::Quiet,
        1 => Verbosity::Normal,
        _ => Verbosity::Verbose,
    }
}

/// Writes a note, unless `--quiet` was given.
pub fn say(line: impl Display) {
    if verbosity() > Verbosity::Quiet {
        line.to_string().lines().for_each(heard);
    }
}

/// Writes a note before a pipe or device is read, which may take until its writer ends.
pub fn say_stream(path: &Path) {
    if reading::is_stream(path) {
        say(format_args!("{}: reading a pipe or device up to its end", path.display()));
    }
}

/// Writes a warning.
pub fn warn(line: impl Display) {
    labeled("warning", AnsiColor::Yellow, &line.to_string());
}

/// Writes an error, each of its lines with the label.
pub fn complain(error: impl Display) {
    for line in error.to_string().lines() {
        labeled("error", AnsiColor::Red, line);
    }
}

/// Writes a line of an FMU or program, or one that counts even with `--quiet`. A closed stderr (`2>&1 | head`) does not stop the program.
pub fn heard(line: &str) {
    let _ = writeln!(std::io::stderr(), "{}", visible(line));
}

fn labeled(label: &str, color: AnsiColor, line: &str) {
    let style = color.on_default().bold();
    let _ = writeln!(anstream::stderr(), "{style}{label}:{style:#} {}", visible(line));
}

/// A verdict for standard output, with its grade in color where stdout has colors.
pub fn graded(verdict: &Verdict) -> String {
    let text = verdict.text();
    let color = match verdict.grade {
        Grade::Good => AnsiColor::Green,
        Grade::Usable => AnsiColor::Yellow,
        Grade::Rejected => AnsiColor::Red,
    };
    let grade = verdict.title().split([':', ',']).next().unwrap_or_default();
    if AutoStream::choice(&std::io::stdout()) == anstream::ColorChoice::Never {
        return visible(&text).into_owned();
    }
    let style = color.on_default().bold();
    visible(&text).replacen(grade, &format!("{style}{grade}{style:#}"), 1)
}

/// Text of third-party names and messages that is safe for a terminal: control characters are escaped as in JSON,
/// except line breaks and tabs.
pub fn visible(text: &str) -> Cow<'_, str> {
    let hidden = |c: char| c.is_control() && !matches!(c, '\n' | '\t');
    if !text.contains(hidden) {
        return text.into();
    }
    let mut visible = String::with_capacity(text.len());
    for c in text.chars() {
        if hidden(c) {
            visible.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            visible.push(c);
        }
    }
    visible.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_of_others_are_shown_and_not_sent_to_the_terminal() {
        assert_eq!(
            visible("a \u{1b}[2J\u{9b}31m\r\u{7}b\n\tc\u{7f} é"),
            "a \\u001b[2J\\u009b31m\\u000d\\u0007b\n\tc\\u007f é"
        );
        assert!(matches!(visible("one\ntwo\tthree"), Cow::Borrowed(_)));
    }
}
