//! Collects the libraries that are embedded in FMUs: `fmu-template` for each platform.
//!
//! In a checkout this script builds the library for the target. The published package has no sources of the library. It
//! contains the libraries that scripts/build-runtimes.sh made for each platform, in `prebuilt/TUPLE/`: installing it
//! compiles only the tool. In both cases, libraries in the folder that METAFMU_RUNTIMES names take precedence.
//!
//! A separate cargo builds the library, with the profile `fmu`, into a separate target directory that all profiles
//! share: the library is the same for all of them. The cargo that runs this script has a different target directory and
//! does not hold its lock.

use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
    process::{Command, exit},
};

/// Paths of libraries by the tuple of their platform.
type Libraries = BTreeMap<String, PathBuf>;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=METAFMU_RUNTIMES");
    let package = PathBuf::from(variable("CARGO_MANIFEST_DIR"));
    let out = PathBuf::from(variable("OUT_DIR"));
    // what cargo packs lies alone
    let workspace = package.ancestors().nth(2).filter(|folder| folder.join("fmu-template/src/lib.rs").is_file());

    let packed = package.join("prebuilt");
    let mut libraries = match workspace {
        None if packed.is_dir() => in_folder(&packed),
        _ => Libraries::new(),
    };
    if let Some(folder) = env::var_os("METAFMU_RUNTIMES").filter(|folder| !folder.is_empty()) {
        let folder = PathBuf::from(folder);
        if workspace.is_none() && folder.is_relative() {
            fail(&format!("METAFMU_RUNTIMES: {} is relative, expected an absolute path", folder.display()));
        }
        libraries.extend(in_folder(&workspace.unwrap_or(&package).join(folder)));
    }
    let own = own_tuple();
    match workspace {
        _ if libraries.contains_key(&own) => {}
        Some(workspace) => {
            libraries.insert(own, build(workspace, &out));
        }
        None if libraries.is_empty() => fail(
            "this package holds no FMU libraries: `scripts/release.sh crates`, in the repository, packs it with them",
        ),
        None => println!(
            "cargo::warning=no FMU library for {own}, this platform: FMUs will be for {}. METAFMU_RUNTIMES names a folder with \
             {own}/{}, which scripts/build-runtimes.sh makes",
            libraries.keys().cloned().collect::<Vec<_>>().join(", "),
            library_name(),
        ),
    }
    embed(&libraries, &out);
}

/// Libraries in a folder, each as TUPLE/NAME.
fn in_folder(folder: &Path) -> Libraries {
    println!("cargo::rerun-if-changed={}", folder.display());
    let library = |platform: PathBuf| {
        let is_library = |path: &PathBuf| path.extension().is_some_and(|e| e == "so" || e == "dll" || e == "dylib");
        let files: Vec<PathBuf> = entries(&platform).into_iter().filter(is_library).collect();
        let [file] = files.as_slice() else {
            fail(&format!("{} has {} libraries, expected one", platform.display(), files.len()));
        };
        println!("cargo::rerun-if-changed={}", file.display());
        let tuple = platform.file_name().unwrap_or_default().to_string_lossy().into_owned();
        (tuple, fs::canonicalize(file).unwrap_or_else(|_| file.clone()))
    };
    entries(folder).into_iter().filter(|entry| entry.is_dir()).map(library).collect()
}

/// Builds the library for the target of this build, and gives the path of a copy in `out`.
fn build(workspace: &Path, out: &Path) -> PathBuf {
    for path in ["fmu-template/Cargo.toml", "fmu-template/src", "fmu-template/runtime", "Cargo.toml", "Cargo.lock"] {
        println!("cargo::rerun-if-changed={}", workspace.join(path).display());
    }
    // OUT_DIR is `<target directory>/<profile>/build/<package>/out`
    let target_dir = out.ancestors().nth(4).unwrap_or(out).join("fmu-library");
    let mut cargo = Command::new(variable("CARGO"));
    cargo.current_dir(workspace);
    cargo.args(["build", "--package", "fmu-template", "--profile", "fmu", "--color", "never", "--target-dir"]);
    cargo.arg(&target_dir);
    // the cargo outside has just read or written the lock file, so it fits; nothing may move underneath it
    if workspace.join("Cargo.lock").exists() {
        cargo.arg("--locked");
    }
    let mut library = target_dir.clone();
    let target = variable("TARGET");
    if target != variable("HOST") {
        cargo.args(["--target", &target]);
        library.push(target);
    }
    clean_environment(&mut cargo, workspace, &target_dir);

    let output = match cargo.output() {
        Ok(output) => output,
        Err(reason) => fail(&format!("cannot start cargo to build fmu-template: {reason}")),
    };
    if !output.status.success() {
        let messages = String::from_utf8_lossy(&output.stderr);
        fail(&format!("building fmu-template, the library inside every FMU, failed\n{messages}"));
    }
    let name = library_name();
    library.extend(["fmu", name]);
    let copy = out.join(name);
    if let Err(reason) = fs::copy(&library, &copy) {
        fail(&format!("cannot copy {} to {}: {reason}", library.display(), copy.display()));
    }
    copy
}

