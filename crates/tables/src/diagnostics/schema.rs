//! Files against the JSON schema of the types that read them: unknown keys, missing keys and values of the wrong type, all at once.
//!
//! A schema comes from the types' doc comments and serde attributes, so that messages, reference pages and editors have the same
//! source. Beside the standard keywords there is `x-unit`, the unit of a number, for the reference pages. Limits of numbers are for
//! editors: here they are left to the checks of each section, which know why.

use super::names::did_you_mean;
use schemars::{JsonSchema, generate::SchemaSettings};
use serde_json::{Map, Value};
use std::{borrow::Cow, ops::Range};
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// The schema (draft 7, which editors of TOML know) of a file that is read as a `T`; nothing in TOML is null.
pub fn of<T: JsonSchema>() -> Value {
    let settings = SchemaSettings::draft07().with(|settings| settings.inline_subschemas = true);
    let mut schema: Value = settings.into_generator().into_root_schema_for::<T>().into();
    remove_null(&mut schema);
    schema
}

fn remove_null(schema: &mut Value) {
    match schema {
        Value::Object(node) => {
            node.retain(|key, value| !(key == "default" && value.is_null()));
            if let Some(Value::Array(types)) = node.get_mut("type") {
                types.retain(|name| name != "null");
                if let [one] = types.as_slice() {
                    let one = one.clone();
                    node.insert("type".into(), one);
                }
            }
            if let Some(Value::Array(choices)) = node.get_mut("enum") {
                choices.retain(|choice| !choice.is_null());
            }
            if let Some(Value::Array(choices)) = node.get_mut("anyOf") {
                choices.retain(|choice| choice.get("type").is_none_or(|name| name != "null"));
                if choices.len() == 1
                    && let Some(Value::Object(only)) = choices.pop()
                {
                    node.remove("anyOf");
                    only.into_iter().for_each(|(key, value)| {
                        node.entry(key).or_insert(value);
                    });
                }
            }
            node.values_mut().for_each(remove_null);
        }
        Value::Array(items) => items.iter_mut().for_each(remove_null),
        _ => {}
    }
}

/// Function that checks a text against a format of the schema: takes the format's name and the text, returns the
/// problem.
pub type Formats = fn(&str, &str) -> Option<String>;

/// One mistake.
#[derive(Clone, Debug)]
pub struct Mistake {
    /// Dotted key.
    pub key: String,
    /// Byte offset in the text.
    pub offset: usize,
    /// Found and expected values.
    pub message: String,
    /// `true` if the mistake is a missing key.
    pub is_missing: bool,
}

/// Every mistake in a TOML document, which is the text's.
pub fn mistakes(schema: &Value, formats: Formats, root: &DeTable, text: &str) -> Vec<Mistake> {
    let mut check = Check { formats, text, mistakes: Vec::new() };
    check.table(schema, root, "", 0);
    check.mistakes
}

struct Check<'a> {
    formats: Formats,
    text: &'a str,
    mistakes: Vec<Mistake>,
}

