//! Pictures and pages: a report of a study's surrogate as one self-contained page, and plots of runs.
//!
//! The first screen answers: `first.rs` has the verdict, the errors, the ranges and the cost; sections follow with the details.
//!
//! One way: test runs and surrogate -> [`Evaluated`] numbers -> sections of [`Figure`]s and tables -> [`page`].

pub mod axis;
pub mod chart;
mod figures;
mod first;
mod numbers;
mod page;
mod picture;
mod plot;
pub mod readable;
mod strip;

use crate::{
    Error, Result,
    evaluation::Verdict,
    evaluation::comparison::Comparison,
    source::{MovingMechanism, MovingPoint},
    study::Study,
    training::EpochRecord,
};
use chart::Chart;
pub use figures::{Beside, card_figures};
pub use first::ranges;
pub use numbers::Evaluated;
pub use page::page;
pub use plot::{Curve, time_series_svg, two_runs_svg};

/// Data that a report is made from.
#[derive(Debug)]
pub struct Material<'a> {
    /// The study.
    pub study: &'a Study,
    /// The surrogate on the test runs.
    pub evaluated: &'a Evaluated<'a>,
    /// The verdict on it.
    pub verdict: &'a Verdict,
    /// Points whose paths are shown.
    pub points: &'a [MovingPoint],
    /// The mechanism in the worst run, if it was simulated here.
    pub mechanism: Option<MovingMechanism>,
    /// Seconds of a step on one core, if they were measured.
    pub step_seconds: Option<f64>,
    /// Speed-up against the source, if that can be run.
    pub speed_up: Option<f64>,
    /// Reason why there is no speed-up, if there is none.
    pub no_speed: &'static str,
    /// The surrogate as the subject of a sentence; none if its program says it.
    pub subject: Option<&'static str>,
    /// The training, epoch by epoch.
    pub history: &'a [EpochRecord],
    /// Origin of the surrogate: names and values.
    pub facts: &'a [(String, String)],
    /// Other models of the same rows.
    pub comparison: Option<&'a Comparison>,
    /// Another surrogate of the same source.
    pub beside: Option<Beside<'a>>,
}

/// A part of a report under a heading.
#[derive(Debug)]
pub struct Section {
    id: &'static str,
    title: String,
    blocks: Vec<ReportBlock>,
}

/// Block of a section.
#[derive(Debug)]
enum ReportBlock {
    /// A piece of HTML.
    Html(String),
    /// Figures beside each other where there is room.
    Figures(Vec<Figure>),
}

/// A chart with a caption.
#[derive(Clone, Debug)]
pub struct Figure {
    /// Unique in a report: letters, digits, `-` and `_`.
    pub id: String,
    /// Text on the content of the chart.
    pub caption: String,
    /// The chart.
    pub chart: Chart,
}

/// A figure as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    /// See [`Figure::id`].
    pub id: String,
    /// [`Figure::caption`], and a note on omitted points.
    pub caption: String,
    /// The picture.
    pub svg: String,
}

impl Figure {
    fn new(id: &str, caption: impl Into<String>, chart: Chart) -> Self {
        let id = id.chars().map(|c| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' }).collect();
        Self { id, caption: caption.into(), chart }
    }

    /// The figure as SVG.
    ///
    /// # Errors
    /// [`Error::Plot`].
    pub fn draw(&self) -> Result<Drawn> {
        let Self { id, caption, chart } = self;
        let svg = chart.svg(caption).map_err(Error::plot(format!("{id}.svg")))?;
        let thinned = if chart.is_thinned() { " Lines are thinned; their peaks are kept." } else { "" };
        Ok(Drawn { id: id.clone(), caption: format!("{caption}{thinned}"), svg })
    }
}

#[cfg(test)]
mod testing;
