use super::*;
use crate::component::UpdateCallback;
use metafmu_runtime::Integration;

// value references of the crane
const ROPE: u32 = 1;
const FORCE: u32 = 6;
const X: u32 = 7;
const POSITION: u32 = 14;

/// The longest step of the crane's solver.
const STEP: f64 = 0.005;

/// The crane, whose steps are fixed, or, with a tolerance, error-controlled.
fn crane(tolerance: Option<f64>) -> Surrogate {
    let controlled = |tolerance| Integration::ErrorControlled { tolerance, longest: STEP };
    let integration = tolerance.map_or(Integration::Fixed { step: STEP }, controlled);
    example::integrated(&example::crane(), integration)
}

/// Arguments of the callback so far, and its action.
struct Watcher {
    instance: *mut c_void,
    told: Vec<(f64, [Boolean; 4])>,
    act: fn(*mut c_void, f64) -> Answer,
    x: Vec<f64>,
}

#[derive(Default)]
struct Answer {
    return_at: Option<f64>,
}

unsafe extern "C" fn update(
    environment: *mut c_void,
    time: f64,
    set: Boolean,
    get: Boolean,
    finished: Boolean,
    can_return: Boolean,
    requested: *mut Boolean,
    return_time: *mut f64,
) {
    unsafe {
        let watcher = &mut *environment.cast::<Watcher>();
        watcher.told.push((time, [set, get, finished, can_return]));
        let mut values = [f64::NAN; 2];
        // the time is not one of the crane's columns
        let references = [X, POSITION];
        if fmi3GetFloat64(watcher.instance, references.as_ptr(), 2, values.as_mut_ptr(), 2) == Status::Ok {
            assert_eq!(values[0], values[1], "output and state");
            watcher.x.push(values[0]);
        }
        if let Some(time) = (watcher.act)(watcher.instance, time).return_at {
            (*requested, *return_time) = (1, time);
        }
    }
}

/// A crane that is initialized, with a callback.
struct Crane(Box<Watcher>);

impl Crane {
    fn new(early_return: bool, tolerance: Option<f64>, act: fn(*mut c_void, f64) -> Answer) -> Self {
        let instance = null_mut();
        let mut watcher =
            Box::new(Watcher { instance, told: Vec::with_capacity(999), act, x: Vec::with_capacity(999) });
        watcher.instance =
            instantiate(&crane(tolerance), &mut watcher, early_return, &[X, POSITION, FORCE], Some(update));
        assert!(!watcher.instance.is_null());
        let tolerance = (tolerance.is_some().into(), tolerance.unwrap_or(0.0));
        unsafe {
            assert_eq!(
                fmi3EnterInitializationMode(watcher.instance, tolerance.0, tolerance.1, 1.0, 0, 0.0),
                Status::Ok
            );
            assert_eq!(fmi3ExitInitializationMode(watcher.instance), Status::Ok);
        }
        let crane = Self(watcher);
        assert_eq!(push(crane.0.instance, 5.0), Status::Ok);
        crane
    }

    /// Status, whether it returned early, the time reached.
    fn step(&mut self, from: f64, size: f64) -> (Status, bool, f64) {
        step(self.0.instance, from, size)
    }

    fn states(&self) -> [f64; 4] {
        states(self.0.instance)
    }
}

impl Drop for Crane {
    fn drop(&mut self) {
        unsafe { fmi3FreeInstance(self.0.instance) }
    }
}

fn instantiate(
    surrogate: &Surrogate,
    watcher: &mut Watcher,
    early_return: bool,
    required: &[u32],
    callback: Option<UpdateCallback>,
) -> *mut c_void {
    let folder = Folder::with(surrogate);
    let (environment, resources) = ((&raw mut *watcher).cast(), path(&folder.0));
    let (name, token, allowed) = (c"crane".as_ptr(), TOKEN.as_ptr(), early_return.into());
    let (list, n) = (required.as_ptr(), required.len());
    unsafe {
        fmi3InstantiateCoSimulation(
            name,
            token,
            resources.as_ptr(),
            0,
            0,
            0,
            allowed,
            list,
            n,
            environment,
            None,
            callback,
        )
    }
}

