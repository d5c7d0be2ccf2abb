//! Steps with intermediate updates: the host is called back after each step of the solver.

use super::table::Function;
use crate::{
    component::{Component, Updates, call},
    status::Status,
};
use std::ffi::c_void;

/// A communication step, and whether it ended early.
///
/// The host calls the FMU's functions from its callback, so that nothing is borrowed from the component meanwhile.
///
/// # Safety
/// The host's promise, and the component is not null.
pub(super) unsafe fn step_with_updates(
    instance: *mut c_void,
    updates: Updates,
    from: f64,
    size: f64,
) -> (Status, bool) {
    let component = instance.cast::<Component>();
    let mut steps = 1.0;
    // SAFETY: the caller's promise
    let begun = unsafe {
        call(instance, Function::DoStep, |instance| {
            steps = instance.begin_updates(from, size)?;
            Ok(())
        })
    };
    if begun != Status::Ok {
        return (begun, false);
    }
    let whole = from + size;
    let (mut time, mut end, mut step) = (from, whole, 0.0);
    loop {
        step += 1.0;
        // the last one ends exactly where it should
        let next = if step < steps { (from + size * (step / steps)).min(end) } else { end };
        // SAFETY: the caller's promise
        let status = unsafe {
            call(instance, Function::DoStep, |instance| instance.step_to_update(time - from, time, next - time))
        };
        if status == Status::Discard {
            // SAFETY: as above
            unsafe { (*component).instance.undo_updates() };
        }
        if status != Status::Ok {
            return (status, false);
        }
        time = next;
        let can_return = updates.early_return && time < whole;
        let (mut requested, mut return_time) = (0, time);
        // SAFETY: the caller's promise; nothing is borrowed while the host is called
        unsafe {
            (*component).instance.enter_update();
            let sets = (*component).instance.has_inputs().into();
            (updates.callback)(
                updates.environment,
                time,
                sets,
                1,
                1,
                can_return.into(),
                &mut requested,
                &mut return_time,
            );
            (*component).instance.leave_update();
        }
        if can_return && requested != 0 {
            // anything that is no later time is now
            end = if return_time > time { end.min(return_time) } else { time };
        }
        if time >= end {
            break;
        }
    }
    // tells the host if a call from its callback has ended the simulation
    // SAFETY: the caller's promise
    let ended = unsafe { call(instance, Function::DoStep, |_| Ok(())) };
    (ended, time < whole)
}
