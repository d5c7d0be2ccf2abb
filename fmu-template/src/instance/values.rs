//! The variables' values: which may be read and set when, and what they depend on.

use super::Instance;
use crate::{
    state::InstanceState,
    status::{Refusal, Status},
};
use metafmu_runtime::{BuiltIn, DomainPolicy, Metadata, Quantity, Role, Tunability, Variables};

/// Target of a call that sets a real.
enum Settable {
    /// An input, a parameter, a state or a measured output.
    Column(usize),
    /// `domain_policy`.
    Policy,
    /// `use_measured`.
    UseMeasured,
    /// The independent variable, which has this value already.
    Time,
}

impl Instance {
    /// How many values these variables have: one each, but for the arrays of FMI 3.0.
    #[inline]
    pub(crate) fn size(&self, references: &[u32]) -> Result<usize, Refusal> {
        self.variables.size(references)
    }

    /// Values of real variables, element by element: all of them or, if one is refused, none. There are as many values
    /// as [`Instance::size`] says.
    #[inline]
    pub(crate) fn get_real(&mut self, references: &[u32], values: &mut [f64]) -> Result<(), Refusal> {
        let mut results = false;
        for &reference in references {
            let quantity = self.quantity(reference)?;
            self.check_readable(reference, quantity)?;
            results |= matches!(quantity, Quantity::Output(_) | Quantity::Array(_) | Quantity::Derivative(_));
        }
        if results {
            self.update_results()?;
        }
        let mut values = values.iter_mut();
        for &reference in references {
            // not by way of `reals`: this is on the path of every step
            let value = match self.quantity(reference)? {
                Quantity::Input(column) => self.now.values[column],
                Quantity::Output(output) => self.results[output],
                Quantity::State(state) => self.states()[state],
                Quantity::Derivative(state) => self.results[self.metadata.outputs.len() + state],
                Quantity::BuiltIn(BuiltIn::DomainDistance) => self.domain.distance(&self.now.values, self.near),
                Quantity::BuiltIn(BuiltIn::Time) => self.now.time,
                Quantity::Bound(output) => self.variables.bound(output, self.elapsed()),
                Quantity::Measured(output) => self.now.values[self.measured.start + output],
                Quantity::Array(array) => {
                    let outputs = self.variables.outputs_of(array);
                    // in this order: zip takes from its first iterator even when the second has ended
                    outputs.iter().zip(values.by_ref()).for_each(|(&output, value)| *value = self.results[output]);
                    continue;
                }
                // some hosts read every variable as a real
                Quantity::BuiltIn(BuiltIn::InDomain) => f64::from(self.is_in_domain()),
                Quantity::BuiltIn(BuiltIn::UseMeasured) => f64::from(self.is_measured()),
                Quantity::BuiltIn(BuiltIn::DomainPolicy) => f64::from(self.now.policy as i32),
            };
            if let Some(to) = values.next() {
                *to = value;
            }
        }
        Ok(())
    }

    /// Before the initialization FMI 3.0 lets start values be read, and FMI 2.0 nothing.
    #[inline(always)]
    fn check_readable(&self, reference: u32, quantity: Quantity) -> Result<(), Refusal> {
        if self.now.state == InstanceState::Instantiated { self.check_start(reference, quantity) } else { Ok(()) }
    }

    #[cold]
    fn check_start(&self, reference: u32, quantity: Quantity) -> Result<(), Refusal> {
        let has_start = match quantity {
            Quantity::Input(column) => self.metadata.inputs[column].role != Role::Time,
            Quantity::Bound(_) => !self.variables.bounds_grow(),
            Quantity::Measured(_) => true,
            Quantity::BuiltIn(built_in) => matches!(built_in, BuiltIn::DomainPolicy | BuiltIn::UseMeasured),
            Quantity::Output(_) | Quantity::Array(_) | Quantity::State(_) | Quantity::Derivative(_) => false,
        };
        if has_start { Ok(()) } else { Err(Refusal::NoStartValue { name: self.name(reference), reference }) }
    }

