//! Compares a modelDescription.xml with the rules of a version: its elements and attributes, their order and their
//! types.

use super::{XmlProblem, tree::Element};

/// Type of an attribute.
#[derive(Clone, Copy, PartialEq)]
pub enum ValueType {
    Text,
    /// A text that is not empty.
    Name,
    Real,
    /// An integer from the first to the second number.
    Whole(i128, i128),
    Boolean,
    Hex,
    /// A list of positions or value references.
    Indices,
    Reals,
    Wholes(i128, i128),
    Booleans,
    OneOf(&'static [&'static str]),
    Several(&'static [&'static str]),
}

pub const INTEGER: ValueType = ValueType::Whole(i32::MIN as i128, i32::MAX as i128);
pub const UNSIGNED: ValueType = ValueType::Whole(0, u32::MAX as i128);
pub const UNSIGNED_64: ValueType = ValueType::Whole(0, u64::MAX as i128);

pub struct Attribute {
    name: &'static str,
    value: ValueType,
    required: bool,
}

pub const fn needs(name: &'static str, value: ValueType) -> Attribute {
    Attribute { name, value, required: true }
}

pub const fn may(name: &'static str, value: ValueType) -> Attribute {
    Attribute { name, value, required: false }
}

/// How often a child element may occur in its parent.
#[derive(Clone, Copy, PartialEq)]
pub enum Occurs {
    AtMostOnce,
    Once,
    AtLeastOnce,
    Any,
}

/// Further rule for the content of an element.
#[derive(Clone, Copy, PartialEq)]
pub enum Content {
    /// No further rule.
    Closed,
    /// Attributes that are not in the rule are allowed.
    OpenAttributes,
    /// There is exactly one of these children.
    OneOfThem(&'static [&'static str]),
    /// There is at least one child, whichever.
    NotEmpty,
}

pub struct Rule {
    /// Names of the elements, with their parent's where the name alone is not enough.
    pub elements: &'static [&'static str],
    /// Groups of attributes.
    pub attributes: &'static [&'static [Attribute]],
    /// Children in the order the standard demands; those that share a number may change places.
    pub children: &'static [(u8, &'static str, Occurs)],
    pub content: Content,
}

/// Compares an element and everything in it with the rules.
pub fn check(rules: &[Rule], element: &Element, parent: &str, problems: &mut Vec<XmlProblem>) {
    let full = format!("{parent}/{}", element.name);
    let mut rules_of_element =
        rules.iter().filter(|rule| rule.elements.iter().any(|name| *name == element.name || *name == full));
    let Some(rule) = rules_of_element.next() else {
        // annotations: any content
        return;
    };
    check_attributes(element, rule, problems);
    check_children(element, rule, problems);
    for child in element.children.iter().filter(|child| rule.children.iter().any(|(_, name, _)| *name == child.name)) {
        check(rules, child, &element.name, problems);
    }
}

fn check_attributes(element: &Element, rule: &Rule, problems: &mut Vec<XmlProblem>) {
    let Element { name: tag, line, .. } = element;
    let known = rule.attributes.iter().copied().flatten();
    for Attribute { name, required, .. } in known.clone() {
        if *required && element.attribute(name).is_none() {
            problems.push(XmlProblem::unusable(*line, format!("<{tag}> has no attribute `{name}`")));
        }
    }
    for (name, value) in &element.attributes {
        match known.clone().find(|attribute| attribute.name == name) {
            Some(attribute) => {
                if let Some(expected) = mismatch(attribute.value, value) {
                    let message = format!("<{tag}> has {name}=\"{value}\", expected {expected}");
                    problems.push(XmlProblem::unusable(*line, message));
                }
            }
            // namespaces and schema locations are none of FMI's business
            None if name.contains(':') || name == "xmlns" || rule.content == Content::OpenAttributes => {}
            None => problems.push(XmlProblem::new(*line, format!("<{tag}> has an unknown attribute `{name}`"))),
        }
    }
}

