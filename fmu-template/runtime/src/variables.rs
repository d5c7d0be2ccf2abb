//! The variables of an FMU as one ordered table. Value references, the description, the instance and the C sources all
//! come from it.

use crate::{Metadata, Output, Role};

/// All variables in the order of their FMI value references, from [`Variables::FIRST_REFERENCE`] on: inputs, outputs,
/// states, their derivatives, built-in variables, arrays of outputs, error bounds, measured values.
#[derive(Clone, Debug, PartialEq)]
pub struct Variables(Vec<Variable>);

/// A variable of an FMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Variable {
    /// Name, as the FMU shows it.
    pub name: String,
    /// Quantity that the variable shows.
    pub quantity: Quantity,
    /// `true` if FMI 2.0 does not have the variable. Its value reference stays unused there.
    pub only_fmi3: bool,
}

/// Quantity that a variable shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// An input of the surrogate: a parameter, the time or an input that is driven.
    Input(usize),
    /// An output.
    Output(usize),
    /// A continuous state.
    State(usize),
    /// The derivative of a state with respect to time.
    Derivative(usize),
    /// A variable that every FMU has.
    BuiltIn(BuiltIn),
    /// Several outputs as one array. FMI 2.0 has no arrays.
    Array(usize),
    /// The error bound of an output: a constant or, of a model with a state, a function of the time since the start.
    Bound(usize),
    /// The measured value of an output of a discrete-time surrogate: a continuous input.
    Measured(usize),
}

/// Variables that an FMU adds to those of the surrogate: its validity, and the policies and signals that control it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BuiltIn {
    /// Policy outside the training ranges, a [`DomainPolicy`](crate::DomainPolicy): a tunable integer parameter.
    DomainPolicy,
    /// `true` if inputs, parameters and time are in the domain, up to [`TOLERANCE`](crate::TOLERANCE): a discrete
    /// Boolean. If the time is an input of the model, inputs and parameters must also be unchanged since the
    /// start of the run.
    InDomain,
    /// Distance from the domain, see [`Domain::distance`](crate::Domain::distance): a continuous dimensionless output,
    /// never negative.
    DomainDistance,
    /// The independent variable of a surrogate of which no input is the time, as FMI 3.0 asks for exactly one.
    Time,
    /// `true` while samples of the outputs are measured, see [`Quantity::Measured`]: a discrete Boolean input of a discrete-time surrogate.
    UseMeasured,
}

/// Properties of a surrogate that its built-in variables depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Known {
    /// `true` if the time is among the inputs: the values at the start then define the whole run.
    pub time: bool,
    /// `true` if it knows where its training data are.
    pub data: bool,
    /// `true` if it knows the training ranges of the outputs that it feeds back.
    pub fed_back: bool,
}

impl BuiltIn {
    /// Built-in variables of every FMU, in order; [`BuiltIn::Time`] is added if no input is the time, and
    /// [`BuiltIn::UseMeasured`] to discrete-time FMUs.
    pub const ALWAYS: [Self; 3] = [Self::DomainPolicy, Self::InDomain, Self::DomainDistance];

    /// Variable name; no variable of a surrogate may have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::DomainPolicy => "domain_policy",
            Self::InDomain => "in_domain",
            Self::DomainDistance => "domain_distance",
            Self::Time => "time",
            Self::UseMeasured => "use_measured",
        }
    }

    /// One sentence for people.
    pub fn description(self, known: Known) -> &'static str {
        match (self, known) {
            (Self::DomainPolicy, _) => {
                "Outside the training ranges: 0 warns and extrapolates, 1 clamps to the range, 2 refuses"
            }
            (Self::InDomain, Known { fed_back: true, .. }) => {
                "True if inputs and parameters are all in the training ranges, and outputs, changes and averages were recently"
            }
            (Self::DomainDistance, Known { fed_back: true, .. }) => {
                "Largest distance of an input or parameter, or recently of an output, change or average, from its training range, relative to \
                 the range; 0 inside"
            }
            (Self::InDomain, Known { time: true, data: false, .. }) => {
                "True if inputs, parameters and time are all in the training ranges, and inputs and parameters unchanged \
                 since the start"
            }
            (Self::InDomain, Known { time: true, data: true, .. }) => {
                "True if inputs, parameters and time are all in the training ranges, near training data, and inputs and parameters \
                 unchanged since the start"
            }
            (Self::InDomain, Known { time: false, data: false, .. }) => {
                "True if inputs, parameters and states are all in the training ranges"
            }
            (Self::InDomain, Known { time: false, data: true, .. }) => {
                "True if inputs and parameters are all in the training ranges, and near training data"
            }
            (Self::DomainDistance, Known { time: true, data: false, .. }) => {
                "Largest distance of an input, parameter or time from its training range, relative to the range; 0 inside"
            }
            (Self::DomainDistance, Known { time: false, data: false, .. }) => {
                "Largest distance of an input, parameter or state from its training range, relative to the range; 0 inside"
            }
            (Self::DomainDistance, Known { data: true, .. }) => {
                "Largest distance of an input or parameter from its training range, or from what is near training data, relative to the \
                 range; 0 inside"
            }
            (Self::Time, _) => "Simulation time",
            (Self::UseMeasured, _) => {
                "True if samples of the outputs are replaced by their measured values before the next one is computed"
            }
        }
    }
}