/// Writes `libraries.rs`, a list of platforms and their libraries.
fn embed(libraries: &Libraries, out: &Path) {
    let item = |(tuple, path): (&String, &PathBuf)| format!("    ({tuple:?}, include_bytes!({path:?})),\n");
    let list: String = libraries.iter().map(item).collect();
    let file = out.join("libraries.rs");
    if let Err(reason) = fs::write(&file, format!("&[\n{list}]\n")) {
        fail(&format!("cannot write {}: {reason}", file.display()));
    }
}

/// The target's name in FMI 3.0.
fn own_tuple() -> String {
    let system = variable("CARGO_CFG_TARGET_OS");
    let architecture = variable("CARGO_CFG_TARGET_ARCH");
    match (architecture.as_str(), system.as_str()) {
        ("x86_64" | "x86" | "aarch64", "linux" | "windows") => format!("{architecture}-{system}"),
        ("x86_64" | "aarch64", "macos") => format!("{architecture}-darwin"),
        _ => "other".into(),
    }
}

/// Entries of a folder, sorted.
fn entries(folder: &Path) -> Vec<PathBuf> {
    match fs::read_dir(folder) {
        Ok(entries) => {
            let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
            paths.sort();
            paths
        }
        Err(reason) => fail(&format!("FMU libraries: cannot read {}: {reason}", folder.display())),
    }
}

/// Takes away what the cargo outside set for this package, and what would make the library depend on who builds it.
fn clean_environment(cargo: &mut Command, workspace: &Path, target_dir: &Path) {
    for name in [
        "RUSTFLAGS",
        "CARGO_BUILD_RUSTFLAGS",
        "CARGO_BUILD_TARGET",
        "CARGO_TARGET_DIR",
        "CARGO_BUILD_TARGET_DIR",
        // clippy and coverage tools; RUSTC_WRAPPER (a compiler cache) stays
        "RUSTC_WORKSPACE_WRAPPER",
        "CARGO_BUILD_RUSTC_WORKSPACE_WRAPPER",
        "CLIPPY_ARGS",
        "CLIPPY_CONF_DIR",
    ] {
        cargo.env_remove(name);
    }
    let profile = env::vars_os().map(|(name, _)| name).filter(|name| {
        name.to_str().is_some_and(|name| name.starts_with("CARGO_PROFILE_") || name.starts_with("CARGO_PKG_"))
    });
    for name in profile {
        cargo.env_remove(name);
    }
    // intermediate files beside the results even where a cargo configuration puts them elsewhere
    cargo.env("CARGO_BUILD_BUILD_DIR", target_dir);
    // goes before flags from configuration files as well: no `target-cpu=native` in a library that is released; and
    // the builder's folders do not appear in its panic messages
    let mut flags = vec![format!("--remap-path-prefix={}=metafmu", workspace.display())];
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    if let Some(home) = home.or_else(|| Some(env::home_dir()?.join(".cargo"))) {
        flags.push(format!("--remap-path-prefix={}=cargo", home.display()));
    }
    cargo.env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}"));
}

fn library_name() -> &'static str {
    match variable("CARGO_CFG_TARGET_OS").as_str() {
        "windows" => "fmu_template.dll",
        "macos" | "ios" => "libfmu_template.dylib",
        _ => "libfmu_template.so",
    }
}

fn variable(name: &str) -> String {
    env::var(name).unwrap_or_else(|_| fail(&format!("cargo did not set the environment variable {name}")))
}

/// Shows every line as an error of this build and stops.
fn fail(message: &str) -> ! {
    for line in message.lines() {
        println!("cargo::error={line}");
    }
    exit(1)
}
