//! The C99 sources of FMUs, embedded as text: the counterpart of the library `fmu-template`, function by function.
//!
//! A separate crate, as a package cannot reach outside its folder.

/// Name and text of a file.
pub type File = (&'static str, &'static str);

macro_rules! files {
    ($($name:literal),* $(,)?) => { &[$(($name, include_str!($name))),*] };
}

/// Files of all FMUs.
pub const COMMON: &[File] = files![
    "activation.c",
    "activation.h",
    "activation_formulas.h",
    "blocks.h",
    "clones.h",
    "derivatives.c",
    "domain.c",
    "evaluator.h",
    "instance.c",
    "instance.h",
    "jet_arithmetic.h",
    "jets.h",
    "messages.c",
    "model.h",
    "parts.h",
    "README.txt",
    "real.h",
    "snapshot.c",
    "steps.c",
    "variables.c",
];

/// Files of models without states.
pub const MAPS: &[File] = files!["maps.c", "maps.h"];

/// Files of networks.
pub const NETWORK: &[File] = files!["network.c", "network.h"];

/// Files of baselines and third-party functions.
pub const GRAPH: &[File] = files!["graph.c", "graph.h", "graph_steps.h"];

/// Files of lists of operations: equations and sums of products.
pub const TAPE: &[File] = files!["tape.h", "tape_run.h"];

/// Files of models with continuous states.
pub const STATES: &[File] = files!["rosenbrock.h", "states.c", "states.h"];

/// Files of equations of motion.
pub const MOTION: &[File] = files!["equations.h", "formulas.h", "motion.c", "motion.h"];

/// Files of derivatives of states that are a graph.
pub const STATE_SPACE: &[File] = files!["state_space.c", "state_space.h"];

/// Files of discrete-time models.
pub const DISCRETE: &[File] = files!["discrete.c", "discrete.h"];

/// The functions of FMI 2.0.
pub const FMI2: &[File] = files!["calls_fmi2.h", "fmi2.c", "fmi2.h"];

/// The functions of FMI 3.0.
pub const FMI3: &[File] = files!["calls_fmi3.h", "fmi3.c", "fmi3.h", "fmi3_absent.c"];
