//! The FMU as a host sees it: through the C functions alone.
//!
//! SAFETY of every unsafe block below: the host keeps the promises that the standard asks of it. Components and states
//! are used before they are freed, arrays have the length given, strings are terminated; null pointers are on purpose.

#![allow(clippy::undocumented_unsafe_blocks)] // said once, above

use super::*;
use metafmu_runtime::{Activation, Evaluator, Surrogate, example};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    fs,
    path::{Path, PathBuf},
    ptr::null,
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
};

// value references of the example surrogate
const LENGTH: u32 = 0; // tunable
const SPEED: u32 = 1; // fixed
const TIME: u32 = 2;
const OUTPUTS: [u32; 2] = [3, 4];
const TOKEN: &CStr = c"{00000000-0000-0000-0000-000000000000}";

// ---- A host ------------------------------------------------------------------------------------------------------

#[derive(Clone, Debug)]
struct Message {
    instance: String,
    status: c_int,
    category: String,
    text: String,
}

type Log = Mutex<Vec<Message>>;

/// Stands in for the C-variadic logger, which stable Rust cannot define. The calling conventions of x86-64 and of 64-bit
/// ARM but Apple's pass the first argument after the format as if it had a parameter of its own.
unsafe extern "C" fn log(
    environment: *mut c_void,
    instance: *const c_char,
    status: c_int,
    category: *const c_char,
    format: *const c_char,
    text: *const c_char,
) {
    unsafe {
        assert_eq!(CStr::from_ptr(format), c"%s");
        let [instance, category, text] = [instance, category, text].map(|s| CStr::from_ptr(s).to_str().unwrap().into());
        let log = &*environment.cast::<Log>();
        log.lock().unwrap().push(Message { instance, status, category, text });
    }
}

fn callbacks(log_of_host: &Log) -> CallbackFunctions {
    type Fixed = unsafe extern "C" fn(*mut c_void, *const c_char, c_int, *const c_char, *const c_char, *const c_char);
    let logger = unsafe { std::mem::transmute::<Fixed, Callback>(log) };
    CallbackFunctions {
        logger: Some(logger),
        allocate_memory: None,
        free_memory: None,
        step_finished: None,
        environment: (&raw const *log_of_host).cast_mut().cast(),
    }
}

/// A folder that is gone with the value; its name has what is awkward in a URI.
struct Folder(PathBuf);

