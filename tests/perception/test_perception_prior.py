"""The prior's table, its ratios for nearby objects and rooms, and its words."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import nearby as nearby_twin

from edge import names
from edge.config import DetectorOnnx
from edge.perception.prior import cooccurrence, rooms, table
from edge.perception.prior.nearby import nearby
from edge.perception.prior.words import PriorWordIndex, make_words

BED, LAMP, TOILET = range(3)
DATA = {
    "rooms": 100,
    "things": ["bed", "floor lamp", "toilet"],
    "rooms_with_both": [[50], [20, 20], [0, 4, 30]],
    "near": {"bias": [-200, 0, -100], "weight": {"bed": {"floor lamp": 150, "toilet": -300}}},
    "kinds": {
        "names": ["bathroom", "bedroom"],
        "rooms": [40, 60],
        "rooms_with": [[0, 4, 36], [50, 20, 0]],
        "doors": [[0, 30], [30, 0]],
        "pairs": [[0, 30], [30, 0]],
        "evidence": 1.0,
        "power": [1.0, 0.5],
    },
}
TABLE = table.parse(DATA)


def test_the_table_holds_together():
    t = table.load()
    both, n = t.rooms_with_both, len(t.classes)
    np.testing.assert_array_equal(both, both.T)
    assert (both <= np.minimum.outer(both.diagonal(), both.diagonal())).all()
    assert both.diagonal().max() <= t.n_rooms == t.kind_rooms.sum()
    assert (t.kind_rooms_with <= t.kind_rooms[:, None]).all()
    assert t.near_weight.shape == both.shape == (n, n)
    assert [names.canonical(name) for name in t.classes] == list(t.classes)
    assert set(json.loads(table.FILE.read_text())) > {"source", "command", "licence"}
    assert table.FILE.stat().st_size < 100_000


@pytest.mark.parametrize(
    ("a", "b", "low", "high"),
    [
        ("toilet", "sink", 1.5, 10),
        ("bed", "pillow", 1.5, 10),
        ("toilet", "bed", 0.0, 0.2),
        ("tv", "sofa", 1.2, 10),
        ("bed", "bed", 1, 1),
        ("couch", "sofa", 1, 1),
        ("zeppelin", "bed", 1, 1),
    ],
)
def test_rooms_with_both(a, b, low, high):
    lift = table.load().likelihood_ratio([a, b])
    assert lift[0, 1] == lift[1, 0]
    assert low <= lift[0, 1] <= high
    assert lift[0, 0] == lift[1, 1] == 1


@pytest.mark.parametrize(("both", "lift"), [(20, 22 / 12), (10, 1.0), (0, 2 / 12)])
def test_small_counts_are_drawn_towards_one(both, lift):
    """Ten rooms with both by chance, and two more for unseen cases."""
    data = {
        **DATA,
        "things": ["bed", "vase"],
        "rooms_with_both": [[50], [both, 20]],
        "near": {"bias": [0, 0], "weight": {}},
        "kinds": {**DATA["kinds"], "rooms_with": [[0, 0], [0, 0]]},
    }
    assert table.parse(data).likelihood_ratio(["bed", "vase"])[0, 1] == pytest.approx(lift)


@pytest.mark.parametrize(
    ("target", "near", "lift"),
    [
        (BED, [0, 0, 0], 1.0),
        (BED, [0, 1, 0], (1 + np.exp(2)) / (1 + np.exp(0.5))),
        (BED, [0, 0, 1], (1 + np.exp(2)) / (1 + np.exp(5))),
        (BED, [0, 0.5, 0], (1 + np.exp(2)) / (1 + np.exp(1.25))),
        (TOILET, [1, 1, 1], 1.0),
        (-1, [1, 1, 1], 1.0),
    ],
)
def test_nearby_objects_change_the_likelihood_ratio(target, near, lift):
    out = np.empty(1, np.float32)
    cooccurrence.likelihood_ratio(TABLE, target, np.array([near], np.float32), out)
    assert out[0] == pytest.approx(lift, rel=1e-5)


def test_room_kinds_follow_from_their_objects():
    chance, prior = rooms.object_given_room(TABLE), rooms.room_prior(TABLE)
    assert prior == pytest.approx([0.4, 0.6])
    # 4 rooms more, of which (50 + 0.5) / 101 have a bed.
    assert chance[0, BED] == pytest.approx(4 * 50.5 / 101 / 44)
    held = np.zeros((3, 3), np.float32)
    held[1, TOILET] = held[2, BED] = 1
    belief = rooms.room_posterior(TABLE, held)
    np.testing.assert_allclose(belief.sum(1), 1)
    assert belief[0] == pytest.approx(prior)
    by_bayes = prior * chance[:, TOILET]
    assert belief[1] == pytest.approx(by_bayes / by_bayes.sum())
    assert belief[1, 0] > 0.9
    assert belief[2, 1] > 0.9


def test_without_objects_the_adjacent_room_decides():
    """Only doors between the two kinds of rooms are in the data.

    The houses have no data on two rooms of a kind, so a bedroom may be next to a bedroom.
    """
    data = {**DATA["kinds"], "doors": [[0, 90], [90, 0]], "pairs": [[200, 100], [100, 200]]}
    t = table.parse({**DATA, "kinds": data})
    prior = rooms.room_prior(t)
    nothing, toilet = np.zeros((1, 3), np.float32), np.eye(3, dtype=np.float32)[None, TOILET]
    own = rooms.room_posterior_at(t, toilet, nothing)
    beside = rooms.room_posterior_at(t, nothing, toilet)
    assert rooms.room_posterior_at(t, nothing, nothing)[0] == pytest.approx(prior)
    assert own[0, 0] > 0.9
    assert prior[1] < beside[0, 1] < 0.9
    assert t.neighbours[0, 0] == 1


def test_rooms_lift(monkeypatch):
    chance = np.array([[0.1, 0.1, 0.8], [0.8, 0.3, 0.2]])
    monkeypatch.setattr(rooms, "object_given_room", lambda table: chance)
    monkeypatch.setattr(rooms, "room_prior", lambda table: np.array([0.5, 0.5]))
    belief = np.array([[1.0, 0.0], [0.5, 0.5]])
    assert rooms.likelihood_ratio(TABLE, TOILET, belief) == pytest.approx([1.6, 1.0])
    assert rooms.likelihood_ratio(TABLE, -1, belief).tolist() == [1, 1]


@given(seed=st.integers(0, 2**31))
def test_nearby_is_its_twin(seed):
    rng = np.random.default_rng(seed)
    wall = rng.random((20, 30)) < 0.05
    n, m = rng.integers(0, 6), rng.integers(0, 12)
    xy = rng.uniform(-1, 4, (n, 2)).astype(np.float32)
    objects = rng.uniform(-1, 4, (m, 3)).astype(np.float32)
    row = rng.integers(-1, 3, m).astype(np.int32)
    weight = rng.random(m).astype(np.float32)
    out = np.full((n, 3), 9, np.float32)
    nearby(wall, -0.5, 0.2, 0.1, xy, n, objects, row, weight, m, 1.5, out)
    expected = nearby_twin(wall, -0.5, 0.2, 0.1, xy, objects, row, weight, 1.5, 3)
    np.testing.assert_array_equal(out, expected)


def test_a_wall_hides_objects_behind_it():
    wall = np.zeros((30, 30), np.bool_)
    wall[:, 15] = True
    xy, out = np.array([[0.5, 1.5]], np.float32), np.empty((1, 1), np.float32)
    row, sure = np.zeros(1, np.int32), np.ones(1, np.float32)
    for x_m, seen in ((1.2, 1), (1.6, 1), (2.2, 0), (4.0, 0)):
        objects = np.array([[x_m, 1.5, 0.0]], np.float32)
        nearby(wall, 0.0, 0.0, 0.1, xy, 1, objects, row, sure, 1, 3.0, out)
        assert out[0, 0] == seen, x_m


VOCABULARY = (
    ["bed", "toilet", "cot", "cloud"],
    np.array([[1, 0, 0], [0, 1, 0], [0.95, 0.3, 0.087], [0.6, 0, 0.8]], np.float32),
)


@pytest.mark.parametrize(
    ("word", "row", "by_embedding"),
    [
        ("bed", BED, BED),
        ("beds", BED, BED),
        ("the white toilet", TOILET, TOILET),
        ("standing lamp", LAMP, LAMP),
        ("cot", -1, BED),
        ("cloud", -1, -1),
        ("zeppelin", -1, -1),
        ("?!", -1, -1),
    ],
)
def test_words(word, row, by_embedding):
    assert PriorWordIndex(TABLE).row(word) == row
    assert PriorWordIndex(TABLE, VOCABULARY).row(word) == by_embedding


@pytest.mark.parametrize(
    ("word", "obj"), [("flagpole", None), ("cushion", "pillow"), ("water faucet", "faucet")]
)
def test_words_of_clip(shared_dir, word, obj):
    file = shared_dir / "models" / "clip_vitb32_vocab.npz"
    if not file.is_file():
        pytest.skip(f"test data not there: {file.name}")
    learned = table.load()
    words = make_words(learned, DetectorOnnx(vocabulary=str(file)))
    assert words.row(word) == (-1 if obj is None else learned.row(obj))
