"""Warm-up: compiles every kernel that the loop calls, before the loop starts.

With a filled numba cache this takes a second or two. Without one it takes tens of seconds, so it
reports its progress.
"""

from __future__ import annotations

import logging
import subprocess
import sys
from collections.abc import Callable
from time import perf_counter

import numpy as np

from edge.bus.wire.kernels import warmup as warm_messages
from edge.config import Config, PolicyPlugin
from edge.geometry import SE2, CameraModel
from edge.host.children import python_module
from edge.loop.goals.candidates import CandidatePool
from edge.loop.scoring.room_surveyor import warm_up as warm_rooms
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.mapping.warmup import warm_values
from edge.mapping.warmup import warmup as warm_mapping
from edge.mission.planning.planner import warm_up as warm_planners
from edge.perception.detection import kernels
from edge.perception.warmup import warmup as warm_perception
from edge.policies import make_policy
from edge.policies.base import PolicyInput, ScorerOutputs
from edge.tasks.warmup import warm_up as warm_tasks
from edge.types import Detections, Observation

log = logging.getLogger("edge.loop.warmup")

_REPORT_AFTER_S = 3.0  # a longer step is logged


def warm_up(config: Config, progress: Callable[[str], None] = lambda what: None) -> float:
    """Run every kernel of this configuration once on synthetic data.

    Returns:
        Duration in seconds.
    """
    # A helper process compiles these while this process compiles the others, and then reads them
    # from the cache. The helper runs `main`, so both lists must agree.
    shared: dict[str, Callable[[], object]] = {
        "perception": lambda: warm_perception((config.perception.back_projection,)),
        "planner": lambda: warm_planners(planner_weights(config)),
        "messages": warm_messages,
    }
    steps: dict[str, Callable[[], object]] = {
        "mapping": lambda: warm_mapping(config.mapping),
        "rooms": lambda: warm_rooms(config),
        "policy": lambda: warm_policy(config),
        **shared,
        "tasks": warm_tasks,
    }
    started = perf_counter()
    helper = _start_helper(config) if _must_compile() else None
    for i, (name, step) in enumerate(steps.items(), start=1):
        before = perf_counter()
        what = f"preparing kernels {i}/{len(steps)}: {name}"
        log.info(what)
        progress(what)
        if helper is not None and name in shared:
            helper.wait()
        step()
        if perf_counter() - before > _REPORT_AFTER_S:
            log.info("compiled %s kernels in %.0f s; the next start finds them in the cache",
                     name, perf_counter() - before)  # fmt: skip
    return perf_counter() - started


def planner_weights(config: Config) -> str:
    """Return the setting `mission.planner.weights`, `constant` for a planner without it."""
    return getattr(config.mission.planner, "weights", "constant")


def _must_compile() -> bool:
    """Return True if kernels must be compiled, which is so if a cheap one is not in the cache."""
    kernel = kernels.to_planes
    if kernel.signatures:  # this process has called it before
        return False
    plane = np.zeros((3, 16, 16), np.float32)
    kernel(np.zeros((16, 16, 3), np.uint8), np.float32(1 / 255), 0, 0, plane)
    return bool(kernel.stats.cache_misses)


def _start_helper(config: Config) -> subprocess.Popen[bytes]:
    """Start the helper process. If it fails, this process compiles everything."""
    command = (
        *python_module("edge.loop.warmup"),
        config.perception.back_projection,
        planner_weights(config),
    )
    null = subprocess.DEVNULL
    return subprocess.Popen(command, stdin=null, stdout=null, stderr=null)


def main(back_projection: str, weights: str) -> None:
    """Run as the helper: compile the kernels of perception, planner and messages into the cache."""
    warm_perception((back_projection,))
    warm_planners(weights)
    warm_messages()


def warm_policy(config: Config) -> None:
    """Score a map with one frontier and an image with one box.

    A policy plugin compiles its own kernels when it is made.
    """
    if config.value_source is not None:
        warm_values(config.mapping)
    if isinstance(config.policy, PolicyPlugin):
        return
    grid = RollingMap(config.mapping)
    pool = CandidatePool(8, config.policy.r_assoc_m)
    grid.frontiers.n = 1
    grid.values.set_targets(("x",))
    grid.window.placed = True
    grid.travel_cost.step(SE2(0.0, 0.0, 0.0))
    pool.update(grid.frontiers, [], 0, 0)
    pool.measure(grid)
    pool.add_spin(grid, SE2(0.0, 0.0, 0.0), 1.0, 0)
    observation = Observation(
        0, 0, np.eye(4), camera=CameraModel.from_hfov(320, 256, 1.2), rgb=None
    )
    detections = Detections(
        observation,
        np.array([[10, 10, 20, 20]], np.float32),
        np.ones(1, np.float32),
        np.zeros(1, np.int32),
        ("x",),
    )
    no_area, target = (0, 0, 0, 0), detections.prompts[0]
    context = PolicyInput(
        observation,
        observation.pose,
        MapView(grid),
        no_area,
        pool.read_only,
        detections,
        ScorerOutputs(),
        detections.prompts,
        target,
        0,
    )
    make_policy(config.policy).score(context)


if __name__ == "__main__":
    main(*sys.argv[1:])
