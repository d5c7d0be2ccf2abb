//! Studies: sampled, trained, built, refused and rejected.

use super::{fmus::own_tuple, *};

#[test]
fn a_dry_run_prints_the_plan_and_writes_nothing() {
    let bench = Bench::new();
    let before = snapshot(bench.folder.path());
    let output = bench.run(&["sample", "study.toml", "--dry-run"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(snapshot(bench.folder.path()), before);
    let plan = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = plan.lines().collect();
    assert_eq!(lines[..3], ["set,run,L,c,thetad0", "train,0,0.1,0.0,0.0", "train,1,0.1,0.0,2.5"]);
    assert_eq!((lines.len(), lines[27].starts_with("train,26,"), lines[28].starts_with("test,0,")), (33, true, true));
    // what is sampled is what was printed
    assert!(bench.run(&["sample", "study.toml"]).status.success());
    let table = fs::read_to_string(bench.path("out/single-pendulum/test.csv")).unwrap();
    let first = table.lines().nth(1).unwrap().split(',').skip(2).take(3).collect::<Vec<_>>().join(",");
    assert_eq!(lines[28], format!("test,0,{first}"));
}

#[test]
fn recorded_runs_become_a_fmu_like_simulated_ones() {
    let bench = Bench::new();
    assert!(bench.run(&["sample", "study.toml"]).status.success());
    fs::copy(bench.path("out/single-pendulum/train.csv"), bench.path("runs.csv")).unwrap();
    let study = small_study();
    let start = study.find("[source]").unwrap();
    let end = study.find("[time]").unwrap();
    let study = format!("{}[source]\ntable = \"runs.csv\"\n{}", &study[..start], &study[end..]);
    let plan = study.find("method = ").unwrap()..study.find("test_runs").unwrap();
    let study = format!("{}{}", &study[..plan.start], &study[plan.end..]);
    fs::write(bench.path("recorded.toml"), study).unwrap();

    let output = bench.run(&["sample", "recorded.toml", "--dry-run"]);
    let plan = stdout(&output);
    assert_eq!((plan.lines().count(), plan.matches("test,").count()), (28, 5), "{}", stderr(&output));
    let output = bench.run(&["build", "recorded.toml", "--out", "recorded"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(bench.path("recorded/single-pendulum.fmu").exists());

    // the content of the table decides what is stale
    let text = fs::read_to_string(bench.path("runs.csv")).unwrap();
    fs::write(bench.path("runs.csv"), format!("# looked at\n{text}")).unwrap();
    bench.fails(&["train", "recorded.toml", "--out", "recorded"], &["sampled from another study"]);
    fs::write(bench.path("runs.csv"), text.replacen("0,0.05,", "0,0.00,", 1)).unwrap();
    bench.fails(&["sample", "recorded.toml"], &["runs.csv:3: time 0 s is duplicated in run `0`"]);
}

#[test]
fn a_sampling_that_is_killed_loses_no_finished_run() {
    let bench = Bench::new();
    let mechanism = include_str!("../../examples/mechanisms/quarter-car.toml");
    fs::write(bench.path("quarter-car.toml"), mechanism.replace("\"augmented\"", "\"embedding\"")).unwrap();
    let study = include_str!("../../examples/mechanisms/quarter-car-study.toml");
    let study = study.replace("\nruns = 1000", "\nruns = 12").replace("test_runs = 100 ", "test_runs = 2 ");
    fs::write(bench.path("study.toml"), study).unwrap();
    let journal = bench.path("killed/unfinished-runs.bin");
    let mut command = Command::new(env!("CARGO_BIN_EXE_metafmu"));
    let mut child = command
        .args(["sample", "study.toml", "--out", "killed"])
        .current_dir(bench.folder.path())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    // a run is 3 outputs at 201 times: the third begins
    while fs::metadata(&journal).map_or(0, |file| file.len()) < 2 * 3 * 201 * 8 {
        assert!(child.try_wait().unwrap().is_none(), "it was not slow enough to be killed");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!bench.path("killed/train.csv").exists());

    let output = bench.run(&["sample", "study.toml", "--out", "killed"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("kept from a sampling that was not finished"), "{}", stderr(&output));
    assert!(!journal.exists());
    assert!(bench.run(&["sample", "study.toml", "--out", "whole"]).status.success());
    for name in ["train.csv", "test.csv"] {
        let [killed, whole] = ["killed", "whole"].map(|folder| fs::read(bench.path(folder).join(name)).unwrap());
        assert!(killed == whole, "{name} is another one");
    }
}

#[test]
fn build_writes_every_result_and_prints_the_table() {
    let bench = Bench::built();
    for name in [
        "single-pendulum.fmu",
        "single-pendulum.safetensors",
        "report.html",
        "metrics.json",
        "train.csv",
        "history.csv",
    ] {
        assert!(bench.path("out/single-pendulum").join(name).exists(), "{name}");
    }
    let output = bench.run(&["evaluate", "study.toml"]);
    for piece in ["theta ", "rad/s2", "R²", "largest error", "metrics.json"] {
        assert!(stdout(&output).contains(piece), "{}", stdout(&output));
    }
    let metrics: serde_json::Value =
        serde_json::from_slice(&fs::read(bench.path("out/single-pendulum/metrics.json")).unwrap()).unwrap();
    assert!(
        metrics["outputs"]["theta"]["r2"].is_number() && metrics["outputs"]["thetadd"]["max_abs_error"].is_number()
    );
    assert_eq!(metrics["test_runs"], 5);
    assert_eq!(metrics["train_rows"], 26 * 41, "one of 27 runs is held out");
    assert!(metrics["train_seconds"].is_number() && metrics["processor_seconds"].is_number());
    let speed = &metrics["speed"];
    assert!(
        stdout(&output).contains("both with outputs every 0.05 s, alternately in 4 test runs"),
        "{}",
        stdout(&output)
    );
    assert!(speed["setting"]["tolerance"].as_f64() > Some(1e-13), "{speed}");
    assert!(speed["source_error"].as_f64() <= speed["surrogate_error"].as_f64(), "{speed}");
}

#[test]
fn tables_are_of_the_format_of_the_study_and_there_is_one_for_each_set() {
    let bench = Bench::new();
    let study = small_study();
    let tables = || {
        let names = snapshot(&bench.path("out/single-pendulum")).into_iter().map(|(path, _)| path);
        let names = names.filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()));
        let mut names: Vec<String> =
            names.filter(|name| name.ends_with(".csv") || name.ends_with(".parquet")).collect();
        names.sort();
        names
    };
    let read = |name: &str| {
        let mut table = metafmu::table::Table::open(&bench.path("out/single-pendulum").join(name)).unwrap();
        let names: Vec<String> = table.columns().iter().map(|column| column.name.clone()).collect();
        let mut rows = Vec::new();
        while table.next_row().unwrap() {
            rows.push((0..names.len()).map(|column| table.number(column).unwrap().to_bits()).collect::<Vec<_>>());
        }
        (names, rows)
    };
    assert!(bench.run(&["sample", "study.toml"]).status.success());
    assert_eq!(tables(), ["test.csv", "train.csv"]);
    let expected = read("train.csv");

    fs::write(bench.path("study.toml"), study.replace("[sampling]", "[sampling]\ntables = \"parquet\"")).unwrap();
    // they are still those of this study
    assert!(bench.run(&["train", "study.toml"]).status.success());
    let output = bench.run(&["sample", "study.toml"]);
    assert!(stdout(&output).contains("train.parquet\n") && stdout(&output).contains("test.parquet\n"));
    assert_eq!(tables(), ["history.csv", "test.parquet", "train.parquet"]);
    assert_eq!(read("train.parquet"), expected);
    let before = bench.run(&["evaluate", "study.toml", "--json"]);
    assert!(before.status.success(), "{}", stderr(&before));

    // a user's conversion is neither used nor in the way
    let path = bench.path("out/single-pendulum/test.csv");
    fs::write(&path, "run,time\n").unwrap();
    assert!(bench.run(&["evaluate", "study.toml"]).status.success());
    fs::remove_file(&path).unwrap();
    fs::remove_file(bench.path("out/single-pendulum/test.parquet")).unwrap();
    bench.fails(&["evaluate", "study.toml"], &["samples.json: the table `test` beside it is missing"]);

    fs::write(bench.path("study.toml"), study).unwrap();
    assert!(bench.run(&["sample", "study.toml"]).status.success());
    assert_eq!(tables(), ["history.csv", "test.csv", "train.csv"]);
    assert!(bench.run(&["evaluate", "study.toml"]).status.success());
    fs::write(bench.path("study.toml"), small_study().replace("[sampling]", "[sampling]\ntables = \"xlsx\"")).unwrap();
    bench.fails(&["sample", "study.toml"], &["sampling.tables: \"xlsx\", expected \"csv\" or \"parquet\""]);
}

#[test]
fn the_stages_one_by_one_give_the_same_files_as_build() {
    let (whole, stages) = (Bench::built(), Bench::new());
    for verb in ["sample", "train", "evaluate", "export"] {
        let output = stages.run(&[verb, "study.toml"]);
        assert!(output.status.success(), "{verb}: {}", stderr(&output));
    }
    for name in ["train.csv", "test.csv", "single-pendulum.safetensors", "single-pendulum.fmu"] {
        let name = Path::new("out/single-pendulum").join(name);
        let bytes = |bench: &Bench| fs::read(bench.folder.path().join(&name)).unwrap();
        assert!(bytes(&whole) == bytes(&stages), "{} differs", name.display());
    }
}

#[test]
fn the_number_of_threads_does_not_change_a_byte() {
    let (one, two) = (Bench::new(), Bench::new());
    for (bench, threads) in [(&one, "1"), (&two, "2")] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_metafmu"));
        command.args(["build", "study.toml"]).env("RAYON_NUM_THREADS", threads).current_dir(bench.folder.path());
        assert!(command.output().unwrap().status.success());
    }
    assert!(fs::read(one.path(FMU)).unwrap() == fs::read(two.path(FMU)).unwrap());
}

#[test]
fn new_writes_the_example_and_overwrites_nothing() {
    let bench = Bench::new();
    let output = bench.run(&["new", "single-pendulum", "--system", "single-pendulum"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let written = fs::read_to_string(bench.path("single-pendulum.toml")).unwrap();
    assert_eq!(written, include_str!("../../examples/single-pendulum.toml"));
    let says = ["single-pendulum.toml: exists already and is not overwritten"];
    for name in ["single-pendulum", "single-pendulum.toml"] {
        bench.fails(&["new", name, "--system", "single-pendulum"], &says);
    }
    bench.fails(&["new", "a/b", "--system", "single-pendulum"], &["a: is no folder"]);
    bench.fails(
        &["new", "a b", "--system", "single-pendulum"],
        &["error: NAME: `a b` is not a valid name", "for instance `a-b`"],
    );
    let output = bench.run(&["new", "mine", "--system", "single-pendulum"]);
    assert!(output.status.success());
    let mine = fs::read_to_string(bench.path("mine.toml")).unwrap();
    assert!(mine.contains("name = \"mine\"") && !mine.contains("\nlicense = "), "{mine}");
    assert!(bench.run(&["new", "its.toml", "--system", "single-pendulum"]).status.success());
    assert!(fs::read_to_string(bench.path("its.toml")).unwrap().contains("name = \"its\""));
}

#[test]
fn new_writes_schemas_beside_the_study_and_replaces_none() {
    let bench = Bench::new();
    let arguments = |name| ["new", name, "--template", "pendulum", "--schema"];
    let output = bench.run(&arguments("hoist"));
    assert!(output.status.success(), "{}", stderr(&output));
    for (name, kind) in [("hoist.toml", "study"), ("hoist-mechanism.toml", "mechanism")] {
        let schema = format!("{kind}.schema.json");
        let text = fs::read_to_string(bench.path(name)).unwrap();
        assert_eq!(text.lines().next(), Some(format!("#:schema ./{schema}").as_str()));
        let printed = bench.run(&["schema", kind]);
        assert_eq!(fs::read_to_string(bench.path(&schema)).unwrap(), stdout(&printed));
        assert!(stdout(&output).lines().any(|line| line == schema), "{}", stdout(&output));
    }
    // identical schemas are kept
    let output = bench.run(&arguments("other"));
    assert!(output.status.success() && !stdout(&output).contains("schema.json"), "{}", stderr(&output));
    let output = bench.run(&["new", "plain", "--system", "single-pendulum"]);
    assert!(output.status.success() && !fs::read_to_string(bench.path("plain.toml")).unwrap().contains("#:schema"));

    fs::write(bench.path("mechanism.schema.json"), "{}").unwrap();
    let before = snapshot(bench.folder.path());
    let says = ["mechanism.schema.json: exists already and is not overwritten"];
    bench.fails(&arguments("third"), &says);
    assert_eq!(snapshot(bench.folder.path()), before);
    // a study alone does not need it
    assert!(bench.run(&["new", "fourth", "--system", "single-pendulum", "--schema"]).status.success());
    let text = fs::read_to_string(bench.path("fourth.toml")).unwrap();
    assert_eq!(
        text,
        format!(
            "#:schema ./study.schema.json\n{}",
            include_str!("../../examples/single-pendulum.toml")
                .replace("single-pendulum.toml", "fourth.toml")
                .replace("new single-pendulum", "new fourth")
                .replace("name = \"single-pendulum\"", "name = \"fourth\"")
        )
    );
}

#[test]
fn a_new_study_in_a_folder_finds_its_source() {
    let bench = Bench::new();
    fs::create_dir_all(bench.path("deep/er")).unwrap();
    fs::write(bench.path("four-bar.toml"), include_str!("../../examples/mechanisms/four-bar.toml")).unwrap();
    let folder = bench.folder.path().display().to_string();
    for name in ["deep/er/arm", "deep/../deep/er/arm2.toml", &format!("{folder}/deep/er/arm3")] {
        let output = bench.run(&["new", name, "--mechanism", "four-bar.toml"]);
        assert!(output.status.success(), "{}", stderr(&output));
    }
    for name in ["arm", "arm2", "arm3"] {
        let study = fs::read_to_string(bench.path(&format!("deep/er/{name}.toml"))).unwrap();
        assert!(study.contains(&format!("name = \"{name}\"")), "{study}");
        assert!(study.contains("mechanism = \"../../four-bar.toml\""), "{study}");
    }
}

#[test]
fn a_study_of_a_table_keeps_the_names_of_its_columns_and_takes_no_number_of_a_run_for_a_parameter() {
    let bench = Bench::new();
    let row = |run: usize, t: f64| format!("{run},{t},{},kalt,{},{}", 0.1 * run as f64, t * run as f64, -t);
    let rows: Vec<String> = (1..=4).flat_map(|run| [0.0, 0.5, 1.0].map(|t| row(run, t))).collect();
    let new = |header: &str, rows: &[String], arguments: &[&str]| {
        fs::write(bench.path("runs.csv"), format!("{header}\n{}\n", rows.join("\n"))).unwrap();
        let _ = fs::remove_file(bench.path("x.toml"));
        let output = bench.run(&[&["new", "x", "--table", "runs.csv"], arguments].concat());
        let study = fs::read_to_string(bench.path("x.toml")).unwrap_or_default();
        (output.status.code(), study, stderr(&output))
    };
    let header = "Lauf,Zeit [s],Dämpfung [N.s/m],Zustand,Körper.x [m],in_domain";
    let (code, study, says) = new(header, &rows, &[]);
    assert_eq!(code, Some(0), "{says}");
    assert!(says.contains("column `Lauf`: numbers the runs: taken as their label and not as a parameter"), "{says}");
    for line in [
        "columns = { time = \"Zeit\", run = \"Lauf\", in_domain_ = \"in_domain\" }",
        "\"Dämpfung\" = { min = 0.1, max = 0.4, unit = \"N.s/m\" }",
        "# Lauf numbers the runs",
        "# Zustand is text and left out",
        "\"Körper.x\" = { unit = \"m\" }",
    ] {
        assert!(study.contains(line), "{line} is not in {study}");
    }
    let output = bench.run(&["sample", "x.toml", "--dry-run"]);
    assert!(stdout(&output).starts_with("set,run,Dämpfung\ntrain,0,"), "{}{}", stdout(&output), stderr(&output));

    // by name; and what numbers the runs is a parameter where there is no other
    let (code, study, says) = new(&header.replace("Zeit", "Uhr"), &rows, &["--time", "Uhr [s]", "--run", "lauf"]);
    assert_eq!((code, study.as_str()), (Some(2), ""), "{says}");
    assert!(says.contains("runs.csv:1: no column `lauf`") && says.contains("did you mean `Lauf`?"), "{says}");
    let (code, study, says) = new(&header.replace("Zeit", "Uhr"), &rows, &["--time", "Uhr [s]", "--run", "Lauf"]);
    assert!(code == Some(0) && study.contains("columns = { time = \"Uhr\", run = \"Lauf\""), "{says}{study}");
    let (code, _, says) = new(&header.replace("Zeit", "Uhr"), &rows, &[]);
    assert!(
        code == Some(0)
            && says.contains("column `Uhr` has seconds that grow from 0: if it is the time, --time \"Uhr\""),
        "{says}"
    );
    let (code, _, says) = new(&header.replace("Zeit", "Uhr"), &rows, &["--structure", "response"]);
    assert!(code == Some(2) && says.contains("none of the columns is the time (Lauf, Uhr, "), "{says}");
    let (code, _, says) = new(&header.replace("[s]", "[ms]"), &rows, &[]);
    assert!(code == Some(2) && says.contains("runs.csv:1: column `Zeit`: unit `ms`, expected `s`"), "{says}");
    let sweep: Vec<String> = (1..=4).flat_map(|k| [0.0, 1.0].map(|t| format!("{k},{t},{}", t * k as f64))).collect();
    let (code, study, says) = new("k,t,x", &sweep, &[]);
    assert!(code == Some(0) && study.contains("k = { min = 1.0, max = 4.0 }"), "{says}{study}");
    bench.fails(&["new", "y", "--system", "single-pendulum", "--time", "t"], &["--time", "--system"]);
}

#[test]
fn a_structure_that_a_source_does_not_have_is_refused() {
    let bench = Bench::new();
    for (source, structure, expected) in [
        (["--system", "single-pendulum"], "static", "--table FILE"),
        (["--template", "crane"], "static", "--table FILE"),
        (["--template", "crane"], "discrete", "--fmu FILE"),
    ] {
        let arguments = [&["new", "x"], &source[..], &["--structure", structure]].concat();
        bench.fails(&arguments, &[&format!("--structure {structure}"), expected]);
        assert!(!bench.path("x.toml").exists() && !bench.path("x-mechanism.toml").exists());
    }
}

#[test]
fn a_column_of_accelerations_is_neither_a_state_nor_an_input() {
    let bench = Bench::new();
    let mut rows = String::from("time,xdd,x,xd,twin\n");
    for t in (0..300).map(|row| 0.01 * f64::from(row)) {
        let (x, xd, xdd) = (t.powi(3) - t, 3.0 * t * t - 1.0, 6.0 * t);
        rows += &format!("{t},{xdd},{x},{xd},{}\n", x + 2.0);
    }
    fs::write(bench.path("motions.csv"), rows).unwrap();
    let output = bench.run(&["new", "x", "--table", "motions.csv", "--structure", "dynamics"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stderr(&output).contains("column `xdd`: is an acceleration"), "{}", stderr(&output));
    let study = fs::read_to_string(bench.path("x.toml")).unwrap();
    assert!(study.contains("\nx = { rate = \"xd\" }") && study.contains("\ntwin = {  }"), "{study}");
    assert!(study.contains("x = {}\nxd = {}\ntwin = {}\n") && !study.contains("xdd"), "{study}");
}

#[test]
fn a_bad_study_is_refused_with_file_line_and_key() {
    let bench = Bench::built();
    let good = small_study();
    let broken = |from: &str, to: &str| {
        assert!(good.contains(from), "{from}");
        fs::write(bench.path("bad.toml"), good.replacen(from, to, 1)).unwrap();
    };
    bench.fails(&["build", "absent.toml"], &["absent.toml", "No such file"]);
    broken("[time]", "[time");
    bench.fails(&["build", "bad.toml"], &["bad.toml:"]);
    broken("[network]", "[network]\nnodes = 3");
    bench.fails(&["build", "bad.toml"], &["bad.toml:", "network.nodes", "unknown key `nodes`", "hidden"]);
    broken("min = 0.1,", "min = 0.3,");
    bench.fails(&["build", "bad.toml"], &["bad.toml:", "parameters.L", "min 0.3 is not below max 0.2"]);
    broken("theta = {", "c = {");
    bench.fails(&["build", "bad.toml"], &["bad.toml:", "outputs.c", "`c` is a parameter already"]);
    broken("\nthetad = {", "\ntheta = {");
    bench.fails(&["build", "bad.toml"], &["bad.toml:", "duplicate key"]);
    fs::write(bench.path("bad.toml"), b"name = \"\xff\"").unwrap();
    bench.fails(&["build", "bad.toml"], &["bad.toml", "UTF-8"]);
}

#[test]
fn a_folder_that_cannot_be_written_is_found_before_the_work() {
    let bench = Bench::new();
    fs::write(bench.path("file"), "not a folder").unwrap();
    bench.fails(&["build", "study.toml", "--out", "file/out"], &["file/out", "cannot"]);
}

#[test]
fn stages_out_of_order_or_of_another_study_say_what_to_run() {
    let bench = Bench::new();
    bench.fails(&["train", "study.toml"], &["samples.json", "run `metafmu sample`"]);
    bench.fails(&["export", "study.toml"], &["single-pendulum.safetensors", "run `metafmu train`"]);
    let bench = Bench::built();
    fs::write(bench.path("study.toml"), small_study().replace("max = 0.2,", "max = 0.25,")).unwrap();
    bench.fails(&["train", "study.toml"], &["sampled from another study"]);
    bench.fails(&["evaluate", "study.toml"], &["trained from another study"]);
    let record = fs::read(bench.path("out/single-pendulum/samples.json")).unwrap();
    bench.fails(
        &["build", "study.toml", "--resume"],
        &["sampled from another study", "`metafmu build` without --resume"],
    );
    assert_eq!(fs::read(bench.path("out/single-pendulum/samples.json")).unwrap(), record);
}

#[test]
fn a_damaged_model_file_is_named() {
    let bench = Bench::built();
    let bytes = fs::read(bench.path(MODEL)).unwrap();
    fs::write(bench.path(MODEL), &bytes[..bytes.len() - 10]).unwrap();
    for verb in ["export", "evaluate"] {
        bench.fails(&[verb, "study.toml"], &["single-pendulum.safetensors", "cut short"]);
    }
    fs::write(bench.path(MODEL), &bytes[..5]).unwrap();
    bench.fails(&["export", "study.toml"], &["single-pendulum.safetensors", "cut short"]);
}

#[cfg(unix)]
#[test]
fn results_that_nobody_can_see_are_an_error_and_a_reader_that_has_seen_enough_is_none() {
    let bench = Bench::built();
    for verb in [
        "simulate out/single-pendulum/single-pendulum.fmu",
        "validate out/single-pendulum/single-pendulum.fmu",
        "evaluate study.toml",
        "export study.toml",
        "report study.toml",
        "sample study.toml --dry-run",
        "new other --system slider-crank",
    ] {
        let output = shell(&bench, &format!("\"$0\" {verb} >&-"));
        assert_eq!(output.status.code(), Some(2), "{verb}: {}", stderr(&output));
        assert!(stderr(&output).contains("stdout: cannot write: it is closed"), "{verb}: {}", stderr(&output));
    }
    // nothing is printed: there is nothing to miss
    let quiet = shell(&bench, &format!("\"$0\" simulate {FMU} --output run.csv >&-"));
    assert_eq!(quiet.status.code(), Some(0), "{}", stderr(&quiet));
    let head = shell(&bench, &format!("(\"$0\" simulate {FMU}; echo $? >&2) | head -n 1"));
    assert_eq!((stdout(&head).lines().count(), stderr(&head).as_str()), (1, "0\n"));
}

#[cfg(unix)]
#[test]
fn a_job_whose_progress_nobody_reads_any_more_ends_well() {
    let bench = Bench::new();
    let progress = "(\"$0\" build study.toml; echo $? > code) 2>&1 | true";
    for command in [progress, "\"$0\" build study.toml 2>&- > /dev/null; echo $? > code"] {
        shell(&bench, command);
        assert_eq!(fs::read_to_string(bench.path("code")).unwrap(), "0\n", "{command}");
        assert!(bench.path(FMU).exists(), "{command}");
        fs::remove_dir_all(bench.path("out")).unwrap();
    }
}

#[cfg(unix)]
#[test]
fn a_build_that_is_interrupted_in_training_finishes_with_the_best_network_and_says_130() {
    let bench = Bench::new();
    fs::write(bench.path("study.toml"), small_study().replace("epochs = 3 ", "epochs = 100000 ")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_metafmu"));
    command.args(["build", "study.toml"]).current_dir(bench.folder.path());
    let mut child = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    while !bench.path("out/single-pendulum/history.csv").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it was not slow enough to be interrupted");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let interrupt = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", stderr(&output));
    let says = stderr(&output);
    assert!(
        says.contains("error: stopped by Ctrl-C while the surrogate was trained\ndone: all files, of the best"),
        "{says}"
    );
    assert!(
        says.ends_with("missing: the rest of the training\ncontinue with: metafmu build study.toml --resume\n"),
        "{says}"
    );
    assert!(stdout(&output).contains("single-pendulum.fmu"), "{}", stdout(&output));
    assert!(bench.path(FMU).exists() && bench.path("out/single-pendulum/report.html").exists());
    // the help is wrapped to the width of the terminal
    let help = stdout(&bench.run(&["help"])).split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(help.contains("130 stopped by Ctrl-C"), "{help}");
}

#[test]
fn a_build_whose_fmu_fails_its_validation_is_rejected() {
    let bench = Bench::new();
    fs::write(bench.path("study.toml"), small_study() + "good = -inf\n").unwrap();
    let build = ["build", "study.toml", "--resume", "--platform", own_tuple()];
    let output = bench.run(&build);
    assert!(stdout(&output).contains("\ngood: every output"), "{}{}", stdout(&output), stderr(&output));
    // no host can load the beginning of a library
    let mut archive = zip::ZipArchive::new(fs::File::open(bench.path(FMU)).unwrap()).unwrap();
    let name = archive.file_names().map(|name| name.unwrap().into_owned()).find(|name| name.starts_with("binaries/"));
    let mut library = vec![0; 4000];
    archive.by_name(&name.unwrap()).unwrap().read_exact(&mut library).unwrap();
    fs::write(bench.path("cut.lib"), library).unwrap();
    let cut = format!("{}=cut.lib", own_tuple());
    let output = bench.run(&[&build[..], &["--binary", &cut]].concat());
    assert_eq!(output.status.code(), Some(1), "{}{}", stdout(&output), stderr(&output));
    let text = stdout(&output);
    let (_, last) = text.split_once("\nrejected: this surrogate is not good enough to be used\n").unwrap();
    assert!(last.starts_with("  single-pendulum.fmu: the validation found ") && last.lines().count() == 1, "{last}");
    let rejected = |output: &Output, code: i32| {
        let file = fs::read_to_string(bench.path("out/single-pendulum/metrics.json")).unwrap();
        let verdict = serde_json::from_str::<serde_json::Value>(&file).unwrap()["verdict"].clone();
        let problem = &verdict["problems"][0];
        assert_eq!((&problem["check"], &problem["place"]), (&"validation".into(), &"single-pendulum.fmu".into()));
        assert_eq!((&verdict["grade"], output.status.code()), (&"rejected".into(), Some(code)), "{verdict}");
        let report = fs::read_to_string(bench.path("out/single-pendulum/report.html")).unwrap();
        let mut archive = zip::ZipArchive::new(fs::File::open(bench.path(FMU)).unwrap()).unwrap();
        let mut card = String::new();
        archive.by_name("documentation/index.html").unwrap().read_to_string(&mut card).unwrap();
        for page in [report, card] {
            let (_, first) = page.split_once("</h1>\n").unwrap();
            assert!(first.starts_with("<div class=\"verdict rejected\">"), "{}", &first[..200]);
            assert!(first.contains("<li>single-pendulum.fmu: the validation found "), "{}", &first[..600]);
        }
    };
    rejected(&output, 1);
    // the verbs that judge again know what the build found
    rejected(&bench.run(&["evaluate", "study.toml"]), 1);
    rejected(&bench.run(&["report", "study.toml"]), 0);
    rejected(&bench.run(&["export", "study.toml"]), 0);
    let output = bench.run(&build);
    assert!(output.status.success() && stdout(&output).contains("\ngood: every output"), "{}", stdout(&output));
}

#[test]
fn a_poor_surrogate_is_rejected_in_the_last_lines_and_by_the_exit_code() {
    let bench = Bench::new();
    fs::write(bench.path("study.toml"), small_study().replace(ANY, "")).unwrap();
    let is_rejected = |output: &Output, says: &[&str]| {
        assert_eq!(output.status.code(), Some(1), "{}{}", stdout(output), stderr(output));
        let text = stdout(output);
        let (_, last) = text.split_once("\nrejected: this surrogate is not good enough to be used\n").unwrap();
        assert!(last.lines().all(|line| line.starts_with("  ")), "{text}");
        says.iter().for_each(|says| assert!(last.contains(says), "{says} is not in {text}"));
    };
    let of_baseline = "times that of the baseline decision-tree";
    is_rejected(&bench.run(&["build", "study.toml"]), &["  theta: ", of_baseline]);
    assert!(bench.path("out/single-pendulum/single-pendulum.fmu").exists(), "it may be looked at");
    let report = fs::read_to_string(bench.path("out/single-pendulum/report.html")).unwrap();
    let (_, first) = report.split_once("</h1>\n").unwrap();
    assert!(first.starts_with("<div class=\"verdict rejected\"><p><strong>Rejected"), "{}", &first[..200]);
    assert!(first.contains(of_baseline) && !report.contains("Valid only within"));
    let metrics = || -> serde_json::Value {
        serde_json::from_str(&fs::read_to_string(bench.path("out/single-pendulum/metrics.json")).unwrap()).unwrap()
    };
    assert_eq!(metrics()["verdict"]["accepted"], false);
    let problem = &metrics()["verdict"]["problems"][0];
    assert_eq!((&problem["check"], &problem["place"]), (&"accuracy".into(), &"theta".into()), "{problem}");
    is_rejected(&bench.run(&["evaluate", "study.toml"]), &["  theta: ", of_baseline]);
    let output = bench.run(&["evaluate", "study.toml", "--json"]);
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((output.status.code(), &printed["verdict"]), (Some(1), &metrics()["verdict"]));
    assert!(stderr(&output).contains("rejected: "), "{}", stderr(&output));
    let output = bench.run(&["export", "study.toml"]);
    assert!(output.status.success() && stderr(&output).contains("rejected: "), "{}", stderr(&output));

    // other limits ask for no other training
    fs::write(bench.path("study.toml"), small_study()).unwrap();
    let output = bench.run(&["evaluate", "study.toml"]);
    assert!(output.status.success() && !stdout(&output).contains("rejected"), "{}", stderr(&output));
    let verdict = &metrics()["verdict"];
    assert_eq!((&verdict["accepted"], &verdict["grade"]), (&true.into(), &"usable".into()), "{verdict}");
    assert!(verdict["problems"].as_array().unwrap().is_empty() && !verdict["advice"].as_array().unwrap().is_empty());

    // a training knows what it did on the runs that were held out
    let study = small_study().replace(ANY, "");
    let rate = study.lines().find(|line| line.starts_with("learning_rate")).unwrap();
    fs::write(bench.path("study.toml"), study.replace(rate, "learning_rate = 5000.0")).unwrap();
    is_rejected(&bench.run(&["train", "study.toml"]), &["on the held-out runs, expected at least 0.9 (accept.r2)"]);
    // derivatives of 1e-300, where all nodes are saturated, are right as far as differences of outputs show
    assert!(bench.run(&["export", "study.toml"]).status.success());
    let output = bench.run(&["validate", "out/single-pendulum/single-pendulum.fmu"]);
    assert!(output.status.success(), "{}", stdout(&output));
    fs::write(bench.path("study.toml"), small_study().replace(rate, "learning_rate = 1e38")).unwrap();
    let output = bench.run(&["train", "study.toml"]);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    let problem = "error: no epoch was completed: the loss became infinite: lower the learning rate\n";
    assert!(message.ends_with(problem) && !message.contains("the first epoch is not complete"), "{message}");
}

#[test]
fn a_constant_output_is_exact_and_one_that_cannot_be_computed_with_is_refused_before_the_training() {
    let bench = Bench::new();
    let rows = |output: f64| -> String {
        let run = |run: u32| {
            (0..3)
                .map(move |row| format!("{run},{},{},{output:e}\n", 0.5 * f64::from(row), 0.1 + 0.01 * f64::from(run)))
        };
        "run,time,L,y\n".to_owned() + &(0..10).flat_map(run).collect::<String>()
    };
    let study = "name = \"s\"\n[source]\ntable = \"runs.csv\"\n[time]\nstop = 1\nstep = 0.5\n[parameters]\n\
                 L = { min = 0.1, max = 0.2 }\n[outputs]\ny = {}\n[sampling]\ntest_runs = 2\n[network]\nhidden = [4]\n\
                 [training]\nepochs = 2\n[baselines]\nbuild = []\n";
    fs::write(bench.path("study.toml"), study).unwrap();
    for output in [3.0, 0.0] {
        fs::write(bench.path("runs.csv"), rows(output)).unwrap();
        let result = bench.run(&["build", "study.toml", "--json"]);
        assert!(result.status.success(), "{}", stderr(&result));
        let metrics: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
        assert_eq!(metrics["outputs"]["y"]["max_abs_error"], 0.0, "{metrics}");
        assert!(bench.run(&["export", "study.toml"]).status.success());
    }
    fs::remove_dir_all(bench.path("out")).unwrap();
    for output in [1e155, 1e-200] {
        fs::write(bench.path("runs.csv"), rows(output)).unwrap();
        let says = format!("study.toml:10: outputs.y: from {output:e} to {output:e} in the runs, expected ");
        let result = bench.run(&["build", "study.toml"]);
        assert_eq!(result.status.code(), Some(2), "{}", stderr(&result));
        assert!(stderr(&result).contains(&says) && !stderr(&result).contains("epoch"), "{}", stderr(&result));
    }
}

#[test]
fn training_runs_may_go_on_beyond_the_end_and_lie_on_the_faces_of_the_ranges() {
    let bench = Bench::new();
    let study = small_study()
        .replace("step = 0.05", "step = 0.05\nmargin = 0.06")
        .replace("method = \"mesh\"", "method = \"sobol\"\nfaces = 0.4")
        .replace("levels = 3", "runs = 20");
    fs::write(bench.path("study.toml"), study).unwrap();
    let tables = |folder: &str| {
        ["train.csv", "test.csv"].map(|table| fs::read_to_string(bench.path(folder).join(table)).unwrap())
    };
    let times = |table: &str| -> Vec<f64> {
        let mut times: Vec<f64> =
            table.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
        times.sort_by(f64::total_cmp);
        times.dedup();
        times
    };
    assert!(bench.run(&["sample", "study.toml", "--out", "whole"]).status.success());
    let [train, test] = tables("whole");
    // 6 % of 40 steps are 2.4, which are 3 whole ones
    assert_eq!((times(&train).len(), times(&test).len()), (44, 41));
    assert_eq!((times(&train)[..41] == times(&test), times(&test)[40]), (true, 2.0));
    assert!((times(&train)[43] - 2.15).abs() < 1e-12);
    let on_faces = train.lines().filter(|line| line.contains(",0.1,") || line.contains(",0.2,")).count();
    assert!((3 * 44..15 * 44).contains(&on_faces), "{on_faces} rows of runs with L at an end of its range");

    for part in ["1/2", "2/2"] {
        assert!(bench.run(&["sample", "study.toml", "--out", "parts", "--shard", part]).status.success());
    }
    assert!(bench.run(&["sample", "study.toml", "--out", "parts", "--merge"]).status.success());
    assert_eq!(tables("parts"), [train, test]);

    // the domain is what the study states
    assert!(bench.run(&["train", "study.toml", "--out", "whole"]).status.success());
    let surrogate = metafmu::surrogate::load(&bench.path("whole/single-pendulum.safetensors")).unwrap();
    assert_eq!(surrogate.metadata().inputs.iter().map(|input| input.max).collect::<Vec<_>>(), [0.2, 0.15, 5.0, 2.0]);
}
