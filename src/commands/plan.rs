//! `metafmu plan`: writes the next points to run.

use super::{CommandOutcome, stdout::write_result, terminal};
use crate::cli::PlanArgs;
use metafmu::{Result, files, pipeline::plan};
use std::path::Path;

pub fn run(args: &PlanArgs) -> Result<CommandOutcome> {
    let out = args.out.as_deref();
    if let Some(out) = out {
        files::check_output(out)?;
        plan::check_out(&args.study, out)?;
    }
    let (control, path) = (terminal::control()?, out.unwrap_or(Path::new("stdout")));
    write_result(out, |to| plan::plan(&args.study, args.points, control, (to, path)))?;
    Ok(CommandOutcome::Fine)
}
