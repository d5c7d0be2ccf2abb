//! Reading and checking an interface file, and which columns of a model its variables are.

use super::*;

impl ModelInterface {
    /// Reads and checks an interface file.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read, [`Error::Study`] with every mistake.
    pub fn load(path: &Path) -> Result<Self> {
        Self::parse(&origin::read(path, "an interface in TOML")?, path)
    }

    /// Reads and checks the text of an interface file; `path` is for messages.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake.
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let origin = Origin::new(path, text);
        let root = origin.parse()?;
        let hint = "this is a study, expected an interface: `metafmu import MODEL --new FILE` writes one";
        origin.refuse_section("source", hint)?;
        let (problems, damaged) = origin.structure(root.get_ref(), &SCHEMA, |_, _| None);
        if !damaged.is_empty() || !problems.is_empty() {
            return Err(Error::Study { problems });
        }
        let mut interface: Self = origin.deserialize(root)?;
        interface.origin = origin;
        interface.origin.refuse(interface.problems())?;
        Ok(interface)
    }

    /// Reads an interface from JSON, which another program wrote: problems have keys, but no lines.
    ///
    /// # Errors
    /// [`Error::Study`] with every mistake.
    pub fn from_json(text: &str) -> Result<Self> {
        let origin = Origin::new(Path::new(""), text);
        let mut interface: Self = serde_json::from_str(text).map_err(|error| {
            let message = error.to_string();
            Error::Study { problems: vec![Problem { path: PathBuf::new(), line: 1, key: String::new(), message }] }
        })?;
        interface.origin = origin;
        interface.origin.refuse(interface.problems())?;
        Ok(interface)
    }

    /// The file.
    pub fn path(&self) -> &Path {
        self.origin.path()
    }

    /// Its text.
    pub fn text(&self) -> &str {
        self.origin.text()
    }

    /// Inputs that are variables of the FMU.
    pub fn variables(&self) -> impl Iterator<Item = (&String, &InterfaceInput)> {
        self.inputs.iter().filter(|(_, input)| input.value.is_none())
    }

    /// Fails with problems of keys.
    ///
    /// # Errors
    /// [`Error::Study`] if there are any.
    pub fn refuse(&self, problems: Problems) -> Result<()> {
        self.origin.refuse(problems)
    }

    /// Evolution of the states, if there are any.
    pub fn evolution(&self) -> Option<Evolution> {
        let state = self.states.values().next()?;
        Some(if state.next.is_some() { Evolution::Discrete } else { Evolution::Continuous })
    }

    /// Assigns the variables to the columns of a model, which have these names.
    ///
    /// # Errors
    /// [`Error::Study`] for unknown columns, too few or too many of them, or one that is named twice.
    pub fn mapping(&self, inputs: &[String], outputs: &[String]) -> Result<Mapping> {
        let mut problems = Problems::default();
        self.refuse(self.ambiguous([("inputs", inputs), ("outputs", outputs)]))?;
        let mut sources = vec![ColumnSource::Value(0.0); inputs.len()];
        let states = self.followed(inputs, outputs, &mut sources, &mut problems);
        // remaining columns, for inputs and outputs that do not name their column
        let free: Vec<usize> =
            (0..inputs.len()).filter(|column| !matches!(sources[*column], ColumnSource::State(_))).collect();
        let known: Vec<String> = free.iter().map(|column| inputs[*column].clone()).collect();
        let given = self.inputs.iter().map(|(name, input)| (name.clone(), input.column.clone())).collect();
        let columns = columns("inputs", given, &known, true, &mut problems);
        let of_states: Vec<usize> = states.iter().map(|state| state.output).collect();
        let given: Vec<(String, Option<String>)> =
            self.outputs.iter().map(|(name, output)| (name.clone(), output.column.clone())).collect();
        let shown = if given.iter().all(|(_, column)| column.is_none()) {
            let free: Vec<usize> = (0..outputs.len()).filter(|column| !of_states.contains(column)).collect();
            let known: Vec<String> = free.iter().map(|column| outputs[*column].clone()).collect();
            let columns = self::columns("outputs", given, &known, false, &mut problems);
            columns.into_iter().filter_map(|column| free.get(column).copied().map(OutputSource::Column)).collect()
        } else {
            // a state is shown by either of its columns; of its derivative that is another number
            let mut known = outputs.to_vec();
            let mut meant: Vec<OutputSource> = (0..outputs.len()).map(OutputSource::Column).collect();
            if self.evolution() == Some(Evolution::Discrete) {
                of_states.iter().enumerate().for_each(|(state, column)| meant[*column] = OutputSource::State(state));
            }
            for (column, source) in sources.iter().enumerate() {
                if let ColumnSource::State(state) = source {
                    known.push(inputs[column].clone());
                    meant.push(OutputSource::State(*state));
                }
            }
            let columns = self::columns("outputs", given, &known, false, &mut problems);
            columns.into_iter().map(|column| meant[column]).collect()
        };
        self.origin.refuse(problems)?;
        let mut variable = 0;
        for (column, input) in columns.into_iter().zip(self.inputs.values()) {
            sources[free[column]] = match input.value {
                Some(value) => ColumnSource::Value(value),
                None => {
                    variable += 1;
                    ColumnSource::Input(variable - 1)
                }
            };
        }
        Ok(Mapping { inputs: sources, outputs: shown, states })
    }

    /// Problems of equal column names in the model, if the interface names columns.
    fn ambiguous(&self, ends: [(&str, &[String]); 2]) -> Problems {
        let of_inputs = self.inputs.values().any(|input| input.column.is_some());
        let of_outputs = self.outputs.values().any(|output| output.column.is_some());
        let are_named = [of_inputs, of_outputs].map(|are_named| are_named || !self.states.is_empty());
        let mut problems = Problems::default();
        for ((section, names), _) in ends.into_iter().zip(are_named).filter(|(_, are_named)| *are_named) {
            let mut before = HashSet::new();
            for name in names.iter().filter(|name| !before.insert(name.as_str())) {
                let message = format!(
                    "two columns of the model's {section} are called `{name}`: expected different names, of tensors that are called otherwise"
                );
                problems.add(section, message);
            }
        }
        problems
    }

    /// The columns that are states, which are noted in `sources`.
    fn followed(
        &self,
        inputs: &[String],
        outputs: &[String],
        sources: &mut [ColumnSource],
        problems: &mut Problems,
    ) -> Vec<Followed> {
        let mut states: Vec<Followed> = Vec::new();
        let mut given: HashMap<usize, String> = HashMap::new();
        for (of, (name, state)) in self.states.iter().enumerate() {
            let key = format!("states.{name}");
            let of_inputs = columns_of(&state.column, inputs);
            if of_inputs.is_empty() {
                problems.add(format!("{key}.column"), unknown_column(&state.column, inputs, "inputs"));
            }
            let (field, later) = match (&state.next, &state.derivative) {
                (Some(next), _) => ("next", next),
                (None, Some(derivative)) => ("derivative", derivative),
                (None, None) => continue,
            };
            let of_outputs = columns_of(later, outputs);
            if of_outputs.is_empty() {
                problems.add(format!("{key}.{field}"), unknown_column(later, outputs, "outputs"));
            }
            if of_inputs.is_empty() || of_outputs.is_empty() {
                continue;
            }
            if of_inputs.len() != of_outputs.len() {
                let message = format!(
                    "\"{later}\" has {}, but \"{}\" has {}: expected one for each",
                    counted(of_outputs.len()),
                    state.column,
                    counted(of_inputs.len()),
                );
                problems.add(format!("{key}.{field}"), message);
                continue;
            }
            for (place, (input, output)) in of_inputs.iter().zip(&of_outputs).enumerate() {
                let name = if of_inputs.len() == 1 { name.clone() } else { format!("{name}[{place}]") };
                if let ColumnSource::State(other) = sources[*input] {
                    let other: &Followed = &states[other];
                    let message = format!("\"{}\" is the column of the state `{}` already", inputs[*input], other.name);
                    problems.add(format!("{key}.column"), message);
                    break;
                }
                if let Some(other) = given.insert(*output, name.clone()) {
                    let message = format!("\"{}\" is that of the state `{other}` already", outputs[*output]);
                    problems.add(format!("{key}.{field}"), message);
                    break;
                }
                sources[*input] = ColumnSource::State(states.len());
                states.push(Followed { name, of, output: *output });
            }
        }
        states
    }

    /// Problems of the interface that do not depend on the model.
    fn problems(&self) -> Problems {
        let mut problems = Problems::default();
        let expected = "a letter, then letters, digits, `-` and `_`, at most 100 characters";
        problems.expect(is_good_name(&self.name), "name", format!("`{}`", self.name), expected);
        let InterfaceTime { step, sample, solver_step, stop } = self.time;
        for (key, given) in [("step", step), ("sample", sample), ("solver_step", solver_step), ("stop", Some(stop))] {
            given.into_iter().for_each(|given| problems.expect_positive(format!("time.{key}"), given));
        }
        self.add_problems_of_states(&mut problems);
        if self.variables().next().is_none() && self.states.is_empty() {
            problems.add("inputs", "no input that is a variable, expected at least one");
        }
        for (key, count) in [("inputs", self.inputs.len()), ("outputs", self.outputs.len())] {
            if count > MAX_VARIABLES {
                problems.add(key, format!("{count} {key}, expected at most {MAX_VARIABLES}"));
                return problems;
            }
        }
        if self.outputs.is_empty() {
            problems.add("outputs", "no output, expected at least one");
        }
        let mut time: Option<&str> = None;
        for (name, input) in &self.inputs {
            let key = format!("inputs.{name}");
            // the time is the independent variable, whatever the column is called
            if input.causality != InterfaceCausality::Time {
                check_variable_name(&mut problems, &key, name);
            }
            input.add_problems(&mut problems, &key);
            if input.causality == InterfaceCausality::Time
                && let Some(other) = time.replace(name)
            {
                problems.add(format!("{key}.causality"), format!("\"time\", but `{other}` is the time already"));
            }
        }
        for (name, output) in &self.outputs {
            let key = format!("outputs.{name}");
            check_variable_name(&mut problems, &key, name);
            if self.inputs.contains_key(name) {
                problems.add(&key, format!("`{name}` is an input already: names of variables must be unique"));
            }
            check_text(&mut problems, &key, &output.unit, &output.description);
        }
        problems
    }

    fn add_problems_of_states(&self, problems: &mut Problems) {
        let InterfaceTime { solver_step, .. } = self.time;
        let is_continuous = self.evolution() == Some(Evolution::Continuous);
        problems.expect_absent(
            solver_step.is_some() && !is_continuous,
            "time.solver_step",
            "belongs to states that have a `derivative`",
        );
        problems.expect_absent(
            self.time.sample.is_some() && is_continuous,
            "time.sample",
            "belongs to states that have a `next` value",
        );
        for (name, state) in &self.states {
            let key = format!("states.{name}");
            let InterfaceState { column, next, derivative, start, min, max, unit, description } = state;
            check_variable_name(problems, &key, name);
            check_text(problems, &key, unit, description);
            if column.is_empty() {
                problems.add(&key, "no `column`, expected one of the model's inputs");
            }
            match (next, derivative) {
                (None, None) => problems.add(
                    &key,
                    "neither `next` nor `derivative`, expected the column of the model's outputs that is one of them",
                ),
                (Some(_), Some(_)) => problems.add(&key, "both `next` and `derivative`, expected one of them"),
                (_, Some(_)) if !is_continuous => {
                    problems.add(
                        format!("{key}.derivative"),
                        "other states have a `next` value: expected one kind of states",
                    );
                }
                (Some(_), _) if is_continuous => {
                    problems
                        .add(format!("{key}.next"), "other states have a `derivative`: expected one kind of states");
                }
                _ => {}
            }
            if start.is_none() {
                problems.add(&key, "no `start`, expected its value at the start");
            }
            for (field, given) in [("min", min), ("max", max), ("start", start)] {
                if let Some(number) = given.filter(|number| !number.is_finite()) {
                    problems.add(format!("{key}.{field}"), format!("{number}, expected a finite number"));
                }
            }
            for (field, given) in [("min", min), ("max", max)] {
                problems.expect_absent(
                    given.is_some() && next.is_some(),
                    format!("{key}.{field}"),
                    "belongs to a state that has a `derivative`",
                );
            }
            if min.is_some() != max.is_some() && next.is_none() {
                problems.add(&key, "one of `min` and `max`, expected both or none");
            }
            if let (Some(min), Some(max)) = (min, max)
                && min > max
            {
                problems.add(format!("{key}.max"), format!("{max}, expected at least min, which is {min}"));
            }
            if self.inputs.contains_key(name) {
                problems.add(&key, format!("`{name}` is an input already: names of variables must be unique"));
            }
        }
        if self.evolution() == Some(Evolution::Discrete) && self.time.sample.is_none() {
            problems.add("time.sample", NO_SAMPLE_TIME);
        }
        let of_time = self.inputs.iter().find(|(_, input)| input.causality == InterfaceCausality::Time);
        if let (Some((name, _)), false) = (of_time, self.states.is_empty()) {
            let message = "\"time\", of a model with states, which follow from inputs and parameters: expected an input, or one with a `value`";
            problems.add(format!("inputs.{name}.causality"), message);
        }
    }
}

