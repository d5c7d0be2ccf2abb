//! Python interpreter for FMUs whose binaries expect one around them, such as those of PythonFMU. A Python program is
//! meant to load these binaries: they refer to its symbols, but to no library that has them.

use serde::Deserialize;
use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// Prints what [`Interpreter`] is. Some builds name the static library but have a shared one as well.
const QUESTION: &str = r#"
import json, os, sys, sysconfig
get = lambda name: sysconfig.get_config_var(name) or ""
version = "%d.%d" % sys.version_info[:2]
names = [get("INSTSONAME"), "libpython%s.so.1.0" % version, "libpython%s.dylib" % version]
folders = [get("PYTHONFRAMEWORKPREFIX"), get("LIBDIR"), os.path.join(sys.base_prefix, "lib")]
files = [os.path.join(folder, name) for name in names if not name.endswith(".a") for folder in folders if folder and name]
print(json.dumps({
    "program": sys.executable,
    "version": version,
    "libraries": [file for file in files if os.path.isfile(file)] + names[1:],
    "home": ":".join(dict.fromkeys([sys.base_prefix, sys.base_exec_prefix])),
    "paths": [path for path in sys.path if path],
}))
"#;

/// Information from `python3` about itself.
#[derive(Debug, Deserialize)]
struct Interpreter {
    program: PathBuf,
    version: String,
    /// Possible paths of its shared library.
    libraries: Vec<PathBuf>,
    /// Path of the standard library.
    home: String,
    /// Paths of packages, those of a virtual environment included.
    paths: Vec<String>,
}

/// Returns true if a binary cannot be loaded because no Python interpreter surrounds it.
pub fn is_missing(error: &libloading::Error) -> bool {
    let text = std::error::Error::source(error).map_or_else(|| error.to_string(), ToString::to_string);
    text.contains("symbol") && (text.contains("_Py") || text.contains(": Py"))
}

/// Loads the library of the interpreter that `python3` starts, so that binaries loaded later find its symbols. In a
/// process for one FMU only, the interpreter also receives the paths of its modules.
pub fn provide(alone: bool) -> Result<(), String> {
    let interpreter = ask().map_err(|problem| format!("it needs Python, but {problem}"))?;
    if !interpreter.libraries.iter().any(|file| load(file)) {
        let Interpreter { program, version, .. } = interpreter;
        return Err(format!(
            "it needs Python, but `python3`, which is {}, has no shared library: install libpython{version}, or put a Python \
             that has one first on the PATH",
            program.display()
        ));
    }
    if alone {
        let paths = interpreter.paths.join(":");
        for (name, value) in [("PYTHONHOME", &interpreter.home), ("PYTHONPATH", &paths)] {
            // SAFETY: nothing of the FMU runs yet, and the other threads of such a process do not look at the environment
            unsafe { std::env::set_var(name, value) };
        }
    }
    Ok(())
}

fn ask() -> Result<Interpreter, String> {
    let output = Command::new("python3").args(["-c", QUESTION]).stdin(Stdio::null()).output();
    let output = output.map_err(|error| format!("`python3` cannot be started: {error}"))?;
    serde_json::from_slice(&output.stdout).map_err(|_| {
        let last = String::from_utf8_lossy(&output.stderr).trim().lines().last().unwrap_or_default().to_owned();
        format!("`python3` ended with {}: {last}", output.status)
    })
}

/// Loads a library for good, with its symbols for all others.
#[cfg(unix)]
fn load(file: &Path) -> bool {
    use libloading::os::unix::{Library as Global, RTLD_GLOBAL, RTLD_NOW};
    // SAFETY: only the initializers of the interpreter's library run, which is intended
    let library = unsafe { Global::open(Some(file), RTLD_NOW | RTLD_GLOBAL) };
    library.map(std::mem::forget).is_ok()
}

/// No effect: on this platform binaries name the libraries of their symbols.
#[cfg(not(unix))]
fn load(_: &Path) -> bool {
    false
}
