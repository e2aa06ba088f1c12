from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lifted_boxes import lifted
from twins import fuse, match, strongest_competing_score

from edge import config
from edge.geometry import invert, se3, to_optical
from edge.perception.tracking import object_kernels as kernels
from edge.perception.tracking.look_kernels import NO_DEPTH
from edge.perception.tracking.object_tracker import ObjectTracker, ObservedObject
from edge.perception.tracking.place_index import CELL_M, make_index, rebuild

NEAR, FAR = 2.0, 5.0


class Scene:
    """Feeds a tracker with things at known places, one frame after the other."""

    def __init__(self, make_observation, **settings):
        self.tracker = ObjectTracker(
            config.PerceptionConfig(detector=config.DetectorSim(), **settings)
        )
        self.make, self.seq = make_observation, 0
        self.seen = self.tracker.read_only

    def see(self, *things, targets=("bed",), words=("chair", "sofa"), depth_m=6.0):
        """One frame with (word, x, y, score) each; targets and context are looked for."""
        self.seq += 1
        depth = np.full((64, 80), depth_m, np.float32)
        frame = self.make(seq=self.seq, depth_m=depth)
        found, around = (
            lifted(frame, things, looked_for, frame.seq, 0.15, 0.6)
            for looked_for in (targets, words)
        )
        self.tracker.update(found, around)
        return self

    def table(self):
        s = self.seen
        return [(s.words[s.word[i]], round(float(s.confidence[i]), 2)) for i in range(s.n)]


@pytest.fixture
def scene(make_observation):
    return lambda **settings: Scene(make_observation, **settings)


def test_nothing_seen_nothing_there(scene):
    s = scene().see()
    assert (s.seen.n, s.seen.generation) == (0, 0)
    assert s.seen.words == ["bed", "chair", "sofa"]
    assert len(s.seen.of("chair")) == len(s.seen.of("lamp")) == 0


def test_misses_lower_the_confidence_until_the_object_is_forgotten(scene):
    s = scene().see(("chair", NEAR, 0, 0.6))
    fell = [float(s.see().seen.confidence[0]) for _ in range(4)]
    assert (np.diff(fell) < 0).all()
    for _ in range(20):
        s.see()
    assert s.seen.n == 0


def test_weak_boxes_count_only_at_known_objects(scene):
    s = scene().see(("chair", NEAR, 0, 0.2))
    assert s.seen.n == 0
    s.see(("chair", NEAR, 0, 0.6)).see(("chair", NEAR, 0, 0.2))
    assert (s.seen.n, s.seen.hits[0]) == (1, 1)
    assert 0.2 < s.seen.confidence[0] < 0.5


def test_over_its_capacity_the_least_confident_goes(scene, monkeypatch):
    monkeypatch.setattr("edge.perception.tracking.object_tracker.MAX_TRACKED", 3)
    s = scene()
    for _ in range(5):
        s.see(("chair", NEAR, 0, 0.9), ("sofa", NEAR, 0, 0.8))
    for i in range(5):
        s.see(("chair", NEAR, 0, 0.9), ("sofa", NEAR, 0, 0.8), ("bed", FAR, 2.0 * (i - 2), 0.4))
    assert s.seen.n == 3
    assert len(set(s.seen.id[:3])) == 3
    assert {s.seen.words[w] for w in s.seen.word[:3]} == {"chair", "sofa", "bed"}


def moved(scene):
    """Return a scene with a chair that was seen three times, and then is gone from its place."""
    s = scene()
    for _ in range(3):
        s.see(("chair", NEAR, 0.5, 0.8))
    return s


@pytest.mark.parametrize("first", ["elsewhere", "gone"])
def test_an_object_seen_elsewhere_has_moved(scene, first):
    s = moved(scene)
    was, first_seen_ns = int(s.seen.id[0]), int(s.seen.first_seen_ns[0])
    if first == "gone":
        while s.seen.n:
            s.see()
        assert [one.id for one in s.tracker.moved.vanished] == [was]
    for _ in range(150):
        s.see(("chair", FAR, -2.0, 0.8))
    assert s.seen.n == 1
    assert (s.seen.id[0], s.seen.first_seen_ns[0], s.seen.moves[0]) == (was, first_seen_ns, 1)
    assert s.seen.came_from_m[0] == pytest.approx((NEAR, 0.5), abs=0.1)
    assert s.tracker.moved.vanished == []


