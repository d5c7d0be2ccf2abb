//! Gives the command a stack.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // a training needs more than the megabyte that the first thread of a program has on Windows: as much as on Linux
    if std::env::var("CARGO_CFG_TARGET_OS").is_ok_and(|system| system == "windows") {
        let msvc = std::env::var("CARGO_CFG_TARGET_ENV").is_ok_and(|environment| environment == "msvc");
        println!("cargo::rustc-link-arg-bins={}", if msvc { "/STACK:8388608" } else { "-Wl,--stack,8388608" });
    }
}
