//! The FMU as a host of FMI 3.0 sees it: through the C functions alone.
//!
//! SAFETY of every unsafe block below: the host keeps the promises that the standard asks of it. Instances and states
//! are used before they are freed, arrays have the length given, strings are terminated; null pointers are on purpose.

#![allow(clippy::undocumented_unsafe_blocks)] // said once, above

use super::{clocks::*, derivatives::*, model_exchange::*, values::*, *};
use crate::{component::Component, state::InstanceState, testing::*};
use metafmu_example as example;
use metafmu_runtime::{Activation, Surrogate};
use std::{
    ffi::{CStr, c_int},
    path::Path,
    ptr::{null, null_mut},
    sync::Mutex,
};

mod arrays;
mod instances;
mod sensitivities;
mod states;
mod steps;
mod updates;

#[derive(Clone, Debug)]
struct Message {
    status: c_int,
    category: String,
    text: String,
}

type Log = Mutex<Vec<Message>>;

unsafe extern "C" fn log(environment: *mut c_void, status: c_int, category: *const c_char, text: *const c_char) {
    unsafe {
        let [category, text] = [category, text].map(|s| CStr::from_ptr(s).to_str().unwrap().into());
        (*environment.cast::<Log>()).lock().unwrap().push(Message { status, category, text });
    }
}

/// How a host uses its instance.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Use {
    Steps,
    StepsAndEvents,
    Solver,
}

/// One instance and what it said.
struct Host {
    instance: *mut c_void,
    log: Box<Log>,
}

impl Host {
    fn instantiate(use_as: Use, name: &CStr, token: &CStr, resources: *const c_char, logging: bool) -> Self {
        let log_of_host = Box::new(Log::default());
        let environment = (&raw const *log_of_host).cast_mut().cast();
        let (name, token, logging, events) =
            (name.as_ptr(), token.as_ptr(), logging.into(), (use_as == Use::StepsAndEvents).into());
        let instance = unsafe {
            match use_as {
                Use::Solver => fmi3InstantiateModelExchange(name, token, resources, 0, logging, environment, Some(log)),
                Use::Steps | Use::StepsAndEvents => {
                    let (variables, n, update) = (null(), 0, None);
                    fmi3InstantiateCoSimulation(
                        name,
                        token,
                        resources,
                        0,
                        logging,
                        events,
                        1,
                        variables,
                        n,
                        environment,
                        Some(log),
                        update,
                    )
                }
            }
        };
        Self { instance, log: log_of_host }
    }

    fn of(surrogate: &Surrogate, use_as: Use) -> Self {
        let folder = Folder::with(surrogate);
        let host = Self::instantiate(use_as, c"pendulum", TOKEN, path(&folder.0).as_ptr(), true);
        assert!(!host.instance.is_null(), "{:?}", host.messages());
        host.messages();
        host
    }

    /// `speed` an input, initialized at time zero.
    fn driven(use_as: Use) -> Self {
        let host = Self::of(&example::with_input(), use_as);
        assert_eq!((host.enter(0.0), host.exit()), (Status::Ok, Status::Ok));
        host
    }

    fn in_state(use_as: Use, state: InstanceState) -> Self {
        let host = Self::of(&example::surrogate(), use_as);
        if state == InstanceState::Instantiated {
            return host;
        }
        assert_eq!(host.enter(0.0), Status::Ok);
        if state == InstanceState::Initialization {
            return host;
        }
        assert_eq!(host.exit(), Status::Ok);
        match (state, use_as) {
            (InstanceState::ContinuousTime, _) => assert_eq!(host.continuous(), Status::Ok),
            (InstanceState::Step, Use::StepsAndEvents) => assert_eq!(host.step_mode(), Status::Ok),
            (InstanceState::Terminated, _) => assert_eq!(unsafe { fmi3Terminate(host.instance) }, Status::Ok),
            (InstanceState::Fatal, _) => assert_eq!(host.panic(), Status::Fatal),
            _ => {}
        }
        host.messages();
        assert_eq!(host.state(), state);
        host
    }

    /// Messages since the last time they were asked for.
    fn messages(&self) -> Vec<Message> {
        std::mem::take(&mut self.log.lock().unwrap())
    }

