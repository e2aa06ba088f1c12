"""The command line that starts one of our modules in a separate process."""

from __future__ import annotations

import sys
from pathlib import Path

_ROOT = str(Path(__file__).parents[2])
# Like `python -m MODULE`, but without the working directory in `sys.path`: an `edge` or `numpy.py`
# there would be imported first (`python -P` needs Python 3.11). The folder of this package is added
# unless it is in `sys.path`. `gc.freeze` skips the slow garbage collection at exit.
_RUN = (
    "import atexit, gc, sys; root, module = sys.argv[1:3]; del sys.argv[1:3]; "
    "found = [p for p in sys.path if p]; "
    "sys.path[:] = found if root in found else [root, *found]; "
    "atexit.register(gc.freeze); "
    "import runpy; runpy.run_module(module, run_name='__main__', alter_sys=True)"
)


def python_module(name: str) -> tuple[str, ...]:
    """Return the command line that runs a module; append its arguments."""
    return sys.executable, "-c", _RUN, _ROOT, name
