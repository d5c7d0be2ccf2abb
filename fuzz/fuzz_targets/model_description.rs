//! Whatever the bytes of a modelDescription.xml, reading it ends with a description or a problem; and one without a problem
//! is written as something that reads the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use metafmu::fmi::xml;

fuzz_target!(|bytes: &[u8]| {
    let Ok(document) = xml::read(bytes) else { return };
    if document.problems.is_empty() {
        let written = xml::write(&document.description);
        let again = xml::read(written.as_bytes()).expect("what was written can be read");
        // as text: a NaN is not equal to itself
        assert_eq!(format!("{:?}", again.description), format!("{:?}", document.description));
    }
});
