//! The description of the FMU that a surrogate becomes.

use super::structure::structure;
use crate::{
    diagnostics::numbers::power,
    fmi::{
        identifier::model_identifier,
        model_description::{
            Causality, CoSimulation, DefaultExperiment, Dimension, FmiVersion, Initial, Integer, InterfaceCapabilities,
            ModelDescription, ModelExchange, NamingConvention, RealAttributes, ScalarVariable, UnitDefinition,
            Variability, VariableType, Width,
        },
    },
    study::{ExportOptions, FmuInterface, FmuPort},
    surrogate::input_description,
    unit::BaseUnit,
};
use metafmu_runtime::{
    BuiltIn, DomainPolicy, Encoding, Integration, Known, MAX_OUTPUT_DERIVATIVE_ORDER, Metadata, Output, OutputArray,
    Quantity, Role, State, Surrogate, Variable,
};

/// Name of the tool in the descriptions of its FMUs, followed by its version.
const GENERATION_TOOL: &str = "metafmu ";

/// Categories of the messages that the library inside every FMU logs.
const LOG_CATEGORIES: [(&str, &str); 3] = [
    ("logStatusError", "calls that fail; always logged"),
    ("logStatusWarning", "calls that are carried out with a reservation, or discarded"),
    ("logAll", "everything"),
];

/// Describes the FMU of a surrogate, with the variables of [`Surrogate::variables`] that the interface shows. It does not depend on
/// the time or the path of the call.
pub fn describe(surrogate: &Surrogate, fmi_version: FmiVersion, about: &ExportOptions) -> ModelDescription {
    let Metadata { name, description, .. } = surrogate.metadata();
    let shown = ShownInterface { surrogate, fmi_version, about };
    let table: Vec<(u32, &Variable)> = shown.table().collect();
    let variables: Vec<ScalarVariable> =
        table.iter().map(|(reference, variable)| shown.variable(*reference, variable)).collect();
    let v3 = fmi_version == FmiVersion::V3;
    let is_discrete = surrogate.program().sampling().is_some();
    // between the steps of the solver
    let updates = v3 && !surrogate.states().is_empty();
    let interface = InterfaceCapabilities {
        model_identifier: model_identifier(name),
        own_memory_management: true,
        get_and_set_state: true,
        serialize_state: true,
        directional_derivative: true,
        adjoint_derivative: v3,
        ..InterfaceCapabilities::default()
    };
    ModelDescription {
        fmi_version,
        model_name: name.clone(),
        token: surrogate.instantiation_token(),
        description: text(&(description.clone() + &of_fixed_steps(surrogate))),
        generation_tool: Some(GENERATION_TOOL.to_owned() + env!("CARGO_PKG_VERSION")),
        // what a solver tries is not warned of, only what it accepts
        // samples would be time events there
        model_exchange: (!is_discrete)
            .then(|| ModelExchange { interface: interface.clone(), needs_completed_integrator_step: true }),
        co_simulation: Some(CoSimulation {
            interface,
            variable_step_size: true,
            // outputs are linear between samples, with kinks there
            max_output_derivative_order: if is_discrete { 0 } else { MAX_OUTPUT_DERIVATIVE_ORDER },
            interpolate_inputs: !v3,
            event_mode: v3,
            intermediate_update: updates,
            return_early_after_intermediate_update: updates,
            ..CoSimulation::default()
        }),
        units: units(surrogate.metadata()),
        // names of mechanisms and `der(NAME)` are hierarchical; those of a study may be any text
        naming: if surrogate.states().is_empty() { NamingConvention::Flat } else { naming(&variables) },
        log_categories: LOG_CATEGORIES.map(|(name, description)| (name.into(), Some(description.into()))).into(),
        default_experiment: Some(default_experiment(surrogate)),
        variables,
        structure: structure(&table, surrogate, about, fmi_version),
        author: about.author.clone(),
        copyright: about.copyright.clone(),
        license: about.license.clone(),
        ..ModelDescription::default()
    }
}

/// Naming convention of the variables: structured if all names have the hierarchical form.
fn naming(variables: &[ScalarVariable]) -> NamingConvention {
    match variables.iter().all(|variable| is_structured(&variable.name)) {
        true => NamingConvention::Structured,
        false => NamingConvention::Flat,
    }
}

