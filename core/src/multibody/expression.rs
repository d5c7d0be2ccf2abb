//! Arithmetic expressions in a description, with exact first and second derivatives.
//!
//! Numbers, names, `+ - * / ^`, parentheses, `pi`, `min`, `max` and the [functions](ElementaryFunction); `^` binds tightest and to the right, so
//! `-a^2` is `-(a^2)`. An expression is evaluated on series ([`Jet`]), which is how a driver gets its velocity and acceleration.

use crate::diagnostics::names::expected_one_of;
use metafmu_runtime::{
    Jet,
    formula::{Combination, ElementaryFunction, Formula, FormulaStep},
};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::{borrow::Cow, fmt};

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    text: String,
    /// Its columns are the names.
    formula: Formula,
    /// The names in the expression, each once.
    names: Vec<String>,
}

impl Expression {
    /// An expression that is a number.
    pub fn number(value: f64) -> Self {
        Self { text: value.to_string(), formula: Formula::number(value), names: Vec::new() }
    }

    /// Parses a text.
    ///
    /// # Errors
    /// A sentence that says what was found, where, and what was expected.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut parser = Parser { text, position: 0, depth: 0, steps: Vec::new(), names: Vec::new() };
        parser.sum()?;
        if parser.peek().is_some() {
            return Err(parser.unexpected("an operator or the end"));
        }
        let Parser { steps, names, .. } = parser;
        let formula = Formula::new(steps).map_err(|error| format!("`{text}`: {error}"))?;
        Ok(Self { text: text.to_owned(), formula, names })
    }

    /// The names in the expression, each once, in order of appearance: the columns of its formula.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The formula.
    pub fn formula(&self) -> &Formula {
        &self.formula
    }

    /// Value; `of` gives that of a name by its position in [`Expression::names`].
    pub fn value(&self, of: impl Fn(usize) -> f64) -> f64 {
        self.formula.value(of)
    }

    /// Value with its derivatives with respect to time.
    pub fn series(&self, of: impl Fn(usize) -> Jet) -> Jet {
        self.formula.series(of)
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
        match self.formula.steps() {
            [FormulaStep::Constant(value)] => serializer.serialize_f64(*value),
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

/// Functions of two variables.
const PAIRS: [(&str, Combination); 2] = [("min", Combination::Minimum), ("max", Combination::Maximum)];

/// Recursive descent; each rule appends its steps after those of its operands.
struct Parser<'a> {
    text: &'a str,
    position: usize,
    depth: usize,
    steps: Vec<FormulaStep>,
    names: Vec<String>,
}

impl Parser<'_> {
    /// `product (("+" | "-") product)*`
    fn sum(&mut self) -> Result<(), String> {
        self.product()?;
        while let Some(operator @ ('+' | '-')) = self.peek() {
            self.position += 1;
            self.product()?;
            self.steps.push(if operator == '+' {
                FormulaStep::Combine(Combination::Add)
            } else {
                FormulaStep::Combine(Combination::Subtract)
            });
        }
        Ok(())
    }

    /// `signed (("*" | "/") signed)*`
    fn product(&mut self) -> Result<(), String> {
        self.signed()?;
        while let Some(operator @ ('*' | '/')) = self.peek() {
            self.position += 1;
            self.signed()?;
            self.steps.push(if operator == '*' {
                FormulaStep::Combine(Combination::Multiply)
            } else {
                FormulaStep::Combine(Combination::Divide)
            });
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
                self.steps.push(FormulaStep::Negate);
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
                    self.steps.push(FormulaStep::Combine(Combination::Power));
                }
            }
        }
        self.depth -= 1;
        Ok(())
    }

    /// `number | name | function "(" sum ")" | pair "(" sum "," sum ")" | "(" sum ")"`
    fn atom(&mut self) -> Result<(), String> {
        match self.peek() {
            Some('(') => self.arguments(1),
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => self.name(),
            _ => Err(self.unexpected("a number, a name or `(`")),
        }
    }

    /// `"(" sum ("," sum)* ")"`
    fn arguments(&mut self, count: usize) -> Result<(), String> {
        for argument in 0..count {
            // the first of them is `(`, which was seen already
            if argument > 0 && self.peek() != Some(',') {
                return Err(self.unexpected("`,`"));
            }
            self.position += 1;
            self.sum()?;
        }
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
                self.steps.push(FormulaStep::Constant(value));
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
            let step = PAIRS
                .iter()
                .find(|(known, _)| *known == name)
                .map(|(_, combination)| FormulaStep::Combine(*combination));
            let function = ElementaryFunction::ALL.into_iter().find(|known| known.name() == name);
            let Some(step) = step.or(function.map(FormulaStep::Call)) else {
                let known = ElementaryFunction::ALL.map(ElementaryFunction::name).into_iter();
                let known: Vec<&str> = known.chain(PAIRS.map(|(name, _)| name)).collect();
                let known = expected_one_of(name, &known);
                return Err(format!("`{}`: no function `{name}`, {known}", self.text));
            };
            self.arguments(if function.is_some() { 1 } else { 2 })?;
            self.steps.push(step);
        } else if name == "pi" {
            self.steps.push(FormulaStep::Constant(std::f64::consts::PI));
        } else {
            let names = &mut self.names;
            let position = names.iter().position(|known| known == name).unwrap_or_else(|| {
                names.push(name.to_owned());
                names.len() - 1
            });
            self.steps.push(FormulaStep::Column(position));
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
        expression.series(|position| match expression.names()[position].as_str() {
            "time" => Jet { value: t, first: 1.0, second: 0.0 },
            "a" => Jet::from(1.7),
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
            ("min(a, 1 + 1) + max(-3, -a)", 0.0),
            ("sign(-a)*abs(a)", -1.7),
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
                let acceleration = (after.first - before.first) / (2.0 * step);
                assert!((here.first - rate).abs() < 1e-6 * (1.0 + rate.abs()), "{text} at {t}: {here:?} {rate}");
                let difference = (here.second - acceleration).abs();
                assert!(difference < 1e-6 * (1.0 + acceleration.abs()), "{text} at {t}: {here:?} {acceleration}");
            }
        }
    }

    #[test]
    fn powers_have_derivatives_at_zero_and_below() {
        assert_eq!(at("time^2", 0.0), Jet { value: 0.0, first: 0.0, second: 2.0 });
        assert_eq!(at("time^1", 0.0), Jet { value: 0.0, first: 1.0, second: 0.0 });
        assert_eq!(at("time^3", -2.0), Jet { value: -8.0, first: 12.0, second: -12.0 });
        assert_eq!(at("sqrt(0)", 0.0), Jet::from(0.0));
    }

    #[test]
    fn mistakes_say_what_was_found_and_expected() {
        for (text, says) in [
            ("", "found the end at character 1, expected a number, a name or `(`"),
            ("2 *", "found the end"),
            ("2 x", "found `x` at character 3, expected an operator or the end"),
            ("(1 + 2", "found the end at character 7, expected `)`"),
            ("min(1)", "found `)` at character 6, expected `,`"),
            ("sin(1, 2)", "found `,` at character 6, expected `)`"),
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
