//! `metafmu._metafmu`: the native part of the Python package.
//!
//! A thin layer: rows come and go as bytes of doubles, descriptions as JSON. Every error is a `metafmu.Error` with the
//! message that the command prints. Work runs in a separate thread, without Python's lock, while the caller's thread
//! checks for Ctrl-C and shows progress.

mod graph;
mod interruptible;
mod threads;

use interruptible::interruptible;
use metafmu::{
    dataset::Run,
    diagnostics::names::{self, NameMatch},
    evaluation::{self, Accuracy, TestRows},
    export::validate_apart,
    fmi::{Watch, Workers},
    import::interface::ModelInterface,
    import::{self, ImportError, Imported, onnx, rounding::RandomRounding},
    pipeline::{
        self, Project,
        export::{ExportPlan, ExportRequest, WrittenFmu},
        fit::FitOptions,
        predict,
    },
    study::FmiChoice,
    surrogate,
};
use metafmu_runtime::{Domain, Evaluator, Rows};
use pyo3::{
    create_exception,
    exceptions::PyValueError,
    prelude::*,
    types::{PyByteArray, PyBytes},
};
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use serde_json::json;
use std::{
    ffi::OsString,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
};
use threads::detached;

create_exception!(metafmu, Error, PyValueError, "What the command `metafmu` would say about wrong input.");

/// An error as Python has it.
fn refused(error: impl std::fmt::Display) -> PyErr {
    Error::new_err(error.to_string())
}

/// Rows that are evaluated between two looks at whether the work must end.
const ROWS: usize = 4096;

/// A surrogate, laid out for evaluation.
#[pyclass(name = "Surrogate", frozen, module = "metafmu._metafmu")]
struct PySurrogate {
    surrogate: metafmu_runtime::Surrogate,
    evaluator: Evaluator,
    domain: Domain,
}

impl PySurrogate {
    fn new(surrogate: metafmu_runtime::Surrogate) -> Self {
        Self { evaluator: Evaluator::new(&surrogate), domain: Domain::of(&surrogate), surrogate }
    }

    /// Results of `row` for each row of doubles, `width` numbers each.
    fn rows<'py>(
        &self,
        py: Python<'py>,
        x: &[u8],
        width: usize,
        row: impl Fn(&[f64], &mut [f64], &mut Evaluator) + Sync,
    ) -> PyResult<Bound<'py, PyByteArray>> {
        let evaluator = &self.evaluator;
        let columns = evaluator.columns();
        let numbers = doubles(x);
        if !numbers.len().is_multiple_of(columns) {
            return Err(refused(format!("{} numbers, expected rows of {columns}", numbers.len())));
        }
        let mut values = vec![0.0; numbers.len() / columns * width];
        interruptible(py, |stop, _| {
            let pieces = values.par_chunks_mut(ROWS * width).zip(numbers.par_chunks(ROWS * columns));
            pieces.for_each_init(
                || evaluator.clone(),
                |evaluator, (values, points)| {
                    if stop.load(Ordering::Relaxed) {
                        return;
                    }
                    for (values, point) in values.chunks_exact_mut(width).zip(points.chunks_exact(columns)) {
                        // a comparison with NaN has no result
                        match point.iter().any(|number| number.is_nan()) {
                            true => values.fill(f64::NAN),
                            false => row(point, values, evaluator),
                        }
                    }
                },
            );
        })?;
        Ok(PyByteArray::new(py, &bytes(&values)))
    }
}

