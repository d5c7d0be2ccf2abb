//! Common part of all C functions of both versions: an instance with its logger behind a pointer, the check of whether
//! a call is allowed, and the return of results to the host.
//!
//! Every `SAFETY` comment that refers to the host's promise means that of the standard. A component is null or was
//! returned by an instantiate function, and one thread at a time uses it. Arrays have the length that is passed with
//! them, strings are terminated, and states came from this library and were not freed. Null pointers are tested for,
//! not trusted.

use crate::{
    boundary::{InternalPanic, TextError, guard, not_null, slice, slice_mut, text, write},
    instance::{Instance, InstanceKind, LoadError},
    location::LocationError,
    logger::Logger,
    snapshot::Snapshot,
    state::Row,
    status::{Refusal, Status, Warning},
};
use std::{
    ffi::{CStr, c_char, c_void},
    fmt::Debug,
    path::PathBuf,
    ptr::null_mut,
};

/// Target of the pointers `fmi2Component` and `fmi3Instance`.
pub(crate) struct Component {
    pub instance: Instance,
    logger: Logger,
    /// Callback in the middle of a step, if the host has one.
    pub updates: Option<Updates>,
}

/// FMI 3.0: environment, time, whether inputs may be set, outputs read, the step of the solver is finished, the host may ask for an
/// early return; whether it does, and at which time.
pub(crate) type UpdateCallback = unsafe extern "C" fn(*mut c_void, f64, u8, u8, u8, u8, *mut u8, *mut f64);

/// Calls the host back in the middle of a step.
#[derive(Clone, Copy)]
pub(crate) struct Updates {
    pub callback: UpdateCallback,
    pub environment: *mut c_void,
    /// `true` if the host allows steps to end early.
    pub early_return: bool,
}

/// A function of one version of the standard; `Debug` is its name without the prefix.
pub(crate) trait Call: Copy + Debug {
    const PREFIX: &'static str;
    /// Where it may be called.
    fn legal(self) -> Row;
}

