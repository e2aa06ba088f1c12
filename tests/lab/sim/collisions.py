"""Where the simulated robot may not be."""

from __future__ import annotations

from edge.lab.sim.base import World


def collides(world: World, x_m: float, y_m: float, radius_m: float) -> bool:
    """Whether a disc at a place touches anything, or leaves the world."""
    return world.plan.clearance_at(x_m, y_m) < radius_m
