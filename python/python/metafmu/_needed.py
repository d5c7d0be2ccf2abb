"""Packages that only some functions need."""

import importlib


def needed(package, purpose):
    """The package. Raises :class:`ImportError` that says what needs it and how to install it."""
    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise ImportError(f"{purpose} needs {package}: pip install {package}") from None
