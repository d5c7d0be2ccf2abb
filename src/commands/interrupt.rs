//! Ctrl-C: the first one stops the running stage, the second one ends the program.

use super::messages::{complain, heard};
use metafmu::diagnostics::interruption::Interruption;
use std::{
    ffi::OsString,
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

/// Arguments of this command.
static ARGUMENTS: OnceLock<Vec<OsString>> = OnceLock::new();
/// `true` for commands that the option --resume continues.
static CAN_RESUME: AtomicBool = AtomicBool::new(false);

/// Turns true at the first Ctrl-C. A stage that it has stopped may clear it and leave the rest to be done; a second
/// Ctrl-C ends the program in any case.
pub fn flag() -> &'static AtomicBool {
    static STOP: AtomicBool = AtomicBool::new(false);
    static PRESSED: AtomicBool = AtomicBool::new(false);
    static HANDLER: OnceLock<()> = OnceLock::new();
    HANDLER.get_or_init(|| {
        let handler = || {
            STOP.store(true, Ordering::Relaxed);
            if PRESSED.swap(true, Ordering::Relaxed) {
                if CAN_RESUME.load(Ordering::Relaxed) {
                    complain("stopped at once by a second Ctrl-C; complete files are kept");
                    heard(&remedy());
                }
                std::process::exit(130);
            }
        };
        // without a handler Ctrl-C ends the program at once, which is safe too: files are written whole
        let _ = ctrlc::set_handler(handler);
    });
    &STOP
}

/// Keeps the arguments of this command, the first of which is the program's name.
pub fn set_arguments(arguments: &[OsString]) {
    let _ = ARGUMENTS.set(arguments.to_vec());
}

/// Says that the option --resume continues this command after it was stopped.
pub fn can_resume() {
    CAN_RESUME.store(true, Ordering::Relaxed);
}

/// Last lines of a build that Ctrl-C ended or shortened.
pub fn conclude(interruption: &Interruption) {
    let text = interruption.to_string();
    let (first, rest) = text.split_once('\n').unwrap_or((&text, ""));
    complain(first);
    rest.lines().for_each(heard);
    heard(&remedy());
}

/// Line with the command that continues.
fn remedy() -> String {
    let arguments = ARGUMENTS.get().map_or(&[][..], |arguments| arguments.get(1..).unwrap_or_default());
    let mut words: Vec<String> = arguments.iter().map(|argument| shell_word(&argument.to_string_lossy())).collect();
    if words.iter().all(|word| word != "--resume") {
        words.push("--resume".into());
    }
    format!("continue with: metafmu {}", words.join(" "))
}

/// An argument as a shell reads it.
fn shell_word(text: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "_-./\\:=,+@%".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_quoted_where_a_shell_divides_them() {
        for (text, expected) in
            [("a/b.toml", "a/b.toml"), ("my study", "'my study'"), ("", "''"), ("it's", r"'it'\''s'")]
        {
            assert_eq!(shell_word(text), expected);
        }
    }
}
