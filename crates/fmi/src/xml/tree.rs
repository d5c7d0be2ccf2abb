//! An XML document as a tree of elements with line numbers.

use super::XmlProblem;
use quick_xml::{
    Reader, XmlVersion,
    events::{BytesStart, Event},
};
use std::borrow::Cow;

/// Elements nest about six deep in a modelDescription.xml; annotations may go deeper.
const MAX_DEPTH: usize = 200;

/// One element; text between elements is not kept, FMI has none.
#[derive(Debug)]
pub struct Element {
    /// Its tag.
    pub name: String,
    /// Names and values, in the order of the document.
    pub attributes: Vec<(String, String)>,
    /// The elements in it.
    pub children: Vec<Element>,
    /// Line in the document, counted from 1.
    pub line: usize,
}

impl Element {
    /// Value of an attribute.
    pub fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// The first child of a name.
    pub fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// The children of the child of that name; none if there is no such child.
    pub fn list(&self, name: &str) -> impl Iterator<Item = &Self> {
        self.child(name).into_iter().flat_map(|list| &list.children)
    }

    /// Parses a document; the error says where it stops being XML.
    pub fn parse(text: &str) -> Result<Self, XmlProblem> {
        let mut lines = text.lines().zip(1..);
        if let Some((found, line)) =
            lines.find_map(|(text, line)| Some((text.chars().find(|&character| !is_char(character))?, line)))
        {
            return Err(XmlProblem::unusable(line, forbidden(found)));
        }
        let mut reader = Reader::from_str(text);
        reader.config_mut().expand_empty_elements = true;
        let mut lines = LineCounter { text: text.as_bytes(), position: 0, line: 1 };
        let mut open: Vec<Self> = Vec::new();
        let mut root = None;
        loop {
            let start = reader.buffer_position();
            let event = reader.read_event().map_err(|error| {
                let line = lines.at(reader.error_position());
                XmlProblem::unusable(line, format!("not well-formed XML: {error}"))
            })?;
            match event {
                Event::Start(tag) => {
                    let line = lines.at(start);
                    if open.len() == MAX_DEPTH {
                        return Err(XmlProblem::unusable(line, format!("elements are nested deeper than {MAX_DEPTH}")));
                    }
                    if root.is_some() {
                        return Err(XmlProblem::unusable(line, "not well-formed XML: a second root element".into()));
                    }
                    open.push(Self::from_tag(&tag, line)?);
                }
                Event::End(_) => {
                    // quick-xml has checked that end tags match start tags
                    let Some(element) = open.pop() else { continue };
                    match open.last_mut() {
                        Some(parent) => parent.children.push(element),
                        None => root = Some(element),
                    }
                }
                Event::Eof => break,
                _ => {}
            }
        }
        let line = lines.at(text.len() as u64);
        if let Some(element) = open.pop() {
            let message = format!("not well-formed XML: <{}> of line {} is never closed", element.name, element.line);
            return Err(XmlProblem::unusable(line, message));
        }
        root.ok_or_else(|| XmlProblem::unusable(line, "not well-formed XML: no root element".into()))
    }

    fn from_tag(tag: &BytesStart, line: usize) -> Result<Self, XmlProblem> {
        let mut attributes = Vec::new();
        for attribute in tag.attributes() {
            let attribute = attribute.map_err(|error| malformed(tag, line, &error))?;
            let value = attribute.normalized_value(XmlVersion::Explicit1_0);
            let value = value.map_err(|error| malformed(tag, line, &error))?;
            // by way of a character reference
            if let Some(found) = value.chars().find(|&character| !is_char(character)) {
                return Err(XmlProblem::unusable(line, forbidden(found)));
            }
            attributes.push((attribute.key.as_ref().to_owned(), value.into_owned()));
        }
        Ok(Self { name: tag.name().as_ref().to_owned(), attributes, children: Vec::new(), line })
    }
}

fn malformed(tag: &BytesStart, line: usize, reason: &dyn std::fmt::Display) -> XmlProblem {
    XmlProblem::unusable(line, format!("not well-formed XML: <{}>: {reason}", tag.name().as_ref()))
}

/// Returns true if XML 1.0 allows this character (production `Char`).
fn is_char(character: char) -> bool {
    matches!(character, '\t' | '\n' | '\r' | ' '..='\u{fffd}' | '\u{10000}'..)
}

fn forbidden(found: char) -> String {
    format!("not well-formed XML: the character U+{:04X} is not allowed", u32::from(found))
}

/// Counter that turns growing byte positions into line numbers, reading the text once.
struct LineCounter<'a> {
    text: &'a [u8],
    position: usize,
    line: usize,
}

impl LineCounter<'_> {
    fn at(&mut self, position: u64) -> usize {
        let position = (position as usize).clamp(self.position, self.text.len());
        self.line += self.text[self.position..position].iter().filter(|&&byte| byte == b'\n').count();
        self.position = position;
        self.line
    }
}

/// The text of a document. The standard requires UTF-8; Latin-1 occurs in old FMUs and is decoded as well.
pub fn decode(bytes: &[u8]) -> Result<Cow<'_, str>, XmlProblem> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let error = match str::from_utf8(bytes) {
        Ok(text) => return Ok(text.into()),
        Err(error) => error,
    };
    let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
    let declaration = bytes.split(|&byte| byte == b'>').next().unwrap_or_default().to_ascii_lowercase();
    let latin_1: [&[u8]; 2] = [b"iso-8859-1", b"windows-1252"];
    if latin_1.iter().any(|name| declaration.windows(name.len()).any(|part| part == *name)) {
        return Ok(bytes.iter().map(|&byte| char::from(byte)).collect::<String>().into());
    }
    Err(XmlProblem::unusable(line, "not in the encoding UTF-8".into()))
}