fn check_children(element: &Element, rule: &Rule, problems: &mut Vec<XmlProblem>) {
    let tag = &element.name;
    let mut last: (u8, &str) = (0, "");
    for child in &element.children {
        let Some((rank, ..)) = rule.children.iter().find(|(_, name, _)| *name == child.name) else {
            problems.push(XmlProblem::new(child.line, format!("<{}> is not an element of <{tag}>", child.name)));
            continue;
        };
        if *rank < last.0 {
            let message = format!("<{}> must come before <{}> in <{tag}>", child.name, last.1);
            problems.push(XmlProblem::new(child.line, message));
        } else {
            last = (*rank, &child.name);
        }
    }
    for (_, name, occurs) in rule.children {
        let count = element.children.iter().filter(|child| child.name == *name).count();
        let line = element.line;
        match occurs {
            Occurs::Once if count == 0 => problems.push(XmlProblem::unusable(line, format!("<{tag}> has no <{name}>"))),
            Occurs::AtLeastOnce if count == 0 => {
                problems.push(XmlProblem::new(line, format!("<{tag}> has no <{name}>")))
            }
            Occurs::Once | Occurs::AtMostOnce if count > 1 => {
                problems.push(XmlProblem::unusable(line, format!("<{tag}> has {count} <{name}>, expected one")));
            }
            _ => {}
        }
    }
    match rule.content {
        Content::OneOfThem(names) => {
            let count = element.children.iter().filter(|child| names.contains(&child.name.as_str())).count();
            if count != 1 {
                let names: Vec<String> = names.iter().map(|name| format!("<{name}>")).collect();
                let message = format!("<{tag}> has {count} of {}, expected one", names.join(", "));
                problems.push(XmlProblem::unusable(element.line, message));
            }
        }
        Content::NotEmpty if element.children.is_empty() => {
            problems.push(XmlProblem::new(element.line, format!("<{tag}> is empty")));
        }
        Content::NotEmpty | Content::Closed | Content::OpenAttributes => {}
    }
}

/// Description of the expected type, if the value is not of that type.
fn mismatch(expected_type: ValueType, value: &str) -> Option<String> {
    let mut words = value.split_whitespace();
    let (fits, expected) = match expected_type {
        ValueType::Text => (true, ""),
        ValueType::Name => (!value.trim().is_empty(), "a name"),
        ValueType::Real => (parse_real(value).is_some(), "a number"),
        INTEGER => (is_whole(value, i32::MIN.into(), i32::MAX.into()), "an integer of 32 bits"),
        ValueType::Whole(min, max) => {
            return (!is_whole(value, min, max)).then(|| format!("an integer from {min} to {max}"));
        }
        ValueType::Boolean => (parse_boolean(value).is_some(), "true or false"),
        ValueType::Hex => (
            value.len().is_multiple_of(2) && value.bytes().all(|b| b.is_ascii_hexdigit()),
            "pairs of hexadecimal digits",
        ),
        ValueType::Indices => (words.all(|index| index.parse::<u32>().is_ok()), "a list of indices"),
        ValueType::Reals => (words.all(|word| parse_real(word).is_some()), "a list of numbers"),
        ValueType::Wholes(min, max) => {
            return (!words.all(|word| is_whole(word, min, max)))
                .then(|| format!("a list of integers from {min} to {max}"));
        }
        ValueType::Booleans => (words.all(|word| parse_boolean(word).is_some()), "a list of true and false"),
        ValueType::OneOf(names) => return (!names.contains(&value)).then(|| format!("one of {}", names.join(", "))),
        ValueType::Several(names) => {
            let known = words.all(|word| names.contains(&word));
            return (!known).then(|| format!("a list of {}", names.join(", ")));
        }
    };
    (!fits).then(|| expected.to_owned())
}

/// Returns true if a text is a whole number of a range.
fn is_whole(text: &str, min: i128, max: i128) -> bool {
    text.trim().parse::<i128>().is_ok_and(|number| (min..=max).contains(&number))
}

/// A `xs:double`, which has fewer spellings than Rust's.
pub fn parse_real(text: &str) -> Option<f64> {
    match text.trim() {
        "INF" => Some(f64::INFINITY),
        "-INF" => Some(f64::NEG_INFINITY),
        "NaN" => Some(f64::NAN),
        number => {
            let plain = number.bytes().all(|byte| byte.is_ascii_digit() || b"+-.eE".contains(&byte));
            number.parse().ok().filter(|_| plain)
        }
    }
}

/// A `xs:boolean`.
pub fn parse_boolean(text: &str) -> Option<bool> {
    match text.trim() {
        "true" | "1" => Some(true),
        "false" | "0" => Some(false),
        _ => None,
    }
}
