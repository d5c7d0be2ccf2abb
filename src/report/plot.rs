//! Plots as SVG, by plotters.

use plotters::{
    coord::Shift,
    drawing::DrawingAreaErrorKind,
    prelude::{BLACK, ChartBuilder, DrawingArea, IntoDrawingArea, LineSeries, RGBColor, SVGBackend, ShapeStyle, WHITE},
};

/// One quantity over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name of the quantity.
    pub name: String,
    /// Unit; empty for a dimensionless quantity.
    pub unit: String,
    /// One value per time.
    pub values: Vec<f64>,
}

/// plotters rounds coordinates to whole units, which makes curves jagged: it draws larger, and the picture is shown smaller.
const SCALE: u32 = 8;
/// Size of the picture as shown, in pixels.
const WIDTH: u32 = 900;
const PANEL_HEIGHT: u32 = 240;
const TITLE_HEIGHT: u32 = 40;
/// Blue of the Okabe-Ito palette, which colour-blind readers tell apart.
const BLUE: RGBColor = RGBColor(0, 114, 178);

/// One panel a curve, one above the other, over a common time axis in seconds.
///
/// # Errors
/// A sentence if there is nothing to draw or plotters fails.
pub fn time_series_svg(title: &str, times: &[f64], curves: &[Curve]) -> Result<String, String> {
    if times.is_empty() || curves.is_empty() {
        return Err("there is nothing to plot".into());
    }
    let mut svg = String::new();
    let height = TITLE_HEIGHT + PANEL_HEIGHT * curves.len() as u32;
    draw(&mut svg, height, title, times, curves).map_err(|error| error.to_string())?;
    let drawn = format!("width=\"{}\" height=\"{}\"", SCALE * WIDTH, SCALE * height);
    Ok(svg.replacen(&drawn, &format!("width=\"{WIDTH}\" height=\"{height}\""), 1))
}

type DrawResult = Result<(), DrawingAreaErrorKind<std::io::Error>>;

fn draw(svg: &mut String, height: u32, title: &str, times: &[f64], curves: &[Curve]) -> DrawResult {
    let area = SVGBackend::with_string(svg, (SCALE * WIDTH, SCALE * height)).into_drawing_area();
    area.fill(&WHITE)?;
    let area = area.margin(8 * SCALE, 0, 0, 0).titled(title, ("sans-serif", 20 * SCALE))?;
    for (index, (panel, curve)) in area.split_evenly((curves.len(), 1)).iter().zip(curves).enumerate() {
        draw_panel(panel, times, curve, index + 1 == curves.len())?;
    }
    area.present()
}

fn draw_panel(panel: &DrawingArea<SVGBackend, Shift>, times: &[f64], curve: &Curve, last: bool) -> DrawResult {
    let (start, stop) = range(times, 0.0);
    let (low, high) = range(&curve.values, 0.05);
    let mut chart = ChartBuilder::on(panel)
        .margin(8 * SCALE)
        .margin_right(24 * SCALE)
        .x_label_area_size(SCALE * if last { 44 } else { 24 })
        .y_label_area_size(80 * SCALE)
        .build_cartesian_2d(start..stop, low..high)?;
    let unit = if curve.unit.is_empty() { String::new() } else { format!(" [{}]", curve.unit) };
    let digits = digits_for(high - low);
    chart
        .configure_mesh()
        .x_desc(if last { "time [s]" } else { "" })
        .y_desc(format!("{}{unit}", curve.name))
        .axis_desc_style(("sans-serif", 15 * SCALE))
        .label_style(("sans-serif", 13 * SCALE))
        .max_light_lines(0)
        .bold_line_style(ShapeStyle { color: RGBColor(220, 220, 220).into(), filled: false, stroke_width: SCALE })
        .axis_style(ShapeStyle { color: BLACK.into(), filled: false, stroke_width: SCALE })
        .set_all_tick_mark_size(5 * SCALE)
        .y_label_formatter(&|value| format!("{value:.digits$}"))
        .y_labels(6)
        .draw()?;
    let points = times.iter().copied().zip(curve.values.iter().copied()).filter(|(_, value)| value.is_finite());
    let style = ShapeStyle { color: BLUE.into(), filled: false, stroke_width: 2 * SCALE };
    chart.draw_series(LineSeries::new(points, style))?;
    Ok(())
}

/// Smallest and largest finite value, widened by a share of their distance; never empty.
fn range(values: &[f64], widen: f64) -> (f64, f64) {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
    if low > high {
        return (0.0, 1.0);
    }
    // a constant needs room too, and so much that the axis labels differ
    let margin = if high > low { widen * (high - low) } else { 0.1 * low.abs().max(1.0) };
    (low - margin, high + margin)
}

/// Decimals that tell the labels of an axis of this length apart.
fn digits_for(length: f64) -> usize {
    (1.0 - length.log10().floor()).clamp(0.0, 12.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_has_a_panel_with_name_and_unit() {
        let times: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.04).collect();
        let curve = |name: &str, unit: &str, f: fn(f64) -> f64| Curve {
            name: name.into(),
            unit: unit.into(),
            values: times.iter().map(|&t| f(t)).collect(),
        };
        let curves = [curve("theta", "rad", f64::sin), curve("constant", "", |_| 3.0), curve("holes", "m", f64::ln)];
        let svg = time_series_svg("A & B", &times, &curves).unwrap();
        for text in ["theta [rad]", "constant", "holes [m]", "time [s]", "A &amp; B"] {
            assert!(svg.contains(text), "no {text}");
        }
        assert!(svg.matches("<polyline").count() >= 3);
        assert!(svg.contains("width=\"900\" height=\"760\" viewBox=\"0 0 7200 6080\""));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn nothing_to_plot_is_an_error() {
        assert!(time_series_svg("empty", &[], &[]).is_err());
    }
}
