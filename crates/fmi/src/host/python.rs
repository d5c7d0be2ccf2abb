//! Python interpreter for FMUs whose binaries expect one around them, such as those of PythonFMU. A Python program is
//! meant to load these binaries: they refer to its symbols, but to no library that has them.

use serde::Deserialize;
use std::{
    fmt, io,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
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

/// Reason why no Python interpreter can be loaded.
#[derive(Debug)]
pub enum PythonError {
    /// `python3` cannot be started.
    NotStarted(io::Error),
    /// `python3` ended without the reply.
    Ended {
        status: ExitStatus,
        /// Last line on standard error.
        last_line: String,
    },
    /// The interpreter has no shared library.
    NoLibrary {
        /// Its executable.
        program: PathBuf,
        version: String,
    },
}

impl fmt::Display for PythonError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("it needs Python, but ")?;
        match self {
            Self::NotStarted(error) => write!(f, "`python3` cannot be started: {error}"),
            Self::Ended { status, last_line } => write!(f, "`python3` ended with {status}: {last_line}"),
            Self::NoLibrary { program, version } => write!(
                f,
                "`python3`, which is {}, has no shared library: install libpython{version}, or put a Python that has one \
                 first on the PATH",
                program.display()
            ),
        }
    }
}

impl std::error::Error for PythonError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::NotStarted(error) => Some(error),
            Self::Ended { .. } | Self::NoLibrary { .. } => None,
        }
    }
}

/// Returns true if a binary refers to symbols of Python, and no interpreter surrounds it.
pub fn is_missing(binary: &[u8]) -> bool {
    !is_around() && binary.split(|byte| *byte == 0).any(is_symbol)
}

/// Returns true if a name between two zero bytes is one of Python's C interface, such as `PyObject_Call` or `_Py_NoneStruct`.
/// Symbols have such names in ELF files, and behind a further underscore in those of macOS.
fn is_symbol(name: &[u8]) -> bool {
    let start = name.iter().take(2).take_while(|byte| **byte == b'_').count();
    name[start..].starts_with(b"Py")
        && name[start..].contains(&b'_')
        && name.iter().all(|byte| byte.is_ascii_alphanumeric() || *byte == b'_')
}

/// Loads the library of the interpreter that `python3` starts, so that binaries loaded later find its symbols. In a
/// process for one FMU only, the interpreter also receives the paths of its modules.
pub fn provide(alone: bool) -> Result<(), PythonError> {
    let interpreter = ask()?;
    if !interpreter.libraries.iter().any(|file| load(file)) {
        let Interpreter { program, version, .. } = interpreter;
        return Err(PythonError::NoLibrary { program, version });
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

fn ask() -> Result<Interpreter, PythonError> {
    let output = Command::new("python3").args(["-c", QUESTION]).stdin(Stdio::null()).output();
    let output = output.map_err(PythonError::NotStarted)?;
    serde_json::from_slice(&output.stdout).map_err(|_| {
        let errors = String::from_utf8_lossy(&output.stderr);
        let last_line = errors.trim().lines().last().unwrap_or_default().to_owned();
        PythonError::Ended { status: output.status, last_line }
    })
}

/// Returns true if this process has the symbols of an interpreter.
#[cfg(unix)]
fn is_around() -> bool {
    use libloading::os::unix::Library as Global;
    // SAFETY: the symbol is searched, not called
    unsafe { Global::this().get::<*const ()>(b"Py_IsInitialized\0") }.is_ok()
}

/// Not needed: on this platform binaries name the libraries of their symbols.
#[cfg(not(unix))]
fn is_around() -> bool {
    true
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn binaries_that_need_python_are_recognized_by_their_symbols() {
        for name in ["Py_IsInitialized", "PyObject_CallMethod", "_Py_NoneStruct", "__Py_NoneStruct", "_PyArg_Parse"] {
            assert!(is_symbol(name.as_bytes()), "{name}");
        }
        for name in
            ["", "_", "Python", "PyTorch 2", "Py_ is a prefix", "fmi2DoStep", "copy_Py_Object", "libpython3.12.so"]
        {
            assert!(!is_symbol(name.as_bytes()), "{name}");
        }
    }
}
