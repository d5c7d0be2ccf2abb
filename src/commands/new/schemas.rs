//! JSON schemas beside a new study, with which editors complete and check its files.

use super::{super::json_text, expect_free, print};
use metafmu::{Result, files, multibody, study};
use std::path::{Path, PathBuf};

/// First line of a study with its schema beside it.
pub const OF_STUDY: &str = "#:schema ./study.schema.json\n";

/// First line of a mechanism with its schema beside it.
pub const OF_MECHANISM: &str = "#:schema ./mechanism.schema.json\n";

/// Schema files that are to be written.
#[derive(Default)]
pub struct SchemaFiles(Vec<(PathBuf, String)>);

impl SchemaFiles {
    /// Schemas of a study, and of its mechanism if that is written too, as `metafmu schema` prints them. Identical files are kept.
    ///
    /// # Errors
    /// [`metafmu::Error::Stale`] if there are files with other content.
    pub fn new(folder: &Path, has_mechanism: bool) -> Result<Self> {
        let of_mechanism = has_mechanism.then(|| ("mechanism", multibody::json_schema()));
        let mut found = Self::default();
        for (kind, schema) in [("study", study::json_schema())].into_iter().chain(of_mechanism) {
            let (path, text) = (folder.join(format!("{kind}.schema.json")), json_text(schema)?);
            if std::fs::read(&path).is_ok_and(|there| there == text.as_bytes()) {
                continue;
            }
            expect_free(&path)?;
            found.0.push((path, text));
        }
        Ok(found)
    }

    /// Writes them and prints their paths.
    ///
    /// # Errors
    /// [`metafmu::Error::Io`].
    pub fn write(&self) -> Result<()> {
        for (path, text) in &self.0 {
            files::write_whole(path, text.as_bytes())?;
            print(&format!("{}\n", path.display()))?;
        }
        Ok(())
    }
}
