//! Where in a table a mistake is.

use std::fmt;

/// Location in a table. Displayed as `line 3` or `row 3`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// A line of text, counted from 1.
    Line(u64),
    /// A row below the header, counted from 1, where there are no lines.
    Row(u64),
    /// The table as a whole, or its header where that is no line.
    Whole,
}

impl Place {
    /// The unit in which the location is counted.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Line(_) => "line",
            Self::Row(_) => "row",
            Self::Whole => "table",
        }
    }

    /// Behind the name of the file: `:3` or `, row 3`.
    pub fn behind_path(self) -> String {
        match self {
            Self::Line(line) => format!(":{line}"),
            Self::Row(row) => format!(", row {row}"),
            Self::Whole => String::new(),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(number) | Self::Row(number) => write!(f, "{} {number}", self.unit()),
            Self::Whole => f.write_str(self.unit()),
        }
    }
}
