//! The tables of legal calls as C headers, for the sources in `fmu-template/c`.

use crate::{
    component::Call,
    state::{InstanceState, Row},
};
use std::{env, fmt::Write, fs, path::Path};

/// Set to 1 it makes the tests write the headers.
const WRITE: &str = "METAFMU_WRITE_HEADERS";

/// Compares the committed header of a version with its table, or writes it.
pub(crate) fn check<C: Call>(functions: &[C]) {
    let name = format!("calls_{}.h", C::PREFIX);
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("c").join(&name);
    let expected = header(functions);
    if env::var_os(WRITE).is_some_and(|value| value == "1") {
        fs::write(&path, &expected).unwrap();
    }
    let found = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        found == expected,
        "fmu-template/c/{name} differs from the table of legal calls in fmu-template/src/{}/table.rs: run `{WRITE}=1 cargo test \
         -p fmu-template` and commit the header",
        C::PREFIX
    );
}

fn header<C: Call>(functions: &[C]) -> String {
    let guard = format!("CALLS_{}_H", C::PREFIX.to_uppercase());
    let mut text = format!(
        "/* States that allow each function. Generated from the table of the FMU's library, fmu-template/src/{}/table.rs. */\n\
         #ifndef {guard}\n#define {guard}\n\n#include \"instance.h\"\n\nenum {{\n",
        C::PREFIX
    );
    for (index, function) in functions.iter().enumerate() {
        let comma = if index + 1 < functions.len() { "," } else { "" };
        writeln!(text, "    ALLOWED_{}{function:?} =\n        {}{comma}", C::PREFIX, sets(function.legal())).unwrap();
    }
    text + "};\n\n#endif\n"
}

/// The states of a row for each set of interfaces, as C.
fn sets(row: Row) -> String {
    let sets = [
        marked_states(row, b'x', "IN_BOTH"),
        marked_states(row, b'c', "IN_CO_SIMULATION"),
        marked_states(row, b'm', "IN_MODEL_EXCHANGE"),
    ];
    let sets: Vec<String> = sets.into_iter().flatten().collect();
    if sets.is_empty() { "0".to_owned() } else { sets.join(" |\n        ") }
}

/// The states that a row marks with a letter, as a call of a macro; none if there are none.
fn marked_states(row: Row, letter: u8, name: &str) -> Option<String> {
    let states = InstanceState::ALL.into_iter().filter(|state| row.get(2 * *state as usize) == Some(&letter));
    let states: Vec<&str> = states.map(constant).collect();
    (!states.is_empty()).then(|| format!("{name}({})", states.join(" | ")))
}

/// The constant of instance.h for a state.
fn constant(state: InstanceState) -> &'static str {
    match state {
        InstanceState::Instantiated => "STATE_INSTANTIATED",
        InstanceState::Initialization => "STATE_INITIALIZATION",
        InstanceState::Event => "STATE_EVENT",
        InstanceState::ContinuousTime => "STATE_CONTINUOUS_TIME",
        InstanceState::Step => "STATE_STEP",
        InstanceState::Terminated => "STATE_TERMINATED",
        InstanceState::Error => "STATE_ERROR",
        InstanceState::IntermediateUpdate => "STATE_UPDATE",
        InstanceState::Fatal => panic!("a state after a panic, which C has not"),
    }
}
