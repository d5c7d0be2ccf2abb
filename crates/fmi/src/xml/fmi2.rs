//! modelDescription.xml of FMI 2.0.

mod reader;
mod schema;
mod writer;

pub use reader::{read, variables};
pub use writer::write;
