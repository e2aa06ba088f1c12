"""What the service says of itself on the bus, once a second."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from edge.loop.checkpoint import ServiceCheckpoint
from edge.loop.faults import DEGRADED_AFTER, Faults
from edge.loop.publish import statuses
from edge.loop.result import MissionFacts, Sink, TickResult
from edge.loop.scorers import Scorers
from edge.loop.source import InputRow, inputs_status
from edge.perception.runtime.health import Health
from edge.perception.swap.detector import DetectorSwap
from edge.perception.worker import DetectorWorker
from edge.tasks.facts import TaskFacts, lengths_m, thinned
from edge.text import one_line, some_lines
from edge.types import MissionStatus

MOST_POSES = 200
MOST_ROUNDS = 4
"""Of a model's answers, the newest: they may be long, and the status goes out each second."""
_MOST_LINES = 20
_CODE_CHARS, _PRINTED_CHARS, _STEP_CHARS = 2000, 500, 100


def status_of(result: TickResult) -> dict[str, object]:
    """The status message: JSON-ready, field names with units."""
    pose, goal, s, health = result.pose, result.goal, result.status, result.health()
    return {
        "instruction": s.instruction,
        "target": s.target,
        "phase": s.phase,
        "reason": s.reason,
        "elapsed_s": round(s.elapsed_s, 2),
        "path_m": round(s.path_m, 2),
        "mission": mission_of(result.mission()),
        "task": task_of(result.task()),
        "pose": None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad],
        "goal": None
        if goal is None
        else {
            "stamp": goal.stamp_ns,
            "kind": goal.kind,
            "id": goal.candidate_id,
            "pose": [goal.pose.x_m, goal.pose.y_m, goal.pose.yaw_rad],
            "candidate_xy_m": list(goal.candidate_xy_m),
            "score": goal.score,
            "answer": "" if result.answer is None else result.answer.state,
        },
        "controller": "answers" if result.controlled else "silent",
        "frontiers": len(result.frontiers()),
        "instances": [
            {
                "id": i.id,
                "label": i.label,
                "xy_m": [float(i.center_m[0]), float(i.center_m[1])],
                "score": float(i.score),
                "hits": i.hits,
                "state": i.state,
            }
            for i in result.instances()
        ],
        **health,
    }


class HealthWatch:
    """How all is that works for the loop.

    Args:
        overruns: by what is listened to, how often more came than could be taken.
        governor: how it stands, None where there is none.
        event: tells of something that a person would want to know.
        sinks: see `edge.loop.publish.statuses`.
        inputs: the source's table, empty where it has none.
        plausibility: see `edge.loop.plausibility.Plausibility.status`.
    """

    def __init__(
        self,
        worker: DetectorWorker,
        swapper: DetectorSwap,
        scorers: Scorers | None,
        checkpoint: ServiceCheckpoint | None,
        faults: Faults,
        overruns: Callable[[], dict[str, int]],
        governor: Callable[[], dict[str, object] | None],
        event: Callable[[str, int], None],
        sinks: Sequence[Sink] = (),
        inputs: Callable[[], Sequence[InputRow]] = tuple,
        plausibility: Callable[[], dict[str, object]] = dict,
    ) -> None:
        self._worker, self._swapper, self._scorers = worker, swapper, scorers
        self._checkpoint, self._faults, self._overruns = checkpoint, faults, overruns
        self._governor, self._event = governor, event
        self._sinks, self._inputs, self._plausibility = sinks, inputs, plausibility
        self._degraded = False  # the detector is known to be, and that was told

    def look(self, now_ns: int) -> None:
        """Tell once that the detector has become degraded, and once that it is well again."""
        state, detail = detector_health(self._worker)
        name = self._worker.detector.name
        if state == "degraded" and not self._degraded:
            self._degraded = True
            self._event(f"detector {name}: degraded: {detail}", now_ns)
        elif state == "ok" and self._degraded:
            self._degraded = False
            self._event(f"detector {name}: goes well again", now_ns)

    def status(self) -> dict[str, Any]:
        """For the status message, by part."""
        worker = self._worker
        return {
            "loop": {**self._faults.status(), "overruns": self._overruns()},
            "checkpoint": None if self._checkpoint is None else self._checkpoint.status(),
            "detector": {
                "model": worker.detector.name,
                **detector_health(worker)._asdict(),
                "invalid_boxes": worker.detector.invalid_boxes,
                **asdict(worker.stats),
            },
            "segmenter": None if worker.masker is None else worker.masker.status(),
            "swap": self._swapper.status(),
            "governor": self._governor(),
            "scorers": {} if self._scorers is None else self._scorers.status(),
            "sinks": statuses(self._sinks),
            "inputs": inputs_status(self._inputs()),
            "plausibility": self._plausibility(),
        }


