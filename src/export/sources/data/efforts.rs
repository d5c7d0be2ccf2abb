//! Formulas of efforts, as a template in one kind of numbers.

use super::{array, divisor, push, real};
use metafmu_runtime::{
    EffortColumn, Efforts,
    formula::{
        Applied, Combination, ElementaryFunction, Extrapolation, Formula, FormulaStep, Interpolation, LookupTable,
    },
};
use std::sync::Arc;

/// A value in the C code: a number that is known, or the name of a variable.
enum CodeValue {
    Known(f64),
    Named(String),
}

/// `model_efforts.h`
pub fn template(efforts: &Efforts) -> String {
    let mut text = String::from(
        "/*\n * Generated. A template, without a guard: efforts e, and arguments of tables, from parameters p, inputs u, positions\n * r and their rates.\n */\n\
         static void OF(efforts)(const NUMBER *p, const NUMBER *u, const NUMBER *r, const NUMBER *rates, NUMBER *e,\n                        NUMBER *arguments)\n{\n",
    );
    for name in ["p", "u", "r", "rates", "e", "arguments"] {
        push(&mut text, format_args!("    (void){name};\n"));
    }
    let (tables, mut count) = (efforts.tables(), [0; 2]);
    for (index, formula) in efforts.formulas().iter().enumerate() {
        let value = formula.walk(|step: Applied<CodeValue>| written(step, (efforts, &tables), &mut text, &mut count));
        push(&mut text, format_args!("    e[{index}] = {};\n", value.text()));
    }
    text + "}\n"
}

/// Axis and position of the table of each argument that is no constant, in the order in which the efforts are computed.
pub fn arguments(efforts: &Efforts) -> Vec<(usize, usize)> {
    let (tables, mut arguments) = (efforts.tables(), Vec::new());
    for formula in efforts.formulas() {
        let varies = |step: Applied<bool>| match step {
            Applied::Constant(_) => false,
            Applied::Column(_) => true,
            Applied::Negate(x) | Applied::Call(_, x) => *x,
            Applied::Combine(_, a, b) => *a || *b,
            Applied::Lookup(table, at) => {
                let axes = at.iter().enumerate().filter(|(_, varies)| **varies);
                arguments.extend(axes.map(|(axis, _)| (axis, position(&tables, table))));
                true
            }
        };
        formula.walk(varies);
    }
    arguments
}

fn position(tables: &[&Arc<LookupTable>], table: &Arc<LookupTable>) -> usize {
    tables.iter().position(|known| *known == table).unwrap_or_default()
}

/// `model_tables`: those of the formulas, each once; `model_arguments`: what is looked up there.
pub fn write_tables(text: &mut String, efforts: &Efforts) {
    let mut entries = String::new();
    for (index, table) in efforts.tables().into_iter().enumerate() {
        let name = |what: &str| format!("table_{index}_{what}");
        let mut axes = Vec::new();
        for (axis, knots) in ["x", "y"].into_iter().zip(table.axes()) {
            array(text, &format!("static const Real {}", name(axis)), knots);
            axes.push(format!("{}, {}", name(axis), knots.len()));
        }
        axes.resize(2, "NULL, 0".into());
        array(text, &format!("static const Real {}", name("nodes")), table.nodes());
        let [has_slopes, is_cubic] = [table.has_slopes(), table.interpolation() == Interpolation::Cubic].map(u8::from);
        let extrapolation = match table.extrapolation() {
            Extrapolation::Hold => "HOLD",
            Extrapolation::Linear => "LINEAR",
            Extrapolation::Periodic => "PERIODIC",
        };
        let mut bends = Vec::new();
        for (axis, what) in ["x", "y"].into_iter().take(table.arguments()).enumerate() {
            let of_axis = table.bends(axis);
            if of_axis.is_empty() {
                bends.push(("NULL".to_owned(), 0));
                continue;
            }
            let name = name(&format!("{what}_bends"));
            let listed: Vec<String> =
                of_axis.iter().map(|bend| format!("    {{{}, {}}},\n", real(bend.at), real(bend.width))).collect();
            push(text, format_args!("\nstatic const Bend {name}[] = {{\n{}}};\n", listed.concat()));
            bends.push((name, of_axis.len()));
        }
        bends.resize(2, ("NULL".into(), 0));
        let (axes, nodes, [(x, x_count), (y, y_count)]) = (axes.join(", "), name("nodes"), [&bends[0], &bends[1]]);
        push(
            &mut entries,
            format_args!(
                "    {{{axes}, {nodes}, {has_slopes}, {is_cubic}, EXTRAPOLATION_{extrapolation}, {{{x}, {y}}}, {{{x_count}, {y_count}}}}},\n"
            ),
        );
    }
    if entries.is_empty() {
        // C has no empty arrays
        entries.push_str("    {NULL, 0, NULL, 0, NULL, 0, 0, EXTRAPOLATION_HOLD, {NULL, NULL}, {0, 0}},\n");
    }
    push(text, format_args!("\nconst LookupTable model_tables[] = {{\n{entries}}};\n"));
    let arguments = arguments(efforts);
    let listed = arguments.iter().map(|(axis, table)| format!("    {{&model_tables[{table}], {axis}}},\n"));
    let listed = if arguments.is_empty() { "    {NULL, 0},\n".into() } else { listed.collect::<String>() };
    push(text, format_args!("\nconst Argument model_arguments[] = {{\n{listed}}};\n"));
}

