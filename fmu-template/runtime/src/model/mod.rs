//! Models: maps together with time, and with states.

mod adjoint;
pub(crate) mod discrete;
pub(crate) mod dynamics;
pub(crate) mod efforts;
mod evaluator;
mod maps;
pub(crate) mod motion;
mod per_instant;
mod reactions;
mod solver;
pub(crate) mod state_space;

use crate::{
    Encoder, FormatError, Input, Metadata, Role, State,
    map::{Map, ScaledNetwork, expect_finite, expect_shape},
};
pub use discrete::{Discrete, Support, Transition};
pub use efforts::{EffortColumn, Efforts};
pub use evaluator::{Evaluator, MAX_OUTPUT_DERIVATIVE_ORDER, Scratch};
pub use motion::{Motion, Shown};
pub use reactions::Reactions;
pub use solver::{CommunicationStep, Drive, Integration, MAX_SOLVER_STEPS, Scale, StepError};
pub use state_space::{Given, StateSpace};

/// What computes a surrogate's outputs from a point: one value for each of its inputs, the time among them, and one for each of its
/// states.
#[derive(Clone, Debug, PartialEq)]
pub enum Model {
    /// One map gives the outputs; the time, if it is an input, is a column like the others.
    Response(Map),
    /// A network for each of some instants `t_0 < ... < t_N`, whose inputs are the columns other than the time. Between
    /// two instants the outputs are interpolated linearly in time, `y = (1 - w) y_k + w y_(k+1)` with
    /// `w = (t - t_k) / (t_(k+1) - t_k)`; before the first and after the last one they do not depend on the time.
    PerInstant {
        /// `t_0, ..., t_N` in seconds, at least two.
        instants: Vec<f64>,
        /// One an instant, all with layers of the same sizes.
        networks: Vec<ScaledNetwork>,
    },
    /// Equations of motion, whose coordinates and velocities are the states.
    Motion(Box<Motion>),
    /// Derivatives of states and outputs as functions of parameters, inputs and states.
    StateSpace(Box<StateSpace>),
    /// The next sample of the outputs as a function of past outputs and inputs.
    Discrete(Box<Discrete>),
}

impl Model {
    /// How continuous states are integrated; none without them.
    pub fn integration(&self) -> Option<Integration> {
        match self {
            Self::Motion(motion) => Some(motion.integration),
            Self::StateSpace(space) if space.counts[2] > 0 => Some(space.integration),
            Self::StateSpace(_) | Self::Response(_) | Self::PerInstant { .. } | Self::Discrete(_) => None,
        }
    }

    /// The same with another integration of continuous states, if it has any.
    #[must_use]
    pub fn with_integration(mut self, integration: Integration) -> Self {
        match &mut self {
            Self::Motion(motion) => motion.integration = integration,
            Self::StateSpace(space) => space.integration = integration,
            Self::Response(_) | Self::PerInstant { .. } | Self::Discrete(_) => {}
        }
        self
    }

    /// What the values of continuous states are measured by: those of the description, in order.
    pub fn scales(&self, states: &[State]) -> Vec<Scale> {
        let is_angle = |state: usize| match self {
            // a coordinate without a range is an angle, or nothing depends on it
            Self::Motion(_) => true,
            Self::StateSpace(space) => space.is_angle(state),
            Self::Response(_) | Self::PerInstant { .. } | Self::Discrete(_) => false,
        };
        states.iter().enumerate().map(|(index, state)| Scale::new(state, is_angle(index))).collect()
    }

