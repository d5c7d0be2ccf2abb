//! The folder of resources. The argument is a URI by RFC 3986 in FMI 2.0, `file:` with an absolute path, and a native path in FMI 3.0. Some
//! hosts pass the one where the standard has the other, or the folder of the whole FMU.

use std::path::{Path, PathBuf};

/// Why a resource location is of no use.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum LocationError {
    #[error("resource location `{uri}` is no file URI, expected one like file:///tmp/fmu/resources")]
    Scheme { uri: String },
    #[error("resource location `{uri}` is on host `{host}`, expected this machine")]
    Host { uri: String, host: String },
    #[error("resource location `{uri}` has no absolute path, expected one like file:///tmp/fmu/resources")]
    Relative { uri: String },
    #[error("resource location `{uri}`: `%` is not followed by two hexadecimal digits")]
    Escape { uri: String },
    #[error("resource location `{uri}`: the path is not UTF-8 after decoding")]
    NotUtf8 { uri: String },
}

/// The folder that an absolute file URI or an absolute path names.
///
/// # Errors
/// A [`LocationError`] that quotes the URI.
pub(crate) fn directory(location: &str) -> Result<PathBuf, LocationError> {
    if Path::new(location).is_absolute() {
        return Ok(PathBuf::from(location));
    }
    path(location, cfg!(windows)).map(PathBuf::from)
}

/// The folder that a native path or a file URI names.
///
/// # Errors
/// A [`LocationError`] that quotes the URI.
pub(crate) fn native(location: &str) -> Result<PathBuf, LocationError> {
    let is_uri = location.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("file:"));
    if is_uri { directory(location) } else { Ok(PathBuf::from(location)) }
}

/// The path of a file of the resources, whether the folder is theirs or that of the FMU.
pub(crate) fn file(folder: &Path, name: &str) -> PathBuf {
    let (path, below) = (folder.join(name), folder.join("resources").join(name));
    if !path.exists() && below.exists() { below } else { path }
}

/// `windows` is an argument so that both families of paths are tested on every machine.
fn path(uri: &str, windows: bool) -> Result<String, LocationError> {
    let (scheme, rest) = uri.split_once(':').ok_or_else(|| LocationError::Scheme { uri: uri.to_owned() })?;
    if !scheme.eq_ignore_ascii_case("file") {
        return Err(LocationError::Scheme { uri: uri.to_owned() });
    }
    let (host, path) = match rest.strip_prefix("//") {
        Some(rest) => rest.split_at(rest.find('/').unwrap_or(rest.len())),
        None => ("", rest),
    };
    let path = decode(path, uri)?;
    if windows && is_drive(host) {
        return Ok(format!("{host}{path}")); // file://C:/folder, one slash short but in use
    }
    if !path.starts_with('/') {
        return Err(LocationError::Relative { uri: uri.to_owned() });
    }
    if !(host.is_empty() || host.eq_ignore_ascii_case("localhost")) {
        if windows {
            return Ok(format!("//{host}{path}")); // a network share
        }
        return Err(LocationError::Host { uri: uri.to_owned(), host: host.to_owned() });
    }
    match path.get(1..3) {
        Some(drive) if windows && is_drive(drive) => Ok(path[1..].to_owned()),
        _ => Ok(path),
    }
}

fn is_drive(text: &str) -> bool {
    matches!(text.as_bytes(), [letter, b':'] if letter.is_ascii_alphabetic())
}

