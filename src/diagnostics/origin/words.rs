//! What the TOML parser and serde say, in words of the file and not of the program that reads it.

use crate::diagnostics::names::did_you_mean;

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
        "duplicate key" => format!("duplicate key `{token}`"),
        message if message.starts_with("key with no value") => "a key without a value, expected `KEY = VALUE`".into(),
        message if message.starts_with("invalid unquoted key") => {
            "a name with other characters than letters of English, digits, `-` and `_` must be in quotes".into()
        }
        message => message.replace('\n', ", "),
    }
}

const VALUE: &str = "expected a number, a text in quotes, true, false, a list in [ ] or a table in { }";

/// How the parser begins what it says about numbers.
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
    let separates = |c: char| c.is_whitespace() || "=[]{}#\"'".contains(c);
    let (before, after) = (text.get(..at).unwrap_or_default(), text.get(at..).unwrap_or_default());
    let begin = at - before.rsplit(separates).next().map_or(0, str::len);
    let end = at + after.find(separates).unwrap_or(after.len());
    text.get(begin..end).unwrap_or_default().trim_matches(',')
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

fn shortened(text: &str) -> String {
    const MOST: usize = 40;
    match text.char_indices().nth(MOST) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

/// A value of the wrong kind, or a key that is not known: serde's `message` about the piece of text that was `found`.
pub fn of_value(message: &str, found: &str) -> String {
    if message.contains("$__toml_private_datetime") {
        return format!("the date or time {found}, expected a table");
    }
    if let Some((name, known)) = split(message, "unknown field `", "`, expected") {
        let known = in_backquotes(known);
        let suggestion = did_you_mean(name, known.iter().copied());
        return format!("unknown key `{name}`, expected {}{suggestion}", one_of(&known));
    }
    if let Some((name, known)) = split(message, "unknown variant `", "`, expected") {
        let known = in_backquotes(known);
        let suggestion = did_you_mean(name, known.iter().copied()).replace('`', "\"");
        let known: Vec<String> = known.iter().map(|name| format!("\"{name}\"")).collect();
        return format!("\"{name}\", expected {}{suggestion}", one_of(&known));
    }
    if let Some((name, _)) = split(message, "missing field `", "`") {
        return format!("`{name}` is missing");
    }
    if message == "wanted string or table" {
        return format!("{}, expected a text in quotes", kind(found));
    }
    // a table may be all that was expected but for what is in it
    if message.starts_with("expected ") && kind(found) != TABLE {
        return format!("{}, {message}", kind(found));
    }
    if let Some((count, expected)) = split(message, "invalid length ", ", expected ") {
        return match expected.strip_prefix("an array of length ") {
            Some(length) => format!("a list of {count}, expected a list of {length}"),
            None => format!("a list, expected {}", in_words(expected)),
        };
    }
    let mismatch = ["invalid type: ", "invalid value: "].into_iter();
    match mismatch.filter_map(|begin| split(message, begin, ", expected ")).next() {
        Some((unexpected, expected)) => of_mismatch(unexpected, expected, &kind(found)),
        None => message.replace('\n', ", "),
    }
}

/// What serde found, what it expected, and what stands in the file.
fn of_mismatch(unexpected: &str, expected: &str, found: &str) -> String {
    let words = in_words(expected);
    let is_whole = expected.len() <= 5 && expected.starts_with(['u', 'i']);
    let number = found.trim_matches(['"', '\'']).parse::<f64>();
    match (unexpected.split(' ').next(), number) {
        (Some("string"), Ok(number)) if words == NUMBER => {
            format!("{found}, expected a number: {number} without quotes")
        }
        (Some("floating"), _) if is_whole => {
            format!("{found}, expected {words}, without a point and without an exponent")
        }
        (Some("integer"), _) if is_whole && unexpected.ends_with("128") => {
            format!("{found}, expected a smaller number")
        }
        _ => format!("{found}, expected {words}"),
    }
}

/// What is between two pieces of a message that begins with the first, and what is behind the second, the last of its kind.
fn split<'a>(message: &'a str, begin: &str, then: &str) -> Option<(&'a str, &'a str)> {
    message.strip_prefix(begin)?.rsplit_once(then)
}

fn in_backquotes(list: &str) -> Vec<&str> {
    list.split('`').skip(1).step_by(2).collect()
}

fn one_of<S: AsRef<str>>(known: &[S]) -> String {
    let known: Vec<&str> = known.iter().map(AsRef::as_ref).collect();
    match known.as_slice() {
        [] => "none".into(),
        [one] => (*one).to_owned(),
        [one, other] => format!("{one} or {other}"),
        all => format!("one of {}", all.join(", ")),
    }
}

const TABLE: &str = "a table";
const NUMBER: &str = "a number";

/// A piece of a file, or what it is.
fn kind(found: &str) -> String {
    if found.starts_with('[') {
        "a list".into()
    } else if found.starts_with('{') || found.is_empty() {
        TABLE.into()
    } else {
        shortened(found.lines().next().unwrap_or_default())
    }
}

/// What serde expects.
fn in_words(expected: &str) -> &str {
    match expected {
        "f32" | "f64" => NUMBER,
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number of at least 0",
        "a boolean" => "true or false",
        "a string" => "a text in quotes",
        "path string" => "the name of a file in quotes",
        "a sequence" => "a list in [ ]",
        "an array of length 2" => "a list of 2",
        "a map" => TABLE,
        expected if expected.starts_with("struct ") => TABLE,
        expected => expected,
    }
}
