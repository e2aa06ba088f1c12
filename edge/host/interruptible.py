"""Work that cannot be interrupted, such as compiling, on threads that exit does not wait for."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import TypeVar
from weakref import WeakSet

from edge.errors import Stopped

log = logging.getLogger("edge")

_POLL_S = 0.05
_detached: WeakSet[threading.Thread] = WeakSet()

T = TypeVar("T")


def start_detached_thread(
    name: str, work: Callable[..., object], *args: object
) -> threading.Thread:
    """Start and return a thread that may still run when the process ends.

    The process must not wait for the thread, and must not shut the interpreter down while it runs:
    the libraries in the thread (onnxruntime, LLVM, Zenoh) would crash. So `edge.cli.main` ends with
    `os._exit`.
    """
    thread = threading.Thread(target=work, args=args, name=name, daemon=True)
    _detached.add(thread)
    thread.start()
    return thread


def any_detached_thread() -> bool:
    """Return True if a thread of `start_detached_thread` is running."""
    return any(thread.is_alive() for thread in tuple(_detached))


def raise_if_stopped(stop: threading.Event) -> None:
    """Raise Stopped if `stop` is set."""
    if stop.is_set():
        log.info("stopped during the start, before the service was ready")
        raise Stopped


def run_unless_stopped(work: Callable[[], T], stop: threading.Event) -> T:
    """Run `work` on a separate thread, and stop waiting for it when `stop` is set.

    Returns:
        The result of `work`. Its exceptions are raised here.

    Raises:
        Stopped: `stop` was set before the work was done.
    """
    raise_if_stopped(stop)
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    start_detached_thread("step", run)
    while not wait([outcome], _POLL_S).done:
        raise_if_stopped(stop)
    return outcome.result()
