//! The `metafmu` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    metafmu::command(std::env::args_os(), None).into()
}