    /// The one message since the last time, after a check of what all messages have in common.
    fn message(&self) -> String {
        let messages = self.messages();
        let [message] = &messages[..] else { panic!("expected one message, found {messages:?}") };
        assert!(message.text.starts_with("fmi3"), "{message:?}");
        let category = match message.status {
            1 | 2 => "logStatusWarning",
            3 | 4 => "logStatusError",
            _ => "logAll",
        };
        assert_eq!(message.category, category, "{message:?}");
        message.text.clone()
    }

    fn state(&self) -> InstanceState {
        unsafe { (*self.instance.cast::<Component>()).instance.snapshot().state }
    }

    fn enter(&self, start: f64) -> Status {
        unsafe { fmi3EnterInitializationMode(self.instance, 0, 0.0, start, 0, 0.0) }
    }

    fn exit(&self) -> Status {
        unsafe { fmi3ExitInitializationMode(self.instance) }
    }

    fn continuous(&self) -> Status {
        unsafe { fmi3EnterContinuousTimeMode(self.instance) }
    }

    fn step_mode(&self) -> Status {
        unsafe { fmi3EnterStepMode(self.instance) }
    }

    fn event_mode(&self) -> Status {
        unsafe { fmi3EnterEventMode(self.instance) }
    }

    fn update(&self) -> ([Boolean; 5], Status) {
        let mut told = [1; 5];
        let [a, b, c, d, e] = &mut told;
        let status = unsafe { fmi3UpdateDiscreteStates(self.instance, a, b, c, d, e, &mut 0.0) };
        (told, status)
    }

    /// A step, what the FMU wished, and the time it reached.
    fn step_told(&self, from: f64, size: f64) -> (Status, [Boolean; 3], f64) {
        let (mut told, mut time) = ([1; 3], f64::NAN);
        let [event, end, early] = &mut told;
        let status = unsafe { fmi3DoStep(self.instance, from, size, 1, event, end, early, &mut time) };
        (status, told, time)
    }

    fn step(&self, from: f64, size: f64) -> Status {
        self.step_told(from, size).0
    }

    fn panic(&self) -> Status {
        unsafe { call(self.instance, Function::Reset, |_| panic!("on purpose")) }
    }

    fn reset(&self) -> Status {
        unsafe { fmi3Reset(self.instance) }
    }

    fn set(&self, references: &[u32], values: &[f64]) -> Status {
        let (n, m) = (references.len(), values.len());
        unsafe { fmi3SetFloat64(self.instance, references.as_ptr(), n, values.as_ptr(), m) }
    }

    fn set_policy(&self, policy: i32) -> Status {
        unsafe { fmi3SetInt32(self.instance, &POLICY, 1, &policy, 1) }
    }

    fn try_get<const N: usize>(&self, references: [u32; N]) -> Result<[f64; N], Status> {
        let mut values = [f64::NAN; N];
        match unsafe { fmi3GetFloat64(self.instance, references.as_ptr(), N, values.as_mut_ptr(), N) } {
            Status::Ok => Ok(values),
            status => Err(status),
        }
    }

    fn outputs(&self) -> [f64; 2] {
        self.try_get(OUTPUTS).unwrap()
    }

    fn in_domain(&self) -> Boolean {
        let mut value = 9;
        assert_eq!(unsafe { fmi3GetBoolean(self.instance, &IN_DOMAIN, 1, &mut value, 1) }, Status::Ok);
        value
    }

    fn save(&self) -> *mut c_void {
        let mut state = null_mut();
        assert_eq!(unsafe { fmi3GetFMUState(self.instance, &mut state) }, Status::Ok);
        assert!(!state.is_null());
        state
    }

    fn restore(&self, state: *mut c_void) -> Status {
        unsafe { fmi3SetFMUState(self.instance, state) }
    }

    fn free_state(&self, mut state: *mut c_void) {
        assert_eq!(unsafe { fmi3FreeFMUState(self.instance, &mut state) }, Status::Ok);
        assert!(state.is_null());
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        unsafe { fmi3FreeInstance(self.instance) }
    }
}

/// A native path as a C string.
fn path(path: &Path) -> std::ffi::CString {
    c_string(path.to_str().unwrap())
}
