"""Goal scoring against VL-Nav's equations written out in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge.config import PolicyHvl, PolicyNearest
from edge.geometry import SE2, wrap_angle
from edge.loop.candidates import FRONTIER, INSTANCE, CandidatePool
from edge.policies import make_policy
from edge.policies.base import ranked
from edge.policies.kernels import hvl_scores, vl_scores

FOV = math.radians(75)


def eq3(offset: float, boxes: list[tuple[float, float]], sigma: float) -> float:
    """VL-Nav eq. 3 and 4, inside the field of view; boxes are (bearing, confidence)."""
    mixture = sum(a * math.exp(-0.5 * ((offset - mu) / sigma) ** 2) for mu, a in boxes)
    return mixture * math.cos(offset / (FOV / 2) * math.pi / 2) ** 2


def scored(points, boxes, pose=SE2(0, 0, 0), seen_ns=0, stamp=0, vl=None, targets=1):  # noqa: B008
    """(targets, points) scores; boxes are (bearing, confidence[, target])."""
    xy = np.array(points, np.float32).reshape(-1, 2)
    n = len(xy)
    out = np.full((targets, n), np.nan, np.float32) if vl is None else np.array([vl], np.float32)
    mu = np.array([b[0] for b in boxes], np.float64)
    alpha = np.array([b[1] for b in boxes], np.float64)
    label = np.array([b[2] if len(b) > 2 else 0 for b in boxes], np.int32)
    kind, seen = np.zeros(n, np.int8), np.full(n, seen_ns, np.int64)
    vl_scores(
        xy, kind, seen, n, pose.x_m, pose.y_m, pose.yaw_rad, stamp, FOV, mu, alpha, label, 0.1, out
    )
    return out


def test_no_candidates():
    assert scored([], [(0.0, 1.0)]).size == 0


def test_no_boxes_score_zero():
    assert scored([(2, 0)], [], targets=2).tolist() == [[0.0], [0.0]]


@settings(max_examples=100)
@given(
    x=st.floats(-4, 4), y=st.floats(-4, 4), yaw=st.floats(-3.1, 3.1),
    boxes=st.lists(st.tuples(st.floats(-0.6, 0.6), st.floats(0.05, 1)), max_size=5),
)  # fmt: skip
def test_vl_score_is_eq_3(x, y, yaw, boxes):
    pose = SE2(0.3, -0.2, yaw)
    x, y = float(np.float32(x)), float(np.float32(y))
    offset = wrap_angle(math.atan2(y - pose.y_m, x - pose.x_m) - yaw)
    got = scored([(x, y)], boxes, pose)[0, 0]
    if abs(abs(offset) - FOV / 2) < 1e-6:
        return
    if abs(offset) > FOV / 2:
        assert math.isnan(got)
    else:
        assert got == pytest.approx(eq3(offset, boxes, 0.1), abs=1e-5)


def test_vl_score_stays_from_first_sight():
    assert scored([(2, 0)], [(0.0, 0.9)], vl=[0.25]).tolist() == [[0.25]]


def test_each_target_has_a_score_of_its_own_from_the_same_look():
    got = scored([(2, 0), (2, 1)], [(0.0, 0.9, 0), (0.46, 0.5, 1)], targets=3)
    for target, boxes in enumerate(([(0.0, 0.9)], [(0.46, 0.5)], [])):
        np.testing.assert_allclose(got[target], scored([(2, 0), (2, 1)], boxes)[0])


def test_an_image_from_before_the_candidate_says_nothing():
    assert math.isnan(scored([(2, 0)], [(0.0, 0.9)], seen_ns=10, stamp=9)[0, 0])


@pytest.mark.parametrize(
    ("kind", "vl", "ratio", "heuristics", "expected"),
    [
        (FRONTIER, 0.0, 0.0, True, 0.5 / 3),
        (FRONTIER, math.nan, 1.0, True, 0.5 / 3),
        (FRONTIER, 0.4, 0.5, True, 0.5 / 3 + 2.0 * 0.4 * (1 - math.exp(-3 * 0.5))),
        (FRONTIER, 0.4, 0.5, False, 0.4),
        (INSTANCE, 0.4, 0.5, True, 0.4),
    ],
)
def test_hvl_score_is_eq_8(kind, vl, ratio, heuristics, expected):
    score = np.zeros(1, np.float32)
    hvl_scores(
        np.array([[2.0, 0.0]], np.float32), np.array([kind], np.int8),
        np.array([vl], np.float32), np.array([ratio], np.float32), 1, 0.0, 0.0,
        0.5, 2.0, 3.0, heuristics, score,
    )  # fmt: skip
    assert score[0] == pytest.approx(expected, rel=1e-5)


def pool_of(*entries: tuple[int, float, float, float]) -> CandidatePool:
    """A pool of (kind, x, y, score)."""
    pool = CandidatePool(16, 0.5)
    pool.n = len(entries)
    for i, (kind, x, y, score) in enumerate(entries):
        pool.kind[i], pool.xy_m[i], pool.score[i], pool.id[i] = kind, (x, y), score, i + 1
    return pool


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        ([], []),
        ([(FRONTIER, 2, 0, 0.1), (FRONTIER, 3, 0, 0.9)], [1, 0]),
        # Instances come first, whatever a frontier scores.
        ([(FRONTIER, 2, 0, 0.9), (INSTANCE, 3, 0, 0.1)], [1, 0]),
        # Too close to be a goal; an instance there is for the mission to verify.
        ([(FRONTIER, 0.2, 0, 0.9), (FRONTIER, 3, 0, 0.1)], [1]),
        ([(INSTANCE, 0.2, 0, 0.9), (FRONTIER, 3, 0, 0.1)], [0, 1]),
        # Ties go to the older identity.
        ([(FRONTIER, 2, 0, 0.5), (FRONTIER, 3, 0, 0.5)], [0, 1]),
    ],
)
def test_ranking_is_algorithm_2(entries, expected):
    assert ranked(pool_of(*entries), SE2(0, 0, 0), 0.5).tolist() == expected


def test_blocked_candidates_are_left_out():
    pool = pool_of((FRONTIER, 2, 0, 0.9), (FRONTIER, 3, 0, 0.1))
    pool.blocked[0] = True
    assert ranked(pool, SE2(0, 0, 0), 0.5).tolist() == [1]


def test_nearest_frontier_scores_by_nearness():
    pool = pool_of((FRONTIER, 4, 0, 0), (FRONTIER, 2, 0, 0), (INSTANCE, 9, 0, 0))
    pool.vl[0, 2] = 0.6
    make_policy(PolicyNearest()).score(pool, None, None, SE2(0, 0, 0))
    assert pool.score[:3] == pytest.approx([0.2, 1 / 3, 0.6])


def test_the_registry_knows_every_policy_of_the_configuration():
    for section in (PolicyHvl(), PolicyNearest()):
        policy = make_policy(section)
        assert policy.delta_reached_m == section.delta_reached_m
