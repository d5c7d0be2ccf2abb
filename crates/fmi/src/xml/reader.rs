//! Reads modelDescription.xml of any version; what both versions have in common.

use super::{XmlProblem, schema, tree::Element};
use crate::{
    model_description::{
        DefaultExperiment, DependencyKind, DisplayUnit, FmiVersion, ModelDescription, Named, UnitDefinition,
    },
    unit::BaseUnit,
};

/// A description as read from a file.
#[derive(Debug)]
pub struct Document {
    /// Content that could be read.
    pub description: ModelDescription,
    /// Deviations of the file from the standard's schema.
    pub problems: Vec<XmlProblem>,
    /// Line of each variable, for messages about it.
    pub variable_lines: Vec<usize>,
    /// Line of `ModelStructure`.
    pub structure_line: usize,
}

/// Attributes of the root element that both versions have; `token` is the name of that attribute.
pub fn root(root: &Element, fmi_version: FmiVersion, token: &str) -> ModelDescription {
    ModelDescription {
        fmi_version,
        model_name: text(root, "modelName").unwrap_or_default(),
        token: text(root, token).unwrap_or_default(),
        description: text(root, "description"),
        author: text(root, "author"),
        version: text(root, "version"),
        copyright: text(root, "copyright"),
        license: text(root, "license"),
        generation_tool: text(root, "generationTool"),
        generation_date_and_time: text(root, "generationDateAndTime"),
        naming: name(root, "variableNamingConvention").unwrap_or_default(),
        units: named(root, "UnitDefinitions", "Unit").map(unit).collect(),
        log_categories: named(root, "LogCategories", "Category")
            .map(|element| (text(element, "name").unwrap_or_default(), text(element, "description")))
            .collect(),
        default_experiment: root.child("DefaultExperiment").map(default_experiment),
        ..ModelDescription::default()
    }
}

/// The children of that name in a list.
pub fn named<'a>(root: &'a Element, list: &'static str, name: &'static str) -> impl Iterator<Item = &'a Element> {
    root.list(list).filter(move |element| element.name == name)
}

/// `dependenciesKind`.
pub fn dependency_kinds(element: &Element) -> Option<Vec<DependencyKind>> {
    let list = element.attribute("dependenciesKind")?;
    Some(list.split_whitespace().filter_map(DependencyKind::from_name).collect())
}

