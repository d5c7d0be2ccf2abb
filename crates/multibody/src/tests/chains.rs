//! Mechanisms of many bodies: chains, trees and loops.

use super::{grid, parse, run};
use crate::{Mechanism, constraint::Constraints, formulation::augmented, model::Sample};
use nalgebra::{DMatrix, DVector, Vector3};
use std::fmt::Write;

/// Links of 0.2 m, each hung from another one's tip or from the ground, with its angle at the start.
fn links(hung_from: &[Option<usize>], angles: impl Fn(usize) -> f64, formulation: &str) -> String {
    let mut text = format!("formulation = \"{formulation}\"\ngravity = [0, -9.81]\n");
    let mut tips: Vec<[f64; 2]> = Vec::new();
    for (link, from) in hung_from.iter().enumerate() {
        let angle = angles(link);
        let [x, y] = from.map_or([0.0, 0.0], |from| tips[from]);
        tips.push([x + 0.2 * angle.sin(), y - 0.2 * angle.cos()]);
        let top = from.map_or("ground".into(), |from| format!("link{from}.tip"));
        let (x, y) = (x + 0.1 * angle.sin(), y - 0.1 * angle.cos());
        write!(
            text,
            "bodies.link{link} = {{ mass = 0.4, inertia = 1.4e-3, position = [{x}, {y}], angle = {angle}, \
             points = {{ top = [0, 0.1], tip = [0, -0.1] }} }}\n\
             joints.j{link} = {{ type = \"revolute\", between = [\"{top}\", \"link{link}.top\"] }}\n\
             initial.link{link} = {{ angle = {angle}, angular_velocity = 0 }}\n"
        )
        .unwrap();
    }
    text + "outputs.energy = { measure = \"kinetic_energy\" }\n"
}

fn chain(count: usize, formulation: &str) -> Mechanism {
    let hung_from: Vec<_> = (0..count).map(|link: usize| link.checked_sub(1)).collect();
    parse(&links(&hung_from, |link| 0.8 + 0.4 * (2.0 * link as f64).sin(), formulation))
}

/// Two links from the tip of each.
fn tree(count: usize) -> String {
    let hung_from: Vec<_> = (0..count).map(|link| (link > 0).then(|| (link.max(1) - 1) / 2)).collect();
    links(&hung_from, |link| 0.3 * link as f64, "augmented")
}

/// A chain between two points of the ground.
fn closed(count: usize) -> Mechanism {
    let hung_from: Vec<_> = (0..count).map(|link: usize| link.checked_sub(1)).collect();
    // half a polygon
    let angle = |link: usize| std::f64::consts::PI * (link as f64 + 0.5) / count as f64;
    let x: f64 = (0..count).map(|link| 0.2 * angle(link).sin()).sum();
    let text = links(&hung_from, angle, "augmented");
    let text = text.lines().filter(|line| !line.starts_with("initial")).collect::<Vec<_>>().join("\n");
    parse(&format!(
        "{text}\nground.points.end = [{x}, 0]\n\
         joints.last = {{ type = \"revolute\", between = [\"link{}.tip\", \"ground.end\"] }}\n",
        count - 1
    ))
}

#[test]
fn a_chain_of_40_keeps_its_energy() {
    let (model, samples) = run(&chain(40, "augmented"), &[], &grid(3.0, 30));
    let energy = |s: &Sample| model.kinetic_energy(&s.v) + model.potential_energy(&s.q);
    let scale = samples.iter().map(|s| model.kinetic_energy(&s.v)).fold(0.0, f64::max);
    let drift = samples.iter().map(|s| (energy(s) - energy(&samples[0])).abs()).fold(0.0, f64::max) / scale;
    assert!(scale > 100.0 && drift < 1e-9, "{drift:e} of {scale} J");
    let violation = samples.iter().map(|s| model.constraints.violation(s.t, &s.q, &s.v)).fold(0.0, f64::max);
    assert!(violation < 1e-10, "{violation:e}");
}

