//! A chart as SVG, drawn by plotters: axes with names and units, lines, markers, areas, and a legend above.

use super::axis::{Axis, TICKS};
use crate::html;
use plotters::{
    coord::Shift,
    drawing::DrawingAreaErrorKind,
    element::{Circle, PathElement, Polygon, Rectangle},
    prelude::{
        BLACK, Cartesian2d, ChartBuilder, ChartContext, Color, DrawingArea, IntoDrawingArea, IntoFont, RGBColor,
        SVGBackend, ShapeStyle, WHITE,
    },
    style::{
        TextStyle,
        text_anchor::{HPos, Pos, VPos},
    },
};
use std::{fmt, io};

/// Two axes and the marks between them.
#[derive(Clone, Debug)]
pub struct Chart {
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// Series, each drawn above those before it.
    pub series: Vec<ChartSeries>,
}

/// Series of a chart, drawn in one ink.
#[derive(Clone, Debug)]
pub struct ChartSeries {
    /// Name in the legend; none if it has no place there.
    pub name: Option<String>,
    /// Color and dashes.
    pub ink: Ink,
    /// Shape of the series.
    pub shape: Shape,
}

/// Points and lines of a [`ChartSeries`], in the axes' units.
#[derive(Clone, Debug)]
pub enum Shape {
    /// A line through points; a point that is not finite is a gap.
    Line(Vec<[f64; 2]>),
    /// A broad [`Shape::Line`], with others drawn on it.
    Broad(Vec<[f64; 2]>),
    /// The area between two lines: x, lower and upper y.
    Band(Vec<[f64; 3]>),
    /// Circles.
    Circles(Vec<[f64; 2]>),
    /// Triangles, which stand out among circles.
    Triangles(Vec<[f64; 2]>),
    /// Rectangles, each by two opposite corners.
    Bars(Vec<[[f64; 2]; 2]>),
    /// Rectangles with a shade between 0, nearly white, and 1.
    Cells(Vec<([[f64; 2]; 2], f64)>),
    /// Numbered circles: number and place. Each number is where no other one is.
    Numbered(Vec<(usize, [f64; 2])>),
}

/// Colors of Okabe and Ito, which color-blind readers tell apart, each with different dashes for prints without color.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "colors")]
pub enum Ink {
    Black,
    Grey,
    Blue,
    Vermilion,
    Green,
    Purple,
    Orange,
    Sky,
}

/// Inks for lines of equal rank.
pub const INKS: [Ink; 6] = [Ink::Blue, Ink::Vermilion, Ink::Green, Ink::Purple, Ink::Orange, Ink::Sky];

/// plotters rounds coordinates to whole units, which makes curves jagged: it draws larger, and the picture is shown smaller.
const SCALE: u32 = 10;
/// Size of a chart without its legend. A phone shows it at three quarters of this width.
pub const WIDTH: u32 = 480;
const HEIGHT: u32 = 320;
/// Height of a line of the legend.
const LEGEND_LINE: u32 = 20;
/// Room left of the vertical axis, below the horizontal one, right of the plot and above it.
const MARGINS: [u32; 4] = [84, 48, 26, 10];
/// Part of the room left of the vertical axis, because letters are higher than plotters assumes.
const EDGE: u32 = 4;
const TICK_TEXT: f64 = 14.0;
const NAME_TEXT: f64 = 15.0;
/// Largest number of points of a line: more than there are pixels.
const LINE_POINTS: usize = 600;
/// Width of an average letter, relative to its height.
const LETTER: f64 = 0.6;

type ChartArea<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type DrawError = DrawingAreaErrorKind<io::Error>;
type DrawResult = Result<(), DrawError>;
type Plot<'a, 'b> = ChartContext<'b, SVGBackend<'a>, Cartesian2d<Axis, Axis>>;

/// Reason why a plot cannot be made.
#[derive(Debug)]
pub enum PlotError {
    /// There are no curves, or no times.
    Empty,
    /// plotters failed.
    Drawing(DrawError),
}

impl fmt::Display for PlotError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("there is nothing to plot"),
            Self::Drawing(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for PlotError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Empty => None,
            Self::Drawing(error) => Some(error),
        }
    }
}

impl Ink {
    fn color(self) -> RGBColor {
        match self {
            Self::Black => RGBColor(0, 0, 0),
            Self::Grey => RGBColor(182, 190, 198),
            Self::Blue => RGBColor(0, 114, 178),
            Self::Vermilion => RGBColor(213, 94, 0),
            Self::Green => RGBColor(0, 158, 115),
            Self::Purple => RGBColor(204, 121, 167),
            Self::Orange => RGBColor(230, 159, 0),
            Self::Sky => RGBColor(86, 180, 233),
        }
    }

