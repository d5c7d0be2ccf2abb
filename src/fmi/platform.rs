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
