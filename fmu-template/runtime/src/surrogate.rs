//! The surrogate as data: variables, program, provenance.

use crate::{
    Bounds, Clock, Domain, Evaluator, FormatError, Input, Metadata, Output, OutputArray, Ports, Program, Role,
    ScaledNetwork, State,
    variables::{Variable, Variables},
};
use sha2::{Digest, Sha256};
use std::{collections::HashMap, fmt::Write, mem};

/// A program with everything needed to use it: which variable each column is, in what unit, and over what range it was
/// trained.
///
/// A value of this type has been validated: shapes fit, every number is finite, names are unique, ranges are not empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Surrogate {
    metadata: Metadata,
    program: Program,
    /// Output columns of each array, in the order of its elements; made from the metadata.
    array_columns: Vec<Vec<usize>>,
    /// Made from the metadata.
    variables: Variables,
}

/// In place of the digest of a surrogate that has none yet.
const UNSEALED: &str = "0000000000000000000000000000000000000000000000000000000000000000";

impl Surrogate {
    /// Puts the parts together and validates them.
    ///
    /// # Errors
    /// The first [`FormatError`] that says how the parts do not fit each other.
    pub fn new(metadata: Metadata, program: impl Into<Program>) -> Result<Self, FormatError> {
        let program = program.into();
        let variables = Variables::of(&metadata, program.sampling().is_some());
        validate_metadata(&metadata, &variables)?;
        let array_columns = array_columns(&metadata)?;
        program.check(&metadata)?;
        Ok(Self { metadata, program, array_columns, variables })
    }

    /// Name, variables, provenance.
    pub fn metadata(&self) -> &Metadata {
        &self.metadata
    }

    /// Name, variables, provenance.
    pub fn into_metadata(self) -> Metadata {
        self.metadata
    }

    /// The inputs, in order.
    pub fn inputs(&self) -> &[Input] {
        &self.metadata.inputs
    }

    /// The network's output columns, in order.
    pub fn outputs(&self) -> &[Output] {
        &self.metadata.outputs
    }

    /// The outputs that predict quantities. Their predicted standard deviations follow them, if the model has any.
    pub fn predictions(&self) -> &[Output] {
        self.metadata.predictions()
    }

    /// Position of the predicted standard deviation of an output, if it has one.
    pub fn std_column(&self, output: usize) -> Option<usize> {
        self.outputs().iter().position(|other| other.std_of.is_some_and(|of| of as usize == output))
    }

    /// The continuous states, in order.
    pub fn states(&self) -> &[State] {
        &self.metadata.states
    }

    /// Outputs grouped into arrays, in order.
    pub fn arrays(&self) -> &[OutputArray] {
        &self.metadata.arrays
    }

    /// Error bounds of the outputs, if they were measured.
    pub fn bounds(&self) -> Option<&Bounds> {
        self.metadata.bounds.as_ref()
    }

    /// Position of the time column among the inputs, if time is an input.
    pub fn time_column(&self) -> Option<usize> {
        self.inputs().iter().position(|input| input.role == Role::Time)
    }

    /// The program that computes the outputs.
    pub fn program(&self) -> &Program {
        &self.program
    }

    /// Number of variables by role.
    pub fn ports(&self) -> Ports {
        Ports::of(&self.metadata)
    }

    /// The network, if it is a single one.
    pub fn network(&self) -> Option<ScaledNetwork> {
        if self.program.clock == Clock::Static { self.program.graph.network() } else { None }
    }

    /// The variables of its FMU, in the order of their value references.
    pub fn variables(&self) -> &Variables {
        &self.variables
    }

    /// Unit of all elements of array `index`, and which outputs they are.
    ///
    /// # Panics
    /// If there is no such array.
    pub fn array_elements(&self, index: usize) -> (&str, &[usize]) {
        let columns = &self.array_columns[index];
        (&self.outputs()[columns[0]].unit, columns)
    }