/// Returns true if a name is fit for a file, too.
fn is_good_name(name: &str) -> bool {
    name.starts_with(|first: char| first.is_ascii_alphabetic())
        && name.chars().all(|other| other.is_ascii_alphanumeric() || matches!(other, '-' | '_'))
        && name.len() <= MAX_NAME
}

/// Message on a column that the model does not have.
fn unknown_column(column: &str, known: &[String], section: &str) -> String {
    let mut names: Vec<&str> = known.iter().map(String::as_str).collect();
    names.extend(whole(known));
    format!("\"{column}\" is no column of the model's {section}, {}", expected_one_of(column, &names))
}

/// Message for discrete states without a sample time.
pub const NO_SAMPLE_TIME: &str = "is missing: expected the time between a state and its next value, in seconds";

fn counted(columns: usize) -> String {
    if columns == 1 { "1 column".into() } else { format!("{columns} columns") }
}

/// Positions of the columns that a name stands for: one, or all of an input or output of several.
fn columns_of(name: &str, known: &[String]) -> Vec<usize> {
    if let Some(place) = known.iter().position(|known| known == name) {
        return vec![place];
    }
    let is_part =
        |known: &str| known.strip_prefix(name).is_some_and(|rest| rest.starts_with('[') && rest.ends_with(']'));
    (0..known.len()).filter(|place| is_part(&known[*place])).collect()
}

