//! Formulas of efforts, as a template in one kind of numbers.

use super::{divisor, push, real};
use metafmu_runtime::{
    EffortColumn, Efforts,
    formula::{ElementaryFunction, Formula, FormulaStep},
};

/// A value in the C code: a number that is known, or the name of a variable.
#[derive(Clone)]
enum Value {
    Known(f64),
    Named(String),
}

/// Largest power that is a product, as in the library.
const LARGEST_POWER: f64 = 4.0;

/// `model_efforts.h`
pub fn template(efforts: &Efforts) -> String {
    let mut text = String::from(
        "/*\n * Generated. A template, without a guard: efforts e from parameters p, inputs u, positions r and their rates.\n */\n\
         static void OF(efforts)(const NUMBER *p, const NUMBER *u, const NUMBER *r, const NUMBER *rates, NUMBER *e)\n{\n",
    );
    for name in ["p", "u", "r", "rates", "e"] {
        push(&mut text, format_args!("    (void){name};\n"));
    }
    let mut count = 0;
    for (index, formula) in efforts.formulas().iter().enumerate() {
        let value = formula.walk(|step, operands: &[Value]| written(step, operands, efforts, &mut text, &mut count));
        push(&mut text, format_args!("    e[{index}] = {};\n", value.text()));
    }
    text + "}\n"
}

/// Operations of a formula, and calls of functions.
pub fn operations(formula: &Formula) -> [usize; 2] {
    let count = |is: fn(&FormulaStep) -> bool| formula.steps().iter().filter(|step| is(step)).count();
    let calls = count(|step| matches!(step, FormulaStep::Call(_) | FormulaStep::Power));
    [count(|step| !matches!(step, FormulaStep::Constant(_) | FormulaStep::Column(_))) - calls, calls]
}

impl Value {
    fn text(&self) -> String {
        match self {
            Self::Known(value) => format!("OF(constant)({})", real(*value)),
            Self::Named(name) => name.clone(),
        }
    }
}

/// Writes a step, and returns its value.
fn written(step: FormulaStep, operands: &[Value], efforts: &Efforts, text: &mut String, count: &mut usize) -> Value {
    if let (false, Some(known)) = (operands.is_empty(), known(step, operands)) {
        return Value::Known(known);
    }
    let call = |name: &str, of: &[&Value]| {
        let of: Vec<String> = of.iter().map(|value| value.text()).collect();
        format!("OF({name})({})", of.join(", "))
    };
    let scaled = |x: &Value, by: String| format!("OF(scaled)({}, {by})", x.text());
    let code = match (step, operands) {
        (FormulaStep::Constant(value), _) => return Value::Known(value),
        (FormulaStep::Column(column), _) => {
            return Value::Named(match efforts.column(column) {
                EffortColumn::Parameter(parameter) => format!("p[{parameter}]"),
                EffortColumn::Input(input) => format!("u[{input}]"),
                EffortColumn::Position(position) => format!("r[{position}]"),
                EffortColumn::Rate(position) => format!("rates[{position}]"),
            });
        }
        (FormulaStep::Call(function), [x]) => call(function.name(), &[x]),
        (FormulaStep::Negate, [x]) => scaled(x, real(-1.0)),
        (FormulaStep::Add, [a, b]) => call("sum", &[a, b]),
        (FormulaStep::Subtract, [a, b]) => call("difference", &[a, b]),
        (FormulaStep::Multiply, [Value::Known(by), x] | [x, Value::Known(by)]) => scaled(x, real(*by)),
        (FormulaStep::Multiply, [a, b]) => call("product", &[a, b]),
        (FormulaStep::Divide, [x, Value::Known(by)]) => scaled(x, format!("R(1.0) / {}", divisor(*by))),
        (FormulaStep::Divide, [a, b]) => call("quotient", &[a, b]),
        (FormulaStep::Power, [x, Value::Known(0.5)]) => call(ElementaryFunction::Sqrt.name(), &[x]),
        (FormulaStep::Power, [x, Value::Known(whole)])
            if whole.fract() == 0.0 && (1.0..=LARGEST_POWER).contains(whole) =>
        {
            (1..*whole as u32).fold(x.text(), |power, _| format!("OF(product)({power}, {})", x.text()))
        }
        (FormulaStep::Power, [a, b]) => call("power", &[a, b]),
        (FormulaStep::Minimum, [a, b]) => call("minimum", &[a, b]),
        (FormulaStep::Maximum, [a, b]) => call("maximum", &[a, b]),
        _ => unreachable!("`walk` gives each step its operands"),
    };
    push(text, format_args!("    const NUMBER t{count} = {code};\n"));
    *count += 1;
    Value::Named(format!("t{}", *count - 1))
}

/// The value of a step whose operands are known.
fn known(step: FormulaStep, operands: &[Value]) -> Option<f64> {
    let value = |value: &Value| if let Value::Known(value) = value { Some(*value) } else { None };
    let values: Vec<f64> = operands.iter().map(value).collect::<Option<_>>()?;
    let steps = values.into_iter().map(FormulaStep::Constant).chain([step]).collect();
    Formula::new(steps).ok().map(|formula| formula.value(|_| f64::NAN))
}
