//! Mistakes of a study that is not written yet, located in what the user has: the table, the FMU or the mechanism.

use crate::cli::NewArgs;
use metafmu::{
    Error,
    diagnostics::{Place, problem::Problem},
    fmi::host::describe,
    table::Table,
};
use std::path::PathBuf;

/// Sections of a study whose keys are names of the source.
const SECTIONS: [&str; 4] = ["parameters", "inputs", "states", "outputs"];

/// Source of a study, with the names of its columns or variables.
struct NamedSource {
    path: PathBuf,
    /// Line of the names; 0 if the source has none.
    line: usize,
    /// Kind of the names: of columns or of variables.
    kind: &'static str,
    names: Vec<String>,
}

/// An error of a study, with its problems located in the source that it was proposed for.
pub fn in_source(error: Error, args: &NewArgs) -> Error {
    match (error, NamedSource::of(args)) {
        (Error::Study { problems }, Some(source)) => {
            Error::Study { problems: problems.into_iter().map(|problem| source.locate(problem)).collect() }
        }
        (error, _) => error,
    }
}

impl NamedSource {
    fn of(args: &NewArgs) -> Option<Self> {
        if let Some(path) = &args.table {
            let table = Table::open(path).ok()?;
            let line = if matches!(table.place(), Place::Line(_)) { 1 } else { 0 };
            let names = table.columns().iter().map(|column| column.name.clone()).collect();
            return Some(Self { path: path.clone(), line, kind: "column", names });
        }
        if let Some(path) = &args.fmu {
            let (description, _) = describe(path, None).ok()?;
            let names = description.variables.into_iter().map(|variable| variable.name).collect();
            return Some(Self { path: path.clone(), line: 0, kind: "variable", names });
        }
        let path = match &args.mechanism {
            Some(path) => path.clone(),
            None if args.command.is_empty() => return None,
            None => args.command.join(" ").into(),
        };
        Some(Self { path, line: 0, kind: "", names: Vec::new() })
    }

    /// Problem of a key of the study, such as `outputs.x.unit`: of the column or variable `x`, if there is one.
    fn locate(&self, problem: Problem) -> Problem {
        let Problem { key, message, .. } = problem;
        let of_names = key.split_once('.').filter(|(section, _)| SECTIONS.contains(section));
        let name = of_names.and_then(|(_, rest)| self.name_in(rest));
        let key = name.map_or(key.clone(), |name| format!("{} `{name}`", self.kind));
        Problem { path: self.path.clone(), line: self.line, key, message }
    }

    /// The longest name that the end of a key begins with. `time` and `run` are `time_` and `run_` in a study of rows.
    fn name_in(&self, rest: &str) -> Option<&str> {
        let begins = |name: &&String| {
            let end = rest.strip_prefix(name.as_str());
            let end = end.map(|end| end.strip_prefix('_').unwrap_or(end));
            end.is_some_and(|end| end.is_empty() || end.starts_with('.'))
        };
        self.names.iter().filter(begins).max_by_key(|name| name.len()).map(String::as_str)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn problems_of_a_proposal_are_those_of_columns_and_variables() {
        let names = ["x", "x.y", "time", "step"].map(str::to_owned).to_vec();
        let table = NamedSource { path: "runs.csv".into(), line: 1, kind: "column", names };
        let located = |key: &str| {
            let problem = Problem { path: "new.toml".into(), line: 7, key: key.into(), message: "wrong".into() };
            table.locate(problem).to_string()
        };
        assert_eq!(located("outputs.x"), "runs.csv:1: column `x`: wrong");
        assert_eq!(located("inputs.x.y.min"), "runs.csv:1: column `x.y`: wrong");
        assert_eq!(located("inputs.time_"), "runs.csv:1: column `time`: wrong");
        assert_eq!(located("time.step"), "runs.csv:1: time.step: wrong");
        let fmu = NamedSource { path: "model.fmu".into(), line: 0, kind: "variable", names: vec!["x".into()] };
        let problem = Problem { path: "new.toml".into(), line: 7, key: "outputs.x".into(), message: "wrong".into() };
        assert_eq!(fmu.locate(problem).to_string(), "model.fmu: variable `x`: wrong");
    }
}
