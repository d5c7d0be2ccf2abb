//! What an FMU says about itself, independent of the FMI version that writes it down.
//!
//! Terms are those of the FMI standard. Variables are referred to by their position in
//! [`ModelDescription::variables`], counted from 0; readers and writers translate.

use super::unit::BaseUnit;

/// Everything in a modelDescription.xml that a host or a validator needs.
///
/// Attributes that neither of them acts on (quantity, relativeQuantity, unbounded, reinit, annotations, source files)
/// are not kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelDescription {
    /// Name of the model.
    pub model_name: String,
    /// FMI 2.0 `guid`: ties the description to the binary.
    pub token: String,
    /// One sentence for people.
    pub description: Option<String>,
    /// Author and organization.
    pub author: Option<String>,
    /// Version of the model.
    pub version: Option<String>,
    /// Copyright.
    pub copyright: Option<String>,
    /// Licence.
    pub license: Option<String>,
    /// Name and version of the program that made the FMU.
    pub generation_tool: Option<String>,
    /// When that was, as written in the file.
    pub generation_date_and_time: Option<String>,
    /// How variable names are built.
    pub naming: NamingConvention,
    /// The co-simulation interface, if it is offered.
    pub co_simulation: Option<CoSimulation>,
    /// The model exchange interface, if it is offered.
    pub model_exchange: Option<Interface>,
    /// Units that variables refer to.
    pub units: Vec<UnitDefinition>,
    /// Types that variables refer to.
    pub types: Vec<TypeDefinition>,
    /// Names and descriptions of log categories.
    pub log_categories: Vec<(String, Option<String>)>,
    /// Suggested experiment.
    pub default_experiment: Option<DefaultExperiment>,
    /// The variables.
    pub variables: Vec<ScalarVariable>,
    /// Which variables depend on which.
    pub structure: ModelStructure,
}

/// How variable names are built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NamingConvention {
    /// Any text without line breaks and tabs.
    #[default]
    Flat,
    /// Hierarchical names such as `arm.joint[2].phi` and `der(x)`.
    Structured,
}

/// What both kinds of interface say about themselves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interface {
    /// Name of the binary and prefix of its functions in source code: a C identifier.
    pub model_identifier: String,
    /// Whether the FMU is only a connection to another program.
    pub needs_execution_tool: bool,
    /// Whether a process may hold one instance only.
    pub only_once_per_process: bool,
    /// Whether the FMU allocates memory by itself instead of through the host.
    pub own_memory_management: bool,
    /// Whether the state can be taken and put back.
    pub get_and_set_state: bool,
    /// Whether a taken state can be turned into bytes.
    pub serialize_state: bool,
    /// Whether directional derivatives are offered.
    pub directional_derivative: bool,
}

/// The co-simulation interface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoSimulation {
    /// What model exchange says as well.
    pub interface: Interface,
    /// Whether communication steps may differ in size.
    pub variable_step_size: bool,
    /// Whether derivatives of inputs are used to interpolate them within a step.
    pub interpolate_inputs: bool,
    /// Highest order of output derivatives.
    pub max_output_derivative_order: u32,
    /// Whether a step may go on while the host does something else.
    pub run_asynchronously: bool,
}

/// A unit and what it is in SI.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitDefinition {
    /// Name, to which variables refer.
    pub name: String,
    /// In SI base units, if that is known.
    pub base: Option<BaseUnit>,
    /// Units a user may prefer to see.
    pub display: Vec<DisplayUnit>,
}

/// A unit for display: `displayed = factor * value + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct DisplayUnit {
    /// Name.
    pub name: String,
    /// Factor.
    pub factor: f64,
    /// Offset.
    pub offset: f64,
}

/// A named type that gives defaults to the variables declared with it.
#[derive(Clone, Debug, PartialEq)]
pub struct TypeDefinition {
    /// Name, to which variables refer.
    pub name: String,
    /// One sentence for people.
    pub description: Option<String>,
    /// The type; its start value is never set.
    pub kind: VariableType,
}

