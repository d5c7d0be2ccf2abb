//! Getting and setting variables in FMI 3.0. All are scalars but for the arrays of outputs, which are Float64.

use super::{Boolean, Function, Refusal, Status, call, call_often, count, slice, slice_mut};
use std::ffi::{c_char, c_void};

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetFloat64(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *mut f64,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call_often(instance, Function::GetFloat64, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, instance.size(references)?, "values")?;
            instance.get_real(references, slice_mut(values, nValues, "values")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetFloat64(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *const f64,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call_often(instance, Function::SetFloat64, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, instance.size(references)?, "values")?;
            instance.set_real(references, slice(values, nValues, "values")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetInt32(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *mut i32,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetInt32, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, nValueReferences, "values")?;
            instance.get_integer(references, slice_mut(values, nValues, "values")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetInt32(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *const i32,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::SetInt32, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, nValueReferences, "values")?;
            instance.set_integer(references, slice(values, nValues, "values")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetBoolean(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *mut Boolean,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetBoolean, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, nValueReferences, "values")?;
            instance.get_boolean(references, slice_mut(values, nValues, "values")?)
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetBoolean(
    instance: *mut c_void,
    valueReferences: *const u32,
    nValueReferences: usize,
    values: *const Boolean,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::SetBoolean, |instance| {
            let references = slice(valueReferences, nValueReferences, "valueReferences")?;
            count(nValues, nValueReferences, "values")?;
            instance.set_boolean(references, slice(values, nValues, "values")?)
        })
    }
}

/// Functions for types that no variable has. This is a macro because each function needs a different name.
macro_rules! no_variables {
    ($($function:ident, $name:ident, $values:ty;)*) => {$(
        #[unsafe(no_mangle)]
        pub(super) unsafe extern "C" fn $function(
            instance: *mut c_void,
            _valueReferences: *const u32,
            nValueReferences: usize,
            _values: $values,
            nValues: usize,
        ) -> Status {
            // SAFETY: the host's promise
            unsafe {
                call(instance, Function::$name, |_| {
                    none(nValueReferences, stringify!($name))?;
                    count(nValues, 0, "values")
                })
            }
        }
    )*};
}

no_variables! {
    fmi3GetFloat32, GetFloat32, *mut f32;
    fmi3GetInt8, GetInt8, *mut i8;
    fmi3GetUInt8, GetUInt8, *mut u8;
    fmi3GetInt16, GetInt16, *mut i16;
    fmi3GetUInt16, GetUInt16, *mut u16;
    fmi3GetUInt32, GetUInt32, *mut u32;
    fmi3GetInt64, GetInt64, *mut i64;
    fmi3GetUInt64, GetUInt64, *mut u64;
    fmi3GetString, GetString, *mut *const c_char;
    fmi3SetFloat32, SetFloat32, *const f32;
    fmi3SetInt8, SetInt8, *const i8;
    fmi3SetUInt8, SetUInt8, *const u8;
    fmi3SetInt16, SetInt16, *const i16;
    fmi3SetUInt16, SetUInt16, *const u16;
    fmi3SetUInt32, SetUInt32, *const u32;
    fmi3SetInt64, SetInt64, *const i64;
    fmi3SetUInt64, SetUInt64, *const u64;
    fmi3SetString, SetString, *const *const c_char;
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3GetBinary(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _valueSizes: *mut usize,
    _values: *mut *const u8,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::GetBinary, |_| {
            none(nValueReferences, "GetBinary")?;
            count(nValues, 0, "values")
        })
    }
}

#[unsafe(no_mangle)]
pub(super) unsafe extern "C" fn fmi3SetBinary(
    instance: *mut c_void,
    _valueReferences: *const u32,
    nValueReferences: usize,
    _valueSizes: *const usize,
    _values: *const *const u8,
    nValues: usize,
) -> Status {
    // SAFETY: the host's promise
    unsafe {
        call(instance, Function::SetBinary, |_| {
            none(nValueReferences, "SetBinary")?;
            count(nValues, 0, "values")
        })
    }
}

/// Refuses to deal with variables of a type that none has; `function` is `Get` or `Set` and the type.
pub(super) fn none(count: usize, function: &'static str) -> Result<(), Refusal> {
    if count == 0 { Ok(()) } else { Err(Refusal::NoVariableOfType { kind: &function[3..], count }) }
}