def detector_health(worker: DetectorWorker) -> Health:
    """How the detector is by its own account, and if that is well, by what comes of its images."""
    own = worker.detector.health()
    if own.state == "ok" and worker.stats.in_a_row >= DEGRADED_AFTER:
        return Health("degraded", f"fails at every image: {worker.stats.last_error}")
    return own


def mission_of(mission: MissionFacts) -> dict[str, object]:
    """Formula, automaton state, plan and sets of a mission (ViTL IV-A2), and why this target."""
    translation, plan, knowledge = mission.brief.translation, mission.plan, mission.knowledge
    return {
        "id": mission.id,
        "formula": one_line(mission.brief.automaton.formula),
        "english": translation.understood,
        "translated_by": one_line(translation.backend),
        "reading": translation.reading,
        "readings": [one_line(english, _PRINTED_CHARS) for english in translation.readings],
        "state": mission.state,
        "states": mission.brief.automaton.n_states,
        "word": list(mission.word),
        "plan": list(plan.steps),
        "cost": plan.cost if plan.feasible else None,
        "why": plan.reason,
        "options": [list(option) for option in plan.options],
        "detected": sorted(knowledge.detected),
        "reached": list(mission.reached),
        "failed": sorted(knowledge.failed),
        "forbidden": list(mission.forbidden),
    }


def task_of(task: TaskFacts | None) -> dict[str, object] | None:
    """A task and its trajectory, however much a model has said; None: there is no task.

    `trajectory` has `MOST_POSES` [x, y, heading] at most, and `index` is of those; `rounds` are the
    newest of `answers` answers of a model.
    """
    if task is None:
        return None
    poses, index, length_m, driven_m = np.empty((0, 3)), -1, 0.0, 0.0
    if task.refined is not None:
        poses, index = thinned(task.refined, task.index, MOST_POSES)
        length_m, driven_m = lengths_m(task.refined, task.index)
    return {
        "instruction": one_line(task.instruction, _PRINTED_CHARS),
        "phase": task.phase,
        "writer": one_line(task.writer),
        "missing": [one_line(name) for name in task.missing[:_MOST_LINES]],
        "steps": [
            {"said": one_line(step.said, _STEP_CHARS), "state": step.state}
            for step in task.steps[:_MOST_LINES]
        ],
        "understood": one_line(task.understood, _PRINTED_CHARS),
        "rounds": [
            {
                "code": some_lines(round.code, _CODE_CHARS),
                "error": one_line(round.error),
                "printed": some_lines(round.printed, _PRINTED_CHARS),
            }
            for round in task.rounds[-MOST_ROUNDS:]
        ],
        "answers": len(task.rounds),
        "trajectory": np.round(poses, 3).tolist(),
        "index": index,
        "length_m": round(length_m, 2),
        "driven_m": round(driven_m, 2),
        "refinements": task.refinements,
        "notes": [one_line(note) for note in task.notes[:_MOST_LINES]],
    }


def answer_of(
    s: MissionStatus, mission: MissionFacts, task: TaskFacts | None = None
) -> dict[str, object]:
    """How the mission stands, and the task that it does, for whoever asked."""
    return {
        "instruction": s.instruction,
        "phase": s.phase,
        "reason": s.reason,
        "target": s.target,
        "paused": mission.paused,
        "elapsed_s": round(s.elapsed_s, 2),
        "path_m": round(s.path_m, 2),
        "warnings": list(mission.brief.warnings),
        **mission_of(mission),
        "task": task_of(task),
    }