/// Returns true if a name is one of parts with dots between them, or the derivative of such a name.
fn is_structured(name: &str) -> bool {
    let inner = name.strip_prefix("der(").and_then(|name| name.strip_suffix(')')).unwrap_or(name);
    inner.split('.').all(|part| {
        part.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
            && part.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
    })
}

/// Returns true if metafmu made the FMU, by its description.
pub fn is_own(description: &ModelDescription) -> bool {
    description.generation_tool.as_deref().is_some_and(|tool| tool.starts_with(GENERATION_TOOL))
}

/// Local variables of an FMU that metafmu added to those of its study: they are recorded beside the outputs.
pub fn added_variables(description: &ModelDescription) -> Vec<String> {
    if !is_own(description) {
        return Vec::new();
    }
    let of_domain = [BuiltIn::InDomain, BuiltIn::DomainDistance].map(|variable| variable.name().to_owned());
    let bounds = description.outputs().map(|output| Output::bound_name(&output.name));
    of_domain.into_iter().chain(bounds).filter(|name| is_local(description, name)).collect()
}

/// Returns true if the description has a local variable of this name.
fn is_local(description: &ModelDescription, name: &str) -> bool {
    description.variable(name).is_some_and(|variable| variable.causality == Causality::Local)
}

/// The variables that hosts see. The library inside has all variables; a host knows those of the description.
struct ShownInterface<'a> {
    surrogate: &'a Surrogate,
    fmi_version: FmiVersion,
    about: &'a ExportOptions,
}

impl ShownInterface<'_> {
    fn is_port(&self, port: FmuPort) -> bool {
        self.about.ports.contains(&port)
    }

    /// Returns true if hosts see a variable.
    fn shows(&self, variable: &Variable) -> bool {
        let is_plain = self.about.interface == FmuInterface::Plain;
        let is_wanted = match variable.quantity {
            Quantity::BuiltIn(BuiltIn::UseMeasured) | Quantity::Measured(_) => self.is_port(FmuPort::Measured),
            Quantity::BuiltIn(BuiltIn::DomainPolicy | BuiltIn::InDomain | BuiltIn::DomainDistance)
            | Quantity::Bound(_) => !is_plain,
            Quantity::BuiltIn(BuiltIn::Time)
            | Quantity::Input(_)
            | Quantity::Output(_)
            | Quantity::State(_)
            | Quantity::Derivative(_)
            | Quantity::Array(_) => true,
        };
        is_wanted && (self.fmi_version == FmiVersion::V3 || !variable.only_fmi3)
    }

    /// The variables that hosts see, with their value references.
    fn table(&self) -> impl Iterator<Item = (u32, &Variable)> {
        self.surrogate.variables().iter().filter(|(_, variable)| self.shows(variable))
    }

    fn variable(&self, value_reference: u32, variable: &Variable) -> ScalarVariable {
        let surrogate = self.surrogate;
        let DescribedVariable { description, what: (causality, variability, initial), kind, dimensions } =
            match variable.quantity {
                Quantity::Input(index) => input(surrogate, index),
                Quantity::Output(index) => output(&surrogate.outputs()[index]),
                Quantity::State(index) => state(&surrogate.states()[index]),
                Quantity::Derivative(index) => self.rate(index),
                Quantity::BuiltIn(variable) => built_in(variable, surrogate, self.added(FmuPort::Domain)),
                Quantity::Array(index) => array(surrogate, index),
                Quantity::Bound(index) => bound(surrogate, index, self.added(FmuPort::Bounds)),
                Quantity::Measured(index) => measured(&surrogate.outputs()[index]),
            };
        // "only continuous-time variables can have intermediateUpdate = true"
        let is_updated = variability == Variability::Continuous && causality != Causality::Independent;
        ScalarVariable {
            name: self.name(variable),
            value_reference,
            description: text(&description),
            causality,
            variability,
            initial,
            declared_type: None,
            kind,
            dimensions,
            clocks: Vec::new(),
            intermediate_update: is_updated && self.fmi_version == FmiVersion::V3 && !surrogate.states().is_empty(),
            aliases: Vec::new(),
        }
    }

    /// Causality of what metafmu adds: a local variable is shown by every host and is a port in none.
    fn added(&self, port: FmuPort) -> Causality {
        if self.is_port(port) { Causality::Output } else { Causality::Local }
    }

    /// The other names are those of the surrogate, which has flat names itself.
    fn name(&self, variable: &Variable) -> String {
        match variable.quantity {
            Quantity::Derivative(_) => self.about.names.of(&variable.name),
            _ => variable.name.clone(),
        }
    }

    fn rate(&self, index: usize) -> DescribedVariable {
        let State { name, rate_unit, nominal, .. } = &self.surrogate.states()[index];
        let derivative = self.table().position(|(_, variable)| variable.quantity == Quantity::State(index));
        let real =
            RealAttributes { unit: text(rate_unit), nominal: Some(*nominal), derivative, ..RealAttributes::default() };
        let what = (Causality::Local, Variability::Continuous, Some(Initial::Calculated));
        DescribedVariable::scalar(&format!("derivative of {name}"), what, VariableType::Real(real))
    }
}

