//! modelDescription.xml of FMI 2.0 and 3.0: writing ours, reading anyone's.

mod fmi2;
mod fmi3;
mod output;
mod reader;
mod schema;
pub mod tree;

pub use reader::Document;
pub use schema::{parse_boolean, parse_real};

use super::model_description::{FmiVersion, ModelDescription};
use tree::{Element, decode};

/// The text of a modelDescription.xml in the version of the description; the same description always gives the same
/// bytes.
///
/// Elements are in the order that the standard requires. Data that a version cannot express are omitted, and so are
/// those missing from a description: items of enumerations, intervals of clocks, all but the first start value of an
/// array.
pub fn write(description: &ModelDescription) -> String {
    match description.fmi_version {
        FmiVersion::V2 => fmi2::write(description),
        FmiVersion::V3 => fmi3::write(description),
    }
}

/// Reads a modelDescription.xml.
///
/// [`Document::problems`] collects violations of the schema, and reading continues as well as possible; absent
/// attributes get the defaults of the standard.
///
/// # Errors
/// The one [`XmlProblem`] that makes reading impossible: the file is not UTF-8, not XML, or neither FMI 2.0 nor FMI 3.
pub fn read(bytes: &[u8]) -> Result<Document, XmlProblem> {
    interpret(&root(bytes)?)
}

/// The root element of an XML document.
///
/// # Errors
/// The one [`XmlProblem`] that makes reading impossible: the file is not UTF-8 or not XML.
pub fn root(bytes: &[u8]) -> Result<Element, XmlProblem> {
    Element::parse(&decode(bytes)?)
}

/// The description whose root element is given.
///
/// # Errors
/// [`XmlProblem`] if it is of neither FMI 2.0 nor FMI 3.
pub fn interpret(root: &Element) -> Result<Document, XmlProblem> {
    if root.name != "fmiModelDescription" {
        let message = format!("the root element is <{}>, expected <fmiModelDescription>", root.name);
        return Err(XmlProblem::unusable(root.line, message));
    }
    match root.attribute("fmiVersion").unwrap_or_default() {
        "2.0" => Ok(fmi2::read(root)),
        version if version.starts_with("3.") => Ok(fmi3::read(root)),
        version => {
            let message = format!("fmiVersion is \"{version}\": only FMI 2.0 and 3.0 are supported");
            Err(XmlProblem::unusable(root.line, message))
        }
    }
}

/// The elements of the variables in the order of [`ModelDescription::variables`].
pub fn variable_elements(root: &Element, version: FmiVersion) -> Vec<&Element> {
    match version {
        FmiVersion::V2 => fmi2::variables(root).collect(),
        FmiVersion::V3 => fmi3::variables(root).collect(),
    }
}

/// A problem in a modelDescription.xml.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct XmlProblem {
    /// Line in the file, counted from 1.
    pub line: usize,
    /// Description of the problem.
    pub message: String,
    /// `true` if it keeps a host from using the FMU, `false` for a violation that can be ignored.
    pub unusable: bool,
}

impl XmlProblem {
    fn new(line: usize, message: String) -> Self {
        Self { line, message, unusable: false }
    }

