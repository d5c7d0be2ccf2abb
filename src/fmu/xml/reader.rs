//! Reads modelDescription.xml of FMI 2.0.

use super::{
    Problem, schema,
    tree::{Element, decode},
};
use crate::fmu::{
    model_description::{
        CoSimulation, DefaultExperiment, DependencyKind, DisplayUnit, Initial, Integer, Interface, ModelDescription,
        ModelStructure, Named, Real, ScalarVariable, TypeDefinition, UnitDefinition, Unknown, Variability,
        VariableType,
    },
    unit::BaseUnit,
};

/// A description as read from a file.
#[derive(Debug)]
pub struct Document {
    /// What could be read.
    pub description: ModelDescription,
    /// What in the file is not as the standard's schema says.
    pub problems: Vec<Problem>,
    /// Line of each variable, for messages about it.
    pub variable_lines: Vec<usize>,
    /// Line of `ModelStructure`.
    pub structure_line: usize,
}

/// Reads a modelDescription.xml.
///
/// Offences against the schema are collected in [`Document::problems`] and read past as well as possible; defaults that
/// the standard gives to absent attributes are filled in.
///
/// # Errors
/// The one [`Problem`] that makes reading impossible: it is not UTF-8, not XML, or not FMI 2.0.
pub fn read(bytes: &[u8]) -> Result<Document, Problem> {
    let text = decode(bytes)?;
    let root = Element::parse(&text)?;
    if root.name != "fmiModelDescription" {
        let message = format!("the root element is <{}>, expected <fmiModelDescription>", root.name);
        return Err(Problem::unusable(root.line, message));
    }
    let version = root.attribute("fmiVersion").unwrap_or_default();
    if version != "2.0" {
        let message = format!("fmiVersion is \"{version}\": only FMI 2.0 is supported");
        return Err(Problem::unusable(root.line, message));
    }
    let mut problems = Vec::new();
    schema::check(&root, "", &mut problems);
    let mut reader = Reader { problems };
    let description = reader.description(&root);
    Ok(Document {
        description,
        problems: reader.problems,
        variable_lines: scalar_variables(&root).map(|variable| variable.line).collect(),
        structure_line: root.child("ModelStructure").map_or(root.line, |structure| structure.line),
    })
}

/// Positions in other parts of the file count these, so that none of them may be skipped.
fn scalar_variables(root: &Element) -> impl Iterator<Item = &Element> {
    root.list("ModelVariables").filter(|element| element.name == "ScalarVariable")
}

/// What the schema check has reported is not reported again here: a value that does not parse counts as absent.
struct Reader {
    problems: Vec<Problem>,
}

impl Reader {
    fn description(&mut self, root: &Element) -> ModelDescription {
        let named = |list: &'static str, name: &'static str| root.list(list).filter(move |e| e.name == name);
        ModelDescription {
            model_name: text(root, "modelName").unwrap_or_default(),
            token: text(root, "guid").unwrap_or_default(),
            description: text(root, "description"),
            author: text(root, "author"),
            version: text(root, "version"),
            copyright: text(root, "copyright"),
            license: text(root, "license"),
            generation_tool: text(root, "generationTool"),
            generation_date_and_time: text(root, "generationDateAndTime"),
            naming: name(root, "variableNamingConvention").unwrap_or_default(),
            co_simulation: root.child("CoSimulation").map(co_simulation),
            model_exchange: root.child("ModelExchange").map(interface),
            units: named("UnitDefinitions", "Unit").map(unit).collect(),
            types: named("TypeDefinitions", "SimpleType").filter_map(|element| self.type_definition(element)).collect(),
            log_categories: named("LogCategories", "Category")
                .map(|element| (text(element, "name").unwrap_or_default(), text(element, "description")))
                .collect(),
            default_experiment: root.child("DefaultExperiment").map(default_experiment),
            variables: scalar_variables(root).map(|element| self.variable(element)).collect(),
            structure: root.child("ModelStructure").map(|element| self.structure(element)).unwrap_or_default(),
        }
    }

