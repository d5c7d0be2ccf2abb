//! Writes an FMU of each kind of surrogate, with C sources, to try a host with: `cargo run --release --example kinds -- FOLDER`
//!
//! They are small models that the tests use, in FMI 2.0 (`NAME.fmu`) and 3.0 (`NAME-fmi3.fmu`).

use metafmu::{
    Error, Result,
    export::{Binary, Contents, pack},
    fmi::model_description::FmiVersion,
    study::ExportOptions,
    surrogate::seal,
};
use metafmu_example as example;
use metafmu_runtime::{Activation, Precision, Surrogate};
use std::{fs, path::Path, process::ExitCode};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [folder] = arguments.as_slice() else {
        eprintln!("usage: kinds FOLDER");
        return ExitCode::from(2);
    };
    match write_all(Path::new(folder)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn write_all(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
    for (name, surrogate) in kinds() {
        let surrogate = seal(surrogate)?;
        for (version, ending) in [(FmiVersion::V2, ""), (FmiVersion::V3, "-fmi3")] {
            let contents = Contents {
                version,
                about: &ExportOptions::default(),
                binaries: &Binary::embedded(),
                accuracy: None,
                figures: &[],
                sources: true,
            };
            let path = folder.join(format!("{name}{ending}.fmu"));
            fs::write(&path, pack(&surrogate, &contents)?).map_err(Error::io(&path, "write"))?;
        }
    }
    Ok(())
}

fn kinds() -> [(&'static str, Surrogate); 9] {
    [
        ("response", example::surrogate()),
        ("response-of-time-points", example::per_instant(&[16], Activation::Tanh, Precision::Double)),
        ("response-with-input", example::with_input()),
        ("response-with-bounds", example::with_bounds()),
        ("equations", example::crane()),
        ("equations-with-actuator", example::crane_with_motor()),
        ("network-of-rates", example::oscillator_by_graph()),
        ("discrete", example::recorded()),
        ("recurrent", example::cell()),
    ]
}
