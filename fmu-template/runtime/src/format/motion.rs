//! The tensors of equations of motion.

use super::{Tensor, Views, bytes, counts, elements, exactly, joined, take, whole_rows};
use crate::{
    Efforts, FormatError, Graph, Integration, Motion, Reactions, Shown,
    check::{expect_finite, expect_shape},
    dictionary::{Dictionary, Factor, SPLINE_POWERS, SplineFactor, Term},
    equations::dynamics::Dynamics,
    formula::{Combination, ElementaryFunction, Extrapolation, Formula, FormulaStep, Interpolation, LookupTable},
    function_set::{ColumnKind, FunctionSet, NetworkColumn, NetworkTerm},
};
use safetensors::Dtype;
use std::sync::Arc;

impl Motion {
    /// Tensors whose names begin with this.
    pub(crate) fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        let Self { dynamics, positions, windings, reactions, actuator_states, outputs } = self;
        let shown: Vec<u32> = outputs
            .iter()
            .flat_map(|shown| match *shown {
                Shown::Position(position) => [0, position as u32],
                Shown::Velocity(position) => [1, position as u32],
                Shown::Acceleration(position) => [2, position as u32],
                Shown::KineticEnergy => [3, 0],
                Shown::PotentialEnergy => [4, 0],
                Shown::Reaction(reaction) => [5, reaction as u32],
                Shown::Effort(effort) => [6, effort as u32],
            })
            .collect();
        let mut tensors = vec![
            columns(prefix, dynamics.function_set().dictionary()),
            double(
                &joined([prefix, "positions.windings"]),
                &[positions.dictionary().outputs(), dynamics.coordinates()],
                windings,
            ),
            (joined([prefix, "outputs.shown"]), Dtype::U32, vec![outputs.len(), 2], bytes(&shown, u32::to_le_bytes)),
        ];
        tensors.extend(of_splines(prefix, dynamics.function_set().dictionary()));
        for (what, function_set) in [("functions.", dynamics.function_set()), ("positions.", positions)] {
            tensors.extend(of_dictionary(&joined([prefix, what]), function_set.dictionary()));
            tensors.extend(
                function_set.network().into_iter().flat_map(|network| of_network(&joined([prefix, what]), network)),
            );
        }
        tensors.extend(of_efforts(prefix, dynamics.efforts()));
        let prescribed =
            (0..).zip(dynamics.prescribed()).filter_map(|(row, is_prescribed)| is_prescribed.then_some(row));
        let prescribed: Vec<u32> = prescribed.collect();
        if !prescribed.is_empty() {
            let content = bytes(&prescribed, u32::to_le_bytes);
            tensors.push((joined([prefix, "functions.prescribed"]), Dtype::U32, vec![prescribed.len()], content));
        }
        if *actuator_states > 0 {
            let content = bytes(&[*actuator_states as u32], u32::to_le_bytes);
            tensors.push((joined([prefix, "states.actuators"]), Dtype::U32, vec![1], content));
        }
        tensors.extend(
            dynamics.forces().into_iter().flat_map(|network| of_network(&joined([prefix, "forces."]), network)),
        );
        tensors.extend(
            reactions
                .iter()
                .flat_map(|reactions| of_dictionary(&joined([prefix, "reactions."]), reactions.functions())),
        );
        tensors
    }

    pub(crate) fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let factors = factors(tensors, prefix)?;
        let splines = splines(tensors, prefix)?;
        let factors = (&factors[..], &splines[..]);
        let (windings, winding_shape) = doubles(tensors, &joined([prefix, "positions.windings"]), 2)?;
        let function_set = function_set(tensors, &joined([prefix, "functions."]), factors)?;
        let positions = self::function_set(tensors, &joined([prefix, "positions."]), factors)?;
        let forces = network(tensors, &joined([prefix, "forces."]))?;
        let coordinates = winding_shape[1];
        let efforts = efforts(tensors, prefix, factors.0.len().saturating_sub(coordinates), coordinates)?;
        let count = efforts.count();
        expect_shape(
            joined([prefix, "positions.windings"]),
            &winding_shape,
            &[positions.dictionary().outputs(), coordinates],
        )?;
        let shown = whole_rows(tensors, &joined([prefix, "outputs.shown"]))?;
        let mut outputs = Vec::with_capacity(shown.len());
        for (index, &[kind, position]) in shown.iter().enumerate() {
            let position = position as usize;
            outputs.push(match kind {
                0 => Shown::Position(position),
                1 => Shown::Velocity(position),
                2 => Shown::Acceleration(position),
                3 => Shown::KineticEnergy,
                4 => Shown::PotentialEnergy,
                5 => Shown::Reaction(position),
                6 => Shown::Effort(position),
                found => {
                    return Err(FormatError::Unknown {
                        name: joined([prefix, "outputs.shown"]),
                        index: 2 * index,
                        found,
                    });
                }
            });
        }
        let [actuator_states, prescribed] = ["states.actuators", "functions.prescribed"].map(|what| {
            let name = joined([prefix, what]);
            // empty tensors are omitted
            let numbers = match tensors.contain(&name) {
                true => elements(take(tensors, &name, Dtype::U32, 1)?.data, u32::from_le_bytes),
                false => Vec::new(),
            };
            Ok(numbers.into_iter().map(|number| number as usize).collect::<Vec<_>>())
        });
        let (actuator_states, prescribed) = (actuator_states?.first().copied().unwrap_or(0), prescribed?);
        let dynamics =
            Dynamics::with_efforts(efforts, function_set)?.with_forces(forces)?.with_prescribed(&prescribed)?;
        let of_reactions = joined([prefix, "reactions."]);
        let has_reactions = tensors.contain_any(&of_reactions);
        let reactions = has_reactions.then(|| dictionary(tensors, &of_reactions, factors)).transpose()?;
        let reactions = reactions.map(|functions| Reactions::new(coordinates, count, functions)).transpose()?;
        Ok(Self { dynamics, positions, windings, reactions, actuator_states, outputs })
    }
}