/// Replaces each `%` and its two digits by the byte they stand for.
fn decode(text: &str, uri: &str) -> Result<String, LocationError> {
    let mut parts = text.split('%');
    let mut bytes = parts.next().unwrap_or_default().as_bytes().to_vec();
    for part in parts {
        let digits = part.get(..2).filter(|digits| digits.bytes().all(|digit| digit.is_ascii_hexdigit()));
        let byte = digits.and_then(|digits| u8::from_str_radix(digits, 16).ok());
        bytes.push(byte.ok_or_else(|| LocationError::Escape { uri: uri.to_owned() })?);
        bytes.extend_from_slice(&part.as_bytes()[2..]);
    }
    String::from_utf8(bytes).map_err(|_| LocationError::NotUtf8 { uri: uri.to_owned() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_uris_of_every_habit_are_understood() {
        for (uri, expected) in [
            ("file:/tmp/fmu/resources", "/tmp/fmu/resources"),
            ("file:///tmp/fmu/resources", "/tmp/fmu/resources"),
            ("file:///tmp/fmu/resources/", "/tmp/fmu/resources/"),
            ("file://localhost/tmp/fmu", "/tmp/fmu"),
            ("FILE:///tmp/fmu", "/tmp/fmu"),
            ("file:///tmp/with%20space/%c3%A4%25", "/tmp/with space/ä%"),
            ("file:///tmp/with space", "/tmp/with space"),
            ("file:////tmp/fmu", "//tmp/fmu"),
            ("file:///C:/temp", "/C:/temp"),
        ] {
            assert_eq!(path(uri, false).as_deref(), Ok(expected), "{uri}");
        }
    }

    #[test]
    fn a_path_is_taken_for_a_uri_and_a_uri_for_a_path() {
        let folder = std::env::temp_dir();
        let text = folder.to_str().unwrap();
        assert_eq!(directory(text), Ok(folder.clone()));
        assert_eq!(native(text), Ok(folder.clone()));
        assert_eq!(native("relative/resources"), Ok(PathBuf::from("relative/resources")));
        assert_eq!(native(&crate::testing::uri(&folder)).map(|found| found.join("x")), Ok(folder.join("x")));
        assert!(matches!(native("file:relative"), Err(LocationError::Relative { .. })));
    }

    #[test]
    fn windows_drives_and_shares_are_understood() {
        for (uri, expected) in [
            ("file:///C:/temp/MyFMU/resources", "C:/temp/MyFMU/resources"),
            ("file:/C:/temp/MyFMU/resources/", "C:/temp/MyFMU/resources/"),
            ("file://localhost/d:/temp", "d:/temp"),
            ("file://C:/temp", "C:/temp"),
            ("file:///C%3A/with%20space", "C:/with space"),
            ("file://server/share/fmu", "//server/share/fmu"),
        ] {
            assert_eq!(path(uri, true).as_deref(), Ok(expected), "{uri}");
        }
    }

    #[test]
    fn what_is_no_absolute_file_uri_is_refused_with_the_reason() {
        let uri = || "".to_owned();
        let kind = |error: LocationError| match error {
            LocationError::Scheme { .. } => LocationError::Scheme { uri: uri() },
            LocationError::Host { host, .. } => LocationError::Host { uri: uri(), host },
            LocationError::Relative { .. } => LocationError::Relative { uri: uri() },
            LocationError::Escape { .. } => LocationError::Escape { uri: uri() },
            LocationError::NotUtf8 { .. } => LocationError::NotUtf8 { uri: uri() },
        };
        for (text, expected) in [
            ("", LocationError::Scheme { uri: uri() }),
            ("/tmp/fmu/resources", LocationError::Scheme { uri: uri() }),
            ("http://example.org/resources", LocationError::Scheme { uri: uri() }),
            ("file://elsewhere/tmp", LocationError::Host { uri: uri(), host: "elsewhere".into() }),
            ("file:", LocationError::Relative { uri: uri() }),
            ("file://", LocationError::Relative { uri: uri() }),
            ("file:resources", LocationError::Relative { uri: uri() }),
            ("file:///tmp/50%", LocationError::Escape { uri: uri() }),
            ("file:///tmp/%+1", LocationError::Escape { uri: uri() }),
            ("file:///tmp/%é", LocationError::Escape { uri: uri() }),
            ("file:///tmp/%ff", LocationError::NotUtf8 { uri: uri() }),
        ] {
            assert_eq!(path(text, false).map_err(kind), Err(expected), "{text}");
        }
    }
}
