//! Reads modelDescription.xml of FMI 3.0.

use super::schema::{RULES, VARIABLES};
use crate::{
    model_description::{
        Alias, Causality, CoSimulation, Dimension, FmiVersion, Initial, Integer, InterfaceCapabilities, MAX_ELEMENTS,
        ModelDescription, ModelExchange, ModelStructure, Named, RealAttributes, ScalarVariable, TypeDefinition,
        Unknown, Variability, VariableType, Width,
    },
    xml::{
        Document, XmlProblem,
        reader::{self, dependency_kinds, flag, name, number, real, text},
        schema::{self, parse_boolean, parse_real},
        tree::Element,
    },
};
use std::collections::HashMap;

/// Reads the root element.
pub fn read(root: &Element) -> Document {
    let mut problems = Vec::new();
    schema::check(RULES, root, "", &mut problems);
    let mut positions = HashMap::new();
    for (position, element) in variables(root).enumerate() {
        if let Some(reference) = number::<u32>(element, "valueReference") {
            // of several the first counts; the validator reports the others
            positions.entry(reference).or_insert(position);
        }
    }
    let mut reader = Fmi3Reader { positions, problems };
    let description = reader.description(root);
    reader.array_sizes(root, &description);
    Document {
        description,
        problems: reader.problems,
        variable_lines: variables(root).map(|variable| variable.line).collect(),
        structure_line: root.child("ModelStructure").map_or(root.line, |structure| structure.line),
    }
}

pub fn variables(root: &Element) -> impl Iterator<Item = &Element> {
    root.list("ModelVariables").filter(|element| VARIABLES.contains(&element.name.as_str()))
}

/// Reader of FMI 3.0. It does not repeat problems that the schema check reports: a value that does not parse counts as
/// absent.
struct Fmi3Reader {
    /// Positions of the variables by value reference.
    positions: HashMap<u32, usize>,
    problems: Vec<XmlProblem>,
}

impl Fmi3Reader {
    fn description(&mut self, root: &Element) -> ModelDescription {
        let structure = root.child("ModelStructure").map(|element| self.structure(element)).unwrap_or_default();
        ModelDescription {
            co_simulation: root.child("CoSimulation").map(co_simulation),
            model_exchange: root.child("ModelExchange").map(model_exchange),
            scheduled_execution: root.child("ScheduledExecution").map(interface),
            types: root.list("TypeDefinitions").filter_map(|element| self.type_definition(element)).collect(),
            event_indicators: structure.event_indicators.len(),
            variables: variables(root).map(|element| self.variable(element)).collect(),
            structure,
            ..reader::root(root, FmiVersion::V3, "instantiationToken")
        }
    }

    fn type_definition(&mut self, element: &Element) -> Option<TypeDefinition> {
        let of = element.name.strip_suffix("Type").filter(|name| VARIABLES.contains(name))?;
        Some(TypeDefinition {
            name: text(element, "name").unwrap_or_default(),
            description: text(element, "description"),
            kind: self.variable_type(element, of),
        })
    }

    fn variable(&mut self, element: &Element) -> ScalarVariable {
        let causality = name(element, "causality").unwrap_or_default();
        let kind = self.variable_type(element, &element.name);
        let variability = name(element, "variability").unwrap_or(match (causality, &kind) {
            (Causality::Parameter | Causality::CalculatedParameter | Causality::StructuralParameter, _) => {
                Variability::Fixed
            }
            (_, VariableType::Real(_)) => Variability::Continuous,
            _ => Variability::Discrete,
        });
        let given: Option<Initial> = name(element, "initial");
        let allowed = Initial::allowed(FmiVersion::V3, causality, variability);
        let default = allowed.and_then(|allowed| allowed.first().copied());
        let is_clock = matches!(kind, VariableType::Clock { .. });
        let clocks = element.attribute("clocks").unwrap_or_default().split_whitespace();
        ScalarVariable {
            name: text(element, "name").unwrap_or_default(),
            value_reference: number(element, "valueReference").unwrap_or_default(),
            description: text(element, "description"),
            causality,
            variability,
            // a clock has no value that could be initialized
            initial: given.or(default.filter(|_| !is_clock)),
            declared_type: text(element, "declaredType"),
            kind,
            dimensions: children(element, "Dimension").filter_map(|child| self.dimension(child)).collect(),
            clocks: clocks.filter_map(|reference| reference.parse().ok()).collect(),
            intermediate_update: flag(element, "intermediateUpdate"),
            aliases: children(element, "Alias").map(alias).collect(),
        }
    }

