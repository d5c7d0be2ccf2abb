//! A surrogate in the place of its source: one system, simulated with each of them, and the differences.

mod counterparts;
mod start_values;
mod step_speed;

use crate::{
    Error, Result,
    fmi::{
        ModelDescription, Watch,
        host::{Grid, RecordedColumn, RowSink, Unpacked},
        model_description::Causality,
        system::{
            ComponentSource, Connector, ConnectorKind, Experiment, FmuSystem, is_number, misfit, port,
            run::{Port, SystemRun},
        },
        worker::run_system_apart,
    },
    unpacking::Patience,
    variable::DefaultValue,
};
use metafmu_runtime::BuiltIn;
use serde::Serialize;
pub use start_values::{StartOrigin, SurrogateStart};
use start_values::{TakenOver, taken_over};
use std::{
    fmt::{self, Write},
    path::{Path, PathBuf},
};
pub use step_speed::{StepSpeed, StepTime};

/// Behind the name of a state: the parameter of a surrogate that has its value at the start.
const AT_START: &str = "_start";

/// Options of a comparison; missing ones come from the system or from the surrogate's default experiment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SwapOptions {
    /// The system: an SSP archive or a SystemStructure.ssd.
    pub system: PathBuf,
    /// The component that is replaced.
    pub component: String,
    /// The FMU that replaces it.
    pub surrogate: PathBuf,
    /// First communication point in s; else the system's, else 0.
    pub start: Option<f64>,
    /// Last communication point in s; else the system's, else the surrogate's.
    pub stop: Option<f64>,
    /// Communication step size in s; else the surrogate's, else the source's.
    pub step: Option<f64>,
    /// Tolerance of model exchange, see [`SystemRun::tolerance`].
    pub tolerance: Option<f64>,
    /// Values of inputs and parameters of the surrogate that the source lacks.
    pub defaults: Vec<DefaultValue>,
}

/// A system with a component's source and the surrogate that is to replace it, unpacked and checked.
#[derive(Debug)]
pub struct Swap {
    system: FmuSystem,
    component: String,
    surrogate: PathBuf,
    source: PathBuf,
    /// Names and units.
    outputs: Vec<(String, String)>,
    start_values: Vec<SurrogateStart>,
    warnings: Vec<String>,
    with_source: SystemRun,
    with_surrogate: SystemRun,
    /// Tolerance of the source's default experiment.
    suggested_tolerance: Option<f64>,
    // with the folders of the runs
    _sources: Vec<ComponentSource>,
}

/// The recorded rows of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordedRows {
    /// Names and units of the columns.
    pub columns: Vec<RecordedColumn>,
    /// Time of each row.
    pub times: Vec<f64>,
    /// Values of each column.
    pub values: Vec<Vec<f64>>,
}

/// Change of a system by a surrogate in place of a component's source.
#[derive(Clone, Debug, Serialize)]
pub struct SwapComparison {
    /// Name of the system.
    pub system: String,
    /// The component that was replaced.
    pub component: String,
    /// Its FMU.
    pub source: PathBuf,
    /// The FMU that replaced it.
    pub surrogate: PathBuf,
    /// First time in s.
    pub start: f64,
    /// Last time in s, as far as both runs went.
    pub stop: f64,
    /// Communication step size in s.
    pub step: f64,
    /// Communication steps that both runs made.
    pub steps: usize,
    /// Each output.
    pub outputs: Vec<Difference>,
    /// Wall time of a step of the component, with its inputs and outputs.
    pub component_step: StepSpeed,
    /// Wall time of a step of all components.
    pub system_step: StepSpeed,
    /// Tolerance of the source in the simulations that are timed: the loosest whose differences are no larger than the
    /// surrogate's. None for an FMU with a separate solver.
    pub source_tolerance: Option<f64>,
    /// Simulations that are timed, of each component alternately.
    pub timed_simulations: usize,
    /// Rows where the surrogate was outside its domain; none if it never was, or does not report it.
    pub outside_domain: Option<Outside>,
    /// Start values of the surrogate's parameters, states and unconnected inputs, and their origins.
    pub start_values: Vec<SurrogateStart>,
    /// Limits of the comparison.
    pub warnings: Vec<String>,
    /// The run with the source.
    #[serde(skip)]
    pub with_source: RecordedRows,
    /// The run with the surrogate.
    #[serde(skip)]
    pub with_surrogate: RecordedRows,
}

