//! The surrogate as C source code, for real-time and hardware-in-the-loop targets: the `sources/` folder of an FMU.
//!
//! Portable C99 that needs nothing but the C library and libm. Everything is compiled in, resources are not read. The
//! FMU behaves as with the library this crate packs: the same variables, states, tolerances and messages. Fixed files
//! are embedded as they are; [`files`] adds two generated ones, `model_data.h` with sizes and `model_data.c` with the
//! numbers.
//!
//! Weights are written as hexadecimal numbers, exact and independent of the compiler's reading of decimals. Whatever the
//! surrogate's precision is, the C code computes in doubles, or with `-DMETAFMU_SINGLE` in singles: all numbers of the
//! model have the type `Real` of `real.h`. What a host gives and gets, and times, are doubles always.
//!
//! # What modelDescription.xml has to say
//! - FMI 2.0: in each interface element (`CoSimulation`, `ModelExchange`), as its first child,
//!   `<SourceFiles><File name="..."/></SourceFiles>` with the names of [`compiled`].
//! - FMI 3.0: nothing; the build description, one of [`files`], says it.

mod data;

use crate::fmi::FmiVersion;
use metafmu_runtime::{Clock, Program, Surrogate, graph::Step};

/// Folder of the archive that holds the files.
pub const FOLDER: &str = "sources";

/// Generated files.
const DATA_HEADER: &str = "model_data.h";
const DATA: &str = "model_data.c";

/// Name and content of the files that do not depend on the surrogate and the version.
const COMMON: [(&str, &str); 11] = [
    ("activation.c", include_str!("activation.c")),
    ("activation.h", include_str!("activation.h")),
    ("blocks.h", include_str!("blocks.h")),
    ("clones.h", include_str!("clones.h")),
    ("evaluator.h", include_str!("evaluator.h")),
    ("instance.c", include_str!("instance.c")),
    ("instance.h", include_str!("instance.h")),
    ("jets.h", include_str!("jets.h")),
    ("model.h", include_str!("model.h")),
    ("real.h", include_str!("real.h")),
    ("README.txt", include_str!("README.txt")),
];

/// Of models without states.
const MAPS: [(&str, &str); 2] = [("maps.c", include_str!("maps.c")), ("maps.h", include_str!("maps.h"))];

const NETWORK: [(&str, &str); 2] = [("network.c", include_str!("network.c")), ("network.h", include_str!("network.h"))];

/// Files of baselines and third-party functions.
const GRAPH: [(&str, &str); 3] = [
    ("graph.c", include_str!("graph.c")),
    ("graph.h", include_str!("graph.h")),
    ("graph_steps.h", include_str!("graph_steps.h")),
];

/// Of models of functions that are lists of operations.
const TAPE: [(&str, &str); 3] = [
    ("jet_activation.h", include_str!("jet_activation.h")),
    ("tape.h", include_str!("tape.h")),
    ("tape_run.h", include_str!("tape_run.h")),
];

/// Of models with continuous states.
const STATES: [(&str, &str); 2] = [("states.c", include_str!("states.c")), ("states.h", include_str!("states.h"))];

const MOTION: [(&str, &str); 4] = [
    ("equations.h", include_str!("equations.h")),
    ("formulas.h", include_str!("formulas.h")),
    ("motion.c", include_str!("motion.c")),
    ("motion.h", include_str!("motion.h")),
];

const STATE_SPACE: [(&str, &str); 2] =
    [("state_space.c", include_str!("state_space.c")), ("state_space.h", include_str!("state_space.h"))];

const DISCRETE: [(&str, &str); 2] =
    [("discrete.c", include_str!("discrete.c")), ("discrete.h", include_str!("discrete.h"))];

const FMI2: [(&str, &str); 2] = [("fmi2.c", include_str!("fmi2.c")), ("fmi2.h", include_str!("fmi2.h"))];

const FMI3: [(&str, &str); 3] = [
    ("fmi3.c", include_str!("fmi3.c")),
    ("fmi3.h", include_str!("fmi3.h")),
    ("fmi3_absent.c", include_str!("fmi3_absent.c")),
];

