"""What the service says of itself on the bus, once a second."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from edge.perception.inline import InlineWorker
from edge.perception.worker import DetectorWorker

if TYPE_CHECKING:
    from edge.service import Service


def status_of(service: Service, worker: DetectorWorker | InlineWorker) -> dict[str, object]:
    """The status message: JSON-ready, field names with units."""
    pose, goal, s = service.pose, service.goal, service.mission.status
    return {
        "target": s.target,
        "phase": s.phase,
        "reason": s.reason,
        "elapsed_s": round(s.elapsed_s, 2),
        "path_m": round(s.path_m, 2),
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
            "answer": "" if service.orders.answer is None else service.orders.answer.state,
        },
        "controller": "answers" if service.orders.heard else "silent",
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
            for i in service.tracker.of(s.target)
        ],
        "detector": {"model": worker.detector.name, **asdict(worker.stats)},
    }
