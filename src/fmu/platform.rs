//! Platforms, and the folders FMI 2.0 gives their binaries.

/// Where in an FMU the binary for a platform is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Platform {
    /// Folder within `binaries/`.
    pub folder: &'static str,
    /// Extension of shared libraries.
    pub extension: &'static str,
}

impl Platform {
    /// The platform this program was built for.
    ///
    /// FMI 2.0 names folders for x86 only; others are called as in FMI 3.0, which is what other tools do.
    pub const CURRENT: Self = {
        const LINUX: &str = "so";
        if cfg!(all(target_os = "linux", target_arch = "x86_64")) {
            Self { folder: "linux64", extension: LINUX }
        } else if cfg!(all(target_os = "linux", target_arch = "x86")) {
            Self { folder: "linux32", extension: LINUX }
        } else if cfg!(all(target_os = "linux", target_arch = "aarch64")) {
            Self { folder: "aarch64-linux", extension: LINUX }
        } else if cfg!(all(windows, target_arch = "x86_64")) {
            Self { folder: "win64", extension: "dll" }
        } else if cfg!(all(windows, target_arch = "aarch64")) {
            Self { folder: "aarch64-windows", extension: "dll" }
        } else if cfg!(target_os = "macos") {
            Self { folder: "darwin64", extension: "dylib" }
        } else {
            Self { folder: "other", extension: LINUX }
        }
    };

    /// Name of the archive entry that holds the binary.
    pub fn binary(self, model_identifier: &str) -> String {
        format!("binaries/{}/{model_identifier}.{}", self.folder, self.extension)
    }
}
