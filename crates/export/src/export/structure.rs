//! The model structure of a surrogate's FMU: its unknowns, and the known variables on which they depend.

use crate::{
    fmi::model_description::{FmiVersion, ModelStructure, Unknown},
    study::{ExportOptions, FmuPort},
};
use metafmu_runtime::{
    Bounds, BuiltIn, Clock, Motion, Ports, Quantity, Role, Sampling, Shown, Surrogate, Variable, graph::Step,
};

/// Model structure: unknowns and their dependencies, as positions of the variables in the table.
///
/// Every output and every derivative of a state depends on every input and every state. Those of the model also depend
/// on the domain policy, which may clamp inputs and states. The initial value of a state is its parameter. Parameters are
/// known at initialization. During the simulation they are known in FMI 3.0 only, where a derivative with respect to a
/// known variable that is not listed is zero (FMI 3.0.2, 2.4.8, `dependencies`).
/// Dependency kinds are omitted, which means that every dependency is nonlinear.
pub(super) fn structure(
    table: &[(u32, &Variable)],
    surrogate: &Surrogate,
    about: &ExportOptions,
    version: FmiVersion,
) -> ModelStructure {
    let shown = ShownVariables { table, surrogate };
    let known = KnownVariables::new(shown, version);
    let of_model = shown.positions(|quantity| matches!(quantity, Quantity::Output(_) | Quantity::Array(_)));
    // local variables are no unknowns
    let [shows_domain, shows_bounds] = [FmuPort::Domain, FmuPort::Bounds].map(|port| about.ports.contains(&port));
    let of_domain = shown.positions(|quantity| {
        shows_domain && matches!(quantity, Quantity::BuiltIn(BuiltIn::InDomain | BuiltIn::DomainDistance))
    });
    let bounds = shown.positions(|quantity| shows_bounds && matches!(quantity, Quantity::Bound(_)));
    let grow = surrogate.bounds().is_some_and(Bounds::grow);
    let rates = shown.positions(|quantity| matches!(quantity, Quantity::Derivative(_)));
    let inputs = shown.columns(|_| true);
    let starts = shown.columns(|role| role == Role::Start);
    ModelStructure {
        outputs: (of_model.iter().chain(&of_domain))
            .map(|output| unknown(*output, known.of(*output)))
            .chain(bounds.iter().map(|bound| unknown(*bound, Vec::new())))
            .collect(),
        derivatives: rates.iter().map(|rate| unknown(*rate, known.of(*rate))).collect(),
        initial_unknowns: of_model
            .iter()
            .map(|output| unknown(*output, known.at_start_of(*output)))
            .chain(known.states.iter().zip(&starts).map(|(state, start)| unknown(*state, vec![*start])))
            .chain(rates.iter().map(|rate| unknown(*rate, known.at_start_of(*rate))))
            .chain(of_domain.iter().map(|output| unknown(*output, inputs.clone())))
            .chain(bounds.iter().filter(|_| grow).map(|bound| unknown(*bound, Vec::new())))
            .collect(),
        ..ModelStructure::default()
    }
}

/// An unknown with its dependencies in ascending order, which FMI 2.0 asks for.
fn unknown(variable: usize, mut dependencies: Vec<usize>) -> Unknown {
    dependencies.sort_unstable();
    Unknown { variable, dependencies: Some(dependencies), kinds: None }
}

/// The variables that an FMU shows, in the order of its description.
#[derive(Clone, Copy)]
struct ShownVariables<'a> {
    table: &'a [(u32, &'a Variable)],
    surrogate: &'a Surrogate,
}

impl ShownVariables<'_> {
    /// Positions of the variables that show such a quantity.
    fn positions(self, is_wanted: impl Fn(Quantity) -> bool) -> Vec<usize> {
        let wanted = self.table.iter().enumerate().filter(|(_, (_, variable))| is_wanted(variable.quantity));
        wanted.map(|(position, _)| position).collect()
    }

    /// Positions of the surrogate's input columns with such a role.
    fn columns(self, is_wanted: impl Fn(Role) -> bool) -> Vec<usize> {
        let inputs = self.surrogate.inputs();
        self.positions(|quantity| matches!(quantity, Quantity::Input(index) if is_wanted(inputs[index].role)))
    }
}

