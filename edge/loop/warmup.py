"""Compiles every kernel that the loop will call, before the loop starts.

With a filled numba cache this takes a second or two; without one it takes tens of seconds, which
is why it says what it is doing.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from time import perf_counter

import numpy as np

from edge.bus.wire.kernels import warmup as warm_messages
from edge.config import Config, PolicyOwn
from edge.geometry import SE2, CameraModel
from edge.loop.candidates import CandidatePool
from edge.loop.prior import warm_up as warm_prior
from edge.mapping.grid import RollingMap
from edge.mapping.view import MapView
from edge.mapping.warmup import warmup as warm_mapping
from edge.mission.planning.planner import warm_up as warm_planners
from edge.perception.warmup import warmup as warm_perception
from edge.policies import make_policy
from edge.policies.base import Answers, Context
from edge.tasks.warmup import warm_up as warm_tasks
from edge.types import Detections, Observation

log = logging.getLogger("edge.loop.warmup")

_SLOW_S = 3.0


def warm_up(config: Config, progress: Callable[[str], None] = lambda what: None) -> float:
    """Run every kernel once on made-up data.

    Args:
        progress: told what is begun.

    Returns:
        Seconds it took.
    """
    steps: list[tuple[str, Callable[[], object]]] = [
        ("mapping", lambda: warm_mapping(config.mapping)),
        ("perception", lambda: warm_perception()),
        ("prior", lambda: warm_prior(config)),
        ("policy", lambda: warm_policy(config)),
        ("planner", warm_planners),
        ("messages", warm_messages),
        ("tasks", warm_tasks),
    ]
    started = perf_counter()
    for i, (name, step) in enumerate(steps, start=1):
        before = perf_counter()
        what = f"preparing kernels {i}/{len(steps)}: {name}"
        log.info(what)
        progress(what)
        step()
        if perf_counter() - before > _SLOW_S:
            log.info("compiled %s kernels in %.0f s; the next start finds them in the cache",
                     name, perf_counter() - before)  # fmt: skip
    return perf_counter() - started


def warm_policy(config: Config) -> None:
    """One scoring pass over a map with one frontier and one box in the image.

    One's own policy compiles what it needs when it is made.
    """
    if isinstance(config.policy, PolicyOwn):
        return
    grid = RollingMap(config.mapping)
    pool = CandidatePool(8, config.policy.r_assoc_m)
    grid.frontiers.n = 1
    grid.values.begin(("x",))
    grid.window.placed = True
    grid.reach.step(SE2(0.0, 0.0, 0.0))
    pool.update(grid.frontiers, [], 0, 0)
    pool.measure(grid)
    pool.add_look(grid, SE2(0.0, 0.0, 0.0), 1.0, 0)
    observation = Observation(
        0, 0, np.eye(4), camera=CameraModel.from_hfov(320, 256, 1.2), rgb=None
    )
    seen = Detections(
        observation,
        np.array([[10, 10, 20, 20]], np.float32),
        np.ones(1, np.float32),
        np.zeros(1, np.int32),
        ("x",),
    )
    nowhere, target = (0, 0, 0, 0), seen.prompts[0]
    context = Context(
        observation,
        observation.pose,
        MapView(grid),
        nowhere,
        pool.shown,
        seen,
        Answers(),
        seen.prompts,
        target,
        0,
    )
    make_policy(config.policy).score(context)