    /// Time since the start of the run.
    pub(super) fn elapsed(&self) -> f64 {
        self.now.time - self.now.start_time
    }

    /// Values of 32-bit integer variables: all of them or, if one is refused, none.
    pub(crate) fn get_integer(&self, references: &[u32], values: &mut [i32]) -> Result<(), Refusal> {
        references.iter().try_for_each(|&reference| self.expect_policy(reference))?;
        values.fill(self.now.policy as i32);
        Ok(())
    }

    /// Makes sure that the variable is the domain policy, the only integer.
    fn expect_policy(&self, reference: u32) -> Result<(), Refusal> {
        match self.quantity(reference)? {
            Quantity::BuiltIn(BuiltIn::DomainPolicy) => Ok(()),
            _ => Err(self.wrong_type(reference, "integer")),
        }
    }

    /// Values of Boolean variables, in the type that the FMI version has for them: all of them or, if one is refused, none.
    pub(crate) fn get_boolean<T: From<bool>>(&self, references: &[u32], values: &mut [T]) -> Result<(), Refusal> {
        for &reference in references {
            match self.quantity(reference)? {
                quantity @ Quantity::BuiltIn(BuiltIn::InDomain | BuiltIn::UseMeasured) => {
                    self.check_readable(reference, quantity)?;
                }
                _ => return Err(self.wrong_type(reference, "Boolean")),
            }
        }
        for (&reference, value) in references.iter().zip(values) {
            let is_switch = self.quantity(reference)? == Quantity::BuiltIn(BuiltIn::UseMeasured);
            *value = if is_switch { self.is_measured() } else { self.is_in_domain() }.into();
        }
        Ok(())
    }

    /// Sets inputs and parameters: all of them or, if one is refused, none. Hosts that set every variable as a real set integers and
    /// Booleans, too.
    pub(crate) fn set_real(&mut self, references: &[u32], values: &[f64]) -> Result<(), Refusal> {
        for (&reference, &value) in references.iter().zip(values) {
            let target = self.settable(reference, value)?;
            if !value.is_finite() {
                let status = if self.is_trial() { Status::Discard } else { Status::Error };
                return Err(Refusal::ValueNotFinite { name: self.name(reference), reference, value, status });
            }
            match target {
                Settable::Column(column) if !self.is_trial() => {
                    self.check_value(column, value, self.now.time, self.now.policy, Status::Error)?;
                }
                Settable::Policy => self.check_point(policy(value)?)?,
                Settable::Column(_) | Settable::UseMeasured | Settable::Time => {}
            }
        }
        for (&reference, &value) in references.iter().zip(values) {
            match self.settable(reference, value)? {
                Settable::Column(column) => self.set_column(column, value),
                Settable::Policy => self.set_policy(policy(value)?),
                Settable::UseMeasured => self.now.values[self.measured.end] = f64::from(value != 0.0),
                Settable::Time => {}
            }
        }
        self.initialize_states();
        self.stale |= !references.is_empty();
        Ok(())
    }

    #[inline(always)]
    fn set_column(&mut self, column: usize, value: f64) {
        let is_parameter = self.metadata.inputs.get(column).is_some_and(|input| input.role != Role::Input);
        let is_other = value != self.now.values[column];
        self.now.values[column] = value;
        if self.now.time <= self.now.start_time {
            self.now.at_start[column] = value;
            if is_parameter && is_other && !self.is_starting() {
                self.restart(column);
            }
        }
        if !self.is_trial() {
            self.note_value(column);
        }
    }

