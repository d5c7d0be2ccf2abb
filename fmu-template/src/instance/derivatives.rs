//! Derivatives of the outputs: with respect to inputs, parameters and time, and along the simulation.

use super::{Instance, finite, variables::UnknownQuantity};
use crate::status::Refusal;
use metafmu_runtime::{BuiltIn, DomainPolicy, MAX_OUTPUT_DERIVATIVE_ORDER, Quantity, Role};
use std::slice;

const KNOWN: &str = "input, parameter, state or time";
const UNKNOWN: &str = "continuous output, state or derivative of one";

/// A variable with respect to which derivatives are taken.
#[derive(Clone, Copy)]
enum KnownQuantity {
    Column(usize),
    /// The independent variable of a surrogate without a time column, on which bounds alone depend.
    Time,
    /// An integer or Boolean: nothing depends on it continuously.
    Switch,
}

impl Instance {
    /// `sensitivity = J seed`, `J` the derivatives of the unknowns (outputs, derivatives of states) with respect to the knowns
    /// (inputs, parameters, states, time). A direction in which the policy clamps has no effect on the surrogate's outputs. Arrays count by
    /// their elements, as [`Instance::size`] says.
    pub(crate) fn directional_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), Refusal> {
        self.check_sensitivity(unknowns, knowns, seed)?;
        self.columns[0].fill(0.0);
        let mut of_time = 0.0;
        for (&known, &seed) in knowns.iter().zip(seed) {
            match self.known(known)? {
                KnownQuantity::Column(column) => self.columns[0][column] += seed,
                KnownQuantity::Time => of_time += seed,
                KnownQuantity::Switch => {}
            }
        }
        let distance = self.distance_rate(0);
        self.update_point();
        self.zero_clamped(0);
        self.zero_at_start();
        let [derivative, _] = &mut self.sensitivities;
        self.evaluator.directional(&self.point, &self.columns[0], derivative);
        for (result, unknown) in sensitivity.iter_mut().zip(self.variables.unknowns(unknowns)) {
            *result = match unknown {
                UnknownQuantity::Result(index) => self.sensitivities[0][index],
                UnknownQuantity::State(state) => self.columns[0][self.metadata.inputs.len() + state],
                UnknownQuantity::Distance => distance,
                UnknownQuantity::Bound(output) => of_time * self.variables.bound_rate(output, self.elapsed()),
                UnknownQuantity::Constant => 0.0,
            };
        }
        self.check_derivatives(sensitivity)
    }

    /// `sensitivity = J^T seed`, `J` as above.
    pub(crate) fn adjoint_derivative(
        &mut self,
        unknowns: &[u32],
        knowns: &[u32],
        seed: &[f64],
        sensitivity: &mut [f64],
    ) -> Result<(), Refusal> {
        self.check_sensitivity(unknowns, knowns, seed)?;
        self.sensitivities[0].fill(0.0);
        let (mut weight_of_distance, mut of_time) = (0.0, 0.0);
        let elapsed = self.elapsed();
        // of the states themselves
        let [_, direct] = &mut self.columns;
        direct.fill(0.0);
        for (unknown, &seed) in self.variables.unknowns(unknowns).zip(seed) {
            let weight = match unknown {
                UnknownQuantity::Bound(output) => {
                    of_time += seed * self.variables.bound_rate(output, elapsed);
                    continue;
                }
                UnknownQuantity::Constant => continue,
                UnknownQuantity::Result(index) => &mut self.sensitivities[0][index],
                UnknownQuantity::State(state) => &mut direct[self.metadata.inputs.len() + state],
                UnknownQuantity::Distance => &mut weight_of_distance,
            };
            *weight += seed;
        }
        self.update_point();
        let [gradient, direct] = &mut self.columns;
        self.evaluator.adjoint(&self.point, &self.sensitivities[0], gradient);
        gradient.iter_mut().zip(direct).for_each(|(gradient, direct)| *gradient += *direct);
        self.zero_clamped(0);
        self.zero_at_start();
        if let Some((column, slope)) = self.domain.distance_derivative(&self.now.values) {
            self.columns[0][column] += slope * weight_of_distance;
        }
        for (result, &known) in sensitivity.iter_mut().zip(knowns) {
            *result = match self.known(known)? {
                KnownQuantity::Column(column) => self.columns[0][column],
                KnownQuantity::Time => of_time,
                KnownQuantity::Switch => 0.0,
            };
        }
        self.check_derivatives(sensitivity)
    }

    /// Derivatives of outputs with respect to time at the present communication point, inputs following the derivatives
    /// that the host gave. There is one order for each variable, and a value for each element.
    pub(crate) fn output_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &mut [f64],
    ) -> Result<(), Refusal> {
        if !self.is_smooth {
            return Err(Refusal::NoOutputDerivatives);
        }
        self.check_unknowns(references)?;
        orders.iter().try_for_each(|&order| index_of_order(order).map(drop))?;
        for order in [0, 1] {
            self.columns[order].copy_from_slice(&self.now.rates[order]);
        }
        if let Some(column) = self.time_column {
            self.columns[0][column] = 1.0;
        }
        self.follow_states()?;
        let first = self.distance_rate(0);
        self.update_point();
        self.zero_clamped(0);
        // along inputs as they are felt
        self.bend_states();
        let distance = [first, self.distance_rate(1)];
        self.zero_clamped(1);
        let [first, second] = &self.columns;
        let [once, twice] = &mut self.sensitivities;
        self.evaluator.along_curve(&self.point, [first, second], [once, twice]);
        let mut places = values.iter_mut();
        for (reference, &order) in references.iter().zip(orders) {
            let order = index_of_order(order)?;
            for (unknown, value) in self.variables.unknowns(slice::from_ref(reference)).zip(&mut places) {
                *value = match unknown {
                    UnknownQuantity::Result(index) => self.sensitivities[order][index],
                    UnknownQuantity::State(state) => self.columns[order][self.metadata.inputs.len() + state],
                    UnknownQuantity::Distance => distance[order],
                    UnknownQuantity::Bound(output) if order == 0 => self.variables.bound_rate(output, self.elapsed()),
                    UnknownQuantity::Bound(_) | UnknownQuantity::Constant => 0.0,
                };
            }
        }
        self.check_derivatives(values)
    }

    /// Puts the derivatives of the states into the columns' work space, beside those of the inputs.
    fn follow_states(&mut self) -> Result<(), Refusal> {
        if !self.metadata.states.is_empty() {
            self.update_results()?;
            let (inputs, outputs) = (self.metadata.inputs.len(), self.metadata.outputs.len());
            self.columns[0][inputs..].copy_from_slice(&self.results[outputs..]);
        }
        Ok(())
    }

    /// Puts the second derivatives of the states into the columns' work space, along the first ones.
    fn bend_states(&mut self) {
        if self.metadata.states.is_empty() {
            return;
        }
        let (inputs, outputs) = (self.metadata.inputs.len(), self.metadata.outputs.len());
        let ([rates, bends], [derivative, _]) = (&mut self.columns, &mut self.sensitivities);
        self.evaluator.directional(&self.point, rates, derivative);
        bends[inputs..].copy_from_slice(&derivative[outputs..]);
    }

    /// Derivatives of inputs with respect to time at the beginning of the next step. They stay until they are set again.
    pub(crate) fn set_input_derivatives(
        &mut self,
        references: &[u32],
        orders: &[i32],
        values: &[f64],
    ) -> Result<(), Refusal> {
        for ((&reference, &order), &value) in references.iter().zip(orders).zip(values) {
            self.driven(reference)?;
            index_of_order(order)?;
            finite("value", value)?;
        }
        for ((&reference, &order), &value) in references.iter().zip(orders).zip(values) {
            let column = self.driven(reference)?;
            self.now.rates[index_of_order(order)?][column] = value;
        }
        Ok(())
    }

    /// The column of a continuous input.
    fn driven(&self, reference: u32) -> Result<usize, Refusal> {
        match self.quantity(reference)? {
            Quantity::Input(column) if self.metadata.inputs[column].role == Role::Input => Ok(column),
            Quantity::Measured(output) => Ok(self.measured.start + output),
            _ => Err(Refusal::NotDifferentiable { name: self.name(reference), reference, expected: "input" }),
        }
    }

    /// Until the simulation runs, outputs of a model of samples are what parameters say, whatever the inputs are.
    fn zero_at_start(&mut self) {
        if self.is_starting() && !self.is_smooth {
            self.input_columns.iter().for_each(|&column| self.columns[0][column] = 0.0);
        }
    }

    /// The direction of a variable.
    fn known(&self, reference: u32) -> Result<KnownQuantity, Refusal> {
        match self.quantity(reference)? {
            // until the simulation runs, the states are what these parameters are
            Quantity::Input(column) if self.metadata.inputs[column].role == Role::Start && self.is_starting() => {
                Ok(KnownQuantity::Column(self.started_by(column)))
            }
            Quantity::Input(column) => Ok(KnownQuantity::Column(column)),
            Quantity::State(state) => Ok(KnownQuantity::Column(self.metadata.inputs.len() + state)),
            // counts from the next sample on: nothing depends on it at once
            Quantity::Measured(output) => Ok(KnownQuantity::Column(self.measured.start + output)),
            Quantity::BuiltIn(BuiltIn::Time) => Ok(KnownQuantity::Time),
            Quantity::BuiltIn(BuiltIn::DomainPolicy | BuiltIn::UseMeasured) => Ok(KnownQuantity::Switch),
            _ => Err(Refusal::NotDifferentiable { name: self.name(reference), reference, expected: KNOWN }),
        }
    }

    fn check_sensitivity(&self, unknowns: &[u32], knowns: &[u32], seed: &[f64]) -> Result<(), Refusal> {
        self.check_unknowns(unknowns)?;
        knowns.iter().try_for_each(|&known| self.known(known).map(drop))?;
        seed.iter().try_for_each(|&seed| finite("seed", seed))
    }

    /// Unknowns are outputs, arrays of them, states, their derivatives, the distance from the domain, and bounds. A host that wants the
    /// derivatives of every variable it sees finds those of `in_domain` to be zero.
    fn check_unknowns(&self, references: &[u32]) -> Result<(), Refusal> {
        references.iter().try_for_each(|&reference| match self.quantity(reference)? {
            Quantity::Output(_)
            | Quantity::Array(_)
            | Quantity::State(_)
            | Quantity::Derivative(_)
            | Quantity::Bound(_)
            | Quantity::BuiltIn(BuiltIn::DomainDistance | BuiltIn::InDomain) => Ok(()),
            _ => Err(Refusal::NotDifferentiable { name: self.name(reference), reference, expected: UNKNOWN }),
        })
    }

    /// Change of the distance from the domain along the columns' work space; to be asked before it is clamped.
    fn distance_rate(&self, order: usize) -> f64 {
        let derivative = self.domain.distance_derivative(&self.now.values);
        derivative.map_or(0.0, |(column, slope)| slope * self.columns[order][column])
    }

    fn zero_clamped(&mut self, order: usize) {
        if self.now.policy != DomainPolicy::Clamp {
            return;
        }
        for ((rate, point), value) in self.columns[order].iter_mut().zip(&self.point).zip(&self.now.values) {
            if point != value {
                *rate = 0.0;
            }
        }
    }
}

/// Zero for the first derivative.
fn index_of_order(order: i32) -> Result<usize, Refusal> {
    match u32::try_from(order) {
        Ok(order @ 1..=MAX_OUTPUT_DERIVATIVE_ORDER) => Ok(order as usize - 1),
        _ => Err(Refusal::Order { found: order, max: MAX_OUTPUT_DERIVATIVE_ORDER }),
    }
}
