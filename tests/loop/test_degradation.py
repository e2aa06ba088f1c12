"""Degradation levels: no hasty step, no oscillation, and a return to full work."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.loop import degradation
from edge.loop.degradation import MOST_DOUBLINGS, UNLIKELY_DOUBLINGS, DegradationLevels, LoadSample

S = 1_000_000_000
BUDGET_MS = 33.0


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(degradation, "DWELL_S", 10.0)


class Plant:
    """Computer model: detect takes the cost of the level times the load; steps are immediate."""

    def __init__(self, costs_ms=(20.0, 10.0, 5.0)) -> None:
        self.levels, self.costs_ms = DegradationLevels(len(costs_ms) - 1, BUDGET_MS), costs_ms
        self.now_s, self.moves = 0, []

    @property
    def level(self) -> int:
        return self.levels.level

    def run(self, seconds: int, load: float = 1.0, **second) -> Plant:
        for _ in range(seconds):
            self.now_s += 1
            sample = LoadSample(self.costs_ms[self.level] * load, **second)
            if (move := self.levels.update(sample, self.now_s * S)) is not None:
                self.levels.arrived(move.level, self.now_s * S)
                self.moves.append((self.now_s, move.level, move.why))
        return self


def test_seconds_of_overload_step_down_with_the_reason():
    ((at_s, level, why),) = Plant().run(4, load=2.0).moves
    assert (at_s, level) == (4, 1)
    budget = "perception.swap.budget_ms (33)"
    assert why == f"detect takes 40 ms (median), above {budget}, for over 3 s"


def test_a_detector_without_samples_gives_no_headroom():
    levels = DegradationLevels(2, BUDGET_MS)
    levels.arrived(1, 0)
    assert all(levels.update(LoadSample(None), s * S) is None for s in range(1, 1000))


def test_a_board_that_is_not_cool_has_no_room():
    plant = Plant().run(4, distress="hot").run(1000, has_headroom=False)
    assert plant.level == 1
    assert plant.run(62).level == 0


def test_useless_steps_up_become_rarer():
    """A board that is cool once something is given up, and hot once it is taken back."""
    plant = Plant(costs_ms=(10.0, 10.0))
    while plant.now_s < 20_000:
        plant.run(1, distress="" if plant.level else "hot")
    ups = [at for at, level, _ in plant.moves if level == 0]
    gaps = [b - a for a, b in pairwise(ups)]
    assert len(gaps) > MOST_DOUBLINGS
    assert all(b >= 1.8 * a for a, b in pairwise(gaps[:MOST_DOUBLINGS]))


def test_a_refused_step_is_retried_later():
    levels, asked = DegradationLevels(2, BUDGET_MS), []
    for s in range(1, 100):
        if levels.update(LoadSample(50.0), s * S) is not None:
            asked.append(s)
            levels.change_failed(s * S)
    assert asked[:3] == [4, 14, 24]
    assert levels.level == 0


loads = st.lists(
    st.tuples(st.integers(1, 90), st.floats(0.05, 6.0), st.booleans(), st.booleans()), max_size=40
)


@given(loads)
def test_steps_keep_the_dwell_and_move_one_level(phases):
    plant = Plant()
    for seconds, load, hot, cool in phases:
        plant.run(seconds, load, distress="hot" if hot else "", has_headroom=cool)
    assert all(b - a >= 10 for (a, *_), (b, *_) in pairwise(plant.moves))
    levels = [0, *(level for _, level, _ in plant.moves)]
    assert all(abs(b - a) == 1 for a, b in pairwise(levels))
    assert set(levels) <= {0, 1, 2}


@given(loads, st.floats(0.05, 1.0))
def test_all_levels_are_restored_once_there_is_headroom(phases, load):
    plant = Plant()
    for seconds, heavy, hot, cool in phases:
        plant.run(seconds, heavy, distress="hot" if hot else "", has_headroom=cool)
    assert plant.run(2 * 3 * (60 << MOST_DOUBLINGS), load).level == 0


@given(st.floats(0.05, 6.0), st.tuples(*[st.floats(0.1, 1.0)] * 2), st.floats(5.0, 60.0))
def test_a_constant_load_steps_down_and_hardly_ever_up(load, shares, cost_ms):
    """The gain of a level is known after a try; tries come at 16 times `LOW_S` or later."""
    costs_ms = (cost_ms, cost_ms * shares[0], cost_ms * shares[0] * shares[1])
    plant = Plant(costs_ms).run(60 << UNLIKELY_DOUBLINGS, load)
    assert [level for _, level, _ in plant.moves] == list(range(1, len(plant.moves) + 1))
