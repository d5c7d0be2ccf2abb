//! The table of what was written before, while an FMU is instantiated.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

/// Places by what they have, in three numbers: one type for all, since each type of table is a kilobyte and a half of every FMU.
pub(crate) type PlaceTable = HashMap<[u32; 3], u32, BuildHasherDefault<QuickHasher>>;

/// Places and bits of numbers from a checked file are no place for an attack, and there are many when an FMU is instantiated.
#[derive(Debug, Default)]
pub(crate) struct QuickHasher(u64);

impl Hasher for QuickHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u64(&mut self, word: u64) {
        // the odd number next to 2^64 over the golden ratio
        self.0 = (self.0.rotate_left(29) ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 ^= self.0 >> 32;
    }
}