/// Operations of a formula, and calls of functions.
pub fn operations(formula: &Formula) -> [usize; 2] {
    let count = |is: fn(&FormulaStep) -> bool| formula.steps().iter().filter(|step| is(step)).count();
    let calls = count(|step| matches!(step, FormulaStep::Call(_) | FormulaStep::Combine(Combination::Power)));
    let of_tables = formula.steps().iter().map(|step| match step {
        FormulaStep::Lookup(table) => LOOKUP_OPERATIONS * table.arguments() * table.numbers_of_node(),
        _ => 0,
    });
    let single = count(|step| matches!(step, FormulaStep::Negate | FormulaStep::Combine(_)));
    let powers = count(|step| matches!(step, FormulaStep::Combine(Combination::Power)));
    [single - powers + of_tables.sum::<usize>(), calls]
}

/// Multiplications and additions of a table for each argument and number of a node: its six derivatives at two or four nodes, and the weights.
const LOOKUP_OPERATIONS: usize = 36;

impl CodeValue {
    fn text(&self) -> String {
        match self {
            Self::Known(value) => format!("OF(constant)({})", real(*value)),
            Self::Named(name) => name.clone(),
        }
    }
}

/// Writes a step, and returns its value.
fn written(
    step: Applied<CodeValue>,
    (efforts, tables): (&Efforts, &[&Arc<LookupTable>]),
    text: &mut String,
    [count, arguments]: &mut [usize; 2],
) -> CodeValue {
    let call = |name: &str, of: &[&CodeValue]| {
        let of: Vec<String> = of.iter().map(|value| value.text()).collect();
        format!("OF({name})({})", of.join(", "))
    };
    let scaled = |x: &CodeValue, by: String| format!("OF(scaled)({}, {by})", x.text());
    let code = match step {
        Applied::Constant(value) => return CodeValue::Known(value),
        Applied::Column(column) => {
            return CodeValue::Named(match efforts.column(column) {
                EffortColumn::Parameter(parameter) => format!("p[{parameter}]"),
                EffortColumn::Input(input) => format!("u[{input}]"),
                EffortColumn::Position(position) => format!("r[{position}]"),
                EffortColumn::Rate(position) => format!("rates[{position}]"),
            });
        }
        Applied::Negate(CodeValue::Known(x)) => return CodeValue::Known(-x),
        Applied::Negate(x) => scaled(x, real(-1.0)),
        Applied::Call(function, CodeValue::Known(x)) => return CodeValue::Known(function.value(*x)),
        Applied::Call(function, x) => call(function.name(), &[x]),
        Applied::Combine(combination, CodeValue::Known(a), CodeValue::Known(b)) => {
            return CodeValue::Known(combination.value(*a, *b));
        }
        Applied::Combine(combination, a, b) => match (combination, a, b) {
            (Combination::Add, a, b) => call("sum", &[a, b]),
            (Combination::Subtract, a, b) => call("difference", &[a, b]),
            (Combination::Multiply, CodeValue::Known(by), x) | (Combination::Multiply, x, CodeValue::Known(by)) => {
                scaled(x, real(*by))
            }
            (Combination::Multiply, a, b) => call("product", &[a, b]),
            (Combination::Divide, x, CodeValue::Known(by)) => scaled(x, format!("R(1.0) / {}", divisor(*by))),
            (Combination::Divide, a, b) => call("quotient", &[a, b]),
            (Combination::Power, x, CodeValue::Known(0.5)) => call(ElementaryFunction::Sqrt.name(), &[x]),
            (Combination::Power, x, CodeValue::Known(power)) if Combination::is_product(*power) => {
                (1..*power as u32).fold(x.text(), |power, _| format!("OF(product)({power}, {})", x.text()))
            }
            (Combination::Power, a, b) => call("power", &[a, b]),
            (Combination::Minimum, a, b) => call("minimum", &[a, b]),
            (Combination::Maximum, a, b) => call("maximum", &[a, b]),
        },
        Applied::Lookup(table, at) => {
            for value in at.iter().filter(|value| matches!(value, CodeValue::Named(_))) {
                push(text, format_args!("    arguments[{arguments}] = {};\n", value.text()));
                *arguments += 1;
            }
            let [first, last] = [&at[0], &at[at.len() - 1]].map(CodeValue::text);
            format!("OF(lookup)(&model_tables[{}], {first}, {last})", position(tables, table))
        }
    };
    push(text, format_args!("    const NUMBER t{count} = {code};\n"));
    *count += 1;
    CodeValue::Named(format!("t{}", *count - 1))
}