/// Suggested experiment, in the unit of time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DefaultExperiment {
    /// Start time.
    pub start: Option<f64>,
    /// Stop time.
    pub stop: Option<f64>,
    /// Relative tolerance.
    pub tolerance: Option<f64>,
    /// Communication step size.
    pub step_size: Option<f64>,
}

/// One variable.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarVariable {
    /// Name, unique in the FMU.
    pub name: String,
    /// Handle for the get and set functions; unique among variables of a type, up to aliases.
    pub value_reference: u32,
    /// One sentence for people.
    pub description: Option<String>,
    /// What it is to the host.
    pub causality: Causality,
    /// When it changes.
    pub variability: Variability,
    /// How it is initialized; `None` for inputs and the independent variable, where the standard has no such attribute,
    /// and for combinations of causality and variability that the standard does not have.
    pub initial: Option<Initial>,
    /// Name of the [`TypeDefinition`] that gives defaults.
    pub declared_type: Option<String>,
    /// Type with its bounds and start value.
    pub kind: VariableType,
}

/// What a variable is to the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Causality {
    /// Set by the host, not by other FMUs.
    Parameter,
    /// Follows from parameters.
    CalculatedParameter,
    /// Given by other FMUs.
    Input,
    /// Given to other FMUs.
    Output,
    /// Internal.
    #[default]
    Local,
    /// Time.
    Independent,
}

/// When a variable changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Variability {
    /// Never.
    Constant,
    /// Not after initialization.
    Fixed,
    /// When the host changes a parameter.
    Tunable,
    /// At events or communication points.
    Discrete,
    /// At any time.
    Continuous,
}

/// How a variable is initialized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Initial {
    /// With its start value.
    Exact,
    /// By an iteration that begins at the start value.
    Approx,
    /// From other variables.
    Calculated,
}

/// Type of a variable, with bounds and start value.
#[derive(Clone, Debug, PartialEq)]
pub enum VariableType {
    /// Double precision number.
    Real(Real),
    /// 32-bit integer.
    Integer(Integer),
    /// Boolean.
    Boolean {
        /// Start value.
        start: Option<bool>,
    },
    /// Text.
    String {
        /// Start value.
        start: Option<String>,
    },
    /// One of the items of its declared type.
    Enumeration(Integer),
}

/// Attributes of a real variable.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Real {
    /// Unit.
    pub unit: Option<String>,
    /// Unit a user prefers to see.
    pub display_unit: Option<String>,
    /// Smallest value.
    pub min: Option<f64>,
    /// Largest value.
    pub max: Option<f64>,
    /// Typical magnitude.
    pub nominal: Option<f64>,
    /// Start value.
    pub start: Option<f64>,
    /// Position of the variable whose derivative this one is.
    pub derivative: Option<usize>,
}

/// Attributes of an integer or enumeration variable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Integer {
    /// Smallest value.
    pub min: Option<i32>,
    /// Largest value.
    pub max: Option<i32>,
    /// Start value.
    pub start: Option<i32>,
}

/// Which variables depend on which.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelStructure {
    /// Every output, with the inputs, states and the time it depends on while the simulation runs.
    pub outputs: Vec<Unknown>,
    /// Derivatives of states.
    pub derivatives: Vec<Unknown>,
    /// What is computed at initialization, with the variables known then that it depends on.
    pub initial_unknowns: Vec<Unknown>,
}

/// A variable that is computed, and what from.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknown {
    /// Position of the variable.
    pub variable: usize,
    /// Positions of the variables it depends on; `None`: all that are known, empty: none.
    pub dependencies: Option<Vec<usize>>,
    /// How it depends on each of them; `None`: in no particular way.
    pub kinds: Option<Vec<DependencyKind>>,
}

/// How an unknown depends on a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DependencyKind {
    /// In no particular way.
    Dependent,
    /// Times a constant factor.
    Constant,
    /// Times a factor of fixed parameters.
    Fixed,
    /// Times a factor of tunable parameters.
    Tunable,
    /// Times a factor that changes at events.
    Discrete,
}

