"""JSON of the service: the status message, which is sent once a second, and replies to requests."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Protocol

import numpy as np

from edge.loop.error_boundary import DEGRADED_AFTER, ErrorBoundary
from edge.loop.publish import statuses
from edge.loop.result import MissionFacts, Sink, TickResult
from edge.loop.scoring.scorers import Scorers
from edge.loop.source import InputStatus, inputs_status
from edge.perception.runtime.health import ModelHealth
from edge.perception.worker import DetectorWorker
from edge.tasks.facts import TaskStatus, lengths_m, thinned
from edge.text import MAX_CHARS, bounded_lines, one_line
from edge.types import Instance, MissionStatus

MOST_POSES = 200
"""Number of poses of a trajectory to include."""
MOST_ATTEMPTS = 4
"""Number of a model's newest attempts to include: they may be long, and are sent each second."""
_MAX_LINES = 20  # of each list of texts
_MAX_CODE_CHARS, _MAX_TEXT_CHARS, _MAX_STEP_CHARS = 2000, 500, 100  # of one text


def status_message(result: TickResult) -> dict[str, object]:
    """Return the status message, JSON-ready, with units in the field names."""
    return {
        **tick_json(result),
        "mission": mission_json(result.mission()),
        "task": task_json(result.task()),
        "frontiers": len(result.frontiers()),
        **result.parts(),
    }


def tick_json(result: TickResult) -> dict[str, Any]:
    """Return the part of the status message that changes all the time.

    `instances` are the objects that were detected as a target.
    """
    pose, goal, status = result.pose, result.goal, result.status
    return {
        "instruction": status.instruction,
        "target": status.target,
        "phase": status.phase,
        "reason": status.reason,
        "elapsed_s": round(status.elapsed_s, 2),
        "path_m": round(status.path_m, 2),
        "pose": None if pose is None else [pose.x_m, pose.y_m, pose.yaw_rad],
        "goal": None
        if goal is None
        else {
            "stamp": goal.stamp_ns,
            "kind": goal.kind,
            "id": goal.candidate_id,
            "pose": [goal.pose.x_m, goal.pose.y_m, goal.pose.yaw_rad],
            "candidate_xy_m": list(goal.candidate_xy_m),
            "score": goal.score if math.isfinite(goal.score) else None,
            "answer": "" if result.goal_status is None else result.goal_status.state,
        },
        "controller": "answers" if result.has_controller else "silent",
        "stopped": result.stopped,
        "instances": [_instance_json(instance) for instance in result.instances()],
    }


def _instance_json(instance: Instance) -> dict[str, object]:
    return {
        "id": instance.id,
        "label": instance.label,
        "xy_m": [round(float(x), 4) for x in instance.center_m[:2]],
        "score": round(float(instance.score), 4),
        "hits": instance.hits,
        "state": instance.state,
    }


class Part(Protocol):
    """A part of the loop that reports its own status."""

    def status(self) -> dict[str, object]:
        """Return the status, JSON-ready; any thread may call this."""


class PartsStatus:
    """Collects the status of all parts of the loop, and reports when the detector fails.

    Args:
        worker: Runs the detector.
        parts: As in `Attributes`.
        scorers: The scorers, if any.
        error_boundary: Counts the exceptions of the loop.
        event: Called with a text for people and the loop time in ns.
        sinks: See `edge.loop.publish.statuses`.

    Attributes:
        parts: The parts that report their own status, by name; None: there is no such part.
        overruns: Returns the number of reads that found a message ring (the buffer of received
            messages) full, by ring; may be set.
        inputs: Returns the source's table of inputs to any thread; may be set.
    """

    def __init__(
        self,
        worker: DetectorWorker,
        parts: dict[str, Part | None],
        scorers: Scorers | None,
        error_boundary: ErrorBoundary,
        event: Callable[[str, int], None],
        sinks: Sequence[Sink] = (),
    ) -> None:
        self._worker, self.parts, self._scorers = worker, parts, scorers
        self._error_boundary, self._event = error_boundary, event
        self._sinks = sinks
        self.overruns: Callable[[], dict[str, int]] = dict
        self.inputs: Callable[[], Sequence[InputStatus]] = tuple
        self._reported = ModelHealth()  # state and detail of the detector that were reported

    def check(self, now_ns: int) -> None:
        """Report once that the detector is degraded or replaced, and once that it works again."""
        health, reported = detector_health(self._worker), self._reported
        name = self._worker.detector.name
        if health.state == "degraded" != reported.state:
            self._event(f"detector {name}: degraded: {health.detail}", now_ns)
        elif health.state == "ok" and health.detail:
            if not (reported.state == "ok" and reported.detail):
                self._event(f"detector {name}: {health.detail}", now_ns)
        elif health.state == "ok" and reported != ModelHealth():
            self._event(f"detector {name}: works again", now_ns)
        elif health.state != "degraded":
            return
        self._reported = health

    def status(self) -> dict[str, Any]:
        """Return the status of each part for the status message."""
        worker = self._worker
        return {
            "loop": {**self._error_boundary.status(), "overruns": self.overruns()},
            "detector": {
                "model": worker.detector.name,
                **detector_health(worker)._asdict(),
                "invalid_boxes": worker.detector.invalid_boxes,
                **asdict(worker.stats),
            },
            "scorers": {} if self._scorers is None else self._scorers.status(),
            "sinks": statuses(self._sinks),
            "inputs": inputs_status(self.inputs()),
            **{name: None if part is None else part.status() for name, part in self.parts.items()},
        }


