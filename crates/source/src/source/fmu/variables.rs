//! Which of an FMU's variables can be what in a study.

use super::super::{
    driven::{Driven, OwnInput},
    wrong_unit,
};
use crate::{
    Result,
    diagnostics::{
        Problems,
        names::{did_you_mean, expected_one_of},
        numbers::ends,
    },
    fmi::{
        ModelDescription,
        host::{InterfaceKind, NO_EQUATIONS, element_names},
        model_description::{self as fmi, Causality, Initial, ScalarVariable, VariableType},
        worker::sampling::{self, SamplingTask},
    },
    study::Study,
    variable::SourceVariable,
};
use std::fmt;

/// A study's names found in an FMU.
pub struct Resolved {
    /// In the study's order.
    pub parameters: Vec<SourceVariable>,
    /// In the study's order.
    pub outputs: Vec<SourceVariable>,
    /// Variables that are set and recorded; the rest is not filled in.
    pub task: SamplingTask,
    /// Initial states of the runs, and inputs that drive them, if there are any.
    pub driven: Option<Driven>,
}

/// Finds a study's parameters, constants and outputs.
///
/// # Errors
/// [`Error::Study`](crate::Error::Study) with every problem.
pub fn resolve(study: &Study, description: &ModelDescription) -> Result<Resolved> {
    let task = SamplingTask {
        path: Default::default(),
        interface: InterfaceKind::CoSimulation,
        stop: 0.0,
        step: 0.0,
        tolerance: None,
        steps_per_row: 1,
        variables: Vec::new(),
        is_input: Vec::new(),
        constants: Vec::new(),
        recorded: Vec::new(),
        outputs: Vec::new(),
        driven: None,
    };
    let mut resolver = Resolver { study, description, parameters: Vec::new(), outputs: Vec::new(), task };
    let mut problems = resolver.parameters();
    problems.extend(resolver.constants());
    problems.extend(resolver.outputs());
    let mut driven = None;
    if study.runs().have_memory {
        match if study.runs().start_from_states { resolver.with_states() } else { resolver.driven() } {
            Ok(found) => driven = Some(found),
            Err(more) => problems.extend(more),
        }
    }
    study.refuse(problems)?;
    let Resolver { mut parameters, outputs, task, .. } = resolver;
    parameters.extend(driven.iter().flat_map(Driven::starts));
    Ok(Resolved { parameters, outputs, task, driven })
}

struct Resolver<'a> {
    study: &'a Study,
    description: &'a ModelDescription,
    parameters: Vec<SourceVariable>,
    outputs: Vec<SourceVariable>,
    task: SamplingTask,
}