#[pymethods]
impl PySurrogate {
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        detached(py, || predict::load_file(&path)).map(Self::new).map_err(refused)
    }

    #[staticmethod]
    fn from_bytes(bytes: &[u8]) -> PyResult<Self> {
        metafmu_runtime::Surrogate::from_bytes(bytes).map(Self::new).map_err(refused)
    }

    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.surrogate.to_bytes().map_err(refused)?))
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        detached(py, || surrogate::save(&self.surrogate, &path)).map_err(refused)
    }

    /// Name, variables and provenance, as JSON.
    fn metadata(&self) -> PyResult<String> {
        serde_json::to_string(self.surrogate.metadata()).map_err(refused)
    }

    /// Refuses a surrogate with states: rows do not say what was before.
    fn stateless(&self) -> PyResult<()> {
        if !self.surrogate.program().has_memory() {
            return Ok(());
        }
        let name = &self.surrogate.metadata().name;
        Err(refused(format!(
            "`{name}` has states: its outputs follow from what was before, expected a surrogate without; `simulate` goes along its inputs in time, and `metafmu predict` along those in a table"
        )))
    }

    /// Refuses a surrogate without states: there is nothing to begin with.
    fn stateful(&self) -> PyResult<()> {
        if self.surrogate.program().has_memory() {
            return Ok(());
        }
        let name = &self.surrogate.metadata().name;
        Err(refused(format!("`{name}` has no states: its outputs follow from its inputs alone, `predict` gives them")))
    }

    fn predict<'py>(&self, py: Python<'py>, x: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
        self.rows(py, x, self.evaluator.results(), |point, values, evaluator| evaluator.evaluate(point, values))
    }

    /// Distance of each row from the domain of validity.
    fn domain_distance<'py>(&self, py: Python<'py>, x: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
        self.rows(py, x, 1, |point, values, _| values[0] = self.domain.distance(point, 0))
    }

    /// Accuracy of predictions against expected outputs, as JSON.
    fn evaluate(&self, py: Python<'_>, x: &[u8], y: &[u8]) -> PyResult<String> {
        let (points, labels) =
            (rows(Some(x), self.evaluator.columns()), rows(Some(y), self.surrogate.predictions().len()));
        let (points, labels) = (points.unwrap_or_default(), labels.unwrap_or_default());
        let accuracy = detached(py, || Accuracy::of_rows(&self.surrogate, TestRows::Given, &points, &labels));
        serde_json::to_string(&accuracy).map_err(refused)
    }

    /// Time between two samples, in seconds, of a discrete-time surrogate.
    fn sample_time(&self) -> Option<f64> {
        self.surrogate.program().sampling().map(|sampling| sampling.step)
    }

    /// Outputs of a surrogate with states at each of the times, from its start on. `constants` are its parameters and
    /// starts. `inputs` has a row for each time, `measured` a row of outputs for each negative time, or no rows.
    fn simulate<'py>(
        &self,
        py: Python<'py>,
        times: &[u8],
        inputs: &[u8],
        constants: Vec<f64>,
        measured: &[u8],
    ) -> PyResult<Bound<'py, PyByteArray>> {
        let (times, inputs, outputs) = (doubles(times).into(), doubles(inputs), doubles(measured));
        let run = Run { parameters: constants, times, inputs, outputs };
        let outputs = detached(py, || evaluation::predict(&self.surrogate, &self.evaluator, &run));
        Ok(PyByteArray::new(py, &bytes(&outputs)))
    }

    /// Derivatives of each output by each input, at each row, output by output.
    fn jacobian<'py>(&self, py: Python<'py>, x: &[u8]) -> PyResult<Bound<'py, PyByteArray>> {
        let (inputs, outputs) = (self.evaluator.columns(), self.evaluator.results());
        self.rows(py, x, inputs * outputs, |point, values, evaluator| {
            let (mut direction, mut column) = (vec![0.0; inputs], vec![0.0; outputs]);
            for input in 0..inputs {
                direction[input] = 1.0;
                evaluator.directional(point, &direction, &mut column);
                direction[input] = 0.0;
                values.iter_mut().skip(input).step_by(inputs).zip(&column).for_each(|(to, from)| *to = *from);
            }
        })
    }

    fn to_onnx(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        detached(py, || pipeline::export::export_onnx(&self.surrogate, &path)).map(drop).map_err(refused)
    }

    fn export(
        &self,
        py: Python<'_>,
        path: PathBuf,
        fmi: &str,
        contents: (bool, Vec<String>),
        variables: (String, Vec<String>, String),
        accuracy: Option<&str>,
    ) -> PyResult<Vec<PathBuf>> {
        let accuracy: Option<Accuracy> = accuracy.map(serde_json::from_str).transpose().map_err(refused)?;
        let ((sources, platforms), (interface, ports, names)) = (contents, variables);
        let ports = ports.into_iter().map(|port| choice("ports", port)).collect::<PyResult<_>>()?;
        let options = ExportRequest {
            fmi: versions(Some(fmi))?,
            platforms,
            binaries: Vec::new(),
            sources,
            interface: Some(choice("interface", interface)?),
            ports: Some(ports),
            names: Some(choice("names", names)?),
        };
        let written =
            detached(py, || pipeline::export::export_surrogate(&self.surrogate, accuracy.as_ref(), &path, &options));
        Ok(written.map_err(refused)?.into_iter().map(|WrittenFmu { fmu, .. }| fmu).collect())
    }
}

/// A choice by its name in study files.
fn choice<T: DeserializeOwned>(option: &str, name: String) -> PyResult<T> {
    serde_json::from_value(name.into()).map_err(|error| refused(format!("{option}: {error}")))
}

fn versions(fmi: Option<&str>) -> PyResult<Option<FmiChoice>> {
    Ok(match fmi {
        None => None,
        Some("2") => Some(FmiChoice::V2),
        Some("3") => Some(FmiChoice::V3),
        Some("both") => Some(FmiChoice::Both),
        Some(other) => return Err(refused(format!("fmi=\"{other}\", expected \"2\", \"3\" or \"both\""))),
    })
}

