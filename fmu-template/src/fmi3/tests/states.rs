use super::*;

/// Function, what it answers where it is allowed, and the states where the standard allows it, by the letters of
/// [`STATES`]; behind a space the interface if it is only one: `c`o-simulation or `m`odel exchange.
type Row = (&'static str, fn(*mut c_void) -> Status, Status, &'static str);

const STATES: [(char, InstanceState); 6] = [
    ('I', InstanceState::Instantiated),
    ('N', InstanceState::Initialization),
    ('V', InstanceState::Event),
    ('C', InstanceState::ContinuousTime),
    ('S', InstanceState::Step),
    ('T', InstanceState::Terminated),
];

#[rustfmt::skip]
pub(super) const TABLE: [Row; 70] = {
    use Status::{Error, Ok};
    macro_rules! c { ($function:ident $(, $argument:expr)*) => { |c| unsafe { $function(c $(, $argument)*) } } }
    [
        ("SetDebugLogging",                 c!(fmi3SetDebugLogging, 0, 0, null()),                                                 Ok,    "INVCST"),
        ("EnterConfigurationMode",          c!(fmi3EnterConfigurationMode),                                                        Ok,    "IVS"),
        ("ExitConfigurationMode",           c!(fmi3ExitConfigurationMode),                                                         Ok,    "IVS"),
        ("EnterInitializationMode",         c!(fmi3EnterInitializationMode, 0, 0.0, 0.0, 0, 0.0),                                  Ok,    "I"),
        ("ExitInitializationMode",          c!(fmi3ExitInitializationMode),                                                        Ok,    "N"),
        ("EnterEventMode",                  c!(fmi3EnterEventMode),                                                                Ok,    "VCS"),
        ("Terminate",                       c!(fmi3Terminate),                                                                     Ok,    "INVCST"),
        ("Reset",                           c!(fmi3Reset),                                                                         Ok,    "INVCST"),
        ("GetFloat64",                      c!(fmi3GetFloat64, &1, 1, &mut 0.0, 1),                                                 Ok,    "INVCST"),
        ("GetInt32",                        c!(fmi3GetInt32, &6, 1, &mut 0, 1),                                                    Ok,    "INVCST"),
        ("GetBoolean",                      c!(fmi3GetBoolean, null(), 0, null_mut(), 0),                                          Ok,    "INVCST"),
        ("GetFloat32",                      c!(fmi3GetFloat32, null(), 0, null_mut(), 0),                                          Ok,    "INVCST"),
        ("GetInt8",                         c!(fmi3GetInt8, null(), 0, null_mut(), 0),                                             Ok,    "INVCST"),
        ("GetUInt8",                        c!(fmi3GetUInt8, null(), 0, null_mut(), 0),                                            Ok,    "INVCST"),
        ("GetInt16",                        c!(fmi3GetInt16, null(), 0, null_mut(), 0),                                            Ok,    "INVCST"),
        ("GetUInt16",                       c!(fmi3GetUInt16, null(), 0, null_mut(), 0),                                           Ok,    "INVCST"),
        ("GetUInt32",                       c!(fmi3GetUInt32, null(), 0, null_mut(), 0),                                           Ok,    "INVCST"),
        ("GetInt64",                        c!(fmi3GetInt64, null(), 0, null_mut(), 0),                                            Ok,    "INVCST"),
        ("GetUInt64",                       c!(fmi3GetUInt64, null(), 0, null_mut(), 0),                                           Ok,    "INVCST"),
        ("GetString",                       c!(fmi3GetString, null(), 0, null_mut(), 0),                                           Ok,    "INVCST"),
        ("GetBinary",                       c!(fmi3GetBinary, null(), 0, null_mut(), null_mut(), 0),                               Ok,    "INVCST"),
        ("SetFloat64",                      c!(fmi3SetFloat64, null(), 0, null(), 0),                                              Ok,    "INVCS"),
        ("SetInt32",                        c!(fmi3SetInt32, null(), 0, null(), 0),                                                Ok,    "INVCS"),
        ("SetBoolean",                      c!(fmi3SetBoolean, null(), 0, null(), 0),                                              Ok,    "INVCS"),
        ("SetFloat32",                      c!(fmi3SetFloat32, null(), 0, null(), 0),                                              Ok,    "INVCS"),
        ("SetInt8",                         c!(fmi3SetInt8, null(), 0, null(), 0),                                                 Ok,    "INVCS"),
        ("SetUInt8",                        c!(fmi3SetUInt8, null(), 0, null(), 0),                                                Ok,    "INVCS"),
        ("SetInt16",                        c!(fmi3SetInt16, null(), 0, null(), 0),                                                Ok,    "INVCS"),
        ("SetUInt16",                       c!(fmi3SetUInt16, null(), 0, null(), 0),                                               Ok,    "INVCS"),
        ("SetUInt32",                       c!(fmi3SetUInt32, null(), 0, null(), 0),                                               Ok,    "INVCS"),
        ("SetInt64",                        c!(fmi3SetInt64, null(), 0, null(), 0),                                                Ok,    "INVCS"),
        ("SetUInt64",                       c!(fmi3SetUInt64, null(), 0, null(), 0),                                               Ok,    "INVCS"),
        ("SetString",                       c!(fmi3SetString, null(), 0, null(), 0),                                               Ok,    "INVCS"),
        ("SetBinary",                       c!(fmi3SetBinary, null(), 0, null(), null(), 0),                                       Ok,    "INVCS"),
        ("GetClock",                        c!(fmi3GetClock, null(), 0, null_mut()),                                               Ok,    "V"),
        ("SetClock",                        c!(fmi3SetClock, null(), 0, null()),                                                   Ok,    "V"),
        ("GetNumberOfVariableDependencies", c!(fmi3GetNumberOfVariableDependencies, 4, &mut 0),                                    Ok,    "INVCST"),
        ("GetVariableDependencies",         c!(fmi3GetVariableDependencies, 1, null_mut(), null_mut(), null_mut(), null_mut(), 0), Ok,    "INVCST"),
        ("GetFMUState",                     get_and_free_state,                                                                    Ok,    "INVCST"),
        ("SetFMUState",                     c!(fmi3SetFMUState, null_mut()),                                                       Error, "INVCST"),
        ("FreeFMUState",                    c!(fmi3FreeFMUState, null_mut()),                                                      Ok,    "INVCST"),
        ("SerializedFMUStateSize",          c!(fmi3SerializedFMUStateSize, null_mut(), null_mut()),                                Error, "INVCST"),
        ("SerializeFMUState",               c!(fmi3SerializeFMUState, null_mut(), null_mut(), 0),                                  Error, "INVCST"),
        ("DeserializeFMUState",             c!(fmi3DeserializeFMUState, null(), 0, null_mut()),                                    Error, "INVCST"),
        ("GetDirectionalDerivative",        c!(fmi3GetDirectionalDerivative, &4, 1, &1, 1, &1.0, 1, &mut 0.0, 1),                  Ok,    "NVCST"),
        ("GetAdjointDerivative",            c!(fmi3GetAdjointDerivative, &4, 1, &1, 1, &1.0, 1, &mut 0.0, 1),                      Ok,    "NVCST"),
        ("GetIntervalDecimal",              c!(fmi3GetIntervalDecimal, null(), 0, null_mut(), null_mut()),                         Ok,    "NV"),
        ("GetIntervalFraction",             c!(fmi3GetIntervalFraction, null(), 0, null_mut(), null_mut(), null_mut()),            Ok,    "NV"),
        ("GetShiftDecimal",                 c!(fmi3GetShiftDecimal, null(), 0, null_mut()),                                        Ok,    "N"),
        ("GetShiftFraction",                c!(fmi3GetShiftFraction, null(), 0, null_mut(), null_mut()),                           Ok,    "N"),
        ("SetIntervalDecimal",              c!(fmi3SetIntervalDecimal, null(), 0, null()),                                         Ok,    "NV"),
        ("SetIntervalFraction",             c!(fmi3SetIntervalFraction, null(), 0, null(), null()),                                Ok,    "NV"),
        ("SetShiftDecimal",                 c!(fmi3SetShiftDecimal, null(), 0, null()),                                            Ok,    "N"),
        ("SetShiftFraction",                c!(fmi3SetShiftFraction, null(), 0, null(), null()),                                   Ok,    "N"),
        ("EvaluateDiscreteStates",          c!(fmi3EvaluateDiscreteStates),                                                        Ok,    "V"),
        ("UpdateDiscreteStates",            c!(fmi3UpdateDiscreteStates, &mut 1, &mut 1, &mut 1, &mut 1, &mut 1, &mut 0.0),        Ok,    "V"),
        ("EnterContinuousTimeMode",         c!(fmi3EnterContinuousTimeMode),                                                       Ok,    "V m"),
        ("CompletedIntegratorStep",         c!(fmi3CompletedIntegratorStep, 1, &mut 1, &mut 1),                                    Ok,    "C"),
        ("SetTime",                         c!(fmi3SetTime, 0.5),                                                                  Ok,    "VC m"),
        ("SetContinuousStates",             c!(fmi3SetContinuousStates, null(), 0),                                                Ok,    "NVC m"),
        ("GetContinuousStateDerivatives",   c!(fmi3GetContinuousStateDerivatives, null_mut(), 0),                                  Ok,    "NVCT m"),
        ("GetEventIndicators",              c!(fmi3GetEventIndicators, null_mut(), 0),                                             Ok,    "NVCT m"),
        ("GetContinuousStates",             c!(fmi3GetContinuousStates, null_mut(), 0),                                            Ok,    "NVCT m"),
        ("GetNominalsOfContinuousStates",   c!(fmi3GetNominalsOfContinuousStates, null_mut(), 0),                                  Ok,    "NVCT m"),
        ("GetNumberOfEventIndicators",      c!(fmi3GetNumberOfEventIndicators, &mut 1),                                            Ok,    "INVCT m"),
        ("GetNumberOfContinuousStates",     c!(fmi3GetNumberOfContinuousStates, &mut 1),                                           Ok,    "INVCT m"),
        ("EnterStepMode",                   c!(fmi3EnterStepMode),                                                                 Ok,    "V c"),
        ("GetOutputDerivatives",            c!(fmi3GetOutputDerivatives, &4, 1, &1, &mut 0.0, 1),                                  Ok,    "ST c"),
        ("DoStep",                          c!(fmi3DoStep, 0.0, 0.01, 1, &mut 1, &mut 1, &mut 1, &mut 0.0),                        Ok,    "S"),
        ("ActivateModelPartition",          c!(fmi3ActivateModelPartition, 0, 0.0),                                                Error, ""),
    ]
};

