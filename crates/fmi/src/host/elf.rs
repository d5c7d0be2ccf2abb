//! The one check of an ELF binary that the dynamic loader does not make.

/// Reason why loading a shared library for 64-bit Linux would end the process, if there is one. The loader maps
/// segments without checking the size of the file, and access beyond its end raises SIGBUS. The loader reports all
/// other errors.
///
/// Layout: System V ABI, chapters "ELF Header" and "Program Header".
pub fn cut_short(bytes: &[u8]) -> Option<String> {
    const LITTLE_ENDIAN_64: &[u8] = b"\x7fELF\x02\x01";
    if !bytes.starts_with(LITTLE_ENDIAN_64) {
        return None;
    }
    let size = bytes.len() as u64;
    match end_of_segments(bytes) {
        Some(end) if end <= size => None,
        Some(end) => Some(format!("is cut short: {size} bytes, expected at least {end}")),
        None => Some(format!("is cut short: its {size} bytes end within the headers")),
    }
}

/// End of the headers and of all segments that are loaded; None if the headers are cut.
fn end_of_segments(bytes: &[u8]) -> Option<u64> {
    const LOAD: u64 = 1;
    let (table, entry_size, entries) = (number(bytes, 32, 8)?, number(bytes, 54, 2)?, number(bytes, 56, 2)?);
    let mut end = table.checked_add(entry_size * entries)?;
    for entry in 0..entries {
        let header = table + entry * entry_size;
        if number(bytes, header, 4)? == LOAD {
            end = end.max(number(bytes, header + 8, 8)?.checked_add(number(bytes, header + 32, 8)?)?);
        }
    }
    Some(end)
}

fn number(bytes: &[u8], place: u64, length: u64) -> Option<u64> {
    let field = bytes.get(usize::try_from(place).ok()?..)?.get(..length as usize)?;
    Some(field.iter().rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_library_that_is_cut_anywhere_is_noticed() {
        let (_, library) = metafmu_libraries::LIBRARIES.iter().find(|(tuple, _)| tuple.ends_with("-linux")).unwrap();
        assert_eq!(cut_short(library), None);
        for length in [16, 60, 200, 1000, library.len() / 2] {
            assert!(cut_short(&library[..length]).is_some(), "{length}");
        }
    }

    #[test]
    fn what_is_no_elf_file_is_left_to_the_loader() {
        assert_eq!(cut_short(b""), None);
        assert_eq!(cut_short(b"MZ\x90"), None);
    }
}
