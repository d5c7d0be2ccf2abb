//! Which elements and attributes an FMI 3.0 modelDescription.xml has.
//!
//! Follows the schema files that come with the FMI 3.0 standard (fmi3ModelDescription.xsd and its includes).

use crate::xml::schema::{
    Attribute,
    Content::{Closed, NotEmpty, OpenAttributes},
    INTEGER,
    Occurs::{self, Any, AtLeastOnce, AtMostOnce, Once},
    Rule, UNSIGNED, UNSIGNED_64,
    ValueType::{self, Boolean, Booleans, Hex, Indices, Name, OneOf, Real, Reals, Several, Text, Whole, Wholes},
    may, needs,
};

/// The elements that are variables.
pub const VARIABLES: &[&str] = &[
    "Float32",
    "Float64",
    "Int8",
    "UInt8",
    "Int16",
    "UInt16",
    "Int32",
    "UInt32",
    "Int64",
    "UInt64",
    "Boolean",
    "String",
    "Binary",
    "Enumeration",
    "Clock",
];

const NAMED: &[Attribute] = &[needs("name", Text), may("description", Text)];

const INTERFACE: &[Attribute] = &[
    needs("modelIdentifier", Name),
    may("needsExecutionTool", Boolean),
    may("canBeInstantiatedOnlyOncePerProcess", Boolean),
    may("canGetAndSetFMUState", Boolean),
    may("canSerializeFMUState", Boolean),
    may("providesDirectionalDerivatives", Boolean),
    may("providesAdjointDerivatives", Boolean),
    may("providesPerElementDependencies", Boolean),
];

const VARIABLE: &[Attribute] = &[
    needs("name", Text),
    needs("valueReference", UNSIGNED),
    may("description", Text),
    may(
        "causality",
        OneOf(&["parameter", "calculatedParameter", "input", "output", "local", "independent", "structuralParameter"]),
    ),
    may("variability", OneOf(&["constant", "fixed", "tunable", "discrete", "continuous"])),
    may("canHandleMultipleSetPerTimeInstant", Boolean),
    may("clocks", Indices),
];

const ARRAYABLE: &[Attribute] = &[
    may("intermediateUpdate", Boolean),
    may("previous", UNSIGNED),
    may("initial", OneOf(&["exact", "approx", "calculated"])),
];

const TYPED: &[Attribute] = &[may("declaredType", Text)];

const FLOAT: &[Attribute] = &[
    may("quantity", Text),
    may("unit", Text),
    may("displayUnit", Text),
    may("relativeQuantity", Boolean),
    may("unbounded", Boolean),
    may("min", Real),
    may("max", Real),
    may("nominal", Real),
];

const FLOAT_VARIABLE: &[Attribute] = &[may("start", Reals), may("derivative", UNSIGNED), may("reinit", Boolean)];

const CLOCK: &[Attribute] = &[
    may("canBeDeactivated", Boolean),
    may("priority", UNSIGNED),
    needs("intervalVariability", OneOf(&["constant", "fixed", "tunable", "changing", "countdown", "triggered"])),
    may("intervalDecimal", Real),
    may("shiftDecimal", Real),
    may("supportsFraction", Boolean),
    may("resolution", UNSIGNED_64),
    may("intervalCounter", UNSIGNED_64),
    may("shiftCounter", UNSIGNED_64),
];

const BINARY: &[Attribute] = &[may("mimeType", Text), may("maxSize", UNSIGNED_64)];

const ANNOTATED: &[(u8, &str, Occurs)] = &[(0, "Annotations", AtMostOnce)];
const ARRAY: &[(u8, &str, Occurs)] = &[(0, "Annotations", AtMostOnce), (1, "Dimension", Any), (2, "Alias", Any)];
const ARRAY_OF_TEXTS: &[(u8, &str, Occurs)] =
    &[(0, "Annotations", AtMostOnce), (1, "Dimension", Any), (2, "Start", Any), (3, "Alias", Any)];

/// Bounds of an integer; the reader checks that numbers fit the width of their variable.
const INTEGER_BOUNDS: &[Attribute] = &[may("quantity", Text), may("min", ANY_INTEGER), may("max", ANY_INTEGER)];
const INTEGER_START: &[Attribute] = &[may("start", Wholes(i64::MIN as i128, u64::MAX as i128))];
const ANY_INTEGER: ValueType = Whole(i64::MIN as i128, u64::MAX as i128);