def test_two_objects_that_were_seen_at_once_stay_two(scene):
    s = scene()
    for _ in range(3):
        s.see(("chair", NEAR, 0.5, 0.8), ("chair", FAR, -2.0, 0.8))
    ids = sorted(s.seen.id[:2].tolist())
    for _ in range(150):
        s.see(("chair", FAR, -2.0, 0.8))
    assert s.seen.n == 1
    assert s.seen.id[0] in ids
    assert s.seen.moves[0] == 0
    assert len(s.tracker.moved.vanished) == 1


@pytest.mark.parametrize("score", [0.36, 0.8])
def test_another_word_is_another_object(scene, score):
    s = moved(scene)
    for _ in range(150):
        s.see(("sofa", FAR, -2.0, score))
    assert (s.seen.n, s.seen.moves[0]) == (1, 0)


def test_a_vanished_object_survives_a_restart(scene):
    s, other = moved(scene), scene()
    while s.seen.n:
        s.see()
    assert s.tracker.moved.vanished
    other.tracker.load_state_dict(s.tracker.state_dict(), 5)
    other.seq = s.seq
    (before,), (after,) = s.tracker.moved.vanished, other.tracker.moved.vanished
    assert after == before._replace(
        first_seen_ns=before.first_seen_ns + 5, last_seen_ns=before.last_seen_ns + 5
    )
    for _ in range(3):
        other.see(("chair", FAR, -2.0, 0.8))
    assert other.seen.id[0] == before.id


def test_the_newest_image_shows_these_objects(scene):
    s = scene().see()
    assert s.tracker.observed == []
    s.see(("chair", NEAR, 0.5, 0.8), ("bed", FAR, 0, 0.7))
    assert {one.id for one in s.tracker.observed} == set(s.seen.id[:2].tolist())
    s.see()
    assert s.tracker.observed == []


@pytest.mark.parametrize("older_row", [0, 1])
def test_two_rows_that_are_one_object_keep_the_older_identity(scene, older_row):
    s = scene().see(("chair", NEAR, 0.5, 0.8), ("chair", FAR, -2.0, 0.8))
    rows = s.tracker._objects
    rows.id[older_row], rows.id[1 - older_row] = 7, 9
    rows.moves[older_row], rows.came_from_m[older_row] = 2, (4.0, 1.0)
    rows.xyz_m[1] = rows.xyz_m[0]  # the centres have come together
    s.tracker._place(1)
    s.see(("chair", NEAR, 0.5, 0.8))
    assert (s.seen.n, s.seen.id[0], s.seen.moves[0]) == (1, 7, 2)
    assert s.seen.came_from_m[0].tolist() == [4.0, 1.0]
    assert s.tracker.moved.renamed == {9: 7}
    assert [one.id for one in s.tracker.observed] == [7]


@pytest.mark.parametrize(
    ("renamed", "ids"),
    [({}, [9, 5, 3]), ({9: 7}, [7, 5, 3]), ({9: 5, 5: 2}, [2, 3]), ({4: 1}, [9, 5, 3])],
)
def test_observed_objects_have_the_ids_of_their_rows(scene, renamed, ids):
    tracker = scene().tracker
    tracker.observed = [ObservedObject(i, np.zeros(4, np.float32), 0.1 * i) for i in (9, 5, 3)]
    tracker.moved.renamed = renamed
    tracker._rename_observed()
    assert [one.id for one in tracker.observed] == ids
    assert tracker.observed[0].score == pytest.approx(0.9)


def test_ids_continue_after_everything_is_forgotten(scene):
    s = scene().see(("chair", NEAR, 0, 0.6))
    before, generation = int(s.seen.id[0]), s.seen.generation
    s.tracker.clear()
    assert s.seen.n == 0
    assert s.seen.generation > generation
    assert s.see(("chair", NEAR, 0, 0.6)).seen.id[0] > before


def test_readers_cannot_write(scene):
    seen = scene().see(("chair", NEAR, 0, 0.6)).seen
    with pytest.raises(ValueError, match="read-only"):
        seen.confidence[0] = 1.0


def surface(x_m, y_m=0.0, z_m=0.6, half_m=0.15, seed=7):
    random = np.random.default_rng(seed)
    middle = np.array((x_m, y_m, z_m))
    return (middle + random.uniform(-half_m, half_m, (40, 3))).astype(np.float32)


