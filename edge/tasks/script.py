"""A model's Python, run where nothing of the host can be reached (OpenNav III-A3).

The interpreter, `pydantic-monty`, knows neither files, processes nor sockets, and runs in a process
of its own that ends with the script. What it can call are the functions it is given.
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
from edge.tasks.functions import CallError, Functions, signature
from edge.tasks.trajectory import TrajectoryError
from edge.text import one_line, printable_lines

log = logging.getLogger(__name__)

MOST_ERROR_CHARS = 300
_PRINTED_BYTES = 1 << 18  # more than that ends the script
_GRACE_S = 5.0  # after which a script that ignores its limits ends with its process
_EPOCH = datetime(2000, 1, 1)


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a script; the trajectory it gave is in `Functions.given`.

    Attributes:
        printed: without control characters, cut to the limit.
        error: one line; "" when it ran to its end.
    """

    printed: str = ""
    error: str = ""


@dataclass(frozen=True, slots=True)
class ScriptLimits:
    """Limits of a model's script.

    Attributes:
        time_s: of computing; after twice that no call of it is answered.
        max_calls: calls of the functions, and each name that is looked up for one.
        max_printed_chars: how much of what it prints goes back to the model.
    """

    time_s: float = 2.0
    max_memory_mb: float = 64.0
    max_recursion: int = 200
    max_calls: int = 200
    max_chars: int = 20_000
    max_printed_chars: int = 4_000


def run(code: str, functions: Functions, limits: ScriptLimits) -> Outcome:
    """Run a script; whatever it does, this returns.

    Time stands still, sleeping takes none, and chance is the same each time, so a script does the
    same on every machine. `functions` holds what it handed over, even where it failed later.

    Raises:
        UnavailableError: the interpreter is not installed, or does not start.
    """
    if len(code) > limits.max_chars:
        return Outcome(error=f"the script has {len(code)} characters, at most {limits.max_chars}")
    deadline_s = time.monotonic() + 2.0 * limits.time_s
    called = {name: _guarded(name, f, deadline_s) for name, f in functions.table().items()}
    return _fed(code, called, limits)


def version() -> str:
    """The interpreter's, once it has run a script on this computer.

    Raises:
        UnavailableError: as `run`.
    """
    if error := _fed("pass", {}, ScriptLimits()).error:
        raise UnavailableError(
            f"pydantic-monty does not run here: {error}; choose tasks.planner.kind: rules"
        )
    return metadata.version("pydantic-monty")


def _fed(code: str, called: dict[str, Callable[..., Any]], limits: ScriptLimits) -> Outcome:
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
            session.feed_run(code, print_callback=printed, external_lookup=called)
            error = ""
    except monty.MontyError as raised:
        error = _told(raised)
    except (OSError, RuntimeError) as raised:
        why = one_line(raised, MOST_ERROR_CHARS)
        raise UnavailableError(
            f"pydantic-monty does not run here: {why}; choose tasks.planner.kind: rules"
        ) from None
    text = printable_lines(printed.output[: limits.max_printed_chars])
    return Outcome(text, error)


def _guarded(name: str, function: Callable[..., Any], deadline_s: float) -> Callable[..., Any]:
    """The function as a script calls it: in time, with arguments that it has."""
    parameters = signature(function)

    def call(*args: Any, **kwargs: Any) -> Any:
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"{name}: the script's time is over")
        try:
            bound = parameters.bind(*args, **kwargs)
        except TypeError as error:
            raise TypeError(f"{name}: {error}; it is {name}{parameters}") from None
        try:
            return function(*bound.args, **bound.kwargs)
        except TrajectoryError as error:
            raise CallError(str(error)) from None
        except Exception:
            log.exception("tasks: %s failed", name)
            raise RuntimeError(f"{name} failed; do without it") from None

    return call


def _told(raised: Any) -> str:
    """One line: the error, and the line of the script where it was."""
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
