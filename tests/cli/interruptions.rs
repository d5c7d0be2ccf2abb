//! Builds that Ctrl-C stops at each of their events.

use super::*;
use metafmu::{
    Error,
    pipeline::{
        Built, Control, CountedWork, Event, PipelineObserver, Project, build,
        export::{ExportPlan, ExportRequest},
    },
    study::FmiChoice,
};
use std::sync::{
    Mutex,
    atomic::{AtomicBool, AtomicUsize, Ordering},
};

/// Sets the stop token at an event, and keeps the kinds of the events.
struct Interrupter<'a> {
    stop: &'a AtomicBool,
    at: Option<usize>,
    count: AtomicUsize,
    begun: Mutex<Vec<(usize, CountedWork)>>,
}

impl PipelineObserver for Interrupter<'_> {
    fn event(&self, event: Event<'_>) {
        let place = match event {
            Event::Advance | Event::Progress { .. } => return,
            _ => self.count.fetch_add(1, Ordering::Relaxed),
        };
        if let Event::Begin { work, .. } = event {
            self.begun.lock().unwrap().push((place, work));
        }
        if self.at == Some(place) {
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

struct Outcome {
    built: metafmu::Result<Built>,
    events: usize,
    begun: Vec<(usize, CountedWork)>,
}

/// Builds the study of a folder, and presses Ctrl-C at an event.
fn interrupted(bench: &Bench, out: &str, at: Option<usize>, resume: bool) -> Outcome {
    let stop = AtomicBool::new(false);
    let observer = Interrupter { stop: &stop, at, count: AtomicUsize::new(0), begun: Mutex::default() };
    let program = Path::new(env!("CARGO_BIN_EXE_metafmu"));
    let control = Control { observer: &observer, stop: &stop, program, heard: |_| {} };
    let project = Project::open(&bench.path("study.toml"), Some(&bench.path(out)), control).unwrap();
    let request = ExportRequest { fmi: Some(FmiChoice::Both), ..ExportRequest::default() };
    let plan = ExportPlan::new(&project, &request).unwrap();
    let built = build(&project, &plan, resume);
    Outcome { built, events: observer.count.into_inner(), begun: observer.begun.into_inner().unwrap() }
}

/// Files that the results of an interruption name in parentheses.
fn files(results: &[String]) -> Vec<&str> {
    let names = results.iter().filter_map(|result| result.split_once('(')?.1.strip_suffix(')'));
    names.flat_map(|names| names.split(", ")).collect()
}

#[test]
fn ctrl_c_at_any_event_of_a_build_says_what_is_done_and_missing() {
    let bench = Bench::new();
    let study = small_study() + "[baselines]\nbuild = [\"linear\", \"ridge\"]\n";
    fs::write(bench.path("study.toml"), study).unwrap();
    let whole = interrupted(&bench, "whole", None, false);
    assert!(whole.built.unwrap().interruption.is_none());
    let mut stopped = Vec::new();
    for at in 0..whole.events {
        let out = format!("out-{at}");
        let during = match interrupted(&bench, &out, Some(at), false).built {
            Err(Error::Unfinished { interruption }) => {
                let (done, missing) = (files(&interruption.done), files(&interruption.missing));
                for name in &done {
                    assert!(bench.path(&out).join(name).exists(), "{at}: {name} is done, {interruption}");
                }
                for name in
                    ["test.csv", "single-pendulum.safetensors", "comparison.json", "metrics.json", "report.html"]
                {
                    assert!(done.contains(&name) != missing.contains(&name), "{at}: {name}, {interruption}");
                }
                interruption.during
            }
            Ok(Built { interruption: Some(interruption), .. }) => {
                assert!(interruption.done[0].starts_with("all files"), "{interruption}");
                assert!(bench.path(&out).join("report.html").exists());
                interruption.during
            }
            // nothing was left to be stopped
            Ok(Built { interruption: None, .. }) => continue,
            Err(error) => panic!("{at}: {error}"),
        };
        if stopped.contains(&during) {
            continue;
        }
        stopped.push(during);
        let resumed = interrupted(&bench, &out, None, true);
        assert!(resumed.built.unwrap().interruption.is_none());
        let read = |folder: &str| fs::read(bench.path(folder).join("single-pendulum.fmu")).unwrap();
        assert!(read(&out) == read("whole"), "{at}");
    }
    for work in ["runs were sampled", "the surrogate was trained", "models were compared", "FMUs were validated"] {
        assert!(stopped.iter().any(|during| during == work), "{work}: {stopped:?}");
    }
    assert_eq!(whole.begun.len(), 3, "{:?}", whole.begun);
}

#[cfg(unix)]
#[test]
fn a_stopped_build_ends_with_the_command_that_continues_it() {
    let bench = Bench::new();
    fs::write(bench.path("my study.toml"), small_study().replace("levels = 3", "levels = 40")).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_metafmu"));
    command.args(["build", "my study.toml", "--fmi", "3"]).current_dir(bench.folder.path());
    let mut child = command.stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped()).spawn().unwrap();
    while !bench.path("out/single-pendulum/unfinished-runs.bin").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it was not slow enough to be interrupted");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    let says = stderr(&output);
    assert_eq!(output.status.code(), Some(130), "{says}");
    let expected = "error: stopped by Ctrl-C while runs were sampled\ndone: some of the runs\nmissing: runs (train.csv, test.csv), \
                    surrogate (single-pendulum.safetensors)";
    assert!(says.contains(expected), "{says}");
    assert!(says.ends_with("continue with: metafmu build 'my study.toml' --fmi 3 --resume\n"), "{says}");
}
