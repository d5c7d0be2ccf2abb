//! A baseline in a separate process: a library that cannot be interrupted, panics or exhausts memory costs its row of
//! the table and nothing else.
//!
//! Input is a line of JSON, then the numbers of the rows and of the test inputs. Output is a line of JSON, then the
//! predictions. All numbers are little-endian doubles.

use crate::{BaselineCause, BaselineError, BaselineKind, Baselines, Fitted, StandardizedRows, model};
use metafmu_core::processor_time::{ProcessorClock, ProcessorTimer};
use metafmu_runtime::Scaling;
use serde::{Deserialize, Serialize};
use std::{
    io::{BufRead, BufReader, Read, Write},
    panic::{AssertUnwindSafe, catch_unwind},
    time::{Duration, Instant},
};

/// Exit code of a worker that was too slow.
pub const TOO_SLOW: i32 = 3;

/// Task of a worker: the model to fit and the rows to evaluate it at.
#[derive(Clone, Debug, PartialEq)]
pub struct FitTask {
    /// The model.
    pub kind: BaselineKind,
    /// The options of all of them.
    pub options: Baselines,
    /// Everything random follows from it.
    pub seed: u64,
    /// The rows it is fitted to.
    pub rows: StandardizedRows,
    /// Inputs of the test rows, in the study's units: shape `[test rows, inputs]`.
    pub test: Vec<f64>,
}

/// Result of a [`FitTask`].
#[derive(Clone, Debug, PartialEq)]
pub struct FitResult {
    /// The fit, or the reason why there is none.
    pub result: Result<BaselineFit, BaselineError>,
    /// Outputs of the test rows, in the study's units: shape `[test rows, outputs]`.
    pub predictions: Vec<f64>,
}

/// A fit that went well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BaselineFit {
    /// Processor seconds of fitting.
    pub fit_seconds: f64,
    /// Seconds of one prediction of all outputs at one point.
    pub predict_seconds_per_point: f64,
    /// Bytes of the fitted model.
    pub memory_bytes: u64,
    /// Why it cannot be exported, if that is so.
    pub not_exportable: Option<String>,
}

#[derive(Serialize, Deserialize)]
struct TaskHeader {
    kind: BaselineKind,
    options: Baselines,
    seed: u64,
    columns: [Vec<f64>; 4],
    rows: usize,
    test_rows: usize,
}

#[derive(Serialize, Deserialize)]
struct ResultHeader {
    result: Result<BaselineFit, BaselineError>,
    predictions: usize,
}

impl FitTask {
    /// Sends it to a worker.
    ///
    /// # Errors
    /// If the worker does not listen.
    pub fn write(&self, mut to: impl Write) -> std::io::Result<()> {
        let Scaling { input_mean, input_scale, output_mean, output_scale } = self.rows.scaling.clone();
        let header = TaskHeader {
            kind: self.kind,
            options: self.options.clone(),
            seed: self.seed,
            columns: [input_mean, input_scale, output_mean, output_scale],
            rows: self.rows.len(),
            test_rows: self.test.len() / self.rows.inputs,
        };
        serde_json::to_writer(&mut to, &header)?;
        to.write_all(b"\n")?;
        [&self.rows.x, &self.rows.y, &self.test].into_iter().try_for_each(|values| write_numbers(&mut to, values))?;
        to.flush()
    }

    fn read(mut from: impl BufRead) -> std::io::Result<Self> {
        let TaskHeader { kind, options, seed, columns, rows, test_rows } = read_line(&mut from)?;
        let [input_mean, input_scale, output_mean, output_scale] = columns;
        let (inputs, outputs) = (input_mean.len(), output_mean.len());
        let x = read_numbers(&mut from, rows * inputs)?;
        let y = read_numbers(&mut from, rows * outputs)?;
        let scaling = Scaling { input_mean, input_scale, output_mean, output_scale };
        let rows = StandardizedRows { inputs, outputs, x, y, scaling };
        Ok(Self { kind, options, seed, rows, test: read_numbers(&mut from, test_rows * inputs)? })
    }

    /// Fits and predicts. A panic is a failure like any other.
    pub fn perform(&self) -> FitResult {
        match caught(|| self.fit_and_predict()) {
            Ok((fit, predictions)) => FitResult { result: Ok(fit), predictions },
            Err(error) => FitResult { result: Err(error), predictions: Vec::new() },
        }
    }

    fn fit_and_predict(&self) -> Result<(BaselineFit, Vec<f64>), BaselineError> {
        let timer = ProcessorTimer::start(ProcessorClock::Process);
        let fitted = model(&self.options, self.kind).fit(&self.rows, self.seed)?;
        let fit_seconds = timer.seconds();
        let began = Instant::now();
        let predictions = self.predict(&fitted)?;
        let predict_seconds = began.elapsed().as_secs_f64();
        if !predictions.iter().all(|value| value.is_finite()) {
            return Err(BaselineError::new(BaselineCause::NotFinite, "its predictions are not finite"));
        }
        let points = (self.test.len() / self.rows.inputs).max(1);
        let fit = BaselineFit {
            fit_seconds,
            predict_seconds_per_point: predict_seconds / points as f64,
            memory_bytes: match &fitted {
                Fitted::Formula(graph) => graph.bytes(),
                Fitted::Library(model) => model.memory_bytes,
            },
            not_exportable: match fitted {
                Fitted::Formula(_) => None,
                Fitted::Library(model) => Some(model.not_exportable.into()),
            },
        };
        Ok((fit, predictions))
    }

