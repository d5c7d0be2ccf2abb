//! The interface of a study of a static map.

use super::{InterfaceDomain, InterfaceInput, InterfaceOutput, InterfaceTime, ModelInterface};
use crate::{study::Study, variable::SourceVariable};
use indexmap::IndexMap;

impl ModelInterface {
    /// The interface of a study of a static map, whose columns have these units and descriptions. What is wrong with it has the study's lines.
    pub fn of_study(study: &Study, inputs: &[SourceVariable], outputs: &[SourceVariable]) -> Self {
        let time = InterfaceTime { step: Some(study.time.step), stop: study.time.stop, ..InterfaceTime::default() };
        Self {
            name: study.name.clone(),
            description: study.description.clone(),
            time,
            domain: InterfaceDomain::default(),
            layers: Vec::new(),
            inputs: inputs
                .iter()
                .map(|variable| {
                    let SourceVariable { name, unit, description, .. } = variable.clone();
                    let (min, max, start) = study
                        .inputs
                        .get(&name)
                        .map_or_else(Default::default, |input| (input.min, input.max, input.start));
                    (name, InterfaceInput { unit, description, min, max, start, ..InterfaceInput::default() })
                })
                .collect(),
            states: IndexMap::new(),
            outputs: outputs
                .iter()
                .map(|variable| {
                    let SourceVariable { name, unit, description, .. } = variable.clone();
                    (name, InterfaceOutput { unit, description, ..InterfaceOutput::default() })
                })
                .collect(),
            origin: study.origin().clone(),
        }
    }
}
