//! A description that breaks it for every rule.

use super::*;
use crate::xml;

const GOOD: &str = r#"<fmiModelDescription fmiVersion="2.0" modelName="m" guid="g">
<CoSimulation modelIdentifier="m"/>
<UnitDefinitions><Unit name="m"><DisplayUnit name="mm" factor="1000"/></Unit></UnitDefinitions>
<TypeDefinitions><SimpleType name="Length"><Real unit="m" min="0"/></SimpleType></TypeDefinitions>
<DefaultExperiment startTime="0" stopTime="1" stepSize="0.1"/>
<ModelVariables>
<ScalarVariable name="time" valueReference="0" causality="independent"><Real/></ScalarVariable>
<ScalarVariable name="p" valueReference="1" causality="parameter" variability="fixed"><Real declaredType="Length" displayUnit="mm" max="2" start="1"/></ScalarVariable>
<ScalarVariable name="u" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output" initial="calculated"><Real nominal="2"/></ScalarVariable>
<ScalarVariable name="n" valueReference="4" causality="output" variability="discrete" initial="exact"><Integer start="1" min="0" max="3"/></ScalarVariable>
</ModelVariables>
<ModelStructure>
<Outputs><Unknown index="4" dependencies="1 3"/><Unknown index="5" dependencies=""/></Outputs>
<InitialUnknowns><Unknown index="4" dependencies="1 2 3" dependenciesKind="dependent fixed dependent"/></InitialUnknowns>
</ModelStructure>
</fmiModelDescription>"#;

fn problems(text: &str) -> Vec<(usize, String)> {
    let mut report = Report::default();
    check(&xml::read(text.as_bytes()).unwrap(), &mut report);
    report.problems.into_iter().map(|finding| (finding.line.unwrap(), finding.message)).collect()
}

#[test]
fn a_good_description_has_no_problem() {
    assert_eq!(problems(GOOD), []);
}

