//! Where a study or mechanism comes from: finds the line of a dotted key, so that mistakes can be located.

mod words;

use super::{
    KeyProblem, Problems,
    kinds::{self, FileKind},
    problem::Problem,
    schema::{self, Formats},
};
use crate::{Error, Result, reading};
use serde::de::DeserializeOwned;
use std::{
    borrow::Cow,
    ops::Range,
    path::{Path, PathBuf},
};
use toml::{Spanned, de::DeTable, de::DeValue};

/// Reads a text file; `expected` says what should be in it, for instance `a study in TOML`.
///
/// # Errors
/// [`Error::Io`], or [`Error::Study`] if it is something else than text in UTF-8.
pub fn read(path: &Path, expected: &str) -> Result<String> {
    let bytes = reading::read(path, reading::MAX_TEXT).map_err(Error::io(path, "read"))?;
    if let Some(kind) = kinds::of(path).filter(|kind| *kind != FileKind::Toml) {
        let message = kind.instead(expected);
        return Err(Error::Study {
            problems: vec![Problem { path: path.to_owned(), line: 1, key: String::new(), message }],
        });
    }
    String::from_utf8(bytes).map_err(|error| {
        let (end, bytes) = (error.utf8_error().valid_up_to(), error.as_bytes());
        let line = bytes[..end].iter().filter(|&&byte| byte == b'\n').count() + 1;
        let found = match bytes {
            [b'P', b'K', 3 | 5, ..] => "an FMU or another zip archive",
            [b'P', b'A', b'R', b'1', ..] => "a table in Parquet",
            [_, _, _, _, _, 0, 0, 0, b'{', ..] => "a model file",
            [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => "text in UTF-16",
            _ => "something else than text in UTF-8",
        };
        let message = format!("{found}, expected {expected}, which is text in UTF-8");
        Error::Study { problems: vec![Problem { path: path.to_owned(), line, key: String::new(), message }] }
    })
}

/// The file a study or mechanism was read from.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    path: PathBuf,
    text: String,
}

impl Origin {
    /// Text of a file; the path is for messages.
    pub fn new(path: &Path, text: &str) -> Self {
        Self { path: path.to_owned(), text: text.to_owned() }
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The text as it was read.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The folder of the file.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Parses the text; mistakes in the syntax are located.
    ///
    /// # Errors
    /// [`Error::Study`] with the first mistake of each line.
    pub fn parse(&self) -> Result<Spanned<DeTable<'_>>> {
        let (root, errors) = DeTable::parse_recoverable(&self.text);
        if errors.is_empty() {
            Ok(root)
        } else {
            Err(Error::Study { problems: self.of_syntax(root.get_ref(), &errors) })
        }
    }

    /// Problems of the structure (unknown and missing keys, values of the wrong type), and the sections that have
    /// problems.
    pub fn structure(
        &self,
        root: &DeTable,
        schema: &serde_json::Value,
        formats: Formats,
    ) -> (Vec<Problem>, Vec<String>) {
        let breaks = self.breaks();
        let (mut problems, mut sections) = (Vec::new(), Vec::new());
        for schema::Mistake { key, offset, message, is_missing } in schema::mistakes(schema, formats, root, &self.text)
        {
            // of a section that is missing the message has the name
            let section =
                if is_missing && key.is_empty() { message.split('`').nth(1) } else { key.split(['.', '[']).next() };
            sections.extend(section.map(str::to_owned).filter(|section| !sections.contains(section)));
            problems.push(Problem { path: self.path.clone(), line: line_of(&breaks, offset), key, message });
        }
        (problems, sections)
    }

    /// Reads a parsed document, whose structure is right, as a `T`.
    ///
    /// # Errors
    /// [`Error::Study`] with the first thing that the type refuses although its schema does not.
    pub fn deserialize<T: DeserializeOwned>(&self, root: Spanned<DeTable<'_>>) -> Result<T> {
        T::deserialize(toml::de::Deserializer::from(root)).map_err(|error: toml::de::Error| {
            let span = error.span().unwrap_or(0..0);
            let (line, message) = (self.line_at(span.start), error.message().replace('\n', ", "));
            Error::Study { problems: vec![Problem { path: self.path.clone(), line, key: self.key_at(&span), message }] }
        })
    }

