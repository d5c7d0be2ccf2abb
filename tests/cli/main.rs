//! The command as a user meets it: results, error messages, exit codes.

mod fmus;
mod interruptions;
mod studies;

use std::{
    fs,
    io::{Read, Write},
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

/// A folder with a study that is sampled and trained in a moment.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: tempfile::tempdir().unwrap() };
        fs::write(bench.path("study.toml"), small_study()).unwrap();
        bench
    }

    /// A folder with the results of `metafmu build`.
    fn built() -> Self {
        let bench = Self::new();
        let output = bench.run(&["build", "study.toml"]);
        assert!(output.status.success(), "{}", stderr(&output));
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, arguments: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metafmu"));
        command.args(arguments).current_dir(self.folder.path()).output().unwrap()
    }

    /// Runs a command that must fail with exit code 2 and every piece of `says` in its error, and change no file.
    fn fails(&self, arguments: &[&str], says: &[&str]) {
        let before = snapshot(self.folder.path());
        let output = self.run(arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.starts_with("error: "), "{arguments:?}: {message}");
        assert!(!message.contains("panicked"), "{arguments:?}: {message}");
        for piece in says {
            assert!(message.contains(piece), "{arguments:?} should say `{piece}`: {message}");
        }
        assert!(output.stdout.is_empty(), "{arguments:?}: a failure prints no result");
        assert_eq!(snapshot(self.folder.path()), before, "{arguments:?}: files changed");
    }
}

/// The single pendulum with a coarse mesh and a tiny network.
fn small_study() -> String {
    let mut study = include_str!("../../examples/paper/single-pendulum.toml").to_owned();
    for (line, smaller) in [
        ("levels = 11", "levels = 3"),
        ("test_runs = 200", "test_runs = 5"),
        ("step = 0.01", "step = 0.05"),
        ("hidden = [128, 128]", "hidden = [8]"),
        ("epochs = 400", "epochs = 3"),
    ] {
        assert!(study.contains(line), "{line}");
        study = study.replace(line, smaller);
    }
    study + ANY
}

/// Accepts whatever so little training gives.
const ANY: &str = "\n[accept]\nr2 = -inf\nbaseline_factor = inf\nangle_error = inf\n";

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Every file below a folder with its bytes.
fn snapshot(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut files = Vec::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = fs::read(&path).unwrap();
                files.push((path, bytes));
            }
        }
    }
    files.sort();
    files
}

const FMU: &str = "out/single-pendulum/single-pendulum.fmu";
const MODEL: &str = "out/single-pendulum/single-pendulum.safetensors";

/// Runs a shell command in which `$0` is the program.
#[cfg(unix)]
fn shell(bench: &Bench, command: &str) -> Output {
    let mut shell = Command::new("sh");
    shell.args(["-c", command, env!("CARGO_BIN_EXE_metafmu")]).current_dir(bench.folder.path()).output().unwrap()
}
