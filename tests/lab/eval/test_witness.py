"""The verdict on an episode by the ground truth, whatever the service reported."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from small_house import small_house

from edge.lab.eval.ground_truth import GroundTruth, GroundTruthLogger, objects_meant_by
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


AWAY, AT_BED, SEEN = {"xy": (2.0, 2.0)}, {"xy": (5.2, 2.0)}, {"shown": ["bed"]}
REACHED = {"phase": "reached", "reached": "bed"}
PROBABLY = "reached: bed (probably, 0.62: bed or sofa)"
FAILED = {"phase": "failed", "reason": "nothing left to search"}


@pytest.mark.parametrize(
    ("ticks", "failure", "wrong_stops"),
    [
        ([SEEN, {**AT_BED, **REACHED}], None, 0),
        ([SEEN, {**AWAY, **REACHED}], "wrong thing", 1),
        # A probable object is neither right nor wrong, unless a person confirmed it.
        ([{**AT_BED, **REACHED, "text": PROBABLY}], "probable", 0),
        ([{**AWAY, **REACHED, "text": PROBABLY}], "probable", 0),
        ([{**AWAY, **REACHED, "text": "reached: bed (confirmed by a person)"}], "wrong thing", 1),
        ([{**SEEN, "shown": ["sofa"], **FAILED}], "never seen", 0),
        ([SEEN, FAILED], "seen, not confirmed", 0),
        ([{"at_s": 9.0}], "budget", 0),
        ([{**SEEN, "instances": [instance(1, BED)]}, {**AT_BED, **FAILED}], "stuck", 0),
    ],
    ids=["right", "wrong", "probably right", "probably wrong", "confirmed by a person", "hidden",
         "unconfirmed", "endless", "given up"],
)  # fmt: skip
def test_an_episode_is_judged_by_its_ticks(stage, ticks, failure, wrong_stops):
    for k, tick in enumerate(ticks):
        stage.tick(**{"at_s": 5.0 + 4.0 * k, **tick})
    assert stage.failure() == failure
    assert [label for label, _ in stage.logger.wrong_stops] == ["bed"] * wrong_stops


def test_a_minute_in_one_place_is_stuck(stage):
    stage.tick(30.0, (3.0, 2.0))
    stage.tick(95.0, (3.4, 2.0), phase="failed", reason="time limit of 95 s")
    assert stage.logger.stuck_s == pytest.approx(65.0)
    assert stage.failure() == "stuck"


@pytest.mark.parametrize(("near_m", "seen"), [(2.0, True), (6.0, True), (6.1, False)])
def test_an_object_counts_as_seen_within_the_detectors_range(stage, near_m, seen):
    stage.tick(5.0, shown=["bed"], near_m=near_m)
    assert (stage.logger.first_sight() is not None) == seen
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
    objects = [
        SimpleNamespace(label=name) for name in ("chair", "armchair", "desk", "dining table")
    ]
    world = SimpleNamespace(objects=objects)
    assert [obj.label for obj in objects_meant_by(world, target)] == labels
