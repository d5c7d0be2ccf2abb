"""The command ``metafmu``; ``python -m metafmu`` is the same."""

import sys

from ._program import program


def main():
    """Does what the arguments say; the exit code is 0, 1 if problems were found, 2 for an error, 130 after Ctrl-C."""
    from . import _metafmu

    # worker processes run the same command
    sys.exit(_metafmu.command(["metafmu", *sys.argv[1:]], program()))


if __name__ == "__main__":
    main()
