//! Speed of a component's steps with its source and with the surrogate, at equal error.

use super::{Difference, RecordedRows, Swap};
use crate::{
    Result,
    fmi::{
        Watch,
        host::InterfaceKind,
        system::{
            master::TIMES,
            run::{ComponentModel, SystemRun},
        },
        worker::run_system_apart,
    },
    integrate::looser_tolerances,
};
use serde::Serialize;
use std::time::{Duration, Instant};

/// Simulations of each component that are timed.
const SIMULATIONS: usize = 3;
/// Wall time after which no further simulations are begun.
const LONG: Duration = Duration::from_secs(10);
/// Tolerance of a component unless it is given, as that of model exchange and mechanisms.
const TOLERANCE: f64 = 1e-8;

/// Wall times of a step, in s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepSpeed {
    /// Step time with the source.
    pub source: StepTime,
    /// Step time with the surrogate.
    pub surrogate: StepTime,
    /// Median with the source by median with the surrogate.
    pub speed_up: f64,
}

/// Wall time of a step, in s.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct StepTime {
    /// Half of the steps are faster.
    pub median: f64,
    /// The fastest step.
    pub minimum: f64,
}

/// Speed of both components in their system.
pub(super) struct TimedSteps {
    pub component_step: StepSpeed,
    pub system_step: StepSpeed,
    /// Tolerance of the source; none if it has a separate solver.
    pub source_tolerance: Option<f64>,
    /// Simulations of each.
    pub simulations: usize,
}

/// Wall times of the steps in several simulations, of the component and of the system.
#[derive(Default)]
struct StepSeconds {
    component: Vec<f64>,
    system: Vec<f64>,
}

impl Swap {
    /// Times the steps of both components, alternately in several simulations. A source that is integrated here has the
    /// loosest tolerance with which no output differs more from `source` than with the surrogate.
    pub(super) fn time(&self, watch: Watch, source: &RecordedRows, differences: &[Difference]) -> Result<TimedSteps> {
        let mut with_source = self.with_source.clone();
        let source_tolerance = self.loosest_tolerance(watch, source, differences)?;
        with_source.components[with_source.measured].tolerance = source_tolerance;
        let (mut of_source, mut of_surrogate) = (StepSeconds::default(), StepSeconds::default());
        let (began, mut simulations) = (Instant::now(), 0);
        while simulations == 0 || simulations < SIMULATIONS && began.elapsed() < LONG {
            of_source.add(&self.simulate(watch, &with_source)?);
            of_surrogate.add(&self.simulate(watch, &self.with_surrogate)?);
            simulations += 1;
        }
        Ok(TimedSteps {
            component_step: StepSpeed::of(of_source.component, of_surrogate.component),
            system_step: StepSpeed::of(of_source.system, of_surrogate.system),
            source_tolerance,
            simulations,
        })
    }

    /// See [`time`](Self::time). Tolerances are tried from the tightest on, as errors grow with them.
    fn loosest_tolerance(
        &self,
        watch: Watch,
        source: &RecordedRows,
        differences: &[Difference],
    ) -> Result<Option<f64>> {
        let Some(given) = self.source_tolerance() else { return Ok(None) };
        let mut loosest = given;
        let looser: Vec<f64> = looser_tolerances(given).collect();
        for &tolerance in looser.iter().rev() {
            let mut run = self.with_source.clone();
            run.components[run.measured].tolerance = Some(tolerance);
            let rows = self.simulate(watch, &run)?;
            let is_as_accurate = |(index, of_surrogate): (usize, &Difference)| {
                let count = rows.times.len().min(source.times.len());
                let values = [source, &rows].map(|recorded| &recorded.values[index][..count]);
                Difference::of("", String::new(), &source.times[..count], values).rms <= of_surrogate.rms
            };
            if !differences.iter().enumerate().all(is_as_accurate) {
                break;
            }
            loosest = tolerance;
        }
        Ok(Some(loosest))
    }

    /// Tolerance of the source in the comparison; none if it has a separate solver.
    fn source_tolerance(&self) -> Option<f64> {
        let SystemRun { components, measured, tolerance, .. } = &self.with_source;
        match &components[*measured].model {
            ComponentModel::Fmu { interface: InterfaceKind::CoSimulation, .. } => None,
            ComponentModel::Fmu { interface: InterfaceKind::ModelExchange, .. } => {
                Some(tolerance.or(self.suggested_tolerance).unwrap_or(TOLERANCE))
            }
            ComponentModel::Mechanism { .. } => Some(tolerance.unwrap_or(TOLERANCE)),
        }
    }

    fn simulate(&self, watch: Watch, run: &SystemRun) -> Result<RecordedRows> {
        let mut recorded = RecordedRows::default();
        run_system_apart(&self.system.path, run, watch, &mut recorded)?;
        Ok(recorded)
    }
}

impl StepSeconds {
    /// Adds the steps of a simulation. No step leads to its first row.
    fn add(&mut self, rows: &RecordedRows) {
        self.component.extend(rows.column(TIMES[0]).iter().skip(1));
        self.system.extend(rows.column(TIMES[1]).iter().skip(1));
    }
}

impl StepSpeed {
    fn of(source: Vec<f64>, surrogate: Vec<f64>) -> Self {
        let [source, surrogate] = [source, surrogate].map(StepTime::of);
        // a clock may stand still
        Self { source, surrogate, speed_up: source.median / surrogate.median.max(1e-9) }
    }
}

impl StepTime {
    /// Median and minimum of the times of at least one step.
    fn of(mut seconds: Vec<f64>) -> Self {
        seconds.sort_by(f64::total_cmp);
        Self { median: seconds[seconds.len() / 2], minimum: seconds[0] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmi::host::RecordedColumn;

    #[test]
    fn the_first_row_of_a_simulation_is_no_step() {
        let column = |name: &str| RecordedColumn { name: name.into(), unit: None };
        let rows = |seconds: [f64; 4]| RecordedRows {
            columns: TIMES.map(column).to_vec(),
            times: vec![0.0, 1.0, 2.0, 3.0],
            values: vec![seconds.to_vec(), seconds.map(|seconds| 2.0 * seconds).to_vec()],
        };
        let (mut source, mut surrogate) = (StepSeconds::default(), StepSeconds::default());
        source.add(&rows([0.0, 4.0, 6.0, 5.0]));
        surrogate.add(&rows([0.0, 0.5, 2.0, 1.0]));
        let speed = StepSpeed::of(source.component, surrogate.component);
        assert_eq!(speed.source, StepTime { median: 5.0, minimum: 4.0 });
        assert_eq!((speed.surrogate.minimum, speed.speed_up), (0.5, 5.0));
        assert_eq!(source.system, [8.0, 12.0, 10.0]);
    }
}