/// Formulas of efforts, and what their columns are.
fn of_efforts(prefix: &str, efforts: &Efforts) -> Vec<Tensor> {
    let (mut steps, mut constants) = (Vec::new(), Vec::new());
    let tables = efforts.tables();
    for step in efforts.formulas().iter().flat_map(Formula::steps) {
        steps.extend(match step {
            FormulaStep::Constant(value) => {
                constants.push(*value);
                [0, constants.len() as u32 - 1]
            }
            FormulaStep::Column(column) => [1, *column as u32],
            FormulaStep::Call(function) => [2, *function as u32],
            FormulaStep::Negate => [3, 0],
            FormulaStep::Lookup(table) => {
                [4, tables.iter().position(|known| *known == table).unwrap_or_default() as u32]
            }
            FormulaStep::Combine(combination) => [FIRST_COMBINATION + *combination as u32, 0],
        });
    }
    let [_, inputs, coordinates] = efforts.counts();
    let mut tensors = vec![
        whole(&joined([prefix, "efforts.inputs"]), &[1], &[inputs as u32]),
        double(&joined([prefix, "efforts.windings"]), &[efforts.positions(), coordinates], efforts.windings()),
        whole(&joined([prefix, "efforts.steps"]), &[steps.len() / 2, 2], &steps),
        double(&joined([prefix, "efforts.constants"]), &[constants.len()], &constants),
    ];
    tensors.extend(of_tables(&joined([prefix, "efforts.tables"]), tables.into_iter()));
    tensors
}

/// Lookup tables under a name.
fn of_tables<'a>(prefix: &str, tables: impl Iterator<Item = &'a Arc<LookupTable>>) -> Vec<Tensor> {
    let mut tensors = Vec::new();
    for (index, table) in tables.enumerate() {
        let prefix = format!("{prefix}.{index}.");
        let shape: Vec<usize> = table.axes().iter().map(Vec::len).collect();
        let kinds = [table.interpolation() as u32, table.extrapolation() as u32];
        let axes =
            AXES.iter().zip(table.axes()).map(|(axis, knots)| double(&joined([&prefix, axis]), &[knots.len()], knots));
        tensors.extend(axes);
        tensors.push(double(&joined([&prefix, "values"]), &shape, table.values()));
        tensors.push(whole(&joined([&prefix, "kinds"]), &[2], &kinds));
    }
    tensors
}

/// Number of the first combination among the kinds of steps.
const FIRST_COMBINATION: u32 = 5;

/// Names of a table's axes.
const AXES: [&str; 2] = ["x", "y"];