    fn type_definition(&mut self, element: &Element) -> Option<TypeDefinition> {
        let kind = element.children.iter().find(|child| schema::is_type(&child.name))?;
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
        let default = Initial::allowed(causality, variability).and_then(|allowed| allowed.first().copied());
        let kind = element.children.iter().find(|child| schema::is_type(&child.name));
        ScalarVariable {
            name: text(element, "name").unwrap_or_default(),
            value_reference: number(element, "valueReference").unwrap_or_default(),
            description: text(element, "description"),
            causality,
            variability,
            initial: given.or(default),
            declared_type: kind.and_then(|kind| text(kind, "declaredType")),
            // the schema check has reported a variable without a type
            kind: kind.map_or(VariableType::Real(Real::default()), |kind| self.variable_type(kind)),
        }
    }

    fn variable_type(&mut self, element: &Element) -> VariableType {
        let integer =
            || Integer { min: number(element, "min"), max: number(element, "max"), start: number(element, "start") };
        match element.name.as_str() {
            "Integer" => VariableType::Integer(integer()),
            "Enumeration" => VariableType::Enumeration(integer()),
            "Boolean" => VariableType::Boolean { start: element.attribute("start").and_then(schema::parse_boolean) },
            "String" => VariableType::String { start: text(element, "start") },
            _ => VariableType::Real(Real {
                unit: text(element, "unit"),
                display_unit: text(element, "displayUnit"),
                min: real(element, "min"),
                max: real(element, "max"),
                nominal: real(element, "nominal"),
                start: real(element, "start"),
                derivative: element.attribute("derivative").and_then(|index| self.position(element, index)),
            }),
        }
    }

    fn structure(&mut self, element: &Element) -> ModelStructure {
        let mut list = |name| element.list(name).filter_map(|unknown| self.unknown(unknown)).collect();
        ModelStructure {
            outputs: list("Outputs"),
            derivatives: list("Derivatives"),
            initial_unknowns: list("InitialUnknowns"),
        }
    }

    fn unknown(&mut self, element: &Element) -> Option<Unknown> {
        let variable = self.position(element, element.attribute("index")?)?;
        let dependencies = element
            .attribute("dependencies")
            .map(|list| list.split_whitespace().filter_map(|index| self.position(element, index)).collect());
        let kinds = element
            .attribute("dependenciesKind")
            .map(|list| list.split_whitespace().filter_map(DependencyKind::from_name).collect());
        Some(Unknown { variable, dependencies, kinds })
    }

    /// The file counts from 1.
    fn position(&mut self, element: &Element, index: &str) -> Option<usize> {
        let index: u32 = index.trim().parse().ok()?;
        if index == 0 {
            let message = format!("<{}> refers to variable 0; the first one is 1", element.name);
            self.problems.push(Problem::unusable(element.line, message));
        }
        Some(index.checked_sub(1)? as usize)
    }
}

fn interface(element: &Element) -> Interface {
    Interface {
        model_identifier: text(element, "modelIdentifier").unwrap_or_default(),
        needs_execution_tool: flag(element, "needsExecutionTool"),
        only_once_per_process: flag(element, "canBeInstantiatedOnlyOncePerProcess"),
        own_memory_management: flag(element, "canNotUseMemoryManagementFunctions"),
        get_and_set_state: flag(element, "canGetAndSetFMUstate"),
        serialize_state: flag(element, "canSerializeFMUstate"),
        directional_derivative: flag(element, "providesDirectionalDerivative"),
    }
}

fn co_simulation(element: &Element) -> CoSimulation {
    CoSimulation {
        interface: interface(element),
        variable_step_size: flag(element, "canHandleVariableCommunicationStepSize"),
        interpolate_inputs: flag(element, "canInterpolateInputs"),
        max_output_derivative_order: number(element, "maxOutputDerivativeOrder").unwrap_or_default(),
        run_asynchronously: flag(element, "canRunAsynchronuously"),
    }
}

