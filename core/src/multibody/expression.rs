//! Arithmetic expressions in a description, with exact first and second derivatives.
//!
//! Numbers, names, `+ - * / ^`, parentheses, `pi` and the [functions](FUNCTIONS); `^` binds tightest and to the right, so
//! `-a^2` is `-(a^2)`. An expression is evaluated on second-order Taylor coefficients (forward automatic differentiation;
//! Griewank, Walther: *Evaluating Derivatives*, chapter 13), which is how a driver gets its velocity and acceleration.

use crate::diagnostics::names::expected_one_of;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::{
    borrow::Cow,
    fmt,
    ops::{Add, Div, Mul, Neg, Sub},
};

/// A function of one variable: its name, and value, first and second derivative there.
type Function = (&'static str, fn(f64) -> [f64; 3]);

/// Every function an expression may call.
pub const FUNCTIONS: &[Function] = &[
    ("sin", |x| [x.sin(), x.cos(), -x.sin()]),
    ("cos", |x| [x.cos(), -x.sin(), -x.cos()]),
    ("tan", |x| {
        let (y, slope) = (x.tan(), 1.0 + x.tan().powi(2));
        [y, slope, 2.0 * y * slope]
    }),
    ("asin", |x| {
        let slope = (1.0 - x * x).sqrt().recip();
        [x.asin(), slope, x * slope.powi(3)]
    }),
    ("acos", |x| {
        let slope = (1.0 - x * x).sqrt().recip();
        [x.acos(), -slope, -x * slope.powi(3)]
    }),
    ("atan", |x| {
        let slope = (1.0 + x * x).recip();
        [x.atan(), slope, -2.0 * x * slope * slope]
    }),
    ("tanh", |x| {
        let (y, slope) = (x.tanh(), 1.0 - x.tanh().powi(2));
        [y, slope, -2.0 * y * slope]
    }),
    ("exp", |x| [x.exp(), x.exp(), x.exp()]),
    ("ln", log),
    ("sqrt", |x| [x.sqrt(), 0.5 / x.sqrt(), -0.25 / (x * x.sqrt())]),
    ("abs", |x| [x.abs(), if x < 0.0 { -1.0 } else { 1.0 }, 0.0]),
];

/// A value with its first and second derivative with respect to time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    /// `f`.
    pub value: f64,
    /// `df/dt`.
    pub rate: f64,
    /// `d²f/dt²`.
    pub acceleration: f64,
}

impl Jet {
    /// A value that does not change with time.
    pub fn constant(value: f64) -> Self {
        Self { value, rate: 0.0, acceleration: 0.0 }
    }

    /// The time itself.
    pub fn time(value: f64) -> Self {
        Self { value, rate: 1.0, acceleration: 0.0 }
    }

    /// `f(self)` by the chain rule; `derivatives` are `f`, `f'` and `f''` at the value.
    fn chain(self, [f, f1, f2]: [f64; 3]) -> Self {
        // what does not change has no derivative, even where that of f is infinite, as of sqrt at 0
        let term = |slope: f64, change: f64| if change == 0.0 { 0.0 } else { slope * change };
        let acceleration = term(f2, self.rate * self.rate) + term(f1, self.acceleration);
        Self { value: f, rate: term(f1, self.rate), acceleration }
    }

    fn is_constant(self) -> bool {
        self.rate == 0.0 && self.acceleration == 0.0
    }

    fn power(self, exponent: Self) -> Self {
        if !exponent.is_constant() {
            return (exponent * self.chain(log(self.value))).chain([1.0; 3].map(|_| self.value.powf(exponent.value)));
        }
        let (x, p) = (self.value, exponent.value);
        // 0 * 0^-1 is zero here: the derivative of a constant
        let term = |factor: f64, power: f64| if factor == 0.0 { 0.0 } else { factor * x.powf(power) };
        self.chain([x.powf(p), term(p, p - 1.0), term(p * (p - 1.0), p - 2.0)])
    }
}

fn log(x: f64) -> [f64; 3] {
    [x.ln(), x.recip(), -x.powi(-2)]
}

impl Add for Jet {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        let acceleration = self.acceleration + other.acceleration;
        Self { value: self.value + other.value, rate: self.rate + other.rate, acceleration }
    }
}

