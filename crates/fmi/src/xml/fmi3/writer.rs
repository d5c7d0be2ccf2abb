//! Writes modelDescription.xml of FMI 3.0.

use crate::{
    model_description::{
        Alias, CoSimulation, Dimension, FmiVersion, Integer, InterfaceCapabilities, ModelDescription, ModelExchange,
        ModelStructure, Named, RealAttributes, ScalarVariable, TypeDefinition, Unknown, VariableType,
    },
    xml::output::{
        XmlAttributes, XmlWriter, add_dependencies, experiment_attributes, log_category, root_attributes, unit,
    },
};

/// The text of a modelDescription.xml; the same description always gives the same bytes.
///
/// Elements are in the order that the standard requires. Items of enumerations, intervals of clocks and all but the first
/// start value of an array are not part of a description and are therefore not written.
pub fn write(description: &ModelDescription) -> String {
    let mut out = XmlWriter::new();
    out.element("fmiModelDescription", &root_attributes(description, "instantiationToken"), |out| {
        if let Some(model_exchange) = &description.model_exchange {
            out.empty("ModelExchange", &model_exchange_attributes(model_exchange));
        }
        if let Some(co_simulation) = &description.co_simulation {
            out.empty("CoSimulation", &co_simulation_attributes(co_simulation));
        }
        if let Some(scheduled_execution) = &description.scheduled_execution {
            out.empty("ScheduledExecution", &interface_attributes(scheduled_execution));
        }
        out.list("UnitDefinitions", &description.units, unit);
        out.list("TypeDefinitions", &description.types, |out, definition| {
            type_definition(out, definition, description);
        });
        out.list("LogCategories", &description.log_categories, log_category);
        if let Some(experiment) = &description.default_experiment {
            out.empty("DefaultExperiment", &experiment_attributes(experiment));
        }
        out.list("ModelVariables", &description.variables, |out, item| variable(out, item, description));
        let ModelStructure { outputs, derivatives, clocked_states, initial_unknowns, event_indicators } =
            &description.structure;
        out.element("ModelStructure", &XmlAttributes::default(), |out| {
            for (name, list) in [
                ("Output", outputs),
                ("ContinuousStateDerivative", derivatives),
                ("ClockedState", clocked_states),
                ("InitialUnknown", initial_unknowns),
                ("EventIndicator", event_indicators),
            ] {
                list.iter().for_each(|item| unknown(out, name, item, description));
            }
        });
    });
    out.finish()
}

fn interface_attributes(interface: &InterfaceCapabilities) -> XmlAttributes {
    let mut attributes = XmlAttributes::default();
    attributes
        .add("modelIdentifier", &interface.model_identifier)
        .add_true("needsExecutionTool", interface.needs_execution_tool)
        .add_true("canBeInstantiatedOnlyOncePerProcess", interface.only_once_per_process)
        .add_true("canGetAndSetFMUState", interface.get_and_set_state)
        .add_true("canSerializeFMUState", interface.serialize_state)
        .add_true("providesDirectionalDerivatives", interface.directional_derivative)
        .add_true("providesAdjointDerivatives", interface.adjoint_derivative);
    attributes
}

fn model_exchange_attributes(model_exchange: &ModelExchange) -> XmlAttributes {
    let mut attributes = interface_attributes(&model_exchange.interface);
    attributes.add_true("needsCompletedIntegratorStep", model_exchange.needs_completed_integrator_step);
    attributes
}

fn co_simulation_attributes(co_simulation: &CoSimulation) -> XmlAttributes {
    let mut attributes = interface_attributes(&co_simulation.interface);
    let order = co_simulation.max_output_derivative_order;
    attributes
        .add_true("canHandleVariableCommunicationStepSize", co_simulation.variable_step_size)
        .add_real("fixedInternalStepSize", co_simulation.fixed_internal_step_size)
        .add_some("maxOutputDerivativeOrder", (order > 0).then(|| order.to_string()).as_deref())
        .add_true("providesIntermediateUpdate", co_simulation.intermediate_update)
        .add_true("mightReturnEarlyFromDoStep", co_simulation.might_return_early)
        .add_true("canReturnEarlyAfterIntermediateUpdate", co_simulation.return_early_after_intermediate_update)
        .add_true("hasEventMode", co_simulation.event_mode);
    attributes
}

