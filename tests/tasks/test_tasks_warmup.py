"""Nothing that a task calls is compiled once the service is ready."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from task_scenes import STREET, street

from edge.config import RobotConfig, TasksConfig
from edge.loop.warmup import room, warm_tasks
from edge.tasks.refine import refine, refine_again
from edge.tasks.scene import scan_kernels
from edge.tasks.scene.objects import ObjectMap
from edge.tasks.scene.scene_builder import add_detections
from edge.tasks.scene.value_map import PathMargins
from edge.tasks.write import write_trajectory
from edge.trajectory import kernels
from edge.trajectory.pursuit import MotionLimits
from edge.types import MASK_SIDE, Detections


def signatures() -> dict[str, list[tuple]]:
    """Compiled or loaded variants of every kernel."""
    return {
        f"{module.__name__}.{name}": list(kernel.signatures)
        for module in (scan_kernels, kernels)
        for name, kernel in vars(module).items()
        if hasattr(kernel, "signatures") and name != "_heuristic"  # inlined in the others
    }


def test_nothing_is_compiled_after_warmup():
    warm_tasks()
    before = signatures()
    assert all(before.values())
    seen, k = room(), 3
    boxes = np.tile(np.array([10.0, 4.0, 30.0, 30.0], np.float32), (k, 1))
    mask = np.ones((k, MASK_SIDE, MASK_SIDE), np.bool_)
    found = Detections(
        seen, boxes, np.ones(k, np.float32), np.zeros(k, np.int32), ("box",), mask=mask
    )
    cloud_m = np.ones((9, 3), np.float32)
    for way in (seen, replace(seen, depth_m=None, cloud_m=cloud_m)):
        add_detections(ObjectMap(), replace(found, observation=way), 10.0)
    for instruction in ("go around the van", "go past object 2, then stop at the gate"):
        scene = street(*STREET)
        coarse = write_trajectory(instruction, scene, TasksConfig()).coarse
        body, limits = PathMargins(0.3), MotionLimits.of(RobotConfig())
        refined = refine(scene, coarse.segments, coarse.regions, body, limits)
        refine_again(scene, refined, 1, body, limits)
    assert signatures() == before
