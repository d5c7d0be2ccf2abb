//! What hosts will do with an FMU: whether they load and run it, what will fail, why, and what to do instead.
//!
//! A host is a list of rules about the FMU's description and archive. [`outlooks`] applies them to any vendor's FMU;
//! `tests/hosts/predicted.py` compares the answers with what the hosts do.

mod conditions;
mod facts;
mod table;
mod trial;

use super::{Archive, FmiVersion, InterfaceKind, Watch};
use crate::Result;
use facts::FmuFacts;
use serde::Serialize;
use std::{fmt, path::Path};

/// A host, and what it demands of an FMU.
struct Host {
    name: &'static str,
    version: &'static str,
    evidence: Evidence,
    /// What it runs, in the order in which it chooses.
    takes: &'static [Offer],
    /// Lists of rules that apply to its FMUs.
    rules: &'static [&'static [Rule]],
}

/// A version of the standard, and an interface of it.
struct Offer {
    version: FmiVersion,
    interface: InterfaceKind,
}

/// A property of FMUs, and what it does in a host.
struct Rule {
    /// What of the FMU has the property.
    finds: fn(&FmuFacts) -> Option<String>,
    effect: Effect,
    /// Why, continuing "NAMES: ".
    because: &'static str,
    /// What the host's user or the FMU's author can do.
    instead: &'static str,
}

/// How it is known what a host does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Evidence {
    /// It was run.
    Run,
    /// Its source was read.
    Read,
}

/// What a host does with an FMU, from harmless to useless.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Effect {
    /// It runs.
    Runs,
    /// It runs, but something of it cannot be used or behaves unexpectedly.
    Limited,
    /// It runs, and values are wrong without a message.
    WrongValues,
    /// It is loaded, and the run ends with an error.
    RunFails,
    /// It is not loaded.
    NotLoaded,
}

/// What a host will do with an FMU.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HostOutlook {
    /// The host.
    pub host: &'static str,
    /// Its version.
    pub version: &'static str,
    /// How this is known.
    pub evidence: Evidence,
    /// The interface by which it runs the FMU.
    pub interface: Option<String>,
    /// The worst of the findings.
    pub effect: Effect,
    /// What will happen, the worst first.
    pub findings: Vec<HostFinding>,
}

/// One thing that a host does with an FMU.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HostFinding {
    /// What it does.
    pub effect: Effect,
    /// What of the FMU it is about, and why.
    pub because: String,
    /// What to do instead.
    pub instead: String,
}

/// What every host that is known will do with an FMU. It is run for some steps by each interface, in a separate process: what does not work at all
/// works in no host.
///
/// # Errors
/// [`Error::ArchiveEntry`](crate::Error::ArchiveEntry) or [`Error::Description`](crate::Error::Description) if its description cannot be
/// read, [`Error::Interrupted`](crate::Error::Interrupted).
pub fn outlooks(path: &Path, watch: Watch) -> Result<Vec<HostOutlook>> {
    let mut facts = FmuFacts::read(&mut Archive::open(path)?)?;
    facts.broken = trial::failures(path, &facts, watch)?;
    Ok(table::HOSTS.iter().map(|host| host.outlook(&facts)).collect())
}

impl Host {
    fn outlook(&self, facts: &FmuFacts) -> HostOutlook {
        let offer = self.takes.iter().find(|offer| facts.offers(offer.version, offer.interface));
        let mut findings: Vec<HostFinding> = match offer {
            Some(offer) => {
                let facts = FmuFacts { interface: offer.interface, ..facts.clone() };
                self.rules.iter().copied().flatten().filter_map(|rule| rule.finding(&facts)).collect()
            }
            None => vec![self.without_interface(facts)],
        };
        findings.sort_by_key(|finding| std::cmp::Reverse(finding.effect));
        HostOutlook {
            host: self.name,
            version: self.version,
            evidence: self.evidence,
            interface: offer.map(|offer| offer.interface.to_string()),
            effect: findings.first().map_or(Effect::Runs, |finding| finding.effect),
            findings,
        }
    }

    fn without_interface(&self, facts: &FmuFacts) -> HostFinding {
        let taken: Vec<String> =
            self.takes.iter().map(|Offer { version, interface }| format!("{interface} of FMI {version}")).collect();
        HostFinding {
            effect: Effect::NotLoaded,
            because: format!("the FMU offers {}, and the host takes {}", facts.offered(), taken.join(", ")),
            instead: "export the FMU for one of these".into(),
        }
    }
}

impl Rule {
    fn finding(&self, facts: &FmuFacts) -> Option<HostFinding> {
        let found = (self.finds)(facts)?;
        let because = if found.is_empty() { self.because.to_owned() } else { format!("{found}: {}", self.because) };
        Some(HostFinding { effect: self.effect, because, instead: self.instead.into() })
    }
}

/// A line for the host, and one for each finding.
impl fmt::Display for HostOutlook {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { host, version, evidence, interface, effect, findings } = self;
        let known = match evidence {
            Evidence::Run => "run",
            Evidence::Read => "read",
        };
        let by = interface.as_ref().map_or(String::new(), |interface| format!(" by {interface}"));
        let says = match effect {
            Effect::Runs | Effect::Limited => format!("runs{by}"),
            Effect::WrongValues => format!("runs{by} with WRONG VALUES"),
            Effect::RunFails => format!("loads, and FAILS{by}"),
            Effect::NotLoaded => "DOES NOT LOAD".into(),
        };
        write!(f, "{host} {version} ({known}): {says}")?;
        for HostFinding { because, instead, .. } in findings {
            write!(f, "\n    {because}")?;
            if !instead.is_empty() {
                write!(f, "\n        instead: {instead}")?;
            }
        }
        Ok(())
    }
}