impl Resolver<'_> {
    fn parameters(&mut self) -> Problems {
        let mut problems = Problems::default();
        let description = self.description;
        for (name, options) in &self.study.parameters {
            let (key, before) = (format!("parameters.{name}"), problems.iter().len());
            let mut add = |message: String| problems.add(key.clone(), message);
            let Some(variable) = description.variable(name) else {
                add(unknown(description, name, before, "variable to be set", |variable| varied(variable).is_ok()));
                continue;
            };
            if let Err(unfit) = varied(variable) {
                add(unfit.to_string());
                continue;
            }
            let (min, max) = range(description, variable);
            let (least, most) = (min.unwrap_or(f64::NEG_INFINITY), max.unwrap_or(f64::INFINITY));
            if options.min < least || options.max > most {
                add(format!("range from {} to {}, the FMU takes {}", options.min, options.max, ends(least, most)));
            }
            let unit = description.unit_of(variable).unwrap_or_default();
            problems.extend(wrong_unit(&key, options.unit.as_deref(), unit));
            self.task.variables.push(name.clone());
            self.task.is_input.push(variable.causality == Causality::Input);
            self.parameters.push(SourceVariable {
                start: variable.kind.as_real().and_then(|real| real.start),
                ..named(name, unit, options.description.as_deref(), variable)
            });
        }
        problems
    }

    fn constants(&mut self) -> Problems {
        let mut problems = Problems::default();
        for (name, &value) in &self.study.source.constants {
            let before = problems.iter().len();
            let mut add = |message: String| problems.add(format!("source.constants.{name}"), message);
            let Some(variable) = self.description.variable(name) else {
                add(unknown(self.description, name, before, "variable to be set", |variable| {
                    settable(variable).is_ok()
                }));
                continue;
            };
            match settable(variable) {
                Err(unfit) => add(unfit.to_string()),
                Ok(()) if self.study.parameters.contains_key(name) => {
                    add("is a parameter: a quantity is either constant or varied".into());
                }
                Ok(()) if self.study.inputs.contains_key(name) => {
                    add("is one of the inputs, which have signals: an input is either constant or driven".into());
                }
                Ok(()) if !value.is_finite() => add(format!("{value} is not finite")),
                Ok(()) => {
                    self.task.variables.push(name.clone());
                    // of an array all elements start with it
                    let scalar = variable.dimensions.is_empty();
                    self.task.is_input.push(scalar && variable.causality == Causality::Input);
                    self.task.constants.push(value);
                }
            }
        }
        problems
    }

    /// The study's inputs, which drive co-simulation.
    fn driven(&mut self) -> std::result::Result<Driven, Problems> {
        let inputs = self.inputs("scalar input", |_| true)?;
        let names = self.study.inputs.keys().cloned().collect();
        self.task.driven =
            Some(sampling::DrivenRuns { states: Vec::new(), inputs: names, held: true, derivatives: false });
        Driven::of_states(self.study, Vec::new(), inputs)
    }

    /// The study's inputs as the FMU has them, which are scalars.
    fn inputs(
        &self,
        what: &str,
        fits: impl Fn(&ScalarVariable) -> bool,
    ) -> std::result::Result<Vec<OwnInput>, Problems> {
        let (mut problems, mut inputs) = (Problems::default(), Vec::new());
        let description = self.description;
        for name in self.study.inputs.keys() {
            let is_input = |variable: &ScalarVariable| {
                variable.causality == Causality::Input && varied(variable).is_ok() && fits(variable)
            };
            let Some(variable) = description.variable(name).filter(|variable| is_input(variable)) else {
                let message = unknown(description, name, problems.iter().len(), what, is_input);
                problems.add(format!("inputs.{name}"), message);
                continue;
            };
            let unit = description.unit_of(variable).unwrap_or_default();
            let (min, max) = range(description, variable);
            inputs.push(OwnInput {
                variable: named(name, unit, None, variable),
                range: [min, max],
                start: variable.kind.as_real().and_then(|real| real.start),
            });
        }
        if problems.is_empty() { Ok(inputs) } else { Err(problems) }
    }

    /// The study's states and inputs, of model exchange.
    fn with_states(&mut self) -> std::result::Result<Driven, Problems> {
        let mut problems = Problems::default();
        let (study, description) = (self.study, self.description);
        let indicators = description.indicator_count();
        if indicators > 0 {
            let message = format!("the FMU has {indicators} event indicators; {NO_EQUATIONS}");
            problems.add("source.fmu", message);
        }
        let Some(known) = description.states().filter(|_| description.model_exchange.is_some()) else {
            let message = "the FMU does not offer its states one by one by model exchange, which \"dynamics\" needs";
            return Err(Problems::one("source.fmu", message));
        };
        let known_names: Vec<&str> = known.iter().map(|state| state.name.as_str()).collect();
        let (mut states, mut positions) = (Vec::new(), Vec::new());
        for (name, options) in &study.states {
            let key = format!("states.{name}");
            match known.iter().position(|state| state.name == *name) {
                None => {
                    problems.add(key, format!("the FMU has no state `{name}`, {}", expected_one_of(name, &known_names)))
                }
                Some(position) => {
                    let unit = description.unit_of(known[position]).unwrap_or_default();
                    if options.is_periodic() && !matches!(unit, "rad" | "") {
                        problems
                            .add(format!("{key}.periodic"), format!("belongs to angles in rad; its unit is `{unit}`"));
                    }
                    positions.push(position);
                    let start = known[position].kind.as_real().and_then(|real| real.start);
                    states.push((named(name, unit, None, known[position]), start));
                }
            }
        }
        let missing: Vec<&str> =
            known_names.iter().filter(|name| !study.states.contains_key(**name)).copied().collect();
        if !missing.is_empty() && !study.states.is_empty() {
            problems.add("states", format!("without {}: expected every state of the FMU", missing.join(", ")));
        }
        if known.is_empty() {
            problems.add("source.fmu", "the FMU has no states; a study without `structure` takes it");
        }
        let inputs = match self
            .inputs("continuous scalar input", |variable| variable.variability == fmi::Variability::Continuous)
        {
            Ok(inputs) if problems.is_empty() => inputs,
            found => {
                problems.extend(found.err().unwrap_or_default());
                return Err(problems);
            }
        };
        let names = study.inputs.keys().cloned().collect();
        self.task.driven =
            Some(sampling::DrivenRuns { states: positions, inputs: names, held: false, derivatives: false });
        Driven::of_states(study, states, inputs)
    }

    fn outputs(&mut self) -> Problems {
        let mut problems = Problems::default();
        for (name, options) in &self.study.outputs {
            let key = format!("outputs.{name}");
            let Some(variable) = recorded_as(self.description, name) else {
                let message =
                    unknown(self.description, name, problems.iter().len(), "variable to be recorded", |variable| {
                        recordable(variable).is_ok()
                    });
                problems.add(key, message);
                continue;
            };
            if let Err(unfit) = recordable(variable) {
                problems.add(key, unfit.to_string());
                continue;
            }
            if variable.name == *name && !variable.dimensions.is_empty() {
                let shape = self.description.shape(variable).unwrap_or_default();
                let some: Vec<String> = element_names(name, &shape).take(3).collect();
                problems.add(key, format!("is an array, expected its elements: {}", some.join(", ")));
                continue;
            }
            let unit = self.description.unit_of(variable).unwrap_or_default();
            problems.extend(wrong_unit(&key, options.unit.as_deref(), unit));
            if !self.task.recorded.contains(&variable.name) {
                self.task.recorded.push(variable.name.clone());
            }
            // a name may be an alias; columns have the variable's own
            let own = if variable.dimensions.is_empty() { &variable.name } else { name };
            self.task.outputs.push(own.clone());
            self.outputs.push(named(name, unit, options.description.as_deref(), variable));
        }
        problems
    }
}