/// Table of legal calls of a version: the functions that belong to an instance, without their prefix, and in which states each may be
/// called. The C headers of `fmu-template/c` are generated from it.
macro_rules! legal_calls {
    ($prefix:literal, $(#[$source:meta])* $($function:ident => $row:literal,)*) => {
        $(#[$source])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(super) enum Function {
            $($function,)*
        }

        #[cfg(test)]
        impl Function {
            pub(super) const ALL: &[Self] = &[$(Self::$function),*];
        }

        impl Call for Function {
            const PREFIX: &'static str = $prefix;

            fn legal(self) -> $crate::state::Row {
                match self {
                    $(Self::$function => $row,)*
                }
            }
        }
    };
}
pub(crate) use legal_calls;

/// Why instantiation failed.
#[derive(Debug, thiserror::Error)]
pub(crate) enum InstantiationError {
    #[error("the instance name is empty")]
    EmptyName,
    #[error("FMU type is {found}, expected 0 (model exchange) or 1 (co-simulation)")]
    Type { found: i32 },
    #[error("scheduled execution is not offered")]
    ScheduledExecution,
    #[error("argument `{argument}` {source}")]
    Text { argument: &'static str, source: TextError },
    #[error(transparent)]
    Location(#[from] LocationError),
    #[error(transparent)]
    Load(#[from] LoadError),
    #[error(transparent)]
    Argument(Refusal),
    #[error("argument `requiredIntermediateVariables`: {0}")]
    Intermediate(#[from] Refusal),
}

impl InstantiationError {
    /// For `map_err` on an argument.
    pub(crate) fn text(argument: &'static str) -> impl FnOnce(TextError) -> Self {
        move |source| Self::Text { argument, source }
    }
}

/// A new component, or null after a message why not. `arguments` are the kind, the token and the resource directory; `updates` are
/// how the host is called back in the middle of steps, and for which variables.
///
/// # Safety
/// The host's promise for `name`.
pub(crate) unsafe fn instantiate(
    function: &str,
    name: *const c_char,
    logger: Logger,
    updates: Option<(Updates, &[u32])>,
    arguments: &dyn Fn() -> Result<(InstanceKind, String, PathBuf), InstantiationError>,
) -> *mut c_void {
    let instance = guard(|| -> Result<_, InstantiationError> {
        // SAFETY: the caller's promise
        match unsafe { text(name) } {
            Ok(name) if name.trim().is_empty() => return Err(InstantiationError::EmptyName),
            Err(TextError::Null) => return Err(InstantiationError::EmptyName),
            Ok(_) | Err(TextError::NotUtf8) => {}
        }
        let (kind, token, resources) = arguments()?;
        let instance = Instance::load(&resources, &token, kind)?;
        let updates = match updates {
            Some((updates, required)) if instance.offers_updates() => {
                required.iter().try_for_each(|&reference| instance.check_intermediate(reference))?;
                Some(updates)
            }
            _ => None,
        };
        Ok((instance, updates))
    });
    let (status, message) = match instance {
        Ok(Ok((instance, updates))) => {
            logger.log(Status::Ok, &format!("{function}: {}", describe(&instance)));
            return Box::into_raw(Box::new(Component { instance, logger, updates })).cast();
        }
        Ok(Err(error)) => (Status::Error, error.to_string()),
        Err(panic) => (Status::Fatal, panic.to_string()),
    };
    logger.log(status, &format!("{function}: {message}"));
    null_mut()
}

fn describe(instance: &Instance) -> String {
    let metadata = instance.metadata();
    let (inputs, outputs) = (metadata.inputs.len(), metadata.outputs.len());
    format!("surrogate `{}` of {}, {inputs} inputs, {outputs} outputs", metadata.name, metadata.provenance.tool)
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn free(component: *mut c_void) {
    if !component.is_null() {
        // SAFETY: not null and the host's promise
        let component = unsafe { Box::from_raw(component.cast::<Component>()) };
        // nobody is left to be told of a panic
        let _ = guard(|| drop(component));
    }
}

/// Refuses a null component and a call the state does not allow, keeps panics in, tells the host of everything that
/// is not simply fine.
///
/// # Safety
/// The host's promise.
#[inline]
pub(crate) unsafe fn call<C: Call>(
    component: *mut c_void,
    call: C,
    mut body: impl FnMut(&mut Instance) -> Result<(), Refusal>,
) -> Status {
    // SAFETY: the caller's promise
    unsafe { perform(component.cast(), Called { prefix: C::PREFIX, name: &call, legal: call.legal() }, &mut body) }
}

/// A [`Call`] as data.
struct Called<'a> {
    prefix: &'static str,
    name: &'a dyn Debug,
    legal: Row,
}

/// Variant of [`call`] for the functions of every step, compiled into the function itself.
///
/// # Safety
/// The host's promise.
#[inline(always)]
pub(crate) unsafe fn call_often<C: Call>(
    component: *mut c_void,
    call: C,
    body: impl FnMut(&mut Instance) -> Result<(), Refusal>,
) -> Status {
    // SAFETY: the caller's promise
    unsafe { carry_out(component.cast(), Called { prefix: C::PREFIX, name: &call, legal: call.legal() }, body) }
}

/// The part of [`call`] that is compiled once: it is 0.5 kB, and a hundred functions call it.
///
/// # Safety
/// The host's promise.
#[inline(never)]
unsafe fn perform(
    component: *mut Component,
    called: Called,
    body: &mut dyn FnMut(&mut Instance) -> Result<(), Refusal>,
) -> Status {
    // SAFETY: the caller's promise
    unsafe { carry_out(component, called, body) }
}

/// # Safety
/// The host's promise.
#[inline(always)]
unsafe fn carry_out(
    component: *mut Component,
    called: Called,
    mut body: impl FnMut(&mut Instance) -> Result<(), Refusal>,
) -> Status {
    if component.is_null() {
        return Status::Error;
    }
    // SAFETY: not null and the host's promise; only the instance is borrowed, so that the logger stays free
    let instance = unsafe { &mut (*component).instance };
    let mut refusal = None;
    // checks the result before moving it: moving an empty refusal takes as long as the call itself
    let answer = guard(|| match instance.begin(called.legal).and_then(|()| body(instance)) {
        Ok(()) => true,
        Err(reason) => {
            refusal = Some(reason);
            false
        }
    });
    match answer {
        Ok(true) if !instance.has_warnings() => Status::Ok,
        // SAFETY: as above
        _ => unsafe { tell(component, &called, answer.map(|_| refusal)) },
    }
}

/// # Safety
/// The host's promise, and the component is not null.
#[cold]
unsafe fn tell(component: *mut Component, called: &Called, answer: Result<Option<Refusal>, InternalPanic>) -> Status {
    // SAFETY: the caller's promise
    let instance = unsafe { &mut (*component).instance };
    let warnings = instance.take_warnings();
    let (status, reason) = match answer {
        Ok(None) => (Status::Ok, None),
        Ok(Some(refusal)) => {
            if refusal.ends_run() {
                instance.fail(refusal.status());
            }
            (refusal.status(), Some(refusal.to_string()))
        }
        Err(panic) => {
            instance.fail(Status::Fatal);
            (Status::Fatal, Some(panic.to_string()))
        }
    };
    // SAFETY: the caller's promise; the instance is not borrowed any more, should the host call back from its logger
    let logger = unsafe { &(*component).logger };
    let warnings = warnings.iter().map(|warning| (Status::Warning, warning.to_string()));
    for (severity, message) in warnings.chain(reason.map(|reason| (status, reason))) {
        logger.log(severity, &format!("{}{:?}: {message}", called.prefix, called.name));
    }
    status
}

/// Switches log categories, all if none is named.
///
/// # Safety
/// The host's promise; `component` is not null.
pub(crate) unsafe fn switch_logging(
    component: *mut c_void,
    instance: &mut Instance,
    on: bool,
    count: usize,
    categories: *const *const c_char,
) -> Result<(), Refusal> {
    // SAFETY: the caller's promise; `instance` borrows another field
    let logger = unsafe { &mut (*component.cast::<Component>()).logger };
    if count == 0 {
        logger.switch_all(on);
    }
    // SAFETY: the caller's promise
    for &category in unsafe { slice(categories, count, "categories")? } {
        not_null(category.cast_mut(), "categories")?;
        // SAFETY: not null and the caller's promise
        let category = unsafe { CStr::from_ptr(category) }.to_string_lossy();
        // not an error: an unknown category is no reason to end a simulation
        if !logger.switch(&category, on) {
            instance.warn(Warning::UnknownCategory { found: category.into_owned(), expected: Logger::categories() });
        }
    }
    Ok(())
}

// ---- States as the host holds them -------------------------------------------------------------------------------

/// Puts a snapshot where `state` points: into the state that is there already, or else into a new one.
///
/// # Safety
/// The host's promise.
pub(crate) unsafe fn store(
    snapshot: &Snapshot,
    state: *mut *mut c_void,
    argument: &'static str,
) -> Result<(), Refusal> {
    not_null(state, argument)?;
    // SAFETY: not null and the host's promise
    unsafe {
        match (*state).cast::<Snapshot>().as_mut() {
            Some(there) => there.clone_from(snapshot),
            None => *state = Box::into_raw(Box::new(snapshot.clone())).cast(),
        }
    }
    Ok(())
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn stored<'a>(state: *mut c_void, argument: &'static str) -> Result<&'a Snapshot, Refusal> {
    // SAFETY: the host's promise
    unsafe { state.cast::<Snapshot>().as_ref() }.ok_or(Refusal::NullPointer { argument })
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn free_state(state: *mut *mut c_void) -> Result<(), Refusal> {
    // SAFETY: not null where it is followed, and the host's promise
    unsafe {
        if !state.is_null() && !(*state).is_null() {
            drop(Box::from_raw((*state).cast::<Snapshot>()));
            *state = null_mut();
        }
    }
    Ok(())
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn state_size(state: *mut c_void, argument: &'static str, size: *mut usize) -> Result<(), Refusal> {
    // SAFETY: the host's promise
    unsafe { write(size, stored(state, argument)?.size(), "size") }
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn serialize(
    state: *mut c_void,
    argument: &'static str,
    bytes: *mut u8,
    size: usize,
) -> Result<(), Refusal> {
    // SAFETY: the host's promise
    let snapshot = unsafe { stored(state, argument)? };
    if size != snapshot.size() {
        return Err(Refusal::StateSize { found: size, expected: snapshot.size() });
    }
    // SAFETY: the host's promise
    unsafe { slice_mut(bytes, size, "serializedState")?.copy_from_slice(&snapshot.to_bytes()) };
    Ok(())
}

/// # Safety
/// The host's promise.
pub(crate) unsafe fn deserialize(
    instance: &Instance,
    bytes: *const u8,
    size: usize,
    state: *mut *mut c_void,
    argument: &'static str,
) -> Result<(), Refusal> {
    // SAFETY: the host's promise
    let bytes = unsafe { slice(bytes, size, "serializedState")? };
    let snapshot = Snapshot::from_bytes(bytes, instance.snapshot())?;
    // SAFETY: as above
    unsafe { store(&snapshot, state, argument) }
}
