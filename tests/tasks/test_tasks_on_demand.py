"""Detection of a new name on the frame at hand."""

from __future__ import annotations

from contextlib import contextmanager

import numpy as np
import pytest
from scans import Box, found_in
from scans import street as seen_street

from edge.config import TrajectoryLimits
from edge.errors import UserError
from edge.tasks.functions import MOST_DETECTIONS, CallError, ScriptFunctions
from edge.tasks.scene.ground import ground_of
from edge.tasks.scene.on_demand import FrameDetector
from edge.tasks.scene.pipeline import PerceptionPipeline
from edge.tasks.scene.scene_builder import SceneBuilder

CAR = Box(14.0, 4.0, colour=(30, 30, 200))
BIN = Box(8.0, -3.0, (0.8, 0.8, 1.2), label="trash can", colour=(30, 160, 30))
OBSERVATION, _ = seen_street([CAR, BIN])


def detector(*boxes, names_asked=None):
    """Return a detector of made boxes, and a scene without objects."""

    def find(observation, tags):
        if names_asked is not None:
            names_asked.append(tuple(tags))
        return found_in(observation, [CAR, BIN]).only(np.arange(len(boxes)))

    pipeline = PerceptionPipeline(lambda _: (), find, lambda found: found)

    @contextmanager
    def opened(name):
        if name == "zeppelin":
            raise UserError("the vocabulary has no word 'zeppelin'")
        yield pipeline

    return FrameDetector(OBSERVATION, opened, 0.5, 40.0)


@pytest.fixture(scope="module")
def scene():
    """Return the scene in which only cars were looked for."""
    found = found_in(OBSERVATION, [CAR, BIN]).only(np.array([0]))
    builder = SceneBuilder(
        PerceptionPipeline(lambda _: ("car",), lambda *_: found, lambda found: found)
    )
    builder.add(OBSERVATION)
    return builder.scene()


def functions(scene, detect=None):
    limits = TrajectoryLimits()
    return ScriptFunctions(ground_of(scene, limits.clearance_m), limits, detect=detect)


def test_without_a_detector_nothing_new_is_found(scene):
    assert functions(scene).det_object("trash can") == []


def test_nothing_of_the_name_is_in_the_picture(scene):
    assert functions(scene, detector()).det_object("trash can") == []


def test_a_new_name_is_detected_only_once(scene):
    asked = []
    calls = functions(scene, detector(CAR, BIN, names_asked=asked))
    (found,) = calls.det_object("trash can")
    assert asked == [("trash can",)]
    assert found["id"] == 2
    assert found["caption"].startswith("green trash can")
    assert found["position"][:2] == pytest.approx((BIN.x_m, BIN.y_m), abs=0.5)
    assert found["size"][2] == pytest.approx(1.2, abs=0.3)
    assert found["nearest_reachable"]["1"] == found["nearest_reachable"][1]
    assert len(calls.ground.scene.contours[2]) == 1
    assert calls.det_object("trash can") == [found]
    stop = calls.stopping_point(2)
    assert 0.3 < np.hypot(stop[0] - BIN.x_m, stop[1] - BIN.y_m) < 2.0
    calls.give_trajectory([calls.a_star_plan((0.0, 0.0), stop, ["1"])], ["1"])
    assert asked == [("trash can",)]
    assert 2 not in scene.objects


def test_known_objects_are_not_detected_again(scene):
    asked = []
    (car,) = functions(scene, detector(CAR, BIN, names_asked=asked)).det_object("car")
    assert (car["id"], asked) == (1, [])


def test_an_unknown_word_is_a_call_error(scene):
    with pytest.raises(CallError, match="det_object: the vocabulary has no word 'zeppelin'"):
        functions(scene, detector()).det_object("zeppelin")


def test_names_to_detect_are_limited(scene):
    calls = functions(scene, detector())
    for k in range(MOST_DETECTIONS):
        assert calls.det_object(f"thing{'abcd'[k]}") == []
    with pytest.raises(CallError, match="4 new names were detected already"):
        calls.det_object("kite")
