//! Messages of the TOML parser in the vocabulary of the file.

use crate::diagnostics::schema::shortened;

/// A mistake in the syntax: the parser's `message` about `text[start..]`, which is in a value or not.
pub fn of_syntax(message: &str, text: &str, start: usize, in_value: bool) -> String {
    let token = token(text, start);
    let line = line(text, start);
    let values = line.split('=').skip(1).map(|behind| first_word(behind.trim_start()));
    if in_value && let Some((value, number)) = values.filter_map(|value| Some((value, with_point(value)?))).next() {
        return format!("`{value}`: numbers have a decimal point, as in {number}");
    }
    match message {
        "string values must be quoted, expected literal string" if token.is_empty() => {
            format!("no value behind `=`, {VALUE}")
        }
        "string values must be quoted, expected literal string" => format!("`{}`, {VALUE}", rest_of_value(text, start)),
        message if message.starts_with("invalid boolean") => format!("`{token}`, expected true or false"),
        message if message.starts_with("missing escaped value") => {
            "a backslash in double quotes needs a second one; or write the text in single quotes".into()
        }
        message if message.starts_with("invalid basic string") || message.starts_with("invalid literal string") => {
            "the quote is not closed in the line".into()
        }
        message if in_value && NUMBERS.iter().any(|number| message.starts_with(number)) => {
            format!("`{token}`, expected a number such as 0.5, -2 or 1e-3")
        }
        "duplicate key" if token.is_empty() => {
            format!("duplicate key `{}`", first_word(text.get(start..).unwrap_or_default()))
        }
        "duplicate key" => format!("duplicate key `{token}`"),
        message if message.starts_with("key with no value") => "a key without a value, expected `KEY = VALUE`".into(),
        message if message.starts_with("invalid unquoted key") => {
            "a name with other characters than letters of English, digits, `-` and `_` must be in quotes".into()
        }
        message => message.replace('\n', ", "),
    }
}

const VALUE: &str = "expected a number, a text in quotes, true, false, a list in [ ] or a table in { }";

/// Beginnings of the parser's messages about numbers.
const NUMBERS: [&str; 6] = [
    "invalid mantissa",
    "invalid fraction",
    "invalid exponent",
    "invalid float",
    "invalid integer",
    "unexpected leading",
];

/// The characters around a place that a number could have.
fn token(text: &str, at: usize) -> &str {
    let (before, after) = (text.get(..at).unwrap_or_default(), text.get(at..).unwrap_or_default());
    let begin = at - before.rsplit(separates).next().map_or(0, str::len);
    let end = at + after.find(separates).unwrap_or(after.len());
    text.get(begin..end).unwrap_or_default().trim_matches(',')
}

fn separates(c: char) -> bool {
    c.is_whitespace() || "=[]{}#\"'".contains(c)
}

fn line(text: &str, at: usize) -> &str {
    let begin = text.get(..at).and_then(|before| before.rfind('\n')).map_or(0, |index| index + 1);
    text[begin..].lines().next().unwrap_or_default()
}

fn first_word(text: &str) -> &str {
    text.split([' ', '\t', '#', '}']).next().unwrap_or_default().trim_end_matches(',')
}

/// The value up to the comment or the end of the line, at most so much of it as one reads.
fn rest_of_value(text: &str, start: usize) -> String {
    let line = text.get(start..).and_then(|text| text.lines().next()).unwrap_or_default();
    let value = line.split('#').next().unwrap_or_default();
    shortened(value.trim_end_matches([',', ']', '}', ' ', '\t']))
}

/// A number that was written with a decimal comma.
fn with_point(token: &str) -> Option<String> {
    let (whole, part) = token.split_once(',')?;
    let digits = part.starts_with(|c: char| c.is_ascii_digit()) && whole.ends_with(|c: char| c.is_ascii_digit());
    let number = format!("{whole}.{part}");
    (digits && number.parse::<f64>().is_ok()).then_some(number)
}
