//! Which elements and attributes an FMI 2.0 modelDescription.xml has, in what order and of what type.
//!
//! Follows the schema files that come with the FMI 2.0 standard (fmi2ModelDescription.xsd and its includes).

use super::{Problem, tree::Element};

/// Type of an attribute.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Text,
    Real,
    Integer,
    Unsigned,
    Boolean,
    Indices,
    OneOf(&'static [&'static str]),
    Several(&'static [&'static str]),
}

struct Attribute {
    name: &'static str,
    kind: Kind,
    required: bool,
}

const fn needs(name: &'static str, kind: Kind) -> Attribute {
    Attribute { name, kind, required: true }
}

const fn may(name: &'static str, kind: Kind) -> Attribute {
    Attribute { name, kind, required: false }
}

/// How often a child element may stand in its parent.
#[derive(Clone, Copy, PartialEq)]
enum Occurs {
    AtMostOnce,
    Once,
    AtLeastOnce,
    Any,
}

use Kind::{Boolean, Indices, Integer, OneOf, Real, Several, Text, Unsigned};
use Occurs::{Any, AtLeastOnce, AtMostOnce, Once};

struct Rule {
    /// Name of the element, with its parent's where the name alone is not enough.
    element: &'static str,
    attributes: &'static [Attribute],
    /// Children in the order the standard demands; those that share a number may change places.
    children: &'static [(u8, &'static str, Occurs)],
}