/// Returns true if C code exists for the program. Equations of motion and networks at time points must be the whole graph, and at most one
/// step may be a dictionary.
pub fn cover(program: &Program) -> bool {
    let steps = &program.graph.steps;
    let count = |is_wanted: fn(&Step) -> bool| steps.iter().filter(|step| is_wanted(step)).count();
    let alone = count(|step| matches!(step, Step::Motion { .. } | Step::Interpolate { .. }));
    let has_clock = match steps.first() {
        Some(Step::Motion { .. }) => program.integration().is_some(),
        Some(Step::Interpolate { .. }) => !program.has_memory(),
        _ => true,
    };
    has_clock && (alone == 0 || steps.len() == 1) && count(|step| matches!(step, Step::Dictionary { .. })) <= 1
}

/// Everything of the `sources/` folder: archive names with bytes, sorted; for FMI 3.0 with the build description. The
/// same surrogate always gives the same bytes.
///
/// `identifier` is the model identifier of the FMU.
pub fn files(surrogate: &Surrogate, identifier: &str, version: FmiVersion) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<(String, Vec<u8>)> =
        fixed(surrogate, version).map(|(name, text)| (format!("{FOLDER}/{name}"), text.as_bytes().to_vec())).collect();
    files.push((format!("{FOLDER}/{DATA_HEADER}"), data::header(surrogate, identifier).into_bytes()));
    files.push((format!("{FOLDER}/{DATA}"), data::source(surrogate).into_bytes()));
    if version == FmiVersion::V3 {
        let description = build_description(&compiled(surrogate, version), identifier);
        files.push((format!("{FOLDER}/buildDescription.xml"), description.into_bytes()));
    }
    files.sort();
    files
}

/// Names of the files that are compiled, relative to the `sources/` folder, sorted: the `SourceFiles` of FMI 2.0.
pub fn compiled(surrogate: &Surrogate, version: FmiVersion) -> Vec<&'static str> {
    let names = fixed(surrogate, version).map(|(name, _)| name).filter(|name| name.ends_with(".c"));
    let mut names: Vec<&str> = names.collect();
    names.push(DATA);
    names.sort_unstable();
    names
}

/// `sources/buildDescription.xml` of FMI 3.0.
fn build_description(compiled: &[&str], identifier: &str) -> String {
    let sources: String = compiled.iter().map(|name| format!("      <SourceFile name=\"{name}\"/>\n")).collect();
    // the identifier is one of C and the names are ours: nothing to escape
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n\
         <fmiBuildDescription fmiVersion=\"3.0\">\n  \
           <BuildConfiguration modelIdentifier=\"{identifier}\">\n    \
             <SourceFileSet language=\"C99\">\n\
               {sources}    \
             </SourceFileSet>\n  \
           </BuildConfiguration>\n\
         </fmiBuildDescription>\n"
    )
}

fn fixed(surrogate: &Surrogate, version: FmiVersion) -> impl Iterator<Item = (&'static str, &'static str)> {
    let adapter: &[_] = match version {
        FmiVersion::V2 => &FMI2,
        FmiVersion::V3 => &FMI3,
    };
    let program = surrogate.program();
    let model: &[&[_]] = match (&program.clock, program.motion()) {
        (Clock::Static, _) if data::has_graph(program) => &[&MAPS, &GRAPH],
        (Clock::Static, _) => &[&MAPS, &NETWORK],
        (Clock::Continuous(_), Some(_)) => &[&TAPE, &STATES, &MOTION],
        (Clock::Continuous(_), None) => &[&GRAPH, &STATES, &STATE_SPACE],
        (Clock::Sampled(_), _) => &[&GRAPH, &DISCRETE],
    };
    let has_dictionary = program.motion().is_none() && program.graph.dictionary().is_some();
    let beside: &[&[_]] = if has_dictionary { &[&TAPE] } else { &[] };
    let files = model.iter().chain(beside).copied().flatten().copied();
    COMMON.into_iter().chain(files).chain(adapter.iter().copied())
}

#[cfg(test)]
mod tests;
