//! Output that the writers of both versions share: elements, attributes, numbers, and parts that look the same in both.

use crate::{
    model_description::{DefaultExperiment, DisplayUnit, ModelDescription, Named, UnitDefinition, Unknown},
    unit::BaseUnit,
};
use std::fmt::Write;

/// The attributes of the root element that both versions have; `token` is the name of that attribute.
pub fn root_attributes(description: &ModelDescription, token: &str) -> XmlAttributes {
    let mut root = XmlAttributes::default();
    root.add("fmiVersion", &description.fmi_version.to_string())
        .add("modelName", &description.model_name)
        .add(token, &description.token);
    for (name, value) in [
        ("description", &description.description),
        ("author", &description.author),
        ("version", &description.version),
        ("copyright", &description.copyright),
        ("license", &description.license),
        ("generationTool", &description.generation_tool),
        ("generationDateAndTime", &description.generation_date_and_time),
    ] {
        root.add_some(name, value.as_deref());
    }
    root.add("variableNamingConvention", description.naming.name());
    root
}

pub fn log_category(out: &mut XmlWriter, (name, description): &(String, Option<String>)) {
    out.empty("Category", XmlAttributes::default().add("name", name).add_some("description", description.as_deref()));
}

/// Adds the dependencies of an unknown; `handle` is the version's reference to a variable.
pub fn add_dependencies(attributes: &mut XmlAttributes, unknown: &Unknown, handle: impl Fn(usize) -> String) {
    let dependencies = unknown.dependencies.as_ref().map(|list| {
        let handles: Vec<String> = list.iter().map(|&position| handle(position)).collect();
        handles.join(" ")
    });
    let kinds = unknown.kinds.as_ref().map(|list| {
        let names: Vec<&str> = list.iter().map(|kind| kind.name()).collect();
        names.join(" ")
    });
    attributes.add_some("dependencies", dependencies.as_deref()).add_some("dependenciesKind", kinds.as_deref());
}

pub fn unit(out: &mut XmlWriter, unit: &UnitDefinition) {
    let UnitDefinition { name, base, display } = unit;
    let mut attributes = XmlAttributes::default();
    attributes.add("name", name);
    if base.is_none() && display.is_empty() {
        return out.empty("Unit", &attributes);
    }
    out.element("Unit", &attributes, |out| {
        if let Some(BaseUnit { exponents, factor, offset }) = base {
            let mut attributes = XmlAttributes::default();
            for (symbol, exponent) in BaseUnit::SYMBOLS.iter().zip(exponents).filter(|(_, exponent)| **exponent != 0) {
                attributes.add(symbol, &exponent.to_string());
            }
            attributes.add_real_unless("factor", *factor, 1.0).add_real_unless("offset", *offset, 0.0);
            out.empty("BaseUnit", &attributes);
        }
        for DisplayUnit { name, factor, offset } in display {
            let mut attributes = XmlAttributes::default();
            attributes
                .add("name", name)
                .add_real_unless("factor", *factor, 1.0)
                .add_real_unless("offset", *offset, 0.0);
            out.empty("DisplayUnit", &attributes);
        }
    });
}

pub fn experiment_attributes(experiment: &DefaultExperiment) -> XmlAttributes {
    let mut attributes = XmlAttributes::default();
    attributes
        .add_real("startTime", experiment.start)
        .add_real("stopTime", experiment.stop)
        .add_real("tolerance", experiment.tolerance)
        .add_real("stepSize", experiment.step_size);
    attributes
}

/// Writer of XML: the text so far and the depth of the next element.
pub struct XmlWriter {
    text: String,
    depth: usize,
}

impl XmlWriter {
    pub fn new() -> Self {
        Self { text: "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".into(), depth: 0 }
    }

    pub fn finish(self) -> String {
        self.text
    }

    pub fn element(&mut self, name: &str, attributes: &XmlAttributes, children: impl FnOnce(&mut Self)) {
        self.line(&format!("<{name}{}>", attributes.text));
        self.depth += 1;
        children(self);
        self.depth -= 1;
        self.line(&format!("</{name}>"));
    }

    pub fn empty(&mut self, name: &str, attributes: &XmlAttributes) {
        self.line(&format!("<{name}{}/>", attributes.text));
    }

    /// An element with one child per item; nothing for an empty list, which the standard does not allow.
    pub fn list<T>(&mut self, name: &str, items: &[T], item: impl Fn(&mut Self, &T)) {
        if !items.is_empty() {
            self.element(name, &XmlAttributes::default(), |out| items.iter().for_each(|value| item(out, value)));
        }
    }

    fn line(&mut self, line: &str) {
        for _ in 0..self.depth {
            self.text.push_str("  ");
        }
        self.text.push_str(line);
        self.text.push('\n');
    }
}

/// Attributes of one element.
#[derive(Default)]
pub struct XmlAttributes {
    text: String,
}

impl XmlAttributes {
    pub fn add(&mut self, name: &str, value: &str) -> &mut Self {
        self.text.push_str(&format!(" {name}=\""));
        for c in value.chars() {
            match c {
                '&' => self.text.push_str("&amp;"),
                '<' => self.text.push_str("&lt;"),
                '>' => self.text.push_str("&gt;"),
                '"' => self.text.push_str("&quot;"),
                // a reader would turn them into spaces
                '\t' | '\n' | '\r' => self.text.push_str(&format!("&#{};", u32::from(c))),
                // no character of XML 1.0, not even as a reference
                '\0'..'\u{20}' | '\u{fffe}' | '\u{ffff}' => self.text.push(char::REPLACEMENT_CHARACTER),
                c => self.text.push(c),
            }
        }
        self.text.push('"');
        self
    }

    pub fn add_some(&mut self, name: &str, value: Option<&str>) -> &mut Self {
        match value {
            Some(value) => self.add(name, value),
            None => self,
        }
    }

    pub fn add_true(&mut self, name: &str, value: bool) -> &mut Self {
        self.add_some(name, value.then_some("true"))
    }

    pub fn add_real(&mut self, name: &str, value: Option<f64>) -> &mut Self {
        self.add_some(name, value.map(real).as_deref())
    }

    pub fn add_real_unless(&mut self, name: &str, value: f64, default: f64) -> &mut Self {
        self.add_real(name, (value != default).then_some(value))
    }
}

/// The shortest text that reads back as the same number.
pub fn real(value: f64) -> String {
    if value.is_nan() {
        return "NaN".into();
    }
    if value.is_infinite() {
        return if value > 0.0 { "INF".into() } else { "-INF".into() };
    }
    let mut text = String::new();
    let magnitude = value.abs();
    // writing to a string does not fail
    let _ = if magnitude == 0.0 || (1e-5..1e15).contains(&magnitude) {
        write!(text, "{value}")
    } else {
        write!(text, "{value:e}")
    };
    text
}
