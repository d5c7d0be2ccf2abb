//! Messages to the host, by categories.

use crate::answer::Status;
use std::ffi::{CStr, CString, c_char, c_int, c_void};

/// The host's logger: environment, instance name, status, category, `printf` format, arguments.
pub(crate) type Callback = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, ...);

/// Sends messages to the host.
///
/// `loggingOn` of instantiation governs debug messages only. Errors and warnings are on from the start, whatever it
/// says: the standard defines fmi2Error and fmi2Warning by "function logger was called", and unlike fmi2Discard without
/// the condition of debug mode. (The Reference FMUs do the same for errors.) `fmi2SetDebugLogging` can turn each
/// category off.
pub(crate) struct Logger {
    callback: Callback,
    environment: *mut c_void,
    instance_name: CString,
    errors: bool,
    warnings: bool,
    debug: bool,
}

/// Categories as the XML declares them: the messages of calls that fail, of calls that are carried out or discarded
/// with a reason, and everything, which adds plain information.
const CATEGORIES: [&CStr; 3] = [c"logStatusError", c"logStatusWarning", c"logAll"];

impl Logger {
    pub(crate) fn new(callback: Callback, environment: *mut c_void, instance_name: &CStr, debug: bool) -> Self {
        Self { callback, environment, instance_name: instance_name.to_owned(), errors: true, warnings: true, debug }
    }

    /// Turns a category on or off. False if there is none of this name.
    pub(crate) fn switch(&mut self, category: &str, on: bool) -> bool {
        match category {
            "logStatusError" => self.errors = on,
            "logStatusWarning" => self.warnings = on,
            "logAll" => self.switch_all(on),
            _ => return false,
        }
        true
    }

    pub(crate) fn switch_all(&mut self, on: bool) {
        (self.errors, self.warnings, self.debug) = (on, on, on);
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
            Status::Error | Status::Fatal => (self.errors, error),
        };
        if !on {
            return;
        }
        // hosts replace `#r7#` by the variable's name, so a plain `#` is written twice; a C string holds no zero
        let message = CString::new(message.replace('#', "##").replace('\0', "")).unwrap_or_default();
        // SAFETY: the host promises that the callback and its environment live as long as the instance; all strings are
        // terminated, and the format takes exactly one
        unsafe {
            (self.callback)(
                self.environment,
                self.instance_name.as_ptr(),
                status as c_int,
                category.as_ptr(),
                c"%s".as_ptr(),
                message.as_ptr(),
            );
        }
    }
}