    /// Sets the domain policy, the only integer.
    pub(crate) fn set_integer(&mut self, references: &[u32], values: &[i32]) -> Result<(), Refusal> {
        let mut new = None;
        for (&reference, &found) in references.iter().zip(values) {
            self.expect_policy(reference)?;
            let policy = DomainPolicy::from_number(found).ok_or(Refusal::Policy { found: found.into() })?;
            self.parameter_settable(Tunability::Tunable, reference, policy == self.now.policy)?;
            new = Some(policy);
        }
        let Some(new) = new else { return Ok(()) };
        // a value that is outside already is not left standing
        self.check_point(new)?;
        self.set_policy(new);
        Ok(())
    }

    fn set_policy(&mut self, new: DomainPolicy) {
        self.stale |= new != self.now.policy;
        self.now.policy = new;
        if !self.is_smooth {
            self.initialize_states();
        }
    }

    /// Sets the switch for measured outputs, the only Boolean that is an input. Of several values the last one counts.
    pub(crate) fn set_boolean<T: From<bool> + PartialEq>(
        &mut self,
        references: &[u32],
        values: &[T],
    ) -> Result<(), Refusal> {
        for &reference in references {
            match self.quantity(reference)? {
                Quantity::BuiltIn(BuiltIn::UseMeasured) => {}
                Quantity::BuiltIn(BuiltIn::InDomain) => {
                    return Err(Refusal::SetComputed { name: self.name(reference), reference });
                }
                _ => return Err(self.wrong_type(reference, "Boolean")),
            }
        }
        if let Some(value) = values.last() {
            self.now.values[self.measured.end] = if *value == T::from(false) { 0.0 } else { 1.0 };
        }
        Ok(())
    }

    /// The target of a call that sets a variable to this value now.
    #[inline]
    fn settable(&self, reference: u32, value: f64) -> Result<Settable, Refusal> {
        match self.quantity(reference)? {
            Quantity::Input(column) => match self.metadata.inputs[column].role {
                Role::Input => Ok(Settable::Column(column)),
                Role::Time => self.present_time(reference, value),
                role => {
                    let variability = if let Role::Parameter(own) = role { own } else { Tunability::Fixed };
                    self.parameter_settable(variability, reference, value == self.now.values[column])?;
                    Ok(Settable::Column(column))
                }
            },
            Quantity::Measured(output) => Ok(Settable::Column(self.measured.start + output)),
            // in both standards, beside fmi3SetContinuousStates
            Quantity::State(state) if self.is_trial() => Ok(Settable::Column(self.metadata.inputs.len() + state)),
            Quantity::State(_) => Err(Refusal::SetState { name: self.name(reference), reference }),
            Quantity::Output(_) | Quantity::Array(_) => {
                Err(Refusal::SetOutput { name: self.name(reference), reference })
            }
            // local variables, or outputs where the FMU has ports for them
            Quantity::Derivative(_)
            | Quantity::Bound(_)
            | Quantity::BuiltIn(BuiltIn::DomainDistance | BuiltIn::InDomain) => {
                Err(Refusal::SetComputed { name: self.name(reference), reference })
            }
            Quantity::BuiltIn(BuiltIn::Time) => self.present_time(reference, value),
            Quantity::BuiltIn(BuiltIn::UseMeasured) => Ok(Settable::UseMeasured),
            Quantity::BuiltIn(BuiltIn::DomainPolicy) => {
                self.parameter_settable(Tunability::Tunable, reference, value == f64::from(self.now.policy as i32))?;
                Ok(Settable::Policy)
            }
        }
    }

    /// The independent variable may be set to the value that it has: it is settable by its own function only.
    fn present_time(&self, reference: u32, value: f64) -> Result<Settable, Refusal> {
        let now = self.now.time;
        if (value - now).abs() <= 1e-9 * now.abs().max(self.metadata.time_step) {
            return Ok(Settable::Time);
        }
        Err(Refusal::SetTime { name: self.name(reference), reference })
    }

