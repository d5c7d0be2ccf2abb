//! Text for web pages.

use crate::evaluation::{Grade, Verdict};

/// Colors and the verdict, on all pages.
pub const LOOK: &str = include_str!("look.css");

/// Text with the characters that mean something in HTML and SVG replaced.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// First lines of a page about a surrogate: the verdict, and at most this many of its [`reasons`].
pub fn verdict(verdict: &Verdict, most: usize) -> String {
    let (class, word) = match verdict.grade {
        Grade::Good => ("good", "Good"),
        Grade::Usable => ("usable", "Usable"),
        Grade::Rejected => ("rejected", "Rejected"),
    };
    let title = verdict.title();
    let text = title.split_once(": ").map_or(title, |(_, text)| text);
    let all = reasons(verdict);
    let shown = all.iter().take(most).map(|line| format!("<li>{line}</li>\n"));
    let more = all.len().saturating_sub(most);
    let more = (more > 0).then(|| format!("<li><a href=\"#verdict\">{more} more lines</a></li>\n"));
    let lines: String = shown.chain(more).collect();
    let list = if lines.is_empty() { String::new() } else { format!("<ul>\n{lines}</ul>\n") };
    format!("<div class=\"verdict {class}\"><p><strong>{word}</strong>: {}.</p>\n{list}</div>\n", escape(text))
}

/// Reasons of a verdict as HTML, a line each, then notes, then what may help.
pub fn reasons(verdict: &Verdict) -> Vec<String> {
    let reasons = verdict.reasons().iter().map(|reason| escape(&reason.to_string()));
    let notes = verdict.notes.iter().map(|note| format!("Note: {}", escape(&note.to_string())));
    let advice = verdict.advice.iter().map(|advice| format!("Try: {}", escape(advice)));
    reasons.chain(notes).chain(advice).collect()
}
