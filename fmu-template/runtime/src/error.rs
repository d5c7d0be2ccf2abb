//! Errors in a model file.

use crate::exact;
use safetensors::SafeTensorError;

/// Version of the layout described in this module.
pub const FORMAT: u32 = 7;

pub(crate) const METADATA_KEY: &str = "metafmu";

/// Every way in which a model file can be wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The container is cut short or is not safetensors at all.
    #[error("not a safetensors container, or cut short: {0}")]
    Container(SafeTensorError),
    /// A safetensors file of another program.
    #[error("the container's metadata has no entry `{METADATA_KEY}`: not a metafmu surrogate")]
    NoMetadata,
    /// The description is no valid JSON, or a field is missing, unknown or of the wrong type.
    #[error("metadata entry `{METADATA_KEY}`: {0}")]
    Metadata(serde_json::Error),
    /// Written by an older program.
    #[error(
        "model file format {found}, expected {FORMAT}: an older metafmu wrote it; make it again with this one, by \
         `metafmu build STUDY`, or `metafmu import MODEL`"
    )]
    OldVersion {
        /// Format in the file.
        found: u32,
    },
    /// Written by a newer program.
    #[error("model file format {found}, expected {FORMAT}: a newer metafmu wrote it; use that one")]
    NewVersion {
        /// Format in the file.
        found: u32,
    },
    /// A required tensor is missing.
    #[error("tensor `{name}` is missing")]
    MissingTensor {
        /// The tensor's name.
        name: String,
    },
    /// A tensor that means nothing here.
    #[error("tensor `{name}` is not part of the format")]
    UnknownTensor {
        /// The tensor's name.
        name: String,
    },
    /// Wrong element type.
    #[error("tensor `{name}` is of type {found}, expected {expected}")]
    Type {
        /// The tensor's name.
        name: String,
        /// Type in the file.
        found: String,
        /// Type that the format requires.
        expected: String,
    },
    /// Wrong shape.
    #[error("tensor `{name}` has shape {found:?}, expected {expected:?}")]
    Shape {
        /// The tensor's name.
        name: String,
        /// Shape in the file.
        found: Vec<usize>,
        /// Shape that fits the variables and the neighboring layers.
        expected: Vec<usize>,
    },
    /// A NaN or an infinity.
    #[error("tensor `{name}`, element {index}: {value} is not finite")]
    NotFinite {
        /// The tensor's name.
        name: String,
        /// Position in row-major order.
        index: usize,
        /// Value in the file.
        value: f64,
    },
    /// A scale that is zero or negative.
    #[error("tensor `{name}`, element {index}: {value} is not positive")]
    NotPositive {
        /// The tensor's name.
        name: String,
        /// Position.
        index: usize,
        /// Value in the file.
        value: f64,
    },
    /// More numbers than the limit.
    #[error("the values of the graph have {found} numbers together, expected at most {limit}")]
    TooLarge {
        /// How many.
        found: usize,
        /// How many there may be.
        limit: usize,
    },
    /// The clock of the program is missing.
    #[error("metadata entry `{METADATA_KEY}`: the field `clock` is missing")]
    NoClock,
    /// A kind of output that this version does not know.
    #[error("tensor `{name}`, element {index}: {found} is not known")]
    Unknown {
        /// The tensor's name.
        name: String,
        /// Position.
        index: usize,
        /// Value in the file.
        found: u32,
    },
    /// A periodic lookup table with other values at its end.
    #[error("a periodic lookup table, element {index}: its ends differ")]
    OpenPeriod {
        /// Position of the value at the end.
        index: usize,
    },
    /// A formula whose steps do not fit together.
    #[error("formula, step {index}: {found} values, expected {expected}")]
    Formula {
        /// The step.
        index: usize,
        /// Values on the stack.
        found: usize,
        /// Operands of the step, or the one value at the end.
        expected: usize,
    },
    /// A function that a step calls has such a step itself.
    #[error("`{name}` has a step that calls a function, or equations: expected none in a function that is called")]
    NestedFunction {
        /// The function.
        name: String,
    },
    /// Variables of a program with a state in another order.
    #[error("the inputs of a program with a state are not parameters, values at the start and inputs, in this order")]
    Order,
    /// Support with a descending range, or with less than one sample.
    #[error("the support of the training has a range that does not ascend, or a number of samples below 1")]
    Support,
    /// The value at the start of nothing.
    #[error("variable `{name}` is the value of a state at the start, but the model has no states")]
    NoState {
        /// The variable.
        name: String,
    },
    /// A nominal value that is zero, negative or not finite.
    #[error("state `{name}`: the nominal value {found} is not positive")]
    Nominal {
        /// The state.
        name: String,
        /// Value in the file.
        found: f64,
    },
    /// A graph that must be a network.
    #[error("`{name}` is not a network: layers of standardized columns, one after the other, with rescaled outputs")]
    NoNetwork {
        /// The graph.
        name: String,
    },
    /// No inputs or no outputs.
    #[error("the list of {what} is empty")]
    NoVariables {
        /// `inputs` or `outputs`.
        what: &'static str,
    },
    /// Two variables of one name.
    #[error("variable `{name}` is duplicated")]
    DuplicateVariable {
        /// The name.
        name: String,
    },
    /// A variable named like one that every FMU adds.
    #[error("variable `{name}`: the name is reserved for a variable that the FMU adds")]
    ReservedName {
        /// The name.
        name: String,
    },
    /// A range that is empty or not finite.
    #[error("variable `{name}`: range from {min} to {max} is empty or not finite", min = exact(*min), max = exact(*max))]
    EmptyRange {
        /// The variable.
        name: String,
        /// Lower end.
        min: f64,
        /// Upper end.
        max: f64,
    },
    /// A start value outside the range.
    #[error(
        "variable `{name}`: start {start} is not between {min} and {max}",
        start = exact(*start), min = exact(*min), max = exact(*max)
    )]
    StartOutsideRange {
        /// The variable.
        name: String,
        /// The start value.
        start: f64,
        /// Lower end.
        min: f64,
        /// Upper end.
        max: f64,
    },
    /// An encoding that does not fit its input.
    #[error("variable `{name}`: its encoding makes no sense, {expected}")]
    Encoding {
        /// The variable.
        name: String,
        /// Expected condition.
        expected: &'static str,
    },
    /// More than one time column.
    #[error("{count} inputs are the time, expected at most one")]
    SeveralTimes {
        /// How many.
        count: usize,
    },
    /// A series in time of nothing.
    #[error("a network for each instant, but no input beside the time")]
    OnlyTime,
    /// Instants between which there is nothing to interpolate.
    #[error("{count} instants, expected at least 2")]
    FewInstants {
        /// How many.
        count: usize,
    },
    /// Instants or knots out of order.
    #[error("tensor `{name}`, element {index}: {found} is not above {before}")]
    NotAscending {
        /// The tensor's name.
        name: String,
        /// Position.
        index: usize,
        /// The one before it.
        before: f64,
        /// Value in the file.
        found: f64,
    },
    /// More or fewer networks than instants.
    #[error("{found} networks, expected {expected}, one for each instant")]
    NetworkCount {
        /// Networks.
        found: usize,
        /// Instants.
        expected: usize,
    },
    /// Something about the network of one instant.
    #[error("instant {instant}: {source}")]
    OfInstant {
        /// Counted from 0.
        instant: usize,
        /// Error of the network.
        source: Box<FormatError>,
    },
    /// Networks of different sizes.
    #[error("instant {instant}: values of lengths {found:?}, expected {expected:?} as at the first instant")]
    LayerSizes {
        /// Counted from 0.
        instant: usize,
        /// Lengths of its columns and of the values that its steps make.
        found: Vec<usize>,
        /// Lengths at the first time point.
        expected: Vec<usize>,
    },
    /// Networks of different steps.
    #[error("instant {instant}: steps of other kinds or precisions than at the first instant")]
    StepKinds {
        /// Counted from 0.
        instant: usize,
    },
    /// An index that points at nothing.
    #[error("tensor `{name}`, element {index}: {found}, expected less than {limit}")]
    Index {
        /// The tensor's name.
        name: String,
        /// Position.
        index: usize,
        /// Index in the file.
        found: u64,
        /// Number of elements it may point at.
        limit: u64,
    },
    /// A tree that does not lead downwards.
    #[error("tensor `forest.below`: node {below} is below node {node}, expected one after it")]
    Upwards {
        /// The node.
        node: usize,
        /// Node below it in the file.
        below: u32,
    },
    /// An array of fewer than two outputs.
    #[error("array `{array}` has {count} elements, expected at least 2")]
    ShortArray {
        /// The array's name.
        array: String,
        /// How many elements there are.
        count: usize,
    },
    /// An array of something that is no output.
    #[error("array `{array}`: `{output}` is no output")]
    UnknownElement {
        /// The array's name.
        array: String,
        /// Name in the file.
        output: String,
    },
    /// An array with an output twice.
    #[error("array `{array}`: output `{output}` is duplicated")]
    DuplicateElement {
        /// The array's name.
        array: String,
        /// The output's name.
        output: String,
    },
    /// An array of outputs of different units.
    #[error("array `{array}`: output `{output}` is in `{found}`, expected `{expected}` as the first element")]
    ElementUnit {
        /// The array's name.
        array: String,
        /// The output's name.
        output: String,
        /// The output's unit.
        found: String,
        /// Unit of the array's first element.
        expected: String,
    },
    /// A standard deviation that does not follow the outputs in their order.
    #[error("output `{name}`: predicted standard deviations follow all other outputs, in their order")]
    MisplacedStd {
        /// Name of the output at its place.
        name: String,
    },
    /// More or fewer error bounds than outputs.
    #[error("{found} error bounds, expected {expected}: one for each output")]
    BoundCount {
        /// Number of bounds.
        found: usize,
        /// Number of outputs, and of times if bounds depend on them.
        expected: usize,
    },
    /// A coverage that is no share, times that do not increase from zero, or a bound that is negative or not finite.
    #[error("error bounds: {what} {found} makes no sense")]
    Bound {
        /// `coverage`, `time` or `half-width`.
        what: &'static str,
        /// Value in the file.
        found: f64,
    },
    /// A cover of the training data that does not belong to the inputs.
    #[error("the cover of the training data makes no sense: expected that {expected}")]
    Cover {
        /// Expected condition.
        expected: &'static str,
    },
    /// The content differs from that when the digest was computed.
    #[error("the file is damaged: its content has the digest {found}, expected {expected}")]
    Damaged {
        /// Digest of the content.
        found: String,
        /// Digest in the file.
        expected: String,
    },
    /// A content digest that is no SHA-256.
    #[error("content digest `{found}` is not 64 hexadecimal digits")]
    Digest {
        /// Digest in the file.
        found: String,
    },
    /// A tolerance of the solver that is zero, negative or not finite.
    #[error("the tolerance {found} of the solver is not positive")]
    Tolerance {
        /// Value in the file.
        found: f64,
    },
    /// A time step that is zero, negative or not finite.
    #[error("time step {found} is not positive", found = exact(*found))]
    TimeStep {
        /// Value in the file.
        found: f64,
    },
}

impl FormatError {
    /// The error as one about the network of an instant.
    pub(crate) fn of_instant(self, instant: usize) -> Self {
        Self::OfInstant { instant, source: Box::new(self) }
    }
}
