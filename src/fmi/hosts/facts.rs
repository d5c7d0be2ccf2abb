//! Facts about an FMU on which its way in hosts depends.

use crate::{
    Error, Result,
    fmi::{
        Archive, FmiVersion, InterfaceKind, ModelDescription, Platform,
        model_description::{Causality, InterfaceCapabilities, ScalarVariable},
        xml::{
            Document,
            tree::{Element, decode},
            variable_elements,
        },
    },
};
use std::{collections::HashSet, sync::Arc};

/// An FMU as hosts see it before they run it.
#[derive(Clone)]
pub(super) struct FmuFacts {
    pub document: Arc<Document>,
    /// The description as it is written: what is there and what follows from defaults.
    pub root: Arc<Element>,
    /// Symbols of the library for this platform, as far as they are functions of FMI; none if there is no library.
    pub functions: Arc<HashSet<String>>,
    /// Names in the archive, and whether they are compressed in a way that the standard allows.
    pub entries: Arc<Vec<ArchivedName>>,
    /// Why it does not run here, by the interfaces that were tried and failed.
    pub broken: Vec<FailedTrial>,
    /// The interface by which a host runs it.
    pub interface: InterfaceKind,
}

/// Longer texts in a library are no names of functions.
const LONGEST_SYMBOL: usize = 200;

/// An interface by which an FMU does not run.
#[derive(Clone)]
pub(super) struct FailedTrial {
    pub interface: InterfaceKind,
    pub message: String,
}

/// An entry of the archive.
pub(super) struct ArchivedName {
    pub name: String,
    pub is_deflated: bool,
}

/// A variable as it is written and as it is meant.
pub(super) struct WrittenVariable<'a> {
    pub variable: &'a ScalarVariable,
    /// The element of the variable.
    pub element: &'a Element,
    /// The element of its type: a child in FMI 2.0, the same in FMI 3.0.
    pub kind: &'a Element,
}

impl FmuFacts {
    pub fn read(archive: &mut Archive) -> Result<Self> {
        let document = archive.document()?;
        let bytes = archive.read("modelDescription.xml", u64::MAX)?;
        let wrong = |line, problem: String| Error::Description { path: archive.path().to_owned(), line, problem };
        let text = decode(&bytes).map_err(|problem| wrong(problem.line, problem.message))?;
        let root = Element::parse(&text).map_err(|problem| wrong(problem.line, problem.message))?;
        let entries = archive.entries()?.into_iter();
        let entries = entries.map(|entry| ArchivedName { name: entry.name, is_deflated: entry.allowed_method });
        let mut facts = Self {
            document: Arc::new(document),
            root: Arc::new(root),
            functions: Arc::default(),
            entries: Arc::new(entries.collect()),
            broken: Vec::new(),
            interface: InterfaceKind::CoSimulation,
        };
        let interfaces = [InterfaceKind::CoSimulation, InterfaceKind::ModelExchange];
        let mut libraries =
            interfaces.into_iter().filter_map(|interface| Self { interface, ..facts.clone() }.library());
        if let Some(library) = libraries.find(|library| archive.contains(library)) {
            // what cannot be unpacked cannot be loaded either, which a trial finds
            facts.functions = Arc::new(functions(&archive.read(&library, u64::MAX).unwrap_or_default()));
        }
        Ok(facts)
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

    /// Capabilities of the interface by which a host runs the FMU.
    pub fn capabilities(&self) -> Option<&InterfaceCapabilities> {
        self.description().interface(self.interface)
    }

    /// The variables as they are written.
    pub fn variables(&self) -> impl Iterator<Item = WrittenVariable<'_>> {
        let is_scalar = self.version() == FmiVersion::V2;
        let variables = self.description().variables.iter().zip(variable_elements(&self.root, self.version()));
        variables.map(move |(variable, element)| {
            let is_type = |child: &&Element| child.name != "Annotations";
            let kind = if is_scalar { element.children.iter().find(is_type) } else { None };
            WrittenVariable { variable, element, kind: kind.unwrap_or(element) }
        })
    }

    /// Variables of this causality.
    pub fn of(&self, causality: Causality) -> impl Iterator<Item = WrittenVariable<'_>> {
        self.variables().filter(move |written| written.variable.causality == causality)
    }

    /// Name of the archive entry with the library for this platform.
    pub fn library(&self) -> Option<String> {
        let identifier = &self.capabilities()?.model_identifier;
        Some(Platform::CURRENT.binary(self.version(), identifier))
    }
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
