"""Work that cannot be told to stop, such as compiling: done on threads that nobody waits for."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar
from weakref import WeakSet

from edge.errors import Stopped

log = logging.getLogger("edge")

_LOOK_S = 0.05
_unjoined: WeakSet[threading.Thread] = WeakSet()

T = TypeVar("T")


def start_unjoined(name: str, work: Callable[..., object], *args: object) -> threading.Thread:
    """Start a thread that may outlast whoever started it.

    The process must neither wait for it nor let the interpreter go while it runs: the libraries at
    work in it (onnxruntime, LLVM, Zenoh) would not survive that. See `edge.cli.main`.
    """
    thread = threading.Thread(target=work, args=args, name=name, daemon=True)
    _unjoined.add(thread)
    thread.start()
    return thread


def any_unjoined() -> bool:
    """Whether such a thread runs."""
    return any(thread.is_alive() for thread in tuple(_unjoined))


def raise_if_stopped(stop: threading.Event) -> None:
    """Raises Stopped once `stop` is set."""
    if stop.is_set():
        log.info("stopped before it was ready")
        raise Stopped


def unless_stopped(work: Callable[[], T], stop: threading.Event) -> T:
    """Do a step on a thread of its own, and leave it to that once `stop` is set.

    Returns:
        What `work` returns; what it raises is raised here.

    Raises:
        Stopped: `stop` was set before the step was begun or done.
    """
    raise_if_stopped(stop)
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    start_unjoined("step", run)
    while not wait([outcome], _LOOK_S).done:
        raise_if_stopped(stop)
    return outcome.result()