impl Neg for Jet {
    type Output = Self;
    fn neg(self) -> Self {
        Self { value: -self.value, rate: -self.rate, acceleration: -self.acceleration }
    }
}

impl Sub for Jet {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for Jet {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        let (a, b) = (self, other);
        Self {
            value: a.value * b.value,
            rate: a.rate * b.value + a.value * b.rate,
            acceleration: a.acceleration * b.value + 2.0 * a.rate * b.rate + a.value * b.acceleration,
        }
    }
}

impl Div for Jet {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        // value by value where possible, so that 1/3 is the double nearest to a third
        let x = other.value;
        let product = self * other.chain([x.recip(), -x.powi(-2), 2.0 * x.powi(-3)]);
        Self { value: self.value / x, ..product }
    }
}

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    text: String,
    /// Postfix notation.
    steps: Vec<Step>,
    /// The names in the expression, each once.
    names: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Step {
    Constant(f64),
    /// Pushes the value of a name, by its position among the names.
    Name(usize),
    /// Replaces the top by a function of it, by its position among the functions.
    Call(usize),
    Negate,
    Add,
    Subtract,
    Multiply,
    Divide,
    Power,
}

impl Expression {
    /// An expression that is a number.
    pub fn number(value: f64) -> Self {
        Self { text: value.to_string(), steps: vec![Step::Constant(value)], names: Vec::new() }
    }

    /// Parses a text.
    ///
    /// # Errors
    /// A sentence that says what was found, where, and what was expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        let expression = Self { text: text.to_owned(), steps: Vec::new(), names: Vec::new() };
        let mut parser = Parser { text, position: 0, depth: 0, expression };
        parser.sum()?;
        match parser.peek() {
            None => Ok(parser.expression),
            Some(_) => Err(parser.unexpected("an operator or the end")),
        }
    }

    /// The names in the expression, each once, in order of appearance.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Evaluates; `value` gives the value of a name by its position in [`Expression::names`].
    pub fn evaluate(&self, value: impl Fn(usize) -> Jet) -> Jet {
        let mut stack = Vec::with_capacity(self.steps.len());
        for step in &self.steps {
            // the parser writes no operator without its operands
            let mut pop = || stack.pop().unwrap_or(Jet::constant(f64::NAN));
            let result = match *step {
                Step::Constant(number) => Jet::constant(number),
                Step::Name(position) => value(position),
                Step::Call(function) => {
                    let argument = pop();
                    argument.chain(FUNCTIONS[function].1(argument.value))
                }
                Step::Negate => -pop(),
                Step::Add => {
                    let right = pop();
                    pop() + right
                }
                Step::Subtract => {
                    let right = pop();
                    pop() - right
                }
                Step::Multiply => {
                    let right = pop();
                    pop() * right
                }
                Step::Divide => {
                    let right = pop();
                    pop() / right
                }
                Step::Power => {
                    let right = pop();
                    pop().power(right)
                }
            };
            stack.push(result);
        }
        stack.pop().unwrap_or(Jet::constant(f64::NAN))
    }
}

impl Default for Expression {
    fn default() -> Self {
        Self::number(0.0)
    }
}

impl fmt::Display for Expression {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Serialize for Expression {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.steps.as_slice() {
            [Step::Constant(value)] => serializer.serialize_f64(*value),
            _ => serializer.serialize_str(&self.text),
        }
    }
}

impl JsonSchema for Expression {
    fn schema_name() -> Cow<'static, str> {
        "Expression".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "anyOf": [{ "type": "number", "format": "finite" }, { "type": "string", "format": "expression" }] })
    }
}

