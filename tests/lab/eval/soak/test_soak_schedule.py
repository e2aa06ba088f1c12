"""The order of faults, and one within another."""

from __future__ import annotations

from itertools import islice
from types import SimpleNamespace

import numpy as np
import pytest

from edge.errors import UserError
from edge.lab.eval.soak.faults import FAULTS, Fault
from edge.lab.eval.soak.schedule import ScheduledFault, draw_faults, inject


def drawn(seed: int, n: int) -> list[tuple[ScheduledFault, ...]]:
    return list(islice(draw_faults(FAULTS, np.random.default_rng(seed)), n))


def test_every_round_has_all_faults_and_each_seed_another_order():
    n = len(FAULTS)
    first = [drawn[0].fault.name for drawn in drawn(1, 2 * n)]
    assert sorted(first[:n]) == sorted(first[n:]) == sorted(fault.name for fault in FAULTS)
    assert first[:n] != first[n:]
    assert drawn(1, n) == drawn(1, n) != drawn(2, n)


def run(faults: list[Fault]) -> tuple[list[str], str]:
    """Run the fault injectors; return their messages and results."""
    watch = SimpleNamespace(bus_is_muted=False)
    steps = inject([ScheduledFault(fault, 0.0) for fault in faults], None, watch, None)
    while True:
        try:
            next(steps)
        except StopIteration as end:
            assert watch.bus_is_muted == any(fault.mutes_bus for fault in faults)
            return SAID[:], end.value


SAID: list[str] = []


def fault(name: str, error: str = "", **more) -> Fault:
    def made(stage, rng):
        SAID.append(f"{name} begins")
        try:
            yield
            if error:
                raise UserError(error)
            while True:
                yield
        finally:
            SAID.append(f"{name} ends")

    return Fault(name, name, name, made, **more)


@pytest.fixture(autouse=True)
def clear_said():
    SAID.clear()


def test_hidden_or_failed_faults_are_reported():
    hidden = fault("a", during=(lambda stage, watch, when: "nothing shows",))
    assert run([hidden])[1] == "nothing shows"
    SAID.clear()
    said, why = run([fault("a", lasts_s=(9, 9)), fault("b", "no process")])
    assert said == ["a begins", "b begins", "b ends", "a ends"]
    assert why == ""
    assert run([fault("c", "no process"), fault("d")])[1].endswith("or ended: no process")
    assert SAID[-2:] == ["c ends", "d ends"]