/// Names of inputs or outputs that have several columns.
fn whole(known: &[String]) -> Vec<&str> {
    let mut names: Vec<&str> =
        known.iter().filter_map(|name| name.strip_suffix(']')?.rsplit_once('[').map(|(name, _)| name)).collect();
    names.dedup();
    names
}

impl InterfaceInput {
    fn add_problems(&self, problems: &mut Problems, key: &str) {
        let Self { causality, variability, min, max, start, value, .. } = self;
        check_text(problems, key, &self.unit, &self.description);
        for (field, given) in [("min", min), ("max", max), ("start", start), ("value", value)] {
            if let Some(number) = given.filter(|number| !number.is_finite()) {
                problems.add(format!("{key}.{field}"), format!("{number}, expected a finite number"));
            }
        }
        if value.is_some() {
            for (field, given) in [("min", min.is_some()), ("max", max.is_some()), ("start", start.is_some())] {
                problems.expect_absent(
                    given,
                    format!("{key}.{field}"),
                    "belongs to a variable, which an input with a `value` is not",
                );
            }
        }
        if let (Some(min), Some(max)) = (min, max)
            && min > max
        {
            problems.add(format!("{key}.max"), format!("{max}, expected at least min, which is {min}"));
        }
        if let (Some(start), Some(min), Some(max)) = (start, min, max)
            && min <= max
            && !(min..=max).contains(&start)
        {
            problems.add(format!("{key}.start"), format!("{start}, expected a value from {min} to {max}"));
        }
        let is_time = *causality == InterfaceCausality::Time;
        problems.expect(
            !is_time || matches!(self.unit.as_str(), "" | "s"),
            format!("{key}.unit"),
            format!("\"{}\"", self.unit),
            "\"s\", as hosts give the time in seconds",
        );
        if variability.is_some() && *causality != InterfaceCausality::Parameter {
            problems.add(format!("{key}.variability"), "belongs to causality = \"parameter\"");
        }
    }
}

