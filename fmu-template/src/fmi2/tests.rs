//! The FMU as a host of FMI 2.0 sees it: through the C functions alone.
//!
//! SAFETY of every unsafe block below: the host keeps the promises that the standard asks of it. Components and states
//! are used before they are freed, arrays have the length given, strings are terminated; null pointers are on purpose.

#![allow(clippy::undocumented_unsafe_blocks)] // said once, above

use super::{model_exchange::*, *};
use crate::{component::Component, state::InstanceState, testing::*};
use metafmu_example as example;
use metafmu_runtime::{Activation, Surrogate};
use std::{fs, ptr::null, sync::Mutex};

mod derivatives;
mod domain;
mod exchange;
mod instances;
mod motion;
mod samples;
mod snapshots;
mod states;
mod steps;
mod values;

#[derive(Clone, Debug)]
struct Message {
    instance: String,
    status: c_int,
    category: String,
    text: String,
}

type Log = Mutex<Vec<Message>>;

/// Stands in for the C-variadic logger, which stable Rust cannot define. The calling conventions of x86-64 and of
/// 64-bit ARM except Apple's pass the first argument after the format as if it were a named parameter.
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
    let logger = unsafe { std::mem::transmute::<Fixed, Callback2>(log) };
    CallbackFunctions {
        logger: Some(logger),
        allocate_memory: None,
        free_memory: None,
        step_finished: None,
        environment: (&raw const *log_of_host).cast_mut().cast(),
    }
}

/// One instance and what it said.
struct Host {
    c: *mut c_void,
    log: Box<Log>,
}

impl Host {
    fn of(surrogate: &Surrogate) -> Self {
        Self::of_kind(surrogate, CO_SIMULATION)
    }

    fn of_kind(surrogate: &Surrogate, kind: c_int) -> Self {
        let folder = Folder::with(surrogate);
        let host = Self::instantiate(c"pendulum", kind, TOKEN, &folder.uri(), false);
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

    fn in_state(state: InstanceState) -> Self {
        Self::of_kind_in_state(CO_SIMULATION, state)
    }

    /// A host of this FMU type that has led its instance into a state.
    fn of_kind_in_state(kind: c_int, state: InstanceState) -> Self {
        let host = Self::of_kind(&example::surrogate(), kind);
        if state == InstanceState::Instantiated {
            return host;
        }
        host.set_up(0.0);
        assert_eq!(host.enter(), Status::Ok);
        if state == InstanceState::Initialization {
            return host;
        }
        assert_eq!(host.exit(), Status::Ok);
        match state {
            InstanceState::ContinuousTime => assert_eq!(host.go_on(), Status::Ok),
            InstanceState::Terminated => assert_eq!(host.terminate(), Status::Ok),
            InstanceState::Error => {
                assert_eq!(host.set_policy(2), Status::Ok);
                let forbidden = if kind == MODEL_EXCHANGE { host.set_time(100.0) } else { host.step(0.0, 100.0) };
                assert_eq!(forbidden, Status::Error);
            }
            InstanceState::Fatal => assert_eq!(host.panic(), Status::Fatal),
            _ => {}
        }
        host.messages();
        assert_eq!(host.state(), state);
        host
    }

    fn stepping() -> Self {
        Self::in_state(InstanceState::Step)
    }

    /// Co-simulation between steps, `speed` an input.
    fn driven() -> Self {
        let host = Self::of(&example::with_input());
        host.initialize(0.0);
        host
    }

    /// Model exchange in Continuous-Time Mode, `speed` an input.
    fn solving() -> Self {
        let host = Self::of_kind(&example::with_input(), MODEL_EXCHANGE);
        host.initialize(0.0);
        assert_eq!(host.go_on(), Status::Ok);
        host
    }

    /// Messages since the last call of this function.
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

    /// Returns true if warnings were logged since the last call. Only the log has them: no status reports them.
    fn warned(&self) -> bool {
        let messages = self.messages();
        assert!(messages.iter().all(|message| message.status == Status::Warning as c_int), "{messages:?}");
        !messages.is_empty()
    }

    fn state(&self) -> InstanceState {
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
        unsafe { call(self.c, Function::Reset, |_| panic!("on purpose")) }
    }

    /// Into Continuous-Time Mode.
    fn go_on(&self) -> Status {
        unsafe { fmi2EnterContinuousTimeMode(self.c) }
    }

    /// Into Event Mode.
    fn event(&self) -> Status {
        unsafe { fmi2EnterEventMode(self.c) }
    }

    /// The step of a solver that ends here is accepted.
    fn complete(&self) -> Status {
        unsafe { fmi2CompletedIntegratorStep(self.c, 1, &mut 0, &mut 0) }
    }

    fn set_time(&self, time: f64) -> Status {
        unsafe { fmi2SetTime(self.c, time) }
    }

    fn set_policy(&self, policy: c_int) -> Status {
        unsafe { fmi2SetInteger(self.c, &POLICY, 1, &policy) }
    }

    fn in_domain(&self) -> bool {
        let mut value = -1;
        assert_eq!(unsafe { fmi2GetBoolean(self.c, &IN_DOMAIN, 1, &mut value) }, Status::Ok);
        assert!(value == 0 || value == 1);
        value == 1
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
