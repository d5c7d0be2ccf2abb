use super::*;

/// Function, what it answers where it is allowed, and the states where the standard allows it in co-simulation and in
/// model exchange, by the letters of [`STATES`].
type Row = (&'static str, fn(*mut c_void) -> Status, Status, &'static str, &'static str);

const STATES: [(char, InstanceState); 7] = [
    ('I', InstanceState::Instantiated),
    ('N', InstanceState::Initialization),
    ('V', InstanceState::Event),
    ('C', InstanceState::ContinuousTime),
    ('S', InstanceState::Step),
    ('T', InstanceState::Terminated),
    ('E', InstanceState::Error),
];

#[rustfmt::skip]
pub(super) const TABLE: [Row; 40] = {
    use Status::{Discard, Error, Ok};
    macro_rules! c { ($function:ident $(, $argument:expr)*) => { |c| unsafe { $function(c $(, $argument)*) } } }
    [
        ("SetDebugLogging",               c!(fmi2SetDebugLogging, 0, 0, null()),                          Ok,      "INSTE", "INVCTE"),
        ("SetupExperiment",               c!(fmi2SetupExperiment, 0, 0.0, 0.0, 0, 0.0),                   Ok,      "I",     "I"),
        ("EnterInitializationMode",       enter_after_setup,                                              Ok,      "I",     "I"),
        ("ExitInitializationMode",        c!(fmi2ExitInitializationMode),                                 Ok,      "N",     "N"),
        ("Terminate",                     c!(fmi2Terminate),                                              Ok,      "INSTE", "INVCTE"),
        ("Reset",                         c!(fmi2Reset),                                                  Ok,      "INSTE", "INVCTE"),
        ("GetReal",                       c!(fmi2GetReal, [1, 2].as_ptr(), 2, [0.0; 2].as_mut_ptr()),     Ok,      "INSTE", "INVCTE"),
        ("GetInteger",                    c!(fmi2GetInteger, [6].as_ptr(), 1, &mut 0),                    Ok,      "INSTE", "INVCTE"),
        ("GetBoolean",                    c!(fmi2GetBoolean, null(), 0, null_mut()),                      Ok,      "INSTE", "INVCTE"),
        ("GetString",                     c!(fmi2GetString, null(), 0, null_mut()),                       Ok,      "INSTE", "INVCTE"),
        ("SetReal",                       c!(fmi2SetReal, null(), 0, null()),                             Ok,      "INS",   "INVC"),
        ("SetInteger",                    c!(fmi2SetInteger, [6].as_ptr(), 1, &1),                        Ok,      "INS",   "INV"),
        ("SetBoolean",                    c!(fmi2SetBoolean, null(), 0, null()),                          Ok,      "INS",   "INV"),
        ("SetString",                     c!(fmi2SetString, null(), 0, null()),                           Ok,      "INS",   "INV"),
        ("GetFMUstate",                   get_and_free_state,                                             Ok,      "INSTE", "INVCTE"),
        ("SetFMUstate",                   c!(fmi2SetFMUstate, null_mut()),                                Error,   "INSTE", "INVCTE"),
        ("FreeFMUstate",                  c!(fmi2FreeFMUstate, null_mut()),                               Ok,      "INSTE", "INVCTE"),
        ("SerializedFMUstateSize",        c!(fmi2SerializedFMUstateSize, null_mut(), null_mut()),         Error,   "INSTE", "INVCTE"),
        ("SerializeFMUstate",             c!(fmi2SerializeFMUstate, null_mut(), null_mut(), 0),           Error,   "INSTE", "INVCTE"),
        ("DeSerializeFMUstate",           c!(fmi2DeSerializeFMUstate, null(), 0, null_mut()),             Error,   "INSTE", "INVCTE"),
        ("GetDirectionalDerivative",      c!(fmi2GetDirectionalDerivative, &4, 1, &1, 1, &1.0, &mut 0.0), Ok,      "NSTE",  "NVCTE"),
        ("SetRealInputDerivatives",       c!(fmi2SetRealInputDerivatives, null(), 0, null(), null()),     Ok,      "INS",   ""),
        ("GetRealOutputDerivatives",      c!(fmi2GetRealOutputDerivatives, &4, 1, &1, &mut 0.0),          Ok,      "STE",   ""),
        ("DoStep",                        c!(fmi2DoStep, 0.0, 0.01, 1),                                   Ok,      "S",     ""),
        ("CancelStep",                    c!(fmi2CancelStep),                                             Error,   "",      ""),
        ("GetStatus",                     c!(fmi2GetStatus, 0, null_mut()),                               Discard, "ST",    ""),
        ("GetRealStatus",                 c!(fmi2GetRealStatus, 2, &mut 0.0),                             Ok,      "ST",    ""),
        ("GetIntegerStatus",              c!(fmi2GetIntegerStatus, 2, null_mut()),                        Discard, "ST",    ""),
        ("GetBooleanStatus",              c!(fmi2GetBooleanStatus, 3, &mut 1),                            Ok,      "ST",    ""),
        ("GetStringStatus",               c!(fmi2GetStringStatus, 1, null_mut()),                         Discard, "ST",    ""),
        ("EnterEventMode",                c!(fmi2EnterEventMode),                                         Ok,      "",      "VC"),
        ("NewDiscreteStates",             c!(fmi2NewDiscreteStates, &mut EventInfo::default()),           Ok,      "",      "V"),
        ("EnterContinuousTimeMode",       c!(fmi2EnterContinuousTimeMode),                                Ok,      "",      "V"),
        ("CompletedIntegratorStep",       c!(fmi2CompletedIntegratorStep, 1, &mut 1, &mut 1),             Ok,      "",      "C"),
        ("SetTime",                       c!(fmi2SetTime, 0.5),                                           Ok,      "",      "IVC"),
        ("SetContinuousStates",           c!(fmi2SetContinuousStates, null(), 0),                         Ok,      "",      "NVC"),
        ("GetEventIndicators",            c!(fmi2GetEventIndicators, null_mut(), 0),                      Ok,      "",      "NVCTE"),
        ("GetContinuousStates",           c!(fmi2GetContinuousStates, null_mut(), 0),                     Ok,      "",      "NVCTE"),
        ("GetDerivatives",                c!(fmi2GetDerivatives, null_mut(), 0),                          Ok,      "",      "NVCTE"),
        ("GetNominalsOfContinuousStates", c!(fmi2GetNominalsOfContinuousStates, null_mut(), 0),           Ok,      "",      "INVCTE"),
    ]
};

fn enter_after_setup(c: *mut c_void) -> Status {
    unsafe {
        if (*c.cast::<Component>()).instance.snapshot().state == InstanceState::Instantiated {
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
fn the_c_header_has_the_table_of_legal_calls() {
    crate::calls::check(Function::ALL);
}

#[test]
fn every_function_is_allowed_in_the_states_of_its_row_and_no_other() {
    for (name, function, answer, co_simulation, model_exchange) in TABLE {
        for (kind, reached, allowed) in
            [(CO_SIMULATION, "INSTE", co_simulation), (MODEL_EXCHANGE, "INVCTE", model_exchange)]
        {
            for (letter, state) in STATES.into_iter().filter(|(letter, _)| reached.contains(*letter)) {
                let host = Host::of_kind_in_state(kind, state);
                let status = function(host.c);
                let messages = host.messages();
                let refused: Vec<_> = messages.iter().filter(|m| m.text.contains("not allowed in state")).collect();
                if allowed.contains(letter) {
                    assert_eq!((status, refused.len()), (answer, 0), "{name} in {state} of {kind}: {refused:?}");
                } else {
                    assert_eq!((status, refused.len()), (Status::Error, 1), "{name} in {state} of {kind}");
                    assert!(refused[0].text.starts_with(&format!("fmi2{name}: not allowed in state `{state}`")));
                    assert_eq!(host.state(), state, "{name} in {state}");
                }
            }
        }
    }
}

#[test]
fn after_a_panic_the_instance_answers_fatal_and_can_still_be_freed() {
    for (name, function, ..) in TABLE {
        let host = Host::in_state(InstanceState::Fatal);
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
fn without_an_experiment_the_run_begins_at_zero_or_at_the_time_that_was_set() {
    let host = Host::new();
    assert_eq!((host.enter(), host.exit(), host.step(0.0, 0.1)), (Status::Ok, Status::Ok, Status::Ok));
    let host = Host::of_kind(&example::surrogate(), MODEL_EXCHANGE);
    assert_eq!((host.set_time(0.5), host.enter(), host.exit()), (Status::Ok, Status::Ok, Status::Ok));
    assert_eq!(host.try_get([TIME]), Ok([0.5]));
}

#[test]
fn a_stop_time_of_infinity_is_no_stop_time() {
    let host = Host::new();
    assert_eq!(host.set_up_until(0.0, f64::INFINITY), Status::Ok);
    assert_eq!((host.enter(), host.exit(), host.step(0.0, 0.1)), (Status::Ok, Status::Ok, Status::Ok));
}

#[test]
fn before_the_initialization_start_values_can_be_read_and_nothing_that_is_calculated() {
    let host = Host::new();
    assert!(host.try_get([LENGTH, SPEED]).is_ok());
    assert_eq!(host.try_get([ANGLE]), Err(Status::Error));
    assert!(host.message().ends_with("has no start value: it can be read from Initialization Mode on"));
    assert_eq!(host.state(), InstanceState::Instantiated);
}

#[test]
fn after_a_refused_call_the_instance_is_as_it_was() {
    let host = Host::stepping();
    let before = host.outputs();
    assert_eq!(host.step(0.0, -1.0), Status::Error);
    assert_eq!(host.set(&[77], &[0.0]), Status::Error);
    assert_eq!(host.exit(), Status::Error);
    assert_eq!((host.state(), host.outputs()), (InstanceState::Step, before));
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
}

#[test]
fn after_the_end_of_a_run_a_reset_or_a_stored_state_begins_another() {
    let host = Host::stepping();
    assert_eq!(host.set_policy(2), Status::Ok);
    let state = host.save();
    let leave_domain = || assert_eq!(host.step(0.0, 100.0), Status::Error);
    leave_domain();
    assert_eq!(host.step(0.0, 0.1), Status::Error, "cannot be continued");
    assert_eq!(host.restore(state), Status::Ok);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    assert_eq!(host.restore(state), Status::Ok);
    leave_domain();
    assert_eq!(host.reset(), Status::Ok);
    host.initialize(0.0);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    host.free_state(state);
}
