//! A search over the keys of a study file: its trials, their rungs, and their selection.
//!
//! Everything follows from the study: the same study has the same trials. Their selection depends on their scores
//! alone, not on the order in which they end.

use crate::{
    Error, Result,
    diagnostics::Problems,
    sampling::{self, Stream},
    source::Source,
    study::{SearchMethod, SearchOptions, Space, Study, set},
};
use rand::RngExt;
use std::path::Path;
use toml::Value;

/// The values of every trial, in the order of the keys of `search.space`.
pub fn trials(options: &SearchOptions, seed: u64) -> Vec<Vec<Value>> {
    if options.method == SearchMethod::Grid {
        return options.space.values().fold(vec![Vec::new()], |trials, space| {
            let values = grid(space);
            trials
                .iter()
                .flat_map(|trial| {
                    let trial = trial.clone();
                    values
                        .iter()
                        .map(move |value| [&trial[..], std::slice::from_ref(value)].concat())
                        .collect::<Vec<_>>()
                })
                .collect()
        });
    }
    let mut random = sampling::random(seed, Stream::Search);
    let trials = 0..options.trials.unwrap_or(0);
    trials.map(|_| options.space.values().map(|space| value_at(space, random.random())).collect()).collect()
}

/// The value of a space at a share of it.
fn value_at(space: &Space, share: f64) -> Value {
    match space {
        Space::Values(values) => values[((share * values.len() as f64) as usize).min(values.len() - 1)].clone(),
        Space::Range(range) => range.at(share),
    }
}

fn grid(space: &Space) -> Vec<Value> {
    match space {
        Space::Values(values) => values.clone(),
        Space::Range(range) => {
            let levels = range.levels.unwrap_or(2);
            (0..levels).map(|level| range.at(level as f64 / (levels - 1) as f64)).collect()
        }
    }
}

/// The share of its epochs that a trial has done at the end of each rung; the last is 1.
pub fn rungs(options: &SearchOptions) -> Vec<f64> {
    let rungs = if options.method == SearchMethod::Halving { options.rungs } else { 1 };
    (0..rungs).rev().map(|left| (options.reduction as f64).powi(-(left as i32))).collect()
}

/// Trials that continue after a rung: the best one in `reduction` of the scores, the smaller the better, and at least
/// one. Trials without a score do not. In ascending order.
pub fn survivors(scores: &[(usize, Option<f64>)], reduction: usize) -> Vec<usize> {
    let mut scored: Vec<(usize, f64)> = scores.iter().filter_map(|&(trial, score)| Some((trial, score?))).collect();
    scored.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
    scored.truncate(scores.len().div_ceil(reduction).max(1));
    let mut trials: Vec<usize> = scored.into_iter().map(|(trial, _)| trial).collect();
    trials.sort_unstable();
    trials
}

/// A file beside the one at `path`, as an absolute path.
fn absolute(path: &Path, file: &str) -> Result<String> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let absolute = std::path::absolute(folder.join(file)).map_err(Error::io(path, "resolve"))?;
    Ok(absolute.to_string_lossy().into_owned())
}

/// Text of a study with other values. `[search]` is removed, and relative paths become absolute ones, so that the text
/// may lie anywhere.
///
/// # Errors
/// [`Error::Study`] if a key leads through something that is not a table.
pub fn study_text(text: &str, path: &Path, keys: &[&str], values: &[Value]) -> Result<String> {
    // the study has been read already
    let mut root: toml::Table = text.parse().unwrap_or_default();
    root.remove("search");
    let folder = path.parent().unwrap_or(Path::new(""));
    let keys_of_files = ["mechanism", "fmu", "table", "index", "command", "files"].map(|key| ("source", key));
    for (section, key) in keys_of_files.into_iter().chain([("sampling", "file")]) {
        match root.get_mut(section).and_then(|section| section.get_mut(key)) {
            Some(Value::String(file)) => *file = absolute(path, file)?,
            Some(Value::Array(arguments)) => {
                let files = arguments.iter_mut().filter_map(|argument| match argument {
                    Value::String(argument) if key == "files" || folder.join(&*argument).is_file() => Some(argument),
                    _ => None,
                });
                for file in files {
                    *file = absolute(path, file)?;
                }
            }
            _ => {}
        }
    }
    for (key, value) in keys.iter().zip(values) {
        set(&mut root, key, value.clone()).ok_or_else(|| {
            let message = "leads through something that is not a table".to_owned();
            let problem = crate::diagnostics::problem::Problem {
                path: path.to_owned(),
                line: 1,
                key: format!("search.space.{key}"),
                message,
            };
            Error::Study { problems: vec![problem] }
        })?;
    }
    Ok(root.to_string())
}

