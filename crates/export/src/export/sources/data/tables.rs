//! Lookup tables in formulas of efforts, and arguments with bends.

use super::{array, real, table as list};
use metafmu_runtime::{
    bends::{Bend, BentArgument},
    formula::{Extrapolation, Interpolation},
    listing::Listing,
};

/// `model_tables` and `model_arguments`.
pub(super) fn write_tables(text: &mut String, listing: &Listing) {
    let mut entries = Vec::new();
    for (index, table) in listing.tables.iter().enumerate() {
        let nodes = format!("table_{index}_nodes");
        let mut axes = Vec::new();
        for (axis, knots) in ["x", "y"].into_iter().zip(table.axes()) {
            let name = format!("table_{index}_{axis}");
            array(text, &format!("static const Real {name}"), knots);
            axes.push(format!("{name}, {}", knots.len()));
        }
        axes.resize(2, "NULL, 0".into());
        array(text, &format!("static const Real {nodes}"), table.nodes());
        let [has_slopes, is_cubic] = [table.has_slopes(), table.interpolation() == Interpolation::Cubic].map(u8::from);
        let extrapolation = match table.extrapolation() {
            Extrapolation::Hold => "HOLD",
            Extrapolation::Linear => "LINEAR",
            Extrapolation::Periodic => "PERIODIC",
        };
        let axes = axes.join(", ");
        entries.push(format!("{axes}, {nodes}, {has_slopes}, {is_cubic}, EXTRAPOLATION_{extrapolation}"));
    }
    let none = "NULL, 0, NULL, 0, NULL, 0, 0, EXTRAPOLATION_HOLD";
    list(text, "const LookupTable model_tables", entries.into_iter(), none);
    let mut entries = Vec::new();
    for (index, (BentArgument { bends, group }, of)) in listing.arguments.iter().enumerate() {
        let name = format!("bends_{index}");
        let listed = bends.list().iter().map(|Bend { at, width }| {
            // neighbors of a single bend are infinitely far
            format!("{}, {}", real(*at), real(width.min(f64::from(f32::MAX))))
        });
        list(text, &format!("static const Bend {name}"), listed, "");
        let (count, start, period) = (bends.list().len(), real(bends.start()), real(bends.period().unwrap_or(0.0)));
        entries.push(format!("{of}, {name}, {count}, {start}, {period}, {group}"));
    }
    let none = format!("0, NULL, 0, {zero}, {zero}, 0", zero = real(0.0));
    list(text, "const Argument model_arguments", entries.into_iter(), &none);
}
