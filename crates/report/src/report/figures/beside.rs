//! Two surrogates of one source side by side, for instance S_fixed, which has a network for each instant, and S_full.

use super::{
    Evaluated, Material, ReportBlock, Section, accuracy::density_figure, case, code, escape, left_out, number, output,
    paragraph, r2, responses::response, shown, table, unit,
};

/// Two surrogates on the same test runs, the left one first. One of them is the report's own.
#[derive(Debug)]
pub struct Beside<'a> {
    /// Names of the surrogates.
    pub names: [String; 2],
    /// The surrogates.
    pub evaluated: [&'a Evaluated<'a>; 2],
    /// Their costs: what, and a value of each.
    pub costs: Vec<(String, [String; 2])>,
}

pub fn section(material: &Material) -> Option<Section> {
    let Beside { names, evaluated: sides, costs } = material.beside.as_ref()?;
    let own = material.evaluated;
    let [left, right] = [&names[0], &names[1]].map(|name| escape(name));
    let mut blocks = vec![paragraph(&format!(
        "On the left {}, on the right {}, on the same {} test runs.",
        names[0],
        names[1],
        own.test.runs.len()
    ))];
    let headings = [
        "output",
        "unit",
        &format!("R², {left}"),
        &format!("R², {right}"),
        &format!("RMS error, {left}"),
        &format!("RMS error, {right}"),
    ];
    let [left_outputs, right_outputs] = sides.map(|side| side.accuracy.outputs.values());
    let rows = left_outputs.zip(right_outputs).enumerate().map(|(column, (left, right))| {
        let (name, output_unit) = output(own, column);
        let [left_rms, right_rms] = [left, right].map(|metrics| number(metrics.rms()));
        vec![code(name), unit(output_unit), r2(left.r2), r2(right.r2), left_rms, right_rms]
    });
    blocks.push(table(&headings, rows));
    let costs = costs.iter().map(|(name, [left, right])| vec![escape(name), escape(left), escape(right)]);
    blocks.push(table(&["cost", &left, &right], costs));

    let both = [(&names[0], "left", sides[0]), (&names[1], "right", sides[1])];
    let pairs = |title: &str, figure: &dyn Fn(&Evaluated, usize, &str) -> super::Figure| {
        [
            ReportBlock::Html(format!("<h3>{title}</h3>")),
            ReportBlock::Figures(
                shown(own)
                    .flat_map(|column| {
                        both.map(|(name, side, evaluated)| {
                            let mut figure = figure(evaluated, column, side);
                            figure.caption = format!("{name}. {}", figure.caption);
                            figure
                        })
                    })
                    .collect(),
            ),
        ]
    };
    blocks.extend(pairs("Prediction against label", &|evaluated, column, side| {
        density_figure(evaluated, column, &format!("beside-{side}"))
    }));
    let order = own.runs_by_error();
    for (what, run) in [("median", order[(order.len() - 1) / 2]), ("worst", order[order.len() - 1])] {
        let [title, figures] = pairs(
            &format!("Time response, {what} case of {}", escape(&material.study.name)),
            &|evaluated, column, side| response(evaluated, run, column, &format!("beside-{side}-{what}")),
        );
        blocks.extend([title, paragraph(&format!("{}.", case(own, run))), figures]);
    }
    blocks.extend(left_out(own));
    Some(Section { id: "beside", title: format!("{} beside {}", names[0], names[1]), blocks })
}