fn get_and_free_state(instance: *mut c_void) -> Status {
    let mut state = null_mut();
    unsafe {
        let status = fmi3GetFMUState(instance, &mut state);
        fmi3FreeFMUState(instance, &mut state);
        status
    }
}

#[test]
fn the_c_header_has_the_table_of_legal_calls() {
    crate::calls::check(Function::ALL);
}

#[test]
fn every_function_is_allowed_in_the_states_of_its_row_and_no_other() {
    for (name, function, answer, allowed) in TABLE {
        let (allowed, interface) = allowed.split_once(' ').unwrap_or((allowed, "cm"));
        for (use_as, reached, letter) in [(Use::StepsAndEvents, "INVST", 'c'), (Use::Solver, "INVCT", 'm')] {
            let legal = |state| allowed.contains(state) && interface.contains(letter);
            for (state_letter, state) in STATES.into_iter().filter(|(letter, _)| reached.contains(*letter)) {
                let host = Host::in_state(use_as, state);
                let status = function(host.instance);
                let messages = host.messages();
                let refused: Vec<_> = messages.iter().filter(|m| m.text.contains("not allowed in state")).collect();
                if legal(state_letter) {
                    assert_eq!((status, refused.len()), (answer, 0), "{name} in {state}, {use_as:?}: {refused:?}");
                } else {
                    assert_eq!((status, refused.len()), (Status::Error, 1), "{name} in {state}, {use_as:?}");
                    assert!(refused[0].text.starts_with(&format!("fmi3{name}: not allowed in state `{state}`")));
                    assert_eq!(host.state(), state, "{name} in {state}");
                }
            }
        }
    }
}

