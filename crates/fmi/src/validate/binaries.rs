//! Checks the shared libraries of all platforms by their names and headers; nothing is loaded.

use super::{Area, Report};
use crate::{
    Archive, Error, FmiVersion, ModelDescription, Platform, model_description::InterfaceCapabilities,
    platform::platforms_of,
};
use std::collections::BTreeMap;

/// Bytes of a library that its headers are in.
const HEADERS: u64 = 1 << 16;

/// Names of the files in each folder of `binaries/`.
type Folders = BTreeMap<String, Vec<String>>;

/// Interface that an FMU offers.
struct OfferedInterface<'a> {
    /// Its name for people.
    name: &'static str,
    capabilities: &'a InterfaceCapabilities,
}

/// Reports libraries that no host finds, and those that cannot be for the platform of their folder.
pub fn check(archive: &mut Archive, description: &ModelDescription, report: &mut Report) {
    // an archive whose directory cannot be read has been reported
    let Ok(entries) = archive.entries() else { return };
    let names: Vec<String> = entries.into_iter().map(|entry| entry.name.replace('\\', "/")).collect();
    check_sources(&names, description, report);
    let folders = folders(&names);
    for (folder, files) in &folders {
        let platforms: Vec<Platform> =
            Platform::ALL.into_iter().filter(|platform| platform.folder(description.fmi_version) == folder).collect();
        match platforms.first() {
            Some(platform) => {
                check_folder(archive, description, &Folder { name: folder, files, platform: *platform }, report);
            }
            None => check_unknown(folder, description.fmi_version, &folders, report),
        }
    }
}

/// Files of `binaries/` by folder.
fn folders(names: &[String]) -> Folders {
    let mut folders = Folders::new();
    for name in names {
        let file = name.strip_prefix("binaries/").and_then(|rest| rest.split_once('/'));
        if let Some((folder, file)) = file.filter(|(_, file)| !file.is_empty()) {
            folders.entry(folder.to_owned()).or_default().push(file.to_owned());
        }
    }
    folders
}

/// The interfaces of an FMU.
fn offered(description: &ModelDescription) -> impl Iterator<Item = OfferedInterface<'_>> {
    let co_simulation = description.co_simulation.as_ref().map(|offered| &offered.interface);
    let model_exchange = description.model_exchange.as_ref().map(|offered| &offered.interface);
    let all = [
        ("co-simulation", co_simulation),
        ("model exchange", model_exchange),
        ("scheduled execution", description.scheduled_execution.as_ref()),
    ];
    all.into_iter().filter_map(|(name, capabilities)| Some(OfferedInterface { name, capabilities: capabilities? }))
}

/// A folder of a known platform.
struct Folder<'a> {
    name: &'a str,
    files: &'a [String],
    platform: Platform,
}

fn check_folder(archive: &mut Archive, description: &ModelDescription, folder: &Folder, report: &mut Report) {
    let mut checked: Vec<String> = Vec::new();
    for OfferedInterface { name, capabilities } in offered(description) {
        let identifier = &capabilities.model_identifier;
        let file = format!("{identifier}.{}", folder.platform.extension);
        // an empty identifier has been reported
        if identifier.is_empty() || checked.contains(&file) {
            continue;
        }
        if folder.files.contains(&file) {
            let entry = format!("binaries/{}/{file}", folder.name);
            if let Some(problem) = library_problem(archive, &entry, folder) {
                report.problem(Area::Binary, format!("`{entry}`: {problem}"));
            }
        } else {
            report.problem(Area::Binary, missing_library(folder, &file, name, identifier));
        }
        checked.push(file);
    }
}

/// Message about a library that hosts do not find.
fn missing_library(folder: &Folder, file: &str, interface: &str, identifier: &str) -> String {
    let extension = format!(".{}", folder.platform.extension);
    let libraries: Vec<String> =
        folder.files.iter().filter(|name| name.ends_with(&extension)).map(|name| format!("`{name}`")).collect();
    let found = if libraries.is_empty() { "no library".into() } else { libraries.join(", ") };
    let case = folder.files.iter().any(|name| name.eq_ignore_ascii_case(file));
    let hint = if case { "; names that differ in case are different files" } else { "" };
    format!(
        "`binaries/{}` has {found}, expected `{file}`: hosts load {interface} by its modelIdentifier \
         \"{identifier}\"{hint}",
        folder.name
    )
}

