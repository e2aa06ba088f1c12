"""A made-up run: a furnished flat, the path of a robot and its detections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from results import facts, result
from simulated import simulated
from task_facts import LIMITS, driving

from edge.geometry import SE2, Grid
from edge.host.calibration import SpeedCalibration
from edge.lab.report.record import RunRecord
from edge.lab.report.recorder import ReportRecorder
from edge.loop.latency import LatencyRing
from edge.loop.result import Event, MissionFacts
from edge.loop.stages import STAGES
from edge.mission.logic.automaton import compile_formula
from edge.mission.logic.ltl import parse as parse_ltl
from edge.mission.planning.plan import DEAD
from edge.mission.translate import Translation
from edge.tasks.facts import TaskStatus
from edge.tasks.refine import refine
from edge.tasks.scene.scene import Region, Scene
from edge.tasks.scene.value_map import PathMargins
from edge.types import Detections, Goal, Instance, MissionEvent, MissionStatus, Observation

MS = 1_000_000
S = 1_000_000_000
RESOLUTION_M = 0.05
WALLS = (
    (0, 0, 9, 0.15), (0, 6.85, 9, 7), (0, 0, 0.15, 7), (8.85, 0, 9, 7),
    (4.4, 0, 4.55, 2.2), (4.4, 3.2, 4.55, 7), (4.55, 3.6, 6.2, 3.75), (7.2, 3.6, 9, 3.75),
)  # fmt: skip
FURNITURE = {
    "sofa": (0.3, 4.6, 1.2, 6.5), "dining table": (2.2, 1.0, 3.6, 1.9), "tv": (3.9, 4.8, 4.3, 6.0),
    "bed": (6.9, 0.4, 8.7, 2.2), "chair": (5.0, 5.6, 5.5, 6.1), "desk": (7.6, 4.4, 8.7, 6.2),
}  # fmt: skip
WAY = (
    (1.0, 1.0),
    (1.4, 3.0),
    (2.6, 3.2),
    (3.6, 2.7),
    (5.4, 2.6),
    (6.6, 3.2),
    (6.7, 4.6),
    (6.3, 5.5),
)


def flat() -> Grid:
    """Nine by seven metres with walls and furniture; one room's end not yet seen."""
    h, w = int(10 / RESOLUTION_M), int(12 / RESOLUTION_M)
    cells = np.full((h, w), -1, dtype=np.int8)

    def fill(box: tuple[float, ...], value: int) -> None:
        x0, y0, x1, y1 = (round((v + 1.5) / RESOLUTION_M) for v in box)
        cells[y0:y1, x0:x1] = value

    fill((0.1, 0.1, 8.9, 6.9), 0)
    for wall in WALLS:
        fill(wall, 100)
    for x0, y0, x1, y1 in FURNITURE.values():
        fill((x0 + 0.15, y0 + 0.15, x1, y1), -1)
        fill((x0, y0, x1, y0 + 0.15), 100)
        fill((x0, y0, x0 + 0.15, y1), 100)
    fill((7.9, 0, 9.5, 3.4), -1)
    return Grid(cells, (-1.5, -1.5), RESOLUTION_M)


def image(rng: np.random.Generator) -> np.ndarray:
    rgb = np.zeros((256, 320, 3), dtype=np.uint8)
    rgb[:150] = (196, 188, 176)
    rgb[150:] = (142, 110, 80)
    x, y = int(rng.integers(60, 200)), int(rng.integers(90, 130))
    rgb[y : y + 90, x : x + 70] = rng.integers(40, 220, 3)
    return rgb


def detections(stamp_ns: int, rng: np.random.Generator, target_score: float) -> Detections:
    x, y = float(rng.integers(60, 200)), float(rng.integers(90, 130))
    boxes = np.array([[x, y, x + 70, y + 90], [10, 40, 60, 200]], dtype=np.float32)
    score = np.array([target_score, 0.3], dtype=np.float32)
    seen = Observation(0, stamp_ns, np.eye(4), rgb=image(rng))
    return Detections(seen, boxes, score, np.array([0, 1], np.int32), ("chair", "sofa"), "demo", 9)


def instance(number: int, label: str, score: float, state: str = "tentative") -> Instance:
    x0, y0, x1, y1 = FURNITURE[label]
    along = np.linspace(0, 1, 12, dtype=np.float32)
    front = np.stack([x0 + along * (x1 - x0), np.full(12, y0), np.full(12, 0.4)], axis=1)
    side = np.stack([np.full(12, x0), y0 + along * (y1 - y0), np.full(12, 0.4)], axis=1)
    points = np.concatenate([front, side]).astype(np.float32)
    center = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.4], dtype=np.float32)
    return Instance(number, label, center, points, score, 9, S, 9 * S, state)


def drive(recorder: ReportRecorder) -> int:
    """Move along `WAY` at 0.4 m/s; returns the last stamp."""
    stamp_ns = 0
    for (x0, y0), (x1, y1) in pairwise(WAY):
        length, yaw = math.hypot(x1 - x0, y1 - y0), math.atan2(y1 - y0, x1 - x0)
        for s in np.arange(0, length, 0.4 / 30):
            f = s / length
            pose = SE2(x0 + f * (x1 - x0), y0 + f * (y1 - y0), yaw)
            recorder.tick(result(observation=Observation(0, stamp_ns, pose.matrix())))
            stamp_ns += S // 30
    return stamp_ns