fn step(instance: *mut c_void, from: f64, size: f64) -> (Status, bool, f64) {
    let (mut told, mut time) = ([9; 3], f64::NAN);
    let [event, end, early] = &mut told;
    let status = unsafe { fmi3DoStep(instance, from, size, 1, event, end, early, &mut time) };
    assert!(status == Status::Error || told[..2] == [0, 0]);
    (status, told[2] == 1, time)
}

fn push(instance: *mut c_void, force: f64) -> Status {
    unsafe { fmi3SetFloat64(instance, &FORCE, 1, &force, 1) }
}

fn states(instance: *mut c_void) -> [f64; 4] {
    let (references, mut values) = ([POSITION, 15, 16, 17], [f64::NAN; 4]);
    unsafe { assert_eq!(fmi3GetFloat64(instance, references.as_ptr(), 4, values.as_mut_ptr(), 4), Status::Ok) };
    values
}

fn nothing(_: *mut c_void, _: f64) -> Answer {
    Answer::default()
}

fn close(found: &[f64], expected: &[f64]) -> bool {
    found.len() == expected.len()
        && found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12)
}

/// The states after a step from one second on without a callback, of half a solver's step at a time if the force changes.
fn alone(size: f64, tolerance: Option<f64>) -> [f64; 4] {
    let host = Host::of(&crane(tolerance), Use::Steps);
    let (defined, tolerance) = (tolerance.is_some().into(), tolerance.unwrap_or(0.0));
    unsafe { assert_eq!(fmi3EnterInitializationMode(host.instance, defined, tolerance, 1.0, 0, 0.0), Status::Ok) };
    assert_eq!((host.exit(), push(host.instance, 5.0), host.step(1.0, size)), (Status::Ok, Status::Ok, Status::Ok));
    states(host.instance)
}

#[test]
fn the_host_sees_the_outputs_after_each_step_of_the_solver() {
    let mut crane = Crane::new(true, None, nothing);
    assert_eq!(crane.step(1.0, 0.0175), (Status::Ok, false, 1.0175));
    let times: Vec<f64> = crane.0.told.iter().map(|(time, _)| *time).collect();
    assert!(close(&times, &[1.004375, 1.00875, 1.013125, 1.0175]), "{times:?}");
    assert!(crane.0.told[..3].iter().all(|(_, flags)| *flags == [1, 1, 1, 1]), "{:?}", crane.0.told);
    assert_eq!(crane.0.told[3].1, [1, 1, 1, 0], "the end is not early");
    let expected = [0.004375, 0.00875, 0.013125, 0.0175].map(|size| alone(size, None)[0]);
    assert!(close(&crane.0.x, &expected), "{:?} {expected:?}", crane.0.x);
    assert!(close(&crane.states(), &alone(0.0175, None)));
    assert_eq!(crane.step(1.0175, 0.002), (Status::Ok, false, 1.0195));
    assert_eq!(crane.0.told.len(), 5);
    // with error control the solver begins anew at each of them
    let mut crane = Crane::new(false, Some(1e-9), nothing);
    assert_eq!(crane.step(1.0, 0.5), (Status::Ok, false, 1.5));
    assert_eq!((crane.0.told.len(), crane.0.told[7].1), (100, [1, 1, 1, 0]));
    let expected = alone(0.5, Some(1e-12));
    assert!(crane.states().iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-8));
}

#[test]
fn a_state_beyond_every_plausible_value_discards_the_step() {
    let far = example::crane().states()[0].limit() - 0.1;
    for tolerance in [None, Some(1e-6)] {
        let host = Host::of(&crane(tolerance), Use::Steps);
        let (starts, values) = ([2, 3, 4, 5], [far, 0.5, 2.0, 0.3]);
        unsafe { assert_eq!(fmi3SetFloat64(host.instance, starts.as_ptr(), 4, values.as_ptr(), 4), Status::Ok) };
        assert_eq!((host.enter(1.0), host.exit(), host.step(1.0, 0.2)), (Status::Ok, Status::Ok, Status::Discard));
        assert_eq!(states(host.instance), values, "as before");
    }
}