#[test]
fn both_formulations_of_a_chain_agree() {
    let [augmented, embedding] =
        ["augmented", "embedding"].map(|formulation| run(&chain(8, formulation), &[], &grid(0.5, 5)).1);
    for (one, other) in augmented.iter().zip(&embedding) {
        assert!((&one.q - &other.q).amax() < 1e-9 && (&one.v - &other.v).amax() < 1e-8, "t = {} s", one.t);
    }
}

#[test]
fn accelerations_of_chains_trees_and_loops_are_those_of_the_dense_equations() {
    for mechanism in [chain(40, "augmented"), parse(&tree(31)), closed(12)] {
        let (model, _) = mechanism.build(&[]).unwrap();
        let (q, mut v) = model.initial_state(0.0).unwrap();
        v.iter_mut().enumerate().for_each(|(k, v)| *v = (1.7 * k as f64).sin());
        model.constraints.correct_velocities(0.0, &q, &mut v).unwrap();
        let found = augmented(&model, 0.0, (&q, &v), &[]).unwrap();
        let transposed = model.constraints.gradients(&q).dense();
        let (n, m) = transposed.shape();
        let mut matrix = DMatrix::zeros(n + m, n + m);
        matrix.view_mut((0, 0), (n, n)).set_diagonal(&model.mass);
        matrix.view_mut((0, n), (n, m)).copy_from(&transposed);
        matrix.view_mut((n, 0), (m, n)).tr_copy_from(&transposed);
        let mut side = DVector::zeros(n + m);
        side.rows_mut(0, n).copy_from(&model.applied_forces(0.0, &q, &v, &[]));
        side.rows_mut(n, m).copy_from(&model.constraints.acceleration_side(0.0, &q, &v));
        let expected = matrix.lu().solve(&side).unwrap();
        let (qdd, multipliers) = (expected.rows(0, n), expected.rows(n, m));
        assert!((&found.qdd - qdd).amax() < 1e-10 * qdd.amax(), "{n} coordinates");
        assert!((&found.multipliers - multipliers).amax() < 1e-10 * multipliers.amax(), "{n} coordinates");
    }
}

#[test]
fn factors_of_a_chain_have_the_entries_of_its_matrix_and_those_of_a_tree_few_more() {
    for (mechanism, most) in [(chain(40, "augmented"), 1.0), (parse(&tree(31)), 1.05)] {
        let (model, _) = mechanism.build(&[]).unwrap();
        let gradients = model.constraints.gradients(&model.position_guess);
        let share_a_body = |one: usize, other: usize| {
            gradients.parts(one).iter().any(|(body, _)| gradients.parts(other).iter().any(|(of, _)| of == body))
        };
        let pairs = (0..gradients.len()).flat_map(|one| (0..=one).map(move |other| (one, other)));
        let of_matrix = pairs.filter(|&(one, other)| share_a_body(one, other)).count();
        let share = model.constraints.elimination(&gradients).entries() as f64 / of_matrix as f64;
        assert!((1.0..=most).contains(&share), "{share}");
    }
}

#[test]
fn redundant_constraints_have_no_factors_and_a_point_mass_moves_by_the_dense_equations() {
    let (model, _) = closed(4).build(&[]).unwrap();
    let twice: Constraints = model.constraints.iter().chain(&model.constraints[..1]).cloned().collect();
    let gradients = twice.gradients(&model.position_guess);
    let elimination = twice.elimination(&gradients);
    assert!(elimination.factorise(&gradients, |_| Vector3::repeat(1.0)).is_none());

    // a point mass on a rod of 0.1 m
    let one = links(&[None], |_| 0.5, "augmented").replace("inertia = 1.4e-3", "inertia = 0");
    let (_, samples) = run(&parse(&one), &[], &grid(0.1, 1));
    let expected = -9.81 / 0.1 * 0.5f64.sin();
    assert!((samples[0].qdd[2] - expected).abs() < 1e-10, "{} {expected}", samples[0].qdd[2]);
}
