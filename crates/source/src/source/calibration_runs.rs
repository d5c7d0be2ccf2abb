//! Calibration runs that are driven by other kinds of signals than those of the study.

use super::{
    driven::Driven,
    kinds::{Corner, Kinds, bits},
};
use crate::{
    evaluation::SignalKind,
    sampling::Plan,
    study::{BoundsOptions, ParameterOptions, Study},
};
use std::collections::HashMap;

/// Number of inputs up to which runs that differ in nothing else try all corners.
const MOST_CORNERS: usize = 4;

/// Runs of each further kind beyond the fewest that bounds can be measured on: some may fail.
const RESERVE: f64 = 1.2;

/// More runs than this are refused with the other mistakes of a study.
const MOST_RUNS: u64 = 10_000_000;

/// The plan of a study and the kinds of its runs. For a surrogate with inputs and error bounds, calibration runs of
/// zero input, free decay and constant inputs follow those with the study's signals.
pub fn plan(study: &Study, driven: Option<&Driven>) -> (Plan, Kinds) {
    with_kinds(study, driven).unwrap_or_else(|| (Plan::new(study), Kinds::default()))
}

/// The kinds of the runs of a study that may have mistakes, more runs than any plan has among them.
pub fn kinds(study: &Study, driven: Option<&Driven>) -> Kinds {
    let least = study.bounds.map_or(0, |bounds| BoundsOptions::least_runs(bounds.coverage));
    let runs = [study.train_runs(), study.sampling.test_runs as u64, study.calibration_runs() as u64, least as u64];
    if runs.into_iter().any(|runs| runs > MOST_RUNS) {
        return Kinds::default();
    }
    with_kinds(study, driven).map_or_else(Kinds::default, |(_, kinds)| kinds)
}

/// None if all runs have signals of the study.
fn with_kinds(study: &Study, driven: Option<&Driven>) -> Option<(Plan, Kinds)> {
    let driven = driven.filter(|driven| study.runs().have_memory && !driven.drivers().is_empty())?;
    let BoundsOptions { coverage, .. } = study.bounds?;
    let parameters_vary = study.parameters.values().any(varies);
    let starts_vary = study.starts().values().any(varies);
    let many = (RESERVE * BoundsOptions::least_runs(coverage) as f64).ceil() as usize;
    let count = |kind: SignalKind| {
        let differ = match kind {
            SignalKind::Zero => parameters_vary,
            // signals come before the decay where starts cannot be chosen
            SignalKind::Decay => parameters_vary || starts_vary || study.runs().are_samples,
            SignalKind::Ends => {
                let corners = 1 << driven.drivers().len().min(MOST_CORNERS);
                return if parameters_vary || starts_vary { 2 * many } else { corners };
            }
            SignalKind::Signals => return 0,
        };
        // runs that do not differ are one
        if differ { many } else { 1 }
    };
    let further: Vec<(SignalKind, Corner)> = SignalKind::ALL
        .into_iter()
        .flat_map(|kind| (0..count(kind)).map(move |number| (kind, Corner(number))))
        .collect();
    let own = study.calibration_runs();
    let mut plan = Plan::with_calibration(study, own + further.len());
    let mut kinds = HashMap::new();
    for (run, kind) in (own..plan.calibration.len()).zip(further) {
        let point = &mut plan.calibration[run];
        if kind.0 == SignalKind::Zero && study.runs().start_from_states {
            let first = point.len() - driven.start().len();
            point[first..].copy_from_slice(driven.start());
        }
        kinds.insert(bits(point), kind);
    }
    Some((plan, Kinds(kinds)))
}

/// Returns true if a parameter has several values.
fn varies(options: &ParameterOptions) -> bool {
    options.min < options.max || options.values.len() > 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Simulation;
    use std::path::Path;

    fn crane(more: &str) -> (Study, Simulation) {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/dynamics");
        let text = format!(
            "name = \"s\"\nstructure = \"dynamics\"\n[source]\nmechanism = \"crane.toml\"\n[time]\nstop = 2\nstep = 0.1\n[states]\n\
             rail.position = {{ min = -5, max = 5 }}\nrope.angle = {{ min = -1, max = 1 }}\n[inputs]\nforce = {{ min = -4, max = 10 }}\n\
             [outputs]\nx = {{}}\n{more}"
        );
        let study = Study::parse(&text, &root.join("s.toml")).unwrap();
        let simulation = Simulation::new(&study).unwrap();
        (study, simulation)
    }

    #[test]
    fn corners_of_three_inputs_come_in_opposite_pairs() {
        let corner = |number: usize| [0, 1, 2].map(|input| Corner(number).is_high(input));
        let mut corners: Vec<[bool; 3]> = (0..8).map(corner).collect();
        assert_eq!(corners[..2], [[false; 3], [true; 3]]);
        assert!((0..4).all(|pair| corners[2 * pair] == corners[2 * pair + 1].map(|is_high| !is_high)));
        corners.sort_unstable();
        corners.dedup();
        assert_eq!(corners.len(), 8);
        assert!(!Corner(0).is_high(100) && Corner(1).is_high(100));
    }

    #[test]
    fn calibration_runs_have_zero_input_free_decay_and_both_ends_of_the_range() {
        let (study, simulation) = crane("[bounds]\ncoverage = 0.9\nruns = 30\n");
        let (own, plan) = (Plan::new(&study), simulation.plan(&study));
        assert_eq!((&plan.train, &plan.test, plan.calibration.part(0..30)), (&own.train, &own.test, own.calibration));
        // of the same parameters, the run from the source's own start is one; of the others a fifth more than nine
        assert_eq!(plan.calibration.len(), 30 + 1 + 3 * 11);
        let driven = simulation.driven().unwrap();
        let inputs = |index: usize| driven.inputs(&plan.calibration[index], &study.time.grid());
        assert!(inputs(0).windows(2).any(|pair| pair[0] != pair[1]));
        assert_eq!(&plan.calibration[30][..], driven.start());
        for (index, value) in
            [(30, 0.0), (31, 0.0), (41, 0.0), (42, -4.0), (43, 10.0), (44, 10.0), (45, -4.0), (63, 10.0)]
        {
            assert!(inputs(index).iter().all(|found| *found == value), "run {index}");
        }
        assert_ne!(plan.calibration[31], plan.calibration[32]);
        // the run is simulated with the same inputs, and there are none of these without bounds
        assert_eq!(simulation.run(&plan.calibration[60]).unwrap().inputs, inputs(60));
        let (study, simulation) = crane("");
        assert!(simulation.plan(&study).calibration.is_empty());
    }
}