def detector_health(worker: DetectorWorker) -> ModelHealth:
    """Return the detector's health: its own report, or degraded if its newest images failed."""
    reported = worker.detector.health()
    if reported.state == "ok" and worker.stats.in_a_row >= DEGRADED_AFTER:
        return ModelHealth("degraded", f"fails on every image: {worker.stats.last_error}")
    return reported


def mission_json(mission: MissionFacts) -> dict[str, object]:
    """Return formula, automaton state, plan and sets of a mission (ViTL IV-A2), JSON-ready.

    `why` is the reason for the active target.
    """
    translation, plan, knowledge = mission.spec.translation, mission.plan, mission.knowledge
    return {
        "id": mission.id,
        "formula": one_line(mission.spec.automaton.formula),
        "english": translation.understood,
        "translated_by": one_line(translation.backend),
        "reading": translation.reading,
        "readings": [one_line(english, _MAX_TEXT_CHARS) for english in translation.readings],
        "state": mission.state,
        "states": mission.spec.automaton.n_states,
        "trace": list(mission.trace),
        "plan": list(plan.steps),
        "cost": plan.cost if plan.feasible else None,
        "why": plan.reason,
        "options": [list(option) for option in plan.options],
        "detected": sorted(knowledge.detected),
        "reached": list(mission.reached),
        "failed": sorted(knowledge.failed),
        "forbidden": list(mission.forbidden),
    }


def task_json(task: TaskStatus | None, scale: int = 1) -> dict[str, Any] | None:
    """Return a task and its trajectory, JSON-ready and of bounded size; None if there is no task.

    `trajectory` has at most `scale * MOST_POSES` rows [x, y, heading], and `index` refers to them.
    `rounds` holds the newest of the model's attempts; their total number is `answers`. An attempt
    without code has its text. `scale` is a factor on the limits of lists and texts.
    """
    if task is None:
        return None
    max_lines, max_text = scale * _MAX_LINES, scale * _MAX_TEXT_CHARS
    line = partial(one_line, limit=scale * MAX_CHARS)
    poses, index, length_m, driven_m = np.empty((0, 3)), -1, 0.0, 0.0
    if task.refined is not None:
        poses, index = thinned(task.refined, task.index, scale * MOST_POSES)
        length_m, driven_m = lengths_m(task.refined, task.index)
    return {
        "instruction": one_line(task.instruction, max_text),
        "phase": task.phase,
        "writer": line(task.writer),
        "missing": [line(name) for name in task.missing[:max_lines]],
        "steps": [
            {"said": one_line(step.said, scale * _MAX_STEP_CHARS), "state": step.state}
            for step in task.steps[:max_lines]
        ],
        "understood": one_line(task.understood, max_text),
        "rounds": [
            {
                "answer": "" if attempt.code else bounded_lines(attempt.answer, max_text),
                "code": bounded_lines(attempt.code, scale * _MAX_CODE_CHARS),
                "error": line(attempt.error),
                "printed": bounded_lines(attempt.printed, max_text),
            }
            for attempt in task.rounds[-scale * MOST_ATTEMPTS :]
        ],
        "answers": len(task.rounds),
        "trajectory": np.round(poses, 3).tolist(),
        "index": index,
        "length_m": round(length_m, 2),
        "driven_m": round(driven_m, 2),
        "refinements": task.refinements,
        "notes": [line(note) for note in task.notes[:max_lines]],
    }


def reply_json(
    status: MissionStatus, mission: MissionFacts, task: TaskStatus | None = None
) -> dict[str, object]:
    """Return the reply to a request: the status of the mission and of its task."""
    return {
        "instruction": status.instruction,
        "phase": status.phase,
        "reason": status.reason,
        "target": status.target,
        "paused": mission.paused,
        "question": mission.question,
        "elapsed_s": round(status.elapsed_s, 2),
        "path_m": round(status.path_m, 2),
        "warnings": list(mission.spec.warnings),
        **mission_json(mission),
        "task": task_json(task),
    }
