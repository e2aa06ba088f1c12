"""Goal scoring against VL-Nav's equations written out in plain Python."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from edge.config import PolicyHvl, PolicyNearest, PolicySearch
from edge.geometry import SE2, CameraModel, wrap_angle
from edge.policies import make_policy
from edge.policies.base import (
    FRONTIER,
    INSTANCE,
    SPIN,
    Candidates,
    PolicyInput,
    ScorerOutputs,
    scores_of,
)
from edge.policies.hvl import hvl_scores, relatedness, vl_scores
from edge.policies.search import SearchPolicy
from edge.policies.select import rank_candidates
from edge.types import ContextBoxes, Detections, Observation

FOV = math.radians(75)


def eq3(offset: float, boxes: list[tuple[float, float]], sigma: float) -> float:
    """VL-Nav eq. 3 and 4, inside the field of view; boxes are (bearing, confidence)."""
    mixture = sum(a * math.exp(-0.5 * ((offset - mu) / sigma) ** 2) for mu, a in boxes)
    return mixture * math.cos(offset / (FOV / 2) * math.pi / 2) ** 2


def scored(
    points, boxes, pose=SE2(0, 0, 0), seen_ns=0, stamp=0, vl=None, targets=1, around=0  # noqa: B008
):  # fmt: skip
    """Return (targets, points) scores.

    Boxes are (bearing, confidence[, target]); the last `around` of them are no targets.
    """
    xy = np.array(points, np.float32).reshape(-1, 2)
    n = len(xy)
    out = np.full((targets, n), np.nan, np.float32) if vl is None else np.array([vl], np.float32)
    mu = np.array([b[0] for b in boxes], np.float64)
    alpha = np.zeros((len(boxes), targets))
    for k, b in enumerate(boxes):
        alpha[k, b[2] if len(b) > 2 else 0] = b[1]
    of_targets = len(boxes) - around
    seen = np.full(n, seen_ns, np.int64)
    vl_scores(
        xy, seen, n, pose.x_m, pose.y_m, pose.yaw_rad, stamp, FOV, mu, alpha, of_targets, 0.1, out
    )
    return out


def test_no_candidates():
    assert scored([], [(0.0, 1.0)]).size == 0


def test_no_boxes_score_zero():
    assert scored([(2, 0)], [], targets=2).tolist() == [[0.0], [0.0]]


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


def test_each_target_has_its_own_score():
    got = scored([(2, 0), (2, 1)], [(0.0, 0.9, 0), (0.46, 0.5, 1)], targets=3)
    for target, boxes in enumerate(([(0.0, 0.9)], [(0.46, 0.5)], [])):
        np.testing.assert_allclose(got[target], scored([(2, 0), (2, 1)], boxes)[0])


def test_only_the_strongest_context_box_counts():
    """Ten pillows count no more for a bed than one, and the bed's own score is kept."""
    bed, pillows = (0.0, 0.4), [(0.0, 0.3), (0.02, 0.3), (-0.4, 0.9)]
    alone, one = scored([(2, 0)], [bed]), scored([(2, 0)], [bed, pillows[0]], around=1)
    assert one[0, 0] == pytest.approx(alone[0, 0] + 0.3)
    assert scored([(2, 0)], [bed, *pillows], around=3) == pytest.approx(one)
    assert scored([(2, 0)], pillows, around=3)[0, 0] == pytest.approx(0.3)


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
    score, one = np.zeros(1, np.float32), np.array([vl], np.float32)
    sight, confidence = (
        (np.array([np.nan], np.float32), one) if kind == INSTANCE else (one, one * 0)
    )
    hvl_scores(
        np.array([kind], np.int8), confidence, sight, np.array([ratio], np.float32),
        np.array([2.0], np.float32), 1, 0.5, 2.0, 3.0, heuristics, score,
    )  # fmt: skip
    assert score[0] == pytest.approx(expected, rel=1e-5)


def candidates_of(*entries: tuple[int, float, float]) -> Candidates:
    """Candidates of (kind, x, y), with ids that count from 1 and confidence 0.6."""
    candidates = Candidates(16)
    candidates.n = len(entries)
    candidates.confidence[:] = 0.6
    for i, (kind, x, y) in enumerate(entries):
        candidates.kind[i], candidates.xy_m[i], candidates.id[i] = kind, (x, y), i + 1
    return candidates