#[test]
fn inputs_that_are_set_in_between_count_from_there_on() {
    let mut crane = Crane::new(false, None, |instance, time| {
        assert_eq!(push(instance, 100.0 * (time - 1.0)), Status::Ok);
        Answer::default()
    });
    assert_eq!(crane.step(1.0, 4.0 * STEP).0, Status::Ok);
    let host = Host::of(&example::crane(), Use::Steps);
    assert_eq!((host.enter(1.0), host.exit()), (Status::Ok, Status::Ok));
    for index in 0..4 {
        let since = f64::from(index) * STEP;
        assert_eq!(push(host.instance, if index == 0 { 5.0 } else { 100.0 * since }), Status::Ok);
        assert_eq!(host.step(1.0 + since, STEP), Status::Ok);
    }
    assert!(close(&crane.states(), &states(host.instance)));
    // the last one remains
    let mut force = 0.0;
    unsafe { assert_eq!(fmi3GetFloat64(crane.0.instance, &FORCE, 1, &mut force, 1), Status::Ok) };
    assert!((force - 2.0).abs() < 1e-12);
}

#[test]
fn a_step_ends_early_where_the_host_wants_it() {
    let at = |early_return: bool, act: fn(*mut c_void, f64) -> Answer| {
        let mut crane = Crane::new(early_return, None, act);
        let (status, early, time) = crane.step(1.0, 0.02);
        assert_eq!(status, Status::Ok);
        // whose steps of the solver are others
        let mut pairs = crane.states().into_iter().zip(alone(time - 1.0, None));
        assert!(pairs.all(|(found, expected)| (found - expected).abs() < 1e-9), "{time}");
        // and continues from there
        let (status, _, end) = crane.step(time, 0.001);
        assert_eq!((status, end), (Status::Ok, time + 0.001));
        (early, ((time - 1.0) * 1e6).round())
    };
    for (act, expected) in [
        ((|_, time| Answer { return_at: (time > 1.007).then_some(time) }) as fn(*mut c_void, f64) -> Answer, 10_000.0),
        (|_, time| Answer { return_at: Some(time + 0.003) }, 8_000.0),
        (|_, time| Answer { return_at: (time < 1.006).then_some(1.0125) }, 12_500.0),
        (|_, _| Answer { return_at: Some(f64::NAN) }, 5_000.0),
        (|_, _| Answer { return_at: Some(0.0) }, 5_000.0),
        (|_, _| Answer { return_at: Some(9.0) }, 20_000.0),
    ] {
        let (early, time) = at(true, act);
        assert_eq!((early, time), (expected < 20_000.0, expected));
        assert_eq!(at(false, act), (false, 20_000.0), "where it was not allowed");
    }
}

#[test]
fn calls_that_the_mode_does_not_have_change_nothing() {
    let refused: [fn(*mut c_void, f64) -> Answer; 4] = [
        |instance, _| {
            assert_eq!(unsafe { fmi3GetFMUState(instance, &mut null_mut()) }, Status::Error);
            Answer::default()
        },
        |instance, time| {
            assert_eq!(step(instance, time, 0.1).0, Status::Error);
            Answer::default()
        },
        |instance, _| {
            assert_eq!(unsafe { fmi3EnterEventMode(instance) }, Status::Error);
            Answer::default()
        },
        |instance, _| {
            assert_eq!(unsafe { fmi3SetFloat64(instance, &ROPE, 1, &1.25, 1) }, Status::Error, "a parameter");
            Answer { return_at: Some(0.0) }
        },
    ];
    for act in refused {
        let mut crane = Crane::new(true, None, act);
        assert_eq!(crane.step(1.0, 0.02).0, Status::Ok);
        let state = unsafe { (*crane.0.instance.cast::<Component>()).instance.snapshot().state };
        assert_eq!(state, InstanceState::Step);
    }
    let mut crane = Crane::new(true, None, |instance, _| {
        let (mut slope, mut count) = (f64::NAN, 0);
        unsafe {
            assert_eq!(fmi3GetOutputDerivatives(instance, &X, 1, &1, &mut slope, 1), Status::Ok);
            assert_eq!(fmi3GetNumberOfVariableDependencies(instance, X, &mut count), Status::Ok);
        }
        assert!(slope.is_finite() && count > 0);
        Answer::default()
    });
    assert_eq!(crane.step(1.0, 0.02).0, Status::Ok);
}

