//! modelDescription.xml of FMI 2.0: writing ours, reading anyone's.

mod reader;
mod schema;
mod tree;
mod writer;

pub use reader::{Document, read};
pub use writer::write;

/// Something wrong in a modelDescription.xml.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// Line in the file, counted from 1.
    pub line: usize,
    /// What is wrong.
    pub message: String,
    /// Whether it keeps a host from using the FMU, as against an offence that can be read past.
    pub unusable: bool,
}

impl Problem {
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
    use crate::fmu::model_description::*;
    use crate::fmu::unit::BaseUnit;

    /// Something of everything.
    fn description() -> ModelDescription {
        let variable = |name: &str, value_reference, causality, variability, kind| ScalarVariable {
            name: name.into(),
            value_reference,
            description: None,
            causality,
            variability,
            initial: Initial::allowed(causality, variability).and_then(|allowed| allowed.first().copied()),
            declared_type: None,
            kind,
        };
        let real = |start| VariableType::Real(Real { start, unit: Some("deg".into()), ..Real::default() });
        let number = Integer { min: Some(-3), max: Some(4), start: Some(1) };
        let interface = Interface { model_identifier: "m".into(), get_and_set_state: true, ..Interface::default() };
        ModelDescription {
            model_name: "<a> & \"b\" \u{fc}\n'c'\t".into(),
            token: "{1}".into(),
            author: Some(String::new()),
            naming: NamingConvention::Structured,
            co_simulation: Some(CoSimulation {
                interface: interface.clone(),
                max_output_derivative_order: 2,
                ..CoSimulation::default()
            }),
            model_exchange: Some(interface),
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
                variable("n", 0, Causality::Parameter, Variability::Tunable, VariableType::Integer(number)),
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
                    ..variable("e", 4, Causality::Input, Variability::Discrete, VariableType::Enumeration(number))
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
            },
            ..ModelDescription::default()
        }
    }

    #[test]
    fn what_is_written_reads_back_as_it_was() {
        let description = description();
        let text = write(&description);
        let document = read(text.as_bytes()).unwrap();
        assert_eq!(document.problems, []);
        assert_eq!(document.description, description);
        assert_eq!(
            text.lines().nth(document.variable_lines[1] - 1).unwrap().trim().split(' ').nth(1),
            Some("name=\"n\"")
        );
    }

    #[test]
    fn the_description_of_a_surrogate_is_the_golden_one() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/modelDescription-fmi2.xml");
        let description = ModelDescription::of_surrogate(&metafmu_runtime::example::surrogate());
        // the version changes with every release
        let text = write(&description).replace(env!("CARGO_PKG_VERSION"), "x.y.z");
        if std::env::var_os("UPDATE_GOLDEN").is_some() {
            std::fs::write(path, &text).unwrap();
        }
        assert_eq!(text, std::fs::read_to_string(path).unwrap(), "UPDATE_GOLDEN=1 rewrites {path}");
        assert_eq!(read(text.as_bytes()).unwrap().problems, []);
    }
}
