//! Values of variables, and derivatives.

use super::{FmiFunctions, FmuInstance, fmi2, fmi3, instance::c_bool};
use crate::{
    Error, Result,
    model_description::{FmiVersion, Integer, MAX_ELEMENTS, RealAttributes, ScalarVariable, VariableType, Width},
};
use std::ffi::c_int;

/// Largest integer up to which every integer is a `f64`.
const EXACT: f64 = 9_007_199_254_740_992.0;

impl FmuInstance<'_> {
    /// Values of real variables (Float64 of FMI 3.0), by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_real(&self, references: &[u32], values: &mut [f64]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => self.get_2("fmi2GetReal", functions.get_real, references, values),
            FmiFunctions::V3(functions) => {
                self.get_3("fmi3GetFloat64", Some(functions.get_float64), references, values)
            }
        }
    }

    /// Sets real variables (Float64 of FMI 3.0), by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_real(&self, references: &[u32], values: &[f64]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => self.set_2("fmi2SetReal", functions.set_real, references, values),
            FmiFunctions::V3(functions) => {
                self.set_3("fmi3SetFloat64", Some(functions.set_float64), references, values)
            }
        }
    }

    /// Values of 32-bit integers (and enumerations of FMI 2.0), by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_integer(&self, references: &[u32], values: &mut [i32]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => self.get_2("fmi2GetInteger", functions.get_integer, references, values),
            FmiFunctions::V3(functions) => self.get_3("fmi3GetInt32", functions.types.int32.get, references, values),
        }
    }

    /// Sets 32-bit integers (and enumerations of FMI 2.0), by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_integer(&self, references: &[u32], values: &[i32]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => self.set_2("fmi2SetInteger", functions.set_integer, references, values),
            FmiFunctions::V3(functions) => self.set_3("fmi3SetInt32", functions.types.int32.set, references, values),
        }
    }

    /// Values of boolean variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn get_boolean(&self, references: &[u32], values: &mut [bool]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => {
                let mut numbers = vec![fmi2::FALSE; values.len()];
                self.get_2("fmi2GetBoolean", functions.get_boolean, references, &mut numbers)?;
                values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number != fmi2::FALSE);
            }
            FmiFunctions::V3(functions) => {
                let mut numbers = vec![0; values.len()];
                self.get_3("fmi3GetBoolean", Some(functions.get_boolean), references, &mut numbers)?;
                values.iter_mut().zip(numbers).for_each(|(value, number)| *value = number != 0);
            }
        }
        Ok(())
    }

    /// Sets boolean variables, by value reference.
    ///
    /// # Errors
    /// [`Error::Fmi`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn set_boolean(&self, references: &[u32], values: &[bool]) -> Result<()> {
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => {
                let numbers: Vec<c_int> = values.iter().map(|&value| c_bool(value)).collect();
                self.set_2("fmi2SetBoolean", functions.set_boolean, references, &numbers)
            }
            FmiFunctions::V3(functions) => {
                let numbers: Vec<u8> = values.iter().map(|&value| u8::from(value)).collect();
                self.set_3("fmi3SetBoolean", Some(functions.set_boolean), references, &numbers)
            }
        }
    }

    /// Value of a variable as numbers; not for texts, bytes and clocks. There is one number for a scalar, and all
    /// elements of an array; booleans are 0 and 1. Integers beyond 2^53 are rounded.
    ///
    /// # Errors
    /// [`Error::Fmi`]; [`Error::Variable`] for a variable that is neither number nor boolean.
    pub fn get_numbers(&self, variable: &ScalarVariable) -> Result<Vec<f64>> {
        let references = [variable.value_reference];
        let count = self.element_count(variable)?;
        let FmiFunctions::V3(functions) = &self.fmu.functions else {
            return self.get_number_2(variable).map(|value| vec![value]);
        };
        let types = &functions.types;
        match &variable.kind {
            VariableType::Real(RealAttributes { single: false, .. }) => {
                self.numbers_3("fmi3GetFloat64", Some(functions.get_float64), references, count, |value| value)
            }
            VariableType::Real(_) => self.numbers_3("fmi3GetFloat32", types.float32.get, references, count, f64::from),
            VariableType::Boolean { .. } => {
                let get = Some(functions.get_boolean);
                self.numbers_3("fmi3GetBoolean", get, references, count, |value| f64::from(u8::from(value != 0)))
            }
            VariableType::Integer(Integer { width, .. }) | VariableType::Enumeration(Integer { width, .. }) => {
                match width {
                    Width::Int8 => self.numbers_3("fmi3GetInt8", types.int8.get, references, count, f64::from),
                    Width::UInt8 => self.numbers_3("fmi3GetUInt8", types.uint8.get, references, count, f64::from),
                    Width::Int16 => self.numbers_3("fmi3GetInt16", types.int16.get, references, count, f64::from),
                    Width::UInt16 => self.numbers_3("fmi3GetUInt16", types.uint16.get, references, count, f64::from),
                    Width::Int32 => self.numbers_3("fmi3GetInt32", types.int32.get, references, count, f64::from),
                    Width::UInt32 => self.numbers_3("fmi3GetUInt32", types.uint32.get, references, count, f64::from),
                    Width::Int64 => self.numbers_3("fmi3GetInt64", types.int64.get, references, count, |v| v as f64),
                    Width::UInt64 => self.numbers_3("fmi3GetUInt64", types.uint64.get, references, count, |v| v as f64),
                }
            }
            VariableType::String { .. } | VariableType::Binary { .. } | VariableType::Clock { .. } => {
                Err(no_number(variable))
            }
        }
    }

    fn get_number_2(&self, variable: &ScalarVariable) -> Result<f64> {
        let references = [variable.value_reference];
        match &variable.kind {
            VariableType::Real(_) => {
                let mut value = [0.0];
                self.get_real(&references, &mut value).map(|()| value[0])
            }
            VariableType::Integer(_) | VariableType::Enumeration(_) => {
                let mut value = [0];
                self.get_integer(&references, &mut value).map(|()| value[0].into())
            }
            VariableType::Boolean { .. } => {
                let mut value = [false];
                self.get_boolean(&references, &mut value).map(|()| u8::from(value[0]).into())
            }
            VariableType::String { .. } | VariableType::Binary { .. } | VariableType::Clock { .. } => {
                Err(no_number(variable))
            }
        }
    }

    /// Sets a variable of any type but texts, bytes and clocks from numbers, one for each element of an array.
    ///
    /// # Errors
    /// [`Error::Fmi`]; [`Error::Variable`] for the wrong number of values, a value that does not fit the type, or a
    /// variable that is neither number nor boolean.
    pub fn set_numbers(&self, variable: &ScalarVariable, values: &[f64]) -> Result<()> {
        let references = [variable.value_reference];
        let count = self.element_count(variable)?;
        if values.len() != count {
            return Err(unfit(variable, format!("{} values, expected {count}", values.len())));
        }
        match &variable.kind {
            VariableType::Integer(Integer { width, .. }) | VariableType::Enumeration(Integer { width, .. }) => {
                let (min, max) = width.range();
                let unfit_value = values.iter().find(|value| {
                    let is_exact = value.fract() == 0.0 && value.abs() <= EXACT;
                    !is_exact || !(min..=max).contains(&(**value as i128))
                });
                if let Some(value) = unfit_value {
                    return Err(unfit(variable, format!("value {value}, expected an integer of type {width:?}")));
                }
            }
            VariableType::Boolean { .. } => {
                if let Some(value) = values.iter().find(|value| ![0.0, 1.0].contains(value)) {
                    return Err(unfit(variable, format!("value {value}, expected 0 or 1")));
                }
            }
            VariableType::Real(_) => {}
            VariableType::String { .. } | VariableType::Binary { .. } | VariableType::Clock { .. } => {
                return Err(no_number(variable));
            }
        }
        match (&self.fmu.functions, &variable.kind) {
            (_, VariableType::Boolean { .. }) => {
                let values: Vec<bool> = values.iter().map(|&value| value == 1.0).collect();
                self.set_boolean(&references, &values)
            }
            (FmiFunctions::V2(_), VariableType::Real(_)) => self.set_real(&references, values),
            (FmiFunctions::V2(_), _) => {
                let values: Vec<i32> = values.iter().map(|&value| value as i32).collect();
                self.set_integer(&references, &values)
            }
            (FmiFunctions::V3(functions), kind) => self.set_numbers_3(functions, kind, references, values),
        }
    }

    /// The casts are exact: what does not fit has been refused.
    fn set_numbers_3(
        &self,
        functions: &fmi3::Fmi3Functions,
        kind: &VariableType,
        references: [u32; 1],
        values: &[f64],
    ) -> Result<()> {
        let types = &functions.types;
        let width = match kind {
            VariableType::Integer(integer) | VariableType::Enumeration(integer) => integer.width,
            VariableType::Real(RealAttributes { single: true, .. }) => {
                let values: Vec<f32> = values.iter().map(|&value| value as f32).collect();
                return self.set_3("fmi3SetFloat32", types.float32.set, &references, &values);
            }
            _ => return self.set_3("fmi3SetFloat64", Some(functions.set_float64), &references, values),
        };
        match width {
            Width::Int8 => {
                let values: Vec<i8> = values.iter().map(|&value| value as i8).collect();
                self.set_3("fmi3SetInt8", types.int8.set, &references, &values)
            }
            Width::UInt8 => {
                let values: Vec<u8> = values.iter().map(|&value| value as u8).collect();
                self.set_3("fmi3SetUInt8", types.uint8.set, &references, &values)
            }
            Width::Int16 => {
                let values: Vec<i16> = values.iter().map(|&value| value as i16).collect();
                self.set_3("fmi3SetInt16", types.int16.set, &references, &values)
            }
            Width::UInt16 => {
                let values: Vec<u16> = values.iter().map(|&value| value as u16).collect();
                self.set_3("fmi3SetUInt16", types.uint16.set, &references, &values)
            }
            Width::Int32 => {
                let values: Vec<i32> = values.iter().map(|&value| value as i32).collect();
                self.set_3("fmi3SetInt32", types.int32.set, &references, &values)
            }
            Width::UInt32 => {
                let values: Vec<u32> = values.iter().map(|&value| value as u32).collect();
                self.set_3("fmi3SetUInt32", types.uint32.set, &references, &values)
            }
            Width::Int64 => {
                let values: Vec<i64> = values.iter().map(|&value| value as i64).collect();
                self.set_3("fmi3SetInt64", types.int64.set, &references, &values)
            }
            Width::UInt64 => {
                let values: Vec<u64> = values.iter().map(|&value| value as u64).collect();
                self.set_3("fmi3SetUInt64", types.uint64.set, &references, &values)
            }
        }
    }

    /// `sum over knowns of d unknown / d known * seed`, for each of the unknowns.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that has no derivatives to offer.
    ///
    /// # Panics
    /// If the number of seeds differs from that of knowns.
    pub fn directional_derivative(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Result<Vec<f64>> {
        assert_eq!(knowns.len(), seed.len(), "one seed per known");
        let mut sensitivity = vec![0.0; unknowns.len()];
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => {
                let name = "fmi2GetDirectionalDerivative";
                let function = self.offered(name, functions.directional_derivative)?;
                self.call(name, |component| {
                    // SAFETY: as for `call`; every array has the length that is passed
                    unsafe {
                        function(
                            component,
                            unknowns.as_ptr(),
                            unknowns.len(),
                            knowns.as_ptr(),
                            knowns.len(),
                            seed.as_ptr(),
                            sensitivity.as_mut_ptr(),
                        )
                    }
                })?;
            }
            FmiFunctions::V3(functions) => {
                let (name, function) = ("fmi3GetDirectionalDerivative", functions.directional_derivative);
                self.derivative_3(name, function, unknowns, knowns, seed, &mut sensitivity)?;
            }
        }
        Ok(sensitivity)
    }

    /// `sum over unknowns of seed * d unknown / d known`, for each of the knowns; FMI 3.0 only.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU that has no adjoint derivatives to offer.
    ///
    /// # Panics
    /// If the number of seeds differs from that of unknowns.
    pub fn adjoint_derivative(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Result<Vec<f64>> {
        assert_eq!(unknowns.len(), seed.len(), "one seed per unknown");
        let mut sensitivity = vec![0.0; knowns.len()];
        let name = "fmi3GetAdjointDerivative";
        let function = match &self.fmu.functions {
            FmiFunctions::V2(_) => None,
            FmiFunctions::V3(functions) => functions.adjoint_derivative,
        };
        self.derivative_3(name, function, unknowns, knowns, seed, &mut sensitivity)?;
        Ok(sensitivity)
    }

    /// Derivatives of outputs by time, each of the order given for it, from 1 on; co-simulation only.
    ///
    /// # Errors
    /// [`Error::Fmi`], or [`Error::MissingFunction`] for an FMU without it.
    ///
    /// # Panics
    /// If the number of orders differs from that of value references.
    pub fn output_derivatives(&self, references: &[u32], orders: &[i32]) -> Result<Vec<f64>> {
        assert_eq!(references.len(), orders.len(), "one order per value reference");
        let mut values = vec![0.0; references.len()];
        match &self.fmu.functions {
            FmiFunctions::V2(functions) => {
                let name = "fmi2GetRealOutputDerivatives";
                let co_simulation = functions.co_simulation.as_ref();
                let function = self.offered(name, co_simulation.and_then(|f| f.output_derivatives))?;
                self.call(name, |component| {
                    // SAFETY: as for `call`; every array has the length that is passed
                    unsafe {
                        let (count, orders) = (references.len(), orders.as_ptr());
                        function(component, references.as_ptr(), count, orders, values.as_mut_ptr())
                    }
                })?;
            }
            FmiFunctions::V3(functions) => {
                let name = "fmi3GetOutputDerivatives";
                let co_simulation = functions.co_simulation.as_ref();
                let function = self.offered(name, co_simulation.and_then(|f| f.output_derivatives))?;
                self.call(name, |component| {
                    // SAFETY: as for `call`; every array has the length that is passed
                    unsafe {
                        let (count, orders) = (references.len(), orders.as_ptr());
                        function(component, references.as_ptr(), count, orders, values.as_mut_ptr(), values.len())
                    }
                })?;
            }
        }
        Ok(values)
    }

    fn derivative_3(
        &self,
        name: &'static str,
        function: Option<fmi3::GetDerivative>,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<()> {
        let function = self.offered(name, function)?;
        self.call(name, |component| {
            // SAFETY: as for `call`; every array has the length that is passed
            unsafe {
                function(
                    component,
                    unknowns.as_ptr(),
                    unknowns.len(),
                    knowns.as_ptr(),
                    knowns.len(),
                    seed.as_ptr(),
                    seed.len(),
                    sensitivity.as_mut_ptr(),
                    sensitivity.len(),
                )
            }
        })
    }

    /// Number of elements of a variable: 1 for a scalar.
    pub(super) fn element_count(&self, variable: &ScalarVariable) -> Result<usize> {
        let description = self.fmu.description();
        debug_assert!(description.fmi_version == FmiVersion::V3 || variable.dimensions.is_empty());
        let count = description.shape(variable).and_then(|shape| shape.into_iter().try_fold(1u64, u64::checked_mul));
        count.filter(|&count| count <= MAX_ELEMENTS).map(|count| count as usize).ok_or_else(|| Error::Variable {
            name: variable.name.clone(),
            problem: "is an array of unknown or unreasonable size".into(),
        })
    }

    fn get_2<T>(
        &self,
        name: &'static str,
        function: fmi2::Fmi2GetValues<T>,
        references: &[u32],
        values: &mut [T],
    ) -> Result<()> {
        assert_eq!(references.len(), values.len(), "one value per value reference");
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the length that is passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_mut_ptr()) }
        })
    }

    fn set_2<T>(
        &self,
        name: &'static str,
        function: fmi2::Fmi2SetValues<T>,
        references: &[u32],
        values: &[T],
    ) -> Result<()> {
        assert_eq!(references.len(), values.len(), "one value per value reference");
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the length that is passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_ptr()) }
        })
    }

    fn get_3<T>(
        &self,
        name: &'static str,
        function: Option<fmi3::Fmi3GetValues<T>>,
        references: &[u32],
        values: &mut [T],
    ) -> Result<()> {
        let function = self.offered(name, function)?;
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the lengths that are passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_mut_ptr(), values.len()) }
        })
    }

    fn set_3<T>(
        &self,
        name: &'static str,
        function: Option<fmi3::Fmi3SetValues<T>>,
        references: &[u32],
        values: &[T],
    ) -> Result<()> {
        let function = self.offered(name, function)?;
        self.call(name, |component| {
            // SAFETY: as for `call`; both arrays have the lengths that are passed
            unsafe { function(component, references.as_ptr(), references.len(), values.as_ptr(), values.len()) }
        })
    }

    /// All elements of one variable.
    fn numbers_3<T: Copy + Default>(
        &self,
        name: &'static str,
        function: Option<fmi3::Fmi3GetValues<T>>,
        references: [u32; 1],
        count: usize,
        number: impl Fn(T) -> f64,
    ) -> Result<Vec<f64>> {
        let mut values = vec![T::default(); count];
        self.get_3(name, function, &references, &mut values)?;
        Ok(values.into_iter().map(number).collect())
    }
}

fn unfit(variable: &ScalarVariable, problem: String) -> Error {
    Error::Variable { name: variable.name.clone(), problem }
}

fn no_number(variable: &ScalarVariable) -> Error {
    let problem = format!("is of type {}, which is not a number", variable.kind.name(FmiVersion::V3));
    unfit(variable, problem)
}