/// Fails if a value of the space, or an end of one of its ranges, is invalid in every study, alone and with values of
/// other keys.
///
/// # Errors
/// [`Error::Study`] with every such value.
pub fn check(study: &Study) -> Result<()> {
    let Some(options) = &study.search else { return Ok(()) };
    let mut problems = Problems::default();
    for (key, space) in &options.space {
        for choice in space.choices() {
            let Err(error) = trial(study, &[key], std::slice::from_ref(&choice)) else { continue };
            let pairs = options.space.iter().filter(|(other, _)| *other != key).flat_map(|(other, space)| {
                space
                    .choices()
                    .into_iter()
                    .map(|value| (vec![key.as_str(), other.as_str()], vec![choice.clone(), value]))
            });
            let whole = trials(options, study.seed).into_iter().take(TRIES).map(|mut values| {
                let keys: Vec<&str> = options.space.keys().map(String::as_str).collect();
                let place = options.space.get_index_of(key).unwrap_or_default();
                values[place] = choice.clone();
                (keys, values)
            });
            if !pairs.chain(whole).any(|(keys, values)| trial(study, &keys, &values).is_ok()) {
                problems.add(format!("search.space.{key}"), format!("{choice}: {}", reasons(&error)));
            }
        }
    }
    study.refuse(problems)
}

/// Trials beside whose values a value is tried.
const TRIES: usize = 10;

/// The study with other values.
fn trial(study: &Study, keys: &[&str], values: &[Value]) -> Result<Study> {
    let (path, text) = study.file();
    let trial = Study::parse(&study_text(text, path, keys, values)?, path)?;
    // of the same samples the source is the same
    if trial.sampling_digest() != study.sampling_digest() {
        Source::new(&trial)?;
    }
    Ok(trial)
}

/// Values and studies of all trials, or the reason why a trial is invalid: values may be valid but not fit together.
///
/// # Errors
/// [`Error::Study`] if the study has no search.
pub fn studies(study: &Study) -> Result<Vec<(Vec<Value>, Result<Study>)>> {
    let Some(options) = &study.search else {
        return Err(study.refusal("search", "missing: `metafmu search` needs it to know what to try"));
    };
    let keys: Vec<&str> = options.space.keys().map(String::as_str).collect();
    Ok(trials(options, study.seed)
        .into_iter()
        .map(|values| {
            let trial = trial(study, &keys, &values);
            (values, trial)
        })
        .collect())
}

