"""Candidates keep their identity while they move little, and only then."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from mapping.mapping_twins import SMALL, complete, look, room

from edge.geometry import SE2
from edge.loop.goals.candidates import CandidatePool
from edge.mapping.grid import RollingMap
from edge.policies.base import FRONTIER, INSTANCE, SPIN, Candidates
from edge.types import Instance


def frontiers(*points: tuple[float, float]) -> SimpleNamespace:
    """As much of `edge.mapping.grid.Frontiers` as the pool reads."""
    xy = np.zeros((64, 2), np.float32)
    xy[: len(points)] = np.array(points, np.float32).reshape(-1, 2)
    return SimpleNamespace(n=len(points), xy_m=xy)


def instance(id: int, x: float, y: float, score: float = 0.5) -> Instance:
    point = np.array([x, y, 0.5], np.float32)
    return Instance(id, "chair", point, point[None], score, 1, 0, 0)


def ids(pool: CandidatePool) -> list[int]:
    return pool.candidates.id[: pool.candidates.n].tolist()


def test_nothing_in_nothing_out():
    pool = CandidatePool(16, 0.5)
    pool.update(frontiers(), [], 0, 0)
    assert pool.candidates.n == 0
    assert pool.candidates.index_of(FRONTIER, 1) == -1


def test_capacity_keeps_instances():
    pool = CandidatePool(2, 0.5)
    pool.update(frontiers((0, 0), (2, 0), (4, 0)), [instance(9, 1, 1)], 0, 0)
    assert pool.candidates.n == 2
    assert pool.candidates.index_of(INSTANCE, 9) == 1


def test_a_discarded_point_is_blocked_until_its_time():
    pool = CandidatePool(16, 0.5)
    pool.discarded.add(FRONTIER, 1, (1.0, 1.0), until_ns=100)
    pool.update(frontiers((1.2, 1.0), (3, 3)), [], 50, 50)
    assert pool.candidates.blocked[:2].tolist() == [True, False]
    pool.update(frontiers((1.2, 1.0), (3, 3)), [], 150, 150)
    assert pool.candidates.blocked[:2].tolist() == [False, False]


def nearest_pairs_first(old: np.ndarray, new: np.ndarray, radius: float) -> list[int]:
    """Association in plain Python: all pairs, nearest first, each entry once."""
    pairs = [
        (float(((n - o) ** 2).sum()), i, j) for i, n in enumerate(new) for j, o in enumerate(old)
    ]
    match = [-1] * len(new)
    for d2, i, j in sorted(pairs):
        if d2 < radius * radius and match[i] < 0 and j not in match:
            match[i] = j
    return match


@given(st.integers(0, 2**32 - 1), st.integers(0, 12), st.integers(0, 12))
def test_the_nearest_pairs_are_joined_first(seed, n_old, n_new):
    rng = np.random.default_rng(seed)
    old, new = rng.uniform(0, 1.5, (n_old, 2)), rng.uniform(0, 1.5, (n_new, 2))
    old, new = old.astype(np.float32), new.astype(np.float32)
    pool = CandidatePool(16, 0.5)
    pool.update(frontiers(*old), [], 0, 0)
    before = ids(pool)
    pool.update(frontiers(*new), [], 1, 1)
    got = [before.index(i) if i in before else -1 for i in ids(pool)]
    assert got == nearest_pairs_first(old, new, 0.5)


@given(
    st.lists(
        st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5)), max_size=20), min_size=1, max_size=6
    )
)
def test_ids_never_repeat_and_anchors_stay_near(frames):
    pool = CandidatePool(64, 0.5)
    for now, points in enumerate(frames):
        pool.update(frontiers(*points), [], now, now)
        assert len(set(ids(pool))) == pool.candidates.n == len(points)
        away = np.hypot(
            *(pool.candidates.xy_m[: pool.candidates.n] - pool.anchor_m[: pool.candidates.n]).T
        )
        assert (away < 0.5).all()


def looking(pose: SE2, *boxes) -> RollingMap:
    """Return a map after one view, with its travel-cost field."""
    grid = RollingMap(SMALL)
    look(grid, pose, [*boxes])
    complete(grid, pose)
    return grid


def test_a_spin_is_one_candidate_that_can_be_discarded():
    pose = SE2(0.0, 0.0, 0.0)
    grid, pool = looking(pose, *room(1.5)), CandidatePool(2, 0.5)

    def turn(now_ns: int) -> Candidates:
        pool.update(frontiers(), [], now_ns, now_ns)
        pool.add_spin(grid, pose, 1.3, now_ns)
        return pool.candidates

    c = turn(0)
    assert (c.n, c.kind[0], pool.read_only.n) == (1, SPIN, 1)
    assert c.gain_m2[0] > 1.5
    assert 0.15 < c.path_m[0] < 0.15 * 6.3
    first = int(c.id[0])
    assert turn(1).id[0] == first
    pool.discarded.add(SPIN, first, tuple(c.xy_m[0].tolist()), until_ns=100)
    assert turn(2).blocked[0]
    pool.update(frontiers((1, 0), (2, 0)), [], 3, 3)
    pool.add_spin(grid, pose, 1.3, 3)
    assert pool.candidates.n == 2, "no room for it"
