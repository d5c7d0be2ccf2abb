//! The description of the FMU that a surrogate becomes.

use super::{
    model_description::{
        Causality, CoSimulation, DefaultExperiment, Initial, Interface, ModelDescription, ModelStructure, Real,
        ScalarVariable, UnitDefinition, Unknown, Variability, VariableType,
    },
    unit::BaseUnit,
};
use metafmu_runtime::{Input, Metadata, Output, Role, Surrogate};

/// Categories of the messages that the library inside every FMU logs.
const LOG_CATEGORIES: [(&str, &str); 3] = [
    ("logStatusError", "calls that fail"),
    ("logStatusWarning", "calls that are carried out with a reservation, or discarded"),
    ("logAll", "everything"),
];

/// Share of its width by which the range of an output seen in training is widened.
const MARGIN: f64 = 0.1;

impl ModelDescription {
    /// Describes the FMU of a surrogate.
    ///
    /// A variable's position is its value reference: input columns, then outputs. Nothing of it depends on when or where
    /// it is called.
    pub fn of_surrogate(surrogate: &Surrogate) -> Self {
        let Metadata { name, description, inputs, outputs, .. } = surrogate.metadata();
        let variables = inputs.iter().map(input_kind).chain(outputs.iter().map(output_kind));
        let variables =
            variables.zip(0..).map(|(variable, value_reference)| ScalarVariable { value_reference, ..variable });
        Self {
            model_name: name.clone(),
            token: surrogate.instantiation_token(),
            description: text(description),
            generation_tool: Some(concat!("metafmu ", env!("CARGO_PKG_VERSION")).into()),
            co_simulation: Some(CoSimulation {
                interface: Interface {
                    model_identifier: model_identifier(name),
                    own_memory_management: true,
                    get_and_set_state: true,
                    serialize_state: true,
                    ..Interface::default()
                },
                variable_step_size: true,
                ..CoSimulation::default()
            }),
            units: units(surrogate.metadata()),
            log_categories: LOG_CATEGORIES.map(|(name, description)| (name.into(), Some(description.into()))).into(),
            default_experiment: Some(default_experiment(surrogate)),
            variables: variables.collect(),
            structure: structure(surrogate),
            ..Self::default()
        }
    }
}

/// A C identifier made of a name: other characters become `_`.
pub fn model_identifier(name: &str) -> String {
    let mut identifier: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !identifier.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
        identifier.insert(0, '_');
    }
    identifier
}

fn input_kind(input: &Input) -> ScalarVariable {
    let (causality, variability, initial) = match input.role {
        Role::Parameter(metafmu_runtime::Variability::Fixed) => {
            (Causality::Parameter, Variability::Fixed, Some(Initial::Exact))
        }
        Role::Parameter(metafmu_runtime::Variability::Tunable) => {
            (Causality::Parameter, Variability::Tunable, Some(Initial::Exact))
        }
        Role::Time => (Causality::Independent, Variability::Continuous, None),
        Role::Input => (Causality::Input, Variability::Continuous, None),
    };
    ScalarVariable {
        name: input.name.clone(),
        value_reference: 0,
        description: text(&input.description),
        causality,
        variability,
        initial,
        declared_type: None,
        kind: VariableType::Real(Real {
            unit: text(&input.unit),
            min: Some(input.min),
            max: Some(input.max),
            nominal: Some(nominal(input.min, input.max)),
            // the independent variable has none
            start: initial.map(|_| input.start),
            ..Real::default()
        }),
    }
}

/// The bounds are those seen in training, widened: a prediction at the edge of the trained domain may pass the extremes
/// of the samples a little, and some hosts warn when a variable leaves its bounds. Past the margin such a warning is
/// right, for then the surrogate is far from anything it was trained on.
fn output_kind(output: &Output) -> ScalarVariable {
    let nominal = nominal(output.min, output.max);
    let width = output.max - output.min;
    let margin = MARGIN * if width > 0.0 { width } else { nominal };
    ScalarVariable {
        name: output.name.clone(),
        value_reference: 0,
        description: text(&output.description),
        causality: Causality::Output,
        variability: Variability::Continuous,
        initial: Some(Initial::Calculated),
        declared_type: None,
        kind: VariableType::Real(Real {
            unit: text(&output.unit),
            min: Some((output.min - margin).max(f64::MIN)),
            max: Some((output.max + margin).min(f64::MAX)),
            nominal: Some(nominal),
            ..Real::default()
        }),
    }
}