/// How much an output differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The output: a connector of the system, or `COMPONENT.CONNECTOR`.
    pub output: String,
    /// Its unit; empty if it has none.
    pub unit: String,
    /// Root mean square of the difference over all rows.
    pub rms: f64,
    /// Largest difference.
    pub max: f64,
    /// When that is, in s.
    pub max_time: f64,
    /// Range of the output in the run with the source.
    pub range: f64,
    /// `rms / range`; none for an output that is constant.
    pub relative_rms: Option<f64>,
    /// `max / range`; none for an output that is constant.
    pub relative_max: Option<f64>,
}

/// Rows outside the ranges that a surrogate is made for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Outside {
    /// How many.
    pub rows: usize,
    /// Time of the first of them, in s.
    pub first: f64,
}

impl Swap {
    /// Reads the system and the FMUs, and determines what the surrogate takes over from the source. Connectors and
    /// parameters match by their names. Parameters have the values that the system sets, else the source's own start
    /// values; `NAME_start` has that of the source's variable `NAME`. See [`Swap::start_values`].
    ///
    /// # Errors
    /// - as [`FmuSystem::open`], [`FmuSystem::load`] and [`Unpacked::open`];
    /// - [`Error::System`], [`Error::Replacement`] with all that does not fit;
    /// - [`Error::Experiment`] if the times make no simulation.
    pub fn open(options: &SwapOptions) -> Result<Self> {
        let system = FmuSystem::open(&options.system)?;
        let Some(replaced) = system.position(&options.component) else {
            let known = system.components.iter().map(|component| component.name.clone()).collect();
            return Err(Error::UnknownComponent { path: system.path, name: options.component.clone(), known });
        };
        let mut sources = (0..system.components.len()).map(|index| system.load(index)).collect::<Result<Vec<_>>>()?;
        let surrogate = ComponentSource::Fmu(Box::new(Unpacked::open(&options.surrogate, None, Patience::default())?));
        let experiment = experiment(options, &system, surrogate.description(), sources[replaced].description())?;
        let mut with_source = system.plan(&sources, replaced, experiment)?;
        refuse_misfits(&system, replaced, &surrogate)?;
        let compared = Compared::new(&system, replaced, &sources[replaced], &surrogate)?;
        let outputs = compared.names(&sources);
        let set: Vec<(&str, f64)> =
            system.components[replaced].values.iter().map(|value| (value.name.as_str(), value.value)).collect();
        let descriptions = [sources[replaced].description(), surrogate.description()];
        let is_connected = |name: &str| system.is_connected(replaced, name);
        let TakenOver { values: start_values, unused } =
            taken_over(descriptions, &set, &options.defaults, is_connected);
        let names: Vec<&str> = unused.iter().map(|(name, _)| name.as_str()).collect();
        refuse(&surrogate, counterparts::problems(descriptions, &names, &options.defaults))?;
        let doubts = start_values::doubts(&start_values, &options.defaults);
        let warnings = unused
            .iter()
            .map(|(name, value)| {
                format!("the system sets `{name}` to {value:?}, which the surrogate has no parameter for")
            })
            .chain(doubts)
            .chain(compared.left_out.iter().cloned())
            .collect();

        with_source.recorded = compared.ports(&sources);
        let mut with_surrogate = with_source.clone();
        let replacement = &mut with_surrogate.components[replaced];
        replacement.path = surrogate.path().to_owned();
        replacement.model = surrogate.model();
        replacement.start_values = start_values::to_set(surrogate.description(), &start_values);
        let source = std::mem::replace(&mut sources[replaced], surrogate);
        // names may be aliases
        with_surrogate.recorded = compared.ports(&sources);
        with_surrogate.connections = system.connect(&sources)?;
        with_surrogate.watched = in_domain(replaced, &sources[replaced]).into_iter().collect();
        let path = source.path().to_owned();
        let suggested_tolerance =
            source.description().default_experiment.and_then(|experiment| experiment.tolerance).filter(|t| *t > 0.0);
        sources.push(source);
        Ok(Self {
            component: options.component.clone(),
            surrogate: options.surrogate.clone(),
            source: path,
            system,
            outputs,
            start_values,
            warnings,
            with_source,
            with_surrogate,
            suggested_tolerance,
            _sources: sources,
        })
    }

    /// Start values of the surrogate's parameters, states and unconnected inputs, and their origins.
    pub fn start_values(&self) -> &[SurrogateStart] {
        &self.start_values
    }

