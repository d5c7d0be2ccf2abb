//! Checks the zip archive.

use super::{Area, Report};
use crate::{Archive, archive::Entry};
use std::collections::BTreeSet;

/// Reports what in the archive some host would stumble over.
pub fn check(archive: &mut Archive, report: &mut Report) {
    let entries = match archive.entries() {
        Ok(entries) => entries,
        Err(error) => return report.problem(Area::Archive, error.to_string()),
    };
    if archive.has_duplicates() {
        report.problem(Area::Archive, "two entries have the same name");
    }
    for entry in &entries {
        let problems = [
            entry.name.contains('\\').then_some("has a backslash in its name, expected forward slashes"),
            entry.unsafe_name,
            entry.encrypted.then_some("is encrypted"),
            (!entry.allowed_method).then_some("is neither stored nor deflated"),
        ];
        for problem in problems.into_iter().flatten() {
            report.problem(Area::Archive, format!("entry `{}` {problem}", entry.name));
        }
    }
    if !archive.contains("modelDescription.xml") {
        let named = entries.iter().find(|entry| entry.name.eq_ignore_ascii_case("modelDescription.xml"));
        let misplaced = entries.iter().find(|entry| entry.name.ends_with("/modelDescription.xml"));
        let hint = match (named, misplaced) {
            (Some(entry), _) => format!("; `{}` differs in case", entry.name),
            (None, Some(entry)) => format!("; `{}` is in the wrong place", entry.name),
            (None, None) => String::new(),
        };
        report.problem(Area::Archive, format!("there is no `modelDescription.xml`{hint}"));
    }
    check_folders(&entries, report);
}

/// Folders of the standard that hosts search.
const FOLDERS: [&str; 6] = ["binaries", "documentation", "extra", "resources", "sources", "terminalsAndIcons"];

/// Reports folders whose names differ from those of the standard in case: hosts on Linux do not find them.
fn check_folders(entries: &[Entry], report: &mut Report) {
    let folders: BTreeSet<&str> = entries.iter().filter_map(|entry| Some(entry.name.split_once('/')?.0)).collect();
    for folder in folders {
        let expected = FOLDERS.into_iter().find(|known| *known != folder && known.eq_ignore_ascii_case(folder));
        if let Some(expected) = expected {
            report.problem(Area::Archive, format!("folder `{folder}` differs in case from `{expected}`"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;
    use zip::{ZipWriter, write::SimpleFileOptions};

    fn messages(names: &[&str], change: impl Fn(&mut Vec<u8>)) -> Vec<String> {
        let mut zip = ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for name in names {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        }
        let mut bytes = zip.finish().unwrap().into_inner();
        change(&mut bytes);
        let mut file = tempfile::NamedTempFile::new().unwrap();
        file.write_all(&bytes).unwrap();
        let mut report = Report::default();
        check(&mut Archive::open(file.path()).unwrap(), &mut report);
        report.problems.into_iter().map(|finding| finding.message).collect()
    }

    /// Changes a field in every header: at `local` bytes into local ones, `central` bytes into central ones.
    fn change_headers(bytes: &mut [u8], local: usize, central: usize, value: u8) {
        for place in 0..bytes.len().saturating_sub(4) {
            match &bytes[place..place + 4] {
                b"PK\x03\x04" => bytes[place + local] = value,
                b"PK\x01\x02" => bytes[place + central] = value,
                _ => {}
            }
        }
    }

    #[test]
    fn a_good_archive_has_no_problem() {
        assert_eq!(messages(&["modelDescription.xml", "binaries/linux64/m.so"], |_| {}), [""; 0]);
    }

    #[test]
    fn every_problem_of_an_archive_is_found() {
        assert_eq!(
            messages(&["x/modelDescription.xml", "resources\\a", "../b"], |_| {}),
            [
                "entry `resources\\a` has a backslash in its name, expected forward slashes",
                "entry `../b` leads out of the archive by `..`",
                "there is no `modelDescription.xml`; `x/modelDescription.xml` is in the wrong place",
            ]
        );
    }

    #[test]
    fn names_that_differ_in_case_are_problems() {
        assert_eq!(
            messages(&["ModelDescription.xml", "Binaries/linux64/a.so", "resources/a"], |_| {}),
            [
                "there is no `modelDescription.xml`; `ModelDescription.xml` differs in case",
                "folder `Binaries` differs in case from `binaries`",
            ]
        );
    }

    #[test]
    fn encryption_and_compression_methods_are_looked_at() {
        // general purpose flags and compression method
        let encrypted = messages(&["modelDescription.xml"], |bytes| change_headers(bytes, 6, 8, 1));
        assert_eq!(encrypted, ["entry `modelDescription.xml` is encrypted"]);
        let bzip2 = messages(&["modelDescription.xml"], |bytes| change_headers(bytes, 8, 10, 12));
        assert_eq!(bzip2, ["entry `modelDescription.xml` is neither stored nor deflated"]);
    }

    #[test]
    fn two_entries_of_one_name_are_found() {
        let twice = messages(&["modelDescription.xml", "modelDescription.xmX"], |bytes| {
            bytes.iter_mut().filter(|byte| **byte == b'X').for_each(|byte| *byte = b'l');
        });
        assert_eq!(twice, ["two entries have the same name"]);
    }
}
