//! Binaries that go into an FMU: those built with this program, and others that a user adds.

use crate::fmi::Platform;
use crate::{Error, Result, diagnostics::names::expected_one_of};
use std::{borrow::Cow, path::Path};

/// The library inside every FMU, for one platform.
#[derive(Clone, Debug)]
pub struct Binary {
    /// Platform that it runs on.
    pub platform: Platform,
    /// The shared library.
    pub bytes: Cow<'static, [u8]>,
}

impl Binary {
    /// The libraries that are embedded in this program.
    pub fn embedded() -> Vec<Self> {
        let binary = |&(tuple, bytes): &(&str, &'static [u8])| {
            Some(Self { platform: Platform::from_tuple(tuple)?, bytes: bytes.into() })
        };
        metafmu_libraries::LIBRARIES.iter().filter_map(binary).collect()
    }

    /// The embedded library for a platform.
    ///
    /// # Errors
    /// [`Error::NotEmbedded`] with the embedded platforms.
    pub fn of_platform(tuple: &str) -> Result<Self> {
        let embedded = Self::embedded();
        let known = embedded.iter().map(|binary| binary.platform.tuple.to_owned()).collect();
        let found = embedded.into_iter().find(|binary| binary.platform.tuple == tuple);
        found.ok_or_else(|| Error::NotEmbedded { tuple: tuple.into(), known })
    }

    /// A library from a file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Binary`] if it is no library for the platform or the platform is not
    /// known.
    pub fn from_file(tuple: &str, path: &Path) -> Result<Self> {
        let wrong = |problem: String| Error::Binary { path: path.to_owned(), problem };
        let platform = Platform::from_tuple(tuple).ok_or_else(|| {
            let known: Vec<&str> = Platform::ALL.iter().map(|platform| platform.tuple).collect();
            wrong(format!("platform `{tuple}` is not known, {}", expected_one_of(tuple, &known)))
        })?;
        let bytes = std::fs::read(path).map_err(Error::io(path, "read"))?;
        let found = platforms_of(&bytes);
        if found.contains(&platform.tuple) {
            return Ok(Self { platform, bytes: bytes.into() });
        }
        Err(wrong(match found.is_empty() {
            true => format!("is no shared library of a known kind (ELF, PE, Mach-O), expected one for {tuple}"),
            false => format!("is a library for {}, expected one for {tuple}", found.join(" and ")),
        }))
    }
}

/// The platforms a library is for; none if it is no library of a known kind.
///
/// Layouts: System V ABI, "ELF Header"; Microsoft PE format, "COFF File Header"; Apple's `mach-o/loader.h` and
/// `mach-o/fat.h`.
fn platforms_of(bytes: &[u8]) -> Vec<&'static str> {
    let part = |place: usize, length: usize| bytes.get(place..place.checked_add(length)?);
    let little = |place: usize, length: usize| {
        let field = part(place, length)?;
        Some(field.iter().rev().fold(0u64, |sum, &byte| sum << 8 | u64::from(byte)))
    };
    let big = |place: usize| part(place, 4).map(|field| field.iter().fold(0u64, |sum, &b| sum << 8 | u64::from(b)));
    let found = if bytes.starts_with(b"\x7fELF") {
        match little(18, 2) {
            Some(62) => &["x86_64-linux"][..],
            Some(3) => &["x86-linux"],
            Some(183) => &["aarch64-linux"],
            _ => &[],
        }
    } else if bytes.starts_with(b"MZ") {
        let header = little(0x3c, 4).map_or(0, |place| place as usize);
        match (part(header, 4), header.checked_add(4).and_then(|place| little(place, 2))) {
            (Some(b"PE\0\0"), Some(0x8664)) => &["x86_64-windows"][..],
            (Some(b"PE\0\0"), Some(0x14c)) => &["x86-windows"],
            (Some(b"PE\0\0"), Some(0xaa64)) => &["aarch64-windows"],
            _ => &[],
        }
    } else if bytes.starts_with(b"\xcf\xfa\xed\xfe") {
        return little(4, 4).and_then(darwin).into_iter().collect();
    } else if bytes.starts_with(b"\xca\xfe\xba\xbe") {
        // several architectures in one file, each announced by 20 bytes
        let count = big(4).unwrap_or(0).min(16) as usize;
        return (0..count).filter_map(|index| darwin(big(8 + 20 * index)?)).collect();
    } else {
        &[]
    };
    found.to_vec()
}

fn darwin(cpu_type: u64) -> Option<&'static str> {
    match cpu_type {
        0x0100_0007 => Some("x86_64-darwin"),
        0x0100_000c => Some("aarch64-darwin"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_tell_the_platform() {
        let elf = |machine: u8| [b"\x7fELF\x02\x01".as_slice(), &[0; 12], &[machine, 0]].concat();
        let pe = |machine: [u8; 2]| [b"MZ".as_slice(), &[0; 58], &[0x40, 0, 0, 0], b"PE\0\0", &machine].concat();
        let fat =
            [b"\xca\xfe\xba\xbe\0\0\0\x02".as_slice(), &[1, 0, 0, 7], &[0; 16], &[1, 0, 0, 12], &[0; 16]].concat();
        for (bytes, expected) in [
            (elf(62), &["x86_64-linux"][..]),
            (elf(183), &["aarch64-linux"]),
            (elf(8), &[]),
            (pe([0x64, 0x86]), &["x86_64-windows"]),
            (pe([0x64, 0xaa]), &["aarch64-windows"]),
            (b"MZ\x90".to_vec(), &[]),
            (b"\xcf\xfa\xed\xfe\x0c\0\0\x01".to_vec(), &["aarch64-darwin"]),
            (fat, &["x86_64-darwin", "aarch64-darwin"]),
            (b"\xca\xfe\xba\xbe\xff\xff\xff\xff".to_vec(), &[]),
            (b"#!/bin/sh".to_vec(), &[]),
            (Vec::new(), &[]),
        ] {
            assert_eq!(platforms_of(&bytes), expected, "{bytes:?}");
        }
    }

    #[test]
    fn the_library_for_this_platform_is_embedded() {
        let own = Binary::of_platform(Platform::CURRENT.tuple).unwrap();
        assert_eq!(platforms_of(&own.bytes), [Platform::CURRENT.tuple]);
        let message = Binary::of_platform("amiga").unwrap_err().to_string();
        assert!(message.starts_with("platform `amiga` is not embedded in this program"), "{message}");
        assert!(message.contains(Platform::CURRENT.tuple), "{message}");
    }

    #[test]
    fn a_file_for_another_platform_is_refused() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &*Binary::of_platform(Platform::CURRENT.tuple).unwrap().bytes).unwrap();
        assert!(Binary::from_file(Platform::CURRENT.tuple, file.path()).is_ok());
        let message = |tuple| Binary::from_file(tuple, file.path()).unwrap_err().to_string();
        assert!(message("x86-windows").ends_with("expected one for x86-windows"));
        assert!(message("amiga").contains("platform `amiga` is not known, expected one of x86_64-linux, "));
    }
}
