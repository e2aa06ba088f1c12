"""Sandbox for a Python script that a language model wrote (OpenNav III-A3).

The script cannot reach anything of the host. `edge.tasks.write` runs each answer of a model.

The interpreter `pydantic-monty` has no files, processes or sockets. It runs in its own process,
which ends with the script. A script can only call the functions that it is given.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from importlib import metadata
from typing import Any

from edge.errors import UnavailableError
from edge.tasks.functions import CallError, ScriptFunctions, signature
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line, printable_lines

log = logging.getLogger(__name__)

MOST_ERROR_CHARS = 300
_PRINTED_BYTES = 1 << 18  # a script that prints more is stopped
_GRACE_S = 5.0  # the process of a script that ignores its limits is ended after this time
_EPOCH = datetime(2000, 1, 1)


@dataclass(frozen=True, slots=True)
class ScriptResult:
    """Result of a script; the trajectory it gave is in `ScriptFunctions.trajectory`.

    Attributes:
        printed: output without control characters, cut to the limit.
        error: one line; "" if the script ran to its end.
    """

    printed: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True)
class ScriptLimits:
    """Limits of a model's script.

    Attributes:
        time_s: computing time. After twice this time on the clock, each call raises TimeoutError.
        max_memory_mb: memory of the interpreter.
        max_recursion: depth of nested calls.
        max_calls: calls of functions, and look-ups of their names.
        max_chars: length of the script.
        max_printed_chars: length of the output that goes back to the model.
    """

    time_s: float = 2.0
    max_memory_mb: float = 64.0
    max_recursion: int = 200
    max_calls: int = 200
    max_chars: int = 20_000
    max_printed_chars: int = 4_000


def run_script(code: str, functions: ScriptFunctions, limits: ScriptLimits) -> ScriptResult:
    """Run a script. It ends within its limits, and its errors become a result.

    The clock stands still, sleeping takes no time, and random numbers are the same each time, so a
    script does the same on every machine. `functions` keeps a trajectory that was handed over, even
    if the script failed later.

    Raises:
        UnavailableError: the interpreter is not installed, or does not start.
    """
    if len(code) > limits.max_chars:
        return ScriptResult(
            error=f"the script has {len(code)} characters, at most {limits.max_chars}"
        )
    begin_s, detected_s = 0.0, functions.detecting_s

    def begin() -> None:
        nonlocal begin_s
        begin_s = time.monotonic()

    def is_late() -> bool:
        """Return True if the time has passed; detections on demand do not count."""
        spent_s = time.monotonic() - begin_s - (functions.detecting_s - detected_s)
        return spent_s > 2.0 * limits.time_s

    callables = {name: _guarded(name, f, is_late) for name, f in functions.table().items()}
    return _run_sandboxed(code, callables, limits, begin)


def version() -> str:
    """Run an empty script as a test, and return the interpreter's version.

    Raises:
        UnavailableError: the interpreter is not installed, or does not run.
    """
    if error := _run_sandboxed("pass", {}, ScriptLimits(), lambda: None).error:
        raise UnavailableError(
            f"pydantic-monty does not run here: {error}; choose tasks.planner.kind: rules"
        )
    return metadata.version("pydantic-monty")


def _run_sandboxed(
    code: str,
    callables: dict[str, Callable[..., Any]],
    limits: ScriptLimits,
    begin: Callable[[], None],
) -> ScriptResult:
    """Run a script that may call `callables` by their names; see `run_script`.

    `begin` is called once the interpreter runs: its start is not the script's time.
    """
    monty = _interpreter()
    printed = monty.CollectString(max_bytes=_PRINTED_BYTES)
    bounds = {
        "max_feed_duration_secs": limits.time_s,
        "max_memory": int(limits.max_memory_mb * 2**20),
        "max_recursion_depth": limits.max_recursion,
        "max_suspensions": limits.max_calls,
    }
    policy = {
        "datetime": _EPOCH, "timezone": "utc", "sleep": "zero", "random_start": {"seed": 0},
    }  # fmt: skip
    try:
        with (
            monty.Monty(max_processes=1, request_timeout=limits.time_s + _GRACE_S) as pool,
            pool.checkout(script_name="script.py", limits=bounds, os_policy=policy) as session,
        ):
            begin()
            session.feed_run(code, print_callback=printed, external_lookup=callables)
            error = ""
    except monty.MontyError as raised:
        error = _error_line(raised)
    except (OSError, RuntimeError) as raised:
        why = one_line(raised, MOST_ERROR_CHARS)
        raise UnavailableError(
            f"pydantic-monty does not run here: {why}; choose tasks.planner.kind: rules"
        ) from None
    text = printable_lines(printed.output[: limits.max_printed_chars])
    return ScriptResult(text, error)


def _guarded(
    name: str, function: Callable[..., Any], is_late: Callable[[], bool]
) -> Callable[..., Any]:
    """Wrap a function for scripts: check its arguments and the deadline, and hide its traceback."""
    parameters = signature(function)

    def call(*args: Any, **kwargs: Any) -> Any:
        if is_late():
            raise TimeoutError(f"{name}: the time limit of the script has passed")
        try:
            bound = parameters.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{name}: {error}; call it as {name}{parameters}") from None
        try:
            return function(*bound.args, **bound.kwargs)
        except TrajectoryError as error:
            raise CallError(str(error)) from None
        except Exception:
            log.exception(
                "tasks: the function %s failed; please report it with this traceback", name
            )
            raise RuntimeError(f"{name}: internal error; do not call this function again") from None

    return call


def _error_line(raised: Any) -> str:
    frames = raised.traceback() if hasattr(raised, "traceback") else []
    where = f"line {frames[-1].line}: " if frames else ""
    return one_line(f"{where}{raised}", MOST_ERROR_CHARS)


def _interpreter() -> Any:
    try:
        import pydantic_monty
    except ImportError:
        raise UnavailableError(
            "pydantic-monty is not installed; pip install 'edge-vln[tasks]', or choose "
            "tasks.planner.kind: rules"
        ) from None
    return pydantic_monty
