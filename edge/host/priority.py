"""The place of the loop, and of what runs beside it, among the threads of the machine."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

log = logging.getLogger("edge.host.priority")

BESIDE = 10
"""How nice threads are whose work can wait: against one that is not, they get a tenth of a core."""

T = TypeVar("T")


@contextmanager
def real_time(priority: int) -> Iterator[bool]:
    """Run a block with a SCHED_FIFO priority, so that no detector's thread holds it up.

    Without it, a thread of the same rank that got the core first keeps it for some milliseconds,
    more than a whole tick's budget.

    Args:
        priority: 1 to 99; 0 leaves everything as it is.

    Yields:
        Whether it was given; where the right is missing, that is logged with what to do.
    """
    given = priority > 0 and _schedule(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority)
    try:
        yield given
    finally:
        if given:
            _schedule(os.SCHED_OTHER, 0)


def _schedule(policy: int, priority: int) -> bool:
    """Threads that a real-time thread starts go back to the ordinary ranks (RESET_ON_FORK)."""
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        log.warning(
            "loop.priority: %d not permitted (%s); run as root, grant CAP_SYS_NICE or set "
            "LimitRTPRIO, or set it to 0",
            priority,
            error.strerror,
        )
        return False
    return True


def give_way() -> None:
    """Let this thread, and those that it starts, get what the others leave."""
    with suppress(OSError):  # where it is that nice already, or nicer
        os.setpriority(os.PRIO_PROCESS, 0, BESIDE)


def give_way_as_process() -> None:
    """The same for a process that leads a session: Linux may weigh those against each other."""
    give_way()
    with suppress(OSError):  # a kernel that does not weigh them
        Path("/proc/self/autogroup").write_text(str(BESIDE), encoding="ascii")


def made_beside(make: Callable[[], T]) -> T:
    """What `make` returns, made on a thread that gives way: so do the threads that it leaves.

    Raises:
        whatever `make` raises.
    """
    outcome: Future[T] = Future()

    def run() -> None:
        give_way()
        try:
            outcome.set_result(make())
        except BaseException as error:
            outcome.set_exception(error)

    threading.Thread(target=run, name="making", daemon=True).start()
    return outcome.result()