@pytest.mark.parametrize(
    ("seen", "doubtful"),
    [
        ((), False),
        ((("bed", NEAR, 0, 0.5),), False),
        ((("sofa", NEAR, 0, 0.5),), True),
        ((("bed", NEAR, 0, 0.6), ("sofa", NEAR, 0, 0.4)), False),
        ((("bed", NEAR, 0, 0.4), ("sofa", NEAR, 0, 0.6)), True),
        ((("bed", NEAR, 0, 0.4), ("sofa", NEAR, 0.8, 0.6)), False),
        ((("bed", NEAR, 0, 0.4), ("double bed", NEAR, 0, 0.6)), False),
    ],
    ids=[
        "nothing", "itself", "another", "less sure", "surer", "surer beside it", "the same thing",
    ],
)  # fmt: skip
def test_an_object_with_a_likelier_class_is_tentative(scene, seen, doubtful):
    s = scene()
    for _ in range(5):
        s.see(*seen, words=("chair", "sofa", "double bed"))
    assert s.tracker.has_competing_object("bed", surface(NEAR), 0.2) == doubtful


def test_restored_objects_compete_after_the_first_image(scene):
    before, after = scene().see(("sofa", NEAR, 0, 0.9)), scene()
    after.tracker.load_state_dict(before.tracker.state_dict(), 0)
    assert not after.tracker.has_competing_object("bed", surface(NEAR), 0.2)
    after.see()
    assert after.tracker.has_competing_object("bed", surface(NEAR), 0.2)


@pytest.mark.parametrize(
    ("target", "around", "doubtful"),
    [
        (("armchair", 0.45), ("chair", 0.5), False),  # an armchair is a chair
        (("armchair", 0.3), ("chair", 0.9), True),  # but hardly this one
        (("chair", 0.3), ("armchair", 0.9), False),
    ],
)
def test_a_broader_word_counts_less_and_a_narrower_nothing(scene, target, around, doubtful):
    s = scene()
    for _ in range(8):
        seen = [(word, NEAR, 0, score) for word, score in (target, around)]
        s.see(*seen, targets=(target[0],), words=(around[0],))
    assert s.tracker.has_competing_object(target[0], surface(NEAR), 0.2) == doubtful


def test_small_objects_compete_with_a_large_one_not_vice_versa(scene):
    row = [("chair", NEAR, y, 0.6) for y in (-0.7, 0.0, 0.7)]
    s = scene(merge_m=0.4)
    for _ in range(5):
        s.see(*row, ("sofa", NEAR, 0.0, 0.45), targets=("sofa",), words=("chair",))
    assert s.tracker.has_competing_object(
        "sofa", np.concatenate([surface(NEAR, y) for *_, y, _ in row]), 0.9
    )
    large = scene()
    for _ in range(5):
        large.see(("sofa", NEAR, 0, 0.8), ("sofa", NEAR, 0.5, 0.8), ("sofa", NEAR, -0.5, 0.8))
    vase = surface(NEAR, 0.5, z_m=0.9, half_m=0.06)
    assert not large.tracker.has_competing_object("vase", vase, 0.1)


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 6))
def test_the_strongest_competing_class_agrees_with_its_twin(seed, n):
    random = np.random.default_rng(seed)
    centers = random.uniform(-0.5, 0.5, (n, 3)).astype(np.float32)
    points = np.zeros((n, kernels.POINTS, 3), np.float32)
    points[:] = centers[:, None] + random.uniform(-0.3, 0.3, points.shape)
    n_points = random.integers(0, kernels.POINTS + 1, n).astype(np.int32)
    word = random.integers(0, 3, n).astype(np.int16)
    confidence = random.random(n, np.float32)
    against = random.choice((0.0, 0.5, 1.0), 3).astype(np.float32)
    thing = random.uniform(-0.4, 0.4, (random.integers(1, 30), 3)).astype(np.float32)
    given = (thing, centers, points, n_points, word, confidence)
    rows = np.arange(n, dtype=np.int32)
    assert kernels.competing_confidence(*given, rows, against, 0.6) == pytest.approx(
        strongest_competing_score(*given, against, 0.6), abs=1e-5
    )


