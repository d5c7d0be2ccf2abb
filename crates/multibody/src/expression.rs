//! Arithmetic expressions in a description, with exact first and second derivatives.
//!
//! Numbers, names, `+ - * / ^`, parentheses, `pi`, the [functions](ElementaryFunction), `min`, `max`, `atan2(y, x)`, `mod(a, b)`,
//! `step(x, x0, y0, x1, y1)` and the description's tables; `^` binds tightest and to the right, so `-a^2` is `-(a^2)`. An expression becomes a [`Formula`] with the tables of a description.

use crate::diagnostics::names::expected_one_of;
use indexmap::IndexMap;
use metafmu_runtime::formula::{Combination, ElementaryFunction, Formula, FormulaStep, LookupTable};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::{borrow::Cow, fmt, ops::RangeInclusive, sync::Arc};

/// A parsed expression.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    text: String,
    tokens: Vec<Token>,
    /// The names in the expression, each once.
    names: Vec<String>,
}

/// A step in postfix notation, whose columns are the names.
#[derive(Clone, Debug, PartialEq)]
enum Token {
    Step(FormulaStep),
    /// A table of the description.
    Lookup {
        table: String,
        arguments: usize,
    },
}

/// Reason why a text is no expression, or an expression has no formula.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExpressionError {
    /// Kind of the reason.
    pub cause: ExpressionCause,
    /// Character in the text, counted from 1; none if no single one is wrong.
    pub character: Option<usize>,
    /// A sentence for people, with the expression.
    pub message: String,
}

/// Kinds of reasons why there is no expression or formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExpressionCause {
    /// Text that the grammar does not allow, such as a missing or a further argument of a function.
    Syntax,
    /// Name of a function or table that does not exist.
    UnknownFunction,
    /// Number of arguments that a table does not have.
    Arguments,
    /// Deeper nesting or more operations than allowed.
    TooLong,
}

impl ExpressionError {
    /// An error of a whole expression.
    fn new(cause: ExpressionCause, message: String) -> Self {
        Self { cause, character: None, message }
    }
}

impl fmt::Display for ExpressionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)
    }
}

impl std::error::Error for ExpressionError {}

impl Expression {
    /// An expression that is a number.
    pub fn number(value: f64) -> Self {
        Self { text: value.to_string(), tokens: vec![Token::Step(FormulaStep::Constant(value))], names: Vec::new() }
    }

    /// Parses a text.
    ///
    /// # Errors
    /// [`ExpressionCause::Syntax`] or [`ExpressionCause::TooLong`]: found and expected text, and the character.
    pub fn parse(text: &str) -> Result<Self, ExpressionError> {
        let mut parser = Parser { text, position: 0, depth: 0, tokens: Vec::new(), names: Vec::new() };
        parser.sum()?;
        if parser.peek().is_some() {
            return Err(parser.unexpected("an operator or the end"));
        }
        let Parser { tokens, names, .. } = parser;
        Ok(Self { text: text.to_owned(), tokens, names })
    }

    /// The names in the expression, each once, in order of appearance: the columns of its formula.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number that the expression is, if it is one.
    pub fn as_number(&self) -> Option<f64> {
        match self.tokens.as_slice() {
            [Token::Step(FormulaStep::Constant(value))] => Some(*value),
            _ => None,
        }
    }

    /// Names of the tables in the expression.
    pub fn tables(&self) -> impl Iterator<Item = &str> {
        self.tokens.iter().filter_map(|token| match token {
            Token::Step(_) => None,
            Token::Lookup { table, .. } => Some(table.as_str()),
        })
    }

