"""How a module of ours is started in a process of its own."""

from __future__ import annotations

import sys
from pathlib import Path

_ROOT = str(Path(__file__).parents[2])
# As `python -m MODULE`, but that imports from the working directory before all else: an `edge` or
# a `numpy.py` that lies there would be run (`-P`, which forbids it, came with Python 3.11). Only
# where this package itself was found there, its folder is looked in. It ends as `edge.cli.main`
# does, without a last look for garbage.
_RUN = (
    "import atexit, gc, sys; root, module = sys.argv[1:3]; del sys.argv[1:3]; "
    "found = [p for p in sys.path if p]; "
    "sys.path[:] = found if root in found else [root, *found]; "
    "atexit.register(gc.freeze); "
    "import runpy; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def python_module(name: str) -> tuple[str, ...]:
    """The command line, to be followed by arguments, that runs a module as a program.

    Args:
        name: such as `edge.cli.main`; `exporters`, which lies beside `edge`, is found too.
    """
    return sys.executable, "-c", _RUN, _ROOT, name
