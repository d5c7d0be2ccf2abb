//! Dictionaries, windings and shown outputs of equations of motion.

use super::{
    ModelSources, array,
    efforts::{arguments, operations, write_tables},
    functions::{AddedNetwork, Cost, Laid, remark, width, write_network},
    network::{ACTIVATIONS, BLOCK_SIZE},
    push, states,
};
use metafmu_runtime::{EffortColumn, Efforts, Motion, Reactions, Shown, Surrogate, dictionary::Dictionary};

const NAMES: [&str; 13] = [
    "model_arguments",
    "model_effort_windings",
    "model_forces_network",
    "model_law",
    "model_law_network",
    "model_periodic",
    "model_positions",
    "model_positions_network",
    "model_prescribed",
    "model_reactions",
    "model_shown",
    "model_tables",
    "model_windings",
];

pub fn part(surrogate: &Surrogate, motion: &Motion) -> ModelSources {
    let (dynamics, efforts) = (&motion.dynamics, motion.dynamics.efforts());
    let (law, positions) = (Laid::out(dynamics.law().dictionary()), Laid::out(motion.positions.dictionary()));
    let (n, m) = (dynamics.coordinates(), dynamics.inputs());
    let (reactions, each) = (Laid::out(&reactions(motion)), Reactions::functions_of_each(n, efforts.count()));
    let networks = networks(motion);
    let width = width(networks.iter().flatten());
    let (of_law, of_forces) = (Cost::of(networks[0].as_ref(), n), Cost::of(networks[2].as_ref(), 0));
    let sub_steps = states::sub_steps(surrogate, motion.integration);
    let calls: usize = efforts.formulas().iter().map(|formula| operations(formula)[1]).sum();
    let stages = |count: usize| states::stages(sub_steps, motion.integration) * count as f64;
    let atoms = [&law, &positions, &reactions].map(Laid::atoms).into_iter().fold(1, usize::max);
    ModelSources {
        header: "motion.h",
        defines: Vec::new(),
        names: [&ACTIVATIONS[..], &states::NAMES, &NAMES].concat(),
        sizes: vec![
            ("COORDINATE_COUNT", n, ""),
            ("FIRST_DRIVEN", dynamics.parameters() + 2 * n, "the first input that is neither parameter nor start"),
            ("DICTIONARY_COLUMNS", dynamics.law().dictionary().columns(), "coordinates and parameters"),
            ("ATOM_COUNT", atoms, "functions of the columns"),
            ("EFFORT_COUNT", efforts.count(), ""),
            ("EFFORT_SIZE", efforts.count().max(1), "but C has no empty arrays"),
            ("ARGUMENT_COUNT", arguments(efforts).len(), "of tables"),
            ("ARGUMENT_SIZE", arguments(efforts).len().max(1), ""),
            ("EFFORT_POSITIONS", efforts.positions(), "positions in formulas of efforts"),
            ("EFFORT_POSITION_SIZE", efforts.positions().max(1), ""),
            BLOCK_SIZE,
            ("NETWORK_WIDTH", width, "of the widest layer of a network"),
            ("POSITION_SIZE", positions.outputs.max(1), "number of positions, but C has no empty arrays"),
            ("REACTION_SIZE", reactions.outputs.max(each), "number of functions of the reactions, of one at least"),
        ],
        remark: remark(
            states::operations(
                sub_steps,
                motion.integration,
                stage(&law, n, efforts) + of_law.operations + of_forces.operations,
                2 * n,
                m,
            ),
            stages(2 * (law.angles() + of_law.angles + of_forces.angles)),
            stages(of_law.activations + of_forces.activations + calls),
            "motion.c",
        ),
        data: data(surrogate, motion, [("law", &law), ("positions", &positions), ("reactions", &reactions)], &networks),
    }
}

/// Those of the law, the positions and the forces.
fn networks(motion: &Motion) -> [Option<AddedNetwork<'_>>; 3] {
    let dynamics = &motion.dynamics;
    [dynamics.law().network(), motion.positions.network(), dynamics.forces()].map(|term| term.map(AddedNetwork::from))
}

/// The functions of the reactions, or of none.
fn reactions(motion: &Motion) -> Dictionary {
    let factors: Vec<_> = motion.positions.dictionary().factors().collect();
    let none = || Dictionary::new(&factors, 0, &[]).expect("the factors are those of another dictionary");
    motion.reactions.as_ref().map_or_else(none, |reactions| reactions.functions().clone())
}

