"""The journal's JSON: exact, complete, and as its page says."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from recordings import small
from results import result

import edge
from edge.geometry import SE2, CameraModel, Grid
from edge.loop.behaviours.plan_worker import PlanResult
from edge.loop.input_log import LoopInput
from edge.mapping.regions import OPEN, RegionMap, border_lengths
from edge.memory import NO_SURVEY, LostRoom, Place, Site, survey_rooms
from edge.mission.spec import prepare
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import ImageSimilarity
from edge.recording import journal
from edge.recording.journal import decode_page, encode_page
from edge.tasks.legs import Leg
from edge.tasks.refine import RefinedTrajectory
from edge.tasks.write import PlanAttempt
from edge.types import MASK_SIDE, ContextBoxes, Detections, GoalStatus, Observation

ROOT = Path(edge.__file__).parents[1]
NOTED = re.compile(r"\.note\(\s*\"(\w+)\"")


STOPS = (((1, "car"), (2, "car")), (), ((3, "van"),))


def again(*inputs: LoopInput) -> list[LoopInput]:
    return decode_page(encode_page(inputs, result(), None, {})).entries


SITE = Site((Place.at("dock", SE2(0.1, 0.2, 0.3)),))


def test_all_that_the_loop_notes_is_written_and_documented():
    noted = set()
    for path in (ROOT / "edge" / "loop").glob("*.py"):
        noted |= set(NOTED.findall(path.read_text(encoding="utf-8")))
    page = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
    table = page[page.index("| kind |") :].splitlines()[2:]
    told = {kind for row in table for kind in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert noted == set(journal._ENCODE) == told


START = LoopInput(3, "start", {
    "translation": prepare(small().mission).translation, "mission_checkpoint": None,
    "map_checkpoint": None, "idle": False, "site": SITE,
})  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("tick", {"now_ns": 1}),
        ("images", {"done": 7}),
        ("request", {"worker": "choice"}),
        ("decision", {"name": "elsewhere", "value": ""}),
        ("idle", {"now_ns": 1, "pose": SE2(0.1, 0.2, 0.3)}),
        ("idle", {"now_ns": 1, "pose": None}),
        ("goal_status", {"goal_status": GoalStatus(1, "failed", "stuck\n", (0.1, 0.2))}),
        ("goal_status", {"goal_status": GoalStatus(1, "reached")}),
        ("pause", {"paused": True, "now_ns": 1}),
        ("confirm", {"now_ns": 1}),
        ("fail", {"reason": "because", "now_ns": 1}),
        ("jump", {"now_ns": 1}),
        ("site", {"site": SITE, "now_ns": 1}),
        ("config", {"config": small()}),
        ("mission", {"translation": prepare(small().mission).translation, "id": "a", "now_ns": 1}),
        ("start", START.fields),
    ],
)
def test_an_entry_survives_a_round_trip(kind, fields):
    if "translation" in fields:
        assert again(LoopInput(3, kind, fields))[0].fields["translation"].formula == (
            fields["translation"].formula
        )
    else:
        assert again(LoopInput(3, kind, fields)) == [LoopInput(3, kind, fields)]


FLOATS = arrays(np.float32, st.integers(0, 4), elements=st.floats(width=32))


@given(FLOATS, st.sampled_from([None, "competing_score"]), st.none() | st.integers(0, 2**32 - 1))
def test_detections_survive_a_round_trip_exactly(score, competing_score, masked):
    n = len(score)
    boxes, labels = np.outer(score, np.ones(4, np.float32)), np.arange(n, dtype=np.int32)
    context = ContextBoxes(boxes, score, labels, ("rug",) * n)
    seen = Observation(5, 7, np.eye(4))
    found = Detections(
        seen, boxes, score, labels, ("bed", "sofa"), competing_score and score, context, "model", 9,
        None if masked is None
        else np.random.default_rng(masked).random((n, MASK_SIDE, MASK_SIDE)) < 0.5,
    )  # fmt: skip
    (entry,) = again(LoopInput(0, "result", {"worker": "detector", "result": found}))
    back = journal.detections_of(entry.fields["result"], seen)
    for name in ("xyxy_px", "score", "class_id"):
        for one, other in ((found, back), (found.context, back.context)):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
            assert getattr(one, name).dtype == getattr(other, name).dtype
    assert (back.prompts, back.context.words) == (found.prompts, context.words)
    assert (back.model, back.latency_ns) == ("model", 9)
    assert (back.competing_score is None) == (competing_score is None)
    assert (back.mask is None) == (masked is None)
    if masked is not None:
        np.testing.assert_array_equal(back.mask, found.mask)


def test_background_results_survive_the_journal():
    values = np.array([0.1, np.inf, np.nan], np.float32)
    label = np.repeat(np.array([[1, 2]], np.int16), 20, axis=1).repeat(20, axis=0)
    grid = Grid(np.full(label.shape, OPEN, np.uint8), (0.1, -0.2), 0.1)
    regions = RegionMap(grid, label < 1, label, 2, border_lengths(label, 2))
    rooms = survey_rooms(regions, NO_SURVEY)._replace(lost=(LostRoom(7, 0.1, 0.2),))
    pose, stamp = SE2(0.1, 0.2, 0.3), 5
    what = {
        "travel_cost": values,
        "rooms": rooms,
        "similarity": ("asked", ImageSimilarity(stamp, pose, ("a", "b"), values[:2])),
        "choice": ("asked", FrontierChoice(stamp, "a", (3, 1), values[:2], 0.25, 0.5)),
    }
    entries = again(
        *(
            LoopInput(i, "result", {"worker": w, "result": f})
            for i, (w, f) in enumerate(what.items())
        )
    )
    back = {entry.fields["worker"]: entry.fields["result"] for entry in entries}
    assert (
        journal.decoded(np.ndarray, back["travel_cost"]["distance_m"]).tobytes() == values.tobytes()
    )
    again_rooms = journal.rooms_of(back["rooms"])
    assert again_rooms.regions.grid.origin_xy_m == (0.1, -0.2)
    for one, other in zip(regions[1:], again_rooms.regions[1:], strict=True):
        np.testing.assert_array_equal(one, other)
    assert again_rooms[1:4] == (pytest.approx([0, 1, 2]), 3, ((7, 0.1, 0.2),))
    np.testing.assert_array_equal(again_rooms.depth_m, rooms.depth_m)
    assert [one.doors for one in again_rooms.shapes] == [one.doors for one in rooms.shapes]
    similarity = journal.decoded(ImageSimilarity, back["similarity"])
    assert (similarity.stamp_ns, similarity.pose, similarity.targets) == (stamp, pose, ("a", "b"))
    choice = journal.decoded(FrontierChoice, back["choice"])
    assert (choice.ids, choice.elsewhere, choice.scene) == ((3, 1), 0.25, 0.5)
    assert choice.p.tobytes() == values[:2].tobytes()


def planned(result: PlanResult) -> PlanResult:
    (entry,) = again(LoopInput(0, "result", {"worker": "task", "result": result}))
    return journal.decoded(PlanResult, entry.fields["result"])


def test_all_fields_of_a_plan_survive_a_round_trip():
    values = {
        "refined": None, "error": "no way", "hopeless": True, "ambiguous": (3, 5),
        "coarse_m": np.array([[0.1, 0.2], [1.0, np.nan]]), "speed_mps": 0.4,
        "stops_at": (3, "van"), "stops": STOPS, "grounds": frozenset({"road", "grass"}),
        "n_done": 2, "understood": "go to the van", "prompt": "a prompt",
        "rounds": (PlanAttempt("answer", "code", "printed", "error"),),
    }  # fmt: skip
    assert values.keys() == {field.name for field in fields(PlanResult)}
    back = planned(PlanResult(**values))
    found = {name: getattr(back, name) for name in values}
    assert found.pop("coarse_m").tobytes() == values.pop("coarse_m").tobytes()
    assert [asdict(one) for one in found.pop("rounds")] == [
        asdict(one) for one in values.pop("rounds")
    ]
    assert found == values
    assert isinstance(found["grounds"], frozenset)


def test_a_configuration_of_an_earlier_version_is_read():
    stored = journal.config_text(small())
    stored["perception"]["voxel_m"] = 0.05
    stored["motion"] = {**(stored["motion"] or {}), "stuck_s": 5.0, "clearance_m": 0.1}
    assert journal.config_of(stored).robot == small().robot


def test_a_plan_of_an_earlier_version_is_read():
    (entry,) = again(LoopInput(0, "result", {"worker": "task", "result": PlanResult(error="none")}))
    stored = entry.fields["result"]
    assert stored.pop("grounds") == []
    stored["cost_m"] = 1.0  # of an earlier version
    assert journal.decoded(PlanResult, stored).error == "none"


@given(st.none() | st.floats(-math.pi, math.pi))
def test_a_refined_trajectory_survives_a_round_trip(heading_rad):
    """Asked for at the end, and asked for again whenever it is planned again."""
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    poses = np.column_stack([line, np.zeros(2), [0.0, heading_rad or 0.0]])
    refined = RefinedTrajectory(
        poses, np.array([0.0, 0.0]), np.array([0.0, 2.0]), np.zeros(2, np.int64),
        (Leg(line, True),), frozenset({2, 1}), heading_rad, 0.5, ("a note",),
    )  # fmt: skip
    back = planned(PlanResult(refined)).refined
    assert back.heading_rad == heading_rad
    assert (back.drivable, back.notes) == (refined.drivable, refined.notes)
    for one, other in (
        (back.poses, poses), (back.leg, refined.leg), (back.legs[0].points_m, line),
    ):  # fmt: skip
        assert (one.dtype, one.tobytes()) == (other.dtype, other.tobytes())


def test_mounts_are_written_only_when_they_change():
    camera = CameraModel(40, 30, 30.0, 31.0, 20.0, 15.0)
    written: dict = {}
    read: dict = {}
    told = []
    for k, mount in enumerate((np.eye(4), np.eye(4), 2.0 * np.eye(4))):
        seen = Observation(
            k, k, np.eye(4) / 3.0, camera=camera, T_base_camera=mount, pose_age_ns=7 * k
        )
        page = decode_page(encode_page([], result(observation=seen), seen, written))
        told.append("rig" in page.observation)
        back = journal.observation_of(page.observation, read, None, None, None)
        assert back.T_map_base.tobytes() == seen.T_map_base.tobytes()
        assert back.T_base_camera.tobytes() == mount.tobytes()
        assert (back.camera, back.pose_age_ns) == (camera, 7 * k)
    assert told == [True, False, True]
