//! Attributes of a node.

use super::{
    proto::{AttributeProto, NodeProto},
    tensor::Tensor,
};

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

    pub fn float(self, name: &str, default: f64) -> Result<f64, String> {
        let value = self.find(name).and_then(|attribute| attribute.f).map_or(default, shortest);
        if value.is_finite() {
            Ok(value)
        } else {
            Err(format!("attribute `{name}` is {value}, expected a finite number"))
        }
    }

    pub fn integer(self, name: &str) -> Option<i64> {
        self.find(name).and_then(|attribute| attribute.i)
    }

    pub fn integers(self, name: &str) -> Option<&'a [i64]> {
        self.find(name).map(|attribute| attribute.ints.as_slice())
    }

    pub fn text(self, name: &str) -> Option<String> {
        let text = self.find(name).and_then(|attribute| attribute.s.as_ref())?;
        Some(String::from_utf8_lossy(text).into_owned())
    }

    pub fn texts(self, name: &str) -> Vec<String> {
        let texts = self.find(name).map(|attribute| attribute.strings.as_slice()).unwrap_or_default();
        texts.iter().map(|text| String::from_utf8_lossy(text).into_owned()).collect()
    }

    pub fn tensor(self, name: &str) -> Option<Result<Tensor, String>> {
        let tensor = self.find(name)?.t.as_ref()?;
        Some(Tensor::read(tensor, None).map_err(|problem| format!("attribute `{name}`: {problem}")))
    }

    /// Numbers in single precision, or those in double precision of the attribute `NAME_as_tensor`.
    pub fn numbers(self, name: &str) -> Result<Numbers, String> {
        if let Some(tensor) = self.tensor(&format!("{name}_as_tensor")) {
            return Ok(Numbers { values: tensor?.data.doubles(), is_single: false });
        }
        let floats = self.find(name).map(|attribute| attribute.floats.as_slice()).unwrap_or_default();
        match floats.iter().position(|value| !value.is_finite()) {
            Some(place) => Err(format!("attribute `{name}`, element {place}: {} is not finite", floats[place])),
            None => Ok(Numbers { values: floats.iter().map(|value| f64::from(*value)).collect(), is_single: true }),
        }
    }
}

/// Numbers of an attribute.
pub struct Numbers {
    pub values: Vec<f64>,
    pub is_single: bool,
}

/// The double with the fewest digits that is this single: 0.01 is meant by the single next to it. Frameworks that compute in double
/// precision have it so, and those in single precision lose nothing.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}