    /// A function with a kink or a jump whose argument depends on a name that is not fixed.
    pub fn kinked_function(&self, is_fixed: impl Fn(&str) -> bool) -> Option<&'static str> {
        // for each value on the stack: does it change?
        let mut stack: Vec<bool> = Vec::new();
        let mut found = None;
        for token in &self.tokens {
            let operands = match token {
                Token::Lookup { arguments, .. } => *arguments,
                Token::Step(FormulaStep::Constant(_) | FormulaStep::Column(_)) => 0,
                Token::Step(FormulaStep::Combine(_)) => 2,
                Token::Step(_) => 1,
            };
            let mut changes = stack.split_off(stack.len().saturating_sub(operands)).contains(&true);
            let kinked = match token {
                Token::Step(FormulaStep::Column(index)) => {
                    changes = !is_fixed(&self.names[*index]);
                    None
                }
                Token::Step(FormulaStep::Call(ElementaryFunction::Floor)) => Some("floor` or `mod"),
                Token::Step(FormulaStep::Call(function @ (ElementaryFunction::Abs | ElementaryFunction::Sign))) => {
                    Some(function.name())
                }
                Token::Step(FormulaStep::Combine(Combination::Minimum)) => Some("min"),
                Token::Step(FormulaStep::Combine(Combination::Maximum)) => Some("max"),
                _ => None,
            };
            found = found.or(kinked.filter(|_| changes));
            stack.push(changes);
        }
        found
    }

    /// Replaces the names of variables with their expressions.
    ///
    /// # Errors
    /// [`ExpressionCause::TooLong`] if it has too many operations with its variables.
    pub fn with_variables(&self, variables: &IndexMap<String, Self>) -> Result<Self, ExpressionError> {
        let (mut tokens, mut names) = (Vec::new(), Vec::new());
        for token in &self.tokens {
            let variable = match token {
                Token::Step(FormulaStep::Column(index)) => variables.get(&self.names[*index]),
                _ => None,
            };
            let (from, of) =
                variable.map_or((std::slice::from_ref(token), &self.names), |of| (&of.tokens[..], &of.names));
            for token in from {
                tokens.push(match token {
                    Token::Step(FormulaStep::Column(index)) => {
                        Token::Step(FormulaStep::Column(position_of(&mut names, &of[*index])))
                    }
                    other => other.clone(),
                });
            }
            if tokens.len() > MOST_STEPS {
                let message = format!("`{self}` has more than {MOST_STEPS} operations with its variables");
                return Err(ExpressionError::new(ExpressionCause::TooLong, message));
            }
        }
        Ok(Self { text: self.text.clone(), tokens, names })
    }

    /// The formula with these tables by their names.
    ///
    /// # Errors
    /// [`ExpressionCause::UnknownFunction`] if there is no such table, [`ExpressionCause::Arguments`] if it has another
    /// number of arguments.
    pub fn formula(&self, tables: &Tables) -> Result<Formula, ExpressionError> {
        let steps = self.tokens.iter().map(|token| self.formula_step(token, tables)).collect::<Result<_, _>>()?;
        Formula::new(steps).map_err(|error| ExpressionError::new(ExpressionCause::Syntax, format!("`{self}`: {error}")))
    }

    /// Step of the formula for a token.
    fn formula_step(&self, token: &Token, tables: &Tables) -> Result<FormulaStep, ExpressionError> {
        let (name, arguments) = match token {
            Token::Step(step) => return Ok(step.clone()),
            Token::Lookup { table, arguments } => (table, *arguments),
        };
        let Some(table) = tables.get(name) else {
            let known: Vec<&str> = function_names().chain(tables.keys().map(String::as_str)).collect();
            let message = format!("`{self}`: no function or table `{name}`, {}", expected_one_of(name, &known));
            return Err(ExpressionError::new(ExpressionCause::UnknownFunction, message));
        };
        if table.arguments() != arguments {
            let expected = table.arguments();
            let counted = if arguments == 1 { "1 argument".into() } else { format!("{arguments} arguments") };
            let message = format!("`{self}`: {counted} of the table `{name}`, expected {expected}");
            return Err(ExpressionError::new(ExpressionCause::Arguments, message));
        }
        Ok(FormulaStep::Lookup(Arc::clone(table)))
    }
}