    /// `of` is the type: a definition's element has another name than a variable's.
    fn variable_type(&mut self, element: &Element, of: &str) -> VariableType {
        let start = element.attribute("start").and_then(|list| list.split_whitespace().next());
        let first_start = element.child("Start").map(|start| text(start, "value").unwrap_or_default());
        if let Some(width) = Width::from_name(of) {
            return VariableType::Integer(self.integer(element, width));
        }
        match of {
            "Enumeration" => VariableType::Enumeration(self.integer(element, Width::Int64)),
            "Boolean" => VariableType::Boolean { start: start.and_then(parse_boolean) },
            "String" => VariableType::String { start: first_start },
            "Binary" => VariableType::Binary { start: first_start },
            "Clock" => VariableType::Clock { interval: name(element, "intervalVariability") },
            _ => VariableType::Real(RealAttributes {
                single: of == "Float32",
                unit: text(element, "unit"),
                display_unit: text(element, "displayUnit"),
                min: real(element, "min"),
                max: real(element, "max"),
                nominal: real(element, "nominal"),
                start: start.and_then(parse_real),
                derivative: element.attribute("derivative").and_then(|reference| self.position(element, reference)),
            }),
        }
    }

    fn integer(&mut self, element: &Element, width: Width) -> Integer {
        let start = element.attribute("start").and_then(|list| list.split_whitespace().next()?.parse().ok());
        let integer = Integer { width, min: number(element, "min"), max: number(element, "max"), start };
        let (smallest, largest) = width.range();
        for (name, value) in [("min", integer.min), ("max", integer.max), ("start", integer.start)] {
            if let Some(value) = value.filter(|value| !(smallest..=largest).contains(value)) {
                let expected = format!("an integer from {smallest} to {largest}");
                let message = format!("<{}> has {name}=\"{value}\", expected {expected}", element.name);
                self.problems.push(XmlProblem::unusable(element.line, message));
            }
        }
        integer
    }

    fn dimension(&mut self, element: &Element) -> Option<Dimension> {
        match (number(element, "start"), element.attribute("valueReference")) {
            (Some(size), None) => Some(Dimension::Fixed(size)),
            (None, Some(reference)) => {
                self.position(element, reference)?;
                reference.trim().parse().ok().map(Dimension::Parameter)
            }
            _ => {
                let message = "<Dimension> has either a start or a valueReference".to_owned();
                self.problems.push(XmlProblem::unusable(element.line, message));
                None
            }
        }
    }

    /// An array has as many start values as elements, or one for all of them.
    fn array_sizes(&mut self, root: &Element, description: &ModelDescription) {
        let mut all = 0u64;
        for (element, variable) in variables(root).zip(&description.variables) {
            let is_text = matches!(element.name.as_str(), "String" | "Binary");
            let count = match element.attribute("start") {
                Some(list) if !is_text => list.split_whitespace().count() as u64,
                // Dymola 2023x writes texts as an attribute
                _ => children(element, "Start").count() as u64,
            };
            let expected = match description.shape(variable) {
                Some(shape) => shape.into_iter().fold(1, u64::saturating_mul),
                None => {
                    let message = format!("variable \"{}\" has the size of no structural parameter", variable.name);
                    self.problems.push(XmlProblem::unusable(element.line, message));
                    continue;
                }
            };
            all = all.saturating_add(expected);
            if all > MAX_ELEMENTS {
                let message = format!(
                    "variable \"{}\" has {expected} elements, expected at most {MAX_ELEMENTS} of all variables",
                    variable.name
                );
                self.problems.push(XmlProblem::unusable(element.line, message));
                return;
            }
            if count > 1 && count != expected {
                let message = format!("variable \"{}\" has {count} start values, expected {expected}", variable.name);
                self.problems.push(XmlProblem::unusable(element.line, message));
            }
        }
    }