fn doubles(bytes: &[u8]) -> Vec<f64> {
    bytes.chunks_exact(8).map(|eight| f64::from_ne_bytes(std::array::from_fn(|place| eight[place]))).collect()
}

fn bytes(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_ne_bytes()).collect()
}

/// Rows of doubles; none of no bytes.
fn rows(bytes: Option<&[u8]>, columns: usize) -> Option<Rows> {
    bytes.map(|bytes| doubles(bytes).chunks_exact(columns.max(1)).collect())
}

/// Problems of a model as an error of Python, one per line.
fn unreadable(problems: Vec<ImportError>) -> PyErr {
    refused(problems.iter().map(ImportError::to_string).collect::<Vec<_>>().join("\n"))
}

/// The columns that an ONNX model takes and gives.
#[pyfunction]
fn onnx_columns(py: Python<'_>, model: &[u8], folder: Option<PathBuf>) -> PyResult<(Vec<String>, Vec<String>)> {
    let imported = detached(py, || onnx::read(model, folder.as_deref())).map_err(unreadable)?;
    Ok((imported.inputs, imported.outputs))
}

/// A message if a name is that of another column than by position, apart from its spelling; each list with what it is.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
fn out_of_order(names: (String, Vec<String>), columns: (String, Vec<String>)) -> Option<String> {
    let [listed, known] = [&names.1, &columns.1].map(|list| list.iter().map(String::as_str).collect::<Vec<_>>());
    names::out_of_order_problem((&names.0, &listed), (&columns.0, &known))
}

/// A message with all names that are missing among the known ones, each with the closest of those that are not wanted.
/// `kind`: what they name. None if nothing is missing.
#[pyfunction]
#[allow(clippy::needless_pass_by_value)]
fn missing(kind: &str, wanted: Vec<String>, known: Vec<String>) -> Option<String> {
    let [wanted, known] = [&wanted, &known].map(|list| list.iter().map(String::as_str).collect::<Vec<_>>());
    let NameMatch { positions, unused } = NameMatch::of(&wanted, &known);
    let absent = wanted.iter().zip(positions).filter(|(_, position)| position.is_none()).map(|(name, _)| *name);
    let unused: Vec<&str> = unused.into_iter().map(|place| known[place]).collect();
    names::missing(kind, &absent.collect::<Vec<_>>(), &known, &unused)
}

/// The outputs of an ONNX model at rows of its columns, as they are read here; states that it has itself are those of the start. `rounding`
/// rounds all values at random: its relative and absolute size, and a seed.
#[pyfunction]
fn onnx_evaluate<'py>(
    py: Python<'py>,
    model: &[u8],
    folder: Option<PathBuf>,
    x: &[u8],
    rounding: Option<(f64, f64, u64)>,
) -> PyResult<Bound<'py, PyByteArray>> {
    let evaluated = detached(py, || {
        let Imported { inputs, builder, columns, recurrences, .. } =
            onnx::read(model, folder.as_deref()).map_err(unreadable)?;
        let starts: Vec<f64> = recurrences.into_iter().flat_map(|state| state.start).collect();
        let rows = rows(Some(x), inputs.len()).unwrap_or_default();
        let points: Rows = rows.iter().map(|row| [row, &starts].concat()).collect();
        let graph = match rounding {
            Some((relative, absolute, seed)) => RandomRounding { relative, absolute, seed }.of(&builder, columns),
            None => builder.finish(columns),
        };
        Ok(graph.map_err(refused)?.evaluate(&points).into_values())
    });
    evaluated.map(|values| PyByteArray::new(py, &bytes(&values)))
}

#[pyfunction]
fn from_onnx(
    py: Python<'_>,
    model: &[u8],
    folder: Option<PathBuf>,
    interface: &str,
    data: Option<&[u8]>,
) -> PyResult<PySurrogate> {
    detached(py, || {
        let interface = ModelInterface::from_json(interface).map_err(refused)?;
        let imported = onnx::read(model, folder.as_deref()).map_err(unreadable)?;
        let rows = rows(data, interface.variables().count());
        let path = Path::new(&interface.name);
        let made = import::surrogate((path, model), imported, &interface, rows);
        made.map(PySurrogate::new).map_err(refused)
    })
}