@pytest.mark.parametrize(("spread_m", "weight"), [(0.0, 1.0), (0.2, 1.0), (3.0, 0.25)])
def test_a_partial_view_of_an_object_counts_less(spread_m, weight):
    points = np.zeros((kernels.POINTS, 3), np.float32)
    points[:] = 2.0, 0.0, 0.6
    points[:, 1] += np.linspace(-spread_m, spread_m, kernels.POINTS, dtype=np.float32)
    T = invert(to_optical(se3(0.0, 0.0, 0.6)))
    look = (T, np.array((20.0, 20.0, 16.0, 12.0, 32, 24)), NO_DEPTH, 3.0, 6.0)
    assert kernels.weight_of(2.0, 0.0, 0.6, points, kernels.POINTS, *look) == weight
    assert kernels.weight_of(2.0, 0.0, 0.6, points, 0, *look) == 1.0


@given(seed=st.integers(0, 2**32 - 1), views=st.integers(1, 20))
def test_a_view_updates_centre_points_reach_and_cell(seed, views):
    random = np.random.default_rng(seed)
    centers, seen = random.uniform(-4, 4, (2, 3, 3)).astype(np.float32)
    surfaces = (seen[:, None] + random.uniform(-0.3, 0.3, (3, 9, 3))).astype(np.float32)
    points = np.zeros((3, kernels.POINTS, 3), np.float32)
    n_points, cursor = np.zeros((2, 3), np.int32)
    n_surface, reach, index = np.array([9, 0, 9], np.int32), np.zeros(3, np.float32), make_index(3)
    rebuild(index, centers, 3)
    moved = centers[1] + (seen[2] - centers[1]) / np.float32(views)
    ours, twin = (points, n_points, cursor), (points.copy(), n_points.copy(), cursor.copy())
    kernels.add_points(*twin, 1, surfaces[2], 9, 0.1)
    got = kernels.add_view(
        index, centers, *ours, reach, 1, seen, surfaces, n_surface, 2, views, 0.1
    )
    np.testing.assert_array_equal(centers[1], moved)
    for mine, other in zip(ours, twin, strict=True):
        np.testing.assert_array_equal(mine, other)
    assert got == reach[1] == np.float32(kernels.reach_of(centers, points, n_points, 1))
    np.testing.assert_array_equal(index[2][1], np.floor(moved[:2] / CELL_M))


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(0, 6))
def test_match_and_fuse_agree_with_their_twins(seed, n):
    random = np.random.default_rng(seed)
    centers = random.uniform(-4, 4, (n, 3)).astype(np.float32)
    points = (centers[:, None] + random.uniform(-0.3, 0.3, (n, kernels.POINTS, 3))).astype("f4")
    n_points = random.integers(0, kernels.POINTS + 1, n).astype(np.int32)
    word = random.integers(0, 2, n).astype(np.int16)
    x, y = random.uniform(-4, 4, 2)
    reach = np.array([kernels.reach_of(centers, points, n_points, i) for i in range(n)], np.float32)
    rows = np.arange(n, dtype=np.int32)
    given = (centers, points, n_points)
    assert kernels.match(*given, reach, word, rows, 1, x, y, 2.0) == match(
        *given, word, 1, x, y, 2.0
    )
    index = make_index(len(centers))
    rebuild(index, centers, n)
    search_m = 2.0 + reach.max(initial=0.0)
    assert kernels.match_near(index, n, search_m, rows, *given, reach, word, 1, x, y, 2.0) == match(
        *given, word, 1, x, y, 2.0
    )
    depth = random.uniform(0.5, 6, (24, 32)).astype(np.float32)
    T = to_optical(se3(0.0, 0.0, 0.6))
    view = np.array((20.0, 20.0, 16.0, 12.0, 32, 24))
    look = (invert(T), view, depth, 3.0, 6.0)
    asked = random.random(2) < 0.7
    ours = [a.astype(np.float32) for a in random.random((4, n)) * ((1,), (30,), (20,), (1,))]
    ours[0][random.random(n) < 0.5] = 0.0
    twin = [a.copy() for a in ours]
    kernels.fuse(centers, points, n_points, word, n, ours[0], asked, *look, *ours[1:])
    fuse(centers, points, n_points, word, twin[0], asked, *look, *twin[1:])
    np.testing.assert_allclose(ours, twin, atol=1e-5)
