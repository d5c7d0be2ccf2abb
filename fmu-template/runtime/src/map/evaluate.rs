//! A map prepared for evaluation: its value, and its exact derivatives.

use super::{
    Map, ScaledNetwork, Scaling,
    graph::{GraphScratch, PreparedGraph},
    network::{Buffers, Network},
    regression::{Regression, RegressionScratch},
};
#[cfg(target_arch = "x86_64")]
use crate::simd::{AVX2, AVX512};
use crate::{
    Precision,
    simd::{PORTABLE, Real, Simd, fma},
};

/// A map laid out for fast evaluation. Scaling is done in double precision whatever the network computes in.
#[derive(Clone, Debug)]
pub(crate) enum PreparedMap {
    Double(Scaled<f64, 8>),
    Single(Scaled<f32, 16>),
    Regression(Regression),
    Graph(PreparedGraph<f64, 8>),
    SingleGraph(PreparedGraph<f32, 16>),
}

/// A network laid out, with its scaling.
#[derive(Clone, Debug)]
pub(crate) struct Scaled<T, const WIDTH: usize> {
    scaling: Scaling,
    network: Network<T, WIDTH>,
}

/// Working memory of one evaluation at a time. Networks whose layers have the same sizes can share it.
#[derive(Clone, Debug)]
pub(crate) enum MapScratch {
    Double(Buffers<f64, 8>),
    Single(Buffers<f32, 16>),
    Regression(RegressionScratch),
    Graph(GraphScratch<f64, 8>),
    SingleGraph(GraphScratch<f32, 16>),
}

/// What to compute at a point.
pub(crate) enum Task<'a> {
    /// The outputs.
    Outputs(&'a mut [f64]),
    /// First derivatives of the outputs, and second ones if there is a slice for them, along a curve with the first and
    /// second derivatives `rates`.
    Series { rates: [&'a [f64]; 2], first: &'a mut [f64], second: Option<&'a mut [f64]> },
    /// `J^T weights`.
    Adjoint { weights: &'a [f64], gradient: &'a mut [f64] },
}

impl PreparedMap {
    pub(crate) fn new(map: &Map, precision: Precision) -> Self {
        match map {
            Map::Network(network) => Self::of_network(network, precision),
            Map::Regression(regression) => Self::Regression(regression.clone()),
            Map::Graph(graph) => match precision {
                Precision::Double => Self::Graph(PreparedGraph::new(graph)),
                Precision::Single => Self::SingleGraph(PreparedGraph::new(graph)),
            },
        }
    }

    pub(crate) fn of_network(network: &ScaledNetwork, precision: Precision) -> Self {
        match precision {
            Precision::Double => Self::Double(Scaled::new(network)),
            Precision::Single => Self::Single(Scaled::new(network)),
        }
    }

    pub(crate) fn scratch(&self) -> MapScratch {
        match self {
            Self::Double(scaled) => MapScratch::Double(scaled.buffers()),
            Self::Single(scaled) => MapScratch::Single(scaled.buffers()),
            Self::Regression(regression) => MapScratch::Regression(regression.scratch()),
            Self::Graph(graph) => MapScratch::Graph(graph.scratch()),
            Self::SingleGraph(graph) => MapScratch::SingleGraph(graph.scratch()),
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
            (Self::Double(scaled), MapScratch::Double(buffers)) => scaled.run::<SIMD>(point, task, buffers),
            (Self::Single(scaled), MapScratch::Single(buffers)) => scaled.run::<SIMD>(point, task, buffers),
            (Self::Regression(regression), MapScratch::Regression(scratch)) => match task {
                Task::Outputs(outputs) => regression.evaluate(point, outputs, scratch),
                Task::Series { rates, first, second } => regression.along_curve(point, rates, first, second, scratch),
                Task::Adjoint { weights, gradient } => regression.adjoint(point, weights, gradient, scratch),
            },
            (Self::Graph(graph), MapScratch::Graph(scratch)) => graph.run::<SIMD>(point, task, scratch),
            (Self::SingleGraph(graph), MapScratch::SingleGraph(scratch)) => graph.run::<SIMD>(point, task, scratch),
            _ => panic!("the scratch belongs to another map"),
        }
    }
}

impl<T: Real, const WIDTH: usize> Scaled<T, WIDTH> {
    fn new(ScaledNetwork { scaling, layers }: &ScaledNetwork) -> Self {
        Self { scaling: scaling.clone(), network: Network::new(layers) }
    }

    fn buffers(&self) -> Buffers<T, WIDTH> {
        self.network.buffers(self.scaling.input_mean.len())
    }

    #[inline(always)]
    fn run<const SIMD: u8>(&self, point: &[f64], task: Task, buffers: &mut Buffers<T, WIDTH>) {
        let Self { scaling: Scaling { input_mean, input_scale, output_mean, output_scale }, network } = self;
        let standardised = point.iter().zip(input_mean).zip(input_scale);
        buffers.load(standardised.map(|((x, mean), scale)| (x - mean) / scale));
        match task {
            Task::Outputs(outputs) => {
                network.forward::<SIMD>(buffers, outputs);
                for ((y, mean), scale) in outputs.iter_mut().zip(output_mean).zip(output_scale) {
                    *y = fma::<f64, SIMD>(*y, *scale, *mean);
                }
            }
            Task::Series { rates, first, mut second } => {
                for (order, rate) in (1..).zip(rates) {
                    buffers.load_rates(order, rate.iter().zip(input_scale).map(|(rate, scale)| rate / scale));
                }
                network.series::<SIMD>(buffers, first, second.as_deref_mut());
                let rescale = |derivative: &mut [f64]| {
                    derivative.iter_mut().zip(output_scale).for_each(|(dy, scale)| *dy *= scale);
                };
                rescale(first);
                second.into_iter().for_each(rescale);
            }
            Task::Adjoint { weights, gradient } => {
                network
                    .adjoint::<SIMD>(buffers, weights.iter().zip(output_scale).map(|(weight, scale)| weight * scale));
                for ((dx, dz), scale) in gradient.iter_mut().zip(buffers.gradient()).zip(input_scale) {
                    *dx = dz / scale;
                }
            }
        }
    }
}
