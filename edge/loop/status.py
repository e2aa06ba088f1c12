"""What the service says of itself on the bus, once a second."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from edge.loop.faults import DEGRADED_AFTER
from edge.perception.detector import Health
from edge.perception.inline import InlineWorker
from edge.perception.worker import DetectorWorker
from edge.text import one_line

if TYPE_CHECKING:
    from edge.loop.scorers import Scorers
    from edge.loop.service import Service
    from edge.mission.run import MissionRun


def status_of(
    service: Service, worker: DetectorWorker | InlineWorker, scorers: Scorers | None
) -> dict[str, object]:
    """The status message: JSON-ready, field names with units."""
    pose, goal, s, mission = service.pose, service.goal, service.status, service.mission
    goals = service.goals
    return {
        "instruction": s.instruction,
        "target": s.target,
        "phase": s.phase,
        "reason": s.reason,
        "elapsed_s": round(s.elapsed_s, 2),
        "path_m": round(s.path_m, 2),
        "mission": mission_of(mission),
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
            "answer": "" if goals.answer is None else goals.answer.state,
        },
        "controller": "answers" if goals.heard else "silent",
        "loop": {**service.faults.status(), "overruns": service.overruns()},
        "frontiers": service.grid.frontiers.n,
        "instances": [
            {
                "id": i.id,
                "label": i.label,
                "xy_m": [float(i.center_m[0]), float(i.center_m[1])],
                "score": float(i.score),
                "hits": i.hits,
                "state": i.state,
            }
            for label in mission.brief.targets
            for i in service.tracker.of(label)
        ],
        "checkpoint": None if service.keeper is None else service.keeper.status(),
        "detector": {
            "model": worker.detector.name,
            **detector_health(worker)._asdict(),
            "invalid_boxes": worker.detector.invalid_boxes,
            **asdict(worker.stats),
        },
        "swap": service.swapper.status(),
        "scorers": {} if scorers is None else scorers.status(),
    }


def detector_health(worker: DetectorWorker | InlineWorker) -> Health:
    """How the detector is by its own account, and if that is well, by what comes of its images."""
    own = worker.detector.health()
    if own.state == "ok" and worker.stats.in_a_row >= DEGRADED_AFTER:
        return Health("degraded", f"fails at every image: {worker.stats.last_error}")
    return own


def mission_of(mission: MissionRun) -> dict[str, object]:
    """Formula, automaton state, plan and sets of a mission (ViTL IV-A2), and why this target."""
    translation, plan, knowledge = mission.brief.translation, mission.plan, mission.knowledge
    return {
        "formula": one_line(mission.brief.automaton.formula),
        "english": translation.understood,
        "translated_by": one_line(translation.backend),
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


def answer_of(service: Service) -> dict[str, object]:
    """How the mission stands, for whoever gave it an order."""
    s, mission = service.status, service.mission
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
    }
