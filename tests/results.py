"""Results of the loop, made by hand for tests of sinks."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from simulated import simulated

from edge.geometry import Grid
from edge.loop.latency import LatencyRing
from edge.loop.result import MissionFacts, TickResult, mission_facts, scored_candidates
from edge.mapping.zones import ZonePolygons
from edge.memory import Site
from edge.mission.run import MissionRun
from edge.mission.spec import prepare
from edge.policies.base import Candidates
from edge.types import MissionStatus, Observation

CELLS = np.array([[-1, 0], [100, 0]], np.int8)


def observation(stamp_ns: int) -> Observation:
    return Observation(0, stamp_ns, np.eye(4))


@cache
def facts(target: str = "chair") -> MissionFacts:
    config = simulated({"mission": {"target": target}}).mission
    return mission_facts(MissionRun(prepare(config), config))


def parts() -> dict[str, Any]:
    names = (
        "loop", "checkpoint", "detector", "segmenter", "swap", "load_shedding", "scorers", "sinks"
    )  # fmt: skip
    return {part: {} for part in names}


def result(now_ns: int = 0, **fields: Any) -> TickResult:
    """Return a tick without events, with the given fields."""
    status = fields.get("status", MissionStatus("chair", "searching"))
    nothing: dict[str, Any] = {
        "observation": None, "pose": None, "status": status, "goal": None, "goal_status": None,
        "has_controller": False, "stopped": "", "proposals": list,
        "targets": {status.target: status.target}, "goals": (), "goal_statuses": (),
        "events": (), "inputs": (), "detections": None, "mission": lambda: facts(status.target),
        "task": lambda: None,
        "instances": list, "objects": list, "rooms": (), "site": Site(), "zones": ZonePolygons(),
        "frontiers": lambda: np.zeros((0, 2), np.float32),
        "candidates": lambda: scored_candidates(Candidates(0), np.zeros(0, np.float32)),
        "path": lambda: np.zeros((0, 2), np.float32), "choice": None, "layers": dict,
        "known_m2": lambda: 0.0,
        "snapshot": lambda inflated=100: Grid(CELLS, (-1.0, 2.0), 0.05),
        "latency": LatencyRing().report, "spans": LatencyRing().spans, "parts": parts,
    }  # fmt: skip
    return TickResult(now_ns=now_ns, **{**nothing, **fields})
