"""Waiting for another thread; for a process see `live_patience`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 60.0  # only a failing test waits this long


def eventually(
    what: Callable[[], T],
    otherwise: str | Callable[[], str] = "never happened",
    patience_s: float = PATIENCE_S,
) -> T:
    """Return the first truthy answer; fail if none comes in time."""
    deadline_s = time.monotonic() + patience_s
    while not (answer := what()):
        if time.monotonic() >= deadline_s:
            raise AssertionError(otherwise() if callable(otherwise) else otherwise)
        time.sleep(0.005)
    return answer
