use super::*;

#[test]
fn a_restored_state_continues_to_the_last_bit() {
    let host = Host::stepping();
    assert_eq!(host.set(&[LENGTH], &[0.123]), Status::Ok);
    assert_eq!(host.step(0.0, 0.1), Status::Ok);
    let state = host.save();
    let go_on = |host: &Host| {
        assert_eq!(host.step(0.1, 0.2), Status::Ok);
        assert_eq!(host.step(0.1 + 0.2, 0.01), Status::Ok);
        (host.outputs().map(f64::to_bits), host.try_get([LENGTH, SPEED, TIME]).unwrap().map(f64::to_bits))
    };
    let first = go_on(&host);
    assert_eq!((host.set(&[LENGTH], &[0.2]), host.warned()), (Status::Ok, true));
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
    let other = example::with_network(&[4], Activation::Tanh).sealed().unwrap();
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
