"""metafmu: a trained model, or a multibody model, as a small FMU that runs anywhere.

>>> import metafmu
>>> surrogate = metafmu.from_sklearn(pipeline, data=X)         # or from_torch, from_keras, from_jax, from_onnx
>>> surrogate.export("model.fmu", fmi="both")                  # doctest: +SKIP

Modules are imported on first use: neither the frameworks nor, for the command, numpy.
"""

from typing import TYPE_CHECKING

from ._metafmu import Error, __version__

if TYPE_CHECKING:
    from ._graph import Graph
    from ._jax import from_jax
    from ._keras import from_keras
    from ._mujoco import mujoco
    from ._onnx import from_onnx
    from ._regressor import AccuracyWarning, Regressor, fit
    from ._sklearn import from_sklearn
    from ._source import source
    from ._study import Study, Validation, validate
    from ._surrogate import Surrogate
    from ._torch import from_torch

_PLACES = {
    "AccuracyWarning": "_regressor",
    "Graph": "_graph",
    "Regressor": "_regressor",
    "Study": "_study",
    "Surrogate": "_surrogate",
    "Validation": "_study",
    "fit": "_regressor",
    "from_jax": "_jax",
    "from_keras": "_keras",
    "from_onnx": "_onnx",
    "from_sklearn": "_sklearn",
    "from_torch": "_torch",
    "mujoco": "_mujoco",
    "source": "_source",
    "validate": "_study",
}

__all__ = ["Error", "__version__", *_PLACES]


def __getattr__(name):
    if name not in _PLACES:
        raise AttributeError(f"module `metafmu` has no attribute `{name}`")
    import importlib

    value = getattr(importlib.import_module(f".{_PLACES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted(__all__)