    fn predict(&self, fitted: &Fitted) -> Result<Vec<f64>, BaselineError> {
        let StandardizedRows { inputs, outputs, scaling, .. } = &self.rows;
        match fitted {
            Fitted::Formula(graph) => {
                graph.check(*inputs, *outputs).map_err(BaselineError::library)?;
                Ok(graph.evaluate(self.test.chunks(*inputs)).into_values())
            }
            Fitted::Library(model) => {
                let columns = scaling.input_mean.iter().zip(&scaling.input_scale).cycle();
                let standardized: Vec<f64> =
                    self.test.iter().zip(columns).map(|(x, (mean, scale))| (x - mean) / scale).collect();
                let predictions = (model.predict)(&standardized)?;
                let columns = scaling.output_mean.iter().zip(&scaling.output_scale).cycle();
                Ok(predictions.iter().zip(columns).map(|(z, (mean, scale))| mean + scale * z).collect())
            }
        }
    }
}

impl FitResult {
    fn write(&self, mut to: impl Write) -> std::io::Result<()> {
        let header = ResultHeader { result: self.result.clone(), predictions: self.predictions.len() };
        serde_json::to_writer(&mut to, &header)?;
        to.write_all(b"\n")?;
        write_numbers(&mut to, &self.predictions)?;
        to.flush()
    }

    /// Reads the result of a worker.
    ///
    /// # Errors
    /// If the result is incomplete.
    pub fn read(from: &[u8]) -> std::io::Result<Self> {
        let mut from = BufReader::new(from);
        let ResultHeader { result, predictions } = read_line(&mut from)?;
        Ok(Self { result, predictions: read_numbers(&mut from, predictions)? })
    }
}

/// Result of a library's function; a panic is a failure like any other.
///
/// # Errors
/// That of the function; [`BaselineCause::Library`] with the message of a panic.
pub fn caught<T>(work: impl FnOnce() -> Result<T, BaselineError>) -> Result<T, BaselineError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().cloned();
        let text = text.or_else(|| panic.downcast_ref::<&str>().map(|&text| text.to_owned()));
        Err(BaselineError::library(format!("the library panicked: {}", text.unwrap_or_default())))
    })
}

/// Does one task and ends; the process ends with [`TOO_SLOW`] after the time budget.
///
/// # Errors
/// If the task does not come or the answer cannot be sent.
pub fn serve(from: impl Read, to: impl Write) -> std::io::Result<()> {
    let task = FitTask::read(BufReader::new(from))?;
    // a budget of years is none
    let budget = Duration::try_from_secs_f64(task.options.time_budget).unwrap_or(Duration::MAX);
    std::thread::spawn(move || {
        std::thread::sleep(budget);
        std::process::exit(TOO_SLOW);
    });
    std::panic::set_hook(Box::new(|_| {}));
    task.perform().write(std::io::BufWriter::new(to))
}

fn write_numbers(to: &mut impl Write, values: &[f64]) -> std::io::Result<()> {
    values.iter().try_for_each(|value| to.write_all(&value.to_le_bytes()))
}

fn read_numbers(from: &mut impl Read, count: usize) -> std::io::Result<Vec<f64>> {
    let mut bytes = [0; 8];
    (0..count).map(|_| from.read_exact(&mut bytes).map(|()| f64::from_le_bytes(bytes))).collect()
}

fn read_line<T: for<'a> Deserialize<'a>>(from: &mut impl BufRead) -> std::io::Result<T> {
    let mut line = String::new();
    from.read_line(&mut line)?;
    Ok(serde_json::from_str(&line)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::wavy_rows;

    fn task(kind: BaselineKind) -> FitTask {
        let rows = wavy_rows(200);
        let test = rows.scaling.input_mean.repeat(3);
        let mut options = Baselines::default();
        options.gaussian_process.rows = 50;
        options.gaussian_process.steps = 5;
        options.polynomial.degree = Some(3);
        FitTask { kind, options, seed: 1, rows, test }
    }

    #[test]
    fn a_task_and_its_answer_arrive_as_they_were_sent() {
        let task = task(BaselineKind::Ridge);
        let mut bytes = Vec::new();
        task.write(&mut bytes).unwrap();
        assert_eq!(FitTask::read(bytes.as_slice()).unwrap(), task);
        let (answer, mut bytes) = (task.perform(), Vec::new());
        answer.write(&mut bytes).unwrap();
        assert_eq!(FitResult::read(&bytes).unwrap(), answer);
        assert!(FitResult::read(&bytes[..bytes.len() - 1]).is_err(), "broken off");
    }

    #[test]
    fn every_baseline_predicts_finite_numbers_and_the_same_ones_again() {
        for kind in BaselineKind::ALL {
            let (once, again) = (task(kind).perform(), task(kind).perform());
            assert!(once.result.is_ok(), "{kind:?}: {:?}", once.result);
            assert_eq!(once.predictions.len(), 6, "{kind:?}");
            assert_eq!(once.predictions, again.predictions, "{kind:?}");
        }
    }

    #[test]
    fn a_panic_and_a_mistake_are_answers() {
        let mut broken = task(BaselineKind::DecisionTree);
        broken.rows.y.truncate(10);
        assert_eq!(broken.perform().result.unwrap_err().cause, BaselineCause::Library);
        let mut infinite = task(BaselineKind::Linear);
        infinite.test[0] = f64::INFINITY;
        let expected = BaselineError::new(BaselineCause::NotFinite, "its predictions are not finite");
        let answer = infinite.perform();
        assert_eq!(answer.result, Err(expected));
        let mut bytes = Vec::new();
        answer.write(&mut bytes).unwrap();
        assert_eq!(FitResult::read(&bytes).unwrap(), answer, "an error has its cause in both processes");
    }
}
