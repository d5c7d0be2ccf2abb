//! `metafmu import`: a third-party model becomes a model file.

use super::{CommandOutcome, heard, print, print_json};
use crate::cli::ImportArgs;
use metafmu::{
    Error, Result,
    diagnostics::numbers::power,
    files,
    pipeline::import::{ImportOptions, ImportedSurrogate, OutputDifference, import, starter},
};

pub fn run(args: &ImportArgs) -> Result<CommandOutcome> {
    if let Some(new) = &args.new {
        if new.exists() {
            let message = "exists already and is not overwritten: remove it, or choose another name".into();
            return Err(Error::Stale { path: new.clone(), message });
        }
        files::write_whole(new, starter(&args.model, args.data.as_deref())?.as_bytes())?;
        let data = args.data.as_ref().map_or(String::new(), |data| format!(" --data {}", data.display()));
        let command = format!("metafmu import {} --interface {}{data}", args.model.display(), new.display());
        print(&format!("{}\nreview it, then import the model with `{command}`\n", new.display()))?;
        return Ok(CommandOutcome::Fine);
    }
    let options = ImportOptions {
        model: args.model.clone(),
        interface: args.interface.clone().unwrap_or_default(),
        data: args.data.clone(),
        check: args.check.clone(),
        tolerance: args.tolerance,
        out: args.out.clone(),
    };
    let imported = import(&options)?;
    report(&imported, args.json)
}

fn report(imported: &ImportedSurrogate, json: bool) -> Result<CommandOutcome> {
    let fits = imported.check.iter().all(|difference| difference.fits);
    if json {
        print_json(imported)?;
    } else {
        for OutputDifference { output, largest, relative, row, fits } in &imported.check {
            let verdict = if *fits { "" } else { ": not what was expected" };
            let (largest, relative) = (power(*largest, 3), power(*relative, 1));
            print(&format!(
                "{output}: largest difference {largest}, {relative} of the range, in row {row}{verdict}\n"
            ))?;
        }
        if let Some(model) = &imported.model {
            print(&format!("{}\n", model.display()))?;
        }
    }
    if !fits {
        heard("the model does not give what the table says: nothing was written");
        return Ok(CommandOutcome::ProblemsFound);
    }
    Ok(CommandOutcome::Fine)
}