/// A variable in a description, without its name and value reference.
struct DescribedVariable {
    description: String,
    what: (Causality, Variability, Option<Initial>),
    kind: VariableType,
    dimensions: Vec<Dimension>,
}

impl DescribedVariable {
    fn scalar(description: &str, what: (Causality, Variability, Option<Initial>), kind: VariableType) -> Self {
        Self { description: description.into(), what, kind, dimensions: Vec::new() }
    }
}

/// An input has no `initial`: FMI 2.0 forbids it, and FMI 3.0 has "exact" as the only value, which some hosts refuse.
fn input(surrogate: &Surrogate, index: usize) -> DescribedVariable {
    let input = &surrogate.inputs()[index];
    let what = match input.role {
        Role::Parameter(metafmu_runtime::Tunability::Fixed) | Role::Start => {
            (Causality::Parameter, Variability::Fixed, Some(Initial::Exact))
        }
        Role::Parameter(metafmu_runtime::Tunability::Tunable) => {
            (Causality::Parameter, Variability::Tunable, Some(Initial::Exact))
        }
        Role::Input => (Causality::Input, Variability::Continuous, None),
        Role::Time => (Causality::Independent, Variability::Continuous, None),
    };
    // every number is valid for a periodic input, and a state has separate limits; hosts may refuse or warn at limits
    let is_limited = input.encoding != Encoding::Periodic && input.role != Role::Start;
    let real = RealAttributes {
        unit: text(&input.unit),
        min: is_limited.then_some(input.min),
        max: is_limited.then_some(input.max),
        nominal: Some(nominal(input.min, input.max)),
        // the independent variable has none
        start: (input.role != Role::Time).then_some(input.start),
        ..RealAttributes::default()
    };
    DescribedVariable::scalar(&input_description(input, surrogate), what, VariableType::Real(real))
}

/// Its value at the start is a parameter, so it is calculated.
fn state(state: &State) -> DescribedVariable {
    let real = RealAttributes {
        unit: text(&state.unit),
        min: state.range.map(|[min, _]| min),
        max: state.range.map(|[_, max]| max),
        nominal: Some(state.nominal),
        ..RealAttributes::default()
    };
    let what = (Causality::Local, Variability::Continuous, Some(Initial::Calculated));
    DescribedVariable::scalar(&state.description, what, VariableType::Real(real))
}

/// Outputs under one name, in addition to their own.
fn array(surrogate: &Surrogate, index: usize) -> DescribedVariable {
    let OutputArray { description, .. } = &surrogate.arrays()[index];
    let (unit, columns) = surrogate.array_elements(index);
    let elements = columns.iter().map(|&column| &surrogate.outputs()[column]);
    let largest = elements.map(|output| nominal(output.min, output.max)).fold(0.0, f64::max);
    let real = RealAttributes { unit: text(unit), nominal: Some(largest), ..RealAttributes::default() };
    let what = (Causality::Output, Variability::Continuous, Some(Initial::Calculated));
    let dimensions = vec![Dimension::Fixed(columns.len() as u64)];
    DescribedVariable { dimensions, ..DescribedVariable::scalar(description, what, VariableType::Real(real)) }
}

