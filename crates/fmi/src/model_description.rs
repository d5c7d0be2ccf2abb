//! An FMU's description of itself, independent of the FMI version in which it is written.
//!
//! Terms are those of the FMI standard. Variables are referred to by their position in
//! [`ModelDescription::variables`], counted from 0; readers and writers translate.

use crate::unit::BaseUnit;
use std::fmt;

/// Everything in a modelDescription.xml that a host or a validator needs.
///
/// Attributes that neither of them acts on (quantity, relativeQuantity, unbounded, reinit, annotations, source files)
/// are not kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelDescription {
    /// Version of the standard.
    pub fmi_version: FmiVersion,
    /// Name of the model.
    pub model_name: String,
    /// `guid` of FMI 2.0, `instantiationToken` of FMI 3.0: ties the description to the binary.
    pub token: String,
    /// One sentence for people.
    pub description: Option<String>,
    /// Author and organization.
    pub author: Option<String>,
    /// Version of the model.
    pub version: Option<String>,
    /// Copyright.
    pub copyright: Option<String>,
    /// License.
    pub license: Option<String>,
    /// Name and version of the program that made the FMU.
    pub generation_tool: Option<String>,
    /// When that was, as written in the file.
    pub generation_date_and_time: Option<String>,
    /// Convention of variable names.
    pub naming: NamingConvention,
    /// The co-simulation interface, if it is offered.
    pub co_simulation: Option<CoSimulation>,
    /// The model exchange interface, if it is offered.
    pub model_exchange: Option<ModelExchange>,
    /// The scheduled execution interface of FMI 3.0, if it is offered.
    pub scheduled_execution: Option<InterfaceCapabilities>,
    /// Units that variables refer to.
    pub units: Vec<UnitDefinition>,
    /// Types that variables refer to.
    pub types: Vec<TypeDefinition>,
    /// Names and descriptions of log categories.
    pub log_categories: Vec<(String, Option<String>)>,
    /// Suggested experiment.
    pub default_experiment: Option<DefaultExperiment>,
    /// Number of event indicators.
    pub event_indicators: usize,
    /// The variables.
    pub variables: Vec<ScalarVariable>,
    /// Which variables depend on which.
    pub structure: ModelStructure,
}

/// Version of the standard.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FmiVersion {
    /// FMI 2.0 and its maintenance releases.
    #[default]
    V2,
    /// FMI 3.0 and its maintenance releases.
    V3,
}

impl FmiVersion {
    /// Both.
    pub const ALL: [Self; 2] = [Self::V2, Self::V3];
}

/// Convention of variable names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NamingConvention {
    /// Any text without line breaks and tabs.
    #[default]
    Flat,
    /// Hierarchical names such as `arm.joint[2].phi` and `der(x)`.
    Structured,
}

/// Capabilities that every type of interface has.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InterfaceCapabilities {
    /// Name of the binary and prefix of its functions in source code: a C identifier.
    pub model_identifier: String,
    /// `true` if the FMU is only a connection to another program.
    pub needs_execution_tool: bool,
    /// `true` if a process may hold one instance only.
    pub only_once_per_process: bool,
    /// `true` if the FMU allocates its memory without the host; FMI 2.0 only, later FMUs always do.
    pub own_memory_management: bool,
    /// `true` if the host can save and restore the state.
    pub get_and_set_state: bool,
    /// `true` if a saved state can be serialized.
    pub serialize_state: bool,
    /// `true` if the FMU provides directional derivatives.
    pub directional_derivative: bool,
    /// `true` if the FMU provides adjoint derivatives; FMI 3.0 only.
    pub adjoint_derivative: bool,
    /// Source files to compile, relative to `sources/`; FMI 2.0 only, later FMUs have a build description instead.
    pub source_files: Vec<String>,
}

/// The model exchange interface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelExchange {
    /// Capabilities that every type of interface has.
    pub interface: InterfaceCapabilities,
    /// `true` if the host must report every completed integrator step.
    pub needs_completed_integrator_step: bool,
}