/// Positions of the variables that are known while unknowns are computed.
struct KnownVariables<'a> {
    shown: ShownVariables<'a>,
    states: Vec<usize>,
    /// The time and the inputs.
    driven: Vec<usize>,
    /// Parameters and the domain policy, where they are known during the simulation.
    constant: Vec<usize>,
    /// The domain policy, if the FMU shows it.
    policy: Vec<usize>,
    /// Which elements of the values of a graph of rates depend on inputs; empty for other surrogates.
    following_inputs: Vec<Vec<bool>>,
}

impl<'a> KnownVariables<'a> {
    fn new(shown: ShownVariables<'a>, version: FmiVersion) -> Self {
        let policy = shown.positions(|quantity| quantity == Quantity::BuiltIn(BuiltIn::DomainPolicy));
        let parameters = shown.columns(|role| matches!(role, Role::Parameter(_)));
        let Ports { parameters: first, inputs, .. } = shown.surrogate.ports();
        let program = shown.surrogate.program();
        let following_inputs = match (&program.clock, program.motion()) {
            (Clock::Continuous(_), None) => program.graph.dependent_on(&(first..first + inputs)),
            _ => Vec::new(),
        };
        Self {
            shown,
            states: shown.positions(|quantity| matches!(quantity, Quantity::State(_))),
            driven: shown.columns(|role| matches!(role, Role::Input | Role::Time)),
            constant: match version {
                FmiVersion::V2 => Vec::new(),
                FmiVersion::V3 => [parameters.as_slice(), &policy].concat(),
            },
            policy,
            following_inputs,
        }
    }

    fn all(&self) -> Vec<usize> {
        [self.driven.as_slice(), &self.states, &self.constant].concat()
    }

    fn without_driven(&self) -> Vec<usize> {
        [self.states.as_slice(), &self.constant].concat()
    }

    /// Variables on which an unknown depends during the simulation. What does not follow at once from an input is not said to: hosts would
    /// see algebraic loops.
    fn of(&self, position: usize) -> Vec<usize> {
        let quantity = self.shown.table[position].1.quantity;
        let program = self.shown.surrogate.program();
        match (&program.clock, program.motion()) {
            (Clock::Continuous(_), Some(motion)) => self.of_motion(motion, quantity),
            (Clock::Continuous(_), None) => self.of_rates(quantity),
            (Clock::Sampled(sampling), _) => self.of_samples(sampling, quantity),
            (Clock::Static, _) => self.all(),
        }
    }

    /// Variables on which an unknown depends at initialization: parameters, starts, and what it depends on later.
    fn at_start_of(&self, position: usize) -> Vec<usize> {
        let later = self.of(position);
        let mut known = [self.shown.columns(|_| true), self.policy.clone()].concat();
        known.retain(|variable| !self.driven.contains(variable) || later.contains(variable));
        known
    }

    /// See [`of`](Self::of), of equations of motion.
    fn of_motion(&self, motion: &Motion, quantity: Quantity) -> Vec<usize> {
        let n = motion.dynamics.coordinates();
        match quantity {
            Quantity::Output(output) if !follows_inputs(motion, output) => self.without_driven(),
            Quantity::Array(array) if !self.elements(array).iter().any(|output| follows_inputs(motion, *output)) => {
                self.without_driven()
            }
            Quantity::Derivative(coordinate) if coordinate < n => vec![self.states[n + coordinate]],
            _ => self.all(),
        }
    }

    /// See [`of`](Self::of), of a graph whose results are outputs and rates of the states.
    fn of_rates(&self, quantity: Quantity) -> Vec<usize> {
        match quantity {
            Quantity::Output(output) => self.of_result(output),
            Quantity::Derivative(state) => self.of_result(self.shown.surrogate.outputs().len() + state),
            Quantity::Array(array)
                if !self.elements(array).iter().any(|output| self.result_follows_inputs(*output)) =>
            {
                self.without_driven()
            }
            _ => self.all(),
        }
    }