    /// FMI 2.0 `guid` and FMI 3.0 `instantiationToken`: the first 128 bits of the content digest, so that a description
    /// and a model file that do not belong together are told apart.
    pub fn instantiation_token(&self) -> String {
        let digits = &self.metadata.provenance.content_digest;
        let parts = [&digits[..8], &digits[8..12], &digits[12..16], &digits[16..20], &digits[20..32]];
        format!("{{{}}}", parts.join("-"))
    }

    /// The surrogate with the digest of its content: the last step of making one. The digest is the SHA-256 of the model file with
    /// sixty-four zeros in its place, in hexadecimal digits.
    ///
    /// # Errors
    /// As [`Surrogate::to_bytes`].
    pub fn sealed(self) -> Result<Self, FormatError> {
        let blank = self.with_content_digest(UNSEALED.into())?;
        let digest = hexadecimal(Sha256::digest(blank.to_bytes()?));
        blank.with_content_digest(digest)
    }

    /// Makes sure that nothing in its model file changed since the digest was put in. Of a file without one nothing is known.
    ///
    /// # Errors
    /// [`FormatError::Damaged`] if the content has another digest.
    pub(crate) fn check_content(&self, file: &[u8]) -> Result<(), FormatError> {
        let noted = &self.metadata.provenance.content_digest;
        if noted == UNSEALED {
            return Ok(());
        }
        // in a JSON text within a JSON text
        let entry = [r#"\"content_digest\":\""#, noted].concat();
        let (before, after) = match file.windows(entry.len()).position(|part| part == entry.as_bytes()) {
            Some(start) => (&file[..start + entry.len() - noted.len()], &file[start + entry.len()..]),
            None => (file, &[] as &[u8]),
        };
        let digest = Sha256::new().chain_update(before).chain_update(UNSEALED).chain_update(after).finalize();
        let found = hexadecimal(digest);
        if *noted == found { Ok(()) } else { Err(FormatError::Damaged { found, expected: noted.clone() }) }
    }

    /// Replaces the error bounds; the surrogate must be sealed again.
    ///
    /// # Errors
    /// [`FormatError::BoundCount`] or [`FormatError::Bound`] if the bounds do not fit the outputs.
    pub fn with_bounds(mut self, bounds: Bounds) -> Result<Self, FormatError> {
        self.metadata.bounds = Some(bounds);
        Self::new(self.metadata, self.program)
    }

    /// Replaces the content digest.
    ///
    /// # Errors
    /// [`FormatError::Digest`] if it is not 64 hexadecimal digits.
    pub fn with_content_digest(mut self, digest: String) -> Result<Self, FormatError> {
        self.metadata.provenance.content_digest = digest;
        Self::new(self.metadata, self.program)
    }
}

impl Evaluator {
    /// Lays out the weights and chooses the instruction set.
    pub fn new(surrogate: &Surrogate) -> Self {
        Self::of(&surrogate.metadata, &surrogate.program)
    }
}

impl Domain {
    /// Domain of a surrogate.
    pub fn of(surrogate: &Surrogate) -> Self {
        let ranges = Self::new(surrogate.inputs(), surrogate.states());
        let cover = surrogate.metadata.cover.iter();
        let domain = cover.fold(ranges, |ranges, cover| ranges.near(cover, surrogate.inputs()));
        let distance = surrogate.program.sampling().and_then(|sampling| sampling.distance_column(&surrogate.ports()));
        distance.into_iter().fold(domain, Self::with_distance)
    }
}

fn hexadecimal(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |mut text, byte| {
        // writing to a string does not fail
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// Positions by name: one type for all, since each type of table is a kilobyte and a half of every FMU.
type PositionByName<'a> = HashMap<&'a str, usize>;

fn validate_metadata(metadata: &Metadata, variables: &Variables) -> Result<(), FormatError> {
    if metadata.inputs.is_empty() {
        return Err(FormatError::NoVariables { what: "inputs" });
    }
    if metadata.outputs.is_empty() {
        return Err(FormatError::NoVariables { what: "outputs" });
    }
    let (built_in, own): (Vec<_>, Vec<_>) = variables.iter().partition(|(_, variable)| variable.is_built_in());
    let mut names: PositionByName = built_in.iter().map(|(_, variable)| (variable.name.as_str(), 0)).collect();
    for (position, (_, Variable { name, .. })) in (1..).zip(&own) {
        match names.insert(name, position) {
            None => {}
            Some(0) => return Err(FormatError::ReservedName { name: name.clone() }),
            Some(_) => return Err(FormatError::DuplicateVariable { name: name.clone() }),
        }
    }
    let stds = metadata.outputs[metadata.predictions().len()..].iter().enumerate();
    for (index, Output { name, std_of, .. }) in stds {
        if *std_of != Some(index as u32) || index >= metadata.predictions().len() {
            return Err(FormatError::MisplacedStd { name: name.clone() });
        }
    }
    let inputs = metadata.inputs.iter().map(|v| (&v.name, v.min, v.max));
    let outputs = metadata.outputs.iter().map(|v| (&v.name, v.min, v.max));
    for (name, min, max) in inputs.chain(outputs) {
        if !(min.is_finite() && max.is_finite() && min <= max) {
            return Err(FormatError::EmptyRange { name: name.clone(), min, max });
        }
    }
    for State { name, range, nominal, .. } in &metadata.states {
        if let Some([min, max]) = *range
            && !(min.is_finite() && max.is_finite() && min <= max)
        {
            return Err(FormatError::EmptyRange { name: name.clone(), min, max });
        }
        if !(nominal.is_finite() && *nominal > 0.0) {
            return Err(FormatError::Nominal { name: name.clone(), found: *nominal });
        }
    }
    for input in &metadata.inputs {
        input.check_encoding()?;
        if !(input.min..=input.max).contains(&input.start) {
            let Input { name, start, min, max, .. } = input.clone();
            return Err(FormatError::StartOutsideRange { name, start, min, max });
        }
    }
    let times = metadata.inputs.iter().filter(|input| input.role == Role::Time).count();
    if times > 1 {
        return Err(FormatError::SeveralTimes { count: times });
    }
    if let Some(bounds) = &metadata.bounds {
        bounds.check(metadata.predictions().len())?;
    }
    if let Some(cover) = &metadata.cover {
        cover.check(&metadata.inputs)?;
    }
    if !(metadata.time_step.is_finite() && metadata.time_step > 0.0) {
        return Err(FormatError::TimeStep { found: metadata.time_step });
    }
    if let Some(found) = metadata.stop_time.filter(|stop| !(stop.is_finite() && *stop > 0.0)) {
        return Err(FormatError::TimeStep { found });
    }
    let digest = &metadata.provenance.content_digest;
    if digest.len() != 64 || !digest.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(FormatError::Digest { found: digest.clone() });
    }
    Ok(())
}

/// The output columns of each array.
fn array_columns(metadata: &Metadata) -> Result<Vec<Vec<usize>>, FormatError> {
    let positions: PositionByName =
        metadata.outputs.iter().enumerate().map(|(column, output)| (output.name.as_str(), column)).collect();
    metadata.arrays.iter().map(|array| columns_of(array, &metadata.outputs, &positions)).collect()
}

fn columns_of(array: &OutputArray, outputs: &[Output], positions: &PositionByName) -> Result<Vec<usize>, FormatError> {
    if array.outputs.len() < 2 {
        return Err(FormatError::ShortArray { array: array.name.clone(), count: array.outputs.len() });
    }
    let mut columns = Vec::with_capacity(array.outputs.len());
    let mut is_used = vec![false; outputs.len()];
    for output in &array.outputs {
        let Some(&column) = positions.get(output.as_str()) else {
            return Err(FormatError::UnknownElement { array: array.name.clone(), output: output.clone() });
        };
        if mem::replace(&mut is_used[column], true) {
            return Err(FormatError::DuplicateElement { array: array.name.clone(), output: output.clone() });
        }
        columns.push(column);
        let (found, expected) = (&outputs[column].unit, &outputs[columns[0]].unit);
        if found != expected {
            let (output, found, expected) = (output.clone(), found.clone(), expected.clone());
            return Err(FormatError::ElementUnit { array: array.name.clone(), output, found, expected });
        }
    }
    Ok(columns)
}