/// The co-simulation interface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CoSimulation {
    /// Capabilities that every type of interface has.
    pub interface: InterfaceCapabilities,
    /// `true` if communication steps may differ in size.
    pub variable_step_size: bool,
    /// `true` if the FMU interpolates inputs within a step by their derivatives; FMI 2.0 only.
    pub interpolate_inputs: bool,
    /// Highest order of output derivatives.
    pub max_output_derivative_order: u32,
    /// `true` if a step may run while the host does something else; FMI 2.0 only.
    pub run_asynchronously: bool,
    /// Step size inside the FMU, if it has one; FMI 3.0 only.
    pub fixed_internal_step_size: Option<f64>,
    /// `true` if events can be handled between steps; FMI 3.0 only.
    pub event_mode: bool,
    /// `true` if the host can exchange values in the middle of a step; FMI 3.0 only.
    pub intermediate_update: bool,
    /// `true` if a step may end before the requested time; FMI 3.0 only.
    pub might_return_early: bool,
    /// `true` if the host may end a step early at an intermediate update; FMI 3.0 only.
    pub return_early_after_intermediate_update: bool,
}

/// A unit and its definition in SI.
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

/// A variable; in FMI 3.0 it may be an array.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarVariable {
    /// Name, unique in the FMU.
    pub name: String,
    /// Handle for the get and set functions. FMI 2.0: unique among variables of a type, up to aliases; FMI 3.0: unique.
    pub value_reference: u32,
    /// One sentence for people.
    pub description: Option<String>,
    /// Its role for the host.
    pub causality: Causality,
    /// When it changes.
    pub variability: Variability,
    /// Its initialization. `None` for the independent variable, for clocks and inputs of FMI 2.0, where the standard
    /// has no such attribute, and for combinations of causality and variability outside the standard.
    pub initial: Option<Initial>,
    /// Name of the [`TypeDefinition`] that gives defaults.
    pub declared_type: Option<String>,
    /// Type with its bounds and start value.
    pub kind: VariableType,
    /// Sizes of an array, the slowest index first; empty for a scalar.
    pub dimensions: Vec<Dimension>,
    /// Value references of the clocks it is assigned to.
    pub clocks: Vec<u32>,
    /// `true` if the host may set or get it in the middle of a co-simulation step; FMI 3.0 only.
    pub intermediate_update: bool,
    /// Other names it goes by.
    pub aliases: Vec<Alias>,
}

impl ScalarVariable {
    /// Start value of a number; 0 or 1 of a boolean.
    pub fn start_value(&self) -> Option<f64> {
        match &self.kind {
            VariableType::Real(real) => real.start,
            VariableType::Integer(integer) | VariableType::Enumeration(integer) => {
                integer.start.map(|start| start as f64)
            }
            VariableType::Boolean { start } => start.map(|start| f64::from(u8::from(start))),
            _ => None,
        }
    }
}

/// Size of an array in one dimension.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dimension {
    /// Always the same.
    Fixed(u64),
    /// The value of the structural parameter with this value reference.
    Parameter(u32),
}

/// Another name of a variable.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Alias {
    /// The name.
    pub name: String,
    /// One sentence for people.
    pub description: Option<String>,
    /// Unit a user prefers to see.
    pub display_unit: Option<String>,
}

/// The role of a variable for the host.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Causality {
    /// Set by the host, not by other FMUs.
    Parameter,
    /// A parameter that array sizes depend on.
    StructuralParameter,
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

/// Initialization of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Initial {
    /// By its start value.
    Exact,
    /// By an iteration that begins at the start value.
    Approx,
    /// From other variables.
    Calculated,
}

/// Type of a variable, with bounds and start value.
#[derive(Clone, Debug, PartialEq)]
pub enum VariableType {
    /// Floating point number: `Real` of FMI 2.0, `Float64` and `Float32` of FMI 3.0.
    Real(RealAttributes),
    /// Integer: `Integer` of FMI 2.0, `Int8` to `UInt64` of FMI 3.0.
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
    /// Bytes; FMI 3.0 only.
    Binary {
        /// Start value, as hexadecimal digits.
        start: Option<String>,
    },
    /// A clock, which has no value but ticks; FMI 3.0 only.
    Clock {
        /// Variability of its interval.
        interval: Option<IntervalVariability>,
    },
}

/// Variability of a clock's interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum IntervalVariability {
    /// Never.
    Constant,
    /// Not after initialization.
    Fixed,
    /// When the host changes a parameter.
    Tunable,
    /// The FMU tells the next interval at every tick.
    Changing,
    /// The FMU tells when to tick next, at any event.
    Countdown,
    /// Ticks on demand.
    Triggered,
}

/// Attributes of a floating point variable; the start value of an array is that of its first element.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RealAttributes {
    /// `true` if it has single precision.
    pub single: bool,
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

