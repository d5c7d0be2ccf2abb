//! Writes modelDescription.xml of FMI 2.0.

use crate::{
    model_description::{
        CoSimulation, FmiVersion, Integer, InterfaceCapabilities, ModelDescription, ModelExchange, ModelStructure,
        Named, RealAttributes, ScalarVariable, TypeDefinition, Unknown, VariableType,
    },
    xml::output::{
        XmlAttributes, XmlWriter, add_dependencies, experiment_attributes, log_category, root_attributes, unit,
    },
};

/// The text of a modelDescription.xml; the same description always gives the same bytes.
///
/// Elements are in the order that the standard requires. Arrays, clocks, aliases and wide integers do not exist in FMI
/// 2.0 and are omitted. So are items of enumerations, which are not part of a description.
pub fn write(description: &ModelDescription) -> String {
    let mut out = XmlWriter::new();
    let mut root = root_attributes(description, "guid");
    root.add("numberOfEventIndicators", &description.event_indicators.to_string());
    out.element("fmiModelDescription", &root, |out| {
        if let Some(model_exchange) = &description.model_exchange {
            let attributes = model_exchange_attributes(model_exchange);
            interface(out, "ModelExchange", &attributes, &model_exchange.interface);
        }
        if let Some(co_simulation) = &description.co_simulation {
            let attributes = co_simulation_attributes(co_simulation);
            interface(out, "CoSimulation", &attributes, &co_simulation.interface);
        }
        out.list("UnitDefinitions", &description.units, unit);
        out.list("TypeDefinitions", &description.types, type_definition);
        out.list("LogCategories", &description.log_categories, log_category);
        if let Some(experiment) = &description.default_experiment {
            out.empty("DefaultExperiment", &experiment_attributes(experiment));
        }
        out.list("ModelVariables", &description.variables, variable);
        let ModelStructure { outputs, derivatives, initial_unknowns, .. } = &description.structure;
        out.element("ModelStructure", &XmlAttributes::default(), |out| {
            out.list("Outputs", outputs, unknown);
            out.list("Derivatives", derivatives, unknown);
            out.list("InitialUnknowns", initial_unknowns, unknown);
        });
    });
    out.finish()
}

fn interface(out: &mut XmlWriter, name: &str, attributes: &XmlAttributes, interface: &InterfaceCapabilities) {
    if interface.source_files.is_empty() {
        return out.empty(name, attributes);
    }
    out.element(name, attributes, |out| {
        out.list("SourceFiles", &interface.source_files, |out, file| {
            out.empty("File", XmlAttributes::default().add("name", file));
        });
    });
}

fn model_exchange_attributes(model_exchange: &ModelExchange) -> XmlAttributes {
    let mut attributes = interface_attributes(&model_exchange.interface);
    attributes.add_true("completedIntegratorStepNotNeeded", !model_exchange.needs_completed_integrator_step);
    attributes
}

fn interface_attributes(interface: &InterfaceCapabilities) -> XmlAttributes {
    let mut attributes = XmlAttributes::default();
    attributes
        .add("modelIdentifier", &interface.model_identifier)
        .add_true("needsExecutionTool", interface.needs_execution_tool)
        .add_true("canBeInstantiatedOnlyOncePerProcess", interface.only_once_per_process)
        .add_true("canNotUseMemoryManagementFunctions", interface.own_memory_management)
        .add_true("canGetAndSetFMUstate", interface.get_and_set_state)
        .add_true("canSerializeFMUstate", interface.serialize_state)
        .add_true("providesDirectionalDerivative", interface.directional_derivative);
    attributes
}

fn co_simulation_attributes(co_simulation: &CoSimulation) -> XmlAttributes {
    let mut attributes = interface_attributes(&co_simulation.interface);
    let order = co_simulation.max_output_derivative_order;
    attributes
        .add_true("canHandleVariableCommunicationStepSize", co_simulation.variable_step_size)
        .add_true("canInterpolateInputs", co_simulation.interpolate_inputs)
        .add_some("maxOutputDerivativeOrder", (order > 0).then(|| order.to_string()).as_deref())
        // spelt like this in the standard
        .add_true("canRunAsynchronuously", co_simulation.run_asynchronously);
    attributes
}

fn type_definition(out: &mut XmlWriter, definition: &TypeDefinition) {
    let mut attributes = XmlAttributes::default();
    attributes.add("name", &definition.name).add_some("description", definition.description.as_deref());
    out.element("SimpleType", &attributes, |out| variable_type(out, &definition.kind, None));
}

fn variable(out: &mut XmlWriter, variable: &ScalarVariable) {
    let mut attributes = XmlAttributes::default();
    attributes
        .add("name", &variable.name)
        .add("valueReference", &variable.value_reference.to_string())
        .add_some("description", variable.description.as_deref())
        .add("causality", variable.causality.name())
        .add("variability", variable.variability.name())
        .add_some("initial", variable.initial.map(Named::name));
    out.element("ScalarVariable", &attributes, |out| {
        variable_type(out, &variable.kind, variable.declared_type.as_deref());
    });
}

fn variable_type(out: &mut XmlWriter, kind: &VariableType, declared_type: Option<&str>) {
    let mut attributes = XmlAttributes::default();
    attributes.add_some("declaredType", declared_type);
    match kind {
        VariableType::Real(RealAttributes { unit, display_unit, min, max, nominal, start, derivative, .. }) => {
            attributes
                .add_some("unit", unit.as_deref())
                .add_some("displayUnit", display_unit.as_deref())
                .add_real("min", *min)
                .add_real("max", *max)
                .add_real("nominal", *nominal)
                .add_real("start", *start)
                .add_some("derivative", derivative.map(index).as_deref());
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
        VariableType::String { start } => {
            attributes.add_some("start", start.as_deref());
        }
        VariableType::Binary { .. } | VariableType::Clock { .. } => {}
    }
    out.empty(kind.name(FmiVersion::V2), &attributes);
}

fn unknown(out: &mut XmlWriter, unknown: &Unknown) {
    let mut attributes = XmlAttributes::default();
    attributes.add("index", &index(unknown.variable));
    add_dependencies(&mut attributes, unknown, index);
    out.empty("Unknown", &attributes);
}

/// The file counts from 1.
fn index(position: usize) -> String {
    (position + 1).to_string()
}
