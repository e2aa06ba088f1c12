"""Report of the directions that a model chose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from results import result
from simulated import simulated

from edge.geometry import CameraModel, Grid, se3, to_optical
from edge.lab.report import choices
from edge.lab.report.recorder import ReportRecorder
from edge.loop.result import VALUE_LAYER, ScoredCandidates
from edge.perception.scoring.choice.question import FrontierChoice
from edge.policies.base import FRONTIER
from edge.types import Observation

S = 1_000_000_000


def looking(stamp_ns: int) -> Observation:
    """From 0.6 m above the floor ahead, along x."""
    model = CameraModel.from_hfov(320, 256, 1.3)
    rgb = np.zeros((256, 320, 3), np.uint8)
    T_base_camera = to_optical(se3(0.1, 0.0, 0.6))
    return Observation(
        0, stamp_ns, np.eye(4), rgb=rgb, camera=model, T_base_camera=T_base_camera
    )  # fmt: skip


def frontiers(*xy_m: tuple[float, float]) -> ScoredCandidates:
    n = len(xy_m)
    ids, zeros = np.arange(n, dtype=np.int64), np.zeros(n, np.float32)
    kind = np.full(n, FRONTIER, np.int8)
    xy = np.array(xy_m, np.float32).reshape(-1, 2)
    return ScoredCandidates(kind, ids, xy, zeros, zeros, zeros.astype(bool))


def answered(stamp_ns: int, *xy_m: tuple[float, float]):
    """Return a tick with an answer about the view ahead."""
    p = np.full(len(xy_m), 0.8 / max(1, len(xy_m)), np.float32)
    choice = FrontierChoice(stamp_ns, "bed", tuple(range(len(xy_m))), p, 0.2, 0.75)
    seen = looking(stamp_ns)
    return result(observation=seen, choice=choice, candidates=lambda: frontiers(*xy_m))


def record_of(*ticks, frames: int = 4, **end):
    recorder = ReportRecorder(simulated(), frames)
    for tick in ticks:
        recorder.tick(tick)
    return recorder.record(result(**end), {})


def test_a_frontier_behind_the_robot_is_not_asked_about():
    assert record_of(answered(S, (-4.0, 0.0))).asked == ()


def test_answers_are_kept_once_and_up_to_a_limit():
    tick = answered(S, (4.0, 0.0))
    assert len(record_of(tick, tick, tick).asked) == 1
    many = [answered(k * 3 * S, (4.0, 0.0)) for k in range(1, 60)]
    stamps = [one.stamp_ns for one in record_of(*many, frames=4).asked]
    assert 2 <= len(stamps) <= 4
    assert stamps == sorted(stamps)
    assert stamps[-1] - stamps[0] > 60 * S
    assert record_of(*many, frames=0).asked == ()


def test_the_page_shows_escaped_answers_and_value_maps():
    cells = np.zeros((30, 40), np.uint8)
    cells[10:20, 5:15] = 200
    layers = {
        VALUE_LAYER + "<bed>": lambda: Grid(cells, (0.0, 0.0), 0.1),
        VALUE_LAYER + "sofa": lambda: Grid(np.zeros((3, 3), np.uint8), (0.0, 0.0), 0.1),
        "looked at": lambda: Grid(cells, (0.0, 0.0), 0.1),
    }
    record = record_of(answered(S, (4.0, 0.0)), layers=lambda: layers)
    assert set(record.values) == {VALUE_LAYER + "<bed>", VALUE_LAYER + "sofa"}
    page = choices.section(replace(record, start_ns=0))
    assert "1.0 s, bed: A 0.80 · elsewhere 0.20; scene 0.75" in page
    assert "value of &lt;bed&gt;" in page
    assert "value of sofa" not in page  # it has no scores
    assert 'viewBox="0 0 10 10"' in page  # the known cells