/// Attributes of an integer or enumeration variable; the start value of an array is that of its first element.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Integer {
    /// Its number of bits, and its sign.
    pub width: Width,
    /// Smallest value.
    pub min: Option<i128>,
    /// Largest value.
    pub max: Option<i128>,
    /// Start value.
    pub start: Option<i128>,
}

/// Storage of an integer. FMI 2.0 has 32 bits only, also for enumerations; those of FMI 3.0 have 64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Width {
    /// 8 bits, signed.
    Int8,
    /// 8 bits, unsigned.
    UInt8,
    /// 16 bits, signed.
    Int16,
    /// 16 bits, unsigned.
    UInt16,
    /// 32 bits, signed.
    #[default]
    Int32,
    /// 32 bits, unsigned.
    UInt32,
    /// 64 bits, signed.
    Int64,
    /// 64 bits, unsigned.
    UInt64,
}

/// Which variables depend on which.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelStructure {
    /// Every output, with the inputs, states and the time it depends on while the simulation runs.
    pub outputs: Vec<Unknown>,
    /// Derivatives of states.
    pub derivatives: Vec<Unknown>,
    /// Discrete states of FMI 3.0 that change with a clock.
    pub clocked_states: Vec<Unknown>,
    /// Variables computed at initialization, each with the variables known then that it depends on.
    pub initial_unknowns: Vec<Unknown>,
    /// Event indicators, which only FMI 3.0 lists.
    pub event_indicators: Vec<Unknown>,
}

/// A variable that is computed, and what from.
#[derive(Clone, Debug, PartialEq)]
pub struct Unknown {
    /// Position of the variable.
    pub variable: usize,
    /// Positions of the variables it depends on; `None`: all that are known, empty: none.
    pub dependencies: Option<Vec<usize>>,
    /// Kind of its dependency on each of them; `None`: no particular one.
    pub kinds: Option<Vec<DependencyKind>>,
}

/// Kind of an unknown's dependency on a variable.
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
        (Self::StructuralParameter, "structuralParameter"),
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

impl Named for IntervalVariability {
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Constant, "constant"),
        (Self::Fixed, "fixed"),
        (Self::Tunable, "tunable"),
        (Self::Changing, "changing"),
        (Self::Countdown, "countdown"),
        (Self::Triggered, "triggered"),
    ];
}

impl Named for Width {
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Int8, "Int8"),
        (Self::UInt8, "UInt8"),
        (Self::Int16, "Int16"),
        (Self::UInt16, "UInt16"),
        (Self::Int32, "Int32"),
        (Self::UInt32, "UInt32"),
        (Self::Int64, "Int64"),
        (Self::UInt64, "UInt64"),
    ];
}

impl Width {
    /// Smallest and largest number.
    pub fn range(self) -> (i128, i128) {
        match self {
            Self::Int8 => (i8::MIN.into(), i8::MAX.into()),
            Self::UInt8 => (0, u8::MAX.into()),
            Self::Int16 => (i16::MIN.into(), i16::MAX.into()),
            Self::UInt16 => (0, u16::MAX.into()),
            Self::Int32 => (i32::MIN.into(), i32::MAX.into()),
            Self::UInt32 => (0, u32::MAX.into()),
            Self::Int64 => (i64::MIN.into(), i64::MAX.into()),
            Self::UInt64 => (0, u64::MAX.into()),
        }
    }
}

impl fmt::Display for FmiVersion {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::V2 => "2.0",
            Self::V3 => "3.0",
        })
    }
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
    /// allows none. `None` if the combination itself is not allowed (FMI 2.0.4, section 2.2.7; FMI 3.0.2, section
    /// 2.4.7.5: tables of `initial`).
    pub fn allowed(version: FmiVersion, causality: Causality, variability: Variability) -> Option<&'static [Self]> {
        use Causality as C;
        use Variability as V;
        match (causality, variability) {
            (C::StructuralParameter, _) if version == FmiVersion::V2 => None,
            (C::Output | C::Local, V::Constant) | (C::Parameter | C::StructuralParameter, V::Fixed | V::Tunable) => {
                Some(&[Self::Exact])
            }
            (C::CalculatedParameter | C::Local, V::Fixed | V::Tunable) => Some(&[Self::Calculated, Self::Approx]),
            (C::Output | C::Local, V::Discrete | V::Continuous) => Some(&[Self::Calculated, Self::Exact, Self::Approx]),
            (C::Input, V::Discrete | V::Continuous) if version == FmiVersion::V3 => Some(&[Self::Exact]),
            (C::Input, V::Discrete | V::Continuous) | (C::Independent, V::Continuous) => Some(&[]),
            _ => None,
        }
    }
}