    /// Lengths of dashes and gaps in the drawn units; none for a solid line.
    fn dashes(self) -> Option<&'static str> {
        match self {
            Self::Black | Self::Grey | Self::Blue => None,
            Self::Vermilion => Some("80 40"),
            Self::Green => Some("20 35"),
            Self::Purple => Some("120 40 20 40"),
            Self::Orange => Some("180 50"),
            Self::Sky => Some("50 25"),
        }
    }

    fn hex(self) -> String {
        let RGBColor(red, green, blue) = self.color();
        format!("#{red:02X}{green:02X}{blue:02X}")
    }

    fn stroke(self, width: u32) -> ShapeStyle {
        ShapeStyle { color: self.color().into(), filled: false, stroke_width: width * SCALE / 2 }
    }

    fn fill(self, opacity: f64) -> ShapeStyle {
        ShapeStyle { color: self.color().mix(opacity), filled: true, stroke_width: 0 }
    }
}

impl ChartSeries {
    /// Series with an entry in the legend.
    pub fn named(name: impl Into<String>, ink: Ink, shape: Shape) -> Self {
        Self { name: Some(name.into()), ink, shape }
    }

    /// Series without an entry in the legend.
    pub fn silent(ink: Ink, shape: Shape) -> Self {
        Self { name: None, ink, shape }
    }
}

impl Chart {
    /// Makes one unit equally long on both axes, which must be linear, by lengthening the range of one of them.
    pub fn equal_scales(mut self) -> Self {
        let [left, below, right, above] = MARGINS.map(f64::from);
        let (width, height) = (f64::from(WIDTH) - left - right, f64::from(HEIGHT) - below - above);
        let (x, y) = (width / (self.x.high - self.x.low), height / (self.y.high - self.y.low));
        let (axis, factor) = if x > y { (&mut self.x, x / y) } else { (&mut self.y, y / x) };
        let (middle, half) = (0.5 * (axis.low + axis.high), 0.5 * (axis.high - axis.low) * factor);
        (axis.low, axis.high) = (middle - half, middle + half);
        self
    }

    /// The picture. The same chart always gives the same text.
    ///
    /// # Errors
    /// [`PlotError::Drawing`].
    pub fn svg(&self, title: &str) -> Result<String, PlotError> {
        stack(title, std::slice::from_ref(self), HEIGHT)
    }

    /// Returns true if a line has too many points to draw all of them.
    pub fn is_thinned(&self) -> bool {
        self.series.iter().any(
            |series| matches!(&series.shape, Shape::Line(points) | Shape::Broad(points) if points.len() > LINE_POINTS),
        )
    }

    fn legend(&self) -> Vec<(&str, &ChartSeries)> {
        self.series.iter().filter_map(|series| Some((series.name.as_deref()?, series))).collect()
    }

    /// Entries side by side: as many as the longest one leaves room for.
    fn legend_columns(&self) -> u32 {
        let longest = self.legend().iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        let entry = 44.0 + longest as f64 * LETTER * TICK_TEXT;
        ((f64::from(WIDTH) / entry) as u32).clamp(1, 4)
    }

    fn legend_height(&self) -> u32 {
        match self.legend().len() as u32 {
            0 => 0,
            entries => entries.div_ceil(self.legend_columns()) * LEGEND_LINE + 4,
        }
    }

    fn draw(&self, area: &ChartArea) -> DrawResult {
        let (legend, plot) = area.split_vertically(self.legend_height() * SCALE);
        self.draw_legend(&legend)?;
        let [left, below, right, above] = MARGINS.map(|margin| margin * SCALE);
        let mut plot = ChartBuilder::on(&plot)
            .margin_top(above)
            .margin_right(right)
            .margin_left(EDGE * SCALE)
            .x_label_area_size(below)
            .y_label_area_size(left - EDGE * SCALE)
            .build_cartesian_2d(self.x.clone(), self.y.clone())?;
        plot.configure_mesh()
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .axis_desc_style(text(NAME_TEXT))
            .label_style(text(TICK_TEXT))
            .x_labels(TICKS)
            .y_labels(TICKS)
            .max_light_lines(0)
            .bold_line_style(ShapeStyle { color: RGBColor(225, 228, 232).into(), filled: false, stroke_width: SCALE })
            .axis_style(ShapeStyle { color: BLACK.into(), filled: false, stroke_width: SCALE })
            .set_all_tick_mark_size(5 * SCALE)
            .draw()?;
        self.series.iter().try_for_each(|series| self.draw_series(&mut plot, series))
    }

