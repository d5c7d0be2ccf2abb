//! From C to Rust and back: pointers become slices or a refusal, panics become a value.

use crate::status::Refusal;
use std::{
    ffi::{CStr, c_char},
    panic::{AssertUnwindSafe, catch_unwind},
};

/// A panic behind the FMI functions, with its message.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("internal error ({message}); free the instance and please report this")]
pub(crate) struct InternalPanic {
    pub(crate) message: String,
}

/// Runs `body` so that no panic unwinds into the host; a panic comes back as the error.
///
/// Whatever `body` borrowed may be half changed after a panic: the caller must not use it for a simulation again.
pub(crate) fn guard<T>(body: impl FnOnce() -> T) -> Result<T, InternalPanic> {
    catch_unwind(AssertUnwindSafe(body)).map_err(|payload| {
        let text = payload.downcast_ref::<&str>().map(|text| (*text).to_owned());
        let text = text.or_else(|| payload.downcast_ref::<String>().cloned());
        InternalPanic { message: text.unwrap_or_default() }
    })
}

/// A C array to read; null is fine if the length is zero.
///
/// # Safety
/// A pointer that is not null points to `length` values, which nobody changes during `'a`.
pub(crate) unsafe fn slice<'a, T>(
    pointer: *const T,
    length: usize,
    argument: &'static str,
) -> Result<&'a [T], Refusal> {
    if length == 0 {
        return Ok(&[]);
    }
    check::<T>(pointer, length, argument)?;
    // SAFETY: neither null nor too long; the rest is the caller's promise
    Ok(unsafe { std::slice::from_raw_parts(pointer, length) })
}

/// A C array to write; null is fine if the length is zero.
///
/// # Safety
/// A pointer that is not null points to `length` values, which nobody else uses during `'a`.
pub(crate) unsafe fn slice_mut<'a, T>(
    pointer: *mut T,
    length: usize,
    argument: &'static str,
) -> Result<&'a mut [T], Refusal> {
    if length == 0 {
        return Ok(&mut []);
    }
    check::<T>(pointer, length, argument)?;
    // SAFETY: neither null nor too long; the rest is the caller's promise
    Ok(unsafe { std::slice::from_raw_parts_mut(pointer, length) })
}

fn check<T>(pointer: *const T, length: usize, argument: &'static str) -> Result<(), Refusal> {
    if pointer.is_null() {
        return Err(Refusal::NullPointer { argument });
    }
    if length > isize::MAX as usize / size_of::<T>() {
        return Err(Refusal::Length { argument, length });
    }
    Ok(())
}

/// Writes a result through an out-pointer.
///
/// # Safety
/// A pointer that is not null points to memory for one `T`.
pub(crate) unsafe fn write<T>(pointer: *mut T, value: T, argument: &'static str) -> Result<(), Refusal> {
    if pointer.is_null() {
        return Err(Refusal::NullPointer { argument });
    }
    // SAFETY: not null; the rest is the caller's promise
    unsafe { pointer.write(value) };
    Ok(())
}

/// Refuses null before anything is done, so that writing the results cannot fail half-way.
pub(crate) fn not_null<T>(pointer: *mut T, argument: &'static str) -> Result<(), Refusal> {
    if pointer.is_null() { Err(Refusal::NullPointer { argument }) } else { Ok(()) }
}

/// Refuses an array whose length is not what the other arguments make of it.
pub(crate) fn count(found: usize, expected: usize, argument: &'static str) -> Result<(), Refusal> {
    if found == expected { Ok(()) } else { Err(Refusal::Count { argument, found, expected }) }
}

/// Why a C string is of no use.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum TextError {
    #[error("is a null pointer")]
    Null,
    #[error("is not UTF-8")]
    NotUtf8,
}

/// A C string as text.
///
/// # Safety
/// A pointer that is not null points to a terminated string, which nobody changes during `'a`.
pub(crate) unsafe fn text<'a>(pointer: *const c_char) -> Result<&'a str, TextError> {
    if pointer.is_null() {
        return Err(TextError::Null);
    }
    // SAFETY: not null; the rest is the caller's promise
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().map_err(|_| TextError::NotUtf8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ptr::{null, null_mut};

    #[test]
    fn a_null_pointer_is_refused_unless_nothing_is_asked_of_it() {
        // SAFETY: null pointers are what is tested
        unsafe {
            assert_eq!(slice::<f64>(null(), 0, "x"), Ok(&[][..]));
            assert_eq!(slice::<f64>(null(), 1, "x"), Err(Refusal::NullPointer { argument: "x" }));
            assert_eq!(slice_mut::<f64>(null_mut(), 0, "x").map(|values| values.len()), Ok(0));
            assert_eq!(slice_mut::<f64>(null_mut(), 1, "x"), Err(Refusal::NullPointer { argument: "x" }));
            assert_eq!(write::<f64>(null_mut(), 1.0, "x"), Err(Refusal::NullPointer { argument: "x" }));
            assert_eq!(text(null()), Err(TextError::Null));
        }
    }

    #[test]
    fn a_length_beyond_the_address_space_is_refused() {
        // SAFETY: refused before the pointer is followed
        let refused = unsafe { slice(&1.0, usize::MAX, "x") };
        assert_eq!(refused, Err(Refusal::Length { argument: "x", length: usize::MAX }));
    }

    #[test]
    fn a_panic_comes_back_as_its_message() {
        assert_eq!(guard(|| 1), Ok(1));
        let plain = InternalPanic { message: "plain".into() };
        assert_eq!(guard(|| -> i32 { panic!("plain") }), Err(plain));
        let formatted = InternalPanic { message: "formatted 2".into() };
        assert_eq!(guard(|| -> i32 { panic!("formatted {}", 2) }), Err(formatted));
    }

    #[test]
    fn text_that_is_not_utf8_is_told_apart() {
        // SAFETY: terminated literals
        unsafe {
            assert_eq!(text(c"\xff".as_ptr()), Err(TextError::NotUtf8));
            assert_eq!(text(c"Gr\xc3\xbc\xc3\x9fe".as_ptr()), Ok("Grüße"));
        }
    }
}
