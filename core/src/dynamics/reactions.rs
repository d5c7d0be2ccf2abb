//! Forces of joints, drivers and springs: their functions of a configuration, as [`Reactions`](metafmu_runtime::Reactions) has them.

use crate::multibody::{
    MotionError,
    measure::Measure,
    model::{Sample, Spring},
    reduced::{Reduced, Terms},
};
use metafmu_runtime::Reactions;
use nalgebra::{DMatrix, DVector};

/// Parts of a force: by accelerations, by products of velocities, by velocities, at rest, by efforts.
pub(super) const PARTS: usize = 5;

/// A part of a force below this share of the same part of the largest one in the mechanism may be rounding.
const SMALL: f64 = 1e-3;

/// Forces in a configuration.
#[derive(Clone, Debug, Default)]
pub(super) struct Forces {
    /// Functions of one force after the other.
    pub(super) functions: Vec<f64>,
    /// The largest of each part that acts anywhere in the mechanism.
    pub(super) sizes: [f64; PARTS],
}

/// The functions of forces of joints, drivers and springs.
///
/// # Errors
/// As [`Reduced::balance`].
pub(super) fn in_configuration(reduced: &Reduced, terms: &Terms, measures: &[Measure]) -> Result<Forces, MotionError> {
    let (n, m) = terms.effort_map.shape();
    let model = reduced.model();
    let inertia = reduced.inertia_forces(terms);
    let damping = model.damping_forces(&terms.q, &terms.velocities);
    let rest = model.potential_forces(&terms.q);
    // a prescribed acceleration acts by the accelerations alone
    let efforts = model.effort_gradients(&terms.q).resize_horizontally(m, 0.0);
    let columns = [&inertia, &damping].into_iter().flat_map(|forces| forces.column_iter());
    let columns = columns.chain(rest.column_iter()).chain(efforts.column_iter());
    let balanced = reduced.balance(terms, &DMatrix::from_columns(&columns.collect::<Vec<_>>()))?;
    let each = Reactions::functions_of_each(n, m);
    let mut sizes = [0.0; PARTS];
    let parts = parts(n, m);
    for (size, part) in sizes.iter_mut().zip(&parts) {
        *size = balanced.columns(part.start, part.len()).iter().fold(0.0, |largest: f64, one| largest.max(one.abs()));
    }
    let still = DVector::zeros(terms.q.len());
    let mut functions = Vec::with_capacity(each * measures.len());
    for measure in measures {
        if let Measure::SpringEffort(spring) = measure {
            functions.extend(of_spring(&model.springs[*spring], terms));
            continue;
        }
        functions.extend((0..each).map(|column| {
            let multipliers = reduced.multipliers(balanced.column(column));
            let (q, v, qdd) = (terms.q.clone(), still.clone(), still.clone());
            measure.value(model, &Sample { t: 0.0, q, v, u: Vec::new(), qdd, multipliers })
        }));
    }
    Ok(Forces { functions, sizes })
}

/// Functions of a spring's force: stiffness acts at rest, damping by velocities, and a formula as an effort.
fn of_spring(spring: &Spring, terms: &Terms) -> Vec<f64> {
    let (n, m) = terms.effort_map.shape();
    let [_, _, damping, at_rest, efforts] = parts(n, m);
    let rest = spring.effort(&terms.q, &DVector::zeros(terms.q.len()));
    let mut functions = vec![0.0; Reactions::functions_of_each(n, m)];
    for (function, velocities) in functions[damping].iter_mut().zip(terms.velocities.column_iter()) {
        *function = spring.effort(&terms.q, &velocities.into_owned()) - rest;
    }
    functions[at_rest.start] = rest;
    if let Some(effort) = spring.further {
        functions[efforts.start + effort] = 1.0;
    }
    functions
}

/// Which functions of a force are of each part.
fn parts(n: usize, m: usize) -> [std::ops::Range<usize>; PARTS] {
    let mut begin = 0;
    [n, n * (n + 1) / 2, n, 1, m].map(|count| {
        begin += count;
        begin - count..begin
    })
}

/// Largest magnitude of each function over some labels; functions of one part of a force share the largest of theirs, or, where that is
/// next to nothing, a share of what acts elsewhere.
pub(super) fn scales<'l>(
    [n, m]: [usize; 2],
    sizes: &[f64; PARTS],
    labels: impl Iterator<Item = &'l [f64]>,
) -> Vec<f64> {
    let mut largest: Vec<f64> = Vec::new();
    for label in labels {
        largest.resize(label.len(), 0.0);
        largest.iter_mut().zip(label).for_each(|(largest, value)| *largest = largest.max(value.abs()));
    }
    for force in largest.chunks_mut(Reactions::functions_of_each(n, m)) {
        for (part, size) in parts(n, m).into_iter().zip(sizes) {
            let scale = force[part.clone()].iter().copied().fold(SMALL * size, f64::max);
            force[part].fill(if scale > 0.0 { scale } else { 1.0 });
        }
    }
    largest
}