    fn unusable(line: usize, message: String) -> Self {
        Self { line, message, unusable: true }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_description::*;
    use crate::unit::BaseUnit;

    /// Something of everything that both versions have.
    fn description(fmi_version: FmiVersion) -> ModelDescription {
        let variable = |name: &str, value_reference, causality, variability, kind| ScalarVariable {
            name: name.into(),
            value_reference,
            description: None,
            causality,
            variability,
            initial: Initial::allowed(fmi_version, causality, variability).and_then(|allowed| allowed.first().copied()),
            declared_type: None,
            kind,
            dimensions: vec![],
            clocks: vec![],
            intermediate_update: false,
            aliases: vec![],
        };
        let real =
            |start| VariableType::Real(RealAttributes { start, unit: Some("deg".into()), ..RealAttributes::default() });
        let number = Integer { width: Width::Int32, min: Some(-3), max: Some(4), start: Some(1) };
        let item = Integer { width: if fmi_version == FmiVersion::V2 { Width::Int32 } else { Width::Int64 }, ..number };
        let interface = InterfaceCapabilities {
            model_identifier: "m".into(),
            get_and_set_state: true,
            own_memory_management: fmi_version == FmiVersion::V3,
            ..InterfaceCapabilities::default()
        };
        ModelDescription {
            fmi_version,
            model_name: "<a> & \"b\" \u{fc}\n'c'\t".into(),
            token: "{1}".into(),
            author: Some(String::new()),
            naming: NamingConvention::Structured,
            co_simulation: Some(CoSimulation {
                interface: interface.clone(),
                max_output_derivative_order: 2,
                ..CoSimulation::default()
            }),
            model_exchange: Some(ModelExchange { interface, needs_completed_integrator_step: true }),
            units: vec![
                UnitDefinition {
                    name: "deg".into(),
                    base: BaseUnit::parse("deg"),
                    display: vec![DisplayUnit { name: "rev".into(), factor: 1.0 / 360.0, offset: 0.0 }],
                },
                UnitDefinition { name: "furlong".into(), base: None, display: vec![] },
            ],
            types: vec![TypeDefinition { name: "angle".into(), description: None, kind: real(None) }],
            log_categories: vec![("logAll".into(), Some("everything".into()))],
            default_experiment: Some(DefaultExperiment {
                stop: Some(1e-9),
                step_size: Some(1e22),
                ..Default::default()
            }),
            variables: vec![
                variable("p", 0, Causality::Parameter, Variability::Fixed, real(Some(0.1 + 0.2))),
                variable("n", 5, Causality::Parameter, Variability::Tunable, VariableType::Integer(number)),
                variable("u", 1, Causality::Input, Variability::Discrete, VariableType::Boolean { start: Some(false) }),
                variable(
                    "s",
                    2,
                    Causality::Local,
                    Variability::Constant,
                    VariableType::String { start: Some("".into()) },
                ),
                variable("x", 3, Causality::Output, Variability::Continuous, real(None)),
                ScalarVariable {
                    declared_type: Some("angle".into()),
                    ..variable("e", 4, Causality::Input, Variability::Discrete, VariableType::Enumeration(item))
                },
            ],
            structure: ModelStructure {
                outputs: vec![Unknown { variable: 4, dependencies: Some(vec![]), kinds: None }],
                derivatives: vec![Unknown { variable: 4, dependencies: None, kinds: None }],
                initial_unknowns: vec![Unknown {
                    variable: 4,
                    dependencies: Some(vec![0, 2]),
                    kinds: Some(vec![DependencyKind::Constant, DependencyKind::Dependent]),
                }],
                ..ModelStructure::default()
            },
            ..ModelDescription::default()
        }
    }

    fn assert_reads_back(description: &ModelDescription) -> String {
        let text = write(description);
        let document = read(text.as_bytes()).unwrap();
        assert_eq!(document.problems, [], "{text}");
        assert_eq!(document.description, *description);
        let line = text.lines().nth(document.variable_lines[1] - 1).unwrap();
        assert_eq!(line.trim().split(' ').nth(1), Some("name=\"n\""));
        text
    }

    #[test]
    fn what_is_written_reads_back_as_it_was() {
        assert_reads_back(&description(FmiVersion::V2));
        assert_reads_back(&description(FmiVersion::V3));
    }

    #[test]
    fn what_only_fmi_3_has_reads_back_as_it_was() {
        let mut description = description(FmiVersion::V3);
        let CoSimulation { event_mode, might_return_early, fixed_internal_step_size, interface, .. } =
            description.co_simulation.as_mut().unwrap();
        (*event_mode, *might_return_early, *fixed_internal_step_size) = (true, true, Some(0.125));
        interface.adjoint_derivative = true;
        description.scheduled_execution = Some(interface.clone());
        let variable = description.variables[1].clone();
        let with = |name: &str, value_reference, causality, variability, kind| ScalarVariable {
            name: name.into(),
            value_reference,
            causality,
            variability,
            initial: Some(Initial::Exact),
            kind,
            ..variable.clone()
        };
        let size = Integer { width: Width::UInt64, start: Some(3), ..Integer::default() };
        let clock = VariableType::Clock { interval: Some(IntervalVariability::Triggered) };
        description.variables.extend([
            with("size", 10, Causality::StructuralParameter, Variability::Fixed, VariableType::Integer(size)),
            ScalarVariable {
                dimensions: vec![Dimension::Parameter(10), Dimension::Fixed(2)],
                aliases: vec![
                    Alias { name: "b".into(), description: Some("another".into()), display_unit: None },
                    Alias { name: "c".into(), description: None, display_unit: Some("rev".into()) },
                ],
                ..with(
                    "a",
                    11,
                    Causality::Input,
                    Variability::Continuous,
                    VariableType::Real(RealAttributes { single: true, start: Some(0.5), ..RealAttributes::default() }),
                )
            },
            ScalarVariable {
                clocks: vec![12],
                ..with(
                    "bytes",
                    13,
                    Causality::Input,
                    Variability::Discrete,
                    VariableType::Binary { start: Some("00ff".into()) },
                )
            },
            ScalarVariable { initial: None, ..with("tick", 12, Causality::Input, Variability::Discrete, clock) },
        ]);
        description.structure.event_indicators = vec![Unknown { variable: 4, dependencies: None, kinds: None }];
        description.structure.clocked_states = description.structure.event_indicators.clone();
        description.event_indicators = 1;
        assert_reads_back(&description);
        assert_eq!(description.shape(description.variable("c").unwrap()), Some(vec![3, 2]));
    }
}