    /// Makes both runs, each in a separate process, and compares them; `begins` is called with the FMU of each run.
    ///
    /// # Errors
    /// As [`run_system_apart`]; [`Error::Worker`] also if an output is not finite, or if there are no steps to compare.
    pub fn compare(&self, watch: Watch, mut begins: impl FnMut(&Path)) -> Result<SwapComparison> {
        let mut warnings = self.warnings.clone();
        let mut simulate = |run: &SystemRun, fmu: &Path| {
            begins(fmu);
            let mut recorded = RecordedRows::default();
            let ended = run_system_apart(&self.system.path, run, watch, &mut recorded)?;
            recorded.check(fmu, self.outputs.len())?;
            if ended {
                let last = recorded.times.last().copied().unwrap_or(run.start);
                warnings.push(format!("an FMU ended the simulation with {} after {last} s", fmu.display()));
            }
            Ok::<_, Error>(recorded)
        };
        let source = simulate(&self.with_source, &self.source)?;
        let surrogate = simulate(&self.with_surrogate, &self.surrogate)?;
        let rows = source.times.len().min(surrogate.times.len());
        if rows < 2 {
            let message = format!("{}: there are no steps to compare", self.system.path.display());
            return Err(Error::Worker { message });
        }
        let differences: Vec<Difference> = self
            .outputs
            .iter()
            .enumerate()
            .map(|(index, (output, unit))| {
                let values = [&source, &surrogate].map(|recorded| &recorded.values[index][..rows]);
                Difference::of(output, unit.clone(), &source.times[..rows], values)
            })
            .collect();
        let timed = self.time(watch, &source, &differences)?;
        let watched = surrogate.values.get(self.outputs.len()).filter(|_| !self.with_surrogate.watched.is_empty());
        Ok(SwapComparison {
            system: self.system.name.clone(),
            component: self.component.clone(),
            source: self.source.clone(),
            surrogate: self.surrogate.clone(),
            start: source.times[0],
            stop: source.times[rows - 1],
            step: self.with_source.step,
            steps: rows - 1,
            outputs: differences,
            component_step: timed.component_step,
            system_step: timed.system_step,
            source_tolerance: timed.source_tolerance,
            timed_simulations: timed.simulations,
            outside_domain: watched.and_then(|inside| Outside::of(&surrogate.times, inside)),
            start_values: self.start_values.clone(),
            warnings,
            with_source: source,
            with_surrogate: surrogate,
        })
    }
}

/// Fails if the surrogate lacks connectors of the component that are connected.
fn refuse_misfits(system: &FmuSystem, replaced: usize, surrogate: &ComponentSource) -> Result<()> {
    let problems: Vec<String> = system.components[replaced]
        .connectors
        .iter()
        .filter(|connector| system.is_connected(replaced, &connector.name))
        .filter_map(|connector| {
            let is_input = matches!(connector.kind, ConnectorKind::Input | ConnectorKind::Parameter);
            misfit(surrogate.description(), &connector.name, is_input)
        })
        .collect();
    refuse(surrogate, problems)
}

fn refuse(surrogate: &ComponentSource, problems: Vec<String>) -> Result<()> {
    let path = surrogate.path().to_owned();
    if problems.is_empty() { Ok(()) } else { Err(Error::Replacement { path, problems }) }
}

/// Variable that indicates whether a surrogate is within its domain.
fn in_domain(component: usize, surrogate: &ComponentSource) -> Option<Port> {
    let name = BuiltIn::InDomain.name();
    let variable = surrogate.description().variable(name)?;
    let tells = matches!(variable.causality, Causality::Output | Causality::Local) && is_number(variable);
    tells.then(|| port(component, surrogate, name))
}

/// Signals that are compared.
struct Compared {
    /// Name, component and connector of each output.
    outputs: Vec<(String, usize, String)>,
    /// Outputs of the source that are not compared, and why.
    left_out: Vec<String>,
}

impl Compared {
    /// The outputs of the system; if it has none, those of the component that both have.
    fn new(system: &FmuSystem, replaced: usize, source: &ComponentSource, surrogate: &ComponentSource) -> Result<Self> {
        let own = system.outputs.iter().map(|(name, end)| (name.clone(), end.component, end.connector.clone()));
        let mut compared = Self { outputs: own.collect(), left_out: Vec::new() };
        let component = &system.components[replaced];
        let connectors = component.connectors.iter().filter(|connector| connector.kind == ConnectorKind::Output);
        for Connector { name, .. } in connectors.filter(|_| system.outputs.is_empty()) {
            let misfit = [source, surrogate].into_iter().find_map(|of| misfit(of.description(), name, false));
            match misfit {
                None => compared.outputs.push((format!("{}.{name}", component.name), replaced, name.clone())),
                Some(problem) => compared.left_out.push(format!("`{name}` is not compared: {problem}")),
            }
        }
        if compared.outputs.is_empty() {
            let problem =
                "there is nothing to compare: neither has the system outputs, nor the component one that both have";
            return Err(Error::Replacement { path: surrogate.path().to_owned(), problems: vec![problem.into()] });
        }
        Ok(compared)
    }