/// A constant, or of a model with a state what grows with the time.
fn bound(surrogate: &Surrogate, index: usize, causality: Causality) -> DescribedVariable {
    let output = &surrogate.outputs()[index];
    let bounds = surrogate.bounds();
    let (half_width, coverage) = bounds.map_or((0.0, 0.0), |bounds| (bounds.largest(index), bounds.coverage));
    let last = bounds.and_then(|bounds| bounds.times.last());
    let until = last.map_or(String::new(), |last| format!(", up to {last} s after its start"));
    let is_of_runs = surrogate.program().has_memory() || surrogate.time_column().is_some();
    let of_run = if is_of_runs { " of a run" } else { "" };
    let description = format!(
        "error bound of {}: expected to hold for {} % of the points{of_run} inside the ranges{until}",
        output.name,
        100.0 * coverage
    );
    let is_constant = last.is_none() && causality == Causality::Output;
    let start = is_constant.then_some(half_width);
    let real = RealAttributes {
        unit: text(&output.unit),
        nominal: Some(nominal(0.0, half_width)),
        start,
        ..RealAttributes::default()
    };
    let what = match last {
        Some(_) => (causality, Variability::Continuous, Some(Initial::Calculated)),
        None if is_constant => (causality, Variability::Constant, Some(Initial::Exact)),
        // some hosts set everything that has a start value, and outputs are never fixed
        None => (causality, Variability::Fixed, Some(Initial::Calculated)),
    };
    DescribedVariable::scalar(&description, what, VariableType::Real(real))
}

/// Input without limits: measured values may be anything, and are not clamped.
fn measured(output: &Output) -> DescribedVariable {
    let real = RealAttributes {
        unit: text(&output.unit),
        nominal: Some(nominal(output.min, output.max)),
        start: Some(0.0),
        ..RealAttributes::default()
    };
    let description = format!("measured {}, used while {} is true", output.name, BuiltIn::UseMeasured.name());
    let what = (Causality::Input, Variability::Continuous, None);
    DescribedVariable::scalar(&description, what, VariableType::Real(real))
}

/// `of_domain`: causality of the variables of the domain.
fn built_in(variable: BuiltIn, surrogate: &Surrogate, of_domain: Causality) -> DescribedVariable {
    let calculated = Some(Initial::Calculated);
    let (what, kind) = match variable {
        BuiltIn::DomainPolicy => {
            let [start, min, max] = [DomainPolicy::default(), DomainPolicy::Warn, DomainPolicy::Error]
                .map(|policy| Some((policy as i32).into()));
            let integer = Integer { width: Width::Int32, min, max, start };
            ((Causality::Parameter, Variability::Tunable, Some(Initial::Exact)), VariableType::Integer(integer))
        }
        BuiltIn::InDomain => ((of_domain, Variability::Discrete, calculated), VariableType::Boolean { start: None }),
        BuiltIn::DomainDistance => {
            let real = RealAttributes { min: Some(0.0), nominal: Some(1.0), ..RealAttributes::default() };
            ((of_domain, Variability::Continuous, calculated), VariableType::Real(real))
        }
        BuiltIn::Time => {
            let real = RealAttributes { unit: Some("s".into()), ..RealAttributes::default() };
            ((Causality::Independent, Variability::Continuous, None), VariableType::Real(real))
        }
        BuiltIn::UseMeasured => {
            ((Causality::Input, Variability::Discrete, None), VariableType::Boolean { start: Some(false) })
        }
    };
    DescribedVariable::scalar(variable.description(known(surrogate)), what, kind)
}

/// Properties of a surrogate that the descriptions of built-in variables depend on.
pub(super) fn known(surrogate: &Surrogate) -> Known {
    let fed_back = surrogate.program().sampling().is_some_and(|sampling| sampling.support.is_some());
    Known { time: surrogate.time_column().is_some(), data: surrogate.metadata().cover.is_some(), fed_back }
}

/// An output has no limits: FMI lets an FMU exceed declared ones by rounding only, and predictions may exceed the
/// training data. The model card has them.
fn output(output: &Output) -> DescribedVariable {
    let real = RealAttributes {
        unit: text(&output.unit),
        nominal: Some(nominal(output.min, output.max)),
        ..RealAttributes::default()
    };
    let what = (Causality::Output, Variability::Continuous, Some(Initial::Calculated));
    DescribedVariable::scalar(&output.description, what, VariableType::Real(real))
}

