//! Unit expressions such as `kg.m2/s` as powers of SI base units, and their comparison by meaning.
//!
//! A unit expression is a product of factors. `.`, `*`, `·`, `×` or a space multiply, `/` divides by the one factor after it.
//! A factor is an expression in parentheses, or a unit symbol of the table below with an SI prefix where that is usual; both may
//! have an integer exponent. Exponents are written `m2`, `m^2`, `m**2` or `m²`, negative ones `m-2`, `m^-2`, `m**-2` or `m⁻²`.
//! `1` is allowed as a numerator, as in `1/s`. Symbols and factors: the SI brochure, 9th edition.

use std::f64::consts::PI;

/// A unit in terms of SI base units: `value in SI = factor * value + offset`, the SI unit being
/// `kg^e0 m^e1 s^e2 A^e3 K^e4 mol^e5 cd^e6 rad^e7`. FMI counts the radian among them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseUnit {
    /// Exponents of `kg`, `m`, `s`, `A`, `K`, `mol`, `cd`, `rad`, in the order of [`BaseUnit::SYMBOLS`].
    pub exponents: [i32; 8],
    /// Factor.
    pub factor: f64,
    /// Offset; not zero for temperature scales only.
    pub offset: f64,
}

impl BaseUnit {
    /// Symbols of the base units, in the order of the exponents.
    pub const SYMBOLS: [&'static str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];
    /// The dimensionless unit.
    const ONE: Self = Self { exponents: [0; 8], factor: 1.0, offset: 0.0 };

    /// Parses a unit expression; `None` if it contains an unknown symbol, or is not a unit expression.
    pub fn parse(expression: &str) -> Option<Self> {
        // a temperature scale is not a multiple of the kelvin and only valid alone
        if matches!(expression.trim(), "degC" | "°C" | "℃") {
            return Some(Self { exponents: [0, 0, 0, 0, 1, 0, 0, 0], factor: 1.0, offset: 273.15 });
        }
        let expression = plain(expression);
        let mut rest = expression.trim();
        let unit = Self::product(&mut rest, 0)?;
        (rest.is_empty() && unit.factor.is_finite() && unit.factor > 0.0).then_some(unit)
    }

    /// Reads factors up to the end of the text or a closing parenthesis.
    fn product(rest: &mut &str, depth: usize) -> Option<Self> {
        let mut unit = Self::ONE;
        let mut sign = 1;
        loop {
            let (factor, exponent) = Self::factor(rest, depth)?;
            unit.multiply(factor, sign * exponent)?;
            let trimmed = rest.trim_start();
            match trimmed.chars().next() {
                None | Some(')') => break,
                Some(separator @ ('.' | '*' | '·' | '/')) => {
                    sign = if separator == '/' { -1 } else { 1 };
                    *rest = trimmed[separator.len_utf8()..].trim_start();
                }
                // only a space
                Some(_) if trimmed.len() < rest.len() => {
                    sign = 1;
                    *rest = trimmed;
                }
                Some(_) => return None,
            }
        }
        Some(unit)
    }

    /// Reads a symbol or an expression in parentheses, and its exponent.
    fn factor(rest: &mut &str, depth: usize) -> Option<(Self, i32)> {
        let factor = match rest.strip_prefix('(') {
            Some(inner) if depth < DEEPEST => {
                *rest = inner.trim_start();
                let product = Self::product(rest, depth + 1)?;
                *rest = rest.trim_start().strip_prefix(')')?;
                product
            }
            Some(_) => return None,
            None => {
                let end = rest.find(ends_symbol).unwrap_or(rest.len());
                let end = if rest.starts_with('1') { 1 } else { end };
                let (factor, exponents) = lookup(&rest[..end])?;
                let is_one = rest.starts_with('1');
                *rest = &rest[end..];
                let unit = Self { exponents, factor, offset: 0.0 };
                if is_one {
                    return Some((unit, 1));
                }
                unit
            }
        };
        Some((factor, exponent(rest)?))
    }

    fn multiply(&mut self, unit: Self, exponent: i32) -> Option<()> {
        self.factor *= unit.factor.powi(exponent);
        for (sum, of_unit) in self.exponents.iter_mut().zip(unit.exponents) {
            *sum = sum.checked_add(of_unit.checked_mul(exponent)?)?;
        }
        Some(())
    }
}

/// Returns true if two unit expressions have the same meaning, as `rad/s2` and `rad/s^2`. Expressions that are not understood
/// are compared as texts. An empty text, `-` and `1` are the dimensionless unit.
pub fn is_same(one: &str, other: &str) -> bool {
    let [one, other] = [one, other].map(str::trim);
    one == other
        || match (parsed(one), parsed(other)) {
            (Some(a), Some(b)) => {
                let is_close = (a.factor / b.factor - 1.0).abs() < ROUNDING;
                a.exponents == b.exponents && a.offset == b.offset && is_close
            }
            _ => false,
        }
}

/// The unit of a text, which may be empty or a dash for 1.
fn parsed(text: &str) -> Option<BaseUnit> {
    if matches!(text, "" | "-") { Some(BaseUnit::ONE) } else { BaseUnit::parse(text) }
}

/// Returns true if a character is not part of a unit's symbol but follows it.
fn ends_symbol(c: char) -> bool {
    c.is_ascii_digit() || c.is_whitespace() || "^-.*·/()".contains(c)
}

/// Relative difference of two factors that are equal but for rounding.
const ROUNDING: f64 = 1e-12;
/// Deepest nesting of parentheses.
const DEEPEST: usize = 8;

/// An expression in the characters that are parsed: `**` is `^`, superscripts are digits, and signs have one form.
fn plain(expression: &str) -> String {
    expression.replace("**", "^").chars().map(plain_character).collect()
}

fn plain_character(c: char) -> char {
    match c {
        '⁻' | '−' => '-',
        '⋅' | '×' | '∙' | '•' => '·',
        // the Greek letter is the micro sign
        'μ' => 'µ',
        c => "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().position(|of| of == c).map_or(c, |digit| char::from(b'0' + digit as u8)),
    }
}

/// Reads the exponent of a factor; 1 if there is none.
fn exponent(rest: &mut &str) -> Option<i32> {
    let has_sign = rest.starts_with('^');
    let text = rest.strip_prefix('^').unwrap_or(rest);
    let digits = text.strip_prefix('-').unwrap_or(text);
    let count = digits.find(|c: char| !c.is_ascii_digit()).unwrap_or(digits.len());
    if count == 0 {
        return (!has_sign && digits.len() == text.len()).then_some(1);
    }
    let length = text.len() - digits.len() + count;
    let exponent = text[..length].parse().ok()?;
    *rest = &text[length..];
    Some(exponent)
}

fn lookup(symbol: &str) -> Option<(f64, [i32; 8])> {
    if let Some(unit) = unit_of_symbol(symbol) {
        return Some((unit.factor, unit.exponents));
    }
    PREFIXES.iter().find_map(|(prefix, scale)| {
        let unit = unit_of_symbol(symbol.strip_prefix(prefix)?).filter(|unit| unit.prefixed)?;
        Some((scale * unit.factor, unit.exponents))
    })
}

fn unit_of_symbol(symbol: &str) -> Option<&'static Unit> {
    UNITS.iter().find(|unit| unit.symbol == symbol)
}

