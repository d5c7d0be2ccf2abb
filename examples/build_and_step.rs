//! Builds the FMU of a study and steps it, through the library only.
//!
//!     cargo run --release --example build_and_step -- examples/quick/single-pendulum.toml

use metafmu::{
    fmi::Fmu,
    pipeline::{
        Control, Project, Silent, build,
        export::{ExportPlan, ExportRequest},
        serve_workers,
    },
};
use std::{env, error::Error, path::Path, sync::atomic::AtomicBool};

fn main() -> Result<(), Box<dyn Error>> {
    // FMUs and baselines run in separate processes: this program, started again
    if serve_workers()? {
        return Ok(());
    }
    let study = env::args().nth(1).ok_or("expected a study file")?;
    let (stop, program) = (AtomicBool::new(false), env::current_exe()?);
    let control = Control { observer: &Silent, stop: &stop, program: &program, heard: |line| eprintln!("{line}") };
    let project = Project::open(Path::new(&study), None, control)?;
    let built = build(&project, &ExportPlan::new(&project, &ExportRequest::default())?, false)?;
    print!("{}", built.verdict.text());

    let (written, validation) = &built.fmus[0];
    print!("{}\n{validation}", written.fmu.display());
    let fmu = Fmu::open(&written.fmu)?;
    let instance = fmu.instantiate("example", false)?;
    instance.enter_initialization_mode(0.0, None)?;
    instance.exit_initialization_mode()?;
    instance.do_step(0.0, project.study.time.step)?;
    for output in project.source.outputs() {
        let variable = fmu.description().variable(&output.name).ok_or("an output is missing")?;
        let mut value = [0.0];
        instance.get_real(&[variable.value_reference], &mut value)?;
        println!("{} = {} {}", output.name, value[0], output.unit);
    }
    Ok(())
}
