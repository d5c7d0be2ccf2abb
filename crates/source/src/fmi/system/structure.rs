//! Reads a SystemStructure.ssd: the supported part of SSP 1.0. Unsupported parts are reported with their lines.

use super::{Connection, Connector, ConnectorKind, End, FmuSystem, StartValue, SystemComponent};
use crate::{
    Error, Result,
    diagnostics::names::expected_one_of,
    fmi::{
        InterfaceKind,
        xml::{
            parse_boolean, parse_real,
            tree::{Element, decode},
        },
    },
};
use std::path::Path;

const FMU: &str = "application/x-fmu-sharedlibrary";
/// A mechanism file.
const MECHANISM: &str = "application/toml";
const PARAMETER_SET: &str = "application/x-ssp-parameter-set";
/// Elements without effect on a run: drawings of a system, and notes of tools.
const IGNORED: [&str; 9] = [
    "Annotations",
    "ConnectionGeometry",
    "ConnectorGeometry",
    "ElementGeometry",
    "Enumerations",
    "GraphicalElements",
    "MetaData",
    "SystemGeometry",
    "Units",
];

/// Reads a description; `path` is for messages, and the FMUs are in `root`.
pub fn read(bytes: &[u8], path: &Path, root: &Path, is_archive: bool) -> Result<FmuSystem> {
    let element = decode(bytes).and_then(|text| Element::parse(&text));
    let document = match element {
        Ok(document) => document,
        Err(problem) => {
            return Err(Error::System { path: path.to_owned(), problems: vec![(problem.line, problem.message)] });
        }
    };
    let mut reader = StructureReader::default();
    let mut system = FmuSystem {
        name: String::new(),
        path: path.to_owned(),
        root: root.to_owned(),
        is_archive,
        components: Vec::new(),
        connections: Vec::new(),
        outputs: Vec::new(),
        start: None,
        stop: None,
    };
    reader.document(&document, &mut system);
    if reader.problems.is_empty() {
        return Ok(system);
    }
    reader.problems.sort_by_key(|(line, _)| *line);
    Err(Error::System { path: path.to_owned(), problems: reader.problems })
}

#[derive(Default)]
struct StructureReader {
    problems: Vec<(usize, String)>,
    /// The system's own connectors.
    connectors: Vec<Connector>,
}

/// One end of a connection: the position of its component, none for the system's own, and the connector.
type ConnectionEnd = (Option<usize>, Connector);

impl StructureReader {
    fn problem(&mut self, element: &Element, message: impl Into<String>) {
        self.problems.push((element.line, message.into()));
    }

    fn refuse(&mut self, element: &Element, expected: &str) {
        let named = element.attribute("name").map_or(String::new(), |name| format!(" `{name}`"));
        self.problem(element, format!("<{}>{named} is not supported, expected {expected}", element.name));
    }

