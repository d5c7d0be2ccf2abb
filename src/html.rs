//! Text for web pages.

use crate::evaluation::Verdict;

/// Text with the characters that mean something in HTML and SVG replaced.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
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
