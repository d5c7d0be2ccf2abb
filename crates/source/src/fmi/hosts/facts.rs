//! Facts about an FMU on which its way in hosts depends.

use crate::{
    Result,
    fmi::{
        Archive, FmiVersion, InterfaceKind, ModelDescription, Platform, description_error,
        model_description::{Causality, InterfaceCapabilities, ScalarVariable, VariableType},
        xml::{self, Document, tree::Element, variable_elements},
    },
};
use std::collections::HashSet;

/// An FMU as hosts see it before they run it.
pub(super) struct FmuFacts {
    pub document: Document,
    /// The description as it is written: attributes that are present, without the defaults of the standard.
    pub root: Element,
    /// Value references of scalar real variables: hosts that read everything as reals meet them.
    pub real_references: HashSet<u32>,
    /// Names of functions of FMI in the library for this platform; none if there is no library.
    pub functions: HashSet<String>,
    /// Names in the archive, and whether they are compressed in a way that the standard allows.
    pub entries: Vec<ArchivedName>,
    /// Why it does not run here, by the interfaces that were tried and failed.
    pub broken: Vec<FailedTrial>,
}

/// An FMU that a host runs by an interface.
#[derive(Clone, Copy)]
pub(super) struct HostedFmu<'a> {
    pub facts: &'a FmuFacts,
    pub interface: InterfaceKind,
}

/// A variable as it is written and as it is meant.
pub(super) struct WrittenVariable<'a> {
    /// The FMU that has it.
    pub facts: &'a FmuFacts,
    pub variable: &'a ScalarVariable,
    /// The element of the variable.
    pub element: &'a Element,
    /// The element of its type: a child in FMI 2.0, the same in FMI 3.0.
    pub kind: &'a Element,
}

/// Longest name of a function in bytes.
const LONGEST_SYMBOL: usize = 200;

/// An interface by which an FMU does not run.
pub(super) struct FailedTrial {
    pub interface: InterfaceKind,
    pub message: String,
}

/// An entry of the archive.
pub(super) struct ArchivedName {
    pub name: String,
    pub is_deflated: bool,
}

impl FmuFacts {
    pub fn read(archive: &mut Archive) -> Result<Self> {
        let root = archive.description_root()?;
        let document = xml::interpret(&root).map_err(|problem| description_error(archive.path(), &problem))?;
        let entries = archive.entries()?.into_iter();
        let entries = entries.map(|entry| ArchivedName { name: entry.name, is_deflated: entry.allowed_method });
        let reals = document.description.variables.iter().filter(|variable| is_real(variable));
        let interfaces = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
        let mut libraries = interfaces.into_iter().filter_map(|interface| library(&document.description, interface));
        let functions = match libraries.find(|library| archive.contains(library)) {
            // what cannot be unpacked cannot be loaded either, which a trial finds
            Some(library) => functions(&archive.read(&library, u64::MAX).unwrap_or_default()),
            None => HashSet::new(),
        };
        Ok(Self {
            real_references: reals.map(|variable| variable.value_reference).collect(),
            functions,
            entries: entries.collect(),
            broken: Vec::new(),
            document,
            root,
        })
    }

    pub fn description(&self) -> &ModelDescription {
        &self.document.description
    }

    pub fn version(&self) -> FmiVersion {
        self.description().fmi_version
    }

    pub fn offers(&self, version: FmiVersion, interface: InterfaceKind) -> bool {
        self.version() == version && self.description().interface(interface).is_some()
    }

    /// The interfaces of the FMU as text.
    pub fn offered(&self) -> String {
        let ModelDescription { co_simulation, model_exchange, scheduled_execution, .. } = self.description();
        let all = [
            ("co-simulation", co_simulation.is_some()),
            ("model exchange", model_exchange.is_some()),
            ("scheduled execution", scheduled_execution.is_some()),
        ];
        let names: Vec<&str> = all.iter().filter(|(_, is_there)| *is_there).map(|(name, _)| *name).collect();
        format!("{} of FMI {}", if names.is_empty() { "nothing".into() } else { names.join(", ") }, self.version())
    }

    /// Returns true if the FMU reads and sets integers and Booleans as reals as well: value references of such tools tell the type.
    pub fn converts_types(&self) -> bool {
        let tool = self.generation_tool();
        tool.starts_with("metafmu ") || (self.version() == FmiVersion::V2 && tool.starts_with("Dymola"))
    }

    /// Name and version of the tool that made the FMU; empty if it is unknown.
    pub fn generation_tool(&self) -> &str {
        self.description().generation_tool.as_deref().unwrap_or_default()
    }

    /// The variables as they are written.
    pub fn variables(&self) -> impl Iterator<Item = WrittenVariable<'_>> {
        let variables = self.description().variables.iter().zip(variable_elements(&self.root, self.version()));
        variables.map(|(variable, element)| WrittenVariable {
            facts: self,
            variable,
            element,
            kind: type_element(element, self.version()),
        })
    }

    /// Variables of this causality.
    pub fn of(&self, causality: Causality) -> impl Iterator<Item = WrittenVariable<'_>> {
        self.variables().filter(move |written| written.variable.causality == causality)
    }
}

impl<'a> HostedFmu<'a> {
    pub fn description(self) -> &'a ModelDescription {
        self.facts.description()
    }

    /// Capabilities of the interface by which a host runs the FMU.
    pub fn capabilities(self) -> Option<&'a InterfaceCapabilities> {
        self.description().interface(self.interface)
    }

    /// Name of the archive entry with the library for this platform.
    pub fn library(self) -> Option<String> {
        library(self.description(), self.interface)
    }
}

/// Returns true if a variable is a scalar real number in double precision.
pub(super) fn is_real(variable: &ScalarVariable) -> bool {
    matches!(&variable.kind, VariableType::Real(real) if !real.single) && variable.dimensions.is_empty()
}

/// The element with a variable's type: a child in FMI 2.0, the variable's own element in FMI 3.0.
fn type_element(element: &Element, version: FmiVersion) -> &Element {
    match version {
        FmiVersion::V2 => element.children.iter().find(|child| child.name != "Annotations").unwrap_or(element),
        FmiVersion::V3 => element,
    }
}

/// Name of the archive entry with an interface's library for this platform; none if the FMU does not offer the interface.
fn library(description: &ModelDescription, interface: InterfaceKind) -> Option<String> {
    let identifier = &description.interface(interface)?.model_identifier;
    Some(Platform::CURRENT.binary(description.fmi_version, identifier))
}

/// Names of functions of FMI in a library: its table of symbols is text between zero bytes, in ELF, PE and Mach-O files alike. The end of a longer
/// name may serve as a shorter one.
pub(super) fn functions(library: &[u8]) -> HashSet<String> {
    let texts = library.split(|byte| *byte == 0).filter(|text| text.len() < LONGEST_SYMBOL);
    texts
        .filter_map(|text| str::from_utf8(text).ok())
        .filter_map(|text| Some(text[text.rfind("fmi")?..].to_owned()))
        .collect()
}
