"""Recorder of a run for the report: bounded, cheap, with the right frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from results import result
from simulated import simulated

from edge.geometry import SE2
from edge.lab.report import story
from edge.lab.report.record import RunRecord
from edge.lab.report.recorder import ReportRecorder, detector_name
from edge.live.trail import STEP_M, DrivenPath
from edge.loop.result import Event, mission_facts
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.types import Detections, MissionStatus, Observation

S = 1_000_000_000
MS = 1_000_000


def make(frames: int = 8) -> ReportRecorder:
    return ReportRecorder(simulated(), frames)


def finish(recorder: ReportRecorder, target: str = "chair", **more: object) -> RunRecord:
    return recorder.record(result(status=MissionStatus(target, "reached"), **more), {})


def drive(recorder: ReportRecorder, stamp_ns: int, x_m: float, yaw_rad: float = 0.0) -> None:
    pose = SE2(x_m, 0.0, yaw_rad).matrix()
    recorder.tick(result(observation=Observation(0, stamp_ns, pose)))


def show(recorder: ReportRecorder, detections: Detections, *targets: str) -> None:
    recorder.tick(
        result(detections=detections, targets={name: name for name in targets or ("chair",)})
    )


def seen(stamp_ns: int, scores: dict[str, float], size: tuple[int, int] = (16, 20)) -> Detections:
    rgb = np.full((*size, 3), stamp_ns // S % 200, np.uint8)
    boxes = np.tile(np.array([2, 4, 8, 12], np.float32), (len(scores), 1))
    score = np.array(list(scores.values()), np.float32)
    class_id = np.arange(len(scores), dtype=np.int32)
    return Detections(
        Observation(0, stamp_ns, np.eye(4), rgb=rgb), boxes, score, class_id, tuple(scores)
    )


def test_empty():
    record = finish(make())
    assert record.trajectory.shape == (0, 3)
    assert record.frontiers_m.shape == (0, 2)
    assert (record.frames, record.goals, record.events) == ((), (), ())
    assert record.title == "Find the chair"


def test_trajectory_keeps_steps_and_counts_from_the_start():
    recorder = make()
    for k in range(100):  # 1 cm each 10 ms: every fifth is 5 cm on
        drive(recorder, 5 * S + k * 10 * MS, 0.0100001 * k, 0.25)
    record = finish(recorder)
    np.testing.assert_allclose(record.trajectory[:, 0], np.arange(0, 100, 5) * 0.01, atol=1e-4)
    np.testing.assert_allclose(record.trajectory_t_s, np.arange(0, 100, 5) * 0.01, atol=1e-9)
    np.testing.assert_array_equal(record.trajectory[:, 2], 0.25)


@given(n=st.integers(1, 900), capacity=st.integers(4, 40))
def test_a_path_of_any_length_is_thinned_to_the_capacity(n, capacity):
    trail = DrivenPath(capacity)
    for k in range(n):
        trail.append(k * S, SE2(float(k), 0.0, 0.0))
    poses, stamps_ns = trail.arrays()
    assert 1 <= len(poses) <= capacity
    np.testing.assert_array_equal(poses[:, 0], stamps_ns // S)
    gaps = np.diff(poses[:, 0])
    assert poses[0, 0] == 0
    assert (gaps > 0).all()
    assert n - 1 - poses[-1, 0] < max(1.0, STEP_M * trail._stride), "within a step of the end"


def test_surplus_events_are_only_counted():
    recorder = make()
    for k in range(2000):
        recorder.tick(result(events=(Event(k, f"{k}"),)))
    record = finish(recorder)
    assert len(record.events) == 500
    assert record.counters["events not shown"] == 1500


def test_frames_are_spaced_and_copied():
    recorder = make()
    shared = seen(0, {"chair": 0.5})
    show(recorder, shared)
    shared.observation.rgb[:] = 255
    shared.xyxy_px[:] = -1
    for k in range(1, 30):  # no better, within the second
        show(recorder, seen(k * S // 30, {"chair": 0.5}))
    show(recorder, seen(S, {"sofa": 0.5}))
    frames = finish(recorder).frames
    assert [f.stamp_ns for f in frames] == [0, S]
    assert frames[0].rgb.max() == 0
    np.testing.assert_array_equal(frames[0].xyxy_px, [[2, 4, 8, 12]])
    assert (frames[0].target_score, frames[1].target_score) == (0.5, 0.0)


@pytest.mark.parametrize("frames", [0, 1, 2])
def test_few_or_no_frames_wanted(frames):
    recorder = make(frames)
    for k in range(6):
        show(recorder, seen(k * S, {"chair": 0.1 * k}))
    show(recorder, Detections(Observation(0, 9 * S, np.eye(4)), *[np.zeros(0)] * 3, ("chair",)))
    assert len(finish(recorder).frames) == frames


def test_another_word_for_the_target_is_the_target():
    recorder = make()
    show(recorder, seen(0, {"sofa": 0.7, "chair": 0.9}), "couch")
    record = finish(recorder, "couch")
    assert record.frames[0].is_target.tolist() == [True, False]
    assert record.is_target("sofas")
    assert not record.is_target("chair")


def test_each_target_has_its_best_view():
    """One target is seen well in many images; another only once, and badly."""
    recorder = make(frames=4)
    for k in range(12):
        scores = {"chair": 0.9 - 0.01 * k, "sofa": 0.3} if k == 5 else {"chair": 0.8}
        show(recorder, seen(k * S, scores), "chair", "sofa")
    frames = finish(recorder).frames
    assert [f.stamp_ns // S for f in frames if "sofa" in f.best] == [5]
    assert next(iter(frames[0].best.values())) == pytest.approx(0.85)
    assert [f.stamp_ns // S for f in frames[-2:]] == [10, 11]


def under_way(formula: str) -> MissionRun:
    config = simulated().mission
    run = MissionRun(prepare(config, formula=formula), config)
    run.start(0)
    return run


def told_of(run: MissionRun) -> RunRecord:
    return finish(make(), mission=lambda: mission_facts(run))


def left_to_reach(record: RunRecord) -> str:
    _, found, after = story.section(record).partition("<dt>left to reach</dt><dd>")
    return after.partition("</dd>")[0] if found else ""


def test_the_record_of_a_running_mission():
    run = under_way("F(chair & F sofa) & (!bed W sofa)")
    run.on_reached("seen in 9 images", S)
    record = told_of(run)
    assert left_to_reach(record) == "sofa"
    assert [step.label for step in record.reached] == ["chair"]
    assert [step.kind for step in record.steps] == ["start", "target", "reached", "target"]
    assert not record.has_single_target


def test_a_failed_mission_lists_the_targets_left():
    run = under_way("F(chair & F sofa)")
    run.finish("failed", "time limit of 45 s", S)
    assert left_to_reach(told_of(run)) == "chair, then sofa"


@pytest.mark.parametrize(
    ("detector", "words"),
    [
        ({"kind": "sim"}, "no neural network"),
        ({"kind": "onnx", "model": "m1"}, "m1 on CPUExecutionProvider"),
    ],
)
def test_the_report_names_the_detector(detector, words):
    assert words in detector_name(simulated({"perception": {"detector": detector}}))


def test_the_record_knows_the_configuration_but_no_secret():
    translator = {"kind": "llm", "url": "https://me:s3cret@host/v1?key=s3cret"}
    record = finish(ReportRecorder(simulated({"mission": {"translator": translator}})))
    assert record.config["mission"]["translator"]["url"] == "https://host/v1?***"
