"""Schedule of faults: the next fault, its duration, and whether another begins within it."""

from __future__ import annotations

import logging
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from edge.errors import UserError
from edge.lab.eval.soak.faults import Fault
from edge.lab.eval.soak.invariants import FaultWindow

if TYPE_CHECKING:
    from edge.lab.eval.soak.harness import SoakHarness
    from edge.lab.eval.soak.monitor import SoakMonitor

log = logging.getLogger("edge.lab.eval.soak")

SECOND = 0.2  # share of faults with another within them
_BEGINS = 0.5  # begin of the second, as a share of the first one's duration

Steps = Generator[None, None, str]
"""A generator of steps that returns the reason of a failure, or ""."""


class ScheduledFault(NamedTuple):
    """A fault and its duration."""

    fault: Fault
    lasts_s: float


def rounds(
    faults: Sequence[Fault], rng: np.random.Generator
) -> Iterator[tuple[ScheduledFault, ...]]:
    """Yield all faults in random order, again and again.

    Some have a second fault within them, which affects another part.
    """
    while True:
        for k in rng.permutation(len(faults)):
            first = faults[k]
            others = [fault for fault in faults if fault.part != first.part]
            second = others and rng.random() < SECOND
            chosen = (first, others[rng.integers(len(others))]) if second else (first,)
            yield tuple(
                ScheduledFault(fault, float(rng.uniform(*fault.lasts_s))) for fault in chosen
            )


def make(
    drawn: Sequence[ScheduledFault],
    harness: SoakHarness,
    monitor: SoakMonitor,
    rng: np.random.Generator,
) -> Steps:
    """Inject the first fault, and the rest within it, which ends before the first does.

    Returns:
        The conditions that the first fault did not show, or why it could not be injected; else "".
    """
    if not drawn:
        return ""
    (fault, lasts_s), *rest = drawn
    log.info("injecting fault %s for %.0f s: %s", fault.name, lasts_s, fault.what)
    monitor.mutes |= fault.mutes
    began_s = time.monotonic()
    window, unshown, ended = FaultWindow(began_s, began_s), list(fault.during), False
    try:
        with (
            closing(fault.make(harness, rng)) as injection,
            closing(make(rest, harness, monitor, rng)) as second,
        ):
            while not ended or time.monotonic() < began_s + lasts_s:
                next(injection)
                unshown = [hold for hold in unshown if hold(harness, monitor, window)]
                if not ended and time.monotonic() >= began_s + _BEGINS * lasts_s:
                    ended = next(second, second) is second
                yield
            return "; ".join(hold(harness, monitor, window) for hold in unshown)
    except UserError as error:
        return f"the fault could not be injected or ended: {error}"
