//! Writes an example surrogate as a model file, for trying out and timing an FMU's library without training anything.
//!
//! `cargo run -p metafmu-runtime --example model_file -- FILE [per-instant] [single] [SIZE OF HIDDEN LAYER]...`, or `FILE NAME` with a name of
//! `NAMED`.

use metafmu_example as example;

use metafmu_runtime::{Activation, Precision, Surrogate};
use std::{env, error::Error, fs};

type Named = (&'static str, fn() -> Surrogate);

/// Surrogates by name: of each clock, with inputs, and with all that the domain of validity can know.
const NAMED: [Named; 10] = [
    ("covered", || example::with_cover(&example::with_input())),
    ("encoded", || example::encoded(&example::with_input())),
    ("crane", example::with_growing_bounds),
    ("motor", example::crane_with_motor),
    ("splines", example::crane_with_splines),
    ("reactions", example::crane_with_reactions),
    ("networks", example::crane_with_networks),
    ("oscillator", example::oscillator_by_graph),
    ("supported", example::supported),
    ("cell", example::cell),
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1).peekable();
    let file = arguments.next().ok_or("expected the name of a file to write")?;
    if let Some((_, surrogate)) = arguments.peek().and_then(|name| NAMED.iter().find(|(named, _)| named == name)) {
        let surrogate = surrogate();
        fs::write(&file, surrogate.to_bytes()?)?;
        println!("{}", surrogate.instantiation_token());
        return Ok(());
    }
    let per_instant = arguments.next_if(|argument| argument == "per-instant").is_some();
    let single = arguments.next_if(|argument| argument == "single").is_some();
    let precision = if single { Precision::Single } else { Precision::Double };
    let hidden = arguments.map(|size| size.parse()).collect::<Result<Vec<usize>, _>>()?;
    let example = if per_instant { example::per_instant } else { example::with_precision };
    let surrogate = example(&hidden, Activation::Tanh, precision);
    fs::write(&file, surrogate.to_bytes()?)?;
    println!("{}", surrogate.instantiation_token());
    Ok(())
}