struct Unit {
    symbol: &'static str,
    factor: f64,
    exponents: [i32; 8],
    /// `true` if SI prefixes are usual with it.
    prefixed: bool,
}

const fn si(symbol: &'static str, exponents: [i32; 8]) -> Unit {
    Unit { symbol, factor: 1.0, exponents, prefixed: true }
}

const fn other(symbol: &'static str, factor: f64, exponents: [i32; 8]) -> Unit {
    Unit { symbol, factor, exponents, prefixed: false }
}

const ONE: [i32; 8] = [0; 8];
const TIME: [i32; 8] = [0, 0, 1, 0, 0, 0, 0, 0];
const ANGLE: [i32; 8] = [0, 0, 0, 0, 0, 0, 0, 1];
const LENGTH: [i32; 8] = [0, 1, 0, 0, 0, 0, 0, 0];
const MASS: [i32; 8] = [1, 0, 0, 0, 0, 0, 0, 0];
const PRESSURE: [i32; 8] = [1, -1, -2, 0, 0, 0, 0, 0];

const UNITS: &[Unit] = &[
    // kg m s A K mol cd rad
    si("m", LENGTH),
    si("s", TIME),
    si("A", [0, 0, 0, 1, 0, 0, 0, 0]),
    si("K", [0, 0, 0, 0, 1, 0, 0, 0]),
    si("mol", [0, 0, 0, 0, 0, 1, 0, 0]),
    si("cd", [0, 0, 0, 0, 0, 0, 1, 0]),
    si("rad", ANGLE),
    Unit { symbol: "g", factor: 1e-3, exponents: MASS, prefixed: true },
    other("kg", 1.0, MASS),
    other("t", 1e3, MASS),
    si("N", [1, 1, -2, 0, 0, 0, 0, 0]),
    si("Pa", PRESSURE),
    si("J", [1, 2, -2, 0, 0, 0, 0, 0]),
    si("W", [1, 2, -3, 0, 0, 0, 0, 0]),
    si("Hz", [0, 0, -1, 0, 0, 0, 0, 0]),
    si("C", [0, 0, 1, 1, 0, 0, 0, 0]),
    si("V", [1, 2, -3, -1, 0, 0, 0, 0]),
    si("F", [-1, -2, 4, 2, 0, 0, 0, 0]),
    si("Ohm", [1, 2, -3, -2, 0, 0, 0, 0]),
    si("Ω", [1, 2, -3, -2, 0, 0, 0, 0]),
    // the sign of the ohm, which is another character than the Greek letter
    si("\u{2126}", [1, 2, -3, -2, 0, 0, 0, 0]),
    si("Nm", [1, 2, -2, 0, 0, 0, 0, 0]),
    si("S", [-1, -2, 3, 2, 0, 0, 0, 0]),
    si("Wb", [1, 2, -2, -1, 0, 0, 0, 0]),
    si("T", [1, 0, -2, -1, 0, 0, 0, 0]),
    si("H", [1, 2, -2, -2, 0, 0, 0, 0]),
    Unit { symbol: "bar", factor: 1e5, exponents: PRESSURE, prefixed: true },
    Unit { symbol: "l", factor: 1e-3, exponents: [0, 3, 0, 0, 0, 0, 0, 0], prefixed: true },
    other("1", 1.0, ONE),
    other("%", 1e-2, ONE),
    other("min", 60.0, TIME),
    other("h", 3600.0, TIME),
    other("d", 86400.0, TIME),
    other("sec", 1.0, TIME),
    other("deg", PI / 180.0, ANGLE),
    other("°", PI / 180.0, ANGLE),
    other("rev", 2.0 * PI, ANGLE),
    other("rpm", 2.0 * PI / 60.0, [0, 0, -1, 0, 0, 0, 0, 1]),
    other("in", 0.0254, LENGTH),
    other("ft", 0.3048, LENGTH),
    other("lb", 0.453_592_37, MASS),
];

