//! Numbers as text in messages.

/// Formats a number with all of its digits, and with a power of ten below 1e-5 and from 1e16 on: never hundreds of zeros.
pub fn exact(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-5..1e16).contains(&magnitude) || !value.is_finite() {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::exact;

    #[test]
    fn numbers_keep_all_digits_and_few_zeros() {
        let found = [0.0, 12.0, 1.0 / 3.0, 1e16, -1.5e300, 5e-324, f64::NAN].map(exact);
        assert_eq!(found, ["0", "12", "0.3333333333333333", "1e16", "-1.5e300", "5e-324", "NaN"]);
    }
}
