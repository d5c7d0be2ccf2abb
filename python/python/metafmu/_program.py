"""Location of the command ``metafmu``: FMUs and baselines run in separate processes of it, so that a crash ends only those."""

import os
import sys


def program():
    """The path of the installed command.

    Raises FileNotFoundError if there is none.
    """
    name = "metafmu.exe" if os.name == "nt" else "metafmu"
    # this process may be the command
    own = os.path.abspath(sys.argv[0]) if sys.argv and sys.argv[0] else ""
    if os.path.basename(own) == name and os.path.isfile(own):
        return own
    if os.path.basename(own) + ".exe" == name and os.path.isfile(own + ".exe"):
        return own + ".exe"
    import importlib.metadata

    try:
        files = importlib.metadata.files("metafmu") or []
    except importlib.metadata.PackageNotFoundError:
        files = []
    for file in files:
        if file.name == name and (found := file.locate()).is_file():
            return os.path.abspath(found)
    beside = os.path.join(os.path.dirname(sys.executable), name)
    if os.path.isfile(beside):
        return beside
    import shutil

    if found := shutil.which("metafmu"):
        return os.path.abspath(found)
    raise FileNotFoundError("the command `metafmu`, which runs FMUs in separate processes, is not installed beside this package")
