//! Names of an FMU's files and functions.

/// A C identifier from a name: other characters become `_`.
pub fn model_identifier(name: &str) -> String {
    let mut identifier: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
    if !identifier.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') {
        identifier.insert(0, '_');
    }
    identifier
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_identifier_is_a_c_identifier() {
        for (name, identifier) in [
            ("pendulum", "pendulum"),
            ("single-pendulum 2", "single_pendulum_2"),
            ("3d", "_3d"),
            ("", "_"),
            ("µ.x", "__x"),
        ] {
            assert_eq!(model_identifier(name), identifier);
        }
    }
}
