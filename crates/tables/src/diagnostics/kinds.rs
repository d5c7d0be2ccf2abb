//! Files of unexpected kinds, recognized by their names, and the commands that handle them.

use crate::Error;
use std::path::Path;

/// A kind of file that people give where another one is expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// CSV or Parquet.
    Table,
    /// Spreadsheet of Excel or another office suite.
    Spreadsheet,
    /// An FMU.
    Fmu,
    /// ONNX.
    Onnx,
    /// Arrays of numpy.
    Arrays,
    /// Tensors, or a model file of metafmu.
    Tensors,
    /// Parameters or a whole model of PyTorch.
    Torch,
    /// A model of Keras.
    Keras,
    /// An object of Python, such as an estimator of scikit-learn.
    Pickle,
    /// Source text of Modelica.
    Modelica,
    /// A model of Simulink.
    Simulink,
    /// A notebook of Jupyter.
    Notebook,
    /// A program in Python.
    Python,
    /// A system of FMUs.
    System,
    /// A study, mechanism or interface.
    Toml,
}

/// The kind of a file by the end of its name, if it is one of these.
pub fn of(path: &Path) -> Option<FileKind> {
    Some(match path.extension()?.to_string_lossy().to_lowercase().as_str() {
        "csv" | "parquet" | "tsv" => FileKind::Table,
        "xlsx" | "xls" | "xlsm" | "ods" => FileKind::Spreadsheet,
        "fmu" => FileKind::Fmu,
        "onnx" => FileKind::Onnx,
        "npz" | "npy" => FileKind::Arrays,
        "safetensors" => FileKind::Tensors,
        "pt" | "pth" | "ckpt" => FileKind::Torch,
        "keras" | "h5" | "hdf5" => FileKind::Keras,
        "pkl" | "pickle" | "joblib" => FileKind::Pickle,
        "mo" => FileKind::Modelica,
        "slx" | "mdl" => FileKind::Simulink,
        "ipynb" => FileKind::Notebook,
        "py" => FileKind::Python,
        "ssp" | "ssd" => FileKind::System,
        "toml" => FileKind::Toml,
        _ => return None,
    })
}

/// The error of a file that is something else than `expected`.
pub fn other(path: &Path, expected: &str) -> Error {
    let message = of(path).map_or_else(|| format!("expected {expected}"), |kind| kind.instead(expected));
    Error::OtherFile { path: path.to_owned(), message }
}

impl FileKind {
    /// Returns true if `metafmu import` may read it.
    pub fn is_trained_model(self) -> bool {
        matches!(self, Self::Onnx | Self::Arrays | Self::Tensors | Self::Fmu)
    }

    /// The kind as text, with its article.
    fn what(self) -> &'static str {
        match self {
            Self::Table => "a table",
            Self::Spreadsheet => "a spreadsheet",
            Self::Fmu => "an FMU",
            Self::Onnx => "an ONNX model",
            Self::Arrays => "arrays of numpy",
            Self::Tensors => "a model file or tensors",
            Self::Torch => "a file of PyTorch",
            Self::Keras => "a model of Keras",
            Self::Pickle => "an object of Python",
            Self::Modelica => "a model in Modelica",
            Self::Simulink => "a model of Simulink",
            Self::Notebook => "a notebook",
            Self::Python => "a Python program",
            Self::System => "a system of FMUs",
            Self::Toml => "a file in TOML",
        }
    }

    /// The `metafmu` command or the conversion that handles a file of this kind.
    fn advice(self) -> &'static str {
        match self {
            Self::Table => "`metafmu new NAME --table FILE` writes a study of it",
            Self::Spreadsheet => "save it as CSV; `metafmu new NAME --table FILE.csv` writes a study of that",
            Self::Fmu => "`metafmu new NAME --fmu FILE` writes a study of it, `metafmu validate FILE` checks it",
            Self::Onnx | Self::Arrays => "`metafmu import FILE --new interface.toml` begins to make an FMU of it",
            Self::Tensors => {
                "`metafmu export FILE` makes an FMU of a model file, `metafmu import FILE --interface interface.toml` of tensors"
            }
            Self::Torch => {
                "make an FMU of the module by metafmu.from_torch in Python, or export it to ONNX for `metafmu import`"
            }
            Self::Keras => {
                "make an FMU of it by metafmu.from_keras in Python, or export it to ONNX for `metafmu import`"
            }
            Self::Pickle => {
                "make an FMU of an estimator by metafmu.from_sklearn in Python, or export it to ONNX for `metafmu import`"
            }
            Self::Modelica | Self::Simulink => {
                "export it as an FMU in its tool; `metafmu new NAME --fmu FILE.fmu` writes a study of that"
            }
            Self::Notebook | Self::Python => "run it by Python; docs/python.md has the package `metafmu`",
            Self::System => "`metafmu swap FILE --component NAME --with SURROGATE.fmu` takes it",
            Self::Toml => {
                "`metafmu build STUDY.toml` takes a study, `metafmu new NAME --mechanism FILE.toml` a mechanism"
            }
        }
    }

    /// A message for one who expected something else.
    pub fn instead(self, expected: &str) -> String {
        format!("{}, expected {expected}; {}", self.what(), self.advice())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_known_by_the_end_of_its_name() {
        assert_eq!(of(Path::new("a/Runs.CSV")), Some(FileKind::Table));
        assert_eq!(of(Path::new("net.pt")), Some(FileKind::Torch));
        assert_eq!(of(Path::new("study")), None);
        let message = FileKind::Table.instead("a study in TOML");
        assert_eq!(message, "a table, expected a study in TOML; `metafmu new NAME --table FILE` writes a study of it");
    }
}
