//! Checks modelDescription.xml against the rules of the FMI standard that hosts apply.

use super::Report;
use crate::{
    diagnostics::numbers::exact,
    identifier::model_identifier,
    model_description::{
        Causality, FmiVersion, Initial, Integer, ModelDescription, ModelStructure, Named, NamingConvention,
        RealAttributes, ScalarVariable, Unknown, Variability, VariableType,
    },
    xml::Document,
};
use std::collections::{BTreeSet, HashMap, HashSet};

/// Reports every violation, with its line.
pub fn check(document: &Document, report: &mut Report) {
    for problem in &document.problems {
        report.at_line(problem.line, problem.message.clone());
    }
    let mut checker = Checker { document, description: &document.description, report };
    checker.interfaces();
    checker.units_and_types();
    checker.experiment();
    checker.names();
    for (variable, &line) in document.description.variables.iter().zip(&document.variable_lines) {
        checker.combination(variable, line);
        checker.start(variable, line);
        checker.values(variable, line);
        checker.references(variable, line);
    }
    checker.aliases();
    checker.structure();
}

struct Checker<'a> {
    document: &'a Document,
    description: &'a ModelDescription,
    report: &'a mut Report,
}

impl Checker<'_> {
    /// Checks the interfaces. The root element has no line in a [`Document`]: messages name the attribute instead.
    fn interfaces(&mut self) {
        let ModelDescription { co_simulation, model_exchange, scheduled_execution, .. } = self.description;
        let co_simulation = co_simulation.as_ref().map(|co_simulation| &co_simulation.interface);
        let model_exchange = model_exchange.as_ref().map(|exchange| &exchange.interface);
        if co_simulation.is_none() && model_exchange.is_none() && scheduled_execution.is_none() {
            self.report.at_line(1, "there is neither <CoSimulation> nor <ModelExchange>");
        }
        if self.description.token.is_empty() {
            self.report.at_line(1, format!("the {} is empty", self.token_name()));
        }
        for interface in co_simulation.into_iter().chain(model_exchange).chain(scheduled_execution) {
            let name = &interface.model_identifier;
            if !name.is_empty() && model_identifier(name) != *name {
                self.report.at_line(1, format!("modelIdentifier \"{name}\" is not a C identifier"));
            }
            if interface.serialize_state && !interface.get_and_set_state {
                self.report.at_line(1, "canSerializeFMUstate is true, but canGetAndSetFMUstate is not");
            }
        }
    }

    fn v3(&self) -> bool {
        self.description.fmi_version == FmiVersion::V3
    }

    fn token_name(&self) -> &'static str {
        if self.v3() { "instantiationToken" } else { "guid" }
    }

    fn type_name(&self, kind: &VariableType) -> &'static str {
        kind.name(self.description.fmi_version)
    }

    fn units_and_types(&mut self) {
        let mut names = HashSet::new();
        for unit in &self.description.units {
            if !names.insert(&unit.name) {
                self.report.at_line(1, format!("unit \"{}\" is defined twice", unit.name));
            }
            if let Some(base) = unit.base.filter(|base| base.factor == 0.0 || !base.factor.is_finite()) {
                self.report.at_line(1, format!("unit \"{}\" has the factor {}", unit.name, base.factor));
            }
            let mut display = HashSet::new();
            for name in unit.display.iter().map(|unit| &unit.name).filter(|name| !display.insert(*name)) {
                self.report.at_line(1, format!("unit \"{}\" has the display unit \"{name}\" twice", unit.name));
            }
        }
        let mut names = HashSet::new();
        for definition in &self.description.types {
            if !names.insert(&definition.name) {
                self.report.at_line(1, format!("type \"{}\" is defined twice", definition.name));
            }
            if let Some(unit) = definition.kind.as_real().and_then(|real| real.unit.as_ref())
                && !self.description.units.iter().any(|known| known.name == *unit)
            {
                let message = format!("type \"{}\" has the unit \"{unit}\", which is not defined", definition.name);
                self.report.at_line(1, message);
            }
        }
    }

    fn experiment(&mut self) {
        let Some(experiment) = self.description.default_experiment else { return };
        let start = experiment.start.unwrap_or(0.0);
        if let Some(stop) = experiment.stop.filter(|stop| *stop < start) {
            self.report.at_line(1, format!("DefaultExperiment stops at {stop}, before its start at {start}"));
        }
        for (name, value) in [("stepSize", experiment.step_size), ("tolerance", experiment.tolerance)] {
            if let Some(value) = value.filter(|value| *value <= 0.0 || value.is_nan()) {
                self.report.at_line(1, format!("DefaultExperiment has {name}=\"{value}\", expected more than zero"));
            }
        }
    }

    fn names(&mut self) {
        let mut first = HashMap::new();
        let mut independent: Option<&str> = None;
        for (variable, &line) in self.description.variables.iter().zip(&self.document.variable_lines) {
            let name = variable.name.as_str();
            for name in std::iter::once(name).chain(variable.aliases.iter().map(|alias| alias.name.as_str())) {
                if let Some(known) = first.insert(name, line) {
                    let message = format!("variable \"{name}\" has the name of the variable in line {known}");
                    self.report.at_line(line, message);
                }
            }
            if name.is_empty() {
                self.report.at_line(line, "a variable has an empty name");
            } else if name.contains(['\r', '\n', '\t']) {
                self.report.at_line(line, format!("variable {name:?} has a line break or tab in its name"));
            } else if self.description.naming == NamingConvention::Structured && !is_structured_name(name) {
                self.report.at_line(line, format!("variable \"{name}\" has no structured name"));
            }
            if variable.causality == Causality::Independent
                && let Some(other) = independent.replace(name)
            {
                self.report.at_line(line, format!("variable \"{name}\" is independent, and so is \"{other}\""));
            }
        }
        if self.v3() && independent.is_none() {
            self.report.at_line(1, "there is no independent variable, expected exactly one");
        }
    }

    fn combination(&mut self, variable: &ScalarVariable, line: usize) {
        let ScalarVariable { name, causality, variability, initial, kind, .. } = variable;
        let (c, v) = (Causality::name(*causality), Variability::name(*variability));
        let real = kind.as_real().is_some();
        if *variability == Variability::Continuous && !real {
            let message = format!("variable \"{name}\" is of type {} and cannot be continuous", self.type_name(kind));
            return self.report.at_line(line, message);
        }
        if *causality == Causality::Independent && !real {
            self.report.at_line(line, format!("variable \"{name}\" is independent, but no real number"));
        }
        if *causality == Causality::StructuralParameter && !matches!(kind, VariableType::Integer(_)) {
            self.report.at_line(line, format!("variable \"{name}\" is a structural parameter, but no integer"));
        }
        if matches!(kind, VariableType::Clock { .. }) {
            // a clock ticks: there is nothing to initialize
            let known = matches!(causality, Causality::Input | Causality::Output | Causality::Local);
            if !known || *variability != Variability::Discrete {
                let message = format!("clock \"{name}\": causality {c} and variability {v} are not allowed");
                self.report.at_line(line, message);
            }
            return;
        }
        match (Initial::allowed(self.description.fmi_version, *causality, *variability), initial) {
            (None, _) => {
                let message = format!("variable \"{name}\": variability {v} is not allowed for causality {c}");
                self.report.at_line(line, message);
            }
            (Some(allowed), Some(initial)) if !allowed.contains(initial) => {
                let initial = Initial::name(*initial);
                let message = format!(
                    "variable \"{name}\": initial {initial} is not allowed for causality {c} and variability {v}"
                );
                self.report.at_line(line, message);
            }
            _ => {}
        }
    }

    fn start(&mut self, variable: &ScalarVariable, line: usize) {
        let ScalarVariable { name, causality, initial, kind, .. } = variable;
        let clock = matches!(kind, VariableType::Clock { .. });
        let needed =
            *causality == Causality::Input && !clock || matches!(initial, Some(Initial::Exact | Initial::Approx));
        let forbidden = *causality == Causality::Independent || *initial == Some(Initial::Calculated);
        if needed && !kind.has_start() {
            self.report.at_line(line, format!("variable \"{name}\" has no start value"));
        }
        if forbidden && kind.has_start() {
            let why = initial.map_or(Causality::name(*causality), Initial::name);
            self.report.at_line(line, format!("variable \"{name}\" is {why} and must not have a start value"));
        }
    }

    /// Bounds, start and nominal value, its own or those of its type.
    fn values(&mut self, variable: &ScalarVariable, line: usize) {
        let name = &variable.name;
        let of_type = self.description.type_of(variable).map(|definition| &definition.kind);
        let (min, max, start) = match &variable.kind {
            VariableType::Real(real) => {
                let nominal = real.nominal.or(of_type.and_then(|kind| kind.as_real()?.nominal));
                if let Some(nominal) = nominal.filter(|nominal| *nominal <= 0.0 || nominal.is_nan()) {
                    let nominal = exact(nominal);
                    self.report
                        .at_line(line, format!("variable \"{name}\" has nominal {nominal}, expected more than zero"));
                }
                let default = of_type.and_then(VariableType::as_real);
                let RealAttributes { min, max, start, .. } = *real;
                (min.or(default.and_then(|real| real.min)), max.or(default.and_then(|real| real.max)), start)
            }
            VariableType::Integer(integer) | VariableType::Enumeration(integer) => {
                let default = match of_type {
                    Some(VariableType::Integer(default) | VariableType::Enumeration(default)) => *default,
                    _ => Integer::default(),
                };
                let Integer { min, max, start, .. } = *integer;
                let numbers = [min.or(default.min), max.or(default.max), start];
                numbers.map(|number| number.map(|number| number as f64)).into()
            }
            _ => return,
        };
        // no comparison finds them
        for (attribute, value) in [("min", min), ("max", max), ("start", start)] {
            if value.is_some_and(f64::is_nan) {
                self.report.at_line(line, format!("variable \"{name}\" has {attribute} NaN, expected a number"));
            }
        }
        if let (Some(min), Some(max)) = (min, max)
            && min > max
        {
            let (min, max) = (exact(min), exact(max));
            self.report.at_line(line, format!("variable \"{name}\" has min {min} above max {max}"));
        }
        let Some(start) = start else { return };
        if let Some(min) = min.filter(|min| start < *min) {
            let (start, min) = (exact(start), exact(min));
            self.report.at_line(line, format!("variable \"{name}\" has start {start} below min {min}"));
        }
        if let Some(max) = max.filter(|max| start > *max) {
            let (start, max) = (exact(start), exact(max));
            self.report.at_line(line, format!("variable \"{name}\" has start {start} above max {max}"));
        }
    }

    /// Declared type, unit, display unit, derivative.
    fn references(&mut self, variable: &ScalarVariable, line: usize) {
        let name = &variable.name;
        if let Some(declared) = &variable.declared_type {
            match self.description.type_of(variable) {
                None => {
                    let message = format!("variable \"{name}\" has the type \"{declared}\", which is not defined");
                    self.report.at_line(line, message);
                }
                Some(definition) if self.type_name(&definition.kind) != self.type_name(&variable.kind) => {
                    let (found, expected) = (self.type_name(&definition.kind), self.type_name(&variable.kind));
                    let message =
                        format!("variable \"{name}\" is of type {expected}, its type \"{declared}\" is {found}");
                    self.report.at_line(line, message);
                }
                Some(_) => {}
            }
        }
        self.clocks(variable, line);
        let Some(real) = variable.kind.as_real() else { return };
        let unit = self.description.unit_of(variable);
        let definition = unit.and_then(|unit| self.description.units.iter().find(|known| known.name == unit));
        if let Some(unit) = unit.filter(|_| definition.is_none()) {
            self.report.at_line(line, format!("variable \"{name}\" has the unit \"{unit}\", which is not defined"));
        }
        let aliases = variable.aliases.iter().filter_map(|alias| alias.display_unit.as_ref());
        for display in real.display_unit.iter().chain(aliases) {
            let known = definition.is_some_and(|unit| unit.display.iter().any(|known| known.name == *display));
            // a unit displayed as itself needs no definition
            if !known && unit != Some(display) {
                let message = format!("variable \"{name}\" has the display unit \"{display}\", which is not defined");
                self.report.at_line(line, message);
            }
        }
        if let Some(state) = real.derivative {
            match self.description.variables.get(state) {
                None => {
                    let message = format!(
                        "variable \"{name}\" is the derivative of variable {}, which does not exist",
                        state + 1
                    );
                    self.report.at_line(line, message);
                }
                Some(state) if state.kind.as_real().is_none() => {
                    let message = format!(
                        "variable \"{name}\" is the derivative of \"{}\", which is not a real number",
                        state.name
                    );
                    self.report.at_line(line, message);
                }
                Some(_) => {}
            }
        }
    }

    /// The clocks a variable belongs to.
    fn clocks(&mut self, variable: &ScalarVariable, line: usize) {
        let name = &variable.name;
        for reference in &variable.clocks {
            let found = self.description.variables.iter().find(|known| known.value_reference == *reference);
            if !found.is_some_and(|known| matches!(known.kind, VariableType::Clock { .. })) {
                let message = format!("variable \"{name}\" belongs to clock {reference}, which is not a clock");
                self.report.at_line(line, message);
            }
        }
    }

    /// FMI 2.0: variables with equal value references have one value, and the host may set it through one of them only.
    /// FMI 3.0: value references are unique, other names are aliases.
    fn aliases(&mut self) {
        let mut known: HashMap<u32, &str> = HashMap::new();
        for (variable, &line) in self.description.variables.iter().zip(&self.document.variable_lines) {
            if self.v3()
                && let Some(other) = known.insert(variable.value_reference, &variable.name)
            {
                let ScalarVariable { name, value_reference, .. } = variable;
                let message =
                    format!("variables \"{other}\" and \"{name}\" share the value reference {value_reference}");
                self.report.at_line(line, message);
            }
        }
        if self.v3() {
            return;
        }
        let mut set_by: HashMap<(bool, &str, u32), &str> = HashMap::new();
        for (variable, &line) in self.description.variables.iter().zip(&self.document.variable_lines) {
            let settable =
                matches!(variable.causality, Causality::Parameter | Causality::Input | Causality::Independent);
            // enumerations are read and set as integers
            let kind = match variable.kind {
                VariableType::Enumeration(_) => "Integer",
                _ => self.type_name(&variable.kind),
            };
            let key = (settable, kind, variable.value_reference);
            if settable && let Some(other) = set_by.insert(key, &variable.name) {
                let message = format!(
                    "variables \"{other}\" and \"{}\" are set by the host and share the value reference {}",
                    variable.name, variable.value_reference
                );
                self.report.at_line(line, message);
            }
        }
    }

    fn structure(&mut self) {
        let structure = &self.description.structure;
        let variables = &self.description.variables;
        let (output_list, initial_list) =
            if self.v3() { ("Output", "InitialUnknown") } else { ("Outputs", "InitialUnknowns") };
        let ModelStructure { outputs, derivatives, clocked_states, initial_unknowns, event_indicators } = structure;
        for (list, unknowns) in [
            (output_list, outputs),
            ("Derivatives", derivatives),
            ("ClockedState", clocked_states),
            (initial_list, initial_unknowns),
            ("EventIndicator", event_indicators),
        ] {
            self.list(list, unknowns);
        }
        let mut outputs = BTreeSet::new();
        let mut unknowns = BTreeSet::new();
        for (position, variable) in variables.iter().enumerate() {
            let computed = variable.initial.is_none_or(|initial| initial != Initial::Exact);
            if variable.causality == Causality::Output {
                outputs.insert(position);
            }
            if variable.causality == Causality::CalculatedParameter
                || variable.causality == Causality::Output
                    && computed
                    && variable.clocks.is_empty()
                    && !is_clock(variable)
            {
                unknowns.insert(position);
            }
        }
        for derivative in structure.derivatives.iter().map(|unknown| unknown.variable) {
            let real = variables.get(derivative).and_then(|variable| variable.kind.as_real());
            let Some(state) = real.and_then(|real| real.derivative) else {
                let message = match variables.get(derivative) {
                    Some(variable) => format!("Derivatives has \"{}\", which is not a derivative", variable.name),
                    None => continue,
                };
                self.report.at_line(self.document.structure_line, message);
                continue;
            };
            unknowns.extend([derivative, state].into_iter().filter(|&position| {
                let initial = variables.get(position).and_then(|variable| variable.initial);
                matches!(initial, Some(Initial::Approx | Initial::Calculated))
            }));
        }
        // those of event indicators may be listed or not
        let indicators: BTreeSet<usize> = structure.event_indicators.iter().map(|unknown| unknown.variable).collect();
        let listed = structure.initial_unknowns.iter().map(|unknown| unknown.variable);
        unknowns.extend(listed.filter(|position| indicators.contains(position)));
        self.exactly(output_list, &structure.outputs, &outputs);
        self.exactly(initial_list, &structure.initial_unknowns, &unknowns);
    }

    /// Reports entries that are missing from a list and entries that should not be in it.
    fn exactly(&mut self, list: &str, found: &[Unknown], expected: &BTreeSet<usize>) {
        let found: BTreeSet<usize> = found.iter().map(|unknown| unknown.variable).collect();
        let name = |position: &usize| self.description.variables.get(*position).map_or("", |variable| &variable.name);
        let missing = expected.difference(&found).map(|position| format!("{list} lacks \"{}\"", name(position)));
        let known = found.difference(expected).filter(|position| **position < self.description.variables.len());
        let excess = known.map(|position| format!("{list} has \"{}\", which does not belong there", name(position)));
        for message in missing.chain(excess) {
            self.report.at_line(self.document.structure_line, message);
        }
    }

    /// Positions that exist, no duplicates, dependencies in order and as many kinds as dependencies.
    fn list(&mut self, list: &str, unknowns: &[Unknown]) {
        let line = self.document.structure_line;
        let count = self.description.variables.len();
        let mut seen = HashSet::new();
        for Unknown { variable, dependencies, kinds } in unknowns {
            let Some(name) = self.description.variables.get(*variable).map(|variable| &variable.name) else {
                self.report.at_line(line, format!("{list} has variable {}, there are only {count}", variable + 1));
                continue;
            };
            if !seen.insert(variable) {
                self.report.at_line(line, format!("{list} has \"{name}\" twice"));
            }
            let Some(dependencies) = dependencies else {
                if kinds.is_some() {
                    self.report.at_line(line, format!("{list}: \"{name}\" has dependenciesKind, but no dependencies"));
                }
                continue;
            };
            if let Some(kinds) = kinds.as_ref().filter(|kinds| kinds.len() != dependencies.len()) {
                let (found, expected) = (kinds.len(), dependencies.len());
                let message = format!("{list}: \"{name}\" has {expected} dependencies and {found} dependenciesKind");
                self.report.at_line(line, message);
            }
            for dependency in dependencies.iter().filter(|dependency| **dependency >= count) {
                let message =
                    format!("{list}: \"{name}\" depends on variable {}, there are only {count}", dependency + 1);
                self.report.at_line(line, message);
            }
            if !self.v3() && !dependencies.is_sorted_by(|a, b| a < b) {
                self.report.at_line(line, format!("{list}: the dependencies of \"{name}\" are not in ascending order"));
            }
        }
    }
}