fn unit(element: &Element) -> UnitDefinition {
    let base = element.child("BaseUnit").map(|base| BaseUnit {
        exponents: BaseUnit::SYMBOLS.map(|symbol| number(base, symbol).unwrap_or_default()),
        factor: real(base, "factor").unwrap_or(1.0),
        offset: real(base, "offset").unwrap_or(0.0),
    });
    let display = element.children.iter().filter(|child| child.name == "DisplayUnit").map(|child| DisplayUnit {
        name: text(child, "name").unwrap_or_default(),
        factor: real(child, "factor").unwrap_or(1.0),
        offset: real(child, "offset").unwrap_or(0.0),
    });
    UnitDefinition { name: text(element, "name").unwrap_or_default(), base, display: display.collect() }
}

fn default_experiment(element: &Element) -> DefaultExperiment {
    DefaultExperiment {
        start: real(element, "startTime"),
        stop: real(element, "stopTime"),
        tolerance: real(element, "tolerance"),
        step_size: real(element, "stepSize"),
    }
}

fn text(element: &Element, attribute: &str) -> Option<String> {
    element.attribute(attribute).map(str::to_owned)
}

fn name<T: Named>(element: &Element, attribute: &str) -> Option<T> {
    element.attribute(attribute).and_then(T::from_name)
}

fn real(element: &Element, attribute: &str) -> Option<f64> {
    element.attribute(attribute).and_then(schema::parse_real)
}

fn number<T: std::str::FromStr>(element: &Element, attribute: &str) -> Option<T> {
    element.attribute(attribute).and_then(|text| text.trim().parse().ok())
}