/// The power of ten next to the largest magnitude in a range; 1 for a range that is zero.
pub(super) fn nominal(min: f64, max: f64) -> f64 {
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
    let states = metadata.states.iter().flat_map(|state| [&state.unit, &state.rate_unit]);
    let mut names: Vec<&String> =
        inputs.chain(metadata.outputs.iter().map(|output| &output.unit)).chain(states).collect();
    let second = "s".to_owned();
    if metadata.inputs.iter().all(|input| input.role != Role::Time) {
        names.push(&second);
    }
    names.retain(|name| !name.is_empty());
    names.sort_unstable();
    names.dedup();
    let define =
        |name: &String| UnitDefinition { name: name.clone(), base: BaseUnit::parse(name), display: Vec::new() };
    names.into_iter().map(define).collect()
}

/// Text on a solver with fixed steps, which does not control its error.
fn of_fixed_steps(surrogate: &Surrogate) -> String {
    match (surrogate.program().integration(), surrogate.metadata().solver_error) {
        (Some(Integration::Fixed { step }), Some(error)) => {
            let error = power(error, 1);
            format!(
                " (solver: fixed steps of {step} s, in the domain like an initial state perturbed by at most {error})"
            )
        }
        _ => String::new(),
    }
}

/// Tolerance that hosts expect of a description, and pass to their solvers. Solvers of several steps give up at much tighter ones if inputs jump. The
/// solver inside the FMU is not loosened by it.
const USUAL_TOLERANCE: f64 = 1e-6;

