use super::*;

#[test]
fn the_version_is_the_standards() {
    assert_eq!(unsafe { CStr::from_ptr(fmi3GetVersion()) }, c"3.0");
}

#[test]
fn resource_paths_with_and_without_a_separator_lead_to_the_model_file() {
    let folder = Folder::with(&example::surrogate());
    let plain = folder.0.to_str().unwrap();
    for use_as in [Use::Steps, Use::Solver] {
        for path in [plain.to_owned(), format!("{plain}/")] {
            let host = Host::instantiate(use_as, c"a", TOKEN, c_string(&path).as_ptr(), true);
            assert!(!host.instance.is_null(), "{:?}", host.messages());
            assert!(host.message().contains("surrogate `example`"));
        }
    }
}

#[test]
fn an_instance_that_cannot_be_is_null_and_the_reason_is_logged_whatever_logging_is_on() {
    let folder = Folder::with(&example::surrogate());
    let (good, empty) = (path(&folder.0), Folder::empty());
    let empty = path(&empty.0);
    for (name, token, resources, what) in [
        (c"", TOKEN, good.as_ptr(), "instance name is empty"),
        (c"a", c"{1}", good.as_ptr(), "`{1}`"),
        (c"a", TOKEN, null(), "`resourcePath` is a null pointer"),
        (c"a", TOKEN, empty.as_ptr(), "cannot read the model file"),
        (c"a", TOKEN, c"\xff".as_ptr(), "`resourcePath` is not UTF-8"),
    ] {
        for (use_as, logging) in [(Use::Steps, false), (Use::Solver, true)] {
            let host = Host::instantiate(use_as, name, token, resources, logging);
            assert!(host.instance.is_null());
            let message = host.message();
            assert!(message.starts_with("fmi3Instantiate") && message.contains(what), "{message}");
        }
    }
    std::fs::write(folder.0.join("model.safetensors"), [7; 40]).unwrap();
    let host = Host::instantiate(Use::Steps, c"a", TOKEN, good.as_ptr(), false);
    assert!(host.instance.is_null() && host.message().contains("not a safetensors container"));
}

#[test]
fn scheduled_execution_is_refused_with_a_message() {
    let log_of_host = Log::default();
    let environment = (&raw const log_of_host).cast_mut().cast();
    let (name, token) = (c"a".as_ptr(), TOKEN.as_ptr());
    let instance = unsafe {
        let (log, none) = (Some(log as Callback3), null());
        fmi3InstantiateScheduledExecution(name, token, c"/tmp".as_ptr(), 0, 0, environment, log, none, none, none)
    };
    assert!(instance.is_null());
    assert!(log_of_host.lock().unwrap()[0].text.contains("scheduled execution is not offered"));
}

#[test]
fn a_host_without_a_logger_is_told_nothing() {
    let folder = Folder::with(&example::surrogate());
    let (name, token, resources) = (c"a".as_ptr(), TOKEN.as_ptr(), path(&folder.0));
    unsafe {
        let instance = fmi3InstantiateModelExchange(name, token, resources.as_ptr(), 0, 1, null_mut(), None);
        assert!(!instance.is_null());
        assert_eq!(fmi3SetTime(instance, 0.0), Status::Error);
        assert_eq!(fmi3SetDebugLogging(instance, 1, 0, null()), Status::Ok);
        fmi3FreeInstance(instance);
        assert!(fmi3InstantiateModelExchange(name, token, null(), 0, 1, null_mut(), None).is_null());
        assert!(fmi3InstantiateModelExchange(null(), null(), null(), 0, 1, null_mut(), None).is_null());
    }
}

#[test]
fn warnings_are_logged_when_they_are_asked_for_and_errors_always() {
    let folder = Folder::with(&example::surrogate());
    let host = Host::instantiate(Use::Steps, c"a", TOKEN, path(&folder.0).as_ptr(), false);
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok);
    assert!(host.messages().is_empty());
    for category in [c"logStatusWarning", c"logStatusError", c"logAll"] {
        let category = category.as_ptr();
        assert_eq!(host.exit(), Status::Error);
        assert!(host.message().contains("fmi3ExitInitializationMode: not allowed in state `instantiated`, only in"));
        assert_eq!(host.reset(), Status::Ok);
        assert_eq!(unsafe { fmi3SetDebugLogging(host.instance, 0, 1, &category) }, Status::Ok);
    }
    let category = c"logStatusWarning".as_ptr();
    assert_eq!(unsafe { fmi3SetDebugLogging(host.instance, 1, 1, &category) }, Status::Ok);
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok);
    assert!(host.message().contains("`length`: 9 is outside"));
}

#[test]
fn the_example_of_a_surrogate_without_time_has_a_time_all_the_same() {
    let surrogate = example::surrogate();
    let mut metadata = surrogate.metadata().clone();
    (metadata.inputs[2].name, metadata.inputs[2].role) = ("load".into(), metadata.inputs[0].role);
    let surrogate = Surrogate::new(metadata, surrogate.program().clone()).unwrap();
    let host = Host::of(&surrogate, Use::Steps);
    assert_eq!((host.enter(0.5), host.exit()), (Status::Ok, Status::Ok));
    assert_eq!(host.step(0.5, 9.0), Status::Ok);
    assert_eq!((host.try_get([9]), host.in_domain()), (Ok([9.5]), 1));
    assert_eq!(host.set(&[9], &[0.0]), Status::Error);
    assert!(host.message().contains("`time` (value reference 9) is the independent variable"));
}

#[test]
fn instances_run_on_threads_of_their_own() {
    std::thread::scope(|scope| {
        for index in 0..4 {
            scope.spawn(move || {
                let host = Host::driven(if index % 2 == 0 { Use::Steps } else { Use::Solver });
                assert_eq!(host.set(&[LENGTH], &[0.12 + 0.01 * f64::from(index)]), Status::Ok);
                for speed in (0..200).map(|step| f64::from(step) / 50.0) {
                    assert_eq!(host.set(&[SPEED], &[speed]), Status::Ok);
                    assert_eq!(host.outputs(), expected(0.12 + 0.01 * f64::from(index), speed, 0.0));
                }
            });
        }
    });
}

#[test]
fn lives_of_instances_leave_no_memory_behind() {
    let folder = Folder::with(&example::surrogate());
    let resources = path(&folder.0);
    let live = || {
        let host = Host::instantiate(Use::Steps, c"short-lived", TOKEN, resources.as_ptr(), true);
        assert_eq!((host.enter(0.0), host.exit(), host.step(0.0, 3.0)), (Status::Ok, Status::Ok, Status::Ok));
        host.free_state(host.save());
        assert_eq!(host.step(7.0, f64::NAN), Status::Error);
        assert!(Host::instantiate(Use::Solver, c"a", c"", resources.as_ptr(), true).instance.is_null());
    };
    live(); // the first life sets up what the process keeps
    let before = allocations().1;
    (0..2_000).for_each(|_| live());
    assert_eq!(allocations().1, before);
}