    /// Makes sure that it fits the inputs, states and outputs of a description.
    ///
    /// # Errors
    /// The first [`FormatError`].
    pub(crate) fn check(&self, metadata: &Metadata) -> Result<(), FormatError> {
        let Metadata { inputs, states, outputs, .. } = metadata;
        let (inputs, outputs) = (inputs.as_slice(), outputs.len());
        let without_states = || match inputs.iter().find(|input| input.role == Role::Start) {
            Some(input) => Err(FormatError::NoState { name: input.name.clone() }),
            None => expect_shape("states", &[states.len()], &[0]),
        };
        match self {
            Self::Response(map) => {
                without_states()?;
                map.check(Encoder::of(inputs).width(), outputs)
            }
            Self::PerInstant { instants, networks } => {
                without_states()?;
                check_per_instant(instants, networks, inputs, outputs)
            }
            Self::Motion(motion) => motion.check(inputs, states, outputs),
            Self::StateSpace(space) => space.check(inputs, states, outputs),
            Self::Discrete(discrete) => discrete.check(inputs, states, outputs),
        }
    }
}

/// Makes sure that a model's inputs are, in this order, so many parameters, a start for each state, and so many inputs: `counts` are the
/// numbers of parameters, inputs and states.
fn expect_roles(inputs: &[Input], states: &[State], counts: [usize; 3]) -> Result<(), FormatError> {
    let [parameters, drivers, count] = counts;
    expect_starts(inputs, [parameters, count, drivers])?;
    expect_shape("states", &[states.len()], &[count])
}

/// Makes sure that a model's inputs are, in this order, so many parameters, values at the start, and inputs.
fn expect_starts(inputs: &[Input], counts: [usize; 3]) -> Result<(), FormatError> {
    let mut rest = inputs;
    let mut count = |is_wanted: fn(Role) -> bool| {
        let count = rest.iter().take_while(|input| is_wanted(input.role)).count();
        rest = &rest[count..];
        count
    };
    let parameters = count(|role| matches!(role, Role::Parameter(_)));
    let found = [parameters, count(|role| role == Role::Start), count(|role| role == Role::Input), rest.len()];
    let [parameters, starts, drivers] = counts;
    expect_shape("inputs", &found, &[parameters, starts, drivers, 0])?;
    match inputs.iter().find(|input| !input.encoding.is_plain()) {
        Some(input) => Err(FormatError::Encoding { name: input.name.clone(), expected: "none with states" }),
        None => Ok(()),
    }
}

fn expect_step(step: f64) -> Result<(), FormatError> {
    if step.is_finite() && step > 0.0 { Ok(()) } else { Err(FormatError::TimeStep { found: step }) }
}

fn check_per_instant(
    instants: &[f64],
    networks: &[ScaledNetwork],
    inputs: &[Input],
    outputs: usize,
) -> Result<(), FormatError> {
    if inputs.iter().all(|input| input.role != Role::Time) {
        return Err(FormatError::NoTime);
    }
    // the time is one of them
    let columns = Encoder::of(inputs).width() - 1;
    if columns == 0 {
        return Err(FormatError::OnlyTime);
    }
    if instants.len() < 2 {
        return Err(FormatError::FewInstants { count: instants.len() });
    }
    expect_finite("instants", instants.iter().copied())?;
    if let Some(index) = instants.windows(2).position(|pair| pair[0] >= pair[1]) {
        return Err(FormatError::NotAscending {
            name: "instants".into(),
            index: index + 1,
            before: instants[index],
            found: instants[index + 1],
        });
    }
    if networks.len() != instants.len() {
        return Err(FormatError::NetworkCount { found: networks.len(), expected: instants.len() });
    }
    for (instant, network) in networks.iter().enumerate() {
        let problem = |source| FormatError::OfInstant { instant, source: Box::new(source) };
        network.check(columns, outputs).map_err(problem)?;
        let (found, expected) = (network.sizes(), networks[0].sizes());
        if found != expected {
            return Err(FormatError::LayerSizes { instant, found, expected });
        }
        let mut pairs = network.layers.iter().zip(&networks[0].layers);
        if let Some(layer) = pairs.position(|(layer, first)| layer.activation != first.activation) {
            return Err(FormatError::LayerActivation { instant, layer });
        }
    }
    Ok(())
}