/// The inverse of [`of_tables`].
#[inline(never)]
fn lookup_tables(tensors: &mut Views, prefix: &str) -> Result<Vec<Arc<LookupTable>>, FormatError> {
    let mut tables = Vec::new();
    loop {
        let prefix = joined([prefix, ".", &tables.len().to_string(), "."]);
        let (values_name, kinds_name) = (joined([&prefix, "values"]), joined([&prefix, "kinds"]));
        if !tensors.contain(&values_name) {
            return Ok(tables);
        }
        let mut axes = Vec::new();
        for axis in AXES.map(|axis| joined([&prefix, axis])) {
            if tensors.contain(&axis) {
                axes.push(doubles(tensors, &axis, 1)?.0);
            }
        }
        let (values, shape) = doubles(tensors, &values_name, axes.len())?;
        expect_shape(&values_name, &shape, &axes.iter().map(Vec::len).collect::<Vec<_>>())?;
        let kinds = counts(tensors, &kinds_name, 2)?;
        let interpolation = listed(&Interpolation::ALL, &kinds_name, 0, kinds[0])?;
        let extrapolation = listed(&Extrapolation::ALL, &kinds_name, 1, kinds[1])?;
        tables.push(Arc::new(LookupTable::new(axes, values, interpolation, extrapolation)?));
    }
}

/// The item of a list with a number that stands at an index of a tensor.
fn listed<T: Copy>(list: &[T], name: &str, index: usize, number: u32) -> Result<T, FormatError> {
    let item = list.get(number as usize).copied();
    item.ok_or_else(|| FormatError::Unknown { name: name.into(), index, found: number })
}

/// The inverse of [`of_efforts`].
#[inline(never)]
fn efforts(tensors: &mut Views, prefix: &str, parameters: usize, coordinates: usize) -> Result<Efforts, FormatError> {
    let inputs = counts(tensors, &joined([prefix, "efforts.inputs"]), 1)?[0] as usize;
    let (windings, shape) = doubles(tensors, &joined([prefix, "efforts.windings"]), 2)?;
    expect_shape(joined([prefix, "efforts.windings"]), &shape[1..], &[coordinates])?;
    let (constants, _) = doubles(tensors, &joined([prefix, "efforts.constants"]), 1)?;
    let tables = lookup_tables(tensors, &joined([prefix, "efforts.tables"]))?;
    let steps = whole_rows(tensors, &joined([prefix, "efforts.steps"]))?;
    let mut known_steps = Vec::with_capacity(steps.len());
    for (index, &[kind, argument]) in steps.iter().enumerate() {
        let at = argument as usize;
        let known = match kind {
            0 => constants.get(at).map(|value| FormulaStep::Constant(*value)),
            1 => Some(FormulaStep::Column(at)),
            2 => ElementaryFunction::ALL.get(at).map(|function| FormulaStep::Call(*function)),
            3 => Some(FormulaStep::Negate),
            4 => tables.get(at).cloned().map(FormulaStep::Lookup),
            _ => Combination::ALL.get((kind - FIRST_COMBINATION) as usize).copied().map(FormulaStep::Combine),
        };
        let Some(known) = known else {
            let is_argument = kind <= 2 || kind == 4;
            let (name, found) = (joined([prefix, "efforts.steps"]), if is_argument { argument } else { kind });
            return Err(FormatError::Unknown { name, index: 2 * index + usize::from(is_argument), found });
        };
        known_steps.push(known);
    }
    let formulas = Formula::one_after_the_other(&known_steps)?;
    Efforts::new([parameters, inputs, coordinates], windings, formulas)
}

/// A network that adds to functions: its tensors, and what its columns and outputs are.
fn of_network(prefix: &str, term: &NetworkTerm) -> Vec<Tensor> {
    let columns = term.columns().iter().flat_map(|column| {
        let kind = KINDS.iter().position(|known| *known == column.kind).unwrap_or(0);
        [column.of as u32, kind as u32]
    });
    let columns: Vec<u32> = columns.collect();
    let outputs: Vec<u32> = term.outputs().iter().map(|output| *output as u32).collect();
    let mut tensors = Graph::from(term.network()).tensors(&format!("{prefix}network.graph."));
    tensors.push(whole(&joined([prefix, "network.columns"]), &[columns.len() / 2, 2], &columns));
    tensors.push(whole(&joined([prefix, "network.outputs"]), &[outputs.len()], &outputs));
    tensors
}

