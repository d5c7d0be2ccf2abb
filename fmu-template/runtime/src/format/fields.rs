//! The description in a model file, read field by field: what serde derives for structures would be 100 kB of every FMU.

use crate::{
    Bounds, Cover, Metadata,
    description::{Encoding, Input, Output, OutputArray, Precision, Provenance, Role, State, Tunability},
};
use serde::de::{Deserialize, Error as _, IntoDeserializer};
use serde_json::{Error, Map, Value};

/// Type that a field is read as.
pub(super) trait Read: Sized {
    fn read(value: Value) -> Result<Self, Error>;
}

/// Fields of an object, taken one by one. A list, as there are few of them, and taking them from the map is 6 kB of every FMU.
pub(super) struct Fields(Vec<(String, Value)>);

impl From<Map<String, Value>> for Fields {
    fn from(fields: Map<String, Value>) -> Self {
        Self(fields.into_iter().collect())
    }
}

impl Fields {
    pub(super) fn of(value: Value) -> Result<Self, Error> {
        match value {
            Value::Object(fields) => Ok(fields.into()),
            other => Err(wrong(&other, "an object")),
        }
    }

    pub(super) fn take<T: Read>(&mut self, name: &'static str) -> Result<T, Error> {
        T::read(self.required(name)?)
    }

    fn take_or_default<T: Read + Default>(&mut self, name: &str) -> Result<T, Error> {
        self.optional(name).map_or_else(|| Ok(T::default()), T::read)
    }

    // both stay out of line: for every type of field they would be several kilobytes of every FMU

    #[inline(never)]
    fn required(&mut self, name: &'static str) -> Result<Value, Error> {
        self.optional(name).ok_or_else(|| Error::missing_field(name))
    }

    #[inline(never)]
    fn optional(&mut self, name: &str) -> Option<Value> {
        let place = self.0.iter().position(|(field, _)| field == name)?;
        Some(self.0.remove(place).1)
    }

    pub(super) fn contain(&self, name: &str) -> bool {
        self.0.iter().any(|(field, _)| field == name)
    }

    /// Makes sure that no field is left.
    pub(super) fn finish(self) -> Result<(), Error> {
        match self.0.first() {
            Some((name, _)) => Err(Error::custom(format_args!("unknown field `{name}`"))),
            None => Ok(()),
        }
    }
}

#[cold]
fn wrong(found: &Value, expected: &str) -> Error {
    Error::custom(format_args!("{found}, expected {expected}"))
}

impl Read for Value {
    fn read(value: Value) -> Result<Self, Error> {
        Ok(value)
    }
}

impl Read for f64 {
    #[inline(never)]
    fn read(value: Value) -> Result<Self, Error> {
        value.as_f64().ok_or_else(|| wrong(&value, "f64"))
    }
}

impl Read for f32 {
    fn read(value: Value) -> Result<Self, Error> {
        f64::read(value).map(|value| value as Self)
    }
}

impl Read for u64 {
    #[inline(never)]
    fn read(value: Value) -> Result<Self, Error> {
        value.as_u64().ok_or_else(|| wrong(&value, "u64"))
    }
}

impl Read for u32 {
    fn read(value: Value) -> Result<Self, Error> {
        value.as_u64().and_then(|number| number.try_into().ok()).ok_or_else(|| wrong(&value, "u32"))
    }
}

impl Read for String {
    #[inline(never)]
    fn read(value: Value) -> Result<Self, Error> {
        match value {
            Value::String(text) => Ok(text),
            other => Err(wrong(&other, "a string")),
        }
    }
}

impl<T: Read> Read for Option<T> {
    fn read(value: Value) -> Result<Self, Error> {
        if value.is_null() { Ok(None) } else { T::read(value).map(Some) }
    }
}

impl<T: Read> Read for Vec<T> {
    fn read(value: Value) -> Result<Self, Error> {
        let Value::Array(values) = value else { return Err(wrong(&value, "an array")) };
        let mut read = Self::with_capacity(values.len());
        for value in values {
            read.push(T::read(value)?);
        }
        Ok(read)
    }
}

impl Read for [f64; 2] {
    fn read(value: Value) -> Result<Self, Error> {
        let numbers = Vec::<f64>::read(value)?;
        numbers.try_into().map_err(|numbers: Vec<f64>| Error::invalid_length(numbers.len(), &"2 numbers"))
    }
}

/// A word, as serde has it.
macro_rules! words {
    ($($name:ty),*) => {$(
        impl Read for $name {
            fn read(value: Value) -> Result<Self, Error> {
                let word = value.as_str().ok_or_else(|| wrong(&value, "a word"))?;
                Self::deserialize(word.into_deserializer())
            }
        }
    )*};
}

/// A structure by its fields, those that may be missing after the others; no other may be there.
macro_rules! structures {
    ($($name:ident { $($field:ident),* $(; $($optional:ident),*)? })*) => {$(
        impl Read for $name {
            fn read(value: Value) -> Result<Self, Error> {
                Self::from_fields(Fields::of(value)?)
            }
        }

        impl $name {
            #[inline(never)]
            pub(super) fn from_fields(mut fields: Fields) -> Result<Self, Error> {
                let read = Self {
                    $($field: fields.take(stringify!($field))?,)*
                    $($($optional: fields.take_or_default(stringify!($optional))?,)*)?
                };
                fields.finish()?;
                Ok(read)
            }
        }
    )*};
}

words!(Precision, Tunability, super::ClockKind);

structures! {
    Metadata {
        name, description, inputs, outputs, time_step, provenance;
        states, arrays, bounds, solver_error, cover, precision, stop_time
    }
    Input { name, role, unit, description, min, max, start; encoding }
    State { name, unit, rate_unit, description, nominal; range }
    Output { name, unit, description, min, max; std_of }
    OutputArray { name, description, outputs }
    Provenance { tool, study_digest, seed, train_rows, content_digest }
    Bounds { coverage, runs, half_widths; times }
    Cover { columns, radius, centres }
}

impl Read for Role {
    fn read(value: Value) -> Result<Self, Error> {
        let mut fields = Fields::of(value)?;
        match fields.take::<String>("causality")?.as_str() {
            "parameter" => Ok(Self::Parameter(fields.take("variability")?)),
            "time" => Ok(Self::Time),
            "input" => Ok(Self::Input),
            "start" => Ok(Self::Start),
            other => Err(Error::unknown_variant(other, &["parameter", "time", "input", "start"])),
        }
    }
}

impl Read for Encoding {
    fn read(value: Value) -> Result<Self, Error> {
        match value {
            Value::String(word) if word == "plain" => Ok(Self::Plain),
            Value::String(word) if word == "periodic" => Ok(Self::Periodic),
            Value::Object(fields) => {
                let mut fields = Fields::from(fields);
                let values = fields.take("nominal")?;
                fields.finish()?;
                Ok(Self::Nominal(values))
            }
            other => Err(wrong(&other, "plain, nominal or periodic")),
        }
    }
}