    /// Names and units.
    fn names(&self, sources: &[ComponentSource]) -> Vec<(String, String)> {
        let outputs = self.outputs.iter();
        outputs
            .map(|(name, component, connector)| (name.clone(), unit(sources[*component].description(), connector)))
            .collect()
    }

    fn ports(&self, sources: &[ComponentSource]) -> Vec<Port> {
        self.outputs.iter().map(|(_, component, connector)| port(*component, &sources[*component], connector)).collect()
    }
}

/// Experiment and settings of both runs.
fn experiment(
    options: &SwapOptions,
    system: &FmuSystem,
    surrogate: &ModelDescription,
    source: &ModelDescription,
) -> Result<Experiment> {
    let suggested = [surrogate, source].into_iter().filter_map(|description| description.default_experiment);
    let start = options.start.or(system.start).unwrap_or(0.0);
    let stop = options.stop.or(system.stop).or_else(|| suggested.clone().find_map(|experiment| experiment.stop));
    let step = options.step.or_else(|| suggested.clone().find_map(|experiment| experiment.step_size));
    let expected = match (stop, step) {
        (None, _) => "a stop time, which neither the system nor the FMUs have",
        (_, None) => "a step size, which neither FMU has",
        (Some(stop), _) if stop <= start => "a stop time after the start time",
        (Some(stop), Some(step)) => match Grid::of_times(start, stop, step) {
            Ok(_) => return Ok(Experiment { start, stop, step, tolerance: options.tolerance }),
            Err(expected) => expected,
        },
    };
    Err(Error::Experiment { start, stop, step, expected })
}

fn unit(description: &ModelDescription, name: &str) -> String {
    let unit = description.variable(name).and_then(|variable| description.unit_of(variable));
    unit.unwrap_or_default().to_owned()
}

impl RowSink for RecordedRows {
    fn begin(&mut self, columns: &[RecordedColumn]) -> Result<()> {
        self.columns = columns.to_vec();
        self.values = vec![Vec::new(); columns.len()];
        Ok(())
    }

    fn row(&mut self, time: f64, values: &[f64]) -> Result<()> {
        self.times.push(time);
        self.values.iter_mut().zip(values).for_each(|(column, value)| column.push(*value));
        Ok(())
    }
}

impl RecordedRows {
    /// The values of a column that there is.
    fn column(&self, name: &str) -> &[f64] {
        let column = self.columns.iter().position(|column| column.name == name);
        column.map_or(&[], |column| &self.values[column])
    }

    /// Fails if one of the first columns is not finite.
    fn check(&self, fmu: &Path, outputs: usize) -> Result<()> {
        for (column, values) in self.columns.iter().zip(&self.values).take(outputs) {
            if let Some(row) = values.iter().position(|value| !value.is_finite()) {
                let (name, time, value) = (&column.name, self.times[row], values[row]);
                let message = format!("{}: in the system, `{name}` is {value} at {time} s", fmu.display());
                return Err(Error::Worker { message });
            }
        }
        Ok(())
    }
}

impl Difference {
    fn of(output: &str, unit: String, times: &[f64], [source, surrogate]: [&[f64]; 2]) -> Self {
        let differences = source.iter().zip(surrogate).map(|(source, surrogate)| (source - surrogate).abs());
        let squares = differences.clone().map(|difference| difference * difference);
        let rms = (squares.sum::<f64>() / times.len() as f64).sqrt();
        let (mut max, mut max_time) = (0.0, times[0]);
        for (difference, time) in differences.zip(times) {
            if difference > max {
                (max, max_time) = (difference, *time);
            }
        }
        let ends = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = source.iter().fold(ends, |(low, high), value| (low.min(*value), high.max(*value)));
        let range = high - low;
        let [relative_rms, relative_max] = [rms, max].map(|value| (range > 0.0).then(|| value / range));
        Self { output: output.to_owned(), unit, rms, max, max_time, range, relative_rms, relative_max }
    }
}