impl Folder {
    fn empty() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("metafmu template #{} {count} ä", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn with(surrogate: &Surrogate) -> Self {
        let folder = Self::empty();
        fs::write(folder.0.join("model.safetensors"), surrogate.to_bytes().unwrap()).unwrap();
        folder
    }

    fn uri(&self) -> String {
        uri(&self.0)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn uri(path: &Path) -> String {
    let path = path.to_str().unwrap().replace('\\', "/");
    let escaped: String = path
        .bytes()
        .map(|byte| match byte {
            b'/' | b'.' | b'-' | b':' => char::from(byte).to_string(),
            _ if byte.is_ascii_alphanumeric() => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect();
    format!("file:///{}", escaped.trim_start_matches('/'))
}

fn c_string(text: &str) -> std::ffi::CString {
    std::ffi::CString::new(text).unwrap()
}

/// One instance and what it said.
struct Host {
    c: *mut c_void,
    log: Box<Log>,
}

impl Host {
    fn of(surrogate: &Surrogate) -> Self {
        let folder = Folder::with(surrogate);
        let host = Self::instantiate(c"pendulum", CO_SIMULATION, TOKEN, &folder.uri(), false);
        assert!(!host.c.is_null(), "{:?}", host.messages());
        host
    }

    fn new() -> Self {
        Self::of(&example::surrogate())
    }

    fn instantiate(name: &CStr, kind: c_int, token: &CStr, uri: &str, debug: bool) -> Self {
        let log = Box::new(Log::default());
        let functions = callbacks(&log);
        let uri = c_string(uri);
        let c = unsafe {
            fmi2Instantiate(name.as_ptr(), kind, token.as_ptr(), uri.as_ptr(), &functions, 0, c_int::from(debug))
        };
        Self { c, log }
    }

    fn in_state(state: State) -> Self {
        let host = Self::new();
        if state == State::Instantiated {
            return host;
        }
        host.set_up(0.0);
        assert_eq!(host.enter(), Status::Ok);
        if state == State::Initialization {
            return host;
        }
        assert_eq!(host.exit(), Status::Ok);
        match state {
            State::Terminated => assert_eq!(host.terminate(), Status::Ok),
            State::Error => assert_eq!(host.set(&[77], &[0.0]), Status::Error),
            State::Fatal => assert_eq!(host.panic(), Status::Fatal),
            _ => {}
        }
        host.messages();
        host
    }

    fn stepping() -> Self {
        Self::in_state(State::StepComplete)
    }

    /// Messages since the last time they were asked for.
    fn messages(&self) -> Vec<Message> {
        std::mem::take(&mut self.log.lock().unwrap())
    }

    /// The one message since the last time, after a check of what all messages have in common.
    fn message(&self) -> String {
        let messages = self.messages();
        let [message] = &messages[..] else { panic!("expected one message, found {messages:?}") };
        assert!(message.text.starts_with("fmi2"), "{message:?}");
        let category = match message.status {
            1 | 2 => "logStatusWarning",
            3 | 4 => "logStatusError",
            _ => "logAll",
        };
        assert_eq!(message.category, category, "{message:?}");
        message.text.clone()
    }

    fn state(&self) -> State {
        unsafe { (*self.c.cast::<Component>()).instance.snapshot().state }
    }

    fn set_up(&self, start: f64) {
        assert_eq!(unsafe { fmi2SetupExperiment(self.c, 0, 0.0, start, 0, 0.0) }, Status::Ok);
    }

    fn set_up_until(&self, start: f64, stop: f64) -> Status {
        unsafe { fmi2SetupExperiment(self.c, 1, 1e-6, start, 1, stop) }
    }

    fn enter(&self) -> Status {
        unsafe { fmi2EnterInitializationMode(self.c) }
    }

    fn exit(&self) -> Status {
        unsafe { fmi2ExitInitializationMode(self.c) }
    }

    fn terminate(&self) -> Status {
        unsafe { fmi2Terminate(self.c) }
    }

    fn reset(&self) -> Status {
        unsafe { fmi2Reset(self.c) }
    }

    fn panic(&self) -> Status {
        unsafe { call(self.c, Call::Reset, |_| panic!("on purpose")) }
    }

    fn initialize(&self, start: f64) {
        self.set_up(start);
        assert_eq!((self.enter(), self.exit()), (Status::Ok, Status::Ok));
    }

    fn step(&self, from: f64, size: f64) -> Status {
        unsafe { fmi2DoStep(self.c, from, size, 1) }
    }

    fn set(&self, references: &[u32], values: &[f64]) -> Status {
        unsafe { fmi2SetReal(self.c, references.as_ptr(), references.len(), values.as_ptr()) }
    }

    fn try_get<const N: usize>(&self, references: [u32; N]) -> Result<[f64; N], Status> {
        let mut values = [f64::NAN; N];
        match unsafe { fmi2GetReal(self.c, references.as_ptr(), N, values.as_mut_ptr()) } {
            Status::Ok => Ok(values),
            status => Err(status),
        }
    }

    fn outputs(&self) -> [f64; 2] {
        self.try_get(OUTPUTS).unwrap()
    }

    fn save(&self) -> *mut c_void {
        let mut state = null_mut();
        assert_eq!(unsafe { fmi2GetFMUstate(self.c, &mut state) }, Status::Ok);
        assert!(!state.is_null());
        state
    }

    fn restore(&self, state: *mut c_void) -> Status {
        unsafe { fmi2SetFMUstate(self.c, state) }
    }

    fn free_state(&self, mut state: *mut c_void) {
        assert_eq!(unsafe { fmi2FreeFMUstate(self.c, &mut state) }, Status::Ok);
        assert!(state.is_null());
    }

    fn serialize(&self, state: *mut c_void) -> Vec<u8> {
        let mut size = 0;
        assert_eq!(unsafe { fmi2SerializedFMUstateSize(self.c, state, &mut size) }, Status::Ok);
        let mut bytes = vec![0; size];
        assert_eq!(unsafe { fmi2SerializeFMUstate(self.c, state, bytes.as_mut_ptr(), size) }, Status::Ok);
        bytes
    }

    fn deserialize(&self, bytes: &[u8]) -> Result<*mut c_void, Status> {
        let mut state = null_mut();
        match unsafe { fmi2DeSerializeFMUstate(self.c, bytes.as_ptr(), bytes.len(), &mut state) } {
            Status::Ok => Ok(state),
            status => Err(status),
        }
    }

    fn switch(&self, on: bool, categories: &[&CStr]) -> Status {
        let pointers: Vec<_> = categories.iter().map(|category| category.as_ptr()).collect();
        unsafe { fmi2SetDebugLogging(self.c, c_int::from(on), pointers.len(), pointers.as_ptr()) }
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        unsafe { fmi2FreeInstance(self.c) }
    }
}

/// What the outputs must be.
fn expected(length: f64, speed: f64, time: f64) -> [f64; 2] {
    let evaluator = Evaluator::new(&example::surrogate());
    let mut outputs = [0.0; 2];
    evaluator.evaluate(&[length, speed, time], &mut outputs, &mut evaluator.scratch());
    outputs
}

fn starts() -> [f64; 2] {
    let surrogate = example::surrogate();
    [surrogate.inputs()[0].start, surrogate.inputs()[1].start]
}

// ---- States ------------------------------------------------------------------------------------------------------

/// Function, what it answers where it is allowed, and the standard's table: instantiated, Initialization Mode,
/// stepComplete, terminated, error.
type Row = (&'static str, fn(*mut c_void) -> Status, Status, &'static str);

#[rustfmt::skip]
const TABLE: [Row; 30] = {
    use Status::{Discard, Error, Ok};
    macro_rules! c { ($function:ident $(, $argument:expr)*) => { |c| unsafe { $function(c $(, $argument)*) } } }
    [
        ("SetDebugLogging",          c!(fmi2SetDebugLogging, 0, 0, null()),                               Ok,      "x x x x x"),
        ("SetupExperiment",          c!(fmi2SetupExperiment, 0, 0.0, 0.0, 0, 0.0),                        Ok,      "x - - - -"),
        ("EnterInitializationMode",  enter_after_setup,                                                   Ok,      "x - - - -"),
        ("ExitInitializationMode",   c!(fmi2ExitInitializationMode),                                      Ok,      "- x - - -"),
        ("Terminate",                c!(fmi2Terminate),                                                   Ok,      "- - x - -"),
        ("Reset",                    c!(fmi2Reset),                                                       Ok,      "x x x x x"),
        ("GetReal",                  c!(fmi2GetReal, [0, 3].as_ptr(), 2, [0.0; 2].as_mut_ptr()),          Ok,      "- x x x x"),
        ("GetInteger",               c!(fmi2GetInteger, null(), 0, null_mut()),                           Ok,      "- x x x x"),
        ("GetBoolean",               c!(fmi2GetBoolean, null(), 0, null_mut()),                           Ok,      "- x x x x"),
        ("GetString",                c!(fmi2GetString, null(), 0, null_mut()),                            Ok,      "- x x x x"),
        ("SetReal",                  c!(fmi2SetReal, [0].as_ptr(), 1, [0.15].as_ptr()),                   Ok,      "x x x - -"),
        ("SetInteger",               c!(fmi2SetInteger, null(), 0, null()),                               Ok,      "x x x - -"),
        ("SetBoolean",               c!(fmi2SetBoolean, null(), 0, null()),                               Ok,      "x x x - -"),
        ("SetString",                c!(fmi2SetString, null(), 0, null()),                                Ok,      "x x x - -"),
        ("GetFMUstate",              get_and_free_state,                                                  Ok,      "x x x x x"),
        ("SetFMUstate",              c!(fmi2SetFMUstate, null_mut()),                                     Error,   "x x x x x"),
        ("FreeFMUstate",             c!(fmi2FreeFMUstate, null_mut()),                                    Ok,      "x x x x x"),
        ("SerializedFMUstateSize",   c!(fmi2SerializedFMUstateSize, null_mut(), null_mut()),              Error,   "x x x x x"),
        ("SerializeFMUstate",        c!(fmi2SerializeFMUstate, null_mut(), null_mut(), 0),                Error,   "x x x x x"),
        ("DeSerializeFMUstate",      c!(fmi2DeSerializeFMUstate, null(), 0, null_mut()),                  Error,   "x x x x x"),
        ("GetDirectionalDerivative", c!(fmi2GetDirectionalDerivative, null(), 0, null(), 0, null(), null_mut()), Error, "- x x x x"),
        ("SetRealInputDerivatives",  c!(fmi2SetRealInputDerivatives, null(), 0, null(), null()),          Error,   "x x x - -"),
        ("GetRealOutputDerivatives", c!(fmi2GetRealOutputDerivatives, null(), 0, null(), null_mut()),     Error,   "- - x x x"),
        ("DoStep",                   c!(fmi2DoStep, 0.0, 0.01, 1),                                        Ok,      "- - x - -"),
        ("CancelStep",               c!(fmi2CancelStep),                                                  Error,   "- - - - -"),
        ("GetStatus",                c!(fmi2GetStatus, 0, null_mut()),                                    Discard, "- - x x -"),
        ("GetRealStatus",            c!(fmi2GetRealStatus, 2, &mut 0.0),                                  Ok,      "- - x x -"),
        ("GetIntegerStatus",         c!(fmi2GetIntegerStatus, 2, null_mut()),                             Discard, "- - x x -"),
        ("GetBooleanStatus",         c!(fmi2GetBooleanStatus, 3, &mut 1),                                 Ok,      "- - x x -"),
        ("GetStringStatus",          c!(fmi2GetStringStatus, 1, null_mut()),                              Discard, "- - x x -"),
    ]
};

fn enter_after_setup(c: *mut c_void) -> Status {
    unsafe {
        if (*c.cast::<Component>()).instance.snapshot().state == State::Instantiated {
            fmi2SetupExperiment(c, 0, 0.0, 0.0, 0, 0.0);
        }
        fmi2EnterInitializationMode(c)
    }
}

fn get_and_free_state(c: *mut c_void) -> Status {
    let mut state = null_mut();
    unsafe {
        let status = fmi2GetFMUstate(c, &mut state);
        fmi2FreeFMUstate(c, &mut state);
        status
    }
}

#[test]
fn every_function_is_allowed_in_the_states_of_the_standards_table_and_no_other() {
    let states = [State::Instantiated, State::Initialization, State::StepComplete, State::Terminated, State::Error];
    for (name, function, answer, row) in TABLE {
        for (state, allowed) in states.into_iter().zip(row.split(' ')) {
            let host = Host::in_state(state);
            let status = function(host.c);
            let refused: Vec<_> =
                host.messages().into_iter().filter(|message| message.text.contains("not allowed in state")).collect();
            if allowed == "x" {
                assert_eq!((status, refused.len()), (answer, 0), "{name} in {state}: {refused:?}");
            } else {
                assert_eq!((status, refused.len()), (Status::Error, 1), "{name} in {state}");
                assert!(refused[0].text.starts_with(&format!("fmi2{name}: not allowed in state `{state}`")));
                assert_eq!(host.state(), State::Error, "{name} in {state}");
            }
        }
    }
}

#[test]
fn after_a_panic_the_instance_answers_fatal_and_can_still_be_freed() {
    for (name, function, ..) in TABLE {
        let host = Host::in_state(State::Fatal);
        assert_eq!(function(host.c), Status::Fatal, "{name}");
    }
    let host = Host::stepping();
    assert_eq!(host.panic(), Status::Fatal);
    assert!(host.message().contains("on purpose"));
}

#[test]
fn a_refusal_names_the_state_and_those_in_which_the_call_is_allowed() {
    let host = Host::new();
    assert_eq!(host.exit(), Status::Error);
    let expected = "fmi2ExitInitializationMode: not allowed in state `instantiated`, only in `Initialization Mode`";
    assert_eq!(host.message(), expected);
}

#[test]
fn initialization_needs_a_start_time() {
    let host = Host::new();
    assert_eq!(host.enter(), Status::Error);
    assert!(host.message().contains("set up"));
}

#[test]
fn after_an_error_a_reset_or_a_stored_state_lets_the_instance_go_on() {
    let host = Host::stepping();
    let state = host.save();
    let refuse = || assert_eq!(host.step(0.0, -1.0), Status::Error);
    refuse();
    assert_eq!(host.step(0.0, 0.1), Status::Error, "cannot be continued");
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    refuse();
    assert_eq!(host.reset(), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    host.free_state(state);
}

// ---- Values ------------------------------------------------------------------------------------------------------

#[test]
fn outputs_are_right_at_every_point_where_a_host_may_look() {
    let host = Host::new();
    let [length, speed] = starts();
    host.set_up(0.25);
    assert_eq!(host.enter(), Status::Ok);
    assert_eq!(host.outputs(), expected(length, speed, 0.25), "start values");
    assert_eq!(host.set(&[SPEED, LENGTH], &[4.0, 0.12]), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.25), "after a set in Initialization Mode");
    assert_eq!(host.exit(), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.25), "at the start time");
    assert_eq!(host.step(0.25, 0.5), Status::Ok);
    assert_eq!(host.outputs(), expected(0.12, 4.0, 0.75), "after a step");
    assert_eq!(host.set(&[LENGTH], &[0.18]), Status::Ok);
    assert_eq!(host.outputs(), expected(0.18, 4.0, 0.75), "after a set between steps");
    assert_eq!(host.step(0.75, 0.01), Status::Ok);
    assert_eq!(host.try_get([4, 0, 2, 1, 3]), {
        let [angle, velocity] = expected(0.18, 4.0, 0.76);
        Ok([velocity, 0.18, 0.76, 4.0, angle])
    });
    assert_eq!(host.terminate(), Status::Ok);
    assert_eq!(host.outputs(), expected(0.18, 4.0, 0.76), "after the end");
    assert!(host.messages().is_empty());
}

#[test]
fn parameters_set_before_initialization_count() {
    let host = Host::new();
    assert_eq!(host.set(&[LENGTH, SPEED], &[0.11, 1.0]), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.outputs(), expected(0.11, 1.0, 0.0));
}

#[test]
fn what_cannot_be_set_is_refused_by_name() {
    let refused = |reference: u32| {
        let host = Host::stepping();
        assert_eq!(host.set(&[reference], &[1.0]), Status::Error);
        host.message()
    };
    assert!(refused(SPEED).contains("`speed` (value reference 1) is fixed and cannot be set in state `stepComplete`"));
    assert!(refused(TIME).contains("`time` (value reference 2) is the independent variable"));
    assert!(refused(3).contains("`angle` (value reference 3) is an output"));
    assert!(refused(5).contains("value reference 5 is unknown, expected at most 4"));
    assert!(refused(u32::MAX).contains("value reference 4294967295 is unknown"));
    for reference in [TIME, 3, 5] {
        assert_eq!(Host::new().set(&[reference], &[1.0]), Status::Error, "{reference} in instantiated");
    }
}

#[test]
fn a_value_that_is_not_finite_is_refused() {
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let host = Host::new();
        assert_eq!(host.set(&[LENGTH], &[value]), Status::Error);
        assert!(host.message().contains(&format!("`length` (value reference 0): {value} is not finite")));
    }
}

#[test]
fn a_call_with_one_wrong_value_changes_nothing_at_all() {
    for (reference, value) in [(SPEED, 1.0), (TIME, 1.0), (3, 1.0), (9, 1.0), (LENGTH, f64::NAN)] {
        let host = Host::stepping();
        let before = host.outputs();
        assert_eq!(host.set(&[LENGTH, reference], &[0.19, value]), Status::Error);
        assert_eq!((host.try_get([LENGTH]), host.outputs()), (Ok([starts()[0]]), before));
    }
}

#[test]
fn an_unknown_value_reference_cannot_be_read() {
    for reference in [5, u32::MAX] {
        let host = Host::stepping();
        assert_eq!(host.try_get([3, reference]), Err(Status::Error));
        assert!(host.message().contains(&format!("fmi2GetReal: value reference {reference} is unknown")));
    }
}

#[test]
fn a_parameter_outside_its_training_range_is_accepted_with_a_warning() {
    let host = Host::stepping();
    assert_eq!(host.set(&[LENGTH], &[0.2 * (1.0 + 1e-12)]), Status::Ok, "rounding");
    assert_eq!(host.set(&[LENGTH], &[0.25]), Status::Warning);
    let message = host.message();
    assert!(message.contains("`length`: 0.25 is outside the training range from 0.1 to 0.2"), "{message}");
    assert_eq!(host.outputs(), expected(0.25, starts()[1], 0.0));
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
}

#[test]
fn there_are_no_variables_of_other_types() {
    let refused = |call: unsafe fn(*mut c_void) -> Status, kind: &str| {
        let host = Host::in_state(State::Initialization);
        assert_eq!(unsafe { call(host.c) }, Status::Error);
        let expected = format!("1 variables of type {kind} asked for, but all variables are of type Real");
        assert!(host.message().ends_with(&expected));
    };
    refused(|c| unsafe { fmi2GetInteger(c, &0, 1, &mut 0) }, "Integer");
    refused(|c| unsafe { fmi2SetInteger(c, &0, 1, &0) }, "Integer");
    refused(|c| unsafe { fmi2GetBoolean(c, &0, 1, &mut 0) }, "Boolean");
    refused(|c| unsafe { fmi2SetBoolean(c, &0, 1, &0) }, "Boolean");
    refused(|c| unsafe { fmi2GetString(c, &0, 1, &mut null()) }, "String");
    refused(|c| unsafe { fmi2SetString(c, &0, 1, &c"".as_ptr()) }, "String");
}

#[test]
fn null_arrays_are_fine_when_empty_and_refused_otherwise() {
    let host = Host::stepping();
    unsafe {
        assert_eq!(fmi2GetReal(host.c, null(), 0, null_mut()), Status::Ok);
        assert_eq!(fmi2SetReal(host.c, null(), 0, null()), Status::Ok);
    }
    let refused = |call: unsafe fn(*mut c_void) -> Status, argument: &str| {
        let host = Host::stepping();
        assert_eq!(unsafe { call(host.c) }, Status::Error);
        assert!(host.message().contains(&format!("argument `{argument}` is a null pointer")));
    };
    unsafe {
        refused(|c| fmi2GetReal(c, null(), 1, &mut 0.0), "vr");
        refused(|c| fmi2GetReal(c, &0, 1, null_mut()), "value");
        refused(|c| fmi2SetReal(c, null(), 1, &0.0), "vr");
        refused(|c| fmi2SetReal(c, &0, 1, null()), "value");
        refused(|c| fmi2SetDebugLogging(c, 1, 1, null()), "categories");
        refused(|c| fmi2SetDebugLogging(c, 1, 1, [null()].as_ptr()), "categories");
        refused(|c| fmi2GetFMUstate(c, null_mut()), "FMUstate");
        refused(|c| fmi2SetFMUstate(c, null_mut()), "FMUstate");
        refused(|c| fmi2SerializedFMUstateSize(c, null_mut(), &mut 0), "FMUstate");
        refused(|c| fmi2SerializeFMUstate(c, null_mut(), null_mut(), 0), "FMUstate");
        refused(|c| fmi2DeSerializeFMUstate(c, null(), 9, &mut null_mut()), "serializedState");
        refused(|c| fmi2GetRealStatus(c, LAST_SUCCESSFUL_TIME, null_mut()), "value");
        refused(|c| fmi2GetBooleanStatus(c, TERMINATED, null_mut()), "value");
    }
}

#[test]
fn a_null_component_is_an_error_and_freeing_it_is_fine() {
    for (name, function, ..) in TABLE {
        if name != "EnterInitializationMode" {
            assert_eq!(function(null_mut()), Status::Error, "{name}");
        }
    }
    unsafe {
        assert_eq!(fmi2EnterInitializationMode(null_mut()), Status::Error);
        fmi2FreeInstance(null_mut());
    }
}

// ---- Experiment and steps ----------------------------------------------------------------------------------------

#[test]
fn times_of_the_experiment_that_make_no_sense_are_refused() {
    let (nan, infinity) = (f64::NAN, f64::INFINITY);
    for (start, stop) in [(nan, 1.0), (infinity, 1.0), (0.0, nan), (0.0, infinity), (1.0, 1.0), (1.0, 0.5)] {
        let host = Host::new();
        assert_eq!(host.set_up_until(start, stop), Status::Error, "{start} {stop}");
        host.message();
    }
    let host = Host::new();
    assert_eq!(unsafe { fmi2SetupExperiment(host.c, 0, nan, 0.5, 0, nan) }, Status::Ok, "undefined: not looked at");
}

#[test]
fn steps_that_make_no_sense_are_refused() {
    let (nan, infinity) = (f64::NAN, f64::INFINITY);
    for (from, size, why) in [
        (nan, 0.1, "`currentCommunicationPoint`: NaN is not finite"),
        (infinity, 0.1, "`currentCommunicationPoint`: inf is not finite"),
        (0.0, nan, "`communicationStepSize`: NaN is not finite"),
        (0.0, infinity, "`communicationStepSize`: inf is not finite"),
        (0.0, -0.1, "step size -0.1 is negative"),
        (0.1, 0.1, "current communication point is 0.1, expected 0"),
        (-1e-6, 0.1, "current communication point is -0.000001, expected 0"),
        (f64::MAX, f64::MAX, "current communication point"),
    ] {
        let host = Host::stepping();
        assert_eq!(host.step(from, size), Status::Error, "{from} {size}");
        let message = host.message();
        assert!(message.starts_with("fmi2DoStep: ") && message.contains(why), "{message}");
        assert_eq!(host.try_get([TIME]), Ok([0.0]), "nothing changed");
    }
}

#[test]
fn steps_of_any_size_follow_the_hosts_clock() {
    let host = Host::stepping();
    let [length, speed] = starts();
    let mut time = 0.0;
    for size in [0.1, 0.0, 1e-9, 1.0 / 3.0, 0.5] {
        assert_eq!(host.step(time, size), Status::Ok);
        time += size;
        assert_eq!(host.try_get([TIME]), Ok([time]));
        assert_eq!(host.outputs(), expected(length, speed, time));
    }
}

#[test]
fn rounding_in_the_hosts_clock_is_let_pass_and_adopted() {
    let host = Host::stepping();
    let nanoseconds = |time: f64| (time * 1e9).round() * 1e-9;
    let size = 1.0 / 300.0;
    for step in 0..300 {
        let from = nanoseconds(f64::from(step) * size);
        assert_eq!(host.step(from, size), Status::Ok, "{from}");
        assert_eq!(host.try_get([TIME]), Ok([from + size]));
    }
}

#[test]
fn a_step_past_the_stop_time_is_refused() {
    let host = Host::new();
    assert_eq!(host.set_up_until(0.0, 1.0), Status::Ok);
    assert_eq!((host.enter(), host.exit()), (Status::Ok, Status::Ok));
    assert_eq!(host.step(0.0, 1.0 + 1e-10), Status::Ok, "rounding");
    assert_eq!(host.step(1.0, 0.01), Status::Error);
    assert!(host.message().contains("past the stop time 1"));
}

#[test]
fn leaving_the_trained_time_is_said_once_a_run_and_rounding_is_not_leaving() {
    let host = Host::stepping();
    let [length, speed] = starts();
    for _ in 0..2 {
        assert_eq!(host.step(0.0, 2.000_000_000_1), Status::Ok);
        assert!(host.messages().is_empty());
        assert_eq!(host.step(2.0, 0.5), Status::Warning);
        assert!(host.message().contains("time 2.5 is outside the training range from 0 to 2"));
        assert_eq!(host.outputs(), expected(length, speed, 2.5), "computed all the same");
        assert_eq!(host.step(2.5, 0.5), Status::Ok);
        assert!(host.messages().is_empty());
        assert_eq!(host.reset(), Status::Ok);
        host.initialize(0.0);
    }
}

#[test]
fn a_start_outside_the_trained_time_is_a_warning() {
    let host = Host::new();
    assert_eq!(host.set_up_until(-1.0, 1.0), Status::Warning);
    assert!(host.message().contains("time -1"));
}

#[test]
fn reset_restores_everything_and_a_second_run_is_the_first_again() {
    let host = Host::new();
    let run = || {
        host.initialize(0.0);
        assert_eq!(host.step(0.0, 0.3), Status::Ok);
        host.outputs()
    };
    let first = run();
    assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
    assert_eq!(host.terminate(), Status::Ok);
    assert_eq!(host.reset(), Status::Ok);
    assert_eq!(host.state(), State::Instantiated);
    assert_eq!(run(), first);
    assert_eq!(host.reset(), Status::Ok);
    assert_eq!(host.enter(), Status::Error, "the experiment must be set up again");
}

#[test]
fn status_information_is_the_time_reached_and_never_the_wish_to_end() {
    let host = Host::stepping();
    let (mut time, mut terminated) = (0.0, 1);
    assert_eq!(host.step(0.0, 0.5), Status::Ok);
    unsafe {
        assert_eq!(fmi2GetRealStatus(host.c, LAST_SUCCESSFUL_TIME, &mut time), Status::Ok);
        assert_eq!(fmi2GetBooleanStatus(host.c, TERMINATED, &mut terminated), Status::Ok);
        assert_eq!((time, terminated), (0.5, 0));
        for kind in [0, 1, 3, -1, 99] {
            assert_eq!(fmi2GetRealStatus(host.c, kind, &mut time), Status::Discard);
            assert!(host.message().contains(&format!("status information {kind} is not available")));
        }
    }
    assert_eq!(host.step(0.5, 0.5), Status::Ok, "discarding is no error");
}

#[test]
fn what_is_not_offered_says_so() {
    for name in ["GetDirectionalDerivative", "SetRealInputDerivatives", "GetRealOutputDerivatives"] {
        let host = Host::stepping();
        let (_, function, ..) = TABLE.into_iter().find(|row| row.0 == name).unwrap();
        assert_eq!(function(host.c), Status::Error);
        assert!(host.message().starts_with(&format!("fmi2{name}: not offered: ")));
    }
}

#[test]
fn a_step_with_its_outputs_allocates_nothing() {
    let host = Host::of(&example::with_network(&[128, 128], Activation::Tanh));
    host.initialize(0.0);
    let size = 1e-4;
    let before = ALLOCATIONS.get();
    for step in 0..10_000 {
        assert_eq!(host.step(f64::from(step) * size, size), Status::Ok);
        assert!(host.outputs()[0].is_finite());
        assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
    }
    assert_eq!(ALLOCATIONS.get() - before, 0);
    host.free_state(host.save());
    assert!(ALLOCATIONS.get() > before, "the count counts");
}

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

// ---- FMU state ---------------------------------------------------------------------------------------------------

#[test]
fn a_restored_state_continues_to_the_last_bit() {
    let host = Host::stepping();
    assert_eq!(host.set(&[LENGTH], &[0.123]), Status::Ok);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    let state = host.save();
    let go_on = |host: &Host| {
        assert_eq!(host.step(0.1, 0.2), Status::Ok);
        assert_eq!(host.step(0.1 + 0.2, 0.01), Status::Ok);
        (host.outputs().map(f64::to_bits), host.try_get([0, 1, 2]).unwrap().map(f64::to_bits))
    };
    let first = go_on(&host);
    assert_eq!(host.set(&[LENGTH], &[0.2]), Status::Ok);
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.outputs(), expected(0.123, starts()[1], 0.1), "at once");
    assert_eq!(go_on(&host), first);

    let bytes = host.serialize(state);
    host.free_state(state);
    let other = Host::new();
    let again = other.deserialize(&bytes).unwrap();
    assert_eq!(other.restore(again), Status::Ok);
    assert_eq!(go_on(&other), first, "in another instance, from bytes");
    other.free_state(again);
}

#[test]
fn a_state_is_taken_into_one_that_is_there() {
    let host = Host::stepping();
    let mut state = host.save();
    let same = state;
    assert_eq!(host.step(0.0, 0.5), Status::Ok);
    assert_eq!(unsafe { fmi2GetFMUstate(host.c, &mut state) }, Status::Ok);
    assert_eq!(state, same);
    assert_eq!(host.step(0.5, 0.5), Status::Ok);
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.try_get([TIME]), Ok([0.5]));
    host.free_state(state);
    host.free_state(null_mut());
}

#[test]
fn a_state_of_another_surrogate_or_a_damaged_one_is_refused() {
    let other = example::surrogate().with_content_digest("1".repeat(64)).unwrap();
    let token = c_string(&other.instantiation_token());
    let other = Host::instantiate(c"other", CO_SIMULATION, &token, &Folder::with(&other).uri(), false);
    let host = Host::new();
    let foreign = other.save();
    assert_eq!(host.restore(foreign), Status::Error);
    assert!(host.message().contains("belongs to another FMU"));
    let mut bytes = other.serialize(foreign);
    assert_eq!(host.deserialize(&bytes), Err(Status::Error));
    host.message();
    bytes[20] ^= 1;
    assert_eq!(other.deserialize(&bytes), Err(Status::Error));
    assert!(other.message().contains("damaged"));
    assert_eq!(other.deserialize(&[]), Err(Status::Error));
    let status = unsafe { fmi2SerializeFMUstate(other.c, foreign, bytes.as_mut_ptr(), bytes.len() - 1) };
    assert_eq!(status, Status::Error);
    other.free_state(foreign);
}

// ---- Several instances -------------------------------------------------------------------------------------------

#[test]
fn instances_do_not_share_anything_that_changes() {
    let (one, two) = (Host::stepping(), Host::stepping());
    assert_eq!(one.set(&[LENGTH], &[0.11]), Status::Ok);
    assert_eq!(one.step(0.0, 0.5), Status::Ok);
    let [length, speed] = starts();
    assert_eq!(two.outputs(), expected(length, speed, 0.0));
    drop(two);
    assert_eq!(one.outputs(), expected(0.11, speed, 0.5));
}

#[test]
fn instances_run_on_threads_of_their_own() {
    std::thread::scope(|scope| {
        for index in 0..4 {
            scope.spawn(move || {
                let host = Host::stepping();
                let length = 0.12 + 0.01 * f64::from(index);
                assert_eq!(host.set(&[LENGTH], &[length]), Status::Ok);
                for step in 0..200 {
                    let time = f64::from(step) / 128.0;
                    assert_eq!(host.step(time, 1.0 / 128.0), Status::Ok);
                    assert_eq!(host.outputs(), expected(length, starts()[1], time + 1.0 / 128.0));
                }
            });
        }
    });
}

// ---- Instantiation and logging -----------------------------------------------------------------------------------

#[test]
fn version_and_platform_are_the_standards() {
    let text = |pointer| unsafe { CStr::from_ptr(pointer) };
    assert_eq!(text(fmi2GetVersion()), c"2.0");
    assert_eq!(text(fmi2GetTypesPlatform()), c"default");
}

#[test]
fn an_instance_that_cannot_be_is_null_and_the_reason_is_logged() {
    let folder = Folder::with(&example::surrogate());
    let failed = |name: &CStr, kind, token: &CStr, uri: &str| {
        let host = Host::instantiate(name, kind, token, uri, false);
        assert!(host.c.is_null());
        let message = host.message();
        assert!(message.starts_with("fmi2Instantiate: "), "{message}");
        message
    };
    let uri = folder.uri();
    let wrong = c"{1}";
    assert!(failed(c"", CO_SIMULATION, TOKEN, &uri).contains("instance name is empty"));
    assert!(failed(c" \t", CO_SIMULATION, TOKEN, &uri).contains("instance name is empty"));
    assert!(failed(c"a", 0, TOKEN, &uri).contains("FMU type is 0, expected 1"));
    assert!(failed(c"a", 7, TOKEN, &uri).contains("FMU type is 7, expected 1"));
    let message = failed(c"a", CO_SIMULATION, wrong, &uri);
    assert!(message.contains("`{1}`") && message.contains(TOKEN.to_str().unwrap()), "{message}");
    assert!(failed(c"a", CO_SIMULATION, c"\xff", &uri).contains("`fmuGUID` is not UTF-8"));
    assert!(failed(c"a", CO_SIMULATION, TOKEN, "http://example.org").contains("`http://example.org` is no file URI"));

    fs::write(folder.0.join("model.safetensors"), [0; 40]).unwrap();
    let message = failed(c"a", CO_SIMULATION, TOKEN, &uri);
    assert!(message.contains("model.safetensors") && message.contains("not a safetensors container"), "{message}");
    fs::remove_file(folder.0.join("model.safetensors")).unwrap();
    let message = failed(c"a", CO_SIMULATION, TOKEN, &uri);
    assert!(message.contains("cannot read the model file") && message.contains("model.safetensors"), "{message}");
}

#[test]
fn null_arguments_of_instantiation_are_refused_without_a_crash() {
    let log = Log::default();
    let functions = callbacks(&log);
    let without_logger = CallbackFunctions { logger: None, ..callbacks(&log) };
    let (name, token, uri) = (c"a".as_ptr(), TOKEN.as_ptr(), c"file:///tmp".as_ptr());
    unsafe {
        assert!(fmi2Instantiate(name, CO_SIMULATION, token, uri, null(), 0, 0).is_null());
        assert!(fmi2Instantiate(name, CO_SIMULATION, token, uri, &without_logger, 0, 0).is_null());
        assert!(log.lock().unwrap().is_empty());
        assert!(fmi2Instantiate(null(), CO_SIMULATION, token, uri, &functions, 0, 0).is_null());
        assert!(fmi2Instantiate(name, CO_SIMULATION, null(), uri, &functions, 0, 0).is_null());
        assert!(fmi2Instantiate(name, CO_SIMULATION, token, null(), &functions, 0, 0).is_null());
        assert!(fmi2Instantiate(name, CO_SIMULATION, token, c"\xff".as_ptr(), &functions, 0, 0).is_null());
    }
    let texts: Vec<_> = log.lock().unwrap().iter().map(|message| message.text.clone()).collect();
    assert_eq!(texts.len(), 4, "{texts:?}");
    assert!(texts[2].contains("`fmuResourceLocation` is a null pointer"));
}

#[test]
fn resource_locations_of_every_habit_lead_to_the_model_file() {
    let folder = Folder::with(&example::surrogate());
    let uri = folder.uri();
    let path = uri.strip_prefix("file://").unwrap();
    for uri in [uri.clone(), format!("{uri}/"), format!("file:{path}"), format!("file://localhost{path}")] {
        let host = Host::instantiate(c"a", CO_SIMULATION, TOKEN, &uri, false);
        assert!(!host.c.is_null(), "{uri}: {:?}", host.messages());
    }
}

#[test]
fn errors_and_warnings_are_logged_from_the_start_and_plain_information_on_demand() {
    let folder = Folder::with(&example::surrogate());
    let host = Host::instantiate(c"quiet", CO_SIMULATION, TOKEN, &folder.uri(), false);
    assert!(host.messages().is_empty());
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Warning);
    let messages = host.messages();
    assert_eq!((messages.len(), messages[0].instance.as_str()), (1, "quiet"));
    let host = Host::instantiate(c"loud", CO_SIMULATION, TOKEN, &folder.uri(), true);
    assert!(host.message().contains("surrogate `example`"));
}

