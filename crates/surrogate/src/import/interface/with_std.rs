//! Predicted standard deviations as outputs of an interface.

use super::{InterfaceOutput, ModelInterface};
use crate::{Result, diagnostics::Problems};
use metafmu_runtime::Output;

impl ModelInterface {
    /// Interface with the predicted standard deviation of each output behind the outputs.
    ///
    /// # Errors
    /// [`crate::Error::Study`] if an input or output has the name of one of them.
    pub fn with_std(&self) -> Result<Self> {
        let mut interface = self.clone();
        let mut problems = Problems::default();
        for ((name, output), index) in self.outputs.iter().zip(0..) {
            let std = Output::std_name(name);
            for (section, is_taken) in
                [("inputs", self.inputs.contains_key(&std)), ("outputs", self.outputs.contains_key(&std))]
            {
                let message = format!("is the name of the predicted standard deviation of `{name}`");
                problems.expect_absent(is_taken, format!("{section}.{std}"), &message);
            }
            let description = format!("predicted standard deviation of {name}");
            let output = InterfaceOutput { column: None, unit: output.unit.clone(), description, std_of: Some(index) };
            interface.outputs.insert(std, output);
        }
        self.refuse(problems)?;
        Ok(interface)
    }
}
