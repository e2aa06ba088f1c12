"""State of the live sink, and its cost without a viewer."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from results import observation, result
from task_facts import driving, looking

from edge.geometry import SE2, CameraModel
from edge.live.sink import PERIOD_S, WATCHED_S, LiveSink
from edge.loop.result import ScoredCandidates
from edge.memory import Place, Site
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import FRONTIER, INSTANCE
from edge.types import ContextBoxes, Detections, Observation

SITE = Site((Place("dock", SE2(1.0, 2.0, 0.0)),))
DEAR = ("mission", "task", "instances", "objects", "candidates", "path", "layers", "parts")
CAMERA = CameraModel.from_hfov(40, 30, 1.2)
T_BASE_CAMERA = np.array([[0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1.0]])


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def sink(clock) -> LiveSink:
    return LiveSink(clock)


def seen(rgb: np.ndarray, **fields: Any) -> Observation:
    return replace(observation(1), rgb=rgb, camera=CAMERA, T_base_camera=T_BASE_CAMERA, **fields)


def test_before_the_first_tick_there_is_nothing(sink):
    assert (sink.snapshot, sink.shots, sink.ticked_s) == (None, {}, None)
    sink.mark_watched()
    sink.close()
    assert sink.snapshot is None


def test_without_viewers_nothing_expensive_is_requested(sink, clock):
    dear = {name: lambda: pytest.fail("gathered for nobody") for name in DEAR}
    rgb = np.zeros((30, 40, 3), np.uint8)
    sink.tick(result(observation=seen(rgb), **dear))
    assert (sink.snapshot, sink.shots) == (None, {})
    assert sink.ticked_s == clock.now_s
    sink.mark_watched()
    clock.now_s += WATCHED_S + 0.1
    sink.tick(result(**dear))


def test_with_viewers_data_are_collected_once_per_period(sink, clock):
    sink.mark_watched()
    gathered = []
    for _ in range(11):
        sink.tick(result(path=lambda: gathered.append(clock.now_s) or np.zeros((0, 2))))
        clock.now_s += PERIOD_S / 5
    assert len(gathered) == 3


@pytest.mark.parametrize("of", ["objects", "layers", "parts"])
def test_expensive_data_are_collected_once_per_second(sink, clock, of):
    sink.mark_watched()
    gathered = []
    for _ in range(20):
        sink.mark_watched()
        sink.tick(result(**{of: lambda: gathered.append(clock.now_s) or {}}))
        clock.now_s += PERIOD_S
    assert len(gathered) == 4


def test_the_site_has_a_version(sink, clock):
    sites = []
    for site in (Site(), SITE, SITE, Site(SITE.items)):
        for _ in range(5):
            sink.mark_watched()
            sink.tick(result(site=site))
            clock.now_s += PERIOD_S
        sites.append(sink.snapshot.n_sites)
    assert sites == [1, 2, 2, 3]


def test_boxes_are_shown_with_their_own_image(sink):
    sink.mark_watched()
    found, newest = (seen(np.full((30, 40, 3), v, np.uint8)) for v in (7, 9))
    around = ContextBoxes(
        np.array([[0, 0, 40, 30]], np.float32), np.ones(1, np.float32), np.zeros(1, np.int32),
        ("rug",),
    )  # fmt: skip
    detections = Detections(
        found, np.array([[10, 15, 20, 30]], np.float32), np.array([0.5], np.float32),
        np.zeros(1, np.int32), ("chair",), context=around,
    )  # fmt: skip
    sink.tick(result(observation=newest, detections=detections))
    assert sink.shots[0].rgb.max() == 7
    chair, rug = sink.shots[0].boxes
    assert (chair.label, chair.wanted, chair.xyxy) == ("chair", True, (0.25, 0.5, 0.5, 1.0))
    assert (rug.label, rug.wanted, rug.xyxy) == ("rug", False, (0.0, 0.0, 1.0, 1.0))


def test_each_camera_has_its_newest_image_at_its_own_pace(sink, clock):
    """The cameras take turns; only the second one's images go through the detector."""
    sink.mark_watched()
    empty = np.zeros((0, 4), np.float32), np.zeros(0, np.float32), np.zeros(0, np.int32)
    seqs = []
    for value in range(1, 9):
        rgb = np.full((30, 40, 3), value, np.uint8)
        newest = seen(rgb, camera_index=1 - value % 2)
        found = Detections(newest, *empty, ("chair",)) if newest.camera_index else None
        sink.tick(result(observation=newest, detections=found))
        seqs.append({i: shot.seq for i, shot in sink.shots.items()})
        clock.now_s += 0.55 * PERIOD_S
    assert seqs[:3] == [{0: 1}, {0: 1, 1: 2}, {0: 3, 1: 2}]
    assert {i: shot.rgb.max() for i, shot in sink.shots.items()} == {0: 7, 1: 8}


def test_letters_are_drawn_on_frontiers_that_still_exist(sink):
    """One frontier is two metres ahead; the others are gone or out of view."""
    sink.mark_watched()
    there = ScoredCandidates(
        np.array([FRONTIER, FRONTIER, INSTANCE], np.int8), np.array([5, 6, 7]),
        np.array([[2, 0], [-2, 0], [2, 0]], np.float32), np.ones(3, np.float32),
        np.ones(3, np.float32), np.zeros(3, np.bool_),
    )  # fmt: skip
    choice = FrontierChoice(
        1, "chair", (9, 5, 6, 7), np.array([0.1, 0.2, 0.3, 0.4], np.float32), 0.0, 1.0
    )
    rgb = np.zeros((30, 40, 3), np.uint8)
    sink.tick(result(observation=seen(rgb), choice=choice, candidates=lambda: there))
    ((letter, u, v),) = sink.shots[0].marks
    assert (letter, u) == ("B", pytest.approx(0.5, abs=0.02))
    assert 0.5 < v < 1.0
    assert sink.snapshot.mark_letters[6] == ("C", pytest.approx(0.3))


def test_the_version_of_a_task_does_not_change_by_driving(sink, clock):
    sink.mark_watched()
    numbers = []
    for task in (None, looking(), driving(0), driving(50), driving(50, phase="reached"), None):
        clock.now_s += PERIOD_S
        sink.tick(result(task=lambda task=task: task))
        numbers.append(sink.snapshot.n_tasks)
    assert numbers == [0, 1, 2, 2, 3, 4]
