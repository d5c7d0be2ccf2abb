use super::*;

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
    assert!(failed(c"a", 7, TOKEN, &uri).contains("FMU type is 7, expected 0 (model exchange) or 1 (co-simulation)"));
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
    assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok);
    let messages = host.messages();
    assert_eq!((messages.len(), messages[0].instance.as_str()), (1, "quiet"));
    let host = Host::instantiate(c"loud", CO_SIMULATION, TOKEN, &folder.uri(), true);
    assert!(host.message().contains("surrogate `example`"));
}

#[test]
fn categories_can_be_switched_one_by_one() {
    let host = Host::new();
    let warn = || {
        assert_eq!(host.reset(), Status::Ok, "each variable is warned of once a run");
        assert_eq!(host.set(&[LENGTH], &[9.0]), Status::Ok);
    };
    let said = |call: &dyn Fn()| {
        call();
        !host.messages().is_empty()
    };
    assert!(said(&warn));
    assert_eq!(host.switch(false, &[c"logStatusWarning"]), Status::Ok);
    assert!(!said(&warn));
    assert_eq!(host.switch(true, &[c"logStatusError"]), Status::Ok);
    assert!(!said(&warn));
    assert_eq!(host.switch(true, &[c"logAll"]), Status::Ok);
    assert!(said(&warn));
    assert_eq!(host.switch(false, &[]), Status::Ok);
    assert!(!said(&warn));
    assert_eq!(host.switch(true, &[]), Status::Ok);
    assert_eq!(host.switch(true, &[c"logEvents"]), Status::Ok);
    assert!(host.message().contains("`logEvents` is unknown, expected one of `logStatusError`, `logStatusWarning`"));
}

#[test]
fn errors_are_logged_whatever_is_switched_off() {
    let host = Host::new();
    for categories in [&[][..], &[c"logAll"], &[c"logStatusError"]] {
        assert_eq!(host.switch(false, categories), Status::Ok);
        assert_eq!(host.exit(), Status::Error);
        assert!(host.message().contains("fmi2ExitInitializationMode: not allowed in state `instantiated`"));
        assert_eq!(host.reset(), Status::Ok);
    }
}

/// An allocation that fails would end the process.
#[test]
fn an_instance_for_which_there_is_no_memory_is_null_and_the_reason_is_logged() {
    use metafmu_runtime::Precision::{Double, Single};
    let tanh = Activation::Tanh;
    for surrogate in [
        example::with_input(),
        example::with_network(&[300, 300], tanh),
        example::with_precision(&[512, 400], tanh, Single),
        example::encoded(&example::per_instant(&[256, 256], tanh, Double)),
        example::per_instant(&[128], tanh, Single),
        example::with_bounds(),
    ] {
        let surrogate = surrogate.sealed().unwrap();
        let folder = Folder::with(&surrogate);
        let (uri, token) = (folder.uri(), c_string(&surrogate.instantiation_token()));
        let instantiate = || Host::instantiate(c"large", CO_SIMULATION, &token, &uri, false);
        drop(instantiate());
        let mut limit = 1 << 15;
        let host = loop {
            let host = limited(limit, instantiate);
            if !host.c.is_null() {
                break host;
            }
            let message = host.message();
            assert!(message.contains("does not fit into memory"), "{limit} bytes: {message}");
            limit += limit / 16;
        };
        host.initialize(0.0);
        assert!(host.messages().is_empty());
    }
}

#[test]
fn the_sign_that_hosts_replace_is_written_twice() {
    let host = Host::instantiate(c"a", CO_SIMULATION, TOKEN, "file:///no/C%23", false);
    assert!(host.message().contains("C##"));
}

#[test]
fn a_thousand_instances_live_side_by_side() {
    let folder = Folder::with(&example::surrogate());
    let hosts: Vec<_> = (0..1_000)
        .map(|index| {
            let kind = if index % 2 == 0 { CO_SIMULATION } else { MODEL_EXCHANGE };
            let host = Host::instantiate(c"one of many", kind, TOKEN, &folder.uri(), false);
            assert_eq!(host.set(&[LENGTH], &[0.1 + 1e-4 * f64::from(index)]), Status::Ok);
            host.initialize(0.0);
            host
        })
        .collect();
    for (index, host) in (0..).zip(&hosts) {
        assert_eq!(host.outputs(), expected(0.1 + 1e-4 * f64::from(index), starts()[1], 0.0));
    }
}

#[test]
fn lives_of_instances_leave_no_memory_behind() {
    let folder = Folder::with(&example::surrogate());
    let uri = folder.uri();
    let live = || {
        let host = Host::instantiate(c"short-lived", CO_SIMULATION, TOKEN, &uri, true);
        host.initialize(0.0);
        let state = host.save();
        host.step(0.0, 0.5);
        host.set(&[LENGTH], &[9.0]);
        let again = host.deserialize(&host.serialize(state)).unwrap();
        host.restore(again);
        host.free_state(again);
        host.free_state(state);
        host.step(7.0, -1.0);
        let failed = Host::instantiate(c"", CO_SIMULATION, TOKEN, &uri, true);
        assert!(failed.c.is_null());
    };
    live(); // the first life sets up what the process keeps
    let before = allocations().1;
    (0..2_000).for_each(|_| live());
    assert_eq!(allocations().1, before);
}
