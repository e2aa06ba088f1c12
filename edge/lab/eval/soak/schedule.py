"""Schedule of `edge soak`: draws the next fault and its duration, and injects it."""

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

_SECOND_SHARE = 0.2  # share of faults with another within them
_SECOND_BEGINS = 0.5  # time at which the second begins, as a share of the first one's duration

Steps = Generator[None, None, str]
"""A generator that is resumed once per loop. It returns the reason of a failure, or ""."""


class ScheduledFault(NamedTuple):
    """A fault and its duration."""

    fault: Fault
    lasts_s: float


def draw_faults(
    faults: Sequence[Fault], rng: np.random.Generator
) -> Iterator[tuple[ScheduledFault, ...]]:
    """Yield all faults in random order, again and again, without end.

    Each item is one fault, or a fault and a second one within it, which affects another part.
    """
    while True:
        for k in rng.permutation(len(faults)):
            first = faults[k]
            others = [fault for fault in faults if fault.part != first.part]
            second = others and rng.random() < _SECOND_SHARE
            chosen = (first, others[rng.integers(len(others))]) if second else (first,)
            yield tuple(
                ScheduledFault(fault, float(rng.uniform(*fault.lasts_s))) for fault in chosen
            )


def inject(
    drawn: Sequence[ScheduledFault],
    harness: SoakHarness,
    monitor: SoakMonitor,
    rng: np.random.Generator,
) -> Steps:
    """Inject the first fault, and the rest within it, which ends before the first does.

    Returns:
        The conditions of `Fault.during` that never held, or why the fault could not be injected;
        else "".
    """
    if not drawn:  # no fault within the last one
        return ""
    (fault, lasts_s), *rest = drawn
    log.info("injecting fault %s for %.0f s: %s", fault.name, lasts_s, fault.what)
    monitor.bus_is_muted |= fault.mutes_bus
    began_s = time.monotonic()
    window = FaultWindow(began_s, began_s)
    missing = list(fault.during)  # conditions that have not held yet
    rest_ended = False  # the faults within this one
    try:
        with (
            closing(fault.inject(harness, rng)) as injection,
            closing(inject(rest, harness, monitor, rng)) as second,
        ):
            while not rest_ended or time.monotonic() < began_s + lasts_s:
                next(injection)
                missing = [check for check in missing if check(harness, monitor, window)]
                if not rest_ended and time.monotonic() >= began_s + _SECOND_BEGINS * lasts_s:
                    # The generator itself is the default: it comes once the generator has ended.
                    rest_ended = next(second, second) is second
                yield
            return "; ".join(check(harness, monitor, window) for check in missing)
    except UserError as error:
        return f"the fault could not be injected or ended: {error}"