fn default_experiment(surrogate: &Surrogate) -> DefaultExperiment {
    let time = surrogate.time_column().map(|column| &surrogate.inputs()[column]);
    DefaultExperiment {
        start: Some(time.map_or(0.0, |time| time.min)),
        stop: time.map(|time| time.max).or(surrogate.metadata().stop_time),
        tolerance: surrogate
            .program()
            .integration()
            .and_then(Integration::tolerance)
            .map(|own| own.max(USUAL_TOLERANCE)),
        step_size: Some(surrogate.metadata().time_step),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{fmi::xml, study::NameStyle, surrogate::with_names};
    use metafmu_example as example;
    use metafmu_runtime::Bounds;

    #[test]
    fn the_descriptions_of_a_surrogate_are_the_golden_ones() {
        for (version, file) in
            [(FmiVersion::V2, "modelDescription-fmi2.xml"), (FmiVersion::V3, "modelDescription-fmi3.xml")]
        {
            let path = format!("{}/../../tests/data/{file}", env!("CARGO_MANIFEST_DIR"));
            let description = describe(&example::with_input(), version, &ExportOptions::default());
            // the version changes with every release
            let text = xml::write(&description).replace(env!("CARGO_PKG_VERSION"), "x.y.z");
            if std::env::var_os("UPDATE_GOLDEN").is_some() {
                std::fs::write(&path, &text).unwrap();
            }
            assert_eq!(text, std::fs::read_to_string(&path).unwrap(), "UPDATE_GOLDEN=1 rewrites {path}");
            assert_eq!(xml::read(text.as_bytes()).unwrap().problems, []);
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
        let description = describe(&example::surrogate(), FmiVersion::V2, &ExportOptions::default());
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
                (Causality::Parameter, Variability::Tunable, Some(Initial::Exact)),
                (Causality::Local, Variability::Discrete, Some(Initial::Calculated)),
                (Causality::Local, Variability::Continuous, Some(Initial::Calculated)),
            ]
        );
        let references: Vec<_> = description.variables.iter().map(|v| v.value_reference).collect();
        assert_eq!(references, [1, 2, 3, 4, 5, 6, 7, 8]);
        let angle = description.variables[3].kind.as_real().unwrap();
        assert_eq!((angle.min, angle.max, angle.start), (None, None, None), "those of training are no limits");
        let length = description.variables[0].kind.as_real().unwrap();
        assert_eq!((length.min, length.max), (Some(0.1), Some(0.2)));
    }

    #[test]
    fn a_nominal_parameter_tells_its_values_and_a_periodic_one_has_no_limits() {
        let surrogate = example::encoded(&example::surrogate());
        let description = describe(&surrogate, FmiVersion::V3, &ExportOptions::default());
        let [length, speed] = [0, 1].map(|index| &description.variables[index]);
        let real = |variable: &ScalarVariable| {
            let real = variable.kind.as_real().unwrap();
            (real.min, real.max, real.start)
        };
        let says = "example input length (one of 0.14, 0.1, 0.2; constant in each training run: after a change outputs \
                    are as if it had been so from the start)";
        assert_eq!(length.description.as_deref(), Some(says));
        assert_eq!(real(length), (Some(0.1), Some(0.2), Some(0.14)));
        let says = "example input speed (any number: values that differ by 5 are the same)";
        assert_eq!((speed.description.as_deref(), real(speed)), (Some(says), (None, None, Some(2.5))));
    }

    #[test]
    fn a_surrogate_without_time_has_an_independent_variable_in_fmi_3_only() {
        let surrogate = example::surrogate();
        let mut metadata = surrogate.metadata().clone();
        metadata.inputs[2].role = Role::Input;
        metadata.inputs[2].name = "force".into();
        let surrogate = Surrogate::new(metadata, surrogate.program().clone()).unwrap();
        let independent = |version| {
            let description = describe(&surrogate, version, &ExportOptions::default());
            description.variables.into_iter().find(|v| v.causality == Causality::Independent)
        };
        assert_eq!(independent(FmiVersion::V2), None);
        assert_eq!(independent(FmiVersion::V3).map(|time| (time.name, time.value_reference)), Some(("time".into(), 9)));
    }

    /// Names of the variables with this causality.
    fn named(description: &ModelDescription, causality: Causality) -> Vec<&str> {
        let variables = description.variables.iter().filter(|variable| variable.causality == causality);
        variables.map(|variable| variable.name.as_str()).collect()
    }

    fn described(surrogate: &Surrogate, interface: FmuInterface, ports: &[FmuPort]) -> ModelDescription {
        let about = ExportOptions { interface, ports: ports.into(), ..ExportOptions::default() };
        describe(surrogate, FmiVersion::V2, &about)
    }

    #[test]
    fn what_metafmu_adds_is_local_unless_it_is_exported_as_ports() {
        let bounds = Bounds { coverage: 0.9, runs: 20, times: Vec::new(), half_widths: vec![0.1, 0.2] };
        let bounded = example::surrogate().with_bounds(bounds).unwrap();
        let usual = described(&bounded, FmuInterface::Study, &[]);
        assert_eq!(named(&usual, Causality::Output), ["angle", "velocity"]);
        assert_eq!(named(&usual, Causality::Local), ["in_domain", "domain_distance", "angle_bound", "velocity_bound"]);
        assert_eq!((usual.structure.outputs.len(), usual.structure.initial_unknowns.len()), (2, 2));
        assert_eq!(added_variables(&usual), named(&usual, Causality::Local), "recorded beside the outputs");

        let wired = described(&bounded, FmuInterface::Study, &[FmuPort::Domain, FmuPort::Bounds]);
        let all = ["angle", "velocity", "in_domain", "domain_distance", "angle_bound", "velocity_bound"];
        assert_eq!(named(&wired, Causality::Output), all);
        assert_eq!((wired.structure.outputs.len(), wired.structure.initial_unknowns.len()), (6, 4));
    }

    #[test]
    fn measured_outputs_are_inputs_only_where_someone_wires_them() {
        let surrogate = example::recorded();
        let usual = described(&surrogate, FmuInterface::Study, &[]);
        assert_eq!(named(&usual, Causality::Input), ["force"]);
        assert_eq!(usual.variable("use_measured"), None);
        let wired = described(&surrogate, FmuInterface::Study, &[FmuPort::Measured]);
        assert_eq!(named(&wired, Causality::Input), ["force", "use_measured", "position_measured"]);
    }

    #[test]
    fn a_plain_interface_has_the_variables_of_the_study_alone() {
        let plain = described(&example::surrogate(), FmuInterface::Plain, &[]);
        let names: Vec<&str> = plain.variables.iter().map(|variable| variable.name.as_str()).collect();
        assert_eq!(names, ["length", "speed", "time", "angle", "velocity"]);
        assert!(plain.variables.iter().all(|variable| variable.kind.as_real().is_some()));
        assert!(added_variables(&plain).is_empty());
    }

    #[test]
    fn derivatives_have_flat_names_where_the_others_do() {
        let about = ExportOptions { names: NameStyle::Flat, ..ExportOptions::default() };
        let flat = with_names(&example::crane(), about.names).unwrap();
        let description = describe(&flat, FmiVersion::V2, &about);
        assert!(description.variables.iter().all(|variable| !variable.name.contains(['(', ')', '.', '['])));
        assert!(description.variables.iter().any(|variable| variable.name.starts_with("der_")));
    }
}
