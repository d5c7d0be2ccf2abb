//! Text for web pages.

use crate::evaluation::Verdict;
use metafmu_runtime::Activation;
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

/// An activation's name as people write it.
pub fn activation(activation: Activation) -> &'static str {
    match activation {
        Activation::Tanh => "tanh",
        Activation::Sigmoid => "sigmoid",
        Activation::Relu => "ReLU",
        Activation::Gelu => "GELU",
        Activation::Silu => "SiLU",
        Activation::Sine => "sine",
        Activation::Identity => "linear",
    }
}

/// The first lines of a page about a surrogate that is rejected; empty of another one.
pub fn rejection(verdict: &Verdict) -> String {
    if verdict.accepted {
        return String::new();
    }
    let problems: String = verdict.problems.iter().map(|problem| format!("<li>{}</li>\n", escape(problem))).collect();
    format!("<p><strong>Rejected: this surrogate is not good enough to be used.</strong></p>\n<ul>\n{problems}</ul>\n")
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