    fn draw_legend(&self, area: &ChartArea) -> DrawResult {
        let columns = self.legend_columns();
        let style = text(TICK_TEXT).pos(Pos::new(HPos::Left, VPos::Center));
        for (index, (name, series)) in (0..).zip(self.legend()) {
            let column = (WIDTH - 20) / columns * (index % columns);
            let (x, y) = ((12 + column) * SCALE, (index / columns * LEGEND_LINE + LEGEND_LINE / 2 + 2) * SCALE);
            let (x, y, unit) = (x as i32, y as i32, SCALE as i32);
            let sample = [(x, y), (x + 30 * unit, y)];
            match series.shape {
                Shape::Line(_) => draw_line(area, sample.to_vec(), series.ink)?,
                Shape::Broad(_) => area.draw(&PathElement::new(sample.to_vec(), series.ink.stroke(10)))?,
                Shape::Circles(_) | Shape::Numbered(_) => {
                    area.draw(&Circle::new((x + 15 * unit, y), 4 * unit, series.ink.fill(1.0)))?;
                }
                Shape::Triangles(_) => area.draw(&triangle((x + 15 * unit, y), series.ink))?,
                Shape::Band(_) | Shape::Bars(_) | Shape::Cells(_) => {
                    let opacity = if matches!(series.shape, Shape::Band(_)) { 0.3 } else { 1.0 };
                    let corners = [(x, y - 5 * unit), (x + 30 * unit, y + 5 * unit)];
                    area.draw(&Rectangle::new(corners, series.ink.fill(opacity)))?;
                }
            }
            area.draw_text(name, &style, (x + 36 * unit, y))?;
        }
        Ok(())
    }

    fn draw_series(&self, plot: &mut Plot, series: &ChartSeries) -> DrawResult {
        let area = plot.plotting_area().strip_coord_spec();
        let (x0, y0) = plot.plotting_area().get_base_pixel();
        let place = |&[x, y]: &[f64; 2]| {
            let (x, y) = plot.plotting_area().map_coordinate(&(x, y));
            (x - x0, y - y0)
        };
        let ink = series.ink;
        match &series.shape {
            Shape::Line(points) | Shape::Broad(points) => {
                for piece in
                    thin(points).split(|[x, y]| !x.is_finite() || !y.is_finite()).filter(|piece| piece.len() > 1)
                {
                    let pixels: Vec<(i32, i32)> = self.clipped(piece).iter().map(place).collect();
                    match series.shape {
                        Shape::Broad(_) => area.draw(&PathElement::new(pixels, ink.stroke(9)))?,
                        _ => draw_line(&area, pixels, ink)?,
                    }
                }
            }
            Shape::Band(points) => {
                let lower = points.iter().map(|&[x, low, _]| [x, low]);
                let upper = points.iter().rev().map(|&[x, _, high]| [x, high]);
                let outline: Vec<[f64; 2]> = lower.chain(upper).collect();
                let pixels: Vec<(i32, i32)> = self.clipped(&outline).iter().map(place).collect();
                area.draw(&Polygon::new(pixels, ink.fill(0.3)))?;
            }
            Shape::Circles(points) => {
                for point in points {
                    area.draw(&Circle::new(place(point), 5 * SCALE / 2, ink.fill(0.75)))?;
                }
            }
            Shape::Triangles(points) => {
                for point in points {
                    area.draw(&triangle(place(point), ink))?;
                }
            }
            Shape::Bars(bars) => {
                for [from, to] in bars {
                    area.draw(&Rectangle::new([place(from), place(to)], ink.fill(1.0)))?;
                }
            }
            Shape::Cells(cells) => {
                for ([from, to], shade) in cells {
                    let style = ShapeStyle { color: shaded(ink, *shade).into(), filled: true, stroke_width: 0 };
                    area.draw(&Rectangle::new([place(from), place(to)], style))?;
                }
            }
            Shape::Numbered(points) => {
                let pixels: Vec<(usize, (i32, i32))> =
                    points.iter().map(|(number, point)| (*number, place(point))).collect();
                draw_numbered(&area, &pixels, ink)?;
            }
        }
        Ok(())
    }