/// Tables of a description by their names.
pub type Tables = IndexMap<String, Arc<LookupTable>>;

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
        match self.as_number() {
            Some(value) => serializer.serialize_f64(value),
            None => serializer.serialize_str(&self.text),
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
const PAIRS: [(&str, Combination); 3] =
    [("min", Combination::Minimum), ("max", Combination::Maximum), ("atan2", Combination::Angle)];

/// Functions that are made of others, and their numbers of arguments.
const COMPOSED: [(&str, usize); 2] = [("mod", 2), ("step", 5)];

/// Names of all functions.
fn function_names<'a>() -> impl Iterator<Item = &'a str> {
    let functions = ElementaryFunction::ALL.map(ElementaryFunction::name).into_iter();
    functions.chain(PAIRS.map(|(name, _)| name)).chain(COMPOSED.map(|(name, _)| name))
}

/// Returns true if a function has this name.
pub fn is_function(name: &str) -> bool {
    function_names().any(|known| known == name)
}

/// The operations of a composed function, whose arguments these are.
///
/// `mod(a, b) = a - b floor(a / b)`, and `step(x, x0, y0, x1, y1) = y0 + (y1 - y0) smooth((x - x0) / (x1 - x0))`.
fn composed(arguments: &[Vec<Token>]) -> Vec<Token> {
    use Combination::{Add, Divide, Multiply, Subtract};
    match arguments {
        [x, x0, y0, x1, y1] => {
            let share = combined(Divide, &combined(Subtract, x, x0), &combined(Subtract, x1, x0));
            let share = called(ElementaryFunction::Smooth, &share);
            combined(Add, y0, &combined(Multiply, &combined(Subtract, y1, y0), &share))
        }
        [a, b] => {
            let turns = called(ElementaryFunction::Floor, &combined(Divide, a, b));
            combined(Subtract, a, &combined(Multiply, b, &turns))
        }
        _ => Vec::new(),
    }
}

fn combined(combination: Combination, a: &[Token], b: &[Token]) -> Vec<Token> {
    [a, b, &[Token::Step(FormulaStep::Combine(combination))]].concat()
}

fn called(function: ElementaryFunction, argument: &[Token]) -> Vec<Token> {
    [argument, &[Token::Step(FormulaStep::Call(function))]].concat()
}

/// Number of digits at the beginning of a text.
fn leading_digits(text: &str) -> usize {
    text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len())
}

/// Returns true if a name may have a character without being quoted.
fn is_of_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '.'
}

/// Operations of an expression with its variables, at most.
const MOST_STEPS: usize = 10_000;

/// Where a name stands; it is added if it does not yet.
fn position_of(names: &mut Vec<String>, name: &str) -> usize {
    names.iter().position(|known| known == name).unwrap_or_else(|| {
        names.push(name.to_owned());
        names.len() - 1
    })
}

/// Recursive descent; each rule appends its tokens after those of its operands.
struct Parser<'a> {
    text: &'a str,
    position: usize,
    depth: usize,
    tokens: Vec<Token>,
    names: Vec<String>,
}