/// The power of ten next to the largest magnitude in a range; 1 for a range that is zero.
fn nominal(min: f64, max: f64) -> f64 {
    let largest = min.abs().max(max.abs());
    if largest == 0.0 {
        return 1.0;
    }
    // parsed, because `powi` of a negative exponent is not correctly rounded
    format!("1e{}", largest.log10().round().clamp(-300.0, 300.0)).parse().unwrap_or(1.0)
}

fn text(text: &str) -> Option<String> {
    (!text.is_empty()).then(|| text.to_owned())
}

fn units(metadata: &Metadata) -> Vec<UnitDefinition> {
    let inputs = metadata.inputs.iter().map(|input| &input.unit);
    let mut names: Vec<&String> = inputs.chain(metadata.outputs.iter().map(|output| &output.unit)).collect();
    names.retain(|name| !name.is_empty());
    names.sort_unstable();
    names.dedup();
    let define =
        |name: &String| UnitDefinition { name: name.clone(), base: BaseUnit::parse(name), display: Vec::new() };
    names.into_iter().map(define).collect()
}

fn default_experiment(surrogate: &Surrogate) -> DefaultExperiment {
    let time = surrogate.time_column().map(|column| &surrogate.inputs()[column]);
    DefaultExperiment {
        start: Some(time.map_or(0.0, |time| time.min)),
        stop: time.map(|time| time.max),
        tolerance: None,
        step_size: Some(surrogate.metadata().time_step),
    }
}

/// Every output is computed from every input column. While the simulation runs the standard counts only inputs, states
/// and the time as known, and parameters at initialization as well.
fn structure(surrogate: &Surrogate) -> ModelStructure {
    let inputs = surrogate.inputs().len();
    let unknowns = |dependencies: Vec<usize>| {
        let unknown =
            |output| Unknown { variable: inputs + output, dependencies: Some(dependencies.clone()), kinds: None };
        (0..surrogate.outputs().len()).map(unknown).collect()
    };
    ModelStructure {
        outputs: unknowns(surrogate.time_column().into_iter().collect()),
        derivatives: Vec::new(),
        initial_unknowns: unknowns((0..inputs).collect()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::example;

    #[test]
    fn a_model_identifier_is_a_c_identifier() {
        for (name, identifier) in [
            ("pendulum", "pendulum"),
            ("single-pendulum 2", "single_pendulum_2"),
            ("3d", "_3d"),
            ("", "_"),
            ("µ.x", "__x"),
        ] {
            assert_eq!(model_identifier(name), identifier);
        }
    }

    #[test]
    fn nominals_are_powers_of_ten_and_never_zero() {
        for (min, max, expected) in [
            (0.0, 0.0, 1.0),
            (-2.0, 1.0, 1.0),
            (0.0, 5.0, 10.0),
            (-47.1, 3.0, 100.0),
            (1e-4, 2e-4, 1e-4),
            (0.0, 1e-320, 1e-300),
        ] {
            assert_eq!(nominal(min, max), expected, "{min} {max}");
        }
    }

    #[test]
    fn variables_have_the_causality_and_bounds_of_their_columns() {
        let description = ModelDescription::of_surrogate(&example::surrogate());
        let kinds: Vec<_> = description.variables.iter().map(|v| (v.causality, v.variability, v.initial)).collect();
        let calculated = (Causality::Output, Variability::Continuous, Some(Initial::Calculated));
        assert_eq!(
            kinds,
            [
                (Causality::Parameter, Variability::Tunable, Some(Initial::Exact)),
                (Causality::Parameter, Variability::Fixed, Some(Initial::Exact)),
                (Causality::Independent, Variability::Continuous, None),
                calculated,
                calculated,
            ]
        );
        let references: Vec<_> = description.variables.iter().map(|v| v.value_reference).collect();
        assert_eq!(references, [0, 1, 2, 3, 4]);
        let angle = description.variables[3].kind.as_real().unwrap();
        assert_eq!((angle.min, angle.max, angle.start), (Some(-2.4), Some(2.4), None));
    }
}
