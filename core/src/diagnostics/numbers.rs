//! Numbers as people read them.

use std::fmt::Write;

/// Formats a number with four digits.
pub fn number(value: f64) -> String {
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

/// R² as people read it: nine decimals, or a power of ten where it is as bad as can be.
pub fn r2(value: f64) -> String {
    if value.abs() < 1e4 { format!("{value:.9}") } else { format!("{value:.2e}") }
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
        ] {
            assert_eq!(number(value), text);
        }
    }
}
