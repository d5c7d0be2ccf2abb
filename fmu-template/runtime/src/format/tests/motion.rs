//! Equations of motion in a file.

use super::*;

/// The crane's model file with other tensors: what is wrong with it.
fn crane_with(change: impl Fn(&mut Motion, &mut Integration)) -> String {
    let surrogate = example::crane();
    let program = surrogate.program();
    let (mut motion, mut integration) = (program.motion().unwrap().clone(), program.integration().unwrap());
    change(&mut motion, &mut integration);
    let surrogate = Surrogate::new(surrogate.metadata().clone(), Program::of_motion(motion, integration));
    surrogate.map_or_else(|error| error.to_string(), |_| "nothing".into())
}

#[test]
fn a_motion_survives_the_round_trip_with_and_without_networks() {
    let moved = example::with_prescribed_trolley(&example::crane());
    for surrogate in [
        example::crane(),
        moved,
        example::crane_with_networks(),
        example::crane_with_reactions(),
        example::crane_with_efforts(),
        example::crane_with_splines(),
        example::crane_with_motor(),
    ] {
        let surrogate = surrogate.sealed().unwrap();
        let bytes = surrogate.to_bytes().unwrap();
        assert_eq!(Surrogate::from_bytes(&bytes).unwrap(), surrogate);
        for length in (0..bytes.len()).step_by(97) {
            assert!(Surrogate::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        // any byte that is another is noticed: by the reader or by the digest
        for position in (8..bytes.len()).step_by(31) {
            let mut damaged = bytes.clone();
            damaged[position] ^= 4;
            assert!(Surrogate::from_bytes(&damaged).is_err(), "byte {position}");
        }
    }
}

#[test]
fn networks_of_a_motion_that_make_no_sense_are_refused() {
    let bytes = example::crane_with_networks().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    for (name, index, number, expected) in [
        ("functions.network.columns", 0, 3, "tensor `network.columns`, element 0: 3, expected less than 3"),
        ("functions.network.columns", 1, 3, "tensor `graph.0.functions.network.columns`, element 1: 3 is not known"),
        ("functions.network.outputs", 5, 12, "tensor `network.outputs`, element 5: 12, expected less than 12"),
        (
            "positions.network.graph.steps",
            4,
            16,
            "tensor `graph.0.positions.network.graph.steps`, element 4: 16 is not known",
        ),
        (
            "positions.network.graph.steps",
            4,
            12,
            "tensor `graph.0.positions.network.graph.steps`, element 4: 12 is not known",
        ),
        // a softmax in place of an activation
        ("positions.network.graph.steps", 8, 5, "`graph.0.positions.network.graph` is not a network"),
        ("forces.network.columns", 10, 6, "tensor `network.columns`, element 5: 6, expected less than 6"),
        ("forces.network.outputs", 0, 2, "tensor `network.outputs`, element 0: 2, expected less than 2"),
    ] {
        let damaged = patched(bytes.clone(), &format!("graph.0.{name}"), index, number);
        let found = Surrogate::from_bytes(&damaged).unwrap_err().to_string();
        assert!(found.starts_with(expected), "{found}");
    }
    for (from, to, expected) in [
        ("forces.network.outputs", "forces.network.output", "tensor `graph.0.forces.network.outputs` is missing"),
        (
            "functions.network.graph.0.mean",
            "functions.network.graph.0.means",
            "`graph.0.functions.network.graph.0.mean` is missing",
        ),
        ("positions.network.graph.3.bias", "positions.network.graph.3.bia", "`graph.0.positions.network.graph.3.bias`"),
    ] {
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}

#[test]
fn efforts_that_make_no_sense_are_refused() {
    let bytes = example::crane_with_efforts().to_bytes().unwrap();
    for (tensor, element, value, expected) in [
        ("efforts.steps", 1, 77, "tensor `efforts.steps`, element 0: 77, expected less than 8"),
        ("efforts.steps", 0, 14, "tensor `graph.0.efforts.steps`, element 0: 14 is not known"),
        ("efforts.steps", 3, 900, "tensor `graph.0.efforts.steps`, element 3: 900 is not known"),
        ("efforts.steps", 0, 5, "formula, step 0: 0 values, expected 2"),
        // table 1 has two arguments
        ("efforts.steps", 0, 4, "formula, step 0: 0 values, expected 2"),
        ("efforts.tables.1.kinds", 1, 3, "tensor `graph.0.efforts.tables.1.kinds`, element 1: 3 is not known"),
        ("efforts.tables.1.kinds", 1, 2, "a periodic lookup table, element 4: its ends differ"),
        ("efforts.inputs", 0, 2, "tensor `graph.0.motion` has shape [7], expected [6]"),
        (
            "efforts.inputs",
            0,
            4_000_000_000,
            "tensor `efforts.inputs`, element 0: 4000000000, expected less than 65536",
        ),
    ] {
        let damaged = patched(bytes.clone(), &format!("graph.0.{tensor}"), element, value);
        let found = Surrogate::from_bytes(&damaged).unwrap_err().to_string();
        assert_eq!(found, expected, "{tensor} {element}");
    }
}

/// Two forces that are zero.
fn reactions(coordinates: usize, inputs: usize) -> Result<Reactions, FormatError> {
    let functions = 2 * Reactions::functions_of_each(coordinates, inputs);
    Reactions::new(coordinates, inputs, Dictionary::new(&[Factor::Angle; 3], functions, &[]).unwrap())
}

#[test]
fn reactions_of_other_shapes_are_refused() {
    let functions = |count: usize| Dictionary::new(&[Factor::Angle; 2], count, &[]).unwrap();
    for (found, expected) in [
        (Reactions::new(2, 1, functions(10)), "tensor `reactions` has shape [10], expected [18]"),
        (Reactions::new(2, 1, functions(0)), "tensor `reactions` has shape [0], expected [9]"),
        (reactions(4, 1), "tensor `reactions` has shape [3], expected [4]"),
    ] {
        assert_eq!(found.unwrap_err().to_string(), expected);
    }
    let bytes = example::crane_with_reactions().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    let found = rebuilt(&header.replacen("reactions.exponents", "reactions.exponent", 1), &bytes[8 + length..]);
    assert_eq!(found.to_string(), "tensor `graph.0.reactions.exponents` is missing");
}

#[test]
fn a_motion_that_makes_no_sense_is_refused() {
    for (expected, change) in [
        ("nothing", &(|_: &mut Motion, _: &mut Integration| {}) as &dyn Fn(&mut Motion, &mut Integration)),
        ("tensor `shown`, element 2: 7, expected less than 3", &|motion, _| motion.outputs[2] = Shown::Velocity(7)),
        ("tensor `shown`, element 1: 0, expected less than 0", &|motion, _| motion.outputs[1] = Shown::Reaction(0)),
        ("tensor `shown`, element 1: 2, expected less than 2", &|motion, _| {
            motion.reactions = Some(reactions(2, 1).unwrap());
            motion.outputs[1] = Shown::Reaction(2);
        }),
        ("tensor `reactions` has shape [2, 0, 3], expected [2, 1, 3]", &|motion, _| {
            motion.reactions = Some(reactions(2, 0).unwrap());
        }),
        ("tensor `shown`, element 1: 1, expected less than 1", &|motion, _| motion.outputs[1] = Shown::Effort(1)),
        ("tensor `graph.steps` has shape [12], expected [11]", &|motion, _| motion.actuator_states = 1),
        ("tensor `graph.steps` has shape [10], expected [11]", &|motion, _| motion.outputs.truncate(6)),
        ("tensor `windings` has shape [5], expected [6]", &|motion, _| motion.windings.truncate(5)),
        ("tensor `windings`, element 1: NaN is not finite", &|motion, _| motion.windings[1] = f64::NAN),
        ("time step 0 is not positive", &|_, integration| *integration = Integration::Fixed { step: 0.0 }),
        ("the tolerance NaN of the solver is not positive", &|_, integration| {
            *integration = Integration::ErrorControlled { tolerance: f64::NAN, longest: 0.1 };
        }),
    ] {
        let found = crane_with(change);
        assert!(found.starts_with(expected), "{found} instead of {expected}");
    }
    let bytes = example::with_prescribed_trolley(&example::crane()).to_bytes().unwrap();
    let found = Surrogate::from_bytes(&patched(bytes, "graph.0.functions.prescribed", 0, 2)).unwrap_err().to_string();
    assert_eq!(found, "tensor `prescribed`, element 0: 2, expected less than 2");
    let bytes = example::crane().to_bytes().unwrap();
    let length = u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let header = std::str::from_utf8(&bytes[8..8 + length]).unwrap();
    assert!(!header.contains("prescribed"), "{header}");
    for (from, to, expected) in [
        ("continuous", "static", "tensor `solver.step` is not part of the format"),
        ("positions.windings", "positions.winding", "tensor `graph.0.positions.windings` is missing"),
    ] {
        assert!(header.contains(from), "{from} is not in {header}");
        let found = rebuilt(&header.replacen(from, to, 1), &bytes[8 + length..]).to_string();
        assert!(found.contains(expected), "{found}");
    }
}
