//! Tapes: lists of operations, and their cost.

use super::{operations::Operations, push, real, table};
use metafmu_runtime::formula::Combination;
use metafmu_runtime::listing::{Instruction, InstructionKind, LANES, Listing};

/// `BLOCK` of models that run tapes.
pub(super) const BLOCK_OF_TAPES: (&str, usize, &str) = ("BLOCK", LANES, "rows of a layer that are computed together");

/// Type of positions of registers that all of these tapes have.
pub(super) fn index_type(listings: &[&Listing]) -> (&'static str, String) {
    let is_short = listings.iter().all(|listing| listing.registers <= usize::from(u16::MAX));
    ("RegisterIndex", if is_short { "uint16_t" } else { "uint32_t" }.into())
}

/// Operations of a run: the fixed inputs' part, the rest, and the part that runs on demand.
pub(super) fn operations(listing: &Listing) -> [Operations; 3] {
    listing.instructions.each_ref().map(|part| {
        part.iter().fold(Operations::default(), |sum, instruction| of_instruction(instruction, listing).times(1.0, sum))
    })
}

/// The counts that `tape.h` states.
fn of_instruction(Instruction { kind, b, count, data, .. }: &Instruction, listing: &Listing) -> Operations {
    let (count, numbers, none) = (f64::from(*count), f64::from(*count) * LANES as f64, Operations::default());
    match kind {
        InstructionKind::Harmonics => Operations { arithmetic: 6.0 * (count - 1.0), sines: 2.0, ..none },
        InstructionKind::Product | InstructionKind::Products => Operations { arithmetic: 2.0 * count, ..none },
        InstructionKind::Reciprocal | InstructionKind::Combine(Combination::Divide | Combination::Minimum) => {
            Operations { arithmetic: 1.0, ..none }
        }
        InstructionKind::Call(_) | InstructionKind::Combine(_) => Operations { functions: 1.0, ..none },
        InstructionKind::Lookup => {
            let table = &listing.tables[*data as usize];
            Operations { arithmetic: (table.arguments() * (6 * table.numbers_of_node() + 52)) as f64, ..none }
        }
        InstructionKind::Matrix => Operations { arithmetic: 2.0 * numbers * f64::from(*b), ..none },
        InstructionKind::Dot => Operations { arithmetic: 2.0 * numbers, ..none },
        InstructionKind::Activation(_) => Operations { activations: numbers, ..none },
        InstructionKind::LaneProducts => Operations { arithmetic: numbers, ..none },
    }
}

pub(super) fn write(text: &mut String, name: &str, listing: &Listing) {
    let Listing { inputs, fixed, constants, weights, instructions, results, .. } = listing;
    let rows = constants.iter().map(|(of, value)| format!("{of}, {}", real(*value)));
    table(text, &format!("static const Constant {name}_constants"), rows, "");
    push(text, format_args!("\nstatic const Real {name}_weights[] = {{\n"));
    for block in if weights.is_empty() { &[[0.0; LANES]][..] } else { weights } {
        push(text, format_args!("    {},\n", block.map(real).join(", ")));
    }
    text.push_str("};\n");
    for (part, instructions) in ["fixed", "others", "rest"].into_iter().zip(instructions) {
        let rows = instructions.iter().map(|instruction| row(instruction, listing));
        table(text, &format!("static const Operation {name}_{part}"), rows, "TAPE_PRODUCT, 0, 0, 0, 0, 0, 0, 0");
    }
    let listed: Vec<String> = results.iter().map(u32::to_string).collect();
    let listed = if results.is_empty() { "0".into() } else { listed.join(", ") };
    push(text, format_args!("\nstatic const RegisterIndex {name}_results[] = {{{listed}}};\n"));
    let (constants, [of_fixed, of_others, of_rest]) = (constants.len(), instructions.each_ref().map(Vec::len));
    let (first, count) = (fixed.start, fixed.len());
    push(
        text,
        format_args!(
            "\nconst Tape model_{name} = {{\n    {inputs}, {first}, {count}, {constants}, {name}_constants, {name}_weights, \
             {{{of_fixed}, {of_others}, {of_rest}}}, {{{name}_fixed, {name}_others, {name}_rest}}, {name}_results\n}};\n"
        ),
    );
}

fn row(instruction: &Instruction, listing: &Listing) -> String {
    let Instruction { kind, a, mut b, c, to, count, data } = *instruction;
    let (kind, function) = match kind {
        InstructionKind::Harmonics => ("HARMONICS", "0".into()),
        InstructionKind::Product => ("PRODUCT", "0".into()),
        InstructionKind::Products => ("PRODUCTS", "0".into()),
        InstructionKind::Reciprocal => ("RECIPROCAL", "0".into()),
        InstructionKind::Call(function) => ("CALL", format!("FUNCTION_{}", function.name().to_uppercase())),
        InstructionKind::Combine(combination) => ("COMBINE", format!("COMBINATION_{}", combination.name())),
        InstructionKind::Lookup => ("LOOKUP", "0".into()),
        InstructionKind::Matrix => ("MATRIX", "0".into()),
        InstructionKind::Dot => ("DOT", "0".into()),
        InstructionKind::Activation(activation) => {
            let slopes = to + count * LANES as u32;
            b = listing
                .instructions
                .iter()
                .flatten()
                .any(|of| of.kind == InstructionKind::LaneProducts && of.b == slopes)
                .into();
            ("ACTIVATION", super::network::activation(activation))
        }
        InstructionKind::LaneProducts => ("BLOCKS", "0".into()),
    };
    format!("TAPE_{kind}, {function}, {a}, {b}, {c}, {to}, {count}, {data}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_example as example;

    #[test]
    fn operations_are_those_of_a_count_by_hand() {
        let crane = example::crane_with_networks();
        let motion = crane.program().motion().unwrap();
        // the rope's length, standardized, in the first layer of nine nodes, which are two blocks
        let of_fixed = Operations { arithmetic: f64::from(2 * 2 + 2 * 16), ..Operations::default() };
        // the sine, standardized, in the same layer, a block of nine columns and one of the output; mean and scale of the output, x + l sin
        let arithmetic = f64::from(2 * 2 + 2 * 16 + 2 * 8 * 9 + 2 * 8 + 2 + 3 * 2);
        let of_others = Operations { arithmetic, sines: 2.0, activations: 16.0 + 8.0, ..Operations::default() };
        assert_eq!(operations(&motion.listing_of_positions()), [of_fixed, of_others, Operations::default()]);
    }
}
