//! Course of the training.

use super::{Axis, Chart, ChartSeries, Figure, Ink, Material, ReportBlock, Section, Shape, paragraph};
use crate::training::EpochRecord;

pub fn section(material: &Material) -> Option<Section> {
    let history = material.history;
    let (first, last) = (history.first()?, history.last()?);
    let best = history.iter().min_by(|a, b| a.validation_loss.total_cmp(&b.validation_loss))?;
    let epochs = Axis::whole("epoch", [first.epoch as f64, last.epoch as f64]);
    let losses = Axis::log("loss", "", history.iter().flat_map(|epoch| [epoch.train_loss, epoch.validation_loss]));
    let place = [best.epoch as f64, best.validation_loss];
    let loss = Chart {
        x: epochs.clone(),
        y: losses,
        series: vec![
            ChartSeries::named("training rows", Ink::Blue, over_epochs(history, |epoch| epoch.train_loss)),
            ChartSeries::named("held-out rows", Ink::Vermilion, over_epochs(history, |epoch| epoch.validation_loss)),
            ChartSeries::named("best epoch", Ink::Black, Shape::Triangles(vec![place])),
        ],
    };
    let rate = Chart {
        x: epochs,
        y: Axis::linear("learning rate", "", history.iter().map(|epoch| epoch.learning_rate).chain([0.0])),
        series: vec![ChartSeries::silent(Ink::Blue, over_epochs(history, |epoch| epoch.learning_rate))],
    };
    let text = match material.evaluated.surrogate.program().graph.instants() {
        None => format!(
            "Loss of the standardized outputs, epoch by epoch. The network is that of epoch {}, the best on the held-out {}, \
             of {}.",
            best.epoch,
            if material.evaluated.is_of_rows() { "rows" } else { "runs" },
            history.len()
        ),
        Some(_) => "Loss of the standardized outputs, epoch by epoch, mean over the networks. Each network is that \
                    of the best epoch on the held-out runs."
            .into(),
    };
    let figures = vec![
        Figure::new("training-loss", "Loss on training rows and held-out rows.", loss),
        Figure::new("training-rate", "Learning rate at the end of each epoch.", rate),
    ];
    Some(Section {
        id: "training",
        title: "Training".into(),
        blocks: vec![paragraph(&text), ReportBlock::Figures(figures)],
    })
}

/// A value of each epoch.
fn over_epochs(history: &[EpochRecord], value: fn(&EpochRecord) -> f64) -> Shape {
    Shape::Line(history.iter().map(|epoch| [epoch.epoch as f64, value(epoch)]).collect())
}
