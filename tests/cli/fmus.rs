//! FMUs: exported, simulated and validated.

use super::*;

#[test]
fn what_is_no_fmu_cannot_be_simulated() {
    let bench = Bench::built();
    bench.fails(&["simulate", "absent.fmu"], &["absent.fmu", "No such file"]);
    fs::write(bench.path("text.fmu"), "not a zip").unwrap();
    bench.fails(&["simulate", "text.fmu"], &["text.fmu"]);
    rewrite(&bench.path(FMU), &bench.path("empty.fmu"), |_, _| None);
    bench.fails(&["simulate", "empty.fmu"], &["empty.fmu", "modelDescription.xml"]);
    rewrite(&bench.path(FMU), &bench.path("bare.fmu"), |name, bytes| (!name.starts_with("binaries/")).then_some(bytes));
    bench.fails(&["simulate", "bare.fmu"], &["bare.fmu", "binaries/"]);
    rewrite(&bench.path(FMU), &bench.path("cut.fmu"), |name, mut bytes| {
        if name.ends_with(".safetensors") {
            bytes.truncate(bytes.len() - 10);
        }
        Some(bytes)
    });
    bench.fails(&["simulate", "cut.fmu"], &["model.safetensors", "cut short"]);
    bench.fails(&["simulate", FMU, "--start", "mass=1"], &["mass"]);
    bench.fails(&["simulate", FMU, "--step-size", "-1"], &["step"]);
    bench.fails(&["simulate", FMU, "--stop-time", "-1e300"], &["start 0 s, stop -1e300 s, step "]);
}

/// Copies an FMU entry by entry; `edit` drops entries or changes their bytes.
fn rewrite(from: &Path, to: &Path, edit: impl Fn(&str, Vec<u8>) -> Option<Vec<u8>>) {
    rewrite_entries(from, to, |name, bytes| edit(&name, bytes).map(|bytes| (name, bytes)));
}

/// Copies an FMU entry by entry; `edit` drops entries or changes their names and bytes.
fn rewrite_entries(from: &Path, to: &Path, mut edit: impl FnMut(String, Vec<u8>) -> Option<(String, Vec<u8>)>) {
    let mut archive = zip::ZipArchive::new(fs::File::open(from).unwrap()).unwrap();
    let mut writer = zip::ZipWriter::new(fs::File::create(to).unwrap());
    for index in 0..archive.len() {
        let mut entry = archive.by_index(index).unwrap();
        let (name, mut bytes) = (entry.name().unwrap().into_owned(), Vec::new());
        entry.read_to_end(&mut bytes).unwrap();
        if let Some((name, bytes)) = edit(name, bytes) {
            writer.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
            writer.write_all(&bytes).unwrap();
        }
    }
    writer.finish().unwrap();
}

