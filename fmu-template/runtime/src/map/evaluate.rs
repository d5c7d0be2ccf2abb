//! A map prepared for evaluation: its value, and its exact derivatives.

use super::{
    Map, ScaledNetwork,
    graph::{GraphScratch, PreparedGraph},
    task::Task,
};
use crate::{
    Precision,
    simd::{Compute, Simd},
};

/// A map laid out for fast evaluation: a network is a graph of layers.
#[derive(Clone, Debug)]
pub(crate) enum PreparedMap {
    Double(PreparedGraph<f64, 8>),
    Single(PreparedGraph<f32, 16>),
}

/// Working memory of one evaluation at a time. Networks whose layers have the same sizes can share it.
#[derive(Clone, Debug)]
pub(crate) enum MapScratch {
    Double(GraphScratch<f64, 8>),
    Single(GraphScratch<f32, 16>),
}

impl PreparedMap {
    pub(crate) fn new(map: &Map, precision: Precision) -> Self {
        match map {
            Map::Network(network) => Self::of_network(network, precision),
            Map::Graph(graph) => match precision {
                Precision::Double => Self::Double(PreparedGraph::new(graph)),
                Precision::Single => Self::Single(PreparedGraph::new(graph)),
            },
        }
    }

    pub(crate) fn of_network(network: &ScaledNetwork, precision: Precision) -> Self {
        match precision {
            Precision::Double => Self::Double(PreparedGraph::of_network(network)),
            Precision::Single => Self::Single(PreparedGraph::of_network(network)),
        }
    }

    pub(crate) fn scratch(&self) -> MapScratch {
        match self {
            Self::Double(graph) => MapScratch::Double(graph.scratch()),
            Self::Single(graph) => MapScratch::Single(graph.scratch()),
        }
    }

    /// Does a task at a point, one value per column. Does not allocate.
    ///
    /// # Panics
    /// If the scratch belongs to another map.
    #[inline]
    pub(crate) fn perform(&self, simd: Simd, point: &[f64], task: Task, scratch: &mut MapScratch) {
        simd.run(Perform { map: self, point, task, scratch });
    }
}

struct Perform<'a, 'b> {
    map: &'a PreparedMap,
    point: &'a [f64],
    task: Task<'b>,
    scratch: &'a mut MapScratch,
}

impl Compute for Perform<'_, '_> {
    #[inline(always)]
    fn run<const SIMD: u8>(self) {
        let Self { map, point, task, scratch } = self;
        match (map, scratch) {
            (PreparedMap::Double(graph), MapScratch::Double(scratch)) => graph.run::<SIMD>(point, task, scratch),
            (PreparedMap::Single(graph), MapScratch::Single(scratch)) => graph.run::<SIMD>(point, task, scratch),
            _ => panic!("the scratch belongs to another map"),
        }
    }
}