    /// A problem for each line that is not TOML; only the first if no line is.
    fn of_syntax(&self, root: &DeTable, errors: &[toml::de::Error]) -> Vec<Problem> {
        const MOST: usize = 10;
        let mut problems: Vec<Problem> = Vec::new();
        let starts = errors.iter().map(|error| error.span().map_or(0, |span| span.start));
        // what the parser says after the first mistake in a line is confused
        let mut errors: Vec<(usize, &toml::de::Error)> = starts.zip(errors).collect();
        errors.sort_by_key(|(start, _)| *start);
        for (start, error) in errors {
            let line = self.line_at(start);
            if problems.iter().any(|problem| problem.line == line) {
                continue;
            }
            let key = self.key_in_line(root, line);
            let message = words::of_syntax(error.message(), &self.text, start, !key.is_empty());
            problems.push(Problem { path: self.path.clone(), line, key, message });
        }
        problems.truncate(if root.is_empty() { 1 } else { MOST });
        problems
    }

    /// Dotted key of the first name in a line of a text that may be no TOML as a whole; empty if it is a heading.
    fn key_in_line(&self, root: &DeTable, line: usize) -> String {
        let start = self.text.split_inclusive('\n').take(line - 1).map(str::len).sum::<usize>();
        let text = self.text[start..].lines().next().unwrap_or_default();
        let name = start + (text.len() - text.trim_start().len());
        if text.trim_start().starts_with('[') {
            return String::new();
        }
        innermost(root, "", &(name..name)).map_or(String::new(), |(_, key)| key)
    }

    /// Fails if the text has a section that only files of another kind have.
    pub fn refuse_section(&self, section: &str, message: &str) -> Result<()> {
        let root = DeTable::parse_recoverable(&self.text).0;
        let Some((name, _)) = root.get_ref().get_key_value(section) else { return Ok(()) };
        let line = self.line_at(name.span().start);
        let problem = Problem { path: self.path.clone(), line, key: section.into(), message: message.into() };
        Err(Error::Study { problems: vec![problem] })
    }

    /// Fails if there are problems.
    pub fn refuse(&self, problems: Problems) -> Result<()> {
        if problems.is_empty() {
            return Ok(());
        }
        Err(Error::Study { problems: self.locate(problems) })
    }

    /// Gives problems their lines.
    pub fn locate(&self, problems: Problems) -> Vec<Problem> {
        if problems.is_empty() {
            return Vec::new();
        }
        let root = DeTable::parse(&self.text).ok();
        let breaks = self.breaks();
        let located = problems.into_iter().map(|KeyProblem { key, message }| {
            let offset = root.as_ref().map_or(0, |root| offset_of(root.get_ref(), &key));
            Problem { path: self.path.clone(), line: line_of(&breaks, offset), key, message }
        });
        located.collect()
    }

    /// Byte offsets of the ends of all lines.
    fn breaks(&self) -> Vec<usize> {
        self.text.match_indices('\n').map(|(offset, _)| offset).collect()
    }

    /// Dotted key of the innermost name or value that contains the span; empty if there is none, or if the text is not
    /// TOML.
    fn key_at(&self, span: &Range<usize>) -> String {
        let root = DeTable::parse(&self.text).ok();
        root.and_then(|root| innermost(root.get_ref(), "", span)).map_or(String::new(), |(_, key)| key)
    }

    fn line_at(&self, offset: usize) -> usize {
        self.text.get(..offset).map_or(1, |before| before.matches('\n').count() + 1)
    }
}

/// The line, counted from 1, of a byte offset.
fn line_of(breaks: &[usize], offset: usize) -> usize {
    breaks.partition_point(|&end| end < offset) + 1
}

/// Where the first name of a dotted key may end, the longest one first.
fn ends(key: &str) -> Vec<usize> {
    key.match_indices(['.', '[']).map(|(end, _)| end).chain([key.len()]).rev().collect()
}

/// Byte offset of the longest part of a dotted key, such as `layers[1].weight`, that is in the table.
fn offset_of(root: &DeTable, key: &str) -> usize {
    let (mut table, mut rest, mut offset) = (root, key, 0);
    // variable names may contain dots and brackets, so the longest name that is there counts
    while let Some((name, mut value)) = ends(rest).into_iter().find_map(|end| table.get_key_value(&rest[..end])) {
        offset = name.span().start;
        rest = &rest[name.get_ref().len()..];
        while let Some((element, behind)) = element(value, rest) {
            (value, rest, offset) = (element, behind, element.span().start);
        }
        rest = rest.trim_start_matches('.');
        match Spanned::get_ref(value) {
            DeValue::Table(inner) if !rest.is_empty() => table = inner,
            _ => break,
        }
    }
    offset
}

