"""Which goals are left alone, on a map that the test makes up."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from simulated import simulated

from edge.geometry import SE2
from edge.loop.candidates import CandidatePool
from edge.loop.pursuit import Pursuit
from edge.mapping.results import Frontiers
from edge.perception.instances import InstanceTracker
from edge.policies import make_policy

S = 1_000_000_000
HERE = SE2(0.0, 0.0, 0.0)


class Case:
    """A pursuit on a map that is free all over, with nothing that was seen badly."""

    def __init__(self) -> None:
        config = simulated({})
        policy = make_policy(config.policy)
        self.pool = CandidatePool(8, config.policy.r_assoc_m)
        self.events: list[str] = []
        tracker = InstanceTracker(config.perception)
        self.pursuit = Pursuit(
            config,
            policy,
            self.pool,
            tracker,
            tell=lambda goal: None,
            held_up=lambda place, now_ns: None,
            event=lambda text, now_ns: None,
        )
        coverage = SimpleNamespace(view=None, start_over=lambda: None, search=lambda reach: True)
        reach = SimpleNamespace(nearest=lambda x, y, within_m: (x, y, 1.0), generation=7)
        self.grid = SimpleNamespace(
            coverage=coverage,
            reach=reach,
            state_at=lambda x, y: 0,
            bumps=SimpleNamespace(open_all=lambda: False),
        )
        self.mission = SimpleNamespace(forbidden=())
        self.now_ns = S
        self.pursuit.set_out("chair")

    def tick(self, *frontiers: tuple[float, float], after_s: float = 0.1):
        """One tick with frontiers at these places."""
        self.now_ns += int(after_s * S)
        xy = np.array(frontiers, np.float32).reshape(-1, 2)
        counts = np.ones(len(xy), np.int32)
        self.pool.update(Frontiers(len(xy), xy, counts, counts), [], self.now_ns, self.now_ns)
        goal = self.pursuit.choose(self.grid, {}, HERE, self.now_ns, "chair", 0)
        self.pursuit.give(goal, self.mission, HERE, self.now_ns)
        return goal

    def turn_round(self) -> None:
        """Look around until nothing is left."""
        for _ in range(3):
            assert self.tick() is None
            assert self.tick(after_s=1.1).kind == "look"
            self.pursuit._selector.looked(self.now_ns)
            self.pursuit.drop()
        assert self.tick(after_s=1.1) is None


def test_with_nothing_to_go_to_nor_to_see_it_is_exhausted():
    case = Case()
    assert not case.pursuit.exhausted
    case.turn_round()
    assert not case.pursuit.exhausted
    case.tick()
    assert case.pursuit.exhausted
    assert case.pursuit.views == 0
    case.pursuit.set_out("sofa")
    assert not case.pursuit.exhausted


@pytest.mark.parametrize("reach_s", [0.2, 5.0], ids=["small map", "large map"])
def test_what_was_opened_is_tried_until_the_reach_field_leads_there_and_a_frontier_lasts(reach_s):
    case = Case()
    case.grid.bumps.open_all = lambda: True
    case.turn_round()
    opened_ns = case.now_ns
    while case.now_ns < opened_ns + max(reach_s, 2.5) * S:
        case.grid.reach.generation = 7 + int((case.now_ns - opened_ns) / (0.6 * reach_s * S))
        assert case.tick() is None
        assert not case.pursuit.exhausted
    case.grid.reach.generation = 9
    case.tick(after_s=0.5)
    assert case.pursuit.exhausted


@pytest.mark.parametrize(("explored", "chances"), [(False, 4), (True, 1)])
def test_a_frontier_that_vanishes_time_and_again_is_left_alone(explored, chances):
    """Four times while exploring, once where all was explored: it shows from afar alone."""
    case = Case()
    if explored:
        case.turn_round()
    for _ in range(chances):
        case.tick((3.0, 0.0))
        goal = case.tick((3.0, 0.0), after_s=2.5)
        assert (goal.kind, goal.candidate_xy_m) == ("frontier", (3.0, 0.0))
        assert case.tick() is None
    case.tick((3.0, 0.0))
    goal = case.tick((3.0, 0.0), after_s=2.5)
    assert goal is None or goal.kind == "look"
    case.tick((3.0, 0.0), (-3.0, 0.0))
    goal = case.tick((3.0, 0.0), (-3.0, 0.0), after_s=2.5)
    assert goal.candidate_xy_m == (-3.0, 0.0)  # other places are not affected
    assert case.tick((3.0, 0.0), after_s=60.0) is not None  # nor is this one for ever


def test_what_was_discarded_gets_another_chance_before_the_end():
    case = Case()
    case.tick((3.0, 0.0))
    case.pursuit._discard(case.now_ns)
    case.pool.discard(0, 1, (3.0, 0.0), case.now_ns + 1000 * S)
    case.turn_round()
    assert not case.pursuit.exhausted
    case.tick((3.0, 0.0))
    assert case.tick((3.0, 0.0), after_s=2.5).candidate_xy_m == (3.0, 0.0)
