//! A map prepared for evaluation: its value, and its exact derivatives.

use super::{
    Map, ScaledNetwork,
    graph::{GraphScratch, PreparedGraph},
    task::Task,
};
#[cfg(target_arch = "x86_64")]
use crate::simd::{AVX2, AVX512};
use crate::{
    Precision,
    simd::{PORTABLE, Simd},
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
        match simd {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Simd::detect` found these features
            Simd::Avx512 => unsafe { self.run_avx512(point, task, scratch) },
            #[cfg(target_arch = "x86_64")]
            // SAFETY: as above
            Simd::Avx2 => unsafe { self.run_avx2(point, task, scratch) },
            Simd::Portable => self.run::<PORTABLE>(point, task, scratch),
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx512f,avx512dq,avx2,fma")]
    fn run_avx512(&self, point: &[f64], task: Task, scratch: &mut MapScratch) {
        self.run::<AVX512>(point, task, scratch);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn run_avx2(&self, point: &[f64], task: Task, scratch: &mut MapScratch) {
        self.run::<AVX2>(point, task, scratch);
    }

    #[inline(always)]
    fn run<const SIMD: u8>(&self, point: &[f64], task: Task, scratch: &mut MapScratch) {
        match (self, scratch) {
            (Self::Double(graph), MapScratch::Double(scratch)) => graph.run::<SIMD>(point, task, scratch),
            (Self::Single(graph), MapScratch::Single(scratch)) => graph.run::<SIMD>(point, task, scratch),
            _ => panic!("the scratch belongs to another map"),
        }
    }
}