impl Check<'_> {
    fn add(&mut self, key: &str, offset: usize, message: String) {
        self.mistakes.push(Mistake { key: key.into(), offset, message, is_missing: false });
    }

    /// Checks a value and its content; `offset` is the position of its key.
    fn value(&mut self, schema: &Value, value: &Spanned<DeValue>, key: &str, offset: usize) {
        let alternatives = schema.get("anyOf").and_then(Value::as_array);
        let fitting = alternatives.and_then(|all| all.iter().find(|one| is_of_type(one, value.get_ref())));
        let schema = fitting.unwrap_or(schema);
        if schema.as_object().is_none_or(|node| !node.keys().any(|key| CONSTRAINTS.contains(&key.as_str()))) {
            return;
        }
        match value.get_ref() {
            DeValue::Table(table) if is_of_type(schema, value.get_ref()) => self.table(schema, table, key, offset),
            DeValue::Array(elements) if is_of_type(schema, value.get_ref()) => {
                if lengths(schema).is_some_and(|[least, most]| !(least..=most).contains(&(elements.len() as u64))) {
                    let message = format!("a list of {}, expected {}", elements.len(), expected(schema));
                    self.add(key, value.span().start, message);
                } else if let Some(items) = schema.get("items") {
                    for (index, element) in elements.iter().enumerate() {
                        self.value(items, element, &format!("{key}[{index}]"), element.span().start);
                    }
                }
            }
            found => {
                let range = value.span();
                if let Some(message) = self.problem_of(schema, found, &range) {
                    self.add(key, range.start, message);
                }
            }
        }
    }

    fn table(&mut self, schema: &Value, table: &DeTable, prefix: &str, offset: usize) {
        let none = Map::new();
        let properties = schema.get("properties").and_then(Value::as_object).unwrap_or(&none);
        let others = schema.get("additionalProperties").unwrap_or(&Value::Bool(true));
        for (name, value) in table.iter() {
            let (offset, name): (usize, &Cow<str>) = (name.span().start, Spanned::get_ref(name));
            let key = if prefix.is_empty() { name.to_string() } else { format!("{prefix}.{name}") };
            match properties.get(name.as_ref()) {
                Some(property) => self.value(property, value, &key, offset),
                None if *others == Value::Bool(false) => {
                    let known: Vec<&str> = properties.keys().map(String::as_str).collect();
                    // of two that are equally close the one that is not given yet
                    let (given, open): (Vec<&str>, Vec<&str>) =
                        known.iter().copied().partition(|name| has_key(table, name));
                    let suggestion = did_you_mean(name, open.into_iter().chain(given));
                    self.add(&key, offset, format!("unknown key `{name}`, expected {}{suggestion}", one_of(&known)));
                }
                None => self.value(others, value, &key, offset),
            }
        }
        let required = schema.get("required").and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_str);
        for name in required.filter(|name| !has_key(table, name)) {
            let message = format!("`{name}` is missing");
            self.mistakes.push(Mistake { key: prefix.into(), offset, message, is_missing: true });
        }
    }

    /// The problem of a value that has no nested values, or whose type differs from the schema's.
    fn problem_of(&self, schema: &Value, found: &DeValue, range: &Range<usize>) -> Option<String> {
        let shown = match found {
            DeValue::Array(_) => "a list".to_owned(),
            DeValue::Table(_) => "a table".to_owned(),
            DeValue::Datetime(_) => format!("the date or time {}", self.text.get(range.clone()).unwrap_or_default()),
            _ => shortened(self.text.get(range.clone()).unwrap_or_default()),
        };
        let choices = choices(schema);
        if let (DeValue::String(text), false) = (found, choices.is_empty()) {
            let suggestion = did_you_mean(text, choices.iter().copied()).replace('`', "\"");
            let known: Vec<String> = choices.iter().map(|name| format!("\"{name}\"")).collect();
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            let is_known = choices.contains(&text.as_ref());
            return (!is_known).then(|| format!("\"{text}\", expected {}{suggestion}", one_of(&known)));
        }
        if !is_of_type(schema, found) {
            return Some(format!("{shown}, expected {}{}", expected(schema), hint(schema, found)));
        }
        match found {
            DeValue::String(text) => (self.formats)(schema.get("format")?.as_str()?, text),
            DeValue::Float(_) => (self.formats)(schema.get("format")?.as_str()?, &shown),
            DeValue::Integer(number) if i64::from_str_radix(number.as_str(), number.radix()).is_err() => {
                Some(format!("{shown}, expected a smaller number"))
            }
            DeValue::Integer(number) if least_natural(schema).is_some() && number.as_str().starts_with('-') => {
                Some(format!("{shown}, expected {}", expected(schema)))
            }
            DeValue::Integer(number) if number.as_str().parse::<f64>().ok() > most(schema) => {
                Some(format!("{shown}, expected a smaller number"))
            }
            _ => None,
        }
    }
}

/// Keywords without which anything is good.
const CONSTRAINTS: [&str; 5] = ["type", "anyOf", "oneOf", "enum", "const"];

/// The smallest number of a type of whole numbers that has no negative ones.
fn least_natural(schema: &Value) -> Option<u64> {
    let is_whole = schema.get("type").is_some_and(|name| name == "integer");
    schema.get("minimum").filter(|_| is_whole).and_then(Value::as_u64)
}

/// The largest number of the type.
fn most(schema: &Value) -> Option<f64> {
    match schema.get("format").and_then(Value::as_str) {
        Some("uint8") => Some(f64::from(u8::MAX)),
        Some("uint16") => Some(f64::from(u16::MAX)),
        Some("uint32") => Some(f64::from(u32::MAX)),
        _ => Some(f64::INFINITY),
    }
}