/// In the order of their numbers in the file.
const KINDS: [ColumnKind; 3] = [ColumnKind::Plain, ColumnKind::Sine, ColumnKind::Cosine];

/// The inverse of [`of_network`]; none if there are no such tensors.
#[inline(never)]
fn network(tensors: &mut Views, prefix: &str) -> Result<Option<NetworkTerm>, FormatError> {
    let columns_name = joined([prefix, "network.columns"]);
    if !tensors.contain(&columns_name) {
        return Ok(None);
    }
    let columns = whole_rows(tensors, &columns_name)?;
    let columns = columns.iter().enumerate().map(|(index, &[of, kind])| {
        let kind = listed(&KINDS, &columns_name, 2 * index + 1, kind)?;
        Ok(NetworkColumn { of: of as usize, kind })
    });
    let columns = columns.collect::<Result<Vec<_>, FormatError>>()?;
    let outputs =
        elements(take(tensors, &joined([prefix, "network.outputs"]), Dtype::U32, 1)?.data, u32::from_le_bytes);
    let outputs = outputs.into_iter().map(|output| output as usize).collect();
    let graph = Graph::read(tensors, &joined([prefix, "network.graph."]), true)?;
    graph.widths()?;
    let network = graph.network().ok_or_else(|| FormatError::NoNetwork { name: joined([prefix, "network.graph"]) })?;
    NetworkTerm::new(columns, outputs, network).map(Some)
}

/// Contributions of the columns of a dictionary, and its splines.
type KnownFactors<'a> = (&'a [Factor], &'a [SplineFactor]);

fn function_set(tensors: &mut Views, prefix: &str, factors: KnownFactors) -> Result<FunctionSet, FormatError> {
    FunctionSet::new(dictionary(tensors, prefix, factors)?, network(tensors, prefix)?)
}

fn whole(name: &str, shape: &[usize], values: &[u32]) -> Tensor {
    (name.into(), Dtype::U32, shape.into(), bytes(values, u32::to_le_bytes))
}

pub(super) fn double(name: &str, shape: &[usize], values: &[f64]) -> Tensor {
    (name.into(), Dtype::F64, shape.into(), bytes(values, f64::to_le_bytes))
}

impl Dictionary {
    /// Tensors whose names begin with this, of a dictionary without splines.
    pub(crate) fn tensors(&self, prefix: &str) -> Vec<Tensor> {
        [columns(prefix, self)].into_iter().chain(of_dictionary(prefix, self)).collect()
    }

    pub(crate) fn read(tensors: &mut Views, prefix: &str) -> Result<Self, FormatError> {
        let factors = factors(tensors, prefix)?;
        dictionary(tensors, prefix, (&factors, &[]))
    }
}

/// Tensor of the columns of a dictionary.
fn columns(prefix: &str, dictionary: &Dictionary) -> Tensor {
    let pairs = dictionary.factors().flat_map(|factor| match factor {
        Factor::Angle => [0.0, 0.0],
        Factor::Power { middle, half } => [middle, half],
    });
    let pairs: Vec<f64> = pairs.collect();
    double(&format!("{prefix}columns"), &[pairs.len() / 2, 2], &pairs)
}

/// Splines of a dictionary; nothing if there are none.
fn of_splines(prefix: &str, dictionary: &Dictionary) -> Vec<Tensor> {
    let splines = dictionary.splines();
    if splines.is_empty() {
        return Vec::new();
    }
    let columns: Vec<u32> = splines.iter().map(|spline| spline.column as u32).collect();
    let content = bytes(&columns, u32::to_le_bytes);
    let columns = (format!("{prefix}splines.columns"), Dtype::U32, vec![columns.len()], content);
    let tables = of_tables(&format!("{prefix}splines"), splines.iter().map(|spline| &spline.table));
    [columns].into_iter().chain(tables).collect()
}

/// The inverse of [`of_splines`].
#[inline(never)]
fn splines(tensors: &mut Views, prefix: &str) -> Result<Vec<SplineFactor>, FormatError> {
    let name = joined([prefix, "splines.columns"]);
    if !tensors.contain(&name) {
        return Ok(Vec::new());
    }
    let columns = elements(take(tensors, &name, Dtype::U32, 1)?.data, u32::from_le_bytes);
    let tables = lookup_tables(tensors, &joined([prefix, "splines"]))?;
    expect_shape(&name, &[columns.len()], &[tables.len()])?;
    let splines = columns.into_iter().zip(tables);
    Ok(splines.map(|(column, table)| SplineFactor { column: column as usize, table }).collect())
}

