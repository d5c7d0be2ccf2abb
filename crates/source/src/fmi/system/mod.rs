//! Systems of FMUs and mechanisms that exchange values: System Structure and Parameterization (SSP) 1.0, and runs of them.
//!
//! [`FmuSystem`] is the content of a SystemStructure.ssd; [`FmuSystem::plan`] fits it to FMUs, and
//! [`run_system_apart`](super::worker::run_system_apart) runs the plan.

pub mod master;
mod plan;
pub mod run;
mod simulator;
mod source;
mod structure;

use super::{Archive, InterfaceKind, host::Unpacked};
use crate::{Error, Result, reading, unpacking::Patience};
pub use plan::Experiment;
pub use plan::{is_number, misfit, port};
pub use source::ComponentSource;
use std::path::{Path, PathBuf};

/// Name of a system's description in its archive.
const DESCRIPTION: &str = "SystemStructure.ssd";
/// No description of a system or mechanism is longer, in bytes.
const MAX_DESCRIPTION: u64 = 64 << 20;

/// A system of FMUs that are connected with each other.
#[derive(Clone, Debug, PartialEq)]
pub struct FmuSystem {
    /// Its name.
    pub name: String,
    /// The description, for messages.
    pub path: PathBuf,
    /// The archive or folder that the FMUs are in.
    root: PathBuf,
    is_archive: bool,
    /// The FMUs, in the order of the description.
    pub components: Vec<SystemComponent>,
    /// Outputs of components and the inputs that take their values.
    pub connections: Vec<Connection>,
    /// The system's own outputs: name and where the value is from.
    pub outputs: Vec<(String, End)>,
    /// Suggested first and last communication point in s.
    pub start: Option<f64>,
    /// Suggested last communication point in s.
    pub stop: Option<f64>,
}

/// A component: an FMU in a system, or a mechanism.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SystemComponent {
    /// Its name, unique in the system.
    pub name: String,
    /// Line in the description.
    pub line: usize,
    /// Path of its file in the archive or folder.
    pub source: String,
    /// `true` if that file is a mechanism instead of an FMU.
    pub is_mechanism: bool,
    /// Interface by which it is to be run; any if none.
    pub interface: Option<InterfaceKind>,
    /// Its connectors.
    pub connectors: Vec<Connector>,
    /// Values that the system sets: of parameters, and start values.
    pub values: Vec<StartValue>,
}

/// A variable of a component that others see.
#[derive(Clone, Debug, PartialEq)]
pub struct Connector {
    /// Name of the variable.
    pub name: String,
    /// Line in the description.
    pub line: usize,
    /// Which way its value goes.
    pub kind: ConnectorKind,
    /// Unit, if the description has one.
    pub unit: Option<String>,
}

/// Which way the value of a connector goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConnectorKind {
    /// Into the component.
    Input,
    /// Out of it.
    Output,
    /// Into it, before it is initialized.
    Parameter,
    /// Out of it, after that.
    CalculatedParameter,
}

/// A value that a system sets.
#[derive(Clone, Debug, PartialEq)]
pub struct StartValue {
    /// Name of the variable.
    pub name: String,
    /// Line in the description.
    pub line: usize,
    /// The value; 0 or 1 for a boolean.
    pub value: f64,
    /// Its unit, if the description has one.
    pub unit: Option<String>,
}

/// A connector of a component.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct End {
    /// Position of the component.
    pub component: usize,
    /// Name of the connector.
    pub connector: String,
    /// Line in the description of what refers to it.
    pub line: usize,
}

/// A connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connection {
    /// The output.
    pub from: End,
    /// The input.
    pub to: End,
}

impl FmuSystem {
    /// Reads a system from an SSP archive, or from a SystemStructure.ssd that the FMUs are beside.
    ///
    /// # Errors
    /// - [`Error::Io`], [`Error::Archive`], [`Error::ArchiveEntry`]: it cannot be read;
    /// - [`Error::System`] with everything that is wrong or not supported.
    pub fn open(path: &Path) -> Result<Self> {
        let is_description = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("ssd"));
        if is_description {
            let bytes = reading::read(path, MAX_DESCRIPTION).map_err(Error::io(path, "read"))?;
            let root = path.parent().unwrap_or(Path::new(""));
            return structure::read(&bytes, path, root, false);
        }
        let mut archive = Archive::open(path)?;
        if !archive.contains(DESCRIPTION) {
            let problem = "is missing: not an SSP archive".into();
            return Err(Error::ArchiveEntry { path: path.to_owned(), entry: DESCRIPTION.into(), problem });
        }
        structure::read(&archive.read(DESCRIPTION, MAX_DESCRIPTION)?, &path.join(DESCRIPTION), path, true)
    }

    /// Position of a component.
    pub fn position(&self, name: &str) -> Option<usize> {
        self.components.iter().position(|component| component.name == name)
    }

    /// Reads the source of a component; an FMU is unpacked.
    ///
    /// # Errors
    /// As [`Unpacked::open`] and [`ComponentSource::mechanism`]; [`Error::ArchiveEntry`] if it is not in the archive.
    pub fn load(&self, component: usize) -> Result<ComponentSource> {
        let SystemComponent { source, interface, is_mechanism, values, .. } = &self.components[component];
        let path = self.root.join(source);
        if *is_mechanism {
            let bytes = match self.is_archive {
                true => Archive::open(&self.root)?.read(source, MAX_DESCRIPTION)?,
                false => reading::read(&path, MAX_DESCRIPTION).map_err(Error::io(&path, "read"))?,
            };
            return ComponentSource::mechanism(path, String::from_utf8_lossy(&bytes).into_owned(), |name| {
                values.iter().find(|value| value.name == name).map(|value| value.value)
            });
        }
        let fmu = match self.is_archive {
            true => {
                Unpacked::of_archive(Archive::open(&self.root)?.open_inner(source)?, *interface, Patience::default())
            }
            false => Unpacked::open(&path, *interface, Patience::default()),
        };
        fmu.map(Box::new).map(ComponentSource::Fmu)
    }

    /// Returns true if a connector of a component is part of a connection.
    pub fn is_connected(&self, component: usize, connector: &str) -> bool {
        let ends = self.connections.iter().flat_map(|Connection { from, to }| [from, to]);
        ends.chain(self.outputs.iter().map(|(_, end)| end))
            .any(|end| end.component == component && end.connector == connector)
    }
}