#[test]
fn before_the_initialization_start_values_can_be_read_and_nothing_that_is_calculated() {
    // parameters and the policy, then the time, outputs, the two of the domain
    let instantiated = || Host::in_state(Use::Steps, InstanceState::Instantiated);
    let host = instantiated();
    assert_eq!(host.set(&[LENGTH], &[0.12]), Status::Ok);
    assert_eq!(host.try_get([LENGTH, SPEED]), Ok([0.12, starts()[1]]));
    assert_eq!(unsafe { fmi3GetInt32(host.instance, &POLICY, 1, &mut 0, 1) }, Status::Ok);
    for reference in [TIME, ANGLE, VELOCITY, DISTANCE] {
        let host = instantiated();
        assert_eq!(host.try_get([LENGTH, reference]), Err(Status::Error), "{reference}");
        assert!(host.message().ends_with("has no start value: it can be read from Initialization Mode on"));
    }
    assert_eq!(unsafe { fmi3GetBoolean(host.instance, &IN_DOMAIN, 1, &mut 0, 1) }, Status::Error);
    assert!(host.message().contains("`in_domain` (value reference 7) has no start value"));
    let host = Host::in_state(Use::Steps, InstanceState::Initialization);
    assert!(host.try_get([LENGTH, SPEED, TIME, ANGLE, VELOCITY, DISTANCE]).is_ok());
    assert_eq!(unsafe { fmi3GetBoolean(host.instance, &IN_DOMAIN, 1, &mut 0, 1) }, Status::Ok);
}