const RULES: &[Rule] = &[
    Rule {
        element: "fmiModelDescription",
        attributes: &[
            needs("fmiVersion", Text),
            needs("modelName", Text),
            needs("guid", Text),
            may("description", Text),
            may("author", Text),
            may("version", Text),
            may("copyright", Text),
            may("license", Text),
            may("generationTool", Text),
            may("generationDateAndTime", Text),
            may("variableNamingConvention", OneOf(&["flat", "structured"])),
            may("numberOfEventIndicators", Unsigned),
        ],
        children: &[
            (0, "ModelExchange", AtMostOnce),
            (0, "CoSimulation", AtMostOnce),
            (1, "UnitDefinitions", AtMostOnce),
            (2, "TypeDefinitions", AtMostOnce),
            (3, "LogCategories", AtMostOnce),
            (4, "DefaultExperiment", AtMostOnce),
            (5, "VendorAnnotations", AtMostOnce),
            (6, "ModelVariables", Once),
            (7, "ModelStructure", Once),
        ],
    },
    Rule {
        element: "ModelExchange",
        attributes: &[
            needs("modelIdentifier", Text),
            may("needsExecutionTool", Boolean),
            may("completedIntegratorStepNotNeeded", Boolean),
            may("canBeInstantiatedOnlyOncePerProcess", Boolean),
            may("canNotUseMemoryManagementFunctions", Boolean),
            may("canGetAndSetFMUstate", Boolean),
            may("canSerializeFMUstate", Boolean),
            may("providesDirectionalDerivative", Boolean),
        ],
        children: &[(0, "SourceFiles", AtMostOnce)],
    },
    Rule {
        element: "CoSimulation",
        attributes: &[
            needs("modelIdentifier", Text),
            may("needsExecutionTool", Boolean),
            may("canHandleVariableCommunicationStepSize", Boolean),
            may("canInterpolateInputs", Boolean),
            may("maxOutputDerivativeOrder", Unsigned),
            may("canRunAsynchronuously", Boolean),
            may("canBeInstantiatedOnlyOncePerProcess", Boolean),
            may("canNotUseMemoryManagementFunctions", Boolean),
            may("canGetAndSetFMUstate", Boolean),
            may("canSerializeFMUstate", Boolean),
            may("providesDirectionalDerivative", Boolean),
        ],
        children: &[(0, "SourceFiles", AtMostOnce)],
    },
    Rule { element: "SourceFiles", attributes: &[], children: &[(0, "File", AtLeastOnce)] },
    Rule { element: "File", attributes: &[needs("name", Text)], children: &[] },
    Rule { element: "UnitDefinitions", attributes: &[], children: &[(0, "Unit", AtLeastOnce)] },
    Rule {
        element: "Unit",
        attributes: &[needs("name", Text)],
        children: &[(0, "BaseUnit", AtMostOnce), (1, "DisplayUnit", Any)],
    },
    Rule {
        element: "BaseUnit",
        attributes: &[
            may("kg", Integer),
            may("m", Integer),
            may("s", Integer),
            may("A", Integer),
            may("K", Integer),
            may("mol", Integer),
            may("cd", Integer),
            may("rad", Integer),
            may("factor", Real),
            may("offset", Real),
        ],
        children: &[],
    },
    Rule {
        element: "DisplayUnit",
        attributes: &[needs("name", Text), may("factor", Real), may("offset", Real)],
        children: &[],
    },
    Rule { element: "TypeDefinitions", attributes: &[], children: &[(0, "SimpleType", AtLeastOnce)] },
    Rule { element: "SimpleType", attributes: &[needs("name", Text), may("description", Text)], children: TYPES },
    Rule {
        element: "SimpleType/Real",
        attributes: &[
            may("quantity", Text),
            may("unit", Text),
            may("displayUnit", Text),
            may("relativeQuantity", Boolean),
            may("min", Real),
            may("max", Real),
            may("nominal", Real),
            may("unbounded", Boolean),
        ],
        children: &[],
    },
    Rule {
        element: "SimpleType/Integer",
        attributes: &[may("quantity", Text), may("min", Integer), may("max", Integer)],
        children: &[],
    },
    Rule { element: "SimpleType/Boolean", attributes: &[], children: &[] },
    Rule { element: "SimpleType/String", attributes: &[], children: &[] },
    Rule {
        element: "SimpleType/Enumeration",
        attributes: &[may("quantity", Text)],
        children: &[(0, "Item", AtLeastOnce)],
    },
    Rule {
        element: "Item",
        attributes: &[needs("name", Text), needs("value", Integer), may("description", Text)],
        children: &[],
    },
    Rule { element: "LogCategories", attributes: &[], children: &[(0, "Category", AtLeastOnce)] },
    Rule { element: "Category", attributes: &[needs("name", Text), may("description", Text)], children: &[] },
    Rule {
        element: "DefaultExperiment",
        attributes: &[may("startTime", Real), may("stopTime", Real), may("tolerance", Real), may("stepSize", Real)],
        children: &[],
    },
    Rule { element: "ModelVariables", attributes: &[], children: &[(0, "ScalarVariable", AtLeastOnce)] },
    Rule {
        element: "ScalarVariable",
        attributes: &[
            needs("name", Text),
            needs("valueReference", Unsigned),
            may("description", Text),
            may("causality", OneOf(&["parameter", "calculatedParameter", "input", "output", "local", "independent"])),
            may("variability", OneOf(&["constant", "fixed", "tunable", "discrete", "continuous"])),
            may("initial", OneOf(&["exact", "approx", "calculated"])),
            may("canHandleMultipleSetPerTimeInstant", Boolean),
        ],
        children: TYPES,
    },
    Rule {
        element: "ScalarVariable/Real",
        attributes: &[
            may("declaredType", Text),
            may("quantity", Text),
            may("unit", Text),
            may("displayUnit", Text),
            may("relativeQuantity", Boolean),
            may("min", Real),
            may("max", Real),
            may("nominal", Real),
            may("unbounded", Boolean),
            may("start", Real),
            may("derivative", Unsigned),
            may("reinit", Boolean),
        ],
        children: &[],
    },
    Rule {
        element: "ScalarVariable/Integer",
        attributes: &[
            may("declaredType", Text),
            may("quantity", Text),
            may("min", Integer),
            may("max", Integer),
            may("start", Integer),
        ],
        children: &[],
    },
    Rule {
        element: "ScalarVariable/Boolean",
        attributes: &[may("declaredType", Text), may("start", Boolean)],
        children: &[],
    },
    Rule {
        element: "ScalarVariable/String",
        attributes: &[may("declaredType", Text), may("start", Text)],
        children: &[],
    },
    Rule {
        element: "ScalarVariable/Enumeration",
        attributes: &[
            needs("declaredType", Text),
            may("quantity", Text),
            may("min", Integer),
            may("max", Integer),
            may("start", Integer),
        ],
        children: &[],
    },
    Rule {
        element: "ModelStructure",
        attributes: &[],
        children: &[(0, "Outputs", AtMostOnce), (1, "Derivatives", AtMostOnce), (2, "InitialUnknowns", AtMostOnce)],
    },
    Rule { element: "Outputs", attributes: &[], children: &[(0, "Unknown", AtLeastOnce)] },
    Rule { element: "Derivatives", attributes: &[], children: &[(0, "Unknown", AtLeastOnce)] },
    Rule { element: "InitialUnknowns", attributes: &[], children: &[(0, "Unknown", AtLeastOnce)] },
    Rule {
        element: "Unknown",
        attributes: &[
            needs("index", Unsigned),
            may("dependencies", Indices),
            may("dependenciesKind", Several(&["dependent", "constant", "fixed", "tunable", "discrete"])),
        ],
        children: &[],
    },
];