@pytest.mark.parametrize(
    ("entries", "score", "expected"),
    [
        ([], [], []),
        ([(FRONTIER, 2, 0), (FRONTIER, 3, 0)], [0.1, 0.9], [1, 0]),
        # Instances come first, whatever a frontier scores.
        ([(FRONTIER, 2, 0), (INSTANCE, 3, 0)], [0.9, 0.1], [1, 0]),
        # Too close to be a goal; an instance there is for the mission to verify.
        ([(FRONTIER, 0.2, 0), (FRONTIER, 3, 0)], [0.9, 0.1], [1]),
        ([(INSTANCE, 0.2, 0), (FRONTIER, 3, 0)], [0.9, 0.1], [0, 1]),
        # A spin is one more way to see unknown space.
        ([(FRONTIER, 3, 0), (INSTANCE, 3, 1), (SPIN, 0.3, 0)], [0.1, 0.1, 0.9], [1, 2, 0]),
        # Ties go to the older identity.
        ([(FRONTIER, 2, 0), (FRONTIER, 3, 0)], [0.5, 0.5], [0, 1]),
    ],
)
def test_ranking_is_algorithm_2(entries, score, expected):
    order = rank_candidates(candidates_of(*entries), np.array(score, np.float32), SE2(0, 0, 0), 0.5)
    assert order.tolist() == expected


@pytest.mark.parametrize(("confirmed_first", "expected"), [(True, [1, 0, 2]), (False, [0, 1, 2])])
def test_confirmed_instances_can_rank_before_higher_scores(confirmed_first, expected):
    candidates = candidates_of((INSTANCE, 2, 0), (INSTANCE, 5, 0), (FRONTIER, 1, 0))
    candidates.confirmed[1] = True
    score = np.array([0.3, 0.2, 0.9], np.float32)
    order = rank_candidates(candidates, score, SE2(0, 0, 0), 0.5, confirmed_first)
    assert order.tolist() == expected


@pytest.mark.parametrize(
    ("path_m", "best"),
    [
        # Ways to a confirmed object, and to one that may be another thing (confidence 0.36).
        ((2.0, 2.0), 0),
        ((2.0, 1.0), 0),
        ((5.0, 2.0), 1),
        ((9.0, 6.0), 0),
    ],
)
def test_objects_are_visited_by_the_least_expected_path(path_m, best):
    candidates = candidates_of((INSTANCE, 1, 0), (INSTANCE, 0, 1))
    candidates.confirmed[0], candidates.confidence[1] = True, 0.36
    candidates.path_m[:2] = path_m
    score = SearchPolicy(PolicySearch()).score(context(candidates))
    chance, cost_m = np.array([0.95, 0.6]), 1.0 + np.array(path_m)
    expected_m = [
        cost_m[i] + (1.0 - chance[i]) * cost_m[1 - i] for i in range(2)
    ]  # the second trip from here again
    assert int(score.argmax()) == int(np.argmin(expected_m)) == best


CAMERA = CameraModel.from_hfov(320, 256, FOV)


class Unknown:
    """A map of which nothing is known."""

    def unknown_ratio(self, xy_m, n, radius_m, out) -> None:
        out[:n] = 1.0


def xyxy_of(boxes) -> np.ndarray:
    middle = [CAMERA.cx_px - CAMERA.fx_px * math.tan(box[0]) for box in boxes]
    return np.array([[u - 1, 0, u + 1, 9] for u in middle], np.float32).reshape(-1, 4)


def scores_in(boxes) -> np.ndarray:
    return np.array([box[1] for box in boxes], np.float32)


def context(
    candidates, targets=("chair",), target="chair", boxes=None, stamp_ns=0, around=None
) -> PolicyInput:
    """Return a context with boxes (bearing, confidence, target) from the origin.

    Background boxes are (bearing, confidence, word).
    """
    seen = Observation(0, stamp_ns, np.eye(4), camera=CAMERA)
    found = None
    if boxes is not None:
        arrays = xyxy_of(boxes), scores_in(boxes), np.array([b[2] for b in boxes], np.int32)
        things = None
        if around is not None:
            words = tuple(word for _, _, word in around)
            count = np.arange(len(words), dtype=np.int32)
            things = ContextBoxes(xyxy_of(around), scores_in(around), count, words)
        found = Detections(seen, *arrays, targets, context=things)
    nowhere = (0, 0, 0, 0)
    return PolicyInput(
        seen, seen.pose, Unknown(), nowhere, candidates.read_only(), found, ScorerOutputs(),
        targets,
        target, 0,
    )  # fmt: skip


# Frontiers, one of them out of reach, an instance and a spin, with each policy's scores.
@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        (PolicyNearest(), [0.2, 1 / 3, 0.0, 0.6, 0.5]),
        (PolicyNearest(distance="straight"), [0.2, 1 / 3, 0.5, 0.6, 0.5]),
        (PolicySearch(), [0.4, 1.0, 0.0, 0.6**0.5 / 10, 1.0]),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_policies_combine_path_length_and_gain(policy, expected):
    candidates = candidates_of(
        (FRONTIER, 4, 0), (FRONTIER, 2, 0), (FRONTIER, 1, 0), (INSTANCE, 9, 0), (SPIN, 1, 0)
    )
    candidates.path_m[:5] = 4.0, 2.0, math.inf, 9.0, 1.0
    candidates.gain_m2[:5] = 4.0, 9.0, 25.0, 0.0, 4.0
    got = scores_of(make_policy(policy), context(candidates))
    assert got == pytest.approx(expected)
    assert got.dtype == np.float32