#[test]
fn every_rule_has_a_description_that_breaks_it() {
    for (good, bad, line, message) in [
        (r#"<CoSimulation modelIdentifier="m"/>"#, "", 1, "there is neither <CoSimulation> nor <ModelExchange>"),
        (r#"modelIdentifier="m""#, r#"modelIdentifier="3 d""#, 1, "modelIdentifier \"3 d\" is not a C identifier"),
        (
            r#"modelIdentifier="m""#,
            r#"modelIdentifier="m" canSerializeFMUstate="1""#,
            1,
            "canSerializeFMUstate is true, but canGetAndSetFMUstate is not",
        ),
        ("</UnitDefinitions>", r#"<Unit name="m"/></UnitDefinitions>"#, 1, "unit \"m\" is defined twice"),
        (
            "</UnitDefinitions>",
            r#"<Unit name="s"><BaseUnit factor="0"/></Unit></UnitDefinitions>"#,
            1,
            "unit \"s\" has the factor 0",
        ),
        ("</Unit>", r#"<DisplayUnit name="mm"/></Unit>"#, 1, "unit \"m\" has the display unit \"mm\" twice"),
        (
            "</TypeDefinitions>",
            r#"<SimpleType name="Length"><Integer/></SimpleType></TypeDefinitions>"#,
            1,
            "type \"Length\" is defined twice",
        ),
        (
            "</TypeDefinitions>",
            r#"<SimpleType name="T"><Real unit="s"/></SimpleType></TypeDefinitions>"#,
            1,
            "type \"T\" has the unit \"s\", which is not defined",
        ),
        (r#"stopTime="1""#, r#"stopTime="-1""#, 1, "DefaultExperiment stops at -1, before its start at 0"),
        (r#"stepSize="0.1""#, r#"stepSize="0""#, 1, "DefaultExperiment has stepSize=\"0\", expected more than zero"),
        (r#"name="u""#, r#"name="p""#, 9, "variable \"p\" has the name of the variable in line 8"),
        (r#"name="u""#, r#"name="""#, 9, "a variable has an empty name"),
        (r#"name="u""#, "name=\"a&#10;b\"", 9, "variable \"a\\nb\" has a line break or tab in its name"),
        (r#"guid="g""#, r#"guid="g" variableNamingConvention="structured""#, 0, ""),
        (r#"name="u""#, r#"name="u 1""#, 0, ""),
        (
            r#"causality="input"><Real start="0"/>"#,
            r#"causality="independent"><Real/>"#,
            9,
            "variable \"u\" is independent, and so is \"time\"",
        ),
        (
            r#"causality="input""#,
            r#"causality="input" variability="fixed""#,
            9,
            "variable \"u\": variability fixed is not allowed for causality input",
        ),
        (
            r#"variability="discrete" initial="exact""#,
            r#"initial="exact""#,
            11,
            "variable \"n\" is of type Integer and cannot be continuous",
        ),
        (
            r#"causality="input""#,
            r#"causality="input" initial="exact""#,
            9,
            "variable \"u\": initial exact is not allowed for causality input and variability continuous",
        ),
        (r#"<Real start="0"/>"#, "<Real/>", 9, "variable \"u\" has no start value"),
        (r#" max="2" start="1""#, "", 8, "variable \"p\" has no start value"),
        (r#"nominal="2""#, r#"start="2""#, 10, "variable \"y\" is calculated and must not have a start value"),
        (
            r#"causality="independent"><Real/>"#,
            r#"causality="independent"><Real start="0"/>"#,
            7,
            "variable \"time\" is independent and must not have a start value",
        ),
        (r#"nominal="2""#, r#"nominal="0""#, 10, "variable \"y\" has nominal 0, expected more than zero"),
        (r#"nominal="2""#, r#"min="2" max="1""#, 10, "variable \"y\" has min 2 above max 1"),
        (r#"max="2" start="1""#, r#"max="2" start="3""#, 8, "variable \"p\" has start 3 above max 2"),
        (r#"max="2" start="1""#, r#"max="2" start="-1""#, 8, "variable \"p\" has start -1 below min 0"),
        (r#"max="2" start="1""#, r#"max="2" start="1e300""#, 8, "variable \"p\" has start 1e300 above max 2"),
        (r#"max="2" start="1""#, r#"max="2" start="NaN""#, 8, "variable \"p\" has start NaN, expected a number"),
        (r#"max="2" start="1""#, r#"max="NaN" start="1""#, 8, "variable \"p\" has max NaN, expected a number"),
        (r#"start="1" min="0" max="3""#, r#"start="5" min="0" max="3""#, 11, "variable \"n\" has start 5 above max 3"),
        (
            r#"<Real nominal="2""#,
            r#"<Real declaredType="Mass""#,
            10,
            "variable \"y\" has the type \"Mass\", which is not defined",
        ),
        (
            "<Integer start",
            r#"<Integer declaredType="Length" start"#,
            11,
            "variable \"n\" is of type Integer, its type \"Length\" is Real",
        ),
        (r#"nominal="2""#, r#"unit="s""#, 10, "variable \"y\" has the unit \"s\", which is not defined"),
        (
            r#"displayUnit="mm""#,
            r#"displayUnit="km""#,
            8,
            "variable \"p\" has the display unit \"km\", which is not defined",
        ),
        (
            r#"nominal="2""#,
            r#"derivative="9""#,
            10,
            "variable \"y\" is the derivative of variable 9, which does not exist",
        ),
        (
            r#"nominal="2""#,
            r#"derivative="5""#,
            10,
            "variable \"y\" is the derivative of \"n\", which is not a real number",
        ),
        (
            r#"valueReference="2""#,
            r#"valueReference="1""#,
            9,
            "variables \"p\" and \"u\" are set by the host and share the value reference 1",
        ),
        (r#"<Unknown index="5" dependencies=""/>"#, "", 13, "Outputs lacks \"n\""),
        (
            r#"<Unknown index="5" dependencies=""/>"#,
            r#"<Unknown index="5"/><Unknown index="3"/>"#,
            13,
            "Outputs has \"u\", which does not belong there",
        ),
        (
            r#"<Unknown index="5" dependencies=""/>"#,
            r#"<Unknown index="5"/><Unknown index="5"/>"#,
            13,
            "Outputs has \"n\" twice",
        ),
        (
            r#"<Unknown index="5" dependencies=""/>"#,
            r#"<Unknown index="5"/><Unknown index="6"/>"#,
            13,
            "Outputs has variable 6, there are only 5",
        ),
        (
            "</InitialUnknowns>",
            r#"<Unknown index="5"/></InitialUnknowns>"#,
            13,
            "InitialUnknowns has \"n\", which does not belong there",
        ),
        (r#"discrete" initial="exact"><Integer start="1""#, r#"discrete"><Integer"#, 13, "InitialUnknowns lacks \"n\""),
        (
            "</Outputs>",
            r#"</Outputs><Derivatives><Unknown index="4"/></Derivatives>"#,
            13,
            "Derivatives has \"y\", which is not a derivative",
        ),
        (
            r#"dependenciesKind="dependent fixed dependent""#,
            r#"dependenciesKind="dependent""#,
            13,
            "InitialUnknowns: \"y\" has 3 dependencies and 1 dependenciesKind",
        ),
        (r#"dependencies="1 2 3" "#, "", 13, "InitialUnknowns: \"y\" has dependenciesKind, but no dependencies"),
        (
            r#"dependencies="1 3""#,
            r#"dependencies="3 1""#,
            13,
            "Outputs: the dependencies of \"y\" are not in ascending order",
        ),
        (
            r#"dependencies="1 3""#,
            r#"dependencies="1 9""#,
            13,
            "Outputs: \"y\" depends on variable 9, there are only 5",
        ),
    ] {
        let text = GOOD.replacen(good, bad, 1);
        assert_ne!(text, GOOD, "{good}");
        let expected: &[_] = if line == 0 { &[] } else { &[(line, message.to_owned())] };
        assert_eq!(problems(&text), expected, "{good} -> {bad}");
    }
}

const GOOD_3: &str = r#"<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t">
<ModelExchange modelIdentifier="m"/>
<UnitDefinitions><Unit name="m"><DisplayUnit name="mm" factor="1000"/></Unit></UnitDefinitions>
<TypeDefinitions><Float64Type name="Length" unit="m" min="0"/></TypeDefinitions>
<ModelVariables>
<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
<Float64 name="p" valueReference="1" causality="parameter" declaredType="Length" displayUnit="mm" max="2" start="1"/>
<Float64 name="u" valueReference="2" causality="input" start="0"><Dimension valueReference="6"/></Float64>
<Float64 name="y" valueReference="3" causality="output" unit="m"><Dimension valueReference="6"/><Alias name="z" displayUnit="mm"/></Float64>
<Int32 name="n" valueReference="4" causality="output" initial="exact" start="1" min="0" max="3"/>
<Clock name="c" valueReference="5" causality="output" intervalVariability="triggered"/>
<UInt64 name="size" valueReference="6" causality="structuralParameter" start="2"/>
<Boolean name="b" valueReference="7" causality="output" clocks="5"/>
</ModelVariables>
<ModelStructure>
<Output valueReference="3" dependencies="2 0"/><Output valueReference="4" dependencies=""/><Output valueReference="5"/><Output valueReference="7"/>
<InitialUnknown valueReference="3"/><EventIndicator valueReference="3"/>
</ModelStructure>
</fmiModelDescription>"#;

#[test]
fn rules_of_fmi_3_hold() {
    assert_eq!(problems(GOOD_3), []);
    for (good, bad, line, message) in [
        (r#"instantiationToken="t""#, r#"instantiationToken="""#, 1, "the instantiationToken is empty"),
        (
            r#"causality="independent" variability="continuous""#,
            "",
            1,
            "there is no independent variable, expected exactly one",
        ),
        (r#"valueReference="1""#, r#"valueReference="2""#, 8, "variables \"p\" and \"u\" share the value reference 2"),
        (r#"name="z""#, r#"name="p""#, 9, "variable \"p\" has the name of the variable in line 7"),
        (
            r#"name="z" displayUnit="mm""#,
            r#"name="z" displayUnit="km""#,
            9,
            "variable \"y\" has the display unit \"km\", which is not defined",
        ),
        (
            r#"causality="output" intervalVariability"#,
            r#"causality="parameter" intervalVariability"#,
            11,
            "clock \"c\": causality parameter and variability fixed are not allowed",
        ),
        (r#"clocks="5""#, r#"clocks="4""#, 13, "variable \"b\" belongs to clock 4, which is not a clock"),
        (r#"start="0"><Dimension"#, "><Dimension", 8, "variable \"u\" has no start value"),
        (r#"<Output valueReference="5"/>"#, "", 15, "Output lacks \"c\""),
        (r#"<InitialUnknown valueReference="3"/>"#, "", 15, "InitialUnknown lacks \"y\""),
        (
            r#"<InitialUnknown valueReference="3"/>"#,
            r#"<InitialUnknown valueReference="3"/><InitialUnknown valueReference="2"/>"#,
            15,
            "InitialUnknown has \"u\", which does not belong there",
        ),
    ] {
        let text = GOOD_3.replacen(good, bad, 1);
        assert_ne!(text, GOOD_3, "{good}");
        let found = problems(&text);
        assert!(found.contains(&(line, message.to_owned())), "{good} -> {bad}: {found:?}");
    }
}

#[test]
fn structured_names_follow_the_grammar() {
    for name in ["x", "_a1", "arm.joint[2,1].phi", "der(x)", "der(a.b[1],2)", "'odd name'.x", r"'it\'s'"] {
        assert!(is_structured_name(name), "{name}");
    }
    for name in ["", "1x", "a b", "a.", ".a", "a[", "a[x]", "der(x", "''", "'open", "a..b", "m\u{fc}"] {
        assert!(!is_structured_name(name), "{name}");
    }
    let text = GOOD.replace(r#"guid="g""#, r#"guid="g" variableNamingConvention="structured""#);
    assert_eq!(
        problems(&text.replace(r#"name="u""#, r#"name="u 1""#)),
        [(9, "variable \"u 1\" has no structured name".into())]
    );
}
