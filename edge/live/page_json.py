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
from edge.loop.status import MOST_POSES, mission_json, task_json, tick_json
from edge.policies.base import FRONTIER, INSTANCE
from edge.tasks.facts import TaskStatus, lengths_m, thinned
from edge.text import bounded_lines

MAX_POINTS = 400
"""Largest number of points of a path that is drawn."""
MAX_STEPS = 60  # of the mission log
MAX_LAYERS = 16  # grids that the page can draw
_TASK_SCALE = 8  # on the status message's limits of a task, which a person reads here
_MAX_PROMPT_CHARS = 100_000
_KINDS = {FRONTIER: "frontier", INSTANCE: "instance"}
_NS = 1e-9  # seconds in a nanosecond


def snapshot_json(snapshot: LiveSnapshot) -> dict[str, Any]:
    """Return the data that change all the time, with the names of the status message."""
    result, mission = snapshot.result, snapshot.result.mission()
    return {
        **tick_json(result),
        "tick_hz": round(snapshot.tick_hz, 1),
        "paused": mission.paused,
        "question": mission.question,
        "proposals": snapshot.proposals,
        "task": _task_progress(result.task(), snapshot.n_tasks),
        "site": snapshot.n_sites,
        "path": points(result.path()),
        "candidates": _candidates(snapshot),
    }


def _task_progress(task: TaskStatus | None, number: int) -> dict[str, Any] | None:
    """Return the progress along the trajectory of `task_json`, with its version."""
    if task is None:
        return None
    index, driven_m = -1, 0.0
    if task.refined is not None:
        index = thinned(task.refined, task.index, _TASK_SCALE * MOST_POSES)[1]
        driven_m = lengths_m(task.refined, task.index)[1]
    return {"number": number, "phase": task.phase, "index": index, "driven_m": round(driven_m, 2)}


def page_task_json(task: TaskStatus, number: int) -> dict[str, Any]:
    """Return a task as in the status message, with longer texts, its prompt and `coarse`."""
    return {
        **(task_json(task, _TASK_SCALE) or {}),
        "number": number,
        "prompt": bounded_lines(task.prompt, _MAX_PROMPT_CHARS),
        "coarse": [] if task.coarse_m is None else points(task.coarse_m),
        "time_s": 0.0 if task.refined is None else round(float(task.refined.times_s[-1]), 1),
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


def _candidates(snapshot: LiveSnapshot) -> list[dict[str, Any]]:
    """Return the candidates of the tick, one object for each."""
    rows = []
    for kind, i, xy_m, score, path_m, blocked in zip(*snapshot.result.candidates(), strict=True):
        letter, p = snapshot.mark_letters.get(int(i), ("", 0.0)) if kind == FRONTIER else ("", 0.0)
        rows.append(
            {
                "kind": _KINDS.get(int(kind), "spin"),
                "id": int(i),
                "xy_m": [_number(value) for value in xy_m],
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
    result, mission = snapshot.result, snapshot.result.mission()
    return {
        "targets": list(result.targets.values()),
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
        "health": snapshot.parts,
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


def _number(value: float) -> float | None:
    """Return a rounded number; None for NaN and infinity, which JSON lacks."""
    return round(float(value), 4) if math.isfinite(value) else None
