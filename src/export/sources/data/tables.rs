//! Lookup tables in formulas of efforts.

use super::{array, real, table as list};
use metafmu_runtime::{
    formula::{Extrapolation, Interpolation},
    listing::Listing,
};

/// `model_tables` and `model_arguments`.
pub(super) fn write_tables(text: &mut String, listing: &Listing) {
    let mut entries = Vec::new();
    for (index, table) in listing.tables.iter().enumerate() {
        let name = |what: &str| format!("table_{index}_{what}");
        let mut axes = Vec::new();
        for (axis, knots) in ["x", "y"].into_iter().zip(table.axes()) {
            array(text, &format!("static const Real {}", name(axis)), knots);
            axes.push(format!("{}, {}", name(axis), knots.len()));
        }
        axes.resize(2, "NULL, 0".into());
        array(text, &format!("static const Real {}", name("nodes")), table.nodes());
        let [has_slopes, is_cubic] = [table.has_slopes(), table.interpolation() == Interpolation::Cubic].map(u8::from);
        let extrapolation = match table.extrapolation() {
            Extrapolation::Hold => "HOLD",
            Extrapolation::Linear => "LINEAR",
            Extrapolation::Periodic => "PERIODIC",
        };
        let mut bends = Vec::new();
        for (axis, what) in ["x", "y"].into_iter().take(table.arguments()).enumerate() {
            let of_axis = table.bends(axis);
            if of_axis.is_empty() {
                bends.push(("NULL".to_owned(), 0));
                continue;
            }
            let name = name(&format!("{what}_bends"));
            let listed = of_axis.iter().map(|bend| format!("{}, {}", real(bend.at), real(bend.width)));
            list(text, &format!("static const Bend {name}"), listed, "");
            bends.push((name, of_axis.len()));
        }
        bends.resize(2, ("NULL".into(), 0));
        let (axes, nodes, [(x, x_count), (y, y_count)]) = (axes.join(", "), name("nodes"), [&bends[0], &bends[1]]);
        entries.push(format!(
            "{axes}, {nodes}, {has_slopes}, {is_cubic}, EXTRAPOLATION_{extrapolation}, {{{x}, {y}}}, {{{x_count}, {y_count}}}"
        ));
    }
    let none = "NULL, 0, NULL, 0, NULL, 0, 0, EXTRAPOLATION_HOLD, {NULL, NULL}, {0, 0}";
    list(text, "const LookupTable model_tables", entries.into_iter(), none);
    let arguments = listing.arguments.iter().map(|(table, axis, of)| format!("&model_tables[{table}], {axis}, {of}"));
    list(text, "const Argument model_arguments", arguments, "NULL, 0, 0");
}
