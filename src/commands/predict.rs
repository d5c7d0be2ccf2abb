//! `metafmu predict`: computes a surrogate's outputs for every row of a table.

use super::{CommandOutcome, messages::say_stream, print, print_json, say, stdout::write_result, terminal, warn};
use crate::cli::PredictArgs;
use metafmu::{
    Result,
    diagnostics::numbers::counted,
    files,
    pipeline::predict::{Found, PredictOptions, Predicted, load, predict},
    table::writer::Format,
};
use std::path::Path;

pub fn run(args: &PredictArgs) -> Result<CommandOutcome> {
    let out = args.out.as_ref().map(|(path, _)| path.as_path());
    out.map_or(Ok(()), files::check_output)?;
    let control = terminal::control()?;
    let surrogate = load(&args.model, control)?;
    say_stream(&args.table);
    let format = args.out.as_ref().map_or(Format::Csv, |(_, format)| *format);
    let options = PredictOptions { outputs: args.outputs.clone(), format, defaults: args.default.clone() };
    let path = out.unwrap_or(Path::new("stdout"));
    let predicted = write_result(out, |to| predict(&surrogate, &args.table, &options, control, (to, path)))?;
    let Some(predicted) = predicted else {
        // nobody reads the rest
        terminal::end();
        return Ok(CommandOutcome::Fine);
    };
    warn_of(&predicted);
    match out {
        Some(_) if args.json => print_json(&predicted)?,
        Some(path) => print(&format!("{}: {}\n", path.display(), summary(&predicted)))?,
        None => say(summary(&predicted)),
    }
    Ok(if predicted.not_finite.rows == 0 { CommandOutcome::Fine } else { CommandOutcome::ProblemsFound })
}

fn summary(Predicted { rows, runs, seconds, .. }: &Predicted) -> String {
    let runs = runs.map_or(String::new(), |runs| format!(" of {}", counted(runs as usize, "run")));
    let per_second = *rows as f64 / seconds;
    format!("{}{runs} in {seconds:.2} s, {per_second:.0} rows/s", counted(*rows as usize, "row"))
}

/// Prints warnings that would be overlooked in a long table.
fn warn_of(Predicted { rows, outside, not_finite, .. }: &Predicted) {
    let first = |found: &Found| found.first.unwrap_or_default();
    if outside.rows > 0 {
        warn(format_args!(
            "outside the domain of validity: {} of {rows} rows, the first is row {} (`in_domain` is \
             false): outputs there cannot be trusted",
            outside.rows,
            first(outside)
        ));
    }
    if not_finite.rows > 0 {
        warn(format_args!(
            "outputs that cannot be computed (NaN or infinite): {} of {rows} rows, the first is row {}",
            not_finite.rows,
            first(not_finite)
        ));
    }
}
