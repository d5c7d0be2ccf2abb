//! The surrogate as C source code, for real-time and hardware-in-the-loop targets: the `sources/` folder of an FMU.
//!
//! Portable C99 that needs nothing but the C library and libm. Everything is compiled in, resources are not read. The
//! FMU behaves as with the library this crate packs: the same variables, states, tolerances and messages. Fixed files
//! come from `metafmu-sources`; [`files`] adds two generated ones, `model_data.h` with sizes and `model_data.c` with the
//! numbers.
//!
//! Weights are written as hexadecimal numbers, exact and independent of the compiler's reading of decimals. Whatever
//! the surrogate's precision is, the C code computes in doubles, or with `-DMETAFMU_SINGLE` in singles: all numbers of
//! the model have the type `Real` of `real.h`. Values that a host exchanges, and times, are always doubles.
//!
//! # What
//! modelDescription.xml has to say
//! - FMI 2.0: in each interface element (`CoSimulation`, `ModelExchange`), as its first child,
//!   `<SourceFiles><File name="..."/></SourceFiles>` with the names of [`compiled`].
//! - FMI 3.0: nothing; the build description, one of [`files`], says it.

mod data;

use crate::fmi::FmiVersion;
use metafmu_runtime::{Clock, Program, Surrogate, graph::Step};
use metafmu_sources::{COMMON, DISCRETE, FMI2, FMI3, File, GRAPH, MAPS, MOTION, NETWORK, STATE_SPACE, STATES, TAPE};

/// Folder of the archive that holds the files.
pub const FOLDER: &str = "sources";

/// Generated files.
const DATA_HEADER: &str = "model_data.h";
const DATA: &str = "model_data.c";

/// Returns true if C code exists for the program. Equations of motion and networks at time points must be the whole graph, and at most one
/// step may be a dictionary.
pub fn cover(program: &Program) -> bool {
    let steps = &program.graph.steps;
    let is_alone = steps.iter().any(|step| matches!(step, Step::Motion { .. } | Step::Interpolate { .. }));
    let dictionaries = steps.iter().filter(|step| matches!(step, Step::Dictionary { .. })).count();
    let has_clock = match steps.first() {
        Some(Step::Motion { .. }) => program.integration().is_some(),
        Some(Step::Interpolate { .. }) => !program.has_memory(),
        _ => true,
    };
    has_clock && (!is_alone || steps.len() == 1) && dictionaries <= 1
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

fn fixed(surrogate: &Surrogate, version: FmiVersion) -> impl Iterator<Item = File> {
    let adapter = match version {
        FmiVersion::V2 => FMI2,
        FmiVersion::V3 => FMI3,
    };
    let program = surrogate.program();
    let model: &[&[_]] = match (&program.clock, program.motion()) {
        (Clock::Static, _) if data::has_graph(program) => &[MAPS, GRAPH],
        (Clock::Static, _) => &[MAPS, NETWORK],
        (Clock::Continuous(_), Some(_)) => &[TAPE, STATES, MOTION],
        (Clock::Continuous(_), None) => &[GRAPH, STATES, STATE_SPACE],
        (Clock::Sampled(_), _) => &[GRAPH, DISCRETE],
    };
    let has_dictionary = program.motion().is_none() && program.graph.dictionary().is_some();
    let beside: &[&[_]] = if has_dictionary { &[TAPE] } else { &[] };
    [COMMON].into_iter().chain(model.iter().copied()).chain(beside.iter().copied()).chain([adapter]).flatten().copied()
}

#[cfg(test)]
mod tests;