#[test]
fn a_step_that_cannot_be_made_leaves_everything_as_it_was() {
    let mut crane = Crane::new(false, None, |instance, _| {
        assert_eq!(push(instance, 1e307), Status::Ok, "far outside of the range");
        Answer::default()
    });
    let before = crane.states();
    let (status, early, time) = crane.step(1.0, 0.1);
    assert_eq!((status, early, time), (Status::Discard, false, 1.0));
    assert_eq!(crane.0.told.len(), 1, "a part was made");
    assert_eq!(crane.states(), before);
    let mut force = 0.0;
    unsafe { assert_eq!(fmi3GetFloat64(crane.0.instance, &FORCE, 1, &mut force, 1), Status::Ok) };
    assert_eq!(force, 5.0);
}

#[test]
fn nothing_is_allocated_in_a_step_with_updates() {
    let mut crane = Crane::new(true, None, |instance, time| {
        assert_eq!(push(instance, 10.0 * (time - 1.0)), Status::Ok);
        Answer::default()
    });
    crane.step(1.0, 0.1);
    let before = allocations().0;
    let (status, ..) = crane.step(1.1, 0.1);
    assert_eq!((status, allocations().0), (Status::Ok, before));
    assert_eq!(crane.0.told.len(), 40);
}

#[test]
fn a_model_without_states_never_calls_back() {
    let mut watcher = Watcher { instance: null_mut(), told: Vec::new(), act: nothing, x: Vec::new() };
    let instance = instantiate(&example::with_input(), &mut watcher, true, &[OUTPUTS[0]], Some(update));
    unsafe {
        assert_eq!(fmi3EnterInitializationMode(instance, 0, 0.0, 0.0, 0, 0.0), Status::Ok);
        assert_eq!(fmi3ExitInitializationMode(instance), Status::Ok);
        assert_eq!(step(instance, 0.0, 0.5), (Status::Ok, false, 0.5));
        fmi3FreeInstance(instance);
    }
    assert!(watcher.told.is_empty());
}

#[test]
fn every_variable_may_be_named_for_intermediate_updates_and_read_there() {
    let mut watcher = Watcher { instance: null_mut(), told: Vec::new(), act: nothing, x: Vec::new() };
    for reference in 1..25 {
        let instance = instantiate(&example::crane(), &mut watcher, true, &[X, reference], Some(update));
        assert!(!instance.is_null(), "{reference}");
        unsafe { fmi3FreeInstance(instance) };
    }
    for unknown in [0, 999] {
        assert!(instantiate(&example::crane(), &mut watcher, true, &[X, unknown], Some(update)).is_null());
    }
    // without a callback nobody asks for them
    let instance = instantiate(&example::crane(), &mut watcher, true, &[999], None);
    assert!(!instance.is_null());
    unsafe { fmi3FreeInstance(instance) };
    let mut crane = Crane::new(true, None, |instance, _| {
        let (mut inside, mut distance) = (0, f64::NAN);
        unsafe {
            assert_eq!(fmi3GetBoolean(instance, &23, 1, &mut inside, 1), Status::Ok);
            assert_eq!(fmi3GetFloat64(instance, &24, 1, &mut distance, 1), Status::Ok);
        }
        assert_eq!((inside, distance), (1, 0.0));
        Answer::default()
    });
    assert_eq!(crane.step(1.0, 0.02).0, Status::Ok);
}
