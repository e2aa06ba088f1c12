"""Policies that use the simulator's truth: their choices, and that no robot gets one."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from small_house import small_house

from edge.geometry import SE2
from edge.lab.eval.arms import make_arms
from edge.lab.eval.bounds import KnownPlace, KnownRoom
from edge.lab.eval.drive import run_episode
from edge.lab.eval.episodes import plan
from edge.lab.sim.worlds import load_world
from edge.policies.base import FRONTIER, INSTANCE, SPIN, Candidates, PolicyInput

RADIUS_M = 0.2
PLACE, ROOM = "edge.lab.eval.bounds:KnownPlace", "edge.lab.eval.bounds:KnownRoom"
# The house's bed stands at (6.8, 2.0) in room two, behind the door at (4, 2); its sofa in room one.


@pytest.fixture
def world(tmp_path):
    return load_world(small_house(tmp_path))


def context(target: str, *candidates: tuple[int, float, float, float, float]) -> PolicyInput:
    """Return candidates given as kind, x, y, path [m] and gain [m²]."""
    c = Candidates(8)
    c.n = len(candidates)
    for k, (kind, x, y, path_m, gain_m2) in enumerate(candidates):
        c.kind[k], c.xy_m[k], c.path_m[k], c.gain_m2[k] = kind, (x, y), path_m, gain_m2
    nowhere = (0, 0, 0, 0)
    at = SE2(0.0, 0.0, 0.0)
    return PolicyInput(None, at, None, nowhere, c.read_only(), None, None, (target,), target, 0)


def test_a_world_without_known_rooms_is_refused():
    with pytest.raises(ValueError, match="garage: the rooms of this world are not known"):
        KnownRoom(SimpleNamespace(name="garage", rooms=()), RADIUS_M)


@pytest.mark.parametrize(
    ("target", "best"), [("bed", (4.0, 2.0)), ("sofa", (2.0, 2.0)), ("piano", (2.0, 2.0))]
)
def test_a_known_place_prefers_the_shortest_path(world, target, best):
    """For a class that no world contains, the nearest frontier is as good as any."""
    policy = KnownPlace(world, RADIUS_M)
    seen = [(FRONTIER, 0.5, 0.5, 1.6, 9.0), (FRONTIER, 4.0, 2.0, 3.0, 1.0),
            (FRONTIER, 2.0, 2.0, 1.0, 0.0)]  # fmt: skip
    score = policy.score(context(target, *seen))
    assert seen[int(score.argmax())][1:3] == best


def test_a_known_place_looks_round_first_and_ignores_look_alikes(world):
    seen = [(FRONTIER, 4.0, 2.0, 3.0, 1.0), (INSTANCE, 2.0, 3.0, 1.0, 0.0),
            (INSTANCE, 6.0, 2.0, 5.0, 0.0), (SPIN, 1.0, 2.0, 0.1, 4.0)]  # fmt: skip
    score = KnownPlace(world, RADIUS_M).score(context("bed", *seen))
    assert score[3] > score[0] > 0.0
    assert score[2] > score[1] == 0.0
    assert np.isfinite(score).all()


def test_a_known_room_is_entered_first_then_searched(world):
    policy = KnownRoom(world, RADIUS_M)
    seen = [(FRONTIER, 0.5, 0.5, 1.6, 9.0), (FRONTIER, 3.5, 2.0, 2.5, 0.1),
            (FRONTIER, 5.0, 0.5, 9.0, 0.5), (FRONTIER, 5.0, 3.5, 9.0, 2.0)]  # fmt: skip
    score = policy.score(context("bed", *seen))
    assert np.argsort(-score).tolist() == [3, 2, 1, 0]
    assert score[2] > 1000.0 * score[1]
    assert policy.score(context("sofa", *seen)).argmax() == 0


@pytest.mark.parametrize("kind", [PLACE, ROOM])
def test_evaluations_drive_with_the_truth(tmp_path, kind):
    config = small_house(tmp_path, mission={"time_limit_s": 60.0})
    (arm,) = make_arms(config, {"bound": {"policy": {"kind": kind, "spin": True}}})
    (episode,) = plan(config, [], ["bed"], 1, 0, 4.0)
    outcome = run_episode(arm, episode)
    assert outcome.success, outcome.reason
    assert outcome.path_m < 1.3 * outcome.shortest_m