pub fn unit(element: &Element) -> UnitDefinition {
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

pub fn default_experiment(element: &Element) -> DefaultExperiment {
    DefaultExperiment {
        start: real(element, "startTime"),
        stop: real(element, "stopTime"),
        tolerance: real(element, "tolerance"),
        step_size: real(element, "stepSize"),
    }
}

pub fn text(element: &Element, attribute: &str) -> Option<String> {
    element.attribute(attribute).map(str::to_owned)
}

pub fn name<T: Named>(element: &Element, attribute: &str) -> Option<T> {
    element.attribute(attribute).and_then(T::from_name)
}

pub fn real(element: &Element, attribute: &str) -> Option<f64> {
    element.attribute(attribute).and_then(schema::parse_real)
}

pub fn number<T: std::str::FromStr>(element: &Element, attribute: &str) -> Option<T> {
    element.attribute(attribute).and_then(|text| text.trim().parse().ok())
}

pub fn flag(element: &Element, attribute: &str) -> bool {
    element.attribute(attribute).and_then(schema::parse_boolean).unwrap_or(false)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::xml::read;

    /// Line and message of each mistake in a file that has `lines` in its root element, from line 2 on.
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
            ("<a>\n<b c='\u{1}'/></a>", 2, "the character U+0001 is not allowed"),
            ("<a\n b='&#x1f;'/>", 1, "the character U+001F is not allowed"),
            ("<a/>", 1, "the root element is <a>"),
            ("<fmiModelDescription fmiVersion='1.0'/>", 1, "fmiVersion is \"1.0\": only FMI 2.0 and 3.0 are supported"),
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
             "<UnitDefinitions> must come before <ModelStructure> in <fmiModelDescription>"),
            (VARIABLES.to_string(), 1, "<fmiModelDescription> has no <ModelStructure>"),
            ("<ModelStructure/>".into(), 1, "<fmiModelDescription> has no <ModelVariables>"),
            (format!("<Oddity/>\n{VARIABLES}<ModelStructure/>"), 2, "<Oddity> is not an element of <fmiModelDescription>"),
            (format!("<CoSimulation/>{VARIABLES}<ModelStructure/>"), 2, "<CoSimulation> has no attribute `modelIdentifier`"),
            (format!("<DefaultExperiment\n stopTime='soon'/>{VARIABLES}<ModelStructure/>"), 2,
             "<DefaultExperiment> has stopTime=\"soon\", expected a number"),
            (format!("<CoSimulation modelIdentifier=''/>{VARIABLES}<ModelStructure/>"), 2,
             "<CoSimulation> has modelIdentifier=\"\", expected a name"),
            (format!("<DefaultExperiment end='1'/>{VARIABLES}<ModelStructure/>"), 2,
             "<DefaultExperiment> has an unknown attribute `end`"),
            ("<ModelVariables>\n<ScalarVariable name='x' valueReference='-1'><Real/></ScalarVariable>\n</ModelVariables><ModelStructure/>".into(), 3,
             "<ScalarVariable> has valueReference=\"-1\", expected an integer from 0 to 4294967295"),
            ("<ModelVariables>\n<ScalarVariable name='x' valueReference='1'/></ModelVariables><ModelStructure/>".into(), 3,
             "<ScalarVariable> has 0 of <Real>, <Integer>, <Boolean>, <String>, <Enumeration>, expected one"),
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

    /// Problems of lines in a description for FMI 3.0.
    fn problems_of_3(lines: &str) -> Vec<(usize, String)> {
        let file = format!(
            "<fmiModelDescription fmiVersion='3.0' modelName='m' instantiationToken='t'>\n{lines}</fmiModelDescription>"
        );
        let document = read(file.as_bytes()).unwrap();
        document.problems.into_iter().map(|problem| (problem.line, problem.message)).collect()
    }

    #[test]
    fn offences_against_the_schema_of_fmi_3_are_reported_with_their_lines() {
        for (lines, line, message) in [
            ("<ModelVariables/><ModelStructure/>", 2, "<ModelVariables> is empty"),
            (
                "<ModelVariables>\n<Real name='x' valueReference='0'/><Float64 name='y' valueReference='1'/></ModelVariables><ModelStructure/>",
                3,
                "<Real> is not an element of <ModelVariables>",
            ),
            (
                "<ModelVariables><Int8 name='x' valueReference='0' start='128'/></ModelVariables><ModelStructure/>",
                2,
                "<Int8> has start=\"128\", expected an integer from -128 to 127",
            ),
            (
                "<ModelVariables><Clock name='x' valueReference='0'/></ModelVariables><ModelStructure/>",
                2,
                "<Clock> has no attribute `intervalVariability`",
            ),
            (
                "<ModelVariables><Enumeration name='x' valueReference='0'/></ModelVariables><ModelStructure/>",
                2,
                "<Enumeration> has no attribute `declaredType`",
            ),
            (
                "<ModelVariables><Float64 name='x' valueReference='0' start='b'/></ModelVariables><ModelStructure/>",
                2,
                "<Float64> has start=\"b\", expected a list of numbers",
            ),
            (
                "<ModelVariables><Float64 name='x' valueReference='0' start='1 2'/></ModelVariables><ModelStructure/>",
                2,
                "variable \"x\" has 2 start values, expected 1",
            ),
            (
                "<ModelVariables><Float64 name='x' valueReference='0'>\n<Dimension/></Float64></ModelVariables><ModelStructure/>",
                3,
                "<Dimension> has either a start or a valueReference",
            ),
            (
                "<ModelVariables><Float64 name='x' valueReference='0'/></ModelVariables>\n<ModelStructure><Output valueReference='1'/></ModelStructure>",
                3,
                "<Output> refers to the value reference 1, which no variable has",
            ),
            (
                "<ModelVariables><Float64 name='x' valueReference='0'/></ModelVariables><ModelStructure>\n<InitialUnknown valueReference='0'/><Output valueReference='0'/></ModelStructure>",
                3,
                "<Output> must come before <InitialUnknown> in <ModelStructure>",
            ),
        ] {
            assert_eq!(problems_of_3(lines), [(line, message.to_owned())], "{lines}");
        }
    }

    #[test]
    fn attributes_of_other_tools_on_an_interface_of_fmi_3_are_allowed() {
        let lines = "<CoSimulation modelIdentifier='m' vendorFlag='1'/><ModelVariables>\
                     <Float64 name='x' valueReference='0'/></ModelVariables><ModelStructure/>";
        assert_eq!(problems_of_3(lines), []);
    }

    #[test]
    fn a_text_of_fmi_3_that_is_an_attribute_is_one_start_value() {
        let lines = "<ModelVariables><String name='x' valueReference='0' start='Hello World'/></ModelVariables><ModelStructure/>";
        let problems = problems_of_3(lines);
        assert!(problems.iter().all(|(_, message)| !message.contains("start values")), "{problems:?}");
    }
}