fn type_definition(out: &mut XmlWriter, definition: &TypeDefinition, description: &ModelDescription) {
    let mut attributes = XmlAttributes::default();
    attributes.add("name", &definition.name).add_some("description", definition.description.as_deref());
    add_type_attributes(&mut attributes, &definition.kind, description);
    out.empty(&format!("{}Type", definition.kind.name(FmiVersion::V3)), &attributes);
}

fn variable(out: &mut XmlWriter, variable: &ScalarVariable, description: &ModelDescription) {
    let mut attributes = XmlAttributes::default();
    let clocks: Vec<String> = variable.clocks.iter().map(u32::to_string).collect();
    attributes
        .add("name", &variable.name)
        .add("valueReference", &variable.value_reference.to_string())
        .add_some("description", variable.description.as_deref())
        .add("causality", variable.causality.name())
        .add("variability", variable.variability.name())
        .add_some("clocks", (!clocks.is_empty()).then(|| clocks.join(" ")).as_deref())
        .add_some("initial", variable.initial.map(Named::name))
        .add_some("declaredType", variable.declared_type.as_deref())
        .add_true("intermediateUpdate", variable.intermediate_update);
    add_type_attributes(&mut attributes, &variable.kind, description);
    let name = variable.kind.name(FmiVersion::V3);
    let start = match &variable.kind {
        VariableType::String { start } | VariableType::Binary { start } => start.as_deref(),
        _ => None,
    };
    if variable.dimensions.is_empty() && variable.aliases.is_empty() && start.is_none() {
        return out.empty(name, &attributes);
    }
    out.element(name, &attributes, |out| {
        for dimension in &variable.dimensions {
            let mut attributes = XmlAttributes::default();
            match dimension {
                Dimension::Fixed(size) => attributes.add("start", &size.to_string()),
                Dimension::Parameter(reference) => attributes.add("valueReference", &reference.to_string()),
            };
            out.empty("Dimension", &attributes);
        }
        if let Some(start) = start {
            out.empty("Start", XmlAttributes::default().add("value", start));
        }
        for Alias { name, description, display_unit } in &variable.aliases {
            let mut attributes = XmlAttributes::default();
            attributes
                .add("name", name)
                .add_some("description", description.as_deref())
                .add_some("displayUnit", display_unit.as_deref());
            out.empty("Alias", &attributes);
        }
    });
}

fn add_type_attributes(attributes: &mut XmlAttributes, kind: &VariableType, description: &ModelDescription) {
    match kind {
        VariableType::Real(RealAttributes { unit, display_unit, min, max, nominal, start, derivative, .. }) => {
            attributes
                .add_some("unit", unit.as_deref())
                .add_some("displayUnit", display_unit.as_deref())
                .add_real("min", *min)
                .add_real("max", *max)
                .add_real("nominal", *nominal)
                .add_real("start", *start)
                .add_some("derivative", derivative.map(|position| reference(position, description)).as_deref());
        }
        VariableType::Integer(integer) | VariableType::Enumeration(integer) => {
            let Integer { min, max, start, .. } = integer;
            for (name, value) in [("min", min), ("max", max), ("start", start)] {
                attributes.add_some(name, value.map(|value| value.to_string()).as_deref());
            }
        }
        VariableType::Boolean { start } => {
            attributes.add_some("start", start.map(|start| start.to_string()).as_deref());
        }
        VariableType::Clock { interval } => {
            attributes.add_some("intervalVariability", interval.map(Named::name));
        }
        // their start values are elements
        VariableType::String { .. } | VariableType::Binary { .. } => {}
    }
}

fn unknown(out: &mut XmlWriter, name: &str, unknown: &Unknown, description: &ModelDescription) {
    let mut attributes = XmlAttributes::default();
    attributes.add("valueReference", &reference(unknown.variable, description));
    add_dependencies(&mut attributes, unknown, |position| reference(position, description));
    out.empty(name, &attributes);
}

/// The value reference of the variable at a position.
fn reference(position: usize, description: &ModelDescription) -> String {
    description.variables.get(position).map_or(String::new(), |variable| variable.value_reference.to_string())
}
