"""The verdict on an episode by the ground truth, whatever the service reported."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from small_house import small_house

from edge.lab.eval.ground_truth import (
    GroundTruth,
    GroundTruthLogger,
    objects_meant_by,
)
from edge.lab.sim.worlds import load_world
from edge.types import Goal, Instance, MissionEvent, MissionStatus, Observation

BED = (6.8, 2.0)  # its middle
SECOND_NS = 1_000_000_000


class Stage:
    """Lets a witness see ticks that a test makes up."""

    def __init__(self, tmp_path, targets=("bed",)):
        self.targets = targets
        config = small_house(tmp_path)
        self.world = load_world(config)
        self.logger = GroundTruthLogger(config, self.world, lambda stamp_ns: self._truth)
        self._log = []
        self.tick(0.0)

    def tick(
        self, at_s, xy=(1.0, 2.0), *, shown=(), near_m=2.0, phase="searching", reason="",
        reached=None, instances=(), target="bed", text="",
    ):  # fmt: skip
        """One tick; `shown` are the labels in the picture, `near_m` away."""
        ids = np.zeros((20, 20), np.uint16)
        for k, label in enumerate(shown):
            ids[10 * k : 10 * k + 10] = next(o.id for o in self.world.objects if o.label == label)
        self._truth = GroundTruth(*xy, 0.0, at_s, 0, ids)
        if reached is not None:
            self._log.append(MissionEvent(0, "reached", reached, 0, text))
        seen = Observation(0, int(at_s * SECOND_NS), np.eye(4), depth_m=np.full((20, 20), near_m))
        self.logger.tick(
            SimpleNamespace(
                targets=self.targets,
                goals=(Goal(0, None, "frontier", 0, (0.0, 0.0), 0.0, "bed"),),
                status=MissionStatus(target, phase, reason),
                observation=seen,
                detections=None,
                events=() if reached is None else ("reached",),
                mission=lambda: SimpleNamespace(log=tuple(self._log)),
                instances=lambda: list(instances),
            )
        )

    def failure(self):
        return self.logger.failure("bed")


def instance(number, xy, state="confirmed"):
    center = np.array([*xy, 0.3], np.float32)
    return Instance(number, "bed", center, center[None], 0.9, 9, 0, 0, state)


@pytest.fixture
def stage(tmp_path):
    return Stage(tmp_path)


def test_an_episode_that_reaches_its_object_is_no_failure(stage):
    stage.tick(5.0, shown=["bed"])
    stage.tick(9.0, (5.2, 2.0), phase="reached", reached="bed")
    assert stage.failure() is None
    assert stage.logger.wrong_stops == []


def test_a_stop_far_from_the_object_is_the_wrong_object(stage):
    stage.tick(5.0, shown=["bed"])
    stage.tick(9.0, (2.0, 2.0), phase="reached", reached="bed")
    assert stage.failure() == "wrong thing"
    assert [label for label, _ in stage.logger.wrong_stops] == ["bed"]


@pytest.mark.parametrize("xy", [(5.2, 2.0), (2.0, 2.0)])  # at the bed, and far from it
def test_a_probable_object_counts_as_neither_right_nor_wrong(stage, xy):
    text = "reached: bed (probably, 0.62: bed or sofa)"
    stage.tick(9.0, xy, phase="reached", reached="bed", text=text)
    assert stage.failure() == "probable"
    assert stage.logger.wrong_stops == []


def test_an_object_that_a_person_confirmed_is_judged(stage):
    text = "reached: bed (confirmed by a person)"
    stage.tick(9.0, (2.0, 2.0), phase="reached", reached="bed", text=text)
    assert stage.failure() == "wrong thing"


def test_a_target_never_in_view_counts_as_never_seen(stage):
    stage.tick(5.0, (3.0, 2.0), shown=["sofa"], phase="failed", reason="nothing left to search")
    assert stage.failure() == "never seen"
    assert stage.logger.first_sight() is None


def test_a_target_in_view_counts_as_seen_not_confirmed(stage):
    stage.tick(5.0, (3.0, 2.0), shown=["bed"])
    stage.tick(9.0, (3.0, 2.0), phase="failed", reason="path limit of 100 m")
    assert stage.failure() == "seen, not confirmed"


def test_a_mission_without_an_end_is_out_of_budget(stage):
    stage.tick(9.0, (3.0, 2.0))
    assert stage.failure() == "budget"


def test_a_minute_in_one_place_is_stuck(stage):
    stage.tick(30.0, (3.0, 2.0))
    stage.tick(95.0, (3.4, 2.0), phase="failed", reason="time limit of 95 s")
    assert stage.logger.stuck_s == pytest.approx(65.0)
    assert stage.failure() == "stuck"


def test_a_confirmed_object_that_was_given_up_counts_as_stuck(stage):
    stage.tick(5.0, (3.0, 2.0), shown=["bed"], instances=[instance(1, BED)])
    stage.tick(9.0, (5.0, 2.0), phase="failed", reason="no way to it")
    assert stage.failure() == "stuck"


@pytest.mark.parametrize(("near_m", "seen"), [(2.0, True), (6.0, True), (6.1, False)])
def test_an_object_counts_as_seen_within_the_detectors_range(stage, near_m, seen):
    stage.tick(5.0, shown=["bed"], near_m=near_m)
    stage.tick(7.0, shown=["bed"], near_m=2.0)
    assert stage.logger.first_sight().seconds == (5.0 if seen else 7.0)


def test_an_error_of_its_own_is_kept(stage):
    stage.logger._truth = None
    with pytest.raises(TypeError):
        stage.tick(1.0)
    assert isinstance(stage.logger.fault, TypeError)


def test_targets_are_matched_by_name_or_noun(tmp_path):
    world = load_world(small_house(tmp_path))
    for target in ("bed", "double bed", "soft red bed"):
        assert [o.label for o in objects_meant_by(world, target)] == ["bed"]
    assert objects_meant_by(world, "unicorn") == []


@pytest.mark.parametrize(
    ("target", "labels"),
    [
        ("chair", ["chair", "armchair"]),
        ("armchair", ["armchair"]),
        ("table", ["desk", "dining table"]),
        ("red table", ["desk", "dining table"]),
        ("sofa", []),
    ],
)
def test_narrower_kinds_count_as_for_the_service(target, labels):
    things = [SimpleNamespace(label=name) for name in ("chair", "armchair", "desk", "dining table")]
    world = SimpleNamespace(objects=things)
    assert [thing.label for thing in objects_meant_by(world, target)] == labels


def test_area_seen_by_an_earlier_search_counts_as_revisited(tmp_path):
    stage = Stage(tmp_path, ("bed", "sofa"))
    assert stage.logger.revisited_m2 == 0.0
    stage.tick(1.0, target="sofa")
    seen_m2 = stage.logger.revisited_m2
    assert seen_m2 > 1.0
    stage.tick(2.0, target="sofa")
    assert stage.logger.revisited_m2 == seen_m2


def test_driving_to_a_known_object_counts_no_revisits(tmp_path):
    stage = Stage(tmp_path, ("sofa", "bed"))
    stage.tick(1.0, target="sofa")
    before_m2 = stage.logger.revisited_m2
    stage.tick(2.0, target="bed", instances=[instance(1, BED)])
    assert stage.logger.revisited_m2 == before_m2