impl Outside {
    fn of(times: &[f64], inside: &[f64]) -> Option<Self> {
        let mut rows = times.iter().zip(inside).filter(|(_, inside)| **inside == 0.0).map(|(time, _)| *time);
        let first = rows.next()?;
        Some(Self { rows: 1 + rows.count(), first })
    }
}

/// The comparison as text: a table, and the times of a step.
impl fmt::Display for SwapComparison {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { system, component, steps, step, .. } = self;
        let (source, surrogate) = (self.source.display(), self.surrogate.display());
        writeln!(f, "{system}: {component} is {source}, and {surrogate} in its place; {steps} steps of {step} s\n")?;
        let headings = ["output", "unit", "RMS difference", "of the range", "largest difference", "of the range"];
        let mut rows = vec![headings.map(str::to_owned).to_vec()];
        for Difference { output, unit, rms, max, max_time, relative_rms, relative_max, .. } in &self.outputs {
            let (rms, max) = (format!("{rms:.3e}"), format!("{max:.3e} at {max_time:.6} s"));
            rows.push(vec![
                output.clone(),
                unit.clone(),
                rms,
                percent_or_constant(*relative_rms),
                max,
                percent_or_constant(*relative_max),
            ]);
        }
        f.write_str(&aligned(&rows))?;
        writeln!(f)?;
        let mut rows = vec![
            ["µs a step", "source: median", "minimum", "surrogate: median", "minimum", "speed-up"]
                .map(str::to_owned)
                .to_vec(),
        ];
        for (name, speed) in [(component.as_str(), &self.component_step), ("the system", &self.system_step)] {
            let StepSpeed { source, surrogate, speed_up } = speed;
            let times = [source.median, source.minimum, surrogate.median, surrogate.minimum]
                .map(|seconds| format!("{:.2}", 1e6 * seconds));
            rows.push([vec![name.to_owned()], times.to_vec(), vec![format!("{speed_up:.2}")]].concat());
        }
        f.write_str(&aligned(&rows))?;
        let simulations = self.timed_simulations;
        match self.source_tolerance {
            Some(tolerance) => writeln!(
                f,
                "(alternately in {simulations} simulations of each; the source with a tolerance of {tolerance:?}, the loosest whose \
                 differences are no larger than the surrogate's)"
            ),
            None => writeln!(f, "(alternately in {simulations} simulations of each)"),
        }
    }
}

fn percent_or_constant(share: Option<f64>) -> String {
    match share.map(|share| 100.0 * share) {
        None => "constant".into(),
        Some(percent) if percent == 0.0 || percent >= 5e-4 => format!("{percent:.3} %"),
        Some(percent) => format!("{percent:.1e} %"),
    }
}

/// Columns side by side: the first to the left, the others to the right.
fn aligned(rows: &[Vec<String>]) -> String {
    let widths: Vec<usize> = (0..rows[0].len())
        .map(|column| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for row in rows {
        for (index, (cell, width)) in row.iter().zip(&widths).enumerate() {
            // writing to a text does not fail
            let _ = if index == 0 { write!(text, "{cell:<width$}") } else { write!(text, "  {cell:>width$}") };
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_measured_against_the_range_of_the_source() {
        let difference =
            Difference::of("y", "m".into(), &[0.0, 0.5, 1.0, 1.5], [&[1.0, 2.0, 3.0, 5.0], &[1.0, 2.3, 2.6, 5.0]]);
        assert!((difference.rms - (0.25f64 / 4.0).sqrt()).abs() < 1e-15);
        assert!((difference.max - 0.4).abs() < 1e-15 && difference.max_time == 1.0);
        assert_eq!(difference.range, 4.0);
        assert!((difference.relative_max.unwrap() - 0.1).abs() < 1e-15);
        let constant = Difference::of("y", String::new(), &[0.0, 1.0], [&[2.0, 2.0], &[2.0, 2.5]]);
        assert_eq!((constant.relative_max, constant.max, constant.max_time), (None, 0.5, 1.0));
    }

    #[test]
    fn the_first_time_outside_the_domain_is_found() {
        let times = [0.0, 0.1, 0.2, 0.3];
        assert_eq!(Outside::of(&times, &[1.0; 4]), None);
        assert_eq!(Outside::of(&times, &[1.0, 0.0, 1.0, 0.0]), Some(Outside { rows: 2, first: 0.1 }));
    }
}