impl<'de> Deserialize<'de> for Expression {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl de::Visitor<'_> for Visitor {
            type Value = Expression;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or an expression in quotes")
            }
            fn visit_f64<E: de::Error>(self, value: f64) -> Result<Expression, E> {
                if value.is_finite() {
                    Ok(Expression::number(value))
                } else {
                    Err(E::custom(format!("{value}, expected a finite number")))
                }
            }
            fn visit_i64<E: de::Error>(self, value: i64) -> Result<Expression, E> {
                Ok(Expression::number(value as f64))
            }
            fn visit_u64<E: de::Error>(self, value: u64) -> Result<Expression, E> {
                Ok(Expression::number(value as f64))
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<Expression, E> {
                Expression::parse(text).map_err(E::custom)
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

/// Recursive descent; each rule appends its steps after those of its operands.
struct Parser<'a> {
    text: &'a str,
    position: usize,
    depth: usize,
    expression: Expression,
}

impl Parser<'_> {
    /// `product (("+" | "-") product)*`
    fn sum(&mut self) -> Result<(), String> {
        self.product()?;
        while let Some(operator @ ('+' | '-')) = self.peek() {
            self.position += 1;
            self.product()?;
            self.expression.steps.push(if operator == '+' { Step::Add } else { Step::Subtract });
        }
        Ok(())
    }

    /// `signed (("*" | "/") signed)*`
    fn product(&mut self) -> Result<(), String> {
        self.signed()?;
        while let Some(operator @ ('*' | '/')) = self.peek() {
            self.position += 1;
            self.signed()?;
            self.expression.steps.push(if operator == '*' { Step::Multiply } else { Step::Divide });
        }
        Ok(())
    }

    /// `("-" | "+") signed | atom ("^" signed)?`
    fn signed(&mut self) -> Result<(), String> {
        self.depth += 1;
        if self.depth > 100 {
            return Err(format!("`{}` is nested too deeply, expected at most 100 levels", self.text));
        }
        match self.peek() {
            Some('-') => {
                self.position += 1;
                self.signed()?;
                self.expression.steps.push(Step::Negate);
            }
            Some('+') => {
                self.position += 1;
                self.signed()?;
            }
            _ => {
                self.atom()?;
                if self.peek() == Some('^') {
                    self.position += 1;
                    self.signed()?;
                    self.expression.steps.push(Step::Power);
                }
            }
        }
        self.depth -= 1;
        Ok(())
    }

    /// `number | name | function "(" sum ")" | "(" sum ")"`
    fn atom(&mut self) -> Result<(), String> {
        match self.peek() {
            Some('(') => self.parentheses(),
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => self.name(),
            _ => Err(self.unexpected("a number, a name or `(`")),
        }
    }

    fn parentheses(&mut self) -> Result<(), String> {
        self.position += 1;
        self.sum()?;
        if self.peek() != Some(')') {
            return Err(self.unexpected("`)`"));
        }
        self.position += 1;
        Ok(())
    }

    fn number(&mut self) -> Result<(), String> {
        let rest = &self.text[self.position..];
        let digits = |text: &str| text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
        let mut end = digits(rest);
        if rest[end..].starts_with('.') {
            end += 1 + digits(&rest[end + 1..]);
        }
        if let Some(exponent) = rest[end..].strip_prefix(['e', 'E']) {
            let sign = usize::from(exponent.starts_with(['+', '-']));
            let count = digits(&exponent[sign..]);
            end += if count > 0 { 1 + sign + count } else { 0 };
        }
        match rest[..end].parse::<f64>() {
            Ok(value) if value.is_finite() => {
                self.position += end;
                self.expression.steps.push(Step::Constant(value));
                Ok(())
            }
            _ => Err(self.unexpected("a finite number")),
        }
    }

    fn name(&mut self) -> Result<(), String> {
        let rest = &self.text[self.position..];
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '.';
        let name = &rest[..rest.find(|c| !plain(c)).unwrap_or(rest.len())];
        self.position += name.len();
        if self.peek() == Some('(') {
            let Some(function) = FUNCTIONS.iter().position(|(known, _)| *known == name) else {
                let known: Vec<&str> = FUNCTIONS.iter().map(|(known, _)| *known).collect();
                let known = expected_one_of(name, &known);
                return Err(format!("`{}`: no function `{name}`, {known}", self.text));
            };
            self.parentheses()?;
            self.expression.steps.push(Step::Call(function));
        } else if name == "pi" {
            self.expression.steps.push(Step::Constant(std::f64::consts::PI));
        } else {
            let names = &mut self.expression.names;
            let position = names.iter().position(|known| known == name).unwrap_or_else(|| {
                names.push(name.to_owned());
                names.len() - 1
            });
            self.expression.steps.push(Step::Name(position));
        }
        Ok(())
    }

    /// The next character that is not a space.
    fn peek(&mut self) -> Option<char> {
        let rest = &self.text[self.position..];
        self.position += rest.len() - rest.trim_start().len();
        self.text[self.position..].chars().next()
    }

    fn unexpected(&mut self, expected: &str) -> String {
        let found = self.peek().map_or("the end".into(), |c| format!("`{c}`"));
        let column = self.text[..self.position].chars().count() + 1;
        format!("`{}`: found {found} at character {column}, expected {expected}", self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(text: &str, t: f64) -> Jet {
        let expression = Expression::parse(text).unwrap();
        expression.evaluate(|position| match expression.names()[position].as_str() {
            "time" => Jet::time(t),
            "a" => Jet::constant(1.7),
            name => panic!("{name}"),
        })
    }

    #[test]
    fn arithmetic_follows_the_usual_precedence() {
        for (text, value) in [
            ("1 + 2*3", 7.0),
            ("-2^2", -4.0),
            ("2^3^2", 512.0),
            ("2^-1", 0.5),
            ("8/4/2", 1.0),
            ("7 - 2 - 1", 4.0),
            ("(1 + 2)*-3", -9.0),
            ("1.5e-3 + .5 + 2.", 2.5015),
            ("2*pi", 2.0 * std::f64::consts::PI),
            ("sqrt(a^2)", 1.7),
            ("1/3", 1.0 / 3.0),
        ] {
            assert_eq!(at(text, 0.0).value, value, "{text}");
        }
    }

    #[test]
    fn derivatives_agree_with_finite_differences() {
        let texts = [
            "time/a - sin(a*time)/a^2",
            "time^3 - 2*time^2 + 1",
            "tan(time/3)*cos(time) - asin(time/4)/acos(time/5)",
            "atan(time)*tanh(a*time) + exp(-time)*ln(time + 1)",
            "sqrt(time^2 + 1)^time",
            "abs(-time)/(1 + time)",
        ];
        let step = 1e-4;
        for text in texts {
            for t in [0.3, 0.9, 1.4] {
                let (before, here, after) = (at(text, t - step), at(text, t), at(text, t + step));
                let rate = (after.value - before.value) / (2.0 * step);
                let acceleration = (after.rate - before.rate) / (2.0 * step);
                assert!((here.rate - rate).abs() < 1e-6 * (1.0 + rate.abs()), "{text} at {t}: {here:?} {rate}");
                let difference = (here.acceleration - acceleration).abs();
                assert!(difference < 1e-6 * (1.0 + acceleration.abs()), "{text} at {t}: {here:?} {acceleration}");
            }
        }
    }

    #[test]
    fn powers_have_derivatives_at_zero_and_below() {
        assert_eq!(at("time^2", 0.0), Jet { value: 0.0, rate: 0.0, acceleration: 2.0 });
        assert_eq!(at("time^1", 0.0), Jet { value: 0.0, rate: 1.0, acceleration: 0.0 });
        assert_eq!(at("time^3", -2.0), Jet { value: -8.0, rate: 12.0, acceleration: -12.0 });
        assert_eq!(at("sqrt(0)", 0.0), Jet::constant(0.0));
    }

    #[test]
    fn mistakes_say_what_was_found_and_expected() {
        for (text, says) in [
            ("", "found the end at character 1, expected a number, a name or `(`"),
            ("2 *", "found the end"),
            ("2 x", "found `x` at character 3, expected an operator or the end"),
            ("(1 + 2", "found the end at character 7, expected `)`"),
            ("sine(1)", "no function `sine`, expected one of sin, cos"),
            ("1 + é", "found `é` at character 5"),
            ("1e999", "expected a finite number"),
            ("..", "expected a finite number"),
        ] {
            let message = Expression::parse(text).unwrap_err();
            assert!(message.contains(says), "{message}");
        }
        assert!(Expression::parse(&"(".repeat(10_000)).unwrap_err().contains("nested too deeply"));
        assert!(Expression::parse(&"-".repeat(10_000)).unwrap_err().contains("nested too deeply"));
    }
}