fn flag(element: &Element, attribute: &str) -> bool {
    element.attribute(attribute).and_then(schema::parse_boolean).unwrap_or(false)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Line and message of what is wrong with a file that has `lines` in its root element, from line 2 on.
    fn problems(lines: &str) -> Vec<(usize, String)> {
        let file =
            format!("<fmiModelDescription fmiVersion='2.0' modelName='m' guid='g'>\n{lines}</fmiModelDescription>");
        let document = read(file.as_bytes()).unwrap();
        document.problems.into_iter().map(|problem| (problem.line, problem.message)).collect()
    }

    const VARIABLES: &str =
        "<ModelVariables><ScalarVariable name='x' valueReference='0'><Real/></ScalarVariable></ModelVariables>";

    #[test]
    fn what_is_not_xml_is_reported_with_its_line() {
        for (file, line, message) in [
            ("", 1, "no root element"),
            ("<a>\n<b>\n</a>", 3, "not well-formed"),
            ("<a>\n<b x='1' x='2'/></a>", 2, "duplicate"),
            ("<a>\n<b x='&nothing;'/></a>", 2, "nothing"),
            ("<a>\n\n", 3, "<a> of line 1 is never closed"),
            ("<a/>\n<b/>", 2, "second root"),
            ("<a/>", 1, "the root element is <a>"),
            ("<fmiModelDescription fmiVersion='1.0'/>", 1, "fmiVersion is \"1.0\": only FMI 2.0 is supported"),
            ("\n<fmiModelDescription fmiVersion='3.0'/>", 2, "fmiVersion is \"3.0\": only FMI 2.0 is supported"),
        ] {
            let problem = read(file.as_bytes()).unwrap_err();
            assert_eq!(problem.line, line, "{file}: {}", problem.message);
            assert!(problem.message.contains(message), "{file}: {}", problem.message);
        }
        assert_eq!(read(&"<a>".repeat(1000).into_bytes()).unwrap_err().message, "elements are nested deeper than 200");
    }

    #[test]
    fn other_encodings_are_read_if_they_are_declared() {
        let file = |declaration: &str| {
            let text = "<fmiModelDescription fmiVersion='2.0' modelName='M\u{fc}hle' guid='g'/>";
            let latin = text.chars().map(|c| c as u8);
            declaration.bytes().chain(latin).collect::<Vec<u8>>()
        };
        let document = read(&file("<?xml version='1.0' encoding='ISO-8859-1'?>")).unwrap();
        assert_eq!(document.description.model_name, "M\u{fc}hle");
        let problem = read(&file("<?xml version='1.0'?>\n")).unwrap_err();
        assert_eq!((problem.line, problem.message.as_str()), (2, "not in the encoding UTF-8"));
    }

    #[test]
    fn offences_against_the_schema_are_reported_with_their_lines() {
        for (lines, line, message) in [
            (format!("{VARIABLES}\n<ModelStructure/>\n<UnitDefinitions><Unit name='m'/></UnitDefinitions>"), 4,
             "<UnitDefinitions> must stand before <ModelStructure> in <fmiModelDescription>"),
            (VARIABLES.to_string(), 1, "<fmiModelDescription> has no <ModelStructure>"),
            ("<ModelStructure/>".into(), 1, "<fmiModelDescription> has no <ModelVariables>"),
            (format!("<Oddity/>\n{VARIABLES}<ModelStructure/>"), 2, "<Oddity> is no element of <fmiModelDescription>"),
            (format!("<CoSimulation/>{VARIABLES}<ModelStructure/>"), 2, "<CoSimulation> has no attribute `modelIdentifier`"),
            (format!("<DefaultExperiment\n stopTime='soon'/>{VARIABLES}<ModelStructure/>"), 2,
             "<DefaultExperiment> has stopTime=\"soon\", expected a number"),
            (format!("<DefaultExperiment end='1'/>{VARIABLES}<ModelStructure/>"), 2,
             "<DefaultExperiment> has an unknown attribute `end`"),
            ("<ModelVariables>\n<ScalarVariable name='x' valueReference='-1'><Real/></ScalarVariable>\n</ModelVariables><ModelStructure/>".into(), 3,
             "<ScalarVariable> has valueReference=\"-1\", expected an integer from 0 to 4294967295"),
            ("<ModelVariables>\n<ScalarVariable name='x' valueReference='1'/></ModelVariables><ModelStructure/>".into(), 3,
             "<ScalarVariable> has 0 of <Real>, <Integer>, <Boolean>, <String> and <Enumeration>, expected one"),
            ("<ModelVariables><ScalarVariable name='x' valueReference='1' causality='out'><Real/></ScalarVariable></ModelVariables><ModelStructure/>".into(), 2,
             "<ScalarVariable> has causality=\"out\", expected one of parameter, calculatedParameter, input, output, local, independent"),
            (format!("{VARIABLES}\n<ModelStructure>\n<Outputs><Unknown index='0'/></Outputs></ModelStructure>"), 4,
             "<Unknown> refers to variable 0; the first one is 1"),
        ] {
            assert_eq!(problems(&lines), [(line, message.to_owned())], "{lines}");
        }
    }

    #[test]
    fn an_empty_list_of_dependencies_is_not_an_absent_one() {
        let structure = "<ModelStructure><Outputs><Unknown index='1'/><Unknown index='1' dependencies=''/>\
                         <Unknown index='1' dependencies=' 1 ' dependenciesKind='fixed'/></Outputs></ModelStructure>";
        let file = format!(
            "<fmiModelDescription fmiVersion='2.0' modelName='m' guid='g'>{VARIABLES}{structure}</fmiModelDescription>"
        );
        let outputs = read(file.as_bytes()).unwrap().description.structure.outputs;
        let dependencies: Vec<_> = outputs.iter().map(|unknown| unknown.dependencies.clone()).collect();
        assert_eq!(dependencies, [None, Some(vec![]), Some(vec![0])]);
        assert_eq!(outputs[2].kinds, Some(vec![DependencyKind::Fixed]));
    }

    #[test]
    fn numbers_are_those_of_xml_schema() {
        assert_eq!(schema::parse_real(" -1.5E3 "), Some(-1500.0));
        assert_eq!(schema::parse_real("-INF"), Some(f64::NEG_INFINITY));
        for text in ["inf", "nan", "infinity", "1,5", "0x1", ""] {
            assert_eq!(schema::parse_real(text), None, "{text}");
        }
    }
}