const PREFIXES: &[(&str, f64)] = &[
    ("n", 1e-9),
    ("u", 1e-6),
    ("µ", 1e-6),
    ("m", 1e-3),
    ("c", 1e-2),
    ("d", 1e-1),
    ("h", 1e2),
    ("k", 1e3),
    ("M", 1e6),
    ("G", 1e9),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn common_mechanical_units_have_their_powers_and_factors() {
        // kg m s A K mol cd rad
        for (expression, exponents, factor) in [
            ("m", [0, 1, 0, 0, 0, 0, 0, 0], 1.0),
            ("mm", [0, 1, 0, 0, 0, 0, 0, 0], 1e-3),
            ("kg", [1, 0, 0, 0, 0, 0, 0, 0], 1.0),
            ("s", [0, 0, 1, 0, 0, 0, 0, 0], 1.0),
            ("rad", [0, 0, 0, 0, 0, 0, 0, 1], 1.0),
            ("deg", [0, 0, 0, 0, 0, 0, 0, 1], PI / 180.0),
            ("N", [1, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("kN", [1, 1, -2, 0, 0, 0, 0, 0], 1e3),
            ("N.m", [1, 2, -2, 0, 0, 0, 0, 0], 1.0),
            ("rad/s", [0, 0, -1, 0, 0, 0, 0, 1], 1.0),
            ("rad/s2", [0, 0, -2, 0, 0, 0, 0, 1], 1.0),
            ("rad/s^2", [0, 0, -2, 0, 0, 0, 0, 1], 1.0),
            ("m/s", [0, 1, -1, 0, 0, 0, 0, 0], 1.0),
            ("m/s2", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m.s-2", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m s^-2", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m / s**2", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m·s⁻²", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m/s/s", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("m/(s·s)", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("(m/s)^2/m", [0, 1, -2, 0, 0, 0, 0, 0], 1.0),
            ("J/(kg.K)", [0, 2, -2, 0, -1, 0, 0, 0], 1.0),
            ("kΩ", [1, 2, -3, -2, 0, 0, 0, 0], 1e3),
            ("μm", [0, 1, 0, 0, 0, 0, 0, 0], 1e-6),
            ("Hz", [0, 0, -1, 0, 0, 0, 0, 0], 1.0),
            ("1/s", [0, 0, -1, 0, 0, 0, 0, 0], 1.0),
            ("W", [1, 2, -3, 0, 0, 0, 0, 0], 1.0),
            ("J", [1, 2, -2, 0, 0, 0, 0, 0], 1.0),
            ("MPa", [1, -1, -2, 0, 0, 0, 0, 0], 1e6),
            ("kg/s", [1, 0, -1, 0, 0, 0, 0, 0], 1.0),
            ("N.s/m", [1, 0, -1, 0, 0, 0, 0, 0], 1.0),
            ("kg.m2", [1, 2, 0, 0, 0, 0, 0, 0], 1.0),
            ("kg*m^2/s", [1, 2, -1, 0, 0, 0, 0, 0], 1.0),
            ("N.m.s/rad", [1, 2, -1, 0, 0, 0, 0, -1], 1.0),
            ("km/h", [0, 1, -1, 0, 0, 0, 0, 0], 1e3 / 3600.0),
            ("mm2", [0, 2, 0, 0, 0, 0, 0, 0], 1e-6),
            ("%", [0; 8], 1e-2),
        ] {
            let unit = BaseUnit::parse(expression).unwrap_or_else(|| panic!("{expression} is not understood"));
            assert_eq!(unit.exponents, exponents, "{expression}");
            let error = (unit.factor / factor - 1.0).abs();
            assert!(error < 4.0 * f64::EPSILON, "{expression}: {} instead of {factor}", unit.factor);
        }
    }

    #[test]
    fn a_temperature_scale_has_an_offset() {
        let celsius = BaseUnit::parse("degC").unwrap();
        assert_eq!((celsius.exponents[4], celsius.offset), (1, 273.15));
    }

    #[test]
    fn what_is_no_known_unit_is_not_guessed() {
        for expression in [
            "",
            "furlong",
            "m//s",
            "m/",
            ".m",
            "kkg",
            "m^",
            "m^x",
            "mdeg",
            "m99999999999",
            "3m",
            "-2",
            "m^",
            "m**",
            "(m",
            "m)",
            "()",
            "m(s)",
            "m2.5",
            "m^0.5",
            "m--2",
            "11",
            "1m",
        ] {
            assert_eq!(BaseUnit::parse(expression), None, "{expression}");
        }
    }

    #[test]
    fn spellings_of_a_unit_are_the_same_unit() {
        for spelling in
            ["rad/s^2", "rad/s**2", "rad/s²", "rad·s⁻²", "rad.s-2", "rad s^-2", "rad / s / s", "rad/(s*s)", "rad*s**-2"]
        {
            assert!(is_same("rad/s2", spelling) && is_same(spelling, "rad/s2"), "{spelling}");
        }
        for (one, other) in
            [("", "-"), ("1", ""), ("N.m", "Nm"), ("deg", "°"), ("1/s", "s^-1"), ("furlong", " furlong")]
        {
            assert!(is_same(one, other), "{one} {other}");
        }
        for (one, other) in [
            ("rad/s2", "rad/s"),
            ("m", "mm"),
            ("deg", "rad"),
            ("K", "degC"),
            ("rad", ""),
            ("furlong", "Furlong"),
            ("%", ""),
        ] {
            assert!(!is_same(one, other), "{one} {other}");
        }
    }
}
