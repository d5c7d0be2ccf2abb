//! Checks of values against the domain of the surrogate, and the consequences.

use super::Instance;
use crate::{
    snapshot::Snapshot,
    status::{Refusal, Status, Warning},
};
use metafmu_runtime::{DomainPolicy, Metadata};

impl Instance {
    /// Returns true if a value at this time differs from its value at the start of the run. If the time is an input of
    /// the network, the outputs are those of a run in which nothing changes.
    #[inline]
    pub(super) fn is_changed(&self, column: usize, value: f64, time: f64) -> bool {
        self.time_column.is_some_and(|other| other != column)
            && time > self.now.start_time
            && value != self.now.at_start[column]
    }

    pub(super) fn is_in_domain(&self) -> bool {
        let Snapshot { changed, time, values, .. } = &self.now;
        !changed
            && self.domain.contains_point(values, self.near)
            && !values.iter().enumerate().any(|(column, value)| self.is_changed(column, *value, *time))
    }

    #[inline(always)]
    pub(super) fn check_value(
        &self,
        column: usize,
        value: f64,
        time: f64,
        policy: DomainPolicy,
        status: Status,
    ) -> Result<(), Refusal> {
        if policy == DomainPolicy::Error { self.check_strictly(column, value, time, status) } else { Ok(()) }
    }

    // not compiled into every step, which it would slow down under each policy
    #[inline(never)]
    fn check_strictly(&self, column: usize, value: f64, time: f64, status: Status) -> Result<(), Refusal> {
        if !self.domain.contains(column, value) {
            let name = self.column_name(column);
            return Err(Refusal::OutsideDomain { name, value, valid: self.valid(column), status });
        }
        if self.is_changed(column, value, time) {
            let name = self.column_name(column);
            return Err(Refusal::Changed { name, from: self.now.at_start[column], to: value, status });
        }
        Ok(())
    }

    /// Checks all current values as [`Self::check_value`] does; the time counts once it is known.
    pub(super) fn check_point(&self, policy: DomainPolicy) -> Result<(), Refusal> {
        for (column, &value) in self.now.values.iter().enumerate() {
            if self.time_column != Some(column) || self.now.experiment {
                self.check_value(column, value, self.now.time, policy, Status::Error)?;
            }
        }
        if policy == DomainPolicy::Error && self.now.changed {
            return Err(Refusal::ChangedBefore);
        }
        Ok(())
    }

    /// Logs a warning for the first call that leaves the domain; one message for each step would flood the log.
    #[inline]
    pub(super) fn note_value(&mut self, column: usize) {
        let value = self.now.values[column];
        if self.is_changed(column, value, self.now.time) {
            self.note_change(column);
        }
        if self.now.policy == DomainPolicy::Warn && !self.warned[column] && !self.domain.contains(column, value) {
            self.warn_outside(column);
        }
    }

    #[cold]
    fn warn_outside(&mut self, column: usize) {
        self.warned[column] = true;
        let is_nominal = self.metadata.inputs.get(column).is_some_and(|input| input.nominal_values().is_some());
        let instead = if is_nominal { "those of the nearest" } else { "extrapolated" };
        let (name, value, valid) = (self.column_name(column), self.now.values[column], self.valid(column));
        self.warnings.push(Warning::OutsideDomain { name, value, valid, instead });
    }

    /// Checks that training data are near the inputs. This concerns all inputs together, so it is checked where they
    /// are used, not where they are set one after the other. Values outside their ranges are handled elsewhere.
    #[inline(always)]
    pub(super) fn note_data(&mut self, refused: Status) -> Result<(), Refusal> {
        // a history that becomes measured is no prediction yet
        let is_silent = self.now.policy == DomainPolicy::Clamp || self.warned_of_data || self.is_measured();
        if is_silent || !self.domain.knows_data() { Ok(()) } else { self.look_for_data(refused) }
    }

    #[inline(never)]
    fn look_for_data(&mut self, refused: Status) -> Result<(), Refusal> {
        if !self.domain.is_in_ranges(&self.now.values) || self.domain.is_near_data(&self.now.values, &mut self.near) {
            return Ok(());
        }
        let distance = self.domain.distance(&self.now.values, self.near);
        if self.now.policy == DomainPolicy::Error {
            return Err(Refusal::FarFromData { distance, status: refused });
        }
        self.warned_of_data = true;
        self.warnings.push(Warning::FarFromData { distance });
        Ok(())
    }

    /// Returns true if the outputs are measured.
    pub(super) fn is_measured(&self) -> bool {
        !self.measured.is_empty() && self.now.values[self.measured.end] == 1.0
    }

    /// Records a change during the run and warns once, whatever the policy: nothing can be clamped here.
    pub(super) fn note_change(&mut self, column: usize) {
        self.now.changed = true;
        if !self.warned_of_change {
            self.warned_of_change = true;
            let (from, to) = (self.now.at_start[column], self.now.values[column]);
            self.warnings.push(Warning::Changed { name: self.column_name(column), from, to });
        }
    }

    /// Description of the valid values of a column.
    fn valid(&self, column: usize) -> String {
        let Metadata { inputs, states, .. } = &self.metadata;
        inputs.get(column).map_or_else(|| states[column - inputs.len()].valid(), |input| input.valid())
    }
}