    fn structure(&mut self, element: &Element) -> ModelStructure {
        ModelStructure {
            outputs: self.unknowns(element, "Output"),
            derivatives: self.unknowns(element, "ContinuousStateDerivative"),
            clocked_states: self.unknowns(element, "ClockedState"),
            initial_unknowns: self.unknowns(element, "InitialUnknown"),
            event_indicators: self.unknowns(element, "EventIndicator"),
        }
    }

    fn unknowns(&mut self, element: &Element, name: &'static str) -> Vec<Unknown> {
        children(element, name).filter_map(|unknown| self.unknown(unknown)).collect()
    }

    fn unknown(&mut self, element: &Element) -> Option<Unknown> {
        let variable = self.position(element, element.attribute("valueReference")?)?;
        let dependencies = element
            .attribute("dependencies")
            .map(|list| list.split_whitespace().filter_map(|reference| self.position(element, reference)).collect());
        Some(Unknown { variable, dependencies, kinds: dependency_kinds(element) })
    }

    fn position(&mut self, element: &Element, reference: &str) -> Option<usize> {
        let reference: u32 = reference.trim().parse().ok()?;
        let position = self.positions.get(&reference).copied();
        if position.is_none() {
            let message =
                format!("<{}> refers to the value reference {reference}, which no variable has", element.name);
            self.problems.push(XmlProblem::unusable(element.line, message));
        }
        position
    }
}

fn children<'a>(element: &'a Element, name: &'static str) -> impl Iterator<Item = &'a Element> {
    element.children.iter().filter(move |child| child.name == name)
}

fn alias(element: &Element) -> Alias {
    Alias {
        name: text(element, "name").unwrap_or_default(),
        description: text(element, "description"),
        display_unit: text(element, "displayUnit"),
    }
}

fn interface(element: &Element) -> InterfaceCapabilities {
    InterfaceCapabilities {
        model_identifier: text(element, "modelIdentifier").unwrap_or_default(),
        needs_execution_tool: flag(element, "needsExecutionTool"),
        only_once_per_process: flag(element, "canBeInstantiatedOnlyOncePerProcess"),
        own_memory_management: true,
        get_and_set_state: flag(element, "canGetAndSetFMUState"),
        serialize_state: flag(element, "canSerializeFMUState"),
        directional_derivative: flag(element, "providesDirectionalDerivatives"),
        adjoint_derivative: flag(element, "providesAdjointDerivatives"),
        source_files: Vec::new(),
    }
}

fn model_exchange(element: &Element) -> ModelExchange {
    ModelExchange {
        interface: interface(element),
        needs_completed_integrator_step: flag(element, "needsCompletedIntegratorStep"),
    }
}

fn co_simulation(element: &Element) -> CoSimulation {
    CoSimulation {
        interface: interface(element),
        variable_step_size: flag(element, "canHandleVariableCommunicationStepSize"),
        max_output_derivative_order: number(element, "maxOutputDerivativeOrder").unwrap_or_default(),
        fixed_internal_step_size: real(element, "fixedInternalStepSize"),
        event_mode: flag(element, "hasEventMode"),
        intermediate_update: flag(element, "providesIntermediateUpdate"),
        might_return_early: flag(element, "mightReturnEarlyFromDoStep"),
        return_early_after_intermediate_update: flag(element, "canReturnEarlyAfterIntermediateUpdate"),
        ..CoSimulation::default()
    }
}
