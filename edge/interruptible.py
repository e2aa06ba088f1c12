"""Long steps of the start that know no way of being told to stop, such as compiling."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar

from edge.errors import Stopped

ABANDONED = "abandoned when stopped"
"""The name of threads that do such a step. The process must not wait for one, nor let the
interpreter go while it runs: see `edge.cli`."""

log = logging.getLogger("edge")

_LOOK_S = 0.05

T = TypeVar("T")


def go_on(stop: threading.Event) -> None:
    """Raises Stopped once `stop` is set."""
    if stop.is_set():
        log.info("stopped before it was ready")
        raise Stopped


def unless_stopped(work: Callable[[], T], stop: threading.Event) -> T:
    """Do a step on a thread of its own, and leave it to that once `stop` is set.

    Returns:
        What `work` returns; what it raises is raised here.

    Raises:
        Stopped: `stop` was set before it was done.
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    threading.Thread(target=run, name=ABANDONED, daemon=True).start()
    while not wait([outcome], _LOOK_S).done:
        go_on(stop)
    return outcome.result()