fn data(
    surrogate: &Surrogate,
    motion: &Motion,
    dictionaries: [(&str, &Laid); 3],
    networks: &[Option<AddedNetwork>; 3],
) -> String {
    let mut text = states::data(surrogate, motion.integration);
    dictionaries.iter().for_each(|(name, dictionary)| dictionary.write(&mut text, name));
    for (name, term) in ["law", "positions", "forces"].into_iter().zip(networks) {
        write_network(&mut text, name, term.as_ref());
    }
    let mut windings = motion.windings.clone();
    // C has no empty arrays
    windings.resize(windings.len().max(motion.dynamics.coordinates()), 0.0);
    array(&mut text, "const Real model_windings", &windings);
    let efforts = motion.dynamics.efforts();
    let n = motion.dynamics.coordinates();
    let mut windings = efforts.windings().to_vec();
    windings.resize(windings.len().max(n), 0.0);
    array(&mut text, "const Real model_effort_windings", &windings);
    write_tables(&mut text, efforts);
    let columns = (0..efforts.count()).flat_map(|effort| efforts.columns(effort));
    let turning: Vec<usize> = columns
        .filter_map(|column| if let EffortColumn::Position(position) = column { Some(position) } else { None })
        .collect();
    let is_periodic = |k: usize| turning.iter().all(|position| efforts.windings()[position * n + k] == 0.0);
    let periodic: Vec<&str> = (0..n).map(|k| if is_periodic(k) { "1" } else { "0" }).collect();
    push(&mut text, format_args!("\nconst int model_periodic[COORDINATE_COUNT] = {{{}}};\n", periodic.join(", ")));
    let prescribed: Vec<&str> =
        motion.dynamics.prescribed().iter().map(|is_prescribed| if *is_prescribed { "1" } else { "0" }).collect();
    push(&mut text, format_args!("\nconst int model_prescribed[COORDINATE_COUNT] = {{{}}};\n", prescribed.join(", ")));
    text.push_str("\nconst Shown model_shown[OUTPUT_COUNT] = {\n");
    for shown in &motion.outputs {
        let (kind, position) = match *shown {
            Shown::Position(position) => ("POSITION", position),
            Shown::Velocity(position) => ("VELOCITY", position),
            Shown::Acceleration(position) => ("ACCELERATION", position),
            Shown::KineticEnergy => ("KINETIC_ENERGY", 0),
            Shown::PotentialEnergy => ("POTENTIAL_ENERGY", 0),
            Shown::Reaction(reaction) => ("REACTION", reaction),
        };
        push(&mut text, format_args!("    {{SHOWN_{kind}, {position}}},\n"));
    }
    text.push_str("};\n");
    text
}

/// Multiplications, additions and divisions of a stage without networks; the formula is in `motion.c`.
fn stage(law: &Laid, n: usize, efforts: &Efforts) -> usize {
    let of_formulas: usize = efforts.formulas().iter().map(|formula| operations(formula)[0]).sum();
    let of_efforts = 5 * n * efforts.positions() + of_formulas;
    let side = of_efforts + n * (1 + 2 * n + 5 * n * n + 2 * efforts.count());
    let solution = n * (n + 1) * (2 * n + 1) / 6 + n * (2 * n - 1);
    law.operations(n) + side + solution
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{Model, example};

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let crane = example::crane();
        let Model::Motion(motion) = crane.model() else { panic!("the crane moves") };
        // rope angle: 8; the rope's length with powers 1 and 2: 8; products: 3 constants; cos and length, which
        // two functions have; the length's square: 1 + 2
        let law = 8 + 8 + 6 + (2 + 4 + 1 + 4) + (1 + 2);
        // 2 (1 + 4 + 20 + 2), 1 + 4, 1 + 2 + 3
        let stage = law + 54 + 5 + 6;
        let found = super::stage(&Laid::out(motion.dynamics.law().dictionary()), 2, motion.dynamics.efforts());
        assert_eq!(found, stage);
        // a step of 0.01 s has two of 0.005 s, of four stages, with 30 operations for each of four states and 20 for the input
        let expected = 2 * (4 * stage + 120 + 20 + 9) + 3;
        let sub_steps = states::sub_steps(&crane, motion.integration);
        assert_eq!(states::operations(sub_steps, motion.integration, stage, 4, 1), expected as f64);
        // of a state: six stages with one to six weights, 2 + ... + 12 and 2 each; seven weights of the error and 4; six of the result and 2
        let of_state = 42 + 12 + 14 + 4 + 12 + 2;
        let expected = 2 * (6 * stage + 4 * of_state + 30 + 24) + stage + 8 + 5 + 3;
        let controlled = metafmu_runtime::Integration::ErrorControlled { tolerance: 1e-9, longest: 0.005 };
        assert_eq!(states::operations(sub_steps, controlled, stage, 4, 1), expected as f64);
    }
}