/// The array element that the rest of a key begins with, for instance `[1]`, and the remainder of the key.
fn element<'a, 'k>(value: &'a Spanned<DeValue<'a>>, rest: &'k str) -> Option<(&'a Spanned<DeValue<'a>>, &'k str)> {
    let (index, behind) = rest.strip_prefix('[')?.split_once(']')?;
    Some((value.get_ref().get(index.parse::<usize>().ok()?)?, behind))
}

/// The shortest span of a name or value in the table that `span` lies in: its length and its dotted key.
fn innermost(table: &DeTable, prefix: &str, span: &Range<usize>) -> Option<(usize, String)> {
    let separator = if prefix.is_empty() { "" } else { "." };
    let of_entries = table.iter().filter_map(|(name, value)| {
        let key = format!("{prefix}{separator}{}", Spanned::<Cow<str>>::get_ref(name));
        let by_name = around(&name.span(), span).map(|length| (length, key.clone()));
        by_name.into_iter().chain(innermost_of_value(value, &key, span)).min_by_key(|(length, _)| *length)
    });
    of_entries.min_by_key(|(length, _)| *length)
}

fn innermost_of_value(value: &Spanned<DeValue>, key: &str, span: &Range<usize>) -> Option<(usize, String)> {
    let inner = match value.get_ref() {
        DeValue::Table(table) => innermost(table, key, span),
        DeValue::Array(elements) => {
            let of_elements = elements
                .iter()
                .enumerate()
                .filter_map(|(index, element)| innermost_of_value(element, &format!("{key}[{index}]"), span));
            of_elements.min_by_key(|(length, _)| *length)
        }
        _ => None,
    };
    // tables with a heading do not enclose their entries, so both are asked; of the same span the inner one counts
    let own = around(&value.span(), span).map(|length| (length, key.to_owned()));
    inner.into_iter().chain(own).min_by_key(|(length, _)| *length)
}