    /// Points moved to the edge of the plot where they are beyond it.
    fn clipped(&self, points: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let Self { x: horizontal, y: vertical, .. } = self;
        points
            .iter()
            .map(|&[x, y]| [x.clamp(horizontal.low, horizontal.high), y.clamp(vertical.low, vertical.high)])
            .collect()
    }
}

/// Charts one below the other, each of this height without its legend.
///
/// # Errors
/// [`PlotError::Drawing`].
pub fn stack(title: &str, charts: &[Chart], height: u32) -> Result<String, PlotError> {
    let heights: Vec<u32> = charts.iter().map(|chart| height + chart.legend_height()).collect();
    let total: u32 = heights.iter().sum();
    let mut svg = String::new();
    draw_stack(&mut svg, charts, &heights).map_err(PlotError::Drawing)?;
    Ok(finish(&svg, title, total))
}

fn draw_stack(svg: &mut String, charts: &[Chart], heights: &[u32]) -> DrawResult {
    let total: u32 = heights.iter().sum();
    let mut area = SVGBackend::with_string(svg, (SCALE * WIDTH, SCALE * total)).into_drawing_area();
    area.fill(&WHITE)?;
    for (chart, height) in charts.iter().zip(heights) {
        let (upper, rest) = area.split_vertically(SCALE * height);
        chart.draw(&upper)?;
        area = rest;
    }
    area.present()
}

/// Adds what plotters' SVG lacks: a display size, a name for screen readers, and dashes, which depend on the color.
/// Removes redundant attributes.
fn finish(svg: &str, title: &str, height: u32) -> String {
    let drawn = format!("width=\"{}\" height=\"{}\"", SCALE * WIDTH, SCALE * height);
    let title = html::escape(title);
    let shown = format!("width=\"{WIDTH}\" height=\"{height}\" role=\"img\" aria-label=\"{title}\"");
    let mut svg = svg.replacen(&drawn, &shown, 1);
    for unsaid in [" opacity=\"1\"", " stroke=\"none\""] {
        svg = svg.replace(unsaid, "");
    }
    for ink in INKS {
        let stroke = format!(" stroke=\"{}\"", ink.hex());
        if let Some(dashes) = ink.dashes() {
            svg = svg.replace(&stroke, &format!("{stroke} stroke-dasharray=\"{dashes}\""));
        }
    }
    svg
}

fn text(size: f64) -> TextStyle<'static> {
    // plotters shrinks the requested size by this factor
    ("sans-serif", size * 1.24 * f64::from(SCALE)).into_font().color(&BLACK)
}

fn triangle((x, y): (i32, i32), ink: Ink) -> Polygon<(i32, i32)> {
    let unit = SCALE as i32;
    Polygon::new([(x, y - 6 * unit), (x + 5 * unit, y + 4 * unit), (x - 5 * unit, y + 4 * unit)], ink.fill(1.0))
}

/// Between nearly white and the ink.
fn shaded(ink: Ink, shade: f64) -> RGBColor {
    let RGBColor(red, green, blue) = ink.color();
    let [red, green, blue] =
        [red, green, blue].map(|channel| (235.0 + (f64::from(channel) - 235.0) * shade.clamp(0.0, 1.0)).round() as u8);
    RGBColor(red, green, blue)
}

/// At most `LINE_POINTS` points: the lowest and the highest of each group, so that no peak is lost.
pub fn thin(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    if points.len() <= LINE_POINTS {
        return points.to_vec();
    }
    let group = points.len().div_ceil(LINE_POINTS / 2);
    points
        .chunks(group)
        .flat_map(|group| {
            let points = group.iter().enumerate();
            let lowest = points.clone().min_by(|(_, a), (_, b)| a[1].total_cmp(&b[1]));
            let highest = points.max_by(|(_, a), (_, b)| a[1].total_cmp(&b[1]));
            let mut ends: Vec<usize> = lowest.into_iter().chain(highest).map(|(index, _)| index).collect();
            ends.sort_unstable();
            ends.into_iter().map(|index| group[index]).collect::<Vec<_>>()
        })
        .collect()
}