/// A variable or type definition has exactly one of the first five, which is checked apart.
const TYPES: &[(u8, &str, Occurs)] = &[
    (0, "Real", AtMostOnce),
    (0, "Integer", AtMostOnce),
    (0, "Boolean", AtMostOnce),
    (0, "String", AtMostOnce),
    (0, "Enumeration", AtMostOnce),
    (1, "Annotations", AtMostOnce),
];

/// Compares an element and everything in it with the rules.
pub fn check(element: &Element, parent: &str, problems: &mut Vec<Problem>) {
    let full = format!("{parent}/{}", element.name);
    let Some(rule) = RULES.iter().find(|rule| rule.element == element.name || rule.element == full) else {
        // annotations: any content
        return;
    };
    check_attributes(element, rule, problems);
    check_children(element, rule, problems);
    for child in element.children.iter().filter(|child| rule.children.iter().any(|(_, name, _)| *name == child.name)) {
        check(child, &element.name, problems);
    }
}

fn check_attributes(element: &Element, rule: &Rule, problems: &mut Vec<Problem>) {
    let Element { name: tag, line, .. } = element;
    for Attribute { name, required, .. } in rule.attributes {
        if *required && element.attribute(name).is_none() {
            problems.push(Problem::unusable(*line, format!("<{tag}> has no attribute `{name}`")));
        }
    }
    for (name, value) in &element.attributes {
        match rule.attributes.iter().find(|attribute| attribute.name == name) {
            Some(attribute) => {
                if let Some(expected) = mismatch(attribute.kind, value) {
                    let message = format!("<{tag}> has {name}=\"{value}\", expected {expected}");
                    problems.push(Problem::unusable(*line, message));
                }
            }
            // namespaces and schema locations are none of FMI's business
            None if name.contains(':') || name == "xmlns" => {}
            None => problems.push(Problem::new(*line, format!("<{tag}> has an unknown attribute `{name}`"))),
        }
    }
}

fn check_children(element: &Element, rule: &Rule, problems: &mut Vec<Problem>) {
    let tag = &element.name;
    let mut last: (u8, &str) = (0, "");
    for child in &element.children {
        let Some((rank, ..)) = rule.children.iter().find(|(_, name, _)| *name == child.name) else {
            problems.push(Problem::new(child.line, format!("<{}> is no element of <{tag}>", child.name)));
            continue;
        };
        if *rank < last.0 {
            let message = format!("<{}> must stand before <{}> in <{tag}>", child.name, last.1);
            problems.push(Problem::new(child.line, message));
        } else {
            last = (*rank, &child.name);
        }
    }
    for (_, name, occurs) in rule.children {
        let count = element.children.iter().filter(|child| child.name == *name).count();
        let line = element.line;
        match occurs {
            Once if count == 0 => problems.push(Problem::unusable(line, format!("<{tag}> has no <{name}>"))),
            AtLeastOnce if count == 0 => problems.push(Problem::new(line, format!("<{tag}> has no <{name}>"))),
            Once | AtMostOnce if count > 1 => {
                problems.push(Problem::unusable(line, format!("<{tag}> has {count} <{name}>, expected one")));
            }
            _ => {}
        }
    }
    if rule.children == TYPES {
        let count = element.children.iter().filter(|child| is_type(&child.name)).count();
        if count != 1 {
            let message = format!(
                "<{tag}> has {count} of <Real>, <Integer>, <Boolean>, <String> and <Enumeration>, expected one"
            );
            problems.push(Problem::unusable(element.line, message));
        }
    }
}

/// Whether an element gives the type of a variable.
pub fn is_type(name: &str) -> bool {
    name != "Annotations" && TYPES.iter().any(|(_, known, _)| *known == name)
}

/// What was expected, if the value is not of the kind.
fn mismatch(kind: Kind, value: &str) -> Option<String> {
    let (fits, expected) = match kind {
        Text => (true, ""),
        Real => (parse_real(value).is_some(), "a number"),
        Integer => (value.trim().parse::<i32>().is_ok(), "an integer of 32 bits"),
        Unsigned => (value.trim().parse::<u32>().is_ok(), "an integer from 0 to 4294967295"),
        Boolean => (parse_boolean(value).is_some(), "true or false"),
        Indices => (value.split_whitespace().all(|index| index.parse::<u32>().is_ok()), "a list of indices"),
        OneOf(names) => return (!names.contains(&value)).then(|| format!("one of {}", names.join(", "))),
        Several(names) => {
            let known = value.split_whitespace().all(|word| names.contains(&word));
            return (!known).then(|| format!("a list of {}", names.join(", ")));
        }
    };
    (!fits).then(|| expected.to_owned())
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