#[test]
fn simulate_writes_csv_and_a_plot() {
    let bench = Bench::built();
    let output = bench.run(&["simulate", FMU, "--start", "L=0.12", "--stop-time", "1", "--step-size", "0.3"]);
    let table = stdout(&output);
    let lines: Vec<&str> = table.lines().collect();
    assert_eq!(lines[0], "time,theta,thetad,thetadd,in_domain,domain_distance");
    let times: Vec<f64> = lines[1..].iter().map(|line| line.split(',').next().unwrap().parse().unwrap()).collect();
    assert_eq!(times.len(), 5, "{times:?}");
    assert_eq!((times[0], times[4]), (0.0, 1.0), "the last step is shorter");
    let output = bench.run(&["simulate", FMU, "--output", "run.csv", "--plot", "run.svg"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(fs::read_to_string(bench.path("run.csv")).unwrap().lines().count(), 42);
    let plot = fs::read_to_string(bench.path("run.svg")).unwrap();
    assert!(plot.contains("theta [rad]") && !plot.contains("in_domain"));
    assert!(stderr(&output).contains("constant in this run and not plotted: in_domain = 1.0"), "{}", stderr(&output));
}

#[test]
fn a_plot_is_svg_and_nothing_else() {
    let bench = Bench::new();
    bench.fails(&["simulate", "absent.fmu", "--plot", "p.png"], &["p.png", "expected a file that ends in .svg"]);
    bench.fails(&["simulate", "absent.fmu", "--plot", "p.SVG"], &["absent.fmu"]);
}

#[test]
fn simulate_warns_outside_of_the_ranges() {
    let bench = Bench::built();
    let output = bench.run(&["simulate", FMU, "--stop-time", "3", "--step-size", "0.5", "--output", "run.csv"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let says = "outside the ranges that the FMU is made for in 2 of 7 rows, at 2.5 s for the first time";
    assert!(stderr(&output).contains(says), "{}", stderr(&output));
    assert_eq!(stderr(&bench.run(&["simulate", FMU])), "", "inside it says nothing");
}

#[test]
fn validate_finds_nothing_in_a_good_fmu_and_says_what_is_wrong_with_a_bad_one() {
    let bench = Bench::built();
    let output = bench.run(&["validate", FMU]);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
    rewrite(&bench.path(FMU), &bench.path("bad.fmu"), |name, bytes| {
        let edit = |bytes| String::from_utf8(bytes).unwrap().replace("start=\"0.15", "start=\"0.95").into_bytes();
        Some(if name == "modelDescription.xml" { edit(bytes) } else { bytes })
    });
    let output = bench.run(&["validate", "bad.fmu"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(stdout(&output).contains("start"), "{}", stdout(&output));
}

/// First bytes of a library for Windows on 64-bit ARM.
fn pe_of_arm() -> Vec<u8> {
    [b"MZ".as_slice(), &[0; 58], &[0x40, 0, 0, 0], b"PE\0\0", &[0x64, 0xaa]].concat()
}

/// Last line of a validation.
fn last_line(output: &Output) -> String {
    stdout(output).lines().last().unwrap_or_default().to_owned()
}

#[test]
fn validate_passes_only_what_a_host_can_load_and_it_has_run() {
    let bench = Bench::built();
    // a library with another name is found by no host
    rewrite_entries(&bench.path(FMU), &bench.path("named.fmu"), |name, bytes| {
        Some((name.replace("/single_pendulum.", "/single.pendulum."), bytes))
    });
    let output = bench.run(&["validate", "named.fmu"]);
    assert_eq!(output.status.code(), Some(1), "{}", stdout(&output));
    let says = "single.pendulum.so`, expected `single_pendulum.so`: hosts load co-simulation by its modelIdentifier";
    assert!(!cfg!(target_os = "linux") || stdout(&output).contains(says), "{}", stdout(&output));
    assert!(last_line(&output).ends_with(" found") && last_line(&output) != "no problems found");
    bench.fails(&["simulate", "named.fmu"], &["no binary for this platform: found `binaries/", "/single.pendulum."]);

    // without a library for this platform nothing is run: neither a problem nor a pass
    let mut library = Some(("binaries/aarch64-windows/single_pendulum.dll".to_owned(), pe_of_arm()));
    rewrite_entries(&bench.path(FMU), &bench.path("elsewhere.fmu"), |name, bytes| {
        if name.starts_with("binaries/") { library.take() } else { Some((name, bytes)) }
    });
    let output = bench.run(&["validate", "elsewhere.fmu"]);
    assert_eq!(output.status.code(), Some(3), "{}", stdout(&output));
    assert_eq!(last_line(&output), "no problems found, but the FMU was not run");
    let output = bench.run(&["validate", "elsewhere.fmu", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&json["was_run"], &json["problems"]), (&false.into(), &serde_json::json!([])));
}

#[test]
fn export_writes_both_versions_with_one_network_and_simulate_runs_each_by_each_interface() {
    let bench = Bench::built();
    let output = bench.run(&["export", "study.toml", "--fmi", "both"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let paths = stdout(&output);
    let mut tables = Vec::new();
    for path in paths.lines() {
        assert!(bench.run(&["validate", path]).status.success(), "{path}");
        for interface in ["cs", "me"] {
            let output = bench.run(&["simulate", path, "--interface", interface, "--stop-time", "0.4"]);
            assert!(output.status.success(), "{}", stderr(&output));
            tables.push(stdout(&output).lines().next().map(str::to_owned));
        }
    }
    assert_eq!(tables.len(), 4, "{paths}");
    assert!(tables.iter().all(|header| *header == tables[0]), "{tables:?}");
    let output = bench.run(&["export", "study.toml", "--fmi", "3", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(json["fmu"].as_str().unwrap().ends_with("single-pendulum-fmi3.fmu"), "{json}");
}

#[test]
fn each_version_has_a_name_and_none_of_an_earlier_network_stays() {
    let bench = Bench::built();
    let fmi3 = "out/single-pendulum/single-pendulum-fmi3.fmu";
    let export = |version: &str| {
        let output = bench.run(&["export", "study.toml", "--fmi", version]);
        assert!(output.status.success(), "{}", stderr(&output));
        stderr(&output)
    };
    let fmi2 = fs::read(bench.path(FMU)).unwrap();
    assert!(!export("3").contains("removed"));
    assert!(fs::read(bench.path(FMU)).unwrap() == fmi2, "of the same network: it stays");
    assert!(!export("2").contains("removed"));
    assert!(bench.path(fmi3).exists());

    fs::write(bench.path("study.toml"), small_study().replace("epochs = 3 ", "epochs = 4 ")).unwrap();
    assert!(bench.run(&["train", "study.toml"]).status.success());
    assert!(export("2").contains("removed out/single-pendulum/single-pendulum-fmi3.fmu"));
    assert!(!bench.path(fmi3).exists() && fs::read(bench.path(FMU)).unwrap() != fmi2);
    fs::write(bench.path(FMU), "no FMU").unwrap();
    assert!(export("3").contains("removed out/single-pendulum/single-pendulum.fmu"));
}

#[test]
fn an_fmu_that_computes_in_single_precision_is_valid() {
    let bench = Bench::new();
    for activation in ["relu", "tanh"] {
        // as wide as the example's: outputs of a small network are rough in fewer places
        let study = small_study().replace("hidden = [8]", "hidden = [128, 128]").replace("\"double\"", "\"single\"");
        assert!(study.contains("\"relu\"") && study.contains("\"single\""));
        fs::write(bench.path("study.toml"), study.replace("\"relu\"", &format!("{activation:?}"))).unwrap();
        let output = bench.run(&["build", "study.toml", "--out", "results", "--fmi", "both"]);
        assert!(output.status.success(), "{activation}: {}", stderr(&output));
    }
}

#[test]
fn platforms_are_chosen_and_added_by_name() {
    let bench = Bench::built();
    let entries = |arguments: &[&str]| -> Vec<String> {
        let output = bench.run(&[&["export", "study.toml"], arguments].concat());
        assert!(output.status.success(), "{}", stderr(&output));
        let archive = zip::ZipArchive::new(fs::File::open(bench.path(FMU)).unwrap()).unwrap();
        let names = archive.file_names().map(|name| name.unwrap().into_owned());
        names.filter(|name| name.starts_with("binaries/")).collect()
    };
    // the part of a Windows library that is checked
    let library = [b"MZ".as_slice(), &[0; 58], &[0x40, 0, 0, 0], b"PE\0\0\x64\x86"].concat();
    fs::write(bench.path("fmu.dll"), library).unwrap();
    let with = entries(&["--binary", "x86_64-windows=fmu.dll"]);
    assert!(with.len() >= 2 && with.contains(&"binaries/win64/single_pendulum.dll".to_owned()), "{with:?}");
    let own = entries(&["--platform", own_tuple()]);
    assert_eq!(own.len(), 1, "{own:?}");
    bench.fails(
        &["export", "study.toml", "--platform", "amiga"],
        &["`amiga` is not known, expected one of x86_64-linux"],
    );
    bench.fails(
        &["export", "study.toml", "--binary", "aarch64-linux=fmu.dll"],
        &["fmu.dll", "is a library for x86_64-windows, expected one for aarch64-linux"],
    );
    bench.fails(&["export", "study.toml", "--binary", "aarch64-linux=none.so"], &["none.so", "cannot read"]);
}

/// The platform the command was built for, which is always embedded.
pub fn own_tuple() -> &'static str {
    metafmu::fmi::Platform::CURRENT.tuple
}

#[test]
fn inputs_that_cannot_be_are_refused() {
    let bench = Bench::built();
    fs::write(bench.path("inputs.csv"), "time,L\n0,0.1\n").unwrap();
    let says =
        "inputs.csv:1: column `L` is a parameter of the FMU, and only inputs change over time: --start L=VALUE sets it";
    bench.fails(&["simulate", FMU, "--input", "inputs.csv"], &[says]);
    bench.fails(&["simulate", FMU, "--input", "absent.csv"], &["absent.csv", "cannot read"]);
}

#[test]
fn the_interface_of_an_fmu_is_chosen_and_hosts_are_foretold() {
    let bench = Bench::built();
    let export = |folder: &str, options: &[&str]| {
        let arguments = [&["export", FMU, "--out", folder], options].concat();
        let output = bench.run(&arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        stdout(&output).trim().to_owned()
    };
    let columns =
        |fmu: &str| stdout(&bench.run(&["simulate", fmu, "--stop-time", "0"])).lines().next().unwrap().to_owned();
    let wired = export("wired", &["--ports", "domain"]);
    assert!(wired.starts_with("wired"), "{wired}");
    assert_eq!(columns(&wired), "time,theta,thetad,thetadd,in_domain,domain_distance");
    let plain = export("plain", &["--interface", "plain", "--names", "flat"]);
    assert_eq!(columns(&plain), "time,theta,thetad,thetadd");
    for fmu in [&wired, &plain] {
        assert_eq!(last_line(&bench.run(&["validate", fmu])), "no problems found");
    }
    bench.fails(&["export", FMU, "--out", "none", "--ports", "bounds"], &["there are no error bounds"]);
    bench.fails(&["export", FMU, "--out", "none", "--interface", "plain", "--ports", "domain"], &["a plain interface"]);

    let foretold = stdout(&bench.run(&["validate", "--hosts", &wired]));
    assert!(foretold.contains("\nFMPy 0.3.32 (run): runs by co-simulation\n"), "{foretold}");
    assert!(foretold.contains("estim8 0.1.6 (run): runs"), "{foretold}");
    let hosts: serde_json::Value =
        serde_json::from_str(&stdout(&bench.run(&["validate", "--hosts", "--json", &plain]))).unwrap();
    let hosts = hosts["hosts"].as_array().unwrap();
    assert!(hosts.len() > 20 && hosts.iter().all(|host| host["evidence"] == "run" || host["evidence"] == "read"));
}
