"""JSON for the page: the current state of the sink, and data that change less often.

A version (`number`, `site`) is a number that changes with the data. The page fetches the data again
when the version changes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from edge.live.automaton_graph import make_automaton_graph
from edge.live.sink import LiveSnapshot
from edge.loop.latency import LatencyReport
from edge.loop.result import MissionFacts
from edge.loop.status import instance_json, mission_json
from edge.policies.base import FRONTIER, INSTANCE
from edge.tasks.facts import TaskStatus, lengths_m, thinned
from edge.text import bounded_lines, one_line
from edge.types import Goal, GoalStatus

MAX_POINTS = 400
"""Largest number of points of a path that is drawn."""
MAX_STEPS = 60  # of the mission log
MAX_LAYERS = 16  # grids that the page can draw
# Characters of a prompt, of a script, of another text, and of one line of a list.
MAX_PROMPT, MAX_CODE, MAX_WORDS, MAX_LINE = 100_000, 20_000, 4_000, 1_000
MAX_LINES = 50  # entries of a list, such as notes
_KINDS = {FRONTIER: "frontier", INSTANCE: "instance"}
_NS = 1e-9  # seconds in a nanosecond


def snapshot_json(snapshot: LiveSnapshot) -> dict[str, Any]:
    """Return the data that change all the time: pose, goal, candidates, objects."""
    result, status, pose = snapshot.result, snapshot.result.status, snapshot.result.pose
    return {
        "t_s": result.now_ns * _NS,
        "beat_hz": round(snapshot.beat_hz, 1),
        "pose": None if pose is None else _numbers((pose.x_m, pose.y_m, pose.yaw_rad)),
        "instruction": status.instruction,
        "phase": status.phase,
        "reason": status.reason,
        "target": status.target,
        "paused": snapshot.mission.paused,
        "stopped": result.stopped,
        "question": snapshot.mission.question,
        "proposals": snapshot.proposals,
        "task": None if snapshot.task is None else _task(snapshot.task, snapshot.n_tasks),
        "elapsed_s": round(status.elapsed_s, 1),
        "path_m": round(status.path_m, 2),
        "controlled": result.has_controller,
        "site": snapshot.n_sites,
        "goal": None if result.goal is None else _goal(result.goal, result.goal_status),
        "way": points(snapshot.path),
        "candidates": _candidates(snapshot),
        "instances": [instance_json(instance) for instance in snapshot.instances],
    }


def _task(task: TaskStatus, number: int) -> dict[str, Any]:
    """Return the progress of a task; `number` is the version of its `task_json`.

    `index` is that of the last pose reached in `refined` of `task_json`; -1: none.
    """
    index, driven_m = -1, 0.0
    if task.refined is not None:
        index = thinned(task.refined, task.index, MAX_POINTS)[1]
        driven_m = lengths_m(task.refined, task.index)[1]
    return {
        "number": number, "phase": task.phase, "index": index, "driven_m": round(driven_m, 1),
    }  # fmt: skip


def task_json(task: TaskStatus, number: int) -> dict[str, Any]:
    """Return a task: instruction, model answers and both trajectories; long texts are cut.

    `refined` is [x, y, heading], `coarse` is [x, y]. A round has the text of the model's answer if
    the answer has no code.
    """
    refined = task.refined
    return {
        "number": number,
        "instruction": one_line(task.instruction, MAX_WORDS),
        "writer": one_line(task.writer),
        "missing": [one_line(name) for name in task.missing[:MAX_LINES]],
        "steps": [
            {"said": one_line(step.said, MAX_LINE), "state": step.state}
            for step in task.steps[:MAX_LINES]
        ],
        "understood": one_line(task.understood, MAX_WORDS),
        "prompt": bounded_lines(task.prompt, MAX_PROMPT),
        "rounds": [
            {
                "said": "" if round.code else bounded_lines(round.answer, MAX_WORDS),
                "code": bounded_lines(round.code, MAX_CODE),
                "error": one_line(round.error, MAX_LINE),
                "printed": bounded_lines(round.printed, MAX_WORDS),
            }
            for round in task.rounds[-MAX_LINES:]
        ],
        "coarse": [] if task.coarse_m is None else points(task.coarse_m),
        "refined": []
        if refined is None
        else np.round(thinned(refined, 0, MAX_POINTS)[0], 3).tolist(),
        "length_m": 0.0 if refined is None else round(lengths_m(refined, 0)[0], 1),
        "time_s": 0.0 if refined is None else round(float(refined.times_s[-1]), 1),
        "refinements": task.refinements,
        "notes": [one_line(note, MAX_LINE) for note in task.notes[:MAX_LINES]],
    }


def site_json(snapshot: LiveSnapshot) -> dict[str, Any]:
    """Return places and zones as GeoJSON, with their version."""
    return {"number": snapshot.n_sites, **snapshot.site.geojson()}


def memory_json(snapshot: LiveSnapshot) -> dict[str, Any]:
    """Return remembered objects and rooms, as `memory/request` lists them."""
    return {
        "objects": [known.to_json() for known in snapshot.objects],
        "rooms": [room.to_json() for room in snapshot.rooms],
    }


def _goal(goal: Goal, answer: GoalStatus | None) -> dict[str, Any]:
    return {
        "kind": goal.kind,
        "id": goal.candidate_id,
        "target": goal.target,
        "pose": _numbers((goal.pose.x_m, goal.pose.y_m, goal.pose.yaw_rad)),
        "candidate_xy_m": _numbers(goal.candidate_xy_m),
        "score": _number(goal.score),
        "answer": "" if answer is None else answer.state,
        "why": "" if answer is None else one_line(answer.reason),
    }


def _candidates(snapshot: LiveSnapshot) -> list[dict[str, Any]]:
    """Return the candidates of the tick, one object for each."""
    rows = []
    for kind, i, xy_m, score, path_m, blocked in zip(*snapshot.candidates, strict=True):
        letter, p = snapshot.mark_letters.get(int(i), ("", 0.0)) if kind == FRONTIER else ("", 0.0)
        rows.append(
            {
                "kind": _KINDS.get(int(kind), "spin"),
                "id": int(i),
                "xy_m": _numbers(xy_m),
                "score": _number(score),
                "path_m": _number(path_m),
                "blocked": bool(blocked),
                "letter": letter,
                "p": _number(p),
            }
        )
    return rows


def log_json(snapshot: LiveSnapshot, latency: LatencyReport) -> dict[str, Any]:
    """Return the data that rarely change: mission, driven path, latency, log, health."""
    result, mission = snapshot.result, snapshot.mission
    return {
        "targets": list(result.targets),
        "mission": {**mission_json(mission), "warnings": list(mission.spec.warnings)},
        "automaton": automaton_json(mission),
        "steps": [
            {"t_s": step.stamp_ns * _NS, "kind": step.kind, "label": step.label, "text": step.text}
            for step in mission.log[-MAX_STEPS:]
        ],
        "trail": points(snapshot.trail[:, :2]),
        "layers": list(snapshot.layers)[:MAX_LAYERS],
        "latency": latency.as_dict(),
        "events": [{"t_s": e.now_ns * _NS, "text": e.text} for e in snapshot.events],
        "n_events": snapshot.n_events,
        "health": snapshot.health,
    }


def automaton_json(mission: MissionFacts) -> dict[str, Any]:
    """Return the automaton as a graph: see `edge.live.automaton_graph`."""
    graph = make_automaton_graph(
        mission.spec.automaton, mission.state, mission.plan.steps, mission.trace
    )
    return {
        "nodes": [node._asdict() for node in graph.nodes],
        "arrows": [arrow._asdict() for arrow in graph.arrows],
        "note": graph.note,
    }


def points(xy_m: np.ndarray) -> list[list[float]]:
    """Return (n, 2) points as JSON: every few points if there are over `MAX_POINTS`."""
    stride = max(1, math.ceil(len(xy_m) / MAX_POINTS))
    # Counted from the end, so that the last point is kept.
    return np.round(xy_m[::-1][::stride][::-1].astype(np.float64), 2).tolist()


def _numbers(values: Any) -> list[float | None]:
    return [_number(value) for value in values]


def _number(value: float) -> float | None:
    """Return a rounded number; None for NaN and infinity, which JSON lacks."""
    return round(float(value), 4) if math.isfinite(value) else None
