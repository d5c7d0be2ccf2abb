//! Numbers as people read them.
//!
//! Records hold the largest number for what is infinite or NaN, because JSON has neither. Here it is "not finite".

pub use metafmu_runtime::exact;
use std::fmt::{Display, Write};

/// Text for a number that is infinite, NaN, or the largest one.
const NOT_FINITE: &str = "not finite";

/// Returns true if a number is neither infinite, NaN nor the largest one.
pub fn is_proper(value: f64) -> bool {
    value.abs() < f64::MAX
}

/// Formats a number with four digits.
pub fn number(value: f64) -> String {
    if !is_proper(value) {
        return NOT_FINITE.into();
    }
    let magnitude = value.abs();
    let mut text = String::new();
    // writing to a string does not fail
    if magnitude != 0.0 && !(1e-3..1e5).contains(&magnitude) {
        let _ = write!(text, "{value:.3e}");
        return text;
    }
    let decimals = if magnitude == 0.0 { 0 } else { (3 - magnitude.log10().floor() as i32).max(0) as usize };
    let _ = write!(text, "{value:.decimals$}");
    if text.contains('.') {
        text.truncate(text.trim_end_matches('0').trim_end_matches('.').len());
    }
    text
}

/// Formats a number as a power of ten with this many decimals, for instance `1.8e-7` with one.
pub fn power(value: f64, decimals: usize) -> String {
    if is_proper(value) { format!("{value:.decimals$e}") } else { NOT_FINITE.into() }
}

/// Range that a number must be in, for instance `1 to 2`; an end that is infinite is left out, as in `at most 2`.
pub fn ends(min: f64, max: f64) -> String {
    match (min.is_finite(), max.is_finite()) {
        (true, true) => format!("{} to {}", exact(min), exact(max)),
        (true, false) => format!("at least {}", exact(min)),
        (false, true) => format!("at most {}", exact(max)),
        (false, false) => "any number".into(),
    }
}

/// Both ends of a range: `from 1 to 2`.
pub fn from_to(min: f64, max: f64) -> String {
    format!("from {} to {}", exact(min), exact(max))
}

/// Text of a value, which is [`exact`] if it is a number of many digits.
pub fn shown(value: impl Display) -> String {
    /// Digits of a double, its sign, its point and a zero before it.
    const LONGEST: usize = 20;
    let text = value.to_string();
    let number = Some(&text).filter(|text| text.len() > LONGEST).and_then(|text| text.parse().ok());
    number.map_or(text, exact)
}

/// Formats a share as a percentage with three decimals, or four digits of one that is far from that.
pub fn percent(share: f64) -> String {
    let percent = 100.0 * share;
    if !is_proper(percent) {
        return NOT_FINITE.into();
    }
    if percent == 0.0 || (5e-4..1e6).contains(&percent.abs()) {
        format!("{percent:.3} %")
    } else {
        format!("{} %", number(percent))
    }
}

/// Number of things with their name in the singular: `1 run`, `3 runs`.
pub fn counted(count: usize, name: &str) -> String {
    format!("{count} {name}{}", if count == 1 { "" } else { "s" })
}

/// R² as people read it: nine decimals, or a power of ten where it is as bad as can be.
pub fn r2(value: f64) -> String {
    if value.abs() < 1e4 { format!("{value:.9}") } else { power(value, 2) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits() {
        for (value, text) in [
            (0.0, "0"),
            (0.15000000000000002, "0.15"),
            (-2.0, "-2"),
            (47.123456, "47.12"),
            (12345.6, "12346"),
            (1e-9, "1.000e-9"),
            (123456.0, "1.235e5"),
            (f64::NAN, "not finite"),
            (f64::MAX, "not finite"),
            (f64::NEG_INFINITY, "not finite"),
        ] {
            assert_eq!(number(value), text);
        }
    }

    #[test]
    fn no_number_is_long_or_a_sentinel() {
        for (found, text) in [
            (power(1.234e-7, 1), "1.2e-7"),
            (power(f64::MAX, 3), "not finite"),
            (ends(0.5, 2.0), "0.5 to 2"),
            (ends(f64::NEG_INFINITY, 2.0), "at most 2"),
            (ends(0.5, f64::INFINITY), "at least 0.5"),
            (from_to(-1e300, 2.5), "from -1e300 to 2.5"),
            (shown(5e-324), "5e-324"),
            (shown(f64::MAX), "1.7976931348623157e308"),
            (shown("a key of more than twenty letters"), "a key of more than twenty letters"),
            (shown(-0.30000000000000004), "-0.30000000000000004"),
            (percent(0.02), "2.000 %"),
            (percent(0.0), "0.000 %"),
            (percent(1e-9), "1.000e-7 %"),
            (percent(f64::MAX), "not finite"),
            (r2(0.25), "0.250000000"),
            (r2(f64::MIN), "not finite"),
            (counted(1, "run"), "1 run"),
            (counted(0, "run"), "0 runs"),
        ] {
            assert_eq!(found, text);
        }
    }
}