fn named(name: &str, unit: &str, description: Option<&str>, variable: &ScalarVariable) -> SourceVariable {
    SourceVariable::new(name, unit, description.or(variable.description.as_deref()).unwrap_or_default())
}

/// Reason why a study cannot use a variable of an FMU as it wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnfitVariable {
    /// Its values are text or bytes.
    NotANumber,
    /// Its values are integers, Booleans or of another type in place of real numbers.
    Type {
        /// Type of the variable.
        found: &'static str,
        /// Types that suit, and what else can be done.
        expected: &'static str,
    },
    /// It is a number that the FMU does not take before a simulation.
    Fixed(&'static str),
    /// It is an array, in place of a scalar.
    Array,
    /// It is a number that the FMU does not calculate.
    NotCalculated(Causality),
}

impl fmt::Display for UnfitVariable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotANumber => f.write_str("is not a number"),
            Self::Type { found, expected } => write!(f, "is of type {found}: {expected}"),
            Self::Fixed(reason) => f.write_str(reason),
            Self::Array => {
                f.write_str("is an array: only scalars are varied; all elements may have one value in source.constants")
            }
            Self::NotCalculated(causality) => {
                write!(f, "is not an output: its causality is {}", fmi::Named::name(*causality))
            }
        }
    }
}

impl std::error::Error for UnfitVariable {}

/// Checks that a study can vary a variable; the error says why not.
pub fn varied(variable: &ScalarVariable) -> std::result::Result<(), UnfitVariable> {
    settable(variable)?;
    if !matches!(variable.kind, VariableType::Real(_)) {
        let expected = "only real numbers are varied; it may have a value in source.constants";
        return Err(UnfitVariable::Type { found: variable.kind.name(fmi::FmiVersion::V2), expected });
    }
    if !variable.dimensions.is_empty() {
        return Err(UnfitVariable::Array);
    }
    Ok(())
}

/// Checks that a variable may have a value before the simulation; the error says why not.
pub fn settable(variable: &ScalarVariable) -> std::result::Result<(), UnfitVariable> {
    let starts = matches!(variable.initial, Some(Initial::Exact | Initial::Approx)) && variable.kind.has_start();
    let reason = match variable.causality {
        _ if !variable.kind.is_number() => return Err(UnfitVariable::NotANumber),
        _ if variable.variability == fmi::Variability::Constant => "is constant in the FMU",
        Causality::Independent => "is the time",
        Causality::StructuralParameter => "is a structural parameter: they keep their values here",
        Causality::Parameter | Causality::Input => return Ok(()),
        Causality::CalculatedParameter | Causality::Output | Causality::Local if starts => return Ok(()),
        _ => "is calculated by the FMU",
    };
    Err(UnfitVariable::Fixed(reason))
}

/// Checks that a variable may be an output of a study; the error says why not.
pub fn recordable(variable: &ScalarVariable) -> std::result::Result<(), UnfitVariable> {
    match (&variable.kind, variable.causality) {
        (VariableType::Real(_), Causality::Output | Causality::Local | Causality::CalculatedParameter) => Ok(()),
        (VariableType::Real(_), causality) => Err(UnfitVariable::NotCalculated(causality)),
        (kind, _) => {
            let found = kind.name(fmi::FmiVersion::V2);
            Err(UnfitVariable::Type { found, expected: "only real numbers are predicted" })
        }
    }
}

/// The smallest and largest value that an FMU takes, its own or that of its type.
pub fn range(description: &ModelDescription, variable: &ScalarVariable) -> (Option<f64>, Option<f64>) {
    let own = variable.kind.as_real();
    let of_type = description.type_of(variable).and_then(|definition| definition.kind.as_real());
    let [own, of_type] = [own, of_type].map(|real| real.map_or([None; 2], |real| [real.min, real.max]));
    (own[0].or(of_type[0]), own[1].or(of_type[1]))
}