def latency() -> LatencyRing:
    rng = np.random.default_rng(3)
    ring = LatencyRing(calibration=SpeedCalibration("m", 1.0, {}))
    for _ in range(800):
        ring.begin_tick(0)
        spent = 0
        for i, stage in enumerate(STAGES):
            duration = int(stage.budget_ms * MS * (0.35 + 0.12 * rng.standard_gamma(1.6)))
            ring.span(i, duration)
            spent += duration if stage.in_tick else 0
        ring.end_tick(spent)
    ring.set_drops(0, 4)
    return ring


def flat_run(phase: str = "reached", reason: str = "") -> RunRecord:
    rng = np.random.default_rng(0)
    recorder = ReportRecorder(
        simulated({"robot": {"name": "demo"}, "mission": {"target": "chair"}})
    )
    end_ns = drive(recorder)
    for i, (x, y) in enumerate(WAY[1:-1]):
        pose = SE2(x, y, 0.5)
        goal = Goal(i * 4 * S, pose, "frontier", i, (x + 0.5, y + 0.4), 0.4, "chair")
        recorder.tick(result(goals=(goal,)))
    at = SE2(*WAY[-1], 2.8)
    goal = Goal(23 * S, at, "instance", 4, (5.3, 5.7), 0.9, "chair")
    recorder.tick(result(goals=(goal,)))
    for k in range(0, end_ns // S):
        recorder.tick(result(detections=detections(k * S, rng, float(rng.uniform(0.05, 0.9)))))
    frontiers = np.array([(7.85, y) for y in np.arange(0.5, 3.3, 0.3)], dtype=np.float32)
    found = [instance(i, name, 0.4 + 0.07 * i) for i, name in enumerate(FURNITURE)]
    found[4] = instance(4, "chair", 0.83, "reached")
    end = result(
        status=MissionStatus("chair", phase, reason, end_ns / S, 14.2),
        events=(
            Event(0, "searching for chair"),
            Event(22 * S, "approaching chair 4 (score 0.71)"),
            Event(end_ns, f"{phase} chair"),
        ),
        latency=latency().report,
        snapshot=lambda inflated: flat(),
        frontiers=lambda: frontiers,
        instances=lambda: found,
    )
    return replace(
        recorder.record(end, {"frames dropped": 3, "bad messages": 0}), mission_facts=None
    )


STORY = (
    (0.0, "start", "", "mission: go to the chair or the sofa, then to the tv"),
    (0.0, "target", "sofa", "target: sofa: nothing of the plan is seen, first of the formula"),
    (2.0, "seen", "bed", "seen: bed"),
    (6.0, "seen", "chair", "seen: chair"),
    (6.0, "target", "chair", "target: chair: it was seen, and the sofa was not"),
    (9.0, "warning", "bed", "will stop 0.6 m from bed, which must not be reached now"),
    (12.0, "failed", "chair", "failed: chair (stuck)"),
    (12.0, "target", "sofa", "target: sofa: the chair failed"),
    (15.0, "seen", "sofa", "seen: sofa"),
    (19.0, "reached", "sofa", "reached: sofa (seen in 9 images)"),
    (19.0, "target", "tv", "target: tv: all that is left"),
    (24.0, "reached", "tv", "reached: tv (seen in 7 images)"),
    (24.0, "end", "", "reached: sofa, then tv"),
)
FORMULA = "F((chair | sofa) & F tv) & (!bed W tv)"


def story_of(
    formula: str,
    word: tuple[str, ...] = (),
    steps: Sequence[tuple[float, str, str, str]] = (),
    instruction: str = "go there",
) -> MissionFacts:
    """Return the log of a mission given as a formula; steps are (seconds, kind, label, text)."""
    parsed = parse_ltl(formula)
    automaton = compile_formula(parsed)
    spec = replace(
        facts().spec, automaton=automaton, targets=automaton.propositions,
        translation=Translation(instruction, parsed, "in words", "ltl"),
    )  # fmt: skip
    log = tuple(
        MissionEvent(round(t_s * S), kind, label, 0, text)  # the states are not looked at
        for t_s, kind, label, text in steps
    )
    return replace(facts(), spec=spec, state=automaton.run(word), trace=word, plan=DEAD, log=log)


def mission_run() -> RunRecord:
    """Return the same drive through the flat, with a choice, a switch and a failure."""
    found = flat_run()
    asked = "Go to the chair or the sofa, then to the tv."
    story = story_of(FORMULA, ("sofa", "tv"), STORY, asked)
    objects = [
        instance(k, label, 0.9 - 0.1 * k, "reached" if label in ("sofa", "tv") else "tentative")
        for k, label in enumerate(("chair", "sofa", "tv", "bed"))
    ]
    texts = [(t_s, text) for t_s, _, _, text in STORY]
    return replace(
        found, title=asked, targets=story.spec.labels, mission_facts=story,
        instances=tuple(objects), events=tuple(texts),
    )  # fmt: skip


def task_run(**fields: Any) -> RunRecord:
    """Return the same drive through the flat as a task, refined on the flat's map."""
    found, occupancy = flat_run(), flat()
    floor = Grid((occupancy.cells == 0).astype(np.uint8), occupancy.origin_xy_m, RESOLUTION_M)
    start = SE2(*WAY[0], math.pi / 2)
    scene = Scene(
        0, start, {}, {1: Region(1, "floor", 40.0)}, occupancy, floor, None, None, None, {}
    )
    coarse = np.array([*WAY[1:4], *WAY[4:]])
    refined = refine(scene, [coarse[:3], coarse[3:]], {1}, PathMargins(0.2, 0.6), LIMITS)
    task: TaskStatus = driving(
        len(refined.poses) - 1, phase="reached", coarse_m=coarse, refined=refined,
        notes=refined.notes,
    )  # fmt: skip
    task = replace(task, instruction="go through the door, then stop at the chair", **fields)
    return replace(found, title=task.instruction, task=task)