/// Returns true if a value has the schema's type, whatever its content.
fn is_of_type(schema: &Value, value: &DeValue) -> bool {
    if let Some(all) = schema.get("anyOf").and_then(Value::as_array) {
        return all.iter().any(|one| is_of_type(one, value));
    }
    let name = schema.get("type").and_then(Value::as_str);
    match value {
        DeValue::String(_) => name == Some("string") || !choices(schema).is_empty(),
        DeValue::Integer(_) => matches!(name, Some("integer" | "number")),
        DeValue::Float(_) => name == Some("number"),
        DeValue::Boolean(_) => name == Some("boolean"),
        DeValue::Datetime(_) => false,
        DeValue::Array(_) => name == Some("array"),
        DeValue::Table(_) => name == Some("object"),
    }
}

/// The texts that a value may have; none: any.
pub fn choices(schema: &Value) -> Vec<&str> {
    let listed = schema.get("enum").and_then(Value::as_array).into_iter().flatten();
    let described = schema.get("oneOf").and_then(Value::as_array).into_iter().flatten();
    // schemars lists choices without a description in one `enum` among the others
    let described = described.flat_map(|choice| match choice.get("const") {
        Some(constant) => vec![constant],
        None => listed_in(choice),
    });
    listed.chain(described).filter_map(Value::as_str).collect()
}

fn has_key(table: &DeTable, name: &str) -> bool {
    table.iter().any(|(known, _)| Spanned::get_ref(known) == name)
}

fn listed_in(schema: &Value) -> Vec<&Value> {
    schema.get("enum").and_then(Value::as_array).into_iter().flatten().collect()
}

/// Least and largest number of elements of a list; the largest one is the least one unless the schema has it.
fn lengths(schema: &Value) -> Option<[u64; 2]> {
    let least = schema.get("minItems").and_then(Value::as_u64)?;
    Some([least, schema.get("maxItems").and_then(Value::as_u64).unwrap_or(least)])
}

/// The type as text.
pub fn expected(schema: &Value) -> String {
    if let Some(all) = schema.get("anyOf").and_then(Value::as_array) {
        let all: Vec<String> = all.iter().map(expected).collect();
        return all.join(" or ");
    }
    let examples = schema.get("examples").and_then(Value::as_array).into_iter().flatten();
    let examples: Vec<String> = examples.map(inline).collect();
    match schema.get("type").and_then(Value::as_str).unwrap_or("string") {
        "number" => "a number".into(),
        "integer" => match least_natural(schema) {
            Some(least) => format!("a whole number of at least {least}"),
            None => "a whole number".into(),
        },
        "boolean" => "true or false".into(),
        "array" => match lengths(schema) {
            Some([least, most]) if least == most => format!("a list of {least}"),
            Some([least, most]) => format!("a list of {least} to {most}"),
            None => "a list in [ ]".into(),
        },
        "object" if examples.is_empty() => "a table".into(),
        "object" => format!("a table such as {}", examples.join(" or ")),
        _ => match schema.get("format").and_then(Value::as_str) {
            Some("expression") => "an expression in quotes".into(),
            Some("path") => "the name of a file in quotes".into(),
            _ => "a text in quotes".into(),
        },
    }
}

/// A value as TOML in one line.
pub fn inline(value: &Value) -> String {
    match value {
        Value::Object(entries) if entries.is_empty() => "{}".into(),
        Value::Object(entries) => {
            let entries: Vec<String> =
                entries.iter().map(|(key, value)| format!("{key} = {}", inline(value))).collect();
            format!("{{ {} }}", entries.join(", "))
        }
        Value::Array(items) => format!("[{}]", items.iter().map(inline).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

/// The remedy for a value of the wrong type, where it is clear.
fn hint(schema: &Value, found: &DeValue) -> String {
    let name = schema.get("type").and_then(Value::as_str);
    match (name, found) {
        (Some("integer"), DeValue::Float(_)) => ", without a point and without an exponent".into(),
        (Some("number"), DeValue::String(text)) => {
            text.parse::<f64>().map_or(String::new(), |number| format!(": {number} without quotes"))
        }
        _ => String::new(),
    }
}

/// A list of names in a sentence.
fn one_of(known: &[&str]) -> String {
    match known {
        [] => "none".into(),
        [one] => (*one).to_owned(),
        [one, other] => format!("{one} or {other}"),
        all => format!("one of {}", all.join(", ")),
    }
}

/// As much of the first line as one reads.
pub(super) fn shortened(text: &str) -> String {
    const MOST: usize = 40;
    let line = text.lines().next().unwrap_or_default();
    match line.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}...", &line[..end]),
        None => line.to_owned(),
    }
}