impl VariableType {
    /// The standard's name of the type.
    pub fn name(&self, version: FmiVersion) -> &'static str {
        match self {
            Self::Real(_) if version == FmiVersion::V2 => "Real",
            Self::Real(real) if real.single => "Float32",
            Self::Real(_) => "Float64",
            Self::Integer(_) if version == FmiVersion::V2 => "Integer",
            Self::Integer(integer) => integer.width.name(),
            Self::Boolean { .. } => "Boolean",
            Self::String { .. } => "String",
            Self::Enumeration(_) => "Enumeration",
            Self::Binary { .. } => "Binary",
            Self::Clock { .. } => "Clock",
        }
    }

    /// Returns true if it has a start value.
    pub fn has_start(&self) -> bool {
        match self {
            Self::Real(real) => real.start.is_some(),
            Self::Integer(integer) | Self::Enumeration(integer) => integer.start.is_some(),
            Self::Boolean { start } => start.is_some(),
            Self::String { start } | Self::Binary { start } => start.is_some(),
            Self::Clock { .. } => false,
        }
    }

    /// Returns true if its value is a number or can be counted as one: not a text, not bytes, not a clock.
    pub fn is_number(&self) -> bool {
        !matches!(self, Self::String { .. } | Self::Binary { .. } | Self::Clock { .. })
    }

    /// The attributes of a real.
    pub fn as_real(&self) -> Option<&RealAttributes> {
        match self {
            Self::Real(real) => Some(real),
            _ => None,
        }
    }
}

/// FMUs with more numbers than this, all elements of all variables, are refused: their descriptions are mistaken, and not to be
/// met by running out of memory.
pub const MAX_ELEMENTS: u64 = 1 << 24;

impl ModelDescription {
    /// The variable of that name or alias.
    pub fn variable(&self, name: &str) -> Option<&ScalarVariable> {
        let named = self.variables.iter().find(|variable| variable.name == name);
        named.or_else(|| self.variables.iter().find(|variable| variable.aliases.iter().any(|alias| alias.name == name)))
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

    /// Sizes of an array, structural parameters having their start values; empty for a scalar, `None` if a size refers
    /// to no structural parameter.
    pub fn shape(&self, variable: &ScalarVariable) -> Option<Vec<u64>> {
        variable.dimensions.iter().map(|dimension| self.dimension_size(dimension)).collect()
    }

    fn dimension_size(&self, dimension: &Dimension) -> Option<u64> {
        match *dimension {
            Dimension::Fixed(size) => Some(size),
            Dimension::Parameter(reference) => {
                let parameter = self.variables.iter().find(|known| known.value_reference == reference)?;
                match parameter.kind {
                    VariableType::Integer(Integer { start: Some(start), .. }) => u64::try_from(start).ok(),
                    _ => None,
                }
            }
        }
    }

    /// Number of continuous states.
    pub fn state_count(&self) -> usize {
        self.elements(&self.structure.derivatives)
    }

    /// The continuous states in the order of the state vector. None if it has elements of arrays, or the description
    /// does not assign derivatives to variables.
    pub fn states(&self) -> Option<Vec<&ScalarVariable>> {
        Some(self.states_with_derivatives()?.into_iter().map(|(state, _)| state).collect())
    }

    /// Each continuous state with its derivative, in the order of the state vector. None in the cases of [`Self::states`].
    pub fn states_with_derivatives(&self) -> Option<Vec<(&ScalarVariable, &ScalarVariable)>> {
        let pairs = self.structure.derivatives.iter().map(|unknown| {
            let derivative = self.variables.get(unknown.variable)?;
            let state = self.variables.get(derivative.kind.as_real()?.derivative?)?;
            (state.dimensions.is_empty() && derivative.dimensions.is_empty()).then_some((state, derivative))
        });
        pairs.collect()
    }

    /// Number of event indicators, those of arrays included.
    pub fn indicator_count(&self) -> usize {
        match self.fmi_version {
            FmiVersion::V2 => self.event_indicators,
            FmiVersion::V3 => self.elements(&self.structure.event_indicators),
        }
    }

    fn elements(&self, unknowns: &[Unknown]) -> usize {
        let sizes = unknowns.iter().map(|unknown| {
            let shape = self.variables.get(unknown.variable).and_then(|variable| self.shape(variable));
            shape.map_or(1, |shape| shape.into_iter().fold(1, u64::saturating_mul) as usize)
        });
        sizes.fold(0, usize::saturating_add)
    }
}