    fn of_result(&self, result: usize) -> Vec<usize> {
        let Ports { parameters, inputs, .. } = self.shown.surrogate.ports();
        match self.place(result) {
            [0, column] if column >= parameters + inputs => vec![self.states[column - parameters - inputs]],
            _ if self.result_follows_inputs(result) => self.all(),
            [0, _] => self.constant.clone(),
            _ => self.without_driven(),
        }
    }

    fn result_follows_inputs(&self, result: usize) -> bool {
        let [value, element] = self.place(result);
        self.following_inputs[value][element]
    }

    /// Value and element of the graph that are a result.
    fn place(&self, result: usize) -> [usize; 2] {
        let steps = &self.shown.surrogate.program().graph.steps;
        match steps.last() {
            Some(Step::Columns { columns }) => columns[result].map(|place| place as usize),
            _ => [steps.len(), result],
        }
    }

    /// See [`of`](Self::of), of samples. Past ones are no variables; parameters, and inputs without direct effect, act from the next one on.
    fn of_samples(&self, sampling: &Sampling, quantity: Quantity) -> Vec<usize> {
        match quantity {
            Quantity::Output(output) => self.acting_directly(sampling, &[output]),
            Quantity::Array(array) => self.acting_directly(sampling, self.elements(array)),
            _ => self.all(),
        }
    }

    /// Driven variables that act directly on one of the outputs.
    fn acting_directly(&self, sampling: &Sampling, outputs: &[usize]) -> Vec<usize> {
        let mut acting = Vec::new();
        for (place, variable) in self.driven.iter().enumerate() {
            let mut effects = outputs.iter().map(|output| sampling.direct.get(output * self.driven.len() + place));
            if effects.any(|effect| effect.is_some_and(|effect| *effect != 0.0)) {
                acting.push(*variable);
            }
        }
        acting
    }

    /// The outputs that are an array.
    fn elements(&self, array: usize) -> &[usize] {
        self.shown.surrogate.array_elements(array).1
    }
}

/// Returns true if an output of a motion changes at once with an input.
fn follows_inputs(motion: &Motion, output: usize) -> bool {
    match motion.outputs[output] {
        Shown::Acceleration(_) => true,
        Shown::Reaction(index) => motion.reactions.as_ref().is_some_and(|reactions| reactions.follows_efforts(index)),
        Shown::Effort(effort) => motion.effort_follows_inputs(effort),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::describe::describe;
    use crate::fmi::ModelDescription;
    use metafmu_example as example;

    /// Names of the variables on which an output or a derivative of a state is said to depend during a simulation.
    fn dependencies<'a>(description: &'a ModelDescription, name: &str) -> Vec<&'a str> {
        let ModelStructure { outputs, derivatives, .. } = &description.structure;
        let mut unknowns = outputs.iter().chain(derivatives);
        let unknown = unknowns.find(|unknown| description.variables[unknown.variable].name == name).unwrap();
        let positions = unknown.dependencies.iter().flatten();
        positions.map(|position| description.variables[*position].name.as_str()).collect()
    }

    #[test]
    fn parameters_are_known_in_a_simulation_in_fmi_3_only() {
        let [v2, v3] = FmiVersion::ALL.map(|version| describe(&example::crane(), version, &ExportOptions::default()));
        let states = ["trolley.position", "rope.angle", "trolley.velocity", "rope.angular_velocity"];
        assert_eq!(dependencies(&v2, "x"), states);
        let known = ["rope", states[0], states[1], states[2], states[3], "domain_policy"];
        assert_eq!(dependencies(&v3, "x"), known);
        assert_eq!(dependencies(&v3, "der(trolley.velocity)")[..2], ["rope", "force"]);
        // it is a state
        for description in [&v2, &v3] {
            assert_eq!(dependencies(description, "der(trolley.position)"), ["trolley.velocity"]);
        }
    }
}