#[test]
fn after_a_panic_the_instance_answers_fatal_and_can_still_be_freed() {
    for (name, function, ..) in TABLE {
        let host = Host::in_state(Use::Steps, InstanceState::Fatal);
        assert_eq!(function(host.instance), Status::Fatal, "{name}");
    }
}

#[test]
fn a_null_instance_is_an_error_and_freeing_it_is_fine() {
    for (name, function, ..) in TABLE {
        assert_eq!(function(null_mut()), Status::Error, "{name}");
    }
    unsafe { fmi3FreeInstance(null_mut()) };
}

#[test]
fn event_mode_is_for_hosts_that_said_they_use_it() {
    let host = Host::in_state(Use::Steps, InstanceState::Step);
    assert_eq!(host.event_mode(), Status::Error);
    assert!(host.message().contains("eventModeUsed = false"));
    let host = Host::in_state(Use::StepsAndEvents, InstanceState::Event);
    assert_eq!(host.update(), ([0; 5], Status::Ok));
    assert_eq!(host.step_mode(), Status::Ok);
    assert_eq!(host.step(0.0, 0.5), Status::Ok);
    assert_eq!(host.event_mode(), Status::Ok);
    assert_eq!(host.step(0.5, 0.5), Status::Error);
}

#[test]
fn after_a_refused_call_the_instance_is_as_it_was() {
    let host = Host::in_state(Use::Steps, InstanceState::Step);
    assert_eq!(host.step(0.0, -1.0), Status::Error);
    assert_eq!(host.step(0.0, f64::NAN), Status::Error);
    assert_eq!(host.set(&[77], &[0.0]), Status::Error);
    assert_eq!(host.state(), InstanceState::Step);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
}

#[test]
fn after_the_end_of_a_run_a_reset_or_a_stored_state_begins_another() {
    let host = Host::in_state(Use::Steps, InstanceState::Instantiated);
    let state = host.save();
    let forbid_what_is_outside = || {
        assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok);
        assert_eq!(unsafe { fmi3SetInt32(host.instance, &POLICY, 1, &2, 1) }, Status::Error);
        assert_eq!((host.state(), host.enter(0.0)), (InstanceState::Terminated, Status::Error));
    };
    forbid_what_is_outside();
    assert_eq!(host.restore(state), Status::Ok);
    host.free_state(state);
    forbid_what_is_outside();
    assert_eq!(host.reset(), Status::Ok);
    assert_eq!((host.enter(0.0), host.exit(), host.step(0.0, 0.1)), (Status::Ok, Status::Ok, Status::Ok));
}

#[test]
fn a_stop_time_of_infinity_is_no_stop_time() {
    let host = Host::in_state(Use::Steps, InstanceState::Instantiated);
    let enter = unsafe { fmi3EnterInitializationMode(host.instance, 0, 0.0, 0.0, 1, f64::INFINITY) };
    assert_eq!((enter, host.exit(), host.step(0.0, 0.1)), (Status::Ok, Status::Ok, Status::Ok));
}

#[test]
fn times_of_the_experiment_that_make_no_sense_are_refused() {
    let (nan, infinity) = (f64::NAN, f64::INFINITY);
    for (start, stop) in [(nan, 1.0), (infinity, 1.0), (0.0, nan), (0.0, -infinity), (1.0, 0.5)] {
        let host = Host::in_state(Use::Steps, InstanceState::Instantiated);
        let status = unsafe { fmi3EnterInitializationMode(host.instance, 0, 0.0, start, 1, stop) };
        assert_eq!(status, Status::Error, "{start} {stop}");
    }
}
