//! Compiles the C shim of the FMU host's logger: the callback that FMI 2.0 wants is C-variadic, and defining one in Rust is
//! unstable.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/host/logger.c");
    cc::Build::new().file("src/host/logger.c").warnings(true).compile("metafmu_logger");
}
