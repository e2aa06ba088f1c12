"""Waiting for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 240.0  # only a failing test waits this long


def eventually(what: Callable[[], T], otherwise: str | Callable[[], str] = "never happened") -> T:
    """The first truthy answer; fails when none comes in `PATIENCE_S`, with what `otherwise` says
    by then."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (answer := what()):
        if time.monotonic() >= deadline_s:
            raise AssertionError(otherwise() if callable(otherwise) else otherwise)
        time.sleep(0.005)
    return answer
