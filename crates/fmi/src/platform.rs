//! Platforms, and the folders of an FMU that their binaries are in.

use super::model_description::FmiVersion;

/// A platform that an FMU can have a binary for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Platform {
    /// Architecture and operating system, as FMI 3.0 names the folder within `binaries/`.
    pub tuple: &'static str,
    /// Folder of FMI 2.0. It names some for x86 only; the others have the names of FMI 3.0, as in third-party tools.
    pub folder_2: &'static str,
    /// Extension of shared libraries.
    pub extension: &'static str,
}

const fn platform(tuple: &'static str, folder_2: &'static str, extension: &'static str) -> Platform {
    Platform { tuple, folder_2, extension }
}

impl Platform {
    /// The platforms that are known.
    pub const ALL: [Self; 8] = [
        platform("x86_64-linux", "linux64", "so"),
        platform("x86-linux", "linux32", "so"),
        platform("aarch64-linux", "aarch64-linux", "so"),
        platform("x86_64-windows", "win64", "dll"),
        platform("x86-windows", "win32", "dll"),
        platform("aarch64-windows", "aarch64-windows", "dll"),
        platform("x86_64-darwin", "darwin64", "dylib"),
        // hosts of either processor look into darwin64
        platform("aarch64-darwin", "darwin64", "dylib"),
    ];

    /// The platform this program was built for.
    pub const CURRENT: Self = {
        if cfg!(all(target_os = "linux", target_arch = "x86_64")) {
            Self::ALL[0]
        } else if cfg!(all(target_os = "linux", target_arch = "x86")) {
            Self::ALL[1]
        } else if cfg!(all(target_os = "linux", target_arch = "aarch64")) {
            Self::ALL[2]
        } else if cfg!(all(windows, target_arch = "x86_64")) {
            Self::ALL[3]
        } else if cfg!(all(windows, target_arch = "x86")) {
            Self::ALL[4]
        } else if cfg!(all(windows, target_arch = "aarch64")) {
            Self::ALL[5]
        } else if cfg!(all(target_os = "macos", target_arch = "x86_64")) {
            Self::ALL[6]
        } else if cfg!(target_os = "macos") {
            Self::ALL[7]
        } else {
            platform("other", "other", "so")
        }
    };

    /// The platform of that name, for instance `x86_64-linux`.
    pub fn from_tuple(tuple: &str) -> Option<Self> {
        Self::ALL.into_iter().chain([Self::CURRENT]).find(|platform| platform.tuple == tuple)
    }

    /// Folder within `binaries/`.
    pub fn folder(self, version: FmiVersion) -> &'static str {
        match version {
            FmiVersion::V2 => self.folder_2,
            FmiVersion::V3 => self.tuple,
        }
    }

    /// Name of the archive entry that holds the binary.
    pub fn binary(self, version: FmiVersion, model_identifier: &str) -> String {
        format!("binaries/{}/{model_identifier}.{}", self.folder(version), self.extension)
    }
}

/// The platforms that a library is for, by its first bytes; none if it is no library of a known kind.
///
/// Layouts: System V ABI, "ELF Header"; Microsoft PE format, "COFF File Header"; Apple's `mach-o/loader.h` and
/// `mach-o/fat.h`.
pub fn platforms_of(bytes: &[u8]) -> Vec<&'static str> {
    let found = if bytes.starts_with(b"\x7fELF") {
        match little_endian(bytes, 18, 2) {
            Some(62) => &["x86_64-linux"][..],
            Some(3) => &["x86-linux"],
            Some(183) => &["aarch64-linux"],
            _ => &[],
        }
    } else if bytes.starts_with(b"MZ") {
        let header = little_endian(bytes, 0x3c, 4).map_or(0, |place| place as usize);
        match (field(bytes, header, 4), header.checked_add(4).and_then(|place| little_endian(bytes, place, 2))) {
            (Some(b"PE\0\0"), Some(0x8664)) => &["x86_64-windows"][..],
            (Some(b"PE\0\0"), Some(0x14c)) => &["x86-windows"],
            (Some(b"PE\0\0"), Some(0xaa64)) => &["aarch64-windows"],
            _ => &[],
        }
    } else if bytes.starts_with(b"\xcf\xfa\xed\xfe") {
        return little_endian(bytes, 4, 4).and_then(darwin).into_iter().collect();
    } else if bytes.starts_with(b"\xca\xfe\xba\xbe") {
        // several architectures in one file, each announced by 20 bytes
        let count = big_endian(bytes, 4).unwrap_or(0).min(16) as usize;
        return (0..count).filter_map(|index| darwin(big_endian(bytes, 8 + 20 * index)?)).collect();
    } else {
        &[]
    };
    found.to_vec()
}

fn field(bytes: &[u8], place: usize, length: usize) -> Option<&[u8]> {
    bytes.get(place..place.checked_add(length)?)
}

fn little_endian(bytes: &[u8], place: usize, length: usize) -> Option<u64> {
    Some(field(bytes, place, length)?.iter().rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
}

/// A number of four bytes, the highest one first.
fn big_endian(bytes: &[u8], place: usize) -> Option<u64> {
    Some(field(bytes, place, 4)?.iter().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
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
}