impl Variable {
    fn new(name: impl Into<String>, quantity: Quantity) -> Self {
        let only_fmi3 = matches!(quantity, Quantity::Array(_) | Quantity::BuiltIn(BuiltIn::Time));
        Self { name: name.into(), quantity, only_fmi3 }
    }

    fn built_in(of: BuiltIn) -> Self {
        Self::new(of.name(), Quantity::BuiltIn(of))
    }

    /// Returns true if the FMU adds it to the variables of the surrogate.
    pub fn is_built_in(&self) -> bool {
        matches!(self.quantity, Quantity::BuiltIn(_))
    }
}

impl Variables {
    /// Value reference of the first variable. OMSimulator takes 0 among the dependencies of an output for "none", and
    /// refuses the FMU.
    pub const FIRST_REFERENCE: u32 = 1;

    /// The table of a surrogate with this description; `is_discrete`: whether it is discrete-time.
    pub(crate) fn of(metadata: &Metadata, is_discrete: bool) -> Self {
        let Metadata { inputs, outputs, states, arrays, bounds, .. } = metadata;
        let has_time = inputs.iter().any(|input| input.role == Role::Time);
        let built_in = BuiltIn::ALWAYS.into_iter().chain((!has_time).then_some(BuiltIn::Time));
        let bounded = bounds.iter().flat_map(|_| metadata.predictions().iter().enumerate());
        let followed = is_discrete.then(|| outputs.iter().enumerate()).into_iter().flatten();
        let switch = is_discrete.then(|| Variable::built_in(BuiltIn::UseMeasured));
        let inputs = inputs.iter().enumerate().map(|(index, v)| Variable::new(&v.name, Quantity::Input(index)));
        let outputs = outputs.iter().enumerate().map(|(index, v)| Variable::new(&v.name, Quantity::Output(index)));
        let rates =
            states.iter().enumerate().map(|(index, v)| Variable::new(v.rate_name(), Quantity::Derivative(index)));
        let states = states.iter().enumerate().map(|(index, v)| Variable::new(&v.name, Quantity::State(index)));
        let built_in = built_in.map(Variable::built_in);
        let arrays = arrays.iter().enumerate().map(|(index, v)| Variable::new(&v.name, Quantity::Array(index)));
        let bounds =
            bounded.map(|(index, output)| Variable::new(Output::bound_name(&output.name), Quantity::Bound(index)));
        let measured =
            followed.map(|(index, v)| Variable::new(Output::measured_name(&v.name), Quantity::Measured(index)));
        let of_model = inputs.chain(outputs).chain(states).chain(rates);
        Self(of_model.chain(built_in).chain(arrays).chain(bounds).chain(switch).chain(measured).collect())
    }

    /// The variable with this value reference.
    #[inline]
    pub fn get(&self, reference: u32) -> Option<&Variable> {
        self.0.get(reference.checked_sub(Self::FIRST_REFERENCE)? as usize)
    }

    /// Value reference of the variable with this quantity, if there is one.
    pub fn reference(&self, quantity: Quantity) -> Option<u32> {
        self.iter().find(|(_, variable)| variable.quantity == quantity).map(|(reference, _)| reference)
    }

    /// Value references and variables, in order.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (u32, &Variable)> + ExactSizeIterator {
        self.0.iter().enumerate().map(|(index, variable)| (Self::FIRST_REFERENCE + index as u32, variable))
    }

    /// Length of a table with each variable at the position that is its value reference.
    pub fn reference_count(&self) -> u32 {
        Self::FIRST_REFERENCE + self.0.len() as u32
    }
}
