//! Messages to the host, by categories.

use crate::status::Status;
use std::ffi::{CStr, CString, c_char, c_int, c_void};

/// FMI 2.0: environment, instance name, status, category, `printf` format, arguments.
pub(crate) type Callback2 = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// FMI 3.0: environment, status, category, message.
pub(crate) type Callback3 = unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char);

/// Where messages go.
enum Sink {
    Fmi2 { callback: Callback2, instance_name: CString },
    Fmi3(Option<Callback3>),
}

/// Sends messages to the host.
pub(crate) struct Logger {
    sink: Sink,
    environment: *mut c_void,
    warnings: bool,
    debug: bool,
}

/// Categories as the XML declares them: the messages of calls that fail, of calls that are carried out or discarded
/// with a reason, and everything, which adds plain information. Errors are always logged. FMI 2.0 defines fmi2Error by
/// "function logger was called" and has `loggingOn` and fmi2SetDebugLogging govern "debug logging"; FMI 3.0.3 says
/// "regardless of the current logging settings".
const CATEGORIES: [&CStr; 3] = [c"logStatusError", c"logStatusWarning", c"logAll"];

impl Logger {
    /// `loggingOn` of FMI 2.0 governs debug messages only. Warnings, too, are on from the start, whatever it says: no
    /// status reports them. `fmi2SetDebugLogging` can turn them off.
    pub(crate) fn fmi2(callback: Callback2, environment: *mut c_void, instance_name: &CStr, debug: bool) -> Self {
        let sink = Sink::Fmi2 { callback, instance_name: instance_name.to_owned() };
        Self { sink, environment, warnings: true, debug }
    }

    /// `loggingOn` of FMI 3.0 governs everything but errors. A host without a callback gets no messages.
    pub(crate) fn fmi3(callback: Option<Callback3>, environment: *mut c_void, on: bool) -> Self {
        Self { sink: Sink::Fmi3(callback), environment, warnings: on, debug: on }
    }

    /// Turns a category on or off. False if there is none of this name.
    pub(crate) fn switch(&mut self, category: &str, on: bool) -> bool {
        match category {
            "logStatusError" => {}
            "logStatusWarning" => self.warnings = on,
            "logAll" => self.switch_all(on),
            _ => return false,
        }
        true
    }

    pub(crate) fn switch_all(&mut self, on: bool) {
        (self.warnings, self.debug) = (on, on);
    }

    /// Names of all categories, for messages.
    pub(crate) fn categories() -> String {
        CATEGORIES.map(|name| format!("`{}`", name.to_string_lossy())).join(", ")
    }

    pub(crate) fn log(&self, status: Status, message: &str) {
        let [error, warning, all] = CATEGORIES;
        let (on, category) = match status {
            Status::Ok => (self.debug, all),
            Status::Warning | Status::Discard => (self.warnings, warning),
            Status::Error | Status::Fatal => (true, error),
        };
        if !on {
            return;
        }
        // hosts replace `#7#` by the variable's name, so a plain `#` is written twice; a C string holds no zero
        let message = CString::new(message.replace('#', "##").replace('\0', "")).unwrap_or_default();
        let (status, category, message) = (status as c_int, category.as_ptr(), message.as_ptr());
        // SAFETY: the host promises that the callback and its environment live as long as the instance; all strings are
        // terminated, and the format takes exactly one
        unsafe {
            match &self.sink {
                Sink::Fmi2 { callback, instance_name } => {
                    callback(self.environment, instance_name.as_ptr(), status, category, c"%s".as_ptr(), message);
                }
                Sink::Fmi3(Some(callback)) => callback(self.environment, status, category, message),
                Sink::Fmi3(None) => {}
            }
        }
    }
}