    /// An attribute that has to be there.
    fn needed<'a>(&mut self, element: &'a Element, attribute: &str) -> Option<&'a str> {
        let value = element.attribute(attribute).filter(|value| !value.is_empty());
        if value.is_none() {
            self.problem(element, format!("<{}> has no attribute `{attribute}`", element.name));
        }
        value
    }

    fn real(&mut self, element: &Element, attribute: &str) -> Option<f64> {
        let text = element.attribute(attribute)?;
        let value = parse_real(text).filter(|value| value.is_finite());
        if value.is_none() {
            self.problem(element, format!("<{}> has {attribute}=\"{text}\", expected a number", element.name));
        }
        value
    }

    fn document(&mut self, root: &Element, system: &mut FmuSystem) {
        if local(root) != "SystemStructureDescription" {
            let message = format!("the root element is <{}>, expected <SystemStructureDescription>", root.name);
            return self.problem(root, message);
        }
        match root.attribute("version") {
            Some(version) if version.starts_with("1.") => {}
            version => {
                let found = version.unwrap_or("not given");
                self.problem(root, format!("the version is {found}, expected 1.0"));
            }
        }
        system.name = root.attribute("name").unwrap_or_default().to_owned();
        for child in content(root) {
            match local(child) {
                "System" => {}
                "DefaultExperiment" => {
                    (system.start, system.stop) = (self.real(child, "startTime"), self.real(child, "stopTime"));
                }
                _ => self.refuse(child, "<System> or <DefaultExperiment>"),
            }
        }
        match content(root).find(|child| local(child) == "System") {
            Some(element) => self.system(element, system),
            None => self.problem(root, format!("<{}> has no <System>", root.name)),
        }
    }

    fn system(&mut self, element: &Element, system: &mut FmuSystem) {
        let (mut values, mut connections) = (Vec::new(), Vec::new());
        for child in content(element) {
            match local(child) {
                "Connectors" => self.connectors = self.connectors(child),
                "ParameterBindings" => values.extend(self.values(child)),
                "Elements" => system.components = self.components(child),
                "Connections" => connections.extend(content(child)),
                _ => self.refuse(child, "<Connectors>, <ParameterBindings>, <Elements> or <Connections>"),
            }
        }
        if system.components.is_empty() && self.problems.is_empty() {
            self.problem(element, format!("<{}> has no components", element.name));
        }
        let own = self.assign(values, &mut system.components);
        for connection in connections {
            self.connection(connection, &own, system);
        }
        for component in &system.components {
            let mut names: Vec<&StartValue> = Vec::new();
            for value in &component.values {
                match names.iter().find(|known| known.name == value.name) {
                    Some(known) => {
                        let message = format!(
                            "`{}.{}` is set a second time, after line {}",
                            component.name, value.name, known.line
                        );
                        self.problems.push((value.line, message));
                    }
                    None => names.push(value),
                }
            }
        }
    }

    fn components(&mut self, elements: &Element) -> Vec<SystemComponent> {
        let mut components: Vec<SystemComponent> = Vec::new();
        for element in content(elements) {
            if local(element) != "Component" {
                self.refuse(element, "components that are FMUs");
                continue;
            }
            let component = self.component(element);
            if components.iter().any(|known| known.name == component.name) {
                self.problem(element, format!("a second component of the name `{}`", component.name));
            }
            components.push(component);
        }
        components
    }

    fn component(&mut self, element: &Element) -> SystemComponent {
        let name = self.needed(element, "name").unwrap_or_default().to_owned();
        let source = self.needed(element, "source").unwrap_or_default().to_owned();
        if source.contains("://") {
            self.problem(
                element,
                format!("component `{name}` has the source `{source}`, expected a file of the system"),
            );
        }
        let kind = element.attribute("type").unwrap_or(FMU);
        if ![FMU, MECHANISM].contains(&kind) {
            let message = format!("component `{name}` is of the type `{kind}`, expected `{FMU}` or `{MECHANISM}`");
            self.problem(element, message);
        }
        let is_mechanism = kind == MECHANISM;
        let interface = match element.attribute("implementation") {
            None | Some("any") => None,
            Some("CoSimulation") => Some(InterfaceKind::CoSimulation),
            Some("ModelExchange") => Some(InterfaceKind::ModelExchange),
            Some(other) => {
                let expected = "expected any, CoSimulation or ModelExchange";
                self.problem(element, format!("component `{name}` has the implementation `{other}`, {expected}"));
                None
            }
        };
        let mut component =
            SystemComponent { name, line: element.line, source, is_mechanism, interface, ..SystemComponent::default() };
        for child in content(element) {
            match local(child) {
                "Connectors" => component.connectors = self.connectors(child),
                "ParameterBindings" => component.values.extend(self.values(child)),
                _ => self.refuse(child, "<Connectors> or <ParameterBindings>"),
            }
        }
        component
    }

    fn connectors(&mut self, list: &Element) -> Vec<Connector> {
        let mut connectors: Vec<Connector> = Vec::new();
        for element in content(list) {
            if local(element) != "Connector" {
                self.refuse(element, "<Connector>");
                continue;
            }
            let name = self.needed(element, "name").unwrap_or_default().to_owned();
            let kind = match element.attribute("kind") {
                Some("input") => ConnectorKind::Input,
                Some("output") => ConnectorKind::Output,
                Some("parameter") => ConnectorKind::Parameter,
                Some("calculatedParameter") => ConnectorKind::CalculatedParameter,
                other => {
                    let expected = "expected input, output, parameter or calculatedParameter";
                    let found = other.unwrap_or("none");
                    self.problem(element, format!("connector `{name}` has the kind `{found}`, {expected}"));
                    continue;
                }
            };
            if connectors.iter().any(|known| known.name == name) {
                self.problem(element, format!("a second connector of the name `{name}`"));
            }
            let unit = content(element).find_map(|child| child.attribute("unit")).map(str::to_owned);
            connectors.push(Connector { name, line: element.line, kind, unit });
        }
        connectors
    }

    /// The values in a list of bindings, with their prefixes.
    fn values(&mut self, bindings: &Element) -> Vec<StartValue> {
        let mut values = Vec::new();
        for binding in content(bindings) {
            if local(binding) != "ParameterBinding" {
                self.refuse(binding, "<ParameterBinding>");
                continue;
            }
            let kind = binding.attribute("type").unwrap_or(PARAMETER_SET);
            if kind != PARAMETER_SET {
                self.problem(binding, format!("a parameter binding of the type `{kind}`, expected `{PARAMETER_SET}`"));
            }
            if let Some(source) = binding.attribute("source") {
                let expected = "expected the values in <ParameterValues>";
                self.problem(binding, format!("a parameter binding with the source `{source}`, {expected}"));
            }
            let prefix = binding.attribute("prefix").unwrap_or_default();
            for child in content(binding) {
                if local(child) != "ParameterValues" {
                    self.refuse(child, "<ParameterValues>");
                    continue;
                }
                for set in content(child) {
                    if local(set) != "ParameterSet" {
                        self.refuse(set, "<ParameterSet>");
                        continue;
                    }
                    for list in content(set) {
                        if local(list) != "Parameters" {
                            self.refuse(list, "<Parameters>");
                            continue;
                        }
                        values.extend(content(list).filter_map(|parameter| self.value(parameter, prefix)));
                    }
                }
            }
        }
        values
    }

    fn value(&mut self, parameter: &Element, prefix: &str) -> Option<StartValue> {
        if local(parameter) != "Parameter" {
            self.refuse(parameter, "<Parameter>");
            return None;
        }
        let name = self.needed(parameter, "name")?;
        let Some(typed) = content(parameter).next() else {
            self.problem(parameter, format!("parameter `{name}` has no value"));
            return None;
        };
        let kind = local(typed);
        if !["Real", "Integer", "Boolean"].contains(&kind) {
            let message =
                format!("parameter `{name}` is of the type <{}>, expected a real, an integer or a boolean", typed.name);
            self.problem(typed, message);
            return None;
        }
        let text = self.needed(typed, "value")?;
        let value = match kind {
            "Boolean" => parse_boolean(text).map(|value| f64::from(u8::from(value))),
            "Integer" => parse_real(text).filter(|value| value.fract() == 0.0),
            _ => parse_real(text).filter(|value| value.is_finite()),
        };
        let Some(value) = value else {
            self.problem(typed, format!("parameter `{name}` has the value `{text}`, which is no <{}>", typed.name));
            return None;
        };
        let unit = typed.attribute("unit").map(str::to_owned);
        Some(StartValue { name: format!("{prefix}{name}"), line: parameter.line, value, unit })
    }

    /// Gives the values that are bound to the system to its components; returns those of the system's connectors.
    fn assign(&mut self, values: Vec<StartValue>, components: &mut [SystemComponent]) -> Vec<StartValue> {
        let mut own = Vec::new();
        for value in values {
            if self.connectors.iter().any(|connector| connector.name == value.name) {
                own.push(value);
                continue;
            }
            // names of components may have dots, too
            let fitting = components.iter_mut().filter_map(|component| {
                let rest = value.name.strip_prefix(component.name.as_str())?.strip_prefix('.')?.to_owned();
                Some((component, rest))
            });
            match fitting.max_by_key(|(component, _)| component.name.len()) {
                Some((component, name)) => component.values.push(StartValue { name, ..value }),
                None => {
                    let expected = "expected `COMPONENT.NAME` or the name of a connector of the system";
                    self.problems.push((value.line, format!("parameter `{}`: {expected}", value.name)));
                }
            }
        }
        own
    }

    /// A connection between components, from one to an output of the system, or from an input or parameter of the
    /// system, which is constant.
    fn connection(&mut self, element: &Element, own: &[StartValue], system: &mut FmuSystem) {
        if local(element) != "Connection" {
            return self.refuse(element, "<Connection>");
        }
        if let Some(child) = content(element).next() {
            return self.refuse(child, "a connection without transformation");
        }
        let (start, end) = (self.end(element, "start", system), self.end(element, "end", system));
        let (Some((from, start)), Some((to, end))) = (start, end) else { return };
        // from inside, the system's own go the other way
        for (component, connector, gives) in [(from, &start, true), (to, &end, false)] {
            let is_output = matches!(connector.kind, ConnectorKind::Output | ConnectorKind::CalculatedParameter);
            if is_output != (gives == component.is_some()) {
                let (role, way) = if gives { ("start", "gives") } else { ("end", "takes") };
                let message = format!("the connection's {role} is `{}`, which {way} no value", connector.name);
                return self.problem(element, message);
            }
        }
        let suppressed = element.attribute("suppressUnitConversion").and_then(parse_boolean).unwrap_or(false);
        if let (Some(one), Some(other)) = (&start.unit, &end.unit)
            && one != other
            && !suppressed
        {
            let message = format!(
                "the connection from `{}` in {one} to `{}` in {other} needs a conversion, which is not supported: expected equal units",
                start.name, end.name
            );
            return self.problem(element, message);
        }
        let line = element.line;
        let mut targets = system.connections.iter().map(|connection| &connection.to);
        match (from, to) {
            (Some(_), Some(target))
                if targets.any(|known| known.component == target && known.connector == end.name) =>
            {
                self.problem(
                    element,
                    format!("a second connection to `{}.{}`", system.components[target].name, end.name),
                );
            }
            (Some(_), Some(_)) if end.kind == ConnectorKind::Parameter => {
                let message =
                    format!("the connection to the parameter `{}` is not supported, expected an input", end.name);
                self.problem(element, message);
            }
            (Some(from), Some(to)) => {
                let from = End { component: from, connector: start.name, line };
                system.connections.push(Connection { from, to: End { component: to, connector: end.name, line } });
            }
            (Some(from), None) => {
                system.outputs.push((end.name, End { component: from, connector: start.name, line }));
            }
            (None, Some(to)) => {
                let value = own.iter().find(|value| value.name == start.name);
                let value = value.map(|value| StartValue { name: end.name, line, ..value.clone() });
                system.components[to].values.extend(value);
            }
            (None, None) => {
                self.problem(element, "a connection from the system to itself, expected one with a component")
            }
        }
    }

    fn end(&mut self, connection: &Element, which: &str, system: &FmuSystem) -> Option<ConnectionEnd> {
        let connector = self.needed(connection, &format!("{which}Connector"));
        let component = match connection.attribute(&format!("{which}Element")) {
            None => None,
            Some(name) => match system.position(name) {
                Some(position) => Some(position),
                None => {
                    let known: Vec<&str> = system.components.iter().map(|component| component.name.as_str()).collect();
                    let message = format!("there is no component `{name}`, {}", expected_one_of(name, &known));
                    self.problem(connection, message);
                    return None;
                }
            },
        };
        let name = connector?;
        let connectors = component.map_or(&self.connectors, |position| &system.components[position].connectors);
        let found = connectors.iter().find(|known| known.name == name).cloned();
        if found.is_none() {
            let known: Vec<&str> = connectors.iter().map(|connector| connector.name.as_str()).collect();
            let of = component
                .map_or("the system".into(), |position| format!("component `{}`", system.components[position].name));
            let message = format!("{of} has no connector `{name}`, {}", expected_one_of(name, &known));
            self.problem(connection, message);
        }
        Some((component, found?))
    }
}

/// An element's name without the prefix of its namespace.
fn local(element: &Element) -> &str {
    element.name.rsplit(':').next().unwrap_or_default()
}

/// The children that say something about a run.
fn content(element: &Element) -> impl Iterator<Item = &Element> {
    element.children.iter().filter(|child| !IGNORED.contains(&local(child)))
}