def test_nearer_instances_win_unless_much_less_certain():
    candidates = candidates_of(*[(INSTANCE, x, 0) for x in (1, 4, 2)])
    candidates.confidence[:3] = 0.25, 0.81, 0.04
    candidates.path_m[:3] = 1.0, 4.0, math.inf
    got = scores_of(make_policy(PolicySearch()), context(candidates))
    assert got == pytest.approx([0.5 / 2, 0.9 / 5, 0.2 / 3])


# By S_VL alone: the remembered value of a frontier is its score.
BY_SIGHT = PolicyHvl(heuristics=False)
BOTH = ("chair", "sofa")


def test_the_first_score_stays_with_its_frontier():
    policy = make_policy(BY_SIGHT)
    first = candidates_of((FRONTIER, 2, 0), (FRONTIER, 2, 1), (FRONTIER, 2, -1))
    bearing = math.atan2(1, 2)
    boxes = [(0.0, 0.5, 0), (bearing, 0.8, 0), (-bearing, 0.3, 1)]
    chair = scores_of(policy, context(first, BOTH, "chair", boxes)).copy()
    assert (chair[1] > 0.1, chair[2] < 0.01) == (True, True)
    # Another order, one gone, one new in sight of nothing, an instance, and a later image without
    # any box: it does not change earlier scores.
    later = candidates_of((FRONTIER, 0, 9), (FRONTIER, 2, -1), (FRONTIER, 2, 0), (INSTANCE, 1, 0))
    later.id[:4] = 7, 3, 1, 3
    later.first_seen_ns[0] = 5
    got = scores_of(policy, context(later, BOTH, "chair", [], stamp_ns=9)).copy()
    assert got.tolist() == [0.0, chair[2], chair[0], np.float32(0.6)]
    # The other target's scores are from the same look.
    sofa = scores_of(policy, context(later, BOTH, "sofa"))
    assert sofa[1] > 0.05 > sofa[2]


@pytest.mark.parametrize(
    ("why", "kept"), [("mission", False), ("pose", False), ("map rolled", True)]
)
def test_a_new_mission_or_pose_jump_clears_scores(why, kept):
    policy, one = make_policy(BY_SIGHT), candidates_of((FRONTIER, 2, 0))
    before = float(scores_of(policy, context(one, boxes=[(0.0, 0.5, 0)]))[0])
    assert before == pytest.approx(0.5)
    policy.reset(why)
    assert scores_of(policy, context(one)).tolist() == [before if kept else 0.0]


@pytest.mark.parametrize(
    "given", [[1.0], [[1.0, 2.0]], 3.0, [1.0, math.nan], [math.inf, 0.0]], ids=str
)
def test_a_policy_that_does_not_score_every_candidate_is_named(given):
    class Odd:
        def score(self, context):
            return given

        def reset(self, why):
            pass

    with pytest.raises(ValueError, match=r"^policy Odd: scores of shape .* for 2 candidates"):
        scores_of(Odd(), context(candidates_of((FRONTIER, 2, 0), (FRONTIER, 3, 0))))


@pytest.mark.parametrize(
    ("around", "w_context", "expected"),
    [
        (None, 1.0, 0.0),
        ([], 1.0, 0.0),
        ([(0.0, 0.8, "pillow")], 1.0, "related"),
        ([(0.0, 0.8, "pillow"), (0.0, 0.8, "pillow")], 1.0, "related"),
        ([(0.0, 0.8, "pillow")], 0.0, 0.0),
        ([(0.0, 0.8, "toilet")], 1.0, 0.0),
        ([(0.6, 0.8, "pillow")], 1.0, 0.0),
    ],
)
def test_hvl_is_drawn_to_related_objects(around, w_context, expected):
    policy = make_policy(PolicyHvl(heuristics=False, w_context=w_context))
    one = candidates_of((FRONTIER, 2, 0))
    got = scores_of(policy, context(one, ("bed", "piano"), "bed", [], around=around))
    if expected == "related":
        expected = 0.8 * relatedness(("pillow",), ("bed",))[0, 0]
    assert got[0] == pytest.approx(expected, abs=1e-3)
    piano = scores_of(policy, context(one, ("bed", "piano"), "piano"))
    assert piano[0] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("kind", [PolicyHvl, PolicyNearest])
def test_nearness_is_along_the_path_or_straight(kind):
    candidates = candidates_of((FRONTIER, 1, 0), (FRONTIER, 3, 0), (FRONTIER, 2, 0))
    candidates.path_m[:3] = 7.0, 3.0, math.inf
    path = scores_of(make_policy(kind()), context(candidates)).copy()
    straight = scores_of(make_policy(kind(distance="straight")), context(candidates))
    assert np.argsort(-path).tolist() == [1, 0, 2]
    assert path[2] == 0.0
    assert np.argsort(-straight).tolist() == [0, 2, 1]