/// The variable of a name, or the array that has an element of that name.
fn recorded_as<'a>(description: &'a ModelDescription, name: &str) -> Option<&'a ScalarVariable> {
    description.variable(name).or_else(|| {
        let (array, indices) = name.strip_suffix(']')?.rsplit_once('[')?;
        let variable = description.variable(array).filter(|variable| !variable.dimensions.is_empty())?;
        let sizes = description.shape(variable)?;
        let indices: Vec<&str> = indices.split(',').collect();
        let fits = indices.len() == sizes.len()
            && indices.iter().zip(&sizes).all(|(index, size)| {
                index.parse().is_ok_and(|number: u64| (1..=*size).contains(&number) && number.to_string() == *index)
            });
        fits.then_some(variable)
    })
}

/// Message about an unknown name: similar names, or else the first ones. After many problems `before` it, which are of one
/// kind, no more names are compared.
fn unknown(
    description: &ModelDescription,
    name: &str,
    before: usize,
    what: &str,
    fits: impl Fn(&ScalarVariable) -> bool,
) -> String {
    const SHOWN: usize = 8;
    const COMPARED: usize = 100;
    if before >= COMPARED {
        return format!("the FMU has no {what} `{name}`");
    }
    let known: Vec<&str> = description.variables.iter().filter(|v| fits(v)).map(|v| v.name.as_str()).collect();
    let lower = name.to_lowercase();
    let mut shown: Vec<&str> = known
        .iter()
        .filter(|known| known.to_lowercase().contains(&lower) || lower.contains(&known.to_lowercase()))
        .copied()
        .take(SHOWN)
        .collect();
    if shown.is_empty() {
        shown = known.iter().copied().take(SHOWN).collect();
    }
    let more = match known.len() - shown.len() {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    let shown = if shown.is_empty() { "none".to_owned() } else { shown.join(", ") };
    let suggestion = did_you_mean(name, known.iter().copied());
    format!("the FMU has no {what} `{name}`, expected one of {shown}{more}{suggestion}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fmi::xml;
    use std::path::Path;

    const DESCRIPTION: &[u8] = include_bytes!("../../../../../tests/data/modelDescription-fmi3.xml");

    /// A study of the example's FMU, whose `speed` is an input and whose `length` is tunable.
    fn resolved(from: &str, to: &str) -> Result<Resolved> {
        const STUDY: &str = "name = \"s\"\n[source]\nfmu = \"example.fmu\"\n[time]\nstop = 1\nstep = 0.5\n[parameters]\n\
            length = { min = 0.12, max = 0.2 }\nspeed = { min = 0, max = 5 }\n[outputs]\nangle = {}\n\
            [sampling]\nmethod = \"sobol\"\nruns = 2\n";
        assert!(STUDY.contains(from), "{from}");
        let folder = tempfile::tempdir().unwrap();
        // its content only counts for the digest of the study
        std::fs::write(folder.path().join("example.fmu"), DESCRIPTION).unwrap();
        let description = xml::read(DESCRIPTION).unwrap().description;
        let text = STUDY.replacen(from, to, 1);
        resolve(&Study::parse(&text, &folder.path().join(Path::new("s.toml")))?, &description)
    }

    #[test]
    fn parameters_keep_where_they_start() {
        let Resolved { parameters, outputs, task, .. } = resolved("stop = 1", "stop = 1").unwrap();
        assert_eq!(task.is_input, [false, true]);
        assert!(parameters.iter().all(|p| p.start.is_some() && !p.unit.is_empty()));
        assert_eq!((outputs[0].unit.as_str(), task.recorded.as_slice()), ("rad", &["angle".to_owned()][..]));
    }

    #[test]
    fn what_does_not_fit_is_said() {
        for (from, to, says) in [
            (
                "length =",
                "domain_policy =",
                "parameters.domain_policy: `domain_policy` is the name of a variable that every FMU of metafmu has",
            ),
            ("length =", "time =", "parameters.time"),
            ("length =", "velocity =", "parameters.velocity: is calculated by the FMU"),
            ("min = 0.12", "min = 0.0", "parameters.length: range from 0 to 0.2, the FMU takes 0.1 to 0.2"),
            ("angle =", "in_domain =", "outputs.in_domain: `in_domain` is the name of a variable that every FMU"),
            ("angle =", "angel =", "outputs.angel: the FMU has no variable to be recorded `angel`, expected one of "),
            ("angle = {}", "angle = { unit = \"deg\" }", "outputs.angle.unit: `deg`, expected `rad`"),
            ("[time]", "constants = { speed = 1 }\n[time]", "source.constants.speed: is a parameter"),
        ] {
            let message = resolved(from, to).err().map(|error| error.to_string()).unwrap_or_default();
            assert!(message.contains(says), "{to}: {message}");
        }
    }
}