fn of_dictionary(prefix: &str, dictionary: &Dictionary) -> [Tensor; 2] {
    let terms: Vec<Term> = dictionary.terms().collect();
    let exponents: Vec<i16> = terms.iter().flat_map(|term| term.exponents.iter().copied()).collect();
    let coefficients: Vec<f64> = terms.iter().flat_map(|term| term.coefficients.iter().copied()).collect();
    let shape = vec![terms.len(), dictionary.exponents()];
    let exponents = (format!("{prefix}exponents"), Dtype::I16, shape, bytes(&exponents, i16::to_le_bytes));
    [exponents, double(&format!("{prefix}coefficients"), &[terms.len(), dictionary.outputs()], &coefficients)]
}

/// Finite numbers and their shape.
#[inline(never)]
pub(super) fn doubles(
    tensors: &mut Views,
    name: &str,
    dimensions: usize,
) -> Result<(Vec<f64>, Vec<usize>), FormatError> {
    let view = take(tensors, name, Dtype::F64, dimensions)?;
    let values = elements(view.data, f64::from_le_bytes);
    expect_finite(name, values.iter().copied())?;
    Ok((values, view.shape.to_vec()))
}

/// Longest step and tolerance of the solver, under a name for each method with error control.
pub(super) fn of_integration(integration: Integration) -> Vec<Tensor> {
    let step = double("solver.step", &[1], &[integration.longest()]);
    let name = if integration.is_implicit() { IMPLICIT } else { EXPLICIT };
    let tolerance = integration.tolerance().map(|tolerance| double(name, &[1], &[tolerance]));
    [step].into_iter().chain(tolerance).collect()
}

/// Tensors of tolerances.
const EXPLICIT: &str = "solver.tolerance";
const IMPLICIT: &str = "solver.implicit_tolerance";

/// The inverse of [`of_integration`].
pub(super) fn integration(tensors: &mut Views) -> Result<Integration, FormatError> {
    let step = exactly(tensors, "solver.step", 1)?[0];
    let is_implicit = tensors.contain(IMPLICIT);
    if !is_implicit && !tensors.contain(EXPLICIT) {
        return Ok(Integration::Fixed { step });
    }
    let tolerance = exactly(tensors, if is_implicit { IMPLICIT } else { EXPLICIT }, 1)?[0];
    Ok(match is_implicit {
        true => Integration::Implicit { tolerance, longest: step },
        false => Integration::ErrorControlled { tolerance, longest: step },
    })
}

/// The inverse of [`columns`].
#[inline(never)]
fn factors(tensors: &mut Views, prefix: &str) -> Result<Vec<Factor>, FormatError> {
    let name = joined([prefix, "columns"]);
    let (columns, shape) = doubles(tensors, &name, 2)?;
    expect_shape(&name, &shape[1..], &[2])?;
    let factors = columns.as_chunks::<2>().0.iter().map(|pair| match *pair {
        // a half of zero is refused by the dictionary
        [middle, half] if pair.map(f64::to_bits) != [0; 2] => Factor::Power { middle, half },
        _ => Factor::Angle,
    });
    Ok(factors.collect())
}

#[inline(never)]
fn dictionary(tensors: &mut Views, prefix: &str, factors: KnownFactors) -> Result<Dictionary, FormatError> {
    let (coefficients_name, exponents_name) = (joined([prefix, "coefficients"]), joined([prefix, "exponents"]));
    let view = take(tensors, &exponents_name, Dtype::I16, 2)?;
    let (exponents, shape) = (elements(view.data, i16::from_le_bytes), view.shape.to_vec());
    let view = take(tensors, &coefficients_name, Dtype::F64, 2)?;
    let width = factors.0.len() + SPLINE_POWERS * factors.1.len();
    expect_shape(&exponents_name, &shape, &[view.shape[0], width])?;
    let functions = view.shape[1];
    let coefficients = elements(view.data, f64::from_le_bytes);
    // chunks of no length are not allowed
    let rows = (0..shape[0])
        .map(|index| (&exponents[index * width..][..width], &coefficients[index * functions..][..functions]));
    Dictionary::from_rows(factors, functions, rows)
}
