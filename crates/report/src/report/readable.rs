//! Numbers on the page as people write them: few digits, powers of ten with raised exponents, thousands apart.

use crate::diagnostics::numbers::{self, is_proper};

/// Four significant digits.
pub fn number(value: f64) -> String {
    rounded(value, 4)
}

/// Three significant digits, for errors.
pub fn short(value: f64) -> String {
    rounded(value, 3)
}

/// Two significant digits, where there is little room.
pub fn brief(value: f64) -> String {
    rounded(value, 2)
}

/// Replaces the exponent of `1e-7` or `2.5e-7` as programs write it: `10⁻⁷` or `2.5·10⁻⁷`, short enough for an axis.
pub fn tick(scientific: &str) -> String {
    match scientific.split_once('e').and_then(|(mantissa, exponent)| Some((mantissa, exponent.parse().ok()?))) {
        Some(("1", exponent)) => format!("10{}", raised(exponent)),
        Some((mantissa, exponent)) => format!("{mantissa}·10{}", raised(exponent)),
        None => scientific.to_owned(),
    }
}

/// A number with this many significant digits, without zeros at its end.
fn rounded(value: f64, digits: usize) -> String {
    if value == 0.0 {
        return "0".into();
    } else if !is_proper(value) {
        // without an exponent
        return numbers::number(value);
    }
    // the exponent is that of the rounded number: 9.996 is 10 in three digits
    let scientific = format!("{value:.*e}", digits - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if !(-3..6).contains(&exponent) {
        return format!("{}\u{a0}×\u{a0}10{}", trimmed(mantissa), raised(exponent));
    }
    let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
    let text = format!("{value:.decimals$}");
    let text = trimmed(&text);
    match text.split_once('.') {
        Some((whole, part)) => format!("{}.{part}", grouped(whole)),
        None => grouped(text),
    }
}

/// Without zeros at the end of decimals.
fn trimmed(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Whole number with a comma between thousands, from five digits on.
fn grouped(whole: &str) -> String {
    let (sign, digits) = whole.strip_prefix('-').map_or(("", whole), |digits| ("-", digits));
    if digits.len() < 5 {
        return whole.to_owned();
    }
    let mut text = sign.to_owned();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

fn raised(exponent: i32) -> String {
    exponent
        .to_string()
        .chars()
        .map(|digit| match digit {
            '-' => '⁻',
            '1' => '¹',
            '2' => '²',
            '3' => '³',
            digit => char::from_u32('⁰' as u32 + digit.to_digit(10).unwrap_or(0)).unwrap_or(digit),
        })
        .collect()
}

/// A number of things.
pub fn count(number: usize) -> String {
    grouped(&number.to_string())
}

/// R² with two digits after its nines, at least four decimals; its distance from 1 where that is tiny.
pub fn r2(value: f64) -> String {
    let misfit = 1.0 - value;
    if value.abs() >= 1e4 {
        return short(value);
    }
    if misfit == 0.0 {
        return "1".into();
    }
    if misfit.abs() < 1e-10 {
        return format!("1\u{a0}-\u{a0}{}", rounded(misfit, 1));
    }
    let nines = -misfit.abs().log10();
    let decimals = (nines.floor() + 2.0).clamp(4.0, 12.0) as usize;
    format!("{value:.decimals$}")
}

/// A share as percentage.
pub fn percent(share: f64) -> String {
    if is_proper(100.0 * share) { format!("{}\u{a0}%", short(100.0 * share)) } else { short(share) }
}

/// A duration in a unit that makes it a short number.
pub fn duration(seconds: f64) -> String {
    let units = [(1.0, "s"), (1e-3, "ms"), (1e-6, "µs")];
    let (size, unit) = units.into_iter().find(|(size, _)| seconds >= *size).unwrap_or((1e-9, "ns"));
    format!("{}\u{a0}{unit}", rounded(seconds / size, 2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_people_write_them() {
        for (value, text) in [
            (0.0, "0"),
            (0.15000000000000002, "0.15"),
            (-2.0, "-2"),
            (47.123456, "47.12"),
            (1234.5678, "1235"),
            (12345.6, "12,346"),
            (-123456.0, "-123,456"),
            (9.99996, "10"),
            (1e-9, "1\u{a0}×\u{a0}10⁻⁹"),
            (4.567e-14, "4.567\u{a0}×\u{a0}10⁻¹⁴"),
            (0.0012345, "0.001234"),
            (2.5e20, "2.5\u{a0}×\u{a0}10²⁰"),
            (f64::INFINITY, "not finite"),
            (f64::MAX, "not finite"),
        ] {
            assert_eq!(number(value), text);
        }
        assert_eq!(short(0.0126666), "0.0127");
        assert_eq!((count(7_335_141), count(4020)), ("7,335,141".into(), "4020".into()));
        assert_eq!(percent(0.00345), "0.345\u{a0}%");
        assert_eq!([3.2e-9, 1.24e-6, 0.5, 2.0].map(duration).join(" ").replace('\u{a0}', ""), "3.2ns 1.2µs 500ms 2s");
    }

    #[test]
    fn r2_keeps_two_digits_after_its_nines() {
        for (value, text) in [
            (0.999999954, "0.999999954"),
            (0.9972, "0.9972"),
            (0.5, "0.5000"),
            (-0.25, "-0.2500"),
            (0.99987, "0.99987"),
            (1.0, "1"),
            (1.0 - 2f64.powi(-45), "1\u{a0}-\u{a0}3\u{a0}×\u{a0}10⁻¹⁴"),
            (-4.2e5, "-420,000"),
        ] {
            assert_eq!(r2(value), text);
        }
    }
}
