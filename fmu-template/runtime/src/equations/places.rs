//! Table of earlier entries, used while an FMU is instantiated.

use std::{
    collections::HashMap,
    hash::{BuildHasherDefault, Hasher},
};

/// Position of an entry by its key. One type for all uses, since each type of table is 1.5 kB of every FMU.
pub(crate) type PlaceTable = HashMap<[u32; 3], u32, BuildHasherDefault<QuickHasher>>;

/// Hash of keys from a checked file: fast, as there are many, and not made to withstand an attack.
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