/// Length of `outer` if `inner` lies in it.
fn around(outer: &Range<usize>, inner: &Range<usize>) -> Option<usize> {
    (outer.start <= inner.start && inner.end <= outer.end).then_some(outer.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use indexmap::IndexMap;
    use schemars::JsonSchema;
    use serde::Deserialize;

    #[derive(Debug, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct ExampleFile {
        number: Option<f64>,
        count: Option<usize>,
        text: Option<String>,
        #[schemars(extend("format" = "path"))]
        file: Option<PathBuf>,
        is_on: Option<bool>,
        list: Option<Vec<usize>>,
        vector: Option<[f64; 2]>,
        kind: Option<ExampleMethod>,
        inner: Option<Inner>,
        map: Option<IndexMap<String, f64>>,
    }

    #[derive(Debug, Deserialize, JsonSchema)]
    #[serde(deny_unknown_fields)]
    #[schemars(extend("examples" = [{"min": 0}]))]
    #[allow(dead_code)]
    struct Inner {
        min: f64,
    }

    #[derive(Debug, Deserialize, JsonSchema)]
    #[serde(rename_all = "lowercase")]
    enum ExampleMethod {
        Mesh,
        Random,
        Sobol,
    }

    fn message(text: &str) -> String {
        let origin = Origin::new(Path::new("f.toml"), text);
        let root = match origin.parse() {
            Ok(root) => root,
            Err(error) => return error.to_string(),
        };
        let (problems, _) = origin.structure(root.get_ref(), &schema::of::<ExampleFile>(), |_, _| None);
        // the schema refuses whatever the type does
        assert_eq!(problems.is_empty(), origin.deserialize::<ExampleFile>(root).is_ok(), "{text}");
        problems.iter().map(Problem::to_string).collect::<Vec<_>>().join("\n")
    }

    #[test]
    fn values_of_the_wrong_kind_are_described_in_words_of_the_file() {
        for (text, says) in [
            ("number = 'x'", "f.toml:1: number: 'x', expected a number"),
            ("number = \"1.5\"", "number: \"1.5\", expected a number: 1.5 without quotes"),
            ("number = true", "number: true, expected a number"),
            ("number = 2020-01-01", "number: the date or time 2020-01-01, expected a number"),
            ("number = [1]", "number: a list, expected a number"),
            (
                "count = 1.0",
                "count: 1.0, expected a whole number of at least 0, without a point and without an exponent",
            ),
            (
                "count = 1e3",
                "count: 1e3, expected a whole number of at least 0, without a point and without an exponent",
            ),
            ("count = -1", "count: -1, expected a whole number of at least 0"),
            ("count = 99999999999999999999", "count: 99999999999999999999, expected a smaller number"),
            ("text = 3", "text: 3, expected a text in quotes"),
            ("file = 3", "file: 3, expected the name of a file in quotes"),
            ("is_on = 'yes'", "is_on: 'yes', expected true or false"),
            ("list = 3", "list: 3, expected a list in [ ]"),
            ("list = [1, \"x\"]", "list[1]: \"x\", expected a whole number of at least 0"),
            ("vector = [1]", "vector: a list of 1, expected a list of 2"),
            ("vector = 1", "vector: 1, expected a list of 2"),
            (
                "kind = 'sobl'",
                "kind: \"sobl\", expected one of \"mesh\", \"random\", \"sobol\"; did you mean \"sobol\"?",
            ),
            ("kind = 3", "kind: 3, expected a text in quotes"),
            ("inner = 3", "inner: 3, expected a table such as { min = 0 }"),
            ("inner = 2020-01-01", "inner: the date or time 2020-01-01, expected a table"),
            ("\n[inner]", "f.toml:2: inner: `min` is missing"),
            ("map = 3", "map: 3, expected a table"),
            ("map = { a = 'x' }", "map.a: 'x', expected a number"),
            ("cout = 3", "f.toml:1: cout: unknown key `cout`, expected one of number, count,"),
            ("cout = 3", "; did you mean `count`?"),
            ("inner = { mni = 1 }", "inner.mni: unknown key `mni`, expected min; did you mean `min`?"),
        ] {
            let found = message(text);
            assert!(found.contains(says), "{text}: {found}");
            for word in
                ["usize", "u64", "f64", "struct", "enum", "field", "variant", "invalid type", "sequence", "map,"]
            {
                assert!(!found.contains(word) || found.contains("expected one of number"), "{text}: {found}");
            }
        }
    }

    #[test]
    fn what_is_no_toml_is_located_by_key_and_each_line_is_named_once() {
        for (text, says) in [
            ("number = abc", "f.toml:1: number: `abc`, expected a number, a text in quotes,"),
            ("text = C:\\data.csv  # here", "f.toml:1: text: `C:\\data.csv`, expected a number, a text in quotes,"),
            ("text = \"C:\\data.csv\"", "text: a backslash in double quotes needs a second one"),
            ("number =", "f.toml:1: number: no value behind `=`, expected"),
            ("number = 0,5", "f.toml:1: number: `0,5`: numbers have a decimal point, as in 0.5"),
            ("inner = { min = 0,5 }", "f.toml:1: inner: `0,5`: numbers have a decimal point, as in 0.5"),
            ("number = .5", "number: `.5`, expected a number such as 0.5"),
            ("number = 5.", "number: `5.`, expected a number such as 0.5"),
            ("is_on = True", "is_on: `True`, expected true or false"),
            ("text = \"x", "text: the quote is not closed in the line"),
            ("number = 1\nnumber = 2", "f.toml:2: duplicate key `number`"),
            ("\"a.b\" = 1\n\"a.b\" = 2", "f.toml:2: duplicate key `\"a.b\"`"),
            ("\n[inner\nmin = 1", "f.toml:2: unclosed table, expected `]`"),
            ("dämpfung = 1", "must be in quotes"),
            ("number 3\n[inner]", "f.toml:1: a key without a value, expected `KEY = VALUE`"),
        ] {
            let found = message(text);
            assert!(found.contains(says), "{text}: {found}");
        }
        let both = message("number = abc\ncount = 2\n[inner]\nmin = def");
        assert_eq!(both.lines().count(), 2, "{both}");
        assert!(both.lines().last().unwrap().starts_with("f.toml:4: inner.min: `def`"), "{both}");
        // a table of another tool
        assert_eq!(message("run,time,x\n1,0,2\n1,1,3\n").lines().count(), 1);
    }

    #[test]
    fn what_is_no_text_is_told_by_its_beginning() {
        let folder = tempfile::tempdir().unwrap();
        for (bytes, says) in [
            (b"PK\x03\x04\xff".as_slice(), "f:1: an FMU or another zip archive, expected a study"),
            (b"PAR1\xff", "f:1: a table in Parquet, expected a study"),
            (b"\xf0\x01\0\0\0\0\0\0{\xff", "f:1: a model file, expected a study"),
            (b"\xff\xfen\0", "f:1: text in UTF-16, expected a study, which is text in UTF-8"),
            (b"name = 'x'\n# \xe4", "f:2: something else than text in UTF-8, expected a study"),
        ] {
            std::fs::write(folder.path().join("f"), bytes).unwrap();
            let message = read(&folder.path().join("f"), "a study").unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
