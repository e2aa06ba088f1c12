"""One model alone in a process: `python -m MODULE JOB OUT`, both pickled.

Whatever it costs there, in time or memory, is this model's doing; if it crashes, nothing else does.
"""

from __future__ import annotations

import pickle
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge.errors import UserError
from edge.host.children import python_module
from edge.host.private_folder import private_folder
from edge.logs import setup
from edge.text import one_line


def main(argv: list[str], measure: Callable[[Any], Any]) -> int:
    """The process: do what the job says; 0, or 1 with one line on stdout.

    Args:
        measure: job → what was measured.
    """
    setup("error")
    job, out = map(Path, argv)
    try:
        out.write_bytes(pickle.dumps(measure(pickle.loads(job.read_bytes()))))
    except UserError as error:
        print(one_line(error, 1000))
        return 1
    except Exception as error:  # of the runtime: one row of the table
        print(one_line(f"{type(error).__name__}: {error}"))
        return 1
    return 0


def run_alone(module: str, job: object, limit_s: float, key: str = "") -> Any:
    """Have a process measure; what it measured, or in one line (str) why nothing was.

    Args:
        module: whose program is `main`.
        limit_s: a process that takes longer is ended.
        key: of the configuration that the limit comes from.
    """
    with private_folder("edge-bench-") as folder:
        asked, out = folder / "job", folder / "out"
        asked.write_bytes(pickle.dumps(job))
        try:
            done = subprocess.run(
                [*python_module(module), str(asked), str(out)], stdout=subprocess.PIPE, text=True,
                errors="replace", check=False, timeout=limit_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"failed: not done after {limit_s:g} s" + (f" ({key})" if key else "")
        if done.returncode:
            return f"failed: {_reason(done)}"
        return pickle.loads(out.read_bytes())


def _reason(done: subprocess.CompletedProcess[str]) -> str:
    """Why a process ended: its signal, or its last line on stdout."""
    if done.returncode < 0:
        return f"its process was ended by signal {-done.returncode}"
    lines = done.stdout.split("\n")
    return next(filter(str.strip, reversed(lines)), f"exit code {done.returncode}")