#[test]
fn categories_can_be_switched_one_by_one() {
    let host = Host::new();
    let warn = || assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Warning);
    let said = |call: &dyn Fn()| {
        call();
        !host.messages().is_empty()
    };
    let fail = || {
        assert_eq!(host.exit(), Status::Error);
        assert_eq!(host.reset(), Status::Ok);
    };
    assert_eq!((said(&warn), said(&fail)), (true, true));
    assert_eq!(host.switch(false, &[c"logStatusWarning"]), Status::Ok);
    assert_eq!((said(&warn), said(&fail)), (false, true), "the status stays, the message goes");
    assert_eq!(host.switch(false, &[]), Status::Ok);
    assert_eq!((said(&warn), said(&fail)), (false, false));
    assert_eq!(host.switch(true, &[c"logStatusError"]), Status::Ok);
    assert_eq!((said(&warn), said(&fail)), (false, true));
    assert_eq!(host.switch(true, &[c"logAll"]), Status::Ok);
    assert_eq!((said(&warn), said(&fail)), (true, true));
    assert_eq!(host.switch(true, &[c"logEvents"]), Status::Warning);
    assert!(host.message().contains("`logEvents` is unknown, expected one of `logStatusError`, `logStatusWarning`"));
}

#[test]
fn the_sign_that_hosts_replace_is_written_twice() {
    let host = Host::instantiate(c"a", CO_SIMULATION, TOKEN, "file:///no/C%23", false);
    assert!(host.message().contains("C##"));
}
