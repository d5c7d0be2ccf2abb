//! `metafmu swap`: simulates a system with a component's source and with a surrogate in its place.

use super::{CommandOutcome, heard, print, print_json, say, terminal::workers, warn};
use crate::cli::SwapArgs;
use metafmu::{
    Error, Result, files,
    fmi::Watch,
    report::{Curve, two_runs_svg},
    swap::{Outside, RecordedRows, SurrogateStart, Swap, SwapComparison, SwapOptions},
};
use metafmu_runtime::BuiltIn;
use std::path::Path;

pub fn run(args: &SwapArgs) -> Result<CommandOutcome> {
    args.plot.iter().try_for_each(|path| files::check_output(path))?;
    let swap = Swap::open(&SwapOptions {
        system: args.system.clone(),
        component: args.component.clone(),
        surrogate: args.with.clone(),
        start: args.start_time,
        stop: args.stop_time,
        step: args.step_size,
        tolerance: args.tolerance,
        defaults: args.default.clone(),
    })?;
    SurrogateStart::lines(swap.start_values()).iter().for_each(say);
    let watch = Watch { workers: workers()?, limit: args.time_limit, heard };
    let comparison = swap.compare(watch, |fmu| say(format_args!("simulating with {}", fmu.display())))?;
    comparison.warnings.iter().for_each(warn);
    if let Some(Outside { rows, first }) = comparison.outside_domain {
        warn(format_args!(
            "the surrogate is outside the ranges that it is made for in {rows} of {} rows, at {first} s for the first time \
             (`{}` is false): its outputs there cannot be trusted",
            comparison.with_surrogate.times.len(),
            BuiltIn::InDomain.name()
        ));
    }
    if let Some(path) = &args.plot {
        plot(path, &comparison)?;
    }
    if args.json {
        print_json(&comparison)?;
    } else {
        print(&comparison.to_string())?;
    }
    Ok(CommandOutcome::Fine)
}

/// Plots every output of both runs.
fn plot(path: &Path, comparison: &SwapComparison) -> Result<()> {
    let curves = |recorded: &RecordedRows| -> Vec<Curve> {
        let outputs = comparison.outputs.iter().zip(&recorded.values);
        let curve = outputs.map(|(output, values)| Curve {
            name: output.output.clone(),
            unit: output.unit.clone(),
            values: values.clone(),
        });
        curve.collect()
    };
    let SwapComparison { system, component, with_source, with_surrogate, .. } = comparison;
    let (source, surrogate) = (curves(with_source), curves(with_surrogate));
    let title = format!("{system}: {component} and its surrogate");
    let runs = [(&*with_source.times, &*source), (&*with_surrogate.times, &*surrogate)];
    let svg = two_runs_svg(&title, ["with the source", "with the surrogate"], runs).map_err(Error::plot(path))?;
    files::write_output(path, |file| file.write_all(svg.as_bytes()))
}