impl Parser<'_> {
    /// `product (("+" | "-") product)*`
    fn sum(&mut self) -> Result<(), ExpressionError> {
        self.product()?;
        while let Some(operator @ ('+' | '-')) = self.peek() {
            self.position += 1;
            self.product()?;
            self.combine(if operator == '+' { Combination::Add } else { Combination::Subtract });
        }
        Ok(())
    }

    /// `signed (("*" | "/") signed)*`
    fn product(&mut self) -> Result<(), ExpressionError> {
        self.signed()?;
        while let Some(operator @ ('*' | '/')) = self.peek() {
            self.position += 1;
            self.signed()?;
            self.combine(if operator == '*' { Combination::Multiply } else { Combination::Divide });
        }
        Ok(())
    }

    /// `("-" | "+") signed | atom ("^" signed)?`
    fn signed(&mut self) -> Result<(), ExpressionError> {
        self.depth += 1;
        if self.depth > 100 {
            let message = format!("`{}` is nested too deeply, expected at most 100 levels", self.text);
            return Err(ExpressionError::new(ExpressionCause::TooLong, message));
        }
        match self.peek() {
            Some('-') => {
                self.position += 1;
                self.signed()?;
                self.step(FormulaStep::Negate);
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
                    self.combine(Combination::Power);
                }
            }
        }
        self.depth -= 1;
        Ok(())
    }

    fn step(&mut self, step: FormulaStep) {
        self.tokens.push(Token::Step(step));
    }

    fn combine(&mut self, combination: Combination) {
        self.step(FormulaStep::Combine(combination));
    }

    /// `number | name | function "(" sum ")" | pair "(" sum "," sum ")" | table "(" sum ("," sum)? ")" | "(" sum ")"`
    fn atom(&mut self) -> Result<(), ExpressionError> {
        match self.peek() {
            Some('(') => self.arguments(1..=1).map(drop),
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_ascii_alphabetic() || c == '_' => self.name(),
            _ => Err(self.unexpected("a number, a name or `(`")),
        }
    }

    /// `"(" sum ("," sum)* ")"`; returns where the operations of each sum begin.
    fn arguments(&mut self, counts: RangeInclusive<usize>) -> Result<Vec<usize>, ExpressionError> {
        let mut begins = Vec::new();
        // the first of them is `(`, which was seen already
        while begins.is_empty() || (begins.len() < *counts.end() && self.peek() == Some(',')) {
            self.position += 1;
            begins.push(self.tokens.len());
            self.sum()?;
        }
        if begins.len() < *counts.start() {
            return Err(self.unexpected("`,`"));
        }
        if self.peek() != Some(')') {
            return Err(self.unexpected("`)`"));
        }
        self.position += 1;
        Ok(begins)
    }

    fn number(&mut self) -> Result<(), ExpressionError> {
        let rest = &self.text[self.position..];
        let mut end = leading_digits(rest);
        if rest[end..].starts_with('.') {
            end += 1 + leading_digits(&rest[end + 1..]);
        }
        if let Some(exponent) = rest[end..].strip_prefix(['e', 'E']) {
            let sign = usize::from(exponent.starts_with(['+', '-']));
            let count = leading_digits(&exponent[sign..]);
            end += if count > 0 { 1 + sign + count } else { 0 };
        }
        match rest[..end].parse::<f64>() {
            Ok(value) if value.is_finite() => {
                self.position += end;
                self.step(FormulaStep::Constant(value));
                Ok(())
            }
            _ => Err(self.unexpected("a finite number")),
        }
    }

    fn name(&mut self) -> Result<(), ExpressionError> {
        let rest = &self.text[self.position..];
        let name = &rest[..rest.find(|c| !is_of_name(c)).unwrap_or(rest.len())];
        self.position += name.len();
        if self.peek() == Some('(') {
            let pair = PAIRS.iter().find(|(known, _)| *known == name);
            let function = ElementaryFunction::ALL.into_iter().find(|known| known.name() == name);
            if let Some((_, combination)) = pair {
                self.arguments(2..=2)?;
                self.combine(*combination);
            } else if let Some(function) = function {
                self.arguments(1..=1)?;
                self.step(FormulaStep::Call(function));
            } else if let Some((_, count)) = COMPOSED.iter().find(|(known, _)| *known == name) {
                let begins = self.arguments(*count..=*count)?;
                let arguments: Vec<_> = begins.into_iter().rev().map(|begin| self.tokens.split_off(begin)).collect();
                self.tokens.extend(composed(&arguments.into_iter().rev().collect::<Vec<_>>()));
            } else {
                let arguments = self.arguments(1..=2)?.len();
                self.tokens.push(Token::Lookup { table: name.to_owned(), arguments });
            }
        } else if name == "pi" {
            self.step(FormulaStep::Constant(std::f64::consts::PI));
        } else {
            let position = position_of(&mut self.names, name);
            self.step(FormulaStep::Column(position));
        }
        Ok(())
    }

    /// The next character that is not a space.
    fn peek(&mut self) -> Option<char> {
        let rest = &self.text[self.position..];
        self.position += rest.len() - rest.trim_start().len();
        self.text[self.position..].chars().next()
    }

    /// Error of the next character that is not a space.
    fn unexpected(&mut self, expected: &str) -> ExpressionError {
        let found = self.peek().map_or("the end".into(), |c| format!("`{c}`"));
        let character = self.text[..self.position].chars().count() + 1;
        let message = format!("`{}`: found {found} at character {character}, expected {expected}", self.text);
        ExpressionError { cause: ExpressionCause::Syntax, character: Some(character), message }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_runtime::{
        Jet,
        formula::{Extrapolation, Interpolation},
    };

    #[test]
    fn tables_are_functions_of_one_or_two_variables() {
        let knots = vec![0.0, 1.0];
        let table = |axes: Vec<Vec<f64>>, values: &[f64]| {
            let table = LookupTable::new(axes, values.to_vec(), Interpolation::Linear, Extrapolation::Hold);
            Arc::new(table.unwrap())
        };
        let cam = table(vec![knots.clone()], &[1.0, 3.0]);
        let map = table(vec![knots.clone(), knots], &[0.0, 2.0, 4.0, 6.0]);
        let tables: Tables = [("cam".to_owned(), cam), ("map".to_owned(), map)].into_iter().collect();
        let value =
            |text: &str| Expression::parse(text).unwrap().formula(&tables).map(|formula| formula.value(|_| 0.5));
        assert_eq!(value("-cam(a) + map(a, cam(0))"), Ok(-2.0 + 4.0));
        assert_eq!(value("cam(1, 2)").unwrap_err().message, "`cam(1, 2)`: 2 arguments of the table `cam`, expected 1");
        assert!(value("map(1)").unwrap_err().message.contains("1 argument of the table `map`, expected 2"));
    }

    fn at(text: &str, t: f64) -> Jet {
        let expression = Expression::parse(text).unwrap();
        expression.formula(&Tables::new()).unwrap().series(|position| match expression.names()[position].as_str() {
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
            ("floor(-a) + floor(a)", -1.0),
            ("mod(7.5, 2) + mod(-1, 2*2)", 4.5),
            ("atan2(1, -1)*4/pi + atan2(-2, 0)*2/pi", 2.0),
            ("step(a, 1, 2, 2, 2) + step(a, 2, -3, 3, 5) + step(a, 0, 0, 1, 4)", 3.0),
            ("step(2.5, 2, -3, 3, 5)", 1.0),
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
            "atan2(sin(time), -time - 0.2) - atan2(-time^2, -a)",
            "mod(7*time, 1.35)*time + smooth(time/2)",
            "step(time, 0.2, time^2, 1.5, 3)",
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
            ("step(1, 2)", "found `)` at character 10, expected `,`"),
            ("sin(1, 2)", "found `,` at character 6, expected `)`"),
            ("cam(1, 2, 3)", "found `,` at character 9, expected `)`"),
            ("1 + é", "found `é` at character 5"),
            ("1e999", "expected a finite number"),
            ("..", "expected a finite number"),
        ] {
            let error = Expression::parse(text).unwrap_err();
            assert!(error.message.contains(says), "{error}");
            assert_eq!(error.cause, ExpressionCause::Syntax, "{error}");
        }
        let unknown = Expression::parse("2*sine(1)").unwrap().formula(&Tables::new()).unwrap_err();
        assert!(
            unknown.message.contains("`2*sine(1)`: no function or table `sine`, expected one of sin, cos"),
            "{unknown}"
        );
        assert_eq!(unknown.cause, ExpressionCause::UnknownFunction);
        for character in ["(", "-"] {
            let error = Expression::parse(&character.repeat(10_000)).unwrap_err();
            assert!(error.message.contains("nested too deeply"));
            assert_eq!(error.cause, ExpressionCause::TooLong);
        }
        assert_eq!(Expression::parse("1 + é").unwrap_err().character, Some(5));
    }
}