pub const RULES: &[Rule] = &[
    Rule {
        elements: &["fmiModelDescription"],
        attributes: &[&[
            needs("fmiVersion", Text),
            needs("modelName", Text),
            needs("instantiationToken", Text),
            may("description", Text),
            may("author", Text),
            may("version", Text),
            may("copyright", Text),
            may("license", Text),
            may("generationTool", Text),
            may("generationDateAndTime", Text),
            may("variableNamingConvention", OneOf(&["flat", "structured"])),
        ]],
        children: &[
            (0, "ModelExchange", AtMostOnce),
            (1, "CoSimulation", AtMostOnce),
            (2, "ScheduledExecution", AtMostOnce),
            (3, "UnitDefinitions", AtMostOnce),
            (4, "TypeDefinitions", AtMostOnce),
            (5, "LogCategories", AtMostOnce),
            (6, "DefaultExperiment", AtMostOnce),
            (7, "ModelVariables", Once),
            (8, "ModelStructure", Once),
            (9, "Annotations", AtMostOnce),
        ],
        content: Closed,
    },
    Rule {
        elements: &["ModelExchange"],
        attributes: &[
            INTERFACE,
            &[may("needsCompletedIntegratorStep", Boolean), may("providesEvaluateDiscreteStates", Boolean)],
        ],
        children: ANNOTATED,
        content: OpenAttributes,
    },
    Rule {
        elements: &["CoSimulation"],
        attributes: &[
            INTERFACE,
            &[
                may("canHandleVariableCommunicationStepSize", Boolean),
                may("fixedInternalStepSize", Real),
                may("maxOutputDerivativeOrder", UNSIGNED),
                may("recommendedIntermediateInputSmoothness", INTEGER),
                may("providesIntermediateUpdate", Boolean),
                may("mightReturnEarlyFromDoStep", Boolean),
                may("canReturnEarlyAfterIntermediateUpdate", Boolean),
                may("hasEventMode", Boolean),
                may("providesEvaluateDiscreteStates", Boolean),
            ],
        ],
        children: ANNOTATED,
        content: OpenAttributes,
    },
    Rule { elements: &["ScheduledExecution"], attributes: &[INTERFACE], children: ANNOTATED, content: OpenAttributes },
    Rule { elements: &["UnitDefinitions"], attributes: &[], children: &[(0, "Unit", AtLeastOnce)], content: Closed },
    Rule {
        elements: &["Unit"],
        attributes: &[&[needs("name", Text)]],
        children: &[(0, "BaseUnit", AtMostOnce), (1, "DisplayUnit", Any), (2, "Annotations", AtMostOnce)],
        content: Closed,
    },
    Rule {
        elements: &["BaseUnit"],
        attributes: &[&[
            may("kg", INTEGER),
            may("m", INTEGER),
            may("s", INTEGER),
            may("A", INTEGER),
            may("K", INTEGER),
            may("mol", INTEGER),
            may("cd", INTEGER),
            may("rad", INTEGER),
            may("factor", Real),
            may("offset", Real),
        ]],
        children: &[],
        content: Closed,
    },
    Rule {
        elements: &["DisplayUnit"],
        attributes: &[&[needs("name", Text), may("factor", Real), may("offset", Real), may("inverse", Boolean)]],
        children: ANNOTATED,
        content: Closed,
    },
    Rule {
        elements: &["TypeDefinitions"],
        attributes: &[],
        children: &[
            (0, "Float32Type", Any),
            (0, "Float64Type", Any),
            (0, "Int8Type", Any),
            (0, "UInt8Type", Any),
            (0, "Int16Type", Any),
            (0, "UInt16Type", Any),
            (0, "Int32Type", Any),
            (0, "UInt32Type", Any),
            (0, "Int64Type", Any),
            (0, "UInt64Type", Any),
            (0, "BooleanType", Any),
            (0, "StringType", Any),
            (0, "BinaryType", Any),
            (0, "EnumerationType", Any),
            (0, "ClockType", Any),
        ],
        content: NotEmpty,
    },
    Rule {
        elements: &["Float32Type", "Float64Type"],
        attributes: &[NAMED, FLOAT],
        children: ANNOTATED,
        content: Closed,
    },
    Rule {
        elements: &[
            "Int8Type",
            "UInt8Type",
            "Int16Type",
            "UInt16Type",
            "Int32Type",
            "UInt32Type",
            "Int64Type",
            "UInt64Type",
        ],
        attributes: &[NAMED, INTEGER_BOUNDS],
        children: ANNOTATED,
        content: Closed,
    },
    Rule { elements: &["BooleanType", "StringType"], attributes: &[NAMED], children: ANNOTATED, content: Closed },
    Rule { elements: &["BinaryType"], attributes: &[NAMED, BINARY], children: ANNOTATED, content: Closed },
    Rule {
        elements: &["EnumerationType"],
        attributes: &[NAMED, INTEGER_BOUNDS],
        children: &[(0, "Annotations", AtMostOnce), (1, "Item", AtLeastOnce)],
        content: Closed,
    },
    Rule {
        elements: &["Item"],
        attributes: &[NAMED, &[needs("value", Whole(i64::MIN as i128, i64::MAX as i128))]],
        children: ANNOTATED,
        content: Closed,
    },
    Rule { elements: &["ClockType"], attributes: &[NAMED, CLOCK], children: ANNOTATED, content: Closed },
    Rule { elements: &["LogCategories"], attributes: &[], children: &[(0, "Category", AtLeastOnce)], content: Closed },
    Rule { elements: &["Category"], attributes: &[NAMED], children: ANNOTATED, content: Closed },
    Rule {
        elements: &["DefaultExperiment"],
        attributes: &[&[may("startTime", Real), may("stopTime", Real), may("tolerance", Real), may("stepSize", Real)]],
        children: ANNOTATED,
        content: Closed,
    },
    Rule {
        elements: &["ModelVariables"],
        attributes: &[],
        children: &[
            (0, "Float32", Any),
            (0, "Float64", Any),
            (0, "Int8", Any),
            (0, "UInt8", Any),
            (0, "Int16", Any),
            (0, "UInt16", Any),
            (0, "Int32", Any),
            (0, "UInt32", Any),
            (0, "Int64", Any),
            (0, "UInt64", Any),
            (0, "Boolean", Any),
            (0, "String", Any),
            (0, "Binary", Any),
            (0, "Enumeration", Any),
            (0, "Clock", Any),
        ],
        content: NotEmpty,
    },
    Rule {
        elements: &["Float32", "Float64"],
        attributes: &[VARIABLE, ARRAYABLE, TYPED, FLOAT, FLOAT_VARIABLE],
        children: ARRAY,
        content: Closed,
    },
    Rule {
        elements: &["Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64"],
        attributes: &[VARIABLE, ARRAYABLE, TYPED, INTEGER_BOUNDS, INTEGER_START],
        children: ARRAY,
        content: Closed,
    },
    Rule {
        elements: &["Enumeration"],
        attributes: &[VARIABLE, ARRAYABLE, &[needs("declaredType", Text)], INTEGER_BOUNDS, INTEGER_START],
        children: ARRAY,
        content: Closed,
    },
    Rule {
        elements: &["Boolean"],
        attributes: &[VARIABLE, ARRAYABLE, TYPED, &[may("start", Booleans)]],
        children: ARRAY,
        content: Closed,
    },
    Rule {
        elements: &["String"],
        attributes: &[VARIABLE, ARRAYABLE, TYPED],
        children: ARRAY_OF_TEXTS,
        content: Closed,
    },
    Rule {
        elements: &["Binary"],
        attributes: &[VARIABLE, ARRAYABLE, TYPED, BINARY],
        children: ARRAY_OF_TEXTS,
        content: Closed,
    },
    Rule {
        elements: &["Clock"],
        attributes: &[VARIABLE, TYPED, CLOCK],
        children: &[(0, "Annotations", AtMostOnce), (1, "Alias", Any)],
        content: Closed,
    },
    Rule { elements: &["String/Start"], attributes: &[&[may("value", Text)]], children: &[], content: Closed },
    Rule { elements: &["Binary/Start"], attributes: &[&[may("value", Hex)]], children: &[], content: Closed },
    Rule {
        elements: &["Dimension"],
        attributes: &[&[may("start", UNSIGNED_64), may("valueReference", UNSIGNED)]],
        children: &[],
        content: Closed,
    },
    Rule { elements: &["Alias"], attributes: &[NAMED, &[may("displayUnit", Text)]], children: &[], content: Closed },
    Rule {
        elements: &["ModelStructure"],
        attributes: &[],
        children: &[
            (0, "Output", Any),
            (1, "ContinuousStateDerivative", Any),
            (2, "ClockedState", Any),
            (3, "InitialUnknown", Any),
            (4, "EventIndicator", Any),
        ],
        content: Closed,
    },
    Rule {
        elements: &["Output", "ContinuousStateDerivative", "ClockedState", "InitialUnknown", "EventIndicator"],
        attributes: &[&[
            needs("valueReference", UNSIGNED),
            may("dependencies", Indices),
            may("dependenciesKind", Several(&["dependent", "constant", "fixed", "tunable", "discrete"])),
        ]],
        children: ANNOTATED,
        content: Closed,
    },
];
