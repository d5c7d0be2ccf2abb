//! Tapes, windings and shown outputs of equations of motion.

use super::{
    ModelSources, array,
    network::ACTIVATIONS,
    push, states, table,
    tables::write_tables,
    tape::{self, BLOCK_OF_TAPES, index_type},
};
use metafmu_runtime::{
    EffortColumn, Integration, Motion, Shown, Surrogate,
    dictionary::{Dictionary, Factor, SplineFactor},
    function_set::FunctionSet,
    listing::{InstructionKind, Listing},
};
use std::f64::consts::TAU;

const NAMES: [&str; 8] = [
    "model_arguments",
    "model_equations",
    "model_periodic",
    "model_positions",
    "model_reactions",
    "model_shown",
    "model_tables",
    "model_windings",
];

pub fn part(surrogate: &Surrogate, motion: &Motion, integration: Integration) -> ModelSources {
    let dynamics = &motion.dynamics;
    let n = dynamics.coordinates();
    let [equations, positions, reactions] = &listings(motion);
    let positions_size = motion.positions.dictionary().outputs().max(1);
    let arguments = equations.arguments.len();
    let mut data = states::data(surrogate, integration);
    tape::write(&mut data, "equations", equations);
    tape::write(&mut data, "positions", positions);
    tape::write(&mut data, "reactions", reactions);
    write_tables(&mut data, equations);
    write_shown(&mut data, motion);
    ModelSources {
        header: "motion.h",
        defines: vec![index_type(&[equations, positions, reactions]), states::method(integration)],
        names: [&ACTIVATIONS[..], &states::NAMES, &NAMES].concat(),
        sizes: vec![
            ("COORDINATE_COUNT", n, ""),
            ("ACTUATOR_STATES", motion.actuator_states, ""),
            (
                "FIRST_DRIVEN",
                dynamics.parameters() + motion.states(),
                "the first input that is neither parameter nor start",
            ),
            ("EFFORT_COUNT", dynamics.efforts().count(), ""),
            ("ARGUMENT_COUNT", arguments, "with bends"),
            ("ARGUMENT_SIZE", arguments.max(1), "but C has no empty arrays"),
            BLOCK_OF_TAPES,
            ("EQUATION_REGISTERS", equations.registers, ""),
            ("POSITION_REGISTERS", positions.registers, ""),
            ("REACTION_REGISTERS", reactions.registers, ""),
            ("POSITION_SIZE", positions_size, "number of positions, but C has no empty arrays"),
        ],
        remark: states::remark(surrogate, integration, tape::operations(equations), motion.states(), motion.driven()),
        data,
    }
}

/// Listings of the equations, the positions and the reactions; empty ones for reactions that do not exist.
fn listings(motion: &Motion) -> [Listing; 3] {
    let dynamics = &motion.dynamics;
    let reactions = match &motion.reactions {
        Some(reactions) => reactions.listing(),
        None => {
            let columns = vec![Factor::Angle; dynamics.coordinates() + dynamics.parameters()];
            let nothing = Dictionary::new(&columns, 0, &[]).expect("nothing is wrong with no functions");
            FunctionSet::from(nothing).listing(0..0)
        }
    };
    let mut listings = [dynamics.listing(), motion.listing_of_positions(), reactions];
    share_tables(&mut listings);
    listings
}

/// Gives all listings the tables of all of them, as `model_tables` has them.
fn share_tables(listings: &mut [Listing]) {
    let mut tables = Vec::new();
    for listing in &mut *listings {
        let first = tables.len() as u32;
        tables.append(&mut listing.tables);
        for instruction in listing.instructions.iter_mut().flatten() {
            if instruction.kind == InstructionKind::Lookup {
                instruction.data += first;
            }
        }
    }
    listings.iter_mut().for_each(|listing| listing.tables.clone_from(&tables));
}

/// Returns true if a turn has a whole number of periods of a spline.
fn repeats_each_turn(spline: &SplineFactor) -> bool {
    let periods = spline.table.period(0).map_or(f64::NAN, |period| TAU / period);
    (periods - periods.round()).abs() <= 4.0 * f64::EPSILON * periods
}

fn write_shown(text: &mut String, motion: &Motion) {
    let (efforts, n) = (motion.dynamics.efforts(), motion.dynamics.coordinates());
    let mut windings = motion.windings.clone();
    // C has no empty arrays
    windings.resize(windings.len().max(n), 0.0);
    array(text, "const Real model_windings", &windings);
    let columns = (0..efforts.count()).flat_map(|effort| efforts.columns(effort));
    let turning: Vec<usize> = columns
        .filter_map(|column| if let EffortColumn::Position(position) = column { Some(position) } else { None })
        .collect();
    let dictionary = motion.dynamics.function_set().dictionary();
    let factors = dictionary.factors().take(n).enumerate();
    let shows_potential = motion.outputs.contains(&Shown::PotentialEnergy);
    let periodic = factors.map(|(k, factor)| {
        let is_turning = turning.iter().any(|position| efforts.windings()[position * n + k] != 0.0);
        let is_free = !(is_turning || shows_potential && motion.dynamics.is_uniform(k));
        let repeats = dictionary.splines().iter().all(|spline| spline.column != k || repeats_each_turn(spline));
        u8::from(factor == Factor::Angle && is_free && repeats).to_string()
    });
    let periodic: Vec<String> = periodic.collect();
    push(text, format_args!("\nconst int model_periodic[COORDINATE_COUNT] = {{{}}};\n", periodic.join(", ")));
    let shown = motion.outputs.iter().map(|shown| match *shown {
        Shown::Position(position) => format!("SHOWN_POSITION, {position}"),
        Shown::Velocity(position) => format!("SHOWN_VELOCITY, {position}"),
        Shown::Acceleration(position) => format!("SHOWN_ACCELERATION, {position}"),
        Shown::KineticEnergy => "SHOWN_KINETIC_ENERGY, 0".into(),
        Shown::PotentialEnergy => "SHOWN_POTENTIAL_ENERGY, 0".into(),
        Shown::Reaction(reaction) => format!("SHOWN_REACTION, {reaction}"),
        Shown::Effort(effort) => format!("SHOWN_EFFORT, {effort}"),
    });
    table(text, "const Shown model_shown", shown, "");
}
