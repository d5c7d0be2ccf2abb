//! Binaries that go into an FMU: those built with this program, and others that a user adds.

use crate::{
    Error, Result,
    diagnostics::names::{did_you_mean, listed},
    fmi::{Platform, platform::platforms_of},
    reading,
};
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
        metafmu_libraries::LIBRARIES
            .iter()
            .filter_map(|&(tuple, bytes)| Some(Self { platform: Platform::from_tuple(tuple)?, bytes: bytes.into() }))
            .collect()
    }

    /// The embedded library for a platform.
    ///
    /// # Errors
    /// [`Error::UnknownPlatform`]; [`Error::NotEmbedded`] with the embedded platforms.
    pub fn of_platform(tuple: &str) -> Result<Self> {
        if Platform::from_tuple(tuple).is_none() {
            return Err(Error::UnknownPlatform { tuple: tuple.into(), expected: expected_tuple(tuple) });
        }
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
        let platform = Platform::from_tuple(tuple)
            .ok_or_else(|| wrong(format!("platform `{tuple}` is not known, expected {}", expected_tuple(tuple))))?;
        let bytes = reading::read(path, reading::MAX_WHOLE).map_err(Error::io(path, "read"))?;
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

/// The tuple of a platform that is named as its folder in FMI 2.0, for instance `linux64`; else all tuples.
fn expected_tuple(name: &str) -> String {
    match Platform::ALL.iter().find(|platform| platform.folder_2 == name) {
        Some(platform) => format!("the tuple `{}`", platform.tuple),
        None => {
            let known: Vec<&str> = Platform::ALL.iter().map(|platform| platform.tuple).collect();
            format!("one of {}{}", listed(&known), did_you_mean(name, known.iter().copied()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_library_for_this_platform_is_embedded() {
        let own = Binary::of_platform(Platform::CURRENT.tuple).unwrap();
        assert_eq!(platforms_of(&own.bytes), [Platform::CURRENT.tuple]);
        for (name, says) in [
            ("amiga", "platform `amiga` is not known, expected one of x86_64-linux, "),
            ("linux64", "platform `linux64` is not known, expected the tuple `x86_64-linux`"),
            ("x86_64_linux", "did you mean `x86_64-linux`?"),
        ] {
            let message = Binary::of_platform(name).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
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