    /// Fixed parameters may be set until the simulation runs, tunable ones also at events and between steps. Some hosts set tunable ones where a
    /// solver tries points, fixed ones until time passes, which means what it does in the initialization, and values that stay what they are.
    fn parameter_settable(&self, variability: Tunability, reference: u32, is_unchanged: bool) -> Result<(), Refusal> {
        let state = self.now.state;
        let is_at_start = self.now.time <= self.now.start_time;
        let variability = match (variability, state) {
            _ if is_unchanged => return Ok(()),
            (_, InstanceState::Instantiated | InstanceState::Initialization) => return Ok(()),
            (Tunability::Tunable, InstanceState::Event | InstanceState::Step | InstanceState::ContinuousTime) => {
                return Ok(());
            }
            (Tunability::Fixed, InstanceState::Event | InstanceState::Step) if is_at_start => return Ok(()),
            (Tunability::Fixed, _) => "fixed",
            (Tunability::Tunable, _) => "tunable",
        };
        Err(Refusal::SetParameter { name: self.name(reference), reference, variability, state })
    }

    #[inline]
    pub(super) fn quantity(&self, reference: u32) -> Result<Quantity, Refusal> {
        self.variables.find(reference).map(|variable| variable.quantity)
    }

    /// Name of a variable that there is.
    pub(super) fn name(&self, reference: u32) -> String {
        self.variables.find(reference).map_or(String::new(), |variable| variable.name.clone())
    }

    pub(super) fn column_name(&self, column: usize) -> String {
        let Metadata { inputs, states, .. } = &self.metadata;
        inputs.get(column).map_or_else(|| states[column - inputs.len()].name.clone(), |input| input.name.clone())
    }

    #[cold]
    fn wrong_type(&self, reference: u32, asked: &'static str) -> Refusal {
        let found = match self.quantity(reference) {
            Ok(Quantity::BuiltIn(BuiltIn::DomainPolicy)) => "integer",
            Ok(Quantity::BuiltIn(BuiltIn::InDomain | BuiltIn::UseMeasured)) => "Boolean",
            Ok(_) => "real",
            Err(refusal) => return refusal,
        };
        Refusal::WrongType { name: self.name(reference), reference, found, asked }
    }

    /// Dependencies of a variable: pairs of an element, counted from one, and the value reference it depends on. The
    /// element of a scalar is zero, which stands for all elements.
    pub(crate) fn dependencies(&self, reference: u32) -> Result<impl Iterator<Item = (usize, u32)> + use<>, Refusal> {
        let quantity = self.quantity(reference)?;
        let Metadata { inputs, outputs, states, .. } = &self.metadata;
        let inputs = Variables::FIRST_REFERENCE..Variables::FIRST_REFERENCE + inputs.len() as u32;
        let first_state = inputs.end + outputs.len() as u32;
        let all = (inputs, first_state..first_state + states.len() as u32);
        let ((inputs, states), policy) = match quantity {
            Quantity::Output(_) | Quantity::Array(_) | Quantity::Derivative(_) => {
                (all, self.variables.reference(Quantity::BuiltIn(BuiltIn::DomainPolicy)))
            }
            Quantity::BuiltIn(BuiltIn::InDomain | BuiltIn::DomainDistance) => (all, None),
            Quantity::Input(_)
            | Quantity::State(_)
            | Quantity::Bound(_)
            | Quantity::Measured(_)
            | Quantity::BuiltIn(BuiltIn::DomainPolicy | BuiltIn::Time | BuiltIn::UseMeasured) => ((0..0, 0..0), None),
        };
        let elements = self.variables.elements(quantity).map_or(0..=0, |elements| 1..=elements);
        Ok(elements.flat_map(move |element| {
            inputs.clone().chain(states.clone()).chain(policy).map(move |known| (element, known))
        }))
    }
}

/// The domain policy of a number.
fn policy(value: f64) -> Result<DomainPolicy, Refusal> {
    let number = if value.fract() == 0.0 { value as i32 } else { -1 };
    DomainPolicy::from_number(number).ok_or(Refusal::Policy { found: value })
}