/// Trains a network; the result is the surrogate, and how the training went, as JSON.
#[pyfunction]
fn fit(
    py: Python<'_>,
    x: &[u8],
    y: &[u8],
    interface: &str,
    options: &str,
    verbose: bool,
) -> PyResult<(PySurrogate, String)> {
    let interface = ModelInterface::from_json(interface).map_err(refused)?;
    let options: FitOptions = serde_json::from_str(options).map_err(|error| {
        // a place in JSON that nobody wrote says nothing
        let (message, place) = (error.to_string(), format!(" at line {} column {}", error.line(), error.column()));
        refused(format!("options: {}", message.trim_end_matches(&place)))
    })?;
    let inputs = rows(Some(x), interface.variables().count()).unwrap_or_default();
    let outputs = rows(Some(y), interface.outputs.len()).unwrap_or_default();
    let program = PathBuf::new();
    let done = interruptible(py, |stop, lines| {
        let lines = lines.only_if(verbose);
        pipeline::fit::fit((inputs, &outputs), &interface, &options, lines.control(stop, &program))
    })?;
    let (surrogate, fit) = done.map_err(refused)?;
    Ok((PySurrogate::new(surrogate), serde_json::to_string(&fit).map_err(refused)?))
}

/// Name and folder of results of a study.
#[pyfunction]
fn study(path: PathBuf, out: Option<PathBuf>, program: PathBuf) -> PyResult<(String, PathBuf)> {
    let stop = AtomicBool::new(false);
    let control = pipeline::Control { observer: &pipeline::Silent, stop: &stop, program: &program, heard: |_| {} };
    let project = Project::open(&path, out.as_deref(), control).map_err(refused)?;
    Ok((project.study.name.clone(), project.folder().to_owned()))
}

/// Builds a study; what was made, as JSON.
#[pyfunction]
fn build(
    py: Python<'_>,
    path: PathBuf,
    out: Option<PathBuf>,
    fmi: Option<&str>,
    resume: bool,
    program: PathBuf,
    verbose: bool,
) -> PyResult<String> {
    let options = ExportRequest { fmi: versions(fmi)?, ..ExportRequest::default() };
    let built = interruptible(py, |stop, lines| {
        let lines = lines.only_if(verbose);
        let project = Project::open(&path, out.as_deref(), lines.control(stop, &program))?;
        let built = pipeline::build(&project, &ExportPlan::new(&project, &options)?, resume)?;
        let fmus: Vec<_> = (built.fmus.iter())
            .map(|(written, report)| json!({ "fmu": written.fmu, "problems": report.problems }))
            .collect();
        Ok::<_, metafmu::Error>(json!({
            "name": project.study.name,
            "folder": project.folder(),
            "model": project.model(),
            "report": project.report(),
            "metrics": built.metrics,
            "table": pipeline::evaluate::table(&project, &built.metrics),
            "accepted": built.verdict.accepted,
            "verdict": built.verdict.text(),
            "fmus": fmus,
        }))
    })?;
    Ok(built.map_err(refused)?.to_string())
}

/// Problems found in an FMU, as JSON.
#[pyfunction]
fn validate(py: Python<'_>, fmu: PathBuf, time_limit: f64, program: PathBuf) -> PyResult<String> {
    let limit = std::time::Duration::try_from_secs_f64(time_limit).map_err(refused)?;
    let report = interruptible(py, |stop, _| {
        let watch = Watch { workers: Workers { program: &program, stop }, limit: Some(limit), heard: |_| {} };
        validate_apart(&fmu, watch)
    })?;
    let report = report.map_err(refused)?;
    let text = report.to_string();
    let report = json!({
        "problems": report.problems, "not_checked": report.not_checked, "was_run": report.was_run, "text": text
    });
    Ok(report.to_string())
}

/// The command `metafmu`; the result is its exit code.
#[pyfunction]
fn command(py: Python<'_>, arguments: Vec<OsString>, program: PathBuf) -> u8 {
    detached(py, || metafmu::command(arguments, Some(&program)))
}

#[pymodule]
fn _metafmu(module: &Bound<'_, PyModule>) -> PyResult<()> {
    threads::of_this_process();
    module.add("Error", module.py().get_type::<Error>())?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add("FUNCTIONS", graph::names())?;
    module.add_class::<PySurrogate>()?;
    module.add_class::<graph::PyGraph>()?;
    module.add_function(wrap_pyfunction!(onnx_columns, module)?)?;
    module.add_function(wrap_pyfunction!(onnx_evaluate, module)?)?;
    module.add_function(wrap_pyfunction!(out_of_order, module)?)?;
    module.add_function(wrap_pyfunction!(missing, module)?)?;
    module.add_function(wrap_pyfunction!(from_onnx, module)?)?;
    module.add_function(wrap_pyfunction!(fit, module)?)?;
    module.add_function(wrap_pyfunction!(study, module)?)?;
    module.add_function(wrap_pyfunction!(build, module)?)?;
    module.add_function(wrap_pyfunction!(validate, module)?)?;
    module.add_function(wrap_pyfunction!(command, module)?)
}
