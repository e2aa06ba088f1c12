"""Pictures of objects: the best view of each, in limited memory, across a restart."""

from __future__ import annotations

import threading
import time

import cv2
import numpy as np
import pytest

from edge.memory import CropStore, crops
from edge.perception.tracking.object_tracker import ObservedObject

RED, BLUE = (250, 0, 0), (0, 0, 250)


def image(color=RED, height=240, width=320):
    return np.full((height, width, 3), color, np.uint8)


def seen(id, score=0.8, box=(50, 50, 150, 130)):
    return ObservedObject(id, np.array(box, np.float32), score)


@pytest.fixture
def store():
    return CropStore(inline=True)


def color_of(jpeg):
    return cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1].mean((0, 1))


def test_nothing_seen_no_picture(store):
    store.observe([], image())
    assert (len(store), store.changes, store.get(1)) == (0, 0, None)
    assert store.state_dict()["jpeg"].size == 0


@pytest.mark.parametrize(
    ("second", "color"),
    [
        (seen(1, 0.3), RED),
        (seen(1, 0.9), RED),  # hardly better
        (seen(1, 1.0), BLUE),
        (seen(1, 1.0, (0, 50, 100, 130)), RED),  # the image cuts it
        (seen(1, 1.0, (50, 50, 60, 130)), RED),  # small
    ],
)
def test_a_clearly_better_view_replaces_the_picture(store, second, color):
    store.observe([seen(1, 0.75)], image())
    store.observe([second], image(BLUE))
    assert color_of(store.get(1)) == pytest.approx(color, abs=12)


@pytest.mark.parametrize("box", [(50, 50, 150, 130), (0, 0, 320, 240), (-5, -5, 400, 300)])
def test_a_picture_is_small(store, box):
    store.observe([seen(1, box=box)], image())
    height, width = cv2.imdecode(np.frombuffer(store.get(1), np.uint8), 1).shape[:2]
    assert max(height, width) <= crops.SIDE_PX


def test_one_image_fills_only_a_few_pictures(store):
    objects = [seen(i) for i in range(1, 6)]
    store.observe(objects, image())
    assert len(store) == 3
    store.observe(objects, image())
    assert len(store) == 5


def test_a_moved_object_keeps_its_new_picture(store):
    store.observe([seen(1)], image())
    store.observe([seen(9)], image(BLUE))
    store.rename({9: 1})
    assert store.get(9) is None
    assert color_of(store.get(1)) == pytest.approx(BLUE, abs=12)


def test_the_better_of_two_pictures_of_an_object_stays(store):
    store.observe([seen(1)], image())
    store.observe([seen(9, 0.1, (50, 50, 80, 70))], image(BLUE))
    store.rename({9: 1})
    assert store.get(9) is None
    assert color_of(store.get(1)) == pytest.approx(RED, abs=12)
    store.observe([seen(1, 0.2)], image(BLUE))
    assert color_of(store.get(1)) == pytest.approx(RED, abs=12)


@pytest.mark.parametrize(("known", "color"), [(0.7, BLUE), (1.0, RED)])
def test_a_picture_of_a_renamed_object_is_stored_under_its_new_id(monkeypatch, known, color):
    store, allowed, encode = CropStore(), threading.Event(), cv2.imencode
    store.load_state_dict(stored_picture(1, known))
    monkeypatch.setattr(crops.cv2, "imencode", lambda *args: allowed.wait(5.0) and encode(*args))
    store.observe([seen(9)], image(BLUE))
    store.rename({9: 4})
    store.rename({4: 1})
    allowed.set()
    while not store._worker.idle:
        time.sleep(0.01)
    assert len(store) == 1
    assert color_of(store.get(1)) == pytest.approx(color, abs=12)
    store.close()


def stored_picture(id, score):
    store = CropStore(inline=True)
    store.observe([seen(id, score)], image())
    return store.state_dict()


@pytest.mark.parametrize(("limit", "value"), [("MAX_CROPS", 2), ("MAX_CROP_BYTES", 1500)])
def test_over_the_limit_the_oldest_goes(store, monkeypatch, limit, value):
    monkeypatch.setattr(crops, limit, value)
    for i in range(1, 6):
        store.observe([seen(i)], image())
    assert 1 <= len(store) <= 2
    assert store.get(5) is not None
    assert store.get(1) is None


def test_pictures_survive_a_restart(store):
    store.observe([seen(1), seen(2)], image())
    other = CropStore(inline=True)
    other.load_state_dict(store.state_dict())
    assert (other.get(1), other.get(2)) == (store.get(1), store.get(2))
    other.observe([seen(1, 0.3)], image(BLUE))
    assert other.get(1) == store.get(1)
    other.clear()
    assert len(other) == 0


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("id", lambda a: a * 0),
        ("n_bytes", lambda a: a + 1),
        ("n_bytes", lambda a: -a),
        ("jpeg", lambda a: a[1:]),
        ("quality", lambda a: a * np.nan),
    ],
)
def test_damaged_pictures_are_refused(store, name, change):
    store.observe([seen(1), seen(2)], image())
    state = store.state_dict()
    with pytest.raises(ValueError, match=r"id|n_bytes|jpeg|quality"):
        CropStore(inline=True).load_state_dict(state | {name: change(state[name])})


def test_the_thread_ends():
    store, before = CropStore(), set(threading.enumerate())
    store.observe([seen(1)], image())
    (thread,) = set(threading.enumerate()) - before
    store.close()
    store.close()
    assert not thread.is_alive()