/// Units and descriptions are single lines.
fn check_text(problems: &mut Problems, key: &str, unit: &str, description: &str) {
    for (field, text) in [("unit", unit), ("description", description)] {
        if text.chars().any(char::is_control) {
            problems.add(format!("{key}.{field}"), "has a control character, expected one line of text");
        }
    }
}

/// The position of each variable's column.
fn columns(
    section: &str,
    given: Vec<(String, Option<String>)>,
    known: &[String],
    all: bool,
    problems: &mut Problems,
) -> Vec<usize> {
    let names: Vec<&str> = known.iter().map(String::as_str).collect();
    let count =
        |what: &str| format!("{} {section}, but the model has {} columns of {section}{what}", given.len(), known.len());
    if given.iter().all(|(_, column)| column.is_none()) {
        if given.len() > known.len() || (all && given.len() < known.len()) {
            problems.add(section, count(": expected one for each"));
        } else if given.len() < known.len() {
            problems.add(section, count(": expected one for each, or `column` in each of them"));
        }
        let named: Vec<&str> = given.iter().map(|(name, _)| name.as_str()).collect();
        if let Some(problem) = out_of_order_problem(("the interface", &named), ("the model", &names)) {
            problems.add(section, format!("{problem}, by `column` in each of them"));
        }
        return (0..given.len()).collect();
    }
    let places: HashMap<&str, usize> = names.iter().enumerate().map(|(place, name)| (*name, place)).collect();
    let mut found: Vec<usize> = Vec::new();
    let mut first: HashMap<usize, &str> = HashMap::new();
    for (name, column) in &given {
        let key = format!("{section}.{name}");
        let Some(column) = column else {
            problems.add(key, "no `column`, which others have: expected one in each of them or in none");
            continue;
        };
        match places.get(column.as_str()).copied() {
            None => {
                let expected = expected_one_of(column, &names);
                problems.add(
                    format!("{key}.column"),
                    format!("\"{column}\" is no column of the model's {section}, {expected}"),
                );
            }
            Some(place) => {
                let other = *first.entry(place).or_insert(name);
                if all && other != name {
                    let message = format!("\"{column}\" is the column of `{other}` already");
                    problems.add(format!("{key}.column"), message);
                }
                found.push(place);
            }
        }
    }
    if all {
        let missing: Vec<&str> =
            (0..known.len()).filter(|place| !first.contains_key(place)).map(|place| names[place]).collect();
        if !missing.is_empty() && problems.is_empty() {
            let missing = crate::diagnostics::names::listed(&missing);
            problems.add(
                section,
                format!("no input for the columns {missing}: expected one for each, or one with a `value`"),
            );
        }
    }
    found
}