/// Numbers in circles. A circle without room at its point is drawn beside it, with a leader line.
fn draw_numbered(area: &ChartArea, points: &[(usize, (i32, i32))], ink: Ink) -> DrawResult {
    let unit = SCALE as i32;
    let radius = 10 * unit;
    let (width, height) = area.dim_in_pixel();
    let (width, height) = (width as i32, height as i32);
    let mut taken: Vec<(i32, i32)> = Vec::new();
    for &(_, (x, y)) in points {
        let (columns, rows) = (radius..=width - radius, radius..=height - radius);
        // outwards in a spiral
        let spiral = (0..400).map(|step| {
            let (distance, angle) = (f64::from(step) * 0.6 * f64::from(SCALE), f64::from(step) * 0.7);
            (x + (distance * angle.cos()) as i32, y + (distance * angle.sin()) as i32)
        });
        let place = spiral
            .into_iter()
            .find(|&(x, y)| {
                columns.contains(&x)
                    && rows.contains(&y)
                    && taken.iter().all(|(u, v)| (x - u).pow(2) + (y - v).pow(2) > (2 * radius + 2 * unit).pow(2))
            })
            .unwrap_or((x, y));
        taken.push(place);
    }
    for (&(_, point), &place) in points.iter().zip(&taken) {
        area.draw(&PathElement::new(vec![point, place], Ink::Black.stroke(2)))?;
        area.draw(&Circle::new(point, 3 * unit, Ink::Black.fill(1.0)))?;
    }
    let style = ("sans-serif", 13.0 * 1.24 * f64::from(SCALE)).into_font().color(&WHITE);
    let style = style.pos(Pos::new(HPos::Center, VPos::Center));
    for ((number, _), &place) in points.iter().zip(&taken) {
        area.draw(&Circle::new(place, radius, ink.fill(1.0)))?;
        area.draw_text(&number.to_string(), &style, place)?;
    }
    Ok(())
}

fn draw_line(area: &ChartArea, pixels: Vec<(i32, i32)>, ink: Ink) -> DrawResult {
    area.draw(&PathElement::new(pixels, ink.stroke(4)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart() -> Chart {
        let line: Vec<[f64; 2]> = (0..5000).map(|i| f64::from(i) * 1e-3).map(|t| [t, (7.0 * t).sin()]).collect();
        Chart {
            x: Axis::exact("time", "s", 0.0, 5.0),
            y: Axis::linear("theta & phi", "rad", line.iter().map(|point| point[1])),
            series: vec![
                ChartSeries::named("truth", Ink::Black, Shape::Line(line.clone())),
                ChartSeries::named("prediction", Ink::Vermilion, Shape::Line(line)),
                ChartSeries::silent(Ink::Grey, Shape::Band(vec![[0.0, -9.0, 9.0], [1.0, f64::MIN, f64::MAX]])),
                ChartSeries::silent(
                    Ink::Blue,
                    Shape::Numbered(vec![(1, [1.0, 0.5]), (2, [1.0, 0.5]), (3, [1.01, 0.5])]),
                ),
            ],
        }
    }

    #[test]
    fn a_chart_has_axis_names_legend_dashes_and_a_size() {
        let svg = chart().svg("a <chart>").unwrap();
        for text in [
            "theta &amp; phi [rad]",
            "time [s]",
            "truth",
            "prediction",
            "aria-label=\"a &lt;chart&gt;\"",
            "stroke-dasharray",
        ] {
            assert!(svg.contains(text), "no {text} in {svg}");
        }
        assert!(svg.contains("width=\"480\"") && svg.contains("viewBox=\"0 0 4800 "));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        assert_eq!(svg, chart().svg("a <chart>").unwrap());
    }

    #[test]
    fn a_long_line_keeps_its_peaks() {
        let mut line: Vec<[f64; 2]> = (0..100_000).map(|i| [f64::from(i), 0.0]).collect();
        line[54_321][1] = 3.0;
        line[54_322][1] = -2.0;
        let thinned = thin(&line);
        assert!(thinned.len() <= LINE_POINTS);
        assert!(thinned.contains(&[54_321.0, 3.0]) && thinned.contains(&[54_322.0, -2.0]));
        assert!(thinned.is_sorted_by(|a, b| a[0] <= b[0]));
    }

    #[test]
    fn equal_scales_lengthen_one_range_only() {
        let chart = Chart { x: Axis::exact("x", "m", -1.0, 1.0), y: Axis::exact("y", "m", 0.0, 0.1), series: vec![] };
        let equal = chart.equal_scales();
        assert_eq!((equal.x.low, equal.x.high), (-1.0, 1.0));
        assert!((equal.y.low + equal.y.high - 0.1).abs() < 1e-12);
        let per_unit = |axis: &Axis, length: f64| length / (axis.high - axis.low);
        assert!((per_unit(&equal.x, 370.0) - per_unit(&equal.y, 262.0)).abs() < 1e-9);
    }
}
