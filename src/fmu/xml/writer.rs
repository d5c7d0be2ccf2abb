//! Writes modelDescription.xml of FMI 2.0.

use crate::fmu::{
    model_description::{
        CoSimulation, DefaultExperiment, DependencyKind, DisplayUnit, Initial, Integer, Interface, ModelDescription,
        ModelStructure, Named, NamingConvention, Real, ScalarVariable, TypeDefinition, UnitDefinition, Unknown,
        Variability, VariableType,
    },
    unit::BaseUnit,
};
use std::fmt::Write;

/// The text of a modelDescription.xml; the same description always gives the same bytes.
///
/// Elements stand in the order the standard demands. Items of enumerations are not part of a description and are
/// therefore not written.
pub fn write(description: &ModelDescription) -> String {
    let mut out = Writer { text: "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n".into(), depth: 0 };
    let ModelDescription { model_name, token, .. } = description;
    let mut root = Attributes::default();
    root.add("fmiVersion", "2.0").add("modelName", model_name).add("guid", token);
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
    root.add("variableNamingConvention", NamingConvention::name(description.naming));
    out.element("fmiModelDescription", &root, |out| {
        if let Some(interface) = &description.model_exchange {
            out.empty("ModelExchange", &interface_attributes(interface));
        }
        if let Some(co_simulation) = &description.co_simulation {
            out.empty("CoSimulation", &co_simulation_attributes(co_simulation));
        }
        out.list("UnitDefinitions", &description.units, unit);
        out.list("TypeDefinitions", &description.types, type_definition);
        out.list("LogCategories", &description.log_categories, |out, (name, description)| {
            out.empty(
                "Category",
                Attributes::default().add("name", name).add_some("description", description.as_deref()),
            );
        });
        if let Some(experiment) = &description.default_experiment {
            out.empty("DefaultExperiment", &experiment_attributes(experiment));
        }
        out.list("ModelVariables", &description.variables, variable);
        let ModelStructure { outputs, derivatives, initial_unknowns } = &description.structure;
        out.element("ModelStructure", &Attributes::default(), |out| {
            out.list("Outputs", outputs, unknown);
            out.list("Derivatives", derivatives, unknown);
            out.list("InitialUnknowns", initial_unknowns, unknown);
        });
    });
    out.text
}

fn interface_attributes(interface: &Interface) -> Attributes {
    let mut attributes = Attributes::default();
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

fn co_simulation_attributes(co_simulation: &CoSimulation) -> Attributes {
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

fn unit(out: &mut Writer, unit: &UnitDefinition) {
    let UnitDefinition { name, base, display } = unit;
    let mut attributes = Attributes::default();
    attributes.add("name", name);
    if base.is_none() && display.is_empty() {
        return out.empty("Unit", &attributes);
    }
    out.element("Unit", &attributes, |out| {
        if let Some(BaseUnit { exponents, factor, offset }) = base {
            let mut attributes = Attributes::default();
            for (symbol, exponent) in BaseUnit::SYMBOLS.iter().zip(exponents).filter(|(_, exponent)| **exponent != 0) {
                attributes.add(symbol, &exponent.to_string());
            }
            attributes.add_real_unless("factor", *factor, 1.0).add_real_unless("offset", *offset, 0.0);
            out.empty("BaseUnit", &attributes);
        }
        for DisplayUnit { name, factor, offset } in display {
            let mut attributes = Attributes::default();
            attributes
                .add("name", name)
                .add_real_unless("factor", *factor, 1.0)
                .add_real_unless("offset", *offset, 0.0);
            out.empty("DisplayUnit", &attributes);
        }
    });
}

fn type_definition(out: &mut Writer, definition: &TypeDefinition) {
    let mut attributes = Attributes::default();
    attributes.add("name", &definition.name).add_some("description", definition.description.as_deref());
    out.element("SimpleType", &attributes, |out| variable_type(out, &definition.kind, None));
}

fn experiment_attributes(experiment: &DefaultExperiment) -> Attributes {
    let mut attributes = Attributes::default();
    attributes
        .add_real("startTime", experiment.start)
        .add_real("stopTime", experiment.stop)
        .add_real("tolerance", experiment.tolerance)
        .add_real("stepSize", experiment.step_size);
    attributes
}

fn variable(out: &mut Writer, variable: &ScalarVariable) {
    let mut attributes = Attributes::default();
    attributes
        .add("name", &variable.name)
        .add("valueReference", &variable.value_reference.to_string())
        .add_some("description", variable.description.as_deref())
        .add("causality", variable.causality.name())
        .add("variability", Variability::name(variable.variability))
        .add_some("initial", variable.initial.map(Initial::name));
    out.element("ScalarVariable", &attributes, |out| {
        variable_type(out, &variable.kind, variable.declared_type.as_deref());
    });
}

fn variable_type(out: &mut Writer, kind: &VariableType, declared_type: Option<&str>) {
    let mut attributes = Attributes::default();
    attributes.add_some("declaredType", declared_type);
    match kind {
        VariableType::Real(Real { unit, display_unit, min, max, nominal, start, derivative }) => {
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
            let Integer { min, max, start } = integer;
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
    }
    out.empty(kind.name(), &attributes);
}

fn unknown(out: &mut Writer, unknown: &Unknown) {
    let join = |words: Vec<String>| words.join(" ");
    let dependencies = unknown.dependencies.as_ref().map(|list| join(list.iter().copied().map(index).collect()));
    let kinds =
        unknown.kinds.as_ref().map(|list| join(list.iter().map(|kind| DependencyKind::name(*kind).into()).collect()));
    let mut attributes = Attributes::default();
    attributes
        .add("index", &index(unknown.variable))
        .add_some("dependencies", dependencies.as_deref())
        .add_some("dependenciesKind", kinds.as_deref());
    out.empty("Unknown", &attributes);
}

/// The file counts from 1.
fn index(position: usize) -> String {
    (position + 1).to_string()
}

struct Writer {
    text: String,
    depth: usize,
}

impl Writer {
    fn element(&mut self, name: &str, attributes: &Attributes, children: impl FnOnce(&mut Self)) {
        self.line(&format!("<{name}{}>", attributes.text));
        self.depth += 1;
        children(self);
        self.depth -= 1;
        self.line(&format!("</{name}>"));
    }

    fn empty(&mut self, name: &str, attributes: &Attributes) {
        self.line(&format!("<{name}{}/>", attributes.text));
    }

    /// An element with one child per item; nothing if there is none, for the standard has no empty lists.
    fn list<T>(&mut self, name: &str, items: &[T], item: impl Fn(&mut Self, &T)) {
        if !items.is_empty() {
            self.element(name, &Attributes::default(), |out| items.iter().for_each(|value| item(out, value)));
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

#[derive(Default)]
struct Attributes {
    text: String,
}

impl Attributes {
    fn add(&mut self, name: &str, value: &str) -> &mut Self {
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

    fn add_some(&mut self, name: &str, value: Option<&str>) -> &mut Self {
        match value {
            Some(value) => self.add(name, value),
            None => self,
        }
    }

    fn add_true(&mut self, name: &str, value: bool) -> &mut Self {
        self.add_some(name, value.then_some("true"))
    }

    fn add_real(&mut self, name: &str, value: Option<f64>) -> &mut Self {
        self.add_some(name, value.map(real).as_deref())
    }

    fn add_real_unless(&mut self, name: &str, value: f64, default: f64) -> &mut Self {
        self.add_real(name, (value != default).then_some(value))
    }
}

/// The shortest text that reads back as the same number.
fn real(value: f64) -> String {
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
