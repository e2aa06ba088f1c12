"""Scheduling priorities of the loop and of background processes."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

log = logging.getLogger("edge.host.priority")

BACKGROUND_NICE = 10
"""Nice value of background processes: about a tenth of a core next to a normal process."""


@contextmanager
def real_time(priority: int) -> Iterator[bool]:
    """Run a block with a SCHED_FIFO priority, so that threads of the detector do not delay it.

    Without it, another thread keeps a core for some milliseconds, more than the budget of a tick.

    Args:
        priority: 1 to 99; 0: no change.

    Yields:
        True if the priority was set. Without the permission, a warning is logged.
    """
    is_set = priority > 0 and _schedule(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, priority)
    try:
        yield is_set
    finally:
        if is_set:  # Linux lets only CAP_SYS_NICE clear the flag
            _schedule(os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)


def _schedule(policy: int, priority: int) -> bool:
    """Set the scheduler of this thread; log a warning and return False if not permitted."""
    try:
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except OSError as error:
        log.warning(
            "loop.priority: %d is not permitted (%s): run as root, grant CAP_SYS_NICE, set "
            "LimitRTPRIO in the systemd unit, or set loop.priority to 0",
            priority,
            error.strerror,
        )
        return False
    return True


def lower_priority() -> None:
    """Lower the priority of this process and of the threads that it will start.

    Do not use it in a process with urgent threads: they wait while a low-priority thread holds the
    interpreter's lock without getting a core.
    """
    with suppress(OSError):  # the nice value is already higher
        os.setpriority(os.PRIO_PROCESS, 0, BACKGROUND_NICE)
    # Linux may schedule by session (autogroup), regardless of the threads' nice values.
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(BACKGROUND_NICE), encoding="ascii")