/// An enumeration whose values have names in the standard.
pub trait Named: Copy + PartialEq + 'static {
    /// Every value beside its name.
    const NAMES: &'static [(Self, &'static str)];

    /// The standard's name.
    fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(value, _)| *value == self).map_or("", |(_, name)| name)
    }

    /// The value of that name.
    fn from_name(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(_, known)| *known == name).map(|(value, _)| *value)
    }
}

impl Named for NamingConvention {
    const NAMES: &'static [(Self, &'static str)] = &[(Self::Flat, "flat"), (Self::Structured, "structured")];
}

impl Named for Causality {
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Parameter, "parameter"),
        (Self::CalculatedParameter, "calculatedParameter"),
        (Self::Input, "input"),
        (Self::Output, "output"),
        (Self::Local, "local"),
        (Self::Independent, "independent"),
    ];
}

impl Named for Variability {
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Constant, "constant"),
        (Self::Fixed, "fixed"),
        (Self::Tunable, "tunable"),
        (Self::Discrete, "discrete"),
        (Self::Continuous, "continuous"),
    ];
}

impl Named for Initial {
    const NAMES: &'static [(Self, &'static str)] =
        &[(Self::Exact, "exact"), (Self::Approx, "approx"), (Self::Calculated, "calculated")];
}

impl Named for DependencyKind {
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Dependent, "dependent"),
        (Self::Constant, "constant"),
        (Self::Fixed, "fixed"),
        (Self::Tunable, "tunable"),
        (Self::Discrete, "discrete"),
    ];
}

impl Initial {
    /// The values of `initial` that a combination of causality and variability allows, the default first; empty if it
    /// allows none. `None` if the combination itself is not allowed (FMI 2.0.4, section 2.2.7, tables of `initial`).
    pub fn allowed(causality: Causality, variability: Variability) -> Option<&'static [Self]> {
        use Causality as C;
        use Variability as V;
        match (causality, variability) {
            (C::Output | C::Local, V::Constant) | (C::Parameter, V::Fixed | V::Tunable) => Some(&[Self::Exact]),
            (C::CalculatedParameter | C::Local, V::Fixed | V::Tunable) => Some(&[Self::Calculated, Self::Approx]),
            (C::Output | C::Local, V::Discrete | V::Continuous) => Some(&[Self::Calculated, Self::Exact, Self::Approx]),
            (C::Input, V::Discrete | V::Continuous) | (C::Independent, V::Continuous) => Some(&[]),
            _ => None,
        }
    }
}

impl VariableType {
    /// The standard's name of the type.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Real(_) => "Real",
            Self::Integer(_) => "Integer",
            Self::Boolean { .. } => "Boolean",
            Self::String { .. } => "String",
            Self::Enumeration(_) => "Enumeration",
        }
    }

    /// Whether there is a start value.
    pub fn has_start(&self) -> bool {
        match self {
            Self::Real(real) => real.start.is_some(),
            Self::Integer(integer) | Self::Enumeration(integer) => integer.start.is_some(),
            Self::Boolean { start } => start.is_some(),
            Self::String { start } => start.is_some(),
        }
    }

    /// The attributes of a real.
    pub fn as_real(&self) -> Option<&Real> {
        match self {
            Self::Real(real) => Some(real),
            _ => None,
        }
    }
}

impl ModelDescription {
    /// The variable of that name.
    pub fn variable(&self, name: &str) -> Option<&ScalarVariable> {
        self.variables.iter().find(|variable| variable.name == name)
    }

    /// The outputs, in the order of the variables.
    pub fn outputs(&self) -> impl Iterator<Item = &ScalarVariable> {
        self.variables.iter().filter(|variable| variable.causality == Causality::Output)
    }

    /// Unit of a variable: its own, or that of its declared type.
    pub fn unit_of<'a>(&'a self, variable: &'a ScalarVariable) -> Option<&'a str> {
        let own = variable.kind.as_real().and_then(|real| real.unit.as_deref());
        own.or_else(|| self.type_of(variable)?.kind.as_real()?.unit.as_deref())
    }

    /// Declared type of a variable.
    pub fn type_of(&self, variable: &ScalarVariable) -> Option<&TypeDefinition> {
        let name = variable.declared_type.as_deref()?;
        self.types.iter().find(|definition| definition.name == name)
    }
}
