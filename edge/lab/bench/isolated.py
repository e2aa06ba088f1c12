"""Runner of one measurement in its own process: `python -m MODULE JOB OUT`.

JOB and OUT are files with the pickled job and result. The measured time and memory belong to one
model only, and a crash ends only this process.
"""

from __future__ import annotations

import pickle
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from edge.errors import UserError
from edge.host.children import python_module
from edge.logs import setup
from edge.text import one_line


def main(argv: list[str], measure: Callable[[Any], Any]) -> int:
    """Run in the child process: measure one job and write the result.

    The arguments are the paths of the job file and of the result file, both pickles.

    Returns:
        The exit status: 0, or 1 with one line on stdout that says why.
    """
    setup("error")
    job, out = map(Path, argv)
    try:
        out.write_bytes(pickle.dumps(measure(pickle.loads(job.read_bytes()))))
    except UserError as error:
        print(one_line(error, 1000))
        return 1
    except Exception as error:  # a runtime error fails one row of the table, not the benchmark
        print(one_line(f"{type(error).__name__}: {error}"))
        return 1
    return 0


def run_isolated(module: str, job: object, limit_s: float, origin: str = "") -> Any:
    """Run a measurement in its own process, for at most `limit_s`.

    The module must call `main`; the job is the argument of its `measure`, and must be picklable. An
    error message names the limit's `origin`.

    Returns:
        The result, or one line of text (str) that says why there is none.
    """
    with tempfile.TemporaryDirectory(prefix="edge-bench-", ignore_cleanup_errors=True) as folder:
        job_file, out = Path(folder, "job"), Path(folder, "out")
        job_file.write_bytes(pickle.dumps(job))
        try:
            done = subprocess.run(
                [*python_module(module), str(job_file), str(out)], stdout=subprocess.PIPE,
                text=True, errors="replace", check=False, timeout=limit_s,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return f"failed: not done after {limit_s:g} s" + (f" ({origin})" if origin else "")
        if done.returncode:
            return f"failed: {_reason(done)}"
        return pickle.loads(out.read_bytes())


def _reason(done: subprocess.CompletedProcess[str]) -> str:
    """Return why a process failed: its signal, its last line on stdout, or its exit code."""
    if done.returncode < 0:
        return f"its process was ended by signal {-done.returncode}"
    lines = done.stdout.split("\n")
    return next(filter(str.strip, reversed(lines)), f"exit code {done.returncode}")
