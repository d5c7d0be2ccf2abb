//! A study on its way from the text: every mistake is found before it is refused.

use super::{
    SCHEMA, SmallNetworks, Study, StudyStructure, TimeOptions,
    kinds::{GivenKeys, states},
};
use crate::{
    Error, Result,
    diagnostics::{
        KeyProblem, Problems,
        origin::{self, Origin},
        problem::Problem,
    },
};
use std::path::Path;
use toml::{Spanned, de::DeTable};

/// A study that was read, and every mistake found on the way.
#[derive(Debug)]
pub struct Draft {
    study: Study,
    problems: Vec<Problem>,
    /// `true` if source, parameters and outputs were read: then the source can check their names.
    names_are_known: bool,
}

impl Draft {
    /// Reads a study file, and the files it names.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] if it is not TOML at all.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "a study in TOML")?, path)
    }

    /// Reads a study file whose table may not exist yet.
    ///
    /// # Errors
    /// Those of [`Draft::load`].
    pub fn load_without_table(path: &Path) -> Result<Self> {
        Self::read(&origin::read(path, "a study in TOML")?, path, true)
    }

    /// Reads a study file's text, and the files it names; `path` is for messages and tells the folder.
    ///
    /// # Errors
    /// [`Error::Study`] if it is not TOML, or a file of another kind.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        Self::read(text, path, false)
    }

    fn read(text: &str, path: &Path, may_lack_table: bool) -> Result<Self> {
        let origin = Origin::new(path, text);
        let mut root = origin.parse()?;
        let hint = "this is a mechanism, expected a study: `metafmu new NAME --mechanism FILE` writes one";
        origin.refuse_section("bodies", hint)?;
        states::join_names(root.get_mut());
        let (mut problems, mut damaged) = origin.structure(root.get_ref(), &SCHEMA, |_, _| None);
        let is_given = |section: &str| root.get_ref().contains_key(section);
        let structure = root.get_ref().get("structure").and_then(|name| name.get_ref().as_str());
        let structure = structure.and_then(StudyStructure::named).unwrap_or_default();
        let refused = structure.kind().refused(&is_given);
        if !(structure.runs().are_rows || is_given("time")) {
            let message = "`time` is missing".into();
            problems.push(Problem { path: path.to_owned(), line: 1, key: String::new(), message });
            damaged.push("time".into());
        }
        replace(&mut root, &damaged);
        let given = given_keys(root.get_ref());
        let mut study: Study = origin.deserialize(root)?;
        study.origin = origin.clone();
        study.has_epochs = given.epochs;
        study.small_networks = SmallNetworks::of(given.hidden, given.training);
        study.structure.kind().set_defaults(&mut study, given);
        // what a damaged section says is unknown: the other ones are checked without it
        let is_damaged = |section: &str| damaged.iter().any(|damaged| damaged == section);
        let of_section = |problem: &KeyProblem| problem.key.split('.').next().unwrap_or_default().to_owned();
        let mut found: Problems =
            study.section_problems().into_iter().filter(|problem| !is_damaged(&of_section(problem))).collect();
        found.extend(refused);
        let has_problems =
            |section: &str| is_damaged(section) || found.iter().any(|problem| of_section(problem) == section);
        let (source, sampling) = (has_problems("source"), has_problems("sampling") || has_problems("parameters"));
        let mut names_are_known = !source && !["parameters", "outputs", "arrays"].into_iter().any(is_damaged);
        let time_is_known = !has_problems("time");
        let mut is_complete = damaged.is_empty();
        if !source {
            names_are_known &= study.load_source(&mut found, &mut problems, may_lack_table);
            study.order_states();
            names_are_known &= is_damaged("states") || study.load_ranges(&mut found);
            is_complete &= names_are_known;
        }
        if !sampling {
            is_complete &= study.load_points(&mut found);
        }
        is_complete &= study.load_recordings(&mut found);
        if is_complete {
            found.extend(study.problems_beside());
        }
        problems.extend(origin.locate(found));
        if !time_is_known {
            study.time = PLACEHOLDER_TIME;
        }
        Ok(Self { study, problems, names_are_known })
    }

    /// The study, as far as it can be asked for its names; none if source, parameters or outputs are not known. Other values may be
    /// wrong.
    pub fn names(&self) -> Option<&Study> {
        self.names_are_known.then_some(&self.study)
    }

    /// Returns true if the study has no mistakes.
    pub fn is_valid(&self) -> bool {
        self.problems.is_empty()
    }

    /// Adds what is wrong with the source that the study names.
    pub fn add(&mut self, error: Error) {
        match error {
            Error::Study { problems } => self.problems.extend(problems),
            other => {
                let key = self.study.source.key();
                self.problems.extend(self.study.origin.locate(Problems::one(key, other.to_string())));
            }
        }
    }

    /// The study, if nothing is wrong.
    ///
    /// # Errors
    /// [`Error::Study`] with every problem, in the order of the lines.
    pub fn finish(self) -> Result<Study> {
        let Self { study, mut problems, .. } = self;
        if problems.is_empty() {
            return Ok(study);
        }
        // those of the study's own file first
        problems.sort_by_key(|problem| (problem.path != study.origin.path(), problem.line));
        Err(Error::Study { problems })
    }
}

/// Valid sections in place of damaged ones, so that the other mistakes can be found.
pub(super) const PLACEHOLDER: &str = "name = 'study'\nsource = { system = 'none' }\ntime = { stop = 1, step = 1 }\n\
                           parameters = { p = { min = 0, max = 1 } }\noutputs = { y = {} }\nsampling = {}\n";

const PLACEHOLDER_TIME: TimeOptions = TimeOptions { stop: 1.0, step: 1.0, margin: 0.0 };

fn given_keys(root: &DeTable<'_>) -> GivenKeys {
    GivenKeys {
        network: root.contains_key("network"),
        hidden: gives(root, "network", "hidden"),
        training: root.contains_key("training"),
        epochs: gives(root, "training", "epochs"),
        clip_norm: gives(root, "training", "clip_norm"),
        schedule: gives(root, "training", "schedule"),
        batch: gives(root, "training", "batch"),
    }
}

/// Returns true if a section of a study has a key.
fn gives(root: &DeTable<'_>, section: &str, key: &str) -> bool {
    let section = root.get(section).and_then(|section| section.get_ref().as_table());
    section.is_some_and(|section| section.contains_key(key))
}

fn replace(root: &mut Spanned<DeTable<'_>>, sections: &[String]) {
    let placeholder = DeTable::parse(PLACEHOLDER).map(Spanned::into_inner).unwrap_or_default();
    for section in sections {
        root.get_mut().remove(section.as_str());
    }
    let good = placeholder.into_iter().filter(|(name, _)| sections.iter().any(|section| name.get_ref() == section));
    root.get_mut().extend(good);
}