/// Problems of a study, without the lines of its generated text.
fn reasons(error: &Error) -> String {
    match error {
        Error::Study { problems } => {
            let reasons: Vec<String> = problems.iter().map(|p| format!("{}: {}", p.key, p.message)).collect();
            reasons.join("; ")
        }
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostics::KeyProblem;

    const STUDY: &str = include_str!("../examples/single-pendulum.toml");

    fn options(text: &str) -> SearchOptions {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn files_of_a_program_are_found_from_other_folders() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("model.py"), "").unwrap();
        let text = "[source]\ncommand = [\"python\", \"model.py\", \"contact\"]\nfiles = [\"arm.xml\"]\n";
        let found = study_text(text, &folder.path().join("study.toml"), &[], &[]).unwrap();
        let found: toml::Table = found.parse().unwrap();
        let absolute = |name: &str| folder.path().join(name).to_string_lossy().into_owned();
        assert_eq!(
            found["source"]["command"],
            Value::from(["python".to_owned(), absolute("model.py"), "contact".into()].to_vec())
        );
        assert_eq!(found["source"]["files"], Value::from([absolute("arm.xml")].to_vec()));
    }

    #[test]
    fn a_grid_is_every_combination_with_both_ends_of_its_ranges() {
        let options = options(
            "method = 'grid'\n[space]\n'training.batch' = [64, 256]\n\
             'training.learning_rate' = { min = 1e-4, max = 1e-2, scale = 'log', levels = 3 }",
        );
        assert!(options.problems().is_empty());
        let found = trials(&options, 1);
        assert_eq!(found.len(), 6);
        let rates: Vec<f64> = found[..3].iter().map(|trial| trial[1].as_float().unwrap()).collect();
        assert!(found[..3].iter().all(|trial| trial[0] == Value::Integer(64)));
        for (found, expected) in rates.iter().zip([1e-4, 1e-3, 1e-2]) {
            assert!((found / expected - 1.0).abs() < 1e-12, "{rates:?}");
        }
    }

    #[test]
    fn random_trials_are_those_of_the_seed_and_stay_in_their_ranges() {
        let options = options(
            "method = 'random'\ntrials = 200\n[space]\n'training.batch' = { min = 10, max = 12 }\n'a.b' = { min = 0.5, max = 2.0 }",
        );
        let found = trials(&options, 7);
        assert_eq!(found, trials(&options, 7));
        assert_ne!(found, trials(&options, 8));
        for batch in 10..=12 {
            assert!(found.iter().any(|trial| trial[0] == Value::Integer(batch)));
        }
        assert!(found.iter().all(|trial| (0.5..=2.0).contains(&trial[1].as_float().unwrap())));
        let longer = trials(&SearchOptions { trials: Some(300), ..options }, 7);
        assert_eq!(found[..], longer[..200], "more trials begin with the same");
    }

    #[test]
    fn the_better_ones_go_on_whatever_the_order_and_failures_do_not() {
        let scores =
            [(0, Some(0.3)), (1, None), (2, Some(0.1)), (3, Some(0.2)), (4, Some(0.1)), (5, Some(f64::INFINITY))];
        assert_eq!(survivors(&scores, 3), [2, 4]);
        let mut reversed = scores;
        reversed.reverse();
        assert_eq!(survivors(&reversed, 3), [2, 4]);
        assert_eq!(survivors(&[(7, Some(1.0))], 3), [7]);
        assert_eq!(survivors(&[(7, None)], 3), Vec::<usize>::new());
    }

    #[test]
    fn rungs_end_with_all_epochs() {
        let options = options("trials = 9\nrungs = 3\nreduction = 4\n[space]\n'training.batch' = [1]");
        assert_eq!(rungs(&options), [1.0 / 16.0, 0.25, 1.0]);
        assert_eq!(rungs(&SearchOptions { method: SearchMethod::Random, ..options }), [1.0]);
    }

    #[test]
    fn a_trial_is_the_study_with_its_values() {
        let text = format!(
            "{STUDY}\n[search]\ntrials = 2\nmethod = 'random'\n[search.space]\n'network.hidden' = [[5, 6]]\n'training.batch' = [7]\n'training.optimiser' = ['adam']"
        );
        let path = Path::new("study.toml");
        let message = Study::parse(&text, path).unwrap_err().to_string();
        let says = "study.toml:";
        assert!(
            message.starts_with(says) && message.contains("search.space.training.optimiser: unknown key `optimiser`"),
            "{message}"
        );
        let text = text.replace("'training.optimiser' = ['adam']", "'export.author' = ['A']");
        let study = Study::parse(&text, path).unwrap();
        let trial = studies(&study).unwrap().swap_remove(0).1.unwrap();
        assert_eq!((trial.network.hidden, trial.training.batch), (vec![5, 6], 7));
        assert_eq!(trial.sampling, study.sampling);
        assert!(trial.search.is_none());
    }

    #[test]
    fn every_value_of_a_space_is_checked_and_those_that_do_not_go_together_are_trials_that_fail() {
        let path = Path::new("study.toml");
        let of = |space: &str| {
            let text = format!("{STUDY}\n[search]\nmethod = 'grid'\n[search.space]\n{space}\n");
            let study = Study::parse(&text, path).map_err(|error| error.to_string())?;
            check(&study).and_then(|()| studies(&study)).map_err(|error| error.to_string())
        };
        let wrong = of("'network.activation' = ['tanh', 'rele']").unwrap_err();
        let says = "search.space.network.activation: \"rele\", expected one of";
        assert!(wrong.starts_with("study.toml:") && wrong.contains(says), "{wrong}");
        let wrong = of("'training.dropout' = { min = 0.0, max = 2.0, levels = 2 }\n\
                        'parameters.L.max' = [0.2, 0.01]\n'source.constants.M' = [1.0]")
        .unwrap_err();
        let lines: Vec<&str> = wrong.lines().collect();
        assert_eq!(lines.len(), 3, "{wrong}");
        for (line, says) in lines.iter().zip([
            "search.space.training.dropout: 2.0: training.dropout: 2, expected a share of at least 0 and below 1",
            "search.space.parameters.L.max: 0.01: parameters.L: range is empty: min 0.1 is not below max 0.01",
            "search.space.source.constants.M: 1.0: source.constants.M: single-pendulum has no quantity `M`",
        ]) {
            assert!(line.starts_with("study.toml:") && line.contains(says), "{says} is not in {line}");
        }
        // a weight decay is fine with one of the two optimizers, of which neither is the study's
        let found = of("'training.optimizer' = ['rmsprop', 'soap']\n'training.weight_decay' = [0.0, 0.01]").unwrap();
        let fit: Vec<bool> = found.iter().map(|(_, study)| study.is_ok()).collect();
        assert_eq!(fit, [true, false, true, true]);
    }

    #[test]
    fn what_cannot_be_searched_is_said() {
        for (text, key, message) in [
            ("trials = 2\n[space]", "space", "no key"),
            ("[space]\na = [1]", "trials", "missing"),
            ("method = 'grid'\ntrials = 3\n[space]\na = [1]", "trials", "as many trials as points"),
            ("method = 'grid'\n[space]\na = { min = 1, max = 2 }", "space.a", "needs `levels`"),
            ("trials = 2\n[space]\na = { min = 2, max = 1 }", "space.a", "empty"),
            ("trials = 2\n[space]\na = { min = 0, max = 1, scale = 'log' }", "space.a", "above 0"),
            ("trials = 2\n[space]\na = []", "space.a", "no values"),
            ("trials = 2\nreduction = 1\n[space]\na = [1]", "reduction", "at least 2"),
            ("trials = 2\nrungs = 4000000000\n[space]\na = [1]", "rungs", "1 to 20"),
            ("trials = 1000000000000\n[space]\na = [1]", "trials", "2 to 10000"),
            ("trials = 2\n[space]\n'search.trials' = [1]", "space.search.trials", "a trial is no search"),
            (
                "method = 'grid'\n[space]\na = { min = 1, max = 2, levels = 200 }\nb = { min = 1, max = 2, levels = 200 }",
                "space",
                "40000 trials, expected at most 10000",
            ),
            (
                "trials = 2\nmodel = 'ridge'\n[space]\n'training.epochs' = [1]",
                "space.training.epochs",
                "decides nothing",
            ),
            (
                "trials = 2\nmodel = 'ridge'\n[space]\n'baselines.svr.c' = [1]",
                "space.baselines.svr.c",
                "decides nothing",
            ),
        ] {
            let problems: Vec<KeyProblem> = options(text).problems().into_iter().collect();
            assert!(
                problems.len() == 1 && problems[0].key == key && problems[0].message.contains(message),
                "{text}: {problems:?}"
            );
        }
    }
}
