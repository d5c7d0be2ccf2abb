//! Attributes of a node.

use super::{
    ImportError,
    proto::{AttributeProto, NodeProto},
    tensor::ConstantTensor,
};

// Kinds of attributes, `AttributeProto.AttributeType`. Writers may omit a number that is 0 and an empty text, so that
// only the kind remains; older files have no kinds.
const FLOAT: i32 = 1;
const INT: i32 = 2;
const STRING: i32 = 3;

/// The attributes of a node, by name.
#[derive(Clone, Copy)]
pub struct Attributes<'a>(&'a NodeProto);

impl<'a> Attributes<'a> {
    pub fn of(node: &'a NodeProto) -> Self {
        Self(node)
    }

    fn find(self, name: &str) -> Option<&'a AttributeProto> {
        self.0.attribute.iter().find(|attribute| attribute.name == name)
    }

    pub fn float(self, name: &str, default: f64) -> Result<f64, ImportError> {
        let value = self.number(name).map_or(default, shortest);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(ImportError::not_finite(format!("attribute `{name}` is {value}, expected a finite number")))
        }
    }

    /// Value of an attribute that is this constant unless another one is given: the nearest single means the constant itself.
    pub fn constant(self, name: &str, constant: f64) -> Result<f64, ImportError> {
        let given = self.float(name, constant)?;
        Ok(if given as f32 == constant as f32 { constant } else { given })
    }

    /// Value of the attribute, be it finite or not.
    pub fn number(self, name: &str) -> Option<f32> {
        self.find(name).and_then(|attribute| attribute.f.or((attribute.kind == FLOAT).then_some(0.0)))
    }

    pub fn integer(self, name: &str) -> Option<i64> {
        self.find(name).and_then(|attribute| attribute.i.or((attribute.kind == INT).then_some(0)))
    }

    pub fn integers(self, name: &str) -> Option<&'a [i64]> {
        self.find(name).map(|attribute| attribute.ints.as_slice())
    }

    pub fn text(self, name: &str) -> Option<String> {
        let attribute = self.find(name)?;
        match &attribute.s {
            Some(text) => Some(String::from_utf8_lossy(text).into_owned()),
            None => (attribute.kind == STRING).then(String::new),
        }
    }

    pub fn texts(self, name: &str) -> Vec<String> {
        let texts = self.find(name).map(|attribute| attribute.strings.as_slice()).unwrap_or_default();
        texts.iter().map(|text| String::from_utf8_lossy(text).into_owned()).collect()
    }

    pub fn tensor(self, name: &str) -> Option<Result<ConstantTensor, ImportError>> {
        let tensor = self.find(name)?.t.as_ref()?;
        Some(ConstantTensor::read(tensor, None).map_err(|error| error.behind(&format_args!("attribute `{name}`"))))
    }

    /// Doubles that the numbers stand for; none unless given.
    pub fn floats(self, name: &str) -> Result<Vec<f64>, ImportError> {
        let floats = self.find(name).map(|attribute| attribute.floats.as_slice()).unwrap_or_default();
        match floats.iter().find(|value| !value.is_finite()) {
            Some(value) => {
                let message = format!("attribute `{name}` has {value}, expected finite numbers");
                Err(ImportError::not_finite(message))
            }
            None => Ok(floats.iter().map(|value| shortest(*value)).collect()),
        }
    }

    /// Numbers in single precision, or those in double precision of the attribute `NAME_as_tensor`.
    pub fn numbers(self, name: &str) -> Result<AttributeNumbers, ImportError> {
        if let Some(tensor) = self.tensor(&format!("{name}_as_tensor")) {
            return Ok(AttributeNumbers { values: tensor?.data.doubles(), is_single: false });
        }
        let floats = self.find(name).map(|attribute| attribute.floats.as_slice()).unwrap_or_default();
        match floats.iter().position(|value| !value.is_finite()) {
            Some(place) => {
                let message = format!("attribute `{name}`, element {place}: {} is not finite", floats[place]);
                Err(ImportError::not_finite(message))
            }
            None => {
                Ok(AttributeNumbers { values: floats.iter().map(|value| f64::from(*value)).collect(), is_single: true })
            }
        }
    }
}

/// Numbers of an attribute.
pub struct AttributeNumbers {
    pub values: Vec<f64>,
    pub is_single: bool,
}

/// Double that a single-precision attribute stands for. Frameworks that compute in double precision store 0.01 as the
/// nearest single. The result is the shortest decimal number if it has few digits, or a fraction such as 1/6. It is the
/// single itself if its last bits are zero, as in 0.25.
fn shortest(value: f32) -> f64 {
    const ROUND_BITS: u32 = 10;
    const MANY_DIGITS: usize = 7;
    if value.to_bits().trailing_zeros() >= ROUND_BITS {
        return value.into();
    }
    let text = format!("{value:e}");
    let digits = text.split('e').next().unwrap_or_default().chars().filter(char::is_ascii_digit).count();
    let fractions = [3.0, 6.0, 7.0, 9.0, 11.0, 12.0].map(|parts| (f64::from(value) * parts).round() / parts);
    let meant = fractions.into_iter().find(|meant| digits >= MANY_DIGITS && *meant as f32 == value);
    meant.or_else(|| text.parse().ok()).unwrap_or(value.into())
}

#[cfg(test)]
mod tests {
    use super::shortest;

    #[test]
    fn decimals_and_powers_of_two_are_what_was_meant() {
        for meant in
            [0.01, 1e-5, 0.1, 1.673_263_2, 0.25, 1.0 / 6.0, -2.0 / 3.0, 2f64.powi(-16), 0.0, -3.0, 1.0 / 1024.0]
        {
            assert_eq!(shortest(meant as f32), meant);
        }
    }
}
