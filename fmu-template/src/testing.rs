//! Common part of the tests of both versions: a resource folder, the example's value references, a counting allocator.

#![allow(clippy::undocumented_unsafe_blocks)] // an allocator that passes everything on

use metafmu_example as example;

use metafmu_runtime::{Evaluator, Surrogate};
use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
    ffi::CStr,
    fs,
    path::{Path, PathBuf},
    sync::atomic::{AtomicUsize, Ordering},
};

// value references of the example surrogate
pub(crate) const LENGTH: u32 = 1; // tunable
pub(crate) const SPEED: u32 = 2; // fixed, or an input in `example::with_input`
pub(crate) const TIME: u32 = 3;
pub(crate) const ANGLE: u32 = 4;
pub(crate) const VELOCITY: u32 = 5;
pub(crate) const OUTPUTS: [u32; 2] = [ANGLE, VELOCITY];
pub(crate) const POLICY: u32 = 6;
pub(crate) const IN_DOMAIN: u32 = 7;
pub(crate) const DISTANCE: u32 = 8;
pub(crate) const TOKEN: &CStr = c"{00000000-0000-0000-0000-000000000000}";

/// A folder that is gone with the value; its name has what is awkward in a URI.
pub(crate) struct Folder(pub PathBuf);

impl Folder {
    pub(crate) fn empty() -> Self {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("metafmu template #{} {count} ä", std::process::id()));
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn with(surrogate: &Surrogate) -> Self {
        let folder = Self::empty();
        fs::write(folder.0.join("model.safetensors"), surrogate.to_bytes().unwrap()).unwrap();
        folder
    }

    pub(crate) fn uri(&self) -> String {
        uri(&self.0)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

pub(crate) fn uri(path: &Path) -> String {
    let path = path.to_str().unwrap().replace('\\', "/");
    let escaped: String = path
        .bytes()
        .map(|byte| match byte {
            b'/' | b'.' | b'-' | b':' => char::from(byte).to_string(),
            _ if byte.is_ascii_alphanumeric() => char::from(byte).to_string(),
            _ => format!("%{byte:02X}"),
        })
        .collect();
    format!("file:///{}", escaped.trim_start_matches('/'))
}

pub(crate) fn c_string(text: &str) -> std::ffi::CString {
    std::ffi::CString::new(text).unwrap()
}

/// Expected outputs of the example.
pub(crate) fn expected(length: f64, speed: f64, time: f64) -> [f64; 2] {
    let mut evaluator = Evaluator::new(&example::surrogate());
    let mut outputs = [0.0; 2];
    evaluator.evaluate(&[length, speed, time], &mut outputs);
    outputs
}

pub(crate) fn starts() -> [f64; 2] {
    let surrogate = example::surrogate();
    [surrogate.inputs()[0].start, surrogate.inputs()[1].start]
}

/// Allocations of this thread: their number, and the bytes that are not freed.
pub(crate) fn allocations() -> (usize, isize) {
    (ALLOCATIONS.get(), LIVE.get())
}

/// Calls a function that may allocate at most `bytes` more bytes on this thread.
pub(crate) fn limited<T>(bytes: isize, call: impl FnOnce() -> T) -> T {
    LIMIT.set(LIVE.get() + bytes);
    let result = call();
    LIMIT.set(isize::MAX);
    result
}

struct Counting;

thread_local! {
    static LIMIT: Cell<isize> = const { Cell::new(isize::MAX) };
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
    static LIVE: Cell<isize> = const { Cell::new(0) };
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        if LIVE.get() + layout.size() as isize > LIMIT.get() {
            return std::ptr::null_mut();
        }
        LIVE.set(LIVE.get() + layout.size() as isize);
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.set(LIVE.get() - layout.size() as isize);
        unsafe { System.dealloc(pointer, layout) }
    }
}
