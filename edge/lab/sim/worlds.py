"""Loaders of worlds, by the kind in the configuration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from edge.config import Config
from edge.geometry import SE2
from edge.lab.sim.base import World
from edge.lab.sim.furnished import load_furnished
from edge.lab.sim.generator.house import load_generated
from edge.lab.sim.house import load_house
from edge.lab.sim.mesh import load_mesh
from edge.lab.sim.procthor import load_procthor
from edge.lab.sim.street import load_street

LOADERS: dict[str, Callable[[Any, Config], World]] = {
    "furnished": load_furnished,
    "generated": load_generated,
    "house": load_house,
    "mesh": load_mesh,
    "procthor": load_procthor,
    "street": load_street,
}


def load_world(config: Config) -> World:
    """Load the world that `sim.world` names, for the configured robot and camera.

    It starts at `sim.start` if that is set, else at its own start.

    Raises:
        edge.lab.sim.base.WorldError: one line: file, place, what to do.

    Example:
        >>> from edge.config import parse
        >>> world = load_world(parse({"perception": {"detector": {"kind": "sim"}}}))
        >>> len(world.objects) > 0
        True
    """
    world = LOADERS[config.sim.world.kind](config.sim.world, config)
    if config.sim.start is not None:
        world.start = SE2(*config.sim.start)
    return world