/// Reason why the library of a folder cannot be loaded on its platform, as far as headers tell.
fn library_problem(archive: &mut Archive, entry: &str, folder: &Folder) -> Option<String> {
    let bytes = match archive.read_start(entry, HEADERS) {
        Ok(bytes) => bytes,
        Err(Error::ArchiveEntry { problem, .. }) => return Some(problem),
        Err(error) => return Some(error.to_string()),
    };
    let found = platforms_of(&bytes);
    let expected: Vec<&str> = Platform::ALL
        .into_iter()
        .filter(|platform| [platform.tuple, platform.folder_2].contains(&folder.name))
        .map(|platform| platform.tuple)
        .collect();
    let is_for = expected.join(" or ");
    if bytes.is_empty() {
        Some("is empty".into())
    } else if found.is_empty() {
        Some(format!("is no shared library of a known kind (ELF, PE, Mach-O), expected one for {is_for}"))
    } else if expected.iter().any(|tuple| found.contains(tuple)) {
        None
    } else {
        Some(format!("is a library for {}, expected one for {is_for}", found.join(" and ")))
    }
}

/// Reports a folder that hosts of the FMU's version do not search.
fn check_unknown(folder: &str, version: FmiVersion, folders: &Folders, report: &mut Report) {
    let of_other_version =
        Platform::ALL.into_iter().find(|platform| [platform.tuple, platform.folder_2].contains(&folder));
    let same_but_case =
        Platform::ALL.into_iter().find(|platform| platform.folder(version).eq_ignore_ascii_case(folder));
    match of_other_version.or(same_but_case) {
        Some(platform) => {
            let expected = platform.folder(version);
            // a second folder for hosts of the other version does no harm
            if !folders.contains_key(expected) {
                let message = format!("`binaries/{folder}`: hosts of FMI {version} search `binaries/{expected}`");
                report.problem(Area::Binary, message);
            }
        }
        None => report.skipped(format!("`binaries/{folder}`: not a platform that is known here")),
    }
}