fn is_clock(variable: &ScalarVariable) -> bool {
    matches!(variable.kind, VariableType::Clock { .. })
}

/// `arm.joint[2,1].phi`, `der(x,2)`, `a.'odd name'`: FMI 2.0.4, section 2.2.9.
fn is_structured_name(name: &str) -> bool {
    match name.strip_prefix("der(").and_then(|inner| inner.strip_suffix(')')) {
        Some(inner) => match inner.rsplit_once(',').filter(|(_, order)| is_number(order)) {
            Some((identifier, _)) => is_identifier(identifier),
            None => is_identifier(inner),
        },
        None => is_identifier(name),
    }
}

/// Parts separated by dots, each a name with perhaps indices in brackets.
fn is_identifier(text: &str) -> bool {
    let mut rest = text;
    loop {
        let Some(after) = after_name(rest) else { return false };
        rest = after;
        if let Some(after) = rest.strip_prefix('[') {
            let Some((indices, after)) = after.split_once(']') else { return false };
            if !indices.split(',').all(|index| is_number(index.trim())) {
                return false;
            }
            rest = after;
        }
        match rest.strip_prefix('.') {
            Some(after) => rest = after,
            None => return rest.is_empty(),
        }
    }
}

/// Remainder of a text after a letter-digit name or a name in single quotes.
fn after_name(text: &str) -> Option<&str> {
    if let Some(quoted) = text.strip_prefix('\'') {
        let mut escaped = false;
        for (place, c) in quoted.char_indices() {
            match c {
                '\'' if !escaped => return (place > 0).then(|| &quoted[place + 1..]),
                _ => escaped = c == '\\' && !escaped,
            }
        }
        return None;
    }
    let end = text.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(text.len());
    (end > 0 && !text.starts_with(|c: char| c.is_ascii_digit())).then(|| &text[end..])
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

#[cfg(test)]
mod tests;
