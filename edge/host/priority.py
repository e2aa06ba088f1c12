"""The place of the loop, and of what runs beside it, among the threads of the machine."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

log = logging.getLogger("edge.host.priority")

BESIDE = 10
"""How nice a process is whose work can wait: beside one that is not, it gets a tenth of a core."""


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
    """Let this process, and the threads that it will start, get what others leave.

    Not for a thread of a process whose other threads must not wait: while it has the interpreter's
    lock and no core, they do.
    """
    with suppress(OSError):  # where it is that nice already, or nicer
        os.setpriority(os.PRIO_PROCESS, 0, BESIDE)
    # Linux may weigh sessions against each other, whatever their threads.
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(BESIDE), encoding="ascii")
