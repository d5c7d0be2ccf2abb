//! A small chart on the first screen: truth and prediction, and below them the error on a separate scale.
//!
//! Its picture has no text: names and numbers are text of the page beside it, so that they stay legible however narrow the chart is.

use super::{
    axis::extent,
    chart::thin,
    readable::{brief, short},
};
use crate::html::escape;
use std::fmt::Write;

/// Truth, prediction and their difference over time, or over the rank of rows.
#[derive(Clone, Debug)]
pub struct Strip {
    /// First words of its title, for instance `Worst run`.
    pub title: String,
    /// Further words of the title.
    pub about: String,
    /// Name and unit of the quantity.
    pub quantity: [String; 2],
    /// Texts at both ends of the horizontal axis.
    pub ends: [String; 2],
    /// x, truth and prediction of each row, by rising x.
    pub rows: Vec<[f64; 3]>,
    /// Half the width of the error band at each row.
    pub bound: Option<Vec<f64>>,
}

/// Side of the picture in its own units; it is stretched to the place it has.
const SIDE: f64 = 1000.0;

impl Strip {
    /// HTML of the chart; none if there are no finite rows.
    pub fn html(&self) -> Option<String> {
        let Self { title, about, quantity: [name, unit], ends: [begin, end], rows, bound } = self;
        let residual = |[_, truth, prediction]: &[f64; 3]| prediction - truth;
        let finite = |value: &f64| value.is_finite();
        let (left, right) = extent(rows.iter().map(|row| row[0]))?;
        let values = extent(rows.iter().flat_map(|row| [row[1], row[2]]).filter(finite))?;
        let largest = rows.iter().map(residual).filter(finite).fold(0.0, |largest: f64, r| largest.max(r.abs()));
        let widest = bound.iter().flatten().copied().filter(finite).fold(0.0, f64::max);
        // a bound far beyond the errors would flatten them
        let reach = if widest > 0.0 { largest.max(widest.min(2.0 * largest)) } else { largest };
        let reach = if reach > 0.0 { reach } else { 1.0 };
        let x = |x: f64| if right > left { SIDE * (x - left) / (right - left) } else { 0.5 * SIDE };
        let (low, high) = if values.1 > values.0 { values } else { (values.0 - 0.5, values.1 + 0.5) };
        let value = |y: f64| SIDE * (high - y) / (high - low);
        let error = |y: f64| (0.5 * SIDE * (1.0 - y / reach)).clamp(0.0, SIDE);
        let line = |class: &str, of: &dyn Fn(&[f64; 3]) -> f64, y: &dyn Fn(f64) -> f64| {
            let points: Vec<[f64; 2]> = rows.iter().map(|row| [row[0], of(row)]).collect();
            let pieces = thin(&points);
            let pieces = pieces.split(|point| !point[1].is_finite()).filter(|piece| !piece.is_empty());
            pieces.map(|piece| polyline(class, piece.iter().map(|&[at, v]| [x(at), y(v)]))).collect::<String>()
        };
        let band = bound.as_ref().map_or(String::new(), |bound| {
            let bounds: Vec<[f64; 2]> = rows.iter().zip(bound).map(|(row, bound)| [row[0], *bound]).collect();
            let side = |sign: f64| thin(&bounds).into_iter().map(move |[at, bound]| [x(at), error(sign * bound)]);
            let back: Vec<[f64; 2]> = side(-1.0).collect();
            let points = coordinates(side(1.0).chain(back.into_iter().rev()));
            format!("<polygon class=\"band\" points=\"{points}\"/>")
        });
        let picture = |class: &str, content: &str| {
            format!(
                "<svg class=\"{class}\" viewBox=\"0 0 1000 1000\" preserveAspectRatio=\"none\" aria-hidden=\"true\">{content}</svg>"
            )
        };
        let curves = line("truth", &|row| row[1], &value) + &line("prediction", &|row| row[2], &value);
        let zero = polyline("zero", [[0.0, 0.5 * SIDE], [SIDE, 0.5 * SIDE]]);
        let errors = band + &zero + &line("residual", &residual, &error);
        let (unit, name) = (escape(unit), escape(name));
        let unit = if unit.is_empty() { unit } else { format!(" <i>{unit}</i>") };
        let label = format!("{title}: {name}, largest error {}", short(largest));
        Some(format!(
            "<div class=\"strip\" role=\"img\" aria-label=\"{}\">\n<p><b>{}</b> {}</p>\n\
             <div class=\"scale\"><span>{}</span><code>{name}</code>{unit}<span>{}</span></div>{}\n\
             <div class=\"scale\"><span>{}</span>error<span>-{}</span></div>{}\n<div class=\"ends\"><span>{}</span><span>{}</span></div></div>\n",
            escape(&label),
            escape(title),
            escape(about),
            short(high),
            short(low),
            picture("value", &curves),
            brief(reach),
            brief(reach),
            picture("error", &errors),
            escape(begin),
            escape(end),
        ))
    }
}

/// Points of a polyline or polygon.
pub fn coordinates(points: impl IntoIterator<Item = [f64; 2]>) -> String {
    let mut text = String::new();
    for [x, y] in points {
        let separator = if text.is_empty() { "" } else { " " };
        // writing to a string does not fail
        let _ = write!(text, "{separator}{x:.0},{y:.0}");
    }
    text
}

fn polyline(class: &str, points: impl IntoIterator<Item = [f64; 2]>) -> String {
    format!("<polyline class=\"{class}\" points=\"{}\"/>", coordinates(points))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strip(rows: Vec<[f64; 3]>) -> Strip {
        Strip {
            title: "Worst run".into(),
            about: "with <L>".into(),
            quantity: ["theta".into(), "rad".into()],
            ends: ["0 s".into(), "2 s".into()],
            bound: Some(vec![0.02; rows.len()]),
            rows,
        }
    }

    #[test]
    fn a_strip_has_the_error_on_its_own_scale() {
        let html = strip(vec![[0.0, 1.0, 1.0], [1.0, 3.0, 3.01], [2.0, 2.0, 1.99]]).html().unwrap();
        for piece in [
            "<polyline class=\"truth\" points=\"0,1000 500,5 1000,502\"/>",
            // the band reaches to twice the largest error, 0.02
            "<polyline class=\"residual\" points=\"0,500 500,250 1000,750\"/>",
            "points=\"0,0 500,0 1000,0 1000,1000 500,1000 0,1000\"",
            "with &lt;L&gt;",
            "<span>3.01</span><code>theta</code> <i>rad</i><span>1</span>",
        ] {
            assert!(html.contains(piece), "{piece} is not in {html}");
        }
    }

    #[test]
    fn nothing_finite_is_not_drawn_and_gaps_are_gaps() {
        assert!(strip(Vec::new()).html().is_none());
        assert!(strip(vec![[0.0, f64::NAN, f64::NAN]]).html().is_none());
        let html = strip(vec![[0.0, 1.0, 1.0], [1.0, 2.0, f64::NAN], [2.0, 3.0, 3.0]]).html().unwrap();
        assert_eq!(html.matches("class=\"prediction\"").count(), 2);
        assert!(!html.contains("NaN"));
    }
}
