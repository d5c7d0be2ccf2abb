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
        let (left, right) = extent(rows.iter().map(|row| row[0]))?;
        let values = extent(rows.iter().flat_map(|row| [row[1], row[2]]).filter(|value| value.is_finite()))?;
        let errors = rows.iter().map(residual).filter(|error| error.is_finite());
        let largest = errors.fold(0.0, |largest: f64, error| largest.max(error.abs()));
        let widest = bound.iter().flatten().copied().filter(|bound| bound.is_finite()).fold(0.0, f64::max);
        // a bound far beyond the errors would flatten them
        let reach = if widest > 0.0 { largest.max(widest.min(2.0 * largest)) } else { largest };
        let reach = if reach > 0.0 { reach } else { 1.0 };
        let (low, high) = if values.1 > values.0 { values } else { (values.0 - 0.5, values.1 + 0.5) };
        let scales = StripScales { left, right, low, high, reach };
        let truth = rows.iter().map(|row| [row[0], row[1]]).collect();
        let prediction = rows.iter().map(|row| [row[0], row[2]]).collect();
        let residuals = rows.iter().map(|row| [row[0], residual(row)]).collect();
        let curves = line("truth", truth, |[x, y]| [scales.x(x), scales.value(y)])
            + &line("prediction", prediction, |[x, y]| [scales.x(x), scales.value(y)]);
        let band = bound.as_ref().map_or(String::new(), |bound| scales.band(rows, bound));
        let zero = polyline("zero", [[0.0, 0.5 * SIDE], [SIDE, 0.5 * SIDE]]);
        let errors = band + &zero + &line("residual", residuals, |[x, y]| [scales.x(x), scales.error(y)]);
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
            stretched_svg("value", &curves),
            brief(reach),
            brief(reach),
            stretched_svg("error", &errors),
            escape(begin),
            escape(end),
        ))
    }
}

/// Ends of the axes of both charts of a strip.
struct StripScales {
    left: f64,
    right: f64,
    low: f64,
    high: f64,
    /// Largest error that is shown.
    reach: f64,
}

impl StripScales {
    fn x(&self, x: f64) -> f64 {
        if self.right > self.left { SIDE * (x - self.left) / (self.right - self.left) } else { 0.5 * SIDE }
    }

    fn value(&self, y: f64) -> f64 {
        SIDE * (self.high - y) / (self.high - self.low)
    }

    fn error(&self, y: f64) -> f64 {
        (0.5 * SIDE * (1.0 - y / self.reach)).clamp(0.0, SIDE)
    }

    /// The band that errors are expected in.
    fn band(&self, rows: &[[f64; 3]], bound: &[f64]) -> String {
        let bounds: Vec<[f64; 2]> = rows.iter().zip(bound).map(|(row, bound)| [row[0], *bound]).collect();
        let bounds = thin(&bounds);
        let above = bounds.iter().map(|[at, bound]| [self.x(*at), self.error(*bound)]);
        let below = bounds.iter().rev().map(|[at, bound]| [self.x(*at), self.error(-bound)]);
        format!("<polygon class=\"band\" points=\"{}\"/>", coordinates(above.chain(below)))
    }
}

/// Prediction minus truth.
fn residual([_, truth, prediction]: &[f64; 3]) -> f64 {
    prediction - truth
}

/// The parts of a curve that are finite.
fn line(class: &str, points: Vec<[f64; 2]>, place: impl Fn([f64; 2]) -> [f64; 2]) -> String {
    let points = thin(&points);
    let pieces = points.split(|point| !point[1].is_finite()).filter(|piece| !piece.is_empty());
    pieces.map(|piece| polyline(class, piece.iter().map(|point| place(*point)))).collect()
}

fn stretched_svg(class: &str, content: &str) -> String {
    format!(
        "<svg class=\"{class}\" viewBox=\"0 0 1000 1000\" preserveAspectRatio=\"none\" aria-hidden=\"true\">{content}</svg>"
    )
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
