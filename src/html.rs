//! Text for web pages.

use crate::evaluation::Verdict;
use std::fmt::Write;

/// Text with the characters that mean something in HTML and SVG replaced.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Four digits, which is what a reader takes in.
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

/// First lines of a page about a surrogate: the verdict, its reasons, and what may help.
pub fn verdict(verdict: &Verdict) -> String {
    let title = verdict.title();
    let title = format!("{}{}", title[..1].to_uppercase(), &title[1..]);
    let reasons = verdict.reasons().iter().map(|reason| escape(reason));
    let advice = verdict.advice.iter().map(|advice| format!("Try: {}", escape(advice)));
    let lines: String = reasons.chain(advice).map(|line| format!("<li>{line}</li>\n")).collect();
    let list = if lines.is_empty() { String::new() } else { format!("<ul>\n{lines}</ul>\n") };
    format!("<p><strong>{}.</strong></p>\n{list}", escape(&title))
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
