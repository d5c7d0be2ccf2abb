"""Studies, and the validation of FMUs."""

from __future__ import annotations

import html
import json
import os
from pathlib import Path

from . import _metafmu
from ._function import write
from ._program import program
from ._source import Source
from ._surrogate import Surrogate


class Study:
    """A study: sampling, training and export of a surrogate, of a function or class with the decorator :func:`metafmu.source`.

    >>> result = metafmu.Study(decay, sampling={"runs": 200}).build()
    >>> result = metafmu.Study.load("study.toml").build()       # of a file
    >>> result.metrics["outputs"], result.fmus
    >>> result.report                                           # shows itself in a notebook

    The source may be defined in a notebook, a script or another function. cloudpickle copies it with the variables that it uses, as they are
    now, to `NAME-source.pickle` in ``folder``, beside the study `NAME.toml`. Processes that sample it import its modules. Variables that
    cannot be copied, such as locks and sockets, are refused by name.

    ``name``: by default that of the function. ``structure``: "response", "discrete" or "dynamics". Other arguments are sections or keys of a
    study file: ``sampling={"runs": 200, "test_runs": 50}``, ``source={"time_limit": 10}``, ``parameters={"k": {"min": 1, "max": 2}}``,
    ``seed=2``. A key that is None is left out.

    Attributes: ``path``, ``name``.
    """

    def __init__(self, source: Source, /, *, name: str | None = None, folder: str | os.PathLike[str] = ".", structure: str | None = None, **sections):
        if not isinstance(source, Source):
            hint = ": metafmu.Study.load reads a file" if isinstance(source, (str, os.PathLike)) else ""
            raise TypeError(f"found {source!r}, expected a function or class with the decorator metafmu.source{hint}")
        self._open(write(source, name, Path(folder), structure, sections, program()))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Study:
        """Reads and checks a study.

        Raises :class:`metafmu.Error` with a line for every mistake: file, line, key, what was found and what was expected.
        """
        study = cls.__new__(cls)
        study._open(Path(path))
        return study

    def _open(self, path):
        self.path = path
        self.name, _ = _metafmu.study(path, None, program())

    def build(
        self, out: str | os.PathLike[str] | None = None, *, fmi: str | None = None, resume: bool = False, verbose: bool = True
    ) -> Result:
        """Samples, trains, evaluates, exports, validates and reports; returns a :class:`Result`.

        ``out``: folder of the results, by default ``out/NAME``. ``fmi``: ``"2"``, ``"3"`` or ``"both"``, by default that of the study.
        ``resume``: keep the finished stages of an interrupted build of the same study. ``verbose``: lines of progress on stderr. Ctrl-C
        ends the training and raises KeyboardInterrupt.

        Raises :class:`metafmu.Error` for mistakes in the study or its files, and if a stage fails. A surrogate that is rejected raises
        nothing: see `Result.accepted`.
        """
        out = None if out is None else Path(out)
        fmi = None if fmi is None else str(fmi)
        return Result(json.loads(_metafmu.build(self.path, out, fmi, bool(resume), program(), bool(verbose))))

    def __repr__(self):
        return f"Study({self.name!r}, {str(self.path)!r})"


class Result:
    """Results of a build, returned by :meth:`Study.build`.

    Attributes:

    - ``name``: name of the study
    - ``folder``: path of the folder with all files
    - ``metrics``: content of `metrics.json`, a dict: accuracy on the test runs for each output
    - ``accepted``, ``verdict``: True if the surrogate meets the limits of the study, and the reasons as text
    - ``fmus``: paths of the FMUs
    - ``problems``: problems that the validation found in the FMUs, an empty list if they are valid
    - ``report``: a :class:`Report`
    """

    def __init__(self, built):
        self._built = built
        self.name = built["name"]
        self.folder = Path(built["folder"])
        self.metrics = built["metrics"]
        self.accepted, self.verdict = built["accepted"], built["verdict"]
        self.fmus = [Path(fmu["fmu"]) for fmu in built["fmus"]]
        self.problems = [problem for fmu in built["fmus"] for problem in fmu["problems"]]
        self.report = Report(Path(built["report"]))

    @property
    def surrogate(self) -> Surrogate:
        """The :class:`Surrogate` that the FMUs contain, read from the folder."""
        return Surrogate.load(self._built["model"])

    def __repr__(self):
        return f"{self._built['table']}\n{self.verdict}".rstrip()


class Report(os.PathLike):
    """Page of HTML that compares a surrogate with its source. It is a path (``path``, `os.fspath`), and a notebook shows the page."""

    def __init__(self, path):
        self.path = path

    def __fspath__(self):
        return str(self.path)

    def __repr__(self):
        return f"Report({str(self.path)!r})"

    def _repr_html_(self):
        # its styles are its own
        page = html.escape(self.path.read_text(encoding="utf-8"), quote=True)
        return f'<iframe srcdoc="{page}" width="100%" height="600" style="border:0"></iframe>'


class Validation:
    """Problems found in an FMU, returned by :func:`metafmu.validate`. An instance is true if the FMU was run and has none.

    - ``problems``: a list of dicts with ``area``, ``line`` and ``message``
    - ``not_checked``: list of features that were not checked, with the reasons
    - ``was_run``: ``False`` if the FMU could not be run by all of its interfaces, for instance on this platform
    """

    def __init__(self, found):
        self.problems = found["problems"]
        self.not_checked = found["not_checked"]
        self.was_run = found["was_run"]
        self._text = found["text"]

    def __bool__(self):
        return self.was_run and not self.problems

    def __repr__(self):
        return self._text.rstrip()


def validate(fmu: str | os.PathLike[str], time_limit: float = 60.0) -> Validation:
    """Checks any FMU of FMI 2.0 or 3.0: archive, description, and, if it has a binary for this machine, simulations in a separate process.

    ``time_limit``: seconds for each of the checks that run the FMU. Problems of the FMU are in the result;
    :class:`metafmu.Error` is raised if the file cannot be read.

    >>> bool(metafmu.validate("model.fmu"))
    True
    """
    return Validation(json.loads(_metafmu.validate(Path(fmu), float(time_limit), program())))
