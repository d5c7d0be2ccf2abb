use super::*;

#[test]
fn times_of_the_experiment_that_make_no_sense_are_refused() {
    let (nan, infinity) = (f64::NAN, f64::INFINITY);
    for (start, stop) in [(nan, 1.0), (infinity, 1.0), (0.0, nan), (0.0, -infinity), (1.0, 0.5)] {
        let host = Host::new();
        assert_eq!(host.set_up_until(start, stop), Status::Error, "{start} {stop}");
        host.message();
    }
    let host = Host::new();
    assert_eq!(host.set_up_until(1.0, 1.0), Status::Ok, "a run of no length");
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
        (0.0, 5e-324, "step size 5e-324 is below 1e-30 s"),
        (0.0, 9.9e-31, "step size 9.9e-31 is below 1e-30 s"),
        (0.1, 0.1, "current communication point is 0.1, expected 0"),
        (-1e-6, 0.1, "current communication point is -1e-6, expected 0"),
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
    for size in [0.1, 0.0, 1e-30, 1e-9, 1.0 / 3.0, 0.5] {
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
fn a_clock_in_single_precision_is_let_pass_and_a_step_left_out_is_not() {
    let host = Host::driven();
    let size = 0.02_f32;
    let mut time = 0.0_f32;
    for _ in 0..40_000 {
        assert_eq!(host.step(time.into(), size.into()), Status::Ok, "{time}");
        time += size;
    }
    host.messages();
    assert_eq!(host.step((time + size).into(), size.into()), Status::Error);
    assert!(host.message().contains("where the last step ended"));
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
        assert_eq!(host.step(2.0, 0.5), Status::Ok);
        assert!(host.message().contains("variable `time`: 2.5 is outside the training range from 0 to 2"));
        assert_eq!(host.outputs(), expected(length, speed, 2.5), "computed all the same");
        assert_eq!(host.step(2.5, 0.5), Status::Ok);
        assert!(host.messages().is_empty());
        assert_eq!(host.reset(), Status::Ok);
        host.initialize(0.0);
    }
}

#[test]
fn a_start_outside_the_trained_time_is_logged() {
    let host = Host::new();
    assert_eq!(host.set_up_until(-1.0, 1.0), Status::Ok);
    assert!(host.message().contains("`time`: -1"));
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
    assert_eq!((host.set(&[LENGTH], &[0.11]), host.warned()), (Status::Ok, true));
    assert_eq!(host.terminate(), Status::Ok);
    assert_eq!(host.reset(), Status::Ok);
    assert_eq!(host.state(), InstanceState::Instantiated);
    assert_eq!(run(), first);
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
fn a_step_with_its_outputs_allocates_nothing() {
    let host = Host::of(&example::with_network(&[128, 128], Activation::Tanh));
    host.initialize(0.0);
    assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
    let size = 1e-4;
    let before = allocations().0;
    for step in 0..10_000 {
        assert_eq!(host.step(f64::from(step) * size, size), Status::Ok);
        assert!(host.outputs()[0].is_finite());
        assert_eq!(host.set(&[LENGTH], &[0.11]), Status::Ok);
    }
    assert_eq!(allocations().0 - before, 0);
    host.free_state(host.save());
    assert!(allocations().0 > before, "the count counts");
}
