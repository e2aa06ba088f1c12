"""Findings of `edge doctor`, which its checks yield."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from edge.config import Config

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Attributes:
        level: `ok`, `warn` or `fail`.
        todo: what to do; "" if nothing.
    """

    level: Level
    what: str
    todo: str = ""


Check = Callable[[Config], Iterator[Finding]]


def ok(what: str) -> Finding:
    """Return the finding that something is as it should be."""
    return Finding("ok", what)


def warn(what: str, todo: str) -> Finding:
    """Return the finding of a problem with which the configuration can run."""
    return Finding("warn", what, todo)


def ok_or_warn(is_ok: bool, what: str, todo: str) -> Finding:
    """Return `ok` with the measurement, or a warning with what to do."""
    return ok(what) if is_ok else warn(what, todo)


def fail(what: str, todo: str) -> Finding:
    """Return the finding of a problem with which the configuration cannot run."""
    return Finding("fail", what, todo)


def finding_of(error: Exception, level: Level = "fail", todo: str = "") -> Finding:
    """Return the finding of an error whose message is `problem; what to do`."""
    what, _, said = str(error).partition("; ")
    return Finding(level, what, said or todo)
