"""Waiting for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 240.0  # only a failing test waits this long


def eventually(what: Callable[[], T], otherwise: str = "it did not happen") -> T:
    """The first truthy answer; fails when none comes in `PATIENCE_S`."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not (answer := what()):
        assert time.monotonic() < deadline_s, otherwise
        time.sleep(0.005)
    return answer
