"""Questions to the memory of a running service, in a simulated house."""

from __future__ import annotations

import base64
import errno
import json
import os
import time

import cv2
import numpy as np
import pytest
from simulated import simulated

from edge.bus.verbs import Request, read_request
from edge.errors import UserError
from edge.host import checkpoint
from edge.host.checkpoint import CheckpointError
from edge.lab.eval.closed_loop import ClosedLoop
from edge.loop.checkpoints.crop_checkpoint import CropCheckpoint
from edge.loop.requests.intent_requests import carry_out
from edge.loop.requests.memory_requests import MEMORY_VERBS, handle_memory, similar_words
from edge.memory import CropStore
from edge.mission.language.intents import MemoryQuestion
from edge.perception.prior.table import load
from edge.perception.prior.words import PriorWordIndex


@pytest.fixture(scope="module")
def loop():
    small = {"camera": {"width_px": 160, "height_px": 128}}
    data = {"mission": {"target": "bed"}, "sensors": small}
    return ClosedLoop(simulated(data)).run(8)


def ask(loop, payload: str) -> dict:
    do, fields = read_request(payload.encode(), MEMORY_VERBS)
    return handle_memory(loop.service, Request(do, fields), 0)


def test_all_objects_are_listed_with_their_times(loop):
    objects = ask(loop, '{"do": "list"}')["objects"]
    assert objects
    for one in objects:
        assert one["known_s"] >= one["age_s"] >= 0.0
        assert one["came_from"] is None


def test_filters_leave_out_objects(loop):
    objects = ask(loop, '{"do": "list"}')["objects"]
    ages_s = sorted(one["age_s"] for one in objects)
    since_s = ages_s[len(ages_s) // 2]
    newest = ask(loop, f'{{"do": "list", "since_s": {since_s + 0.06}}}')["objects"]
    assert 0 < len(newest) <= len(objects)
    assert all(one["age_s"] <= since_s + 0.06 for one in newest)
    with pytest.raises(UserError, match="no room called crypt is known"):
        ask(loop, '{"do": "list", "room": "crypt"}')
    # The filter by room divides the objects that are in rooms.
    found = []
    for room in ask(loop, '{"do": "rooms"}')["rooms"]:
        inside = ask(loop, json.dumps({"do": "list", "room": f"room {room['id']}"}))["objects"]
        title = room["name"] or " and ".join(room["kinds"]) or f"room {room['id']}"
        assert {one["room"] for one in inside} <= {title}
        found += [one["id"] for one in inside]
    assert sorted(found) == sorted(one["id"] for one in objects if one["room"])
    assert found


def test_similar_objects_are_marked_as_similar(loop):
    answer = ask(loop, '{"do": "find", "name": "countertop"}')
    assert answer["text"].startswith("no countertop has been seen")
    assert "; a table (similar) " in answer["text"]
    assert answer["objects"]


def test_a_similar_object_is_no_yes(loop):
    answer = carry_out(loop.service, MemoryQuestion("exists", "countertop"), 0)
    assert answer.startswith("no countertop has been seen")


VOCABULARY = ["goblet", "cup", "chair"], np.array([(1.0, 0.0), (0.95, 0.312), (0.0, 1.0)], "f4")


@pytest.mark.parametrize(
    ("name", "words", "vocabulary", "similar"),
    [
        ("cup", [], VOCABULARY, []),
        ("goblet", ["chair", "cup"], None, []),
        ("goblet", ["chair", "cup"], VOCABULARY, ["cup"]),
        ("cup", ["wine glass", "chair"], None, ["wine glass"]),
        ("nothing known", ["chair"], VOCABULARY, []),
    ],
)
def test_similar_words_come_from_vocabulary_and_table(name, words, vocabulary, similar):
    class Prior:
        words = PriorWordIndex(load(), vocabulary)

    assert similar_words(name, words, Prior()) == similar
    assert similar_words(name, words, None) == [word for word in similar if word == "wine glass"]


def test_the_picture_of_an_object_is_a_small_jpeg(loop):
    loop.service.map.crops.close()
    ids = [one["id"] for one in ask(loop, '{"do": "list"}')["objects"]]
    with_picture = [i for i in ids if loop.service.map.crops.get(i)]
    assert with_picture
    answer = ask(loop, f'{{"do": "crop", "id": {with_picture[0]}}}')
    jpeg = np.frombuffer(base64.b64decode(answer["jpeg_base64"]), np.uint8)
    assert max(cv2.imdecode(jpeg, cv2.IMREAD_COLOR).shape[:2]) <= 64
    with pytest.raises(UserError, match="no picture of an object 99999"):
        ask(loop, '{"do": "crop", "id": 99999}')


@pytest.mark.parametrize(
    ("payload", "message"),
    [
        ('{"do": "find"}', "name: expected text"),
        ('{"do": "crop"}', "id: expected the id of an object"),
        ('{"do": "crop", "id": true}', "id: expected the id of an object"),
        ('{"do": "list", "since_s": -1}', "since_s: expected seconds"),
        ('{"do": "list", "since_s": "1"}', "since_s: expected seconds"),
        ('{"do": "list", "name": "mug"}', "'name': not a field of do: list"),
        ('{"do": "list", "room": 3}', "room: expected text"),
    ],
)
def test_an_invalid_memory_request_is_refused(payload, message):
    with pytest.raises(ValueError, match=message):
        read_request(payload.encode(), MEMORY_VERBS)


def test_pictures_survive_a_restart(loop, tmp_path):
    path, crops = tmp_path / "mission.json.crops", loop.service.map.crops
    first = CropCheckpoint(path)
    first.save_if_changed(crops, 0)
    first.close(crops)
    again, loaded = CropCheckpoint(path), CropStore()
    again.restore(loaded)
    again.close(loaded)
    assert again.problem == ""
    assert len(loaded) == len(crops) > 0
    path.write_bytes(path.read_bytes()[:-9])
    damaged, empty = CropCheckpoint(path), CropStore()
    damaged.restore(empty)
    damaged.close(empty)
    assert "kept as mission.json.crops.damaged-1" in damaged.problem
    assert len(empty) == 0
    path.write_text("of another program")
    with pytest.raises(CheckpointError):
        CropCheckpoint(path)


def test_pictures_that_could_not_be_written_are_written_later(loop, tmp_path, monkeypatch):
    def write(now_s: float) -> str:
        saved.save_if_changed(crops, int(now_s * 1e9))
        while not saved.writer.idle:
            time.sleep(0.001)
        return saved.writer.problem

    path, crops = tmp_path / "mission.json.crops", loop.service.map.crops
    saved = CropCheckpoint(path)
    with monkeypatch.context() as full_disk:
        full_disk.setattr(checkpoint, "save", raise_disk_full)
        assert write(0.0) == "No space left on device"
    assert write(4.0) == "No space left on device"  # not tried again so soon
    assert write(5.0) == ""
    assert saved.writer.written == 1
    saved.close(crops)


def raise_disk_full(*args) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
