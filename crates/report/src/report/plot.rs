//! Outputs of a run over time.

use super::{
    axis::Axis,
    chart::{Chart, ChartSeries, Ink, PlotError, Shape, stack},
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

/// Height of a chart.
const HEIGHT: u32 = 200;

/// One chart per curve, one below the other, over a common time axis in seconds.
///
/// # Errors
/// [`PlotError`].
pub fn time_series_svg(title: &str, times: &[f64], curves: &[Curve]) -> Result<String, PlotError> {
    let (Some(&start), Some(&stop), false) = (times.first(), times.last(), curves.is_empty()) else {
        return Err(PlotError::Empty);
    };
    let charts: Vec<Chart> = curves
        .iter()
        .map(|Curve { name, unit, values }| Chart {
            x: Axis::exact("time", "s", start, stop),
            y: Axis::linear(name, unit, values.iter().copied()),
            series: vec![ChartSeries::silent(
                Ink::Blue,
                Shape::Line(times.iter().zip(values).map(|(&t, &y)| [t, y]).collect()),
            )],
        })
        .collect();
    stack(title, &charts, HEIGHT)
}

/// SVG chart of two runs with the same number of curves, under the names of the runs. Each run has its own times.
///
/// # Errors
/// As [`time_series_svg`].
pub fn two_runs_svg(title: &str, names: [&str; 2], runs: [(&[f64], &[Curve]); 2]) -> Result<String, PlotError> {
    let [(times, curves), (other_times, other_curves)] = runs;
    let (Some(&start), Some(&stop), false) = (times.first(), times.last(), curves.is_empty()) else {
        return Err(PlotError::Empty);
    };
    let line =
        |times: &[f64], curve: &Curve| Shape::Line(times.iter().zip(&curve.values).map(|(&t, &y)| [t, y]).collect());
    let charts: Vec<Chart> = curves
        .iter()
        .zip(other_curves)
        .map(|(curve, other)| Chart {
            x: Axis::exact("time", "s", start, stop),
            y: Axis::linear(&curve.name, &curve.unit, curve.values.iter().chain(&other.values).copied()),
            series: vec![
                ChartSeries::named(names[0], Ink::Blue, line(times, curve)),
                ChartSeries::named(names[1], Ink::Vermilion, line(other_times, other)),
            ],
        })
        .collect();
    stack(title, &charts, HEIGHT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_has_a_chart_with_name_and_unit() {
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
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
    }

    #[test]
    fn two_runs_are_in_one_chart_with_a_legend() {
        let curve = |values: [f64; 3]| Curve { name: "x".into(), unit: "m".into(), values: values.into() };
        let (source, surrogate) = ([curve([0.0, 1.0, 2.0])], [curve([0.0, 1.5, 9.0])]);
        let times = [0.0, 1.0, 2.0];
        let svg = two_runs_svg("T", ["source", "surrogate"], [(&times, &source), (&times, &surrogate)]).unwrap();
        for text in ["source", "surrogate", "x [m]"] {
            assert!(svg.contains(text), "no {text}");
        }
        // lines and their samples in the legend
        assert_eq!(svg.matches("stroke=\"#D55E00\"").count(), 2);
        assert!(two_runs_svg("T", ["a", "b"], [(&[], &[]), (&[], &[])]).is_err());
    }

    #[test]
    fn nothing_to_plot_is_an_error() {
        assert!(time_series_svg("empty", &[], &[]).is_err());
    }
}