/// Reports source files that modelDescription.xml names and the archive lacks.
fn check_sources(names: &[String], description: &ModelDescription, report: &mut Report) {
    for OfferedInterface { name, capabilities } in offered(description) {
        for file in &capabilities.source_files {
            let entry = format!("sources/{file}");
            if !names.contains(&entry) {
                report.problem(Area::Archive, format!("{name} names the source file `{file}`, there is no `{entry}`"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_description::{CoSimulation, ModelExchange};
    use std::io::Write;
    use zip::{ZipWriter, write::SimpleFileOptions};

    /// A description whose co-simulation and model exchange have these identifiers.
    fn described(version: FmiVersion, identifiers: [&str; 2]) -> ModelDescription {
        let [co_simulation, model_exchange] = identifiers.map(|identifier| InterfaceCapabilities {
            model_identifier: identifier.into(),
            ..InterfaceCapabilities::default()
        });
        ModelDescription {
            fmi_version: version,
            co_simulation: Some(CoSimulation { interface: co_simulation, ..CoSimulation::default() }),
            model_exchange: Some(ModelExchange { interface: model_exchange, ..ModelExchange::default() }),
            ..ModelDescription::default()
        }
    }

    /// First bytes of a library for x86-64 Linux, and for x86-64 Windows.
    fn elf() -> Vec<u8> {
        [b"\x7fELF\x02\x01".as_slice(), &[0; 12], &[62, 0]].concat()
    }

    fn pe() -> Vec<u8> {
        [b"MZ".as_slice(), &[0; 58], &[0x40, 0, 0, 0], b"PE\0\0", &[0x64, 0x86]].concat()
    }

    fn problems(description: &ModelDescription, entries: &[(&str, &[u8])]) -> Vec<String> {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut zip = ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, bytes) in entries {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        file.write_all(&zip.finish().unwrap().into_inner()).unwrap();
        let mut report = Report::default();
        check(&mut Archive::open(file.path()).unwrap(), description, &mut report);
        report.problems.into_iter().map(|finding| finding.message).collect()
    }

    #[test]
    fn libraries_that_hosts_find_are_no_problem() {
        let (elf, pe) = (elf(), pe());
        let both = described(FmiVersion::V2, ["a", "b"]);
        let files = [("binaries/linux64/a.so", &*elf), ("binaries/linux64/b.so", &elf), ("binaries/win64/a.dll", &pe)];
        let files = [&files[..], &[("binaries/win64/b.dll", &pe), ("binaries/win64/other.dll", b"")]].concat();
        assert_eq!(problems(&both, &files), [""; 0]);
        let third = described(FmiVersion::V3, ["a", "a"]);
        let files = [("binaries/x86_64-linux/a.so", &*elf), ("binaries/linux64/a.so", &elf), ("binaries/odd/x", b"")];
        assert_eq!(problems(&third, &files), [""; 0]);
    }

    #[test]
    fn libraries_that_no_host_finds_are_problems_on_every_platform() {
        let (elf, pe) = (elf(), pe());
        let second = described(FmiVersion::V2, ["A_B", "A_B"]);
        let because = "hosts load co-simulation by its modelIdentifier \"A_B\"";
        for (entry, bytes, expected) in [
            ("binaries/linux64/A.B.so", &elf, format!("`binaries/linux64` has `A.B.so`, expected `A_B.so`: {because}")),
            ("binaries/win64/A.B.dll", &pe, format!("`binaries/win64` has `A.B.dll`, expected `A_B.dll`: {because}")),
            (
                "binaries/linux64/A_B.dll",
                &pe,
                format!("`binaries/linux64` has no library, expected `A_B.so`: {because}"),
            ),
            (
                "binaries/linux64/a_b.so",
                &elf,
                format!(
                    "`binaries/linux64` has `a_b.so`, expected `A_B.so`: {because}; names that differ in case are \
                     different files"
                ),
            ),
            (
                "binaries/x86_64-linux/A_B.so",
                &elf,
                "`binaries/x86_64-linux`: hosts of FMI 2.0 search `binaries/linux64`".into(),
            ),
            ("binaries/Linux64/A_B.so", &elf, "`binaries/Linux64`: hosts of FMI 2.0 search `binaries/linux64`".into()),
        ] {
            assert_eq!(problems(&second, &[(entry, bytes)]), [expected]);
        }
        let third = described(FmiVersion::V3, ["a", "a"]);
        assert_eq!(
            problems(&third, &[("binaries/win64/a.dll", &pe)]),
            ["`binaries/win64`: hosts of FMI 3.0 search `binaries/x86_64-windows`"]
        );
    }

    #[test]
    fn each_interface_has_its_own_library() {
        let elf = elf();
        assert_eq!(
            problems(&described(FmiVersion::V2, ["a", "b"]), &[("binaries/linux64/a.so", &elf)]),
            ["`binaries/linux64` has `a.so`, expected `b.so`: hosts load model exchange by its modelIdentifier \"b\""]
        );
    }

    #[test]
    fn libraries_of_another_platform_or_of_none_are_problems() {
        let description = described(FmiVersion::V2, ["a", "a"]);
        for (bytes, expected) in [
            (pe(), "`binaries/linux64/a.so`: is a library for x86_64-windows, expected one for x86_64-linux"),
            (Vec::new(), "`binaries/linux64/a.so`: is empty"),
            (
                b"#!/bin/sh".to_vec(),
                "`binaries/linux64/a.so`: is no shared library of a known kind (ELF, PE, Mach-O), expected one for \
                 x86_64-linux",
            ),
        ] {
            assert_eq!(problems(&description, &[("binaries/linux64/a.so", &bytes)]), [expected]);
        }
        // hosts on both processors of darwin search one folder
        let darwin = b"\xcf\xfa\xed\xfe\x0c\0\0\x01";
        assert_eq!(problems(&description, &[("binaries/darwin64/a.dylib", darwin)]), [""; 0]);
    }

    #[test]
    fn missing_source_files_are_problems() {
        let mut description = described(FmiVersion::V2, ["a", "a"]);
        description.co_simulation.as_mut().unwrap().interface.source_files = vec!["a.c".into(), "b.c".into()];
        assert_eq!(
            problems(&description, &[("sources/a.c", b"")]),
            ["co-simulation names the source file `b.c`, there is no `sources/b.c`"]
        );
    }
}
