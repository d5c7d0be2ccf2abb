//! The functions of clocks, of which there are none.

use super::{Boolean, Function, Status, call, values::none};
use std::ffi::{c_int, c_void};

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetClock(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _values: *mut Boolean,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetClock, |_| none(nValueReferences, "GetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetClock(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _values: *const Boolean,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetClock, |_| none(nValueReferences, "SetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetIntervalDecimal(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _intervals: *mut f64,
    _qualifiers: *mut c_int,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetIntervalDecimal, |_| none(nValueReferences, "GetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetIntervalFraction(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _counters: *mut u64,
    _resolutions: *mut u64,
    _qualifiers: *mut c_int,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetIntervalFraction, |_| none(nValueReferences, "GetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetShiftDecimal(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _shifts: *mut f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetShiftDecimal, |_| none(nValueReferences, "GetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetShiftFraction(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _counters: *mut u64,
    _resolutions: *mut u64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::GetShiftFraction, |_| none(nValueReferences, "GetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetIntervalDecimal(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _intervals: *const f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetIntervalDecimal, |_| none(nValueReferences, "SetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetIntervalFraction(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _counters: *const u64,
    _resolutions: *const u64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetIntervalFraction, |_| none(nValueReferences, "SetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetShiftDecimal(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _shifts: *const f64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetShiftDecimal, |_| none(nValueReferences, "SetClock")) }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetShiftFraction(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _counters: *const u64,
    _resolutions: *const u64,
) -> Status {
    // SAFETY: the host's promise
    unsafe { call(instance, Function::SetShiftFraction, |_| none(nValueReferences, "SetClock")) }
}
