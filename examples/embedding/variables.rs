//! Variables of FMUs by their names, for the programs that couple FMUs.

use metafmu::{
    Error, Result,
    fmi::{Fmu, FmuInstance},
};

/// Value references of an FMU's variables.
pub fn references<const N: usize>(fmu: &Fmu, names: [&str; N]) -> Result<[u32; N]> {
    let description = fmu.description();
    let mut references = [0; N];
    for (reference, name) in references.iter_mut().zip(names) {
        let variable = description.variable(name).ok_or_else(|| Error::UnknownVariable {
            name: name.into(),
            known: description.variables.iter().map(|variable| variable.name.clone()).collect(),
        })?;
        *reference = variable.value_reference;
    }
    Ok(references)
}

/// Their values.
pub fn values<const N: usize>(instance: &FmuInstance, references: [u32; N]) -> Result<[f64; N]> {
    let mut values = [0.0; N];
    instance.get_real(&references, &mut values)?;
    Ok(values)
}
