//! Reads modelDescription.xml of FMI 2.0.

use super::schema::{RULES, is_type};
use crate::{
    model_description::{
        CoSimulation, FmiVersion, Initial, Integer, InterfaceCapabilities, ModelDescription, ModelExchange,
        ModelStructure, RealAttributes, ScalarVariable, TypeDefinition, Unknown, Variability, VariableType, Width,
    },
    xml::{
        Document, XmlProblem,
        reader::{self, dependency_kinds, flag, name, named, number, real, text},
        schema::{self, parse_boolean},
        tree::Element,
    },
};

/// Reads the root element.
pub fn read(root: &Element) -> Document {
    let mut problems = Vec::new();
    schema::check(RULES, root, "", &mut problems);
    let mut reader = Fmi2Reader { problems };
    let description = reader.description(root);
    Document {
        description,
        problems: reader.problems,
        variable_lines: variables(root).map(|variable| variable.line).collect(),
        structure_line: root.child("ModelStructure").map_or(root.line, |structure| structure.line),
    }
}

/// Positions in other parts of the file count these, so that none of them may be skipped.
pub fn variables(root: &Element) -> impl Iterator<Item = &Element> {
    root.list("ModelVariables").filter(|element| element.name == "ScalarVariable")
}

/// Reader of FMI 2.0. It does not repeat problems that the schema check reports: a value that does not parse counts as
/// absent.
struct Fmi2Reader {
    problems: Vec<XmlProblem>,
}

impl Fmi2Reader {
    fn description(&mut self, root: &Element) -> ModelDescription {
        ModelDescription {
            co_simulation: root.child("CoSimulation").map(co_simulation),
            model_exchange: root.child("ModelExchange").map(model_exchange),
            types: named(root, "TypeDefinitions", "SimpleType")
                .filter_map(|element| self.type_definition(element))
                .collect(),
            event_indicators: number(root, "numberOfEventIndicators").unwrap_or_default(),
            variables: variables(root).map(|element| self.variable(element)).collect(),
            structure: root.child("ModelStructure").map(|element| self.structure(element)).unwrap_or_default(),
            ..reader::root(root, FmiVersion::V2, "guid")
        }
    }

    fn type_definition(&mut self, element: &Element) -> Option<TypeDefinition> {
        let kind = element.children.iter().find(|child| is_type(&child.name))?;
        Some(TypeDefinition {
            name: text(element, "name").unwrap_or_default(),
            description: text(element, "description"),
            kind: self.variable_type(kind),
        })
    }

    fn variable(&mut self, element: &Element) -> ScalarVariable {
        let causality = name(element, "causality").unwrap_or_default();
        let variability = name(element, "variability").unwrap_or(Variability::Continuous);
        let given: Option<Initial> = name(element, "initial");
        let default =
            Initial::allowed(FmiVersion::V2, causality, variability).and_then(|allowed| allowed.first().copied());
        let kind = element.children.iter().find(|child| is_type(&child.name));
        ScalarVariable {
            name: text(element, "name").unwrap_or_default(),
            value_reference: number(element, "valueReference").unwrap_or_default(),
            description: text(element, "description"),
            causality,
            variability,
            initial: given.or(default),
            declared_type: kind.and_then(|kind| text(kind, "declaredType")),
            // the schema check has reported a variable without a type
            kind: kind.map_or(VariableType::Real(RealAttributes::default()), |kind| self.variable_type(kind)),
            dimensions: Vec::new(),
            clocks: Vec::new(),
            intermediate_update: false,
            aliases: Vec::new(),
        }
    }

    fn variable_type(&mut self, element: &Element) -> VariableType {
        match element.name.as_str() {
            "Integer" => VariableType::Integer(integer(element)),
            "Enumeration" => VariableType::Enumeration(integer(element)),
            "Boolean" => VariableType::Boolean { start: element.attribute("start").and_then(parse_boolean) },
            "String" => VariableType::String { start: text(element, "start") },
            _ => VariableType::Real(RealAttributes {
                unit: text(element, "unit"),
                display_unit: text(element, "displayUnit"),
                min: real(element, "min"),
                max: real(element, "max"),
                nominal: real(element, "nominal"),
                start: real(element, "start"),
                derivative: element.attribute("derivative").and_then(|index| self.position(element, index)),
                single: false,
            }),
        }
    }

    fn structure(&mut self, element: &Element) -> ModelStructure {
        ModelStructure {
            outputs: self.unknowns(element, "Outputs"),
            derivatives: self.unknowns(element, "Derivatives"),
            initial_unknowns: self.unknowns(element, "InitialUnknowns"),
            ..ModelStructure::default()
        }
    }

    fn unknowns(&mut self, element: &Element, name: &str) -> Vec<Unknown> {
        element.list(name).filter_map(|unknown| self.unknown(unknown)).collect()
    }

    fn unknown(&mut self, element: &Element) -> Option<Unknown> {
        let variable = self.position(element, element.attribute("index")?)?;
        let dependencies = element
            .attribute("dependencies")
            .map(|list| list.split_whitespace().filter_map(|index| self.position(element, index)).collect());
        Some(Unknown { variable, dependencies, kinds: dependency_kinds(element) })
    }

    /// The file counts from 1.
    fn position(&mut self, element: &Element, index: &str) -> Option<usize> {
        let index: u32 = index.trim().parse().ok()?;
        if index == 0 {
            let message = format!("<{}> refers to variable 0; the first one is 1", element.name);
            self.problems.push(XmlProblem::unusable(element.line, message));
        }
        Some(index.checked_sub(1)? as usize)
    }
}

fn interface(element: &Element) -> InterfaceCapabilities {
    InterfaceCapabilities {
        model_identifier: text(element, "modelIdentifier").unwrap_or_default(),
        needs_execution_tool: flag(element, "needsExecutionTool"),
        only_once_per_process: flag(element, "canBeInstantiatedOnlyOncePerProcess"),
        own_memory_management: flag(element, "canNotUseMemoryManagementFunctions"),
        get_and_set_state: flag(element, "canGetAndSetFMUstate"),
        serialize_state: flag(element, "canSerializeFMUstate"),
        directional_derivative: flag(element, "providesDirectionalDerivative"),
        adjoint_derivative: false,
        source_files: element.list("SourceFiles").filter_map(|file| text(file, "name")).collect(),
    }
}

fn model_exchange(element: &Element) -> ModelExchange {
    ModelExchange {
        interface: interface(element),
        needs_completed_integrator_step: !flag(element, "completedIntegratorStepNotNeeded"),
    }
}

fn co_simulation(element: &Element) -> CoSimulation {
    CoSimulation {
        interface: interface(element),
        variable_step_size: flag(element, "canHandleVariableCommunicationStepSize"),
        interpolate_inputs: flag(element, "canInterpolateInputs"),
        max_output_derivative_order: number(element, "maxOutputDerivativeOrder").unwrap_or_default(),
        run_asynchronously: flag(element, "canRunAsynchronuously"),
        ..CoSimulation::default()
    }
}

fn integer(element: &Element) -> Integer {
    Integer {
        width: Width::Int32,
        min: number(element, "min"),
        max: number(element, "max"),
        start: number(element, "start"),
    }
}
