//! Writes the example surrogate as a model file, for trying out and timing an FMU's library without training anything.
//!
//! `cargo run -p metafmu-runtime --example model_file -- FILE [per-instant] [single] [SIZE OF HIDDEN LAYER]...`

use metafmu_runtime::{Activation, Precision, example};
use std::{env, error::Error, fs};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = env::args().skip(1).peekable();
    let file = arguments.next().ok_or("expected the name of a file to write")?;
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
